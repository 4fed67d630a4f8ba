"""A table does not depend on how wide the processor's vectors are."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import numpy as np
import pytest

from seqsweep.identify.table.read import read_table

from ..support.commands import TOP, call, campaign, command

sys.path.insert(0, str(TOP / "benchmarks"))

from harness import without_avx512

SETTINGS = without_avx512()
wide = pytest.mark.skipif(SETTINGS is None, reason="this processor has no AVX-512 to do without")


def largest_difference(folder: Path, plant: str, n: int, **point) -> float:
    """Of the rows with AVX-512 and with AVX2 alone, relative (Frobenius norm); the kernels are compiled for each."""
    path, kernels = campaign(folder, plant=plant, n=n, **point), folder / "kernels"
    assert command("run", path, "-o", folder / "wide.parquet").returncode == 0
    narrow = call(
        "run", path, "-o", folder / "narrow.parquet", env={**os.environ, **SETTINGS, "NUMBA_CACHE_DIR": str(kernels)}
    )
    assert narrow.returncode == 0, narrow.stderr
    assert list(kernels.rglob("*.kernel"))  # nothing that was compiled for this processor was taken
    one, other = (read_table(folder / f"{name}.parquet").responses[0].y for name in ("wide", "narrow"))
    return float(np.max(np.linalg.norm(one - other, axis=(1, 2)) / np.linalg.norm(one, axis=(1, 2))))


@wide
def test_the_turbine_has_the_same_rows_with_avx2_and_avx512(tmp_path):
    assert largest_difference(tmp_path, "dpmsg-v1", 3) < 1e-12


@wide
@pytest.mark.evidence
@pytest.mark.parametrize("plant", ["branch-v1", "dpmsg-v1", "gfm-v1", "gfl-v1"])
def test_every_plant_has_the_same_rows_with_avx2_and_avx512(tmp_path, plant):
    off = largest_difference(tmp_path, plant, 60, powers=(0.3, 0.6))
    print(f"{plant}, 60 frequencies: rows differ by {off:.1e} of Y at most between AVX2 and AVX-512")
    assert off < 1e-12
