"""Make the recordings of this folder anew, byte for byte: ``python data/make.py``.

The reference turbine is perturbed in time on a grid, in two experiments of twelve tones each, at f and at
the mirror; phases of voltage and current at its terminals are written in every format that recordings
come in. The true admittance beside them is not that of the sweep: it comes from the linearisation that
the tests derive on their own.
"""

from __future__ import annotations

import io
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from seqsweep.identify.exchange.mat import mat_bytes
from seqsweep.plant.protocol import Injection, Job, OperatingPoint, Source, Tone
from seqsweep.plant.registry import make_plant
from seqsweep.plant.turbine.parameters import LINE_L_H, LINE_R_OHM
from seqsweep.sweep.playback.comtrade import AnalogChannel, Encoding, write_comtrade
from seqsweep.sweep.playback.manifest import Experiment, Manifest, PlayedTone
from seqsweep.sweep.playback.waveform_files import phases

HERE = Path(__file__).parent

POWER_W, VOLTAGE_V, F1_HZ = 0.65e6, 690.0, 50.0
NU_HZ = (7.5, 12.5, 17.5, 22.5, 27.5, 32.5, 42.5, 57.5, 77.5, 107.5, 132.5, 157.5)
"""|f - f1|: odd multiples of 2.5 Hz, of which none is the sum, difference or double of others."""
F_HZ = tuple(sorted(F1_HZ - nu if nu < F1_HZ else F1_HZ + nu for nu in NU_HZ))
AMPLITUDE_PU = 0.002
PHASES_RAD = tuple(round(float(np.pi * (k * k % 24) / 12.0), 2) for k in range(len(NU_HZ)))  # of low crest factor
STEP_S, EVERY = 50e-6, 20
RATE_HZ = 1000.0  # of the recording: every twentieth step
QUIET_S, SETTLE_S, WINDOW_S = 0.2, 1.1, 0.8
NAMES = ("va", "vb", "vc", "ia", "ib", "ic")
RESOLUTION = 1e-3  # V and A: hides the last digits, in which processors differ


class Recorded(NamedTuple):
    """One experiment: its name, time (s) and phases (n, 6) in V and A, load direction."""

    name: str
    time_s: np.ndarray
    samples: np.ndarray


def main(folder: Path) -> None:
    """Write every file into ``folder``."""
    recordings = [recorded("direct", F_HZ), recorded("mirror", tuple(2.0 * F1_HZ - f for f in F_HZ))]
    for one in recordings:
        for encoding in ("ASCII", "BINARY", "FLOAT32"):
            comtrade(folder / f"comtrade_{encoding.lower()}" / f"{one.name}.cfg", one, encoding)  # type: ignore[arg-type]
        comtrade(folder / "comtrade_cff" / f"{one.name}.cff", one, "BINARY")
        put(folder / "pscad" / f"{one.name}.inf", pscad_descriptors())
        put(folder / "pscad" / f"{one.name}_01.out", pscad_samples(one))
        put(folder / "csv" / f"{one.name}.csv", csv(one))
        put(folder / "parquet" / f"{one.name}.parquet", parquet(one))
        put(folder / "matlab_5" / f"{one.name}.mat", mat_bytes(columns(one)))
        put(folder / "matlab_73" / f"{one.name}.mat", matlab_73(one))
        put(folder / "hdf5" / f"{one.name}.h5", hdf5(one))
    put(folder / "manifest.json", as_json(manifest().to_dict()))
    put(folder / "truth.json", as_json(truth()))


# What is recorded


def recorded(name: str, f_hz: Sequence[float]) -> Recorded:
    """The turbine on its grid: settled, 0.2 s of silence, then all tones at once."""
    plant = make_plant("dpmsg-v1", {"dt_s": STEP_S})
    settled = plant.settle(OperatingPoint(POWER_W, VOLTAGE_V), Source("thevenin", LINE_R_OHM, LINE_L_H))
    amplitude = AMPLITUDE_PU * plant.rating.peak_voltage_v
    tones = tuple(Tone(f, amplitude, phase) for f, phase in zip(f_hz, PHASES_RAD, strict=True))
    begun = round(QUIET_S / STEP_S)
    state, quiet = plant.run([Job(settled, None)], begun)[0]
    _, loud = plant.run([Job(state, Injection("series_voltage", tones))], round((SETTLE_S + WINDOW_S) / STEP_S))[0]
    vector = [np.concatenate([getattr(part, x) for part in (quiet, loud)])[::EVERY] for x in ("v", "i")]
    samples = np.round(np.hstack([phases(x) for x in vector]) / RESOLUTION) * RESOLUTION
    return Recorded(name, np.arange(len(samples)) / RATE_HZ, samples)


