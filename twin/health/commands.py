"""Kernel that holds the commands against the motion that they should make.

A linear model of the change of yaw rate and surge in a step of about a second is learned online.
What it would say of commands reversed, with sides swapped or with one thruster dead, says what is
wrong with them.
"""

from __future__ import annotations

import math

import numpy as np

from twin.channels import R, U
from twin.health.evidence import CLEAR
from twin.health.state import (
    ABSENT,
    ACCELEROMETERS,
    COMMAND,
    COMMAND_TERMS,
    DOUBTFUL,
    DRIVE,
    EXCLUDED,
    HYPOTHESES,
    IMPOSSIBLE,
    NO_ANSWER,
    NO_LEFT,
    NO_REASON,
    NO_RIGHT,
    OK,
    WRONG_SIGN,
)
from usv_kernel.jit import inlined, kernel

__all__ = ["CHANGED", "check_commands"]

YAW, SURGE = range(2)

THRUST, MOMENT, DIFFERENCE = 2, 2, 3
"""Places of the commands' effects among the parameters: thrust of surge, the others of yaw."""

LEFT_THRUST, LEFT_MOMENT = 0, 2
"""Places in the drive of what the left side makes; that of the right side follows."""

EFFECTS = np.array(
    [
        # thrust of left, right; steering of left, right; difference of thrust of left, right
        [[1.0, 1.0], [1.0, 1.0], [1.0, -1.0]],  # as given
        [[-1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0]],  # all reversed
        [[1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]],  # steering reversed
        [[-1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]],  # thrust reversed
        [[1.0, 1.0], [1.0, 1.0], [-1.0, 1.0]],  # sides swapped
        [[0.0, 1.0], [0.0, 1.0], [0.0, -1.0]],  # left thruster dead
        [[1.0, 0.0], [1.0, 0.0], [1.0, 0.0]],  # right thruster dead
    ]
)
"""What may be wrong with commands: factors of the sides in what a boat makes of them."""

LEFT_DEAD = 5
"""The first of the hypotheses of a boat that has changed: a thruster does not answer."""

OF_THRUST, OF_MOMENT, OF_DIFFERENCE = range(3)
"""Kinds of effects: the second index of EFFECTS."""

STEP, STEP_MIN = 0.35, 0.9
"""A step, in lengths over nominal speed and in s: in shorter ones waves hide what commands do, in
longer ones drag answers."""

WARM_UP = 35.0
"""Steps before anything is concluded."""

RECENT = 3.0
"""Steps over which errors are averaged."""

FIRST_STEPS, LEVEL_STEPS = 8.0, 25.0
"""Steps until errors count for the level, as the model knows nothing yet; and over how many steps
the level is averaged."""

CORRELATED_STEPS = 4.0
"""So many neighbouring steps have the same error, as a wave lasts longer than a step. The
covariance of the parameters, which takes errors for white, is too small by this."""

MODEL_ERROR, MODEL_DRIVE = 0.25, 0.15
"""Share of the commands' effect that a linear model without rate limits does not explain; at least
that share of the effect of so many nominal thrusts."""

LEVEL_MIN = 0.004
"""Least typical error of a step, in nominal units: rounding of a filter's rates."""

ERROR_MAX = 25.0
"""Most that one step counts, in squared levels: a single wave says little."""

LEVEL_CUT, MODEL_CUT, MODEL_SHARE = 3.0, 5.0, 0.2
"""Errors above so many levels do not raise the level; above so many a step counts less."""

PRIOR, WALK = 1e3, 5e-5
"""Variance of a parameter before any step, and what a step adds to it, in squared levels. With
regressors of about 1 the latter makes a memory of 150 steps."""

EXPECTED_SURGE, SURGE_PRIOR = 0.115, 0.5
"""Expected change of surge by nominal thrust in a length over nominal speed, in nominal speeds; and
the variance that it begins with: forward thrust pushes forward."""

