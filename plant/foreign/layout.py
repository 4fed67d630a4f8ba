"""How a table of text is laid out: what separates its cells, where its numbers begin, what its columns are called.

One answer for recordings and for tables of other tools. It is found from below: the last lines of the first 64 kB are
numbers for certain; what stands above the first line like them is a heading.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from ..errors import SeqsweepError
from .cells import Kind, fortran_exponent, kind_of, kinds_of, split, thousands_sign
from .clean_text import LATIN, Mending, encoding_of

HEAD_BYTES = 1 << 16
COMMENTS = ("#", "%", "//", "!")
DELIMITERS = ("\t", ";", "|", ",", " ")
SAMPLE = 40
"""Lines that decide on separators and kinds of columns."""

NAMES = {"\t": "tab", ";": "semicolon", "|": "bar", ",": "comma", " ": "blank"}

_TIMES = ("s", "ms", "us", "µs", "μs", "ns", "min", "h")
_ELECTRIC = (
    "v",
    "kv",
    "mv",
    "a",
    "ka",
    "ma",
    "pu",
    "p.u.",
    "ohm",
    "ω",
    "siemens",
    "w",
    "kw",
    "mw",
    "var",
    "kvar",
    "va",
)
_UNITS = frozenset((*_TIMES, *_ELECTRIC, "hz", "khz", "deg", "rad", "°", "-", "1"))


class LayoutError(SeqsweepError):
    """A text that is no table of numbers, with what is in the way."""


class Layout(NamedTuple):
    """How a table of text is laid out.

    Attributes
    ----------
    skip_rows : int
        Lines above the first line of numbers.
    delimiter, decimal : str
        What separates cells, and whole numbers from fractions.
    kinds : tuple of Kind
        What each column holds; an empty last one comes from a delimiter at the end of each line.
    names : tuple of str or None
        Headings, one for each column; None where there are none.
    units : tuple of str or None
        Units, where a row of their own has them.
    comments : tuple of str
        Comment lines above the numbers, without their mark.
    mending : Mending
        What the bytes need before they are read.
    notes : tuple of str
        What a person should know.
    """

    skip_rows: int
    delimiter: str
    decimal: str
    kinds: tuple[Kind, ...]
    names: tuple[str, ...] | None
    units: tuple[str, ...] | None
    comments: tuple[str, ...]
    mending: Mending
    notes: tuple[str, ...] = ()


def layout_of(path: Path, fewest: int = 2) -> Layout:
    """The layout of a text file with ``fewest`` columns of numbers or times at least.

    Raises
    ------
    LayoutError
        If it is no text, or no table of numbers.
    """
    with open(path, "rb") as file:
        raw = file.read(HEAD_BYTES + 1)
    encoding = encoding_of(raw)
    if not encoding:
        raise LayoutError(f"{path}: holds zero bytes: not a text file")
    whole = raw if len(raw) <= HEAD_BYTES else raw[: raw.rfind(b"\n") + 1] or raw
    lines = whole.decode(encoding, "replace").lstrip("\ufeff").splitlines()
    if len(raw) > HEAD_BYTES and encoding.startswith("utf-16"):
        lines = lines[:-1]  # it may be cut in the middle
    return layout_of_lines(path, lines, encoding, fewest)


def layout_of_lines(path: Path, lines: Sequence[str], encoding: str = "utf-8", fewest: int = 2) -> Layout:
    """As `layout_of`, of the first lines of a text; ``path`` is for messages."""
    delimiter, rows = _separated(path, lines, fewest)
    kinds = kinds_of(rows)
    first = _first_of_numbers(lines, delimiter, kinds)
    _refuse_two_commas(path, lines[:first], delimiter, rows)
    heads = _headings(lines[:first], delimiter, kinds)
    cells = [cell for row in rows for cell in row]
    thousands = next(filter(None, map(thousands_sign, cells)), "") if "clock" not in kinds else ""
    mending = Mending(encoding, delimiter == " ", any(map(fortran_exponent, cells)), thousands)
    notes = (LATIN,) if encoding == "latin-1" else ()
    return Layout(
        first,
        delimiter,
        _decimal(rows, kinds, thousands),
        kinds,
        heads.names,
        heads.units,
        tuple(_bare(line) for line in lines[:first] if is_comment(line)),
        mending,
        (*notes, *heads.notes),
    )


_NO_POINT = re.compile(r"[+-]?\d+([eEdD][+-]?\d+)?")


def _refuse_two_commas(path: Path, above: Sequence[str], delimiter: str, rows: Sequence[Sequence[str]]) -> None:
    """Refuse decimal commas between cells that commas separate, told by whole numbers for about twice the headings."""
    named = [cells for cells in (split(line, delimiter) for line in above if line.strip()) if not _n_numbers(cells)]
    n, width = len(named[-1]) if named else 0, len(rows[0])
    halved = n >= 3 and 1.5 * n <= width <= 2 * n
    if delimiter == "," and halved and all(_NO_POINT.fullmatch(cell.strip()) for row in rows for cell in row):
        raise LayoutError(
            f"{path}: the heading names {n} columns, and a row has {width} whole numbers between commas: decimal "
            "commas, with commas between the cells, too? Put semicolons or tabs between them, or write decimal points"
        )


# Numbers


def _separated(path: Path, lines: Sequence[str], fewest: int) -> tuple[str, list[list[str]]]:
    """The delimiter that makes numbers of the largest part of the cells, and lines of the same number of cells."""
    filled = [line for line in lines if line.strip() and not is_comment(line)]
    found = {delimiter: _fitting_rows(filled[-SAMPLE:], delimiter, fewest) for delimiter in DELIMITERS}
    parts = {delimiter: _part_of_numbers(rows) for delimiter, rows in found.items() if rows}
    good = [delimiter for delimiter in parts if round(parts[delimiter] * len(found[delimiter][0])) >= fewest]
    if good:
        best = max(good, key=lambda delimiter: parts[delimiter])
        return best, found[best]
    raise LayoutError(f"{path}: {_no_table(filled)}")


def _fitting_rows(lines: Sequence[str], delimiter: str, fewest: int) -> list[list[str]]:
    """Rows of the most common width; those below the headings of a short file, where there are few of them."""
    rows = [split(line, delimiter) for line in lines]
    rows = [row for row in rows if _n_numbers(row) >= fewest] or rows
    width = Counter(map(len, rows)).most_common(1)[0][0] if rows else 0
    return [row for row in rows if len(row) == width] if width > 1 else []


def _part_of_numbers(rows: Sequence[Sequence[str]]) -> float:
    """How many of the columns hold numbers or times."""
    kinds = kinds_of(rows)
    return sum(kind in ("number", "clock") for kind in kinds) / len(kinds)


def _n_numbers(row: Sequence[str]) -> int:
    return sum(kind_of(cell) in ("number", "clock") for cell in row)


def _no_table(lines: Sequence[str]) -> str:
    if not lines:
        return "no lines: the file is empty, or holds comments only"
    single = sum(kind_of(line) == "number" for line in lines)
    if single > 0.5 * len(lines):
        return "a single column of numbers: nothing separates cells; a column of time and one per channel are needed"
    last = " ".join(lines[-1].split())[:60]
    if not any(kind_of(cell) in ("number", "clock") for line in lines for cell in re.split(r"[\t;, ]+", line) if cell):
        return f"a header, and no rows of numbers; the last line reads {last!r}"
    return (
        f"no table of numbers: neither tab, semicolon, comma nor blank separates the same number of numbers in every "
        f"line within the first {HEAD_BYTES >> 10} kB; a line reads {last!r}"
    )


def _first_of_numbers(lines: Sequence[str], delimiter: str, kinds: Sequence[Kind]) -> int:
    """Number of the first line that is like the last ones."""
    wanted = [k for k, kind in enumerate(kinds) if kind in ("number", "clock")]
    for number, line in enumerate(lines):
        if is_comment(line) or not line.strip():
            continue
        row = split(line, delimiter)
        if len(row) != len(kinds):
            continue
        found = [kind_of(row[k]) for k in wanted]
        fitting = sum(each == kinds[k] for each, k in zip(found, wanted, strict=True))
        if "words" not in found and fitting >= max(1, 0.5 * len(wanted)):
            return number
    return 0


def _decimal(rows: Sequence[Sequence[str]], kinds: Sequence[Kind], thousands: str) -> str:
    """The sign of fractions: a comma where numbers hold commas."""
    if thousands in (".", ","):
        return "," if thousands == "." else "."
    numbers = [row[k] for row in rows for k, kind in enumerate(kinds) if kind == "number"]
    return "," if any("," in cell for cell in numbers) else "."


# Headings


class _Heads(NamedTuple):
    names: tuple[str, ...] | None
    units: tuple[str, ...] | None
    notes: tuple[str, ...] = ()


def _headings(lines: Sequence[str], delimiter: str, kinds: Sequence[Kind]) -> _Heads:
    """Names and units of the columns among the lines above the numbers."""
    width = len(kinds)
    ends = max((k + 1 for k, kind in enumerate(kinds) if kind != "empty"), default=width)
    filled = [line for line in lines if line.strip()]
    plain = _fitting([line for line in filled if not is_comment(line)], delimiter, width, ends)
    rows = plain or _fitting([_bare(line) for line in filled if is_comment(line)], delimiter, width, ends)[-1:]
    if not rows:
        return _Heads(None, None, _unfit(filled, delimiter, width))
    units = rows[-1] if len(rows) > 1 and _are_units(rows[-1]) else None
    names = rows[-2] if units else rows[-1]
    above = rows[: rows.index(names)]
    return _Heads(_told_apart(names, above[-1] if above else None), units)


def _fitting(lines: Sequence[str], delimiter: str, width: int, ends: int) -> list[tuple[str, ...]]:
    """Lines with a cell for each column, perhaps separated by another sign than the numbers are."""
    found = []
    for line in lines:
        for cells in (split(line, each) for each in dict.fromkeys((delimiter, *DELIMITERS))):
            row = _of_width(cells, width, ends)
            if row is None and " " in line:
                row = _of_width(re.split(r"\s{2,}|\t", line.strip()), width, ends) or _of_width(
                    re.findall(r"[^\s\[(]+(?:\s*[\[(][^\])]*[\])])?", line), width, ends
                )
            if row is not None and any(kind_of(cell) == "words" for cell in row):
                found.append(row)
                break
    return found


def _of_width(cells: Sequence[str], width: int, ends: int) -> tuple[str, ...] | None:
    """The cells as a row of that width, empty ones at the end added or left out."""
    row = list(cells)
    while len(row) > ends and not row[-1].strip():
        row.pop()
    if ends <= len(row) <= width:
        return tuple(cell.strip().strip('"').strip() for cell in [*row, *[""] * (width - len(row))])
    return None


def _are_units(row: Sequence[str]) -> bool:
    """Whether a row holds nothing but units, such as (ms) (V)."""
    bare = [cell.strip("()[] ").lower() for cell in row]
    known = sum(cell in _UNITS for cell in bare)
    return known >= max(1, len(row) // 2) and all(len(cell) < 9 for cell in bare)


def _told_apart(names: tuple[str, ...], above: tuple[str, ...] | None) -> tuple[str, ...]:
    """Names; where two are the same, with what stands above them."""
    if above is None or len(set(names)) == len(names):
        return names
    several = {name for name in names if names.count(name) > 1}
    return tuple(f"{top}:{name}" if name in several else name for name, top in zip(names, above, strict=True))


def _unfit(lines: Sequence[str], delimiter: str, width: int) -> tuple[str, ...]:
    """What to say of a line that looks like headings but has another number of cells."""
    for line in reversed(lines):
        cells = split(_bare(line), delimiter)
        if len(cells) > 1 and sum(kind_of(cell) == "words" for cell in cells) > 1:
            shown = ", ".join(cells)[:80]
            return (f"the headings have {len(cells)} cells, the rows {width}: not used ({shown})",)
    return ()


def is_comment(line: str) -> bool:
    """Whether a line is a remark."""
    return line.lstrip().startswith(COMMENTS)


def _bare(line: str) -> str:
    return line.strip().lstrip("#%!/").strip()
