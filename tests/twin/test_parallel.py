"""Workers: every kind gives the same results, and missing packages are named."""

from __future__ import annotations

import functools
import operator

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
    pytest.importorskip(parallel.BACKENDS[backend][0], reason=f"{backend} is not installed")
    assert dict(parallel.results_of(CALLS, jobs=2, backend=backend)) == EXPECTED
    failing = [functools.partial(int, "seven")]
    with pytest.raises(ValueError, match=r"^invalid literal for int\(\) with base 10: 'seven'$"):
        list(parallel.results_of(failing, jobs=2, backend=backend))


def test_a_missing_backend_is_named(monkeypatch):
    with pytest.raises(BackendError, match="no backend is called 'mpi'; known: loky"):
        list(parallel.results_of(CALLS, backend="mpi"))
    monkeypatch.setitem(parallel.BACKENDS, "dask", ("no_such_module", "'dask[distributed]'"))
    with pytest.raises(BackendError, match=r"pip install 'dask\[distributed\]'"):
        parallel.check_backend("dask")
