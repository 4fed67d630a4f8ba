"""Verdicts that were wrong once, each in its kind: swept turbines, inverters, long, noisy and measured tables."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from seqsweep.identify.response import FrequencyResponse
from seqsweep.tuning.result import PointTuning, to_json
from seqsweep.tuning.siso import SeriesRL
from seqsweep.tuning.tune import tune

from ..support import oracle

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

from verdict_families.following import Following, linear_following
from verdict_families.forming import DROOP, STIFF, Forming, linear_forming
from verdict_families.linear import Bases, Linear
from verdict_families.sweeping import swept
from verdict_families.swept_plants import LinearPlant
from verdict_families.tables import T_PN
from verdict_families.units import Unit, edges, grid_of

F1_HZ = 50.0
GFL, GFM = Bases(690.0, 1.632e6, F1_HZ), Bases(690.0, 2.75e6, F1_HZ)
IDEAL = {"grid": "ideal", "basis": "shots", "growth_bound_per_s": 0.7, "disturbed_s": 1.0}
BOTH_WAYS = np.unique(np.concatenate([np.geomspace(1.0, 1500.0, 50), F1_HZ + np.geomspace(0.3, 40.0, 25)]))
"""Frequencies that are logarithmic from 1 Hz on and about f1 (Hz)."""


def rows(device: Linear, f_hz: np.ndarray, fact: dict | None = IDEAL) -> FrequencyResponse:
    """Rows by formula; ``fact`` is what is known of where it rests."""
    y = T_PN @ device.admittance(f_hz - F1_HZ) @ np.linalg.inv(T_PN)
    meta = {"op_id": "a"} | ({} if fact is None else {"stable_on": fact})
    return FrequencyResponse(f_hz, y, F1_HZ, meta=meta)


def judged(response: FrequencyResponse, r_ohm: float, x_ohm: float) -> PointTuning:
    (point,) = tune([response], SeriesRL(r_ohm, x_ohm, response.f1_hz)).points
    return point


def named(point: PointTuning) -> complex:
    """The pole named as the resonance (rad/s), NaN where none is."""
    assert point.stability is not None
    loop = point.stability.closed_loop
    return complex(np.nan, np.nan) if loop.critical is None else complex(loop.poles[loop.critical])


def truth(device: Linear, r_ohm: float, x_ohm: float) -> str:
    return "stable" if device.closed_loop(r_ohm, x_ohm).real.max() < 0.0 else "unstable"


def noisy(response: FrequencyResponse, level: np.ndarray | float, seed: int = 0) -> FrequencyResponse:
    """Relative noise of each element, no covariance."""
    rng = np.random.default_rng(seed)
    noise = rng.normal(size=(*response.y.shape, 2)) @ [1.0, 1j] / np.sqrt(2.0)
    size = np.linalg.norm(response.y, axis=(1, 2))[:, None, None] / 2.0
    return replace(response, y=response.y + np.reshape(level, (-1, 1, 1)) * size * noise)


# The turbine, really swept ---------------------------------------------------------------------------------------


def turbine(folder: Path, power_mw: float, points: int, amplitude_pu: float, **injection: object) -> FrequencyResponse:
    from seqsweep.plant.turbine.reference import ReferenceTurbine

    content = {
        "campaign": {"name": "test"},
        "plant": {"id": "dpmsg-v1"},
        "operating_point": [{"id": "a", "active_power_mw": power_mw, "terminal_voltage_pu": 1.0}],
        "sweep": {"f_min_hz": 1.0, "f_max_hz": 1000.0, "points": points},
        "injection": {"amplitude_pu": amplitude_pu, **injection},
    }
    name = f"{power_mw}-{points}-{amplitude_pu}-{injection.get('signal', 'tone')}.parquet"
    return swept(ReferenceTurbine(), content, folder / name)


def exact_poles(power_mw: float, scale: float) -> np.ndarray:
    x_ohm = 0.25 * scale
    return oracle.closed_loop_poles(
        power_mw * 1e6, 0.012 * scale, x_ohm / (2.0 * np.pi * F1_HZ), terminal_voltage_v=690.0
    )


def test_sixty_rows_of_the_turbine_at_0_2_mw_are_stable(tmp_path: Path) -> None:
    """Once "unstable, probability 0": the fit had a pole of its own at +23.8 rad/s."""
    point = judged(turbine(tmp_path, 0.2, 60, 0.002), 0.012, 0.25)
    pole = named(point)
    assert point.verdict == "stable"
    assert point.probability == pytest.approx(1.0, abs=1e-6)
    assert point.stability is not None
    assert point.stability.n_open_loop_unstable == 0
    assert pole.imag / (2.0 * np.pi) == pytest.approx(24.50, abs=0.02)
    assert -pole.real / abs(pole) == pytest.approx(0.177, abs=0.002)
    assert point.stability.critical is not None
    assert point.stability.critical.m == pytest.approx(1.985, abs=0.005)


@pytest.mark.parametrize("points", [90, 150, pytest.param(300, marks=pytest.mark.evidence)])
def test_more_rows_find_the_same_resonance(tmp_path: Path, points: int) -> None:
    """Once 42 to 45 Hz, where there is none: the true pole stood among the others."""
    point = judged(turbine(tmp_path, 0.65, points, 0.0005), 0.012, 0.25)
    assert point.verdict == "stable"
    assert named(point) == pytest.approx(oracle.resonance_pole(exact_poles(0.65, 1.0)), abs=0.05)


@pytest.mark.parametrize("power_mw", [0.3, 0.7, 1.1])
def test_multisine_finds_the_resonance_that_tones_find(tmp_path: Path, power_mw: float) -> None:
    exact = exact_poles(power_mw, 1.0)
    point = judged(turbine(tmp_path, power_mw, 60, 0.005, signal="multisine"), 0.012, 0.25)
    assert point.verdict == ("stable" if exact.real.max() < 0.0 else "unstable")
    assert named(point) == pytest.approx(oracle.resonance_pole(exact), abs=0.2)


POWERS_MW = np.linspace(0.2, 1.1, 10)
AMPLITUDES_PU = (0.0005, 0.002, 0.005)


def tried(folder: Path, powers_mw: np.ndarray, points: tuple[int, ...], amplitudes_pu: tuple[float, ...]) -> np.ndarray:
    """Shares of wrong, undecided and invented resonances over two grids each."""
    found = []
    for power_mw in powers_mw:
        for n in points:
            for amplitude_pu in amplitudes_pu:
                response = turbine(folder, round(float(power_mw), 3), n, amplitude_pu)
                for scale in (1.0, 1.6):
                    exact = exact_poles(round(float(power_mw), 3), scale)
                    point = judged(response, 0.012 * scale, 0.25 * scale)
                    right = "stable" if exact.real.max() < 0.0 else "unstable"
                    pole = named(point)
                    invented = np.isfinite(pole) and np.abs(exact - pole).min() > max(np.pi, 0.1 * abs(pole))
                    found.append([point.verdict not in (right, "undecided"), point.verdict == "undecided", invented])
    return np.mean(found, axis=0)


def test_few_and_loud_rows_of_the_turbine_are_not_judged_wrong(tmp_path: Path) -> None:
    wrong, undecided, invented = tried(tmp_path, POWERS_MW[[0, 9]], (60,), (0.0005, 0.005))
    assert wrong == 0.0
    assert undecided <= 0.02
    assert invented == 0.0


@pytest.mark.evidence
def test_three_hundred_verdicts_on_the_turbine(tmp_path: Path) -> None:
    """Ten powers, 20 to 150 rows, three amplitudes, two grids: 7 were wrong and certain, 49 resonances invented."""
    for points in ((20, 40), (60, 100, 150)):
        wrong, undecided, invented = tried(tmp_path, POWERS_MW, points, AMPLITUDES_PU)
        print(f"{points} rows: wrong {wrong:.1%}, undecided {undecided:.1%}, resonances invented {invented:.1%}")
        assert wrong == 0.0
        assert invented == 0.0
        assert points[0] < 60 or undecided <= 0.02


# Inverters -------------------------------------------------------------------------------------------------------


def both_sides(device: Linear, bases: Bases, r_over_x: float, away: float) -> list[tuple[float, float]]:
    """Grids on both sides of every edge of stability, so far away."""
    sizes = edges(Unit("", "", bases, device, None), r_over_x)
    assert sizes
    return [grid_of(size * (1.0 + side * away), r_over_x) for size in sizes for side in (-1.0, 1.0)]


L_FILTER = Following(filter="L", outer="pq", rf=0.005, kff=1.0, krd=0.16, kpc=0.4, kic=60.0, p=0.8)


@pytest.mark.parametrize("wff", [np.inf, 2000.0], ids=["direct", "filtered"])
@pytest.mark.parametrize("points", [40, 100])
def test_l_filter_with_voltage_feed_forward_is_decided(wff: float, points: int) -> None:
    """Once undecided, the locus could not be traced to the end, or stable beside a mode damped by -100 %."""
    device = linear_following(replace(L_FILTER, wff=wff), GFL)
    response = rows(device, np.geomspace(1.0, 1000.0, points))
    for scr in (2.0, 5.0, 20.0):
        r, x = grid_of(GFL.z_ohm / scr, 0.1)
        point = judged(response, r, x)
        pole = named(point)
        assert point.verdict == truth(device, r, x)
        assert not -pole.real / abs(pole) < -0.5
        assert not np.abs(device.closed_loop(r, x) - pole).min() > 0.1 * abs(pole)


@pytest.fixture(scope="module")
def stiff_table(tmp_path_factory: pytest.TempPathFactory) -> FrequencyResponse:
    """A droop behind a bare transformer, swept where it rests: SCR 10."""
    r, x = grid_of(GFM.z_ohm / 10.0, 0.1)
    content = {
        "campaign": {"name": "test"},
        "plant": {"id": "branch-v1"},
        "operating_point": [{"id": "a", "active_power_mw": 1.375, "terminal_voltage_pu": 1.0}],
        "sweep": {"f_min_hz": 1.0, "f_max_hz": 1000.0, "points": 100},
        "injection": {"amplitude_pu": 0.001},
        "source": {"kind": "thevenin", "r_ohm": r, "x_ohm": x},
    }
    device = linear_forming(Forming(**DROOP, **STIFF), GFM)
    folder = tmp_path_factory.mktemp("stiff")
    return swept(LinearPlant(device, GFM, bend=1.0), content, folder / "y.parquet")


@pytest.mark.parametrize("scr", [2.0, 3.0, 10.0, 20.0, 34.0, 35.0, 40.0, 100.0])
def test_stiff_droop_is_unstable_on_strong_grids_alone(stiff_table: FrequencyResponse, scr: float) -> None:
    """Its edge is SCR 34.34, unstable on stronger grids; once eight unstable poles of its own were counted for two."""
    point = judged(stiff_table, *grid_of(GFM.z_ohm / scr, 0.1))
    assert point.verdict == ("stable" if scr < 34.34 else "unstable")
    assert point.stability is not None
    assert point.stability.n_open_loop_unstable == 2


@pytest.mark.parametrize("first_hz", [6.0, 19.0, 46.0, 60.0, 80.0])
@pytest.mark.parametrize("scr", [60.0, pytest.param(90.0, marks=pytest.mark.evidence), 300.0])
def test_rows_far_from_f1_do_not_make_a_stiff_droop_stable(first_hz: float, scr: float) -> None:
    """Its own modes, 14 Hz from f1, grow on stiffer grids than the one on which it rested; once it was certain that
    they decay."""
    device = linear_forming(Forming(**DROOP, **STIFF), GFM)
    r, x = grid_of(GFM.z_ohm / 2.0, 0.1)
    fact = {"grid": {"r_ohm": r, "x_ohm": x}, "basis": "shots", "growth_bound_per_s": 0.7, "disturbed_s": 1.0}
    point = judged(rows(device, F1_HZ + np.linspace(first_hz, 950.0, 20), fact), *grid_of(GFM.z_ohm / scr, 0.1))
    assert truth(device, *grid_of(GFM.z_ohm / scr, 0.1)) == "unstable"
    assert point.verdict != "stable"


def test_rows_far_from_f1_keep_no_verdict_back_where_the_device_rested() -> None:
    """The grid on which it rested holds what it held, also where its impedance is the same but for rounding."""
    device = linear_forming(Forming(**DROOP), GFM)
    r, x = grid_of(GFM.z_ohm / 2.0, 0.1)
    fact = {"grid": {"r_ohm": r, "x_ohm": x}, "basis": "shots", "growth_bound_per_s": 0.7, "disturbed_s": 1.0}
    response = rows(device, F1_HZ + np.linspace(30.0, 950.0, 20), fact)
    reasons = [judged(response, scale * r, scale * x).stability.reason for scale in (1.0, 1.0 - 1e-15, 1.3, 0.7)]
    assert ["may have held" in reason for reason in reasons] == [False, False, False, True]


def test_where_a_device_rests_is_needed_where_it_decides() -> None:
    """The count of the stiff droop's own unstable poles cannot be left to a fit."""
    device = linear_forming(Forming(**DROOP, **STIFF), GFM)
    for scr in (3.0, 60.0):
        r, x = grid_of(GFM.z_ohm / scr, 0.1)
        assert judged(rows(device, BOTH_WAYS, None), r, x).verdict in ("undecided", truth(device, r, x))


