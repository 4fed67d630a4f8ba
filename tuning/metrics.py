"""What operators read from a scan: how power answers to angle, voltage and frequency, and how stiff a device is.

Everything follows from the 2x2 admittance and the operating point (P, Q, |v|). Per unit of the rating; P and Q out of
the device; the grid voltage is ``(V + dV) exp(j theta)``, the frame that of the fundamental, the frequency
nu = |f - f1| that of the perturbation as an observer in that frame sees it. docs/metrics.md derives every formula.

Errors are those of Y alone, carried through exactly where a quantity is linear in Y, else to first order.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi
from typing import NamedTuple

import numpy as np

from ..identify.frames import T_INVERSE, T
from ..identify.response import FrequencyResponse
from ..plant.errors import SeqsweepError
from .siso import Grid

SUB_TRANSIENT_HZ = (5.0, 25.0)
"""Band of nu over which stiffness is judged; it must end well below f1, where every inductance resonates."""

MISFIT_LIMIT = 0.1
"""A swing fit that is off by more is no swing; its numbers are withheld."""

FEWEST_ROWS = 4
"""Rows that a swing fit needs below the peak of the network frequency perturbation."""

REFERENCE_PU = 1j
"""Grid impedance behind which the stiffness of the terminal voltage is stated."""


class MetricsError(SeqsweepError):
    """A table that lacks what a metric needs, with the way out."""


class Point(NamedTuple):
    """An operating point per unit of the rating: power out of the device, and |v_pcc|."""

    p: float
    q: float
    v: float


@dataclass(frozen=True, slots=True)
class Response:
    """A complex quantity over nu with its errors.

    Attributes
    ----------
    value : (n,) complex
        The quantity.
    covariance : (n, 2, 2) float
        Of its real and imaginary part; NaN where that of Y is unknown.
    """

    value: np.ndarray
    covariance: np.ndarray

    @property
    def magnitude_std(self) -> np.ndarray:
        """Standard deviation (n,) of the modulus."""
        return self._std(np.stack([self.value.real, self.value.imag], axis=1))

    @property
    def phase_std_deg(self) -> np.ndarray:
        """Standard deviation (n,) of the phase (degrees)."""
        across = self._std(np.stack([-self.value.imag, self.value.real], axis=1))
        return np.degrees(across / np.abs(self.value))

    def _std(self, direction: np.ndarray) -> np.ndarray:
        unit = direction / np.linalg.norm(direction, axis=1, keepdims=True)
        return np.sqrt(np.einsum("ni,nij,nj->n", unit, self.covariance, unit))

    def times(self, factor: np.ndarray) -> Response:
        """The quantity times exact complex numbers (n,)."""
        turn = np.stack([np.stack([factor.real, -factor.imag], 1), np.stack([factor.imag, factor.real], 1)], 1)
        return Response(self.value * factor, turn @ self.covariance @ turn.transpose(0, 2, 1))


class Least(NamedTuple):
    """The least value of a quantity over a band, where it lies (Hz), and its standard deviation."""

    value: float
    at_hz: float
    std: float


@dataclass(frozen=True, slots=True)
class Swing:
    """The swing equation that answers as the device does: -1/G = s / (K w1) + 1 / (M s + D).

    Attributes
    ----------
    k, m_s, d : float
        Synchronising power (pu/rad), M = 2 H (s), damping D = 1 / droop (pu).
    std : (3,) float
        Their standard deviations.
    misfit : float
        Root mean square of the relative difference over the rows of the fit.
    band_hz : tuple of float
        Least and largest nu of those rows.
    n_rows : int
        Their number.
    w1_rad_s : float
        Fundamental angular frequency (rad/s).
    """

    k: float
    m_s: float
    d: float
    std: np.ndarray
    misfit: float
    band_hz: tuple[float, float]
    n_rows: int
    w1_rad_s: float

    @property
    def is_swing(self) -> bool:
        """Whether the numbers may be shown."""
        return self.misfit <= MISFIT_LIMIT


@dataclass(frozen=True, slots=True)
class Metrics:
    """Everything about one operating point.

    Attributes
    ----------
    op_id : str
        Operating point.
    point : Point
        Where it was measured; behind a grid that of the source.
    behind : str or None
        The grid whose source is looked from; None: the device's own terminals.
    nu_hz : (n,) float
        |f - f1| (Hz), ascending.
    p_theta, p_v, q_theta, q_v : Response
        dP/dtheta (pu/rad), dP/dV, dQ/dtheta, dQ/dV (pu).
    nfp : Response
        dP/df, power over grid frequency (pu/pu): the network frequency perturbation plot.
    swing : Swing or str
        The fit, or why there is none.
    p_stiffness, q_stiffness : Least or None
        Least |dP/dtheta| (pu/rad) and |dQ/dV| (pu/pu) of `SUB_TRANSIENT_HZ`; None without rows there.
    voltage_stiffness_db : Least or None
        Least -20 lg sigma_max((1 + Z_ref Y)^-1) there, with Z_ref = j1 pu.
    passivity : (n,) float
        Least eigenvalue of (Y + Y^H)/2 (pu).
    passivity_std : (n,) float
        Its standard deviation.
    passive_bands_hz : tuple of (float, float)
        Where it is not negative, between the rows.
    """

    op_id: str
    point: Point
    behind: str | None
    nu_hz: np.ndarray
    p_theta: Response
    p_v: Response
    q_theta: Response
    q_v: Response
    nfp: Response
    swing: Swing | str
    p_stiffness: Least | None
    q_stiffness: Least | None
    voltage_stiffness_db: Least | None
    passivity: np.ndarray
    passivity_std: np.ndarray
    passive_bands_hz: tuple[tuple[float, float], ...]

    def __repr__(self) -> str:
        from .metrics_report import format_report

        return format_report(self)

    def _repr_html_(self) -> str:
        from .metrics_report import as_html

        return as_html(self)


class _Rows(NamedTuple):
    """Usable rows by nu: Y_dq (n, 2, 2; pu), the covariance (n, 8, 8; pu) of Y_pn, and whether f < f1."""

    nu_hz: np.ndarray
    y_dq: np.ndarray
    covariance: np.ndarray
    below: np.ndarray


def metrics(response: FrequencyResponse, rating: tuple[float, float], grid: Grid | None = None) -> Metrics:
    """The metrics of one operating point.

    Parameters
    ----------
    response : FrequencyResponse
        In the pn frame; its meta holds the measured fundamental.
    rating : (float, float)
        Rated line-to-line RMS voltage (V) and apparent power (VA).
    grid : Grid, optional
        Look from the source behind this grid.

    Raises
    ------
    MetricsError
        If no row is usable, or the table does not say P, Q and |v|.
    """
    voltage_v, power_va = rating
    base_ohm = voltage_v**2 / power_va
    rows, point = _rows_of(response, base_ohm), _point_of(response, rating)
    seen, left, right = _behind(rows, grid, base_ohm)
    angle = 0.0
    if grid is not None:
        if grid.couples:
            raise MetricsError(
                f"{grid.label} is a device of its own: there is no source to look from; give a passive grid"
            )
        point, angle = _source_point(point, grid.at_f1 / base_ohm)
    turn = _rotation(-angle)
    seen, left, right = turn @ seen @ turn.T, turn @ left, right @ turn.T
    jacobian = [_linear(rows, seen, left, right, offset, weight) for offset, weight in _jacobian_terms(point)]
    s = 2j * pi * rows.nu_hz
    nfp = jacobian[0].times(2.0 * pi * response.f1_hz / s)
    least, least_std = _passivity(rows, seen, left, right)
    return Metrics(
        op_id=str(response.meta.get("op_id", "")),
        point=point,
        behind=None if grid is None else grid.label,
        nu_hz=rows.nu_hz,
        p_theta=jacobian[0],
        p_v=jacobian[1],
        q_theta=jacobian[2],
        q_v=jacobian[3],
        nfp=nfp,
        swing=fit_swing(rows.nu_hz, nfp, response.f1_hz),
        p_stiffness=_least_modulus(rows.nu_hz, jacobian[0]),
        q_stiffness=_least_modulus(rows.nu_hz, jacobian[3]),
        voltage_stiffness_db=_voltage_stiffness(rows, seen, left, right, response.f1_hz),
        passivity=least,
        passivity_std=least_std,
        passive_bands_hz=_bands(rows.nu_hz, least),
    )


def _jacobian_terms(point: Point) -> list[tuple[float, np.ndarray]]:
    """dP/dtheta, dP/dV, dQ/dtheta, dQ/dV as offset + sum of weight * Y_dq; see docs/metrics.md.

    dP/dtheta = -Q - V^2 Ydq    dP/dV = P/V - V Ydd    dQ/dtheta = P + V^2 Yqq    dQ/dV = Q/V + V Yqd
    """
    p, q, v = point
    dd, dq, qd, qq = np.eye(4).reshape(4, 2, 2)
    return [(-q, -(v**2) * dq), (p / v, -v * dd), (p, v**2 * qq), (q / v, v * qd)]


# Rows and operating point


def _rows_of(response: FrequencyResponse, base_ohm: float) -> _Rows:
    """Rows of both sides of f1: what lies below it is the conjugate of what lies above."""
    usable = response.usable
    if not np.any(usable):
        raise MetricsError(f"operating point {response.meta.get('op_id')!r} has no row to take metrics from")
    nu = response.f_hz[usable] - response.f1_hz
    y = T_INVERSE @ response.y[usable] @ T * base_ohm
    covariance = np.asarray(response.covariance)[usable] * base_ohm**2
    order = np.argsort(np.abs(nu), kind="stable")
    below = nu[order] < 0.0
    y_dq = np.where(below[:, None, None], y[order].conj(), y[order])
    return _Rows(np.abs(nu[order]), y_dq, covariance[order], below)


def _point_of(response: FrequencyResponse, rating: tuple[float, float]) -> Point:
    """The measured P, Q and |v| of an operating point (pu)."""
    found = response.meta.get("fundamental")
    if found is None:
        raise MetricsError(
            f"the table does not say at which P, Q and |v| {response.meta.get('op_id')!r} was measured: tables from "
            "version 1.1 on do; sweep or identify it again"
        )
    voltage_v, power_va = rating
    return Point(
        -found["active_power_into_device_w"] / power_va,
        -found["reactive_power_into_device_var"] / power_va,
        found["voltage_v"] / voltage_v,
    )


# Behind a grid


def _behind(rows: _Rows, grid: Grid | None, base_ohm: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Y seen through the grid, (Y^-1 + Z)^-1, and the factors L, R of its differential L dY R."""
    eye = np.broadcast_to(np.eye(2, dtype=complex), rows.y_dq.shape)
    if grid is None:
        return rows.y_dq, eye, eye
    z = grid.impedance_dq(2j * pi * rows.nu_hz) / base_ohm
    left = np.linalg.inv(eye + rows.y_dq @ z)
    return left @ rows.y_dq, left, np.linalg.inv(eye + z @ rows.y_dq)


