"""The manifest that ties recordings to what was injected: read, held against its form, and matched with files."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, PositiveFloat, ValidationError

FORMAT = "seqsweep-manifest"
MANIFEST_LIMIT_BYTES = 64 << 20


class ManifestError(ValueError):
    """A manifest that cannot be used, with the way out."""


class _Part(BaseModel):
    model_config = ConfigDict(extra="ignore", frozen=True)


class Shot(_Part):
    """A tone: the point it serves and where it was injected (Hz, signed), its phase peak (V or A)."""

    f_hz: PositiveFloat
    injected_hz: float
    amplitude: float = Field(ge=0.0)
    phase_rad: float = 0.0


class Experiment(_Part):
    """What one file plays: its shots, all at once, on from ``start_s``, to be believed after ``settle_s``."""

    file: str
    shots: tuple[Shot, ...] = Field(min_length=1)
    start_s: float = 0.0
    settle_s: float = Field(default=0.0, ge=0.0)
    duration_s: float | None = Field(default=None, gt=0.0)
    recording: str | None = None


class Bases(_Part):
    rated_voltage_v: PositiveFloat
    rated_power_va: PositiveFloat


class Manifest(_Part):
    """See the page on recordings. ``direction`` may be added: that of the recorded current."""

    format: Literal["seqsweep-manifest"]
    version: str = Field(pattern=r"^1\.\d+\.\d+$")
    f1_hz: PositiveFloat
    amplitude_unit: Literal["V", "A"] = "V"
    bases: Bases
    operating_point: dict[str, Any] = Field(default_factory=dict)
    experiments: tuple[Experiment, ...] = Field(min_length=1)
    direction: Literal["load", "generator"] | None = None

    @property
    def op_id(self) -> str:
        return str(self.operating_point.get("op_id", "recorded"))


def read_manifest(path: Path) -> Manifest:
    """The manifest at ``path``.

    Raises
    ------
    ManifestError
        If it is missing, no JSON, of another format or version, or lacks something; every problem is named.
    """
    if not path.is_file():
        raise ManifestError(f"{path}: no such file")
    if path.stat().st_size > MANIFEST_LIMIT_BYTES:
        raise ManifestError(f"{path}: {path.stat().st_size >> 20} MB; no manifest is that long")
    try:
        content = json.loads(path.read_text("utf-8"))
        return Manifest.model_validate(content)
    except ValidationError as error:
        problems = (f"{'.'.join(map(str, e['loc'])) or 'manifest'}: {e['msg']}" for e in error.errors()[:8])
        raise ManifestError(f"{path}: " + "; ".join(problems)) from None
    except (ValueError, RecursionError) as error:
        raise ManifestError(f"{path}: not a JSON file ({error})") from None


def match(manifest: Manifest, files: Sequence[Path]) -> tuple[list[tuple[Path, Experiment]], list[str]]:
    """Files with their experiments, and what could not be matched, in words.

    An experiment finds its recording by ``recording`` (a file name), else by the stem of its own file; where no
    stem matches at all and the numbers are equal, by order.

    Raises
    ------
    ManifestError
        If nothing matches.
    """
    by_name = {path.name: path for path in files} | {path.stem: path for path in files}
    pairs = [(by_name.get(e.recording or "") or by_name.get(Path(e.file).stem), e) for e in manifest.experiments]
    matched = [(path, e) for path, e in pairs if path is not None]
    if not matched:
        if len(files) != len(manifest.experiments):
            raise ManifestError(
                f"{len(files)} recordings for {len(manifest.experiments)} experiments, and no names in common: name "
                f"the recordings like the files they play ({manifest.experiments[0].file}, ...), or add "
                '"recording": "NAME" to each experiment of the manifest'
            )
        return list(zip(files, manifest.experiments, strict=True)), ["recordings are matched with experiments by order"]
    used = {path for path, _ in matched}
    words = [f"no recording of {e.file}" for path, e in pairs if path is None]
    words += [f"{path.name} belongs to no experiment of the manifest: left out" for path in files if path not in used]
    return matched, words
