"""From experiments to points: two independent experiments of one frequency and its mirror, and their 2x2."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import nan
from typing import NamedTuple

import numpy as np

from ..admittance import components
from ..settling import COND_LIMIT
from ..uncertainty import real_covariance, student_factor
from .local_polynomial import Local
from .tones import Heard

NOISY = 0.1
"""Standard deviation of Y, relative to its norm, above which a row is `noisy`."""

UNSETTLED = 3e-3
"""Disagreement of the halves of a window that is worth a status where noise does not explain it."""

SLIP = 1e-3
"""Cycles over a window by which a row may differ from the one that was asked for and still be called by its name."""

COMMON = 0.5
"""A line of another recording that is at least this part of a tone says that the tone is none."""

COINCIDENT = 0.01
"""Background at the place of a tone or its mirror, relative to the tone, that spoils a point."""


class Experiment(NamedTuple):
    """A tone that was heard, and where.

    Attributes
    ----------
    name : str
        For messages: file and place in it.
    heard : Heard
        What was heard.
    serves_hz : float or None
        The point it was fired for, where a manifest says so (Hz).
    amplitude_pu : float
        Of the injection, where it is known; NaN.
    """

    name: str
    heard: Heard
    serves_hz: float | None = None
    amplitude_pu: float = nan


@dataclass(frozen=True, slots=True)
class Point:
    """One row: 2x2 at ``f_hz`` and what it is worth. Fields as in the table; ``covariance`` is (8, 8) in S^2."""

    f_hz: float
    y: np.ndarray
    covariance: np.ndarray
    status: str
    reason: str
    amplitude_pu: float
    n_periods: float
    window_s: float
    cond_v: float
    residual: float


def points_of(experiments: Sequence[Experiment], f1_hz: float) -> list[Point]:
    """Every point that experiments give, ascending; a point whose mirror experiment is missing says so.

    Parameters
    ----------
    experiments : sequence of Experiment
        In any order; repeats of one experiment are averaged by least squares.
    f1_hz : float
        Fundamental to which frequencies are referred (Hz): a tone that stood d above the fundamental of its own
        record stands d above this one.
    """
    if not experiments:
        return []
    groups = _groups(experiments)
    found = [(_row_hz(group, f1_hz, upper), n) for n, group in enumerate(groups) for upper in _sides(group)]
    rows = [(f, n) for f, n in sorted(found) if f > 0.0]
    first = [_solve(groups[n], f, f1_hz, None) for f, n in rows]
    slopes = _slopes(first)
    points = [
        _solve(groups[n], f, f1_hz, slopes[f]) if _apart(groups[n]) and f in slopes else point
        for (f, n), point in zip(rows, first, strict=True)
    ]
    background = _background(groups)
    return [_spoiled(point, groups[n], n, background) for point, (_, n) in zip(points, rows, strict=True)]


def without_common_lines(experiments: Sequence[Experiment]) -> tuple[list[Experiment], list[str]]:
    """Experiments without lines that several recordings have and none has the mirror of, and what was left out.

    Such a line is the network's or the device's own. Nothing is left out that a manifest asked for, or where no point
    is complete: then the mirror experiments are missing altogether.
    """
    groups = _groups(experiments)
    one_sided = [group for group in groups if group[0].serves_hz is None and _one_sided(group)]
    common = [group for group in one_sided if len(group) > 1 or _in_background(group[0], experiments)]
    if len(common) == len(groups) or not any(len(group) > 1 and not _one_sided(group) for group in groups):
        return list(experiments), []
    left_out = {id(experiment) for group in common for experiment in group}
    words = [
        f"not used: a line at {group[0].heard.f_hz:.6g} Hz, which several stretches have and none its mirror"
        for group in common
    ]
    return [experiment for experiment in experiments if id(experiment) not in left_out], words


def _in_background(experiment: Experiment, others: Sequence[Experiment]) -> bool:
    """Whether another recording has a line where this one has its tone, at least half as large."""
    size = COMMON * np.max(np.abs(experiment.heard.v))
    for other in others:
        apart = np.abs(other.heard.background_hz - other.heard.f1_hz - _distance(experiment))
        near = apart * min(other.heard.window_s, experiment.heard.window_s) < 1.0
        if other.name != experiment.name and np.any(np.abs(other.heard.background[near]) > size):
            return True
    return False


def _one_sided(group: list[Experiment]) -> bool:
    """Whether all experiments of a group stand on one side of the fundamental and say the same."""
    sides = [_turned(e, group[0].heard.f_hz, e.heard.f1_hz) for e in group]
    return len({np.sign(_distance(e)) for e in group}) < 2 and (len(group) < 2 or _dependent(sides))


def broadband_points(records: Sequence[Local], f1_hz: float) -> list[Point]:
    """Rows of broadband records, ascending; where several speak of one frequency the surest is taken."""
    best: dict[float, Point] = {}
    for local in records:
        for k, distance in enumerate(local.distance_hz):
            f_hz = f1_hz + float(distance)
            status, reason = _loud_enough(local.y[k], local.covariance[k])
            point = Point(
                f_hz,
                local.y[k],
                local.covariance[k],
                status,
                reason,
                nan,
                local.window_s * abs(f_hz),
                local.window_s,
                nan,
                nan,
            )
            if f_hz > 0.0 and (f_hz not in best or np.trace(point.covariance) < np.trace(best[f_hz].covariance)):
                best[f_hz] = point
    return [best[f] for f in sorted(best)]


# Which experiments belong together


def _distance(experiment: Experiment) -> float:
    """Distance of a tone from the fundamental of its own record (Hz); mirrors have opposite ones."""
    return experiment.heard.f_hz - experiment.heard.f1_hz


def _groups(experiments: Sequence[Experiment]) -> list[list[Experiment]]:
    """Experiments of one point: equal distance from f1, or a sum of frequencies that is twice the nominal f1."""
    groups: list[list[Experiment]] = []
    for experiment in sorted(experiments, key=lambda e: (abs(_distance(e)), _distance(e))):
        home = next((group for group in reversed(groups) if _belong(group[0], experiment)), None)
        if home is None:
            groups.append([experiment])
        else:
            home.append(experiment)
    return groups


def _belong(one: Experiment, other: Experiment) -> bool:
    if one.serves_hz is not None and other.serves_hz is not None:
        return abs(one.serves_hz - other.serves_hz) < 1e-6 * max(1.0, abs(one.serves_hz))
    near = 0.5 / max(one.heard.window_s, other.heard.window_s)
    if abs(abs(_distance(one)) - abs(_distance(other))) < near:
        return True
    nominal = round(one.heard.f1_hz / 10.0) * 10.0
    return abs(one.heard.f_hz + other.heard.f_hz - 2.0 * nominal) < near * 0.1 and _drifted(one, other, nominal)


def _drifted(one: Experiment, other: Experiment, nominal: float) -> bool:
    """Whether a mirror meant for the nominal fundamental explains the distance of two tones."""
    wanted = abs(one.heard.f1_hz - nominal) + abs(other.heard.f1_hz - nominal)
    return abs(_distance(one) + _distance(other)) <= 1.1 * wanted


def _sides(group: list[Experiment]) -> set[bool]:
    """Rows of a group: above f1 (True), below (False); with a manifest the one that was asked for, else both."""
    served = {e.serves_hz > e.heard.f1_hz for e in group if e.serves_hz is not None}
    return served or {True, False}


def _row_hz(group: list[Experiment], f1_hz: float, upper: bool) -> float:
    """Frequency of a row: the mean distance of its experiments from f1, above or below (Hz)."""
    distance = float(np.mean([abs(_distance(e)) for e in group]))
    row = f1_hz + distance if upper else f1_hz - distance
    served = group[0].serves_hz
    kept = served is not None and abs(row - served) * group[0].heard.window_s < SLIP
    return served if kept and served is not None else row


def _apart(group: list[Experiment]) -> bool:
    """Whether the experiments of a point stood at noticeably different distances from the fundamental."""
    size = [abs(_distance(e)) for e in group]
    return max(size) - min(size) > 1e-4


# Solving


def _solve(group: list[Experiment], f_hz: float, f1_hz: float, slope: tuple[np.ndarray, np.ndarray] | None) -> Point:
    sides = [_turned(e, f_hz, f1_hz) for e in group]
    blank = _blank(group, f_hz)
    if len(group) < 2 or _one_sided(group):
        return replace(blank, status="failed", reason=_missing(group))
    v = np.array([_components(side.v, side.phi1) for side in sides])
    i = np.array([_components(side.i, side.phi1) for side in sides])
    doubt = np.zeros((len(group), 2, 2))
    if slope is not None:
        beyond = [_off(e, f_hz, f1_hz) for e in group]
        i = i - np.array([off * slope[0] @ x for off, x in zip(beyond, v, strict=True)])
        doubt = np.array([np.diag((off * slope[1] @ np.abs(x)) ** 2) for off, x in zip(beyond, v, strict=True)])
    scale = np.linalg.norm(v, axis=1)
    if not np.all(scale > 0.0):
        return replace(blank, status="ill_conditioned", reason="an experiment shows no voltage at its lines")
    cond = float(np.linalg.cond((v / scale[:, None]).T))
    weights = np.array([1.0 / _loudness(side) for side in sides])
    inverse = np.linalg.pinv((v * weights[:, None]).T)
    y = (i * weights[:, None]).T @ inverse
    noise = np.array([_noise(side, y) for side in sides]) + doubt
    covariance = _covariance(noise, weights[:, None] * inverse)
    status, reason = _judged(group, y, covariance, cond)
    return replace(blank, y=y, covariance=covariance, status=status, reason=reason, cond_v=cond)


class _Side(NamedTuple):
    """Phasors and scatter of an experiment, ordered for a row: f first, its mirror second."""

    v: np.ndarray
    i: np.ndarray
    v_scatter: np.ndarray
    i_scatter: np.ndarray
    freedom: float
    phi1: float


def _turned(experiment: Experiment, f_hz: float, f1_hz: float) -> _Side:
    heard = experiment.heard
    order = [0, 1] if (_distance(experiment) > 0.0) == (f_hz > f1_hz) else [1, 0]
    scatter = heard.v_scatter[:, order], heard.i_scatter[:, order]
    return _Side(heard.v[order], heard.i[order], *scatter, heard.freedom, heard.phi1)


def _off(experiment: Experiment, f_hz: float, f1_hz: float) -> float:
    """How far (Hz) an experiment stood beyond the point it is used for, seen from the row."""
    beyond = abs(_distance(experiment)) - abs(f_hz - f1_hz)
    return beyond if f_hz > f1_hz else -beyond


def _components(x: np.ndarray, phi1: float) -> np.ndarray:
    """(2,) components of the pn frame of one experiment's phasors."""
    return components(x[None, :], phi1)[:, 0]


