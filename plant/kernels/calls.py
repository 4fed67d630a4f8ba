"""Calls of C functions by their addresses, from compiled code.

The addresses are numbers, so that one compiled kernel serves every library.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import extending, types

_intrinsic: Any = extending.intrinsic  # its annotations have the typing context among the arguments

_INT, _LONG, _DOUBLE = ir.IntType(32), ir.IntType(64), ir.DoubleType()


def _call(builder, kinds, arguments):
    """Call what is at the first of ``arguments`` with the others, as an int32 function of ``kinds``."""
    function = builder.inttoptr(arguments[0], ir.FunctionType(_INT, kinds).as_pointer())
    return builder.call(function, arguments[1:])


@_intrinsic
def called(typingctx, function, argument):
    """``function(argument)``, both addresses: an int32."""

    def codegen(context, builder, signature, arguments):
        return _call(builder, [_LONG], arguments)

    return types.int32(types.int64, types.int64), codegen


@_intrinsic
def values_2(typingctx, function, instance, references, n, values):
    """``fmi2SetReal(instance, references, n, values)`` and its like; all but n are addresses."""

    def codegen(context, builder, signature, arguments):
        return _call(builder, [_LONG] * 4, arguments)

    return types.int32(*[types.int64] * 5), codegen


@_intrinsic
def values_3(typingctx, function, instance, references, n, values, n_values):
    """``fmi3SetFloat64(instance, references, n, values, n_values)`` and its like."""

    def codegen(context, builder, signature, arguments):
        return _call(builder, [_LONG] * 5, arguments)

    return types.int32(*[types.int64] * 6), codegen


@_intrinsic
def do_step_2(typingctx, function, instance, time_s, step_s, no_way_back):
    """``fmi2DoStep(instance, time, step, noSetFMUStatePriorToCurrentPoint)``."""

    def codegen(context, builder, signature, arguments):
        return _call(builder, [_LONG, _DOUBLE, _DOUBLE, _INT], arguments)

    return types.int32(types.int64, types.int64, types.float64, types.float64, types.int32), codegen


@_intrinsic
def do_step_3(typingctx, function, instance, time_s, step_s, no_way_back, event, terminate, early, last):
    """``fmi3DoStep``; the last four are the addresses of what it answers."""

    def codegen(context, builder, signature, arguments):
        return _call(builder, [_LONG, _DOUBLE, _DOUBLE, _INT, *[_LONG] * 4], arguments)

    inputs = [types.int64, types.int64, types.float64, types.float64, types.int32, *[types.int64] * 4]
    return types.int32(*inputs), codegen


@_intrinsic
def pointer(typingctx, address):
    """``address`` as a pointer to memory."""

    def codegen(context, builder, signature, arguments):
        return builder.inttoptr(arguments[0], ir.IntType(8).as_pointer())

    return types.voidptr(types.int64), codegen
