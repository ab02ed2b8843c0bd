"""Roll, pitch and heave from a three-axis IMU, an AHRS and GNSS, whichever there are.

The gyros are integrated, and held to the AHRS and to gravity. Gravity shows once the boat's own
horizontal accelerations are taken out of the accelerometers. Vertical acceleration is integrated
twice, and held to the vertical speed and height of the GNSS.

Source: Fossen 2021, Sec. 14.3 (observers for attitude and position, with biases).
"""

from __future__ import annotations

import math
from typing import Any

from twin.channels import AHRS_ROLL, GPS_VZ, GPS_Z, GYRO_X, GYRO_Y, MOTION_AT, MOTION_END
from twin.motion.linear import correct, fade, propagate, turn_covariance
from twin.motion.state import (
    ACCEL_BIAS_TIME_S,
    AHRS_ERROR,
    AHRS_WHITE_SHARE,
    ANGLE,
    CLIMB,
    CLIMB_TIMEOUT_S,
    GRAVITY_ERROR,
    GYRO_BIAS_TIME_S,
    HEAVE,
    HEAVE_CORNER_MAX_RADPS,
    HEAVE_CORNER_MIN_RADPS,
    HEAVE_CORNER_SHARE,
    HEAVE_FORGETTING_S,
    HEIGHT_BIAS_TIME_S,
    HEIGHT_ERROR,
    INNOVATION_FORGETTING_S,
    INNOVATION_MEAN_S,
    LATE_FIX_ROWS,
    LIFT_BIAS,
    N_TILT,
    RATE_BIAS,
    RATE_DERIVATIVE_RMS_RADPS2,
    RATE_RMS_RADPS,
    SLOW_HEAVE_SD_M,
    WAVE_ACCEL_MAX_MPS2,
    WAVE_ACCEL_MIN_MPS2,
    WAVE_ACCEL_MPS2,
    WAVE_FREQUENCY_TIME_S,
    WAVE_SPEED_LEAK_S,
    wave_density,
)
from twin.particulars import GRAVITY
from usv_kernel.arrays import shaped
from usv_kernel.channels import GYRO
from usv_kernel.jit import inlined, kernel
from usv_kernel.scalar import sincos

__all__ = ["HOLD_MAX_S", "is_measured", "take_attitude"]

RATE_FORGETTING_S = 60.0
RATE_PRIOR_ROWS = 100.0
"""Time constant of the mean squares of the rates of roll and pitch, and weight of their first
guess in rows."""

SILENT_GYRO_SD = 0.1
"""Root of the spectral density of the rate of a boat whose gyro is silent, rad/s times root s."""

SILENT_ACCEL_SD_MPS2 = 2.0
"""Standard deviation of the vertical acceleration of a boat whose accelerometer is silent."""

UNKNOWN_ACCEL_MPS2 = 1.0
"""Horizontal acceleration of a boat whose velocity is not known."""

UNKNOWN_DENSITY = wave_density(UNKNOWN_ACCEL_MPS2)
"""Spectral density of the error of the angle that gravity shows then, rad2 s ..."""

FIRST_DENSITY = wave_density(WAVE_ACCEL_MPS2)
"""... where velocity is known, before innovations show it ..."""

DENSITY_MIN = wave_density(WAVE_ACCEL_MIN_MPS2)
DENSITY_MAX = wave_density(WAVE_ACCEL_MAX_MPS2)
"""... and its bounds."""

GATE_SD = 6.0
REFUSALS_MAX = 40.0
"""Gate of the innovation in standard deviations, and refusals in a row after which it opens."""

NIS_SAMPLES = 10.0
"""Samples over which the normalised innovation squared (NIS) of the AHRS is averaged."""

NIS_MAX = 9.0
NIS_CLEAR = 2.0
"""Mean NIS from which on gyro and AHRS contradict each other, and below which they agree again."""

NIS_CLIP = 25.0
"""Largest NIS that counts of one sample."""

SUSPECT_NONE, SUSPECT_GYRO, SUSPECT_AHRS, SUSPECT_BOTH = range(4)

GRAVITY_TIME_S = 10.0
"""Time constant with which roll and pitch by gyros alone follow gravity."""

GRAVITY_ERROR_TIME_S = 2.0
TILT_MARGIN_RAD = math.radians(2.0)
"""Time constant of the mean squares of how far they and the AHRS are from gravity, and root of the
difference from which on the further one is in doubt."""

