"""The command for a bank of grids: judge."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .anywhere import Asked, Parameter, Power, SourceVoltage, is_surrogate, model_of, powers_of
from .shared import NOT_ALL_OK, Elements, Force, StableOn, TableFile, check_outputs
from .telling import columns, remark, results

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from ...identify.response import FrequencyResponse
    from ..bank.following import Following
    from ..bank.pairs import Pairs

LINE_S = 5.0
"""Seconds between lines of progress."""


def judge(
    table: TableFile,
    grids: Annotated[
        Path, typer.Option(metavar="BANK", help="A folder, a family.toml, a Parquet file, or one file of a grid.")
    ],
    op: Annotated[list[str] | None, typer.Option(metavar="ID", help="Only this operating point; repeatable.")] = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="JUDGE.parquet", help="Write one row per pair.")
    ] = None,
    plot: Annotated[Path | None, typer.Option(metavar="FILE", help="Map and damping: .png, .svg, .pdf.")] = None,
    elements: Elements = 5,
    power: Power = None,
    source_voltage: SourceVoltage = None,
    parameter: Parameter = None,
    stable_on: StableOn = None,
    exclude: Annotated[
        list[str] | None, typer.Option(metavar="HZ-HZ", help="Leave these rows out, such as 50-70; repeatable.")
    ] = None,
    jobs: Annotated[int, typer.Option(min=1, help="Workers.")] = os.cpu_count() or 1,
    force: Force = False,
) -> None:
    """Every operating point on every grid of a bank, the worst first. Interrupted, the same command goes on."""
    from ...identify.table.read import read_table
    from ...tuning.bank.entries import check_single, read_bank
    from ...tuning.grid_check import check_belongs
    from ...tuning.tune import chosen
    from ..bank.following import Following
    from ..bank.judge import judge_bank
    from .decide import as_told

    check_outputs(output, force, plot, ".parquet")
    content = as_told(read_table(table), stable_on, exclude or ())
    swept = chosen(content.responses, op)
    responses: Sequence[FrequencyResponse] | Following = swept
    names: Sequence[object] = [response.meta.get("op_id") for response in swept]
    if is_surrogate(content):
        model = model_of(content, parameter)
        responses = Following(model, tuple(powers_of(power, model)), source_voltage)
        names = responses.names
    else:
        Asked(power, source_voltage, parameter).check_unasked()
    bank = read_bank(grids, table)
    entries = bank.entries
    for text in bank.remarks:
        remark(text)
    bases = content.meta.get("bases", {})
    check_single(bank, content.meta["f1_hz"], partial(check_belongs, swept[0], bases))
    digest = f"{content.meta['sha256']} {stable_on} {exclude} {names} {source_voltage}" + "".join(parameter or ())
    verdicts = judge_bank(
        responses,
        bases,
        digest,
        entries,
        output=output,
        jobs=jobs,
        elements=elements,
        discard=force,
        report=progress(),
    )
    tell_pairs(verdicts, content.meta["f1_hz"], output, plot, {"table_sha256": content.meta["sha256"]})


def tell_pairs(
    verdicts: Pairs, f1_hz: float, output: Path | None, plot: Path | None, provenance: Mapping[str, str]
) -> None:
    """Print the pairs, write and draw them, and end with the status that says whether every one was judged."""
    from ..bank.report import report_text
    from ..bank.table import row_of

    results(lambda: report_text(verdicts, f1_hz, columns()), lambda: (row_of(verdict, f1_hz) for verdict in verdicts))
    if output is not None:
        from ..bank.table import write_judge
        from ..run import shards

        grids = len({verdict.grid_id for verdict in verdicts})
        write_judge(verdicts, f1_hz, output, {**provenance, "grids": grids})
        shards.remove(shards.folder_of(output))
    if plot is not None:
        from ..bank.figure import plot_bank

        plot_bank(verdicts, f1_hz, plot)
    if any(v.status != "ok" for v in verdicts):
        raise typer.Exit(NOT_ALL_OK)


def progress() -> Callable[[int, int], None]:
    """A line on stderr now and then."""
    begin = last = time.monotonic()
    first = -1

    def report(done: int, total: int) -> None:
        nonlocal last, first
        now = time.monotonic()
        if first < 0:
            first = done
            if done:
                remark(f"{done}/{total} pairs are kept from before")
        if now - last >= LINE_S and done > first:
            left = (now - begin) / (done - first) * (total - done)
            remark(f"{done}/{total} pairs, about {left:.0f} s left")
            last = now

    return report
