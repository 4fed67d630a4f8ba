"""The one-line diagram of a farm with its critical mode drawn on it: who takes part, and which branch counts.

The network is laid out as a tree from the source's bus; what closes a loop is dashed. A device is a circle whose area
is its share in the mode, red where more of it makes the mode less damped; a branch is as wide as the mode moves with
its impedance. All of that stands in the JSON of `seqsweep farm`, so that a report draws it from the file alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ...identify.views.style import DEVICE, QUIET, WARNING, new_figure, write_figure
from ...tuning.farm.farm import Farm
from ...tuning.farm.result import to_json

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_WIDEST = 7.0  # points of the branch that counts most
_LARGEST = 420.0  # square points of a device with the whole share
_NAMED = 30  # devices up to which names stand beside them


class Places(NamedTuple):
    """Where the nodes of the network stand, and which branches make the tree."""

    at: dict[str, tuple[float, float]]
    tree: frozenset[int]


Content = Mapping[str, Any]
"""The JSON of a farm."""


def plot_diagram(path: str | Path, farm: Farm) -> None:
    """Draw the diagram and write it; see `write_figure`."""
    write_figure(path, lambda: diagram_figure(to_json(farm)))


def diagram_figure(farm: Content) -> Figure:
    """The one-line diagram of what `tuning.farm.result.to_json` gives."""
    places = laid_out(farm)
    rows = 1.0 + max(y for _, y in places.at.values())
    figure = new_figure(float(np.clip(0.45 * rows + 1.2, 2.4, 9.0)))
    axes = figure.subplots()
    mode = critical_of(farm)
    _draw_branches(axes, farm, places, mode)
    _draw_buses(axes, farm, places)
    _draw_devices(axes, farm, places, mode)
    _draw_source(axes, farm, places, mode)
    axes.set_title(_title(farm, mode), fontsize=9.0)
    axes.set_axis_off()
    axes.margins(x=0.06, y=0.12)
    axes.invert_yaxis()
    return figure


def critical_of(farm: Content) -> Content | None:
    """The mode with the largest real part; None if there is none."""
    return max(farm["modes"], key=lambda mode: float(mode["sigma_per_s"]), default=None)


def laid_out(farm: Content) -> Places:
    """A tree from the source's bus: depth to the right, leaves one below the other."""
    children: dict[str, list[str]] = {}
    root = farm["network"]["source_bus"]
    tree, seen, queue = set(), {root}, [root]
    ends = {k: list(branch["ends"]) for k, branch in enumerate(farm["network"]["branches"])}
    while queue:
        here = queue.pop(0)
        for k, pair in ends.items():
            if len(pair) == 2 and here in pair:
                other = pair[1] if pair[0] == here else pair[0]
                if other not in seen:
                    children.setdefault(here, []).append(other)
                    tree.add(k)
                    seen.add(other)
                    queue.append(other)
    return Places(_placed(root, children), frozenset(tree))


def _placed(root: str, children: dict[str, list[str]]) -> dict[str, tuple[float, float]]:
    """Depth and row of every node, without recursion, as chains may be long."""
    at: dict[str, tuple[float, float]] = {}
    order, stack = [], [(root, 0)]
    while stack:
        here, level = stack.pop()
        order.append((here, level))
        stack += [(child, level + 1) for child in reversed(children.get(here, []))]
    row = 0.0
    for here, level in order:  # leaves in their order
        if not children.get(here):
            at[here] = (float(level), row)
            row += 1.0
    for here, level in reversed(order):  # the others in the middle of what is behind them
        if children.get(here):
            at[here] = (float(level), float(np.mean([at[child][1] for child in children[here]])))
    return at


def _draw_branches(axes: Axes, farm: Content, places: Places, mode: Content | None) -> None:
    widths = _widths(farm, mode)
    for k, branch in enumerate(farm["network"]["branches"]):
        nodes = list(branch["ends"])
        if len(nodes) == 2:
            (x0, y0), (x1, y1) = places.at[nodes[0]], places.at[nodes[1]]
            style = "-" if k in places.tree else (0, (4, 2))
            axes.plot([x0, x1], [y0, y1], color="0.45", linewidth=widths[k], linestyle=style, zorder=1)
            if _is_transformer(branch["ends"]):
                _draw_windings(axes, (x0 + x1) / 2.0, (y0 + y1) / 2.0)


