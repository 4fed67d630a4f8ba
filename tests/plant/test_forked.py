"""A fork as a snapshot: branches of a box with hidden statics, told from each other; crashes cost one branch."""

from __future__ import annotations

import gc
import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import pytest

from seqsweep.plant.states.forks import BoxDied, CannotFork, Forks
from seqsweep.plant.states.store import Room

from ..support.commands import TOP, is_alive, wait_for

pytestmark = pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="snapshots by fork need Linux")

_hidden = [0]  # a static, as a C library may have


class Counter:
    """A box with state where nobody can reach it."""

    def __init__(self):
        self.seen = []


@dataclass(frozen=True)
class Add:
    """Add to the hidden static; the answer is all that was ever added, and by whom."""

    number: int

    def __call__(self, box):
        _hidden[0] += self.number
        box.seen.append(self.number)
        return _hidden[0], tuple(box.seen), os.getpid()


@dataclass(frozen=True)
class Dies:
    number: int

    def __call__(self, box):
        os.write(2, b"assertion failed: theta < 2 pi\n")
        os.kill(os.getpid(), self.number)


@dataclass(frozen=True)
class Raises:
    def __call__(self, box):
        raise ValueError("no such port")


@dataclass(frozen=True)
class StartsAThread:
    def __call__(self, box):
        threading.Thread(target=time.sleep, args=(3600.0,), daemon=True).start()


@dataclass(frozen=True)
class Sleeps:
    told: str

    def __call__(self, box):
        with open(self.told, "a") as file:
            file.write(f" {os.getpid()}")
        time.sleep(3600.0)


@dataclass(frozen=True)
class Notes:
    """Note down that it was done."""

    book: str

    def __call__(self, box):
        with open(self.book, "a") as file:
            file.write("x")


@dataclass(frozen=True)
class LooksAtTheCollector:
    """How many objects are ever looked at again, and how many are not."""

    def __call__(self, box):
        return len(gc.get_objects()), gc.get_freeze_count()


def noted(book):
    """Note down that a box was made."""
    Notes(book)(None)
    return Counter()


def unwilling():
    raise FileNotFoundError("no library")


def asks_one_that_hangs(way, told):
    """In a process of its own: its box's settled process and nursery are told, then the fork that sleeps."""
    forks = Forks(Counter)
    settled, *_ = [forks.act(way[:k], way[k])[2] for k in range(len(way))]
    Path(told).write_text(f"{settled} {forks._nursery[0].pid}")
    forks.act(way, Sleeps(told))


@pytest.fixture
def forks(monkeypatch):
    kept = Forks(Counter, room=Room(branches=4, settled=3))
    yield kept
    kept.close()


def test_branches_share_the_way_and_not_what_comes_after(forks):
    settled = (Add(1), Add(10))
    assert forks.act((), Add(1))[:2] == (1, (1,))
    assert forks.act((Add(1),), Add(10))[:2] == (11, (1, 10))
    for number in (100, 200, 300):
        assert forks.act(settled, Add(number))[:2] == (11 + number, (1, 10, number))
    assert forks.act((*settled, Add(200)), Add(5))[:2] == (216, (1, 10, 200, 5))
    assert _hidden == [0]  # nothing of it happened here


def test_the_same_job_again_is_answered_by_another_process_and_alike(forks):
    first, second = (forks.act((Add(1),), Add(2)) for _ in range(2))
    assert first[:2] == second[:2]
    assert first[2] != second[2]
    assert os.getpid() not in (first[2], second[2])


def test_a_position_that_was_let_go_is_reached_again_from_the_nearest_one(forks):
    pids = [forks.act((Add(1),), Add(k))[2] for k in range(8)]  # eight branches, of which four are kept
    wait_for(lambda: sum(is_alive(pid) for pid in pids) == 4)
    assert forks.act((Add(1), Add(2)), Add(100))[:2] == (103, (1, 2, 100))
    way = tuple(Add(k) for k in range(1, 9))
    assert forks.act(way, Add(100))[:2] == (136, (*range(1, 9), 100))


def test_a_branch_goes_on_in_its_own_process_while_the_settled_box_stays(forks):
    settled = forks.act((), Add(1))[2]
    way, pids = (Add(1),), set()
    for k in range(2, 6):
        pids.add(forks.act(way, Add(k))[2])
        way = (*way, Add(k))
    assert len(pids) == 1
    assert is_alive(settled)
    assert forks.act((Add(1),), Add(50))[2] not in {settled, *pids}


def test_a_position_that_was_left_is_reached_again_once_and_then_stays(forks, tmp_path):
    """The way back is gone once, whoever branches there: the note is written for the first branch and the second."""
    book = tmp_path / "book"
    left = (Add(1), Notes(str(book)))
    forks.act((Add(1),), left[1])
    answers = [forks.act(left, Add(k)) for k in (10, 20, 30, 40)]
    assert [answer[:2] for answer in answers] == [(1 + k, (1, k)) for k in (10, 20, 30, 40)]
    assert len({pid for _, _, pid in answers}) == 4
    assert book.read_text() == "xx"


def test_a_settled_box_that_is_let_go_takes_its_branches_along_and_comes_back(forks):
    first = [forks.act((), Add(1))[2], forks.act((Add(1),), Add(2))[2]]
    for k in (10, 20, 30):
        for way in ((), (Add(k),)):
            forks.act(way, Add(k))
    wait_for(lambda: not any(Path(f"/proc/{pid}").exists() for pid in first))  # nor a zombie
    assert forks.act((Add(1), Add(2)), Add(3))[:2] == (6, (1, 2, 3))


