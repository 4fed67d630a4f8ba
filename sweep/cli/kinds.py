"""What a file is, told from its content, and which command takes it: a file of the wrong kind is named for what it is.

Only what can be told for sure is refused here. A damaged file, or one that nobody knows, is left to its reader, which
can say more of it.
"""

from __future__ import annotations

import json
import os
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from .shared import WrongInput

LARGEST = 50_000_000
"""Bytes of text that are read to see what a file is."""

FOLDER, EMPTY = "a folder", "empty"
CAMPAIGN, FARM, SCENARIO = "a campaign", "the network of a farm", "a scenario"
GRID, FAMILY, PROFILE = "a grid", "a family of grids", "a profile of requirements"
TABLE, SURROGATE, JUDGED = "a table of admittances", "a surrogate", "the verdicts that judge wrote"
TUNING, VERIFICATION, METRICS = "what tune wrote", "what verify wrote", "what metrics wrote"
FARM_RESULT, FARM_IN_TIME = "what farm wrote", "what verify wrote of a farm"
PROBED, MANIFEST = "a grid that seqsweep grid found", "a manifest of injected perturbations"
PICTURE, PAGE, NOTEBOOK = "a picture", "a page (HTML)", "a notebook"
TEXT, RECORDING, MATRIX = "a text file", "a recording", "a MATLAB or HDF5 file"
TOUCHSTONE, WORKBOOK = "a Touchstone file", "a workbook"
DEVICE, MATPOWER = "a device or controller", "a MATPOWER case"

_OF_FORMAT = {
    "seqsweep-tuning": TUNING,
    "seqsweep-verification": VERIFICATION,
    "seqsweep-metrics": METRICS,
    "seqsweep-farm": FARM_RESULT,
    "seqsweep-farm-states": FARM_RESULT,
    "seqsweep-farm-verification": FARM_IN_TIME,
    "seqsweep-grid": PROBED,
    "seqsweep-manifest": MANIFEST,
    "seqsweep-judge": JUDGED,
}
_OF_SECTION = (
    ("family", FAMILY),
    ("element", GRID),
    ("region", GRID),
    ("bus", FARM),
    ("device", FARM),
    ("demand", PROFILE),
    ("campaign", CAMPAIGN),
    ("plant", CAMPAIGN),
    ("operating_point", CAMPAIGN),
    ("sweep", CAMPAIGN),
    ("event", SCENARIO),
)
"""Sections of TOML documents by the kind that they are of; the first that is there decides."""

_OF_SUFFIX = {
    **dict.fromkeys((".csv", ".tsv", ".txt", ".asc"), TEXT),
    **dict.fromkeys((".cfg", ".cff", ".dat", ".out", ".inf", ".tdms", ".mf4", ".mdf"), RECORDING),
    **dict.fromkeys((".mat", ".h5", ".hdf5"), MATRIX),
    **dict.fromkeys((".s1p", ".s2p", ".ts"), TOUCHSTONE),
    **dict.fromkeys((".xlsx", ".xlsm"), WORKBOOK),
    **dict.fromkeys((".fmu", ".so", ".dll", ".py"), DEVICE),
    **dict.fromkeys((".png", ".svg", ".pdf", ".jpg", ".jpeg"), PICTURE),
    **dict.fromkeys((".html", ".htm"), PAGE),
    ".ipynb": NOTEBOOK,
    ".m": MATPOWER,
}


class Need(NamedTuple):
    """What an argument or option of a command takes: in words, and the kinds; ``option`` is empty for an argument."""

    words: str
    kinds: frozenset[str]
    option: str = ""


_TABLES = frozenset({TABLE, SURROGATE})
_COLUMNS = frozenset({TEXT, RECORDING, MATRIX, TOUCHSTONE})
_A_CAMPAIGN = {"campaign": Need("a campaign", frozenset({CAMPAIGN}))}
_A_TABLE = {"table": Need("a table of admittances", _TABLES)}
_A_GRID = frozenset({GRID, PROBED, *_TABLES, *_COLUMNS})
_RESULTS = frozenset({TUNING, VERIFICATION, METRICS, FARM_RESULT, JUDGED})

