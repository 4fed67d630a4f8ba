"""What a table holds, for people: one page of text in the width of the terminal.

Operating points are read one after the other, so that a thousand of them need no more memory than a
few. rich is imported where text is laid out.
"""

from __future__ import annotations

import io
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ...identify.operating_state import fundamental_text, stable_on_text
from ...identify.response import STATUSES, FrequencyResponse
from ...identify.table.format import TableError
from ...identify.table.read import iter_responses, read_metadata
from ...identify.uncertainty import relative_uncertainty
from ...plant.errors import place_of
from ..excitation.adaptive_rounds import certificate_text

if TYPE_CHECKING:
    from rich.console import RenderableType

MIN_WIDTH = 30
BLOCKS_UP_TO = 3
LISTED_UP_TO = 12
REASONS_SHOWN = 5
PLACES_SHOWN = 3


class Worst(NamedTuple):
    """The largest value of a quality, and where it is."""

    value: float
    f_hz: float
    op_id: str


@dataclass(frozen=True, slots=True)
class PointFacts:
    """What is said about one operating point."""

    op_id: str
    active_power_mw: float | None
    terminal_voltage_pu: float | None
    band_hz: tuple[float, float]
    statuses: Counter[str]
    uncertainty: Worst | None
    linearity: Worst | None
    residual: Worst | None
    cond_v: Worst | None
    settle_residual: float | None
    interpolation: str | None
    fundamental: str | None
    stable_on: str | None

    @property
    def points(self) -> int:
        """Number of rows."""
        return self.statuses.total()

    @property
    def not_ok(self) -> int:
        """Number of rows that are not "ok"."""
        return self.points - self.statuses["ok"]


@dataclass(slots=True)
class Complaint:
    """Rows with one status and one reason; numbers in the reason may differ, the first one is kept."""

    status: str
    reason: str
    count: int = 0
    places: list[tuple[str, float]] = field(default_factory=list)


def summary(table_path: str | Path, width: int = 80, plain: bool = True, op_id: str | None = None) -> str:
    """A page of text about a table.

    Parameters
    ----------
    table_path : path
        The table.
    width : int
        Columns to fill, at least `MIN_WIDTH`.
    plain : bool
        ASCII without colour, for files and pipes; else lines and colours of a terminal.
    op_id : str, optional
        Only this operating point.

    Raises
    ------
    TableError
        If the file is not a readable table, or has no such operating point.
    """
    meta, facts, complaints = _read(table_path, op_id)
    worst_first = sorted(complaints.values(), key=lambda complaint: -complaint.count)
    page = [
        _pairs(_header(Path(table_path).name, meta, facts)),
        *(_blocks(facts) if len(facts) <= BLOCKS_UP_TO else _overview(facts, width)),
        *_reasons(worst_first),
    ]
    return _rendered(page, max(width, MIN_WIDTH), plain)


def summary_values(table_path: str | Path, op_id: str | None = None) -> dict[str, Any]:
    """What `summary` says, as plain values for other programs; raises as `summary`."""
    from dataclasses import asdict

    meta, facts, complaints = _read(table_path, op_id)
    return {
        "table": Path(table_path).name,
        "format": meta["format"],
        "version": meta["version"],
        "plant": _table(meta, "plant").get("id"),
        "f1_hz": meta["f1_hz"],
        "bases": {key: value for key, value in _table(meta, "bases").items() if isinstance(value, int | float)},
        "operating_points": [_fact_values(each) for each in facts],
        "not_ok": [asdict(complaint) for complaint in complaints.values()],
    }


def _fact_values(point: PointFacts) -> dict[str, Any]:
    named = {name: getattr(point, name) for name in PointFacts.__slots__}
    worst = {name: value._asdict() if isinstance(value, Worst) else value for name, value in named.items()}
    return {**worst, "statuses": dict(point.statuses)}


def _read(
    table_path: str | Path, op_id: str | None
) -> tuple[Mapping[str, Any], list[PointFacts], dict[tuple[str, str], Complaint]]:
    """Metadata, facts and complaints of a table, or of one operating point of it."""
    meta = read_metadata(table_path)
    if op_id is not None:
        names = [str(point.get("op_id")) for point in meta.get("operating_points", [])]
        place_of(op_id, names, "what is to be shown", TableError)
    complaints: dict[tuple[str, str], Complaint] = {}
    facts = []
    for response in iter_responses(table_path):
        if op_id is None or str(response.meta["op_id"]) == op_id:
            facts.append(point_facts(response))
            _collect(complaints, response)
    return meta, facts, complaints


