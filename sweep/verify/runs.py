"""The whole of `seqsweep verify` as one job, done here or, for a foreign device, in a child that holds it."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import NamedTuple

from ...identify.table.read import read_table
from ...plant.protocol import Plant
from ...plant.registry import PlantSpec, runs_isolated
from ..run.child import ChildFailed, child
from .scenario import read_story
from .verify import VerifyError, cause_gone_of, format_report, read_tuning, tuned_of, verify, write_json

VERIFY_S = 3600.0
"""Wall time (s) that both runs of a foreign device may take."""


class VerifyJob(NamedTuple):
    """What the command was called with: files, and the width of the terminal."""

    tuning: Path
    table: Path | None
    op: str | None
    scenario: Path | None
    output: Path | None
    plot: Path | None
    width: int


def verified(job: VerifyJob) -> str:
    """Do it, and give the report as text.

    Raises
    ------
    VerifyError
        If it cannot be done as asked, or a foreign device does not survive it.
    """
    section = read_tuning(job.tuning)["provenance"]["table"].get("configuration", {}).get("plant")
    if section is None or not runs_isolated(section["id"], section.get("isolate")):
        return _done(job)
    spec = PlantSpec(section["id"], section.get("parameters", {}))
    try:
        with child(spec) as asked:
            return asked.ask(partial(_done, job), VERIFY_S, f"verifying took longer than {VERIFY_S:g} s of wall time")
    except ChildFailed as failure:
        raise VerifyError(str(failure)) from None


def _done(job: VerifyJob, plant: Plant | None = None) -> str:
    """Both runs, and the files that were asked for; the device is made from the tuning, wherever this is."""
    tuned = tuned_of(read_tuning(job.tuning), job.op)
    cause_gone = None if job.table is None else cause_gone_of(read_table(job.table).response(tuned.op_id))
    result = verify(tuned, None if job.scenario is None else read_story(job.scenario), cause_gone)
    if job.output is not None:
        write_json(result, job.output)
    if job.plot is not None:
        from .figure import plot as draw

        draw(result, job.plot)
    return format_report(result, job.width)
