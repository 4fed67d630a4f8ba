"""The pictures of a report, in the one style of all pictures of this package.

matplotlib's SVG is chosen over an interactive plotting library: the page is then complete without a script, prints as
vectors, stays small, and has the look of every other picture. What an interactive library would add, a cursor and the
values under it, a script of a hundred lines does (`hover.js`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ....identify.response import FrequencyResponse
from ....identify.views.bode import MAX_OVERLAID, bode_figure
from ....identify.views.style import COLOURS, DEVICE, QUIET, WARNING, escaped, grid_lines, new_figure
from .svg import Picture, drawn, points_under, rows_under

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Hover = Callable[[], Mapping[str, Any]]

_ELEMENTS = ("Ypp", "Ypn", "Ynp", "Ynn")


def admittance(responses: Sequence[FrequencyResponse]) -> Picture:
    """Bode picture of at most `MAX_OVERLAID` operating points."""
    shown = list(responses[:MAX_OVERLAID])
    return drawn(
        "bode",
        lambda: _admittance(shown),
        "Magnitude and phase of the four elements of the sequence admittance over frequency, "
        f"{len(shown)} operating point{'s' if len(shown) > 1 else ''}.",
        "Magnitude and phase of Ypp, Ypn, Ynp and Ynn, current positive into the device; the second component is the "
        "conjugate at the mirror frequency 2 f1 - f.",
    )


def _admittance(responses: Sequence[FrequencyResponse]) -> tuple[Figure, Hover]:
    figure = bode_figure(responses)
    heads = [head for name in _ELEMENTS for head in (f"|{name}| (S)", f"\N{ANGLE}{name} (\N{DEGREE SIGN})")]

    def hover() -> Mapping[str, Any]:
        groups = {str(r.meta.get("op_id")): (r.f_hz, _polar(r)) for r in responses}
        return rows_under(figure.axes[:8], "f", "Hz", heads, groups)

    return figure, hover


def _polar(response: FrequencyResponse) -> list[np.ndarray]:
    y = np.where(response.ok[:, None], response.y.reshape(-1, 4), complex(np.nan, np.nan))
    return [column for k in range(4) for column in (np.abs(y[:, k]), np.degrees(np.angle(y[:, k])))]


def modes(points: Sequence[Mapping[str, Any]]) -> Picture:
    """Closed-loop poles of the worst cases inside the swept band, upper half-plane, with 95 % intervals."""
    shown = [point for point in points if point.get("poles")][: len(COLOURS)]
    return drawn(
        "poles",
        lambda: _modes(shown),
        f"Closed-loop poles of {len(shown)} case{'s' if len(shown) != 1 else ''} in the complex plane: real part "
        "against frequency, with 95 % intervals. Poles right of the line at zero grow.",
        "Closed-loop poles inside the swept band, upper half-plane, with 95 % intervals.",
    )


def _modes(points: Sequence[Mapping[str, Any]]) -> tuple[Figure, Hover]:
    figure = new_figure(3.4)
    axes = figure.add_subplot()
    axes.axvline(0.0, color=QUIET, linewidth=0.8)
    places: list[tuple[float, float, str]] = []
    for colour, point in zip(COLOURS, points, strict=False):
        poles = [p for p in point["poles"] if p["kind"] != "beyond" and p["im_rad_s"] >= 0.0]
        re, f = np.array([[p["re_rad_s"], p["f_hz"]] for p in poles]).reshape(-1, 2).T
        errors = np.array([1.96 * p["re_std_rad_s"] for p in poles])
        case = f"{point['op_id']} at scale {point['scale']:g}"
        axes.errorbar(
            re, f, xerr=errors, fmt="x", color=colour, elinewidth=0.8, label=escaped(f"{case}: {point['verdict']}")
        )
        places += [
            (p["re_rad_s"], p["f_hz"], f"{case}: {p['re_rad_s']:+.4g} 1/s at |f - f1| = {p['f_hz']:.4g} Hz, "
             f"damping {100.0 * p['damping']:.3g} %, {p['kind']}")
            for p in poles
        ]  # fmt: skip
    _limit(axes, [p["re_rad_s"] for point in points for p in point["poles"] if p["kind"] in ("resonance", "slow")])
    axes.set_xlabel("Real part (1/s); right of the line a mode grows")
    axes.set_ylabel(r"Frequency $|f - f_1|$ (Hz)")
    grid_lines(axes)
    if points:
        axes.legend(loc="upper left", frameon=False)
    return figure, lambda: points_under(axes, [p[0] for p in places], [p[1] for p in places], [p[2] for p in places])


def _limit(axes: Axes, decisive: Sequence[float]) -> None:
    """Show what decides: modes far to the left say nothing about stability and are cut off."""
    widest = max(20.0, *(abs(value) for value in decisive)) if decisive else 100.0
    axes.set_xlim(-12.0 * widest, max(2.0 * widest, 1.2 * max(decisive, default=0.0)))


def resonance_in_time(verification: Mapping[str, Any]) -> Picture:
    """The resonance's share of the current in every window, without and with damping control."""
    return drawn(
        "time",
        lambda: _in_time(verification["runs"]),
        "Share of the resonance in the current over time, without and with damping control.",
        f"{verification['op_id']}: the resonance's share of the current in windows of 150 ms, "
        f"k = {verification['damping']['k']:.3g}.",
    )


def _in_time(runs: Mapping[str, Any]) -> tuple[Figure, Hover]:
    figure = new_figure(2.8)
    axes = figure.add_subplot()
    groups: dict[str, tuple[Any, Sequence[Any]]] = {}
    for (name, run), colour in zip(runs.items(), (WARNING, DEVICE), strict=False):
        windows = [w for w in run["windows"] if w.get("ratio") is not None]
        time = [(w["from_s"] + w["to_s"]) / 2.0 for w in windows]
        ratio = [100.0 * w["ratio"] for w in windows]
        axes.semilogy(time, ratio, "o-", color=colour, label=f"{name} damping control")
        power = [np.nan if w.get("power_mw") is None else w["power_mw"] for w in windows]
        groups[f"{name} damping control"] = (time, [ratio, power])
    axes.axhline(3.0, color=QUIET, linestyle="--", linewidth=0.8, label="control starts above")
    axes.set_xlabel("Time (s)")
    axes.set_ylabel("Resonance over fundamental (%)")
    grid_lines(axes)
    axes.legend(frameon=False)
    return figure, lambda: rows_under([axes], "t", "s", ["resonance over fundamental (%)", "P (MW)"], groups)
