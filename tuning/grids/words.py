"""How an impedance is written for people."""

from __future__ import annotations


def in_ohm(z: complex, digits: int = 4) -> str:
    """``0.012 + j0.25``, and ``0.012 - j2.4`` where it is capacitive; a resistance of rounding's size is zero."""
    r = 0.0 if abs(z.real) < 1e-12 * abs(z) else z.real
    return f"{r:.{digits}g} {'-' if z.imag < 0.0 else '+'} j{abs(z.imag):.{digits}g}"
