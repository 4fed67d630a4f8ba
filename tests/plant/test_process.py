"""A device behind a pipe: the same table as in this process, and what a bad program costs."""

from __future__ import annotations

import json
import re
import sys
import time

import numpy as np
import pytest

from seqsweep.identify.table.read import read_table
from seqsweep.plant.boxes.program import process_plant
from seqsweep.plant.boxes.program_frames import MOST_STEPS, Peer, PeerError
from seqsweep.plant.check import check_plant
from seqsweep.plant.protocol import Injection, Job, OperatingPoint, Source, Tone

from ..support import step_plants
from ..support.commands import HERE, campaign, command, end_group, ended, group_members, shards_of, start, wait_for

PEER = f"{sys.executable} {HERE / 'boxes' / 'peer.py'}"
RATED = OperatingPoint(0.0, 690.0)
SNAPSHOT = {"card": {"snapshot": True}}


@pytest.mark.parametrize("parameters", [{}, SNAPSHOT], ids=["from cold", "snapshots"])
def test_a_program_keeps_the_promise_of_a_plant(parameters):
    plant = process_plant(PEER, **parameters)
    assert [finding for finding in check_plant(plant) if not finding.passed] == []


@pytest.mark.parametrize("parameters", [{}, SNAPSHOT], ids=["from cold", "snapshots"])
def test_a_program_gives_the_very_samples_of_the_device_it_wraps(parameters):
    plant, twin = process_plant(PEER, **parameters), step_plants.branch()
    tone = Injection("series_voltage", (Tone(-70.0, 5.0, 0.2),))
    ends = [(plant, plant.settle(RATED, Source())), (twin, twin.settle(RATED, Source()))]
    for n_steps in (1, 400, MOST_STEPS + 7):  # a frame and more
        answers = [device.run([Job(state, tone)], n_steps)[0] for device, state in ends]
        (_, mine), (_, wanted) = answers
        assert mine.t0_s == wanted.t0_s
        assert np.array_equal(mine.v, wanted.v)
        assert np.max(np.abs(mine.i - wanted.i)) <= 1e-12 * np.max(np.abs(wanted.i))
        ends = [(device, end) for (device, _), (end, _) in zip(ends, answers, strict=True)]


def test_the_same_sweep_through_a_process_gives_the_same_table(tmp_path):
    tables = []
    for name, plant in (("wrapped", "python:step_plants:branch"), ("through", f"process:{PEER}")):
        done = command("run", campaign(tmp_path, plant=plant, n=2), "-o", tmp_path / f"{name}.parquet")
        assert done.returncode == 0, done.stderr
        tables.append(read_table(tmp_path / f"{name}.parquet").responses[0])
    wrapped, through = tables
    assert through.f_hz.tolist() == wrapped.f_hz.tolist()
    assert np.max(np.abs(through.y - wrapped.y)) <= 1e-9 * np.max(np.abs(wrapped.y))  # rounding under a small tone
    # and it is the device: the closed form of the held branch
    assert np.max(np.abs(wrapped.y[:, 0, 0] / step_plants.admittance(wrapped.f_hz) - 1.0)) <= 1e-4


FAULTS = {
    "garbage": "is no frame STEP: standard output is for frames alone, print to standard error",
    "prints": "b'entering', which is no frame STEP",
    "exit": "the program ended before it answered STEP: exit status 3, last words 'licence expired'",
    "segfault": "the program ended before it answered STEP: SIGSEGV",
    "huge": "announces 4294967295 bytes",
    "short": "bytes are needed",
    "fail": "the program says: theta left the circle",
    "nan": "the response is not finite",
}


def test_a_bad_program_costs_the_points_that_suffer_from_it_with_the_reason(tmp_path):
    """It goes wrong 1.5 s after its cold start, differently at each operating point: the window near f1 meets that."""
    lines = f"[plant.parameters]\nfaults = {json.dumps(list(FAULTS))}\nafter = 30000\nanswer_s = 300.0"
    powers = range(len(FAULTS) + 1)
    path = campaign(tmp_path, plant=f"process:{PEER}", plant_lines=lines, powers=powers)
    path.write_text(path.read_text().replace("f_min_hz = 20.0\nf_max_hz = 900.0\npoints = 8", "f_hz = [45.0, 300.0]"))
    status, said = ended("run", path, "-o", tmp_path / "y.parquet", "--jobs", 2)
    assert status == 1, said
    assert "Traceback" not in said
    well, *ill = read_table(tmp_path / "y.parquet").responses
    assert well.status.tolist() == ["ok", "ok"], well.reason
    for (fault, words), response in zip(FAULTS.items(), ill, strict=True):
        assert response.status.tolist() == ["diverged" if fault == "nan" else "failed", "ok"], fault
        assert words in response.reason[0]


