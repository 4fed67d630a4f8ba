"""The turbine's jobs on their way together, in lanes that are filled anew with whoever is left."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..lanes import n_tones_of
from ..protocol import Job, Window
from ..space_vectors import PHASE_PEAK
from ..under_way import Advance, Clockwork, LanesUnderWay, Places, Rider, of_each
from .asked import Kind, kinds_of, order_of
from .tone_table import pays

if TYPE_CHECKING:
    from .reference import ReferenceTurbine


def lanes_under_way(
    turbine: ReferenceTurbine, jobs: Sequence[Job], windows: Sequence[Window], block_steps: int
) -> LanesUnderWay | None:
    """The jobs; None where one of them stands behind a network or has so many tones that a table is cheaper."""
    from ..kernels import turbine as kernel

    n_tones = max(n_tones_of(job.injection) for job in jobs)
    if pays(n_tones) or any(job.state.source.circuit is not None for job in jobs):
        return None
    of_jobs = kinds_of(jobs, turbine.parameters)
    kinds = sorted(set(of_jobs), key=order_of)
    numbers = np.array([kinds.index(kind) for kind in of_jobs])
    columns, clockwork = turbine.columns(jobs, windows, block_steps, n_tones)
    advance = [_advance(turbine, kind, n_tones, block_steps) for kind in kinds]
    return LanesUnderWay(columns, clockwork, numbers, advance, kernel.N_STATES, (PHASE_PEAK, -PHASE_PEAK))


def clockwork_of(
    turbine: ReferenceTurbine, jobs: Sequence[Job], windows: Sequence[Window], block_steps: int, n_tones: int
) -> Clockwork:
    """What turns in the jobs' columns, seen from the dq frame."""
    from ..kernels import turbine as kernel

    of_jobs = of_each(jobs, turbine.tones_of) if n_tones else [[]] * len(jobs)
    riders = [
        Rider(job.state.step, window, window.f_hz - turbine.f1_hz, tones)
        for job, window, tones in zip(jobs, windows, of_jobs, strict=True)
    ]
    mean_taper = kernel.TAPER_0 + 0.5 * kernel.TAPER_2
    places = Places(kernel.LINE_RE, kernel.TAPER_RE, kernel.TONES, kernel.N_TONE_SLOTS, mean_taper)
    return Clockwork(riders, places, n_tones, block_steps, turbine.dt_s)


def _advance(turbine: ReferenceTurbine, kind: Kind, n_tones: int, block_steps: int) -> Advance:
    from ..kernels import turbine as kernel

    steps = turbine.steps_of(kind, np.zeros((0, 4, kernel.LANES)))

    def advance(lanes: np.ndarray, sums: np.ndarray) -> None:
        steps.each(lanes, n_tones, turbine.parameters, turbine.dt_s, block_steps, kernel.SUM_V, sums)

    return advance
