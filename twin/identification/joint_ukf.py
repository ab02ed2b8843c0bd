"""State and parameters of the twin's model in the structured UKF.

Memory is flat, because the number of parameters differs from model to model and a type for each
would compile every kernel again. The openers below are its one definition: kernels get NamedTuples
of views, and Python the structured dtype that :func:`usv_kernel.arrays.named_dtype` makes of them.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.channels import R, U, V
from twin.filters.navigation_ekf import FINE_MAX_S
from twin.filters.navigation_state import N_MODELLED
from twin.filters.ukf import UKFWorkspace, scaled_weights
from twin.identification.filter_settings import FilterSettings
from twin.identification.identifiability import accumulate
from twin.identification.physical_bounds import BOUNDS, physical_bounds
from twin.model.actuators import follow_all
from twin.model.augmented import joint_predict
from twin.model.dynamics import N_ACT
from twin.model.structure import N_STATES, N_TERMS
from twin.particulars import Particulars
from usv_kernel.arrays import flat_size, named_dtype, python_views, take
from usv_kernel.jit import inlined, kernel
from usv_kernel.simd import LANES

__all__ = [
    "DOUBTED_VELOCITY_SD",
    "FilterConfig",
    "FilterState",
    "FilterWorkspace",
    "JointUKF",
    "accumulate_information",
    "advance",
    "clip_velocities",
    "filter_config",
    "filter_state",
    "filter_workspace",
    "information_is_due",
    "process_noise",
    "scale_plan",
]

Array = NDArray[Any]

STEP_MAX_S = 0.1
"""Longest step of the filter's prediction; longer gaps are cut up."""

DOUBTED_VELOCITY_SD = 0.1
"""Standard deviation of velocities under doubted commands, in envelopes."""

INFORMATION_STEP_S = 0.25
INFORMATION_GAP_MAX_S = 1.0
"""Step at which the regressors' information is summed, and longest time for which one counts."""


class FilterState(NamedTuple):
    """What the joint filter of a boat remembers."""

    x: Any  # (6 + p,) mean: x, y (m), psi (rad), u, v (m/s), r (rad/s), then the parameters
    P: Any  # (6 + p, 6 + p) its covariance
    act: Any  # (4,) actuators as followed from the commands: unit of the structure, rad
    wind: Any  # (2,) true wind to north and east, m/s; zeros until it is measured
    fastest: Any  # (3,) largest abs(u), abs(v), m/s, and abs(r), rad/s, seen
    wave_power: Any  # (3,) mean squares of the waves in u, v (m/s)^2 and r (rad/s)^2
    counted: Any  # (2,) time since regressors were counted, and time that they stand for, s
    gram_matrices: Any  # Gram matrices of the regressors of surge, sway and yaw


class FilterConfig(NamedTuple):
    """What the joint filter is given; see :class:`FilterSettings`."""

    q: Any  # (6,) variance that each state gains per second
    q_xi: Any  # (p,) variance that each parameter gains per second
    r: Any  # (6,) variance of each measured state
    p0: Any  # (6,) variance of each state at the start
    lags: Any  # (3,) shaft speed and drive angle, s; speed of the drives, rad/s
    envelope: Any  # (3,) largest abs(u), abs(v), m/s, and abs(r), rad/s
    nominal: Any  # (3,) velocities that may be predicted for any boat, m/s and rad/s
    prior: Any  # (p,) prior mean of the parameters
    weights: Any  # (4,) of the sigma points
    n_unit: float  # unit of the structure's shaft speeds
    wave_time: float  # time over which waves are averaged, s; 0 for none
    wave_noise: float  # what their power adds to the measurement noise, s
    wave_push: float  # what it adds to the process noise, 1/s
    rest_push: float  # share of the process noise that is left at rest
    n_nominal: float  # nominal shaft speed in the unit of the structure
    driven: float  # most that plausible speeds grow with faster shafts
    even: float  # most of a velocity's standard deviation in a forecast, in the largest plausible
    bounds: Any  # (6, p + 1) see physical_bounds
    model: Any  # ModelTerms


class FilterWorkspace(NamedTuple):
    """Scratch of the joint filter."""

    Q: Any  # (6, 6) process noise of the states for a step
    q_xi: Any  # (p,) that of the parameters
    R: Any  # (6, 6) measurement noise
    terms: Any  # (N_TERMS,) terms of the model
    accel: Any  # (7,) accelerations for the navigation; see ``navigate``
    mask: Any  # (6,) which states were measured
    ahead: Any  # (6 + p,), (6 + p, 6 + p), (4,) mean, covariance and actuators of a forecast
    sigma: Any  # UKFWorkspace


