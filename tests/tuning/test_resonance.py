"""Which mode is named as the resonance, and when none is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from seqsweep.identify.fit.model import fit_response
from seqsweep.identify.fit.rational import Omitted
from seqsweep.identify.frames import dq_to_pn
from seqsweep.identify.response import FrequencyResponse
from seqsweep.tuning.feeding import Hole
from seqsweep.tuning.objections import Ruling
from seqsweep.tuning.poles import ClosedLoop, _is_beside_held, _is_told, _resonance, closed_loop, crowded
from seqsweep.tuning.result import why_no_resonance
from seqsweep.tuning.siso import SeriesRL
from seqsweep.tuning.tune import tune_point
from seqsweep.tuning.verdict import _beside

F1_HZ = 50.0
GRID = SeriesRL(0.02, 0.3, F1_HZ)
OPEN = Hole(0.0, 0.0)
"""A hole around f1 in which something is fed."""
META = {"op_id": "a", "stable_on": {"grid": "ideal", "growth_bound_per_s": 0.7, "disturbed_s": 10.0}}


def response(poles: list[complex], nu_hz: np.ndarray) -> FrequencyResponse:
    """Exact rows of a passive branch with small narrow modes, all of rank one."""
    s = 2j * np.pi * nu_hz[:, None, None]
    y = np.eye(2) / (0.5 + s * 1e-3)
    for k, pole in enumerate(poles):
        residue = 0.02 * abs(pole.real) * np.outer([1.0, 0.3j * (k + 1)], [1.0, 0.5 - 0.2j * k])
        y = y + residue / (s - pole) + residue.conj() / (s - pole.conjugate())
    return FrequencyResponse(F1_HZ + nu_hz, dq_to_pn(y), F1_HZ, meta=META)


@pytest.fixture(scope="module")
def loop() -> ClosedLoop:
    """A lightly and a well damped mode."""
    poles = [-2.0 + 150j, -60.0 + 400j]
    found = closed_loop(fit_response(response(poles, np.geomspace(0.5, 900.0, 60))), GRID)
    return replace(found, critical=int(np.argmin(np.abs(found.poles - poles[0]))))


def with_damping(loop: ClosedLoop, zeta: float, std: float) -> ClosedLoop:
    """The loop, its resonance damped by so much and known to this part of itself."""
    poles, covariance = loop.poles.copy(), loop.covariance.copy()
    poles[loop.critical] = 150.0 * complex(-zeta, np.sqrt(1.0 - zeta**2))
    covariance[loop.critical] = (150.0 * std) ** 2 / 2.0 * np.eye(2)
    return replace(loop, poles=poles, covariance=covariance)


@pytest.mark.parametrize(
    ("verdict", "fit", "damping", "std", "is_named"),
    [
        ("stable", "sound", 0.3, 1e-2, True),
        ("stable", "sound", 0.3, 5e-2, False),
        ("stable", "sound", 0.02, 5e-2, True),
        ("undecided", "sound", 0.02, 1e-2, True),
        ("undecided", "sound", 0.3, 1e-5, False),
        ("undecided", "contested", 0.02, 1e-5, True),
        ("undecided", "contested", 0.02, 1e-2, False),
        ("undecided", "denied", 0.02, 1e-5, False),
        ("unstable", "sound", -0.02, 1e-2, True),
        ("unstable", "sound", 0.3, 1e-5, False),  # an aperiodic mode grows: the oscillating one is not what matters
    ],
)
def test_a_mode_is_named_where_the_verdict_leaves_it_its_ground(
    loop: ClosedLoop, verdict: str, fit: str, damping: float, std: float, is_named: bool
) -> None:
    before = with_damping(loop, damping, std)
    after = _beside(Ruling(verdict, "", fit), before)  # type: ignore[arg-type]
    assert (after.critical == before.critical) is is_named
    assert (after.withheld is None) is is_named
    assert (after.resonance_hz is None) is not is_named


def test_a_mode_that_may_grow_hides_none_that_is_known() -> None:
    """Of two modes the data carry the second; the first comes first only where it surely grows, or can be named."""
    model = fit_response(response([-2.0 + 150j], np.geomspace(0.5, 900.0, 40)))
    poles, believed = np.array([0.5 + 60j, -6.0 + 148j]), np.array([True, True])
    second, both, none = np.array([False, True]), np.array([True, True]), np.array([False, False])
    surely = np.array([True, False])
    assert _resonance(model, poles, believed, second, none) == 1
    assert _resonance(model, poles, believed, second, surely) is None
    assert _resonance(model, poles, believed, both, none) == 0


def test_what_is_withheld_is_said() -> None:
    point = tune_point(response([-60.0 + 400j], np.geomspace(0.5, 900.0, 60)), GRID)
    assert point.stability is not None
    found = replace(point.stability.closed_loop, critical=None)
    at = int(np.argmin(np.abs(found.poles - (-60.0 + 400j))))
    below, above = found.pair_hz(at)
    text = why_no_resonance(replace(point.stability, closed_loop=replace(found, withheld=at)))
    assert f"{below:.4g}/{above:.4g} Hz" in text
    assert "not sure enough" in text
    assert "carried by the data" in why_no_resonance(replace(point.stability, closed_loop=found))


def test_several_narrow_modes_in_a_gap_of_the_rows_crowd_it() -> None:
    """Rows from 5 Hz on, and none from 20 to 60 Hz; modes that rows surround crowd nothing."""
    rows = np.concatenate([np.geomspace(5.0, 20.0, 30), np.geomspace(60.0, 900.0, 50)])

    def gaps(*poles: complex) -> list[int]:
        model = fit_response(response(list(poles), rows))
        return np.flatnonzero(crowded(model, OPEN)).tolist()

    assert gaps(-0.6 + 10j, -0.9 + 19j) == [0]
    assert gaps(-1.0 + 200j, -2.0 + 300j) == [30]
    assert gaps(-1.0 + 200j, -0.6 + 80j, -2.0 + 900j) == []


@pytest.mark.parametrize(
    ("ranks", "rows_hz", "noisy", "is_told"),
    [
        ((2, 2), [770.0, 950.0], True, False),  # twenty parameters of two poles, sixteen numbers of two rows
        ((1, 1), [770.0, 950.0], True, True),
        ((2, 1), [770.0, 950.0], True, False),
        ((2, 2), [770.0, 890.0, 950.0], True, True),  # the third is within the mode's width
        ((2, 2), [770.0, 950.0], False, True),  # exact rows tell it from afar
    ],
)
def test_a_mode_among_more_poles_than_its_rows_tell_is_not_named(
    ranks: tuple[int, int], rows_hz: list[float], noisy: bool, is_told: bool
) -> None:
    """A grid turned the place of two device's poles at the end of the rows into a mode that was none."""
    own = 2j * np.pi * np.array([860.0, 930.0]) - 500.0
    exact = fit_response(response([-2.0 + 150j], np.geomspace(0.5, 900.0, 40)))
    model = replace(
        exact,
        poles=np.concatenate([own, own.conj()]),
        ranks=np.array([*ranks, *ranks]),
        nu_hz=np.concatenate([np.geomspace(5.0, 630.0, 20), rows_hz]),
        omitted=Omitted(*np.zeros((4, 0))) if noisy else None,
    )
    assert _is_told(model, -500.0 + 2j * np.pi * 848.0) is is_told


@pytest.mark.parametrize(("real", "held"), [(-1e-3, True), (-0.5, False)])
def test_a_mode_beside_a_pole_that_is_held_at_the_axis_is_not_named(real: float, held: bool) -> None:
    """Two inverters, each with an unstable pair of its own, swept on a grid on which 17 rows do not show them."""
    exact = fit_response(response([-2.0 + 150j], np.geomspace(0.5, 900.0, 40)))
    own = np.array([real + 84.2j])
    model = replace(exact, poles=np.append(own, own.conj()), nu_hz=np.array([9.5, 12.0, 17.0, 26.0]))
    assert _is_beside_held(model, -4.7 + 78.7j) is held
    assert not _is_beside_held(model, -4.7 + 60.0j)
