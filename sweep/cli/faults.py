"""A fault of the program itself: one line on stderr, the details in a log that can be sent to us.

Such a fault is no refusal: it is whatever neither `SeqsweepError` nor the operating system raised.
The log lies beside the output where the command has one, else in the folder for temporary files.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

DEBUG = "--debug"
"""The option that prints the details instead of writing them to a log; it may stand anywhere on the line."""


def told(error: BaseException, arguments: Sequence[str], debug: bool) -> str:
    """What stderr is told of a fault; unless ``debug``, the details go to a log file, which is named.

    Parameters
    ----------
    error : BaseException
        The fault, with its traceback.
    arguments : sequence of str
        The command line that led to it, without the name of the program.
    debug : bool
        Whether the details are to be printed.
    """
    what = f"{type(error).__name__}: {' '.join(str(error).split())}".rstrip(": ")
    head = f"fault of seqsweep itself, not of your input: {what}"
    details = _details(error, arguments)
    if debug:
        return f"{details}\n{head}"
    try:
        log = _log_of(arguments)
        log.write_text(details, "utf-8")
    except OSError as unwritten:
        return f"{details}\n{head}; no log could be written: {unwritten}"
    return f"{head}; details in {log}, or with {DEBUG}"


def _details(error: BaseException, arguments: Sequence[str]) -> str:
    import platform
    import traceback
    from importlib.metadata import version

    where = f"seqsweep {version('seqsweep')}, Python {platform.python_version()}, {platform.platform()}"
    return f"{where}\nseqsweep {' '.join(arguments)}\n\n{''.join(traceback.format_exception(error))}"


def _log_of(arguments: Sequence[str]) -> Path:
    output = output_of(arguments)
    if output is not None and output.absolute().parent.is_dir():
        return output.with_name(f"{output.name}.fault.log")
    import tempfile

    with tempfile.NamedTemporaryFile(prefix="seqsweep-fault-", suffix=".log", delete=False) as file:
        return Path(file.name)


def output_of(arguments: Sequence[str]) -> Path | None:
    """The file or folder that a command line names as its output, if it names one."""
    for given, following in zip(arguments, [*arguments[1:], None], strict=True):
        if given in ("-o", "--output"):
            return Path(following) if following else None
        if given.startswith("--output="):
            return Path(given.partition("=")[2])
    return None


def command_line() -> tuple[list[str], bool]:
    """What this process was called with, without its own name and without `DEBUG`; and whether that was there."""
    given = sys.argv[1:]
    return [argument for argument in given if argument != DEBUG], DEBUG in given
