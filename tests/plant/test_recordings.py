"""Every format gives back the waveforms that were written; names, units and physics find v and i."""

from __future__ import annotations

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy.io import savemat

from seqsweep.plant.recordings.read import known_suffixes, read_recording, recordings_in
from seqsweep.plant.recordings.waveforms import open_waveforms

from ..support import recording_files as files
from ..support.by_hand import Stretch

N, DT = 3000, 1e-4
T = DT * np.arange(N)
TRUTH = Stretch(
    v=563.0 * np.exp(1j * (2 * np.pi * 50.0 * T + 0.2)) * (1.0 + 0.01 * np.exp(2j * np.pi * 27.0 * T)),
    i=800.0 * np.exp(1j * (2 * np.pi * 50.0 * T - 1.0)),
)
SAMPLES = files.six(TRUTH)
COLUMNS = dict(zip(files.NAMES, SAMPLES.T, strict=True))
ROUNDING = {"ASCII": 4e-5, "BINARY": 4e-5, "BINARY32": 1e-9, "FLOAT32": 1e-7}
"""Half a step of 16 bits is 1.5e-5 of the peak, and a space vector adds up three; the others likewise."""


def difference(path, **options):
    """Largest difference from the truth, relative, of v and i; the record must have its length and its time."""
    waveforms = open_waveforms(path, "load", **options)
    record = waveforms.record(0, waveforms.n_samples)
    assert len(record.v) == N
    assert record.dt_s == pytest.approx(DT, rel=1e-9)
    return max(np.max(np.abs(record.v - TRUTH.v)) / 563.0, np.max(np.abs(record.i - TRUTH.i)) / 800.0)


def notes(path, **options):
    """Everything said about a recording, in one text."""
    return "\n".join(open_waveforms(path, "load", **options).notes())


# COMTRADE


@pytest.mark.parametrize("form", ROUNDING)
@pytest.mark.parametrize("revision", [1991, 1999, 2013])
def test_comtrade_of_every_revision_and_format_is_read_to_its_rounding(tmp_path, form, revision):
    path = files.comtrade(tmp_path / "a", SAMPLES, form=form, revision=revision, status=19)
    assert difference(path) < ROUNDING[form]


@pytest.mark.parametrize("form", ROUNDING)
def test_the_combined_file_is_read_like_the_pair(tmp_path, form):
    assert difference(files.comtrade(tmp_path / "a", SAMPLES, form=form, revision=2013, cff=True)) < ROUNDING[form]


def test_a_dat_stands_for_its_cfg_whatever_the_case_of_the_suffix(tmp_path):
    path = files.comtrade(tmp_path / "a", SAMPLES)
    path.rename(path.with_suffix(".CFG"))
    assert difference(tmp_path / "a.dat") < ROUNDING["BINARY"]


def test_the_package_comtrade_reads_the_same_numbers_out_of_the_files_of_these_tests(tmp_path):
    comtrade = pytest.importorskip("comtrade")
    path = files.comtrade(tmp_path / "a", SAMPLES, form="BINARY32")
    theirs = comtrade.load(str(path), use_numpy_arrays=True, use_double_precision=True)
    ours = read_recording(path).samples(range(6), 0, N)
    assert np.max(np.abs(np.array(theirs.analog).T - ours)) < 1e-12 * np.max(ours)


def test_secondary_values_come_out_on_the_primary_side(tmp_path):
    path = files.comtrade(tmp_path / "a", SAMPLES / 100.0, ratio=(100, 1, "S"))
    assert difference(path) < ROUNDING["BINARY"]
    assert "primary by ratios 100" in notes(path)


def test_text_that_is_no_utf8_costs_nothing(tmp_path):
    names = ["电压Va", "电压Vb", "电压Vc", "Ia", "Ib", "Ic"]
    path = files.comtrade(tmp_path / "a", SAMPLES, names=names, units=["V"] * 3 + ["A"] * 3, encoding="gbk")
    assert difference(path) < ROUNDING["BINARY"]
    assert "not UTF-8" in notes(path)


