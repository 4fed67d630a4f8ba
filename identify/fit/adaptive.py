"""Where to measure next, and when to stop: a rational surrogate that knows where it is unsure.

The rows measured so far, of all operating points, go in; the next few places come out, or the error to
which the surrogates are certified. Everything happens at nu = |f - f1|, the frequency seen from the
rotating frame: a row at f speaks for its mirror 2 f1 - f too.

What a surrogate is: a vector fit in the dq frame started from the poles of a barycentric interpolant,
of the order with the lowest BIC. Where it is unsure: the larger of its distance to the surrogate of the
round before, which has not seen the latest rows; of its distance to the surrogate of another order with
nearly the same BIC; and of twice its standard error, the misfit never believed to be below the rows'
own noise. All distances are ||dY||_F / ||Y||_F.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ...plant.errors import SeqsweepError
from ..frames import dq_to_pn
from ..response import FrequencyResponse
from .aaa import interpolants, poles
from .dq_data import DqData, to_dq
from .model import fit_poles
from .rational import RationalModel, evaluate, gradient

FIRST_POINTS = 8
"""Places of the first round, without the ends of the band."""

ROUND_POINTS = 4
"""Places of a further round: their eight shots fill the lanes of a compiled plant."""

NEAREST_HZ = 1.0
"""Closest approach to f1 (Hz): the window that tells them apart is five of its periods long."""

APART_HZ = 0.1
"""Least distance of two places (Hz)."""

SPREAD = 0.05
"""Least distance of two places of one round, and from a row that failed, relative to nu."""

NOISE_MARGIN = 3.0
"""With noisy rows no more is asked than this many times their noise."""

EXCESS = 2.0
"""Largest misfit of a surrogate that describes its rows, in units of their noise."""

NOISE_FLOOR = 1e-7
"""Noise of rows that say nothing of theirs."""

LEAST_MISFIT = 1e-3
"""A fit counts smaller misfits as this one, in units of the noise."""

MIN_ROWS = 5
"""Fewest usable rows a surrogate is made from."""

_EQUAL_BIC = 10.0
_MISSES = 3
_CANDIDATES = 400
_PARTS = np.eye(4).reshape(4, 2, 2)


class Surrogate(NamedTuple):
    """A model of one operating point, another of nearly the same worth (or None), and what they stand on.

    Attributes
    ----------
    model : RationalModel
        In the dq frame.
    rival : RationalModel or None
        Another order whose BIC is within 10.
    noise : float
        Of the rows, relative.
    excess : float
        Misfit in units of that noise.
    """

    model: RationalModel
    rival: RationalModel | None
    noise: float
    excess: float


@dataclass(frozen=True, slots=True)
class Verdict:
    """What is known about one operating point.

    Attributes
    ----------
    op_id : str
        Its name.
    state : "unsure", "sure", "certified" or "hopeless"
        "sure": the surrogate thinks so; "certified": fresh rows have confirmed it; "hopeless": too few usable rows.
    goal : float
        The error asked: the tolerance, or what the noise of the rows allows.
    error : float
        The largest error thought possible, anywhere in the band or found at a fresh row; NaN if unknown.
    at_hz : float
        Where, as |f - f1| (Hz).
    fresh_error : float
        Largest error found at the latest rows, by the surrogate that had not seen them; NaN if there is none.
    n_fresh : int
        Number of those rows.
    noise : float
        Of the rows, relative.
    order : int
        Poles of the surrogate.
    """

    op_id: str
    state: str
    goal: float
    error: float
    at_hz: float
    fresh_error: float
    n_fresh: int
    noise: float
    order: int


@dataclass(frozen=True, slots=True)
class Decision:
    """What to do after a round.

    Attributes
    ----------
    nu_hz : (k,) float
        Where to measure next, as |f - f1| (Hz), the most wanted first; empty where nothing is left to ask.
    verdicts : tuple of Verdict
        One for each response.
    surrogates : tuple of Surrogate or None
        To be handed to the next `decide`.
    """

    nu_hz: np.ndarray
    verdicts: tuple[Verdict, ...]
    surrogates: tuple[Surrogate | None, ...]

    @property
    def certified(self) -> bool:
        """Whether every operating point that can be certified is."""
        return all(verdict.state in ("certified", "hopeless") for verdict in self.verdicts)


def band_of(f_min_hz: float, f_max_hz: float, f1_hz: float) -> tuple[float, float]:
    """Range of nu = |f - f1| (Hz) of a band; f1 inside it is approached to `NEAREST_HZ`.

    Raises
    ------
    SeqsweepError
        If nothing is left of the band.
    """
    ends = abs(f_min_hz - f1_hz), abs(f_max_hz - f1_hz)
    inside = f_min_hz < f1_hz < f_max_hz
    low, high = (NEAREST_HZ, max(ends)) if inside else (max(min(ends), NEAREST_HZ), max(ends))
    if not low < high:
        raise SeqsweepError(
            f"the band from {f_min_hz:g} to {f_max_hz:g} Hz lies within {NEAREST_HZ:g} Hz of f1 = {f1_hz:g} Hz: "
            "widen it"
        )
    return low, high


def first_places(band_hz: tuple[float, float]) -> np.ndarray:
    """The first round (`FIRST_POINTS`,) as nu (Hz): evenly over the logarithm of the band."""
    return np.geomspace(*band_hz, FIRST_POINTS)


def decide(
    responses: Sequence[FrequencyResponse],
    previous: Decision | None,
    band_hz: tuple[float, float],
    tolerance: float,
) -> Decision:
    """Judge what has been measured and say what is to be measured next.

    Parameters
    ----------
    responses : sequence of FrequencyResponse
        Every operating point with the same frequencies, all rounds so far; pn frame. Rows that are not "ok" do not
        count, but are not asked for again.
    previous : Decision or None
        Of the round before; its surrogates have not seen the latest rows.
    band_hz : (float, float)
        As `band_of` gives it.
    tolerance : float
        Largest error ||dY||_F / ||Y||_F that is asked.

    Returns
    -------
    Decision
        With empty ``nu_hz`` if everything is certified, or nothing can be.
    """
    before: Sequence[Surrogate | None] = previous.surrogates if previous else [None] * len(responses)
    earlier: Sequence[Verdict | None] = previous.verdicts if previous else [None] * len(responses)
    surrogates = tuple(surrogate_of(r, b) for r, b in zip(responses, before, strict=True))
    nu_hz = _candidates(band_hz, [s for s in (*surrogates, *before) if s is not None])
    doubts = [_doubt(s, b, nu_hz) for s, b in zip(surrogates, before, strict=True)]
    verdicts = tuple(
        _verdict(response, surrogate, old, was, nu_hz, doubt, tolerance)
        for response, surrogate, old, was, doubt in zip(responses, surrogates, before, earlier, doubts, strict=True)
    )
    decided = Decision(np.empty(0), verdicts, surrogates)
    if decided.certified:
        return decided
    open_ones = [(v, d) for v, d in zip(verdicts, doubts, strict=True) if v.state in ("unsure", "sure")]
    wanted = np.max([doubt / verdict.goal for verdict, doubt in open_ones], axis=0)
    explore = all(verdict.state == "sure" for verdict, _ in open_ones)
    return Decision(_places(nu_hz, wanted, _taken(responses), explore), verdicts, surrogates)


def interpolate(response: FrequencyResponse, f_hz: np.ndarray) -> np.ndarray:
    """The surrogate of a table's rows at other frequencies: what an adaptive sweep is certified for.

    Parameters
    ----------
    response : FrequencyResponse
        pn frame, at least `MIN_ROWS` usable rows.
    f_hz : (n,) float
        Frequencies of the first component (Hz).

    Returns
    -------
    (n, 2, 2) complex
        Admittance in S, pn frame.

    Raises
    ------
    SeqsweepError
        If there are too few usable rows.
    """
    surrogate = surrogate_of(response)
    if surrogate is None:
        raise SeqsweepError(f"fewer than {MIN_ROWS} rows are usable: nothing to interpolate")
    return dq_to_pn(evaluate(surrogate.model, 2j * np.pi * (np.asarray(f_hz, dtype=float) - response.f1_hz)))


# The surrogate ---------------------------------------------------------------------------------------------------


def surrogate_of(response: FrequencyResponse, before: Surrogate | None = None) -> Surrogate | None:
    """The rational model of one operating point with the lowest BIC; None where there are too few usable rows.

    ``before`` is the surrogate of a part of the rows: orders well below its order are not tried again.
    """
    data = _distinct(to_dq(response))
    if len(data.nu_hz) < MIN_ROWS:
        return None
    noise = _noise(response, data)
    models = _models(data, response.f1_hz, noise, before)
    ranked = sorted(models, key=lambda model: model.bic)
    best = ranked[0]
    rival = ranked[1] if len(ranked) > 1 and ranked[1].bic < best.bic + _EQUAL_BIC else None
    return Surrogate(best, rival, noise, _excess(best, noise))


def _distinct(data: DqData) -> DqData:
    """Rows that mirror each other as one: the first."""
    first = np.diff(data.nu_hz, prepend=-np.inf) > 1e-6
    return DqData(data.nu_hz[first], data.y[first], None if data.std is None else data.std[first])


def _noise(response: FrequencyResponse, data: DqData) -> float:
    """Relative noise of the rows: from their covariance, else from the disagreement of their windows."""
    if data.std is not None:
        size = np.linalg.norm(data.y, axis=(1, 2))
        return max(float(np.median(np.sqrt(2.0) * np.linalg.norm(data.std, axis=(1, 2)) / size)), NOISE_FLOOR)
    residual = np.asarray(response.quality.get("residual", np.full(len(response), np.nan)), dtype=float)[response.ok]
    residual = residual[np.isfinite(residual)]
    return max(float(np.sqrt(np.mean(residual**2) / 2.0)), NOISE_FLOOR) if len(residual) else NOISE_FLOOR


def _models(data: DqData, f1_hz: float, noise: float, before: Surrogate | None) -> list[RationalModel]:
    """Models of growing order until one describes the rows, or more does not pay."""
    fewest = 1 if before is None else before.model.order // 2
    floor = noise / np.sqrt(2.0) if data.std is None else NOISE_FLOOR
    models: list[RationalModel] = []
    misses = 0
    for interpolant in interpolants(data):
        n_nodes = len(interpolant.z)
        if models and 8 * len(data.nu_hz) < 5 * (2 * n_nodes - 1) + 4 + 4:
            break
        if n_nodes < fewest:
            continue
        model = fit_poles(data, poles(interpolant), f1_hz=f1_hz, noise_floor=floor)
        misses = misses + 1 if models and model.bic >= min(m.bic for m in models) else 0
        models.append(model)
        if _excess(model, noise) <= 1.0 or (misses >= _MISSES and min(_excess(m, noise) for m in models) <= EXCESS):
            break
    return models


def _excess(model: RationalModel, noise: float) -> float:
    """Misfit in units of the rows' noise."""
    return model.residual if model.weighting == "covariance" else np.sqrt(2.0) * model.residual / noise


