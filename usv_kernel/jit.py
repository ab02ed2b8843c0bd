"""Kernels: plain functions of scalars and float64 arrays that numba compiles to machine code.

A kernel does not allocate, calls no linear-algebra library, and uses no strings, exceptions or
generators. Outputs are written in place.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba
from numba.core import event

from usv_kernel.arrays import python_views
from usv_kernel.cache import _MODULES, cache_directory
from usv_kernel.compiler import Kernel
from usv_kernel.warmup import Compiling

__all__ = [
    "inlined",
    "kernel",
    "py_func",
]

F = TypeVar("F", bound=Callable[..., Any])

event.register("numba:compile", Compiling(_MODULES))

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

    No kernel allocates: one that would does not compile. So there are no references to count
    either, which took up to half of the time of those that hand views on. A kernel that returns
    views is for other kernels: see :func:`py_func`.

    Floating-point rules stay strict: a relaxed sum compiles to other roundings wherever it
    is inlined, and the same seed would no longer give the same bits in every process.

    Parameters
    ----------
    function : callable
        Plain function of scalars and arrays.
    inline : bool
        Always put it in place of its calls; see :func:`inlined`.

    Returns
    -------
    callable
        The compiled function; it releases the interpreter lock while it runs.
    """
    _MODULES.add(function.__module__)
    folder = cache_directory(function.__module__)
    # The folder is chosen when the function is decorated, so the setting can go back at once.
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
    """Compile as :func:`kernel` does what is so short that a call would cost more.

    An array goes into a call as seven or more numbers, each of them by way of the stack.
    """
    return kernel(function, inline=True)


def py_func(compiled: F) -> F:
    """Return what a kernel was compiled from, for those that return views of their arguments.

    Python would free a view that numba has not counted; see
    :func:`usv_kernel.arrays.python_views`.
    """
    return python_views(compiled)  # type: ignore[return-value]
