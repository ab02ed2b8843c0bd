"""Kernel that holds the commands against the motion that they should make.

A linear model of the change of yaw rate and surge in a step of a third of a boat length is learned
online. What it would say of commands reversed, or with sides swapped, says what is wrong with them.
"""

from __future__ import annotations

import math

import numpy as np

from twin.channels import R, U
from twin.health.state import (
    ABSENT,
    COMMAND,
    COMMAND_TERMS,
    DOUBTFUL,
    DRIVE,
    EXCLUDED,
    HYPOTHESES,
    IMPOSSIBLE,
    NO_ANSWER,
    NO_REASON,
    OK,
    WRONG_SIGN,
)
from usv_kernel.jit import inlined, kernel

__all__ = ["CHANGED", "check_commands"]

YAW, SURGE = range(2)

SIGNS = np.array(
    [
        [1.0, 1.0, 1.0],  # as given
        [-1.0, -1.0, -1.0],  # all reversed
        [1.0, -1.0, 1.0],  # steering reversed
        [-1.0, 1.0, -1.0],  # thrust reversed
        [1.0, 1.0, -1.0],  # sides swapped
    ]
)
"""What may be wrong with commands: factors of thrust, steering moment and difference of thrust."""

STEP = 0.35
"""A step, in lengths over nominal speed: shorter ones are noise, in longer ones drag answers."""

WARM_UP = 40.0
"""Steps before anything is concluded."""

MEMORY = 150.0
"""Steps over which the model is learned."""

RECENT = 4.0
"""Steps over which errors are averaged."""

FIRST_STEPS, LEVEL_STEPS = 15.0, 40.0
"""Steps until errors count for the level, as the model knows nothing yet; and over how many steps
the level is averaged."""

LEVEL_MIN = 0.004
"""Least typical error of a step, in nominal units: rounding of a filter's rates."""

ERROR_MAX = 25.0
"""Most that one step counts, in squared levels: a single wave says little."""

LEVEL_CUT, MODEL_CUT, MODEL_SHARE = 3.0, 5.0, 0.2
"""Errors above so many levels do not raise the level; above so many a step counts less."""

EXPECTED_SURGE, SURGE_WEIGHT, RIDGE = 0.04, 2.0, 1e-3
"""Expected change of surge by nominal thrust in a step, in nominal speeds; its weight in steps;
and the weight of zero for all other terms."""

ROUNDS = 3
"""Rounds of Gauss and Seidel a step: they go on from the last solution."""

AT_ODDS, AGREED, SILENT = 9.0, 4.0, 6.0
"""Mean squares of errors, in levels, above and below which commands are at odds or not; and the
former for a boat that makes way with shafts at rest."""

EXPLAINED = 0.3
"""A hypothesis explains the motion if it leaves so much of the errors."""

IDLE_SHAFTS, IDLE_SPEED = 1e-9, 0.2
"""Shafts are at rest, and a boat makes way, below and above these shares of the nominal ones."""

CHANGED = 6.0
"""What is still doubtful after so long is a boat that has changed, s."""

CALM, GIVE_IN = 2.0, 60.0
"""Excluded commands come back after so long (s): impossible ones of good numbers, others of any."""

CALM_STEPS = 2.0
"""Excluded commands come back after they explained the motion for so many steps."""

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
def _solve(fit, axis):
    """Improve the parameters of an axis by a round of Gauss and Seidel."""
    A, b, x = fit.information, fit.right, fit.params
    for i in range(COMMAND_TERMS):
        # at the nominal speed, nominal thrust and drag are equal
        weight, expected = RIDGE, 0.0
        if axis == SURGE and (i == 1 or i == 2):
            weight, expected = SURGE_WEIGHT, EXPECTED_SURGE if i == 2 else -EXPECTED_SURGE
        total = b[i] + weight * expected
        for j in range(COMMAND_TERMS):
            if j != i:
                total -= A[i, j] * x[j]
        x[i] = total / (A[i, i] + weight)


@inlined
def _regressor(axis, k, r, u, drive, signs):
    """Return regressor k of an axis."""
    if axis == YAW:
        if k == 0:
            return r
        if k == 1:
            return r * abs(r)
        if k == 2:
            return signs[1] * drive[1]
        if k == 3:
            return signs[2] * drive[2]
        if k == 4:
            return r * u
        return 1.0
    if k == 0:
        return u
    if k == 1:
        return u * abs(u)
    if k == 2:
        return signs[0] * drive[0]
    if k == 3:
        return r * r
    return 0.0  # no constant: thrust alone makes way


@inlined
def _predicted(axis, params, r, u, drive, signs):
    """Return the change of an axis in a step."""
    total = 0.0
    for k in range(COMMAND_TERMS):
        total += params[k] * _regressor(axis, k, r, u, drive, signs)
    return total


