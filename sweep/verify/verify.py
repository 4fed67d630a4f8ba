"""The proof in time: the same device with and without damping control, through the same scenario.

`verify` takes what `tune` found (grid, k, w_r and the campaign in its provenance) and drives the
device through a grid step, or what a scenario file says, twice. Every number is read from terminals.
"""

from __future__ import annotations

import json
import textwrap
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...plant.damping.control import DampingSettings
from ...plant.damping.estimator import SAMPLE_S, WINDOW_S
from ...plant.damping.events import Event, Fault, Scenario, Trajectory, conditions_at, simulate
from ...plant.errors import SeqsweepError, in_words
from ...plant.protocol import Conditions, MeasuredPlant, NotSettled, OperatingPoint, Plant, Source
from ...plant.registry import make_plant
from ...tuning.siso import Grid, SeriesRL
from .scenario import Story

if TYPE_CHECKING:
    from ...identify.response import FrequencyResponse

FORMAT = "seqsweep-verification"
VERSION = "1.0.0"

SCHEMA_FILE = Path(__file__).parents[1] / "schema" / "seqsweep-verification-1.schema.json"
"""JSON schema of what `verify` writes."""

_FAINT = 2e-3
_LARGE = 0.5
"""Rates are read where r lies between these: below the estimate is noise, above nothing is linear."""

CauseGone = Callable[[Conditions], bool]


class VerifyError(SeqsweepError):
    """A tuning that cannot be verified in time, with the way out."""


@dataclass(frozen=True, slots=True)
class Tuned:
    """What verification needs of a tuning: the grid, scale included, and the damping control for it."""

    op_id: str
    plant: Plant
    grid: Grid
    active_power_w: float
    terminal_voltage_v: float | None
    source_voltage_v: float | None
    k: float
    f_r_hz: float


@dataclass(frozen=True, slots=True)
class WindowReport:
    """The current between two times: pair of frequencies (Hz), magnitudes (A, phase peak), r, growth (1/s), power (MW).

    What cannot be told is NaN: blocked, no resonance, synchronism lost.
    """

    from_s: float
    to_s: float
    f_hz: float
    f_mirror_hz: float
    amplitude_a: float
    mirror_a: float
    ratio: float
    growth_per_s: float
    power_mw: float
    power_swing_mw: float


@dataclass(frozen=True, slots=True)
class RunReport:
    """One run in words and numbers.

    Attributes
    ----------
    outcome : str
        In a few words.
    largest_ratio, last_ratio : float
        r, highest and last known.
    above_s, calm_s : float or None
        When r passed the threshold for the first time, and from when on it stayed below (s).
    rate_per_s : float or None
        Growth (+) or decay (-) of the resonance after the last change of anything (1/s).
    started_s, stopped_s : tuple of float
        When damping control started and stopped (s).
    lost_s : float or None
        When synchronism was lost (s).
    windows : tuple of WindowReport
        150 ms each, from the first event on.
    """

    outcome: str
    largest_ratio: float
    last_ratio: float
    above_s: float | None
    calm_s: float | None
    rate_per_s: float | None
    started_s: tuple[float, ...]
    stopped_s: tuple[float, ...]
    lost_s: float | None
    windows: tuple[WindowReport, ...]


@dataclass(frozen=True, slots=True)
class Verification:
    """Both runs; ``remarks`` say what the reader should know."""

    tuned: Tuned
    scenario: Scenario
    settings: DampingSettings
    duration_s: float
    without: Trajectory
    damped: Trajectory
    reports: tuple[RunReport, RunReport]
    remarks: tuple[str, ...]


# From tuning.json to a scenario --------------------------------------------------------------------------------------


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


