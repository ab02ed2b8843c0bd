"""What a log says of the axes of its IMU, as normal equations of two 3 x 3 matrices.

True rates are ``G`` times the gyros, true forces ``A`` times the accelerometers. The fast parts of
velocity over ground, compass and AHRS are linear in both matrices, as is gravity.

Source: Fossen 2021, Sec. 14.2 (strapdown equations), linear in roll and pitch.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from twin.logs.columns import Array
from twin.logs.diagnosis.findings import Recording
from twin.logs.diagnosis.signals import ENOUGH, averaged, integrated
from twin.particulars import GRAVITY

__all__ = ["FORCES", "LATENCY", "RATES", "VARIANTS", "WINDOW", "Evidence", "fast", "gather"]

RATES = "gyro_x_radps", "gyro_y_radps", "gyro_radps"

FORCES = "accel_x_mps2", "accel_y_mps2", "accel_z_mps2"

WINDOW = 10.0
"""Equations are kept for each stretch of so many seconds."""

VARIANTS = {
    "as it is": (1.0, 0.0, 0.0, 1.0),
    "roll reversed": (-1.0, 0.0, 0.0, 1.0),
    "pitch reversed": (1.0, 0.0, 0.0, -1.0),
    "both reversed": (-1.0, 0.0, 0.0, -1.0),
    "swapped": (0.0, 1.0, 1.0, 0.0),
    "turned to port": (0.0, 1.0, -1.0, 0.0),
    "turned to starboard": (0.0, -1.0, 1.0, 0.0),
    "in degrees": (math.pi / 180.0, 0.0, 0.0, math.pi / 180.0),
}
"""What an AHRS may show: the matrix (2, 2), row by row, that makes roll and pitch of it."""

_STEP, _SMOOTH = 0.1, 0.3
"""The signals are compared at such steps, as means over such a width, s."""

_SLOW = 6.0
"""What changes more slowly is left out: gyros drift, and boats heel, s."""

_SHORTEST, _LONGEST = 30.0, 1800.0
"""Shorter logs say nothing, and of longer ones the first part is enough, s."""

_ABSURD = 1e6
"""No sensor of a boat says as much, in SI units and rad."""

_INDEPENDENT = 0.6
"""Errors closer together say the same, s."""

_UNMODELLED = 0.1
"""So large a share of a signal is left out by the linear equations."""

_LEVEL, _SIZE = 0.06, 0.02
"""By so much the mean tilt of a boat (rad), and gravity as an IMU measures it, may differ."""

LATENCY = 0.1
"""Of the fixes, if nobody states it, s."""

_UNKNOWN = 18
"""Entries of both matrices, row by row, the gyros' first."""

ROLL, PITCH, YAW = ([3 * row + j for j in range(3)] for row in range(3))
AHEAD, ASIDE, DOWN = ([9 + 3 * row + j for j in range(3)] for row in range(3))


class Evidence(NamedTuple):
    """Normal equations of each window; ``m' square m - 2 m' cross + rest`` is the squared error.

    In units of its variance, for each of the :data:`VARIANTS` of the AHRS.
    """

    times: Array  # (W,) where each window begins, s
    square: Array  # (V, W, 18, 18)
    cross: Array  # (V, W, 18)
    rest: Array  # (V, W)
    ahrs: bool  # whether there is one

    def errors(self, m: Array, variant: int = 0) -> Array:
        """Return the squared errors of matrices (18,) in each window, shape (W,)."""
        return np.asarray(
            (self.square[variant] @ m) @ m - 2.0 * self.cross[variant] @ m + self.rest[variant]
        )


class _Block(NamedTuple):
    """Equations of one kind: ``columns @ m[at] = values``."""

    at: list[int]
    columns: Array  # (N, k)
    values: Array  # (N,)
    window: npt.NDArray[np.int64]  # (N,)


class _Signals(NamedTuple):
    """What the sensors say at even steps."""

    grid: Array  # (N,) s
    imu: Array  # (N, 6) rates and specific force
    velocity: Array  # (N, 2) north and east, m/s
    heading: Array  # (N,) rad
    angles: Array | None  # (N, 2) roll and pitch, rad
    lost: npt.NDArray[np.bool_]  # (N,) whether something is missing


