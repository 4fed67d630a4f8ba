"""The conformance check passes every registered plant and catches each broken one by its own finding."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field, replace
from types import SimpleNamespace

import numpy as np
import pytest

from seqsweep.plant.check import Finding, check_plant
from seqsweep.plant.promises import PROMISES
from seqsweep.plant.protocol import Injection, Job, NotSettled, OperatingPoint, Phasors, Source
from seqsweep.plant.registry import is_built_in, make_plant, registered_ids
from seqsweep.plant.rl_branch import BranchState, RLBranch

GRID = Source("thevenin", r_ohm=0.012, l_h=0.8e-3, angle_rad=0.3)


def failed(findings):
    return {finding.name for finding in findings if not finding.passed}


@pytest.mark.parametrize("source", [None, Source(angle_rad=1.0), GRID], ids=["default", "turned", "grid"])
@pytest.mark.parametrize("plant_id", [name for name in registered_ids() if is_built_in(name)])
def test_every_registered_plant_keeps_its_promise(plant_id, source):
    findings = check_plant(make_plant(plant_id), source=source)
    assert not failed(findings), findings
    assert [finding.name for finding in findings] == list(PROMISES)
    assert all(isinstance(finding, Finding) and finding.detail for finding in findings)


def test_a_period_that_is_no_whole_number_of_steps_is_no_fault():
    assert not failed(check_plant(RLBranch(dt_s=70e-6, f1_hz=60.0)))


def test_the_operating_point_and_the_source_given_are_the_ones_checked():
    findings = check_plant(RLBranch(), OperatingPoint(5.0, 700.0), GRID)
    assert not failed(findings)
    assert findings[1].detail == "at 5 W and 700 V, thevenin source"
    fixed = replace(GRID, voltage_v=690.0)
    assert not failed(check_plant(RLBranch(), source=fixed))
    assert not failed(check_plant(RLBranch(), OperatingPoint(0.0, None), fixed))


# ---------------------------------------------------------------------- plants that break one promise each


class Recording(RLBranch):
    """A sound plant without `run_phasors`; each heir breaks one promise."""

    run_phasors = None

    def changed(self, job, end, record):
        return end, record

    def run(self, jobs, n_steps):
        pairs = zip(jobs, super().run(jobs, n_steps), strict=True)
        return [self.changed(job, end, record) for job, (end, record) in pairs]


class ChangesItsState(Recording):
    def changed(self, job, end, record):
        object.__setattr__(job.state, "i", end.i)
        return end, record


@dataclass(frozen=True, slots=True)
class LoggingState(BranchState):
    log: list = field(default_factory=list)


class WritesIntoItsState(Recording):
    """Harmless to the numbers, and yet a state that two threads share."""

    def settle(self, operating_point, source):
        state = super().settle(operating_point, source)
        return LoggingState(state.step, state.time_s, state.i, state.v_source, state.source)

    def changed(self, job, end, record):
        if isinstance(job.state, LoggingState):
            job.state.log.append("run")
        return end, record


class DependsOnNeighbours(Recording):
    """Two lanes share a register: jobs beside others are off by a hair."""

    def run(self, jobs, n_steps):
        hair = 1.0 + 1e-10 * (len(jobs) - 1)
        return [(end, replace(record, i=hair * record.i)) for end, record in super().run(jobs, n_steps)]


class MixesItsLanes(Recording):
    """More than eight jobs come back in another order."""

    def run(self, jobs, n_steps):
        results = super().run(jobs, n_steps)
        return results if len(jobs) <= 8 else results[8:] + results[:8]


class KeepsTheFirstOperatingPoint(Recording):
    def run(self, jobs, n_steps):
        source = jobs[0].state.v_source
        return super().run([Job(replace(job.state, v_source=source), job.injection) for job in jobs], n_steps)


class OneSampleTooMany(Recording):
    def changed(self, job, end, record):
        return end, replace(record, v=np.append(record.v, 0.0), i=np.append(record.i, 0.0))


class OneResultTooFew(Recording):
    def run(self, jobs, n_steps):
        return super().run(jobs, n_steps)[:-1]


class RealWaveforms(Recording):
    def changed(self, job, end, record):
        return end, replace(record, v=record.v.real)


class ClockStandsStill(Recording):
    def changed(self, job, end, record):
        return replace(end, time_s=0.0), record


class EndsInNaN(Recording):
    def changed(self, job, end, record):
        return end, replace(record, i=np.where(np.arange(len(record.i)) < 1000, record.i, np.nan))


class RollsDice(Recording):
    def __init__(self):
        super().__init__()
        self.dice = np.random.default_rng(1)

    def changed(self, job, end, record):
        return end, replace(record, i=record.i * (1.0 + 1e-10 * self.dice.standard_normal()))


class SettlesElsewhereEachTime(Recording):
    def __init__(self):
        super().__init__()
        self.count = itertools.count()

    def settle(self, operating_point, source):
        return super().settle(operating_point, replace(source, angle_rad=0.1 * next(self.count)))


class ForgetsWhereItWas(Recording):
    """A filter of the measurement starts anew with every run: two parts are not one whole."""

    def changed(self, job, end, record):
        fresh = 1.0 - 1e-6 * np.exp(-np.arange(len(record.i)) / 3.0)
        return end, replace(record, i=record.i * fresh)


class Mirrored(Recording):
    """beta has the wrong sign."""

    def changed(self, job, end, record):
        return end, replace(record, v=record.v.conj(), i=record.i.conj())


def with_tones(job, **changes):
    if job.injection is None:
        return job
    tones = tuple(replace(tone, **{k: f(tone, job) for k, f in changes.items()}) for tone in job.injection.tones)
    return Job(job.state, Injection(job.injection.kind, tones))


class TonesTurnBackwards(Recording):
    def run(self, jobs, n_steps):
        return super().run([with_tones(job, f_hz=lambda tone, job: -tone.f_hz) for job in jobs], n_steps)


class TonesStartWithTheRun(Recording):
    """Time since the branch, where the state's time is promised: a run in two parts shows it, too."""

    def run(self, jobs, n_steps):
        def phase_rad(tone, job):
            return tone.phase_rad - 2.0 * np.pi * tone.f_hz * job.state.time_s

        return super().run([with_tones(job, phase_rad=phase_rad) for job in jobs], n_steps)


