"""How long a campaign is expected to take: what a device does once is not multiplied by its shots."""

from __future__ import annotations

import time
from types import SimpleNamespace

import pytest

from seqsweep.plant.rl_branch import RLBranch
from seqsweep.sweep.config.sections import Config
from seqsweep.sweep.measure.tones import RUN_BLOCKS
from seqsweep.sweep.planning import make_plan
from seqsweep.sweep.run import wall_time
from seqsweep.sweep.run.wall_time import wall_time_s

ONCE_S = 1.5
CAMPAIGN = {
    "campaign": {"name": "once"},
    "plant": {"id": "branch-v1"},
    "operating_point": [{"id": "p", "active_power_mw": 0.65, "terminal_voltage_pu": 1.0}],
    "sweep": {"f_min_hz": 20.0, "f_max_hz": 900.0, "points": 24},
}


class SlowAtFirst(RLBranch):
    """The branch, whose first call takes as long as a kernel that is compiled."""

    warm = False

    def run(self, jobs, n_steps):
        self._warm_up()
        return super().run(jobs, n_steps)

    def run_phasors(self, jobs, windows, block_steps, n_blocks):
        self._warm_up()
        return super().run_phasors(jobs, windows, block_steps, n_blocks)

    def _warm_up(self):
        if not self.warm:
            self.warm = True
            time.sleep(ONCE_S)


def test_a_first_call_that_compiles_is_not_taken_for_the_cost_of_every_block():
    plant = SlowAtFirst()
    assert wall_time_s(make_plan(Config.from_dict(CAMPAIGN), plant), plant, 1) < 10.0


def test_what_batches_share_is_not_multiplied_by_them(monkeypatch):
    """Rounds of batches that are measured together cost once: a batch alone took 0.5 s beside stepping, four 0.8 s."""
    points = [{"active_power_mw": 0.2 + 0.01 * k, "terminal_voltage_pu": 1.0} for k in range(20)]
    sweep = {"f_min_hz": 20.0, "f_max_hz": 900.0, "points": 60}
    plant = RLBranch()
    plan = make_plan(Config.from_dict({**CAMPAIGN, "operating_point": points, "sweep": sweep}), plant)
    (batch,) = plan.batches_at(plan.conditions[0])
    blocks_of = wall_time._blocks(batch, {})
    alone = wall_time.Cost(1e-3, 8, 0.0, 0.5, {})
    stepping_s = 1e-3 * RUN_BLOCKS * wall_time._runs(blocks_of, 8, wall_time.TOGETHER)
    clock = iter([0.0, stepping_s + 0.8])
    monkeypatch.setattr(wall_time, "measure_together", lambda plant, batches: None)
    monkeypatch.setattr(wall_time, "time", SimpleNamespace(perf_counter=lambda: next(clock)))
    cost = wall_time._in_company(plan, plant, batch, alone)
    assert cost.beside_s == pytest.approx(0.1)
    assert cost.round_s * wall_time._rounds(blocks_of) == pytest.approx(0.4)
