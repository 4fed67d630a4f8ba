"""What a turbine's job asks for: the kernel that steps it, its power, what its reactive current leaves to i_d."""

from __future__ import annotations

from math import sqrt

from ..circuits.circuit import Circuit
from ..protocol import Job, OperatingPoint


def kind_of(job: Job) -> tuple[str, bool, Circuit | None]:
    """Kind of the source, whether reactive power is asked for, and the network."""
    return job.state.source.kind, job.state.i_q_ref_a != 0.0, job.state.source.circuit


def order_of(kind: tuple[str, bool, Circuit | None]) -> tuple[str, bool, str]:
    """Ideal sources first, then lines, then networks."""
    source, reactive, circuit = kind
    return {"ideal": "0", "thevenin": "1"}.get(source, "2"), reactive, "" if circuit is None else repr(circuit)


def power_of(operating_point: OperatingPoint) -> complex:
    """Out of the converter (W + j var)."""
    return complex(operating_point.active_power_w, operating_point.reactive_power_var)


def left_to_d(i_limit_a: float, i_q_ref_a: float) -> float:
    """What the limit of the current leaves to |i_d| (A); all of it, to the last bit, where i_q* is zero."""
    return i_limit_a * sqrt(1.0 - (i_q_ref_a / i_limit_a) ** 2)
