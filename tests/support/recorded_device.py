"""A linear device with an exact answer under voltages of our choice: recordings of every kind, without any integrator.

In the dq frame of the fundamental, d along its voltage, q leading, load direction, s = 2 pi j (f - f1):

    Zdq = [[R + s L + K / (1 + s tau), -w1 L], [w1 L, R + s L]],    Y = T Zdq^-1 T^-1,  T = [[1, j], [1, -j]].
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .by_hand import Stretch

T = np.array([[1, 1j], [1, -1j]])


@dataclass(frozen=True)
class Device:
    """R (ohm), inductance L (H), K (ohm), tau (s) and the fundamental (Hz, V phase peak, A phase peak, rad)."""

    r: float = 0.35
    inductance: float = 2.1e-3
    k: float = 0.8
    tau: float = 4e-3
    f1_hz: float = 50.0
    v1: float = 326.6
    i1: complex = 40.0 * np.exp(-0.3j)
    phi1: float = 0.4

    def y(self, f_hz):
        """Admittance (2, 2) in S at a signed frequency (Hz)."""
        s, w1 = 2j * np.pi * (f_hz - self.f1_hz), 2 * np.pi * self.f1_hz
        r, x = self.r + s * self.inductance, w1 * self.inductance
        z = np.array([[r + self.k / (1 + s * self.tau), -x], [x, r]])
        return T @ np.linalg.inv(z) @ np.linalg.inv(T)

    def stretch(self, lines, length_s, dt_s, *, t0_s=0.0, noise=0.0, rng=None):
        """v and i under ``lines`` {f (Hz, signed): phasor (V) in the frame of v1}, white noise on every phase."""
        t = t0_s + dt_s * np.arange(round(length_s / dt_s))
        v, i = np.full(len(t), self.v1 + 0j), np.full(len(t), complex(self.i1))
        for f, phasor in lines.items():
            turn = np.exp(2j * np.pi * (f - self.f1_hz) * t)
            y = self.y(f)
            v += phasor * turn
            i += y[0, 0] * phasor * turn + np.conj(y[1, 0] * phasor * turn)
        frame = np.exp(1j * (2 * np.pi * self.f1_hz * t + self.phi1))
        return noisy(Stretch(v * frame, i * frame, dt_s), noise, self, rng)


def random_device(rng, f1_hz=50.0):
    """A device of the same make with values of its own."""
    device = Device(f1_hz=f1_hz, phi1=rng.uniform(-3, 3))
    scale = rng.uniform(0.5, 2.0, 4)
    return replace(
        device, r=0.35 * scale[0], inductance=2.1e-3 * scale[1] * 50.0 / f1_hz, k=0.8 * scale[2], tau=4e-3 * scale[3]
    )


def noisy(stretch, level, device, rng):
    """White noise of ``level`` times the fundamental's peak, independent on three phases of v and of i."""
    if not level:
        return stretch
    turn = 2.0 / 3.0 * np.exp(2j * np.pi / 3.0 * np.arange(3))
    v, i = (
        x + size * level * rng.normal(size=(len(x), 3)) @ turn
        for x, size in ((stretch.v, device.v1), (stretch.i, abs(device.i1)))
    )
    return Stretch(v, i, stretch.dt_s)


def joined(stretches):
    """One after the other."""
    return Stretch(
        np.concatenate([s.v for s in stretches]), np.concatenate([s.i for s in stretches]), stretches[0].dt_s
    )


def tones(rng, f_hz, size_v, leak=0.2):
    """Lines of tones at ``f_hz`` of about ``size_v`` and, behind a source impedance, of their mirrors: per f1."""

    def lines(f1_hz):
        found = {}
        for f in f_hz:
            phasor = size_v * rng.uniform(0.5, 1.5) * np.exp(1j * rng.uniform(0, 6.28))
            found[f] = found.get(f, 0) + phasor
            mirror = 2 * f1_hz - f
            found[mirror] = found.get(mirror, 0) + leak * phasor * rng.uniform(0.2, 1) * np.exp(1j * rng.uniform(0, 6))
        return found

    return lines


def chi_square(point, truth):
    """Distance (d^T C^-1 d) of each element of a row's Y from the truth, by its 2x2 covariance: (4,)."""
    found = []
    for k, delta in enumerate((truth - point.y).ravel()):
        part = np.array([delta.real, delta.imag])
        found.append(part @ np.linalg.solve(point.covariance[2 * k : 2 * k + 2, 2 * k : 2 * k + 2], part))
    return np.array(found)
