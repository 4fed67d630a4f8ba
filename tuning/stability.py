"""Stable, unstable or undecided: the winding number decides, the Bode criterion is shown beside it.

Stable iff the locus of det(1 + Y Z) over f = -inf ... inf winds about zero, counter-clockwise, as often as the
device has poles of its own in the right half-plane. The locus is evaluated on the rational fit; how sure it is that
it passes zero on this side follows from the fit's covariance.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import erfc, sqrt
from typing import Literal, NamedTuple

import numpy as np

from ..identify.fit.rational import RationalModel, evaluate, evaluate_pn, spread
from .poles import ClosedLoop, closed_loop
from .remedy import remedy
from .siso import Grid, check_fundamental, impedance_dq, impedance_pn, siso

MAX_STEP_DEG = 30.0
"""A locus is refined until no step turns further than this."""

DECIDED = 0.99
"""Probability from which on a verdict is given."""

_DECIDED_AT = 2.326  # standard errors that make it so

LIGHTLY_DAMPED = 0.05
"""Damping ratio below which a mode must lie inside the swept band to be believed."""

_GAP = 1.6  # neighbouring |f - f1| further apart than this ratio leave a gap, unless the mode is wider than it
_EDGE = 1.05  # a mode this far beyond the band's end still counts as swept
_MAX_POINTS = 20000

Decision = Literal["stable", "unstable", "undecided"]
Admittance = Callable[[np.ndarray], np.ndarray]


class Crossing(NamedTuple):
    """Where Y1/Yg1 (component 1) or Y2/Yg2 (component 2) passes 180 degrees.

    Attributes
    ----------
    component : 1 or 2
        SISO equivalent.
    f_hz : float
        Frequency of the first component (Hz).
    m : float
        Magnitude margin |Yg / Y|; below one the plain Bode criterion alarms.
    rising : bool
        True if the phase of Y/Yg rises through 180 degrees.
    """

    component: int
    f_hz: float
    m: float
    rising: bool


@dataclass(frozen=True, slots=True)
class Winding:
    """The locus and what it did.

    Attributes
    ----------
    number : int
        Counter-clockwise turns about zero, the ends closed by the fit.
    number_shortest : int
        The same with the ends closed the shortest way: from the highest swept frequency on, no eigenvalue of Y Zg is
        taken to pass -1. It differs where the fit's asymptotes alone turn the locus about zero.
    nu_hz : (n,) float
        Frequencies in the dq frame (Hz), refined.
    locus : (n,) complex
        det(1 + Y Z), the grid's own poles on the axis taken out, divided by a stable factor of its degree.
    largest_step_deg : float
        Largest turn between neighbours, the closing step included (degrees).
    beyond_deg, inside_deg : float
        Turn above the highest and below the lowest swept |f - f1|, positive-frequency half (degrees).
    """

    number: int
    number_shortest: int
    nu_hz: np.ndarray
    locus: np.ndarray
    largest_step_deg: float
    beyond_deg: float
    inside_deg: float

    @property
    def trusted(self) -> bool:
        """Whether the refinement came to its end."""
        return self.largest_step_deg <= MAX_STEP_DEG


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
        Probability that the loop is stable: how many standard errors the locus keeps from zero inside the band.
    winding : Winding
        The locus.
    n_open_loop_unstable : int
        Right-half-plane poles of the device alone.
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
    """

    verdict: Decision
    reason: str
    probability: float
    winding: Winding
    n_open_loop_unstable: int
    closed_loop: ClosedLoop
    crossings: tuple[Crossing, ...]
    critical: Crossing | None
    bode_stable: bool
    bode_note: str
    extrapolation: str


def judge(model: RationalModel, grid: Grid) -> Stability:
    """Verdict of a fitted device on a grid.

    Raises
    ------
    SeqsweepError
        If the fundamental of the model is not the grid's.
    """
    check_fundamental(model.f1_hz, grid)
    loop = closed_loop(model, grid)
    winding = wind(model, grid, loop)
    crossings = bode_crossings(lambda f: evaluate_pn(model, f), grid, *swept_band(model))
    number = _believed_number(model, grid, winding)
    doubtful = doubt(model, grid, loop, winding.nu_hz, number == model.n_unstable)
    verdict, reason = _decide(model, grid, loop, winding, doubtful)
    bode_stable = all(c.m >= 1.0 for c in crossings)
    return Stability(
        verdict=verdict,
        reason=reason,
        probability=doubtful.probability,
        winding=winding,
        n_open_loop_unstable=model.n_unstable,
        closed_loop=loop,
        crossings=crossings,
        critical=critical_crossing(crossings, model.f1_hz),
        bode_stable=bode_stable,
        bode_note=_bode_note(model, grid, crossings, number == model.n_unstable),
        extrapolation=_extrapolation(model, winding),
    )


