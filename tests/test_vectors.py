"""Sums of rows and views, which kernels write out by hand."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from usv_kernel import in_python, kernel
from usv_kernel.vectors import LANES, accumulate, combine, dots
from usv_kernel.views import shaped, stack

GUARD = 12345.0


@kernel
def add(to, at, count, factors, start, step, sign, rows, first, width, many):
    accumulate(to, at, count, factors, start, step, sign, rows, first, width, many)


@kernel
def write(to, at, count, factors, start, step, sign, rows, first, width, many):
    combine(to, at, count, factors, start, step, sign, rows, first, width, many)


@kernel
def two_dots(a, b, x):
    return dots(a, b, x)


@kernel
def reversed_by_the_stack(numbers):
    room = stack(5)
    for i in range(5):
        room[i] = numbers[i]
    for i in range(5):
        numbers[i] = room[4 - i]


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


def test_room_on_the_stack_holds_what_is_put_there():
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
def test_rows_are_added_or_written_and_nothing_beside_them(
    count, many, step, sign, offsets, gap, seed
):
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
        call(to, at, count, factors, start, step, sign, rows, first, width, many)
        np.testing.assert_allclose(to[at : at + count], base + expected, rtol=0, atol=1e-13)
        assert (to[:at] == GUARD).all() and (to[at + count :] == GUARD).all()


def test_rows_may_lie_in_the_array_that_they_are_added_to():
    square = np.random.default_rng(0).normal(size=(7, 37))
    expected = square.copy()
    expected[5] += square[:5].T @ square[6, :5]
    add(square, 5 * 37, 37, square, 6 * 37, 1, 1.0, square, 0, 37, 5)
    np.testing.assert_allclose(square, expected, rtol=0, atol=1e-13)


@pytest.mark.parametrize("bad", [np.zeros(4, np.float32), np.zeros((4, 4))[:, ::2]])
def test_other_arrays_do_not_compile(bad):
    with pytest.raises(Exception, match="sums of rows take"):
        add(bad, 0, 4, np.zeros(4), 0, 1, 1.0, np.zeros(4), 0, 4, 1)


@kernel
def parts(flat, n, m):
    return shaped(flat, 0, (n, m)), shaped(flat, n * m, (2, n, m))


@kernel
def second(flat, n, m):
    return parts(flat, n, m)[1][1, 1, 0]


def test_views_are_those_of_reshape_in_kernels_and_in_python():
    flat = np.arange(40.0)
    one, two = in_python(parts)(flat, 3, 4)
    np.testing.assert_array_equal(one, flat[:12].reshape(3, 4))
    np.testing.assert_array_equal(two, flat[12:36].reshape(2, 3, 4))
    assert np.shares_memory(one, flat)
    assert second(flat, 3, 4) == two[1, 1, 0]
