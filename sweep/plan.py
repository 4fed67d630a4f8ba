"""The plan as data: every shot of a campaign, printable and countable before anything runs.

A shot is one experiment: one operating point, one injected frequency. A point needs two of them, at
f and at its mirror 2 f1 - f. Points are gathered into batches, the unit of work and of what is kept
on disk; which points share a batch follows from the plan alone, never from how it is run.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from ..identify.table.format import content_hash
from ..plant.errors import SeqsweepError
from ..plant.protocol import (
    Injection,
    InjectionKind,
    OperatingPoint,
    Plant,
    Source,
    Tone,
    reactance_to_inductance,
)
from ..plant.registry import PlantCard, PlantSpec, card_of, runs_isolated
from .config.sections import DEFAULT_INTERPOLATION_TOLERANCE, Config, OperatingPointSection, SourceSection, SweepSection
from .excitation.adaptive_rounds import Adaptive, first_round
from .excitation.choice import broadband
from .excitation.frequencies import Block, Frequency, coherent_block, generated, listed
from .excitation.signals import AXES, Axis, Signal, negated, tones

RESULT_VERSION = 3
"""Part of every hash: raise it when the same shot gives another number."""

EXPECTED_WINDOWS = 3.0
"""Windows of a shot until two agree, as a guess before it has run (reference turbine: 2 to 5, idle lanes included)."""


ALIKE = 0.6
"""Shortest window of a batch in parts of its longest: points of a batch run equally long."""


TOGETHER = 4
"""Points whose eight shots fill the lanes of a compiled plant."""

ROWS_PER_PROBE = 14
"""One row in so many is swept at half the amplitude as well, to see whether the device is linear."""

LATE_DEGREES = 1.0
"""Turn of the admittance at the highest frequency from which on a plan warns."""

MIN_PROBES = 2

SETTLE_S = 0.5
"""Simulated time (s) of a broadband signal before its first period that is listened to: fast modes die out in it."""

PROBE_AMPLITUDE = 0.5
"""Amplitude of a probe, in parts of the sweep's."""


class PlanError(SeqsweepError):
    """A campaign that this plant cannot run, with the way out."""


@dataclass(frozen=True, slots=True)
class Grid:
    """The Thevenin grid of one operating point: source voltage (V, line-to-line RMS) and impedance."""

    r_ohm: float
    l_h: float
    voltage_v: float


@dataclass(frozen=True, slots=True)
class Condition:
    """An operating point as the plan knows it; |v_pcc| is None where the grid decides it."""

    op_id: str
    active_power_w: float
    terminal_voltage_v: float | None
    grid: Grid | None = None
    reactive_power_var: float = 0.0


