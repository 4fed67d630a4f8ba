"""An FMU for co-simulation, stepped through the addresses of its functions.

A `block` of numbers holds all that a step needs: addresses of the functions, value references and values, time and
step. A step is then a function of the block's address, `step_of(2)` for FMI 2.0, `step_of(3)` for FMI 3.0, that
whatever calls functions by address can call: the loop in here, or a circuit with the FMU in it.
"""

from __future__ import annotations

import functools

from .compiled import address_of, callback, intrinsic, njit

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


def _calls(kinds):
    """What an intrinsic gives that calls an address, an int32 function of ``kinds``: i int64, w int32, f double."""
    from llvmlite import ir
    from numba import types
    from numba.core.typing import signature

    low = {"i": ir.IntType(64), "w": ir.IntType(32), "f": ir.DoubleType()}
    high = {"i": types.int64, "w": types.int32, "f": types.float64}

    def code(context, builder, called, arguments):
        prototype = ir.FunctionType(low["w"], [low[kind] for kind in kinds])
        return builder.call(builder.inttoptr(arguments[0], prototype.as_pointer()), arguments[1:])

    return signature(types.int32, types.int64, *(high[kind] for kind in kinds)), code


@intrinsic
def _called(typing_context, function, argument):
    """``function(argument)``, both addresses: an int32."""
    return _calls("i")


@intrinsic
def _values_2(typing_context, function, instance, references, n, values):
    """``fmi2SetReal(instance, references, n, values)`` and its like; all but n are addresses."""
    return _calls("iiii")


@intrinsic
def _values_3(typing_context, function, instance, references, n, values, n_values):
    """``fmi3SetFloat64(instance, references, n, values, n_values)`` and its like."""
    return _calls("iiiii")


@intrinsic
def _do_step_2(typing_context, function, instance, time_s, step_s, no_way_back):
    """``fmi2DoStep(instance, time, step, noSetFMUStatePriorToCurrentPoint)``."""
    return _calls("iffw")


@intrinsic
def _do_step_3(typing_context, function, instance, time_s, step_s, no_way_back, event, terminate, early, last):
    """``fmi3DoStep``; the last four are the addresses of what it answers."""
    return _calls("iffwiiii")


def _at(context, builder, address, cell, kind):
    """A pointer to a cell of a block."""
    from llvmlite import ir

    place = builder.add(address, builder.mul(cell, ir.IntType(64)(8)))
    return builder.inttoptr(place, context.get_value_type(kind).as_pointer())


def _reads(name):
    """What an intrinsic gives that reads a cell of numba's type of that name."""
    from numba import types

    kind = getattr(types, name)

    def code(context, builder, signature, arguments):
        address, place = arguments
        return builder.load(_at(context, builder, address, place, kind))

    return kind(types.int64, types.int64), code


@intrinsic
def _whole(typing_context, block, cell):
    """The integer in a cell of the block at an address."""
    return _reads("int64")


@intrinsic
def _number(typing_context, block, cell):
    """The double in a cell of the block at an address."""
    return _reads("float64")


@intrinsic
def _put(typing_context, block, cell, value):
    """Put an integer into a cell of the block at an address."""
    from numba import types

    def code(context, builder, signature, arguments):
        address, place, whole = arguments
        builder.store(whole, _at(context, builder, address, place, types.int64))
        return context.get_dummy_value()

    return types.void(types.int64, types.int64, types.int64), code


def group(k):
    """The cells of the group number ``k``, those that set before those that get."""
    first = _GROUPS + GROUP_CELLS * k
    return slice(first, first + GROUP_CELLS)


@njit(forceinline=True)
def _end(block, where, status):
    """Where a step ended, and how: the outcome of its function."""
    _put(block, WHERE, where)
    _put(block, STATUS, status)


@njit(forceinline=True)
def _group_2(block, k):
    """The outcome of setting or getting the group number ``k``."""
    g = _GROUPS + GROUP_CELLS * k
    return _values_2(
        _whole(block, g), _whole(block, INSTANCE), _whole(block, g + 1), _whole(block, g + 2), _whole(block, g + 3)
    )


@njit(forceinline=True)
def _group_3(block, k):
    g = _GROUPS + GROUP_CELLS * k
    function, references, n = _whole(block, g), _whole(block, g + 1), _whole(block, g + 2)
    return _values_3(function, _whole(block, INSTANCE), references, n, _whole(block, g + 3), _whole(block, g + 4))


@njit(nogil=True, cache=True)
def _step_2(block):
    """Set, step and get, with the outcome in the block."""
    n_sets = _whole(block, N_SETS)
    for k in range(n_sets):
        status = _group_2(block, k)
        if status > WARNING:
            return _end(block, k, status)
    way_back, time_s, step_s = _whole(block, NO_WAY_BACK), _number(block, TIME), _number(block, STEP_SIZE)
    status = _do_step_2(_whole(block, DO_STEP), _whole(block, INSTANCE), time_s, step_s, way_back)
    if status > WARNING:
        return _end(block, STEP, status)
    for k in range(n_sets, n_sets + _whole(block, N_GETS)):
        status = _group_2(block, k)
        if status > WARNING:
            return _end(block, k, status)
    _put(block, STATUS, 0)


@njit(nogil=True, cache=True)
def _step_3(block):
    """`_step_2` of the other version."""
    n_sets = _whole(block, N_SETS)
    for k in range(n_sets):
        status = _group_3(block, k)
        if status > WARNING:
            return _end(block, k, status)
    _put(block, FLAGS, 0)
    flags, last = block + 8 * FLAGS, block + 8 * _LAST_TIME
    way_back, time_s, step_s = _whole(block, NO_WAY_BACK), _number(block, TIME), _number(block, STEP_SIZE)
    do_step, instance = _whole(block, DO_STEP), _whole(block, INSTANCE)
    status = _do_step_3(do_step, instance, time_s, step_s, way_back, flags, flags + 1, flags + 2, last)
    if status > WARNING:
        return _end(block, STEP, status)
    if _whole(block, FLAGS) & 0xFF00:  # the second byte: terminateSimulation
        return _end(block, END_ASKED, WARNING + 1)
    for k in range(n_sets, n_sets + _whole(block, N_GETS)):
        status = _group_3(block, k)
        if status > WARNING:
            return _end(block, k, status)
    _put(block, STATUS, 0)


@functools.cache
def step_of(version):
    """Address of the step of a major version of the standard: an int32 function of a block's address."""
    step = {2: _step_2, 3: _step_3}[version]
    return callback(step, STATUS) or address_of(_answering(step))


def _answering(step):
    """The step as a function that gives its status, for numba to compile: its version's insides are not as ours."""

    def answer(block):
        step(block)
        return _whole(block, STATUS)

    return answer


@njit(nogil=True, cache=True)
def advance(step, block, time, first_step, dt_s, inputs, outputs, u, y, done):
    """Put a row of ``u`` into ``inputs``, step, and take a row of ``y`` from ``outputs``, as often as there are rows.

    ``step`` is what `step_of` gives, ``block`` the address of its block; ``time``, ``inputs`` and ``outputs`` are
    memory (float) to which the block points. ``done`` (1,) receives the rows done; where these are fewer, the block
    says what ended it.
    """
    done[0] = 0
    for k in range(len(u)):
        time[0] = (first_step + k) * dt_s
        for j in range(len(inputs)):
            inputs[j] = u[k, j]
        if _called(step, block) > WARNING:
            return
        for j in range(len(outputs)):
            y[k, j] = outputs[j]
        done[0] = k + 1
