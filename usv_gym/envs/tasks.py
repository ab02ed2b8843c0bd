"""What an episode is about: the path, the reward term by term, and when it ends."""

from __future__ import annotations

import math

import numpy as np

from usv_gym.physics import frames as fr
from usv_kernel.errors import UsvTwinError
from usv_kernel.jit import kernel
from usv_kernel.records import Record
from usv_kernel.scalar import wrap

__all__ = [
    "RULES",
    "TASK",
    "TASKS",
    "Curves",
    "FreeManoeuvre",
    "LawnMower",
    "PathFollowing",
    "Seakeeping",
    "StationKeeping",
    "Task",
    "TaskError",
    "WayPoints",
    "follow",
    "score_step",
]

ERRORS = ("cross_track_m", "to_go_m", "course_error_rad", "next_turn_rad")

CROSS_TRACK, TO_GO, COURSE_ERROR, NEXT_TURN = range(len(ERRORS))
"""Places of the errors."""

N_TERMS = 5

MOTION = "motion"
"""Name of the fifth part of a reward: minus what roll and vertical acceleration cost."""

ROLL_UNIT, LIFT_UNIT, MOTION_MOST = math.radians(10.0), 2.0, 4.0
"""Roll (rad) and vertical acceleration of the deck point (m/s2) that cost 1 each, by their squares,
and the most that a step costs, before the weight."""

DECK = 0.4
"""The deck point, in lengths forward of the origin."""

FAILURE = 500.0
"""What it costs to leave the area or to capsize: as much as some 12 s far from the path. So an
agent that looks ahead for less than that never fails on purpose."""


SEAKEEPING_TIME = 110.0
"""Time to sail the path of the task ``seakeeping`` at the nominal speed, s."""


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


NOTHING, PATH, STATION = 0, 1, 2
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
        ("kind", float),  # NOTHING, PATH or STATION
        ("reach", float),  # m, distance at which a way point counts as reached
        ("speed", float),  # m/s, nominal speed
        ("area", float),  # m, distance that ends the episode
        ("unit", float),  # m, distance off the path that counts as 1
        ("loose", float),  # how much less a distance off the path costs
        ("motion", float),  # weight of roll and vertical acceleration
        ("deck", float),  # m, the deck point forward of the origin
    ]
)
"""What is common to the tasks of all boats."""


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
    change = 0.0
    for j in range(action.shape[0]):
        change += abs(action[j] - before[j])
    if rules.kind == PATH:
        angle = errors[COURSE_ERROR]
        along = state[fr.U] * math.cos(angle) + state[fr.V] * math.sin(angle)
        # too fast costs as much as too slow by the same amount
        first = 1.0 - abs(along / rules.speed - 1.0)
        second = -min(abs(errors[CROSS_TRACK]) / (rules.unit * rules.loose), 2.0)
        reached = leg + 2 == points.shape[0] and errors[TO_GO] < rules.reach
        far = abs(errors[CROSS_TRACK]) > rules.area
        over = reached or far
    else:
        distance = math.hypot(errors[CROSS_TRACK], errors[TO_GO])
        speed = math.hypot(state[fr.U], state[fr.V])
        first = -0.5 * distance / rules.unit
        second = -0.1 * speed / rules.speed
        reached = distance < rules.reach
        over = far = distance > rules.area
    third = -0.05 * change
    fourth = -FAILURE if far or capsized else 0.0
    task.terms[0] += first
    task.terms[1] += second
    task.terms[2] += third
    task.terms[3] += fourth
    task.reward += first + second + third + fourth
    if rules.motion > 0.0:
        # of the deck point, along the mast
        lift = rate[fr.W] + state[fr.V] * state[fr.P] - state[fr.U] * state[fr.Q]
        lift -= rules.deck * (rate[fr.Q] - state[fr.P] * state[fr.R])
        rough = (state[fr.PHI] / ROLL_UNIT) ** 2 + (lift / LIFT_UNIT) ** 2
        fifth = -rules.motion * min(rough, MOTION_MOST)
        task.terms[4] += fifth
        task.reward += fifth
    task.success = 1.0 if reached and not capsized else 0.0
    if over:
        task.terminated = 1.0


