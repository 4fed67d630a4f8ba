"""Kernel: ns per step and lane, against a floor counted from the kernel's own operations; of lanes that are calm.

CPU time, in several fresh processes, because the stack's alignment is drawn anew in each. The floor: the Python of
the kernel is run on numbers that count what is done to them; a product that goes straight into a sum
is one operation with it (fused). Each operation costs what a fused pair, a division or a square
root costs in a loop of nothing else, compiled by the same compiler on the same core. Loads and
stores are free in this count, so that no kernel can quite reach it.
"""

from __future__ import annotations

import math
import os
import time
from collections import Counter
from functools import partial
from statistics import median
from types import SimpleNamespace
from typing import Any, ClassVar

from harness import Report, fresh, run_script, seconds, without_avx512

SOURCES = ("ideal", "thevenin")
INVERTERS = ("gfm-v1", "gfl-v1")
INVERTER_BARS = {"gfm-v1": 1.2, "gfl-v1": 1.0}
BAR_NS = 22.0
EMT_BAR_NS = 9.0
AVX2_BAR = 2.2
AVX2_PAIRS = 3


def measure(quick: bool) -> Report:
    """Figures of the kernel."""
    counts = fresh(__file__, {"NUMBA_DISABLE_JIT": "1"}, what="count")
    runs = [fresh(__file__, what="time") for _ in range(3 if quick else 9)]
    report = Report("Kernel: RK4 of the complete turbine, 8 lanes, 50 us, one tone, phasors accumulated")
    price = {kind: min(run["price"][kind] for run in runs) for kind in ("arithmetic", "division", "root")}
    for source in SOURCES:
        times = [run[source] for run in runs]
        floor = sum(price[kind] * counts[source][kind] for kind in price)
        report.add(f"{source}, median of {len(runs)} processes", median(times), "ns/step/lane", BAR_NS)
        report.add(f"{source}, best process", min(times), "ns/step/lane")
        report.add(f"{source}, slowest process", max(times), "ns/step/lane")
        report.add(f"{source}, operations (fused pairs count once)", counts[source]["arithmetic"], "per step and lane")
        report.add(f"{source}, divisions and square roots", _slow(counts[source]), "per step and lane")
        report.add(f"{source}, counted floor", floor, "ns/step/lane")
        report.add(f"{source}, median over floor", median(times) / floor, "", 1.5)
        report.add(f"{source}, second order", median(run[f"{source} emt"] for run in runs), "ns/step/lane", EMT_BAR_NS)
        complete = median(run[f"{source} complete"] for run in runs)
        report.add(f"{source}, with its machine and limits, median of {len(runs)} processes", complete, "ns/step/lane")
        ratio = median(run[source] / run[f"{source} complete"] for run in runs)
        report.add(f"{source}, without over with, same process", ratio, "")
        ratio = median(run[f"{source} emt"] / run[source] for run in runs)
        report.add(f"{source}, second order over RK4, same process", ratio, "")
    for inverter in INVERTERS:
        name = f"{inverter}, 25 us"
        report.add(f"{name}, median of {len(runs)} processes", median(run[inverter] for run in runs), "ns/step/lane")
        ratio = median(run[inverter] / run["thevenin complete"] for run in runs)
        of_what = "the turbine's RK4 behind a grid, with its machine and limits"
        report.add(f"{name}, over {of_what}, same process", ratio, "", INVERTER_BARS[inverter])
    for source, ratio in _avx2_over_avx512().items():
        report.add(f"{source}, AVX2 over AVX-512, median of {AVX2_PAIRS} pairs", ratio, "", AVX2_BAR)
    for kind, ns in price.items():
        report.add(f"price of one {kind}", ns, "ns/lane")
    report.series = {"processes": {source: [run[source] for run in runs] for source in SOURCES}}
    return report


def _avx2_over_avx512() -> dict[str, float]:
    """How many times longer a step takes with AVX2 alone, by source; empty on a processor that has no AVX-512."""
    settings = without_avx512()
    if settings is None:
        return {}
    pairs = [(fresh(__file__, settings, what="time"), fresh(__file__, what="time")) for _ in range(AVX2_PAIRS)]
    return {source: median(narrow[source] / wide[source] for narrow, wide in pairs) for source in SOURCES}


