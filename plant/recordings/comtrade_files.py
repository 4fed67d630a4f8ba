"""COMTRADE (IEEE C37.111 / IEC 60255-24) 1991, 1999, 2013: .cfg with .dat, and .cff.

The configuration is parsed by the package ``comtrade``; samples are read here, in portions, straight
from the file. Values come out on the primary side.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from math import ceil
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..foreign.cells import Kind
from ..foreign.clean_text import decoded
from .alignment import aligned
from .comtrade_config import clean_lines
from .names import channels_of
from .number_table import Columns, read_numbers, refuse_too_large, unfit_note
from .recording import BLOCK, Channel, Recording, RecordingError, Samples, in_memory
from .timebase import TimeBase, time_base

CFG_LIMIT_BYTES = 8 << 20
RAW = {"BINARY": "<i2", "BINARY32": "<i4", "FLOAT32": "<f4"}
MISSING = {"BINARY": -(2**15), "BINARY32": -(2**31), "ASCII": 99999}
LARGEST_FLOAT = 3.4e38
"""FLOAT32 marks a missing sample by the largest number there is."""

NO_STAMP = 0xFFFFFFFF

_SECTION = re.compile(rb"(?im)^--- file type: *([a-z]+)(?: +([a-z0-9]+))?(?: *: *([0-9]+))? *---[ \t]*\r?\n")


class _Dat(NamedTuple):
    """Where the samples are: file, first byte, number of bytes, format."""

    path: Path
    offset: int
    n_bytes: int
    format: str


class _Section(NamedTuple):
    """Samples ``start`` to ``stop`` share one rate (Hz; 0: the time stamps say); None: nobody says when it begins."""

    start: int
    stop: int
    rate_hz: float
    start_s: float | None = 0.0


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
    section, section_notes = _longest(cfg, min(n_found, announced) if announced > 0 else n_found)
    base = _time_base(path, section, stamps, sample_rate_hz)
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
    stamps = _stamps((_rows(dat, row, start, min(start + BLOCK, n_rows))["t"] for start in blocks), _unit_s(cfg))
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


def _unit_s(cfg: Any) -> float:
    """Seconds per unit of a time stamp."""
    unit = float(cfg.time_base * cfg.timemult)
    return unit if np.isfinite(unit) and unit > 0.0 else 1e-6


def _stamps(raw: Iterable[np.ndarray], unit_s: float) -> Iterator[np.ndarray]:
    """Time stamps (s) in blocks, NaN where there is none; 32 bits begin anew when they are full, time does not."""
    turns, last = 0, 0
    for block in raw:
        known = block != NO_STAMP
        count = np.where(known, block, 0).astype(np.int64)
        wraps = np.diff(count, prepend=last) < -(2**31)
        total = count + 2**32 * (turns + np.cumsum(wraps & known))
        if len(block):
            turns, last = int(total[-1] - count[-1]) >> 32, int(count[-1])
        yield np.where(known, total * unit_s, np.nan)


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
    return stored, _stamps(counts, _unit_s(cfg)), table.n_rows, unfit_note(table.unfit, "the .dat")


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


# Time


def _longest(cfg: Any, n_samples: int) -> tuple[_Section, tuple[str, ...]]:
    """The section of one rate with most samples; there may be several rates in a file."""
    sections: list[_Section] = []
    start = 0
    start_s: float | None = 0.0
    for rate, end in cfg.sample_rates:
        stop = min(int(end), n_samples) if end else n_samples
        sections.append(_Section(start, stop, float(rate), start_s))
        start_s = start_s + (stop - start) / rate if start_s is not None and rate > 0.0 else None
        start = stop
    longest = max(sections, key=lambda section: section.stop - section.start)
    if len(sections) == 1:
        return longest, ()
    rates = ", ".join(f"{section.rate_hz:g} Hz x {section.stop - section.start}" for section in sections)
    return longest, (f"several sampling rates ({rates}): only the longest section is used",)


def _time_base(path: Path, section: _Section, stamps: Iterator[np.ndarray], sample_rate_hz: float | None) -> TimeBase:
    """Start and step (s) of a section: as asked, as the configuration claims, or as its time stamps say."""
    if sample_rate_hz is not None:
        note = f"{sample_rate_hz:g} samples per second, as asked"
        return TimeBase(section.start_s or 0.0, 1.0 / sample_rate_hz, (note,))
    mine = _of_section(section, stamps)
    if not section.rate_hz > 0.0:
        return time_base(path, _all_there(path, mine))
    claimed = 1.0 / section.rate_hz
    seen = _seen(mine)
    start_s = section.start_s
    if start_s is None:
        start_s = section.start * claimed if seen is None else seen.first_s
    return TimeBase(start_s, claimed, () if seen is None else _compared(path, section, seen, claimed))


def _of_section(section: _Section, stamps: Iterable[np.ndarray]) -> Iterator[np.ndarray]:
    """Time stamps (s) of a section, in blocks."""
    at = 0
    for block in stamps:
        mine = block[max(0, section.start - at) : max(0, section.stop - at)]
        at += len(block)
        if len(mine):
            yield mine


def _all_there(path: Path, stamps: Iterable[np.ndarray]) -> Iterator[np.ndarray]:
    for block in stamps:
        if not np.all(np.isfinite(block)):
            raise RecordingError(f"{path}: neither a sampling rate nor time stamps: give --sample-rate HZ")
        yield block


class _Seen(NamedTuple):
    """What time stamps (s) say: first and last, their number, the shortest and the longest step, and where they are."""

    first_s: float
    last_s: float
    n: int
    shortest_s: float
    shortest_at: int
    longest_s: float
    longest_at: int


def _seen(stamps: Iterable[np.ndarray]) -> _Seen | None:
    """None where a stamp is missing, or all are the same."""
    seen: _Seen | None = None
    for block in stamps:
        if not np.all(np.isfinite(block)):
            return None
        seen = seen or _Seen(float(block[0]), float(block[0]), 0, np.inf, 0, -np.inf, 0)
        steps = np.diff(block, prepend=seen.last_s)
        least, most = int(np.argmin(steps)), int(np.argmax(steps))
        if seen.n == 0 and len(steps) > 1:
            least, most = 1 + int(np.argmin(steps[1:])), 1 + int(np.argmax(steps[1:]))
        seen = seen._replace(last_s=float(block[-1]), n=seen.n + len(block))
        if steps[least] < seen.shortest_s:
            seen = seen._replace(shortest_s=float(steps[least]), shortest_at=seen.n - len(block) + least)
        if steps[most] > seen.longest_s:
            seen = seen._replace(longest_s=float(steps[most]), longest_at=seen.n - len(block) + most)
    return seen if seen is not None and seen.n > 1 and seen.longest_s > 0.0 else None


def _compared(path: Path, section: _Section, seen: _Seen, claimed_s: float) -> tuple[str, ...]:
    """What is to be said where time stamps and the claimed step disagree.

    Raises
    ------
    RecordingError
        If the stamps run backwards, or leave out a piece.
    """
    if seen.shortest_s < 0.0:
        raise RecordingError(
            f"{path}: time stamps run backwards at sample {section.start + seen.shortest_at + 1}: the file holds "
            "several recordings, or is damaged; cut it there, or give --sample-rate HZ where the stamps mean nothing"
        )
    stamped = (seen.last_s - seen.first_s) / (seen.n - 1)
    if abs(stamped / claimed_s - 1.0) <= 1e-3 and seen.longest_s < 1.5 * claimed_s:
        return ()
    missing_s = seen.last_s - seen.first_s - (seen.n - 1) * claimed_s
    if missing_s > 2.0 * claimed_s and seen.longest_s - claimed_s > 0.9 * missing_s:
        raise RecordingError(
            f"{path}: {seen.longest_s:.6g} s lie between the time stamps of samples {section.start + seen.longest_at} "
            f"and {section.start + seen.longest_at + 1}, where the step is {claimed_s:.6g} s: there is a gap; cut the "
            "file there, or give --sample-rate HZ where the stamps mean nothing"
        )
    if abs(stamped / claimed_s - 1.0) <= 1e-3:
        return ()
    return (
        f"the configuration says {1 / claimed_s:.6g} samples per second, the time stamps {1 / stamped:.6g}: the "
        "former is used; --sample-rate HZ overrules it",
    )
