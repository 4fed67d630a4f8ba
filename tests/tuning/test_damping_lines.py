"""Names of the lines of equal damping on the pole map."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from seqsweep.tuning.damping_lines import RATIOS, draw_damping


def named(poles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where the names stand, and where the poles do (points on the page)."""
    axes = Figure(figsize=(4.0, 4.0)).subplots()
    axes.set_xscale("symlog", linthresh=1.0)
    axes.set_yscale("symlog", linthresh=1.0)
    axes.set_xlim(-3000.0, 30.0)
    axes.set_ylim(0.0, 1000.0)
    draw_damping(axes, poles, 1.0, 900.0)
    assert [text.get_text() for text in axes.texts] == [f"{100 * ratio:g} %" for ratio in RATIOS]
    to_points = 72.0 / axes.figure.dpi
    at = np.array([text.xy for text in axes.texts])
    return at, (axes.transData.transform(at) - axes.transData.transform(poles)[:, None]).reshape(-1, 2) * to_points


def test_a_name_stands_as_high_as_it_can_and_moves_out_of_the_way_of_a_pole() -> None:
    free, _ = named(np.array([[-2.0, 2.0]]))
    moved, apart = named(free - np.array([0.0, 0.02]) * free)  # a pole where every name would stand
    assert np.all(moved[:, 1] < free[:, 1])
    assert np.all((np.abs(apart[:, 0]) >= 15.9) | (np.abs(apart[:, 1] - 6.0) >= 9.9))


def test_without_a_pole_the_names_are_there_all_the_same() -> None:
    at, _ = named(np.zeros((0, 2)))
    assert np.all(at[:, 1] > 200.0)