def _dependent(sides: list[_Side]) -> bool:
    v = np.array([_components(side.v, side.phi1) for side in sides])
    return bool(np.linalg.cond((v / np.linalg.norm(v, axis=1, keepdims=True)).T) > 100.0)


def _noise(side: _Side, y: np.ndarray) -> np.ndarray:
    """E[e e^H] (2, 2) of the residual i - Y v of a whole experiment (A^2), widened for the number of its segments."""
    residual = components(side.i_scatter, side.phi1) - y @ components(side.v_scatter, side.phi1)
    one = np.einsum("aw,bw->ab", residual, residual.conj()) / side.freedom
    return np.asarray(one / residual.shape[1] * student_factor(side.freedom))


def _loudness(side: _Side) -> float:
    """Size of an experiment's scatter (A), to weigh repeats; equal weights where there is none."""
    return float(np.mean(np.abs(side.i_scatter) ** 2) ** 0.5 + 1e-9 * np.linalg.norm(side.i) + 1e-300)


def _covariance(noise: np.ndarray, back: np.ndarray) -> np.ndarray:
    """(8, 8) of Y = I B from the noise of every experiment: dY_ab = sum_e E_ae B_eb (as `uncertainty.propagate`)."""
    return real_covariance(np.einsum("eac,eb,ed->abcd", noise, back, back.conj()).reshape(4, 4))


