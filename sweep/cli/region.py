"""The command `surrogate`: Y at any operating point of a swept region, and the worst of them on a grid."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .shared import Force, TableFile, WrongInput, check_outputs
from .telling import remark, result

if TYPE_CHECKING:
    import numpy as np

    from ...identify.surrogate.surrogate import Surrogate
    from ...tuning.region.worst import Worst


def surrogate(
    table: TableFile,
    at: Annotated[
        list[str] | None, typer.Option(metavar="P,Q,V", help="Operating point (MW, Mvar, pu) to predict; repeatable.")
    ] = None,
    grid: Annotated[
        str | None, typer.Option(metavar="R+jX", help="Grid (ohm at f1) to search the worst point on.")
    ] = None,
    source_voltage: Annotated[
        float | None, typer.Option(metavar="PU", help="Source voltage behind the grid: |v| then follows by load flow.")
    ] = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="FILE.parquet", help="The surrogate, or with --at a table.")
    ] = None,
    plot: Annotated[Path | None, typer.Option(metavar="FILE", help="Map of the region: .png, .svg or .pdf.")] = None,
    force: Force = False,
) -> None:
    """Y at any operating point between the swept ones, how sure it is, and the worst point on a grid."""
    from ...identify.surrogate.store import read_surrogate

    if source_voltage is not None and grid is None:
        raise WrongInput("--source-voltage is that of a grid: give --grid R+jX as well")
    check_outputs(output, force, plot, ".parquet")
    points = [_point(text) for text in at or ()]
    model = read_surrogate(table)
    asked = [_line(model, point) for point in points]  # a point outside is refused before anything is searched
    worst = None if grid is None else _worst(model, table, grid, source_voltage)
    of_worst = [] if worst is None else _worst_lines(model, worst, source_voltage)
    result("\n".join([_summary(model), *of_worst, *asked]), lambda: _values(model, points, worst))
    if output is not None:
        _write(model, table, points, output)
    if plot is not None:
        from ..region.figure import plot_map

        plot_map(plot, model, worst)


def _point(text: str) -> np.ndarray:
    import numpy as np

    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) != 3:
        raise WrongInput(f"--at {text!r}: needed are three numbers P,Q,V in MW, Mvar and pu, such as 0.65,0,1.0")
    return np.array(values)


def _summary(model: Surrogate) -> str:
    from ...identify.surrogate.surrogate import AXES

    bar, where = model.worst_bar
    region = "; ".join(
        f"{axis} {low:g} to {high:g}" if high > low else f"{axis} {low:g}"
        for axis, low, high in zip(AXES, model.region.low, model.region.high, strict=True)
    )
    shape = model.models[0].shape
    jump = "" if model.border is None else f"\nthe device changes between {model.border}: nothing is said there"
    at = ", ".join(f"{value:.4g}" for value in where)
    return (
        f"{len(model.points)} operating points, {len(model.nu_hz)} frequencies; {region}\n"
        f"model: {len(shape.numerator)} products over {1 + len(shape.denominator)}\n"
        f"95 % radius of Y, relative: at most {bar:.2g}, at (P, Q, |v|) = ({at}){jump}"
    )


def _line(model: Surrogate, point: np.ndarray) -> str:
    relative = model.evaluate(point).relative[0]
    where = ", ".join(f"{value:g}" for value in point)
    at = int(relative.argmax())
    return f"({where}): 95 % radius of Y at most {relative[at]:.2g} (at |f - f1| = {model.nu_hz[at]:.4g} Hz)"


def _worst(model: Surrogate, table: Path, text: str, source_voltage: float | None) -> Worst:
    from ...identify.table.read import read_metadata
    from ...tuning.region.worst import worst_point
    from ...tuning.siso import parse_grid

    rated = read_metadata(table)["bases"]["rated_voltage_v"]
    return worst_point(model, parse_grid(text, model.f1_hz), source_voltage, rated)


def _worst_lines(model: Surrogate, worst: Worst, source_voltage: float | None) -> list[str]:
    """The worst operating point in words."""
    critical = worst.tuning.stability.critical if worst.tuning.stability else None
    margin = "no crossing" if critical is None else f"m = {critical.m:.4g} at {critical.f_hz:.4g} Hz"
    where = ", ".join(f"{value:.4g}" for value in worst.point)
    how = "Points whose |v| would leave the swept range are left out."
    if source_voltage is None and model.region.varies[2]:
        how = "|v| was searched over its range like the powers; with --source-voltage it follows from the grid."
    return [
        f"worst operating point (P, Q, |v|) = ({where}): {worst.tuning.verdict}, {margin}",
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
        "region": {"low": model.region.low, "high": model.region.high},
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


def _write(model: Surrogate, table: Path, points: list[np.ndarray], output: Path) -> None:
    from ...identify.surrogate.predicted import write_predicted
    from ...identify.surrogate.store import write_surrogate
    from ...identify.table.read import read_table

    content = read_table(table)
    if points:
        write_predicted(output, model, points, content)
        remark(f"{output}: {len(points)} predicted operating point{'' if len(points) == 1 else 's'}")
        return
    write_surrogate(output, model, content)
    remark(f"{output}: the surrogate with the sweeps that it rests on")
