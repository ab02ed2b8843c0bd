"""What world and belief compile with: the ``kernel`` decorator and the functions that both need.

``usv_gym`` (the world) must not import ``twin`` (the belief), nor the other way round;
this package is below both and holds only what would otherwise stand in each of them twice.

A kernel is a plain function of scalars and float64 arrays that numba compiles to machine
code: no allocation, no linear-algebra library, no strings, no exceptions, no generators.
Outputs are written in place.
"""

from __future__ import annotations

import functools
import hashlib
import math
import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from types import FunctionType
from typing import Any, TypeVar

import numba
import platformdirs
from numba.core import event, types
from numba.extending import intrinsic

from usv_kernel.compiler import Kernel
from usv_kernel.first_use import Compiling
from usv_kernel.views import reshaped

__version__ = "0.1.0"

__all__ = [
    "actuate",
    "cache_directory",
    "cached",
    "fma",
    "in_python",
    "inlined",
    "kernel",
    "module_digest",
    "running_program",
    "sincos",
    "sources_digest",
    "wrap",
]

F = TypeVar("F", bound=Callable[..., Any])

_ROOT = Path(__file__).resolve().parent.parent
_PROGRAM = {".py", ".csv", ".npz", ".toml"}
_PACKAGES = ("usv_kernel", "usv_gym", "twin")


def sources_digest(root: Path = _ROOT) -> str:
    """Return one digest over the whole program.

    Parameters
    ----------
    root : Path
        Folder that holds the packages.

    Returns
    -------
    str
        Twenty hexadecimal digits; another value after any edit of a source, or of the vessels,
        priors and weights that ship with it.
    """
    digest = hashlib.sha256()
    for package in _PACKAGES:
        for path in sorted((root / package).rglob("*")):
            if path.suffix in _PROGRAM:
                digest.update(
                    path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes()
                )
    return digest.hexdigest()[:20]


@functools.cache
def running_program() -> str:
    """Return :func:`sources_digest` of the running program, as it was when first asked for."""
    return sources_digest()


def module_digest(module: str, root: Path = _ROOT) -> str:
    """Return one digest over a module and all that it imports from the three packages.

    numba's disk cache looks at the file of the outermost function only, so that an edit of
    a function that it calls in another file would go on running the old machine code.

    Parameters
    ----------
    module : str
        Dotted name.
    root : Path
        Folder that holds the packages.

    Returns
    -------
    str
        Twenty hexadecimal digits; another value after any edit of any of those files.
    """
    found: set[Path] = set()
    todo = _files_of(module, root)
    while todo:
        path = todo.pop()
        if path not in found:
            found.add(path)
            todo += [file for name in _source(path)[1] for file in _files_of(name, root)]
    digest = hashlib.sha256()
    for path in sorted(found):
        digest.update(path.relative_to(root).as_posix().encode() + b"\0" + _source(path)[0])
    return digest.hexdigest()[:20]


def _files_of(module: str, root: Path) -> list[Path]:
    """Return the file of a module of ours; none for others, and for names inside a module."""
    if module.partition(".")[0] not in _PACKAGES:
        return []
    path = root.joinpath(*module.split("."))
    return [file for file in (path.with_suffix(".py"), path / "__init__.py") if file.is_file()]


_IMPORT = re.compile(rb"^[ \t]*(?:from[ ]+([\w.]+)[ ]+)?import[ ]+(\([^)]*\)|[^\n]*)", re.MULTILINE)
_COMMENT = re.compile(rb"#[^\n]*")


@functools.cache
def _source(path: Path) -> tuple[bytes, frozenset[str]]:
    """Return a file's content and the dotted names that it imports, those of a ``from`` both ways.

    By pattern and not by parsing: every import of the packages waits for it.
    """
    content = path.read_bytes()
    names = set()
    for origin, listed in _IMPORT.findall(_COMMENT.sub(b"", content)):
        start = origin.decode()
        items = [item.split()[0] for item in listed.decode().strip("()").split(",") if item.strip()]
        names |= {start, *(f"{start}.{item}" for item in items)} if start else set(items)
    return content, frozenset(names)


@functools.cache
def cache_directory(module: str) -> Path | None:
    """Return the folder for a module's compiled kernels, or None where none can be written.

    It is named by :func:`module_digest`; of earlier ones the newest three are kept.
    ``NUMBA_CACHE_DIR`` moves it.
    """
    base = Path(os.environ.get("NUMBA_CACHE_DIR") or platformdirs.user_cache_dir("usv-twin"))
    ours = bool(_files_of(module, _ROOT))
    folder = base / f"{module}-{module_digest(module) if ours else sources_digest()}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        os.utime(folder)
        for stale in _of_module(folder)[:-4]:
            shutil.rmtree(stale, ignore_errors=True)
    except OSError:
        return None
    return folder if os.access(folder, os.W_OK) else None


