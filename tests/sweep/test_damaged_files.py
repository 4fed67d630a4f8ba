"""Damaged files of every kind: read, or refused in one line that names file and cause; the runner never suffers.

`make evidence` damages every kind 20,000 times (``SEQSWEEP_MUTATIONS`` says how many) from a new seed and writes the
figures into docs/recordings-that-go-wrong.md.
"""

from __future__ import annotations

import json
import os
import secrets
import subprocess
import sys
import warnings
import zipfile
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from ..support import recording_files as files
from ..support.by_hand import Stretch

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / "tests" / "support" / "mutations.py"
PAGE = ROOT / "docs" / "recordings-that-go-wrong.md"

T = 1e-3 * np.arange(1200)
TONE = 1.0 + 0.01 * np.exp(54j * np.pi * T)
SAMPLES = files.six(Stretch(v=563.0 * np.exp(100j * np.pi * T) * TONE, i=80.0 * np.exp(100j * np.pi * T - 1j)))


def copied(*names):
    """Files of data/."""

    def make(folder):
        for name in names:
            (folder / Path(name).name).write_bytes((ROOT / "data" / name).read_bytes())

    return make


def people_csv(folder):
    """What people do to text, all at once: a title, units in a row, dates, decimal commas, words."""
    heads = ["Zeit", *files.NAMES, "Zustand"]
    rows = [
        ";".join([f"02.03.2026 10:00:{t:09.6f}", *(f"{x:.6f}" for x in row), "gut"]).replace(".", ",")
        for t, row in zip(T, SAMPLES, strict=True)
    ]
    rows = [row.replace("02,03,2026", "02.03.2026") for row in rows]
    lines = ["Messung 7", "", ";".join(heads), ";V;V;V;A;A;A;", *rows]
    (folder / "a.csv").write_text("\n".join(lines) + "\n", "latin-1")


def tdms(folder):
    nptdms = pytest.importorskip("nptdms")
    properties = {
        "wf_increment": 1e-3,
        "wf_start_offset": 0.0,
        "wf_start_time": np.datetime64("2026-03-02T10:00:00", "us"),
    }
    with nptdms.TdmsWriter(str(folder / "a.tdms")) as writer:
        writer.write_segment(
            [
                nptdms.ChannelObject("g", name, x, properties={**properties, "unit_string": name[0].replace("I", "A")})
                for name, x in zip(files.NAMES, SAMPLES.T, strict=True)
            ]
        )


def mdf(folder):
    asammdf = pytest.importorskip("asammdf")
    with asammdf.MDF(version="4.10") as one:
        one.append([asammdf.Signal(x, T, name=name) for name, x in zip(files.NAMES, SAMPLES.T, strict=True)])
        one.save(folder / "a.mf4")


def simulink(folder):
    from scipy.io import savemat

    signals = np.array([(SAMPLES[:, :3], "V"), (SAMPLES[:, 3:], "I")], dtype=[("values", "O"), ("label", "O")])
    savemat(folder / "a.mat", {"log": {"time": T[:, None], "signals": signals}}, do_compression=True)


F_HZ = np.geomspace(2.0, 900.0, 40)


def admittance():
    """Ypn (n, 2, 2) of an R-L branch with a lag in dd, in S."""
    from seqsweep.identify.frames import dq_to_pn

    s = 2j * np.pi * (F_HZ - 50.0)
    z = np.empty((len(F_HZ), 2, 2), dtype=complex)
    z[:, 0, 0], z[:, 1, 1] = 0.3 + 2e-3 * s + 0.8 / (1.0 + 4e-3 * s), 0.3 + 2e-3 * s
    z[:, 0, 1], z[:, 1, 0] = -0.6, 0.6
    return dq_to_pn(np.linalg.inv(z))


def responses():
    from seqsweep.identify.response import FrequencyResponse

    return [FrequencyResponse(F_HZ, admittance(), 50.0, meta={"op_id": "p1"})]


META = {
    **{"f1_hz": 50.0, "bases": {"rated_voltage_v": 690.0, "rated_power_va": 1.6e6}, "power_meaning": "out of it"},
    **{"plant": {"id": "x-v1"}, "configuration": {"plant": {"id": "x-v1"}}},
    "operating_points": [{"op_id": "p1", "active_power_mw": 0.5, "terminal_voltage_pu": 1.0}],
}