@inlined
def _learn(fit, axis, change, error, warm, health):
    """Take a step into the model of an axis."""
    level = max(fit.level, LEVEL_MIN)
    size = abs(error) if not warm else min(abs(error), LEVEL_CUT * level)
    part = 1.0 / min(max(health.steps - FIRST_STEPS, 1.0), LEVEL_STEPS)
    fit.level = math.sqrt(fit.level**2 + part * (size * size - fit.level**2))
    weight = 1.0 if not warm or abs(error) < MODEL_CUT * level else MODEL_SHARE
    fade = 1.0 - 1.0 / MEMORY
    r, u = health.motion[0], health.motion[1]
    for i in range(COMMAND_TERMS):
        f = _regressor(axis, i, r, u, health.mean_drive, SIGNS[0])
        fit.right[i] = fade * fit.right[i] + weight * f * change
        for j in range(COMMAND_TERMS):
            g = _regressor(axis, j, r, u, health.mean_drive, SIGNS[0])
            fit.information[i, j] = fade * fit.information[i, j] + weight * f * g
    for _ in range(ROUNDS):
        _solve(fit, axis)


@inlined
def _conclude(left, right, s, step, T, health, given):
    """Set the status of the commands by how well they, or others, explain the motion."""
    check = health.sensors[COMMAND]
    at_odds = health.mismatch[0]
    if check.status != EXCLUDED:
        idle = abs(left) + abs(right) < IDLE_SHAFTS and s[U] > IDLE_SPEED * given.speed
        if at_odds > (SILENT if idle else AT_ODDS):
            least = health.mismatch[1]
            for k in range(2, HYPOTHESES):
                least = min(least, health.mismatch[k])
            if least < EXPLAINED * at_odds:
                _set(health, EXCLUDED, WRONG_SIGN)
                check.calm = 0.0
            elif idle:
                _set(health, EXCLUDED, NO_ANSWER)
                check.calm = 0.0
            elif check.status == OK:
                _set(health, DOUBTFUL, NO_ANSWER)
        elif check.status == DOUBTFUL and at_odds < AGREED:
            _set(health, OK, NO_REASON)
    else:
        check.calm = check.calm + T if at_odds < AGREED else 0.0
        if check.calm > CALM_STEPS * step or health.clock - check.since > GIVE_IN:
            _set(health, OK, NO_REASON)
            health.mismatch[0] = 0.0


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
    learn = check.status != EXCLUDED and (health.mismatch[0] < AGREED or not warm or lasting)
    for k in range(HYPOTHESES):
        health.step_mismatch[k] = 0.0
    for axis in range(2):
        fit = health.fit[axis]
        change = ((r_new - r) if axis == YAW else (u_new - u)) * step / T
        error = change - _predicted(axis, fit.params, r, u, health.mean_drive, SIGNS[0])
        level = max(fit.level, LEVEL_MIN)
        for k in range(HYPOTHESES):
            other = change - _predicted(axis, fit.params, r, u, health.mean_drive, SIGNS[k])
            health.step_mismatch[k] += min((other / level) ** 2, ERROR_MAX)
        if learn:
            _learn(fit, axis, change, error, warm, health)
    health.steps += 1.0
    if check.status == OK and health.mismatch[0] < AGREED:
        for k in range(4):
            health.trusted[k] = health.before[k]
            health.before[k] = cmd[k]
    for k in range(HYPOTHESES):
        health.mismatch[k] += 1.0 / RECENT * (0.5 * health.step_mismatch[k] - health.mismatch[k])
    for k in range(DRIVE):
        health.drive_sum[k] = 0.0
    health.step_time = 0.0
    health.motion[0], health.motion[1] = r_new, u_new
    if warm and check.reason != IMPOSSIBLE:
        _conclude(left, right, s, step, T, health, given)


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


@kernel
def check_commands(dt, cmd, s, ready, health, given):
    """Hold commands against yaw rate and surge; note their status."""
    n0 = max(given.shaft_speed, 1e-6)
    left, right = cmd[0] / n0, cmd[1] / n0
    if not _are_possible(dt, left, right, cmd, health) or not ready:
        return
    a, b = left * abs(left), right * abs(right)
    share = 1.0 - math.exp(-dt / max(given.lag, LAG_MIN))
    targets = (
        0.5 * (a * math.cos(cmd[2]) + b * math.cos(cmd[3])),
        0.5 * (a * math.sin(cmd[2]) + b * math.sin(cmd[3])),
        0.5 * (a * math.cos(cmd[2]) - b * math.cos(cmd[3])),
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
    step = STEP * given.time_scale
    if health.step_time >= step:
        _end_step(left, right, cmd, s, step, health, given)
