"""The locus of det(1 + Y Z) over the dq axis, and how often it winds about zero.

Beyond the swept band nothing is known, so nothing is extrapolated: the loop gain is let fall off, Y Z / r for the
frequency r times the band's end. No eigenvalue of Y Z then passes -1 beyond the band, the ends meet at one, and the
number of turns is that of the swept band alone. Where the device is active and the loop gain above one at the band's
end, that is no answer, and `verdict` says so. Around f1, between the lowest row and its mirror image, the same is done
where nothing feeds an oscillation (`feeding`); elsewhere the fit is followed there, with its errors.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..identify.fit.rational import RationalModel, evaluate
from .poles import ClosedLoop
from .siso import Grid

MAX_STEP_DEG = 30.0
"""A locus is refined until no step turns further than this."""

_MAX_POINTS = 20000
_SEEDS = np.array([-3.0, -1.0, -0.3, 0.0, 0.3, 1.0, 3.0])  # widths from a mode at which a locus is looked at first
_FALL = np.geomspace(1.0, 1e4, 25)[1:]  # how many times the band's end the locus is followed while the gain falls off

Locus = Callable[[np.ndarray], np.ndarray]
Admittance = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True, slots=True)
class Winding:
    """The locus and what it did.

    Attributes
    ----------
    number : int
        Counter-clockwise turns about zero.
    nu_hz : (n,) float
        Frequencies in the dq frame (Hz), refined; symmetric.
    locus : (n,) complex
        det(1 + Y Z), the grid's own poles on the axis taken out.
    largest_step_deg : float
        Largest turn between neighbours (degrees).
    beyond_deg, inside_deg : float
        Turn above the highest and below the lowest swept |f - f1|, positive-frequency half (degrees).
    """

    number: int
    nu_hz: np.ndarray
    locus: np.ndarray
    largest_step_deg: float
    beyond_deg: float
    inside_deg: float

    @property
    def trusted(self) -> bool:
        """Whether the refinement came to its end."""
        return self.largest_step_deg <= MAX_STEP_DEG


class Band(NamedTuple):
    """|f - f1| (Hz): from where the locus is followed, the lowest row, the highest."""

    start_hz: float
    lowest_hz: float
    end_hz: float


def wind(model: RationalModel, grid: Grid, loop: ClosedLoop) -> Winding:
    """Winding of det(1 + Y Z) of a fitted device about zero; ``loop`` tells where to look closely."""
    poles = np.concatenate([model.poles, loop.poles])
    lowest, end = float(model.nu_hz[0]), float(model.nu_hz[-1])
    seeds = np.concatenate([np.geomspace(1e-3, end, 80), about(poles), model.nu_hz])
    band = Band(loop.hole.start_hz, lowest, end)
    return wound(lambda nu: evaluate(model, 2j * np.pi * nu), grid, band, seeds)


def wound(admittance: Admittance, grid: Grid, band: Band, seeds_hz: np.ndarray) -> Winding:
    """Winding of det(1 + Y Z) about zero.

    Parameters
    ----------
    admittance : callable
        |f - f1| (n,) in Hz, from where the band is followed to its end, to Ydq (n, 2, 2) in S.
    grid : Grid
        The grid.
    band : Band
        Where the locus is followed.
    seeds_hz : (n,) float
        Where the locus is looked at first, besides the grid's own modes (Hz); it is refined from there.

    Notes
    -----
    Device and grid are real systems in the dq frame: the half of negative frequency is the conjugate of the other.
    """
    end = band.end_hz
    w1 = grid.f1_hz * np.array([0.98, 1.0, 1.02])  # where an inductive grid is smallest
    passes = _passing_one(admittance, grid, band)
    seeds = np.concatenate([seeds_hz, about(grid.modes), w1, passes])
    inside = np.unique(np.concatenate([[0.0, end], seeds[(seeds > 0.0) & (seeds < end)]]))
    beyond = np.unique(np.concatenate([end * _FALL, passes[passes > end]]))
    nu, values = refine_locus(closed_locus(admittance, grid, band), np.concatenate([inside, beyond]))
    steps = np.angle(values[1:] / values[:-1])
    middle = (nu[1:] + nu[:-1]) / 2.0
    return Winding(
        number=round(float(np.sum(steps)) / np.pi),
        nu_hz=np.concatenate([-nu[:0:-1], nu]),
        locus=np.concatenate([values[:0:-1].conj(), values]),
        largest_step_deg=float(np.degrees(np.abs(steps).max())),
        beyond_deg=float(np.degrees(np.sum(steps[middle > end]))),
        inside_deg=float(np.degrees(np.sum(steps[middle < band.lowest_hz]))),
    )


def _passing_one(admittance: Admittance, grid: Grid, band: Band) -> np.ndarray:
    """Where, outside the band, 1 + g passes zero the closest as an eigenvalue g of the gain falls off (Hz).

    Two eigenvalues that pass together turn the locus by a whole turn there, which no step across it would show.
    """
    start = np.zeros(0) if band.start_hz <= 0.0 else band.start_hz / _least(admittance, grid, band.start_hz)
    return np.concatenate([start, band.end_hz * _least(admittance, grid, band.end_hz)])


def _least(admittance: Admittance, grid: Grid, nu_hz: float) -> np.ndarray:
    """Divisors above one of the gain at |f - f1| with which 1 + g is the least, and about as far beside."""
    at = np.array([nu_hz])
    gains = np.linalg.eigvals(admittance(at) @ grid.impedance_dq(2j * np.pi * at))[0]
    gains = gains[gains.real < 0.0]
    beside = gains.imag[:, None] * _SEEDS
    share = ((-gains.real[:, None] + beside) / np.abs(gains[:, None]) ** 2).ravel()
    return np.asarray(1.0 / share[(share > 0.0) & (share < 1.0)])


def about(poles: np.ndarray) -> np.ndarray:
    """Frequencies |f - f1| (Hz) around every pole (m,) in rad/s, as close as it is wide: as many of each, in turn."""
    width = np.abs(poles.real)[:, None] * _SEEDS
    return np.abs(poles.imag[:, None] + width).ravel() / (2.0 * np.pi)


def closed_locus(admittance: Admittance, grid: Grid, band: Band) -> Locus:
    """det(1 + Y Z), cleared of the grid's poles, at |f - f1| from zero on (Hz); outside the band the gain falls off."""
    s_end = np.array([2j * np.pi * band.end_hz])
    clearing_end = complex(grid.clearing(s_end)[0])
    log_end = np.log(abs(clearing_end)) + 1j * grid.clearing_angle(complex(s_end[0]))

    def locus(nu_hz: np.ndarray) -> np.ndarray:
        above = np.minimum(band.end_hz / np.maximum(nu_hz, 1e-300), 1.0)
        below = np.minimum(nu_hz / band.start_hz, 1.0) if band.start_hz > 0.0 else np.ones_like(nu_hz)
        within = np.clip(nu_hz, band.start_hz, band.end_hz)
        gain = admittance(within) @ grid.impedance_dq(2j * np.pi * within)
        beyond = nu_hz > band.end_hz
        clearing = np.where(beyond, np.exp(above * log_end), grid.clearing(2j * np.pi * np.minimum(nu_hz, band.end_hz)))
        return clearing * det(np.eye(2) + (above * below)[:, None, None] * gain)

    return locus


def refine_locus(function: Locus, nu_hz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
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
    return np.where((low > 0.0) & (high > 4.0 * low), np.sqrt(np.abs(low * high)), (low + high) / 2.0)


def det(matrices: np.ndarray) -> np.ndarray:
    """Determinants (n,) of (n, 2, 2)."""
    return matrices[:, 0, 0] * matrices[:, 1, 1] - matrices[:, 0, 1] * matrices[:, 1, 0]
