"""Tables out to other tools and in from them: the bodies of ``seqsweep export`` and ``seqsweep import``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ...identify.exchange.convert import outgoing, to_table
from ...identify.exchange.facts import ExchangeError, Facts, Found
from ...identify.response import Frame
from ...identify.table.read import read_table
from ...identify.table.write import write_table
from ...plant.errors import SeqsweepError

SUFFIXES = {
    **{".csv": "csv", ".tsv": "csv", ".txt": "csv"},
    **{".mat": "mat"},
    **{".s2p": "touchstone", ".ts": "touchstone"},
}
"""Formats by the suffix of a file."""

FORMATS = ("csv", "mat", "touchstone")


class UnknownFormat(SeqsweepError):
    """A file whose format neither its suffix nor an option says."""


def format_of(path: Path, chosen: str | None) -> str:
    """The format a file has or is to have; the option wins over the suffix."""
    if chosen is not None and chosen not in FORMATS:
        raise UnknownFormat(f"--format {chosen!r}: known are {', '.join(FORMATS)}")
    found = chosen or SUFFIXES.get(path.suffix.lower())
    if found is None:
        raise UnknownFormat(f"{path}: its suffix says no format; known are {', '.join(SUFFIXES)}, or give --format")
    return found


def export_table(
    table: Path, output: Path, kind: str, op_id: str | None = None, frame: Frame = "pn", z0_ohm: float | None = None
) -> str:
    """Write ``table`` in another format; what was written, and what was left out, in words."""
    content = read_table(table)
    responses = content.responses if op_id is None else (content.response(op_id),)
    out = outgoing(responses, content.meta, frame)
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
    found = read_file(path, kind, given)
    responses, meta = to_table(found, path)
    write_table(output, responses, meta)
    rows = sum(len(response) for response in responses)
    return f"{output}: {rows} rows from {path}, read as {_in_words(found.facts)}"


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
    raise ExchangeError(f"format {kind!r}; known are {', '.join(FORMATS)}")


def _in_words(facts: Facts) -> str:
    frame = facts["frame"]
    if frame == "dq":
        frame = f"dq (q {facts.get('q_axis', 'leading')} d)"
    return f"{facts['quantity']} in {frame}, {facts['direction']} direction, f1 = {facts['f1_hz']:g} Hz"
