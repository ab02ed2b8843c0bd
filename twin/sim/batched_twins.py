"""What twins add to observations: n boats in one compiled call where the predictor has one.

The ``ukf`` and ``dsw-ukf-plus`` keep all that they remember in flat arrays, which stand here row by
row, one for each boat; :attr:`CompiledTwins.boats` gives them by name. Every other predictor is
asked boat by boat.
"""

from __future__ import annotations

import copy
import math
from abc import abstractmethod
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.channels import MEASUREMENTS
from twin.digital_twin import Twin
from twin.filters.navigation_state import NAVIGATION
from twin.identification.joint_ukf import (
    JointUKF,
    filter_config,
    filter_state,
    filter_workspace,
    forecast_buffers,
    forecast_covariance,
    forecast_mean,
    limit_covariances,
)
from twin.model.dynamics import N_ACT
from twin.model.rollout import GRID, HORIZON_ROWS, HORIZONS
from twin.model.structure import N_STATES, ModelTerms
from twin.particulars import Particulars
from twin.predictors.base import Predictor
from twin.predictors.dsw_ukf_plus import PlusPredictor
from twin.predictors.plus_forecast import (
    draws_of,
    mean_forecast_of,
    mean_products,
    plus_draws,
    plus_mean,
)
from twin.predictors.plus_update import PlusMemory, plus_config_of, plus_step, plus_work_of
from twin.predictors.registry import PredictorError, predictor_class
from twin.predictors.ukf import (
    RolloutInputs,
    UKFConfig,
    UKFMemory,
    UKFPredictor,
    UKFWork,
    plain,
    tight_step,
)
from twin.sim.bridge import particulars_of
from twin.sim.oracle import simulator_options
from usv_gym.envs.episodes import BOUND, EPISODES, OBSERVATION, Episodes, Observer
from usv_gym.envs.render import TwinOverlay
from usv_gym.envs.tasks import ERRORS, follow
from usv_gym.physics import frames as fr
from usv_gym.world.channels import CHANNELS
from usv_gym.world.state import BOAT
from usv_kernel.arrays import flat_size
from usv_kernel.jit import inlined, kernel
from usv_kernel.records import as_record
from usv_kernel.scalar import sincos

__all__ = [
    "HORIZONS",
    "TWIN_OBSERVATION",
    "TwinObserver",
    "observer_of",
]

Array = NDArray[np.float64]

_SD = ("sd_forward", "sd_starboard", "sd_heading", "sd_surge", "sd_sway", "sd_yaw_rate")

TWIN_OBSERVATION = (
    *("twin_surge", "twin_sway", "twin_yaw_rate", "twin_cos_heading", "twin_sin_heading"),
    *("twin_cross_track", "twin_to_go", "twin_cos_course_error", "twin_sin_course_error"),
    *("twin_cos_next_turn", "twin_sin_next_turn"),
    *(f"twin_{name}" for name in _SD),
    *(
        f"ahead_{h:g}s_{name}"
        for h in HORIZONS.tolist()
        for name in (
            *("forward", "starboard", "cos_turn", "sin_turn", "surge", "sway", "yaw_rate"),
            *_SD,
        )
    ),
)
"""Names of the entries that the twin adds; scales in :class:`twin.sim.wrapper.TwinObservation`."""

ROWS = int(HORIZON_ROWS[-1]) + 1
"""Rows of the plan of a forecast."""

NOTE = np.dtype(
    [
        ("last", "f8"),  # time of the last row, s; NaN before the first
        ("shown", "f8"),  # time of the last row that was written to the observation, s
        ("covs_due", "f8"),  # time of the next covariances ahead, s
        ("leg", "f8"),  # leg of the path, by the twin's state
        ("path_errors", "f8", len(ERRORS)),  # see usv_gym.envs.tasks.ERRORS
        ("position_error", "f8"),  # distance of the twin's position from the true one, m
        ("z", "f8", len(MEASUREMENTS)),  # measurement row
        ("now", "f8", (N_STATES, N_STATES)),  # variances of the state, on the diagonal
        ("ahead", "f8", (len(HORIZONS), N_STATES)),  # states at HORIZONS
        ("covs", "f8", (len(HORIZONS), N_STATES, N_STATES)),  # their covariances
    ]
)
"""What is noted of each boat between observations."""

SETTINGS = np.dtype(
    [
        ("period", "f8"),  # the covariances ahead are updated this often, s
        ("gps_var", "f8"),  # variance of the drifting part of a fix, m2
        ("look", "f8"),  # 1 where observations are to be written
    ]
)
"""What all boats of a batch have in common."""


