"""Broken, hostile and lying recordings: a clear message, bounded memory, nothing lost that can be used."""

from __future__ import annotations

import io
import pickle
import resource
import zlib

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy.io import savemat

from seqsweep.plant.recordings import recording as limits
from seqsweep.plant.recordings.read import read_recording
from seqsweep.plant.recordings.recording import RecordingError
from seqsweep.plant.recordings.waveforms import defects, open_waveforms

from ..support import recording_files as files
from .test_recordings import COLUMNS, DT, SAMPLES, N, T, notes


def refused(path, words, **options):
    """The recording is refused, in these words, and the message names the file."""
    with pytest.raises(RecordingError, match=words) as refusal:
        open_waveforms(path, "load", **options)
    assert path.stem in str(refusal.value)


# Damaged


def test_a_truncated_dat_gives_what_is_there_and_says_so(tmp_path):
    path = files.comtrade(tmp_path / "a", SAMPLES, cut=1001)
    waveforms = open_waveforms(path, "load")
    assert waveforms.n_samples == (N * 20 - 1001) // 20
    assert "truncated: 2949 of the 3000 samples" in notes(path)
    assert "19 bytes at the end are no whole row" in notes(path)


@pytest.mark.parametrize("form", ["ASCII", "BINARY"])
def test_a_dat_longer_than_its_cfg_is_read_as_far_as_announced(tmp_path, form):
    path = files.comtrade(tmp_path / "a", SAMPLES, form=form, rates=[(1e4, 2000)])
    assert open_waveforms(path, "load").n_samples == 2000
    assert "3000 samples where 2000 were announced" in notes(path)


@pytest.mark.parametrize(
    ("form", "words"), [("ASCII", "rows of 7 numbers were announced"), ("BINARY", "6 analog channels")]
)
def test_a_wrong_number_of_channels_is_found_and_the_right_one_named(tmp_path, form, words):
    path = files.comtrade(tmp_path / "a", SAMPLES, form=form)
    lines = path.read_text().replace("6,6A", "5,5A").splitlines()
    path.write_text("\n".join(lines[:7] + lines[8:]))
    refused(path, words)


def test_time_stamps_and_times_that_run_backwards_are_refused_with_the_place(tmp_path):
    stamps = np.arange(N) * 100.0
    stamps[1500:] -= 1e5
    refused(files.comtrade(tmp_path / "a", SAMPLES, stamps=stamps), "run backwards at sample 1501")
    path = files.text(tmp_path / "b.csv", SAMPLES)
    lines = path.read_text().splitlines()
    path.write_text("\n".join(lines[:2001] + lines[1001:]))
    refused(path, "time runs backwards or stands still at sample 2000")


def test_a_gap_in_time_is_refused_and_rounded_times_are_not(tmp_path):
    path = files.text(tmp_path / "a.csv", SAMPLES)
    lines = path.read_text().splitlines()
    path.write_text("\n".join(lines[:1000] + lines[1300:]))
    refused(path, "there is a gap")
    savemat(tmp_path / "b.mat", {"time": np.round(T, 4) + 2e-5 * (np.arange(N) % 2), **COLUMNS})
    assert "taken as uniform" in notes(tmp_path / "b.mat")


def test_a_rate_that_its_time_stamps_contradict_is_said(tmp_path):
    path = files.comtrade(tmp_path / "a", SAMPLES, stamps=np.arange(N) * 101.0)
    assert "the configuration says 10000 samples per second, the time stamps 9900.99" in notes(path)


def test_a_dead_phase_is_named_and_the_way_out_works(tmp_path):
    dead = SAMPLES.copy()
    dead[:, 1] = 0.0
    path = files.comtrade(tmp_path / "a", dead)
    refused(path, "Vb is dead .* two phases are enough")
    waveforms = open_waveforms(path, "load", channels={"va": "Va", "vc": "Vc"})
    assert np.max(np.abs(np.abs(waveforms.record(0, N).v) - 563.0)) < 6.0


def test_missing_samples_are_counted_and_clipped_channels_named(tmp_path):
    spoiled = SAMPLES.copy()
    spoiled[500:520, 1] = np.nan
    spoiled[:, 3] = np.clip(spoiled[:, 3], -700.0, 790.0)
    waveforms = open_waveforms(files.comtrade(tmp_path / "a", spoiled, form="BINARY32"), "load")
    found = defects(waveforms, 0, N)
    assert found.missing == 20
    assert found.clipped == ("Ia",)


