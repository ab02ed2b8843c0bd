"""How kernels are compiled: machine code for those that Python calls, LLVM code for their parts.

numba compiles every function to optimised machine code of its own, and then puts a copy of its
LLVM code into each caller, where it is translated again; with a hundred kernels that call each
other, half of the time went into code that nobody runs. So a kernel has two dispatchers here: its
own answers Python, as ever, and that of its ``part`` answers other kernels. A part stays LLVM
code, and is optimised and translated once, with the kernel that Python calls. Both are kept on
disk.

What this needs of numba beyond its documented pipeline is named in ``_NEEDED``; where an
attribute of these is missing, kernels are compiled in numba's way, to the same results.
"""

from __future__ import annotations

import functools
from typing import Any, ClassVar

from llvmlite.binding import parse_bitcode
from numba.core import config, types
from numba.core.caching import Cache, CompileResultCacheImpl
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import (
    CompilerBase,
    CompileResult,
    DefaultPassBuilder,
    Flags,
    compile_result,
)
from numba.core.compiler_machinery import PassManager, register_pass
from numba.core.registry import CPUDispatcher
from numba.core.typed_passes import NativeLowering
from numba.core.types import unliteral  # type: ignore[attr-defined]
from numba.core.typing import Context

__all__ = [
    "Kernel",
]

try:
    from llvmlite.binding import PassBuilder, PipelineTuningOptions
except ImportError:  # before 0.45
    PassBuilder = PipelineTuningOptions = None

_NEEDED = {
    JITCodeLibrary: (
        "_optimize_functions",
        "_optimize_final_module",
        "_finalize_final_module",
        "_finalize_dynamic_globals",
    ),
    Context: ("resolve_function_type",),
    CPUDispatcher: ("_numba_type_", "add_overload", "compile"),
    NativeLowering: ("run_pass",),
}

_PARTS = all(hasattr(owner, name) for owner, names in _NEEDED.items() for name in names)


class _Typing(Context):  # type: ignore[misc]
    """numba's knowledge of types, with a memory of what operators give.

    numba looks through its candidates anew for every sum: an eighth of the compiling. Functions are
    looked up anew: what numba keeps of them, another target (CUDA) may have changed meanwhile.
    """

    _known: ClassVar[dict[tuple[Any, ...], Any]] = {}

    def __init__(self, context: Context) -> None:
        self.__dict__ = context.__dict__

    def resolve_function_type(self, func: Any, args: Any, kws: Any) -> Any:
        """Return the signature of a call."""
        name = getattr(getattr(func, "typing_key", None), "__module__", None)
        call = func, tuple(args)
        try:
            remember = name == "_operator" and not kws and hash(call) is not None
        except TypeError:  # a slice with literal limits, before Python 3.12
            remember = False
        signature = self._known.get(call) if remember else None
        if signature is None:
            signature = super().resolve_function_type(func, args, kws)
            if remember and signature is not None:
                self._known[call] = signature
        return signature


# numba keeps what it has compiled of its functions by the context that asked
_typing = functools.cache(_Typing)


class _Library(JITCodeLibrary):  # type: ignore[misc]
    """The code of a kernel that Python calls."""

    def _optimize_functions(self, ll_module: Any) -> None:
        if PipelineTuningOptions is None:
            super()._optimize_functions(ll_module)
        else:  # all at once, below
            ll_module.data_layout = self._codegen._data_layout

    def _optimize_final_module(self) -> None:
        if PipelineTuningOptions is None:
            super()._optimize_final_module()
            return
        tuning = PipelineTuningOptions(config.OPT)
        tuning.loop_vectorization = bool(config.LOOP_VECTORIZE)
        tuning.slp_vectorization = bool(config.SLP_VECTORIZE)
        # what gains by it is unrolled by hand: of the rest it only made twice as much code
        tuning.loop_unrolling = tuning.loop_interleaving = False
        builder = PassBuilder(self._codegen._tm, tuning)
        builder.getModulePassManager().run(self._final_module, builder)


class _PartLibrary(_Library):
    """LLVM code to put into others: not translated."""

    def _optimize_functions(self, ll_module: Any) -> None:
        # numba makes the passes anew for each function, and for all that are only declared
        try:
            passes, builder = self._codegen._function_pass_manager()
        except TypeError:  # numba before 0.62 makes them for a module
            super()._optimize_functions(ll_module)
            return
        ll_module.data_layout = self._codegen._data_layout
        for function in ll_module.functions:
            if not function.is_declaration:
                passes.run(function, builder)

    def _optimize_final_module(self) -> None:
        # sums and the like become vectors before they are inlined: in a long kernel LLVM gives up
        if not self._linking_libraries:
            super()._optimize_final_module()

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True


