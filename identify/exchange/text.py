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
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...plant.foreign.cells import kind_of, split
from ...plant.foreign.clean_text import FORTRAN
from ...plant.foreign.layout import NAMES, Layout, LayoutError, is_comment, layout_of
from ..files import atomic_file
from ..response import FrequencyResponse
from ..table.format import ELEMENTS, QUALITY, canonical_json, std_of
from .convert import Outgoing
from .facts import (
    SET_POINT,
    TABLE_FACTS,
    ExchangeError,
    Facts,
    Found,
    Sheet,
    agreed,
    check_file,
    facts_of,
    frequency_factor,
    need_all,
    points_of,
    texts,
    unit_factor,
)
from .headers import (
    DQ_ELEMENTS,
    POSITION,
    Column,
    column_of,
    in_table_units,
    one_terminal,
    said_by_columns,
    variables_header,
)

Places = dict[tuple[int, int], dict[str, list[int]]]
"""Row and column of an element to the numbers of the columns that hold its parts; some may be there several times."""

FORMS = ({"complex"}, {"re", "im"}, {"mag", "phase"})
"""Parts that make an element, the best first."""

REDUNDANT = 1e-3
"""Part of an element by which columns that say the same may differ: they are printed with few digits."""

# Writing


def write_csv(path: str | Path, out: Outgoing) -> None:
    """Write all responses of ``out``; replaces ``path`` as a whole."""
    points = [out.point(str(response.meta["op_id"])) for response in out.responses]
    comments = {"written_by": "seqsweep", **out.facts, "operating_points": points, "table_sha256": out.meta["sha256"]}
    text = io.StringIO()
    for key, value in comments.items():
        text.write(f"# {key}: {canonical_json(value)}\n")
    writer = csv.writer(text, lineterminator="\n", quoting=csv.QUOTE_NONNUMERIC)
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
    reasons = [" ".join(str(reason).split()) for reason in np.asarray(response.reason)]  # one row, one line
    columns |= {"status": response.status, "reason": reasons, **response.quality}
    return {name: np.asarray(values).tolist() for name, values in columns.items()}


# Reading


def read_csv(path: str | Path, given: Facts) -> Found:
    """Read text of ours or of others.

    Parameters
    ----------
    path : path
        Separated by commas, semicolons, tabs or blanks; see `layout_of`.
    given : mapping
        Facts that the user knows.

    Raises
    ------
    ExchangeError
        If it is no such text, a column is missing, a cell is no number, or a fact is.
    """
    return found_in(path, _opened(check_file(path)), given)


def found_in(path: str | Path, opened: Opened, given: Facts) -> Found:
    """What a table of text holds, once it is opened."""
    comments, header, rows = opened
    columns = [column_of(name) for name in header]
    columns, terminal = one_terminal(path, columns, given.get("terminal"))
    said = agreed(said_by_columns(path, columns), facts_of(comments), path)
    facts = agreed(said, given, path)
    at_f = _frequency_column(path, columns)
    kept = _of_terminal(path, columns, rows, given.get("terminal")) if terminal is None else rows
    places = _places(path, header, columns)
    cells = _cells(path, header, columns, kept)
    need_all(facts, (*TABLE_FACTS, *_left_open(columns)), path)
    frequency = _frequency(path, columns[at_f], cells[at_f], facts)
    matrix = _matrix(path, header, columns, cells, places, facts)
    return Found(_sheets(columns, cells, frequency, matrix, said), facts)


class Opened(NamedTuple):
    """A table of text: comments above the header, the header, and the rows below, read when they are asked for."""

    comments: Sequence[str]
    header: Sequence[str]
    rows: Iterable[Sequence[str]]


def _opened(path: Path) -> Opened:
    try:
        layout = layout_of(path)
    except LayoutError as error:
        raise ExchangeError(str(error)) from None
    return opened(path, layout, _lines(path, layout.mending.encoding))


