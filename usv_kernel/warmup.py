"""What happens around compiling: a word to whoever waits, and no garbage collector meanwhile."""

from __future__ import annotations

import gc
import multiprocessing
import os
import sys
import threading
import time
from itertools import cycle
from typing import Any

from numba.core import event

__all__ = [
    "QUIET",
    "Compiling",
]

QUIET = "USV_TWIN_QUIET"
"""Environment variable; anything in it silences the word."""

TEXT = "usv-twin: compiling kernels, once for each part after an installation or an update"

PATIENCE = 0.3
"""What is compiled sooner is not worth a word, s."""


class Compiling(event.Listener):  # type: ignore[misc]
    """Told by numba when it begins and ends to compile; what is read from disk is no such event.

    On a terminal a spinner turns on stderr while a kernel is being compiled; elsewhere one line
    is printed. Worker processes say nothing.

    Parameters
    ----------
    modules : set of str
        Those whose kernels are ours.
    """

    def __init__(self, modules: set[str]) -> None:
        self._modules = modules
        self._depth = 0  # numba compiles under a lock of its own, so plain counting will do
        self._began = 0.0
        self._said = False
        self._collecting = False
        self._done = threading.Event()
        self._thread: threading.Thread | None = None

    def on_start(self, event: Any) -> None:
        """Begin with the outermost kernel."""
        if self._depth or event.data["dispatcher"].py_func.__module__ in self._modules:
            self._depth += 1
        if self._depth != 1:
            return
        self._began = self._began or time.monotonic()
        # the compiler leaves few cycles and looks for them often: an eighth of its time
        self._collecting = gc.isenabled()
        gc.disable()
        if not (os.environ.get(QUIET) or multiprocessing.parent_process()):
            self._done.clear()
            self._thread = threading.Thread(target=self._say, daemon=True)
            self._thread.start()

    def on_end(self, event: Any) -> None:
        """End with the outermost kernel."""
        self._depth = max(self._depth - 1, 0)
        if self._depth:
            return
        if self._collecting:
            gc.enable()
        if self._thread is not None:
            self._done.set()
            self._thread.join()
            self._thread = None

    def _say(self) -> None:
        stream = sys.stderr
        if stream is None or self._done.wait(0.0 if self._said else PATIENCE):
            return
        try:
            if not stream.isatty():
                if not self._said:
                    print(TEXT, file=stream, flush=True)
            else:
                for sign in cycle("-\\|/"):
                    seconds = time.monotonic() - self._began
                    print(f"\r{TEXT} {sign} {seconds:.0f} s", end="", file=stream, flush=True)
                    if self._done.wait(0.2):
                        break
                print("\r\x1b[K", end="", file=stream, flush=True)
        except (OSError, ValueError):  # closed meanwhile: there is nobody to tell
            return
        self._said = True
