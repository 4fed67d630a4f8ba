"""The data type of the house: a 2x2 complex response, frequency first, frozen."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from ..plant.errors import SeqsweepError
from .read_only import ReadOnly

if TYPE_CHECKING:
    import pandas as pd

Frame = Literal["pn", "dq"]
STATUSES = ("ok", "not_settled", "nonlinear", "ill_conditioned", "noisy", "diverged", "failed")


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class FrequencyResponse:
    """2x2 admittance of one operating point; row = response, column = excitation.

    It cannot be changed, its arrays and its ``meta`` included; two responses are equal where they are one and the
    same object (compare ``y`` with `numpy.allclose`). ``response[mask]`` is the response of some of its rows.

    Attributes
    ----------
    f_hz : (n,) float
        Frequency of the first component, strictly increasing (Hz). In the dq frame it is the
        frequency seen from the rotating frame, f - f1, and may be negative.
    y : (n, 2, 2) complex
        Admittance in S, load direction; NaN where the point failed. In the pn frame the second
        component is the conjugate at the mirror 2 f1 - f (paper, eq. 1).
    f1_hz : float
        Fundamental frequency (Hz).
    frame : "pn" or "dq"
        Frame of ``y``.
    covariance : (n, 8, 8) float
        Covariance in S^2 over (re, im) of pp, pn, np, nn; NaN where unknown.
    status, reason : (n,) str
        One of `STATUSES`, and the reason where it is not "ok".
    quality : mapping of str to (n,) arrays
        The table's further columns: amplitude_pu, n_periods, window_s, cond_v, linearity, residual.
    meta : mapping
        At least ``op_id``; provenance as in the table's metadata.

    Raises
    ------
    SeqsweepError
        If shapes disagree, frequencies are not finite or do not increase, or frame or a status is unknown.
    """

    f_hz: np.ndarray
    y: np.ndarray
    f1_hz: float
    frame: Frame = "pn"
    covariance: np.ndarray | None = None
    status: np.ndarray | None = None
    reason: np.ndarray | None = None
    quality: Mapping[str, np.ndarray] = field(default_factory=dict)
    meta: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        f_hz = _locked(self.f_hz, float)
        n = len(f_hz)
        defaults = {
            "f_hz": f_hz,
            "y": _locked(self.y, complex),
            "covariance": _locked(np.full((n, 8, 8), np.nan) if self.covariance is None else self.covariance, float),
            "status": _locked(np.full(n, "ok") if self.status is None else self.status, str),
            "reason": _locked(np.full(n, "") if self.reason is None else self.reason, str),
            "quality": ReadOnly({name: _locked(column) for name, column in self.quality.items()}),
            "meta": self.meta if isinstance(self.meta, ReadOnly) else ReadOnly(self.meta),
        }
        for name, value in defaults.items():
            object.__setattr__(self, name, value)
        _check(self)

    def __len__(self) -> int:
        return len(self.f_hz)

    def __repr__(self) -> str:
        from .views.words import in_a_line

        return in_a_line(self)

    def _repr_html_(self) -> str:
        from .views.words import as_html

        return as_html(self)

    def __getitem__(self, rows: Any) -> FrequencyResponse:
        """The response of some rows, chosen as numpy does it: a mask, a slice, a list of row numbers, one number."""
        chosen = np.atleast_1d(np.arange(len(self))[rows])
        names = ("f_hz", "y", "covariance", "status", "reason")
        parts = {name: np.asarray(getattr(self, name))[chosen] for name in names}
        return replace(self, **parts, quality={name: column[chosen] for name, column in self.quality.items()})

    @property
    def ok(self) -> np.ndarray:
        """(n,) bool: rows with status "ok"."""
        return np.asarray(np.asarray(self.status) == "ok")

    @property
    def usable(self) -> np.ndarray:
        """(n,) bool: rows to learn from: finite, and "ok" or "noisy" with a covariance that says how noisy."""
        known = np.isfinite(np.asarray(self.covariance)).all(axis=(1, 2))
        noisy = (np.asarray(self.status) == "noisy") & known
        return np.asarray((self.ok | noisy) & np.isfinite(self.y).all(axis=(1, 2)))

    @property
    def why_lost(self) -> str:
        """What most of the rows that are not usable have against them, such as "diverged: the PLL lost the grid"."""
        lost = ~self.usable
        statuses, counts = np.unique(np.asarray(self.status)[lost], return_counts=True)
        if not len(statuses):
            return ""
        most = statuses[counts.argmax()]
        told = np.asarray(self.reason)[lost & (np.asarray(self.status) == most)]
        reason = next((str(text) for text in told if text), "")
        return f"{most}: {reason}" if reason else str(most)

    @property
    def f_mirror_hz(self) -> np.ndarray:
        """(n,) signed frequency 2 f1 - f of the second component (Hz); pn frame."""
        return 2.0 * self.f1_hz - self.f_hz

    @property
    def z(self) -> np.ndarray:
        """(n, 2, 2) impedance in ohm, the inverse of ``y``; NaN where that is not known or has no inverse."""
        known = np.isfinite(self.y).all(axis=(1, 2))
        known[known] = np.abs(np.linalg.det(self.y[known])) > 0.0
        z = np.full_like(self.y, complex(np.nan, np.nan))
        z[known] = np.linalg.inv(self.y[known])
        return z

    def to_frame(self, frame: Frame) -> FrequencyResponse:
        """The response in the frame "pn" or "dq": frequencies move by f1."""
        from .frames import to_frame

        return to_frame(self, frame)

    def interpolate(self, f_hz: float | np.ndarray) -> np.ndarray:
        """``y`` (2, 2) or (n, 2, 2) in S at other frequencies (Hz), by a rational model of the rows; pn frame."""
        from .fit.adaptive import interpolate

        y = interpolate(self, np.atleast_1d(np.asarray(f_hz, dtype=float)))
        return y[0] if np.ndim(f_hz) == 0 else y

    def to_dataframe(self) -> pd.DataFrame:
        """A pandas frame with the index ``f_hz``: complex elements, standard deviations, status and quality."""
        from .views.data_frame import data_frame

        return data_frame(self)

    def plot(self, ax: Any = None) -> Any:
        """Bode plot of the four elements in matplotlib axes (4, 2), which are returned.

        ``ax`` says where to draw: such axes, or a single one for the four magnitudes.
        """
        from .views.bode import shown

        return shown([self], ax)


def _locked(values: Any, dtype: type | None = None) -> np.ndarray:
    """Copy, then lock the copy: the caller's array stays the caller's."""
    array = np.array(values, dtype=dtype)
    array.setflags(write=False)
    return array


def _check(response: FrequencyResponse) -> None:
    n = len(response.f_hz)
    expected = {"f_hz": (n,), "y": (n, 2, 2), "covariance": (n, 8, 8), "status": (n,), "reason": (n,)}
    for name, shape in expected.items():
        given = getattr(response, name).shape
        if given != shape:
            raise SeqsweepError(f"{name} has shape {given}; {n} frequencies need {shape}")
    for name, column in response.quality.items():
        if column.shape != (n,):
            raise SeqsweepError(f"quality[{name!r}] has shape {column.shape}; {n} frequencies need {(n,)}")
    if response.frame not in get_args(Frame):
        raise SeqsweepError(f"frame is {response.frame!r}; known: {', '.join(map(repr, get_args(Frame)))}")
    if not np.all(np.isfinite(response.f_hz)):
        row = int(np.argmin(np.isfinite(response.f_hz)))
        raise SeqsweepError(f"f_hz of row {row} is {response.f_hz[row]:g}; needed: a finite number, in Hz")
    if np.any(np.diff(response.f_hz) <= 0):
        raise SeqsweepError("f_hz must increase strictly: sort it and remove duplicates")
    unknown = sorted(set(np.asarray(response.status).tolist()) - set(STATUSES))
    if unknown:
        raise SeqsweepError(f"unknown status {unknown[0]!r}; known: {', '.join(STATUSES)}")