def tuned_of(content: Mapping[str, Any], op_id: str | None = None) -> Tuned:
    """Device, grid and damping control of one operating point; by default of the worst.

    Raises
    ------
    VerifyError
        If there is no such operating point, no campaign, no gain, or the device has no measurement port.
    """
    from ..config.sections import Config

    point = _point(content, op_id or content["worst"])
    configuration = content["provenance"]["table"].get("configuration", {})
    if "plant" not in configuration:
        raise VerifyError("the tuning names no campaign to drive: recordings and imports cannot be verified in time")
    if point["k"] is None or point["f_r_hz"] is None:
        raise VerifyError(f"{point['op_id']} has no k to verify: {point['reason']}")
    config = Config.from_dict(configuration)
    plant = make_plant(config.plant.id, config.plant.parameters)
    if not isinstance(plant, MeasuredPlant):
        raise VerifyError(f"{plant.id} has no measurement port: damping control cannot act on it, nor events in time")
    section = next(section for section in config.operating_point if section.id == point["op_id"])
    u, pcc_pu, grid = plant.rating.voltage_v, section.terminal_voltage_pu, content["provenance"]["grid"]
    return Tuned(
        op_id=section.id,
        plant=plant,
        grid=SeriesRL(grid["r_ohm"], grid["x_ohm"], grid["f1_hz"]),
        active_power_w=section.active_power_mw * 1e6,
        terminal_voltage_v=None if pcc_pu is None else pcc_pu * u,
        source_voltage_v=None if section.grid is None else section.grid.voltage_pu * u,
        k=point["k"],
        f_r_hz=point["f_r_hz"],
    )


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
    return Scenario(power_w, tuned.grid.r_ohm, tuned.grid.l_h, voltage_v, story.events, story.scale, story.turbines)


def settings_of(tuned: Tuned) -> DampingSettings:
    """Damping control as it was tuned."""
    return DampingSettings(
        tuned.k, tuned.grid.r_ohm, tuned.grid.l_h, resonance_hz=tuned.f_r_hz, f1_hz=tuned.plant.f1_hz
    )


def cause_gone_of(response: FrequencyResponse) -> CauseGone:
    """The check by which damping control stops: the winding number of the swept device on the grid of the moment."""
    from ...identify.fit.model import fit_response
    from ...tuning.verdict import judge

    model = fit_response(response)

    def gone(conditions: Conditions) -> bool:
        x_ohm = 2.0 * np.pi * model.f1_hz * conditions.l_h
        return judge(model, SeriesRL(conditions.r_ohm, x_ohm, model.f1_hz)).verdict == "stable"

    return gone


def _point(content: Mapping[str, Any], op_id: str) -> Mapping[str, Any]:
    for point in content["operating_points"]:
        if point["op_id"] == op_id:
            return point
    known = ", ".join(point["op_id"] for point in content["operating_points"])
    raise VerifyError(f"no operating point {op_id!r} in the tuning; it has {known}")


def _source_voltage_v(tuned: Tuned) -> float:
    """Voltage behind the tuned grid (line-to-line RMS) at which the swept |v_pcc| stands at the PCC."""
    plant, grid = tuned.plant, tuned.grid
    assert isinstance(plant, MeasuredPlant)
    try:
        state = plant.equilibrium(
            OperatingPoint(tuned.active_power_w, tuned.terminal_voltage_v), Source("thevenin", grid.r_ohm, grid.l_h)
        )
    except NotSettled as refusal:
        raise VerifyError(f"{tuned.op_id}: {refusal}") from None
    _, trace = plant.trace(state, Conditions(grid.r_ohm, grid.l_h), 1)
    source = trace.record.v[0] + (grid.r_ohm + 1j * grid.x_ohm) * trace.record.i[0]
    return float(abs(source) * 1.5**0.5)


# Both runs -----------------------------------------------------------------------------------------------------------


def verify(tuned: Tuned, story: Story | None = None, cause_gone: CauseGone | None = None) -> Verification:
    """Drive the device through the story without and with damping control.

    Parameters
    ----------
    tuned : Tuned
        From `tuned_of`.
    story : Story, optional
        Default: the grid steps from 1.2/1.4 of the tuned impedance to all of it at 0.1 s.
    cause_gone : callable, optional
        Says where damping control may stop, see `cause_gone_of`; without it, it stays.

    Raises
    ------
    VerifyError
        If there is no state to begin from, or the device gives up on the way.
    """
    story = story or Story()
    return compare(tuned, scenario_of(tuned, story), settings_of(tuned), story.duration_s, cause_gone)


def compare(
    tuned: Tuned,
    scenario: Scenario,
    settings: DampingSettings,
    duration_s: float,
    cause_gone: CauseGone | None = None,
) -> Verification:
    """Both runs of a scenario, reported."""
    without = _driven("without", tuned.plant, scenario, None, duration_s)
    damped = _driven("with", tuned.plant, scenario, settings, duration_s, cause_gone)
    reports = tuple(report(trajectory, scenario.events, settings.threshold) for trajectory in (without, damped))
    remarks = tuple(_remarks(tuned, scenario, duration_s, without))
    return Verification(tuned, scenario, settings, duration_s, without, damped, reports, remarks)  # type: ignore[arg-type]


