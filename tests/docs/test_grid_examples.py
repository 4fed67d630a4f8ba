"""The grids of the page on grids: each opens, is judged, and the two ways of giving the same grid agree."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from seqsweep.identify.response import FrequencyResponse
from seqsweep.sweep.config.sections import load_config
from seqsweep.tuning.bank.entries import bank_of
from seqsweep.tuning.bank.judgement import judge_pair
from seqsweep.tuning.grids.open import open_grid
from seqsweep.tuning.tune import Device, fitted
from tests.support import oracle

GRIDS = Path(__file__).parents[2] / "examples" / "grids"
NU = np.geomspace(0.4, 1950.0, 100)


@pytest.fixture(scope="module")
def device() -> Device:
    y = oracle.admittance_pn(50.0 + NU, 0.65e6, 690.0)
    meta = {"op_id": "p065", "stable_on": {"grid": "ideal", "basis": "stated"}}
    return fitted(FrequencyResponse(50.0 + NU, y, 50.0, meta=meta))


def test_the_scan_is_the_network_it_was_taken_from(device: Device) -> None:
    exact, scanned = (open_grid(str(GRIDS / name), 50.0) for name in ("compensated.toml", "scan.csv"))
    s = 2j * np.pi * np.geomspace(3.0, 1500.0, 200)
    apart = np.abs(scanned.impedance_dq(s) / exact.impedance_dq(s) - 1.0)
    assert np.median(apart) < 1e-5
    verdicts = [judge_pair(device, bank_of(GRIDS / name)[0], {}) for name in ("compensated.toml", "scan.csv")]
    assert [v.verdict for v in verdicts] == ["stable", "stable"]
    assert verdicts[0].re_rad_s == pytest.approx(verdicts[1].re_rad_s, abs=1e-4)


def test_regions_and_family_are_judged(device: Device) -> None:
    assert judge_pair(device, bank_of(GRIDS / "loci.toml")[0], {}).verdict == "stable"
    family = bank_of(GRIDS / "family.toml")
    assert len(family) == 400
    assert judge_pair(device, family[0], {}).verdict == "unstable"
    assert judge_pair(device, family[-1], {}).verdict == "stable"


def test_the_campaign_of_the_page_can_be_read() -> None:
    assert len(load_config(GRIDS / "powers.toml", ()).operating_point) == 6
