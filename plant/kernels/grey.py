"""A converter's circuit around a sampled controller that is called by its address.

Space vectors in the stationary frame, phase peak. Between two samples the converter's voltage stands
still, so the network is linear with known input: it is advanced exactly, by matrices prepared for the
step (`Network`). The DC link is a store of energy: what the converter takes out of it is the integral
of i_L times a constant, exact too.

A controller is a function of one address that returns 0 (fine), 1 (there is a message) or anything
else (it refuses), and two stretches of memory, its inputs and its outputs; `Cells` are the views of
one of them, `Wiring` says which cell holds which quantity.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from .compiled import intrinsic, njit

# Quantities that a controller may be told; vectors are re, im. The last one is zero.
V_RE, V_IM, V_F_RE, V_F_IM, I_L_RE, I_L_IM, I_G_RE, I_G_IM = range(8)
V_DC, I_DC, P_PCC, Q_PCC, TIME, P_REF, Q_REF, V_REF, ONE, ZERO = range(8, 18)
N_QUANTITIES = 18

# States of the network: current out of the converter, shunt voltage, current out of the device.
I_L, V_C, I_G = range(3)

# Kinds of cells.
F8, F4, I4, U4, I2, U2, I1, U1 = range(8)
CELL_TYPES = ("f8", "f4", "i4", "u4", "i2", "u2", "i1", "u1")

# How an advance ends.
DONE, REFUSED, NOT_A_NUMBER, EMPTY = range(4)

# Blackman's taper, 0.42 - 0.5 cos + 0.08 cos(2 .) in powers of the cosine.
TAPER_0, TAPER_1, TAPER_2 = 0.34, -0.5, 0.16
TAPER_MEAN = 0.42


class Cells(NamedTuple):
    """One stretch of memory, seen as each type; in the order of `CELL_TYPES`."""

    f8: np.ndarray
    f4: np.ndarray
    i4: np.ndarray
    u4: np.ndarray
    i2: np.ndarray
    u2: np.ndarray
    i1: np.ndarray
    u1: np.ndarray


class Wiring(NamedTuple):
    """Which cells hold what.

    Attributes
    ----------
    in_kind, in_cell, in_quantity : (n,) int
        Kind and number of a cell, and the first of the two quantities it is made of.
    in_gain : (n, 2) float
        Their factors.
    out_kind, out_cell : (m,) int
        Kind and number of a cell.
    out_vector : (m,) complex
        What its value adds to the converter's voltage (V), or to its modulation.
    modulated : bool
        Whether the outputs are the modulation index, v_conv / (v_dc / 2).
    gate_kind, gate_cell : (1,) or (0,) int
        The cell that says whether the bridge switches, where the controller has one.
    """

    in_kind: np.ndarray
    in_cell: np.ndarray
    in_quantity: np.ndarray
    in_gain: np.ndarray
    out_kind: np.ndarray
    out_cell: np.ndarray
    out_vector: np.ndarray
    modulated: bool
    gate_kind: np.ndarray
    gate_cell: np.ndarray


class Network(NamedTuple):
    """A step of the network, and what is measured in it.

    Attributes
    ----------
    phi : (4, 3) float
        From the states to the states one step later; the last row is the integral of i_L.
    beta : (4,) float
        The same from the converter's voltage.
    v_states, i_states : (3,) float
        From the states to v_pcc and to i_g.
    v_source, i_source : float
        The same from the source voltage.
    f_states : (3,) float
        From the states to the voltage of the shunt branch, which is v_pcc where nothing lies between.
    f_source : float
        The same from the source voltage.
    """

    phi: np.ndarray
    beta: np.ndarray
    v_states: np.ndarray
    i_states: np.ndarray
    v_source: float
    i_source: float
    f_states: np.ndarray
    f_source: float


class Skew(NamedTuple):
    """What an unbalanced fault adds to a step: ``turn`` times the conjugate of what ``network`` and ``forcing`` give.

    Attributes
    ----------
    network : Network
        Half of what the network along the fault's axis differs from that across it.
    forcing : (n, 4) complex
        The same of a source's forcing; see `Tones`.
    turn : complex
        exp(2j angle of the axis).
    """

    network: Network
    forcing: np.ndarray
    turn: complex


class Store(NamedTuple):
    """The DC link and the rhythm: capacitance (F), constant power into it (W), step (s), samples of delay (0 or 1).

    A battery of ``e_v`` (V) behind ``1 / g_s`` (S) gives v_dc (e_v - v_dc) g_s besides.
    """

    c_dc_f: float
    power_w: float
    dt_s: float
    delay: int
    e_v: float
    g_s: float


class Port(NamedTuple):
    """What stands between measurement and controller: it is told v - (r_ohm + j x_ohm) H i_g, with H = 1 - B.

    B is a band pass at the fundamental, by the bilinear rule: gain (1 - z^-2) / (1 + a_1 z^-1 + a_2 z^-2).
    """

    r_ohm: float
    x_ohm: float
    gain: float
    a_1: float
    a_2: float


class Box(NamedTuple):
    """A controller, ready to be called.

    Attributes
    ----------
    addresses : (2,) int
        Of its function and of that function's argument.
    time : (1,) float
        Where it reads the time (s).
    inputs, outputs : Cells
        Its memory.
    wiring : Wiring
        What is where.
    port : Port
        What it is told instead of v_pcc.
    """

    addresses: np.ndarray
    time: np.ndarray
    inputs: Cells
    outputs: Cells
    wiring: Wiring
    port: Port


class Tones(NamedTuple):
    """A source of rotating phasors, and of a periodic waveform where there are too many of them to sum at every step.

    Attributes
    ----------
    phasors, rotations : (n,) complex
        Their values at the step at hand (V), moved on in place, and their turn per step.
    forcing : (n, 4) complex
        What a phasor adds to states and integral over a step, per volt at its start.
    table : (n_rows, 5) complex
        The waveform: its voltage (V) at step k of its period, and what it adds to states and integral over that step.
        Steps are counted from time zero. Of no rows where all is in the phasors.
    """

    phasors: np.ndarray
    rotations: np.ndarray
    forcing: np.ndarray
    table: np.ndarray


@intrinsic
def _called(typing_context, function, argument):
    """Result (int32) of the C function at address ``function``, given the address ``argument``."""
    from llvmlite import ir
    from numba import types

    def code(context, builder, signature, arguments):
        prototype = ir.FunctionType(ir.IntType(32), [ir.IntType(64)])
        return builder.call(builder.inttoptr(arguments[0], prototype.as_pointer()), [arguments[1]])

    return types.int32(types.int64, types.int64), code


@njit(forceinline=True, error_model="numpy")
def _tell(cells, kind, cell, value):
    if kind == F8:
        cells.f8[cell] = value
    elif kind == F4:
        cells.f4[cell] = value
    elif kind == I4:
        cells.i4[cell] = int(value + math.copysign(0.5, value))
    elif kind == U4:
        cells.u4[cell] = int(value + math.copysign(0.5, value))
    elif kind == I2:
        cells.i2[cell] = int(value + math.copysign(0.5, value))
    elif kind == U2:
        cells.u2[cell] = int(value + math.copysign(0.5, value))
    elif kind == I1:
        cells.i1[cell] = int(value + math.copysign(0.5, value))
    else:
        cells.u1[cell] = int(value + math.copysign(0.5, value))


@njit(forceinline=True, error_model="numpy")
def _told(cells, kind, cell):
    if kind == F8:
        return cells.f8[cell]
    if kind == F4:
        return float(cells.f4[cell])
    if kind == I4:
        return float(cells.i4[cell])
    if kind == U4:
        return float(cells.u4[cell])
    if kind == I2:
        return float(cells.i2[cell])
    if kind == U2:
        return float(cells.u2[cell])
    if kind == I1:
        return float(cells.i1[cell])
    return float(cells.u1[cell])


@njit(forceinline=True, error_model="numpy")
def _inform(box, quantities):
    """Write the controller's inputs from the ``quantities`` (N_QUANTITIES,)."""
    wiring = box.wiring
    for k in range(len(wiring.in_cell)):
        first = wiring.in_quantity[k]
        value = wiring.in_gain[k, 0] * quantities[first] + wiring.in_gain[k, 1] * quantities[first + 1]
        _tell(box.inputs, wiring.in_kind[k], wiring.in_cell[k], value)