# Judging


def _judged(group: list[Experiment], y: np.ndarray, covariance: np.ndarray, cond: float) -> tuple[str, str]:
    if not cond <= COND_LIMIT:
        return "ill_conditioned", f"cond(V) is {cond:.2g}: the experiments are nearly one"
    doubted = next((e for e in group if e.heard.doubt is not None), None)
    if doubted is not None and doubted.heard.doubt is not None:
        return doubted.heard.doubt.status, f"{doubted.name}: {doubted.heard.doubt.reason}"
    status, reason = _loud_enough(y, covariance)
    if status != "ok":
        return status, reason
    worst = max(group, key=lambda e: e.heard.residual)
    wanders = any(e.heard.drift_hz > 0.0 for e in group)  # then Y itself moves, and the scatter tells of it
    if not wanders and worst.heard.residual > max(UNSETTLED, 5.0 * worst.heard.expected):
        return "not_settled", (
            f"{worst.name}: the halves of the window differ by {worst.heard.residual:.2g}, which noise does not "
            "explain: record longer after the tone begins"
        )
    return "ok", ""


def _loud_enough(y: np.ndarray, covariance: np.ndarray) -> tuple[str, str]:
    spread = float(np.sqrt(np.trace(covariance)) / np.linalg.norm(y))
    if spread <= NOISY:
        return "ok", ""
    return (
        "noisy",
        f"the standard deviation of Y is {_above(spread, NOISY)} of it, {NOISY:g} is the limit: record longer, or "
        "louder",
    )


def _above(value: float, limit: float) -> str:
    """The value with two digits, or as many as show that it is above the limit."""
    texts = [f"{value:.{digits}g}" for digits in range(2, 18)]
    return next((text for text in texts if not float(text) <= limit), texts[-1])


