"""What an episode is about: the path, the reward term by term, and when it ends."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from usv_gym.envs.scoring import (
    DECK_LENGTHS,
    DOCK,
    DOCK_TERMS,
    MOTION,
    N_TERMS,
    NOTHING,
    PATH,
    PATH_TERMS,
    REST_SPEED_MIN_MPS,
    REST_SPEED_SHARE,
    RULES,
    STATION,
    STATION_TERMS,
    TASK,
    WEIGHT_MAX,
    TaskError,
    path_errors,
)
from usv_kernel.arrays import alloca_f64
from usv_kernel.errors import check_number, did_you_mean
from usv_kernel.files import import_named
from usv_kernel.jit import kernel
from usv_kernel.random import fill_uniform, start_stream
from usv_kernel.streams import Children

__all__ = [
    "TASKS",
    "Curves",
    "Docking",
    "FreeManoeuvre",
    "LawnMower",
    "PathFollowing",
    "Score",
    "Seakeeping",
    "StationKeeping",
    "Step",
    "Task",
    "WayPoints",
    "make_task",
]

Ranges = Sequence[tuple[float, float, float]]

LEGS_MAX = 16
"""Most legs that are drawn in compiled code."""

_DRAWS_MAX = 2 * LEGS_MAX

_BENDS = 20
"""Bends of a curve: 6 legs or more of each, together at least 120."""

SEAKEEPING_TIME_S = 110.0
"""Time to sail the path of the task ``seakeeping`` at the nominal speed."""


class Step(NamedTuple):
    """One control step of n boats, by the truth; arrays are not to be changed."""

    t: np.ndarray
    """Time since the reset (n,), s."""
    state: np.ndarray
    """State (n, 16); order and units in :mod:`usv_gym.physics.frames`."""
    rate: np.ndarray
    """Mean time derivative of the state over the step (n, 16)."""
    action: np.ndarray
    """Action of this step (n, A), within -1 and 1 ..."""
    before: np.ndarray
    """... and of the step before."""
    errors: np.ndarray
    """Errors (n, 4) from the leg: to starboard of it and left along it (m), course of the leg less
    heading, and turn to the next leg (rad)."""
    leg: np.ndarray
    """Leg of the path (n,), from 0."""
    points: np.ndarray
    """Paths (n, K, 2), m north and east."""
    capsized: np.ndarray
    """Whether each boat has capsized (n,)."""


class Score(NamedTuple):
    """How one control step of n boats is rated."""

    terms: Mapping[str, np.ndarray]
    """Parts of the reward (n,), by the names of ``Task.terms``; their sum is the reward."""
    success: np.ndarray
    """Whether the goal is reached (n,)."""
    over: np.ndarray
    """Whether the episode ends (n,); it also ends where a boat has capsized."""


class Task:
    """What an episode is about; subclasses draw the path and say what is rated.

    A task of your own overrides :meth:`path` and :meth:`score`, in a file of your own; those of
    this package are rated in compiled code instead, by their ``kind``. See
    docs/how-to/own_task.md.

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
    weights : mapping of str to float, optional
        Factors of parts of the reward, by name; 1 where left out.

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

    Raises
    ------
    TaskError
        A weight is of no part of the reward, or no number.
    """

    kind = NOTHING
    terms: tuple[str, ...] = PATH_TERMS
    """Names of the parts of the reward, eight at most; ``motion`` follows where it has a weight."""
    motion = 0.0
    """Weight of roll and vertical acceleration, unless another one is given."""
    loose = 1.0
    """How much less a distance off the path costs."""
    legs = 1
    """Legs of a path."""
    reach = 2.0
    """Distance at which a way point counts as reached, in lengths of the boat."""
    area = 5.0
    """Distance that ends the episode, in units."""

    def __init__(
        self,
        n: int,
        speed: float,
        length: float,
        motion: float | None = None,
        weights: Mapping[str, float] | None = None,
    ) -> None:
        self.length, self.unit, self.speed = length, max(10.0, 4.0 / 3.0 * length), speed
        self.rules = np.zeros(1, RULES)[0]
        self.rules["kind"], self.rules["speed"] = self.kind, speed
        self.rules["reach"], self.rules["area"] = self.reach * length, self.area * self.unit
        self.rules["unit"], self.rules["loose"] = self.unit, self.loose
        self.rules["motion"] = self.motion if motion is None else motion
        self.rules["deck"] = DECK_LENGTHS * length, 0.0, 0.0
        self.rules["rest"] = max(REST_SPEED_SHARE * speed, REST_SPEED_MIN_MPS)
        self.rules["terms"] = len(self.terms)
        if self.rules["motion"] > 0.0:
            self.terms = (*self.terms, MOTION)
        if len(self.terms) > N_TERMS:
            raise TaskError(
                f"{type(self).__name__}: {len(self.terms)} terms; use {N_TERMS} at most"
            )
        self.rules["weights"] = 1.0
        for name, weight in (weights or {}).items():
            if name not in self.terms:
                raise TaskError(
                    f"reward_weights: the reward has no term {name!r}"
                    f"{did_you_mean(name, self.terms)}; its terms: {', '.join(self.terms)}"
                )
            check_number(f"reward_weights[{name!r}]", weight, 0.0, WEIGHT_MAX, TaskError)
            self.rules["weights"][self.terms.index(name)] = weight
        self.points = np.zeros((n, self.legs + 1, 2))
        self.records = np.zeros(n, TASK)

    @property
    def errors(self) -> np.ndarray:
        """True errors, shape (n, 4) in the order of ``ERRORS``; a view."""
        return self.records["errors"]

    def draw(self, i: int, children: Children, number: int, heading: float = 0.0) -> None:
        """Do what :meth:`reset` does with the generator of a child, where the records are zeros.

        Legs that are drawn by :meth:`ranges` are drawn in compiled code.
        """
        if not self._compiled:
            self.reset(i, children.generator(number), heading)
            return
        words, errors = children.states[number], self.records["errors"][i]
        _draw_path(words, self._ranges, heading, self.points[i], errors)

    @cached_property
    def _compiled(self) -> bool:
        """Whether kernels draw the path: nothing of it is overridden, and it is not too long."""
        kind = type(self)
        own = kind.path is not Task.path or kind.reset is not Task.reset
        return not own and self.legs <= LEGS_MAX

    @cached_property
    def _ranges(self) -> np.ndarray:
        """What :meth:`ranges` gave at the first episode, checked."""
        given, name = self.ranges(), type(self).__name__
        if given is None:
            raise TaskError(f"{name} must draw its path: override path(self, rng)")
        try:
            ranges = np.array(given, dtype=float)
        except (TypeError, ValueError):
            ranges = np.zeros(0)
        if ranges.shape != (self.legs, 3) or not np.isfinite(ranges).all():
            raise TaskError(
                f"{name}.ranges gave {str(given)[:200]}: must be three finite numbers for each of "
                f"its legs, of which it has legs = {self.legs}"
            )
        turn, low, high = ranges.T
        if not ((turn >= 0.0) & (turn <= 180.0) & (low > 0.0) & (low <= high)).all():
            raise TaskError(
                f"{name}.ranges gave {str(given)[:200]}: the largest turn must lie between 0 and "
                "180 degrees, the shortest length above 0, and the longest be no shorter"
            )
        return ranges

    def reset(self, i: int, rng: np.random.Generator, heading: float = 0.0) -> None:
        """Draw the path of boat i, which starts at the origin with a heading (rad)."""
        points = np.asarray(self.path(rng), dtype=float)
        if points.shape != self.points.shape[1:] or not np.isfinite(points).all():
            raise TaskError(
                f"{type(self).__name__}.path gave an array of shape {points.shape}: must be finite "
                f"numbers of shape {self.points.shape[1:]}, a row for each of its legs and one more"
            )
        if heading != 0.0:
            c, s = math.cos(heading), math.sin(heading)
            north, east = points.T
            points = np.stack([c * north - s * east, s * north + c * east], axis=1)
        self.points[i] = points
        self.records[i] = 0.0
        path_errors(0.0, 0.0, heading, self.points[i], 0, self.records["errors"][i])

    def path(self, rng: np.random.Generator) -> np.ndarray:
        """Draw a path (legs + 1, 2), m north and east: the boat starts at (0, 0), heading north.

        Randomness comes from ``rng`` alone. Errors and observations follow from the path. Those of
        this package that draw each leg by :meth:`ranges` do so in compiled code.
        """
        points = np.zeros((self.legs + 1, 2))
        chain_legs(rng.random(2 * self.legs), self._ranges, 0.0, points)
        return points

    def ranges(self) -> Ranges | None:
        """Return how each leg is drawn; None: :meth:`path` is overridden.

        Three numbers for each of the ``legs``: the largest turn before it to either side, degrees,
        and its shortest and longest length, m. The first turn is that from the first heading. It is
        asked for once, at the first episode.
        """
        return None

    def score(self, step: Step) -> Score | None:
        """Rate one step of all boats; None: it is rated in compiled code, by ``kind``.

        Called for each control step, after the boats have moved. Results must not depend on how
        many boats there are: use NumPy entry by entry.
        """
        return None

    def take(self, step: Step, rated: np.ndarray) -> None:
        """Rate one step by :meth:`score`, and add it to the records of some boats (n,).

        TaskError: the score has other terms, or is no number.
        """
        score, name = self.score(step), type(self).__name__
        if score is None or set(score.terms) != set(self.terms):
            given = "None" if score is None else ", ".join(score.terms)
            raise TaskError(
                f"{name}.score gave {given}; must be a Score with the terms {', '.join(self.terms)}"
            )
        for k, term in enumerate(self.terms):
            values = np.broadcast_to(np.asarray(score.terms[term], float), rated.shape)
            if not np.isfinite(values[rated]).all():
                raise TaskError(f"{name}.score: the term {term!r} is not finite: {values[rated]}")
            values = self.rules["weights"][k] * values[rated]
            self.records["terms"][rated, k] += values
            self.records["reward"][rated] += values
        ends = np.broadcast_to(np.asarray(score.over, dtype=np.bool_), rated.shape)
        reached = np.broadcast_to(np.asarray(score.success, dtype=np.bool_), rated.shape)
        self.records["terminated"][rated & ends] = 1.0
        self.records["success"][rated] = (reached & ~step.capsized)[rated]

    @property
    def is_own(self) -> bool:
        """Whether steps are rated by :meth:`score`."""
        return type(self).score is not Task.score


@kernel
def chain_legs(u: np.ndarray, ranges: np.ndarray, course: float, points: np.ndarray) -> None:
    """Write way points (K + 1, 2) from uniform numbers (2 K or more), for a first heading, rad."""
    count = ranges.shape[0]
    points[0] = 0.0
    for k in range(count):
        turn, low, high = ranges[k]
        course += math.radians(-turn + 2.0 * turn * u[k])
        length = low + (high - low) * u[count + k]
        points[k + 1, 0] = points[k, 0] + length * math.cos(course)
        points[k + 1, 1] = points[k, 1] + length * math.sin(course)


@kernel
def _draw_path(
    words: np.ndarray, ranges: np.ndarray, heading: float, points: np.ndarray, errors: np.ndarray
) -> None:
    """Draw a path for a first heading, and write the errors there.

    ``words`` (4,) start a generator, and become it.
    """
    u = alloca_f64(_DRAWS_MAX)
    start_stream(words, words)
    fill_uniform(words, u[: 2 * ranges.shape[0]])
    chain_legs(u, ranges, heading, points)
    path_errors(0.0, 0.0, heading, points, 0, errors)


class FreeManoeuvre(Task):
    """No goal, no reward, no end but capsizing; the path ahead is a line to the north."""

    def ranges(self) -> Ranges:
        """See :meth:`Task.ranges`."""
        return [(0.0, 1e4, 1e4)]


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

    def ranges(self) -> Ranges:
        """See :meth:`Task.ranges`."""
        low, high = 10.0 * self.length, 20.0 * self.length
        return [(21.0, low, high)] + [(70.0, low, high)] * (self.legs - 1)


class WayPoints(PathFollowing):
    """Visit way points anywhere around, 12 to 30 lengths apart: turns of up to 140 degrees."""

    def ranges(self) -> Ranges:
        """See :meth:`Task.ranges`."""
        low, high = 12.0 * self.length, 30.0 * self.length
        return [(42.0, low, high)] + [(140.0, low, high)] * (self.legs - 1)


class Curves(PathFollowing):
    """Follow a smooth curve: bends of 60 to 150 degrees with radii of 6 to 12 lengths.

    It is made of legs of one length each, and the next begins where the boat passes the end of
    the one before.
    """

    legs = 120
    reach = 0.0

    def path(self, rng: np.random.Generator) -> np.ndarray:
        """See :meth:`Task.path`."""
        angle, radius, side = rng.random((_BENDS, 3)).T
        angle, radius = np.radians(60.0 + 90.0 * angle), 6.0 + 6.0 * radius
        bends = np.repeat(
            np.where(side < 0.5, -1.0, 1.0) / radius, np.rint(angle * radius).astype(int)
        )
        courses = np.cumsum(np.concatenate([np.zeros(5), bends])[: self.legs])
        return _chain(courses, np.full(self.legs, self.length))


class LawnMower(PathFollowing):
    """Sweep a field: parallel legs of 14 to 24 lengths, 4 to 7 lengths apart."""

    legs = 9

    def path(self, rng: np.random.Generator) -> np.ndarray:
        """See :meth:`Task.path`."""
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
    together. The deck point is that of the environment's ``deck_point``.
    """

    legs = 1
    motion = 0.5
    loose = 3.0
    area = 10.0

    def ranges(self) -> Ranges:
        """See :meth:`Task.ranges`."""
        length = SEAKEEPING_TIME_S * self.rules["speed"].item()
        return [(60.0, length, length)]


