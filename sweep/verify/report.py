"""A verification as JSON in the format ``seqsweep-verification``, and as plain text for the terminal."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from math import isfinite
from pathlib import Path
from typing import Any

from ...identify.files import write_json as write_whole
from ...identify.views.html import html_table
from ...plant.damping.events import CircuitStep, Event, Fault
from ...tuning.layout import wrapped
from .reading import RunReport, WindowReport
from .runs import Verification

FORMAT = "seqsweep-verification"
VERSION = "1.1.0"

SCHEMA_FILE = Path(__file__).parents[1] / "schema" / "seqsweep-verification-1.schema.json"
"""JSON schema of what `verify` writes."""


_RUNS = ("without", "with")
_SETTINGS = ("k", "r_ohm", "l_h", "resonance_hz", "threshold", "delay_s")


def to_json(result: Verification) -> dict[str, Any]:
    """The verification as plain JSON values; unknown numbers are null."""
    from dataclasses import asdict
    from importlib.metadata import version

    tuned, scenario, settings = result.tuned, result.scenario, result.settings
    content: dict[str, Any] = plain(
        {
            "format": FORMAT,
            "version": VERSION,
            "tool": {"name": "seqsweep", "version": version("seqsweep")},
            "op_id": tuned.op_id,
            "plant": tuned.plant.id,
            "grid": {"r_ohm": tuned.grid.at_f1.real, "x_ohm": tuned.grid.at_f1.imag, "f1_hz": tuned.grid.f1_hz},
            "scenario": {
                **{key: value for key, value in asdict(scenario).items() if key not in ("events", "circuit")},
                **({} if scenario.circuit is None else {"circuit": scenario.circuit.facts()}),
                "duration_s": result.duration_s,
                "events": [_event_json(event) for event in scenario.events],
            },
            "damping": None if settings is None else {key: getattr(settings, key) for key in _SETTINGS},
            "runs": {name: asdict(each) for name, each in zip(_RUNS, result.reports, strict=False)},
            "remarks": list(result.remarks),
        }
    )
    return content


def _event_json(event: Event) -> dict[str, Any]:
    from dataclasses import asdict

    if isinstance(event, CircuitStep):
        return {"kind": "CircuitStep", "time_s": event.time_s, "what": event.what, "circuit": event.circuit.facts()}
    return {"kind": type(event).__name__, **asdict(event)}


def write_json(result: Verification, path: str | Path) -> None:
    """Write the verification as JSON, atomically."""
    write_whole(path, to_json(result))


def plain(value: Any) -> Any:
    """Plain JSON values; what is not finite is null."""
    if isinstance(value, Mapping):
        return {key: plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [plain(each) for each in value]
    return None if isinstance(value, float) and not isfinite(value) else value


def format_report(result: Verification, width: int = 80) -> str:
    """Both runs as plain text: what was asked, how each went, and the windows side by side."""
    runs = result.reports
    lines = [*wrapped(_headline(result), width), *wrapped(_damping_line(result), width), ""]
    lines += columns_of([("", *_RUNS[: len(runs)]), *_facts(runs, result.threshold)])
    lines += ["", *wrapped("windows of 150 ms: frequencies, r of the stronger one, its growth, power", width)]
    head = ("t (s)", *_beside([_WINDOW_HEAD] * len(runs)))
    lines += columns_of([head, *_window_rows(runs)], gap=" " if width < 100 else "  ")
    lines += [line for remark in result.remarks for line in ("", *wrapped(f"note: {remark}", width))]
    return "\n".join(lines)


def as_html(result: Verification) -> str:
    """How both runs went as a small HTML table, for a notebook."""
    facts = _facts(result.reports, result.threshold)
    return html_table(_headline(result), ("", "without damping control", "with")[: len(result.reports) + 1], facts)


_WINDOW_HEAD = ("Hz", "r", "1/s", "MW")


def _headline(result: Verification) -> str:
    scenario, tuned = result.scenario, result.tuned
    return (
        f"{tuned.op_id}: {tuned.plant.id} at {scenario.active_power_w / 1e6:.4g} MW, source "
        f"{scenario.source_voltage_v / tuned.plant.rating.voltage_v:.4g} pu behind {scenario.scale:.4g} x "
        f"({tuned.grid.at_f1.real:.4g} + j{tuned.grid.at_f1.imag:.4g}) ohm; {events_in_words(scenario.events)}"
    )


def _damping_line(result: Verification) -> str:
    settings = result.settings
    if settings is None:
        return "damping control: none"
    return f"damping control: k = {settings.k:.4g} for the tuned grid, set to {settings.resonance_hz:.4g} Hz"


def events_in_words(events: Iterable[Event]) -> str:
    """What happens and when, in the order in which it happens."""
    return "; ".join(event_in_words(event) for event in sorted(events, key=lambda event: event.time_s)) or "no event"


def event_in_words(event: Event) -> str:
    """What happens and when."""
    if isinstance(event, Fault):
        return f"fault {event.kind} through {event.r_ohm:g} ohm at {event.time_s:g} s for {1e3 * event.duration_s:g} ms"
    if isinstance(event, CircuitStep):
        return f"{event.what} at {event.time_s:g} s"
    names = {"scale": "grid x {:.4g}", "count": "{:g} turbines", "wind_m_s": "wind {:g} m/s"}
    for name, text in names.items():
        if hasattr(event, name):
            return f"{text.format(getattr(event, name))} at {event.time_s:g} s"
    return f"{event.active_power_w / 1e6:.4g} MW at {event.time_s:g} s"  # type: ignore[union-attr]


def _facts(runs: Sequence[RunReport], threshold: float) -> list[tuple[str, ...]]:
    def both(name: str, text: Callable[[RunReport], str]) -> tuple[str, ...]:
        return (name, *map(text, runs))

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


def _window_rows(runs: Sequence[RunReport]) -> list[tuple[str, ...]]:
    """The windows of all runs, side by side."""
    return [
        (f"{windows[0].from_s:.2f}-{windows[0].to_s:.2f}", *_beside([_window_cells(window) for window in windows]))
        for windows in zip(*[run.windows for run in runs], strict=False)
    ]


def _beside(cells: Sequence[tuple[str, ...]]) -> tuple[str, ...]:
    """Cells of one run after those of another, with a bar between."""
    return tuple(cell for each in cells for cell in ("|", *each))[1:]


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


def columns_of(rows: list[tuple[str, ...]], gap: str = "  ") -> list[str]:
    """Rows of cells as lines, the first column to the left."""
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    forms = ["<", *[">"] * (len(widths) - 1)]
    return [
        gap.join(f"{cell:{form}{width}}" for cell, form, width in zip(row, forms, widths, strict=True)).rstrip()
        for row in rows
    ]