@njit(forceinline=True, error_model="numpy")
def _command(box):
    wiring = box.wiring
    u = 0.0j
    for k in range(len(wiring.out_cell)):
        u += wiring.out_vector[k] * _told(box.outputs, wiring.out_kind[k], wiring.out_cell[k])
    return u


@njit(forceinline=True, error_model="numpy")
def _switches(box):
    """Whether the controller lets the bridge switch."""
    gates = box.wiring.gate_cell
    return len(gates) == 0 or _told(box.outputs, box.wiring.gate_kind[0], gates[0]) != 0.0


@njit(forceinline=True, error_model="numpy")
def _power_in(v_dc, store):
    """Power into the DC link (W)."""
    return store.power_w + store.g_s * v_dc * (store.e_v - v_dc)


@njit(forceinline=True, error_model="numpy")
def _terminals(x, e, network):
    """v_pcc, i_g and the shunt branch's voltage with the states ``x`` under the source voltage ``e``."""
    v, i, v_f = network.v_source * e, network.i_source * e, network.f_source * e
    for k in range(3):
        v += network.v_states[k] * x[k]
        i += network.i_states[k] * x[k]
        v_f += network.f_states[k] * x[k]
    return v, i, v_f


@njit(forceinline=True, error_model="numpy")
def _observe(x, e, energy, network, skew, store, quantities):
    """What is measured with the states ``x`` under the source voltage ``e``, into ``quantities``; v_pcc and i_g."""
    v, i, v_f = _terminals(x, e, network)
    if skew is not None:
        v_more, i_more, v_f_more = _terminals(x, e, skew.network)
        v += skew.turn * v_more.conjugate()
        i += skew.turn * i_more.conjugate()
        v_f += skew.turn * v_f_more.conjugate()
    power = 1.5 * v * i.conjugate()
    quantities[V_RE], quantities[V_IM] = v.real, v.imag
    quantities[V_F_RE], quantities[V_F_IM] = v_f.real, v_f.imag
    quantities[I_L_RE], quantities[I_L_IM] = x[I_L].real, x[I_L].imag
    quantities[I_G_RE], quantities[I_G_IM] = i.real, i.imag
    v_dc = math.sqrt(2.0 * energy / store.c_dc_f)
    quantities[V_DC], quantities[I_DC] = v_dc, _power_in(v_dc, store) / v_dc
    quantities[P_PCC], quantities[Q_PCC] = power.real, power.imag
    return v, i


