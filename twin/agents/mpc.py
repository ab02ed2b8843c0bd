"""Model-predictive control with the model that the twin has identified, for many boats at once.

Every decision minimises a sum of squares over the seconds ahead. Its terms are the distance from
the path, the lack of speed along it, and the effort. The boat knows all legs of the path. The
unknowns are shaft speed and angle at a few times ("knots"), straight lines between them. The motion
under a plan is that of the boat's own twin (:func:`twin.model.rollout.rollout`), from the twin's
estimate. Damped Gauss-Newton steps improve the best of a few first guesses: the plan of the
decision before, and angles that are held. Nothing is drawn at random.

Source: Levenberg 1944, Marquardt 1963 (damping); Nocedal and Wright 2006, section 10.3 and 16.7
(Gauss-Newton, bounds by projection).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.agents.agent import ControllerError, check_actions, shaft_speeds
from twin.channels import PSI, U, V, X, Y
from twin.filters.linalg import cholesky, solve_factored
from twin.model.dynamics import N_ACT
from twin.model.rollout import (
    Paths,
    RolloutConfig,
    RolloutStart,
    Waves,
    rollout,
    rollout_size,
)
from twin.model.structure import N_STATES
from twin.predictors.forecast import SHRINKAGE
from twin.sim.batched_twins import CompiledTwins
from usv_gym.envs.scoring import COURSE_ERROR, CROSS_TRACK, ERRORS, TO_GO, follow, path_errors
from usv_gym.envs.vector import USVVectorEnv
from usv_kernel.arrays import shaped
from usv_kernel.jit import kernel

__all__ = [
    "ModelPredictive",
    "plan_all",
]

Array = NDArray[np.float64]

WIDTH = 2
"""Numbers in an action: shaft speed, angle."""

NUDGE = 1e-3
"""Finite difference of a knot, in parts of full throttle and helm."""

DAMPINGS = (1e-3, 1e-1, 10.0)
"""Levenberg-Marquardt damping, in parts of the diagonal, raised until a step is an improvement."""


class PlanConfig(NamedTuple):
    """What all boats have in common."""

    dt: float  # time of a row of the motion, s
    length: float  # of the boat, m
    speed: float  # nominal speed, m/s
    reach: float  # distance at which a way point counts as reached, m
    shaft: float  # nominal shaft speed, part of the full one
    progress: float  # weights: see ModelPredictive
    effort: float
    change: float
    steps: int  # Gauss-Newton steps at most
    basis: Any  # (K, M) share of each knot in each row
    shift: Any  # (M, M) shares of the knots in those of one decision later
    mixing: Any  # (4, 2) see usv_gym.vessel.vessel.Vessel.mixing
    limits: Any  # (4,) full commands in the unit of the model
    guesses: Any  # (G, 2 M) first guesses besides the last plan
    boat: Any  # RolloutConfig


class Goal(NamedTuple):
    """What a boat's plan is for."""

    last: Any  # (2,) action in force
    points: Any  # (P, 2) way points, m
    leg: int  # that of now


class PlanWork(NamedTuple):
    """Scratch of a plan."""

    start: Any  # RolloutStart of one motion
    paths: Any  # Paths of the motion, (1, K, 6) and (K, 4)
    plan: Any  # (K, 4) commands
    rollout: Any  # scratch of the rollout
    errors: Any  # (4,) errors from the path
    legs: Any  # (K,) leg of each row
    trial: Any  # (2 M,) another plan
    base: Any  # (R,) its residuals: R = 2 K + 3 M
    residuals: Any  # (R,) those of a third
    J: Any  # (2 M, R) slopes of the residuals
    H: Any  # (2 M, 2 M) J J'
    A: Any  # (2 M, 2 M) damped
    g: Any  # (2 M,) right side
    step: Any  # (2 M,) step
    line: Any  # (1, 2 M) of the factor


