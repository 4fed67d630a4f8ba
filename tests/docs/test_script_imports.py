"""Benchmarks and examples import late, where nobody sees a name that has moved: every such name is looked up here."""

import ast
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SCRIPTS = sorted(path for folder in ("benchmarks", "examples") for path in (ROOT / folder).rglob("*.py"))


def imported(tree: ast.AST) -> Iterator[tuple[str, str, str]]:
    """(module, name there, name here) of what is imported from the program, at any depth."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] == "seqsweep":
            yield from ((node.module, alias.name, alias.asname or alias.name) for alias in node.names)


def found(module: str, name: str) -> object:
    there = import_module(module)
    return getattr(there, name) if hasattr(there, name) else import_module(f"{module}.{name}")


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_what_a_script_imports_is_there_and_what_it_calls_can_be_called(script):
    tree = ast.parse(script.read_text("utf-8"))
    called = {node.func.id for node in ast.walk(tree) if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)}
    for module, name, here in imported(tree):
        assert callable(found(module, name)) or here not in called, f"{module} has no function {name}"
