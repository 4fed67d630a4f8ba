"""Workbooks (.xlsx), with the extra ``excel``: a sheet is read as the text that it shows."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ...plant.foreign.layout import LayoutError, layout_of_lines
from .facts import ExchangeError, Facts, Found, check_file
from .text import found_in, opened

MOST_ROWS, MOST_CELLS = 1_000_000, 1000
HEAD_LINES = 400


def read_workbook(path: str | Path, given: Facts) -> Found:
    """Read a sheet of a workbook; ``given["variable"]`` names it where several hold tables.

    Raises
    ------
    ExchangeError
        If it is no workbook, or no sheet or several hold a table of numbers; as `read_csv` otherwise.
    """
    check_file(path)
    sheets = dict(_tables(path))
    chosen = given.get("variable")
    if chosen is not None and chosen not in sheets:
        raise ExchangeError(f"{path} has no sheet {chosen!r} with a table; it has {', '.join(sheets) or 'none'}")
    names = [chosen] if chosen else list(sheets)
    if len(names) != 1:
        found = f"several sheets hold tables: {', '.join(sheets)}" if sheets else "no sheet holds a table of numbers"
        raise ExchangeError(f"{path}: {found}; --variable NAME says which")
    lines = sheets[names[0]]
    return found_in(path, opened(path, layout_of_lines(Path(path), lines[:HEAD_LINES]), iter(lines)), given)


def _tables(path: str | Path) -> Iterator[tuple[str, list[str]]]:
    """Sheets that hold tables, as tab-separated lines."""
    for name, lines in _sheets(path):
        try:
            layout_of_lines(Path(path), lines[:HEAD_LINES])
        except LayoutError:
            continue
        yield name, lines


def _sheets(path: str | Path) -> Iterator[tuple[str, list[str]]]:
    try:
        from openpyxl import load_workbook
    except ImportError:
        raise ExchangeError(
            f"{path}: .xlsx needs the extra: pip install 'seqsweep[excel]', or save it as .csv"
        ) from None
    try:
        book = load_workbook(path, read_only=True, data_only=True)
        for sheet in book.worksheets:
            rows = sheet.iter_rows(values_only=True, max_row=MOST_ROWS, max_col=MOST_CELLS)
            yield sheet.title, [line for line in map(_line, rows) if line.strip()]
    except ExchangeError:
        raise
    except Exception as error:  # whatever its parsers of zip and XML trip over
        words = " ".join(str(error).split())[:160]
        raise ExchangeError(f"{path}: damaged, or not a workbook ({type(error).__name__}: {words})") from None


def _line(cells: tuple[Any, ...]) -> str:
    return "\t".join(_text(cell) for cell in cells).rstrip("\t")


def _text(cell: Any) -> str:
    """A cell as text, numbers with all their digits."""
    if cell is None:
        return ""
    return repr(cell) if isinstance(cell, float) else " ".join(str(cell).split())
