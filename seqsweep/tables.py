"""Tables in a notebook: written and read, made of recordings and of other tools' files, and handed on to them."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from .identify.exchange.convert import to_table
from .identify.response import Frame, FrequencyResponse
from .identify.table.format import complete_metadata
from .identify.table.read import Table
from .identify.table.write import write_table as write
from .plant.errors import SeqsweepError


def as_table(y: FrequencyResponse | Table | Sequence[FrequencyResponse]) -> Table:
    """The table of some responses, with what ``meta["table"]`` of the first says of all of them."""
    if isinstance(y, Table):
        return y
    responses = (y,) if isinstance(y, FrequencyResponse) else tuple(y)
    shared = responses[0].meta.get("table", {}) if responses else {}
    points = [{key: value for key, value in response.meta.items() if key != "table"} for response in responses]
    return Table({**shared, "operating_points": points}, responses)


def write_table(path: str | Path, y: FrequencyResponse | Table | Sequence[FrequencyResponse]) -> None:
    """Write a response, or a table, as Parquet in the format ``seqsweep-admittance``; what is there is replaced.

    Parameters
    ----------
    path : path
        Replaced atomically.
    y : FrequencyResponse, Table or sequence of FrequencyResponse
        From `sweep`, `identify`, `import_table` or `read_table`; pn frame.

    Raises
    ------
    SeqsweepError
        If nothing is known of the device and its ratings, or the frame is not pn.
    """
    table = as_table(y)
    meta = {key: value for key, value in table.meta.items() if key != "sha256"}
    if "bases" not in meta:
        raise SeqsweepError(
            "this response does not say which device it is of (meta['table']): write what sweep, identify, "
            "import_table or read_table gave"
        )
    write(path, table.responses, meta)


def identify(
    files: str | Path | Iterable[str | Path],
    *,
    manifest: str | Path | None = None,
    direction: Literal["load", "generator"] | None = None,
    channels: Mapping[str, str] | None = None,
    f1_hz: float | None = None,
    sample_rate_hz: float | None = None,
    rated_voltage_v: float | None = None,
    rated_power_va: float | None = None,
    op_id: str | None = None,
    stable_on: str | None = None,
    output: str | Path | None = None,
    jobs: int | None = None,
) -> FrequencyResponse:
    """The 2x2 admittance of a device that was perturbed and recorded.

    Parameters
    ----------
    files : path or paths
        Recordings, or folders of them: COMTRADE, PSCAD, MATLAB, CSV, HDF5, Parquet, TDMS, MDF4.
    manifest : path, optional
        What ``seqsweep inject`` wrote beside the perturbation files.
    direction : "load" or "generator", optional
        Sign of the recorded current: positive into the device, or out of it. The manifest may say it.
    channels : mapping, optional
        Which channel is which, such as ``{"va": "V1"}``; the others are found.
    f1_hz : float, optional
        Nominal fundamental (Hz); found where it is not given.
    sample_rate_hz : float, optional
        Of files that have no time of their own (Hz).
    rated_voltage_v, rated_power_va : float, optional
        Rating (V line-to-line RMS, VA); without it one per unit is what was recorded.
    op_id : str, optional
        Name of the operating point.
    stable_on : str, optional
        Where the device was seen to be stable: "ideal", or R+jX in ohm at f1.
    output : path, optional
        A table to write as well.
    jobs : int, optional
        Workers; as many as there are processors unless given.

    Warns
    -----
    UserWarning
        Of everything a person should know: channels chosen, files left out.
    """
    from .sweep.recorded.identify import identified, request_of

    request = request_of(
        [Path(file) for file in ([files] if isinstance(files, str | Path) else files)],
        None if manifest is None else Path(manifest),
        ",".join(f"{name}={channel}" for name, channel in (channels or {}).items()),
        direction,
        "auto" if f1_hz is None else repr(f1_hz),
        sample_rate_hz,
        (rated_voltage_v, rated_power_va),
        op_id,
        stable_on,
    )
    found = identified(request, jobs=jobs or os.cpu_count() or 1, say=_warn)
    return _kept([found.response], found.meta, output)[str(found.response.meta["op_id"])]


def import_table(
    path: str | Path,
    *,
    format: Literal["csv", "mat", "touchstone"] | None = None,
    output: str | Path | None = None,
    **facts: Any,
) -> Table:
    """The table of another tool's file.

    Parameters
    ----------
    path : path
        CSV or other text, ``.mat`` or Touchstone.
    format : str, optional
        Where the suffix does not say it.
    output : path, optional
        A table to write as well.
    **facts
        What the file does not say and nobody may guess: ``frame``, ``direction``, ``f1_hz``, ``quantity``, ``unit``,
        ``rated_voltage_v``, ``rated_power_va``, ``op_id``, ...; the error names the one that is missing.
    """
    from .sweep.cli.exchange import format_of, read_apart

    responses, meta = to_table(read_apart(Path(path), format_of(Path(path), format), facts), path)
    return _kept(responses, meta, output)


def export(
    y: FrequencyResponse | Table | Sequence[FrequencyResponse],
    path: str | Path,
    *,
    format: Literal["csv", "mat", "touchstone"] | None = None,
    frame: Frame = "pn",
    z0_ohm: float | None = None,
) -> None:
    """Write a response, or a table, for other tools: CSV, MATLAB (frd-ready) or Touchstone, by the suffix of ``path``.

    ``z0_ohm`` is the reference impedance of Touchstone (ohm), U^2/S unless given.
    """
    from .sweep.cli.exchange import format_of, written

    table = as_table(y)
    written(
        table.responses, complete_metadata(_plain(table.meta)), Path(path), format_of(Path(path), format), frame, z0_ohm
    )


def _plain(meta: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in meta.items() if key != "sha256"}


def _kept(responses: Sequence[FrequencyResponse], meta: Mapping[str, Any], output: str | Path | None) -> Table:
    """The table in memory, as `read_table` would give it; on the disk as well where ``output`` says so."""
    if output is not None:
        write(output, responses, meta)
    return table_of(responses, meta)


def table_of(responses: Sequence[FrequencyResponse], meta: Mapping[str, Any]) -> Table:
    """What `read_table` would give of a file with these responses and this metadata, which is completed."""
    completed = complete_metadata(meta)
    entries = {point["op_id"]: point for point in completed["operating_points"]}
    named = [replace(each, meta={**entries[each.meta["op_id"]], **each.meta}) for each in responses]
    return Table(completed, tuple(named))


def _warn(text: str) -> None:
    import warnings

    warnings.warn(text, UserWarning, stacklevel=2)
