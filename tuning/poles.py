"""Closed-loop poles of the fitted device on a grid, with damping and standard errors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..identify.fit.rational import RationalModel, derivative, evaluate, spread
from .feeding import Hole, hole_of
from .siso import Grid, check_fundamental, impedance_dq

RESONANCE_FROM_HZ = 5.0
"""Modes below this frequency in dq are slow modes, not resonances (Hz)."""

RESONANCE_DAMPING = 2.0**-0.5
"""Damping ratio from which on a mode has no peak."""

NAMED_DAMPING = 0.5
"""Damping ratio from which on a mode's peak is below 16 % and it is not named as a resonance: rows tell it badly."""

LIGHT = 0.1
"""Damping ratio below which a mode is lightly damped, and the ratio counts; above, how long it lasts."""

SURELY = 2.326
"""Standard errors of its real part from which on a mode surely grows: 99 %."""

BEYOND = 1.5
"""Poles further out than this multiple of the highest swept |f - f1| are not believed."""

EDGE = 1.05
"""A mode this far beyond the band's end still counts as swept."""

_GAP = 1.6  # neighbouring |f - f1| further apart than this ratio leave a gap, unless the mode is wider than it
_CARRIED = 0.05  # a mode so near to one of the device's own, in widths of that, does not show in the locus
_ONE_PLACE = 2.0  # standard errors within which a mode is not told from one of the device's own that counts twice
_BESIDE = 0.05  # relative distance from a pole of no known width within which a mode is its shadow
_VAGUE = 0.3  # a pole of the device whose width is not known to this part of itself has no known width
_KNOWN = 0.2  # a mode whose place is known no better than to this part of itself is none that the data carry
_DAMPED = 0.5  # nor one whose damping is not known to a factor of two
_NEAR_AXIS = 0.02  # unless it is as sure to be next to undamped: to this part of itself
_SEVERAL = 2  # oscillating modes in a gap of the rows that may stand for more
_HELD = 1e-4  # damping ratio of a pole at the axis: of no mode that a device has
_OF_ROW = 8  # real numbers of a row
_OF_PAIR, _OF_SINGULAR_PAIR = 10, 8  # real parameters of an oscillating pole and its residue of rank two, or one
_INFINITE = 1e8  # rad/s; eigenvalues of the pencil beyond are its infinite ones


class Shape(NamedTuple):
    """Null vectors of Y + Yg at a closed-loop pole: ``left @ M = 0``, ``M @ right = 0``, and left @ M' @ right."""

    left: np.ndarray
    right: np.ndarray
    slope: complex


class Shapes(NamedTuple):
    """The same for many poles: (n, 2), (n, 2) and (n,)."""

    left: np.ndarray
    right: np.ndarray
    slope: np.ndarray


@dataclass(frozen=True, slots=True)
class ClosedLoop:
    """Closed-loop poles in the dq frame.

    Attributes
    ----------
    f1_hz : float
        Fundamental frequency (Hz).
    poles : (m,) complex
        Poles with Im >= 0 (rad/s), largest real part first; the conjugates are implied.
    covariance : (m, 2, 2) float
        Covariance of real and imaginary part ((rad/s)^2).
    beyond : (m,) bool
        Not believed: too far outside the swept band, where only the fit's asymptotes speak, or nearer to f1 than all
        rows where nothing feeds a mode.
    critical : int or None
        Index of the resonance: among the oscillating modes that the data carry the least damped one, or if all are
        damped by more than a tenth the one with the largest real part; an unstable one if there is one; None if there
        is none.
    leading : int or None
        The same, whether rows surround it and tell it or not: a mode that they do not is not named, but may decide.
    withheld : int or None
        Index of a mode that would be the resonance, but is not named beside the verdict that the loop got.
    hole : Hole
        The gap around f1 that has no rows.
    """

    f1_hz: float
    poles: np.ndarray
    covariance: np.ndarray
    beyond: np.ndarray
    critical: int | None
    leading: int | None
    hole: Hole
    withheld: int | None = None

    @property
    def std(self) -> np.ndarray:
        """(m,) complex standard errors, real part + 1j imaginary part (rad/s)."""
        return np.sqrt(self.covariance[:, 0, 0]) + 1j * np.sqrt(self.covariance[:, 1, 1])

    @property
    def damping(self) -> np.ndarray:
        """(m,) damping ratios -Re/|pole|."""
        return -self.poles.real / np.maximum(np.abs(self.poles), 1e-300)

    @property
    def f_hz(self) -> np.ndarray:
        """(m,) frequencies in the dq frame (Hz)."""
        return self.poles.imag / (2.0 * np.pi)

    @property
    def n_unstable(self) -> int:
        """Believed poles in the right half-plane, conjugates counted."""
        unstable = self.poles[(self.poles.real > 0.0) & ~self.beyond]
        return int(len(unstable) + np.sum(unstable.imag > 0.0))

    @property
    def resonance_hz(self) -> tuple[float, float] | None:
        """The resonance pair f1 -+ |Im|/2pi in phase quantities (Hz)."""
        if self.critical is None:
            return None
        return self.pair_hz(self.critical)

    def pair_hz(self, k: int) -> tuple[float, float]:
        """A mode as the pair f1 -+ |Im|/2pi in phase quantities (Hz)."""
        nu = float(self.f_hz[k])
        return self.f1_hz - nu, self.f1_hz + nu

    @property
    def slow(self) -> np.ndarray:
        """(k,) indices of the slow modes, Im/2pi <= 5 Hz."""
        return np.flatnonzero(self.f_hz <= RESONANCE_FROM_HZ)


