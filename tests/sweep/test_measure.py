"""The worker of a campaign: what becomes of plants that fail, and what a result depends on."""

from __future__ import annotations

import re
from math import isnan

import numpy as np
import pytest

from seqsweep.plant.rl_branch import RLBranch, admittance
from seqsweep.plant.turbine.reference import ReferenceTurbine
from seqsweep.sweep.config.sections import Config
from seqsweep.sweep.measure.measure import measure, measure_together
from seqsweep.sweep.planning import make_plan

from ..support import plants

F_HZ = [20.0, 70.0, 95.0, 130.0, 300.0]
"""`plants.FailingBranch` fails for tones from 90 to 110 Hz: for the point at 95 Hz alone."""


def planned(plant, *, f_hz=F_HZ, point=None, sweep=None, **sections):
    content = {
        "campaign": {"name": "measure"},
        "plant": {"id": "branch-v1"},
        "operating_point": [point or {"active_power_mw": 0.65, "terminal_voltage_pu": 1.0}],
        "sweep": {"f_hz": f_hz} if sweep is None else sweep,
        **sections,
    }
    return make_plan(Config.from_dict(content), plant)


def rows_of(plant, plan):
    rows = [row for batch in plan.batches() for row in measure(plant, batch).rows]
    return sorted(rows, key=lambda row: row.f_hz)


def y_of(rows):
    parts = np.array([row.y for row in rows])
    return (parts[:, ::2] + 1j * parts[:, 1::2]).reshape(-1, 2, 2)


# Plants that fail


@pytest.mark.parametrize(
    ("make", "how", "status", "words"),
    [
        (plants.FailingBranch, "raises", "failed", "the converter tripped"),
        (plants.FailingBranch, "nan", "diverged", "not finite"),
        (plants.FailingBranch, "short", "failed", r"shapes \(14, 2\) and \(14, 2\); \(15, 2\) is needed"),
        (plants.FailingRecordingBranch, "raises", "failed", "the converter tripped"),
        (plants.FailingRecordingBranch, "nan", "diverged", "not finite"),
        (plants.FailingRecordingBranch, "short", "failed", r"gave \d+ and \d+ samples of v and i; \d+ were asked"),
        (plants.FailingRecordingBranch, "wrong step", "failed", "f1_hz or dt_s is not that of the plant"),
    ],
)
def test_a_fault_at_one_frequency_costs_that_frequency_alone(make, how, status, words):
    plant, sound_plant = make(how), RLBranch() if make is plants.FailingBranch else plants.RecordingBranch()
    rows, sound = rows_of(plant, planned(plant)), rows_of(sound_plant, planned(sound_plant))
    assert [row.status for row in rows] == ["ok", "ok", status, "ok", "ok"]
    bad = rows.pop(2)
    asked = sound.pop(2)
    assert re.search(words, bad.reason)
    assert np.all(np.isnan(bad.y))
    assert isnan(bad.cond_v)
    assert (bad.n_periods, bad.window_s, bad.amplitude_pu) == (asked.n_periods, asked.window_s, asked.amplitude_pu)
    assert rows == sound or repr(rows) == repr(sound)  # to the last bit what they are beside a sound neighbour


def test_too_few_answers_are_a_fault_of_the_plant():
    plant = plants.FailingRecordingBranch("few")
    assert {(row.status, row.reason) for row in rows_of(plant, planned(plant, sweep={"f_hz": F_HZ, "probes": 0}))} == {
        ("failed", "run gave 2 answers to 3 jobs")
    }


def test_a_plant_that_cannot_settle_fails_every_row_with_its_own_words():
    plant = plants.UnwillingBranch()
    rows = rows_of(plant, planned(plant))
    assert len(rows) == len(F_HZ)
    assert {(row.status, row.reason) for row in rows} == {("failed", "no licence server found")}


@pytest.mark.parametrize(
    ("error", "reason"),
    [
        (ValueError("p_ref of 3 pu:\n  at most 1.2"), "p_ref of 3 pu: at most 1.2"),
        (ValueError(), "ValueError"),
        (KeyError("p_ref"), "KeyError: 'p_ref'"),
        (ZeroDivisionError("division by zero"), "ZeroDivisionError: division by zero"),
    ],
)
def test_a_reason_is_the_message_and_the_class_where_the_message_says_nothing(error, reason, monkeypatch):
    def refuse(*_):
        raise error

    plant = plants.UnwillingBranch()
    monkeypatch.setattr(plant, "settle", refuse)
    assert {row.reason for row in rows_of(plant, planned(plant))} == {reason}


def test_a_steady_state_that_is_none_is_found_out():
    """`settle` is believed only as far as two unperturbed periods agree."""
    plant = plants.DriftingBranch()
    rows = rows_of(plant, planned(plant))
    assert {row.status for row in rows} == {"not_settled"}
    assert "unperturbed waveforms change by 2e-05 of their peak over one period; 1e-06 is needed" in rows[0].reason


def test_a_response_that_grows_for_ever_is_given_up_as_diverged():
    plant = plants.GrowingBranch()
    rows = rows_of(plant, planned(plant, sweep={"f_hz": F_HZ, "max_simulated_s": 2.0}))
    assert {row.status for row in rows} == {"diverged"}
    assert "grows by a factor" in rows[0].reason
    assert all(row.residual > 0.1 for row in rows)


def test_a_response_that_does_not_come_to_rest_in_time_says_what_to_change():
    plant = ReferenceTurbine()
    rows = rows_of(plant, planned(plant, sweep={"f_hz": F_HZ, "tolerance": 1e-15, "max_simulated_s": 1.0}))
    assert {row.status for row in rows} == {"not_settled"}
    for row in rows:
        assert re.search(r"after 0.\d s; 1e-15 is asked .raise sweep.max_simulated_s or sweep.tolerance", row.reason)
        assert row.residual > 1e-15


