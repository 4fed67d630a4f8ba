"""A campaign against the elements: full and failing disks, few files, little memory, boxes that leave things behind.

`failing_files.c` is preloaded and lets the n-th call fail that changes something below a folder; n goes over all of
them in `make evidence`, over a few at random here.
"""

from __future__ import annotations

import errno
import functools
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from ..support import fmus
from ..support.commands import (
    HERE,
    SEQSWEEP,
    TOP,
    call,
    campaign,
    command,
    end_group,
    shards_of,
    slow_campaign,
    start_held,
    unfolded,
)
from ..support.controllers import COMPILER, needs_compiler

MACHINE = 4
LINUX = pytest.mark.skipif(sys.platform != "linux", reason="preloading and /proc are Linux's")


@functools.cache
def shim():
    """The library that fails, built beside nothing of ours."""
    import tempfile

    folder = Path(tempfile.mkdtemp(prefix="failing-files-"))
    source = HERE / "failing_files.c"
    subprocess.run([COMPILER, "-O1", "-Wall", "-shared", "-fPIC", "-o", folder / "fail.so", source, "-ldl"], check=True)
    return folder / "fail.so"


def with_failure(command, below, at, code, *, counter, once=False, **environment):
    """Run the command with its ``at``-th change below a folder failing; it, and how many changes were tried."""
    counter.unlink(missing_ok=True)
    failing = {
        "LD_PRELOAD": str(shim()),
        "FAIL_BELOW": f"{below}/",
        "FAIL_AT": str(at),
        "FAIL_WITH": str(code),
        "FAIL_ON": "once" if once else "",
        "FAIL_COUNT": str(counter),
    }
    done = call(*command, timeout=600, env={**os.environ, **failing, **environment})
    return done, counter.stat().st_size if counter.exists() else 0


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    path = tmp_path_factory.mktemp("elements") / "y.parquet"
    done = command("run", TOP / "examples" / "table1.toml", "-o", path)
    assert done.returncode == 0, done.stderr
    return path


def commands(table, out):
    """Every command that writes, and what it writes below ``out``."""
    return {
        "run": ["run", TOP / "examples" / "table1.toml", "--set", "sweep.points=8", "-o", out / "y.parquet"],
        "tune": ["tune", table, "--grid", "0.012+0.25j", "-o", out / "t.json", "--plot", out / "t.png"],
        "metrics": ["metrics", table, "-o", out / "m.json", "--plot", out / "m.pdf"],
        "show": ["show", table, "--plot", out / "b.svg"],
        "report": ["report", table, "-o", out / "r.html"],
        "csv": ["export", table, "-o", out / "y.csv"],
        "mat": ["export", table, "-o", out / "y.mat"],
        "touchstone": ["export", table, "-o", out / "y.s2p"],
        "init": ["init", "-o", out / "c.toml"],
        "inject": ["inject", TOP / "examples" / "table1.toml", "-o", out / "shots", "--format", "csv"],
    }


NAMES = list(commands(Path(), Path()))


def survived(command, out, at, code, counter, once=False):
    """Whether the failure was met at all; that it cost one line, status 4 and nothing else is seen to."""
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir()
    done, tried = with_failure(command, out, at, code, counter=counter, once=once)
    if tried < at:
        assert done.returncode == 0, done.stderr
        return False
    assert done.returncode == MACHINE, (at, done.stderr)
    assert "Traceback" not in done.stderr
    assert os.strerror(code).lower() in done.stderr.lower()
    assert str(out) in done.stderr.splitlines()[-1]  # it says where
    assert not [path for path in out.rglob("*") if path.suffix == ".tmp"]
    return True


@LINUX
@needs_compiler
@pytest.mark.parametrize("name", ["run", pytest.param("csv", marks=pytest.mark.evidence)])
def test_a_disk_that_is_full_costs_one_line(tmp_path, table, name):
    command, counter = commands(table, tmp_path / "out")[name], tmp_path / "count"
    (tmp_path / "out").mkdir()
    done, tried = with_failure(command, tmp_path / "out", 0, errno.ENOSPC, counter=counter)
    assert done.returncode == 0, done.stderr
    assert tried >= 4
    for at in random.sample(range(1, tried + 1), 2):
        assert survived(command, tmp_path / "out", at, errno.ENOSPC, counter)


