"""What is true of a device on a grid, and whether a table covers what the question needs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .linear import J, Linear
from .units import Unit

RATIO = 1.3
"""Neighbouring |f - f1| this far apart leave no gap."""

SLOW_HZ = 5.0
"""Modes below are slow modes, not resonances (dq, Hz)."""

LOUD = 0.5
"""Loop gain from which on rows are needed where faint activity asks for none. One is where a loop at the edge stands at
its critical frequency: on the stable side the gain is below one all around it, and yet rows are needed nowhere more."""

QUIET = 0.2
"""Loop gain below which activity is faint: it cannot make a loop oscillate, whatever its phase, with some to spare."""

_PLACES_HZ = np.geomspace(0.02, 8000.0, 400)

VISIBLE = 5e-3
"""A mode that moves by less than this part of its size when the grid doubles is not seen at the terminals."""


@dataclass(frozen=True)
class Truth:
    """Exact facts of one case.

    Attributes
    ----------
    stable : bool
        Whether no pole lies on the right.
    n_unstable : int
        Poles on the right, conjugates counted.
    poles : (m,) complex
        Of the closed loop (rad/s).
    distance : float
        Relative distance of the nearest edge of stability in the size of the grid; inf where there is none.
    covered : bool
        Whether the table's rows cover the question; see `covers`.
    nearly_covered : bool
        The same, or only where the device is faintly active are rows missing; see `covers_all_but_faint`.
    critical : complex
        The exact mode that a resonance should name, NaN where none oscillates in the band (rad/s, Im > 0).
    critical_covered : bool
        Whether rows lie around it as closely as `covers` asks.
    hidden : bool
        Whether nothing in such a table can tell: every pole on the right is farther out than the last row, where the
        device is passive or the loop gain below one, or comes from a mode of the device whose part of every row is
        below twice the row's error.
    """

    stable: bool
    n_unstable: int
    poles: np.ndarray
    distance: float
    covered: bool
    nearly_covered: bool
    critical: complex
    critical_covered: bool
    hidden: bool


def truth_of(unit: Unit, grid: tuple[float, float], distance: float, nu_hz: np.ndarray, noise: float = 0.0) -> Truth:
    """Exact facts; ``nu_hz`` (n,) are the usable rows' |f - f1|, ascending, ``noise`` their relative errors."""
    poles = unit.device.closed_loop(*grid)
    critical = critical_mode(unit, grid, poles, nu_hz)
    oscillates = np.isfinite(critical.real)
    modes = seen_modes(poles, unit.device.own_poles)
    covered = covers(unit, grid, nu_hz, modes)
    return Truth(
        stable=bool(poles.real.max() < 0.0),
        n_unstable=int(np.sum(poles.real > 0.0)),
        poles=poles,
        distance=distance,
        covered=covered,
        nearly_covered=covered or covers_all_but_faint(unit, grid, nu_hz, modes),
        critical=critical,
        hidden=_is_hidden(unit, grid, poles[poles.real > 0.0], nu_hz, noise),
        critical_covered=bool(oscillates and _closed_at(abs(critical.imag) / (2.0 * np.pi), nu_hz, modes)),
    )


def seen_modes(poles: np.ndarray, own: np.ndarray) -> np.ndarray:
    """Poles of the closed loop and of the device alone; what is the same in both is not seen at the terminals."""

    def moved(these: np.ndarray, those: np.ndarray) -> np.ndarray:
        return these[np.abs(these[:, None] - those).min(axis=1) > 1e-6 * np.maximum(np.abs(these), 1.0)]

    return np.concatenate([moved(poles, own), moved(own, poles)])


def critical_mode(unit: Unit, grid: tuple[float, float], poles: np.ndarray, nu_hz: np.ndarray) -> complex:
    """The least damped oscillating mode in the band that the grid moves, a network's own at f1 left aside."""
    nu = poles.imag / (2.0 * np.pi)
    f1_hz = unit.bases.f1_hz
    among = poles[(nu > max(SLOW_HZ, nu_hz[0])) & (nu < nu_hz[-1]) & (np.abs(nu - f1_hz) > 1.0)]
    if not len(among):
        return complex(np.nan, np.nan)
    moved = unit.device.closed_loop(grid[0] * 1.01, grid[1] * 1.01)
    shift = np.abs(among[:, None] - moved).min(axis=1) / (0.01 * np.abs(among))
    among = among[shift > VISIBLE]
    if not len(among):
        return complex(np.nan, np.nan)
    return complex(among[np.argmax(among.real / np.abs(among))])


