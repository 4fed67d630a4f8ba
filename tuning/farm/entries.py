"""A farm as it is written: what its file says of devices, network, damping control and grid-side dampers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from ...plant.errors import SeqsweepError
from ..network.assembly import Network


class FarmError(SeqsweepError):
    """A farm that cannot be judged as it is written, with the way out."""


class NoLoadFlow(FarmError):
    """A farm whose network cannot carry the power of its devices."""


@dataclass(frozen=True, slots=True)
class DeviceEntry:
    """One ``[[device]]``.

    Attributes
    ----------
    name, bus : str
        Name, and the bus that its terminals are.
    table : str
        File of its admittance, relative to the farm file.
    op : str or None
        Operating point of the table; None where a power is given instead, or the table has one point.
    active_power_mw, reactive_power_mvar : float or None
        With them Y comes from the surrogate of the table, at the terminal voltage that the load flow finds.
    count : int
        Equal devices in parallel at this bus.
    rating : float
        Rating in multiples of the swept device: Y and the powers times this number.
    """

    name: str
    bus: str
    table: str
    op: str | None
    active_power_mw: float | None
    reactive_power_mvar: float
    count: int
    rating: float

    @property
    def factor(self) -> float:
        """The whole entry in multiples of the swept device: rating times count."""
        return self.rating * self.count


@dataclass(frozen=True, slots=True)
class DampingEntry:
    """``[damping]``: what the devices' damping gain k multiplies, and which resonance the control is set to.

    Attributes
    ----------
    r_ohm, x_ohm : float or None
        Impedance at f1 that k multiplies, at the devices' terminals; None: the one that a device sees there.
    resonance_hz : float or None
        Signed frequency of the stronger component; None: that of the critical mode above f1.
    k_max : float
        Largest gain of a device.
    """

    r_ohm: float | None = None
    x_ohm: float | None = None
    resonance_hz: float | None = None
    k_max: float = 2.0


@dataclass(frozen=True, slots=True)
class DamperEntry:
    """One ``[[damper]]``: a grid-side damping converter.

    Attributes
    ----------
    name, bus : str
        Name, and the bus that it stands at.
    share : float
        Its rating as a share of the farm's; the limit of its current in time.
    size_s : float or None
        Length (S) of its pair of admittances at the mode; None: what damps the farm best.
    washout_hz : float
        What is slower in the dq frame it takes for the operating point; zero: it has no washout.
    """

    name: str
    bus: str
    share: float
    size_s: float | None
    washout_hz: float = 1.0


@dataclass(frozen=True, slots=True)
class FarmEntry:
    """A farm as it is written.

    Attributes
    ----------
    name : str
        Of the farm.
    f1_hz : float
        Fundamental (Hz).
    network : Network
        Branches between buses, the source's impedance to ground among them.
    voltages_v : mapping of str to float
        Rated voltage of every bus (V, line to line).
    source_bus : str
        Where the source's impedance ends.
    source_voltage_v : float
        Voltage behind it (V, line-to-line RMS).
    source_z_ohm : complex
        Its impedance at f1.
    devices : tuple of DeviceEntry
        Those in service.
    damping : DampingEntry
        Of their damping control.
    dampers : tuple of DamperEntry
        Grid-side damping converters in service.
    """

    name: str
    f1_hz: float
    network: Network
    voltages_v: Mapping[str, float]
    source_bus: str
    source_voltage_v: float
    source_z_ohm: complex
    devices: tuple[DeviceEntry, ...]
    damping: DampingEntry = DampingEntry()
    dampers: tuple[DamperEntry, ...] = ()
