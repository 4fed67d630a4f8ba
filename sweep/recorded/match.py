"""The manifest on its way back: read, held against its format, and matched with the recordings of its experiments."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from ...plant.errors import SeqsweepError
from ...plant.protocol import Rating, SourceDirection
from ..playback.manifest import FILE_NAME, FORMAT, Experiment, PlayedTone, manifest_violations

LIMIT_BYTES = 64 << 20


class ManifestError(SeqsweepError):
    """A manifest that cannot be used, with the way out."""


class Told(NamedTuple):
    """What a manifest says.

    Attributes
    ----------
    f1_hz : float
        Fundamental it was planned for (Hz).
    amplitude_base : float
        Rated phase peak of what its amplitudes are in (V or A).
    rating : Rating
        Bases.
    op_id : str
        Operating point.
    direction : "load", "generator" or None
        Of the recorded current, where whoever recorded added it.
    experiments : tuple of Experiment
        In the order of the manifest.
    recordings : tuple of str or None
        Name of the recording of each, where whoever recorded added it.
    content : dict
        All of it.
    """

    f1_hz: float
    amplitude_base: float
    rating: Rating
    op_id: str
    direction: SourceDirection | None
    experiments: tuple[Experiment, ...]
    recordings: tuple[str | None, ...]
    content: dict[str, Any]


def read_manifest(path: Path) -> Told:
    """The manifest at ``path``.

    Raises
    ------
    ManifestError
        If it is missing, no JSON, or does not conform; the problems are named.
    """
    if not path.is_file():
        raise ManifestError(f"{path}: no such file")
    if path.stat().st_size > LIMIT_BYTES:
        raise ManifestError(f"{path}: {path.stat().st_size >> 20} MB; no manifest is that long")
    try:
        content = json.loads(path.read_text("utf-8"))
    except (ValueError, RecursionError) as error:
        raise ManifestError(f"{path}: not a JSON file ({error})") from None
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise ManifestError(
            f'{path}: no seqsweep manifest (it does not say "format": "{FORMAT}"); `seqsweep inject` writes them, as '
            f"{FILE_NAME}"
        )
    if problems := manifest_violations(content):
        raise ManifestError(f"{path}: no manifest of this format: {'; '.join(problems[:8])}")
    rating = Rating(content["bases"]["rated_voltage_v"], content["bases"]["rated_power_va"])
    return Told(
        f1_hz=content["f1_hz"],
        amplitude_base=rating.peak_voltage_v if content["amplitude_unit"] == "V" else rating.peak_current_a,
        rating=rating,
        op_id=content["operating_point"]["op_id"],
        direction=content.get("direction"),
        experiments=tuple(_experiment(each) for each in content["experiments"]),
        recordings=tuple(each.get("recording") for each in content["experiments"]),
        content=content,
    )


def _experiment(data: dict[str, Any]) -> Experiment:
    shots = tuple(PlayedTone(**shot) for shot in data["shots"])
    return Experiment(data["file"], shots, data["start_s"], data["settle_s"], data["duration_s"])


def match(told: Told, files: Sequence[Path]) -> tuple[list[tuple[Path, Experiment]], list[str]]:
    """Files with their experiments, and what could not be matched, in words.

    An experiment finds its recording by the name its manifest gives, else by the stem of the file it was played from;
    where nothing matches at all and there are as many recordings as files were played, by order.

    Raises
    ------
    ManifestError
        If nothing matches.
    """
    by_name = {_stem(path.name): path for path in files} | {path.name: path for path in files}
    wanted = zip(told.experiments, told.recordings, strict=True)
    pairs = [(by_name.get(name or "") or by_name.get(_stem(e.file)), e) for e, name in wanted]
    matched = [(path, e) for path, e in pairs if path is not None]
    if not matched:
        return _by_order(told, files), ["recordings are matched with experiments by order"]
    used = {path for path, _ in matched}
    words = [f"no recording of {e.file}" for path, e in pairs if path is None]
    words += [f"{path.name} belongs to no experiment of the manifest: left out" for path in files if path not in used]
    return matched, words


def _stem(name: str) -> str:
    return Path(name).stem


def _by_order(told: Told, files: Sequence[Path]) -> list[tuple[Path, Experiment]]:
    played = list(dict.fromkeys(e.file for e in told.experiments))
    if len(files) != len(played):
        raise ManifestError(
            f"{len(files)} recordings for {len(played)} played files, and no names in common: name the recordings like "
            f'the files they answer ({played[0]}, ...), or add "recording": "NAME" to each experiment of the manifest'
        )
    answer = dict(zip(played, files, strict=True))
    return [(answer[e.file], e) for e in told.experiments]
