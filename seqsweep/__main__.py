"""``python -m seqsweep`` is the command line, and so is the script ``seqsweep``."""

import gc
import os
import signal

COLLECTED_AFTER = 10_000, 20, 20
"""Objects that a command makes before the collector of garbage looks at them, and how often it looks at older ones.

What a command imports stays to its end: looking through it ever again takes a tenth of the time of a short command.
"""


def command() -> None:
    """Run the command line; who interrupts it while it is being imported sees one line, as ever."""
    gc.set_threshold(*COLLECTED_AFTER)
    for number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, _leave)
    from seqsweep.sweep.cli.main import console

    console()


def _leave(number: int, frame: object) -> None:
    os.write(2, b"interrupted\n")
    os._exit(3)


if __name__ == "__main__":
    command()
