"""How exact a sweep is. Every test prints what it measured: ``python -m pytest -s tests/sweep/test_accuracy.py``.

The yardstick is the turbine's exact linearisation in continuous time (`oracle`), which shares nothing
with the plant but the values of its parameters. The sweep knows the plant by its terminals alone.
"""

from __future__ import annotations

from functools import cache
from math import pi

import numpy as np
import pytest

from seqsweep.identify.admittance import solve_pn
from seqsweep.identify.fourier import harmonics, line, periodic_window
from seqsweep.plant.protocol import Injection, Job, OperatingPoint, Source, Tone, Window
from seqsweep.plant.registry import make_plant
from seqsweep.plant.rl_branch import RLBranch, admittance, continuous_admittance
from seqsweep.plant.turbine.parameters import LINE_L_H, LINE_R_OHM, LINE_X_OHM
from seqsweep.plant.turbine.reference import ReferenceTurbine
from seqsweep.sweep.config.sections import Config
from seqsweep.sweep.excitation.frequencies import coherent_block, generated
from seqsweep.sweep.measure.measure import measure
from seqsweep.sweep.planning import make_plan

from ..support import oracle

P_MW, U_V = 0.65, 690.0
BAND = {"f_min_hz": 1.0, "f_max_hz": 1000.0, "points": 100}
IN_PLACE = {"kind": "thevenin", "r_ohm": LINE_R_OHM, "x_ohm": LINE_X_OHM}

BAR_WORST, BAR_MEDIAN = 1e-4, 1e-5
"""What the turbine's page promises of the default step; measured errors are printed beside it."""


def swept(
    plant, sweep, *, power_mw=P_MW, voltage_pu=1.0, q_mvar=0.0, source=None, kind="series_voltage", amplitude_pu=5e-4
):
    """(f, y) of a campaign of one operating point; every row must be ok."""
    point = {"active_power_mw": power_mw, "terminal_voltage_pu": voltage_pu, "reactive_power_mvar": q_mvar}
    config = Config.from_dict(
        {
            "campaign": {"name": "accuracy"},
            "plant": {"id": plant.id},
            "operating_point": [point],
            "sweep": sweep,
            "injection": {"kind": kind, "amplitude_pu": amplitude_pu},
            "source": source or {"kind": "ideal"},
        }
    )
    plan = make_plan(config, plant)
    rows = sorted((row for batch in plan.batches() for row in measure(plant, batch).rows), key=lambda r: r.f_hz)
    assert {row.status for row in rows} == {"ok"}
    assert len(rows) == len(plan.points)
    parts = np.array([row.y for row in rows])
    return np.array([row.f_hz for row in rows]), (parts[:, ::2] + 1j * parts[:, 1::2]).reshape(-1, 2, 2)


@cache
def ideal_sweep(power_mw=P_MW, voltage_pu=1.0):
    return swept(make_plant("dpmsg-v1"), BAND, power_mw=power_mw, voltage_pu=voltage_pu)


def relative(y, reference):
    """Frobenius norm of the difference over that of the reference, per frequency."""
    return np.linalg.norm(y - reference, axis=(-2, -1)) / np.linalg.norm(reference, axis=(-2, -1))


def report(what, error, f_hz, bar):
    worst = int(np.argmax(error))
    print(
        f"\n  {what}: worst {error[worst]:.2e} at {f_hz[worst]:.4g} Hz, median {np.median(error):.2e} "
        f"(bar {bar}, {len(error)} points)",
        end="",
    )


# The reference turbine against its linearisation


@pytest.mark.parametrize(
    ("power_mw", "voltage_pu"), [(0.65, 1.0), (0.2, 0.9), (0.2, 1.1), (1.3, 0.9), (1.3, 1.1)], ids=str
)
def test_the_swept_turbine_is_its_exact_linearisation(power_mw, voltage_pu):
    """RK4 of 50 us turns j w by (w h)^4 / 120 of itself, 8e-5 at 1 kHz: so the bar. The median sees settling alone."""
    f_hz, y = ideal_sweep(power_mw, voltage_pu)
    assert len(f_hz) == 100
    assert f_hz[0] == 1.0
    assert f_hz[-1] == 1000.0
    error = relative(y, oracle.admittance_pn(f_hz, power_mw * 1e6, voltage_pu * U_V))
    report(f"{power_mw} MW, {voltage_pu} pu against the linearisation", error, f_hz, "1e-4, median 1e-5")
    assert error.max() <= BAR_WORST
    assert np.median(error) <= BAR_MEDIAN


