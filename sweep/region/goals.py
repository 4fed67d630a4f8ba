"""What a region is swept for: Y itself, the critical mode, or the verdict on a grid or a bank.

A goal says how large the doubt is that is left over the region, where it is largest, and by how much a fresh sweep
missed its prediction, all three in the unit of its tolerance. The sweep goes on where the doubt is largest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np

from ...identify.response import FrequencyResponse
from ...identify.surrogate.design import WIDER, apart_from_swept, fresh_rows, missed_by, next_point
from ...identify.surrogate.surrogate import Surrogate
from ...plant.errors import SeqsweepError
from ...tuning.bank.entries import bank_of
from ...tuning.grids.open import open_grid
from ...tuning.grids.regions import RegionGrid
from ...tuning.region.loadflow import Situation, admissible
from ...tuning.region.scan import Scan, scan, scan_rows
from ..config.sections import ToleranceSection

COVERING = 256
"""Points of the region that are looked at on one grid."""

COVERING_OF_BANK = 64


class Goal(Protocol):
    """What is to be certified.

    Attributes
    ----------
    tolerance : float
        What is asked.
    wider : float
        How many times the doubt has to fit into it.
    promise : str
        What holds once it is certified.
    """

    @property
    def tolerance(self) -> float: ...

    @property
    def wider(self) -> float: ...

    @property
    def promise(self) -> str: ...

    def look(self, surrogate: Surrogate) -> tuple[np.ndarray, float]:
        """The operating point (d,) to sweep next, and the largest doubt over the region."""

    def missed(self, surrogate: Surrogate, response: FrequencyResponse, at: np.ndarray) -> float:
        """By how much a fresh sweep at ``at`` (d,) missed what the surrogate predicted."""

    def words(self, doubt: float) -> str:
        """The doubt in words."""

    def missed_words(self, missed: float) -> str:
        """How the last fresh sweep was met."""


@dataclass(frozen=True, slots=True)
class Admittance:
    """Y over the region and all frequencies, relative to its norm."""

    tolerance: float
    wider: float = WIDER

    @property
    def promise(self) -> str:
        return f"Y is certified to {self.tolerance:g} over the region"

    def look(self, surrogate: Surrogate) -> tuple[np.ndarray, float]:
        return next_point(surrogate, surrogate.region)

    def missed(self, surrogate: Surrogate, response: FrequencyResponse, at: np.ndarray) -> float:
        return missed_by(surrogate, response, at)

    def words(self, doubt: float) -> str:
        return f"error bar {doubt:.2g} of {self.tolerance:g}"

    def missed_words(self, missed: float) -> str:
        return f"the last fresh sweep was met within {missed:.2g}"


class _Seen(NamedTuple):
    """Points (p, d) of the region on all grids, one after the other, and what is known of them."""

    points: np.ndarray
    scanned: Scan


@dataclass(frozen=True, slots=True)
class CriticalMode:
    """The least damped mode near the axis, at every operating point on every grid (rad/s)."""

    tolerance: float
    situations: tuple[Situation, ...]
    wider: float = WIDER

    @property
    def promise(self) -> str:
        return f"the critical mode is certified to {self.tolerance:g} rad/s over the region, {_on(self.situations)}"

    def look(self, surrogate: Surrogate) -> tuple[np.ndarray, float]:
        seen = _seen(surrogate.cautious, self.situations)
        radius = np.where(np.isfinite(seen.scanned.mode), seen.scanned.mode_radius, 0.0)
        return apart_from_swept(surrogate, seen.points, radius), float(radius.max())

    def missed(self, surrogate: Surrogate, response: FrequencyResponse, at: np.ndarray) -> float:
        pairs = [_both(surrogate, response, at, each) for each in self.situations]
        off = [float(np.abs(found.mode - told.mode)[0]) for told, found in pairs if np.isfinite(found.mode[0])]
        return max((float("inf") if np.isnan(each) else each for each in off), default=0.0)

    def words(self, doubt: float) -> str:
        return f"critical mode known to {doubt:.2g} rad/s, asked {self.tolerance:g},"

    def missed_words(self, missed: float) -> str:
        return f"the mode of the last fresh sweep was met within {missed:.2g} rad/s"


@dataclass(frozen=True, slots=True)
class Verdict:
    """The share of the region, over all grids, in which it is open whether a mode grows."""

    tolerance: float
    situations: tuple[Situation, ...]
    wider: float = 1.0

    @property
    def promise(self) -> str:
        return f"the verdict is known on all but {self.tolerance:.3g} of the region, {_on(self.situations)}"

    def look(self, surrogate: Surrogate) -> tuple[np.ndarray, float]:
        seen = _seen(surrogate.cautious, self.situations)
        closeness = 1.0 / np.maximum(np.abs(seen.scanned.sure), 1e-12)
        return apart_from_swept(surrogate, seen.points, closeness), float(np.mean(is_open(seen.scanned)))

    def missed(self, surrogate: Surrogate, response: FrequencyResponse, at: np.ndarray) -> float:
        """One where a verdict that was told is another one, else zero."""
        pairs = [_both(surrogate, response, at, each) for each in self.situations]
        wrong = [not is_open(told)[0] and (told.sure[0] > 0.0) != (found.sure[0] > 0.0) for told, found in pairs]
        return float(any(wrong))

    def words(self, doubt: float) -> str:
        return f"verdict open on {doubt:.1%} of the region, asked {self.tolerance:.1%}, least sure"

    def missed_words(self, missed: float) -> str:
        return f"the verdict at the last fresh sweep was {'not the predicted one' if missed else 'as predicted'}"


def is_open(scanned: Scan) -> np.ndarray:
    """(p,) bool: where a mode may be on the other side of the axis within `WIDER` times its radius."""
    return np.asarray(np.abs(scanned.sure) < WIDER)


def _on(situations: Sequence[Situation]) -> str:
    return f"on {situations[0].name}" if len(situations) == 1 else f"on {len(situations)} grids"


def _seen(surrogate: Surrogate, situations: Sequence[Situation]) -> _Seen:
    covering = surrogate.region.samples(COVERING if len(situations) == 1 else COVERING_OF_BANK)
    points = [admissible(surrogate, each, covering) for each in situations]
    scans = [scan(surrogate, each.grid, p) for each, p in zip(situations, points, strict=True) if len(p)]
    if not scans:
        raise SeqsweepError(
            "no operating point of the region exists on this grid: its |v_pcc| would leave the region, or the grid "
            "cannot carry the power"
        )
    return _Seen(np.concatenate(points), Scan(*map(np.concatenate, zip(*scans, strict=True))))


def _both(surrogate: Surrogate, response: FrequencyResponse, at: np.ndarray, on: Situation) -> tuple[Scan, Scan]:
    """What was told of an operating point (d,), and what its sweep says, at the same frequencies."""
    rows, y = fresh_rows(surrogate, response)
    told = surrogate.evaluate(at[None])
    nu_hz = surrogate.nu_hz[rows]
    return (
        scan_rows(nu_hz, told.y[:, rows], told.radius[:, rows], on.grid),
        scan_rows(nu_hz, y[None], np.zeros((1, len(rows))), on.grid),
    )


def goal_on(asked: ToleranceSection, f1_hz: float, rated_voltage_v: float) -> Goal:
    """What a campaign asks for on grids, of the fundamental (Hz) and the rating (V, line to line) of its plant.

    Raises
    ------
    SeqsweepError
        If its grid is none.
    """
    situations = situations_of(asked.grid, f1_hz, asked.source_voltage_pu, rated_voltage_v)
    if asked.mode_rad_s is not None:
        return CriticalMode(asked.mode_rad_s, situations)
    assert asked.verdict is not None
    return Verdict(asked.verdict, situations)


def situations_of(
    grid: str, f1_hz: float, source_voltage_pu: float | None, rated_voltage_v: float | None
) -> tuple[Situation, ...]:
    """The grids that a text names: R+jX, a file, or a bank; each with the source voltage of its file, else that given.

    Raises
    ------
    SeqsweepError
        If it names none, or a region of Z, of which no member is the one that counts.
    """
    path = Path(grid)
    if path.is_dir() or path.suffix.lower() in (".toml", ".parquet"):
        entries = bank_of(path)
        opened = [(each.grid_id, each.open(f1_hz), each.source_voltage_pu(source_voltage_pu)) for each in entries]
    else:
        one = open_grid(grid, f1_hz)
        opened = [(one.label, one, source_voltage_pu)]
    if any(isinstance(each, RegionGrid) for _, each, _ in opened):
        raise SeqsweepError(f"{grid}: a region of Z has no single worst operating point; give its members")
    return tuple(Situation(name, each, voltage_pu, rated_voltage_v) for name, each, voltage_pu in opened)  # type: ignore[arg-type]
