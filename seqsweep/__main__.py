"""``python -m seqsweep`` is the command line, and so is the script ``seqsweep``."""

import os
import signal


def command() -> None:
    """Run the command line; who interrupts it while it is being imported sees one line, as ever."""
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
