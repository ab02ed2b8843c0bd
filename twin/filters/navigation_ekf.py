"""The tight GPS/IMU/compass filter: where the boat is and how it moves, without a ship model.

An extended Kalman filter with twelve states

    n = (x, y, psi, u, v, r, b_gyro, b_ax, b_ay, b_compass, t_x, t_y)

x, y are m north and east, psi is the heading in rad, r the yaw rate in rad/s. u, v are the velocity
over the ground forward and starboard in m/s. Biases are those of gyro, accelerometers and compass.
t_x, t_y are the gravity that tilt lets into each accelerometer, m/s2: first-order Gauss-Markov, as
are the biases, but fast. The accelerometers drive u and v. GPS position, GPS velocity, compass and
gyro are measured one number after the other. So any of them may be missing in any row. Antenna and
IMU may sit off the origin.

A GPS sample is ``gps_latency`` old, and is compared with where the antenna was then. For that a
ring holds the recent path by dead reckoning alone. What was corrected since then counts as a
constant error of heading and velocity.

Where the accelerometers are missing, the accelerations of a model may be handed in; without
one, velocities are held.

Rejected as samples, besides NaN, are

- numbers that no boat gives (:data:`SPEED_LIMIT` and others);
- those with an innovation above :data:`GATE_SD`. After many refusals in a row the filter must be
  wrong: it restarts from that number. An acceleration is refused where it leaps from one
  row to the next;
- frozen ones: all numbers of a sensor repeat to the last bit. Either it is stuck, or the log has
  more rows than the sensor has samples. But a number may also stay because nothing moves, or
  because it is rounded. So once it has stayed for :data:`FROZEN_S`, a fix or heading that is
  within its standard deviation of what the filter expects counts as new. An IMU that repeats is
  always one that says nothing.

The filter knows nothing of waves: what it says moves with them.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from twin.channels import PSI, R, U, V, X, Y
from twin.filters.dead_reckoning import past_motion, remember
from twin.filters.navigation_prediction import Motion, mend, predict
from twin.filters.navigation_state import (
    ACCEL_LIMIT,
    ACCEL_X_BIAS,
    ACCEL_Y_BIAS,
    COMPASS_BIAS,
    GYRO_BIAS,
    HEADING_MAX_RAD,
    IMU_LEAPS,
    IS_MODELLED,
    MODEL_VARIANCES,
    N_NAV,
    POSITION_MAX_M,
    SPEED_LIMIT,
    TILT_X,
    TILT_Y,
    TURN_LIMIT,
    VARIANCE_MIN,
)
from usv_kernel.channels import ACCEL_X, ACCEL_Y, COMPASS, GPS_VX, GPS_VY, GPS_X, GPS_Y, GYRO
from usv_kernel.jit import inlined, kernel
from usv_kernel.scalar import wrap
from usv_kernel.simd import Block, Factors, Rows, Strip, accumulate_rows, combine

__all__ = [
    "aid",
    "is_learning_suspended",
    "is_ready",
    "lacks_gps",
    "lacks_heading",
    "lacks_imu",
    "navigate",
]

Array = NDArray[np.float64]

GATE_SD = 6.0
"""Gate of an innovation, in standard deviations ..."""

REFUSED_MAX = 20.0
"""... and number of refusals in a row after which a sample is accepted all the same ..."""

REFUSED_PER_S = 5.0
"""... where one after a pause counts as this many for each second of it."""

LOST_AGAIN_S = 3.0
LOST_SPEED_RATIO = 1.5
SETTLING_S = 10.0
"""Where that happens again within LOST_AGAIN_S, at a speed above LOST_SPEED_RATIO nominal speeds,
the velocity begins anew as well, and models learn nothing for SETTLING_S."""

FROZEN_S = 2.0
"""Time of equal samples after which the boat may be at rest."""

STEP_MAX_S = 0.1
"""Longest step of the prediction; longer gaps are cut up."""

LOST_AFTER_S = 1.0
"""Age of the last sample above which GPS or IMU count as lost."""

GAP_MAX_S = 600.0
"""Longest time of a prediction over a gap between rows."""

FINE_MAX_S = 30.0
COARSE_STEP_S = 10.0
"""Last part of a gap that is predicted in steps of STEP_MAX_S, and step of its first part."""

_SHRINKAGE_MAX = 1e6
"""Variance ratio of a correction above which rounding counts. A gyro shrinks that of the yaw rate
by 2e4 in every row."""

BIAS_SD_MPS2 = 0.7
BIAS_TIME_S = 3.0
"""Standard deviation of the bias of faulty accelerometers, and typical time to their exclusion."""

CONTAMINATED_SD = 5.0
"""Difference, in standard deviations, above which a faulty sensor has corrupted a state."""

_AID_SHRINKAGE_MAX = 1e4
"""Largest variance ratio of a correction by a model."""


@kernel
def _correct(nav, work, innovation, variance, age, channel):
    """Correct by one number with measurement row H; return False where it is refused.

    ``age`` is the time since the sensor's last sample, s; a channel below 0 refuses nothing.
    """
    n, P, H, gain = nav.n, nav.P, work.H, work.gain
    S = _gain(P, H, variance, gain)
    if variance > S:  # rounding has left no covariance
        mend(P, work.A)
        S = _gain(P, H, variance, gain)
    S = max(S, variance)
    if channel >= 0:
        if innovation * innovation > GATE_SD * GATE_SD * S:
            nav.refused[channel] += max(1.0, REFUSED_PER_S * age)
            if nav.refused[channel] <= REFUSED_MAX:
                return False
            # the filter has diverged: take the number as if nothing had been known
            nav.lost = 1.0
            for i in range(6):
                size = H[i] * H[i]
                # a jump of the position says nothing of the heading
                if size > 0.25 and (channel > 1 or i == channel):
                    P[i, i] += innovation * innovation / max(size, 1.0)
            S = max(_gain(P, H, variance, gain), variance)
        nav.refused[channel] = 0.0
    step = innovation / S
    for i in range(N_NAV):
        n[i] += gain[i] * step
    for i in range(3):
        nav.corrected[i] += gain[2 + i] * step
    root = 1.0 / math.sqrt(S)
    for i in range(N_NAV):
        gain[i] *= root
    accumulate_rows(
        Block(P, 0, N_NAV, N_NAV, N_NAV), Factors(gain, 0, 1, -1.0), Rows(gain, 0, N_NAV, 1)
    )
    for i in range(N_NAV):
        P[i, i] = max(P[i, i], VARIANCE_MIN)
    if S / variance > _SHRINKAGE_MAX:
        mend(P, work.A)
    return True


@kernel
def _forget_biases(nav, settings):
    """Restart the biases that were learned from false samples."""
    n, P = nav.n, nav.P
    for i in range(6, N_NAV):
        for k in range(N_NAV):
            P[i, k] = 0.0
            P[k, i] = 0.0
        n[i] = 0.0
    P[GYRO_BIAS, GYRO_BIAS] = settings.gyro_bias_var
    P[ACCEL_X_BIAS, ACCEL_X_BIAS] = P[ACCEL_Y_BIAS, ACCEL_Y_BIAS] = settings.accel_bias_var
    P[COMPASS_BIAS, COMPASS_BIAS] = settings.compass_bias_var
    P[TILT_X, TILT_X] = P[TILT_Y, TILT_Y] = settings.tilt_var


@kernel
def _forget_velocity(nav, settings):
    """Restart the velocity from rest, as at the start."""
    n, P = nav.n, nav.P
    for i in (U, V):
        for k in range(N_NAV):
            P[i, k] = P[k, i] = 0.0
        n[i], P[i, i] = 0.0, settings.velocity_var_0


@kernel
def _gain(P, H, variance, gain):
    """Write P H' and return the variance of the innovation."""
    S = variance
    combine(Strip(gain, 0, N_NAV), Factors(H, 0, 1, 1.0), Rows(P, 0, N_NAV, N_NAV))
    for i in range(N_NAV):
        S += H[i] * gain[i]
    return S


