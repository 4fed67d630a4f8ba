"""The command line. Errors become one message and an exit status here, and nowhere else.

Exit status: 0 done, 1 done but some rows are not ok, 2 the input is wrong, 3 interrupted, 4 the
machine failed us, 5 a fault of the program itself. What a command needs is imported inside it:
``--help`` must not wait.
"""

from __future__ import annotations

import errno
import io
import os
import signal
import sys
import threading
import warnings
from collections.abc import Iterable, Sequence
from functools import partial
from typing import Annotated, Any

import typer

from ...plant.errors import SeqsweepError
from . import faults
from .commands import COMMANDS, epilog_of, meant_by
from .interrupts import Interrupts
from .kinds import refuse_others
from .say import say, tell
from .shared import FAULT, INTERRUPTED, MACHINE, OK, WRONG_INPUT
from .shell import first_sentence
from .telling import speaking

_USAGE_ERROR: Any = typer.BadParameter.__mro__[2]
"""`ClickException`: newer versions of typer bring a click of their own, older ones import it."""

HELP = "Sweep a converter nobody can look into: its 2x2 sequence admittance, as a table."

_PROGRAM: dict[str, Any] = {
    "name": "seqsweep",
    "help": HELP,
    "no_args_is_help": True,
    "add_completion": False,
    "context_settings": {"help_option_names": ["-h", "--help"]},
    "pretty_exceptions_enable": False,
    "rich_markup_mode": None,
}

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)

GO_ON = "run the same command again to go on"


def _version(
    version: Annotated[bool, typer.Option("--version", help="Print the version and exit.")] = False,
    debug: Annotated[bool, typer.Option(faults.DEBUG, help="Print the details of a fault of the program.")] = False,
) -> None:
    if version:
        import platform
        from importlib.metadata import version as version_of

        from ...identify.table.format import VERSION as TABLE_FORMAT

        say(f"seqsweep {version_of('seqsweep')}, table format {TABLE_FORMAT}, Python {platform.python_version()}")
        raise typer.Exit


def _program(names: Iterable[str]) -> typer.Typer:
    """The command line with the commands of these names."""
    program = typer.Typer(**_PROGRAM)
    program.callback(invoke_without_command=True)(_version)
    for name in names:
        told = speaking(COMMANDS[name].run, partial(refuse_others, name))
        program.command(name, epilog=epilog_of(COMMANDS[name]), short_help=first_sentence(told.__doc__ or ""))(told)
    return program


def __getattr__(name: str) -> typer.Typer:
    """``app``, the whole command line: made where it is asked for."""
    if name == "app":
        return _program(COMMANDS)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def main() -> None:
    """Run the command line and raise ``SystemExit`` with its exit status."""
    raise SystemExit(_status())


def console() -> None:
    """Run the command line and end the process.

    Everything is written by then, and taking the compiler down in order would cost 0.3 s. Pools of
    processes need no orderly end either: Linux ends them with this process, while to wait for them may
    take minutes, if one was killed while it held the lock of a queue.
    """
    status = _status()
    sys.stdout.flush()
    sys.stderr.flush()
    if status == INTERRUPTED or threading.active_count() == 1 or sys.platform == "linux":
        os._exit(status)
    raise SystemExit(status)  # elsewhere, pools are taken down by the interpreter


def _status() -> int:
    interrupts = Interrupts(lambda: f"interrupted{'; ' + GO_ON if _resumes() else ''}")
    try:
        interrupts.heed()
        return interrupts.over(_of_the_command(interrupts))
    except KeyboardInterrupt:  # while another error was dealt with
        return interrupts.farewell()


def _of_the_command(interrupts: Interrupts) -> int:
    """Run the command; its exit status."""
    arguments, debug = faults.command_line()
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")  # matrices are small here: more threads only get in each other's way
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "1")  # it looks for them among all that is installed
    warnings.filterwarnings("ignore", message=".*still being processed by the workers", category=UserWarning)  # joblib
    try:
        with interrupts.foremost():
            result = _asked(arguments)(arguments, prog_name="seqsweep", standalone_mode=False)
    except _USAGE_ERROR as error:
        if meant := _meant(arguments):
            tell(f"no command is called so; did you mean: seqsweep {meant}")
        else:
            usage = io.StringIO()
            error.show(file=usage)
            tell(usage.getvalue().rstrip())
        return WRONG_INPUT
    except (KeyboardInterrupt, typer.Abort):
        return interrupts.farewell()
    except SeqsweepError as error:
        tell(str(error))
        return WRONG_INPUT
    except (BrokenPipeError, SystemExit):  # nobody reads on; typer makes the latter of the former
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return OK
    except IsADirectoryError as error:
        tell(f"{error.filename} is a folder; name a file")
        return WRONG_INPUT
    except OSError as error:
        kept = error.errno in _FULL and _began(arguments)
        tell(f"{_in_words(error)}{'; what was measured is kept: ' + GO_ON if kept else ''}")
        return MACHINE
    except MemoryError:
        tell("the memory of this machine does not suffice")
        return MACHINE
    except Exception as error:
        details = faults.told(error, arguments, debug)
        typer.echo(details, err=True) if debug else tell(details)
        return FAULT
    if result == 128 + signal.SIGINT:  # what typer makes of Ctrl-C
        return interrupts.farewell()
    return result if isinstance(result, int) else OK


def _asked(arguments: Sequence[str]) -> typer.Typer:
    """The one command that is asked: to prepare all of them takes as long as to import numpy."""
    return _program(arguments[:1] if arguments and arguments[0] in COMMANDS else COMMANDS)


def _meant(arguments: Sequence[str]) -> str | None:
    """The command that a first word from elsewhere stands for; None where it is a command, or no word of the list."""
    word = next((argument for argument in arguments if not argument.startswith("-")), "")
    return None if word in COMMANDS else meant_by(word)


def _in_words(error: OSError) -> str:
    """What the machine refused, and which file it was about."""
    if error.strerror is None or error.filename is None:
        return str(error)
    where = error.filename2 or error.filename
    return f"{where}: {error.strerror[:1].lower()}{error.strerror[1:]}"


def _began(arguments: Sequence[str]) -> bool:
    """Whether the command left work beside its output that it would go on with."""
    from ..run.shards import folder_of

    output = faults.output_of(arguments)
    return _resumes() and output is not None and folder_of(output).is_dir()


def _resumes() -> bool:
    """Whether the command keeps what it has done: `run` and `judge` do."""
    return faults.command_line()[0][:1] in (["run"], ["judge"])
