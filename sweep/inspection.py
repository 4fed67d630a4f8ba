"""What `seqsweep check` finds: of a plant by driving it, of a file by reading it.

A plant that is not this package's own is driven in a child; a file is read and nothing of it executed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ..plant.check import Finding, check_plant
from ..plant.registry import PlantSpec, runs_isolated
from .child import ChildFailed, child

CHECK_S = 600.0
"""Wall time (s) that driving a plant through all its promises may take."""


def findings_of(plant_id: str, parameters: Mapping[str, Any] | None = None) -> Sequence[Finding]:
    """Every promise of a plant, and whether it is kept.

    Raises
    ------
    PlantError
        If there is no such plant, or it cannot be made from these parameters.
    """
    spec = PlantSpec(plant_id, parameters or {})
    if not runs_isolated(plant_id, None):
        return check_plant(spec.make())
    try:
        with child(spec) as asked:
            return asked.ask(check_plant, CHECK_S, f"the check took longer than {CHECK_S:g} s of wall time")
    except ChildFailed as failure:
        return [Finding("survives", False, str(failure))]