class TonesAreRms(Recording):
    def run(self, jobs, n_steps):
        return super().run(
            [with_tones(job, amplitude=lambda tone, job: 1.414 * tone.amplitude) for job in jobs], n_steps
        )


class NotSettledYet(Recording):
    def settle(self, operating_point, source):
        state = super().settle(operating_point, source)
        return replace(state, i=1.001 * state.i)


class IgnoresTheInjection(Recording):
    def run(self, jobs, n_steps):
        jobs = [Job(job.state, job.injection if self._is_shunt(job) else None) for job in jobs]
        return super().run(jobs, n_steps)

    @staticmethod
    def _is_shunt(job):
        return job.injection is not None and job.injection.kind == "shunt_current"


class LineToLinePeaks(Recording):
    """v is sqrt(3) too large: everything but its size is right."""

    def settle(self, operating_point, source):
        state = super().settle(operating_point, source)
        return replace(state, v_source=1.7320508 * state.v_source, i=1.7320508 * state.i)


class AcceptsShuntCurrent(Recording):
    def run(self, jobs, n_steps):
        return super().run(
            [Job(job.state, None) if IgnoresTheInjection._is_shunt(job) else job for job in jobs], n_steps
        )


class ShuntCurrentStopsIt(Recording):
    def run(self, jobs, n_steps):
        if any(IgnoresTheInjection._is_shunt(job) for job in jobs):
            raise NotImplementedError("no current source here")
        return super().run(jobs, n_steps)


class SettlesAnywhere(Recording):
    def settle(self, operating_point, source):
        low, high = self.operating_range.terminal_voltage_v
        clipped = min(max(operating_point.terminal_voltage_v, low), high)
        return super().settle(replace(operating_point, terminal_voltage_v=clipped), source)


@dataclass(frozen=True)
class StateWithHandle(BranchState):
    handle: object = None


class CannotBePickled(Recording):
    def changed(self, job, end, record):
        return StateWithHandle(end.step, end.time_s, end.i, end.v_source, end.source, handle=lambda: None), record

    def settle(self, operating_point, source):
        return self.changed(None, super().settle(operating_point, source), None)[0]


class PhasorsOfAnotherTaper(RLBranch):
    def run_phasors(self, jobs, windows, block_steps, n_blocks):
        results = super().run_phasors(jobs, windows, block_steps, n_blocks)
        return [(end, Phasors(phasors.v, phasors.i * (1.0 + 1e-6))) for end, phasors in results]


