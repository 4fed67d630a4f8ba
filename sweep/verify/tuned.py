"""What a tuning asks to be verified: the device, the grid and the damping control of one operating point."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import isclose
from pathlib import Path
from typing import Any

import numpy as np

from ...plant.damping.control import DampingSettings
from ...plant.damping.events import Scenario, conditions_at, source_of
from ...plant.errors import SeqsweepError, place_of
from ...plant.protocol import MeasuredPlant, NotSettled, OperatingPoint, Plant, reactance_to_inductance
from ...plant.registry import make_plant
from ...plant.space_vectors import LINE_RMS
from ...tuning.gain import virtual_impedance, why_capacitive
from ...tuning.grids.elements import elements_grid
from ...tuning.grids.in_time import circuit_of_grid
from ...tuning.siso import Grid, SeriesRL
from .scenario import Story
from .switching import circuits_of


class VerifyError(SeqsweepError):
    """A tuning that cannot be verified in time, with the way out."""


@dataclass(frozen=True, slots=True)
class Tuned:
    """What verification needs of a tuning: the grid, scale included, and the damping control for it.

    ``plant`` is the card of a device that a child process has driven: enough for a report. ``impedance`` is what k
    multiplies; None: the grid. ``k`` and ``f_r_hz`` are None where there is no damping control; ``no_k`` says why.
    """

    op_id: str
    plant: Plant
    grid: Grid
    active_power_w: float
    terminal_voltage_v: float | None
    source_voltage_v: float | None
    k: float | None
    f_r_hz: float | None
    reactive_power_var: float = 0.0
    impedance: SeriesRL | None = None
    no_k: str = ""


def read_tuning(path: str | Path) -> dict[str, Any]:
    """A tuning result as `tune` wrote it, held against its schema.

    Raises
    ------
    VerifyError
        If the file is not one.
    """
    from jsonschema import ValidationError, validate

    from ...tuning.result import schema

    try:
        content = json.loads(Path(path).read_text("utf-8"))
        validate(content, schema())
    except FileNotFoundError:
        raise VerifyError(f"{path}: no such file; `seqsweep tune y.parquet --grid R+jX -o {path}` writes it") from None
    except ValidationError as error:
        raise VerifyError(f"{path}: not a tuning result: {error.json_path}: {error.message}") from None
    except (json.JSONDecodeError, UnicodeDecodeError):
        raise VerifyError(f"{path}: not JSON; needed: the file that `seqsweep tune -o` wrote") from None
    return content


def tuned_of(
    content: Mapping[str, Any], op_id: str | None = None, plant: Plant | None = None, scale: float | None = None
) -> Tuned:
    """Device, grid and damping control of one operating point at one scale; by default of the worst.

    The device is ``plant``, or the one that the campaign in the tuning names.

    Raises
    ------
    VerifyError
        If there is no such operating point, no campaign, or the device has no measurement port.
    """
    from ..config.sections import Config

    point = _point(content, op_id or content["worst"], scale)
    configuration = content["provenance"]["table"].get("configuration", {})
    if "plant" not in configuration:
        raise VerifyError("the tuning names no campaign to drive: recordings and imports cannot be verified in time")
    config = Config.from_dict(configuration)
    plant = plant or make_plant(config.plant.id, config.plant.parameters)
    if not isinstance(plant, MeasuredPlant):
        raise VerifyError(f"{plant.id} has no measurement port: damping control cannot act on it, nor events in time")
    section = next(section for section in config.operating_point if section.id == point["op_id"])
    own = point.get("damping_impedance")
    u, pcc_pu, grid = plant.rating.voltage_v, section.terminal_voltage_pu, _grid(content, point)
    return Tuned(
        op_id=section.id,
        plant=plant,
        grid=grid,
        active_power_w=section.active_power_mw * 1e6,
        terminal_voltage_v=None if pcc_pu is None else pcc_pu * u,
        source_voltage_v=None if section.grid is None else section.grid.voltage_pu * u,
        k=point["k"],
        f_r_hz=point["f_r_hz"],
        reactive_power_var=(section.reactive_power_mvar or 0.0) * 1e6,
        impedance=None if own is None else SeriesRL(own["r_ohm"], own["x_ohm"], own["f1_hz"]),
        no_k=_why_no_k(point),
    )


def _why_no_k(point: Mapping[str, Any]) -> str:
    """Why an entry of a tuning has no gain; empty where it has one."""
    if point["k"] is not None and point["f_r_hz"] is not None:
        return ""
    return str(point.get("missing", {}).get("k") or point["reason"])


def scenario_of(tuned: Tuned, story: Story) -> Scenario:
    """The scenario on the tuned grid.

    Raises
    ------
    VerifyError
        If the operating point does not exist on the tuned grid and no source voltage is given.
    """
    power_w = tuned.active_power_w if story.active_power_w is None else story.active_power_w
    voltage_v = tuned.source_voltage_v
    if story.source_voltage_pu is not None:
        voltage_v = story.source_voltage_pu * tuned.plant.rating.voltage_v
    if voltage_v is None:
        voltage_v = _source_voltage_v(tuned)
    circuit, events = circuits_of(tuned.grid, story.events)
    return replace(
        scenario_of_voltage(tuned, voltage_v),
        active_power_w=power_w,
        events=events,
        scale=story.scale,
        turbines=story.turbines,
        circuit=circuit,
    )


def scenario_of_voltage(tuned: Tuned, voltage_v: float) -> Scenario:
    """The device on the tuned grid with ``voltage_v`` (V) behind it, and nothing happens."""
    z = tuned.grid.at_f1
    return Scenario(
        tuned.active_power_w,
        z.real,
        reactance_to_inductance(z.imag, tuned.grid.f1_hz),
        voltage_v,
        reactive_power_var=tuned.reactive_power_var,
        circuit=circuit_of_grid(tuned.grid),
    )


def why_undamped(tuned: Tuned) -> str:
    """Why no damping control is simulated: the tuning has no gain, or the grid no R and L for it; empty where it is."""
    if tuned.k is None or tuned.f_r_hz is None:
        return tuned.no_k
    return "" if tuned.impedance is not None else why_capacitive(tuned.grid, tuned.f_r_hz)


def settings_of(tuned: Tuned) -> DampingSettings | None:
    """Damping control as it was tuned; None where there is none, see `why_undamped`."""
    if tuned.k is None or tuned.f_r_hz is None or why_undamped(tuned):
        return None
    behind = tuned.impedance or virtual_impedance(tuned.grid, tuned.f_r_hz)
    return DampingSettings(tuned.k, behind.r_ohm, behind.l_h, resonance_hz=tuned.f_r_hz, f1_hz=tuned.plant.f1_hz)


def _point(content: Mapping[str, Any], op_id: str, scale: float | None) -> Mapping[str, Any]:
    """The entry of an operating point at a scale; what is not said is that of the worst entry, or the only one."""
    entries = content["operating_points"]
    place_of(op_id, list(dict.fromkeys(entry["op_id"] for entry in entries)), "the tuning", VerifyError)
    named = [(entry.get("scale", 1.0), entry) for entry in entries if entry["op_id"] == op_id]
    if scale is None and op_id == content["worst"]:
        scale = content.get("worst_scale")
    found = [entry for at, entry in named if scale is None or isclose(at, scale, rel_tol=1e-9)]
    if len(found) != 1:
        known = ", ".join(f"{at:g}" for at, _ in named)
        asked = "at which of its scales?" if scale is None else f"there is no scale {scale:g}."
        raise VerifyError(f"operating point {op_id!r}: {asked} It was tuned at {known} (--scale X)")
    return found[0]


def _grid(content: Mapping[str, Any], point: Mapping[str, Any]) -> Grid:
    """The grid of an entry, scale included; that of the whole tuning before version 1.2."""
    grid: Mapping[str, Any] = point.get("grid") or content["provenance"]["grid"]
    if grid.get("kind", "series_rl") == "series_rl":
        return SeriesRL(grid["r_ohm"], grid["x_ohm"], grid["f1_hz"])
    if grid["kind"] == "elements":
        return elements_grid(grid["document"], grid["f1_hz"], grid["name"]).scaled(grid["scale"])
    raise VerifyError(
        f"{point['op_id']} was tuned on a grid that has no time domain ({grid['kind']}): simulated are R + jX and "
        "elements (grid.toml with [[element]])"
    )


def _source_voltage_v(tuned: Tuned) -> float:
    """Voltage behind the tuned grid (line-to-line RMS) at which the swept |v_pcc| stands at the PCC."""
    plant, grid = tuned.plant, tuned.grid
    assert isinstance(plant, MeasuredPlant)
    conditions = conditions_at(scenario_of_voltage(tuned, 1.0), 0.0)
    try:
        state = plant.equilibrium(
            OperatingPoint(tuned.active_power_w, tuned.terminal_voltage_v, tuned.reactive_power_var),
            replace(source_of(conditions, 1.0), voltage_v=None),
        )
    except NotSettled as refusal:
        raise VerifyError(f"{tuned.op_id}: {refusal}") from None
    _, trace = plant.trace(state, conditions, 1)
    no_load = trace.record.v[0] + grid.at_f1 * trace.record.i[0]
    circuit = conditions.circuit
    gain = 1.0 if circuit is None else abs(circuit.seen_at(2j * np.pi * grid.f1_hz)[1])
    return float(abs(no_load) * LINE_RMS / gain)
