"""What a command says, and to whom: its result to stdout, everything else to stderr.

Every command takes two options, the same ones everywhere: ``--json`` prints the result as one JSON document in place of
text, ``--quiet`` leaves nothing on stderr but errors. A command says `result` what it found and `remark` the rest, and
knows of neither option.
"""

from __future__ import annotations

import functools
import inspect
import time
from collections.abc import Callable, Iterable, Mapping
from contextvars import ContextVar
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer

from .say import columns, say, tell

__all__ = ["columns", "is_json", "is_quiet", "plain", "remark", "result", "results", "script", "speaking"]

LONG_S = 1.0
"""A command that took longer says how long."""


class Manner(NamedTuple):
    """How this command speaks."""

    as_json: bool = False
    quiet: bool = False


_PLAINLY = Manner()
_MANNER: ContextVar[Manner] = ContextVar("manner", default=_PLAINLY)

AsJson = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]
Quiet = Annotated[bool, typer.Option("-q", "--quiet", help="Nothing on stderr but errors.")]


def result(text: str | Callable[[], str], values: Callable[[], Any]) -> None:
    """Print a result to stdout.

    Parameters
    ----------
    text : str or callable
        The result for people; a callable is asked only where text is wanted.
    values : callable
        Gives the result as plain values, asked only where JSON is wanted.
    """
    if _MANNER.get().as_json:
        import json

        typer.echo(json.dumps(plain(values()), indent=1, allow_nan=False))
    else:
        say(text if isinstance(text, str) else text())


def results(text: Callable[[], str], rows: Callable[[], Iterable[Any]]) -> None:
    """As `result`, of a list that may be long: its JSON is written row by row, and never held as a whole."""
    if not _MANNER.get().as_json:
        say(text())
        return
    import json

    empty = True
    for row in rows():
        shown = json.dumps(plain(row), indent=1, allow_nan=False).replace("\n", "\n ")
        typer.echo(("[\n " if empty else ",\n ") + shown, nl=False)
        empty = False
    typer.echo("[]" if empty else "\n]")


def script(text: str, values: Callable[[], Any]) -> None:
    """Print a result that is for a program, not for people: no line of it is folded."""
    if _MANNER.get().as_json:
        result(text, values)
    else:
        typer.echo(text)


def remark(text: str) -> None:
    """Say something that is not the result to stderr."""
    if not _MANNER.get().quiet:
        tell(text)


def is_quiet() -> bool:
    """Whether nothing but errors is wanted on stderr: progress, too, is for people."""
    return _MANNER.get().quiet


def is_json() -> bool:
    """Whether the result is wanted as JSON."""
    return _MANNER.get().as_json


def plain(value: Any) -> Any:
    """A value as JSON knows it: numbers that are not finite are null, paths are text, arrays are lists."""
    if isinstance(value, Mapping):
        return {str(key): plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(each) for each in value]
    if isinstance(value, Path):
        return str(value)
    if hasattr(value, "tolist"):  # of numpy, which is not imported here
        return plain(value.tolist())
    if isinstance(value, complex):
        return [plain(value.real), plain(value.imag)]
    if isinstance(value, float) and (value != value or value in (float("inf"), -float("inf"))):
        return None
    return value


def speaking(command: Callable[..., None], check: Callable[[Mapping[str, Any]], None]) -> Callable[..., None]:
    """The command with ``--json`` and ``--quiet``, its values checked, and at the end a line with the time it took."""
    signature = inspect.signature(command, eval_str=True)
    own = list(signature.parameters.values())
    added = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=False, annotation=kind)
        for name, kind in (("as_json", AsJson), ("quiet", Quiet))
    ]

    @functools.wraps(command)
    def told(*given: Any, as_json: bool, quiet: bool, **named: Any) -> None:
        token, begin = _MANNER.set(Manner(as_json, quiet)), time.monotonic()
        try:
            check(named)
            command(*given, **named)
        except typer.Exit:
            _close(begin)
            raise
        else:
            _close(begin)
        finally:
            _MANNER.reset(token)

    told.__signature__ = signature.replace(parameters=[*own, *added])  # type: ignore[attr-defined]
    told.__annotations__ = {each.name: each.annotation for each in [*own, *added]}
    del told.__wrapped__
    return told


def _close(begin: float) -> None:
    took = time.monotonic() - begin
    if took >= LONG_S:
        remark(f"took {in_words(took)}")


def in_words(seconds: float) -> str:
    """A time such as ``12.3 s``, ``4 min 5 s``, ``2 h 10 min``."""
    if seconds < 60.0:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    if minutes < 60:
        return f"{minutes} min {rest} s"
    return f"{minutes // 60} h {minutes % 60} min"
