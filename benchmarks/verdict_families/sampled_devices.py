"""A sampled controller on an L filter, exactly: the circuit between two samples by the matrix exponential.

dq frame, load direction, per unit. The bridge holds e over one interval; what the controller computes at a sample acts
one interval later. It samples i, and v as the mean of the past interval, as converters with a filter against images
do; without that filter Y itself would depend on the grid. Linearised about (v0, i0), with the angle de of the PLL:

    lf/wb i' = v - e - (rf + j lf) i            v^ = v - j v0 de          i^ = i - j i0 de
    de+ = de + T wb (kpp v^q + x)               x+ = x + T kip v^q
    i*_d = s - kp p,  s+ = s - T ki p,  p = v0 i_d + i0 . v (power drawn: the more, the less current is asked for)
    e+ = j e0 de - kpc (i* - i^) - g - j lf i^ + kff v^,     g+ = g + T kic (i* - i^)
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import expm

from .linear import Bases, J


@dataclass(frozen=True)
class Controller:
    """Parameters in pu; ``t_s`` is the interval (s)."""

    t_s: float
    lf: float
    rf: float
    kpc: float
    kic: float
    kpp: float
    kip: float
    kp: float
    ki: float
    kff: float
    v0: float
    i0: complex


@dataclass(frozen=True)
class Sampled:
    """The device; voltages in V and currents in A outside, per unit inside."""

    control: Controller
    bases: Bases

    @property
    def w1(self) -> float:
        return self.bases.w1

    @cached_property
    def law(self) -> tuple[np.ndarray, ...]:
        """Of the controller: x+ = F x + G (i, v), e+ = H x + K (i, v); x = (de, x_pll, g_d, g_q, s)."""
        c, wb, t = self.control, self.bases.w1, self.control.t_s
        i0 = np.array([c.i0.real, c.i0.imag])
        e0 = np.array([c.v0, 0.0]) - c.rf * i0 - c.lf * J @ i0
        unit = np.eye(9)
        de, x_pll, g, s, i, v = unit[0], unit[1], unit[2:4], unit[4], unit[5:7], unit[7:9]
        v_hat = v - np.outer(J @ [c.v0, 0.0], de)
        i_hat = i - np.outer(J @ i0, de)
        p = c.v0 * i[0] + i0 @ v
        wanted = np.array([c.kp * -p + s, np.zeros(9)])  # more power drawn, less current asked
        error = wanted - i_hat
        after = [de + t * wb * (c.kpp * v_hat[1] + x_pll), x_pll + t * c.kip * v_hat[1]]
        keeps = 1.0 if c.ki > 0.0 else 0.5  # without a power loop its integrator is none
        after += [*(g + t * c.kic * error), keeps * s - t * c.ki * p]
        e = np.outer(J @ e0, de) - c.kpc * error - g - c.lf * J @ i_hat + c.kff * v_hat
        f, h = np.array(after), np.array(e)
        return f[:, :5], f[:, 5:], h[:, :5], h[:, 5:]

    def circuit(self, r_pu: float, x_pu: float) -> tuple[np.ndarray, np.ndarray]:
        """A and B of i' = A i + B (v_source - e) with a grid in series (pu)."""
        c, wb = self.control, self.bases.w1
        total = c.lf + x_pu
        return -wb / total * ((c.rf + r_pu) * np.eye(2) + total * J), wb / total * np.eye(2)

    def admittance(self, nu_hz: np.ndarray) -> np.ndarray:
        """Ydq (n, 2, 2) in S: the component of i at the frequency of v, images of the sampling left aside."""
        nu = np.atleast_1d(np.asarray(nu_hz, float))
        return np.array([self._at(2j * np.pi * f) for f in nu]) / self.bases.z_ohm

    def _at(self, s: complex) -> np.ndarray:
        t = self.control.t_s
        a, b = self.circuit(0.0, 0.0)
        z, one = np.exp(s * t), np.eye(2)
        mean = (1.0 - 1.0 / z) / (
            s * t
        )  # of a rotating phasor over the past interval; the share of e that is held, too
        phi = expm(a * t)
        by_e = np.linalg.solve(a, (phi - one) @ b)
        by_v = np.linalg.solve(s * one - a, (z * one - phi) @ b)
        f, g, h, k = self.law
        # unknowns i, e, x for each of the two voltages: z i = phi i - by_e e + by_v v, z x = F x + G, z e = H x + K
        m = np.zeros((9, 9), complex)
        m[0:2, 0:2], m[0:2, 2:4] = z * one - phi, by_e
        m[2:4, 0:2], m[2:4, 2:4], m[2:4, 4:] = -k[:, :2], z * one, -h
        m[4:, 0:2], m[4:, 4:] = -g[:, :2], z * np.eye(5) - f
        e = np.linalg.solve(m, np.vstack([by_v, mean * k[:, 2:], mean * g[:, 2:]]))[2:4]
        return np.linalg.solve(s * one - a, b @ (one - e * mean))

    @cached_property
    def own_poles(self) -> np.ndarray:
        """Poles on an ideal source (rad/s): logarithms of the multipliers of one interval."""
        return self._poles(0.0, 0.0)

    def closed_loop(self, r_ohm: float, x_ohm: float) -> np.ndarray:
        """Poles (rad/s) on a grid; the circuit between samples is exact with the grid in it."""
        return self._poles(r_ohm / self.bases.z_ohm, x_ohm / self.bases.z_ohm)

    def _poles(self, r_pu: float, x_pu: float) -> np.ndarray:
        multipliers = np.linalg.eigvals(self.interval(r_pu, x_pu))
        return np.log(multipliers[np.abs(multipliers) > 1e-9] + 0j) / self.control.t_s

    def interval(self, r_pu: float, x_pu: float) -> np.ndarray:
        """Transition (11, 11) of (i, e before, e now, x) over one interval, the source at rest.

        The mean of v over the interval that ends at the sample follows from i at both its ends and e before.
        """
        c, wb = self.control, self.bases.w1
        a, b = self.circuit(r_pu, x_pu)
        phi = expm(a * c.t_s)
        by_e = np.linalg.solve(a, (phi - np.eye(2)) @ b)
        back = np.linalg.inv(phi)  # i at the beginning of the interval: back (i + by_e e)
        rise_i, rise_e = (np.eye(2) - back) / c.t_s, -back @ by_e / c.t_s
        mean_i, mean_e = np.linalg.solve(a, rise_i), np.linalg.solve(a, rise_e + b)
        z_grid = r_pu * np.eye(2) + x_pu * J
        v_of_i = -z_grid @ mean_i - x_pu / wb * rise_i
        v_of_e = -z_grid @ mean_e - x_pu / wb * rise_e
        f, g, h, k = self.law
        step = np.zeros((11, 11))
        step[0:2, 0:2], step[0:2, 4:6] = phi, -by_e
        step[2:4, 4:6] = np.eye(2)
        step[4:6, 0:2], step[4:6, 2:4], step[4:6, 6:] = k[:, :2] + k[:, 2:] @ v_of_i, k[:, 2:] @ v_of_e, h
        step[6:, 0:2], step[6:, 2:4], step[6:, 6:] = g[:, :2] + g[:, 2:] @ v_of_i, g[:, 2:] @ v_of_e, f
        return step


