"""How a step is rated: errors from the path, parts of the reward, and ends, in compiled code."""

from __future__ import annotations

import math

import numpy as np

from usv_gym.physics import frames as fr
from usv_kernel.arrays import alloca_f64
from usv_kernel.errors import UsvTwinError
from usv_kernel.jit import inlined, kernel
from usv_kernel.records import Record
from usv_kernel.scalar import wrap

__all__ = ["RULES", "TASK", "TaskError", "follow", "path_errors", "score_step"]

ERRORS = ("cross_track_m", "to_go_m", "course_error_rad", "next_turn_rad")

CROSS_TRACK, TO_GO, COURSE_ERROR, NEXT_TURN = range(len(ERRORS))
"""Places of the errors."""

N_TERMS = 8
"""Largest number of parts of a reward."""

PATH_TERMS = ("progress", "cross_track", "effort", "failure")
STATION_TERMS = ("distance", "speed", "effort", "failure")
DOCK_TERMS = (*STATION_TERMS, "heading")
"""Names of the parts of each kind of reward ..."""

PROGRESS, OFF_PATH = range(2)
DISTANCE, SPEED = range(2)
EFFORT, FAILURE, HEADING = range(2, 5)
"""... and their places."""

MOTION = "motion"
"""Name of the last part of a reward: minus what roll and vertical acceleration cost."""

EFFORT_COST = 0.05
"""What a change of the action by 1 costs."""

OFF_PATH_COST_MAX = 2.0
"""Largest cost of a distance from the path in a step."""

DISTANCE_COST = 0.5
BERTH_SPEED_COST = 0.5
STATION_SPEED_COST = 0.1
HEADING_COST = 0.25
"""Cost per step of a unit of distance, of a nominal speed too fast for a berth, of the nominal
speed at a station, and of an angle to the berth of 90 degrees."""

BERTH_SLOWING = 3.0
"""Distance from the berth, in reaches, below which the free speed falls in proportion to it."""

ROLL_UNIT_RAD = math.radians(10.0)
LIFT_UNIT_MPS2 = 2.0
MOTION_COST_MAX = 4.0
"""Roll (rad) and vertical acceleration of the deck point (m/s2) that cost 1 each, by their squares,
and the most that a step costs, before the weight."""

DECK_LENGTHS = 0.4
"""Default place of the deck point, lengths forward of the origin."""

WEIGHT_MAX = 1e3
"""Largest factor of a part of the reward."""

FAILURE_COST = 500.0
"""Cost of leaving the area or capsizing: that of 12 s far from the path, so that an agent with a
shorter horizon does not fail on purpose."""


ALONGSIDE = math.radians(20.0)
"""Largest angle to its berth at which a boat counts as docked, rad."""

REST_SPEED_SHARE = 0.1
REST_SPEED_MIN_MPS = 0.25
"""Speed below which a boat is at rest, in nominal speeds, and its least value."""


class TaskError(UsvTwinError):
    """A task that is not known; the message lists those that are."""


@kernel
def path_errors(
    x: float, y: float, psi: float, points: np.ndarray, leg: int, errors: np.ndarray
) -> None:
    """Write the errors of a boat from a leg: from point ``leg`` of a path (K, 2) to the next.

    Errors (4,): distance to starboard of the leg and left along it (m), course of the leg less
    heading, turn to the next leg (rad). The turn is 0 on the last leg.
    """
    dx, dy = points[leg + 1, 0] - points[leg, 0], points[leg + 1, 1] - points[leg, 1]
    course = math.atan2(dy, dx)
    c, s = math.cos(course), math.sin(course)
    ex, ey = x - points[leg, 0], y - points[leg, 1]
    errors[CROSS_TRACK] = ey * c - ex * s
    errors[TO_GO] = math.hypot(dx, dy) - (ex * c + ey * s)
    errors[COURSE_ERROR] = wrap(course - psi)
    errors[NEXT_TURN] = 0.0
    if leg + 2 < points.shape[0]:
        next_x = points[leg + 2, 0] - points[leg + 1, 0]
        next_y = points[leg + 2, 1] - points[leg + 1, 1]
        errors[NEXT_TURN] = wrap(math.atan2(next_y, next_x) - course)


@kernel
def follow(
    x: float,
    y: float,
    psi: float,
    points: np.ndarray,
    leg: int,
    reach: float,
    errors: np.ndarray,
) -> int:
    """Write the path errors and return the leg, moved on where its end is reached."""
    path_errors(x, y, psi, points, leg, errors)
    if errors[TO_GO] < reach and leg + 2 < points.shape[0]:
        leg += 1
        path_errors(x, y, psi, points, leg, errors)
    return leg


NOTHING, PATH, STATION, DOCK = 0, 1, 2, 3
"""Kinds of tasks."""

TASK = np.dtype(
    [
        ("leg", float),  # from way point ``leg`` to the next
        ("errors", float, len(ERRORS)),  # true errors, see ERRORS
        ("terms", float, N_TERMS),  # reward since the last decision, term by term
        ("reward", float),  # and their sum
        ("terminated", float),  # 1 where the episode is over
        ("success", float),
        ("capsized", float),
        ("known_leg", float),  # leg by what is known on board
    ]
)
"""Progress of one boat in its task."""

