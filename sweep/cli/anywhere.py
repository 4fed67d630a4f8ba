"""What commands share that take a surrogate where a table goes: dispatches on a grid, and the worst of a region."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import isfinite
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from .shared import WrongInput
from .telling import remark

if TYPE_CHECKING:
    from ...identify.surrogate.surrogate import Surrogate
    from ...identify.table.read import Table
    from ...tuning.region.loadflow import Situation
    from ...tuning.region.worst import Least
    from ...tuning.result import TuningResult
    from ...tuning.siso import Grid
    from ..worst import ConfirmedWorst


def checked_voltage(source_pu: float | None) -> float | None:
    """``--source-voltage`` (pu), refused where it is none of a source."""
    from ...tuning.grids.document import check_source_voltage

    if source_pu is not None:
        check_source_voltage(source_pu, f"--source-voltage {source_pu:g}")
    return source_pu


SourceVoltage = Annotated[
    float | None,
    typer.Option(
        metavar="PU",
        callback=checked_voltage,
        help="A surrogate's |v| follows by load flow from this voltage behind grids whose file says none.",
    ),
]
Power = Annotated[
    list[str] | None,
    typer.Option(
        "--power", metavar="P[,Q]", help="Dispatch of a surrogate (MW, Mvar); repeatable. Else ends and middle."
    ),
]

Parameter = Annotated[
    list[str] | None,
    typer.Option(
        "--parameter", metavar="NAME=VALUE", help="Value of a parameter that a surrogate was swept over; repeatable."
    ),
]


def is_surrogate(table: Table) -> bool:
    """Whether the file was written as a surrogate, to be asked between its operating points."""
    return bool(table.meta.get("surrogate"))


def model_of(table: Table, parameters: Sequence[str] | None = None) -> Surrogate:
    """The surrogate of a table, with the values that parameters were given."""
    from ...identify.surrogate.store import surrogate_of

    return surrogate_of(table).fixed(**dict(map(named_value, parameters or ())))


def named_value(text: str) -> tuple[str, float]:
    """NAME=VALUE, as ``--parameter`` and ``--at`` take it."""
    name, _, value = text.partition("=")
    try:
        number = float(value)
    except ValueError:
        number = float("nan")
    if not name or not isfinite(number):
        raise WrongInput(f"{text!r}: needed is NAME=VALUE with a number, such as k_pp=0.08")
    return name.strip(), number


def powers_of(texts: Sequence[str] | None, model: Surrogate) -> list[tuple[float, float]]:
    """The dispatches that were asked for, or those an operator asks about."""
    from ...tuning.region.loadflow import dispatches

    return [_power(text) for text in texts] if texts else dispatches(model)


def _power(text: str) -> tuple[float, float]:
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) not in (1, 2) or not all(map(isfinite, values)):
        raise WrongInput(f"--power {text!r}: needed is P or P,Q in MW and Mvar, such as 0.65 or 0.65,-0.1")
    return values[0], values[1] if len(values) == 2 else 0.0


class Asked(NamedTuple):
    """What is asked of a surrogate besides the grid: dispatches, the voltage behind the grid, values of parameters."""

    power: Sequence[str] | None
    source_voltage: float | None
    parameters: Sequence[str] | None

    def behind(self, grid: str) -> Asked:
        """The same with the source voltage that the grid's file says, where it says one."""
        from ...tuning.grids.open import source_voltage_of

        own = source_voltage_of(grid)
        return self if own is None else self._replace(source_voltage=own)

    def check_unasked(self) -> None:
        """Refuse what only a surrogate can answer."""
        if self.power or self.source_voltage is not None or self.parameters:
            raise WrongInput(
                "--power, --source-voltage and --parameter ask a surrogate: write one with "
                "seqsweep surrogate TABLE.parquet -o FILE"
            )


def situation_of(model: Surrogate, name: str, grid: Grid, source_voltage: float | None) -> Situation:
    """A grid with the source behind it."""
    from ...tuning.region.loadflow import Situation

    return Situation(name, grid, source_voltage, model.meta["bases"].get("rated_voltage_v"))


def on_grid(table: Table, grid: Grid, asked: Asked) -> Table:
    """The table that tuning reads: the device at each dispatch, as the surrogate has it on this grid.

    A dispatch that the grid cannot carry within the region is told and left out.
    """
    from ...plant.errors import SeqsweepError
    from ...tuning.region.loadflow import predicted_on

    model = model_of(table, asked.parameters)
    situation = situation_of(model, grid.label, grid, asked.source_voltage)
    responses, lost = [], []
    for each in powers_of(asked.power, model):
        try:
            responses.append(predicted_on(model, each, situation))
        except SeqsweepError as error:
            lost.append(error)
    if not responses:
        raise lost[0]
    for one in lost:
        remark(str(one))
    return replace(table, responses=tuple(responses), meta={**table.meta, "operating_points": []})


def tune_worst(
    table: Table, grid: str, least: Least, margin: float, asked: Asked, sweeps: int, jobs: int
) -> tuple[TuningResult, str]:
    """The worst operating point over the region, confirmed by sweeps, and what is to be said of it."""
    from ...tuning.region.worst import Worst, worst_of_bank
    from ...tuning.result import TuningResult
    from ..region.goals import situations_of
    from ..worst import confirmed_worst, predicted_worst, sweeping

    model, values = model_of(table), dict(map(named_value, asked.parameters or ()))
    grids = situations_of(grid, model.f1_hz, asked.source_voltage, model.meta["bases"].get("rated_voltage_v"))

    def search(surrogate: Surrogate) -> Worst:
        return worst_of_bank(surrogate.fixed(**values), grids, least, margin)

    if sweeps == 0:
        found = predicted_worst(model, search)
    else:
        usable = [response for response in table.responses if response.usable.any()]
        found = confirmed_worst(
            usable,
            model.region,
            search,
            sweeping(table.meta["configuration"], jobs, model.region.parameters),
            bases=table.meta.get("bases"),
            most=sweeps,
            say=remark,
        )
    provenance: dict[str, Any] = {"table_sha256": table.meta["sha256"], "least": least}
    free_v = bool(model.region.varies[2]) and any(each.source_voltage_pu is None for each in grids)
    words = _told(found, len(grids), model.region.parameters, free_v)
    return TuningResult(found.worst.situation.grid, margin, (found.tuning,), provenance), words


def _told(found: ConfirmedWorst, n_grids: int, parameters: Sequence[str], free_v: bool) -> str:
    from ...identify.surrogate.region import told

    worst = found.worst
    where = told(worst.point, parameters)
    over = worst.situation.name if n_grids == 1 else f"{worst.situation.name}, the worst of {n_grids} grids"
    lines = [
        f"worst operating point by {worst.least}: {where} on {over}",
        f"{worst.n_points} operating points were scanned.",
        _swept(found),
    ]
    if free_v:
        lines.insert(
            1, "|v| was searched over its range like the powers; with --source-voltage it follows from the grid."
        )
    if found.open_m is None:
        lines.append("At 95 % no other point of the region has an m that is lower by more than 0.5 %.")
    else:
        lines.append(f"At 95 % elsewhere m may be as low as {found.open_m:.4g}: sweep more before it decides anything.")
    return "\n".join(lines)


def _swept(found: ConfirmedWorst) -> str:
    n = len(found.added)
    if not found.swept:
        return f"It is a prediction from {found.sweeps} sweeps: no sweep was made there."
    predicted = "no crossing" if found.predicted_m is None else f"m = {found.predicted_m:.4g}"
    return (
        f"It was swept; predicted was {predicted}. The answer rests on {found.sweeps} sweeps, {n} of them made for it."
    )
