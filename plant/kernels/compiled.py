"""Kernels whose machine code is kept: every process but the first calls them without the compiler.

Importing numba costs more than the simulation of a whole sweep, and so does unpickling what its own cache holds.
`njit` here stands for numba's. A function with ``cache=True`` is compiled by numba once; its object code goes into a
file, and from then on llvmlite alone loads it and ctypes calls it. All else (functions without ``cache``, arguments
that are no plain numbers and arrays, functions that return something or allocate) is numba's as it ever was.

The code is what numba's own cache would hold but for one attribute, the alignment of the stack: spilled vectors that
straddle cache lines cost time (docs/performance.md). Its files are those of `kept`.
"""

from __future__ import annotations

import ctypes
import functools
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .kept import alone, is_whole, path_of, read, write

_NO_WAY_IN = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}

_ARRAY_HEAD, _VALUES = "pp", {"f": "double", "i": "i64", "p": "ptr", "b": "i8"}

_lock = threading.RLock()
_under_way = threading.local()
"""Whether this thread makes code that is kept."""

_engines: list[Any] = []
"""Owners of loaded code: it lives as long as the process."""

Code = Callable[[Sequence[Any]], Any]


def njit(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """`numba.njit`, but that numba is imported only where there is something to compile."""
    if function is None:
        return functools.partial(njit, **options)
    return function if os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0") else Kernel(function, options)


def each(kernel: Any, arguments: Sequence[Any], stacked: Sequence[int]) -> None:
    """`Kernel.each`, of a function that is not compiled as well."""
    if isinstance(kernel, Kernel):
        kernel.each(arguments, stacked)
        return
    for one in _one_by_one(arguments, stacked):
        kernel(*one)


def _one_by_one(arguments: Sequence[Any], stacked: Sequence[int]) -> Iterator[list[Any]]:
    """The arguments of each call, of which those ``stacked`` are entries of theirs."""
    for k in range(len(arguments[stacked[0]])):
        yield [x[k] if at in stacked else x for at, x in enumerate(arguments)]


class intrinsic:
    """`numba.extending.intrinsic`, but that numba is imported only where there is something to compile."""

    def __init__(self, function: Callable[..., Any]):
        self.__doc__ = function.__doc__
        self._function = function

    def __call__(self, *arguments: Any) -> Any:
        """Only within a kernel."""
        raise NotImplementedError(f"{self._function.__name__} is called by compiled code alone")

    @functools.cached_property
    def _numba_type_(self) -> Any:
        """How numba sees this function among the names that a kernel uses."""
        from numba.core.registry import cpu_target
        from numba.extending import intrinsic as of_numba

        made, context = of_numba(self._function), cpu_target.typing_context
        context.refresh()  # what was registered just now
        return context.resolve_value_type(made)


class Kernel:
    """A function that is compiled when it is called, or called by another that is compiled.

    Attributes
    ----------
    py_func : function
        What is compiled.
    """

    def __init__(self, function: Callable[..., Any], options: dict[str, Any]):
        functools.update_wrapper(self, function)
        self.py_func = function
        self._options = options
        self._codes: dict[str, Code] = {}

    def __call__(self, *arguments: Any) -> Any:
        return self._code(arguments)(arguments)

    def _code(self, arguments: Sequence[Any]) -> Code:
        kinds = ",".join(_kind(argument) for argument in arguments)
        code = self._codes.get(kinds)
        if code is None:
            with _lock:
                code = self._codes[kinds] = self._found(kinds, arguments)
        return code

    def each(self, arguments: Sequence[Any], stacked: Sequence[int]) -> None:
        """Call it for every entry of some arguments, by their numbers: stacks of arrays along their first axis.

        Where it can, the interpreter is let go of once for all of them.
        """
        calls = _one_by_one(arguments, stacked)
        first = next(calls)
        code = self._code(first)
        if isinstance(code, _Loaded):
            code.each(first, len(arguments[stacked[0]]), {at: arguments[at].strides[0] for at in stacked})
            return
        code(first)
        for further in calls:
            code(further)

    @functools.cached_property
    def dispatcher(self) -> Any:
        """Numba's own, for what cannot be kept here; its cache notices an edit of the function's own file alone."""
        import numba

        kept = self._options.get("cache", False) and is_whole(Path(self.py_func.__code__.co_filename))
        return numba.njit(**(self._options | {"cache": kept}))(self.py_func)

    @functools.cached_property
    def _within_kernels(self) -> Any:
        """What other kernels call: without a way in from Python, which takes the compiler a fifth of its time."""
        import numba

        if self._options.get("cache"):
            return self.dispatcher
        return numba.njit(**(self._options | _NO_WAY_IN))(self.py_func)

    @functools.cached_property
    def _part(self) -> Any:
        """What code that is kept is made of; it cannot be called by any other."""
        from .compiler import to_text

        return to_text(self.py_func, self._options | _NO_WAY_IN)

    @property
    def _numba_type_(self) -> Any:
        """How numba sees this function among the names that a kernel uses."""
        return (self._part if getattr(_under_way, "kept", False) else self._within_kernels)._numba_type_

    def _found(self, kinds: str, arguments: Sequence[Any]) -> Code:
        kept = None
        if self._options.get("cache") and "?" not in kinds and (path := path_of(self.py_func, self._options, kinds)):
            kept = read(path) or self._made(path, arguments)
        if kept and kept[0]:
            return _loaded(*kept, "".join(map(_letters, arguments)))
        return lambda arguments: self.dispatcher(*map(_plain, arguments))

    def _made(self, path: Path, arguments: Sequence[Any]) -> tuple[str, bytes]:
        """Name and object code, compiled by the first process that asks for it; others wait for what it leaves."""
        with alone(path):
            return read(path) or write(path, *self._compiled(arguments))

    def _compiled(self, arguments: Sequence[Any]) -> tuple[str, bytes]:
        """Name and object code; empty where it cannot stand alone, or numba is inside not as the compiler knows it."""
        _under_way.kept = True
        try:
            from .compiler import code_of

            letters = "".join(map(_letters, arguments))
            given = ["ptr", "ptr", *(_VALUES[letter] for letter in letters)]
            return code_of(self.py_func, self._options | _NO_WAY_IN | {"_nrt": False}, map(_plain, arguments), given)
        except (ImportError, AttributeError, TypeError):
            return "", b""
        finally:
            _under_way.kept = False


# ---------------------------------------------------------------------- arguments


class Fixed:
    """An argument that is handed over again and again: what a kernel takes of it is found once.

    Its arrays must stay where they are; it keeps them.

    Attributes
    ----------
    argument : object
        The argument itself.
    """

    def __init__(self, argument: Any):
        self.argument = argument
        self._kind, self._letters, self._values = _kind(argument), _letters(argument), tuple(_values(argument))


def _plain(argument: Any) -> Any:
    return argument.argument if isinstance(argument, Fixed) else argument


_KINDS = {type(None): "n", bool: "b", int: "i", complex: "c", np.complex128: "c"}
_LETTERS = {"n": "p", "c": "ff"}


def _kind(argument: Any) -> str:
    """What numba makes of an argument, as far as it can be handed over without it; "?" where it cannot."""
    if isinstance(argument, Fixed):
        return argument._kind
    if isinstance(argument, np.ndarray):
        flags = argument.flags
        plain = flags.c_contiguous and flags.aligned and argument.dtype.isnative
        return f"{argument.dtype.str}[{argument.ndim}]{'' if flags.writeable else 'r'}" if plain else "?"
    if isinstance(argument, tuple):
        floats = set(map(type, argument)) == {float}
        return f"{type(argument).__name__}({len(argument) * 'f' if floats else ','.join(map(_kind, argument))})"
    return "f" if isinstance(argument, float) else _KINDS.get(type(argument), "?")


def _letters(argument: Any) -> str:
    """The values that a kernel takes for an argument: pointers (p), integers (i), floats (f), truths (b)."""
    if isinstance(argument, Fixed):
        return argument._letters
    if isinstance(argument, np.ndarray):  # owner, its parent, size, item size, data, shape, strides
        return _ARRAY_HEAD + "iip" + 2 * argument.ndim * "i"
    if isinstance(argument, tuple):
        return len(argument) * "f" if set(map(type, argument)) == {float} else "".join(map(_letters, argument))
    kind = _kind(argument)
    return _LETTERS.get(kind, kind)


def _values(argument: Any) -> Sequence[Any]:
    if isinstance(argument, Fixed):
        return argument._values
    if isinstance(argument, np.ndarray):
        head = None, None, argument.size, argument.itemsize, argument.ctypes.data
        return (*head, *argument.shape, *argument.strides)
    if isinstance(argument, tuple):
        return argument if set(map(type, argument)) == {float} else [x for part in argument for x in _values(part)]
    return (argument.real, argument.imag) if isinstance(argument, complex) else (argument,)


_DATA = 4
"""Where the address of its numbers stands among the values of an array."""

_CTYPES = {"p": ctypes.c_void_p, "i": ctypes.c_int64, "f": ctypes.c_double, "b": ctypes.c_uint8}


# ---------------------------------------------------------------------- code


def _loaded(name: str, code: bytes, letters: str) -> Code:
    """The function of that name, from object code, for such arguments; it lets go of the interpreter while it runs."""
    import llvmlite.binding as llvm

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    machine = llvm.Target.from_default_triple().create_target_machine(jit=True)
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine)
    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    _engines.append(engine)
    return _Loaded(engine.get_function_address(name), letters)


