"""Sequence admittance of grid converters, whether they are stable on a grid, and the gain that makes them so.

    import seqsweep as ss
    y = ss.sweep("dpmsg-v1", active_power_mw=0.65, f_hz=ss.log_grid(1, 1000, 100))
    t = ss.tune(y, grid="0.012+0.25j", scale=1.4)
    v = ss.verify(t, plant="dpmsg-v1")

This is the front door of the house: every name below is imported when it is first used (PEP 562), so
that the import itself costs nothing. Behind it stand four floors, each knowing only those below it:
`seqsweep.plant` (what is driven), `seqsweep.identify` (from records to Y and its table),
`seqsweep.tuning` (from the table to decisions) and `seqsweep.sweep` (campaigns and the command line).

A new name of the face is one line of `_HOME`, and one import for readers and type checkers above it.
"""

from __future__ import annotations

import sys
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .deciding import tune, verify
    from .identify.response import FrequencyResponse
    from .identify.surrogate.store import read_surrogate
    from .identify.surrogate.surrogate import Surrogate, build_surrogate
    from .identify.table.read import Table, read_table
    from .looking_further import farm, farm_advice, judge, metrics, surrogate
    from .making import check_plant, make_plant
    from .plant.boxes.step_function import plant_from_lanes, plant_from_step
    from .plant.errors import SeqsweepError
    from .sweeping import Campaign, SweepInterrupted, adaptive_grid, linear_grid, log_grid, sweep
    from .tables import export, identify, import_table, write_table

    __version__: str

_HOME = {
    "sweep": "sweeping",
    "Campaign": "sweeping",
    "SweepInterrupted": "sweeping",
    "log_grid": "sweeping",
    "linear_grid": "sweeping",
    "adaptive_grid": "sweeping",
    "tune": "deciding",
    "verify": "deciding",
    "metrics": "looking_further",
    "judge": "looking_further",
    "farm": "looking_further",
    "farm_advice": "looking_further",
    "surrogate": "looking_further",
    "read_table": "identify.table.read",
    "write_table": "tables",
    "identify": "tables",
    "import_table": "tables",
    "export": "tables",
    "Surrogate": "identify.surrogate.surrogate",
    "build_surrogate": "identify.surrogate.surrogate",
    "read_surrogate": "identify.surrogate.store",
    "make_plant": "making",
    "check_plant": "making",
    "plant_from_step": "plant.boxes.step_function",
    "plant_from_lanes": "plant.boxes.step_function",
    "FrequencyResponse": "identify.response",
    "Table": "identify.table.read",
    "SeqsweepError": "plant.errors",
}
"""Where the names of the face live, as modules of this package."""

__all__ = [  # noqa: RUF022 (in the order of the work)
    "sweep",
    "Campaign",
    "SweepInterrupted",
    "log_grid",
    "linear_grid",
    "adaptive_grid",
    "tune",
    "verify",
    "metrics",
    "judge",
    "farm",
    "farm_advice",
    "surrogate",
    "read_table",
    "write_table",
    "identify",
    "import_table",
    "export",
    "Surrogate",
    "build_surrogate",
    "read_surrogate",
    "make_plant",
    "check_plant",
    "plant_from_step",
    "plant_from_lanes",
    "FrequencyResponse",
    "Table",
    "SeqsweepError",
    "__version__",
]


_FLOORS = ("plant", "identify", "tuning", "sweep")


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version(__name__)
    if name not in _HOME:
        from .plant.errors import nearest

        raise AttributeError(f"module {__name__!r} has no attribute {name!r}{nearest(name, __all__)}")
    from importlib import import_module

    if name in _FLOORS:  # the folder itself is what is found, and is callable
        return import_module(f"{__name__}.{name}")
    found = _found(name)
    setattr(sys.modules[__name__], name, found)
    return found


def __dir__() -> list[str]:
    return sorted(__all__)


def _found(name: str) -> Any:
    from importlib import import_module

    return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)


class _FolderAndFunction(ModuleType):
    """A floor of the house that shares its name with a function of the face, and so is callable as that function."""

    def __call__(self, *given: Any, **named: Any) -> Any:
        return self._function()(*given, **named)

    def _function(self) -> Any:
        return _found(self.__name__.rpartition(".")[2])

    @property
    def __signature__(self) -> Any:
        from inspect import signature

        return signature(self._function())


class _Face(ModuleType):
    """This module: whatever the face names stays callable when the import system puts a folder of that name here."""

    def __setattr__(self, name: str, value: Any) -> None:
        if name in _FLOORS and name in _HOME:
            value.__class__ = _FolderAndFunction
        super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Face
