"""What the tables of a farm do not show, asked of each device on what it is connected to, as `tune` asks one device.

A farm is as sure as the least known of its devices: one whose rows leave room for a mode that would make the farm
unstable withholds the verdict, and one whose rows do not cover the question keeps it from being certain.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from ..basis import Basis
from ..feeding import hole_of
from ..near_f1 import NEAREST_HZ
from ..objections import (
    LIGHTLY_DAMPED,
    is_fed_around,
    said_of_end,
    said_of_held,
    said_of_hidden,
    said_of_hole,
    said_of_open,
)
from ..poles import SURELY, ClosedLoop, crowded, is_swept
from ..uncovered import KEPT, Seen, asked_if_stable
from .participation import ModeParts
from .rest import Rest, Whole
from .system import System
from .units import Unit

TAKES_PART = 0.1
"""Share of a mode from which on the rows of a device have to surround it."""


class Unshown(NamedTuple):
    """What is held against a verdict.

    Attributes
    ----------
    withheld : str
        Why none is given; empty where one is.
    sure : float
        How probable it is that nothing the rows leave open changes it.
    uncovered : str
        Why it is not certain, however small the errors; empty where it may be.
    """

    withheld: str = ""
    sure: float = 1.0
    uncovered: str = ""


def of_stable(system: System, poles: np.ndarray, modes: Sequence[ModeParts]) -> Unshown:
    """What may make a farm unstable that is stable by the fits of its tables.

    ``poles`` (m,) are those of the farm (rad/s), ``modes`` the ones that are told.
    """
    whole, upper = Whole(system), poles[poles.imag >= 0.0]
    found = [_of_device(unit, unit.basis, Rest(whole, unit), upper) for unit in system.units if unit.basis is not None]
    return Unshown(
        withheld=_first(one.withheld for one in found) or _unswept(system, whole, modes),
        sure=min((one.sure for one in found), default=1.0),
        uncovered=_first(one.uncovered for one in found),
    )


def of_unstable(system: System, modes: Sequence[ModeParts]) -> Unshown:
    """What is held against instability: modes that grow need rows of their devices around them."""
    grows = [mode for mode in modes if mode.pole.real > 0.0]
    told = [mode for mode in grows if not _silent(system, mode)]
    if grows and not told:
        unit = _silent(system, grows[0])[0]
        return Unshown(withheld=_of(unit, _no_rows(system, grows[0])))
    sure = [mode for mode in told if mode.pole.real > SURELY * mode.std.real]
    if not sure:
        return Unshown(uncovered="no unstable mode surely grows: sweep more points around them")
    if any(mode.pole.real > KEPT * float(np.sum(np.abs(mode.devices))) for mode in sure):
        return Unshown()
    return Unshown(uncovered=f"a change of every Y by less than {KEPT:.1%} of itself stops the growth")


def _of_device(unit: Unit, basis: Basis, rest: Rest, upper: np.ndarray) -> Unshown:
    """What the rows of one device leave open."""
    model, anchor = unit.model, basis.anchor
    hole = hole_of(model, rest, upper)
    loop = ClosedLoop(model.f1_hz, upper, np.zeros((len(upper), 2, 2)), np.zeros(len(upper), bool), None, None, hole)
    grids = (rest,) if anchor.grid is None else (rest, anchor.grid)
    hidden, why = asked_if_stable(Seen(model, loop, basis.rows, grids, None, crowded(model, hole)))
    near = bool(model.nu_hz[0] <= NEAREST_HZ)  # rows that tell slow modes of a farm on which side they are
    size_ohm = float(np.linalg.norm(rest.impedance_dq(np.zeros(1, complex))[0], 2))
    withheld = (
        said_of_end(model, rest)
        or said_of_hidden(model, hidden)
        or said_of_open(model, anchor, anchor.still_open)
        or said_of_held(model, anchor, size_ohm)
        or (said_of_hole(model, upper, lambda pole: near) if hole.start_hz == 0.0 else "")
    )
    harmless = 1.0 if hidden is None else hidden.harmless
    decays = 1.0 if anchor.still_open is None else anchor.still_open.decays
    return Unshown(_of(unit, withheld), min(harmless, decays), _of(unit, why))


def _unswept(system: System, whole: Whole, modes: Sequence[ModeParts]) -> str:
    """The first mode that decides without rows around it, of a device that takes part and may feed it there."""
    critical = max(modes, key=lambda mode: mode.pole.real, default=None)
    for mode in modes:
        if mode is not critical and -mode.pole.real > LIGHTLY_DAMPED * abs(mode.pole):
            continue
        nu_hz = mode.pole.imag / (2.0 * np.pi)
        fed = [unit for unit in _silent(system, mode) if is_fed_around(unit.model, Rest(whole, unit), nu_hz)]
        if fed:
            return _of(fed[0], _no_rows(system, mode))
    return ""


def _silent(system: System, mode: ModeParts) -> list[Unit]:
    """Devices that take part in a mode and whose rows do not surround it."""
    partners = [unit for unit, share in zip(system.units, mode.shares, strict=True) if share >= TAKES_PART]
    return [unit for unit in partners if unit.basis is not None and not is_swept(unit.model, mode.pole)]


def _no_rows(system: System, mode: ModeParts) -> str:
    nu_hz = mode.pole.imag / (2.0 * np.pi)
    place = f"{system.f1_hz - nu_hz:.4g}/{system.f1_hz + nu_hz:.4g} Hz"
    return f"a mode at {place} decides, and its table has no usable rows around it: sweep there"


def _of(unit: Unit, text: str) -> str:
    return f"{unit.name}: {text}" if text else ""


def _first(texts: Iterable[str]) -> str:
    """The first device of which something is said, and how many more there are."""
    said = [text for text in texts if text]
    more = "" if len(said) < 2 else f" ({len(said) - 1} more of the devices: the same or alike)"
    return f"{said[0]}{more}" if said else ""