def swept_band(model: RationalModel) -> tuple[float, float]:
    """Positive frequencies (Hz) the table answers for, mirror images included: f1 -+ the highest |f - f1|."""
    highest = float(model.nu_hz[-1])
    return max(model.f1_hz - highest, 1e-3 * model.f1_hz), model.f1_hz + highest


# The Bode criterion ------------------------------------------------------------------------------------------------


def bode_crossings(admittance: Admittance, grid: Grid, f_min_hz: float, f_max_hz: float) -> tuple[Crossing, ...]:
    """Every frequency in a band at which Y1/Yg1 or Y2/Yg2 is real and negative.

    Parameters
    ----------
    admittance : callable
        Frequencies (n,) in Hz to Ypn (n, 2, 2) in S.
    grid : Grid
        The grid.
    f_min_hz, f_max_hz : float
        Positive band (Hz).

    Notes
    -----
    The paper's criterion, Section II-B: |Y| > |Yg| at a phase difference of 180 degrees means instability.
    """
    f = _bode_grid(grid.f1_hz, f_min_hz, f_max_hz)
    ratios = _ratios(admittance, grid, f)
    found = [c for component in (0, 1) for c in _crossings_of(admittance, grid, component, f, ratios[component])]
    return tuple(sorted(found, key=lambda c: c.f_hz))


def critical_crossing(crossings: tuple[Crossing, ...], f1_hz: float) -> Crossing | None:
    """Crossing of Y1 above f1 with the smallest m; that of Y2 below f1 is its mirror image. None if there is none."""
    return min((c for c in crossings if c.component == 1 and c.f_hz > f1_hz), key=lambda c: c.m, default=None)


def _bode_grid(f1_hz: float, f_min_hz: float, f_max_hz: float) -> np.ndarray:
    """Logarithmic over the band, and logarithmic in the distance from f1 on both sides."""
    distance = np.logspace(-2.0, np.log10(max(f_max_hz - f1_hz, f1_hz)), 300)
    f = np.concatenate([np.geomspace(f_min_hz, f_max_hz, 300), f1_hz - distance, f1_hz + distance])
    return np.unique(f[(f >= f_min_hz) & (f <= f_max_hz)])