def point_facts(response: FrequencyResponse) -> PointFacts:
    """Band, statuses and worst qualities of one operating point."""
    meta = response.meta
    return PointFacts(
        op_id=str(meta["op_id"]),
        active_power_mw=meta.get("active_power_mw"),
        terminal_voltage_pu=meta.get("terminal_voltage_pu"),
        band_hz=(float(response.f_hz[0]), float(response.f_hz[-1])),
        statuses=Counter(np.asarray(response.status).tolist()),
        uncertainty=_worst_value(response, relative_uncertainty(response)),
        linearity=_worst(response, "linearity"),
        residual=_worst(response, "residual"),
        cond_v=_worst(response, "cond_v"),
        settle_residual=meta.get("settle_residual"),
        interpolation=_interpolation(response),
        fundamental=fundamental_text(meta["fundamental"]) if "fundamental" in meta else None,
        stable_on=stable_on_text(meta["stable_on"]) if "stable_on" in meta else None,
    )


def _interpolation(response: FrequencyResponse) -> str | None:
    """What an adaptive sweep certified."""
    entry = response.meta.get("interpolation")
    return certificate_text(entry, response.f1_hz) if isinstance(entry, dict) else None


def _worst(response: FrequencyResponse, name: str) -> Worst | None:
    return _worst_value(response, np.asarray(response.quality.get(name, np.full(len(response), np.nan)), dtype=float))


def _worst_value(response: FrequencyResponse, values: np.ndarray) -> Worst | None:
    if np.all(np.isnan(values)):
        return None
    index = int(np.nanargmax(values))
    return Worst(float(values[index]), float(response.f_hz[index]), str(response.meta["op_id"]))


def _worst_of(found: Iterable[Worst | None]) -> Worst | None:
    return max((worst for worst in found if worst is not None), default=None)


_A_NUMBER = re.compile(r"[-+]?\d+(\.\d+)?(e[-+]?\d+)?", re.IGNORECASE)


def _collect(complaints: dict[tuple[str, str], Complaint], response: FrequencyResponse) -> None:
    """Add the rows of ``response`` that are not ok to those of the same status and reason."""
    op_id = str(response.meta["op_id"])
    for index in np.flatnonzero(~response.ok):
        status, reason = str(np.asarray(response.status)[index]), str(np.asarray(response.reason)[index])
        complaint = complaints.setdefault((status, _A_NUMBER.sub("#", reason)), Complaint(status, reason))
        complaint.count += 1
        if len(complaint.places) < PLACES_SHOWN:
            complaint.places.append((op_id, float(response.f_hz[index])))


# What is said


def _header(name: str, meta: Mapping[str, Any], facts: Sequence[PointFacts]) -> Iterator[tuple[str, str]]:
    tool, bases = _table(meta, "tool"), _table(meta, "bases")
    writer = " ".join(str(part) for part in (tool.get("name"), tool.get("version")) if part)
    yield "table", name
    yield "format", f"{meta['format']} {meta['version']}" + (f", written by {writer}" if writer else "")
    rated = [f"{bases[key] * unit:g} {symbol}" for key, unit, symbol in _RATED if key in bases]
    yield "plant", ", ".join([str(_table(meta, "plant").get("id", "unnamed")), *rated])
    yield "f1", f"{meta['f1_hz']:g} Hz"
    if meaning := meta.get("power_meaning"):
        yield "power", str(meaning)
    configuration = _table(meta, "configuration")
    if source := _table(configuration, "source"):
        yield "source", _source(source)
    if injection := _table(configuration, "injection"):
        yield "injection", _injection(injection)
    total = sum((point.statuses for point in facts), Counter())
    many = "operating point" if len(facts) == 1 else "operating points"
    yield "rows", f"{total.total()} of {len(facts)} {many}: {_statuses(total)}"


_RATED = (("rated_voltage_v", 1.0, "V"), ("rated_power_va", 1e-6, "MVA"))


