"""While kernels compile: a message on stderr, no garbage collection, and no interruption."""

from __future__ import annotations

import gc
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from numba.core import event

__all__ = [
    "QUIET",
    "CompileListener",
    "deferred_interrupt",
]

QUIET = "USV_TWIN_QUIET"
"""Environment variable; any value silences the message."""

MESSAGE = (
    "usv-twin: compiling the kernels of this kind of use, for a minute or two of one core "
    "(once after an install or update: the next start is quick)"
)

INTERRUPTED = "usv-twin: stops as soon as this kernel is compiled"


@contextmanager
def deferred_interrupt() -> Iterator[None]:
    """Let Ctrl-C wait for the end of the block: numba and LLVM do not survive it.

    Half-compiled code is left behind otherwise, and the process hangs or crashes at the next use.
    Blocks may be nested. Only the main thread ever receives Ctrl-C.
    """
    before = signal.getsignal(signal.SIGINT)
    main = threading.current_thread() is threading.main_thread()
    if not main or not callable(before) or getattr(before, "defers", False):
        yield
        return
    pressed: list[Any] = []

    def remember(number: int, frame: Any) -> None:
        if not pressed:
            print(f"\n{INTERRUPTED}", file=sys.stderr, flush=True)
        pressed[:] = [number, frame]

    remember.defers = True  # type: ignore[attr-defined]
    signal.signal(signal.SIGINT, remember)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
        if pressed:
            before(*pressed)


class CompileListener(event.Listener):  # type: ignore[misc]
    """Listener of numba's compile events in some modules; kernels read from disk raise none.

    It prints one line on stderr with the first kernel, but in worker processes.
    """

    def __init__(self, modules: set[str]) -> None:
        self._modules = modules
        self._depth = 0  # numba compiles under a lock: no other thread counts
        self._said = self._collecting = False

    def on_start(self, event: Any) -> None:
        """Say once that it takes time, with the outermost kernel."""
        if self._depth or event.data["dispatcher"].py_func.__module__ in self._modules:
            self._depth += 1
        if self._depth != 1:
            return
        # collections would take an eighth of the compile time and free little
        self._collecting = gc.isenabled()
        gc.disable()
        silent = os.environ.get(QUIET) or multiprocessing.parent_process() or sys.stderr is None
        if not (self._said or silent):
            self._said = True
            print(MESSAGE, file=sys.stderr, flush=True)

    def on_end(self, event: Any) -> None:
        """Collect garbage again after the outermost kernel."""
        self._depth = max(self._depth - 1, 0)
        if not self._depth and self._collecting:
            gc.freeze()  # compiled code stays: no later collection needs to look at it
            gc.enable()
