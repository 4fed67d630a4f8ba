"""Foreign code stays in processes of its own: what the runner learns of it, and what is left when it dies."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from contextlib import contextmanager
from functools import partial

import pytest

from seqsweep.plant.protocol import Rating
from seqsweep.plant.registry import PlantError, PlantSpec, card_of, is_black_box, make_plant, register, runs_isolated
from seqsweep.sweep.config.sections import Config
from seqsweep.sweep.planning import make_plan
from seqsweep.sweep.run import campaign as campaign_of
from seqsweep.sweep.run import child as children_of
from seqsweep.sweep.run import host
from seqsweep.sweep.run.child import Child, ChildFailed, child, scratch
from seqsweep.sweep.run.host import plant_or_card
from seqsweep.sweep.run.spare import spare_children

from ..support.commands import TOP, call, campaign, command, end_group, is_alive, start, wait_for
from ..support.questions import (
    dies,
    kills_itself,
    kills_itself_once,
    no_answer_that_can_be_sent,
    pid_of,
    prints,
    r_ohm_of,
    raises,
    sleeps,
    starts_a_grandchild,
)

BRANCH = PlantSpec("branch-v1", {"r_ohm": 0.2})


@pytest.fixture
def found_by_name(monkeypatch):
    """The questions have to be importable in the child, too."""
    monkeypatch.setenv("PYTHONPATH", str(TOP))


def test_a_card_is_what_the_plant_says_of_itself_and_a_plan_needs_no_more(tmp_path):
    config = Config.from_dict(
        {
            "campaign": {"name": "card"},
            "plant": {"id": "branch-v1", "isolate": True},
            "operating_point": [{"id": "a", "active_power_mw": 0.1, "terminal_voltage_pu": 1.0}],
            "sweep": {"f_min_hz": 20.0, "f_max_hz": 900.0, "points": 12},
        }
    )
    card, plant = plant_or_card(config), make_plant("branch-v1")
    assert card == card_of(plant, PlantSpec("branch-v1"))
    assert card.rating == Rating(690.0, 1e6)
    assert card.listens
    assert make_plan(config, card) == make_plan(config, plant)


def test_a_card_holds_plain_values_whatever_the_plant_made_them_of(tmp_path):
    """A card that brought a class of the plant's module along would load that module in the runner."""
    (tmp_path / "foreign_rating.py").write_text(
        "from seqsweep.plant.rl_branch import RLBranch\n"
        "from seqsweep.plant.protocol import Rating\n"
        "class MyRating(Rating): pass\n"
        "class MyFloat(float): pass\n"
        "class Plant(RLBranch):\n"
        "    def __init__(self):\n"
        "        super().__init__()\n"
        "        self.rating, self.f1_hz = MyRating(400.0, 1e4), MyFloat(50.0)\n"
    )
    code = (
        "import sys; from seqsweep.plant.registry import PlantSpec; from seqsweep.sweep.run.child import child\n"
        "with child(PlantSpec('python:foreign_rating:Plant')) as asked: print(asked.card.rating)\n"
        "assert 'foreign_rating' not in sys.modules"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=600)
    assert (done.returncode, done.stdout) == (0, "Rating(voltage_v=400.0, power_va=10000.0)\n"), done.stderr


def test_a_child_answers_questions_until_one_of_them_ends_it(found_by_name):
    with child(BRANCH) as asked:
        assert asked.ask(pid_of, 300.0, "late") != os.getpid()
        assert asked.ask(r_ohm_of, 300.0, "late") == 0.2
        with pytest.raises(ChildFailed, match=r"^no licence for this host$"):
            asked.ask(raises, 300.0, "late")
        with pytest.raises(ChildFailed, match="plant's process died: exit status 7, last words 'segment 7 is on fire'"):
            asked.ask(partial(dies, status=7), 300.0, "late")


