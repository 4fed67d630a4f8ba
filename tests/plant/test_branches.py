"""Snapshots of a box that counts what is asked of it: right wherever it goes back to, and few of them are held."""

from __future__ import annotations

import itertools

import pytest

from seqsweep.plant.states.store import BoxLost, Room
from seqsweep.plant.states.stores import Snapshots


class Counter:
    """A box whose state is the sum of what was added since its start, and which knows the snapshots it holds."""

    def __init__(self):
        self.state, self.held, self.acted, self.most_held = None, {}, 0, 0
        self._names = itertools.count()

    def save(self):
        name = next(self._names)
        self.held[name] = self.state
        self.most_held = max(self.most_held, len(self.held))
        return name

    def load(self, name):
        self.state = self.held[name]

    def drop(self, name):
        del self.held[name]


def settle(box):
    box.acted += 1
    box.state = 100


def adding(n):
    """An action; the same for the same ``n``."""

    def add(box):
        box.acted += 1
        box.state += n
        return box.state

    return ACTIONS.setdefault(n, add)


ACTIONS = {}


def made():
    box = Counter()
    return box, Snapshots(lambda: box)


def way(*numbers):
    return (settle, *(adding(n) for n in numbers))


def test_every_position_gives_its_own_answer_in_whatever_order_it_is_asked():
    _, positions = made()
    positions.act((), settle)
    for numbers in [(1,), (2,), (1, 5), (2, 5), (1, 5, 7), (1,), (1, 5, 7), (2, 5)]:
        assert positions.act(way(*numbers), adding(3)) == 103 + sum(numbers)


def test_a_branch_that_goes_on_costs_one_snapshot_and_no_step_twice():
    box, positions = made()
    positions.act((), settle)
    for branch in range(40):
        for length in range(10):
            positions.act(way(*[branch + 1] * length), adding(branch + 1))
    assert box.acted == 1 + 40 * 10
    assert len(box.held) == 1 + 40


def test_a_position_that_is_asked_for_again_is_reached_once_more_and_stays():
    box, positions = made()
    positions.act((), settle)
    for n in (1, 2, 3):
        positions.act(way(*range(1, n)), adding(n))
    before = box.acted
    for other in (10, 11, 12):
        assert positions.act(way(1, 2), adding(other)) == 103 + other
    assert box.acted == before + 2 + 3  # the way there, once; then three answers


def test_the_oldest_snapshot_goes_first_and_is_given_back():
    box = Counter()
    positions = Snapshots(lambda: box, room=Room(branches=8))
    positions.act((), settle)
    for n in range(1, 50):
        positions.act(way(), adding(n))
    assert box.most_held <= 1 + 8 + 1  # the settled box, the branches, and the latest before the oldest goes
    assert positions.act(way(1), adding(3)) == 104


def test_branches_of_shots_that_are_over_do_not_drive_out_a_settled_box():
    """Three operating points in rounds, as an adaptive sweep asks: each is settled once."""
    box = Counter()
    positions = Snapshots(lambda: box, room=Room(branches=8))
    points = [lambda box: settle(box) for _ in range(3)]
    for point in points:
        positions.act((), point)
    for _ in range(4):
        for point in points:
            for n in range(6):
                positions.act((point,), adding(n))
    assert box.acted == 3 + 4 * 3 * 6
    assert len(box.held) == 3 + 8


def test_after_the_box_is_lost_another_one_goes_the_way_again():
    boxes = []

    def build():
        boxes.append(Counter())
        return boxes[-1]

    def die(box):
        raise BoxLost("fatal")

    positions = Snapshots(build)
    positions.act((), settle)
    positions.act(way(), adding(1))
    with pytest.raises(BoxLost):
        positions.act(way(1), die)
    assert positions.act(way(1), adding(3)) == 104
    assert len(boxes) == 2
