"""How columns of an unknown log go with each other: factor, angle and sign, by correlation."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from twin.logs.columns import Array
from twin.logs.signals import ENOUGH, averaged, even_times, integrated, sampled, ways

__all__ = [
    "Agreement",
    "gyro_on_compass",
    "heading_on_track",
    "turns_as_driven",
    "velocity_on_fixes",
]

WINDOW_S = 2.0
"""Turns are compared over so many seconds."""

FAR_M = 1e9
"""No boat goes farther between two fixes, whatever the unit."""

HORIZONS_S = (1.0, 2.0, 4.0, 8.0)
SEEN = 0.4
"""Times over which commands turn a boat, and the correlation from which on they are seen to."""


class Agreement(NamedTuple):
    """How one signal goes with another, both as complex numbers."""

    ratio: float
    """Of the first to the second."""
    turned: float
    """Angle from the second to the first, rad."""
    coherence: float
    """Correlation; 1: one ratio and one angle."""
    mirrored: float
    """The same with the second mirrored, conjugate ..."""
    mirror: float
    """... and that angle, rad."""


def _agreement(a: npt.NDArray[Any], b: npt.NDArray[Any]) -> Agreement | None:
    """Return how a goes with b; None where they are few or nothing."""
    ok = (np.abs(a) < FAR_M) & (np.abs(b) < FAR_M)  # false for NaN too
    a, b = a[ok], b[ok]
    size = math.sqrt(float((np.abs(a) ** 2).sum() * (np.abs(b) ** 2).sum()))
    if len(a) < 8 or size == 0.0:
        return None
    along, across = complex(np.vdot(b, a)) / size, complex(a @ b) / size
    left = np.abs(b) > 0.3 * np.quantile(np.abs(b), 0.9)
    ratio = float(np.median(np.abs(a[left]) / np.abs(b[left])))
    return Agreement(
        ratio, float(np.angle(along)), abs(along), abs(across), float(np.angle(across))
    )


def velocity_on_fixes(
    fixes: tuple[Array, Array], velocities: tuple[Array, Array]
) -> Agreement | None:
    """Return how the way of fixes goes with integrated velocities; None where there is no way.

    Parameters
    ----------
    fixes, velocities : tuple of ndarray, shape (N,) and (N, 2)
        Times, s, and positions, m, or velocities.
    """
    if len(fixes[0]) < ENOUGH or len(velocities[0]) < ENOUGH:
        return None
    way, middle, step = ways(*fixes)
    if len(middle) < 8:
        return None
    edges = np.append(middle - 0.5 * step, middle[-1] + 0.5 * step)
    summed = integrated(*velocities)
    by_velocity = np.diff(averaged(velocities[0], summed, edges, 0.5 * step), axis=0)
    return _agreement(way @ (1.0, 1j), by_velocity @ (1.0, 1j))


def heading_on_track(fix: tuple[Array, Array], heading: tuple[Array, Array]) -> Agreement | None:
    """Return how the track of fixes goes with a heading, rad; None where there is no track."""
    if len(fix[0]) < ENOUGH or len(heading[0]) < ENOUGH:
        return None
    way, middle, step = ways(*fix)
    length = np.hypot(*way.T)
    psi = averaged(heading[0], np.unwrap(heading[1]), middle, step)
    # slow ways tell little, and long ones count no more than others
    fast = np.isfinite(psi) & (length > 0.2 * float(np.fmax.reduce(length, initial=1e-9)))
    way = way[fast] / np.sqrt(length[fast, None])
    return _agreement(way @ (1.0, 1j), np.sqrt(length[fast]) * np.exp(1j * psi[fast]))


def gyro_on_compass(
    t_compass: Array, compass: Array, t_gyro: Array, gyro: Array
) -> Agreement | None:
    """Return how an integrated yaw rate goes with a heading, rad; None where they are few.

    Parameters
    ----------
    t_compass, compass : ndarray, shape (N,)
        Times, s, and headings, rad, wrapped or not.
    t_gyro, gyro : ndarray, shape (M,)
        Times and yaw rates, rad/s. ``turned`` is pi where they have the other sign.
    """
    if len(compass) < ENOUGH or len(gyro) < ENOUGH:
        return None
    step = max(float(np.median(np.diff(t))) for t in (t_compass, t_gyro))
    edges = max(t_compass[0], t_gyro[0]), min(t_compass[-1], t_gyro[-1])
    grid = even_times(*edges, max(WINDOW_S, 6.0 * step), t_compass)
    turns = [
        np.diff(sampled(t, angle, grid))
        for t, angle in ((t_gyro, integrated(t_gyro, gyro)), (t_compass, np.unwrap(compass)))
    ]
    known = np.isfinite(turns).all(axis=0)
    x, y = (each[known] - each[known].sum() / max(known.sum(), 1) for each in turns)
    return _agreement(x + 0j, y + 0j)


def turns_as_driven(t: Array, psi: Array, difference: Array) -> bool:
    """Return whether more thrust on the left turns a boat to larger headings.

    Parameters
    ----------
    t, psi, difference : ndarray, shape (N,)
        Times, s, headings, rad, and thrust on the left less that on the right.
    """
    known = np.isfinite(psi) & np.isfinite(difference)
    if known.sum() < 3 * ENOUGH:
        return False
    t, psi, difference = t[known], np.unwrap(psi[known]), difference[known]
    pushed, best = integrated(t, difference), 0.0
    for horizon in HORIZONS_S:
        at = even_times(t[0] + horizon, t[-1] - 2.0 * horizon, horizon, t)
        if len(at) < ENOUGH:
            continue
        edges = [sampled(t, psi, at + k * horizon) for k in (-0.5, 0.5, 1.5)]
        before, after = edges[1] - edges[0], edges[2] - edges[1]
        acts = sampled(t, pushed, at + horizon) - sampled(t, pushed, at)
        ok = np.isfinite(after) & np.isfinite(before) & np.isfinite(acts)
        known_of = np.column_stack([before[ok], np.ones(int(ok.sum()))])
        both = np.column_stack([(after - before)[ok], acts[ok]])
        both = both - known_of @ np.linalg.lstsq(known_of, both, rcond=1e-9)[0]
        size = float(np.prod(np.linalg.norm(both, axis=0)))
        found = float(both[:, 0] @ both[:, 1]) / size if size > 0.0 else 0.0
        best = max(best, found, key=abs)
    return best > SEEN
