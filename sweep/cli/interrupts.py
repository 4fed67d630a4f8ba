"""Ctrl-C and a request to end: raised once, where it is caught; who asks again is let go at once.

Python raises `KeyboardInterrupt` wherever the main thread happens to be. In a finaliser or a callback nobody catches
it: it is printed and forgotten. While another error is dealt with, or when all is done, it ends the process with a
traceback. Here what a signal does depends on how far the command is, so that there is no such moment.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any

from .say import tell
from .shared import INTERRUPTED

AGAIN_S = 0.01
"""Time (s) after which an interrupt that nobody caught is raised anew, somewhere else."""


class Interrupts:
    """The handler of signals of one command.

    Parameters
    ----------
    words : callable
        What is told whoever interrupts.

    Attributes
    ----------
    came : bool
        Whether the command was interrupted: whatever is raised from then on comes of that.
    """

    def __init__(self, words: Callable[[], str]):
        self._words = words
        self._leave_with: int | None = None
        self._over = self._told = self.came = False
        self._hook, self._thread_hook = sys.unraisablehook, threading.excepthook

    def heed(self) -> None:
        """Be asked from now on, by Ctrl-C unless this process was begun deaf to it, and by SIGTERM."""
        with suppress(ValueError):  # only the main thread can be told
            if signal.getsignal(signal.SIGINT) != signal.SIG_IGN:
                signal.signal(signal.SIGINT, self)
            signal.signal(signal.SIGTERM, self)  # `timeout`, Slurm, docker stop: as Ctrl-C
            sys.unraisablehook, threading.excepthook = self.unraisable, self.in_thread

    def __call__(self, number: int, frame: FrameType | None) -> None:
        if self._leave_with is None:
            self.came, self._leave_with = True, INTERRUPTED
            raise KeyboardInterrupt
        if self.came and not self._told:
            os.write(2, f"{self._words()}\n".encode())  # the stream may be in use
        os._exit(self._leave_with)

    def unraisable(self, what: Any) -> None:
        """For `sys.unraisablehook`: an interrupt that came where nothing can be raised is raised a moment later.

        Whatever else finalisers of what is interrupted complain of is passed over.
        """
        if not self.came:
            self._hook(what)
        elif issubclass(what.exc_type, KeyboardInterrupt) and not self._over:
            self._leave_with = None
            signal.signal(signal.SIGALRM, self)
            signal.setitimer(signal.ITIMER_REAL, AGAIN_S)

    def in_thread(self, what: threading.ExceptHookArgs) -> None:
        """For `threading.excepthook`: of a pool that is interrupted, threads may find that their processes are gone."""
        if not self.came:
            self._thread_hook(what)

    @contextmanager
    def foremost(self) -> Iterator[None]:
        """Whatever is raised in the block after an interrupt, by who was interrupted, is that interrupt."""
        try:
            yield
        except Exception:
            if self.came:
                raise KeyboardInterrupt from None
            raise

    def over(self, status: int) -> int:
        """Nothing is left to be interrupted; the status of the command, as given."""
        self._over, self._leave_with = True, status
        return status

    def farewell(self) -> int:
        """Tell that the command was interrupted; its status."""
        self.came = True
        status = self.over(INTERRUPTED)
        tell(self._words())
        self._told = True
        return status