def _slow(count: dict[str, int]) -> int:
    return count["division"] + count["root"]


def child(what: str) -> dict[str, Any]:
    """One process: counts, or times and prices."""
    return _counted() if what == "count" else _timed()


# Times


def _timed() -> dict[str, Any]:
    import numpy as np

    found: dict[str, Any] = {"price": _prices()}
    n_blocks, block_steps = 50, 400
    for source in SOURCES:
        times: dict[str, list[float]] = {source: [], f"{source} emt": []}
        calls = {}
        for what, integrator in zip(list(times), ("rk4", "emt"), strict=True):
            advance, arguments, slot = _experiment(source, integrator)
            calls[what] = partial(advance, *arguments, block_steps, slot, np.empty((n_blocks, 8, 8)))
            calls[what]()
        advance, arguments, slot = _experiment(source)
        times[f"{source} complete"] = []
        calls[f"{source} complete"] = partial(
            advance.complete, *arguments, block_steps, slot, np.empty((n_blocks, 8, 8))
        )
        calls[f"{source} complete"]()
        for plant_id in INVERTERS if source == "thevenin" else ():
            times[plant_id] = []
            advance, arguments, slot = _inverter(plant_id)
            calls[plant_id] = partial(advance, *arguments, block_steps, slot, np.empty((n_blocks, 8, 8)))
            calls[plant_id]()
        for _ in range(7):  # in turns, so that neighbours on the machine disturb both alike
            for what, call in calls.items():
                times[what] += seconds(call, 1, time.process_time)
        found |= {what: median(t) / (n_blocks * block_steps * 8) * 1e9 for what, t in times.items()}
    return found


def _experiment(source_kind: str, integrator: str = "rk4") -> tuple[Any, tuple[Any, ...], int]:
    """A kernel, its arguments but for the blocks, and the slot of the sums: eight lanes, a tone at 77 Hz each."""
    from seqsweep.plant.kernels import turbine as kernel
    from seqsweep.plant.protocol import Injection, Job, OperatingPoint, Source, Tone, Window
    from seqsweep.plant.turbine.parameters import LINE_L_H, LINE_R_OHM
    from seqsweep.plant.turbine.reference import ReferenceTurbine

    plant = ReferenceTurbine(integrator=integrator)
    source = Source() if source_kind == "ideal" else Source("thevenin", LINE_R_OHM, LINE_L_H)
    state = plant.equilibrium(OperatingPoint(0.65e6, 690.0), source)
    job = Job(state, Injection("series_voltage", (Tone(77.0, 0.5),)))
    ((lanes, _, advance, n_tones),) = plant._batches([job] * kernel.LANES, [Window(77.0, 15)] * kernel.LANES, 400)
    return advance, (lanes, n_tones, plant.parameters, plant.dt_s), kernel.SUM_V


def _inverter(plant_id: str) -> tuple[Any, tuple[Any, ...], int]:
    """As `_experiment`, for an inverter behind SCR 5."""
    from seqsweep.plant.kernels import inverters as kernel
    from seqsweep.plant.protocol import Injection, Job, OperatingPoint, Source, Tone, Window
    from seqsweep.plant.registry import make_plant

    plant: Any = make_plant(plant_id)
    x_ohm = plant.base_impedance_ohm / 5.0
    source = Source("thevenin", 0.1 * x_ohm, x_ohm / (2.0 * math.pi * 50.0))
    state = plant.equilibrium(OperatingPoint(0.5 * plant.rating.power_va, 690.0), source)
    job = Job(state, Injection("series_voltage", (Tone(77.0, 0.5),)))
    ((lanes, _, table, tones),) = plant._batches([job] * kernel.LANES, [Window(77.0, 15)] * kernel.LANES, 400)
    return partial(plant._advance(""), table), (lanes, tones, plant.parameters, plant.dt_s), kernel.SUM_V