@njit(forceinline=True, error_model="numpy")
def _at_port(port, x, i, quantities):
    """The controller is told other voltages; the band pass moves on by a sample (states x[4], x[5])."""
    passed = port.gain * i + x[4]
    x[4] = x[5] - port.a_1 * passed
    x[5] = -port.gain * i - port.a_2 * passed
    less = complex(port.r_ohm, port.x_ohm) * (i - passed)
    quantities[V_RE] -= less.real
    quantities[V_IM] -= less.imag
    quantities[V_F_RE] -= less.real
    quantities[V_F_IM] -= less.imag


@njit(forceinline=True, error_model="numpy")
def _voltage(command, x, v_dc, modulated, store):
    """What the averaged converter makes of a command over one step: v_dc / sqrt(3) phase peak at most."""
    u = command
    if modulated:
        taken = 0.75 * v_dc * (u * x[I_L].conjugate()).real  # power at the start of the step
        u *= 0.5 * (v_dc + 0.5 * store.dt_s * (_power_in(v_dc, store) - taken) / (store.c_dc_f * v_dc))
    if 3.0 * (u.real**2 + u.imag**2) <= v_dc**2:  # no root and no hypot on the way of every step
        return u
    return u * (v_dc / math.sqrt(3.0) / abs(u))


@njit(forceinline=True, error_model="numpy")
def _later(row, x, u, phasors, network, forcing):
    """State ``row`` one step later, the integral of i_L being the fourth."""
    phi = network.phi
    y = phi[row, 0] * x[0] + phi[row, 1] * x[1] + phi[row, 2] * x[2] + network.beta[row] * u
    for tone in range(len(phasors)):
        y += forcing[tone, row] * phasors[tone]
    return y


@njit(forceinline=True, error_model="numpy")
def _all_later(x, u, phasors, network, forcing):
    return (
        _later(0, x, u, phasors, network, forcing),
        _later(1, x, u, phasors, network, forcing),
        _later(2, x, u, phasors, network, forcing),
        _later(3, x, u, phasors, network, forcing),
    )


@njit(forceinline=True, error_model="numpy")
def _move(x, energy, u, source, network, skew, store, step):
    """States (in place) and energy one step later under the converter voltage ``u``."""
    phasors, table = source.phasors, source.table
    x_0, x_1, x_2, charge = _all_later(x, u, phasors, network, source.forcing)
    if len(table) > 0:
        row = step % len(table)
        x_0, x_1, x_2, charge = x_0 + table[row, 1], x_1 + table[row, 2], x_2 + table[row, 3], charge + table[row, 4]
    if skew is not None:
        more_0, more_1, more_2, more_charge = _all_later(x, u, phasors, skew.network, skew.forcing)
        x_0 += skew.turn * more_0.conjugate()
        x_1 += skew.turn * more_1.conjugate()
        x_2 += skew.turn * more_2.conjugate()
        charge += skew.turn * more_charge.conjugate()
    x[0], x[1], x[2] = x_0, x_1, x_2
    for tone in range(len(phasors)):
        phasors[tone] *= source.rotations[tone]
    power_in = _power_in(math.sqrt(2.0 * energy / store.c_dc_f), store)
    return energy + store.dt_s * power_in - 1.5 * (u * charge.conjugate()).real


