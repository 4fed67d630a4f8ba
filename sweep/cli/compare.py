"""The command `compare`: do two tables agree within their uncertainty; usable in the tests of a model library."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .say import say
from .shared import DIFFERENT, WrongInput

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
) -> None:
    """Do two tables of one device agree within their uncertainty? Exit status 0 where they do, 6 where not."""
    from ...identify.comparison import compare as compared
    from ...identify.table.read import read_table

    pairs = list(_pairs(read_table(first), read_table(second)))
    found = [compared(a, b, tolerance) for a, b in pairs]
    for comparison in found:
        say(_text(comparison))
    agree = all(comparison.agrees for comparison in found)
    say(f"agree within their uncertainty: {'yes' if agree else 'no'}")
    if not agree:
        raise typer.Exit(DIFFERENT)


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


def _number(value: float) -> str:
    return "-" if value != value else f"{value:.2g}"
