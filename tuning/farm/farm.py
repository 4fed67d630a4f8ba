"""A farm from its document to its answer: load flow, devices where they stand, verdict; and the farm as one table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...identify.frames import dq_to_pn
from ...identify.response import FrequencyResponse
from .dampers import Damper, dampers_of
from .entries import FarmEntry
from .judge import FarmVerdict, judge_farm
from .pairs import to_dq
from .system import System, system_of
from .tree import reduced, tree_behind_source
from .units import FAR, Library, ReadTable, Unit, units_of

_NAMED = 3  # devices that one warning names


@dataclass(frozen=True, slots=True)
class Farm:
    """A judged farm.

    Attributes
    ----------
    entry : FarmEntry
        What was asked.
    units : tuple of Unit
        The devices where they stand.
    dampers : tuple of Damper
        Grid-side damping converters as they are set.
    system : System
        All joined, the devices first.
    judgement : FarmVerdict
        Verdict and modes.
    """

    entry: FarmEntry
    units: tuple[Unit, ...]
    dampers: tuple[Damper, ...]
    system: System
    judgement: FarmVerdict

    def __repr__(self) -> str:
        from .result import text_of

        return text_of(self)

    def _repr_html_(self) -> str:
        from .result import as_html

        return as_html(self)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Devices whose terminal voltage is not that of their sweep, and why the verdict is not certain."""
        return (*_off_sweep(self.units), *self.judgement.remarks)


def _off_sweep(units: Sequence[Unit]) -> tuple[str, ...]:
    """Devices whose terminal voltage is not that of their sweep, in one sentence."""
    off = {unit.name: 100.0 * unit.off for unit in units if abs(unit.off) > FAR}
    if not off:
        return ()
    worst = sorted(off, key=lambda name: -abs(off[name]))
    named = ", ".join(f"{name} {off[name]:+.1f} %" for name in worst[:_NAMED])
    more = f" and {len(off) - _NAMED} more" if len(off) > _NAMED else ""
    advice = "sweep it there" if len(off) == 1 else "sweep them there"
    return (
        f"terminal voltages that are not those of the sweeps: {named}{more}; {advice}, or give active_power_mw and "
        "a table over several voltages",
    )


def judged(entry: FarmEntry, read: ReadTable | Library) -> Farm:
    """Load flow, fit and verdict.

    Parameters
    ----------
    entry : FarmEntry
        The farm.
    read : callable or Library
        File name of a device's table to the table; a `Library` keeps what was fitted for the next farm.

    Raises
    ------
    FarmError
        If tables and farm do not fit, or the load flow has no solution.
    """
    units, _ = units_of(entry, read)
    return judged_with(entry, units)


def judged_with(entry: FarmEntry, units: Sequence[Unit], dampers: tuple[Damper, ...] | None = None) -> Farm:
    """Verdict of a farm whose devices are known where they stand; its dampers are set here unless they are given."""
    units = tuple(units)
    if dampers is None:
        dampers = dampers_of(entry, units, _critical(entry, units)) if entry.dampers else ()
    system = system_of((*units, *(damper.unit for damper in dampers)), entry.network, entry.f1_hz)
    return Farm(entry, units, dampers, system, judge_farm(system))


def _critical(entry: FarmEntry, units: tuple[Unit, ...]) -> complex | None:
    """The critical mode of the farm without its dampers."""
    mode = judge_farm(system_of(units, entry.network, entry.f1_hz)).critical
    return None if mode is None else mode.pole


def seen_from_source(farm: Farm, f_hz: Sequence[float] | np.ndarray) -> FrequencyResponse:
    """The admittance of the whole farm at the source's bus as a response, current into the farm.

    It carries ``stable_on`` the source's impedance where the farm's own verdict on it is "stable", internal modes
    included.
    """
    f, z = np.asarray(f_hz, dtype=float), farm.entry.source_z_ohm
    fact = {"grid": {"r_ohm": z.real, "x_ohm": z.imag}, "basis": "stated"}
    known = {"stable_on": fact} if farm.judgement.verdict == "stable" else {}
    y = admittance_at_source(farm, f)
    return FrequencyResponse(f, y, farm.entry.f1_hz, meta={"op_id": "farm", **known})


def admittance_at_source(farm: Farm, f_hz: np.ndarray) -> np.ndarray:
    """Ypn (n, 2, 2) in S of the whole farm at the source's bus, the source taken away, at signed frequencies (Hz).

    Notes
    -----
    With the source's impedance Zs in place the bus shows Z_t = (Y + Ys)^-1, so Y = Z_t^-1 - Ys.
    """
    entry = farm.entry
    system = system_of(farm.system.units, entry.network, entry.f1_hz, [entry.source_bus])
    s = 2j * np.pi * (f_hz - entry.f1_hz)
    if system.tree is not None:
        return dq_to_pn(to_dq(reduced(tree_behind_source(entry), s, system.by_bus(s)).y))
    z = system.impedance(s)
    total = np.linalg.solve(np.eye(z.shape[1]) + z @ system.admittance(s), z)
    at = 2 * system.ports.index(entry.source_bus)
    own = np.linalg.inv(total[:, at : at + 2, at : at + 2]) - np.linalg.inv(source_dq(entry, s))
    return dq_to_pn(own)


def source_dq(entry: FarmEntry, s: np.ndarray) -> np.ndarray:
    """Impedance (n, 2, 2) of the source in dq (ohm) at complex ``s`` (n,) in rad/s."""
    w1 = 2.0 * np.pi * entry.f1_hz
    z, l_h = entry.source_z_ohm, entry.source_z_ohm.imag / w1
    own = z.real + s * l_h
    return own[:, None, None] * np.eye(2) + z.imag * np.array([[0.0, -1.0], [1.0, 0.0]])
