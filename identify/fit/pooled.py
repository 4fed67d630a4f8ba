"""Many tables fitted together: a pair of poles that no table pays for alone, but all of them ask for, is a doubt.

Devices of one kind have the same faint modes. One table's noise hides such a mode, and its fit does without; what is
made of many devices averages their noise, but not what all their fits leave out. So a pair is put at one place in all
fits, only its residues being free, and its gains in chi-squared are added up over the tables: from noise alone each
gains as many as there are residues. That no table seeks its own place for it is what makes the sum sharp. The fits with
such pairs become the models' rivals, and their differences one error that all tables have in common: the models
themselves stay, as poles that no table carries alone would be modes that are none.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from ..response import FrequencyResponse
from .covariance import finished
from .dq_data import ELEMENTS
from .least_squares import Problem, Trial, datum_variance, refine, shows_noise, solve_residues, trial_at
from .model import Settled, settled_response
from .partial_fractions import order_of
from .rational import Rational, RationalModel

SURE = 4.5
"""Standard deviations by which the sum of the gains must be above that of noise; some forty places are tried."""

_MOST_MORE = 4  # pairs that are added
_PLACES = 14  # over the band
_DAMPINGS = (0.3, 0.6, 0.9)
_STEPS = 3  # of the refinement, every table for itself, once a pole is taken


class Wanted(NamedTuple):
    """A table to be fitted, and how many unstable poles of its own the device is known to have; None: whatever fits."""

    response: FrequencyResponse
    n_unstable: int | None


@dataclass
class Pool:
    """Fits by key, each made once however many sets of tables they are asked for in."""

    _settled: dict[str, Settled] = field(default_factory=dict)
    _models: dict[str, RationalModel] = field(default_factory=dict)
    _together: dict[frozenset[str], dict[str, RationalModel]] = field(default_factory=dict)

    def models(self, wanted: Mapping[str, Wanted]) -> dict[str, RationalModel]:
        """Models of tables that are used together."""
        for key, (response, n_unstable) in wanted.items():
            if key not in self._settled:
                self._settled[key] = settled_response(response, n_unstable=n_unstable)
                self._models[key] = finished(*self._settled[key])
        noisy = [key for key in wanted if _has_room_for_doubt(self._settled[key])]
        return {**{key: self._models[key] for key in wanted}, **self._doubted_together(noisy)}

    def _doubted_together(self, keys: Sequence[str]) -> dict[str, RationalModel]:
        """Models of noisy tables with the rivals that they have in common; one table alone has none."""
        if len(keys) < 2:
            return {}
        together = frozenset(keys)
        if together not in self._together:
            self._together[together] = self._fitted(keys)
        return self._together[together]

    def _fitted(self, keys: Sequence[str]) -> dict[str, RationalModel]:
        fits = [self._settled[key] for key in keys]
        for _ in range(_MOST_MORE):
            place = asked_for([fit.problem for fit in fits], [fit.trial for fit in fits])
            if place is None:
                break
            fits = [_with_one_at(fit, place) for fit in fits]
        return {key: self._doubted(key, fit) for key, fit in zip(keys, fits, strict=True)}

    def _doubted(self, key: str, fit: Settled) -> RationalModel:
        own = self._models[key]
        if fit is self._settled[key]:
            return own
        more = finished(*fit, whole_ranks=True)
        rival = Rational(more.poles, more.residues, more.d, more.e)
        return replace(own, omitted=None, rival=rival)


def _with_one_at(fit: Settled, place: complex) -> Settled:
    return fit._replace(trial=refine(fit.problem, _with(fit.problem, fit.trial, place), _STEPS))


def asked_for(problems: Sequence[Problem], trials: Sequence[Trial]) -> complex | None:
    """Where all tables together ask for a pair of poles (rad/s, the upper one); None if they do not."""
    end = min(abs(problem.s[-1]) for problem in problems)
    sizes = np.geomspace(3e-3 * end, end, _PLACES)
    places = [w * complex(-zeta, (1.0 - zeta**2) ** 0.5) for w in sizes for zeta in _DAMPINGS]
    excess = [_excess(problems, trials, place) for place in places]
    best = int(np.argmax(excess))
    return places[best] if excess[best] > SURE else None


def _excess(problems: Sequence[Problem], trials: Sequence[Trial], place: complex) -> float:
    """By how many standard deviations the gains at a place are above those of noise."""
    free = 2 * ELEMENTS * len(problems)
    gains = sum(_gain(problem, trial, place) for problem, trial in zip(problems, trials, strict=True))
    return float((gains - free) / np.sqrt(2.0 * free))


def _gain(problem: Problem, trial: Trial, place: complex) -> float:
    more = _with(problem, trial, place)
    linear = solve_residues(problem, more.poles, more.tail)
    return (trial.cost - linear.cost) / datum_variance(problem, more, linear)


def _with(problem: Problem, trial: Trial, place: complex) -> Trial:
    poles = np.append(trial.poles, place)  # real ones stay first
    return trial_at(problem, poles, trial.tail)


def _has_room_for_doubt(fit: Settled) -> bool:
    """Whether the rows show noise, and are enough for some poles more."""
    room = order_of(fit.trial.poles) + 2 * _MOST_MORE <= (len(fit.problem.s) - 1) // 2
    return room and shows_noise(fit.problem, fit.trial)