def test_branches_of_shots_that_are_over_do_not_drive_out_a_settled_box(tmp_path):
    """Three operating points in rounds, as an adaptive sweep asks: each is settled once, however many branches came."""
    book = tmp_path / "book"
    points = [Notes(f"{book}{k}") for k in range(3)]
    forks = Forks(Counter, room=Room(branches=4))
    try:
        for point in points:
            forks.act((), point)
        for way in [(point,) for point in points] * 3:
            for k in range(6):
                assert forks.act(way, Add(k))[0] == k
    finally:
        forks.close()
    assert [Path(point.book).read_text() for point in points] == ["x"] * 3


def test_a_settled_box_that_is_killed_is_settled_again(forks):
    """As the memory killer would: who was asked for next is told, and no branch of it is asked in vain thereafter."""
    settled, branch = forks.act((), Add(1))[2], forks.act((Add(1),), Add(2))[2]
    os.kill(settled, signal.SIGKILL)
    wait_for(lambda: not is_alive(branch))
    with pytest.raises(BoxDied, match=r"^the box died: SIGKILL"):
        forks.act((Add(1),), Add(3))
    assert forks.act((Add(1), Add(2)), Add(3))[:2] == (6, (1, 2, 3))


def test_what_was_there_before_a_fork_is_not_collected_in_it(forks):
    """A collection writes to every object it looks at, and a fork would have to copy all of them."""
    looked_at, left_alone = forks.act((Add(1),), LooksAtTheCollector())
    assert looked_at < left_alone / 10


def test_a_crash_costs_its_branch_alone(forks):
    assert forks.act((), Add(1))[0] == 1
    with pytest.raises(BoxDied, match=r"^the box died: SIGSEGV"):
        forks.act((Add(1),), Dies(signal.SIGSEGV))
    assert forks.act((Add(1),), Add(2))[0] == 3
    with pytest.raises(BoxDied, match="SIGABRT"):
        forks.act((Add(1), Dies(signal.SIGABRT)), Add(2))  # on the way
    assert forks.act((Add(1), Add(2)), Add(3))[0] == 6
    with pytest.raises(BoxDied, match=r"^the box died: SIGABRT"):
        forks.act((Add(1), Add(2), Add(3)), Dies(signal.SIGABRT))  # in the process that came all the way
    assert forks.act((Add(1), Add(2), Add(3)), Add(4))[0] == 10


def test_what_an_action_raises_arrives_and_leaves_the_position_as_it_was(forks):
    for way in ((Add(1),), (Add(1), Add(2))):
        before, _, _ = forks.act(way[:-1], way[-1])
        with pytest.raises(ValueError, match=r"^no such port$"):
            forks.act(way, Raises())
        assert forks.act(way, Add(2))[0] == before + 2


def test_a_box_that_cannot_be_built_says_why():
    forks = Forks(unwilling)
    for _ in range(2):
        with pytest.raises(FileNotFoundError, match="no library"):
            forks.act((), Add(1))
    forks.close()


def test_a_box_with_threads_is_not_forked(forks):
    with pytest.raises(CannotFork, match="runs 1 threads of its own"):
        forks.act((), StartsAThread())
    assert forks.act((), Add(1))[0] == 1


def test_no_process_is_left_behind(forks):
    pids = [forks.act((Add(1),), Add(k))[2] for k in range(3)]
    assert all(is_alive(pid) for pid in pids)
    forks.close()
    wait_for(lambda: not any(is_alive(pid) for pid in pids))
    assert forks.act((Add(1),), Add(5))[0] == 6  # and it begins anew when asked


@pytest.mark.parametrize("way", [(Add(1),), (Add(1), Add(2))], ids=["a fork", "a process that goes on"])
def test_a_branch_that_hangs_goes_with_the_process_that_asked(tmp_path, way):
    """The asker is killed while a fork sleeps: nursery and forks follow, whatever they are at."""
    told = tmp_path / "pids"
    code = f"from tests.plant.test_forked import *; asks_one_that_hangs({way!r}, {str(told)!r})"
    asker = subprocess.Popen([sys.executable, "-c", code], cwd=TOP)
    wait_for(lambda: told.exists() and len(told.read_text().split()) == 3)
    pids = [int(pid) for pid in told.read_text().split()]
    assert all(is_alive(pid) for pid in pids)
    asker.kill()
    asker.wait()
    wait_for(lambda: not any(is_alive(pid) for pid in pids))


def test_a_fork_costs_neither_a_box_nor_the_way_to_it(tmp_path):
    """Twenty branches come from one box, which was made once and settled once; what a fork takes is printed."""
    made, settled = tmp_path / "made", tmp_path / "settled"
    forks, way = Forks(partial(noted, str(made))), (Notes(str(settled)),)
    try:
        forks.act((), way[0])
        begin = time.perf_counter()
        for k in range(20):
            forks.act(way, Add(k))
        print(f"\n  {(time.perf_counter() - begin) / 20 * 1e3:.1f} ms a fork", end="")
    finally:
        forks.close()
    assert (made.read_text(), settled.read_text()) == ("x", "x")
