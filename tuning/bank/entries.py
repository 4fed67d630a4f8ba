"""What a bank holds: files of a folder, tables in one Parquet file, or a family made from ranges.

An entry is small and not yet opened: a file that cannot be read costs its own row and nothing else.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...identify.table.format import FORMAT as TABLE_FORMAT
from ..grids.errors import GridError, NotAGrid, refuse_other_document, refuse_other_format
from ..grids.open import GRID_SUFFIXES, grid_of_document, open_file, read_document, source_voltage_of
from ..grids.promise import Grid
from ..grids.regions import RegionGrid, member_of
from ..grids.tables import ZTable, format_of_json, grid_of_table

MOST_MEMBERS = 100_000
"""Most grids that a family makes."""

_LISTED = 4  # sub-folders named in a remark

FAMILY_KEYS = ("name", "combine", "count", "seed")
RANGE_KEYS = ("from", "to", "steps", "spacing")


@dataclass(frozen=True, slots=True)
class BankEntry:
    """One grid of a bank, before it is opened.

    Attributes
    ----------
    grid_id : str
        Its name: the file's, the table's, or the values that the family gave it.
    file : str
        The file to open; empty where the content is here.
    document : mapping or None
        Elements, where a family made them.
    table : ZTable or None
        Rows, where a Parquet file held many.
    parameters : mapping
        What the family varied, by "element.key".
    problem : str
        Why it cannot be opened, where that is known already.
    """

    grid_id: str
    file: str = ""
    document: Mapping[str, Any] | None = None
    table: ZTable | None = None
    parameters: Mapping[str, Any] = field(default_factory=dict)
    problem: str = ""

    def source_voltage_pu(self, otherwise: float | None) -> float | None:
        """Voltage (pu of the device's rating) behind the grid: as its file says, else what stands for all grids."""
        own = source_voltage_of(self.file) if self.document is None else self.document.get("source_voltage_pu")
        return otherwise if own is None else float(own)

    def open(self, f1_hz: float) -> Grid | RegionGrid:
        """The grid.

        Raises
        ------
        SeqsweepError
            If it is none.
        """
        if self.problem:
            raise GridError(self.problem)
        if self.document is not None:
            return grid_of_document(self.document, f1_hz, self.grid_id, self.grid_id)
        if self.table is not None:
            return grid_of_table(self.table, f1_hz, self.grid_id)
        return open_file(self.file, f1_hz)


class Bank(NamedTuple):
    """What a folder or file holds.

    Attributes
    ----------
    entries : tuple of BankEntry
        Its grids, not yet opened.
    remarks : tuple of str
        What was left out, and what was taken for a grid that may be meant for something else.
    is_folder : bool
        Whether they are the files of a folder.
    """

    entries: tuple[BankEntry, ...]
    remarks: tuple[str, ...] = ()
    is_folder: bool = False


def bank_of(path: str | Path) -> tuple[BankEntry, ...]:
    """The entries of `read_bank`."""
    return read_bank(path).entries


def read_bank(path: str | Path, device: Path | None = None) -> Bank:
    """The grids of a folder, of one file with many grids, or of a single grid's file.

    Parameters
    ----------
    path : path
        Folder or file.
    device : path or None
        The table of the device that is to be judged: in a folder of grids it is no grid.

    Raises
    ------
    GridError
        If there is none.
    """
    path = Path(path)
    if not path.exists():
        raise GridError(f"{path}: no such file or folder; one R + jX is judged by tune --grid")
    bank = _of_folder(path, device) if path.is_dir() else Bank(_of_file(path, str(path)))
    if not bank.entries:
        others = "".join(f"; {remark}" for remark in bank.remarks)
        raise GridError(f"{path}: the bank is empty{others}; a grid has one of the suffixes {', '.join(GRID_SUFFIXES)}")
    return bank._replace(entries=_named_once(bank.entries))


def check_single(bank: Bank, f1_hz: float, belongs: Callable[[Grid], None] = lambda grid: None) -> None:
    """Refuse a grid that was named by itself and is none: a wrong call, not one bad file of many.

    ``belongs`` refuses one that cannot be the device's.

    Raises
    ------
    SeqsweepError
        With what is wrong with it.
    """
    if len(bank.entries) == 1 and not bank.is_folder:
        belongs(member_of(bank.entries[0].open(f1_hz)))


def _of_file(path: Path, place: str) -> tuple[BankEntry, ...]:
    """The grids of a file, named as they are in it; messages begin with ``place``."""
    if path.suffix.lower() == ".parquet":
        return tuple(_of_parquet(path))
    if path.suffix.lower() == ".toml":
        document = read_document(path)
        refuse_other_document(document, place)
        if "family" in document:
            return tuple(family(document, place))
    if path.suffix.lower() == ".json":
        refuse_other_format(format_of_json(path), place)
    return (BankEntry(path.name, str(path)),)


def _of_folder(path: Path, device: Path | None) -> Bank:
    """Every file of a known suffix; a family or a Parquet file stands for its members."""
    entries: list[BankEntry] = []
    inside = sorted(path.iterdir())
    remarks = _sub_folders([each.name for each in inside if each.is_dir() and not each.name.startswith(".")])
    for file in (each for each in inside if each.is_file() and each.suffix.lower() in GRID_SUFFIXES):
        name = file.name
        if device is not None and file.samefile(device):
            remarks.append(f"{name} is the device's own table and was left out")
            continue
        try:
            found = _of_file(file, name)
        except NotAGrid as error:
            remarks.append(f"left out: {error}")
        except GridError as error:
            entries.append(BankEntry(name, str(file), problem=str(error)))
        else:
            if len(found) == 1 and found[0].grid_id == name:
                entries.append(found[0])
                continue
            entries += [replace(entry, grid_id=f"{name}#{entry.grid_id}") for entry in found]
            remarks += _taken_for_sources(name, found)
    return Bank(tuple(entries), tuple(remarks), is_folder=True)


def _sub_folders(names: Sequence[str]) -> list[str]:
    """A word on folders within the folder, which are banks of their own: a bank is no tree of everything below it."""
    if not names:
        return []
    what = "a sub-folder" if len(names) == 1 else f"{len(names)} sub-folders"
    shown = ", ".join(names[:_LISTED]) + (", ..." if len(names) > _LISTED else "")
    return [f"left out: {what} ({shown}): a bank is one folder; name a sub-folder as --grids to judge it"]


def _taken_for_sources(name: str, found: Sequence[BankEntry]) -> list[str]:
    """A word on a table of devices, whose operating points are grids where they are given as such."""
    if not found or not all("#" in entry.file for entry in found):
        return []
    n = len(found)
    taken = "its operating point was taken for a measured source" if n == 1 else ""
    taken = taken or f"its {n} operating points were taken for measured sources"
    return [f"{name} is a table of seqsweep: {taken}, to stand on as a grid"]


def _named_once(entries: Sequence[BankEntry]) -> tuple[BankEntry, ...]:
    names = [entry.grid_id for entry in entries]
    if len(set(names)) == len(names):
        return tuple(entries)
    twice = next(name for name in names if names.count(name) > 1)
    raise GridError(f"two grids of the bank are called {twice!r}")


# One Parquet file ----------------------------------------------------------------------------------------------------


def _of_parquet(path: Path) -> Iterator[BankEntry]:
    """Operating points of a table of ours, or one table of Z(f) for each ``grid_id``."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        table = pq.read_table(path)
    except (pa.ArrowException, OSError) as error:
        raise GridError(f"{path}: not a Parquet file: {error}") from None
    names = set(table.column_names)
    refuse_other_format(_format_of(table.schema.metadata), str(path))
    if {"op_id", "y_pp_re"} <= names:
        for op_id in dict.fromkeys(table.column("op_id").to_pylist()):
            yield BankEntry(str(op_id), f"{path}#{op_id}")
        return
    needed = ("grid_id", "f_hz", "r_ohm", "x_ohm")
    if not set(needed) <= names:
        raise GridError(f"{path}: columns {', '.join(sorted(names))[:200]}; a bank has {', '.join(needed)} (std_ohm)")
    ids = np.array([str(value) for value in table.column("grid_id").to_pylist()])
    f, r, x = (np.asarray(table.column(name).to_pylist(), dtype=float) for name in needed[1:])
    std = np.asarray(table.column("std_ohm").to_pylist(), dtype=float) if "std_ohm" in names else None
    for grid_id in dict.fromkeys(ids.tolist()):
        at = ids == grid_id
        yield BankEntry(grid_id, table=ZTable(f[at], r[at] + 1j * x[at], None if std is None else std[at]))


def _format_of(metadata: Mapping[bytes, bytes] | None) -> Any:
    """The format that a Parquet file of ours says in its metadata; ours that hold a device are no matter here."""
    try:
        about = json.loads((metadata or {}).get(b"seqsweep", b"{}"))
    except ValueError:
        return None
    name = about.get("format") if isinstance(about, Mapping) else None
    return None if name == TABLE_FORMAT else name


# A family ------------------------------------------------------------------------------------------------------------


def family(document: Mapping[str, Any], place: str) -> Iterator[BankEntry]:
    """Members of a family: every value of an element that is a list or a range is varied.

    ``[family]`` says how: ``combine = "all"`` every combination, ``"random"`` so many of them (``count``, ``seed``),
    each value drawn by itself, from a range evenly.

    Raises
    ------
    GridError
        If a range cannot be read, or nothing is varied.
    """
    rules = document["family"]
    if not isinstance(rules, Mapping):
        raise GridError(f"{place}: [family] is a table of keys: {', '.join(FAMILY_KEYS)}")
    unknown = [key for key in rules if key not in FAMILY_KEYS]
    if unknown:
        raise GridError(f"{place}: [family] has {', '.join(FAMILY_KEYS)}; {unknown[0]!r} is not known")
    base = {key: value for key, value in document.items() if key != "family"}
    varied = list(_varied(base, place))
    if not varied:
        raise GridError(f"{place}: nothing is varied; give an element's value as a list, or as from, to and steps")
    combine = rules.get("combine", "all")
    if combine == "all":
        choices: Any = itertools.product(*(values for *_, values in varied))
        count = int(np.prod([len(values) for *_, values in varied]))
    elif combine == "random":
        count = _whole(rules.get("count", 100), f"{place}: [family] count")
        choices = _drawn(base, varied, count, _whole(rules.get("seed", 1), f"{place}: [family] seed"))
    else:
        raise GridError(f"{place}: combine = {combine!r}; known are 'all' and 'random'")
    if not 0 < count <= MOST_MEMBERS:
        raise GridError(f"{place}: {count} grids; a family has 1 to {MOST_MEMBERS}")
    for number, chosen in enumerate(choices, start=1):
        yield _member(base, varied, chosen, number)


def _varied(base: Mapping[str, Any], place: str) -> Iterator[tuple[int, str, str, list[Any]]]:
    """(number of the element, its name, key, values) of everything that is varied."""
    counts: dict[str, int] = {}
    entries = base.get("element", ())
    if not isinstance(entries, list) or not all(isinstance(entry, Mapping) for entry in entries):
        raise GridError(f"{place}: needed is a list of [[element]]")
    for k, entry in enumerate(entries):
        kind = str(entry.get("kind"))
        counts[kind] = counts.get(kind, 0) + 1
        name = str(entry.get("name", f"{kind}{counts[kind]}"))
        for key, value in entry.items():
            if isinstance(value, list):
                if not value:
                    raise GridError(f"{place}: {name}.{key}: an empty list")
                yield k, name, key, value
            elif isinstance(value, Mapping):
                yield k, name, key, _range(value, f"{place}: {name}.{key}")


def _range(value: Mapping[str, Any], place: str) -> list[float]:
    """Values from ``from`` to ``to`` in ``steps``, evenly or by equal ratios (spacing = "log")."""
    unknown = [key for key in value if key not in RANGE_KEYS]
    if unknown or "from" not in value or "to" not in value:
        raise GridError(f"{place}: a range has from, to, steps and spacing ('linear' or 'log')")
    low, high = _real(value["from"], f"{place}.from"), _real(value["to"], f"{place}.to")
    steps = _whole(value.get("steps", 5), f"{place}.steps")
    if steps < 1 or value.get("spacing", "linear") not in ("linear", "log"):
        raise GridError(f"{place}: steps = {steps}, spacing = {value.get('spacing')!r}")
    if value.get("spacing") == "log":
        if not low > 0.0:
            raise GridError(f"{place}: a logarithmic range begins above 0")
        return [float(x) for x in np.geomspace(low, high, steps)]
    return [float(x) for x in np.linspace(low, high, steps)]


def _whole(value: Any, place: str) -> int:
    """A whole number, not negative."""
    if not isinstance(value, int) or isinstance(value, bool) or value < 0:
        raise GridError(f"{place} = {value!r}; needed is a whole number")
    return value


def _real(value: Any, place: str) -> float:
    """A finite number."""
    if not isinstance(value, int | float) or isinstance(value, bool) or not np.isfinite(value):
        raise GridError(f"{place} = {value!r}; needed is a number")
    return float(value)


def _drawn(
    base: Mapping[str, Any], varied: Sequence[tuple[int, str, str, list[Any]]], count: int, seed: int
) -> Iterator[tuple[Any, ...]]:
    """Random values: anywhere in a range, any of a list."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        chosen = []
        for k, _name, key, values in varied:
            given = base["element"][k][key]
            if isinstance(given, Mapping) and given.get("spacing") == "log":
                chosen.append(float(np.exp(rng.uniform(np.log(values[0]), np.log(values[-1])))))
            elif isinstance(given, Mapping):
                chosen.append(float(rng.uniform(values[0], values[-1])))
            else:
                chosen.append(values[int(rng.integers(len(values)))])
        yield tuple(chosen)


def _member(
    base: Mapping[str, Any], varied: Sequence[tuple[int, str, str, list[Any]]], chosen: Sequence[Any], number: int
) -> BankEntry:
    entries = [dict(entry) for entry in base["element"]]
    parameters = {}
    for (k, name, key, _values), value in zip(varied, chosen, strict=True):
        entries[k][key] = value
        parameters[f"{name}.{key}"] = value
    document = {**base, "element": entries}
    return BankEntry(f"{number:05d}", document=document, parameters=parameters)