# Doubt -----------------------------------------------------------------------------------------------------------


def _doubt(surrogate: Surrogate | None, before: Surrogate | None, nu_hz: np.ndarray) -> np.ndarray:
    """Error thought possible at each candidate (n,), relative."""
    if surrogate is None:
        return np.full(len(nu_hz), np.inf)
    s = 2j * np.pi * nu_hz
    y = evaluate(surrogate.model, s)
    size = np.linalg.norm(y, axis=(1, 2))
    others = [evaluate(m, s) for m in (before.model if before else None, surrogate.rival) if m is not None]
    found = [np.linalg.norm(other - y, axis=(1, 2)) / size for other in others]
    if not before:
        found.append(np.full(len(nu_hz), np.inf))
    return np.max([*found, 2.0 * _standard_error(surrogate, s) / size], axis=0)


def _standard_error(surrogate: Surrogate, s: np.ndarray) -> np.ndarray:
    """Standard error of ||Y||_F (n,) in S; a misfit below the noise is luck or too many parameters."""
    model = surrogate.model
    slopes = np.stack([gradient(model, s, np.broadcast_to(part, (len(s), 2, 2))) for part in _PARTS])
    spread = np.linalg.norm(slopes @ model.covariance_root, axis=(0, 2))
    return np.asarray(spread * max(1.0, 1.0 / max(surrogate.excess, LEAST_MISFIT)))


