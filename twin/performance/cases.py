"""How fast the package is, beside its peers, in one run.

A :class:`Case` does some operation over and over; :func:`measure` lets all cases take turns, a
short burst each, round after round, so that whatever else the machine does hits all of them alike.
What counts are medians over the rounds, and the ratios between cases of the same round.

An operation is a step of one boat, an update of a filter, a row or a refit of a predictor, a
prediction, or a frame of learning.

Environments sail a turn in sea state 2 with 100 wave components, in the task ``free`` and without
a limit of time: no episode ends while it is measured. A burst of theirs is long enough to hold
what is done now and then: new noise, new bands, refits. Peers that are not installed are left out.
"""

from __future__ import annotations

import gc
import math
import os
import subprocess
import sys
import tempfile
import tracemalloc
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

import usv_gym  # noqa: F401 - registers the environment
from twin.digital_twin import Twin
from twin.filters.ukf import measurement_update, workspace
from twin.identification.filter_settings import plain_settings
from twin.identification.joint_ukf import JointUKF
from twin.model.augmented import JointConfig, JointState, JointWorkspace, joint_predict
from twin.model.dynamics import derivative
from twin.model.structure import N_STATES, N_TERMS
from twin.performance.harness import FLOOR, Burst, Case, Measured
from twin.sim.bridge import particulars_of, simulate
from usv_gym import SeaState, Vessel
from usv_gym.physics import ship
from usv_gym.physics.waves import WAVE_ROWS, factor_workspace
from usv_kernel.jit import kernel
from usv_kernel.simd import padded
from usv_kernel.warmup import QUIET

__all__ = [
    "BOATS",
    "CASES",
    "CURVES",
    "FIRST_USES",
    "MEMORY",
    "Curve",
    "Line",
    "chosen",
    "first_use",
    "fit",
    "growth_cases",
    "growth_rows",
    "memory_per_boat",
]

Array = NDArray[np.float64]

STEPS = 512
"""Environment steps in a burst: one boat's block of noise."""

BATCH, BATCH_STEPS = 256, 120
"""Boats in a batch, and steps in its burst: three renewals of the bands, about a block of noise."""

WINDOW = 30
"""Rows of the sliding window."""


def chosen(only: str = "", *, quick: bool = False) -> list[Case]:
    """Return cases, and those that they are compared with.

    Parameters
    ----------
    only : str
        Part of the names, in any case of letters; all if empty.
    quick : bool
        Leave the slow ones out.
    """
    found = {c.name for c in CASES if only.lower() in c.name.lower() and not (quick and c.slow)}
    for case in CASES:
        if case.name in found:
            found |= {case.relative_to or case.name}
            found |= {FLOOR} if case.must else set()
    return [case for case in CASES if case.name in found]


# environments
def _endless(env_id: str, **kwargs: Any) -> gym.Env[Any, Any]:
    return gym.make(env_id, max_episode_steps=10**9, **kwargs)


def _sailing(**kwargs: Any) -> gym.Env[Any, Any]:
    return _endless("USVTwin-v0", task="free", **kwargs)


AHEAD = np.array([0.8, 0.1], np.float32)
"""Shaft speed and drive angle of a wide turn."""


def _stepping(env: gym.Env[Any, Any], action: Any, ends: bool = False) -> Burst:
    env.reset(seed=0)

    def run() -> None:
        step = env.step
        for _ in range(STEPS):
            _, _, terminated, truncated, _ = step(action)
            if ends and (terminated or truncated):
                env.reset()

    return run, STEPS


def _with_a_past(burst: Burst, steps: int = 2400) -> Burst:
    """Let a twin sail until its window is full."""
    for _ in range(math.ceil(steps / burst[1])):
        burst[0]()
    return burst


def _gym_sailing() -> Burst:
    import gym_sailing  # noqa: F401

    env = gym.make("Motorboat-v0")
    return _stepping(env, env.action_space.sample(), ends=True)


def _batch(twin: str | None, boats: int = BATCH, threads: int = 1) -> Burst:
    envs = _boats(twin, boats, threads)
    actions = np.tile(AHEAD, (boats, 1))

    def run() -> None:
        for _ in range(BATCH_STEPS):
            envs.step(actions)

    return run, BATCH_STEPS


