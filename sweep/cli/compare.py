"""Commands on several tables: compare (usable in the tests of a model library) and merge."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .shared import DIFFERENT, Force, WrongInput, check_new, check_plot, check_suffix, report_statuses
from .telling import remark, result

if TYPE_CHECKING:
    from ...identify.comparison import Comparison
    from ...identify.response import FrequencyResponse
    from ...identify.table.read import Table


def compare(
    first: Annotated[Path, typer.Argument(metavar="A.parquet", help="The table whose rows are compared.")],
    second: Annotated[Path, typer.Argument(metavar="B.parquet", help="The table that it is held against.")],
    tolerance: Annotated[
        float, typer.Option(min=0.0, help="Relative difference up to which rows are the same in any case.")
    ] = 1e-4,
    plot: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Both, and the difference: .png, .svg or .pdf.")
    ] = None,
) -> None:
    """Do two tables of one device agree within their uncertainty? Exit status 0 where they do, 6 where not."""
    from ...identify.comparison import compare as compared
    from ...identify.table.read import read_table

    check_plot(plot)
    pairs = list(_pairs(read_table(first), read_table(second)))
    found = [compared(a, b, tolerance) for a, b in pairs]
    agree = all(comparison.agrees for comparison in found)
    lines = [*map(_text, found), f"agree within their uncertainty: {'yes' if agree else 'no'}"]
    result("\n".join(lines), lambda: {"agree": agree, "tolerance": tolerance, "operating_points": _values(found)})
    if plot is not None:
        from ...identify.comparison_figure import plot_comparison

        worst = max(found, key=lambda comparison: (not comparison.agrees, float(comparison.relative.max())))
        plot_comparison(worst, plot, (first.name, second.name))
        remark(f"{plot}: {worst.op_a}{', the worst operating point' if len(found) > 1 else ''}")
    if not agree:
        raise typer.Exit(DIFFERENT)


def merge(
    tables: Annotated[list[Path], typer.Argument(metavar="TABLE.parquet...", help="Tables of one device.")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="TABLE.parquet", help="The table to write.")],
    force: Force = False,
) -> None:
    """Make one table of several of one device: operating points side by side, bands of one of them end to end."""
    from collections import Counter

    import numpy as np

    from ...identify.merging import merged
    from ...identify.table.read import read_table
    from ...identify.table.write import write_table

    check_new(output, force)
    check_suffix(output, ".parquet")
    responses, meta = merged([read_table(table) for table in tables], [table.name for table in tables])
    write_table(output, responses, meta)
    report_statuses(output, dict(Counter(str(status) for r in responses for status in np.asarray(r.status).tolist())))


def _pairs(a: Table, b: Table) -> Iterator[tuple[FrequencyResponse, FrequencyResponse]]:
    """Operating points of one name; the only ones of both tables in any case."""
    if len(a.op_ids) == len(b.op_ids) == 1:
        yield a.response(a.op_ids[0]), b.response(b.op_ids[0])
        return
    common = [op for op in a.op_ids if op in b.op_ids]
    if not common:
        raise WrongInput(f"no operating point has one name in both: {', '.join(a.op_ids)} and {', '.join(b.op_ids)}")
    for op in common:
        yield a.response(op), b.response(op)


def _text(comparison: Comparison) -> str:
    head = f"{'band Hz':>17}  {'rows':>4}  {'median':>8}  {'largest':>8}  {'dB':>7}  {'deg':>7}  {'chi2/n':>7}  agree"
    rows = [
        f"{band.low_hz:8.4g} {band.high_hz:8.4g}  {band.n_rows:4d}  {band.median:8.2g}  {band.largest:8.2g}  "
        f"{band.largest_db:7.2g}  {band.largest_deg:7.2g}  {_number(band.chi_squared_per_degree):>7}  "
        f"{'yes' if band.agrees else 'no'}"
        for band in comparison.bands
    ]
    worst = ", ".join(f"{relative:.2g} at {f:.4g} Hz" for f, relative in comparison.worst())
    n = int(comparison.interpolated.sum())
    notes = [f"largest differences: {worst}"]
    if n:
        notes.append(f"{n} of {len(comparison.f_hz)} rows are held against an interpolation of the second table")
    return "\n".join([f"{comparison.op_a} against {comparison.op_b}", head, *rows, *notes])


def _values(found: Sequence[Comparison]) -> list[dict[str, Any]]:
    """Comparisons as JSON has them."""
    return [
        {
            "op_a": comparison.op_a,
            "op_b": comparison.op_b,
            "agree": comparison.agrees,
            "rows": len(comparison.f_hz),
            "interpolated_rows": int(comparison.interpolated.sum()),
            "bands": [band._asdict() for band in comparison.bands],
            "worst": [{"f_hz": f, "relative": relative} for f, relative in comparison.worst()],
        }
        for comparison in found
    ]


def _number(value: float) -> str:
    return "-" if value != value else f"{value:.2g}"
