"""The bank of grids in a report: every pair counted, the worst shown, the rest folded by operating point and by grid.

A bank may hold a thousand operating points on four hundred grids. So only the columns that are shown are read, sorting
and counting are done on arrays, and the page holds as many rows as there are operating points and grids, not pairs.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ....identify.views.style import WARNING, grid_lines, new_figure
from .svg import Picture, drawn, points_under

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from .pictures import Hover

VERDICTS = ("unstable", "undecided", "stable")
"""From the worst to the best."""

COLOURS = ("#cb181d", "#fdd49e", "#9ecae1")

POINTED_AT = 1500
"""Pairs, the worst first, that the picture shows one by one."""

NAMED = 40
"""Grids or operating points up to which each has its name on the axis of the map."""

_COLUMNS = (
    "grid_id", "op_id", "status", "verdict", "probability", "margin_m", "mode_lower_hz", "mode_upper_hz", "re_rad_s",
    "damping", "critical_scale",
)  # fmt: skip


@dataclass(frozen=True)
class Bank:
    """The rows of ``judge.parquet``.

    Attributes
    ----------
    meta : mapping
        What the file says of itself.
    columns : mapping of str to (n,) arrays
        The columns that a report shows; numbers are NaN where there is none.
    """

    meta: Mapping[str, Any]
    columns: Mapping[str, np.ndarray]

    def __len__(self) -> int:
        return len(self.columns["verdict"])

    @cached_property
    def rank(self) -> np.ndarray:
        """(n,) int: place of each pair's verdict among `VERDICTS`."""
        places = {"unstable": 0, "stable": 2}
        names, number = np.unique(self.columns["verdict"], return_inverse=True)
        return np.array([places.get(name, 1) for name in names.tolist()])[number]

    @cached_property
    def order(self) -> np.ndarray:
        """(n,) int: pairs from the worst to the best: by verdict, then by how fast the deciding mode grows."""
        growth = np.nan_to_num(self.columns["re_rad_s"], nan=-np.inf)
        return np.lexsort((-growth, self.rank))

    @property
    def counts(self) -> dict[str, int]:
        """Pairs by verdict, from the worst to the best, without those that are not there."""
        found = np.bincount(self.rank, minlength=3)
        return {name: int(n) for name, n in zip(VERDICTS, found, strict=True) if n}

    def rows(self, start: int, stop: int) -> list[dict[str, Any]]:
        """Pairs ``start`` to ``stop`` in the order of `order`."""
        at = self.order[start:stop]
        return [
            dict(zip(self.columns, row, strict=True))
            for row in zip(*(c[at].tolist() for c in self.columns.values()), strict=True)
        ]

    def by(self, column: str) -> list[dict[str, Any]]:
        """One row per operating point (``op_id``) or grid (``grid_id``), the worst first, with its counts and worst."""
        other = "op_id" if column == "grid_id" else "grid_id"
        names, number = np.unique(self.columns[column], return_inverse=True)
        counts = np.zeros((len(names), 3), dtype=int)
        np.add.at(counts, (number, self.rank), 1)
        first = np.full(len(names), len(self))
        np.minimum.at(first, number[self.order], np.arange(len(self)))
        worst = self.order[first]
        return [
            {
                "name": names[k],
                "counts": counts[k].tolist(),
                "worst": self.columns[other][worst[k]],
                "margin_m": self.columns["margin_m"][worst[k]],
                "damping": self.columns["damping"][worst[k]],
            }
            for k in np.argsort(first, kind="stable")
        ]


def read_bank(path: Path, meta: Mapping[str, Any]) -> Bank:
    """The columns of a ``judge.parquet`` that a report shows."""
    import pyarrow.parquet as pq

    table = pq.read_table(path, columns=list(_COLUMNS))
    return Bank(meta, {name: table.column(name).to_pandas().to_numpy() for name in _COLUMNS})


def sentence_of(bank: Bank) -> str:
    """The bank in one sentence."""
    counts, n = bank.counts, len(bank)
    if set(counts) == {"stable"}:
        return f"On the bank of grids: stable on all {n} pairs of grid and operating point."
    others = " and ".join(f"{k} {name}" for name, k in counts.items() if name != "stable")
    worst = bank.rows(0, 1)[0]
    return (
        f"On the bank of grids: stable on {counts.get('stable', 0)} of {n} pairs of grid and operating point, "
        f"{others}; the weakest is grid {worst['grid_id']} at {worst['op_id']}."
    )


