"""Which channel is which: by name and unit, then by physics. A guess is always printed and can be overruled.

Whatever was recorded (three phases, two of them, line-to-line voltages, alpha and beta), the space vector is a sum of
channels with complex weights; scale and phase order are in the weights.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Literal

import numpy as np

from .recording import Channel, Recording, RecordingError, names_of

Kind = Literal["voltage", "current"]
ROLES = ("va", "vb", "vc", "vab", "vbc", "vca", "valpha", "vbeta", "ia", "ib", "ic", "ialpha", "ibeta")

PROBE_S = 1.0
"""Length of the stretch that physics is asked about."""

DEAD = 0.02
"""A phase this much smaller than the largest is no phase."""

ZERO_SEQUENCE = 0.02
"""Three phases whose sum is larger than this, relative, are worth a word."""

_A = np.exp(2j * np.pi / 3.0)
_ALPHABETS = {
    "phases": ("a b c", "l1 l2 l3", "r s t", "an bn cn", "1 2 3", "0 1 2", "u v w"),
    "line_to_line": ("ab bc ca", "l12 l23 l31", "12 23 31", "rs st tr", "uv vw wu"),
    "alpha_beta": ("alpha beta", "al be"),
}
_UNITS = {
    "v": 1.0,
    "volt": 1.0,
    "volts": 1.0,
    "kv": 1e3,
    "mv": 1e-3,
    "a": 1.0,
    "amp": 1.0,
    "amps": 1.0,
    "ka": 1e3,
    "ma": 1e-3,
}
_DIRECT = re.compile(r"dc\W*$", re.IGNORECASE)
"""Ends the name of a direct voltage or current, not of a phase c."""

_AT_TERMINAL = re.compile(r"pcc|poc|poi|term|meas|wt(?![a-z])", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class SpaceVector:
    """A space vector as a weighted sum of channels.

    Attributes
    ----------
    kind : "voltage" or "current"
    form : str
        "phases", "two phases", "line_to_line" or "alpha_beta".
    columns : tuple of int
        Channels.
    weights : (n,) complex
        ``x = sum(weights * samples)`` is a phase peak in V or A.
    """

    kind: Kind
    form: str
    columns: tuple[int, ...]
    weights: np.ndarray

    def of(self, samples: np.ndarray) -> np.ndarray:
        """Space vector (n,) of samples (n, columns)."""
        x = np.empty(len(samples), dtype=complex)
        x.real = np.einsum("nk,k->n", samples, self.weights.real)
        x.imag = np.einsum("nk,k->n", samples, self.weights.imag)
        return x


@dataclass(frozen=True, slots=True)
class Assignment:
    """Voltage, current, and what was seen and assumed on the way."""

    voltage: SpaceVector
    current: SpaceVector
    notes: tuple[str, ...]


def parse_channels(text: str) -> dict[str, str]:
    """``{"va": "U1", ...}`` of "va=U1,vb=U2,..."; `RecordingError` where a role is unknown or given twice."""
    given: dict[str, str] = {}
    for part in filter(None, (part.strip() for part in text.split(","))):
        role, equals, name = (piece.strip() for piece in part.partition("="))
        if role.lower() not in ROLES or not equals or not name:
            raise RecordingError(f"channels: {part!r} is not ROLE=NAME with a role of {', '.join(ROLES)}")
        if role.lower() in given:
            raise RecordingError(f"channels: {role} is given twice")
        given[role.lower()] = name
    return given


def assign(
    recording: Recording, given: Mapping[str, str] | None = None, base: tuple[float, float] | None = None
) -> Assignment:
    """Find voltage and current of a recording.

    Parameters
    ----------
    recording : Recording
        Its names and units, then a stretch of its samples, are looked at.
    given : mapping of role to channel name, optional
        What the user says; roles as in `ROLES`. Whatever is not given is guessed.
    base : (V, A), optional
        Rated phase peaks, for channels in per unit.

    Raises
    ------
    RecordingError
        If v or i is not found or not the only one, a phase is missing or dead, or a unit is unusable.
    """
    given = given or {}
    notes: list[str] = []
    vectors = []
    for kind in ("voltage", "current"):
        columns = {role: recording.column(name) for role, name in given.items() if role[0] == kind[0].replace("c", "i")}
        vector = _as_given(recording, kind, columns) if columns else _guessed(recording, kind, notes)
        vectors.append(_scaled(recording, vector, base, notes))
    voltage, current = (_checked(recording, vector, notes) for vector in vectors)
    return Assignment(voltage, current, tuple(notes))


def in_words(recording: Recording, vector: SpaceVector) -> str:
    """The channels of a space vector, for people."""
    shown = [recording.channels[k] for k in vector.columns]
    names = ", ".join(f"{each.name} [{each.unit}]" if each.unit else each.name for each in shown)
    return f"{vector.kind}: {names} ({vector.form.replace('_', ' ')})"


# As given


def _as_given(recording: Recording, kind: str, columns: Mapping[str, int]) -> SpaceVector:
    forms = {
        "phases": ("a", "b", "c"),
        "two phases": ("a", "b"),
        "line_to_line": ("ab", "bc", "ca"),
        "two line_to_line": ("ab", "bc"),
        "alpha_beta": ("alpha", "beta"),
    }
    suffixes = {role[1:] for role in columns}
    for form, needed in forms.items():
        if suffixes == set(needed):
            return _vector(kind, form, [columns[kind[0].replace("c", "i") + suffix] for suffix in needed])
    letter = kind[0].replace("c", "i")
    raise RecordingError(
        f"{recording.path}: channels {', '.join(columns)} make no {kind}: give {letter}a, {letter}b, {letter}c, or two "
        f"of them, or line-to-line vab, vbc, vca, or {letter}alpha, {letter}beta"
    )


def _vector(kind: str, form: str, columns: Sequence[int]) -> SpaceVector:
    """Weights by form; in a three-wire system the third quantity follows from the other two."""
    to_phases = {
        "phases": np.eye(3),
        "two phases": np.array([[1, 0], [0, 1], [-1, -1]]),
        "line_to_line": np.array([[1, 0, -1], [-1, 1, 0], [0, -1, 1]]) / 3.0,
        "two line_to_line": np.array([[2, 1], [-1, 1], [-1, -2]]) / 3.0,
    }
    if form == "alpha_beta":
        weights = np.array([1.0, 1.0j])
    else:
        weights = 2.0 / 3.0 * np.array([1.0, _A, _A**2]) @ to_phases[form]
    return SpaceVector("voltage" if kind == "voltage" else "current", form, tuple(columns), weights)


# Guessed


def _guessed(recording: Recording, kind: str, notes: list[str]) -> SpaceVector:
    groups = _groups(recording.channels, kind)
    if not groups:
        raise RecordingError(_nothing(recording, kind))
    complete = [group for group in groups if group[0] != "two phases"] or groups
    here = [group for group in complete if _AT_TERMINAL.search(recording.channels[group[1][0]].name)]
    chosen = complete if len(complete) == 1 else here
    if len(chosen) != 1:
        shown = "; ".join(", ".join(recording.channels[k].name for k in columns) for _, columns in complete[:6])
        letter = kind[0].replace("c", "i")
        raise RecordingError(
            f"{recording.path}: several could be the {kind} ({shown}): "
            f"give --channels {letter}a=...,{letter}b=...,{letter}c=..."
        )
    form, columns = chosen[0]
    if len(complete) > 1:
        notes.append(f"several could be the {kind}: the one at the terminal, by its name, was taken")
    if form == "two phases":
        notes.append(f"two phases of the {kind}: the third is taken as minus their sum (three wires)")
    return _vector(kind, form, columns)


def _groups(channels: Sequence[Channel], kind: str) -> list[tuple[str, list[int]]]:
    """Form and columns of everything that could be this quantity, by names and units."""
    found: list[tuple[str, list[int]]] = []
    taken: set[int] = set()
    mine = [k for k, channel in enumerate(channels) if _kind(channel) == kind]
    for form, alphabets in _ALPHABETS.items():
        if form == "line_to_line" and kind == "current":
            continue
        for alphabet in alphabets:
            for columns in _families(channels, [k for k in mine if k not in taken], alphabet.split()):
                found.append((form, columns))
                taken.update(columns)
    if not found:
        two = (("two phases", "a b"), ("two phases", "l1 l2"), ("two phases", "an bn"))
        lines = tuple(("two line_to_line", pair) for pair in ("ab bc", "l12 l23", "12 23"))
        for form, alphabet in (*lines, *two) if kind == "voltage" else two:
            found = found or [(form, columns) for columns in _families(channels, mine, alphabet.split())]
    return found


def _families(channels: Sequence[Channel], among: Sequence[int], letters: Sequence[str]) -> list[list[int]]:
    """Columns whose names differ in their phase alone, in the order of ``letters``."""
    families: dict[str, dict[str, int]] = {}
    for k in among:
        if (split := _stem_and_phase(channels[k], letters)) is not None:
            families.setdefault(split[0], {}).setdefault(split[1], k)
    return [[family[letter] for letter in letters] for family in families.values() if set(family) == set(letters)]


def _stem_and_phase(channel: Channel, letters: Sequence[str]) -> tuple[str, str] | None:
    """Name without its phase, and the phase; the file's own word for the phase counts where the name has none."""
    name = re.sub(r"[\])}'\s]+$", "", channel.name.lower())
    for letter in sorted(letters, key=len, reverse=True):
        if name.endswith(letter):
            stem = name[: -len(letter)]
            if len(letter) > 1 or not re.search(r"(?<![a-z])(alph|bet|alpha|beta)$", name):
                return re.sub(r"[\s_\-.:\[({]+$", "", stem), letter
    word = channel.phase.strip().lower()
    return (re.sub(r"[\d\s_]+$", "", name), word) if word in letters else None


