"""Operating points of devices as a sweep would find them, from their exact linearisation.

The reference turbine, and a droop-controlled grid-forming inverter with the numbers of PowerSimulationsDynamics' "test
23", which is stable on an ideal source.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from seqsweep.identify.frames import dq_to_pn
from seqsweep.identify.response import FrequencyResponse
from seqsweep.identify.surrogate.surrogate import AXES, Region, Surrogate, name_of
from seqsweep.plant.inverters.parameters import FormingParameters
from seqsweep.tuning.region.loadflow import Situation
from seqsweep.tuning.siso import SeriesRL, siso

from . import inverter_oracle, oracle

U_V = 690.0
BASES = {"rated_voltage_v": U_V, "rated_power_va": 1.632e6}
F_HZ = 50.0 + np.logspace(-0.3, np.log10(950.0), 30)
PV = Region(np.array([0.2, 0.0, 0.9]), np.array([1.3, 0.0, 1.1]))
PQV = Region(np.array([0.2, -0.4, 0.9]), np.array([1.3, 0.4, 1.1]))


PQV_DROOP = Region(np.array([0.4, -0.8, 0.9]), np.array([2.2, 0.8, 1.1]))
DROOP = FormingParameters(k_d=0.0, k_w=20.0, t_a_s=0.63662)


def exact(point: np.ndarray, f_hz: np.ndarray = F_HZ) -> np.ndarray:
    """Y (f, 2, 2) of the turbine in the pn frame at (P, Q, V) in MW, Mvar, pu."""
    return oracle.admittance_pn(f_hz, point[0] * 1e6, point[2] * U_V, q_var=point[1] * 1e6)


def exact_droop(point: np.ndarray, f_hz: np.ndarray = F_HZ) -> np.ndarray:
    """Y (f, 2, 2) of the droop inverter in the pn frame at (P, Q, V) in MW, Mvar, pu."""
    power = 1e6 * complex(point[0], point[1]) / DROOP.s_rated_va
    model = inverter_oracle.linearise(DROOP, "forming", power, point[2])
    return inverter_oracle.admittance_pn(model, f_hz) * DROOP.s_rated_va / DROOP.u_rated_v**2


def swept(point: np.ndarray, noise: float = 0.0, random: np.random.Generator | None = None) -> FrequencyResponse:
    """One operating point of the turbine with relative ``noise`` and the covariance that says so, and its current."""
    return TURBINE.swept(point, noise, random)


def facts(point: np.ndarray) -> dict[str, float]:
    """The terminal current at f1, as a table holds it."""
    v = point[2] * U_V
    x, _ = oracle.equilibrium(point[0] * 1e6, v, q_var=point[1] * 1e6)
    into = complex(*oracle.current(x, np.array([v, 0.0]))) / np.sqrt(3.0)
    power_va = np.sqrt(3.0) * v * into.conjugate()
    return {
        "active_power_into_device_w": power_va.real,
        "reactive_power_into_device_var": power_va.imag,
        "current_a": abs(into),
        "current_angle_rad": float(np.angle(into)),
        "voltage_v": v,
    }


@dataclass(frozen=True)
class Device:
    """A device whose admittance is known in closed form.

    Attributes
    ----------
    name : str
        What it is.
    exact : callable
        Y (f, 2, 2) in the pn frame (S) at an operating point (3,) and frequencies (f,).
    facts : callable or None
        The measured fundamental at an operating point (3,), as a table holds it.
    """

    name: str
    exact: Callable[[np.ndarray, np.ndarray], np.ndarray]
    facts: Callable[[np.ndarray], dict[str, float]] | None = None

    def swept(
        self,
        point: np.ndarray,
        noise: float = 0.0,
        random: np.random.Generator | None = None,
        f_hz: np.ndarray = F_HZ,
    ) -> FrequencyResponse:
        """An operating point (3,) with relative ``noise`` and the covariance that says so."""
        y = self.exact(point, f_hz)
        size = np.linalg.norm(y, axis=(1, 2))[:, None, None]
        if noise:
            assert random is not None
            errors = random.normal(size=(2, *y.shape))
            y = y + noise * size / np.sqrt(8.0) * (errors[0] + 1j * errors[1])
        covariance = (max(noise, 1e-12) ** 2 / 8.0 * size**2) * np.eye(8)
        meta = {"op_id": name_of(point), **dict(zip(AXES, map(float, point), strict=True))}
        known = {} if self.facts is None else {"fundamental": self.facts(point)}
        return FrequencyResponse(f_hz, y, 50.0, covariance=covariance, meta={**meta, **known})


TURBINE = Device("turbine", exact, facts)
DROOP_INVERTER = Device("droop inverter", exact_droop)


def unseen(region: Region, n: int, seed: int) -> np.ndarray:
    """Random points (n, 3) of a region."""
    return region.low + np.random.default_rng(seed).random((n, 3)) * (region.high - region.low)


def errors_of(surrogate: Surrogate, points: np.ndarray, truth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(p, f) true errors and 95 % radii, both relative to ||Y||."""
    found = surrogate.evaluate(points)
    off = np.linalg.norm(dq_to_pn(found.y) - truth, axis=(2, 3)) / np.linalg.norm(truth, axis=(2, 3))
    return off, found.relative