class PhasorsStopTheClock(RLBranch):
    def run_phasors(self, jobs, windows, block_steps, n_blocks):
        results = super().run_phasors(jobs, windows, block_steps, n_blocks)
        return [(job.state, phasors) for job, (_, phasors) in zip(jobs, results, strict=True)]


class PhasorsLackTheMirror(RLBranch):
    def run_phasors(self, jobs, windows, block_steps, n_blocks):
        results = super().run_phasors(jobs, windows, block_steps, n_blocks)
        return [(end, Phasors(phasors.v[:, :1], phasors.i[:, :1])) for end, phasors in results]


class Raises(Recording):
    def run(self, jobs, n_steps):
        raise RuntimeError("segment 7\nhas no licence")


class RaisesLater(Recording):
    def run(self, jobs, n_steps):
        if len(jobs) > 8:
            raise MemoryError("twelve lanes")
        return super().run(jobs, n_steps)


class NeverSettles(Recording):
    def settle(self, operating_point, source):
        raise NotSettled("the equilibrium is unstable", status="diverged")


class NoRating(Recording):
    def __init__(self):
        super().__init__()
        del self.rating


class StepOfMinusOne(Recording):
    def __init__(self):
        super().__init__()
        self.dt_s = -1.0


@pytest.mark.parametrize(
    ("broken", "caught"),
    [
        (ChangesItsState, {"state_unchanged", "steady", "repeatable", "halves", "neighbours"}),
        (WritesIntoItsState, {"state_unchanged"}),
        (DependsOnNeighbours, {"neighbours"}),
        (MixesItsLanes, {"neighbours"}),
        (KeepsTheFirstOperatingPoint, {"neighbours"}),
        (OneSampleTooMany, {"samples"}),
        (OneResultTooFew, {"samples"}),
        (RealWaveforms, {"samples"}),
        (ClockStandsStill, {"samples"}),
        (EndsInNaN, {"finite"}),
        (RollsDice, {"repeatable", "neighbours", "state_picklable"}),
        (SettlesElsewhereEachTime, {"repeatable"}),
        (ForgetsWhereItWas, {"halves"}),
        (Mirrored, {"sequence", "terminal_voltage", "tone_time"}),
        (TonesTurnBackwards, {"sequence", "tone_time"}),
        (TonesStartWithTheRun, {"tone_time", "halves"}),
        (TonesAreRms, {"tone_time"}),
        (NotSettledYet, {"steady"}),
        (IgnoresTheInjection, {"reacts", "tone_time"}),
        (LineToLinePeaks, {"terminal_voltage"}),
        (AcceptsShuntCurrent, {"shunt_refused"}),
        (ShuntCurrentStopsIt, {"shunt_refused"}),
        (SettlesAnywhere, {"range_refused"}),
        (CannotBePickled, {"state_picklable"}),
        (PhasorsOfAnotherTaper, {"phasors"}),
        (PhasorsStopTheClock, {"phasors"}),
        (PhasorsLackTheMirror, {"phasors"}),
        (Raises, {"samples"}),
        (RaisesLater, {"neighbours"}),
        (NeverSettles, {"settles"}),
        (NoRating, {"attributes"}),
        (StepOfMinusOne, {"attributes"}),
    ],
)
def test_a_broken_plant_is_caught_by_the_finding_of_its_fault_and_no_other(broken, caught):
    findings = check_plant(broken())
    assert failed(findings) == caught, [finding for finding in findings if not finding.passed]


def test_the_sound_plant_that_the_broken_ones_are_made_from_passes():
    assert not failed(check_plant(Recording()))


def test_a_gate_that_fails_ends_the_list_and_anything_else_does_not():
    assert [finding.name for finding in check_plant(NeverSettles())] == ["attributes", "settles"]
    assert len(check_plant(NotSettledYet())) == 17


def test_what_a_plant_raises_is_told_in_one_line():
    assert check_plant(Raises())[-1] == Finding("samples", False, "segment 7 has no licence")
    assert check_plant(NeverSettles())[-1].detail == "the equilibrium is unstable"
    (shunt,) = (finding for finding in check_plant(ShuntCurrentStopsIt()) if finding.name == "shunt_refused")
    assert shunt.detail == "a ValueError is promised; it raised NotImplementedError: no current source here"


def test_anything_at_all_may_be_checked():
    (finding,) = check_plant(SimpleNamespace(id="x"))
    assert finding.name == "attributes"
    assert finding.detail.startswith("the plant lacks f1_hz, dt_s")
