"""The drawings of the pages that explain: ``python docs/site/drawings.py`` writes ``docs/figures/drawing-*.svg``.

Vector graphics, letters as outlines, so that they look the same everywhere and print at any size. They are 18 cm wide,
the width of the text on A4.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import matplotlib
import numpy as np

matplotlib.use("svg")
import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

FIGURES = Path(__file__).parents[1] / "figures"
BLUE, ORANGE, GREY, RED, GREEN = "#1f5fa8", "#c2571a", "#5f6670", "#b3261e", "#2e7d4f"
PALE = {BLUE: "#e3ecf7", ORANGE: "#fbe9dd", GREY: "#eef0f2", RED: "#f9e3e1", GREEN: "#e2f1e8"}
STYLE = {
    "svg.hashsalt": "seqsweep",
    "svg.fonttype": "path",
    "font.size": 9.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": GREY,
    "axes.labelcolor": "#20242a",
    "text.color": "#20242a",
}


def sheet(height: float) -> tuple[Figure, Axes]:
    """An empty sheet, 7.1 inches wide, one unit an inch."""
    figure = plt.figure(figsize=(7.1, height))
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set(xlim=(0, 7.1), ylim=(0, height))
    axes.axis("off")
    return figure, axes


def box(axes: Axes, x: float, y: float, size: tuple[float, float], text: str, colour: str = BLUE) -> None:
    """A box whose middle is (x, y)."""
    width, height = size
    place = (x - width / 2, y - height / 2)
    style = "round,pad=0,rounding_size=0.08"
    axes.add_patch(FancyBboxPatch(place, width, height, boxstyle=style, fc=PALE[colour], ec=colour, lw=1.2, zorder=3))
    axes.text(x, y, text, ha="center", va="center", linespacing=1.35, zorder=4)


def arrow(
    axes: Axes, start: tuple[float, float], end: tuple[float, float], colour: str = GREY, style: str = "-|>"
) -> None:
    """A straight arrow."""
    axes.add_patch(
        FancyArrowPatch(start, end, arrowstyle=style, mutation_scale=11, color=colour, lw=1.3, shrinkA=0, shrinkB=0)
    )


def bend(axes: Axes, points: list[tuple[float, float]], colour: str = GREY) -> None:
    """A line through points with an arrow at its end."""
    x, y = zip(*points[:-1], strict=True)
    axes.plot(x, y, color=colour, lw=1.3, solid_joinstyle="round")
    arrow(axes, points[-2], points[-1], colour)


def spectrum(
    figure: Figure, place: tuple[float, float, float, float], bars: dict[float, tuple[float, str, str]], title: str
) -> None:
    """Lines over the frequency: frequency to height, colour and name."""
    axes = figure.add_axes(place)
    for f, (height, colour, name) in bars.items():
        axes.plot([f, f], [0, height], color=colour, lw=5, solid_capstyle="butt")
        axes.text(f, height + 0.06, name, ha="center", color=colour)
    axes.axvline(50, color=GREY, lw=0.9, ls=(0, (3, 3)))
    axes.text(50, 1.46, "f1", ha="center", color=GREY)
    axes.set(xlim=(0, 100), ylim=(0, 1.45), yticks=[], xticks=[23, 50, 77])
    axes.spines["left"].set_visible(False)
    axes.tick_params(length=2.5, labelsize=8.5)
    axes.set_title(title, fontsize=9.5, pad=13)
    axes.set_xlabel("Hz", labelpad=1)


def two_by_two() -> Figure:
    """One tone goes in, two come out; two experiments make four elements."""
    figure, axes = sheet(4.6)
    v_forth = {77: (1.0, BLUE, "V(f)")}
    v_back = {23: (1.0, ORANGE, "V(2 f1 - f)")}
    i_forth = {77: (1.0, BLUE, "Ypp V"), 23: (0.55, BLUE, "conj(Ynp V)")}
    i_back = {23: (0.85, ORANGE, "conj(Ynn V*)"), 77: (0.5, ORANGE, "Ypn V*")}
    for k, (v, i, name) in enumerate([(v_forth, i_forth, "experiment 1"), (v_back, i_back, "experiment 2")]):
        low = (0.645, 0.285)[k]
        spectrum(figure, (0.05, low, 0.26, 0.21), v, f"{name}: voltage")
        spectrum(figure, (0.64, low, 0.31, 0.21), i, "current")
        y = (low + 0.105) * 4.6
        box(axes, 3.38, y, (1.35, 0.62), "converter\n(a closed box)", GREY)
        arrow(axes, (2.32, y), (2.68, y))
        arrow(axes, (4.08, y), (4.44, y))
    axes.text(
        3.55, 0.44,
        "[ I(f),  conj I(2 f1 - f) ]  =  Y  [ V(f),  conj V(2 f1 - f) ]\n"
        "two experiments, four equations: Ypp, Ypn, Ynp, Ynn",
        ha="center", va="center", linespacing=1.6, fontsize=10.5,
        bbox={"boxstyle": "round,pad=0.5", "fc": PALE[GREY], "ec": GREY},
    )  # fmt: skip
    return figure


def settle_and_branch() -> Figure:
    """The device is brought to rest once; every shot starts from there."""
    figure, axes = sheet(3.5)
    t = np.linspace(0, 2.3, 500)
    axes.plot(0.35 + t, 1.75 + 0.75 * np.exp(-1.9 * t) * np.cos(9 * t), color=GREY, lw=1.4)
    axes.text(1.5, 2.78, "settle once, and certify it:\ntwo blocks repeat to a millionth", ha="center", color=GREY)
    axes.plot([2.75], [1.75], "o", color=RED, ms=9, zorder=5)
    axes.annotate(
        "the state is kept",
        (2.75, 1.70),
        (2.1, 0.95),
        ha="center",
        color=RED,
        arrowprops={"arrowstyle": "-", "color": RED},
    )
    u = np.linspace(0, 1, 300)
    branches = [
        (2.95, 9, BLUE, "shot: tone at f"),
        (2.15, 5, ORANGE, "shot: tone at 2 f1 - f"),
        (1.35, 0, GREY, "unperturbed, to compare"),
        (0.55, 14, BLUE, "the next frequency ..."),
    ]
    for y, waves, colour, name in branches:
        axes.plot([2.82, 3.35], [1.75, y], color=colour, lw=1.1)
        grown = 1 - np.exp(-6 * u)
        axes.plot(3.35 + 1.75 * u, y + 0.2 * grown * np.sin(2 * np.pi * waves * u), color=colour, lw=1.3)
        axes.text(5.22, y, name, va="center", color=colour)
    axes.text(
        0.35,
        0.2,
        "A shot is heard until its windows agree; nothing that one shot does is seen by another.",
        color="#20242a",
    )
    return figure


def measurement_port() -> Figure:
    """Where damping control stands: between the measurement and the controller."""
    figure, axes = sheet(3.3)
    main = 2.55
    axes.plot([0.45, 5.15], [main, main], color="#20242a", lw=1.8)
    axes.plot([0.45], [main], "o", ms=13, mfc="white", mec="#20242a")
    axes.text(0.45, main + 0.26, "source", ha="center")
    box(axes, 1.35, main, (0.85, 0.4), "grid R + jX", GREY)
    axes.plot([2.35], [main], "o", color="#20242a", ms=6)
    axes.text(2.35, main + 0.2, "PCC", ha="center")
    box(axes, 3.35, main, (0.8, 0.4), "filter", GREY)
    box(axes, 5.55, main, (1.0, 0.6), "converter", GREY)
    arrow(axes, (2.35, main - 0.06), (2.35, 1.42), BLUE)
    axes.text(2.43, 2.0, "measured v, i", color=BLUE)
    box(axes, 2.35, 1.05, (1.5, 0.72), "damping control\nv + H_NF H_FB i", ORANGE)
    arrow(axes, (3.12, 1.05), (4.62, 1.05), ORANGE)
    axes.text(3.87, 1.15, "another voltage\nthan the PCC's", ha="center", color=ORANGE, va="bottom")
    box(axes, 5.55, 1.05, (1.8, 0.72), "controller\n(sealed; never opened)", BLUE)
    arrow(axes, (5.55, 1.42), (5.55, 2.24), BLUE)
    axes.text(5.63, 1.8, "gate signals", color=BLUE)
    axes.plot([3.87, 3.87], [0.28, 1.0], color=RED, lw=1.1, ls=(0, (4, 3)))
    axes.text(3.87, 0.14, "the measurement port: the one place where something is put in", ha="center", color=RED)
    return figure


def winding_number() -> Figure:
    """Turns of det(1 + YZ) about zero, counted from a grid on which the answer is known."""
    figure, (left, right) = plt.subplots(
        1, 2, figsize=(7.1, 3.7), gridspec_kw={"width_ratios": [1.15, 1]}, layout="constrained"
    )
    w = np.concatenate([-np.logspace(2, -3, 900), np.logspace(-3, 2, 900)])
    lag = 1.0 / (1.0 + 1j * w) ** 3
    for gain, colour, name in [(4.0, BLUE, "short line: no turn about zero"), (13.0, RED, "long line: two turns")]:
        locus = 1.0 + gain * lag
        left.plot(locus.real, locus.imag, color=colour, lw=1.6, label=name)
        for at in (324, 1468):
            ends = (locus.real[at + 8], locus.imag[at + 8]), (locus.real[at], locus.imag[at])
            look = {"arrowstyle": "-|>", "color": colour, "mutation_scale": 14, "shrinkA": 0, "shrinkB": 0}
            left.annotate("", *ends, arrowprops=look)
    left.plot([0], [0], "+", color="#20242a", ms=11, mew=1.8)
    left.annotate("zero", (0, 0), (0.6, 0.55), arrowprops={"arrowstyle": "-", "color": GREY}, color="#20242a")
    left.set(
        xlabel="real part of det(1 + Y Z)",
        ylabel="imaginary part",
        title="the turns are counted",
        xlim=(-2.6, 3.4),
        ylim=(-2.9, 2.9),
    )
    left.axhline(0, color=GREY, lw=0.5)
    left.axvline(0, color=GREY, lw=0.5)
    left.legend(loc="upper right", fontsize=8, framealpha=1.0, edgecolor="white")
    gains = np.linspace(0, 13, 200)
    roots = np.array([-1 + g ** (1 / 3) * np.exp(1j * np.pi / 3) for g in gains])
    right.axvspan(0, 0.6, color=PALE[RED])
    right.axvline(0, color=RED, lw=1.2)
    for sign in (1, -1):
        right.plot(roots.real, sign * roots.imag, color=GREY, lw=1.4)
        right.plot(roots.real[[61, -1]], sign * roots.imag[[61, -1]], "x", color=BLUE, ms=8, mew=2)
        right.plot(roots.real[-1:], sign * roots.imag[-1:], "x", color=RED, ms=8, mew=2)
    right.plot([-1], [0], "o", color=GREEN, ms=9)
    right.annotate(
        "the anchor: no grid,\nseen at rest",
        (-1, 0),
        (-1.3, -2.2),
        color=GREEN,
        arrowprops={"arrowstyle": "-", "color": GREEN},
    )
    right.text(-0.72, 1.62, "the line\ngrows", color=GREY)
    right.text(0.03, -2.35, "unstable", color=RED)
    right.set(
        xlim=(-1.35, 0.6),
        ylim=(-2.5, 2.5),
        xlabel="growth (1/s)",
        ylabel="frequency (rad/s)",
        title="from a known point onwards",
    )
    return figure


def uncertainty() -> Figure:
    """What every step adds to the error, and what is stated at its end."""
    figure, axes = sheet(3.55)
    steps = [
        ("record\nv, i", "noise, ripple,\ntransducers (*)", GREY),
        ("phasors\nV, I", "windows that do\nnot yet agree", BLUE),
        ("a row\nY and cov", "distortion;\ncond(V)", BLUE),
        ("model\nY(s)", "rows too far apart;\nthe order", ORANGE),
        ("mode, m\nand verdict", "grid taken as\nexact (*)", GREEN),
    ]
    x = np.linspace(0.8, 6.3, len(steps))
    for k, (name, adds, colour) in enumerate(steps):
        box(axes, x[k], 2.45, (1.0, 0.7), name, colour)
        if k:
            arrow(axes, (x[k - 1] + 0.52, 2.45), (x[k] - 0.52, 2.45))
        axes.text(x[k], 1.42, adds, ha="center", va="center", color=RED, fontsize=8.8, linespacing=1.3)
        arrow(axes, (x[k], 1.66), (x[k], 2.08), RED)
    said = ["", "residual", "cov, linearity,\nstatus", "misfit,\n+- of poles", "95 % intervals,\nprobability"]
    for place, text in zip(x, said, strict=True):
        axes.text(place, 3.14, text, ha="center", va="center", color=BLUE, fontsize=8.8)
    axes.text(0.22, 3.42, "what is said of it", color=BLUE, fontsize=8.8)
    axes.text(0.22, 1.0, "what comes in", color=RED, fontsize=8.8)
    axes.text(
        3.55,
        0.42,
        "(*) is in no interval: what a transducer did, what all experiments share,\n"
        "and a grid that is not the one that was named.",
        ha="center",
        va="center",
        fontsize=9,
        linespacing=1.4,
    )
    return figure


def turbine() -> Figure:
    """The reference turbine from the rotor to the grid, and what its controls measure."""
    figure, axes = sheet(2.75)
    y = 1.95
    axes.plot([0.4, 6.75], [y, y], color="#20242a", lw=1.8)
    box(axes, 0.62, y, (0.8, 0.62), "rotor and\nPMSG", GREY)
    box(axes, 1.78, y, (0.95, 0.62), "machine-side\nconverter", GREY)
    box(axes, 2.8, y, (0.62, 0.62), "DC link\nC", GREY)
    box(axes, 3.8, y, (0.9, 0.62), "grid-side\nconverter", GREY)
    box(axes, 4.75, y, (0.45, 0.4), "Lc", GREY)
    axes.plot([5.45, 5.45], [y, 1.5], color="#20242a", lw=1.5)
    box(axes, 5.45, 1.28, (0.62, 0.44), "Rf, Cf", GREY)
    axes.plot([5.45, 6.05], [y, y], "o", color="#20242a", ms=5)
    axes.text(6.05, y + 0.16, "PCC", ha="center")
    box(axes, 6.6, y, (0.62, 0.44), "source", GREY)
    arrow(axes, (5.02, y + 0.32), (5.38, y + 0.32))
    axes.text(5.2, y + 0.4, "i_L", ha="center")
    box(axes, 3.8, 0.62, (1.9, 0.72), "PLL, DC voltage,\ncurrent control", BLUE)
    arrow(axes, (3.8, 0.98), (3.8, y - 0.31), BLUE)
    bend(axes, [(2.8, y - 0.31), (2.8, 0.78), (2.85, 0.78)], BLUE)
    axes.text(2.72, 1.2, "v_dc", color=BLUE, ha="right")
    bend(axes, [(6.05, y), (6.05, 0.62), (4.75, 0.62)], BLUE)
    axes.text(6.0, 0.7, "v of the PCC, i_L", color=BLUE, ha="right")
    box(axes, 1.3, 0.62, (1.5, 0.72), "torque law (MPPT),\ncurrent control", BLUE)
    arrow(axes, (1.6, 0.98), (1.6, y - 0.31), BLUE)
    return figure


def recording() -> Figure:
    """Where a device elsewhere is perturbed, what is recorded, and which way the current counts."""
    figure, axes = sheet(2.6)
    y = 1.55
    axes.plot([0.5, 6.0], [y, y], color="#20242a", lw=1.8)
    box(axes, 0.62, y, (0.8, 0.5), "source", GREY)
    axes.plot([1.85], [y], "o", ms=26, mfc=PALE[ORANGE], mec=ORANGE, zorder=3)
    axes.text(1.85, y, "~", ha="center", va="center", fontsize=15, color=ORANGE, zorder=4)
    axes.text(1.85, y + 0.36, "the waveform\nthat inject wrote", ha="center", color=ORANGE, linespacing=1.2)
    box(axes, 3.0, y, (0.75, 0.4), "R, X", GREY)
    axes.plot([4.1], [y], "o", color="#20242a", ms=6)
    axes.text(4.1, y + 0.2, "terminals", ha="center")
    box(axes, 6.1, y, (1.3, 0.62), "your device", GREY)
    arrow(axes, (4.45, y + 0.18), (5.25, y + 0.18), BLUE)
    axes.text(4.85, y + 0.27, "load", ha="center", color=BLUE)
    arrow(axes, (5.25, y - 0.18), (4.45, y - 0.18), RED)
    axes.text(4.85, y - 0.4, "generator", ha="center", color=RED)
    box(axes, 4.1, 0.5, (1.9, 0.5), "recorder: 3 voltages,\n3 currents", BLUE)
    arrow(axes, (4.1, y - 0.06), (4.1, 0.76), BLUE)
    arrow(axes, (3.12, 0.5), (2.55, 0.5), BLUE)
    axes.text(2.48, 0.5, "identify  ->  y.parquet", ha="right", va="center", color=BLUE)
    axes.text(
        5.3, 0.5, "--direction says which way\nthe current was counted", va="center", color="#20242a", linespacing=1.3
    )
    return figure


def black_boxes() -> Figure:
    """Six ways in, one promise, one table."""
    figure, axes = sheet(3.3)
    ways = [
        ("a step function", "python:"),
        ("a Python object", "python:"),
        ("a program", "process:"),
        ("an FMU", "fmu:"),
        ("a vendor's library", "cigre:"),
        ("recordings", "identify"),
    ]
    heights = np.linspace(2.95, 0.35, len(ways))
    for height, (name, word) in zip(heights, ways, strict=True):
        colour = ORANGE if word == "identify" else GREY
        box(axes, 0.98, height, (1.6, 0.4), name, colour)
        if word != "identify":
            bend(axes, [(1.78, height), (2.45, height), (2.9, 1.95 + 0.12 * (height - 1.95))])
            axes.text(1.86, height + 0.05, word, color=GREY, fontsize=8.5)
    box(axes, 3.65, 1.95, (1.5, 1.0), "one promise:\nsettle once,\nbranch many times", BLUE)
    box(axes, 5.4, 1.95, (1.0, 0.6), "sweep", BLUE)
    arrow(axes, (4.4, 1.95), (4.9, 1.95))
    box(axes, 6.55, 1.15, (0.9, 0.7), "table\nY, cov", GREEN)
    bend(axes, [(5.9, 1.95), (6.55, 1.95), (6.55, 1.5)])
    bend(axes, [(1.78, heights[-1]), (6.55, heights[-1]), (6.55, 0.8)], ORANGE)
    axes.text(
        3.65, heights[-1] + 0.08, "identify: nothing is driven, and the same table comes out", color=ORANGE, ha="center"
    )
    return figure


DRAWINGS: dict[str, Callable[[], Figure]] = {
    "two-by-two": two_by_two,
    "settle-and-branch": settle_and_branch,
    "measurement-port": measurement_port,
    "winding-number": winding_number,
    "uncertainty": uncertainty,
    "turbine": turbine,
    "recording": recording,
    "black-boxes": black_boxes,
}


def main() -> None:
    """Draw all of them."""
    with plt.rc_context(STYLE):
        for name, draw in DRAWINGS.items():
            figure = draw()
            figure.savefig(FIGURES / f"drawing-{name}.svg", metadata={"Date": None})
            plt.close(figure)


if __name__ == "__main__":
    main()
