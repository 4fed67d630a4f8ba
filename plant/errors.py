"""What is refused, and the words for it: every other exception that reaches the command line is a fault of ours.

A refusal says what was given, what was needed, in which unit, and the way out. It is a `SeqsweepError`,
and so a `ValueError`; the command line turns exactly that class into "the input is wrong". numpy raises
plain `ValueError` for shapes that do not fit: such a thing is a bug here, never a user's mistake.
"""

from __future__ import annotations

import difflib
import errno
from collections.abc import Iterable, Sequence

MOST_CHARACTERS = 300
"""Length of a reason: it goes over a pipe, and into a row."""

MOST_NAMES = 10
"""Names that a refusal lists; a table may hold a thousand operating points."""

_OURS = __name__.partition(".")[0]


NO_ROOM = frozenset({errno.ENOSPC, errno.EDQUOT})
"""What the system says where a disk is full: a failure of the machine, whatever was at work."""


class SeqsweepError(ValueError):
    """Something given cannot be used as it is; the message says what would be needed."""


def closest(given: str, known: Iterable[str]) -> str | None:
    """The one of ``known`` that ``given`` may have meant, if there is one."""
    folded = {name.lower(): name for name in sorted(known)}
    close = difflib.get_close_matches(given.lower(), folded, n=1)
    return folded[close[0]] if close else None


def nearest(given: str, known: Iterable[str]) -> str:
    """A hint in brackets, " (did you mean 'x'?)", where one of ``known`` is nearly ``given``; else nothing."""
    close = closest(given, known)
    return "" if close is None else f" (did you mean {close!r}?)"


def in_words(error: BaseException) -> str:
    """What an error says; its class is told, too, where the text alone may be no sentence."""
    text = " ".join(str(error).split())
    ours = type(error).__module__.startswith(f"{_OURS}.")
    is_clear = ours or isinstance(error, ValueError | ImportError | RuntimeError)
    return text if text and is_clear else f"{type(error).__name__}: {text}".rstrip(": ")


def reason_of(error: BaseException) -> str:
    """What a plant raised, as the reason of its rows: in the same words here and in a child process."""
    return in_words(error)[:MOST_CHARACTERS]


def is_without_room(error: BaseException) -> bool:
    """Whether the disk was full."""
    return isinstance(error, OSError) and error.errno in NO_ROOM


def place_of(op_id: str, known: Sequence[str], where: str, error: type[SeqsweepError] = SeqsweepError) -> int:
    """Place of an operating point among those of ``known`` names; refused, with what there is, where it is not there.

    Parameters
    ----------
    op_id : str
        The name that was asked for.
    known : sequence of str
        The names there are.
    where : str
        What holds them, such as "the table".
    error : class
        Which error says so.
    """
    if op_id in known:
        return known.index(op_id)
    hint = nearest(op_id, known) if len(known) > MOST_NAMES else ""
    names = ", ".join(known[:MOST_NAMES]) + (", ..." if len(known) > MOST_NAMES else "")
    raise error(f"no operating point {op_id!r} in {where}{hint}; it has {names}")
