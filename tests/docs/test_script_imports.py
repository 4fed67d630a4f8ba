"""Benchmarks and examples import late, where nobody sees a name that has moved: every such name is looked up here."""

import ast
from collections.abc import Iterator
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SCRIPTS = sorted(path for folder in ("benchmarks", "examples") for path in (ROOT / folder).rglob("*.py"))


def imported(tree: ast.AST) -> Iterator[tuple[str, str, str]]:
    """(module, name there, name here) of what is imported from the program, at any depth."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith(("seqsweep.", "tests.")):
            yield from ((node.module, alias.name, alias.asname or alias.name) for alias in node.names)


def tops(tree: ast.AST) -> Iterator[str]:
    """Packages and modules that are imported whole or in part, at any depth."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name.partition(".")[0] for alias in node.names)
        if isinstance(node, ast.ImportFrom) and node.module and not node.level:
            yield node.module.partition(".")[0]


def found(module: str, name: str) -> object:
    there = import_module(module)
    return getattr(there, name) if hasattr(there, name) else import_module(f"{module}.{name}")


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_what_a_script_imports_is_there_and_what_it_calls_can_be_called(script):
    tree = ast.parse(script.read_text("utf-8"))
    called = {node.func.id for node in ast.walk(tree) if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)}
    for module, name, here in imported(tree):
        assert callable(found(module, name)) or here not in called, f"{module} has no function {name}"


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_every_module_that_a_script_imports_can_be_found(script):
    folders = (*script.parents, ROOT / "tests" / "support")
    beside = {path.stem for folder in folders if folder.is_relative_to(ROOT) for path in folder.glob("*")}
    missing = {top for top in tops(ast.parse(script.read_text("utf-8"))) if top not in beside and not find_spec(top)}
    assert missing <= {"dpsimpy", "dpsim"}, f"{script} imports {missing}"
