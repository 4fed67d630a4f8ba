"""What the program may not do: reach for the network, or execute what a file says."""

from __future__ import annotations

import ast
import shutil
import socket
from functools import cache
from pathlib import Path

import pytest
import typer

from seqsweep.sweep.cli.main import app

from ..support.commands import campaign, command

TOP = Path(__file__).parents[2]
ROOMS = ("seqsweep", "sweep", "tuning", "identify", "plant")
FILES = sorted(path for room in ROOMS for path in (TOP / room).rglob("*.py"))

PIPES = {
    "plant/foreign/sandbox.py": "the pipe to a reader's own process",
    "plant/promises.py": "a state that it has pickled the moment before, to see that it can be",
    "plant/states/forks.py": "the pipe to a box's own processes",
    "sweep/run/child.py": "the pipe to a plant's own process",
}
"""Modules that unpickle, and what: both ends are this program."""


@cache
def nodes_of(path: Path) -> list[ast.AST]:
    """What a module calls and imports, as Python reads it."""
    kinds = ast.Call, ast.Import, ast.ImportFrom
    return [node for node in ast.walk(ast.parse(path.read_text("utf-8"))) if isinstance(node, kinds)]


@cache
def calls(path: Path) -> list[str]:
    """Names of what a module calls, as written: ``eval``, ``pickle.loads``; where it is no name, what it ends with."""
    return [written(node.func) for node in nodes_of(path) if isinstance(node, ast.Call)]


def written(node: ast.expr) -> str:
    if isinstance(node, ast.Attribute):
        return f"{written(node.value)}.{node.attr}"
    return node.id if isinstance(node, ast.Name) else "..."


def test_no_text_is_executed():
    forbidden = {"eval", "exec", "builtins.eval", "builtins.exec", "os.system", "yaml.load"}
    assert [(path.name, call) for path in FILES for call in calls(path) if call in forbidden] == []


def test_nothing_is_unpickled_but_what_this_program_sent_itself():
    words = ("pickle.load", "pickle.loads", "cPickle.loads", "joblib.load", "pandas.read_pickle", "pd.read_pickle")
    found = {path.relative_to(TOP).as_posix() for path in FILES for call in calls(path) if call in words}
    assert found <= set(PIPES)
    arrays = [(path.name, call) for path in FILES for call in calls(path) if call in ("np.load", "numpy.load")]
    assert all("allow_pickle=True" not in (TOP / path).read_text("utf-8") for path in map(str, FILES))
    assert len(arrays) < 10


@pytest.fixture
def closed(monkeypatch):
    """Every way to another machine is closed; what was tried is in the list."""
    tried: list[object] = []

    def refuse(self, address, *others):
        tried.append(address)
        raise AssertionError(f"the network was asked for: {address}")

    for name in ("connect", "connect_ex", "bind", "sendto"):
        monkeypatch.setattr(socket.socket, name, refuse)
    monkeypatch.setattr(socket, "getaddrinfo", refuse)
    return tried


QUICK = ["--set", "sweep.points=24", "--set", "sweep.probes=0", "--set", "sweep.operating_points.tolerance=5e-2"]
GRID = "voltage_kv = 0.69\n[[element]]\nkind = 'series'\nr_ohm = 0.012\nx_ohm = 0.1\n"
LINE = ["--grid", "0.012+0.1j"]


def calls_of_every_command(folder: Path) -> list[list[object]]:
    """Command lines in an order in which each finds what it needs; the example of a farm lies in the folder."""
    campaign(folder, plant="dpmsg-v1", n=24)
    (folder / "grid.toml").write_text(GRID)
    y, region, kept = folder / "y.parquet", folder / "turbine.parquet", folder / "t.json"
    return [
        ["init", "-o", folder / "c.toml"],
        ["plan", folder / "campaign.toml"],
        ["check", "branch-v1"],
        ["run", folder / "campaign.toml", "-o", y],
        ["run", folder / "turbine.toml", "-o", region, "--jobs", 1, *QUICK],
        ["show", y, "--plot", folder / "y.png"],
        ["validate", y],
        ["tune", y, *LINE, "-o", kept],
        ["verify", kept, "-o", folder / "v.json"],
        ["judge", y, "--grids", folder / "grid.toml", "-o", folder / "j.parquet"],
        ["grid", TOP / "examples" / "grid.toml", "-o", folder / "g.json"],
        ["surrogate", region, "-o", folder / "s.parquet"],
        ["farm", folder / "farm.toml", "-o", folder / "f.json"],
        ["convert", folder / "farm.toml", "-o", folder / "farm.m"],
        ["report", y, kept, "-o", folder / "report.html"],
        ["compare", y, y],
        ["merge", y, region, "-o", folder / "both.parquet"],
        ["metrics", y, "-o", folder / "m.json"],
        [
            "identify",
            TOP / "data" / "csv" / "direct.csv",
            "-o",
            folder / "i.parquet",
            "--direction",
            "load",
            "--jobs",
            1,
        ],
        ["inject", folder / "campaign.toml", "-o", folder / "shots", "--format", "csv"],
        ["export", y, "-o", folder / "y.csv"],
        ["import", folder / "y.csv", "-o", folder / "again.parquet"],
        ["completion", "bash"],
        ["man"],
    ]


def done_without_network(lines: list[list[object]], tried: list[object]) -> None:
    """Every command does its work, and no socket was asked for anything."""
    for words in lines:
        done = command(*words)
        assert done.returncode in (0, 1), (words, done.stderr)
    assert tried == []


def test_from_a_campaign_to_a_report_without_the_network(tmp_path, closed):
    """The whole way on the reference turbine with every socket closed."""
    lines, whole_way = calls_of_every_command(tmp_path), ("run", "show", "tune", "export", "report")
    assert {words[0] for words in lines} == set(typer.main.get_command(app).commands)
    done_without_network([words for words in lines if words[0] in whole_way and QUICK[1] not in words], closed)


@pytest.mark.evidence
def test_no_command_asks_for_the_network(tmp_path, closed):
    """All of them, with every socket closed."""
    shutil.copytree(TOP / "examples" / "farm", tmp_path, dirs_exist_ok=True)
    lines = calls_of_every_command(tmp_path)
    done_without_network(lines, closed)
    print(f"{len(lines)} command lines, every command among them: no socket was asked for anything")


ASKING = {"ftplib", "http", "requests", "smtplib", "socket", "ssl", "telnetlib", "urllib", "urllib3", "webbrowser"}


def test_no_module_imports_what_could_ask_for_the_network():
    """`urllib.parse` takes addresses apart and asks for nothing."""
    nodes = ((path.relative_to(TOP).as_posix(), node) for path in FILES for node in nodes_of(path))
    names = [
        (path, name)
        for path, node in nodes
        for name in (
            [alias.name for alias in node.names] if isinstance(node, ast.Import)
            else [node.module or ""] if isinstance(node, ast.ImportFrom) and not node.level
            else []
        )
    ]  # fmt: skip
    assert [found for found in names if found[1].partition(".")[0] in ASKING and found[1] != "urllib.parse"] == []