def _driven(
    how: str,
    plant: Plant,
    scenario: Scenario,
    settings: DampingSettings | None,
    duration_s: float,
    cause_gone: CauseGone | None = None,
) -> Trajectory:
    """One run; a device that gives up on the way is told in its own words."""
    try:
        return simulate(plant, scenario, settings, duration_s, cause_gone=cause_gone)
    except NotSettled as refusal:
        raise VerifyError(f"the scenario has no state to begin from: {refusal}") from None
    except ValueError:
        raise
    except Exception as error:
        raise VerifyError(
            f"the run {how} damping control does not come to its end: {in_words(error)}; a shorter duration_s in a "
            "scenario file shows what goes before"
        ) from None


def has_equilibrium(plant: Plant, scenario: Scenario, time_s: float) -> bool:
    """Whether the device has a periodic state, stable or not, on what surrounds it at ``time_s``."""
    assert isinstance(plant, MeasuredPlant)
    now = conditions_at(scenario, time_s)
    source = Source("thevenin", now.r_ohm, now.l_h, voltage_v=scenario.source_voltage_v)
    try:
        plant.equilibrium(OperatingPoint(scenario.active_power_w * now.power_scale, None), source)
    except (NotSettled, ValueError):
        return False
    return True


def _remarks(tuned: Tuned, scenario: Scenario, duration_s: float, without: Trajectory) -> Iterable[str]:
    if not has_equilibrium(tuned.plant, scenario, duration_s):
        yield (
            "no operating point that carries this power was found on the grid after the events: where there is none, "
            "no control can find one"
        )
    if tuned.k == 0.0:
        yield "k is 0: the tuning asks for no damping, both runs are the same"
    first = min((event.time_s for event in scenario.events), default=duration_s)
    before = without.ratio[without.decision_s <= first]
    if np.any(before > 1e-3):
        yield "it resonates before the first event: the beginning is unstable"


# What a run says -----------------------------------------------------------------------------------------------------


def report(trajectory: Trajectory, events: tuple[Event, ...], threshold: float) -> RunReport:
    """Read one trajectory; nothing counts after synchronism is lost."""
    t, ratio = trajectory.decision_s, trajectory.ratio
    seen = t <= _end_s(trajectory)
    above = t[seen & (ratio > threshold)]
    above_s = float(above[0]) if len(above) else None
    calm_s = _calm_s(t, ratio, threshold) if trajectory.lost_s is None else None
    return RunReport(
        outcome=_outcome(trajectory, above_s, calm_s),
        largest_ratio=float(np.nanmax(ratio[seen], initial=0.0)),
        last_ratio=float(ratio[seen & np.isfinite(ratio)][-1]),
        above_s=above_s,
        calm_s=calm_s,
        rate_per_s=_rate_per_s(trajectory, events),
        started_s=trajectory.started_s,
        stopped_s=trajectory.stopped_s,
        lost_s=trajectory.lost_s,
        windows=tuple(_windows(trajectory, events)),
    )


def _end_s(trajectory: Trajectory) -> float:
    return np.inf if trajectory.lost_s is None else trajectory.lost_s


def _calm_s(t: np.ndarray, ratio: np.ndarray, threshold: float) -> float | None:
    """From when on r stays below the threshold to the end; unknown is not calm. None if it does not."""
    restless = np.flatnonzero(~(ratio < threshold))
    if len(restless) == 0:
        return 0.0
    return None if restless[-1] + 1 == len(t) else float(t[restless[-1] + 1])


def _outcome(trajectory: Trajectory, above_s: float | None, calm_s: float | None) -> str:
    if trajectory.lost_s is not None:
        return f"synchronism lost at {trajectory.lost_s:.2f} s"
    if calm_s is None:
        return "still resonating at the end"
    return "no resonance above the threshold" if above_s is None else f"calm from {calm_s:.2f} s on"


