"""An FMU for co-simulation, stepped through the addresses of its functions.

A `block` of numbers holds all that a step needs: addresses of the functions, value references and values, time and
step. A step is then a function of the block's address, `STEPS[2]` for FMI 2.0, `STEPS[3]` for FMI 3.0, that whatever
calls functions by address can call: the loop in here, or a circuit with the FMU in it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba import carray, cfunc, extending, njit, types

_intrinsic: Any = extending.intrinsic  # its annotations have the typing context among the arguments

WARNING = 1
"""Statuses up to this one let a step go on."""

STEP, END_ASKED = -1, -2
"""Where a step ended, if not at a group of variables: in the step itself, or after it, as the FMU asks for an end."""

# Cells of a block, 8 bytes each; times are doubles.
INSTANCE, DO_STEP, TIME, STEP_SIZE, NO_WAY_BACK, N_SETS, N_GETS, WHERE, STATUS, FLAGS = range(10)
_LAST_TIME = FLAGS + 1
_GROUPS = FLAGS + 2

# A group of variables of one type: function, references, their number, values, their number.
GROUP_CELLS = 5

MOST_GROUPS = 20
"""Types of inputs and outputs, together."""

N_CELLS = _GROUPS + GROUP_CELLS * MOST_GROUPS


_INT, _LONG, _DOUBLE = ir.IntType(32), ir.IntType(64), ir.DoubleType()


def _call(builder, kinds, arguments):
    """Call what is at the first of ``arguments`` with the others, as an int32 function of ``kinds``."""
    function = builder.inttoptr(arguments[0], ir.FunctionType(_INT, kinds).as_pointer())
    return builder.call(function, arguments[1:])


@_intrinsic
def _called(typingctx, function, argument):
    """``function(argument)``, both addresses: an int32."""

    def codegen(context, builder, signature, arguments):
        return _call(builder, [_LONG], arguments)

    return types.int32(types.int64, types.int64), codegen


@_intrinsic
def _values_2(typingctx, function, instance, references, n, values):
    """``fmi2SetReal(instance, references, n, values)`` and its like; all but n are addresses."""

    def codegen(context, builder, signature, arguments):
        return _call(builder, [_LONG] * 4, arguments)

    return types.int32(*[types.int64] * 5), codegen


@_intrinsic
def _values_3(typingctx, function, instance, references, n, values, n_values):
    """``fmi3SetFloat64(instance, references, n, values, n_values)`` and its like."""

    def codegen(context, builder, signature, arguments):
        return _call(builder, [_LONG] * 5, arguments)

    return types.int32(*[types.int64] * 6), codegen


@_intrinsic
def _do_step_2(typingctx, function, instance, time_s, step_s, no_way_back):
    """``fmi2DoStep(instance, time, step, noSetFMUStatePriorToCurrentPoint)``."""

    def codegen(context, builder, signature, arguments):
        return _call(builder, [_LONG, _DOUBLE, _DOUBLE, _INT], arguments)

    return types.int32(types.int64, types.int64, types.float64, types.float64, types.int32), codegen


@_intrinsic
def _do_step_3(typingctx, function, instance, time_s, step_s, no_way_back, event, terminate, early, last):
    """``fmi3DoStep``; the last four are the addresses of what it answers."""

    def codegen(context, builder, signature, arguments):
        return _call(builder, [_LONG, _DOUBLE, _DOUBLE, _INT, *[_LONG] * 4], arguments)

    inputs = [types.int64, types.int64, types.float64, types.float64, types.int32, *[types.int64] * 4]
    return types.int32(*inputs), codegen


@_intrinsic
def _pointer(typingctx, address):
    """``address`` as a pointer to memory."""

    def codegen(context, builder, signature, arguments):
        return builder.inttoptr(arguments[0], ir.IntType(8).as_pointer())

    return types.voidptr(types.int64), codegen


def group(k):
    """The cells of the group number ``k``, those that set before those that get."""
    first = _GROUPS + GROUP_CELLS * k
    return slice(first, first + GROUP_CELLS)


@njit(inline="always")
def _ended(block, where, status):
    block[WHERE], block[STATUS] = where, status
    return np.int32(status)


@cfunc(types.int32(types.int64), cache=True)
def _step_2(address):
    block, times = carray(_pointer(address), N_CELLS, np.int64), carray(_pointer(address), N_CELLS, np.float64)
    instance, n_sets, n_groups = block[INSTANCE], block[N_SETS], block[N_SETS] + block[N_GETS]
    for k in range(n_sets):
        g = _GROUPS + GROUP_CELLS * k
        status = _values_2(block[g], instance, block[g + 1], block[g + 2], block[g + 3])
        if status > WARNING:
            return _ended(block, k, status)
    status = _do_step_2(block[DO_STEP], instance, times[TIME], times[STEP_SIZE], np.int32(block[NO_WAY_BACK]))
    if status > WARNING:
        return _ended(block, STEP, status)
    for k in range(n_sets, n_groups):
        g = _GROUPS + GROUP_CELLS * k
        status = _values_2(block[g], instance, block[g + 1], block[g + 2], block[g + 3])
        if status > WARNING:
            return _ended(block, k, status)
    return np.int32(0)


@cfunc(types.int32(types.int64), cache=True)
def _step_3(address):
    block, times = carray(_pointer(address), N_CELLS, np.int64), carray(_pointer(address), N_CELLS, np.float64)
    instance, n_sets, n_groups = block[INSTANCE], block[N_SETS], block[N_SETS] + block[N_GETS]
    for k in range(n_sets):
        g = _GROUPS + GROUP_CELLS * k
        status = _values_3(block[g], instance, block[g + 1], block[g + 2], block[g + 3], block[g + 4])
        if status > WARNING:
            return _ended(block, k, status)
    block[FLAGS] = 0
    flags, last = address + 8 * FLAGS, address + 8 * _LAST_TIME
    no_way_back = np.int32(block[NO_WAY_BACK])
    status = _do_step_3(
        block[DO_STEP], instance, times[TIME], times[STEP_SIZE], no_way_back, flags, flags + 1, flags + 2, last
    )
    if status > WARNING:
        return _ended(block, STEP, status)
    if block[FLAGS] & 0xFF00:  # the second byte: terminateSimulation
        return _ended(block, END_ASKED, WARNING + 1)
    for k in range(n_sets, n_groups):
        g = _GROUPS + GROUP_CELLS * k
        status = _values_3(block[g], instance, block[g + 1], block[g + 2], block[g + 3], block[g + 4])
        if status > WARNING:
            return _ended(block, k, status)
    return np.int32(0)


STEPS = {2: _step_2.address, 3: _step_3.address}
"""Addresses of the steps, by the major version of the standard: int32 functions of a block's address."""


@njit(nogil=True, cache=True)
def advance(step, block, time, first_step, dt_s, inputs, outputs, u, y):
    """Put a row of ``u`` into ``inputs``, step, and take a row of ``y`` from ``outputs``, as often as there are rows.

    ``step`` is one of `STEPS`, ``block`` the address of its block; ``time``, ``inputs`` and ``outputs`` are memory
    (float) to which the block points. Returns the rows done; where these are fewer, the block says what ended it.
    """
    for k in range(len(u)):
        time[0] = (first_step + k) * dt_s
        for j in range(len(inputs)):
            inputs[j] = u[k, j]
        if _called(step, block) > WARNING:
            return k
        for j in range(len(outputs)):
            y[k, j] = outputs[j]
    return len(u)
