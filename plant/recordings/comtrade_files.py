"""COMTRADE (IEEE C37.111 / IEC 60255-24) 1991, 1999, 2013: .cfg with .dat, and .cff.

The configuration is parsed by the package ``comtrade``; samples are read here, in portions, straight
from the file. Values come out on the primary side.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import ceil
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..foreign.cells import Kind
from ..foreign.clean_text import decoded
from .alignment import aligned
from .comtrade_config import clean_lines
from .comtrade_times import NO_STAMP, longest_section, stamps_of, time_base_of, unit_of_stamps_s
from .names import channels_of
from .number_table import Columns, read_numbers, refuse_too_large, unfit_note
from .recording import BLOCK, Channel, Recording, RecordingError, Samples, in_memory

CFG_LIMIT_BYTES = 8 << 20
RAW = {"BINARY": "<i2", "BINARY32": "<i4", "FLOAT32": "<f4"}
MISSING = {"BINARY": -(2**15), "BINARY32": -(2**31), "ASCII": 99999}
LARGEST_FLOAT = 3.4e38
"""FLOAT32 marks a missing sample by the largest number there is."""

_SECTION = re.compile(rb"(?im)^--- file type: *([a-z]+)(?: +([a-z0-9]+))?(?: *: *([0-9]+))? *---[ \t]*\r?\n")


class _Dat(NamedTuple):
    """Where the samples are: file, first byte, number of bytes, format."""

    path: Path
    offset: int
    n_bytes: int
    format: str


def read(path: Path, sample_rate_hz: float | None) -> Recording:
    """Open a COMTRADE recording (see `read_recording`)."""
    text, dat, notes = _cff(path) if path.suffix.lower() == ".cff" else _cfg_and_dat(path)
    cfg, more = _parsed(path, text)
    dat = dat._replace(format=(dat.format or cfg.ft).strip().upper() or "ASCII")
    if dat.format != "ASCII" and dat.format not in RAW:
        raise RecordingError(f"{path}: data format {dat.format!r}; known are ASCII, {', '.join(RAW)}")
    samples, stamps, n_found, found_notes = (_ascii if dat.format == "ASCII" else _binary)(cfg, dat)
    announced = int(cfg.sample_rates[-1][1])
    if n_found < announced:
        found_notes += (f"truncated: {n_found} of the {announced} samples announced are there",)
    elif n_found > announced > 0:
        found_notes += (f"{n_found} samples where {announced} were announced: those beyond are not read",)
    section, section_notes = longest_section(cfg, min(n_found, announced) if announced > 0 else n_found)
    base = time_base_of(path, section, stamps, sample_rate_hz)
    recording = Recording(
        path=path,
        format=f"COMTRADE {cfg.rev_year} {dat.format}",
        channels=_channels(cfg, dat.format),
        n_samples=section.stop - section.start,
        t0_s=base.t0_s,
        dt_s=base.dt_s,
        samples=lambda columns, start, stop: samples(columns, section.start + start, section.start + stop),
        header_f1_hz=cfg.frequency or None,
        notes=(*notes, *more, *found_notes, *section_notes, *base.notes, *_ratios(cfg)),
    )
    if recording.n_samples < 2:
        return recording
    return aligned(recording, [1e-6 * float(each.skew or 0.0) for each in cfg.analog_channels])


# Configuration


def _cfg_and_dat(path: Path) -> tuple[str, _Dat, tuple[str, ...]]:
    cfg, dat = _sibling(path, ".cfg"), _sibling(path, ".dat")
    text, notes = decoded(_small(cfg))
    return text, _Dat(dat, 0, dat.stat().st_size, ""), notes


def _sibling(path: Path, suffix: str) -> Path:
    """The other half of a pair, whatever the case of its suffix."""
    for candidate in (path.with_suffix(suffix), path.with_suffix(suffix.upper()), path.with_suffix(suffix.title())):
        if candidate.is_file():
            return candidate
    raise RecordingError(f"{path}: its {suffix} file is missing; a COMTRADE recording is a pair .cfg and .dat")


def _small(path: Path) -> bytes:
    if path.stat().st_size > CFG_LIMIT_BYTES:
        raise RecordingError(f"{path}: {path.stat().st_size >> 20} MB; no COMTRADE configuration is that long")
    return path.read_bytes()


def _cff(path: Path) -> tuple[str, _Dat, tuple[str, ...]]:
    """Configuration text and place of the samples in a combined file."""
    with open(path, "rb") as file:
        head = file.read(CFG_LIMIT_BYTES)
    sections = list(_SECTION.finditer(head))
    kinds = [match[1].upper() for match in sections]
    if b"CFG" not in kinds or b"DAT" not in kinds:
        raise RecordingError(
            f"{path}: no sections CFG and DAT within the first {CFG_LIMIT_BYTES >> 20} MB: no CFF file"
        )
    dat = sections[kinds.index(b"DAT")]
    cfg = kinds.index(b"CFG")
    end = sections[cfg + 1].start() if cfg + 1 < len(sections) else len(head)
    text, notes = decoded(head[sections[cfg].end() : end])
    size = path.stat().st_size - dat.end()
    n_bytes = min(int(dat[3]), size) if dat[3] and int(dat[3]) else size
    return text, _Dat(path, dat.end(), n_bytes, (dat[2] or b"").decode()), notes


def _parsed(path: Path, text: str) -> tuple[Any, tuple[str, ...]]:
    """The package's configuration object; its strictness about dates must not cost the recording."""
    lines = clean_lines(path, text)
    try:
        return _checked(path, _cfg("\n".join(lines))), ()
    except RecordingError:
        raise
    except Exception as error:
        try:
            return _checked(path, _cfg("\n".join(_undated(lines)))), ("dates could not be read; they are not needed",)
        except RecordingError:
            raise
        except Exception:
            raise RecordingError(f"{path}: not a COMTRADE configuration ({type(error).__name__}: {error})") from None