def _table(values: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    """The table under ``key``, empty where somebody else's metadata has something different there."""
    value = values.get(key)
    return value if isinstance(value, Mapping) else {}


def _source(source: Mapping[str, Any]) -> str:
    if source.get("kind") != "thevenin":
        return str(source.get("kind", "unknown"))
    if not source.get("x_ohm"):
        return "thevenin, the grid of each operating point"
    return f"thevenin, {source.get('r_ohm', 0.0):g} + j {source['x_ohm']:g} ohm"


def _injection(injection: Mapping[str, Any]) -> str:
    parts = [str(injection[key]) for key in ("kind", "signal") if key in injection]
    amplitude = injection.get("amplitude_pu")
    return ", ".join([*parts, *([f"{amplitude:g} pu"] if isinstance(amplitude, int | float) else [])])


def _statuses(statuses: Counter[str]) -> str:
    return ", ".join(f"{statuses[status]} {status}" for status in STATUSES if statuses[status])


def _at(worst: Worst | None, named: bool = False) -> str:
    if worst is None:
        return "unknown"
    return f"{worst.value:.2g} at {worst.f_hz:.5g} Hz" + (f" of {worst.op_id}" if named else "")


def _band(band_hz: tuple[float, float]) -> str:
    return f"{band_hz[0]:.5g} to {band_hz[1]:.5g} Hz"


def _condition(point: PointFacts) -> str:
    power, voltage = point.active_power_mw, point.terminal_voltage_pu
    parts = [f"{power:g} MW"] if power is not None else []
    return ", ".join([*parts, f"{voltage:g} pu" if voltage is not None else "|v| decided by the grid"])


def _block(point: PointFacts) -> Iterator[tuple[str, str]]:
    yield point.op_id, _condition(point)
    yield "  band", f"{_band(point.band_hz)}, {point.points} points"
    yield "  status", _statuses(point.statuses)
    yield "  error", f"worst {_at(point.uncertainty)} (one standard error, of |Y|)"
    yield "  linear", f"worst {_at(point.linearity)} (spread over the amplitude, of |Y|)"
    yield "  residual", f"worst {_at(point.residual)}"
    yield "  cond(V)", f"worst {_at(point.cond_v)}"
    if point.settle_residual is not None:
        yield "  settled", f"to {point.settle_residual:.2g} over a period"
    if point.interpolation is not None:
        yield "  adaptive", point.interpolation
    if point.fundamental is not None:
        yield "  at f1", point.fundamental
    yield "  stable", f"on {point.stable_on}" if point.stable_on is not None else _NOT_KNOWN


_NOT_KNOWN = "not known where (tune --stable-on states it)"


def _blocks(facts: Sequence[PointFacts]) -> list[RenderableType]:
    return [part for point in facts for part in ("", _pairs(_block(point)))]


def _overview(facts: Sequence[PointFacts], width: int) -> list[RenderableType]:
    """All of them in some lines, then each in one, the worst first where they are too many."""
    band = (min(point.band_hz[0] for point in facts), max(point.band_hz[1] for point in facts))
    sums = [
        ("band", f"{_band(band)}, {facts[0].points} points each"),
        ("error", f"worst {_at(_worst_of(point.uncertainty for point in facts), named=True)}"),
        ("linear", f"worst {_at(_worst_of(point.linearity for point in facts), named=True)}"),
        ("residual", f"worst {_at(_worst_of(point.residual for point in facts), named=True)}"),
        ("cond(V)", f"worst {_at(_worst_of(point.cond_v for point in facts), named=True)}"),
    ]
    settled = [point.settle_residual for point in facts if point.settle_residual is not None]
    if settled:
        sums.append(("settled", f"to {max(settled):.2g} over a period, or better"))
    if adaptive := [point for point in facts if point.interpolation is not None]:
        certified = sum("not certified" not in str(point.interpolation) for point in adaptive)
        sums.append(("adaptive", f"interpolation certified for {certified} of {len(adaptive)} operating points"))
    known = [point for point in facts if point.stable_on is not None]
    sums.append(("stable", f"known for {len(known)} of {len(facts)} operating points" if known else _NOT_KNOWN))
    listed = list(facts)
    parts: list[RenderableType] = [_pairs(sums), ""]
    if len(facts) > LISTED_UP_TO:
        listed = sorted(facts, key=_badness, reverse=True)[:LISTED_UP_TO]
        parts.append(_text(f"the worst {len(listed)} of {len(facts)} operating points"))
    return [*parts, _lines(listed, width)]


def _badness(point: PointFacts) -> tuple[int, float]:
    return point.not_ok, point.residual.value if point.residual else 0.0


def _reasons(complaints: Sequence[Complaint]) -> Iterator[RenderableType]:
    if not complaints:
        return
    yield ""
    yield _text("not ok", "bold")
    yield _pairs((f"  {c.count} {c.status}", f"{c.reason} ({_places(c)})") for c in complaints[:REASONS_SHOWN])
    if len(complaints) > REASONS_SHOWN:
        yield _text(f"  and {len(complaints) - REASONS_SHOWN} more reasons")


def _places(complaint: Complaint) -> str:
    """Where the first few rows are: "p020 at 1.2, 1.5 Hz, p130 at 1.2 Hz, ..."."""
    by_point: dict[str, list[str]] = {}
    for op_id, f_hz in complaint.places:
        by_point.setdefault(op_id, []).append(f"{f_hz:.5g}")
    parts = [f"{op_id} at {', '.join(f_hz)} Hz" for op_id, f_hz in by_point.items()]
    return ", ".join([*parts, *(["..."] if complaint.count > len(complaint.places) else [])])


# How it is laid out


def _text(text: str, style: str = "") -> RenderableType:
    """Text as it is: no markup, nothing that moves the cursor."""
    from rich.text import Text

    return Text("".join(c if c.isprintable() else "?" for c in text), style=style)


def _pairs(pairs: Iterable[tuple[str, str]]) -> RenderableType:
    """Names and values in two columns; a long value wraps within its column."""
    from rich.table import Table

    grid = Table.grid(padding=(0, 1))
    grid.add_column(min_width=10, no_wrap=False)
    grid.add_column(overflow="fold")
    for name, value in pairs:
        grid.add_row(_text(name, "bold"), _text(value))
    return grid


def _value(worst: Worst | None) -> str:
    return "-" if worst is None else f"{worst.value:.2g}"


def _place(worst: Worst | None) -> str:
    return "-" if worst is None else f"{worst.f_hz:.5g}"


def _not_ok(point: PointFacts) -> str:
    return _statuses(Counter({status: n for status, n in point.statuses.items() if status != "ok"}))


class _Column(NamedTuple):
    heading: str
    room: int  # the width of the page from which on the column is shown
    content: Callable[[PointFacts], str]


_COLUMNS = (
    _Column("op", 0, lambda point: point.op_id),
    _Column("MW", 44, lambda point: "-" if point.active_power_mw is None else f"{point.active_power_mw:.4g}"),
    _Column(
        "pu", 44, lambda point: "grid" if point.terminal_voltage_pu is None else f"{point.terminal_voltage_pu:.4g}"
    ),
    _Column("ok", 0, lambda point: str(point.statuses["ok"])),
    _Column("error", 50, lambda point: _value(point.uncertainty)),
    _Column("residual", 66, lambda point: _value(point.residual)),
    _Column("at Hz", 66, lambda point: _place(point.residual)),
    _Column("cond(V)", 80, lambda point: _value(point.cond_v)),
    _Column("at Hz", 92, lambda point: _place(point.cond_v)),
    _Column("not ok", 0, _not_ok),
)


def _lines(facts: Sequence[PointFacts], width: int) -> RenderableType:
    from rich import box
    from rich.table import Table

    shown = [column for column in _COLUMNS if width >= column.room]
    table = Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False, padding=(0, 1, 0, 0))
    for column in shown:
        widest = max(len(column.content(point)) for point in facts)
        table.add_column(column.heading, overflow="fold", min_width=min(widest, width // 4))
    for point in facts:
        table.add_row(*(_text(column.content(point)) for column in shown))
    return table


def _rendered(parts: Iterable[RenderableType], width: int, plain: bool) -> str:
    from rich.console import Console

    console = Console(
        file=io.StringIO(), width=width, force_terminal=not plain, color_system=None if plain else "standard"
    )
    with console.capture() as capture:
        for part in parts:
            console.print(part, highlight=False)
    text = "\n".join(line.rstrip() for line in capture.get().splitlines()) + "\n"
    if not plain:
        return text
    return text.replace("─", "-").encode("ascii", "backslashreplace").decode()