class _Loaded:
    """A kernel's machine code, called by ctypes: it lets go of the interpreter while it runs."""

    def __init__(self, address: int, letters: str):
        self.address, self._letters = address, letters
        self._taken = (_CTYPES["p"], _CTYPES["p"], *(_CTYPES[letter] for letter in letters))
        self._function = ctypes.CFUNCTYPE(ctypes.c_int32, *self._taken)(address)
        self._unused = (ctypes.c_void_p * 2)()  # where an answer and an error would go
        self._outcome = ctypes.addressof(self._unused), ctypes.addressof(self._unused) + ctypes.sizeof(ctypes.c_void_p)

    def __call__(self, arguments: Sequence[Any]) -> None:
        _check(self._function(*self._outcome, *(value for argument in arguments for value in _values(argument))))

    def each(self, first: Sequence[Any], n: int, strides: dict[int, int]) -> None:
        """Call it ``n`` times: the data of some arguments move by so many bytes from one call to the next."""
        values = [value for argument in first for value in _values(argument)]
        sizes = [len(_letters(argument)) for argument in first]
        moves = [0] * len(values)
        for at, stride in strides.items():
            moves[sum(sizes[:at]) + _DATA] = stride
        pointers = [move for move, letter in zip(moves, self._letters, strict=True) if letter == "p"]
        _check(self._loop(self.address, n, *pointers, *self._outcome, *values))

    @functools.cached_property
    def _loop(self) -> Any:
        """A function of the code's address, the number of calls, bytes to move each pointer by, and the arguments."""
        engine = _linked(_loop_text(self._letters))
        moves = (ctypes.c_int64,) * self._letters.count("p")
        kind = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_void_p, ctypes.c_int64, *moves, *self._taken)
        return kind(engine.get_function_address("loop"))


