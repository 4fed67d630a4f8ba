"""From a table of Z(f) to a rational z(s): a real function of one phase, stable, its order sought to the end.

An interpolation by straight lines between the rows gives wrong verdicts (of 100 near the edge 27, 12 and 3 from
tables of 25, 60 and 100 rows); a rational function does not, for that is what a network's impedance is. Fitted is z
and not its inverse, in the phase frame, where it has real coefficients and half the order it has in dq.

1. If the rows are without noise, an interpolant (AAA) tells the poles at once, whatever their number.
2. Else poles are added in pairs, each where the misfit is largest, and moved by vector fitting until they rest. The
   order with the lowest BIC is taken. The search goes on over plateaus: before the last resonance of a cable has its
   pair the misfit hardly falls.
3. A pole at s = 0, which a series capacitor has, is tried as a fixed one at every order.
4. Gauss-Newton on all parameters ends at the least squares and gives their covariance.

B. Gustavsen, A. Semlyen, "Rational approximation of frequency domain responses by vector fitting", 1999;
Y. Nakatsukasa, O. Sete, L. N. Trefethen, "The AAA algorithm for rational approximation", 2018.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ...identify.fit.partial_fractions import basis, counts_upper, order_of, upper_half
from .errors import GridError
from .rational import RationalGrid, gradient

MIN_ROWS = 8
"""Fewest rows a grid is made from."""

NOISE_FREE = 1e-8
"""Relative misfit below which rows are taken to be without noise."""

_EXACT = 1e-13  # misfit of rows without noise below which nothing counts
_ROUNDED = 5e-7  # the same for others, as a part of |z|: the last digits of a table are no resonances
_ASKED = 25.0  # square of the standard errors that a capacitor's pole has to show
_SPARE = 4  # rows beyond the parameters that make a small misfit mean something
_MOST_TERMS = 250  # of the interpolant of a closed form: 300 km of cable with all their resonances take 100
_IDLE = 1e-9  # part of |z| by which a closed form misses none of its real poles: they are rounding
_STAGES = (8, 14, 24, 40, 64, 90)  # degrees of the interpolant
_INTERPOLATED = 1e-9  # its error, relative to the largest value, that leaves no room for noise
_NOISY = 0.1  # below this part an error that no longer falls is noise
_MOST_POLES = 80
_PATIENCE = 3  # pairs without a gain in BIC after which a search that explains the rows ends
_MOVES = 6
_NARROWEST = 1e-4  # half width of a pole that noisy rows can tell, as a part of their distance
_LIGHT = 0.02  # damping ratio below which the sign of a residue counts
_CARRYING_ROWS = 4  # at so many rows a pole has to show


class _Rows(NamedTuple):
    """s (n,) rad/s, z (n,) ohm, weight (n,) 1/ohm, and the misfit below which a higher order is no better."""

    s: np.ndarray
    z: np.ndarray
    weight: np.ndarray
    floor: float


@dataclass(frozen=True, slots=True)
class _Trial:
    """Poles, real ones and upper halves, whether one at zero is added, coefficients and weighted misfit."""

    poles: np.ndarray
    at_zero: bool
    x: np.ndarray
    misfit: np.ndarray
    bic: float

    @property
    def rms(self) -> float:
        """Root mean square of the weighted misfit of a row."""
        return float(np.sqrt(2.0 * np.mean(self.misfit**2)))


def fit_impedance(
    f_hz: np.ndarray, z: np.ndarray, f1_hz: float, *, std: np.ndarray | None = None, name: str = ""
) -> RationalGrid:
    """Rational z(s) of a table.

    Parameters
    ----------
    f_hz : (n,) float
        Frequencies above zero, ascending (Hz).
    z : (n,) complex
        Impedance (ohm).
    f1_hz : float
        Fundamental (Hz).
    std : (n,) float or None
        Standard deviation of the complex z (ohm); None: all rows are known to the same part of |z|.
    name : str
        For messages.

    Raises
    ------
    GridError
        With fewer rows than `MIN_ROWS`.
    """
    if len(f_hz) < MIN_ROWS:
        raise GridError(f"{name or 'grid'}: {len(f_hz)} rows; a rational Z(f) needs at least {MIN_ROWS}")
    size = np.maximum(np.abs(z), 1e-9 * np.abs(z).max())
    rows = _Rows(2j * np.pi * f_hz, z, 1.0 / size if std is None else 1.0 / np.maximum(std, 1e-12 * size), _EXACT)
    trial = _interpolated(rows, size)
    if trial is None:
        rows = rows._replace(floor=_ROUNDED * float(np.median(rows.weight * size)))
        trial = _supported(rows, _pruned(rows, _settled(rows, _grown(rows, size))), size)
    trial = _settled(rows, _with_capacitor_if_told(rows, trial, size))
    return _finished(rows, trial, f1_hz, name, size, std is not None)


def fit_closed_form(f_hz: np.ndarray, z: np.ndarray, f1_hz: float) -> RationalGrid:
    """Rational z(s) of values without any error, as of a distributed line: an interpolant, whatever its degree.

    Parameters
    ----------
    f_hz : (n,) float
        Frequencies above zero, ascending (Hz), close enough to resolve every resonance.
    z : (n,) complex
        Impedance (ohm).
    f1_hz : float
        Fundamental (Hz).
    """
    size = np.abs(z)
    rows = _Rows(2j * np.pi * f_hz, z, 1.0 / size, _EXACT)
    poles, _ = _interpolant(rows, min(_MOST_TERMS, len(f_hz) - 2), _EXACT)
    free, at_zero = (_without_idle(rows, _kept(rows, size, poles, with_one)) for with_one in (False, True))
    trial = at_zero if at_zero.rms < 0.1 * free.rms else free  # a series capacitor's pole, where there is one
    return _finished(rows, trial, f1_hz, "", size, False)


# The linear part -----------------------------------------------------------------------------------------------------


def _columns(s: np.ndarray, poles: np.ndarray, at_zero: bool) -> np.ndarray:
    """(n, c) partial fractions, with 1/s first if asked for, then 1 and s."""
    columns = basis(s, poles, 2)
    return np.concatenate([1.0 / s[:, None], columns], axis=1) if at_zero else columns


def _solved(rows: _Rows, poles: np.ndarray, at_zero: bool) -> _Trial:
    """Coefficients of given poles by least squares."""
    a = _columns(rows.s, poles, at_zero) * rows.weight[:, None]
    right = rows.z * rows.weight
    a = np.concatenate([a.real, a.imag])
    b = np.concatenate([right.real, right.imag])
    norm = np.linalg.norm(a, axis=0)
    norm[norm == 0.0] = 1.0
    x = np.linalg.lstsq(a / norm, b, rcond=1e-14)[0] / norm
    misfit = b - a @ x
    n_data, n_parameters = len(b), len(x) + order_of(poles)
    cost = max(float(np.mean(misfit**2)), rows.floor**2)
    return _Trial(poles, at_zero, x, misfit, n_data * np.log(cost) + n_parameters * np.log(n_data))


def _moved(rows: _Rows, poles: np.ndarray, at_zero: bool, moves: int = _MOVES) -> _Trial:
    """Vector fitting: poles relocated until they rest; the best iterate counts."""
    best = _solved(rows, poles, at_zero)
    for _ in range(moves if len(poles) else 0):
        found = _relocated(rows, poles, at_zero)
        if found is None:
            break
        trial = _solved(rows, found, at_zero)
        gain, poles = best.rms - trial.rms, found
        best = min(best, trial, key=lambda t: t.rms)
        if gain < 1e-3 * best.rms or best.rms < rows.floor:
            break
    return best


def _relocated(rows: _Rows, poles: np.ndarray, at_zero: bool) -> np.ndarray | None:
    """Zeros of sigma(s) = d + sum c_k phi_k(s), those on the right mirrored to the left."""
    phi = _columns(rows.s, poles, at_zero)
    m = order_of(poles)
    sigma = np.concatenate([basis(rows.s, poles, 0), np.ones((len(rows.s), 1))], axis=1)
    block = np.concatenate([phi, -rows.z[:, None] * sigma], axis=1) * rows.weight[:, None]
    block = np.concatenate([block.real, block.imag])
    norm = np.linalg.norm(block, axis=0)
    norm[norm == 0.0] = 1.0
    upper = np.asarray(np.linalg.qr(block / norm, mode="r"))[phi.shape[1] :, phi.shape[1] :]
    scale = np.linalg.norm(rows.weight * rows.z) / len(rows.s)
    last = scale * sigma.real.sum(axis=0) / norm[phi.shape[1] :]
    a = np.concatenate([upper, last[None]])
    b = np.zeros(len(a))
    b[-1] = scale * len(rows.s)
    c = np.linalg.lstsq(a, b, rcond=None)[0] / norm[phi.shape[1] :]
    if not np.all(np.isfinite(c)) or abs(c[-1]) < 1e-12:
        return None
    state, into = _realisation(poles)
    return _stable(np.linalg.eigvals(state - np.outer(into, c[:m]) / c[-1]))


def _realisation(poles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Real (A, b) whose (sI - A)^-1 b are the basis functions."""
    n_real, n_pair = counts_upper(poles)
    pairs = poles[n_real:]
    a = np.diag(np.concatenate([poles.real, pairs.real]))
    i, j = n_real + np.arange(n_pair), n_real + n_pair + np.arange(n_pair)
    a[i, j], a[j, i] = pairs.imag, -pairs.imag
    return a, np.concatenate([np.ones(n_real), np.full(n_pair, 2.0), np.zeros(n_pair)])


