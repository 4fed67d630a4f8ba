"""Stable, unstable or undecided: two judges who have to agree, and the reason where they do not.

One counts the turns of det(1 + Y Z) from the rows themselves, relative to what the disturbed runs proved (`rows`). The
other counts the closed-loop poles of the rational fit, whose own poles are held by the same proof (`poles`). How sure
the fit is follows from its covariance (`probability`). The Bode criterion is shown beside them (`crossings`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..identify.fit.rational import RationalModel, evaluate_pn
from .anchor import Anchor
from .crossings import Crossing, bode_crossings, critical_crossing
from .objections import Case, Decision, Ruling, decide
from .poles import LIGHT, ClosedLoop, closed_loop, crowded
from .probability import doubt
from .rows import Rows, wind_rows
from .siso import Grid, check_fundamental, impedance_pn, siso
from .uncovered import Seen, asked_if_stable, stated, uncovered_unstable
from .winding import Winding, about, refine_locus, wind

_PLACED = 0.03  # a well damped mode is named if its place is known to this part of itself
_SHARP = 1e-3  # a mode of a contested fit is named if its place is known to this part of itself,
_TOLD = 0.1  # and its real part to this part of itself, or of `_SHARP` of the mode where it is next to the axis


@dataclass(frozen=True, slots=True)
class Stability:
    """The judgement of one operating point on one grid.

    Attributes
    ----------
    verdict : "stable", "unstable" or "undecided"
        By the winding number.
    reason : str
        Why, in one sentence.
    probability : float
        Probability that the loop is stable: how many standard errors the locus keeps from zero inside the band, or how
        surely a slow mode of the device's own decays, times the probability that no mode which the rows do not exclude
        changes that; never certain where the rows do not cover the question.
    winding : Winding
        The locus.
    n_open_loop_unstable : int
        Right-half-plane poles of the device alone.
    n_unstable_by_rows : int or None
        Unstable modes of device and grid as the rows count them; None where they were not asked.
    closed_loop : ClosedLoop
        Poles of device and grid.
    crossings : tuple of Crossing
        Every 180-degree crossing inside the swept band, ascending in frequency.
    critical : Crossing or None
        Crossing of Y1 above f1 with the smallest m.
    bode_stable : bool
        What the plain Bode criterion says: no crossing with m < 1.
    bode_note : str
        Where and why it disagrees with the winding number; empty where it does not.
    extrapolation : str
        The part of the answer that rests on the fit outside the swept band.
    uncovered : str
        Why a verdict is not certain however small the errors, and what to measure; empty where nothing is missing.
    """

    verdict: Decision
    reason: str
    probability: float
    winding: Winding
    n_open_loop_unstable: int
    n_unstable_by_rows: int | None
    closed_loop: ClosedLoop
    crossings: tuple[Crossing, ...]
    critical: Crossing | None
    bode_stable: bool
    bode_note: str
    extrapolation: str
    uncovered: str = ""

    @property
    def remarks(self) -> tuple[str, ...]:
        """What the reader should know of the verdict besides its reason."""
        why = self.uncovered
        return (f"{self.verdict}, but not certain, however small the errors: {why}",) if why else ()


def judge(model: RationalModel, grid: Grid, rows: Rows | None = None, anchor: Anchor | None = None) -> Stability:
    """Verdict of a fitted device on a grid.

    Parameters
    ----------
    model : RationalModel
        The fit.
    grid : Grid
        The grid.
    rows : Rows or None
        The rows themselves, for the second judge; None: the fit alone is asked.
    anchor : Anchor or None
        What is proved of the device; None: the fit is believed about the device's own poles.

    Raises
    ------
    SeqsweepError
        If the fundamental of the model is not the grid's.
    """
    check_fundamental(model.f1_hz, grid)
    loop = closed_loop(model, grid)
    winding = wind(model, grid, loop)
    stable = model.n_unstable == winding.number
    crossings = bode_crossings(lambda f: evaluate_pn(model, f), grid, *swept_band(model))
    doubtful = doubt(model, grid, loop, winding.nu_hz, stable)
    by_rows = None if rows is None else _own_modes(model, anchor) - wind_rows(rows, grid, model, loop.hole).number
    seen_on = () if anchor is None or anchor.grid is None else (anchor.grid,)
    hidden, why = None, ""
    if rows is not None:
        seen = Seen(model, loop, rows, (grid, *seen_on), by_rows, crowded(model, loop.hole))
        hidden, why = asked_if_stable(seen) if stable else (None, uncovered_unstable(seen, grid))
    still_open = anchor.still_open if stable and anchor is not None else None
    ruling = decide(Case(model, grid, loop, winding, doubtful, rows, anchor, by_rows, hidden, still_open))
    harmless = 1.0 if hidden is None else hidden.harmless
    probability = doubtful.probability * harmless
    if still_open is not None:  # the slow mode that is open and one that rows do not exclude may be the same
        probability = min(doubtful.probability, still_open.decays, harmless)
    return Stability(
        verdict=ruling.verdict,
        reason=ruling.reason,
        probability=stated(probability, why),
        winding=winding,
        n_open_loop_unstable=model.n_unstable,
        n_unstable_by_rows=by_rows,
        closed_loop=_beside(ruling, loop),
        crossings=crossings,
        critical=critical_crossing(crossings, model.f1_hz),
        bode_stable=all(c.m >= 1.0 for c in crossings),
        bode_note=_bode_note(model, grid, crossings, stable),
        extrapolation=_extrapolation(model, winding),
        uncovered="" if ruling.verdict == "undecided" else why,
    )


def _own_modes(model: RationalModel, anchor: Anchor | None) -> int:
    """Unstable poles of the device alone: as proved, or where nothing is, as fitted."""
    return model.n_unstable if anchor is None or anchor.n_unstable is None else anchor.n_unstable


def _beside(ruling: Ruling, loop: ClosedLoop) -> ClosedLoop:
    """The closed loop without its resonance where the verdict takes the ground from under it.

    A well damped mode is the least sure of all: the fit of another order has it elsewhere. Beside a stable verdict it
    has to be placed; where no verdict is given, or an aperiodic mode makes the loop unstable, it is not what matters.
    Where the fit is contested, a mode has to be known sharply, place and damping; where it is denied, none is.
    """
    k = loop.critical
    if k is None:
        return loop
    vague, is_light = abs(loop.std[k]) / abs(loop.poles[k]), loop.damping[k] <= LIGHT
    if ruling.verdict == "stable":
        is_named = is_light or vague < _PLACED
    else:
        told = loop.std[k].real < _TOLD * max(abs(loop.poles[k].real), _SHARP * abs(loop.poles[k]))
        is_named = is_light and (ruling.fit == "sound" or (ruling.fit == "contested" and vague < _SHARP and bool(told)))
    return loop if is_named else replace(loop, critical=None, withheld=k)


def swept_band(model: RationalModel) -> tuple[float, float]:
    """Positive frequencies (Hz) the table answers for, mirror images included: f1 -+ the highest |f - f1|."""
    highest = float(model.nu_hz[-1])
    return max(model.f1_hz - highest, 1e-3 * model.f1_hz), model.f1_hz + highest


# The Bode criterion beside it ---------------------------------------------------------------------------------------


def _bode_note(model: RationalModel, grid: Grid, crossings: tuple[Crossing, ...], stable: bool) -> str:
    alarms = [c for c in crossings if c.m < 1.0]
    if stable and alarms:
        text = ", ".join(f"Y{c.component} at {c.f_hz:.4g} Hz (m = {c.m:.2f})" for c in alarms)
        own = _own_poles(model, grid)
        return (
            f"The Bode criterion alarms on {text}, the winding number does not, and it decides: below f1 an "
            f"equivalent may have unstable poles of its own (here {own}, where 1 + Ynn Zg2 = 0), and then stability "
            "asks for 180 degrees with |Y| > |Yg|."
        )
    if not stable and not alarms:
        return (
            "The Bode criterion finds no 180-degree crossing with |Y| > |Yg| inside the swept band, but the winding "
            "number counts unstable closed-loop poles, and it decides."
        )
    return ""


def _own_poles(model: RationalModel, grid: Grid) -> int:
    """Right-half-plane poles of Y1, the zeros of 1 + Ynn Zg2; Y2, its mirror image, has as many."""
    end = float(model.nu_hz[-1])

    def first(nu_hz: np.ndarray) -> np.ndarray:
        within = np.clip(nu_hz, -end, end)
        f = within + model.f1_hz
        y = evaluate_pn(model, f)
        gain = y[:, 1, 1] / siso(f, y, grid).yg2 if grid.couples else y[:, 1, 1] * impedance_pn(grid, f)[1]
        return 1.0 + gain * end / np.maximum(np.abs(nu_hz), end)

    seeds = np.concatenate([about(model.poles), model.nu_hz, end * np.geomspace(1.0, 1e4, 25)])
    nu = np.unique(np.concatenate([-seeds, [0.0], seeds]))
    _, values = refine_locus(first, nu)
    turns = float(np.sum(np.angle(np.append(values[1:], values[0]) / values))) / (2.0 * np.pi)
    return model.n_unstable - round(turns)


def _extrapolation(model: RationalModel, winding: Winding) -> str:
    return (
        f"Swept: |f - f1| from {model.nu_hz[0]:.3g} to {model.nu_hz[-1]:.4g} Hz. Below, the answer rests on the fit: "
        f"the locus turns {winding.inside_deg:+.0f} degrees there. Above, the loop gain is let fall off: the locus "
        f"turns {winding.beyond_deg:+.0f} degrees above until the ends meet."
    )
