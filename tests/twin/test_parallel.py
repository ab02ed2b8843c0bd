"""Workers: their number changes no result, and one that dies is said."""

from __future__ import annotations

import functools
import operator
import os
import signal

import pytest

from twin.parallel import WorkerError, results_of

CALLS = [functools.partial(operator.floordiv, 100, i) for i in range(1, 12)]
EXPECTED = {i - 1: 100 // i for i in range(1, 12)}


@pytest.mark.parametrize("jobs", [1, 2])
def test_the_number_of_workers_changes_nothing(jobs):
    assert dict(results_of(CALLS, jobs=jobs)) == EXPECTED


def test_an_error_of_a_call_comes_as_it_is():
    with pytest.raises(ValueError, match=r"^invalid literal for int\(\) with base 10: 'seven'$"):
        list(results_of([functools.partial(int, "seven")], jobs=2))


def test_a_killed_worker_is_said_with_what_was_left():
    calls = [*CALLS[:3], lambda: os.kill(os.getpid(), signal.SIGKILL)]
    with pytest.raises(WorkerError, match=r"not done: [1-4] of 4 calls. Use fewer --jobs"):
        list(results_of(calls, jobs=2))
