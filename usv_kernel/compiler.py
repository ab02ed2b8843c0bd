"""Compiler of kernels: machine code for calls from Python, LLVM code for calls from kernels.

numba compiles every function to machine code, and then copies its LLVM code into each caller and
translates it again. With a hundred kernels that call each other, half of the compile time goes
into machine code that never runs. So a kernel has two dispatchers. Its own serves Python. That of
its ``part`` serves other kernels: it keeps LLVM code only, which is translated once, with the
kernel that Python calls. Both are kept on disk.

``_NEEDED`` lists the internals of numba that this relies on. Where one is missing, numba compiles
in its own way, with the same results.
"""

from __future__ import annotations

import contextlib
import functools
import pickle
import zlib
from pathlib import Path
from typing import Any, ClassVar

from llvmlite.binding import parse_bitcode
from numba.core import config, types
from numba.core.caching import Cache, CompileResultCacheImpl, IndexDataCacheFile
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
from numba.core.serialize import dumps
from numba.core.typed_passes import NativeLowering
from numba.core.types import unliteral  # type: ignore[attr-defined]
from numba.core.typing import Context

from usv_kernel.errors import UsvTwinError
from usv_kernel.warmup import deferred_interrupt

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

_FILES = all(
    hasattr(IndexDataCacheFile, name)
    for name in ("_load_index", "_save_index", "_load_data", "_save_data", "_open_for_write")
)


_UNUSED = {
    "annotate_types",
    "dump_parfor_diagnostics",
    "find_literally",
    "inline_closure_likes",
    "inline_inlinables",
    "inline_overloads",
    "literal_unroll",
    "LiteralPropagation",
    "make_function_op_code_to_jit_function",
    "nopython_rewrites",
    "Rewrite dynamic raises",
    "with_lifting",
}
"""Passes of numba for what no kernel has: closures, array expressions, contexts, annotations."""


class _Typing(Context):  # type: ignore[misc]
    """numba's typing context with a cache for operators: look-ups take an eighth of a compile."""

    _known: ClassVar[dict[tuple[Any, ...], Any]] = {}

    def __init__(self, context: Context) -> None:
        self.__dict__ = context.__dict__

    def resolve_function_type(self, func: Any, args: Any, kws: Any) -> Any:
        """Return the signature of a call."""
        origin = getattr(getattr(func, "typing_key", func), "__module__", None)
        call = func, tuple(args)
        try:
            known = isinstance(func, str) or origin in ("_operator", "builtins", "math")
            remember = known and not kws and hash(call) is not None
        except TypeError:  # a slice with literal limits, before Python 3.12
            remember = False
        signature = self._known.get(call) if remember else None
        if signature is None:
            signature = super().resolve_function_type(func, args, kws)
            if remember and signature is not None:
                self._known[call] = signature
        return signature


# one object for each context: numba caches compiled functions by it
_typing = functools.cache(_Typing)


class _Library(JITCodeLibrary):  # type: ignore[misc]
    """Code of a kernel that Python calls."""

    def _optimize_functions(self, ll_module: Any) -> None:
        if PipelineTuningOptions is None:
            super()._optimize_functions(ll_module)
        else:  # _optimize_final_module does it
            ll_module.data_layout = self._codegen._data_layout

    def _optimize_final_module(self) -> None:
        if PipelineTuningOptions is None:
            super()._optimize_final_module()
            return
        tuning = PipelineTuningOptions(config.OPT)
        tuning.loop_vectorization = bool(config.LOOP_VECTORIZE)
        tuning.slp_vectorization = bool(config.SLP_VECTORIZE)
        # loops that gain by it are unrolled by hand; of the others it doubles the code
        tuning.loop_unrolling = tuning.loop_interleaving = False
        builder = PassBuilder(self._codegen._tm, tuning)
        builder.getModulePassManager().run(self._final_module, builder)


class _PartLibrary(_Library):
    """LLVM code for other kernels; never translated on its own."""

    def _optimize_functions(self, ll_module: Any) -> None:
        # numba would create the passes for each function, also for mere declarations
        try:
            passes, builder = self._codegen._function_pass_manager()
        except TypeError:  # numba before 0.62 creates them for a module
            super()._optimize_functions(ll_module)
            return
        ll_module.data_layout = self._codegen._data_layout
        for function in ll_module.functions:
            if not function.is_declaration:
                passes.run(function, builder)

    def _optimize_final_module(self) -> None:
        # vectorise leaf functions before they are inlined: LLVM gives up in long kernels
        if not self._linking_libraries:
            super()._optimize_final_module()

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True


@register_pass(mutates_CFG=True, analysis_only=False)
class _Lowering(NativeLowering):  # type: ignore[misc]
    """Lowering to LLVM code with a library of this module."""

    _name = "kernel_lowering"
    _library = _Library

    def run_pass(self, state: Any) -> bool:
        """Run numba's pass with our library."""
        name = state.func_id.func_qualname
        state.library = self._library(state.targetctx.codegen(), name)
        state.library.enable_object_caching()
        return bool(super().run_pass(state))


