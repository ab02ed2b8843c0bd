"""Kernels: functions of scalars and float64 arrays that numba compiles to machine code.

A kernel does not allocate memory and calls no linear-algebra library. It uses no strings,
exceptions or generators, and writes its outputs in place.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba
from numba.core import event

from usv_kernel.arrays import python_views
from usv_kernel.cache import KERNEL_MODULES, cache_directory
from usv_kernel.compiler import Kernel
from usv_kernel.warmup import CompileListener

__all__ = [
    "inlined",
    "kernel",
    "py_func",
]

F = TypeVar("F", bound=Callable[..., Any])

event.register("numba:compile", CompileListener(KERNEL_MODULES))

_OPTIONS = {
    "nopython": True,
    "nogil": True,
    "error_model": "numpy",
    "boundscheck": None,
    "_nrt": False,
    "no_cfunc_wrapper": True,
}


def kernel(function: F, inline: bool = False) -> F:
    """Compile a function to machine code on its first call, and keep the code on disk.

    A kernel that would allocate memory fails to compile. So nothing counts references, which would
    double the run time of kernels that pass views on. A kernel that returns views is for other
    kernels only: see :func:`py_func`. It releases the interpreter lock while it runs. With
    ``inline`` it is inlined into every caller; see :func:`inlined`.

    Floating-point rules are strict. With fast math, sums would round differently wherever they are
    inlined, and equal seeds would no longer give equal bits.
    """
    KERNEL_MODULES.add(function.__module__)
    folder = cache_directory(function.__module__)
    # numba reads this setting when a function is decorated
    before = numba.config.CACHE_DIR  # type: ignore[attr-defined]
    numba.config.CACHE_DIR = str(folder) if folder else before  # type: ignore[attr-defined]
    try:
        compiled = Kernel(function, targetoptions={**_OPTIONS, "forceinline": inline})
        if folder is not None:
            compiled.enable_caching()
    finally:
        numba.config.CACHE_DIR = before  # type: ignore[attr-defined]
    return compiled  # type: ignore[no-any-return]


def inlined(function: F) -> F:
    """Compile a short function as :func:`kernel` does, and inline it into every caller.

    A call passes seven or more numbers per array on the stack, which can cost more than the body.
    """
    return kernel(function, inline=True)


def py_func(compiled: F) -> F:
    """Return the Python function of a kernel that returns views of its arguments.

    Python would free a view that numba has not counted; see
    :func:`usv_kernel.arrays.python_views`.
    """
    return python_views(compiled)  # type: ignore[return-value]
