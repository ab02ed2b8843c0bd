"""A bank of small navigation filters, each leaving one sensor out, and tests of their innovations.

Each filter is an extended Kalman filter of eight states

    x = (p_n, p_e, v_n, v_e, psi, g, a_1, a_2)

position and velocity over the ground of the IMU, m and m/s north and east, and heading, rad. Where
a filter uses the gyro, g is its bias, rad/s, else the yaw rate. Where it uses the accelerometers,
a_1, a_2 are their biases forward and to starboard, m/s2, else the acceleration itself, a
first-order Gauss-Markov process (Singer 1970).

Noise comes from the data sheets alone. What drifts in a GPS or a compass is process noise of
position and heading: 2 sd^2 / T of a first-order Gauss-Markov process of the time T.

Samples are taken in epochs of :data:`EPOCH_S`: the mean of the samples of a sensor stands for them,
at their mean age. The innovations of an epoch, divided by their standard deviations, are white with
variance 1 if all sensors that the filter uses are sound. So their exponentially weighted mean m
over a window gives a chi-square, N |m|^2, with N the effective number of samples. While all is
sound it is learned how much more the means vary (their level), as real errors are neither white nor
those of the data sheet. A filter passes as long as no window of any sensor exceeds the chi-square
that a sound one exceeds with the probability :data:`FALSE_ALARM`.

Without GPS the accelerations that the commands make (:mod:`twin.integrity.commands`) are one more
aid: what the accelerometers measured more is their bias, with the variance learned before.

Sources: Särkkä 2013, Bayesian Filtering and Smoothing, 5.2 (filter); Bar-Shalom, Li and Kirubarajan
2001, Estimation with Applications to Tracking and Navigation, 5.4 (tests of innovations); Singer
1970, IEEE Trans. Aerospace and Electronic Systems 6(4); Huber 1964 (clipped innovations); Blanch et
al. 2012, ION GNSS, and Brown and McBurney 1988 (a bank that leaves sensors out: solution
separation).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from twin.particulars import GRAVITY, Particulars
from usv_kernel.arrays import alloca_f64
from usv_kernel.jit import inlined, kernel
from usv_kernel.scalar import wrap

__all__ = [
    "ACCELERATION_FIRST",
    "BANK",
    "BANK_SETTINGS",
    "FILTERS",
    "LEFT_OUT",
    "LEVEL_MAX",
    "advance_bank",
    "bank_settings",
    "begin_anew",
    "begin_at_fix",
    "convert",
    "forget_tests",
    "window_ratio",
]

Array = NDArray[np.float64]

FIXES, VELOCITY, COMPASS, GYRO, ACCELEROMETERS = range(5)
"""Sensors that a filter may leave out."""

SENSED = 3
"""Number of sensors that correct a filter, the first ones; the others drive its prediction."""

THRUST = SENSED
"""The aid after these: accelerations that the commands make, where there is no GPS."""

AIDS = 4

LEFT_OUT = np.array(
    [
        [0.0, 0.0, 0.0, 0.0, 0.0],
        [1.0, 0.0, 0.0, 0.0, 0.0],
        [0.0, 1.0, 0.0, 0.0, 0.0],
        [1.0, 1.0, 0.0, 0.0, 0.0],
        [0.0, 0.0, 1.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, 1.0, 0.0],
        [0.0, 0.0, 0.0, 0.0, 1.0],
    ]
)
"""What each filter leaves out: nothing, one sensor, or the GPS."""

FILTERS = len(LEFT_OUT)

ALL, NO_FIXES, NO_VELOCITY, NO_GPS, NO_COMPASS, NO_GYRO, NO_ACCELEROMETERS = range(FILTERS)
"""The filters, by what each uses or leaves out."""

STATES = 8
PN, PE, VN, VE, PSI, G, A1, A2 = range(STATES)
"""Places in the state."""

EPOCH_S = 0.2
"""Samples within this time are taken together."""

WINDOWS_S = np.array([1.0, 12.0])
"""Windows of the test."""

WINDOWS = len(WINDOWS_S)

FALSE_ALARM = 1e-7
"""Probability that a sound filter fails a test."""

THRESHOLD = -2.0 * math.log(FALSE_ALARM)
"""Chi-square of two degrees of freedom that is exceeded with this probability."""

INNOVATION_MAX_SD = 6.0
"""Innovation, in standard deviations, at which the test clips (Huber) and the filter gates."""

SILENT_S = 3.0
"""Age of the last sample above which a sensor counts as absent."""

RETURN_S = 2.0
"""Time for which a sensor must have passed its test before it is used again."""

LEARN_S = 60.0
"""Time constant with which levels, and the motion of the boat, are learned ..."""

LEARN_FIRST_S = 10.0
"""... and that of levels at the start."""

ROW_FORGETTING = 0.05
"""Weight of a new interval in the mean interval between rows (exponential forgetting)."""

ROWS_HELD_MAX = 2.5
"""Most row intervals for which one sample of the IMU is held."""

STEP_MAX_S = 1.0
"""Longest step of a prediction."""

GAP_S = 30.0
"""Gap between rows above which the filters begin anew, near the last fix."""

LOST_SD_M = 100.0
"""Standard deviation of an unknown position."""

LOST_HEADING_SD_RAD = 0.7
"""Standard deviation of an unknown heading."""

LEVEL_MAX = 4.0
"""Largest level (inflation of the variance of the means), and its first value."""

DELAY_SD_S = 0.2
"""Standard deviation of a sensor's undeclared delay."""

