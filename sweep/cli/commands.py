"""Every command by its name, with examples, and what people type who mean it: the one source of help, completion and
the manual page."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from . import bank, compare, convert, decide, farm, files, handover, metrics, region, show, sweep
from .shell import completion, man

PAGES = "docs"
"""Folder of the pages, as the last line of every help names it."""


class Command(NamedTuple):
    """A command: what it runs, examples of it, the page that explains it, other words for it."""

    run: Callable[..., None]
    examples: tuple[str, ...]
    page: str
    synonyms: tuple[str, ...] = ()


COMMANDS: dict[str, Command] = {
    "init": Command(
        sweep.init,
        ("init", "init --plant vendor.so -o vendor.toml", "init --notebook"),
        "tutorial.md",
        ("new", "create", "template", "start"),
    ),
    "plan": Command(sweep.plan, ("plan campaign.toml",), "excitation.md", ("dry-run", "estimate", "preview")),
    "run": Command(
        sweep.run,
        ("run campaign.toml -o y.parquet", "run campaign.toml -o y.parquet --set sweep.points=50"),
        "tutorial.md",
        ("sweep", "scan", "measure", "execute", "resume"),
    ),
    "show": Command(
        show.show,
        (
            "show y.parquet --plot bode.png",
            "show y.parquet --at 77",
            "show y.parquet --op p065 --plot z.png --impedance --axes db",
        ),
        "table-format.md",
        ("plot", "bode", "info", "summary", "print", "view", "display"),
    ),
    "validate": Command(sweep.validate, ("validate y.parquet",), "table-format.md", ("lint",)),
    "tune": Command(
        decide.tune,
        (
            "tune y.parquet --grid 0.012+0.25j",
            "tune y.parquet --grid 0.012+0.25j --scale 1,1.2,1.4 --plot t.png",
            "tune y.parquet --grid 0.012+0.25j --confirm -o tuning.json",
        ),
        "stability.md",
        ("stability", "nyquist", "gain", "margin"),
    ),
    "judge": Command(
        bank.judge,
        ("judge y.parquet --grids grids/ -o judge.parquet --plot map.png",),
        "grids.md",
        ("judgement", "bank", "screen"),
    ),
    "verify": Command(
        decide.verify,
        ("verify tuning.json --plot verify.png",),
        "verify.md",
        ("simulate", "simulation", "time"),
    ),
    "grid": Command(decide.grid, ("grid campaign.toml -o grid.json",), "grid-impedance.md", ("probe",)),
    "surrogate": Command(
        region.surrogate,
        (
            "surrogate region.parquet --at 0.65,0,1.0",
            "surrogate region.parquet --grid 0.012+0.25j --source-voltage 1",
        ),
        "surrogate.md",
        ("predict", "interpolate", "region"),
    ),
    "farm": Command(farm.farm, ("farm farm.toml --plot farm.png",), "farm.md", ("park", "plant", "network")),
    "convert": Command(
        convert.convert,
        ("convert network.json -o farm.toml", "convert farm.toml -o farm.m"),
        "farm.md",
        ("pandapower", "matpower", "translate"),
    ),
    "report": Command(
        handover.report,
        (
            "report y.parquet tuning.json verify.json -o report.html --pdf",
            "report y.parquet tuning.json -o report.html --profile great-britain",
        ),
        "report.md",
        ("html", "pdf", "document"),
    ),
    "compare": Command(
        compare.compare,
        ("compare vendor.parquet laboratory.parquet --plot difference.png",),
        "report.md",
        ("diff", "difference", "match"),
    ),
    "merge": Command(
        compare.merge,
        ("merge low.parquet high.parquet -o y.parquet",),
        "table-format.md",
        ("join", "concat", "concatenate", "combine", "append"),
    ),
    "metrics": Command(
        metrics.metrics, ("metrics y.parquet --plot metrics.png",), "metrics.md", ("nfp", "passivity", "jacobian")
    ),
    "check": Command(sweep.check, ("check dpmsg-v1", "check vendor.fmu"), "black-boxes.md", ("inspect", "test")),
    "identify": Command(
        files.identify,
        ("identify records/ --manifest m.json --direction load -o y.parquet",),
        "recordings.md",
        ("record", "recordings", "estimate-y"),
    ),
    "inject": Command(
        files.inject_command,
        ("inject campaign.toml -o injected --format comtrade",),
        "inject.md",
        ("perturb", "excite", "playback"),
    ),
    "export": Command(
        files.export_command,
        ("export y.parquet -o y.csv", "export y.parquet -o y.mat --frame dq"),
        "exchange.md",
        ("save", "write"),
    ),
    "import": Command(
        files.import_command,
        ("import y.csv -o y.parquet",),
        "exchange.md",
        ("read", "load", "open"),
    ),
    "completion": Command(
        completion,
        ("completion bash > seqsweep.bash", "completion fish | source"),
        "shell.md",
        ("complete",),
    ),
    "man": Command(man, ("man > seqsweep.1", "man | man -l -"), "shell.md", ("manual", "help")),
}


def epilog_of(command: Command) -> str:
    """Examples and the page, below the help of a command; nothing of it is wrapped."""
    lines = ["Examples:", *(f"  seqsweep {example}" for example in command.examples)]
    return "\b\n" + "\n".join(lines) + f"\n\nMore: {PAGES}/{command.page}"


def meant_by(word: str) -> str | None:
    """The command that a word from elsewhere stands for; None where it is none of the list."""
    lowered = word.lower()
    return next((name for name, command in COMMANDS.items() if lowered in command.synonyms), None)
