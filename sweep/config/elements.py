"""A campaign's grid of elements: the name of a file, or its content, becomes ``elements`` of the grid's section."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from ...plant.errors import SeqsweepError
from ...plant.foreign.toml_file import read_toml
from .file import Keys

OF_SECTION = ("voltage_pu", "scale", "elements")
"""Keys of a grid's section that are not the document's."""


class Misread(NamedTuple):
    """A grid that cannot be read: where it is named, and why."""

    keys: Keys
    text: str


def with_elements(data: Mapping[str, Any], folder: Path) -> tuple[dict[str, Any], list[Misread]]:
    """A copy in which every grid of elements stands in full, and what could not be read.

    Parameters
    ----------
    data : mapping
        A campaign as TOML gives it.
    folder : path
        What file names are relative to.
    """
    problems: list[Misread] = []
    found = dict(data)
    for keys, section, grid in _grids(data):
        try:
            section["grid"] = _in_full(grid, folder)
        except SeqsweepError as error:
            problems.append(Misread(keys, str(error)))
        found = _put(found, keys[:-1], section)
    return found, problems


def _grids(data: Mapping[str, Any]) -> Iterator[tuple[Keys, dict[str, Any], Any]]:
    """(place of the grid, a copy of the section that holds it, the grid) wherever there is one of elements."""
    points = data.get("operating_point")
    for k, point in enumerate(points if isinstance(points, list | tuple) else []):
        if isinstance(point, Mapping) and _is_elements(point.get("grid")):
            yield ("operating_point", k, "grid"), dict(point), point["grid"]
    source = data.get("source")
    if isinstance(source, Mapping) and _is_elements(source.get("grid")):
        yield ("source", "grid"), dict(source), source["grid"]


def _is_elements(grid: Any) -> bool:
    if isinstance(grid, str):
        return True
    return isinstance(grid, Mapping) and ("element" in grid or isinstance(grid.get("elements"), str))


def _in_full(grid: Any, folder: Path) -> dict[str, Any]:
    """The section of a grid with its document under ``elements``."""
    if isinstance(grid, str):
        return {"elements": read_elements(folder / grid)}
    section = {key: value for key, value in grid.items() if key in OF_SECTION}
    if isinstance(grid.get("elements"), str):
        return {**grid, "elements": read_elements(folder / grid["elements"])}
    return {**section, "elements": {key: value for key, value in grid.items() if key not in OF_SECTION}}


def read_elements(path: Path) -> dict[str, Any]:
    """The document of a file of elements.

    Raises
    ------
    SeqsweepError
        If there is no such file, or it has no time domain.
    """
    if path.suffix.lower() != ".toml":
        raise SeqsweepError(
            f"{path.name} is no file of elements; needed: a grid.toml with [[element]], or R and X: a table of Z(f) "
            "has no time domain"
        )
    document = read_toml(path)
    if "element" not in document:
        raise SeqsweepError(f"{path}: it has no [[element]]; regions and families have no time domain")
    return document


def _put(data: dict[str, Any], keys: Keys, value: Any) -> dict[str, Any]:
    """A copy with one section replaced."""
    if len(keys) == 1:
        return {**data, str(keys[0]): value}
    entries = list(data[str(keys[0])])
    entries[int(keys[1])] = value
    return {**data, str(keys[0]): entries}
