"""What the rows themselves do not show, so that no verdict from them is certain, however small the errors of the fit.

A probability from standard errors speaks of the modes that the fit has. A mode of the device beyond the end of the
band, in a wide gap of the rows or around f1 has no standard error. Where the rows cover the question nothing of this
kind can change the verdict; where they do not, `ALLOWANCE` is kept for it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..identify.fit.order import NARROWEST
from ..identify.fit.rational import RationalModel, evaluate
from .feeding import ACTIVE, FAR_HZ, LOUD, QUIET, REACH_HZ, activity
from .poles import ClosedLoop, is_swept, mode_weight
from .rows import Rows
from .siso import Grid, Impedance
from .unseen import DENSE, Unseen, mutual_impedance, unseen

ALLOWANCE = 0.005
"""How likely a verdict is wrong for what its rows cannot show: a judgement. Counted: 18 of 2,494 verdicts on tables
that do not cover the question, all but one for modes that no row shows at all (docs/how-often-wrong.md)."""

KEPT = 3e-3
"""Part of itself by which Y of a device may differ on another grid, as that of a sampled one does."""

_FAINT = 0.1  # loop gain of all rows below which a mode between them matters only if it is ten times what they show
_NEAR_HZ = 2.0  # rows that begin no further from f1 leave room for slow modes only, which the fit follows
_SLIGHT = 2.0 * NARROWEST  # loop gain below which not even the peak of the narrowest mode further out reaches one
_SPARE = 3  # rows for each pole from which on a fit would need a further one for what a gap hides
_SURELY = 4.0  # standard errors of its real part from which on an unstable mode is there
_BETWEEN = np.linspace(0.0, 1.0, 9)  # places in a gap


class Seen(NamedTuple):
    """What a verdict rests on.

    Attributes
    ----------
    model, loop : RationalModel, ClosedLoop
        The fit, and its poles on the grid that is judged.
    rows : Rows
        The rows.
    grids : sequence of Impedance
        What the device is connected to and, if there is one, the grid on which the device was seen to be stable.
    by_rows : int or None
        Unstable modes as the rows count them.
    crowded : (n,) bool
        Gaps of the rows, each below its row, that hold several modes of the device.
    """

    model: RationalModel
    loop: ClosedLoop
    rows: Rows
    grids: Sequence[Impedance]
    by_rows: int | None
    crowded: np.ndarray


def asked_if_stable(seen: Seen) -> tuple[Unseen | None, str]:
    """What may hide between the rows of a loop that the fit calls stable, and why that verdict is not certain."""
    hidden = unseen(seen.model, seen.rows.data, seen.grids, seen.crowded)
    faint = passed_over(seen, hidden)
    return (None if faint else hidden), uncovered_stable(seen) or faint


def uncovered_stable(seen: Seen) -> str:
    """Why rows do not cover the question whether a loop is stable, and what to measure; empty where they do.

    A stable verdict may be wrong wherever a mode can hide, and next to the edge.
    """
    questions = (_ends_early, _begins_far, _leaves_gaps, _tells_no_more, _is_near, _is_counted_twice)
    return next((why for why in (ask(seen) for ask in questions) if why), "")


def uncovered_unstable(seen: Seen, grid: Grid) -> str:
    """The same of an unstable loop, which is proven by a mode that surely grows and that rows surround."""
    return _is_vague(seen, grid) or _is_counted_twice(seen)


def passed_over(seen: Seen, hidden: Unseen | None) -> str:
    """Why a mode that may hide between the rows withholds no verdict, but its certainty; empty where it does.

    Where the loop gain of all rows is that small, such a mode has to be ten times as large as all that they show.
    """
    nu_hz, y = seen.rows.data.nu_hz, seen.rows.data.y
    if hidden is None or not hidden.is_shown or nu_hz[0] > FAR_HZ or np.max(_gain(seen, nu_hz, y)) > _FAINT:
        return ""
    place = f"{seen.model.f1_hz - hidden.nu_hz:.4g}/{seen.model.f1_hz + hidden.nu_hz:.4g} Hz"
    return (
        f"the rows around {place} {'do not exclude' if hidden.in_gap else 'ask for'} a mode narrower than their "
        f"distance, though the loop gain of all rows is below {_FAINT:g}: measure more points there"
    )


def stated(probability: float, why: str) -> float:
    """The probability of being stable as it is stated where rows do not cover the question for the reason ``why``."""
    return float(np.clip(probability, ALLOWANCE, 1.0 - ALLOWANCE)) if why else probability


def _ends_early(seen: Seen) -> str:
    """Above the band a loop whose gain is not small may do anything, unless the band is long and the device passive.

    A band that ends where a converter still has modes tells nothing of them, passive or not: one of them that is
    lightly damped has a peak many times as high as what the last rows show.
    """
    end = float(seen.model.nu_hz[-1])
    last = seen.rows.data.nu_hz >= end / DENSE
    nu_hz, y = seen.rows.data.nu_hz[last], seen.rows.data.y[last]
    fitted = evaluate(seen.model, 2j * np.pi * nu_hz)
    passive = np.maximum(activity(y), activity(fitted)) < -ACTIVE
    gain = _gain(seen, nu_hz, fitted)
    is_fed, is_short = bool(np.any((gain > QUIET) & ~passive)), end < REACH_HZ and np.max(gain) > _SLIGHT
    if not is_fed and not is_short:
        return ""
    what = "is not clearly passive" if is_fed else "may become active further out"
    return (
        f"the sweep ends at |f - f1| = {end:.4g} Hz, where the loop gain is above {QUIET if is_fed else _SLIGHT:g} and "
        f"the device {what}: sweep to higher frequencies"
    )


def _begins_far(seen: Seen) -> str:
    """Around f1 slow modes are followed by the fit; the loops of a converter are not."""
    lowest = float(seen.model.nu_hz[0])
    hole = np.linspace(0.0, lowest, len(_BETWEEN))
    loud = bool(np.any(_gain(seen, hole, evaluate(seen.model, 2j * np.pi * hole)) > LOUD))
    if lowest <= _NEAR_HZ or (lowest <= FAR_HZ and not loud):
        return ""
    return f"the lowest |f - f1| in the table is {lowest:.3g} Hz: sweep nearer to f1"


def _leaves_gaps(seen: Seen) -> str:
    """Between rows further apart than the modes around them are wide, where the loop may be fed."""
    nu = seen.model.nu_hz
    for k in np.flatnonzero(nu[1:] > DENSE * nu[:-1]):
        low, high = float(nu[k]), float(nu[k + 1])
        if _may_feed(seen, low, high, bool(seen.crowded[k + 1])):
            between = f"{seen.model.f1_hz + low:.4g} and {seen.model.f1_hz + high:.4g} Hz"
            return f"there are no rows between {between} (mirror images count): sweep there"
    return ""


def _may_feed(seen: Seen, low_hz: float, high_hz: float, crowded: bool) -> bool:
    """Whether a mode could hide between two rows that feeds an oscillation.

    Where rows are many beside the poles of the fit, only where the loop gain is not small, the gap is wider than the
    modes around it, and it is none of slow modes, which the fit follows.
    """
    model = seen.model
    at = low_hz + (high_hz - low_hz) * _BETWEEN
    y = evaluate(model, 2j * np.pi * at)
    gain = _gain(seen, at, y)
    loud, fed = np.any(gain > LOUD), np.any((activity(y) > -ACTIVE) & (gain > QUIET))
    if crowded or len(model.nu_hz) < _SPARE * model.order:
        return bool(loud or fed)
    modes = np.concatenate([model.poles, seen.loop.poles])
    width_hz = np.abs(1j * np.pi * (low_hz + high_hz) - modes).min(initial=np.inf) / (2.0 * np.pi)
    return bool(loud and high_hz - low_hz > width_hz and high_hz > FAR_HZ)


def _tells_no_more(seen: Seen) -> str:
    """A fit of as many poles as the rows tell apart may have too few."""
    n, order = len(seen.model.nu_hz), seen.model.order
    most = (n - 1) // 2
    if order + 2 <= most:
        return ""
    return f"{n} rows tell no more than {max(most, order)} poles apart, and the fit takes {order}: sweep more points"


def _is_near(seen: Seen) -> str:
    """So near to the edge that what Y of a device keeps from one grid to another decides."""
    model, grid = seen.model, seen.grids[0]
    modes_hz = np.abs(seen.loop.poles.imag) / (2.0 * np.pi)
    nu_hz = np.concatenate([model.nu_hz, modes_hz[(modes_hz > model.nu_hz[0]) & (modes_hz < model.nu_hz[-1])]])
    s = 2j * np.pi * nu_hz
    nearness = mutual_impedance(model, grid, s) * np.linalg.norm(evaluate(model, s), 2, axis=(1, 2))
    nearest = int(np.argmax(nearness))
    if nearness[nearest] * KEPT < 1.0:
        return ""
    place = f"{model.f1_hz - nu_hz[nearest]:.4g}/{model.f1_hz + nu_hz[nearest]:.4g} Hz"
    return f"a change of Y by {1.0 / nearness[nearest]:.1g} of itself at {place} decides: sweep it on this very grid"


def _is_vague(seen: Seen, grid: Grid) -> str:
    """No unstable mode that rows surround surely grows."""
    loop = seen.loop
    surely = np.flatnonzero((loop.poles.real > _SURELY * loop.std.real) & ~loop.beyond)
    poles = loop.poles[[k for k in surely if is_swept(seen.model, complex(loop.poles[k]))]]
    if not len(poles):
        return "no rows surround an unstable mode that surely grows: sweep more points around it"
    weight = np.linalg.norm(mode_weight(seen.model, grid, poles), axis=(1, 2))
    moved = KEPT * weight * np.linalg.norm(evaluate(seen.model, 1j * poles.imag), 2, axis=(1, 2))
    if np.any(poles.real > moved):
        return ""
    return f"a change of Y by less than {KEPT:.1%} of itself stops the growth: sweep it on this very grid"


def _is_counted_twice(seen: Seen) -> str:
    """Rows and fit count differently, though errors of the rows explain it."""
    if seen.by_rows is None or seen.by_rows == seen.loop.n_unstable:
        return ""
    return (
        f"the rows, followed from one to the next, count {seen.by_rows} unstable modes, the fit "
        f"{seen.loop.n_unstable}, which their errors explain: sweep more points, or more periods"
    )


def _gain(seen: Seen, nu_hz: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Largest loop gain (n,) at |f - f1| on any of the grids."""
    s = 2j * np.pi * nu_hz
    return np.max([np.abs(np.linalg.eigvals(y @ grid.impedance_dq(s))).max(axis=1) for grid in seen.grids], axis=0)
