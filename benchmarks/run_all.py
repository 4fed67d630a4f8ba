"""Every benchmark, each in a process of its own; then the page ``docs/figures/benchmarks.md`` and its plot.

    python benchmarks/run_all.py [--quick] [--only kernel,process] [--page]

With --page nothing runs: page and plot are made from what ``build/benchmarks/`` holds. A quick run
writes its page to ``build/benchmarks/`` instead of ``docs/figures/``.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

from harness import KEPT, ROOT, Report, read_report

NAMES = (
    "kernel",
    "against_others",
    "dpsim_sweep",
    "tradeoff",
    "accuracy",
    "scaling",
    "parallel",
    "process",
    "recordings",
    "thousand",
    "hundred_thousand",
    "dask_cluster",
    "plan",
    "host",
)
NEEDS_DPSIM = {"dpsim_sweep"}


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--quick", action="store_true", help="fewer repetitions and smaller sizes")
    parser.add_argument("--only", default=",".join(NAMES), help="names, separated by commas")
    parser.add_argument("--page", action="store_true", help="only write page and plot")
    arguments = parser.parse_args()
    for name in [] if arguments.page else arguments.only.split(","):
        if name in NEEDS_DPSIM and not _has_dpsim():
            print(f"## {name}\n\nleft out: dpsim is not installed (pip install dpsim)\n")
            continue
        print(f"## {name}\n", flush=True)
        script = str(Path(__file__).with_name(f"{name}.py"))
        subprocess.run([sys.executable, script, *(["--quick"] if arguments.quick else [])], check=True)
        print(flush=True)
    _write_page(KEPT if arguments.quick else ROOT / "docs" / "figures")


def _has_dpsim() -> bool:
    from importlib.util import find_spec

    return find_spec("dpsimpy") is not None


def _write_page(folder: Path) -> None:
    """Page and plot of everything that was kept; what comes from a quick run is marked."""
    kept = {name: read_report(name) for name in NAMES if (KEPT / f"{name}.json").exists()}
    folder.mkdir(parents=True, exist_ok=True)
    head = "<!-- written by `python benchmarks/run_all.py`; do not edit -->\n"
    parts = [
        f"## {report.title}\n\n`python benchmarks/{name}.py{' --quick' if quick else ''}`\n\n{report.table()}\n"
        for name, (report, quick) in kept.items()
    ]
    (folder / "benchmarks.md").write_text("\n".join([head, "# Benchmarks\n", *parts]), "utf-8")
    _draw({name: report for name, (report, _) in kept.items()}, folder / "benchmarks.png")
    print(f"page and plot: {folder}")


def _draw(reports: dict[str, Report], path: Path) -> None:
    """Speed beside others, cost against size, the kernel over processes."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(11.0, 4.2), layout="constrained", width_ratios=(1.3, 1.0))
    if "against_others" in reports:
        rates = reports["against_others"].series["rates"]
        names = list(rates)[::-1]
        colours = ["C0" if name.startswith("reference") else "0.6" for name in names]
        bars = left.barh(names, [rates[name] for name in names], color=colours)
        left.bar_label(bars, [f"{rates[name]:.3g}" for name in names], padding=3, fontsize=8)
        left.set_xscale("log")
        left.margins(x=0.25)
        left.set_xlabel("simulated seconds per CPU second")
        left.tick_params(axis="y", labelsize=8)
    if "scaling" in reports:
        for (what, series), marker in zip(reports["scaling"].series.items(), "os", strict=True):
            per_point = 1.0 if what == "points" else 100.0
            total = [n * per_point for n in series["n"]]
            label = (
                "one operating point, more frequencies"
                if what == "points"
                else "100 frequencies, more operating points"
            )
            right.loglog(total, series["wall_s"], marker + "-", label=label)
        first = reports["scaling"].series["operating points"]
        n0, t0 = first["n"][0] * 100.0, first["wall_s"][0]
        ends = [n0, first["n"][-1] * 100.0]
        right.loglog(ends, [t0 * n / n0 for n in ends], "k:", lw=1, label="linear")
        right.set_xlabel("points of the table")
        right.set_ylabel("wall time, two workers (s)")
        right.grid(True, which="both", lw=0.3)
        right.legend(fontsize=8)
    figure.savefig(path, dpi=120)
    plt.close(figure)


if __name__ == "__main__":
    main()