@pytest.mark.parametrize(("number", "name"), [(11, "SIGSEGV"), (6, "SIGABRT"), (9, "SIGKILL")])
def test_a_child_that_is_killed_says_by_which_signal(found_by_name, number, name):
    with child(BRANCH) as asked, pytest.raises(ChildFailed, match=f"died: {name}"):
        asked.ask(partial(kills_itself, number=number), 300.0, "late")


@pytest.mark.parametrize(("times", "status"), [(1, 0), (2, 4)])
def test_a_plant_that_is_killed_from_outside_while_it_is_made_is_made_once_more(tmp_path, times, status):
    """Killed twice, the machine is at fault, and neither the plant nor the input."""
    scars = tmp_path / "scars"
    scars.mkdir()
    lines = f'[plant.parameters]\nscars = "{scars}"\ntimes = {times}\n'
    path = campaign(tmp_path, plant="python:plants:KilledWhenMadeBranch", plant_lines=lines, n=2)
    done = call("run", path, "-o", tmp_path / "y.parquet", "--jobs", 1)
    assert done.returncode == status, done.stderr
    assert "Traceback" not in done.stderr
    assert ("SIGKILL, twice; the machine may be out of memory" in done.stderr) == (status == 4)


def test_a_question_whose_process_is_killed_from_outside_is_asked_once_more(tmp_path, found_by_name):
    asked = host.ChildHost(BRANCH)
    assert asked.ask(partial(kills_itself_once, scar=tmp_path / "scar"), 300.0, "late") != os.getpid()
    with pytest.raises(ChildFailed, match="died: SIGKILL"):
        asked.ask(partial(kills_itself, number=9), 300.0, "late")


def test_an_answer_that_cannot_be_sent_costs_the_child_alone(found_by_name):
    with child(BRANCH) as asked, pytest.raises(ChildFailed, match="died: exit status 1"):
        asked.ask(no_answer_that_can_be_sent, 300.0, "late")


def test_a_child_that_overruns_its_time_goes_with_everything_it_started(found_by_name):
    with child(BRANCH) as asked:
        pid, grandchild = asked.ask(pid_of, 300.0, "late"), asked.ask(starts_a_grandchild, 300.0, "late")
        with pytest.raises(ChildFailed, match=r"^it took too long$"):
            asked.ask(sleeps, 0.2, "it took too long")
        assert is_alive(grandchild)
    wait_for(lambda: not is_alive(pid) and not is_alive(grandchild))


def test_what_a_plant_prints_does_not_fill_the_disk(found_by_name):
    with child(BRANCH) as asked:
        assert asked.ask(partial(prints, n_bytes=100), 300.0, "late") == 100
        assert asked.ask(partial(prints, n_bytes=children_of.SAID_BYTES), 300.0, "late") > children_of.SAID_BYTES
        assert asked.ask(partial(prints, n_bytes=100), 300.0, "late") == 100