FILTER = np.dtype(
    [
        ("x", "f8", STATES),  # state
        ("P", "f8", (STATES, STATES)),  # its covariance
        ("uses_gyro", "f8"),  # 1 where the gyro drives it, else 0
        ("uses_accelerometers", "f8"),  # 1 where the accelerometers do
        ("mean", "f8", (AIDS, WINDOWS, 2)),  # weighted means of the whitened innovations
        ("seen", "f8", AIDS),  # time that the windows have seen, s
        ("misfit", "f8", AIDS),  # -2 log-likelihood of the samples since the failure began
        ("ratio", "f8"),  # largest statistic over its threshold; below 1 the filter passes
        ("since", "f8"),  # clock at which it began from another filter, s
    ]
)
"""A filter and its test."""

BANK = np.dtype(
    [
        ("filters", FILTER, FILTERS),
        ("begun", "f8"),  # 1 once a fix and a heading have come
        ("clock", "f8"),  # s since the start
        # sums of the epoch
        ("span", "f8"),  # its length so far, s
        ("gyro", "f8", 2),  # integral of the yaw rate (rad), and its time (s)
        ("force", "f8", 3),  # integrals of the specific forces (m/s), and their time (s)
        ("samples", "f8", AIDS),  # number of samples
        ("sum", "f8", 5),  # of x, y, v_x, v_y, heading
        ("age_sum", "f8", SENSED),  # of the ages at the end of the epoch, s
        ("age", "f8", SENSED),  # time since the last sample, s
        ("interval", "f8", AIDS),  # typical time between samples, s
        # accelerations that the commands make, what these were less than the measured specific
        # forces (m/s2), and the variances of that
        ("push", "f8", 2),
        ("excess", "f8", 2),
        ("push_var", "f8", 2),
        ("modelled", "f8"),  # 1 while this is used, as no GPS is
        # variance of mean innovations over that of white ones, learned while all is sound
        ("level", "f8", (AIDS, WINDOWS)),
        ("imu_age", "f8", 2),  # of gyro, accelerometers, s
        ("row", "f8"),  # typical time between rows, s
        ("rate", "f8"),  # last yaw rate of the gyro, rad/s
        ("heading", "f8"),  # first heading of the epoch, rad
        ("last", "f8", 5),  # last fix, velocity and heading; NaN before the first
        ("force_filter", "f8"),  # the filter in force
        ("fastest", "f8"),  # largest speed that the boat has sailed, m/s
        ("acceleration", "f8"),  # mean square of a specific force, (m/s2)2
        ("acceleration_walk", "f8"),  # mean square change of it in a second, (m/s2)2/s
        ("epoch_force", "f8", 2),  # mean specific forces of the last epoch, m/s2
        ("epoch_velocity", "f8", 2),  # mean GPS velocity of an epoch about a second ago, m/s ...
        ("velocity_age", "f8"),  # ... and how long ago, s; NaN: there is none
        ("rate_walk", "f8"),  # mean square change of the yaw rate in a second, (rad/s)2/s
        ("epoch_rate", "f8"),  # mean yaw rate of the last epoch, rad/s
    ]
)
"""What the bank remembers."""

