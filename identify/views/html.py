"""A small table as HTML: how results show themselves in a notebook."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

MOST = 12
"""Rows that a result shows; the rest is counted."""

_VERDICTS = {"stable": "#1b6e33", "unstable": "#a50f15", "undecided": "#7a4b00"}
"""Colours with enough contrast on white, and on the tint behind every second row of a notebook."""


def html_table(title: str, heads: Sequence[str], rows: Iterable[Sequence[str]], total: int | None = None) -> str:
    """A title and a table of text, escaped; the first column heads its row, a verdict has its colour.

    Parameters
    ----------
    title : str
        What stands above.
    heads : sequence of str
        One per column.
    rows : iterable of sequences of str
        What is shown.
    total : int, optional
        How many rows there are in all, where not all are shown.
    """
    body = [list(row) for row in rows]
    head = "".join(f'<th scope="col">{escape(text)}</th>' for text in heads)
    lines = "".join(f"<tr>{_first(row[:1])}{''.join(map(_cell, row[1:]))}</tr>" for row in body)
    more = "" if total is None or total <= len(body) else f"<p>&hellip; and {total - len(body)} more</p>"
    return f"<p>{escape(title)}</p><table><thead><tr>{head}</tr></thead><tbody>{lines}</tbody></table>{more}"


def _first(texts: Sequence[str]) -> str:
    return "".join(f'<th scope="row">{escape(text)}</th>' for text in texts)


def _cell(text: str) -> str:
    colour = _VERDICTS.get(text)
    style = f' style="color:{colour};font-weight:bold"' if colour else ""
    return f"<td{style}>{escape(text)}</td>"
