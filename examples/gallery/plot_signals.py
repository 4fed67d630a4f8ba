"""
A tone for every point, or all points at once?
==============================================

A tone measures one frequency at a time and is the reference. A multisine plays all of them in one waveform: ten
simulated seconds in place of minutes, with a larger error that the rows state themselves.
"""

import matplotlib.pyplot as plt
import numpy as np

import seqsweep as ss

f_hz = ss.log_grid(2, 900, 60)
tones = ss.sweep("dpmsg-v1", active_power_mw=0.65, f_hz=f_hz, progress=False)
multisine = ss.sweep("dpmsg-v1", active_power_mw=0.65, f_hz=f_hz, signal="multisine", amplitude_pu=0.01, progress=False)
print(tones, multisine, sep="\n")

# %%
# Both play the same device; a multisine has odd lines only, so that the tones are interpolated to its frequencies.

away = np.abs(multisine.f_hz - 50.0) > 2.0
f, y = multisine.f_hz[away], multisine.y[away]
expected = tones.interpolate(f)
size = np.linalg.norm(expected, axis=(1, 2))
difference = np.linalg.norm(y - expected, axis=(1, 2)) / size
print(f"median difference {np.median(difference):.1e}, largest {difference.max():.1e}")

fig, (above, below) = plt.subplots(2, 1, figsize=(6.8, 5.2), sharex=True, layout="constrained")
above.loglog(tones.f_hz, np.abs(tones.y[:, 0, 0]), color="#5f6670", label="tones")
above.loglog(f, np.abs(y[:, 0, 0]), "o", ms=4, color="#c2571a", label="multisine")
above.set(ylabel="|Ypp| (S)", title="two ways to the same admittance")
above.legend(frameon=False)
below.loglog(f, difference, "o", ms=4, color="#c2571a")
below.set(xlabel="f (Hz)", ylabel="difference, in parts of Y")
for axes in (above, below):
    axes.grid(alpha=0.3)
plt.show()
