"""What physics says about the channels of a recording: sequences of the fundamental, sums, sense of rotation.

Three phases of a healthy system are of about one size, 120 degrees apart and in the order a, b, c. Let X_k be the
phasor of channel k at the fundamental and w_k its weight in the space vector; then, with the conjugate weights for the
other sense of rotation,

    positive = sum_k w_k X_k / 2,   negative = sum_k conj(w_k) X_k / 2.

What is left of X beside its best fit by phases that add up to zero is a zero sequence for phases; for line-to-line
voltages, which add up to zero whatever the network does, it is an error of measurement.

One reversed channel of three turns (positive, negative, rest) = (1, 0, 0) into (1/3, 2/3, 2/3), two exchanged phases
turn it into (0, 1, 0). Every single mistake of that kind is tried; a mistake is put right where exactly one makes the
system healthy, and the recording is refused by the channel's name where none or several do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np

from .recording import Recording, RecordingError

Kind = Literal["voltage", "current"]

PROBE_S = 1.0
"""Length of the stretch that physics is asked about."""

DEAD = 0.02
"""A phase this much smaller than the largest is no phase."""

ZERO_SEQUENCE = 0.02
"""Three phases whose sum is larger than this, relative, are worth a word."""

NEGATIVE = {"voltage": 0.25, "current": 0.5}
"""Largest healthy negative sequence of the fundamental, relative to the positive one."""

EXPLAINED = 0.2
"""Negative sequence and rest that a mistake may leave, once it is put right, to count as the explanation."""

NO_SUM = 0.1
"""Line-to-line voltages whose sum is larger than this, relative to one of them, are not those of one network."""

POWER_FACTOR = 0.94
"""Of three possible exchanges of phases, 120 degrees apart, one is believed where it alone makes the power flow as the
recording is said to count, with at least this power factor; with the others it flows the other way."""

FAINT = 0.05
"""A fundamental below this part of all that a channel shows tells nothing about its phases."""

F1_BAND_HZ = (10.0, 1000.0)

_A = np.exp(2j * np.pi / 3.0)
_ROOT = 1.0 / np.sqrt(3.0)
_ROWS: dict[str, tuple[float, float, float]] = {
    "a": (1, 0, 0),
    "b": (0, 1, 0),
    "c": (0, 0, 1),
    "ab": (1, -1, 0),
    "bc": (0, 1, -1),
    "ca": (-1, 0, 1),
    "ba": (-1, 1, 0),
    "cb": (0, -1, 1),
    "ac": (1, 0, -1),
    "alpha": (2 / 3, -1 / 3, -1 / 3),
    "beta": (0, _ROOT, -_ROOT),
}
"""What a channel of that role is of the phases a, b, c."""

_NO_ZERO = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, -1.0]])
"""Phases that add up to zero, as combinations of the first two."""


@dataclass(frozen=True, slots=True)
class SpaceVector:
    """A space vector as a weighted sum of channels.

    Attributes
    ----------
    kind : "voltage" or "current"
    form : str
        "phases", "two phases", "line_to_line" or "alpha_beta", for people.
    columns : tuple of int
        Channels.
    weights : (n,) complex
        ``x = sum(weights * samples)`` is a phase peak in V or A.
    roles : tuple of str
        What each channel is of the three phases: a, b, c, ab, cb, ..., alpha, beta.
    """

    kind: Kind
    form: str
    columns: tuple[int, ...]
    weights: np.ndarray
    roles: tuple[str, ...]

    def of(self, samples: np.ndarray) -> np.ndarray:
        """Space vector (n,) of samples (n, columns)."""
        x = np.empty(len(samples), dtype=complex)
        x.real = np.einsum("nk,k->n", samples, self.weights.real)
        x.imag = np.einsum("nk,k->n", samples, self.weights.imag)
        return x


def determines(roles: Sequence[str]) -> bool:
    """Whether channels of these roles tell three phases that add up to zero."""
    return bool(np.linalg.matrix_rank(_mixing(roles)) == 2)


def space_vector(kind: Kind, form: str, columns: Sequence[int], roles: Sequence[str]) -> SpaceVector:
    """The vector 2/3 (a + A b + A^2 c), A = exp(2j pi / 3), of channels of given roles.

    A channel of role r is ``row_r @ (a, b, c)``. In a three-wire system (a, b, c) = N y with N (3, 2), so the channels
    are M y with M = rows N, and y is their least-squares solution: the weights are 2/3 (1, A, A^2) N M^+. Three phases
    lose their zero sequence that way, line-to-line voltages their sum.
    """
    weights = 2.0 / 3.0 * np.array([1.0, _A, _A**2]) @ _NO_ZERO @ _inverse(_mixing(roles))
    return SpaceVector(kind, form, tuple(columns), weights, tuple(roles))


def _mixing(roles: Sequence[str]) -> np.ndarray:
    return np.array([_ROWS[role] for role in roles], dtype=float) @ _NO_ZERO


def _inverse(mixing: np.ndarray) -> np.ndarray:
    """M^+ = (M^T M)^-1 M^T (2, k) with the inverse in closed form: the entries are small integers, nothing rounds."""
    (a, b), (c, d) = mixing.T @ mixing
    return np.array([[d, -b], [-c, a]]) @ mixing.T / (a * d - b * c)


# Judging


class _Reading(NamedTuple):
    """One way to read the channels of a vector: the signs (k,) they get, and the vector's weights; in words."""

    signs: np.ndarray
    weights: np.ndarray
    words: str


