"""While kernels compile: a message on stderr, no garbage collection, and no interruption."""

from __future__ import annotations

import gc
import multiprocessing
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import cycle
from typing import Any

from numba.core import event

__all__ = [
    "QUIET",
    "CompileListener",
    "deferred_interrupt",
]

QUIET = "USV_TWIN_QUIET"
"""Environment variable; any value silences the message."""

MESSAGE = "usv-twin: compiling kernels (first use after an install or update)"

MESSAGE_DELAY = 0.3
"""Compilation time before the message appears, s."""


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

    On a terminal it shows a spinner on stderr during compilation. Elsewhere it prints one line.
    Worker processes print nothing.
    """

    def __init__(self, modules: set[str]) -> None:
        self._modules = modules
        self._depth = 0  # numba compiles under a lock: no other thread counts
        self._began = 0.0
        self._shown = False
        self._collecting = False
        self._done = threading.Event()
        self._thread: threading.Thread | None = None

    def on_start(self, event: Any) -> None:
        """Start the message with the outermost kernel."""
        if self._depth or event.data["dispatcher"].py_func.__module__ in self._modules:
            self._depth += 1
        if self._depth != 1:
            return
        self._began = self._began or time.monotonic()
        # collections would take an eighth of the compile time and free little
        self._collecting = gc.isenabled()
        gc.disable()
        if not (os.environ.get(QUIET) or multiprocessing.parent_process()):
            self._done.clear()
            self._thread = threading.Thread(target=self._show_message, daemon=True)
            self._thread.start()

    def on_end(self, event: Any) -> None:
        """Stop the message with the outermost kernel."""
        self._depth = max(self._depth - 1, 0)
        if self._depth:
            return
        if self._collecting:
            gc.enable()
        if self._thread is not None:
            self._done.set()
            self._thread.join()
            self._thread = None

    def _show_message(self) -> None:
        stream = sys.stderr
        if stream is None or self._done.wait(0.0 if self._shown else MESSAGE_DELAY):
            return
        try:
            if not stream.isatty():
                if not self._shown:
                    print(MESSAGE, file=stream, flush=True)
            else:
                for sign in cycle("-\\|/"):
                    seconds = time.monotonic() - self._began
                    print(f"\r{MESSAGE} {sign} {seconds:.0f} s", end="", file=stream, flush=True)
                    if self._done.wait(0.2):
                        break
                print("\r\x1b[K", end="", file=stream, flush=True)
        except (OSError, ValueError):  # stderr was closed meanwhile
            return
        self._shown = True