def callback(kernel: Kernel, cell: int) -> int:
    """Address of an int32 function of an address, for whatever calls functions by address.

    It calls the kernel with that address, and gives what then stands in the cell of that number, of 8 bytes each.
    Zero where the kernel is numba's own: see `address_of`.
    """
    code = kernel._code((0,))
    if not isinstance(code, _Loaded):
        return 0
    engine = _linked(f"""
define i32 @callback(i64 %block) {{
  %room = alloca [2 x ptr]
  %code = inttoptr i64 {code.address} to ptr
  %status = call i32 %code(ptr %room, ptr %room, i64 %block)
  %place = add i64 %block, {8 * cell}
  %cell = inttoptr i64 %place to ptr
  %found = load i64, ptr %cell
  %answer = trunc i64 %found to i32
  ret i32 %answer
}}
""")
    return int(engine.get_function_address("callback"))


def address_of(function: Callable[[int], int]) -> int:
    """Address of an int32 function of an address, compiled by numba in every process."""
    import numba

    made = numba.cfunc(numba.int32(numba.int64))(function)
    _engines.append(made)
    return int(made.address or 0)


def _linked(text: str) -> Any:
    """The engine that holds the code of LLVM's text."""
    import llvmlite.binding as llvm

    machine = llvm.Target.from_default_triple().create_target_machine(jit=True)
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(text), machine)
    engine.finalize_object()
    _engines.append(engine)
    return engine


def _check(status: int) -> None:
    if status not in (0, -2):  # fine, and numba's way to say "None"
        raise SystemError(f"a kernel ended with status {status}")


def _loop_text(letters: str) -> str:
    """LLVM's text of the loop over a function that takes such values; it ends where a call fails."""
    pointers = [k for k, letter in enumerate(letters) if letter == "p"]
    taken = "".join(f", i64 %by{k}" for k in pointers)
    given = "".join(f", {_VALUES[letter]} %a{k}" for k, letter in enumerate(letters))
    moved = "\n".join(
        f"  %o{k} = mul i64 %n, %by{k}\n  %m{k} = getelementptr i8, ptr %a{k}, i64 %o{k}" for k in pointers
    )
    passed = "".join(f", {_VALUES[x]} %{'m' if x == 'p' else 'a'}{k}" for k, x in enumerate(letters))
    return f"""
define i32 @loop(ptr %code, i64 %times{taken}, ptr %answer, ptr %error{given}) {{
begin:
  br label %next
next:
  %n = phi i64 [0, %begin], [%after, %next]
{moved}
  %status = call i32 %code(ptr %answer, ptr %error{passed})
  %after = add i64 %n, 1
  %none = icmp eq i32 %status, -2
  %zero = icmp eq i32 %status, 0
  %fine = or i1 %none, %zero
  %more = icmp slt i64 %after, %times
  %on = and i1 %fine, %more
  br i1 %on, label %next, label %end
end:
  ret i32 %status
}}
"""
