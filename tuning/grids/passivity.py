"""Is a tabulated grid passive? Everything that is said of its own modes rests on that."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .errors import GridError
from .rational import RationalGrid
from .words import in_ohm

NEGATIVE = 0.01
"""Part of |Z| by which a row's resistance may be negative before it counts as active; noise may add to it."""

_STANDARD_ERRORS = 5.0
_DENSE = 2000


def checked_passive(
    grid: RationalGrid, f_hz: np.ndarray, z: np.ndarray, std: np.ndarray | None, notes: tuple[str, ...]
) -> RationalGrid:
    """The grid with its notes, or a refusal if its rows say that it is not passive.

    Raises
    ------
    GridError
        If rows have a negative resistance that noise does not explain.
    """
    noise = np.abs(z) * grid.misfit if std is None else np.maximum(std, np.abs(z) * grid.misfit)
    active = _active(z, noise)
    if len(active):
        raise _negative(grid.name, f_hz, z, active)
    if _is_conjugate(z):
        raise GridError(
            f"{grid.name}: the reactance is negative at all {len(z)} rows and falls with the frequency, to "
            f"{z[-1].imag:.4g} ohm at {f_hz[-1]:.4g} Hz: no path to a source does that. Is its sign, or the angle's, "
            "turned round?"
        )
    return replace(grid, notes=(*notes, *_fit_notes(grid)))


def refuse_turned(name: str, f_hz: np.ndarray, z: np.ndarray, std: np.ndarray | None) -> None:
    """Refuse rows most of which have a negative resistance: no function of a passive grid describes them.

    Raises
    ------
    GridError
        If so.
    """
    active = _active(z, np.zeros(len(z)) if std is None else std)
    if 2 * len(active) > len(z):
        raise _negative(name, f_hz, z, active)


def _active(z: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Indices of rows whose resistance is negative by more than ``noise`` (n,) in ohm explains."""
    return np.flatnonzero(z.real < -(NEGATIVE * np.abs(z) + _STANDARD_ERRORS * noise / np.sqrt(2.0)))


def _negative(name: str, f_hz: np.ndarray, z: np.ndarray, active: np.ndarray) -> GridError:
    worst = active[np.argmin(z[active].real / np.abs(z[active]))]
    return GridError(
        f"{name}: the resistance is negative at {len(active)} of {len(z)} rows (Z = {in_ohm(z[worst])} ohm at "
        f"{f_hz[worst]:.4g} Hz): a passive grid has none. Is its sign, or its angle, turned round? A grid with "
        "converters in it is given as a 2x2 table: seqsweep import"
    )


def _is_conjugate(z: np.ndarray) -> bool:
    """Whether all rows (n,) look like the conjugate of an inductance: negative, and the further up the more so."""
    return bool(np.all(z.imag < 0.0) and np.all(np.diff(z.imag) < 0.0) and z[-1].imag < 2.0 * z[0].imag)


def _fit_notes(grid: RationalGrid) -> list[str]:
    """What the fitted function itself has to say: its misfit, and a resistance below zero between the rows."""
    rows = grid.rows_hz if grid.rows_hz is not None else np.array([1.0, 1e3])
    found = []
    if grid.misfit > 1e-3:
        found.append(f"the rational function misses the rows by {grid.misfit:.1%}")
    f = np.geomspace(rows[0], rows[-1], _DENSE)
    z = grid.impedance(2j * np.pi * f)
    lowest = int(np.argmin(z.real / np.abs(z)))
    if z[lowest].real < -1e-6 * np.abs(z[lowest]):
        found.append(
            f"the fitted resistance is {z[lowest].real / np.abs(z[lowest]):.1%} of |Z| at {f[lowest]:.4g} Hz: not "
            "quite passive there"
        )
    if (inductance := grid.e) < 0.0:
        found.append(f"the fitted inductance at high frequency is negative ({inductance:.2g} H): the band ends early")
    return found
