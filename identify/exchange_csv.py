"""Comma-separated text: our own, that of spreadsheets and scripts, and tab-separated complex numbers.

What we write begins with ``# key: value`` lines, the facts, the value as JSON; then one header line of
names with their units in brackets; then one line per operating point and frequency, numbers with as
many digits as tell them apart. A spreadsheet opens it; ``pandas.read_csv(path, comment="#")`` reads it.

What others write is recognised by its header: see `column_of`. A header of ``f, NAME_d, NAME_q`` over
lines of ``(a+bj)`` names the two variables of a matrix that follows row after row.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .exchange import (
    ExchangeError,
    Facts,
    Found,
    Outgoing,
    Sheet,
    agreed,
    check_file,
    facts_of,
    frequency_factor,
    need,
    points_of,
    unit_factor,
)
from .response import FrequencyResponse
from .table import ELEMENTS, QUALITY, atomic_file, canonical_json, std_of

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
    "hz": "Hz", "khz": "kHz", "rad/s": "rad/s", "s": "S", "ms": "mS", "us": "uS", "µs": "uS", "μs": "uS", "ks": "kS",
    "1/ohm": "1/ohm", "ohm": "ohm", "ω": "ohm", "mohm": "mohm", "mω": "mohm", "kohm": "kohm", "kω": "kohm", "pu": "pu",
    "p.u.": "pu", "db": "dB", "deg": "deg", "°": "deg", "degrees": "deg", "rad": "rad", "dbs": "dB",
}  # fmt: skip
_FREQUENCY = {"f": None, "freq": None, "frequency": None, "omega": "rad/s", "w": "rad/s", "hz": "Hz"}


# Writing


def write_csv(path: str | Path, out: Outgoing) -> None:
    """Write all responses of ``out``; replaces ``path`` as a whole."""
    points = [out.point(str(response.meta["op_id"])) for response in out.responses]
    comments = {"written_by": "seqsweep", **out.facts, "operating_points": points, "table_sha256": out.meta["sha256"]}
    text = io.StringIO()
    for key, value in comments.items():
        text.write(f"# {key}: {canonical_json(value)}\n")
    writer = csv.writer(text, lineterminator="\n")
    for number, response in enumerate(out.responses):
        columns = _columns(response)
        if number == 0:
            writer.writerow(columns)
        writer.writerows(zip(*columns.values(), strict=True))
    with atomic_file(path) as file:
        file.write(text.getvalue().encode())


def _columns(response: FrequencyResponse) -> dict[str, list[Any]]:
    """Columns under their headers; floats as Python prints them, the shortest text that reads back the same."""
    names = ELEMENTS if response.frame == "pn" else DQ_ELEMENTS
    elements = response.y.reshape(-1, 4)
    columns: dict[str, Any] = {"op_id": [response.meta["op_id"]] * len(response), "f [Hz]": response.f_hz}
    if response.frame == "pn":
        columns["f_mirror [Hz]"] = response.f_mirror_hz
    for k, name in enumerate(names):
        columns[f"y_{name}_re [S]"] = elements[:, k].real
        columns[f"y_{name}_im [S]"] = elements[:, k].imag
    if response.frame == "pn":
        std = std_of(np.asarray(response.covariance))
        columns.update({f"y_{name}_std [S]": std[:, k] for k, name in enumerate(names)})
    columns |= {"status": response.status, "reason": response.reason, **response.quality}
    return {name: np.asarray(values).tolist() for name, values in columns.items()}


# Reading


class Column(NamedTuple):
    """What a header says: ``what`` is "f", "value" or the name of a further column of the table."""

    what: str
    element: str = ""
    part: str = ""
    unit: str | None = None
    quantity: str | None = None


def read_csv(path: str | Path, given: Facts) -> Found:
    """Read text of ours or of others.

    Parameters
    ----------
    path : path
        Separated by commas, semicolons, tabs or blanks; the first line that is no comment is the header.
    given : mapping
        Facts that the user knows.

    Raises
    ------
    ExchangeError
        If it is no such text, a column is missing, a cell is no number, or a fact is.
    """
    said, rows = _rows(path)
    header, body = rows[0], rows[1:]
    if not body:
        raise ExchangeError(f"{path}: a header, and no rows")
    if len(header) == 3 and len(body[0]) == 5:
        header = _variables_header(path, header)
    columns = [column_of(name) for name in header]
    said = {**_said_by_columns(path, columns), **said}
    facts = agreed(said, given, path)
    cells = _cells(path, header, body)
    frequency = _frequency(path, columns, cells, facts)
    matrix = _matrix(path, header, columns, cells, facts)
    return Found(_sheets(path, columns, cells, frequency, matrix, said), facts)


def _rows(path: str | Path) -> tuple[dict[str, Any], list[list[str]]]:
    """Facts in comments, and the cells of every other line that is not blank."""
    content = check_file(path).read_bytes()
    if b"\0" in content[:4096]:
        raise ExchangeError(f"{path}: not text: it holds zero bytes; --format says what it is")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = content.decode("latin-1")
    lines = [line for line in text.splitlines() if line.strip()]
    comments = [line[1:].strip() for line in lines if line.startswith("#")]
    lines = [line for line in lines if not line.startswith("#")]
    if not lines:
        raise ExchangeError(f"{path}: no header and no rows")
    delimiter = next((mark for mark in "\t;," if mark in lines[0]), None)
    if delimiter is None:
        return facts_of(comments), [line.split() for line in lines]
    try:
        return facts_of(comments), list(csv.reader(lines, delimiter=delimiter, strict=True))
    except csv.Error as error:
        raise ExchangeError(f"{path}: not {'tab' if delimiter == chr(9) else delimiter}-separated: {error}") from None


def _variables_header(path: str | Path, header: Sequence[str]) -> list[str]:
    """``f, NAME_d, NAME_q`` as the five columns that follow."""
    first, second = (name.strip().rpartition("_")[2].lower() for name in header[1:])
    if first + second not in ("dq", "pn"):
        raise ExchangeError(
            f"{path}: rows of five cells under {', '.join(header)}; needed: f and two variables, ending in _d and _q"
        )
    return [header[0], *(row + column for row in (first, second) for column in (first, second))]


def column_of(header: str) -> Column:
    """Recognise a header such as ``f [Hz]``, ``y_pp_re [S]``, ``|Ydq| (dB)``, ``phase(Z21) [deg]`` or ``imag_nn``."""
    text = header.strip().lower()
    unit = None
    if found := re.search(r"[\[(]\s*([^\[\]()]+?)\s*[\])]\s*$", text):
        unit = _UNITS.get(found[1])
        if unit is not None or text.endswith("]"):
            text = text[: found.start()]
    tokens = [token for token in re.split(r"[\W_]+", text.replace("|", " abs ").replace("∠", " phase ")) if token]
    if text.strip() in (*QUALITY, "op_id", "status", "reason"):
        return Column(text.strip())
    if tokens and tokens[0] in _FREQUENCY and "mirror" not in tokens:
        named = next((_UNITS[token] for token in tokens if token in ("hz", "khz")), None)
        return Column("f", unit=unit or named or _FREQUENCY[tokens[0]])
    return _value_column(tokens, unit)


def _value_column(tokens: Sequence[str], unit: str | None) -> Column:
    quantity = element = part = None
    for token in tokens:
        bare = token[1:] if token[:1] in ("y", "z") and token[1:] in POSITION else token
        if token in ("y", "z") or bare != token:
            quantity = {"y": "admittance", "z": "impedance"}[token[0]]
        if bare in POSITION:
            element = bare
        elif token in _PARTS:
            part = part or _PARTS[token]
            unit = unit or {"db": "dB", "deg": "deg", "rad": "rad"}.get(token)
        elif token in ("std", "mirror"):
            return Column("other")
        elif unit is None:
            unit = _UNITS.get(token)
    if element is None:
        return Column("other")
    return Column("value", element, part or "complex", unit, quantity)


def _said_by_columns(path: str | Path, columns: Sequence[Column]) -> dict[str, Any]:
    """Frame and quantity as far as the names of the columns say them."""
    values = [column for column in columns if column.what == "value"]
    frames = {"pn" if c.element in ELEMENTS else "dq" for c in values if c.element in (*ELEMENTS, *DQ_ELEMENTS)}
    quantities = {column.quantity for column in values if column.quantity}
    for kinds in (frames, quantities):
        if len(kinds) > 1:
            raise ExchangeError(f"{path}: columns of {' and '.join(sorted(kinds))} in one file; keep one kind")
    said: dict[str, Any] = {"frame": frames.pop()} if frames else {}
    return {**said, "quantity": quantities.pop()} if quantities else said


def _cells(path: str | Path, header: Sequence[str], body: Sequence[Sequence[str]]) -> list[list[str]]:
    """Columns of text."""
    for number, row in enumerate(body, start=1):
        if len(row) != len(header):
            raise ExchangeError(f"{path}: row {number} has {len(row)} cells, the header {len(header)}")
    return [list(column) for column in zip(*body, strict=True)]


def _frequency(path: str | Path, columns: Sequence[Column], cells: list[list[str]], facts: Facts) -> np.ndarray:
    found = [k for k, column in enumerate(columns) if column.what == "f"]
    if len(found) != 1:
        what = "no column" if not found else f"{len(found)} columns"
        raise ExchangeError(f"{path}: {what} of frequencies; needed: one, named f or frequency, its unit in brackets")
    unit = columns[found[0]].unit or need(facts, "frequency_unit", path)
    values = _numbers(path, "the frequency", cells[found[0]], complex)
    return np.asarray(values.real * frequency_factor(unit, path))


def _matrix(
    path: str | Path, header: Sequence[str], columns: Sequence[Column], cells: list[list[str]], facts: Facts
) -> np.ndarray:
    parts: dict[tuple[int, int], dict[str, np.ndarray]] = {}
    for name, column, text in zip(header, columns, cells, strict=True):
        if column.what == "value":
            kind = complex if column.part == "complex" else float
            values = _numbers(path, f"column {name!r}", text, kind)
            place = parts.setdefault(POSITION[column.element], {})
            if column.part in place:
                raise ExchangeError(f"{path}: column {name!r} is there twice")
            place[column.part] = _in_si(path, column, values, facts)
    matrix = np.empty((len(cells[0]), 2, 2), dtype=complex)
    for row, column_number in ((0, 0), (0, 1), (1, 0), (1, 1)):
        matrix[:, row, column_number] = _joined(path, header, (row, column_number), parts.get((row, column_number), {}))
    return matrix


def _in_si(path: str | Path, column: Column, values: np.ndarray, facts: Facts) -> np.ndarray:
    """S, ohm or rad; decibels are those of a magnitude in S or ohm."""
    if column.part == "phase":
        unit = column.unit or need(facts, "phase_unit", path)
        return np.deg2rad(values) if unit == "deg" else values
    if column.unit == "dB":
        return np.asarray(10.0 ** (values / 20.0))
    return np.asarray(values * unit_factor(column.unit or need(facts, "unit", path), facts, path))


def _joined(path: str | Path, header: Sequence[str], at: tuple[int, int], parts: Mapping[str, np.ndarray]) -> Any:
    """One element from re and im, magnitude and phase, or as it is."""
    if set(parts) == {"complex"}:
        return parts["complex"]
    if set(parts) == {"re", "im"}:
        value = np.empty(len(parts["re"]), dtype=complex)  # not re + 1j im: NaN and signed zeros stay where they are
        value.real, value.imag = parts["re"], parts["im"]
        return value
    if set(parts) == {"mag", "phase"}:
        return parts["mag"] * np.exp(1j * parts["phase"])
    names = " or ".join(name for name, place in POSITION.items() if place == at)
    given = ", ".join(sorted(parts)) or "nothing"
    raise ExchangeError(
        f"{path}: element {names}: {given} found; needed: re and im, magnitude and phase, or one complex column. "
        f"The header is: {', '.join(header)[:200]}"
    )


def _numbers(path: str | Path, what: str, text: Sequence[str], kind: type) -> np.ndarray:
    values: np.ndarray = np.empty(len(text), dtype=kind)
    for number, cell in enumerate(text):
        try:
            values[number] = kind(cell.strip().replace("+-", "-").replace("i", "j") if kind is complex else cell)
        except ValueError:
            raise ExchangeError(f"{path}: row {number + 1}, {what}: {cell[:40]!r} is not a number") from None
    return values


def _sheets(
    path: str | Path,
    columns: Sequence[Column],
    cells: list[list[str]],
    f_hz: np.ndarray,
    matrix: np.ndarray,
    said: Facts,
) -> tuple[Sheet, ...]:
    """One sheet per operating point, in the order of the file."""
    text = {column.what: np.array(cell) for column, cell in zip(columns, cells, strict=True)}
    op_id = text.get("op_id", np.full(len(f_hz), ""))
    quality = {key: _numbers(path, f"column {key!r}", text[key].tolist(), float) for key in QUALITY if key in text}
    points = {point.get("op_id"): point for point in points_of(said)}
    sheets = []
    for name in dict.fromkeys(op_id.tolist()):
        rows = op_id == name
        sheets.append(
            Sheet(
                f_hz[rows],
                matrix[rows],
                {**points.get(name, {}), "op_id": name or None},
                text["status"][rows] if "status" in text else None,
                text["reason"][rows] if "reason" in text else None,
                {key: values[rows] for key, values in quality.items()},
            )
        )
    return tuple(sheets)