AGREED, SILENT, UNEXPLAINED = 4.0, 3.0, 15.0
"""Mean squares of errors, in levels: below the first commands agree. Above the second, a boat that
makes way with shafts at rest does not get the commands. Above the third they are doubtful whatever
explains them: high waves come in groups."""

DRIFT, EVIDENCE_MAX, SUSPECT, EXPLAINED, DECIDED = 2.0, 20.0, 12.0, 60.0, 12.0
"""Evidence for a hypothesis: the sum of what it takes off the squared errors (in levels) of the
steps, less the first number a step. A step counts up to the second number, as one wave says little.
Above the third nothing is learned, or the fault would become the model; above the fourth a
hypothesis that agrees explains the motion. The last number is clearly more than another has."""

SIGN_SURE, SIGN_KEPT = 2.5, 1.0
"""Standard deviations by which an effect must be negative to be named, and to stay so."""

AGAINST_THRUST, AGAINST_SPEED, AGAINST_TIME = 0.1, 0.3, 15.0
"""Nominal thrust and speed of a boat that goes against its thrust, and how long (s) it must: one
that brakes stops sooner, and a current is slower."""

IDLE_SHAFTS, IDLE_SPEED = 1e-9, 0.2
"""Shafts are at rest, and a boat makes way, below and above these shares of the nominal ones."""

CHANGED = 6.0
"""What is still doubtful after so long is a boat that has changed, s."""

CALM, GIVE_IN = 2.0, 60.0
"""Excluded commands come back after so long (s): impossible ones of good numbers, others of any."""

CALM_STEPS = 2.0
"""Excluded commands come back after they explained the motion for so many steps."""

KNOWN_TIME = 2.0
"""After a sensor of the motion came back, the estimated motion needs so long to be right, s."""

SHAFT_MAX, ANGLE_MAX = 20.0, 7.0
"""Commands beyond are impossible: shaft speed in nominal ones, drive angle in rad (a unit slip
to degrees is found by ``usv-twin log check``)."""

LAG_MIN = 0.05
"""Least lag of the actuators, s."""


@inlined
def _set(health, status, reason):
    """Set status and reason of the commands."""
    check = health.sensors[COMMAND]
    check.status, check.reason, check.since = status, reason, health.clock


@inlined
def _effect(kind, health, effects):
    """Return thrust, steering moment or difference of thrust of the last step."""
    first = LEFT_MOMENT if kind == OF_MOMENT else LEFT_THRUST
    drive = health.mean_drive
    return effects[kind, 0] * drive[first] + effects[kind, 1] * drive[first + 1]


@inlined
def _regressor(axis, k, health, effects):
    """Return regressor k of an axis."""
    r, u = health.motion[0], health.motion[1]
    if axis == YAW:
        if k == 0:
            return r
        if k == 1:
            return r * abs(r)
        if k == MOMENT:
            return _effect(OF_MOMENT, health, effects)
        if k == DIFFERENCE:
            return _effect(OF_DIFFERENCE, health, effects)
        if k == 4:
            return r * u
        return 1.0
    if k == 0:
        return u
    if k == 1:
        return u * abs(u)
    if k == THRUST:
        return _effect(OF_THRUST, health, effects)
    if k == 3:
        return r * r
    return 0.0  # no constant: thrust alone makes way


@inlined
def _error(axis, fit, change, effects, health):
    """Return the error of a step under a hypothesis."""
    error = change
    for i in range(COMMAND_TERMS):
        error -= fit.params[i] * _regressor(axis, i, health, effects)
    return error


@inlined
def _variance(axis, fit, health, effects):
    """Return the variance of the error of a step, in squared levels: more where all is new."""
    spread, driven = 1.0, 0.0
    for i in range(COMMAND_TERMS):
        f = _regressor(axis, i, health, effects)
        if i in (MOMENT, DIFFERENCE):
            driven += abs(fit.params[i]) * max(abs(f), MODEL_DRIVE)
        for j in range(COMMAND_TERMS):
            g = _regressor(axis, j, health, effects)
            spread += CORRELATED_STEPS * f * fit.cov[i, j] * g
    return spread + (MODEL_ERROR * driven / max(fit.level, LEVEL_MIN)) ** 2


