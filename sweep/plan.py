"""The plan as data: every shot of a campaign, printable and countable before anything runs.

A shot is one experiment: one operating point, one injected frequency. A point needs two of them, at
f and at its mirror 2 f1 - f. Points are gathered into batches, the unit of work and of what is kept
on disk; which points share a batch follows from the plan alone, never from how it is run. A batch
carries its shots, and a shot its injection and its window: whoever measures one needs no plan.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..identify.table.format import canonical_json
from ..plant.circuits.circuit import Circuit
from ..plant.errors import SeqsweepError
from ..plant.protocol import Injection, InjectionKind, OperatingPoint, Source, Tone, Window
from ..plant.registry import PlantSpec
from .excitation.frequencies import Block, Frequency
from .excitation.signals import AXES, Axis, Signal, negated, tones

if TYPE_CHECKING:
    from .excitation.adaptive_rounds import Adaptive  # a worker of black boxes needs none of its fits

RESULT_VERSION = 4
"""Part of every hash: raise it when the same shot gives another number."""

EXPECTED_WINDOWS = 3.0
"""Windows of a shot until two agree, as a guess before it has run (reference turbine: 2 to 5, idle lanes included)."""


SETTLE_S = 0.5
"""Simulated time (s) of a broadband signal before its first period that is listened to: fast modes die out in it."""

PROBE_AMPLITUDE = 0.5
"""Amplitude of a probe, in parts of the sweep's."""


class PlanError(SeqsweepError):
    """A campaign that this plant cannot run, with the way out."""


@dataclass(frozen=True, slots=True)
class Grid:
    """The Thevenin grid of one operating point: source voltage (V, line-to-line RMS) and impedance.

    ``circuit`` are its elements, if it is no R + jX: r_ohm and l_h (negative if it is capacitive) are then what the PCC
    sees at f1, ``no_load`` is the PCC's voltage over the source's where no current flows.
    """

    r_ohm: float
    l_h: float
    voltage_v: float
    circuit: Circuit | None = None
    document: Mapping[str, Any] | None = None
    scale: float = 1.0
    no_load: float = 1.0

    def facts(self) -> dict[str, Any]:
        """What the result depends on."""
        plain = {"r_ohm": self.r_ohm, "l_h": self.l_h, "voltage_v": self.voltage_v}
        return plain if self.circuit is None else {**plain, "circuit": self.circuit.facts()}


@dataclass(frozen=True, slots=True)
class Condition:
    """An operating point as the plan knows it; |v_pcc| is None where the grid decides it."""

    op_id: str
    active_power_w: float
    terminal_voltage_v: float | None
    grid: Grid | None = None
    reactive_power_var: float = 0.0

    def facts(self) -> dict[str, Any]:
        """What the result depends on."""
        plain = {field.name: getattr(self, field.name) for field in fields(self)}
        return {**plain, "grid": None if self.grid is None else self.grid.facts()}


@dataclass(frozen=True, slots=True)
class Shot:
    """One experiment with a tone.

    Attributes
    ----------
    op_id : str
        Operating point.
    injection : Injection
        Its tone: signed frequency (Hz), the point's own or its mirror, and phase peak (V or A).
    window : Window
        Where it is listened to: the point it serves (Hz), and blocks of one window.
    """

    op_id: str
    injection: Injection
    window: Window

    @property
    def f_hz(self) -> float:
        """The point it serves (Hz)."""
        return self.window.f_hz

    @property
    def injected_hz(self) -> float:
        """Signed frequency of the tone: ``f_hz`` or its mirror (Hz)."""
        return self.injection.tones[0].f_hz

    def facts(self) -> dict[str, Any]:
        """What the result depends on."""
        return {
            "op_id": self.op_id,
            "f_hz": self.f_hz,
            "injected_hz": self.injected_hz,
            "amplitude": self.injection.tones[0].amplitude,
            "window_blocks": self.window.n_blocks,
        }


Aim = tuple[Injection, Window]
"""What a shot injects, and what it listens to: the same at every operating point."""