@pytest.mark.parametrize(
    ("spec", "words"),
    [
        (PlantSpec("brunch-v1"), "did you mean 'branch-v1'"),
        (PlantSpec("branch-v1", {"r_omh": 1.0}), "did you mean 'r_ohm'"),
    ],
)
def test_a_plant_that_cannot_be_made_is_refused_in_its_own_words(tmp_path, spec, words):
    with pytest.raises(PlantError, match=words):
        Child(spec, tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_killed_runner_takes_a_child_that_is_deep_in_itself_with_it(tmp_path, found_by_name):
    code = (
        "import sys, pathlib; from seqsweep.plant.registry import PlantSpec\n"
        "from seqsweep.sweep.run.child import child\n"
        "from tests.support.questions import pid_of, sleeps\n"
        "with child(PlantSpec('branch-v1')) as asked:\n"
        f"    pathlib.Path({str(tmp_path / 'pid')!r}).write_text(str(asked.ask(pid_of, 300.0, 'late')))\n"
        "    asked.ask(sleeps, 3600.0, 'late')\n"
    )
    runner = subprocess.Popen([sys.executable, "-c", code], cwd=TOP)
    wait_for(lambda: (tmp_path / "pid").exists() and (tmp_path / "pid").read_text())
    time.sleep(0.2)
    runner.kill()
    runner.wait()
    wait_for(lambda: not is_alive(int((tmp_path / "pid").read_text())))


def test_temporary_files_go_with_the_run_and_a_killed_runs_with_the_next(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    left = tmp_path / "seqsweep-run-left"
    left.mkdir()
    (left / "lock").touch()
    os.utime(left, (0.0, 0.0))
    with scratch() as first:
        (first / "unpacked").mkdir()
        assert not left.exists()
        os.utime(first, (0.0, 0.0))
        with scratch() as second:
            assert first.exists()  # old, but its owner holds its lock
            assert second != first
    assert list(tmp_path.iterdir()) == []


def the_branch_in_a_child():
    return Config.from_dict(
        {
            "campaign": {"name": "spare"},
            "plant": {"id": BRANCH.id, "parameters": dict(BRANCH.parameters), "isolate": True},
            "operating_point": [{"active_power_mw": 0.1, "terminal_voltage_pu": 1.0}],
            "sweep": {"f_hz": [77.0]},
        }
    )


def test_the_child_that_gave_the_card_answers_what_is_asked_next_and_ends_with_the_block(found_by_name, monkeypatch):
    begun, real = [], subprocess.Popen
    monkeypatch.setattr(children_of.subprocess, "Popen", lambda *a, **k: begun.append(real(*a, **k)) or begun[-1])
    asked = host.ChildHost(BRANCH)
    with spare_children():
        plant_or_card(the_branch_in_a_child())
        assert asked.ask(pid_of, 300.0, "late") == begun[0].pid
        assert asked.ask(pid_of, 300.0, "late") == begun[1].pid  # the spare one ended with its answer
        plant_or_card(the_branch_in_a_child())
        assert begun[2].poll() is None
    assert [process.poll() for process in begun] == [-9, -9, -9]
    plant_or_card(the_branch_in_a_child())
    assert begun[3].poll() == -9  # outside of the block nobody stays


def test_a_spare_child_that_died_or_holds_another_plant_is_not_taken(found_by_name, monkeypatch):
    begun, real = [], subprocess.Popen
    monkeypatch.setattr(children_of.subprocess, "Popen", lambda *a, **k: begun.append(real(*a, **k)) or begun[-1])
    with spare_children():
        plant_or_card(the_branch_in_a_child())
        assert host.ChildHost(PlantSpec("branch-v1", {"r_ohm": 0.3})).ask(r_ohm_of, 300.0, "late") == 0.3
        begun[0].kill()
        begun[0].wait()
        assert host.ChildHost(BRANCH).ask(pid_of, 300.0, "late") == begun[2].pid


def test_the_spare_child_measures_within_the_memory_that_the_campaign_gives(found_by_name):
    with spare_children():
        plant_or_card(the_branch_in_a_child())
        with pytest.raises(ChildFailed, match=r"MB of memory; plant.memory_mb allows 1 MB"):
            host.ChildHost(BRANCH, memory_mb=1.0).ask(sleeps, 300.0, "late")


def test_a_black_box_is_never_loaded_in_the_runner(monkeypatch):
    from seqsweep.plant import registry

    monkeypatch.setattr(registry, "_targets", dict(registry._targets))
    monkeypatch.setattr(registry, "_BLACK_BOXES", set())
    register("boxed-v1", "seqsweep.plant.rl_branch:RLBranch", black_box=True)
    assert is_black_box("boxed-v1")
    assert runs_isolated("boxed-v1", None)
    with pytest.raises(PlantError, match=r"isolate = false: boxed-v1 is foreign code, .* never loaded in the runner"):
        runs_isolated("boxed-v1", False)
    assert not runs_isolated("branch-v1", None)
    assert runs_isolated("branch-v1", True)
    assert not runs_isolated("python:plants:SlowBranch", False)


def test_the_runner_plans_and_runs_a_foreign_plant_without_importing_it(tmp_path):
    """The module leaves its process id whenever it is imported."""
    (tmp_path / "tell_tale.py").write_text(
        "import os, pathlib\n"
        "from seqsweep.plant.rl_branch import RLBranch\n"
        "with open(pathlib.Path(__file__).with_name('imported'), 'a') as file: print(os.getpid(), file=file)\n"
        "class Plant(RLBranch): pass\n"
    )
    path = campaign(tmp_path, plant="python:tell_tale:Plant", n=4)
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    planned = call("plan", path, env=environment)
    assert planned.returncode == 0, planned.stderr
    assert "worker" in planned.stdout.splitlines()[-1]
    process = start("run", path, "-o", tmp_path / "y.parquet", env=environment)
    try:
        process.communicate(timeout=600)
    finally:
        end_group(process)
    assert process.returncode == 0
    importers = {int(line) for line in (tmp_path / "imported").read_text().split()}
    assert len(importers) >= 2  # one for the plan's card and its stopwatch, one for those of the run
    assert process.pid not in importers


def test_a_plan_says_so_where_the_stopwatch_stops(tmp_path):
    """The plant says what it is, but cannot be driven: the plan stands, its wall time is unknown."""
    planned = command("plan", campaign(tmp_path, plant="python:plants:UnwillingBranch", n=4))
    assert planned.returncode == 0
    assert planned.stdout.splitlines()[-1] == "wall time unknown: no licence server found"


def test_a_plant_that_dies_as_it_is_made_is_wrong_input(tmp_path):
    (tmp_path / "stillborn.py").write_text("import os\ndef plant(): os.abort()\n")
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    done = call(
        "run", campaign(tmp_path, plant="python:stillborn:plant"), "-o", tmp_path / "y.parquet", env=environment
    )
    assert done.returncode == 2
    assert done.stderr.startswith("python:stillborn:plant cannot be made: the plant's process died: SIGABRT")


def test_check_survives_a_plant_that_does_not(tmp_path):
    (tmp_path / "mortal.py").write_text(
        "import os\nfrom seqsweep.plant.rl_branch import RLBranch\n"
        "class Plant(RLBranch):\n    def settle(self, point, source): os.abort()\n"
    )
    done = call("check", "python:mortal:Plant", env={**os.environ, "PYTHONPATH": str(tmp_path)})
    assert done.returncode == 1
    assert done.stdout.startswith("FAIL  survives  the plant's process died: SIGABRT")


@pytest.mark.parametrize(
    ("spacing", "amplitude_pu"), [("adaptive", 0.001), ("log", "auto")], ids=["rounds", "pilots and points"]
)
def test_all_that_a_sweep_asks_goes_to_the_same_children(tmp_path, monkeypatch, spacing, amplitude_pu):
    begun, brought = [], []
    real = campaign_of.pool

    class Counted(Child):
        def __init__(self, *arguments):
            super().__init__(*arguments)
            begun.append(self)

    @contextmanager
    def counting(*arguments):
        with real(*arguments) as results:
            yield lambda batches: brought.append(len(batches)) or results(batches)

    monkeypatch.setattr(host, "Child", Counted)
    monkeypatch.setattr(campaign_of, "pool", counting)
    content = {
        "campaign": {"name": "rounds"},
        "plant": {"id": "branch-v1", "isolate": True},
        "operating_point": [{"active_power_mw": 0.65, "terminal_voltage_pu": 1.0}],
        "sweep": {"f_min_hz": 20.0, "f_max_hz": 900.0, "points": 40, "spacing": spacing},
        "injection": {"amplitude_pu": amplitude_pu},
    }
    config = Config.from_dict(content)
    card = plant_or_card(config)
    campaign_of.run(make_plan(config, card), card, tmp_path / "y.parquet", jobs=1)
    assert len([n for n in brought if n]) > 1
    assert len(begun) == 1