def _boats(twin: str | None, boats: int, threads: int = 1) -> gym.vector.VectorEnv[Any, Any, Any]:
    options: dict[str, Any] = {"task": "free", "max_episode_steps": None, "num_threads": threads}
    envs = gym.make_vec("USVTwin-v0", num_envs=boats, twin=twin, **options)
    envs.reset(seed=0)
    return envs


def _of_all(twin: str | None, threads: int) -> Burst:
    """Count the steps of boats, not those of the batch."""
    run, steps = _batch(twin, threads=threads)
    return run, steps * BATCH


def _cart_poles() -> Burst:
    envs = gym.make_vec("CartPole-v1", num_envs=BATCH, vectorization_mode="vector_entry_point")
    envs.reset(seed=0)
    actions = np.arange(BATCH) % 2

    def run() -> None:
        for _ in range(STEPS):
            envs.step(actions)

    return run, STEPS * BATCH


# filters
H = 0.05
"""Time between rows, s."""

ANGLE = 2
"""Which of the states is an angle."""


@kernel
def _update_often(count, state, h, config, work, z, mask, R):
    """Predict and correct ``count`` times; arguments as for the two kernels."""
    for _ in range(count):
        joint_predict(state, h, config, work)
        measurement_update(state.x, state.P, z, mask, R, ANGLE, math.inf, work.sigma)


class Problem:
    """One filtering problem of 6 states and 25 parameters, as every filter gets it.

    Attributes
    ----------
    x, P : ndarray, shapes (31,), (31, 31)
        Mean and covariance at the start.
    z : ndarray, shape (6,)
        The measured states, again and again.
    Q, R : ndarray, shape (6, 6)
        Noise of a step, and of a measurement.
    """

    def __init__(self) -> None:
        self.boat = particulars_of(Vessel.load("usv75"))
        self.settings = plain_settings(self.boat)
        self.ukf = JointUKF(self.boat, self.settings)
        n = self.boat.shaft_speed * self.settings.n_unit
        self.ukf.x[3], self.ukf.act[:] = self.boat.speed, (n, n, 0.1, 0.1)
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
        """Return those of the two kernels of the structured filter, prediction and correction."""
        ukf, mask = self.ukf, np.ones(N_STATES, dtype=bool)
        sigma = workspace(N_STATES, len(ukf.xi))
        state = JointState(ukf.x, ukf.P, ukf.act, ukf.wind)
        scratch = JointWorkspace(self.Q, self.settings.q_xi, self._terms, sigma)
        before = (state, H, JointConfig(ukf.terms, ukf.weights), scratch)
        return before, (ukf.x, ukf.P, self.z, mask, self.R, ANGLE, math.inf, sigma)

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
    arguments: tuple[Any, ...] = (count, *predict, *correct[2:5])

    def run() -> None:
        problem.begin()
        _update_often(*arguments)

    return run, count


def _structured_from_python(count: int = 200) -> Burst:
    problem = Problem()
    predict, correct = problem.arguments()

    def run() -> None:
        problem.begin()
        for _ in range(count):
            joint_predict(*predict)
            measurement_update(*correct)

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


def _stonesoup(count: int = 10) -> Burst:
    from datetime import datetime, timedelta

    from stonesoup.models.base import GaussianModel, TimeVariantModel
    from stonesoup.models.measurement.linear import LinearGaussian
    from stonesoup.models.transition.base import TransitionModel
    from stonesoup.predictor.kalman import UnscentedKalmanPredictor
    from stonesoup.types.array import StateVectors
    from stonesoup.types.detection import Detection
    from stonesoup.types.hypothesis import SingleHypothesis
    from stonesoup.types.state import GaussianState
    from stonesoup.updater.kalman import UnscentedKalmanUpdater

    problem, begun = Problem(), datetime(2025, 1, 1)
    Q = problem.filterpy().Q

    class Move(TransitionModel, GaussianModel, TimeVariantModel):
        ndim_state = len(problem.x)

        def function(self, state, noise=False, **kwargs):
            dt = kwargs["time_interval"].total_seconds()
            points = np.asarray(state.state_vector, float).T
            return StateVectors(np.column_stack([problem.move(point, dt) for point in points]))

        def covar(self, **kwargs):
            return Q

    sensor = LinearGaussian(len(problem.x), tuple(range(N_STATES)), problem.R)
    scaling = {"alpha": 1.0, "beta": 2.0, "kappa": 0.0}
    predictor = UnscentedKalmanPredictor(Move(), **scaling)
    updater = UnscentedKalmanUpdater(sensor, **scaling)

    def run() -> None:
        state = GaussianState(problem.x, problem.P, timestamp=begun)
        for k in range(count):
            now = begun + (k + 1) * timedelta(seconds=H)
            ahead = predictor.predict(state, timestamp=now)
            seen = Detection(problem.z, timestamp=now, measurement_model=sensor)
            state = updater.update(SingleHypothesis(ahead, seen))

    return run, count


