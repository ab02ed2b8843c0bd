"""Commands held against the motion that they should make: two regressions and named hypotheses.

In a step of about a third of a length over nominal speed, yaw rate and surge change by

    dr = a1 r + a2 r |r| + a3 M + a4 D + a5 u v + a6
    du = b1 u + b2 u |u| + b3 T + b4 r^2 + b5 v r

with the thrust T that the commands ask for, the moment M of its steering part and the difference D
of the sides, all in nominal units (speed, length over speed, thrust). The coefficients are learned
by recursive least squares with forgetting, and what is left over, which waves make, by its mean
square. A hypothesis says what a boat makes of its commands: it changes the signs and sides in T, M
and D. Evidence for it is the cumulative sum of its log-likelihood ratio to the one in force, of
Student's t, each step weighed by the correlation of the residuals: waves last longer than a step.

Without GPS, what the accelerometers measured stands for the change of the surge, and the surge of
each hypothesis is that by its commands alone. The bank is told what accelerations the commands
make, and which of gyro and compass turns as they say.

Sources: Page 1954 (cumulative sum); Willsky and Jones 1976 (likelihood ratios of faults); Ljung
1999, System Identification, 11.2 (recursive least squares); Bayley and Hammersley 1946 (effective
number of correlated samples).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from twin.integrity.bank import LEARN_S, RETURN_S
from twin.particulars import Particulars
from usv_kernel.arrays import alloca_f64
from usv_kernel.jit import inlined, kernel
from usv_kernel.scalar import wrap

__all__ = [
    "DRIVES",
    "DRIVES_SETTINGS",
    "HYPOTHESES",
    "drives_settings",
    "initial_drives",
    "most_evidence",
    "watch_commands",
]

Array = NDArray[np.float64]

(
    SOUND,
    REVERSED,
    STEERING_REVERSED,
    THRUST_REVERSED,
    SWAPPED,
    LEFT_DEAD,
    RIGHT_DEAD,
    UNKNOWN,
) = range(8)

EFFECTS = np.array(
    [
        # thrust of left, right; steering of left, right; difference of thrust of left, right
        [[1.0, 1.0], [1.0, 1.0], [1.0, -1.0]],
        [[-1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0]],
        [[1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]],
        [[-1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]],
        [[1.0, 1.0], [1.0, 1.0], [-1.0, 1.0]],
        [[0.0, 1.0], [0.0, 1.0], [0.0, -1.0]],
        [[1.0, 0.0], [1.0, 0.0], [1.0, 0.0]],
        [[0.0, 0.0], [0.0, 0.0], [0.0, 0.0]],
    ]
)
"""Factors of the sides in what a boat makes of its commands; the last makes anything."""

HYPOTHESES = len(EFFECTS)

YAW, SURGE = range(2)

TERMS = 6

STEP = 0.35
"""Length of a step, in lengths over nominal speed: in shorter ones waves hide what commands do, in
longer ones drag answers."""

STEP_MIN_S = 0.9
"""A step is no shorter."""

WARM_UP_STEPS = 35.0
"""Number of steps before the first decision."""

DECISION_LOG_RATIO = 16.0
"""Log-likelihood ratio at which a hypothesis comes into force: a false alarm of 1e-7."""

STEPS_MIN = 3.0
"""Least number of steps for a decision: a faulty sensor spoils one or two before its exclusion."""

CUSUM_DRIFT = 0.5
"""Drift of the cumulative sum of log-likelihood ratios, per step (Page 1954)."""

LEARN_LOG_RATIO_MAX = 1.0
"""Log-likelihood ratio above which coefficients are not adapted to a possible fault."""

DEGREES_OF_FREEDOM = 10.0
"""Degrees of freedom of Student's t: waves come in groups."""

MODEL_ERROR = 0.25
"""Standard deviation of what each term leaves out, as a share of it."""

UNKNOWN_SD = 0.7
"""Standard deviation of the drive under unknown commands, in nominal drives."""

MEMORY_STEPS = 150.0
"""Steps over which coefficients and residuals are learned (forgetting factor)."""

RESIDUAL_SD_MIN = 0.009
"""Least standard deviation of the residuals, nominal units."""

