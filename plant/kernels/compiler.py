"""How code that is kept is made: by numba, but for what only numba's own way to call it needs.

A kernel is made of some dozens of small functions that are inlined into it. Of these numba would make machine code
too, which nobody calls, and for every sum in them it tries dozens of rules, of arrays, strings and sets as well. Here
they stay intermediate code, and rules are asked for once: the same numbers in about three quarters of the time.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from typing import Any, ClassVar

import llvmlite.binding as llvm
import numba
from numba.core import compiler, compiler_machinery, typed_passes, types
from numba.core.codegen import JITCodeLibrary
from numba.core.errors import NumbaError

_STACK = " alignstack(64)"
_LIBM = {"atan2", "cos", "exp", "fmod", "hypot", "log", "pow", "sin", "sqrt", "tan"}
"""Functions that every process of Python has at hand."""


def code_of(
    function: Callable[..., Any], options: dict[str, Any], arguments: Iterable[Any], given: Sequence[str]
) -> tuple[str, bytes]:
    """Name and object code of the function for such arguments; empty where it cannot stand alone.

    Parameters
    ----------
    function : function
        What is compiled; what it calls is asked for its type in numba's way.
    options : dict
        Of `numba.njit`.
    arguments : iterable
        As the function takes them.
    given : sequence of str
        LLVM's kinds of the values that it will be called with.
    """
    dispatcher = to_text(function, options)
    try:
        dispatcher.compile(tuple(map(numba.typeof, arguments)))
    except NumbaError:  # it allocates, or is wrong: the ordinary way tells
        return "", b""
    (found,) = dispatcher.overloads.values()
    name, library = found.fndesc.llvm_func_name, found.library
    text = library.get_llvm_str()
    if found.signature.return_type != types.none or not _stands_alone(text, name, given):
        return "", b""
    return name, _object_code(text, library.codegen.machine)


def to_text(function: Callable[..., Any], options: dict[str, Any]) -> Any:
    """Numba's dispatcher of a function that is compiled to intermediate code alone."""
    return numba.njit(**(options | {"cache": False, "pipeline_class": _Compiler}))(function)


def _stands_alone(text: str, name: str, given: Sequence[str]) -> bool:
    """Whether the function takes what it is given, and asks for nothing but LLVM's own functions and libm's."""
    head = re.search(rf'^define .*@"?{re.escape(name)}"?\((.*?)\) local_unnamed_addr|^\Z', text, re.MULTILINE)
    if head is None or head[1] is None:
        return False
    taken = [part.split()[0] for part in re.sub(r"\([^()]*(\([^()]*\)[^()]*)*\)", "", head[1]).split(",")]
    asked = re.findall(r'^declare .*?@"?([\w.]+)"?\(', text, re.MULTILINE)
    return taken == given and all(function.startswith("llvm.") or function in _LIBM for function in asked)


def _object_code(text: str, machine: Any) -> bytes:
    """Object code, its stack aligned for the widest vectors."""
    aligned = re.sub(r"^(define .*?)( \{)$", rf"\1{_STACK}\2", text, flags=re.MULTILINE)
    return bytes(machine.emit_object(llvm.parse_assembly(aligned)))


# ---------------------------------------------------------------------- numba's ways, shortened


class _Generator:
    """What numba asks of the generator of code that is not loaded."""

    def __init__(self, machine: Any):
        self.machine = machine

    def set_env(self, name: str, env: Any) -> None:
        """There is no code to be told of its environment."""


class _Text(JITCodeLibrary):
    """A library of intermediate code, optimised as numba's own are, of which no machine code is made."""

    @property
    def codegen(self) -> Any:
        """The generator."""
        return _Generator(self._codegen._tm)

    def get_pointer_to_function(self, name: str) -> int:
        """Zero, numba's word for a function that Python does not call."""
        self._ensure_finalized()
        return 0

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._verify_declare_only_symbols()
        self._finalized = True


class _Remembering:
    """A typing context that asks numba once for each operation and kinds of operands."""

    _known: ClassVar[dict[Any, Any]] = {}

    def __init__(self, context: Any):
        self._context = context

    def __getattr__(self, name: str) -> Any:
        return getattr(self._context, name)

    def resolve_function_type(self, function: Any, taken: Sequence[Any], named: Any) -> Any:
        """The signature, as numba's own context finds it."""
        if named or not isinstance(function, types.Function) or not all(map(_is_plain, taken)):
            return self._context.resolve_function_type(function, taken, named)
        key = function, *taken
        if key not in self._known:
            self._known[key] = self._context.resolve_function_type(function, taken, named)
        return self._known[key]


def _is_plain(kind: Any) -> bool:
    return isinstance(kind, types.Number | types.Array)


@compiler_machinery.register_pass(mutates_CFG=False, analysis_only=True)
class _Remember(compiler_machinery.AnalysisPass):
    """Types are found by a context that remembers."""

    _name = "seqsweep_remember"

    def __init__(self) -> None:
        super().__init__()

    def run_pass(self, state: Any) -> bool:
        state.typingctx = _Remembering(state.typingctx)
        return False


@compiler_machinery.register_pass(mutates_CFG=False, analysis_only=True)
class _IntoText(compiler_machinery.AnalysisPass):
    """The lowered code goes into a library that is not loaded."""

    _name = "seqsweep_into_text"

    def __init__(self) -> None:
        super().__init__()

    def run_pass(self, state: Any) -> bool:
        state.library = _Text(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        return False


class _Compiler(compiler.CompilerBase):
    """Numba's passes, and these two."""

    def define_pipelines(self) -> list[Any]:
        """One pipeline."""
        passes = compiler_machinery.PassManager("seqsweep_to_text")
        for taken, told in compiler.DefaultPassBuilder.define_nopython_pipeline(self.state).passes:
            for before in _BEFORE.get(taken, ()):
                passes.add_pass(before)
            passes.add_pass(taken, told)
        passes.finalize()
        return [passes]


_BEFORE = {typed_passes.NopythonTypeInference: (_Remember,), typed_passes.NativeLowering: (_IntoText,)}
