"""The promises of a plant, one function each: it drives a plant on trial and says what it saw, or raises `Broken`.

`check.check_plant` goes through them in the order of `PROMISES`. A trial makes what several of them need when
it is first asked for.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property
from math import inf, isfinite, isnan, pi
from typing import Any, cast

import numpy as np

from .errors import in_words
from .protocol import (
    Injection,
    InjectionKind,
    Job,
    OperatingPoint,
    OperatingRange,
    Phasors,
    Plant,
    Rating,
    Record,
    Source,
    Tone,
    Window,
)
from .space_vectors import LINE_RMS

_STEADY = 1e-6
"""Largest change from one period to the next, relative to the waveform's peak."""

_SAME = 1e-12
"""Largest difference between two answers to one job; compilers may order sums by the batch's size."""

_CLOSE = 1e-9
"""Largest difference between two ways to one result, where the order of rounding is not promised."""

_AMPLITUDE_PU = 0.01
_PHASE_RAD = 0.7
_PERIODS = 8
"""Fundamental periods of the window that looks for the tone: lines half of f1 apart are told apart."""

_BEYOND = 8
"""Unperturbed steps appended to a run, so that its end state is judged along with its record."""


class Broken(Exception):
    """The promise at hand is not kept."""


class Trial:
    """A plant under examination, with what several checks need; made when first asked for."""

    def __init__(self, plant: Plant, operating_point: OperatingPoint | None, source: Source):
        self.plant = plant
        self.source = source
        self._operating_point = operating_point

    @cached_property
    def operating_point(self) -> OperatingPoint:
        if self._operating_point is not None:
            return self._operating_point
        limits = self.plant.operating_range
        power_w = sum(limits.active_power_w) / 2.0
        low, high = limits.terminal_voltage_v
        voltage_v = None if self.source.voltage_v is not None else min(max(self.plant.rating.voltage_v, low), high)
        return OperatingPoint(power_w if isfinite(power_w) else 0.0, voltage_v)

    @cached_property
    def period_steps(self) -> int:
        """Steps of the whole number nearest to a fundamental period."""
        return round(1.0 / (self.plant.f1_hz * self.plant.dt_s))

    @cached_property
    def state(self) -> Any:
        return self.settle()

    @cached_property
    def later(self) -> Any:
        """A steady state at no particular moment: tones and windows that start at zero by habit show up."""
        ((end, _),) = self.run([Job(self.state, None)], int(1.37 * self.period_steps))
        return end

    @cached_property
    def responses(self) -> tuple[Record, list[tuple[np.ndarray, np.ndarray]]]:
        """The unperturbed record, and (v, i) less the unperturbed ones under a tone at +f and at -f."""
        tones = [self.tone(sign * self.f_tone_hz) for sign in (1.0, -1.0)]
        results = self.run([Job(self.later, injection) for injection in (None, *tones)], _PERIODS * self.period_steps)
        base, *perturbed = [record for _, record in results]
        return base, [(record.v - base.v, record.i - base.i) for record in perturbed]

    @property
    def f_tone_hz(self) -> float:
        return 1.5 * self.plant.f1_hz

    def settle(self) -> Any:
        return self.plant.settle(self.operating_point, self.source)

    def tone(self, f_hz: float, kind: InjectionKind = "series_voltage") -> Injection:
        rating = self.plant.rating
        peak = rating.peak_voltage_v if kind == "series_voltage" else rating.peak_current_a
        return Injection(kind, (Tone(f_hz, _AMPLITUDE_PU * peak, _PHASE_RAD),))

    def run(self, jobs: Sequence[Job], n_steps: int) -> list[tuple[Any, Record]]:
        """The plant's `run`, its answer looked over."""
        results = self.plant.run(jobs, n_steps)
        if len(results) != len(jobs):
            raise Broken(f"{len(jobs)} jobs in, {len(results)} results out")
        for job, (end, record) in zip(jobs, results, strict=True):
            self._look_over(job, end, record, n_steps)
        return results

    def _look_over(self, job: Job, end: Any, record: Record, n_steps: int) -> None:
        shapes = np.shape(record.v), np.shape(record.i)
        if shapes != ((n_steps,), (n_steps,)):
            raise Broken(f"{n_steps} steps asked for, v and i have shapes {shapes[0]} and {shapes[1]}")
        if not (np.iscomplexobj(record.v) and np.iscomplexobj(record.i)):
            raise Broken("v and i must be complex space vectors")
        dt_s, start_s = self.plant.dt_s, float(job.state.time_s)
        told = {"dt_s": (record.dt_s, dt_s), "f1_hz": (record.f1_hz, self.plant.f1_hz)}
        for name, (of_record, of_plant) in told.items():
            if of_record != of_plant:
                raise Broken(f"{name} is {of_record!r} in the record and {of_plant!r} in the plant")
        for name, found_s, wanted_s in (
            ("the first sample's time", record.t0_s, start_s),
            ("the end state's time", float(end.time_s), start_s + n_steps * dt_s),
        ):
            if not abs(found_s - wanted_s) <= 1e-6 * dt_s + 1e-12 * abs(wanted_s):
                raise Broken(f"{name} is {found_s!r} s, not {wanted_s!r} s")
        if record.source_direction not in ("load", "generator"):
            raise Broken(f"source_direction is {record.source_direction!r}")

    def waveforms(self, jobs: Sequence[Job], n_steps: int) -> list[np.ndarray]:
        """(2, n) v and i of every job in per unit of the rated peak, its end state run on for some steps."""
        results = self.run(jobs, n_steps)
        further = self.run([Job(end, None) for end, _ in results], _BEYOND)
        return [
            np.concatenate([self.per_unit(record), self.per_unit(more)], axis=1)
            for (_, record), (_, more) in zip(results, further, strict=True)
        ]

    def per_unit(self, x: Record | Phasors) -> np.ndarray:
        rating = self.plant.rating
        return np.stack([x.v / rating.peak_voltage_v, x.i / rating.peak_current_a])


