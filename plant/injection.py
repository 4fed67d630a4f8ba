"""What every built-in plant does alike with its source: checks, and tones as series voltage."""

from __future__ import annotations

import cmath
from collections.abc import Callable, Iterator
from functools import partial
from math import pi

from .errors import SeqsweepError
from .protocol import Injection, OperatingPoint, Source


def check_source(operating_point: OperatingPoint, source: Source, networks: bool = False) -> None:
    """Refuse a source without impedance, and |v_pcc| said twice or not at all; a network unless it is simulated.

    Raises
    ------
    SeqsweepError
        With what was given and what is needed.
    """
    if (operating_point.terminal_voltage_v is None) == (source.voltage_v is None):
        raise SeqsweepError("give either the operating point's terminal_voltage_v or the source's voltage_v, not both")
    if source.kind == "network" and not networks:
        raise SeqsweepError(
            "a grid of elements is simulated behind the built-in plants dpmsg-v1, gfl-v1 and gfm-v1 alone; "
            "give this plant a grid R + jX"
        )
    if source.kind == "thevenin" and not (source.r_ohm >= 0.0 and source.l_h > 0.0):
        raise SeqsweepError(
            f"a Thevenin source needs r_ohm >= 0 and l_h > 0; got {source.r_ohm:g} ohm, {source.l_h:g} H"
        )


def series_tones(
    injection: Injection | None, source: Source, grid_impedance: Callable[[float], complex] | None = None
) -> Iterator[tuple[float, complex]]:
    """Tones of an injection as (signed frequency in Hz, series voltage at time zero in V, phase peak).

    A shunt current i into the PCC acts on the device as the series voltage Z_grid i: the Thevenin
    equivalent of source, impedance and injected current.

    Parameters
    ----------
    injection : Injection or None
        None: no tones.
    source : Source
        What feeds the PCC.
    grid_impedance : callable, optional
        Z_grid (ohm) of the plant's own stepper at a signed frequency (Hz); that of the source by default.

    Raises
    ------
    SeqsweepError
        For a shunt current into an ideal source.
    """
    if injection is None:
        return
    if injection.kind == "shunt_current" and source.kind == "ideal":
        raise SeqsweepError(
            "shunt_current cannot perturb a PCC held by an ideal source: use series_voltage, or a thevenin source"
        )
    grid_impedance = grid_impedance or partial(impedance_of, source)
    for tone in injection.tones:
        amplitude = tone.amplitude * cmath.exp(1j * tone.phase_rad)
        yield tone.f_hz, amplitude * grid_impedance(tone.f_hz) if injection.kind == "shunt_current" else amplitude


def impedance_of(source: Source, f_hz: float) -> complex:
    """Impedance (ohm) of a source at a signed frequency (Hz)."""
    if source.circuit is not None:
        return source.circuit.seen_at(2j * pi * f_hz)[0]
    return source.r_ohm + 2j * pi * f_hz * source.l_h


def turns(cycles: float) -> complex:
    """exp(2j pi cycles), with whole turns taken off first."""
    return cmath.exp(2j * pi * (cycles % 1.0))
