"""
One follows the grid, one forms it
==================================

Two inverters with the same hardware, swept at the same operating point: ``gfl-v1`` locks on to the grid's voltage,
``gfm-v1`` is a voltage itself. The grid-forming one has the larger admittance at low frequencies, and there it behaves
like a machine.
"""

import matplotlib.pyplot as plt
import numpy as np

import seqsweep as ss

f_hz = ss.log_grid(2, 900, 60)
source = {"kind": "thevenin", "r_ohm": 0.002, "x_ohm": 0.04}
following = ss.sweep("gfl-v1", active_power_mw=1.0, f_hz=f_hz, source=source, progress=False)
forming = ss.sweep("gfm-v1", active_power_mw=1.0, f_hz=f_hz, source=source, progress=False)
print(following, forming, sep="\n")

# %%
# Passivity: where the smallest eigenvalue of the Hermitian part of Y is negative, the device feeds an oscillation of
# that frequency, and a resonance of the grid there can grow.


def feeding(y):
    """Smallest eigenvalue of the Hermitian part, over the size of Y."""
    hermitian = (y.y + y.y.conj().transpose(0, 2, 1)) / 2.0
    return np.linalg.eigvalsh(hermitian)[:, 0] / np.linalg.norm(y.y, axis=(1, 2))


fig, (above, below) = plt.subplots(2, 1, figsize=(6.8, 5.2), sharex=True, layout="constrained")
for y, name, colour in ((following, "gfl-v1, follows", "#1f5fa8"), (forming, "gfm-v1, forms", "#c2571a")):
    above.loglog(y.f_hz, np.linalg.norm(y.y, axis=(1, 2)), color=colour, label=name)
    below.semilogx(y.f_hz, feeding(y), color=colour)
below.axhline(0.0, color="#b3261e", lw=1.0)
above.set(ylabel="||Y|| (S)", title="the size of the admittance")
below.set(xlabel="f (Hz)", ylabel="in parts of ||Y||", title="below zero the device feeds an oscillation")
above.legend(frameon=False)
for axes in (above, below):
    axes.grid(alpha=0.3)
plt.show()
