"""The rates to reach: ``pytest tests/bench -m bench``; ``usv-twin bench`` shows them all."""

from __future__ import annotations

import pytest

from twin.performance import cases, harness

pytestmark = pytest.mark.bench
CASES = cases.chosen(quick=True)


@pytest.fixture(scope="module")
def measured():
    return harness.measure(CASES, 5)


@pytest.mark.parametrize(
    "case", [case for case in CASES if case.must or case.must_ratio], ids=lambda case: case.name
)
def test_must_is_reached(measured, case):
    assert measured.reached(case) >= 1.0