def _kind(channel: Channel) -> Kind | None:
    """Voltage or current, by unit, else by name."""
    unit = channel.unit.strip().lower()
    if unit in _UNITS:
        return "voltage" if unit.rstrip("olts").endswith("v") else "current"
    if unit not in ("", "pu", "p.u.", "1", "-"):
        return None
    name = channel.name.strip().lower().rsplit(":", 1)[-1].rsplit("/", 1)[-1]
    if re.search(r"rms|power|freq|angle|speed|_ref|ref$|mag", name):
        return None
    if re.search(r"volt|spannung|^[uve](?![a-z]{4})|[_ .][uv](?:[_ .]|l?[abc123rst]?$)", name):
        return "voltage"
    if re.search(r"curr|strom|^i(?![a-z]{4})|[_ .]i(?:[_ .]|l?[abc123rst]?$)", name):
        return "current"
    return None


def _nothing(recording: Recording, kind: str) -> str:
    """What to say where names and units lead nowhere: what is there, or what physics sees, and how to go on."""
    letter = kind[0].replace("c", "i")
    option = f"--channels {letter}a=NAME,{letter}b=NAME,{letter}c=NAME"
    among = f"among {names_of(recording.channels)}"
    if words := _incomplete(recording.channels, kind):
        return (
            f"{recording.path}: {words} {among}; needed: three phases, or in a three-wire system two of them, a and b: "
            f"record them, or name those that go by other names with {option}"
        )
    triples = ["(" + ", ".join(recording.channels[k].name for k in each) + ")" for each in _balanced(recording)]
    seen = f"; by physics {' and '.join(triples[:4])} are three-phase systems" if triples else ""
    return f"{recording.path}: no {kind} found {among}{seen}: name it with {option}"


