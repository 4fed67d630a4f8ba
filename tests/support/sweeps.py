"""What several tests do with a plant: plan a campaign in memory, sweep it, compare with the truth."""

from __future__ import annotations

import numpy as np

from seqsweep.sweep.config.sections import Config
from seqsweep.sweep.measure.linearity import covariance_of, judged
from seqsweep.sweep.measure.measure import measure
from seqsweep.sweep.planning import make_plan


def planned(plant, *, f_hz=None, point=None, sweep=None, **sections):
    """The plan of a campaign; ``sweep`` is its section, ``f_hz`` a list for it."""
    content = {
        "campaign": {"name": "test"},
        "plant": {"id": "branch-v1"},
        "operating_point": [point or {"active_power_mw": 0.65, "terminal_voltage_pu": 1.0}],
        "sweep": ({} if f_hz is None else {"f_hz": f_hz}) | (sweep or {}),
        **sections,
    }
    return make_plan(Config.from_dict(content), plant)


def rows_of(plant, plan):
    """Rows of the first operating point, ascending, as the table has them."""
    rows = [row for batch in plan.batches() for row in measure(plant, batch).rows]
    return judged(sorted(rows, key=lambda row: row.f_hz), plan.nonlinear_above)


def y_of(rows):
    """Admittances (n, 2, 2) in S."""
    return np.array([row.admittance for row in rows])


def errors(rows, exact):
    """Relative errors (n,), ||dY||_F / ||Y||_F, against ``exact`` (n, 2, 2)."""
    return np.linalg.norm(y_of(rows) - exact, axis=(1, 2)) / np.linalg.norm(exact, axis=(1, 2))


def inside(rows, exact, level=0.95):
    """(n, 4) bool: which elements' regions of that level hold the exact value, with normal quantiles."""
    variance = np.array([np.diagonal(covariance_of(row)).reshape(4, 2).sum(axis=1) for row in rows])
    off = (y_of(rows) - exact).reshape(-1, 4)
    return np.abs(off) ** 2 <= -np.log(1.0 - level) * variance


def swept(plant, f_hz, **sections):
    """Admittances (n, 2, 2) in S of ``plant`` at 0.2 MW and rated voltage, where every row is ok."""
    point = {"active_power_mw": 0.2, "terminal_voltage_pu": 1.0}
    rows = rows_of(plant, planned(plant, f_hz=f_hz, point=point, **sections))
    assert [row.status for row in rows] == ["ok"] * len(rows), rows
    return y_of(rows)