# ---------------------------------------------------------------------- gates


def _attributes(trial: Trial) -> str:
    plant: Any = trial.plant
    missing = [name for name in Plant.__annotations__ if not hasattr(plant, name)]
    missing += [name for name in ("settle", "run") if not callable(getattr(plant, name, None))]
    if missing:
        raise Broken(f"the plant lacks {', '.join(missing)}")
    for name in ("id", "power_meaning"):
        if not (isinstance(getattr(plant, name), str) and getattr(plant, name)):
            raise Broken(f"{name} is {getattr(plant, name)!r}, not a text")
    for name, value in (("f1_hz", plant.f1_hz), ("dt_s", plant.dt_s)):
        if not (isfinite(value) and value > 0.0):
            raise Broken(f"{name} is {value!r}, not a finite number above 0")
    if plant.f1_hz * plant.dt_s > 0.1:
        raise Broken(f"dt_s is {plant.dt_s:g} s: fewer than ten samples per fundamental period")
    rating, limits = plant.rating, plant.operating_range
    if not (isinstance(rating, Rating) and 0.0 < rating.voltage_v < inf and 0.0 < rating.power_va < inf):
        raise Broken(f"rating is {rating!r}, not a Rating with finite values above 0")
    if not isinstance(limits, OperatingRange):
        raise Broken(f"operating_range is {limits!r}, not an OperatingRange")
    for name in ("active_power_w", "terminal_voltage_v"):
        low, high = getattr(limits, name)
        if not low <= high:
            raise Broken(f"operating_range.{name} is {low!r} to {high!r}")
    return f"{plant.id}: f1 = {plant.f1_hz:g} Hz, dt = {plant.dt_s:g} s, {rating.voltage_v:g} V, {rating.power_va:g} VA"


def _settles(trial: Trial) -> str:
    time_s = float(trial.state.time_s)
    if not isfinite(time_s):
        raise Broken(f"the state's time_s is {time_s!r}")
    point = trial.operating_point
    voltage = "the source's voltage" if point.terminal_voltage_v is None else f"{point.terminal_voltage_v:g} V"
    return f"at {point.active_power_w:g} W and {voltage}, {trial.source.kind} source"


def _samples(trial: Trial) -> str:
    for n_steps in (1, trial.period_steps):
        trial.run([Job(trial.state, None), Job(trial.state, trial.tone(trial.f_tone_hz))], n_steps)
    return "as many samples as steps, on the plant's own time axis"


def _finite(trial: Trial) -> str:
    jobs = [Job(trial.later, None), Job(trial.later, trial.tone(trial.f_tone_hz))]
    waveforms = trial.waveforms(jobs, _PERIODS * trial.period_steps)
    if not np.all(np.isfinite(waveforms)):
        raise Broken("v or i holds NaN or infinity")
    return f"largest value {np.max(np.abs(waveforms)):.3g} times the rated peak"


# ---------------------------------------------------------------------- the steady state


def _steady(trial: Trial) -> str:
    """Compares sample by sample; a period that is no whole number of steps is made up by a small turn."""
    n = trial.period_steps
    ((_, record),) = trial.run([Job(trial.state, None)], 2 * n)
    x = trial.per_unit(record)
    turn = np.exp(2j * pi * trial.plant.f1_hz * n * trial.plant.dt_s)
    return _within(_STEADY, [_difference(x[:, :n] * turn, x[:, n:])], "from one period to the next")