def opened(path: str | Path, layout: Layout, lines: Iterable[str]) -> Opened:
    """A table of a known layout out of its lines."""
    above = list(islice(lines, layout.skip_rows))
    rows = _split(path, (line for line in lines if line.strip() and not is_comment(line)), layout)
    return Opened(layout.comments, _header(path, layout, above), rows)


def _header(path: str | Path, layout: Layout, above: Sequence[str]) -> list[str]:
    """Names of the columns with their units in brackets."""
    if layout.names is None:
        named = [split(line, layout.delimiter) for line in above if line.strip() and not is_comment(line)]
        if named and len(named[-1]) == 3 and len(layout.kinds) == 5:
            return variables_header(path, named[-1])
        raise ExchangeError(f"{path}: no header: {'; '.join(layout.notes) or 'the file begins with numbers'}")
    units = layout.units or ("",) * len(layout.names)
    return [
        f"{name} [{unit.strip('()[] ')}]" if unit.strip("()[] -") else name
        for name, unit in zip(layout.names, units, strict=True)
    ]


def _lines(path: Path, encoding: str) -> Iterator[str]:
    """Lines of a file; bytes that are no text are replaced."""
    with open(path, encoding=encoding.replace("utf-8-sig", "utf-8"), errors="replace", newline=None) as file:
        for number, line in enumerate(file):
            yield line.lstrip("\ufeff") if number == 0 else line


def _split(path: str | Path, lines: Iterable[str], layout: Layout) -> Iterator[list[str]]:
    """Cells of lines; numbers as Python writes them."""
    for row in _raw_rows(path, lines, layout.delimiter):
        while len(row) > len(layout.kinds) and not row[-1].strip():
            row.pop()
        yield [_plain(cell, layout) for cell in row] if layout.decimal == "," or layout.mending.exponents else row


def _raw_rows(path: str | Path, lines: Iterable[str], delimiter: str) -> Iterator[list[str]]:
    if delimiter == " ":
        yield from (split(line, delimiter) for line in lines)
        return
    try:
        yield from csv.reader(lines, delimiter=delimiter, strict=True)
    except csv.Error as error:
        raise ExchangeError(f"{path}: not {NAMES[delimiter]}-separated: {error}") from None


def _plain(cell: str, layout: Layout) -> str:
    """A number with a point and an E; anything else as it is."""
    if kind_of(cell) != "number":
        return cell
    if layout.mending.thousands:
        cell = cell.replace(layout.mending.thousands, "")
    cell = cell.replace(",", ".") if layout.decimal == "," else cell
    return FORTRAN.sub(b"E", cell.encode()).decode() if layout.mending.exponents else cell


def _cells(
    path: str | Path, header: Sequence[str], columns: Sequence[Column], rows: Iterable[Sequence[str]]
) -> list[np.ndarray]:
    """One array per column, of the kind it holds; empty for columns that say nothing of ours."""
    kinds = [_kind(column) for column in columns]
    cells: list[list[Any]] = [[] for _ in columns]
    for number, row in enumerate(rows, start=1):
        if len(row) != len(header):
            raise ExchangeError(f"{path}: row {number} has {len(row)} cells, the header {len(header)}")
        for kind, values, cell, name in zip(kinds, cells, row, header, strict=True):
            if kind is not None:
                values.append(cell if kind is str else _number(path, number, name, cell, kind))
    return [
        texts(values, path) if kind is str else np.array(values, dtype=kind)
        for kind, values in zip(kinds, cells, strict=True)
    ]


def _kind(column: Column) -> type | None:
    if column.what in ("op_id", "status", "reason"):
        return str
    if column.what == "f" or column.part == "complex":
        return complex
    return None if column.what in ("other", "terminal") else float


def _number(path: str | Path, number: int, name: str, cell: str, kind: type) -> Any:
    try:
        return kind(cell.strip().replace("+-", "-").replace("i", "j") if kind is complex else cell)
    except ValueError:
        raise ExchangeError(f"{path}: row {number}, column {name!r}: {cell[:40]!r} is not a number") from None


