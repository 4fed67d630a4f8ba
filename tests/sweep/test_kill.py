"""kill -9 at any moment, then the same command again: the bytes of an undisturbed run.

``python -m pytest -m evidence -s tests/sweep/test_kill.py`` kills at hundreds of random moments, of whom it may be;
``SEQSWEEP_KILLS=10`` in front makes it so many of each kind; with ``SEQSWEEP_KILLS_KEPT=FOLDER``, what was done is kept
there, and a trial that was ended goes on.
"""

from __future__ import annotations

import os
import random
import shlex
import signal
import subprocess
import time
from collections import Counter
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import NamedTuple

import pytest

from ..support.commands import (
    HERE,
    SEQSWEEP,
    call,
    campaign,
    command,
    end_group,
    group_members,
    is_alive,
    shards_of,
    slow_campaign,
    start,
    start_held,
    wait_for,
)


@pytest.fixture(scope="module")
def slow(tmp_path_factory):
    """A campaign of a second."""
    return slow_campaign(tmp_path_factory.mktemp("slow"))


@pytest.fixture(scope="module")
def undisturbed(slow):
    """Bytes of that campaign's table, by whether its plant runs isolated."""

    @cache
    def bytes_of(isolate):
        table = slow.with_name(f"{isolate}.parquet")
        return finished(slow, table, "--jobs", 2, "--set", f"plant.isolate={isolate}")

    return bytes_of


def many_points(folder, n_points):
    """A campaign of so many operating points that shards are packed, which they are by 256."""
    return campaign(folder, powers=[0.1 + 0.002 * k for k in range(n_points)], n=2)


def killed_while_held(path, table, n_shards, *options):
    """Start the command, and kill -9 its runner alone while its plant holds; its workers go by themselves."""
    process = start_held(table, n_shards, "run", path, "-o", table, *options)
    try:
        process.kill()
        process.wait(timeout=300)
        wait_for(lambda: not group_members(process.pid), 120.0)
    finally:
        end_group(process)


def finished(path, table, *options, run=command):
    """The same command again, to its end; the bytes of the table, beside which nothing may be left."""
    done = run("run", path, "-o", table, *options)
    assert done.returncode == 0, done.stderr
    assert [other.name for other in table.parent.iterdir() if other.name.startswith(table.name)] == [table.name]
    return table.read_bytes()


@pytest.mark.parametrize(
    ("n_shards", "isolate"), [(0, "false"), (3, "true"), pytest.param(6, "false", marks=pytest.mark.evidence)]
)
def test_a_killed_runner_costs_nothing_but_time(tmp_path, slow, undisturbed, n_shards, isolate):
    """Before the first shard, in the midst of them, near the last one."""
    setting = ["--jobs", 2, "--set", f"plant.isolate={isolate}"]
    path, table = slow, tmp_path / "y.parquet"
    killed_while_held(path, table, n_shards, *setting)
    assert not table.exists()
    kept = {shard: shard.stat().st_mtime_ns for shard in shards_of(table)}
    assert len(kept) >= n_shards
    assert finished(path, table, *setting) == undisturbed(isolate)


def test_a_runner_killed_while_it_packs_shards_costs_nothing_but_time(tmp_path):
    """As soon as a pack is begun."""
    path, table = many_points(tmp_path, 264), tmp_path / "y.parquet"
    process = start("run", path, "-o", table, "--jobs", 2)
    try:
        wait_for(lambda: table.exists() or any(Path(f"{table}.parts").glob("*.pack*")))
        process.kill()
        process.wait(timeout=300)
    finally:
        end_group(process)
    table.unlink(missing_ok=True)  # a machine may be slow to look
    assert finished(path, table, "--jobs", 2) == finished(path, tmp_path / "fresh.parquet", "--jobs", 1)


def test_a_killed_worker_costs_nothing_but_time(tmp_path):
    """The plant kills its own process once, in mid-shot, as the kernel does when memory runs out."""
    scar, table, fresh = tmp_path / "scar", tmp_path / "y.parquet", tmp_path / "fresh.parquet"
    path = slow_campaign(
        tmp_path, plant="python:plants:SuicidalBranch", rest_s=0.005, extra=f'scar = "{scar}"', n_points=2
    )
    setting = ["--set", "plant.isolate=false", "--backend", "loky", "--jobs", 2]
    done = call("run", path, "-o", table, *setting)
    assert done.returncode == 0, done.stderr
    assert scar.exists()  # it did die
    assert "48 ok" in done.stderr
    alone = ["--set", "plant.isolate=false", "--backend", "threading"]
    assert finished(path, fresh, *alone) == table.read_bytes()  # now nobody dies


def test_a_runner_killed_with_processes_leaves_none_behind(tmp_path):
    """Workers whose runner is gone end by themselves, and the next run is not told that the output is in use."""
    path = slow_campaign(tmp_path, plant="python:plants:SlowPythonBranch", rest_s=0.01, n_points=2)
    table, fresh = tmp_path / "y.parquet", tmp_path / "fresh.parquet"
    setting = ["--set", "plant.isolate=false", "--jobs", 2]
    killed_while_held(path, table, 3, *setting)
    alone = ["--set", "plant.isolate=false", "--backend", "threading"]
    assert finished(path, table, *setting) == finished(path, fresh, *alone)