class Boats(NamedTuple):
    """The simulated boats, row by row, and what is noted of each."""

    rows: Any  # see usv_gym.world.state.BOAT
    points: Any  # (n, P, 2) way points, m
    notes: Any  # see NOTE
    shared: Any  # see usv_gym.envs.episodes.EPISODES
    settings: Any  # see SETTINGS


class UKFForecast(NamedTuple):
    """Buffers of a forecast of the plain filter."""

    plan: Any  # (40, 4) the command, held
    buffers: Any  # see Forecast


class PlusForecast(NamedTuple):
    """Buffers of a forecast of DSW-UKF+."""

    plan: Any  # (40, 4) the command, held
    mean: Any  # see MeanForecast
    draws: Any  # see Draws
    normal: Any  # standard normal numbers of the draws


_ALL = slice(None)


@inlined
def _spread(cov, heading, length, speed, out, at):
    """Write the six standard deviations of a state, position turned into the body frame."""
    c, s = heading
    a, b, d = cov[0, 0], cov[0, 1], cov[1, 1]
    out[at] = math.sqrt(max(c * c * a + 2.0 * c * s * b + s * s * d, 0.0)) / length
    out[at + 1] = math.sqrt(max(s * s * a - 2.0 * c * s * b + c * c * d, 0.0)) / length
    out[at + 2] = math.sqrt(max(cov[2, 2], 0.0))
    out[at + 3] = math.sqrt(max(cov[3, 3], 0.0)) / speed
    out[at + 4] = math.sqrt(max(cov[4, 4], 0.0)) / speed
    out[at + 5] = math.sqrt(max(cov[5, 5], 0.0))


@inlined
def _next_row(boat, note):
    """Write a boat's measurements to its note; return the time since the row before, or -1.

    -1 stands for no new row: the boat is idle.
    """
    t, last = boat.t, note.last
    if t == last:
        return -1.0
    note.last = t
    for k in range(len(CHANNELS)):
        note.z[k] = boat.measurement[k]
    for k in range(len(CHANNELS), len(MEASUREMENTS)):
        note.z[k] = math.nan
    return t - last if math.isfinite(last) else 0.0


@kernel
def _next_row_of(boat, note):
    """Do :func:`_next_row` on flat memory."""
    return _next_row(boat, as_record(note, NOTE))


@inlined
def _is_due(note, look):
    """Return whether a boat's part of the observation is to be written, and is not yet."""
    if look == 0.0 or note.shown == note.last:
        return False
    note.shown = note.last
    return True


@inlined
def _hold(command, plan):
    """Write a plan that holds a command."""
    for row in range(plan.shape[0]):
        for k in range(N_ACT):
            plan[row, k] = command[k]


@inlined
def describe(s, boat, note, points, rules, obs):
    """Write the twin's part of one boat's observation, from state ``s`` and what is noted."""
    errors, ahead, speed, psi = note.path_errors[:], note.ahead, rules.speed, s[2]
    d, c = sincos(psi)
    note.leg = follow(s[0], s[1], psi, points, int(note.leg), rules.reach, errors)
    o = obs[len(OBSERVATION) : len(OBSERVATION) + len(TWIN_OBSERVATION)]
    o[0], o[1], o[2], o[3], o[4] = s[3] / speed, s[4] / speed, s[5], c, d
    o[5], o[6] = errors[0] / rules.unit, 0.1 * errors[1] / rules.unit
    o[8], o[7] = sincos(errors[2])
    o[10], o[9] = sincos(errors[3])
    _spread(note.now, (c, d), rules.unit, speed, o, 11)
    at = 17
    for j in range(ahead.shape[0]):
        m = ahead[j]
        length = speed * HORIZONS[j]
        dx, dy, turn = m[0] - s[0], m[1] - s[1], m[2] - psi
        o[at] = (dx * c + dy * d) / length
        o[at + 1] = (dy * c - dx * d) / length
        o[at + 3], o[at + 2] = sincos(turn)
        o[at + 4], o[at + 5], o[at + 6] = m[3] / speed, m[4] / speed, m[5]
        _spread(note.covs[j], (c, d), length, speed, o, at + 7)
        at += 13
    for j in range(o.shape[0]):
        o[j] = min(max(o[j], -BOUND), BOUND)
    note.position_error = math.hypot(s[0] - boat.state[fr.X], s[1] - boat.state[fr.Y])


