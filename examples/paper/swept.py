"""The paper's Sections II and III from real sweeps: every operating point on the grid it belongs to."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import NamedTuple

import numpy as np

from seqsweep.identify.fit.rational import evaluate_pn
from seqsweep.sweep.config.sections import Config
from seqsweep.sweep.confirm import margin_with, sweep_with_damping
from seqsweep.tuning.gain import GainSearch, search_gain
from seqsweep.tuning.result import PointTuning
from seqsweep.tuning.siso import SeriesRL, Siso, siso
from seqsweep.tuning.tune import tune_point

Z_GRID = SeriesRL(0.012, 0.25, 50.0)
"""The line of Table I (ohm)."""

SCR_1_8 = 0.648
"""Multiple of `Z_GRID` at which the reference turbine has a short-circuit ratio of 1.8."""

F_HZ = [50.0 + nu for nu in (1.0, 1.5, *np.unique(np.round(np.geomspace(2.0, 950.0, 44))).tolist())]
"""Swept frequencies (Hz): above f1 alone, for injections at the mirror 2 f1 - f serve the other side as well."""

K_PAPER, F_R_PAPER_HZ = 0.5, 77.0
MARGIN = 1.4


class Case(NamedTuple):
    """One sweep: power (MW), multiple of the line, damping gain and the frequency it is set to (Hz)."""

    power_mw: float
    scale: float
    k: float = 0.0
    f_r_hz: float = F_R_PAPER_HZ


class Study(NamedTuple):
    """Every swept case, and the gain that holds m = 1.4 at 0.65 MW on 1.4 Z."""

    points: dict[Case, PointTuning]
    search: GainSearch
    f_r_hz: float

    def point(self, power_mw: float, scale: float, k: float = 0.0) -> PointTuning:
        """The case of this power, grid and gain; k may be that of the search."""
        return next(p for case, p in self.points.items() if case[:3] == (power_mw, scale, k))


GRIDS = [Case(0.65, scale) for scale in (1.0, 1.2, 1.4)]
POWERS = [Case(0.60, 1.4), Case(0.70, 1.4)]
SCENARIO = Case(1.1, SCR_1_8 * 1.375)
SCRS = [Case(1.1, SCR_1_8 * 1.1), Case(1.1, SCR_1_8 * 1.25), Case(1.1, SCR_1_8 * 1.8 / 1.3)]
RESHAPED = [Case(power_mw, 1.4, K_PAPER) for power_mw in (0.60, 0.65, 0.70)]


def study(workers: int = 2) -> Study:
    """Sweep and judge everything, in ``workers`` processes."""
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        searching = pool.submit(tuned_gain, 0.65, 1.4, MARGIN)
        cases = [*GRIDS, *RESHAPED, *POWERS, *SCRS, SCENARIO]
        points = dict(zip(cases, pool.map(judged, cases), strict=True))
        search, f_r_hz = searching.result()
        tuned = [Case(power_mw, 1.4, search.k, f_r_hz) for power_mw in (0.60, 0.65, 0.70)]
        stiff = [SCENARIO._replace(k=k, f_r_hz=f_r_of(points[SCENARIO])) for k in (search.k, 2.0)]
        points |= dict(zip([*tuned, *stiff], pool.map(judged, [*tuned, *stiff]), strict=True))
    return Study(points, search, f_r_hz)


def judged(case: Case) -> PointTuning:
    """Sweep one case with its damping control in place, fit it and judge it on its grid."""
    grid = Z_GRID.scaled(case.scale)
    response = sweep_with_damping(campaign(case), "paper", grid, case.k, case.f_r_hz, jobs=1)
    return tune_point(response, grid, margin=MARGIN)


def tuned_gain(power_mw: float, scale: float, margin: float) -> tuple[GainSearch, float]:
    """The gain at which the re-swept device holds ``margin``, and the frequency it is set to (Hz)."""
    case, grid = Case(power_mw, scale), Z_GRID.scaled(scale)
    point = judged(case)
    assert point.k is not None
    f_r_hz = f_r_of(point)
    config = campaign(case)
    return search_gain(lambda k: margin_with(config, "paper", grid, k, f_r_hz, jobs=1), margin, point.k), f_r_hz


def campaign(case: Case) -> Config:
    """The sweep of Table I's turbine at the |v_pcc| that belongs to the case's grid and 690 V behind it."""
    grid = {"r_ohm": Z_GRID.r_ohm, "x_ohm": Z_GRID.x_ohm, "scale": case.scale}
    return Config.from_dict(
        {
            "campaign": {"name": "paper"},
            "plant": {"id": "dpmsg-v1"},
            "operating_point": [{"id": "paper", "active_power_mw": case.power_mw, "grid": grid}],
            "sweep": {"f_hz": F_HZ},
        }
    )


# What is read from a judged case


def f_r_of(point: PointTuning) -> float:
    """Frequency of the stronger resonance component (Hz)."""
    assert point.f_r_hz is not None
    return point.f_r_hz


def mode_of(point: PointTuning) -> tuple[complex, float]:
    """The paper's resonance (rad/s, dq) and its damping ratio: the least damped mode from 5 Hz to f1.

    The notch of the damping control has a mode of its own at 2 f1, less damped than what it damps; the paper's
    figures are about the other one.
    """
    assert point.stability is not None
    loop = point.stability.closed_loop
    among = np.flatnonzero((loop.f_hz > 5.0) & (loop.f_hz < loop.f1_hz) & ~loop.beyond)
    k = int(among[np.argmin(loop.damping[among])])
    return complex(loop.poles[k]), float(loop.damping[k])


def moved_poles(point: PointTuning) -> np.ndarray:
    """Closed-loop poles (rad/s, dq) but for those that stay where the device's own are: the grid does not see them."""
    assert point.model is not None
    assert point.stability is not None
    poles = point.stability.closed_loop.poles
    distance = np.abs(poles[:, None] - point.model.poles[None, :]).min(axis=1)
    return poles[distance > 1e-2 * np.abs(poles)]


def pair_of(point: PointTuning) -> tuple[float, float]:
    """The mode in phase quantities (Hz)."""
    assert point.stability is not None
    f1_hz, nu_hz = point.stability.closed_loop.f1_hz, mode_of(point)[0].imag / (2.0 * np.pi)
    return f1_hz - nu_hz, f1_hz + nu_hz


def crossing_of(point: PointTuning) -> tuple[float, float]:
    """Frequency (Hz) and m of the critical Bode crossing; NaN where there is none."""
    found = point.critical_crossing
    return (np.nan, np.nan) if found is None else (found.f_hz, found.m)


def siso_of(point: PointTuning, scale: float, f_hz: np.ndarray) -> Siso:
    """The SISO equivalents of the fitted sweep on ``scale`` times the line."""
    assert point.model is not None
    return siso(f_hz, evaluate_pn(point.model, f_hz), Z_GRID.scaled(scale))