@kernel
def aid(nav, work, entry, value, variance):
    """Correct one entry of the state by a model's estimate of it.

    Parameters
    ----------
    nav, work : record
        :data:`NAVIGATION`, corrected in place; :data:`NAVIGATION_WORK`.
    entry : int
        Of the state.
    value, variance : float
        In its unit.
    """
    work.H[:] = 0.0
    work.H[entry] = 1.0
    variance = max(variance, 2.0 * nav.P[entry, entry] / _AID_SHRINKAGE_MAX)
    _correct(nav, work, value - nav.n[entry], variance, 0.0, -1)


@inlined
def _is_contaminated(nav, i):
    """Return whether entry i of the state differs from where it may begin again."""
    error = nav.restart.state[i] - nav.n[i]
    if i == PSI:
        error = wrap(error)
    return error * error > CONTAMINATED_SD**2 * (nav.restart.cov[i, i] + VARIANCE_MIN)


@inlined
def _begin_again(nav, settings):
    """Restart the states that a sensor, now excluded, has corrupted."""
    n, P, restart = nav.n, nav.P, nav.restart
    state, cov = restart.state, restart.cov
    whole, heading, surge = restart.position > 0.0, restart.heading > 0.0, restart.surge > 0.0
    if not (whole or heading or surge):
        return
    first, last = 0, 6
    if not (whole or surge):
        first, last = PSI, PSI + 1
    elif not whole:
        first, last = U, V + 1
    astray = (surge and not whole) or restart.lost > 0.0
    for i in range(first, min(last, R)):  # the yaw rate follows the gyro at once
        astray = astray or _is_contaminated(nav, i)
    if astray:
        _forget_biases(nav, settings)
        for i in range(6):
            if (first <= i < last) or (heading and i in (PSI, R)):
                n[i] += wrap(state[i] - n[i]) if i == PSI else state[i] - n[i]
                for k in range(N_NAV):
                    P[i, k] = P[k, i] = 0.0
        for i in range(first, last):
            for k in range(first, last):
                P[i, k] = cov[i, k]
        if heading:
            P[PSI, PSI], P[R, R] = cov[PSI, PSI], cov[R, R]
        if surge and not whole:
            # what made the velocity wrong has moved the boat as well
            moved = (0.5 * BIAS_SD_MPS2 * BIAS_TIME_S**2) ** 2
            P[X, X] += moved
            P[Y, Y] += moved
        for k in range(nav.refused.shape[0]):
            nav.refused[k] = 0.0
        nav.restarted = 1.0
    restart.position = restart.heading = restart.surge = 0.0


