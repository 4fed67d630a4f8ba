"""The admittance table: its format, reading, writing and validation."""

from __future__ import annotations

from importlib import import_module
from typing import Any

_ROOMS = {
    "Table": "read",
    "iter_responses": "read",
    "read_metadata": "read",
    "read_table": "read",
    "validate_table": "read",
    "TableError": "format",
    "write_table": "write",
}

__all__ = sorted(_ROOMS)


def __getattr__(name: str) -> Any:
    if name not in _ROOMS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_ROOMS[name]}"), name)