BANK_SETTINGS = np.dtype(
    [
        ("fix_var", "f8"),  # m2
        ("velocity_var", "f8"),  # (m/s)2
        ("compass_var", "f8"),  # rad2
        ("gyro_var", "f8"),  # (rad/s)2
        ("accel_var", "f8"),  # (m/s2)2
        ("gyro_bias_var", "f8"),  # (rad/s)2
        ("accel_bias_var", "f8"),  # (m/s2)2
        ("bias_time", "f8"),  # s
        ("fix_drift", "f8"),  # m2/s
        ("compass_drift", "f8"),  # rad2/s
        ("tilt_drift", "f8"),  # of the velocity, (m/s)2/s
        ("rate_drift", "f8"),  # of a yaw rate without gyro, (rad/s)2/s
        ("rate_var", "f8"),  # of a yaw rate at the start, (rad/s)2
        ("thrust_var", "f8"),  # of an acceleration without accelerometers, (m/s2)2
        ("thrust_time", "f8"),  # s
        ("speed_var", "f8"),  # of a velocity at the start, (m/s)2
        ("gps_latency", "f8"),  # s
        ("compass_latency", "f8"),  # s
        ("gps_arm", "f8", 2),  # from IMU to antenna, m forward and to starboard
        ("origin_arm", "f8", 2),  # from IMU to origin, m
        ("fix_bias_var", "f8"),  # m2
        ("compass_bias_var", "f8"),  # rad2
    ]
)
"""What it is given of a boat and its instruments."""

ACCELERATION_FIRST = 1.0
"""Standard deviation of the acceleration before it is known, m/s2: of a small boat in waves."""

GPS_DRIFT_S = 400.0
"""Time constant of the drift of a GPS."""

COMPASS_DRIFT_S = 200.0
"""Time constant of the drift of a compass."""

BIAS_TIME_S = 100.0
"""Time constant of the biases of gyro and accelerometers."""


def bank_settings(particulars: Particulars) -> Array:
    """Return the settings of a bank for a boat, in the order of :data:`BANK_SETTINGS`.

    What no data sheet states scales with speed and length (Froude).
    """
    I, U, L = particulars.instruments, particulars.speed, particulars.length
    turn = U / L
    gps = [a - b for a, b in zip(I.gps_arm[:2], I.imu_arm[:2], strict=True)]
    return np.array(
        [
            I.gps_sd**2,
            I.doppler_sd**2,
            I.compass_sd**2,
            I.gyro_sd**2,
            I.accel_sd**2,
            I.gyro_bias_sd**2 + 1e-8,
            I.accel_bias_sd**2 + 1e-6,
            BIAS_TIME_S,
            2.0 * I.gps_bias_sd**2 / GPS_DRIFT_S,
            2.0 * I.compass_bias_sd**2 / COMPASS_DRIFT_S,
            2.0 * (GRAVITY * I.tilt_sd) ** 2 * I.tilt_time,
            (0.5 * turn) ** 2 * turn,
            turn**2,
            (0.25 * U * turn) ** 2,
            L / U,
            U**2,
            I.gps_latency,
            I.compass_latency,
            *gps,
            -I.imu_arm[0],
            -I.imu_arm[1],
            I.gps_bias_sd**2,
            I.compass_bias_sd**2,
        ]
    )


@inlined
def convert(one, gyro, accelerometers, given):
    """Change the states of gyro and accelerometers to biases, or to yaw rate and acceleration."""
    if one.uses_gyro != gyro:
        one.uses_gyro = gyro
        for j in range(STATES):
            one.P[G, j] = one.P[j, G] = 0.0
        one.x[G] = 0.0
        one.P[G, G] = given.gyro_bias_var if gyro > 0.0 else given.rate_var
    if one.uses_accelerometers != accelerometers:
        one.uses_accelerometers = accelerometers
        for i in range(A1, A2 + 1):
            for j in range(STATES):
                one.P[i, j] = one.P[j, i] = 0.0
            one.x[i] = 0.0
            one.P[i, i] = given.accel_bias_var if accelerometers > 0.0 else given.thrust_var


