"""Grid-following inverters: L, LC or LCL filter, PLL, current control, outer loops, feed-forward, delay. Per unit.

Currents are out of the device as in the textbooks, the last line turns them round. Frame at w1, d axis on the voltage
of the terminals. Control with hats in the frame of the PLL:

    lf/wb i_c' = e - v - (rf + j lf) i_c       LCL: v = v_C + rc (i_c - i_g), cf/wb v_C' = i_c - i_g - j cf v_C
    lg/wb i_g' = v - u - (rg + j lg) i_g       L, LC: v = u; LC: a branch rc, cf at the terminals
    de' = wb (kpp v^q + x), x' = kip v^q
    e^ = P(s) (kpc (i* - i_c^) + g + j krd i_c^ + kff v_f)        g' = kic (i* - i_c^)     P(s): Pade's all-pass
    v_f' = wff (v^ - v_f), or v_f = v^
    i_d* = Kp e_p + s_p, s_p' = Ki e_p, e_p = P* - p_m or v_dc - 1        i_q* = -(Kq e_q + s_q), e_q of Q or |v|
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .linear import Bases, J, Linear, in_si, jacobian, pade, pair, turned


@dataclass(frozen=True)
class Following:
    """Parameters in pu (gains per second where they integrate); ``filter`` is "L", "LC", "C" (LC, rc = 0) or "LCL"."""

    filter: str = "LCL"
    outer: str = "pq"  # or "dc", "pv", "current"
    lf: float = 0.16
    rf: float = 0.003
    cf: float = 0.046
    rc: float = 0.07
    lg: float = 0.06
    rg: float = 0.003
    kpc: float = 0.857
    kic: float = 1217.0
    krd: float = 0.16
    kff: float = 0.0
    wff: float = 5000.0  # inf: not filtered
    kpp: float = 0.18669
    kip: float = 70.283
    kp: float = 0.1
    ki: float = 20.0
    kq: float = 0.1
    kiq: float = 20.0
    wm: float = 2.0 * np.pi * 100.0
    c_dc_s: float = 0.066
    delay_s: float = 0.0
    p: float = 0.8
    q: float = 0.0
    v: float = 1.0


@dataclass(frozen=True)
class _Refs:
    """References that make the wanted operating point the equilibrium."""

    p_ref: float
    q_ref: float
    v_ref: float
    i_ref: np.ndarray
    p_source: float


def linear_following(g: Following, bases: Bases) -> Linear:
    """The exact linearisation, by the complex step, at the operating point of ``g``."""
    x, refs = _equilibrium(g)
    u = np.array([g.v, 0.0])

    def rhs(z: np.ndarray, w: np.ndarray) -> np.ndarray:
        return _rhs(z, w, g, refs, bases.w1)[0]

    rest = rhs(x + 0j, u + 0j).real
    if np.abs(rest).max() > 1e-7:
        raise AssertionError(f"the operating point is no equilibrium: {np.abs(rest).max():.1e}")
    c = jacobian(lambda z: _rhs(z, u, g, refs, bases.w1)[1], x)
    d = jacobian(lambda w: _rhs(x, w, g, refs, bases.w1)[1], u)
    e = g.cf / bases.w1 if g.filter == "C" else 0.0
    return in_si(jacobian(lambda z: rhs(z, u), x), jacobian(lambda w: rhs(x, w), u), c, d, e, bases)


class _Reader:
    """Takes a state vector apart, and collects derivatives in the same order."""

    def __init__(self, z: np.ndarray):
        self._z, self._at, self._out = z, 0, []

    def take(self, n: int = 2) -> np.ndarray:
        part = self._z[self._at : self._at + n]
        self._at += n
        return part

    def give(self, *derivatives: object) -> np.ndarray:
        return np.concatenate([np.atleast_1d(np.asarray(x)) for x in derivatives if x is not None])


def _rhs(z: np.ndarray, u: np.ndarray, g: Following, refs: _Refs, wb: float) -> tuple[np.ndarray, np.ndarray]:
    """(x', current into the device)."""
    read = _Reader(z)
    i_c = read.take()
    v_c = read.take() if g.filter in ("LC", "LCL") else None
    i_g = read.take() if g.filter == "LCL" else None
    angle, x_pll, gam = read.take(1)[0], read.take(1)[0], read.take()
    v_f = read.take() if np.isfinite(g.wff) else None
    p_m, q_m, s_p, s_q, v_dc = (read.take(1)[0] for _ in range(5))
    late = read.take(6) if g.delay_s > 0.0 else None

    v, out, d_filter = _filter(g, wb, i_c, v_c, i_g, u)
    v_hat, i_hat = turned(v, -angle), turned(i_c, -angle)
    e_p = v_dc - 1.0 if g.outer == "dc" else refs.p_ref - p_m
    e_q = refs.v_ref - np.sqrt(v @ v) if g.outer == "pv" else refs.q_ref - q_m
    if g.outer == "current":
        e_p, e_q = 0.0 * p_m, 0.0 * q_m
    i_ref = np.array([g.kp * e_p + s_p, -(g.kq * e_q + s_q)])
    asked = g.kpc * (i_ref - i_hat) + gam + g.krd * J @ i_hat + g.kff * (v_hat if v_f is None else v_f)
    e_hat, d_late = _delayed(g, asked, late)
    e = turned(e_hat, angle)
    power_out = out if g.filter != "LCL" else i_g
    return (
        read.give(
            wb / g.lf * (e - v - g.rf * i_c - g.lf * J @ i_c),
            *d_filter,
            wb * (g.kpp * v_hat[1] + x_pll),
            g.kip * v_hat[1],
            g.kic * (i_ref - i_hat),
            None if v_f is None else g.wff * (v_hat - v_f),
            g.wm * (v @ power_out - p_m),
            g.wm * (v[1] * power_out[0] - v[0] * power_out[1] - q_m),
            g.ki * e_p - (1e2 * (s_p - refs.i_ref[0]) if g.outer == "current" else 0.0),
            g.kiq * e_q - (1e2 * (s_q + refs.i_ref[1]) if g.outer == "current" else 0.0),
            (refs.p_source - e @ i_c) / (g.c_dc_s * v_dc) if g.outer == "dc" else 1e2 * (1.0 - v_dc),
            d_late,
        ),
        -out,
    )


def _filter(
    g: Following, wb: float, i_c: np.ndarray, v_c: np.ndarray | None, i_g: np.ndarray | None, u: np.ndarray
) -> tuple[np.ndarray, np.ndarray, tuple[np.ndarray, ...]]:
    """Voltage that is measured, current out of the terminals, derivatives of the filter's further states."""
    if g.filter == "L":
        return u, i_c, ()
    if g.filter == "C":  # the slope of u is the E of the state space
        return u, i_c - g.cf * J @ u, ()
    assert v_c is not None
    if g.filter == "LC":
        shunt = (u - v_c) / g.rc
        return u, i_c - shunt, (wb / g.cf * (shunt - g.cf * J @ v_c),)
    assert i_g is not None
    v = v_c + g.rc * (i_c - i_g)
    dv = wb / g.cf * (i_c - i_g - g.cf * J @ v_c)
    di = wb / g.lg * (v - u - g.rg * i_g - g.lg * J @ i_g)
    return v, i_g, (dv, di)


def _delayed(g: Following, asked: np.ndarray, late: np.ndarray | None) -> tuple[np.ndarray, np.ndarray | None]:
    if late is None:
        return asked, None
    a, b, c, d = pade(g.delay_s)
    x = late.reshape(2, 3)
    return x @ c + d * asked, (x @ a.T + np.outer(asked, b)).ravel()


def _equilibrium(g: Following) -> tuple[np.ndarray, _Refs]:
    """In closed form from (P, Q, |v|) at the terminals."""
    i_out = np.conj((g.p + 1j * g.q) / g.v)
    v, v_c, i_c = _branches(g, i_out)
    e = v + (g.rf + 1j * g.lf) * i_c
    angle = np.angle(v)
    v_hat, i_hat, e_hat = (x * np.exp(-1j * angle) for x in (v, i_c, e))
    gam = e_hat - 1j * g.krd * i_hat - g.kff * v_hat
    s = v * np.conj(i_out)
    refs = _Refs(s.real, s.imag, abs(v), pair(i_hat), (e * np.conj(i_c)).real)
    parts = [pair(i_c)]
    parts += [pair(v_c)] if g.filter in ("LC", "LCL") else []
    parts += [pair(i_out)] if g.filter == "LCL" else []
    parts += [np.array([angle, 0.0]), pair(gam)]
    parts += [pair(v_hat)] if np.isfinite(g.wff) else []
    parts += [np.array([s.real, s.imag, i_hat.real, -i_hat.imag, 1.0])]
    if g.delay_s > 0.0:
        a, b, _, _ = pade(g.delay_s)
        parts += [np.outer(pair(e_hat), -np.linalg.solve(a, b)).ravel()]
    return np.concatenate(parts), refs


def _branches(g: Following, i_out: complex) -> tuple[complex, complex, complex]:
    """v measured, v_C and i_C of the wanted current out of the terminals."""
    if g.filter == "L":
        return complex(g.v), 0j, i_out
    if g.filter == "C":
        return complex(g.v), 0j, i_out + 1j * g.cf * g.v
    if g.filter == "LC":
        v_c = g.v / (1.0 + 1j * g.cf * g.rc)
        return complex(g.v), v_c, i_out + 1j * g.cf * v_c
    v = g.v + (g.rg + 1j * g.lg) * i_out
    v_c = v / (1.0 + 1j * g.cf * g.rc)
    return v, v_c, i_out + 1j * g.cf * v_c


def draw_following(rng: np.random.Generator, bases: Bases) -> tuple[Linear, str, Following]:
    """A random one, stable or not on an ideal source, a line that says what it is, and its parameters."""

    def about(x: float, spread: float = 0.5) -> float:
        return float(x * np.exp(rng.uniform(-spread, spread)))

    kind = str(rng.choice(["L", "LC", "C", "LCL"], p=[0.35, 0.2, 0.1, 0.35]))
    pll_hz, zeta = float(np.exp(rng.uniform(np.log(5.0), np.log(60.0)))), rng.uniform(0.5, 1.0)
    w = 2.0 * np.pi * pll_hz
    lf, bandwidth = about(0.15), 2.0 * np.pi * about(250.0)
    delay_s = float(rng.choice([0.0, rng.uniform(20e-6, 150e-6)]))
    feed = float(rng.choice([0.0, 1.0, rng.uniform(0.3, 1.0)]))
    filtered = bool(rng.random() < 0.6)
    g = Following(
        filter=kind,
        outer=str(rng.choice(["pq", "dc", "pv", "current"])),
        lf=lf,
        rf=about(0.004),
        cf=about(0.05),
        rc=about(0.1),
        lg=about(0.07),
        rg=about(0.004),
        kpc=lf * bandwidth / bases.w1,
        kic=lf * bandwidth / bases.w1 * about(200.0, 1.0),
        krd=lf * float(rng.choice([0.0, 1.0])),
        kff=feed,
        wff=about(2000.0, 1.0) if filtered else np.inf,
        kpp=2.0 * zeta * w / bases.w1,
        kip=w**2 / bases.w1,
        kp=about(0.3, 1.0),
        ki=about(20.0, 1.0),
        kq=about(0.1, 1.0),
        kiq=about(10.0, 1.0),
        wm=2.0 * np.pi * about(60.0, 1.0),
        delay_s=delay_s,
        c_dc_s=about(0.06),
        p=rng.uniform(0.1, 1.0),
        q=rng.uniform(-0.3, 0.3),
        v=rng.uniform(0.9, 1.1),
    )
    if g.outer == "dc":
        g = replace(g, kp=about(1.5), ki=about(25.0, 0.8))
    feeding = "none" if feed == 0.0 else f"{feed:.2f} {'filtered' if filtered else 'direct'}"
    text = (
        f"{kind} filter, {g.outer} loops, PLL {pll_hz:.1f} Hz, feed-forward {feeding}, "
        f"delay {delay_s * 1e6:.0f} us, P {g.p:.2f}"
    )
    return linear_following(g, bases), text, g