def bank_of_27() -> Iterator[Situation]:
    """Three lengths of the line of Table I, three ratios R/X, three source voltages."""
    for length, ratio, source_pu in itertools.product((0.45, 0.6, 0.75), (0.05, 0.15, 0.3), (0.97, 1.0, 1.03)):
        x_ohm = 0.25 * length
        grid = SeriesRL(ratio * x_ohm, x_ohm, 50.0)
        yield Situation(f"{x_ohm:g} ohm, R/X {ratio:g}, {source_pu:g} pu", grid, source_pu, U_V)


def exact_margin(point: np.ndarray, situation: Situation) -> float:
    """m by the exact Y at 400 frequencies: the angle of -Y1/Yg1 interpolated linearly between two of them."""
    f_hz = 50.0 + np.logspace(0.0, np.log10(950.0), 400)
    seen = siso(f_hz, exact(point, f_hz), situation.grid)
    ratio = np.log(-seen.y1 / seen.yg1)
    turn, size = np.unwrap(ratio.imag) / (2.0 * np.pi), ratio.real
    at = np.flatnonzero(np.diff(np.floor(turn)))
    if len(at) == 0:
        return float("inf")
    whole = np.maximum(np.floor(turn[at]), np.floor(turn[at + 1]))
    share = (whole - turn[at]) / (turn[at + 1] - turn[at])
    return float(np.exp(-(size[at] + share * (size[at + 1] - size[at])).max()))


def brute_force(situations: list[Situation], n_p: int, n_q: int, region: Region = PQV) -> float:
    """Least exact m over a lattice of powers and the border of the region's voltages, on every grid."""
    return min(exact_margin(point, each) for each in situations for point in admissible(each, n_p, n_q, region))


def admissible(situation: Situation, n_p: int, n_q: int, region: Region) -> Iterator[np.ndarray]:
    """Points of the lattice whose |v| is within the region, and those at its ends."""
    for p in np.linspace(region.low[0], region.high[0], n_p):
        powers = np.linspace(region.low[1], region.high[1], n_q)
        volts = np.array([_voltage(p, q, situation) for q in powers])
        inside = (volts >= region.low[2]) & (volts <= region.high[2])
        yield from (np.array([p, q, v]) for q, v in zip(powers[inside], volts[inside], strict=True))
        for end in (region.low[2], region.high[2]):
            for k in np.flatnonzero((volts[:-1] < end) != (volts[1:] < end)):
                if np.isfinite(volts[k : k + 2]).all():
                    q = powers[k] + (end - volts[k]) / (volts[k + 1] - volts[k]) * (powers[k + 1] - powers[k])
                    yield np.array([p, q, end])


def _voltage(p_mw: float, q_mvar: float, situation: Situation) -> float:
    grid, source_pu = situation.grid, situation.source_voltage_pu
    assert isinstance(grid, SeriesRL)
    assert source_pu is not None
    try:
        return oracle.terminal_voltage(p_mw * 1e6, grid.r_ohm, grid.l_h, source_pu * U_V, q_var=q_mvar * 1e6) / U_V
    except ValueError:
        return float("nan")