CHANNEL_LIMITS = (10.0, 10.0, 100.0, 1.4, 1.4, 1e6, 50.0)
"""Sizes that no valid sample reaches, by motion channel: rad/s, m/s2, rad, m, m/s."""

FORCE_MAX_MPS2 = 100.0
"""The same of the other accelerometers, m/s2."""

GAP_S = 1.0
"""Time between rows after which the filters begin again."""

HOLD_MAX_S = 0.2
"""Time for which the last sample of the IMU stands for a missing one."""

AXIS_SHARE_MIN = 0.3
"""Direction cosine from which on an axis of the IMU counts for one of the boat."""

START_SD_RAD = 0.2
"""Standard deviation of roll and pitch of a boat of which nothing is known."""


@kernel
def is_measured(z: Any) -> bool:
    """Return whether a row has a sample of a motion channel."""
    found = False
    for k in range(MOTION_AT, MOTION_END):
        found = found or math.isfinite(z[k])
    return found


@inlined
def _start(memory, given):
    """Begin with a level boat at rest, of which nothing is known."""
    memory.tilt[:, :] = 0.0
    memory.P[:, :] = 0.0
    for k in range(0, 2 * N_TILT, N_TILT):
        memory.P[k + ANGLE, k + ANGLE] = START_SD_RAD**2
        memory.P[k + RATE_BIAS, k + RATE_BIAS] = given.gyro_bias**2
        memory.P[k + AHRS_ERROR, k + AHRS_ERROR] = given.ahrs**2
        memory.P[k + GRAVITY_ERROR, k + GRAVITY_ERROR] = (given.accel_bias / GRAVITY) ** 2
    memory.vertical[:] = 0.0
    memory.P_vertical[:, :] = 0.0
    memory.P_vertical[HEAVE, HEAVE] = 1.0
    memory.P_vertical[CLIMB, CLIMB] = 1.0
    memory.P_vertical[LIFT_BIAS, LIFT_BIAS] = given.accel_bias**2 + given.accel**2
    memory.P_vertical[HEIGHT_ERROR, HEIGHT_ERROR] = 1e4
    memory.rate[:] = 0.0
    memory.turning[:] = 0.0
    memory.turned[:] = 0.0
    memory.rate_power[:, 0] = RATE_RMS_RADPS**2
    memory.rate_power[:, 1] = RATE_DERIVATIVE_RMS_RADPS2**2
    memory.force[0], memory.force[1], memory.force[2] = 0.0, 0.0, -GRAVITY
    memory.lift = memory.wave_speed = 0.0
    memory.wave_power[:] = 0.0
    memory.velocity[:] = math.nan
    memory.innovation[:, 0] = 0.0
    memory.innovation[:, 1] = FIRST_DENSITY
    memory.nis[:] = memory.own[:] = 0.0
    memory.by_gravity[:, :] = memory.doubted[:, :] = 0.0
    memory.rows = 0.0


@inlined
def _fresh(z, dt, memory, k):
    """Return whether motion channel k has a new and plausible sample, and note its age."""
    value = z[MOTION_AT + k]
    # the same bits again are no new sample: the instrument is slower than the log, or hangs
    new = math.isfinite(value) and value != memory.last[k] and abs(value) < CHANNEL_LIMITS[k]
    memory.ages[k] = 0.0 if new else memory.ages[k] + dt
    if abs(value) < CHANNEL_LIMITS[k]:
        memory.last[k] = value
    return new


@inlined
def _note_planar(z, dt, memory):
    """Note which of the axes of the IMU that every log has are new."""
    all_new = True
    for k in range(3):
        value, limit = z[GYRO + k], CHANNEL_LIMITS[0] if k == 0 else FORCE_MAX_MPS2
        new = value != memory.planar[k] and abs(value) < limit
        all_new = all_new and new
        memory.planar_ages[k] = 0.0 if new else memory.planar_ages[k] + dt
        if abs(value) < limit:
            memory.planar[k] = value
    memory.planar_new = 1.0 if all_new else 0.0


