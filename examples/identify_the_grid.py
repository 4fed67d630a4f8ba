"""The grid behind the PCC from one noisy second, by the library: R and X with errors, and a picture.

    python examples/identify_the_grid.py [grid.png]

The same without noise from the command line: ``seqsweep grid examples/grid.toml -o grid.json --plot grid.png``.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from math import pi

import numpy as np

from seqsweep.identify.grid_impedance import identify_grid
from seqsweep.plant.protocol import Injection, Job, OperatingPoint, Source
from seqsweep.plant.turbine.reference import ReferenceTurbine
from seqsweep.sweep.excitation.signals import tones
from seqsweep.sweep.grid_probe.figure import plot
from seqsweep.sweep.grid_probe.probe import GridSeen, make_probe

R_OHM, X_OHM, NOISE = 0.012, 0.25, 0.005

turbine = ReferenceTurbine()
probe = make_probe("multisine", turbine, amplitude_pu=0.02, duration_s=1.0)
peak_a = probe.amplitude_pu * turbine.rating.peak_current_a
injection = Injection("shunt_current", tones(probe.signal, "d", turbine.f1_hz, peak_a))

# The turbine at 0.65 MW on the grid of Table I; the current is driven into the PCC for a second.
source = Source("thevenin", R_OHM, X_OHM / (2.0 * pi * turbine.f1_hz))
state = turbine.settle(OperatingPoint(0.65e6, 690.0), source)
((_, record),) = turbine.run([Job(state, injection)], round(1.0 / turbine.dt_s))

# Measured with white noise of 0.5 %: rms of its space vector over the rated peak.
random = np.random.default_rng(1)
noise = NOISE * np.sqrt(0.5) * (random.normal(size=(2, len(record.v))) + 1j * random.normal(size=(2, len(record.v))))
record = replace(
    record,
    v=record.v + turbine.rating.peak_voltage_v * noise[0],
    i=record.i + turbine.rating.peak_current_a * noise[1],
)

found = identify_grid(record, injection)
print(f"R = {found.r_ohm:.5f} +- {1.96 * found.r_std_ohm:.5f} ohm, true {R_OHM:g}")
print(f"X = {found.x_ohm:.5f} +- {1.96 * found.x_std_ohm:.5f} ohm at {found.f1_hz:g} Hz, true {X_OHM:g}")
print(f"an R-L branch: {found.is_rl} (residual as large by chance: {found.p_value:.0%})")
if len(sys.argv) > 1:
    plot([GridSeen("Table I, 0.5 % noise", found, float("nan"), "")], sys.argv[1])
