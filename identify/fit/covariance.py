"""The finished model: what noise, cuts and a missed mode may have done to it, and what is worth a note."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..uncertainty import NORMAL_95
from .dq_data import ELEMENTS
from .least_squares import (
    Linear,
    Problem,
    Trial,
    block_diagonal,
    datum_variance,
    inverse_r,
    projected_jacobian,
    shows_noise,
    solve_residues,
)
from .omitted import beside_the_model, with_cut
from .partial_fractions import counts_upper, parts
from .rational import RationalModel
from .residue_ranks import Cut, cut_ranks, truncated, uncut

_ALIKE = 40  # neighbouring rows taken to have the same noise, relative to Y, where the table does not tell
_RUNS_APART = 10.0  # by so many times their distance two poles may err apart from each other
_VISIBLE = 1e-3  # a doubt that does not show in the digits that are printed is not printed
_REPEATED = 1e-8  # singular value of unit rows that read what was cut, below which one of them repeats the others
_LIGHT = 0.05  # damping ratio below which a doubtful sign of a pole is worth a note


def finished(
    problem: Problem,
    f1_hz: float,
    trial: Trial,
    notes: tuple[str, ...],
    remarks: tuple[str, ...] = (),
    whole_ranks: bool = False,
) -> RationalModel:
    """The model with the poles of ``trial``; with ``whole_ranks`` as it is, neither cut nor its order in doubt."""
    linear = solve_residues(problem, trial.poles, trial.tail)
    cut = uncut(trial, linear) if whole_ranks else cut_ranks(problem, trial, linear)
    n_real, n_pair = counts_upper(trial.poles)
    residues, d, e = parts(n_real, n_pair, trial.tail, cut.coefficients)
    m = n_real + 2 * n_pair
    response, directions = _response(problem, trial, linear._replace(coefficients=cut.coefficients))
    response = _held_singular(response, cut)
    root = response @ _noise_root(problem, linear, directions)
    std = np.linalg.norm(root[:m], axis=1)
    pair_std = std[n_real : n_real + n_pair] + 1j * std[n_real + n_pair :]
    model = RationalModel(
        f1_hz=f1_hz,
        poles=np.concatenate([trial.poles, trial.poles[n_real:].conj()]),
        residues=truncated(residues, cut.ranks),
        d=d,
        e=e,
        tail=trial.tail,
        ranks=cut.ranks,
        bic=trial.bic,
        residual=float(np.sqrt(linear.cost / linear.misfit.size)),
        noise_floor=problem.noise_floor,
        weighting=problem.weighting,
        nu_hz=problem.s.imag / (2.0 * np.pi),
        weight=problem.weight.T,
        covariance_root=root,
        omitted=None,
        rival=None,
        pole_std=np.concatenate([std[:n_real].astype(complex), pair_std, pair_std]),
        notes=notes,
        remarks=remarks,
    )
    if shows_noise(problem, trial) and not whole_ranks:
        beside = beside_the_model(problem, trial, linear, cut.ranks, response, directions)
        model = replace(model, omitted=with_cut(beside, linear.coefficients - cut.coefficients))
    return _with_sign_notes(model)


def _with_sign_notes(model: RationalModel) -> RationalModel:
    """Note every pole in the right half-plane, and every lightly damped one whose half-plane the data leave open."""
    noted, remarked = [], []
    for pole, std in zip(model.poles, model.pole_std, strict=True):
        doubt = NORMAL_95 * std.real
        interval = f" +- {doubt:.2g}" if doubt > _VISIBLE * abs(pole.real) else ""
        text = f"{pole.real:+.3g}{interval} rad/s, {abs(pole.imag) / (2.0 * np.pi):.3g} Hz (dq)"
        unswept = abs(pole) < 2.0 * np.pi * model.nu_hz[0]
        is_open = abs(pole.real) < min(2.0 * std.real, _LIGHT * abs(pole)) or (pole.real > 0.0 and unswept)
        if pole.imag >= 0.0 and is_open:
            remarked.append(f"the half-plane of the device's own pole at {text} is not decided by the data")
        elif pole.imag >= 0.0 and pole.real > 0.0:
            noted.append(f"the device is unstable on an ideal source: it has a pole of its own at {text}")
    return replace(model, notes=(*model.notes, *noted), remarks=(*model.remarks, *remarked))


# The covariance ------------------------------------------------------------------------------------------------------


def _response(problem: Problem, trial: Trial, linear: Linear) -> tuple[np.ndarray, np.ndarray]:
    """What noise does to poles and coefficients (k, k), and the orthonormal directions of it that do (4, 2n, k).

    Weights need not be those of the noise, and noise is correlated between elements: the error is R^-1 Q^T noise, and
    its covariance R^-1 (Q^T cov Q) R^-T.
    """
    jacobian, inside = projected_jacobian(problem, trial, linear)
    m, c = jacobian.shape[1], linear.r.shape[1]
    poles, u = _held_inverse(problem, trial, linear, jacobian)
    r_inverse = inverse_r(linear)
    root = np.zeros((m + ELEMENTS * c,) * 2)
    root[:m, :m] = poles
    root[m:, :m] = -(r_inverse @ (inside @ poles)).reshape(ELEMENTS * c, m)
    root[m:, m:] = block_diagonal(r_inverse)
    directions = np.concatenate([u.reshape(*linear.misfit.shape, m), _block_columns(linear.q)], axis=2)
    return root, directions


def _held_singular(response: np.ndarray, cut: Cut) -> np.ndarray:
    """The response (k, k) to noise of a fit whose poles and residues move together so that what was cut stays zero."""
    read = cut.rows @ response[response.shape[0] - cut.rows.shape[1] :]
    size = np.linalg.norm(read, axis=1)
    _, singular, along = np.linalg.svd(read / np.where(size > 0.0, size, 1.0)[:, None], full_matrices=False)
    along = along[singular > _REPEATED]
    return response - (response @ along.T) @ along


def _held_inverse(
    problem: Problem, trial: Trial, linear: Linear, jacobian: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """`inverted`, but no pole errs by more than it is away from zero, or ten times from its nearest neighbour.

    Two poles that nearly coincide leave a direction in which both may run apart without moving Y. The linear errors
    of that direction are without bounds and cancel in Y as long as nothing rounds them, which cutting ranks does. A
    prior of that width for each pole leaves every direction as it is that the data know better.
    """
    n_real, _ = counts_upper(trial.poles)
    everyone = np.concatenate([trial.poles, trial.poles[n_real:].conj()])
    gap = np.abs(trial.poles[:, None] - everyone)
    gap[np.arange(len(gap)), np.arange(len(gap))] = np.inf
    reach = np.minimum(np.abs(trial.poles), _RUNS_APART * gap.min(axis=1, initial=np.inf))
    reach = np.concatenate([reach, reach[n_real:]]) / np.sqrt(datum_variance(problem, trial, linear))
    u, singular, vh = np.linalg.svd(jacobian * reach, full_matrices=False)
    return reach[:, None] * vh.T * (singular / (singular**2 + 1.0)), u


def _noise_root(problem: Problem, linear: Linear, directions: np.ndarray) -> np.ndarray:
    """Root (k, k) of the covariance of the noise along orthonormal ``directions`` (4, 2n, k)."""
    n, k = len(problem.s), directions.shape[2]
    by_row = directions.reshape(ELEMENTS, 2, n, k).transpose(2, 0, 1, 3).reshape(n, 2 * ELEMENTS, k)
    if problem.noise is None:
        noise = _noise_of_misfit(linear, by_row)
    else:
        noise = _noise_of_table(problem.noise, linear, by_row)
    spread = np.tensordot(by_row, noise @ by_row, axes=([0, 1], [0, 1]))
    variance, axes = np.linalg.eigh(spread)
    root = axes * np.sqrt(np.maximum(variance, (1e-3 * problem.floor) ** 2))
    return np.asarray(root @ axes.T)  # unique: the eigenvectors of even noise are anyone's


def _noise_of_table(noise: np.ndarray, linear: Linear, by_row: np.ndarray) -> np.ndarray:
    """(n, 8, 8): the table's covariances, scaled so that they explain the misfit."""
    left = np.einsum("nii->", noise) - np.sum(by_row * (noise @ by_row))
    return noise * (linear.cost / left)


def _noise_of_misfit(linear: Linear, by_row: np.ndarray) -> np.ndarray:
    """(n, 8, 8): the misfit's own covariance, averaged over neighbouring rows; what the fit took is given back."""
    n = len(by_row)
    taken = np.minimum(np.sum(by_row**2, axis=2), 0.9)
    misfit = linear.misfit.reshape(ELEMENTS, 2, n).transpose(2, 0, 1).reshape(n, -1) / np.sqrt(1.0 - taken)
    total = np.concatenate([np.zeros((1, 8, 8)), np.cumsum(misfit[:, :, None] * misfit[:, None, :], axis=0)])
    half = min(_ALIKE, n) // 2
    first = np.clip(np.arange(n) - half, 0, n - 2 * half)
    return (total[first + 2 * half] - total[first]) / (2 * half)


def _block_columns(blocks: np.ndarray) -> np.ndarray:
    """(4, n, c) to (4, n, 4 c): block e in columns of its own."""
    e, n, c = blocks.shape
    full = np.zeros((e, n, e, c))
    full[np.arange(e), :, np.arange(e), :] = blocks
    return full.reshape(e, n, e * c)