def _left_open(columns: Iterable[Column]) -> set[str]:
    """Units that the columns do not name."""
    facts = {("f", ""): "frequency_unit", ("value", "phase"): "phase_unit"}
    bare = [column for column in columns if column.what in ("f", "value") and column.unit is None]
    return {facts.get((column.what, column.part), "unit") for column in bare}


def _frequency_column(path: str | Path, columns: Sequence[Column]) -> int:
    found = [k for k, column in enumerate(columns) if column.what == "f"]
    if len(found) != 1:
        what = "no column" if not found else f"{len(found)} columns"
        raise ExchangeError(f"{path}: {what} of frequencies; needed: one, named f or frequency, its unit in brackets")
    return found[0]


def _frequency(path: str | Path, column: Column, values: np.ndarray, facts: Facts) -> np.ndarray:
    if np.any(values.imag != 0.0):
        raise ExchangeError(f"{path}: a frequency has an imaginary part")
    return np.asarray(values.real * frequency_factor(column.unit or facts["frequency_unit"], path))


def _of_terminal(
    path: str | Path, columns: Sequence[Column], rows: Iterable[Sequence[str]], wanted: str | None
) -> Iterable[Sequence[str]]:
    """Rows of the terminal that is wanted, where a column names the terminal of each."""
    at = next((k for k, column in enumerate(columns) if column.what == "terminal"), None)
    if at is None:
        if wanted is not None:
            raise ExchangeError(f"{path} names no terminals: leave --terminal {wanted} out")
        return rows
    listed = list(rows)
    names = dict.fromkeys(row[at].strip() for row in listed if len(row) > at)
    if wanted is None and len(names) > 1:
        raise ExchangeError(f"{path} holds several terminals: --terminal {' or '.join(names)}")
    if wanted is not None and wanted not in names:
        raise ExchangeError(f"{path} has no terminal {wanted!r}; it has {', '.join(names)}")
    return [row for row in listed if wanted is None or row[at].strip() == wanted]


def _places(path: str | Path, header: Sequence[str], columns: Sequence[Column]) -> Places:
    """Which columns hold which part of which element; all four must be there."""
    places: Places = {(row, column): {} for row in (0, 1) for column in (0, 1)}
    for number, column in enumerate(columns):
        if column.what == "value":
            places[POSITION[column.element]].setdefault(column.part, []).append(number)
    for at, parts in places.items():
        for part, numbers in parts.items():
            twice = [k for k in numbers if columns[k].unit == columns[numbers[0]].unit]
            if len(twice) > 1 and part not in ("mag", "phase"):
                raise ExchangeError(f"{path}: {header[twice[0]]!r} and {header[twice[1]]!r} are the same part twice")
        if not any(set(parts) >= form for form in FORMS):
            names = " or ".join(name for name, place in POSITION.items() if place == at)
            given = ", ".join(sorted(parts)) or "nothing"
            raise ExchangeError(
                f"{path}: element {names}: {given} found; needed: re and im, magnitude and phase, or one complex "
                f"column. The header is: {', '.join(header)[:200]}"
            )
    return places


def _matrix(
    path: str | Path,
    header: Sequence[str],
    columns: Sequence[Column],
    cells: Sequence[np.ndarray],
    places: Places,
    facts: Facts,
) -> np.ndarray:
    """Y or Z (n, 2, 2) in S or ohm."""
    elements = []
    for parts in places.values():
        value = _joined({part: _in_si(path, columns[k[0]], cells[k[0]], facts) for part, k in parts.items()})
        for part, numbers in parts.items():
            for k in numbers:
                _check_redundant(path, header[k], part, _in_si(path, columns[k], cells[k], facts), value)
        elements.append(value)
    return np.stack(elements, axis=-1).reshape(-1, 2, 2)


