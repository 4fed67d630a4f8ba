"""What docs/exchange.md and docs/inject.md show is run as it stands."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

from seqsweep.identify.response import FrequencyResponse
from seqsweep.identify.table.write import write_table
from seqsweep.sweep.playback.manifest import manifest_violations

DOCS = Path(__file__).parents[2] / "docs"
OF_ALL = {"--json", "--quiet"}
"""Options of every command; docs/shell.md has them."""
F_HZ = np.array([10.0, 23.0, 77.0, 300.0])


def snippets(page: str, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", (DOCS / page).read_text("utf-8"), re.DOTALL)


@pytest.fixture
def y(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> np.ndarray:
    """``y.parquet`` in the current folder, its third row failed; the values in it."""
    rng = np.random.default_rng(5)
    y = rng.normal(size=(4, 2, 2)) + 1j * rng.normal(size=(4, 2, 2))
    y[2] = complex(np.nan, np.nan)
    status, reason = np.array(["ok", "ok", "failed", "ok"]), np.array(["", "", "why", ""])
    meta = {
        "f1_hz": 50.0,
        "bases": {"rated_voltage_v": 690.0, "rated_power_va": 1.632e6},
        "power_meaning": "at the PCC",
        "operating_points": [{"op_id": "p065", "active_power_mw": 0.65, "terminal_voltage_pu": 1.0}],
        "configuration": {},
        "plant": {},
    }
    response = FrequencyResponse(F_HZ, y, 50.0, status=status, reason=reason, meta={"op_id": "p065"})
    write_table(tmp_path / "y.parquet", [response], meta)
    monkeypatch.chdir(tmp_path)
    return y


@pytest.mark.parametrize("reader", ["duckdb", "polars", "pandas"])
def test_two_lines_of_each_reader_give_the_rows(y: np.ndarray, reader: str) -> None:
    (code,) = [code for code in snippets("exchange.md", "python") if f"import {reader}\n" in code]
    assert len(code.strip().splitlines()) == 2
    names: dict[str, np.ndarray] = {}
    exec(code, names)
    ok = [0, 1, 3]
    np.testing.assert_array_equal(names["rows"], np.column_stack([F_HZ, y[:, 0, 0].real, y[:, 0, 0].imag])[ok])


def test_the_objects_of_the_page_hold_the_table(y: np.ndarray) -> None:
    (code,) = [code for code in snippets("exchange.md", "python") if "to_control" in code]
    names: dict[str, np.ndarray] = {}
    exec(code, names)
    ok = [0, 1, 3]
    np.testing.assert_array_equal(names["gain"], np.abs(y[ok, 0, 0]))
    np.testing.assert_array_equal(np.asarray(names["y_pp"])[0], y[:, 0, 0])
    assert names["smith"].shape == (3,)


def test_the_manifest_of_the_page_conforms() -> None:
    (example,) = snippets("inject.md", "json")
    assert manifest_violations(json.loads(example)) == []


def test_the_campaign_of_the_page_names_a_device_elsewhere() -> None:
    from seqsweep.sweep.config.sections import Config
    from seqsweep.sweep.playback.inject import Timing, planned

    (section,) = snippets("inject.md", "toml")
    rest = {
        "campaign": {"name": "x"},
        "operating_point": [{"active_power_mw": 40.0, "terminal_voltage_pu": 1.0}],
        "sweep": {"f_hz": [20.0]},
    }
    plan, plant = planned(Config.from_dict({**rest, **tomllib.loads(section)}), Timing())
    assert (plan.f1_hz, plant.rating.voltage_v) == (50.0, 33e3)


def test_every_option_of_the_commands_is_on_its_page() -> None:
    from ..support.commands import command

    for name, page in (("inject", "inject.md"), ("import", "exchange.md"), ("export", "exchange.md")):
        said = command(name, "--help").stdout
        text = (DOCS / page).read_text("utf-8")
        options = set(re.findall(r"(--[a-z][a-z0-9-]+)", said)) - {"--help", "--output", "--force", *OF_ALL}
        assert options
        assert [option for option in sorted(options) if option not in text] == []
