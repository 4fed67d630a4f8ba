"""Regions that `seqsweep run` sweeps itself, held against the exact admittance when they were certified."""

from __future__ import annotations

import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from harness import entry_point

from seqsweep.identify.surrogate.design import Progress
from seqsweep.identify.surrogate.region import AXES, Region
from seqsweep.identify.surrogate.surrogate import build_surrogate
from seqsweep.identify.table.read import Table, read_table
from tests.support.regions import DROOP, Device, errors_of, unseen

from .designs import Certified

PLANTS: dict[str, tuple[str, Mapping[str, float]]] = {
    "turbine": ("dpmsg-v1", {}),
    "droop inverter": ("gfm-v1", {"k_d": DROOP.k_d, "k_w": DROOP.k_w, "t_a_s": DROOP.t_a_s}),
}
"""The plants that `run` sweeps of the devices, and their parameters."""

POINTS = 60
"""Frequencies from 1 to 1000 Hz."""

UNSEEN = 300
"""Operating points at which the largest true error is looked for."""

_MOST = 30


def swept(name: str, device: Device, region: Region, tolerances: Sequence[float], seed: int) -> list[Certified]:
    """For each tolerance, the loosest first, when a campaign was certified to it, and how wrong it was then."""
    table = _run(name, device, region, tolerances[-1], seed)
    return [_certified(table, device, region, tolerance) for tolerance in tolerances]


def _run(name: str, device: Device, region: Region, tolerance: float, seed: int) -> Table:
    with tempfile.TemporaryDirectory() as folder:
        campaign, table = Path(folder) / "region.toml", Path(folder) / "y.parquet"
        campaign.write_text(_campaign(name, device, region, tolerance, seed), "utf-8")
        done = subprocess.run(
            [str(entry_point()), "run", str(campaign), "-o", str(table), "--jobs", "1"], capture_output=True, text=True
        )
        if not table.exists():
            raise SystemExit(done.stderr)
        return read_table(table)


def _campaign(name: str, device: Device, region: Region, tolerance: float, seed: int) -> str:
    plant, parameters = PLANTS[device.name]
    axes = [
        f"{axis} = [{low:g}, {high:g}]" if high > low else f"{axis} = {low:g}"
        for axis, low, high in zip(AXES, region.low, region.high, strict=True)
    ]
    return "\n".join(
        [
            f'[campaign]\nname = "{name}"\n[plant]\nid = "{plant}"\n[plant.parameters]',
            *(f"{key} = {value!r}" for key, value in parameters.items()),
            f"[sweep]\nf_min_hz = 1.0\nf_max_hz = 1000.0\npoints = {POINTS}\n[sweep.operating_points]",
            *axes,
            f"tolerance = {tolerance!r}\nmost = {_MOST}\nseed = {seed}\n",
        ]
    )


def _certified(table: Table, device: Device, region: Region, tolerance: float) -> Certified:
    n = _sweeps(table.meta["region"]["history"], tolerance)
    if n is None:
        return Certified(np.nan, np.nan)
    surrogate = build_surrogate(table.responses[:n], region=region)
    points = unseen(region, UNSEEN, 20250)
    truth = np.array([device.exact(point, surrogate.f1_hz + surrogate.nu_hz) for point in points])
    return Certified(n, float(errors_of(surrogate, points, truth)[0].max()))


def _sweeps(history: Sequence[Mapping[str, Any]], tolerance: float) -> int | None:
    """After how many operating points a campaign was certified for a tolerance; None: it was not."""
    for k, stage in enumerate(history):
        missed = tuple(at["fresh_error"] for at in history[: k + 1] if at["fresh_error"] is not None)
        if Progress(stage["doubt"], np.zeros(3), missed).is_certified(tolerance):
            return int(stage["operating_points"])
    return None
