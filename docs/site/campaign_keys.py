"""The page of a campaign's keys: every section and key that the program accepts, from the sections themselves."""

from __future__ import annotations

import re
from collections.abc import Iterator
from importlib.resources import files
from types import UnionType
from typing import Any, Union, get_args, get_origin

from command_line import cell
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from seqsweep.sweep.config.sections import Config

HEAD = """# Keys of a campaign

A campaign is a TOML file. This page lists every section and every key that `seqsweep run` accepts, made from the
sections of the program itself. A key that is not here is refused with the nearest one that is. `seqsweep init` writes a
campaign in which the usual keys are explained; `--set section.key=value` overrides one for one run.

Operating points are either listed as `[[operating_point]]` (one section each), or named as a region by
`[sweep.operating_points]`. Each listed point has either `terminal_voltage_pu`, or a `grid = { ... }` on which the load
flow of the black box decides the voltage.

"""

EXAMPLE = """
```toml
[campaign]
name = "weak grid"

[plant]
id = "dpmsg-v1"

[[operating_point]]
id = "p065"
active_power_mw = 0.65
grid = { r_ohm = 0.012, x_ohm = 0.25, voltage_pu = 1.0, scale = 1.2 }

[sweep]
f_min_hz = 1.0
f_max_hz = 1000.0
points = 100
```

"""


def page() -> str:
    """The page as Markdown."""
    return HEAD + EXAMPLE.lstrip() + "\n".join(_sections(Config, ""))


def keys() -> Iterator[str]:
    """Every key, dotted, as ``sweep.points`` or ``operating_point.grid.voltage_pu``."""
    yield from _keys(Config, "")


def _keys(model: type[BaseModel], prefix: str) -> Iterator[str]:
    for name, field in model.model_fields.items():
        yield f"{prefix}{name}"
        if inner := _model_of(field.annotation):
            yield from _keys(inner, f"{prefix}{name}.")


def _sections(model: type[BaseModel], prefix: str) -> Iterator[str]:
    inner = {name: found for name, field in model.model_fields.items() if (found := _model_of(field.annotation))}
    plain = {name: field for name, field in model.model_fields.items() if name not in inner or prefix}
    if prefix:
        yield _section(model, prefix, plain)
    for name, found in inner.items():
        yield from _sections(found, f"{prefix}{name}.")


def _section(model: type[BaseModel], prefix: str, fields: dict[str, FieldInfo]) -> str:
    name = prefix.rstrip(".")
    rows = "".join(_row(name, key, field) for key, field in fields.items())
    what = " ".join((model.__doc__ or "").replace("``", "`").split())
    return (
        f"## {_title(name)}\n\n{what}\n\n| key | what is needed | default | what it means |\n|---|---|---|---|\n{rows}"
    )


def _title(name: str) -> str:
    """The head as TOML writes the section."""
    if name == "operating_point":
        return "[[operating_point]]"
    parent, _, last = name.rpartition(".")
    if parent and name != "sweep.operating_points":
        shown = f"[[{parent}]]" if parent == "operating_point" else f"[{parent}]"
        return f"{last} = {{ ... }} in {shown}"
    return f"[{name}]"


def _row(section: str, key: str, field: FieldInfo) -> str:
    meaning = _meanings().get((section, key), "")
    return f"| `{key}` | {cell(field.description or '')} | {_default(field)} | {cell(meaning)} |\n"


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "needed"
    return "-" if field.default in (None, {}, ()) else f"`{_toml(field.default)}`"


def _toml(value: Any) -> str:
    return f'"{value}"' if isinstance(value, str) else str(value)


def _model_of(annotation: Any) -> type[BaseModel] | None:
    """The section within an annotation, or None."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    if get_origin(annotation) in (Union, UnionType, tuple):
        return next((found for part in get_args(annotation) if (found := _model_of(part))), None)
    return next((found for part in get_args(annotation)[:1] if (found := _model_of(part))), None)


def _meanings() -> dict[tuple[str, str], str]:
    """What the template says of each key, by section and key."""
    found: dict[tuple[str, str], str] = {}
    section = ""
    for line in files("seqsweep.sweep.config").joinpath("template.toml").read_text("utf-8").splitlines():
        if head := re.match(r"#? ?\[\[?([\w.]+)\]\]?", line):
            section = head[1]
        elif key := re.match(r"#? ?(\w+) = [^#]*# (.*)", line):
            found[section, key[1]] = key[2]
    return found
