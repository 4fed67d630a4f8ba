"""`seqsweep metrics`: what operators read from a scan, from a table alone."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .shared import Force, TableFile, check_outputs
from .telling import columns, result

if TYPE_CHECKING:
    from ...identify.table.read import Table
    from ...tuning.metrics import Metrics


def metrics(
    table: TableFile,
    behind: Annotated[
        str | None,
        typer.Option(metavar="GRID", help="Look from the source behind this grid: R+jX in ohm at f1, or a file."),
    ] = None,
    op: Annotated[list[str] | None, typer.Option(metavar="ID", help="Only this operating point; repeatable.")] = None,
    output: Annotated[Path | None, typer.Option("-o", "--output", metavar="METRICS.json", help="Write JSON.")] = None,
    plot: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Jacobian, frequency perturbation, passivity: .png, .svg, .pdf.")
    ] = None,
    force: Force = False,
) -> None:
    """How P and Q answer to the grid: Jacobian, frequency perturbation, swing fit, stiffness, passivity."""
    from ...identify.table.read import read_table
    from ...tuning.metrics_report import format_report, to_json, write_json

    check_outputs(output, force, plot, ".json")
    content = read_table(table)
    found = _of_table(content, behind, op)
    result(lambda: "\n\n".join(format_report(each, columns()) for each in found), lambda: to_json(found, content.meta))
    if output is not None:
        write_json(found, content.meta, output)
    if plot is not None:
        from ...tuning.metrics_figure import plot_metrics

        plot_metrics(found[0], plot)


def _of_table(content: Table, behind: str | None, op: list[str] | None) -> list[Metrics]:
    """The metrics of the chosen operating points, or of all."""
    from ...tuning.grids.open import open_grid
    from ...tuning.metrics import metrics as metrics_of

    grid = None if behind is None else open_grid(behind, content.meta["f1_hz"])
    bases = content.meta["bases"]
    rating = bases["rated_voltage_v"], bases["rated_power_va"]
    chosen = content.responses if not op else [content.response(op_id) for op_id in op]
    return [metrics_of(response, rating, grid) for response in chosen]
