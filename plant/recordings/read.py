"""`read_recording`: one function, many formats. A reader is one file and one `register_reader` line."""

from __future__ import annotations

import importlib
from pathlib import Path

from ..foreign.layout import LayoutError
from .recording import Recording, RecordingError

_readers: dict[str, str] = {}


def register_reader(suffixes: str, target: str) -> None:
    """Let files with these suffixes (such as ".cfg .cff") be read by ``target``, a "module:function" beside this."""
    for suffix in suffixes.split():
        _readers[suffix] = target


def known_suffixes() -> tuple[str, ...]:
    """Suffixes of the files that can be read, sorted."""
    return tuple(sorted(_readers))


def read_recording(path: str | Path, *, sample_rate_hz: float | None = None) -> Recording:
    """Open a recording; its suffix decides the format.

    Parameters
    ----------
    path : path
        COMTRADE (.cfg or .cff; a .dat stands for its .cfg), CSV or TSV, PSCAD (.inf or .out), Parquet,
        MATLAB, HDF5, TDMS or MDF4. Files are data: nothing in them is executed or unpickled.
    sample_rate_hz : float, optional
        Samples per second where the file has no time, or a wrong one; it overrules the file.

    Raises
    ------
    RecordingError
        If the file is missing, of no known format, damaged, or has no uniform time.
    """
    path = Path(path)
    check_file(path, sample_rate_hz)
    target = _readers[path.suffix.lower()]
    module, name = target.split(":")
    try:
        recording: Recording = getattr(importlib.import_module(f".{module}", __package__), name)(path, sample_rate_hz)
    except LayoutError as error:
        raise RecordingError(str(error)) from None
    if recording.n_samples < 2 or not recording.channels:
        raise RecordingError(f"{path}: {len(recording.channels)} channels of {recording.n_samples} samples: no data")
    return recording


def check_file(path: Path, sample_rate_hz: float | None) -> None:
    """Refuse what no reader can open; raises `RecordingError`."""
    if not path.exists():
        raise RecordingError(f"{path}: no such file")
    if not path.is_file():
        raise RecordingError(f"{path}: not a file; for a folder name its files, or use its name with `identify`")
    if sample_rate_hz is not None and not sample_rate_hz > 0.0:
        raise RecordingError(f"a sample rate of {sample_rate_hz:g} Hz is none: a positive number is needed")
    if path.suffix.lower() not in _readers:
        raise RecordingError(f"{path}: no reader for {path.suffix or 'a file without suffix'!r}; known are {_known()}")


def recordings_in(path: str | Path) -> list[Path]:
    """What `read_recording` can open in a folder, sorted by name; a file stands for itself and its runs.

    A COMTRADE pair counts once, a PSCAD case once per run.
    """
    path = Path(path)
    if not path.is_dir():
        from .pscad_files import runs_of

        return runs_of(path) if path.suffix.lower() == ".inf" else [path]
    found = sorted(p for p in path.iterdir() if p.is_file() and p.suffix.lower() in _readers and p.name[0] != ".")
    taken = {p.with_suffix("").name.lower() for p in found if p.suffix.lower() in (".cfg", ".inf")}
    alone = [p for p in found if not (p.suffix.lower() in (".dat", ".out") and _stem(p) in taken)]
    return [each for p in alone for each in (recordings_in(p) if p.suffix.lower() == ".inf" else [p])]


def _stem(path: Path) -> str:
    """Name without suffix and, for PSCAD, without the number of the file; then without the run."""
    import re

    name = path.with_suffix("").name.lower()
    return re.sub(r"(_r\d{5})?_\d{2}$", "", name) if path.suffix.lower() == ".out" else name


def _known() -> str:
    return ", ".join(known_suffixes())


register_reader(".cfg .cff .dat", "comtrade_files:read")
register_reader(".csv .tsv .txt", "text_files:read")
register_reader(".inf .out", "pscad_files:read")
register_reader(".parquet", "parquet_files:read")
register_reader(".mat", "matlab_files:read")
register_reader(".h5 .hdf5", "hdf5_files:read")
register_reader(".tdms", "tdms_files:read")
register_reader(".mf4", "mdf_files:read")
