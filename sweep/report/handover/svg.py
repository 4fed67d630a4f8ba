"""A picture of a report: SVG that stands in the page itself, words for those who do not see it, values to point at.

The SVG is complete without a script. Beside it stands what a script needs where one may run: where the panels are, and
the numbers behind the lines, so that a cursor can be laid over the picture and its values read.
"""

from __future__ import annotations

import io
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from ....identify.views.style import styled

if TYPE_CHECKING:
    from collections.abc import Callable

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_DIGITS = 5
_SERIF = "'STIXGeneral', 'STIX Two Text', 'Times New Roman', Times, serif"
"""The fonts of the pictures: the one that they are laid out with, then such as other machines have."""


@dataclass(frozen=True)
class Picture:
    """One picture of a report.

    Attributes
    ----------
    name : str
        Its identifier in the page.
    svg : str
        The SVG element.
    alt : str
        What it shows, for those who do not see it.
    caption : str
        What stands below it.
    hover : mapping
        Panels and values for the script; see `rows_under` and `points_under`.
    """

    name: str
    svg: str
    alt: str
    caption: str
    hover: Mapping[str, Any] = field(default_factory=dict)

    @property
    def data(self) -> str:
        """`hover` as JSON that may stand inside a page."""
        return json.dumps(self.hover, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")


def drawn(
    name: str, make: Callable[[], tuple[Figure, Callable[[], Mapping[str, Any]]]], alt: str, caption: str
) -> Picture:
    """A picture by ``make``, which gives the figure, and the values under it once the figure has its layout."""
    found: dict[str, Any] = {}

    def text() -> str:
        figure, hover = make()
        svg = svg_of(figure, name)
        found.update(hover())
        return svg

    return Picture(name, styled(text), alt, caption, found)


def svg_of(figure: Figure, name: str) -> str:
    """The figure as an SVG element, its identifiers made unique by ``name`` so that several stand in one page."""
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    file = io.StringIO()
    FigureCanvasSVG(figure).print_svg(file, metadata={"Date": None, "Creator": None})  # savefig draws twice
    text = file.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r'\bid="([^"]+)"', rf'id="{name}-\1"', text)
    text = re.sub(r'(href="#|url\(#)', rf"\1{name}-", text)
    text = text.replace("'STIXGeneral'", _SERIF)
    text = re.sub(r'height="[^"]*pt"', "", text, count=1)
    return re.sub(r'<svg ([^>]*?)width="[^"]*"', r'<svg \1aria-hidden="true" focusable="false"', text, count=1)


def rows_under(
    panels: Iterable[Axes], name: str, unit: str, heads: Sequence[str], groups: Mapping[str, tuple[Any, Sequence[Any]]]
) -> dict[str, Any]:
    """Values over one abscissa, for a cursor that all panels share.

    Parameters
    ----------
    panels : axes
        Those that have the abscissa; their figure must have been drawn.
    name, unit : str
        Of the abscissa.
    heads : sequence of str
        What each column of values is, unit included.
    groups : mapping of str to (x, columns)
        Values by the name of what they belong to: abscissa (n,) and one (n,) per head.
    """
    return {
        "kind": "rows",
        "name": name,
        "unit": unit,
        "heads": list(heads),
        "panels": [_panel(axes) for axes in panels],
        "groups": [
            {"name": group, "x": _plain(x), "columns": [_plain(column) for column in columns]}
            for group, (x, columns) in groups.items()
        ],
    }


def points_under(axes: Axes, x: Any, y: Any, texts: Sequence[str]) -> dict[str, Any]:
    """Points with a text each, the nearest of which is read where somebody points; the figure must have been drawn."""
    places = axes.transData.transform(np.column_stack([np.asarray(x, float), np.asarray(y, float)]))
    width, height = axes.figure.get_size_inches() * axes.figure.dpi  # type: ignore[union-attr]
    box = axes.bbox.padded(2.0)
    shown = [k for k in np.flatnonzero(np.isfinite(places).all(axis=1)) if box.contains(*places[k])]
    return {
        "kind": "points",
        "panels": [_panel(axes)],
        "points": [
            [round(float(places[k, 0] / width), 4), round(1.0 - float(places[k, 1] / height), 4), texts[int(k)]]
            for k in shown
        ],
    }


def _panel(axes: Axes) -> dict[str, Any]:
    """Where axes stand, in parts of the picture from its upper left corner, and what their abscissa spans."""
    box = axes.get_position()
    low, high = axes.get_xlim()
    where = {"left": box.x0, "right": box.x1, "top": 1.0 - box.y1, "bottom": 1.0 - box.y0}
    return {
        **{key: round(float(value), 4) for key, value in where.items()},
        "low": float(low),
        "high": float(high),
        "log": axes.get_xscale() == "log",
    }


def _plain(values: Any) -> list[float | None]:
    """Numbers of a few digits; None where there is none."""
    return [float(f"{v:.{_DIGITS}g}") if np.isfinite(v) else None for v in np.asarray(values, dtype=float).tolist()]