@inlined
def _find_suspect(error, var, k, memory):
    """Return which of gyro and AHRS is in doubt, where they have contradicted each other of late.

    Gravity decides. If it is the gyro, the covariance grows until innovations are as large as it
    claims. Source: Zhou and Frank 1996 (strong tracking filter).
    """
    gyro, ahrs = memory.by_gravity[k, 0], memory.by_gravity[k, 1]
    P, i, j = memory.P, k * N_TILT + ANGLE, k * N_TILT + AHRS_ERROR
    total = var + P[i, i] + 2.0 * P[i, j] + P[j, j]
    square = error * error / total
    memory.nis[k] += (min(square, NIS_CLIP) - memory.nis[k]) / NIS_SAMPLES
    if ahrs > gyro + TILT_MARGIN_RAD**2:
        return SUSPECT_AHRS
    # a gyro in doubt stays so until nothing speaks against it
    before = memory.doubted[k, 0] > 0.0
    if memory.nis[k] <= (NIS_CLEAR if before else NIS_MAX):
        return SUSPECT_NONE
    more = (max(memory.nis[k], square) - 1.0) * total
    if gyro > ahrs + (0.0 if before else TILT_MARGIN_RAD**2):
        P[i, i] += more
        return SUSPECT_GYRO
    P[i, i] += 0.5 * more
    P[j, j] += 0.5 * more
    return SUSPECT_BOTH


@inlined
def _count_refused(used, memory, k):
    """Count refused samples of a channel, one after the other."""
    memory.refused[k] = 0.0 if used else memory.refused[k] + 1.0


@inlined
def _remember(t, memory):
    """Note attitude and vertical speed for fixes that come late."""
    row = memory.ring[int(memory.rows) % LATE_FIX_ROWS]
    row[0], row[1], row[2], row[3] = (
        t,
        memory.tilt[0, ANGLE],
        memory.tilt[1, ANGLE],
        memory.vertical[CLIMB],
    )
    turned = memory.turned_ring[int(memory.rows) % LATE_FIX_ROWS]
    turned[0], turned[1] = memory.turned[0], memory.turned[1]
    memory.rows += 1.0


@inlined
def _rows_about(t, now, memory):
    """Return the places in the ring of the rows before and after a time, and where it lies between.

    The row of ``now`` is not in the ring yet: its place is -1.
    """
    newest, kept = int(memory.rows) - 1, min(int(memory.rows), LATE_FIX_ROWS)
    back = 0
    while back < kept - 1 and memory.ring[(newest - back) % LATE_FIX_ROWS, 0] > t + 1e-6:
        back += 1
    place = (newest - back) % LATE_FIX_ROWS
    later = (place + 1) % LATE_FIX_ROWS if back > 0 else -1
    before, after = memory.ring[place, 0], memory.ring[later, 0] if back > 0 else now
    share = (t - before) / (after - before) if after > before else 1.0
    return place, later, min(max(share, 0.0), 1.0)


@inlined
def _when(t, now, memory):
    """Return the row of the ring at or before a time, and the vertical speed at it."""
    place, later, share = _rows_about(t, now, memory)
    old = memory.ring[place]
    speed = memory.vertical[CLIMB] if later < 0 else memory.ring[later, 3]
    return old, old[3] + share * (speed - old[3])


@inlined
def _turned_since(t, now, k, memory):
    """Return by how much roll (k = 0) or pitch has changed since a time."""
    place, later, share = _rows_about(t, now, memory)
    turned = memory.turned_ring[place, k]
    until = memory.turned[k] if later < 0 else memory.turned_ring[later, k]
    return memory.turned[k] - turned - share * (until - turned)


@inlined
def _turned(m, a, b, c, i):
    """Return entry i of a matrix times a vector."""
    return m[i, 0] * a + m[i, 1] * b + m[i, 2] * c


@inlined
def _seen(m, a, b, c, i):
    """Return what axis i of an IMU shows of a vector in the boat's axes."""
    return m[0, i] * a + m[1, i] * b + m[2, i] * c