def judged(
    recording: Recording, voltage: SpaceVector, current: SpaceVector, notes: list[str]
) -> tuple[SpaceVector, SpaceVector]:
    """Voltage and current as physics has them; what is put right and what is left out is added to ``notes``.

    Raises
    ------
    RecordingError
        If a phase is dead, or no single mistake explains what the channels show, or several do.
    """
    probes = [_valid(recording, vector) for vector in (voltage, current)]
    f1_hz = fundamental_hz(voltage.of(probes[0]), recording.dt_s)
    phasors = [_phasors(x, f1_hz, recording.dt_s) for x in probes]
    ways = [_ways(recording, vector, x) for vector, x in zip((voltage, current), phasors, strict=True)]
    chosen = _chosen(recording, ways[0], ways[1], phasors)
    for vector, x, way in zip((voltage, current), probes, chosen, strict=True):
        notes += _left_out(vector, x * way.signs)
    notes += dict.fromkeys(way.words for way in chosen if way.words)
    return replace(voltage, weights=chosen[0].weights), replace(current, weights=chosen[1].weights)


def _valid(recording: Recording, vector: SpaceVector) -> np.ndarray:
    """Samples of about a second (n, k), every channel alive."""
    x = probe(recording, vector.columns)
    x = x[np.all(np.isfinite(x), axis=1)]
    if len(x) < 16:
        raise RecordingError(f"{recording.path}: no valid samples of the {vector.kind}")
    alive = np.std(x, axis=0)
    for k, column in enumerate(vector.columns):
        if not alive[k] > DEAD * np.max(alive):
            name = recording.channels[column].name
            raise RecordingError(
                f"{recording.path}: {name} is dead ({alive[k]:.3g} where others have {np.max(alive):.3g} RMS): a phase "
                f"of the {vector.kind} is missing; in a three-wire system two phases are enough: name those with "
                "--channels"
            )
    return x


def _left_out(vector: SpaceVector, x: np.ndarray) -> list[str]:
    """Zero sequence and offset of channels (n, k) as they were read, in words."""
    notes = []
    zero = np.std(np.sum(x, axis=1)) / 3.0 / np.max(np.std(x, axis=0))
    if vector.form == "phases" and zero > ZERO_SEQUENCE:
        notes.append(f"the {vector.kind} has a zero sequence of {zero:.1%}: left out")
    taper = np.hanning(len(x))
    offset = abs(np.sum(vector.of(x) * taper) / np.sum(taper)) / np.sqrt(np.mean(np.abs(vector.of(x)) ** 2))
    if offset > 0.01:
        notes.append(f"the {vector.kind} has a DC offset of {offset:.1%}: left out")
    return notes


