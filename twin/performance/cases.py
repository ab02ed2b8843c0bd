"""What ``usv-twin bench`` times: environments, filters, predictors and ships.

An operation is a step of one boat, an update of a filter, a row or a refit of a predictor, or a
prediction. Environments turn in sea state 2 with 100 wave components, in the task ``free`` and
without a time limit, so that no episode ends meanwhile. Their bursts are long enough to contain
what is done only now and then: new noise, forecasts, refits.
"""

from __future__ import annotations

import dataclasses
import gc
import math
import os
import subprocess
import sys
import tempfile
import tracemalloc
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

import usv_gym  # noqa: F401 - registers the environment
from twin.channels import U
from twin.digital_twin import Twin
from twin.filters.ukf import UKFWorkspace, measurement_update, workspace
from twin.identification.filter_settings import plain_settings
from twin.identification.joint_ukf import JointUKF
from twin.model.augmented import JointConfig, JointState, JointWorkspace, joint_predict
from twin.model.dynamics import derivative, model_of
from twin.model.structure import N_STATES, N_TERMS, ModelTerms
from twin.performance.harness import BASELINE, Burst, Case
from twin.predictors.ukf import plain
from twin.sim.bridge import particulars_of, simulate
from usv_gym import SeaState, Vessel
from usv_gym.physics import ship
from usv_gym.physics.waves import WAVE_ROWS, factor_workspace
from usv_gym.world.realisation import load_rows
from usv_kernel.errors import UsvTwinError
from usv_kernel.jit import kernel
from usv_kernel.simd import padded
from usv_kernel.warmup import QUIET

__all__ = [
    "BOATS",
    "CASES",
    "COLD_COMPILES",
    "MEMORY",
    "CompileError",
    "cold_compile_seconds",
    "memory_per_boat",
    "select_cases",
]

Array = NDArray[np.float64]


class CompileError(UsvTwinError):
    """A process that was to compile all kernels ended with an error."""


STEPS = 512
"""Environment steps in a burst: one boat's block of noise."""

BATCH, BATCH_STEPS = 256, 120
"""Boats in a batch, and steps in its burst: three forecasts, about a block of noise."""

WINDOW = 30
"""Rows of the sliding window."""


def select_cases(only: str = "") -> list[Case]:
    """Return the cases with a text in their names (any case), and those they are compared with."""
    found = {c.name for c in CASES if only.lower() in c.name.lower()}
    for case in CASES:
        if case.name in found:
            found |= {case.relative_to or case.name}
            found |= {BASELINE} if case.target else set()
    return [case for case in CASES if case.name in found]


# environments
def _step(env_id: str, action: Any, **options: Any) -> Burst:
    env = gym.make(env_id, max_episode_steps=10**9, **options)
    env.reset(seed=0)

    def run() -> None:
        for _ in range(STEPS):
            env.step(action)

    return run, STEPS


def _sail(twin: str | None, **options: Any) -> Burst:
    return _step("USVTwin-v0", AHEAD, task="free", twin=twin, **options)


def _sail_with_full_window(twin: str, steps: int = 2400) -> Burst:
    """Step an environment with a twin that has filled its window."""
    burst = _sail(twin)
    for _ in range(math.ceil(steps / burst[1])):
        burst[0]()
    return burst


AHEAD = np.array([0.8, 0.1], np.float32)
"""Shaft speed and drive angle of a wide turn."""


def batch(twin: str | None, boats: int = BATCH) -> Burst:
    """Return a burst of steps of a batch of boats; the count is of batch steps."""
    envs = make_boats(twin, boats)
    actions = np.tile(AHEAD, (boats, 1))

    def run() -> None:
        for _ in range(BATCH_STEPS):
            envs.step(actions)

    return run, BATCH_STEPS


def make_boats(twin: str | None, boats: int) -> gym.vector.VectorEnv[Any, Any, Any]:
    """Return a batch of boats after its reset."""
    options: dict[str, Any] = {"task": "free", "max_episode_steps": None, "num_threads": 1}
    envs = gym.make_vec("USVTwin-v0", num_envs=boats, twin=twin, **options)
    envs.reset(seed=0)
    return envs


