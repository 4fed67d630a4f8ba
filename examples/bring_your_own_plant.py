"""A plant of one's own: an inductive load, on an ideal source.

    python examples/bring_your_own_plant.py

checks it, then sweeps it through the campaign runner by its name, ``python:bring_your_own_plant:Load``.
The same from the command line, in this folder: ``seqsweep check python:bring_your_own_plant:Load``.
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from seqsweep.plant.protocol import Injection, Job, OperatingPoint, OperatingRange, Rating, Record, Source


@dataclass(frozen=True)
class LoadState:
    """Where the load is: steps since time zero, current (A), source voltage (V, peak)."""

    step: int
    i: complex
    peak_v: float
    time_s: float


class Load:
    """R-L load, stepped by the exact response to a voltage that is held for one step."""

    id = "python:bring_your_own_plant:Load"
    f1_hz, dt_s = 50.0, 100e-6
    rating = Rating(voltage_v=400.0, power_va=10e3)
    operating_range = OperatingRange((-1e9, 1e9), (100.0, 800.0))
    power_meaning = "ignored: the load takes what |v_pcc| drives through it"

    def __init__(self, r_ohm: float = 2.0, l_h: float = 5e-3):
        self.decay = np.exp(-r_ohm * self.dt_s / l_h)  # of the current, over a step
        self.gain = (1.0 - self.decay) / r_ohm

    def settle(self, operating_point: OperatingPoint, source: Source) -> LoadState:
        u = operating_point.terminal_voltage_v
        if (
            source.kind != "ideal"
            or u is None
            or not 100.0 <= u <= 800.0
            or not abs(operating_point.active_power_w) <= 1e9
        ):
            raise ValueError("the load needs an ideal source of 100 to 800 V")
        peak_v = (2.0 / 3.0) ** 0.5 * u
        turn = np.exp(2j * np.pi * self.f1_hz * self.dt_s)
        return LoadState(0, self.gain * peak_v / (turn - self.decay), peak_v, 0.0)

    def run(self, jobs: list[Job], n_steps: int) -> list[tuple[LoadState, Record]]:
        return [self._run(job.state, job.injection, n_steps) for job in jobs]

    def _run(self, state: LoadState, injection: Injection | None, n_steps: int) -> tuple[LoadState, Record]:
        if injection and injection.kind == "shunt_current":
            raise ValueError("a shunt current changes nothing at a PCC that an ideal source holds")
        t = (state.step + np.arange(n_steps)) * self.dt_s
        v = state.peak_v * np.exp(2j * np.pi * self.f1_hz * t)
        for tone in injection.tones if injection else ():
            v += tone.amplitude * np.exp(1j * (2 * np.pi * tone.f_hz * t + tone.phase_rad))
        i = np.empty(n_steps + 1, complex)
        i[0] = state.i
        for k in range(n_steps):
            i[k + 1] = self.decay * i[k] + self.gain * v[k]
        step = state.step + n_steps
        end = LoadState(step, complex(i[-1]), state.peak_v, step * self.dt_s)
        return end, Record(state.time_s, self.dt_s, v, i[:-1], self.f1_hz, "load", self.id)

    def admittance(self, f_hz: np.ndarray) -> np.ndarray:
        """What a sweep must find: the closed form of the stepped load."""
        return self.gain / (np.exp(2j * np.pi * f_hz * self.dt_s) - self.decay)


CAMPAIGN = """
[campaign]
name = "my load"
[plant]
id = "python:bring_your_own_plant:Load"
parameters = { r_ohm = 1.5 }
[[operating_point]]
id = "rated"
active_power_mw = 0.0
terminal_voltage_pu = 1.0
[sweep]
f_hz = [10.0, 20.0, 80.0, 200.0, 400.0]
[injection]
kind = "series_voltage"
signal = "tone"
amplitude_pu = 0.01
[source]
kind = "ideal"
"""


def main() -> None:
    """Check the load, sweep it, compare with the closed form."""
    import os
    import subprocess

    from seqsweep.identify.table.read import read_table
    from seqsweep.plant.check import check_plant

    for finding in check_plant(Load()):
        print("pass" if finding.passed else "FAIL", finding.name, "-", finding.detail)
    seqsweep = Path(sys.executable).with_name("seqsweep")
    with tempfile.TemporaryDirectory() as folder:
        campaign, table = Path(folder) / "load.toml", Path(folder) / "load.parquet"
        campaign.write_text(CAMPAIGN, "utf-8")
        here = Path(__file__).resolve().parent
        subprocess.run([seqsweep, "run", campaign, "-o", table], check=True, cwd=here, env=dict(os.environ))
        (response,) = read_table(table).responses
    exact = Load(r_ohm=1.5).admittance(response.f_hz)
    error = np.max(np.abs(response.y[:, 0, 0] - exact) / np.abs(exact))
    print(f"{len(response.f_hz)} points, largest error of Ypp against the closed form: {error:.1e}")


if __name__ == "__main__":
    main()
