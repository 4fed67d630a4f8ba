"""Which channel is which: by name and unit, then by physics. A guess is always printed and can be overruled.

Whatever was recorded (three phases, two of them, line-to-line voltages in either direction, alpha and beta), the space
vector is a sum of channels with complex weights; scale and phase order are in the weights (`sequences`).
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import NamedTuple

import numpy as np

from .recording import Channel, Recording, RecordingError, names_of
from .sequences import Kind, SpaceVector, determines, judged, probe, space_vector
from .units import Size, in_the_way, is_per_unit, says_nothing, unit_of

ROLES = (
    *("va", "vb", "vc", "vab", "vbc", "vca", "vba", "vcb", "vac", "valpha", "vbeta"),
    *("ia", "ib", "ic", "ialpha", "ibeta"),
)

_ALPHABETS = {
    "phases": ("a b c", "l1 l2 l3", "r s t", "an bn cn", "1 2 3", "0 1 2", "u v w"),
    "line_to_line": ("ab bc ca", "l12 l23 l31", "12 23 31", "rs st tr", "uv vw wu"),
    "alpha_beta": ("alpha beta", "al be"),
}
_TOLD_BY_TWO = ("a b c", "l1 l2 l3", "an bn cn")
"""Names of phases of which two are enough."""

_KINDS: tuple[Kind, ...] = ("voltage", "current")
_DIRECT = re.compile(r"dc\W*$", re.IGNORECASE)
"""Ends the name of a direct voltage or current, not of a phase c."""

_AT_TERMINAL = re.compile(r"pcc|poc|poi|term|meas|wt(?![a-z])", re.IGNORECASE)


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
    recording: Recording,
    given: Mapping[str, str] | None = None,
    base: tuple[float, float] | None = None,
    units: Mapping[str, str] | None = None,
) -> Assignment:
    """Find voltage and current of a recording.

    Parameters
    ----------
    recording : Recording
        Its names and units, then a stretch of its samples, are looked at.
    given : mapping of role to channel name, optional
        What the user says; roles as in `ROLES`. Whatever is not given is guessed.
    base : (V, A), optional
        Rated phase peaks, for channels in per unit, and for what is too far from them to be believed.
    units : mapping of str to str, optional
        Unit of "voltage" and of "current" as the user says it; it overrules the file.

    Raises
    ------
    RecordingError
        If v or i is not found or not the only one, a phase is missing or dead, or a unit is unusable.
    """
    given = given or {}
    notes: list[str] = []
    vectors = []
    for kind in _KINDS:
        columns = {role: recording.column(name) for role, name in given.items() if role[0] == _letter(kind)}
        vector = _as_given(recording, kind, columns) if columns else _guessed(recording, kind, notes)
        vectors.append(vector)
    told = units or {}
    scaled = [_scaled(recording, vector, base, told.get(vector.kind), notes) for vector in vectors]
    voltage, current = judged(recording, scaled[0], scaled[1], notes)
    return Assignment(voltage, current, tuple(notes))


def in_words(recording: Recording, vector: SpaceVector) -> str:
    """The channels of a space vector, for people."""
    shown = [recording.channels[k] for k in vector.columns]
    names = ", ".join(f"{each.name} [{each.unit}]" if each.unit else each.name for each in shown)
    return f"{vector.kind}: {names} ({vector.form.replace('_', ' ')})"


# As given


def _as_given(recording: Recording, kind: Kind, columns: Mapping[str, int]) -> SpaceVector:
    letter = _letter(kind)
    roles = tuple(role[1:] for role in columns)
    form = _form_of(roles)
    if form is None or not determines(roles):
        raise RecordingError(
            f"{recording.path}: channels {', '.join(columns)} make no {kind}: give {letter}a, {letter}b, {letter}c, or "
            f"two of them, or line-to-line vab, vbc, vca (or vba, ...), two of them, or {letter}alpha, {letter}beta"
        )
    return space_vector(kind, form, tuple(columns.values()), roles)


def _form_of(roles: Sequence[str]) -> str | None:
    """What channels of these roles are together, for people; None where they do not go together."""
    if set(roles) == {"alpha", "beta"}:
        return "alpha_beta"
    if all(role in ("a", "b", "c") for role in roles):
        return "phases" if len(roles) == 3 else "two phases"
    if all(len(role) == 2 for role in roles):
        return "line_to_line" if len(roles) == 3 else "two line_to_line"
    return None


def _letter(kind: Kind) -> str:
    return "v" if kind == "voltage" else "i"


# Guessed


class _Group(NamedTuple):
    """Channels that could be a quantity: its form, and the columns and roles of the channels."""

    form: str
    columns: tuple[int, ...]
    roles: tuple[str, ...]


def _guessed(recording: Recording, kind: Kind, notes: list[str]) -> SpaceVector:
    groups = _complete(recording.channels, kind) or _pairs(recording.channels, kind)
    if not groups:
        raise RecordingError(_nothing(recording, kind))
    here = [group for group in groups if _AT_TERMINAL.search(recording.channels[group.columns[0]].name)]
    chosen = groups if len(groups) == 1 else here
    if len(chosen) != 1:
        shown = "; ".join(", ".join(recording.channels[k].name for k in group.columns) for group in groups[:6])
        letter = _letter(kind)
        raise RecordingError(
            f"{recording.path}: several could be the {kind} ({shown}): "
            f"give --channels {letter}a=...,{letter}b=...,{letter}c=..."
        )
    if len(groups) > 1:
        notes.append(f"several could be the {kind}: the one at the terminal, by its name, was taken")
    group = chosen[0]
    if group.form == "two phases":
        notes.append(f"two phases of the {kind}: the third is taken as minus their sum (three wires)")
    return space_vector(kind, group.form, group.columns, group.roles)


def _complete(channels: Sequence[Channel], kind: Kind) -> list[_Group]:
    """Everything that could be this quantity with all of its channels, by the ends of names, else by words in them."""
    return _all_there(channels, kind, within=False) or _all_there(channels, kind, within=True)


def _all_there(channels: Sequence[Channel], kind: Kind, within: bool) -> list[_Group]:
    found: list[_Group] = []
    taken: set[int] = set()
    mine = [k for k, channel in enumerate(channels) if _kind(channel) == kind]
    for form in ("phases", *(("line_to_line",) if kind == "voltage" else ()), "alpha_beta"):
        size = 2 if form == "alpha_beta" else 3
        for alphabet in _ALPHABETS[form]:
            free = [k for k in mine if k not in taken]
            for group in _families(channels, free, form, _roles_of(form, alphabet), within):
                if len(group.columns) == size and determines(group.roles):
                    found.append(group)
                    taken.update(group.columns)
    return found


def _pairs(channels: Sequence[Channel], kind: Kind) -> list[_Group]:
    """Two channels that tell the third in a three-wire system; line-to-line voltages come first."""
    mine = [k for k, channel in enumerate(channels) if _kind(channel) == kind and not _DIRECT.search(channel.name)]
    lines = [("line_to_line", alphabet) for alphabet in _ALPHABETS["line_to_line"]] if kind == "voltage" else []
    for form, alphabet in (*lines, *(("phases", alphabet) for alphabet in _TOLD_BY_TWO)):
        families = _families(channels, mine, form, _roles_of(form, alphabet))
        found = [group for group in families if len(group.columns) == 2 and determines(group.roles)]
        if found:
            return [group._replace(form=_form_of(group.roles) or group.form) for group in found]
    return []


def _roles_of(form: str, alphabet: str) -> dict[str, str]:
    """Role of every ending of an alphabet; line-to-line voltages may also be named the other way round."""
    letters = alphabet.split()
    roles = {"phases": ("a", "b", "c"), "line_to_line": ("ab", "bc", "ca"), "alpha_beta": ("alpha", "beta")}[form]
    found = dict(zip(letters, roles, strict=True))
    if form == "line_to_line":
        found |= {letter[:-2] + letter[:-3:-1]: role[::-1] for letter, role in zip(letters, roles, strict=True)}
    return found


def _families(
    channels: Sequence[Channel], among: Sequence[int], form: str, roles: Mapping[str, str], within: bool = False
) -> list[_Group]:
    """Channels whose names differ in their phase alone, in the order of ``roles``."""
    families: dict[str, dict[str, int]] = {}
    split_of = _phase_within if within else _stem_and_phase
    for k in among:
        if (split := split_of(channels[k], tuple(roles))) is not None:
            families.setdefault(split[0], {}).setdefault(roles[split[1]], k)
    order = [dict.fromkeys(role for role in roles.values() if role in family) for family in families.values()]
    return [
        _Group(form, tuple(family[role] for role in there), tuple(there))
        for family, there in zip(families.values(), order, strict=True)
    ]


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


def _phase_within(channel: Channel, letters: Sequence[str]) -> tuple[str, str] | None:
    """Name without the first word's end that is a phase, and the phase: "va, bus 3", "phase a voltage"."""
    name = channel.name.lower()
    found = re.search(rf"({'|'.join(sorted(letters, key=len, reverse=True))})(?=[^a-z0-9]|$)", name)
    return (f"{name[: found.start()]}*{name[found.end() :]}", found[1]) if found else None


