"""What twins add to observations: n boats in one compiled call where the predictor has one.

The ``ukf`` and ``dsw-ukf-plus`` keep all that they remember in flat arrays, which stand here row by
row, one for each boat. Every other predictor is asked boat by boat.
"""

from __future__ import annotations

import copy
import math
from abc import abstractmethod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.channels import MEASUREMENTS
from twin.digital_twin import Twin
from twin.identification.joint_ukf import (
    JointUKF,
    parts,
    rooms,
    scale_plan,
    spread_ahead,
    spread_now,
)
from twin.model.dynamics import N_ACT
from twin.model.rollout import LOOK_AHEAD, look_ahead
from twin.model.structure import N_STATES
from twin.particulars import Particulars
from twin.predictors.base import Predictor
from twin.predictors.dsw_ukf_plus import PlusPredictor
from twin.predictors.plus_ensemble import plus_look, plus_spread
from twin.predictors.plus_update import plus_step
from twin.predictors.registry import PredictorError, predictor_class
from twin.predictors.ukf import RolloutInputs, UKFPredictor, nav_parts, tight_step
from twin.sim.bridge import particulars_of
from twin.sim.oracle import simulator_options
from usv_gym.envs.episodes import BOUND, EPISODES, OBSERVATION, Episodes, Observer
from usv_gym.envs.render import TwinOverlay
from usv_gym.envs.tasks import ERRORS, follow
from usv_gym.physics import frames as fr
from usv_gym.world.channels import CHANNELS
from usv_gym.world.state import BOAT
from usv_kernel.arrays import shaped
from usv_kernel.jit import inlined, kernel, py_func
from usv_kernel.records import as_record
from usv_kernel.scalar import sincos

__all__ = [
    "HORIZONS",
    "TWIN_OBSERVATION",
    "TwinObserver",
    "observer_of",
]

Array = NDArray[np.float64]

HORIZONS: tuple[float, ...] = tuple(LOOK_AHEAD.tolist())
"""How far ahead the observation looks, s."""

PLAN_STEP = 0.25

_ROWS = np.array([round(h / PLAN_STEP) - 1 for h in HORIZONS])

_SD = ("sd_forward", "sd_starboard", "sd_heading", "sd_surge", "sd_sway", "sd_yaw_rate")

TWIN_OBSERVATION = (
    *("twin_surge", "twin_sway", "twin_yaw_rate", "twin_cos_heading", "twin_sin_heading"),
    *("twin_cross_track", "twin_to_go", "twin_cos_course_error", "twin_sin_course_error"),
    *("twin_cos_next_turn", "twin_sin_next_turn"),
    *(f"twin_{name}" for name in _SD),
    *(
        f"ahead_{h:g}s_{name}"
        for h in HORIZONS
        for name in (
            *("forward", "starboard", "cos_turn", "sin_turn", "surge", "sway", "yaw_rate"),
            *_SD,
        )
    ),
)
"""Names of the entries that the twin adds; scales in :class:`twin.sim.wrapper.TwinObservation`."""

# one row of numbers per boat: time of the last row, of the one last looked at, of the next bands,
# leg, errors of the path, how far the believed position is off, the measurements, variances now,
# states and covariances ahead
LAST, SHOWN, RENEW_AT, LEG, PATH_ERRORS = 0, 1, 2, 3, 4

OFF = PATH_ERRORS + len(ERRORS)

ROW = OFF + 1

NOW = ROW + len(MEASUREMENTS)

AHEAD = NOW + N_STATES**2

COVS = AHEAD + len(HORIZONS) * N_STATES

NOTE_SIZE = COVS + len(HORIZONS) * N_STATES**2

# what all boats of a batch are told alike
PERIOD, GPS_VAR, TIME_SCALE, LOOK = 0, 1, 2, 3

_CALM = np.empty((0, 3))

_ALL = slice(None)


