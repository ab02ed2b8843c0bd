"""What world and belief compile with: the ``kernel`` decorator and the functions that both need.

``usv_gym`` (the world) must not import ``twin`` (the belief), nor the other way round;
this package is below both and holds only what would otherwise stand in each of them twice.

A kernel is a plain function of scalars and float64 arrays that numba compiles to machine
code: no allocation, no linear-algebra library, no strings, no exceptions, no generators.
Outputs are written in place.
"""

from __future__ import annotations

import hashlib
import math
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numba
import platformdirs

__version__ = "0.1.0"

__all__ = ["actuate", "cache_directory", "cached", "kernel", "sources_digest", "wrap"]

F = TypeVar("F", bound=Callable[..., Any])

_ROOT = Path(__file__).resolve().parent.parent
_PACKAGES = ("usv_kernel", "usv_gym", "twin")


def sources_digest(root: Path = _ROOT) -> str:
    """Return one digest over every file that may hold a kernel.

    numba's disk cache looks at the file of the outermost function only, so that an edit of
    a function that it calls in another file would go on running the old machine code.

    Parameters
    ----------
    root : Path
        Folder that holds the packages.

    Returns
    -------
    str
        Twenty hexadecimal digits; another value after any edit of any source.
    """
    digest = hashlib.sha256()
    for package in _PACKAGES:
        for path in sorted((root / package).rglob("*.py")):
            digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:20]


def cache_directory() -> Path | None:
    """Return the folder for today's compiled kernels, or None where none can be written.

    It is named by :func:`sources_digest`; folders of earlier sources are removed once they
    are older than the newest three. ``NUMBA_CACHE_DIR`` moves it.
    """
    base = Path(os.environ.get("NUMBA_CACHE_DIR") or platformdirs.user_cache_dir("usv-twin"))
    folder = base / f"kernels-{sources_digest()}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        os.utime(folder)
        kept = sorted(base.glob("kernels-*"), key=lambda path: path.stat().st_mtime)
        for stale in kept[:-4]:
            shutil.rmtree(stale, ignore_errors=True)
    except OSError:
        return None
    return folder if os.access(folder, os.W_OK) else None


_CACHE = cache_directory()


def cached() -> bool:
    """Return whether kernels of today's sources have been compiled before."""
    return _CACHE is not None and next(_CACHE.rglob("*.nbi"), None) is not None


def kernel(function: F) -> F:
    """Compile a function to machine code on its first call, and keep the code on disk.

    Floating-point rules stay strict: a relaxed sum compiles to other roundings wherever it
    is inlined, and the same seed would no longer give the same bits in every process.

    Parameters
    ----------
    function : callable
        Plain function of scalars and arrays.

    Returns
    -------
    callable
        The compiled function; it releases the interpreter lock while it runs.
    """
    # The folder is chosen when the function is decorated, so the setting can go back at once.
    before = numba.config.CACHE_DIR  # type: ignore[attr-defined]
    numba.config.CACHE_DIR = str(_CACHE) if _CACHE else before  # type: ignore[attr-defined]
    try:
        compiled = numba.njit(cache=_CACHE is not None, nogil=True, error_model="numpy")(function)
    finally:
        numba.config.CACHE_DIR = before  # type: ignore[attr-defined]
    return compiled  # type: ignore[no-any-return]


@kernel
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
