"""Kernel that holds the commands against the motion that they should make.

A linear model of the change of yaw rate and surge in a step of a third of a boat length is learned
online. What it would say of commands reversed, or with sides swapped, says what is wrong with them.
"""

from __future__ import annotations

import math

from twin.channels import R, U
from twin.health.state import (
    ABSENT,
    COMMAND,
    COMMAND_TERMS,
    DOUBTFUL,
    DRIVE,
    EXCLUDED,
    IMPOSSIBLE,
    NO_ANSWER,
    NO_REASON,
    OK,
    WRONG_SIGN,
)
from usv_kernel.jit import inlined, kernel

__all__ = ["check_commands"]

WARM_UP = 40.0
"""Steps before anything is judged."""

MEMORY = 150.0
"""Steps over which the model is learned."""

RECENT = 4.0
"""Steps over which errors are averaged."""

SETTLE = 15.0
"""Steps until errors count."""

SURGE = 0.04
"""Expected change of surge by the nominal thrust in a step, in nominal speeds."""

AT_ODDS, AGREED, SILENT = 9.0, 4.0, 6.0
"""Mean squares of errors, in levels, above and below which commands are at odds or not."""

DECIDED = 6.0
"""What is still doubtful after so long is a boat that has changed, s."""

GIVE_IN = 60.0


@inlined
def _solve(axis, surge):
    """Improve the parameters of an axis by a round of Gauss and Seidel."""
    A, b, x = axis.information, axis.right, axis.params
    for i in range(COMMAND_TERMS):
        # at the nominal speed, nominal thrust and drag are equal
        weight, expected = 1e-3, 0.0
        if surge and (i == 1 or i == 2):
            weight, expected = 2.0, SURGE if i == 2 else -SURGE
        total = b[i] + weight * expected
        for j in range(COMMAND_TERMS):
            if j != i:
                total -= A[i, j] * x[j]
        x[i] = total / (A[i, i] + weight)


@inlined
def _features(axis, r, u, thrust, moment, difference, k):
    """Return regressor k of an axis."""
    if axis == 0:
        if k == 0:
            return r
        if k == 1:
            return r * abs(r)
        if k == 2:
            return moment
        if k == 3:
            return difference
        if k == 4:
            return r * u
        return 1.0
    if k == 0:
        return u
    if k == 1:
        return u * abs(u)
    if k == 2:
        return thrust
    if k == 3:
        return r * r
    return 0.0  # no constant: thrust alone makes way


@inlined
def _predicted(axis, params, r, u, thrust, moment, difference):
    total = 0.0
    for k in range(COMMAND_TERMS):
        total += params[k] * _features(axis, r, u, thrust, moment, difference, k)
    return total