def gather(recording: Recording, mounting: Array, late: float = LATENCY) -> Evidence | None:
    """Return what a log says of the axes of its IMU; None where it lacks sensors or time.

    Parameters
    ----------
    recording : Recording
        The log; gyros and accelerometers of three axes, velocity over ground and compass are
        needed, and an AHRS is used.
    mounting : ndarray, shape (3, 3)
        Turns the axes of the IMU, as far as their mounting is known, to those of the boat.
    late : float
        Delay of the fixes, s.
    """
    signals = _signals_of(recording, mounting, late)
    if signals is None:
        return None
    width = round(_SLOW / _STEP)
    # what lies near a gap or an end is wrong for as long as it is remembered
    near = np.convolve(signals.lost, np.ones(2 * width + 1))[width:-width] > 0.5
    near[:width] = near[-width:] = True
    kept = np.flatnonzero(~near)
    if len(kept) < 10 * ENOUGH:
        return None
    window = ((signals.grid[kept] - signals.grid[kept[0]]) / WINDOW).astype(np.int64)
    window = np.unique(window, return_inverse=True)[1].astype(np.int64)
    times = signals.grid[kept[np.searchsorted(window, np.arange(window[-1] + 1))]]
    fixed, by_angle = _equations(signals, kept, window, width)
    count = len(times)
    variants = len(VARIANTS) if by_angle else 1
    square = np.zeros((variants, count, _UNKNOWN, _UNKNOWN))
    cross, rest = np.zeros((variants, count, _UNKNOWN)), np.zeros((variants, count))
    for block in fixed:
        _add((square[0], cross[0], rest[0]), block, _variance(block, count))
    square[1:], cross[1:], rest[1:] = square[0], cross[0], rest[0]
    for kind in by_angle:
        variances = [_variance(block, count) for block in kind]
        if kind[0].at[0] >= AHEAD[0]:  # a wrong tilt leaves much, whatever the matrices
            variances = [min(variances)] * len(kind)
        for k, block in enumerate(kind):
            _add((square[k], cross[k], rest[k]), block, variances[k])
    _add_gravity((square, cross, rest), signals, kept, window)
    return Evidence(times, square, cross, rest, signals.angles is not None)


def _signals_of(recording: Recording, mounting: Array, late: float) -> _Signals | None:
    """Return the signals to compare at even steps; None where there are too few."""
    t_imu, imu = recording.samples(*RATES, *FORCES)
    t_fix, velocity = recording.samples("gps_vx_mps", "gps_vy_mps")
    t_psi, compass = recording.samples("compass_rad")
    if min(len(t_imu), len(t_fix), len(t_psi)) < 5 * ENOUGH:
        return None
    imu = np.hstack([imu[:, :3] @ mounting.T, imu[:, 3:] @ mounting.T])
    start = max(t_imu[0], t_fix[0] - late, t_psi[0]) + _SMOOTH
    end = min(t_imu[-1], t_fix[-1] - late, t_psi[-1]) - _SMOOTH
    if end - start < _SHORTEST:
        return None
    grid = np.arange(start, min(end, start + _LONGEST), _STEP)
    imu = averaged(t_imu, imu, grid, _SMOOTH)
    velocity = averaged(t_fix - late, velocity, grid, _SMOOTH)
    heading = averaged(t_psi, np.unwrap(compass[:, 0]), grid, _SMOOTH)
    lost = _absurd(np.column_stack([imu, velocity, heading]))

    t_angle, angles = recording.samples("ahrs_roll_rad", "ahrs_pitch_rad")
    tilted = None
    if len(t_angle) >= 5 * ENOUGH:
        tilted = averaged(t_angle, angles, grid, _SMOOTH)
        missing = _absurd(tilted)
        if (missing & ~lost).mean() > 0.5:
            tilted = None
        else:
            lost |= missing
            tilted[missing] = 0.0
    imu[lost], velocity[lost], heading[lost] = 0.0, 0.0, 0.0
    return _Signals(grid, imu, velocity, heading, tilted, lost)


def _absurd(values: Array) -> npt.NDArray[np.bool_]:
    """Return which rows (N, k) hold what is missing, or what no boat can measure."""
    return np.asarray(~(np.abs(values) < _ABSURD).all(axis=1), np.bool_)


