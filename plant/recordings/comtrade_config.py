"""The lines of a COMTRADE configuration, held against what the standard has in each, before a parser sees them.

What does no harm is mended (commas at the end of a line, commas between quotation marks); what does is refused with
the number of its line.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from pathlib import Path

from ..errors import SeqsweepError
from .recording import RecordingError

ANALOG_CELLS = {1991: 10, 1999: 13, 2013: 13}


def clean_lines(path: Path, text: str) -> list[str]:
    """Lines of a configuration, fit for a parser.

    Raises
    ------
    RecordingError
        If a line is not what its place asks for: with its number, what it should be and what it reads.
    """
    lines = [_clean(line) for line in text.replace("\x1a", "").strip().splitlines()]
    reader = _Lines(path, lines)
    revision = _revision(lines[0] if lines else "")
    total = reader.cells(1, "the numbers of channels, such as 6,6A,0D", 3)
    n_analog = reader.count(1, total[1], "A")
    n_status = reader.count(1, total[2], "D")
    said = f"line 2 announces {n_analog} analog and {n_status} status channels"
    for k in range(n_analog):
        reader.analog(2 + k, f"analog channel {k + 1}; {said}", revision)
    for k in range(n_status):
        reader.cells(2 + n_analog + k, f"status channel {k + 1}; {said}", 3)
    at = 2 + n_analog + n_status
    reader.numbers(at, f"the line frequency; {said}", 1, empty=True)
    n_rates = int(reader.numbers(at + 1, "the number of sampling rates", 1)[0])
    for k in range(max(1, n_rates)):
        reader.numbers(at + 2 + k, f"sampling rate {k + 1} and its last sample", 2)
    return lines


def _clean(line: str) -> str:
    """A line without blanks and commas at its end, and without commas in quoted names."""
    line = line.strip()
    if '"' in line:
        cells = next(csv.reader([line], skipinitialspace=True), [])
        line = ",".join(cell.replace(",", ";") for cell in cells)
    return line


def _revision(first: str) -> int:
    """Year of the standard that the first line names; the first one names none."""
    cells = [cell.strip() for cell in first.split(",")]
    year = cells[2] if len(cells) > 2 else ""
    return int(year) if year in ("1999", "2013") else 1991


class _Lines:
    """Lines by number, with complaints that name it."""

    def __init__(self, path: Path, lines: Sequence[str]):
        self._path, self._lines = path, lines

    def cells(self, at: int, what: str, fewest: int) -> list[str]:
        """At least so many cells."""
        line = self._lines[at] if at < len(self._lines) else None
        cells = [cell.strip() for cell in line.split(",")] if line else []
        if line is None or len(cells) < fewest:
            self._refuse(at, what, f"needed are {fewest} cells")
        return cells

    def count(self, at: int, cell: str, letter: str) -> int:
        """A number of channels such as 6A."""
        digits = cell.upper().removesuffix(letter)
        if not digits.isdigit() or len(digits) > 5:
            self._refuse(at, "the numbers of channels, such as 6,6A,0D", f"{cell!r} is no number of channels")
        return int(digits)

    def analog(self, at: int, what: str, revision: int) -> None:
        """Number, name, phase, component, unit, a, b, skew, lowest and highest, and what newer standards add."""
        most = ANALOG_CELLS[revision]
        cells = self.cells(at, what, 10)
        while len(cells) > most and not cells[-1]:
            cells.pop()
        if len(cells) > most:
            self._refuse(at, what, f"it has {len(cells)} cells, a channel has {most}: a comma within a name?")
        self._numeric(at, what, cells[5:10], empty=True)

    def numbers(self, at: int, what: str, fewest: int, empty: bool = False) -> list[float]:
        """Numbers, at least so many."""
        cells = self.cells(at, what, 1)
        if not empty or any(cells):
            cells = self.cells(at, what, fewest)
        if fewest == 1 and len([cell for cell in cells if cell]) > 1:
            self._refuse(at, what, "needed is one number")
        return self._numeric(at, what, cells[:fewest], empty)

    def _numeric(self, at: int, what: str, cells: Sequence[str], empty: bool = False) -> list[float]:
        found = []
        for cell in cells:
            if not cell and empty:
                found.append(0.0)
                continue
            try:
                found.append(_finite(float, cell))
            except ValueError:
                self._refuse(at, what, f"{cell[:20]!r} is no number")
        return found

    def _refuse(self, at: int, what: str, why: str) -> None:
        reads = f"reads {self._lines[at][:60]!r}" if at < len(self._lines) else "is missing"
        raise RecordingError(f"{self._path}: line {at + 1} of the configuration should be {what}, but {reads}: {why}")


def _finite(parse: Callable[[str], float], cell: str) -> float:
    value = parse(cell)
    if not abs(value) < 1e300:
        raise SeqsweepError(cell)
    return value
