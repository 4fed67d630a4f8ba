"""A grid as a rational function z(s) of the phase frame, fitted to a table of Z(f), with its errors."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..network.descriptor import Descriptor
from .coverage import around, is_between
from .promise import OnePort
from .words import in_ohm


@dataclass(frozen=True, slots=True)
class RationalGrid(OnePort):
    """z(s) = sum_k r_k/(s - p_k) + d + s e, real coefficients, stable poles; a series capacitor's pole is at zero.

    Attributes
    ----------
    f1_hz : float
        Fundamental frequency (Hz).
    poles : (m,) complex
        rad/s, phase frame: real ones first (zero among them for a series capacitor), then the upper halves of the
        pairs, then their conjugates.
    residues : (m,) complex
        ohm rad/s, same order.
    d, e : float
        Constant (ohm) and slope (H).
    covariance_root : (k, j) float
        F with F F^T the covariance of the real parameters in the order of `gradient`; no columns: known exactly.
    misfit : float
        Root mean square of the fit's relative error at the rows.
    rows_hz : (r,) float or None
        Frequencies of the rows (Hz); None where the function stands for a closed form.
    name : str
        For people.
    notes : tuple of str
        What the reader should know: passivity, misfit, rows left out.
    scale : float
        By what the impedance is multiplied.
    """

    f1_hz: float
    poles: np.ndarray
    residues: np.ndarray
    d: float
    e: float
    covariance_root: np.ndarray
    misfit: float
    rows_hz: np.ndarray | None = None
    name: str = ""
    notes: tuple[str, ...] = ()
    scale: float = 1.0

    @property
    def label(self) -> str:
        """Name, order and z at the fundamental."""
        z = self.at_f1
        scale = "" if self.scale == 1.0 else f" times {self.scale:.4g}"
        rows = "" if self.rows_hz is None else f"table of {len(self.rows_hz)} rows{scale}, "
        return f"{self.name + ': ' if self.name else ''}{rows}{in_ohm(z)} ohm at {self.f1_hz:g} Hz"

    def impedance(self, s: np.ndarray) -> np.ndarray:
        """z in ohm; infinite at a pole."""
        s = np.asarray(s, dtype=complex)
        with np.errstate(divide="ignore", invalid="ignore"):
            return self.scale * ((1.0 / (s[:, None] - self.poles)) @ self.residues + self.d + s * self.e)

    def slope(self, s: np.ndarray) -> np.ndarray:
        """dz/ds in ohm s."""
        s = np.asarray(s, dtype=complex)
        with np.errstate(divide="ignore", invalid="ignore"):
            return self.scale * ((-1.0 / (s[:, None] - self.poles) ** 2) @ self.residues + self.e)

    @property
    def phase_modes(self) -> np.ndarray:
        """The poles."""
        return self.poles

    def phase_descriptor(self) -> Descriptor:
        """States of the partial fractions, the port's current and its voltage: e i' = -v - d i - C x."""
        n_real, n_pair = counts(self.poles)
        m = n_real + 2 * n_pair
        a, b, c = np.zeros((m, m)), np.zeros(m), np.zeros(m)
        a[:n_real, :n_real], b[:n_real] = np.diag(self.poles[:n_real].real), 1.0
        c[:n_real] = self.residues[:n_real].real
        for k in range(n_pair):
            at, pole, residue = n_real + 2 * k, self.poles[n_real + k], self.residues[n_real + k]
            a[at : at + 2, at : at + 2] = [[pole.real, pole.imag], [-pole.imag, pole.real]]
            b[at], c[at], c[at + 1] = 2.0, residue.real, residue.imag
        i, v = m, m + 1
        e_all, a_all = np.zeros((m + 2, m + 2)), np.zeros((m + 2, m + 2))
        e_all[:m, :m], a_all[:m, :m], a_all[:m, i] = np.eye(m), a, b
        e_all[i, i], a_all[i, i], a_all[i, v], a_all[i, :m] = (
            self.scale * self.e,
            -self.scale * self.d,
            -1.0,
            -self.scale * c,
        )
        a_all[v, i] = -1.0
        port = np.zeros(m + 2)
        port[v] = 1.0
        return Descriptor(e_all, a_all, port[:, None], port[None])

    def spread_dq(self, s: np.ndarray, weight: np.ndarray) -> np.ndarray:
        """Effect of the fit's errors on sum_ij weight_ij Zdq_ij: z1 and z2 move with the same parameters."""
        s, w1 = self._beside(s), self.w1_rad_s
        both = (weight[:, 0, 0] + weight[:, 1, 1]) / 2.0
        across = (weight[:, 1, 0] - weight[:, 0, 1]) / 2j
        slopes = (both + across)[:, None] * gradient(self, s + 1j * w1)
        slopes += (both - across)[:, None] * gradient(self, s - 1j * w1)
        return np.asarray(self.scale * slopes @ self.covariance_root)

    def missing_rows(self, nu_hz: float, width_hz: float) -> tuple[float, float] | None:
        """The first of f1 + nu and |f1 - nu| that no rows hold on both sides."""
        if self.rows_hz is None:
            return None
        for f_hz in (self.f1_hz + nu_hz, abs(self.f1_hz - nu_hz)):
            if not is_between(self.rows_hz, f_hz, width_hz):
                return around(f_hz, width_hz)
        return None

    def scaled(self, scale: float) -> RationalGrid:
        """The impedance multiplied."""
        return replace(self, scale=self.scale * scale)

    def described(self) -> dict[str, Any]:
        """z at the fundamental, order, band and misfit."""
        z = self.at_f1
        rows = self.rows_hz if self.rows_hz is not None else np.zeros(0)
        return {
            "kind": "table",
            "name": self.name,
            "r_ohm": z.real,
            "x_ohm": z.imag,
            "f1_hz": self.f1_hz,
            "scale": self.scale,
            "order": len(self.poles),
            "misfit": self.misfit,
            "rows": len(rows),
            "f_min_hz": float(rows[0]) if len(rows) else None,
            "f_max_hz": float(rows[-1]) if len(rows) else None,
            "notes": list(self.notes),
        }


def counts(poles: np.ndarray) -> tuple[int, int]:
    """Numbers of real poles and of pairs."""
    n_real = int(np.sum(poles.imag == 0.0))
    return n_real, (len(poles) - n_real) // 2


def gradient(grid: RationalGrid, s: np.ndarray) -> np.ndarray:
    """Derivative of the unscaled z(s) by its real parameters: (n, k) complex.

    In this order: real poles but one at zero, which is known; Re and Im of the pairs; then the coefficients: residues
    of the real poles, Re and Im of the pairs' residues, d, e.
    """
    n_real, n_pair = counts(grid.poles)
    moving = grid.poles[:n_real] != 0.0
    with np.errstate(divide="ignore", invalid="ignore"):
        by = 1.0 / (s[:, None] - grid.poles)
        slopes = grid.residues * by**2
    up, low = slice(n_real, n_real + n_pair), slice(n_real + n_pair, None)
    poles = [slopes[:, :n_real][:, moving], slopes[:, up] + slopes[:, low], 1j * (slopes[:, up] - slopes[:, low])]
    residues = [by[:, :n_real], by[:, up] + by[:, low], 1j * (by[:, up] - by[:, low])]
    return np.concatenate([*poles, *residues, np.ones((len(s), 1)), s[:, None]], axis=1)
