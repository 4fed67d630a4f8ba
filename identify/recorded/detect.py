"""Experiments in a long record that nobody described: where tones are on, and which.

Between two changes (`stretches`) all lines of the voltage that stand above the noise are found in the spectrum of the
whole stretch. A line is background where every other stretch of the record has it too, or where it is a harmonic that
networks usually have and nothing in the record shows that it was injected; of a line and its mirror the stronger one is
the tone. The rest are tones; what is not used is named.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .background import SPECTRUM_SAMPLES, interpolated
from .fundamental import fundamental
from .line_fit import Waveforms
from .stretches import Frames, Stretch, edges, spectrum, steady_stretches, voltage, without_fundamental

FRAME_S = (0.2, 1.0)
"""Shortest and longest frame (s)."""

FINER = 2.5
"""Where much of a record changes all the time, frames shorter by this factor are tried."""

SOME_FRAMES = 16

NEAR_BINS, NEAR_F1 = 0.3, 1e-4
"""A line is a harmonic within this many bins and this part of its distance from f1."""

SAME_BIN = 0.2
"""Part of a bin of another stretch within which a line is the same."""

BEATS = 0.3
"""Lines that differ from stretch to stretch are the beats of others where they are weaker than this part of those."""

AS_STRONG = 0.5
"""A line that stands elsewhere with at least this part of its size is there all the time."""

LEAST_TONE = 0.03
"""Of the strongest tone; what is weaker is the device's answer to others, or a remainder."""

SIDEBAND_HZ, SIDEBAND = 1.5, 3.0
"""So close to f1 a line whose mirror is not this much weaker is a wandering of f1."""

LEAST_QUIET_S = 0.2
"""Shortest stretch before the first tone whose lines are looked at (s)."""

MOST_TONES = 400
LASTS, RESTLESS = 1.5, 2.0
"""Frames that an experiment must last, and that a change may last before it is worth a word."""

MARGIN = 1.0 / 12.0
"""Part of a frame that is left out next to an edge."""

LINES = 0.8
"""A record that never rests is a multisine where its lines have this part of the energy beside the fundamental."""


class Found(NamedTuple):
    """A tone that is on between two samples; ``f_hz`` (signed) is known to a fraction of a bin.

    ``quiet`` are the samples before it in which no tone is on, where there are such.
    """

    start: int
    stop: int
    f_hz: float
    quiet: tuple[int, int] | None = None


class Survey(NamedTuple):
    """Tones of a record in the order of time, and the lines of their stretches that are not used, in words."""

    found: tuple[Found, ...]
    unused: tuple[str, ...]


class _Seen(NamedTuple):
    """Lines of a stretch: frequencies (Hz) and sizes (V), both (k,); and the resolution (Hz)."""

    stretch: Stretch
    f_hz: np.ndarray
    size: np.ndarray
    resolution_hz: float
    f1_hz: float


def find_tones(waveforms: Waveforms) -> list[Found]:
    """Tones in the order of time; empty where none stands above the noise long enough.

    Raises
    ------
    HearingError
        If there is no fundamental.
    """
    return list(survey(waveforms).found)


def survey(waveforms: Waveforms) -> Survey:
    """Tones of a record, and what else there is; `HearingError` if there is no fundamental."""
    n, dt_s = waveforms.n_samples, waveforms.dt_s
    length_s = min(max(n * dt_s / 6.0, FRAME_S[0]), FRAME_S[1])
    frames = _frames(waveforms, length_s)
    seen = _lines_of_stretches(waveforms, frames)
    if sum(each.stretch.stop - each.stretch.start for each in seen if len(each.f_hz)) < 0.5 * n:
        finer = _frames(waveforms, max(length_s / FINER, FRAME_S[0]))
        other = _lines_of_stretches(waveforms, finer)
        if sum(len(each.f_hz) > 0 for each in other) > sum(len(each.f_hz) > 0 for each in seen):
            seen, frames = other, finer
    if not _loud_samples(seen):
        seen = _multisine(waveforms, frames)
    return _sorted_out(waveforms, seen, frames)


def _loud_samples(seen: list[_Seen]) -> int:
    return sum(each.stretch.stop - each.stretch.start for each in seen if len(each.f_hz))


