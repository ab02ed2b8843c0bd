"""Error of the model's velocity during an outage of GPS, and the position variance it adds."""

from __future__ import annotations

import math

from twin.channels import PSI, R, U, V, X, Y
from twin.filters.navigation_ekf import (
    GAP_MAX_S,
    is_learning_suspended,
    lacks_gps,
)
from twin.model.dynamics import drive, rates_over_ground
from twin.model.rollout import GRID
from twin.model.structure import CURRENT, N_STATES, current_of
from usv_kernel.jit import inlined

__all__ = ["try_open_loop", "widen_without_gps"]

MODEL_DRIFT_SD = 0.02
LASTING_SHARE = 0.045
"""Least standard deviation of the constant error of the model's velocity without GPS, in nominal
speeds; and constant share of the variance of a rough model's velocity, up to the fastest seen."""

TRIAL_S = 40.0
TRIALS_KEPT = 6
AXIS_SHARE = 0.5
"""Length of a trial, in which the model is integrated open loop, with the measured heading, while
fixes come. Its mean velocity error estimates that of an outage. The geometric mean of the squares
of TRIALS_KEPT trials is kept, of which north and east get AXIS_SHARE each. A trial that an outage
interrupts ends with the next fix."""

SQUARED_ERROR_MIN = 1e-9
"""Least of these squares, (m/s)2."""

TRIAL_TIME, TRIAL_U, TRIAL_V, TRIAL_NORTH, TRIAL_EAST, TRIAL_COUNT = range(6)

COURSE_CURRENT_SD = 0.12
"""Standard deviation, in nominal speeds, of the current along the mean course of a boat with a
rough model. On one course it cannot be told from an error of drag or thrust; when the boat turns
without GPS, the current keeps its direction, and the other error turns with the boat."""


@inlined
def try_open_loop(dt, nav, state, given, model, terms):
    """Integrate the model open loop with the measured heading, and compare it with the navigation.

    The actuators of ``state`` have followed the commands. ``terms`` is scratch.
    """
    n, trial, x = nav.n, nav.trial, state.x
    if (
        nav.gps_age > GAP_MAX_S
        or dt > GAP_MAX_S
        or is_learning_suspended(nav)
        or trial[TRIAL_TIME] == 0.0
    ):
        trial[TRIAL_TIME] = dt
        trial[TRIAL_U], trial[TRIAL_V] = n[U], n[V]
        trial[TRIAL_NORTH], trial[TRIAL_EAST] = n[X], n[Y]
        return
    drive(state.act, terms)
    c, s = math.cos(n[PSI]), math.sin(n[PSI])
    current = current_of(x, N_STATES, model.hull)
    steps = max(1, math.ceil(dt / GRID - 1e-9))
    h = dt / steps
    for _ in range(steps):
        u, v = trial[TRIAL_U], trial[TRIAL_V]
        motion = u, v, n[R], c, s
        rates = rates_over_ground(motion, state.wind, current, x, N_STATES, model, terms)
        for i in range(2):
            moved, most = trial[TRIAL_U + i] + h * rates[i], given.envelope[i]
            trial[TRIAL_U + i] = min(max(moved, -most), most)
        trial[TRIAL_NORTH] += h * (u * c - v * s)
        trial[TRIAL_EAST] += h * (u * s + v * c)
    trial[TRIAL_TIME] += dt
    if trial[TRIAL_TIME] < TRIAL_S or lacks_gps(nav):
        return
    north, east = trial[TRIAL_NORTH] - n[X], trial[TRIAL_EAST] - n[Y]
    square = AXIS_SHARE * (north * north + east * east) / trial[TRIAL_TIME] ** 2
    trial[TRIAL_TIME], count = 0.0, min(max(trial[TRIAL_COUNT], 0.0), TRIALS_KEPT - 1.0)
    trial[TRIAL_COUNT] = count + 1.0
    square = math.log(min(max(square, SQUARED_ERROR_MIN), given.envelope[0] ** 2))
    before = math.log(max(nav.drift_var, SQUARED_ERROR_MIN))
    nav.drift_var = math.exp((count * before + square) / (count + 1.0))


@inlined
def widen_without_gps(dt, nav, state, given, model):
    """Add the variance of the model's velocity error to that of the navigation's position."""
    if nav.gps_age == 0.0:
        for i in range(2):
            nav.turned[i], nav.turned[2 + i] = nav.path[2 + i], 0.0
    if not lacks_gps(nav):
        return
    P, speed = state.P, 0.25 * given.envelope[0]
    lasting = max(nav.drift_var, (MODEL_DRIFT_SD * speed) ** 2)
    if given.rest_push < 1.0:  # rough: no population says what it leaves out
        most = state.fastest[0] ** 2 + state.fastest[1] ** 2
        lasting = max(lasting, LASTING_SHARE * min(P[U, U] + P[V, V], most))
        _widen_by_turns(nav, speed)
    at = N_STATES + int(model.hull[CURRENT])
    for i in range(2):
        more = P[at + i, at + i] if at >= N_STATES else 0.0
        nav.P[i, i] += 2.0 * (lasting + more) * nav.gps_age * min(dt, GAP_MAX_S)


@inlined
def _widen_by_turns(nav, speed):
    """Add the variance of a current that was not observable before the boat turned."""
    before = math.hypot(nav.turned[0], nav.turned[1])  # s along the mean course so far
    share = min(before / max(nav.clock - nav.gps_age, 1e-3), 1.0)
    for i in range(2):
        # time along that course since the last fix, less that along the courses since: s
        apart = nav.turned[i] / max(before, 1e-3) * nav.gps_age - (nav.path[2 + i] - nav.turned[i])
        more = max(apart * apart - nav.turned[2 + i], 0.0)
        nav.turned[2 + i] += more
        nav.P[i, i] += (COURSE_CURRENT_SD * speed * share) ** 2 * more