def test_a_date_that_nobody_can_read_costs_nothing(tmp_path):
    path = files.comtrade(tmp_path / "a", SAMPLES)
    path.write_text(path.read_text().replace("01/01/2026,00:00:00.000000", "45/45/2026,00:00:00.000000"))
    assert difference(path) < ROUNDING["BINARY"]
    assert "dates could not be read" in notes(path)


def test_of_several_sampling_rates_the_longest_section_is_used(tmp_path):
    path = files.comtrade(tmp_path / "a", SAMPLES, rates=[(5000.0, 500), (10_000.0, N)], form="FLOAT32")
    waveforms = open_waveforms(path, "load")
    record = waveforms.record(0, waveforms.n_samples)
    assert np.max(np.abs(record.v - TRUTH.v[500:])) < 1e-6 * 563.0
    assert "only the longest section" in notes(path)


@pytest.mark.parametrize("form", ["ASCII", "BINARY", "BINARY32"])
def test_missing_values_are_nan_and_nothing_else_is(tmp_path, form):
    holed = SAMPLES.copy()
    holed[100:110, 2] = np.nan
    read = read_recording(files.comtrade(tmp_path / "a", holed, form=form)).samples(range(6), 0, N)
    assert np.array_equal(np.isnan(read), np.isnan(holed))


# Text, PSCAD


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("a.csv", {}),
        ("a.tsv", {"delimiter": "\t"}),
        ("a.csv", {"delimiter": ";", "decimal": ","}),
        ("a.csv", {"heads": ["ua", "ub", "uc", "ia", "ib", "ic"], "preface": ("# made by hand",)}),
        ("a.csv", {"heads": ["U_L1/V", "U_L2/V", "U_L3/V", "I_L1/A", "I_L2/A", "I_L3/A"], "time": "t"}),
        ("a.csv", {"heads": [f"PCC:{x}" for x in ("Vabc_1", "Vabc_2", "Vabc_3", "Iabc_1", "Iabc_2", "Iabc_3")]}),
        ("a.txt", {"delimiter": " ", "heads": ["Va", "Vb", "Vc", "Ia", "Ib", "Ic"], "time": "t"}),
    ],
)
def test_text_in_every_dialect_is_read_to_the_last_digit(tmp_path, name, options):
    assert difference(files.text(tmp_path / name, SAMPLES, **options)) < 1e-14


def test_units_in_the_headings_are_obeyed(tmp_path):
    heads = ["Va (kV)", "Vb (kV)", "Vc (kV)", "Ia [kA]", "Ib [kA]", "Ic [kA]"]
    path = files.text(tmp_path / "a.csv", SAMPLES / 1e3, heads=heads, time="Time (ms)", dt_s=0.1)
    assert difference(path) < 1e-14


def test_units_in_a_row_of_their_own_are_obeyed(tmp_path):
    path = files.text(tmp_path / "a.csv", SAMPLES / 1e3, heads=["Ua", "Ub", "Uc", "Ia", "Ib", "Ic"], time="Time")
    lines = path.read_text().splitlines()
    path.write_text("\n".join([lines[0], "(s),(kV),(kV),(kV),(kA),(kA),(kA)", *lines[1:]]))
    assert difference(path) < 1e-14


def test_without_a_time_the_rate_is_asked_for_and_taken(tmp_path):
    path = files.text(tmp_path / "a.csv", SAMPLES, time=None)
    with pytest.raises(ValueError, match="--sample-rate"):
        read_recording(path)
    assert difference(path, sample_rate_hz=1e4) < 1e-14


def test_pscad_descriptors_may_come_in_any_order_and_more_than_one_file(tmp_path):
    path = files.pscad(tmp_path, "case", SAMPLES, order=[9, 3, 11, 1, 0, 2, 12, 5, 4, 8, 10, 7, 6], extra=7)
    assert (tmp_path / "case_02.out").exists()
    assert difference(path) < 1e-12  # 14 digits are written