@inlined
def lacks_gps(nav):
    """Return whether the GPS is lost."""
    return nav.gps_age > LOST_AFTER_S


@inlined
def is_learning_suspended(nav):
    """Return whether motion or commands are in doubt, so that models must not learn from them."""
    return nav.commands_doubted + nav.motion_doubted + nav.unsettled > 0.0


@inlined
def lacks_imu(nav):
    """Return whether the IMU is lost; a boat that never had one has lost none."""
    return nav.has_imu > 0.0 and nav.imu_age > LOST_AFTER_S


@inlined
def lacks_heading(nav):
    """Return whether neither compass nor gyro gives samples."""
    return min(nav.compass_age, nav.imu_age) > LOST_AFTER_S


@inlined
def is_ready(nav):
    """Return whether a fix and a heading have come."""
    return nav.has_fix * nav.has_heading > 0.0


@kernel
def _start(nav, z, settings):
    """Start from heading and fix, once both have come."""
    n, P = nav.n, nav.P
    speed = settings.velocity_var_0
    fastest = SPEED_LIMIT * math.sqrt(speed)
    if abs(z[COMPASS]) < HEADING_MAX_RAD:
        n[PSI] = z[COMPASS]
        nav.has_heading = 1.0
    if abs(z[GPS_X]) < POSITION_MAX_M and abs(z[GPS_Y]) < POSITION_MAX_M:
        n[X], n[Y] = z[GPS_X], z[GPS_Y]
        n[U] = n[V] = 0.0
        if abs(z[GPS_VX]) < fastest and abs(z[GPS_VY]) < fastest:
            n[U], n[V] = z[GPS_VX], z[GPS_VY]
        nav.has_fix = 1.0
        nav.gps_age = 0.0
    if abs(z[GYRO]) < TURN_LIMIT:
        n[R] = z[GYRO]
    if not is_ready(nav):
        return
    old = settings.latency + nav.gps_age
    c, s = math.cos(n[PSI]), math.sin(n[PSI])
    forward, side = settings.gps_x, settings.gps_y
    north, east = n[U], n[V]
    n[X] += old * north - c * forward + s * side
    n[Y] += old * east - s * forward - c * side
    n[U] = north * c + east * s + n[R] * side
    n[V] = east * c - north * s - n[R] * forward
    P[X, X] = P[Y, Y] = settings.gps_var + old * old * speed
    P[PSI, PSI] = settings.compass_var + settings.compass_bias_var
    P[PSI, COMPASS_BIAS] = P[COMPASS_BIAS, PSI] = -settings.compass_bias_var
    nav.gps_age = nav.compass_age = nav.imu_age = 0.0


