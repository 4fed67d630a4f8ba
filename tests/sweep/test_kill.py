"""kill -9 at any moment, then the same command again: the bytes of an undisturbed run.

``python -m pytest -m evidence -s tests/sweep/test_kill.py`` kills at hundreds of random moments, of whom it may be;
``SEQSWEEP_KILLS=10`` in front makes it so many of each kind.
"""

from __future__ import annotations

import os
import random
import signal
import time
from contextlib import suppress
from functools import cache
from pathlib import Path

import pytest

from ..support.commands import (
    call,
    campaign,
    command,
    end_group,
    group_members,
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


def killed(path, table, moment, *options, orphans=False):
    """Start the command, and kill -9 its runner alone when ``moment()`` has come; True if it was still at work."""
    process = start("run", path, "-o", table, *options)
    try:
        wait_for(lambda: moment() or process.poll() is not None)
        caught = process.poll() is None
        if caught:
            os.kill(process.pid, signal.SIGKILL)
        process.wait(timeout=300)
        if not orphans:
            wait_for(lambda: not group_members(process.pid), 120.0)  # workers notice, and go by themselves
        return caught
    finally:
        end_group(process)


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


@pytest.mark.parametrize(("n_shards", "isolate"), [(0, "false"), (3, "true"), (6, "false")])
def test_a_killed_runner_costs_nothing_but_time(tmp_path, slow, undisturbed, n_shards, isolate):
    """Before the first shard, in the midst of them, near the last one."""
    setting = ["--jobs", 2, "--set", f"plant.isolate={isolate}"]
    path, table = slow, tmp_path / "y.parquet"
    killed_while_held(path, table, n_shards, *setting)
    assert not table.exists()
    kept = {shard: shard.stat().st_mtime_ns for shard in shards_of(table)}
    assert len(kept) >= n_shards
    assert finished(path, table, *setting) == undisturbed(isolate)


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


N_KILLS = int(os.environ.get("SEQSWEEP_KILLS", "100"))
"""Kills of each kind in `make evidence`."""


def tracks(pid):
    """Whether a process is loky's tracker of resources, which does no work; killed, it is begun anew and says so."""
    with suppress(OSError):
        return b"resource_tracker" in Path(f"/proc/{pid}/cmdline").read_bytes()
    return False


def struck(path, table, at_s, dice, *options):
    """Start the command and kill -9 one of its processes, whichever it be, after ``at_s``; what was hit, if anybody.

    The command is waited for: where its runner was spared, it may have finished.
    """
    process = start("run", path, "-o", table, *options)
    hit = None
    try:
        end = time.monotonic() + at_s
        wait_for(lambda: time.monotonic() >= end or process.poll() is not None)
        members = [] if process.poll() is not None else [pid for pid in group_members(process.pid) if not tracks(pid)]
        if members:
            victim = dice.choice(members)
            hit = "runner" if victim == process.pid else "other"
            with suppress(ProcessLookupError):
                os.kill(victim, signal.SIGKILL)
        _, said = process.communicate(timeout=600)
    finally:
        end_group(process)
    assert process.returncode in (0, 3, 4, -signal.SIGKILL), said
    assert "Traceback" not in said
    return hit


@pytest.mark.evidence
@pytest.mark.parametrize("isolated", [False, True], ids=["here", "isolated"])
@pytest.mark.parametrize("backend", ["threading", "loky", "dask"])
def test_whoever_is_killed_the_table_is_the_same(tmp_path, backend, isolated):
    """Runner, worker, box or what these have started: one of them, at a moment drawn over the whole run."""
    path = campaign(tmp_path, plant="dpmsg-v1", powers=[0.1 * k for k in range(1, 5)], n=40)
    setting = ["--jobs", 2, "--backend", backend, "--set", f"plant.isolate={str(isolated).lower()}"]
    begin = time.monotonic()
    undisturbed = finished(path, tmp_path / "fresh.parquet", *setting, run=call)
    whole_s = time.monotonic() - begin
    seed = random.SystemRandom().randrange(1 << 32)
    dice, hits, runs = random.Random(seed), {"runner": 0, "other": 0}, 0
    while sum(hits.values()) < N_KILLS:
        table = tmp_path / f"{runs}.parquet"
        runs += 1
        if hit := struck(path, table, dice.uniform(0.0, whole_s), dice, *setting):
            hits[hit] += 1
        if not table.exists():
            finished(path, table, *setting, run=call)
        assert table.read_bytes() == undisturbed
        table.unlink()
    print(f"\n  {backend}, {'isolated' if isolated else 'here'}: seed {seed}, kills {hits}, {runs} campaigns", end="")


@pytest.mark.evidence
@pytest.mark.parametrize("backend", ["threading", "loky"])
def test_kills_at_random_moments_leave_the_bytes_alone(tmp_path, backend):
    """Thirty kills of each backend, at moments drawn over the whole run, start and end included.

    A process that loky has started and that has no task yet does not know its runner: it may stay for
    loky's five minutes. The shards and the lock are not its business.
    """
    path = campaign(tmp_path, plant="dpmsg-v1", powers=[0.1 * k for k in range(1, 9)], n=60)
    fresh = tmp_path / "fresh.parquet"
    setting = ["--jobs", 2, "--backend", backend]
    begin = time.monotonic()
    undisturbed = finished(path, fresh, *setting, run=call)
    whole_s = time.monotonic() - begin
    dice, kills, runs = random.Random(11), 0, 0
    while kills < 30:
        table = tmp_path / f"{runs}.parquet"
        runs += 1
        for _ in range(3):  # the same output, killed up to three times
            end = time.monotonic() + dice.uniform(0.0, whole_s)
            kills += killed(path, table, lambda end=end: time.monotonic() >= end, *setting, orphans=True)
            if table.exists():
                break
        if not table.exists():
            finished(path, table, *setting, run=call)
        assert table.read_bytes() == undisturbed
    print(f"\n  {backend}: {kills} kills in {runs} campaigns of {whole_s:.1f} s, every table as undisturbed", end="")
