"""A response in one line, and as a small HTML table: what a notebook shows of it."""

from __future__ import annotations

from collections import Counter
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from ..table.format import ELEMENTS
from ..uncertainty import relative_uncertainty
from .html import MOST, html_table

if TYPE_CHECKING:
    from ..response import FrequencyResponse

ENDS = 5
"""Rows that are shown of either end of a long response."""


def in_a_line(response: FrequencyResponse) -> str:
    """Such as ``<FrequencyResponse p065: 100 rows, 1 to 1000 Hz, 100 ok, error <= 5.8e-06>``."""
    name = response.meta.get("op_id", "without a name")
    return f"<FrequencyResponse {name}: {facts_of(response)}>"


def facts_of(response: FrequencyResponse) -> str:
    """Rows, band, statuses and worst error, in words."""
    n = len(response)
    if not n:
        return "no rows"
    counts = Counter(np.asarray(response.status).tolist()).most_common()
    band = f"{response.f_hz[0]:g} to {response.f_hz[-1]:g} Hz" if n > 1 else f"{response.f_hz[0]:g} Hz"
    frame = [] if response.frame == "pn" else [f"{response.frame} frame"]
    parts = [f"{n} row{'s' if n > 1 else ''}", band, *frame, *(f"{count} {status}" for status, count in counts)]
    error = relative_uncertainty(response)
    known = error[np.isfinite(error)]
    return ", ".join([*parts, f"error <= {known.max():.1e}"] if len(known) else parts)


def as_html(response: FrequencyResponse) -> str:
    """The line above, and the first and last rows below it: magnitudes in S and angles in degrees."""
    names = ELEMENTS if response.frame == "pn" else ("dd", "dq", "qd", "qq")
    head = "".join(f"<th>{name}</th>" for name in ("f (Hz)", *(f"Y<sub>{n}</sub> (S)" for n in names), "status"))
    rows = "".join(_row(response, k) for k in _shown(len(response)))
    return f"<p>{escape(in_a_line(response))}</p><table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>"


def _shown(n: int) -> list[int | None]:
    """Rows to show; None stands for those that are left out."""
    return list(range(n)) if n <= 2 * ENDS + 1 else [*range(ENDS), None, *range(n - ENDS, n)]


def _row(response: FrequencyResponse, k: int | None) -> str:
    if k is None:
        return "<tr>" + "<td>&hellip;</td>" * 6 + "</tr>"
    values = [_polar(complex(value)) for value in response.y[k].ravel()]
    cells = [f"{response.f_hz[k]:g}", *values, escape(_status(response, k))]
    return "<tr>" + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>"


def _polar(value: complex) -> str:
    if not np.isfinite(value):
        return "&ndash;"
    return f"{abs(value):.4g}&ang;{np.degrees(np.angle(value)):.1f}&deg;"


def _status(response: FrequencyResponse, k: int) -> str:
    status, reason = np.asarray(response.status)[k], np.asarray(response.reason)[k]
    return f"{status}: {reason}" if reason else str(status)


def table_in_a_line(responses: Any) -> str:
    """A table as one line for every operating point."""
    lines = [f"  {response.meta['op_id']}: {facts_of(response)}" for response in responses]
    n = len(lines)
    shown = lines if n <= 2 * ENDS + 1 else [*lines[:ENDS], "  ...", *lines[-ENDS:]]
    return "\n".join([f"<Table of {n} operating point{'s' if n != 1 else ''}", *shown]) + ">"


def table_as_html(responses: Any) -> str:
    """A table as one row for every operating point, the first ones."""
    rows = [
        (
            str(r.meta["op_id"]),
            _known(r.meta.get("active_power_mw")),
            _known(r.meta.get("terminal_voltage_pu")),
            facts_of(r),
        )
        for r in responses[:MOST]
    ]
    n = len(responses)
    title = f"Table of {n} operating point{'s' if n != 1 else ''}"
    return html_table(title, ("operating point", "P (MW)", "|v| (pu)", "rows"), rows, n)


def _known(value: float | None) -> str:
    return "\N{EN DASH}" if value is None else f"{value:.4g}"