@kernel
def _same(z, nav, sensor, first, last, dt):
    """Return whether all numbers that a sensor gives are those that it gave last."""
    given, same = False, True
    for j in range(first, last):
        if math.isfinite(z[j]):
            given = True
            same = same and z[j] == nav.last[j]
    nav.unchanged[sensor] += dt
    if not given:
        return False
    if not same:
        nav.unchanged[sensor] = 0.0
        for j in range(first, last):
            nav.last[j] = z[j]
    return same


@inlined
def _expected(j, past, before, settings, H):
    """Return number j of a fix as expected from the state ``before``; write its row H."""
    c, s = math.cos(past.psi), math.sin(past.psi)
    forward, side = settings.gps_x, settings.gps_y
    for i in range(6):
        H[i] = 0.0
    if j == 0:
        H[X], H[PSI], H[U], H[V] = 1.0, past.east - s * forward - c * side, -past.cos, past.sin
        return before[X] - past.north + c * forward - s * side
    if j == 1:
        H[Y], H[PSI] = 1.0, c * forward - s * side - past.north
        H[U], H[V] = -past.sin, -past.cos
        return before[Y] - past.east + s * forward + c * side
    u, v = past.u - past.r * side, past.v + past.r * forward
    north, east = u * c - v * s, u * s + v * c
    if j == 2:
        H[PSI], H[U], H[V], H[R] = -east, c, -s, -c * side - s * forward
        return north
    H[PSI], H[U], H[V], H[R] = north, s, c, c * forward - s * side
    return east


@kernel
def _correct_by_fix(nav, z, dt, repeats, settings, work):
    """Correct by position and velocity of the antenna when the fix was taken."""
    n, P, H, before = nav.n, nav.P, work.H, work.before
    past = past_motion(nav, settings, work.past[:])
    for i in range(N_NAV):
        before[i] = n[i]
    late, age = settings.latency, nav.gps_age
    # unknown change of velocity from then to now
    drift = settings.accel_var * min(dt, STEP_MAX_S) * late
    drift += settings.tilt_var * late * min(late, 2.0 * settings.tilt_time)
    drift += max(P[ACCEL_X_BIAS, ACCEL_X_BIAS], P[ACCEL_Y_BIAS, ACCEL_Y_BIAS]) * late * late
    # ... shared by all fixes of that time
    drift *= max(late / max(age, dt, 1e-3), 1.0)
    gps_var = settings.gps_var + drift * late * late / 3.0
    doppler_var = settings.doppler_var + drift
    fastest = SPEED_LIMIT * math.sqrt(settings.velocity_var_0)
    for j in range(4):
        if not abs(z[j]) < (POSITION_MAX_M if j < 2 else fastest):
            continue
        innovation = z[j] - _expected(j, past, before, settings, H)
        for i in range(6):
            innovation -= H[i] * (n[i] - before[i])
        variance = gps_var if j < 2 else doppler_var
        if repeats and innovation * innovation > variance:
            return
        if _correct(nav, work, innovation, variance, age, j):
            nav.gps_age = 0.0


