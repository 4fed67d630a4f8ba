"""Files with a table of Z(f): text of any layout, Touchstone one-ports, MATLAB, and what `seqsweep grid` writes."""

from __future__ import annotations

import io
import json
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...plant.errors import place_of
from .columns import Heading, frequency_of, heading_of, impedance_of
from .errors import GridError, naming, refuse_other_format
from .passivity import checked_passive, refuse_turned
from .rational import RationalGrid
from .scalar_fit import MIN_ROWS, fit_impedance

TEXT_SUFFIXES = (".csv", ".txt", ".dat", ".tsv", ".asc")

ACCEPTED_MISFIT = 0.03
"""Root mean square misfit beyond which a rational function is said not to describe a table."""

_CLOSE = 1e-9  # rows whose frequencies differ by less are one


class ZTable(NamedTuple):
    """Z(f) as a file has it.

    Attributes
    ----------
    f_hz : (n,) float
        Frequencies above zero, ascending (Hz).
    z : (n,) complex
        Impedance (ohm).
    std : (n,) float or None
        Standard deviation of the complex z (ohm).
    notes : tuple of str
        What was decided on reading.
    """

    f_hz: np.ndarray
    z: np.ndarray
    std: np.ndarray | None = None
    notes: tuple[str, ...] = ()


def table_grid(path: str | Path, f1_hz: float, op_id: str | None = None) -> RationalGrid:
    """The grid of a file with a table of Z(f); ``op_id`` says which of several that `seqsweep grid` measured.

    Raises
    ------
    GridError
        If the file holds no such table, or no rational function describes it, or it is not passive.
    """
    path = Path(path)
    table = read_table_of_z(path, f1_hz, op_id)
    return grid_of_table(table, f1_hz, path.name)


def grid_of_table(table: ZTable, f1_hz: float, name: str) -> RationalGrid:
    """The grid of a table that was read."""
    table = _ordered(table, name)
    grid = fit_impedance(table.f_hz, table.z, f1_hz, std=table.std, name=name)
    allowed = ACCEPTED_MISFIT if table.std is None else max(ACCEPTED_MISFIT, 2.0 * _relative(table))
    if grid.misfit > allowed:
        refuse_turned(name, table.f_hz, table.z, table.std)
        raise GridError(
            f"{name}: no rational function of {len(table.f_hz)} rows describes Z(f) (misfit {grid.misfit:.0%}): rows "
            "are too far apart for its resonances, or some are wrong"
        )
    return checked_passive(grid, table.f_hz, table.z, table.std, table.notes)


def read_table_of_z(path: Path, f1_hz: float, op_id: str | None = None) -> ZTable:
    """Read a file by its suffix.

    Raises
    ------
    GridError
        With what is in the way.
    """
    suffix = path.suffix.lower()
    if not path.is_file():
        raise GridError(f"{path}: no such file")
    if suffix in TEXT_SUFFIXES:
        return _of_text(path, f1_hz)
    if suffix == ".mat":
        return _of_mat(path, f1_hz)
    if suffix == ".json":
        return _of_probe(path, op_id)
    if suffix.startswith(".s") and suffix.endswith("p") and suffix[2:-1].isdigit():
        return _of_touchstone(path)
    known = ", ".join((*TEXT_SUFFIXES, ".s1p", ".mat", ".json", ".toml", ".parquet"))
    raise GridError(f"{path}: a grid has one of the suffixes {known}")


# Text ----------------------------------------------------------------------------------------------------------------


def _of_text(path: Path, f1_hz: float) -> ZTable:
    from ...plant.foreign.cells import split
    from ...plant.foreign.layout import layout_of

    layout = layout_of(path)
    width = len(layout.kinds)
    lines = path.read_bytes().decode(layout.mending.encoding, "replace").lstrip("\ufeff").splitlines()
    rows = [split(line, layout.delimiter) for line in lines[layout.skip_rows :] if line.strip()]
    cells = [[_number(path, cell, layout.decimal) for cell in row] for row in rows if len(row) == width]
    columns = list(np.array(cells, dtype=complex).T)
    headings = _headings(path, layout, columns)
    return _of_columns(headings, columns, f1_hz, str(path), layout.notes)


