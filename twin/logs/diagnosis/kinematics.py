"""A three-axis IMU against the velocity over ground: axes, units and mounting, without an AHRS.

Specific force and gravity along the tilt, which the gyros integrate to, make the acceleration that
the fixes show. Each fault is undone in turn: where that explains the velocities much better, it is
named.

Source: Fossen 2021, Sec. 14.2 (strapdown equations), linear in roll and pitch.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from twin.logs.columns import Array
from twin.logs.diagnosis.findings import ERROR, WARNING, Finding, Recording
from twin.logs.diagnosis.signals import ENOUGH, averaged, integrated, sampled, white_noise
from twin.particulars import GRAVITY, Particulars
from usv_kernel.scalar import rotation

__all__ = ["check_kinematics"]

_STEP, _SMOOTH = 0.1, 0.3
"""The signals are compared at such steps, as means over such a width, s."""

_SLOW = (12.0, 6.0, 3.0)
"""What changes more slowly is left out: gyros drift, and boats heel, s. The one counts with which
most is explained: noise is slow, and so are following seas."""

_BETTER = 1.2
"""A fault is named if undoing it divides the unexplained power by this ..."""

_EXPLAINED = 0.75
"""... and leaves no larger share unexplained ..."""

_EVIDENT = 10.0
"""... or divides it by this."""

_ASKEW = math.radians(6.0)
"""An IMU turned by more about its third axis is mounted askew ..."""

_SURE, _CLEAR = 5.0, 0.15
"""... if that is so many standard deviations, and no larger share is left unexplained."""

_SHORTEST, _LONGEST = 30.0, 1800.0
"""Shorter logs say nothing, and of longer ones the first part is enough, s."""

_INDEPENDENT = 0.6
"""Errors closer together say the same, s."""

_G_NOISE, _SIMILAR = (7.0, 14.0), 2.0
"""An axis in g has so many times less noise than the other two, which differ by no more than the
second."""

_DEGREES = 180.0 / math.pi

_LATENCY = 0.1
"""Of the fixes, if nobody states it, s."""

_RATES = "gyro_x_radps", "gyro_y_radps", "gyro_radps"

_FORCES = "accel_x_mps2", "accel_y_mps2", "accel_z_mps2"


class _Fault(NamedTuple):
    """What undoes a fault: which gyro and accelerometer is which, and their factors."""

    code: str
    what: str
    remedy: str
    columns: tuple[str, ...]
    gyros: tuple[int, int] = (0, 1)  # of roll and pitch
    forces: tuple[int, int] = (0, 1)  # forward and to starboard
    rate_factors: tuple[float, float] = (1.0, 1.0)
    force_factors: tuple[float, float] = (1.0, 1.0)


_EXCHANGE = "x is forward, y to starboard, z down: exchange the columns, or state imu_mounting"

_UNIT_G = 'state unit = "g" for this column in a mapping file'

_SWAPPED = "each fits the motion in the place of the other"

_AGAINST = "against the motion: it has the wrong sign"

_TURN = "x is forward, y to starboard, z down, and rates are about them: turn the sign"

_FAULTS = (
    _Fault("accel-swapped", _SWAPPED, _EXCHANGE, _FORCES[:2], forces=(1, 0)),
    _Fault("gyro-swapped", _SWAPPED, _EXCHANGE, _RATES[:2], gyros=(1, 0)),
    _Fault("gyro-swapped", _SWAPPED, _EXCHANGE, _RATES[1:], gyros=(0, 2)),
    _Fault("gyro-swapped", _SWAPPED, _EXCHANGE, _RATES[::2], gyros=(2, 1)),
    _Fault(
        "tilt-unit",
        "57 times too large for the motion",
        "these are degrees per second: name the columns gyro_x_degps and gyro_y_degps",
        _RATES[:2],
        rate_factors=(1.0 / _DEGREES, 1.0 / _DEGREES),
    ),
    _Fault(
        "accel-unit",
        "9.8 times too small for the motion: these are g",
        _UNIT_G,
        _FORCES[:1],
        force_factors=(GRAVITY, 1.0),
    ),
    _Fault(
        "accel-unit",
        "9.8 times too small for the motion: these are g",
        _UNIT_G,
        _FORCES[1:2],
        force_factors=(1.0, GRAVITY),
    ),
    _Fault("tilt-sign", _AGAINST, _TURN, _RATES[:1], rate_factors=(-1.0, 1.0)),
    _Fault("tilt-sign", _AGAINST, _TURN, _RATES[1:2], rate_factors=(1.0, -1.0)),
    _Fault("tilt-sign", _AGAINST, _TURN, _FORCES[:1], force_factors=(-1.0, 1.0)),
    _Fault("tilt-sign", _AGAINST, _TURN, _FORCES[1:2], force_factors=(1.0, -1.0)),
)


class _Signals(NamedTuple):
    """What the sensors say at even steps."""

    grid: Array  # (N,) s
    imu: Array  # (N, 6) rates and specific force
    velocity: Array  # (N, 2) north and east, m/s
    heading: Array  # (N,) rad
    lost: npt.NDArray[np.bool_]  # (N,) whether something is missing


class _Motion(NamedTuple):
    """Velocity over ground, and what makes it; fast parts of north, then of east."""

    velocity: Array  # (2 N,)
    forces: Array  # (2, 2, 2 N) along the first two axes of the IMU, taken forward and to starboard
    tilts: Array  # (3, 2, 2 N) the same of gravity along the integrals of the gyros


def check_kinematics(recording: Recording, particulars: Particulars | None = None) -> list[Finding]:
    """Return wrong axes, units and mounting of an IMU, as the velocity over ground shows them.

    Parameters
    ----------
    recording : Recording
        The log; gyros and accelerometers of three axes, velocity over ground and compass are
        needed.
    particulars : Particulars, optional
        State how the IMU is mounted, and how late the fixes are.
    """
    found = _check_noise(recording)
    signals = None if found else _signals_of(recording, particulars)
    if signals is None:
        return found
    motions = (_motion_of(signals, slow) for slow in _SLOW)
    fits = [_fit_of(motion) for motion in motions if motion is not None]
    if not fits:
        return found
    fit = min(fits, key=lambda fit: min(fit.left, fit.undone))
    if fit.left > _BETTER * fit.undone and (
        fit.undone < _EXPLAINED or fit.left > _EVIDENT * fit.undone
    ):
        fault, evidence = fit.fault, {"unexplained": fit.undone, "as_it_is": fit.left}
        what = f"{recording.called(*fault.columns)}: {fault.what}"
        return [Finding(ERROR, fault.code, what, fault.remedy, evidence)]
    if abs(fit.turn) > max(_ASKEW, _SURE * fit.turn_sd) and fit.left < _CLEAR:
        names = recording.called(*_RATES[:2], *_FORCES[:2])
        what = f"{names}: turned by {math.degrees(fit.turn):.0f} degrees about the third axis"
        remedy = (
            f"if it is how the IMU is mounted, state imu_mounting = [0.0, 0.0, {fit.turn:.3f}] in "
            "[instruments] of the particulars, or add it to the third angle there"
        )
        evidence = {"yaw_rad": fit.turn, "sd_rad": fit.turn_sd, "unexplained": fit.left}
        return [Finding(WARNING, "imu-askew", what, remedy, evidence)]
    return []


class _Fit(NamedTuple):
    """What explains the velocities; shares of their power that are left."""

    left: float  # as it is, or turned about the third axis
    turn: float  # that turn, rad
    turn_sd: float
    undone: float  # with the fault undone that explains most
    fault: _Fault


def _fit_of(motion: _Motion) -> _Fit:
    """Return how much of the velocities each fault explains."""
    power = _power(motion.velocity)
    ahead, aside = _predictions(motion, _Fault("", "", "", ()))
    # one that is mounted askew looks a little like all the others
    turn = math.atan2(float(aside @ motion.velocity), float(ahead @ motion.velocity))
    turned = math.cos(turn) * ahead + math.sin(turn) * aside
    left = min(_power(motion.velocity - part) for part in (turned, ahead))
    undone = [_power(motion.velocity - _predictions(motion, fault)[0]) for fault in _FAULTS]
    best = int(np.argmin(undone))
    independent = max(len(motion.velocity) * _STEP / _INDEPENDENT, 1.0)
    sd = math.sqrt(left / (independent * _power(aside)))
    return _Fit(left / power, turn, sd, undone[best] / power, _FAULTS[best])


def _power(values: Array) -> float:
    """Return the sum of squares, above 0."""
    return max(float(values @ values), 1e-300)


def _check_noise(recording: Recording) -> list[Finding]:
    """Return whether one horizontal accelerometer has the noise of one in g."""
    t, force = recording.samples(*_FORCES)
    if len(t) < 5 * ENOUGH:
        return []
    noise = [white_noise(t, column) for column in force.T]
    spread = force.std(axis=0)
    for k in range(2):
        others = noise[1 - k], noise[2]
        similar = 0.0 < max(others) < _SIMILAR * min(others)
        if not similar or not noise[k] > 0.0:
            continue
        ratio = math.sqrt(others[0] * others[1]) / noise[k]
        if _G_NOISE[0] < ratio < _G_NOISE[1] and 3.0 * spread[k] < max(spread[1 - k], spread[2]):
            what = (
                f"{recording.called(_FORCES[k])}: noise and motion {ratio:.0f} times less than of "
                "the other axes: these are g"
            )
            return [Finding(ERROR, "accel-unit", what, _UNIT_G, {"ratio": ratio})]
    return []


def _signals_of(recording: Recording, particulars: Particulars | None) -> _Signals | None:
    """Return the signals to compare at even steps; None where there are too few."""
    t_imu, imu = recording.samples(*_RATES, *_FORCES)
    t_fix, velocity = recording.samples("gps_vx_mps", "gps_vy_mps")
    t_psi, compass = recording.samples("compass_rad")
    if min(len(t_imu), len(t_fix), len(t_psi)) < 5 * ENOUGH:
        return None
    late = _LATENCY if particulars is None else particulars.instruments.gps_latency
    if particulars is not None:
        turn = rotation(particulars.instruments.imu_mounting)
        imu = np.hstack([imu[:, :3] @ turn.T, imu[:, 3:] @ turn.T])
    start = max(t_imu[0], t_fix[0] - late, t_psi[0]) + _SMOOTH
    end = min(t_imu[-1], t_fix[-1] - late, t_psi[-1]) - _SMOOTH
    if end - start < _SHORTEST:
        return None
    end = min(end, start + _LONGEST)
    grid = np.arange(start, end, _STEP)
    imu = averaged(t_imu, imu, grid, _SMOOTH)
    velocity = averaged(t_fix - late, velocity, grid, _SMOOTH)
    heading = sampled(t_psi, np.unwrap(compass[:, 0]), grid)
    lost = np.asarray(np.isnan(np.column_stack([imu, velocity, heading])).any(axis=1), np.bool_)
    imu[lost], velocity[lost], heading[lost] = 0.0, 0.0, 0.0
    return _Signals(grid, imu, velocity, heading, lost)


def _motion_of(signals: _Signals, slow: float) -> _Motion | None:
    """Return velocities without what is slower than this, s; None where too little is left."""
    width = round(slow / _STEP)
    # what lies near a gap or an end is wrong for as long as it is remembered
    far = np.convolve(signals.lost, np.ones(4 * width + 1))[2 * width : -2 * width] < 0.5
    far[: 2 * width] = far[-2 * width :] = False
    if far.sum() < 10 * ENOUGH:
        return None
    grid, c, s = signals.grid, np.cos(signals.heading), np.sin(signals.heading)

    def over_ground(values: Array, side: int) -> Array:
        """Return the velocity that an acceleration forward or to starboard makes."""
        way = np.column_stack([-s, c] if side else [c, s]) * values[:, None]
        return _fast(integrated(grid, way), width)[far].T.ravel()

    ones = np.ones(len(grid))
    constant = np.column_stack([over_ground(ones, side) for side in (0, 1)])  # heel and trim

    def both_ways(columns: Array) -> Array:
        """Return the velocities that accelerations (N, k) make, shape (k, 2, 2 M)."""
        return np.array(
            [
                [_without(constant, over_ground(column, side)) for side in (0, 1)]
                for column in columns.T
            ]
        )

    rates = signals.imu[:, :3] - signals.imu[~signals.lost, :3].mean(axis=0)
    return _Motion(
        _without(constant, _fast(signals.velocity, width)[far].T.ravel()),
        both_ways(signals.imu[:, 3:5]),
        both_ways(GRAVITY * _fast(integrated(grid, rates), width)),
    )


def _fast(values: Array, width: int) -> Array:
    """Return signals (N, k) without their means over so many steps."""
    mean = np.ones(width) / width
    slow = [np.convolve(np.convolve(column, mean, "same"), mean, "same") for column in values.T]
    return np.asarray(values - np.column_stack(slow))


def _without(known: Array, values: Array) -> Array:
    """Return a signal without what goes with known ones."""
    return np.asarray(values - known @ np.linalg.lstsq(known, values, rcond=None)[0])


def _predictions(motion: _Motion, fault: _Fault) -> tuple[Array, Array]:
    """Return the velocity with a fault undone, and the same turned by 90 degrees."""
    roll, pitch = (
        factor * motion.tilts[k] for k, factor in zip(fault.gyros, fault.rate_factors, strict=True)
    )
    x, y = (
        factor * motion.forces[k]
        for k, factor in zip(fault.forces, fault.force_factors, strict=True)
    )
    return x[0] - pitch[0] + y[1] + roll[1], x[1] - pitch[1] - y[0] - roll[0]
