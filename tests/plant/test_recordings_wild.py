"""What people and their tools do to files: every kind gives the same waveforms as the plain file does."""

from __future__ import annotations

import datetime as dt

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy.io import savemat

from seqsweep.plant.errors import SeqsweepError
from seqsweep.plant.recordings.units import parse_units, unit_of
from seqsweep.plant.recordings.waveforms import open_waveforms

from ..support import recording_files as files
from ..support.by_hand import Stretch
from .test_recordings import COLUMNS, DT, SAMPLES, TRUTH, N, T, difference, notes
from .test_recordings_bad import refused

HEADS = ("Time", *files.NAMES)
WORDS = {"V": "voltage", "I": "current"}
ROWS = np.column_stack([T, SAMPLES])


def lines(row=lambda cells: ",".join(cells), cell=lambda x: f"{x:.9e}"):
    """Rows of text."""
    return [row([cell(x) for x in values]) for values in ROWS]


def written(path, rows, head="Time,Va,Vb,Vc,Ia,Ib,Ic", encoding="utf-8"):
    """A text of a heading and rows; its path."""
    path.write_bytes(("\n".join([*([head] if head else []), *rows]) + "\n").encode(encoding))
    return path


MILLI = [f"{name} [m{'V' if name[0] == 'V' else 'A'}]" for name in files.NAMES]


def thousands(signs):
    """Rows in mV and mA; ``signs`` are those between thousands and before fractions."""
    table = str.maketrans(",.", signs)
    return [
        ";".join(f"{x:,.6f}".translate(table) for x in [t, *(1e3 * row)]) for t, row in zip(T, SAMPLES, strict=True)
    ]


def clock(k, form="%Y-%m-%d %H:%M:%S.%f"):
    """Time of sample k, as a date; midnight falls into the record."""
    return (dt.datetime(2026, 3, 1, 23, 59, 59, 900_000) + dt.timedelta(microseconds=100 * k)).strftime(form)


def stamped(row_of):
    """Rows whose time is ``row_of(k)``."""
    return [",".join([row_of(k), *(f"{x:.9e}" for x in SAMPLES[k])]) for k in range(N)]


