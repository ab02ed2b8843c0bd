"""Small dense linear algebra for kernels: the same bits whatever library and threads there are."""

from __future__ import annotations

import math

from usv_kernel.jit import kernel
from usv_kernel.scalar import fma
from usv_kernel.simd import Block, Factors, Rows, Strip, accumulate, accumulate_rows

__all__ = [
    "add_product",
    "add_rows",
    "add_square",
    "cholesky",
    "dot",
    "invert",
    "packed_size",
    "solve_factored",
]

_PIVOT_MIN = 1e-13


@kernel
def cholesky(A, U, work):
    """Write the upper Cholesky factor U (n, n) of a symmetric A, U' U = A; U may be A itself.

    Only upper triangles are read and written. Where A is not positive definite to rounding, the
    row of that pivot is left 0; returned is the number of such pivots. ``work`` (1, n) is scratch.
    """
    n, lost = A.shape[0], 0
    for j in range(n):
        for i in range(j):
            work[0, i] = -U[i, j]
        row = U[j, j:]
        for k in range(row.shape[0]):
            row[k] = A[j, j + k]
        own = row[0]
        add_rows(U, j, (j, n), work, U, (0, j))
        if not (row[0] > _PIVOT_MIN * own and row[0] < math.inf):
            lost += 1
            row[:] = 0.0
            continue
        root = math.sqrt(row[0])
        for i in range(row.shape[0]):
            row[i] /= root
    return lost


@kernel
def solve_factored(U, b, x):
    """Write the solution x of U' U x = b, with U of full rank from :func:`cholesky`.

    ``x`` may be ``b``.
    """
    n = U.shape[0]
    for i in range(n):
        x[i] = b[i]
    for i in range(n):
        x[i] /= U[i, i]
        value, row, rest = x[i], U[i, i + 1 :], x[i + 1 :]
        for k in range(rest.shape[0]):
            rest[k] -= value * row[k]
    for i in range(n - 1, -1, -1):
        total = x[i]
        for k in range(i + 1, n):
            total -= U[i, k] * x[k]
        x[i] = total / U[i, i]


@kernel
def invert(U, out, work):
    """Write the inverse of U' U, symmetric to the last bit; ``work`` (n + 1, n) is scratch.

    U is from :func:`cholesky`, without a lost pivot.
    """
    n = U.shape[0]
    Y, column = work[:n], work[n:]  # Y = the inverse of U', lower
    for i in range(n):
        for k in range(i):
            column[0, k] = -U[k, i]
        Y[i] = 0.0
        Y[i, i] = 1.0
        add_rows(Y, i, (0, i), column, Y, (0, i))
        row = Y[i, : i + 1]
        for k in range(row.shape[0]):
            row[k] /= U[i, i]
    for i in range(n):
        for k in range(i, n):
            column[0, k] = Y[k, i]
        out[i] = 0.0
        add_rows(out, i, (0, i + 1), column, Y, (i, n))
        for k in range(i):
            out[k, i] = out[i, k]


@kernel
def add_rows(target, i, columns, factors, rows, which):
    """Add factors[0, j] * rows[j] for j = first ... last - 1 to some columns of target[i].

    ``columns`` is (start, stop), ``which`` (first, last). ``rows`` may be the target, of which row
    ``i`` is not among those then.
    """
    start, stop = columns
    first, last = which
    across = rows.shape[1]
    accumulate(
        Strip(target, i * target.shape[1] + start, stop - start),
        Factors(factors, first, 1, 1.0),
        Rows(rows, first * across + start, across, last - first),
    )


@kernel
def add_product(target, left, right, columns, rows, sign):
    """Add sign * left' right, summed over rows (first, last), to the target.

    ``columns`` is (size, start, stop): the rows of the target are the first ``size`` columns of
    left, its columns those of right from start to stop. With left = right and sign = 1 or -1,
    what is added is symmetric to the last bit.
    """
    size, start, stop = columns
    first, last = rows
    down, across = left.shape[1], right.shape[1]
    accumulate_rows(
        Block(target, start, target.shape[1], size, stop - start),
        Factors(left, first * down, down, sign),
        Rows(right, first * across + start, across, last - first),
    )


@kernel
def add_square(target, rows):
    """Add rows' rows to the upper triangle of the target (a, a)."""
    n = target.shape[0]
    for i in range(n):
        accumulate(
            Strip(target, i * n + i, n - i),
            Factors(rows, i, n, 1.0),
            Rows(rows, i, n, rows.shape[0]),
        )


@kernel
def dot(a, b, lanes):
    """Return the product of two vectors (6 n,), summed in lanes (n,) so that it can be vectorised.

    See :func:`packed_size`.
    """
    n = lanes.shape[0]
    A, B, C, D = a[:n], a[n : 2 * n], a[2 * n : 3 * n], a[3 * n : 4 * n]
    E, F, G, H = a[4 * n : 5 * n], a[5 * n :], b[:n], b[n : 2 * n]
    I, J, K, L = b[2 * n : 3 * n], b[3 * n : 4 * n], b[4 * n : 5 * n], b[5 * n :]
    for k in range(lanes.shape[0]):
        three = fma(C[k], I[k], fma(B[k], H[k], A[k] * G[k]))
        lanes[k] = fma(F[k], L[k], fma(E[k], K[k], fma(D[k], J[k], three)))
    first, second, third, fourth = 0.0, 0.0, 0.0, 0.0
    k = 0
    while k + 4 <= n:
        first += lanes[k]
        second += lanes[k + 1]
        third += lanes[k + 2]
        fourth += lanes[k + 3]
        k += 4
    while k < n:
        first += lanes[k]
        k += 1
    return (first + second) + (third + fourth)


@kernel
def packed_size(n):
    """Return the length of a packed symmetric matrix: its upper triangle by rows, then zeros.

    The zeros make it a multiple of six; see :func:`dot`.
    """
    return 6 * ((n * (n + 1) + 11) // 12)