@kernel
def commands(knots, config, plan):
    """Write the commands (K, 4) of a plan's knots (2 M,): shaft speeds, then angles; 1 is full."""
    basis, mixing = config.basis, config.mixing
    many = basis.shape[1]
    for row in range(basis.shape[0]):
        shaft, angle = 0.0, 0.0
        for m in range(many):
            shaft += basis[row, m] * knots[m]
            angle += basis[row, m] * knots[many + m]
        for j in range(N_ACT):
            share = mixing[j, 0] * shaft + mixing[j, 1] * angle
            plan[row, j] = config.limits[j] * min(max(share, -1.0), 1.0)


@kernel
def residuals_of(knots, free, goal, config, work, out):
    """Write the residuals of a plan (2 M,) and of its motion; return the sum of their squares.

    ``free`` says whether the legs follow from the motion, or are given: a slope is that of the same
    legs. The motion is left in ``work.paths``, its legs in ``work.legs``. ``out`` (2 K + 3 M,) has,
    row by row, lengths from the path and the lack of speed. Shaft speeds less the nominal one and
    changes from knot to knot follow.
    """
    states, legs, errors, leg = work.paths.states[0], work.legs, work.errors, goal.leg
    K, many = states.shape[0], knots.shape[0] // WIDTH
    for k in range(K):
        s = states[k]
        if free:
            leg = follow(s[X], s[Y], s[PSI], goal.points, leg, config.reach, errors)
            legs[k] = leg
        else:
            path_errors(s[X], s[Y], s[PSI], goal.points, int(legs[k]), errors)
        # only the last point of the path can be within reach; there the boat is to stop
        wanted = 1.0
        if errors[TO_GO] < config.reach:
            wanted = max(errors[TO_GO] / config.reach, -1.0)
        along = s[U] * math.cos(errors[COURSE_ERROR]) + s[V] * math.sin(errors[COURSE_ERROR])
        distance = errors[CROSS_TRACK] / config.length
        # its square grows linearly with the distance, so that far from the path the boat sails back
        out[k] = distance / (1.0 + distance * distance) ** 0.25
        out[K + k] = config.progress * (wanted - along / config.speed)
    for m in range(many):
        out[2 * K + m] = config.effort * (knots[m] - config.shaft)
    for m in range(WIDTH * many):
        before = goal.last[m // many] if m % many == 0 else knots[m - 1]
        out[2 * K + many + m] = config.change * (knots[m] - before)
    total = 0.0
    for k in range(out.shape[0]):
        total += out[k] * out[k]
    return total


@kernel
def rate(knots, free, goal, config, work, out):
    """Roll the model under a plan, and do :func:`residuals_of`."""
    commands(knots, config, work.plan)
    none = Waves(shaped(work.errors, 0, (1, 0, 3)), 0.0)
    rollout(work.start, work.plan, config.dt, config.boat, none, work.paths, work.rollout)
    return residuals_of(knots, free, goal, config, work, out)


@kernel
def _copy(source, target):
    for k in range(target.shape[0]):
        target[k] = source[k]


@kernel
def _descend(knots, best, goal, config, work):
    """Take a damped Gauss-Newton step from a plan rated ``best``; return the plan's new rating."""
    trial, base, moved = work.trial, work.base, work.residuals
    J, H, A, g = work.J, work.H, work.A, work.g
    V = knots.shape[0]
    rate(knots, True, goal, config, work, base)
    _copy(knots, trial)
    for k in range(V):
        nudge = -math.copysign(NUDGE, knots[k])  # never out of bounds
        trial[k] = knots[k] + nudge
        rate(trial, False, goal, config, work, moved)
        trial[k] = knots[k]
        g[k] = 0.0
        for j in range(base.shape[0]):
            J[k, j] = (moved[j] - base[j]) / nudge
            g[k] -= J[k, j] * base[j]
        for m in range(k + 1):
            H[m, k] = 0.0
            for j in range(base.shape[0]):
                H[m, k] += J[m, j] * J[k, j]
    for k in range(V):
        # a knot at its bound that is pushed outwards stays there
        if abs(knots[k]) >= 1.0 and g[k] * knots[k] > 0.0:
            g[k] = 0.0
            for m in range(V):
                if m != k:
                    H[min(k, m), max(k, m)] = 0.0
    for damping in DAMPINGS:
        for k in range(V):
            for m in range(k, V):
                A[k, m] = H[k, m]
            A[k, k] += damping * H[k, k] + 1e-9
        if cholesky(A, A, work.line) > 0:
            continue
        solve_factored(A, g, work.step)
        for k in range(V):
            trial[k] = min(max(knots[k] + work.step[k], -1.0), 1.0)
        cost = rate(trial, True, goal, config, work, moved)
        if cost < best:
            _copy(trial, knots)
            return cost
    return best


@kernel
def plan_all(inputs, bounds, paths, config, last, plans, work):
    """Update the plans (n, 2 M) of all boats, and the actions in force (n, 2).

    ``bounds`` (n, 3) are velocities beyond which a model is not plausible. ``paths`` are the legs
    that the twins are on (n,), and way points (n, P, 2), m.
    """
    legs, points = paths
    trial, base, theta = work.trial, work.base, work.start.params[0]
    s, states, M = work.start.states[0], work.paths.states[0], config.shift.shape[0]
    for i in range(inputs.places.shape[0]):
        goal = Goal(last[i], points[i], int(legs[i]))
        knots = plans[i]
        _copy(inputs.places[i], s[:3])
        _copy(inputs.velocities[i], s[3:])
        _copy(inputs.actuators[i], work.start.act)
        _copy(inputs.winds[i], work.start.wind)
        for k in range(WIDTH * M):
            trial[k] = 0.0
            for m in range(M):
                trial[k] += config.shift[k % M, m] * knots[k - k % M + m]
        _copy(trial, knots)
        best = 0.0
        # an implausible model is shrunk to its prior, as in the twin's own forecast
        for part in SHRINKAGE:
            for k in range(theta.shape[0]):
                prior = inputs.prior[k]
                theta[k] = prior + part * (inputs.parameters[i, k] - prior)
            best = rate(knots, True, goal, config, work, base)
            plausible = True
            for k in range(states.shape[0]):
                for j in range(3):
                    plausible = plausible and abs(states[k, 3 + j]) <= bounds[i, j]
            if plausible:
                break
        for guess in config.guesses:
            cost = rate(guess, True, goal, config, work, base)
            if cost < best:
                best = cost
                _copy(guess, knots)
        for _ in range(config.steps):
            cost = _descend(knots, best, goal, config, work)
            if not cost < best:
                break
            best = cost
        for c in range(WIDTH):
            last[i, c] = knots[c * M]


class ModelPredictive:
    """Model-predictive control on the twin's model and state.

    Parameters
    ----------
    name : str
        Of the controller.
    horizon : float
        How far ahead it plans, times to sail a length.
    rows : int
        Rows of the motion that are rated.
    knots : sequence of float
        Times of the knots, as parts of the horizon; what stands at the last one is held.
    steps : int
        Gauss-Newton steps in a decision, at most.
    progress, effort, change : float
        Weights of the lack of speed, of shaft speeds less the nominal one, and of changes from knot
        to knot. A length from the path has the weight 1.
    """

    observation = "twin"
    entries: tuple[str, ...] = ()
    """It reads the twins themselves, and no entry of the observation."""

    def __init__(
        self,
        name: str = "mpc-twin",
        *,
        horizon: float = 7.0,
        rows: int = 16,
        knots: tuple[float, ...] = (0.0, 0.12, 0.3, 0.6),
        steps: int = 2,
        progress: float = 1.0,
        effort: float = 0.3,
        change: float = 0.3,
    ) -> None:
        if not (horizon > 0.0 and rows >= 1 and steps >= 0 and list(knots) == sorted(set(knots))):
            raise ControllerError(
                f"{name}: horizon = {horizon}, rows = {rows}, steps = {steps}, knots = {knots}: "
                "must be above 0, 1 or more, 0 or more, and times that grow"
            )
        self.name = name
        self.horizon, self.rows, self.knots, self.steps = horizon, rows, knots, steps
        self.weights = progress, effort, change

    def begin(self, envs: USVVectorEnv) -> None:
        """See :meth:`twin.agents.agent.Agent.begin`; ControllerError without a compiled model."""
        base = envs.unwrapped
        observer = base.observer
        if not isinstance(observer, CompiledTwins):
            raise ControllerError(
                f"{self.name} rolls the models of compiled twins; make the environment with "
                "twin='ukf' or twin='dsw-ukf-plus', and an observation such as 'twin' or 'compact'"
            )
        check_actions(self.name, base)
        joint, rollout_inputs, vessel = observer.joint, observer.rollout_inputs, base.vessel
        n, K, M, V = base.num_envs, self.rows, len(self.knots), WIDTH * len(self.knots)
        length, shafts = vessel.values["length_waterline"], shaft_speeds(vessel)
        h = self.horizon * length / base.speed / K
        dt = base.simulation.dt * base.frame_skip
        nominal = float(shafts[1] / shafts[0])
        times, each = h * K * np.array(self.knots), np.eye(M)
        between = [
            np.stack([np.interp(t, times, row) for row in each], axis=1)
            for t in (h * np.arange(K), times + dt)
        ]
        limits = np.array([joint.settings.n_unit * shafts[0]] * 2 + [vessel.helm_max] * 2)
        held = [(nominal, x) for x in (-1.0, -0.4, 0.0, 0.4, 1.0)] + [(-nominal, 0.0)]
        self._config = PlanConfig(
            h,
            length,
            base.speed,
            float(base.task.rules["reach"]),
            nominal,
            *self.weights,
            self.steps,
            between[0],
            between[1],
            vessel.mixing.copy(),
            limits,
            np.repeat(np.array(held), M, axis=1),
            RolloutConfig(joint.lags, joint.envelope, joint.terms),
        )
        self._inputs = rollout_inputs
        self._paths = observer.notes["leg"], base.task.points
        self._bounds = np.empty((n, 3))
        self._last, self._plans = np.empty((n, WIDTH)), np.empty((n, V))
        self.forget(np.ones(n, dtype=np.bool_))
        R, p = 2 * K + 3 * M, len(rollout_inputs.prior)
        self._work = PlanWork(
            RolloutStart(np.empty((1, N_STATES)), np.empty((1, p)), np.empty(N_ACT), np.empty(2)),
            Paths(np.empty((1, K, N_STATES)), np.empty((K, N_ACT))),
            np.empty((K, N_ACT)),
            np.empty(rollout_size()),
            np.empty(len(ERRORS)),
            np.empty(K),
            np.empty(V),
            np.empty(R),
            np.empty(R),
            np.empty((V, R)),
            np.empty((V, V)),
            np.empty((V, V)),
            np.empty(V),
            np.empty(V),
            np.empty((1, V)),
        )

    def forget(self, boats: NDArray[np.bool_]) -> None:
        """Forget the plans of some boats (n,), which begin an episode."""
        first = self._config.shaft, 0.0
        self._last[boats], self._plans[boats] = first, np.repeat(first, len(self.knots))

    def act(self, obs: NDArray[np.float32]) -> Array:
        """See :meth:`twin.agents.agent.Agent.act`; it reads the twins themselves."""
        inputs = self._inputs
        np.maximum(1.5 * inputs.fastest, inputs.nominal, out=self._bounds)
        plan_all(
            inputs,
            self._bounds,
            self._paths,
            self._config,
            self._last,
            self._plans,
            self._work,
        )
        return self._last.copy()