def test_every_run_of_a_pscad_case_is_a_recording(tmp_path):
    files.pscad(tmp_path, "case", SAMPLES * 2.0, run="_r00001")
    inf = files.pscad(tmp_path, "case", SAMPLES, run="_r00002")
    assert [path.name for path in recordings_in(inf)] == ["case_r00001_01.out", "case_r00002_01.out"]
    assert recordings_in(tmp_path) == recordings_in(inf)
    assert difference(tmp_path / "case_r00002_01.out") < 1e-12
    with pytest.raises(ValueError, match="2 runs; name one"):
        read_recording(inf)


# Arrays


def test_matlab_vectors_matrices_and_simulink_logs_are_read_exactly(tmp_path):
    signals = np.array([(SAMPLES[:, :3], "Vabc"), (SAMPLES[:, 3:], "Iabc")], dtype=[("values", "O"), ("label", "O")])
    contents = {
        "vectors": {"time": T[:, None], **{name: x[:, None] for name, x in COLUMNS.items()}},
        "three": {"t": T, "vabc": SAMPLES[:, :3], "iabc": SAMPLES[:, 3:].T},
        "rate": {"fs": 1.0 / DT, **COLUMNS},
        "simulink": {"out": {"time": T[:, None], "signals": signals}},
    }
    for name, content in contents.items():
        path = tmp_path / f"{name}.mat"
        savemat(path, content, do_compression=name == "three")
        assert difference(path) < 1e-15, name


def test_a_simulink_matrix_with_its_time_in_the_first_row_needs_names(tmp_path):
    savemat(tmp_path / "a.mat", {"data": np.vstack([T, SAMPLES.T])})
    with pytest.raises(ValueError, match=r"by physics \(data1, data2, data3\) and \(data4, data5, data6\)"):
        open_waveforms(tmp_path / "a.mat", "load")
    roles = ("va", "vb", "vc", "ia", "ib", "ic")
    assert difference(tmp_path / "a.mat", channels={role: f"data{k + 1}" for k, role in enumerate(roles)}) < 1e-15