@register_pass(mutates_CFG=True, analysis_only=False)
class _Lowering(NativeLowering):  # type: ignore[misc]
    """Lower to LLVM code, optimised in our way."""

    _name = "kernel_lowering"
    _library = _Library

    def run_pass(self, state: Any) -> bool:
        """Do as numba does, with a library of ours."""
        name = state.func_id.func_qualname
        state.library = self._library(state.targetctx.codegen(), name)
        state.library.enable_object_caching()
        return bool(super().run_pass(state))


@register_pass(mutates_CFG=True, analysis_only=False)
class _PartLowering(_Lowering):
    """Lower to LLVM code, and let other functions call it by that."""

    _name = "part_lowering"
    _library = _PartLibrary

    def run_pass(self, state: Any) -> bool:
        """Do as numba does for what is executed, but for the executing."""
        state.flags.no_compile = True
        super().run_pass(state)
        lowered, key = state["cr"], object()
        state.targetctx.insert_user_function(key, lowered.fndesc, [state.library])
        state["cr"] = lowered._replace(cfunc=key)
        return True


class _Compiler(CompilerBase):  # type: ignore[misc]
    """numba's pipeline with a lowering and a typing of our own."""

    _lowering = _Lowering

    def __init__(self, typing_context: Any, *arguments: Any) -> None:
        super().__init__(_typing(typing_context), *arguments)

    def define_pipelines(self) -> list[PassManager]:
        passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
        passes.passes = [
            (self._lowering if step is NativeLowering else step, text)
            for step, text in passes.passes
        ]
        passes.finalize()
        return [passes]


class _PartCompiler(_Compiler):
    """The same for parts."""

    _lowering = _PartLowering


class _PartCacheImpl(CompileResultCacheImpl):  # type: ignore[misc]
    """What of a part is written to disk, and how it is read."""

    def reduce(self, cres: Any) -> tuple[Any, ...]:
        library, description = cres.library, cres.fndesc
        description.typemap = description.calltypes = None  # as numba does: for the lowering only
        code = library._final_module.as_bitcode()
        return library.name, code, description, cres.environment, cres.signature

    def rebuild(self, target_context: Any, payload: tuple[Any, ...]) -> CompileResult:
        name, code, description, environment, signature = payload
        library = _PartLibrary(target_context.codegen(), name)
        library._final_module = parse_bitcode(code)
        library._finalize_final_module()
        return compile_result(
            typing_context=target_context.typing_context,
            target_context=target_context,
            library=library,
            fndesc=description,
            environment=environment,
            signature=signature,
            entry_point=object(),
            objectmode=False,
        )

    def get_filename_base(self, fullname: str, abiflags: str) -> str:
        return f"part.{super().get_filename_base(fullname, abiflags)}"


class _PartCache(Cache):  # type: ignore[misc]
    """Parts on disk."""

    _impl_class = _PartCacheImpl


class _Flags(Flags):  # type: ignore[misc]
    """Flags that compare by what was set.

    numba looks its overloads up by type and flags, many times for every operator, and compares
    all options with their defaults each time: a tenth of the compiling.
    """

    __slots__ = ()

    def __hash__(self) -> int:
        return len(self._values)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Flags) and self._values == other._values


class _Dispatcher(CPUDispatcher):  # type: ignore[misc]
    """numba's dispatcher for types without the values of literals, and with quick flags."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self._compiler._customize_flags = _Flags

    def compile(self, sig: Any) -> Any:
        # a number written out in a call would have the kernel compiled once more for that number
        return super().compile(tuple(map(unliteral, sig)))


class _Part(_Dispatcher):
    """What other kernels call of a kernel; Python cannot."""

    def add_overload(self, cres: Any) -> None:
        self.overloads[tuple(cres.signature.args)] = cres

    def enable_caching(self) -> None:
        self._cache = _PartCache(self.py_func)


class Kernel(_Dispatcher):
    """A compiled function; other kernels that call it get its ``part``.

    Parameters
    ----------
    function : callable
        What to compile.
    locals : dict, optional
        See :func:`numba.jit`.
    targetoptions : dict
        Options of :func:`numba.jit`.
    """

    def __init__(self, function: Any, locals: Any = None, targetoptions: Any = None) -> None:
        given = locals or {}  # numba before 0.62 wants a dictionary
        super().__init__(function, given, targetoptions, *((_Compiler,) if _PARTS else ()))
        options = {**(targetoptions or {}), "no_cpython_wrapper": True}
        self.part = _Part(function, given, options, _PartCompiler) if _PARTS else self

    def enable_caching(self) -> None:
        """Keep what is compiled on disk."""
        super().enable_caching()
        if self.part is not self:
            self.part.enable_caching()

    @property
    def _numba_type_(self) -> types.Type:
        return types.Dispatcher(self.part)