@kernel
def check_commands(dt, cmd, s, ready, health, given):
    """Hold commands against yaw rate and surge; note their status."""
    check = health.sensors[COMMAND]
    n0 = max(given.shaft_speed, 1e-6)
    left, right = cmd[0] / n0, cmd[1] / n0
    sane = abs(left) < 20.0 and abs(right) < 20.0 and abs(cmd[2]) < 7.0 and abs(cmd[3]) < 7.0
    check.age = 0.0
    if check.status == ABSENT:
        check.status = OK
        check.since = health.clock
    if not sane:
        if check.status != EXCLUDED:
            check.since = health.clock
        check.status, check.reason, check.calm = EXCLUDED, IMPOSSIBLE, 0.0
        health.step_time = -1.0
        return
    if check.reason == IMPOSSIBLE:
        check.calm += dt
        if check.calm > 2.0:
            check.status, check.reason, check.since = OK, NO_REASON, health.clock
    if not ready:
        return
    a, b = left * abs(left), right * abs(right)
    share = 1.0 - math.exp(-dt / max(given.lag, 0.05))
    targets = (
        0.5 * (a * math.cos(cmd[2]) + b * math.cos(cmd[3])),
        0.5 * (a * math.sin(cmd[2]) + b * math.sin(cmd[3])),
        0.5 * (a * math.cos(cmd[2]) - b * math.cos(cmd[3])),
    )
    turn = 1.0 / given.time_scale
    if health.step_time < 0.0:
        health.step_time = 0.0
        for k in range(DRIVE):
            health.driven[k] = 0.0
        health.motion[0], health.motion[1] = s[R] / turn, s[U] / given.speed
    for k in range(DRIVE):
        health.drive[k] += share * (targets[k] - health.drive[k])
        health.driven[k] += health.drive[k] * dt
    health.step_time += dt
    step = 0.35 * given.time_scale
    if health.step_time < step:
        return
    T = health.step_time
    thrust, moment, difference = health.driven[0] / T, health.driven[1] / T, health.driven[2] / T
    r, u = health.motion[0], health.motion[1]
    r_new, u_new = s[R] / turn, s[U] / given.speed
    mixed, reversed_, steered, doubly, swapped, excited = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    warm = health.steps > WARM_UP
    for axis in range(2):
        fit = health.fit[axis]
        change = ((r_new - r) if axis == 0 else (u_new - u)) * step / T
        error = change - _predicted(axis, fit.params, r, u, thrust, moment, difference)
        other = change - _predicted(axis, fit.params, r, u, -thrust, -moment, -difference)
        turned = change - _predicted(axis, fit.params, r, u, thrust, -moment, difference)
        both = change - _predicted(axis, fit.params, r, u, -thrust, moment, -difference)
        sides = change - _predicted(axis, fit.params, r, u, thrust, moment, -difference)
        level = max(fit.level, 0.004)
        mixed += min((error / level) ** 2, 25.0)
        reversed_ += min((other / level) ** 2, 25.0)
        steered += min((turned / level) ** 2, 25.0)
        doubly += min((both / level) ** 2, 25.0)
        swapped += min((sides / level) ** 2, 25.0)
        excited += min(((error - other) / level) ** 2, 25.0)
        lasting = check.status == DOUBTFUL and health.clock - check.since > DECIDED
        learn = check.status != EXCLUDED and (health.at_odds < AGREED or not warm or lasting)
        if learn:
            size = abs(error) if not warm else min(abs(error), 3.0 * level)
            part = 1.0 / min(max(health.steps - SETTLE, 1.0), 40.0)
            fit.level = math.sqrt(fit.level**2 + part * (size * size - fit.level**2))
            weight = 1.0 if not warm or abs(error) < 5.0 * level else 0.2
            fade = 1.0 - 1.0 / MEMORY
            for i in range(COMMAND_TERMS):
                f = _features(axis, r, u, thrust, moment, difference, i)
                fit.right[i] = fade * fit.right[i] + weight * f * change
                for j in range(COMMAND_TERMS):
                    g = _features(axis, r, u, thrust, moment, difference, j)
                    fit.information[i, j] = fade * fit.information[i, j] + weight * f * g
            for _ in range(3):
                _solve(fit, axis == 1)
    health.steps += 1.0
    if check.status == OK and health.at_odds < AGREED:
        for k in range(4):
            health.trusted[k] = health.before[k]
            health.before[k] = cmd[k]
    share = 1.0 / RECENT
    health.at_odds += share * (0.5 * mixed - health.at_odds)
    health.if_reversed += share * (0.5 * reversed_ - health.if_reversed)
    health.if_steered += share * (0.5 * steered - health.if_steered)
    health.if_both += share * (0.5 * doubly - health.if_both)
    health.if_swapped += share * (0.5 * swapped - health.if_swapped)
    health.excited += share * (0.5 * excited - health.excited)
    health.driven[0] = health.driven[1] = health.driven[2] = 0.0
    health.step_time = 0.0
    health.motion[0], health.motion[1] = r_new, u_new
    if not warm or check.reason == IMPOSSIBLE:
        return
    if check.status != EXCLUDED:
        idle = abs(left) + abs(right) < 1e-9 and s[U] > 0.2 * given.speed
        if health.at_odds > (SILENT if idle else AT_ODDS):
            least = min(
                health.if_reversed, health.if_steered, health.if_both, health.if_swapped
            )
            sign = least < 0.3 * health.at_odds
            silent = idle
            if sign or silent:
                check.status = EXCLUDED
                check.reason = WRONG_SIGN if sign else NO_ANSWER
                check.since = health.clock
                check.calm = 0.0
            elif check.status == OK:
                check.status, check.reason, check.since = DOUBTFUL, NO_ANSWER, health.clock
        elif check.status == DOUBTFUL and health.at_odds < AGREED:
            check.status, check.reason, check.since = OK, NO_REASON, health.clock
    else:
        check.calm = check.calm + T if health.at_odds < AGREED else 0.0
        if check.calm > 2.0 * step or health.clock - check.since > GIVE_IN:
            check.status, check.reason, check.since = OK, NO_REASON, health.clock
            health.at_odds = 0.0