TEXTS = {
    "aligned with blanks": lambda p: written(
        p, lines(lambda c: " ".join(f"{x:>18}" for x in c)), " ".join(f"{h:>18}" for h in HEADS)
    ),
    "blanks, names with units": lambda p: written(
        p, lines("  ".join), "Time [s]  " + "  ".join(f"{n} [{'V' if n[0] == 'V' else 'A'}]" for n in files.NAMES)
    ),
    "savetxt": lambda p: written(p, lines(), "# " + ",".join(HEADS)),
    "savetxt with blanks": lambda p: written(p, lines(" ".join), "# " + " ".join(HEADS)),
    "savetxt under a remark": lambda p: written(p, ["# " + ",".join(HEADS), *lines()], "# made in 2026, by hand"),
    "D exponents": lambda p: written(p, lines(cell=lambda x: f"{x:.9e}".replace("e", "D"))),
    "exponents without a letter": lambda p: written(p, lines(cell=lambda x: f"{x:.9e}".replace("e-0", "-00"))),
    "a comma after every row": lambda p: written(p, [f"{row}," for row in lines()]),
    "a comma after everything": lambda p: written(p, [f"{row}," for row in lines()], ",".join(HEADS) + ","),
    "commas in quoted names": lambda p: written(
        p, lines(), '"Time, s",' + ",".join(f'"{n}, bus 3 ({"V" if n[0] == "V" else "A"})"' for n in files.NAMES)
    ),
    "phases within names": lambda p: written(
        p,
        lines(),
        "Time," + ",".join(f"Phase {n[1].upper()} {'voltage' if n[0] == 'V' else 'current'}" for n in files.NAMES),
    ),
    "empty cells at the end of every row": lambda p: written(p, [f"{row},,," for row in lines()]),
    "bars": lambda p: written(p, lines("|".join), "|".join(HEADS)),
    "thousands with points": lambda p: written(p, thousands(".,"), ";".join(["Time", *MILLI])),
    "thousands with blanks": lambda p: written(p, thousands(" ,"), ";".join(["Time", *MILLI])),
    "quoted numbers": lambda p: written(p, lines(lambda c: ",".join(f'"{x}"' for x in c))),
    "decimal commas": lambda p: written(p, lines(lambda c: ";".join(c).replace(".", ",")), ";".join(HEADS)),
    "decimal commas in quotes": lambda p: written(
        p, lines(lambda c: ",".join('"' + x.replace(".", ",") + '"' for x in c))
    ),
    "decimal commas and blanks": lambda p: written(
        p, lines(lambda c: "   ".join(c).replace(".", ",")), "   ".join(HEADS)
    ),
    "a title, empty lines, a row of units": lambda p: written(
        p, ["", ",".join(HEADS), "(s),(V),(V),(V),(A),(A),(A)", *lines()], "Bench 3, run 7"
    ),
    "a column of words": lambda p: written(p, [f"{row},ok" for row in lines()], ",".join(HEADS) + ",State"),
    "a column of words in another alphabet": lambda p: written(
        p, [f"{row},gestört" for row in lines()], ",".join(HEADS) + ",Zustand", "latin-1"
    ),
    "UTF-16": lambda p: written(p, lines(), encoding="utf-16"),
    "UTF-16 without its mark": lambda p: written(p, lines(), encoding="utf-16-le"),
    "UTF-8 with a mark": lambda p: written(p, lines(), encoding="utf-8-sig"),
    "PowerFactory": lambda p: written(
        p,
        [
            '"b:tnow in s",'
            + ",".join(
                f'"m:{n[0].lower().replace("v", "u")}:{n[1].upper()} in {"V" if n[0] == "V" else "A"}"'
                for n in files.NAMES
            ),
            *lines(),
        ],
        '"All calculations","Bus","Bus","Bus","Line","Line","Line"',
    ),
    "phases after a stroke": lambda p: written(p, lines(), "Time,V_A,V_B,V_C,I_A,I_B,I_C"),
    "phases after a blank": lambda p: written(
        p, lines(), "Time,Voltage A,Voltage B,Voltage C,Current A,Current B,Current C"
    ),
    "time in ms": lambda p: written(
        p,
        [f"{1e3 * t:.9e},{row.partition(',')[2]}" for t, row in zip(T, lines(), strict=True)],
        "Time [ms]," + ",".join(files.NAMES),
    ),
    "time in minutes": lambda p: written(
        p,
        [f"{t / 60:.15e},{row.partition(',')[2]}" for t, row in zip(T, lines(), strict=True)],
        "Time (min)," + ",".join(files.NAMES),
    ),
    "dates": lambda p: written(p, stamped(clock)),
    "dates with T and Z": lambda p: written(p, stamped(lambda k: clock(k, "%Y-%m-%dT%H:%M:%S.%fZ"))),
    "German dates": lambda p: written(p, stamped(lambda k: clock(k, "%d.%m.%Y %H:%M:%S.%f"))),
    "American dates": lambda p: written(p, stamped(lambda k: clock(k, "%m/%d/%Y %I:%M:%S.%f %p"))),
    "time of day": lambda p: written(p, stamped(lambda k: clock(k, "%H:%M:%S.%f"))),
    "date and time apart": lambda p: written(
        p, stamped(lambda k: clock(k, "%Y-%m-%d,%H:%M:%S.%f")), "Date," + ",".join(HEADS)
    ),
    "dates under another name": lambda p: written(p, stamped(clock), "Logged," + ",".join(files.NAMES)),
}


@pytest.mark.parametrize("kind", TEXTS)
def test_a_text_of_any_kind_is_read_as_the_plain_one(tmp_path, kind):
    assert difference(TEXTS[kind](tmp_path / "a.csv")) < 2e-9


def test_a_text_without_a_time_of_use_is_read_with_a_sample_rate(tmp_path):
    path = written(tmp_path / "a.csv", stamped(lambda k: "2026-03-02 10:04:07"))
    refused(path, "stands still .* --sample-rate")
    assert difference(path, sample_rate_hz=1 / DT) < 2e-9


