"""Model-predictive control with the model that the twin has identified, for many boats at once.

Every decision minimises a sum of squares over the seconds ahead: the distance off the path, all
of whose legs the boat knows; the speed along it that is lacking; and the effort. The unknowns are
shaft speed and angle at a few times ("knots"), straight lines between them. The motion under a
plan is what the boat's own twin says (:func:`twin.model.rollout.roll_out`), from where the twin believes
the boat to be. Damped Gauss-Newton steps improve the best of a few first guesses: the plan of the
decision before, and helms that are held. Nothing is drawn at random.

Source: Levenberg 1944, Marquardt 1963 (damping); Nocedal and Wright 2006, section 10.3 and 16.7
(Gauss-Newton, bounds by projection).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from twin.agents.agent import ControllerError, check_actions, shaft_speeds
from twin.filters.linalg import cholesky, solve_factored
from twin.model.dynamics import N_ACT
from twin.model.rollout import ROOM, roll_out
from twin.model.structure import N_STATES
from twin.predictors.plus_ensemble import SHRINK
from twin.sim.batched_twins import LEG, CompiledTwins
from usv_gym.envs.tasks import ERRORS, follow, path_errors
from usv_gym.envs.vector import USVVectorEnv
from usv_kernel.jit import kernel

__all__ = [
    "ModelPredictive",
    "plan_all",
]

Array = NDArray[np.float64]

WIDTH = 2
"""Numbers in an action: shaft speed, angle."""

NUDGE = 1e-3
"""Change of a knot that gives a slope, in parts of full throttle and helm."""

DAMPINGS = (1e-3, 1e-1, 10.0)
"""Parts of the diagonal that are added to it in turn, until a step is an improvement."""

_CALM = np.empty((0, 3))

# what all boats are told alike
ROW, LENGTH, SPEED_USUAL, WITHIN, SHAFT, PROGRESS, EFFORT, CHANGE = range(8)


@kernel
def commands(knots, basis, mixing, limits, plan):
    """Write the commands (K, 4) of a plan's knots, in the unit of the model.

    Parameters
    ----------
    knots : (2 M,) array
        Shaft speeds, then angles; 1 is full.
    basis : (K, M) array
        Share of each knot in each row.
    mixing : (4, 2) array
        See :attr:`usv_gym.vessel.vessel.Vessel.mixing`.
    limits : (4,) array
        Full commands.
    plan : (K, 4) array
        Written.
    """
    many = basis.shape[1]
    for row in range(basis.shape[0]):
        shaft, angle = 0.0, 0.0
        for m in range(many):
            shaft += basis[row, m] * knots[m]
            angle += basis[row, m] * knots[many + m]
        for j in range(N_ACT):
            share = mixing[j, 0] * shaft + mixing[j, 1] * angle
            plan[row, j] = limits[j] * min(max(share, -1.0), 1.0)


@kernel
def misses(knots, last, states, points, leg, free, told, errors, legs, out):
    """Write what a plan misses, and return the sum of its squares.

    Parameters
    ----------
    knots, last : (2 M,), (2,) arrays
        The plan, and the action in force.
    states : (K, 6) array
        The motion.
    points : (P, 2) array
        Way points, m.
    leg : int
        That of now.
    free : bool
        Whether the legs follow from the motion, or are given: a slope is that of the same legs.
    told : array
        Time of a row, length, usual speed, reach of way points, usual shaft speed; weights.
    errors : (4,) array
        Room.
    legs : (K,) array
        Leg of each row.
    out : (2 K + 3 M,) array
        Lengths off the path and speed that is lacking, row by row; shaft speeds off the usual
        one, and changes from knot to knot.
    """
    K, many = states.shape[0], knots.shape[0] // WIDTH
    for k in range(K):
        s = states[k]
        if free:
            leg = follow(s[0], s[1], s[2], points, leg, told[WITHIN], errors)
            legs[k] = leg
        else:
            path_errors(s[0], s[1], s[2], points, int(legs[k]), errors)
        # within reach there is a point only where the path ends: there the boat is to stop
        wanted = 1.0
        if errors[1] < told[WITHIN]:
            wanted = max(errors[1] / told[WITHIN], -1.0)
        along = s[3] * math.cos(errors[2]) + s[4] * math.sin(errors[2])
        off = errors[0] / told[LENGTH]
        # its square grows as the distance does: far off the path the boat is to sail back, not wait
        out[k] = off / (1.0 + off * off) ** 0.25
        out[K + k] = told[PROGRESS] * (wanted - along / told[SPEED_USUAL])
    for m in range(many):
        out[2 * K + m] = told[EFFORT] * (knots[m] - told[SHAFT])
    for m in range(WIDTH * many):
        before = last[m // many] if m % many == 0 else knots[m - 1]
        out[2 * K + many + m] = told[CHANGE] * (knots[m] - before)
    total = 0.0
    for k in range(out.shape[0]):
        total += out[k] * out[k]
    return total


@kernel
def rate(knots, free, sources, model, goal, motion, out):
    """Roll the model under a plan, write what it misses, and return the sum of its squares.

    Parameters
    ----------
    knots : (2 M,) array
        The plan.
    free : bool
        See :func:`misses`.
    sources : tuple
        Basis, mixing and limits: see :func:`commands`.
    model : tuple
        State, parameters, actuators, wind, lags, envelope and structure: see
        :func:`twin.model.rollout.roll_out`.
    goal : tuple
        Action in force, way points, leg, and what :func:`misses` is told.
    motion : tuple
        Room: plan, states, actuators, scratch of the roll-out, errors, legs.
    out : (2 K + 3 M,) array
        Written.
    """
    basis, mixing, limits = sources
    s, theta, act, wind, lags, envelope, kit = model
    last, points, leg, told = goal
    plan, states, acts, scratch, errors, legs = motion
    commands(knots, basis, mixing, limits, plan)
    roll_out(
        *(s, theta, act, plan, told[ROW], lags, envelope, wind, kit, _CALM, 0.0),
        *(states, acts, scratch),
    )
    return misses(knots, last, states, points, leg, free, told, errors, legs, out)


@kernel
def _copy(source, target):
    for k in range(target.shape[0]):
        target[k] = source[k]


@kernel
def _downhill(knots, best, sources, model, goal, motion, room):
    """Take a damped Gauss-Newton step from a plan rated ``best``; return what the new one costs.

    That is ``best`` again where no step improves the plan, and the plan is left.
    """
    trial, base, miss, J, H, A, g, step, work = room
    V = knots.shape[0]
    rate(knots, True, sources, model, goal, motion, base)
    _copy(knots, trial)
    for k in range(V):
        nudge = -math.copysign(NUDGE, knots[k])  # never out of bounds
        trial[k] = knots[k] + nudge
        rate(trial, False, sources, model, goal, motion, miss)
        trial[k] = knots[k]
        g[k] = 0.0
        for j in range(base.shape[0]):
            J[k, j] = (miss[j] - base[j]) / nudge
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
        if cholesky(A, A, work) > 0:
            continue
        solve_factored(A, g, step)
        for k in range(V):
            trial[k] = min(max(knots[k] + step[k], -1.0), 1.0)
        cost = rate(trial, True, sources, model, goal, motion, miss)
        if cost < best:
            _copy(trial, knots)
            return cost
    return best


@kernel
def plan_all(
    rollout_inputs, now, points, told, sources, shift, common, guesses, steps, last, plans, start, motion,
    room,
):  # fmt: skip
    """Renew the plans of all boats.

    Parameters
    ----------
    beliefs : tuple
        Places, velocities, parameters, actuators and winds of
        :class:`twin.predictors.ukf.RolloutInputs`, bounds of the velocities (n, 3), and the prior.
    now : (n,) array
        Legs that the twins believe to be on.
    points : (n, P, 2) array
        Paths, m.
    told, sources
        See :func:`misses` and :func:`rate`.
    shift : (M, M) array
        Shares of the knots in those of one decision later.
    common : tuple
        Lags, envelope and structure.
    guesses : (G, 2 M) array
        First guesses besides the plan of before.
    steps : int
        Gauss-Newton steps at most.
    last : (n, 2) array
        Actions in force; the new ones are written there.
    plans : (n, 2 M) array
        Knots of the decision before; renewed.
    start, motion, room : tuple
        Room for state, parameters, actuators and wind; see :func:`rate`; for the steps.
    """
    places, velocities, parameters, actuators, winds, bounds, prior = rollout_inputs
    s, theta, act, wind = start
    trial, base = room[0], room[1]
    states, M = motion[1], shift.shape[0]
    model = (s, theta, act, wind, common[0], common[1], common[2])
    for i in range(places.shape[0]):
        goal = (last[i], points[i], int(now[i]), told)
        knots = plans[i]
        _copy(places[i], s[:3])
        _copy(velocities[i], s[3:])
        _copy(actuators[i], act)
        _copy(winds[i], wind)
        for k in range(WIDTH * M):
            trial[k] = 0.0
            for m in range(M):
                trial[k] += shift[k % M, m] * knots[k - k % M + m]
        _copy(trial, knots)
        best = 0.0
        for part in SHRINK:  # as the twin does: a model that is too wild is drawn back
            for k in range(theta.shape[0]):
                theta[k] = prior[k] + part * (parameters[i, k] - prior[k])
            best = rate(knots, True, sources, model, goal, motion, base)
            inside = True
            for k in range(states.shape[0]):
                for j in range(3):
                    inside = inside and abs(states[k, 3 + j]) <= bounds[i, j]
            if inside:
                break
        for guess in guesses:
            cost = rate(guess, True, sources, model, goal, motion, base)
            if cost < best:
                best = cost
                _copy(guess, knots)
        for _ in range(steps):
            cost = _downhill(knots, best, sources, model, goal, motion, room)
            if not cost < best:
                break
            best = cost
        for c in range(WIDTH):
            last[i, c] = knots[c * M]


class ModelPredictive:
    """Model-predictive control on the twin's model and state.

    Parameters
    ----------
    horizon : float
        How far ahead it plans, times to sail a length.
    rows : int
        Rows of the motion that are rated.
    knots : sequence of float
        Times of the knots, as parts of the horizon; what stands at the last one is held.
    steps : int
        Gauss-Newton steps in a decision, at most.
    progress, effort, change : float
        Weights of the speed that is lacking, of shaft speeds off the usual one, and of changes
        from knot to knot; a length off the path has the weight 1.
    """

    name = "mpc-twin"
    observation = "twin"

    def __init__(
        self,
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
                f"mpc-twin: horizon = {horizon}, rows = {rows}, steps = {steps}, knots = {knots}: "
                "must be above 0, 1 or more, 0 or more, and times that grow"
            )
        self.horizon, self.rows, self.knots, self.steps = horizon, rows, knots, steps
        self.weights = progress, effort, change

    def begin(self, envs: USVVectorEnv) -> None:
        """See :meth:`twin.agents.agent.Agent.begin`.

        Raises
        ------
        ControllerError
            Without a twin whose model is compiled.
        """
        base = envs.unwrapped
        observer = base.observer
        if not isinstance(observer, CompiledTwins):
            raise ControllerError(
                "mpc-twin rolls the models of compiled twins; make the environment with "
                "twin='ukf' or twin='dsw-ukf-plus'"
            )
        check_actions(self.name, base)
        joint, rollout_inputs, vessel = observer.joint, observer.rollout_inputs, base.vessel
        n, K, M, V = base.num_envs, self.rows, len(self.knots), WIDTH * len(self.knots)
        length, shafts = vessel.values["length_waterline"], shaft_speeds(vessel)
        h = self.horizon * length / base.speed / K
        dt = base.simulation.dt * base.frame_skip
        usual = shafts[1] / shafts[0]
        self._told = np.array(
            [h, length, base.speed, base.task.rules["reach"], usual, *self.weights]
        )
        times, each = h * K * np.array(self.knots), np.eye(M)
        between = [
            np.stack([np.interp(t, times, row) for row in each], axis=1)
            for t in (h * np.arange(K), times + dt)
        ]
        limits = np.array([joint.settings.n_unit * shafts[0]] * 2 + [vessel.helm_max] * 2)
        self._sources, self._shift = (between[0], vessel.mixing.copy(), limits), between[1]
        self._common = joint.lags, joint.envelope, joint.kit
        held = [(usual, x) for x in (-1.0, -0.4, 0.0, 0.4, 1.0)] + [(-usual, 0.0)]
        self._guesses = np.repeat(np.array(held), M, axis=1)
        self._beliefs, self._paths = rollout_inputs, base.task.points
        self._legs = observer.notes[:, LEG]
        self._bounds = np.empty((n, 3))
        self._last = np.tile([usual, 0.0], (n, 1))
        self._plans = np.repeat(self._last, M, axis=1)
        self._start = (
            np.empty(N_STATES),
            np.empty(len(rollout_inputs.prior)),
            np.empty(N_ACT),
            np.empty(2),
        )
        self._motion = (
            *(np.empty((K, N_ACT)), np.empty((K, N_STATES)), np.empty((K, N_ACT))),
            *(np.empty(ROOM), np.empty(len(ERRORS)), np.empty(K)),
        )
        R = 2 * K + 3 * M
        self._room = (
            *(np.empty(V), np.empty(R), np.empty(R), np.empty((V, R))),
            *(np.empty((V, V)), np.empty((V, V)), np.empty(V), np.empty(V), np.empty((1, V))),
        )

    def act(self, obs: NDArray[np.float32]) -> Array:
        """See :meth:`twin.agents.agent.Agent.act`; it looks at the twins themselves."""
        believed = self._beliefs
        np.maximum(1.5 * believed.seen, believed.usual, out=self._bounds)
        plan_all(
            *((*believed[:5], self._bounds, believed.prior), self._legs, self._paths, self._told),
            *(self._sources, self._shift, self._common, self._guesses, self.steps),
            *(self._last, self._plans, self._start, self._motion, self._room),
        )
        return self._last.copy()