PRINTED = """
5    | +0.234844-1.166782j   | -0.0778075+0.4003271j | -0.0778043+0.4003336j | +0.2366293-1.480966j
23   | -0.173006-1.910209j   | +0.2245512+1.520572j  | +0.2245612+1.520576j  | -0.1719478-2.224378j
60   | -0.8320882+0.2671487j | +0.8298293+0.0570844j | +0.8298293+0.0570837j | -0.8324830-0.0470075j
150  | +0.8613961+2.292534j  | +0.0166181-0.1662755j | +0.0166180-0.1662656j | +0.8573100+1.978310j
400  | +2.831369-0.5595668j  | -0.0469478-0.0380197j | -0.0469492-0.0380275j | +2.818054-0.8730620j
1000 | +0.5325129+2.032454j  | -0.0074511-0.0013679j | -0.0074516-0.0013678j | +0.4953099+1.721583j
"""
"""The turbine's page: 0.65 MW, 690 V, ideal source; S, load direction, continuous time."""


def test_the_swept_turbine_is_the_printed_table():
    printed = [[complex(cell.strip()) for cell in row.split("|")] for row in PRINTED.strip().splitlines()]
    f_hz = np.array([row[0].real for row in printed])
    expected = np.array([row[1:] for row in printed]).reshape(-1, 2, 2)
    found, y = swept(make_plant("dpmsg-v1"), {"f_hz": f_hz.tolist()})
    assert found.tolist() == f_hz.tolist()
    error = relative(y, expected)
    print("\n  swept, in S, with the relative difference from the printed row")
    for f, row, e in zip(f_hz, y, error, strict=True):
        cells = "  ".join(f"{element:+.7f}" for element in row.ravel())
        print(f"  {f:6.0f} Hz  {cells}  {e:.1e}")
    assert error.max() <= BAR_WORST


@pytest.mark.parametrize("kind", ["series_voltage", "shunt_current"])
def test_a_device_swept_in_place_is_the_device_on_an_ideal_source(kind):
    """The same P and |v_pcc| behind 1.0 Z: whatever the line adds to both v and i must drop out of the 2x2 solve.

    With the default 5e-4 pu: beside the loop's own resonance 1e-3 pu of shunt current drive the device
    out of the small signal (next test). The 7e-5 at 1 kHz are RK4's, in the resonance of the line with the shunt.
    """
    f_hz, y = swept(make_plant("dpmsg-v1"), BAND, source=IN_PLACE, kind=kind)
    f_ideal, y_ideal = ideal_sweep()
    assert f_hz.tolist() == f_ideal.tolist()
    error = relative(y, y_ideal)
    report(f"in place on 1.0 Z with {kind} against the ideal source", error, f_hz, "1e-4")
    assert error.max() <= 1e-4


@pytest.mark.parametrize("kind", ["series_voltage", "shunt_current"])
def test_what_the_resonance_adds_in_place_is_the_devices_own_nonlinearity(kind):
    """A method's error would not know the amplitude; a device's third order goes with its square."""
    errors = {}
    for amplitude_pu in (1e-3, 2e-4):
        f_hz, y = swept(
            make_plant("dpmsg-v1"),
            {"f_hz": [25.0, 75.0], "tolerance": 1e-7},
            source=IN_PLACE,
            kind=kind,
            amplitude_pu=amplitude_pu,
        )
        errors[amplitude_pu] = relative(y, oracle.admittance_pn(f_hz, P_MW * 1e6, U_V)).max()
    ratio = errors[1e-3] / errors[2e-4]
    print(f"\n  {kind}, 25 Hz in place: " + ", ".join(f"{e:.1e} with {a:g} pu" for a, e in errors.items()), end="")
    assert 0.8 * 25.0 <= ratio <= 1.2 * 25.0


def test_one_injection_and_a_plain_quotient_would_be_wrong_in_place():
    """Why two injections: behind a line the mirror's voltage is not zero, and Ypn carries it into I(f)."""
    f_hz, y = ideal_sweep()
    z2 = LINE_R_OHM + 2j * pi * (f_hz - 100.0) * LINE_L_H
    quotient = y[:, 0, 0] - y[:, 0, 1] * y[:, 1, 0] * z2 / (1.0 + y[:, 1, 1] * z2)
    off = np.abs(quotient / y[:, 0, 0] - 1.0)
    report("I/V of a single injection in place, against Ypp", off, f_hz, "none: this is the fault avoided")
    assert off.max() > 0.1


# The branch against its closed form


@pytest.mark.parametrize("source", [{"kind": "ideal"}, IN_PLACE], ids=["ideal", "in place"])
def test_the_swept_branch_is_its_closed_form(source):
    """The trapezoidal rule is the closed form with a warped frequency: nothing is left but rounding and settling."""
    plant = RLBranch()
    f_hz, y = swept(plant, BAND, source=source)
    error = relative(y, admittance(plant, f_hz))
    report(f"branch, {source['kind']} source, against its warped closed form", error, f_hz, "1e-6")
    assert error.max() <= 1e-6


