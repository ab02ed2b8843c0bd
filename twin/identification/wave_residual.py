"""What the model leaves over: the waves, as an autoregressive process.

The measured velocities move with the waves and the model's do not. Their difference, sampled at
the window's step, is described by an autoregression for each of u, v and r:

    w_k = a_1 w_(k-1) + ... + a_6 w_(k-6) + noise

It predicts the next second or so, and its simulated paths say how far waves carry the boat from
the model's motion later on. Height, encounter period and effect of the waves depend on the heading:
paths are drawn by what was left on headings like those ahead.

Source: docs/explanation/twin.md, Waves and prediction intervals.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from usv_kernel.arrays import flat_size, take
from usv_kernel.jit import inlined, kernel

__all__ = [
    "FACTOR",
    "ORDER",
    "SECTORS",
    "SECTOR_SIZE",
    "between",
    "fit_sector_ar",
    "fit_waves",
    "forecast_waves",
    "heading_kernel",
    "sector_work_size",
    "simulate_waves",
]

ORDER = 6

RIDGE = 1e-3
"""Share of the variance that is treated as white noise of the estimate."""

ROOT_MAX = 0.98
"""Largest root of what predicts, and largest reflection coefficient of what is drawn: waves die
out, and never grow."""

HEADING_BANDWIDTH = math.radians(20.0)
"""Waves depend on the heading. A residual has a normal weight of this standard deviation, over the
difference between its heading and the one asked for, rad."""

SECTORS = 24
POOLED_PSEUDO_COUNT = 3.0
"""Sectors of headings; rows of all headings that each sector's fit includes."""

FACTOR = 3 * ORDER
"""Numbers of a sector before the lower triangular factor (3, 3) of its noise: coefficients."""

SECTOR_SIZE = FACTOR + 9


class WaveFitWork(NamedTuple):
    """Scratch of :func:`fit_waves`."""

    ahead: Any  # (N,) errors of a prediction
    back: Any  # (N,) errors of a prediction from later to earlier
    a: Any  # (6,) coefficients
    b: Any  # (6,) of the test of stability


@inlined
def _wave_fit_work(work, N):
    """Open the scratch of :func:`fit_waves` for N rows."""
    ahead, at = take(work, 0, (N,))
    back, at = take(work, at, (N,))
    a, at = take(work, at, (ORDER,))
    b, at = take(work, at, (ORDER,))
    return WaveFitWork(ahead, back, a, b)


class SectorWork(NamedTuple):
    """Scratch of :func:`fit_sector_ar` for N rows."""

    near: Any  # (N, 3) residuals, weighted by how near the heading was
    sector: Any  # (N,) sector of each row's heading
    everywhere: Any  # (3, 7) autocovariances of all headings
    covariances: Any  # (3, 7) those of a sector
    kernel: Any  # (24,) weight of a sector so far away
    seen: Any  # (24, 9) products of one-step errors
    sums: Any  # (9,) their sum for a sector; coefficients before
    pooled: Any  # (3,) variances of one-step errors of all headings


@inlined
def _sector_work(work, N):
    """Open the scratch of :func:`fit_sector_ar`."""
    near, at = take(work, 0, (N, 3))
    sector, at = take(work, at, (N,))
    everywhere, at = take(work, at, (3, ORDER + 1))
    covariances, at = take(work, at, (3, ORDER + 1))
    kernel, at = take(work, at, (SECTORS,))
    seen, at = take(work, at, (SECTORS, 9))
    sums, at = take(work, at, (9,))
    pooled, at = take(work, at, (3,))
    return SectorWork(near, sector, everywhere, covariances, kernel, seen, sums, pooled)


