"""PSCAD: descriptors in ``case.inf``, ten channels in each of ``case_01.out``, ``case_02.out``, ...

Runs of one case are called ``case_r00001_01.out``. Descriptors need not be in order: ``PGB(n)`` is column
(n - 1) % 10 + 1 of file (n - 1) // 10 + 1.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from ..foreign.clean_text import FORTRAN, Mending, decoded
from .names import base_from
from .number_table import Columns, read_numbers, refuse_too_large, unfit_note
from .recording import Channel, Recording, RecordingError, in_memory

PER_FILE = 10
LONGEST_LINE = 8192
_DESCRIPTOR = re.compile(r'PGB\((\d+)\)\s+Output\s+Desc="([^"]*)"(.*)', re.IGNORECASE)
_OUT = re.compile(r"^(?P<case>.+?)(?P<run>_r\d+)?_(?P<number>\d{2,})$")


def read(path: Path, sample_rate_hz: float | None) -> Recording:
    """Open one run of a PSCAD case, named by its .inf or any of its .out files (see `read_recording`)."""
    inf, prefix = _case(path)
    channels = _descriptors(inf)
    files = sorted({(number - 1) // PER_FILE + 1 for number in channels})
    tables = {k: _out(_out_path(prefix, k)) for k in files}
    _refuse_different_times(prefix, tables)
    first = tables[files[0]]
    n_rows = min(len(table) for table in tables.values())
    base = base_from(path, Channel("time", "s"), [first[:n_rows, 0]], sample_rate_hz)
    found = {
        number: channel for number, channel in channels.items() if _column(number) < tables[_file(number)].shape[1]
    }
    numbers = sorted(found)
    parts = {number: tables[_file(number)][:n_rows, _column(number)] for number in numbers}
    stored = in_memory([np.array([parts[number] for number in numbers]).T])
    absent = [channels[number].name for number in sorted(set(channels) - set(found))]
    notes = (f"no column for {', '.join(absent[:6])}",) if absent else ()
    shorter = any(len(table) > n_rows for table in tables.values())
    return Recording(
        path=path,
        format="PSCAD",
        channels=tuple(found[number] for number in numbers),
        n_samples=n_rows,
        t0_s=base.t0_s,
        dt_s=base.dt_s,
        samples=stored,
        notes=(*notes, *(("files of different lengths: cut to the shortest",) if shorter else ()), *base.notes),
    )


def runs_of(inf: Path) -> list[Path]:
    """The first .out of every run of a case; the .inf itself where there are no runs."""
    runs: dict[str, Path] = {}
    for path in inf.parent.glob(f"{_escaped(inf.stem)}_r*_*.out"):
        found = _OUT.match(path.stem)
        if found and found["case"] == inf.stem and found["run"]:
            runs[found["run"]] = min(runs.get(found["run"], path), path)
    return [runs[run] for run in sorted(runs)] or [inf]


def _escaped(name: str) -> str:
    return re.sub(r"([\[\]*?])", r"[\1]", name)


def _case(path: Path) -> tuple[Path, Path]:
    """Descriptor file, and what the names of its .out files begin with."""
    if path.suffix.lower() == ".inf":
        runs = runs_of(path)
        if runs != [path] and not path.with_name(f"{path.stem}_01.out").exists():
            names = ", ".join(run.name for run in runs[:4])
            raise RecordingError(f"{path}: {len(runs)} runs; name one by its file, such as {names}")
        return path, path.with_suffix("")
    found = _OUT.match(path.stem)
    if found is None:
        raise RecordingError(f"{path}: PSCAD output is called case_01.out or case_r00001_01.out; this is neither")
    run = found["run"] or ""
    prefix = path.with_name(found["case"] + run)
    for stem in (found["case"] + run, found["case"]):
        for suffix in (".inf", ".INF"):
            if (inf := path.with_name(stem + suffix)).is_file():
                return inf, prefix
    raise RecordingError(f"{path}: its descriptors {found['case']}.inf are missing")


def _descriptors(inf: Path) -> dict[int, Channel]:
    text, _ = decoded(inf.read_bytes()[: 8 << 20])
    channels = {}
    for number, name, rest in _DESCRIPTOR.findall(text):
        fields = dict(re.findall(r'(\w+)="([^"]*)"', rest))
        group = fields.get("Group", "")
        channels[int(number)] = (name.strip(), fields.get("Units", "").strip(), group)
    if not channels or 0 in channels:
        raise RecordingError(f"{inf}: no descriptors 'PGB(n) Output Desc=...'")
    names = [name for name, _, _ in channels.values()]
    return {
        number: Channel(name if names.count(name) == 1 else f"{group}:{name}", unit)
        for number, (name, unit, group) in channels.items()
    }


def _file(number: int) -> int:
    return (number - 1) // PER_FILE + 1


def _column(number: int) -> int:
    return (number - 1) % PER_FILE + 1


def _out_path(prefix: Path, number: int) -> Path:
    path = prefix.with_name(f"{prefix.name}_{number:02d}.out")
    if not path.is_file():
        raise RecordingError(f"{path}: missing; the descriptors speak of channels in it")
    return path


def _out(path: Path) -> np.ndarray:
    """Columns (n, 1 + channels) of one file; a first line that holds no numbers is a title."""
    refuse_too_large(path, path.stat().st_size)
    with open(path, "rb") as file:
        lines = [file.readline(LONGEST_LINE) for _ in range(3)]
    numbers = [_n_numbers(line) for line in lines]
    first = next((k for k, n in enumerate(numbers) if n > 1), None)
    if first is None:
        raise RecordingError(f"{path}: no rows of numbers")
    with open(path, "rb") as file:
        for _ in range(first):
            file.readline()
        table = read_numbers(path, file, Columns(["number"] * numbers[first], " ", mending=Mending(squeeze=True)))
    if len(table.unfit) > 1 or not table.parts:
        raise RecordingError(
            f"{path}: {unfit_note(table.unfit, 'the file')}; {numbers[first]} numbers per row are needed"
        )
    return np.concatenate(table.parts)


def _n_numbers(line: bytes) -> int:
    try:
        return len([float(cell) for cell in FORTRAN.sub(b"E", line).split()])
    except ValueError:
        return 0


def _refuse_different_times(prefix: Path, tables: dict[int, np.ndarray]) -> None:
    times = [table[:, 0] for table in tables.values()]
    n = min(len(time) for time in times)
    if any(not np.array_equal(time[:n], times[0][:n]) for time in times):
        raise RecordingError(f"{prefix}: its .out files do not have the same times")