def _verdict(
    response: FrequencyResponse,
    surrogate: Surrogate | None,
    before: Surrogate | None,
    was: Verdict | None,
    nu_hz: np.ndarray,
    doubt: np.ndarray,
    tolerance: float,
) -> Verdict:
    name = str(response.meta.get("op_id", ""))
    if surrogate is None:
        return Verdict(name, "hopeless", tolerance, np.nan, np.nan, np.nan, 0, np.nan, 0)
    goal = max(tolerance, NOISE_MARGIN * surrogate.noise)
    fresh, fresh_hz = _fresh_errors(response, before)
    worst = int(np.argmax(doubt))
    error, at_hz = float(doubt[worst]), float(nu_hz[worst])
    fresh_error = float(np.max(fresh)) if len(fresh) else np.nan
    if len(fresh) and fresh_error > error:
        error, at_hz = fresh_error, float(fresh_hz[int(np.argmax(fresh))])
    sure = error <= goal and surrogate.excess <= max(EXCESS, 0.3 * goal / surrogate.noise)
    confirmed = sure and was is not None and was.state in ("sure", "certified") and len(fresh) > 0
    state = "certified" if confirmed else "sure" if sure else "unsure"
    return Verdict(name, state, goal, error, at_hz, fresh_error, len(fresh), surrogate.noise, surrogate.model.order)