# twins
ROWS = 20
"""Rows in a second."""


def _lived(name: str, **options: Any) -> tuple[Twin, Callable[[], None]]:
    """Return a twin that has lived for two minutes, and a function that gives it a second more."""
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
    return _lived(name, **options)[1], ROWS


def _window(rows: int = WINDOW) -> Burst:
    twin, _ = _lived("dsw-ukf", window="fixed", w_min=rows, w_max=rows + 1)
    predictor: Any = twin.predictor
    return partial(predictor._restart, rows), 1


def _prediction(name: str, horizon: float = 10.0) -> Burst:
    twin, _ = _lived(name)
    return lambda: twin.predict(horizon=horizon), 1


# ships
SHIP_STEPS = 200


def _ship(dof: int, components: int) -> Burst:
    boat, rng = Vessel.load("usv75"), np.random.default_rng(0)
    state = SeaState(hs=0.5 if components else 0.0, wind=4.5, components=max(components, 1))
    sea = state.realise(boat, rng, rng)
    states, work = np.zeros((SHIP_STEPS + 1, 16)), np.zeros((ship.WORK_ROWS, 16))
    states[0, 6] = 5.6
    waves = np.zeros((WAVE_ROWS, padded(sea.waves.shape[1])))
    waves[:, : sea.waves.shape[1]] = sea.waves
    factors = factor_workspace(waves.shape[1])
    cmds = np.tile(boat.helm(20.4, 0.1), (SHIP_STEPS, 1))
    vessel, around = ship.Ship(boat.packed, dof), ship.Sea(waves, sea.gusts, sea.weather, factors)
    return lambda: ship.sail(states, cmds, vessel, around, H, work), SHIP_STEPS


def _otter() -> Burst:
    from python_vehicle_simulator.lib import gnc
    from python_vehicle_simulator.vehicles import otter

    boat, control = otter(), np.array([60.0, 50.0])

    def run() -> None:
        eta, nu, actual = np.zeros(6), np.zeros(6), np.zeros(2)
        for _ in range(SHIP_STEPS):
            nu, actual = boat.dynamics(eta, nu, actual, control, H)
            eta = gnc.attitudeEuler(eta, nu, H)

    return run, SHIP_STEPS


def _shipmmg() -> Burst:
    """Let ShipMMG sail KVLCC2 for as many steps, its integrator free to choose its own."""
    from shipmmg import mmg_3dof

    v = Vessel.load("kvlcc2_l7").values
    L = v["length_waterline"]
    basic = mmg_3dof.Mmg3DofBasicParams(
        **{"L_pp": L, "B": v["beam"], "d": v["draft"], "D_p": v["propeller_diameter"]},
        **{"m": v["mass"], "I_zG": v["I_zz"], "x_G": v["x_G"], "A_R": v["A_R"]},
        **{"m_x": v["m_x"], "m_y": v["m_y"], "J_z": v["J_zz"]},
        **{"\u03b7": v["propeller_diameter"] / v["rudder_height"], "f_\u03b1": v["f_alpha"]},
        **{"\u03b5": v["epsilon"], "t_R": v["t_R"], "a_H": v["a_H"], "x_H": L * v["x_H_prime"]},
        **{f"\u03b3_R_{side}": v[f"gamma_R_{side}"] for side in ("plus", "minus")},
        **{"x_R": L * v["x_R_prime"], "x_P": v["x_P_prime"], "l_R": v["l_R_prime"]},
        **{"\u03ba": v["kappa"]},
        **{"t_P": v["thrust_deduction"], "w_P0": v["wake_fraction"]},
    )
    forces = [f"X_{k}" for k in ("vv", "vr", "rr", "vvvv")]
    forces += [f"{f}_{k}" for f in "YN" for k in ("v", "r", "vvv", "vvr", "vrr", "rrr")]
    manoeuvring = mmg_3dof.Mmg3DofManeuveringParams(
        *(v["k_0"], v["k_1"], v["k_2"], v["R_0"]), **{f"{name}_dash": v[name] for name in forces}
    )
    times = H * np.arange(SHIP_STEPS + 1)
    rudder, shaft = np.full(times.shape, 0.1), np.full(times.shape, 10.4)
    arguments = (basic, manoeuvring, times, rudder, shaft)
    start = {"u0": 1.179, "\u03c1": v["water_density"]}
    return lambda: mmg_3dof.simulate_mmg_3dof(*arguments, **start, t_eval=times), SHIP_STEPS


