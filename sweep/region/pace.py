"""How long a region will still take, told no more surely than the rounds so far allow."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field

_ROUNDS = 4  # by which the fall of the error bar is judged


@dataclass
class Pace:
    """Rounds of a region: when each ended, how many points were swept, and the largest error bar then."""

    clock: Callable[[], float] = time.monotonic
    begun_s: float = 0.0
    rounds: list[tuple[float, int, float]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.begun_s = self.clock()

    def mark(self, n_points: int, bar: float) -> None:
        """A round has ended."""
        self.rounds.append((self.clock(), n_points, bar))

    def is_over(self, most_minutes: float | None) -> bool:
        """Whether the time that was allowed is over."""
        return most_minutes is not None and self.clock() - self.begun_s >= 60.0 * most_minutes

    def left(self, wanted: float) -> str:
        """What is to be said of the time left until the bar is ``wanted``; nothing where the bar does not fall.

        The bar falls about geometrically with the points: a line through its logarithm over the last rounds. Two sweeps
        more may be asked for by the certificate.
        """
        last = self.rounds[-_ROUNDS:]
        if len(last) < 2:
            return ""
        (t0, n0, bar0), (t1, n1, bar1) = last[0], last[-1]
        if bar0 <= 0.0 or bar1 <= 0.0:
            return ""
        fall = (math.log(bar0) - math.log(bar1)) / max(n1 - n0, 1)
        if fall <= 0.0:
            return "; how long is open: the doubt does not fall"
        points = max(math.ceil(math.log(bar1 / wanted) / fall), 1)
        seconds = points * (t1 - t0) / max(n1 - n0, 1)
        return f"; at this pace some {points} more, {seconds:.0f} s"
