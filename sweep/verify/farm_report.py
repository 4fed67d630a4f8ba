"""A farm's runs as text for a terminal and as plain JSON values."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from math import isfinite, pi
from pathlib import Path
from typing import Any

import numpy as np

from ...identify.files import write_json as write_whole
from ...tuning.layout import wrapped
from .farm_runs import FarmRun, FarmVerification
from .reading import grows_at_the_end
from .report import columns_of, plain

FORMAT, VERSION = "seqsweep-farm-verification", "1.0.0"


def to_json(result: FarmVerification) -> dict[str, Any]:
    """Every run, the line's reading and every device's; unknown numbers are null."""
    content: dict[str, Any] = plain(
        {
            "format": FORMAT,
            "version": VERSION,
            "farm": result.farm.entry.name,
            "duration_s": result.story.duration_s,
            "events": list(result.words),
            "damping": [
                None if each is None else {"k": each.k, "r_ohm": each.r_ohm, "l_h": each.l_h, "hz": each.resonance_hz}
                for each in result.settings
            ],
            "dampers": [asdict_of_damper(damper) for damper in result.farm.dampers],
            "pencil": [{"re_per_s": m.pole.real, "im_per_s": m.pole.imag} for m in result.farm.judgement.modes],
            "runs": [_run_json(run, result) for run in result.runs],
        }
    )
    return content


def write_json(result: FarmVerification, path: Path) -> None:
    """Write the verification, atomically."""
    write_whole(path, to_json(result))


def asdict_of_damper(damper: Any) -> dict[str, Any]:
    """A grid-side damper as it was set."""
    of = damper.device
    pairs = {key: [value.real, value.imag] for key, value in (("y_mode_s", of.y_mode), ("y_mirror_s", of.y_mirror))}
    return {"name": damper.entry.name, "bus": damper.entry.bus, "nu_rad_s": of.nu_rad_s, "limit_a": of.limit_a, **pairs}


def _run_json(run: FarmRun, result: FarmVerification) -> dict[str, Any]:
    names = result.names if len(run.devices) == len(result.names) else ("aggregate",)
    return {
        "title": run.title,
        "lost_s": run.trajectory.lost_s,
        "line": asdict(run.line),
        "devices": {name: asdict(each) for name, each in zip(names, run.devices, strict=True)},
    }


def format_report(result: FarmVerification, width: int = 80) -> str:
    """All runs side by side, then every device, then what the aggregate gets wrong."""
    lines = [*wrapped(_headline(result), width), *wrapped(_damping(result), width), ""]
    lines += columns_of([("", *(_short(run.title) for run in result.runs)), *_facts(result)])
    lines += ["", *columns_of(_device_rows(result))]
    wrong = _wrong(result)
    if wrong:
        lines += ["", "what one aggregated turbine gets wrong:"]
        lines += [text for each in wrong for text in wrapped(f"- {each}", width)]
    return "\n".join(lines)


def _short(title: str) -> str:
    return title.replace(" damping", "").replace("aggregate ", "one, ")


def _headline(result: FarmVerification) -> str:
    critical = None if result.last is None else result.last.judgement.critical
    mode = "; no operating point by the load flow after the last change" if result.last is None else ""
    if critical is not None:
        nu, f1 = critical.pole.imag / (2.0 * pi), result.farm.entry.f1_hz
        place = f"{f1 - nu:.4g}/{f1 + nu:.4g} Hz"
        when = " after the last change" if len(result.words) else ""
        mode = f"; critical mode by the pencil, without damping{when}: {critical.pole.real:+.3g} 1/s at {place}"
    events = "; ".join(result.words) or "no event"
    return (
        f"{result.farm.entry.name}: {len(result.names)} devices in time, {result.story.duration_s:g} s; {events}{mode}"
    )


def _damping(result: FarmVerification) -> str:
    given = [(name, each) for name, each in zip(result.names, result.settings, strict=True) if each is not None]
    parts = []
    if given:
        gains = sorted({each.k for _, each in given})
        k = f"k = {gains[0]:.4g}" if len(gains) == 1 else ", ".join(f"{name} {each.k:.3g}" for name, each in given)
        hz = given[0][1].resonance_hz
        parts.append(f"damping control: {k}" + ("" if hz is None else f", set to {hz:.4g} Hz"))
    parts += [
        f"{damper.entry.name} at {damper.entry.bus}: {100.0 * damper.entry.share:g} % of the farm's rating"
        for damper in result.farm.dampers
    ]
    return "; ".join(parts) or "no damping is asked for: k in a scenario file, or [[damper]] in the farm file"


def _facts(result: FarmVerification) -> list[tuple[str, ...]]:
    def row(name: str, text: Callable[[FarmRun], str]) -> tuple[str, ...]:
        return name, *(text(run) for run in result.runs)

    return [
        row("synchronism lost", lambda run: _lost(run, result)),
        row("line: largest r", lambda run: f"{100.0 * run.line.largest_ratio:.1f} %"),
        row("line: last r", lambda run: _value(100.0 * run.line.last_ratio, ".2f", " %")),
        row("line: rate after changes", lambda run: _value(run.line.rate_per_s, "+.2f", " 1/s")),
        row("line: stronger component", lambda run: _value(_frequency_hz(run), ".2f", " Hz")),
        row("damping started", lambda run: _value(_started_s(run), ".3f", " s")),
    ]


def _lost(run: FarmRun, result: FarmVerification) -> str:
    if run.trajectory.lost_s is None:
        return "kept"
    times = [each.lost_s if each.lost_s is not None else np.inf for each in run.trajectory.devices]
    first = int(np.argmin(times))
    who = f" {result.names[first]}" if len(times) > 1 else ""
    return f"{times[first]:.3f} s{who}"


def _started_s(run: FarmRun) -> float | None:
    """When the first device's control, or a grid-side damper, started (s)."""
    started = [time for each in (*run.devices, run.line) for time in each.started_s]
    return min(started, default=None)