@pytest.mark.parametrize("bits", [12, 16])
def test_a_coarse_but_whole_sine_is_not_called_clipped(tmp_path, bits):
    step = 2.0 * 800.0 / 2**bits
    waveforms = open_waveforms(files.text(tmp_path / "a.csv", np.rint(SAMPLES / step) * step), "load")
    assert defects(waveforms, 0, N).clipped == ()


@pytest.mark.parametrize("suffix", [".cfg", ".cff", ".csv", ".inf", ".out", ".parquet", ".mat", ".h5", ".tdms", ".mf4"])
@pytest.mark.parametrize("content", [b"", b"\0" * 5000, bytes(range(256)) * 40, b"hello\nworld\n" * 200])
@pytest.mark.filterwarnings("default")  # of third-party readers on garbage
def test_garbage_is_refused_by_every_reader_in_one_message(tmp_path, suffix, content):
    path = tmp_path / f"case_01{suffix}"
    path.write_bytes(content)
    with pytest.raises(RecordingError):
        read_recording(path)


@pytest.mark.parametrize("suffix", ["mat", "h5", "parquet"])
def test_a_file_cut_in_half_is_refused_in_one_message(tmp_path, suffix):
    path = tmp_path / f"a.{suffix}"
    if suffix == "mat":
        savemat(path, {"time": T, **COLUMNS}, do_compression=True)
    elif suffix == "h5":
        with h5py.File(path, "w") as file:
            for name, x in {"time": T, **COLUMNS}.items():
                file[name] = x
    else:
        pq.write_table(pa.table({"time": T, **COLUMNS}), path)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(RecordingError):
        read_recording(path)


# Hostile


class Bomb:
    """Unpickling it would be noticed."""

    def __reduce__(self):
        return (pytest.fail, ("something in a file was executed",))


def test_a_pickle_called_mat_or_h5_or_csv_is_not_opened_as_one(tmp_path):
    for suffix in ("mat", "h5", "csv", "parquet"):
        path = tmp_path / f"a.{suffix}"
        path.write_bytes(pickle.dumps(Bomb()))
        with pytest.raises(RecordingError):
            read_recording(path)


def test_matlab_objects_are_refused_by_name_with_the_way_out(tmp_path):
    with h5py.File(tmp_path / "a.mat", "w") as file:
        file["ts"] = np.zeros(6, dtype=np.uint32)
        file["ts"].attrs["MATLAB_class"] = np.bytes_("timeseries")
        file["ts"].attrs["MATLAB_object_decode"] = 3
    refused(tmp_path / "a.mat", "timeseries.*save arrays with a vector 'time'")


def test_an_hdf5_file_does_not_reach_into_other_files(tmp_path):
    with h5py.File(tmp_path / "secret.h5", "w") as file:
        file["Va"] = SAMPLES[:, 0]
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for name, x in COLUMNS.items():
            if name != "Va":
                file[name] = x
        file["Va"] = h5py.ExternalLink("secret.h5", "Va")
        file["fs"] = 1e4
    read = read_recording(tmp_path / "a.h5")
    assert "Va" not in [channel.name for channel in read.channels]
    assert "Va (a link)" in "".join(read.notes)


def test_a_file_of_20_gb_is_judged_without_reading_it(tmp_path):
    path = files.comtrade(tmp_path / "a", SAMPLES, rates=[(1e4, 10**9)])
    for suffix in (".dat", ".csv", ".txt"):
        with open(tmp_path / f"a{suffix}", "wb") as file:
            file.truncate(20 << 30)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    refused(path, "the sample numbers do not count up")
    refused(tmp_path / "a.csv", "20 GB, which must be read as a whole; .* save it as binary COMTRADE")
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 50_000  # kB


