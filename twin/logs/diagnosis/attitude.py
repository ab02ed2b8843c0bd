"""Sensors of roll, pitch and heave against gravity and each other: units, signs, axes, mounting."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from twin.channels import MEASUREMENTS, MOTION_AT, MOTION_END
from twin.logs.columns import Array
from twin.logs.diagnosis.axes.evidence import LATENCY
from twin.logs.diagnosis.axes.height import check_height
from twin.logs.diagnosis.axes.verdict import axes_unchecked, check_axes
from twin.logs.diagnosis.findings import ERROR, WARNING, Finding, Recording
from twin.logs.diagnosis.signals import ENOUGH, sampled
from twin.particulars import GRAVITY, Particulars
from usv_kernel.channels import ACCEL_X, ACCEL_Y
from usv_kernel.scalar import rotation

__all__ = ["check_attitude", "is_three_axis", "unchecked_axes", "upright"]

_ASKEW = math.radians(6.0)
"""A boat may heel and trim by less in the mean; more is how the IMU is mounted."""

_TRIM = math.radians(3.5)
"""A boat may trim by less in the mean."""

_APART = math.radians(3.0)
"""Gravity and an AHRS differ by less in the mean."""

_AROUND = 0.3
"""A boat whose turn accelerates it by less, m/s2, hardly turns."""

_AXIS = math.radians(50.0)
"""With gravity further off the third axis, another one points down."""

_G_UNIT = 0.8, 1.25
"""Mean specific force in units of gravity is between these, times 1 for g."""

_OFF = 0.05
"""Gravity as sound accelerometers measure it differs by less, as a share."""

_CLEAR = 0.6
"""From this correlation on two signals belong together."""

_SAME = 0.9
"""From this correlation on two sensors measure the same motion."""

_OPPOSED = 0.5
"""From this correlation on, with the other sign, the AHRS and gravity contradict each other."""

_SLIGHT = math.radians(0.4)
"""Angles of less are no larger than the errors of an AHRS."""

_STEEP = math.radians(75.0)
"""No boat sails on with such a roll; these are degrees."""

_BETTER = 0.02
"""The other gyro fits better if its correlation is larger by this."""

_TURNING = 0.05
"""Yaw rate of a boat that sails straight on, rad/s."""

_ROUND = 2.0
"""A compass shows over so many seconds how a boat turns."""

_SMOOTH = 0.3
"""Changes are compared over so many seconds."""

_DEAD = 10.0
"""An axis that says the same for so long is dead, s."""

_STILL = 0.003
"""Rates below, rad/s, and speeds, m/s, tell nothing."""

_SPAN, _TOO_LARGE = 1.0, 50.0
"""Changes of the vertical speed over such a time (s) that are so many times those of the integrated
accelerometers are in cm/s, whatever the noise."""

_ANGLES = "ahrs_roll_rad", "ahrs_pitch_rad"

_FORCE = "accel_x_mps2", "accel_y_mps2", "accel_z_mps2"


def check_attitude(recording: Recording, particulars: Particulars | None = None) -> list[Finding]:
    """Return what is wrong with the sensors of roll, pitch and heave.

    Parameters
    ----------
    recording : Recording
        The log.
    particulars : Particulars, optional
        State how the IMU is known to be mounted.
    """
    found = _dead_axes(recording)
    stated = (0.0, 0.0, 0.0) if particulars is None else particulars.instruments.imu_mounting
    mounting = rotation(stated)
    of_gravity = _check_gravity(recording, mounting)
    dead = bool(found)
    if not dead and not any(finding.severity == ERROR for finding in of_gravity):
        of_gravity = _check_size(recording, mounting) + of_gravity
    if dead:  # it also turns the mean
        of_gravity = [finding for finding in of_gravity if finding.code != "imu-askew"]
    found += of_gravity
    found += [finding for angle in _ANGLES for finding in _check_angle(recording, angle)]
    if not any(finding.severity == ERROR for finding in found) and not dead:
        for finding in found:
            if finding.code != "imu-askew":
                continue
            turn = rotation((finding.evidence["roll_rad"], finding.evidence["pitch_rad"], 0.0))
            mounting = turn @ mounting
        late = LATENCY if particulars is None else particulars.instruments.gps_latency
        wrong = check_axes(recording, mounting, late)
        if wrong is None:
            wrong = _check_rates(recording)
        found = _together(found, wrong)
    return found + check_height(recording)


def unchecked_axes(
    recording: Recording, particulars: Particulars | None = None
) -> tuple[str, ...] | None:
    """Return the columns of an IMU whose axis and sign a log does not tell; None for no such IMU.

    Parameters
    ----------
    recording, particulars
        As for :func:`check_attitude`.
    """
    stated = (0.0, 0.0, 0.0) if particulars is None else particulars.instruments.imu_mounting
    late = LATENCY if particulars is None else particulars.instruments.gps_latency
    return axes_unchecked(recording, rotation(stated), late)


def _together(askew: list[Finding], wrong: list[Finding]) -> list[Finding]:
    """Return findings of gravity and of the axes as one where they have one cause."""
    scale = [finding for finding in askew if finding.code != "imu-askew"]
    askew = [finding for finding in askew if finding.code == "imu-askew"]
    if not askew or not wrong:
        return scale + askew + wrong
    if wrong[0].code != "imu-askew" or "pitch_rad" not in askew[0].evidence:
        return scale + wrong  # it looks like a mounting
    yaw = wrong[0].evidence["yaw_rad"]
    evidence = {**askew[0].evidence, **wrong[0].evidence}
    what = f"{askew[0].what}; {wrong[0].what}"
    angles = f"[{evidence['roll_rad']:.3f}, {evidence['pitch_rad']:.3f}, {yaw:.3f}]"
    remedy = f"if it is the IMU, state imu_mounting = {angles} in [instruments] of the particulars"
    return [*scale, replace(askew[0], what=what, remedy=remedy, evidence=evidence)]


def _check_rates(recording: Recording) -> list[Finding]:
    """Return how gyros go with an AHRS where no velocity over ground helps."""
    found = _check_rate(recording, _ANGLES[0], "gyro_x_radps", "gyro_y_radps")
    return found + _check_rate(recording, _ANGLES[1], "gyro_y_radps", "gyro_x_radps")


def upright(recording: Recording) -> Recording:
    """Return a recording with yaw rate and accelerations as on a boat that does not roll or pitch.

    The angles are those of the AHRS. Where they or the other axes of the IMU are missing,
    nothing changes.
    """
    t, angle = recording.samples("ahrs_roll_rad", "ahrs_pitch_rad")
    names = ("gyro_x_radps", "gyro_y_radps", "gyro_radps", *_FORCE)
    columns = [MEASUREMENTS.index(name) for name in names]
    imu = recording.z[:, columns]
    if len(t) < 5 * ENOUGH or not (np.isfinite(imu).sum(axis=0) >= 5 * ENOUGH).all():
        return recording
    roll, pitch = sampled(t, angle, recording.t).T
    q, r = imu[:, 1], imu[:, 2]
    x, y, low = imu[:, 3:].T
    down = y * np.sin(roll) + low * np.cos(roll)
    z = recording.z.copy()
    z[:, columns[2]] = (q * np.sin(roll) + r * np.cos(roll)) / np.cos(pitch)
    z[:, columns[3]] = x * np.cos(pitch) + down * np.sin(pitch)
    z[:, columns[4]] = y * np.cos(roll) - low * np.sin(roll)
    return replace(recording, z=z)


def is_three_axis(recording: Recording) -> bool:
    """Return whether a log has gyros and accelerometers of three axes."""
    names = ("gyro_x_radps", "gyro_y_radps", "gyro_radps", *_FORCE)
    return len(recording.samples(*names)[0]) >= 5 * ENOUGH


def _dead_axes(recording: Recording) -> list[Finding]:
    """Return findings about axes that never change, or no more."""
    found = []
    for j in (ACCEL_X, ACCEL_Y, *range(MOTION_AT, MOTION_END)):
        there = np.flatnonzero(np.isfinite(recording.z[:, j]))
        values, t = recording.z[there, j], recording.t[there]
        if len(values) < ENOUGH:
            continue
        begins = np.flatnonzero(np.diff(values, prepend=math.inf) != 0.0)
        ends = np.append(begins[1:], len(values)) - 1
        run = int(np.argmax(t[ends] - t[begins]))
        first, last = begins[run], ends[run]
        whole = len(begins) == 1
        if not whole and (t[last] - t[first] < _DEAD or last - first < ENOUGH):
            continue
        name, value = recording.called(MEASUREMENTS[j]), float(values[first])
        span = "all" if whole else f"from t = {t[first]:.1f} to {t[last]:.1f} s all"
        what = f"{name}: {span} {last - first + 1} values are {value:g}, as of a dead axis"
        remedy = "leave its cells empty there; the twin does without it"
        found.append(Finding(WARNING, "axis-dead", what, remedy, {"value": value}))
    return found


def _check_gravity(recording: Recording, mounting: Array) -> list[Finding]:
    """Return what the mean of the accelerometers says of their unit, axes and mounting."""
    t, force = recording.samples(*_FORCE)
    if len(t) < 5 * ENOUGH:
        return []
    rough = float(np.linalg.norm(np.median(force, axis=0)))
    unit = GRAVITY if _G_UNIT[0] < rough < _G_UNIT[1] else 1.0
    force = force @ mounting.T
    around, straight = _way_round(recording, t)
    force[:, 1] -= around / unit
    if straight.sum() < max(5 * ENOUGH, 0.1 * len(t)):
        return []
    mean = np.median(force[straight], axis=0)
    size = float(np.linalg.norm(mean))
    spread = float(np.sqrt(np.mean(np.sum((force[straight] - mean) ** 2, axis=1))))
    names, evidence = recording.called(*_FORCE), {"x": mean[0], "y": mean[1], "z": mean[2]}
    if _G_UNIT[0] < size < _G_UNIT[1] and spread < 0.5 * size:
        what = f"{names}: {size:.2f} in the mean: these are g"
        return [Finding(ERROR, "accel-unit", what, 'state unit = "g" in a mapping file', evidence)]
    if not _G_UNIT[0] < size / GRAVITY < _G_UNIT[1]:
        what = f"{names}: {size:.3g} m/s2 in the mean, where gravity is {GRAVITY}"
        remedy = "give the specific force as the IMU measures it, with gravity, all axes in m/s2"
        return [Finding(ERROR, "accel-gravity", what, remedy, evidence)]
    if mean[2] > size * math.cos(_AXIS):
        what = f"{names}: {mean[2]:.2f} m/s2 down: the third axis points up"
        remedy = 'an upright boat has -9.81 there; state frame = "enu" or scale = -1.0 in a mapping'
        return [Finding(ERROR, "accel-up", what, remedy, evidence)]
    tilt = math.acos(min(max(-float(mean[2]) / size, -1.0), 1.0))
    if tilt > _AXIS:
        axis = "xyz"[int(np.argmax(np.abs(mean)))]
        what = f"{names}: gravity lies along {axis}: the axes are swapped, or the IMU is turned"
        remedy = "x is forward, y to starboard, z down; exchange the columns, or state imu_mounting"
        return [Finding(ERROR, "accel-swapped", what, remedy, evidence)]
    roll = math.atan2(-mean[1], -mean[2])
    pitch = math.asin(min(max(float(mean[0]) / size, -1.0), 1.0))
    apart = _apart_from_ahrs(recording, t[straight], force[straight], around[straight])
    trimmed = apart is None and abs(pitch) > _TRIM
    if tilt > _ASKEW or trimmed or (apart is not None and apart > _APART):
        what = (
            f"{names}: gravity is {math.degrees(tilt):.0f} degrees off their third axis: the IMU "
            "is mounted askew, or the boat lies so"
        )
        if apart is not None:
            what += f"; the AHRS is {math.degrees(apart):.0f} degrees off gravity"
            evidence["apart_rad"] = apart
        remedy = (
            f"if it is the IMU, state imu_mounting = [{roll:.3f}, {pitch:.3f}, 0.0] in "
            "[instruments] of the particulars"
        )
        evidence |= {"roll_rad": roll, "pitch_rad": pitch}
        return [Finding(WARNING, "imu-askew", what, remedy, evidence)]
    return []


def _check_size(recording: Recording, mounting: Array) -> list[Finding]:
    """Return whether gravity is larger or smaller than anywhere."""
    t, force = recording.samples(*_FORCE)
    if len(t) < 5 * ENOUGH:
        return []
    force = force @ mounting.T
    force[:, 1] -= _way_round(recording, t)[0]
    ratio = float(np.linalg.norm(force.mean(axis=0))) / GRAVITY
    if abs(ratio - 1.0) < _OFF:
        return []
    what = f"{recording.called(*_FORCE)}: gravity is {ratio:.3g} times as large as it is"
    remedy = (
        f"the scale of the third axis, or of all: scale = {1.0 / ratio:.4g} in a mapping file for "
        "those that share it"
    )
    return [Finding(WARNING, "accel-scale", what, remedy, {"ratio": ratio})]


def _apart_from_ahrs(recording: Recording, t: Array, force: Array, around: Array) -> float | None:
    """Return by how much gravity and an AHRS differ in the mean where the boat hardly turns, rad.

    None without an AHRS in radians, or where the boat turns all the time.
    """
    t_angle, angles = recording.samples("ahrs_roll_rad", "ahrs_pitch_rad")
    if len(t_angle) < 5 * ENOUGH or float(np.quantile(np.abs(angles), 0.9)) > _STEEP:
        return None
    angles = sampled(t_angle, angles, t)
    ok = (np.abs(around) < _AROUND) & np.isfinite(angles).all(axis=1)
    if ok.sum() < 5 * ENOUGH:
        return None
    mean, angle = np.median(force[ok], axis=0), np.median(angles[ok], axis=0)
    roll, pitch = math.atan2(-mean[1], -mean[2]), math.atan2(mean[0], math.hypot(mean[1], mean[2]))
    return math.hypot(roll - angle[0], pitch - angle[1])


def _check_angle(recording: Recording, name: str) -> list[Finding]:
    """Return whether an angle of the AHRS is in degrees."""
    angle = recording.samples(name)[1][:, 0]
    if len(angle) < ENOUGH or float(np.quantile(np.abs(angle), 0.9)) < _STEEP:
        return []
    given = recording.called(name)
    what = f"{given}: up to {np.abs(angle).max():.3g} rad; these are degrees"
    remedy = f"name the column {name.replace('_rad', '_deg')}"
    return [Finding(ERROR, "ahrs-unit", what, remedy, {"most": float(np.abs(angle).max())})]


def _way_round(recording: Recording, at: Array) -> tuple[Array, npt.NDArray[np.bool_]]:
    """Return the acceleration to starboard of a turn, m/s2, and where it is known well enough.

    Without velocities it is known to be small where the boat hardly turns.
    """
    t_psi, compass = recording.samples("compass_rad")
    if len(t_psi) < ENOUGH:
        return np.zeros(len(at)), np.ones(len(at), dtype=np.bool_)
    psi = np.unwrap(compass[:, 0])  # a gyro may be wrong
    half = 0.5 * _ROUND
    turning = (sampled(t_psi, psi, at + half) - sampled(t_psi, psi, at - half)) / _ROUND
    t, velocity = recording.samples("gps_vx_mps", "gps_vy_mps")
    if len(t) < ENOUGH:
        return np.zeros(len(at)), np.abs(turning) < _TURNING
    around = turning * sampled(t, np.linalg.norm(velocity, axis=1), at)
    known = np.isfinite(around)
    return np.where(known, around, 0.0), known


class _Fit(NamedTuple):
    """How one signal goes with another."""

    correlation: float
    slope: float


def _fit(x: Array, y: Array) -> _Fit:
    """Return correlation, and the slope of y on x."""
    ok = np.isfinite(x) & np.isfinite(y)
    if ok.sum() < 5 * ENOUGH:
        return _Fit(0.0, math.nan)
    x, y = x[ok] - x[ok].mean(), y[ok] - y[ok].mean()
    xx, yy, xy = float(x @ x), float(y @ y), float(x @ y)
    if min(xx, yy) <= 0.0:
        return _Fit(0.0, math.nan)
    return _Fit(xy / math.sqrt(xx * yy), xy / xx)


def _change(t: Array, values: Array) -> tuple[Array, Array]:
    """Return times and rates of change over :data:`_SMOOTH`."""
    before = sampled(t, values, t - _SMOOTH)
    return t - 0.5 * _SMOOTH, np.asarray((values - before) / _SMOOTH)


def _mean(t: Array, values: Array, at: Array) -> Array:
    """Return means over :data:`_SMOOTH` about some times."""
    whole = np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(t))])
    ends = (sampled(t, whole, at + sign * 0.5 * _SMOOTH) for sign in (1.0, -1.0))
    return np.asarray((next(ends) - next(ends)) / _SMOOTH)


def _check_rate(recording: Recording, angle: str, gyro: str, other: str) -> list[Finding]:
    """Return how a gyro goes with the change of its angle: sign, unit, and the other axis."""
    t, values = recording.samples(angle)
    if len(t) < 5 * ENOUGH:
        return []
    times, change = _change(t, values[:, 0])
    if float(np.nanstd(change)) < _STILL:
        return []
    fits = {}
    for name in (gyro, other, "gyro_radps"):
        t_rate, rate = recording.samples(name)
        if len(t_rate) < 5 * ENOUGH or float(rate.std()) < _STILL:
            if name != "gyro_radps":
                return []
            continue
        fits[name] = _fit(change, _mean(t_rate, rate[:, 0], times))
    own = fits.pop(gyro)
    other = max(fits, key=lambda name: abs(fits[name].correlation))
    cross = fits[other]
    names, evidence = recording.called(angle, gyro), {"correlation": own.correlation}
    if abs(cross.correlation) > max(_CLEAR, abs(own.correlation) + _BETTER):
        what = f"{recording.called(gyro, other)}: each goes with the angle of the other"
        remedy = (
            "roll and pitch of gyros or AHRS are swapped, or the IMU is turned about its third "
            "axis: exchange the columns, or state imu_mounting"
        )
        return [Finding(ERROR, "gyro-swapped", what, remedy, evidence)]
    if abs(own.correlation) < _CLEAR:
        return []
    evidence["slope"] = own.slope
    if own.slope < 0.0:
        what = f"{names}: the gyro turns against the angle: one of them has the wrong sign"
        remedy = "roll is above 0 with starboard down, pitch with the bow up; so are their rates"
        return [Finding(ERROR, "tilt-sign", what, remedy, evidence)]
    if 30.0 < own.slope < 110.0 or 30.0 < 1.0 / own.slope < 110.0:
        wrong = gyro if own.slope > 1.0 else angle
        what = f"{recording.called(wrong)}: {max(own.slope, 1.0 / own.slope):.3g} times too large"
        wanted = wrong.replace("_radps", "_degps").replace("_rad", "_deg")
        return [Finding(ERROR, "tilt-unit", what, f"name the column {wanted}", evidence)]
    return []