def test_the_warping_of_the_branch_is_the_trapezoidal_rules():
    """Against 1/(R + j w L) the whole error is (w h)^2 / 12, the textbook's leading term."""
    plant = RLBranch()
    f_hz, y = swept(plant, BAND)
    y_continuous = continuous_admittance(plant, f_hz)
    error = np.abs(y[:, 0, 0] / y_continuous[:, 0, 0] - 1.0)
    w = 2.0 * pi * f_hz
    expected = (w * plant.dt_s) ** 2 / 12.0 * np.abs(1j * w * plant.l_h * y_continuous[:, 0, 0])
    report("branch against 1/(R + j w L), unwarped", error, f_hz, "(w h)^2 / 12")
    high = f_hz > 100.0  # below, the warping drowns in the 1e-7 of settling
    # The next term of tan x = x + x^3/3 + 2 x^5/15 is 0.4 (w h / 2)^2 of the first, 1 % at 1 kHz.
    assert np.allclose(error[high], expected[high], rtol=0.015)


# Two runs, two angles, two phases: one identity


def two_injections(plant, f_hz, n_blocks, *, angle_rad, phases_rad):
    """Y (2, 2) at ``f_hz`` from two shots of these phases, the source turned by ``angle_rad``; driven by hand."""
    state = plant.settle(OperatingPoint(P_MW * 1e6, U_V), Source(angle_rad=angle_rad))
    block = coherent_block(plant.f1_hz, plant.dt_s)
    ((_, record),) = plant.run([Job(state, None)], block.steps)
    phi1 = float(np.angle(line(record.v, plant.f1_hz, record.t0_s, record.dt_s)))
    lines_hz = (f_hz, 2.0 * plant.f1_hz - f_hz)
    amplitude = 1e-3 * plant.rating.peak_voltage_v
    tones = [Tone(f, amplitude, phase) for f, phase in zip(lines_hz, phases_rad, strict=True)]
    jobs = [Job(state, Injection("series_voltage", (tone,))) for tone in tones]
    answers = plant.run_phasors(jobs, [Window(f_hz, n_blocks)] * 2, block.steps, 4 * n_blocks)
    window_s = n_blocks * block.duration_s

    def perturbation(sums, waveform):
        at_rest = harmonics(waveform, record.t0_s, record.dt_s)
        heard = [periodic_window(at_rest, round(f * window_s), n_blocks) for f in lines_hz]
        return sums[-n_blocks:].sum(axis=0) - np.array(heard)

    v = np.array([perturbation(phasors.v, record.v) for _, phasors in answers])
    i = np.array([perturbation(phasors.i, record.i) for _, phasors in answers])
    y, _ = solve_pn(v, i, phi1)
    return y


def test_the_mirror_identity_joins_runs_of_different_phases_and_angles():
    """Ynn(f) = conj Ypp(2 f1 - f) and Ynp(f) = conj Ypn(2 f1 - f) for every real device.

    The two sides share no run, no injection phase and no source angle, so a phasor that depends on
    absolute time, or an angle of the fundamental left out, shows here at full size.
    """
    plant = ReferenceTurbine()
    rng = np.random.default_rng(20)
    grid = generated(1.0, 1000.0, 12, "log", plant.f1_hz, plant.dt_s)
    f_hz = np.array([point.f_hz for point in grid])
    errors, angle_s = [], []
    for point in grid:
        angles = rng.uniform(-pi, pi, 2)
        angle_s.append(angles[1] - angles[0])
        here = two_injections(
            plant, point.f_hz, point.window_blocks, angle_rad=angles[0], phases_rad=rng.uniform(-pi, pi, 2)
        )
        mirrored = two_injections(
            plant, 100.0 - point.f_hz, point.window_blocks, angle_rad=angles[1], phases_rad=rng.uniform(-pi, pi, 2)
        )
        flipped = np.conj(mirrored[::-1, ::-1])
        errors.append(float(relative(here, flipped)))
    report("mirror identity between runs of different phases and angles", np.array(errors), f_hz, "1e-5")
    assert max(errors) <= 1e-5
    assert np.ptp(angle_s) > 1.0  # the angles did differ


# The closed loop: eigenvalues, and what the simulation shows of them

TABULATED = [(1.0, -13.45, 25.59), (1.2, -4.74, 26.14), (1.4, 9.57, 26.26)]
"""Multiple of Table I's line; sigma (rad/s) and frequency (Hz, dq) of the critical mode, as the page prints them."""


def at_rest_on(plant, scale):
    source = Source("thevenin", scale * LINE_R_OHM, scale * LINE_L_H, voltage_v=U_V)
    return plant.equilibrium(OperatingPoint(P_MW * 1e6, None), source)


def critical(poles):
    return oracle.resonance_pole(np.asarray(poles))


