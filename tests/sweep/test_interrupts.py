"""Ctrl-C at any moment: one line and its status, no traceback, nobody left behind, and the same command goes on.

``python -m pytest -m evidence -s tests/sweep/test_interrupts.py`` interrupts at random moments and while whatever
module is imported; ``SEQSWEEP_INTERRUPTS=10`` in front makes it so many of each kind.
"""

from __future__ import annotations

import os
import random
import signal
import threading
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path

import pytest

from seqsweep.sweep.cli.interrupts import Interrupts

from ..support.commands import call, campaign, end_group, ended, group_members, start, wait_for

OK, INTERRUPTED = 0, 3
GO_ON = "interrupted; run the same command again to go on"

N_INTERRUPTS = int(os.environ.get("SEQSWEEP_INTERRUPTS", "100"))
"""Interrupts of each kind in `make evidence`."""

INTERRUPTING = '''
import os, signal, sys
group, word, module = os.environ["INTERRUPTED_AT"].split(" ")

class AtImport:
    """Interrupts when a module is about to be imported."""
    def find_spec(self, name, path=None, target=None):
        if name == module:
            os.kill(os.getpid(), signal.SIGINT)

if any(word in argument for argument in sys.orig_argv):
    if module == "site":
        os.killpg(int(group) or os.getpgid(0), signal.SIGINT)
    else:
        sys.meta_path.insert(0, AtImport())
'''


@pytest.fixture
def interrupted_at(tmp_path):
    """An environment in which processes with a word on their command line send Ctrl-C where a module is imported.

    Where the module is "site", it is sent to the whole group as soon as Python has started.
    """
    (tmp_path / "site").mkdir()
    (tmp_path / "site" / "sitecustomize.py").write_text(INTERRUPTING, "utf-8")

    def environment(module, word="seqsweep"):
        return {**os.environ, "PYTHONPATH": str(tmp_path / "site"), "INTERRUPTED_AT": f"0 {word} {module}"}

    return environment


@pytest.fixture
def interrupts():
    """Interrupts that are heeded; signals and hooks are given back."""
    kept = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGALRM)}
    printed = []
    with pytest.MonkeyPatch.context() as patch:
        for hook in ("sys.unraisablehook", "threading.excepthook"):
            patch.setattr(hook, printed.append)
        one = Interrupts(lambda: "interrupted")
        one.heed()
        yield one
    assert printed == []
    for number, handler in kept.items():
        signal.signal(number, handler)


class Left(BaseException):
    """The process would have ended here."""


@pytest.fixture
def leaving(monkeypatch):
    """Ending the process, as an exception that holds the status."""

    def leave(status):
        raise Left(status)

    monkeypatch.setattr(os, "_exit", leave)


def printed_by_python(said):
    """What the command itself never says."""
    return [word for word in ("Traceback", "ignored in", "Warning:", "KeyboardInterrupt") if word in said]


def interrupt():
    signal.raise_signal(signal.SIGINT)


def test_who_interrupts_twice_is_let_go_at_once(interrupts, leaving, capfd):
    with pytest.raises(KeyboardInterrupt):
        interrupt()
    with pytest.raises(Left, match="3"):
        interrupt()
    assert capfd.readouterr().err == "interrupted\n"


def test_who_has_been_told_is_not_told_again(interrupts, leaving, capfd):
    with pytest.raises(KeyboardInterrupt):
        interrupt()
    assert interrupts.farewell() == INTERRUPTED
    with pytest.raises(Left, match="3"):
        interrupt()
    assert capfd.readouterr().err == "interrupted\n"


def test_what_is_done_is_not_interrupted(interrupts, leaving, capfd):
    assert interrupts.over(OK) == OK
    with pytest.raises(Left, match="0"):
        interrupt()
    assert capfd.readouterr().err == ""


def test_what_fails_because_it_was_interrupted_is_interrupted(interrupts):
    def fail():
        with interrupts.foremost():
            with suppress(KeyboardInterrupt):
                interrupt()
            raise OSError("a pipe to nobody")

    with pytest.raises(KeyboardInterrupt):
        fail()


def test_what_fails_by_itself_fails(interrupts):
    with pytest.raises(OSError, match="a disk"), interrupts.foremost():
        raise OSError("a disk")


class Finalised:
    """Is interrupted where nothing can be raised."""

    def __del__(self):
        interrupt()


def test_an_interrupt_that_nobody_can_catch_is_raised_a_moment_later(interrupts):
    Finalised()
    with pytest.raises(KeyboardInterrupt):
        wait_for(lambda: False, 60.0)


class Cluster:
    """Complains when it goes."""

    def __del__(self):
        raise RuntimeError("IOLoop is closed")


def test_finalisers_of_what_is_interrupted_print_nothing(interrupts):
    with pytest.raises(KeyboardInterrupt):
        interrupt()
    Cluster()


def test_threads_of_what_is_interrupted_print_nothing(interrupts):
    with pytest.raises(KeyboardInterrupt):
        interrupt()
    orphan = threading.Thread(target={}.pop, args=("a process that is gone",))
    orphan.start()
    orphan.join()