class Task:
    """State of n episodes' tasks; subclasses draw the path and say what is rated.

    Parameters
    ----------
    n : int
        Number of boats.
    speed : float
        Nominal speed of the boat, m/s.
    length : float
        Length of the boat, m.
    motion : float, optional
        Weight of roll and vertical acceleration in the reward; that of the class if left out.

    Attributes
    ----------
    points : ndarray, shape (n, K, 2)
        Paths, m north and east.
    records : ndarray of TASK, shape (n,)
        Leg, errors, reward terms and ends.
    rules : record of RULES
        See :func:`score_step`.
    unit : float
        Distance off the path that counts as 1, in rewards and observations: 10 m, or 4/3
        lengths of a boat for which that is more.
    """

    kind = NOTHING
    terms: tuple[str, ...] = ("progress", "cross_track", "effort", "failure")
    """Names of the parts of the reward; ``motion`` follows where it has a weight."""
    motion = 0.0
    """Weight of roll and vertical acceleration, unless another one is given."""
    loose = 1.0
    """How much less a distance off the path costs."""
    legs = 1
    reach = 2.0
    """Distance at which a way point counts as reached, in lengths of the boat."""
    area = 5.0
    """Distance that ends the episode, in units."""

    def __init__(self, n: int, speed: float, length: float, motion: float | None = None) -> None:
        self.length, self.unit = length, max(10.0, 4.0 / 3.0 * length)
        self.rules = np.zeros(1, RULES)[0]
        self.rules["kind"], self.rules["speed"] = self.kind, speed
        self.rules["reach"], self.rules["area"] = self.reach * length, self.area * self.unit
        self.rules["unit"], self.rules["loose"] = self.unit, self.loose
        self.rules["motion"] = self.motion if motion is None else motion
        self.rules["deck"] = DECK * length
        if self.rules["motion"] > 0.0:
            self.terms = (*self.terms, MOTION)
        self.points = np.zeros((n, self.legs + 1, 2))
        self.records = np.zeros(n, TASK)

    @property
    def errors(self) -> np.ndarray:
        """True errors, shape (n, 4) in the order of ``ERRORS``; a view."""
        return self.records["errors"]

    def reset(self, i: int, rng: np.random.Generator, heading: float = 0.0) -> None:
        """Draw the path of boat i, which starts at the origin with a heading (rad)."""
        points = self._path(rng)
        if heading != 0.0:
            c, s = math.cos(heading), math.sin(heading)
            north, east = points.T
            points = np.stack([c * north - s * east, s * north + c * east], axis=1)
        self.points[i] = points
        self.records[i] = 0.0
        path_errors(0.0, 0.0, heading, self.points[i], 0, self.records["errors"][i])

    def _path(self, rng: np.random.Generator) -> np.ndarray:
        raise TaskError("a task must draw its path")


class FreeManoeuvre(Task):
    """No goal, no reward, no end but capsizing; the path ahead is a line to the north."""

    def _path(self, rng: np.random.Generator) -> np.ndarray:
        return np.array([[0.0, 0.0], [1e4, 0.0]])


class PathFollowing(Task):
    """Follow straight legs of 10 to 20 lengths, with turns of up to 70 degrees between them.

    The reward per step of ``dt`` is from the truth, a sum of four terms. ``progress`` is 1 at the
    nominal speed along the leg, 0 at rest and at twice that speed. ``cross_track`` is minus the
    distance from the leg in units, at most 2. ``effort`` is minus 0.05 times the change of the
    action, and ``failure`` minus 500, once. A way point is reached where the boat passes, two
    lengths before it, the line across the leg, however far to the side. The episode ends with
    success at the last one. It ends with failure 5 units (50 m) to the side of the leg or its
    extension, or capsized.
    """

    kind = PATH
    legs = 6

    def _path(self, rng: np.random.Generator) -> np.ndarray:
        turns = np.radians(rng.uniform(-70.0, 70.0, self.legs))
        turns[0] *= 0.3  # the boat starts heading north
        return _chain(np.cumsum(turns), self.length * rng.uniform(10.0, 20.0, self.legs))


class WayPoints(PathFollowing):
    """Visit way points anywhere around, 12 to 30 lengths apart: turns of up to 140 degrees."""

    def _path(self, rng: np.random.Generator) -> np.ndarray:
        turns = np.radians(rng.uniform(-140.0, 140.0, self.legs))
        turns[0] *= 0.3
        return _chain(np.cumsum(turns), self.length * rng.uniform(12.0, 30.0, self.legs))


