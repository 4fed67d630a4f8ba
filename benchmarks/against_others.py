"""Simulated seconds per CPU second: our turbine, dpsim's grid-following converter, scipy on our equations.

dpsim: EMT, 50 us, trapezoidal; a smaller device than ours (grid side only, no machine). scipy: RK45 and
LSODA at 1e-6 on the same turbine, as plain numpy (the linearisation oracle's right-hand side) and as
compiled code (the kernel's own derivatives, without the stiff shunt), under the same 0.1 % tone.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from statistics import median
from typing import Any

import numpy as np
from harness import ROOT, Report, run_script, seconds

POWER_W, VOLTAGE_V, TONE_HZ, AMPLITUDE = 0.65e6, 690.0, 77.0, 0.001


def measure(quick: bool) -> Report:
    """Figures of all of them, and their ratios to ours."""
    repetitions = 3 if quick else 7
    found = _ours(repetitions) | _scipy(repetitions, 0.2 if quick else 1.0) | _dpsim(repetitions)
    report = Report("Simulated seconds per CPU second, one core")
    for name, rate in found.items():
        report.add(name, rate, "s/s")
    best = found["reference turbine, 8 lanes, phasors"]
    for name, rate in found.items():
        if not name.startswith("reference"):
            report.add(f"ours (8 lanes) over {name}", best / rate, "x")
    report.series = {"rates": found}
    return report


def _rate(function: Callable[[], object], simulated_s: float, repetitions: int) -> float:
    """Simulated seconds per CPU second, the median."""
    return simulated_s / median(seconds(function, repetitions, time.process_time))


def _ours(repetitions: int) -> dict[str, float]:
    from seqsweep.plant.protocol import Injection, Job, OperatingPoint, Source, Tone, Window
    from seqsweep.plant.turbine.reference import ReferenceTurbine

    plant = ReferenceTurbine()
    state = plant.settle(OperatingPoint(POWER_W, VOLTAGE_V), Source())
    tone = Tone(TONE_HZ, AMPLITUDE * plant.rating.peak_voltage_v)
    job, window, simulated_s = Job(state, Injection("series_voltage", (tone,))), Window(TONE_HZ, 50), 2.0
    steps, blocks = 400, round(simulated_s / (400 * plant.dt_s))

    def phasors(lanes: int) -> object:
        return plant.run_phasors([job] * lanes, [window] * lanes, steps, blocks)

    return {
        f"reference turbine, {what}": _rate(function, lanes * simulated_s, repetitions)
        for what, lanes, function in (
            ("8 lanes, phasors", 8, lambda: phasors(8)),
            ("8 lanes, waveforms kept", 8, lambda: plant.run([job] * 8, steps * blocks)),
            ("1 lane of 8 used, phasors", 1, lambda: phasors(1)),
        )
    }


def _scipy(repetitions: int, simulated_s: float) -> dict[str, float]:
    from numba import njit
    from scipy.integrate import solve_ivp

    sys.path.insert(0, str(ROOT))
    from seqsweep.plant.kernels import turbine as kernel
    from seqsweep.plant.turbine.parameters import TABLE_I
    from tests.support import oracle

    x, wind = oracle.equilibrium(POWER_W, VOLTAGE_V)
    nu, amplitude = 2.0 * np.pi * (TONE_HZ - 50.0), AMPLITUDE * VOLTAGE_V

    def plain(t: float, y: np.ndarray) -> np.ndarray:
        v = np.array([VOLTAGE_V + amplitude * np.cos(nu * t), amplitude * np.sin(nu * t)])
        return oracle.rhs(y, v, wind)

    device, p = kernel._device, TABLE_I

    @njit
    def compiled(t: float, y: Any) -> Any:
        v_re, v_im = VOLTAGE_V + amplitude * np.cos(nu * t), amplitude * np.sin(nu * t)
        c, s = np.cos(y[2]), np.sin(y[2])
        return np.array(device(y, v_re, v_im, v_re, v_im, c, s, (wind, None, None), p))

    without_shunt = np.delete(x, (2, 3))
    compiled(0.0, without_shunt)
    found = {}
    for how, rhs, start in (("plain numpy", plain, x), ("compiled, no shunt", compiled, without_shunt)):
        for method in ("RK45", "LSODA"):
            solve = _solver(solve_ivp, rhs, start, method, simulated_s)
            found[f"scipy {method} 1e-6, {how}"] = _rate(solve, simulated_s, min(repetitions, 3))
    return found


def _solver(
    solve_ivp: Any, rhs: Callable[..., Any], start: np.ndarray, method: str, simulated_s: float
) -> Callable[[], Any]:
    scale = 1e-6 * np.maximum(np.abs(start), 1.0)

    def solve() -> Any:
        answer = solve_ivp(rhs, (0.0, simulated_s), start, method=method, rtol=1e-6, atol=scale)
        assert answer.success, answer.message
        return answer

    return solve


def _dpsim(repetitions: int) -> dict[str, float]:
    """dpsim running by itself, and stepped from Python; nothing where it is not installed."""
    try:
        import dpsimpy  # noqa: F401
    except ImportError:
        print("dpsim is not installed (extra 'bench'): left out", file=sys.stderr)
        return {}
    sys.path.insert(0, str(ROOT))
    from examples.dpsim_plant import DpsimConverter, alone
    from seqsweep.plant.protocol import Job, OperatingPoint, Source

    point, simulated_s = OperatingPoint(1e4, 400.0), 2.0
    plant = DpsimConverter(settled=1e-3)
    state = plant.settle(point, Source())
    steps = round(simulated_s / plant.dt_s) - state.settling_steps

    def stepped() -> object:
        return plant.run([Job(state, None)], steps)

    inside = [_alone_s(alone, point, simulated_s) for _ in range(repetitions)]
    return {
        "dpsim GFL 50 us, its own loop": simulated_s / median(inside),
        "dpsim GFL 50 us, stepped from Python": _rate(stepped, simulated_s, repetitions),
    }


def _alone_s(alone: Callable[..., Any], point: Any, simulated_s: float) -> float:
    """CPU time (s) of dpsim's own run; building is not counted."""
    simulation = alone(point, simulated_s)
    begin = time.process_time()
    simulation.run()
    return time.process_time() - begin


if __name__ == "__main__":
    run_script("against_others", measure)
