"""Bode plot of a table's admittance: magnitude and phase of the four elements, as a report wants it.

Panels stand as the elements stand in the matrix. matplotlib is imported when a figure is made.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ...plant.errors import SeqsweepError, place_of
from ..fit.adaptive import MIN_ROWS, interpolate
from ..response import FrequencyResponse
from ..table.format import TableError
from ..table.read import iter_responses, read_metadata
from ..uncertainty import NORMAL_95
from .asked import Look, as_asked
from .style import COLOURS, DASHES, WARNING, escaped, grid_lines, new_figure, opened_figure, write_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PLAIN = Look()
"""Admittance in pn, logarithmic."""

MAX_OVERLAID = 6
HEIGHT_IN = 7.0
_SHORT = 28
"""Letters of a name up to which three stand side by side in the legend."""

_TITLES = ("$Y_{pp}$", "$Y_{pn}$", "$Y_{np}$", "$Y_{nn}$")
_TITLES_DQ = ("$Y_{dd}$", "$Y_{dq}$", "$Y_{qd}$", "$Y_{qq}$")
_COMPONENTS = ("{0}(f)$", "conj ${0}(2f_1{{-}}f)$")
_DOUBTFUL: dict[str, Any] = {"linestyle": "none", "color": WARNING, "marker": "x", "markersize": 5}
_NOTHING: dict[str, Any] = {"linestyle": "none", "color": WARNING, "marker": "|", "markersize": 6}


class _Curve(NamedTuple):
    label: str
    response: FrequencyResponse
    colour: str
    dashes: Any
    between: tuple[np.ndarray, np.ndarray] | None


def bode(
    table: str | Path | FrequencyResponse | Sequence[FrequencyResponse],
    path: str | Path,
    op_id: str | None = None,
    look: Look = PLAIN,
) -> tuple[str, ...]:
    """Draw magnitude and phase of the four elements over f, to a file.

    Parameters
    ----------
    table : path, FrequencyResponse or several of them
        A table's file, or responses in the pn frame.
    path : path
        PNG, SVG or PDF by its suffix; replaced atomically.
    op_id : str, optional
        The operating point to draw. Without it up to `MAX_OVERLAID` are laid over each other; of
        more than that the first one is drawn.
    look : Look
        Admittance or impedance, pn or dq, and the axes.

    Returns
    -------
    tuple of str
        The operating points that were drawn.

    Raises
    ------
    SeqsweepError
        If the suffix is another one, or a response is not in the pn frame; nothing is written.
    TableError
        If the file is not a readable table, or has no such operating point; nothing is written.
    """
    meta, responses, total = _chosen(table, op_id)
    shown = [as_asked(response, look) for response in responses]
    write_figure(path, lambda: bode_figure(shown, _title(meta, responses, total), look))
    return tuple(str(response.meta["op_id"]) for response in responses)


def bode_figure(responses: Sequence[FrequencyResponse], title: str = "", look: Look = PLAIN) -> Figure:
    """The figure that `bode` writes, of responses that are as ``look`` asks."""
    figure = new_figure(HEIGHT_IN)
    draw_bode(panels(figure), responses, look)
    figure.suptitle(title, fontsize=10)
    return figure


def panels(figure: Figure) -> np.ndarray:
    """Axes (4, 2) for `draw_bode`: magnitude above phase, twice, as the elements stand in the matrix."""
    return np.asarray(figure.subplots(4, 2, sharex=True, sharey="row", gridspec_kw={"height_ratios": [3, 2, 3, 2]}))


def draw_bode(axes: np.ndarray, responses: Sequence[FrequencyResponse], look: Look = PLAIN) -> None:
    """Draw magnitude and phase of every response into axes (4, 2), and the legend into their figure.

    Raises
    ------
    SeqsweepError
        If a response is not in the frame of the look.
    """
    needed = "dq" if look.dq else "pn"
    if wrong := next((response.frame for response in responses if response.frame != needed), None):
        raise SeqsweepError(f"the plot shows the {needed} frame, a response is in {wrong!r}: convert it first")
    curves = [_Curve(_label(r), r, c, d, _certified(r)) for r, c, d in zip(responses, COLOURS, DASHES, strict=False)]
    for element in range(4):
        row, column = divmod(element, 2)
        _draw_element(axes[2 * row, column], axes[2 * row + 1, column], curves, element, look)
    for column in range(2):
        if not look.dq and look.axes != "linear":
            _mirror_axis(axes[0, column], responses)
        axes[3, column].set_xlabel(r"$|f - f_1|$ (Hz)" if look.dq else "f (Hz)")
        axes[3, column].xaxis.set_major_formatter(lambda f, _: f"{f:g}")
    _same_scale([axes[row, column] for row in (0, 2) for column in (0, 1)], responses, look)
    for row in range(4):
        axes[row, 0].set_ylabel("Phase (deg)" if row % 2 else _magnitude_label(look))
    _legend(axes[0, 0].figure, curves)


def draw_magnitudes(axes: Axes, response: FrequencyResponse) -> None:
    """Draw the magnitudes (S) of the four elements into one pair of axes; rows that are not ok are left out."""
    good = np.where(response.ok[:, None, None], response.y, complex(np.nan, np.nan)).reshape(-1, 4)
    for k, name in enumerate(_TITLES if response.frame == "pn" else _TITLES_DQ):
        axes.plot(response.f_hz, np.abs(good[:, k]), color=COLOURS[k], linestyle=DASHES[k], label=name)
    axes.set_xscale("log" if response.frame == "pn" else "symlog")
    axes.set_yscale("log")
    axes.set_xlabel("f (Hz)" if response.frame == "pn" else "$f - f_1$ (Hz)")
    axes.set_ylabel("Magnitude (S)")
    axes.legend(fontsize=8)
    grid_lines(axes)


def shown(responses: Sequence[FrequencyResponse], ax: Any = None) -> Any:
    """The responses drawn for a notebook: matplotlib axes, those of ``ax`` where they are given.

    Parameters
    ----------
    responses : sequence of FrequencyResponse
        Laid over each other, up to `MAX_OVERLAID`; a single one in the dq frame is drawn as magnitudes.
    ax : matplotlib axes or array (4, 2) of them, optional
        Where to draw: one pair of axes takes magnitudes, eight take the Bode plot. Without it a figure is opened.
    """
    if ax is None and any(response.frame != "pn" for response in responses):
        ax = opened_figure(0.5 * HEIGHT_IN).subplots()
    if ax is not None and not isinstance(ax, np.ndarray):
        for response in responses:
            draw_magnitudes(ax, response)
        return ax
    axes = panels(opened_figure(HEIGHT_IN)) if ax is None else ax
    draw_bode(axes, responses[:MAX_OVERLAID])
    return axes


# What is drawn


def _chosen(
    table: str | Path | FrequencyResponse | Sequence[FrequencyResponse], op_id: str | None
) -> tuple[Mapping[str, Any], list[FrequencyResponse], int]:
    """Metadata, the responses to draw, and how many there are; no more of a table is kept than is drawn."""
    if isinstance(table, str | Path):
        meta = read_metadata(table)
        names = [str(point.get("op_id")) for point in meta.get("operating_points", [])]
        responses: Iterator[FrequencyResponse] = iter_responses(table)
    else:
        given = [table] if isinstance(table, FrequencyResponse) else list(table)
        meta, names, responses = {}, [str(response.meta["op_id"]) for response in given], iter(given)
    if op_id is not None:
        place_of(op_id, names, "what is to be drawn", TableError)
        responses = (response for response in responses if response.meta["op_id"] == op_id)
    wanted = 1 if op_id is not None or len(names) > MAX_OVERLAID else len(names)
    return meta, list(islice(responses, wanted)), len(names)


def _title(meta: Mapping[str, Any], responses: Sequence[FrequencyResponse], total: int) -> str:
    plant = meta.get("plant")
    device = [str(plant["id"])] if isinstance(plant, Mapping) and "id" in plant else []
    if len(responses) == 1:
        of = f" ({total} in the table)" if total > 1 else ""
        return escaped(", ".join([*device, _label(responses[0])]) + of)
    return escaped(", ".join([*device, f"{len(responses)} operating points"]))


def _label(response: FrequencyResponse) -> str:
    power, voltage = response.meta.get("active_power_mw"), response.meta.get("terminal_voltage_pu")
    values = [f"{value:.4g} {unit}" for value, unit in ((power, "MW"), (voltage, "pu")) if value is not None]
    name = str(response.meta["op_id"])
    return f"{name}: {', '.join(values)}" if values else name


def _magnitude_label(look: Look) -> str:
    return f"Magnitude (dB re 1 {look.unit})" if look.axes == "db" else f"Magnitude ({look.unit})"


def _draw_element(magnitude: Axes, phase: Axes, curves: Sequence[_Curve], element: int, look: Look) -> None:
    magnitude.set_xscale("linear" if look.axes == "linear" else "log")
    magnitude.set_yscale("log" if look.axes == "log" else "linear")
    for curve in curves:
        dotted = len(curves) == 1 and len(curve.response) <= 200
        _draw_curve(magnitude, phase, curve, element, dotted, _SHOWN[look.axes])
    magnitude.set_title(_element_title(element, look), fontsize=9)
    phase.set_ylim(-190.0, 190.0)
    phase.set_yticks([-180, -90, 0, 90, 180])
    for axes in (magnitude, phase):
        grid_lines(axes)
        if not look.dq:
            _mark_fundamental(axes, curves, named=axes is magnitude)


def _element_title(element: int, look: Look) -> str:
    """The element, and in pn what it is: a current per voltage, or a voltage per current."""
    name = f"${look.symbol}_{{{look.elements[element]}}}$"
    if look.dq:
        return name
    row, column = divmod(element, 2)
    above, below = ("V", "I") if look.impedance else ("I", "V")
    parts = [("$" if k == 0 else "") + _COMPONENTS[k].format(letter) for k, letter in ((row, above), (column, below))]
    return f"{name}: {parts[0]} per {parts[1]}"


def _decibels(size: np.ndarray) -> np.ndarray:
    return np.asarray(20.0 * np.log10(size))


_SHOWN: dict[str, Callable[[np.ndarray], np.ndarray]] = {"log": np.asarray, "linear": np.asarray, "db": _decibels}
"""From a magnitude to what is drawn of it."""


def _draw_curve(
    magnitude: Axes,
    phase: Axes,
    curve: _Curve,
    element: int,
    dotted: bool,
    drawn: Callable[[np.ndarray], np.ndarray],
) -> None:
    """Rows, their 95 % intervals, and between them the certified interpolation where there is one."""
    response = curve.response
    f = np.asarray(response.f_hz)
    y = np.asarray(response.y).reshape(-1, 4)[:, element]
    good = np.where(response.ok, y, complex(np.nan, np.nan))
    good = np.where(good == 0.0, complex(np.nan, np.nan), good)  # has no place on a logarithmic axis, and no angle
    size, angle = np.abs(good), np.degrees(np.angle(good))
    of_size, of_angle = _half_intervals(response, element)
    line: dict[str, Any] = {"color": curve.colour, "linestyle": curve.dashes}
    fine_f, fine_y = _between(curve, element)
    fine_y = np.where(fine_y == 0.0, complex(np.nan, np.nan), fine_y)
    magnitude.plot(fine_f, drawn(np.abs(fine_y)), **line)
    phase.plot(*_without_streaks(fine_f, np.degrees(np.angle(fine_y))), **line)
    if dotted or _interpolated(response):
        dots: dict[str, Any] = {"color": curve.colour, "linestyle": "none", "marker": ".", "markersize": 3.5}
        magnitude.plot(f, drawn(size), **dots)
        phase.plot(f, angle, **dots)
    low = np.maximum(size - of_size, 1e-6 * size)
    magnitude.fill_between(f, drawn(low), drawn(size + of_size), color=curve.colour, alpha=0.22, linewidth=0.0)
    phase.errorbar(f, angle, yerr=of_angle, fmt="none", ecolor=curve.colour, elinewidth=0.6, alpha=0.5)
    _draw_not_ok(magnitude, phase, response, y, drawn)


def _half_intervals(response: FrequencyResponse, element: int) -> tuple[np.ndarray, np.ndarray]:
    """Half the 95 % intervals (n,) of magnitude (S) and phase (deg) of an element; NaN where they are unknown."""
    y = np.asarray(response.y).reshape(-1, 4)[:, element]
    block = np.asarray(response.covariance)[:, 2 * element : 2 * element + 2, 2 * element : 2 * element + 2]
    with np.errstate(invalid="ignore", divide="ignore"):
        outward = np.stack([y.real, y.imag], axis=1) / np.abs(y)[:, None]
        across = np.stack([-outward[:, 1], outward[:, 0]], axis=1)
        radial, tangential = (NORMAL_95 * np.sqrt(np.einsum("ni,nij,nj->n", u, block, u)) for u in (outward, across))
        return radial, np.degrees(np.arcsin(np.minimum(1.0, tangential / np.abs(y))))


def _interpolated(response: FrequencyResponse) -> bool:
    """Whether the sweep was adaptive: its rows are where they have to be for the interpolation, not for the eye."""
    return "interpolation" in response.meta


def _between(curve: _Curve, element: int) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (m,) and admittances (m,) of the line that is drawn through the rows of an element."""
    response, fine = curve.response, curve.between
    if fine is None:
        y = np.asarray(response.y).reshape(-1, 4)[:, element]
        return np.asarray(response.f_hz), np.where(response.ok, y, complex(np.nan, np.nan))
    return fine[0], fine[1].reshape(-1, 4)[:, element]


