"""An adaptive sweep of the reference turbine: where its points are, and what is certified against what is true.

    python examples/adaptive_points.py [PICTURE.png]

The truth is a second sweep with 150 points on a logarithmic grid.
"""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt
import numpy as np

from seqsweep.identify.fit.adaptive import interpolate
from seqsweep.identify.response import FrequencyResponse
from seqsweep.identify.table.read import read_table
from seqsweep.plant.registry import make_plant
from seqsweep.sweep.config.sections import Config
from seqsweep.sweep.planning import make_plan
from seqsweep.sweep.run.campaign import run


def sweep(**grid: object) -> FrequencyResponse:
    """The turbine at 0.65 MW over 1 to 1000 Hz."""
    point = {"id": "p065", "active_power_mw": 0.65, "terminal_voltage_pu": 1.0}
    band = {"f_min_hz": 1.0, "f_max_hz": 1000.0, **grid}
    plant = make_plant("dpmsg-v1")
    config = Config.from_dict(
        {"campaign": {"name": "x"}, "plant": {"id": "dpmsg-v1"}, "operating_point": [point], "sweep": band}
    )
    with TemporaryDirectory() as folder:
        run(make_plan(config, plant), plant, Path(folder) / "y.parquet", jobs=2)
        return read_table(Path(folder) / "y.parquet").response("p065")


def draw(adaptive: FrequencyResponse, dense: FrequencyResponse, path: str) -> None:
    """Magnitudes and points above; the error at the dense sweep's points below."""
    certificate = adaptive.meta["interpolation"]
    away = np.abs(dense.f_hz - dense.f1_hz) >= 1.0
    f_hz, y = dense.f_hz[away], dense.y[away]
    error = np.linalg.norm(interpolate(adaptive, f_hz) - y, axis=(1, 2)) / np.linalg.norm(y, axis=(1, 2))
    figure, (above, below) = plt.subplots(2, 1, figsize=(8, 6), sharex=True, layout="constrained")
    fine = np.geomspace(1.0, 1000.0, 2000)
    model = interpolate(adaptive, fine)
    for (i, j), name in (((0, 0), "Ypp"), ((0, 1), "Ypn")):
        (line,) = above.loglog(fine, np.abs(model[:, i, j]), label=f"|{name}|, interpolated")
        above.loglog(adaptive.f_hz, np.abs(adaptive.y[:, i, j]), "o", ms=5, color=line.get_color())
    above.set_ylabel("S")
    above.set_title(f"{len(adaptive)} points placed by the adaptive grid")
    above.legend()
    below.loglog(f_hz, np.maximum(error, 1e-9), ".", ms=4, label="against a sweep of 150 points")
    below.axhline(certificate["error"], color="C2", label=f"certified: {certificate['error']:.1e}")
    below.axhline(certificate["tolerance"], color="C3", ls="--", label=f"asked: {certificate['tolerance']:g}")
    below.set(xlabel="f (Hz)", ylabel="||dY|| / ||Y||")
    below.legend()
    figure.savefig(path, dpi=120)
    print(f"{len(adaptive)} points, certified to {certificate['error']:.1e}; largest difference {error.max():.1e}")


if __name__ == "__main__":
    draw(sweep(points=60, spacing="adaptive"), sweep(points=150), sys.argv[1] if len(sys.argv) > 1 else "adaptive.png")
