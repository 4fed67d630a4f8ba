"""Arrow columns as NumPy arrays, through their buffers.

pyarrow's own ``to_numpy`` imports all of pandas, and its functions on lists all of its compute layer: together longer
than the rest of `seqsweep show`.
"""

from __future__ import annotations

from typing import Any

import numpy as np


def doubles(column: Any) -> np.ndarray:
    """A column of doubles without nulls as (n,) float."""
    return np.concatenate([np.empty(0), *(_buffer(chunk, float) for chunk in _chunks(column))])


def strings(column: Any) -> np.ndarray:
    """A column of strings without nulls as (n,) str."""
    return np.array(column.to_pylist(), dtype=str)


def doubles_in_lists(column: Any, length: int) -> np.ndarray | None:
    """A column of lists of doubles as (n, length) float; None where a list has another length, or a null in it."""
    parts = [_flat(chunk, length) for chunk in _chunks(column)]
    if any(part is None for part in parts):
        return None
    return np.concatenate([np.empty(0), *parts]).reshape(-1, length)


def _flat(chunk: Any, length: int) -> np.ndarray | None:
    """All elements of the lists of a chunk, (n length,); None where a list has another length, or a null in it."""
    if hasattr(chunk.type, "list_size"):
        first, size = chunk.offset * chunk.type.list_size, len(chunk) * chunk.type.list_size
    else:
        offsets = _buffer(chunk.offsets, chunk.offsets.type.to_pandas_dtype())
        if np.any(np.diff(offsets) != length):
            return None
        first, size = int(offsets[0]), int(offsets[-1] - offsets[0])
    values = chunk.values.slice(first, size)
    return None if size != len(chunk) * length or values.null_count else _buffer(values, float)


def _chunks(column: Any) -> list[Any]:
    return list(column.chunks) if hasattr(column, "chunks") else [column]


def _buffer(array: Any, dtype: Any) -> np.ndarray:
    """The numbers of an Arrow array without nulls, not copied."""
    if not len(array):
        return np.empty(0, dtype)
    width = np.dtype(dtype).itemsize
    return np.frombuffer(array.buffers()[1], dtype, count=len(array), offset=width * array.offset)
