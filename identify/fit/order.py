"""How many poles the data ask for, and which of them are spurious (the rules of `fit`)."""

from __future__ import annotations

import numpy as np

from .dq_data import ELEMENTS
from .least_squares import (
    Problem,
    Trial,
    costs_without,
    floor_cost,
    pole_std,
    refine,
    solve_residues,
    trial_at,
    trial_of,
)
from .partial_fractions import basis, order_of, separated, upper_half
from .rational import RationalModel
from .vector_fit import vector_fit

_FAR = 1.5  # a pole is outside the band beyond this multiple of the highest angular frequency
_FEW = 60  # rows
_UNPLACED = 0.5  # standard error of a far pole, in its size, from which on its place is not known
_NEARBY = 5.0  # where a real pole that replaces a far pair is started, in bands
_FAINT = 1e-4  # what a right-half-plane pole must contribute to Y to be believed
_ROUNDING = 1e-4  # part of the noise floor below which only exact rows are met
_MODEST = 0.75  # parameters of a fit that is believed to rounding, in numbers of the rows
_OUTLIERS_PER_ROW = 10  # at most one row in ten may be left out as an outlier


NARROWEST = 0.005
"""Damping ratio of the narrowest mode of its own that a device which came to rest is reckoned to have."""

LASTING = 0.5
"""Decay (1/s) of the slowest one that runs of some seconds are sure to see at rest."""

SLOWEST = 0.05
"""Decay (1/s) of the slowest one at all: what decays more slowly takes a minute to come to rest."""


def select_order(problem: Problem, max_order: int, start: RationalModel | None) -> Trial:
    """Grow by a pair where the misfit is largest until two pairs in a row do not pay; four where rows are few.

    The misfit of few rows may stay where it is until every mode between them has its pair.
    """
    poles = _first_poles(problem) if start is None else upper_half(start.poles)
    tail = 1 if start is None else start.tail
    best = trial = vector_fit(problem, poles, tail)
    misses, patience = 0, _patience(problem)
    while misses < patience and order_of(trial.poles) + 2 <= max_order and trial.cost > floor_cost(problem):
        trial = vector_fit(problem, with_pair(problem, trial), tail)
        misses = 0 if trial.bic < best.bic else misses + 1
        best = min(best, trial, key=lambda t: t.bic)
    return best


def _patience(problem: Problem) -> int:
    """Pairs in a row that need not pay."""
    return 2 if len(problem.s) >= _FEW else 4


def ended(problem: Problem, trial: Trial, max_order: int) -> bool:
    """Whether `select_order`, whose best trial it was, went to the highest order."""
    return order_of(trial.poles) + 2 * _patience(problem) > max_order


def _first_poles(problem: Problem) -> np.ndarray:
    """Three weakly damped pairs over the band and a real pole beyond its end."""
    low, high = np.log10(max(abs(problem.s[0]), 1e-3 * abs(problem.s[-1]))), np.log10(abs(problem.s[-1]))
    beta = np.logspace(low, high, 5)[1:4]
    return np.concatenate([[-3.0 * abs(problem.s[-1]) + 0j], beta * (-0.1 + 1j)])


def with_pair(problem: Problem, trial: Trial) -> np.ndarray:
    """The trial's poles and a weakly damped pair at the frequency of the largest misfit."""
    misfit = np.abs(solve_residues(problem, trial.poles, trial.tail).misfit)
    n = len(problem.s)
    by_line = np.sum(misfit[:, :n] ** 2 + misfit[:, n:] ** 2, axis=0)
    beta = abs(problem.s[int(np.argmax(by_line))])
    return np.append(trial.poles, beta * (-0.1 + 1j))


# What is spurious ----------------------------------------------------------------------------------------------------