def _headings(path: Path, layout: Any, columns: list[np.ndarray]) -> list[Heading]:
    if layout.names is not None:
        units = layout.units or ("",) * len(layout.names)
        texts = [f"{n} [{u.strip('()[] ')}]" if u else n for n, u in zip(layout.names, units, strict=True)]
        return [heading_of(text) for text in texts]
    if len(columns) == 2 and np.any(columns[1].imag != 0.0):
        return [Heading("f", "", "hz"), Heading("z", "", "ohm")]
    raise GridError(
        f"{path}: {len(columns)} columns without headings; needed is a line above such as f [Hz], R [ohm], X [ohm], or "
        "two columns: f in Hz, and complex numbers in ohm"
    )


def _number(path: Path, cell: str, decimal: str) -> complex:
    text = cell.strip().strip("()").replace(" ", "").replace("+-", "-").replace("i", "j")
    text = text.replace("D", "E").replace("*", "")
    if decimal == ",":
        text = text.replace(",", ".")
    try:
        return complex(text) if text else complex(np.nan)
    except ValueError:
        raise GridError(f"{path}: {cell[:40]!r} is not a number") from None


def _of_columns(
    headings: list[Heading], columns: list[np.ndarray], f1_hz: float, place: str, notes: tuple[str, ...]
) -> ZTable:
    at = [k for k, heading in enumerate(headings) if heading.what == "f"]
    if len(at) != 1:
        raise GridError(
            f"{place}: {len(at)} columns of frequencies; needed is one, named f, frequency or harmonic order"
        )
    with naming(place):
        f_hz = frequency_of(headings[at[0]], columns[at[0]].real, f1_hz)
        z, note = impedance_of(headings, columns, place)
    stds = [k for k, heading in enumerate(headings) if heading.what == "std" and heading.sequence in ("", "positive")]
    std = columns[stds[0]].real if stds else None
    return ZTable(f_hz, z, std, (*notes, *([note] if note else [])))


# Other formats -------------------------------------------------------------------------------------------------------


def _of_touchstone(path: Path) -> ZTable:
    """A one-port of S- or Z-parameters, through scikit-rf."""
    from ...identify.exchange.facts import extra

    skrf = extra("skrf", "scikit-rf")
    stream = io.StringIO(path.read_bytes().decode("latin-1"))  # a file of its own it leaves open where its parser fails
    stream.name = path.name.lower()
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            network = skrf.Network(stream)
    except Exception as error:  # it raises whatever its parser met
        raise GridError(
            f"{path}: no Touchstone file of one port, which has three numbers a row: the frequency and two of S11 "
            f"(scikit-rf: {str(error)[:200]})"
        ) from None
    if network.nports != 1:
        raise GridError(
            f"{path} has {network.nports} ports; a grid seen from the PCC has one. Close the other ports, or give the "
            "2x2 admittance of the sequences with seqsweep import"
        )
    return ZTable(np.asarray(network.f, dtype=float), np.asarray(network.z[:, 0, 0]), None)


def _of_mat(path: Path, f1_hz: float) -> ZTable:
    """Vectors under names such as f and Z, or R and X."""
    from ...identify.exchange.mat import variables_of

    vectors = {
        name: np.asarray(value).ravel().astype(complex)
        for name, value in variables_of(path).items()
        if isinstance(value, np.ndarray) and value.dtype.kind in "fciu" and value.size >= MIN_ROWS
    }
    length = max((len(v) for v in vectors.values()), default=0)
    vectors = {name: v for name, v in vectors.items() if len(v) == length}
    if not vectors:
        raise GridError(f"{path}: no vectors of {MIN_ROWS} numbers or more; needed are f and Z, or f, R and X")
    return _of_columns([heading_of(name) for name in vectors], list(vectors.values()), f1_hz, str(path), ())


def format_of_json(path: Path) -> Any:
    """The format that a JSON file says it has; None where it says none, or is no JSON."""
    try:
        content = json.loads(path.read_text("utf-8"))
    except (ValueError, RecursionError):
        return None
    return content.get("format") if isinstance(content, Mapping) else None


