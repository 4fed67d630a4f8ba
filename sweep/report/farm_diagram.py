"""The one-line diagram of a farm with its critical mode drawn on it: who takes part, and which branch counts.

The network is laid out as a tree from the source's bus; what closes a loop is dashed. A device is a circle whose area
is its share in the mode, red where more of it makes the mode less damped; a branch is as wide as the mode moves with
its impedance.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ...identify.views.style import DEVICE, QUIET, WARNING, new_figure, write_figure
from ...tuning.farm.farm import Farm
from ...tuning.farm.participation import ModeParts
from ...tuning.network.assembly import GROUND, Branch

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


def plot_diagram(path: str | Path, farm: Farm) -> None:
    """Draw the diagram and write it; see `write_figure`."""
    write_figure(path, lambda: diagram_figure(farm))


def diagram_figure(farm: Farm) -> Figure:
    """The one-line diagram."""
    places = laid_out(farm)
    rows = 1.0 + max(y for _, y in places.at.values())
    figure = new_figure(float(np.clip(0.45 * rows + 1.2, 2.4, 9.0)))
    axes = figure.subplots()
    mode = farm.judgement.critical
    _draw_branches(axes, farm, places, mode)
    _draw_buses(axes, farm, places)
    _draw_devices(axes, farm, places, mode)
    _draw_source(axes, farm, places, mode)
    axes.set_title(_title(farm, mode), fontsize=9.0)
    axes.set_axis_off()
    axes.margins(x=0.06, y=0.12)
    axes.invert_yaxis()
    return figure


def laid_out(farm: Farm) -> Places:
    """A tree from the source's bus: depth to the right, leaves one below the other."""
    children: dict[str, list[str]] = {}
    tree, seen, queue = set(), {farm.entry.source_bus}, [farm.entry.source_bus]
    ends = {k: _ends(branch) for k, branch in enumerate(farm.entry.network.branches)}
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
    return Places(_placed(farm.entry.source_bus, children), frozenset(tree))


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


def _ends(branch: Branch) -> list[str]:
    return [name for name in branch.ends if name != GROUND]


def _draw_branches(axes: Axes, farm: Farm, places: Places, mode: ModeParts | None) -> None:
    widths = _widths(farm, mode)
    for k, branch in enumerate(farm.entry.network.branches):
        nodes = _ends(branch)
        if len(nodes) == 2:
            (x0, y0), (x1, y1) = places.at[nodes[0]], places.at[nodes[1]]
            style = "-" if k in places.tree else (0, (4, 2))
            axes.plot([x0, x1], [y0, y1], color="0.45", linewidth=widths[k], linestyle=style, zorder=1)
            if _is_transformer(branch):
                _draw_windings(axes, (x0 + x1) / 2.0, (y0 + y1) / 2.0)


def _widths(farm: Farm, mode: ModeParts | None) -> np.ndarray:
    """(b,) points: by how much the mode moves with each branch's impedance."""
    if mode is None:
        return np.full(len(farm.entry.network.branches), 0.8)
    weight = np.abs(mode.branches)
    return np.asarray(0.8 + _WIDEST * weight / max(float(weight.max(initial=0.0)), 1e-300))


def _source_branch(farm: Farm) -> int:
    """The source's impedance is the last branch of the farm's network."""
    return len(farm.entry.network.branches) - 1


def _is_transformer(branch: Branch) -> bool:
    return any(abs(abs(ratio) - 1.0) > 1e-9 for name, ratio in branch.ends.items() if name != GROUND)


def _draw_windings(axes: Axes, x: float, y: float) -> None:
    for shift in (-0.035, 0.035):
        axes.plot([x + shift], [y], "o", markersize=7, markerfacecolor="none", markeredgecolor="0.25", zorder=2)


def _draw_buses(axes: Axes, farm: Farm, places: Places) -> None:
    for bus, kv in farm.entry.voltages_v.items():
        if bus not in places.at:
            continue
        x, y = places.at[bus]
        axes.plot([x, x], [y - 0.28, y + 0.28], color="black", linewidth=2.2, zorder=3)
        if len(farm.units) <= _NAMED:
            axes.annotate(
                f"{bus}, {kv / 1e3:g} kV", (x, y - 0.3), (0, 2), textcoords="offset points", fontsize=7, ha="center"
            )


def _draw_devices(axes: Axes, farm: Farm, places: Places, mode: ModeParts | None) -> None:
    """Each device to the right of its bus; several of one bus side by side."""
    shares = np.zeros(len(farm.system.units)) if mode is None else mode.shares
    placed: dict[str, int] = {}
    for k, unit in enumerate(farm.system.units):
        n = placed[unit.bus] = placed.get(unit.bus, 0) + 1
        x, y = places.at[unit.bus]
        at = x + 0.28 * n
        worse = mode is not None and mode.devices[k].real > 0.0
        axes.plot([x, at], [y, y], color="0.45", linewidth=0.8, zorder=1)
        axes.scatter([at], [y], s=30.0 + _LARGEST * shares[k], color=WARNING if worse else DEVICE, alpha=0.85, zorder=4)
        if len(farm.units) <= _NAMED:
            power = f", {-unit.power_va.real / 1e6:.3g} MW" if unit.power_va else ""
            text = f"{unit.name} {100.0 * shares[k]:.0f} %{power}"
            away = 4.0 + 0.5 * np.sqrt(30.0 + _LARGEST * shares[k])
            axes.annotate(text, (at, y), (away, -2), textcoords="offset points", fontsize=7)


def _draw_source(axes: Axes, farm: Farm, places: Places, mode: ModeParts | None) -> None:
    x, y = places.at[farm.entry.source_bus]
    z = farm.entry.source_z_ohm
    width = _widths(farm, mode)[_source_branch(farm)]
    axes.plot([x - 0.42, x], [y, y], color="0.45", linewidth=width, zorder=1)
    axes.plot([x - 0.42], [y], "s", markersize=11, markerfacecolor="white", markeredgecolor=QUIET, zorder=3)
    text = f"source\n{z.real:.3g} + j{z.imag:.4g} ohm"
    axes.annotate(text, (x - 0.42, y), (0, -18), textcoords="offset points", fontsize=7, ha="center", va="top")


def _title(farm: Farm, mode: ModeParts | None) -> str:
    if mode is None:
        return f"{farm.entry.name}: {farm.judgement.verdict}; no oscillating mode in the band"
    nu, f1 = mode.pole.imag / (2.0 * np.pi), farm.entry.f1_hz
    legend = "area: share; red: more of it, less damping; width of a branch: the mode moves with its impedance"
    place = f"mode at {f1 - nu:.3g}/{f1 + nu:.3g} Hz, {mode.pole.real:+.3g} 1/s"
    return f"{farm.entry.name}: {farm.judgement.verdict}; {place}\n{legend}"