def _rate_per_s(trajectory: Trajectory, events: tuple[Event, ...]) -> float | None:
    """Slope of ln A_r over the time in which nothing changes any more and r is neither faint nor large."""
    changes = [event.time_s + getattr(event, "duration_s", 0.0) for event in events]
    settled_s = max([0.0, *changes, *trajectory.started_s, *trajectory.stopped_s]) + WINDOW_S
    t, ratio, size = trajectory.decision_s, trajectory.ratio, trajectory.resonance_a
    inside = (t >= settled_s) & (t <= _end_s(trajectory)) & (ratio > _FAINT) & (ratio < _LARGE)
    if np.count_nonzero(inside) * SAMPLE_S < 0.05:
        return None
    return float(np.polyfit(t[inside], np.log(size[inside]), 1)[0])


def _windows(trajectory: Trajectory, events: tuple[Event, ...]) -> Iterable[WindowReport]:
    """Windows as long as the estimator's, from the first event on."""
    first = min((event.time_s for event in events), default=0.0)
    n = round(WINDOW_S / SAMPLE_S)
    begin = round(first / SAMPLE_S)
    for last in range(begin + n - 1, len(trajectory.decision_s), n):
        to_s = float(trajectory.decision_s[last])
        yield _window(trajectory, to_s - WINDOW_S, to_s, last)


def _window(trajectory: Trajectory, from_s: float, to_s: float, decision: int) -> WindowReport:
    if to_s > _end_s(trajectory):
        return WindowReport(from_s, to_s, *[float("nan")] * 8)
    found = trajectory.resonance[decision]
    inside = (trajectory.time_s >= from_s - 1e-9) & (trajectory.time_s < to_s - 1e-9)
    power_mw = trajectory.p_w[inside] / 1e6
    return WindowReport(
        from_s=from_s,
        to_s=to_s,
        f_hz=found.f_hz,
        f_mirror_hz=2.0 * trajectory.f1_hz - found.f_hz,
        amplitude_a=found.amplitude,
        mirror_a=found.mirror,
        ratio=found.ratio,
        growth_per_s=found.growth_per_s,
        power_mw=float(np.mean(power_mw)),
        power_swing_mw=float(np.ptp(power_mw)),
    )


# Out -----------------------------------------------------------------------------------------------------------------


def to_json(result: Verification) -> dict[str, Any]:
    """The verification as plain JSON values; unknown numbers are null."""
    from dataclasses import asdict
    from importlib.metadata import version

    tuned, scenario, settings = result.tuned, result.scenario, result.settings
    names = ("without", "with")
    return _plain(
        {
            "format": FORMAT,
            "version": VERSION,
            "tool": {"name": "seqsweep", "version": version("seqsweep")},
            "op_id": tuned.op_id,
            "plant": tuned.plant.id,
            "grid": {"r_ohm": tuned.grid.r_ohm, "x_ohm": tuned.grid.x_ohm, "f1_hz": tuned.grid.f1_hz},
            "scenario": {
                **{key: value for key, value in asdict(scenario).items() if key != "events"},
                "duration_s": result.duration_s,
                "events": [{"kind": type(event).__name__, **asdict(event)} for event in scenario.events],
            },
            "damping": {
                "k": settings.k,
                "r_ohm": settings.r_ohm,
                "l_h": settings.l_h,
                "resonance_hz": settings.resonance_hz,
                "threshold": settings.threshold,
                "delay_s": settings.delay_s,
            },
            "runs": {name: asdict(each) for name, each in zip(names, result.reports, strict=True)},
            "remarks": list(result.remarks),
        }
    )


def write_json(result: Verification, path: str | Path) -> None:
    """Write the verification as JSON, atomically."""
    from ...identify.files import atomic_file

    text = json.dumps(to_json(result), indent=1, allow_nan=False) + "\n"
    with atomic_file(path) as file:
        file.write(text.encode())


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    return None if isinstance(value, float) and not isfinite(value) else value


def format_report(result: Verification, width: int = 80) -> str:
    """Both runs as plain text: what was asked, how each went, and the windows side by side."""
    without, damped = result.reports
    lines = [*_wrapped(_headline(result), width), *_wrapped(_damping_line(result), width), ""]
    lines += _grid_of([("", "without", "with"), *_facts(without, damped, result.settings.threshold)])
    lines += ["", *_wrapped("windows of 150 ms: frequencies, r of the stronger one, its growth, power", width)]
    lines += _grid_of([_WINDOW_HEAD, *_window_rows(without, damped)], gap=" " if width < 100 else "  ")
    lines += [line for remark in result.remarks for line in ("", *_wrapped(f"note: {remark}", width))]
    return "\n".join(lines)


