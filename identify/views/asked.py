"""A response as it is asked for: impedance in place of admittance, dq in place of pn, values at any frequency.

Impedance and dq are linear in a small change of Y, so that covariances go with them. Between the rows values come from
the rational model of the rows; how far it may be off is measured by leaving out the rows on either side and predicting
them.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np

from ...plant.errors import SeqsweepError
from ..fit.adaptive import MIN_ROWS, interpolate
from ..frames import T_INVERSE, T, pn_to_dq
from ..response import FrequencyResponse
from ..uncertainty import NORMAL_95

SAME = 1e-6
"""Frequencies closer than this, relatively, are one."""

Axes = Literal["log", "db", "linear"]


class Look(NamedTuple):
    """How a response is shown.

    Attributes
    ----------
    impedance : bool
        Z in ohm in place of Y in S.
    dq : bool
        The dq frame at |f - f1| in place of pn at f.
    axes : "log", "db" or "linear"
        Of magnitudes; linear is of frequencies, too.
    """

    impedance: bool = False
    dq: bool = False
    axes: Axes = "log"

    @property
    def symbol(self) -> str:
        return "Z" if self.impedance else "Y"

    @property
    def unit(self) -> str:
        return "ohm" if self.impedance else "S"

    @property
    def elements(self) -> tuple[str, str, str, str]:
        """Indices of the four elements."""
        return ("dd", "dq", "qd", "qq") if self.dq else ("pp", "pn", "np", "nn")


def as_asked(response: FrequencyResponse, look: Look) -> FrequencyResponse:
    """The response as ``look`` asks, its covariance carried along.

    Parameters
    ----------
    response : FrequencyResponse
        pn frame.
    look : Look
        In dq, rows below f1 become the conjugate at |f - f1|: a matrix in dq at -nu is the conjugate of that at nu.

    Raises
    ------
    SeqsweepError
        If the response is not in the pn frame.
    """
    if response.frame != "pn":
        raise SeqsweepError(f"needed is a response in the pn frame, given is one in {response.frame!r}")
    meta = dict(response.meta)
    if look.impedance or look.dq:
        meta.pop("interpolation", None)  # what was certified is Ypn
    asked = replace(response, meta=meta)
    if look.impedance:
        asked = _as_impedance(asked)
    return _as_dq(asked) if look.dq else asked


def _as_impedance(response: FrequencyResponse) -> FrequencyResponse:
    """Z = Y^-1; dZ = -Z dY Z."""
    z = response.z
    carried = -np.einsum("nij,nkl->nikjl", z, np.swapaxes(z, 1, 2)).reshape(-1, 4, 4)
    return replace(response, y=z, covariance=_carried(response.covariance, carried))


def _as_dq(response: FrequencyResponse) -> FrequencyResponse:
    """T^-1 Y T at f - f1, folded to positive frequencies; of two rows at one |f - f1| the one above f1 stays."""
    nu = response.f_hz - response.f1_hz
    y = pn_to_dq(response.y)
    covariance = _carried(response.covariance, np.broadcast_to(np.kron(T_INVERSE, T.T), (len(nu), 4, 4)))
    below = nu < 0.0
    y = np.where(below[:, None, None], np.conj(y), y)
    turned = np.where(below[:, None], np.tile([1.0, -1.0], 4), 1.0)
    covariance = turned[:, :, None] * covariance * turned[:, None, :]
    order = np.lexsort((below, np.round(np.abs(nu), 9)))
    first = np.append(True, np.diff(np.abs(nu)[order]) > SAME * np.abs(nu)[order][1:])
    rows = order[first & (np.abs(nu)[order] > 0.0)]
    return replace(
        response,
        f_hz=np.abs(nu)[rows],
        y=y[rows],
        covariance=covariance[rows],
        frame="dq",
        status=np.asarray(response.status)[rows],
        reason=np.asarray(response.reason)[rows],
        quality={name: column[rows] for name, column in response.quality.items()},
    )


def _carried(covariance: np.ndarray | None, linear: np.ndarray) -> np.ndarray:
    """Covariance (n, 8, 8) over (re, im) of four elements after a complex linear map (n, 4, 4) of them."""
    real = np.empty((len(linear), 4, 2, 4, 2))
    real[:, :, 0, :, 0] = real[:, :, 1, :, 1] = linear.real
    real[:, :, 1, :, 0], real[:, :, 0, :, 1] = linear.imag, -linear.imag
    turned = real.reshape(-1, 8, 8)
    return np.asarray(turned @ np.asarray(covariance) @ np.swapaxes(turned, 1, 2))


class Value(NamedTuple):
    """The 2x2 at one frequency.

    Attributes
    ----------
    f_hz : float
        Frequency of the first component (Hz).
    y : (2, 2) complex
        In the unit of the look.
    half_95 : (2, 2) float
        Half the 95 % interval of each element, the error of the interpolation included; NaN where it is not known.
    between_hz : (float, float) or None
        The rows on either side; None where the table has the row itself.
    error : float
        Error of the interpolation, relative to the norm; 0 at a row.
    """

    f_hz: float
    y: np.ndarray
    half_95: np.ndarray
    between_hz: tuple[float, float] | None
    error: float


def value_at(response: FrequencyResponse, f_hz: float, look: Look = Look()) -> Value:  # noqa: B008 (a tuple)
    """The 2x2 at a frequency, a row of the table or interpolated between rows with its error.

    Raises
    ------
    SeqsweepError
        If the frequency lies outside of the usable rows, or nearer to f1 than all of them, or there are too few of them
        to interpolate.
    """
    usable = response[response.usable]
    apart = np.abs(usable.f_hz - f_hz)
    if len(usable) and apart.min() <= SAME * abs(f_hz):
        return _value(usable[int(apart.argmin())], look, None, 0.0)
    outside = len(usable) < MIN_ROWS or not usable.f_hz[0] <= f_hz <= usable.f_hz[-1]
    if outside or abs(f_hz - usable.f1_hz) < _nearest_to_f1_hz(usable):
        raise SeqsweepError(_refusal(response, usable, f_hz))
    right = int(np.searchsorted(usable.f_hz, f_hz))
    around = [right - 1, right]
    error = max(_left_out(usable, row) for row in around)
    y = interpolate(usable, np.array([f_hz]))
    covariance = np.asarray(usable.covariance)[around].max(axis=0)
    covariance = covariance + (error * np.linalg.norm(y)) ** 2 / 8.0 * np.eye(8)
    between = replace(usable[around[0]], f_hz=np.array([f_hz]), y=y, covariance=covariance[None])
    return _value(between, look, (float(usable.f_hz[around[0]]), float(usable.f_hz[around[1]])), error)


def _nearest_to_f1_hz(response: FrequencyResponse) -> float:
    """Smallest |f - f1| of the rows (Hz): seen from dq the lowest frequency, below which they tell nothing."""
    return float(np.min(np.abs(response.f_hz - response.f1_hz)))


def _left_out(response: FrequencyResponse, row: int) -> float:
    """How far a row is missed, relatively, by the model of all others; at an end of the table by that of all."""
    others = np.arange(len(response)) != row
    inside = 0 < row < len(response) - 1 and others.sum() >= MIN_ROWS
    found = interpolate(response[others] if inside else response, response.f_hz[[row]])[0]
    return float(np.linalg.norm(found - response.y[row]) / np.linalg.norm(response.y[row]))


def _value(row: FrequencyResponse, look: Look, between: tuple[float, float] | None, error: float) -> Value:
    shown = as_asked(row, look)
    if not len(shown):
        raise SeqsweepError("at f1 itself dq has no value: its frequency there is zero")
    variances = np.diagonal(np.asarray(shown.covariance)[0]).reshape(4, 2).sum(axis=1) / 2.0
    half = NORMAL_95 * np.sqrt(variances).reshape(2, 2)
    return Value(float(row.f_hz[0]), shown.y[0], half, between, error)


def _refusal(response: FrequencyResponse, usable: FrequencyResponse, f_hz: float) -> str:
    name = response.meta.get("op_id", "the table")
    if len(usable) < MIN_ROWS:
        return f"{name}: {f_hz:g} Hz is no row, and {len(usable)} usable rows are too few to interpolate ({MIN_ROWS})"
    if usable.f_hz[0] <= f_hz <= usable.f_hz[-1]:
        nearest = _nearest_to_f1_hz(usable)
        return (
            f"{name}: {f_hz:g} Hz is nearer to f1 than every usable row ({nearest:.4g} Hz away); slow modes that the "
            "rows do not show may turn Y there: sweep points closer to f1"
        )
    return (
        f"{name}: {f_hz:g} Hz lies outside of its usable rows, {usable.f_hz[0]:g} to {usable.f_hz[-1]:g} Hz; nothing "
        "is extrapolated"
    )
