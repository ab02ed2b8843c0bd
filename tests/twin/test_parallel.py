"""Workers: every kind comes to the same results, and says what it lacks."""

from __future__ import annotations

import functools
import operator

import pytest

from twin import parallel as workers
from twin.benchmark.protocol import BenchmarkError

CALLS = [functools.partial(operator.floordiv, 100, i) for i in range(1, 12)]
EXPECTED = {i - 1: 100 // i for i in range(1, 12)}


@pytest.mark.parametrize(("jobs", "backend"), [(1, "loky"), (2, "loky"), (2, "threading")])
def test_workers_change_nothing(jobs, backend):
    assert dict(workers.results_of(CALLS, jobs=jobs, backend=backend)) == EXPECTED


@pytest.mark.parametrize("backend", ["dask", "ray"])
def test_clusters_change_nothing(backend):
    pytest.importorskip(workers.BACKENDS[backend][0], reason=f"{backend} is not installed")
    assert dict(workers.results_of(CALLS, jobs=2, backend=backend)) == EXPECTED
    failing = [functools.partial(int, "seven")]
    with pytest.raises(ValueError, match=r"^invalid literal for int\(\) with base 10: 'seven'$"):
        list(workers.results_of(failing, jobs=2, backend=backend))


def test_backends_that_cannot_be_had(monkeypatch):
    with pytest.raises(BenchmarkError, match="no backend is called 'mpi'; known: loky"):
        list(workers.results_of(CALLS, backend="mpi"))
    monkeypatch.setitem(workers.BACKENDS, "dask", ("no_such_module", "'dask[distributed]'"))
    with pytest.raises(BenchmarkError, match=r"pip install 'dask\[distributed\]'"):
        workers.check_backend("dask")