@inlined
def filter_state(memory, model):
    """Open the memory of a joint filter."""
    n, limits = N_STATES + model.which.shape[1], model.limits
    x, at = take(memory, 0, (n,))
    P, at = take(memory, at, (n, n))
    act, at = take(memory, at, (N_ACT,))
    wind, at = take(memory, at, (2,))
    fastest, at = take(memory, at, (3,))
    wave_power, at = take(memory, at, (3,))
    counted, at = take(memory, at, (2,))
    k = limits[3, 1] - limits[3, 0]
    surge, at = take(memory, at, (k, k))
    k = limits[4, 1] - limits[4, 0]
    sway, at = take(memory, at, (k, k))
    k = limits[5, 1] - limits[5, 0]
    yaw, at = take(memory, at, (k, k))
    return FilterState(x, P, act, wind, fastest, wave_power, counted, (surge, sway, yaw))


@inlined
def filter_config(values, model):
    """Open the configuration of a joint filter."""
    q, at = take(values, 0, (N_STATES,))
    q_xi, at = take(values, at, (model.which.shape[1],))
    r, at = take(values, at, (N_STATES,))
    p0, at = take(values, at, (N_STATES,))
    lags, at = take(values, at, (3,))
    envelope, at = take(values, at, (3,))
    nominal, at = take(values, at, (3,))
    prior, at = take(values, at, (model.which.shape[1],))
    weights, at = take(values, at, (4,))
    n, at = take(values, at, (1,))
    waves, at = take(values, at, (3,))
    rest, at = take(values, at, (2,))
    most, at = take(values, at, (2,))
    bounds, at = take(values, at, (BOUNDS, model.which.shape[1] + 1))
    return FilterConfig(
        q, q_xi, r, p0, lags, envelope, nominal, prior,
        weights, n[0], waves[0], waves[1], waves[2], rest[0], rest[1],
        most[0], most[1], bounds, model,
    )  # fmt: skip