REAL = Following(
    filter="L", outer="dc", lf=0.15, kpc=0.75, kic=300.0, krd=0.15, kp=1.5, ki=25.0, p=0.95, kpp=0.1, kip=5.0
)


def test_real_unstable_pole_is_decided() -> None:
    """The classical limit of grid-following devices on weak grids: no oscillation, rows begin 0.3 Hz from f1."""
    device = linear_following(REAL, GFL)
    r, x = grid_of(GFL.z_ohm / 0.9, 0.1)
    poles = device.closed_loop(r, x)
    unstable = poles[poles.real > 0.0]
    assert len(unstable) == 1
    assert unstable[0].real > 2.0 * np.pi * 0.3
    assert judged(rows(device, BOTH_WAYS), r, x).verdict == "unstable"


FAST = Following(
    lf=0.2, cf=0.032, rc=0.076, lg=0.078, kpc=0.8, kic=410.0, krd=0.0, kff=1.0, wff=np.inf, kpp=0.39, kip=24.7, kp=0.8,
    ki=9.8, kq=0.04, kiq=17.9, wm=236.0, p=0.19, v=1.075
)  # fmt: skip


def test_unstable_mode_is_the_one_that_is_named() -> None:
    """Once 13/87 Hz with +7.7 % of damping beside "unstable"; the mode that decides stands at 266 Hz."""
    device = linear_following(FAST, GFL)
    r, x = both_sides(device, GFL, 0.1, 0.1)[-1]
    poles = device.closed_loop(r, x)
    worst = complex(poles[np.argmax(poles.real + 1e-9 * poles.imag)])
    assert worst.imag > 2.0 * np.pi * 200.0
    point = judged(rows(device, np.geomspace(1.0, 3000.0, 150)), r, x)
    assert (point.verdict, truth(device, r, x)) == ("unstable", "unstable")
    assert named(point) == pytest.approx(worst, abs=0.5)