@inlined
def _spread(cov, c, s, length, speed, out, at):
    """Write the six standard deviations of a state, position turned into the body frame."""
    a, b, d = cov[0, 0], cov[0, 1], cov[1, 1]
    out[at] = math.sqrt(max(c * c * a + 2.0 * c * s * b + s * s * d, 0.0)) / length
    out[at + 1] = math.sqrt(max(s * s * a - 2.0 * c * s * b + c * c * d, 0.0)) / length
    out[at + 2] = math.sqrt(max(cov[2, 2], 0.0))
    out[at + 3] = math.sqrt(max(cov[3, 3], 0.0)) / speed
    out[at + 4] = math.sqrt(max(cov[4, 4], 0.0)) / speed
    out[at + 5] = math.sqrt(max(cov[5, 5], 0.0))


@inlined
def note_parts(note):
    """Return path errors, measurements, variances now, states and covariances ahead as views."""
    many = (COVS - AHEAD) // N_STATES
    return (
        note[PATH_ERRORS:OFF],
        note[ROW:NOW],
        shaped(note, NOW, (N_STATES, N_STATES)),
        shaped(note, AHEAD, (many, N_STATES)),
        shaped(note, COVS, (many, N_STATES, N_STATES)),
    )


@inlined
def _next_row(boat, note):
    """Write a boat's measurements to its note; return the time since the row before, or -1.

    -1 stands for no new row: the boat rests.
    """
    t, last = boat.t, note[LAST]
    if t == last:
        return -1.0
    note[LAST] = t
    for k in range(len(CHANNELS)):
        note[ROW + k] = boat.measurement[k]
    for k in range(len(CHANNELS), len(MEASUREMENTS)):
        note[ROW + k] = math.nan
    return t - last if math.isfinite(last) else 0.0


@inlined
def _is_looked_for(note, look):
    """Return whether a boat's part of the observation is to be written, and is not yet."""
    if look == 0.0 or note[SHOWN] == note[LAST]:
        return False
    note[SHOWN] = note[LAST]
    return True


@kernel
def describe(s, boat, note, points, rules, obs):
    """Write the twin's part of one boat's observation, from state ``s`` and what is noted."""
    errors, _, now, ahead, covs = note_parts(note)
    speed, psi = rules.speed, s[2]
    d, c = sincos(psi)
    note[LEG] = follow(s[0], s[1], psi, points, int(note[LEG]), rules.reach, errors)
    o = obs[len(OBSERVATION) : len(OBSERVATION) + len(TWIN_OBSERVATION)]
    o[0], o[1], o[2], o[3], o[4] = s[3] / speed, s[4] / speed, s[5], c, d
    o[5], o[6] = errors[0] / rules.unit, 0.1 * errors[1] / rules.unit
    o[8], o[7] = sincos(errors[2])
    o[10], o[9] = sincos(errors[3])
    _spread(now, c, d, rules.unit, speed, o, 11)
    at = 17
    for j in range(ahead.shape[0]):
        m = ahead[j]
        length = speed * LOOK_AHEAD[j]
        dx, dy, turn = m[0] - s[0], m[1] - s[1], m[2] - psi
        o[at] = (dx * c + dy * d) / length
        o[at + 1] = (dy * c - dx * d) / length
        o[at + 3], o[at + 2] = sincos(turn)
        o[at + 4], o[at + 5], o[at + 6] = m[3] / speed, m[4] / speed, m[5]
        _spread(covs[j], c, d, length, speed, o, at + 7)
        at += 13
    for j in range(o.shape[0]):
        o[j] = min(max(o[j], -BOUND), BOUND)
    note[OFF] = math.hypot(s[0] - boat.state[fr.X], s[1] - boat.state[fr.Y])


