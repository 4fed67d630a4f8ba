"""What a fit of few poles leaves out, as an error beside it."""

from __future__ import annotations

import numpy as np

from seqsweep.identify.fit.omitted import _second_moment, _Seen


def test_what_many_faint_directions_hold_is_not_denied_by_the_few_that_rows_see_sharply() -> None:
    """Sixty directions seen over four decades, each holding 2.5 variances of noise, or what noise alone leaves."""
    found = np.tile([1.0, -1.0], 30)

    def moment(variances: float, most: float) -> np.ndarray:
        seen = _Seen(np.eye(60), np.geomspace(1e8, 1e4, 60), np.sqrt(variances) * found, 1540.0, 1600)
        root, _ = _second_moment(seen, most)
        return np.diag(root @ root.T)

    assert moment(2.5, 3.0).min() > 1.2
    assert moment(2.5, np.inf)[-10:].max() < 0.2  # with no bound on the sharp ones
    assert moment(1.0, 3.0)[-10:].max() < 0.1