@kernel
def predict(one, T, bank, given):
    """Predict a filter by T s of the epoch; return its acceleration north and east, m/s2."""
    x, P = one.x, one.P
    gyro, driven = one.uses_gyro > 0.0, one.uses_accelerometers > 0.0
    forward, side = bank.force[0], bank.force[1]
    dpsi = T * (bank.gyro[0] - x[G]) if gyro else T * x[G]
    c, s = math.cos(x[PSI] + 0.5 * dpsi), math.sin(x[PSI] + 0.5 * dpsi)
    # body accelerations: measured less bias, or the state itself
    a = forward - x[A1] if driven else x[A1]
    b = side - x[A2] if driven else x[A2]
    north, east = c * a - s * b, s * a + c * b
    sign = -1.0 if driven else 1.0
    half = 0.5 * T * T
    x[PN] += T * x[VN] + half * north
    x[PE] += T * x[VE] + half * east
    x[VN] += T * north
    x[VE] += T * east
    x[PSI] += dpsi
    # P = F P F', row operations and then the same on the columns
    g = -T if gyro else T
    for k in range(2):
        for j in range(STATES):
            if k == 0:
                psi, a1, a2 = P[PSI, j], P[A1, j], P[A2, j]
                dn = -east * psi + sign * (c * a1 - s * a2)
                de = north * psi + sign * (s * a1 + c * a2)
                P[PN, j] += T * P[VN, j] + half * dn
                P[PE, j] += T * P[VE, j] + half * de
                P[VN, j] += T * dn
                P[VE, j] += T * de
                P[PSI, j] += g * P[G, j]
            else:
                psi, a1, a2 = P[j, PSI], P[j, A1], P[j, A2]
                dn = -east * psi + sign * (c * a1 - s * a2)
                de = north * psi + sign * (s * a1 + c * a2)
                P[j, PN] += T * P[j, VN] + half * dn
                P[j, PE] += T * P[j, VE] + half * de
                P[j, VN] += T * dn
                P[j, VE] += T * de
                P[j, PSI] += g * P[j, G]
    row = bank.row
    noise = T * (given.accel_var * row + given.tilt_drift) if driven else 0.0
    P[VN, VN] += noise
    P[VE, VE] += noise
    P[PN, PN] += T * given.fix_drift
    P[PE, PE] += T * given.fix_drift
    P[PSI, PSI] += T * given.compass_drift
    if gyro:
        P[PSI, PSI] += T * row * given.gyro_var
        P[G, G] += 2.0 * T / given.bias_time * max(given.gyro_bias_var - P[G, G], 0.0)
    else:
        walk = max(given.rate_drift, bank.rate_walk)
        P[G, G] += T * walk
        P[PSI, PSI] += T * T * T / 3.0 * walk
    # as much, and as fast, as was measured; it lasts no longer than a length takes
    acceleration = max(given.thrust_var, bank.acceleration)
    walk = max(2.0 * acceleration / given.thrust_time, bank.acceleration_walk)
    for i in range(A1, A2 + 1):
        if driven:
            P[i, i] += 2.0 * T / given.bias_time * max(given.accel_bias_var - P[i, i], 0.0)
        else:
            keep = math.exp(-0.5 * T * walk / acceleration)
            x[i] *= keep
            for j in range(STATES):
                P[i, j] *= keep
                P[j, i] *= keep
            P[i, i] += (1.0 - keep * keep) * acceleration
    return north, east


@inlined
def _innovation(one, aid, k, bank, age, rate, acceleration, ahead, side, gain):
    """Return number k of an aid less what a filter expects ``age`` s ago, and h P h'.

    P h' is written to ``gain`` (8,). The row h has entries of position, velocity, heading and rate.
    ``ahead`` and ``side`` are the antenna's arm, m north and east.
    """
    x, P, z = one.x, one.P, bank.sum
    if aid == THRUST:
        # a bias where the accelerometers are used, else what they would measure
        at, said = A1 + k, bank.excess[k] if one.uses_accelerometers > 0.0 else bank.push[k]
        for i in range(STATES):
            gain[i] = P[i, at]
        return said - x[at], P[at, at]
    if aid == COMPASS:
        on_rate = 0.0 if one.uses_gyro > 0.0 else -age
        nu = wrap(z[4] - (x[PSI] - age * rate))
        for i in range(STATES):
            gain[i] = P[i, PSI] + on_rate * P[i, G]
        return nu, gain[PSI] + on_rate * gain[G]
    arm, turned = (ahead, -side) if k == 0 else (side, ahead)
    v = VN + k
    if aid == FIXES:
        p = PN + k
        nu = z[k] - (x[p] - age * x[v] + 0.5 * age * age * acceleration + arm)
        for i in range(STATES):
            gain[i] = P[i, p] - age * P[i, v] + turned * P[i, PSI]
        return nu, gain[p] - age * gain[v] + turned * gain[PSI]
    at = 0.0 if one.uses_gyro > 0.0 else turned
    nu = z[2 + k] - (x[v] - age * acceleration + rate * turned)
    for i in range(STATES):
        gain[i] = P[i, v] + at * P[i, G]
    return nu, gain[v] + at * gain[G]