@inlined
def filter_workspace(work, p):
    """Open the scratch of a joint filter of p parameters."""
    n, points = N_STATES + p, 1 + 2 * N_STATES
    width = LANES * ((2 * N_STATES + p + LANES) // LANES)
    Q, at = take(work, 0, (N_STATES, N_STATES))
    q_xi, at = take(work, at, (p,))
    R, at = take(work, at, (N_STATES, N_STATES))
    terms, at = take(work, at, (N_TERMS,))
    accel, at = take(work, at, (N_MODELLED,))
    mask, at = take(work, at, (N_STATES,))
    x, at = take(work, at, (n,))
    P, at = take(work, at, (n, n))
    act, at = take(work, at, (N_ACT,))
    one, at = take(work, at, (points, width))
    two, at = take(work, at, (points, width))
    three, at = take(work, at, (points, width))
    four, at = take(work, at, (points, width))
    sigma = UKFWorkspace(one, two, three, four)
    return FilterWorkspace(Q, q_xi, R, terms, accel, mask, (x, P, act), sigma)


@inlined
def process_noise(h, state, config, work):
    """Write the process noise of a step of h."""
    for i in range(N_STATES):
        work.Q[i, i] = config.q[i] * h
    if config.rest_push < 1.0:
        # squares of thrust and motion, in nominal ones
        x, act, speed = state.x, state.act, 0.25 * config.envelope[0]
        thrust = (act[0] * act[0] + act[1] * act[1]) / (2.0 * config.n_nominal**2)
        motion = (x[U] ** 2 + x[V] ** 2) / speed**2 + (4.0 * x[R] / config.envelope[2]) ** 2
        share = config.rest_push + (1.0 - config.rest_push) * min(thrust + motion, 1.0)
        for i in range(3):
            work.Q[3 + i, 3 + i] *= share
    for i in range(3):
        work.Q[3 + i, 3 + i] += config.wave_push * state.wave_power[i] * h
    for k in range(config.q_xi.shape[0]):
        work.q_xi[k] = config.q_xi[k] * h


@kernel
def scale_plan(plan, n_unit, scaled):
    """Write a plan (K, 4) with its shaft speeds in the unit of the structure."""
    for row in range(plan.shape[0]):
        for k in range(2):
            scaled[row, k] = n_unit * plan[row, k]
            scaled[row, 2 + k] = plan[row, 2 + k]


@inlined
def advance(dt, cmd, state, config, work):
    """Predict state, parameters and covariance over dt s under a command, in place.

    Longer gaps are cut to :data:`FINE_MAX_S`: by then the initial velocities have decayed.
    """
    dt = min(dt, FINE_MAX_S)
    steps = max(1, math.ceil(dt / STEP_MAX_S - 1e-9))
    h = dt / steps
    process_noise(h, state, config, work)
    for _ in range(steps):
        follow_all(state.act, cmd, config.lags, config.n_unit, 0.5 * h)
        joint_predict(state, h, config, work)
        follow_all(state.act, cmd, config.lags, config.n_unit, 0.5 * h)


@inlined
def information_is_due(dt, state):
    """Return whether the terms of the moment are to be added, each :data:`INFORMATION_STEP_S`."""
    state.counted[0] += dt
    return state.counted[0] >= INFORMATION_STEP_S - 1e-9


@inlined
def accumulate_information(terms, state, model):
    """Add the terms of the moment to the Gram matrices."""
    counted = state.counted
    seconds = min(counted[0], INFORMATION_GAP_MAX_S)
    counted[0] = 0.0
    counted[1] += seconds
    for i in range(3):
        low, high = model.limits[3 + i, 0] - N_STATES, model.limits[3 + i, 1] - N_STATES
        accumulate(state.gram_matrices[i], terms, model.which[i, low:high], seconds)


@inlined
def clip_velocities(x, envelope):
    """Clip the velocities of a joint vector to what the boat can do."""
    for i in range(3):
        x[3 + i] = min(max(x[3 + i], -envelope[i]), envelope[i])


class JointUKF:
    """State and parameters of the twin's model in the structured UKF.

    ``memory`` is all that it remembers, flat; ``memory.view(dtype)[0]`` has its fields by name, see
    :class:`FilterState`. ``x`` and ``P`` are of six states and then the parameters. ``act`` (4,)
    are the actuators as followed from the commands, in the unit of the structure. ``wind`` (2,) is
    the true wind to north and east, m/s, zeros until it is measured. ``fastest`` (3,) are the
    largest velocities seen, by which the forecast is held plausible. ``wave_power`` (3,) are the
    mean squares of the waves in u, v and r. ``counted`` ends with the time counted, s;
    ``gram_matrices`` are those of surge, sway and yaw, see
    :func:`twin.identification.identifiability.accumulate`.
    """

    def __init__(self, particulars: Particulars, settings: FilterSettings) -> None:
        self.settings = settings
        self.terms = settings.structure.terms
        n = N_STATES + len(settings.structure)
        self.lags = np.array([particulars.shaft_lag, particulars.steer_lag, particulars.steer_rate])
        U, L = particulars.speed, particulars.length
        self.envelope = np.array([4.0 * U, 4.0 * U, 4.0 * U / L])
        self.nominal = np.array([1.5 * U, 0.8 * U, 1.2 * U / L])
        self.weights = scaled_weights(n, settings.alpha, settings.beta, settings.kappa)
        self.memory = np.zeros(flat_size(filter_state, self.terms))
        state: FilterState = python_views(filter_state)(self.memory, self.terms)
        self.x, self.P, self.act, self.wind = state.x, state.P, state.act, state.wind
        self.fastest, self.wave_power, self.counted = (
            state.fastest,
            state.wave_power,
            state.counted,
        )
        self.gram_matrices = state.gram_matrices
        self.constants = np.concatenate(
            [
                settings.q,
                settings.q_xi,
                settings.r,
                settings.p0,
                self.lags,
                self.envelope,
                self.nominal,
                settings.xi0,
                self.weights,
                [settings.n_unit],
                settings.waves,
                [settings.rest_push, settings.n_unit * particulars.shaft_speed],
                settings.most,
                physical_bounds(
                    settings.structure, settings.xi0, U, particulars.shaft_speed, settings.share
                ).ravel(),
            ]
        )
        config: FilterConfig = python_views(filter_config)(self.constants, self.terms)
        self.q, self.r = config.q, config.r
        self.scratch = np.zeros(flat_size(filter_workspace, n - N_STATES))
        self.reset()

    @property
    def dtype(self) -> np.dtype[Any]:
        """Structured dtype of the memory; see :class:`FilterState`."""
        return named_dtype(filter_state, self.terms)

    def reset(self) -> None:
        """Go back to the prior."""
        self.memory[:] = 0.0
        self.x[N_STATES:] = self.settings.xi0
        self.P[range(N_STATES), range(N_STATES)] = self.settings.p0
        self.P[N_STATES:, N_STATES:] = self.settings.xi0_cov

    @property
    def xi(self) -> Array:
        """Parameters, a view of shape (p,)."""
        return self.x[N_STATES:]