@kernel
def _ukf_all(
    boats, points, shared, told, notes, nav, memory, nav_settings, nav_work, constants, scratch,
    work, kit, room, obs,
):  # fmt: skip
    """Let the twins of boats with a new row take it, and write their parts of the observations.

    ``room`` is for one memory, four actuators at each horizon, and a command.
    """
    rules = as_record(shared, EPISODES).rules
    copied = room[: memory.shape[1]]
    acts = shaped(room, memory.shape[1], (len(HORIZONS) + 1, N_ACT))
    held = acts[acts.shape[0] - 1]
    for i in range(boats.shape[0]):
        boat, note = as_record(boats[i], BOAT), notes[i]
        dt = _next_row(boat, note)
        _, z, now, ahead, covs = note_parts(note)
        x, _, act, wind, _, _, _, _, lags, envelope, _, n_unit = parts(memory[i], constants, kit)
        cmd = boat.command
        if dt >= 0.0:
            tight_step(
                *(dt, z, cmd, nav[i], nav_settings, nav_work),
                *(memory[i], constants, scratch, work, kit),
            )
        if not _is_looked_for(note, told[LOOK]):
            continue
        scale_plan(shaped(cmd, 0, (1, N_ACT)), n_unit, shaped(held, 0, (1, N_ACT)))
        look_ahead(
            *(x[:N_STATES], x[N_STATES:], act, held, lags, envelope, wind, kit, told[TIME_SCALE]),
            *(_CALM, 0.0, ahead, acts, rooms(scratch, kit)[5]),
        )
        spread_now(told[GPS_VAR], nav_parts(nav[i])[1], memory[i], kit, now)
        if note[LAST] >= note[RENEW_AT]:
            note[RENEW_AT] = note[LAST] + told[PERIOD] - 1e-9
            spread_ahead(
                *(held, told[GPS_VAR], nav_parts(nav[i])[1], memory[i], constants, scratch),
                *(work, kit, copied, now, covs),
            )
        describe(x[:N_STATES], boat, note, points[i], rules, obs[i])


@kernel
def _plus_all(
    boats, points, shared, told, notes, nav, memory, rows, book, nav_settings, nav_work, constants,
    scratch, work, kit, refit_rules, refit_room, usual, look_room, shocks, room, obs,
):  # fmt: skip
    """Do for ``dsw-ukf-plus`` what :func:`_ukf_all` does for ``ukf``."""
    rules = as_record(shared, EPISODES).rules
    held = room[room.shape[0] - N_ACT :]
    for i in range(boats.shape[0]):
        boat, note = as_record(boats[i], BOAT), notes[i]
        dt = _next_row(boat, note)
        _, z, now, ahead, covs = note_parts(note)
        cmd = boat.command
        if dt >= 0.0:
            plus_step(
                *(note[LAST], dt, z, cmd, nav[i], nav_settings, nav_work, memory[i], constants),
                *(scratch, work, kit, rows[i], book[i], refit_rules, refit_room),
            )
        if not _is_looked_for(note, told[LOOK]):
            continue
        n, P_nav = nav_parts(nav[i])
        x, _, _, _, _, _, _, _, _, _, _, n_unit = parts(memory[i], constants, kit)
        scale_plan(shaped(cmd, 0, (1, N_ACT)), n_unit, shaped(held, 0, (1, N_ACT)))
        plus_look(
            *(held, n, usual, told[TIME_SCALE], rows[i], book[i], refit_rules, memory[i]),
            *(constants, kit, ahead, look_room),
        )
        spread_now(told[GPS_VAR], P_nav, memory[i], kit, now)
        if note[LAST] >= note[RENEW_AT]:
            note[RENEW_AT] = note[LAST] + told[PERIOD] - 1e-9
            plus_spread(
                *(held, told[GPS_VAR], told[TIME_SCALE], P_nav, ahead, book[i], memory[i]),
                *(constants, kit, shocks, look_room, covs),
            )
        describe(x[:N_STATES], boat, note, points[i], rules, obs[i])


