"""Workers: every kind gives the same results, and missing packages are named."""

from __future__ import annotations

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


def dying_calls(folder, deaths):
    """Return calls that forecast simulated runs; one kills its worker so many times first."""

    def call(seed):
        from pathlib import Path

        import numpy as np

        from twin import Twin
        from twin.sim.bridge import particulars_of, simulate
        from usv_gym.vessel.vessel import Vessel
        from usv_gym.world.sea import SeaState

        died = len(list(Path(folder).glob("died*"))) if folder else deaths
        if seed == 3 and died < deaths:
            (Path(folder) / f"died_{died}").touch()
            os.kill(os.getpid(), signal.SIGKILL)
        boat = Vessel.load("usv75")
        log = simulate("random", vessel=boat, sea=SeaState.named("2"), duration=15.0, seed=seed)
        twin = Twin(particulars_of(boat), "ukf")
        twin.run(log)
        made = twin.predict("hold")
        return np.concatenate([made.mean.ravel(), made.cov.ravel()]).tobytes()

    return [functools.partial(call, seed) for seed in range(8)]


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["loky", "dask", "ray"])
def test_a_killed_worker_changes_no_bit(backend, tmp_path):
    pytest.importorskip(parallel.BACKENDS[backend][0], reason=f"{backend} is not installed")
    alone = {i: call() for i, call in enumerate(dying_calls(None, 0))}
    found = dict(parallel.results_of(dying_calls(tmp_path, 1), jobs=2, backend=backend))
    assert len(list(tmp_path.iterdir())) == 1
    assert found == alone


def test_calls_that_kill_their_workers_are_given_up():
    calls = [*CALLS[:3], lambda: os.kill(os.getpid(), signal.SIGKILL)]
    with pytest.raises(BackendError, match=r"backend loky: workers died 3 times .*; not done: \d"):
        list(parallel.results_of(calls, jobs=2))
