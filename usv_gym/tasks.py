"""What an episode is about: the path, the reward term by term, and when it ends."""

from __future__ import annotations

import math

import numpy as np

from usv_kernel import kernel, wrap

__all__ = ["TASKS", "FreeManoeuvre", "PathFollowing", "Task", "TaskError", "follow", "judge"]

ERRORS = ("cross_track_m", "to_go_m", "course_error_rad", "next_turn_rad")
TERMS = ("progress", "cross_track", "effort")
CROSS_TRACK_SCALE = 10.0
"""Cross-track error that costs one unit of reward, m."""


class TaskError(ValueError):
    """A task that is not known; the message lists those that are."""


@kernel
def path_errors(
    x: float, y: float, psi: float, points: np.ndarray, leg: int, errors: np.ndarray
) -> None:
    """Write how a boat stands to one leg of a path.

    Parameters
    ----------
    x, y, psi : float
        Position in m and heading in rad.
    points : ndarray, shape (K, 2)
        Way points, m north and east.
    leg : int
        Leg from point ``leg`` to point ``leg + 1``.
    errors : ndarray, shape (4,)
        Written: distance to starboard of the leg (m), distance left along it (m), course of
        the leg less the heading (rad), turn to the next leg (rad; 0 on the last).
    """
    dx, dy = points[leg + 1, 0] - points[leg, 0], points[leg + 1, 1] - points[leg, 1]
    course = math.atan2(dy, dx)
    c, s = math.cos(course), math.sin(course)
    ex, ey = x - points[leg, 0], y - points[leg, 1]
    errors[0] = ey * c - ex * s
    errors[1] = math.hypot(dx, dy) - (ex * c + ey * s)
    errors[2] = wrap(course - psi)
    errors[3] = 0.0
    if leg + 2 < points.shape[0]:
        next_x = points[leg + 2, 0] - points[leg + 1, 0]
        next_y = points[leg + 2, 1] - points[leg + 1, 1]
        errors[3] = wrap(math.atan2(next_y, next_x) - course)


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
    if errors[1] < reach and leg + 2 < points.shape[0]:
        leg += 1
        path_errors(x, y, psi, points, leg, errors)
    return leg


# one row of numbers per boat: where each part begins
LEG = 0
ERROR = LEG + 1
TERM = ERROR + len(ERRORS)
REWARD = TERM + len(TERMS)
TERMINATED, SUCCESS = REWARD + 1, REWARD + 2
CAPSIZED = SUCCESS + 1
KNOWN_LEG = CAPSIZED + 1
RECORD_SIZE = KNOWN_LEG + 1
# and what is common to all boats
RATED, REACH, SPEED, AREA = 0, 1, 2, 3


@kernel
def judge(
    state: np.ndarray,
    action: np.ndarray,
    before: np.ndarray,
    points: np.ndarray,
    rules: np.ndarray,
    record: np.ndarray,
) -> None:
    """Write errors, reward terms and end of one step of one boat, from the truth.

    Parameters
    ----------
    state : ndarray, shape (16,)
        True state.
    action, before : ndarray, shape (A,)
        Action of this step and of the step before.
    points : ndarray, shape (K, 2)
        Path.
    rules : ndarray, shape (4,)
        Whether steps are rated at all, the distance at which a way point counts as reached
        (m), the speed along the path that earns one unit (m/s), and the distance off the
        path that ends the episode (m).
    record : ndarray, shape (RECORD_SIZE,)
        Parts as named above; written, but for the leg that the boat believes to be on.
    """
    errors = record[ERROR:TERM]
    leg = follow(state[0], state[1], state[5], points, int(record[LEG]), rules[REACH], errors)
    record[LEG] = leg
    # the mast points below the horizon
    capsized = math.cos(state[3]) * math.cos(state[4]) < 0.0
    record[CAPSIZED] = record[TERMINATED] = 1.0 if capsized else 0.0
    if rules[RATED] == 0.0:
        return
    along = state[6] * math.cos(errors[2]) + state[7] * math.sin(errors[2])
    change = 0.0
    for j in range(action.shape[0]):
        change += abs(action[j] - before[j])
    record[TERM] = min(along / rules[SPEED], 1.0)
    record[TERM + 1] = -min(abs(errors[0]) / CROSS_TRACK_SCALE, 2.0)
    record[TERM + 2] = -0.05 * change
    record[REWARD] = record[TERM] + record[TERM + 1] + record[TERM + 2]
    reached = leg + 2 == points.shape[0] and errors[1] < rules[REACH]
    record[SUCCESS] = 1.0 if reached else 0.0
    if reached or abs(errors[0]) > rules[AREA]:
        record[TERMINATED] = 1.0


