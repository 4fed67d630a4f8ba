"""An adaptive grid in rounds: from places |f - f1| to coherent points, and from the last verdict to words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any

import numpy as np

from ...identify.fit.adaptive import APART_HZ, NOISE_MARGIN, Verdict, band_of, first_places
from .frequencies import GENERATED_SHIFT, MAX_WINDOW_S, Block, Frequency, GridError, check_band, exact_or_nearby, nearby

PLACE_SHIFT = 0.03
"""Largest move of a wanted place to where the window is shorter, relative to |f - f1|."""


@dataclass(frozen=True, slots=True)
class Adaptive:
    """What an adaptive sweep is asked for.

    Attributes
    ----------
    f_min_hz, f_max_hz : float
        Band (Hz).
    most_points : int
        Rows at which it gives up.
    tolerance : float
        Interpolation error ||dY||_F / ||Y||_F to certify.
    """

    f_min_hz: float
    f_max_hz: float
    most_points: int
    tolerance: float

    def band_hz(self, f1_hz: float) -> tuple[float, float]:
        """Range of |f - f1| (Hz)."""
        return band_of(self.f_min_hz, self.f_max_hz, f1_hz)


def first_round(asked: Adaptive, f1_hz: float, dt_s: float, block: Block) -> list[Frequency]:
    """Both ends of the band and places between them, ascending in frequency.

    Raises
    ------
    GridError
        If the band is unusable, or holds no second point.
    """
    check_band(np.array([asked.f_min_hz, asked.f_max_hz]), f1_hz, dt_s)
    try:
        places = first_places(asked.band_hz(f1_hz))
    except ValueError as error:
        raise GridError(str(error)) from None
    room_hz = GENERATED_SHIFT * (asked.f_max_hz - asked.f_min_hz)
    ends = [exact_or_nearby(f, min(room_hz, PLACE_SHIFT * f), f1_hz, block) for f in (asked.f_min_hz, asked.f_max_hz)]
    points = [end for end in ends if end is not None]
    return sorted([*points, *next_round(places, points, asked, f1_hz, block)], key=lambda point: point.f_hz)


def next_round(
    nu_hz: Sequence[float] | np.ndarray, points: Sequence[Frequency], asked: Adaptive, f1_hz: float, block: Block
) -> list[Frequency]:
    """Points near the places ``nu_hz`` = |f - f1| (Hz), none of which ``points`` serve already.

    A place is served from either side of f1; where the band has both, the side with fewer points is taken, so that
    a table can be read on both.
    """
    found: list[Frequency] = []
    for nu in nu_hz:
        taken = [*points, *found]
        if len(taken) >= asked.most_points:
            break
        nearest = min((abs(abs(p.f_hz - f1_hz) - nu) for p in taken), default=np.inf)
        if nearest < APART_HZ:
            continue
        move_hz = max(min(GENERATED_SHIFT * nearest, PLACE_SHIFT * nu), 0.5 / MAX_WINDOW_S)
        point = nearby(_side(nu, taken, asked, f1_hz), move_hz, f1_hz, block)
        if point is not None and asked.f_min_hz <= point.f_hz <= asked.f_max_hz:
            found.append(point)
    return found


def _side(nu: float, points: Sequence[Frequency], asked: Adaptive, f1_hz: float) -> float:
    """f1 + nu or f1 - nu (Hz), whichever is in the band."""
    above, below = f1_hz + nu, f1_hz - nu
    if below < asked.f_min_hz:
        return above
    if above > asked.f_max_hz:
        return below
    n_below = sum(point.f_hz < f1_hz for point in points)
    n_above = sum(f1_hz < point.f_hz <= 2.0 * f1_hz - asked.f_min_hz for point in points)
    return below if n_below < n_above else above


# What is said about it in the end


def certificate(verdict: Verdict, asked: Adaptive, f1_hz: float, n_rounds: int) -> dict[str, Any]:
    """The verdict as the table's metadata holds it; null stands for what is not known."""
    low_hz, _ = asked.band_hz(f1_hz)
    inside = asked.f_min_hz < f1_hz < asked.f_max_hz
    return {
        "certified": verdict.state == "certified",
        "tolerance": verdict.goal,
        "error": _known(verdict.error),
        "error_at_offset_hz": _known(verdict.at_hz),
        "fresh_error": _known(verdict.fresh_error),
        "fresh_points": verdict.n_fresh,
        "noise": _known(verdict.noise),
        "order": verdict.order,
        "rounds": n_rounds,
        "band_hz": [asked.f_min_hz, asked.f_max_hz],
        "except_within_hz_of_f1": low_hz if inside else None,
    }


def certificate_text(entry: dict[str, Any], f1_hz: float) -> str:
    """A certificate in words."""
    if entry["certified"]:
        checked = f"at {entry['fresh_points']} fresh points it was {entry['fresh_error']:.2g}"
        goal = f"{entry['tolerance']:.2g} " + ("is what the noise allows" if _limited_by_noise(entry) else "asked")
        return f"interpolation error certified to {entry['error']:.2g} ({goal}); {checked}"
    if entry["error"] is None:
        return f"interpolation not certified to {entry['tolerance']:.2g}: too few rows are usable"
    nu = entry["error_at_offset_hz"]
    return (
        f"interpolation not certified to {entry['tolerance']:.2g}: the error may reach {entry['error']:.2g} near "
        f"{f1_hz:g} +- {nu:.4g} Hz (raise sweep.points or sweep.interpolation_tolerance)"
    )


def _limited_by_noise(entry: dict[str, Any]) -> bool:
    return bool(entry["noise"] is not None and entry["tolerance"] <= 1.001 * NOISE_MARGIN * entry["noise"])


def _known(value: float) -> float | None:
    return float(value) if isfinite(value) else None
