"""Variables of an FMU: what a campaign says of them, held against the description, and where their values lie."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import inf, prod
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..errors import SeqsweepError, nearest
from .archive import description_of
from .versions import VERSIONS, Version

_TEXT = {"String"}
_TRUTH = {"Boolean"}
_REAL = {"Real", "Float64", "Float32"}
_WHOLE = {"Integer", "Enumeration", *(f"{sign}Int{bits}" for sign in ("", "U") for bits in (8, 16, 32, 64))}


class FmuError(SeqsweepError):
    """An FMU that cannot be driven as the campaign says, with the variable and the way out."""


class Setting(NamedTuple):
    """A variable that is set at the start: its type, its reference, its values."""

    type: str
    reference: int
    values: tuple[Any, ...]


class Group(NamedTuple):
    """Variables of one type, whose values lie one behind the other: ``n_values`` from the byte ``first`` on."""

    type: str
    references: tuple[int, ...]
    first: int
    n_values: int


class Cells(NamedTuple):
    """Where one variable lies: ``width`` values of a type, as numpy spells it, from the cell ``first`` on."""

    type: str
    first: int
    width: int


class Contents(NamedTuple):
    """An FMU for co-simulation that can be driven: where it lies, its description (fmpy's), what is in it."""

    path: Path
    description: Any
    version: int
    by_name: Mapping[str, Any]

    @property
    def spelled(self) -> Version:
        """What its version of the standard calls things."""
        return VERSIONS[self.version]

    @property
    def name(self) -> str:
        """Name and version of the model."""
        return f"{self.description.modelName} {self.description.version or ''}".strip()

    @property
    def needs(self) -> str:
        """The tool that must be there for it to run; nothing for a self-contained FMU."""
        return tool_of(self.description) if self.description.coSimulation.needsExecutionTool else ""

    @property
    def can_go_back(self) -> bool:
        """Whether it gets and sets its state."""
        return bool(self.description.coSimulation.canGetAndSetFMUstate)


def contents_of(path: Path, validate: bool) -> Contents:
    """The FMU, read without unpacking; ``validate`` as in `description_of`.

    Raises
    ------
    SeqsweepError
        If it is no FMU, or one that cannot be driven here; with the way out.
    """
    description = description_of(path, validate)
    version = int(description.fmiVersion.partition(".")[0])
    if version not in VERSIONS or description.coSimulation is None:
        kinds = [kind for kind in ("modelExchange", "coSimulation") if getattr(description, kind) is not None]
        raise FmuError(
            f"{path}: FMI {description.fmiVersion}, {' and '.join(kinds) or 'no interface'}; needed: FMI 2.0 or 3.0 "
            "for co-simulation, which most tools export on request"
        )
    from fmpy import platform, supported_platforms

    offered = supported_platforms(str(path))
    if platform not in offered:
        raise FmuError(
            f"{path}: it has binaries for {', '.join(offered) or 'no platform'}, this machine is {platform}; export it "
            "for this one, or drive it elsewhere by process:COMMAND"
        )
    return Contents(path, description, version, {variable.name: variable for variable in description.modelVariables})


def tool_of(description: Any) -> str:
    """What an FMU was made with."""
    return str(description.generationTool or "an unnamed tool")


def width_of(variable: Any) -> int:
    """Number of its values: 1, or as many as an array's fixed dimensions make."""
    return prod(variable.shape or ())


def find(contents: Contents, key: str, name: str, causality: str) -> Any:
    """The input or output called ``name``, a physical quantity.

    Raises
    ------
    FmuError
        If there is no such variable, or it is something else.
    """
    variable = _known(contents, key, name, causality)
    found = variable.causality
    if found != causality:
        raise FmuError(f"{key}: variable {name!r} of {contents.path} is an {found}; needed: an {causality}")
    _refuse_no_real(contents, key, variable)
    return variable


def find_settable(contents: Contents, key: str, name: str) -> Any:
    """The variable called ``name``, if it can be set before the start.

    Raises
    ------
    FmuError
        If there is no such variable, or it cannot.
    """
    variable = _known(contents, key, name, "")
    if variable.variability == "constant":
        raise FmuError(f"{key}: variable {name!r} of {contents.path} is a constant: no campaign can set it")
    if not is_settable(variable):
        raise FmuError(f"{key}: variable {name!r} of {contents.path}, {variable.causality}, cannot be set at the start")
    return variable


def find_power(contents: Contents, name: str) -> Any:
    """The variable called ``name``, if an operating point's power can be written there before the start."""
    variable = find_settable(contents, "active_power", name)
    _refuse_no_real(contents, "active_power", variable)
    return variable


def is_settable(variable: Any) -> bool:
    """Whether the standard lets a variable be set before initialization."""
    if variable.variability == "constant":
        return False
    return variable.causality in ("parameter", "input") or variable.initial in ("exact", "approx")


def setting(key: str, variable: Any, value: Any) -> Setting:
    """``variable`` set to ``value``: a number, a truth value or a text, or a list of an array's values.

    Raises
    ------
    FmuError
        If the variable is of another type or width, or a value is out of its range or none of its items.
    """
    values = tuple(value) if isinstance(value, list | tuple) else (value,)
    if not all(_fits(variable.type, one) for one in values):
        raise FmuError(f"{key}: variable {variable.name!r} is a {variable.type}; given {value!r}")
    if len(values) != width_of(variable):
        raise FmuError(f"{key}: variable {variable.name!r} has {width_of(variable)} values; given {value!r}")
    for one in values:
        _refuse_out_of_range(key, variable, one)
    return Setting(variable.type, variable.valueReference, values)


def _refuse_out_of_range(key: str, variable: Any, value: Any) -> None:
    """Refuse what the description rules out: an item that is not there, a number beyond its bounds."""
    if isinstance(value, bool | str):
        return
    items = getattr(variable.declaredType, "items", None) or []
    if variable.type == "Enumeration" and items and str(value) not in {item.value for item in items}:
        known = ", ".join(f"{item.value} ({item.name})" for item in items)
        raise FmuError(f"{key}: variable {variable.name!r} has the items {known}; given {value!r}")
    low, high = (_bound(variable, name) for name in ("min", "max"))
    if not low <= value <= high:
        raise FmuError(f"{key}: variable {variable.name!r} lies between {low:g} and {high:g}; given {value!r}")


def _bound(variable: Any, name: str) -> float:
    """The least or largest value of a variable, or of its declared type."""
    said = getattr(variable, name, None) or getattr(variable.declaredType, name, None)
    try:
        return float(said)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return -inf if name == "min" else inf


def laid_out(contents: Contents, variables: Sequence[Any]) -> tuple[tuple[Group, ...], dict[str, Cells]]:
    """Variables of any types in one stretch of memory, the widest types first, each type in the order given."""
    groups, cells, end = [], {}, 0
    for kind in sorted({variable.type for variable in variables}, key=lambda kind: (-_size(contents, kind), kind)):
        numpy, first = contents.spelled.types[kind].numpy, end
        own = [variable for variable in variables if variable.type == kind]
        for variable in own:
            cells[variable.name] = Cells(numpy, end // _size(contents, kind), width_of(variable))
            end += width_of(variable) * _size(contents, kind)
        n_values = (end - first) // _size(contents, kind)
        groups.append(Group(kind, tuple(variable.valueReference for variable in own), first, n_values))
    return tuple(groups), cells


def n_bytes(contents: Contents, groups: Sequence[Group]) -> int:
    """Bytes that `laid_out` takes."""
    return max((group.first + group.n_values * _size(contents, group.type) for group in groups), default=0)


def _size(contents: Contents, kind: str) -> int:
    return np.dtype(contents.spelled.types[kind].numpy).itemsize


def _known(contents: Contents, key: str, name: str, causality: str) -> Any:
    known = contents.by_name
    if name in known:
        return known[name]
    alike = [other for other, variable in known.items() if not causality or variable.causality == causality]
    hint = nearest(name, alike) or f"; it has {', '.join(alike[:12])}"
    raise FmuError(f"{key}: {contents.path} has no variable {name!r}{hint}")


def _refuse_no_real(contents: Contents, key: str, variable: Any) -> None:
    needed = contents.spelled.real
    if variable.type != needed:
        raise FmuError(f"{key}: variable {variable.name!r} of {contents.path} is a {variable.type}; needed: a {needed}")


def _fits(kind: str, value: Any) -> bool:
    if kind in _TRUTH or kind in _TEXT:
        return isinstance(value, bool if kind in _TRUTH else str)
    if isinstance(value, bool):
        return False
    return isinstance(value, int) if kind in _WHOLE else kind in _REAL and isinstance(value, int | float)
