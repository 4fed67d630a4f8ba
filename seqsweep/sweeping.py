"""Sweeps from a notebook: the same configuration and the same runner as behind the command line, results in memory."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypedDict, Unpack, overload

import numpy as np

from .identify.response import FrequencyResponse
from .identify.table.read import Table, read_table
from .plant.errors import SeqsweepError
from .plant.protocol import Plant
from .plant.registry import PlantCard, releases_gil
from .sweep.config.sections import Config, load_config
from .sweep.plan import Plan
from .sweep.planning import make_plan
from .sweep.run.campaign import Interrupted, sweep_in_memory
from .sweep.run.campaign import run as run_campaign
from .sweep.run.host import plant_or_card
from .sweep.run.spare import spare_children
from .sweep.run.swept import Swept
from .tables import table_of

if TYPE_CHECKING:
    from .sweep.cli.progress import Progress

# Frequencies


@dataclass(frozen=True, slots=True)
class FrequencyGrid:
    """Frequencies as a recipe: a sweep moves them to where its windows are short and exact.

    `numpy.asarray` gives them as they were asked for.
    """

    f_min_hz: float
    f_max_hz: float
    points: int
    spacing: Literal["log", "linear", "adaptive"] = "log"
    interpolation_tolerance: float | None = None

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        space = np.linspace if self.spacing == "linear" else np.geomspace
        return np.asarray(space(self.f_min_hz, self.f_max_hz, self.points), dtype=dtype)

    def __len__(self) -> int:
        return self.points

    def __iter__(self) -> Iterator[float]:
        return iter(np.asarray(self).tolist())

    def settings(self) -> dict[str, Any]:
        """What a campaign says under ``[sweep]`` for it."""
        said = {name: getattr(self, name) for name in self.__slots__}
        return {name: value for name, value in said.items() if value is not None}


def log_grid(f_min_hz: float, f_max_hz: float, points: int) -> FrequencyGrid:
    """``points`` frequencies from ``f_min_hz`` to ``f_max_hz`` (Hz), evenly over the logarithm."""
    return FrequencyGrid(float(f_min_hz), float(f_max_hz), points)


def linear_grid(f_min_hz: float, f_max_hz: float, points: int) -> FrequencyGrid:
    """``points`` frequencies from ``f_min_hz`` to ``f_max_hz`` (Hz), evenly spaced."""
    return FrequencyGrid(float(f_min_hz), float(f_max_hz), points, "linear")


def adaptive_grid(f_min_hz: float, f_max_hz: float, most_points: int, tolerance: float | None = None) -> FrequencyGrid:
    """At most ``most_points`` frequencies (Hz), placed in rounds until interpolation is certified to ``tolerance``.

    The tolerance is of ||dY|| / ||Y||; without one it is 1e-3.
    """
    return FrequencyGrid(float(f_min_hz), float(f_max_hz), most_points, "adaptive", tolerance)


# Sweeping


class Settings(TypedDict, total=False):
    """Keys of ``[sweep]`` and ``[injection]`` of a campaign; see ``seqsweep init`` for what each of them means."""

    tolerance: float
    uncertainty: float
    probes: int
    nonlinear_above: float
    max_simulated_s: float
    kind: Literal["series_voltage", "shunt_current"]
    signal: Literal["tone", "multisine", "prbs", "qrb", "chirp"]
    period_s: float
    amplitude_pu: float | Literal["auto"]
    amplitude_max_pu: float


_OF_INJECTION = ("kind", "signal", "period_s", "amplitude_pu", "amplitude_max_pu")

Frequencies = FrequencyGrid | Sequence[float] | np.ndarray | float


class SweepInterrupted(KeyboardInterrupt):
    """A sweep that was interrupted; in a notebook it is ``sys.last_value`` afterwards.

    Attributes
    ----------
    partial : FrequencyResponse, Table or None
        What was measured until then: the rows that are done, of the operating points that have any.
    """

    def __init__(self, partial: FrequencyResponse | Table | None, asked: int):
        rows = 0 if partial is None else _n_rows(partial)
        kept = f"; {rows} of {asked} rows are measured, see the exception's `partial`" if rows else ""
        super().__init__(f"the sweep was interrupted{kept}")
        self.partial = partial


@overload
def sweep(
    plant: str | Plant,
    *,
    active_power_mw: float,
    f_hz: Frequencies,
    terminal_voltage_pu: float = ...,
    grid: str | complex | Mapping[str, Any] | None = ...,
    parameters: Mapping[str, Any] | None = ...,
    source: Mapping[str, Any] | None = ...,
    jobs: int | None = ...,
    name: str = ...,
    progress: bool = ...,
    **settings: Unpack[Settings],
) -> FrequencyResponse: ...


@overload
def sweep(
    plant: str | Plant,
    *,
    active_power_mw: Sequence[float] | np.ndarray,
    f_hz: Frequencies,
    terminal_voltage_pu: float | Sequence[float] = ...,
    grid: str | complex | Mapping[str, Any] | None = ...,
    parameters: Mapping[str, Any] | None = ...,
    source: Mapping[str, Any] | None = ...,
    jobs: int | None = ...,
    name: str = ...,
    progress: bool = ...,
    **settings: Unpack[Settings],
) -> Table: ...


def sweep(
    plant: str | Plant,
    *,
    active_power_mw: float | Sequence[float] | np.ndarray,
    f_hz: Frequencies,
    terminal_voltage_pu: float | Sequence[float] = 1.0,
    grid: str | complex | Mapping[str, Any] | None = None,
    parameters: Mapping[str, Any] | None = None,
    source: Mapping[str, Any] | None = None,
    jobs: int | None = None,
    name: str = "notebook",
    progress: bool = True,
    **settings: Unpack[Settings],
) -> FrequencyResponse | Table:
    """Sweep a device: its 2x2 sequence admittance at one operating point, or at several.

    Parameters
    ----------
    plant : str or Plant
        The name of a plant, which is made as a campaign makes it (foreign code in processes of its own), or an
        object, which is driven in this process as it is.
    active_power_mw : float, or sequence of them
        Operating points (MW, out of the device). A single number gives a `FrequencyResponse`, several a `Table`.
    f_hz : FrequencyGrid, or frequencies
        `log_grid`, `linear_grid`, `adaptive_grid`, or a list of frequencies in Hz.
    terminal_voltage_pu : float, or one for each operating point
        \\|v_pcc\\| in pu of the rated voltage.
    grid : str, complex or mapping, optional
        Instead of \\|v_pcc\\| the grid that decides it, such as ``"0.012+0.25j"``: R + jX in ohm at f1, or the table
        ``grid`` of a campaign.
    parameters : mapping, optional
        Parameters of a plant that is named.
    source : mapping, optional
        What feeds the PCC, as under ``[source]`` of a campaign; without it an ideal source.
    jobs : int, optional
        Workers; as many as there are processors unless given. An object whose class does not say
        ``releases_gil = True`` is driven by one.
    name : str
        The name of the campaign, as the table keeps it.
    progress : bool
        Whether progress is shown where the sweep takes more than a second.
    **settings
        Further keys of ``[sweep]`` and ``[injection]``, such as ``amplitude_pu=0.001`` or ``signal="multisine"``.

    Returns
    -------
    FrequencyResponse or Table
        Written by `write_table`, it is byte for byte what ``seqsweep run`` makes of the same campaign.

    Raises
    ------
    SeqsweepError
        If something is wrong with what was asked, or with the plant.
    SweepInterrupted
        If it is interrupted; with the rows that are measured.
    """
    single = np.ndim(active_power_mw) == 0
    config = Config.from_dict(
        {
            "campaign": {"name": name},
            "plant": _plant_section(plant, parameters),
            "operating_point": _operating_points(active_power_mw, terminal_voltage_pu, grid),
            **_sections(f_hz, settings),
            **({} if source is None else {"source": dict(source)}),
        }
    )
    table = _swept(config, None if isinstance(plant, str) else plant, jobs, progress, single)
    return table[table.op_ids[0]] if single else table


def _swept(config: Config, live: Plant | None, jobs: int | None, progress: bool, single: bool) -> Table:
    with spare_children(), _shown(progress) as shown:
        plant = plant_or_card(config) if live is None else live
        plan = make_plan(config, plant) if live is None else _live_plan(config, live)
        try:
            swept = sweep_in_memory(
                plan,
                plant,
                jobs=_workers(jobs, live),
                backend=None if live is None else "threading",
                report=shown.report,
                say=shown.say,
            )
        except Interrupted as interrupted:
            raise _interrupted(interrupted.swept, single) from None
    _warn([*plan.warnings, *swept.remarks])
    return _table_of(swept)


def _live_plan(config: Config, plant: Plant) -> Plan:
    """The plan of an object: it is driven where it is, and the table says that its code is not on record."""
    from .making import is_known

    plan = make_plan(config, plant)
    plan = replace(plan, hosting=replace(plan.hosting, isolate=False))
    return plan if is_known(plant) else replace(plan, plant_fingerprint={**plan.plant_fingerprint, "live": True})


def _workers(jobs: int | None, live: Plant | None) -> int:
    if live is not None and not releases_gil(live):
        return 1
    return jobs or os.cpu_count() or 1


def _table_of(swept: Swept) -> Table:
    """The table in memory: what `read_table` would give of the file."""
    return table_of(list(swept.responses()), swept.metadata())


def _interrupted(swept: Swept, single: bool) -> SweepInterrupted:
    asked = len(swept.plan.points) * len(swept.plan.conditions)
    if next(swept.responses(), None) is None:
        return SweepInterrupted(None, asked)
    table = _table_of(swept)
    return SweepInterrupted(table[table.op_ids[0]] if single else table, asked)


def _n_rows(found: FrequencyResponse | Table) -> int:
    return len(found) if isinstance(found, FrequencyResponse) else sum(len(each) for each in found.responses)


def _warn(remarks: Sequence[str]) -> None:
    import warnings

    for remark in remarks:
        warnings.warn(remark, UserWarning, stacklevel=4)


@contextmanager
def _shown(progress: bool) -> Iterator[Progress]:
    from .sweep.cli.progress import Progress
    from .sweep.cli.progress import progress as shown

    if not progress:
        yield Progress(lambda done, total, share: None, lambda text: None)
        return
    with shown() as found:
        yield found


# From arguments to the sections of a campaign


def _plant_section(plant: str | Plant, parameters: Mapping[str, Any] | None) -> dict[str, Any]:
    if isinstance(plant, str):
        return {"id": plant, "parameters": dict(parameters or {})}
    if parameters:
        raise SeqsweepError("parameters go with the name of a plant; an object has been made with its own already")
    from .making import spec_of

    spec = spec_of(plant)
    return {"id": spec.id, "parameters": dict(spec.parameters)}


def _sections(f_hz: Frequencies, settings: Mapping[str, Any]) -> dict[str, Any]:
    """``[sweep]`` and ``[injection]``; a key that neither has is refused as one of ``[sweep]``."""
    frequencies = f_hz.settings() if isinstance(f_hz, FrequencyGrid) else {"f_hz": np.atleast_1d(f_hz).tolist()}
    injection = {key: value for key, value in settings.items() if key in _OF_INJECTION}
    further = {key: value for key, value in settings.items() if key not in _OF_INJECTION}
    return {"sweep": {**frequencies, **further}, "injection": injection}


def _operating_points(
    active_power_mw: float | Sequence[float] | np.ndarray,
    terminal_voltage_pu: float | Sequence[float],
    grid: str | complex | Mapping[str, Any] | None,
) -> list[dict[str, Any]]:
    powers = np.atleast_1d(np.asarray(active_power_mw, dtype=float)).tolist()
    voltages = np.atleast_1d(np.asarray(terminal_voltage_pu, dtype=float)).tolist()
    if len(voltages) not in (1, len(powers)):
        raise SeqsweepError(
            f"{len(powers)} powers but {len(voltages)} voltages; needed: one voltage, or one for each power"
        )
    voltages = voltages * len(powers) if len(voltages) == 1 else voltages
    points: list[dict[str, Any]] = []
    for power, voltage in zip(powers, voltages, strict=True):
        where = {"terminal_voltage_pu": voltage} if grid is None else {"grid": _grid_section(grid)}
        points.append({"id": _fresh_id(power, points), "active_power_mw": power, **where})
    return points


def _fresh_id(power_mw: float, points: Sequence[Mapping[str, Any]]) -> str:
    """Such as "p065" for 0.65 MW; a second point of the same power is "p065-2"."""
    name = "p" + (f"{power_mw:.2f}" if round(power_mw, 2) == power_mw else f"{power_mw:.10g}").replace(".", "")
    same = sum(str(point["id"]).partition("_")[0] == name for point in points)
    return f"{name}_{same + 1}" if same else name


def _grid_section(grid: str | complex | Mapping[str, Any]) -> dict[str, Any] | str:
    if isinstance(grid, Mapping):
        return dict(grid)
    if isinstance(grid, str) and grid.endswith(".toml"):
        return grid
    try:
        z = complex(grid.replace(" ", "")) if isinstance(grid, str) else complex(grid)
    except ValueError:
        raise SeqsweepError(f"grid {grid!r} is not R+jX in ohm at f1; write it as 0.012+0.25j") from None
    return {"r_ohm": z.real, "x_ohm": z.imag}


# Campaigns


class Campaign:
    """A campaign as its file has it: planned, and run to a table on the disk, resumable.

    Made by `from_toml` or `from_dict`; ``config`` is what both the command line and the face work from.
    """

    def __init__(self, config: Config):
        self.config = config

    @classmethod
    def from_toml(cls, path: str | Path, settings: Sequence[str] = ()) -> Campaign:
        """The campaign of a file; ``settings`` as after ``--set``, such as ``"injection.amplitude_pu=0.002"``."""
        return cls(load_config(path, settings))

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> Campaign:
        """The campaign of plain values, sections and keys as in a file."""
        return cls(Config.from_dict(content))

    def __repr__(self) -> str:
        points = ", ".join(point.id for point in self.config.operating_point)
        return f"<Campaign {self.config.campaign.name}: {self.config.plant.id} at {points}>"

    def plan(self) -> Plan:
        """Every shot it will fire; nothing runs.

        Raises
        ------
        SeqsweepError
            If its operating points are chosen while it runs.
        """
        if self.config.sweep.operating_points is not None:
            raise SeqsweepError("its operating points are chosen while it runs: there is no plan before; run it")
        return make_plan(self.config, self._plant())

    def run(
        self,
        output: str | Path | None = None,
        *,
        jobs: int | None = None,
        force: bool = False,
        progress: bool = True,
    ) -> Table:
        """Sweep, and give the table.

        Parameters
        ----------
        output : path, optional
            The Parquet table to write. Interrupted, the same call goes on where it was. Without it nothing is kept.
        jobs : int, optional
            Workers; as many as there are processors unless given.
        force : bool
            Whether an output that is there already, and unfinished work of another campaign on it, may go.
        progress : bool
            Whether progress is shown where the sweep takes more than a second.

        Raises
        ------
        SeqsweepError
            If the output is there already, or the plant cannot be made.
        """
        if output is None:
            with tempfile.TemporaryDirectory() as folder:
                return self._run(Path(folder) / "y.parquet", jobs, True, progress)
        return self._run(Path(output), jobs, force, progress)

    def _run(self, output: Path, jobs: int | None, force: bool, progress: bool) -> Table:
        if output.exists() and not force:
            raise SeqsweepError(f"{output} exists; force=True replaces it")
        workers = jobs or os.cpu_count() or 1
        if self.config.sweep.operating_points is None:
            _run_listed(self.config, output, workers, force, progress)
        else:
            _run_region(self.config, output, workers, force, progress)
        return read_table(output)

    def _plant(self) -> Plant | PlantCard:
        return plant_or_card(self.config)


def _run_listed(config: Config, output: Path, workers: int, force: bool, progress: bool) -> None:
    """A campaign whose operating points are listed, to its table."""
    with spare_children(), _shown(progress) as shown:
        plant = plant_or_card(config)
        plan = make_plan(config, plant)
        outcome = run_campaign(plan, plant, output, jobs=workers, discard=force, report=shown.report, say=shown.say)
    _warn([*plan.warnings, *outcome.remarks])


def _run_region(config: Config, output: Path, workers: int, force: bool, progress: bool) -> None:
    """A campaign that chooses its operating points, to its table."""
    from .sweep.region.adaptive import sweep_region

    def one_round(listed: Config, path: Path) -> None:
        _run_listed(listed, path, workers, force, False)

    if force:
        shutil.rmtree(output.with_name(output.name + ".rounds"), ignore_errors=True)
    with _shown(progress) as shown:
        outcome = sweep_region(config, output, one_round, shown.say)
    if not outcome.certified:
        _warn([f"not reached: {outcome.promise}; a larger `most` sweeps on, or ask for less"])
