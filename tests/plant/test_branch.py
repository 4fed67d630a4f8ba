"""The R-L branch against its closed forms and against a slow, obvious stepper."""

from __future__ import annotations

import cmath
from dataclasses import replace
from math import pi, sqrt

import numpy as np
import pytest

from seqsweep.plant.protocol import Injection, Job, OperatingPoint, Source, Tone, Window
from seqsweep.plant.rl_branch import RLBranch, admittance, continuous_admittance

BRANCH = RLBranch()
AT_RATED = OperatingPoint(0.0, 690.0)
IDEAL = Source(angle_rad=0.3)
GRID = Source("thevenin", r_ohm=0.012, l_h=0.8e-3, angle_rad=0.3)
LINES_HZ = (1.0, 23.0, 47.0, 60.0, 99.0, 100.0, 101.0, 150.0, 400.0, 1000.0)
WARM_UP_STEPS = 8000
"""0.4 s, 40 time constants L/R: the transient of the tone's onset is below 1e-17."""


def tone(f_hz, amplitude=0.5, phase_rad=0.4, kind="series_voltage"):
    return Injection(kind, (Tone(f_hz, amplitude, phase_rad),))


def swept(branch, source, kind, f_hz, listen):
    """Y at f from two injections, the unperturbed run subtracted; ``listen(branch, jobs, f)`` gives V and I."""
    state = branch.settle(AT_RATED, source)
    injections = [None, tone(f_hz, kind=kind), tone(2.0 * branch.f1_hz - f_hz, kind=kind)]
    warm = [end for end, _ in branch.run([Job(state, injection) for injection in injections], WARM_UP_STEPS)]
    base, *both = listen(branch, [Job(end, injection) for end, injection in zip(warm, injections, strict=True)], f_hz)
    v, i = (np.array([x[quantity] - base[quantity] for x in both]).T for quantity in (0, 1))
    v[1], i[1] = v[1].conj(), i[1].conj()
    return i @ np.linalg.inv(v)


def phasors_while_stepping(branch, jobs, f_hz):
    """One tapered window of 1 s in ten blocks: it tells lines 3 Hz apart."""
    results = branch.run_phasors(jobs, [Window(f_hz, 10)] * len(jobs), 2000, 10)
    return [(phasors.v.sum(axis=0), phasors.i.sum(axis=0)) for _, phasors in results]


def phasors_of_records(branch, jobs, f_hz):
    """One plain window of 1 s, which every line here fits in whole periods."""
    lines = np.array([[f_hz], [2.0 * branch.f1_hz - f_hz]])
    records = [record for _, record in branch.run(jobs, 20000)]
    turn = np.exp(-2j * pi * lines * records[0].time_s)
    return [(np.mean(turn * record.v, axis=1), np.mean(turn * record.i, axis=1)) for record in records]


@pytest.mark.parametrize("listen", [phasors_while_stepping, phasors_of_records])
@pytest.mark.parametrize(
    ("source", "kind"), [(IDEAL, "series_voltage"), (GRID, "series_voltage"), (GRID, "shunt_current")]
)
def test_the_swept_branch_equals_its_closed_form(source, kind, listen):
    """Rounding alone, some 1e-13 of 563 V in a 0.5 V tone, and the grid's share of it: 1e-9."""
    for f_hz in LINES_HZ:
        y = swept(BRANCH, source, kind, f_hz, listen)
        error = np.linalg.norm(y - admittance(BRANCH, f_hz)) / np.linalg.norm(admittance(BRANCH, f_hz))
        assert error < 1e-9, f_hz


def test_the_warped_closed_form_tends_to_the_continuous_one_with_the_square_of_the_step():
    def gap(dt_s):
        branch = RLBranch(dt_s=dt_s)
        return abs(admittance(branch, 1000.0)[0, 0] / continuous_admittance(branch, 1000.0)[0, 0] - 1.0)

    assert gap(50e-6) == pytest.approx((pi * 1000.0 * 50e-6) ** 2 / 3.0, rel=0.02)  # tan x = x + x^3/3 + ...
    assert gap(50e-6) / gap(5e-6) == pytest.approx(100.0, rel=0.02)


def test_the_closed_form_has_the_mirror_symmetry_of_a_real_system():
    f_hz = np.array(LINES_HZ)
    here, mirrored = admittance(BRANCH, f_hz), admittance(BRANCH, 2.0 * BRANCH.f1_hz - f_hz)
    np.testing.assert_array_equal(here[:, 1, 1], mirrored[:, 0, 0].conj())
    assert here.shape == (len(LINES_HZ), 2, 2)
    assert continuous_admittance(BRANCH, 0.0)[0, 0] == pytest.approx(1.0 / BRANCH.r_ohm)


def slow_branch(branch, state, injection, n_steps):
    """The trapezoidal rule as a book writes it: two unknowns (v_pcc and i at the next sample), solved each step."""
    source, h = state.source, branch.dt_s
    r_grid, l_grid = (source.r_ohm, source.l_h) if source.kind == "thevenin" else (0.0, 0.0)
    tones = injection.tones if injection else ()

    def grid_impedance(f_hz):
        return r_grid + l_grid * 2j / h * cmath.tan(pi * f_hz * h)

    def e(step):
        t = step * h
        total = state.v_source * cmath.exp(2j * pi * branch.f1_hz * t)
        for each in tones:
            x = each.amplitude * cmath.exp(1j * (2.0 * pi * each.f_hz * t + each.phase_rad))
            total += x if injection.kind == "series_voltage" else grid_impedance(each.f_hz) * x
        return total

    di_dt = (e(state.step) - (branch.r_ohm + r_grid) * state.i) / (branch.l_h + l_grid)
    v, i = [branch.r_ohm * state.i + branch.l_h * di_dt], [state.i]
    for step in range(state.step, state.step + n_steps):
        # branch: l (i' - i)/h + r (i' + i)/2 = (v' + v)/2; grid: l_g (i' - i)/h + r_g (i' + i)/2 = (e' + e - v' - v)/2
        a = np.array([[branch.l_h / h + branch.r_ohm / 2.0, -0.5], [l_grid / h + r_grid / 2.0, 0.5]])
        b = np.array(
            [
                (branch.l_h / h - branch.r_ohm / 2.0) * i[-1] + v[-1] / 2.0,
                (l_grid / h - r_grid / 2.0) * i[-1] + (e(step) + e(step + 1) - v[-1]) / 2.0,
            ]
        )
        i_next, v_next = np.linalg.solve(a, b)
        i.append(i_next)
        v.append(v_next)
    return np.array(v), np.array(i)


