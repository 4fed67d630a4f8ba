"""A device that stands on an ideal source only is refused behind a grid, before anything is driven."""

from __future__ import annotations

import sys

import numpy as np
import pytest

import seqsweep as ss

from ..support.commands import TOP, command

PEER = f"{sys.executable} {TOP / 'tests' / 'support' / 'boxes' / 'peer.py'}"
CAMPAIGN = """
[campaign]
name = "forwards"
[plant]
id = "process:{peer}"
{plant}
[[operating_point]]
id = "p"
active_power_mw = 0.0
{point}
[sweep]
f_hz = [10.0, 120.0]
"""


def step(i, v, dt):
    """An inductive load."""
    i = i + dt / 5e-3 * (v - 2.0 * i)
    return i, i


def device() -> ss.Plant:
    return ss.plant_from_step(step, 0j, dt_s=50e-6, voltage_v=400.0, power_va=10e3, hold="mean")


def test_a_sweep_behind_a_grid_is_refused_with_the_way_out() -> None:
    with pytest.raises(ss.SeqsweepError, match="stands on an ideal source only") as refused:
        ss.sweep(device(), active_power_mw=0.0, f_hz=[10.0, 120.0], grid="0.1+0.5j")
    assert "seqsweep tune" in str(refused.value)
    found = ss.sweep(device(), active_power_mw=0.0, f_hz=[10.0, 120.0])
    assert np.all(found.status == "ok")


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        ({"point": "grid = { r_ohm = 0.1, x_ohm = 0.5 }"}, "operating point 'p' has a grid"),
        ({"plant": '[source]\nkind = "thevenin"\nr_ohm = 0.1\nx_ohm = 0.5'}, "[source] is not ideal"),
    ],
)
def test_a_campaign_that_puts_it_there_is_a_wrong_call(lines: dict, words: str, tmp_path) -> None:
    path = tmp_path / "campaign.toml"
    usual = {"peer": PEER, "plant": "", "point": "terminal_voltage_pu = 1.0"}
    path.write_text(CAMPAIGN.format(**{**usual, **lines}), "utf-8")
    done = command("run", path, "-o", tmp_path / "y.parquet", "--jobs", 1)
    assert done.returncode == 2
    assert words in done.stderr
    assert list(tmp_path.iterdir()) == [path]
