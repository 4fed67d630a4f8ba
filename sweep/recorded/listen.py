"""One recording: which experiments are in it, and what was heard of each. A pure function of a task; workers run it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import nan
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...identify.recorded.detect import Found, survey
from ...identify.recorded.local_polynomial import Local, local_polynomials
from ...identify.recorded.points import NOISY, Experiment
from ...identify.recorded.quiet import quiet_lines, without_background
from ...identify.recorded.tones import HearingError, fundamental, hear
from ...plant.protocol import SourceDirection
from ...plant.recordings.recording import RecordingError
from ...plant.recordings.waveforms import Waveforms, defects, open_waveforms
from ...plant.space_vectors import LINE_RMS
from ..playback.manifest import Experiment as Played
from ..playback.manifest import PlayedTone

F1_LIE = 2e-4
"""Relative difference of the file's own f1 and the data's that is worth a word."""

BROADBAND_HZ = np.geomspace(2.0, 1000.0, 100)
"""Frequencies at which a broadband record is asked, as far as it excites them; f1 as nominal."""

FEWEST_BROADBAND = 8
"""Fewer frequencies that are not noisy make no broadband record."""

MOST_OF = 0.9
"""A record that holds less of the stretch a manifest speaks of was begun by a trigger: all of it is taken."""

CLOCK_CYCLES = 0.01
"""Cycles by which a tone may slip over its window before the clocks are worth a word."""

MOST_SHOWN = 200
"""Tones that a line of output lists."""

F1_TOLD, F1_TOLD_HZ = 0.05, 2.0
"""A told fundamental farther than both (part of it, Hz) from the strongest line of the voltage is not in the record."""

NOMINAL_HZ = (50.0, 60.0, 400.0, 50.0 / 3.0)
NEAR_NOMINAL = 0.04
"""A fundamental farther than this from every nominal one means a wrong sampling rate, most likely."""

AIRCRAFT_HZ = (340.0, 840.0)
"""Fundamentals of aircraft, whose generators turn as their engines do (360 to 800 Hz), are not unusual."""


@dataclass(frozen=True, slots=True)
class Task:
    """A recording and how it is to be read.

    Attributes
    ----------
    path : Path
        The file.
    direction : "load" or "generator"
        Of its current.
    channels : mapping
        Role to channel name, where the user overrules the guess.
    experiment : Played or None
        What it holds; None: to be found.
    f1_hz : float or None
        The fundamental (Hz), None: estimated.
    sample_rate_hz : float or None
        Overrules the file.
    base : (V, A) or None
        Rated phase peaks.
    units : mapping
        Unit of "voltage" and of "current", where the user overrules the file.
    amplitude_base : float
        What the manifest's amplitudes are relative to (V or A); NaN.
    quiet_until_s : float or None
        Until when no tone is on, in the time of the recording, where a manifest says so (s).
    """

    path: Path
    direction: SourceDirection
    channels: Mapping[str, str] = field(default_factory=dict)
    experiment: Played | None = None
    f1_hz: float | None = None
    sample_rate_hz: float | None = None
    base: tuple[float, float] | None = None
    units: Mapping[str, str] = field(default_factory=dict)
    amplitude_base: float = nan
    quiet_until_s: float | None = None


class Fundamental(NamedTuple):
    """Frequency (Hz) and phasors (V, A; load direction) of the fundamental of a record."""

    f1_hz: float
    v1: complex
    i1: complex

    @property
    def power_w(self) -> float:
        """Active power out of the device at the PCC (W)."""
        return float(-1.5 * np.real(self.v1 * np.conj(self.i1)))

    @property
    def apparent_va(self) -> float:
        """Apparent power (VA)."""
        return float(1.5 * abs(self.v1 * self.i1))

    @property
    def reactive_var(self) -> float:
        """Reactive power out of the device at the PCC (var)."""
        return float(-1.5 * np.imag(self.v1 * np.conj(self.i1)))

    @property
    def line_voltage_v(self) -> float:
        """|v_pcc|, line-to-line RMS (V)."""
        return float(abs(self.v1) * LINE_RMS)


class Listened(NamedTuple):
    """What a recording gave.

    Attributes
    ----------
    name : str
        The file.
    experiments : tuple of Experiment
        Its tones.
    broadband : Local or None
        The 2x2 of a record without tones.
    fundamentals : tuple of Fundamental
        One per experiment, or one of the broadband record.
    notes : tuple of str
        What a person should know.
    refusal : str or None
        Why it gave nothing.
    """

    name: str
    experiments: tuple[Experiment, ...] = ()
    broadband: Local | None = None
    fundamentals: tuple[Fundamental, ...] = ()
    notes: tuple[str, ...] = ()
    refusal: str | None = None


def listen(task: Task) -> Listened:
    """Read one recording and hear its experiments; a file that cannot be used says why and costs no other."""
    name = task.path.name
    try:
        waveforms = open_waveforms(
            task.path,
            task.direction,
            channels=task.channels,
            base=task.base,
            sample_rate_hz=task.sample_rate_hz,
            units=task.units,
        )
        _check_f1(waveforms, task.f1_hz)
        told = task.experiment
        stretches, unused = (_as_told(task, told, waveforms), []) if told else _found(waveforms)
        result = _experiments(task, waveforms, stretches) if stretches else _broadband(waveforms)
        return result._replace(notes=(*waveforms.notes(), *result.notes, *unused))
    except (RecordingError, HearingError) as error:
        return Listened(name, refusal=_bare(error, task.path))
    except MemoryError:
        return Listened(name, refusal="does not fit into memory: cut it into several files")


def _check_f1(waveforms: Waveforms, f1_hz: float | None) -> None:
    """Refuse a fundamental that was told and is not in the record: every number would be of noise."""
    if f1_hz is None:
        return
    found = fundamental(waveforms, 0, waveforms.n_samples)
    if abs(found - f1_hz) > max(F1_TOLD * f1_hz, F1_TOLD_HZ):
        raise HearingError(
            f"the fundamental is said to be {f1_hz:g} Hz, and the strongest line of the voltage is at {found:.4g} Hz: "
            "leave --f1 out, or say the sampling rate (--sample-rate)"
        )


def _bare(error: Exception, path: Path) -> str:
    """The message without the name of the file and its folder."""
    return str(error).replace(str(path), path.name).removeprefix(f"{path.name}: ")


class Stretch(NamedTuple):
    """First and last sample of an experiment, its tones, and the samples before them in which nothing is played."""

    start: int
    stop: int
    shots: tuple[PlayedTone, ...]
    quiet: tuple[int, int] | None = None


def _experiments(task: Task, waveforms: Waveforms, stretches: Sequence[Stretch]) -> Listened:
    """Every tone of every stretch; a stretch that cannot be used costs no other."""
    notes: list[str] = []
    experiments: list[Experiment] = []
    refusals: list[Exception] = []
    for stretch in stretches:
        try:
            found, said = _stretch(task, waveforms, stretch)
        except (RecordingError, HearingError) as error:
            refusals.append(error)
            continue
        experiments += found
        notes += said
    if not experiments:
        raise refusals[0]
    notes += [f"left out: {_bare(error, task.path)}" for error in refusals]
    fundamentals = tuple(Fundamental(e.heard.f1_hz, e.heard.v1, e.heard.i1) for e in experiments)
    notes += _facts(waveforms, fundamentals)
    tones = ", ".join(f"{e.heard.f_hz:.6g}" for e in experiments[:MOST_SHOWN])
    tones += f" and {len(experiments) - MOST_SHOWN} more" if len(experiments) > MOST_SHOWN else ""
    return Listened(task.path.name, tuple(experiments), None, fundamentals, (f"tones at {tones} Hz", *notes))


def _stretch(task: Task, waveforms: Waveforms, stretch: Stretch) -> tuple[list[Experiment], list[str]]:
    """Tones of one stretch, and what is to be said of it."""
    start, stop, shots, quiet = stretch
    where = _where(waveforms, start, stop)
    defect = defects(waveforms, start, stop)
    if defect.clipped:
        raise RecordingError(
            f"{', '.join(defect.clipped)} clipped{where}: what a recorder cut off cannot be restored; record again "
            "with a larger range"
        )
    heard = hear(waveforms, start, stop, tuple(shot.injected_hz for shot in shots), task.f1_hz)
    before = quiet_lines(waveforms, *quiet, heard, task.f1_hz) if quiet else None
    if before is not None:
        heard = [without_background(each, before) for each in heard]
    notes = [f"{defect.missing} samples are missing{where}"] if defect.missing else []
    notes += [f"{note}{where}" for note in dict.fromkeys(note for each in heard for note in each.notes)]
    experiments = []
    for shot, each in zip(shots, heard, strict=True):
        served = shot.f_hz if task.experiment else None
        if served is not None and abs(each.f_hz - shot.injected_hz) * each.window_s > CLOCK_CYCLES:
            notes.append(_clocks(each.f_hz, shot.injected_hz) + where)
        experiments.append(Experiment(task.path.name + where, each, served, shot.amplitude / task.amplitude_base))
    return experiments, notes


def _broadband(waveforms: Waveforms) -> Listened:
    """The 2x2 of a record in which no tone stands out, where it excites the device well enough."""
    name = waveforms.recording.path.name
    nothing = (
        "no tone stands above the noise long enough, and it is no broadband record either: record longer or "
        "louder, or tell what was injected with --manifest"
    )
    nominal = round(fundamental(waveforms, 0, waveforms.n_samples) / 10.0) * 10.0
    local = local_polynomials(waveforms, BROADBAND_HZ - nominal)
    if not len(local.y):
        raise HearingError(nothing)
    spread = np.sqrt(np.trace(local.covariance, axis1=1, axis2=2)) / np.linalg.norm(local.y, axis=(1, 2))
    if not np.count_nonzero(spread < NOISY) >= FEWEST_BROADBAND:
        raise HearingError(nothing)
    seen = (Fundamental(local.f1_hz, local.v1, local.i1),)
    notes = (
        "no tone stands out: taken as a broadband record and analysed by local polynomials "
        f"({np.count_nonzero(spread < NOISY)} frequencies)",
        *_facts(waveforms, seen),
    )
    return Listened(name, (), local, seen, notes)


def _clocks(found_hz: float, told_hz: float) -> str:
    ppm = (found_hz / told_hz - 1.0) * 1e6 if told_hz else nan
    return f"the tone is at {found_hz:.8g} Hz, not at {told_hz:.8g} Hz: the clocks differ by {ppm:.3g} ppm"


def _where(waveforms: Waveforms, start: int, stop: int) -> str:
    if start == 0 and stop == waveforms.n_samples:
        return ""
    dt_s = waveforms.dt_s
    return f" ({waveforms.t0_s + start * dt_s:.4g} to {waveforms.t0_s + stop * dt_s:.4g} s)"


def _as_told(task: Task, told: Played, waveforms: Waveforms) -> list[Stretch]:
    """The stretch a manifest speaks of, or the whole record where it is shorter: recorders start by triggers."""
    dt_s, n = waveforms.dt_s, waveforms.n_samples
    start = max(0, round((told.start_s + told.settle_s - waveforms.t0_s) / dt_s))
    stop = min(n, start + round(told.duration_s / dt_s))
    if not stop - start >= MOST_OF * told.duration_s / dt_s:
        return [Stretch(0, n, told.shots)]
    until = 0 if task.quiet_until_s is None else int((task.quiet_until_s - waveforms.t0_s) / dt_s)
    return [Stretch(start, stop, told.shots, (0, until) if 0 < until <= start else None)]


def _found(waveforms: Waveforms) -> tuple[list[Stretch], list[str]]:
    """Stretches that nobody told of, and what is not used of them, in words."""
    seen = survey(waveforms)
    together: dict[tuple[int, int], list[Found]] = {}
    for each in seen.found:
        together.setdefault((each.start, each.stop), []).append(each)
    stretches = [
        Stretch(start, stop, tuple(PlayedTone(nan, each.f_hz, nan, nan) for each in found), found[0].quiet)
        for (start, stop), found in together.items()
    ]
    return stretches, list(seen.unused)


def _facts(waveforms: Waveforms, seen: Sequence[Fundamental]) -> list[str]:
    """What the fundamental is, and where the file's own word and the data differ."""
    voltage_v, power_w, reactive_var = (
        float(np.median([getattr(each, name) for each in seen]))
        for name in ("line_voltage_v", "power_w", "reactive_var")
    )
    notes = [
        f"fundamental: {seen[0].f1_hz:.6g} Hz, {engineering(voltage_v, 'V')} line to line, "
        f"{_flow(power_w, 'W')}, {_flow(reactive_var, 'var')}"
    ]
    return notes + _lies(waveforms, seen)


