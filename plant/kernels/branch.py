"""The R-L branch behind an ideal or a Thevenin source, by the trapezoidal rule.

Space vectors in the stationary frame. The source is a sum of rotating phasors, one row of
``phasors`` and ``rotations`` each: its value at the first sample and its turn per step.
"""

from __future__ import annotations

from .compiled import njit

# Blackman's taper, 0.42 - 0.5 cos + 0.08 cos(2 .) in powers of the cosine.
TAPER_0, TAPER_1, TAPER_2 = 0.34, -0.5, 0.16
TAPER_MEAN = 0.42


@njit(forceinline=True)
def _step(i, e_now, e_next, r_ohm, l_h, r_grid_ohm, l_grid_h, dt_s):
    """Voltage at the terminals now, and the current one step later."""
    r_loop, l_loop = r_ohm + r_grid_ohm, l_h + l_grid_h
    di_dt = (e_now - r_loop * i) / l_loop
    v = e_now - r_grid_ohm * i - l_grid_h * di_dt
    i_next = ((2.0 * l_loop / dt_s - r_loop) * i + e_now + e_next) / (2.0 * l_loop / dt_s + r_loop)
    return v, i_next


@njit(forceinline=True)
def _next_source(tones, rotations):
    """Turn the tones by a step; their sum."""
    e = 0.0j
    for k in range(len(tones)):
        tones[k] = tones[k] * rotations[k]
        e += tones[k]
    return e


@njit(forceinline=True)
def _source(tones):
    e = 0.0j
    for k in range(len(tones)):
        e += tones[k]
    return e


@njit(nogil=True, cache=True)
def advance_recording(current, tones, rotations, r_ohm, l_h, r_grid_ohm, l_grid_h, dt_s, v_out, i_out):
    """Fill ``v_out`` and ``i_out`` with the samples before each step; ``current`` (1,) and ``tones`` are moved on."""
    i, e_now = current[0], _source(tones)
    for k in range(len(v_out)):
        e_next = _next_source(tones, rotations)
        i_out[k] = i
        v_out[k], i = _step(i, e_now, e_next, r_ohm, l_h, r_grid_ohm, l_grid_h, dt_s)
        e_now = e_next
    current[0] = i


@njit(nogil=True, cache=True)
def advance_blocks(
    current, tones, rotations, r_ohm, l_h, r_grid_ohm, l_grid_h, dt_s, lines, line_rotations, taper, turn, steps, sums
):
    """Advance by blocks of ``steps``; ``current`` (1,), ``tones`` and ``lines`` move on in place.

    ``sums[block]`` receives the tapered sums of v at both ``lines``, then of i at both. ``lines``
    are the phasors exp(-2j pi f t) at the first sample; ``taper`` is the taper's phasor there, which
    turns by ``turn`` per step, a whole turn per window.
    """
    i, e_now = current[0], _source(tones)
    for block in range(len(sums)):
        for k in range(4):
            sums[block, k] = 0.0
        for _ in range(steps):
            e_next = _next_source(tones, rotations)
            c = taper.real
            weight = TAPER_0 + c * (TAPER_1 + c * TAPER_2)
            i_now = i
            v, i = _step(i_now, e_now, e_next, r_ohm, l_h, r_grid_ohm, l_grid_h, dt_s)
            for line in range(2):
                sums[block, line] += weight * v * lines[line]
                sums[block, 2 + line] += weight * i_now * lines[line]
                lines[line] = lines[line] * line_rotations[line]
            taper *= turn
            e_now = e_next
    current[0] = i
