"""State and parameters of the twin's model in the structured UKF."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.checkpoint import Field
from twin.filters.navigation_ekf import GAP_MAX
from twin.filters.ukf import scaled_weights, workspace
from twin.identification.filter_settings import FilterSettings
from twin.identification.identifiability import accumulate
from twin.model.actuators import follow_all
from twin.model.augmented import joint_predict
from twin.model.dynamics import N_ACT
from twin.model.rollout import LOOK_AHEAD, ROOM, roll_out, upsample
from twin.model.structure import N_STATES, N_TERMS
from twin.particulars import Particulars
from usv_kernel.arrays import shaped
from usv_kernel.jit import inlined, kernel, py_func

__all__ = [
    "JointUKF",
    "advance",
    "hold_inside",
    "scale_plan",
    "see",
]

Array = NDArray[Any]

PSI = 2

STEP_MAX = 0.1
"""Longest step of the filter's prediction, s; longer gaps are cut up."""

BAND_STEP = 0.25
"""Step at which covariances are carried along a prediction, s."""

SEE_EVERY, SEE_MAX = 0.25, 1.0
"""Regressors are counted each SEE_EVERY s, and stand for no more than SEE_MAX s of a gap."""


@inlined
def parts(memory, constants, kit):
    """Return x, P, act, wind, q, q_xi, r, p0, lags, envelope, weights and n_unit as views.

    The joint filter has few flat arrays, because each one that a kernel takes costs a call.
    """
    p = kit[0].shape[1]
    n = N_STATES + p
    end = n + n * n
    x, act, wind = memory[:n], memory[end : end + N_ACT], memory[end + N_ACT : end + N_ACT + 2]
    P = shaped(memory, n, (n, n))
    q, q_xi = constants[:N_STATES], constants[N_STATES:n]
    r, p0 = constants[n : n + N_STATES], constants[n + N_STATES : n + 2 * N_STATES]
    rest = constants[n + 2 * N_STATES :]
    return x, P, act, wind, q, q_xi, r, p0, rest[:3], rest[3:6], rest[6:10], rest[10]


@inlined
def wave_parts(memory, constants, kit):
    """Return the mean squares of the waves felt, of u, v, r, and ``FilterSettings.waves``."""
    n = N_STATES + kit[0].shape[1]
    first = n + n * n + N_ACT + 2
    return memory[first : first + 3], constants[constants.shape[0] - 3 :]


@inlined
def rooms(scratch, kit):
    """Return room for Q, q_xi, R, terms, four numbers, six numbers and a roll-out as views."""
    square = N_STATES * N_STATES
    rest = scratch[2 * square :]
    return (
        shaped(scratch, 0, (N_STATES, N_STATES)),
        shaped(scratch, square, (N_STATES, N_STATES)),
        rest[:N_TERMS],
        rest[N_TERMS : N_TERMS + 4],
        rest[N_TERMS + 4 : N_TERMS + 10],
        rest[N_TERMS + 10 : N_TERMS + 10 + ROOM],
        rest[N_TERMS + 10 + ROOM :],
    )


@inlined
def _process_noise(h, memory, constants, kit, Q, qx):
    """Write the process noise of a step of h: Q (6, 6) of the states, qx (p,) of the parameters."""
    _, _, _, _, q, q_xi, _, _, _, _, _, _ = parts(memory, constants, kit)
    felt, waves = wave_parts(memory, constants, kit)
    for i in range(N_STATES):
        Q[i, i] = q[i] * h
    for i in range(3):
        Q[3 + i, 3 + i] += waves[2] * felt[i] * h
    for k in range(q_xi.shape[0]):
        qx[k] = q_xi[k] * h


@kernel
def scale_plan(plan, n_unit, scaled):
    """Write a plan (K, 4) with its shaft speeds in the unit of the structure."""
    for row in range(plan.shape[0]):
        for k in range(2):
            scaled[row, k] = n_unit * plan[row, k]
            scaled[row, 2 + k] = plan[row, 2 + k]