def picture(bank: Bank) -> Picture:
    """Map of the verdicts, and the deciding modes of the worst pairs."""
    counts = ", ".join(f"{n} {name}" for name, n in bank.counts.items())
    shown = min(len(bank), POINTED_AT)
    of = f"the worst {shown} of {len(bank)} pairs" if shown < len(bank) else "all pairs"
    return drawn(
        "bankmap",
        lambda: _figure(bank),
        f"Verdict of {len(bank)} pairs of grid and operating point: {counts}; and damping against frequency of the "
        f"deciding mode of {of}.",
        f"Left: verdicts, operating points and grids from the worst to the best. Right: the deciding mode of {of}.",
    )


def _figure(bank: Bank) -> tuple[Figure, Hover]:
    figure = new_figure(3.6)
    left, right = figure.subplots(1, 2, width_ratios=[1.25, 1.0])
    _draw_map(left, bank)
    texts, x, y = _draw_modes(right, bank)
    return figure, lambda: points_under(right, x, y, texts)


def _draw_map(axes: Axes, bank: Bank) -> None:
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Patch

    points, grids = ([row["name"] for row in bank.by(column)] for column in ("op_id", "grid_id"))
    cells = np.full((len(grids), len(points)), np.nan)
    at = [_places(grids, bank.columns["grid_id"]), _places(points, bank.columns["op_id"])]
    cells[at[0], at[1]] = bank.rank
    axes.imshow(cells, aspect="auto", cmap=ListedColormap(COLOURS), vmin=-0.5, vmax=2.5, interpolation="none")
    for axis, names, word in ((axes.yaxis, grids, "grids"), (axes.xaxis, points, "operating points")):
        axis.set_ticks(range(len(names)), names) if len(names) <= NAMED else axis.set_ticks([])
        axis.set_label_text(f"{len(names)} {word}, the worst first" if len(names) > 1 else word)
    axes.tick_params(axis="x", rotation=90)
    handles = [
        Patch(facecolor=colour, edgecolor="0.4", label=f"{name} ({bank.counts[name]})")
        for name, colour in zip(VERDICTS, COLOURS, strict=True)
        if name in bank.counts
    ]
    axes.legend(handles=handles, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, frameon=False, fontsize=8)


def _places(names: list[str], column: np.ndarray) -> list[int]:
    """Place (n,) among ``names`` of every entry of a column."""
    place = {name: k for k, name in enumerate(names)}
    return [place[name] for name in column.tolist()]


def _draw_modes(axes: Axes, bank: Bank) -> tuple[list[str], np.ndarray, np.ndarray]:
    """Damping over the upper frequency of the deciding modes; texts and places of the points."""
    rows = [row for row in bank.rows(0, POINTED_AT) if row["damping"] == row["damping"]]
    x = np.array([row["mode_upper_hz"] for row in rows], dtype=float)
    y = np.array([100.0 * row["damping"] for row in rows], dtype=float)
    grid_lines(axes)
    axes.axhline(0.0, color=WARNING, linewidth=0.8)
    for name, colour in zip(VERDICTS, ("#a50f15", "#b26a00", "#08519c"), strict=True):
        mask = np.array([row["verdict"] == name for row in rows], dtype=bool)
        axes.plot(x[mask], y[mask], ".", markersize=3.5, color=colour, label=name, alpha=0.7)
    axes.set_xlabel("Upper frequency of the deciding mode (Hz)")
    axes.set_ylabel("Damping (%); below the line it grows")
    return [_text(row) for row in rows], x, y


def _text(row: Mapping[str, Any]) -> str:
    return (
        f"grid {row['grid_id']} at {row['op_id']}: {row['verdict']}, mode at {row['mode_lower_hz']:.4g} / "
        f"{row['mode_upper_hz']:.4g} Hz, damping {100.0 * row['damping']:.3g} %, m = {row['margin_m']:.4g}"
    )


def metadata_of(schema_metadata: Mapping[bytes, bytes] | None) -> dict[str, Any]:
    """What a Parquet file of ours says of itself; nothing where it is not ours."""
    try:
        found = json.loads((schema_metadata or {}).get(b"seqsweep", b"{}"))
    except ValueError:
        return {}
    return found if isinstance(found, dict) else {}