@dataclass(frozen=True, slots=True)
class Play:
    """One experiment with a broadband signal.

    Attributes
    ----------
    op_id : str
        Operating point.
    axis : "d" or "q"
        Along which axis of the PCC voltage.
    sign : 1 or -1
        As it is, or turned over.
    amplitude : float
        Peak of the space vector (V or A, phase peak).
    kind : "series_voltage" or "shunt_current"
        How the device is perturbed.
    signal : Signal
        What is played.
    f1_hz : float
        Fundamental (Hz): the axes turn with it.
    """

    op_id: str
    axis: Axis
    sign: int
    amplitude: float
    kind: InjectionKind
    signal: Signal = field(repr=False)
    f1_hz: float

    def injection(self, angle_rad: float) -> Injection:
        """The perturbation, where the PCC voltage stands at ``angle_rad`` at time zero."""
        signal = self.signal if self.sign > 0 else negated(self.signal)
        return Injection(self.kind, tones(signal, self.axis, self.f1_hz, self.amplitude, angle_rad))

    def facts(self) -> dict[str, Any]:
        """What the result depends on, besides the signal."""
        return {"op_id": self.op_id, "axis": self.axis, "sign": self.sign, "amplitude": self.amplitude}


@dataclass(frozen=True, slots=True)
class Limits:
    """When a shot is over: windows agree within ``tolerance``, or, on a noisy device, their mean is known to
    ``uncertainty`` (relative standard error); at the latest after ``max_simulated_s`` (s).

    ``highest_hz`` is the upper end of the band that is swept (Hz): modes beyond it are not looked for.
    """

    tolerance: float
    uncertainty: float
    max_simulated_s: float
    highest_hz: float


@dataclass(frozen=True, slots=True)
class Hosting:
    """Where the plant lives, and what it may use.

    Attributes
    ----------
    spec : PlantSpec
        Its name and parameters.
    isolate : bool
        Whether it lives in processes of its own.
    timeout_s : float or None
        Wall time (s) that a shot may take.
    memory_mb : float or None
        Memory (MB) that one of its processes may use.
    """

    spec: PlantSpec
    isolate: bool
    timeout_s: float | None = None
    memory_mb: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Batch:
    """Points of one operating point that are measured together, and all that it takes to measure them.

    Attributes
    ----------
    condition : Condition
        Operating point.
    source : Source
        What feeds the PCC.
    points : tuple of Frequency
        Neighbours in window length, not in frequency.
    aims : tuple of tuple of (Injection, Window)
        Per point what its experiments inject and listen to, in pairs: at f and at the mirror; empty where a signal is
        played. Batches of all operating points share them: they are most of what a batch holds.
    plays : tuple of Play
        Of all points together, in pairs of opposite signs: along d and along q; empty where tones are injected.
    limits : Limits
        When a shot is over.
    block : Block
        The unit in which windows are cut.
    f1_hz, dt_s : float
        Fundamental (Hz) and step (s) of the plant.
    amplitude_pu : float
        Peak of its tones, or of its signal (pu).
    key : str
        Hash of everything the result depends on: the name of its shard.
    """

    condition: Condition
    source: Source
    points: tuple[Frequency, ...]
    aims: tuple[tuple[Aim, ...], ...]
    plays: tuple[Play, ...]
    limits: Limits
    block: Block
    f1_hz: float
    dt_s: float
    amplitude_pu: float
    key: str = ""

    @property
    def n_shots(self) -> int:
        """Number of experiments."""
        return len(self.plays) or sum(len(of_point) for of_point in self.aims)

    @property
    def shots(self) -> tuple[tuple[Shot, ...], ...]:
        """Per point its experiments."""
        return tuple(tuple(Shot(self.condition.op_id, *aim) for aim in of_point) for of_point in self.aims)

    @property
    def cycles(self) -> np.ndarray | None:
        """Lines of the signal that is played, in cycles of its period; None where tones are injected."""
        return self.plays[0].signal.cycles if self.plays else None

    def alone(self, k: int) -> Batch:
        """Point ``k`` of the batch by itself."""
        return replace(self, points=self.points[k : k + 1], aims=self.aims[k : k + 1])

    def facts(self) -> dict[str, Any]:
        """What the result depends on, as far as the batch knows."""
        signal = self.plays[0].signal if self.plays else None
        return {
            "source": _source_facts(self.source),
            "tolerance": self.limits.tolerance,
            "uncertainty": self.limits.uncertainty,
            "max_simulated_s": self.limits.max_simulated_s,
            "condition": self.condition.facts(),
            "points": [{name: getattr(point, name) for name in Frequency.__slots__} for point in self.points],
            "shots": [shot.facts() for of_point in self.shots for shot in of_point] or [p.facts() for p in self.plays],
            "signal": None if signal is None else _signal_facts(signal),
        }