@inlined
def advance(dt, cmd, memory, constants, scratch, work, kit):
    """Predict state, parameters and covariance of the joint filter over dt, actuators included.

    Parameters
    ----------
    dt : float
        Time, s.
    cmd : ndarray, shape (4,)
        Commands of the actuators.
    memory, constants, scratch, work, kit
        Of a :class:`JointUKF`; the memory is advanced in place.
    """
    x, P, act, wind, _, _, _, _, lags, _, weights, n_unit = parts(memory, constants, kit)
    Q, _, terms, _, _, _, qx = rooms(scratch, kit)
    dt = min(dt, GAP_MAX)
    steps = max(1, math.ceil(dt / STEP_MAX - 1e-9))
    h = dt / steps
    _process_noise(h, memory, constants, kit, Q, qx)
    for _ in range(steps):
        follow_all(act, cmd, lags, n_unit, 0.5 * h)
        joint_predict(x, P, act, wind, kit, h, Q, qx, weights, terms, work)
        follow_all(act, cmd, lags, n_unit, 0.5 * h)


@kernel
def see(dt, terms, memory, kit):
    """Add the terms of the moment to what was seen, at SEE_EVERY.

    Parameters
    ----------
    dt : float
        Time since the call before, s.
    terms : ndarray
        All terms of the moment.
    memory, kit
        Of a :class:`JointUKF`. Its memory ends with the time since terms were added, the time
        seen (s), and a Gram matrix for each of surge, sway and yaw.
    """
    n = N_STATES + kit[0].shape[1]
    seen = memory[n + n * n + N_ACT + 5 :]
    seen[0] += dt
    if seen[0] < SEE_EVERY - 1e-9:
        return
    seconds = min(seen[0], SEE_MAX)
    seen[0] = 0.0
    seen[1] += seconds
    first = 2
    for i in range(3):
        low, high = kit[1][3 + i, 0] - N_STATES, kit[1][3 + i, 1] - N_STATES
        size = (high - low) ** 2
        gram = shaped(seen, first, (high - low, high - low))
        accumulate(gram, terms, kit[0][i, low:high], seconds)
        first += size


@inlined
def hold_inside(x, envelope):
    """Keep the velocities inside what the boat can do: bad parameters must not run away.

    Parameters
    ----------
    x : ndarray, shape (31,)
        Joint vector, changed in place.
    envelope : ndarray, shape (3,)
        Largest size of u, v (m/s) and r (rad/s).
    """
    for i in range(3):
        x[3 + i] = min(max(x[3 + i], -envelope[i]), envelope[i])


@kernel
def _bands(acts, dt, every, memory, constants, scratch, work, kit, copy, out):
    """Write the covariance of the state after each ``every`` rows of a prediction."""
    steps = max(1, math.ceil(dt * every / BAND_STEP - 1e-9))
    h = dt * every / steps
    for k in range(memory.shape[0]):
        copy[k] = memory[k]
    x, P, _, wind, _, _, _, _, _, envelope, weights, _ = parts(copy, constants, kit)
    Q, _, terms, _, _, _, qx = rooms(scratch, kit)
    _process_noise(h, copy, constants, kit, Q, qx)
    for j in range(out.shape[0]):
        last = min((j + 1) * every, acts.shape[0]) - 1
        for _ in range(steps):
            joint_predict(x, P, acts[last], wind, kit, h, Q, qx, weights, terms, work)
            hold_inside(x, envelope)
        for i in range(N_STATES):
            for k in range(N_STATES):
                out[j, i, k] = P[i, k]


