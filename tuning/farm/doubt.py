"""Which measurement leaves a mode in doubt: the variance of its real part by table and row."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...identify.fit.rational import gradient, joint, row_shares, spread
from .participation import null_vectors, table_weights
from .system import System


@dataclass(frozen=True, slots=True)
class Doubt:
    """What the uncertainty of one mode's real part comes from.

    Attributes
    ----------
    std : float
        Standard error of the real part (1/s).
    by_table : mapping of str to float
        Part of the variance by table and operating point, adding up to one; the largest first. What several tables have
        in common counts for each by its own size.
    rows_hz : tuple of (float, float)
        Bands |f - f1| (Hz) of the heaviest rows of the first table, the heaviest first.
    by_order : float
        Part of the first table's variance that is doubt about the model's order, not noise of rows.
    """

    std: float
    by_table: dict[str, float]
    rows_hz: tuple[tuple[float, float], ...]
    by_order: float

    def said(self, f1_hz: float) -> str:
        """In one sentence: what to measure again, and where."""
        name, part = next(iter(self.by_table.items()))
        where = " and ".join(_band_text(f1_hz, low, high) for low, high in self.rows_hz)
        why = "" if self.by_order < 0.5 else ", with more rows: the doubt is about modes between them"
        return f"{100.0 * part:.0f} % of its variance comes from {name}: measure it again at {where}{why}"


def doubt_of(system: System, pole: complex) -> Doubt:
    """What the uncertainty of a mode comes from."""
    weights = table_weights(system, pole, null_vectors(system, pole))
    models = system.models
    errors = {key: spread(models[key], np.array([pole]), weight[None])[0] for key, weight in weights.items()}
    variance = {key: float(np.sum(error.real**2)) for key, error in errors.items()}
    total = max(sum(variance.values()), 1e-300)
    ranked = dict(sorted(((key, v / total) for key, v in variance.items()), key=lambda item: -item[1]))
    first = next(iter(ranked))
    by_order = float(errors[first][-1].real ** 2) / max(variance[first], 1e-300)
    slope = gradient(models[first], np.array([pole]), weights[first][None])[0].real
    together = joint([models[key] for key in errors], list(errors.values()))
    rows = _bands(models[first].nu_hz, row_shares(models[first], slope))
    return Doubt(float(np.linalg.norm(together.real)), ranked, rows, by_order)


def _bands(nu_hz: np.ndarray, share: np.ndarray) -> tuple[tuple[float, float], ...]:
    """Runs of neighbouring rows that carry most of it; two at most."""
    heavy = np.flatnonzero(share > 0.25 * share.max())
    runs = np.split(heavy, np.flatnonzero(np.diff(heavy) > 1) + 1)
    runs.sort(key=lambda run: -float(share[run].sum()))
    return tuple((float(nu_hz[run[0]]), float(nu_hz[run[-1]])) for run in runs[:2])


def _band_text(f1_hz: float, low: float, high: float) -> str:
    if high - low < 1e-9:
        return f"{f1_hz - low:.4g}/{f1_hz + low:.4g} Hz"
    return f"{f1_hz - high:.4g} to {f1_hz - low:.4g} and {f1_hz + low:.4g} to {f1_hz + high:.4g} Hz"