def _certified(response: FrequencyResponse) -> tuple[np.ndarray, np.ndarray] | None:
    """Frequencies (m,) and admittances (m, 2, 2) of an adaptive table's interpolation; None for other tables.

    Too close to f1 for the certificate the line has a gap.
    """
    if not _interpolated(response) or np.count_nonzero(response.usable) < MIN_ROWS:
        return None
    f_hz, f1_hz = np.asarray(response.f_hz), response.f1_hz
    nearest_hz = response.meta["interpolation"]["except_within_hz_of_f1"] or 1e-3 * f1_hz
    about_f1 = np.geomspace(nearest_hz, 0.5 * f1_hz, 200)
    fine = np.concatenate([f_hz, np.geomspace(f_hz[0], f_hz[-1], 1000), f1_hz - about_f1, [f1_hz], f1_hz + about_f1])
    fine = np.unique(fine[(fine >= f_hz[0]) & (fine <= f_hz[-1])])
    y = np.full((len(fine), 2, 2), complex(np.nan, np.nan))
    sure = np.abs(fine - f1_hz) >= nearest_hz * (1.0 - 1e-9)
    y[sure] = interpolate(response, fine[sure])
    return fine, y


def _draw_not_ok(
    magnitude: Axes,
    phase: Axes,
    response: FrequencyResponse,
    y: np.ndarray,
    drawn: Callable[[np.ndarray], np.ndarray],
) -> None:
    """Crosses where a value is there but not ok, ticks on the frequency axis where there is none."""
    f = np.asarray(response.f_hz)
    doubtful = ~response.ok & np.isfinite(y)
    nothing = ~response.ok & ~np.isfinite(y)
    magnitude.plot(f[doubtful], drawn(np.abs(y[doubtful])), **_DOUBTFUL)
    phase.plot(f[doubtful], np.degrees(np.angle(y[doubtful])), **_DOUBTFUL)
    for axes in (magnitude, phase):
        floor = np.full(nothing.sum(), 0.03)
        axes.plot(f[nothing], floor, transform=axes.get_xaxis_transform(), **_NOTHING)


