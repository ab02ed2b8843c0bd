"""Long runs that look for what breaks: garbage for every predictor, and many steps of boats."""

from __future__ import annotations

import gc
import heapq
import math
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import suppress
from itertools import islice
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from twin.channels import COMMANDS, MEASUREMENTS
from twin.digital_twin import Twin, TwinError, known_plan
from twin.sim.bridge import particulars_of, simulate
from usv_gym.envs.episodes import BOUND, CapsizeWarning
from usv_gym.vessel.vessel import Vessel, vessel_names
from usv_gym.world.sea import SEA_STATES, SeaState

__all__ = [
    "EnvironmentSoak",
    "GarbageSoak",
    "garbage_rows",
    "inspect_twin",
    "resident_memory",
    "soak_environments",
    "soak_predictor",
]

Array = NDArray[np.float64]

BEFORE, AFTER = 60.0, 75.0
"""Clean sailing before and after the garbage, s."""

HORIZON, SPAN, FACTOR, FREE = 10.0, 5.0, 1.5, 0.2
"""Errors of the forecast of the horizon (s), averaged over the span (s), are normal within this
factor of those of a twin without garbage, and this (m)."""

EXTREMES = np.array([
    *(math.nan, math.inf, -math.inf, 0.0, -0.0, 5e-324, 1e-300, 1e300, -1e300, 1e9, -1e9, 1e6),
    *(1e3, -1e3, 90.0, 180.0, 360.0, 2.0**53, 0.1, -1.0, 1.0),
])  # fmt: skip
"""Values that break programs."""

SLOWEST = 5
"""The row that is the fifth slowest counts as the slowest. The four before it are left to the
operating system, which takes milliseconds in about one row of a million."""

WARM_UP = 1000
"""Rows of garbage before anything is measured."""

BLOCK = 1000
"""Rows of garbage drawn at a time."""

BOATS = 64
"""Boats of an environment that is soaked."""

ACTION_STEPS = 40
"""Steps for which a random action is held."""


class GarbageSoak(NamedTuple):
    """What a predictor did with garbage, and after it."""

    predictor: str
    rows: int
    refused: int  # rows whose stamps or commands Twin.step refused, in words
    crashes: int  # rows that raised anything else
    not_finite: int  # estimates and forecasts that were not finite
    not_definite: int  # covariances with a negative eigenvalue
    slowest: float  # slowest row of garbage over the slowest clean one; see SLOWEST
    mean: float  # the same of the means
    normal_after: float  # s of clean rows until the forecasts are normal; inf if never
    growth: float  # of the memory, MB


class EnvironmentSoak(NamedTuple):
    """What one kind of environment did."""

    vessel: str
    sea: str
    dof: int
    steps: int
    crashes: int
    not_finite: int  # observations and rewards that were not finite or in their space
    growth: float  # of the memory, MB


def resident_memory() -> float:
    """Return the memory in use, MB; nan where the system does not tell."""
    try:
        with open("/proc/self/statm", encoding="ascii") as file:  # noqa: PTH123
            return int(file.read().split()[1]) * 4096 / 1e6
    except OSError:
        return math.nan


def garbage_rows(rng: np.random.Generator, begin: float) -> Iterator[tuple[float, Array, Array]]:
    """Yield time (s), measurements (19,) and commands (4,) of rows without sense, for ever.

    Values are any bits of a double, extremes, or plausible numbers; cells are missing; stamps stand
    still, go back, or jump by up to an hour.
    """
    t, width = begin, len(MEASUREMENTS) + len(COMMANDS)
    while True:
        kind = rng.integers(5, size=(BLOCK, width))
        bits = rng.integers(2**64, size=(BLOCK, width), dtype=np.uint64).view(np.float64)
        plausible = 10.0 ** rng.uniform(-3, 4, (BLOCK, width)) * rng.choice([-1, 1], (BLOCK, width))
        values = np.choose(
            kind, [bits, rng.choice(EXTREMES, (BLOCK, width)), plausible, np.nan, plausible]
        )
        # whole stretches are finite, so that Twin.step does not refuse all of them
        calm = rng.random(BLOCK) < 0.7
        commands = values[:, len(MEASUREMENTS) :]
        commands[calm] = np.where(np.isfinite(commands[calm]), commands[calm], 0.0)
        steps = rng.choice([0.05, 0.05, 0.05, 0.05, 1e-9, 0.0, -1.0, 3.0, 3600.0], BLOCK)
        steps = np.where(rng.random(BLOCK) < 0.95, 0.05, steps)
        for row, step in zip(values, steps, strict=True):
            stamp = t + step
            t = max(t, stamp)
            yield stamp, row[: len(MEASUREMENTS)], row[len(MEASUREMENTS) :]


class _Errors(NamedTuple):
    """Errors of forecasts: when they were made, s, and how far off they were, m."""

    t: list[float]
    error: list[float]