@kernel
def _correct(one, gain, innovation, S):
    """Correct a filter by one number, with P h' in ``gain`` and the innovation variance S."""
    x, P, step = one.x, one.P, innovation / S
    for i in range(STATES):
        x[i] += gain[i] * step
        share = gain[i] / S
        for j in range(STATES):
            P[i, j] -= share * gain[j]


@inlined
def _numbers(aid):
    """Return how many numbers an aid has."""
    return 1 if aid == COMPASS else 2


@kernel
def _test_and_correct(one, aid, bank, age, variance, span, rate, north, east, failing, given):
    """Test and correct a filter by an aid."""
    numbers, level, gain = _numbers(aid), bank.level[aid, 0], alloca_f64(STATES)
    c, s = math.cos(one.x[PSI]), math.sin(one.x[PSI])
    ahead = c * given.gps_arm[0] - s * given.gps_arm[1]
    side = s * given.gps_arm[0] + c * given.gps_arm[1]
    w0 = w1 = nu = spread = 0.0
    growth = 1.0
    # the first last: it is what corrects first
    for j in range(numbers):
        k = numbers - 1 - j
        acceleration, R = north if k == 0 else east, variance[k]
        nu, spread = _innovation(one, aid, k, bank, age, rate, acceleration, ahead, side, gain)
        S = (spread + R) * level
        growth *= S / R
        w1, w0 = w0, nu / math.sqrt(S)
    total = w0 * w0 + w1 * w1
    size = math.sqrt(total)
    share = min(1.0, INNOVATION_MAX_SD / max(size, 1e-12))
    one.seen[aid] += span
    for i in range(WINDOWS):
        alpha = min(max(span / WINDOWS_S[i], span / one.seen[aid]), 1.0)
        one.mean[aid, i, 0] += alpha * (w0 * share - one.mean[aid, i, 0])
        one.mean[aid, i, 1] += alpha * (w1 * share - one.mean[aid, i, 1])
    if failing:
        one.misfit[aid] += min(total, INNOVATION_MAX_SD * INNOVATION_MAX_SD) + math.log(growth)
    if size <= INNOVATION_MAX_SD and (aid < SENSED or bank.modelled > 0.0):
        _correct(one, gain, nu, spread + variance[0])
        if numbers > 1:
            nu, spread = _innovation(one, aid, 1, bank, age, rate, east, ahead, side, gain)
            _correct(one, gain, nu, spread + variance[1])


@inlined
def _samples(one, aid, window, bank):
    """Return the effective number of white innovations in a mean over a window."""
    span = max(bank.interval[aid], EPOCH_S)
    return max(min(one.seen[aid] / span, 2.0 * WINDOWS_S[window] / span - 1.0), 1.0)


@inlined
def _learn_level(one, aid, span, bank):
    """Learn the level: the variance of the means over that of white innovations."""
    numbers, level = float(_numbers(aid)), bank.level
    share = min(span / min(max(one.seen[aid], LEARN_FIRST_S), LEARN_S), 0.1)
    first = level[aid, 0]
    for i in range(WINDOWS):
        m0, m1 = one.mean[aid, i, 0], one.mean[aid, i, 1]
        square = (m0 * m0 + m1 * m1) * _samples(one, aid, i, bank) / numbers * first
        level[aid, i] = min(max(level[aid, i] + share * (square - level[aid, i]), 1.0), LEVEL_MAX)


@inlined
def window_ratio(one, aid, window, bank):
    """Return the statistic of an aid in a window over its threshold."""
    if one.seen[aid] == 0.0:
        return 0.0
    m0, m1 = one.mean[aid, window, 0], one.mean[aid, window, 1]
    # the first level is that of the innovations themselves
    level = bank.level[aid, window] / bank.level[aid, 0]
    return (m0 * m0 + m1 * m1) * _samples(one, aid, window, bank) / level / THRESHOLD


