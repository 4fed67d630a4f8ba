"""The worst operating point, searched by a surrogate and confirmed by sweeps.

The surrogate names a point; it is swept and joins the surrogate, and the search begins anew, until the swept margin is
the predicted one and nothing that the surrogate's doubt leaves open is lower.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..identify.response import FrequencyResponse
from ..identify.surrogate.region import Region, facts_of, name_of, points_of
from ..identify.surrogate.surrogate import Surrogate, build_surrogate
from ..plant.errors import SeqsweepError
from ..tuning.region.worst import Worst
from ..tuning.result import PointTuning
from ..tuning.tune import tune_point
from .planning import make_plan
from .region.adaptive import listed
from .run.campaign import sweep_in_memory
from .run.host import plant_or_card

MOST_SWEEPS = 4
"""Sweeps spent on confirming."""

AGREES = 0.005
"""Relative difference of m at which prediction and sweep agree, and by which a point must be lower to be worse."""

_BESIDE = 0.005  # parts of the region within which a point counts as swept

Sweep = Callable[[np.ndarray], FrequencyResponse]
"""Sweeps the device at an operating point (d,)."""


class WorstError(SeqsweepError):
    """A device that cannot be swept at its worst point, with the way out."""


@dataclass(frozen=True, slots=True)
class ConfirmedWorst:
    """The worst operating point, and what it rests on.

    Attributes
    ----------
    worst : Worst
        The last search.
    tuning : PointTuning
        Its judgement: by a sweep there, where it was swept.
    swept : bool
        Whether it was.
    predicted_m : float or None
        m as it was predicted before that sweep.
    sweeps : int
        Operating points that the answer rests on, those for confirming among them.
    added : tuple of FrequencyResponse
        Those for confirming.
    open_m : float or None
        The least m that the surrogate's doubt leaves open elsewhere, at 95 %; None where nothing is lower than the
        answer by more than `AGREES`.
    """

    worst: Worst
    tuning: PointTuning
    swept: bool
    predicted_m: float | None
    sweeps: int
    added: tuple[FrequencyResponse, ...]
    open_m: float | None


def predicted_worst(surrogate: Surrogate, search: Callable[[Surrogate], Worst]) -> ConfirmedWorst:
    """The answer without any further sweep."""
    worst = search(surrogate)
    return ConfirmedWorst(
        worst,
        worst.tuning,
        False,
        worst.tuning.margin_m,
        len(surrogate.points),
        (),
        _open_m(worst, surrogate.points, surrogate.region),
    )


def confirmed_worst(
    responses: Sequence[FrequencyResponse],
    region: Region,
    search: Callable[[Surrogate], Worst],
    sweep: Sweep,
    *,
    bases: Mapping[str, Any] | None = None,
    most: int = MOST_SWEEPS,
    say: Callable[[str], None] = lambda text: None,
) -> ConfirmedWorst:
    """Search, sweep the point found, and search again, until sweep and surrogate agree.

    Parameters
    ----------
    responses : sequence of FrequencyResponse
        Operating points swept so far.
    region : Region
        Where to search.
    search : callable
        The worst point of a surrogate, such as `worst_of_bank` on a bank of grids.
    sweep : callable
        Sweeps an operating point.
    bases : mapping or None
        The device's rating.
    most : int
        Sweeps that may be spent.
    say : callable
        Called with a line on every sweep.
    """
    known = list(responses)
    worst = search(build_surrogate(known, region=region, bases=bases))
    predicted = worst.tuning.margin_m
    while len(known) - len(responses) < most:
        at = _next(worst, points_of(known, region.parameters), region)
        if at is None:
            break
        predicted = worst.tuning.margin_m if at is worst.point else predicted
        known.append(sweep(at))
        worst = search(build_surrogate(known, region=region, bases=bases))
        name = name_of(at, region.parameters)
        say(f"{len(known)} sweeps, the last at {name}: m = {_number(worst.tuning.margin_m)} at the worst point")
    own = _swept_there(worst, known, region)
    tuning = worst.tuning if own is None else _judged(own, worst)
    added = tuple(known[len(responses) :])
    left = _open_m(worst, points_of(known, region.parameters), region)
    return ConfirmedWorst(worst, tuning, own is not None, predicted, len(known), added, left)


def sweeping(configuration: Mapping[str, Any], jobs: int, parameters: Sequence[str] = ()) -> Sweep:
    """Sweeps operating points of the plant of a campaign, as it is written in a table's metadata.

    ``parameters`` are those of the plant whose values stand behind P, Q and |v| in a point.

    Raises
    ------
    WorstError
        If the table does not say which campaign it came from.
    """
    plain = dict(configuration)
    if not {"campaign", "plant", "sweep"} <= set(plain):
        raise WorstError(
            "the table does not say which campaign it came from, so that nothing can be swept again: "
            "`seqsweep surrogate TABLE --grid ...` predicts its worst point"
        )

    def sweep(point: np.ndarray) -> FrequencyResponse:
        config = listed(plain, point[None], parameters)
        plant = plant_or_card(config)
        plan = replace(make_plan(config, plant), adaptive=None)
        swept = sweep_in_memory(plan, plant, jobs=jobs, backend="threading")
        (response,) = swept.responses()
        return replace(response, meta={**response.meta, **facts_of(point, parameters)})

    return sweep


def _next(worst: Worst, swept: np.ndarray, region: Region) -> np.ndarray | None:
    """The worst point if it is not swept yet, else the point that might be lower still; None where all is said."""
    if _near(worst.point, swept, region) is None:
        return worst.point
    at = _lower_still(worst, swept, region)
    return None if at is None else worst.low_points[at]


def _lower_still(worst: Worst, swept: np.ndarray, region: Region) -> int | None:
    """The least of the bounds below the answer that is not at a swept point."""
    margin = worst.tuning.margin_m
    limit = np.inf if margin is None else (1.0 - AGREES) * margin
    open_ = (k for k in range(len(worst.lows)) if worst.lows[k] < limit)
    return next((k for k in open_ if _near(worst.low_points[k], swept, region) is None), None)


def _open_m(worst: Worst, swept: np.ndarray, region: Region) -> float | None:
    at = _lower_still(worst, swept, region)
    return None if at is None else float(worst.lows[at])


def _swept_there(worst: Worst, known: Sequence[FrequencyResponse], region: Region) -> FrequencyResponse | None:
    at = _near(worst.point, points_of(known, region.parameters), region)
    return None if at is None else known[at]


def _near(point: np.ndarray, swept: np.ndarray, region: Region) -> int | None:
    """Index of a swept point that is as good as ``point``."""
    axes = np.flatnonzero(region.varies)
    apart = np.abs(swept - point)[:, axes] / (region.high - region.low)[axes]
    nearest = int(apart.max(axis=1).argmin())
    return nearest if apart[nearest].max() <= _BESIDE else None


def _judged(response: FrequencyResponse, worst: Worst) -> PointTuning:
    return tune_point(response, worst.situation.grid)


def _number(m: float | None) -> str:
    return "none" if m is None else f"{m:.4g}"
