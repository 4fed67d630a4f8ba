"""Lines of equal damping ratio on a map of poles, with their names where no pole is in the way."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..identify.views.style import QUIET

if TYPE_CHECKING:
    from matplotlib.axes import Axes

RATIOS = (0.01, 0.05, 0.2, 0.7)

_ROOM_PT = np.array([16.0, 10.0])  # half a name and half a mark, across and up
_BELOW_PT = np.array([0.0, -6.0])  # from the place of a name to its middle


def draw_damping(axes: Axes, poles: np.ndarray, lowest_hz: float, highest_hz: float) -> None:
    """Draw the lines of `RATIOS`.

    Parameters
    ----------
    axes : Axes
        With its limits set: real part (rad/s) over abs(f - f1) (Hz).
    poles : (n, 2) float
        What is drawn on them, in their units.
    lowest_hz, highest_hz : float
        Where the lines begin and end.
    """
    nu, taken = np.geomspace(lowest_hz, highest_hz, 100), poles.reshape(-1, 2)
    for ratio in RATIOS:
        line = np.column_stack([-2.0 * np.pi * nu * ratio / np.sqrt(1.0 - ratio**2), nu])
        axes.plot(*line.T, color="0.75", linewidth=0.6, zorder=0)
        at = _free_place(axes, line[line[:, 0] >= 0.55 * axes.get_xlim()[0]], taken)
        taken = np.vstack([taken, at])
        axes.annotate(
            f"{100.0 * ratio:g} %", at, xytext=(0, -2), textcoords="offset points", fontsize=7,
            color=QUIET, ha="center", va="top", clip_on=True,
            bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.4, "alpha": 0.8},
        )  # fmt: skip


def _free_place(axes: Axes, line: np.ndarray, taken: np.ndarray) -> tuple[float, float]:
    """The highest point of a line (n, 2) whose name touches nothing ``taken`` (m, 2); else the freest of all."""
    to_points = 72.0 / axes.figure.dpi
    names = axes.transData.transform(line) * to_points + _BELOW_PT
    marks = axes.transData.transform(taken) * to_points
    apart = np.max(np.abs(names[:, None, :] - marks) / _ROOM_PT, axis=2).min(axis=1, initial=np.inf)
    free = np.flatnonzero(apart >= 1.0)
    x, y = line[free[-1] if len(free) else int(np.argmax(apart))]
    return float(x), float(y)
