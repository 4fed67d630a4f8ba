"""The notebooks of the examples, run from the first cell to the last, for `docs/notebooks`.

What a notebook gave is kept in ``build/docs`` until it or the program changes. Without ``seqsweep_run`` (the
configuration value of the quick build) notebooks that are not kept are shown without their outputs.
"""

from __future__ import annotations

import hashlib
import shutil
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from executed import CLONE, DOCS, KEPT, TOP, program_digest

SOURCES = TOP / "examples" / "notebooks"
PLACE = DOCS / "notebooks"
MOST_S = 180


def bring(run: bool) -> None:
    """Every notebook in `PLACE`, with its outputs where they are kept or ``run`` says so."""
    PLACE.mkdir(exist_ok=True)
    program = program_digest()
    with ThreadPoolExecutor(2) as pool:
        list(pool.map(lambda path: _bring(path, program, run), sorted(SOURCES.glob("*.ipynb"))))


def _bring(path: Path, program: str, run: bool) -> None:
    key = hashlib.sha256(program.encode() + path.read_bytes()).hexdigest()[:24]
    kept = KEPT / f"{key}.ipynb"
    if run and not kept.exists():
        KEPT.mkdir(parents=True, exist_ok=True)
        kept.write_text(executed(path), "utf-8")
    source, place = (kept if kept.exists() else path).read_text("utf-8"), PLACE / path.name
    if not place.exists() or place.read_text("utf-8") != source:
        place.write_text(source, "utf-8")


def executed(path: Path) -> str:
    """A notebook with the outputs of a run in a copy of what a clone has."""
    import nbformat
    from nbclient import NotebookClient

    book = nbformat.read(path, 4)
    with tempfile.TemporaryDirectory() as folder:
        for name in CLONE:
            shutil.copytree(TOP / name, Path(folder) / name, ignore=shutil.ignore_patterns("__pycache__"))
        there = {"metadata": {"path": str(Path(folder) / "examples" / "notebooks")}}
        kernel = {"kernel_name": "python3", "startup_timeout": MOST_S, "extra_arguments": ["--log-level=ERROR"]}
        NotebookClient(book, timeout=MOST_S, resources=there, **kernel).execute()
    _without_progress(book)
    text: str = nbformat.writes(book)
    return text


def _without_progress(book: object) -> None:
    """Outputs that a reader of a page has no use for: what went to standard error, and times of execution."""
    for cell in book.cells:  # type: ignore[attr-defined]
        cell.metadata.pop("execution", None)
        if cell.cell_type == "code":
            cell.outputs = [o for o in cell.outputs if not (o.output_type == "stream" and o.name == "stderr")]