def table(folder):
    from seqsweep.identify.table.write import write_table

    write_table(folder / "y.parquet", responses(), META)


def tuning(folder):
    from seqsweep.identify.table.read import read_table
    from seqsweep.tuning.result import write_json
    from seqsweep.tuning.siso import parse_grid
    from seqsweep.tuning.tune import tune

    table(folder)
    result = tune(read_table(folder / "y.parquet"), parse_grid("0.012+0.1j", 50.0))
    (folder / "y.parquet").unlink()
    write_json(result, folder / "tuning.json")


def exported(name):
    """The table in another format."""

    def make(folder):
        from seqsweep.sweep.cli.exchange import export_table, format_of

        table(folder)
        export_table(folder / "y.parquet", folder / name, format_of(folder / name, None))
        (folder / "y.parquet").unlink()

    return make


def frd_73(folder):
    import warnings

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        matio = pytest.importorskip("matio")
    from matio.utils.matclass import MatlabOpaque

    data = {"Response": np.moveaxis(admittance(), 0, -1), "Frequency": F_HZ[:, None], "FreqUnits": np.array(["Hz"])}
    model = MatlabOpaque({"Data_": MatlabOpaque(data, classname="ltipack.frddata")}, classname="frd")
    matio.save_to_mat(str(folder / "g.mat"), {"G": model}, version="v7.3")


def workbook(folder):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    parts = [f"Y{e}_{p} [S]" for e in ("pp", "pn", "np", "nn") for p in ("re", "im")]
    book.active.append(["f [Hz]", *parts])
    for f, y in zip(F_HZ, admittance().reshape(-1, 4), strict=True):
        book.active.append([float(f), *(float(x) for value in y for x in (value.real, value.imag))])
    book.save(folder / "y.xlsx")


SCENARIO = """\
duration_s = 2.0
[[event]]
time_s = 1.0
kind = "grid_step"
scale = 1.5
"""


def scenario(folder):
    (folder / "story.toml").write_text(SCENARIO)


def campaign(folder):
    (folder / "table1.toml").write_bytes((ROOT / "examples" / "table1.toml").read_bytes())


def fmu(folder):
    pytest.importorskip("fmpy")
    from ..support.fmus import description

    with zipfile.ZipFile(folder / "box.fmu", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("modelDescription.xml", description())
        archive.writestr("binaries/linux64/box.so", bytes(2000))
        archive.writestr("resources/values.txt", "1 2 3\n" * 100)


SUBJECTS = {
    "COMTRADE ASCII": ("recording", copied("comtrade_ascii/direct.cfg", "comtrade_ascii/direct.dat")),
    "COMTRADE BINARY": ("recording", copied("comtrade_binary/direct.cfg", "comtrade_binary/direct.dat")),
    "COMTRADE FLOAT32": ("recording", copied("comtrade_float32/direct.cfg", "comtrade_float32/direct.dat")),
    "COMTRADE CFF": ("recording", copied("comtrade_cff/direct.cff")),
    "CSV": ("recording", copied("csv/direct.csv")),
    "CSV of people": ("recording", people_csv),
    "PSCAD": ("recording", copied("pscad/direct.inf", "pscad/direct_01.out")),
    "Parquet": ("recording", copied("parquet/direct.parquet")),
    "MATLAB 5": ("recording", copied("matlab_5/direct.mat")),
    "MATLAB 5, Simulink": ("recording", simulink),
    "MATLAB 7.3": ("recording", copied("matlab_73/direct.mat")),
    "HDF5": ("recording", copied("hdf5/direct.h5")),
    "TDMS": ("recording", tdms),
    "MDF4": ("recording", mdf),
    "table": ("table", table),
    "manifest": ("manifest", copied("manifest.json")),
    "tuning.json": ("tuning", tuning),
    "campaign": ("campaign", campaign),
    "scenario": ("scenario", scenario),
    "import of CSV": ("import", exported("y.csv")),
    "import of .mat": ("import", exported("y.mat")),
    "import of .mat 7.3 (frd)": ("import", frd_73),
    "import of Touchstone": ("import", exported("y.s2p")),
    "import of .xlsx": ("import", workbook),
    "FMU archive": ("fmu", fmu),
}

SEED, COUNT = 20260302, 8
"""In CI 200 files in all, the same ones every time."""


def originals(folder, subject):
    """Whole files of a kind."""
    place = folder / subject.replace(" ", "_").replace(",", "")
    place.mkdir()
    SUBJECTS[subject][1](place)
    return place


def outcomes(places, seed, count):
    """What the script says of so many damaged copies of each subject; a crash of it is a problem like any other."""
    subjects = [word for subject, place in places.items() for word in (SUBJECTS[subject][0], str(place))]
    command = [sys.executable, str(SCRIPT), str(seed), str(count), *subjects]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=1200 + count * len(places), check=False)
        said, words = done.stdout, f"ended with {done.returncode}: {done.stderr[-2000:]}"
        failed = done.returncode != 0 or "Traceback" in done.stderr
    except subprocess.TimeoutExpired as late:
        said, words, failed = (late.stdout or b"").decode(), f"seed {seed}: hung", True
    found = dict(zip(places, map(json.loads, said.splitlines()), strict=False))
    met = [*places][len(found) if len(found) < len(places) else -1] if failed else None
    return found | ({met: {"read": 0, "refused": 0, "problems": [words]}} if met else {})


