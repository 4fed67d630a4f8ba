"""Where the admittance jumps over the operating points: a limit, a dead band, a change of mode.

A jump shows as sweeps that no single smooth model meets when they are left out. It is found by splitting the sweeps at
one value of a feature with a physical meaning (a power, the voltage, a current) such that both sides are described far
better than the whole, and such that the two models differ, where the sides meet, by more than their error bars. Between
the last sweep of one side and the first of the other nothing is known, and nothing is said.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from .certainty import all_alike, certainty, relative_error
from .choosing import choose_shapes
from .partitions import evidence_of
from .sparse_rational import Data, Fitted, fit_shape, predict, values

FEATURES: dict[str, tuple[Callable[[np.ndarray], np.ndarray], str]] = {
    "active power": (lambda x: x[:, 0], "MW"),
    "reactive power": (lambda x: x[:, 1], "Mvar"),
    "terminal voltage": (lambda x: x[:, 2], "pu"),
    "current": (lambda x: np.hypot(x[:, 0], x[:, 1]) / x[:, 2], "MVA/pu"),
    "active current": (lambda x: x[:, 0] / x[:, 2], "MW/pu"),
    "reactive current": (lambda x: -x[:, 1] / x[:, 2], "Mvar/pu"),
    "apparent power": (lambda x: np.hypot(x[:, 0], x[:, 1]), "MVA"),
}
"""What a device may switch by, of operating points (p, d) in MW, Mvar and pu; and its unit."""

GAIN = 10.0
"""By how much the sides must be described better than the whole."""

WORTH = 2e-3
"""Root mean square of the left-out errors of the whole from which on a jump is looked for."""

APART = 2.0
"""In error bars, how far the two models must differ where the sides meet."""

DECIDING = 6
"""Frequencies that decide."""

CLEARLY, BETTER, OVERWHELMING = 2e-2, 3.0, 25.0
"""Where the whole is met this badly and the sides so much better, this evidence alone tells two devices."""

EVIDENCE = 6.0
"""Twice the log-likelihood ratio from which on a split is looked at: the odds are twenty to one."""

_TRIED = 2  # splits that are fitted with the rational model, of those that Gaussian processes like best
_RIVALRY = 12.0  # by how much less evidence another split may have and still be tried
_MOVES = 3  # rounds of moving sweeps to the side that explains them
_EXPLAINS = 0.2  # a sweep moves where the other side misses it by less than this part of its own side's error


class Cut(NamedTuple):
    """One feature by which the sweeps part: up to ``low`` they are of one side, from ``high`` on of the other."""

    feature: str
    low: float
    high: float
    rising: bool = True
    """Whether the second side is above."""

    column: int | None = None
    """Where the feature is a parameter of the plant: its place in an operating point."""

    def value(self, points: np.ndarray) -> np.ndarray:
        """(p,) the feature at points (p, d)."""
        return _value(self.feature, self.column, np.atleast_2d(points))

    def side(self, points: np.ndarray) -> np.ndarray:
        """(p,) int of points (p, d): 0 or 1, and -1 in between."""
        value = self.value(points)
        below, above = (0, 1) if self.rising else (1, 0)
        return np.where(value <= self.low, below, np.where(value >= self.high, above, -1))

    def beyond(self, points: np.ndarray) -> np.ndarray:
        """(p,) how far points are from the middle of the gap, in parts of the feature's range; positive on side 1."""
        value = self.value(points)
        away = (value - (self.low + self.high) / 2.0) / _range(value)
        return away if self.rising else -away

    def width(self, points: np.ndarray) -> float:
        """Of the gap, in parts of the feature's range over ``points``."""
        return float((self.high - self.low) / _range(self.value(points)))