@kernel
def _describe(s, boat, note, points, rules, obs):
    """Do :func:`describe` on flat memory."""
    describe(s, boat, as_record(note, NOTE), points, rules, obs)


@inlined
def _row_of(memory, i):
    """Return what boat i remembers."""
    return UKFMemory(memory.nav[i], memory.filter[i])


@inlined
def _plus_row_of(memory, i):
    """Return what boat i remembers."""
    return PlusMemory(
        memory.nav[i],
        memory.filter[i],
        memory.rows[i],
        memory.window[i],
        memory.selector[i],
        memory.segments[i],
    )


@inlined
def _write_variances(P, P_nav, gps_var, now):
    """Write how uncertain the state is now."""
    for i in range(N_STATES):
        now[i, i] = P[i, i] + P_nav[i, i] + (gps_var if i < 2 else 0.0)


@kernel
def _ukf_all(boats, memories, config, work, forecast, obs):
    """Let the twins of boats with a new row take it, and write their parts of the observations.

    The arguments are plain tuples, which numba takes from Python much faster than named ones.
    """
    boats = Boats(boats[0], boats[1], boats[2], boats[3], boats[4])
    memories, work = UKFMemory(memories[0], memories[1]), UKFWork(work[0], work[1])
    which, limits, hull = config[2]
    config = UKFConfig(config[0], config[1], ModelTerms(which, limits, hull))
    forecast = UKFForecast(forecast[0], forecast[1])
    settings, model = as_record(boats.settings, SETTINGS), config.model
    rules = as_record(boats.shared, EPISODES).rules
    given = filter_config(config.filter, model)
    scratch = filter_workspace(work.filter, model.which.shape[1])
    out = forecast_buffers(forecast.buffers, ROWS)
    for i in range(boats.rows.shape[0]):
        boat = as_record(boats.rows[i], BOAT)
        note = as_record(boats.notes[i], NOTE)
        memory = _row_of(memories, i)
        dt, cmd = _next_row(boat, note), boat.command
        if dt >= 0.0:
            tight_step(dt, note.z[:], cmd, memory, config, work)
        if not _is_due(note, settings.look):
            continue
        nav, state = as_record(memory.nav, NAVIGATION), filter_state(memory.filter, model)
        _hold(cmd, forecast.plan)
        forecast_mean(forecast.plan, GRID, state, given, out, scratch.rollout)
        _write_variances(state.P, nav.P, settings.gps_var, note.now)
        renew = note.last >= note.covs_due
        if renew:
            note.covs_due = note.last + settings.period - 1e-9
            forecast_covariance(out.plan, GRID, state, given, out.covs, scratch)
            for row in range(ROWS):
                for j in range(N_STATES):
                    for k in range(N_STATES):
                        out.covs[row, j, k] += nav.P[j, k]
                for j in range(2):
                    out.covs[row, j, j] += settings.gps_var
            limit_covariances(out.covs, note.now[:], GRID, given.envelope)
        for h in range(HORIZON_ROWS.shape[0]):
            row = HORIZON_ROWS[h]
            for j in range(N_STATES):
                note.ahead[h, j] = out.states[0, row, j]
                if renew:
                    for k in range(N_STATES):
                        note.covs[h, j, k] = out.covs[row, j, k]
        describe(state.x, boat, note, boats.points[i], rules, obs[i])


_DRAWN_ROWS = HORIZON_ROWS + 1


