"""Beyond one grid, in a notebook: operators' metrics, banks of grids, farms on a network, any operating point."""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from .identify.response import FrequencyResponse
from .identify.surrogate.store import surrogate_of
from .identify.surrogate.surrogate import Surrogate
from .identify.table.read import Table, read_table
from .identify.views.html import MOST, html_table
from .plant.errors import SeqsweepError
from .plant.foreign.toml_file import read_toml
from .sweep.bank.following import FarmFollowing
from .sweep.bank.judge import judge_bank
from .sweep.bank.report import report_text, summary
from .sweep.farm_sweeps import gain_advice, power_advice
from .tables import as_table
from .tuning.bank.entries import check_single, read_bank
from .tuning.bank.judgement import PairVerdict
from .tuning.farm.document import farm_of
from .tuning.farm.entries import FarmEntry
from .tuning.farm.farm import Farm, judged
from .tuning.farm.on_grids import farm_on_grids
from .tuning.farm.restore import DAMPED_BAND, Advice, Damping, Demand, SourceMargin
from .tuning.farm.units import Library
from .tuning.grids.open import open_grid
from .tuning.metrics import Metrics
from .tuning.metrics import metrics as metrics_of


def metrics(y: FrequencyResponse, behind: str | None = None) -> Metrics:
    """What operators read from a scan: Jacobian, frequency perturbation, swing fit, stiffness, passivity.

    Parameters
    ----------
    y : FrequencyResponse
        One operating point; pn frame.
    behind : str, optional
        Look from the source behind this grid: R+jX in ohm at f1, or a file.

    Raises
    ------
    SeqsweepError
        If the response does not say its rating.
    """
    bases = as_table(y).meta.get("bases")
    if bases is None:
        raise SeqsweepError(
            "this response does not say its rating (meta['table']['bases']): sweep or read_table gave it"
        )
    grid = None if behind is None else open_grid(behind, y.f1_hz)
    return metrics_of(y, (bases["rated_voltage_v"], bases["rated_power_va"]), grid)


class Verdicts(list[PairVerdict]):
    """Pairs of grid and operating point, the worst first; a list that shows itself in a few lines."""

    f1_hz: float = 50.0

    def __repr__(self) -> str:
        return report_text(self, self.f1_hz, 80) if self else "[]"

    def _repr_html_(self) -> str:
        rows = [
            (v.grid_id, v.op_id, v.verdict, _short(v.probability), _short(v.margin_m), _short(v.damping))
            for v in self[:MOST]
        ]
        heads = ("grid", "operating point", "verdict", "P(stable)", "m", "damping ratio")
        return html_table(summary(self, self.f1_hz) if self else "no pairs", heads, rows, len(self))


def _short(value: float | None) -> str:
    return "\N{EN DASH}" if value is None else f"{value:.4g}"


def judge(
    y: FrequencyResponse | Table | str | Path, grids: str | Path, *, elements: int = 5, jobs: int | None = None
) -> Verdicts:
    """Every operating point on every grid of a bank, the worst first.

    Parameters
    ----------
    y : FrequencyResponse, Table or path
        Operating points of the device; pn frame. Or a farm's TOML file: its load flow is solved anew on every grid.
    grids : path
        A folder of grids, a family.toml, a Parquet file, or one file of a grid.
    elements : int
        For how many of the worst pairs the critical value of every element is sought.
    jobs : int, optional
        Workers; as many as there are processors unless given.
    """
    swept, bases, f1_hz = _on_any_grid(y) if isinstance(y, str | Path) else _swept(as_table(y))
    bank = read_bank(Path(grids))
    check_single(bank, f1_hz)
    for remark in bank.remarks:
        warnings.warn(remark, stacklevel=2)
    found = judge_bank(
        swept,
        bases,
        "",  # nothing is kept on the disk, so nothing need be told apart
        bank.entries,
        output=None,
        jobs=jobs or os.cpu_count() or 1,
        elements=elements,
    )
    verdicts = Verdicts(found)
    verdicts.f1_hz = f1_hz
    return verdicts


class _Judged(NamedTuple):
    """What is judged, its rating, and its fundamental (Hz)."""

    what: Sequence[FrequencyResponse] | FarmFollowing
    bases: Mapping[str, Any]
    f1_hz: float


def _swept(table: Table) -> _Judged:
    return _Judged(table.responses, table.meta.get("bases", {}), table.meta["f1_hz"])


def _on_any_grid(document: str | Path) -> _Judged:
    entry, library = _entry_and_library(document, ())
    farm = farm_on_grids(entry, library)
    return _Judged(FarmFollowing(farm), farm.bases, entry.f1_hz)


def farm(document: str | Path, out: Sequence[str] = ()) -> Farm:
    """Load flow, verdict and modes of many devices on one network, and who takes part in each mode.

    Parameters
    ----------
    document : path
        The farm as a TOML file; its tables are named relative to it.
    out : sequence of str
        Devices or equipment that are out of service.

    Raises
    ------
    SeqsweepError
        If the file is no farm, or a table of it cannot be read.
    """
    return _farm_and_library(document, out)[1]


def farm_advice(
    document: str | Path,
    by: str,
    *,
    damping: float | None = None,
    margin: float | None = None,
    probability: float = 0.95,
    out: Sequence[str] = (),
    jobs: int | None = None,
) -> Advice:
    """What gains or powers do to a farm's modes, and the smallest changes that give every mode a damping.

    Parameters
    ----------
    document : path
        The farm as a TOML file.
    by : "gain" or "power"
        Damping gains, each confirmed by a sweep, or powers given up, predicted by the tables' surrogates.
    damping : float, optional
        Damping ratio that every mode near f1 shall have; without a demand the slopes alone are found.
    margin : float, optional
        Bode margin m that the farm shall have at the source's bus, in place of a damping.
    probability : float
        With which probability, for the errors of the tables.
    out : sequence of str
        Devices or equipment that are out of service.
    jobs : int, optional
        Threads that sweep.

    Raises
    ------
    SeqsweepError
        If a device cannot be swept again, or has no table over several powers.
    """
    library, found = _farm_and_library(document, out)
    demand: Demand | None = None if margin is None else SourceMargin(margin, probability)
    if damping is not None:
        demand = Damping(damping, probability, DAMPED_BAND * found.entry.f1_hz)
    if by == "power":
        return power_advice(library, found, demand)
    if by != "gain":
        raise SeqsweepError(f"by = {by!r}; known are 'gain' and 'power'")
    return gain_advice(library, found, demand, jobs or os.cpu_count() or 1)


def _farm_and_library(document: str | Path, out: Sequence[str]) -> tuple[Library, Farm]:
    entry, library = _entry_and_library(document, out)
    return library, judged(entry, library)


def _entry_and_library(document: str | Path, out: Sequence[str]) -> tuple[FarmEntry, Library]:
    path = Path(document)
    return farm_of(read_toml(path), out), Library(lambda name: read_table(path.parent / name))


def surrogate(y: Table) -> Surrogate:
    """Y at any operating point within those of a table, with its doubt: ``surrogate(table).response((p, q, v))``.

    Raises
    ------
    SeqsweepError
        If the table holds too few operating points, or some that leave a direction unseen.
    """
    return surrogate_of(y)
