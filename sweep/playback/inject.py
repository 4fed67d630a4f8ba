"""A campaign as files for others to play: the body of ``seqsweep inject``.

The experiments are those of the plan: two per row of the table, at f and at its mirror, or four of a
broadband signal. They are played one after the other, pair after pair, in as few files as the longest
one allows: a device that settles within a second need not be started anew two hundred times.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import ceil, inf
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...identify.files import write_json
from ...plant.errors import SeqsweepError, place_of
from ...plant.protocol import Job, OperatingPoint, OperatingRange, Plant, Rating, Record, Source
from ...plant.registry import PlantCard
from ..config.sections import Config
from ..plan import Condition, Plan
from ..planning import make_plan
from ..run.host import plant_or_card
from .comtrade import Encoding
from .manifest import AMPLITUDE_UNIT, FILE_NAME, FORMAT, Experiment, Manifest, PlayedTone
from .waveform_files import SUFFIXES, PlaybackFormat, Waveforms, phases, write_waveforms

EXTERNAL = "external"
"""The id of a device that exists elsewhere: it can be perturbed by files, not driven."""

ANYTHING = OperatingRange(active_power_w=(-inf, inf), terminal_voltage_v=(0.0, inf))

MIN_SAMPLES = 4
"""Samples of the rate per fundamental period, at least."""

_WRITTEN = re.compile(rf"shot_\d{{3,}}({'|'.join(map(re.escape, SUFFIXES.values()))})", re.ASCII)
"""Names that `scheduled` gives to files: no others are removed, whatever a manifest says."""


class InjectError(SeqsweepError):
    """Files that cannot be written as asked, with the way out."""


class Timing(NamedTuple):
    """How the experiments follow one another.

    Attributes
    ----------
    rate_hz : float
        Sample rate (Hz).
    quiet_s : float
        Silence at the start of every file: the device starts and settles (s).
    settle_s : float
        How long tones play before the part to evaluate begins (s).
    windows : int
        Coherent windows of that part.
    longest_s : float
        A file does not grow beyond this; one experiment alone may (s).
    """

    rate_hz: float = 10_000.0
    quiet_s: float = 1.0
    settle_s: float = 1.0
    windows: int = 2
    longest_s: float = 60.0


@dataclass
class ExternalDevice:
    """What a plan needs to know of a device that is elsewhere; it answers the promise of a plant in words only."""

    f1_hz: float
    dt_s: float
    rating: Rating
    id: str = EXTERNAL
    operating_range: OperatingRange = ANYTHING
    power_meaning: str = "as metered by whoever records it"

    def settle(self, operating_point: OperatingPoint, source: Source) -> Any:
        """Refuse: there is nothing to settle."""
        raise InjectError(f"{EXTERNAL}: a device that is elsewhere cannot be driven from here")

    def run(self, jobs: Sequence[Job], n_steps: int) -> list[tuple[Any, Record]]:
        """Refuse: there is nothing to run."""
        raise InjectError(f"{EXTERNAL}: a device that is elsewhere cannot be driven from here")


def planned(config: Config, timing: Timing) -> tuple[Plan, Plant | PlantCard]:
    """The plan of a campaign whose plant may be elsewhere.

    Raises
    ------
    InjectError
        If the parameters of an external device are not f1_hz, rated_voltage_v and rated_power_va, or
        the sample rate is too low.
    """
    _check_timing(timing)
    plant = _plant(config, timing.rate_hz)
    plan = replace(make_plan(config, plant), probes=frozenset())
    if plan.adaptive is not None:
        raise InjectError(
            'spacing = "adaptive" asks on from what it has heard; files need "log", "linear" or a list f_hz'
        )
    highest = max(abs(shot.injected_hz) for wanted in _wanted(plan, plan.conditions[0]) for shot in wanted.shots)
    if timing.rate_hz <= 2.0 * highest:
        raise InjectError(
            f"--rate {timing.rate_hz:g} Hz holds tones below {timing.rate_hz / 2:g} Hz; the highest is {highest:g} Hz: "
            f"ten samples per period are {10 * highest:g} Hz"
        )
    return plan, plant


def _plant(config: Config, rate_hz: float) -> Plant | PlantCard:
    if config.plant.id == EXTERNAL:
        return _external(config.plant.parameters, rate_hz)
    return plant_or_card(config)


def _check_timing(timing: Timing) -> None:
    for name, value, least in (
        ("--rate", timing.rate_hz, 1.0),
        ("--quiet", timing.quiet_s, 0.0),
        ("--settle", timing.settle_s, 0.0),
        ("--longest", timing.longest_s, 0.0),
        ("--windows", timing.windows, 1),
    ):
        if not least <= value < inf:
            raise InjectError(f"{name} {value:g}; needed: a finite number of at least {least:g}")


def _external(parameters: Mapping[str, Any], rate_hz: float) -> ExternalDevice:
    """Steps are chosen so that whole ones make a period: windows then hold whole periods at any rate."""
    needed = ("f1_hz", "rated_voltage_v", "rated_power_va")
    if set(parameters) != set(needed):
        given = ", ".join(parameters) or "none"
        raise InjectError(f'[plant] id = "{EXTERNAL}" takes the parameters {", ".join(needed)}; given: {given}')
    for name in needed:
        value = parameters[name]
        if isinstance(value, bool) or not isinstance(value, int | float) or not value > 0:
            raise InjectError(f"plant.parameters.{name} is {value!r}; needed: a number above 0")
    f1_hz = float(parameters["f1_hz"])
    steps = round(rate_hz / f1_hz)
    if steps < MIN_SAMPLES:
        raise InjectError(f"--rate {rate_hz:g} Hz has fewer than {MIN_SAMPLES} samples per period of {f1_hz:g} Hz")
    rating = Rating(float(parameters["rated_voltage_v"]), float(parameters["rated_power_va"]))
    return ExternalDevice(f1_hz, 1.0 / (f1_hz * steps), rating)


def chosen(plan: Plan, op_id: str | None) -> Condition:
    """The operating point to write files for."""
    names = [condition.op_id for condition in plan.conditions]
    if op_id is None and len(names) > 1:
        raise InjectError(f"a manifest is that of one operating point; choose with --op ID: {', '.join(names)}")
    return plan.conditions[0 if op_id is None else place_of(op_id, names, "the campaign", InjectError)]


def inject(
    plan: Plan,
    plant: Plant | PlantCard,
    condition: Condition,
    folder: Path,
    kind: PlaybackFormat,
    timing: Timing,
    encoding: Encoding = "BINARY",
) -> Manifest:
    """Write the files of one operating point, and their manifest last; those of an earlier one in ``folder`` go.

    Raises
    ------
    OSError
        If the machine refuses; the manifest is then not there.
    """
    earlier = _files_of(folder)
    (folder / FILE_NAME).unlink(missing_ok=True)  # an old manifest must not speak for new files
    for path in earlier:
        path.unlink(missing_ok=True)
    files = list(scheduled(plan, condition, timing, SUFFIXES[kind]))
    for experiments in files:
        write_waveforms(folder / experiments[0].file, waveforms(plan, experiments, timing.rate_hz), kind, encoding)
    manifest = Manifest(
        f1_hz=plan.f1_hz,
        sample_rate_hz=timing.rate_hz,
        kind=plan.kind,
        rated_voltage_v=plant.rating.voltage_v,
        rated_power_va=plant.rating.power_va,
        operating_point=_point(condition, plant.rating),
        experiments=tuple(experiment for experiments in files for experiment in experiments),
        configuration=plan.configuration,
    )
    write_json(folder / FILE_NAME, manifest.to_dict())
    return manifest


def _files_of(folder: Path) -> list[Path]:
    """Files in ``folder`` that `inject` wrote, as its manifest names them; a COMTRADE .cfg has its .dat beside it."""
    paths = [folder / name for name in _names_in(folder / FILE_NAME) if _WRITTEN.fullmatch(name)]
    data = [path.with_suffix(".dat") for path in paths if path.suffix == SUFFIXES["comtrade"]]
    return [path for path in (*paths, *data) if path.is_file()]


def _names_in(manifest: Path) -> list[str]:
    """Files that a manifest names, each once; none where it is not there or something else."""
    try:
        content = json.loads(manifest.read_text("utf-8"))
    except (OSError, ValueError, RecursionError):
        return []
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        return []
    experiments = content.get("experiments")
    entries = experiments if isinstance(experiments, list) else []
    named = [each.get("file") for each in entries if isinstance(each, dict)]
    return list(dict.fromkeys(name for name in named if isinstance(name, str)))


def _point(condition: Condition, rating: Rating) -> dict[str, Any]:
    voltage_v = condition.terminal_voltage_v
    return {
        "op_id": condition.op_id,
        "active_power_mw": condition.active_power_w / 1e6,
        "terminal_voltage_pu": None if voltage_v is None else voltage_v / rating.voltage_v,
    }


# From the plan to stretches of time


class _Wanted(NamedTuple):
    """An experiment without its place in time: tones, and the length of one coherent window (s)."""

    shots: tuple[PlayedTone, ...]
    window_s: float


def _wanted(plan: Plan, condition: Condition) -> Iterator[_Wanted]:
    """The experiments of the plan, pair after pair: f and mirror, or a broadband signal and its opposite."""
    if plan.signal is not None:
        yield from _broadband(plan, condition)
        return
    for point in plan.points:
        for shot in plan.shots_of(condition, point):
            tones = shot.injection.tones
            played = tuple(PlayedTone(shot.f_hz, tone.f_hz, tone.amplitude, tone.phase_rad) for tone in tones)
            yield _Wanted(played, shot.window.n_blocks * plan.block.duration_s)


def _broadband(plan: Plan, condition: Condition) -> Iterator[_Wanted]:
    """All lines at once, along the axes of a frame at f1 whose angle is zero at the file's first sample.

    Where the voltage stands is not known here, nor needed: along any two axes at right angles the
    experiments are independent at every line.
    """
    rows = np.array([point.f_hz for point in plan.points])
    window_s = plan.points[0].window_blocks * plan.block.duration_s
    for play in plan.plays_of(condition):
        tones = play.injection(angle_rad=0.0).tones
        played = (
            PlayedTone(_served(rows, tone.f_hz, plan.f1_hz), tone.f_hz, tone.amplitude, tone.phase_rad)
            for tone in tones
        )
        yield _Wanted(tuple(played), window_s)


def _served(rows: np.ndarray, injected_hz: float, f1_hz: float) -> float:
    """The row (Hz) that a line serves: one that was asked for, else the frequency itself or its mirror, above zero."""
    mirror_hz = 2.0 * f1_hz - injected_hz
    for f_hz in (injected_hz, mirror_hz):
        nearest = float(rows[np.argmin(np.abs(rows - f_hz))])
        if abs(nearest - f_hz) <= 1e-9 * f1_hz:
            return nearest
    return injected_hz if injected_hz > 0.0 else mirror_hz


def scheduled(plan: Plan, condition: Condition, timing: Timing, suffix: str) -> Iterator[list[Experiment]]:
    """Experiments of one file after the other. Everything begins at a sample; a pair stays in one file."""
    wanted = list(_wanted(plan, condition))
    rate = timing.rate_hz
    quiet = ceil(timing.quiet_s * rate)
    experiments: list[Experiment] = []
    number, at = 0, quiet
    for pair in zip(wanted[0::2], wanted[1::2], strict=True):
        lengths = [ceil((timing.settle_s + timing.windows * each.window_s) * rate - 1e-6) for each in pair]
        if experiments and at + sum(lengths) > timing.longest_s * rate:
            yield experiments
            experiments, number, at = [], number + 1, quiet
        for each, length in zip(pair, lengths, strict=True):
            name = f"shot_{number:03d}{suffix}"
            duration_s = timing.windows * each.window_s
            experiments.append(Experiment(name, each.shots, at / rate, timing.settle_s, duration_s))
            at += length
    yield experiments


# From stretches of time to samples


def waveforms(plan: Plan, experiments: Sequence[Experiment], rate_hz: float) -> Waveforms:
    """Three phases of one file: silence, then the tones of every experiment while it lasts."""
    stop = ceil(max(experiment.end_s for experiment in experiments) * rate_hz - 1e-6)
    vector = np.zeros(stop, dtype=complex)
    for experiment in experiments:
        first, last = round(experiment.start_s * rate_hz), ceil(experiment.end_s * rate_hz - 1e-6)
        vector[first:last] = space_vector(experiment.shots, np.arange(first, last) / rate_hz)
    letter = {"series_voltage": "v", "shunt_current": "i"}[plan.kind]
    names = (f"{letter}a", f"{letter}b", f"{letter}c")
    return Waveforms(names, AMPLITUDE_UNIT[plan.kind], phases(vector), rate_hz, plan.f1_hz)


def space_vector(shots: Iterable[PlayedTone], time_s: np.ndarray) -> np.ndarray:
    """Sum of tones (n,) at times (n,) (s), in V or A."""
    vector = np.zeros(len(time_s), dtype=complex)
    for shot in shots:
        turns = (shot.injected_hz * time_s) % 1.0
        vector += shot.amplitude * np.exp(1j * (2.0 * np.pi * turns + shot.phase_rad))
    return vector
