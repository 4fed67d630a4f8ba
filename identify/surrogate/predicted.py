"""Predicted operating points as an ordinary table, so that every other command reads them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..table.read import Table
from ..table.write import write_table
from .region import AXES
from .surrogate import Surrogate


def write_predicted(path: str | Path, surrogate: Surrogate, points: Sequence[np.ndarray], table: Table) -> None:
    """Write the predictions at ``points`` (each (d,)), at the frequencies of ``table``'s first point.

    The covariance of a row holds the surrogate's error; the metadata's ``plant`` says what the rows rest on.

    Raises
    ------
    SurrogateError
        If a point is outside the swept region.
    OSError
        If the machine refuses.
    """
    f_hz = _known(surrogate, table.responses[0].f_hz)
    responses = [surrogate.response(point, f_hz) for point in points]
    meta = {key: table.meta[key] for key in ("f1_hz", "bases", "power_meaning", "configuration")}
    listed = [_entry(response.meta) for response in responses]
    source = {"predicted_from": table.meta["sha256"], "device": table.meta["plant"]}
    write_table(path, responses, {**meta, "operating_points": listed, "plant": source})


def _entry(meta: Any) -> dict[str, Any]:
    return {key: meta[key] for key in ("op_id", *AXES, "parameters") if key in meta}


def _known(surrogate: Surrogate, f_hz: np.ndarray) -> np.ndarray:
    """Of the table's frequencies those that the surrogate has."""
    nu = np.abs(f_hz - surrogate.f1_hz)
    apart = np.abs(surrogate.nu_hz[None] - nu[:, None]).min(axis=1)
    return f_hz[apart <= 1e-6 * nu]
