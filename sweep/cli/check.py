"""What `seqsweep check` finds: of a plant by driving it, of a file by reading it.

A plant that is not this package's own is driven in a child. A file is read, and nothing of it executed: what
would be, and where, is said instead.
"""

from __future__ import annotations

import ast
import os
import platform
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from ...plant.check import Finding, check_plant
from ...plant.errors import SeqsweepError
from ...plant.registry import PlantSpec
from ..run.child import ChildFailed
from ..run.host import host_named

CHECK_S = 600.0
"""Wall time (s) that driving a plant through all its promises may take."""

SHOWN = 40
"""Variables and functions that are listed of each sort."""

INTRODUCTION_S = 60.0
"""Wall time (s) that a real-code controller may take to say what it is."""

_ASKED = "cigre:"

_HOLDERS = ".fmu, .so, .dll, .py, a campaign .toml"

_CALLED = (ast.FunctionDef, ast.ClassDef)

_CONTROLLER = ("Model_GetInfo", "Model_Outputs")


class InspectionError(SeqsweepError):
    """A file that cannot be read for what it is."""


def findings_of(plant_id: str, parameters: Mapping[str, Any] | None = None) -> Sequence[Finding]:
    """Every promise of a plant, and whether it is kept.

    Raises
    ------
    PlantError
        If there is no such plant, or it cannot be made from these parameters.
    """
    spec = PlantSpec(plant_id, parameters or {})
    kind, _, rest = plant_id.partition(":")
    if kind == "fmu" and rest:
        _refuse_no_file(Path(rest))
    try:
        return host_named(spec).ask(check_plant, CHECK_S, f"the check took longer than {CHECK_S:g} s of wall time")
    except ChildFailed as failure:
        return [Finding("survives", False, str(failure))]


def findings_of_campaign(path: Path) -> Sequence[Finding]:
    """`findings_of` the plant of a campaign, with its parameters."""
    from ..config.sections import load_config

    section = load_config(path).plant
    return findings_of(section.id, section.parameters)


def is_inspected(what: str) -> bool:
    """Whether ``what`` names a file to read, or a controller to ask, not a plant or a campaign to drive."""
    head, colon, _ = what.partition(":")
    if what.startswith(_ASKED):
        return True
    path = Path(what)
    if (colon and not _separated(head)) or what.endswith(".toml"):
        return False
    return _separated(what) or path.suffix.lower() in _READERS or ("." in what and path.exists())


def _separated(text: str) -> bool:
    return any(separator in text for separator in (os.sep, os.altsep) if separator)


def _refuse_no_file(path: Path) -> None:
    if path.is_dir():
        raise InspectionError(f"{path} is a folder; needed: a file that could hold a plant ({_HOLDERS})")
    if not path.is_file():
        raise InspectionError(f"{path}: no such file")


def inspect(path: Path) -> str:
    """What a file holds, and what of it would be executed where it is driven.

    Raises
    ------
    SeqsweepError
        If there is no such file, or it is not what its name says, or unfit to be unpacked.
    """
    if str(path).startswith(_ASKED):
        return _introduction(Path(str(path).removeprefix(_ASKED)))
    _refuse_no_file(path)
    if path.suffix.lower() not in _READERS:
        raise InspectionError(f"{path} is no file that could hold a plant ({_HOLDERS})")
    return "\n".join(_READERS[path.suffix.lower()](path))


def _introduction(path: Path) -> str:
    """What a real-code controller says of itself, asked in a process of its own: it is loaded, but not stepped."""
    return asked(path, "seqsweep.plant.controllers.cigre_abi")


def asked(path: Path, module: str) -> str:
    """What ``module`` prints of a library, in a process of its own that may die of it.

    Raises
    ------
    InspectionError
        If it dies, takes too long or refuses.
    """
    command = [sys.executable, "-m", module, str(path)]
    try:
        done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=INTRODUCTION_S)
    except subprocess.TimeoutExpired:
        raise InspectionError(f"{path} took longer than {INTRODUCTION_S:g} s to say what it is") from None
    if done.returncode:
        words = done.stderr.strip().splitlines()
        ending = f"signal {-done.returncode}" if done.returncode < 0 else f"exit status {done.returncode}"
        raise InspectionError(
            words[-1] if words and done.returncode == 2 else f"{path} cannot say what it is: {ending}"
        )
    return done.stdout.rstrip()