@njit(forceinline=True, error_model="numpy")
def _step(box, source, network, skew, store, step, quantities, x, energy):
    """One sample: measure, call, hold. Returns v_pcc, i_g, the energy after it and how it ended."""
    e = 0.0j
    for tone in range(len(source.phasors)):
        e += source.phasors[tone]
    if len(source.table) > 0:
        e += source.table[step % len(source.table), 0]
    v, i = _observe(x, e, energy, network, skew, store, quantities)
    _at_port(box.port, x, i, quantities)
    box.time[0] = step * store.dt_s
    quantities[TIME] = box.time[0]
    _inform(box, quantities)
    if _called(box.addresses[0], box.addresses[1]) not in (0, 1):
        return v, i, energy, REFUSED
    command = _command(box)
    if not (math.isfinite(command.real) and math.isfinite(command.imag)):
        return v, i, energy, NOT_A_NUMBER
    if store.delay:
        command, x[3] = x[3], command
    u = _voltage(command, x, quantities[V_DC], box.wiring.modulated, store)
    if not _switches(box):  # the choke sees no voltage: its current dies away in its resistance
        u = complex(quantities[V_F_RE], quantities[V_F_IM])
    energy = _move(x, energy, u, source, network, skew, store, step)
    return v, i, energy, DONE if energy > 0.0 else EMPTY


@njit(forceinline=True, error_model="numpy")
def _leave(ending, energy, end):
    ending[0], ending[1] = energy, end


@njit(error_model="numpy", cache=True)
def inform(box, network, store, quantities, x, e, energy):
    """Tell the controller, and ``quantities``, what is measured with states ``x`` under the source voltage ``e``."""
    _observe(x, e, energy, network, None, store, quantities)
    _inform(box, quantities)


@njit(nogil=True, error_model="numpy", cache=True)
def advance_recording(box, source, network, store, step, quantities, x, ending, v_out, i_out):
    """Fill ``v_out`` and ``i_out`` with v_pcc and i_g before each step.

    Parameters
    ----------
    box, source, network, store
        As above; the source's phasors are those of the first step, and are moved on in place.
    step : int
        Number of the first step since time zero.
    quantities : (N_QUANTITIES,) float
        References set, the rest is filled in.
    x : (6,) complex
        States of the network, the command that waits (with a delay) and two of the port; moved on in place.
    ending : (2,) float
        Energy of the DC link (J), moved on in place, and how it ended; what was not reached is left as it was.
    """
    energy, end = ending[0], DONE
    for k in range(len(v_out)):
        v_out[k], i_out[k], energy, end = _step(box, source, network, None, store, step + k, quantities, x, energy)
        if end != DONE:
            break
    _leave(ending, energy, end)


@njit(nogil=True, error_model="numpy", cache=True)
def advance_tracing(
    box, source, network, skew, store, step, quantities, x, ending, v_out, i_out, v_dc_out, seen, seen_share
):
    """`advance_recording` with v_dc and, seen from the source, a slow view of v_pcc besides.

    ``skew`` is None but for an unbalanced fault. ``seen`` (n + 1,) follows v_pcc over the source's first tone by
    ``seen_share`` of the way in a step; its first value is given, the others are those behind each step.
    """
    energy, end = ending[0], DONE
    if not energy > 0.0:  # the step before this stretch was the last one
        _leave(ending, energy, EMPTY)
        return
    e = source.phasors[0]
    per_square = 1.0 / (e.real**2 + e.imag**2)
    for k in range(len(v_out)):
        e = source.phasors[0].conjugate()
        v_out[k], i_out[k], energy, end = _step(box, source, network, skew, store, step + k, quantities, x, energy)
        v_dc_out[k] = quantities[V_DC]
        seen[k + 1] = seen[k] + seen_share * (v_out[k] * e * per_square - seen[k])
        if end != DONE:
            break
    _leave(ending, energy, end)


@njit(nogil=True, error_model="numpy", cache=True)
def advance_blocks(
    box, source, network, store, step, quantities, x, ending, lines, line_rotations, taper, turn, block_steps, sums
):
    """Advance by blocks; ``sums[block]`` receives the tapered sums of v_pcc at both ``lines``, then of i_g.

    ``lines`` (2,) are the phasors exp(-2j pi f t) at the first step, moved on in place; ``taper`` is the taper's
    phasor, which turns by ``turn`` per step. The rest is as in `advance_recording`.
    """
    energy, end = ending[0], DONE
    for block in range(len(sums)):
        for k in range(4):
            sums[block, k] = 0.0
    for block in range(len(sums)):
        for k in range(block_steps):
            now = step + block * block_steps + k
            v, i, energy, end = _step(box, source, network, None, store, now, quantities, x, energy)
            if end != DONE:
                _leave(ending, energy, end)
                return
            weight = TAPER_0 + taper.real * (TAPER_1 + taper.real * TAPER_2)
            for line in range(2):
                sums[block, line] += weight * v * lines[line]
                sums[block, 2 + line] += weight * i * lines[line]
                lines[line] *= line_rotations[line]
            taper *= turn
    _leave(ending, energy, end)