def _incomplete(channels: Sequence[Channel], kind: str) -> str:
    """Which phases of a quantity are there and which are missing, by their names; empty where no name tells."""
    mine = [channel for channel in channels if _kind(channel) == kind and not _DIRECT.search(channel.name)]
    lines = _ALPHABETS["line_to_line"] if kind == "voltage" else ()
    for alphabet in (*lines, *_ALPHABETS["phases"]):
        letters = alphabet.split()
        split = {channel.name: found for channel in mine if (found := _stem_and_phase(channel, letters)) and found[0]}
        for name, (stem, letter) in split.items():
            there = {other: phase for other, (of, phase) in split.items() if of == stem}
            missing = [_renamed(name, letter, phase) for phase in letters if phase not in there.values()]
            return f"of the {kind} {_listed(list(there))} there and {_listed(missing)} missing"
    return ""


def _renamed(name: str, letter: str, other: str) -> str:
    """The name that another phase would have; the phase alone where the name does not end in it."""
    end = len(re.sub(r"[\])}'\s]+$", "", name))
    start = end - len(letter)
    if name[start:end].lower() != letter:
        return f"phase {other}"
    return name[:start] + (other.upper() if name[start:end].isupper() else other) + name[end:]


def _listed(names: Sequence[str]) -> str:
    verb = "is" if len(names) == 1 else "are"
    return f"{' and '.join(map(repr, names))} {verb}"