def test_hdf5_and_matlab_73_are_read_exactly(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["rec/time"] = T
        for name, x in COLUMNS.items():
            file[f"rec/{name}"] = x
            file[f"rec/{name}"].attrs["unit"] = "V" if name[0] == "V" else "A"
    with h5py.File(tmp_path / "b.mat", "w", userblock_size=512) as file:
        file["t"], file["vabc"], file["iabc"] = T[None], SAMPLES[:, :3].T, SAMPLES[:, 3:].T
    with open(tmp_path / "b.mat", "r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file")
    assert difference(tmp_path / "a.h5") < 1e-15
    assert difference(tmp_path / "b.mat") < 1e-15


def test_parquet_is_read_exactly_over_the_borders_of_its_row_groups(tmp_path):
    pq.write_table(pa.table({"time": T, **COLUMNS}), tmp_path / "a.parquet", row_group_size=700)
    assert difference(tmp_path / "a.parquet") < 1e-15
    waveforms = open_waveforms(tmp_path / "a.parquet", "load")
    assert np.array_equal(waveforms.record(650, 1450).v, waveforms.record(0, N).v[650:1450])


def test_tdms_is_read_exactly(tmp_path):
    nptdms = pytest.importorskip("nptdms")
    with nptdms.TdmsWriter(str(tmp_path / "a.tdms")) as writer:
        writer.write_segment(
            [
                nptdms.ChannelObject(
                    "g", name, x, properties={"wf_increment": DT, "unit_string": name[0].replace("I", "A")}
                )
                for name, x in COLUMNS.items()
            ]
        )
    assert difference(tmp_path / "a.tdms") < 1e-15


@pytest.mark.filterwarnings("default")  # of the library's own imports
def test_mdf4_is_read_exactly(tmp_path):
    asammdf = pytest.importorskip("asammdf")
    with asammdf.MDF(version="4.10") as mdf:
        mdf.append([asammdf.Signal(x, T, name=name, unit=name[0].replace("I", "A")) for name, x in COLUMNS.items()])
        mdf.save(tmp_path / "a.mf4")
    assert difference(tmp_path / "a.mf4") < 1e-15


def test_every_reader_exists_and_is_imported_only_when_asked_for():
    assert {".cfg", ".csv", ".inf", ".parquet", ".mat", ".h5", ".tdms", ".mf4"} <= set(known_suffixes())


# Channels


def test_a_generators_current_is_negated_and_remembered(tmp_path):
    path = files.comtrade(tmp_path / "a", SAMPLES, form="FLOAT32")
    load, generator = (open_waveforms(path, direction).record(0, N) for direction in ("load", "generator"))
    assert np.array_equal(generator.i, -load.i)
    assert np.array_equal(generator.v, load.v)
    assert (load.source_direction, generator.source_direction) == ("load", "generator")


@pytest.mark.parametrize(
    ("make", "names"),
    [
        (
            lambda x: np.column_stack([x[:, 0] - x[:, 1], x[:, 1] - x[:, 2], x[:, 2] - x[:, 0], x[:, 3:]]),
            "Vab Vbc Vca Ia Ib Ic",
        ),
        (lambda x: np.column_stack([x[:, 0] - x[:, 1], x[:, 1] - x[:, 2], x[:, 3:]]), "U12 U23 I1 I2 I3"),
        (lambda x: x[:, [0, 1, 3, 4]], "Va Vb Ia Ib"),
        (lambda x: x, "VAN VBN VCN IA IB IC"),
        (lambda x: x, "Ur Us Ut Ir Is It"),
        (
            lambda x: np.column_stack([TRUTH.v.real, TRUTH.v.imag, TRUTH.i.real, TRUTH.i.imag]),
            "v_alpha v_beta i_alpha i_beta",
        ),
    ],
)
def test_phases_line_voltages_two_phases_and_space_vectors_are_one_vector(tmp_path, make, names):
    path = files.text(tmp_path / "a.csv", make(SAMPLES), heads=names.split())
    assert difference(path) < 1e-14


def test_swapped_phases_are_seen_and_put_right(tmp_path):
    path = files.text(tmp_path / "a.csv", SAMPLES[:, [0, 2, 1, 3, 5, 4]])
    assert difference(path) < 1e-14
    assert "rotates backward" in notes(path)


def test_the_words_for_the_phases_count_where_names_are_all_the_same(tmp_path):
    options = {"names": ["Bus"] * 3 + ["Line"] * 3, "units": ["V"] * 3 + ["A"] * 3, "phases": list("ABCABC")}
    assert difference(files.comtrade(tmp_path / "a", SAMPLES, **options)) < ROUNDING["BINARY"]


def test_offsets_and_zero_sequences_are_said_and_left_out(tmp_path):
    path = files.text(tmp_path / "a.csv", SAMPLES + 30.0 * np.sin(2 * np.pi * 150.0 * T)[:, None])
    assert difference(path) < 1e-14
    assert "zero sequence" in notes(path)
    shifted = SAMPLES.copy()
    shifted[:, 0] += 40.0
    assert "the voltage has a DC offset of" in notes(files.text(tmp_path / "b.csv", shifted))


def test_of_several_voltages_the_one_at_the_terminal_is_taken_else_the_user_is_asked(tmp_path):
    both = np.column_stack([0.9 * SAMPLES[:, :3], SAMPLES])
    currents = ["Ia", "Ib", "Ic"]
    named = files.text(
        tmp_path / "a.csv", both, heads=["Vg_a", "Vg_b", "Vg_c", "Vpcc_a", "Vpcc_b", "Vpcc_c", *currents]
    )
    assert difference(named) < 1e-14
    unnamed = files.text(tmp_path / "b.csv", both, heads=["V1a", "V1b", "V1c", "V2a", "V2b", "V2c", *currents])
    with pytest.raises(ValueError, match="several could be the voltage"):
        open_waveforms(unnamed, "load")
    assert difference(unnamed, channels={"va": "V2a", "vb": "V2b", "vc": "V2c"}) < 1e-14


def test_per_unit_needs_a_base(tmp_path):
    heads = [f"{name} [pu]" for name in files.NAMES]
    path = files.text(tmp_path / "a.csv", SAMPLES / np.repeat([563.0, 800.0], 3), heads=heads)
    with pytest.raises(ValueError, match="per unit: give --rated-voltage-v"):
        open_waveforms(path, "load")
    assert difference(path, base=(563.0, 800.0)) < 1e-14
