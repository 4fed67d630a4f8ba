"""The two inverters once more, written from the equations and sharing nothing with the product: the truth of the tests.

Real pairs (d, q) in a frame at w1, so that the complex-step derivative is exact; per unit; currents out of the device.
A multiplication by j is the matrix `J`; a view from a frame ahead by an angle is ``turn(angle).T``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import root

J = np.array([[0.0, -1.0], [1.0, 0.0]])
COMPLEX_STEP = 1e-30


class Model(NamedTuple):
    """x' = A x + B v_pcc, i_out = C x around a point; per unit, dq frame at w1, d on v_pcc."""

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    x: np.ndarray


def turn(angle: Any) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]])


def circuit(p: Any, i_c: Any, v_c: Any, i_g: Any, e: Any, v_pcc: Any) -> tuple[Any, ...]:
    """Derivatives of the LCL filter's currents and voltage."""
    w, v = p.w1_rad_s, node(p, i_c, v_c, i_g)
    return (
        w / p.l_f_pu * (e - v - p.r_f_pu * i_c) - w * J @ i_c,
        w / p.c_f_pu * (i_c - i_g) - w * J @ v_c,
        w / p.l_g_pu * (v - v_pcc - p.r_g_pu * i_g) - w * J @ i_g,
    )


def node(p: Any, i_c: Any, v_c: Any, i_g: Any) -> Any:
    return v_c + p.r_c_pu * (i_c - i_g)


def forming(p: Any, refs: tuple[float, float, float], x: np.ndarray, v_pcc: np.ndarray) -> np.ndarray:
    """Right-hand side of the virtual synchronous machine, 19 states."""
    i_c, v_c, i_g, xi, gamma, phi, vp = x[:14].reshape(7, 2)
    theta, w, q_m, eps, theta_p = x[14:]
    p_ref, q_ref, v_ref = refs
    v = node(p, i_c, v_c, i_g)
    power, reactive = v @ i_g, v[1] * i_g[0] - v[0] * i_g[1]
    ratio = vp[1] / vp[0]
    w_pll = 1.0 + p.k_ppll * ratio + p.k_ipll * eps
    v_dq, i_dq, g_dq = (turn(theta).T @ y for y in (v, i_c, i_g))
    emf = np.array([v_ref + p.k_q * (q_ref - q_m), 0.0 * w])
    dv = emf - p.r_v_pu * g_dq - w * p.l_v_pu * J @ g_dq - v_dq
    di = p.k_pv * dv + p.k_iv * xi + w * p.c_f_pu * J @ v_dq + p.k_ffi * g_dq - i_dq
    e = p.k_pc * di + p.k_ic * gamma + w * p.l_f_pu * J @ i_dq + p.k_ffv * v_dq - p.k_ad * (v_dq - phi)
    return np.concatenate(
        [
            *circuit(p, i_c, v_c, i_g, turn(theta) @ e, v_pcc),
            dv,
            di,
            p.w_ad_rad_s * (v_dq - phi),
            p.w_lp_rad_s * (turn(theta_p).T @ v - vp),
            [
                p.w1_rad_s * (w - 1.0),
                (p_ref - power - p.k_d * (w - w_pll) - p.k_w * (w - 1.0)) / p.t_a_s,
                p.w_f_rad_s * (reactive - q_m),
                ratio,
                p.w1_rad_s * (w_pll - 1.0),
            ],
        ]
    )


def following(p: Any, refs: tuple[float, float, float], x: np.ndarray, v_pcc: np.ndarray, dc: Any = None) -> np.ndarray:
    """Right-hand side of the grid-following inverter, 16 states, and v_dc where ``dc`` gives its power in."""
    i_c, v_c, i_g, gamma, v_f = x[:10].reshape(5, 2)
    delta, x_pll, s_p, s_q, p_m, q_m = x[10:16]
    v_dc = x[16] if dc else 1.0
    p_ref, q_ref, v_ref = refs
    v = node(p, i_c, v_c, i_g)
    v_dq, i_dq = turn(delta).T @ v, turn(delta).T @ i_c
    e_p = p.c_p * (p_ref - p_m) + p.c_dc * (v_dc - 1.0)
    e_q = p.c_q * (q_ref - q_m) + p.c_v * (v_ref - np.sqrt(v @ v))
    di = np.array([p.k_p * e_p + s_p, -p.k_q * e_q - s_q]) - i_dq
    e = turn(delta) @ (p.k_pc * di + gamma + p.k_rd * J @ i_dq + p.k_ff * v_f)
    reactive = v[1] * i_g[0] - v[0] * i_g[1]
    return np.concatenate(
        [
            *circuit(p, i_c, v_c, i_g, e, v_pcc),
            p.k_ic * di,
            p.w_ff_rad_s * (v_dq - v_f),
            [p.w1_rad_s * (p.k_ppll * v_dq[1] + x_pll), p.k_ipll * v_dq[1], p.k_i * e_p, p.k_iq * e_q],
            [p.w_m_rad_s * (v @ i_g - p_m), p.w_m_rad_s * (reactive - q_m)],
            [(dc(v_dc) - e @ i_c) / (v_dc * p.c_dc_s)] if dc else [],
        ]
    )