def _frames(waveforms: Waveforms, length_s: float) -> Frames:
    n = min(int(length_s / waveforms.dt_s), waveforms.n_samples)
    starts = range(0, waveforms.n_samples - n + 1, n)
    some = starts[:: max(1, len(starts) // SOME_FRAMES)]
    f1_hz = float(np.median([fundamental(waveforms, start, start + n) for start in some]))
    return Frames(n, f1_hz, waveforms.dt_s)


# Lines of a stretch


def _lines_of_stretches(waveforms: Waveforms, frames: Frames) -> list[_Seen]:
    """Stretches and their lines; two in a row are one where only weak lines differ, which beats of others made."""
    found: list[_Seen] = []
    for stretch in steady_stretches(waveforms, frames):
        seen = _seen(waveforms, stretch, frames)
        if found and _differ_by_beats(found[-1], seen):
            seen = _seen(waveforms, Stretch(found.pop().stretch.start, stretch.stop), frames)
        found.append(seen)
    return found


def _differ_by_beats(one: _Seen, other: _Seen) -> bool:
    alone, shared = 0.0, 0.0
    for mine, theirs in ((one, other), (other, one)):
        for f, size in zip(mine.f_hz, mine.size, strict=True):
            if _size_elsewhere(theirs, f, mine) < AS_STRONG * size:
                alone = max(alone, float(size))
            elif not _is_usual(mine, f):
                shared = max(shared, float(size))
    return alone < BEATS * shared


def _seen(waveforms: Waveforms, stretch: Stretch, frames: Frames) -> _Seen:
    """All lines of a stretch above the noise, strongest first."""
    n = min(stretch.stop - stretch.start, SPECTRUM_SAMPLES)
    start = (stretch.start + stretch.stop - n) // 2
    f1_hz = fundamental(waveforms, start, start + n)
    size, floor = spectrum(voltage(waveforms, start, start + n), f1_hz, waveforms.dt_s)
    top = np.flatnonzero((size > floor) & (size >= np.roll(size, 1)) & (size >= np.roll(size, -1)))
    top = top[np.argsort(-size[top])][: 2 * MOST_TONES]
    f_hz = np.array([interpolated(size, int(k)) for k in top]) / (n * waveforms.dt_s)
    seen = _Seen(stretch, f_hz, size[top], 1.0 / (n * waveforms.dt_s), f1_hz)
    return _without_sidebands(seen, size)


def _without_sidebands(seen: _Seen, spectrum_size: np.ndarray) -> _Seen:
    """Without lines next to f1 that come in pairs of about equal size: those are a wandering of f1 itself."""
    near = np.abs(seen.f_hz - seen.f1_hz) < max(SIDEBAND_HZ, 4.0 * seen.resolution_hz)
    places = np.rint((2.0 * seen.f1_hz - seen.f_hz) / seen.resolution_hz).astype(int)
    around = (places[:, None] + np.arange(-2, 3)) % len(spectrum_size)
    keep = ~near | (seen.size > SIDEBAND * np.max(spectrum_size[around], axis=1, initial=0.0))
    return seen._replace(f_hz=seen.f_hz[keep], size=seen.size[keep])


def _size_at(seen: _Seen, f_hz: float) -> float:
    """Size of the line at a frequency (V); 0 where there is none."""
    near = np.abs(seen.f_hz - f_hz) < 1.5 * seen.resolution_hz
    return float(np.max(seen.size[near], initial=0.0))


def _size_elsewhere(other: _Seen, f_hz: float, seen: _Seen) -> float:
    """Size in another stretch of a line of ``seen`` (V); a line's place is known to a small part of a bin."""
    bins = 1.5 if _is_usual(seen, f_hz) else SAME_BIN
    near = np.abs(other.f_hz - f_hz) < 1.5 * seen.resolution_hz + bins * other.resolution_hz
    return float(np.max(other.size[near], initial=0.0))


def _multisine(waveforms: Waveforms, frames: Frames) -> list[_Seen]:
    """The whole record as one stretch, where nearly all of its energy is in lines."""
    seen = _seen(waveforms, Stretch(0, waveforms.n_samples), frames)
    n = min(waveforms.n_samples, SPECTRUM_SAMPLES)
    start = (waveforms.n_samples - n) // 2
    rest = without_fundamental(voltage(waveforms, start, start + n), frames.f1_hz, frames.dt_s)
    return [seen] if np.sum(seen.size**2) > LINES * np.mean(np.abs(rest) ** 2) else []


# Which of them are tones


def _sorted_out(waveforms: Waveforms, seen: list[_Seen], frames: Frames) -> Survey:
    found: list[Found] = []
    unused: list[str] = []
    quiet = _quiet(waveforms, seen, frames)
    before = [_seen(waveforms, Stretch(*quiet), frames)] if quiet else []
    references = [*_references(seen), *before]
    for each in seen:
        tones, words = _tones(each, [other for other in references if other.stretch != each.stretch])
        if not len(tones):
            continue
        start, stop = _inside(waveforms, each.stretch, edges(waveforms, each.stretch, tones[:8], frames), frames)
        unused += [f"{word}{_when(waveforms, start, stop)}" for word in words]
        found += [Found(start, stop, float(f), quiet) for f in tones]
    return Survey(tuple(found), (*unused, *_restless(waveforms, seen, found, frames)))


def _restless(waveforms: Waveforms, seen: list[_Seen], found: list[Found], frames: Frames) -> list[str]:
    """Where something changes all the time for longer than an edge takes, in words."""
    calm = sorted([(each.stretch.start, each.stretch.stop) for each in seen] + [(f.start, f.stop) for f in found])
    length_s, until, words = frames.n * frames.dt_s, 0, []
    for start, stop in [*calm, (waveforms.n_samples, waveforms.n_samples)]:
        if calm and start - until > RESTLESS * frames.n:
            words.append(
                f"not used:{_when(waveforms, until, start)} nothing lasts; an experiment is found where it lasts "
                f"{LASTS * length_s:.2g} s without a change: record longer, or tell of it with --manifest"
            )
        until = max(until, stop)
    return words


def _inside(waveforms: Waveforms, stretch: Stretch, on: Stretch, frames: Frames) -> Stretch:
    """A stretch within its edges, but for those of the record."""
    margin, n = round(MARGIN * frames.n), waveforms.n_samples
    start = stretch.start if on.start <= 0 else on.start + margin
    return Stretch(start, n if on.stop >= n else on.stop - margin)


def _quiet(waveforms: Waveforms, seen: list[_Seen], frames: Frames) -> tuple[int, int] | None:
    """Samples before the first tone, where they are enough for a spectrum."""
    for each in seen:
        tones, _ = _tones(each, [other for other in _references(seen) if other is not each])
        if len(tones):
            on = edges(waveforms, each.stretch, tones[:8], frames)
            stop = on.start - round(MARGIN * frames.n)
            return (0, stop) if stop > LEAST_QUIET_S / frames.dt_s else None
    return None


def _when(waveforms: Waveforms, start: int, stop: int) -> str:
    if start == 0 and stop == waveforms.n_samples:
        return ""
    return f" ({waveforms.t0_s + start * waveforms.dt_s:.4g} to {waveforms.t0_s + stop * waveforms.dt_s:.4g} s)"


def _references(seen: list[_Seen]) -> list[_Seen]:
    """The stretches to compare with; none where all have the same lines, which then tell nothing."""
    if len(seen) < 2 or all(_has_all(one, seen[0]) and _has_all(seen[0], one) for one in seen[1:]):
        return []
    return seen


def _has_all(one: _Seen, other: _Seen) -> bool:
    return all(_size_elsewhere(other, f, one) > AS_STRONG * size for f, size in zip(one.f_hz, one.size, strict=True))


def _tones(seen: _Seen, others: list[_Seen]) -> tuple[np.ndarray, list[str]]:
    """Tones of a stretch (Hz, strongest first), and what else there is, in words."""
    always = np.array(
        [_always(seen, f, size, others) for f, size in zip(seen.f_hz, seen.size, strict=True)], dtype=bool
    )
    mirrors = np.array([_size_at(seen, 2.0 * seen.f1_hz - f) for f in seen.f_hz]) > seen.size
    strongest = np.max(seen.size[~always], initial=0.0)
    faint = seen.size < LEAST_TONE * strongest
    chosen = np.flatnonzero(~always & ~mirrors & ~faint)
    words = _in_words("lines that are always there", seen.f_hz[always])
    words += _in_words(f"lines below {LEAST_TONE:.0%} of the strongest tone", seen.f_hz[~always & ~mirrors & faint])
    words += _in_words(f"lines beyond {MOST_TONES} tones", seen.f_hz[chosen[MOST_TONES:]])
    return seen.f_hz[chosen[:MOST_TONES]], words


def _in_words(what: str, f_hz: np.ndarray) -> list[str]:
    if not len(f_hz):
        return []
    shown = ", ".join(f"{f:.5g}" for f in np.sort(f_hz)[:12])
    return [f"not used: {what}, at {shown}{f' and {len(f_hz) - 12} more' if len(f_hz) > 12 else ''} Hz"]


def _always(seen: _Seen, f_hz: float, size: float, others: list[_Seen]) -> bool:
    """Whether a line is there in all other stretches, or, where there are none, a harmonic that networks have."""
    if others:
        return all(_size_elsewhere(other, f_hz, seen) > AS_STRONG * size for other in others)
    return _is_usual(seen, f_hz)


def _is_usual(seen: _Seen, f_hz: float) -> bool:
    """Whether a line is at a harmonic that networks and converters have."""
    order = round(f_hz / seen.f1_hz)
    near = NEAR_BINS * seen.resolution_hz + NEAR_F1 * abs(order - 1) * seen.f1_hz
    usual = order % 6 == 1 or order in (-1, 0, 3, -3)
    return usual and abs(f_hz - order * seen.f1_hz) < near