def covers(unit: Unit, grid: tuple[float, float], nu_hz: np.ndarray, modes: np.ndarray) -> bool:
    """Whether the rows cover what stability asks.

    Rows are needed wherever the device is active, however small the loop gain, and wherever the loop gain is above one;
    above the last row passivity closes the end, and none are needed where the device is passive. Neighbouring |f - f1|
    there may be apart by a ratio of 1.3, or by the half width of the modes between them (the distance of the nearest
    pole from the middle of the gap, as |s - p|/2 pi). Below the lowest |f - f1| no mode may be narrower than that.
    """
    nu = _PLACES_HZ
    active, gain = _active_and_gain(unit, grid, nu)
    needed = active | ((gain > 1.0) & (nu <= nu_hz[-1]))
    return all(_closed_at(x, nu_hz, modes) for x in nu[needed])


def covers_all_but_faint(unit: Unit, grid: tuple[float, float], nu_hz: np.ndarray, modes: np.ndarray) -> bool:
    """The same with no row asked for where the device is active with a loop gain below `QUIET`.

    Rows are needed wherever it is active with a larger one, and, up to the last such frequency, wherever the loop gain
    is above `LOUD` (up to the last row where the device is passive).
    """
    nu = _PLACES_HZ
    active, gain = _active_and_gain(unit, grid, nu)
    decisive = np.flatnonzero(active & (gain > QUIET))
    end = nu[decisive[-1]] if len(decisive) else nu_hz[-1]
    if end > nu_hz[-1]:
        return False
    needed = ((active & (gain > QUIET)) | (gain > LOUD)) & (nu <= end)
    return all(_closed_at(x, nu_hz, modes) for x in nu[needed])


def _active_and_gain(unit: Unit, grid: tuple[float, float], nu: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where the device is not passive, and the largest eigenvalue of Y Z (n,)."""
    y = unit.device.admittance(nu)
    least = np.linalg.eigvalsh((y + y.conj().transpose(0, 2, 1)) / 2.0)[:, 0]
    s = 2j * np.pi * nu
    z = (grid[0] + s * grid[1] / unit.bases.w1)[:, None, None] * np.eye(2) + grid[1] * J
    return least < -1e-3 * np.linalg.norm(y, axis=(1, 2)), np.abs(np.linalg.eigvals(y @ z)).max(axis=1)


def _is_hidden(unit: Unit, grid: tuple[float, float], unstable: np.ndarray, nu_hz: np.ndarray, noise: float) -> bool:
    if not len(unstable) or not np.isfinite(nu_hz[-1]):
        return False
    beyond = np.abs(unstable) > 2.0 * np.pi * nu_hz[-1]
    active, gain = _active_and_gain(unit, grid, nu_hz[-1:])
    beyond &= not bool(active[0] and gain[0] > 1.0)
    return all(out or _is_drowned(unit, pole, nu_hz, noise) for out, pole in zip(beyond, unstable, strict=True))


def _is_drowned(unit: Unit, pole: complex, nu_hz: np.ndarray, noise: float) -> bool:
    """Whether the device's own mode next to a closed-loop pole is lost in the errors of every row."""
    device = unit.device
    if noise == 0.0 or not isinstance(device, Linear):
        return False
    poles, vectors = np.linalg.eig(device.a)
    nearest = int(np.argmin(np.abs(poles - pole)))
    residue = np.outer(device.c @ vectors[:, nearest], np.linalg.solve(vectors, device.b.astype(complex))[nearest])
    part = np.linalg.norm(residue) / np.abs(2j * np.pi * nu_hz - poles[nearest])
    return bool(np.all(part < 2.0 * noise * np.linalg.norm(device.admittance(nu_hz), axis=(1, 2))))


def _closed_at(nu: float, rows: np.ndarray, modes: np.ndarray) -> bool:
    """Whether the rows on both sides of a frequency (Hz) are near enough."""
    if nu > rows[-1]:
        return False
    above = int(np.searchsorted(rows, nu))
    low, high = (rows[above - 1] if above > 0 else 0.0), rows[above]
    if low > 0.0 and high <= RATIO * low:
        return True
    middle = (low + high) / 2.0
    if low == 0.0:  # around f1: every mode in there is as wide as the hole
        inside = modes[np.abs(modes.imag) <= 2.0 * np.pi * high]
        return bool(np.all(np.abs(inside.real) >= 2.0 * np.pi * high))
    return bool(high - low <= np.abs(2j * np.pi * middle - modes).min() / (2.0 * np.pi))
