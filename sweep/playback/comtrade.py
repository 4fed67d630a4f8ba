"""A small writer of COMTRADE (IEEE C37.111-1999 and -2013): one rate, analog channels, no digital ones."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from ...identify.files import atomic_file
from ...plant.errors import SeqsweepError

Encoding = Literal["ASCII", "BINARY", "BINARY32", "FLOAT32"]

_FULL = {"ASCII": 99_998, "BINARY": 32_767, "BINARY32": 2**31 - 1}
"""Largest count; the value beyond it marks a missing sample."""

LONGEST_S = 4000.0
"""Longest file: time stamps have 32 bits."""

_DTYPE = {"BINARY": "<i2", "BINARY32": "<i4", "FLOAT32": "<f4"}
_TIME = "01/01/2000,00:00:00.000000"


class AnalogChannel(NamedTuple):
    """Name, phase ("A", "B", "C" or "") and unit of a channel."""

    name: str
    phase: str
    unit: str


def write_comtrade(
    path: str | Path,
    channels: Sequence[AnalogChannel],
    samples: np.ndarray,
    rate_hz: float,
    f1_hz: float,
    encoding: Encoding = "BINARY",
) -> None:
    """Write ``path`` (.cfg) and its .dat, or both in one where ``path`` ends in .cff.

    Parameters
    ----------
    path : path
        Ends in .cfg or .cff.
    channels : sequence of AnalogChannel
        One per column.
    samples : (n, n_channels) float
        In the channels' units. All but FLOAT32 quantise: each channel's peak is the largest count.
    rate_hz, f1_hz : float
        Sample rate and nominal frequency (Hz); the time stamps, in us, begin at zero.
    encoding : str
        ASCII and BINARY (16 bit) are revision 1999; BINARY32 and FLOAT32, and every .cff, are 2013.

    Raises
    ------
    SeqsweepError
        If shapes disagree, a sample is not finite, or the file is longer than `LONGEST_S`.
    """
    path = Path(path)
    if samples.ndim != 2 or samples.shape[1] != len(channels):
        raise SeqsweepError(f"samples are {samples.shape} for {len(channels)} channels; needed: (n, {len(channels)})")
    if not np.all(np.isfinite(samples)):
        raise SeqsweepError("COMTRADE has no number for NaN or infinity")
    if len(samples) / rate_hz > LONGEST_S:
        raise SeqsweepError(f"{len(samples) / rate_hz:g} s; the time stamps of COMTRADE, in us, end at {LONGEST_S:g} s")
    combined = path.suffix.lower() == ".cff"
    counts, scales = _counts(samples, encoding)
    revision = 2013 if combined or encoding in ("BINARY32", "FLOAT32") else 1999
    configuration = _configuration(channels, counts, scales, rate_hz, f1_hz, encoding, revision)
    data = _data(counts, rate_hz, encoding)
    if combined:
        with atomic_file(path) as file:
            file.write(_combined(configuration, data, encoding))
        return
    for name, content in ((path, configuration), (path.with_suffix(".dat"), data)):
        with atomic_file(name) as file:
            file.write(content)


def _counts(samples: np.ndarray, encoding: Encoding) -> tuple[np.ndarray, np.ndarray]:
    """Numbers as stored, and the factor of each channel that makes them values again."""
    if encoding == "FLOAT32":
        return samples.astype("<f4"), np.ones(samples.shape[1])
    peak = np.abs(samples).max(axis=0, initial=0.0)
    scales = np.where(peak > 0.0, peak, 1.0) / _FULL[encoding]
    return np.rint(samples / scales).astype(int), scales


def _configuration(
    channels: Sequence[AnalogChannel],
    counts: np.ndarray,
    scales: np.ndarray,
    rate_hz: float,
    f1_hz: float,
    encoding: Encoding,
    revision: int,
) -> bytes:
    n = len(channels)
    full = _FULL.get(encoding, 1)
    lines = [f"seqsweep,1,{revision}", f"{n},{n}A,0D"]
    for k, (channel, scale) in enumerate(zip(channels, scales, strict=True), start=1):
        factors = f"{float(scale)!r},0,0,{-full},{full},1,1,P"
        lines.append(f"{k},{channel.name},{channel.phase},,{channel.unit},{factors}")
    lines += [f"{f1_hz:.10g}", "1", f"{rate_hz:.10g},{len(counts)}", _TIME, _TIME, encoding, "1"]
    if revision == 2013:
        lines += ["0,0", "0,0"]
    return "".join(f"{line}\r\n" for line in lines).encode("ascii", "replace")


def _data(counts: np.ndarray, rate_hz: float, encoding: Encoding) -> bytes:
    n = len(counts)
    number, stamp_us = np.arange(1, n + 1), np.rint(np.arange(n) * (1e6 / rate_hz)).astype(int)
    if encoding == "ASCII":
        text = io.StringIO()
        np.savetxt(text, np.column_stack([number, stamp_us, counts]), fmt="%d", delimiter=",", newline="\r\n")
        return text.getvalue().encode("ascii")
    rows = np.zeros(n, [("number", "<u4"), ("stamp_us", "<u4"), ("counts", _DTYPE[encoding], (counts.shape[1],))])
    rows["number"], rows["stamp_us"], rows["counts"] = number, stamp_us, counts
    return rows.tobytes()


def _combined(configuration: bytes, data: bytes, encoding: Encoding) -> bytes:
    size = "" if encoding == "ASCII" else f": {len(data)}"
    heads = ["--- file type: CFG ---", "--- file type: INF ---", "--- file type: HDR ---"]
    cfg, inf, hdr = (f"{head}\r\n".encode() for head in heads)
    return cfg + configuration + inf + hdr + f"--- file type: DAT {encoding}{size} ---\r\n".encode() + data
