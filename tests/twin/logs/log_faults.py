"""Faults put into sound logs, for tests."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

Fault = Callable[[np.ndarray, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]


def changed(part: int, *columns: int) -> Callable[[Callable[[np.ndarray], np.ndarray]], Fault]:
    """Return a fault of some columns of t, z or cmd from a function of their values."""

    def of(change: Callable[[np.ndarray], np.ndarray]) -> Fault:
        def fault(*log: np.ndarray):
            values = log[part].copy()
            values[:, columns] = change(values[:, columns])
            return *log[:part], values, *log[part + 1 :]

        return fault

    return of


def late_by(seconds: float, *columns: int) -> Fault:
    """Return the fault of sensors whose samples come late."""

    def fault(t: np.ndarray, z: np.ndarray, cmd: np.ndarray):
        rows = round(seconds / float(np.median(np.diff(t))))
        z = z.copy()
        z[rows:, columns] = z[:-rows, columns]
        z[:rows, columns] = np.nan
        return t, z, cmd

    return fault


def jitter(t: np.ndarray, z: np.ndarray, cmd: np.ndarray):
    step = float(np.median(np.diff(t)))
    rng = np.random.default_rng(1)
    return t + step * rng.uniform(-0.4, 0.4, len(t)), z, cmd


def gaps(t: np.ndarray, z: np.ndarray, cmd: np.ndarray):
    kept = ((t < 30.0) | (t > 33.0)) & ((t < 60.0) | (t > 60.8))
    return t[kept], z[kept], cmd[kept]


def milliseconds(t: np.ndarray, z: np.ndarray, cmd: np.ndarray):
    return 1000.0 * t, z, cmd


def clock_set_back(t: np.ndarray, z: np.ndarray, cmd: np.ndarray):
    return t - 5.0 * (t > 50.0), z, cmd


def no_fix(t: np.ndarray, z: np.ndarray, cmd: np.ndarray):
    z = z.copy()
    z[(t > 40.0) & (t < 55.0), :4] = np.nan
    return t, z, cmd


def frozen(start: float, end: float, *columns: int) -> Fault:
    def fault(t: np.ndarray, z: np.ndarray, cmd: np.ndarray):
        z, rows = z.copy(), (t > start) & (t < end)
        first = int(np.argmax(rows))
        for column in columns:
            seen = z[:first, column]
            z[rows, column] = seen[np.isfinite(seen)][-1]
        return t, z, cmd

    return fault


def stale(t: np.ndarray, z: np.ndarray, cmd: np.ndarray):
    z = z.copy()
    for start in range(200, len(t) - 100, 400):
        z[start : start + 30] = z[start]
    return t, z, cmd


def jump(t: np.ndarray, z: np.ndarray, cmd: np.ndarray):
    z = z.copy()
    z[(t > 40.0) & (t < 42.0), :2] += 500.0
    return t, z, cmd


def degrees_wrapped(z: np.ndarray) -> np.ndarray:
    return np.degrees(z) % 360.0


def course_as_radians(z: np.ndarray) -> np.ndarray:
    speed, course = np.hypot(*z.T), np.degrees(np.arctan2(z[:, 1], z[:, 0])) % 360.0
    return np.column_stack([speed * np.cos(course), speed * np.sin(course)])


def to_latitude(z: np.ndarray) -> np.ndarray:
    return z / 111_000.0 + np.array([59.43, 10.47])


def swapped_latitude(z: np.ndarray) -> np.ndarray:
    """Return fixes whose latitude (59 degrees) and longitude were swapped before conversion."""
    narrow, wide = math.cos(math.radians(59.43)), math.cos(math.radians(10.47))
    return np.column_stack([z[:, 1] / narrow, z[:, 0] * wide])