# learning
FRAMES = {"n_steps": 32, "batch_size": 256, "n_epochs": 10}

BOATS = 64


def _learning(envs: Any) -> Burst:
    from stable_baselines3 import PPO

    agent = PPO("MlpPolicy", envs, device="cpu", seed=0, **FRAMES)
    frames = BOATS * FRAMES["n_steps"]
    return lambda: agent.learn(frames, reset_num_timesteps=False), frames


def _learning_pendulums() -> Burst:
    from stable_baselines3.common.vec_env import DummyVecEnv

    return _learning(DummyVecEnv([lambda: gym.make("Pendulum-v1")] * BOATS))


def _learning_to_sail() -> Burst:
    from usv_gym.envs.sb3 import SB3VecEnv

    return _learning(SB3VecEnv(BOATS, twin="ukf"))


def memory_per_boat(twin: str | None) -> float:
    """Return the memory that a boat of a batch of :data:`BOATS` takes, byte.

    Everything that lives from its making on, as far as Python's and numpy's allocators know.
    """
    _boats(twin, 2)  # compiles, and fills what is kept once for all
    gc.collect()
    tracemalloc.start()
    try:
        envs = _boats(twin, BOATS)
        envs.step(np.tile(AHEAD, (BOATS, 1)))
        gc.collect()
        return tracemalloc.get_traced_memory()[0] / BOATS
    finally:
        tracemalloc.stop()


MEMORY: dict[str, tuple[str | None, float | None]] = {
    f"memory of a boat in a batch of {BOATS}": (None, None),
    f"memory of a boat with ukf in a batch of {BOATS}": ("ukf", 64e3),
}
"""Batches whose memory is measured: their twin, and how much a boat may take at most, byte."""

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


def first_use(options: Sequence[dict[str, Any]]) -> float:
    """Return how long a process computes that finds no compiled kernels, s of one core.

    Parameters
    ----------
    options : sequence of dict
        Of ``gym.make``, for the environments that it steps, one after the other.

    Raises
    ------
    RuntimeError
        With the last line that the process wrote, if it failed.
    """
    with tempfile.TemporaryDirectory() as empty:
        done = subprocess.run(
            [sys.executable, "-c", _FIRST_USE.format(options=list(options))],
            env={**os.environ, "NUMBA_CACHE_DIR": empty, QUIET: "1"},
            capture_output=True,
            text=True,
        )
    if done.returncode:
        raise RuntimeError(
            done.stderr.strip().rpartition("\n")[2] or f"ended with {done.returncode}"
        )
    return float(done.stdout)


FIRST_USES: dict[str, tuple[tuple[dict[str, Any], ...], float | None]] = {
    "first use of the environment": (({},), None),
    "first use of everything": (({}, {"twin": "ukf"}, {"twin": "dsw-ukf"}, {"dof": 6}), 30.0),
}
"""Environments, and how long their first use may take at most with all compiling, s."""

_UKF_PEER, _WINDOW_PEER = "filterpy UKF 6 + 25", f"filterpy window W = {WINDOW}"

_CART_POLES, _KVLCC2 = f"CartPole x {BATCH}", "ShipMMG KVLCC2"

_OTTER, _PPO_FLOOR = "PythonVehicleSimulator Otter", f"PPO, {BOATS} Pendulums"