def _source_point(point: Point, z: complex) -> tuple[Point, float]:
    """Operating point at the source behind ``z`` (pu), and the source's angle over v_pcc (rad)."""
    i_out = complex(point.p, -point.q) / point.v
    source = point.v - z * i_out
    power = source * i_out.conjugate()
    return Point(power.real, power.imag, abs(source)), float(np.angle(source))


def _rotation(angle: float) -> np.ndarray:
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


# Errors


def _linear(
    rows: _Rows, seen: np.ndarray, left: np.ndarray, right: np.ndarray, offset: float, weight: np.ndarray
) -> Response:
    """offset + sum_ij weight_ij Y_ij of the seen Y, with its covariance."""
    value = offset + np.einsum("ij,nij->n", weight, seen)
    slope = left.transpose(0, 2, 1) @ weight @ right.transpose(0, 2, 1)
    return Response(value, _carried(rows, slope))


def _carried(rows: _Rows, slope: np.ndarray) -> np.ndarray:
    """Covariance (n, 2, 2) of sum_ij slope_ij dYdq_ij, from that of Y_pn.

    Below f1 the row holds the conjugate of Y_dq: the slope is conjugated with it, and then the result.
    """
    own = np.where(rows.below[:, None, None], slope.conj(), slope)
    weights = (T_INVERSE.T @ own @ T.T).reshape(-1, 4)
    a = np.empty((len(weights), 2, 8))
    a[:, 0, 0::2], a[:, 0, 1::2] = weights.real, -weights.imag
    a[:, 1, 0::2], a[:, 1, 1::2] = weights.imag, weights.real
    a[rows.below, 1] *= -1.0
    return a @ rows.covariance @ a.transpose(0, 2, 1)