@register_pass(mutates_CFG=True, analysis_only=False)
class _PartLowering(_Lowering):
    """Lowering to LLVM code that other kernels call."""

    _name = "part_lowering"
    _library = _PartLibrary

    def run_pass(self, state: Any) -> bool:
        """Run the pass without translation to machine code."""
        state.flags.no_compile = True
        super().run_pass(state)
        lowered, key = state["cr"], object()
        state.targetctx.insert_user_function(key, lowered.fndesc, [state.library])
        state["cr"] = lowered._replace(cfunc=key)
        return True


class _Compiler(CompilerBase):  # type: ignore[misc]
    """numba's pipeline with the lowering and the typing context of this module."""

    _lowering = _Lowering

    def __init__(self, typing_context: Any, *arguments: Any) -> None:
        super().__init__(_typing(typing_context), *arguments)

    def define_pipelines(self) -> list[PassManager]:
        passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
        passes.passes = [
            (self._lowering if step is NativeLowering else step, text)
            for step, text in passes.passes
            if step.name() not in _UNUSED
        ]
        passes.finalize()
        return [passes]


class _PartCompiler(_Compiler):
    """Compiler of parts."""

    _lowering = _PartLowering


class _PartCacheImpl(CompileResultCacheImpl):  # type: ignore[misc]
    """Writes a part to disk and reads it."""

    def reduce(self, cres: Any) -> tuple[Any, ...]:
        library, description = cres.library, cres.fndesc
        description.typemap = description.calltypes = None  # needed for the lowering only
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


class _CacheFile(IndexDataCacheFile):  # type: ignore[misc]
    """Files of compiled code with a checksum: what is damaged counts as missing.

    numba would stop at every later command, or run damaged machine code.
    """

    def save(self, key: Any, data: Any) -> None:
        with contextlib.suppress(OSError):  # a full disk: the next process compiles again
            super().save(key, data)

    def _load_index(self) -> dict[Any, str]:
        try:
            version, stamp, overloads = _opened(self._index_path)
        except (OSError, _DamageError):
            return {}
        fresh = version == self._version and stamp == self._source_stamp
        return overloads if fresh else {}

    def _save_index(self, overloads: dict[Any, str]) -> None:
        with self._open_for_write(self._index_path) as file:
            file.write(_sealed((self._version, self._source_stamp, overloads)))

    def _load_data(self, name: str) -> Any:
        try:
            return _opened(self._data_path(name))
        except _DamageError:
            raise FileNotFoundError from None  # numba compiles, and writes it again

    def _save_data(self, name: str, data: Any) -> None:
        with self._open_for_write(self._data_path(name)) as file:
            file.write(_sealed(data))


class _DamageError(UsvTwinError):
    """A file of compiled code that is damaged or outdated; never seen outside of this module."""


def _sealed(data: Any) -> bytes:
    """Return data as bytes with a checksum before them."""
    content = dumps(data)
    return zlib.crc32(content).to_bytes(4, "big") + content


def _opened(path: str) -> Any:
    """Return the data of a file that :func:`_sealed` made."""
    content = Path(path).read_bytes()
    if zlib.crc32(content[4:]).to_bytes(4, "big") != content[:4]:
        raise _DamageError(f"{path}: is damaged")
    try:
        return pickle.loads(content[4:])
    except (ImportError, AttributeError):  # of types that an earlier version had
        raise _DamageError(f"{path}: is outdated") from None


def _check_files(cache: Any) -> None:
    """Let a cache of numba use files with checksums."""
    if _FILES:
        cache._cache_file.__class__ = _CacheFile


class _PartCache(Cache):  # type: ignore[misc]
    """Disk cache of parts."""

    _impl_class = _PartCacheImpl


class _Flags(Flags):  # type: ignore[misc]
    """Flags that compare by the options set: comparing all defaults is a tenth of a compile."""

    __slots__ = ()

    def __hash__(self) -> int:
        return len(self._values)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Flags) and self._values == other._values


class _Dispatcher(CPUDispatcher):  # type: ignore[misc]
    """numba's dispatcher, without specialisation for literal arguments."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self._compiler._customize_flags = _Flags

    def compile(self, sig: Any) -> Any:
        with deferred_interrupt():
            # else a constant in a call would compile the kernel once more for its value
            return super().compile(tuple(map(unliteral, sig)))


class _Part(_Dispatcher):
    """Dispatcher for calls from other kernels; Python cannot call it."""

    def add_overload(self, cres: Any) -> None:
        self.overloads[tuple(cres.signature.args)] = cres

    def enable_caching(self) -> None:
        self._cache = _PartCache(self.py_func)
        _check_files(self._cache)


class Kernel(_Dispatcher):
    """A compiled function; other kernels call its ``part``. Options as of :func:`numba.jit`."""

    def __init__(self, function: Any, locals: Any = None, targetoptions: Any = None) -> None:
        given = locals or {}  # numba before 0.62 wants a dictionary
        super().__init__(function, given, targetoptions, *((_Compiler,) if _PARTS else ()))
        options = {**(targetoptions or {}), "no_cpython_wrapper": True}
        self.part = _Part(function, given, options, _PartCompiler) if _PARTS else self

    def enable_caching(self) -> None:
        """Keep what is compiled on disk."""
        super().enable_caching()
        _check_files(self._cache)
        if self.part is not self:
            self.part.enable_caching()

    @property
    def _numba_type_(self) -> types.Type:
        return types.Dispatcher(self.part)