@kernel
def test_ratio(k, bank):
    """Return the largest statistic of filter k over its threshold."""
    most = 0.0
    for aid in range(AIDS):
        tested = bank.modelled > 0.0
        if aid < SENSED:
            tested = LEFT_OUT[k, aid] == 0.0 and bank.age[aid] <= SILENT_S
        if tested:
            for i in range(WINDOWS):
                most = max(most, window_ratio(bank.filters[k], aid, i, bank))
    return most


@kernel
def forget_tests(one):
    """Begin the tests of a filter anew."""
    one.mean[:] = 0.0
    one.seen[:] = 0.0
    one.ratio = 0.0


@inlined
def _keep_last(bank, aid, z):
    """Keep the sample of a sensor, if there is one; return whether there is."""
    first, end = 2 * aid, min(2 * aid + 2, COMPASS * 2 + 1)
    for j in range(first, end):
        if math.isnan(z[j]):
            return False
    for j in range(first, end):
        bank.last[j] = z[j]
    return True


@kernel
def begin_at_fix(one, bank, given):
    """Set position and velocity of a filter to the last ones of the GPS."""
    for i in range(PN, VE + 1):
        for j in range(STATES):
            one.P[i, j] = one.P[j, i] = 0.0
        one.x[i] = 0.0 if math.isnan(bank.last[i]) else bank.last[i]
    one.P[PN, PN] = one.P[PE, PE] = 4.0 * given.fix_var
    one.P[VN, VN] = one.P[VE, VE] = given.speed_var


@kernel
def begin_anew(bank, given):
    """Begin every filter near the last fix, with all else unknown."""
    for k in range(FILTERS):
        one = bank.filters[k]
        for i in range(STATES):
            for j in range(STATES):
                one.P[i, j] = 0.0
        begin_at_fix(one, bank, given)
        one.P[PN, PN] = one.P[PE, PE] = LOST_SD_M**2
        one.P[PSI, PSI] = LOST_HEADING_SD_RAD**2
        one.P[A1, A1] = one.P[A2, A2] = given.accel_bias_var
        one.uses_gyro = one.uses_accelerometers = -1.0
        one.since = bank.clock
        forget_tests(one)
    bank.force_filter = ALL


@inlined
def _gather(dt, z, bank, given):
    """Add a row to the sums of the epoch; z has the samples that may be used."""
    bank.clock += dt
    bank.span += dt
    if bank.row == 0.0:
        bank.row = dt
    bank.row += ROW_FORGETTING * (min(dt, ROWS_HELD_MAX * bank.row) - bank.row)
    covered = min(dt, ROWS_HELD_MAX * bank.row)
    for aid in range(SENSED):
        bank.age[aid] += dt
        bank.age_sum[aid] += dt * bank.samples[aid]
    for k in range(2):
        bank.imu_age[k] += dt
    if not math.isnan(z[5]):
        before = z[5] if math.isnan(bank.rate) else bank.rate
        # a sample is that of its moment: trapezoid
        bank.gyro[0] += covered * 0.5 * (z[5] + before)
        bank.gyro[1] += covered
        bank.imu_age[0] = 0.0
    bank.rate = z[5]
    if not (math.isnan(z[6]) or math.isnan(z[7])):
        bank.force[0] += covered * z[6]
        bank.force[1] += covered * z[7]
        bank.force[2] += covered
        bank.imu_age[1] = 0.0
    for aid in range(SENSED):
        first = 2 * aid
        if not _keep_last(bank, aid, z):
            continue
        passed = bank.age[aid]
        bank.age[aid] = 0.0
        if 0.0 < passed < SILENT_S:
            if bank.interval[aid] == 0.0:
                bank.interval[aid] = passed
            bank.interval[aid] += 0.1 * (passed - bank.interval[aid])
        if aid == COMPASS:
            if bank.samples[aid] == 0.0:
                bank.heading = z[4]
            bank.sum[4] += bank.heading + wrap(z[4] - bank.heading)
            bank.age_sum[aid] += given.compass_latency
        else:
            bank.sum[first] += z[first]
            bank.sum[first + 1] += z[first + 1]
            bank.age_sum[aid] += given.gps_latency
        bank.samples[aid] += 1.0


@kernel
def begin_bank(bank, z, given):
    """Begin all filters with the first fix and heading."""
    for aid in range(SENSED):
        _keep_last(bank, aid, z)
    if math.isnan(bank.last[0]) or math.isnan(bank.last[4]):
        return
    bank.begun = 1.0
    for k in range(FILTERS):
        one = bank.filters[k]
        one.x[:], one.P[:, :] = 0.0, 0.0
        one.x[PSI] = bank.last[4]
        one.P[PSI, PSI] = given.compass_var + given.compass_bias_var
        begin_at_fix(one, bank, given)
        one.uses_gyro = one.uses_accelerometers = -1.0
        one.since = bank.clock
        forget_tests(one)


