"""Random numbers of kernels are NumPy's own."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from usv_kernel.random import (
    STREAM,
    below,
    borrowed_stream,
    fill_normal,
    fill_uniform,
    start_stream,
)


def stream_of(seed: int) -> np.ndarray:
    stream = np.zeros(STREAM, dtype=np.uint64)
    start_stream(np.random.SeedSequence(seed).generate_state(4, np.uint64), stream)
    return stream


@given(st.integers(0, 2**64), st.integers(0, 50))
def test_numbers_are_those_of_numpy(seed, count) -> None:
    ours, theirs, out = stream_of(seed), np.random.default_rng(seed), np.zeros(count)
    for _ in range(2):
        fill_uniform(ours, out)
        np.testing.assert_array_equal(out, theirs.random(count))
        fill_normal(ours, out)
        np.testing.assert_array_equal(out, theirs.standard_normal(count))


def test_three_million_normal_numbers_are_those_of_numpy() -> None:
    # one in 3900 is of the tail, and one in a hundred needs a second look
    ours, out = stream_of(1), np.zeros(3_000_000)
    fill_normal(ours, out)
    np.testing.assert_array_equal(out, np.random.default_rng(1).standard_normal(out.size))
    assert (abs(out) > 3.6541528853610088).sum() > 600


@given(st.integers(0, 2**64), st.one_of(st.integers(2, 20), st.integers(2, 2**32 - 1)))
def test_a_whole_number_below_another_is_that_of_numpy(seed, count) -> None:
    """The larger the bound, the more words are thrown away."""
    ours, theirs, out = stream_of(seed), np.random.default_rng(seed), np.zeros(3)
    fill_uniform(ours, out)
    theirs.random(3)
    assert below(ours, count) == theirs.integers(count)


@given(st.integers(0, 2**64))
def test_a_borrowed_generator_goes_on_where_kernels_end(seed) -> None:
    rng, whole, out = np.random.default_rng(seed), np.random.default_rng(seed), np.zeros(3)
    with borrowed_stream(rng) as stream:
        fill_normal(stream, out)
    assert [*out, rng.random()] == [*whole.standard_normal(3), whole.random()]


def test_a_borrowed_generator_may_be_of_another_kind() -> None:
    found = []
    for _ in range(2):
        rng, out = np.random.Generator(np.random.MT19937(3)), np.zeros(2)
        with borrowed_stream(rng) as stream:
            fill_normal(stream, out)
        found.append([*out, rng.random()])
    assert found[0] == found[1] and len(set(found[0])) == 3