def _per_boat(twin: str | None) -> Burst:
    """Count the steps of boats, not those of the batch."""
    run, steps = batch(twin)
    return run, steps * BATCH


# filters
H = 0.05
"""Time between rows, s."""

ANGLE = 2
"""Which of the states is an angle."""


@kernel
def _update_often(count, predict, correct):
    """Predict and correct ``count`` times.

    The arguments are plain tuples, which numba takes from Python much faster than named ones.
    """
    (x, P, act, wind), dt, (model, weights), (Q, q_xi, terms, sigma) = predict
    which, limits, hull = model
    points, root, slope, scratch = sigma
    sigma_work = UKFWorkspace(points, root, slope, scratch)
    state = JointState(x, P, act, wind)
    config = JointConfig(ModelTerms(which, limits, hull), weights)
    work = JointWorkspace(Q, q_xi, terms, sigma_work)
    z, mask, R, angle, gate = correct
    for _ in range(count):
        joint_predict(state, dt, config, work)
        measurement_update(x, P, z, mask, R, angle, gate, sigma_work)


class Problem:
    """One filtering problem of 6 states and 25 parameters, as every filter gets it.

    ``z`` (6,) are the measured states, again and again; ``Q``, ``R`` (6, 6) the noise of a step,
    and of a measurement.
    """

    def __init__(self) -> None:
        self.boat = particulars_of(Vessel.load("usv75"))
        settings, structure = plain_settings(self.boat), model_of(self.boat, "paper")
        self.settings = dataclasses.replace(
            settings,
            structure=structure,
            q_xi=np.zeros(len(structure)),
            xi0=structure.mean,
            xi0_cov=np.diag(structure.sd**2),
        )
        self.ukf = JointUKF(self.boat, self.settings)
        n = self.boat.shaft_speed * self.settings.n_unit
        self.ukf.x[U], self.ukf.act[:] = self.boat.speed, (n, n, 0.1, 0.1)
        self.x, self.P, self.z = self.ukf.x.copy(), self.ukf.P.copy(), self.ukf.x[:N_STATES].copy()
        self.Q, self.R = 1e-4 * np.eye(N_STATES), 0.1 * np.eye(N_STATES)
        self._terms, self._rate = np.zeros(N_TERMS), np.zeros(N_STATES)

    def move(self, x: Array, dt: float) -> Array:
        """Return the model's step from one sigma point."""
        s, xi, ukf = x[:N_STATES], x[N_STATES:], self.ukf
        derivative(s, xi, ukf.act, ukf.wind, ukf.terms, self._terms, self._rate)
        return np.concatenate([s + dt * self._rate, xi])

    def begin(self) -> None:
        """Put the structured filter back to the start."""
        self.ukf.x[:], self.ukf.P[:] = self.x, self.P

    def arguments(self) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
        """Return those of :func:`_update_often`."""
        ukf, mask = self.ukf, np.ones(N_STATES, dtype=bool)
        sigma = workspace(N_STATES, len(ukf.xi))
        state = JointState(ukf.x, ukf.P, ukf.act, ukf.wind)
        scratch = JointWorkspace(self.Q, self.settings.q_xi, self._terms, sigma)
        before = (state, H, JointConfig(ukf.terms, ukf.weights), scratch)
        return plain(before), (self.z, mask, self.R, ANGLE, math.inf)

    def filterpy(self) -> Any:
        """Return filterpy's filter at the start."""
        from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

        points = MerweScaledSigmaPoints(len(self.x), 1.0, 2.0, 0.0)
        ukf = UnscentedKalmanFilter(len(self.x), N_STATES, H, _states, self.move, points)
        ukf.x, ukf.P, ukf.R = self.x.copy(), self.P.copy(), self.R
        ukf.Q = np.zeros_like(self.P)
        ukf.Q[:N_STATES, :N_STATES] = self.Q
        return ukf


def _states(x: Array) -> Array:
    return x[:N_STATES]


def _structured(count: int = 200) -> Burst:
    problem = Problem()
    predict, correct = problem.arguments()

    def run() -> None:
        problem.begin()
        _update_often(count, predict, correct)

    return run, count