def fundamental_hz(x: np.ndarray, dt_s: float) -> float:
    """Frequency of the strongest line of a space vector, whichever way it turns (Hz)."""
    f_hz = np.fft.fftfreq(len(x), dt_s)
    size = np.abs(np.fft.fft((x - np.mean(x)) * np.hanning(len(x))))
    band = (np.abs(f_hz) >= F1_BAND_HZ[0]) & (np.abs(f_hz) <= F1_BAND_HZ[1])
    peak = int(np.argmax(np.where(band, size, 0.0)))
    left, right = size[peak - 1], size[(peak + 1) % len(size)]
    beside = (right - left) / (right + left + size[peak] + 1e-300) if size[peak] > 0.0 else 0.0
    return float(abs(f_hz[peak] + beside / (len(x) * dt_s)))


def _phasors(x: np.ndarray, f_hz: float, dt_s: float) -> np.ndarray:
    """Phasors (k,) of channels (n, k) at one frequency; zero where it is faint beside the rest of the channels."""
    taper = np.hanning(len(x))
    turn = taper * np.exp(-2j * np.pi * f_hz * dt_s * np.arange(len(x)))
    clean = x - taper @ x / np.sum(taper)
    phasors = 2.0 * turn @ clean / np.sum(taper)
    faint = np.max(np.abs(phasors)) < FAINT * np.max(np.std(clean, axis=0))
    return np.zeros_like(phasors) if faint else np.asarray(phasors)


def _ways(recording: Recording, vector: SpaceVector, x: np.ndarray) -> list[_Reading]:
    """As recorded where that is healthy, else every single mistake that explains the phasors ``x`` (k,)."""
    names = [recording.channels[k].name for k in vector.columns]
    as_recorded, *mistakes = _readings(vector, names)
    if not x.any() or _healthy(vector, as_recorded, x):
        return [as_recorded]
    found = [reading for reading in mistakes if max(_imbalance(vector, reading, x)) <= EXPLAINED]
    if not found:
        raise RecordingError(f"{recording.path}: {_unhealthy(vector, names, x)}")
    return found


def _readings(vector: SpaceVector, names: list[str]) -> list[_Reading]:
    """As recorded, one channel reversed, two phases exchanged."""
    ones = np.ones(len(names))
    turned = [np.where(np.arange(len(names)) == k, -1.0, 1.0) for k in range(len(names))]
    flips = [
        _Reading(s, vector.weights * s, f"{name} is recorded with the opposite sign (a reversed transformer): turned")
        for s, name in zip(turned, names, strict=True)
    ]
    # with b and c exchanged the sum 2/3 (a + A c + A^2 b) is conj(x); with a and b, a and c it is A, A^2 times that
    exchanged = [
        _Reading(
            ones,
            factor * np.conj(vector.weights),
            f"the {vector.kind} rotates backward: its phases {one} and {other} were exchanged",
        )
        for factor, one, other in ((1.0, "b", "c"), (_A, "a", "b"), (_A**2, "a", "c"))
    ]
    return [_Reading(ones, vector.weights, ""), *flips, *exchanged]


class _Imbalance(NamedTuple):
    """Negative sequence relative to the positive one, and what does not add up, relative to what does."""

    negative: float
    rest: float


def _imbalance(vector: SpaceVector, reading: _Reading, x: np.ndarray) -> _Imbalance:
    mixing = _mixing(vector.roles)
    signed = x * reading.signs
    fit = mixing @ _inverse(mixing) @ signed
    own = reading.weights * reading.signs  # the weights act on channels as recorded, signs included
    positive, negative = abs(own @ signed), abs(np.conj(own) @ signed)
    return _Imbalance(negative / (positive + 1e-300), float(np.linalg.norm(signed - fit) / np.linalg.norm(fit)))


