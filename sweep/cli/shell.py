"""Completion scripts and the manual page, made of the command line itself: `seqsweep completion`, `seqsweep man`.

The scripts are static: a shell that completes does not start Python. What can be said of a value is taken from its
metavar: ``TABLE.parquet`` completes files of that suffix, ``pn|dq`` these two words.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Annotated, Any, NamedTuple

import typer

from .shared import EXIT_STATUSES, WrongInput
from .telling import script

SHELLS = ("bash", "zsh", "fish")


class Option(NamedTuple):
    """An option: its names, its help, whether a value follows, and what is known of the value."""

    names: tuple[str, ...]
    help: str
    metavar: str
    takes_value: bool
    words: tuple[str, ...]
    suffix: str


class Spec(NamedTuple):
    """A command: its help, its arguments as usage and suffix, its options and its epilog."""

    name: str
    help: str
    arguments: tuple[str, ...]
    suffix: str
    options: tuple[Option, ...]
    epilog: str


def completion(
    shell: Annotated[str, typer.Argument(metavar="bash|zsh|fish", help="The shell.")],
) -> None:
    """Print the completion script of a shell; commands, options, and the values that are known."""
    if shell not in SHELLS:
        raise WrongInput(f"completion {shell}: known are {', '.join(SHELLS)}")
    text = completion_script(shell)
    script(text.rstrip("\n"), lambda: {"shell": shell, "script": text})


def man() -> None:
    """Print the manual page, for man and for packagers (roff)."""
    from importlib.metadata import version

    text = manual_page(version("seqsweep"))
    script(text.rstrip("\n"), lambda: {"page": text})


def completion_script(shell: str) -> str:
    """The completion script of one of `SHELLS`."""
    return {"bash": _bash, "zsh": _zsh, "fish": _fish}[shell](specs())


def specs() -> list[Spec]:
    """Every command as the command line declares it."""
    from .main import app

    root: Any = typer.main.get_command(app)
    return [_spec(name, command) for name, command in root.commands.items() if not command.hidden]


def _spec(name: str, command: Any) -> Spec:
    arguments = [p for p in command.params if p.param_type_name == "argument"]
    options = [_option(p) for p in command.params if p.param_type_name == "option"]
    options.append(Option(("-h", "--help"), "Show this message and exit.", "", False, (), ""))
    metavars = tuple((p.metavar or str(p.name).upper()) for p in arguments)
    suffix = next((found for found in map(_suffix, metavars) if found), "")
    return Spec(name, _plain(command.help or ""), metavars, suffix, tuple(options), command.epilog or "")


def _option(parameter: Any) -> Option:
    flag = bool(getattr(parameter, "is_flag", False))
    metavar = "" if flag else (parameter.metavar or str(parameter.name).upper())
    text = _plain(getattr(parameter, "help", None) or "")
    return Option(tuple(parameter.opts), text, metavar, not flag, _words(metavar), _suffix(metavar))


def _plain(text: str) -> str:
    return " ".join(text.replace("\b", " ").split())


def _words(metavar: str) -> tuple[str, ...]:
    """``pn|dq`` as its words; nothing of ``R+jX|FILE|own``, where not every part is a word."""
    parts = metavar.split("|")
    return tuple(parts) if len(parts) > 1 and all(re.fullmatch(r"[a-z0-9_-]+", part) for part in parts) else ()


def _suffix(metavar: str) -> str:
    found = re.search(r"\.(parquet|json|toml|html)\b", metavar)
    return found.group(1) if found else ""


# bash ----------------------------------------------------------------------------------------------------------------


def _bash(commands: list[Spec]) -> str:
    names = " ".join(spec.name for spec in commands)
    return "\n".join(
        [
            "# bash completion of seqsweep, made by: seqsweep completion bash",
            "_seqsweep_files() {",
            "    local IFS=$'\\n'",
            '    COMPREPLY=($(compgen -d -- "$2") $(compgen -f -X "!*${1:+.$1}" -- "$2"))',
            "}",
            "_seqsweep() {",
            '    local current="${COMP_WORDS[COMP_CWORD]}" previous="${COMP_WORDS[COMP_CWORD-1]}" command="" word',
            '    for word in "${COMP_WORDS[@]:1:COMP_CWORD-1}"; do',
            f'        case " {names} " in *" $word "*) command="$word"; break ;; esac',
            "    done",
            "    COMPREPLY=()",
            '    case "$command $previous" in',
            *(f"        {line}" for spec in commands for line in _bash_values(spec)),
            "    esac",
            '    case "$command" in',
            f'        "") COMPREPLY=($(compgen -W "{names} --version --help" -- "$current")); return ;;',
            *(f"        {line}" for spec in commands for line in _bash_command(spec)),
            "    esac",
            "}",
            "complete -o filenames -F _seqsweep seqsweep",
            "",
        ]
    )


def _bash_values(spec: Spec) -> Iterator[str]:
    for option in spec.options:
        if not option.takes_value:
            continue
        pattern = " | ".join(f'"{spec.name} {name}"' for name in option.names)
        if option.words:
            yield f'{pattern}) COMPREPLY=($(compgen -W "{" ".join(option.words)}" -- "$current")); return ;;'
        else:
            yield f'{pattern}) _seqsweep_files "{option.suffix}" "$current"; return ;;'


def _bash_command(spec: Spec) -> Iterator[str]:
    options = " ".join(name for option in spec.options for name in option.names)
    words = _words(spec.arguments[0]) if spec.arguments else ()
    rest = f'COMPREPLY=($(compgen -W "{" ".join(words)}" -- "$current"))' if words else _bash_files(spec)
    yield f"{spec.name})"
    yield '    case "$current" in'
    yield f'        -*) COMPREPLY=($(compgen -W "{options}" -- "$current")) ;;'
    yield f"        *) {rest} ;;"
    yield "    esac ;;"


def _bash_files(spec: Spec) -> str:
    return f'_seqsweep_files "{_suffix_of_all(spec)}" "$current"'


def _suffix_of_all(spec: Spec) -> str:
    """The suffix that every argument of a command has; empty where they differ."""
    return spec.suffix if len(spec.arguments) == 1 and "RESULT" not in spec.arguments[0] else ""


# zsh -----------------------------------------------------------------------------------------------------------------


def _zsh(commands: list[Spec]) -> str:
    return "\n".join(
        [
            "#compdef seqsweep",
            "# zsh completion of seqsweep, made by: seqsweep completion zsh",
            "_seqsweep() {",
            "    local -a commands",
            "    commands=(",
            *(f"        '{spec.name}:{_quoted(first_sentence(spec.help))}'" for spec in commands),
            "    )",
            "    if (( CURRENT == 2 )); then",
            "        _describe -t commands 'seqsweep command' commands",
            "        return",
            "    fi",
            "    local command=$words[2]",
            "    shift words; (( CURRENT-- ))",
            "    case $command in",
            *(f"        {line}" for spec in commands for line in _zsh_command(spec)),
            "    esac",
            "}",
            'if [[ $zsh_eval_context[-1] == loadautofunc ]]; then _seqsweep "$@"; else compdef _seqsweep seqsweep; fi',
            "",
        ]
    )


def _zsh_command(spec: Spec) -> Iterator[str]:
    words = _words(spec.arguments[0]) if spec.arguments else ()
    yield f"{spec.name}) _arguments \\"
    for option in spec.options:
        value = f":{option.metavar.lower().replace(':', ' ')}:{_zsh_values(option.words, option.suffix)}"
        for name in option.names:
            yield f"    '*{name}[{_quoted(option.help)}]{value if option.takes_value else ''}' \\"
    if spec.arguments:
        yield f"    '*:{_quoted(spec.arguments[0])}:{_zsh_values(words, _suffix_of_all(spec))}' ;;"
    else:
        yield "    ;;"


def _zsh_values(words: tuple[str, ...], suffix: str) -> str:
    if words:
        return f"({' '.join(words)})"
    return f'_files -g "*.{suffix}"' if suffix else "_files"


def _quoted(text: str) -> str:
    """Text within the quotes of the zsh script."""
    return text.replace("'", "'\\''").replace("[", "(").replace("]", ")").replace(":", ";")


# fish ----------------------------------------------------------------------------------------------------------------


def _fish(commands: list[Spec]) -> str:
    lines = ["# fish completion of seqsweep, made by: seqsweep completion fish"]
    for spec in commands:
        what = _fish_text(first_sentence(spec.help))
        lines.append(f"complete -c seqsweep -n __fish_use_subcommand -f -a {spec.name} -d {what}")
        words = _words(spec.arguments[0]) if spec.arguments else ()
        if words:
            lines.append(f"complete -c seqsweep -n '__fish_seen_subcommand_from {spec.name}' -f -a '{' '.join(words)}'")
        lines += [_fish_option(spec.name, option) for option in spec.options]
    return "\n".join([*lines, ""])


def _fish_option(command: str, option: Option) -> str:
    names = " ".join(f"-l {n[2:]}" if n.startswith("--") else f"-s {n[1:]}" for n in option.names)
    value = f" -x -a '{' '.join(option.words)}'" if option.words else " -r" if option.takes_value else ""
    return (
        f"complete -c seqsweep -n '__fish_seen_subcommand_from {command}' {names}{value} -d {_fish_text(option.help)}"
    )


def _fish_text(text: str) -> str:
    escaped = text.replace("\\", "\\\\").replace("'", "\\'")
    return f"'{escaped}'"


def first_sentence(text: str) -> str:
    """The first sentence of a help."""
    return " ".join(re.split(r"(?<=[.?!])\s", text, maxsplit=1)[0].split())


# The manual page -----------------------------------------------------------------------------------------------------


def manual_page(version: str) -> str:
    """The manual page in roff, section 1."""
    from .main import HELP

    commands = specs()
    lines = [
        f'.TH SEQSWEEP 1 "" "seqsweep {version}" "User Commands"',
        ".SH NAME",
        "seqsweep \\- sequence admittance of grid converters, and whether they are stable",
        ".SH SYNOPSIS",
        ".B seqsweep",
        ".I COMMAND",
        "[\\fIARGUMENTS\\fR] [\\fIOPTIONS\\fR]",
        ".SH DESCRIPTION",
        _roff(HELP),
        "Results go to standard output, everything else to standard error.",
        ".SH COMMANDS",
        *(line for spec in commands for line in _roff_command(spec)),
        ".SH EXIT STATUS",
        *(line for status, text in EXIT_STATUSES.items() for line in (".TP", f".B {status}", _roff(text))),
        ".SH EXAMPLES",
        *(line for spec in commands for line in _roff_examples(spec)),
        "",
    ]
    return "\n".join(lines)


def _roff_command(spec: Spec) -> Iterator[str]:
    arguments = " ".join(f"\\fI{_roff(argument)}\\fR" for argument in spec.arguments)
    usage = f"seqsweep {spec.name} {arguments}".rstrip()
    yield f'.SS "{usage}"'
    yield _roff(spec.help)
    for option in spec.options:
        names = ", ".join(f"\\fB{_roff(name)}\\fR" for name in option.names)
        yield ".TP"
        yield names + (f" \\fI{_roff(option.metavar)}\\fR" if option.takes_value else "")
        yield _roff(option.help) or "\\&"


def _roff_examples(spec: Spec) -> Iterator[str]:
    for line in spec.epilog.replace("\b", "").splitlines():
        if line.startswith("  "):
            yield from (".PP", ".nf", _roff(line.strip()), ".fi")


def _roff(text: str) -> str:
    """Text in which roff sees no request and no hyphen that it may break or dash."""
    escaped = text.replace("\\", "\\e").replace("-", "\\-")
    return f"\\&{escaped}" if escaped.startswith((".", "'")) else escaped