@kernel
def _burg(w, ahead, back, a):
    """Write the autoregression (6,) that predicts a column (N,) best, both ways in time.

    Forward errors alone would extrapolate a jump of the last second as growth. The ridge is
    that of white noise added to the column.

    Source: Burg 1967.
    """
    N, square = w.shape[0], 1e-12
    for n in range(N):
        ahead[n] = back[n] = w[n]
        square += w[n] * w[n]
    for m in range(ORDER):
        # of the noise: products of the coefficients (1, -a)
        both, own = 0.0, 1.0
        for i in range(m):
            both += a[i] * a[m - 1 - i]
            own += a[i] * a[i]
        both, own = RIDGE * square * both, RIDGE * square * own
        for n in range(m + 1, N):
            both += ahead[n] * back[n - 1]
            own += 0.5 * (ahead[n] * ahead[n] + back[n - 1] * back[n - 1])
        k = both / own
        for i in range((m + 1) // 2):
            one, two = a[i], a[m - 1 - i]
            a[i], a[m - 1 - i] = one - k * two, two - k * one
        a[m] = k
        for n in range(N - 1, m, -1):
            one, two = ahead[n], back[n - 1]
            ahead[n], back[n] = one - k * two, two - k * one


@kernel
def fit_waves(w, coefficients, work):
    """Fit a stable autoregression to each column, by Burg's method with a ridge.

    ``w`` (N, c) is evenly sampled and about zero, with more than twice :data:`ORDER` rows.
    ``coefficients`` (6, c), of the last value first, is written; ``work`` is scratch.
    """
    scratch = _wave_fit_work(work, w.shape[0])
    ahead, back, a, b = scratch.ahead, scratch.back, scratch.a, scratch.b
    for j in range(w.shape[1]):
        _burg(w[:, j], ahead, back, a)
        if not is_stable(a, ROOT_MAX, b):
            shrink, part = ROOT_MAX / spectral_radius(a, b), 1.0
            for i in range(ORDER):
                part *= shrink
                a[i] *= part
        for i in range(ORDER):
            coefficients[i, j] = a[i]


@kernel
def is_stable(a, size, b):
    """Return whether all roots of an autoregression a (6,), last value first, are below a size.

    Source: Schur and Cohn's test, by the recursion of Levinson and Durbin downwards.
    """
    part = 1.0
    for i in range(a.shape[0]):
        part /= size
        b[i] = part * a[i]
    for m in range(a.shape[0] - 1, -1, -1):
        k = b[m]
        if not abs(k) < 1.0:
            return False
        left = 1.0 / ((1.0 - k) * (1.0 + k))
        for i in range((m + 1) // 2):
            one, two = b[i], b[m - 1 - i]
            b[i], b[m - 1 - i] = left * (one + k * two), left * (two + k * one)
    return True


@kernel
def spectral_radius(a, b):
    """Return the size of the largest root; arguments as for :func:`is_stable`."""
    low, high = 0.0, 1.0
    for i in range(a.shape[0]):
        high = max(high, 1.0 + abs(a[i]))  # Cauchy's bound
    while high - low > 1e-14 * high:
        middle = 0.5 * (low + high)
        if is_stable(a, middle, b):
            high = middle
        else:
            low = middle
    return high


@kernel
def forecast_waves(past, coefficients, path):
    """Write an autoregression's noise-free continuation of its last values (6, c), newest first.

    ``path`` (K + 1, c) begins with the newest value.
    """
    for j in range(path.shape[1]):
        path[0, j] = past[0, j]
    for k in range(1, path.shape[0]):
        for j in range(path.shape[1]):
            value = 0.0
            for i in range(ORDER):
                value += coefficients[i, j] * (path[k - 1 - i, j] if i < k else past[i + 1 - k, j])
            path[k, j] = value


@inlined
def heading_kernel(away):
    """Return the root of the weight of a row whose heading differs by ``away`` (rad)."""
    return math.exp(0.5 * (math.cos(away) - 1.0) / HEADING_BANDWIDTH**2)


@inlined
def _sector(psi):
    """Return the sector of a heading."""
    return round(psi * (SECTORS / (2.0 * math.pi))) % SECTORS


@kernel
def _levinson(R, a):
    """Write the autoregression of autocovariances (7,); return the variance of its noise."""
    left = R[0]
    for m in range(ORDER):
        k = R[m + 1]
        for i in range(m):
            k -= a[i] * R[m - i]
        k = min(max(k / left, -ROOT_MAX), ROOT_MAX)
        for i in range((m + 1) // 2):
            one, two = a[i], a[m - 1 - i]
            a[i], a[m - 1 - i] = one - k * two, two - k * one
        a[m] = k
        left *= (1.0 - k) * (1.0 + k)
    return left


@kernel
def _add_covariances(w, R):
    """Add the autocovariances of rows (N, 3), times N, to R (3, 7)."""
    for n in range(w.shape[0]):
        for i in range(min(ORDER, n) + 1):
            for j in range(3):
                R[j, i] += w[n, j] * w[n - i, j]


@kernel
def _join(cov, many, row):
    """Correlate the noise of u, v, r as ``cov`` (3, 3) + diag(``many``) says; sizes stay."""
    a, b, c = cov[0] + many[0], cov[4] + many[1], cov[8] + many[2]
    ab, ac = cov[1] / math.sqrt(a * b), cov[2] / math.sqrt(a * c)
    rest = math.sqrt(1.0 - ab * ab)
    bc = (cov[5] / math.sqrt(b * c) - ab * ac) / rest
    two, three = row[FACTOR + 4], row[FACTOR + 8]
    row[FACTOR + 3], row[FACTOR + 4] = ab * two, rest * two
    row[FACTOR + 6], row[FACTOR + 7] = ac * three, bc * three
    row[FACTOR + 8] = math.sqrt(max(1.0 - ac * ac - bc * bc, 0.0)) * three


def sector_work_size(N: int) -> int:
    """Return the length of the scratch of :func:`fit_sector_ar` for N rows."""
    return flat_size(_sector_work, N)


@kernel
def fit_sector_ar(w, psi, good, sectors, work):
    """Describe the waves of each sector of headings.

    The autocovariances are weighted by how near the heading was, both rows of a product by the root
    of that. So each autoregression is stable.

    ``w`` (N, 3) are residuals of u, v, r about zero, zeros where not good; ``good`` (N,) is above 0
    where the row counts. ``sectors`` (24, 27) is written: coefficients (6, 3), of the last value
    first, and the lower triangular factor (3, 3) of the noise. ``work`` is
    :func:`sector_work_size` long.
    """
    N = w.shape[0]
    scratch = _sector_work(work, N)
    near, at, all_, R = scratch.near, scratch.sector, scratch.everywhere, scratch.covariances
    kernel_of, seen, sums, many = scratch.kernel, scratch.seen, scratch.sums, scratch.pooled
    a = sums[:ORDER]
    count = 0.0
    for k in range(N):
        count += 1.0 if good[k] > 0.0 else 0.0
        at[k] = _sector(psi[k])
    count = max(count, 1.0)
    for m in range(SECTORS):
        kernel_of[m] = heading_kernel(m * (2.0 * math.pi / SECTORS))
    all_[:] = 0.0
    _add_covariances(w, all_)
    for m in range(SECTORS):
        weight = POOLED_PSEUDO_COUNT
        for k in range(N):
            share = kernel_of[m - int(at[k])] if good[k] > 0.0 else 0.0
            weight += share * share
            for j in range(3):
                near[k, j] = share * w[k, j]
        for j in range(3):
            for i in range(ORDER + 1):
                R[j, i] = POOLED_PSEUDO_COUNT / count * all_[j, i]
        _add_covariances(near, R)
        row = sectors[m]
        for j in range(3):
            for i in range(ORDER + 1):
                R[j, i] /= weight
            R[j, 0] += RIDGE * R[j, 0] + 1e-12
            left = _levinson(R[j], a)
            for i in range(ORDER):
                row[3 * i + j] = a[i]
            for i in range(3):
                row[FACTOR + 3 * j + i] = math.sqrt(left) if i == j else 0.0
    # one-step errors, by sectors
    seen[:] = 0.0
    many[:] = 0.0
    run = 0
    for k in range(N):
        run = run + 1 if good[k] > 0.0 else 0
        if run <= ORDER:
            continue
        m = int(at[k])
        for j in range(3):
            sums[j] = w[k, j]
            for i in range(ORDER):
                sums[j] -= sectors[m, 3 * i + j] * w[k - 1 - i, j]
            many[j] += POOLED_PSEUDO_COUNT / count * sums[j] ** 2
        for i in range(3):
            for j in range(3):
                seen[m, 3 * i + j] += sums[i] * sums[j]
    for j in range(3):
        many[j] += 1e-12
    for m in range(SECTORS):
        sums[:] = 0.0
        for k in range(SECTORS):
            share = kernel_of[m - k] ** 2
            for i in range(9):
                sums[i] += share * seen[k, i]
        _join(sums, many, sectors[m])


@kernel
def simulate_waves(sectors, psi, shocks, out):
    """Write paths (D, K, 3) of waves from a calm on, along headings ``psi`` (K,).

    ``shocks`` (D, k, 3) are standard normal, used again where they do not reach; zeros stay calm.
    """
    for k in range(psi.shape[0]):
        row = sectors[_sector(psi[k])]
        for d in range(out.shape[0]):
            for j in range(3):
                value = 0.0
                for i in range(j + 1):
                    value += row[FACTOR + 3 * j + i] * shocks[d, k % shocks.shape[1], i]
                for i in range(min(ORDER, k)):
                    value += row[3 * i + j] * out[d, k - 1 - i, j]
                out[d, k, j] = value


@kernel
def between(path, grid, after, ends, means):
    """Write values of paths at rising times ``after`` (s), and their means from each to the next.

    ``path`` (D, K + 1, c) has values from now on, ``grid`` s apart, with straight lines between
    them. The first of the means (D, M, c) is since now.
    """
    last = path.shape[1] - 2
    for d in range(path.shape[0]):
        for j in range(path.shape[2]):
            carried, done, before, t = 0.0, 0, 0.0, 0.0
            for m in range(after.shape[0]):
                low = min(int(after[m] / grid), last)
                while done < low:
                    carried += 0.5 * grid * (path[d, done, j] + path[d, done + 1, j])
                    done += 1
                share = after[m] / grid - low
                first, rise = path[d, low, j], path[d, low + 1, j] - path[d, low, j]
                ends[d, m, j] = first + share * rise
                total = carried + grid * share * (first + 0.5 * share * rise)
                means[d, m, j] = (total - before) / (after[m] - t)
                before, t = total, after[m]
