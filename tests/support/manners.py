"""Bad manners of a box in Python, as `boxes/manners.h` has them in C: programs and plants look them up by name."""

import os
import signal


def forks():
    for _ in range(3):
        if os.fork() == 0:
            signal.pause()


def dies_with_orphans():
    forks()
    os.abort()


def floods():
    """A gigabyte, on standard error: a program's standard output is for frames."""
    for _ in range(1024):
        os.write(2, b"x" * (1 << 20))


def deaf():
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    while True:
        signal.pause()


MANNERS = {
    "moves": lambda: os.chdir("/"),
    "leaves": lambda: os._exit(0),
    "forks": forks,
    "dies_with_orphans": dies_with_orphans,
    "floods": floods,
    "signals": lambda: os.kill(os.getpid(), signal.SIGTERM),
    "deaf": deaf,
}