def drop_outliers(problem: Problem, trial: Trial) -> tuple[Problem, Trial, tuple[str, ...]]:
    """Leave out rows that ask for a pole of their own, narrower than the distance of the rows, and that pole.

    Poles that no row asks for go first; only fits to as many rows have a BIC to compare.
    """
    notes: tuple[str, ...] = ()
    if trial.cost < floor_cost(problem):
        return problem, trial, notes
    for _ in range(len(problem.s) // _OUTLIERS_PER_ROW):
        tried = [_without_pole(problem, trial, k) for k in narrow_poles(problem, trial.poles)]
        found = [less for less in tried if less is not None]
        if not found:
            break
        kept, trial = min(found, key=lambda less: (-len(less[0].s), less[1].bic))
        if len(kept.s) < len(problem.s):
            notes += (outlier_note(left_out_hz(problem.s, kept.s)),)
        problem = kept
    return problem, trial, notes


def outlier_note(nu_hz: float) -> str:
    """What is said of the row at |f - f1| = ``nu_hz`` that was left out."""
    return f"the row at |f - f1| = {nu_hz:.4g} Hz does not agree with its neighbours and was left out of the fit"


def left_out_hz(s: np.ndarray, kept: np.ndarray) -> float:
    """|f - f1| (Hz) of the one row of ``s`` (n,) that ``kept`` (n - 1,) lacks; others may have the same frequency."""
    first = int(np.argmin(np.append(s[:-1] == kept, False)))
    return float(s.imag[first] / (2.0 * np.pi))


def narrow_poles(problem: Problem, poles: np.ndarray) -> np.ndarray:
    """Indices of pairs inside the band whose width is below the distance of the rows around them."""
    w = problem.s.imag
    above = np.clip(np.searchsorted(w, poles.imag), 1, len(w) - 1)
    inside = (poles.imag >= w[0]) & (poles.imag <= w[-1])
    return np.flatnonzero(inside & (np.abs(poles.real) < w[above] - w[above - 1]))


def without_rows(problem: Problem, rows: np.ndarray) -> Problem:
    """The problem with some rows left out."""
    return problem._replace(
        s=np.delete(problem.s, rows),
        y=np.delete(problem.y, rows, axis=1),
        weight=np.delete(problem.weight, rows, axis=1),
        noise=None if problem.noise is None else np.delete(problem.noise, rows, axis=0),
    )


def _without_pole(problem: Problem, trial: Trial, k: int) -> tuple[Problem, Trial] | None:
    """The fit without pole k: to the rows but the one next to it, if that alone asks for the pole and stands apart.

    To all of them where they do not pay for the pole: no row asks for it then. None where the others miss it.
    """
    row = int(np.argmin(np.abs(problem.s.imag - trial.poles[k].imag)))
    rest, fewer = without_rows(problem, np.array([row])), np.delete(trial.poles, k)
    with_pole = trial_at(rest, trial.poles, trial.tail)
    without = refine(rest, trial_at(rest, fewer, trial.tail))
    if without.bic >= with_pole.bic or without.bic >= refine(rest, with_pole).bic:
        return None
    to_all = refine(problem, trial_at(problem, fewer, trial.tail))
    if to_all.bic <= trial.bic:
        return problem, to_all
    coefficients = solve_residues(rest, without.poles, without.tail).coefficients
    expected = coefficients @ basis(problem.s[row : row + 1], without.poles, without.tail)[0]
    apart = np.linalg.norm(problem.y[:, row] - expected) > _FAINT * np.linalg.norm(problem.y[:, row])
    return (rest, without) if apart else None


def prune(problem: Problem, trial: Trial) -> Trial:
    """Take away, one by one, what the data do not pay for: a pole or pair, a tail term, a far pole for a slope."""
    while True:
        reduced = _reductions(problem, trial)
        if not reduced:
            return trial
        candidate = refine(problem, min(reduced, key=lambda t: t.bic))
        if candidate.bic >= trial.bic:
            return trial
        trial = candidate


def _reductions(problem: Problem, trial: Trial) -> list[Trial]:
    n, tail, costs = len(trial.poles), trial.tail, costs_without(problem, trial)
    found = [trial_of(problem, np.delete(trial.poles, k), tail, float(costs[k])) for k in range(n)]
    if tail > 0 and n > 0:
        found.append(trial_of(problem, trial.poles, tail - 1, float(costs[-1])))
    far = np.flatnonzero(_is_far(problem, trial.poles) & (tail == 1))
    return found + [trial_at(problem, np.delete(trial.poles, k), 2) for k in far]


def thin_out_far(problem: Problem, trial: Trial) -> Trial:
    """Pairs outside the band whose place is not known give way to one real pole each where the BIC does not suffer.

    Far away the data know a few terms of a power series, and several poles share them: their places, and with them the
    errors of everything else, are then a matter of rounding.
    """
    far = np.flatnonzero(_is_far(problem, trial.poles) & (trial.poles.imag > 0.0))
    if len(far):
        far = far[pole_std(problem, trial)[far] > _UNPLACED * np.abs(trial.poles[far])]
    for pole in trial.poles[far]:
        k = int(np.argmin(np.abs(trial.poles - pole)))
        single = -min(abs(pole), _NEARBY * abs(problem.s[-1])) + 0j
        thinner = refine(problem, trial_at(problem, np.append(single, np.delete(trial.poles, k)), trial.tail))
        trial = min(trial, thinner, key=lambda t: t.bic)
    return trial


def drop_faint(problem: Problem, trial: Trial) -> tuple[Trial, tuple[str, ...]]:
    """Remove, one by one, poles of no certain half-plane that Y does not need to 1e-4.

    Errors of the sweep ask for such poles. One by one: a true instability must not keep spurious ones beside it. Rows
    that the fit meets to rounding have no such errors.
    """
    exact = met_exactly(problem, trial)
    if exact is not None:
        return exact, ()
    n_before, needed = order_of(trial.poles), np.zeros(0, dtype=complex)
    while True:
        doubtful = _doubtful(problem, trial, needed)
        if len(doubtful) == 0:
            break
        faintest = doubtful[np.argmin(costs_without(problem, trial)[doubtful])]
        without = trial_at(problem, np.delete(trial.poles, faintest), trial.tail)
        without = refine(problem, without, n_iterations=30)
        if relative_misfit(problem, without) > _FAINT:
            needed = np.append(needed, trial.poles[faintest])
        else:
            trial = without
    n_left_out = n_before - order_of(trial.poles)
    if n_left_out == 0:
        return trial, ()
    misfit = relative_misfit(problem, trial)
    return trial, (f"{n_left_out} faint poles of no certain sign left out of the fit: it matches Y to {misfit:.1g}",)


def met_exactly(problem: Problem, trial: Trial) -> Trial | None:
    """The trial continued to rounding, where it meets the rows so.

    Errors of a sweep may be smooth enough for a fit to meet them to its floor; to rounding none does.
    """
    if trial.cost > floor_cost(problem) or not _is_modest(problem, trial):
        return None
    exact = refine(to_rounding(problem), trial)
    return trial_at(problem, exact.poles, exact.tail) if is_exact(problem, exact) else None


def is_exact(problem: Problem, trial: Trial) -> bool:
    """Whether the trial meets the rows to rounding with three quarters as many parameters as they have numbers.

    The quarter that is left, two numbers for each row, is met by no chance.
    """
    return trial.cost < floor_cost(to_rounding(problem)) and _is_modest(problem, trial)


def _is_modest(problem: Problem, trial: Trial) -> bool:
    return order_of(trial.poles) + ELEMENTS * (order_of(trial.poles) + trial.tail) <= _MODEST * 2 * problem.y.size


def to_rounding(problem: Problem) -> Problem:
    """The problem with a floor that only exact rows are met to."""
    return problem._replace(floor=_ROUNDING * problem.floor)


def _doubtful(problem: Problem, trial: Trial, needed: np.ndarray) -> np.ndarray:
    """Indices of poles in the right half-plane or within two standard errors of it, but for those known as needed."""
    uncertain = trial.poles.real > -2.0 * pole_std(problem, trial)
    known = np.any(np.abs(trial.poles[:, None] - needed) < 1e-2 * np.abs(trial.poles[:, None]), axis=1)
    return np.flatnonzero(uncertain & ~known)


def settle_instability(problem: Problem, trial: Trial) -> Trial:
    """As many poles in the right half-plane as experiment proved: of those beyond, the least missed one is given up.

    Given up means mirrored or removed, whichever has the lower BIC.
    """
    while problem.n_unstable is not None and unstable_count(trial.poles) > problem.n_unstable:
        options = []
        for k in np.flatnonzero(trial.poles.real > 0.0):
            mirrored = trial.poles.copy()
            mirrored[k] = -mirrored[k].conjugate()
            options += [trial_at(problem, poles, trial.tail) for poles in (mirrored, np.delete(trial.poles, k))]
        before = unstable_count(trial.poles)
        refined = [refine(problem, t, n_iterations=30) for t in options]
        fewer = [t for t in refined if unstable_count(t.poles) < before]
        trial = min(fewer or options, key=lambda t: t.bic)
    return trial


def unstable_count(poles: np.ndarray) -> int:
    """Poles in the right half-plane, conjugates counted, from the real ones and the upper halves."""
    unstable = poles[poles.real > 0.0]
    return int(len(unstable) + np.sum(unstable.imag > 0.0))


def settle_lasting(problem: Problem, trial: Trial) -> Trial:
    """Poles held at the axis, of a device that came to rest, are put where such a device has them if that fits as well.

    Rows that do not tell how narrow a pole is leave it anywhere, also where it would ring for minutes: a loop that
    moves it by less than that would seem to be unstable.
    """
    if problem.n_unstable != 0:
        return trial
    for pole in trial.poles[-trial.poles.real < np.maximum(NARROWEST * np.abs(trial.poles.imag), SLOWEST)]:
        for decay in (LASTING, SLOWEST):
            poles = trial.poles.copy()
            poles[np.argmin(np.abs(poles - pole))] = -max(NARROWEST * abs(pole.imag), decay) + 1j * pole.imag
            damped = trial_at(problem, separated(poles), trial.tail)
            if damped.bic <= trial.bic + np.log(2 * problem.y.size):
                trial = damped
                break
    return trial


def relative_misfit(problem: Problem, trial: Trial) -> float:
    """Root mean square misfit relative to ||Y||_F / 2 at each frequency, whatever the weights."""
    n = len(problem.s)
    misfit = solve_residues(problem, trial.poles, trial.tail).misfit
    absolute = (misfit[:, :n] ** 2 + misfit[:, n:] ** 2) / problem.weight**2
    size = np.sum(np.abs(problem.y) ** 2, axis=0) / ELEMENTS
    return float(np.sqrt(np.mean(absolute / size) / 2.0))


def settle_far_poles(problem: Problem, trial: Trial) -> tuple[Trial, tuple[str, ...]]:
    """Mirror right-half-plane poles outside the band, or trade them for a slope, where the fit does not suffer."""
    notes = []
    for pole in trial.poles[_is_far(problem, trial.poles) & (trial.poles.real > 0.0)]:
        k = int(np.argmin(np.abs(trial.poles - pole)))
        mirrored = trial.poles.copy()
        mirrored[k] = -pole.conjugate()
        options = [refine(problem, trial_at(problem, mirrored, trial.tail))]
        options.append(refine(problem, trial_at(problem, np.delete(trial.poles, k), 2)))
        settled = [t for t in options if not np.any(_is_far(problem, t.poles) & (t.poles.real > 0.0))]
        best = min(settled, key=lambda t: t.bic, default=trial)
        if best is not trial and best.bic <= trial.bic + np.log(2 * problem.y.size):
            trial = best
            notes.append(
                f"a pole fitted at {pole.real:+.3g} rad/s, outside the swept band, was taken as stable: "
                "the data fit the stable one as well"
            )
    return trial, tuple(notes)


def _is_far(problem: Problem, poles: np.ndarray) -> np.ndarray:
    """(m,) bool: outside the swept band."""
    return np.abs(poles) > _FAR * abs(problem.s[-1])
