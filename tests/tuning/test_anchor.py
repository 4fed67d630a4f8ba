"""What disturbed runs prove of a device, and what they leave open."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
import pytest

from seqsweep.identify.frames import dq_to_pn
from seqsweep.identify.response import FrequencyResponse
from seqsweep.tuning.result import PointTuning
from seqsweep.tuning.siso import SeriesRL
from seqsweep.tuning.text import CERTAIN
from seqsweep.tuning.tune import tune_point

F1_HZ = 50.0
GRID = SeriesRL(0.02, 0.1, F1_HZ)


def judged(growth_per_s: float, fact: dict[str, Any], noise: float = 0.0) -> PointTuning:
    """A first-order device with a mode of its own at 8 Hz (dq) that grows so fast, on a grid that hardly moves it."""
    nu = np.geomspace(0.7, 900.0, 80)
    pole, s = growth_per_s + 2j * np.pi * 8.0, 2j * np.pi * nu[:, None, None]
    residue = 0.5 * np.array([[1.0, 0.4], [0.3, 0.1]])
    y = 2.0 / (1.0 + s / 400.0) * np.eye(2) + residue / (s - pole) + residue / (s - pole.conjugate())
    rng = np.random.default_rng(3)
    std = noise * np.linalg.norm(y, axis=(1, 2)) / 2.0
    y = y + std[:, None, None] * (rng.normal(size=y.shape) + 1j * rng.normal(size=y.shape)) / np.sqrt(2.0)
    covariance = np.maximum(std, 1e-9)[:, None, None] ** 2 / 2.0 * np.eye(8)
    meta = {"op_id": "a", "stable_on": {"grid": "ideal", **fact}}
    return tune_point(FrequencyResponse(F1_HZ + nu, dq_to_pn(y), F1_HZ, covariance=covariance, meta=meta), GRID)


SHOTS = {"basis": "shots", "growth_bound_per_s": 0.7, "disturbed_s": 10.0}


@pytest.mark.parametrize(
    ("growth_per_s", "noise"),
    [
        *((0.6, noise) for noise in (0.0, 1e-3, 1e-2)),
        *(
            pytest.param(slower, noise, marks=pytest.mark.evidence)
            for slower in (0.1, 0.3)
            for noise in (0.0, 1e-3, 1e-2)
        ),
    ],
)
def test_a_mode_that_grows_more_slowly_than_the_runs_exclude_is_never_certainly_stable(
    growth_per_s: float, noise: float
) -> None:
    point = judged(growth_per_s, SHOTS, noise)
    assert point.verdict != "stable" or (point.probability or 0.0) < CERTAIN


@pytest.mark.parametrize("noise", [0.0, 1e-3])
@pytest.mark.parametrize("growth_per_s", [-0.3, -0.6, -3.0])
def test_a_slow_mode_that_the_rows_show_to_decay_is_no_doubt(growth_per_s: float, noise: float) -> None:
    assert judged(growth_per_s, SHOTS, noise).verdict == "stable"


def test_the_reason_names_the_mode_that_the_runs_leave_open() -> None:
    point = judged(0.3, SHOTS, 1e-2)
    assert point.verdict == "undecided"
    assert "may as well grow: the runs on an ideal source exclude only what grows faster than 0.7 1/s" in point.reason


def judged_from(
    lowest_hz: float, growth_per_s: float, frequency_hz: float, noise: float, size: float = 0.5
) -> PointTuning:
    """The device with a slow mode, and rows that begin somewhere."""
    nu = np.geomspace(lowest_hz, 900.0, 60)
    pole, s = growth_per_s + 2j * np.pi * frequency_hz, 2j * np.pi * nu[:, None, None]
    residue = size * np.array([[1.0, 0.4], [0.3, 0.1]])
    y = 2.0 / (1.0 + s / 400.0) * np.eye(2) + residue / (s - pole) + residue / (s - pole.conjugate())
    rng = np.random.default_rng(3)
    std = noise * np.linalg.norm(y, axis=(1, 2)) / 2.0
    y = y + std[:, None, None] * (rng.normal(size=y.shape) + 1j * rng.normal(size=y.shape)) / np.sqrt(2.0)
    covariance = std[:, None, None] ** 2 / 2.0 * np.eye(8)
    meta = {"op_id": "a", "stable_on": {"grid": "ideal", **SHOTS}}
    return tune_point(FrequencyResponse(F1_HZ + nu, dq_to_pn(y), F1_HZ, covariance=covariance, meta=meta), GRID)


@pytest.mark.parametrize(("growth_per_s", "frequency_hz"), [(0.5, 0.0), (0.3, 0.7)])
def test_a_fit_held_stable_does_not_hide_that_the_rows_ask_for_a_mode_that_grows(
    growth_per_s: float, frequency_hz: float
) -> None:
    point = judged_from(4.0, growth_per_s, frequency_hz, 1e-3)
    assert point.verdict != "stable" or (point.probability or 0.0) < CERTAIN
    assert point.model is not None
    assert np.all(point.model.poles.real < -0.04)


@pytest.mark.parametrize(("growth_per_s", "frequency_hz"), [(-0.3, 0.0), (-0.3, 0.7)])
def test_a_mode_that_could_grow_far_faster_than_the_runs_let_it_is_no_doubt(
    growth_per_s: float, frequency_hz: float
) -> None:
    assert judged_from(4.0, growth_per_s, frequency_hz, 1e-3).verdict == "stable"


@pytest.mark.parametrize(
    ("lowest_hz", "growth_per_s", "frequency_hz"), [(4.0, 0.6, 0.7), (12.0, 0.3, 8.0), (12.0, 0.1, 3.0)]
)
def test_exact_rows_tell_of_a_mode_that_grows_though_a_fit_that_is_held_meets_them(
    lowest_hz: float, growth_per_s: float, frequency_hz: float
) -> None:
    """To its floor, with poles on the wrong side and others that make up for them: once "stable", with certainty."""
    assert judged_from(lowest_hz, growth_per_s, frequency_hz, 0.0).verdict == "undecided"


@pytest.mark.parametrize("frequency_hz", [3.0, 8.0])
def test_a_hole_does_not_make_a_mode_that_grows_pass_for_a_quicker_one(frequency_hz: float) -> None:
    """Rows from 12 Hz on take it for one that decays faster than the runs exclude, and do not know how fast."""
    point = judged_from(12.0, 0.6, frequency_hz, 1e-3)
    assert (point.probability or 0.0) < CERTAIN


def test_a_row_that_was_left_out_may_be_a_mode_that_grows() -> None:
    """Narrower than the distance of the rows, it shows in one alone: an error, or the device's own instability."""
    point = judged_from(1.0, 0.3, 8.0, 1e-2, 0.05)
    assert point.model is not None
    assert any("was left out of the fit" in note for note in point.model.notes)
    assert (point.probability or 0.0) < CERTAIN


