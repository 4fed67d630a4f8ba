"""What `seqsweep check` finds: of a plant by driving it, of a file by reading it.

A plant that is not this package's own is driven in a child. A file is read, and nothing of it executed: what
would be, and where, is said instead.
"""

from __future__ import annotations

import ast
import platform
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from ..plant.check import Finding, check_plant
from ..plant.registry import PlantSpec, refuse_unknown_id, runs_isolated
from .child import ChildFailed, child

CHECK_S = 600.0
"""Wall time (s) that driving a plant through all its promises may take."""

SHOWN = 40
"""Variables and functions that are listed of each sort."""

INTRODUCTION_S = 60.0
"""Wall time (s) that a real-code controller may take to say what it is."""

_ASKED = "cigre:"

_CONTROLLER = ("Model_GetInfo", "Model_Outputs")


class InspectionError(ValueError):
    """A file that cannot be read for what it is."""


def findings_of(plant_id: str, parameters: Mapping[str, Any] | None = None) -> Sequence[Finding]:
    """Every promise of a plant, and whether it is kept.

    Raises
    ------
    PlantError
        If there is no such plant, or it cannot be made from these parameters.
    """
    spec = PlantSpec(plant_id, parameters or {})
    refuse_unknown_id(plant_id)
    if not runs_isolated(plant_id, None):
        return check_plant(spec.make())
    try:
        with child(spec) as asked:
            return asked.ask(check_plant, CHECK_S, f"the check took longer than {CHECK_S:g} s of wall time")
    except ChildFailed as failure:
        return [Finding("survives", False, str(failure))]


def findings_of_campaign(path: Path) -> Sequence[Finding]:
    """`findings_of` the plant of a campaign, with its parameters."""
    from .config import load_config

    section = load_config(path).plant
    return findings_of(section.id, section.parameters)


def is_inspected(what: str) -> bool:
    """Whether ``what`` names a file to read, or a controller to ask, not a plant to drive."""
    return what.startswith(_ASKED) or (Path(what).suffix.lower() in _READERS and Path(what).is_file())


def inspect(path: Path) -> str:
    """What a file holds, and what of it would be executed where it is driven.

    Raises
    ------
    ValueError
        If it is not what its name says, or unfit to be unpacked.
    """
    if str(path).startswith(_ASKED):
        return _introduction(Path(str(path).removeprefix(_ASKED)))
    return "\n".join(_READERS[path.suffix.lower()](path))


def _introduction(path: Path) -> str:
    """What a real-code controller says of itself, asked in a process of its own: it is loaded, but not stepped."""
    command = [sys.executable, "-m", "seqsweep.plant.cigre_abi", str(path)]
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
    from ..plant.fmu_archive import description_of, look_through, sha256_of

    members = look_through(path)
    content = description_of(path)
    yield f"{path}: FMI {content.fmiVersion}, model {content.modelName} {content.version or ''}".rstrip()
    yield f"  sha256 {sha256_of(path)}, from {content.generationTool or 'an unnamed tool'}"
    yield f"  {len(members)} members, {sum(m.size for m in members)} bytes unpacked; no path or link leads elsewhere"
    interface = content.coSimulation
    if interface is None:
        yield "  no co-simulation: it cannot be driven here"
        return
    how = "its own get and set" if interface.canGetAndSetFMUstate else "a fork of its process"
    yield f"  co-simulation; its states are branched by {how}"
    for causality in ("input", "output", "parameter"):
        named = [v for v in content.modelVariables if v.causality == causality]
        yield from _listed(f"{causality}s", [_variable(v) for v in named])
    libraries = [m.name for m in members if m.name.startswith("binaries/") and "/" in m.name[9:]]
    yield from _listed("would be loaded and executed, in a child process, of", libraries or ["no binary: it has none"])
    yield f'  to drive it: a campaign with [plant] id = "fmu:{path}" and [plant.parameters]; then'
    yield "  seqsweep check CAMPAIGN.toml"


def _variable(variable: Any) -> str:
    unit = f" {variable.unit}" if variable.unit else ""
    start = f" = {variable.start}" if variable.start is not None else ""
    return f"{variable.name} ({variable.type}{unit}{start})"


def _library(path: Path) -> Iterator[str]:
    from ..plant.fmu_archive import sha256_of
    from ..plant.shared_object import read_shared_object

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
    kinds = (ast.FunctionDef, ast.ClassDef)
    names = [node.name for node in tree.body if isinstance(node, kinds) and not node.name.startswith("_")]
    yield f"{path}: a Python module"
    yield from _listed("functions and classes that may be factories", names or ["none"])
    yield "  would be executed, in a child process: the whole module when it is imported, then the factory"
    yield f"  to drive it, from its folder: seqsweep check python:{path.stem}:{names[0] if names else 'FACTORY'}"


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