def _cfg(text: str) -> Any:
    from comtrade import Cfg

    cfg = Cfg(ignore_warnings=True)
    cfg.read(text)
    return cfg


def _undated(lines: list[str]) -> list[str]:
    """The same configuration with dates that any parser takes."""
    _, analog, status = (cell.strip() for cell in lines[1].split(",")[:3])
    first = 4 + int(analog[:-1]) + int(status[:-1])
    at = first + max(1, int(float(lines[first - 1].split(",")[0])))
    plain = "01/01/2000,00:00:00.000000"
    return [*lines[:at], plain, plain, *lines[at + 2 :]]


def _checked(path: Path, cfg: Any) -> Any:
    if not cfg.analog_channels:
        raise RecordingError(f"{path}: no analog channels")
    ends = [end for _, end in cfg.sample_rates]
    if ends != sorted(ends) or any(rate < 0 for rate, _ in cfg.sample_rates):
        raise RecordingError(f"{path}: sections of the configuration (rate, last sample) do not follow one another")
    return cfg


def _channels(cfg: Any, data_format: str) -> tuple[Channel, ...]:
    analog = cfg.analog_channels
    named = channels_of([each.name for each in analog], [each.uu.strip() for each in analog])
    return tuple(
        replace(channel, phase=each.ph, limits=_limits(each, data_format))
        for channel, each in zip(named, analog, strict=True)
    )


def _limits(analog: Any, data_format: str) -> tuple[float, float] | None:
    """Ends of the recorder's range, where it has any."""
    if not analog.cmax > analog.cmin or data_format == "FLOAT32":
        return None
    ratio = _ratio(analog)
    return (ratio * (analog.a * analog.cmin + analog.b), ratio * (analog.a * analog.cmax + analog.b))


def _ratio(analog: Any) -> float:
    """Factor to the primary side."""
    on_secondary = analog.pors.strip().upper() == "S" and analog.primary > 0.0 and analog.secondary > 0.0
    return float(analog.primary / analog.secondary) if on_secondary else 1.0


def _ratios(cfg: Any) -> tuple[str, ...]:
    ratios = sorted({_ratio(each) for each in cfg.analog_channels} - {1.0})
    shown = ", ".join(f"{ratio:g}" for ratio in ratios[:6])
    return (f"secondary values, turned to primary by ratios {shown}",) if ratios else ()


# Samples


def _row(cfg: Any, data_format: str) -> np.dtype:
    n_words = ceil(cfg.status_count / 16)
    raw = (RAW[data_format], (cfg.analog_count,))
    return np.dtype([("n", "<u4"), ("t", "<u4"), ("x", *raw), ("status", "<u2", (n_words,))])


def _binary(cfg: Any, dat: _Dat) -> tuple[Samples, Iterator[np.ndarray], int, tuple[str, ...]]:
    """Samples on demand, time stamps (s) in blocks, number of samples, notes."""
    row = _row(cfg, dat.format)
    n_rows, rest = divmod(dat.n_bytes, row.itemsize)
    _refuse_other_rows(cfg, dat, row, n_rows)
    scale, offset = _scales(cfg)
    missing = MISSING.get(dat.format)

    def samples(columns: Sequence[int], start: int, stop: int) -> np.ndarray:
        chosen = list(columns)
        raw = _rows(dat, row, start, stop)["x"]
        raw = raw if chosen == list(range(cfg.analog_count)) else raw[:, chosen]
        values = raw * scale[chosen]
        values += offset[chosen]
        gone = raw == missing if missing is not None else ~(np.abs(raw) <= LARGEST_FLOAT)
        if gone.any():
            values[gone] = np.nan
        return values

    blocks = range(0, n_rows, BLOCK)
    stamps = stamps_of(
        (_rows(dat, row, start, min(start + BLOCK, n_rows))["t"] for start in blocks), unit_of_stamps_s(cfg)
    )
    return samples, stamps, n_rows, (f"{rest} bytes at the end are no whole row",) if rest else ()