@dataclass(frozen=True)
class Plan:
    """Everything a campaign will do.

    Attributes
    ----------
    hosting : Hosting
        Where the plant lives.
    plant_fingerprint : mapping
        What it is, for hashes and metadata.
    f1_hz, dt_s : float
        Fundamental (Hz) and step (s) of the plant.
    block : Block
        The unit in which windows are cut.
    points : tuple of Frequency
        Ascending; of an adaptive grid the first round.
    conditions : tuple of Condition
        Operating points in campaign order.
    source : Source
        What feeds the PCC.
    kind : "series_voltage" or "shunt_current"
        How it is perturbed.
    signal : Signal or None
        What is played for all points at once; None: a tone for each.
    amplitude : float
        Peak of a tone, or of the signal (V or A).
    probes : frozenset of float
        Frequencies (Hz) of the points that are swept at `PROBE_AMPLITUDE` as well.
    automatic : bool
        Whether ``amplitude_pu`` is a limit, and pilots find the amplitude below it.
    limits : Limits
        When a shot is over.
    amplitude_pu, nonlinear_above : float
        From the configuration.
    batch_pairs : int
        Pairs of shots of a batch.
    configuration : mapping
        The whole configuration, as it is stored.
    warnings : tuple of str
        What the user should know before it runs.
    adaptive : Adaptive or None
        What the further rounds are asked for; None where ``points`` are all.
    """

    hosting: Hosting
    plant_fingerprint: Mapping[str, Any]
    f1_hz: float
    dt_s: float
    block: Block
    points: tuple[Frequency, ...]
    conditions: tuple[Condition, ...]
    source: Source
    kind: InjectionKind
    signal: Signal | None
    amplitude: float
    probes: frozenset[float]
    amplitude_pu: float
    automatic: bool
    limits: Limits
    nonlinear_above: float
    batch_pairs: int
    configuration: Mapping[str, Any]
    warnings: tuple[str, ...] = field(default=())
    adaptive: Adaptive | None = None

    def shots(self) -> Iterator[Shot | Play]:
        """Every experiment, in campaign order."""
        for condition in self.conditions:
            if self.signal is not None:
                yield from self.plays_of(condition)
                continue
            for point in self.points:
                yield from self.shots_of(condition, point)

    def shots_of(self, condition: Condition, point: Frequency) -> tuple[Shot, ...]:
        """The experiments of one point, in pairs: at f and at the mirror 2 f1 - f. A probe has a second pair."""
        return tuple(Shot(condition.op_id, *aim) for aim in self._aims_of(point))

    def _aims_of(self, point: Frequency) -> tuple[Aim, ...]:
        f = point.f_hz
        amplitudes = (1.0, PROBE_AMPLITUDE) if f in self.probes else (1.0,)
        return tuple(
            (Injection(self.kind, (Tone(at, part * self.amplitude),)), Window(f, point.window_blocks))
            for part in amplitudes
            for at in (f, 2.0 * self.f1_hz - f)
        )

    def plays_of(self, condition: Condition) -> tuple[Play, ...]:
        """The experiments of all points together: along d and along q, each with both signs."""
        if self.signal is None:
            return ()
        return tuple(
            Play(condition.op_id, axis, sign, self.amplitude, self.kind, self.signal, self.f1_hz)
            for axis in AXES
            for sign in (1, -1)
        )

    @cached_property
    def n_shots(self) -> int:
        """Number of experiments."""
        if self.signal is not None:
            return 4 * len(self.conditions)
        return 2 * len(self.conditions) * (len(self.points) + len(self.probes))

    @cached_property
    def simulated_s(self) -> float:
        """Simulated seconds to expect."""
        if self.signal is not None:
            return self.n_shots * (SETTLE_S + 2.0 * self.signal.period_s)
        blocks = sum(point.window_blocks * (1 + (point.f_hz in self.probes)) for point in self.points)
        return 2 * len(self.conditions) * EXPECTED_WINDOWS * blocks * self.block.duration_s

    def groups(self) -> list[tuple[Frequency, ...]]:
        """Points that are measured together, longest windows first."""
        return [self.points] if self.signal is not None else _gathered(self.points, self.probes, self.batch_pairs)

    def batches(self) -> Iterator[Batch]:
        """Work in the order in which it is best begun: longest windows first, per operating point."""
        return (make() for make in self.makers())

    def makers(self) -> Iterator[Callable[[], Batch]]:
        """What makes each of the `batches`: whoever needs a few of many need not make the others."""
        for condition in self.conditions:
            for of_any in self._at_any_condition:
                yield partial(of_any.batch, condition)

    def batches_at(self, condition: Condition) -> list[Batch]:
        """The batches of one operating point."""
        return [of_any.batch(condition) for of_any in self._at_any_condition]

    def batch(self, condition: Condition, points: tuple[Frequency, ...]) -> Batch:
        """Some points of an operating point as a unit of work, under the hash of all that its result depends on."""
        return self._of_points(points).batch(condition)

    @property
    def _at_any_condition(self) -> list[_AtAnyCondition]:
        """Kept where several operating points share it: of 100,000 with a plan each it would be most of the memory."""
        return self._shared if len(self.conditions) > 1 else self._made()

    @cached_property
    def _shared(self) -> list[_AtAnyCondition]:
        return self._made()

    def _made(self) -> list[_AtAnyCondition]:
        return [self._of_points(group) for group in self.groups()]

    def _of_points(self, points: tuple[Frequency, ...]) -> _AtAnyCondition:
        batch = Batch(
            condition=_ANY,
            source=self.source,
            points=points,
            aims=() if self.signal is not None else tuple(self._aims_of(point) for point in points),
            plays=self.plays_of(_ANY),
            limits=self.limits,
            block=self.block,
            f1_hz=self.f1_hz,
            dt_s=self.dt_s,
            amplitude_pu=self.amplitude_pu,
        )
        return _AtAnyCondition(batch, canonical_json({**batch.facts(), **self._facts()}))

    def at(self, amplitude_pu: float) -> Plan:
        """The plan at another amplitude."""
        if amplitude_pu == self.amplitude_pu:
            return self
        return replace(self, amplitude=self.amplitude * amplitude_pu / self.amplitude_pu, amplitude_pu=amplitude_pu)

    def _facts(self) -> dict[str, Any]:
        """What every result depends on."""
        return {
            "version": RESULT_VERSION,
            "plant": dict(self.plant_fingerprint),
            "kind": self.kind,
            "isolate": self.hosting.isolate,
            "timeout_s": self.hosting.timeout_s,
            **({} if self.hosting.memory_mb is None else {"memory_mb": self.hosting.memory_mb}),
        }