def _fmu(path: Path) -> Iterator[str]:
    from ...plant.fmu.archive import complaint_of, description_of, look_through, sha256_of
    from ...plant.fmu.variables import tool_of

    members, complaint = look_through(path), complaint_of(path)
    content = description_of(path, validate=False)
    yield f"{path}: FMI {content.fmiVersion}, model {content.modelName} {content.version or ''}".rstrip()
    yield f"  sha256 {sha256_of(path)}, from {tool_of(content)}"
    yield f"  {len(members)} members, {sum(m.size for m in members)} bytes unpacked; no path or link leads elsewhere"
    if complaint:
        yield f"  {complaint}"
    interface = content.coSimulation
    if interface is None:
        yield "  no co-simulation: it cannot be driven here; most tools export it for co-simulation on request"
        return
    how = "its own get and set" if interface.canGetAndSetFMUstate else "a fork of its process"
    yield f"  co-simulation; its states are branched by {how}"
    if interface.needsExecutionTool:
        yield f"  it runs only where {tool_of(content)} is installed or running; a self-contained export needs nothing"
    for causality in ("input", "output", "parameter"):
        named = [v for v in content.modelVariables if v.causality == causality]
        yield from _listed(f"{causality}s", [_variable(v) for v in named])
    from fmpy import platform as ours
    from fmpy import platform_tuple

    binaries = [m.name for m in members if m.name.startswith("binaries/") and "/" in m.name[9:]]
    libraries = [name for name in binaries if name.split("/")[1] in (ours, platform_tuple)]
    if not libraries:
        yield from _listed("binaries", binaries or ["none"])
        yield f"  none is for this machine ({ours}): export it for this one, or drive it elsewhere by process:COMMAND"
        return
    yield from _listed("would be loaded and executed, in a child process, of", libraries)
    yield f'  to drive it: a campaign with [plant] id = "fmu:{path}", or, if it is a controller for the turbine\'s'
    yield f'  circuit, id = "dpmsg-grey-v1", controller = "fmu:{path}", and [plant.parameters]; then'
    yield "  seqsweep check CAMPAIGN.toml"


def _variable(variable: Any) -> str:
    unit = f" {variable.unit}" if variable.unit else ""
    start = f" = {variable.start}" if variable.start is not None else ""
    return f"{variable.name} ({variable.type}{unit}{start})"


def _library(path: Path) -> Iterator[str]:
    from ...plant.controllers.shared_object import read_shared_object
    from ...plant.fmu.archive import sha256_of

    content = read_shared_object(path)
    yield f"{path}: {content.kind} for {content.machine}, this machine is {platform.machine()}"
    yield f"  sha256 {sha256_of(path)}"
    if content.kind != "ELF" or content.machine != platform.machine():
        yield "  it cannot be loaded here; a program that loads it elsewhere, or under wine, can speak for it:"
        yield "  process:COMMAND"
        return
    missing = [name for name in _CONTROLLER if name not in content.functions]
    yield from _listed("exports", content.functions or ["nothing"])
    if missing:
        yield f"  no IEEE/CIGRE real-code controller: it lacks {', '.join(missing)}"
    else:
        yield "  an IEEE/CIGRE real-code controller (TB 958), by its names; for its ports and parameters it is"
        yield f"  asked, in a child process, by: seqsweep check cigre:{path}"
    yield "  would be executed, in a child process: its initialisers when it is loaded, then these functions"


def _module(path: Path) -> Iterator[str]:
    try:
        tree = ast.parse(path.read_bytes(), str(path))
    except (SyntaxError, ValueError) as error:
        raise InspectionError(f"{path}: not Python: {error}") from None
    public = [node for node in tree.body if isinstance(node, _CALLED) and not node.name.startswith("_")]
    classes = {node.name: node for node in tree.body if isinstance(node, ast.ClassDef)}
    factories = [node.name for node in public if _is_called_bare(node, classes)]
    others = [node.name for node in public if node.name not in factories]
    yield f"{path}: a Python module"
    yield from _listed(
        "functions and classes that may be factories", factories or ["none without parameters" if others else "none"]
    )
    yield from _listed("functions and classes that need parameters, or may", others)
    yield "  would be executed, in a child process: the whole module when it is imported, then the factory"
    suggested = [name for name in factories if name != "main"]
    if suggested:
        yield f"  to drive it, from its folder: seqsweep check python:{path.stem}:{suggested[0]}"
    else:
        yield f'  to drive it: a campaign with [plant] id = "python:{path.stem}:FACTORY" and [plant.parameters], in its'
        yield "  folder; then seqsweep check CAMPAIGN.toml. A program that speaks frames is process:COMMAND instead"


def _is_called_bare(node: ast.FunctionDef | ast.ClassDef, classes: Mapping[str, ast.ClassDef]) -> bool:
    """Whether the source says that it can be called without arguments; a base from elsewhere says nothing."""
    if isinstance(node, ast.FunctionDef):
        return _n_required(node.args) == 0
    for inner in node.body:
        if isinstance(inner, ast.FunctionDef) and inner.name == "__init__":
            return _n_required(inner.args) <= 1
    fields = [inner for inner in node.body if isinstance(inner, ast.AnnAssign) and inner.value is None]
    if node.decorator_list and fields:
        return False
    others = {name: other for name, other in classes.items() if name != node.name}
    return not node.keywords and all(
        isinstance(base, ast.Name) and base.id in others and _is_called_bare(others[base.id], others)
        for base in node.bases
    )


def _n_required(arguments: ast.arguments) -> int:
    """Number of arguments without a default, a method's first included."""
    positional = len(arguments.posonlyargs) + len(arguments.args) - len(arguments.defaults)
    return positional + sum(default is None for default in arguments.kw_defaults)


def _listed(title: str, names: Sequence[str]) -> Iterator[str]:
    more = f", ... and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
    if names:
        yield f"  {title}: {', '.join(names[:SHOWN])}{more}"


_READERS: dict[str, Callable[[Path], Iterator[str]]] = {
    ".fmu": _fmu,
    ".so": _library,
    ".dll": _library,
    ".py": _module,
}