def _check_redundant(path: str | Path, name: str, part: str, said: np.ndarray, value: np.ndarray) -> None:
    """Refuse a column that says something else than those that were used."""
    if part == "phase":
        wrong = np.abs(np.exp(1j * said) - np.exp(1j * np.angle(value))) * np.abs(value)
    else:
        parts = {"re": value.real, "im": value.imag, "mag": np.abs(value), "complex": value}
        wrong = np.abs(said - parts[part])
    size = np.abs(value)
    bad = wrong > REDUNDANT * size + 1e-9 * np.nanmax(size, initial=0.0)
    if np.any(bad):
        row = int(np.argmax(bad))
        raise ExchangeError(
            f"{path}: column {name!r} contradicts the others in row {row + 1}, by {wrong[row] / size[row]:.2g} of the "
            "element: which of them is right? Remove the wrong ones"
        )


def _in_si(path: str | Path, column: Column, values: np.ndarray, facts: Facts) -> np.ndarray:
    """S, ohm or rad; decibels are those of a magnitude in S or ohm."""
    if column.part == "phase":
        unit = column.unit or facts["phase_unit"]
        if unit not in ("deg", "rad"):
            raise ExchangeError(f"{path}: a phase in {unit!r}; known are deg and rad")
        return np.deg2rad(values) if unit == "deg" else values
    if column.unit == "dB":
        return np.asarray(10.0 ** (values / 20.0))
    return np.asarray(values * unit_factor(column.unit or facts["unit"], facts, path))


def _joined(parts: Mapping[str, np.ndarray]) -> np.ndarray:
    """One element from re and im, magnitude and phase, or as it is."""
    if "complex" in parts:
        return parts["complex"]
    if {"re", "im"} <= set(parts):
        value = np.empty(len(parts["re"]), dtype=complex)  # not re + 1j im: NaN and signed zeros stay where they are
        value.real, value.imag = parts["re"], parts["im"]
        return value
    return np.asarray(parts["mag"] * np.exp(1j * parts["phase"]))


def _sheets(
    columns: Sequence[Column], cells: Sequence[np.ndarray], f_hz: np.ndarray, matrix: np.ndarray, said: Facts
) -> tuple[Sheet, ...]:
    """One sheet per operating point, in the order of the file."""
    named = {column.what: values for column, values in zip(columns, cells, strict=True)}
    set_points = _set_points(columns, cells)
    quality = {key: named[key] for key in QUALITY if key in named}
    points = {str(point.get("op_id")): point for point in points_of(said)}
    sheets = []
    for name, rows in _rows_of_points(named.get("op_id"), set_points, len(f_hz)):
        own = {key: float(values[rows][0]) for key, values in set_points.items() if len(set(values[rows])) == 1}
        sheets.append(
            Sheet(
                f_hz[rows],
                matrix[rows],
                {**own, **points.get(name, {}), "op_id": name or None},
                named["status"][rows] if "status" in named else None,
                named["reason"][rows] if "reason" in named else None,
                {key: values[rows] for key, values in quality.items()},
            )
        )
    return tuple(sheets)


def _set_points(columns: Sequence[Column], cells: Sequence[np.ndarray]) -> dict[str, np.ndarray]:
    """Columns (n,) of powers and voltages that stand beside the rows, in MW, Mvar and pu."""
    return {
        column.what: in_table_units(column, values)
        for column, values in zip(columns, cells, strict=True)
        if column.what in SET_POINT and np.all(np.isfinite(values))
    }


def _rows_of_points(
    op_id: np.ndarray | None, set_points: Mapping[str, np.ndarray], n: int
) -> Iterator[tuple[str, np.ndarray]]:
    """Name and rows (n,) bool of every operating point: by its name, else by its powers and voltage.

    Values that differ in every row were measured beside it: then all rows are of one operating point.
    """
    if op_id is not None:
        yield from ((name, op_id == name) for name in dict.fromkeys(op_id.tolist()))
        return
    each = list(zip(*(values.tolist() for values in set_points.values()), strict=True)) or [()] * n
    distinct = dict.fromkeys(each)
    if len(distinct) == n:
        yield "", np.ones(n, dtype=bool)
        return
    for point in distinct:
        yield "", np.array([own == point for own in each])
