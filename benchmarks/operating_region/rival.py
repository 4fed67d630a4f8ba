"""A library's method for the same sweeps: a Gaussian process of scikit-learn.

Of the libraries' methods for scattered points it is the one that states an error of its own, so that it can be held
to every bar: it certifies, it covers, it chooses the next sweep. It is given the surrogate's coordinates and
frequencies, a smooth kernel with a scale of its own for every axis, a noise that it finds itself, and the parameters of
the largest likelihood.
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

_RADIUS = np.sqrt(15.51)  # 95 % quantile of chi-squared with eight degrees: four complex elements


@dataclass(frozen=True)
class Process:
    """What stands in a surrogate for its model.

    Attributes
    ----------
    regressor : sklearn.gaussian_process.GaussianProcessRegressor
        Of real and imaginary parts of all elements at all frequencies.
    """

    regressor: Any
    models: tuple[()] = ()

    def evaluate(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Y (p, f, 4) at points (p, d) of the unit box, and the radius of its 95 % region relative to the norm."""
        mean, deviation = self.regressor.predict(x, return_std=True)
        parts, widths = (values.reshape(len(x), 2, -1, ELEMENTS) for values in (mean, deviation))
        y = parts[:, 0] + 1j * parts[:, 1]
        return y, _RADIUS * np.sqrt((widths**2).mean(axis=(1, 3))) / np.linalg.norm(y, axis=2)


def build_rival(responses: Sequence[FrequencyResponse], region: Region) -> Surrogate:
    """A surrogate with a Gaussian process in place of its model, in the same coordinates."""
    n_axes = int(region.varies.sum())
    constant = Shape(((0,) * n_axes,), ())
    frame = build_surrogate(responses, Chosen(None, ((constant,),)), region)
    y = np.array([to_dq(response).y.ravel() for response in responses])
    return replace(frame, pieces=(Process(_fitted(frame.scale.unit(frame.points), y)),))


def _fitted(x: np.ndarray, y: np.ndarray) -> Any:
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

    smooth = ConstantKernel(10.0, (1e-2, 1e6)) * RBF(np.ones(x.shape[1]), (0.1, 100.0))
    kernel = smooth + WhiteKernel(1e-8, (1e-13, 1e-1))
    process = GaussianProcessRegressor(kernel, alpha=0.0, normalize_y=True, random_state=0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of parameters at their bounds
        return process.fit(x, np.hstack([y.real, y.imag]))