def _structured_from_python(count: int = 200) -> Burst:
    problem = Problem()
    predict, correct = problem.arguments()

    def run() -> None:
        problem.begin()
        for _ in range(count):
            _update_often(1, predict, correct)

    return run, count


def _filterpy(count: int = 10) -> Burst:
    problem = Problem()
    ukf = problem.filterpy()

    def run() -> None:
        ukf.x, ukf.P = problem.x.copy(), problem.P.copy()
        for _ in range(count):
            ukf.predict()
            ukf.update(problem.z)

    return run, count


def _filterpy_window() -> Burst:
    return _filterpy(WINDOW - 1)[0], 1


# twins
ROWS = 20
"""Rows in a second."""


def _running_twin(name: str, **options: Any) -> tuple[Twin, Callable[[], None]]:
    """Return a twin after two minutes, and a function that gives it another second of rows."""
    vessel = Vessel.load("usv75")
    log = simulate("zigzag", vessel=vessel, sea=SeaState.named("2"), duration=120.0, seed=0)
    twin = Twin(particulars_of(vessel), name, **options)
    twin.run(log)
    predictor: Any = twin.predictor
    rows = list(zip(log.z[-ROWS:], log.cmd[-ROWS:], strict=True))

    def second() -> None:
        t = predictor.t
        for k, (z, cmd) in enumerate(rows):
            predictor.update(t + H * (k + 1), H, z, cmd)

    return twin, second


def _rows(name: str, **options: Any) -> Burst:
    return _running_twin(name, **options)[1], ROWS


def window(rows: int = WINDOW) -> Burst:
    """Return a burst of re-runs of the dynamic window over so many rows."""
    twin = _running_twin("dsw-ukf", window="fixed", w_min=rows, w_max=rows + 1)[0]
    predictor: Any = twin.predictor
    return partial(predictor._restart, rows), 1


def prediction(name: str, horizon: float = 10.0) -> Burst:
    """Return a burst of predictions with their intervals."""
    twin = _running_twin(name)[0]
    return lambda: twin.predict(horizon=horizon), 1


# ships
SHIP_STEPS = 200


def sail_ship(dof: int, components: int) -> Burst:
    """Return a burst of steps of a ship alone, in so many wave components."""
    boat, rng = Vessel.load("usv75"), np.random.default_rng(0)
    state = SeaState(hs=0.5 if components else 0.0, wind=4.5, components=max(components, 1))
    sea = state.realise(boat, rng, rng)
    states, work = np.zeros((SHIP_STEPS + 1, 16)), np.zeros((ship.WORK_ROWS, 16))
    states[0, 6] = 5.6
    waves = np.zeros((WAVE_ROWS, padded(sea.waves.shape[1])))
    waves[:, : sea.waves.shape[1]] = sea.waves
    factors = factor_workspace(waves.shape[1])
    cmds = np.tile(boat.command(20.4, 0.1), (SHIP_STEPS, 1))
    loads = load_rows(boat, waves)
    around = ship.Sea(waves, sea.gusts, sea.weather, factors, loads)
    vessel = ship.Ship(boat.packed, dof)
    return lambda: ship.sail(states, cmds, vessel, around, H, work), SHIP_STEPS


BOATS = 64
"""Boats in the batch whose memory is measured."""


def memory_per_boat(twin: str | None) -> float:
    """Return the memory that a boat of a batch of :data:`BOATS` takes, byte.

    Counted is what Python's and numpy's allocators know of.
    """
    make_boats(twin, 2).step(np.tile(AHEAD, (2, 1)))  # compiles, and makes what all boats share
    gc.collect()
    tracemalloc.start()
    try:
        envs = make_boats(twin, BOATS)
        envs.step(np.tile(AHEAD, (BOATS, 1)))
        gc.collect()
        return tracemalloc.get_traced_memory()[0] / BOATS
    finally:
        tracemalloc.stop()


MEMORY: dict[str, tuple[str | None, float | None]] = {
    f"memory of a boat in a batch of {BOATS}": (None, None),
    f"memory of a boat with ukf in a batch of {BOATS}": ("ukf", 75e3),
}
"""The twin of each batch, and the limit on the memory of a boat, byte."""