@kernel
def _roll(plan, dt, memory, constants, scratch, kit, ripple, scaled, out, acts):
    """Roll the model under a plan whose shaft speeds are in the unit of the particulars."""
    x, _, act, wind, _, _, _, _, lags, envelope, _, n_unit = parts(memory, constants, kit)
    room = rooms(scratch, kit)[5]
    scale_plan(plan, n_unit, scaled)
    s, xi = x[:N_STATES], x[N_STATES:]
    roll_out(s, xi, act, scaled, dt, lags, envelope, wind, kit, ripple, 0.0, out, acts, room)


@kernel
def spread_now(gps_var, P_nav, memory, kit, now):
    """Write how unsure the state is now, as variances on the diagonal of ``now`` (6, 6).

    Other arguments as for :func:`spread_ahead`.
    """
    n = N_STATES + kit[0].shape[1]
    P = shaped(memory, n, (n, n))
    for i in range(N_STATES):
        now[i, i] = P[i, i] + P_nav[i, i] + (gps_var if i < 2 else 0.0)


@kernel
def spread_ahead(command, gps_var, P_nav, memory, constants, scratch, work, kit, copy, now, out):
    """Write how unsure the state will be at LOOK_AHEAD under a held command.

    What :meth:`ModelPredictor.predict` says of the same times, but for how the actuators move.

    Parameters
    ----------
    command : (4,) array
        In the unit of the structure, rad.
    gps_var : float
        Variance of the drifting part of a fix, m2.
    P_nav : (12, 12) array
        Covariance of the navigation.
    memory, constants, scratch, work, kit
        Of a :class:`JointUKF`.
    copy : array
        Room as large as the memory.
    now, out : (6, 6), (4, 6, 6) arrays
        From :func:`spread_now`; covariances ahead, which are written.
    """
    for k in range(memory.shape[0]):
        copy[k] = memory[k]
    x, P, act, wind, _, _, _, _, lags, envelope, weights, _ = parts(copy, constants, kit)
    Q, _, terms, _, _, _, qx = rooms(scratch, kit)
    _process_noise(BAND_STEP, copy, constants, kit, Q, qx)
    before = 0.0
    for j in range(LOOK_AHEAD.shape[0]):
        after = LOOK_AHEAD[j]
        for _ in range(round((after - before) / BAND_STEP)):
            follow_all(act, command, lags, 1.0, 0.5 * BAND_STEP)
            joint_predict(x, P, act, wind, kit, BAND_STEP, Q, qx, weights, terms, work)
            follow_all(act, command, lags, 1.0, 0.5 * BAND_STEP)
            hold_inside(x, envelope)
        before = after
        for i in range(N_STATES):
            # deviations that no boat could have by then
            most = 2.0 * envelope[0] * after + math.sqrt(now[i, i])
            if i == PSI:
                most = 2.0 * min(envelope[2] * after, math.pi) + math.sqrt(now[i, i])
            elif i > PSI:
                most = 2.0 * envelope[i - 3]
            variance = P[i, i] + P_nav[i, i] + (gps_var if i < 2 else 0.0)
            terms[i] = min(1.0, most / math.sqrt(max(variance, 1e-300)))
        for i in range(N_STATES):
            for k in range(N_STATES):
                total = P[i, k] + P_nav[i, k] + (gps_var if i == k and i < 2 else 0.0)
                out[j, i, k] = total * (terms[i] * terms[k])


_NO_RIPPLE = np.empty((0, 3))


JOINT_FIELDS = {
    "covariance": Field(covariance=True),
    **dict.fromkeys(("wave_power", "since_counted", "seconds_seen"), Field(low=0.0)),
}
"""What the fields of :meth:`JointUKF.views` may hold."""


