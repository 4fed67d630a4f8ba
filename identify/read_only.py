"""Facts that stay what they are: a dict that refuses to be changed, and hands out copies that may be."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NoReturn


class ReadOnly(dict[str, Any]):
    """A dict whose content cannot be changed; tables inside it are of the same kind, lists are copies.

    It pickles, goes through `json.dumps`, and ``{**it}`` or ``dict(it)`` is an ordinary dict again.
    """

    def __init__(self, content: Mapping[str, Any]):
        super().__init__({key: read_only(value) for key, value in content.items()})

    def __reduce__(self) -> tuple[type[ReadOnly], tuple[dict[str, Any]]]:
        return ReadOnly, (dict(self),)

    def _refuse(self, *given: object, **named: object) -> NoReturn:
        raise TypeError("these facts cannot be changed; make new ones: {**facts, 'key': value}")

    __setitem__ = __delitem__ = __ior__ = _refuse
    clear = pop = popitem = setdefault = update = _refuse


def read_only(value: Any) -> Any:
    """``value`` with every dict in it made `ReadOnly`; what is so already is shared, not copied."""
    if isinstance(value, ReadOnly):
        return value
    if isinstance(value, Mapping):
        return ReadOnly(value)
    return [read_only(each) for each in value] if isinstance(value, list) else value
