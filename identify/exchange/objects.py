"""Responses as objects of other Python packages. The packages are extras: ``pip install 'seqsweep[exchange]'``."""

from __future__ import annotations

import re
from math import pi
from typing import Any

import numpy as np

from ..response import FrequencyResponse
from ..table.format import ELEMENTS, std_of
from ..table.read import Table
from .facts import ExchangeError, extra

ROUND_TRIP = 1e-12
"""Largest relative error (norm of a 2x2) that scattering parameters may bring."""


def to_control(response: FrequencyResponse) -> Any:
    """The response as python-control's ``FrequencyResponseData``: two inputs (V), two outputs (A).

    Parameters
    ----------
    response : FrequencyResponse
        In either frame; rows that are not "ok" are left out.

    Returns
    -------
    control.FrequencyResponseData
        ``omega`` in rad/s (negative in the dq frame below f1). No interpolation, no symmetry: in the pn
        frame Y(-f) is not the conjugate of Y(f).
    """
    control = extra("control", "control")
    ok = _rows(response)
    second = {"pn": ("p", "n_conj"), "dq": ("d", "q")}[response.frame]
    return control.frd(
        np.moveaxis(response.y[ok], 0, -1),
        2.0 * pi * response.f_hz[ok],
        inputs=[f"v_{name}" for name in second],
        outputs=[f"i_{name}" for name in second],
        name=re.sub(r"\W", "_", str(response.meta.get("op_id", "y"))),
    )


def to_network(response: FrequencyResponse, z0_ohm: float = 50.0) -> Any:
    """The response as a scikit-rf ``Network``: port 1 is p (or d), port 2 the conjugate mirror (or q).

    Parameters
    ----------
    response : FrequencyResponse
        In either frame; rows that are not "ok" are left out.
    z0_ohm : float
        Reference impedance of the scattering parameters (ohm). Near the device's own impedance, such
        as U^2/S, nothing is lost.

    Raises
    ------
    ExchangeError
        If a frequency is negative, which a ``Network`` cannot hold, or scattering parameters for this
        reference would lose more than `ROUND_TRIP` of Y.
    """
    skrf = extra("skrf", "scikit-rf")
    ok = _rows(response)
    f_hz, y = response.f_hz[ok], response.y[ok]
    if f_hz[0] < 0.0:
        raise ExchangeError(
            f"{f_hz[0]:g} Hz in the {response.frame} frame: a scikit-rf Network, and so Touchstone, holds no negative "
            "frequencies; use the pn frame (--frame pn)"
        )
    network = skrf.Network(f=f_hz, f_unit="Hz", y=y, z0=z0_ohm, name=str(response.meta.get("op_id", "y")))
    norm, lost = (np.linalg.norm(value, axis=(1, 2)) for value in (y, network.y - y))
    if np.any(~(lost <= ROUND_TRIP * norm)):
        part = lost / np.where(norm > 0.0, norm, 1.0)
        raise ExchangeError(
            f"scattering parameters for {z0_ohm:g} ohm lose {part.max():.1e} of Y at {f_hz[np.argmax(part)]:g} Hz; "
            "choose a reference impedance near the device's own (--z0 OHM)"
        )
    return network


def to_xarray(table: Table) -> Any:
    """A table as ``xarray.Dataset``: ``y (op_id, f_hz, row, column)`` in S, ``std``, ``status`` and the qualities.

    Parameters
    ----------
    table : Table
        As `read_table` gives it: every operating point has the same frequencies.
    """
    xarray = extra("xarray", "xarray")
    responses = table.responses
    f_hz = responses[0].f_hz
    if any(not np.array_equal(response.f_hz, f_hz) for response in responses):
        raise ExchangeError("the operating points have different frequencies: they do not fit one array")
    axes = ("op_id", "f_hz", "row", "column")
    variables = {
        "y": (axes, np.stack([response.y for response in responses]), {"unit": "S"}),
        "std": (axes, np.stack([_std(response) for response in responses]), {"unit": "S"}),
        "status": (axes[:2], np.stack([np.asarray(response.status) for response in responses])),
        "f_mirror_hz": ("f_hz", responses[0].f_mirror_hz, {"unit": "Hz"}),
    }
    for name in responses[0].quality:
        variables[name] = (axes[:2], np.stack([response.quality[name] for response in responses]))
    names = [element[0] for element in (ELEMENTS[0], ELEMENTS[3])]
    coordinates = {"op_id": list(table.op_ids), "f_hz": f_hz, "row": names, "column": names}
    attributes = {"f1_hz": table.meta["f1_hz"], "frame": "pn", "direction": table.meta["direction"]}
    return xarray.Dataset(variables, coordinates, attributes)


def _std(response: FrequencyResponse) -> np.ndarray:
    """Standard deviations (n, 2, 2) of the complex elements (S)."""
    return std_of(np.asarray(response.covariance)).reshape(-1, 2, 2)


def _rows(response: FrequencyResponse) -> np.ndarray:
    """(n,) bool: the rows that go out."""
    if not np.any(response.ok):
        raise ExchangeError(f"{response.meta.get('op_id', 'the response')}: no row is ok: there is nothing to hand on")
    return response.ok