def soak_predictor(
    name: str,
    rows: int,
    seed: int,
    progress: Callable[[int], None] = lambda done: None,
) -> GarbageSoak:
    """Feed a predictor clean rows, garbage and clean rows again.

    Parameters
    ----------
    name : str
        One of ``twin.PREDICTORS``.
    rows : int
        Rows of garbage.
    seed : int
        Of run and garbage.
    progress : callable
        Called with the number of rows of garbage that are done.
    """
    boat = Vessel.load("usv75")
    duration = BEFORE + AFTER + HORIZON
    log = simulate("random", vessel=boat, sea=SeaState.named("2"), duration=duration, seed=seed)
    clean, twin = (Twin(particulars_of(boat), name, seed=seed) for _ in range(2))
    middle = int(np.searchsorted(log.t, BEFORE))
    # the first rows compile, also the first of garbage
    _sail(twin, log, 0, len(log), 0.0)
    for row in islice(garbage_rows(np.random.default_rng(seed + 1), twin.t), WARM_UP):
        with suppress(TwinError):
            twin.step(*row)
    twin.reset()
    normal, times = _sail(clean, log, 0, len(log), 0.0)
    _sail(twin, log, 0, middle, 0.0)
    rng = np.random.default_rng(seed)
    counts = dict.fromkeys(("refused", "crashes", "not_finite", "not_definite"), 0)
    slow, total, done = [0.0] * SLOWEST, 0.0, 0
    memory = resident_memory()
    gc.disable()  # Python's collections of the whole program are no row's
    for t, z, cmd in garbage_rows(rng, float(log.t[middle - 1])):
        begun = time.thread_time()
        try:
            twin.step(t, z, cmd)
        except TwinError:
            counts["refused"] += 1
        except Exception:  # whatever it is, it is counted
            counts["crashes"] += 1
        took = time.thread_time() - begun
        heapq.heappushpop(slow, took)
        total, done = total + took, done + 1
        if done % BLOCK == 0:
            gc.collect()
            inspect_twin(twin, counts)
            progress(done)
        if done == BLOCK:
            memory = resident_memory()  # histories have reached their size
        if done == rows:
            break
    gc.enable()
    growth = resident_memory() - memory
    shift = twin.t - float(log.t[middle - 1])
    after = _sail(twin, log, middle, len(log), shift, counts)[0]
    return GarbageSoak(
        name,
        rows,
        **counts,
        slowest=float(slow[0] / times.max()),
        mean=float(total / rows / times.mean()),
        normal_after=_normal_after(after, normal),
        growth=growth,
    )


def _sail(
    twin: Twin,
    log: Any,
    first: int,
    end: int,
    shift: float,
    counts: dict[str, int] | None = None,
) -> tuple[_Errors, Array]:
    """Feed rows of a log; return errors of forecasts made each second, and the times of rows, s."""
    found, took = _Errors([], []), []
    for k in range(first, end):
        begun = time.thread_time()
        twin.step(float(log.t[k]) + shift, log.z[k], log.cmd[k])
        took.append(time.thread_time() - begun)
        if k % 20 or log.t[k] + HORIZON > log.t[-1]:
            continue
        prediction = twin.predict(known_plan(log, k, HORIZON, 0.25), dt=0.25)
        if counts is not None:
            inspect_twin(twin, counts)
        later = int(np.searchsorted(log.t, log.t[k] + HORIZON))
        found.t.append(float(log.t[k]))
        found.error.append(float(np.hypot(*(prediction.mean[-1, :2] - log.truth[later, :2]))))
    return found, np.array(took)


def inspect_twin(twin: Twin, counts: dict[str, int]) -> None:
    """Count what is wrong with an estimate and a forecast."""
    estimate, prediction = twin.estimate(), twin.predict("hold")
    numbers = (estimate.state, prediction.mean, prediction.cov, prediction.low, prediction.high)
    if not all(np.isfinite(part).all() for part in numbers):
        counts["not_finite"] += 1
        return
    scale = np.abs(prediction.cov).max(axis=(1, 2), keepdims=True) + 1e-300
    if np.linalg.eigvalsh(prediction.cov / scale).min() < -1e-9:
        counts["not_definite"] += 1


def _normal_after(after: _Errors, normal: _Errors) -> float:
    """Return how long after the garbage errors are normal, s; inf if never."""
    t, error = np.array(after.t), np.array(after.error)
    clean_error = np.interp(t, normal.t, normal.error)
    for begin in t[t <= t[-1] - SPAN]:
        span = (t >= begin) & (t < begin + SPAN)
        if error[span].mean() <= FACTOR * clean_error[span].mean() + FREE:
            return float(begin - BEFORE)
    return math.inf


def soak_environments(
    steps: int, seed: int, progress: Callable[[int], None] = lambda done: None
) -> Iterator[EnvironmentSoak]:
    """Step boats of every vessel in every sea, with all faults, with 3 and 6 degrees of freedom.

    ``steps`` are those of all boats together; ``progress`` is called with how many are done.
    """
    kinds = [
        (v, s, dof) for v in vessel_names() for s in SEA_STATES if s.isdigit() for dof in (3, 6)
    ]
    rng = np.random.default_rng(seed)
    done = 0
    for k, (vessel, sea, dof) in enumerate(kinds):
        wanted = -(-(steps - done) // (len(kinds) - k))
        each = max(-(-wanted // BOATS), 1)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", CapsizeWarning)  # here boats may
            env = gym.make_vec(
                "USVTwin-v0",
                num_envs=BOATS,
                vessel=vessel,
                sea=sea,
                dof=dof,
                faults="on",
                twin=None,
            )
        crashes = not_finite = 0
        env.reset(seed=int(rng.integers(2**31)))
        memory = resident_memory()
        for j in range(each):
            if j % ACTION_STEPS == 0:
                action = rng.uniform(-1.2, 1.2, env.action_space.shape).astype(np.float32)
            try:
                observation, reward = env.step(action)[:2]
            except Exception:  # whatever it is, it is counted
                crashes += 1
                env.reset(seed=int(rng.integers(2**31)))
                continue
            inside = (np.abs(observation) <= BOUND).all()  # NaN is not
            not_finite += not (inside and np.isfinite(reward).all())
        done += each * BOATS
        env.close()
        progress(done)
        growth = resident_memory() - memory
        yield EnvironmentSoak(vessel, sea, dof, each * BOATS, crashes, not_finite, growth)
