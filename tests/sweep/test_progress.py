"""Signs of life: which shot a slow or hanging device is at, when it is given up, and bars that do not glue to text."""

from __future__ import annotations

import os
import pty
import re
import subprocess

import pytest

from seqsweep.sweep.cli import progress
from seqsweep.sweep.run import child, heartbeat

from ..support.commands import HERE, SEQSWEEP, campaign, command, wait_for


@pytest.fixture
def soon(monkeypatch):
    """Lines after a tenth of a second, not ten, and a look at the device every hundredth."""
    monkeypatch.setattr(heartbeat, "FIRST_S", 0.1)
    monkeypatch.setattr(child, "LOOK_S", 0.01)


def test_a_device_that_hangs_is_named_with_its_shot_and_when_it_is_given_up(tmp_path, soon):
    lines = "isolate = true\ntimeout_s = 0.25\n[plant.parameters]\nrest_s = 30.0\n"
    file = campaign(tmp_path, plant="python:plants:SlowBranch", plant_lines=lines, n=2)
    done = command("run", file, "-o", tmp_path / "y.parquet", "--jobs", 1)
    assert done.returncode == 1, done.stderr
    said = re.findall(r"^p0: (.*)$", done.stderr, re.MULTILINE)
    assert any("shot" in line for line in said)
    left = [float(found) for line in said for found in re.findall(r"given up in (\d+) s", line)]
    assert left
    assert max(left) <= 2.0  # eight shots of 0.25 s, probes among them
    assert "plant.timeout_s for each of its 4 shots" in done.stderr


def test_a_slow_device_that_goes_forwards_tells_one_shot_after_the_other(tmp_path, soon, monkeypatch):
    monkeypatch.setattr(heartbeat, "FIRST_S", 0.0)  # at every look: on a busy machine growing intervals miss the shots
    lines = "[plant.parameters]\nrest_s = 0.03\n"
    file = campaign(tmp_path, plant="python:step_plants:slow_branch", plant_lines=lines, powers=(0.0,), n=3)
    done = command("run", file, "-o", tmp_path / "y.parquet", "--jobs", 1)
    assert done.returncode == 0, done.stderr
    shots = [tuple(map(int, found)) for found in re.findall(r"at shot (\d+) of (\d+)", done.stderr)]
    assert shots
    assert all(1 <= shot <= of for shot, of in shots)


def test_a_quiet_run_has_no_heartbeat(tmp_path, soon):
    lines = "isolate = true\n[plant.parameters]\nrest_s = 0.3\n"
    file = campaign(tmp_path, plant="python:plants:SlowBranch", plant_lines=lines, powers=(0.0,), n=2)
    done = command("run", file, "-o", tmp_path / "y.parquet", "--jobs", 1, "--quiet")
    assert done.returncode == 0
    assert done.stderr == ""


def test_lines_come_at_growing_intervals(monkeypatch):
    from types import SimpleNamespace

    clock = SimpleNamespace(now=0.0)
    monkeypatch.setattr(heartbeat, "time", SimpleNamespace(monotonic=lambda: clock.now))
    said = []
    batch = SimpleNamespace(condition=SimpleNamespace(op_id="p"), n_shots=8)
    waiting = heartbeat.Waiting(batch, 480.0, said.append)
    for second in range(100):
        clock.now = float(second)
        if second == 15:
            waiting.beat(heartbeat.Beat(3, 8, (12.5,)))
        waiting.look()
    assert len(said) == 4  # at 10, 20, 40 and 80 s
    assert "starting or settling" in said[0]
    assert said[1].startswith("p: at shot 3 of 8, 12.5 Hz, for 5 s, the batch for 20 s; it is given up in 460 s")


def test_nothing_finished_for_long_is_said(monkeypatch):
    monkeypatch.setattr(progress, "STALLED_S", 0.05)
    said = []
    with progress._lines(100.0, said.append) as shown:
        shown.report(3, 12, 0.25)
        first = len(said)  # a line of before the report may stand there
        wait_for(lambda: len(said) > first)
    assert re.fullmatch(r"3/12 points, none finished for \d+(\.\d+)? s", said[-1])


def test_on_a_terminal_no_text_is_glued_to_the_bar(tmp_path):
    """A pseudo-terminal: whatever is printed beside the bar begins a line of its own."""
    lines = "[plant.parameters]\nrest_s = 0.05\n"
    file = campaign(tmp_path, plant="python:plants:SlowBranch", plant_lines=lines, powers=(0.1, 0.2), n=12)
    shown, terminal = pty.openpty()
    words = [SEQSWEEP, "run", file, "-o", "y.parquet", "--jobs", "1"]  # a name so short that no line breaks in it
    environment = {**os.environ, "TERM": "xterm", "PYTHONPATH": str(HERE)}
    process = subprocess.Popen(
        words, cwd=tmp_path, stdin=subprocess.DEVNULL, stdout=terminal, stderr=terminal, env=environment
    )
    os.close(terminal)
    text = b""
    while True:
        try:
            found = os.read(shown, 65536)
        except OSError:  # Linux's end of a pseudo-terminal
            break
        if not found:
            break
        text += found
    os.close(shown)
    assert process.wait(600) == 0
    screen = text.decode()
    assert "/24 points" in screen
    plain = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "\x1b", screen)
    at = plain.index("y.parquet: 24 ok")
    assert plain[at - 1] in "\n\r\x1b"
