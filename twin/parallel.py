"""Workers of any kind that joblib knows: processes, threads, or a cluster of Dask or Ray."""

from __future__ import annotations

import contextlib
import importlib
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TypeVar

from usv_kernel.errors import UsvTwinError

__all__ = [
    "BACKENDS",
    "BackendError",
    "check_backend",
    "results_of",
]

BACKENDS = {
    "loky": ("joblib", "joblib"),
    "threading": ("joblib", "joblib"),
    "dask": ("dask.distributed", "'dask[distributed]'"),
    "ray": ("ray.util.joblib", "ray"),
}
"""Kinds of workers by joblib's names: the module that each needs, and what to install."""

DEATHS_MAX = 3
"""After so many deaths of workers the calls that are left are given up."""

_Result = TypeVar("_Result")


class BackendError(UsvTwinError):
    """A kind of workers that is not known, or not installed."""


def check_backend(backend: str) -> None:
    """Refuse workers not in :data:`BACKENDS`, or not installed; BackendError says what to do."""
    if backend not in BACKENDS:
        raise BackendError(f"no backend is called {backend!r}; known: {', '.join(BACKENDS)}")
    module, package = BACKENDS[backend]
    try:
        importlib.import_module(module)
    except ImportError:
        raise BackendError(
            f"backend {backend}: {module} is not installed; python -m pip install {package}"
        ) from None


def results_of(
    calls: Sequence[Callable[[], _Result]], *, jobs: int = 1, backend: str = "loky"
) -> Iterator[tuple[int, _Result]]:
    """Make calls, each in a worker, and yield number and result of each as they come.

    With other backends than ``threading`` the calls are sent as pickles. ``dask`` uses the cluster
    that ``DASK_SCHEDULER_ADDRESS`` names, ``ray`` the one of ``RAY_ADDRESS``; else each starts one
    on this machine. A folder that the calls write to must be shared with a cluster. Calls that are
    lost as their worker dies are made again. BackendError: workers died :data:`DEATHS_MAX` times.
    """
    left = dict(enumerate(calls))
    deaths = 0
    with _workers(backend, jobs) as lost:
        while left:
            try:
                for i, result in _pass(left, jobs, backend):
                    del left[i]
                    yield i, result
            except lost as error:
                deaths += 1
                if deaths == DEATHS_MAX:
                    raise BackendError(
                        f"backend {backend}: workers died {deaths} times ({type(error).__name__}); "
                        f"not done: {len(left)} of {len(calls)} calls, the first is number "
                        f"{min(left)}. Use fewer --jobs if the memory is short"
                    ) from None


def _pass(
    calls: Mapping[int, Callable[[], _Result]], jobs: int, backend: str
) -> Iterator[tuple[int, _Result]]:
    """Make calls once; see :func:`results_of`."""
    from joblib import Parallel, delayed, parallel_config

    # cluster backends return nothing before all calls are done: send a few at a time
    flows = backend in ("loky", "threading")
    numbers = list(calls)
    size = len(numbers) if flows else 4 * jobs
    with parallel_config(backend=backend):  # registers dask, which Parallel alone does not know
        pool = Parallel(n_jobs=jobs, return_as="generator_unordered" if flows else "list")
    for first in range(0, len(numbers), size):
        yield from pool(delayed(_numbered)(i, calls[i]) for i in numbers[first : first + size])


def _numbered(i: int, call: Callable[[], _Result]) -> tuple[int, _Result]:
    return i, call()


@contextlib.contextmanager
def _workers(backend: str, jobs: int) -> Iterator[tuple[type[Exception], ...]]:
    """Start workers of a kind where joblib does not; yield the errors of a worker's death."""
    check_backend(backend)
    with contextlib.ExitStack() as stack:
        lost: tuple[type[Exception], ...] = ()
        if backend == "loky":
            from joblib.externals.loky.process_executor import TerminatedWorkerError

            lost = (TerminatedWorkerError,)
        elif backend == "dask":
            import dask
            from dask.distributed import Client, KilledWorker

            here = {"n_workers": jobs, "threads_per_worker": 1, "dashboard_address": None}
            far = dask.config.get("scheduler-address", None)
            stack.enter_context(Client(far) if far else Client(**here))
            lost = (KilledWorker,)
        elif backend == "ray":
            import ray
            from ray.exceptions import NodeDiedError, RayActorError, WorkerCrashedError
            from ray.util.joblib import register_ray

            if not ray.is_initialized():
                far = os.environ.get("RAY_ADDRESS")
                ray.init(**({} if far else {"num_cpus": jobs}), log_to_driver=False)
                stack.callback(ray.shutdown)
            register_ray()
            lost = NodeDiedError, RayActorError, WorkerCrashedError
        yield lost