@pytest.mark.parametrize(
    ("source", "kind"), [(IDEAL, "series_voltage"), (GRID, "series_voltage"), (GRID, "shunt_current")]
)
def test_the_kernel_equals_its_slow_twin(source, kind):
    state = BRANCH.settle(AT_RATED, source)
    ((state, _),) = BRANCH.run([Job(state, None)], 123)
    injection = Injection(kind, (Tone(73.0, 20.0, 0.4), Tone(-310.0, 10.0, -1.0)))
    v, i = slow_branch(BRANCH, state, injection, 500)
    ((end, record),) = BRANCH.run([Job(state, injection)], 500)
    assert np.max(np.abs(record.v - v[:-1])) < 1e-9 * 563.0
    assert np.max(np.abs(np.append(record.i, end.i) - i)) < 1e-9 * 1000.0
    assert end.time_s == pytest.approx(623 * BRANCH.dt_s)


def test_a_shunt_current_divides_between_grid_and_branch():
    """Kirchhoff at the PCC: what the branch takes beyond the injected current came through Z_grid from v_source."""
    f_hz, h = 230.0, BRANCH.dt_s
    state = BRANCH.settle(AT_RATED, GRID)
    injection = tone(f_hz, amplitude=30.0, kind="shunt_current")
    (warm, _), (base, _) = BRANCH.run([Job(state, injection), Job(state, None)], WARM_UP_STEPS)
    (_, perturbed), (_, still) = BRANCH.run([Job(warm, injection), Job(base, None)], 10)
    injected = 30.0 * np.exp(1j * (2.0 * pi * f_hz * perturbed.time_s + 0.4))
    z_grid = GRID.r_ohm + GRID.l_h * 2j / h * np.tan(pi * f_hz * h)
    np.testing.assert_allclose(perturbed.v - still.v, -z_grid * (perturbed.i - still.i - injected), atol=1e-9)


@pytest.mark.parametrize("source", [IDEAL, GRID])
def test_the_settled_branch_repeats_and_stands_at_the_voltage_asked_for(source):
    state = BRANCH.settle(OperatingPoint(12345.0, 1.1 * 690.0), source)
    ((end, record),) = BRANCH.run([Job(state, None)], 400)
    assert abs(end.i - state.i) < 1e-12 * abs(state.i)
    np.testing.assert_allclose(np.abs(record.v), sqrt(2.0 / 3.0) * 1.1 * 690.0, rtol=1e-12)
    np.testing.assert_allclose(record.i / record.v, admittance(BRANCH, 50.0)[0, 0], rtol=1e-12)
    assert cmath.phase(state.v_source) == pytest.approx(source.angle_rad)


def test_a_source_that_fixes_its_own_voltage_gives_the_same_state():
    wanted = BRANCH.settle(AT_RATED, GRID)
    fixed = replace(GRID, voltage_v=abs(wanted.v_source) / sqrt(2.0 / 3.0))
    found = BRANCH.settle(OperatingPoint(0.0, None), fixed)
    assert found.i == pytest.approx(wanted.i, rel=1e-12)
    at_source = BRANCH.settle(OperatingPoint(0.0, None), replace(IDEAL, voltage_v=690.0))
    assert at_source.i == pytest.approx(BRANCH.settle(AT_RATED, IDEAL).i, rel=1e-12)


def test_wrong_calls_are_refused():
    state = BRANCH.settle(AT_RATED, IDEAL)
    with pytest.raises(ValueError, match="shunt_current cannot perturb a PCC held by an ideal source"):
        BRANCH.run([Job(state, tone(70.0, kind="shunt_current"))], 1)
    with pytest.raises(ValueError, match="shunt_current cannot perturb a PCC held by an ideal source"):
        BRANCH.run_phasors([Job(state, tone(70.0, kind="shunt_current"))], [Window(70.0, 1)], 1, 1)
    for point, source in [(AT_RATED, replace(GRID, voltage_v=690.0)), (OperatingPoint(0.0, None), IDEAL)]:
        with pytest.raises(ValueError, match="give either"):
            BRANCH.settle(point, source)
    with pytest.raises(ValueError, match=r"\|v_pcc\| of 3 pu is outside the range of branch-v1: 0.1 to 2 pu"):
        BRANCH.settle(OperatingPoint(0.0, 3 * 690.0), IDEAL)
    with pytest.raises(ValueError, match="not a number"):
        BRANCH.settle(OperatingPoint(float("nan"), 690.0), IDEAL)
    with pytest.raises(ValueError, match="a Thevenin source needs"):
        BRANCH.settle(AT_RATED, Source("thevenin"))
    with pytest.raises(ValueError, match="l_h is 0; branch-v1 needs"):
        RLBranch(l_h=0.0)
    with pytest.raises(ValueError, match="a tenth of a period"):
        RLBranch(dt_s=0.01)