RULES = np.dtype(
    [
        ("kind", float),  # NOTHING, PATH, STATION or DOCK
        ("reach", float),  # m, distance at which a way point counts as reached
        ("speed", float),  # m/s, nominal speed
        ("area", float),  # m, distance that ends the episode
        ("unit", float),  # m, distance off the path that counts as 1
        ("loose", float),  # how much less a distance off the path costs
        ("motion", float),  # weight of roll and vertical acceleration
        ("deck", float, 3),  # m, the deck point forward, to starboard and down of the origin
        ("rest", float),  # m/s, a boat that is slower is at rest
        ("terms", float),  # parts of the reward but for motion
        ("weights", float, N_TERMS),  # factor of each part
    ]
)
"""What is common to the tasks of all boats."""


@inlined
def _rate_path(state, points, leg, rules, task, now):
    """Write the parts of the reward on a path; return whether it is reached, and left."""
    errors, angle = task.errors, task.errors[COURSE_ERROR]
    along = state[fr.U] * math.cos(angle) + state[fr.V] * math.sin(angle)
    # too fast costs as much as too slow by the same amount
    now[PROGRESS] = 1.0 - abs(along / rules.speed - 1.0)
    now[OFF_PATH] = -min(abs(errors[CROSS_TRACK]) / (rules.unit * rules.loose), OFF_PATH_COST_MAX)
    reached = leg + 2 == points.shape[0] and errors[TO_GO] < rules.reach
    return reached, abs(errors[CROSS_TRACK]) > rules.area


@inlined
def _rate_docking(state, points, leg, rules, task, now):
    """Write the parts of the reward at a berth, as :func:`_rate_path` does."""
    errors, at_berth = task.errors, leg + 2 == points.shape[0]
    angle, distance = errors[COURSE_ERROR], math.hypot(errors[CROSS_TRACK], errors[TO_GO])
    if not at_berth:
        distance = errors[TO_GO] + math.hypot(
            points[leg + 2, 0] - points[leg + 1, 0], points[leg + 2, 1] - points[leg + 1, 1]
        )
    speed = math.hypot(state[fr.U], state[fr.V])
    # slower and slower over the last six lengths
    fast = speed / rules.speed - min(max(distance, 0.0) / (BERTH_SLOWING * rules.reach), 1.0)
    now[DISTANCE] = -DISTANCE_COST * max(distance, 0.0) / rules.unit
    now[SPEED] = -BERTH_SPEED_COST * max(fast, 0.0)
    now[HEADING] = -HEADING_COST * (1.0 - math.cos(angle)) if at_berth else 0.0
    reached = at_berth and distance < 0.25 * rules.reach and speed < rules.rest
    quay = at_berth and errors[TO_GO] < -0.5 * rules.reach
    return reached and abs(angle) < ALONGSIDE, quay or abs(errors[CROSS_TRACK]) > rules.area


@inlined
def _rate_station(state, rules, task, now):
    """Write the parts of the reward at a station, as :func:`_rate_path` does."""
    distance = math.hypot(task.errors[CROSS_TRACK], task.errors[TO_GO])
    speed = math.hypot(state[fr.U], state[fr.V])
    now[DISTANCE] = -DISTANCE_COST * distance / rules.unit
    now[SPEED] = -STATION_SPEED_COST * speed / rules.speed
    return distance < rules.reach, distance > rules.area


@inlined
def _rate_motion(state, rate, rules):
    """Return the cost of roll, and of the deck point's acceleration along the mast."""
    lift = rate[fr.W] + state[fr.V] * state[fr.P] - state[fr.U] * state[fr.Q]
    ahead, side, down = rules.deck[0], rules.deck[1], rules.deck[2]
    p, q, r = state[fr.P], state[fr.Q], state[fr.R]
    lift -= ahead * (rate[fr.Q] - p * r)
    lift += side * (rate[fr.P] + q * r) - down * (p * p + q * q)
    return min((state[fr.PHI] / ROLL_UNIT_RAD) ** 2 + (lift / LIFT_UNIT_MPS2) ** 2, MOTION_COST_MAX)


@kernel
def score_step(
    state: np.ndarray,
    rate: np.ndarray,
    action: np.ndarray,
    before: np.ndarray,
    points: np.ndarray,
    rules: Record,
    task: Record,
) -> None:
    """Write errors and end of one step of one boat, and add its reward terms, from the truth.

    ``rate`` (16,) is the mean time derivative of ``state`` over the step. ``action`` and ``before``
    (A,) are those of this step and the step before. All of the task's record is written but
    ``known_leg``.
    """
    errors = task.errors
    leg = follow(
        state[fr.X], state[fr.Y], state[fr.PSI], points, int(task.leg), rules.reach, errors
    )
    task.leg = leg
    # the mast points below the horizon
    capsized = math.cos(state[fr.PHI]) * math.cos(state[fr.THETA]) < 0.0
    task.capsized = task.terminated = 1.0 if capsized else 0.0
    if rules.kind == NOTHING:
        return
    now, count = alloca_f64(N_TERMS), int(rules.terms)
    if rules.kind == PATH:
        reached, far = _rate_path(state, points, leg, rules, task, now)
    elif rules.kind == DOCK:
        reached, far = _rate_docking(state, points, leg, rules, task, now)
    else:
        reached, far = _rate_station(state, rules, task, now)
    change = 0.0
    for j in range(action.shape[0]):
        change += abs(action[j] - before[j])
    now[EFFORT] = -EFFORT_COST * change
    now[FAILURE] = -FAILURE_COST if far or capsized else 0.0
    if rules.motion > 0.0:
        now[count] = -rules.motion * _rate_motion(state, rate, rules)
        count += 1
    total = 0.0
    for k in range(count):
        value = rules.weights[k] * now[k]
        task.terms[k] += value
        total += value
    task.reward += total
    task.success = 1.0 if reached and not capsized else 0.0
    # a boat stays at a station
    if far or (reached and rules.kind != STATION):
        task.terminated = 1.0