def _stable(poles: np.ndarray) -> np.ndarray:
    """Real poles and upper halves in the left half-plane, a little off the axis where they stood on it."""
    real = -np.maximum(np.abs(poles.real), 1e-7 * np.abs(poles))
    return upper_half(real + 1j * poles.imag)


# The order -----------------------------------------------------------------------------------------------------------


def _interpolated(rows: _Rows, size: np.ndarray) -> _Trial | None:
    """The trial with the poles of an interpolant, if the rows are without noise and tell them with some to spare."""
    poles = _interpolating_poles(rows)
    if poles is None:
        return None
    best = min((_kept(rows, size, poles, at_zero) for at_zero in (False, True)), key=lambda t: t.bic)
    spare = 2 * len(rows.s) - 2 * order_of(best.poles) - 3
    part = float(np.sqrt(np.mean(_relative(rows, best, size) ** 2)))
    return best if part < NOISE_FREE and spare >= _SPARE else None


def _interpolating_poles(rows: _Rows) -> np.ndarray | None:
    """Poles (rad/s) of the interpolant that leaves nothing of the rows; None if none of a bearable degree does.

    In stages, because noise stops every one of them: where the error has come to rest low, it is noise.
    """
    for most in (k for k in _STAGES if k <= len(rows.s) - 2):
        poles, errors = _interpolant(rows, most, 1e-12)
        if errors[-1] < _INTERPOLATED:
            return poles
        if errors[-1] < _NOISY and errors[-1] > 0.2 * errors[most // 2]:
            return None
    return None


def _interpolant(rows: _Rows, most: int, tolerance: float) -> tuple[np.ndarray, np.ndarray]:
    """Poles (rad/s) of an interpolant of so many terms, and its error after each, as a part of the largest value."""
    from scipy.interpolate import AAA

    a = float(np.exp(np.mean(np.log(np.abs(rows.s)))))  # z grows with s; divided by s + a it does not
    values = rows.z / (rows.s + a)
    points, both = np.concatenate([rows.s, rows.s.conj()]) / a, np.concatenate([values, values.conj()])
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        found = AAA(points, both, rtol=tolerance, max_terms=most, clean_up=False)
        poles = found.poles() * a
    poles = poles[np.isfinite(poles) & (np.abs(poles + a) > 1e-6 * a)]
    return poles[np.abs(poles) < 1e3 * np.abs(rows.s).max()], found.errors / np.abs(values).max()


def _kept(rows: _Rows, size: np.ndarray, poles: np.ndarray, at_zero: bool) -> _Trial:
    """Poles that matter, moved to where they fit best."""
    if at_zero:
        poles = poles[np.abs(poles) > 1e-2 * np.abs(rows.s[0])]
    trial = _solved(rows, _stable(poles), at_zero)
    trial = _moved(rows, _significant(rows, trial, size), at_zero)
    return _moved(rows, _significant(rows, trial, size), at_zero)


def _without_idle(rows: _Rows, trial: _Trial) -> _Trial:
    """Without the real poles that nothing is lost with: two close ones cancel each other, or the pole at zero."""
    for pole in trial.poles[trial.poles.imag == 0.0]:
        tried = _solved(rows, trial.poles[trial.poles != pole], trial.at_zero)
        trial = tried if tried.rms < max(_IDLE, trial.rms) else trial
    return trial


def _with_capacitor_if_told(rows: _Rows, trial: _Trial, size: np.ndarray) -> _Trial:
    """The trial, without the pole at zero where it explains no more than last digits, or than noise may ask for.

    Far from zero it hardly shows, and on the axis it would make a mode that the grid has not.
    """
    if not trial.at_zero:
        return trial
    without = _solved(rows, trial.poles, False)  # the others where they are: a real one near zero would do instead
    lost = without.rms**2 - trial.rms**2
    asked = lost > _ASKED * max(trial.rms, rows.floor) ** 2 / len(trial.misfit)
    return trial if asked and without.rms > _ROUNDED * float(np.median(rows.weight * size)) else without


def _significant(rows: _Rows, trial: _Trial, size: np.ndarray) -> np.ndarray:
    """Poles whose term shows above the misfit at several rows: one that is glued to a single row fits its error."""
    if len(trial.poles) == 0:
        return trial.poles
    terms = np.abs(_terms(rows.s, trial)) / size[:, None]
    level = max(1e-11, float(np.sqrt(np.mean(_relative(rows, trial, size) ** 2))))
    return trial.poles[np.sort(terms, axis=0)[-_CARRYING_ROWS] > level]


def _terms(s: np.ndarray, trial: _Trial) -> np.ndarray:
    """(n, poles) what each pole, its conjugate included, contributes to z."""
    n_real, n_pair = counts_upper(trial.poles)
    columns = basis(s, trial.poles, 0)
    x = trial.x[1:] if trial.at_zero else trial.x
    up, low = slice(n_real, n_real + n_pair), slice(n_real + n_pair, n_real + 2 * n_pair)
    pairs = columns[:, up] * x[up] + columns[:, low] * x[low]
    return np.concatenate([columns[:, :n_real] * x[:n_real], pairs], axis=1)


def _relative(rows: _Rows, trial: _Trial, size: np.ndarray) -> np.ndarray:
    """(n,) |misfit| / |z|."""
    n = len(rows.s)
    return np.hypot(trial.misfit[:n], trial.misfit[n:]) / rows.weight / size


def _grown(rows: _Rows, size: np.ndarray) -> _Trial:
    """The order with the lowest BIC: pairs are added where the misfit is largest, over plateaus."""
    none = np.zeros(0, dtype=complex)
    chosen = []
    for at_zero in (False, True):
        trial = best = _solved(rows, none, at_zero)
        since = 0
        while order_of(trial.poles) + 2 <= min(_MOST_POLES, len(rows.s) - 3):
            trial = _moved(rows, _with_pair(rows, trial), at_zero, 4)
            since = 0 if trial.bic < best.bic else since + 1
            best = min(best, trial, key=lambda t: t.bic)
            if best.rms < rows.floor or (since >= _PATIENCE and _is_explained(best, rows, size)):
                break
        chosen.append(best)
    return min(chosen, key=lambda t: t.bic)


def _is_explained(trial: _Trial, rows: _Rows, size: np.ndarray) -> bool:
    """Whether the misfit looks like noise: a few percent, and no neighbours alike."""
    n = len(rows.s)
    misfit = trial.misfit[:n] + 1j * trial.misfit[n:]
    alike = np.abs(np.sum(misfit[1:] * misfit[:-1].conj())) / max(np.sum(np.abs(misfit) ** 2), 1e-300)
    return bool(alike < 0.5 and np.sqrt(np.mean(_relative(rows, trial, size) ** 2)) < 0.05)


def _with_pair(rows: _Rows, trial: _Trial) -> np.ndarray:
    """The trial's poles and a lightly damped pair at the row of the largest misfit, apart from the others."""
    n = len(rows.s)
    by_row = np.hypot(trial.misfit[:n], trial.misfit[n:])
    beta = abs(rows.s[int(np.argmax(by_row))])
    return upper_half(np.append(trial.poles, beta * (-0.02 + 1j)))


def _supported(rows: _Rows, trial: _Trial, size: np.ndarray) -> _Trial:
    """Without poles that fit the error of single rows, the others settled anew each time."""
    for _ in range(len(trial.poles)):
        told = _told(rows, trial)
        kept = _significant(rows, trial, size) if len(told) == len(trial.poles) else told
        if len(kept) == len(trial.poles):
            break
        trial = _settled(rows, _moved(rows, kept, trial.at_zero))
    return trial


def _told(rows: _Rows, trial: _Trial) -> np.ndarray:
    """Poles that noisy rows can tell: not much narrower than the rows' distance, and passive if lightly damped.

    A passive impedance has residues of positive real part at poles near the axis.
    """
    n_real, n_pair = counts_upper(trial.poles)
    x = trial.x[1:] if trial.at_zero else trial.x
    residue = x[n_real : n_real + n_pair]
    pairs, w = trial.poles[n_real:], np.abs(rows.s)
    above = np.clip(np.searchsorted(w, pairs.imag), 1, len(w) - 1)
    wide = np.abs(pairs.real) > _NARROWEST * (w[above] - w[above - 1])
    passive = (residue > 0.0) | (np.abs(pairs.real) > _LIGHT * np.abs(pairs))
    return np.concatenate([trial.poles[:n_real], pairs[wide & passive]])


def _pruned(rows: _Rows, trial: _Trial) -> _Trial:
    """Without the poles that the rows do not miss, the least missed first."""
    while len(trial.poles):
        tried = [_moved(rows, np.delete(trial.poles, k), trial.at_zero, 1) for k in range(len(trial.poles))]
        least = min(tried, key=lambda t: t.bic)
        if least.bic >= trial.bic:
            return trial
        trial = least
    return trial


# The end -------------------------------------------------------------------------------------------------------------


def _settled(rows: _Rows, trial: _Trial) -> _Trial:
    """Gauss-Newton on the poles, coefficients solved for at every step, shortened until the misfit falls."""
    for _ in range(8):
        grid = _grid_of(trial, 50.0)
        jacobian = _jacobian(rows, grid)
        m = order_of(trial.poles)
        if m == 0:
            return trial
        norm = np.linalg.norm(jacobian, axis=0)
        norm[norm == 0.0] = 1.0
        step = (np.linalg.lstsq(jacobian / norm, trial.misfit, rcond=1e-12)[0] / norm)[:m]
        better = _stepped(rows, trial, step)
        if better is None:
            return trial
        gain, trial = trial.rms - better.rms, better
        if gain < 1e-6 * trial.rms:
            return trial
    return trial


def _stepped(rows: _Rows, trial: _Trial, step: np.ndarray) -> _Trial | None:
    n_real, n_pair = counts_upper(trial.poles)
    change = np.concatenate([step[:n_real], step[n_real : n_real + n_pair] + 1j * step[n_real + n_pair :]])
    for part in (1.0, 0.3, 0.1):
        tried = _solved(rows, _stable(trial.poles + part * change), trial.at_zero)
        if tried.rms < trial.rms:
            return tried
    return None


def _jacobian(rows: _Rows, grid: RationalGrid) -> np.ndarray:
    """(2n, k) of the weighted z by the parameters of `gradient`."""
    slopes = gradient(grid, rows.s) * rows.weight[:, None]
    return np.concatenate([slopes.real, slopes.imag])


def _grid_of(trial: _Trial, f1_hz: float) -> RationalGrid:
    """Poles and residues of a trial, without errors."""
    n_real, n_pair = counts_upper(trial.poles)
    first, x = (trial.x[:1], trial.x[1:]) if trial.at_zero else (np.zeros(0), trial.x)
    pair = x[n_real : n_real + n_pair] + 1j * x[n_real + n_pair : n_real + 2 * n_pair]
    poles = [np.zeros(len(first), dtype=complex), trial.poles, trial.poles[n_real:].conj()]
    residues = [first.astype(complex), x[:n_real].astype(complex), pair, pair.conj()]
    poles[1] = np.concatenate([trial.poles[:n_real], trial.poles[n_real:]])
    d, e = x[n_real + 2 * n_pair :]
    none = np.zeros((0, 0))
    return RationalGrid(f1_hz, np.concatenate(poles), np.concatenate(residues), float(d), float(e), none, 0.0)


def _finished(rows: _Rows, trial: _Trial, f1_hz: float, name: str, size: np.ndarray, std_known: bool) -> RationalGrid:
    """The grid with its covariance, misfit and notes."""
    grid = _grid_of(trial, f1_hz)
    jacobian = _jacobian(rows, grid)
    spare = max(len(trial.misfit) - jacobian.shape[1], 1)
    variance = float(np.sum(trial.misfit**2)) / spare
    if std_known:  # half of a complex variance in the real part; a larger misfit speaks for larger errors
        variance = max(variance, 0.5)
    norm = np.linalg.norm(jacobian, axis=0)
    norm[norm == 0.0] = 1.0
    _, singular, vh = np.linalg.svd(jacobian / norm, full_matrices=False)
    root = vh.T / np.maximum(singular, 1e-13 * singular.max()) / norm[:, None] * np.sqrt(variance)
    misfit = float(np.sqrt(np.mean(_relative(rows, trial, size) ** 2)))
    return replace(
        grid,
        covariance_root=root,
        misfit=misfit,
        rows_hz=np.abs(rows.s) / (2.0 * np.pi),
        name=name,
    )