@inlined
def _begin_fit(fit, axis, length):
    """Set the model of an axis to what is expected of any boat in a step of so many lengths."""
    for i in range(COMMAND_TERMS):
        for j in range(COMMAND_TERMS):
            fit.cov[i, j] = 0.0
        fit.cov[i, i] = PRIOR
    if axis == SURGE:
        # at the nominal speed, nominal thrust and drag are equal
        fit.cov[1, 1] = fit.cov[2, 2] = SURGE_PRIOR
        fit.params[2] = EXPECTED_SURGE * length
        fit.params[1] = -fit.params[2]


@inlined
def _learn(axis, fit, change, warm, health, effects):
    """Take a step into the model of an axis: a Kalman filter of slowly changing parameters."""
    level = max(fit.level, LEVEL_MIN)
    error = _error(axis, fit, change, effects, health)
    spread = _variance(axis, fit, health, effects)
    size = abs(error) / math.sqrt(spread)
    part = 1.0 / min(max(health.steps - FIRST_STEPS, 1.0), LEVEL_STEPS)
    capped = min(size, LEVEL_CUT * level) if warm else size
    fit.level = math.sqrt(fit.level**2 + part * (capped * capped - fit.level**2))
    if warm and size > MODEL_CUT * level:
        spread += 1.0 / MODEL_SHARE - 1.0
    for i in range(COMMAND_TERMS):
        fit.gain[i] = 0.0
        for j in range(COMMAND_TERMS):
            fit.gain[i] += fit.cov[i, j] * _regressor(axis, j, health, effects)
    for i in range(COMMAND_TERMS):
        fit.params[i] += fit.gain[i] * error / spread
        for j in range(COMMAND_TERMS):
            fit.cov[i, j] -= fit.gain[i] * fit.gain[j] / spread
        fit.cov[i, i] = min(fit.cov[i, i] + WALK, PRIOR)


@inlined
def _is_sign_wrong(T, health):
    """Return whether the boat answers to its commands the wrong way round, and did all the time.

    Steering turns it to the other side, or it goes ahead for long with its thrust astern.
    """
    check, yaw = health.sensors[COMMAND], health.fit[YAW]
    named = check.status == DOUBTFUL and check.reason == WRONG_SIGN
    certain = SIGN_KEPT if named else SIGN_SURE
    level = max(yaw.level, LEVEL_MIN)
    wrong = False
    for k in (MOMENT, DIFFERENCE):
        sd = level * math.sqrt(CORRELATED_STEPS * max(yaw.cov[k, k], 0.0))
        wrong = wrong or yaw.params[k] < -certain * sd
    thrust, u = _effect(OF_THRUST, health, EFFECTS[0]), health.motion[1]
    if check.status == EXCLUDED:
        health.against_time = 0.0
    elif thrust * u < 0.0 and abs(thrust) > AGAINST_THRUST and abs(u) > AGAINST_SPEED:
        health.against_time = min(health.against_time + T, 2.0 * AGAINST_TIME)
    else:
        health.against_time = max(health.against_time - T, 0.0)
    return wrong or health.against_time > AGAINST_TIME


@inlined
def _is_thruster_dead(health):
    """Return whether one thruster is known not to answer."""
    check = health.sensors[COMMAND]
    return check.status == DOUBTFUL and (check.reason == NO_LEFT or check.reason == NO_RIGHT)


@inlined
def _add_evidence(health):
    """Add a step to the evidence for each hypothesis, a cumulative sum (Page 1954)."""
    share = 1.0 / RECENT
    for k in range(HYPOTHESES):
        health.mismatch[k] += share * (0.5 * health.step_mismatch[k] - health.mismatch[k])
        better = min(health.step_mismatch[0] - health.step_mismatch[k], EVIDENCE_MAX)
        health.evidence[k] = min(max(health.evidence[k] + better - DRIFT, 0.0), 2.0 * EXPLAINED)
    # entry 0: for the commands as given, against the hypothesis that excluded them
    other = health.step_mismatch[int(health.hypothesis)]
    better = min(other - health.step_mismatch[0], EVIDENCE_MAX)
    health.evidence[0] = min(max(health.evidence[0] + better, 0.0), 2.0 * EXPLAINED)