@inlined
def _aided(model, i, density, held, settings):
    """Return an acceleration of a model, and the noise density that it leaves.

    An error of the model lasts: it acts for about a length over nominal speed. Where that makes
    more than a velocity that is held would wander, so much less of the acceleration is used.
    """
    density += model[MODEL_VARIANCES + i] / math.sqrt(settings.r_var_0)
    share = min(held / density, 1.0)
    return share * model[i], min(density, held)


@inlined
def _are_accelerations_plausible(nav, z, last_x, last_y, follows, settings):
    """Return whether the accelerations of a row are used; a leap from the row before is refused."""
    if not (abs(z[ACCEL_X]) < ACCEL_LIMIT and abs(z[ACCEL_Y]) < ACCEL_LIMIT):
        return False
    if follows:
        leap = max(abs(z[ACCEL_X] - last_x), abs(z[ACCEL_Y] - last_y))
        if leap > settings.leap and nav.refused[IMU_LEAPS] < 0.5 * REFUSED_MAX:
            nav.refused[IMU_LEAPS] += 1.0
            nav.last[ACCEL_X], nav.last[ACCEL_Y] = last_x, last_y
            return False
        nav.refused[IMU_LEAPS] = 0.0
    return True


@inlined
def _correct_by_gyro(nav, z, settings, work):
    """Correct the yaw rate and the gyro's bias."""
    n, H = nav.n, work.H
    H[R] = H[GYRO_BIAS] = 1.0
    innovation = z[GYRO] - n[R] - n[GYRO_BIAS]
    if _correct(nav, work, innovation, settings.gyro_var, nav.imu_age, 5):
        nav.imu_age = 0.0
    H[R] = H[GYRO_BIAS] = 0.0


@inlined
def _correct_by_compass(nav, z, repeats, settings, work):
    """Correct the heading and the compass's bias, unless the sample only repeats the last one."""
    n, H, variance = nav.n, work.H, settings.compass_var
    innovation = wrap(z[COMPASS] - n[PSI] - n[COMPASS_BIAS])
    still = nav.unchanged[1] >= FROZEN_S and innovation * innovation < variance
    if not repeats or still:
        H[PSI] = H[COMPASS_BIAS] = 1.0
        if _correct(nav, work, innovation, variance, nav.compass_age, 4):
            nav.compass_age = 0.0
        H[PSI] = H[COMPASS_BIAS] = 0.0


