"""`seqsweep identify` on ten minutes of six channels at 10 kHz, and on a folder of a hundred records.

The device is an R-L branch; tones of 1 % of rated, 10 s each, 0.1 % noise, COMTRADE BINARY (20 bytes per sample).
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from harness import Report, command, run_script

RATE_HZ, F1_HZ, LENGTH_S = 10_000.0, 50.0, 10.0
CFG = """\
benchmark,device,1999
6,6A,0D
{channels}
50
1
{rate:g},{n}
01/01/2026,00:00:00.000000
01/01/2026,00:00:00.000000
BINARY
1
"""


def measure(quick: bool) -> Report:
    """CPU time, wall time and memory of whole processes."""
    n_tones = 20 if quick else 60
    report = Report("Recordings: COMTRADE in, table out")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        tones = _tones(n_tones)
        size_mb = _write(folder / "long", tones)
        wall_s, memory_mb, cpu_s = _identify(folder / "long.cfg", 1)
        minutes = n_tones * LENGTH_S / 60.0
        report.add(f"{minutes:g} min x 6 channels at 10 kHz, one worker: wall time", wall_s, "s", 5.0)
        report.add("the same: CPU time", cpu_s, "s")
        report.add("the same: size of the file", size_mb, "MB")
        report.add("the same: peak memory", memory_mb, "MB", None if quick else 2.0 * size_mb)
        many = folder / "many"
        many.mkdir()
        hundred = _tones(20 if quick else 100)
        for k, tone in enumerate(hundred):
            _write(many / f"shot_{k:03d}", [tone])
        for jobs in (1, 2):
            wall_s, _, cpu_s = _identify(many, jobs)
            report.add(f"a folder of {len(hundred)} records of 10 s, --jobs {jobs}: wall time", wall_s, "s")
    return report


def _identify(path: Path, jobs: int) -> tuple[float, float, float]:
    output = str(path.parent / "y.parquet")
    arguments = ["identify", str(path), "-o", output, "--direction", "load", "--force", "--jobs", str(jobs)]
    return command(arguments)


def _tones(n: int) -> list[float]:
    """Both frequencies of n / 2 points (Hz), beside every harmonic."""
    points = np.geomspace(3.0, 900.0, n // 2).round(1) + 0.03
    return [at for f in points for at in (f, 2.0 * F1_HZ - f)]


def _write(path: Path, tones: list[float]) -> float:
    """One tone after another in one recording; its size (MB)."""
    rng, n = np.random.default_rng(0), round(LENGTH_S * RATE_HZ)
    scale = np.repeat([1000.0, 3000.0], 3) / 32767.0
    turns = np.exp(-2j * np.pi / 3.0 * np.arange(3))
    with open(path.with_suffix(".dat"), "wb") as file:  # a piece at a time: a child's peak memory includes its parent's
        for k, tone in enumerate(tones):
            t = (k * n + np.arange(n)) / RATE_HZ
            lines = [(F1_HZ, 563.0), (tone, 5.63)]
            v = sum(size * np.exp(2j * np.pi * f * t) for f, size in lines)
            i = sum(size / (0.1 + 2e-3j * np.pi * f) * np.exp(2j * np.pi * f * t) for f, size in lines)
            x = np.column_stack([np.real(v[:, None] * turns), np.real(i[:, None] * turns)])
            x *= 1.0 + 1e-3 * rng.standard_normal(x.shape)
            rows = np.empty(n, [("n", "<u4"), ("t", "<u4"), ("x", "<i2", (6,))])
            rows["n"], rows["t"] = k * n + np.arange(1, n + 1), np.rint(t * 1e6)
            rows["x"] = np.rint(x / scale)
            rows.tofile(file)
    names = ("Va", "Vb", "Vc", "Ia", "Ib", "Ic")
    channels = [
        f"{c + 1},{name},,,{name[0].replace('I', 'A')},{scale[c]:.12g},0,0,-32767,32767,1,1,P"
        for c, name in enumerate(names)
    ]
    path.with_suffix(".cfg").write_text(CFG.format(channels="\n".join(channels), rate=RATE_HZ, n=n * len(tones)))
    return path.with_suffix(".dat").stat().st_size / 1e6


if __name__ == "__main__":
    run_script("recordings", measure)
