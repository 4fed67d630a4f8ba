"""A sweep of a plant at hand, without command and processes."""

from __future__ import annotations

import numpy as np

from seqsweep.sweep.config import Config
from seqsweep.sweep.measure import measure
from seqsweep.sweep.plan import make_plan


def swept(plant, f_hz, **sections):
    """(n, 2, 2) admittance of ``plant`` at 0.2 MW and rated voltage; every point must be ok."""
    config = {
        "campaign": {"name": "at hand"},
        "plant": {"id": "branch-v1"},
        "operating_point": [{"id": "a", "active_power_mw": 0.2, "terminal_voltage_pu": 1.0}],
        "sweep": {"f_hz": f_hz},
        **sections,
    }
    plan = make_plan(Config.from_dict(config), plant)
    found = (row for batch in plan.batches() for row in measure(plant, plan, batch).rows)
    rows = sorted(found, key=lambda row: row.f_hz)
    assert [row.status for row in rows] == ["ok"] * len(f_hz), rows
    parts = np.array([row.y for row in rows])
    return (parts[:, 0::2] + 1j * parts[:, 1::2]).reshape(-1, 2, 2)
