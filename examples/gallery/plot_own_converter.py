"""
A converter in fifteen lines, and where it becomes unstable
===========================================================

The converter of the tutorial: current control, a phase-locked loop, a filter. It is swept once, and every grid is
judged from that sweep. Then the device itself is put behind some of these grids, to see whether it comes to rest.
"""

import warnings

import matplotlib.pyplot as plt
import numpy as np

import seqsweep as ss

warnings.filterwarnings("ignore", message=".*half a step of delay.*")


def step(state, v, dt):
    i, integral, angle, slip = state  # current out (A), current control, PLL
    turn = np.exp(1j * angle)
    error = 1200.0 - i / turn  # 1200 A, in phase with the voltage
    integral = integral + dt * 20.0 * error
    i = i + dt / 0.3e-3 * ((0.2 * error + integral) * turn - 2e-3 * i)  # filter: 0.3 mH, 2 mohm
    slip = slip + dt * 100.0 * (v / turn).imag
    angle = angle + dt * (100.0 * np.pi + slip + 1.0 * (v / turn).imag)
    return (i, integral, angle, slip), -i  # the current into the device


device = ss.plant_from_step(step, (0j, 0j, 0.0, 0.0), dt_s=50e-6, voltage_v=690.0, power_va=1e6)
y = ss.sweep(device, active_power_mw=1.0, f_hz=ss.log_grid(8, 900, 30), progress=False)

# %%
# The margin over the length of the line, from one sweep: below 1 the loop is unstable.

scales = np.linspace(1.4, 3.4, 9)
margins = [ss.tune(y, grid="0.01+0.15j", scale=scale).margin_m for scale in scales]

# %%
# The device itself, behind three of these lines.

seen = {}
for scale in (2.5, 2.7, 2.8):
    source = {"kind": "thevenin", "r_ohm": 0.01 * scale, "x_ohm": 0.15 * scale}
    seen[scale] = str(ss.sweep(device, active_power_mw=1.0, f_hz=[80.0], source=source, progress=False).status[0])
print(seen)

fig, axes = plt.subplots(figsize=(6.8, 3.6), layout="constrained")
axes.plot(scales, margins, "o-", color="#1f5fa8", label="from the sweep")
axes.axhline(1.0, color="#b3261e", lw=1.0)
for scale, status in seen.items():
    colour = "#2e7d4f" if status == "ok" else "#b3261e"
    axes.axvline(scale, color=colour, ls=":", lw=1.4)
    axes.annotate(
        status, (scale, max(margins)), rotation=90, xytext=(-10, -50), textcoords="offset points", color=colour
    )
axes.set(xlabel="length of the line, in parts of 0.01 + j0.15 ohm", ylabel="margin m")
axes.legend(frameon=False, loc="center left")
axes.grid(alpha=0.3)
plt.show()