@LINUX
@needs_compiler
@pytest.mark.evidence
@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EIO, errno.EROFS], ids=lambda code: errno.errorcode[code])
@pytest.mark.parametrize("name", NAMES)
def test_a_disk_that_fails_at_any_moment_costs_one_line(tmp_path, table, name, code):
    """Every write, creation, rename and sync of every command that writes, one after the other."""
    command, met = commands(table, tmp_path / "out")[name], 0
    while survived(command, tmp_path / "out", met + 1, code, tmp_path / "count", once=code == errno.EIO):
        met += 1
    assert met >= 4
    print(f"\n  {name}: {met} moments, {errno.errorcode[code]}", end="")


@pytest.fixture
def small_disk(tmp_path):
    """A file system of its own in memory, and a function that makes it so many kB large."""
    place = tmp_path / "disk"
    place.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=4k", "tmpfs", place], capture_output=True).returncode:
        pytest.skip("mounting a file system is not allowed here")

    def sized(kilobytes):
        subprocess.run(["mount", "-o", f"remount,size={kilobytes}k", place], check=True)

    yield place, sized
    subprocess.run(["umount", "-l", place], check=True)


@LINUX
@pytest.mark.evidence
def test_a_disk_that_grows_from_too_small_to_large_enough(small_disk):
    """The same command on a real file system that is full, ever again with 8 kB more, until its table is there."""
    (place, sized), refusals = small_disk, 0
    for kilobytes in range(8, 400, 8):
        sized(kilobytes)
        done = call("run", TOP / "examples" / "table1.toml", "-o", place / "y.parquet")
        if done.returncode == 0:
            break
        refusals += 1
        assert done.returncode == MACHINE, done.stderr
        assert "Traceback" not in done.stderr
        assert "no space left on device" in done.stderr.splitlines()[-1]
        assert not [path for path in place.rglob("*") if path.suffix == ".tmp"]
    assert [path.name for path in place.iterdir()] == ["y.parquet"]
    again = place.parent / "y.parquet"
    assert command("run", TOP / "examples" / "table1.toml", "-o", again).returncode == 0
    assert (place / "y.parquet").read_bytes() == again.read_bytes()
    assert refusals > 3
    print(f"\n  {refusals} times full, {kilobytes} kB at last: the same bytes", end="")


@LINUX
@needs_compiler
def test_a_run_that_met_a_full_disk_goes_on_to_the_same_bytes(tmp_path):
    path, counter, out = campaign(tmp_path, powers=(0.3, 0.6)), tmp_path / "count", tmp_path / "out"
    out.mkdir()
    assert command("run", path, "-o", tmp_path / "fresh.parquet").returncode == 0
    table = out / "y.parquet"
    done, _ = with_failure(["run", path, "-o", table], out, 12, errno.ENOSPC, counter=counter)
    assert done.returncode == MACHINE
    assert "run the same command again to go on" in done.stderr
    assert shards_of(table)
    assert command("run", path, "-o", table).returncode == 0
    assert table.read_bytes() == (tmp_path / "fresh.parquet").read_bytes()


@LINUX
@needs_compiler
def test_no_room_to_unpack_an_fmu_is_a_failure_of_the_machine(tmp_path):
    """Not wrong input: the archive is as good as ever."""
    box, room = fmus.fmu(tmp_path, "STATE"), tmp_path / "room"
    room.mkdir()
    lines = "\n".join(f"{key} = {value!r}".replace("'", '"') for key, value in fmus.PARAMETERS.items())
    path = campaign(tmp_path, plant=f"fmu:{box}", plant_lines=f"[plant.parameters]\n{lines}\n", n=4)
    command = ["run", path, "-o", tmp_path / "y.parquet"]
    seen = set()
    for at in (10, 12):  # what goes into its folder
        done, _ = with_failure(
            command, room, at, errno.ENOSPC, counter=tmp_path / "count", TMPDIR=str(room), PYTHONDONTWRITEBYTECODE="1"
        )
        assert done.returncode == MACHINE, done.stderr
        assert "no space left on device" in done.stderr.lower()
        seen.add("fmu-" in done.stderr)
    assert True in seen  # it was met while unpacking
    assert not list(room.iterdir())


@LINUX
def test_a_box_that_needs_more_memory_than_it_may_costs_its_own_points(tmp_path):
    path = campaign(tmp_path, plant="python:misbehaving_plants:Leaking", plant_lines="memory_mb = 400", n=2)
    done = call("run", path, "-o", tmp_path / "y.parquet", timeout=600)
    assert done.returncode == 1, done.stderr
    shown = command("show", tmp_path / "y.parquet")
    assert "MB of memory; plant.memory_mb allows 400 MB" in " ".join(shown.stdout.split())


