"""Pages of what is written: columns of the table, files of JSON, names in Python; from the program itself."""

from __future__ import annotations

import json
from collections.abc import Iterator
from importlib import import_module
from importlib.resources import files
from typing import Any

from command_line import cell

import seqsweep
from seqsweep.identify.table.format import COLUMNS, FORMAT, VERSION
from seqsweep.plant.registry import registered_ids

SCHEMAS = ("identify", "tuning", "sweep")
"""Floors that have JSON schemas."""


def columns_page() -> str:
    """Columns and metadata of the table."""
    rows = "".join(f"| `{c.name}` | {c.kind} | {c.unit or '-'} |\n" for c in COLUMNS)
    schema = _schema("identify", f"{FORMAT}-1.schema.json")
    return (
        f"# Columns and metadata of the table\n\n"
        f"The format is `{FORMAT}` {VERSION}. [The table](../table-format.md) says what every column means and what a "
        f"conforming table must satisfy; this page is made from the program and lists them.\n\n"
        f"## Columns\n\n| column | kind | unit |\n|---|---|---|\n{rows}\n"
        f"## Metadata\n\nThe key `seqsweep` of the file's metadata holds JSON:\n\n{_properties(schema)}"
    )


def json_page() -> str:
    """Every file of JSON that a command writes or reads."""
    sections = [_json_section(floor, name) for floor in SCHEMAS for name in _names(floor)]
    return (
        "# Files of JSON\n\nWhat commands write with `-o` and read again, made from the JSON schemas that stand "
        "beside the code. No number is ever infinite or NaN: it is null, and a reason stands beside it.\n\n"
        + "\n".join(sections)
    )


def _names(floor: str) -> list[str]:
    folder = files(f"seqsweep.{floor}").joinpath("schema")
    return sorted(entry.name for entry in folder.iterdir() if entry.name.endswith(".schema.json"))


def _schema(floor: str, name: str) -> dict[str, Any]:
    read: dict[str, Any] = json.loads(files(f"seqsweep.{floor}").joinpath("schema", name).read_text("utf-8"))
    return read


def _json_section(floor: str, name: str) -> str:
    schema = _schema(floor, name)
    kind = name.removesuffix(".schema.json")
    return f"## {kind}\n\n{schema.get('title', '')}. Schema: `{floor}/schema/{name}`.\n\n{_properties(schema)}"


def _properties(schema: dict[str, Any]) -> str:
    rows = "".join(f"| `{name}` | {kind} | {cell(text)} |\n" for name, kind, text in _walk(schema, schema, ""))
    return f"| key | kind | what it is |\n|---|---|---|\n{rows}"


def _walk(part: dict[str, Any], whole: dict[str, Any], prefix: str, depth: int = 0) -> Iterator[tuple[str, str, str]]:
    """Keys of a schema in depth, ``a.b`` for keys of objects and ``a[].b`` for those of lists of objects."""
    for name, entry in part.get("properties", {}).items():
        inner = _resolved(entry, whole)
        yield f"{prefix}{name}", _kind(inner), entry.get("description", inner.get("description", ""))
        items = _resolved(inner.get("items", {}), whole) if isinstance(inner.get("items"), dict) else {}
        if depth < 3:
            yield from _walk(inner, whole, f"{prefix}{name}.", depth + 1)
            yield from _walk(items, whole, f"{prefix}{name}[].", depth + 1)


def _resolved(entry: dict[str, Any], whole: dict[str, Any]) -> dict[str, Any]:
    target: Any = whole
    for step in entry.get("$ref", "#").split("/")[1:]:
        target = target[step]
    return entry if target is whole else target


def _kind(entry: dict[str, Any]) -> str:
    if "const" in entry:
        return f"`{json.dumps(entry['const'])}`"
    if "enum" in entry:
        return " or ".join(f"`{json.dumps(value)}`" for value in entry["enum"])
    kind = entry.get("type", "any")
    return kind if isinstance(kind, str) else " or ".join(kind)


API_HEAD = """# In Python: every name

`import seqsweep as ss` gives these names. [In Python and in notebooks](../python.md) shows them at work; this page is
made from their docstrings.

"""

OBJECTS = ("Campaign", "FrequencyResponse", "Table", "Surrogate")
"""Classes whose methods are listed."""


def api_page() -> str:
    """Every name of the face with its docstring."""
    names = [name for name in seqsweep.__all__ if not name.startswith("__")]
    plants = ", ".join(f"`{name}`" for name in registered_ids())
    return API_HEAD + f"Devices that come with it: {plants}.\n\n" + "\n".join(map(_object, names))


def _object(name: str) -> str:
    home = f"seqsweep.{seqsweep._HOME[name]}"
    found = getattr(import_module(home), name)
    if not isinstance(found, type):
        return f"## {name}\n\n```{{eval-rst}}\n.. autofunction:: {home}.{name}\n```\n"
    members = "\n   :members:" if name in OBJECTS else ""
    return f"## {name}\n\n```{{eval-rst}}\n.. autoclass:: {home}.{name}{members}\n```\n"