class TwinObserver(Observer):
    """Twins of n boats, and their parts of the observations.

    Parameters
    ----------
    episodes : Episodes
        The boats; only their measurements, commands and paths are looked at.
    twin : Twin
        That of the first boat, as new.
    band_period : float
        The standard deviations ahead are renewed this often, s; 0 for every step.
    parameters : bool
        Add the parameters of the identified model and their standard deviations, both in units
        of the standard deviations that they had at the start.
    """

    def __init__(
        self, episodes: Episodes, twin: Twin, band_period: float, parameters: bool = False
    ) -> None:
        self.episodes, self.first, self.band_period = episodes, twin, band_period
        self.notes = np.zeros((episodes.n, NOTE_SIZE))
        self.notes[:, [LAST, SHOWN]] = math.nan
        self.names: tuple[str, ...] = TWIN_OBSERVATION
        self._parameters = parameters
        if parameters:
            prior = twin.predictor.estimate()
            if not prior.params.size:
                raise PredictorError(
                    f"{twin.name} identifies no parameters: observation='twin_params' needs a "
                    "twin with a model, such as 'ukf'"
                )
            self._prior, self._prior_sd = prior.params, np.maximum(prior.params_sd, 1e-12)
            known = twin.predictor.parameter_names
            self.names += (*(f"xi_{name}" for name in known), *(f"sd_{name}" for name in known))

    @property
    def off(self) -> Array:
        """Distance (n,) of the believed from the true positions, m; a view."""
        return self.notes[:, OFF]

    def infos(self) -> dict[str, np.ndarray]:
        """See :class:`Observer`."""
        return {"twin_position_error_m": self.off}

    def reset(self, i: int) -> None:
        """Let boat i begin an episode with a twin that knows nothing yet."""
        self.notes[i] = 0.0
        self.notes[i, [LAST, SHOWN]] = math.nan
        self._forget(i)

    def overlay(self, i: int) -> TwinOverlay | None:
        """Return what the twin of boat i believes, for pictures; None before its first row."""
        note = self.notes[i]
        if not math.isfinite(note[LAST]):
            return None
        _, _, now, ahead, covs = py_func(note_parts)(note)
        return TwinOverlay(
            state=self._state(i),
            cov=now[:2, :2].copy(),
            horizons=LOOK_AHEAD.copy(),
            ahead=ahead.copy(),
            covs=covs[:, :2, :2].copy(),
        )

    @abstractmethod
    def _state(self, i: int) -> Array:
        """Return a copy of the state (6,) that the twin of boat i believes in."""

    def observe(self, obs: NDArray[np.float32], look: bool = True, rows: slice = _ALL) -> None:
        """Let the twins of boats with a new row take it, and write their parts of ``obs``.

        Parameters
        ----------
        obs : ndarray, shape (n, D)
            Observations of all boats.
        look : bool
            Predict and write; without it, the row is taken in and no more.
        rows : slice
            The boats to look at.
        """
        self._observe(obs, look, rows)
        if look and self._parameters:
            xi, sd = self._identified(rows)
            at = len(OBSERVATION) + len(TWIN_OBSERVATION)
            half = at + xi.shape[1]
            obs[rows, at:half] = ((xi - self._prior) / self._prior_sd).clip(-BOUND, BOUND)
            obs[rows, half:] = (sd / self._prior_sd).clip(-BOUND, BOUND)

    @abstractmethod
    def _forget(self, i: int) -> None: ...

    @abstractmethod
    def _observe(self, obs: NDArray[np.float32], look: bool, rows: slice) -> None: ...

    @abstractmethod
    def _identified(self, rows: slice) -> tuple[Array, Array]:
        """Return parameters (k, p) of some boats' models, and their standard deviations."""

    @abstractmethod
    def twin(self, i: int) -> Twin:
        """Return a copy of the twin of boat i, that knows what it knows now."""