@pytest.mark.parametrize(("scale", "sigma", "hertz"), TABULATED)
def test_the_plants_own_poles_are_the_tabulated_ones(scale, sigma, hertz):
    """Poles of the stepped plant's flow; 5e-3 is half of the last printed digit, which the step must not move."""
    plant = ReferenceTurbine()
    pole = critical(plant.linearise(at_rest_on(plant, scale)))
    exact = critical(oracle.closed_loop_poles(P_MW * 1e6, scale * LINE_R_OHM, scale * LINE_L_H, source_voltage_v=U_V))
    print(
        f"\n  {scale} Z: stepped {pole.real:+.4f} rad/s, {pole.imag / 2 / pi:.4f} Hz; exact {exact.real:+.4f}, "
        f"{exact.imag / 2 / pi:.4f}; page {sigma:+.2f}, {hertz:.2f}",
        end="",
    )
    assert abs(pole.real - sigma) <= 5.1e-3
    assert abs(pole.imag / (2.0 * pi) - hertz) <= 5.1e-3
    # Central differences of 1e-5 leave 1e-5 of the pole at most.
    assert abs(pole - exact) <= 1e-4 * abs(exact)


def matrix_pencil(x, dt_s, order):
    """Poles (rad/s) of a sum of ``order`` damped exponentials sampled at ``dt_s``, and their weights."""
    n = len(x) // 2
    hankel = np.lib.stride_tricks.sliding_window_view(x, n)
    _, _, vh = np.linalg.svd(hankel, full_matrices=False)
    basis = vh[:order].T  # row space: n samples of each exponential
    z = np.linalg.eigvals(np.linalg.lstsq(basis[:-1], basis[1:], rcond=None)[0])
    weights = np.linalg.lstsq(np.vander(z, len(x), increasing=True).T, x.astype(complex), rcond=None)[0]
    return np.log(z) / dt_s, weights


@pytest.mark.parametrize(("scale", "sigma", "hertz"), TABULATED)
def test_the_simulation_rings_with_the_tabulated_mode(scale, sigma, hertz):
    """A 40 ms kick of 1e-6 pu from the equilibrium, then nothing: what rings on is the mode.

    Growth and frequency are read off the current alone. At 1.4 Z it grows by exp(9.57 * 0.9) = 5500, so
    the kick has to be that small to stay in the small signal for as long as it is listened to.
    """
    plant = ReferenceTurbine()
    start = at_rest_on(plant, scale)
    tone = Tone(plant.f1_hz + hertz, 1e-6 * plant.rating.peak_voltage_v)
    ((kicked, _),) = plant.run([Job(start, Injection("series_voltage", (tone,)))], 800)
    ((_, record),) = plant.run([Job(kicked, None)], 18_000)
    ((_, quiet),) = plant.run([Job(start, None)], 400)
    to_dq = np.exp(-2j * pi * plant.f1_hz * record.time_s)
    deviation = (record.i * to_dq - np.mean(quiet.i * np.exp(-2j * pi * plant.f1_hz * quiet.time_s)))[2000::20]
    # Eight exponentials: the mode, the DC link's, the PLL's and the rotor's, each with its conjugate.
    poles, weights = matrix_pencil(deviation.real, 20 * plant.dt_s, 8)
    ringing = (poles.imag > 2.0 * pi * 15.0) & (poles.imag < 2.0 * pi * 40.0)
    pole = poles[ringing][np.argmax(np.abs(weights[ringing]))]
    print(
        f"\n  {scale} Z in time: {pole.real:+.3f} rad/s, {pole.imag / 2 / pi:.3f} Hz; page {sigma:+.2f}, {hertz:.2f} "
        f"({'grows' if pole.real > 0 else 'decays'}); bar 2 %",
        end="",
    )
    assert abs(pole.real - sigma) <= 0.02 * abs(sigma)
    assert abs(pole.imag / (2.0 * pi) - hertz) <= 0.02 * hertz
    grew = np.max(np.abs(deviation[-100:])) > np.max(np.abs(deviation[:100]))
    assert grew == (scale == 1.4)


# The step


def test_the_error_falls_with_the_step_until_something_else_is_larger():
    """The default, 50 us, is chosen where the integrator's share is below the rest: half the step gains little."""
    print("\n  step (us)   worst error   at (Hz)   median")
    worst = {}
    for dt_us in (25, 50, 100, 200):
        f_hz, y = swept(ReferenceTurbine(dt_s=dt_us * 1e-6), {**BAND, "points": 30})
        error = relative(y, oracle.admittance_pn(f_hz, P_MW * 1e6, U_V))
        worst[dt_us] = error.max()
        print(f"  {dt_us:9d} {error.max():13.2e} {f_hz[np.argmax(error)]:9.4g} {np.median(error):8.1e}")
    assert worst[50] <= BAR_WORST
    assert worst[100] <= worst[200]
    assert worst[50] <= 1.5 * worst[100]
