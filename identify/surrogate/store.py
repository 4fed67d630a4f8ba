"""A surrogate on disk: the table it was built from, with the chosen products in the metadata.

The rows say everything else; reading fits the coefficients again, which takes milliseconds. Every reader of tables can
read the file, and sees the sweeps.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..table.read import Table, read_table
from ..table.write import write_table
from .sparse_rational import Shape
from .surrogate import Surrogate, build_surrogate


def write_surrogate(path: str | Path, surrogate: Surrogate, table: Table) -> None:
    """Write ``surrogate``, built from ``table``, atomically.

    Raises
    ------
    OSError
        If the machine refuses.
    """
    shapes = [{"numerator": m.shape.numerator, "denominator": m.shape.denominator} for m in surrogate.models]
    write_table(path, table.responses, {**table.meta, "surrogate": [_plain(shape) for shape in shapes]})


def read_surrogate(path: str | Path) -> Surrogate:
    """The surrogate of a file, or of a table, for which the products are chosen now.

    Raises
    ------
    TableError
        If the file is no table.
    SurrogateError
        If no surrogate can be built from it.
    """
    return surrogate_of(read_table(path))


def surrogate_of(table: Table) -> Surrogate:
    """The surrogate of a table that was read; with the products that stand in its metadata, if any.

    Raises
    ------
    SurrogateError
        If no surrogate can be built from it.
    """
    usable = [response for response in table.responses if response.usable.any()]
    return build_surrogate(usable, shapes=_shapes(table.meta.get("surrogate")), bases=table.meta.get("bases"))


def _plain(shape: Mapping[str, Sequence[Sequence[int]]]) -> dict[str, Any]:
    return {key: [list(index) for index in indices] for key, indices in shape.items()}


def _shapes(stored: Any) -> list[Shape] | None:
    if not stored:
        return None
    return [Shape(tuple(map(tuple, each["numerator"])), tuple(map(tuple, each["denominator"]))) for each in stored]
