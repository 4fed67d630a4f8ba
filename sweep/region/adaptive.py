"""Operating points chosen by doubt: sweep a few, fit a surrogate, sweep where its bar is largest, until certified.

Every round is a small campaign of its own whose table stands in ``OUTPUT.rounds`` until the whole is done; a round that
is there already is read instead of swept. The choice of a point follows from the rows alone, so that an interrupted
region goes on where it was and ends with the same bytes.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...identify.response import FrequencyResponse
from ...identify.surrogate.design import Progress, first_points, gap_of
from ...identify.surrogate.region import AXES, Region, name_of, told
from ...identify.surrogate.surrogate import Surrogate, build_surrogate
from ...identify.table.read import Table, read_table
from ...identify.table.write import write_table
from ...plant.errors import SeqsweepError
from ..config.sections import Config, OperatingPointsSection
from ..run.host import plant_or_card
from .goals import Admittance, Goal, goal_on
from .pace import Pace

Sweep = Callable[[Config, Path], None]
"""Sweeps a campaign with listed operating points into a table; goes on where that was interrupted."""

_LOST = 3  # operating points in a row without a usable row at which the region is given up


class RegionError(SeqsweepError):
    """A region that cannot be swept as it is asked for, with the way out."""


class RegionOutcome(NamedTuple):
    """Rows by status, the surrogate of all points, and how it stands."""

    statuses: dict[str, int]
    progress: Progress
    certified: bool
    n_points: int
    promise: str


@dataclass(frozen=True)
class _Swept:
    """What has been swept so far, a table a round."""

    tables: tuple[Table, ...] = ()
    missed: tuple[float, ...] = field(default=())

    @property
    def responses(self) -> list[FrequencyResponse]:
        return [response for table in self.tables for response in table.responses]

    @property
    def useful(self) -> list[FrequencyResponse]:
        """Operating points with rows to learn from."""
        return [response for response in self.responses if np.any(response.usable)]


def region_of(asked: OperatingPointsSection) -> Region:
    """The box that a campaign asks for, in the units of `AXES`, and the parameters that are axes of it."""
    parameters = asked.parameters or {}
    names = tuple(sorted(parameters))
    values = [*(getattr(asked, axis) for axis in AXES), *(parameters[name] for name in names)]
    ends = np.array([np.broadcast_to(value, 2) for value in values], dtype=float)
    return Region(ends[:, 0], ends[:, 1], names)


def sweep_region(config: Config, output: Path, sweep: Sweep, say: Callable[[str], None]) -> RegionOutcome:
    """Sweep the region of ``config`` until its surrogate is certified, and write one table of all points.

    Parameters
    ----------
    config : Config
        With ``sweep.operating_points``.
    output : path
        The table; rounds are kept in ``OUTPUT.rounds`` until it is written.
    sweep : callable
        Measures one round.
    say : callable
        Called with a line of progress after every round.

    Raises
    ------
    RegionError
        If three operating points in a row give no usable row, or rounds of another campaign are in the way.
    """
    asked = config.sweep.operating_points
    assert asked is not None
    region, goal = region_of(asked), _goal(config)
    folder = output.with_name(output.name + ".rounds")
    folder.mkdir(exist_ok=True)
    pace, history = Pace(), list[dict[str, Any]]()
    swept = _with_rounds(_Swept(), config, region, first_points(region, asked.seed), folder, sweep)
    while True:
        surrogate = build_surrogate(swept.useful, region=region)
        at, doubt = goal.look(surrogate)
        width, between = gap_of(surrogate)
        progress = Progress(doubt, at if between is None else between, swept.missed, width)
        certified = progress.is_certified(goal.tolerance, goal.wider)
        pace.mark(len(swept.responses), doubt)
        history.append({"operating_points": len(swept.responses), "doubt": doubt, "fresh_error": _last(swept.missed)})
        words = _words(progress, surrogate, len(swept.responses), goal)
        say(words if certified else words + pace.left(goal.tolerance / goal.wider))
        if certified or len(swept.responses) >= asked.most or pace.is_over(asked.most_minutes):
            break
        swept = _predicted(swept, surrogate, config, goal, progress.at, folder, sweep)
    write_table(output, swept.responses, _metadata(config, swept, progress, certified, history))
    shutil.rmtree(folder)
    return RegionOutcome(_statuses(swept.responses), progress, certified, len(swept.responses), goal.promise)


def _with_rounds(
    swept: _Swept, config: Config, region: Region, points: np.ndarray, folder: Path, sweep: Sweep
) -> _Swept:
    """All ``points``: in one table, or where parameters differ, in a table each."""
    for part in np.split(points, len(points)) if region.parameters else [points]:
        swept = _with_round(swept, config, region, part, folder, sweep)
    return swept


def _with_round(
    swept: _Swept, config: Config, region: Region, points: np.ndarray, folder: Path, sweep: Sweep
) -> _Swept:
    """One table more."""
    table = _round(config, region, points, folder / f"{len(swept.tables):04d}.parquet", sweep)
    found = _Swept((*swept.tables, table), swept.missed)
    _refuse_lost(found.responses)
    return found


def _goal(config: Config) -> Goal:
    """What the region is swept for; a grid in it is of the fundamental and the rating that the plant promises."""
    asked = config.sweep.operating_points
    assert asked is not None
    if isinstance(asked.tolerance, float):
        return Admittance(asked.tolerance)
    plant = plant_or_card(config)
    return goal_on(asked.tolerance, plant.f1_hz, plant.rating.voltage_v)


def _predicted(
    swept: _Swept, surrogate: Surrogate, config: Config, goal: Goal, at: np.ndarray, folder: Path, sweep: Sweep
) -> _Swept:
    """Sweep ``at`` and hold the result against its prediction, made before."""
    found = _with_round(swept, config, surrogate.region, at[None], folder, sweep)
    fresh = found.tables[-1].responses[0]
    if not surrogate.holds(at[None])[0]:  # in the gap of a jump nothing was predicted
        return found
    missed = goal.missed(surrogate, fresh, at) if np.any(fresh.usable) else float("inf")
    return _Swept(found.tables, (*found.missed, missed))


def _round(config: Config, region: Region, points: np.ndarray, path: Path, sweep: Sweep) -> Table:
    this = listed(config.to_dict(), points, region.parameters)
    if not path.exists():
        sweep(this, path)
    table = read_table(path)
    if table.meta["configuration"] != this.to_dict():
        raise RegionError(
            f"{path.parent}: rounds of another campaign are in the way; --force discards them, or choose another output"
        )
    return _with_parameters(table, dict(zip(region.parameters, map(float, points[0, 3:]), strict=True)))


def listed(configuration: Mapping[str, Any], points: np.ndarray, parameters: Sequence[str]) -> Config:
    """A campaign of these operating points (p, d) alone, with the one value of each parameter that they share."""
    entries = [{"id": name_of(p, parameters), **dict(zip(AXES, map(float, p[:3]), strict=True))} for p in points]
    if not np.any(points[:, 1]):
        entries = [{key: value for key, value in point.items() if key != AXES[1]} for point in entries]
    sweep = {key: value for key, value in configuration["sweep"].items() if key != "operating_points"}
    plant = dict(configuration["plant"])
    if parameters:
        own = dict(zip(parameters, map(float, points[0, 3:]), strict=True))
        plant["parameters"] = {**plant.get("parameters", {}), **own}
    return Config.from_dict({**configuration, "plant": plant, "sweep": sweep, "operating_point": entries})


def _with_parameters(table: Table, parameters: Mapping[str, float]) -> Table:
    """The table whose operating points say which parameters they were swept with."""
    if not parameters:
        return table
    responses = tuple(replace(r, meta={**r.meta, "parameters": dict(parameters)}) for r in table.responses)
    points = [{**point, "parameters": dict(parameters)} for point in table.meta["operating_points"]]
    return replace(table, responses=responses, meta={**table.meta, "operating_points": points})


def _refuse_lost(responses: Sequence[FrequencyResponse]) -> None:
    last = responses[-_LOST:]
    if len(last) == _LOST and not any(np.any(response.usable) for response in last):
        raise RegionError(
            f"{_LOST} operating points in a row, the last at {last[-1].meta['op_id']}, gave no usable row "
            f"({np.asarray(last[-1].reason)[0]}): make the region smaller, to where the device works"
        )


def _metadata(
    config: Config, swept: _Swept, progress: Progress, certified: bool, history: list[dict[str, Any]]
) -> dict[str, Any]:
    """Metadata of the whole: every point of every round, the campaign as it was asked for, and the certificate."""
    asked = config.sweep.operating_points
    assert asked is not None
    first = swept.tables[0].meta
    kept = {key: first[key] for key in ("f1_hz", "bases", "power_meaning")}
    plant = first["plant"]
    if asked.parameters:  # each operating point says its own
        plant = {**plant, "parameters": dict(config.plant.parameters)}
    return {
        **kept,
        "plant": plant,
        "operating_points": [point for table in swept.tables for point in table.meta["operating_points"]],
        "configuration": config.to_dict(),
        "region": {
            "certified": certified,
            **_tolerance_facts(asked, progress),
            "border_width": progress.width,
            "fresh_errors": [None if not np.isfinite(miss) else miss for miss in progress.missed],
            "history": history,
        },
    }


def _last(missed: Sequence[float]) -> float | None:
    """How the last fresh sweep was met; None where there was none, or no row of it could be used."""
    return missed[-1] if missed and np.isfinite(missed[-1]) else None


def _tolerance_facts(asked: OperatingPointsSection, progress: Progress) -> dict[str, Any]:
    """What was asked, and what is left open, by its name."""
    if isinstance(asked.tolerance, float):
        return {"tolerance": asked.tolerance, "largest_bar": progress.doubt}
    return {"on_grids": asked.tolerance.model_dump(exclude_none=True), "doubt": progress.doubt}


def _statuses(responses: Sequence[FrequencyResponse]) -> dict[str, int]:
    found: dict[str, int] = {}
    for status in _each_status(responses):
        found[status] = found.get(status, 0) + 1
    return found


def _each_status(responses: Sequence[FrequencyResponse]) -> Iterator[str]:
    for response in responses:
        yield from np.asarray(response.status).tolist()


def _words(progress: Progress, surrogate: Surrogate, n: int, goal: Goal) -> str:
    where = told(progress.at, surrogate.region.parameters)
    fresh = f"; {goal.missed_words(progress.missed[-1])}" if progress.missed else ""
    jump = "" if surrogate.border is None else f"; the device changes between {surrogate.border}"
    return f"{n} operating points: {goal.words(progress.doubt)} at {where}{fresh}{jump}"
