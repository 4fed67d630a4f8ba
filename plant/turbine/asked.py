"""What a turbine's job asks for: the kernel that steps it, its power, what its reactive current leaves to i_d."""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt
from typing import NamedTuple

from ..circuits.circuit import Circuit
from ..errors import SeqsweepError
from ..protocol import Compensation, Job, OperatingPoint
from .equilibrium import machine_stands
from .parameters import TurbineParameters
from .state import TurbineState

_INTEGRATORS = ("rk4", "emt")


class Kind(NamedTuple):
    """What decides on the kernel of a job.

    Attributes
    ----------
    source : str
        Kind of the source.
    reactive : bool
        Whether reactive power is asked for.
    circuit : Circuit or None
        The network.
    calm : bool
        Whether the machine stands still: nothing but wind moves it.
    """

    source: str
    reactive: bool
    circuit: Circuit | None
    calm: bool


def kinds_of(jobs: Sequence[Job], p: TurbineParameters) -> list[Kind]:
    """The kind of each job; most of them share a state."""
    states = {id(job.state): job.state for job in jobs}
    kinds = {key: _kind_of(state, p) for key, state in states.items()}
    return [kinds[id(job.state)] for job in jobs]


def _kind_of(state: TurbineState, p: TurbineParameters) -> Kind:
    source = state.source
    return Kind(
        source.kind, is_reactive(state), source.circuit, machine_stands(p, state.values.tolist(), state.wind_m_s)
    )


def is_reactive(state: TurbineState) -> bool:
    """Whether reactive power is asked for."""
    return state.i_q_ref_a != 0.0


def order_of(kind: Kind) -> tuple[str, bool, str, bool]:
    """Ideal sources first, then lines, then networks."""
    circuit = "" if kind.circuit is None else repr(kind.circuit)
    return {"ideal": "0", "thevenin": "1"}.get(kind.source, "2"), kind.reactive, circuit, kind.calm


def checked_integrator(integrator: str, block: Compensation) -> str:
    """The integrator that was asked for, if the turbine has it, with that compensation."""
    if integrator not in _INTEGRATORS:
        raise SeqsweepError(f"integrator is {integrator!r}; dpmsg-v1 has {' and '.join(map(repr, _INTEGRATORS))}")
    if integrator == "emt" and block != Compensation():
        raise SeqsweepError(
            "integrator 'emt' has no damping control: leave damping_gain at 0, or take integrator 'rk4'"
        )
    return integrator


def power_of(operating_point: OperatingPoint) -> complex:
    """Out of the converter (W + j var)."""
    return complex(operating_point.active_power_w, operating_point.reactive_power_var)


def left_to_d(i_limit_a: float, i_q_ref_a: float) -> float:
    """What the limit of the current leaves to |i_d| (A); all of it, to the last bit, where i_q* is zero."""
    return i_limit_a * sqrt(1.0 - (i_q_ref_a / i_limit_a) ** 2)
