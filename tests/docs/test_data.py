"""The recordings in data/: made anew byte for byte, the same in every format, and true."""

from __future__ import annotations

import json
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest

from seqsweep.sweep.playback.manifest import manifest_violations

DATA = Path(__file__).parents[2] / "data"
NAMES = ("va", "vb", "vc", "ia", "ib", "ic")
BOTH = ("direct", "mirror")


def recording(name: str) -> np.ndarray:
    """Time and six channels of the text, (2100, 7)."""
    return np.loadtxt(DATA / "csv" / f"{name}.csv", delimiter=",", skiprows=1)


def test_the_script_makes_every_byte_anew(tmp_path: Path) -> None:
    subprocess.run([sys.executable, DATA / "make.py", tmp_path], check=True, timeout=600)
    made = {path.relative_to(tmp_path): path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    kept = {path.relative_to(DATA): path.read_bytes() for path in DATA.rglob("*") if path.is_file()}
    by_hand = {Path("README.md"), Path("make.py")}
    stray = {path for path in kept if "__pycache__" in path.parts}
    assert set(made) == set(kept) - by_hand - stray
    assert [str(path) for path in made if made[path] != kept[path]] == []
    assert sum(map(len, kept.values())) < 2e6


@pytest.mark.parametrize("name", BOTH)
@pytest.mark.parametrize("kind", ["ascii", "binary", "float32", "cff"])
def test_comtrade_holds_the_recording_to_its_resolution(name: str, kind: str) -> None:
    import comtrade

    suffix = "cff" if kind == "cff" else "cfg"
    record = comtrade.load(str(DATA / f"comtrade_{kind}" / f"{name}.{suffix}"))
    expected = recording(name)
    counts = {"ascii": 99_998, "binary": 32_767, "cff": 32_767, "float32": 2**23}[kind]
    found = np.array(record.analog).T
    assert np.all(np.abs(found - expected[:, 1:]) <= 0.51 * np.abs(expected[:, 1:]).max(axis=0) / counts)
    assert record.analog_channel_ids == list(NAMES)


@pytest.mark.parametrize("name", BOTH)
def test_pscad_holds_it_in_kilo_and_generator_direction(name: str) -> None:
    found = np.loadtxt(DATA / "pscad" / f"{name}_01.out", skiprows=1)
    expected = recording(name) * np.array([1.0, *[1e-3] * 3, *[-1e-3] * 3])
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-12)  # seven digits
    lines = (DATA / "pscad" / f"{name}.inf").read_text().splitlines()
    assert [line.split('"')[1] for line in lines] == list(NAMES)


@pytest.mark.parametrize("name", BOTH)
def test_the_binary_formats_hold_every_digit(name: str) -> None:
    import h5py
    import pandas
    from scipy.io import loadmat

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import matio
    expected = recording(name)
    frame = pandas.read_parquet(DATA / "parquet" / f"{name}.parquet")
    mat_5 = loadmat(DATA / "matlab_5" / f"{name}.mat")
    mat_73 = matio.load_from_mat(str(DATA / "matlab_73" / f"{name}.mat"))
    with h5py.File(DATA / "hdf5" / f"{name}.h5") as file:
        for k, channel in enumerate(("time", *NAMES)):
            for found in (frame[channel].to_numpy(), mat_5[channel][:, 0], mat_73[channel][:, 0], file[channel][:]):
                np.testing.assert_allclose(found, expected[:, k], rtol=0.0, atol=1e-9)  # text has three decimals
        assert file["va"].attrs["unit"] == "V"


def test_the_recordings_hold_the_true_admittance() -> None:
    """Two experiments, a Fourier sum over whole periods each, one 2x2 solve: nothing of ours is used."""
    truth = json.loads((DATA / "truth.json").read_text())
    phasors = []
    for name in BOTH:
        data = recording(name)[1300:]
        v, i = (
            data[:, part] @ np.exp(2j * np.pi * np.arange(3) / 3.0) * 2.0 / 3.0 for part in (slice(1, 4), slice(4, 7))
        )
        phasors.append(lambda f, t=data[:, 0], v=v, i=i: [np.mean(x * np.exp(-2j * np.pi * f * t)) for x in (v, i)])
    phi1 = np.angle(phasors[0](50.0)[0])
    turn = np.exp(2j * phi1)
    for row in truth["y"]:
        f = row["f_hz"]
        heard = np.array([[one(f), np.conj(one(100.0 - f)) * turn] for one in phasors])  # experiment, component, v or i
        y = heard[:, :, 1].T @ np.linalg.inv(heard[:, :, 0].T)
        expected = np.array([complex(*row[name]) for name in ("pp", "pn", "np", "nn")]).reshape(2, 2)
        assert np.linalg.norm(y - expected) < 1e-3 * np.linalg.norm(expected), f


def test_the_manifest_conforms() -> None:
    assert manifest_violations(json.loads((DATA / "manifest.json").read_text())) == []