def _kind(channel: Channel) -> Kind | None:
    """Voltage or current, by unit, else by name."""
    if (known := unit_of(channel.unit)) is not None:
        return known[0]
    if not (is_per_unit(channel.unit) or says_nothing(channel.unit)):
        return None
    if found := re.search(r"^[a-z]:([ui])\d?:", channel.name.strip().lower()):  # PowerFactory: m:u:A, s:i:bus1:B
        return "voltage" if found[1] == "u" else "current"
    name = channel.name.strip().lower().rsplit(":", 1)[-1].rsplit("/", 1)[-1]
    if re.search(r"rms|power|freq|angle|speed|_ref|ref$|mag", name):
        return None
    if re.search(r"volt|spannung|^[uve](?![a-z]{4})|[_ .][uv](?:[_ .]|l?[abc123rst]?$)", name):
        return "voltage"
    if re.search(r"curr|strom|^i(?![a-z]{4})|[_ .]i(?:[_ .]|l?[abc123rst]?$)", name):
        return "current"
    return None


def _nothing(recording: Recording, kind: Kind) -> str:
    """What to say where names and units lead nowhere: what is there, or what physics sees, and how to go on."""
    letter = _letter(kind)
    option = f"--channels {letter}a=NAME,{letter}b=NAME,{letter}c=NAME"
    among = f"among {names_of(recording.channels)}"
    if words := _incomplete(recording.channels, kind):
        return (
            f"{recording.path}: {words} {among}; needed: three phases, or in a three-wire system two of them: record "
            f"them, or name those that go by other names with {option}"
        )
    triples = ["(" + ", ".join(recording.channels[k].name for k in each) + ")" for each in _balanced(recording)]
    seen = f"; by physics {' and '.join(triples[:4])} are three-phase systems" if triples else ""
    return f"{recording.path}: no {kind} found {among}{seen}: name it with {option}"