def test_device_s_own_pole_that_no_grid_moves_is_not_named() -> None:
    """A mode of the device that its terminals hardly see stays where it is on every grid."""
    from scipy.linalg import block_diag

    device = linear_following(Following(p=1.0), GFL)
    hidden = np.array([[-1.5, 2.0 * np.pi * 41.0], [-2.0 * np.pi * 41.0, -1.5]])
    faint = 1e-7 * np.linalg.norm(device.c) * np.ones((2, 2))
    both = Linear(
        block_diag(device.a, hidden),
        np.vstack([device.b, np.eye(2) * np.linalg.norm(device.b)]),
        np.hstack([device.c, faint]),
        device.d,
        0.0,
        device.w1,
    )
    names = [named(judged(rows(both, BOTH_WAYS), *grid_of(GFL.z_ohm / scr, 0.1))) for scr in (2.5, 1.8, 1.5)]
    for scr, pole in zip((2.5, 1.8, 1.5), names, strict=True):
        exact = oracle.resonance_pole(device.closed_loop(*grid_of(GFL.z_ohm / scr, 0.1)))
        assert pole == pytest.approx(exact, abs=0.05)


@pytest.mark.parametrize("scr", [1.5, 2.0, 6.0])
def test_hold_of_a_stepped_device_does_not_keep_the_verdict_back(scr: float) -> None:
    """Half a step of delay makes the device active at the end of the band; sweeping further does not help."""
    device = linear_following(replace(Following(p=1.0), filter="L", cf=0.0), GFL)
    response = rows(device, np.unique(np.concatenate([BOTH_WAYS, np.geomspace(1500.0, 3000.0, 8)])))
    late = np.exp(-2j * np.pi * response.f_hz * 25e-6)
    mirror = np.exp(-2j * np.pi * (response.f_hz - 2.0 * F1_HZ) * 25e-6)
    delayed = replace(response, y=np.stack([late, mirror], axis=1)[:, :, None] * response.y)
    r, x = grid_of(GFL.z_ohm / scr, 0.1)
    assert judged(delayed, r, x).verdict == truth(device, r, x)