def outcome(subject, place, seed, count):
    """What is said of one subject, by a process of its own."""
    return outcomes({subject: place}, seed, count)[subject]


@pytest.fixture(scope="module")
def judged(tmp_path_factory):
    """Every subject, by one process: starting it takes longer than its readers."""
    folder, places = tmp_path_factory.mktemp("damaged"), {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of third-party writers
        for subject in SUBJECTS:
            with suppress(pytest.skip.Exception):  # the library that writes it is not installed
                places[subject] = originals(folder, subject)
    return places, outcomes(places, SEED, COUNT)


@pytest.mark.parametrize("subject", SUBJECTS)
def test_damaged_files_are_read_or_refused_by_name_and_cause(judged, subject):
    places, all_found = judged
    if subject not in places:
        pytest.skip("the library that writes such files is not installed")
    assert subject in all_found, "not reached: see the subject that ended the process"
    found = all_found[subject]
    assert found["problems"] == []
    assert found["read"] + found["refused"] == COUNT
    assert found["memory_mb"] < 1500.0


@pytest.mark.evidence
@pytest.mark.filterwarnings("default")
def test_every_kind_is_damaged_many_times(tmp_path):
    """The figures of docs/recordings-that-go-wrong.md."""
    count = int(os.environ.get("SEQSWEEP_MUTATIONS", "20000"))
    seed = secrets.randbelow(10**6)
    print(f"seed {seed}, {count} of each kind")
    part = 500
    places = {subject: originals(tmp_path, subject) for subject in SUBJECTS}
    parts = [min(part, count - start) for start in range(0, count, part)]
    with ThreadPoolExecutor(2) as pool:
        work = {
            subject: [pool.submit(outcome, subject, place, 1000 * seed + k, n) for k, n in enumerate(parts)]
            for subject, place in places.items()
        }
        found = {subject: [each.result() for each in futures] for subject, futures in work.items()}
    problems = [f"{subject}: {each}" for subject, all_ in found.items() for one in all_ for each in one["problems"]]
    _write(found, count, len(problems))
    assert problems == []


def _write(found, count, n_problems):
    """The table of figures between the marks of the page."""
    lines = [
        f"{count} damaged files of each kind, a new seed each time (`make evidence`). Crashes and hangs of the runner,",
        f"tracebacks, refusals without file or cause: {n_problems}.",
        "",
        "| kind | read | refused | slowest (s) | memory (MB) |",
        "|---|---|---|---|---|",
    ]
    for subject, parts in found.items():
        read, refused = (sum(one[key] for one in parts) for key in ("read", "refused"))
        slowest, memory = (max(one.get(key, 0.0) for one in parts) for key in ("slowest_s", "memory_mb"))
        lines.append(f"| {subject} | {read} | {refused} | {slowest:.1f} | {memory:.0f} |")
    text = PAGE.read_text("utf-8")
    head, rest = text.split("<!-- damaged files -->\n")[0], text.split("<!-- end -->")[1]
    PAGE.write_text(f"{head}<!-- damaged files -->\n" + "\n".join(lines) + f"\n<!-- end -->{rest}", "utf-8")