@pytest.mark.parametrize(
    ("head", "words"),
    [
        ("Time [ticks],Va,Vb,Vc,Ia,Ib,Ic", "the time is in 'ticks', which is no unit known here"),
        ("Time,Va,Vb,Vc,Ia", "the headings have 5 cells, the rows 7: not used"),
    ],
)
def test_headings_that_cannot_be_used_are_told(tmp_path, head, words):
    refused(written(tmp_path / "a.csv", lines(), head), words)


def test_what_is_no_table_is_told_by_its_cause(tmp_path):
    refused(written(tmp_path / "a.csv", [f"{x:.6e}" for x in T], "Va"), "a single column of numbers")
    refused(
        written(tmp_path / "b.csv", ["alpha,beta"] * 50, ""),
        "a header, and no rows of numbers; the last line reads 'alpha,beta'",
    )
    refused(written(tmp_path / "c.csv", [], "# nothing"), "holds comments only")


def test_decimal_commas_between_commas_are_told_and_not_read_as_whole_numbers(tmp_path):
    rows = [line.replace(".", ",") for line in lines()]
    refused(written(tmp_path / "a.csv", rows, "t,Va,Vb,Vc,Ia,Ib,Ic"), "decimal commas, with commas between the cells")


def test_a_written_name_is_taken_as_it_is_written(tmp_path):
    heads = [f"{name}_{'V' if name[0] == 'V' else 'A'}" for name in files.NAMES]
    path = written(tmp_path / "a.csv", lines(), ",".join(["t", *heads]))
    roles = dict(zip(("va", "vb", "vc", "ia", "ib", "ic"), heads, strict=True))
    assert difference(path, channels=roles) < 2e-9


# Uneven times


def uneven(path, sampled, printed):
    """Three phases and currents sampled at times ``sampled``, with times ``printed`` beside them."""
    v = 563.0 * np.exp(100j * np.pi * sampled) * (1.0 + 0.02 * np.exp(2j * np.pi * 77.0 * sampled))
    samples = files.six(Stretch(v=v, i=v / (3.0 + 2.0j)))
    rows = [",".join([f"{t:.6f}", *(f"{x:.6f}" for x in row)]) for t, row in zip(printed, samples, strict=True)]
    return written(path, rows)


EVEN = 250e-6 * np.arange(2000)
CUT = np.floor(EVEN * 1e4 + 1e-9) / 1e4
"""250 us printed to 100 us, cut off: steps of 200 and 300 us, alternately."""


def test_the_step_of_times_that_are_cut_off_is_that_of_all_of_them(tmp_path):
    rounded = open_waveforms(uneven(tmp_path / "a.csv", EVEN, CUT), "load")
    assert rounded.dt_s == pytest.approx(250e-6, rel=2e-5)


def test_a_step_that_changes_slowly_is_refused(tmp_path):
    times = np.cumsum(250e-6 * (1.0 + 0.2 * np.arange(2000) / 2000))
    refused(uneven(tmp_path / "a.csv", times, times), "away from where a fixed step of .* puts it: the step changes")


# COMTRADE


def test_time_stamps_of_32_bits_may_begin_anew(tmp_path):
    stamps = (2**32 - 150_000 + np.rint(1e6 * T)) % 2**32
    assert difference(files.comtrade(tmp_path / "a", SAMPLES, form="FLOAT32", stamps=stamps)) < 1e-7


