"""Rows that are left out on purpose, visibly: bands of frequency that somebody knows to be wrong."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import isfinite
from typing import NamedTuple

import numpy as np

from ..plant.errors import SeqsweepError
from .response import FrequencyResponse


class Band(NamedTuple):
    """Frequencies from ``low_hz`` to ``high_hz``, both included (Hz, pn frame)."""

    low_hz: float
    high_hz: float


def parse_bands(texts: Sequence[str]) -> tuple[Band, ...]:
    """Bands from texts such as ``50-70`` or ``150`` (Hz); several may stand in one, separated by commas.

    Raises
    ------
    SeqsweepError
        If one is no frequency and no band.
    """
    return tuple(_band(part.strip()) for text in texts for part in text.split(","))


def _band(text: str) -> Band:
    low, dash, high = text.partition("-")
    try:
        band = Band(float(low), float(high if dash else low))
    except ValueError:
        band = Band(float("nan"), float("nan"))
    if not (isfinite(band.low_hz) and isfinite(band.high_hz) and 0.0 <= band.low_hz <= band.high_hz):
        raise SeqsweepError(f"--exclude {text!r}: needed is a frequency or a band in Hz, such as 150 or 50-70")
    return band


def without_bands(response: FrequencyResponse, bands: Sequence[Band]) -> FrequencyResponse:
    """The response with the rows in ``bands`` marked, so that nothing is learnt from them; they stay in sight.

    A band applies to the frequency of a row, not to its mirror.
    """
    f_hz = np.asarray(response.f_hz)
    inside = np.zeros(len(f_hz), dtype=bool)
    for band in bands:
        inside |= (f_hz >= band.low_hz) & (f_hz <= band.high_hz)
    status = np.where(inside, "failed", np.asarray(response.status))
    reason = np.where(inside, EXCLUDED, np.asarray(response.reason))
    return replace(response, status=status, reason=reason)


EXCLUDED = "left out as asked (--exclude)"
"""Reason of a row that was left out on purpose."""


def excluded(response: FrequencyResponse) -> np.ndarray:
    """(n,) bool: rows that were left out on purpose."""
    return np.asarray(response.reason) == EXCLUDED
