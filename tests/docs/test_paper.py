"""The paper's claims on our turbine, thinly: numbers that docs/paper.md shows; the script itself writes the page."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "paper"
sys.path.insert(0, str(EXAMPLE))

import comparison  # noqa: E402
import simulated  # noqa: E402
import swept  # noqa: E402

PAPER = simulated.Gain(0.5, 77.0, "k = 0.5")
STRONG = simulated.Gain(1.34, 76.26, "k = 1.34")


@pytest.fixture(scope="module")
def weakest():
    return swept.judged(swept.Case(0.65, 1.4))


def outcomes(story):
    return [run.report for run in story.runs]


# ---------------------------------------------------------------- Section II


@pytest.mark.parametrize(
    ("scale", "verdict", "pole", "m"),
    [(1.0, "stable", -13.45 + 2j * np.pi * 25.59, 1.292), (1.2, "stable", -4.74 + 2j * np.pi * 26.14, 1.070)],
)
def test_stable_on_the_paper_s_stable_grids(scale, verdict, pole, m):
    """Printed to two digits; the sweep's own tolerance is 1e-5 of Y."""
    point = swept.judged(swept.Case(0.65, scale))
    assert point.verdict == verdict
    assert swept.mode_of(point)[0] == pytest.approx(pole, abs=0.04)
    assert swept.crossing_of(point)[1] == pytest.approx(m, abs=1e-3)
    assert max(abs(f - 50.0) for f in swept.pair_of(point)) == pytest.approx(27.0, abs=1.5)


def test_unstable_on_1_4_z_within_1_hz_of_23_and_77(weakest):
    assert weakest.verdict == "unstable"
    assert swept.pair_of(weakest) == (pytest.approx(23.0, abs=1.0), pytest.approx(77.0, abs=1.0))
    pole, damping = swept.mode_of(weakest)
    assert pole.real == pytest.approx(9.57, abs=0.01)
    assert damping == pytest.approx(-0.058, abs=5e-4)
    assert swept.crossing_of(weakest) == (pytest.approx(75.7, abs=0.05), pytest.approx(0.900, abs=1e-3))


# ---------------------------------------------------------------- Section III


@pytest.mark.parametrize(
    ("power_mw", "k", "real", "m"), [(0.65, 0.5, -3.81, 1.050), (0.60, 0.5, -8.40, 1.116), (0.70, 0.5, 1.89, 0.977)]
)
def test_half_the_line_damps_up_to_0_65_mw(power_mw, k, real, m):
    """The poles are those of the exact linearisation, docs/damping.md, printed to two digits."""
    point = swept.judged(swept.Case(power_mw, 1.4, k))
    assert swept.mode_of(point)[0].real == pytest.approx(real, abs=0.01)
    assert swept.crossing_of(point)[1] == pytest.approx(m, abs=1e-3)
    assert point.verdict == ("stable" if real < 0.0 else "unstable")


def test_margin_of_1_4_takes_more_than_the_formula_says(weakest):
    """k = 0.357 by the formula; 1.34 when swept again. The search stops within 0.5 % above the required m."""
    assert weakest.k == pytest.approx(0.357, abs=1e-3)
    point = swept.judged(swept.Case(0.65, 1.4, 1.34, swept.f_r_of(weakest)))
    assert 1.39 < swept.crossing_of(point)[1] < 1.42
    assert swept.mode_of(point)[1] > 0.10


def test_poles_that_the_grid_does_not_move_are_left_out(weakest):
    moved = swept.moved_poles(weakest)
    assert np.sum(moved.real > 0.0) == 1
    near = moved[(moved.real > -60.0) & (np.abs(moved.imag) > 2.0 * np.pi * 5.0)]
    assert len(near) == 1


# ---------------------------------------------------------------- Section IV


def test_step_to_1_4_z_diverges_without_and_converges_with_damping_by_0_7_s():
    """The paper: through 3 % within 150 ms, converged at about 0.7 s."""
    without, damped, strong = outcomes(simulated.grid_step(0.60, (simulated.NONE, PAPER, STRONG)))
    assert without.above_s - simulated.STEP_S < 0.15
    assert without.lost_s is not None
    assert damped.started_s[0] == pytest.approx(0.28, abs=0.01)
    assert damped.calm_s < 0.7
    assert strong.calm_s < damped.calm_s
    assert sorted((without.windows[1].f_hz, without.windows[1].f_mirror_hz)) == pytest.approx([23.4, 76.6], abs=0.3)
    assert without.windows[0].amplitude_a > without.windows[0].mirror_a


# ---------------------------------------------------------------- scenarios


@pytest.mark.parametrize(
    ("told", "none", "resonating"),
    [
        (simulated.weaker_grids, "Z x 1.5", "Z x 1.375"),
        pytest.param(simulated.more_turbines, "8 to 13 turbines", "8 to 11 turbines", marks=pytest.mark.evidence),
    ],
    ids=["weaker grids", "more turbines"],
)
def test_scenarios_with_an_equilibrium_end_calm_with_damping_and_others_are_named(told, none, resonating):
    gain = simulated.Gain(1.34, 74.05, "k = 1.34")
    by_name = {story.title.split(",")[0]: story for story in told((simulated.NONE, gain))}
    assert [name for name, story in by_name.items() if not story.has_equilibrium] == [none]
    for name, story in by_name.items():
        without, damped = outcomes(story)
        resonates = name == resonating
        assert (without.lost_s is None) == (story.has_equilibrium and not resonates)
        assert (damped.lost_s is None) == story.has_equilibrium
        assert bool(damped.started_s) == resonates


def test_faults_of_40_ms_do_not_start_it():
    assert all(
        run.started_s == () and run.lost_s is None for story in simulated.faults(STRONG) for run in outcomes(story)
    )


@pytest.mark.parametrize(("scale", "scr"), [(0.648, 1.8), (0.648 * 1.1, 1.64), (0.648 * 1.5, 1.2)])
def test_short_circuit_ratios_are_the_paper_s(scale, scr):
    assert simulated.short_circuit_ratio(scale) == pytest.approx(scr, abs=0.005)


# ---------------------------------------------------------------- the page


def test_page_is_rewritten_between_its_markers_only(tmp_path):
    page = tmp_path / "paper.md"
    page.write_text(f"before\n{comparison.BEGIN}\nold\n{comparison.END}\nafter\n")
    comparison.rewrite(page, comparison.markdown([comparison.Row("a", "b", "c", "d")]))
    text = page.read_text()
    assert "old" not in text
    assert "| a | b | c | d |" in text
    assert text.startswith("before\n")
    assert text.endswith("\nafter\n")


def test_page_shows_every_figure_and_a_table():
    page = (EXAMPLE.parents[1] / "docs" / "paper.md").read_text()
    table = page.split(comparison.BEGIN)[1].split(comparison.END)[0]
    assert "| 1.4 Z | unstable, 23/77 Hz | unstable" in table
    for name in ("bode", "notch", "reshaped", "poles", "time", "scenarios", "faults"):
        assert f"figures/paper-{name}.png" in page
        assert (EXAMPLE.parents[1] / "docs" / "figures" / f"paper-{name}.png").stat().st_size > 10_000
