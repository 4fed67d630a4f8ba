"""From a response to a decision, in a notebook: stable or not, which gain, and the proof in time."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from .identify.response import FrequencyResponse
from .identify.table.read import Table
from .plant.errors import SeqsweepError
from .plant.protocol import Plant
from .plant.registry import PlantSpec
from .sweep.verify.job import Question, answer, verification
from .sweep.verify.runs import Verification
from .sweep.verify.scenario import Story, read_story, story_of
from .tables import as_table
from .tuning.result import TuningResult, to_json
from .tuning.siso import Grid
from .tuning.tune import tune as tuned


def tune(
    y: FrequencyResponse | Table,
    grid: str | complex | Grid,
    *,
    scale: float | Sequence[float] = 1.0,
    margin: float = 1.4,
    stable_on: str | None = None,
    exclude: Sequence[str] = (),
    confirm: bool = False,
    jobs: int | None = None,
) -> TuningResult:
    """Is it stable on this grid, with what margin, and which damping gain makes it so?

    Parameters
    ----------
    y : FrequencyResponse or Table
        What was swept, identified or imported; pn frame.
    grid : str, complex or Grid
        Grid impedance R + jX in ohm at f1, such as ``"0.012+0.25j"``; a file with a grid; a grid itself; "own": the
        one each point was swept for.
    scale : float or sequence of float
        Multiplies the grid impedance; several: one entry per operating point and scale.
    margin : float
        Magnitude margin m that the gain is made for.
    stable_on : str, optional
        Where the device was seen to be stable: "ideal", or R+jX in ohm at f1. A sweep knows it by itself.
    exclude : sequence of str
        Rows to leave out, as bands in Hz: ``["50-70"]``.
    confirm : bool
        Whether to sweep the device again with damping in place, until the margin holds.
    jobs : int, optional
        Workers of that.

    Returns
    -------
    TuningResult
        ``verdict``, ``margin_m`` and ``k`` are those of the operating point in greatest need, ``points`` has them all.

    Raises
    ------
    SeqsweepError
        If something is wrong with what was asked.
    """
    table = _without(_stated(as_table(y), stable_on), exclude)
    f1_hz = table.responses[0].f1_hz if table.responses else 50.0
    on: Grid | Literal["own"] = "own" if grid == "own" else _grid_of(grid, f1_hz)
    scales = tuple(scale) if isinstance(scale, Sequence) else (scale,)
    result = tuned(table, on, margin=margin, scales=scales)
    if not confirm:
        return result
    from .sweep.confirm import confirm as swept_again

    return swept_again(result, table.meta.get("configuration", {}), jobs=jobs or os.cpu_count() or 1)


def _grid_of(grid: str | complex | Grid, f1_hz: float) -> Grid:
    """A grid as it is, or what its text or file says."""
    from .tuning.grids.open import open_grid

    return open_grid(str(grid).strip("()"), f1_hz) if isinstance(grid, str | complex) else grid


def _stated(table: Table, stable_on: str | None) -> Table:
    """The table with what the user knows of the device."""
    if stable_on is None:
        return table
    from .identify.operating_state import stated, with_statement

    fact = stated(stable_on)
    return Table(table.meta, tuple(with_statement(response, fact) for response in table.responses))


def _without(table: Table, exclude: Sequence[str]) -> Table:
    """The table without the rows that are to be left out."""
    if not exclude:
        return table
    from .identify.exclusion import parse_bands, without_bands

    bands = parse_bands(exclude)
    return Table(table.meta, tuple(without_bands(response, bands) for response in table.responses))


def verify(
    tuning: TuningResult,
    plant: str | Plant | None = None,
    *,
    parameters: Mapping[str, Any] | None = None,
    op: str | None = None,
    scenario: str | Path | Mapping[str, Any] | Story | None = None,
    swept: FrequencyResponse | Table | None = None,
) -> Verification:
    """The same device in time, without and with damping control.

    Parameters
    ----------
    tuning : TuningResult
        What `tune` gave.
    plant : str or Plant, optional
        The device, by name or as an object; by default the one that was swept.
    parameters : mapping, optional
        Parameters of a plant that is named.
    op : str, optional
        Operating point; by default the one in greatest need.
    scenario : path, mapping or Story, optional
        What happens, as in a scenario file; by default the grid steps onto the tuned one.
    swept : FrequencyResponse or Table, optional
        The device as it was swept: damping stops where it says stable. Without it, once started, damping stays on.

    Returns
    -------
    Verification
        Prints as a report; ``plot()`` draws it.

    Raises
    ------
    SeqsweepError
        If the device cannot be driven through the scenario.
    """
    content = to_json(tuning)
    question = Question(content, op, _story(scenario), _response(swept, op or content["worst"]))
    if isinstance(plant, str):
        return verification(question, PlantSpec(plant, parameters or {}))
    if parameters:
        raise SeqsweepError("parameters go with the name of a plant; an object has been made with its own already")
    return verification(question) if plant is None else answer(question, plant)


def _story(scenario: str | Path | Mapping[str, Any] | Story | None) -> Story | None:
    if scenario is None or isinstance(scenario, Story):
        return scenario
    return story_of(scenario) if isinstance(scenario, Mapping) else read_story(scenario)


def _response(swept: FrequencyResponse | Table | None, op_id: str) -> FrequencyResponse | None:
    return swept.response(op_id) if isinstance(swept, Table) else swept