@inlined
def _end_sums(bank):
    """Turn the sums of the epoch into means."""
    for aid in range(SENSED):
        n = bank.samples[aid]
        if n > 0.0:
            bank.age_sum[aid] /= n
            for j in range(2 * aid, min(2 * aid + 2, 5)):
                bank.sum[j] /= n
    for j in range(2):
        bank.force[j] = bank.force[j] / bank.force[2] if bank.force[2] > 0.0 else 0.0
    bank.gyro[0] = bank.gyro[0] / bank.gyro[1] if bank.gyro[1] > 0.0 else 0.0


@inlined
def _cover_gap(one, row, bank, given):
    """Add the uncertainty of the part of an epoch in which gyro or accelerometers were missing."""
    without_gyro = max(bank.span - bank.gyro[1], 0.0)
    if one.uses_gyro > 0.0 and without_gyro > 0.5 * row:
        one.P[PSI, PSI] += without_gyro * without_gyro * given.rate_var
    missing = max(bank.span - bank.force[2], 0.0)
    if one.uses_accelerometers > 0.0 and missing > 0.5 * row:
        noise = 2.0 * missing * given.thrust_time * max(given.thrust_var, bank.acceleration)
        for i in range(2):
            one.P[VN + i, VN + i] += noise
            one.P[PN + i, PN + i] += noise * missing * missing / 3.0
            one.P[PN + i, VN + i] += 0.5 * noise * missing
            one.P[VN + i, PN + i] = one.P[PN + i, VN + i]


@kernel
def _advance_filter(k, bank, given, sound, failing):
    """Predict filter k over the epoch, test it, and correct it."""
    one, T, row = bank.filters[k], bank.span, bank.row
    gyro = LEFT_OUT[k, GYRO] == 0.0 and bank.imu_age[0] < SILENT_S
    driven = LEFT_OUT[k, ACCELEROMETERS] == 0.0 and bank.imu_age[1] < SILENT_S
    convert(one, 1.0 if gyro else 0.0, 1.0 if driven else 0.0, given)
    steps, north, east = math.ceil(T / STEP_MAX_S - 1e-6), 0.0, 0.0
    for _ in range(steps):
        north, east = predict(one, T / steps, bank, given)
    _cover_gap(one, row, bank, given)
    rate = bank.gyro[0] - one.x[G] if gyro else one.x[G]
    # the moment of a sample is known to within a row, and delays are not stated in full
    late = DELAY_SD_S * DELAY_SD_S + row * row / 12.0
    for aid in range(AIDS):
        n = bank.samples[aid]
        if n == 0.0 or (aid < SENSED and LEFT_OUT[k, aid] > 0.0):
            continue
        if aid == FIXES:
            R = given.fix_var / n + 0.5 * late * (one.x[VN] ** 2 + one.x[VE] ** 2)
        elif aid == VELOCITY:
            R = given.velocity_var / n + 0.5 * late * min(
                north * north + east * east, 2.0 * max(given.thrust_var, bank.acceleration)
            )
        else:
            R = given.compass_var / n + late * min(rate * rate, given.rate_var)
        variance = (R, R)
        if aid == THRUST:
            variance = (bank.push_var[0], bank.push_var[1])
        span = max(bank.interval[aid], EPOCH_S) if bank.interval[aid] > 0.0 else T
        age = bank.age_sum[aid] if aid < SENSED else 0.0
        _test_and_correct(one, aid, bank, age, variance, span, rate, north, east, failing, given)
        if sound and k == 0 and (aid < SENSED or bank.modelled == 0.0):
            _learn_level(one, aid, span, bank)
    one.ratio = test_ratio(k, bank)


