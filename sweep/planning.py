"""From a campaign's configuration and a plant's card to the plan: what is asked, checked before anything runs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ..plant.errors import SeqsweepError
from ..plant.operating_range import is_within
from ..plant.protocol import Plant, Source, reactance_to_inductance
from ..plant.registry import PlantCard, PlantSpec, card_of, runs_isolated
from .config.sections import (
    DEFAULT_INTERPOLATION_TOLERANCE,
    Config,
    GridSection,
    OperatingPointSection,
    SourceSection,
    SweepSection,
)
from .excitation.adaptive_rounds import Adaptive, first_round
from .excitation.choice import broadband
from .excitation.frequencies import Frequency, coherent_block, generated, listed
from .excitation.signals import Signal
from .plan import Condition, Grid, Hosting, Limits, Plan, PlanError

ROWS_PER_PROBE = 14
"""One row in so many is swept at half the amplitude as well, to see whether the device is linear."""

MIN_PROBES = 2

LATE_DEGREES = 1.0
"""Turn of the admittance at the highest frequency from which on a plan warns."""


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
    source = _source(config.source, card)
    _check_source(source, conditions, card)
    voltage_like = config.injection.kind == "series_voltage"
    peak = card.rating.peak_voltage_v if voltage_like else card.rating.peak_current_a
    return Plan(
        hosting=Hosting(
            spec, runs_isolated(spec.id, config.plant.isolate), config.plant.timeout_s, config.plant.memory_mb
        ),
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
        limits=_limits(config.sweep, points),
        nonlinear_above=config.sweep.nonlinear_above,
        batch_pairs=_batch_pairs(len(points), len(conditions), card),
        configuration=config.to_dict(),
        warnings=(*warnings, *_lateness(card, points)),
        adaptive=_adaptive(config.sweep),
    )


def _check_source(source: Source, conditions: Sequence[Condition], card: PlantCard) -> None:
    """Refuse to stand a plant behind an impedance that says it cannot."""
    behind = [condition.op_id for condition in conditions if condition.grid is not None]
    if card.ideal_only and (behind or source.kind != "ideal" or source.settle_on is not None):
        what = f"operating point {behind[0]!r} has a grid" if behind else "[source] is not ideal"
        raise PlanError(
            f"{card.id} stands on an ideal source only, for {card.ideal_only}, and {what}: leave it out. "
            "The admittance is the same on an ideal source; the grid is given to seqsweep tune"
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
            "(fmu:, process: and plant_from_step)"
        )


def _limits(sweep: SweepSection, points: Sequence[Frequency]) -> Limits:
    adaptive = _adaptive(sweep)
    highest_hz = points[-1].f_hz if adaptive is None else adaptive.f_max_hz
    return Limits(sweep.tolerance, sweep.uncertainty, sweep.max_simulated_s, highest_hz)


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
    at = sorted(set(np.linspace(0, len(points) - 1, min(n, len(points))).round().astype(int).tolist()))
    return [points[k].f_hz for k in at]


def _adaptive(sweep: SweepSection) -> Adaptive | None:
    if sweep.spacing != "adaptive":
        return None
    assert sweep.f_min_hz is not None
    assert sweep.f_max_hz is not None
    assert sweep.points is not None
    tolerance = sweep.interpolation_tolerance or DEFAULT_INTERPOLATION_TOLERANCE
    return Adaptive(sweep.f_min_hz, sweep.f_max_hz, sweep.points, tolerance)


def _source(section: SourceSection, plant: PlantCard) -> Source:
    friend = section.settle_on
    if section.grid is not None:
        grid = _grid("[source]", section.grid, plant)
        return Source("network" if grid.circuit else "thevenin", grid.r_ohm, grid.l_h, circuit=grid.circuit)
    return Source(
        section.kind,
        section.r_ohm,
        reactance_to_inductance(section.x_ohm, plant.f1_hz),
        settle_on=None if friend is None else (friend.r_ohm, reactance_to_inductance(friend.x_ohm, plant.f1_hz)),
    )


def _condition(section: OperatingPointSection, plant: PlantCard) -> Condition:
    power_w, u = section.active_power_mw * 1e6, plant.rating.voltage_v
    reactive_var = (section.reactive_power_mvar or 0.0) * 1e6
    if section.grid is None:
        assert section.terminal_voltage_pu is not None
        return Condition(section.id, power_w, section.terminal_voltage_pu * u, None, reactive_var)
    grid = _grid(f"operating point {section.id!r}", section.grid, plant)
    return Condition(section.id, power_w, None, grid, reactive_var)


def _grid(where: str, section: GridSection, plant: PlantCard) -> Grid:
    """The grid of a section, as R + jX or as a circuit."""
    voltage_v, f1_hz = section.voltage_pu * plant.rating.voltage_v, plant.f1_hz
    if section.elements is None:
        assert section.r_ohm is not None
        assert section.x_ohm is not None
        l_h = reactance_to_inductance(section.x_ohm * section.scale, f1_hz)
        return Grid(section.r_ohm * section.scale, l_h, voltage_v)
    from ..tuning.grids.in_time import circuit_of  # late: most sources are no circuit of elements

    try:
        circuit = circuit_of(section.elements, f1_hz).scaled(section.scale)
        z, gain = circuit.seen_at(2j * np.pi * f1_hz)
    except (SeqsweepError, np.linalg.LinAlgError) as error:
        raise PlanError(f"{where}: its grid of elements: {error}") from None
    l_h = reactance_to_inductance(z.imag, f1_hz)
    return Grid(z.real, l_h, voltage_v, circuit, section.elements, section.scale, abs(gain))


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
            if not is_within(value, (low, high)):
                raise PlanError(
                    f"operating point {condition.op_id!r}: {key} = {value:g} {unit} is outside the operating range of "
                    f"{plant.id}, {low:g} to {high:g} {unit}"
                )


def _batch_pairs(n_points: int, n_conditions: int, plant: PlantCard) -> int:
    """Small batches keep two cores busy and lose little; big ones settle, store and leave lanes idle less often."""
    if not plant.listens:
        return 1
    n = n_points * n_conditions
    if n <= 64 or not plant.releases_gil:
        return 8
    return 16 if n <= 1000 else 128