def manifest() -> Manifest:
    """What was played, in the form `seqsweep inject` gives it; t of the tones is that of the recordings."""
    plant = make_plant("dpmsg-v1", {"dt_s": STEP_S})
    amplitude = AMPLITUDE_PU * plant.rating.peak_voltage_v
    experiments = [
        Experiment(
            f"{name}.csv",
            tuple(
                PlayedTone(f, f if name == "direct" else 2.0 * F1_HZ - f, amplitude, phase)
                for f, phase in zip(F_HZ, PHASES_RAD, strict=True)
            ),
            QUIET_S,
            SETTLE_S,
            WINDOW_S,
        )
        for name in ("direct", "mirror")
    ]
    point = {"op_id": "p065", "active_power_mw": POWER_W / 1e6, "terminal_voltage_pu": 1.0}
    rating = plant.rating
    made_by = {"made_by": "data/make.py"}
    return Manifest(
        F1_HZ, RATE_HZ, "series_voltage", rating.voltage_v, rating.power_va, point, tuple(experiments), made_by
    )


def truth() -> dict[str, Any]:
    """The admittance (S, pn frame, load direction) from the linearisation of the tests; twelve digits."""
    sys.path.insert(0, str(HERE.parent / "tests" / "support"))
    import oracle

    names = ("pp", "pn", "np", "nn")
    rows = []
    for f, y in zip(F_HZ, oracle.admittance_pn(np.array(F_HZ), POWER_W, VOLTAGE_V), strict=True):
        elements = {name: digits(value) for name, value in zip(names, y.ravel(), strict=True)}
        rows.append({"f_hz": f, **elements})
    return {"f1_hz": F1_HZ, "unit": "S", "frame": "pn", "direction": "load", "elements": "[re, im]", "y": rows}


def digits(value: complex) -> list[float]:
    """[re, im] with twelve digits."""
    return [float(f"{part:.12g}") for part in (value.real, value.imag)]


# How it is written


def put(path: Path, content: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)


def as_json(value: Any) -> bytes:
    return json.dumps(value, indent=1).encode() + b"\n"


def units() -> list[str]:
    return ["V"] * 3 + ["A"] * 3


def columns(one: Recorded) -> dict[str, np.ndarray]:
    """Time and channels as columns (n, 1)."""
    channels = {name: one.samples[:, [k]] for k, name in enumerate(NAMES)}
    return {"time": one.time_s[:, np.newaxis], **channels}


def comtrade(path: Path, one: Recorded, encoding: Encoding) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    channels = [AnalogChannel(name, name[1].upper(), unit) for name, unit in zip(NAMES, units(), strict=True)]
    write_comtrade(path, channels, one.samples, RATE_HZ, F1_HZ, encoding)


def csv(one: Recorded) -> bytes:
    text = io.StringIO()
    header = ",".join(["time [s]", *(f"{name} [{unit}]" for name, unit in zip(NAMES, units(), strict=True))])
    table = np.column_stack([one.time_s, one.samples])
    np.savetxt(text, table, fmt="%.3f", delimiter=",", header=header, comments="")
    return text.getvalue().encode()


def pscad_descriptors() -> bytes:
    """PSCAD's names for the columns of its output; kV and kA, as on its wires."""
    lines = [
        f'PGB({k}) Output Desc="{name}" Group="PCC" Max=2.0 Min=-2.0 Units="k{unit}"\n'
        for k, (name, unit) in enumerate(zip(NAMES, units(), strict=True), start=1)
    ]
    return "".join(lines).encode()


def pscad_samples(one: Recorded) -> bytes:
    """PSCAD's output of one case; the current is that out of the turbine, in generator direction."""
    text = io.StringIO()
    table = np.column_stack([one.time_s, one.samples * np.repeat([1e-3, -1e-3], 3)]) + 0.0
    np.savetxt(text, table, fmt="%13.6E", header=f"! case {one.name}", comments="")
    return text.getvalue().encode()


def parquet(one: Recorded) -> bytes:
    import pyarrow as pa
    import pyarrow.parquet as pq

    names = ["time", *NAMES]
    kinds = [
        pa.field(name, pa.float64(), metadata={"unit": unit}) for name, unit in zip(names, ["s", *units()], strict=True)
    ]
    table = pa.table([column.ravel() for column in columns(one).values()], schema=pa.schema(kinds))
    buffer = io.BytesIO()
    pq.write_table(table, buffer, compression="zstd", use_dictionary=False, use_byte_stream_split=True)
    return buffer.getvalue()


def hdf5(one: Recorded) -> bytes:
    """One data set per channel, its unit an attribute."""
    import h5py

    buffer = io.BytesIO()
    with h5py.File(buffer, "w") as file:
        for (name, column), unit in zip(columns(one).items(), ["s", *units()], strict=True):
            file.create_dataset(name, data=column.ravel(), compression="gzip").attrs["unit"] = unit
    return buffer.getvalue()


def matlab_73(one: Recorded) -> bytes:
    """What MATLAB's ``save -v7.3`` writes: HDF5 behind a block of text, a column as a row."""
    import h5py

    buffer = io.BytesIO()
    with h5py.File(buffer, "w", userblock_size=512) as file:
        for name, column in columns(one).items():
            data = file.create_dataset(name, data=column.T, compression="gzip", chunks=column.T.shape)
            data.attrs["MATLAB_class"] = np.bytes_("double")
    head = b"MATLAB 7.3 MAT-file, written by seqsweep".ljust(116) + bytes(8) + b"\x00\x02IM"
    return head + buffer.getvalue()[len(head) :]


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE)