def _fresh_errors(response: FrequencyResponse, before: Surrogate | None) -> tuple[np.ndarray, np.ndarray]:
    """What ``before`` gets wrong at rows it has not seen, relative, and their nu (Hz)."""
    data = _distinct(to_dq(response))
    if before is None:
        return np.empty(0), np.empty(0)
    unseen = np.min(np.abs(data.nu_hz[:, None] - before.model.nu_hz), axis=1) > 1e-6
    y, nu_hz = data.y[unseen], data.nu_hz[unseen]
    error = np.linalg.norm(evaluate(before.model, 2j * np.pi * nu_hz) - y, axis=(1, 2))
    return error / np.linalg.norm(y, axis=(1, 2)), nu_hz


# Places ----------------------------------------------------------------------------------------------------------


def _candidates(band_hz: tuple[float, float], surrogates: Sequence[Surrogate]) -> np.ndarray:
    """The band in fine steps, finer about the poles of the surrogates."""
    grids: list[Any] = [np.geomspace(*band_hz, _CANDIDATES), np.linspace(*band_hz, _CANDIDATES)]
    for surrogate in surrogates:
        pole = surrogate.model.poles[surrogate.model.poles.imag > 0.0]
        grids += [(pole.imag + widths * np.abs(pole.real)) / (2.0 * np.pi) for widths in (-3, -1, -0.3, 0, 0.3, 1, 3)]
    nu_hz = np.unique(np.concatenate(grids))
    return nu_hz[(nu_hz >= band_hz[0]) & (nu_hz <= band_hz[1])]


def _taken(responses: Sequence[FrequencyResponse]) -> tuple[np.ndarray, np.ndarray]:
    """nu (Hz) of every row, and of those that are not ok in every operating point."""
    nu_hz = np.abs(responses[0].f_hz - responses[0].f1_hz)
    bad = ~np.any([response.ok for response in responses], axis=0)
    return nu_hz, nu_hz[bad]


def _places(nu_hz: np.ndarray, wanted: np.ndarray, taken: tuple[np.ndarray, np.ndarray], explore: bool) -> np.ndarray:
    """The candidates most wanted, apart from each other; every second one in the widest gap, where all seem sure."""
    rows, bad = taken
    chosen: list[float] = []
    for k in range(ROUND_POINTS):
        free = _apart(nu_hz, rows, APART_HZ) & _apart(nu_hz, bad, SPREAD * nu_hz)
        free &= _apart(nu_hz, np.array(chosen), np.maximum(APART_HZ, SPREAD * nu_hz))
        if not np.any(free):
            break
        gap = np.min(np.abs(np.log(nu_hz[:, None] / np.append(rows, chosen))), axis=1)
        unknown = ~np.isfinite(wanted)
        score = gap if (explore and k % 2) or np.any(unknown & free) else wanted
        chosen.append(float(nu_hz[np.argmax(np.where(free, score, -1.0))]))
    return np.array(chosen)


def _apart(nu_hz: np.ndarray, from_hz: np.ndarray, distance_hz: Any) -> np.ndarray:
    """(n,) bool: farther than ``distance_hz`` from all of ``from_hz``."""
    if not len(from_hz):
        return np.full(len(nu_hz), True)
    return np.asarray(np.min(np.abs(nu_hz[:, None] - from_hz), axis=1) > distance_hz)