@inlined
def _best_hypothesis(health):
    """Return the hypothesis with most evidence; a dead thruster must be clearly more likely."""
    best = 1
    for k in range(2, HYPOTHESES):
        more = DECIDED if k >= LEFT_DEAD and best < LEFT_DEAD else 0.0
        if health.evidence[k] > health.evidence[best] + more:
            best = k
    return best


@inlined
def _forget_evidence(health):
    """Begin again with all hypotheses."""
    for k in range(HYPOTHESES):
        health.mismatch[k] = health.evidence[k] = 0.0


@inlined
def _find_fault(idle, wrong, health):
    """Doubt or exclude commands that are in use."""
    check, at_odds = health.sensors[COMMAND], health.mismatch[0]
    best = _best_hypothesis(health)
    if _is_thruster_dead(health):
        if health.evidence[0] > EXPLAINED:
            _set(health, OK, NO_REASON)
            _forget_evidence(health)
    elif health.evidence[best] > EXPLAINED and health.mismatch[best] < AGREED:
        health.hypothesis = best
        health.evidence[0] = 0.0
        if best >= LEFT_DEAD:
            # the boat has changed: the commands are used, and the twin learns what they do now
            _set(health, DOUBTFUL, NO_LEFT if best == LEFT_DEAD else NO_RIGHT)
        else:
            _set(health, EXCLUDED, WRONG_SIGN)
    elif idle and at_odds > SILENT:
        _set(health, EXCLUDED, NO_ANSWER)
        check.calm = 0.0
    elif check.status == OK and at_odds > UNEXPLAINED:
        _set(health, DOUBTFUL, NO_ANSWER)
    elif check.status == OK and wrong:
        # learned with its sign, so the commands are used; but nobody meant it
        _set(health, DOUBTFUL, WRONG_SIGN)
    elif check.status == DOUBTFUL:
        over = at_odds < AGREED if check.reason == NO_ANSWER else not wrong
        if over:
            _set(health, OK, NO_REASON)


@inlined
def _readmit(idle, T, health):
    """Use excluded commands again once they explain the motion, or a hypothesis does not."""
    check = health.sensors[COMMAND]
    agreed = health.mismatch[0] < AGREED and not idle
    check.calm = check.calm + T if agreed else 0.0
    if check.reason == WRONG_SIGN:
        right = health.evidence[0] > EXPLAINED
    else:
        right = check.calm > CALM_STEPS * T
    if right or health.clock - check.since > GIVE_IN:
        _set(health, OK, NO_REASON)
        _forget_evidence(health)


@inlined
def _end_step(left, right, cmd, s, step, health, given):
    """Hold the step that ends against what the model says of it, and learn from it."""
    check = health.sensors[COMMAND]
    T = health.step_time
    for k in range(DRIVE):
        health.mean_drive[k] = health.drive_sum[k] / T
    r, u = health.motion[0], health.motion[1]
    r_new, u_new = s[R] / (1.0 / given.time_scale), s[U] / given.speed
    warm = health.steps > WARM_UP
    lasting = check.status == DOUBTFUL and health.clock - check.since > CHANGED
    dead = _is_thruster_dead(health)
    effective = int(health.hypothesis) if dead else 0
    agreed = health.mismatch[effective] < AGREED and (
        dead or health.evidence[_best_hypothesis(health)] < SUSPECT
    )
    learn = check.status != EXCLUDED and (agreed or not warm or lasting)
    for k in range(HYPOTHESES):
        health.step_mismatch[k] = 0.0
    for axis in range(2):
        fit = health.fit[axis]
        if health.steps == 0.0:
            _begin_fit(fit, axis, step / given.time_scale)
        change = ((r_new - r) if axis == YAW else (u_new - u)) * step / T
        level = max(fit.level, LEVEL_MIN)
        variance = _variance(axis, fit, health, EFFECTS[effective]) * level * level
        for k in range(HYPOTHESES):
            error = _error(axis, fit, change, EFFECTS[k], health)
            health.step_mismatch[k] += min(error * error / variance, ERROR_MAX)
        if learn:
            _learn(axis, fit, change, warm, health, EFFECTS[effective])
    health.steps += 1.0
    if check.status == OK and agreed:
        for k in range(4):
            health.trusted[k] = health.before[k]
            health.before[k] = cmd[k]
    _add_evidence(health)
    wrong = _is_sign_wrong(T, health)
    for k in range(DRIVE):
        health.drive_sum[k] = 0.0
    health.step_time = 0.0
    health.motion[0], health.motion[1] = r_new, u_new
    if not warm or check.reason == IMPOSSIBLE:
        return
    idle = abs(left) + abs(right) < IDLE_SHAFTS and s[U] > IDLE_SPEED * given.speed
    if check.status != EXCLUDED:
        _find_fault(idle, wrong, health)
    else:
        _readmit(idle, T, health)


