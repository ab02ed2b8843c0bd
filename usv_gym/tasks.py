"""What an episode is about: the path, the reward term by term, and when it ends."""

from __future__ import annotations

import math

import numpy as np

from usv_kernel import kernel, wrap

__all__ = ["TASKS", "FreeManoeuvre", "PathFollowing", "Task", "TaskError", "path_errors"]

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


@kernel
def path_reward(
    states: np.ndarray,
    actions: np.ndarray,
    before: np.ndarray,
    points: np.ndarray,
    legs: np.ndarray,
    reach: float,
    area: float,
    speed: float,
    errors: np.ndarray,
    terms: np.ndarray,
    rewards: np.ndarray,
    terminated: np.ndarray,
    success: np.ndarray,
) -> None:
    """Write reward terms and ends of every boat, from the truth.

    Parameters
    ----------
    states : ndarray, shape (n, 16)
        True states.
    actions, before : ndarray, shape (n, A)
        Action of this step and of the step before.
    points, legs : ndarray, shapes (n, K, 2), (n,)
        Paths, and the leg that each boat is on (advanced in place).
    reach, area : float
        A way point counts as reached within ``reach`` m; further than ``area`` m off the
        path ends the episode.
    speed : float
        Speed along the path that earns one unit, m/s.
    errors, terms, rewards : ndarray, shapes (n, 4), (n, 3), (n,)
        Written.
    terminated, success : ndarray of bool, shape (n,)
        Written.
    """
    for i in range(states.shape[0]):
        x, y, psi = states[i, 0], states[i, 1], states[i, 5]
        legs[i] = follow(x, y, psi, points[i], legs[i], reach, errors[i])
        u, v = states[i, 6], states[i, 7]
        along = u * math.cos(errors[i, 2]) + v * math.sin(errors[i, 2])
        terms[i, 0] = min(along / speed, 1.0)
        terms[i, 1] = -min(abs(errors[i, 0]) / CROSS_TRACK_SCALE, 2.0)
        change = 0.0
        for j in range(actions.shape[1]):
            change += abs(actions[i, j] - before[i, j])
        terms[i, 2] = -0.05 * change
        rewards[i] = terms[i, 0] + terms[i, 1] + terms[i, 2]
        success[i] = legs[i] + 2 == points.shape[1] and errors[i, 1] < reach
        terminated[i] = success[i] or abs(errors[i, 0]) > area


class Task:
    """State of n episodes' tasks; the base is a boat that is left to itself.

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
    points, known_legs : ndarray, shapes (n, K, 2), (n,)
        Paths, and the leg that each boat believes to be on.
    errors, terms : ndarray, shapes (n, 4), (n, 3)
        True errors and reward terms of the last step; order of ``ERRORS`` and ``TERMS``.
    rewards : ndarray, shape (n,)
        Sums of the terms.
    terminated, success : ndarray of bool, shape (n,)
        Whether the episode ended, and whether by reaching the goal.
    reach : float
        Distance at which a way point counts as reached, m.
    """

    legs_per_path = 1
    off_track = math.inf

    def __init__(self, n: int, speed: float, length: float) -> None:
        self.speed, self.length = speed, length
        self.reach = 2.0 * length
        self.points = np.zeros((n, self.legs_per_path + 1, 2))
        self.legs = np.zeros(n, dtype=np.int64)
        self.known_legs = np.zeros(n, dtype=np.int64)
        self.errors = np.zeros((n, len(ERRORS)))
        self.terms = np.zeros((n, len(TERMS)))
        self.rewards = np.zeros(n)
        self.terminated = np.zeros(n, dtype=np.bool_)
        self.success = np.zeros(n, dtype=np.bool_)

    def reset(self, i: int, rng: np.random.Generator) -> None:
        """Draw the path of boat i; it starts at the origin, heading north."""
        self.points[i] = self._path(rng)
        self.legs[i] = self.known_legs[i] = 0
        self.terms[i] = 0.0
        self.terminated[i] = self.success[i] = False
        path_errors(0.0, 0.0, 0.0, self.points[i], 0, self.errors[i])

    def step(self, states: np.ndarray, actions: np.ndarray, before: np.ndarray) -> None:
        """Judge one step of every boat; see :func:`path_reward`."""
        raise TypeError("a task must judge its steps")

    def _path(self, rng: np.random.Generator) -> np.ndarray:
        raise TypeError("a task must draw its path")


class FreeManoeuvre(Task):
    """No goal, no reward, no end; the path ahead is a line to the north."""

    def step(self, states: np.ndarray, actions: np.ndarray, before: np.ndarray) -> None:
        """Write the true errors to the line; there is nothing to judge."""
        for i, state in enumerate(states):
            path_errors(state[0], state[1], state[5], self.points[i], 0, self.errors[i])

    def _path(self, rng: np.random.Generator) -> np.ndarray:
        return np.array([[0.0, 0.0], [1e4, 0.0]])


class PathFollowing(Task):
    """Follow straight legs through way points drawn at random.

    Reward per step, from the truth: ``progress`` (speed along the leg over the usual speed,
    at most 1), ``cross_track`` (minus the distance off the leg in units of 10 m, at most 2)
    and ``effort`` (minus 0.05 times the change of the action). The episode ends with success
    at the last way point, and without it 50 m off the leg.
    """

    legs_per_path = 6
    off_track = 50.0

    def step(self, states: np.ndarray, actions: np.ndarray, before: np.ndarray) -> None:
        """Judge one step of every boat; see :func:`path_reward`."""
        path_reward(
            states,
            actions,
            before,
            self.points,
            self.legs,
            self.reach,
            self.off_track,
            self.speed,
            self.errors,
            self.terms,
            self.rewards,
            self.terminated,
            self.success,
        )

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