def rest(p: Any, kind: str, power: complex, voltage: float, dc: bool = False) -> tuple[np.ndarray, tuple[float, ...]]:
    """State and references at rest, found by a root finder from a rough guess (no closed form)."""
    i = np.array([power.real, -power.imag]) / voltage
    v_pcc = np.array([voltage, 0.0])
    v = v_pcc + (p.r_g_pu * np.eye(2) + p.l_g_pu * J) @ i
    refs = (float(v @ i), float(v[1] * i[0] - v[0] * i[1]), float(np.hypot(*v)))
    if kind == "forming":
        behind = v + (p.r_v_pu * np.eye(2) + p.l_v_pu * J) @ i
        refs = (*refs[:2], float(np.hypot(*behind)))
        theta = np.arctan2(behind[1], behind[0])
        guess = np.concatenate([i, v, i, [0, 0, 0.1, 0], turn(theta).T @ v, [refs[2], 0]])
        guess = np.concatenate([guess, [theta, 1.0, refs[1], 0.0, np.arctan2(v[1], v[0])]])
        f: Callable[..., Any] = forming
    else:
        delta = np.arctan2(v[1], v[0])
        i_dq = turn(delta).T @ i
        guess = np.concatenate([i, v, i, [1, 0], [refs[2], 0], [delta, 0, i_dq[0], -i_dq[1], refs[0], refs[1]]])
        f, p = following, p._replace(c_p=1.0, c_q=1.0)  # all errors vanish at rest: which of them drive is no matter
    found = root(lambda x: f(p, refs, x, v_pcc), guess, method="lm", options={"xtol": 1e-15, "ftol": 1e-15})
    residual = np.max(np.abs(f(p, refs, found.x, v_pcc)))
    assert residual < 1e-7, residual
    return np.append(found.x, 1.0) if dc else found.x, refs


def linearise(p: Any, kind: str, power: complex, voltage: float, dc_resistance: float | str | None = None) -> Model:
    """Exact linearisation by the complex step; ``dc_resistance`` None: constant v_dc, "power": constant power in."""
    x, refs = rest(p, kind, power, voltage, dc_resistance is not None)
    e_p = _bridge_power(p, x)
    laws = {None: None, "power": lambda v: e_p + 0.0 * v}
    dc = laws.get(dc_resistance, lambda v: v * (e_p - (v - 1.0) / dc_resistance))  # type: ignore[call-overload, operator]
    f = (lambda x, v: forming(p, refs, x, v)) if kind == "forming" else (lambda x, v: following(p, refs, x, v, dc))
    v0, n = np.array([voltage, 0.0]), len(x)
    full = np.concatenate([x, v0])
    columns = [f(y[:n], y[n:]).imag / COMPLEX_STEP for y in full + 1j * COMPLEX_STEP * np.eye(n + 2)]
    jacobian = np.array(columns).T
    c = np.zeros((2, n))
    c[0, 4] = c[1, 5] = 1.0
    return Model(jacobian[:, :n], jacobian[:, n:], c, x)


def _bridge_power(p: Any, x: np.ndarray) -> float:
    """Re(e conj i_c) at rest."""
    i_c, v_c, i_g = x[:6].reshape(3, 2)
    e = node(p, i_c, v_c, i_g) + (p.r_f_pu * np.eye(2) + p.l_f_pu * J) @ i_c
    return float(e @ i_c)


def admittance_dq(m: Model, nu_hz: np.ndarray) -> np.ndarray:
    """Y_dq (n, 2, 2), load direction, per unit."""
    s = 2j * np.pi * np.asarray(nu_hz, float)
    eye = np.eye(len(m.a))
    return np.array([-m.c @ np.linalg.solve(z * eye - m.a, m.b.astype(complex)) for z in s])


def admittance_pn(m: Model, f_hz: np.ndarray, f1_hz: float = 50.0) -> np.ndarray:
    """Sequence admittance (n, 2, 2) at f and its mirror, per unit."""
    t = np.array([[1.0, 1j], [1.0, -1j]])
    return t @ admittance_dq(m, np.asarray(f_hz, float) - f1_hz) @ np.linalg.inv(t)


def behind(p: Any, m: Model, z: complex, dynamic: bool = True) -> np.ndarray:
    """Closed-loop poles behind a line ``z`` (pu at f1): with its own dynamics, or algebraic.

    The line and l_g carry one current: v_pcc = v_s + (r + j x) i_g + x/w1 di_g/dt.
    """
    line = z.real * np.eye(2) + z.imag * J
    if not dynamic:
        return np.linalg.eigvals(m.a + m.b @ line @ m.c)
    # v_pcc enters di_g/dt alone, with -w1/l_g: x/w1 di_g/dt closes a loop that is solved for di_g/dt.
    share = np.eye(len(m.a)) - z.imag / p.w1_rad_s * m.b @ m.c
    return np.linalg.eigvals(np.linalg.solve(share, m.a + m.b @ line @ m.c))