class JointUKF:
    """State and parameters of the twin's model in the structured UKF.

    Parameters
    ----------
    particulars : Particulars
        The boat.
    settings : FilterSettings
        Noises and prior.

    Attributes
    ----------
    x, P : ndarray, shapes (6 + p,), (6 + p, 6 + p)
        Mean and covariance: six states, then the parameters.
    act : ndarray, shape (4,)
        Where the actuators are believed to be, in the unit of the structure.
    seen, grams : ndarray, list of three ndarrays
        Time seen (first entry, s), and the Gram matrices of surge, sway and yaw: see
        :func:`twin.identification.identifiability.accumulate`.
    wind : ndarray, shape (2,)
        True wind to north and east, m/s; zeros until it is measured.
    """

    def __init__(self, particulars: Particulars, settings: FilterSettings) -> None:
        self.settings = settings
        self.kit = settings.structure.kit
        n = N_STATES + len(settings.structure)
        self.lags = np.array([particulars.shaft_lag, particulars.steer_lag, particulars.steer_rate])
        U, L = particulars.speed, particulars.length
        self.envelope = np.array([4.0 * U, 4.0 * U, 4.0 * U / L])
        self.weights = scaled_weights(n, settings.alpha, settings.beta, settings.kappa)
        sizes = [b - a for a, b in settings.structure.blocks.values()]
        self.memory = np.zeros(n + n * n + N_ACT + 7 + sum(k * k for k in sizes))
        self.seen = self.memory[n + n * n + N_ACT + 6 :]
        ends = np.cumsum([1, *(k * k for k in sizes)])
        self.grams = [
            self.seen[end - k * k : end].reshape(k, k)
            for k, end in zip(sizes, ends[1:], strict=True)
        ]
        self.constants = np.concatenate(
            [
                *(settings.q, settings.q_xi, settings.r, settings.p0),
                *(self.lags, self.envelope, self.weights),
                *([settings.n_unit], settings.waves),
            ]
        )
        views = py_func(parts)(self.memory, self.constants, self.kit)
        self.x, self.P, self.act, self.wind, self.q, _, self.r, *_ = views
        self.scratch = np.zeros(2 * N_STATES**2 + N_TERMS + 10 + ROOM + n - N_STATES)
        self.work = workspace(N_STATES, n - N_STATES)
        self.arguments = (self.memory, self.constants, self.scratch, self.work, self.kit)
        self._scaled = np.empty((0, 4))
        self._copy = np.empty_like(self.memory)
        self.reset()

    def views(self) -> dict[str, Array]:
        """Return what the filter remembers as fields by name, which are views."""
        first = len(self.memory) - len(self.seen) - 1
        grams = zip(("surge", "sway", "yaw"), self.grams, strict=True)
        return {
            **{"mean": self.x, "covariance": self.P, "actuators": self.act, "wind": self.wind},
            "wave_power": self.memory[first - 3 : first],
            "since_counted": self.memory[first : first + 1],
            "seconds_seen": self.seen[:1],
            **{f"gram.{name}": gram for name, gram in grams},
        }

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

    def roll(self, plan: Array, dt: float) -> tuple[Array, Array]:
        """Return states (K, 6) and actuators (K, 4) under a plan; nothing is changed.

        Parameters
        ----------
        plan : ndarray, shape (K, 4)
            Commands; shaft speeds in the unit of the particulars.
        dt : float
            Time between rows, s.
        """
        K = len(plan)
        out, acts = np.empty((K, N_STATES)), np.empty((K, 4))
        if len(self._scaled) != K:
            self._scaled = np.empty((K, 4))
        _roll(
            *(plan, dt, self.memory, self.constants, self.scratch, self.kit),
            *(_NO_RIPPLE, self._scaled, out, acts),
        )
        return out, acts

    def bands(self, acts: Array, dt: float) -> Array:
        """Return covariances (K, 6, 6) of the states that :meth:`roll` gave with ``acts``."""
        every = max(1, min(round(BAND_STEP / dt), len(acts)))
        coarse = np.zeros((math.ceil(len(acts) / every), N_STATES, N_STATES))
        _bands(acts, dt, every, *self.arguments, self._copy, coarse)
        if every == 1:
            return coarse
        path = np.concatenate([self.P[None, :N_STATES, :N_STATES], coarse])
        return upsample(path, every, len(acts))