def _widths(farm: Content, mode: Content | None) -> np.ndarray:
    """(b,) points: by how much the mode moves with each branch's impedance."""
    names = [branch["name"] for branch in farm["network"]["branches"]]
    if mode is None:
        return np.full(len(names), 0.8)
    moved = [mode["branches"][name] for name in names]
    weight = np.array([np.hypot(each["re_per_s"], each["im_per_s"]) for each in moved])
    return np.asarray(0.8 + _WIDEST * weight / max(float(weight.max(initial=0.0)), 1e-300))


def _is_transformer(ends: Mapping[str, float]) -> bool:
    return any(abs(abs(ratio) - 1.0) > 1e-9 for ratio in ends.values())


def _draw_windings(axes: Axes, x: float, y: float) -> None:
    for shift in (-0.035, 0.035):
        axes.plot([x + shift], [y], "o", markersize=7, markerfacecolor="none", markeredgecolor="0.25", zorder=2)


def _draw_buses(axes: Axes, farm: Content, places: Places) -> None:
    for bus, volts in farm["network"]["buses_v"].items():
        if bus not in places.at:
            continue
        x, y = places.at[bus]
        axes.plot([x, x], [y - 0.28, y + 0.28], color="black", linewidth=2.2, zorder=3)
        if len(farm["devices"]) <= _NAMED:
            axes.annotate(
                f"{bus}, {volts / 1e3:g} kV", (x, y - 0.3), (0, 2), textcoords="offset points", fontsize=7, ha="center"
            )


def _draw_devices(axes: Axes, farm: Content, places: Places, mode: Content | None) -> None:
    for each in devices_of(farm, places, mode):
        x, _ = places.at[each.bus]
        size = 30.0 + _LARGEST * each.share
        axes.plot([x, each.x], [each.y, each.y], color="0.45", linewidth=0.8, zorder=1)
        axes.scatter([each.x], [each.y], s=size, color=WARNING if each.worse else DEVICE, alpha=0.85, zorder=4)
        if len(farm["devices"]) <= _NAMED:
            away = (4.0 + 0.5 * np.sqrt(size), -2)
            axes.annotate(each.text, (each.x, each.y), away, textcoords="offset points", fontsize=7)


class Placed(NamedTuple):
    """A device or damper in the diagram: where, on which bus, its share in the mode, what is said of it."""

    x: float
    y: float
    bus: str
    share: float
    worse: bool
    text: str


def devices_of(farm: Content, places: Places, mode: Content | None) -> list[Placed]:
    """Each device and damper to the right of its bus; several of one bus side by side."""
    found: list[Placed] = []
    for device in (*farm["devices"], *farm["dampers"]):
        part = {"share": 0.0, "re_per_s": 0.0} if mode is None else mode["devices"][device["name"]]
        x, y = places.at[device["bus"]]
        n = 1 + sum(each.bus == device["bus"] for each in found)
        power = device.get("active_power_out_w")
        told = f", {power / 1e6:.3g} MW" if power else ""
        text = f"{device['name']} {100.0 * part['share']:.0f} %{told}"
        found.append(Placed(x + 0.28 * n, y, device["bus"], part["share"], part["re_per_s"] > 0.0, text))
    return found


def _draw_source(axes: Axes, farm: Content, places: Places, mode: Content | None) -> None:
    x, y = places.at[farm["network"]["source_bus"]]
    r, reactance = farm["network"]["source_ohm"]
    width = _widths(farm, mode)[-1]  # the source's impedance is the last branch
    axes.plot([x - 0.42, x], [y, y], color="0.45", linewidth=width, zorder=1)
    axes.plot([x - 0.42], [y], "s", markersize=11, markerfacecolor="white", markeredgecolor=QUIET, zorder=3)
    text = f"source\n{r:.3g} + j{reactance:.4g} ohm"
    axes.annotate(text, (x - 0.42, y), (0, -18), textcoords="offset points", fontsize=7, ha="center", va="top")


def _title(farm: Content, mode: Content | None) -> str:
    if mode is None:
        return f"{farm['farm']}: {farm['verdict']}; no oscillating mode in the band"
    below, above = mode["seen_at_hz"]
    legend = "area: share; red: more of it, less damping; width of a branch: the mode moves with its impedance"
    place = f"mode at {below:.3g}/{above:.3g} Hz, {mode['sigma_per_s']:+.3g} 1/s"
    return f"{farm['farm']}: {farm['verdict']}; {place}\n{legend}"
