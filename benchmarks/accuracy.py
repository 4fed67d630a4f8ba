"""How accurate is it? Every way of exciting the reference turbine against its exact linearisation, point by point.

Rewrites the table in ``docs/accuracy.md`` and draws ``docs/figures/accuracy.png``. Simulated seconds are those of the
perturbed runs, all experiments together; errors are ||dY||_F / ||Y||_F.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import Any

import numpy as np
from harness import ROOT, Report, rewrite, run_script

PAGE = ROOT / "docs" / "accuracy.md"
BEGIN, END = "<!-- table: python benchmarks/accuracy.py -->", "<!-- end of table -->"


@dataclass(frozen=True)
class Way:
    """One way of exciting the device; ``drawn`` ones are in the figure."""

    name: str
    injection: dict[str, Any]
    sweep: dict[str, Any]
    drawn: bool = False
    bar_median: float | None = None
    bar_max: float | None = None


WAYS = (
    Way("tones", {"amplitude_pu": 0.0005}, {}, True, 1e-5, 1e-4),
    Way("multisine", {"signal": "multisine", "amplitude_pu": 0.002}, {}, True, 1e-5, 5e-4),
    Way("multisine", {"signal": "multisine", "amplitude_pu": 0.01}, {"tolerance": 1e-4}, True, 1e-5, 5e-4),
    Way("multisine", {"signal": "multisine", "amplitude_pu": 0.05}, {"tolerance": 1e-3}),
    Way("prbs", {"signal": "prbs", "amplitude_pu": 0.01}, {"tolerance": 1e-4}),
    Way("qrb", {"signal": "qrb", "amplitude_pu": 0.01}, {"tolerance": 1e-4}),
    Way("chirp", {"signal": "chirp", "amplitude_pu": 0.01}, {"tolerance": 1e-4}, True),
)


@dataclass(frozen=True)
class Found:
    """What one way gave: per point frequency (Hz), true error and stated standard error, both relative."""

    way: Way
    f_hz: np.ndarray
    error: np.ndarray
    stated: np.ndarray
    simulated_s: float


def measure(quick: bool) -> Report:
    """Errors of every way; ``quick`` changes nothing, it takes seconds."""
    report = Report("How accurate is it: reference turbine, 0.65 MW, 1 Hz to 1 kHz, 100 points asked")
    found = [_one(way) for way in WAYS]
    for one in found:
        name = f"{one.way.name}, {one.way.injection['amplitude_pu']:g} pu"
        report.add(f"{name}: median error", np.median(one.error), "", one.way.bar_median)
        report.add(f"{name}: largest error", one.error.max(), "", one.way.bar_max)
        report.add(f"{name}: simulated", one.simulated_s, "s", 10.0 if one.way.name == "multisine" else None)
    _write_page(found)
    draw(found)
    return report


def _one(way: Way) -> Found:
    from seqsweep.identify.uncertainty import relative_uncertainty
    from seqsweep.plant.turbine.reference import ReferenceTurbine
    from seqsweep.sweep.config.sections import Config
    from seqsweep.sweep.measure.linearity import judged
    from seqsweep.sweep.measure.measure import measure as measure_batch
    from seqsweep.sweep.planning import make_plan
    from seqsweep.sweep.run.campaign import response_of

    sys.path.insert(0, str(ROOT))
    from tests.support import oracle

    plant = _clocked(ReferenceTurbine)
    config = Config.from_dict(
        {
            "campaign": {"name": "accuracy"},
            "plant": {"id": "dpmsg-v1"},
            "operating_point": [{"id": "p065", "active_power_mw": 0.65, "terminal_voltage_pu": 1.0}],
            "sweep": {"f_min_hz": 1.0, "f_max_hz": 1000.0, "points": 100, **way.sweep},
            "injection": way.injection,
        }
    )
    plan = make_plan(config, plant)
    rows = [row for batch in plan.batches() for row in measure_batch(plant, batch).rows]
    response = response_of(plan, "p065", judged(sorted(rows, key=lambda row: row.f_hz), plan.nonlinear_above))
    assert np.all(response.ok), set(response.status)
    exact = oracle.admittance_pn(response.f_hz, 0.65e6, 690.0)
    error = np.linalg.norm(response.y - exact, axis=(1, 2)) / np.linalg.norm(exact, axis=(1, 2))
    return Found(way, response.f_hz, error, relative_uncertainty(response), plant.perturbed_s)


def _clocked(kind: type) -> Any:
    """A plant that counts the simulated seconds of its perturbed runs."""

    class Clocked(kind):  # type: ignore[misc, valid-type]
        perturbed_s = 0.0

        def run(self, jobs: Any, n_steps: int) -> Any:
            self.perturbed_s += sum(job.injection is not None for job in jobs) * n_steps * self.dt_s
            return super().run(jobs, n_steps)

        def run_phasors(self, jobs: Any, windows: Any, block_steps: int, n_blocks: int) -> Any:
            self.perturbed_s += len(jobs) * n_blocks * block_steps * self.dt_s
            return super().run_phasors(jobs, windows, block_steps, n_blocks)

    return Clocked()


def _write_page(found: list[Found]) -> None:
    head = (
        "| excitation | peak (pu) | points | simulated (s) | median error | largest error | at (Hz) | stated, median |"
    )
    lines = [head, "|---" * 8 + "|"]
    lines += [
        f"| {one.way.name} | {one.way.injection['amplitude_pu']:g} | {len(one.f_hz)} | {one.simulated_s:.3g} | "
        f"{np.median(one.error):.1e} | {one.error.max():.1e} | {one.f_hz[one.error.argmax()]:.4g} | "
        f"{np.median(one.stated):.1e} |"
        for one in found
    ]
    rewrite(PAGE, BEGIN, END, "\n".join(lines))


def draw(found: list[Found]) -> None:
    """Error of every point over frequency."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(6.8, 4.2), layout="constrained")
    markers = iter("os^D")
    for one in [one for one in found if one.way.drawn]:
        label = f"{one.way.name}, {one.way.injection['amplitude_pu']:g} pu, {one.simulated_s:.3g} s simulated"
        axes.loglog(one.f_hz, one.error, next(markers), ms=3.5, lw=0.6, ls=":", label=label)
    axes.axvline(50.0, color="0.5", lw=0.8, ls="--")
    axes.annotate("$f_1$", (50.0, axes.get_ylim()[0]), (3, 4), textcoords="offset points", fontsize=9, color="0.35")
    axes.set_xlabel("f (Hz)")
    axes.set_ylabel("relative error of Y against the exact linearisation")
    axes.grid(True, which="both", lw=0.3)
    axes.set_ylim(top=axes.get_ylim()[1] * 30)
    axes.legend(fontsize=8, loc="upper left")
    folder = ROOT / "docs" / "figures"
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(folder / "accuracy.png", dpi=120)
    plt.close(figure)


if __name__ == "__main__":
    run_script("accuracy", measure)