_WINDOW_HEAD = ("t (s)", "Hz", "r", "1/s", "MW", "|", "Hz", "r", "1/s", "MW")


def _headline(result: Verification) -> str:
    scenario, tuned = result.scenario, result.tuned
    events = "; ".join(_in_words(event) for event in sorted(scenario.events, key=lambda event: event.time_s))
    return (
        f"{tuned.op_id}: {tuned.plant.id} at {scenario.active_power_w / 1e6:.4g} MW, source "
        f"{scenario.source_voltage_v / tuned.plant.rating.voltage_v:.4g} pu behind {scenario.scale:.4g} x "
        f"({tuned.grid.r_ohm:.4g} + j{tuned.grid.x_ohm:.4g}) ohm; {events or 'no event'}"
    )


def _damping_line(result: Verification) -> str:
    settings = result.settings
    return f"damping control: k = {settings.k:.4g} for the tuned grid, set to {settings.resonance_hz:.4g} Hz"


def _in_words(event: Event) -> str:
    if isinstance(event, Fault):
        return f"fault {event.kind} through {event.r_ohm:g} ohm at {event.time_s:g} s for {1e3 * event.duration_s:g} ms"
    names = {"scale": "grid x {:.4g}", "count": "{:g} turbines", "wind_m_s": "wind {:g} m/s"}
    for name, text in names.items():
        if hasattr(event, name):
            return f"{text.format(getattr(event, name))} at {event.time_s:g} s"
    return f"{event.active_power_w / 1e6:.4g} MW at {event.time_s:g} s"  # type: ignore[union-attr]


def _facts(without: RunReport, damped: RunReport, threshold: float) -> list[tuple[str, ...]]:
    def both(name: str, text: Callable[[RunReport], str]) -> tuple[str, ...]:
        return name, text(without), text(damped)

    return [
        both("outcome", lambda run: run.outcome),
        both(f"r above {100.0 * threshold:g} % from", lambda run: _time(run.above_s)),
        both("largest r", lambda run: f"{100.0 * run.largest_ratio:.1f} %"),
        both("last r", lambda run: f"{100.0 * run.last_ratio:.2f} %"),
        both("rate after the last change", lambda run: _value(run.rate_per_s, "+.2f", " 1/s")),
        both("damping control started", lambda run: _times(run.started_s)),
        both("damping control stopped", lambda run: _times(run.stopped_s)),
        both("synchronism lost", lambda run: _time(run.lost_s)),
    ]


def _window_rows(without: RunReport, damped: RunReport) -> list[tuple[str, ...]]:
    rows = []
    for left, right in zip(without.windows, damped.windows, strict=False):
        rows.append((f"{left.from_s:.2f}-{left.to_s:.2f}", *_window_cells(left), "|", *_window_cells(right)))
    return rows


def _window_cells(window: WindowReport) -> tuple[str, ...]:
    if not isfinite(window.power_mw):
        return ("lost", "", "", "")
    if not isfinite(window.ratio):
        return ("blocked", "", "", f"{window.power_mw:.3f}")
    low, high = sorted((window.f_hz, window.f_mirror_hz))
    pair = f"{low:.1f}/{high:.1f}" if isfinite(low) else "-"
    growth = f"{window.growth_per_s:+.1f}" if isfinite(window.growth_per_s) else "-"
    return pair, f"{100.0 * window.ratio:.2f} %", growth, f"{window.power_mw:.3f}"


def _value(value: float | None, form: str, unit: str) -> str:
    return "-" if value is None else f"{value:{form}}{unit}"


def _time(time_s: float | None) -> str:
    return _value(time_s, ".3f", " s")


def _times(times_s: tuple[float, ...]) -> str:
    return ", ".join(f"{time_s:.3f} s" for time_s in times_s) or "-"


def _grid_of(rows: list[tuple[str, ...]], gap: str = "  ") -> list[str]:
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    forms = ["<", *[">"] * (len(widths) - 1)]
    return [
        gap.join(f"{cell:{form}{width}}" for cell, form, width in zip(row, forms, widths, strict=True)).rstrip()
        for row in rows
    ]


def _wrapped(text: str, width: int) -> list[str]:
    return textwrap.wrap(text, max(width, 20), subsequent_indent="  ")
