"""Tables out of recordings: waveforms with noise, in files beside a manifest, identified as a user's would be."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path

import numpy as np

from seqsweep.identify.response import FrequencyResponse
from seqsweep.plant.protocol import Injection, Job, Rating, Record, Source, Tone
from seqsweep.sweep.playback.manifest import Experiment, Manifest, PlayedTone

from .swept_plants import NoisyPlant

AT_ONCE = 4
"""Tones of one recording."""

SECONDS = 3.0
"""Length of a recording, after half a second in which the modes die out."""

CHANNELS = ("va", "vb", "vc", "ia", "ib", "ic")


def identified(
    plant: NoisyPlant, source: Source, f_hz: np.ndarray, amplitude_pu: float, output: Path
) -> FrequencyResponse:
    """Rows at the frequencies ``f_hz`` (Hz), each tone and its mirror recorded; read where they are there already."""
    from seqsweep.identify.table.read import read_table
    from seqsweep.sweep.recorded.identify import Request, identify

    if not output.exists():
        with tempfile.TemporaryDirectory() as folder:
            shots = _programme(f_hz, plant.f1_hz, amplitude_pu * plant.rating.peak_voltage_v)
            for number, of_file in enumerate(shots):
                _write(_played(plant, source, of_file), Path(folder) / f"{number:02}.parquet")
            manifest = Path(folder) / "manifest.json"
            manifest.write_text(json.dumps(_manifest(plant, shots).to_dict()), "utf-8")
            files = tuple(sorted(Path(folder).glob("*.parquet")))
            rating = Rating(plant.rating.voltage_v, plant.rating.power_va)
            identify(Request(files, manifest=manifest, direction="load", rating=rating), output, jobs=1)
    return read_table(output).responses[0]


def _programme(f_hz: np.ndarray, f1_hz: float, amplitude_v: float) -> list[tuple[PlayedTone, ...]]:
    """Tones of every recording: some frequencies far from each other, then the mirrors of the same."""
    n_files = -(-len(f_hz) // AT_ONCE)
    return [
        tuple(
            PlayedTone(float(f), float(2.0 * f1_hz - f if mirrored else f), amplitude_v, 0.9 * k)
            for k, f in enumerate(f_hz[number::n_files])
        )
        for number in range(n_files)
        for mirrored in (False, True)
    ]


def _manifest(plant: NoisyPlant, shots: list[tuple[PlayedTone, ...]]) -> Manifest:
    experiments = tuple(Experiment(f"{k:02}.parquet", of_file, 0.0, 0.0, SECONDS) for k, of_file in enumerate(shots))
    point = {"op_id": "a", "active_power_mw": 0.5 * plant.rating.power_va / 1e6, "terminal_voltage_pu": 1.0}
    rating = plant.rating
    return Manifest(
        plant.f1_hz,
        1.0 / plant.dt_s,
        "series_voltage",
        rating.voltage_v,
        rating.power_va,
        point,
        experiments,
        {"made_by": "benchmarks/verdicts.py"},
    )


def _played(plant: NoisyPlant, source: Source, shots: tuple[PlayedTone, ...]) -> Record:
    state = plant.settle(None, source)
    tones = tuple(Tone(shot.injected_hz, shot.amplitude, shot.phase_rad) for shot in shots)
    injection = Injection("series_voltage", tones)
    ((settled, _),) = plant.run([Job(state, injection)], round(0.5 / plant.dt_s))
    ((_, record),) = plant.run([Job(settled, injection)], round(SECONDS / plant.dt_s))
    return record


def _write(record: Record, path: Path) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    phases = np.exp(-2j * np.pi * np.arange(3) / 3.0)
    columns = [record.time_s, *(record.v[:, None] * phases).real.T, *(record.i[:, None] * phases).real.T]
    units = ["s", "V", "V", "V", "A", "A", "A"]
    fields = [
        pa.field(name, pa.float64(), metadata={"unit": unit})
        for name, unit in zip(("time", *CHANNELS), units, strict=True)
    ]
    pq.write_table(pa.table(columns, schema=pa.schema(fields)), path)
