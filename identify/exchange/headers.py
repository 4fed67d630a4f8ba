"""What a header of someone else's text says its column is."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..table.format import ELEMENTS, QUALITY
from .facts import SET_POINT, ExchangeError

DQ_ELEMENTS = ("dd", "dq", "qd", "qq")
POSITION = {
    **{name: divmod(k, 2) for k, name in enumerate(ELEMENTS)},
    **{name: divmod(k, 2) for k, name in enumerate(DQ_ELEMENTS)},
    **{name: divmod(k, 2) for k, name in enumerate(("11", "12", "21", "22"))},
}
"""Row and column of an element by its name."""

_PARTS = {
    **dict.fromkeys(("re", "real"), "re"),
    **dict.fromkeys(("im", "imag", "imaginary"), "im"),
    **dict.fromkeys(("mag", "abs", "magnitude", "amplitude", "db"), "mag"),
    **dict.fromkeys(("phase", "pha", "ph", "arg", "angle", "ang", "deg", "rad", "degrees"), "phase"),
}
_UNITS = {
    **{name: name for name in ("Hz", "kHz", "rad/s", "S", "mS", "uS", "kS", "1/ohm", "pu", "dB", "deg", "rad")},
    **{"hz": "Hz", "HZ": "Hz", "khz": "kHz", "µS": "uS", "μS": "uS", "1/Ω": "1/ohm", "p.u.": "pu", "db": "dB"},
    **{f"{prefix}{ohm}": f"{prefix}ohm" for prefix in ("", "m", "k") for ohm in ("ohm", "Ohm", "Ω", "\N{OHM SIGN}")},
    **{"°": "deg", "degrees": "deg", "radians": "rad"},
}
"""Units as they are written; capitals count, 1 MS is not 1 mS."""

_GLUED = re.compile(
    rf"(?P<part>{'|'.join(sorted(_PARTS, key=len, reverse=True))})?(?P<quantity>[yz])(?P<element>{'|'.join(POSITION)})"
    rf"(?P<after>{'|'.join(sorted(_PARTS, key=len, reverse=True))})?",
    re.IGNORECASE,
)
"""Words in one: MagYdd, ReZ12, Yppre."""

_TERMINALS = ("terminal", "bus", "node", "busbar")

_MEGA = {"MW": 1.0, "kW": 1e-3, "W": 1e-6}
_MEGAVAR = {
    **dict.fromkeys(("Mvar", "MVar", "MVAr", "MVAR"), 1.0),
    **dict.fromkeys(("kvar", "kVar", "kVAr", "kVAR"), 1e-3),
    **dict.fromkeys(("var", "Var", "VAr", "VAR"), 1e-6),
}
SET_POINT_UNITS = {"p": ("active_power_mw", _MEGA), "q": ("reactive_power_mvar", _MEGAVAR)}
SET_POINT_UNITS |= dict.fromkeys(("v", "u"), ("terminal_voltage_pu", {"pu": 1.0}))
"""Letters of the operating point in a header: what they mean, and the units that tell them from other columns."""

_FREQUENCY = {"f": None, "freq": None, "frequency": None, "omega": "rad/s", "w": "rad/s", "hz": "Hz"}


class Column(NamedTuple):
    """What a header says.

    Attributes
    ----------
    what : str
        "f", "value", "terminal", "other", one of `SET_POINT`, or the name of a further column of the table.
    element, part : str
        Of a value: "pp", "dq", "21"; "re", "im", "mag", "phase" or "complex".
    unit, quantity : str or None
        None where the header does not say.
    frame : str
        That a word beside numbers of rows and columns says: "dq" of ``Z_dq_11``.
    terminal : str
        The words that are left over.
    """

    what: str
    element: str = ""
    part: str = ""
    unit: str | None = None
    quantity: str | None = None
    frame: str = ""
    terminal: str = ""


def variables_header(path: str | Path, header: Sequence[str]) -> list[str]:
    """``f, NAME_d, NAME_q`` as the five columns that follow."""
    first, second = (name.strip().rpartition("_")[2].lower() for name in header[1:])
    if first + second not in ("dq", "pn"):
        raise ExchangeError(
            f"{path}: rows of five cells under {', '.join(header)}; needed: f and two variables, ending in _d and _q"
        )
    return [header[0], *(row + column for row in (first, second) for column in (first, second))]


def column_of(header: str) -> Column:
    """Recognise a header such as ``f [Hz]``, ``y_pp_re [S]``, ``|Ydq| (dB)``, ``phase(Z21) [deg]`` or ``imag_nn``.

    What stands in brackets at the end is the unit, known or not; in parentheses, only if it is known.
    """
    text, unit = header.strip(), None
    if found := re.search(r"\[\s*([^\[\]]+?)\s*\]$|\(\s*([^()]+?)\s*\)$", text):
        unit = _UNITS.get(found[1] or found[2], found[1])
        text = text if unit is None else text[: found.start()].rstrip()
    if text in (*QUALITY, *SET_POINT, "op_id", "status", "reason"):
        return Column(text)
    text = re.sub(r"\s+in\s+\(?([^\s()]+)\)?$", _named_unit, text) if unit is None else text
    tokens = [token for token in re.split(r"[\W_]+", text.replace("|", " abs ").replace("∠", " phase ")) if token]
    first = tokens[0].lower() if tokens else ""
    if first in _FREQUENCY and "mirror" not in tokens:
        named = next((_UNITS[token] for token in tokens if token.lower() in ("hz", "khz") and token in _UNITS), None)
        return Column("f", unit=unit or named or _FREQUENCY[first])
    return _set_point_column(tokens, unit) or _value_column(tokens, unit)


def _set_point_column(tokens: Sequence[str], unit: str | None) -> Column | None:
    """``P [MW]``, ``Q_Mvar`` or ``|V| (pu)``: a letter and a unit of its own; None for anything else."""
    words = [token for token in tokens if token != "abs"] + ([] if unit is None else [unit])
    if len(words) != 2 or words[0].lower() not in SET_POINT_UNITS:
        return None
    what, factors = SET_POINT_UNITS[words[0].lower()]
    return Column(what, unit=words[1]) if words[1] in factors else None


def in_table_units(column: Column, values: np.ndarray) -> np.ndarray:
    """Set-points in MW, Mvar and pu."""
    factors = next(factors for what, factors in SET_POINT_UNITS.values() if what == column.what)
    return np.asarray(values * (1.0 if column.unit is None else factors[column.unit]))


def _named_unit(found: re.Match[str]) -> str:
    """A unit after "in", as a word of its own."""
    return f" {_UNITS.get(found[1], found[1])}"


def _value_column(tokens: Sequence[str], unit: str | None) -> Column:
    words = [word for token in tokens for word in _unglued(token)]
    if {"std", "mirror"} & {word.lower() for word in words}:
        return Column("other")
    positions = [word.lower() for word in words if word.lower() in POSITION]
    frame = positions.pop(0) if len(positions) > 1 and positions[0] in ("pn", "dq") else ""
    quantity = element = part = None
    left = []
    for token in words:
        word = token.lower()
        if word in ("y", "z"):
            quantity = {"y": "admittance", "z": "impedance"}[word]
        elif word == frame and element is None and word != positions[0]:
            continue
        elif word in positions and element is None:
            element = word
        elif word in _PARTS:
            part = part or _PARTS[word]
            unit = unit or {"db": "dB", "deg": "deg", "degrees": "deg", "rad": "rad"}.get(word)
        elif unit is None and token in _UNITS:
            unit = _UNITS[token]
        elif word not in ("in", "of"):
            quantity = quantity or {"Y": "admittance", "Z": "impedance"}.get(token[0])
            left.append(token)
    if element is None:
        return Column("terminal") if words and words[0].lower() in _TERMINALS else Column("other")
    return Column("value", element, part or "complex", unit, quantity, frame, "_".join(left))


def _unglued(token: str) -> list[str]:
    """A word as the several that it is made of."""
    found = _GLUED.fullmatch(token)
    return [part for part in found.group("part", "quantity", "element", "after") if part] if found else [token]


def one_terminal(path: str | Path, columns: Sequence[Column], wanted: str | None) -> tuple[list[Column], str | None]:
    """Columns of the one terminal that is meant, and its name; None where the columns do not tell terminals apart.

    Raises
    ------
    ExchangeError
        If there are several and the user does not say which, or there is none of that name.
    """
    values = [column for column in columns if column.what == "value"]
    places = [(column.element, column.part, column.unit) for column in values]
    names = list(dict.fromkeys(column.terminal for column in values))
    if len(names) < 2 or len(set(places)) == len(places):
        return list(columns), wanted if wanted and names == [wanted] else None
    if wanted is None:
        raise ExchangeError(
            f"{path} holds several terminals: --terminal {' or '.join(name or '(none)' for name in names)}"
        )
    if wanted not in names:
        raise ExchangeError(f"{path} has no terminal {wanted!r}; it has {', '.join(names)}")
    kept = [Column("other") if column.what == "value" and column.terminal != wanted else column for column in columns]
    return kept, wanted


def said_by_columns(path: str | Path, columns: Sequence[Column]) -> dict[str, Any]:
    """Frame and quantity as far as the names of the columns say them."""
    values = [column for column in columns if column.what == "value"]
    frames = {"pn" if c.element in ELEMENTS else "dq" for c in values if c.element in (*ELEMENTS, *DQ_ELEMENTS)}
    frames |= {column.frame for column in values if column.frame}
    quantities = {column.quantity for column in values if column.quantity}
    for kinds in (frames, quantities):
        if len(kinds) > 1:
            raise ExchangeError(f"{path}: columns of {' and '.join(sorted(kinds))} in one file; keep one kind")
    said: dict[str, Any] = {"frame": frames.pop()} if frames else {}
    return {**said, "quantity": quantities.pop()} if quantities else said
