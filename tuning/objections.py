"""What may be held against a verdict: each objection in the words of the reason, or empty where there is none."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from ..identify.fit.model import MAX_ORDER
from ..identify.fit.rational import RationalModel, evaluate
from ..identify.uncertainty import NORMAL_95
from . import near_f1
from .anchor import Anchor, OpenMode
from .feeding import ACTIVE, LOUD, QUIET, REACH_HZ, activity, is_fed
from .poles import EDGE, RESONANCE_DAMPING, ClosedLoop, is_beyond, is_swept, mode_weight, unstable_on
from .probability import DECIDED, DECIDED_AT, Doubt
from .remedy import advice_on_grid, grid_is_to_blame, remedy
from .rows import Rows, difference, misfits
from .siso import Grid, Impedance
from .unseen import Unseen, overruled
from .winding import Winding

LIGHTLY_DAMPED = 0.05
"""Damping ratio below which a mode must lie inside the swept band to be believed."""

_CLEARLY = 0.3  # part of Y that feeds a wave from which on a device surely does, its hold and delay aside
_TREND = 1.3  # the turn of the loop gain at the band's end is read over this ratio of frequencies
_UNEXPLAINED, _ROUGH = 2.0, 1e-3  # misfits in standard errors and relative to Y that no longer describe the rows
_EXACT = 1e-6  # misfit relative to Y of a fit that meets the rows
_BETWEEN_ROWS = 0.1  # part of itself to which Y is known at best where rows are far apart
_DEEP = 8.0  # how many times nearer to f1 than all rows a mode is out of reach
_FAR = 3.0  # a turn that would take so many times the band to reach -1 does not reach it
_THE_SAME = 1.0 - 1e-6  # an impedance at f1 that is smaller by less, as by rounding, is the same
_SLOW_LOOPS_HZ = 20.0  # |f - f1| within which the loops of power, synchronisation and voltage of converters act

Decision = Literal["stable", "unstable", "undecided"]
Standing = Literal["sound", "contested", "denied"]


@dataclass(frozen=True, slots=True)
class Case:
    """Everything a verdict may rest on."""

    model: RationalModel
    grid: Grid
    loop: ClosedLoop
    winding: Winding
    doubt: Doubt
    rows: Rows | None
    anchor: Anchor | None
    by_rows: int | None
    hidden: Unseen | None
    still_open: OpenMode | None

    @property
    def stable(self) -> bool:
        """What the fit says."""
        return self.winding.number == self.model.n_unstable

    @property
    def turns(self) -> str:
        """The count in words."""
        return f"winding number {self.winding.number}, open-loop unstable poles {self.model.n_unstable}"


class Ruling(NamedTuple):
    """The verdict, why, and what that leaves of the fit: nothing is held against it, somebody counts differently, or it
    is shown to be wrong."""

    verdict: Decision
    reason: str
    fit: Standing = "sound"


def decide(case: Case) -> Ruling:
    """The first objection that holds, or the verdict if none does."""
    objections: tuple[tuple[Callable[[Case], str], Standing], ...] = (
        (_untraced, "denied"),
        (_unfounded, "denied"),
        (_unproved, "contested"),
        (_miscounted, "denied"),
        (_too_few_rows, "contested"),
        (_open_end, "sound"),
        (_judges_disagree, "contested"),
        (_swept_grid_denies, "denied"),
        (_left_out_row_denies, "sound"),
        (_may_have_been_held, "sound"),
        (_may_hide, "sound"),
        (_may_grow, "sound"),
        (_improbable, "sound"),
        (_unswept, "sound"),
        (_grid_unmeasured, "sound"),
    )
    for objection, fit in objections:
        reason = objection(case)
        if reason:
            return Ruling("undecided", reason, fit)
    if case.stable:
        return Ruling("stable", case.turns)
    return Ruling("unstable", f"{case.turns}; {_mode_text(case)}")


def _untraced(case: Case) -> str:
    return "" if case.winding.trusted else f"the locus could not be traced to the end ({case.turns})"


def _unfounded(case: Case) -> str:
    """What experiment says cannot be, given the rows."""
    return "" if case.anchor is None else case.anchor.problem


def _unproved(case: Case) -> str:
    """The count of the device's own unstable poles is what the fit made of it."""
    model, anchor = case.model, case.anchor
    if anchor is None or anchor.n_unstable is not None or model.n_unstable == 0:
        return ""
    return (
        f"the fit has {model.n_unstable} unstable poles of the device's own, and nothing proves or excludes them: "
        "the table does not say on which grid the device was stable. Say it: --stable-on ideal, or --stable-on "
        "R+jX for the grid it was measured on"
    )