@kernel
def _plus_all(boats, memories, config, work, forecast, obs):
    """Do for ``dsw-ukf-plus`` what :func:`_ukf_all` does for ``ukf``."""
    boats = Boats(boats[0], boats[1], boats[2], boats[3], boats[4])
    nav, joint, rows, window, selector, segments = memories
    memories = PlusMemory(nav, joint, rows, window, selector, segments)
    config, work = plus_config_of(config), plus_work_of(work)
    forecast = PlusForecast(forecast[0], forecast[1], forecast[2], forecast[3])
    settings, model = as_record(boats.settings, SETTINGS), config.model
    rules = as_record(boats.shared, EPISODES).rules
    p, D = model.which.shape[1], forecast.normal[0].shape[0]
    mean = mean_forecast_of(forecast.mean, p, ROWS, ROWS)
    draws = draws_of(forecast.draws, p, ROWS, ROWS, D)
    for i in range(boats.rows.shape[0]):
        boat = as_record(boats.rows[i], BOAT)
        note = as_record(boats.notes[i], NOTE)
        memory = _plus_row_of(memories, i)
        dt, cmd = _next_row(boat, note), boat.command
        if dt >= 0.0:
            plus_step(note.last, dt, note.z[:], cmd, memory, config, work)
        if not _is_due(note, settings.look):
            continue
        nav, state = as_record(memory.nav, NAVIGATION), filter_state(memory.filter, model)
        _hold(cmd, forecast.plan)
        plus_mean(forecast.plan, GRID, memory, config, mean)
        _write_variances(state.P, nav.P, settings.gps_var, note.now)
        for h in range(HORIZON_ROWS.shape[0]):
            for j in range(N_STATES):
                note.ahead[h, j] = mean.states[0, HORIZON_ROWS[h], j]
        if note.last >= note.covs_due:
            note.covs_due = note.last + settings.period - 1e-9
            plus_draws((mean, mean), GRID, memory, config, forecast.normal, draws)
            covs = note.covs[:]
            mean_products(draws.deviations, _DRAWN_ROWS, covs)
            for h in range(HORIZON_ROWS.shape[0]):
                for j in range(2):
                    for k in range(2):
                        covs[h, j, k] += nav.P[j, k]
                    covs[h, j, j] += settings.gps_var
        describe(state.x, boat, note, boats.points[i], rules, obs[i])


