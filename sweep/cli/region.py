"""The command `surrogate`: Y at any operating point of a swept region, and the worst of them on a grid."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .anywhere import Parameter, checked_voltage, model_of, named_value
from .shared import Force, TableFile, WrongInput, check_outputs, check_plot
from .telling import remark, result

if TYPE_CHECKING:
    import numpy as np

    from ...identify.surrogate.surrogate import Surrogate
    from ...identify.table.read import Table
    from ...tuning.region.worst import Worst


def surrogate(
    table: TableFile,
    at: Annotated[
        list[str] | None,
        typer.Option(metavar="P,Q,V[,NAME=VALUE]", help="Operating point (MW, Mvar, pu) to predict; repeatable."),
    ] = None,
    grid: Annotated[
        str | None, typer.Option(metavar="R+jX", help="Grid (ohm at f1) to search the worst point on.")
    ] = None,
    source_voltage: Annotated[
        float | None,
        typer.Option(
            metavar="PU",
            callback=checked_voltage,
            help="Source voltage behind the grid: |v| then follows by load flow.",
        ),
    ] = None,
    parameter: Parameter = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="FILE.parquet", help="The surrogate, or with --at a table.")
    ] = None,
    plot: Annotated[Path | None, typer.Option(metavar="FILE", help="Map of the region: .png, .svg or .pdf.")] = None,
    progress: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Picture of the doubt over the number of sweeps.")
    ] = None,
    force: Force = False,
) -> None:
    """Y at any operating point between the swept ones, how sure it is, and the worst point on a grid."""
    from ...identify.table.read import read_table

    if source_voltage is not None and grid is None:
        raise WrongInput("--source-voltage is that of a grid: give --grid R+jX as well")
    check_outputs(output, force, plot, ".parquet")
    content = read_table(table)
    check_plot(progress)
    if progress is not None and "history" not in content.meta.get("region", {}):
        raise WrongInput(f"{table}: --progress is drawn of a table whose campaign chose its operating points")
    model = model_of(content, parameter)
    points = [_point(text, model) for text in at or ()]
    asked = [_line(model, point) for point in points]  # a point outside is refused before anything is searched
    worst = None if grid is None else _worst(model, grid, source_voltage)
    of_worst = [] if worst is None else _worst_lines(model, worst, source_voltage)
    doubts = _doubts(model, content)
    result("\n".join([_summary(model), *doubts, *of_worst, *asked]), lambda: _values(model, points, worst))
    if output is not None:
        _write(model, content, points, output)
    if plot is not None:
        from ..region.figure import plot_map

        plot_map(plot, model, worst)
    if progress is not None:
        from ..region.figure import plot_progress

        plot_progress(progress, content.meta["region"])


def _point(text: str, model: Surrogate) -> np.ndarray:
    """An operating point: P, Q and V, and NAME=VALUE for every parameter that is still an axis."""
    import numpy as np

    parts = text.split(",")
    try:
        values = [float(part) for part in parts if "=" not in part]
    except ValueError:
        values = []
    if len(values) != 3:
        raise WrongInput(f"--at {text!r}: needed are three numbers P,Q,V in MW, Mvar and pu, such as 0.65,0,1.0")
    further = dict(named_value(part) for part in parts if "=" in part)
    return model.region.fixed(further).complete(np.array(values))[0]


def _summary(model: Surrogate) -> str:
    from ...identify.surrogate.region import told

    bar, where = model.worst_bar
    region = "; ".join(
        f"{axis} {low:g} to {high:g}" if high > low else f"{axis} {low:g}"
        for axis, low, high in zip(model.region.axes, model.region.low, model.region.high, strict=True)
    )
    shape = model.models[0].shape
    jump = "" if model.border is None else f"\nthe device changes between {model.border}: nothing is said there"
    return (
        f"{len(model.points)} operating points, {len(model.nu_hz)} frequencies; {region}\n"
        f"model: {len(shape.numerator)} products over {1 + len(shape.denominator)}\n"
        f"95 % radius of Y, relative: at most {bar:.2g}, at {told(where, model.region.parameters)}{jump}"
    )


def _doubts(model: Surrogate, content: Table) -> list[str]:
    """What speaks against the surrogate: operating points that it does without, another unit, sweeps that do not
    belong together."""
    from ...identify.surrogate.store import left_out, voltages_in_kv

    lost, unit = left_out(content), voltages_in_kv(content)
    lines = [*([f"left out: {lost}"] if lost else []), *([unit] if unit else [])]
    if model.contradiction:
        lines.append(
            f"The sweeps contradict each other: left out, one is missed by {100.0 * model.contradiction:.0f} % of Y. "
            "Two devices in one table, a device that changes by something else than its operating point, or far too "
            "few sweeps; nothing here can be relied on."
        )
    return lines


def _line(model: Surrogate, point: np.ndarray) -> str:
    relative = model.evaluate(point).relative[0]
    where = ", ".join([*(f"{v:g}" for v in point[:3]), *map("{}={:g}".format, model.region.parameters, point[3:])])
    at = int(relative.argmax())
    return f"({where}): 95 % radius of Y at most {relative[at]:.2g} (at |f - f1| = {model.nu_hz[at]:.4g} Hz)"


def _worst(model: Surrogate, text: str, source_voltage: float | None) -> Worst:
    from ...tuning.region.worst import worst_point
    from ...tuning.siso import parse_grid

    rated = model.meta["bases"].get("rated_voltage_v")
    return worst_point(model, parse_grid(text, model.f1_hz), source_voltage, rated)


def _worst_lines(model: Surrogate, worst: Worst, source_voltage: float | None) -> list[str]:
    """The worst operating point in words."""
    from ...identify.surrogate.region import told

    critical = worst.tuning.stability.critical if worst.tuning.stability else None
    margin = "no crossing" if critical is None else f"m = {critical.m:.4g} at {critical.f_hz:.4g} Hz"
    where = told(worst.point, model.region.parameters)
    how = "Points whose |v| would leave the swept range are left out."
    if source_voltage is None and model.region.varies[2]:
        how = "|v| was searched over its range like the powers; with --source-voltage it follows from the grid."
    return [
        f"worst operating point {where}: {worst.tuning.verdict}, {margin}",
        "It is a prediction: sweep that point and tune it before it decides anything.",
        how,
    ]


def _values(model: Surrogate, points: list[np.ndarray], worst: Worst | None) -> dict[str, Any]:
    """What the command says, as JSON has it."""
    bar, where = model.worst_bar
    critical = worst.tuning.stability.critical if worst is not None and worst.tuning.stability else None
    return {
        "operating_points": len(model.points),
        "frequencies": len(model.nu_hz),
        "region": {"axes": model.region.axes, "low": model.region.low, "high": model.region.high},
        "radius_95": bar,
        "radius_95_at": where,
        "at": [{"point": p, "radius_95": float(model.evaluate(p).relative[0].max())} for p in points],
        "worst": None
        if worst is None
        else {
            "point": worst.point,
            "verdict": worst.tuning.verdict,
            "margin_m": None if critical is None else critical.m,
            "f_hz": None if critical is None else critical.f_hz,
        },
    }


def _write(model: Surrogate, content: Table, points: list[np.ndarray], output: Path) -> None:
    from ...identify.surrogate.predicted import write_predicted
    from ...identify.surrogate.store import write_surrogate

    if points:
        write_predicted(output, model, points, content)
        remark(f"{output}: {len(points)} predicted operating point{'' if len(points) == 1 else 's'}")
        return
    write_surrogate(output, model, content)
    remark(f"{output}: the surrogate with the sweeps that it rests on")
