"""`seqsweep grid`: the grid's impedance as the PCC sees it, found while the campaign's plant runs on it.

The plant is settled on the grid of each operating point, a current of one second is driven into the PCC,
and R and L are fitted to what of it the grid took (`identify.grid_impedance`). The grid's own values go
into the plant and nowhere else.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from math import floor, hypot, isfinite, log10
from pathlib import Path
from typing import Any

import numpy as np

from ...identify.files import write_json as write_whole
from ...identify.grid_impedance import GridImpedance, identify_grid
from ...identify.uncertainty import NORMAL_95
from ...plant.errors import SeqsweepError, place_of, reason_of
from ...plant.protocol import Injection, Job, NotSettled, Plant, Record, Source
from ...plant.registry import PlantCard
from ..config.sections import MAX_AMPLITUDE_PU
from ..excitation.frequencies import coherent_block
from ..excitation.odd_lines import SignalError
from ..excitation.signals import Signal, multisine, qrb, residue_length, tones
from ..measure.loadflow import reached
from ..plan import Condition, Plan
from ..run.child import ChildFailed
from ..run.host import DEFAULT_TIMEOUT_S, Host

FORMAT, VERSION = "seqsweep-grid", "1.0.0"
SCHEMA_FILE = Path(__file__).parents[1] / "schema" / "seqsweep-grid-1.schema.json"

BAND_HZ = (10.0, 150.0)
"""Band of nu: what the PCC hears is from -100 to 40 and from 60 to 200 Hz where f1 is 50 Hz."""

KINDS = ("multisine", "qrb")


class ProbeError(SeqsweepError):
    """A campaign on which no grid can be identified, with the way out."""


@dataclass(frozen=True, slots=True)
class Probe:
    """How the grid is asked.

    Attributes
    ----------
    signal : Signal
        One period is the whole record; odd lines only, so that the even ones tell the noise.
    amplitude_pu : float
        Peak of the injected current over the rated peak.
    """

    signal: Signal
    amplitude_pu: float


@dataclass(frozen=True, slots=True)
class GridSeen:
    """The grid of one operating point.

    Attributes
    ----------
    op_id : str
        Operating point.
    found : GridImpedance or None
        None where the plant did not run.
    scr : float
        Short-circuit ratio U^2 / (S |Z|); NaN where nothing was found.
    reason : str
        Why nothing was found, or why the grid is no R-L branch; empty where all is well.
    """

    op_id: str
    found: GridImpedance | None
    scr: float
    reason: str


def make_probe(
    kind: str, plant: Plant | PlantCard, amplitude_pu: float, duration_s: float, band_hz: tuple[float, float] = BAND_HZ
) -> Probe:
    """A probing signal that fits the plant's step and fundamental.

    Parameters
    ----------
    kind : str
        One of `KINDS`: cosines at odd lines, amplitudes falling with the root of nu, of low crest factor;
        or the inverse repeat of a quadratic-residue binary sequence.
    plant : Plant or PlantCard
        Gives f1 and the step.
    amplitude_pu : float
        Peak over the rated peak.
    duration_s : float
        Length of the record (s), cut to whole blocks.
    band_hz : (float, float)
        Lowest and highest nu (Hz).
    """
    if kind not in KINDS:
        raise ProbeError(f"signal {kind!r}: the grid is probed with {' or '.join(KINDS)}")
    if not 0.0 < amplitude_pu <= MAX_AMPLITUDE_PU:
        raise ProbeError(f"amplitude of {amplitude_pu:g} pu: needed is a number above 0, at most {MAX_AMPLITUDE_PU:g}")
    block = coherent_block(plant.f1_hz, plant.dt_s)
    period_s = floor(duration_s / block.duration_s + 1e-9) * block.duration_s
    if period_s <= 0.0:
        raise ProbeError(f"{duration_s:g} s is shorter than {block.duration_s:g} s, whole periods of f1 in whole steps")
    if kind == "qrb":
        length = residue_length(0.5 * period_s, band_hz[1])
        return Probe(qrb(length, 2.0 * length / period_s, band_hz, odd=True), amplitude_pu)
    cycles = np.arange(1, floor(band_hz[1] * period_s + 1e-9) + 1, 2)
    cycles = cycles[cycles >= band_hz[0] * period_s - 1e-9]
    if not len(cycles):
        raise SignalError(f"no odd line of {period_s:g} s between {band_hz[0]:g} and {band_hz[1]:g} Hz: widen the band")
    return Probe(multisine(cycles, period_s, cycles**-0.5), amplitude_pu)


def probe_grids(plant: Plant, plan: Plan, probe: Probe, op_ids: Sequence[str] | None = None) -> list[GridSeen]:
    """The grid of every operating point of a campaign, or of those named.

    Raises
    ------
    ProbeError
        If an operating point has no grid behind its PCC, or there is none of a name.
    """
    conditions = _chosen(plan, op_ids)
    for condition in conditions:
        if condition.grid is None and plan.source.kind == "ideal":
            raise ProbeError(
                f"operating point {condition.op_id!r} stands on an ideal source: there is no grid behind its PCC. Give "
                "it one, grid = { r_ohm = 0.012, x_ohm = 0.25 }, or a [source] of kind 'thevenin'"
            )
    return [_seen(plant, plan, probe, condition) for condition in conditions]


def probe_hosted(host: Host, plan: Plan, probe: Probe, op_ids: Sequence[str] | None = None) -> list[GridSeen]:
    """As `probe_grids`, for a plant that may live elsewhere.

    Raises
    ------
    ProbeError
        If it crashes, hangs or raises there.
    """
    timeout_s = (plan.hosting.timeout_s or DEFAULT_TIMEOUT_S) * len(plan.conditions)
    late = f"probing took longer than {timeout_s:g} s of wall time (plant.timeout_s for each operating point)"
    try:
        return host.ask(partial(_probed, plan, probe, op_ids), timeout_s, late)
    except ChildFailed as failure:
        raise ProbeError(str(failure)) from None


def _probed(plan: Plan, probe: Probe, op_ids: Sequence[str] | None, plant: Plant) -> list[GridSeen]:
    return probe_grids(plant, plan, probe, op_ids)


def _chosen(plan: Plan, op_ids: Sequence[str] | None) -> list[Condition]:
    known = [condition.op_id for condition in plan.conditions]
    places = sorted({place_of(op_id, known, "the campaign", ProbeError) for op_id in op_ids or ()})
    return [plan.conditions[place] for place in places] or list(plan.conditions)


def _seen(plant: Plant, plan: Plan, probe: Probe, condition: Condition) -> GridSeen:
    peak_a = probe.amplitude_pu * plant.rating.peak_current_a
    injection = Injection("shunt_current", tones(probe.signal, "d", plant.f1_hz, peak_a))
    try:
        record = _driven(plant, plan, condition, injection, round(probe.signal.period_s / plant.dt_s))
    except NotSettled as refusal:
        return GridSeen(condition.op_id, None, float("nan"), f"{refusal.status}: {refusal}")
    except SeqsweepError:
        raise
    except Exception as error:
        return GridSeen(condition.op_id, None, float("nan"), f"failed: {reason_of(error)}")
    found = identify_grid(record, injection)
    scr = plant.rating.voltage_v**2 / (plant.rating.power_va * hypot(found.r_ohm, found.x_ohm))
    return GridSeen(condition.op_id, found, scr, "" if found.is_rl else _not_rl(found))


def _driven(plant: Plant, plan: Plan, condition: Condition, injection: Injection, n_steps: int) -> Record:
    """The plant on its grid, from the moment the injection begins."""
    source = plan.source if condition.grid is None else Source("thevenin")
    source, point = reached(plant, source, condition)
    ((_, record),) = plant.run([Job(plant.settle(point, source), injection)], n_steps)
    if not (np.all(np.isfinite(record.v)) and np.all(np.isfinite(record.i))):
        raise NotSettled("the response is not finite", status="diverged")
    return record


def _not_rl(found: GridImpedance) -> str:
    worst = int(np.argmax(np.abs(found.z - found.fitted(found.f_hz)) / found.z_std))
    f_hz, z, fitted = found.f_hz[worst], found.z[worst], found.fitted(found.f_hz)[worst]
    return (
        f"no R-L branch: one R and one L miss {found.misfit:.1%} of the voltage, most clearly at {f_hz:.4g} Hz with "
        f"{z.real:.4g} {z.imag:+.4g}j ohm against {fitted.real:.4g} {fitted.imag:+.4g}j ohm "
        "(lines of --plot and -o; seqsweep tune --grid GRID.json takes them)"
    )


# What is said and written


def grid_text(seen: GridSeen) -> str:
    """R + jX as `seqsweep tune --grid` takes it, to the digits that count; an R that noise left below zero is zero."""
    found = seen.found
    if found is None:
        return ""
    size = hypot(found.r_ohm, found.x_ohm)
    return (
        f"{_rounded(max(found.r_ohm, 0.0), found.r_std_ohm, size)}{_rounded(found.x_ohm, found.x_std_ohm, size, '+')}j"
    )


def format_report(seen: Sequence[GridSeen], probe: Probe, f1_hz: float) -> str:
    """A few lines per operating point, for the terminal."""
    nu = probe.signal.nu_hz
    head = (
        f"{probe.signal.kind} of {len(nu)} lines from f1 -+ {nu[0]:g} to f1 -+ {nu[-1]:g} Hz, peak "
        f"{probe.amplitude_pu:g} pu of current, {probe.signal.period_s:g} s"
    )
    return "\n".join([head, *(line for each in seen for line in _report_lines(each, f1_hz))])


def _report_lines(seen: GridSeen, f1_hz: float) -> Iterator[str]:
    found = seen.found
    if found is None:
        yield f"{seen.op_id}: {seen.reason}"
        return
    r, x = (
        f"{_rounded(value, std, hypot(found.r_ohm, found.x_ohm))} +- {NORMAL_95 * std:.2g} ohm"
        for value, std in ((found.r_ohm, found.r_std_ohm), (found.x_ohm, found.x_std_ohm))
    )
    yield f"{seen.op_id}: R = {r}, X = {x} at {f1_hz:g} Hz, SCR {seen.scr:.4g} (95 % intervals)"
    yield f"  {seen.reason}" if seen.reason else f'  seqsweep tune TABLE.parquet --grid "{grid_text(seen)}"'


def _rounded(value: float, std: float, size: float, sign: str = "") -> str:
    """``value`` to the second digit of its error, and not beyond 1e-5 of ``size``: the step itself errs by as much."""
    decimals = 1 - floor(log10(max(std, 1e-5 * size)))
    return f"{value:{sign}.{max(decimals, 0)}f}"


def to_json(seen: Sequence[GridSeen], probe: Probe, plan: Plan) -> dict[str, Any]:
    """The result in the format ``seqsweep-grid``; `SCHEMA_FILE` is its JSON schema."""
    from importlib.metadata import version

    signal = probe.signal
    return {
        "format": FORMAT,
        "version": VERSION,
        "provenance": {
            "tool": {"name": "seqsweep", "version": version("seqsweep")},
            "plant": dict(plan.plant_fingerprint),
            "configuration": dict(plan.configuration),
            "signal": {
                "kind": signal.kind,
                "period_s": signal.period_s,
                "nu_hz": [float(nu) for nu in signal.nu_hz],
                "crest": signal.crest,
                "amplitude_pu": probe.amplitude_pu,
            },
        },
        "operating_points": [_point_json(each) for each in seen],
    }


def _point_json(seen: GridSeen) -> dict[str, Any]:
    found = seen.found
    if found is None:
        return {"op_id": seen.op_id, "grid": None, "reason": seen.reason}
    names = ("f1_hz", "r_ohm", "x_ohm", "l_h", "r_std_ohm", "x_std_ohm", "l_std_h", "misfit", "p_value", "window_s")
    values: Mapping[str, Any] = {name: getattr(found, name) for name in names}
    lines = zip(found.f_hz.tolist(), found.z.real.tolist(), found.z.imag.tolist(), found.z_std.tolist(), strict=True)
    return {
        "op_id": seen.op_id,
        "grid": grid_text(seen),
        "reason": seen.reason,
        "scr": seen.scr if isfinite(seen.scr) else None,
        "is_rl": found.is_rl,
        **values,
        "lines": [{"f_hz": f, "r_ohm": r, "x_ohm": x, "z_std_ohm": std} for f, r, x, std in lines],
    }


def write_json(content: Mapping[str, Any], path: str | Path) -> None:
    """Write what `to_json` gave, atomically."""
    write_whole(path, content)