def test_a_program_that_falls_silent_is_not_waited_for(tmp_path):
    lines = '[plant.parameters]\nfaults = ["silence"]\nafter = 30000\nanswer_s = 1.0'
    path = campaign(tmp_path, plant=f"process:{PEER}", plant_lines=lines, powers=[1.0])
    path.write_text(path.read_text().replace("f_min_hz = 20.0\nf_max_hz = 900.0\npoints = 8", "f_hz = [45.0]"))
    status, said = ended("run", path, "-o", tmp_path / "y.parquet", "--jobs", 1)
    assert status == 1, said
    (response,) = read_table(tmp_path / "y.parquet").responses
    assert response.status.tolist() == ["failed"]
    assert re.search(r"no answer to \w+ within 1 s", response.reason[0])


@pytest.mark.parametrize("parameters", [{}, SNAPSHOT], ids=["from cold", "snapshots"])
def test_a_program_that_ended_is_started_again_for_the_next_point(parameters):
    plant = process_plant(PEER, faults=["exit"], after=1000, **parameters)
    for _ in range(2):
        with pytest.raises(PeerError, match="licence expired"):
            plant.settle(OperatingPoint(1e6, 690.0), Source())
        assert plant.settle(RATED, Source()).step > 1000


CARDS = {
    "version": ({"version": 2}, "version is 2; this protocol is version 1"),
    "step": ({"dt_s": 0}, "dt_s: given 0; needed: a number above 0, in s"),
    "range": ({"active_power_w": [1.0, 0.0]}, "active_power_w: given [1.0, 0.0]; needed: two numbers"),
    "misspelt": ({"snapshots": True}, "unknown key 'snapshots'; known are version, f1_hz"),
}


@pytest.mark.parametrize("case", CARDS)
def test_a_wrong_card_is_refused_by_key(case):
    card, words = CARDS[case]
    with pytest.raises(PeerError) as refusal:
        process_plant(PEER, card=card)
    assert words in str(refusal.value)


@pytest.mark.parametrize("fault", ["garbage", "silence", "exit"])
def test_a_program_that_cannot_introduce_itself_is_wrong_input(tmp_path, fault):
    lines = f'[plant.parameters]\nhello = "{fault}"\nanswer_s = 1.0'
    done = command("run", campaign(tmp_path, plant=f"process:{PEER}", plant_lines=lines), "-o", tmp_path / "y.parquet")
    assert done.returncode == 2
    assert done.stderr.startswith(f"process:{PEER} cannot be made: ")
    assert "PeerError" not in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["campaign.toml"]


def test_a_command_that_is_none_is_refused():
    for words in ("/no/such/program", "'unfinished", ""):
        with pytest.raises(ValueError, match="cannot be started"):
            Peer(words, 1.0)


def test_a_program_that_answers_while_it_reads_does_not_block():
    """`cat` sends back what it gets, at once: more than a pipe holds, in both directions."""
    peer = Peer("cat", 5.0)
    content = bytes(1 << 20)
    assert peer.ask("STEP", content, len(content)) == content
    peer.close()


def test_a_killed_runner_takes_a_silent_program_with_it(tmp_path):
    lines = '[plant.parameters]\nfaults = ["silence"]\nafter = 30000\nanswer_s = 600.0'
    path = campaign(tmp_path, plant=f"process:{PEER}", plant_lines=lines, powers=[0.0, 1.0], n=3)
    table = tmp_path / "y.parquet"
    process = start("run", path, "-o", table)
    try:
        wait_for(lambda: len(group_members(process.pid)) >= 3 and len(shards_of(table)) >= 1)
        time.sleep(0.3)
        process.kill()
        process.wait()
        wait_for(lambda: not group_members(process.pid), 120.0)
    finally:
        end_group(process)


def test_a_program_is_refused_a_grid_with_the_way_out():
    with pytest.raises(ValueError, match="goes forwards only: it stands on an ideal source"):
        process_plant(PEER).settle(RATED, Source("thevenin", 0.01, 1e-3))