def _ratios(admittance: Admittance, grid: Grid, f_hz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Y1/Yg1 = Y1 Zg1 and Y2/Yg2 = Y2 Zg2."""
    pair = siso(f_hz, admittance(f_hz), grid)
    z1, z2 = impedance_pn(grid, f_hz)
    return pair.y1 * z1, pair.y2 * z2


def _crossings_of(
    admittance: Admittance, grid: Grid, component: int, f_hz: np.ndarray, ratio: np.ndarray
) -> list[Crossing]:
    found = []
    for k in np.flatnonzero(np.diff(np.signbit(ratio.imag)) & (np.minimum(ratio.real[1:], ratio.real[:-1]) < 0.0)):
        f, q = f_hz[k : k + 2], ratio[k : k + 2]
        for _ in range(2):  # twice 32 parts and a straight line: 1e-7 of the first bracket
            f = np.linspace(f[0], f[-1], 33)
            q = _ratios(admittance, grid, f)[component]
            j = int(np.flatnonzero(np.diff(np.signbit(q.imag)))[0])
            f, q = f[j : j + 2], q[j : j + 2]
        part = q.imag[0] / (q.imag[0] - q.imag[1])
        at = q.real[0] + part * (q.real[1] - q.real[0])
        if at < 0.0 and np.abs(q).max() < 1e3 * np.abs(ratio[k : k + 2]).max():
            found.append(
                Crossing(component + 1, float(f[0] + part * (f[1] - f[0])), float(-1.0 / at), bool(q.imag[0] > 0.0))
            )
    return found


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

    def first(nu_hz: np.ndarray) -> np.ndarray:
        f = nu_hz + model.f1_hz
        return 1.0 + evaluate_pn(model, f)[:, 1, 1] * impedance_pn(grid, f)[1]

    _, values = refine_locus(_closed_by(first, model), _first_nu(model, None, grid))
    return model.n_unstable - _turns(values)


# The winding number ------------------------------------------------------------------------------------------------


def wind(model: RationalModel, grid: Grid, loop: ClosedLoop | None = None) -> Winding:
    """Winding of det(1 + Y Z) about zero over f = -inf ... inf; ``loop`` tells where to look closely.

    Notes
    -----
    The grid's own poles on the axis, and what else of it is not known to be stable, are taken out: `Grid.clearing`.
    """

    def determinant(nu_hz: np.ndarray) -> np.ndarray:
        s = 2j * np.pi * nu_hz
        return grid.clearing(s) * _det(np.eye(2) + evaluate(model, s) @ impedance_dq(grid, s))

    nu, values = refine_locus(_closed_by(determinant, model), _first_nu(model, loop, grid))
    steps = np.degrees(np.angle(values[1:] / values[:-1]))
    closing = np.degrees(np.angle(values[0] / values[-1]))
    middle = (nu[1:] + nu[:-1]) / 2.0
    return Winding(
        number=_turns(values),
        number_shortest=_turns_closed_shortest(model, grid),
        nu_hz=nu,
        locus=values,
        largest_step_deg=float(max(np.abs(steps).max(), abs(closing))),
        beyond_deg=float(np.sum(steps[middle > model.nu_hz[-1]])),
        inside_deg=float(np.sum(steps[(middle > 0.0) & (middle < model.nu_hz[0])])),
    )


def _turns_closed_shortest(model: RationalModel, grid: Grid) -> int:
    """Turns of det(1 + Y Z) up to the highest swept frequency, then back to one with no eigenvalue passing -1."""

    def determinant(nu_hz: np.ndarray) -> np.ndarray:
        s = 2j * np.pi * nu_hz
        return grid.clearing(s) * _det(np.eye(2) + evaluate(model, s) @ impedance_dq(grid, s))

    nu = _first_nu(model, None, grid)
    nu = nu[(nu >= 0.0) & (nu <= model.nu_hz[-1])]
    _, values = refine_locus(determinant, nu)
    half = float(np.sum(np.angle(values[1:] / values[:-1])))
    s = 2j * np.pi * model.nu_hz[-1:]
    gains = np.linalg.eigvals(evaluate(model, s)[0] @ impedance_dq(grid, s)[0])
    closing = float(np.sum(np.angle(1.0 + gains))) + grid.clearing_angle(complex(s[0]))
    return round((half - closing) / np.pi)


def refine_locus(function: Admittance, nu_hz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Add points until no step of ``function`` turns by more than 30 degrees, or it is hopeless."""
    values = function(nu_hz)
    while len(nu_hz) < _MAX_POINTS:
        wide = np.flatnonzero(np.abs(np.angle(values[1:] / values[:-1])) > np.radians(0.95 * MAX_STEP_DEG))
        wide = wide[np.diff(nu_hz)[wide] > 1e-12 * np.maximum(1.0, np.abs(nu_hz[wide]))]
        if len(wide) == 0:
            break
        middle = _middle(nu_hz[wide], nu_hz[wide + 1])
        values = np.insert(values, wide + 1, function(middle))
        nu_hz = np.insert(nu_hz, wide + 1, middle)
    return nu_hz, values


def _middle(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Geometric mean of an interval far from zero, arithmetic mean of any other."""
    far = (low * high > 0.0) & (np.maximum(np.abs(low), np.abs(high)) > 4.0 * np.minimum(np.abs(low), np.abs(high)))
    return np.where(far, np.sign(low) * np.sqrt(np.abs(low * high)), (low + high) / 2.0)


def _closed_by(function: Admittance, model: RationalModel) -> Admittance:
    """The function divided by (1 + s tau)^q, q its growth at infinity: the ends meet, no zero or pole moves."""
    end = _end_hz(model, None)
    ratio = np.abs(function(np.array([10.0 * end]))[0] / function(np.array([end]))[0])
    degree = round(float(np.log10(ratio)))
    tau = 1.0 / (2.0 * np.pi * model.f1_hz)

    def closed(nu_hz: np.ndarray) -> np.ndarray:
        return function(nu_hz) / (1.0 + 2j * np.pi * nu_hz * tau) ** degree

    return closed if degree else function


def _first_nu(model: RationalModel, loop: ClosedLoop | None, grid: Grid) -> np.ndarray:
    """Symmetric start: logarithmic, and dense about every pole of the device, of the loop and of the grid alone."""
    poles = np.concatenate([model.poles, grid.modes, [] if loop is None else loop.poles])
    about = poles.imag[:, None] + np.abs(poles.real)[:, None] * np.array([-3.0, -1.0, -0.3, 0.0, 0.3, 1.0, 3.0])
    w1 = np.array([model.f1_hz]) * np.array([0.98, 1.0, 1.02])  # where an inductive Zg1 or Zg2 is smallest
    spread = np.geomspace(1e-3, _end_hz(model, loop), 150)
    nu = np.concatenate([spread, np.abs(about.ravel()) / (2.0 * np.pi), w1, model.nu_hz])
    nu = np.unique(nu[nu <= spread[-1]])
    nu = nu[nu > 0.0]
    return np.concatenate([-nu[::-1], [0.0], nu])


def _end_hz(model: RationalModel, loop: ClosedLoop | None) -> float:
    """A frequency (Hz) far above everything the model knows."""
    poles = model.poles if loop is None else np.concatenate([model.poles, loop.poles])
    return 1e3 * max(float(np.abs(poles).max(initial=0.0)) / (2.0 * np.pi), float(model.nu_hz[-1]))


def _turns(values: np.ndarray) -> int:
    """Whole counter-clockwise turns of a closed locus."""
    steps = np.angle(np.append(values[1:], values[0]) / values)
    return round(float(np.sum(steps)) / (2.0 * np.pi))


def _det(matrices: np.ndarray) -> np.ndarray:
    return matrices[:, 0, 0] * matrices[:, 1, 1] - matrices[:, 0, 1] * matrices[:, 1, 0]


# The decision ------------------------------------------------------------------------------------------------------


class Doubt(NamedTuple):
    """Probability of being stable, where in the dq frame (Hz) the doubt comes from, in how many standard errors."""

    probability: float
    nu_hz: float
    distance: float


def doubt(model: RationalModel, grid: Grid, loop: ClosedLoop, nu_hz: np.ndarray, stable: bool) -> Doubt:
    """Probability of being stable, given that the locus of the fit says ``stable``.

    A stable loop is in doubt wherever its locus may pass zero on the other side: the least distance counts. An
    unstable one becomes stable only if the locus is wrong at every unstable mode: the surest mode counts.
    """
    nu = nu_hz[(nu_hz >= 0.0) & (nu_hz <= model.nu_hz[-1])]
    distance = locus_distance(model, grid, nu)
    if stable:
        nearest = int(np.argmin(distance))
        return Doubt(_normal(distance[nearest]), float(nu[nearest]), float(distance[nearest]))
    unstable = loop.poles[(loop.poles.real > 0.0) & ~loop.beyond]
    about = [np.abs(2.0 * np.pi * nu - p.imag) <= 3.0 * p.real for p in unstable]
    nearest_ones = [int(np.argmin(np.where(a, distance, np.inf))) for a in about if np.any(a)]
    surest = max(nearest_ones, key=lambda k: distance[k], default=int(np.argmin(distance)))
    return Doubt(_normal(-distance[surest]), float(nu[surest]), float(distance[surest]))


def locus_distance(model: RationalModel, grid: Grid, nu_hz: np.ndarray) -> np.ndarray:
    """How many standard errors (n,) the locus keeps from zero at frequencies |f - f1| (Hz): Mahalanobis distance.

    By the delta method: det M moves by tr(adj(M) dM). Near a lightly damped mode it is Re/std of its pole, but unlike
    that it stays well defined where poles crowd and only their combinations are known.
    """
    s = 2j * np.pi * nu_hz
    z = impedance_dq(grid, s)
    loop = np.eye(2) + evaluate(model, s) @ z
    adjugate = np.stack([loop[:, 1, 1], -loop[:, 0, 1], -loop[:, 1, 0], loop[:, 0, 0]], axis=1).reshape(-1, 2, 2)
    errors = spread(model, s, np.swapaxes(z @ adjugate, 1, 2))
    real, imag = errors.real, errors.imag
    value = _det(loop)
    rounding = 1e-18 * np.sum(np.abs(loop) ** 2, axis=(1, 2)) ** 2  # at nu = 0 the locus is real, and so is its spread
    var_re, var_im = np.sum(real**2, axis=1) + rounding, np.sum(imag**2, axis=1) + rounding
    across = np.sum(real * imag, axis=1)
    squared = var_im * value.real**2 - 2.0 * across * value.real * value.imag + var_re * value.imag**2
    return np.sqrt(np.maximum(squared, 0.0) / np.maximum(var_re * var_im - across**2, 1e-14 * var_re * var_im))


def _normal(x: float) -> float:
    """Standard normal distribution function."""
    return 0.5 * erfc(-x / sqrt(2.0))


def _believed_number(model: RationalModel, grid: Grid, winding: Winding) -> int:
    """The shortest closing where the ends cannot matter, else that of the fit."""
    return winding.number if _active_at_end(model, grid) else winding.number_shortest


def _decide(
    model: RationalModel, grid: Grid, loop: ClosedLoop, winding: Winding, doubtful: Doubt
) -> tuple[Decision, str]:
    number = _believed_number(model, grid, winding)
    stable = number == model.n_unstable
    turns = f"winding number {number}, open-loop unstable poles {model.n_unstable}"
    if not winding.trusted:
        return "undecided", f"the locus could not be traced to the end ({turns})"
    if _active_at_end(model, grid) and (stable or winding.number != winding.number_shortest):
        return "undecided", (
            f"the sweep ends at |f - f1| = {model.nu_hz[-1]:.4g} Hz, where the device is still active and the loop "
            "gain above one: sweep to higher frequencies"
        )
    if stable != (loop.n_unstable == 0):
        return "undecided", f"locus and poles disagree ({turns}, {loop.n_unstable} unstable closed-loop poles)"
    if 1.0 - DECIDED < doubtful.probability < DECIDED:
        return "undecided", (
            f"the loop is stable with a probability of {doubtful.probability:.1%}; what is missing are more or better "
            f"points near {_place(model, doubtful.nu_hz)}: {_advice(model, grid, loop, doubtful)}"
        )
    decisive = _decisive(loop, stable)
    unseen = [k for k in decisive if not is_swept(model, complex(loop.poles[k]))]
    if unseen and (stable or len(unseen) == len(decisive)):
        return "undecided", (
            f"a mode at {_place(model, float(loop.f_hz[unseen[0]]))} decides, and the table has no usable rows around "
            "it: sweep there"
        )
    return ("stable" if stable else "unstable"), turns


def _advice(model: RationalModel, grid: Grid, loop: ClosedLoop, doubtful: Doubt) -> str:
    """Which rows, and how many times the periods, would bring the locus as far from zero as a verdict asks."""
    nearest = complex(loop.poles[np.argmin(np.abs(loop.poles - 2j * np.pi * doubtful.nu_hz))])
    found = remedy(model, grid, nearest, (doubtful.distance / _DECIDED_AT) ** 2)
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


def _decisive(loop: ClosedLoop, stable: bool) -> list[int]:
    """Modes the verdict hangs on: the unstable ones, or the resonance and everything lightly damped."""
    if not stable:
        return [int(k) for k in np.flatnonzero((loop.poles.real > 0.0) & ~loop.beyond)]
    light = np.flatnonzero((loop.damping < LIGHTLY_DAMPED) & ~loop.beyond).tolist()
    return sorted({*light, *([] if loop.critical is None else [loop.critical])})


def is_swept(model: RationalModel, pole: complex) -> bool:
    """Whether usable rows lie on both sides of a mode (rad/s, dq), as close as their ratio or the mode's width asks."""
    nu = abs(pole.imag) / (2.0 * np.pi)
    swept = model.nu_hz
    if nu < swept[0] / _EDGE or nu > swept[-1] * _EDGE:
        return False
    above = int(np.clip(np.searchsorted(swept, nu), 1, len(swept) - 1))
    distance = 2.0 * np.pi * (swept[above] - swept[above - 1])
    return bool(swept[above] <= _GAP * swept[above - 1] or distance <= 2.0 * abs(pole.real))


def _active_at_end(model: RationalModel, grid: Grid) -> bool:
    """Whether the device may still bring a loop to oscillate above the swept band: not passive, gain above one."""
    s = 2j * np.pi * model.nu_hz[-1:]
    y = evaluate(model, s)[0]
    active = np.linalg.eigvalsh((y + y.conj().T) / 2.0)[0] < -0.01 * np.linalg.norm(y)
    return bool(active and np.abs(np.linalg.eigvals(y @ impedance_dq(grid, s)[0])).max() > 1.0)


def _extrapolation(model: RationalModel, winding: Winding) -> str:
    ends = ""
    if winding.number != winding.number_shortest:
        ends = (
            f" Its asymptotes would make the winding number {winding.number} instead of {winding.number_shortest}: "
            "they are not believed where the device is passive or the loop gain below one at the band's end."
        )
    return (
        f"Swept: |f - f1| from {model.nu_hz[0]:.3g} to {model.nu_hz[-1]:.4g} Hz. Outside, the answer rests on the fit: "
        f"the locus turns {winding.inside_deg:+.0f} degrees below and {winding.beyond_deg:+.0f} degrees above." + ends
    )
