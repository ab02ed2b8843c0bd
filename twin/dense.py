"""Small dense linear algebra for kernels: the same bits whatever library and threads there are."""

from __future__ import annotations

import math

from usv_kernel import kernel

__all__ = ["add_product", "add_rows", "cholesky", "invert", "solve_factored"]

_PIVOT_MIN = 1e-13


@kernel
def cholesky(A, L):
    """Write the lower Cholesky factor of a symmetric matrix.

    Parameters
    ----------
    A : (n, n) array
        Symmetric; its lower triangle is read.
    L : (n, n) array
        Its factor, also the lower triangle alone; where A is not positive definite to
        rounding, the column of that pivot is left 0.

    Returns
    -------
    int
        Number of such pivots.
    """
    n, lost = A.shape[0], 0
    for j in range(n):
        pivot = A[j, j]
        for k in range(j):
            pivot -= L[j, k] * L[j, k]
        if not (pivot > _PIVOT_MIN * A[j, j] and pivot < math.inf):
            lost += 1
            for i in range(j, n):
                L[i, j] = 0.0
            continue
        root = math.sqrt(pivot)
        L[j, j] = root
        for i in range(j + 1, n):
            total = A[i, j]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            L[i, j] = total / root
    return lost


@kernel
def solve_factored(L, b, x):
    """Write the solution of L L' x = b.

    Parameters
    ----------
    L : (n, n) array
        From :func:`cholesky`, without a lost pivot.
    b, x : (n,) arrays
        Right side and solution; may be the same.
    """
    n = L.shape[0]
    for i in range(n):
        total = b[i]
        for k in range(i):
            total -= L[i, k] * x[k]
        x[i] = total / L[i, i]
    for i in range(n - 1, -1, -1):
        total = x[i]
        for k in range(i + 1, n):
            total -= L[k, i] * x[k]
        x[i] = total / L[i, i]


@kernel
def invert(L, out):
    """Write the inverse of L L'.

    Parameters
    ----------
    L : (n, n) array
        From :func:`cholesky`, without a lost pivot.
    out : (n, n) array
        The inverse, symmetric to the last bit.
    """
    n = L.shape[0]
    for j in range(n):
        for i in range(n):
            out[j, i] = 1.0 if i == j else 0.0
        solve_factored(L, out[j], out[j])
    for j in range(n):
        for i in range(j):
            out[i, j] = out[j, i] = 0.5 * (out[i, j] + out[j, i])


@kernel
def add_rows(target, i, start, stop, factors, row, rows, first, last):
    """Add factors[row, j] * rows[j] for j = first ... last - 1 to target[i], start to stop.

    Several rows at a time save loads and stores; the order of the sum is that of j. Loops over
    all of a slice become vector instructions, those from a start that is not known do not.

    Parameters
    ----------
    target : (a, b) array
        Row ``i`` is changed, in columns ``start`` to ``stop``.
    factors : (c, d) array
        Of row ``row`` the columns ``first`` to ``last`` count.
    rows : (d, b) array
        What is added; may be the target, of which row ``i`` is not among those then.
    """
    to = target[i, start:stop]
    j = first
    while j + 6 <= last:
        a, b, c = factors[row, j], factors[row, j + 1], factors[row, j + 2]
        d, e, f = factors[row, j + 3], factors[row, j + 4], factors[row, j + 5]
        A, B, C = rows[j, start:stop], rows[j + 1, start:stop], rows[j + 2, start:stop]
        D, E, F = rows[j + 3, start:stop], rows[j + 4, start:stop], rows[j + 5, start:stop]
        for k in range(to.shape[0]):
            three = to[k] + a * A[k] + b * B[k] + c * C[k]
            to[k] = three + d * D[k] + e * E[k] + f * F[k]
        j += 6
    while j + 2 <= last:
        a, b = factors[row, j], factors[row, j + 1]
        A, B = rows[j, start:stop], rows[j + 1, start:stop]
        for k in range(to.shape[0]):
            to[k] = to[k] + a * A[k] + b * B[k]
        j += 2
    while j < last:
        a, A = factors[row, j], rows[j, start:stop]
        for k in range(to.shape[0]):
            to[k] += a * A[k]
        j += 1


@kernel
def add_product(target, left, right, size, start, stop, first, last, sign):
    """Add sign * left' right, summed over their rows first to last, to the target.

    With left = right and sign = 1 or -1, what is added is symmetric to the last bit.

    Parameters
    ----------
    target : (a, b) array
        Its rows are the first ``size`` columns of left, its columns ``start`` to ``stop`` of
        right.
    left, right : (c, a), (c, b) arrays
        Factors.
    sign : float
        Factor of the product.
    """
    j = first
    while j + 6 <= last:
        A, B, C = right[j, start:stop], right[j + 1, start:stop], right[j + 2, start:stop]
        D, E, F = right[j + 3, start:stop], right[j + 4, start:stop], right[j + 5, start:stop]
        for i in range(size):
            a, b, c = sign * left[j, i], sign * left[j + 1, i], sign * left[j + 2, i]
            d, e, f = sign * left[j + 3, i], sign * left[j + 4, i], sign * left[j + 5, i]
            to = target[i, start:stop]
            for k in range(to.shape[0]):
                three = to[k] + a * A[k] + b * B[k] + c * C[k]
                to[k] = three + d * D[k] + e * E[k] + f * F[k]
        j += 6
    while j + 2 <= last:
        A, B = right[j, start:stop], right[j + 1, start:stop]
        for i in range(size):
            a, b = sign * left[j, i], sign * left[j + 1, i]
            to = target[i, start:stop]
            for k in range(to.shape[0]):
                to[k] = to[k] + a * A[k] + b * B[k]
        j += 2
    while j < last:
        A = right[j, start:stop]
        for i in range(size):
            a, to = sign * left[j, i], target[i, start:stop]
            for k in range(to.shape[0]):
                to[k] += a * A[k]
        j += 1
