"""Does a plant keep its promise? `check_plant` drives any plant and says what it found.

Four findings are gates: without attributes, a steady state, samples as asked and finite numbers there
is nothing further to judge. A plant that raises fails the finding at hand, with its message.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .errors import in_words
from .promises import PROMISES, Broken, Trial
from .protocol import OperatingPoint, Plant, Source

_GATES = ("attributes", "settles", "samples", "finite")


@dataclass(frozen=True, slots=True)
class Finding:
    """One promise, whether it was kept, and the number or message behind the verdict."""

    name: str
    passed: bool
    detail: str


def check_plant(
    plant: Plant, operating_point: OperatingPoint | None = None, source: Source | None = None
) -> list[Finding]:
    """Judge a plant by driving it for a few tens of fundamental periods.

    Parameters
    ----------
    plant : Plant
        Any plant; nothing is asked of it but the protocol.
    operating_point : OperatingPoint, optional
        Where to check; the middle of the power range at rated voltage unless given.
    source : Source, optional
        What feeds it; an ideal source unless given.

    Returns
    -------
    list of Finding
        One per promise, in the order of the checks; it ends at the first gate that fails.
    """
    trial = Trial(plant, operating_point, source or Source())
    findings = []
    with np.errstate(all="ignore"):
        for name, check in PROMISES.items():
            findings.append(_judge(name, check, trial))
            if name in _GATES and not findings[-1].passed:
                break
    return findings


def _judge(name: str, check: Callable[[Trial], str], trial: Trial) -> Finding:
    try:
        return Finding(name, True, check(trial))
    except Broken as broken:
        return Finding(name, False, str(broken))
    except Exception as error:
        return Finding(name, False, in_words(error))