def test_a_rate_of_zero_asks_the_stamps_and_a_gap_in_them_is_refused(tmp_path):
    stamps = np.rint(1e6 * T)
    assert difference(files.comtrade(tmp_path / "a", SAMPLES, form="FLOAT32", rates=[(0, N)], stamps=stamps)) < 1e-7
    stamps[N // 2 :] += 50_000
    refused(files.comtrade(tmp_path / "b", SAMPLES, rates=[(0, N)], stamps=stamps), "there is a gap")
    refused(files.comtrade(tmp_path / "c", SAMPLES, stamps=stamps), "there is a gap; .*--sample-rate")
    assert difference(tmp_path / "c.cfg", sample_rate_hz=1 / DT) < 1e-4


def test_a_section_at_another_rate_begins_where_the_one_before_it_ends(tmp_path):
    head = np.tile(SAMPLES[:1], (500, 1))
    stamps = np.concatenate([np.arange(500) * 1e3, 500e3 + np.rint(1e6 * T)])
    path = files.comtrade(
        tmp_path / "a", np.vstack([head, SAMPLES]), form="FLOAT32", rates=[(1e3, 500), (1e4, 500 + N)], stamps=stamps
    )
    assert open_waveforms(path, "load").t0_s == pytest.approx(0.5, abs=1e-12)
    assert difference(path) < 1e-7


def edited(path, old, new):
    """A configuration with one text replaced."""
    cfg = path.read_text()
    assert old in cfg
    path.write_text(cfg.replace(old, new, 1))
    return path


def test_skew_is_turned_back(tmp_path):
    t = T + 250e-6
    i = 800.0 * np.exp(1j * (2 * np.pi * 50.0 * t - 1.0))
    samples = files.six(Stretch(v=TRUTH.v, i=i))
    path = files.comtrade(tmp_path / "a", samples, form="FLOAT32")
    for name in ("Ia", "Ib", "Ic"):
        edited(path, f"{name},,,A,1,0,0,", f"{name},,,A,1,0,250,")
    waveforms = open_waveforms(path, "load")
    record = waveforms.record(0, waveforms.n_samples)
    at = np.rint(waveforms.t0_s / DT + np.arange(waveforms.n_samples)).astype(int)
    assert np.max(np.abs(record.i - TRUTH.i[at])) < 1e-5 * 800.0
    assert np.max(np.abs(record.v - TRUTH.v[at])) < 1e-6 * 563.0
    assert "sampled 250 us later" in notes(path)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("6,6A,0D", "7,7A,0D", "line 9 .* should be analog channel 7; line 2 announces 7 analog .* reads '50'"),
        ("6,6A,0D", "5,5A,0D", "line 8 .* should be the line frequency; line 2 announces 5 analog"),
        ("6,6A,0D", "six", "line 2 .* should be the numbers of channels"),
        ("1,Va,", "1,Va, bus 3,", "line 3 .* it has 14 cells, a channel has 13: a comma within a name"),
        ("\n1\n10000", "\none\n10000", "line 10 .* should be the number of sampling rates, .* 'one' is no number"),
    ],
)
def test_a_configuration_that_does_not_fit_is_refused_by_its_line(tmp_path, old, new, words):
    refused(edited(files.comtrade(tmp_path / "a", SAMPLES), old, new), words)


def test_commas_that_do_no_harm_are_mended(tmp_path):
    path = edited(files.comtrade(tmp_path / "a", SAMPLES, form="ASCII"), "1,Va,", '1,"Va, PCC",')
    path.write_text(path.read_text().replace("P\n", "P,\n"))
    dat = path.with_suffix(".dat")
    dat.write_bytes(dat.read_bytes().replace(b"\r\n", b",\r\n"))
    assert "Va; PCC" in [
        channel.name
        for channel in open_waveforms(
            path, "load", channels={"va": "Va; PCC", "vb": "Vb", "vc": "Vc"}
        ).recording.channels
    ]


# MATLAB and HDF5


def simulink(values):
    signals = np.array([(v, n) for v, n in values], dtype=[("values", "O"), ("label", "O")])
    return {"time": T[:, None], "signals": signals}