@pytest.mark.parametrize("lowest_hz", [1.0, 4.0])
@pytest.mark.parametrize("frequency_hz", [0.0, 0.7, 8.0])
def test_exact_rows_tell_of_a_mode_that_decays(lowest_hz: float, frequency_hz: float) -> None:
    point = judged_from(lowest_hz, -0.3, frequency_hz, 0.0)
    assert "may as well grow" not in point.reason


@pytest.mark.evidence
def test_what_rows_show_to_grow_slowly_is_never_certainly_stable() -> None:
    """216 devices; where the mode is nowhere twice as large as a row's noise, nothing tells of it."""
    asked = product((0.5, 0.05), (1.0, 4.0, 12.0), (0.1, 0.3, 0.6), (0.0, 0.7, 3.0, 8.0), (0.0, 1e-3, 1e-2))
    certain = [a for a in asked if _is_certainly_stable(*a)]
    shown = [a for a in certain if not _is_drowned(*a)]
    print(f"of 216 devices that grow more slowly than 0.7 1/s {len(certain)} are stable with certainty")
    print(f"of them rows show the mode of {len(shown)}: {shown}")
    assert len(shown) == 0


def _is_certainly_stable(size: float, lowest_hz: float, growth_per_s: float, frequency_hz: float, noise: float) -> bool:
    point = judged_from(lowest_hz, growth_per_s, frequency_hz, noise, size)
    return point.verdict == "stable" and (point.probability or 0.0) > CERTAIN


def _is_drowned(size: float, lowest_hz: float, growth_per_s: float, frequency_hz: float, noise: float) -> bool:
    """Whether the mode's part of every row is below twice the row's noise."""
    s = 2j * np.pi * np.geomspace(lowest_hz, 900.0, 60)
    part = 1.12 * size / np.abs(s - growth_per_s - 2j * np.pi * frequency_hz)  # 1.12: norm of the residue
    return bool(np.all(part < 2.0 * noise * np.abs(2.0 * np.sqrt(2.0) / (1.0 + s / 400.0))))