RESIDUAL_MAX_SD = 3.0
"""Residual, in standard deviations, at which learning clips it (Huber)."""

SHAFT_MAX = 20.0
ANGLE_MAX = 7.0
"""Limits of a possible command: shaft speed in nominal shaft speeds, drive angle in rad."""

IDLE = 0.1
"""A boat lies idle below this drive, yaw rate and surge, nominal units."""

MOTION_MAX = 3.0
"""No boat turns or moves faster, in nominal units."""

DRIVES = np.dtype(
    [
        ("theta", "f8", (2, TERMS)),  # coefficients of yaw and surge
        ("P", "f8", (2, TERMS, TERMS)),  # their covariances
        ("variance", "f8", 2),  # of the residuals
        ("product", "f8", 2),  # mean of a whitened residual times the one before
        ("residual", "f8", 2),  # the last one, whitened
        ("drive", "f8", 4),  # thrust of left and right, and its steering part, after the lags
        ("sum", "f8", 4),  # integral over the step, s; then its mean
        ("span", "f8"),  # time since the step began, s; below 0 there is none
        ("begin", "f8", 2),  # yaw rate and surge when it began
        ("sway", "f8"),  # sway then
        ("known", "f8"),  # how long the motion has been known, s
        ("steps", "f8"),  # steps weighed
        ("evidence", "f8", HYPOTHESES),
        ("hypothesis", "f8"),  # the one in force
        ("since", "f8"),  # clock at which it came into force, s
        ("impossible", "f8"),  # time for which commands are still left out, s
        ("trusted", "f8", 4),  # last command before anything was at odds
        ("before", "f8", 4),  # the one of the step after
        ("drift", "f8", 2),  # leaky sums of sway times yaw rate and of its square
        ("gained", "f8", 2),  # integrals of the specific forces over the step, m/s ...
        ("gained_s", "f8"),  # ... and the time that they were measured, s
        ("surges", "f8", HYPOTHESES),  # surge by the commands alone, as each hypothesis says
        ("force_var", "f8", 2),  # variance of the forces less those by the commands
        ("push", "f8", 2),  # what the commands made in the last step, forward and to starboard
        ("push_var", "f8", 2),  # variances of that
        ("excess", "f8", 2),  # what the accelerometers measured more
        ("length", "f8"),  # how long it was, s
        ("said", "f8"),  # 1 where these are new
        ("yaw", "f8"),  # yaw rate by the commands alone
        ("yaw_var", "f8"),  # variance of what it is wrong by
        ("headings", "f8", 2),  # by gyro and by compass when the step began, rad
        ("yaw_witness", "f8"),  # log-likelihood of the turns by compass over that of those by gyro
    ]
)
"""What the checks of the commands remember; nominal units where none are stated."""

DRIVES_SETTINGS = np.dtype(
    [
        ("speed", "f8"),  # nominal, m/s
        ("time", "f8"),  # length over nominal speed, s
        ("shaft_speed", "f8"),  # nominal, rev/s
        ("lag", "f8"),  # of shafts and drives, s
        ("sides", "f8"),  # 1 for a thruster on each side, else 0
    ]
)
"""What they are given of a boat."""


def drives_settings(particulars: Particulars) -> Array:
    """Return what the checks of the commands are given, in the order of DRIVES_SETTINGS."""
    return np.array(
        [
            particulars.speed,
            particulars.length / particulars.speed,
            particulars.shaft_speed,
            max(particulars.shaft_lag, particulars.steer_lag, 0.05),
            particulars.steering != "rudder" and not particulars.tanker,
        ]
    )