def test_a_command_outlives_the_shell_that_began_it(tmp_path):
    """Its processes end with it, and it with nobody: not even where it does all the work itself."""
    path, table = slow_campaign(tmp_path, n_points=2), tmp_path / "y.parquet"
    setting = ["--backend", "loky", "--jobs", "1", "--set", "plant.isolate=false"]
    line = shlex.join([SEQSWEEP, "run", str(path), "-o", str(table), *setting])
    at_work = f"ls {shlex.quote(str(table))}.parts 2>&1 | grep -q '^[0-9a-f]\\{{64\\}}$'"
    shell = f"{line} >/dev/null 2>&1 & echo $!; while kill -0 $! && ! {at_work}; do sleep 0.02; done"
    begun = subprocess.run(["sh", "-c", shell], cwd=HERE, stdout=subprocess.PIPE, check=False)
    wait_for(lambda: not is_alive(int(begun.stdout)))
    assert table.exists()


N_KILLS = int(os.environ.get("SEQSWEEP_KILLS", "100"))
"""Kills of each kind in `make evidence`."""


def tracks(pid):
    """Whether a process is loky's tracker of resources, which does no work; killed, it is begun anew and says so."""
    with suppress(OSError):
        return b"resource_tracker" in Path(f"/proc/{pid}/cmdline").read_bytes()
    return False


class Strike(NamedTuple):
    """What came of one command of which a process was to be killed: who was hit, and how long (s) it all took."""

    hit: str
    took_s: float


def struck(path, table, at_s, dice, *options):
    """Start the command, kill -9 one of its processes, whichever it be, after ``at_s``, and wait for its end.

    Its end is as documented, and it leaves no process: who was to be killed may have been spared, and the command
    gone on, or be over by then ("nobody").
    """
    begin, process, hit = time.monotonic(), start("run", path, "-o", table, *options), "nobody"
    try:
        wait_for(lambda: time.monotonic() >= begin + at_s or process.poll() is not None)
        members = [] if process.poll() is not None else [pid for pid in group_members(process.pid) if not tracks(pid)]
        if members:
            victim = dice.choice(members)
            hit = "runner" if victim == process.pid else "other"
            with suppress(ProcessLookupError):
                os.kill(victim, signal.SIGKILL)
        _, said = process.communicate(timeout=600)
        wait_for(lambda: not group_members(process.pid), 60.0)
    finally:
        end_group(process)
    assert process.returncode in (0, 3, 4, -signal.SIGKILL), said
    assert "Traceback" not in said
    return Strike(hit, time.monotonic() - begin)


class Ledger(NamedTuple):
    """Who was killed so far, and each campaign that came to its table, one word a line."""

    path: Path

    @property
    def words(self):
        return Counter(self.path.read_text("utf-8").split() if self.path.exists() else ())

    @property
    def n_kills(self):
        return self.words["runner"] + self.words["other"]

    @property
    def summary(self):
        words = self.words
        return f"{self.n_kills} kills, {words['runner']} of them of the runner, in {words['campaign']} campaigns"

    def add(self, word):
        with self.path.open("a", encoding="utf-8") as file:
            file.write(f"{word}\n")


def ledger(folder, kind):
    """The ledger of a kind: in the folder of SEQSWEEP_KILLS_KEPT, else in the one given."""
    kept = Path(os.environ.get("SEQSWEEP_KILLS_KEPT", folder))
    kept.mkdir(parents=True, exist_ok=True)
    return Ledger(kept / f"{kind}.txt")


def remains(room):
    """What commands that are over have left in the folder for temporary files, but for dask's own empty ones."""
    return [path for path in room.rglob("*") if path.is_file() and "dask-scratch-space" not in path.parts]


def few_points(folder, n):
    """A campaign of three operating points."""
    return campaign(folder, plant="dpmsg-v1", powers=[0.1, 0.2, 0.3], n=n)


KINDS = [(backend, how) for how in ("here", "isolated") for backend in ("threading", "loky", "dask")]


@pytest.mark.evidence
@pytest.mark.parametrize(("backend", "how"), [*KINDS, ("threading", "packed")])
def test_whoever_is_killed_the_table_is_the_same(tmp_path, monkeypatch, backend, how):
    """Runner, worker, box or what these have started: one of them, at a moment drawn over the whole run.

    The same command again is struck as well, until a table is there.
    """
    room = tmp_path / "room"
    room.mkdir()
    monkeypatch.setenv("TMPDIR", str(room))
    path = many_points(tmp_path, 520) if how == "packed" else few_points(tmp_path, 6 if how == "isolated" else 24)
    isolate = ["--set", f"plant.isolate={str(how == 'isolated').lower()}"]
    setting, table = ["--jobs", 2, "--backend", backend, *isolate], tmp_path / "y.parquet"
    undisturbed = finished(path, tmp_path / "fresh.parquet", *isolate, run=call)
    seed = random.SystemRandom().randrange(1 << 32)
    dice, kept, whole_s = random.Random(seed), ledger(tmp_path, f"{backend}-{how}"), 5.0
    while kept.n_kills < N_KILLS:
        strike = struck(path, table, dice.uniform(0.0, whole_s), dice, *setting)
        if strike.hit == "nobody":
            whole_s = strike.took_s  # a machine is not as busy all the time
        else:
            whole_s = max(whole_s, strike.took_s)
            kept.add(strike.hit)
        if table.exists():
            kept.add("campaign")
            assert table.read_bytes() == undisturbed
            assert not list(tmp_path.glob("y.parquet?*"))
            table.unlink()
    for leftover in room.iterdir():
        os.utime(leftover, (0, 0))  # long ago, for whoever sweeps up
    assert finished(path, table, *setting, run=call) == undisturbed
    assert remains(room) == []
    print(f"\n  {backend}, {how}: {kept.summary}, every table as undisturbed (last seed {seed})", end="")
