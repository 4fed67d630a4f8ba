"""The console script: every exit status, every refusal in one message, nothing half-written."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import time

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from ..support.commands import (
    SEQSWEEP,
    call,
    campaign,
    command,
    end_group,
    group_members,
    least_cpu_s,
    shards_of,
    slow_campaign,
    start_held,
    wait_for,
)

OK, NOT_ALL_OK, WRONG_INPUT, INTERRUPTED, MACHINE = range(5)


def listing(folder):
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*"))


def assert_refused(done, words, status=WRONG_INPUT):
    """One message, on stderr, that says ``words``; no traceback, and nothing on stdout."""
    assert done.returncode == status, done.stderr
    assert "Traceback" not in done.stderr
    assert "Error:" not in done.stderr.replace("Error: ", "", 1)
    assert done.stdout == ""
    assert words in done.stderr
    assert len(done.stderr.strip().splitlines()) <= 4  # a usage error has the usage above it


# Input that is wrong

BY_SETTING = {
    "unknown key": ("sweep.color=1", "sweep.color: unknown key"),
    "misspelt key": ("sweep.poins=10", "did you mean points?"),
    "wrong type": ('sweep.points="many"', 'given "many"; needed: a whole number'),
    "negative amplitude": ("injection.amplitude_pu=-0.001", "given -0.001; needed: a number above 0"),
    "huge amplitude": ("injection.amplitude_pu=5", "given 5; needed: a number above 0 and at most 0.2"),
    "not TOML": ("campaign.name=table one", "text needs quotes"),
    "no such entry": ("operating_point.7.active_power_mw=1.0", "a list of one entry, number 0"),
    "unknown plant": ('plant.id="brunch-v1"', "did you mean 'branch-v1'?"),
    "unknown parameter": ("plant.parameters.r_omh=1.0", "did you mean 'r_ohm'?"),
    "refused parameter": ("plant.parameters.r_ohm=-1.0", "r_ohm is -1; branch-v1 needs"),
    "awkward step": ("plant.parameters.dt_s=51.23456789e-6", "use a step such as"),
    "outside the range": ("operating_point.0.terminal_voltage_pu=3.0", "outside the operating range of branch-v1"),
    "shunt on ideal": ('injection.kind="shunt_current"', "cannot perturb a PCC that an ideal source holds"),
}


@pytest.mark.parametrize("case", BY_SETTING)
def test_a_wrong_value_is_refused_by_name(tmp_path, case):
    setting, words = BY_SETTING[case]
    path, before = campaign(tmp_path), ["campaign.toml"]
    assert_refused(command("run", path, "-o", tmp_path / "y.parquet", "--set", setting), words)
    assert listing(tmp_path) == before


LISTED = {
    "f1": ("[10.0, 50.0]", "50 Hz is the fundamental itself"),
    "Nyquist": ("[10.0, 12000.0]", "Nyquist frequency of 10000 Hz"),
    "twice": ("[10.0, 10.0]", "10 Hz is there twice"),
    "unsorted": ("[20.0, 10.0]", "10 Hz follows 20 Hz"),
    "zero": ("[0.0, 10.0]", "above 0"),
}


@pytest.mark.parametrize("case", LISTED)
def test_an_impossible_frequency_is_refused_with_the_reason(tmp_path, case):
    f_hz, words = LISTED[case]
    path = campaign(tmp_path)
    text = path.read_text().replace("f_min_hz = 20.0\nf_max_hz = 900.0\npoints = 8", f"f_hz = {f_hz}")
    path.write_text(text)
    assert_refused(command("run", path, "-o", tmp_path / "y.parquet"), words)
    assert listing(tmp_path) == ["campaign.toml"]


def test_all_problems_of_a_file_are_told_at_once_each_at_its_line(tmp_path):
    path = campaign(tmp_path, powers=(0.1, 0.2))
    text = path.read_text().replace('id = "p1"', 'id = "p0"').replace("points = 8", "pionts = 8")
    path.write_text(text.replace("amplitude_pu = 0.001", "amplitude_pu = 7"))
    done = command("run", path, "-o", tmp_path / "y.parquet")
    lines = done.stderr.strip().splitlines()
    assert done.returncode == WRONG_INPUT
    assert len(lines) == 3
    assert all(line.startswith(f"{path}:") for line in lines)
    assert '"p0" is also operating_point.0' in lines[0]
    assert "did you mean points?" in lines[1]
    assert "at most 0.2" in lines[2]


def test_a_missing_file_is_refused_with_the_way_out(tmp_path):
    done = command("run", tmp_path / "none.toml", "-o", tmp_path / "y.parquet")
    assert_refused(done, "no such file; `seqsweep init -o")
    assert listing(tmp_path) == []


def test_a_plan_for_no_worker_is_refused(tmp_path):
    assert_refused(command("plan", campaign(tmp_path), "--jobs", "0"), "--jobs")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--backend", "mpi"], "known are threading, loky and dask"),
        (["--scheduler", "tcp://nowhere:1"], "--scheduler goes with --backend dask"),
        (["--jobs", "0"], "--jobs"),
        (["--job", "2"], "--jobs"),
    ],
)
def test_a_wrong_option_is_refused(tmp_path, arguments, words):
    assert_refused(command("run", campaign(tmp_path), "-o", tmp_path / "y.parquet", *arguments), words)
    assert listing(tmp_path) == ["campaign.toml"]


def test_an_output_that_cannot_be_is_refused_before_anything_runs(tmp_path):
    path = campaign(tmp_path)
    (tmp_path / "taken.parquet").write_text("mine")
    assert_refused(command("run", path, "-o", tmp_path), "is a folder; name a file")
    assert_refused(command("run", path, "-o", tmp_path / "none" / "y.parquet"), "no such folder")
    assert_refused(command("run", path, "-o", path / "y.parquet"), "no such folder")
    assert_refused(command("run", path, "-o", tmp_path / "taken.parquet"), "exists; --force replaces it")
    assert_refused(command("run", path, "-o", "/dev/null", "--force"), "is no ordinary file")
    assert (tmp_path / "taken.parquet").read_text() == "mine"
    assert listing(tmp_path) == ["campaign.toml", "taken.parquet"]


@pytest.mark.parametrize(
    "arguments",
    [["tune", "y.parquet", "--grid", "0.012+0.25j"], ["verify", "tuning.json"], ["grid", "campaign.toml"]],
    ids=lambda arguments: arguments[0],
)
def test_a_decision_is_not_replaced_unasked_nor_put_where_it_cannot_be(tmp_path, arguments):
    """Before the input is even read: it may take an hour to find out."""
    taken, folder = tmp_path / "taken.json", tmp_path / "folder.png"
    taken.write_text("mine")
    folder.mkdir()
    assert_refused(command(*arguments, "-o", taken), "taken.json exists; --force replaces it")
    assert_refused(command(*arguments, "-o", folder), "is a folder; name a file")
    assert_refused(command(*arguments, "-o", "/dev/null", "--force"), "is no ordinary file")
    assert_refused(command(*arguments, "--plot", folder), "is a folder; name a file")
    assert taken.read_text() == "mine"
    assert listing(tmp_path) == ["folder.png", "taken.json"]


@pytest.mark.parametrize(
    ("arguments", "name", "words"),
    [
        (["tune", "y.parquet", "--grid", "1j", "-o"], "t.csv", "what is written here is JSON; name it .json"),
        (["verify", "tuning.json", "-o"], "v.png", "what is written here is JSON; name it .json"),
        (["farm", "farm.toml", "-o"], "f.txt", "what is written here is JSON; name it .json"),
        (["surrogate", "y.parquet", "-o"], "p.csv", "what is written here is Parquet; name it .parquet"),
        (["import", "y.csv", "-o"], "z.csv", "what is written here is Parquet; name it .parquet"),
        (["identify", ".", "--direction", "load", "-o"], "z.csv", "what is written here is Parquet; name it .parquet"),
    ],
    ids=lambda value: value[0] if isinstance(value, list) else "",
)
def test_a_name_that_promises_another_format_is_refused(tmp_path, arguments, name, words):
    assert_refused(command(*arguments, tmp_path / name), words)
    assert listing(tmp_path) == []


def test_a_decision_is_replaced_with_force_and_a_picture_is_drawn_again(tmp_path):
    table, out, picture = tmp_path / "y.parquet", tmp_path / "tuning.json", tmp_path / "tuning.svg"
    assert command("run", campaign(tmp_path, plant="dpmsg-v1", n=24), "-o", table).returncode == OK
    out.write_text("old")
    picture.write_text("old")
    done = command("tune", table, "--grid", "0.012+0.25j", "-o", out, "--plot", picture, "--force")
    assert done.returncode == OK, done.stderr
    first = out.read_bytes()
    assert b'"seqsweep-tuning"' in first
    assert command("tune", table, "--grid", "0.012+0.25j", "--plot", picture).returncode == OK
    assert picture.stat().st_size > 10_000
    assert_refused(command("tune", table, "--grid", "0.012+0.25j", "-o", out), "exists; --force replaces it")
    assert out.read_bytes() == first


def test_a_file_that_is_no_table_is_refused(tmp_path):
    whole, foreign, cut = tmp_path / "y.parquet", tmp_path / "foreign.parquet", tmp_path / "cut.parquet"
    assert command("run", campaign(tmp_path), "-o", whole).returncode == OK
    pq.write_table(pa.table({"a": [1, 2]}), foreign)
    cut.write_bytes(whole.read_bytes()[:-100])
    (tmp_path / "text.parquet").write_text("f,y\n1,2\n")
    (tmp_path / "empty.parquet").touch()
    for asked, names in {
        "show": ["foreign", "cut", "missing"],
        "validate": ["foreign", "cut", "text", "empty"],
    }.items():
        for name in names:
            assert_refused(command(asked, tmp_path / f"{name}.parquet"), f"{name}.parquet")


# The tour


def test_from_init_to_show_as_the_help_says(tmp_path):
    path, table, picture = tmp_path / "campaign.toml", tmp_path / "y.parquet", tmp_path / "bode.svg"
    assert command("init", "-o", path).returncode == OK
    assert_refused(command("init", "-o", path), "exists")
    fewer = ["--set", "sweep.points=12"]
    planned = command("plan", path, *fewer)
    assert planned.returncode == OK
    assert "28 shots of 0.2817 V peak (0.0005 pu), series_voltage" in planned.stdout
    assert listing(tmp_path) == ["campaign.toml"]
    ran = command("run", path, "-o", table, *fewer)
    assert (ran.returncode, ran.stdout) == (OK, "")
    assert "12 ok" in ran.stderr
    shown = command("show", table, "--plot", picture)
    assert shown.returncode == OK
    assert "p065" in shown.stdout
    assert picture.stat().st_size > 10_000
    valid = command("validate", table)
    assert (valid.returncode, valid.stdout.strip()) == (OK, f"{table}: conforms")
    assert listing(tmp_path) == ["bode.svg", "campaign.toml", "y.parquet"]
    first = table.read_bytes()
    assert command("run", path, "-o", table, "--force", "--jobs", 1, *fewer).returncode == OK
    assert table.read_bytes() == first


def test_check_says_pass_or_fail_in_words_and_status():
    sound, broken = command("check", "branch-v1"), command("check", "python:plants:DriftingBranch")
    assert sound.returncode == OK
    assert "FAIL" not in sound.stdout
    assert broken.returncode == NOT_ALL_OK
    assert "FAIL" in broken.stdout
    assert "Traceback" not in broken.stderr
    assert_refused(command("check", "python:plants:Nothing"), "has no 'Nothing'")


def test_rows_that_are_not_ok_end_in_status_one_with_a_whole_table(tmp_path):
    path, table = campaign(tmp_path, plant="dpmsg-v1", n=4), tmp_path / "y.parquet"
    weak = "grid = { r_ohm = 0.012, x_ohm = 0.25, scale = 1.4 }"
    path.write_text(path.read_text().replace("terminal_voltage_pu = 1.0", weak) + '\n[source]\nkind = "thevenin"\n')
    done = command("run", path, "-o", table)
    assert done.returncode == NOT_ALL_OK
    assert f"{table}: 4 diverged" in done.stderr.splitlines()
    assert f"seqsweep show {table} says why" in done.stderr.splitlines()
    assert command("validate", table).returncode == OK
    shown = command("show", table)
    assert shown.returncode == OK
    assert "diverged" in shown.stdout
    assert "unstable" in shown.stdout


def test_a_plant_that_fails_in_every_way_ends_in_status_one(tmp_path):
    lines = '[plant.parameters]\nhow = "raises"\nlow_hz = 100.0\nhigh_hz = 300.0'
    path = campaign(tmp_path, plant="python:plants:FailingBranch", plant_lines=lines)
    done = command("run", path, "-o", tmp_path / "y.parquet")
    assert done.returncode == NOT_ALL_OK
    assert "failed" in done.stderr
    assert "Traceback" not in done.stderr
    shown = command("show", tmp_path / "y.parquet")
    assert "the converter tripped" in shown.stdout


def test_help_imports_nothing_heavy_and_is_quick():
    heavy = "{'numba', 'matplotlib', 'pyarrow', 'joblib', 'pandas', 'numpy', 'scipy', 'pydantic', 'llvmlite'}"
    code = (
        "import sys; sys.argv = ['seqsweep', '--help']\n"
        "from seqsweep.sweep.cli.main import main\n"
        f"try:\n    main()\nfinally:\n    print(sorted({heavy} & set(sys.modules)), file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=600)
    assert (done.returncode, done.stderr.strip()) == (OK, "[]")
    assert "validate" in done.stdout
    took_s = least_cpu_s(lambda: call("--help"), 1.0)
    assert call("--help").returncode == OK
    print(f"\n  seqsweep --help: {took_s:.2f} s of CPU (bar 0.35 s on a quiet machine)", end="")
    assert took_s < 1.0  # this machine may be busy; twice the imports of today would still be seen
    nothing = call()  # no command: the help, and a status that scripts notice
    assert (nothing.returncode, nothing.stdout) == (WRONG_INPUT, "")
    assert "validate" in nothing.stderr


# Ctrl-C


def test_a_request_to_end_is_ctrl_c(tmp_path):
    """What a scheduler, `timeout` or docker sends, to the command alone."""
    table = tmp_path / "y.parquet"
    path = slow_campaign(tmp_path, plant="python:plants:SlowPythonBranch")
    process = start_held(table, 1, "run", path, "-o", table, "--jobs", 2)
    try:
        process.terminate()
        _, said = process.communicate(timeout=600)
        assert process.returncode == INTERRUPTED, said
        assert "run the same command again to go on" in said
        wait_for(lambda: not group_members(process.pid), 120.0)
    finally:
        end_group(process)


@pytest.mark.parametrize("backend", ["threading", "loky"])
def test_ctrl_c_ends_soon_and_the_same_command_goes_on(tmp_path, backend):
    plant = "python:plants:SlowBranch" if backend == "threading" else "python:plants:SlowPythonBranch"
    path, table, fresh = slow_campaign(tmp_path, plant=plant), tmp_path / "y.parquet", tmp_path / "fresh.parquet"
    process = start_held(table, 2, "run", path, "-o", table, "--jobs", 2)
    try:
        begin = time.perf_counter()
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does: workers get it too
        _, said = process.communicate(timeout=600)
        seconds = time.perf_counter() - begin
        print(f"\n  Ctrl-C, {backend}: ended after {seconds:.2f} s (bar 2 s)", end="")
        assert process.returncode == INTERRUPTED, said  # the plant itself would go on for ever
        assert "run the same command again to go on" in said
        assert "Traceback" not in said
        assert not table.exists()
        assert shards_of(table)
        wait_for(lambda: not group_members(process.pid), 120.0)  # no worker is left behind
    finally:
        end_group(process)
    again = command("run", path, "-o", table, "--jobs", 2)
    assert again.returncode == OK
    assert re.search(r"^going on: (\d+)/96 points are measured already, (\d+) left$", again.stderr, re.MULTILINE)
    undisturbed = command("run", path, "-o", fresh, "--jobs", 1, "--backend", "threading")
    assert undisturbed.returncode == OK
    assert "going on" not in undisturbed.stderr
    assert table.read_bytes() == fresh.read_bytes()


def test_ctrl_c_does_not_wait_for_a_plant_that_is_deep_in_itself(tmp_path):
    path, table = slow_campaign(tmp_path), tmp_path / "y.parquet"
    process = start_held(table, 0, "run", path, "-o", table)
    try:
        os.killpg(process.pid, signal.SIGINT)
        process.communicate(timeout=600)
        assert process.returncode == INTERRUPTED  # the shot itself would never end
    finally:
        end_group(process)


# The machine


def test_a_second_run_on_one_output_says_so_and_stops(tmp_path):
    path, table = slow_campaign(tmp_path), tmp_path / "y.parquet"
    process = start_held(table, 0, "run", path, "-o", table)
    try:
        assert_refused(command("run", path, "-o", table), "another run is writing this output", MACHINE)
        assert process.poll() is None  # the first is not disturbed
    finally:
        end_group(process)


def test_a_disk_that_takes_no_more_is_the_machines_fault_and_costs_nothing_kept(tmp_path):
    """`ulimit -f` stands in for the full disk: a file may hold 1 KiB, a shard of eight points needs more."""
    path, table, fresh = campaign(tmp_path), tmp_path / "y.parquet", tmp_path / "fresh.parquet"
    assert command("run", path, "-o", fresh).returncode == OK
    full = call("run", path, "-o", table, wrapper=["bash", "-c", 'ulimit -f 1 && exec "$@"', "bash"])
    assert_refused(full, "run the same command again to go on", MACHINE)
    assert not table.exists()
    assert not list(tmp_path.glob("**/*.tmp"))
    assert command("run", path, "-o", table).returncode == OK
    assert table.read_bytes() == fresh.read_bytes()
    assert listing(tmp_path) == ["campaign.toml", "fresh.parquet", "y.parquet"]


@pytest.fixture
def mounted(tmp_path):
    """A function that mounts a tmpfs with options on a new folder; skips where that is not allowed."""
    folders = []

    def mount(options):
        folder = tmp_path / f"mount{len(folders)}"
        folder.mkdir()
        if shutil.which("mount") is None or os.geteuid() != 0:
            pytest.skip("mounting needs root")
        done = subprocess.run(["mount", "-t", "tmpfs", "-o", options, "none", str(folder)], capture_output=True)
        if done.returncode:
            pytest.skip("mounting is not allowed here")
        folders.append(folder)
        return folder

    yield mount
    for folder in folders:
        subprocess.run(["umount", str(folder)], check=True)


def test_a_full_file_system_is_the_machines_fault_and_nothing_false_is_left(tmp_path, mounted):
    path, small = campaign(tmp_path, n=40), mounted("size=16k")
    done = command("run", path, "-o", small / "y.parquet")
    assert_refused(done, "no space left on device", MACHINE)
    assert not (small / "y.parquet").exists()
    assert not list(small.glob("**/*.tmp"))
    assert not list(small.glob(".*"))


def test_a_read_only_folder_is_the_machines_fault(tmp_path, mounted):
    path, locked = campaign(tmp_path), mounted("ro")
    assert_refused(command("run", path, "-o", locked / "y.parquet"), "no permission to write", MACHINE)
    assert_refused(command("init", "-o", locked / "c.toml"), "no permission to write", MACHINE)


def test_a_closed_pipe_is_no_error(tmp_path):
    """`seqsweep show y.parquet | head -1`, in the worst case: the reader is gone before the first line."""
    table = tmp_path / "y.parquet"
    assert command("run", campaign(tmp_path), "-o", table).returncode == OK
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run([SEQSWEEP, "show", table], stdout=writer, stderr=subprocess.PIPE, text=True, timeout=600)
    os.close(writer)
    assert (done.returncode, done.stderr) == (OK, "")
