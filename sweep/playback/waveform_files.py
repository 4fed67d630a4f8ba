"""Files that other tools play back: three phases in columns, at a rate, in the form each of them reads."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from ...identify.files import atomic_file
from .comtrade import AnalogChannel, Encoding, write_comtrade

PlaybackFormat = Literal["csv", "comtrade", "pscad", "mat"]

SUFFIXES: dict[PlaybackFormat, str] = {"csv": ".csv", "comtrade": ".cfg", "pscad": ".txt", "mat": ".mat"}
"""Formats, and what their files end in."""


class Waveforms(NamedTuple):
    """Three phases.

    Attributes
    ----------
    names : tuple of str
        Of the three columns, such as va, vb, vc.
    unit : "V" or "A"
        Of the samples.
    samples : (n, 3) float
        From time zero on.
    rate_hz, f1_hz : float
        Sample rate and fundamental (Hz).
    """

    names: tuple[str, str, str]
    unit: str
    samples: np.ndarray
    rate_hz: float
    f1_hz: float

    @property
    def time_s(self) -> np.ndarray:
        """(n,) time from the first sample on (s)."""
        return np.arange(len(self.samples)) / self.rate_hz


def phases(vector: np.ndarray) -> np.ndarray:
    """Phases a, b, c (n, 3) of a space vector (n,), phase peak: Re x, and a third and two thirds of a turn later."""
    turns = np.exp(-2j * np.pi * np.arange(3) / 3.0)
    return (vector[:, np.newaxis] * turns).real + 0.0  # no negative zeros


def write_waveforms(path: Path, waveforms: Waveforms, kind: PlaybackFormat, encoding: Encoding = "BINARY") -> None:
    """Write one file; ``encoding`` is that of COMTRADE."""
    if kind == "comtrade":
        channels = [
            AnalogChannel(name, phase, waveforms.unit) for name, phase in zip(waveforms.names, "ABC", strict=True)
        ]
        write_comtrade(path, channels, waveforms.samples, waveforms.rate_hz, waveforms.f1_hz, encoding)
        return
    with atomic_file(path) as file:
        {"csv": _csv, "pscad": _pscad, "mat": _mat}[kind](file, waveforms)


def _csv(file: Any, waveforms: Waveforms) -> None:
    header = ",".join(["time [s]", *(f"{name} [{waveforms.unit}]" for name in waveforms.names)])
    table = np.column_stack([waveforms.time_s, waveforms.samples])
    np.savetxt(file, table, fmt=["%.10g", *["%.10g"] * 3], delimiter=",", header=header, comments="")


def _pscad(file: Any, waveforms: Waveforms) -> None:
    """PSCAD's File Read: a comment, then time and up to ten columns. Its wires carry kV and kA."""
    header = f"! time [s], {', '.join(waveforms.names)} [k{waveforms.unit}]"
    table = np.column_stack([waveforms.time_s, waveforms.samples * 1e-3])
    np.savetxt(file, table, fmt="%18.10E", header=header, comments="")


def _mat(file: Any, waveforms: Waveforms) -> None:
    """Simulink's From File: one matrix, the first row time, one row per phase."""
    from ...identify.exchange.mat import mat_bytes

    file.write(mat_bytes({"perturbation": np.vstack([waveforms.time_s, waveforms.samples.T])}))