def _terminal_voltage(trial: Trial) -> str:
    wanted_v = trial.operating_point.terminal_voltage_v
    base, _ = trial.responses
    found_v = abs(_phasor(base.v, base.time_s, trial.plant.f1_hz)) * LINE_RMS
    if wanted_v is not None and not abs(found_v - wanted_v) <= 1e-3 * wanted_v:
        raise Broken(f"|v_pcc| is {found_v:.6g} V line-to-line RMS, {wanted_v:g} V was asked for (v is a phase peak)")
    return f"|v_pcc| = {found_v:.6g} V line-to-line RMS"


def _range_refused(trial: Trial) -> str:
    limits, source = trial.plant.operating_range, replace(trial.source, voltage_v=None)
    inside = Trial(trial.plant, None, source).operating_point
    outside = [
        (field, value)
        for field in ("active_power_w", "terminal_voltage_v")
        for value in (*_beyond(*getattr(limits, field)), float("nan"))
    ]
    for field, value in outside:
        point = replace(inside, **{field: value})
        if not _refused(lambda point=point: trial.plant.settle(point, source)):  # type: ignore[misc]
            raise Broken(f"settled at {field} = {value:g}, outside its operating_range; a ValueError is promised")
    return f"{len(outside)} operating points outside the range were refused"


def _beyond(low: float, high: float) -> list[float]:
    """A value below and one above the range, where it ends."""
    margin = 0.05 * max((abs(x) for x in (low, high) if isfinite(x)), default=1.0) or 1.0
    return [x for x, end in ((low - margin, low), (high + margin, high)) if isfinite(end)]


# ---------------------------------------------------------------------- the answer to a job


def _repeatable(trial: Trial) -> str:
    """The same job three times, once from a state settled anew."""
    injection, n = trial.tone(trial.f_tone_hz), trial.period_steps
    jobs = [Job(state, injection) for state in (trial.state, trial.state, trial.settle())]
    first, *others = [trial.waveforms([job], n)[0] for job in jobs]
    return _within(_SAME, [_difference(first, x) for x in others], "between two answers to one job")


