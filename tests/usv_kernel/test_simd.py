"""Sums of rows and views, which kernels write out by hand."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from usv_kernel.arrays import alloca_f64, shaped
from usv_kernel.jit import kernel, py_func
from usv_kernel.simd import (
    LANES,
    Block,
    Factors,
    Rows,
    Strip,
    accumulate,
    accumulate_rows,
    combine,
    dots,
    inner,
)

GUARD = 12345.0


@kernel
def add(strip, factors, rows):
    accumulate(strip, factors, rows)


@kernel
def write(strip, factors, rows):
    combine(strip, factors, rows)


@kernel
def add_matrix(block, factors, rows):
    accumulate_rows(block, factors, rows)


@kernel
def product(a, first, b, start, count):
    return inner(a, first, b, start, count)


@kernel
def two_dots(a, b, x):
    return dots(a, b, x)


@kernel
def reversed_by_the_stack(numbers):
    scratch = alloca_f64(5)
    for i in range(5):
        scratch[i] = numbers[i]
    for i in range(5):
        numbers[i] = scratch[4 - i]


@settings(deadline=None)  # the first call compiles
@given(groups=st.integers(0, 9), over=st.integers(0, LANES - 1), seed=st.integers(0, 2**32 - 1))
def test_dots_are_those_of_whole_groups_in_a_fixed_order(groups, over, seed):
    rng = np.random.default_rng(seed)
    a, b, x = rng.normal(size=(3, groups * LANES + over))
    whole = slice(0, groups * LANES)
    found = two_dots(a, b, x)
    np.testing.assert_allclose(found, (a[whole] @ x[whole], b[whole] @ x[whole]), atol=1e-12)
    # each of the sums by itself: neither what stands beside it nor where it lies changes a bit
    assert two_dots(b, a, x) == found[::-1]
    assert two_dots(*np.pad([a[whole], b[whole], x[whole]], ((0, 0), (0, 3 * LANES)))) == found


def test_array_on_the_stack_holds_what_is_put_there():
    numbers = np.arange(7.0)
    reversed_by_the_stack(numbers)
    np.testing.assert_array_equal(numbers, [4.0, 3.0, 2.0, 1.0, 0.0, 5.0, 6.0])


@settings(deadline=None)  # the first call compiles
@given(
    count=st.integers(0, 70),
    many=st.integers(0, 13),
    step=st.sampled_from([-3, -1, 1, 2, 31]),
    sign=st.sampled_from([1.0, -1.0, 0.25]),
    offsets=st.tuples(*[st.integers(0, 5)] * 2),
    gap=st.integers(0, 5),
    seed=st.integers(0, 2**32 - 1),
)
def test_rows_are_added_or_written_and_nothing_else(count, many, step, sign, offsets, gap, seed):
    rng = np.random.default_rng(seed)
    at, first = offsets
    width = count + gap
    factors = rng.normal(size=max(many, 1) * abs(step) + 1)
    start = 0 if step > 0 else len(factors) - 1
    rows = rng.normal(size=first + many * width + count + 1)
    before = rng.normal(size=at + count + 3)
    expected = sum(
        (sign * factors[start + j * step] * rows[first + j * width :][:count] for j in range(many)),
        np.zeros(count),
    )
    for call, base in ((add, before[at : at + count]), (write, 0.0)):
        to = np.full(len(before), GUARD)
        to[at : at + count] = before[at : at + count]
        call(
            Strip(to, at, count),
            Factors(factors, start, step, sign),
            Rows(rows, first, width, many),
        )
        np.testing.assert_allclose(to[at : at + count], base + expected, rtol=0, atol=1e-13)
        assert (to[:at] == GUARD).all() and (to[at + count :] == GUARD).all()


@settings(deadline=None)  # the first call compiles
@given(
    size=st.integers(0, 9),
    count=st.integers(0, 40),
    many=st.integers(0, 14),
    sign=st.sampled_from([1.0, -1.0]),
    gaps=st.tuples(*[st.integers(0, 3)] * 5),
    seed=st.integers(0, 2**32 - 1),
)
def test_a_matrix_of_rows_is_added_as_row_by_row(size, count, many, sign, gaps, seed):
    rng = np.random.default_rng(seed)
    at, first, start, over, extra = gaps
    apart, width, step = count + over, count + extra, size + over
    factors = rng.normal(size=start + many * step + size + 1)
    rows = rng.normal(size=first + many * width + count + 1)
    to = rng.normal(size=at + size * apart + count + 1)
    singly = to.copy()
    of_rows = Rows(rows, first, width, many)
    for i in range(size):
        one = Strip(singly, at + i * apart, count)
        add(one, Factors(factors, start + i, step, sign), of_rows)
    add_matrix(Block(to, at, apart, size, count), Factors(factors, start, step, sign), of_rows)
    # to the bit: each number's terms are fused in the same order
    np.testing.assert_array_equal(to, singly)


def test_infinity_stays_in_its_column():
    rows, to = np.ones(9), np.zeros((2, 9))
    rows[1] = math.inf  # seen twice: by the first eight columns, and by the last
    add_matrix(Block(to, 0, 9, 2, 9), Factors(np.ones(2), 0, 1, 1.0), Rows(rows, 0, 9, 1))
    expected = np.ones((2, 9))
    expected[:, 1] = math.inf
    np.testing.assert_array_equal(to, expected)


@settings(deadline=None)  # the first call compiles
@given(count=st.integers(0, 40), places=st.tuples(*[st.integers(0, 5)] * 2))
def test_inner_takes_so_many_numbers_and_no_more(count, places):
    rng = np.random.default_rng(count)
    a, b = np.full((2, 50), np.nan)
    first, start = places
    a[first : first + count], b[start : start + count] = rng.normal(size=(2, count))
    expected = a[first : first + count] @ b[start : start + count]
    assert abs(product(a, first, b, start, count) - expected) < 1e-13


def test_rows_may_lie_in_the_array_that_they_are_added_to():
    square = np.random.default_rng(0).normal(size=(7, 37))
    expected = square.copy()
    expected[5] += square[:5].T @ square[6, :5]
    add(Strip(square, 5 * 37, 37), Factors(square, 6 * 37, 1, 1.0), Rows(square, 0, 37, 5))
    np.testing.assert_allclose(square, expected, rtol=0, atol=1e-13)


@pytest.mark.parametrize("bad", [np.zeros(4, np.float32), np.zeros((4, 4))[:, ::2]])
def test_other_arrays_do_not_compile(bad):
    with pytest.raises(Exception, match="sums of rows take"):
        add(Strip(bad, 0, 4), Factors(np.zeros(4), 0, 1, 1.0), Rows(np.zeros(4), 0, 4, 1))


@kernel
def parts(flat, n, m):
    return shaped(flat, 0, (n, m)), shaped(flat, n * m, (2, n, m))


@kernel
def second(flat, n, m):
    return parts(flat, n, m)[1][1, 1, 0]


def test_views_are_those_of_reshape_in_kernels_and_outside():
    flat = np.arange(40.0)
    one, two = py_func(parts)(flat, 3, 4)
    np.testing.assert_array_equal(one, flat[:12].reshape(3, 4))
    np.testing.assert_array_equal(two, flat[12:36].reshape(2, 3, 4))
    assert np.shares_memory(one, flat)
    assert second(flat, 3, 4) == two[1, 1, 0]
