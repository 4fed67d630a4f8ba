"""A verdict is certain only where the rows cover the question: what they do not show has no standard error."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from seqsweep.identify.frames import dq_to_pn
from seqsweep.identify.response import FrequencyResponse
from seqsweep.tuning.poles import closed_loop
from seqsweep.tuning.probability import DECIDED
from seqsweep.tuning.result import PointTuning
from seqsweep.tuning.siso import SeriesRL
from seqsweep.tuning.text import CERTAIN
from seqsweep.tuning.tune import fitted, tune_point
from seqsweep.tuning.uncovered import ALLOWANCE, Seen, passed_over, stated
from seqsweep.tuning.unseen import Unseen

F1_HZ = 50.0
MODE = -3.0 + 2j * np.pi * 160.0
RESIDUE = np.exp(2.2j) * np.array([[0.5, 0.5j], [-0.5j, 0.5]])
"""Of a mode that couples to one sequence."""
GRID = SeriesRL(0.02, 0.3, F1_HZ)
ALL = np.geomspace(0.5, 1500.0, 120)


def device(nu_hz: np.ndarray, size: float) -> np.ndarray:
    """An inductive device that is a little active, with a narrow mode at 160 Hz (dq): (n, 2, 2) in S."""
    s = 2j * np.pi * nu_hz[:, None, None]
    base = np.array([[2.0, -1.0], [1.0, -0.05]]) / (1.0 + s / 300.0)
    above = np.eye(2) * 0.4 * s / (s + 4000.0) / (1.0 + s / 1e5)
    mode = RESIDUE / (s - MODE) + RESIDUE.conj() / (s - MODE.conjugate())
    return base + above + size * mode


def passive_but_for(modes: list[complex], nu_hz: np.ndarray, size: float) -> np.ndarray:
    """A passive inductive device with a conductance beside it, and modes of one size that may be fed: (n, 2, 2)."""
    s = 2j * np.pi * nu_hz[:, None, None]
    base = np.array([[2.0, -1.0], [1.0, 1.5]]) / (1.0 + s / 300.0) + 0.3 * np.eye(2) / (1.0 + s / 1e5)
    return base + sum(size * (RESIDUE / (s - p) + RESIDUE.conj() / (s - p.conjugate())) for p in modes)


def table(nu_hz: np.ndarray, size: float, noise: float, seed: int) -> FrequencyResponse:
    return table_of(nu_hz, device(nu_hz, size), noise, seed)


def table_of(nu_hz: np.ndarray, y: np.ndarray, noise: float, seed: int) -> FrequencyResponse:
    """Rows above f1 with white noise of known covariance; the device rests on an ideal source."""
    rng = np.random.default_rng(seed)
    std = noise * np.linalg.norm(y, axis=(1, 2)) / 2.0
    y = y + std[:, None, None] * (rng.normal(size=y.shape) + 1j * rng.normal(size=y.shape)) / np.sqrt(2.0)
    meta = {"op_id": "a", "stable_on": {"grid": "ideal", "growth_bound_per_s": 0.7, "disturbed_s": 10.0}}
    covariance = std[:, None, None] ** 2 / 2.0 * np.eye(8)
    return FrequencyResponse(F1_HZ + nu_hz, dq_to_pn(y), F1_HZ, covariance=covariance, meta=meta)


def judged(nu_hz: np.ndarray, size: float, noise: float = 1e-4, seed: int = 0) -> PointTuning:
    return tune_point(table(nu_hz, size, noise, seed), GRID)


def unstable_poles(size: float) -> int:
    return unstable_poles_of(lambda nu_hz: device(nu_hz, size), GRID)


def unstable_poles_of(admittance: Callable[[np.ndarray], np.ndarray], grid: SeriesRL) -> int:
    """By counting the turns of det(1 + Y Z) on a locus of half a million points, the device itself being stable."""
    nu = np.unique(np.concatenate([np.linspace(0.0, 400.0, 500001), np.geomspace(400.0, 1e8, 4000)]))
    locus = np.linalg.det(np.eye(2) + admittance(nu) @ grid.impedance_dq(2j * np.pi * nu))
    return -round(float(np.sum(np.angle(locus[1:] / locus[:-1]))) / np.pi)


def is_certain(point: PointTuning) -> bool:
    assert point.probability is not None
    return point.verdict != "undecided" and not 1.0 - CERTAIN < point.probability < CERTAIN


@pytest.mark.parametrize("size", [20.0, *(pytest.param(s, marks=pytest.mark.evidence) for s in (5.0, 60.0))])
def test_a_mode_beyond_a_band_cut_short_is_never_overruled_with_certainty(size: float) -> None:
    """Up to 66 Hz nothing shows the mode at 160 Hz, and the device is a little active where the rows end."""
    assert unstable_poles(size) == 2
    for seed in range(3):
        short = judged(ALL[ALL < 66.0], size, seed=seed)
        assert not is_certain(short)
        assert short.stability is not None
        assert "sweep to higher frequencies" in short.stability.uncovered
    whole = judged(ALL, size)
    assert whole.verdict == "unstable"
    assert is_certain(whole)


@pytest.mark.parametrize(("size", "unstable"), [(1.0, 0), (3.0, 2), (10.0, 4)])
def test_one_pole_in_a_wide_hole_around_f1_does_not_stand_for_two(size: float, unstable: int) -> None:
    """Modes 1.5 and 15.5 Hz from f1, rows from 49 Hz on, in which both are one pole; once that was called stable."""
    modes = [-0.75 + 2j * np.pi * 1.5, -2.4 + 2j * np.pi * 15.5]
    assert unstable_poles_of(lambda nu_hz: passive_but_for(modes, nu_hz, size), GRID) == unstable
    nu_hz = np.linspace(49.0, 1950.0, 19)
    point = tune_point(table_of(nu_hz, passive_but_for(modes, nu_hz, size), 1e-5, 0), GRID)
    assert point.verdict == "undecided"
    assert "the rows around f1" in point.reason


def test_passivity_where_the_band_ends_closes_it_with_certainty_only_beyond_a_converters_modes() -> None:
    """A mode at 350 Hz that the grid feeds, and rows up to 100 Hz, all passive, with a loop gain of 0.1."""
    grid, modes = GRID.scaled(0.1), [-3.0 + 2j * np.pi * 350.0]
    for size, unstable in ((0.0, 0), (60.0, 2)):
        assert unstable_poles_of(lambda nu_hz, size=size: passive_but_for(modes, nu_hz, size), grid) == unstable
        short, whole = (
            tune_point(table_of(nu_hz, passive_but_for(modes, nu_hz, size), 1e-4, 0), grid)
            for nu_hz in (ALL[ALL < 100.0], ALL)
        )
        assert (short.verdict, is_certain(short)) == ("stable", False)
        assert short.stability is not None
        assert "may become active further out" in short.stability.uncovered
        assert (whole.verdict, is_certain(whole)) == ("unstable" if unstable else "stable", True)


def test_a_device_that_clearly_feeds_oscillations_where_a_short_band_ends_is_not_called_stable() -> None:
    """The activity of a hold is small or far out; a negative conductance at its size is neither."""
    for highest_hz, verdict in ((200.0, "undecided"), (1500.0, "stable")):
        nu_hz = ALL[highest_hz > ALL]
        y = np.array([[0.3, 0.0], [0.0, -0.27]]) / (1.0 + 2j * np.pi * nu_hz[:, None, None] / 3000.0)
        point = tune_point(table_of(nu_hz, y, 1e-5, 0), GRID)
        assert point.verdict == verdict, point.reason
        assert ("clearly feeds oscillations" in point.reason) == (verdict == "undecided")


def test_rows_that_cover_the_question_keep_their_certainty() -> None:
    assert unstable_poles(1.0) == 0
    point = judged(ALL, 1.0)
    assert point.verdict == "stable"
    assert is_certain(point)
    assert not any("not certain" in text for text in point.warnings)


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        (ALL[ALL > 8.0], "the lowest |f - f1| in the table is 8.44 Hz"),
        (ALL[(ALL < 20.0) | (ALL > 200.0)], "there are no rows between"),
        (np.geomspace(0.5, 1500.0, 14), "there are no rows between"),
    ],
)
def test_what_is_missing_is_said_once_and_the_verdict_stays(rows: np.ndarray, words: str) -> None:
    point = judged(rows, 0.0, noise=1e-6)
    assert (point.verdict, is_certain(point)) == ("stable", False)
    (said,) = [text for text in point.warnings if "not certain" in text]
    assert words in said


def test_the_allowance_takes_certainty_and_no_verdict() -> None:
    assert [stated(p, "why") for p in (0.0, 0.3, 1.0)] == [ALLOWANCE, 0.3, 1.0 - ALLOWANCE]
    assert [stated(p, "") for p in (0.0, 0.3, 1.0)] == [0.0, 0.3, 1.0]
    assert 1.0 - CERTAIN < ALLOWANCE < 1.0 - DECIDED


@pytest.mark.parametrize(
    ("scale", "lowest_hz", "is_passed"), [(0.02, 0.5, True), (1.0, 0.5, False), (0.02, 6.0, False)]
)
def test_a_mode_that_would_have_to_be_huge_withholds_no_verdict(
    scale: float, lowest_hz: float, is_passed: bool
) -> None:
    """Ten times what all rows show; where they begin far from f1 they show too little to say so."""
    device, grid = fitted(table(ALL[lowest_hz <= ALL], 0.0, 1e-4, 0)), GRID.scaled(scale)
    assert device.model is not None
    assert device.rows is not None
    crowded = np.zeros(len(device.model.nu_hz), dtype=bool)
    seen = Seen(device.model, closed_loop(device.model, grid), device.rows, (grid,), 0, crowded)
    strongest = np.abs(np.linalg.eigvals(device.rows.data.y @ grid.impedance_dq(2j * np.pi * device.rows.data.nu_hz)))
    assert (float(strongest.max()) < 0.1) == (scale < 1.0)
    why = passed_over(seen, Unseen(30.0, 0.0, in_gap=True))
    assert bool(why) == is_passed
    assert passed_over(seen, None) == passed_over(seen, Unseen(30.0, -100.0, in_gap=True)) == ""


@pytest.mark.parametrize("x_ohm", [0.3, 1e-6])
def test_a_device_without_a_pole_is_judged_on_a_grid_without_one(x_ohm: float) -> None:
    """A resistance; behind next to no reactance the loop has no finite pole either, and once it ended in a fault."""
    nu_hz = np.geomspace(1.0, 1000.0, 8)
    y = np.tile(0.01 * np.eye(2, dtype=complex), (8, 1, 1))
    point = tune_point(FrequencyResponse(F1_HZ + nu_hz, y, F1_HZ, meta={"op_id": "a"}), SeriesRL(1.0, x_ohm, F1_HZ))
    assert point.verdict == "stable"
