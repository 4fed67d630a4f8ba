"""Plants by name, and their check: the two doors to `seqsweep.plant` of the face."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from typing import Any
from weakref import WeakKeyDictionary

from .plant.check import Finding
from .plant.protocol import Plant
from .plant.registry import PlantSpec
from .plant.registry import make_plant as plant_of

_MADE: WeakKeyDictionary[Any, PlantSpec] = WeakKeyDictionary()
"""What the plants that were made here were made of, so that a table of theirs can name it."""


class Findings(tuple[Finding, ...]):
    """What `check_plant` found; shows as one line for every promise."""

    @property
    def passed(self) -> bool:
        """Whether the plant keeps every promise."""
        return all(finding.passed for finding in self)

    def __repr__(self) -> str:
        width = max(len(finding.name) for finding in self)
        return "\n".join(
            f"{'pass' if finding.passed else 'FAIL'}  {finding.name:<{width}}  {finding.detail}".rstrip()
            for finding in self
        )


def make_plant(plant_id: str, **parameters: Any) -> Plant:
    """The plant of that name, made from its parameters.

    Parameters
    ----------
    plant_id : str
        Such as "dpmsg-v1", "fmu:FILE" or "python:module:factory".
    **parameters
        As under ``[plant.parameters]`` of a campaign.

    Raises
    ------
    SeqsweepError
        If there is no such plant, or a parameter is unknown or refused.
    """
    spec = PlantSpec(plant_id, parameters)
    plant = plant_of(spec.id, spec.parameters)
    with suppress(TypeError):  # some objects cannot be referred to weakly
        _MADE[plant] = spec
    return plant


def is_known(plant: Plant) -> bool:
    """Whether `make_plant` made it: then its name and parameters say all of it."""
    try:
        return plant in _MADE
    except TypeError:
        return False


def spec_of(plant: Plant) -> PlantSpec:
    """What the plant was made of, as far as that is known: its own id where it is an object of unknown origin."""
    return _MADE[plant] if is_known(plant) else PlantSpec(str(plant.id))


def check_plant(plant: Plant | str) -> Findings:
    """Hold a plant, or that of a name, against the promise that every plant makes (`seqsweep.plant.protocol`).

    A plant that is named runs in a process of its own where it is foreign code, an object in this one.
    """
    findings: Sequence[Finding]
    if isinstance(plant, str):
        from .sweep.cli.check import findings_of

        findings = findings_of(plant)
    else:
        from .plant.check import check_plant as check

        findings = check(plant)
    return Findings(findings)