VOLTAGES, CURRENTS = SAMPLES[:, :3], SAMPLES[:, 3:]
STRUCTS = {
    "3x1xN values": {"out": simulink([(VOLTAGES.T[:, None, :], "Vabc"), (CURRENTS.T[:, None, :], "Iabc")])},
    "a structure of vectors": {"s": {"t": T, **COLUMNS}},
    "a structure of structures": {
        "s": {
            "time": T,
            "v": {"a": VOLTAGES[:, 0], "b": VOLTAGES[:, 1], "c": VOLTAGES[:, 2]},
            "i": {"a": CURRENTS[:, 0], "b": CURRENTS[:, 1], "c": CURRENTS[:, 2]},
        }
    },
    "structures with data": {"s": {name: {"time": T, "data": x} for name, x in COLUMNS.items()}},
    "an array of structures": {
        "t": T,
        "rec": np.array(
            [(name, x, "V" if name[0] == "V" else "A") for name, x in COLUMNS.items()],
            dtype=[("name", "O"), ("data", "O"), ("unit", "O")],
        ),
    },
    "a record per sample": {
        "rec": np.array([tuple(row) for row in ROWS], dtype=[(name, "O") for name in ("time", *files.NAMES)])
    },
    "complex space vectors": {
        "t": T,
        "v": (VOLTAGES[:, 0] + 1j * (VOLTAGES[:, 1] - VOLTAGES[:, 2]) / 3**0.5),
        "i": (CURRENTS[:, 0] + 1j * (CURRENTS[:, 1] - CURRENTS[:, 2]) / 3**0.5),
    },
}


@pytest.mark.parametrize("kind", STRUCTS)
def test_matlab_structures_of_any_kind_are_read(tmp_path, kind):
    savemat(tmp_path / "a.mat", STRUCTS[kind])
    channels = None
    if kind == "a structure of structures":
        channels = {f"{q}{p}": f"s.{q}.{p}" for q in "vi" for p in "abc"}
    assert difference(tmp_path / "a.mat", channels=channels) < 1e-12


