"""A device that is one over its operating points: its models, and what they may lack.

The sweeps of a design may stand where a product that the model lacks is nearly a sum of those that it has. No left-out
sweep shows it then, and no rival that holds it is kept, for its left-out errors are large where the sweeps hardly tell
its coefficient. Elsewhere it may be of full size: the leverage of a model that is one product richer says how large.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from .certainty import Certainty, all_alike, certainty, free_sweeps, relative_error, what_each_tells
from .choosing import larger
from .sparse_rational import Data, Fitted, fit_shape, predict

_FEW = 3.0
"""Free sweeps below which their own mean may be small by luck, and those that hold corners count in full."""


@dataclass(frozen=True)
class Piece:
    """A device that is one over its operating points.

    Attributes
    ----------
    models : tuple of Fitted
        The chosen model first, then its rivals.
    sure : Certainty
        What a leverage stands for.
    wary : Certainty
        The same on the safe side: sweeps are placed and regions certified with it.
    data : Data
        The sweeps that they were fitted to.
    """

    models: tuple[Fitted, ...]
    sure: Certainty
    wary: Certainty
    data: Data

    def evaluate(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Y (p, f, 4) at points (p, d) of the unit box, and its radius relative to the norm."""
        best = predict(self.models[0], x)
        score = max(self.models[0].score, 1e-300)
        rivals = [predict(rival, x) for rival in self.models[1:]]
        worse = [rival.score / score for rival in self.models[1:]]
        return best.y, relative_error(best, self.sure, rivals, worse)

    @cached_property
    def cautious(self) -> Cautious:
        """The same on the safe side, with what the model may lack in its radius."""
        shapes = larger(self.models[0].shape)
        return Cautious(replace(self, sure=self.wary), tuple(fit_shape(self.data, shape) for shape in shapes))


def piece_of(models: tuple[Fitted, ...], data: Data, noise: np.ndarray | None) -> Piece | Cautious:
    """A piece of models, best first, of sweeps whose rows have the relative variance ``noise`` (f, m)."""
    best = models[0]
    sure, wary = (certainty(best, data, noise, counts(best, data)) for counts in (what_each_tells, all_alike))
    piece = Piece(models, sure, wary, data)
    return piece.cautious if free_sweeps(best, data) < _FEW else piece


@dataclass(frozen=True)
class Cautious:
    """A piece whose radius is the largest of its own and of those that models of one product more would have.

    It is what a sweep is placed by and certified with; as the radius of a 95 % region it would be too large.

    Attributes
    ----------
    piece : Piece
        What is predicted, with its radius on the safe side.
    richer : tuple of Fitted
        Models of one product more.
    """

    piece: Piece
    richer: tuple[Fitted, ...]

    @property
    def models(self) -> tuple[Fitted, ...]:
        """Those of the piece."""
        return self.piece.models

    @property
    def cautious(self) -> Cautious:
        """Itself."""
        return self

    def evaluate(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Y (p, f, 4) at points (p, d) of the unit box, and the larger radius relative to the norm."""
        y, radius = self.piece.evaluate(x)
        bars = [relative_error(predict(model, x), self.piece.sure, (), ()) for model in self.richer]
        return y, np.max([radius, *bars], axis=0)