def _healthy(vector: SpaceVector, reading: _Reading, x: np.ndarray) -> bool:
    seen = _imbalance(vector, reading, x)
    return seen.negative <= NEGATIVE[vector.kind] and (vector.form == "phases" or seen.rest <= NO_SUM)


def _unhealthy(vector: SpaceVector, names: list[str], x: np.ndarray) -> str:
    """What is wrong with the phasors, and which channel is the odd one."""
    seen = _imbalance(vector, _readings(vector, names)[0], x)
    wrong = f"a negative sequence of {seen.negative:.0%} of the positive one"
    if vector.form != "phases" and seen.rest > NO_SUM:
        wrong = f"a sum of {abs(np.sum(x)) / np.max(np.abs(x)):.0%} of one of them, where it must be zero"
    sizes = ", ".join(
        f"{name} {abs(size):.4g} at {np.angle(size / x[0], deg=True):.0f} degrees"
        for name, size in zip(names, x, strict=True)
    )
    return (
        f"the {vector.kind} has {wrong} at the fundamental ({sizes}), and no single reversed or exchanged channel "
        f"explains it{_odd_one(vector, names, x)}"
    )


def _odd_one(vector: SpaceVector, names: list[str], x: np.ndarray) -> str:
    """The channel without which the others make a healthy system, where there is exactly one."""

    def without(k: int) -> bool:
        kept = [n for n in range(len(names)) if n != k]
        roles = [vector.roles[n] for n in kept]
        if not determines(roles):
            return False
        pair = space_vector(vector.kind, "two", kept, roles)
        return _imbalance(pair, _readings(pair, [names[n] for n in kept])[0], x[kept]).negative < ZERO_SEQUENCE * 2.0

    odd = [k for k in range(len(names)) if len(names) > 2 and without(k)]
    if len(odd) != 1:
        return ": check how they were connected, or name channels with --channels"
    letter = "v" if vector.kind == "voltage" else "i"
    others = ",".join(f"{letter}{vector.roles[n]}={names[n]}" for n in range(len(names)) if n != odd[0])
    return f": {names[odd[0]]} does not fit the other two; without it: --channels {others}"


def _chosen(
    recording: Recording, voltages: list[_Reading], currents: list[_Reading], phasors: list[np.ndarray]
) -> tuple[_Reading, _Reading]:
    """The readings of both quantities, where there is one pair of them that the data single out."""
    pairs = [(v, i) for v in voltages for i in currents]
    if len(pairs) == 1:
        return pairs[0]
    alike = [(v, i) for v, i in pairs if _same_exchange(v, i)]
    if alike:  # names in the other order for both: whichever pair of phases it was, Y is the same
        return alike[0]
    likely = [pair for pair in pairs if _power_factor(pair, phasors) >= POWER_FACTOR]
    if len(likely) == 1 and not any("sign" in reading.words for reading in (*voltages, *currents)):
        return likely[0]
    several = currents if len(currents) > 1 else voltages
    raise RecordingError(
        f"{recording.path}: the channels contradict one another, and several single mistakes would explain it ("
        f"{'; or '.join(reading.words.removesuffix(': turned') for reading in several)}): say which channel is which "
        "with --channels, or mend the recording"
    )


def _same_exchange(v: _Reading, i: _Reading) -> bool:
    return "exchanged" in v.words and v.words.replace("voltage", "current") == i.words


def _power_factor(pair: tuple[_Reading, _Reading], phasors: list[np.ndarray]) -> float:
    """Of the fundamental, positive where power flows as the current was said to count."""
    v, i = (reading.weights @ x for reading, x in zip(pair, phasors, strict=True))
    return float(np.real(v * np.conj(i)) / (abs(v * i) + 1e-300))


def probe(recording: Recording, columns: Sequence[int]) -> np.ndarray:
    """Samples of about a second from the middle of a recording."""
    n = min(recording.n_samples, max(64, int(PROBE_S / recording.dt_s)), 1 << 20)
    start = (recording.n_samples - n) // 2
    return recording.samples(columns, start, start + n)