class TwinObserver(Observer):
    """Twins of n boats, and their parts of the observations.

    Parameters
    ----------
    episodes : Episodes
        The boats; only their measurements, commands and paths are used.
    twin : Twin
        That of the first boat, as new.
    band_period : float
        The standard deviations ahead are updated this often, s; 0 for every step.
    parameters : bool
        Add the parameters of the identified model and their standard deviations, both in units
        of the standard deviations that they had at the start.
    """

    def __init__(
        self, episodes: Episodes, twin: Twin, band_period: float, parameters: bool = False
    ) -> None:
        self.episodes, self.first, self.band_period = episodes, twin, band_period
        self._notes = np.zeros((episodes.n, NOTE.itemsize // 8))
        self.notes = self._notes.view(NOTE)[:, 0]
        self.notes["last"] = self.notes["shown"] = math.nan
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
    def position_error(self) -> Array:
        """Distance (n,) of the twins' positions from the true ones, m; a view."""
        error: Array = self.notes["position_error"]
        return error

    def infos(self) -> dict[str, np.ndarray]:
        """See :class:`Observer`."""
        return {"twin_position_error_m": self.position_error}

    def reset(self, i: int) -> None:
        """Let boat i begin an episode with a twin that has seen nothing yet."""
        self._notes[i] = 0.0
        self.notes["last"][i] = self.notes["shown"][i] = math.nan
        self._forget(i)

    def overlay(self, i: int) -> TwinOverlay | None:
        """Return the twin of boat i for pictures; None before its first row."""
        note = self.notes[i]
        if not math.isfinite(note["last"]):
            return None
        return TwinOverlay(
            state=self._state(i),
            cov=note["now"][:2, :2].copy(),
            horizons=HORIZONS.copy(),
            ahead=note["ahead"].copy(),
            covs=note["covs"][:, :2, :2].copy(),
        )

    @abstractmethod
    def _state(self, i: int) -> Array:
        """Return a copy of the state (6,) of the twin of boat i."""

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
        """Return a copy of the twin of boat i as it is now."""


class SeparateTwins(TwinObserver):
    """A predictor for each boat, asked one after the other; for any predictor."""

    def __init__(
        self, episodes: Episodes, twin: Twin, band_period: float, parameters: bool = False
    ) -> None:
        super().__init__(episodes, twin, band_period, parameters)
        self.twins = [twin, *(copy.deepcopy(twin) for _ in range(episodes.n - 1))]
        self._plan = np.zeros((ROWS, N_ACT))

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
            note, boat = self.notes[i], sim.boats[i]
            dt, twin = _next_row_of(boat, self._notes[i]), self.twins[i]
            t = note["last"].item()
            if dt >= 0.0:
                # what a twin keeps must not change with the next row
                twin.feed(t, note["z"].copy(), sim.cmd[i].copy())
            if not look or note["shown"] == note["last"]:
                continue
            note["shown"] = note["last"]
            self._plan[:] = sim.cmd[i]
            if t >= note["covs_due"]:
                note["covs_due"] = t + self.band_period - 1e-9
                prediction = twin.predictor.predict(self._plan, GRID)
                note["ahead"][:] = prediction.mean[HORIZON_ROWS]
                note["covs"][:] = prediction.cov[HORIZON_ROWS]
            else:
                note["ahead"][:] = twin.predictor.mean(self._plan, GRID)[HORIZON_ROWS]
            np.fill_diagonal(note["now"], twin.predictor.estimate().sd ** 2)
            s = np.ascontiguousarray(twin.predictor.state, dtype=np.float64)
            _describe(s, boat, self._notes[i], task.points[i], task.rules, obs[i])


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
        own, many = predictor.memory, episodes.n
        self._blank = [array.copy() for array in own]
        self.memory = type(own)(
            *(array[None] if many == 1 else np.repeat(array[None], many, axis=0) for array in own)
        )
        gps_var = predictor.particulars.instruments.gps_bias_sd**2
        self._settings = np.array([band_period, gps_var, 1.0])
        self._forecast = self._buffers()
        # a thread needs scratch of its own
        self._all = [self._arguments(rows, own=True) for rows in episodes.blocks]

    @property
    def boats(self) -> dict[str, Any]:
        """What the twins remember, by name: ``boats["filter"]["P"]`` is (n, 6 + p, 6 + p)."""
        parts = self.memory._asdict()
        return {
            name: parts[name].view(dtype)[:, 0] for name, dtype in self._predictor.dtypes.items()
        }

    def _buffers(self) -> Any:
        """Return buffers of a forecast."""
        return UKFForecast(np.zeros((ROWS, N_ACT)), np.zeros(flat_size(forecast_buffers, ROWS)))

    def _state(self, i: int) -> Array:
        return self.memory.filter[i, :N_STATES].copy()

    def _forget(self, i: int) -> None:
        if self._single:
            self.first.reset()
            return
        for memory, blank in zip(self.memory, self._blank, strict=True):
            memory[i] = blank

    def twin(self, i: int) -> Twin:
        """See :meth:`TwinObserver.twin`."""
        twin = copy.deepcopy(self.first)
        predictor = _compiled(twin)
        for array, memory in zip(predictor.memory, self.memory, strict=True):
            array[:] = memory[i]
        twin.t = predictor.t = self.notes["last"].item(i)
        twin.cmd = self.episodes.simulation.cmd[i].copy()
        return twin

    def _identified(self, rows: slice) -> tuple[Array, Array]:
        """See :class:`TwinObserver`."""
        state = self.boats["filter"][rows]
        variances = np.diagonal(state["P"], axis1=1, axis2=2)
        return state["x"][:, N_STATES:], np.sqrt(variances[:, N_STATES:])

    def _observe(self, obs: NDArray[np.float32], look: bool, rows: slice) -> None:
        self._settings[2] = look
        if rows != _ALL:
            self._call(*self._arguments(rows), obs[rows])
        elif len(self._all) == 1:
            self._call(*self._all[0], obs)
        else:
            self.episodes.each(lambda j: self._call(*self._all[j], obs[self.episodes.blocks[j]]))
        if self._single:
            twin = self.first
            twin.t = self._predictor.t = self._notes.item(0)
            twin.cmd = self._cmd

    def _arguments(self, rows: slice, own: bool = False) -> tuple[Any, ...]:
        sim, task, predictor = self.episodes.simulation, self.episodes.task, self._predictor
        boats = Boats(
            sim.rows[rows],
            task.points[rows],
            self._notes[rows],
            self.episodes.shared,
            self._settings,
        )
        memory = type(self.memory)(*(array[rows] for array in self.memory))
        scratch = predictor.work, self._forecast
        return (
            plain(boats),
            plain(memory),
            plain(predictor.config),
            *plain(copy.deepcopy(scratch) if own else scratch),
        )

    @property
    def rollout_inputs(self) -> RolloutInputs:
        """What the models of all boats are rolled from, for :mod:`twin.agents.mpc`; views."""
        return self._predictor.rollout_inputs(self.memory)

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

    def _buffers(self) -> Any:
        """Return buffers of a forecast."""
        predictor = self._predictor
        assert isinstance(predictor, PlusPredictor)
        normal = predictor.normal
        D, p = normal[0].shape
        return PlusForecast(
            np.zeros((ROWS, N_ACT)),
            np.zeros(flat_size(mean_forecast_of, p, ROWS, ROWS)),
            np.zeros(flat_size(draws_of, p, ROWS, ROWS, D)),
            normal,
        )

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
        What the twins are given of the boats; that of the vessel if left out.
    band_period : float
        The standard deviations ahead are updated this often, s; 0 for every step.
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
            raise PredictorError(f"{twin} is given the sea: name one, not {len(episodes.seas)}")
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