_FIRST_USE = """
import time
import gymnasium as gym
import usv_gym

for options in {options}:
    env = gym.make("USVTwin-v0", **options)
    env.action_space.seed(0)
    env.reset(seed=0)
    for _ in range(60):
        env.step(env.action_space.sample())
print(time.process_time())
"""


def cold_compile_seconds(options: Sequence[dict[str, Any]]) -> float:
    """Return the CPU time (s) of a process that compiles all kernels and steps environments.

    ``options`` are those of ``gym.make``. CompileError has its last line if the process failed.
    """
    with tempfile.TemporaryDirectory() as empty:
        done = subprocess.run(
            [sys.executable, "-c", _FIRST_USE.format(options=list(options))],
            env={**os.environ, "NUMBA_CACHE_DIR": empty, QUIET: "1"},
            capture_output=True,
            text=True,
        )
    if done.returncode:
        raise CompileError(
            done.stderr.strip().rpartition("\n")[2] or f"ended with {done.returncode}"
        )
    return float(done.stdout)


COLD_COMPILES: dict[str, tuple[tuple[dict[str, Any], ...], float | None]] = {
    "first use of the environment": (({},), None),
    "first use of everything": (({}, {"twin": "ukf"}, {"twin": "dsw-ukf"}, {"dof": 6}), 30.0),
}
"""Environments by name, and the limit on the CPU time of their first use, s."""

_FILTERPY, _FILTERPY_WINDOW = "filterpy UKF 6 + 25", f"filterpy window W = {WINDOW}"

CASES: tuple[Case, ...] = (
    Case(BASELINE, lambda: _step("Pendulum-v1", np.zeros(1, np.float32))),
    Case("env, 3-DOF", lambda: _sail(None), BASELINE, 150e3, 1.5),
    Case("env, 6-DOF", lambda: _sail(None, dof=6), BASELINE, 80e3),
    Case("env with ukf", lambda: _sail("ukf"), BASELINE, 70e3),
    Case("env with dsw-ukf-plus", lambda: _sail_with_full_window("dsw-ukf-plus"), BASELINE, 3e3),
    Case(f"batch of {BATCH}", lambda: _per_boat(None), BASELINE, 300e3),
    Case(f"batch of {BATCH}, ukf", lambda: _per_boat("ukf"), BASELINE, 120e3),
    Case(_FILTERPY, _filterpy),
    Case("UKF 6 + 25 in-kernel", _structured, _FILTERPY, target_ratio=300.0),
    Case("UKF 6 + 25 from Python", _structured_from_python, _FILTERPY),
    Case(_FILTERPY_WINDOW, _filterpy_window),
    Case(f"dsw-ukf window W = {WINDOW}", window, _FILTERPY_WINDOW, target_ratio=300.0),
    Case("row of ukf", lambda: _rows("ukf")),
    Case("row of dsw-ukf", lambda: _rows("dsw-ukf"), "row of ukf"),
    Case("row of dsw-ukf-plus", lambda: _rows("dsw-ukf-plus"), "row of ukf"),
    Case("refit of dsw-ukf-plus", lambda: _rows("dsw-ukf-plus", period=H), "row of ukf"),
    Case("10 s prediction of ukf", lambda: prediction("ukf")),
    Case("10 s prediction of dsw-ukf", lambda: prediction("dsw-ukf"), "10 s prediction of ukf"),
    Case(
        "10 s prediction of dsw-ukf-plus",
        lambda: prediction("dsw-ukf-plus"),
        "10 s prediction of ukf",
    ),
    Case("ship, 3-DOF, 0 waves", lambda: sail_ship(3, 0)),
    Case("ship, 3-DOF, 100 waves", lambda: sail_ship(3, 100), "ship, 3-DOF, 0 waves"),
    Case("ship, 6-DOF, 0 waves", lambda: sail_ship(6, 0)),
    Case("ship, 6-DOF, 100 waves", lambda: sail_ship(6, 100), "ship, 6-DOF, 0 waves"),
)
"""All that is compared."""