@kernel
def take_attitude(t, dt, z, velocity, memory, given):
    """Take a row: estimate roll, pitch, their rates, heave and vertical speed.

    Parameters
    ----------
    t, dt : float
        Time, and time since the row before, s.
    z : ndarray, shape (19,)
        In the order of ``twin.channels.MEASUREMENTS``; NaN is missing.
    velocity : ndarray, shape (3,)
        Speed forward and to starboard (m/s) and rate of turn (rad/s), as the twin has them; NaN
        where it has none.
    memory : record of ``ATTITUDE``
        Advanced in place.
    given : record of ``ATTITUDE_SETTINGS``
        Errors and places of the sensors.
    """
    if memory.rows == 0.0 or not 0.0 < dt <= GAP_S:
        _start(memory, given)
    dt = min(max(dt, 0.0), GAP_S)
    silent = _age_of(0, memory, given) > 0.0, _age_of(1, memory, given) > 0.0
    has_p, has_q = _fresh(z, dt, memory, 0), _fresh(z, dt, memory, 1)
    has_lift = _fresh(z, dt, memory, 2)
    _note_planar(z, dt, memory)
    _integrate(dt, z, (has_p, has_q, has_lift), silent, velocity[2], memory, given)
    tilt, P, late = shaped(memory.tilt, 0, (2 * N_TILT,)), memory.P, given.ahrs_latency
    for k in range(2):
        for i in range(2):
            memory.doubted[k, i] += dt if memory.doubted[k, i] > 0.0 else 0.0
        if _fresh(z, dt, memory, 3 + k):
            seen = k * N_TILT + ANGLE, k * N_TILT + AHRS_ERROR
            error = z[AHRS_ROLL + k] - tilt[seen[0]] - tilt[seen[1]]
            if late > 0.0 and memory.rows > 0.0:
                # compared with the angle of then: what is known now, less what was turned since
                error += _turned_since(t - late, t, k, memory)
            gate = (
                math.inf if memory.refused[3 + k] > REFUSALS_MAX or memory.rows == 0.0 else GATE_SD
            )
            var = (AHRS_WHITE_SHARE * given.ahrs) ** 2
            doubted = _find_suspect(error, var, k, memory)
            gate = 0.0 if doubted == SUSPECT_AHRS else math.inf if doubted != SUSPECT_NONE else gate
            for i in range(2):
                since = max(memory.doubted[k, i], dt)
                memory.doubted[k, i] = since if doubted == SUSPECT_GYRO + i else 0.0
            used = correct(tilt, P, seen, error, var, gate)
            _count_refused(used, memory, 3 + k)
    _hold_to_gravity(dt, z, velocity, memory, given)
    _rise(dt, has_lift, memory, given)
    _hold_to_fix(t, dt, z, memory, given)
    _remember(t, memory)


@inlined
def _lost_rates(memory, given):
    """Return whether the gyros that show the rates of roll and of pitch are silent for long."""
    M, dead_x, dead_y = given.mounting, memory.ages[0] > HOLD_MAX_S, memory.ages[1] > HOLD_MAX_S
    return (
        (dead_x and abs(M[0, 0]) > AXIS_SHARE_MIN) or (dead_y and abs(M[0, 1]) > AXIS_SHARE_MIN),
        (dead_x and abs(M[1, 0]) > AXIS_SHARE_MIN) or (dead_y and abs(M[1, 1]) > AXIS_SHARE_MIN),
    )