def _frequency_hz(run: FarmRun) -> float | None:
    """Of the line's stronger component, the median of where it is known."""
    known = run.trajectory.line.resonance_hz[run.trajectory.line.ratio > 2e-3]
    return float(np.median(known)) if len(known) else None


def _device_rows(result: FarmVerification) -> list[tuple[str, ...]]:
    individual = [run for run in result.runs if len(run.devices) == len(result.names)]
    head = ("device", *(f"{name}, {_short(run.title)}" for run in individual for name in ("largest r", "outcome")))
    rows = [head]
    for k, name in enumerate(result.names):
        cells = [name]
        for run in individual:
            cells += [f"{100.0 * run.devices[k].largest_ratio:.1f} %", _outcome(run, k)]
        rows.append(tuple(cells))
    return rows


def _outcome(run: FarmRun, k: int) -> str:
    lost = run.trajectory.devices[k].lost_s
    if lost is not None:
        return f"lost {lost:.2f} s"
    device = run.devices[k]
    calm = device.calm_s
    if calm is not None and grows_at_the_end(device.rate_per_s, device.last_ratio):
        return "grows"
    return "resonates" if calm is None else "calm" if calm == 0.0 else f"calm {calm:.2f} s"


def _wrong(result: FarmVerification) -> list[str]:
    """Each run of the devices against that of one for all."""
    found = []
    by_title = {run.title: run for run in result.runs}
    for title in ("without damping", "with damping"):
        real, one = by_title.get(title), by_title.get(f"aggregate {title}")
        if real is not None and one is not None:
            found += [f"{title}: {text}" for text in _differences(real, one)]
    return found


def _differences(real: FarmRun, one: FarmRun) -> list[str]:
    texts = []
    if real.line.rate_per_s is not None and one.line.rate_per_s is not None:
        off = one.line.rate_per_s - real.line.rate_per_s
        texts.append(f"the rate of the line's resonance by {off:+.2f} 1/s")
    lost, alone = real.trajectory.lost_s, one.trajectory.lost_s
    if (lost is None) != (alone is None):
        texts.append(
            "it keeps synchronism, the farm does not" if alone is None else "it loses synchronism, the farm does not"
        )
    elif lost is not None and alone is not None:
        texts.append(f"the loss of synchronism by {1e3 * (alone - lost):+.0f} ms")
    ratios = [each.largest_ratio for each in real.devices]
    texts.append(
        f"the devices' largest r, which is {100.0 * min(ratios):.1f} to {100.0 * max(ratios):.1f} %, as "
        f"{100.0 * one.devices[0].largest_ratio:.1f} %"
    )
    return texts


def _value(value: float | None, form: str, unit: str) -> str:
    return "-" if value is None or not isfinite(value) else f"{value:{form}}{unit}"