NEEDS: dict[str, dict[str, Need]] = {
    "run": _A_CAMPAIGN,
    "plan": _A_CAMPAIGN,
    "inject": _A_CAMPAIGN,
    "grid": _A_CAMPAIGN,
    "check": {"plant": Need("a plant's id, a campaign or a device", frozenset({CAMPAIGN, DEVICE}))},
    "show": _A_TABLE,
    "tune": _A_TABLE | {"grid": Need("a grid", _A_GRID | {FOLDER, FAMILY}, "--grid")},
    "judge": _A_TABLE | {"grids": Need("a grid or a bank of grids", _A_GRID | {FOLDER, FAMILY}, "--grids")},
    "surrogate": _A_TABLE,
    "metrics": _A_TABLE | {"behind": Need("a grid", _A_GRID, "--behind")},
    "export": _A_TABLE,
    "validate": _A_TABLE,
    "compare": dict.fromkeys(("first", "second"), Need("two tables of admittances", _TABLES)),
    "merge": {"tables": Need("tables of admittances", _TABLES)},
    "farm": {"document": Need("the network of a farm", frozenset({FARM}))},
    "verify": {
        "tuning": Need("what tune wrote, or a farm", frozenset({TUNING, FARM})),
        "table": Need("a table of admittances", _TABLES, "--table"),
        "scenario": Need("a scenario", frozenset({SCENARIO}), "--scenario"),
    },
    "convert": {"source": Need("a network", frozenset({FARM, MATPOWER}))},
    "report": {
        "inputs": Need("a table of admittances and results about it", _TABLES | _RESULTS),
        "profile": Need("a profile of requirements", frozenset({PROFILE}), "--profile"),
    },
    "identify": {
        "files": Need("recordings", _COLUMNS | {FOLDER}),
        "manifest": Need("a manifest", frozenset({MANIFEST}), "--manifest"),
    },
    "import": {"file": Need("another tool's table", _COLUMNS | {WORKBOOK})},
}
"""What each command takes, by the name of its parameter."""


def refuse_others(command: str, given: Mapping[str, Any]) -> None:
    """Refuse every file among the values of a command that is of a kind it does not take.

    Raises
    ------
    WrongInput
        What the file is, what is needed, and which commands take it.
    """
    for name, need in NEEDS.get(command, {}).items():
        for path in _paths(given.get(name)):
            kind = kind_of(path)
            if kind is not None and kind not in need.kinds:
                asked = " ".join(filter(None, ("seqsweep", command, need.option)))
                raise WrongInput(f"{path} is {kind}, and {asked} needs {need.words}{_way_out(kind)}")


def _paths(value: Any) -> list[Path]:
    """The paths among a parameter's value; a text, which may be something else, counts where it is a file's name."""
    values = value if isinstance(value, Sequence) and not isinstance(value, str) else [value]
    return [Path(each) for each in values if isinstance(each, Path) or (isinstance(each, str) and os.path.isfile(each))]


def _way_out(kind: str) -> str:
    """The commands that take a kind, those first whose argument it is."""
    if kind in (FOLDER, EMPTY):
        return ""
    takers = sorted(dict.fromkeys(_takers(kind)), key=lambda taker: "--" in taker)[:3]
    if not takers:
        return "; no command reads it"
    listed = ", ".join(takers[:-1]) + (" and " if takers[1:] else "") + takers[-1]
    return f"; seqsweep {listed} take{'s' if len(takers) == 1 else ''} it"


def _takers(kind: str) -> Iterator[str]:
    for command, needs in NEEDS.items():
        for need in needs.values():
            if kind in need.kinds:
                yield f"{command} {need.option}".rstrip()


def kind_of(path: Path) -> str | None:
    """What a file is; None where it is not there, or cannot be told for sure."""
    try:
        if path.is_dir():
            return FOLDER
        if not path.is_file():
            return None
        return _kind_of_file(path)
    except (OSError, ValueError):  # a name that no file can have, a file that may not be read
        return None


def _kind_of_file(path: Path) -> str | None:
    with path.open("rb") as file:
        head = file.read(512)
    suffix = path.suffix.lower()
    if not head:
        return EMPTY
    if head[:4] == b"PAR1":
        return _kind_of_parquet(path)
    if head.startswith((b"\x89PNG", b"%PDF", b"\xff\xd8\xff")):
        return PICTURE
    if suffix == ".toml":
        return _kind_of_toml(_text(path))
    if suffix == ".json":
        return _kind_of_json(_text(path))
    if head.lstrip().lower().startswith((b"<!doctype html", b"<html")):
        return PAGE
    return _OF_SUFFIX.get(suffix)


def _text(path: Path) -> str:
    return path.read_text("utf-8-sig") if path.stat().st_size <= LARGEST else ""


def _kind_of_toml(text: str) -> str | None:
    try:
        content = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError):
        return None
    return next((kind for section, kind in _OF_SECTION if section in content), None)


def _kind_of_json(text: str) -> str | None:
    try:
        content = json.loads(text)
    except (json.JSONDecodeError, RecursionError):
        return None
    return _OF_FORMAT.get(str(content.get("format"))) if isinstance(content, dict) else None


def _kind_of_parquet(path: Path) -> str | None:
    """A table, a surrogate, or verdicts of a bank; None for another tool's Parquet, and for a damaged file."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        about = json.loads((pq.read_metadata(path).metadata or {}).get(b"seqsweep", b"null"))
    except (pa.ArrowException, json.JSONDecodeError, RecursionError):
        return None
    if not isinstance(about, dict):
        return None
    if about.get("format") == "seqsweep-admittance":
        return SURROGATE if about.get("surrogate") else TABLE
    return _OF_FORMAT.get(str(about.get("format")))
