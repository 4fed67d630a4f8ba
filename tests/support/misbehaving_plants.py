"""Plants with bad manners; campaigns call them ``python:misbehaving_plants:NAME``."""

from __future__ import annotations

import os
import time

from manners import MANNERS
from plants import SlowBranch

_hoard: list[bytearray] = []


class Leaking(SlowBranch):
    """Keeps ten megabytes of every hundredth of a second that it is at work."""

    def run_phasors(self, *arguments, **options):
        while True:
            _hoard.append(bytearray(os.urandom(1 << 20) * 10))
            time.sleep(0.01)


class Forking(SlowBranch):
    """Starts processes that start processes, and waits for none of them."""

    def run_phasors(self, *arguments, **options):
        for _ in range(3):
            if os.fork() == 0:
                os.fork()
                time.sleep(600)
        time.sleep(600)


class Rude(SlowBranch):
    """Behaves as ``manner`` says, once, when it is first driven with a tone."""

    def __init__(self, manner):
        super().__init__()
        self._manner = manner

    def run_phasors(self, jobs, windows, block_steps, n_blocks):
        if manner := MANNERS.pop(self._manner, None):
            manner()
        return super().run_phasors(jobs, windows, block_steps, n_blocks)
