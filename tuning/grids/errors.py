"""What is refused of a grid, and files of other kinds that stand beside grids."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from ...plant.errors import SeqsweepError

GRID_SECTIONS = ("element", "region", "family")
"""Sections that only the document of a grid has."""

_CAMPAIGN = {"campaign", "plant", "operating_point", "sweep", "injection"}
_FARM = {"bus", "device"}


class GridError(SeqsweepError):
    """A grid that cannot be used as given: what was given, what is needed, and the way out."""


class NotAGrid(GridError):
    """A sound file of another kind: a folder of grids may hold it, a call that names it is wrong."""


@contextmanager
def naming(place: str) -> Iterator[None]:
    """Put the name of a file before what is refused of it, where it does not stand there yet."""
    try:
        yield
    except GridError as error:
        raise error if str(error).startswith(place) else GridError(f"{place}: {error}") from None


def check_in_service(entry: Mapping[str, Any], name: str, error: type[SeqsweepError] = GridError) -> None:
    """Refuse an ``in_service`` that is neither true nor false: as a text, "no" would count as in service."""
    value = entry.get("in_service", True)
    if not isinstance(value, bool):
        raise error(f"{name}: in_service = {value!r}; needed is true or false, without quotation marks")


def refuse_other_document(document: Mapping[str, Any], place: str) -> None:
    """Refuse a campaign and a farm, told by their sections.

    Raises
    ------
    NotAGrid
        If ``document`` has sections of either and none of a grid.
    """
    if any(section in document for section in GRID_SECTIONS):
        return
    if _FARM & set(document):
        raise NotAGrid(f"{place} is the network of a farm, not a grid: seqsweep farm judges it")
    if _CAMPAIGN & set(document):
        raise NotAGrid(
            f"{place} is a campaign, not a grid: seqsweep run sweeps it, and of its grid seqsweep grid makes a file"
        )


def refuse_other_format(name: Any, place: str) -> None:
    """Refuse what another command of ours wrote.

    Raises
    ------
    NotAGrid
        If ``name`` is one of our formats, but no grid's.
    """
    if isinstance(name, str) and name.startswith("seqsweep-") and name != "seqsweep-grid":
        raise NotAGrid(f"{place} is no grid: its format is {name}")