class SeparateTwins(TwinObserver):
    """A predictor for each boat, asked one after the other; for any predictor."""

    def __init__(
        self, episodes: Episodes, twin: Twin, band_period: float, parameters: bool = False
    ) -> None:
        super().__init__(episodes, twin, band_period, parameters)
        self.twins = [twin, *(copy.deepcopy(twin) for _ in range(episodes.n - 1))]
        self._plan = np.zeros((round(HORIZONS[-1] / PLAN_STEP), N_ACT))

    def _state(self, i: int) -> Array:
        return np.array(self.twins[i].predictor.state, dtype=np.float64)

    def _forget(self, i: int) -> None:
        self.twins[i].reset()

    def twin(self, i: int) -> Twin:
        """See :meth:`TwinObserver.twin`."""
        return copy.deepcopy(self.twins[i])

    def _identified(self, rows: slice) -> tuple[Array, Array]:
        """See :class:`TwinObserver`."""
        found = [twin.predictor.estimate() for twin in self.twins[rows]]
        return np.array([one.params for one in found]), np.array([one.params_sd for one in found])

    def _observe(self, obs: NDArray[np.float32], look: bool, rows: slice) -> None:
        sim, task = self.episodes.simulation, self.episodes.task
        for i in range(self.episodes.n)[rows]:
            note = self.notes[i]
            dt = _next_row(sim.boats[i], note)
            t, twin = note.item(LAST), self.twins[i]
            _, z, now, ahead, covs = py_func(note_parts)(note)
            if dt >= 0.0:
                # what a twin keeps must not change with the next row
                twin.feed(t, z.copy(), sim.cmd[i].copy())
            if not _is_looked_for(note, float(look)):
                continue
            self._plan[:] = sim.cmd[i]
            if t >= note[RENEW_AT]:
                note[RENEW_AT] = t + self.band_period - 1e-9
                prediction = twin.predictor.predict(self._plan, PLAN_STEP)
                ahead[:], covs[:] = prediction.mean[_ROWS], prediction.cov[_ROWS]
            else:
                ahead[:] = twin.predictor.mean(self._plan, PLAN_STEP)[_ROWS]
            np.fill_diagonal(now, twin.predictor.estimate().sd ** 2)
            s = np.ascontiguousarray(twin.predictor.state, dtype=np.float64)
            describe(s, sim.boats[i], note, task.points[i], task.rules, obs[i])