@inlined
def _integrate(dt, z, has, silent, turn, memory, given):
    """Turn the boat by the mean of the rates of this row and the one before.

    ``turn`` is the twin's rate of turn, for where the gyro is silent.
    """
    has_p, has_q, has_lift = has
    before, rate, M = memory.rate, memory.rate, given.mounting
    lost_r = memory.planar_ages[0] > HOLD_MAX_S
    has_r = abs(z[GYRO]) < CHANNEL_LIMITS[0] and not lost_r
    old = before[0], before[1], before[2]
    # a missing axis shows the last rate for a while, then none, of the boat's axes in its own
    dead_x, dead_y = memory.ages[0] > HOLD_MAX_S, memory.ages[1] > HOLD_MAX_S
    last = (
        memory.tilt[0, RATE_BIAS] + (0.0 if dead_x or dead_y else old[0]),
        memory.tilt[1, RATE_BIAS] + (0.0 if dead_x or dead_y else old[1]),
        turn if lost_r and abs(turn) < CHANNEL_LIMITS[0] else 0.0 if lost_r else old[2],
    )
    raw = (
        z[GYRO_X] if has_p else _seen(M, last[0], last[1], last[2], 0),
        z[GYRO_Y] if has_q else _seen(M, last[0], last[1], last[2], 1),
        z[GYRO] if has_r else _seen(M, last[0], last[1], last[2], 2),
    )
    p = _turned(M, raw[0], raw[1], raw[2], 0) - memory.tilt[0, RATE_BIAS]
    q = _turned(M, raw[0], raw[1], raw[2], 1) - memory.tilt[1, RATE_BIAS]
    r = _turned(M, raw[0], raw[1], raw[2], 2)
    lost_p, lost_q = _lost_rates(memory, given)
    p, q = 0.0 if lost_p else p, 0.0 if lost_q else q
    rate[0], rate[1], rate[2] = p, q, r
    if memory.rows == 0.0:
        old = p, q, r
    # a gyro that comes back says nothing of the row before
    old = p if silent[0] else old[0], q if silent[1] else old[1], old[2]
    if dt > 0.0:
        for i in range(3):
            memory.turning[i] = (rate[i] - old[i]) / dt
    p, q, r = 0.5 * (p + old[0]), 0.5 * (q + old[1]), 0.5 * (r + old[2])
    phi, theta = memory.tilt[0, ANGLE], memory.tilt[1, ANGLE]
    roll_rate, pitch_rate = _angle_rates(phi, theta, p, q, r)
    half = 0.5 * dt
    roll_rate, pitch_rate = _angle_rates(phi + half * roll_rate, theta + half * pitch_rate, p, q, r)
    memory.tilt[0, ANGLE] = min(max(phi + dt * roll_rate, -1.5), 1.5)
    memory.tilt[1, ANGLE] = min(max(theta + dt * pitch_rate, -1.5), 1.5)
    memory.turned[0] += dt * roll_rate
    memory.turned[1] += dt * pitch_rate
    memory.own[0] += dt * roll_rate
    memory.own[1] += dt * pitch_rate
    tilt, P = shaped(memory.tilt, 0, (2 * N_TILT,)), memory.P
    turn_covariance(P, dt, r * dt)
    for k in range(2):
        at, other = k * N_TILT, (1 - k) * N_TILT
        P[at, at] += (given.gyro * dt) ** 2
        age, lost = _age_of(k, memory, given), lost_p if k == 0 else lost_q
        if age > 0.0 or lost:
            P[at, at] += _unseen(dt, age, lost, memory.rate_power[k])
        else:
            _learn_power(dt, k, memory)
        if lost_r:  # roll becomes pitch, and pitch roll, as the boat turns
            P[at, at] += SILENT_GYRO_SD**2 * (tilt[other] ** 2 + P[other, other]) * dt
        fade(tilt, P, at + RATE_BIAS, GYRO_BIAS_TIME_S, dt, given.gyro_bias)
        fade(tilt, P, at + AHRS_ERROR, given.ahrs_time, dt, given.ahrs)
        fade(tilt, P, at + GRAVITY_ERROR, ACCEL_BIAS_TIME_S, dt, given.accel_bias / GRAVITY)
    _move_force(z, has_lift, memory, given)


@inlined
def _age_of(k, memory, given):
    """Return how long a gyro has been silent that counts for the rate of roll or pitch, s."""
    age, M = 0.0, given.mounting
    for i in range(3):
        silent = memory.planar_ages[0] if i == 2 else memory.ages[i]
        age = max(age, silent) if abs(M[k, i]) > AXIS_SHARE_MIN else age
    return age


@inlined
def _unseen(dt, age, lost, power):
    """Return what the variance of an angle grows by in a step without a sample of its gyro.

    A rate that is held is off by its derivative times its age; for one that is lost, the boat
    swings on. Both are as large as they were of late.
    """
    if lost:
        return 2.0 * power[0] * dt * math.sqrt(power[0] / power[1])
    return 0.25 * power[1] * (age**4 - max(age - dt, 0.0) ** 4)


@inlined
def _learn_power(dt, k, memory):
    """Learn how fast roll or pitch changes, and how fast that does."""
    share = max(min(dt / RATE_FORGETTING_S, 1.0), 1.0 / (memory.rows + RATE_PRIOR_ROWS))
    power = memory.rate_power[k]
    power[0] += share * (memory.rate[k] ** 2 - power[0])
    power[1] += share * (memory.turning[k] ** 2 - power[1])
    # a boat at rest may begin to move
    power[0], power[1] = max(power[0], 1e-6), max(power[1], 1e-6)