def _same_scale(magnitudes: Sequence[Axes], responses: Sequence[FrequencyResponse], look: Look) -> None:
    """One range for all four elements, so that coupling shows at a glance; values decide it, not bands."""
    sizes = np.concatenate([np.abs(np.asarray(response.y)).ravel() for response in responses])
    sizes = sizes[np.isfinite(sizes) & (sizes > 0.0)]
    if len(sizes):
        for axes in magnitudes:
            axes.set_ylim(*_RANGES[look.axes](float(sizes.min()), float(sizes.max())))


_RANGES: dict[str, Callable[[float, float], tuple[float, float]]] = {
    "log": lambda low, high: (low / 2.0, high * 2.0),
    "db": lambda low, high: (20.0 * math.log10(low) - 6.0, 20.0 * math.log10(high) + 6.0),
    "linear": lambda low, high: (0.0, 1.05 * high),
}
"""Range of the axis of magnitudes from the least and the largest one."""


def _without_streaks(f: np.ndarray, angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where a phase within +-180 degrees crosses an end: run up to it, leave a gap, come in from the other."""
    jumps = np.flatnonzero(np.abs(np.diff(angle)) > 180.0)
    end = np.copysign(180.0, angle[jumps])
    share = (end - angle[jumps]) / (angle[jumps + 1] - angle[jumps] + 2.0 * end)
    at = f[jumps] * (f[jumps + 1] / f[jumps]) ** share
    places = np.repeat(jumps + 1, 3)
    gap = np.column_stack([end, np.full_like(end, np.nan), -end])
    return np.insert(f, places, np.repeat(at, 3)), np.insert(angle, places, gap.ravel())


# What helps to read it


def _mark_fundamental(axes: Axes, curves: Sequence[_Curve], named: bool) -> None:
    f1_hz = curves[0].response.f1_hz
    for f_hz, name in ((f1_hz, "$f_1$"), (2.0 * f1_hz, "$2f_1$")):
        axes.axvline(f_hz, color="0.35", linewidth=0.7, linestyle=(0, (2, 2)), zorder=1)
        if named:
            axes.annotate(
                name,
                (f_hz, 0.08),
                xycoords=("data", "axes fraction"),
                xytext=(2, 0),
                textcoords="offset points",
                fontsize=8,
                color="0.35",
            )


def _mirror_axis(axes: Axes, responses: Sequence[FrequencyResponse]) -> None:
    """Name, above some frequencies f, the signed frequency 2 f1 - f of the second component."""
    from matplotlib.ticker import NullLocator

    f1_hz = responses[0].f1_hz
    low = min(float(response.f_hz[0]) for response in responses)
    high = max(float(response.f_hz[-1]) for response in responses)
    decades = 10.0 ** np.arange(np.ceil(np.log10(low) - 1e-9), np.floor(np.log10(high) + 1e-9) + 1)
    ticks = sorted(
        {*decades.tolist(), f1_hz, 2.0 * f1_hz} & {f for f in (*decades, f1_hz, 2 * f1_hz) if low <= f <= high}
    )
    above = axes.secondary_xaxis("top")
    above.set_xticks(ticks, [_mirror_text(f, f1_hz) for f in ticks], fontsize=8)
    above.xaxis.set_minor_locator(NullLocator())
    above.set_xlabel("mirror $2f_1 - f$ (Hz)", fontsize=8)


def _mirror_text(f_hz: float, f1_hz: float) -> str:
    """2 f1 - f in words; what rounding leaves of zero is zero, not -7.9e-13."""
    mirror_hz = 2.0 * f1_hz - f_hz
    text = "0" if abs(mirror_hz) < 1e-9 * f1_hz else f"{mirror_hz:g}"
    return text.replace("-", "\N{MINUS SIGN}")


def _legend(figure: Figure, curves: Sequence[_Curve]) -> None:
    """One legend for all panels, holding only what is there to be seen."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles: list[Any] = []
    if any(c.between is not None for c in curves):
        sure = all(c.response.meta["interpolation"]["certified"] for c in curves if c.between is not None)
        label = "rows and certified interpolation" if sure else "rows and interpolation, not certified everywhere"
        handles.append(Line2D([], [], color=curves[0].colour, marker=".", markersize=5, label=label))
    if len(curves) > 1:
        handles += [Line2D([], [], color=c.colour, linestyle=c.dashes, label=escaped(c.label)) for c in curves]
    if any(np.isfinite(np.asarray(c.response.covariance)).any() for c in curves):
        handles.append(Patch(color=curves[0].colour, alpha=0.22, linewidth=0, label="95 % interval"))
    seen = [np.isfinite(np.asarray(c.response.y)[~c.response.ok]).all(axis=(1, 2)) for c in curves]
    if any(finite.any() for finite in seen):
        handles.append(Line2D([], [], label="not ok", **_DOUBTFUL))
    if any((~finite).any() for finite in seen):
        handles.append(Line2D([], [], label="not ok, no value", **_NOTHING))
    if handles:
        longest = max(len(str(handle.get_label())) for handle in handles)
        columns = 3 if longest <= _SHORT else 2 if longest <= 2 * _SHORT else 1
        where: dict[str, Any] = {"loc": "outside lower center", "ncols": columns}
        figure.legend(handles=handles, frameon=False, fontsize=8, handlelength=3.2, **where)