class Border(NamedTuple):
    """Where the device changes.

    Attributes
    ----------
    cuts : tuple of Cut
        Features that part all sweeps, the first the one that is told. Where they disagree nothing is known.
    """

    cuts: tuple[Cut, ...]

    def side(self, points: np.ndarray) -> np.ndarray:
        """(p,) int of points (p, d): 0 or 1, and -1 in the gap where nothing is known."""
        sides = np.array([cut.side(points) for cut in self.cuts])
        return np.where((sides == sides[0]).all(axis=0), sides[0], -1)

    def width(self, points: np.ndarray) -> float:
        """How well it is located over ``points``, in parts of a feature's range.

        The gap of the first feature; or, where features still disagree, how far apart their borders are.
        """
        _, apart = self._disputed(points)
        return max(self.cuts[0].width(points), apart)

    def question(self, swept: np.ndarray, points: np.ndarray, width: float) -> np.ndarray:
        """The operating point (d,) to sweep next: where features disagree most, else in the middle of the gap."""
        at, apart = self._disputed(points)
        return points[at] if apart > width else self._middle(swept)

    def _disputed(self, points: np.ndarray) -> tuple[int, float]:
        """Which of the points is farthest beyond one border and short of another, and the widest strip between two."""
        beyond = np.array([cut.beyond(points) for cut in self.cuts])
        most, least = beyond.max(axis=0), beyond.min(axis=0)
        strip = (most - least)[(most > 0.0) & (least < 0.0)]
        return int(np.minimum(most, -least).argmax()), float(strip.max(initial=0.0))

    def _middle(self, swept: np.ndarray) -> np.ndarray:
        """Between the two swept points that bound the first feature's gap."""
        cut = self.cuts[0]
        value, middle = cut.value(swept), (cut.low + cut.high) / 2.0
        below, above = value <= cut.low, value >= cut.high
        start = swept[np.flatnonzero(below)[value[below].argmax()]]
        end = swept[np.flatnonzero(above)[value[above].argmin()]]
        low, high = 0.0, 1.0
        for _ in range(50):
            share = (low + high) / 2.0
            is_below = cut.value((start + share * (end - start))[None])[0] < middle
            low, high = (share, high) if is_below else (low, share)
        return np.asarray(start + low * (end - start))

    def __str__(self) -> str:
        cut = self.cuts[0]
        unit = "" if cut.column is not None else f" {FEATURES[cut.feature][1]}"
        return f"{cut.feature} {cut.low:.4g} to {cut.high:.4g}{unit}"


_Features = list[tuple[str, int | None]]


def _features(parameters: Sequence[str]) -> _Features:
    """Names of what a device may switch by, with the column of an operating point where it is a parameter."""
    return [*((name, None) for name in FEATURES), *((name, 3 + k) for k, name in enumerate(parameters))]


def _value(feature: str, column: int | None, points: np.ndarray) -> np.ndarray:
    """(p,) of points (p, d)."""
    return np.asarray(FEATURES[feature][0](points) if column is None else points[:, column])


def _range(value: np.ndarray) -> float:
    return max(float(value.max() - value.min()), 1e-12)


def least_side(n_axes: int) -> int:
    """Fewest sweeps on a side that can be told to be another device."""
    return n_axes + 2


class Findings(NamedTuple):
    """Where the device changes; where it may change, the sweeps saying too little yet. None: nowhere."""

    border: Border | None = None
    suspected: Border | None = None


def find_border(
    points: np.ndarray, data: Data, region: np.ndarray, noise: np.ndarray | None, parameters: Sequence[str] = ()
) -> Findings:
    """The border of a jump, where the sweeps show one, or where there may be one.

    Parameters
    ----------
    points : (m, d) float
        The sweeps, in MW, Mvar and pu, and the values of parameters.
    data : Data
        The same in the unit box.
    region : (p, d) float
        Points of the unit box over which denominators are guarded.
    noise : (f, m) float or None
        Relative variance of the rows.
    parameters : sequence of str
        Names of the parameters that are axes.
    """
    features = _features(parameters)
    few = _thinned(data, noise)
    partitions = _partitions(points, few, features)
    if not partitions:
        return Findings()
    whole = fit_shape(few.data, choose_shapes(few.data, region)[0]).score
    if whole < max(WORTH, GAIN * few.noise):
        return Findings()
    settled = (_settled(points, few, part, region, features) for part in partitions)
    found = [split for split in settled if split is not None]
    best = min(found, key=lambda s: s.score, default=None)
    if best is None:
        return Findings()
    return Findings(best.border) if _are_two(points, few, best, whole) else Findings(suspected=best.border)


def _are_two(points: np.ndarray, few: _Few, split: _Split, whole: float) -> bool:
    """Whether the sides of a split are two devices, the whole being met with the left-out error ``whole``.

    With few sweeps on one side its model says little yet: there the evidence counts, if it is overwhelming.
    """
    if whole >= CLEARLY and split.score * BETTER <= whole:
        evidence = evidence_of(few.data, few.variance, split.side[None])[0]
        if evidence >= OVERWHELMING:
            return True
    better = split.score * GAIN <= whole or split.score <= 3.0 * few.noise
    return better and _differ(points, few, split)


class _Few(NamedTuple):
    """Sweeps at the frequencies that decide, and the root mean square of the rows' noise."""

    data: Data
    variance: np.ndarray | None
    noise: float


class _Split(NamedTuple):
    """Two sides, their models, the worse of their scores, and the border between them."""

    side: np.ndarray
    models: tuple[Fitted, Fitted]
    score: float
    border: Border


def _thinned(data: Data, noise: np.ndarray | None) -> _Few:
    rows = np.linspace(0, len(data.y) - 1, min(DECIDING, len(data.y))).round().astype(int)
    variance = None if noise is None else noise[rows]
    level = 0.0 if variance is None else float(np.sqrt(np.mean(variance)))
    return _Few(Data(data.x, data.y[rows], data.weight[rows]), variance, level)


def _side_of(data: Data, mask: np.ndarray) -> Data:
    return Data(data.x[mask], data.y[:, mask], data.weight[:, mask])