@inlined
def _angle_rates(phi, theta, p, q, r):
    """Return the time derivatives of roll and pitch (Fossen 2021, Eq 2.39)."""
    s, c = sincos(phi)
    d, e = sincos(theta)
    return p + (q * s + r * c) * d / e, q * c - r * s


@inlined
def _arm_force(rate, turning, arm):
    """Return the specific force that turning adds at a place on the boat."""
    a, b, c = arm[0], arm[1], arm[2]
    p, q, r = rate[0], rate[1], rate[2]
    u, v, w = q * c - r * b, r * a - p * c, p * b - q * a
    return (
        turning[1] * c - turning[2] * b + q * w - r * v,
        turning[2] * a - turning[0] * c + r * u - p * w,
        turning[0] * b - turning[1] * a + p * v - q * u,
    )


@inlined
def _move_force(z, has_lift, memory, given):
    """Note the specific force of the origin, in the boat's axes."""
    force, M, ages = memory.force, given.mounting, memory.planar_ages
    has_x, has_y = ages[1] == 0.0, ages[2] == 0.0
    dead = ages[1] > HOLD_MAX_S or ages[2] > HOLD_MAX_S or memory.ages[2] > HOLD_MAX_S
    if dead or has_x or has_y or has_lift:
        s, c = sincos(memory.tilt[0, ANGLE])
        d, e = sincos(memory.tilt[1, ANGLE])
        # a missing axis shows the last force for a while, then gravity alone
        g = GRAVITY * d, -GRAVITY * s * e, -GRAVITY * c * e
        x, y, low = _arm_force(memory.rate, memory.turning, given.imu_arm)
        a = memory.planar[1] if ages[1] <= HOLD_MAX_S else _seen(M, g[0], g[1], g[2], 0)
        b = memory.planar[2] if ages[2] <= HOLD_MAX_S else _seen(M, g[0], g[1], g[2], 1)
        down = memory.last[2] if memory.ages[2] <= HOLD_MAX_S else _seen(M, g[0], g[1], g[2], 2)
        force[0] = _turned(M, a, b, down, 0) - x
        force[1] = _turned(M, a, b, down, 1) - y
        force[2] = _turned(M, a, b, down, 2) - low


@inlined
def _hold_to_gravity(dt, z, velocity, memory, given):
    """Correct roll and pitch by gravity, with the twin's own accelerations taken out."""
    before, u, v = memory.velocity, velocity[0], velocity[1]
    ages = memory.planar_ages
    turns = ages[0] <= HOLD_MAX_S or abs(velocity[2]) < CHANNEL_LIMITS[0]
    if ages[1] == 0.0 and ages[2] == 0.0 and turns and dt > 0.0:
        f, r, theta = memory.force, memory.rate[2], memory.tilt[1]
        known = math.isfinite(u) and math.isfinite(v) and math.isfinite(before[0])
        ahead = (u - before[0]) / dt - v * r if known else 0.0
        side = (v - before[1]) / dt + u * r if known else 0.0
        cos = math.cos(theta[ANGLE])
        sin_roll = min(max((side - f[1]) / (GRAVITY * cos), -0.9), 0.9)
        sin_pitch = min(max((f[0] - ahead) / GRAVITY, -0.9), 0.9)
        tilt = shaped(memory.tilt, 0, (2 * N_TILT,))
        for k in range(2):
            seen = k * N_TILT + ANGLE, k * N_TILT + GRAVITY_ERROR
            shown = math.asin(sin_roll if k == 0 else sin_pitch)
            _hold_own(shown, dt, k, memory)
            error = shown - tilt[seen[0]] - tilt[seen[1]]
            # what lasts for seconds counts as often as it is new
            density = _learn_density(error, dt, memory.innovation[k]) if known else UNKNOWN_DENSITY
            correct(tilt, memory.P, seen, error, density / dt, GATE_SD)
    before[0], before[1] = u, v


@inlined
def _hold_own(shown, dt, k, memory):
    """Hold the tilt by gyros alone to gravity, and note how far it and the AHRS are from it."""
    share, squares = min(dt / GRAVITY_ERROR_TIME_S, 1.0), memory.by_gravity[k]
    squares[0] += share * ((shown - memory.own[k]) ** 2 - squares[0])
    if memory.ages[3 + k] < HOLD_MAX_S:
        squares[1] += share * ((shown - memory.last[3 + k]) ** 2 - squares[1])
    memory.own[k] += min(dt / GRAVITY_TIME_S, 1.0) * (shown - memory.own[k])


