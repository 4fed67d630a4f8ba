"""The benchmark of the verdict: its truth, and the first of its cases."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

from verdict_families import kept
from verdict_families.calibration import Stated, bins
from verdict_families.cases import cases_of
from verdict_families.following import Following, draw_following, linear_following
from verdict_families.forming import DROOP, STIFF, Forming, draw_forming, linear_forming
from verdict_families.linear import Bases, J, Linear, pade, parallel
from verdict_families.rational_devices import draw_rational
from verdict_families.sampled_devices import draw_sampled
from verdict_families.score import is_phantom, line_of
from verdict_families.sweeping import swept
from verdict_families.swept_plants import LinearPlant, SampledPlant
from verdict_families.tables import T_PN
from verdict_families.truth import covers, covers_all_but_faint, seen_modes
from verdict_families.units import Unit, draw_unit, edges, grid_of, rightmost

from seqsweep.identify.fourier import block_phasors
from seqsweep.plant.protocol import Injection, Job, Source, Tone, Window

GFM, GFL = Bases(690.0, 2.75e6, 50.0), Bases(690.0, 1.632e6, 50.0)


def nearest(poles: np.ndarray, pole: complex) -> float:
    return float(np.abs(poles - pole).min())


def grid_at(scr: float, bases: Bases, x_over_r: float = 10.0) -> tuple[float, float]:
    return grid_of(bases.z_ohm / scr, 1.0 / x_over_r)


# Published numbers ------------------------------------------------------------------------------------------------

VSM = [-3.752, -6.472 + 26.568j, -23.962 + 246.146j, -219.247, -1419.180 + 173.714j, -1701.346 + 5440.424j]
DROOPS = [-11.405, -16.239 + 31.593j, -23.657 + 242.184j, -50.595, -1419.890 + 173.425j, -1866.626 + 5686.984j]
FOLLOWS = [-18.670, -18.865, -28.284 + 147.129j, -543.329 + 1154.541j, -525.285 + 6726.918j, -485.569 + 7267.053j]


@pytest.mark.parametrize(
    ("device", "published"),
    [
        (linear_forming(Forming(), GFM), VSM),
        (linear_forming(Forming(**DROOP), GFM), DROOPS),
        (linear_forming(Forming(**DROOP, **STIFF), GFM), [17.013 + 83.902j, -45.925 + 70.272j]),
        (linear_following(Following(), GFL), FOLLOWS),
    ],
    ids=["VSM", "droop", "stiff droop", "grid-following"],
)
def test_own_poles_are_the_published_ones(device: Linear, published: list[complex]) -> None:
    assert max(nearest(device.own_poles, pole) for pole in published) < 1e-3


@pytest.mark.parametrize(
    ("scr", "worst"), [(10, -11.32), (30, -3.341), (34, -0.223), (35, 0.409), (40, 2.960), (100, 11.957)]
)
def test_stiff_droop_is_unstable_on_strong_grids(scr: float, worst: float) -> None:
    device = linear_forming(Forming(**DROOP, **STIFF), GFM)
    assert device.closed_loop(*grid_at(scr, GFM)).real.max() == pytest.approx(worst, abs=6e-3)


@pytest.mark.parametrize(
    ("scr", "worst"), [(3, -16.410), (2, -8.068), (1.7, -2.422), (1.6, 0.265), (1.5, 3.588), (1.4, 7.779)]
)
def test_grid_following_inverter_is_unstable_on_weak_grids(scr: float, worst: float) -> None:
    device = linear_following(Following(p=1.0), GFL)
    assert device.closed_loop(*grid_at(scr, GFL)).real.max() == pytest.approx(worst, abs=1e-3)


@pytest.mark.parametrize(
    ("device", "bases", "f_hz", "row"),
    [
        (linear_forming(Forming(), GFM), GFM, 23.0, (-0.11682 - 6.94239j, -0.24533 + 1.05446j)),
        (linear_forming(Forming(), GFM), GFM, 400.0, (0.20627 - 0.42468j, -0.00487 - 0.00794j)),
        (linear_following(Following(), GFL), GFL, 35.0, (-0.59629 + 0.06158j, 0.66937 + 0.11259j)),
        (linear_following(Following(), GFL), GFL, 1000.0, (1.35130 + 1.16782j, -0.02393 + 0.02110j)),
    ],
)
def test_admittance_is_the_published_one(
    device: Linear, bases: Bases, f_hz: float, row: tuple[complex, complex]
) -> None:
    y = T_PN @ device.admittance(np.array([f_hz - 50.0]))[0] @ np.linalg.inv(T_PN) * bases.z_ohm
    np.testing.assert_allclose(y[0], row, atol=2e-5)


# Second opinions --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("draw", [draw_following, draw_forming, draw_rational])
def test_closed_loop_poles_are_zeros_of_the_determinant(draw) -> None:
    """All three forms of the ordinary differential equations: each pole makes 1 + Y Z singular."""
    rng = np.random.default_rng(3)
    for _ in range(12):
        device, text, *_ = draw(rng, GFL)
        r, x = grid_at(2.0, GFL)
        for pole in device.closed_loop(r, x):
            if nearest(device.own_poles, pole) < 1e-3 * abs(pole):
                continue  # not seen at the terminals, or nearly so: Y itself has no value there
            y = device.c @ np.linalg.solve(pole * np.eye(len(device.a)) - device.a, device.b) + device.d
            z = (r + pole * x / GFL.w1) * np.eye(2) + x * J
            loop = np.eye(2) + (y + pole * device.e * np.eye(2)) @ z
            smallest = np.linalg.svd(loop, compute_uv=False)[1]
            assert smallest < 1e-5 * np.linalg.norm(loop), (text, pole)


def test_two_devices_in_parallel_add_their_admittances() -> None:
    rng, nu = np.random.default_rng(5), np.array([3.0, 40.0, 300.0])
    one, other = draw_following(rng, GFL)[0], draw_forming(rng, GFL)[0]
    both = parallel(one, other)
    np.testing.assert_allclose(both.admittance(nu), one.admittance(nu) + other.admittance(nu), rtol=1e-10)


def test_all_pass_is_the_delay_to_a_thousandth() -> None:
    a, b, c, d = pade(150e-6)
    s = 2j * np.pi * 1000.0
    assert abs(c @ np.linalg.solve(s * np.eye(3) - a, b) + d - np.exp(-s * 150e-6)) < 1e-3


def test_edge_of_a_sampled_controller_is_that_of_its_admittance() -> None:
    """Its eigenvalues come from the interval, its Y from the phasors: they meet to what images leave, some 1e-3."""
    from scipy.optimize import fsolve

    rng, met = np.random.default_rng(1), 0
    for _ in range(20):
        device, _ = draw_sampled(rng, GFL)
        found = edges(Unit("sampled", "", GFL, device, None), 0.1)
        if not found:
            continue
        poles = device.closed_loop(*grid_of(found[0], 0.1))
        start = abs(poles[np.argmax(poles.real)].imag) / (2.0 * np.pi)

        def determinant(at: np.ndarray, device=device) -> list[float]:
            r, x = grid_of(at[0] * GFL.z_ohm, 0.1)
            z = (r + 2j * np.pi * at[1] * x / GFL.w1) * np.eye(2) + x * J
            value = np.linalg.det(np.eye(2) + device.admittance(np.array([at[1]]))[0] @ z)
            return [value.real, value.imag]

        size, _ = fsolve(determinant, [found[0] / GFL.z_ohm, start])
        assert size * GFL.z_ohm == pytest.approx(found[0], rel=5e-3)
        met += 1
    assert met >= 5


def test_edges_are_where_a_pole_is_on_the_axis() -> None:
    rng = np.random.default_rng(2)
    for family in ("following", "forming", "rational", "sampled"):
        unit = draw_unit(family, rng)
        for size in edges(unit, 0.1):
            poles = unit.device.closed_loop(*grid_of(size, 0.1))
            assert np.abs(poles.real).min() < 1e-4 * np.abs(poles).max()
            assert rightmost(unit, 0.99 * size, 0.1) * rightmost(unit, 1.01 * size, 0.1) < 0.0


# Plants -----------------------------------------------------------------------------------------------------------


def test_phasors_of_a_linear_plant_are_those_of_its_waveforms() -> None:
    plant = LinearPlant(linear_following(Following(), GFL), GFL)
    injection = Injection("series_voltage", (Tone(77.0, 1.0, 0.3),))
    ((later, _),) = plant.run([Job(plant.settle(None, Source()), injection)], 400)
    ((_, record),) = plant.run([Job(later, injection)], 800)
    ((_, phasors),) = plant.run_phasors([Job(later, injection)], [Window(77.0, 3, 1)], 200, 4)
    slow = block_phasors(record, Window(77.0, 3, 1), 200)
    np.testing.assert_allclose(phasors.i, slow.i, atol=1e-10 * np.abs(record.i).max())
    np.testing.assert_allclose(phasors.v, slow.v, atol=1e-10 * np.abs(record.v).max())


def test_a_run_in_two_parts_is_the_run_in_one() -> None:
    plant = LinearPlant(linear_following(Following(), GFL), GFL)
    injection = Injection("series_voltage", (Tone(-33.0, 1.0, 0.3),))
    state = plant.settle(None, Source())
    ((half, _),) = plant.run([Job(state, injection)], 400)
    ((_, second),) = plant.run([Job(half, injection)], 400)
    ((_, whole),) = plant.run([Job(state, injection)], 800)
    np.testing.assert_allclose(whole.i[400:], second.i, atol=1e-12 * np.abs(second.i).max())


def campaign(**source: object) -> dict:
    return {
        "campaign": {"name": "test"},
        "plant": {"id": "branch-v1"},
        "operating_point": [{"id": "a", "active_power_mw": 0.5, "terminal_voltage_pu": 1.0}],
        "sweep": {"f_hz": [7.0, 35.0, 77.0, 400.0]},
        "source": {"kind": "ideal", **source},
    }


def test_swept_rows_are_the_device_s_own(tmp_path: Path) -> None:
    stiff = linear_forming(Forming(**DROOP, **STIFF), GFM)
    r, x = grid_at(10.0, GFM)
    behind = swept(LinearPlant(stiff, GFM), campaign(kind="thevenin", r_ohm=r, x_ohm=x), tmp_path / "a.parquet")
    exact = T_PN @ stiff.admittance(behind.f_hz - 50.0) @ np.linalg.inv(T_PN)
    assert behind.ok.all()
    np.testing.assert_allclose(behind.y, exact, rtol=0.0, atol=1e-6 * np.abs(exact).max())


def test_swept_rows_of_a_sampled_controller_are_its_own(tmp_path: Path) -> None:
    device, _ = draw_sampled(np.random.default_rng(1), GFL)
    rows = swept(SampledPlant(device), campaign(), tmp_path / "a.parquet")
    exact = T_PN @ device.admittance(rows.f_hz - 50.0) @ np.linalg.inv(T_PN)
    error = np.linalg.norm(rows.y - exact, axis=(1, 2)) / np.linalg.norm(exact, axis=(1, 2))
    assert rows.ok.all()
    assert error.max() < 3e-3  # images of the sampling


# What is counted --------------------------------------------------------------------------------------------------


def test_coverage_is_lost_in_a_gap_and_around_a_narrow_mode() -> None:
    device = linear_following(Following(p=1.0), GFL)
    unit, grid = Unit("following", "", GFL, device, None), grid_at(1.7, GFL)
    modes = seen_modes(device.closed_loop(*grid), device.own_poles)
    rows = np.geomspace(0.5, 950.0, 60)
    assert covers(unit, grid, rows, modes)
    assert not covers(unit, grid, rows[(rows < 20.0) | (rows > 32.0)], modes)
    assert not covers(unit, grid, rows[rows > 8.0], modes)  # a slow mode is narrower than that
    assert not covers(unit, grid, rows[rows < 20.0], modes)  # the device is active beyond


def test_rows_are_needed_where_the_device_is_active_however_small_the_loop_gain() -> None:
    """A device that feeds around 40 Hz behind a grid a hundred times too stiff for that to matter."""
    a, b = np.array([[-20.0, 251.0], [-251.0, -20.0]]), np.eye(2)
    device = Linear(a, b, np.diag([-90.0, 1.0]), np.eye(2), 0.0, GFL.w1)
    unit, grid = Unit("rational", "", GFL, device, None), (0.001, 0.001)
    modes = seen_modes(device.closed_loop(*grid), device.own_poles)
    rows = np.geomspace(0.5, 950.0, 60)
    gap = rows[(rows < 25.0) | (rows > 60.0)]
    assert covers(unit, grid, rows, modes)
    assert not covers(unit, grid, gap, modes)
    assert covers_all_but_faint(unit, grid, gap, modes)


def test_bins_hold_what_is_calibrated_and_show_what_is_not() -> None:
    rng = np.random.default_rng(0)
    p = rng.uniform(size=4000)
    honest = [Stated(k, float(x), bool(rng.random() < x), "") for k, x in enumerate(p)]
    bold = [Stated(k, float(x), bool(rng.random() < 0.5), "") for k, x in enumerate(p)]
    assert sum(b.held for b in bins(honest)) >= 9
    assert sum(b.held for b in bins(bold)) <= 3


# Verdicts --------------------------------------------------------------------------------------------------------

SEED = 12
"""Of the part that every change is tried on; `make evidence` takes a new one each time."""


@pytest.mark.parametrize("first", [0, *(pytest.param(k, marks=pytest.mark.evidence) for k in range(5, 50, 5))])
def test_no_verdict_is_wrong(first: int, tmp_path: Path) -> None:
    """Five tables, one of each family, on three grids each; a verdict may be withheld, but not be wrong."""
    cases = [case for index in range(first, first + 5) for case in cases_of(SEED, index, 0.15, 3, tmp_path)]
    assert [line_of(c) for c in cases if c.wrong and not c.truth.hidden] == []
    assert [line_of(c) for c in cases if c.said.verdict == "crash"] == []
    assert [line_of(c) for c in cases if np.isfinite(c.said.resonance.real) and is_phantom(c)] == []


def test_several_modes_between_f1_and_the_lowest_row_are_not_judged_from_afar(tmp_path: Path) -> None:
    """A device of order 22 with five modes within 3 Hz of f1, its lowest row 5 Hz away: once wrong with certainty."""
    cases = cases_of(11, 1908, 0.0, 2, tmp_path)
    assert [case.truth.n_unstable for case in cases] == [0, 2]
    assert [line_of(c) for c in cases if c.wrong] == []


@pytest.mark.parametrize(("seed", "index", "grid"), [(432949, 602, 1), (432949, 822, 2)])
def test_a_mode_that_stays_beside_a_pole_which_counts_twice_is_no_resonance(
    seed: int, index: int, grid: int, tmp_path: Path
) -> None:
    """Two grid-forming inverters: the fit made one pole of two, and named what was left of it on the grid."""
    (case,) = cases_of(seed, index, 0.0, 3, tmp_path, is_wanted=lambda one: one.grid_number == grid)
    assert np.isfinite(case.said.resonance.real)
    assert not is_phantom(case), line_of(case)


@pytest.mark.parametrize(
    ("index", "words"), [(172, "unstable pole of the device's own"), (433, "no usable rows around")]
)
def test_what_rows_do_not_reach_carries_no_verdict(index: int, words: str, tmp_path: Path) -> None:
    """A droop unit whose count was met by a pole five bands out; a mode in a gap that a twentieth of Y would move."""
    cases = cases_of(515572, index, 0.58, 3, tmp_path)
    assert {case.truth.stable for case in cases} == {True, False}
    assert [line_of(c) for c in cases if c.wrong] == []
    assert any(words in case.said.reason for case in cases)


def test_pole_that_nothing_proves_is_no_resonance_where_its_damping_is_a_guess(tmp_path: Path) -> None:
    """Two grid-forming inverters, a table that says nothing of where they were stable: a spurious pole was named."""
    cases = cases_of(515572, 1912, 0.58, 3, tmp_path)
    assert [line_of(c) for c in cases if np.isfinite(c.said.resonance.real) and is_phantom(c)] == []
    assert np.isfinite(cases[0].said.resonance.real)


@pytest.mark.parametrize(("seed", "index", "grid"), [(71001, 347, 2), (71001, 2, 0)])
def test_a_device_unstable_by_itself_is_counted_where_its_rows_are_far_apart(
    seed: int, index: int, grid: int, tmp_path: Path
) -> None:
    """Two grid-forming inverters side by side, exact rows on a strong grid: one unstable pair of their own."""
    (case,) = cases_of(seed, index, 0.0, 3, tmp_path, is_wanted=lambda one: one.grid_number == grid)
    assert case.truth.n_unstable == case.own_unstable == case.said.own_unstable == 2
    assert case.said.verdict == "unstable", line_of(case)


# A run that was ended ---------------------------------------------------------------------------------------------


def test_answers_of_a_run_that_was_ended_are_kept_and_it_goes_on(tmp_path: Path) -> None:
    """Three answers, then a fourth of which only half reached the disk."""
    file, asked = tmp_path / "answers.pickle", []

    def answer(index: int) -> int:
        asked.append(index)
        return index * index

    assert list(kept.answers(answer, range(3), file, 1, lambda: True)) == [0, 1, 4]
    with file.open("ab") as source:
        source.write(b"\x80\x05\x95\x12")
    assert list(kept.answers(answer, range(5), file, 1, lambda: False)) == [0, 1, 4]
    assert list(kept.answers(answer, range(5), file, 1, lambda: True)) == [0, 1, 4, 9, 16]
    assert list(kept.answers(answer, range(2), file, 1, lambda: True)) == [0, 1]
    assert asked == [0, 1, 2, 3, 4]