class StationKeeping(Task):
    """Go to a point 4 to 8 lengths away, ahead or to one side, and stay there.

    Reward per step of ``dt``, from the truth: ``distance`` (minus half the distance in units),
    ``speed`` (minus a tenth of the speed over ground over the nominal speed), ``effort`` and
    ``failure`` as on a path. The boat succeeds while it is within two lengths; the episode ends
    with failure 10 units away or capsized. Errors are those of the leg to the point: how far
    to starboard of it, and how far to go.
    """

    kind = STATION
    terms = STATION_TERMS
    area = 10.0

    def ranges(self) -> Ranges:
        """See :meth:`Task.ranges`."""
        return [(90.0, 4.0 * self.length, 8.0 * self.length)]


class Docking(Task):
    """Go into a berth and come to rest there, in wind and current.

    The berth lies behind a way point, 5 to 9 lengths ahead and within 60 degrees to a side; from
    there it is 4 to 6 lengths to the berth, after a turn of up to 60 degrees. The boat has docked,
    and the episode ends with success, when three hold at once: its origin is within half a length
    of the berth, its heading within 20 degrees of the berth's, and its speed over ground below a
    tenth of the nominal one (or 0.25 m/s, if that is more). It ends with failure when the boat is a
    length beyond the berth, which is the quay, 5 units (50 m) to the side of the leg, or capsized.

    Reward per step of ``dt``, from the truth: ``distance`` is minus half the way to go in units,
    ``speed`` minus half of what the speed over ground exceeds the nominal one that is left: all of
    it at six lengths from the berth, none there. ``heading`` is minus 0.25 (1 - cos) of the angle
    to the berth on the last leg. ``effort`` and ``failure`` are as on a path.
    """

    kind = DOCK
    terms = DOCK_TERMS
    legs = 2

    def ranges(self) -> Ranges:
        """See :meth:`Task.ranges`."""
        L = self.length
        return [(60.0, 5.0 * L, 9.0 * L), (60.0, 4.0 * L, 6.0 * L)]


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
    "docking": Docking,
    "seakeeping": Seakeeping,
    "free": FreeManoeuvre,
}
"""Name to task."""


def make_task(
    name: str | type[Task],
    n: int,
    speed: float,
    length: float,
    motion: float | None = None,
    weights: Mapping[str, float] | None = None,
) -> Task:
    """Return the task of that name for n boats.

    ``name`` is one of :data:`TASKS`, ``module:Class`` of a file of your own, or a class. Others are
    the parameters of :class:`Task`. TaskError: there is no such task.
    """
    kind: Any = name
    if isinstance(name, str):
        own = ":" in name
        kind = import_named(name, TaskError, f"task = {name!r}") if own else TASKS.get(name)
    if not (isinstance(kind, type) and issubclass(kind, Task)):
        hint = did_you_mean(name, TASKS) if isinstance(name, str) else ""
        raise TaskError(
            f"no task is called {name!r}{hint}; known: {', '.join(TASKS)}; one of your own: "
            "module:Class of a subclass of usv_gym.envs.tasks.Task"
        )
    task = kind(n, speed, length, motion, weights)
    if task.is_own and task.rules["motion"] > 0.0:
        raise TaskError(
            f"motion_penalty = {motion}: {kind.__name__} rates its steps itself; give it a term"
        )
    return task
