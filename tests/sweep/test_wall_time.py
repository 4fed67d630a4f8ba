"""How long a campaign is expected to take: what a device does once is not multiplied by its shots."""

from __future__ import annotations

import time

from seqsweep.plant.rl_branch import RLBranch
from seqsweep.sweep.config.sections import Config
from seqsweep.sweep.planning import make_plan
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