WITHOUT_UNDERTAKER = """
import ctypes, os, subprocess, sys, time
from pathlib import Path
ctypes.CDLL(None).prctl(36, 1)  # orphans come to this process, which buries nobody
done = subprocess.run(sys.argv[1:], capture_output=True, text=True)
time.sleep(0.3)
mine = [p.read_text().rpartition(")")[2].split() for p in Path("/proc").glob("[0-9]*/stat") if p.exists()]
print(sum(1 for fields in mine if fields[0] == "Z" and int(fields[1]) == os.getpid()), done.returncode, done.stderr)
"""


@LINUX
def test_what_a_box_has_started_is_buried_where_the_first_process_does_not(tmp_path):
    path = campaign(tmp_path, plant="python:misbehaving_plants:Forking", plant_lines="timeout_s = 0.3", n=2)
    line = [sys.executable, "-c", WITHOUT_UNDERTAKER, SEQSWEEP, "run", str(path), "-o", str(tmp_path / "y.parquet")]
    done = subprocess.run(line, cwd=HERE, capture_output=True, text=True, timeout=600, check=True)
    zombies, status, *_ = done.stdout.split()
    assert (zombies, status) == ("0", "1"), done.stdout


def few(files=None, data_mb=None):
    """What a child does before it becomes the command: it lowers its own limits."""

    def lower():
        if files is not None:
            resource.setrlimit(resource.RLIMIT_NOFILE, (files, files))
        if data_mb is not None:
            resource.setrlimit(resource.RLIMIT_DATA, (data_mb << 20, data_mb << 20))

    return lower


@LINUX
@pytest.mark.parametrize("limits", [{"files": 256}, {"data_mb": 512}], ids=["256 files", "512 MB"])
def test_a_small_machine_suffices(tmp_path, limits):
    path = campaign(tmp_path, plant="dpmsg-v1", n=12)
    small, large = tmp_path / "small.parquet", tmp_path / "large.parquet"
    done = call("run", path, "-o", small, "--jobs", 2, preexec_fn=few(**limits))
    assert done.returncode == 0, done.stderr
    assert command("run", path, "-o", large).returncode == 0
    assert small.read_bytes() == large.read_bytes()


def test_language_and_time_zone_of_the_machine_are_no_matter(tmp_path):
    path = campaign(tmp_path, powers=(0.3, 0.6))
    tables = []
    for k, place in enumerate(
        [{"LC_ALL": "C", "TZ": "UTC"}, {"LC_ALL": "tr_TR.ISO-8859-9", "TZ": "Pacific/Apia", "PYTHONUTF8": "0"}]
    ):
        done = call("run", path, "-o", tmp_path / f"{k}.parquet", env={**os.environ, **place})
        assert done.returncode == 0, done.stderr
        tables.append((tmp_path / f"{k}.parquet").read_bytes())
    assert tables[0] == tables[1]


def test_an_output_that_is_moved_during_the_run_costs_one_line(tmp_path):
    path, out = slow_campaign(tmp_path, n_points=2), tmp_path / "out"
    out.mkdir()
    table = out / "y.parquet"
    process = start_held(table, 1, "run", path, "-o", table, "--jobs", 2)
    try:
        out.rename(tmp_path / "elsewhere")
        _, said = process.communicate(timeout=600)
    finally:
        end_group(process)
    assert process.returncode == MACHINE, said
    assert "was moved or removed while the run was at work" in unfolded(said).splitlines()[-1]
    assert "Warning" not in said


@LINUX
def test_who_is_told_to_ignore_ctrl_c_is_still_ended_by_sigterm(tmp_path):
    """A shell's ``&`` starts commands so: Ctrl-C is not for them, and they do not take it."""
    path, table = slow_campaign(tmp_path), tmp_path / "y.parquet"
    command = ["run", path, "-o", table, "--jobs", 1]
    ignoring = {"preexec_fn": lambda: signal.signal(signal.SIGINT, signal.SIG_IGN)}
    process = start_held(table, 1, *command, **ignoring)
    try:
        process.send_signal(signal.SIGINT)
        time.sleep(0.5)
        assert process.poll() is None
        process.send_signal(signal.SIGTERM)
        _, said = process.communicate(timeout=600)
    finally:
        end_group(process)
    assert process.returncode == 3, said
    assert "interrupted; run the same command again to go on" in said
