"""What readers of foreign files do on bad days; `Sandbox.ask` calls these by name, so the sandbox must find them."""

from __future__ import annotations

import os
import signal
import time

from seqsweep.plant.errors import SeqsweepError


def crash():
    os.kill(os.getpid(), signal.SIGSEGV)


def leave():
    os._exit(3)


def hang():
    time.sleep(3600)


def gorge():
    return len(bytearray(64 << 30))


def recurse():
    return recurse()


def refuse():
    raise SeqsweepError("no good")


def exit_politely():
    raise SystemExit(0)


def well(number):
    return number + 1


def who():
    return os.getpid()