def _of_module(folder: Path) -> list[Path]:
    """Return the folders of all versions of a module, oldest first."""
    name = folder.name.rpartition("-")[0]
    return sorted(folder.parent.glob(f"{name}-*"), key=lambda path: path.stat().st_mtime)


def cached() -> bool:
    """Return whether the kernels of today's sources have been compiled before.

    A module that was compiled in an earlier version only is going to be compiled again.
    """
    fresh = False
    for folder in filter(None, map(cache_directory, _MODULES)):
        compiled = {path for path in _of_module(folder) if next(path.rglob("*.nbi"), None)}
        if compiled and folder not in compiled:
            return False
        fresh = fresh or folder in compiled
    return fresh


_MODULES: set[str] = set()
"""Those that hold kernels, as far as they were imported."""
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
    views is for other kernels: see :func:`in_python`.

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


def in_python(compiled: F) -> F:
    """Return what a kernel was compiled from, for those that return views of their arguments.

    Python would free a view that nobody has counted. ``shaped`` becomes its twin for Python.
    """
    function = compiled.py_func  # type: ignore[attr-defined]
    names = {**function.__globals__, "shaped": reshaped}
    return FunctionType(function.__code__, names)  # type: ignore[return-value]


@intrinsic
def fma(typing_context, a, b, c):
    """Return a * b + c with one rounding, in one instruction; for kernels only.

    Written out, so that every compiler rounds alike: none of them may fuse by itself.
    """

    def generate(context, builder, signature, arguments):
        return builder.fma(*arguments)

    return types.float64(types.float64, types.float64, types.float64), generate


# 33 bits of pi/2 and the rest: their products with a whole number are exact (Cody-Waite)
_TWO_OVER_PI = 6.36619772367581382433e-01
_PIO2_HIGH = 1.57079632673412561417e00
_PIO2_LOW = 6.07710050650619224932e-11
# adding 1.5 * 2^52 leaves no room for a fraction; floor() would go through integers, one by one
_ROUND = 6755399441055744.0


@inlined
def sincos(x: float) -> tuple[float, float]:
    """Return sine and cosine to 2e-15, in straight-line code that vectorises.

    Meant for |x| below 1e6, where the reduction loses nothing.
    """
    n = fma(x, _TWO_OVER_PI, _ROUND) - _ROUND
    r = fma(-n, _PIO2_LOW, fma(-n, _PIO2_HIGH, x))
    half = (fma(0.5, n, -0.25) + _ROUND) - _ROUND
    odd = fma(-2.0, half, n)
    sign = 1.0 - 2.0 * fma(-2.0, (fma(0.5, half, -0.25) + _ROUND) - _ROUND, half)
    z = r * r
    s = fma(z, -7.64716373181981647590e-13, 1.60590438368216145994e-10)
    s = fma(z, fma(z, s, -2.50521083854417187751e-08), 2.75573192239858906526e-06)
    s = fma(z, fma(z, s, -1.98412698412698412698e-04), 8.33333333333333333333e-03)
    s = fma(r * z, fma(z, s, -1.66666666666666666667e-01), r)
    c = fma(z, -1.14707455977297247139e-11, 2.08767569878680989792e-09)
    c = fma(z, fma(z, c, -2.75573192239858906526e-07), 2.48015873015873015873e-05)
    c = fma(z, fma(z, c, -1.38888888888888888889e-03), 4.16666666666666666667e-02)
    c = fma(z, fma(z, c, -0.5), 1.0)
    # one of two terms is 0, so that sin(-x) = -sin(x) and cos(-x) = cos(x) to the bit
    even = 1.0 - odd
    return sign * fma(odd, c, even * s), sign * fma(-odd, s, even * c)


@inlined
def wrap(angle: float) -> float:
    """Return the angle in [-pi, pi)."""
    return angle - 2.0 * math.pi * math.floor(angle / (2.0 * math.pi) + 0.5)


@kernel
def actuate(value: float, target: float, lag: float, rate: float) -> float:
    """Return the speed at which a lagged, rate-limited actuator moves to its target.

    Replaces the paper's Eq (11) and (27), which can only move away from zero.

    Parameters
    ----------
    value, target : float
        Where the actuator is and where it is told to go, in its own unit.
    lag : float
        Time constant in s; above 0.
    rate : float
        Largest speed, in units per s.

    Returns
    -------
    float
        Speed in units per s.
    """
    return min(max((target - value) / lag, -rate), rate)