class Curves(PathFollowing):
    """Follow a smooth curve: bends of 60 to 150 degrees with radii of 6 to 12 lengths.

    It is made of legs of one length each, and the next begins where the boat passes the end of
    the one before.
    """

    legs = 120
    reach = 0.0

    def _path(self, rng: np.random.Generator) -> np.ndarray:
        turns: list[float] = [0.0] * 5
        while len(turns) < self.legs:
            angle, radius = np.radians(rng.uniform(60.0, 150.0)), rng.uniform(6.0, 12.0)
            side = rng.choice([-1.0, 1.0])
            turns += [side / radius] * max(round(angle * radius), 1)
        courses = np.cumsum(turns[: self.legs])
        return _chain(courses, np.full(self.legs, self.length))


class LawnMower(PathFollowing):
    """Sweep a field: parallel legs of 14 to 24 lengths, 4 to 7 lengths apart."""

    legs = 9

    def _path(self, rng: np.random.Generator) -> np.ndarray:
        side = rng.choice([-1.0, 1.0])
        lengths = np.where(
            np.arange(self.legs) % 2 == 0, rng.uniform(14.0, 24.0), rng.uniform(4.0, 7.0)
        )
        quarter = side * 0.5 * math.pi
        courses = np.resize([0.0, quarter, 2.0 * quarter, quarter], self.legs)
        return _chain(courses, self.length * lengths)


class Seakeeping(PathFollowing):
    """Keep a mean course and speed for 110 s, and the boat quiet, with ``dof=6``.

    The course is drawn within 60 degrees of the first heading. ``progress``, ``effort`` and
    ``failure`` are those of a path, and ``cross_track`` is a third of it: the boat may choose
    a better heading or speed for a while. ``motion`` is minus 0.5 times the square of the roll over
    10 degrees, plus that of the vertical acceleration of the deck point over 2 m/s2, at most 4
    together. The deck point lies 0.4 lengths forward.
    """

    legs = 1
    motion = 0.5
    loose = 3.0
    area = 10.0

    def _path(self, rng: np.random.Generator) -> np.ndarray:
        course = np.radians(rng.uniform(-60.0, 60.0, 1))
        return _chain(course, np.array([SEAKEEPING_TIME * self.rules["speed"]]))


class StationKeeping(Task):
    """Go to a point 4 to 8 lengths away, ahead or to one side, and stay there.

    Reward per step of ``dt``, from the truth: ``distance`` (minus half the distance in units),
    ``speed`` (minus a tenth of the speed over ground over the nominal speed), ``effort`` and
    ``failure`` as on a path. The boat succeeds while it is within two lengths; the episode ends
    with failure 10 units away or capsized. Errors are those of the leg to the point: how far
    to starboard of it, and how far to go.
    """

    kind = STATION
    terms = ("distance", "speed", "effort", "failure")
    area = 10.0

    def _path(self, rng: np.random.Generator) -> np.ndarray:
        course = np.radians(rng.uniform(-90.0, 90.0, 1))
        return _chain(course, self.length * rng.uniform(4.0, 8.0, 1))


def _chain(courses: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """Return way points (K + 1, 2) in m from the origin, by courses in rad and lengths in m."""
    points = np.zeros((len(courses) + 1, 2))
    points[1:, 0], points[1:, 1] = lengths * np.cos(courses), lengths * np.sin(courses)
    return points.cumsum(axis=0)


TASKS: dict[str, type[Task]] = {
    "path": PathFollowing,
    "curves": Curves,
    "lawnmower": LawnMower,
    "waypoints": WayPoints,
    "station": StationKeeping,
    "seakeeping": Seakeeping,
    "free": FreeManoeuvre,
}
"""Name to task."""


def make_task(name: str, n: int, speed: float, length: float, motion: float | None = None) -> Task:
    """Return the task of that name for n boats; TaskError lists the names that there are.

    ``motion`` is the weight of roll and vertical acceleration, that of the task if left out.
    """
    if not isinstance(name, str) or name not in TASKS:
        raise TaskError(f"no task is called {name!r}; known: {', '.join(TASKS)}")
    return TASKS[name](n, speed, length, motion)
