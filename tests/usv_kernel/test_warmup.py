"""Ctrl-C while a kernel compiles."""

import signal

import pytest
from numba.core import event

from usv_kernel.jit import kernel
from usv_kernel.warmup import INTERRUPTED, deferred_interrupt


@pytest.fixture(autouse=True)
def ctrl_c_interrupts():
    """Handle SIGINT as at a terminal: a shell that starts tests in the background ignores it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def test_deferred_interrupt_waits_for_the_outermost_block(capsys):
    done = []

    @deferred_interrupt()
    def press(what, then=None):
        signal.raise_signal(signal.SIGINT)
        if then is not None:
            then("inner")
        done.append(what)

    with pytest.raises(KeyboardInterrupt):
        press("outer", press)
    assert done == ["inner", "outer"]
    assert capsys.readouterr().err.count(INTERRUPTED) == 1
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)


def test_deferred_interrupt_keeps_an_error_of_the_block():
    with pytest.raises(ZeroDivisionError), deferred_interrupt():
        raise ZeroDivisionError
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


class _CtrlC(event.Listener):
    """Presses Ctrl-C when a compile begins."""

    def on_start(self, event):
        signal.raise_signal(signal.SIGINT)

    def on_end(self, event):
        pass


def test_interrupted_compile_leaves_a_kernel_that_works(monkeypatch, tmp_path):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))

    @kernel
    def inner(x):
        return 2.0 * x

    @kernel
    def outer(x):
        return inner(x) + 1.0

    with pytest.raises(KeyboardInterrupt), event.install_listener("numba:run_pass", _CtrlC()):
        outer(1.0)
    assert outer(1.0) == 3.0
    assert inner(2.0) == 4.0