def _incomplete(channels: Sequence[Channel], kind: Kind) -> str:
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
    x = np.nan_to_num(probe(recording, columns))
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


# Scale


def _scaled(
    recording: Recording,
    vector: SpaceVector,
    base: tuple[float, float] | None,
    told: str | None,
    notes: list[str],
) -> SpaceVector:
    """Weights in V or A; the unit that is ``told`` overrules the file's."""
    rated = None if base is None else base[0 if vector.kind == "voltage" else 1]
    written = {recording.channels[k].unit.strip() for k in vector.columns}
    if told is None and len(written) > 1:
        raise RecordingError(
            f"{recording.path}: channels of the {vector.kind} have different units: {', '.join(sorted(written))}"
        )
    unit = told if told is not None else written.pop()
    if written - {unit, ""} and told is not None:
        notes.append(f"the {vector.kind} is in {told}, as asked, where the file says {', '.join(sorted(written))}")
    factor, stated = _factor(recording, vector.kind, unit, rated), not says_nothing(unit)
    scaled = replace(vector, weights=vector.weights * factor)
    x = np.abs(scaled.of(probe(recording, vector.columns)))
    size = float(np.sqrt(np.mean(x[np.isfinite(x)] ** 2))) if np.any(np.isfinite(x)) else 0.0
    if problem := in_the_way(vector.kind, Size(size, factor, stated), rated) if size > 0.0 else "":
        raise RecordingError(f"{recording.path}: {problem}")
    if is_per_unit(unit):
        notes.append(f"{vector.kind} in per unit of {factor:.6g} (phase peak)")
    if not stated:
        notes.append(f"the {vector.kind} has no known unit: taken as {'V' if vector.kind == 'voltage' else 'A'}")
    return scaled


def _factor(recording: Recording, kind: Kind, unit: str, rated: float | None) -> float:
    """V or A per unit of a channel."""
    if is_per_unit(unit):
        if rated is None:
            raise RecordingError(
                f"{recording.path}: the {kind} is in per unit: give --rated-voltage-v and --rated-power-va"
            )
        return rated
    if says_nothing(unit):
        return 1.0
    known = unit_of(unit)
    if known is None or known[0] != kind:
        raise RecordingError(
            f"{recording.path}: a channel of the {kind} is in {unit!r}, which is no unit of a {kind}: --{kind}-unit "
            "says what it is"
        )
    return known[1]