def _equations(
    signals: _Signals, kept: npt.NDArray[np.int64], window: npt.NDArray[np.int64], width: int
) -> tuple[list[_Block], list[list[_Block]]]:
    """Return the equations without the AHRS, and those with it for each variant of its signs."""
    grid, c, s = signals.grid, np.cos(signals.heading), np.sin(signals.heading)
    known = ~signals.lost

    def summed(values: Array) -> Array:
        """Return the fast part of integrals of (N, k) values."""
        about = np.where(known[:, None], values - values[known].mean(axis=0), 0.0)
        return fast(integrated(grid, about), width)

    def over_ground(values: Array, side: int) -> Array:
        """Return the velocities (2 M, k) that accelerations forward or to starboard make."""
        north, east = (-s, c) if side else (c, s)
        both = [summed(values * part[:, None])[kept] for part in (north, east)]
        return _without(constant, np.concatenate(both)) if len(constant) else np.concatenate(both)

    constant = np.zeros((0, 0))
    ones = np.ones((len(grid), 1))
    constant = np.column_stack([over_ground(ones, side) for side in (0, 1)])  # heel and trim
    velocity = _without(constant, fast(signals.velocity, width)[kept].T.reshape(-1, 1))[:, 0]
    rates, forces = signals.imu[:, :3], signals.imu[:, 3:]
    tilts = GRAVITY * summed(rates)
    ahead, aside = over_ground(forces, 0), over_ground(forces, 1)
    twice = np.concatenate([window, window])
    fixed = [
        _Block(
            [*AHEAD, *ASIDE, *PITCH, *ROLL],
            np.hstack([ahead, aside, -over_ground(tilts, 0), over_ground(tilts, 1)]),
            velocity,
            twice,
        )
    ]
    turned = summed(rates)[kept]
    if signals.angles is None:
        psi = fast(signals.heading[:, None], width)[kept, 0]
        fixed.append(_Block(YAW, turned, psi, window))
    if signals.angles is None:
        return fixed, []
    by_angle: list[list[_Block]] = []
    yawing = np.gradient(signals.heading, grid)
    for entries in VARIANTS.values():
        roll, pitch = np.reshape(entries, (2, 2)) @ signals.angles.T
        p = np.gradient(roll, grid) - yawing * np.sin(pitch)
        tipping = np.gradient(pitch, grid)
        q = tipping * np.cos(roll) + yawing * np.sin(roll) * np.cos(pitch)
        r = yawing * np.cos(roll) * np.cos(pitch) - tipping * np.sin(roll)
        shown = summed(np.column_stack([p, q, r]))[kept]
        tilt = over_ground(GRAVITY * pitch[:, None], 0) - over_ground(GRAVITY * roll[:, None], 1)
        both = np.hstack([ahead, aside])
        blocks = [
            _Block(at, turned, shown[:, k], window) for k, at in enumerate((ROLL, PITCH, YAW))
        ]
        by_angle.append([*blocks, _Block([*AHEAD, *ASIDE], both, velocity + tilt[:, 0], twice)])
    return fixed, [list(blocks) for blocks in zip(*by_angle, strict=True)]


def _variance(block: _Block, count: int) -> float:
    """Return the variance of equations as the best matrices leave it in the typical window."""
    each = np.bincount(block.window, minlength=count)
    weight = np.ones(count)
    for _ in range(5):
        scale = np.sqrt(weight)[block.window]
        fit = np.linalg.lstsq(block.columns * scale[:, None], block.values * scale, rcond=1e-9)[0]
        left = (block.values - block.columns @ fit) ** 2
        power = np.bincount(block.window, left, count) / each
        typical = max(float(np.median(power)), 1e-12)
        weight = np.minimum(1.0, 2.0 * typical / np.maximum(power, 1e-12))
    signal = np.bincount(block.window, block.values**2, count) / each
    return typical + _UNMODELLED**2 * float(np.median(signal))


def _add(sums: tuple[Array, Array, Array], block: _Block, variance: float) -> None:
    """Add equations to the normal equations of their windows."""
    square, cross, rest = sums
    weight = _STEP / _INDEPENDENT / variance
    for k in range(len(rest)):
        inside = block.window == k
        columns, values = block.columns[inside], block.values[inside]
        square[k][np.ix_(block.at, block.at)] += weight * columns.T @ columns
        cross[k][block.at] += weight * columns.T @ values
        rest[k] += weight * float(values @ values)


def _add_gravity(
    sums: tuple[Array, Array, Array],
    signals: _Signals,
    kept: npt.NDArray[np.int64],
    window: npt.NDArray[np.int64],
) -> None:
    """Add that the mean specific force is the acceleration over ground, and gravity upwards."""
    square, cross, rest = sums
    count = rest.shape[1]
    c, s = np.cos(signals.heading), np.sin(signals.heading)
    north, east = (np.gradient(column, signals.grid) for column in signals.velocity.T)
    ahead, aside = north * c + east * s, east * c - north * s
    for k in range(count):
        rows = kept[window == k]
        force = signals.imu[rows, 3:].mean(axis=0)
        expected = ahead[rows].mean(), aside[rows].mean(), -GRAVITY
        for at, value, share in zip(
            (AHEAD, ASIDE, DOWN), expected, (_LEVEL, _LEVEL, _SIZE), strict=True
        ):
            weight = 1.0 / (share * GRAVITY) ** 2 / count
            square[:, k, at[0] : at[-1] + 1, at[0] : at[-1] + 1] += weight * np.outer(force, force)
            cross[:, k, at[0] : at[-1] + 1] += weight * value * force
            rest[:, k] += weight * value**2


def fast(values: Array, width: int) -> Array:
    """Return signals (N, k) without their means over so many steps."""
    mean = np.ones(width) / width
    slow = [np.convolve(np.convolve(column, mean, "same"), mean, "same") for column in values.T]
    return np.asarray(values - np.column_stack(slow))


def _without(known: Array, values: Array) -> Array:
    """Return signals without what goes with known ones."""
    return np.asarray(values - known @ np.linalg.lstsq(known, values, rcond=None)[0])