def _partitions(points: np.ndarray, few: _Few, features: _Features) -> list[np.ndarray]:
    """Splits (m,) bool at one value of a feature, those first that speak most clearly for two devices."""
    splits = _splits(points, least_side(few.data.x.shape[1]), features)
    if len(splits) == 0:
        return []
    evidence = evidence_of(few.data, few.variance, splits)
    likely = evidence >= max(EVIDENCE, evidence.max() - _RIVALRY)
    ranked = np.argsort(-evidence, kind="stable")[:_TRIED]
    return [splits[k] for k in ranked if likely[k]]


def _splits(points: np.ndarray, least: int, features: _Features) -> np.ndarray:
    """(n, m) bool: sweeps above each value of each feature, where both sides hold ``least`` sweeps or more."""
    found: dict[bytes, np.ndarray] = {}
    for feature in features:
        value = _value(*feature, points)
        for at in np.unique(value)[1:]:
            side = value >= at - 1e-12
            if least <= side.sum() <= len(side) - least:
                found.setdefault((side if side[0] else ~side).tobytes(), side)
    return np.array(list(found.values()))


def _settled(points: np.ndarray, few: _Few, side: np.ndarray, region: np.ndarray, features: _Features) -> _Split | None:
    """A split whose sweeps stand on the side that explains them, and the feature that parts them."""
    least = least_side(few.data.x.shape[1])
    for _ in range(_MOVES):
        if not least <= side.sum() <= len(side) - least:
            return None
        models = _models(few.data, side, region)
        moved = _moved(few.data, side, models)
        if np.array_equal(moved, side):
            break
        side = moved
    border = _border(points, side, features)
    return None if border is None else _Split(side, models, max(m.score for m in models), border)


def _models(data: Data, side: np.ndarray, region: np.ndarray) -> tuple[Fitted, Fitted]:
    below, above = (_side_of(data, mask) for mask in (~side, side))
    return fit_shape(below, choose_shapes(below, region)[0]), fit_shape(above, choose_shapes(above, region)[0])


def _moved(data: Data, side: np.ndarray, models: tuple[Fitted, Fitted]) -> np.ndarray:
    """The sides after every sweep has gone where it is explained."""
    own = np.empty(len(side))
    for mask, model in ((~side, models[0]), (side, models[1])):
        own[mask] = np.sqrt(np.mean(np.sum(np.abs(model.left_out) ** 2, axis=2), axis=0))
    other = np.where(side, _missed(data, models[0]), _missed(data, models[1]))
    return np.where(other < _EXPLAINS * own, ~side, side)


def _missed(data: Data, model: Fitted) -> np.ndarray:
    """(m,) root mean square of what a model misses each sweep by, relative to ||Y||."""
    off = (values(model, data.x).transpose(1, 0, 2) - data.y) * data.weight[..., None]
    return np.sqrt(np.mean(np.sum(np.abs(off) ** 2, axis=2), axis=0))


def _border(points: np.ndarray, side: np.ndarray, features: _Features) -> Border | None:
    """Every feature that parts the sides without an exception, that with the widest gap first; None if none does."""
    cuts = [cut for feature in features if (cut := _cut(points, side, *feature)) is not None]
    cuts.sort(key=lambda cut: -cut.width(points))
    if not cuts:
        return None
    return Border(tuple(cut._replace(rising=cut.rising == cuts[0].rising) for cut in cuts))


def _cut(points: np.ndarray, side: np.ndarray, name: str, column: int | None) -> Cut | None:
    value = _value(name, column, points)
    for rising, above in ((True, side), (False, ~side)):
        if value[~above].max() < value[above].min() - 1e-9 * _range(value):
            return Cut(name, float(value[~above].max()), float(value[above].min()), rising, column)
    return None


def _differ(points: np.ndarray, few: _Few, split: _Split) -> bool:
    """Whether the two models differ where the sides meet by more than their error bars."""
    below, above = (np.flatnonzero(mask) for mask in (~split.side, split.side))
    apart = np.linalg.norm(few.data.x[below][:, None] - few.data.x[above][None], axis=2)
    nearest = np.argsort(apart.min(axis=1))[:3]
    at = (few.data.x[below[nearest]] + few.data.x[above[apart[nearest].argmin(axis=1)]]) / 2.0
    told = [
        _with_bar(model, _side_of(few.data, mask), few.variance if few.variance is None else few.variance[:, mask], at)
        for model, mask in zip(split.models, (~split.side, split.side), strict=True)
    ]
    size = np.linalg.norm(told[0][0], axis=2)
    off = np.linalg.norm(told[0][0] - told[1][0], axis=2) / size
    return bool(np.median(off.max(axis=1) / (told[0][1] + told[1][1]).max(axis=1)) > APART)


def _with_bar(model: Fitted, data: Data, noise: np.ndarray | None, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    found = predict(model, x)
    return found.y, relative_error(found, certainty(model, data, noise, all_alike(model, data)), (), ())
