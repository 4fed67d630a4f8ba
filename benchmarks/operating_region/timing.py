"""How long the surrogate and a certified campaign take."""

from __future__ import annotations

import re
import resource
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np
from harness import ROOT, entry_point

from tests.support.regions import PQV, TURBINE, unseen

from .rival import BUILDS

BUILD_S, EVALUATE_S, CAMPAIGN_S = 5.0, 2.0, 15.0

F_HZ = 50.0 + np.logspace(-0.3, np.log10(950.0), 100)


def speed(build: str) -> tuple[float, float]:
    """CPU seconds to build from 20 sweeps at 100 frequencies, and to evaluate 1000 points at all of them."""
    random = np.random.default_rng(5)
    responses = [TURBINE.swept(point, 3e-6, random, F_HZ) for point in unseen(PQV, 20, 5)]
    begin = time.process_time()
    surrogate = BUILDS[build](responses, PQV)
    built = time.process_time()
    surrogate.evaluate(unseen(PQV, 1000, 6))
    return built - begin, time.process_time() - built


def campaign() -> tuple[float, float, int]:
    """Wall time and CPU time (s) of ``seqsweep run examples/region.toml`` on two workers, and the operating points."""
    with tempfile.TemporaryDirectory() as folder:
        table = Path(folder) / "y.parquet"
        command = [entry_point(), "run", ROOT / "examples" / "region.toml", "-o", table, "--jobs", "2"]
        before, begin = _used(), time.perf_counter()
        done = subprocess.run([str(part) for part in command], capture_output=True, text=True)
        wall = time.perf_counter() - begin
    if done.returncode:
        raise SystemExit(done.stderr)
    return wall, _used() - before, int(re.findall(r"(\d+) operating points", done.stderr)[-1])


def _used() -> float:
    """CPU seconds of the processes that this one has waited for."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
