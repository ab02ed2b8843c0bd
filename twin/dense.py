"""Small dense linear algebra for kernels: the same bits whatever library and threads there are."""

from __future__ import annotations

import math

from usv_kernel import kernel

__all__ = ["cholesky", "invert", "solve_factored"]

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