def test_a_perturbation_that_does_not_arrive_is_told_and_not_divided_by():
    plant = plants.FailingBranch("silent")
    rows = rows_of(plant, planned(plant))
    assert [row.status for row in rows] == ["ok", "ok", "ill_conditioned", "ok", "ok"]
    assert "the perturbation does not arrive" in rows[2].reason


@pytest.mark.parametrize("kind", ["series_voltage", "shunt_current"])
def test_an_unstable_loop_gives_diverged_rows_with_the_reason(kind):
    """1.4 Z of Table I's line in place: the load flow exists, the equilibrium is unstable."""
    plant = ReferenceTurbine()
    grid = {"r_ohm": 0.012, "x_ohm": 0.25, "scale": 1.4}
    plan = planned(
        plant,
        point={"active_power_mw": 0.65, "grid": grid},
        source={"kind": "thevenin"},
        injection={"kind": kind},
    )
    rows = rows_of(plant, plan)
    assert len(rows) == len(F_HZ)
    assert {row.status for row in rows} == {"diverged"}
    assert "unstable: +9.57 rad/s at 26.3 Hz" in rows[0].reason
    assert np.all(np.isnan(y_of(rows)))


# What a result depends on


def test_a_plant_without_phasors_gives_the_rows_of_one_with_them():
    """Two paths that share no line of code between plant and solve: block sums less the harmonics of the
    steady state, and records less the unperturbed branch. 1e-9: the tone is 1e-3 of what is subtracted,
    and the certified steady state of the turbine is allowed 1e-9 of its own.
    """
    for fast, slow in ((RLBranch(), plants.RecordingBranch()), (ReferenceTurbine(), plants.RecordingTurbine())):
        a, b = rows_of(fast, planned(fast)), rows_of(slow, planned(slow))
        assert {row.status for row in a + b} == {"ok"}
        y = y_of(a)
        worst = np.max(np.linalg.norm(y_of(b) - y, axis=(1, 2)) / np.linalg.norm(y, axis=(1, 2)))
        print(f"\n  {fast.id}: phasors against records, worst {worst:.1e} (bar 1e-9)", end="")
        assert worst <= 1e-9
        assert [row.window_s for row in a] == [row.window_s for row in b]


def test_a_point_is_the_same_to_the_last_bit_whatever_shares_its_batch():
    plant = ReferenceTurbine()
    plan = planned(plant, sweep={"f_min_hz": 1.0, "f_max_hz": 1000.0, "points": 24})
    together = {row.f_hz: row for batch in plan.batches() for row in measure(plant, batch).rows}
    condition = plan.conditions[0]
    rng = np.random.default_rng(1)
    shuffled = [plan.points[k] for k in rng.permutation(len(plan.points))]
    for size in (1, 5, len(shuffled)):
        for first in range(0, len(shuffled), size):
            batch = plan.batch(condition, tuple(shuffled[first : first + size]))
            for row in measure(plant, batch).rows:
                assert repr(row) == repr(together[row.f_hz])  # repr: NaN equals itself, and no bit is lost


def test_operating_points_measured_together_are_the_same_to_the_last_bit_as_alone():
    plant = ReferenceTurbine()
    points = [
        {"id": f"p{k}", "active_power_mw": power_mw, "terminal_voltage_pu": 1.0}
        for k, power_mw in enumerate((0.3, 1.25, 0.65, 0.9))
    ]
    plan = planned(plant, f_hz=[3.0, 49.0, 77.0, 300.0], operating_point=points)
    batches = list(plan.batches())
    assert len(batches) == len(points)
    for batch, together in zip(batches, measure_together(plant, batches), strict=True):
        assert repr(together) == repr(measure(plant, batch))


def test_what_fails_among_several_costs_its_own_points_alone():
    plant, sound = plants.FailingBranch("raises"), RLBranch()
    points = [{"id": name, "active_power_mw": 0.65, "terminal_voltage_pu": 1.0} for name in "ab"]
    of_both = measure_together(plant, list(planned(plant, operating_point=points).batches()))
    alone = list(planned(sound, operating_point=points).batches())
    for found, expected in zip(of_both, measure_together(sound, alone), strict=True):
        assert [row.status for row in found.rows].count("failed") == 1
        kept = {row.f_hz: repr(row.y) for row in found.rows if row.status == "ok"}
        assert kept == {row.f_hz: repr(row.y) for row in expected.rows if row.f_hz in kept}


def test_the_rows_come_in_the_order_of_the_batch():
    plant = RLBranch()
    plan = planned(plant)
    (batch,) = plan.batches()
    reverse = plan.batch(batch.condition, batch.points[::-1])
    assert [row.f_hz for row in measure(plant, reverse).rows] == [point.f_hz for point in reverse.points]


def test_a_steady_state_found_at_any_time_is_as_good():
    """Phasors refer to absolute time; a plant that waited has another phi1, and the same admittance."""
    plant = plants.LateBranch()
    rows = rows_of(plant, planned(plant))
    assert {row.status for row in rows} == {"ok"}
    exact = admittance(plant, np.array(F_HZ))
    assert np.max(np.linalg.norm(y_of(rows) - exact, axis=(1, 2)) / np.linalg.norm(exact, axis=(1, 2))) <= 1e-8


def test_the_steady_state_is_seen_and_kept():
    plant = ReferenceTurbine()
    plan = planned(plant, source={"kind": "thevenin", "r_ohm": 0.012, "x_ohm": 0.25})
    seen = measure(plant, next(iter(plan.batches()))).condition
    assert seen["voltage_v"] == pytest.approx(690.0, rel=1e-9)
    assert 0.0 <= seen["settle_residual"] <= 1e-9
