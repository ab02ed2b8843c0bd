"""Calls in processes of this machine, whose results come as they are done."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

from usv_kernel.errors import UsvTwinError

__all__ = ["WorkerError", "results_of"]

_Result = TypeVar("_Result")


class WorkerError(UsvTwinError):
    """A worker process died; the message says how much was left, and the remedy."""


def results_of(
    calls: Sequence[Callable[[], _Result]], *, jobs: int = 1
) -> Iterator[tuple[int, _Result]]:
    """Make calls in so many processes, and yield number and result of each as they come.

    WorkerError: a process was killed, or had no memory left.
    """
    from joblib import Parallel, delayed
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    left = len(calls)
    pool = Parallel(n_jobs=jobs, return_as="generator_unordered")
    try:
        for found in pool(delayed(_numbered)(i, call) for i, call in enumerate(calls)):
            yield found
            left -= 1
    except TerminatedWorkerError:
        raise WorkerError(
            f"a worker process was killed; not done: {left} of {len(calls)} calls. Use fewer "
            "--jobs if the memory is short, and give the same command again"
        ) from None


def _numbered(i: int, call: Callable[[], _Result]) -> tuple[int, _Result]:
    return i, call()