def test_hdf5_units_may_be_arrays_of_texts(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["time"] = T
        for k, (name, x) in enumerate(COLUMNS.items()):
            channel = file.create_dataset(f"rec/x{'abcabc'[k]}{k // 3}", data=x)
            channel.attrs["Unit"] = np.array([b"V" if name[0] == "V" else b"A"])
    roles = {role: f"x{'abcabc'[k]}{k // 3}" for k, role in enumerate(("va", "vb", "vc", "ia", "ib", "ic"))}
    assert difference(tmp_path / "a.h5", channels=roles) < 1e-15
    assert "[V]" in notes(tmp_path / "a.h5", channels=roles)


def test_struct_arrays_of_matlab_73_are_followed(tmp_path):
    with h5py.File(tmp_path / "a.mat", "w", userblock_size=512) as file:
        group = file.create_group("rec")
        for field in ("name", "data"):
            refs = group.create_dataset(field, (1, 6), dtype=h5py.ref_dtype)
            for k, (name, x) in enumerate(COLUMNS.items()):
                value = np.array([[ord(c)] for c in name], "u2") if field == "name" else x[None]
                item = file.create_dataset(f"#refs#/{field}{k}", data=value)
                item.attrs["MATLAB_class"] = np.bytes_("char" if field == "name" else "double")
                refs[0, k] = item.ref
        file["t"] = T[None]
    with open(tmp_path / "a.mat", "r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file")
    assert difference(tmp_path / "a.mat") < 1e-15


def test_a_record_per_sample_of_matlab_73_is_followed(tmp_path):
    rows = ROWS[::15]
    with h5py.File(tmp_path / "a.mat", "w", userblock_size=512) as file:
        group = file.create_group("rec")
        for k, field in enumerate(("time", *files.NAMES)):
            refs = group.create_dataset(field, (len(rows), 1), dtype=h5py.ref_dtype)
            for j, row in enumerate(rows):
                refs[j, 0] = file.create_dataset(f"#refs#/{field}{j}", data=[[row[k]]]).ref
    with open(tmp_path / "a.mat", "r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file")
    record = open_waveforms(tmp_path / "a.mat", "load").record(0, len(rows))
    assert record.dt_s == pytest.approx(15 * DT)
    assert np.max(np.abs(record.v - TRUTH.v[::15])) < 1e-9


def test_a_data_set_that_was_never_written_is_refused(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for name in ("time", *files.NAMES):
            file.create_dataset(name, (10**12,), "f8", chunks=(4096,), compression="gzip")
    refused(tmp_path / "a.h5", r"announces 7.63e\+06 MB, of which the file holds 0 bytes")


def test_complex_records_of_hdf5_are_space_vectors(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["t"] = T
        for name, x in (("v", VOLTAGES), ("i", CURRENTS)):
            pairs = np.zeros(N, [("real", "f8"), ("imag", "f8")])
            pairs["real"], pairs["imag"] = x[:, 0], (x[:, 1] - x[:, 2]) / 3**0.5
            file[name] = pairs
    assert difference(tmp_path / "a.h5") < 1e-12


def test_structures_with_times_of_their_own_are_brought_together(tmp_path):
    later = T[40:]
    parts = {
        name: {"time": T if name[0] == "V" else later, "data": x if name[0] == "V" else x[40:]}
        for name, x in COLUMNS.items()
    }
    savemat(tmp_path / "a.mat", {"s": parts})
    waveforms = open_waveforms(tmp_path / "a.mat", "load")
    record = waveforms.record(0, waveforms.n_samples)
    assert waveforms.t0_s == pytest.approx(40 * DT)
    assert np.max(np.abs(record.v - TRUTH.v[40:])) < 1e-9
    assert np.max(np.abs(record.i - TRUTH.i[40:])) < 1e-9


# Parquet


def parquet(path, time, **options):
    pq.write_table(pa.table({**({"time": time} if time is not None else {}), **COLUMNS}), path, **options)
    return path


def test_parquet_times_may_be_stamps_or_durations(tmp_path):
    ns = np.rint(1e9 * T).astype("i8") + 1_772_000_000_123_456_789
    for name, kind in (("a", pa.timestamp("ns")), ("b", pa.timestamp("us", "UTC")), ("c", pa.duration("ns"))):
        scale = 1000 if kind.unit == "us" else 1
        path = parquet(tmp_path / f"{name}.parquet", pa.array(ns // scale, kind), row_group_size=700)
        assert difference(path) < 1e-15


def test_the_index_of_a_pandas_table_is_its_time(tmp_path):
    pd = pytest.importorskip("pandas")
    for name, index in (("a", pd.Index(T)), ("b", pd.to_timedelta(T, unit="s")), ("c", pd.Index(T, name="seconds"))):
        pd.DataFrame(COLUMNS, index=index).to_parquet(tmp_path / f"{name}.parquet")
        assert difference(tmp_path / f"{name}.parquet") < 1e-15


# TDMS and MDF4


def tdms(path, shift_s, names=files.NAMES, by_offset=False):
    """Voltages and currents in groups of their own, the currents begun ``shift_s`` later."""
    nptdms = pytest.importorskip("nptdms")
    i = 800.0 * np.exp(1j * (2 * np.pi * 50.0 * (T + shift_s) - 1.0))
    samples = files.six(Stretch(v=TRUTH.v, i=i))
    start = np.datetime64("2026-03-02T10:00:00.000000", "us")
    channels = []
    for k, name in enumerate(names):
        late = shift_s if k > 2 else 0.0
        properties = {
            "wf_increment": DT,
            "wf_start_time": start + (0 if by_offset else np.timedelta64(round(late * 1e6), "us")),
            "wf_start_offset": late if by_offset else 0.0,
        }
        channels.append(nptdms.ChannelObject("g" if k < 3 else "h", name, samples[:, k], properties=properties))
    with nptdms.TdmsWriter(str(path)) as writer:
        writer.write_segment(channels)
    return path


@pytest.mark.parametrize("by_offset", [False, True])
@pytest.mark.parametrize("shift_s", [0.0, 2.5e-3, 130e-6])
def test_tdms_groups_begin_when_they_say(tmp_path, shift_s, by_offset):
    path = tdms(tmp_path / "a.tdms", shift_s, [f"{n} ({n[0].replace('I', 'A')})" for n in files.NAMES], by_offset)
    waveforms = open_waveforms(path, "load")
    record = waveforms.record(0, waveforms.n_samples)
    t = waveforms.t0_s + DT * np.arange(waveforms.n_samples)
    truth = 800.0 * np.exp(1j * (2 * np.pi * 50.0 * t - 1.0))
    assert np.max(np.abs(record.i - truth)) < 2e-5 * 800.0
    assert [channel.unit for channel in waveforms.recording.channels] == list("VVVAAA")


@pytest.mark.filterwarnings("default")  # of the library's own imports
def test_mdf4_with_one_channel_per_group_is_read(tmp_path):
    asammdf = pytest.importorskip("asammdf")
    with asammdf.MDF(version="4.10") as mdf:
        for name, x in COLUMNS.items():
            late = 30 if name[0] == "I" else 0
            mdf.append([asammdf.Signal(x[late:], T[late:], name=name, unit=name[0].replace("I", "A"))])
        mdf.save(tmp_path / "a.mf4")
    waveforms = open_waveforms(tmp_path / "a.mf4", "load")
    record = waveforms.record(0, waveforms.n_samples)
    assert waveforms.n_samples == N - 30
    assert np.max(np.abs(record.i - TRUTH.i[30:])) < 1e-9
    assert np.max(np.abs(record.v - TRUTH.v[30:])) < 1e-9


# Units


def in_units(path, unit_v="", unit_a="", scale_v=1.0, scale_a=1.0):
    heads = [f"{n} [{u}]" if (u := unit_v if n[0] == "V" else unit_a) else n for n in files.NAMES]
    scale = np.repeat([scale_v, scale_a], 3)
    return files.text(path, SAMPLES * scale, heads=heads)


BASE = (563.0, 800.0)


@pytest.mark.parametrize(
    ("units", "scales", "likely"),
    [
        (("", ""), (1e-3, 1e-3), r"the voltage .*taken as V.* as kV would be 1 times"),
        (("V", ""), (1.0, 1e-3), r"the current .*taken as A.* as kA would be 1 times"),
        (("kV", "A"), (1.0, 1.0), "the voltage .*as its unit says.* as V would be 1 times"),
        (("V", "kA"), (1.0, 1.0), "the current .*as its unit says.* as A would be 1 times"),
        (("V", ""), (1.0, 0.05), "the current .*taken as A, no unit is given"),
    ],
)
def test_values_far_from_their_rating_are_refused_with_the_likely_unit(tmp_path, units, scales, likely):
    refused(in_units(tmp_path / "a.csv", *units, *scales), likely, base=BASE)


@pytest.mark.parametrize("units", [("", ""), ("V", "A")])
def test_the_unit_that_is_told_overrules_the_file(tmp_path, units):
    path = in_units(tmp_path / "a.csv", *units, 1e-3, 1e-3)
    assert difference(path, base=BASE, units={"voltage": "kV", "current": "kA"}) < 1e-12
    if units[0]:
        assert "the voltage is in kV, as asked, where the file says V" in notes(path, units={"voltage": "kV"})


def test_a_device_at_rest_is_believed_where_its_unit_is_told(tmp_path):
    path = in_units(tmp_path / "a.csv", "V", "A", 1.0, 0.01)
    assert open_waveforms(path, "load", base=BASE).n_samples == N


def test_a_voltage_of_next_to_nothing_without_any_unit_is_asked_about(tmp_path):
    path = in_units(tmp_path / "a.csv", "", "", 1e-3, 1e-3)
    refused(path, "has no unit and a size of 0.6896, line to line: in kV, or per unit")
    assert difference(path, units={"voltage": "kV", "current": "kA"}) < 1e-12


@pytest.mark.parametrize(("text", "factor"), [("mV", 1e-3), ("MV", 1e6), ("kV", 1e3), ("KV", 1e3), ("Volts", 1.0)])
def test_capitals_tell_milli_from_mega(text, factor):
    assert unit_of(text) == ("voltage", factor)


def test_a_unit_that_is_none_is_refused():
    with pytest.raises(SeqsweepError, match="--voltage-unit 'A': known are V, kV"):
        parse_units("A", None)