# Long, noisy and measured tables ---------------------------------------------------------------------------------


@pytest.mark.parametrize("points", [96, 192, pytest.param(384, marks=pytest.mark.evidence)])
def test_long_tables_with_noisier_slow_rows_are_judged_right(points: int) -> None:
    """Windows of one second: slow rows are noisier, no covariance. Once order 23 with ten poles on the right."""
    device = linear_following(Following(p=1.0), GFL)
    f = np.linspace(2.0, 2.0 + 4.0 * points, points)
    f = f[np.abs(f - F1_HZ) > 0.5]
    level = 1e-4 + 5e-3 / (1.0 + np.abs(f - F1_HZ) / 3.0)
    response = noisy(rows(device, f), level)
    for r, x in both_sides(device, GFL, 0.1, 0.15):
        point = judged(response, r, x)
        assert point.verdict == truth(device, r, x)
        assert point.stability is not None
        assert point.stability.n_open_loop_unstable == 0


@pytest.mark.parametrize("seed", range(5))
def test_measured_rows_with_a_hole_around_f1_are_not_called_unstable_where_they_were_measured(seed: int) -> None:
    """Nothing within 8 Hz of f1, outlying rows beside it and at 3 f1, no covariance: once "+133 +- 27 rad/s"."""
    device = linear_following(replace(Following(), p=0.2 + 0.15 * seed), GFL)
    f = np.geomspace(2.0, 1000.0, 90)
    f = f[np.abs(f - F1_HZ) > 8.0]
    response = noisy(rows(device, f), 5e-3, seed)
    y, rng = np.array(response.y), np.random.default_rng(100 + seed)
    wrong = [int(np.argmin(np.abs(f - at))) for at in (42.0, 58.5, 62.0, 150.0)]
    y[wrong] *= 1.0 + 0.5 * rng.normal(size=(len(wrong), 2, 2))
    point = judged(replace(response, y=y), 1e-4, 1e-3)
    assert point.verdict != "unstable"
    assert not point.probability < 0.5
    text = " ".join(point.warnings)
    assert any(f"{value:.4g}" in text for row in wrong for value in (f[row], abs(f[row] - F1_HZ))), text