@inlined
def _are_possible(dt, left, right, cmd, health):
    """Return whether the commands are possible, and set their status accordingly."""
    check = health.sensors[COMMAND]
    check.age = 0.0
    if check.status == ABSENT:
        _set(health, OK, check.reason)
    possible = (
        abs(left) < SHAFT_MAX
        and abs(right) < SHAFT_MAX
        and abs(cmd[2]) < ANGLE_MAX
        and abs(cmd[3]) < ANGLE_MAX
    )
    if not possible:
        if check.status != EXCLUDED:
            check.since = health.clock
        check.status, check.reason, check.calm = EXCLUDED, IMPOSSIBLE, 0.0
        health.step_time = -1.0
    elif check.reason == IMPOSSIBLE:
        check.calm += dt
        if check.calm > CALM:
            _set(health, OK, NO_REASON)
    return possible


@inlined
def _is_motion_known(dt, health):
    """Return whether all that says how the boat moves agrees, and has been in use for a while."""
    known = (
        abs(health.heading_sum) <= CLEAR * health.heading_level
        and abs(health.velocity_sum[0]) <= CLEAR * health.velocity_level
        and abs(health.velocity_sum[1]) <= CLEAR * health.velocity_level
    )
    if not known:
        return False
    for sensor in range(ACCELEROMETERS):
        check = health.sensors[sensor]
        never = check.status == ABSENT and check.interval == 0.0
        known = known and (check.status == OK or never)
    health.known_time = health.known_time + dt if known else 0.0
    return health.known_time > KNOWN_TIME


@kernel
def check_commands(dt, cmd, s, ready, health, given):
    """Hold commands against yaw rate and surge; note their status."""
    n0 = max(given.shaft_speed, 1e-6)
    left, right = cmd[0] / n0, cmd[1] / n0
    if not _are_possible(dt, left, right, cmd, health) or not ready:
        return
    if not _is_motion_known(dt, health):
        health.step_time = -1.0
        return
    a, b = left * abs(left), right * abs(right)
    share = 1.0 - math.exp(-dt / max(given.lag, LAG_MIN))
    targets = (
        0.5 * a * math.cos(cmd[2]),
        0.5 * b * math.cos(cmd[3]),
        0.5 * a * math.sin(cmd[2]),
        0.5 * b * math.sin(cmd[3]),
    )
    turn = 1.0 / given.time_scale
    if health.step_time < 0.0:
        health.step_time = 0.0
        for k in range(DRIVE):
            health.drive_sum[k] = 0.0
        health.motion[0], health.motion[1] = s[R] / turn, s[U] / given.speed
    for k in range(DRIVE):
        health.drive[k] += share * (targets[k] - health.drive[k])
        health.drive_sum[k] += health.drive[k] * dt
    health.step_time += dt
    step = max(STEP * given.time_scale, STEP_MIN)
    if health.step_time >= step:
        _end_step(left, right, cmd, s, step, health, given)
