"""The promise of a plant: settle once, branch many times, mutate nothing.

Everything above this folder knows a plant by this file alone. Quantities are SI; space vectors
follow the phase-peak convention ``x = x_alpha + 1j*x_beta`` and the current is positive into the
device under test (load direction).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi
from typing import Any, Literal, NamedTuple, Protocol, runtime_checkable

import numpy as np

from .circuits.circuit import Circuit
from .circuits.dynamics import Fault
from .space_vectors import PHASE_PEAK

InjectionKind = Literal["series_voltage", "shunt_current"]
SourceDirection = Literal["load", "generator"]


@dataclass(frozen=True, slots=True)
class Rating:
    """What one per unit means.

    Attributes
    ----------
    voltage_v : float
        Rated line-to-line RMS voltage (V).
    power_va : float
        Rated apparent power (VA).
    """

    voltage_v: float
    power_va: float

    @property
    def peak_voltage_v(self) -> float:
        """Rated phase-peak voltage, sqrt(2/3) U (V)."""
        return PHASE_PEAK * self.voltage_v

    @property
    def peak_current_a(self) -> float:
        """Rated phase-peak current, sqrt(2) S / (sqrt(3) U) (A)."""
        return PHASE_PEAK * self.power_va / self.voltage_v


@dataclass(frozen=True, slots=True)
class OperatingPoint:
    """A stationary condition of the device.

    Attributes
    ----------
    active_power_w : float
        Active power out of the device (W); what is metered is the plant's ``power_meaning``.
    terminal_voltage_v : float or None
        |v_pcc| as line-to-line RMS (V); None where the source fixes its own voltage instead.
    reactive_power_var : float
        Reactive power out of the device (var); a device without a set-point for it takes 0 alone.
    """

    active_power_w: float
    terminal_voltage_v: float | None
    reactive_power_var: float = 0.0


@dataclass(frozen=True, slots=True)
class OperatingRange:
    """Closed intervals in which a plant may be asked to settle: (lowest, highest).

    A device without a set-point for reactive power leaves ``reactive_power_var`` at its default: it takes 0 alone.
    """

    active_power_w: tuple[float, float]
    terminal_voltage_v: tuple[float, float]
    reactive_power_var: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Source:
    """What feeds the PCC.

    Attributes
    ----------
    kind : "ideal", "thevenin" or "network"
        An ideal source holds v_pcc itself; a Thevenin source stands behind r + s l, that of a network behind a circuit.
    r_ohm, l_h : float
        Series impedance of a Thevenin source (ohm, H).
    voltage_v : float or None
        Source voltage, line-to-line RMS (V). None: it follows from the operating point's |v_pcc|.
    angle_rad : float
        Angle of the source voltage's space vector at time zero (rad).
    settle_on : (r_ohm, l_h) or None
        A friendlier impedance (ohm, H), behind which a device that has to be waited for starts and from where it is
        walked to this source; a device whose equilibrium is solved for does not need it.
    circuit : Circuit or None
        Elements between PCC and source, of a network.
    """

    kind: Literal["ideal", "thevenin", "network"] = "ideal"
    r_ohm: float = 0.0
    l_h: float = 0.0
    voltage_v: float | None = None
    angle_rad: float = 0.0
    settle_on: tuple[float, float] | None = None
    circuit: Circuit | None = None


@dataclass(frozen=True, slots=True)
class Tone:
    """One rotating perturbation ``amplitude * exp(1j*(2*pi*f_hz*t + phase_rad))``.

    ``f_hz`` is signed (+ positive sequence, - negative sequence); ``amplitude`` is a phase peak
    (V or A); ``t`` is the time of the plant's state, not the time since the branch.
    """

    f_hz: float
    amplitude: float
    phase_rad: float = 0.0


@dataclass(frozen=True, slots=True)
class Injection:
    """A perturbation: tones added to the source voltage, or driven as current into the PCC."""

    kind: InjectionKind
    tones: tuple[Tone, ...]


class State(Protocol):
    """A value from which a plant can go on; opaque but for its time. Never mutated."""

    @property
    def time_s(self) -> float: ...


class Job(NamedTuple):
    """One experiment: branch from ``state`` under ``injection`` (None: unperturbed)."""

    state: Any
    injection: Injection | None


@dataclass(frozen=True, slots=True)
class Record:
    """PCC waveforms as space vectors, uniformly sampled.

    Attributes
    ----------
    t0_s, dt_s : float
        Time of the first sample and the sampling step (s).
    v, i : (n,) complex
        Voltage (V) and current (A) as phase-peak space vectors, current in load direction.
    f1_hz : float
        Fundamental frequency (Hz).
    source_direction : "load" or "generator"
        The direction in which the current was found; ``i`` is load direction whatever it says.
    origin : str
        Where the record comes from, for people.
    """

    t0_s: float
    dt_s: float
    v: np.ndarray
    i: np.ndarray
    f1_hz: float
    source_direction: SourceDirection = "load"
    origin: str = ""

    @property
    def time_s(self) -> np.ndarray:
        """Sample times (n,) in s."""
        return self.t0_s + self.dt_s * np.arange(len(self.v))


class Window(NamedTuple):
    """How a job is listened to: the line, and the length of its tapered windows.

    ``f_hz`` is signed; the mirror 2 f1 - f is always listened to as well. Windows follow one
    another, each ``n_blocks`` blocks long; ``first_block`` is the job's first block, counted from
    the start of a window (a job that goes on in the middle of one).
    """

    f_hz: float
    n_blocks: int
    first_block: int = 0


@dataclass(frozen=True, slots=True)
class Phasors:
    """Sums over blocks of tapered, demodulated samples; consecutive blocks add up to windows.

    Attributes
    ----------
    v, i : (n_blocks, 2) complex
        ``sum_k w_k x_k exp(-2j*pi*f*t_k) dt / window`` of one block; columns: f and 2 f1 - f. Adding
        the ``Window.n_blocks`` blocks of one window gives the phasors (V, A).
    """

    v: np.ndarray
    i: np.ndarray


@runtime_checkable
class Plant(Protocol):
    """A device at the end of two terminals, driven in time.

    A plant mutates nothing: the same job gives the same answer, whatever ran before it or
    beside it. Wrong calls raise ``ValueError``; what physics refuses raises `NotSettled`.
    """

    id: str
    f1_hz: float
    dt_s: float
    rating: Rating
    operating_range: OperatingRange
    power_meaning: str

    def settle(self, operating_point: OperatingPoint, source: Source) -> Any:
        """Return the certified periodic steady state; raise `NotSettled` where there is none."""
        ...

    def run(self, jobs: Sequence[Job], n_steps: int) -> list[tuple[Any, Record]]:
        """Run every job ``n_steps`` further; records hold the samples at steps 0 ... n_steps - 1."""
        ...


@runtime_checkable
class PhasorPlant(Plant, Protocol):
    """Optional capability: phasors accumulated while stepping, no waveform in memory."""

    def run_phasors(
        self, jobs: Sequence[Job], windows: Sequence[Window], block_steps: int, n_blocks: int
    ) -> list[tuple[Any, Phasors]]:
        """Run every job ``n_blocks`` blocks of ``block_steps`` steps further, one window each."""
        ...


class PhasorRun(Protocol):
    """Jobs on their way together, listened to in blocks; each stands where its last stretch ended."""

    def go_on(self, who: np.ndarray, n_blocks: int) -> np.ndarray:
        """Run some jobs, by their numbers (n,), ``n_blocks`` blocks further.

        Returns
        -------
        (n, 2, n_blocks, 2) complex
            Sums of `Phasors` of v (V) and i (A) for each of them; last axis: f and 2 f1 - f.
        """
        ...


@runtime_checkable
class LanePlant(PhasorPlant, Protocol):
    """Optional capability: many jobs that go on stretch by stretch, without a state handed back in between."""

    def phasor_run(self, jobs: Sequence[Job], windows: Sequence[Window], block_steps: int) -> PhasorRun | None:
        """The jobs, ready to go on as `PhasorPlant.run_phasors` would; None where that is as good."""
        ...


class Compensation(NamedTuple):
    """What stands between measurement and controller: ``v_r = v - H_NF(s) (r_ohm + 1j*x_ohm) i_g``.

    ``x_ohm`` is w_r Lv, signed with w_r; i_g is positive *out of* the device, here alone. The circuit
    goes on with v. H_NF is a notch at the fundamental. Zero and zero: off.
    """

    r_ohm: float = 0.0
    x_ohm: float = 0.0


@dataclass(frozen=True, slots=True)
class Conditions:
    """What surrounds a device for a while, in `MeasuredPlant.trace`; what a device cannot do, it refuses by name.

    Attributes
    ----------
    r_ohm, l_h : float
        Series impedance of the Thevenin source (ohm, H); its voltage is that of the state.
    fault_s : (3,) float
        Conductance at the PCC (S): alpha-alpha, alpha-beta, beta-beta.
    wind_m_s : float or None
        Wind speed (m/s); None leaves it.
    power_scale : float
        Factor on the law by which the device chooses its power.
    compensation : Compensation or None
        At the measurement port; None is the plant's own.
    circuit : Circuit or None
        Elements between PCC and source, in place of R and L; branches are the same ones where their names are.
    """

    r_ohm: float
    l_h: float
    fault_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    wind_m_s: float | None = None
    power_scale: float = 1.0
    compensation: Compensation | None = None
    circuit: Circuit | None = None


@dataclass(frozen=True, slots=True)
class Trace:
    """A record and what else a person wants to see of a device.

    Attributes
    ----------
    record : Record
        v_pcc and current (load direction).
    v_dc_v : (n,) float
        Voltage of the DC link (V).
    rotor_rad_s : (n,) float
        Rotor speed (rad/s); NaN where there is no rotor.
    sync_rad : (n,) float
        Angle of the device's synchronisation ahead of the source voltage (rad), not wrapped; where nobody can see what
        the device synchronises by, that of v_pcc, smoothed.
    """

    record: Record
    v_dc_v: np.ndarray
    rotor_rad_s: np.ndarray
    sync_rad: np.ndarray


@runtime_checkable
class MeasuredPlant(Plant, Protocol):
    """Optional capability: a measurement port, and surroundings that change between two calls.

    The port is where the controller's v and i come from, and where damping control acts;
    ``compensation`` is what stands there unless a call says otherwise.
    """

    compensation: Compensation

    def equilibrium(self, operating_point: OperatingPoint, source: Source) -> Any:
        """The periodic state, stable or not; `NotSettled` where there is none, or none can be reached."""
        ...

    def trace(self, state: Any, conditions: Conditions, n_steps: int) -> tuple[Any, Trace]:
        """Go on from ``state`` under ``conditions``; samples at steps 0 ... n_steps - 1."""
        ...


@dataclass(frozen=True, slots=True)
class Member:
    """A device of a farm.

    Attributes
    ----------
    name, node : str
        Name, and the node of the network that its terminals are.
    active_power_w, reactive_power_var : float
        Out of one device (W, var).
    factor : float
        Equal devices that it stands for, sizes counted.
    """

    name: str
    node: str
    active_power_w: float
    reactive_power_var: float = 0.0
    factor: float = 1.0


@dataclass(frozen=True, slots=True)
class FarmConditions:
    """What surrounds the devices of a farm for a while.

    Attributes
    ----------
    circuit : Circuit
        The network: nodes of the devices, "source", "ground" and any others.
    source_v : float
        Voltage of its ideal source (V, line-to-line RMS).
    connected : (n,) tuple of bool
        Which devices are.
    power_scale : (n,) tuple of float
        Factor on the law by which each chooses its power.
    compensation : (n,) tuple of Compensation
        At each one's measurement port.
    dampers_on : (d,) tuple of bool
        Which grid-side dampers act.
    fault : Fault or None
        A short circuit at a node.
    watch : tuple of (str, str)
        What else is looked at: ("v", node) or ("i", branch).
    sizes : (n,) tuple of float
        What the members' factors are multiplied with; empty: one.
    """

    circuit: Circuit
    source_v: float
    connected: tuple[bool, ...]
    power_scale: tuple[float, ...]
    compensation: tuple[Compensation, ...]
    dampers_on: tuple[bool, ...] = ()
    fault: Fault | None = None
    watch: tuple[tuple[str, str], ...] = ()
    sizes: tuple[float, ...] = ()


class FarmTrace(NamedTuple):
    """Traces of all devices, and what else was watched (n_steps, w): phase-peak space vectors."""

    devices: tuple[Trace, ...]
    watched: np.ndarray


class Together(Protocol):
    """Devices that are stepped together on one network."""

    members: tuple[Member, ...]
    dampers: tuple[tuple[str, Any], ...]
    f1_hz: float
    dt_s: float
    rating: Rating

    def drawn(self, voltage_v: np.ndarray) -> np.ndarray:
        """Complex power (n,) in VA that each draws at |v| (n,) in V, line-to-line RMS."""
        ...

    def at_rest(self, conditions: FarmConditions, voltages_v: np.ndarray) -> Any:
        """The state where a load flow (n,) complex puts it, stable or not."""
        ...

    def joined(self, state: Any, conditions: FarmConditions, names: Sequence[str], voltages_v: np.ndarray) -> Any:
        """The state with devices put in service under ``conditions``."""
        ...

    def trace(self, state: Any, conditions: FarmConditions, n_steps: int) -> tuple[Any, FarmTrace]:
        """Go on under ``conditions``; samples at steps 0 ... n_steps - 1."""
        ...


@runtime_checkable
class FarmPlant(MeasuredPlant, Protocol):
    """Optional capability: many of it on one network."""

    def together(self, members: Sequence[Member], dampers: Sequence[tuple[str, Any]] = ()) -> Together:
        """Members on a network, with grid-side dampers (`damping.grid_side.GridSideDamper`) at nodes."""
        ...


@runtime_checkable
class RecordSource(Protocol):
    """Something that has records to offer but cannot be driven: files, a laboratory."""

    def records(self) -> Sequence[Record]: ...


class NotSettled(Exception):
    """The device has no certified steady state here; wrong physics, not a wrong call.

    Attributes
    ----------
    status : "not_settled" or "diverged"
        What the table shows for the operating point's rows.
    """

    def __init__(self, reason: str, status: Literal["not_settled", "diverged"] = "not_settled"):
        super().__init__(reason)
        self.status = status


def reactance_to_inductance(x_ohm: float, f1_hz: float) -> float:
    """Inductance (H) whose reactance at ``f1_hz`` is ``x_ohm``."""
    return x_ohm / (2.0 * pi * f1_hz)
