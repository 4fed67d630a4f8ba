"""What a cell of a table of text is: a number, a date, a time of day, nothing, or words."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from typing import Literal

Kind = Literal["number", "clock", "date", "empty", "words"]

MISSING = frozenset(
    ("", "NaN", "nan", "NAN", "null", "NULL", "N/A", "NA", "#N/A", "-", "--", "-nan", "inf", "-inf", "Inf", "-Inf")
)
"""Cells of a sample that is not there."""

_UNSIGNED = r"(?:\d+[.,]?\d*|[.,]\d+)"
_MANTISSA = rf"[+-]?{_UNSIGNED}"
_NUMBER = re.compile(rf"{_MANTISSA}(?:[eEdD][+-]?\d{{1,3}}|(?<=\d)[+-]\d{{3}})?")
_COMPLEX = re.compile(rf"\(?{_MANTISSA}(?:[eE][+-]?\d+)?(?:\s*\+?[+-]\s*{_UNSIGNED}(?:[eE][+-]?\d+)?)?[ij]\)?")
_BLANK = " '\u00a0\u2019\u202f"
_THOUSANDS = re.compile(
    r"[+-]?\d{1,3}(?:(\.)\d{3})+,\d+|[+-]?\d{1,3}(?:(,)\d{3})+\.\d+"
    rf"|[+-]?\d{{1,3}}(?:([{_BLANK}])\d{{3}})+(?:[.,]\d+)?"
)
_FORTRAN = re.compile(rf"{_MANTISSA}(?:[dD][+-]?\d{{1,3}}|(?<=\d)[+-]\d{{3}})")
_DATE = r"(?:\d{1,4}[-./]\d{1,2}[-./]\d{1,4}|\d{1,2}[- .]?[A-Za-z]{3,9}[- .]?\d{2,4})"
CLOCK = (
    r"(?:(?P<h>\d{1,2}):)?(?P<m>\d{1,2}):(?P<s>\d{1,2})(?:[.,:](?P<f>\d{1,12}))?\s*(?P<half>[AaPp]\.?[Mm]\.?)?"
    r"(?:Z|\s*[+-]\d{2}:?\d{2})?"
)
"""A time of day; two numbers are minutes and seconds."""

_DATE_ALONE = re.compile(_DATE)
STAMP = rf"(?:{_DATE}[T ,]+)?{CLOCK}"
"""A time of day, perhaps after a date."""

_STAMP = re.compile(STAMP)


def kind_of(cell: str) -> Kind:
    """What one cell is."""
    cell = cell.strip()
    if cell in MISSING:
        return "empty"
    if _NUMBER.fullmatch(cell) or _THOUSANDS.fullmatch(cell) or _COMPLEX.fullmatch(cell):
        return "number"
    if _STAMP.fullmatch(cell):
        return "clock"
    return "date" if _DATE_ALONE.fullmatch(cell) else "words"


def kinds_of(rows: Sequence[Sequence[str]]) -> tuple[Kind, ...]:
    """What each column of rows of equal length holds: what nine of ten of its cells are, where they are not empty."""
    return tuple(_kind_of_column([kind_of(cell) for cell in column]) for column in zip(*rows, strict=True))


def _kind_of_column(kinds: Sequence[Kind]) -> Kind:
    filled = [kind for kind in kinds if kind != "empty"]
    if not filled:
        return "empty"
    most = max(set(filled), key=filled.count)
    return most if filled.count(most) >= 0.9 * len(filled) else "words"


def split(line: str, delimiter: str) -> list[str]:
    """Cells of a line, stripped; a delimiter between quotation marks is none, blanks in a row are one."""
    line = line.rstrip("\r\n")
    if delimiter == " ":
        return [cell.strip('"') for cell in re.findall(r'"[^"]*"|[^\s"]+', line)]
    try:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])]
    except csv.Error:
        return [cell.strip().strip('"') for cell in line.split(delimiter)]


def fortran_exponent(cell: str) -> bool:
    """Whether a number's exponent is written as Fortran does."""
    return _FORTRAN.fullmatch(cell.strip()) is not None


def thousands_sign(cell: str) -> str:
    """The sign between thousands of a number, empty where there is none."""
    found = _THOUSANDS.fullmatch(cell.strip())
    return next(filter(None, found.groups()), "") if found else ""
