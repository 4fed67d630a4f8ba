"""Tables out to other tools and in from them: the bodies of ``seqsweep export`` and ``seqsweep import``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ...identify.exchange.convert import outgoing, to_table
from ...identify.exchange.facts import ExchangeError, Facts, Found, check_file
from ...identify.response import Frame, FrequencyResponse
from ...identify.table.read import read_table
from ...identify.table.write import write_table
from ...plant.errors import SeqsweepError
from ...plant.foreign.sandbox import apart

SUFFIXES = {
    **{".csv": "csv", ".tsv": "csv", ".txt": "csv"},
    **{".mat": "mat"},
    **{".s2p": "touchstone", ".ts": "touchstone"},
}
"""Formats by the suffix of a file."""

FORMATS = ("csv", "mat", "touchstone")

READ_ONLY = {".xlsx": "xlsx", ".xlsm": "xlsx"}
"""Formats that are read and not written."""


class UnknownFormat(SeqsweepError):
    """A file whose format neither its suffix nor an option says."""


def format_of(path: Path, chosen: str | None, reading: bool = False) -> str:
    """The format a file has or is to have; the option wins over the suffix."""
    suffixes = {**SUFFIXES, **READ_ONLY} if reading else SUFFIXES
    formats = dict.fromkeys((*FORMATS, *suffixes.values()))
    if chosen is not None and chosen not in formats:
        raise UnknownFormat(f"--format {chosen!r}: known are {', '.join(formats)}")
    found = chosen or suffixes.get(path.suffix.lower())
    if found is None:
        raise UnknownFormat(f"{path}: its suffix says no format; known are {', '.join(suffixes)}, or give --format")
    return found


def export_table(
    table: Path, output: Path, kind: str, op_id: str | None = None, frame: Frame = "pn", z0_ohm: float | None = None
) -> str:
    """Write ``table`` in another format; what was written, and what was left out, in words."""
    content = read_table(table)
    responses = content.responses if op_id is None else (content.response(op_id),)
    return written(responses, content.meta, output, kind, frame, z0_ohm)


def written(
    responses: Sequence[FrequencyResponse],
    meta: Mapping[str, Any],
    output: Path,
    kind: str,
    frame: Frame,
    z0_ohm: float | None,
) -> str:
    """Write responses of a table in another format; what was written, and what was left out, in words."""
    out = outgoing(responses, meta, frame)
    if kind == "csv":
        from ...identify.exchange.text import write_csv

        write_csv(output, out)
        left_out = 0
    elif kind == "mat":
        from ...identify.exchange.mat import write_mat

        write_mat(output, out)
        left_out = 0
    else:
        from ...identify.exchange.touchstone import write_touchstone

        write_touchstone(output, out, z0_ohm)
        left_out = sum(int((~response.ok).sum()) for response in out.responses)
    names = ", ".join(str(response.meta["op_id"]) for response in out.responses)
    rows = sum(len(response) for response in out.responses) - left_out
    text = f"{output}: {names}, {rows} rows, {frame} frame, current into the device"
    return f"{text}; {left_out} rows that are not ok left out" if left_out else text


def import_file(path: Path, output: Path, kind: str, given: Facts) -> str:
    """Write the table of another tool's file; how it was read, in words."""
    found = read_apart(path, kind, given)
    responses, meta = to_table(found, path)
    write_table(output, responses, meta)
    rows = sum(len(response) for response in responses)
    return f"{output}: {rows} rows from {path}, read as {_in_words(found.facts)}{_turned(found)}"


def read_apart(path: Path, kind: str, given: Facts) -> Found:
    """`read_file` in a process of its own: what a damaged file does to its reader happens there."""
    check_file(path)
    absolute = path.absolute()
    try:
        found: Found = apart(absolute, f"{__name__}:read_here", str(absolute), kind, dict(given))
    except SeqsweepError as error:
        raise ExchangeError(str(error).replace(str(absolute), str(path))) from None
    return found


def read_here(path: str, kind: str, given: Facts) -> Found:
    """`read_file` by the path's text."""
    return read_file(Path(path), kind, given)


def read_file(path: Path, kind: str, given: Mapping[str, Any]) -> Found:
    """What a file of one of `FORMATS` holds."""
    if kind == "csv":
        from ...identify.exchange.text import read_csv

        return read_csv(path, given)
    if kind == "mat":
        from ...identify.exchange.mat import read_mat

        return read_mat(path, given)
    if kind == "touchstone":
        from ...identify.exchange.touchstone import read_touchstone

        return read_touchstone(path, given)
    if kind == "xlsx":
        from ...identify.exchange.workbook import read_workbook

        return read_workbook(path, given)
    raise ExchangeError(f"format {kind!r}; known are {', '.join(FORMATS)} and xlsx")


def _in_words(facts: Facts) -> str:
    frame = facts["frame"]
    if frame == "dq":
        frame = f"dq (q {facts.get('q_axis', 'leading')} d)"
    return f"{facts['quantity']} in {frame}, {facts['direction']} direction, f1 = {facts['f1_hz']:g} Hz"


def _turned(found: Found) -> str:
    """What is to be said where rows were taken at another frequency than the file's."""
    shift = float(found.facts["f1_hz"]) if found.facts["frame"] == "dq" else 0.0
    below = sum(int((sheet.f_hz + shift < 0.0).sum()) for sheet in found.sheets)
    return f"; {below} rows below 0 Hz (pn frame) are taken at their mirrors 2 f1 - f" if below else ""
