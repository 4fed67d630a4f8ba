"""An FMI 2.0 co-simulation FMU, stepped through the addresses of its functions.

The addresses are numbers, so that one compiled kernel serves every FMU. A status above warning ends the loop.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import extending, njit, types

_intrinsic: Any = extending.intrinsic  # its annotations have the typing context among the arguments

WARNING = 1

SET_REAL, DO_STEP, GET_REAL = 0, 1, 2
"""Which call ended a loop."""

_INT, _LONG, _DOUBLE, _ADDRESS = ir.IntType(32), ir.IntType(64), ir.DoubleType(), ir.IntType(8).as_pointer()


def _call(builder, address, kinds, arguments):
    """Call what is at ``address`` as an int32 function of ``kinds``."""
    function = builder.inttoptr(address, ir.FunctionType(_INT, kinds).as_pointer())
    given = [
        builder.inttoptr(argument, kind) if kind is _ADDRESS else argument
        for argument, kind in zip(arguments, kinds, strict=True)
    ]
    return builder.call(function, given)


@_intrinsic
def _values(typingctx, function, component, references, n, values):
    """``function(component, references, n, values)``: fmi2SetReal or fmi2GetReal; all but n are addresses."""

    def codegen(context, builder, signature, arguments):
        return _call(builder, arguments[0], [_ADDRESS, _ADDRESS, _LONG, _ADDRESS], arguments[1:])

    return types.int32(*[types.int64] * 5), codegen


@_intrinsic
def _do_step(typingctx, function, component, time_s, step_s, no_way_back):
    """``fmi2DoStep(component, time, step, noSetFMUStatePriorToCurrentPoint)``."""

    def codegen(context, builder, signature, arguments):
        return _call(builder, arguments[0], [_ADDRESS, _DOUBLE, _DOUBLE, _INT], arguments[1:])

    return types.int32(types.int64, types.int64, types.float64, types.float64, types.int32), codegen


@njit(nogil=True, cache=True)
def advance(functions, component, inputs, outputs, first_step, dt_s, no_way_back, u, y):
    """Set a row of ``u``, step, and get a row of ``y``, as often as there are rows.

    ``functions`` are the addresses of fmi2SetReal, fmi2DoStep and fmi2GetReal; ``inputs`` and ``outputs``
    the value references (uint32). Returns (rows done, which call ended the loop, its status).
    """
    set_real, do_step, get_real = functions
    n_in, n_out = len(inputs), len(outputs)
    input_at, output_at = inputs.ctypes.data, outputs.ctypes.data
    u_at, y_at = u.ctypes.data, y.ctypes.data
    for k in range(len(u)):
        status = _values(set_real, component, input_at, n_in, u_at + 8 * n_in * k)
        if status > WARNING:
            return k, SET_REAL, status
        status = _do_step(do_step, component, (first_step + k) * dt_s, dt_s, no_way_back)
        if status > WARNING:
            return k, DO_STEP, status
        status = _values(get_real, component, output_at, n_out, y_at + 8 * n_out * k)
        if status > WARNING:
            return k, GET_REAL, status
    return len(u), DO_STEP, 0