@inlined
def _learn_motion(bank, given):
    """Learn the variance of accelerations, and time constants of these and of the yaw rate."""
    T = bank.span
    share = min(T / min(max(bank.clock, LEARN_FIRST_S), LEARN_S), 0.1)
    has_force, has_gyro = bank.force[2] > 0.0, bank.gyro[1] > 0.0
    forward, side, rate = bank.force[0], bank.force[1], bank.gyro[0]
    sound, n = bank.filters[0], bank.samples[VELOCITY]
    bank.velocity_age += T
    # over so long, noise of the velocity is small beside its change
    if n > 0.0 and not bank.velocity_age < STEP_MAX_S - 1e-6:
        north, east = bank.sum[2] - bank.epoch_velocity[0], bank.sum[3] - bank.epoch_velocity[1]
        square = 0.5 * (north * north + east * east) - 2.0 * given.velocity_var / n
        passed = bank.velocity_age
        if not has_force and passed <= SILENT_S:
            # without accelerometers from the change of the GPS velocity
            more = min(share * passed / T, 0.1)
            bank.acceleration += more * (square / (passed * passed) - bank.acceleration)
        bank.epoch_velocity[0], bank.epoch_velocity[1] = bank.sum[2], bank.sum[3]
        bank.velocity_age = 0.0
    if bank.force_filter == 0.0 and sound.ratio < 0.5:
        if min(bank.age[FIXES], bank.age[VELOCITY]) < SILENT_S:
            bank.fastest = max(bank.fastest, math.hypot(sound.x[VN], sound.x[VE]))
        if has_force:
            square = 0.5 * (forward * forward + side * side)
            bank.acceleration += share * (square - bank.acceleration)
        a, b = forward - bank.epoch_force[0], side - bank.epoch_force[1]
        if has_force and not math.isnan(a):
            bank.acceleration_walk += share * (0.5 * (a * a + b * b) / T - bank.acceleration_walk)
        step = rate - bank.epoch_rate
        if has_gyro and not math.isnan(step):
            bank.rate_walk += share * (step * step / T - bank.rate_walk)
    bank.epoch_force[0] = forward if has_force else math.nan
    bank.epoch_force[1] = side if has_force else math.nan
    bank.epoch_rate = rate if has_gyro else math.nan


@inlined
def _begin_epoch(bank):
    """Begin the sums of an epoch."""
    bank.span = bank.gyro[0] = bank.gyro[1] = 0.0
    for j in range(5):
        bank.sum[j] = 0.0
    for j in range(3):
        bank.age_sum[j] = bank.force[j] = 0.0
    for aid in range(AIDS):
        bank.samples[aid] = 0.0


@inlined
def _pass_gap(dt, z, bank, given):
    """Begin anew after a gap between rows, with the samples that come after it."""
    bank.clock += dt
    for aid in range(SENSED):
        bank.age[aid] = 0.0 if _keep_last(bank, aid, z) else bank.age[aid] + dt
    for k in range(2):
        bank.imu_age[k] = bank.imu_age[k] + dt if math.isnan(z[5 + k]) else 0.0
    if not math.isnan(z[4]):
        for k in range(FILTERS):
            bank.filters[k].x[PSI] = z[4]
    begin_anew(bank, given)
    bank.rate = bank.epoch_rate = math.nan
    bank.epoch_force[:] = bank.velocity_age = math.nan
    _begin_epoch(bank)


@kernel
def _end_epoch(bank, given):
    """Update the filters by the samples of an epoch; no epoch spans a gap between rows."""
    _end_sums(bank)
    biased = bank.filters[0].uses_accelerometers > 0.0 and bank.samples[THRUST] > 0.0
    for i in range(2):
        bank.excess[i] += bank.filters[0].x[A1 + i] if biased else 0.0
    failing = bank.filters[int(bank.force_filter)].ratio >= 1.0
    sound = bank.force_filter == 0.0 and not failing
    for k in range(FILTERS):
        _advance_filter(k, bank, given, sound, failing)
    _learn_motion(bank, given)
    _begin_epoch(bank)


@kernel
def advance_bank(dt, z, anew, bank, given):
    """Take a row; return whether an epoch ended, so that the tests are new.

    z (8,) holds the samples that may be used: fix, GPS velocity, heading, yaw rate, forces. With
    ``anew`` the filters begin anew with them.
    """
    if bank.begun == 0.0:
        bank.clock += dt
        begin_bank(bank, z, given)
        return False
    if anew or dt > GAP_S:
        _pass_gap(dt, z, bank, given)
        return False
    gap = dt > EPOCH_S and bank.span > 0.0
    if gap:
        _end_epoch(bank, given)
    _gather(dt, z, bank, given)
    if bank.span >= EPOCH_S - 1e-6:
        _end_epoch(bank, given)
        return True
    return gap
