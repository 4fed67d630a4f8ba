"""
Which grids of a family are safe?
=================================

One sweep of the reference turbine, and a family of grids: short-circuit ratio against the percentage of series
compensation. The map shows the margin of each.
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt
import numpy as np

import seqsweep as ss

FAMILY = """
voltage_kv = 0.69
rated_power_mw = 1.632

[family]
combine = "all"

[[element]]
kind = "series_capacitor"
compensation_percent = { from = 0, to = 60, steps = 7 }

[[element]]
kind = "source"
scr = { from = 1.0, to = 4.0, steps = 9, spacing = "log" }
x_over_r = 20
"""

y = ss.sweep("dpmsg-v1", active_power_mw=0.65, f_hz=ss.log_grid(1, 1000, 100), progress=False)
with TemporaryDirectory() as folder:
    Path(folder, "family.toml").write_text(FAMILY)
    pairs = ss.judge(y, Path(folder) / "family.toml", elements=0)
counts = {verdict: sum(pair.verdict == verdict for pair in pairs) for verdict in ("stable", "unstable", "undecided")}
print(counts)

# %%
# The growth of the deciding mode of each grid. Without a capacitor that is the mode near 24 and 76 Hz; with one it is
# the resonance of the capacitor and the line, which the grid's resistance hardly damps.

by_place = {pair.grid_id: pair for pair in pairs}
growth = np.array([by_place[name].re_rad_s for name in sorted(by_place)], dtype=float).reshape(7, 9)
fig, axes = plt.subplots(figsize=(6.8, 3.9), layout="constrained")
scr = np.geomspace(1.0, 4.0, 9)
mesh = axes.pcolormesh(scr, np.linspace(0, 60, 7), growth, cmap="RdBu_r", vmin=-40, vmax=40, shading="nearest")
axes.set(xscale="log", xlabel="short-circuit ratio", ylabel="series compensation (%)")
axes.set_xticks([1, 1.5, 2, 3, 4], ["1", "1.5", "2", "3", "4"])
axes.minorticks_off()
fig.colorbar(mesh, label="growth of the deciding mode (rad/s)", extend="both")
plt.show()
