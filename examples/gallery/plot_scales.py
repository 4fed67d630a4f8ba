"""
How far can the grid be stretched?
==================================

The reference turbine is swept once. Its table then answers for every length of the line, without another sweep.
"""

import matplotlib.pyplot as plt
import numpy as np

import seqsweep as ss

y = ss.sweep("dpmsg-v1", active_power_mw=0.65, f_hz=ss.log_grid(1, 1000, 60), progress=False)

# %%
# A verdict for ten lengths. Below a margin m of 1 the loop is unstable.

scales = np.linspace(0.6, 1.5, 10)
tunings = [ss.tune(y, grid="0.012+0.25j", scale=scale) for scale in scales]
margins = [tuning.margin_m for tuning in tunings]
for scale, tuning in zip(scales, tunings, strict=True):
    print(f"{scale:.1f} times the line: {tuning.verdict}, m = {tuning.margin_m:.3f}")

# %%
# The margin falls with the length of the line and is gone at 1.33 times it.

fig, axes = plt.subplots(figsize=(6.4, 3.2), layout="constrained")
axes.plot(scales, margins, "o-", color="#1f5fa8")
axes.axhline(1.0, color="#b3261e", linewidth=1.0)
axes.annotate("unstable below", (0.62, 1.0), xytext=(0, -14), textcoords="offset points", color="#b3261e")
axes.set(xlabel="length of the line, in parts of 0.012 + j0.25 ohm", ylabel="margin m")
axes.grid(alpha=0.3)
plt.show()
