"""One device on one grid of a bank: a row of the report."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ...identify.fit.rational import RationalModel
from ...plant.errors import SeqsweepError
from ..grid_check import check_belongs, grid_warnings
from ..grids.exclusion import critical_growth, exclusion
from ..grids.promise import Grid
from ..grids.regions import RegionGrid, member_of
from ..poles import ClosedLoop
from ..tune import Device
from ..verdict import Stability, judge
from .edges import ElementEdge, element_edges, scale_at_the_edge
from .entries import BankEntry


@dataclass(frozen=True, slots=True)
class PairVerdict:
    """One operating point on one grid.

    Attributes
    ----------
    grid_id, op_id : str
        Which grid, which operating point.
    status : str
        "ok", or "failed" where the grid could not be read or judged.
    verdict, reason : str
        "stable", "unstable" or "undecided", and why.
    probability : float or None
        Probability of being stable.
    grid : str
        The grid in one line.
    r_ohm, x_ohm : float or None
        Its impedance at the fundamental (ohm).
    n_unstable : int or None
        Unstable closed-loop modes, conjugates counted.
    margin_m : float or None
        m of the critical crossing.
    re_rad_s, im_rad_s, re_std_rad_s, damping : float or None
        The deciding mode (dq frame): pole, standard error of its real part, damping ratio.
    critical_scale : float or None
        Multiplier of the whole impedance at the edge.
    elements : tuple of ElementEdge
        Critical value of each element, where the grid has any and they were asked for.
    region_distance : float or None
        Of a region: least distance of zero from the values of det(1 + Y Z) over all its members; 1 for no grid.
    region_growth : float or None
        Of a region: multiple of its extent about the member at which it is no longer decided; None beyond reach.
    missing_hz : (float, float) or None
        Band of f that was to be measured of the grid.
    parameters : mapping
        What the family varied.
    warnings : tuple of str
        What the reader should know.
    """

    grid_id: str
    op_id: str
    status: str = "ok"
    verdict: str = "undecided"
    reason: str = ""
    probability: float | None = None
    grid: str = ""
    r_ohm: float | None = None
    x_ohm: float | None = None
    n_unstable: int | None = None
    margin_m: float | None = None
    re_rad_s: float | None = None
    im_rad_s: float | None = None
    re_std_rad_s: float | None = None
    damping: float | None = None
    critical_scale: float | None = None
    elements: tuple[ElementEdge, ...] = ()
    region_distance: float | None = None
    region_growth: float | None = None
    missing_hz: tuple[float, float] | None = None
    parameters: Mapping[str, Any] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()


def judge_pair(device: Device, entry: BankEntry, bases: Mapping[str, Any], *, elements: bool = False) -> PairVerdict:
    """The verdict of one device on one grid. A grid that cannot be read makes a row that says so.

    ``bases`` is the device's rating; ``elements`` also seeks the critical value of each element of the grid.
    """
    try:
        grid = entry.open(device.response.f1_hz)
        check_belongs(device.response, bases, member_of(grid))
    except SeqsweepError as error:
        return PairVerdict(entry.grid_id, device.op_id, "failed", reason=str(error), parameters=entry.parameters)
    if device.model is None or device.problem:
        return PairVerdict(entry.grid_id, device.op_id, reason=device.problem, parameters=entry.parameters)
    return _judged(device, device.model, entry, grid, bases, elements)


def _judged(
    device: Device,
    model: RationalModel,
    entry: BankEntry,
    grid: Grid | RegionGrid,
    bases: Mapping[str, Any],
    elements: bool,
) -> PairVerdict:
    member = member_of(grid)
    stability = judge(model, member, device.rows, device.anchor)
    whole = _of_region(model, grid, stability) if isinstance(grid, RegionGrid) else {}
    loop = stability.closed_loop
    at = deciding_mode(loop)
    notes = tuple(getattr(member, "notes", ()))
    found = PairVerdict(
        grid_id=entry.grid_id,
        op_id=device.op_id,
        verdict=stability.verdict,
        reason=stability.reason,
        probability=stability.probability,
        grid=grid.name if isinstance(grid, RegionGrid) else grid.label,
        r_ohm=member.at_f1.real,
        x_ohm=member.at_f1.imag,
        n_unstable=loop.n_unstable,
        margin_m=None if stability.critical is None else stability.critical.m,
        re_rad_s=None if at is None else float(loop.poles[at].real),
        im_rad_s=None if at is None else float(loop.poles[at].imag),
        re_std_rad_s=None if at is None else float(loop.std[at].real),
        damping=None if at is None else float(loop.damping[at]),
        critical_scale=scale_at_the_edge(model, member, loop.n_unstable),
        elements=element_edges(model, member, loop.n_unstable == 0) if elements else (),
        missing_hz=_missing(member, loop, stability),
        parameters=entry.parameters,
        warnings=(*notes, *stability.remarks, *grid_warnings(device.response.meta, bases, member)),
    )
    return replace(found, **whole)


def _of_region(model: RationalModel, grid: RegionGrid, stability: Stability) -> dict[str, Any]:
    """What all members of a region have in common, where the one that was judged is decided."""
    if stability.verdict == "undecided":
        return {}
    found = exclusion(model, grid)
    margin = {"region_distance": found.distance, "region_growth": critical_growth(model, grid)}
    if found.excluded:
        return margin
    return {
        **margin,
        "verdict": "undecided",
        "reason": f"one member of the region is {stability.verdict}, but {found.reason}",
    }


def deciding_mode(loop: ClosedLoop) -> int | None:
    """Index of the mode that decides: the unstable one that grows fastest, else the resonance, else the slowest one."""
    unstable = np.flatnonzero((loop.poles.real > 0.0) & ~loop.beyond)
    if len(unstable):
        return int(unstable[np.argmax(loop.poles.real[unstable])])
    if loop.critical is not None:
        return loop.critical
    believed = np.flatnonzero(~loop.beyond)
    return int(believed[np.argmax(loop.poles.real[believed])]) if len(believed) else None


def _missing(member: Grid, loop: ClosedLoop, stability: Stability) -> tuple[float, float] | None:
    """Rows of the grid that the deciding mode wants, where the verdict is open."""
    at = deciding_mode(loop)
    if at is None or stability.verdict != "undecided":
        return None
    pole = loop.poles[at]
    return member.missing_rows(abs(pole.imag) / (2.0 * np.pi), abs(pole.real) / (2.0 * np.pi))