@pytest.mark.parametrize("module", ["seqsweep.sweep.cli.main", "typer", "numpy", "joblib", "pyarrow"])
def test_ctrl_c_during_an_import_is_one_line(tmp_path, interrupted_at, module):
    setting = ["--backend", "loky", "--jobs", 2, "--set", "plant.isolate=false"]
    arguments = "run", campaign(tmp_path), "-o", tmp_path / "y.parquet", *setting
    status, said = ended(*arguments, env=interrupted_at(module))
    assert (status, said.splitlines()[-1:]) in [(INTERRUPTED, [GO_ON]), (INTERRUPTED, ["interrupted"])], said
    assert not printed_by_python(said)


@pytest.mark.parametrize(("backend", "word"), [("loky", "popen_loky"), ("dask", "spawn_main")])
def test_workers_that_are_just_starting_print_nothing_about_ctrl_c(tmp_path, interrupted_at, backend, word):
    setting = ["--backend", backend, "--jobs", 2, "--set", "plant.isolate=false"]
    arguments = "run", campaign(tmp_path), "-o", tmp_path / "y.parquet", *setting
    status, said = ended(*arguments, env=interrupted_at("site", word))
    assert status == INTERRUPTED
    assert said.strip() == GO_ON


# Evidence


def heeds(pid):
    """Whether a process is a command that has begun: it catches SIGTERM, as Python by itself does not (Linux)."""
    with suppress(OSError, StopIteration):
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
        caught = next(line for line in lines if line.startswith("SigCgt"))
        return bool(int(caught.split()[1], 16) >> (signal.SIGTERM - 1) & 1)
    return False


def hammered(path, table, moments_s, *options):
    """Start the command and send Ctrl-C to its group at some moments (s) after its start; how far it was, stderr."""
    begin, process = time.monotonic(), start("run", path, "-o", table, *options)
    state = "over"
    try:
        for at_s in moments_s:
            wait_for(lambda at_s=at_s: time.monotonic() >= begin + at_s or process.poll() is not None)
            if process.poll() is None and state == "over":
                state = "at work" if heeds(process.pid) else "not begun"
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGINT)
        _, said = process.communicate(timeout=600)
        wait_for(lambda: not group_members(process.pid), 60.0)
    finally:
        end_group(process)
    return state, process.returncode, said, time.monotonic() - begin


@pytest.mark.evidence
@pytest.mark.parametrize("isolated", [False, True], ids=["here", "isolated"])
@pytest.mark.parametrize("backend", ["threading", "loky", "dask"])
def test_ctrl_c_at_any_moment_is_one_line(tmp_path, backend, isolated):
    """Once or several times, at moments drawn over the whole run, until a table is there; its bytes are the same.

    While Python itself starts, before the command has begun, it says in its own words where it was.
    """
    path = campaign(tmp_path, plant="dpmsg-v1", powers=[0.1, 0.2, 0.3], n=6 if isolated else 24)
    isolate = ["--set", f"plant.isolate={str(isolated).lower()}"]
    setting, table, fresh = (
        ["--jobs", 2, "--backend", backend, *isolate],
        tmp_path / "y.parquet",
        tmp_path / "f.parquet",
    )
    assert call("run", path, "-o", fresh, *isolate).returncode == OK
    seed = random.SystemRandom().randrange(1 << 32)
    dice, whole_s, seen = random.Random(seed), 5.0, Counter()
    while seen["at work"] < N_INTERRUPTS:
        moments_s = sorted(dice.uniform(0.0, whole_s) for _ in range(dice.choice([1, 1, 2, 3])))
        state, status, said, took_s = hammered(path, table, moments_s, *setting)
        seen[state] += 1
        whole_s = took_s if state == "over" else max(whole_s, took_s)
        if state == "at work":
            assert status == INTERRUPTED or (status == OK and table.exists()), (seed, moments_s, said)
            assert not printed_by_python(said), (seed, moments_s, said)
        if table.exists():
            assert table.read_bytes() == fresh.read_bytes()
            table.unlink()
    place, early = "isolated" if isolated else "here", f"{seen['not begun']} before the command had begun"
    print(
        f"\n  {backend}, {place}: {seen['at work']} at work, one line each, same bytes; {early} (seed {seed})", end=""
    )


LISTING = "import sys; from seqsweep.sweep.cli.main import main\ntry: main()\nfinally: print(*sys.modules)"


@pytest.mark.evidence
def test_ctrl_c_while_any_module_is_imported_is_one_line(tmp_path, interrupted_at):
    """Those that a run imports, from the first of the command on."""
    import subprocess
    import sys

    path = campaign(tmp_path)
    line = [sys.executable, "-c", LISTING, "run", str(path), "-o", str(tmp_path / "y.parquet")]
    modules = subprocess.run(line, capture_output=True, text=True, check=True).stdout.split()
    later = modules[modules.index("seqsweep.sweep.cli.main") :]
    asked = random.SystemRandom().sample(later, min(N_INTERRUPTS, len(later)))
    for module in asked:
        status, said = ended("run", path, "-o", tmp_path / "z.parquet", env=interrupted_at(module))
        assert status in (OK, INTERRUPTED), (module, said)  # a module that the script itself has is not imported again
        assert not printed_by_python(said), (module, said)
        (tmp_path / "z.parquet").unlink(missing_ok=True)
    print(f"\n  {len(asked)} of {len(later)} modules: one line each", end="")
