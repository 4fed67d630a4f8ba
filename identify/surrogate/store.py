"""A surrogate on disk: the table it was built from, with the chosen products in the metadata.

The rows say everything else; reading fits the coefficients again, which takes milliseconds. Every reader of tables can
read the file, and sees the sweeps.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..response import FrequencyResponse
from ..table.read import Table, read_table
from ..table.write import write_table
from .jumps import Border, Cut
from .region import LEAST_SWEEPS, Region, hulled, parameters_of, points_of
from .sparse_rational import Shape
from .surrogate import Chosen, Surrogate, SurrogateError, build_surrogate

FAR = 10.0
"""In multiples of the rating: beyond, a power or a voltage is in another unit."""

BESIDE = 0.2
"""Relative: so far from the rating in kV a terminal voltage that is meant in kV may stand."""

_NAMED = 4  # operating points that are named, of those that are left out


def write_surrogate(path: str | Path, surrogate: Surrogate, table: Table) -> None:
    """Write ``surrogate``, built from ``table``, atomically.

    Raises
    ------
    OSError
        If the machine refuses.
    """
    pieces = [[_plain(model.shape) for model in piece.models] for piece in surrogate.pieces]
    border = None if surrogate.border is None else [cut._asdict() for cut in surrogate.border.cuts]
    write_table(path, table.responses, {**table.meta, "surrogate": {"border": border, "pieces": pieces}})


def read_surrogate(path: str | Path) -> Surrogate:
    """The surrogate of a file, or of a table, for which the products are chosen now.

    Raises
    ------
    TableError
        If the file is no table.
    SurrogateError
        If no surrogate can be built from it.
    """
    return surrogate_of(read_table(path))


def surrogate_of(table: Table) -> Surrogate:
    """The surrogate of a table that was read; with the products that stand in its metadata, if any.

    Raises
    ------
    SurrogateError
        If no surrogate can be built from it.
    """
    _check_units(table)
    usable = [response for response in table.responses if response.usable.any()]
    lost = left_out(table)
    if len(usable) < LEAST_SWEEPS and lost:
        raise SurrogateError(
            f"{len(usable)} operating points have usable rows, a surrogate needs {LEAST_SWEEPS}; {lost}: sweep where "
            "the device works"
        )
    chosen = _chosen(table.meta.get("surrogate"))
    return build_surrogate(usable, chosen=chosen, region=_region_of(table, usable), bases=table.meta.get("bases"))


def left_out(table: Table) -> str:
    """Operating points that a surrogate does without, for lack of a usable row, and why; empty where there are none."""
    lost = [response for response in table.responses if not response.usable.any()]
    if not lost:
        return ""
    names = ", ".join(str(response.meta.get("op_id")) for response in lost[:_NAMED])
    more = f" and {len(lost) - _NAMED} more" if len(lost) > _NAMED else ""
    return f"{names}{more} without a usable row ({lost[0].why_lost})"


def voltages_in_kv(table: Table) -> str:
    """What speaks for terminal voltages in kV instead of pu: all stand about the rating in kV, none about 1 pu.

    They are not refused: a device of 690 V that was swept through deep dips may really have stood at 0.69 pu.
    """
    rated_kv = (table.meta.get("bases") or {}).get("rated_voltage_v", 0.0) / 1e3
    found = [v for v in (response.meta.get("terminal_voltage_pu") for response in table.responses) if v]
    if not found or not rated_kv or not all(abs(v / rated_kv - 1.0) <= BESIDE < abs(v - 1.0) for v in found):
        return ""
    return (
        f"terminal_voltage_pu is {min(found):g} to {max(found):g} on a device of {rated_kv:g} kV: is it in kV? "
        "Per unit is of the rated voltage"
    )


def _region_of(table: Table, usable: Sequence[FrequencyResponse]) -> Region:
    """The box that a campaign chose its points in, or the convex hull of points that were listed."""
    parameters = parameters_of(usable)
    points = points_of(usable, parameters)
    box = Region(points.min(axis=0), points.max(axis=0), parameters)
    return box if "region" in table.meta else hulled(points, box)


def _check_units(table: Table) -> None:
    """Refuse operating points that are far from the device's rating: kW for MW, V for pu."""
    rated_mva = (table.meta.get("bases") or {}).get("rated_power_va", 0.0) / 1e6
    for response in table.responses:
        name = response.meta.get("op_id")
        for axis, unit in (("active_power_mw", "kW"), ("reactive_power_mvar", "kvar")):
            power = response.meta.get(axis)
            if rated_mva and power and abs(power) > FAR * rated_mva:
                raise SurrogateError(f"{name}: {axis} = {power:g} on a device of {rated_mva:g} MVA: is it in {unit}?")
        voltage = response.meta.get("terminal_voltage_pu")
        if voltage is not None and not 1.0 / FAR < voltage < FAR:
            raise SurrogateError(f"{name}: terminal_voltage_pu = {voltage:g}: is it in V? Per unit is of the rating")


def _plain(shape: Shape) -> dict[str, Any]:
    return {key: [list(index) for index in indices] for key, indices in shape._asdict().items()}


def _chosen(stored: Any) -> Chosen | None:
    if not stored:
        return None
    if isinstance(stored, list):  # as it was written before borders were known
        stored = {"border": None, "pieces": [stored]}
    border = None if stored["border"] is None else Border(tuple(Cut(**cut) for cut in stored["border"]))
    return Chosen(border, tuple(tuple(map(_shape, piece)) for piece in stored["pieces"]))


def _shape(stored: Mapping[str, Sequence[Sequence[int]]]) -> Shape:
    return Shape(tuple(map(tuple, stored["numerator"])), tuple(map(tuple, stored["denominator"])))