def _halves(trial: Trial) -> str:
    injection, n = trial.tone(trial.f_tone_hz), 2 * trial.period_steps
    whole = trial.waveforms([Job(trial.later, injection)], n)[0]
    ((middle, first),) = trial.run([Job(trial.later, injection)], n // 3)
    second = trial.waveforms([Job(middle, injection)], n - n // 3)[0]
    parts = np.concatenate([trial.per_unit(first), second], axis=1)
    return _within(_CLOSE, [_difference(whole, parts)], "between one run and the same in two parts")


def _neighbours(trial: Trial) -> str:
    """Twelve different jobs at two operating points, in two orders, against each of them alone."""
    f_hz, other = trial.f_tone_hz, _other_state(trial)
    jobs = [Job(state, trial.tone((-0.8) ** k * f_hz)) for k, state in enumerate(3 * [trial.later, other, trial.state])]
    two_tones = Injection("series_voltage", trial.tone(f_hz).tones + trial.tone(-0.9 * f_hz).tones)
    jobs += [Job(other, two_tones), Job(trial.later, None), Job(other, None)]
    wanted = [trial.waveforms([job], trial.period_steps)[0] for job in jobs]
    differences = []
    for order in (range(len(jobs)), [(5 * k + 3) % len(jobs) for k in range(len(jobs))]):
        found = trial.waveforms([jobs[k] for k in order], trial.period_steps)
        differences += [_difference(wanted[k], x) for k, x in zip(order, found, strict=True)]
    return _within(_SAME, differences, "between a job in a batch and the same job alone")


def _other_state(trial: Trial) -> Any:
    """A state at another operating point, or at another time where there is no other point."""
    low, high = trial.plant.operating_range.active_power_w
    power_w = low + 0.3 * (high - low)
    if not isfinite(power_w):
        power_w = trial.operating_point.active_power_w
    voltage_v = trial.operating_point.terminal_voltage_v
    if voltage_v is not None:
        low, high = trial.plant.operating_range.terminal_voltage_v
        voltage_v = min(max(0.98 * voltage_v, low), high)
    try:
        return trial.plant.settle(OperatingPoint(power_w, voltage_v), trial.source)
    except Exception:  # the plant need not settle everywhere
        ((end, _),) = trial.run([Job(trial.later, None)], 7)
        return end


def _state_unchanged(trial: Trial) -> str:
    """A fresh state, so that what only the first run touches is seen."""
    state, injection = trial.settle(), trial.tone(trial.f_tone_hz)
    try:
        before = pickle.dumps(state)
    except Exception:
        return "not judged: the state cannot be pickled; see repeatable"
    trial.run([Job(state, injection), Job(state, None)], trial.period_steps)
    if pickle.dumps(state) != before:
        raise Broken("the state passed in was changed by run")
    return "the state passed in is the same, byte for byte"


def _state_picklable(trial: Trial) -> str:
    content = pickle.dumps(trial.later)
    jobs = [Job(state, trial.tone(trial.f_tone_hz)) for state in (trial.later, pickle.loads(content))]
    original, copied = (trial.waveforms([job], trial.period_steps)[0] for job in jobs)
    _within(_SAME, [_difference(original, copied)], "between a state and its pickled copy")
    return f"{len(content)} bytes"


# ---------------------------------------------------------------------- the injection


def _reacts(trial: Trial) -> str:
    rating, (_, differences) = trial.plant.rating, trial.responses
    weakest = inf
    for v, i in differences:
        for name, x, peak in (("v", v, rating.peak_voltage_v), ("i", i, rating.peak_current_a)):
            reaction = float(np.max(np.abs(x))) / peak
            weakest = min(weakest, reaction)
            if not reaction > 1e-7 * _AMPLITUDE_PU:
                raise Broken(f"a tone of {_AMPLITUDE_PU:g} pu moves {name} by {reaction:.2g} pu")
    return f"a tone of {_AMPLITUDE_PU:g} pu moves v and i by {weakest:.2g} pu or more"


def _sequence(trial: Trial) -> str:
    """v at the tone's signed frequency against v at its negative; v and i of the fundamental likewise."""
    f1, (base, differences) = trial.plant.f1_hz, trial.responses
    looked_at = [("v of the fundamental", base.v, f1), ("i of the fundamental", base.i, f1)]
    for sign, (v, _) in zip((1.0, -1.0), differences, strict=True):
        looked_at.append((f"v of a tone at {sign * trial.f_tone_hz:+g} Hz", v, sign * trial.f_tone_hz))
    for name, x, f_hz in looked_at:
        there, mirrored = (abs(_phasor(x, base.time_s, f)) for f in (f_hz, -f_hz))
        silent = 1e-3 * trial.plant.rating.peak_current_a if name.startswith("i") else 0.0
        if there + mirrored > silent and not there > 3.0 * mirrored:
            raise Broken(f"{name}: {there:.3g} at {f_hz:+g} Hz, but {mirrored:.3g} at {-f_hz:+g} Hz")
    return f"tones at +-{trial.f_tone_hz:g} Hz appear at their signed frequency"


def _tone_time(trial: Trial) -> str:
    if trial.source.kind != "ideal":
        return "not judged: only an ideal source shows the tone itself at the PCC"
    base, differences = trial.responses
    for sign, (v, _) in zip((1.0, -1.0), differences, strict=True):
        (tone,) = trial.tone(sign * trial.f_tone_hz).tones
        ratio = _phasor(v, base.time_s, tone.f_hz) / (tone.amplitude * np.exp(1j * tone.phase_rad))
        if not abs(ratio - 1.0) <= 0.01:
            raise Broken(
                f"the tone at {tone.f_hz:+g} Hz arrives {abs(ratio):.4g} times as large and turned by "
                f"{np.angle(ratio):+.3g} rad; its time is the state's, its amplitude a phase peak"
            )
    return "amplitude and phase of the tone are those asked for, in the state's time"


def _shunt_refused(trial: Trial) -> str:
    source = replace(trial.source, kind="ideal")
    try:
        state = trial.plant.settle(trial.operating_point, source)
    except ValueError:
        return "no ideal source to refuse it with"
    job = Job(state, trial.tone(trial.f_tone_hz, "shunt_current"))
    calls: list[Callable[[], Any]] = [lambda: trial.plant.run([job], 1)]
    if _listens(trial.plant):
        calls.append(lambda: cast(Any, trial.plant).run_phasors([job], [Window(trial.f_tone_hz, 1)], 1, 1))
    if not all(_refused(call) for call in calls):
        raise Broken("a shunt current into an ideal source was accepted; a ValueError is promised")
    return "a shunt current into an ideal source is refused"


# ---------------------------------------------------------------------- phasors while stepping


def _phasors(trial: Trial) -> str:
    """Windows that begin, go on and end inside the run, one line per job, against the record."""
    if not _listens(trial.plant):
        return "not judged: the plant has no run_phasors"
    f_hz, block_steps, n_blocks = trial.f_tone_hz, max(2, trial.period_steps // 7), 9
    windows = [Window(f_hz, 4), Window(-0.9 * f_hz, 5, 3), Window(3.1 * f_hz, 1)]
    injections = [trial.tone(f_hz), None, trial.tone(-0.9 * f_hz)]
    jobs = [Job(trial.later, injection) for injection in injections]
    results = cast(Any, trial.plant).run_phasors(jobs, windows, block_steps, n_blocks)
    records = trial.run(jobs, block_steps * n_blocks)
    differences = []
    for (end, found), (end_of_run, record), window in zip(results, records, windows, strict=True):
        shapes = np.shape(found.v), np.shape(found.i)
        if shapes != ((n_blocks, 2), (n_blocks, 2)):
            raise Broken(f"{n_blocks} blocks asked for, v and i have shapes {shapes[0]} and {shapes[1]}")
        wanted = _block_phasors(record, window, block_steps)
        differences.append(_difference(trial.per_unit(wanted), trial.per_unit(found)))
        (_, one), (_, other) = trial.run([Job(end, None), Job(end_of_run, None)], _BEYOND)
        differences.append(_difference(trial.per_unit(one), trial.per_unit(other)))
    return _within(_CLOSE, differences, "between run_phasors and the record of run")


def _block_phasors(record: Record, window: Window, block_steps: int) -> Phasors:
    """What `Phasors` promises, from a record: Blackman's taper over its mean, time counted from zero."""
    n_steps = window.n_blocks * block_steps
    position = (window.first_block * block_steps + np.arange(len(record.v))) / n_steps
    taper = 0.42 - 0.5 * np.cos(2.0 * pi * position) + 0.08 * np.cos(4.0 * pi * position)
    lines_hz = np.array([[window.f_hz], [2.0 * record.f1_hz - window.f_hz]])
    demodulator = taper / (0.42 * n_steps) * np.exp(-2j * pi * ((lines_hz * record.time_s) % 1.0))
    v, i = ((demodulator * x).reshape(2, -1, block_steps).sum(axis=2).T for x in (record.v, record.i))
    return Phasors(v, i)


def _listens(plant: Plant) -> bool:
    return callable(getattr(plant, "run_phasors", None))


# ---------------------------------------------------------------------- small helpers


def _difference(a: np.ndarray, b: np.ndarray) -> float:
    """Largest difference of two (2, ...) arrays, v and i each over its own peak (at least 0.01 pu)."""
    axes = tuple(range(1, a.ndim))
    return float(np.max(np.max(np.abs(a - b), axis=axes) / np.maximum(np.max(np.abs(a), axis=axes), 0.01)))


def _within(limit: float, differences: Sequence[float], where: str) -> str:
    worst = float("nan") if any(isnan(x) for x in differences) else max(differences)
    text = f"v and i differ by {worst:.2g} {where}; the limit is {limit:g}"
    if not worst <= limit:
        raise Broken(text)
    return text


def _phasor(x: np.ndarray, time_s: np.ndarray, f_hz: float) -> complex:
    """Phasor at a signed frequency under Blackman's taper."""
    position = np.arange(len(x)) / len(x)
    taper = 0.42 - 0.5 * np.cos(2.0 * pi * position) + 0.08 * np.cos(4.0 * pi * position)
    return complex(np.mean(taper / 0.42 * x * np.exp(-2j * pi * f_hz * time_s)))


def _refused(call: Callable[[], Any]) -> bool:
    """Whether the call raises ValueError; any other exception in its place breaks the promise."""
    try:
        call()
    except ValueError:
        return True
    except Exception as error:
        kind, words = type(error).__name__, in_words(error)  # here the class is what is wrong
        told = words if words.startswith(kind) else f"{kind}: {words}"
        raise Broken(f"a ValueError is promised; it raised {told}") from None
    return False


PROMISES: dict[str, Callable[[Trial], str]] = {
    "attributes": _attributes,
    "settles": _settles,
    "samples": _samples,
    "finite": _finite,
    "steady": _steady,
    "terminal_voltage": _terminal_voltage,
    "range_refused": _range_refused,
    "repeatable": _repeatable,
    "halves": _halves,
    "neighbours": _neighbours,
    "state_unchanged": _state_unchanged,
    "state_picklable": _state_picklable,
    "reacts": _reacts,
    "sequence": _sequence,
    "tone_time": _tone_time,
    "shunt_refused": _shunt_refused,
    "phasors": _phasors,
}