CASES: tuple[Case, ...] = (
    Case(FLOOR, lambda: _stepping(_endless("Pendulum-v1"), np.zeros(1, np.float32))),
    Case("gym-sailing", _gym_sailing, FLOOR, needs=("gym_sailing",)),
    Case("env, 3-DOF", lambda: _stepping(_sailing(twin=None), AHEAD), FLOOR, 150e3, 1.5),
    Case("env, 6-DOF", lambda: _stepping(_sailing(twin=None, dof=6), AHEAD), FLOOR, 80e3),
    Case("env with ukf", lambda: _stepping(_sailing(twin="ukf"), AHEAD), FLOOR, 70e3),
    Case(
        "env with dsw-ukf-plus",
        lambda: _with_a_past(_stepping(_sailing(twin="dsw-ukf-plus"), AHEAD)),
        FLOOR,
        3e3,
    ),
    Case(_CART_POLES, _cart_poles),
    *(
        Case(
            f"batch of {BATCH}{', ukf' if twin else ''}{', 2 threads' if threads > 1 else ''}",
            partial(_of_all, twin, threads),
            _CART_POLES,
            must if threads == 1 else None,
            slow=threads > 1,
        )
        for twin, must in ((None, 300e3), ("ukf", 120e3))
        for threads in (1, 2)
    ),
    Case(_UKF_PEER, _filterpy),
    Case("stonesoup UKF 6 + 25", _stonesoup, _UKF_PEER, needs=("stonesoup",)),
    Case("UKF 6 + 25 in-kernel", _structured, _UKF_PEER, must_ratio=300.0),
    Case("UKF 6 + 25 from Python", _structured_from_python, _UKF_PEER),
    Case(_WINDOW_PEER, _filterpy_window),
    Case(f"dsw-ukf window W = {WINDOW}", _window, _WINDOW_PEER, must_ratio=300.0),
    Case("row of ukf", lambda: _rows("ukf")),
    Case("row of dsw-ukf", lambda: _rows("dsw-ukf"), "row of ukf"),
    Case("row of dsw-ukf-plus", lambda: _rows("dsw-ukf-plus"), "row of ukf"),
    Case("refit of dsw-ukf-plus", lambda: _rows("dsw-ukf-plus", period=H), "row of ukf"),
    *(
        Case(
            f"10 s bands of {name}",
            partial(_prediction, name),
            None if name == "ukf" else "10 s bands of ukf",
        )
        for name in ("ukf", "dsw-ukf", "dsw-ukf-plus")
    ),
    Case(_KVLCC2, _shipmmg, needs=("shipmmg",)),
    Case("ship, 3-DOF, 0 waves", lambda: _ship(3, 0), _KVLCC2),
    Case("ship, 3-DOF, 100 waves", lambda: _ship(3, 100), _KVLCC2),
    Case(_OTTER, _otter, needs=("python_vehicle_simulator",)),
    Case("ship, 6-DOF, 0 waves", lambda: _ship(6, 0), _OTTER),
    Case("ship, 6-DOF, 100 waves", lambda: _ship(6, 100), _OTTER),
    Case(_PPO_FLOOR, _learning_pendulums, needs=("stable_baselines3",), slow=True),
    Case(
        f"PPO, {BOATS} boats with ukf",
        _learning_to_sail,
        _PPO_FLOOR,
        must_ratio=0.8,
        needs=("stable_baselines3", "usv_gym.envs.sb3"),
        slow=True,
    ),
)
"""All that is compared."""


# how the cost grows
@dataclass(frozen=True)
class Curve:
    """Something whose cost grows with a size.

    Parameters
    ----------
    name : str
        What is timed.
    size : str
        What grows.
    sizes : tuple of int
        How large it is.
    make : callable
        Sets it up for a size and returns a :data:`Burst`.
    """

    name: str
    size: str
    sizes: tuple[int, ...]
    make: Callable[[int], Burst]


_COMPONENTS = (0, 8, 24, 48, 100, 200, 300, 400)

_BATCHES = (1, 2, 4, 16, 64, 256, 1024, 4096)

_HORIZONS = (1, 2, 5, 10, 20, 40, 60)

