"""
Points where they are needed
============================

An adaptive grid places its points itself and stops when the interpolation between them is certified. Here it is held
against a sweep of 150 points that it has not seen.
"""

import warnings

import matplotlib.pyplot as plt
import numpy as np

import seqsweep as ss

warnings.filterwarnings("ignore", message=".*interpolation error certified.*")  # it is printed below
adaptive = ss.sweep("dpmsg-v1", active_power_mw=0.65, f_hz=ss.adaptive_grid(1, 1000, 60), progress=False)
dense = ss.sweep("dpmsg-v1", active_power_mw=0.65, f_hz=ss.log_grid(1, 1000, 150), progress=False)
certified = adaptive.meta["interpolation"]["error"]
print(f"{len(adaptive)} points, certified to {certified:.1e}")

# %%

away = np.abs(dense.f_hz - 50.0) >= 1.0
f, y = dense.f_hz[away], dense.y[away]
error = np.linalg.norm(adaptive.interpolate(f) - y, axis=(1, 2)) / np.linalg.norm(y, axis=(1, 2))
print(f"largest error at {len(f)} other frequencies: {error.max():.1e}")

fine = np.geomspace(1.0, 1000.0, 1500)
fine[np.abs(fine - 50.0) < 1.0] = np.nan  # f1 itself is in no sweep
fig, (above, below) = plt.subplots(2, 1, figsize=(6.8, 5.2), sharex=True, layout="constrained")
shown = np.abs(adaptive.interpolate(np.nan_to_num(fine, nan=52.0))[:, 0, 0])
above.loglog(fine, shown, color="#1f5fa8", label="interpolated")
above.loglog(adaptive.f_hz, np.abs(adaptive.y[:, 0, 0]), "o", ms=5, color="#1f5fa8", label="swept")
above.set(ylabel="|Ypp| (S)", title=f"{len(adaptive)} points, placed by the sweep itself")
above.legend(frameon=False)
below.loglog(f, np.maximum(error, 1e-9), ".", ms=4, color="#5f6670", label="true error")
below.axhline(certified, color="#2e7d4f", label="certified")
below.set(xlabel="f (Hz)", ylabel="in parts of Y")
below.legend(frameon=False)
for axes in (above, below):
    axes.grid(alpha=0.3)
plt.show()
