"""What steps the lanes of one kind of job, and how lanes that meet a limit go their way again."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import numpy as np

from ..kernels.compiled import each
from .asked import Kind


class Steps(Protocol):
    """A kernel that knows its leading arguments.

    ``further`` are its arguments behind the lanes: tones, parameters, step, steps of a block, first slot that is kept,
    and the array that receives what is kept.
    """

    def __call__(self, lanes: np.ndarray, *further: Any) -> None:
        """Step one flat array, (n_slots LANES,)."""

    def each(self, lanes: np.ndarray, *further: Any) -> None:
        """Step flat arrays (n, n_slots LANES), each with its entry of what receives."""


class PlainSteps(NamedTuple):
    """`Steps` of one kernel and the arguments that stand before its lanes."""

    kernel: Any
    leading: tuple[Any, ...]

    def __call__(self, lanes: np.ndarray, *further: Any) -> None:
        self.kernel(*self.leading, lanes, *further)

    def each(self, lanes: np.ndarray, *further: Any) -> None:
        """`Steps.each`."""
        arguments = [*self.leading, lanes, *further]
        each(self.kernel, arguments, (len(self.leading), len(arguments) - 1))


class CalmSteps(NamedTuple):
    """`Steps` of a kernel that knows neither machine nor limits; lanes that meet a limit go the whole way again.

    Each lane is judged by itself, so that not even its rounding depends on its neighbours.
    """

    calm: PlainSteps
    complete: PlainSteps

    def __call__(self, lanes: np.ndarray, *further: Any) -> None:
        *common, kept = further
        self.each(lanes[None], *common, kept[None])

    def each(self, lanes: np.ndarray, *further: Any) -> None:
        """`Steps.each`."""
        from ..kernels.turbine import BEYOND, LANES

        before = lanes.copy()
        self.calm.each(lanes, *further)
        # what is no number has met a limit too
        met = ~(lanes.reshape(len(lanes), -1, LANES)[:, BEYOND] <= 0.0)
        if met.any():
            self._again(met, before, lanes, *further)

    def _again(self, met: np.ndarray, before: np.ndarray, lanes: np.ndarray, *further: Any) -> None:
        """The arrays one of whose lanes ``met`` (n, LANES) a limit, from ``before`` on, and of them those lanes."""
        *common, kept = further
        which = np.flatnonzero(met.any(axis=1))
        again, heard = before[which], np.empty_like(kept[which])
        self.complete.each(again, *common, heard)
        n_lanes = met.shape[1]
        for done, anew in ((lanes, again), (kept, heard)):
            shape = len(which), -1, n_lanes
            chosen = np.where(met[which, None], anew.reshape(shape), done[which].reshape(shape))
            done[which] = chosen.reshape(anew.shape)


def of_fourth_order(kind: Kind, compensated: bool, table: np.ndarray) -> Steps:
    """Runge-Kutta's method for jobs of a kind on a source or behind a line, told the table of their sources."""
    from ..kernels import turbine as kernel

    ideal, reactive = kind.source == "ideal", kind.reactive or None
    advance = kernel.advance_ideal if ideal else kernel.advance_thevenin
    if compensated:
        advance = kernel.advance_ideal_compensated if ideal else kernel.advance_thevenin_compensated
    complete = PlainSteps(advance, (reactive, None, table))
    return CalmSteps(PlainSteps(advance, (reactive, True, table)), complete) if kind.calm else complete


def of_second_order(kind: Kind, compensated: bool, table: np.ndarray) -> Steps:
    """The second-order step for jobs of a kind; it has neither compensation nor table."""
    from ..kernels import turbine_emt as kernel

    advance = kernel.advance_ideal if kind.source == "ideal" else kernel.advance_thevenin
    return PlainSteps(advance, (kind.reactive or None,))