def _prices() -> dict[str, float]:
    """ns per lane of a fused pair, a division, a square root, in vector loops of nothing else."""
    import numpy as np
    from numba import njit

    @njit(fastmath={"nsz", "contract"}, error_model="numpy")
    def fused(x: Any, n: int) -> None:
        for _ in range(n):
            for i in range(64):
                y = x[i]
                for _ in range(16):
                    y = y * y + 0.1  # not affine: nothing to fold
                x[i] = y

    @njit(fastmath={"nsz", "contract"}, error_model="numpy")
    def divided(x: Any, n: int) -> None:
        for _ in range(n):
            for i in range(64):
                y = x[i]
                for _ in range(8):
                    y = 1.5 / y
                x[i] = y

    @njit(fastmath={"nsz", "contract"}, error_model="numpy")
    def rooted(x: Any, n: int) -> None:
        for _ in range(n):
            for i in range(64):
                y = x[i]
                for _ in range(8):
                    y = math.sqrt(y)
                x[i] = y

    prices = {}
    for kind, loop, depth in (("arithmetic", fused, 16), ("division", divided, 8), ("root", rooted, 8)):
        x = np.full(64, 0.2)
        loop(x, 10)
        prices[kind] = min(seconds(partial(loop, x, 20000), 9, time.process_time)) / (20000 * 64 * depth) * 1e9
    return prices


# The count


class _Counting:
    """A number that counts what is done to it; constants of a run are plain floats and cost nothing."""

    tally: ClassVar[Counter[str]] = Counter()
    __slots__ = ("product", "value")

    def __init__(self, value: float, product: bool = False):
        self.value, self.product = float(value), product

    def _add(self, other: Any, sign: float) -> _Counting:
        for term in (self, other):
            if isinstance(term, _Counting) and term.product:
                term.product = False  # the product and this sum are one operation, already counted
                break
        else:
            self.tally["arithmetic"] += 1
        return _Counting(self.value + sign * _value(other))

    def __add__(self, other: Any) -> _Counting:
        return self._add(other, 1.0)

    __radd__ = __add__

    def __sub__(self, other: Any) -> _Counting:
        return self._add(other, -1.0)

    def __rsub__(self, other: Any) -> _Counting:
        return (-self)._add(other, 1.0)

    def __neg__(self) -> _Counting:
        negative = _Counting(-self.value, self.product)
        self.product = False
        return negative

    def __mul__(self, other: Any) -> _Counting:
        self.tally["arithmetic"] += 1
        return _Counting(self.value * _value(other), product=True)

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> _Counting:
        if not isinstance(other, _Counting):  # by a constant of the run: times its inverse
            return self * (1.0 / other)
        return other.__rtruediv__(self)

    def __rtruediv__(self, other: Any) -> _Counting:
        self.tally["division"] += 1
        return _Counting(_value(other) / self.value)

    def __abs__(self) -> _Counting:
        self.tally["arithmetic"] += 1
        return _Counting(abs(self.value))

    def __lt__(self, other: Any) -> bool:
        self.tally["arithmetic"] += 1  # a minimum or maximum
        return self.value < _value(other)

    __gt__ = __lt__  # which of the two is chosen does not change the count


def _value(x: Any) -> float:
    return x.value if isinstance(x, _Counting) else float(x)


def _floor(x: _Counting) -> _Counting:
    x.tally["arithmetic"] += 1
    return _Counting(math.floor(x.value))


def _sqrt(x: _Counting) -> _Counting:
    x.tally["root"] += 1
    return _Counting(math.sqrt(x.value))


def _counted() -> dict[str, dict[str, int]]:
    """Operations of one step of one lane; the kernel runs as plain Python."""
    import numpy as np

    assert os.environ["NUMBA_DISABLE_JIT"] == "1"
    from seqsweep.plant.kernels import turbine as kernel

    found = {}
    for source in SOURCES:
        advance, (lanes, *constants), slot = _experiment(source)
        x = np.array([_Counting(value) for value in lanes], dtype=object)
        shim = SimpleNamespace(floor=_floor, sqrt=_sqrt, pi=math.pi, exp=math.exp, cos=math.cos, sin=math.sin)
        kernel.math, whole = shim, kernel.math
        _Counting.tally.clear()
        advance.calm(x, *constants, 1, slot, np.empty((1, 8, kernel.LANES), dtype=object))
        kernel.math = whole
        tally = _Counting.tally
        found[source] = {kind: tally[kind] // kernel.LANES for kind in ("arithmetic", "division", "root")}
    return found


if __name__ == "__main__":
    run_script("kernel", measure, child)
