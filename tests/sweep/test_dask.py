"""A dask scheduler of its own, in processes of its own: with one slot, and killed while it works."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from contextlib import suppress
from importlib.util import find_spec

import pytest

from seqsweep.sweep.run import workers

from ..support.commands import (
    call,
    campaign,
    command,
    end_group,
    shards_of,
    slow_campaign,
    start,
    wait_for,
)

if find_spec("distributed") is None:  # importing it takes long, and every worker collects all files
    pytest.skip("the extra 'dask' is not installed", allow_module_level=True)


@pytest.fixture
def cluster(tmp_path):
    """A scheduler and one worker with one slot, each a process; its address."""
    address = tmp_path / "address.json"
    common = {"cwd": tmp_path, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    options = ["--no-dashboard", "--scheduler-file", str(address)]
    scheduler = subprocess.Popen(
        [sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0", *options],
        **common,
    )
    wait_for(lambda: address.exists() and address.stat().st_size > 0)
    worker = subprocess.Popen(
        [sys.executable, "-m", "distributed.cli.dask_worker", "--nthreads", "1", *options], **common
    )
    yield scheduler, _address(address)
    for process in (worker, scheduler):
        process.kill()
        process.wait()


def _address(path):
    """From the file that the scheduler writes, once it is whole."""
    found = []

    def whole():
        with suppress(ValueError):
            found.append(json.loads(path.read_text())["address"])
        return found

    wait_for(whole)
    return found[0]


def test_a_cluster_of_one_slot_does_the_work_itself(tmp_path, cluster):
    """The plant says in which process it was; joblib alone would have worked in the runner."""
    _, address = cluster
    done = call("run", campaign(tmp_path), "-o", tmp_path / "y.parquet", "--backend", "dask", "--scheduler", address)
    assert done.returncode == 0, done.stderr
    here = command("run", campaign(tmp_path), "-o", tmp_path / "here.parquet")
    assert here.returncode == 0
    assert (tmp_path / "y.parquet").read_bytes() == (tmp_path / "here.parquet").read_bytes()


def test_a_scheduler_that_is_killed_ends_in_one_line_and_the_work_is_kept(tmp_path, cluster):
    scheduler, address = cluster
    file = slow_campaign(tmp_path, rest_s=0.1)  # some ten seconds: not over before the scheduler is killed
    out = tmp_path / "y.parquet"
    runner = start("run", file, "-o", out, "--backend", "dask", "--scheduler", address)
    try:
        wait_for(lambda: len(list(shards_of(out))) > 0)
        scheduler.send_signal(signal.SIGKILL)
        _, said = runner.communicate(timeout=600)
    finally:
        end_group(runner)
    assert runner.returncode == 4, said
    assert "the dask scheduler" in said
    assert "Traceback" not in said
    assert list(shards_of(out))


def test_a_scheduler_that_does_not_answer_is_wrong_input(tmp_path):
    address = ["--scheduler", "tcp://127.0.0.1:1"]
    done = call("run", campaign(tmp_path), "-o", tmp_path / "y.parquet", "--backend", "dask", *address)
    assert done.returncode == 2
    assert "no dask scheduler answers" in done.stderr


class Perishable:
    """A cluster of which a process is killed while it starts, so many times."""

    def __init__(self, deaths):
        self.deaths, self.begun = deaths, 0

    def __call__(self, **settings):
        self.begun += 1
        if self.begun <= self.deaths:
            raise RuntimeError("Nanny failed to start.")
        return self


def test_a_worker_killed_while_the_cluster_starts_costs_a_start():
    assert workers._begun(cluster := Perishable(2), 2) is cluster
    assert cluster.begun == 3


def test_workers_that_never_start_are_a_failure_of_the_machine():
    with pytest.raises(OSError, match="could not start its workers 4 times in a row: Nanny failed"):
        workers._begun(Perishable(9), 2)