def _balanced(recording: Recording) -> list[tuple[int, ...]]:
    """Triples of channels, equal in size and zero in sum at the strongest frequency."""
    columns = list(range(min(len(recording.channels), 12)))
    x = np.nan_to_num(_probe(recording, columns))
    spectrum = np.fft.rfft(x * np.hanning(len(x))[:, None], axis=0)
    spectrum[:3] = 0.0
    phasors = spectrum[int(np.argmax(np.max(np.abs(spectrum), axis=1)))]
    size = np.abs(phasors)
    return [
        each
        for each in combinations(columns, 3)
        if np.ptp(size[list(each)]) < 0.1 * np.max(size[list(each)]) > 0.0
        and abs(np.sum(phasors[list(each)])) < 0.1 * np.max(size[list(each)])
    ]


# Scale and physics


def _scaled(
    recording: Recording, vector: SpaceVector, base: tuple[float, float] | None, notes: list[str]
) -> SpaceVector:
    """Weights in V or A."""
    units = {recording.channels[k].unit.strip().lower() for k in vector.columns}
    if len(units) > 1:
        raise RecordingError(
            f"{recording.path}: channels of the {vector.kind} have different units: {', '.join(sorted(units))}"
        )
    unit = units.pop()
    if unit in ("pu", "p.u."):
        if base is None:
            raise RecordingError(
                f"{recording.path}: the {vector.kind} is in per unit: give --rated-voltage-v and --rated-power-va"
            )
        factor = base[0 if vector.kind == "voltage" else 1]
        notes.append(f"{vector.kind} in per unit of {factor:.6g} (phase peak)")
    elif unit in _UNITS:
        factor = _UNITS[unit]
    else:
        factor = 1.0
        notes.append(f"the {vector.kind} has no known unit: taken as {'V' if vector.kind == 'voltage' else 'A'}")
    return replace(vector, weights=vector.weights * factor)


def _checked(recording: Recording, vector: SpaceVector, notes: list[str]) -> SpaceVector:
    """The vector as physics has it: every phase alive, rotating forward."""
    x = _probe(recording, vector.columns)
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
    if vector.form == "phases" and np.std(np.sum(x, axis=1)) > ZERO_SEQUENCE * np.max(alive) * 3.0:
        notes.append(
            f"the {vector.kind} has a zero sequence of {np.std(np.sum(x, axis=1)) / 3 / np.max(alive):.1%}: left out"
        )
    taper = np.hanning(len(x))
    offset = abs(np.sum(vector.of(x) * taper) / np.sum(taper)) / np.sqrt(np.mean(np.abs(vector.of(x)) ** 2))
    if offset > 0.01:
        notes.append(f"the {vector.kind} has a DC offset of {offset:.1%}: left out")
    if not _rotates_forward(vector.of(x)):
        notes.append(f"the {vector.kind} rotates backward: its phases b and c were exchanged")
        return replace(vector, weights=np.conj(vector.weights))
    return vector


def _rotates_forward(x: np.ndarray) -> bool:
    spectrum = np.abs(np.fft.fft((x - np.mean(x)) * np.hanning(len(x))))
    half = len(x) // 2
    return bool(np.max(spectrum[1:half]) > np.max(spectrum[half + 1 :]))


def _probe(recording: Recording, columns: Sequence[int]) -> np.ndarray:
    """Samples of about a second from the middle of a recording."""
    n = min(recording.n_samples, max(64, int(PROBE_S / recording.dt_s)), 1 << 20)
    start = (recording.n_samples - n) // 2
    return recording.samples(columns, start, start + n)
