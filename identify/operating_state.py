"""What is known of an operating point besides its admittance: its fundamental, and where the device is stable.

Both are facts of the measurement. They stand in the table's metadata per operating point, ``fundamental`` and
``stable_on``, and reach `FrequencyResponse.meta` when a table is read.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from math import hypot, isfinite
from typing import Any

import numpy as np

from ..plant.errors import SeqsweepError
from ..plant.space_vectors import LINE_RMS
from .response import FrequencyResponse


class StatementError(SeqsweepError):
    """A statement about an operating point that makes no sense, with the way out."""


def fundamental_facts(v1: complex, i1: complex) -> dict[str, float]:
    """The fundamental at the PCC, current positive into the device.

    Parameters
    ----------
    v1, i1 : complex
        Space-vector phasors at f1 (V and A, phase peak; load direction).

    Returns
    -------
    dict
        Active and reactive power into the device (W, var): a device that generates has a negative active power, one
        that takes inductive current a positive reactive power. Voltage (V, line-to-line RMS), its angle at time zero
        (rad), current (A, RMS) and its angle against the voltage (rad).
    """
    power_va = 1.5 * v1 * np.conj(i1)
    return {
        "active_power_into_device_w": float(power_va.real),
        "reactive_power_into_device_var": float(power_va.imag),
        "voltage_v": float(abs(v1) * LINE_RMS),
        "angle_rad": float(np.angle(v1)),
        "current_a": float(abs(i1) * 0.5**0.5),
        "current_angle_rad": float(np.angle(i1 * np.conj(v1))),
    }


def stable_on_text(fact: Mapping[str, Any]) -> str:
    """The fact ``stable_on`` in words."""
    grid = fact["grid"]
    where = "an ideal source" if grid == "ideal" else f"{grid['r_ohm']:.4g} + j{grid['x_ohm']:.4g} ohm"
    if "growth_bound_per_s" not in fact:
        return f"{where}, as stated"
    runs = {"shots": "shot", "recordings": "record"}.get(fact["basis"], "run")
    return (
        f"{where}: a mode growing faster than {fact['growth_bound_per_s']:.2g} 1/s would have shown "
        f"in a {runs} of {fact['disturbed_s']:.3g} s"
    )


def fundamental_text(facts: Mapping[str, float]) -> str:
    """The fundamental at the PCC in words; powers out of the device, as an operating point is given."""
    power_mw, reactive_mvar = (
        0.0 - facts[key] / 1e6 for key in ("active_power_into_device_w", "reactive_power_into_device_var")
    )
    return f"{power_mw:.4g} MW and {reactive_mvar:.3g} Mvar out of the device at the PCC, {facts['current_a']:.4g} A"


def with_statement(response: FrequencyResponse, fact: Mapping[str, Any]) -> FrequencyResponse:
    """The response with another ``stable_on``; one that was proven on the same source stays, for it says more."""
    known = response.meta.get("stable_on")
    if known is not None and known["grid"] == fact["grid"]:
        return response
    return replace(response, meta={**response.meta, "stable_on": dict(fact)})


def stated(text: str) -> dict[str, Any]:
    """The fact ``stable_on`` as somebody states it, without proof.

    Parameters
    ----------
    text : str
        "ideal", or R+jX in ohm at f1, such as "0.012+0.25j": the grid on which the device was seen to be stable.

    Raises
    ------
    StatementError
        If it is neither.
    """
    if text.strip().lower() == "ideal":
        return {"grid": "ideal", "basis": "stated"}
    try:
        z = complex(re.sub(r"j([\d.]+(?:e[+-]?\d+)?)$", r"\1j", text.replace(" ", "").replace("i", "j")))
    except ValueError:
        z = complex("nan")
    if not (isfinite(z.real) and isfinite(z.imag) and z.real >= 0.0 and z.imag >= 0.0 and hypot(z.real, z.imag) > 0.0):
        raise StatementError(
            f"--stable-on {text!r}: needed is the source on which the device was seen to be stable, as ideal or as "
            "R+jX in ohm at f1 with R, X >= 0, such as 0.012+0.25j"
        )
    return {"grid": {"r_ohm": z.real, "x_ohm": z.imag}, "basis": "stated"}
