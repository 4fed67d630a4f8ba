"""What the program may not do: reach for the network, or execute what a file says."""

from __future__ import annotations

import ast
import socket
from functools import cache
from pathlib import Path

import pytest

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
def calls(path: Path) -> list[str]:
    """Names of what a module calls, as written: ``eval``, ``pickle.loads``."""
    nodes = ast.walk(ast.parse(path.read_text("utf-8")))
    return [ast.unparse(node.func) for node in nodes if isinstance(node, ast.Call)]


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


def test_from_a_campaign_to_a_report_without_the_network(tmp_path, closed):
    """The whole way on the reference turbine with every socket closed."""
    table, decision = tmp_path / "y.parquet", tmp_path / "t.json"
    for words in (
        ("run", campaign(tmp_path, plant="dpmsg-v1", n=24), "-o", table),
        ("show", table, "--plot", tmp_path / "y.png"),
        ("tune", table, "--grid", "0.012+0.25j", "-o", decision),
        ("export", table, "-o", tmp_path / "y.csv"),
        ("report", table, decision, "-o", tmp_path / "report.html"),
    ):
        done = command(*words)
        assert done.returncode in (0, 1), (words, done.stderr)
    assert closed == []
