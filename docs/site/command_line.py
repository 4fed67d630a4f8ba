"""The page of the command line: every command with every option, from the program that runs them."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import typer

from seqsweep.sweep.cli.main import app

HEAD = """# The command line

Every command with every option, as the program itself declares them. `seqsweep COMMAND --help` prints the same.
What a command answers line by line is on the page [what every printed line means](../glossary.md), and what its exit
status says on [exit statuses](../exit-statuses.md).

| command | what it does |
|---|---|
"""

_KINDS = {float: "NUMBER", int: "N", Path: "FILE"}


def page() -> str:
    """The page as Markdown."""
    root: Any = typer.main.get_command(app)
    commands = {name: command for name, command in root.commands.items() if not command.hidden}
    rows = "".join(f"| [`seqsweep {name}`](#{anchor(name)}) | {cell(_first(c))} |\n" for name, c in commands.items())
    sections = "\n".join(_section(name, command) for name, command in commands.items())
    own = "\n## seqsweep without a command\n\n" + _table(root.params)
    return f"{HEAD}{rows}\n{sections}{own}"


def anchor(name: str) -> str:
    """The anchor of a command's section."""
    return f"seqsweep-{name}"


def cell(text: str) -> str:
    """Text as it may stand in a cell of a table."""
    return " ".join(text.split()).replace("|", "\\|").replace("<", "&lt;")


def _first(command: Any) -> str:
    return (command.help or "").strip().split("\n\n")[0]


def _section(name: str, command: Any) -> str:
    shown = [p for p in command.params if not getattr(p, "hidden", False)]
    arguments = " ".join(_usage(p) for p in shown if p.param_type_name == "argument")
    needed = " ".join(f"{p.opts[0]} {metavar(p)}" for p in shown if p.param_type_name == "option" and p.required)
    usage = " ".join(part for part in ("seqsweep", name, arguments, needed, "[OPTIONS]") if part)
    words = f"{_prose(command.help or '')}\n\n{_table(shown)}\n{_examples(command.epilog or '')}"
    return f"## seqsweep {name}\n\n    {usage}\n\n{words}"


def _examples(epilog: str) -> str:
    """Examples of a command and the page that it names, from what stands below its help."""
    examples = "".join(f"    {line.strip()}\n" for line in epilog.splitlines() if line.startswith("  "))
    page = re.search(r"More: docs/(\S+)\.md", epilog)
    more = f"More: [{page[1]}](../{page[1]}.md).\n" if page else ""
    return f"{examples}\n{more}" if examples else more


def _prose(text: str) -> str:
    """Help as Markdown: the paragraphs as they stand; what is laid out in columns stays so."""
    return "\n\n".join(_paragraph(part) for part in text.replace("\b", "").strip("\n").split("\n\n"))


def _paragraph(text: str) -> str:
    lines = text.strip("\n").splitlines()
    if any(line.startswith("  ") for line in lines):
        return "```\n" + "\n".join(lines) + "\n```"
    return " ".join(line.strip() for line in lines)


def _usage(parameter: Any) -> str:
    name = metavar(parameter)
    return name if parameter.required else f"[{name}]"


def metavar(parameter: Any) -> str:
    """What stands for the value: FILE, HZ-HZ, the choices, or the kind."""
    if parameter.metavar:
        return str(parameter.metavar)
    annotation = parameter.type_descriptor.annotation
    if get_origin(annotation) is Literal:
        return "|".join(str(choice) for choice in get_args(annotation))
    return _KINDS.get(annotation, str(parameter.name).upper())


def _table(parameters: Any) -> str:
    rows = "".join(f"| {' '.join(line)} |\n".replace("  ", " ") for line in map(_row, parameters))
    return f"| argument or option | default | what it means |\n|---|---|---|\n{rows}"


def _row(parameter: Any) -> Iterator[str]:
    flag = getattr(parameter, "is_flag", False)
    if parameter.param_type_name == "argument":
        names = f"`{metavar(parameter)}`"
    else:
        opts = [*parameter.opts, *parameter.secondary_opts]
        names = ", ".join(f"`{opt}`" for opt in opts) + ("" if flag else f" `{metavar(parameter)}`")
    yield cell(names)
    yield f"| {default_of(parameter)} |"
    yield cell(getattr(parameter, "help", None) or "")


def default_of(parameter: Any) -> str:
    """The default as it is told; the number of cores is this machine's and is named instead."""
    if parameter.required:
        return "needed"
    value = parameter.default
    if parameter.name == "jobs":
        return "all cores" if value else "-"
    if value is None or value is False or callable(value) or value in ((), [], ""):
        return "-"
    return "on" if value is True else f"`{value}`"