def _miscounted(case: Case) -> str:
    """The count of the device's own unstable poles is not what experiment says."""
    return "" if case.anchor is None else said_of_count(case.model, case.anchor)


def said_of_count(model: RationalModel, anchor: Anchor) -> str:
    """What withholds a verdict where a fit has another number of unstable poles of the device's own than was proved."""
    if anchor.n_unstable is None:
        return ""
    far = model.poles[(model.poles.real > 0.0) & is_beyond(model, model.poles)]
    if len(far):
        return (
            f"the fit has an unstable pole of the device's own {abs(far[0]) / (2.0 * np.pi):.4g} Hz from f1, and the "
            f"rows, which end at {model.nu_hz[-1]:.4g} Hz, do not tell it: sweep to higher frequencies, or more points"
        )
    if model.n_unstable == anchor.n_unstable:
        return ""
    return (
        f"the device was stable on {anchor.where}, which takes {anchor.n_unstable} unstable poles of its own, and "
        f"the fit finds {model.n_unstable}: sweep more points"
    )


def _too_few_rows(case: Case) -> str:
    """The order of the fit ended where the rows ran out, and they are not described."""
    model = case.model
    if _is_the_devices_own(case) or (case.stable and not (case.hidden is not None and case.hidden.is_shown)):
        return ""
    most = min(MAX_ORDER, (len(model.nu_hz) - 1) // 2)
    unexplained = model.weighting != "covariance" or model.residual > _UNEXPLAINED
    if (
        case.rows is None
        or model.order + 2 <= most
        or not unexplained
        or np.median(misfits(case.rows.data, model)) < _ROUGH
    ):
        return ""
    return (
        f"{len(model.nu_hz)} rows tell no more than {max(most, model.order)} poles apart, and the device has more: the "
        "fit leaves more than noise unexplained; sweep more points"
    )


def _is_the_devices_own(case: Case) -> bool:
    """Whether an instability is that which the device was proved to have, on a grid too strong to change it.

    Where the loop gain is small from f1 to the band's end, device and grid have as many unstable modes as the device.
    """
    own = 0 if case.anchor is None else case.anchor.n_unstable or 0
    if case.stable or own == 0 or case.loop.n_unstable != own:
        return False
    s = 2j * np.pi * case.winding.nu_hz[np.abs(case.winding.nu_hz) <= case.model.nu_hz[-1]]
    gain = np.linalg.eigvals(evaluate(case.model, s) @ case.grid.impedance_dq(s))
    return bool(np.max(np.abs(gain)) < LOUD)


def _open_end(case: Case) -> str:
    """Above the band a loop that is active and whose gain is above one may do anything."""
    if not case.stable:
        return ""
    still_active = said_of_end(case.model, case.grid)
    if still_active:
        return still_active
    mode = _mode_above(case)
    return "" if mode is None else f"a mode at {mode}, above the swept band, may be unstable: sweep there"


def said_of_end(model: RationalModel, grid: Impedance) -> str:
    """What withholds a stable verdict at the end of the rows of a device; empty where it cannot oscillate beyond."""
    at_end = f"the sweep ends at |f - f1| = {model.nu_hz[-1]:.4g} Hz"
    if _active_at_end(model, grid):
        return f"{at_end}, where the device is still active and the loop gain above one: sweep to higher frequencies"
    if _feeds_at_short_end(model, grid):
        return (
            f"{at_end}, where the device clearly feeds oscillations, and may have modes further out: sweep to higher "
            "frequencies"
        )
    return ""


def _mode_above(case: Case) -> str | None:
    """A mode that the fit sees above the band and that decides: surely unstable, or near to it if the device is active.

    A device clearly active at the band's end feeds what is just above it.
    """
    model, loop = case.model, case.loop
    reach_hz = max(_FAR * model.nu_hz[-1], REACH_HZ)
    above = (loop.f_hz > EDGE * model.nu_hz[-1]) & (np.abs(loop.poles) < 2.0 * np.pi * reach_hz)
    doubtful = loop.poles.real > 3.0 * loop.std.real
    if _activity_at_end(model) > _CLEARLY:
        doubtful |= (loop.damping < RESONANCE_DAMPING) & ~loop.beyond
    found = np.flatnonzero(above & doubtful)
    return _place(model, float(loop.f_hz[found[0]])) if len(found) else None


def _judges_disagree(case: Case) -> str:
    """Poles, locus and rows have to count the same unstable modes."""
    by_poles, by_locus = case.loop.n_unstable, case.model.n_unstable - case.winding.number
    if by_poles != by_locus and by_locus == case.by_rows == _unstable_anywhere(case.loop):
        return ""
    if by_poles != by_locus:
        return f"locus and poles disagree ({case.turns}, {by_poles} unstable closed-loop poles)"
    if case.rows is None or case.by_rows is None or case.by_rows == by_poles or _is_exact(case.rows, case.model):
        return ""
    at = difference(case.rows, case.model, case.grid)
    if at.in_noise:
        return ""
    return (
        f"the rows, followed from one to the next, count {case.by_rows} unstable modes, the fit {by_poles}; they "
        f"differ most near {_place(case.model, at.nu_hz)}: measure more points there"
    )


def _unstable_anywhere(loop: ClosedLoop) -> int:
    """Poles in the right half-plane, also those that are not believed: a real one may be as wide as the band, and turn
    the locus within it."""
    return int(np.sum(loop.poles.real > 0.0) + np.sum((loop.poles.real > 0.0) & (loop.poles.imag > 0.0)))


def _is_exact(rows: Rows, model: RationalModel) -> bool:
    """Whether the fit meets every row, with half as many parameters as numbers: eight rows tell no more than that."""
    overdetermined = len(model.covariance_root) <= rows.data.y.size
    return bool(overdetermined and np.all(misfits(rows.data, model) < _EXACT))


def _swept_grid_denies(case: Case) -> str:
    """On the grid the table was swept on the fit has to be as stable as the device was seen to be."""
    return "" if case.anchor is None else said_of_swept_grid(case.model, case.anchor)


def said_of_swept_grid(model: RationalModel, anchor: Anchor) -> str:
    """What withholds a verdict where a fit is unstable on the grid on which the device was seen to be stable."""
    unstable = np.zeros(0) if anchor.grid is None else unstable_on(model, anchor.grid)
    if len(unstable) == 0:
        return ""
    worst = unstable[np.argmax(unstable.real)]
    return (
        f"the fit is unstable on {anchor.where}, where the device was seen to be stable, near "
        f"{_place(model, abs(worst.imag) / (2.0 * np.pi))}: measure more points there"
    )


def _left_out_row_denies(case: Case) -> str:
    """A row that does not agree with its neighbours is an error or a mode; only another one beside it can tell."""
    if case.rows is None or case.rows.left_out is None or not case.stable:
        return ""
    nu_hz = overruled(case.model, case.rows.left_out, case.grid)
    if nu_hz is None:
        return ""
    return (
        f"the row at {_place(case.model, nu_hz)} does not agree with its neighbours and was left out; if it is right, "
        "it decides: measure it again, and more points beside it"
    )


def _may_hide(case: Case) -> str:
    """A mode narrower than the distance of the rows would make the loop unstable."""
    return said_of_hidden(case.model, case.hidden)


def said_of_hidden(model: RationalModel, hidden: Unseen | None) -> str:
    """What a mode between the rows of a device withholds; empty where they exclude it, or do not ask for it."""
    if hidden is None or not hidden.is_shown:
        return ""
    what = "do not exclude" if hidden.in_gap else "ask for"
    return (
        f"the rows around {_place(model, hidden.nu_hz)} {what} a mode narrower than their distance, which would make "
        "the loop unstable: measure more points there"
    )


def _may_grow(case: Case) -> str:
    """A slow mode of the device's own that the disturbed runs leave open, and the rows too."""
    return "" if case.anchor is None else said_of_open(case.model, case.anchor, case.still_open)


def said_of_open(model: RationalModel, anchor: Anchor, mode: OpenMode | None) -> str:
    """What a slow mode of a device's own withholds that may as well grow; empty where it surely decays."""
    if mode is None or mode.decays >= DECIDED:
        return ""
    return (
        f"the device's own mode at {_place(model, abs(mode.pole.imag) / (2.0 * np.pi))} grows by "
        f"{mode.pole.real:.2g} +- {NORMAL_95 * mode.std_per_s:.2g} 1/s (below zero it decays), so that it may as well "
        f"grow: the runs on {anchor.where} exclude only what grows faster than {anchor.growth_bound_per_s:.2g} 1/s. "
        "Longer runs, or more points near it, would tell"
    )


def _may_have_been_held(case: Case) -> str:
    """The grid on which the device rested may have held a mode of its own that no row comes near and a stiffer grid
    lets go."""
    if not case.stable or case.anchor is None:
        return ""
    return said_of_held(case.model, case.anchor, abs(case.grid.at_f1))


def said_of_held(model: RationalModel, anchor: Anchor, size_ohm: float) -> str:
    """The same of a device on whatever shows it an impedance of that size at f1."""
    lowest = float(model.nu_hz[0])
    if anchor.grid is None or lowest <= _SLOW_LOOPS_HZ or size_ohm > _THE_SAME * abs(anchor.grid.at_f1):
        return ""
    return (
        f"the device was seen to be stable on {anchor.where}, which may have held a mode that grows by itself on a "
        f"stiffer grid; the lowest |f - f1| in the table is {lowest:.3g} Hz: sweep nearer to f1"
    )


def _improbable(case: Case) -> str:
    """Too near the edge for what is known of Y."""
    at = case.doubt
    if not 1.0 - DECIDED < at.probability < DECIDED:
        return ""
    return (
        f"the loop is stable with a probability of {at.probability:.1%}; what is missing are more or better points "
        f"near {_place(case.model, at.nu_hz)}: {_advice(case)}"
    )


def _unswept(case: Case) -> str:
    """Modes that decide need rows around them."""
    loop, decisive = case.loop, _decisive(case)
    hidden = _hidden_in_hole(case)
    if hidden:
        return hidden
    unseen = [k for k in decisive if not _is_known(case, complex(loop.poles[k]))]
    unseen = [k for k in unseen if _may_cross(case, complex(loop.poles[k]))]
    if not unseen or (not case.stable and len(unseen) < len(decisive)) or _is_the_devices_own(case):
        return ""
    return (
        f"a mode at {_place(case.model, float(loop.f_hz[unseen[0]]))} decides, and the table has no usable rows around "
        "it: sweep there"
    )


def _may_cross(case: Case, pole: complex) -> bool:
    """Whether a mode that no rows surround may be on the other side of the axis than the fit has it."""
    if pole.real > 0.0 or is_fed_around(case.model, case.grid, pole.imag / (2.0 * np.pi)):
        return True
    size = np.linalg.norm(evaluate(case.model, np.array([1j * pole.imag]))[0], 2)
    moved = np.linalg.norm(mode_weight(case.model, case.grid, np.array([pole]))[0]) * size
    return bool(_BETWEEN_ROWS * moved > -pole.real)


def _grid_unmeasured(case: Case) -> str:
    """Modes that decide need rows of the grid around them, too, where it is a table."""
    loop, decisive = case.loop, _decisive(case)
    wanted = {k: case.grid.missing_rows(*_place_and_width(complex(loop.poles[k]))) for k in decisive}
    missing = [(k, band) for k, band in wanted.items() if band is not None]
    if not missing or (not case.stable and len(missing) < len(decisive)):
        return ""
    k, (low, high) = missing[0]
    return (
        f"a mode at {_place(case.model, float(loop.f_hz[k]))} decides, and the grid was not measured from {low:.4g} to "
        f"{high:.4g} Hz: scan it there"
    )


def _place_and_width(pole: complex) -> tuple[float, float]:
    """|f - f1| and half width of a mode (Hz)."""
    return abs(pole.imag) / (2.0 * np.pi), abs(pole.real) / (2.0 * np.pi)


def _hidden_in_hole(case: Case) -> str:
    """A slow mode far nearer to f1 than all rows, and narrower than its distance from them, is only guessed at."""
    if case.loop.hole.start_hz > 0.0 or not case.stable:
        return ""
    return said_of_hole(case.model, case.loop.poles, lambda pole: _is_held(case, pole))


def said_of_hole(model: RationalModel, loop_poles: np.ndarray, is_held: Callable[[complex], bool]) -> str:
    """What withholds a stable verdict where oscillations can be fed around f1; empty where no slow mode is guessed at.

    ``is_held`` says of a closed-loop pole (rad/s) nearer to f1 than every row whether it is known on which side it is.
    """
    lowest = float(model.nu_hz[0])
    own, loop = (np.abs(poles) * _DEEP < 2.0 * np.pi * lowest for poles in (model.poles, loop_poles))
    placed = all(near_f1.placed(model, int(k)) for k in np.flatnonzero(own))
    if placed and all(is_held(complex(pole)) for pole in loop_poles[loop]):
        return ""
    return f"slow modes decide, and the lowest |f - f1| in the table is {lowest:.3g} Hz: sweep nearer to f1"


def _is_known(case: Case, pole: complex) -> bool:
    """Whether rows surround a mode, or hold it on its side of the axis though it is nearer to f1 than all of them."""
    return is_swept(case.model, pole) or _is_held(case, pole)


def _is_held(case: Case, pole: complex) -> bool:
    is_near = abs(pole) < 2.0 * np.pi * case.model.nu_hz[0]
    return bool(is_near and case.rows is not None and near_f1.held(case.model, case.rows.data, case.grid, pole))


def _mode_text(case: Case) -> str:
    """The unstable mode that grows fastest, in words."""
    loop = case.loop
    decisive = _decisive(case)
    unstable = [k for k in decisive if _is_known(case, complex(loop.poles[k]))] or decisive
    pole = complex(loop.poles[unstable[0]])
    if pole.imag == 0.0:
        return f"an aperiodic mode grows at {pole.real:+.3g} rad/s"
    place = _place(case.model, float(loop.f_hz[unstable[0]]))
    return f"the mode at {place} grows at {pole.real:+.3g} rad/s (damping {100.0 * loop.damping[unstable[0]]:.1f} %)"


def _advice(case: Case) -> str:
    """Which rows, and how many times the periods, would bring the locus as far from zero as a verdict asks."""
    model, poles = case.model, case.loop.poles
    if grid_is_to_blame(model, case.grid, case.doubt):
        return advice_on_grid(model, case.doubt)
    nearest = complex(poles[np.argmin(np.abs(poles - 2j * np.pi * case.doubt.nu_hz))])
    found = remedy(model, case.grid, nearest, (case.doubt.distance / DECIDED_AT) ** 2)
    if found is None:
        return "the loop is so close to the edge that no affordable number of periods decides"
    low, high = (model.f1_hz + nu for nu in found.nu_hz)
    where = f"{low:.4g} to {high:.4g} Hz" if high > low else f"{low:.4g} Hz"
    return f"about {found.times} times the periods at {where} (mirror images count) would decide"


def _place(model: RationalModel, nu_hz: float) -> str:
    """A frequency of the dq frame as the pair seen in phase quantities."""
    if nu_hz < model.nu_hz[0]:
        return f"f1 (|f - f1| below {model.nu_hz[0]:.2g} Hz)"
    return f"{model.f1_hz - nu_hz:.4g}/{model.f1_hz + nu_hz:.4g} Hz"


def _decisive(case: Case) -> list[int]:
    """Modes the verdict hangs on: the unstable ones, or the resonance and everything lightly damped."""
    loop = case.loop
    if not case.stable:
        grows = loop.poles.real > 0.0
        return [int(k) for k in np.flatnonzero(grows if np.all(loop.beyond[grows]) else grows & ~loop.beyond)]
    within = loop.f_hz < EDGE * case.model.nu_hz[-1]
    light = np.flatnonzero((loop.damping < LIGHTLY_DAMPED) & within).tolist()
    return sorted({*light, *([] if loop.leading is None else [loop.leading])})


def is_fed_around(model: RationalModel, grid: Impedance, nu_hz: float) -> bool:
    """Whether an oscillation could be fed in the gap between rows that holds ``nu_hz``."""
    rows = np.concatenate([[0.0], model.nu_hz, [EDGE * nu_hz]])
    above = int(np.clip(np.searchsorted(rows, nu_hz), 1, len(rows) - 1))
    s = 2j * np.pi * np.linspace(rows[above - 1], rows[above], 9)
    return is_fed(evaluate(model, s), grid.impedance_dq(s))


def _active_at_end(model: RationalModel, grid: Impedance) -> bool:
    """Whether the device may still bring a loop to oscillate above the swept band: not passive, gain above one.

    Unless the loop gain turns so slowly, as by the delay of half a step, that -1 is many times the band away.
    """
    end = float(model.nu_hz[-1])
    s = 2j * np.pi * end * np.array([1.0 / _TREND, 1.0])
    before, gains = np.linalg.eigvals(evaluate(model, s) @ grid.impedance_dq(s))
    turning = any(_reaches_minus_one(gain, before) for gain in gains if abs(gain) > 1.0)
    return bool(turning and _activity_at_end(model) > ACTIVE)


def _feeds_at_short_end(model: RationalModel, grid: Impedance) -> bool:
    """Whether a band ends where a converter still has modes, on a device that clearly feeds whatever lies out there."""
    end = float(model.nu_hz[-1])
    s = 2j * np.pi * model.nu_hz[-1:]
    gain = np.abs(np.linalg.eigvals(evaluate(model, s) @ grid.impedance_dq(s))).max()
    return bool(end < REACH_HZ and gain > QUIET and _activity_at_end(model) > _CLEARLY)


def _activity_at_end(model: RationalModel) -> float:
    """Part of Y at the band's end that feeds a wave."""
    return float(activity(evaluate(model, 2j * np.pi * model.nu_hz[-1:]))[0])


def _reaches_minus_one(gain: complex, before: np.ndarray) -> bool:
    """Whether a loop gain turning on as it did since `_TREND` times lower frequency comes to -1 within `_FAR` bands."""
    earlier = before[np.argmin(np.abs(before - gain))]
    turn = np.angle(gain / earlier) * np.sign(np.angle(gain))  # towards -1 where positive, in 1 - 1/_TREND of the band
    left = np.pi - abs(np.angle(gain))
    return bool(left < np.pi / 4.0 or turn / (1.0 - 1.0 / _TREND) * (_FAR - 1.0) > left)
