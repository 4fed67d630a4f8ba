"""The whole of `seqsweep verify` as one question, answered here or, for a foreign device, in a child that holds it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from ...identify.response import FrequencyResponse
from ...identify.table.read import read_table
from ...plant.protocol import Plant
from ...plant.registry import PlantSpec, card_of
from ..run.child import ChildFailed
from ..run.host import host_named
from .report import write_json
from .runs import Verification, cause_gone_of, verify
from .scenario import Story, read_story
from .tuned import VerifyError, read_tuning, tuned_of

VERIFY_S = 3600.0
"""Wall time (s) that both runs of a foreign device may take."""


class Question(NamedTuple):
    """What is to be verified.

    Attributes
    ----------
    tuning : mapping
        The content of a tuning's JSON.
    op_id : str or None
        Operating point; by default the worst.
    scale : float or None
        Which of its scales, where it was tuned at several.
    story : Story or None
        What happens; by default a step onto the tuned grid.
    swept : FrequencyResponse or None
        The device as it was swept: damping stops where it says stable. Without it damping stays on.
    """

    tuning: Mapping[str, Any]
    op_id: str | None = None
    story: Story | None = None
    swept: FrequencyResponse | None = None
    scale: float | None = None


def verification(question: Question, spec: PlantSpec | None = None, isolate: bool | None = None) -> Verification:
    """Both runs of the device that the tuning names, or of the one of ``spec``.

    Raises
    ------
    VerifyError
        If it cannot be done as asked, or a foreign device does not survive it.
    """
    if spec is None:
        section = question.tuning["provenance"]["table"].get("configuration", {}).get("plant")
        if section is None:
            return answer(question)
        spec, isolate = PlantSpec(section["id"], section.get("parameters", {})), section.get("isolate")
    late = f"verifying took longer than {VERIFY_S:g} s of wall time"
    try:
        return host_named(spec, isolate).ask(partial(_answer_with_card, question, spec), VERIFY_S, late)
    except ChildFailed as failure:
        raise VerifyError(str(failure)) from None


def answer(question: Question, plant: Plant | None = None) -> Verification:
    """Both runs of ``plant``, in this process; without one, of the one that the tuning names."""
    tuned = tuned_of(question.tuning, question.op_id, plant, question.scale)
    cause_gone = None if question.swept is None else cause_gone_of(question.swept)
    return verify(tuned, question.story, cause_gone)


def _answer_with_card(question: Question, spec: PlantSpec, plant: Plant) -> Verification:
    """`answer`, fit to be sent: a foreign device itself stays where it is."""
    result = answer(question, plant)
    return replace(result, tuned=replace(result.tuned, plant=card_of(plant, spec)))  # type: ignore[arg-type]


class VerifyJob(NamedTuple):
    """What the command was called with."""

    tuning: Path
    table: Path | None
    op: str | None
    scale: float | None
    scenario: Path | None
    output: Path | None
    plot: Path | None


def verified(job: VerifyJob) -> Verification:
    """Do it, and write the files that were asked for; raises as `verification`."""
    tuning = read_tuning(job.tuning)
    swept = None if job.table is None else read_table(job.table).response(job.op or tuning["worst"])
    story = None if job.scenario is None else read_story(job.scenario)
    result = verification(Question(tuning, job.op, story, swept, job.scale))
    if job.output is not None:
        write_json(result, job.output)
    if job.plot is not None:
        from .figure import plot as draw

        draw(result, job.plot)
    return result