_ANY = Condition("\0", 0.0, None)
"""Stands for an operating point; no name of one holds such a character."""


class _AtAnyCondition(NamedTuple):
    """A batch but for its operating point, and the text whose hash is its key.

    Most of the text are its shots, the same at all operating points: made once, a key is ten times as quick.
    """

    of_any: Batch
    text: str

    def batch(self, condition: Condition) -> Batch:
        """The batch at an operating point, under the hash of all that its result depends on."""
        facts = self.text.replace(canonical_json(_ANY.facts()), canonical_json(condition.facts()))
        facts = facts.replace(canonical_json(_ANY.op_id), canonical_json(condition.op_id))
        key = hashlib.sha256(facts.encode()).hexdigest()
        plays = tuple(replace(play, op_id=condition.op_id) for play in self.of_any.plays)
        return replace(self.of_any, condition=condition, plays=plays, key=key)


def _signal_facts(signal: Signal) -> dict[str, Any]:
    return {
        "kind": signal.kind,
        "period_s": signal.period_s,
        "cycles": signal.cycles,
        "phasors": np.stack([signal.phasors.real, signal.phasors.imag]),
    }


def _gathered(points: tuple[Frequency, ...], probes: frozenset[float], most: int) -> list[tuple[Frequency, ...]]:
    """Groups of up to ``most`` pairs of shots, longest windows first; a probe takes two."""
    groups: list[list[Frequency]] = []
    pairs = most
    for point in sorted(points, key=lambda point: (-point.window_blocks, point.f_hz)):
        of_point = 1 + (point.f_hz in probes)
        if pairs + of_point > most:
            groups.append([])
            pairs = 0
        groups[-1].append(point)
        pairs += of_point
    return [tuple(group) for group in groups]


def operating_point(condition: Condition) -> OperatingPoint:
    """The condition as the plant takes it."""
    return OperatingPoint(condition.active_power_w, condition.terminal_voltage_v, condition.reactive_power_var)


def _source_facts(source: Source) -> dict[str, Any]:
    """What a result depends on of a source."""
    plain = asdict(replace(source, circuit=None))
    del plain["circuit"]
    return plain if source.circuit is None else {**plain, "circuit": source.circuit.facts()}