def initial_drives(particulars: Particulars) -> Array:
    """Return the memory of checks that have seen nothing, with the priors of any boat.

    A boat reaches its nominal speed within one to three lengths; half of its drag is linear.
    """
    memory = np.zeros(DRIVES.itemsize // 8)
    drives = memory.view(DRIVES)[0]
    length = max(STEP, STEP_MIN_S / (particulars.length / particulars.speed))
    push = 0.4 * length
    drives["theta"][YAW, [0, 3]] = -0.3 * length, push
    drives["theta"][SURGE, [0, 1, 2, 4]] = -0.5 * push, -0.5 * push, push, 1.3 * length
    yaw = np.array([0.5, 0.5, 1.0, 1.2, 0.4, 0.02]) * length
    surge = np.array([0.4, 0.4, 0.6, 1.0, 0.4, 1e-6]) * length
    drives["P"] = np.array([np.diag(yaw**2), np.diag(surge**2)])
    drives["variance"], drives["force_var"], drives["yaw_var"] = 0.02**2, 0.1**2, 0.1**2
    drives["span"] = -1.0
    return memory


@inlined
def _limited(motion):
    """Return a motion that a boat can have."""
    return min(max(motion, -MOTION_MAX), MOTION_MAX)


@inlined
def _write_row(row, axis, h, yaw, surge, sway, drives, given):
    """Write the regressors of an axis under a hypothesis."""
    mean = drives.sum
    row[0], row[1], row[5] = yaw, yaw * abs(yaw), 1.0
    if axis == YAW:
        difference = EFFECTS[h, 2, 0] * mean[0] + EFFECTS[h, 2, 1] * mean[1]
        row[2] = EFFECTS[h, 1, 0] * mean[2] + EFFECTS[h, 1, 1] * mean[3]
        row[3], row[4] = difference * given.sides, surge * sway
    else:
        row[0], row[1], row[5] = surge, surge * abs(surge), 0.0
        row[2] = EFFECTS[h, 0, 0] * mean[0] + EFFECTS[h, 0, 1] * mean[1]
        row[3], row[4] = yaw * yaw, sway * yaw


@inlined
def _change(drives, axis, row):
    """Return the change of an axis by regressors."""
    change = 0.0
    for i in range(TERMS):
        change += row[i] * drives.theta[axis, i]
    return change


@inlined
def _doubt(drives, axis, row):
    """Return the variance of the change of an axis by errors of its coefficients."""
    total = 0.0
    for i in range(TERMS):
        part = 0.0
        for j in range(TERMS):
            part += drives.P[axis, i, j] * row[j]
        total += row[i] * part
    return total


@inlined
def _spread(drives, axis, h, row, given):
    """Return the variance of the change of an axis by a hypothesis."""
    S, theta = drives.variance[axis] + _doubt(drives, axis, row), drives.theta[axis]
    for i in range(TERMS):
        S += (MODEL_ERROR * row[i] * theta[i]) ** 2
    if h == UNKNOWN:
        size = theta[2] * theta[2]
        if axis == YAW:
            size = 0.25 * size + given.sides * theta[3] * theta[3]
        S += UNKNOWN_SD * UNKNOWN_SD * size
    return S


@inlined
def _log_likelihood(error, S):
    """Return the logarithm of Student's density, but for a constant."""
    ratio = error * error / (S * DEGREES_OF_FREEDOM)
    return -0.5 * math.log(S) - 0.5 * (DEGREES_OF_FREEDOM + 1.0) * math.log(1.0 + ratio)


@inlined
def _weight(drives, axis):
    """Return the effective share of independent residuals, by their lag-one correlation."""
    r = min(max(drives.product[axis], 0.0), 0.9)
    return (1.0 - r) / (1.0 + r)


@kernel
def _learn(drives, axis, h, change, sway, given):
    """Learn from the change of an axis under a hypothesis."""
    row, gain, P = alloca_f64(TERMS), alloca_f64(TERMS), drives.P[axis]
    _write_row(row, axis, h, drives.begin[YAW], drives.begin[SURGE], sway, drives, given)
    S = drives.variance[axis]
    for i in range(TERMS):
        gain[i] = 0.0
        for j in range(TERMS):
            gain[i] += P[i, j] * row[j]
        S += row[i] * gain[i]
    error = change - _change(drives, axis, row)
    # an error of many deviations counts less
    left = max(S, error * error / RESIDUAL_MAX_SD**2)
    for i in range(TERMS):
        drives.theta[axis, i] += gain[i] * error / left
        for j in range(TERMS):
            P[i, j] -= gain[i] * gain[j] / left
    for i in range(TERMS):
        P[i, i] *= 1.0 + 1.0 / MEMORY_STEPS
    share = 1.0 / min(max(drives.steps, 4.0), MEMORY_STEPS)
    excess = min(error * error, RESIDUAL_MAX_SD**2 * S) - S
    variance = drives.variance[axis] + share * excess
    drives.variance[axis] = max(variance, RESIDUAL_SD_MIN**2)
    w = min(max(error / math.sqrt(S), -RESIDUAL_MAX_SD), RESIDUAL_MAX_SD)
    drives.product[axis] += share * (w * drives.residual[axis] - drives.product[axis])
    drives.residual[axis] = w


@inlined
def most_evidence(drives):
    """Return the evidence for the likeliest hypothesis but the one in force."""
    most = 0.0
    for h in range(HYPOTHESES):
        most = max(most, drives.evidence[h])
    return most


@inlined
def _put_in_force(drives, h, now):
    """Put a hypothesis in force: its model of the commands is used from now on."""
    drives.hypothesis, drives.since = h, now
    for k in range(HYPOTHESES):
        drives.evidence[k] = 0.0
        drives.surges[k] = drives.surges[h]


@kernel
def _write_likelihoods(
    drives, changes, bias_var, turned, sway, axes, has_gps, given, by_yaw, by_all
):
    """Write the log-likelihood of a step by each hypothesis: of yaw alone, and of all."""
    row = alloca_f64(TERMS)
    for h in range(HYPOTHESES):
        u, total = drives.begin[SURGE] if has_gps else drives.surges[h], 0.0
        for axis in range(2):
            _write_row(row, axis, h, drives.begin[YAW], u, sway, drives, given)
            change = _change(drives, axis, row)
            if axis < axes:
                S = _spread(drives, axis, h, row, given)
                if axis == SURGE and not has_gps:
                    S += bias_var
                total += _weight(drives, axis) * _log_likelihood(changes[axis] - change, S)
            if axis == YAW:
                by_yaw[h] = total
            elif not has_gps:
                if axes > SURGE:
                    # to starboard accelerometers measure the turn at the surge of the hypothesis
                    error = changes[2] - u * turned
                    total += _log_likelihood(
                        error, max(drives.force_var[1], RESIDUAL_SD_MIN**2) + bias_var
                    )
                drives.surges[h] = _limited(u + change)
        by_all[h] = total


@kernel
def _add_evidence(drives, changes, bias_var, turned, sway, axes, has_gps, now, given):
    """Add the evidence of a step, and learn from it.

    ``changes`` are those of yaw rate and surge, and what the accelerometers measured to starboard;
    ``bias_var`` is the variance of what their bias adds to that; ``turned`` is the change of the
    heading, rad.
    """
    force, trained = int(drives.hypothesis), drives.steps > WARM_UP_STEPS
    by_yaw, by_all = alloca_f64(HYPOTHESES), alloca_f64(HYPOTHESES)
    _write_likelihoods(
        drives, changes, bias_var, turned, sway, axes, has_gps, given, by_yaw, by_all
    )
    strongest = force
    if trained:
        for h in range(HYPOTHESES):
            if h == force or (given.sides == 0.0 and SWAPPED <= h <= RIGHT_DEAD):
                drives.evidence[h] = 0.0
            else:
                # without GPS, accelerometers at fault would be commands that make anything
                more = by_all[h] - by_all[force]
                if h == UNKNOWN and not has_gps:
                    more = by_yaw[h] - by_yaw[force]
                more = min(more, DECISION_LOG_RATIO / STEPS_MIN) - CUSUM_DRIFT
                drives.evidence[h] = max(drives.evidence[h] + more, 0.0)
            if drives.evidence[h] == 0.0:
                drives.surges[h] = drives.surges[force]
            if drives.evidence[h] > drives.evidence[strongest]:
                strongest = h
        if drives.evidence[strongest] > DECISION_LOG_RATIO:
            _put_in_force(drives, strongest, now)
        elif force != SOUND and now - drives.since > LEARN_S:
            _put_in_force(drives, SOUND, now)
            drives.steps = 0.0
    suspected = most_evidence(drives) > LEARN_LOG_RATIO_MAX
    force = int(drives.hypothesis)
    known = force in (SOUND, LEFT_DEAD, RIGHT_DEAD)
    if has_gps and known and not (trained and suspected):
        drives.steps += 1.0
        for axis in range(2):
            _learn(drives, axis, force, changes[axis], sway, given)
    return suspected


@kernel
def _compare_turns(drives, gyro, motion, surge, sway, span, h, has_gps, given):
    """Compare the turns by gyro and by compass with that by the commands alone.

    ``gyro`` is the yaw rate at the end of the step.
    """
    before, row = drives.yaw, alloca_f64(TERMS)
    _write_row(row, YAW, h, before, surge, sway, drives, given)
    drives.yaw = _limited(drives.yaw + _change(drives, YAW, row))
    said, S = 0.5 * (before + drives.yaw), max(drives.yaw_var, RESIDUAL_SD_MIN**2)
    by_compass = wrap(motion[4] - drives.headings[1]) / span * given.time - said
    by_gyro = wrap(motion[3] - drives.headings[0]) / span * given.time - said
    drives.yaw_witness += _log_likelihood(by_compass, S) - _log_likelihood(by_gyro, S)
    if has_gps:
        error = gyro - drives.yaw
        drives.yaw_var += span / LEARN_S * (error * error - drives.yaw_var)
        drives.yaw += span / LEARN_S * error


@kernel
def _write_accelerations(drives, surge, changes, sway, turned, span, h, has_gps, given):
    """Write the accelerations that the commands make in a step, and learn their error variance.

    ``surge`` is that by the commands alone when the step began.
    """
    row = alloca_f64(TERMS)
    _write_row(row, SURGE, h, drives.begin[YAW], surge, sway, drives, given)
    share, doubt = span / LEARN_S, _doubt(drives, SURGE, row)
    drives.push[0], drives.push[1] = _change(drives, SURGE, row), surge * turned
    for axis in range(2):
        excess = changes[1 + axis] - drives.push[axis]
        drives.excess[axis] = excess
        drives.push_var[axis] = max(drives.force_var[axis], RESIDUAL_SD_MIN**2)
        if has_gps:
            drives.force_var[axis] += share * (excess * excess - drives.force_var[axis])
    drives.push_var[0] += doubt
    drives.length, drives.said = span, 1.0


@kernel
def _follow(drives, yaw, surge, sway, span, trained, given):
    """Correct the motion by the commands alone towards the true one; learn the sway of turns."""
    fade = 1.0 - 1.0 / MEMORY_STEPS
    drives.drift[0] = fade * drives.drift[0] + sway * yaw
    drives.drift[1] = fade * drives.drift[1] + yaw * yaw
    if not trained:
        drives.yaw = yaw
    h = int(drives.hypothesis)
    own = surge
    if trained:
        row = alloca_f64(TERMS)
        _write_row(row, SURGE, h, drives.begin[YAW], drives.surges[h], sway, drives, given)
        own = drives.surges[h] + _change(drives, SURGE, row)
        own = _limited(own + span / LEARN_S * (surge - own))
    for k in range(HYPOTHESES):
        drives.surges[k] = own


@inlined
def _is_idle(drives, yaw, surge):
    """Return whether neither drive nor motion exceeded :data:`IDLE` in a step.

    Nothing is learned then: the residuals would fall to their least.
    """
    drive = 0.0
    for i in range(4):
        drive += abs(drives.sum[i])
    return drive < IDLE and abs(yaw) < IDLE and abs(surge) < IDLE


@kernel
def _end_step(drives, motion, doubted, has_gps, now, given):
    """Weigh a step that has ended; return whether the commands explain it."""
    span, h, T, U = drives.span, int(drives.hypothesis), given.time, given.speed
    for i in range(4):
        drives.sum[i] /= span
    yaw, surge, sway = motion[0] * T, motion[1] / U, 0.5 * (motion[2] / U + drives.sway)
    turn = 0.5 * (yaw + drives.begin[YAW])
    if not has_gps:
        # unknown: it goes with the yaw rate
        sway = drives.drift[0] / (drives.drift[1] + IDLE * IDLE) * turn
    turned, measured = turn * span / T, drives.gained_s > 0.5 * span
    scale = span / max(drives.gained_s, 1e-9) / U
    forces = (
        drives.gained[0] * scale + sway * turned,
        drives.gained[1] * scale,
    )
    change = surge - drives.begin[SURGE] if has_gps else forces[0]
    changes = (yaw - drives.begin[YAW], change, forces[1])
    trained, own = drives.steps > WARM_UP_STEPS, drives.surges[h]
    suspected = True
    if not doubted:
        drives.yaw_witness = 0.0
    if not doubted and not _is_idle(drives, yaw, surge):
        axes = 2 if has_gps or measured else 1
        bias_var = motion[5] * (span / U) ** 2
        suspected = _add_evidence(
            drives, changes, bias_var, turned, sway, axes, has_gps, now, given
        )
    if int(drives.hypothesis) == h:
        at = drives.begin[SURGE] if has_gps else own
        if trained:
            _compare_turns(drives, yaw, motion, at, sway, span, h, has_gps and not doubted, given)
        if measured:
            ahead = (changes[0], forces[0], forces[1])
            _write_accelerations(
                drives, own, ahead, sway, turned, span, h, has_gps and not doubted, given
            )
    if has_gps and not doubted:
        _follow(drives, yaw, surge, sway, span, trained, given)
    return not suspected and drives.hypothesis == SOUND


@inlined
def _begin_step(drives, motion, given):
    """Begin a step at a motion."""
    drives.span = drives.gained[0] = drives.gained[1] = drives.gained_s = 0.0
    for i in range(4):
        drives.sum[i] = 0.0
    drives.begin[YAW], drives.begin[SURGE] = motion[0] * given.time, motion[1] / given.speed
    drives.sway = motion[2] / given.speed
    drives.headings[0], drives.headings[1] = motion[3], motion[4]


@kernel
def watch_commands(dt, cmd, motion, force, known, doubted, has_gps, now, drives, given):
    """Take a row.

    Parameters
    ----------
    dt : float
        Time since the row before, s.
    cmd : ndarray, shape (4,)
        Command in force since then.
    motion : tuple of 6 floats
        Yaw rate, surge and sway over the ground, rad/s and m/s, heading without compass and heading
        without gyro, rad, and the variance of the bias of the accelerometers, (m/s2)2.
    force : tuple of 2 floats
        Specific forces forward and to starboard less their biases, m/s2; NaN where there are none.
    known, doubted, has_gps : bool
        Whether the motion is measured; whether its sensors contradict each other, so that only the
        witnesses take the row; whether the velocity is measured.
    now : float
        Clock, s.
    drives, given : record
        ``DRIVES``, advanced; ``DRIVES_SETTINGS``.
    """
    left, right = cmd[0] / given.shaft_speed, cmd[1] / given.shaft_speed
    possible = max(abs(left), abs(right)) < SHAFT_MAX and max(abs(cmd[2]), abs(cmd[3])) < ANGLE_MAX
    drives.impossible = max(drives.impossible - dt, 0.0) if possible else RETURN_S
    drives.known = drives.known + dt if known else 0.0
    if not possible:
        drives.span = -1.0
        return
    length = max(STEP * given.time, STEP_MIN_S)
    if drives.known <= RETURN_S:
        drives.span = -1.0
    elif drives.span < 0.0:
        _begin_step(drives, motion, given)
    elif drives.span >= length - 1e-6:
        if _end_step(drives, motion, doubted, has_gps, now, given):
            for i in range(4):
                drives.trusted[i] = drives.before[i]
                drives.before[i] = cmd[i]
        _begin_step(drives, motion, given)
    share = 1.0 - math.exp(-dt / given.lag)
    for side in range(2):
        speed = left if side == 0 else right
        thrust, angle = 0.5 * speed * abs(speed), cmd[2 + side]
        drives.drive[side] += share * (thrust * math.cos(angle) - drives.drive[side])
        drives.drive[2 + side] += share * (thrust * math.sin(angle) - drives.drive[2 + side])
    for i in range(4):
        drives.sum[i] += dt * drives.drive[i]
    if drives.span >= 0.0:
        drives.span += dt
        if not math.isnan(force[0]):
            drives.gained[0] += dt * force[0]
            drives.gained[1] += dt * force[1]
            drives.gained_s += dt