def _missing(group: list[Experiment]) -> str:
    heard = group[0].heard
    times = "one experiment" if len(group) == 1 else f"{len(group)} equal experiments"
    mirror = 2.0 * heard.f1_hz - heard.f_hz
    return f"{times} at {heard.f_hz:.6g} Hz, the mirror experiment at {mirror:.6g} Hz is missing: record it too"


def _blank(group: list[Experiment], f_hz: float) -> Point:
    window_s = min(e.heard.window_s for e in group)
    residual = max(e.heard.residual for e in group)
    amplitude = float(np.mean([e.amplitude_pu for e in group]))
    nothing = np.full((2, 2), complex(nan, nan))
    return Point(
        f_hz, nothing, np.full((8, 8), nan), "ok", "", amplitude, window_s * abs(f_hz), window_s, nan, residual
    )


class _Background(NamedTuple):
    """Lines of all records: order (multiple of f1), size of the voltage (V), number of the experiment; its group."""

    order: np.ndarray
    size_v: np.ndarray
    experiment: np.ndarray
    group_of: np.ndarray


def _background(groups: list[list[Experiment]]) -> _Background:
    heard = [(number, e.heard) for number, group in enumerate(groups) for e in group]
    return _Background(
        order=np.concatenate([each.background_hz / each.f1_hz for _, each in heard]),
        size_v=np.concatenate([np.abs(each.background) for _, each in heard]),
        experiment=np.repeat(np.arange(len(heard)), [len(each.background) for _, each in heard]),
        group_of=np.array([number for number, _ in heard]),
    )


def _spoiled(point: Point, group: list[Experiment], number: int, background: _Background) -> Point:
    """A tone or mirror at the place of a line that other records have too cannot be told from it."""
    if point.status not in ("ok", "noisy"):
        return point
    for experiment in group:
        heard = experiment.heard
        if heard.place_known:
            continue
        places = np.array([heard.f_hz, 2.0 * heard.f1_hz - heard.f_hz])
        near = 1.0 / heard.window_s / heard.f1_hz
        level = [_elsewhere(place / heard.f1_hz, near, number, background) for place in places]
        k = int(np.argmax(level))
        if level[k] > COINCIDENT * np.linalg.norm(heard.v):
            return replace(
                point,
                status="noisy",
                reason=f"{experiment.name}: other records have a line of {level[k]:.3g} V at {places[k]:.6g} Hz "
                f"({level[k] / np.linalg.norm(heard.v):.1%} of the tone): choose a frequency beside it",
            )
        if _others(background, number) == 0 and (order := _harmonic(heard)) is not None:
            return replace(
                point,
                status="noisy",
                reason=f"{experiment.name}: the tone, or its mirror, is at {order} f1, where networks have a harmonic, "
                "and neither a quiet stretch nor another recording shows what stands there without it: choose a "
                "frequency beside it, or record some seconds before the tone begins",
            )
    return point


def _others(background: _Background, number: int) -> int:
    """How many experiments belong to other points than ``number``."""
    return int(np.count_nonzero(background.group_of != number))


def _harmonic(heard: Heard) -> int | None:
    """The odd multiple of f1, other than f1 itself, at which the tone or its mirror stands."""
    for place in (heard.f_hz, 2.0 * heard.f1_hz - heard.f_hz):
        order = round(place / heard.f1_hz)
        if order % 2 and order != 1 and abs(place - order * heard.f1_hz) * heard.window_s < 1.0:
            return order
    return None


def _elsewhere(order: float, near: float, number: int, background: _Background) -> float:
    """Median voltage (V) of a line at this multiple of f1 in the experiments of other points than ``number``."""
    others = background.group_of != number
    if not others.any():
        return 0.0
    at = np.abs(background.order - order) < near
    sizes = np.zeros(len(background.group_of))
    np.maximum.at(sizes, background.experiment[at], background.size_v[at])
    return float(np.median(sizes[others]))


# Mirrors meant for another fundamental


def _slopes(points: list[Point]) -> dict[float, tuple[np.ndarray, np.ndarray]]:
    """dY/df (2, 2) (S/Hz) at the frequencies of solved points, and how far its one-sided values stray from it."""
    solved = [point for point in points if np.all(np.isfinite(point.y))]
    if len(solved) < 3:
        return {}
    f_hz, y = np.array([p.f_hz for p in solved]), np.array([p.y for p in solved])
    between = np.diff(y, axis=0) / np.diff(f_hz)[:, None, None]
    left, right = np.concatenate([between[:1], between]), np.concatenate([between, between[-1:]])
    stray = np.abs(right - left)
    stray[[0, -1]] = np.abs(between[[0, -1]])
    slopes = np.gradient(y, f_hz, axis=0)
    return {f: (slope, off) for f, slope, off in zip(f_hz.tolist(), slopes, stray, strict=True)}
