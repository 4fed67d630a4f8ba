"""Questions that a child can find by name: functions of a plant. The module is light, for every child loads it."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from pathlib import Path


def pid_of(plant):
    return os.getpid()


def r_ohm_of(plant):
    return plant.r_ohm


def raises(plant):
    raise RuntimeError("no licence\nfor this host")


def dies(plant, status):
    print("segment 7 is on fire", flush=True)
    os._exit(status)


def kills_itself(plant, number):
    os.kill(os.getpid(), number)


def kills_itself_once(plant, scar):
    """Killed, where no file ``scar`` is there yet; its process, where one is."""
    if not Path(scar).exists():
        Path(scar).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return os.getpid()


def sleeps(plant):
    time.sleep(3600.0)


def starts_a_grandchild(plant):
    return subprocess.Popen(["sleep", "600"]).pid


def prints(plant, n_bytes):
    os.write(1, b"x" * n_bytes)
    return os.fstat(1).st_size


def no_answer_that_can_be_sent(plant):
    return lambda: None
