"""A campaign's file and overrides as plain values, and where each of them stands: messages name the place.

Nothing here knows what a campaign holds.
"""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from ...plant.errors import SeqsweepError

Keys = tuple[str | int, ...]
"""Where a value stands: ("operating_point", 0, "active_power_mw")."""

PROBLEMS_SHOWN = 20


class ConfigError(SeqsweepError):
    """A campaign that cannot be run as written.

    Attributes
    ----------
    problems : tuple of str
        All of them, each ``file:line: key: what was given; what is needed``.
    """

    def __init__(self, problems: Sequence[str]):
        self.problems = tuple(problems)
        shown = self.problems[:PROBLEMS_SHOWN]
        more = [f"... and {len(self.problems) - len(shown)} more"] if len(shown) < len(self.problems) else []
        super().__init__("\n".join([*shown, *more]))


# From the file to plain values


def read(path: Path) -> str:
    try:
        return path.read_bytes().decode("utf-8-sig")
    except FileNotFoundError:
        way_out = f"; `seqsweep init -o {path}` writes a campaign to start from" if path.parent.is_dir() else ""
        raise ConfigError([f"{path}: no such file{way_out}"]) from None
    except IsADirectoryError:
        raise ConfigError([f"{path}: is a folder; name a campaign file in it"]) from None
    except UnicodeDecodeError as error:
        line = error.object[: error.start].count(b"\n") + 1
        byte = error.object[error.start]
        raise ConfigError([f"{path}:{line}: not UTF-8 (byte 0x{byte:02x}): save the file as UTF-8"]) from None
    except OSError as error:
        raise ConfigError([f"{path}: cannot be read: {error.strerror}"]) from None


def parse(text: str, path: str | Path) -> dict[str, Any]:
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        found = re.search(r"\(at line (\d+), column \d+\)", str(error))
        line = int(found[1]) if found else text.count("\n") + 1
        what = re.sub(r" \(at .*\)$", "", str(error))
        raise ConfigError([f"{path}:{line}: not TOML: {what}"]) from None
    except RecursionError:
        raise ConfigError([f"{path}: not a campaign: nested too deeply"]) from None


_HEADER = re.compile(r"\s*(\[\[?)\s*([^\[\]=]+?)\s*\]\]?\s*(#.*)?$")
_ASSIGNMENT = re.compile(r"""\s*([\w."' -]+?)\s*=""")


def line_numbers(text: str, data: Mapping[str, Any]) -> dict[Keys, int]:
    """Line of every section and key; values inside a value are found at the line of the outer one."""
    lines: dict[Keys, int] = {}
    entries: dict[Keys, int] = {}  # arrays of tables: the entry that is being written
    section: Keys = ()
    for number, line in enumerate(text.splitlines(), start=1):
        if header := _HEADER.match(line):
            keys = _resolved((), header[2], entries)
            if header[1] == "[[":
                parent = keys[:-1] if keys[-1:] and isinstance(keys[-1], int) else keys
                entries[parent] = entries.get(parent, -1) + 1
                lines.setdefault(parent, number)
                keys = (*parent, entries[parent])
            section = keys if _exists(data, keys) else section
        elif assignment := _ASSIGNMENT.match(line):
            keys = _resolved(section, assignment[1], entries)
        else:
            continue
        if _exists(data, keys):
            lines.setdefault(keys, number)
    return lines


def _resolved(section: Keys, dotted: str, entries: Mapping[Keys, int]) -> Keys:
    keys = section
    for part in dotted.split("."):
        keys = (*keys, part.strip(" \t\"'"))
        if keys in entries:
            keys = (*keys, entries[keys])
    return keys


def _exists(data: Any, keys: Keys) -> bool:
    for key in keys:
        inside = key in data if isinstance(data, Mapping) else isinstance(data, list) and key in range(len(data))
        if not inside:
            return False
        data = data[key]
    return True


# Overrides


class Setting(NamedTuple):
    keys: Keys
    text: str


def apply(overrides: Sequence[str], data: dict[str, Any]) -> list[Setting]:
    """Put every override into ``data``, in order."""
    settings, problems = [], []
    for text in overrides:
        try:
            keys, value = _assignment(text)
            _put(data, keys, value)
            settings.append(Setting(keys, text))
        except ValueError as error:
            problems.append(f"--set {short(text)}: {error}")
    if problems:
        raise ConfigError(problems)
    return settings


def _assignment(text: str) -> tuple[Keys, Any]:
    dotted, equals, value = text.partition("=")
    parts = [part.strip() for part in dotted.split(".")]
    if not equals or not all(parts):
        raise SeqsweepError("write section.key=value, such as injection.amplitude_pu=0.002")
    try:
        parsed = tomllib.loads(f"value = {value}")
    except (tomllib.TOMLDecodeError, RecursionError):
        parsed = {}
    if set(parsed) != {"value"}:
        quoted = value.strip().strip("\"'")
        raise SeqsweepError(f"{value.strip()!r} is not a TOML value; text needs quotes: --set '{dotted}=\"{quoted}\"'")
    return tuple(int(part) if part.isdecimal() else part for part in parts), parsed["value"]


def _put(data: dict[str, Any], keys: Keys, value: Any) -> None:
    inner: Any = data
    for depth, key in enumerate(keys):
        if isinstance(inner, list) and key not in range(len(inner)):
            raise SeqsweepError(_no_entry(keys, depth, len(inner)))
        if not isinstance(inner, list | dict):
            raise SeqsweepError(f"{dotted(keys[:depth])} is {shown(inner)}, not a section")
        place: Any = str(key) if isinstance(inner, dict) else key
        if depth == len(keys) - 1:
            inner[place] = value
        elif isinstance(inner, dict):
            inner = inner.setdefault(place, {})
        else:
            inner = inner[place]


def _no_entry(keys: Keys, depth: int, count: int) -> str:
    """Why the key behind a list of so many entries names none of them."""
    name, key = dotted(keys[:depth]), keys[depth]
    if count == 0:
        return f"{name} is an empty list: there is nothing to replace"
    entries = "one entry, number 0" if count == 1 else f"{count} entries, numbers 0 to {count - 1}"
    behind = keys[depth + 1 :] if isinstance(key, int) else keys[depth:]
    return f"{name} is a list of {entries}; an entry is named by its number: {dotted((*keys[:depth], 0, *behind))}=..."


# Words


def place_of(path: str | Path, keys: Keys, lines: Mapping[Keys, int], settings: Sequence[Setting]) -> str:
    """``--set ...`` where an override is to blame, else file and line."""
    for setting in reversed(settings):
        if keys[: len(setting.keys)] == setting.keys:
            return f"--set {short(setting.text)}"
    line = line_of(keys, lines)
    return str(path) if line is None else f"{path}:{line}"


def line_of(keys: Keys, lines: Mapping[Keys, int]) -> int | None:
    """Line of the value at ``keys``, or of the nearest one around it that has a line."""
    return next((lines[keys[:end]] for end in range(len(keys), 0, -1) if keys[:end] in lines), None)


def dotted(keys: Keys) -> str:
    return ".".join(str(key) for key in keys)


def shown(value: Any) -> str:
    """``value`` about as TOML writes it, shortened."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return short(json.dumps(value, ensure_ascii=False))
    return "a table" if isinstance(value, Mapping) else short(str(value))


def short(text: str) -> str:
    return text if len(text) <= 60 else f"{text[:57]}..."
