"""A response as a pandas frame. pandas is imported when one is made."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..table.format import ELEMENTS, std_of

if TYPE_CHECKING:
    import pandas as pd

    from ..response import FrequencyResponse


def data_frame(response: FrequencyResponse) -> pd.DataFrame:
    """One row per frequency, index ``f_hz`` (Hz): complex elements (S), their standard deviations, status, quality."""
    import pandas as pd

    names = ELEMENTS if response.frame == "pn" else ("dd", "dq", "qd", "qq")
    y, std = response.y.reshape(-1, 4), std_of(np.asarray(response.covariance))
    columns = {f"y_{name}": y[:, k] for k, name in enumerate(names)}
    columns |= {f"y_{name}_std": std[:, k] for k, name in enumerate(names)}
    columns |= {"status": np.asarray(response.status), "reason": np.asarray(response.reason), **response.quality}
    return pd.DataFrame(columns, index=pd.Index(np.asarray(response.f_hz), name="f_hz"))