def draw_sampled(rng: np.random.Generator, bases: Bases) -> tuple[Sampled, str]:
    """A random one: 4 to 12 kHz, PLL 5 to 60 Hz, with or without a power loop and feed-forward."""
    t_s = 1.0 / float(rng.choice([4000.0, 5000.0, 8000.0, 10000.0])) * 50.0 / bases.f1_hz
    pll_hz, zeta = float(np.exp(rng.uniform(np.log(5.0), np.log(60.0)))), rng.uniform(0.5, 1.0)
    w, lf = 2.0 * np.pi * pll_hz, float(0.15 * np.exp(rng.uniform(-0.4, 0.4)))
    gain = lf / bases.w1 / t_s * rng.uniform(0.1, 0.3)
    power_loop = bool(rng.random() < 0.5)
    control = Controller(
        t_s=t_s,
        lf=lf,
        rf=0.005,
        kpc=gain,
        kic=gain * float(np.exp(rng.uniform(np.log(50.0), np.log(400.0)))),
        kpp=2.0 * zeta * w / bases.w1,
        kip=w**2 / bases.w1,
        kp=rng.uniform(0.05, 0.5) if power_loop else 0.0,
        ki=rng.uniform(5.0, 40.0) if power_loop else 0.0,
        kff=float(rng.choice([0.0, 1.0, rng.uniform(0.3, 1.0)])),
        v0=rng.uniform(0.9, 1.1),
        i0=complex(-rng.uniform(0.1, 1.0), rng.uniform(-0.3, 0.3)),
    )
    text = f"sampled at {1e-3 / t_s:.1f} kHz, PLL {pll_hz:.1f} Hz, feed-forward {control.kff:.2f}"
    return Sampled(control, bases), text + (", power loop" if power_loop else "")
