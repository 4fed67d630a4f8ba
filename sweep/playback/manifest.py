"""The manifest of perturbation files: which tones are played when, and which rows of the table they serve.

``schema/seqsweep-manifest-1.schema.json`` is the format. `inject` writes it beside the files; whoever
records the answers hands it on together with the recordings, and may add what only they know: the
``direction`` of the recorded current, and which ``recording`` belongs to an experiment.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

from ...plant.protocol import InjectionKind

FORMAT = "seqsweep-manifest"
VERSION = "1.0.0"
FILE_NAME = "manifest.json"
SCHEMA_FILE = Path(__file__).parents[1] / "schema" / "seqsweep-manifest-1.schema.json"
AMPLITUDE_UNIT: dict[InjectionKind, str] = {"series_voltage": "V", "shunt_current": "A"}


class PlayedTone(NamedTuple):
    """A tone and the row it serves: ``amplitude exp(j (2 pi injected_hz t + phase_rad))``, t in the file."""

    f_hz: float
    injected_hz: float
    amplitude: float
    phase_rad: float


@dataclass(frozen=True, slots=True)
class Experiment:
    """Tones that are played together, in a stretch of a file.

    Attributes
    ----------
    file : str
        Name of a file beside the manifest.
    shots : tuple of PlayedTone
        What is played.
    start_s, settle_s, duration_s : float
        The tones play from ``start_s`` on, counted from the file's first sample; the part to evaluate
        begins ``settle_s`` later and lasts ``duration_s`` (s).
    """

    file: str
    shots: tuple[PlayedTone, ...]
    start_s: float
    settle_s: float
    duration_s: float

    @property
    def end_s(self) -> float:
        """When the tones end."""
        return self.start_s + self.settle_s + self.duration_s


@dataclass(frozen=True, slots=True)
class Manifest:
    """What was written for one operating point.

    Attributes
    ----------
    f1_hz, sample_rate_hz : float
        Fundamental and sample rate (Hz).
    kind : "series_voltage" or "shunt_current"
        How it perturbs; amplitudes are phase peaks in V or A.
    rated_voltage_v, rated_power_va : float
        The bases (V line-to-line RMS, VA).
    operating_point : mapping
        ``op_id``, ``active_power_mw``, ``terminal_voltage_pu``.
    experiments : tuple of Experiment
        File after file, in the order of time.
    configuration : mapping
        The whole campaign.
    """

    f1_hz: float
    sample_rate_hz: float
    kind: InjectionKind
    rated_voltage_v: float
    rated_power_va: float
    operating_point: Mapping[str, Any]
    experiments: tuple[Experiment, ...]
    configuration: Mapping[str, Any]

    def to_dict(self) -> dict[str, Any]:
        """The JSON of the manifest."""
        return {
            "format": FORMAT,
            "version": VERSION,
            "f1_hz": self.f1_hz,
            "sample_rate_hz": self.sample_rate_hz,
            "kind": self.kind,
            "amplitude_unit": AMPLITUDE_UNIT[self.kind],
            "bases": {"rated_voltage_v": self.rated_voltage_v, "rated_power_va": self.rated_power_va},
            "operating_point": dict(self.operating_point),
            "experiments": [
                {**asdict(experiment), "shots": [shot._asdict() for shot in experiment.shots]}
                for experiment in self.experiments
            ],
            "configuration": dict(self.configuration),
        }


def manifest_violations(data: Any) -> list[str]:
    """Everything that is wrong with the JSON of a manifest; an empty list says that it conforms."""
    import jsonschema

    validator = jsonschema.Draft202012Validator(json.loads(SCHEMA_FILE.read_text(encoding="utf-8")))
    errors = sorted(validator.iter_errors(data), key=lambda error: error.json_path)
    if errors:
        return [f"{error.json_path}: {error.message[:200]}" for error in errors]
    return [*_tones(data), *_order(data)]


def _tones(data: Mapping[str, Any]) -> Iterator[str]:
    if AMPLITUDE_UNIT[data["kind"]] != data["amplitude_unit"]:
        yield f"amplitudes of a {data['kind']} in {data['amplitude_unit']}; needed: {AMPLITUDE_UNIT[data['kind']]}"
    f1_hz, nyquist_hz = data["f1_hz"], 0.5 * data["sample_rate_hz"]
    for number, experiment in enumerate(data["experiments"]):
        for shot in experiment["shots"]:
            f, at = shot["f_hz"], shot["injected_hz"]
            if min(abs(at - f), abs(at - (2.0 * f1_hz - f))) > 1e-9 * (f + f1_hz):
                yield f"experiment {number}: {at:g} Hz is neither {f:g} Hz nor its mirror {2.0 * f1_hz - f:g} Hz"
            if abs(at) >= nyquist_hz:
                yield f"experiment {number}: {at:g} Hz is not below half the sample rate, {nyquist_hz:g} Hz"


def _order(data: Mapping[str, Any]) -> Iterator[str]:
    """Stretches of one file must follow one another."""
    stretches = [(each["file"], each["start_s"], each["settle_s"] + each["duration_s"]) for each in data["experiments"]]
    for number, (before, after) in enumerate(pairwise(stretches), start=1):
        end_s = before[1] + before[2]
        if before[0] == after[0] and after[1] < end_s - 1e-9:
            yield f"experiment {number} begins at {after[1]:g} s, before the last one ends at {end_s:g} s"