@inlined
def _learn_density(error, dt, kept):
    """Return the spectral density of the noise that the innovations of gravity show, rad2 s.

    Averaged over a time T, white noise of density S has the variance S / 2T.
    Source: Mehra 1970 (noise covariances from innovations).
    """
    kept[0] += min(dt / INNOVATION_MEAN_S, 1.0) * (error - kept[0])
    share = min(dt / INNOVATION_FORGETTING_S, 1.0)
    kept[1] += share * (2.0 * INNOVATION_MEAN_S * kept[0] * kept[0] - kept[1])
    kept[1] = min(max(kept[1], DENSITY_MIN), DENSITY_MAX)
    return kept[1]


@inlined
def _rise(dt, has_lift, memory, given):
    """Integrate the vertical acceleration to vertical speed and heave."""
    x, P, f = memory.vertical, memory.P_vertical, memory.force
    s, c = sincos(memory.tilt[0, ANGLE])
    d, e = sincos(memory.tilt[1, ANGLE])
    lift = e * (s * f[1] + c * f[2]) - d * f[0] + GRAVITY - x[LIFT_BIAS]
    lost = memory.ages[2] > HOLD_MAX_S
    lift = 0.0 if lost else lift
    memory.lift = lift
    power, share = memory.wave_power, min(dt / WAVE_FREQUENCY_TIME_S, 1.0)
    memory.wave_speed += dt * (lift - memory.wave_speed / WAVE_SPEED_LEAK_S)
    power[0] += share * (memory.wave_speed**2 - power[0])
    power[1] += share * (lift * lift - power[1])
    x[HEAVE] += dt * x[CLIMB] + 0.5 * dt * dt * lift
    x[CLIMB] += dt * lift
    propagate(P, (dt, -0.5 * dt * dt, -dt))
    density = SILENT_ACCEL_SD_MPS2**2 * 0.5 if lost else given.accel**2 * dt
    P[CLIMB, CLIMB] += density * dt
    fade(x, P, LIFT_BIAS, ACCEL_BIAS_TIME_S, dt, math.hypot(given.accel_bias, 0.1 * given.accel))
    fade(x, P, HEIGHT_ERROR, HEIGHT_BIAS_TIME_S, dt, given.height_bias)
    fade(x, P, HEAVE, HEAVE_FORGETTING_S, dt, SLOW_HEAVE_SD_M)


@inlined
def _hold_to_fix(t, dt, z, memory, given):
    """Correct the vertical motion by GNSS; without it, by heave that is small in the mean."""
    x, P = memory.vertical, memory.P_vertical
    has_z, has_vz = _fresh(z, dt, memory, 5), _fresh(z, dt, memory, 6)
    a, b, c = given.gps_arm[0], given.gps_arm[1], given.gps_arm[2]
    if memory.rows == 0.0:
        return
    old, speed = _when(t - given.latency, t, memory)
    if has_vz:
        p, q = memory.rate[0], memory.rate[1]
        arm = p * b - q * a
        error = z[GPS_VZ] - speed - arm
        gate = math.inf if memory.refused[6] > REFUSALS_MAX else GATE_SD
        used = correct(x, P, (CLIMB, CLIMB), error, given.climb**2, gate)
        _count_refused(used, memory, 6)
    if has_z:
        arm = c * math.cos(old[1]) * math.cos(old[2]) - a * math.sin(old[2]) + b * math.sin(old[1])
        error = z[GPS_Z] - arm - x[HEAVE] - x[HEIGHT_ERROR] + given.latency * x[CLIMB]
        gate = math.inf if memory.refused[5] > REFUSALS_MAX else GATE_SD
        used = correct(x, P, (HEAVE, HEIGHT_ERROR), error, given.height**2, gate)
        _count_refused(used, memory, 5)
    if memory.ages[6] > CLIMB_TIMEOUT_S and dt > 0.0:
        power = memory.wave_power
        corner = HEAVE_CORNER_SHARE * math.sqrt(power[1] / max(power[0], 1e-12))
        corner = min(max(corner, HEAVE_CORNER_MIN_RADPS), HEAVE_CORNER_MAX_RADPS)
        var = given.accel**2 / corner**4
        correct(x, P, (HEAVE, HEAVE), -x[HEAVE], var, math.inf)
