"""One grid from what a person writes: R + jX, or the name of a file."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ...identify.fit.rational import RationalModel
from ...plant.errors import place_of
from ...plant.foreign.toml_file import read_toml
from ..poles import closed_loop_poles, is_beyond
from .elements import elements_grid
from .errors import GridError, refuse_other_document
from .in_time import grid_of_fact
from .promise import Grid
from .regions import RegionGrid, regions_grid
from .response import ResponseGrid
from .series import check_scale, parse_series
from .tables import table_grid

GRID_SUFFIXES = (".toml", ".parquet", ".csv", ".txt", ".dat", ".tsv", ".asc", ".s1p", ".s2p", ".mat", ".json")
"""Suffixes of files that hold a grid."""


_FILE_LIKE = re.compile(r"\.[a-zA-Z]{2}\w*$|[/\\]")  # a name with a suffix, or within a folder


def open_grid(text: str, f1_hz: float, scale: float = 1.0) -> Grid:
    """The grid of ``0.012+0.25j`` (ohm at f1), or of a file, multiplied by ``scale``.

    Parameters
    ----------
    text : str
        R+jX, or a file: ``grid.toml`` (elements), a table of Z(f), or a table of ours, with ``#ID`` behind its name
        where it has several operating points.
    f1_hz : float
        The fundamental of the device's table (Hz).
    scale : float
        Multiplies the impedance.

    Raises
    ------
    SeqsweepError
        If it is neither, or the file is no grid.
    """
    check_scale(scale)
    if not is_file(text):
        if _FILE_LIKE.search(text):
            raise GridError(f"{text}: no such file; a grid is a file, or R+jX in ohm at f1, such as 0.012+0.25j")
        return parse_series(text, f1_hz, scale)
    grid = open_file(text, f1_hz)
    if isinstance(grid, RegionGrid):
        raise GridError(f"{text}: regions of Z are judged by seqsweep judge; tune needs one grid")
    return grid if scale == 1.0 else grid.scaled(scale)


def is_file(text: str) -> bool:
    """Whether a text names a file rather than an impedance."""
    path = Path(text.partition("#")[0])
    return bool(text) and (path.suffix.lower() in GRID_SUFFIXES or path.exists())


def open_file(text: str, f1_hz: float) -> Grid | RegionGrid:
    """The grid of a file, whatever its kind."""
    name, _, op_id = text.partition("#")
    path = Path(name)
    if not path.exists():
        raise GridError(f"{path}: no such file")
    if path.is_dir():
        raise GridError(
            f"{path} is a folder, and one grid is needed: give one of its files, or all of them to judge --grids"
        )
    if path.suffix.lower() == ".toml":
        return grid_of_document(read_document(path), f1_hz, path.stem, str(path))
    if path.suffix.lower() == ".parquet":
        return response_grid(path, op_id or None, f1_hz)
    return table_grid(path, f1_hz, op_id or None)


def source_voltage_of(text: str) -> float | None:
    """Voltage (pu of the device's rating) behind the grid of a file of elements, where the file says it."""
    if Path(text).suffix.lower() != ".toml" or not Path(text).exists():
        return None
    value = read_document(Path(text)).get("source_voltage_pu")
    return float(value) if isinstance(value, int | float) else None


def read_document(path: Path) -> dict[str, Any]:
    """A TOML file as plain values."""
    return read_toml(path, GridError)


def grid_of_document(document: Mapping[str, Any], f1_hz: float, name: str, place: str) -> Grid | RegionGrid:
    """The grid of a document with elements or regions; messages begin with ``place``."""
    refuse_other_document(document, place)
    try:
        if "region" in document:
            return regions_grid(document, f1_hz, name)
        if "family" in document:
            raise GridError("a family makes many grids: seqsweep judge --grids takes it")
        return elements_grid(document, f1_hz, name)
    except GridError as error:
        raise GridError(f"{place}: {error}") from None


def response_grid(path: Path, op_id: str | None, f1_hz: float) -> ResponseGrid:
    """The grid of an operating point of a table of ours."""
    from ...identify.fit.model import fit_response
    from ...identify.table.read import read_table

    responses = read_table(path).responses
    ids = [str(response.meta.get("op_id")) for response in responses]
    if op_id is None and len(responses) > 1:
        raise GridError(
            f"{path} has {len(responses)} operating points: write {path}#ID, ID one of {', '.join(ids[:8])}"
        )
    chosen = responses[0 if op_id is None else place_of(op_id, ids, str(path), GridError)]
    if chosen.f1_hz != f1_hz:
        raise GridError(f"{path}: its fundamental is {chosen.f1_hz:g} Hz, the device's {f1_hz:g} Hz")
    name = f"{path.name}#{chosen.meta.get('op_id')}"
    model = fit_response(chosen)
    _check_proved(model, chosen.meta.get("stable_on"), name)
    return ResponseGrid(model, name)


def _check_proved(model: RationalModel, stable_on: Any, name: str) -> None:
    """Refuse a source whose own stability is not what its table proves, or is left open and matters."""
    place = stable_on.get("grid") if isinstance(stable_on, Mapping) else None
    if isinstance(place, Mapping):
        line = grid_of_fact(place, model.f1_hz)
        poles = closed_loop_poles(model, line)
        if np.any((poles.real > 0.0) & ~is_beyond(model, poles)):
            raise GridError(f"{name}: the source was stable on {line.label}, its fit is not: sweep more points of it")
    elif place is None and model.n_unstable:
        raise GridError(
            f"{name}: the fit has {model.n_unstable} unstable poles of the source's own, and nothing proves or "
            "excludes them: import or identify it with --stable-on, which says on which grid it was stable"
        )
