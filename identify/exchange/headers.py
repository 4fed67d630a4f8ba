"""What a header of someone else's text says its column is."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from ..table.format import ELEMENTS, QUALITY
from .facts import ExchangeError

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
    **dict.fromkeys(("phase", "ph", "arg", "angle", "ang", "deg", "rad"), "phase"),
}
_UNITS = {
    **{name: name for name in ("Hz", "kHz", "rad/s", "S", "mS", "uS", "kS", "1/ohm", "pu", "dB", "deg", "rad")},
    **{"hz": "Hz", "HZ": "Hz", "khz": "kHz", "µS": "uS", "μS": "uS", "1/Ω": "1/ohm", "p.u.": "pu", "db": "dB"},
    **{f"{prefix}{ohm}": f"{prefix}ohm" for prefix in ("", "m", "k") for ohm in ("ohm", "Ohm", "Ω", "\N{OHM SIGN}")},
    **{"°": "deg", "degrees": "deg", "radians": "rad"},
}
"""Units as they are written; capitals count, 1 MS is not 1 mS."""

_FREQUENCY = {"f": None, "freq": None, "frequency": None, "omega": "rad/s", "w": "rad/s", "hz": "Hz"}


class Column(NamedTuple):
    """What a header says: ``what`` is "f", "value" or the name of a further column of the table."""

    what: str
    element: str = ""
    part: str = ""
    unit: str | None = None
    quantity: str | None = None


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
    if text in (*QUALITY, "op_id", "status", "reason"):
        return Column(text)
    tokens = [token for token in re.split(r"[\W_]+", text.replace("|", " abs ").replace("∠", " phase ")) if token]
    first = tokens[0].lower() if tokens else ""
    if first in _FREQUENCY and "mirror" not in tokens:
        named = next((_UNITS[token] for token in tokens if token.lower() in ("hz", "khz") and token in _UNITS), None)
        return Column("f", unit=unit or named or _FREQUENCY[first])
    return _value_column(tokens, unit)


def _value_column(tokens: Sequence[str], unit: str | None) -> Column:
    quantity = element = part = None
    for token in tokens:
        word = token.lower()
        bare = word[1:] if word[:1] in ("y", "z") and word[1:] in POSITION else word
        if word in ("y", "z") or bare != word:
            quantity = {"y": "admittance", "z": "impedance"}[word[0]]
        if bare in POSITION:
            element = bare
        elif word in _PARTS:
            part = part or _PARTS[word]
            unit = unit or {"db": "dB", "deg": "deg", "rad": "rad"}.get(word)
        elif word in ("std", "mirror"):
            return Column("other")
        elif unit is None:
            unit = _UNITS.get(token)
    if element is None:
        return Column("other")
    return Column("value", element, part or "complex", unit, quantity)


def said_by_columns(path: str | Path, columns: Sequence[Column]) -> dict[str, Any]:
    """Frame and quantity as far as the names of the columns say them."""
    values = [column for column in columns if column.what == "value"]
    frames = {"pn" if c.element in ELEMENTS else "dq" for c in values if c.element in (*ELEMENTS, *DQ_ELEMENTS)}
    quantities = {column.quantity for column in values if column.quantity}
    for kinds in (frames, quantities):
        if len(kinds) > 1:
            raise ExchangeError(f"{path}: columns of {' and '.join(sorted(kinds))} in one file; keep one kind")
    said: dict[str, Any] = {"frame": frames.pop()} if frames else {}
    return {**said, "quantity": quantities.pop()} if quantities else said