def _of_probe(path: Path, op_id: str | None) -> ZTable:
    """The lines that `seqsweep grid -o` wrote, of the operating point, or of the first that has them."""
    refuse_other_format(format_of_json(path), str(path))
    try:
        content: Mapping[str, Any] = json.loads(path.read_text("utf-8"))
        points = {str(p.get("op_id")): p["lines"] for p in content["operating_points"] if p.get("lines")}
        chosen = next(iter(points)) if op_id is None else op_id
        place_of(chosen, list(points), str(path), GridError)
        lines = points[chosen]
        f, r, x, std = (
            np.array([line[key] for line in lines], dtype=float) for key in ("f_hz", "r_ohm", "x_ohm", "z_std_ohm")
        )
    except GridError:
        raise
    except (ValueError, KeyError, StopIteration, TypeError, AttributeError):
        raise GridError(f"{path}: not what `seqsweep grid -o` writes: no lines of an operating point") from None
    z = np.where(f < 0.0, r - 1j * x, r + 1j * x)  # z(-f) is the conjugate of z(f)
    note = f"{path.name} holds the grids of {', '.join(points)}: taken was {chosen}; {path.name}#ID takes another"
    f, z, std = _merged(np.abs(f), z, std)
    return ZTable(f, z, std, (note,) if op_id is None and len(points) > 1 else ())


def _merged(f: np.ndarray, z: np.ndarray, std: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lines at f and at -f say the same: their mean, weighted by what is known of each."""
    unique, place = np.unique(np.round(f, 9), return_inverse=True)
    weight = 1.0 / np.maximum(std, 1e-12 * np.abs(z)) ** 2
    total = np.bincount(place, weight)
    mean = (np.bincount(place, weight * z.real) + 1j * np.bincount(place, weight * z.imag)) / total
    return unique, mean, 1.0 / np.sqrt(total)


# Rows ----------------------------------------------------------------------------------------------------------------


def _ordered(table: ZTable, name: str) -> ZTable:
    """Rows above zero frequency, finite, ascending, each once.

    Raises
    ------
    GridError
        If two rows of one frequency contradict each other, or too few are left.
    """
    good = np.isfinite(table.z) & np.isfinite(table.f_hz) & (table.f_hz > 0.0) & (np.abs(table.z) > 0.0)
    f, z = table.f_hz[good], table.z[good]
    std = None if table.std is None else table.std[good]
    order = np.argsort(f, kind="stable")
    f, z, std = f[order], z[order], None if std is None else std[order]
    again = np.flatnonzero(np.diff(f) <= _CLOSE * f[1:]) if len(f) else np.zeros(0, dtype=int)
    apart = again[np.abs(z[again + 1] - z[again]) > 1e-3 * np.abs(z[again])]
    if len(apart):
        raise GridError(
            f"{name}: two rows at {f[apart[0]]:.6g} Hz contradict each other ({z[apart[0]]:.4g} and "
            f"{z[apart[0] + 1]:.4g} ohm): keep one"
        )
    once = np.setdiff1d(np.arange(len(f)), again + 1)
    notes = table.notes
    if len(again):
        notes = (*notes, _twice(len(again)))
    if (lost := int(np.sum(~good))) > 0:
        rows = "one row" if lost == 1 else f"{lost} rows"
        notes = (*notes, f"left out: {rows} without a finite impedance, or not above 0 Hz")
    if len(once) < MIN_ROWS:
        rows = "one usable row" if len(once) == 1 else f"{len(once)} usable rows"
        raise GridError(f"{name}: {rows}; a table of Z(f) needs at least {MIN_ROWS}")
    return ZTable(f[once], z[once], None if std is None else std[once], notes)


def _relative(table: ZTable) -> float:
    return 0.0 if table.std is None else float(np.sqrt(np.mean((table.std / np.abs(table.z)) ** 2)))


def _twice(n: int) -> str:
    return "one row was there twice and counts once" if n == 1 else f"{n} rows were there twice and count once"
