"""What the headings of a table of Z(f) say: frequency, R and X, magnitude and angle, which sequence."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from .errors import GridError

_PARTS = {
    **dict.fromkeys(("r", "re", "real", "resistance", "rnet", "rs"), "re"),
    **dict.fromkeys(("x", "im", "imag", "imaginary", "reactance", "xnet", "xs"), "im"),
    **dict.fromkeys(("abs", "mag", "magnitude", "modulus", "zmag", "zabs", "db"), "mag"),
    **dict.fromkeys(("phase", "angle", "ang", "arg", "phi", "theta", "ph", "deg", "phz", "zphase", "zang"), "phase"),
    **dict.fromkeys(("std", "sigma", "uncertainty"), "std"),
    **dict.fromkeys(("z", "impedance", "zcomplex", "complex"), "z"),
}
_FREQUENCIES = ("f", "freq", "frequency", "hz", "khz", "omega", "w", "harmonic", "order", "h", "frequenz")
_SEQUENCES = {
    **dict.fromkeys(("1", "pos", "positive", "p", "pps", "direct", "mitsystem"), "positive"),
    **dict.fromkeys(("2", "neg", "negative", "n", "nps", "inverse", "gegensystem"), "negative"),
    **dict.fromkeys(("0", "zero", "zps", "homopolar", "nullsystem"), "zero"),
}
_UNITS = {
    **{"ohm": 1.0, "ω": 1.0, "Ω": 1.0, "\N{OHM SIGN}": 1.0, "ohms": 1.0},
    **{"mohm": 1e-3, "mω": 1e-3, "mΩ": 1e-3, "milliohm": 1e-3, "kohm": 1e3, "kω": 1e3, "kΩ": 1e3},
    **{"hz": 1.0, "khz": 1e3, "rad/s": 1.0 / (2.0 * np.pi), "1/s": 1.0 / (2.0 * np.pi)},
    **{"db": 1.0, "deg": 1.0, "°": 1.0, "degrees": 1.0, "rad": 180.0 / np.pi, "radians": 180.0 / np.pi},
    **{"-": 1.0, "1": 1.0, "": 1.0},
}

_RELATIVE = ("pu", "p.u.", "%")
_UNIT_WORDS = ("ohm", "ohms", "mohm", "milliohm", "kohm", "hz", "khz", "deg", "degrees", "rad", "radians", "pu")

SAME_SEQUENCES = 0.02
"""Part of |Z| by which positive and negative sequence of a passive symmetric grid may differ in a table."""


class Heading(NamedTuple):
    """What one heading says: ``what`` is "f", a part of z or "other"; ``unit`` as written, lower case."""

    what: str
    sequence: str
    unit: str
    is_order: bool = False


def heading_of(text: str) -> Heading:
    """Recognise ``f [Hz]``, ``R1 (ohm)``, ``|Z+|(ohms)``, ``Network Impedance, Magnitude in Ohm``, ``z0_re``, ..."""
    bare, unit = _split_unit(text)
    words = _words(bare)
    parts = [_PARTS[word] for word in words if word in _PARTS]
    sequence = next((_SEQUENCES[word] for word in words if word in _SEQUENCES), "")
    unit = unit or next((word for word in words if word in _UNIT_WORDS), "")
    if words and words[0] in _FREQUENCIES and not [part for part in parts if part != "z"]:
        named = {"omega": "rad/s", "w": "rad/s"}.get(words[0], "")
        return Heading("f", "", unit or named, words[0] in ("harmonic", "order", "h"))
    known = [part for part in parts if part != "z"] or parts
    if "std" in known:
        return Heading("std", sequence, unit)
    return Heading(known[-1] if known else "other", sequence, "db" if "db" in words or unit.startswith("db") else unit)


def _split_unit(text: str) -> tuple[str, str]:
    """The name, and the unit that stands in brackets at its end or behind "in"; what is no unit stays in the name."""
    found = re.search(r"[\[(]\s*([^\[\]()]+?)\s*[\])]\s*$|\bin\s+(\S+)\s*$", text)
    unit = "" if found is None else (found[1] or found[2]).strip().lower()
    square = found is not None and "[" in found[0]
    is_unit = square or unit in _UNITS or unit in _RELATIVE or "ohm" in unit or "ω" in unit
    return (text[: found.start()], unit) if found is not None and is_unit else (text, "")


def _words(name: str) -> list[str]:
    """Words of a name in lower case; signs of a sequence, bars and angle signs are words, too."""
    for sign, word in (("/_", " phase "), ("∠", " phase "), ("|", " abs ")):
        name = name.replace(sign, word)
    name = re.sub(r"(?<=[A-Za-z])\+", " pos ", name)
    name = re.sub(r"(?<=[RXZrxz])-(?=\W|$)", " neg ", name)
    name = re.sub(r"\b([RXZrxz])(pos|neg|zero)", r"\1 \2", name)
    name = re.sub(r"(?<=[A-Za-z])(?=\d)|(?<=\d)(?=[A-Za-z])", " ", name)
    return [word for word in re.split(r"[\W_]+", name.lower()) if word]


def frequency_of(heading: Heading, values: np.ndarray, f1_hz: float) -> np.ndarray:
    """Frequencies in Hz; a harmonic order is a multiple of f1."""
    return values * (f1_hz if heading.is_order else _factor(heading.unit))


def impedance_of(headings: Sequence[Heading], columns: Sequence[np.ndarray], place: str) -> tuple[np.ndarray, str]:
    """z (n,) in ohm of the positive sequence, or of the negative where only that is there, and a note.

    Raises
    ------
    GridError
        If no sequence is complete, only the zero sequence is there, or positive and negative differ.
    """
    found = {sequence: _joined(headings, columns, sequence, place) for sequence in ("", "positive", "negative", "zero")}
    one = found["positive"] if found["positive"] is not None else found["negative"]
    if found[""] is not None:
        one = found[""]
    if one is None:
        given = ", ".join(sorted({f"{h.what}{' ' + h.sequence if h.sequence else ''}" for h in headings}))
        only_zero = found["zero"] is not None
        why = (
            "only the zero sequence is there; it does not act on a three-wire device" if only_zero else f"found {given}"
        )
        raise GridError(
            f"{place}: no positive-sequence impedance ({why}); needed are columns such as R and X, |Z| and angle, or "
            "one of complex numbers"
        )
    notes = [f"the {name} sequence was left out" for name in ("zero",) if found[name] is not None]
    if not any(h.unit for h in headings if h.what in ("re", "im", "mag", "z")):
        notes.append("the unit of Z is not named and was taken for ohm")
    if found["positive"] is not None and found["negative"] is not None:
        _check_alike(found["positive"], found["negative"], place)
        notes.append("positive and negative sequence agree, as those of a passive symmetric grid do")
    elif found[""] is None and found["positive"] is None:
        notes.append("read from the negative sequence, which a passive symmetric grid has in common with the positive")
    return one, "; ".join(notes)


def _check_alike(positive: np.ndarray, negative: np.ndarray, place: str) -> None:
    apart = np.abs(positive - negative) / np.maximum(np.abs(positive), 1e-300)
    if np.median(apart) > SAME_SEQUENCES:
        raise GridError(
            f"{place}: positive and negative sequence differ by {np.median(apart):.1%} (median): that is no passive "
            "symmetric grid; scan it as a 2x2 matrix and import it with seqsweep import"
        )


def _joined(headings: Sequence[Heading], columns: Sequence[np.ndarray], sequence: str, place: str) -> np.ndarray | None:
    """z of one sequence from whichever columns there are; None if they do not make one."""
    parts: dict[str, tuple[Heading, np.ndarray]] = {}
    for heading, column in zip(headings, columns, strict=True):
        if heading.sequence == sequence and heading.what in ("re", "im", "mag", "phase", "z"):
            if heading.what in parts:
                raise GridError(f"{place}: two columns of {sequence or 'the'} {heading.what}; keep one")
            parts[heading.what] = heading, column
    if {"re", "im"} <= set(parts):
        return _scaled(parts["re"]).real + 1j * _scaled(parts["im"]).real
    magnitude = parts.get("mag", parts.get("z"))
    if "phase" in parts and magnitude is not None:
        heading, column = parts["phase"]
        if not heading.unit and np.nanmax(np.abs(column.real)) <= 1.01 * np.pi:
            raise GridError(
                f"{place}: angles from {np.nanmin(column.real):.3g} to {np.nanmax(column.real):.3g}: name "
                "their unit, [deg] or [rad]"
            )
        return _magnitude(magnitude) * np.exp(1j * np.radians(column.real * _factor(heading.unit)))
    if "z" in parts and np.iscomplexobj(parts["z"][1]) and np.any(parts["z"][1].imag != 0.0):
        return _scaled(parts["z"])
    return None


def _magnitude(part: tuple[Heading, np.ndarray]) -> np.ndarray:
    heading, column = part
    return np.asarray(10.0 ** (column.real / 20.0)) if heading.unit == "db" else _scaled(part).real


def _scaled(part: tuple[Heading, np.ndarray]) -> np.ndarray:
    heading, column = part
    return np.asarray(column, dtype=complex) * _factor(heading.unit)


def _factor(unit: str) -> float:
    if unit in _RELATIVE:
        raise GridError(f"a column in {unit!r}: the base is not in the table; give ohm")
    if unit not in _UNITS:
        raise GridError(f"unit {unit!r} is not known; known are ohm, mohm, kohm, Hz, kHz, rad/s, deg, rad, dB")
    return _UNITS[unit]