def _rows(dat: _Dat, row: np.dtype, start: int, stop: int) -> np.ndarray:
    rows = np.fromfile(dat.path, row, count=stop - start, offset=dat.offset + start * row.itemsize)
    if len(rows) != stop - start:
        raise RecordingError(f"{dat.path}: became shorter while it was read")
    return rows


def _refuse_other_rows(cfg: Any, dat: _Dat, row: np.dtype, n_rows: int) -> None:
    """Sample numbers count up in every row, unless a row is longer or shorter than the configuration says."""
    if n_rows < 2:
        raise RecordingError(f"{dat.path}: {dat.n_bytes} bytes hold {n_rows} rows of {row.itemsize}: no recording")
    several = min(n_rows, 32)
    numbers = _rows(dat, row, 0, several)["n"].astype(np.int64)
    if np.all(np.diff(numbers) == 1) or np.all(numbers == NO_STAMP):
        return
    raise RecordingError(
        f"{dat.path}: rows of {row.itemsize} bytes ({cfg.analog_count} analog, {cfg.status_count} status channels, "
        f"{dat.format}) were announced, but the sample numbers do not count up with them{_true_row(cfg, dat, several)}"
    )


def _true_row(cfg: Any, dat: _Dat, n_rows: int) -> str:
    """What the row length seems to be, for the message."""
    with open(dat.path, "rb") as file:
        file.seek(dat.offset)
        head = file.read(min(dat.n_bytes, 1 << 16))
    for size in range(8, len(head) // 4):
        first = [int.from_bytes(head[k * size : k * size + 4], "little") for k in range(4)]
        if [n - first[0] for n in first] == [0, 1, 2, 3]:
            width = np.dtype(RAW[dat.format]).itemsize
            analog = (size - 8 - 2 * ceil(cfg.status_count / 16)) / width
            return f"; rows of {size} bytes ({analog:g} analog channels of {width} bytes) would fit: correct the .cfg"
    return "; wrong number of channels, another data format, or no COMTRADE data at all"


def _scales(cfg: Any) -> tuple[np.ndarray, np.ndarray]:
    ratio = np.array([_ratio(each) for each in cfg.analog_channels])
    a, b = (np.array([getattr(each, name) for each in cfg.analog_channels]) for name in "ab")
    return ratio * a, ratio * b


def _ascii(cfg: Any, dat: _Dat) -> tuple[Samples, Iterator[np.ndarray], int, tuple[str, ...]]:
    """As `_binary`, with everything in memory."""
    refuse_too_large(dat.path, dat.n_bytes)
    n_columns = 2 + cfg.analog_count + cfg.status_count
    with open(dat.path, "rb") as file:
        file.seek(dat.offset)
        source = file if dat.offset == 0 else io.BytesIO(_until_next_section(file.read(dat.n_bytes)))
        table = read_numbers(dat.path, source, Columns(_kinds(source, n_columns), ","))
    if len(table.unfit) > 1 or not table.parts:
        raise RecordingError(
            f"{dat.path}: rows of {n_columns} numbers were announced ({cfg.analog_count} analog, {cfg.status_count} "
            f"status channels), but rows read {table.unfit[0] if table.unfit else 'nothing'!r}: correct the .cfg"
        )
    scale, offset = _scales(cfg)
    for part in table.parts:
        for k, analog in enumerate(cfg.analog_channels):
            raw = part[:, 2 + k]
            if not MISSING["ASCII"] <= analog.cmax:  # a recorder of that range means the number
                raw[raw == MISSING["ASCII"]] = np.nan
            raw *= scale[k]
            raw += offset[k]
    stored = in_memory([part[:, 2 : 2 + cfg.analog_count] for part in table.parts])
    counts = (np.nan_to_num(part[:, 1], nan=NO_STAMP).clip(0, NO_STAMP) for part in table.parts)
    return stored, stamps_of(counts, unit_of_stamps_s(cfg)), table.n_rows, unfit_note(table.unfit, "the .dat")


def _kinds(source: Any, n_columns: int) -> list[Kind]:
    """Numbers, and a last column of nothing where there is a comma at the end of the rows."""
    start = source.tell()
    line = source.readline(1 << 16).rstrip()
    source.seek(start)
    more: list[Kind] = ["empty"] if line.endswith(b",") and line.count(b",") == n_columns else []
    return [*["number"] * n_columns, *more]  # type: ignore[list-item]


def _until_next_section(raw: bytes) -> bytes:
    following = _SECTION.search(raw)
    return raw[: following.start()] if following else raw