CURVES: tuple[Curve, ...] = (
    Curve("ship step, 3-DOF", "wave components", _COMPONENTS, lambda n: _ship(3, n)),
    Curve("ship step, 6-DOF", "wave components", _COMPONENTS, lambda n: _ship(6, n)),
    Curve("batch step", "boats", _BATCHES, lambda n: _batch(None, n)),
    Curve("batch step with ukf", "boats", _BATCHES, lambda n: _batch("ukf", n)),
    Curve("dsw-ukf re-run", "rows", (2, 5, 10, 15, 30, 60, 120, 240), _window),
    Curve("ukf with bands", "s ahead", _HORIZONS, lambda n: _prediction("ukf", n)),
    Curve(
        "dsw-ukf-plus with bands", "s ahead", _HORIZONS, lambda n: _prediction("dsw-ukf-plus", n)
    ),
)
"""All whose growth is measured."""


def growth_cases(curve: Curve) -> list[Case]:
    """Return a case for each size of a curve."""
    return [Case(f"{curve.name}: {n}", partial(curve.make, n)) for n in curve.sizes]


@dataclass(frozen=True)
class Line:
    """A straight line through times, and where they leave it.

    Parameters
    ----------
    start, slope : float
        Time at size 0 and per unit of size, in the unit of the times.
    worst : float
        Largest distance of a time from the line, as a part of the time.
    bend : float or None
        Size where two lines meet that fit far better than one; None if none do.
    slopes : tuple of float
        Slopes before and after it; twice the same without a bend.
    """

    start: float
    slope: float
    worst: float
    bend: float | None
    slopes: tuple[float, float]

    def __call__(self, size: float) -> float:
        """Return the time that the line says for a size."""
        return self.start + self.slope * size

    def told(self, size: str) -> str:
        """Return the line in words, its times in us; ``size`` says what grows."""
        each = f"{self.start:.3g} us + {self.slope:.3g} us times {size}"
        if self.bend is None:
            return f"{each}; straight within {100.0 * self.worst:.0f} %"
        before, after = self.slopes
        return (
            f"{each}, {100.0 * self.worst:.0f} % off at worst; it bends at {self.bend:g}: "
            f"{before:.3g} us times {size} before, {after:.3g} us after"
        )


STRAIGHT = 0.1
"""Distance from a line, as a part of the time, within which times count as straight."""


def fit(sizes: Sequence[float], times: Sequence[float]) -> Line:
    """Return the line with the least squares of relative distances, and where the times bend.

    A bend is looked for where a time lies further than 10 % from the line: the size at which two
    lines that meet there fit best, if they halve the distances.
    """
    n, t = np.asarray(sizes, float), np.asarray(times, float)

    def solved(*columns: Array) -> tuple[Array, Array]:
        basis = np.stack([np.ones_like(n), *columns], axis=1)
        weights = np.linalg.lstsq(basis / t[:, None], np.ones_like(t), rcond=None)[0]
        return weights, basis @ weights / t - 1.0

    (start, slope), off = solved(n)
    worst, bend, slopes = float(np.abs(off).max()), None, (slope, slope)
    if worst > STRAIGHT:
        tried = [(knot, *solved(n, np.maximum(n - knot, 0.0))) for knot in n[1:-1]]
        knot, weights, bent = min(tried, key=lambda one: float(one[2] @ one[2]))
        if bent @ bent < 0.25 * (off @ off):
            bend, slopes = float(knot), (weights[1], weights[1] + weights[2])
    return Line(float(start), float(slope), worst, bend, (float(slopes[0]), float(slopes[1])))


def growth_rows(curve: Curve, measured: Measured) -> tuple[list[dict[str, Any]], Line | None]:
    """Return a row for each size that was measured, and the line through them.

    Returns
    -------
    list of dict, Line or None
        Rows of ``name``, ``size_of``, ``size``, ``median_us``, ``line_us``; no line through fewer
        than three.
    """
    names = dict(zip(curve.sizes, (case.name for case in growth_cases(curve)), strict=True))
    times = {
        n: 1e6 * measured.median(name) for n, name in names.items() if name in measured.seconds
    }
    line = fit(list(times), list(times.values())) if len(times) > 2 else None
    return [
        {
            "name": curve.name,
            "size_of": curve.size,
            "size": n,
            "median_us": us,
            "line_us": None if line is None else line(n),
        }
        for n, us in times.items()
    ], line
