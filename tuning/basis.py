"""What the judgement of a device rests on besides its fit: the rows it believes, and what is proved."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ..identify.fit.rational import RationalModel
from ..identify.response import FrequencyResponse
from ..identify.uncertainty import relative_uncertainty
from .anchor import Anchor, open_mode
from .rows import Rows, believed, misfits

MAX_MISFIT = 0.03
"""Median relative misfit beyond which a fit is not believed."""


class Basis(NamedTuple):
    """What the judgement of a device rests on.

    Attributes
    ----------
    rows : Rows
        The rows of its table that the fit believes.
    anchor : Anchor
        What is proved of it, with the slow mode of its own that the rows decide the least.
    problem : str
        Why the fit cannot be used; empty where it can.
    """

    rows: Rows
    anchor: Anchor
    problem: str


def basis_of(response: FrequencyResponse, rows: Rows, anchor: Anchor, model: RationalModel) -> Basis:
    """Rows and proof of a response held against the fit of it."""
    misfit = float(np.median(misfits(rows.data, model)))
    bad = misfit > acceptable_misfit(response)
    problem = f"no rational model describes the table: its median misfit is {misfit:.1%}" if bad else ""
    kept = believed(rows, model)
    return Basis(kept, replace(anchor, still_open=open_mode(model, anchor, kept)), problem)


def acceptable_misfit(response: FrequencyResponse) -> float:
    """`MAX_MISFIT`, or twice what the rows themselves say of their errors."""
    stated = relative_uncertainty(response)[response.usable]
    stated = stated[np.isfinite(stated)]
    return max(MAX_MISFIT, 2.0 * float(np.median(stated))) if len(stated) else MAX_MISFIT