def _flow(value: float, unit: str) -> str:
    return f"{engineering(abs(value), unit)} {'into' if value < 0.0 else 'out of'} the device"


def engineering(value: float, unit: str) -> str:
    """Four digits and a prefix: 18.72 kW."""
    prefix, factor = next(((p, f) for p, f in (("M", 1e6), ("k", 1e3), ("", 1.0)) if abs(value) >= f), ("m", 1e-3))
    return f"{value / factor:.4g} {prefix}{unit}"


def _lies(waveforms: Waveforms, seen: Sequence[Fundamental]) -> list[str]:
    """Where the file's own word and its data differ."""
    f1_hz = float(np.median([each.f1_hz for each in seen]))
    claimed = waveforms.recording.header_f1_hz
    notes = []
    if claimed and abs(f1_hz / claimed - 1.0) > F1_LIE:
        notes.append(f"the file says {claimed:g} Hz, its data {f1_hz:.6g} Hz: the data is believed")
    usual = min(abs(f1_hz / nominal - 1.0) for nominal in NOMINAL_HZ) <= NEAR_NOMINAL
    if not usual and not AIRCRAFT_HZ[0] <= f1_hz <= AIRCRAFT_HZ[1]:
        nominal = claimed or min(NOMINAL_HZ[:2], key=lambda x: abs(f1_hz / x - 1.0))
        rate = nominal / f1_hz / waveforms.dt_s
        notes.append(
            f"a fundamental of {f1_hz:.6g} Hz is unusual; were it {nominal:g} Hz, the sampling rate would be "
            f"{rate:.6g} Hz (--sample-rate)"
        )
    return notes