class CompiledTwins(TwinObserver):
    """All twins in one call; what each remembers is a row of a few arrays.

    Of one boat the arrays are the predictor's own.
    """

    def __init__(
        self, episodes: Episodes, twin: Twin, band_period: float, parameters: bool = False
    ) -> None:
        super().__init__(episodes, twin, band_period, parameters)
        predictor = self._predictor = _compiled(twin)
        self._single, self._cmd = episodes.n == 1, episodes.simulation.cmd[0]
        own = predictor.remembered
        self._blank = [array.copy() for array in own]
        many = episodes.n
        self.memories = [
            array[None] if many == 1 else np.repeat(array[None], many, axis=0) for array in own
        ]
        particulars = predictor.particulars
        self._told = np.array(
            [band_period, particulars.instruments.gps_bias_sd**2, particulars.time_scale, 1.0]
        )
        self._shared = predictor.shared
        self._room = np.zeros(len(predictor.ukf.memory) + (len(HORIZONS) + 1) * N_ACT)
        # a thread needs scratch of its own
        self._all = [self._arguments(rows, own=True) for rows in episodes.blocks]

    def _state(self, i: int) -> Array:
        _, memory, *_ = self.memories
        return memory[i, :N_STATES].copy()

    def _forget(self, i: int) -> None:
        if self._single:
            self.first.reset()
            return
        for memory, blank in zip(self.memories, self._blank, strict=True):
            memory[i] = blank

    def twin(self, i: int) -> Twin:
        """See :meth:`TwinObserver.twin`."""
        twin = copy.deepcopy(self.first)
        predictor = _compiled(twin)
        for array, memory in zip(predictor.remembered, self.memories, strict=True):
            array[:] = memory[i]
        twin.t = predictor.t = self.notes.item(i, LAST)
        twin.cmd = self.episodes.simulation.cmd[i].copy()
        return twin

    def _identified(self, rows: slice) -> tuple[Array, Array]:
        """See :class:`TwinObserver`."""
        n = N_STATES + len(self._prior)
        memory = self.memories[1][rows]
        return memory[:, N_STATES:n], np.sqrt(memory[:, n : n + n * n : n + 1][:, N_STATES:])

    def _observe(self, obs: NDArray[np.float32], look: bool, rows: slice) -> None:
        self._told[LOOK] = look
        if rows != _ALL:
            self._call(*self._arguments(rows), obs[rows])
        elif len(self._all) == 1:
            self._call(*self._all[0], obs)
        else:
            self.episodes.each(lambda j: self._call(*self._all[j], obs[self.episodes.blocks[j]]))
        if self._single:
            twin = self.first
            twin.t = self._predictor.t = self.notes.item(0, LAST)
            twin.cmd = self._cmd

    def _arguments(self, rows: slice, own: bool = False) -> tuple[Any, ...]:
        sim, task = self.episodes.simulation, self.episodes.task
        shared = (*self._shared, self._room)
        return (
            *(
                sim.rows[rows],
                task.points[rows],
                self.episodes.shared,
                self._told,
                self.notes[rows],
            ),
            *(memory[rows] for memory in self.memories),
            *(copy.deepcopy(shared) if own else shared),
        )

    @property
    def rollout_inputs(self) -> RolloutInputs:
        """What the models of all boats are rolled from, for :mod:`twin.agents.mpc`; views."""
        return self._predictor.rollout_inputs(*self.memories)

    @property
    def joint(self) -> JointUKF:
        """What the models have in common: structure, lags, envelope, unit of shaft speed."""
        return self._predictor.ukf

    @staticmethod
    def _call(*arguments: object) -> None:
        _ukf_all(*arguments)


def _compiled(twin: Twin) -> UKFPredictor:
    assert isinstance(twin.predictor, UKFPredictor)
    return twin.predictor


class CompiledPlusTwins(CompiledTwins):
    """The same with refits."""

    @staticmethod
    def _call(*arguments: object) -> None:
        _plus_all(*arguments)


def observer_of(
    episodes: Episodes,
    twin: str | Predictor,
    particulars: Particulars | None,
    band_period: float,
    seed: int,
    parameters: bool = False,
) -> TwinObserver:
    """Return the twins of n boats.

    Parameters
    ----------
    episodes : Episodes
        The boats.
    twin : str or Predictor
        A name in ``twin.PREDICTORS``, or a predictor; many boats get copies of it.
    particulars : Particulars, optional
        What the twins are told of the boats; that of the vessel if left out.
    band_period : float
        The standard deviations ahead are renewed this often, s; 0 for every step.
    seed : int
        For predictors that draw random numbers.
    parameters : bool
        Add the parameters of the identified model.
    """
    if not (math.isfinite(band_period) and band_period >= 0.0):
        raise ValueError(f"band_period = {band_period} must be finite and 0 or more")
    sim, options = episodes.simulation, {}
    if not isinstance(twin, Predictor):
        if len(episodes.seas) > 1 and predictor_class(twin).needs_simulator:
            raise PredictorError(f"{twin} is told of the sea: give one, not {len(episodes.seas)}")
        options = simulator_options(twin, episodes.vessel, episodes.seas[0], sim.dof)
    particulars = particulars or particulars_of(episodes.vessel, sim.suite, sim.dof)
    first = Twin(particulars, twin, seed=seed, **options)
    kind = _COMPILED.get(type(first.predictor), SeparateTwins)
    return kind(episodes, first, band_period, parameters)


_COMPILED: dict[type[Predictor], type[TwinObserver]] = {
    UKFPredictor: CompiledTwins,
    PlusPredictor: CompiledPlusTwins,
}
"""Exactly these classes: a subclass may do anything."""