@kernel
def navigate(nav, dt, z, model, settings, work):
    """Take one row of measurements.

    Parameters
    ----------
    nav : record
        :data:`NAVIGATION`, advanced in place.
    dt : float
        Time since the row before, s; 0 or more.
    z : ndarray, shape (19,)
        Measurement row in the order of ``twin.logs.log.MEASUREMENTS``; NaN is missing.
    model : ndarray, shape (7,)
        Accelerations u', v' (m/s2), r' (rad/s2) for where the IMU is missing, and their use. 1: a
        model gave them; 0: there is none, and velocities are held. Then their variances.
    settings, work : record
        :data:`NAVIGATION_SETTINGS` and :data:`NAVIGATION_WORK`.
    """
    nav.lost = nav.restarted = 0.0
    n, P, H = nav.n, nav.P, work.H
    dt = min(max(dt, 0.0), GAP_MAX_S)
    nav.clock += dt
    nav.gps_age += dt
    nav.compass_age += dt
    nav.imu_age += dt
    last_gyro = nav.last[GYRO]
    last_x, last_y = nav.last[ACCEL_X], nav.last[ACCEL_Y]
    gps_repeats = _same(z, nav, 0, 0, 4, dt)
    compass_repeats = _same(z, nav, 1, 4, 5, dt)
    imu = not _same(z, nav, 2, 5, 8, dt)
    if not is_ready(nav):
        _start(nav, z, settings)
        if is_ready(nav):
            remember(nav, settings)
        return
    # whether the row before had an IMU sample, and whether gyro and accelerometers are plausible
    follows = dt > 0.0 and dt <= STEP_MAX_S and nav.imu_age <= 1.5 * dt
    gyro = imu and abs(z[GYRO]) < TURN_LIMIT
    driven = imu and _are_accelerations_plausible(nav, z, last_x, last_y, follows, settings)
    # a model's accelerations of this moment do not hold through a gap
    modelled = model[IS_MODELLED] > 0.0 and dt * dt * settings.r_var_0 <= 1.0
    r_rate, r_mean, r_var = 0.0, n[R], settings.r_density
    if gyro:
        change = z[GYRO] - n[GYRO_BIAS] - n[R]
        S = (
            P[R, R]
            + 2.0 * P[R, GYRO_BIAS]
            + P[GYRO_BIAS, GYRO_BIAS]
            + settings.gyro_var
            + r_var * dt
        )
        if change * change < GATE_SD * GATE_SD * S:
            r_mean += 0.5 * change
    elif modelled:
        r_rate, r_var = _aided(model, 2, settings.r_aided_density, r_var, settings)
    fine = min(dt, FINE_MAX_S)
    steps = max(1, math.ceil(fine / STEP_MAX_S - 1e-9))
    coarse = math.ceil((dt - fine) / COARSE_STEP_S)
    ax, ay, held = 0.0, 0.0, settings.held_density
    if modelled:
        ax, ahead = _aided(model, 0, settings.aided_density, held, settings)
        ay, aside = _aided(model, 1, settings.aided_density, held, settings)
        held = max(ahead, aside)
    for j in range(-coarse, steps):
        h = (dt - fine) / coarse if j < 0 else fine / steps
        # a sample is the mean over its interval; a gap is not filled with it
        if driven and j == steps - 1:
            forward, side = settings.imu_x, settings.imu_y
            turn = r_mean * r_mean
            spin = (z[GYRO] - last_gyro) / dt if gyro and follows else 0.0
            if not abs(spin) * STEP_MAX_S < 1.0:
                spin = 0.0
            force_x = z[ACCEL_X] + turn * forward + spin * side
            force_y = z[ACCEL_Y] + turn * side - spin * forward
            var = settings.accel_var * h * h
            motion = Motion(h, force_x, force_y, var, True, r_mean, r_rate, r_var * h)
        else:
            if not gyro:
                r_mean = n[R] + 0.5 * h * r_rate
            motion = Motion(h, ax, ay, held * h, False, r_mean, r_rate, r_var * h)
        predict(nav, settings, motion, work.A)
    if steps > 1:
        mend(P, work.A)

    for i in range(N_NAV):
        H[i] = 0.0
    if gyro:
        _correct_by_gyro(nav, z, settings, work)
    if abs(z[COMPASS]) < HEADING_MAX_RAD:
        _correct_by_compass(nav, z, compass_repeats, settings, work)
    if not gps_repeats or nav.unchanged[0] >= FROZEN_S:
        _correct_by_fix(nav, z, dt, gps_repeats, settings, work)
    nav.since_lost += dt
    nav.unsettled = max(nav.unsettled - dt, 0.0)
    if nav.lost > 0.0:
        _forget_biases(nav, settings)
        fastest = LOST_SPEED_RATIO**2 * settings.velocity_var_0
        if nav.since_lost < LOST_AGAIN_S and n[U] * n[U] + n[V] * n[V] > fastest:
            _forget_velocity(nav, settings)
            nav.unsettled = SETTLING_S
        nav.since_lost = 0.0
    _begin_again(nav, settings)
    remember(nav, settings)
