"""Plain text in a given width: tables that leave columns out and say so, lines that are continued below."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

WIDTH = 80
"""Columns of what is printed where no terminal says how wide it is."""

NARROWEST = 20
"""Columns below which nothing is folded any further."""

_HELD = "\N{NO-BREAK SPACE}"
SHORT = 16
"""Characters of a name that had no room."""

_NAMES = ("grid", "op")
_LEFT = (*_NAMES, "verdict")


class Fitted(NamedTuple):
    """A table as lines, and the names of its columns and of those that had no room."""

    lines: list[str]
    names: list[str]
    dropped: list[str]


def fitted_table(rows: Sequence[Mapping[str, str]], width: int, dropped_first: Sequence[str]) -> Fitted:
    """A table of ``rows`` (column to cell), empty columns left out.

    Where it is too wide, first long names are shortened, then columns are left out in the order of ``dropped_first``.
    """
    names = [name for name in rows[0] if any(row[name] for row in rows)]
    if _width_of(rows, names) > width:
        rows = _shortened(rows, [name for name in names if name in _NAMES])
    dropped = []
    for name in dropped_first:
        if name in names and _width_of(rows, names) > width:
            names.remove(name)
            dropped.append(name)
    return Fitted(aligned(_cells(rows, names)), names, dropped)


def _shortened(rows: Sequence[Mapping[str, str]], names: Sequence[str]) -> list[Mapping[str, str]]:
    """The rows, long names without their middle, unless two of them would then look alike."""
    short = {name: [_without_middle(row[name]) for row in rows] for name in names}
    kept = [name for name in names if len(set(short[name])) == len({row[name] for row in rows})]
    return [{**row, **{name: short[name][k] for name in kept}} for k, row in enumerate(rows)]


def _without_middle(text: str) -> str:
    return text if len(text) <= SHORT else f"{text[: SHORT // 2 - 2]}...{text[1 - SHORT // 2 :]}"


def left_out(dropped: Sequence[str], elsewhere: str) -> Iterator[str]:
    """The sentence on columns that had no room."""
    if dropped:
        yield f"left out, the lines being too long: {', '.join(dropped)} (a wider terminal or {elsewhere} has them)"


def aligned(table: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a table whose first row is its head: names to the left, numbers to the right."""
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    head, *rows = table
    lines = []
    for cells in (head, ["-" * width for width in widths], *rows):
        padded = [
            cell.ljust(width) if name in _LEFT else cell.rjust(width)
            for name, cell, width in zip(head, cells, widths, strict=True)
        ]
        lines.append("  ".join(padded).rstrip())
    return lines


def _width_of(rows: Sequence[Mapping[str, str]], names: Sequence[str]) -> int:
    return max(map(len, aligned(_cells(rows, names))))


def _cells(rows: Sequence[Mapping[str, str]], names: Sequence[str]) -> list[Sequence[str]]:
    """The head of a table and its rows."""
    return [names, *([row[name] for name in names] for row in rows)]


def wrapped(text: str, width: int, hang: str = "  ") -> list[str]:
    """Lines of at most ``width``, the second and further ones begun with ``hang``.

    No word is broken, so that a path can be copied, and no percent sign parted from its number.
    """
    lines = textwrap.wrap(
        text.replace(" %", f"{_HELD}%"),
        max(width, NARROWEST),
        subsequent_indent=hang,
        break_long_words=False,
        break_on_hyphens=False,
    )
    return [line.replace(_HELD, " ") for line in lines]


def labelled(rows: Sequence[tuple[str, str]], width: int) -> str:
    """``label  text`` in two columns; the text goes on below itself, or further left where little room is."""
    column = max(len(label) for label, _ in rows) + 2
    hang = " " * (column if width - column >= 2 * NARROWEST else 6)
    lines = [line for label, text in rows for line in wrapped(f"{label:<{column}}{text}", width, hang)]
    return "\n".join(lines)


def folded(text: str, width: int) -> str:
    """The text, every line that is wider than ``width`` continued below it, two further in than it began."""
    return "\n".join(part for line in text.split("\n") for part in _parts(line, width))


def _parts(line: str, width: int) -> Iterator[str]:
    if len(line) <= width:
        yield line
        return
    indent = line[: len(line) - len(line.lstrip())]
    yield from wrapped(line, width, f"{indent}  ")