def test_what_decompresses_to_more_than_memory_is_refused_before_it_does(tmp_path, monkeypatch):
    small = 1 << 16
    monkeypatch.setattr(limits, "TEXT_LIMIT_BYTES", small)
    for module in ("matlab_files", "hdf5_files", "parquet_files"):
        monkeypatch.setattr(f"seqsweep.plant.recordings.{module}.TEXT_LIMIT_BYTES", small)
    zeros = {name: np.zeros(10 * small) for name in ("time", *files.NAMES)}
    savemat(tmp_path / "a.mat", zeros, do_compression=True)
    with pytest.raises(RecordingError, match="GB when decompressed"):
        read_recording(tmp_path / "a.mat")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for name, x in zeros.items():
            file.create_dataset(name, data=x, chunks=(len(x),), compression="gzip")
    with pytest.raises(RecordingError, match="does not fit into memory"):
        read_recording(tmp_path / "a.h5")
    pq.write_table(pa.table(zeros), tmp_path / "a.parquet", row_group_size=10 * small)
    with pytest.raises(RecordingError, match="row group of 655360 rows does not fit"):
        read_recording(tmp_path / "a.parquet")


def test_a_matlab_variable_that_lies_about_its_size_costs_a_message_not_the_memory(tmp_path):
    """A v5 variable is a zlib stream; one that inflates to much more than its header says is cut off by the reader."""
    savemat(tmp_path / "a.mat", {"Va": np.zeros(64)}, do_compression=True)
    raw = (tmp_path / "a.mat").read_bytes()
    inner = zlib.decompress(raw[136:])
    bomb = zlib.compress(inner + b"\0" * (64 << 20))
    (tmp_path / "a.mat").write_bytes(raw[:128] + np.array([15, len(bomb)], "<u4").tobytes() + bomb)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(RecordingError):
        read_recording(tmp_path / "a.mat")
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 50_000  # kB


# Wrong


def test_a_parquet_of_another_schema_is_refused_by_its_columns(tmp_path):
    pq.write_table(pa.table({"name": ["x", "y"]}), tmp_path / "a.parquet")
    refused(tmp_path / "a.parquet", r"no column of numbers; .* name \(string\)")
    pq.write_table(pa.table({"speed": np.zeros(100), "time": DT * np.arange(100)}), tmp_path / "b.parquet")
    refused(tmp_path / "b.parquet", "no voltage found among 'speed'")


@pytest.mark.parametrize(
    ("names", "words"),
    [
        (
            "va ia ib ic",
            "of the voltage 'va' is there and 'vb' and 'vc' are missing among 'va', 'ia'.* va=NAME,vb=NAME",
        ),
        ("U_c ia ib ic", "of the voltage 'U_c' is there and 'U_a' and 'U_b' are missing"),
        ("U_L2 ia ib ic", "of the voltage 'U_L2' is there and 'U_L1' and 'U_L3' are missing"),
        ("vab ia ib ic", "of the voltage 'vab' is there and 'vbc' and 'vca' are missing"),
        ("va vb vc IB", "of the current 'IB' is there and 'IA' and 'IC' are missing .* --channels ia=NAME"),
        ("vdc ia ib ic", "no voltage found among 'vdc'"),
    ],
)
def test_a_phase_that_was_not_recorded_is_named(tmp_path, names, words):
    columns = {name: np.cos(100.0 * np.pi * DT * np.arange(4000) + k) for k, name in enumerate(names.split())}
    pq.write_table(pa.table({"time": DT * np.arange(4000), **columns}), tmp_path / "a.parquet")
    refused(tmp_path / "a.parquet", words)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("none.cfg", "no such file"),
        ("a.xyz", "no reader for '.xyz'; known are .cff"),
        ("a.cfg", "its .dat file is missing"),
    ],
)
def test_files_that_are_not_there_or_of_no_known_format_are_named(tmp_path, name, words):
    if not name.startswith("none"):
        (tmp_path / name).write_text("x")
    with pytest.raises(RecordingError, match=words):
        read_recording(tmp_path / name)


@pytest.mark.parametrize(
    ("channels", "words"),
    [
        ({"va": "Vq"}, "no channel is called 'Vq'; there are 'Va'"),
        ({"va": "Va"}, "channels va make no voltage: give va, vb, vc"),
    ],
)
def test_channels_that_cannot_be_are_refused(tmp_path, channels, words):
    refused(files.text(tmp_path / "a.csv", SAMPLES), words, channels=channels)


def test_a_cell_that_is_no_number_is_refused_with_its_place(tmp_path):
    path = files.text(tmp_path / "a.csv", SAMPLES)
    path.write_text(path.read_text().replace("\n0.01,", "\nlate,", 1))
    refused(path, "late")


def test_buffers_in_memory_are_no_recordings():
    with pytest.raises(TypeError):
        read_recording(io.BytesIO(b""))  # type: ignore[arg-type]
