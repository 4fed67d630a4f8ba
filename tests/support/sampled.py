"""The exact small-signal response of a sampled plant whose state can be set: Jacobians along one period.

A periodic orbit of period T_p, perturbed by v = exp(j w t): the deviation one period on is Phi x + b, in
the steady state exp(j w T_p) x. Phi and b are central differences of the plant's own runs over one period,
so nothing is known of the plant but its state as real numbers; neither frame nor controller matter.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import pi
from typing import Any

import numpy as np

from seqsweep.plant.protocol import Injection, Job, Plant, Tone

STEP = 1e-6
"""Of the differences, in parts of the state's size."""

TONE_V = 1e-3
"""Of the differences by the source (V); the response is linear to far below 1e-9 there."""


@dataclass(frozen=True)
class Orbit:
    """A plant's periodic state, and the state as real numbers (n,): ``moved(x)`` is a state again.

    ``periods`` fundamental periods hold a whole number of steps.
    """

    plant: Plant
    state: Any
    numbers: Callable[[Any], np.ndarray]
    moved: Callable[[Any, np.ndarray], Any]
    periods: int = 1

    @property
    def steps(self) -> int:
        return round(self.periods / (self.plant.f1_hz * self.plant.dt_s))

    def flow(self, x: np.ndarray, tone: Tone | None = None) -> tuple[np.ndarray, Any]:
        """State one period on, from the state ``x`` under a tone, and the record of that period."""
        injection = None if tone is None else Injection("series_voltage", (tone,))
        ((end, record),) = self.plant.run([Job(self.moved(self.state, x), injection)], self.steps)
        return self.numbers(end), record


def admittance_pn(orbit: Orbit, f_hz: np.ndarray) -> np.ndarray:
    """Sequence admittance (n, 2, 2) in S of the stepped plant at ``f_hz``, d axis on its fundamental voltage."""
    monodromy = _monodromy(orbit)
    _, record = orbit.flow(orbit.numbers(orbit.state))
    turn = np.exp(2j * np.angle(_mean(record.v, orbit.plant.f1_hz, record.time_s)))
    return np.array([_solved(orbit, monodromy, f, turn) for f in f_hz])


def _monodromy(orbit: Orbit) -> np.ndarray:
    x = orbit.numbers(orbit.state)
    columns = []
    for size, unit in zip(STEP * np.maximum(np.abs(x), 1.0), np.eye(len(x)), strict=True):
        columns.append((orbit.flow(x + size * unit)[0] - orbit.flow(x - size * unit)[0]) / (2.0 * size))
    return np.column_stack(columns)


def _solved(orbit: Orbit, monodromy: np.ndarray, f: float, turn: complex) -> np.ndarray:
    """Y from two excitations, at f and at the mirror; ``turn`` is exp(2j phi1)."""
    mirror = 2.0 * orbit.plant.f1_hz - f
    v_direct, i_direct = _response(orbit, monodromy, f, (f, mirror))
    v_mirror, i_mirror = _response(orbit, monodromy, mirror, (f, mirror))
    v, i = (
        np.column_stack([[x[0], turn * np.conj(x[1])] for x in pair])
        for pair in ((v_direct, v_mirror), (i_direct, i_mirror))
    )
    return i @ np.linalg.inv(v)


def _response(
    orbit: Orbit, monodromy: np.ndarray, f: float, lines: tuple[float, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Phasors of v and i at both lines under exp(2j pi f t), in the steady state, per volt."""
    x = orbit.numbers(orbit.state)
    zero = np.zeros_like(x)
    forced = _deviation(orbit, x, zero, f, 0.0)[0] + 1j * _deviation(orbit, x, zero, f, -pi / 2.0)[0]
    turn = np.exp(2j * pi * f * orbit.periods / orbit.plant.f1_hz)
    start = np.linalg.solve(turn * np.eye(len(x)) - monodromy, forced)
    _, *real = _deviation(orbit, x, start.real, f, 0.0)
    _, *imaginary = _deviation(orbit, x, start.imag, f, -pi / 2.0)
    time = orbit.state.time_s + orbit.plant.dt_s * np.arange(orbit.steps)
    found = []
    for re, im in zip(real, imaginary, strict=True):
        alpha, beta = re.real + 1j * im.real, re.imag + 1j * im.imag
        forward, backward = 0.5 * (alpha + 1j * beta), 0.5 * np.conj(alpha - 1j * beta)
        found.append([_mean(forward if line == f else backward, line, time) for line in lines])
    return np.array(found[0]), np.array(found[1])


def _mean(x: np.ndarray, f: float, time: np.ndarray) -> complex:
    return complex(np.mean(x * np.exp(-2j * pi * f * time)))


def _deviation(orbit: Orbit, x: np.ndarray, start: np.ndarray, f: float, phase: float) -> tuple[np.ndarray, ...]:
    """Deviation of end state, v and i per volt of a tone, begun ``start`` away per volt."""
    (end_1, record_1), (end_2, record_2) = (
        orbit.flow(x + sign * TONE_V * start, Tone(f, sign * TONE_V, phase)) for sign in (1.0, -1.0)
    )
    per = 1.0 / (2.0 * TONE_V)
    return (end_1 - end_2) * per, (record_1.v - record_2.v) * per, (record_1.i - record_2.i) * per