@dataclass(frozen=True, slots=True)
class Shot:
    """One experiment.

    Attributes
    ----------
    op_id : str
        Operating point.
    f_hz : float
        The point it serves (Hz).
    injected_hz : float
        Signed frequency of the tone: ``f_hz`` or its mirror (Hz).
    amplitude : float
        Phase peak (V or A).
    window_blocks : int
        Blocks of one window.
    """

    op_id: str
    f_hz: float
    injected_hz: float
    amplitude: float
    window_blocks: int


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
    """

    op_id: str
    axis: Axis
    sign: int
    amplitude: float


@dataclass(frozen=True, slots=True)
class Batch:
    """Points of one operating point that are measured together.

    Attributes
    ----------
    condition : Condition
        Operating point.
    points : tuple of Frequency
        Neighbours in window length, not in frequency.
    amplitude_pu : float
        Peak of its tones, or of its signal (pu).
    key : str
        Hash of everything the result depends on: the name of its shard.
    """

    condition: Condition
    points: tuple[Frequency, ...]
    amplitude_pu: float
    key: str


@dataclass(frozen=True)
class Plan:
    """Everything a campaign will do.

    Attributes
    ----------
    spec : PlantSpec
        The plant by name.
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
    amplitude_pu, tolerance, uncertainty, nonlinear_above, max_simulated_s : float
        From the configuration.
    batch_pairs : int
        Pairs of shots of a batch.
    isolate : bool
        Whether the plant runs in processes of its own.
    timeout_s : float or None
        Wall time (s) that a shot of an isolated plant may take.
    configuration : mapping
        The whole configuration, as it is stored.
    warnings : tuple of str
        What the user should know before it runs.
    adaptive : Adaptive or None
        What the further rounds are asked for; None where ``points`` are all.
    """

    spec: PlantSpec
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
    tolerance: float
    uncertainty: float
    nonlinear_above: float
    max_simulated_s: float
    batch_pairs: int
    isolate: bool
    timeout_s: float | None
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
        f = point.f_hz
        amplitudes = (1.0, PROBE_AMPLITUDE) if f in self.probes else (1.0,)
        return tuple(
            Shot(condition.op_id, f, at, part * self.amplitude, point.window_blocks)
            for part in amplitudes
            for at in (f, 2.0 * self.f1_hz - f)
        )

    def plays_of(self, condition: Condition) -> tuple[Play, ...]:
        """The experiments of all points together: along d and along q, each with both signs."""
        return tuple(Play(condition.op_id, axis, sign, self.amplitude) for axis in AXES for sign in (1, -1))

    def injection(self, shot: Shot) -> Injection:
        """The perturbation of a shot."""
        return Injection(self.kind, (Tone(shot.injected_hz, shot.amplitude),))

    def play(self, play: Play, angle_rad: float) -> Injection:
        """The perturbation of a play, where the PCC voltage stands at ``angle_rad`` at time zero."""
        assert self.signal is not None
        signal = self.signal if play.sign > 0 else negated(self.signal)
        return Injection(self.kind, tones(signal, play.axis, self.f1_hz, play.amplitude, angle_rad))

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

    def batches(self) -> Iterator[Batch]:
        """Work in the order in which it is best begun: longest windows first, per operating point."""
        groups = [self.points] if self.signal is not None else _alike(self.points, self.probes, self.batch_pairs)
        for condition in self.conditions:
            for group in groups:
                yield Batch(condition, group, self.amplitude_pu, self._key(condition, group))

    def at(self, amplitude_pu: float) -> Plan:
        """The plan at another amplitude."""
        if amplitude_pu == self.amplitude_pu:
            return self
        return replace(self, amplitude=self.amplitude * amplitude_pu / self.amplitude_pu, amplitude_pu=amplitude_pu)

    def _key(self, condition: Condition, points: tuple[Frequency, ...]) -> str:
        return content_hash(
            {
                "version": RESULT_VERSION,
                "plant": dict(self.plant_fingerprint),
                "source": asdict(self.source),
                "kind": self.kind,
                "tolerance": self.tolerance,
                "uncertainty": self.uncertainty,
                "max_simulated_s": self.max_simulated_s,
                "isolate": self.isolate,
                "timeout_s": self.timeout_s,
                "condition": asdict(condition),
                "points": [asdict(point) for point in points],
                "shots": [asdict(shot) for shot in self._shots_of_all(condition, points)],
                "signal": None if self.signal is None else _signal_facts(self.signal),
            }
        )

    def shots_in(self, batch: Batch) -> tuple[Shot | Play, ...]:
        """The experiments of a batch."""
        return tuple(self._shots_of_all(batch.condition, batch.points))

    def _shots_of_all(self, condition: Condition, points: tuple[Frequency, ...]) -> Iterator[Shot | Play]:
        if self.signal is not None:
            return iter(self.plays_of(condition))
        return (shot for point in points for shot in self.shots_of(condition, point))


def _signal_facts(signal: Signal) -> dict[str, Any]:
    return {
        "kind": signal.kind,
        "period_s": signal.period_s,
        "cycles": signal.cycles,
        "phasors": np.stack([signal.phasors.real, signal.phasors.imag]),
    }


def make_plan(config: Config, plant: Plant | PlantCard) -> Plan:
    """What ``config`` asks of ``plant``, checked; nothing runs.

    A plant that is not to be loaded here is planned from its card.

    Raises
    ------
    PlanError
        If an operating point is outside the plant's range.
    GridError
        If frequencies are unusable.
    """
    spec = PlantSpec(config.plant.id, config.plant.parameters)
    card = plant if isinstance(plant, PlantCard) else card_of(plant, spec)
    signal, points, warnings = _signal_and_points(config, card)
    conditions = tuple(_condition(section, card) for section in config.operating_point)
    _check_range(conditions, card)
    voltage_like = config.injection.kind == "series_voltage"
    peak = card.rating.peak_voltage_v if voltage_like else card.rating.peak_current_a
    source = _source(config.source, card.f1_hz)
    return Plan(
        spec=spec,
        plant_fingerprint=card.fingerprint,
        f1_hz=card.f1_hz,
        dt_s=card.dt_s,
        block=coherent_block(card.f1_hz, card.dt_s),
        points=tuple(points),
        conditions=conditions,
        source=source,
        kind=config.injection.kind,
        signal=signal,
        amplitude=config.injection.largest_pu * peak,
        probes=frozenset() if signal is not None else frozenset(_probes(points, config.sweep.probes)),
        amplitude_pu=config.injection.largest_pu,
        automatic=config.injection.amplitude_pu == "auto",
        tolerance=config.sweep.tolerance,
        uncertainty=config.sweep.uncertainty,
        nonlinear_above=config.sweep.nonlinear_above,
        max_simulated_s=config.sweep.max_simulated_s,
        batch_pairs=_batch_pairs(len(points), len(conditions), card),
        isolate=runs_isolated(spec.id, config.plant.isolate),
        timeout_s=config.plant.timeout_s,
        configuration=config.to_dict(),
        warnings=(*warnings, *_lateness(card, points)),
        adaptive=_adaptive(config.sweep),
    )


def _lateness(card: PlantCard, points: Sequence[Frequency]) -> Iterator[str]:
    """A warning where what is held in a step comes so late that the admittance shows it."""
    late_s = card.fingerprint.get("held_late_s", 0.0)
    f_hz = max(abs(point.f_hz) for point in points)
    degrees = 360.0 * f_hz * late_s
    if degrees > LATE_DEGREES:
        yield (
            f"the voltage of a step of {card.dt_s:g} s is held from its start: half a step of delay, which turns Y by "
            f'-{degrees:.2g} degrees at {f_hz:g} Hz; a smaller dt_s makes it less, hold = "mean" takes it away '
            "(fmu: and process:)"
        )


def _signal_and_points(config: Config, plant: PlantCard) -> tuple[Signal | None, list[Frequency], list[str]]:
    if config.injection.signal == "tone":
        return None, *_points(config, plant)
    return broadband(config.sweep, config.injection, plant.f1_hz, plant.dt_s)


def _points(config: Config, plant: PlantCard) -> tuple[list[Frequency], list[str]]:
    sweep = config.sweep
    if sweep.f_hz is not None:
        return listed(sweep.f_hz, plant.f1_hz, plant.dt_s)
    assert sweep.f_min_hz is not None
    assert sweep.f_max_hz is not None
    assert sweep.points is not None
    if adaptive := _adaptive(sweep):
        return first_round(adaptive, plant.f1_hz, plant.dt_s, coherent_block(plant.f1_hz, plant.dt_s)), []
    points = generated(sweep.f_min_hz, sweep.f_max_hz, sweep.points, sweep.spacing, plant.f1_hz, plant.dt_s)
    fewer = f"the grid has {len(points)} points instead of {sweep.points}: neighbours met when they were snapped"
    return points, [fewer] if len(points) < sweep.points else []


def _probes(points: Sequence[Frequency], wanted: int | None) -> list[float]:
    """Frequencies (Hz) of the rows to probe: spread evenly over the rows, the ends among them."""
    n = max(MIN_PROBES, round(len(points) / ROWS_PER_PROBE)) if wanted is None else wanted
    at = np.unique(np.linspace(0, len(points) - 1, min(n, len(points))).round().astype(int))
    return [points[k].f_hz for k in at]


def _adaptive(sweep: SweepSection) -> Adaptive | None:
    if sweep.spacing != "adaptive":
        return None
    assert sweep.f_min_hz is not None
    assert sweep.f_max_hz is not None
    assert sweep.points is not None
    tolerance = sweep.interpolation_tolerance or DEFAULT_INTERPOLATION_TOLERANCE
    return Adaptive(sweep.f_min_hz, sweep.f_max_hz, sweep.points, tolerance)


def _source(section: SourceSection, f1_hz: float) -> Source:
    friend = section.settle_on
    return Source(
        section.kind,
        section.r_ohm,
        reactance_to_inductance(section.x_ohm, f1_hz),
        settle_on=None if friend is None else (friend.r_ohm, reactance_to_inductance(friend.x_ohm, f1_hz)),
    )


def _condition(section: OperatingPointSection, plant: PlantCard) -> Condition:
    power_w, u = section.active_power_mw * 1e6, plant.rating.voltage_v
    reactive_var = (section.reactive_power_mvar or 0.0) * 1e6
    if section.grid is None:
        assert section.terminal_voltage_pu is not None
        return Condition(section.id, power_w, section.terminal_voltage_pu * u, None, reactive_var)
    g = section.grid
    grid = Grid(g.r_ohm * g.scale, reactance_to_inductance(g.x_ohm * g.scale, plant.f1_hz), g.voltage_pu * u)
    return Condition(section.id, power_w, None, grid, reactive_var)


def _check_range(conditions: tuple[Condition, ...], plant: PlantCard) -> None:
    power, voltage = plant.operating_range.active_power_w, plant.operating_range.terminal_voltage_v
    u = plant.rating.voltage_v
    for condition in conditions:
        q_low, q_high = plant.operating_range.reactive_power_var
        named = [
            ("active_power_mw", condition.active_power_w / 1e6, power[0] / 1e6, power[1] / 1e6, "MW"),
            ("reactive_power_mvar", condition.reactive_power_var / 1e6, q_low / 1e6, q_high / 1e6, "Mvar"),
        ]
        if condition.terminal_voltage_v is not None:
            named.append(
                ("terminal_voltage_pu", condition.terminal_voltage_v / u, voltage[0] / u, voltage[1] / u, "pu")
            )
        for key, value, low, high, unit in named:
            if not low - 1e-9 * abs(low) <= value <= high + 1e-9 * abs(high):
                raise PlanError(
                    f"operating point {condition.op_id!r}: {key} = {value:g} {unit} is outside the operating range of "
                    f"{plant.id}, {low:g} to {high:g} {unit}"
                )


def _alike(points: tuple[Frequency, ...], probes: frozenset[float], most: int) -> list[tuple[Frequency, ...]]:
    """Groups of up to ``most`` pairs of shots, longest windows first; a probe takes two.

    Beyond the first few, which a compiled plant steps for the price of one, none is much shorter than
    its group's longest.
    """
    groups: list[list[Frequency]] = []
    pairs = 0
    for point in sorted(points, key=lambda point: (-point.window_blocks, point.f_hz)):
        of_point = 1 + (point.f_hz in probes)
        alike = groups and point.window_blocks >= ALIKE * groups[-1][0].window_blocks
        if groups and pairs + of_point <= (most if alike else min(most, TOGETHER)):
            groups[-1].append(point)
            pairs += of_point
        else:
            groups.append([point])
            pairs = of_point
    return [tuple(group) for group in groups]


def _batch_pairs(n_points: int, n_conditions: int, plant: PlantCard) -> int:
    """Small batches keep two cores busy and lose little; big ones settle and store less often."""
    if not plant.listens:
        return 1
    return 8 if n_points * n_conditions <= 1000 else 50


def operating_point(condition: Condition) -> OperatingPoint:
    """The condition as the plant takes it."""
    return OperatingPoint(condition.active_power_w, condition.terminal_voltage_v, condition.reactive_power_var)
