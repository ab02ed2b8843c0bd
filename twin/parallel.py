"""Calls in workers of any kind that joblib knows: processes, threads, or a cluster."""

from __future__ import annotations

import contextlib
import importlib
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TypeVar

from usv_kernel.errors import UsvTwinError

__all__ = ["BACKENDS", "BackendError", "check_backend", "results_of"]

BACKENDS = {
    "loky": "joblib",
    "threading": "joblib",
    "dask": "dask.distributed",
    "ray": "ray.util.joblib",
}
"""Kinds of workers by joblib's names, and the module that each needs: processes and threads of this
machine, a cluster of Dask, one of Ray."""

DEATHS_MAX = 3
"""After so many deaths of workers the calls that are left are given up."""

_Result = TypeVar("_Result")


class BackendError(UsvTwinError):
    """A kind of workers that is not known or not installed, or whose workers die."""


def check_backend(backend: str) -> None:
    """Refuse workers not in :data:`BACKENDS`, or not installed; BackendError says what to do."""
    if backend not in BACKENDS:
        raise BackendError(f"no backend is called {backend!r}; known: {', '.join(BACKENDS)}")
    try:
        importlib.import_module(BACKENDS[backend])
    except ImportError:
        raise BackendError(
            f"backend {backend}: {BACKENDS[backend]} is not installed; "
            f"python -m pip install 'usv-twin[{backend}]'"
        ) from None


def results_of(
    calls: Sequence[Callable[[], _Result]], *, jobs: int = 1, backend: str = "loky"
) -> Iterator[tuple[int, _Result]]:
    """Make calls in so many workers, and yield number and result of each as they come.

    With other backends than ``threading`` the calls are sent as pickles. ``dask`` uses the cluster
    that ``DASK_SCHEDULER_ADDRESS`` names, ``ray`` the one of ``RAY_ADDRESS``; else each starts one
    on this machine. A folder that the calls write to must be shared with a cluster. Calls that are
    lost as their worker dies are made again. BackendError: workers died :data:`DEATHS_MAX` times.
    """
    left, deaths = dict(enumerate(calls)), 0
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
                        f"not done: {len(left)} of {len(calls)} calls. Use fewer --jobs if the "
                        "memory is short, and give the same command again"
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
    if backend == "threading":
        yield ()
    elif backend == "loky":
        from joblib.externals.loky.process_executor import TerminatedWorkerError

        yield (TerminatedWorkerError,)
    elif backend == "dask":
        import dask
        from dask.distributed import Client, KilledWorker

        far = dask.config.get("scheduler-address", None)
        here = {"n_workers": jobs, "threads_per_worker": 1, "dashboard_address": None}
        with Client(far) if far else Client(**here):
            yield (KilledWorker,)
    else:
        import ray
        from ray.exceptions import NodeDiedError, RayActorError, WorkerCrashedError
        from ray.util.joblib import register_ray

        own = not ray.is_initialized()
        if own:
            here = {} if os.environ.get("RAY_ADDRESS") else {"num_cpus": jobs}
            ray.init(**here, log_to_driver=False)
        register_ray()
        try:
            yield (NodeDiedError, RayActorError, WorkerCrashedError)
        finally:
            if own:
                ray.shutdown()