@pytest.mark.parametrize("seed", range(6))
def test_result_of_a_noisy_table_is_json(seed: int) -> None:
    """2 % of noise and no covariance: once "Out of range float values", and nothing was written."""
    device = linear_following(replace(Following(), p=0.15 * seed), GFL)
    response = noisy(rows(device, np.geomspace(1.0, 1000.0, 60)), 0.02, seed)
    result = tune([response], SeriesRL(*grid_of(GFL.z_ohm / (1.2 + seed), 0.1), F1_HZ))
    assert json.loads(json.dumps(to_json(result), allow_nan=False))["operating_points"]


def test_a_constant_of_rounding_does_not_turn_the_locus() -> None:
    """Once undecided at every grid: a constant of 2e-7 S and a pole at 1.3e7 rad/s, although the edge was right."""
    device = linear_following(replace(L_FILTER, kff=0.0), GFL)
    response = rows(device, BOTH_WAYS)
    rounded = replace(response, y=response.y + 2e-7 * np.eye(2) * np.random.default_rng(0).normal())
    for scr in (1.2, 3.0, 30.0):
        r, x = grid_of(GFL.z_ohm / scr, 0.1)
        assert judged(rounded, r, x).verdict == truth(device, r, x)


@pytest.mark.parametrize("gain", [0.5, 2.0, 2.5, 3.0])
def test_an_aperiodic_mode_wider_than_the_band_is_counted(gain: float) -> None:
    """Once undecided: locus and rows counted it, and the poles did not believe it, so far out of the band.

    Of Y = -gain / (1 + s T) behind 1 ohm and L it is the root of 1 + s T = gain (1 + s L), the coupling of L left out.
    """
    nu_hz, t_s, grid = np.geomspace(0.5, 1000.0, 100), 1.0 / 8000.0, SeriesRL(1.0, 0.01, F1_HZ)
    y = np.diag([-gain, 0.3]) / (1.0 + 2j * np.pi * nu_hz[:, None, None] * t_s)
    response = FrequencyResponse(F1_HZ + nu_hz, T_PN @ y @ np.linalg.inv(T_PN), F1_HZ, meta={"stable_on": IDEAL})
    pole = (gain - 1.0) / (t_s - gain * 0.01 / (2.0 * np.pi * F1_HZ))
    assert gain < 1.0 or pole > 1.5 * 2.0 * np.pi * nu_hz[-1]
    assert judged(response, grid.r_ohm, grid.x_ohm).verdict == ("unstable" if pole > 0.0 else "stable")
