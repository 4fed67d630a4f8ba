"""The proof in time: the same device with and without damping control, through the same scenario.

`verify` takes what `tune` found (grid, k, w_r and the campaign in its provenance) and drives the
device through a grid step, or what a scenario file says, twice. Every number is read from terminals.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...plant.damping.control import THRESHOLD, DampingSettings
from ...plant.damping.events import Scenario, Trajectory, conditions_at, simulate, source_of
from ...plant.errors import SeqsweepError, in_words
from ...plant.protocol import Conditions, MeasuredPlant, NotSettled, OperatingPoint, Plant
from ...tuning.grids.elements import CircuitGrid
from ...tuning.siso import Grid, SeriesRL
from .reading import RunReport, report
from .scenario import Story
from .tuned import Tuned, VerifyError, scenario_of, settings_of, why_undamped

if TYPE_CHECKING:
    from ...identify.response import FrequencyResponse

CauseGone = Callable[[Conditions], bool]


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class Verification:
    """Both runs; ``remarks`` say what the reader should know. Printed, it is the report of ``seqsweep verify``.

    ``settings`` and ``damped`` are None, and there is one report, where there is no damping control to simulate.
    """

    tuned: Tuned
    scenario: Scenario
    settings: DampingSettings | None
    duration_s: float
    without: Trajectory
    damped: Trajectory | None
    reports: tuple[RunReport, ...]
    remarks: tuple[str, ...]

    @property
    def threshold(self) -> float:
        """Ratio of the resonance over the fundamental above which it counts."""
        return THRESHOLD if self.settings is None else self.settings.threshold

    def __repr__(self) -> str:
        from .report import format_report

        return format_report(self)

    def _repr_html_(self) -> str:
        from .report import as_html

        return as_html(self)

    def plot(self, ax: Any = None) -> Any:
        """Power, resonance current, r(t) and frequency of both runs, in matplotlib axes (4,), which are returned."""
        from .figure import shown

        return shown(self, ax)


def cause_gone_of(response: FrequencyResponse) -> CauseGone:
    """The check by which damping control stops: the winding number of the swept device on the grid of the moment."""
    from ...identify.fit.model import fit_response
    from ...tuning.verdict import judge

    model = fit_response(response)

    def gone(conditions: Conditions) -> bool:
        return judge(model, _grid_of(conditions, model.f1_hz)).verdict == "stable"

    return gone


def _grid_of(conditions: Conditions, f1_hz: float) -> Grid:
    if conditions.circuit is not None:
        return CircuitGrid(f1_hz, conditions.circuit)
    return SeriesRL(conditions.r_ohm, 2.0 * np.pi * f1_hz * conditions.l_h, f1_hz)


def verify(tuned: Tuned, story: Story | None = None, cause_gone: CauseGone | None = None) -> Verification:
    """Drive the device through the story without and with damping control; without alone where there is no gain.

    Parameters
    ----------
    tuned : Tuned
        From `tuned_of`.
    story : Story, optional
        Default: the grid steps from 1.2/1.4 of the tuned impedance to all of it at 0.1 s.
    cause_gone : callable, optional
        Says where damping control may stop, see `cause_gone_of`; without it, it stays.

    Raises
    ------
    VerifyError
        If there is no state to begin from, or the device gives up on the way.
    """
    story = story or Story()
    return compare(tuned, scenario_of(tuned, story), settings_of(tuned), story.duration_s, cause_gone)


def compare(
    tuned: Tuned,
    scenario: Scenario,
    settings: DampingSettings | None,
    duration_s: float,
    cause_gone: CauseGone | None = None,
) -> Verification:
    """Both runs of a scenario, reported."""
    without = _driven("without", tuned.plant, scenario, None, duration_s)
    damped, threshold = None, THRESHOLD
    if settings is not None:
        damped = _driven("with", tuned.plant, scenario, settings, duration_s, cause_gone)
        threshold = settings.threshold
    driven = (without,) if damped is None else (without, damped)
    reports = tuple(report(trajectory, scenario.events, threshold) for trajectory in driven)
    remarks = tuple(_remarks(tuned, scenario, duration_s, without))
    return Verification(tuned, scenario, settings, duration_s, without, damped, reports, remarks)


def _driven(
    how: str,
    plant: Plant,
    scenario: Scenario,
    settings: DampingSettings | None,
    duration_s: float,
    cause_gone: CauseGone | None = None,
) -> Trajectory:
    """One run; a device that gives up on the way is told in its own words."""
    try:
        return simulate(plant, scenario, settings, duration_s, cause_gone=cause_gone)
    except NotSettled as refusal:
        raise VerifyError(f"the scenario has no state to begin from: {refusal}") from None
    except SeqsweepError:
        raise
    except Exception as error:
        raise VerifyError(
            f"the run {how} damping control does not come to its end: {in_words(error)}; a shorter duration_s in a "
            "scenario file shows what goes before"
        ) from None


def has_equilibrium(plant: Plant, scenario: Scenario, time_s: float) -> bool:
    """Whether the device has a periodic state, stable or not, on what surrounds it at ``time_s``."""
    assert isinstance(plant, MeasuredPlant)
    now = conditions_at(scenario, time_s)
    source = source_of(now, scenario.source_voltage_v)
    try:
        plant.equilibrium(
            OperatingPoint(scenario.active_power_w * now.power_scale, None, scenario.reactive_power_var), source
        )
    except (NotSettled, ValueError):
        return False
    return True


def _remarks(tuned: Tuned, scenario: Scenario, duration_s: float, without: Trajectory) -> Iterable[str]:
    if not has_equilibrium(tuned.plant, scenario, duration_s):
        yield (
            "no operating point that carries this power was found on the grid after the events: where there is none, "
            "no control can find one"
        )
    undamped = why_undamped(tuned)
    if undamped:
        yield f"simulated without damping control alone: {undamped}"
    elif tuned.k == 0.0:
        yield "k is 0: the tuning asks for no damping, both runs are the same"
    first = min((event.time_s for event in scenario.events), default=duration_s)
    before = without.ratio[without.decision_s <= first]
    if np.any(before > 1e-3):
        yield "it resonates before the first event: the beginning is unstable"
