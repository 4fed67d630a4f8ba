"""The command `show`: a table summarised, its values at asked frequencies, its Bode plot."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .shared import TableFile, WrongInput, check_plot
from .telling import columns, remark, result

if TYPE_CHECKING:
    from ...identify.views.asked import Look, Value


def show(
    table: TableFile,
    op: Annotated[str | None, typer.Option(metavar="ID", help="Only this operating point.")] = None,
    at: Annotated[
        list[str] | None, typer.Option(metavar="HZ[,HZ...]", help="The 2x2 at these frequencies; repeatable.")
    ] = None,
    plot: Annotated[Path | None, typer.Option(metavar="FILE", help="Bode plot: .png, .svg or .pdf.")] = None,
    impedance: Annotated[bool, typer.Option("--impedance", help="Z in ohm in place of Y in S.")] = False,
    frame: Annotated[str, typer.Option(metavar="pn|dq", help="pn at f, or dq at f - f1.")] = "pn",
    axes: Annotated[str, typer.Option(metavar="log|db|linear", help="Axes of the Bode plot.")] = "log",
) -> None:
    """Summarise a table; with --at print its values there, with --plot draw its Bode plot."""
    from ...identify.views.asked import Look

    for option, given, known in (("--frame", frame, ("pn", "dq")), ("--axes", axes, ("log", "db", "linear"))):
        if given not in known:
            raise WrongInput(f"{option} {given!r}: known are {', '.join(known)}")
    if plot is None and axes != "log":
        raise WrongInput("--axes are those of the Bode plot: it goes with --plot FILE")
    if plot is None and not at and (impedance or frame == "dq"):
        raise WrongInput("--impedance and --frame say how values are shown: they go with --at HZ or --plot FILE")
    check_plot(plot)
    look = Look(impedance, frame == "dq", axes)  # type: ignore[arg-type]
    if at:
        _tell_values(table, op, _frequencies(at), look)
    else:
        _tell_summary(table, op)
    if plot is not None:
        from ...identify.views.bode import bode

        drawn = bode(table, plot, op, look)
        remark(f"{plot}: operating point{'s' if len(drawn) > 1 else ''} {', '.join(drawn)}")


def _tell_summary(table: Path, op: str | None) -> None:
    from ..report.summary import summary, summary_values

    terminal = sys.stdout.isatty()
    result(lambda: summary(table, columns(), not terminal, op).rstrip("\n"), lambda: summary_values(table, op))


def _frequencies(texts: Sequence[str]) -> list[float]:
    try:
        found = [float(part) for text in texts for part in text.split(",")]
    except ValueError:
        found = []
    if not found or not all(isfinite(f) for f in found):
        raise WrongInput(
            f"--at {','.join(texts)!r}: needed are numbers in Hz, separated by commas, such as 77 or 20,77"
        )
    return found


def _tell_values(table: Path, op: str | None, f_hz: Sequence[float], look: Look) -> None:
    from ...identify.table.read import read_table
    from ...identify.views.asked import value_at

    content = read_table(table)
    responses = content.responses if op is None else (content.response(op),)
    found = [
        (str(response.meta["op_id"]), response.f1_hz, value_at(response, f, look))
        for response in responses
        for f in f_hz
    ]
    result(
        lambda: "\n\n".join("\n".join(_lines(op_id, f1, value, look)) for op_id, f1, value in found),
        lambda: [_json(op_id, f1, value, look) for op_id, f1, value in found],
    )


def _lines(op_id: str, f1_hz: float, value: Value, look: Look) -> Iterator[str]:
    yield f"{op_id} at {value.f_hz:.6g} Hz, {_second(f1_hz, value, look)}"
    if value.between_hz is not None:
        low, high = value.between_hz
        yield f"between the rows at {low:.6g} and {high:.6g} Hz; the interpolation is off by about {value.error:.1e}"
    size, re, im = (f"{word} ({look.unit})" for word in ("size", "re", "im"))
    yield f"{'':4}{size:>12}{'dB':>9}{'deg':>9}{re:>14}{im:>14}{'+- 95 %':>10}"
    for name, y, half in _elements(value, look):
        magnitude, angle = _polar(y)
        polar = f"{magnitude:12.5g}{_decibels(magnitude):>9}{angle:9.2f}"
        yield f"{name:4}{polar}{y.real:14.5g}{y.imag:14.5g}{_half(half):>10}"


def _second(f1_hz: float, value: Value, look: Look) -> str:
    if look.dq:
        return f"in dq at |f - f1| = {abs(value.f_hz - f1_hz):.6g} Hz"
    return f"the second component at {2.0 * f1_hz - value.f_hz:.6g} Hz"


def _elements(value: Value, look: Look) -> list[tuple[str, complex, float]]:
    names = [look.symbol + name for name in look.elements]
    return list(zip(names, map(complex, value.y.ravel()), map(float, value.half_95.ravel()), strict=True))


def _polar(y: complex) -> tuple[float, float]:
    from cmath import phase
    from math import degrees

    return abs(y), degrees(phase(y))


def _decibels(size: float) -> str:
    from math import log10

    return f"{20.0 * log10(size):.2f}" if size > 0.0 else "-"


def _half(half: float) -> str:
    return f"{half:.1e}" if half == half else "unknown"


def _json(op_id: str, f1_hz: float, value: Value, look: Look) -> dict[str, Any]:
    return {
        "op_id": op_id,
        "f_hz": value.f_hz,
        "second_hz": 2.0 * f1_hz - value.f_hz,
        "frame": "dq" if look.dq else "pn",
        "quantity": "impedance" if look.impedance else "admittance",
        "unit": look.unit,
        "between_hz": value.between_hz,
        "interpolation_error": value.error,
        "elements": {
            name: {"re": y.real, "im": y.imag, "size": abs(y), "angle_deg": _polar(y)[1], "half_95": half}
            for name, y, half in _elements(value, look)
        },
    }
