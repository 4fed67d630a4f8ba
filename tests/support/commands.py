"""The console script as tests call it, and campaigns for it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
import warnings
from contextlib import ExitStack, chdir, contextmanager, redirect_stderr, redirect_stdout, suppress
from pathlib import Path
from tempfile import TemporaryFile, gettempdir
from unittest.mock import patch

from seqsweep.sweep.cli.say import UNKNOWN

SEQSWEEP = str(Path(sys.executable).with_name("seqsweep"))
HERE = Path(__file__).parent
TOP = HERE.parents[1]
"""Commands run here: `python:plants:...` is found in the current folder."""

CAMPAIGN = """\
[campaign]
name = "command"

[plant]
id = "{plant}"
{plant_lines}

{points}
[sweep]
f_min_hz = 20.0
f_max_hz = 900.0
points = {n}

[injection]
amplitude_pu = 0.001
"""

POINT = """\
[[operating_point]]
id = "{name}"
active_power_mw = {power:g}
terminal_voltage_pu = 1.0

"""


def campaign(folder, *, plant="branch-v1", plant_lines="", powers=(0.65,), n=8):
    """Write a campaign into ``folder``; its path."""
    points = "".join(POINT.format(name=f"p{k}", power=power) for k, power in enumerate(powers))
    path = Path(folder) / "campaign.toml"
    path.write_text(CAMPAIGN.format(plant=plant, plant_lines=plant_lines, points=points, n=n), "utf-8")
    return path


def slow_campaign(folder, *, plant="python:plants:SlowBranch", rest_s=0.02, extra="", n_points=4):
    """About a hundred calls of ``rest_s`` in two batches of each operating point."""
    lines = f"[plant.parameters]\nrest_s = {rest_s}\n{extra}"
    return campaign(folder, plant=plant, plant_lines=lines, powers=[0.1 + 0.1 * k for k in range(n_points)], n=24)


def call(*arguments, timeout=600, wrapper=(), **options):
    """Run the command to its end; a machine with much else to do may take its time."""
    command = [*wrapper, SEQSWEEP, *map(str, arguments)]
    done = subprocess.run(
        command, cwd=HERE, capture_output=True, text=True, timeout=timeout, stdin=subprocess.DEVNULL, **options
    )
    done.stdout, done.stderr = unfolded(done.stdout), unfolded(done.stderr)
    return done


def unfolded(text):
    """Lines that went on below because they were too wide, as one line again: tests ask for words, not for places."""
    lines, width = [], 0
    for line in text.splitlines():
        hang = " " * (len(lines[-1]) - len(lines[-1].lstrip()) + 2) if lines else ""
        rest = line[len(hang) :]
        if lines and line.startswith(hang) and rest[:1].strip() and width + 1 + len(rest.split()[0]) > UNKNOWN:
            lines[-1] += f" {rest}"
        else:
            lines.append(line)
        width = len(line)
    return "\n".join(lines) + ("\n" if text.endswith("\n") else "")


def command(*arguments):
    """`call` within this process, which has the heavy imports behind it; what it leaves in the process is taken back.

    Not for what concerns the process itself: signals, limits, environment, children that outlive it.
    """
    from seqsweep.sweep.cli import main

    with TemporaryFile("w+", encoding="utf-8") as out, TemporaryFile("w+", encoding="utf-8") as err:
        with _as_a_process([SEQSWEEP, *map(str, arguments)], out, err):
            status = main._status()
        shown, told = map(_read_again, (out, err))
    done = subprocess.CompletedProcess(arguments, status, unfolded(shown), unfolded(told))
    done.shown = shown  # with the lines as they stand on a terminal
    return done


@contextmanager
def without_pictures():
    """Reports whose words are asked for are made without what takes longest, the drawing; places of pictures stay."""
    with patch("seqsweep.sweep.report.handover.svg.styled", lambda make: "<svg></svg>"):
        yield


@contextmanager
def _as_a_process(argv, out, err):
    """Folder, arguments, streams, warnings and modules of a process of its own, given back at the end."""
    kept_modules, kept_signals = set(sys.modules), {n: signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)}
    kept = {"argv": argv, "path": [*sys.path], "unraisablehook": sys.unraisablehook}
    patches = [*(patch.object(sys, name, value) for name, value in kept.items()), patch.dict(os.environ)]
    patches.append(patch.object(threading, "excepthook", threading.excepthook))
    with ExitStack() as stack:
        for context in (*patches, chdir(HERE), warnings.catch_warnings(), _streams(out, err)):
            stack.enter_context(context)
        warnings.resetwarnings()
        warnings.showwarning = lambda message, *_, **__: print(f"Warning: {message}", file=sys.stderr)
        try:
            yield
        finally:
            for number, handler in kept_signals.items():
                signal.signal(number, handler)
            for name in set(sys.modules) - kept_modules:
                if _is_a_tests_own(sys.modules[name]):
                    del sys.modules[name]


@contextmanager
def _streams(out, err):
    """The three standard streams, for this process and its children."""
    sys.stdout.flush()
    sys.stderr.flush()
    kept = [os.dup(k) for k in range(3)]
    with open(os.devnull) as nothing, redirect_stdout(out), redirect_stderr(err), patch.object(sys, "stdin", nothing):
        for k, file in enumerate((nothing, out, err)):
            os.dup2(file.fileno(), k)
        try:
            yield
        finally:
            out.flush()
            err.flush()
            for k, descriptor in enumerate(kept):
                os.dup2(descriptor, k)
                os.close(descriptor)


def _read_again(file):
    file.seek(0)
    return file.read()


def _is_a_tests_own(module):
    """Whether a module is a plant of a test: the next command may find another one under its name."""
    path = getattr(module, "__file__", None) or ""
    of_the_program = path.startswith((str(TOP), sys.prefix))  # the clone itself may lie among temporary files
    return path.startswith(str(HERE)) or (path.startswith(gettempdir()) and not of_the_program)


def start(*arguments, **options):
    """Begin the command, in a session of its own so that its whole group can be signalled."""
    return subprocess.Popen(
        [SEQSWEEP, *map(str, arguments)],
        cwd=HERE,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        **options,
    )


def start_held(output, n_shards, *arguments, **options):
    """`start` a campaign and see it hold; see `holding`.

    Where it was over before its shards were seen, as a very busy machine may have it, it is begun once more.
    """
    held = output.with_name("held")
    for _ in range(10):
        process = start(*arguments, env=holding(output, n_shards), **options)
        wait_for(lambda running=process: held.exists() or running.poll() is not None)
        if process.poll() is None:
            return process
        end_group(process)
        output.unlink(missing_ok=True)
    raise AssertionError(f"it never held: exit status {process.returncode}")


def ended(*arguments, timeout=600, **options):
    """Run the command to its end, see that no process of its session is left, and give (exit status, stderr)."""
    process = start(*arguments, **options)
    try:
        said = unfolded(process.communicate(timeout=timeout)[1])
        wait_for(lambda: not group_members(process.pid), 60.0)  # who was killed may be a moment about it
    finally:
        end_group(process)
    return process.returncode, said


def holding(output, n_shards):
    """The environment in which plants of `slow_campaign` stop once so many shards are kept beside ``output``.

    What is to be interrupted is at work then, however late a busy machine comes to it. Who holds leaves a file
    ``held`` in the same folder, and goes on when it is no longer there.
    """
    return {**os.environ, "SEQSWEEP_HOLD": f"{n_shards} {output}"}


def shards_of(output):
    """The shards that are kept beside ``output``."""
    return list(output.with_name(output.name + ".parts").glob("?" * 64))


def wait_for(condition, timeout_s=300.0):
    """Poll until ``condition()``; fails after ``timeout_s``."""
    end = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.005)


def is_alive(pid):
    """Whether a process is there, and not only waits to be taken note of (Linux)."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def group_members(group):
    """Processes alive in the session that a process of `start` leads, whatever their process group (Linux)."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[3]) == group and fields[0] != "Z":
            found.append(int(stat.parent.name))
    return found


def family_s(pid):
    """CPU time (s) of a process, its descendants, and all that these have buried (Linux)."""
    used, parents = {}, {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            fields = stat.read_text().rpartition(")")[2].split()
            parents[int(stat.parent.name)] = int(fields[1])
            used[int(stat.parent.name)] = sum(int(field) for field in fields[11:15])
    family = [pid]
    for member in family:
        family += [child for child, parent in parents.items() if parent == member]
    return sum(used[member] for member in family) / os.sysconf("SC_CLK_TCK")


def least_cpu_s(work, bar_s, trials=10):
    """Least CPU time (s) of ``work()``, of as many trials as it takes to stay below ``bar_s``.

    A neighbour on the same core and the collector of garbage can make any one trial slow.
    """
    least = float("inf")
    for _ in range(trials):
        begin = _cpu_s()
        work()
        least = min(least, _cpu_s() - begin)
        if least < bar_s:
            break
    return least


def _cpu_s():
    """Of this process and of its children that have ended (s)."""
    return sum(os.times()[:4])


def end_group(process):
    """Leave nothing of a test's own process group behind."""
    for pid in group_members(process.pid):
        with suppress(ProcessLookupError):
            os.kill(pid, 9)
    process.communicate()
