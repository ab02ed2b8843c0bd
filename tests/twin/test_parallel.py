"""Workers: every kind gives the same results, and missing packages are named."""

import functools
import operator
import os
import signal

import pytest

from twin import parallel
from twin.parallel import BackendError

CALLS = [functools.partial(operator.floordiv, 100, i) for i in range(1, 12)]
EXPECTED = {i - 1: 100 // i for i in range(1, 12)}


@pytest.mark.parametrize(("jobs", "backend"), [(1, "loky"), (2, "loky"), (2, "threading")])
def test_workers_change_nothing(jobs, backend):
    assert dict(parallel.results_of(CALLS, jobs=jobs, backend=backend)) == EXPECTED


@pytest.mark.parametrize("backend", ["dask", "ray"])
def test_clusters_change_nothing(backend):
    pytest.importorskip(parallel.BACKENDS[backend], reason=f"{backend} is not installed")
    assert dict(parallel.results_of(CALLS, jobs=2, backend=backend)) == EXPECTED
    failing = [functools.partial(int, "seven")]
    with pytest.raises(ValueError, match=r"^invalid literal for int\(\) with base 10: 'seven'$"):
        list(parallel.results_of(failing, jobs=2, backend=backend))


def test_a_missing_backend_is_named(monkeypatch):
    with pytest.raises(BackendError, match="no backend is called 'mpi'; known: loky"):
        list(parallel.results_of(CALLS, backend="mpi"))
    monkeypatch.setitem(parallel.BACKENDS, "dask", "no_such_module")
    with pytest.raises(BackendError, match=r"pip install 'usv-twin\[dask\]'"):
        parallel.check_backend("dask")


@pytest.mark.parametrize("backend", ["loky", "dask", "ray"])
def test_calls_of_a_killed_worker_are_made_again(backend, tmp_path):
    pytest.importorskip(parallel.BACKENDS[backend], reason=f"{backend} is not installed")

    def call(i):  # sent by value: workers of a cluster cannot import this module
        if i == 3 and not (tmp_path / "died").exists():
            (tmp_path / "died").touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return 100 // i

    calls = [functools.partial(call, i) for i in range(1, 12)]
    assert dict(parallel.results_of(calls, jobs=2, backend=backend)) == EXPECTED
    assert (tmp_path / "died").exists()


def test_calls_that_kill_their_workers_are_given_up():
    calls = [*CALLS[:3], lambda: os.kill(os.getpid(), signal.SIGKILL)]
    with pytest.raises(BackendError, match=r"backend loky: workers died 3 times .*; not done: \d"):
        list(parallel.results_of(calls, jobs=2))