# Passivity and stiffness


def _passivity(rows: _Rows, seen: np.ndarray, left: np.ndarray, right: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least eigenvalue (n,) of the Hermitian part of Y, and its standard deviation: d lambda = Re(u^H dY u)."""
    values, vectors = np.linalg.eigh((seen + seen.conj().transpose(0, 2, 1)) / 2.0)
    u = vectors[:, :, 0]
    weight = u.conj()[:, :, None] * u[:, None, :]
    covariance = _carried(rows, left.transpose(0, 2, 1) @ weight @ right.transpose(0, 2, 1))
    return values[:, 0], np.sqrt(covariance[:, 0, 0])


def _bands(nu_hz: np.ndarray, values: np.ndarray) -> tuple[tuple[float, float], ...]:
    """Intervals of nu in which a quantity is not negative; borders by linear interpolation between rows."""
    bands: list[tuple[float, float]] = []
    start = nu_hz[0] if values[0] >= 0.0 else None
    for k in range(1, len(nu_hz)):
        if (values[k - 1] >= 0.0) == (values[k] >= 0.0):
            continue
        border = nu_hz[k - 1] + (nu_hz[k] - nu_hz[k - 1]) * values[k - 1] / (values[k - 1] - values[k])
        if start is None:
            start = border
        else:
            bands.append((float(start), float(border)))
            start = None
    return (*bands, (float(start), float(nu_hz[-1]))) if start is not None else tuple(bands)


def _least_modulus(nu_hz: np.ndarray, of: Response) -> Least | None:
    return _least(nu_hz, np.abs(of.value), of.magnitude_std)


def _least(nu_hz: np.ndarray, values: np.ndarray, std: np.ndarray) -> Least | None:
    """The least value over the sub-transient band."""
    low, high = SUB_TRANSIENT_HZ
    inside = np.flatnonzero((nu_hz >= low) & (nu_hz <= high))
    if not len(inside):
        return None
    k = inside[np.argmin(values[inside])]
    return Least(float(values[k]), float(nu_hz[k]), float(std[k]))


def _voltage_stiffness(
    rows: _Rows, seen: np.ndarray, left: np.ndarray, right: np.ndarray, f1_hz: float
) -> Least | None:
    """-20 lg of the largest singular value of S = (1 + Z_ref Y)^-1; d sigma = Re(u^H dS v), dS = -S Z_ref dY S.

    Z_ref is an inductance of j1 pu at f1, in the dq frame at nu.
    """
    reference = _reference(rows.nu_hz, f1_hz)
    sensitivity = np.linalg.inv(np.eye(2) + reference @ seen)
    u, sigma, vh = np.linalg.svd(sensitivity)
    before = -np.einsum("ni,nij,njk->nk", u[:, :, 0].conj(), sensitivity, reference)
    after = np.einsum("nij,nj->ni", sensitivity, vh[:, 0].conj())
    weight = before[:, :, None] * after[:, None, :]
    covariance = _carried(rows, left.transpose(0, 2, 1) @ weight @ right.transpose(0, 2, 1))
    per_sigma = 20.0 / np.log(10.0) / sigma[:, 0]
    return _least(rows.nu_hz, -20.0 * np.log10(sigma[:, 0]), per_sigma * np.sqrt(covariance[:, 0, 0]))


def _reference(nu_hz: np.ndarray, f1_hz: float) -> np.ndarray:
    """R + j X at f1 of `REFERENCE_PU` as an impedance (n, 2, 2) in the dq frame."""
    s = 1j * nu_hz / f1_hz
    x, r = REFERENCE_PU.imag, REFERENCE_PU.real
    z = np.empty((len(nu_hz), 2, 2), complex)
    z[:, 0, 0] = z[:, 1, 1] = r + s * x
    z[:, 0, 1], z[:, 1, 0] = -x, x
    return z


# The swing equation


def fit_swing(nu_hz: np.ndarray, nfp: Response, f1_hz: float) -> Swing | str:
    """Least squares of the relative difference from G over the rows up to its peak; a text where it cannot be."""
    from scipy.optimize import least_squares

    n = int(np.argmax(np.abs(nfp.value))) + 1
    if n < FEWEST_ROWS:
        return (
            f"{n} rows lie below the peak of |dP/df| at {nu_hz[n - 1]:.3g} Hz, and {FEWEST_ROWS} are needed: sweep "
            f"more frequencies within {nu_hz[n - 1]:.3g} Hz of f1"
        )
    s, g, w1 = 2j * pi * nu_hz[:n], nfp.value[:n], 2.0 * pi * f1_hz

    def differences(logs: np.ndarray) -> np.ndarray:
        relative = swing_response(s, np.exp(logs), w1) / g - 1.0
        return np.concatenate([relative.real, relative.imag]) / np.sqrt(n)

    starts = [np.log([k, m, max(abs(g[0]), 1e-3)]) for k, m in ((1.0, 0.3), (1.0, 5.0))]
    found = min((least_squares(differences, start) for start in starts), key=lambda fit: fit.cost)
    values = np.exp(found.x)
    k, m_s, d = (float(x) for x in values)
    return Swing(
        k=k,
        m_s=m_s,
        d=d,
        std=values * _swing_std(found.jac, nfp, n),
        misfit=float(np.sqrt(2.0 * found.cost)),
        band_hz=(float(nu_hz[0]), float(nu_hz[n - 1])),
        n_rows=n,
        w1_rad_s=w1,
    )


def swing_response(s: np.ndarray, k_m_d: Sequence[float] | np.ndarray, w1: float) -> np.ndarray:
    """G = -1 / (s / (K w1) + 1 / (M s + D))."""
    k, m, d = k_m_d
    return -1.0 / (s / (k * w1) + 1.0 / (m * s + d))


def _swing_std(jacobian: np.ndarray, nfp: Response, n: int) -> np.ndarray:
    """Standard deviations of the logarithms of K, M, D: the rows' errors through the normal equations."""
    relative = nfp.times(1.0 / nfp.value).covariance[:n] / n
    covariance = np.zeros((2 * n, 2 * n))
    at = np.arange(n)
    for a in (0, 1):
        for b in (0, 1):
            covariance[at + a * n, at + b * n] = relative[:, a, b]
    solve = np.linalg.pinv(jacobian)
    return np.sqrt(np.diag(solve @ covariance @ solve.T))