def closed_loop(model: RationalModel, grid: Grid) -> ClosedLoop:
    """Poles of device and grid, roots of det(1 + Y Z) = 0, with standard errors by the delta method."""
    poles = closed_loop_poles(model, grid)
    upper = poles[poles.imag >= 0.0]
    upper = upper[np.argsort(-upper.real)]
    covariance = _covariance(model, grid, upper)
    hole = hole_of(model, grid, upper)
    beyond = is_beyond(model, upper) | (np.abs(upper) < 2.0 * np.pi * hole.start_hz)
    carried = ~beyond & _carried(model, grid.shadows, upper, covariance)
    shown = np.array([_is_shown(model, complex(pole)) for pole in upper], dtype=bool)
    grows = upper.real > SURELY * np.sqrt(covariance[:, 0, 0])
    critical, leading = (_resonance(model, upper, ~beyond, named, grows) for named in (carried & shown, carried))
    return ClosedLoop(model.f1_hz, upper, covariance, beyond, critical, leading, hole)


def _carried(model: RationalModel, shadows: np.ndarray, poles: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Modes (m,) that the data carry.

    Not carried are modes that share a place with one of the device's own, which then is uncontrollable from the
    terminals and the same on every grid, or of a source that was fitted (``shadows``), and modes of which place or
    damping is hardly known, or not told from the place of a pole of the device's own whose residue has full rank.
    """
    std, std_re = np.sqrt(np.trace(covariance, axis1=1, axis2=2)), np.sqrt(covariance[:, 0, 0])
    own = np.concatenate([model.poles, shadows])
    apart = np.abs(poles[:, None] - own) / np.maximum(np.abs(own.real), 1e-300)
    vague = model.poles[model.pole_std.real > _VAGUE * np.abs(model.poles.real)]  # a row or two hold them up
    beside = np.abs(poles[:, None] - vague) < _BESIDE * np.abs(poles)[:, None]
    twice = model.poles[model.ranks > 1]  # the grid moves one of the two, and the other may stand for the fit's error
    beside = np.append(beside, np.abs(poles[:, None] - twice) < _ONE_PLACE * std[:, None], axis=1)
    damped = std_re < np.maximum(_DAMPED * np.abs(poles.real), _NEAR_AXIS * np.abs(poles))
    known = (std < _KNOWN * np.abs(poles)) & damped
    return (apart.min(axis=1, initial=np.inf) > _CARRIED) & known & ~np.any(beside, axis=1)


def _resonance(
    model: RationalModel, poles: np.ndarray, believed: np.ndarray, named: np.ndarray, grows: np.ndarray
) -> int | None:
    """Index of the resonance: the least damped mode, or if all are well damped the one that lasts longest.

    An unstable one comes first, and where one surely ``grows`` that cannot be named, nothing is. Slow modes are listed
    by themselves; one that is unstable with nothing faster counts.
    """
    f_hz, damping = poles.imag / (2.0 * np.pi), -poles.real / np.maximum(np.abs(poles), 1e-300)
    within = (f_hz > 0.0) & (f_hz < EDGE * model.nu_hz[-1]) & (damping < NAMED_DAMPING) & believed
    if np.any((poles.real > 0.0) & within & (named | grows)):
        within &= poles.real > 0.0
    within &= named
    fast = within & (f_hz > RESONANCE_FROM_HZ)
    among = np.flatnonzero(fast if np.any(fast) else within & (poles.real > 0.0))
    if len(among) == 0:
        return None
    light = among[damping[among] < LIGHT]
    return int(light[np.argmin(damping[light])] if len(light) else among[np.argmax(poles.real[among])])


def is_beyond(model: RationalModel, poles: np.ndarray) -> np.ndarray:
    """(m,) bool: further from the origin than 1.5 times the highest swept |f - f1|."""
    return np.abs(poles) > BEYOND * 2.0 * np.pi * model.nu_hz[-1]


def unstable_on(model: RationalModel, grid: Grid) -> np.ndarray:
    """Believed closed-loop poles (m,) in the right half-plane (rad/s), conjugates included."""
    poles = closed_loop_poles(model, grid)
    return np.asarray(poles[(poles.real > 0.0) & ~is_beyond(model, poles)])


def is_swept(model: RationalModel, pole: complex) -> bool:
    """Whether usable rows are as close to a mode (rad/s, dq) as their ratio or the mode's width asks.

    The rows nearest to f1 have their mirror images on the other side: a slow or aperiodic mode between them is swept
    where it is as wide as its distance from them.
    """
    nu, width = abs(pole.imag) / (2.0 * np.pi), abs(pole.real) / (2.0 * np.pi)
    swept = model.nu_hz
    if nu < swept[0] / EDGE:
        return bool(swept[0] - nu <= width)
    if nu > swept[-1] * EDGE:
        return False
    above = int(np.clip(np.searchsorted(swept, nu), 1, len(swept) - 1))
    return bool(swept[above] <= _GAP * swept[above - 1] or swept[above] - swept[above - 1] <= 2.0 * width)


def _is_shown(model: RationalModel, pole: complex) -> bool:
    """Whether rows surround a mode and tell it, and agree with what was proved of the device there."""
    return is_swept(model, pole) and _is_told(model, pole) and not _is_beside_held(model, pole)


def _is_beside_held(model: RationalModel, pole: complex) -> bool:
    """Whether a pole of the device's own is held at the axis between the same two rows as a mode.

    What was proved keeps it on the left, narrower than any mode of a device that came to rest, where rows would have
    it on the other side: what stands beside it makes up for that.
    """
    above = np.searchsorted(model.nu_hz, abs(pole.imag) / (2.0 * np.pi))
    at_axis = model.poles[(model.poles.imag > 0.0) & (np.abs(model.poles.real) < _HELD * model.poles.imag)]
    return bool(np.any(np.searchsorted(model.nu_hz, at_axis.imag / (2.0 * np.pi)) == above))


def _is_told(model: RationalModel, pole: complex) -> bool:
    """Whether the rows around a mode have as many numbers as the device's own oscillating poles there have parameters.

    Around it are the rows next to it, and all within its width. Poles that ask them for more are held up by rows
    further away, which tell of such poles together and not of each: the grid's answer to one of them is the fit's
    invention. Rows without noise tell it however far away.
    """
    if model.omitted is None:
        return True
    rows = np.concatenate([-model.nu_hz[::-1], model.nu_hz])
    nu, width = abs(pole.imag) / (2.0 * np.pi), abs(pole.real) / (2.0 * np.pi)
    above = int(np.clip(np.searchsorted(rows, nu), 1, len(rows) - 1))
    low, high = min(rows[above - 1], nu - width), max(rows[above], nu + width)
    own = model.poles.imag / (2.0 * np.pi)
    among = (own > 0.0) & (own >= low) & (own <= high)
    parameters = np.sum(np.where(model.ranks[among] > 1, _OF_PAIR, _OF_SINGULAR_PAIR))
    return bool(parameters <= _OF_ROW * np.sum((rows >= low) & (rows <= high)))


def crowded(model: RationalModel, hole: Hole) -> np.ndarray:
    """Gaps (n,) of the rows, each below its row, that hold several oscillating modes of the device, not surrounded.

    What rows outside know of a gap is the first terms of a series; a few modes there use them up, and may stand for
    more. The first gap is the hole around f1, where nothing is asked if nothing is fed, and always where even one
    mode makes what the fit says of it a guess.
    """
    nu_hz = model.poles.imag / (2.0 * np.pi)
    unswept = np.array([not is_swept(model, complex(pole)) for pole in model.poles], dtype=bool)
    inside = unswept & (nu_hz > 0.0) & (nu_hz < model.nu_hz[-1])
    number = np.bincount(np.searchsorted(model.nu_hz, nu_hz[inside]), minlength=len(model.nu_hz))
    number[0] = _SEVERAL if hole.guessed else number[0] * (hole.start_hz == 0.0)
    return np.asarray(number >= _SEVERAL)


def closed_loop_poles(model: RationalModel, grid: Grid) -> np.ndarray:
    """Closed-loop poles (m,) in rad/s, dq frame, conjugates included.

    Notes
    -----
    With i = C x + D v + E v', x' = A x + B v of the device and Eg xg' = Ag xg + Bg i, v = Cg xg of the grid the poles
    are the finite generalised eigenvalues of a descriptor pencil in (x, i, xg). It is inverted about a point in the
    right half-plane, so that a plain eigenvalue routine serves and the infinite ones become zeros. A residue of rank
    one takes one state.
    """
    check_fundamental(model.f1_hz, grid)
    a, b, c = states(model)
    behind = grid.descriptor()
    n = len(a)
    size = n + 2 + len(behind.a)
    m = np.zeros((size, size), dtype=complex)
    e = np.zeros((size, size), dtype=complex)
    state, current, network = slice(0, n), slice(n, n + 2), slice(n + 2, None)
    m[state, state], m[state, network] = np.diag(a), b @ behind.c
    m[current, state], m[current, current], m[current, network] = -c, np.eye(2), -model.d @ behind.c
    m[network, current], m[network, network] = behind.b, behind.a
    e[state, state] = np.eye(n)
    e[current, network] = model.e @ behind.c
    e[network, network] = behind.e
    size_of_rows = 1.0 / np.maximum(np.abs(m).max(axis=1), np.abs(e).max(axis=1) * 2.0 * np.pi * grid.f1_hz)[:, None]
    m, e = m * size_of_rows, e * size_of_rows
    about = 0.7 * 2.0 * np.pi * grid.f1_hz
    inverse = np.linalg.eigvals(np.linalg.solve(m - about * e, e))
    poles = about + 1.0 / inverse[np.abs(inverse) > 1.0 / _INFINITE]
    poles[np.abs(poles.imag) < 1e-9 * np.abs(poles)] = poles[np.abs(poles.imag) < 1e-9 * np.abs(poles)].real
    return poles


def mode_shape(model: RationalModel, grid: Grid, pole: complex) -> Shape:
    """Left and right null vectors of Y + Yg at a closed-loop pole, dq frame."""
    shapes = mode_shapes(model, grid, np.array([pole]))
    return Shape(shapes.left[0], shapes.right[0], complex(shapes.slope[0]))


def mode_shapes(model: RationalModel, grid: Grid, poles: np.ndarray) -> Shapes:
    """`mode_shape` of all poles (n,) at once."""
    z_inverse = np.linalg.inv(impedance_dq(grid, poles))
    u, _, vh = np.linalg.svd(evaluate(model, poles) + z_inverse)
    left, right = u[:, :, 1].conj(), vh[:, 1].conj()
    slopes = np.stack([derivative(model, complex(pole)) for pole in poles])
    slopes = slopes - z_inverse @ grid.slope_dq(poles) @ z_inverse
    return Shapes(left, right, np.einsum("ni,nij,nj->n", left, slopes, right))


def mode_weight(model: RationalModel, grid: Grid, poles: np.ndarray) -> np.ndarray:
    """What closed-loop poles (n,) move by, but for the sign, when Ydq at them changes: (n, 2, 2), as for `gradient`.

    A pole moves by -left dY right / (left M' right).
    """
    shape = mode_shapes(model, grid, poles)
    return np.asarray(shape.left[:, :, None] * shape.right[:, None, :] / shape.slope[:, None, None])


def _covariance(model: RationalModel, grid: Grid, poles: np.ndarray) -> np.ndarray:
    """(n, 2, 2) over Re and Im by the delta method, errors of the device and of the grid together."""
    if len(poles) == 0:
        return np.zeros((0, 2, 2))
    with np.errstate(divide="ignore", invalid="ignore"):  # of a double pole nothing is known
        return _moved(model, grid, poles, mode_weight(model, grid, poles))


def _moved(model: RationalModel, grid: Grid, poles: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Covariance (n, 2, 2) of poles that move by ``weight`` (n, 2, 2) with Ydq."""
    behind = np.swapaxes(np.linalg.inv(impedance_dq(grid, poles)), 1, 2)
    errors = np.append(spread(model, poles, weight), grid.spread_dq(poles, -(behind @ weight @ behind)), axis=1)
    effect = np.stack([errors.real, errors.imag], axis=1)
    return np.asarray(effect @ np.swapaxes(effect, 1, 2))


def states(model: RationalModel) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Diagonal A (n,), B (n, 2), C (2, n) with as many states per pole as its residue has rank."""
    u, singular, vh = np.linalg.svd(model.residues)
    kept = np.arange(2) < model.ranks[:, None]
    root = np.sqrt(singular)
    a = np.repeat(model.poles[:, None], 2, axis=1)[kept]
    b = (root[:, :, None] * vh)[kept]
    c = np.swapaxes(u * root[:, None, :], 1, 2)[kept].T
    return a, b, c
