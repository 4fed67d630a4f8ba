"""Networks of other tools to farm files, and farms to them; which tool it is is told from the content or the suffix."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from .entries import FarmError
from .matpower_files import from_matpower, is_matpower, to_matpower
from .network_parts import Network
from .pandapower_files import from_pandapower, is_pandapower, to_pandapower

WRITERS = {".json": to_pandapower, ".m": to_matpower}
"""How a farm is written, by the suffix of the file."""


def imported(text: str, table: str, s_sc_mva: float | None = None, f1_hz: float = 50.0) -> Network:
    """A network of pandapower or MATPOWER as the parts of a farm file, with remarks on the translation.

    Parameters
    ----------
    text : str
        The file.
    table : str
        File of the admittance that every generator gets.
    s_sc_mva : float, optional
        Short-circuit power of the source where the file has none.
    f1_hz : float
        Fundamental (Hz) where the file has none.

    Raises
    ------
    FarmError
        If it is neither, or holds what a farm file cannot say.
    """
    if s_sc_mva is not None and not s_sc_mva > 0.0:
        raise FarmError(f"a short-circuit power of {s_sc_mva:g} MVA; needed is a number above 0")
    if is_pandapower(text):
        return from_pandapower(text, table, s_sc_mva)
    if is_matpower(text):
        return from_matpower(text, table, s_sc_mva, f1_hz)
    raise FarmError("neither a network of pandapower (pp.to_json) nor a case file of MATPOWER (mpc.bus = [...])")


def exported(document: Mapping[str, Any], powers_mva: Mapping[str, complex], suffix: str) -> str:
    """A farm as the file of another tool, ``.json`` (pandapower) or ``.m`` (MATPOWER)."""
    if suffix not in WRITERS:
        raise FarmError(f"a network is written as .json (pandapower) or .m (MATPOWER), not as {suffix or 'no suffix'}")
    return WRITERS[suffix](document, powers_mva)
