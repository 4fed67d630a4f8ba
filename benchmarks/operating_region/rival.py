"""A library's method for the same sweeps: a Gaussian process of scikit-learn.

Of the libraries' methods for scattered points it is the one that states an error of its own, so that it can be held
to every bar: it certifies, it covers, it chooses the next sweep. It is given the surrogate's coordinates and
frequencies, a smooth kernel with a scale of its own for every axis, a noise that it finds itself, and at every
frequency the parameters of the largest likelihood.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from seqsweep.identify.fit.dq_data import to_dq
from seqsweep.identify.response import FrequencyResponse
from seqsweep.identify.surrogate.sparse_rational import ELEMENTS, Shape
from seqsweep.identify.surrogate.surrogate import Chosen, Region, Surrogate, build_surrogate

from .designs import Build, build_ours

_RADIUS = np.sqrt(15.51)  # 95 % quantile of chi-squared with eight degrees: four complex elements


@dataclass(frozen=True)
class Processes:
    """What stands in a surrogate for its model: a process for every frequency, of four elements relative to ||Y||.

    Attributes
    ----------
    regressors : tuple of sklearn.gaussian_process.GaussianProcessRegressor
        Of real and imaginary parts, at every frequency.
    middle : (f, 4) complex
        Mean over the sweeps (S).
    size : (f,) float
        Mean of ||Y|| (S).
    """

    regressors: tuple[Any, ...]
    middle: np.ndarray
    size: np.ndarray
    models: tuple[()] = ()

    @property
    def cautious(self) -> Processes:
        """Itself: a process has no products that it might lack."""
        return self

    def evaluate(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Y (p, f, 4) at points (p, d) of the unit box, and the radius of its 95 % region relative to the norm."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of variances that rounding made negative
            told = [regressor.predict(x, return_std=True) for regressor in self.regressors]
        mean, deviation = (np.stack(parts, axis=1) * self.size[:, None] for parts in zip(*told, strict=True))
        y = self.middle + mean[..., :ELEMENTS] + 1j * mean[..., ELEMENTS:]
        return y, _RADIUS * np.sqrt((deviation**2).mean(axis=2)) / np.linalg.norm(y, axis=2)


def build_rival(responses: Sequence[FrequencyResponse], region: Region) -> Surrogate:
    """A surrogate with Gaussian processes in place of its model, in the same coordinates."""
    constant = Shape(((0,) * int(region.varies.sum()),), ())
    frame = build_surrogate(responses, Chosen(None, ((constant,),)), region)
    y = np.stack([to_dq(response).y.reshape(-1, ELEMENTS) for response in responses], axis=1)  # (f, m, 4)
    middle, size = y.mean(axis=1), np.linalg.norm(y, axis=2).mean(axis=1)
    x, relative = frame.scale.unit(frame.points), (y - middle[:, None]) / size[:, None, None]
    regressors = tuple(_fitted(x, np.hstack([at.real, at.imag])) for at in relative)
    return replace(frame, pieces=(Processes(regressors, middle, size),))


BUILDS: dict[str, Build] = {"ours": build_ours, "rival": build_rival}
"""The two methods by name."""


def _fitted(x: np.ndarray, y: np.ndarray) -> Any:
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

    smooth = ConstantKernel(1.0, (1e-6, 1e6)) * RBF(np.ones(x.shape[1]), (0.1, 100.0))
    process = GaussianProcessRegressor(smooth + WhiteKernel(1e-8, (1e-14, 1e-1)), alpha=0.0, random_state=0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of parameters at their bounds
        return process.fit(x, y)