class Task:
    """State of n episodes' tasks; subclasses draw the path and say what is rated.

    Parameters
    ----------
    n : int
        Number of boats.
    speed : float
        Usual speed of the boat, m/s.
    length : float
        Length of the boat, m.

    Attributes
    ----------
    points : ndarray, shape (n, K, 2)
        Paths, m north and east.
    records : ndarray, shape (n, RECORD_SIZE)
        Leg, errors, reward terms and ends; parts as named at the top of this file.
    rules : ndarray, shape (4,)
        See :func:`judge`.
    """

    legs_per_path = 1
    rated = False
    off_track = math.inf

    def __init__(self, n: int, speed: float, length: float) -> None:
        self.length = length
        self.rules = np.array([float(self.rated), 2.0 * length, speed, self.off_track])
        self.points = np.zeros((n, self.legs_per_path + 1, 2))
        self.records = np.zeros((n, RECORD_SIZE))

    @property
    def errors(self) -> np.ndarray:
        """True errors, shape (n, 4) in the order of ``ERRORS``; a view."""
        return self.records[:, ERROR:TERM]

    @property
    def terms(self) -> np.ndarray:
        """Reward terms of the last step, shape (n, 3) in the order of ``TERMS``; a view."""
        return self.records[:, TERM:REWARD]

    def reset(self, i: int, rng: np.random.Generator) -> None:
        """Draw the path of boat i; it starts at the origin, heading north."""
        self.points[i] = self._path(rng)
        self.records[i] = 0.0
        path_errors(0.0, 0.0, 0.0, self.points[i], 0, self.records[i, ERROR:TERM])

    def _path(self, rng: np.random.Generator) -> np.ndarray:
        raise TypeError("a task must draw its path")


class FreeManoeuvre(Task):
    """No goal, no reward, no end but capsizing; the path ahead is a line to the north."""

    def _path(self, rng: np.random.Generator) -> np.ndarray:
        return np.array([[0.0, 0.0], [1e4, 0.0]])


class PathFollowing(Task):
    """Follow straight legs through way points drawn at random.

    Reward per step, from the truth: ``progress`` (speed along the leg over the usual speed,
    at most 1), ``cross_track`` (minus the distance off the leg in units of 10 m, at most 2)
    and ``effort`` (minus 0.05 times the change of the action). The episode ends with success
    at the last way point, and without it 50 m off the leg or capsized.
    """

    legs_per_path = 6
    rated = True
    off_track = 50.0

    def _path(self, rng: np.random.Generator) -> np.ndarray:
        turns = np.radians(rng.uniform(-70.0, 70.0, self.legs_per_path))
        turns[0] *= 0.3  # the boat starts heading north
        courses = np.cumsum(turns)
        lengths = self.length * rng.uniform(10.0, 20.0, self.legs_per_path)
        legs = lengths[:, None] * np.stack([np.cos(courses), np.sin(courses)], axis=1)
        return np.concatenate([np.zeros((1, 2)), np.cumsum(legs, axis=0)])


TASKS: dict[str, type[Task]] = {"path": PathFollowing, "free": FreeManoeuvre}
"""Name to task."""


def make_task(name: str, n: int, speed: float, length: float) -> Task:
    """Return the task of that name for n boats.

    Raises
    ------
    TaskError
        Lists the names that there are.
    """
    try:
        return TASKS[name](n, speed, length)
    except (KeyError, TypeError):
        raise TaskError(f"no task is called {name!r}; known: {', '.join(TASKS)}") from None
