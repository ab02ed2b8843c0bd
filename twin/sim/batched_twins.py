"""What twins add to observations: n boats in one compiled call where the predictor has one.

The ``ukf`` and ``dsw-ukf-plus`` keep all that they remember in flat arrays. They stand here row by
row, one for each boat; :attr:`CompiledTwins.boats` gives them by name. Every other predictor is
asked boat by boat.
"""

from __future__ import annotations

import copy
import dataclasses
import math
from abc import abstractmethod
from collections import deque
from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from twin.digital_twin import Twin
from twin.identification.joint_ukf import JointUKF
from twin.integrity.state import INTEGRITY, SENSORS, integrity_settings
from twin.model.dynamics import N_ACT
from twin.model.rollout import HORIZON_ROWS, HORIZONS, LONG_STEP
from twin.model.structure import N_STATES
from twin.motion.deck_motion import initial_motion
from twin.motion.forecast_state import QUIET_SPANS
from twin.particulars import Particulars
from twin.predictors.base import Forecaster, Predictor
from twin.predictors.dsw_ukf_plus import PlusPredictor
from twin.predictors.forecast import draws_of, forecast_of
from twin.predictors.registry import DEFAULT, PredictorError, predictor_class
from twin.predictors.ukf import (
    RolloutInputs,
    UKFPredictor,
    plain,
)
from twin.sim.bridge import particulars_of, with_deck_point
from twin.sim.forecast_scores import (
    FORECAST_EVERY_S,
    GRADED_AT,
    LONGEST_STEP,
    NO_SCORES,
    SUMS_AT,
    ForecastScores,
    follow_forecasts,
    grade_known,
    grades_size,
    is_due,
    next_plan,
)
from twin.sim.oracle import simulator_options
from twin.sim.twin_observation import (
    ATTITUDE_OBSERVATION,
    GRADES_AT,
    HEALTH_OBSERVATION,
    NOTE,
    ROWS,
    SETTINGS,
    TRUST,
    TWIN_OBSERVATION,
    WAVE_STEPS,
    Boats,
    describe_flat,
    describe_motion_flat,
    keep_forecast_flat,
    note_attitude_flat,
    observe_plus,
    observe_ukf,
    take_row,
)
from usv_gym.envs.episodes import BOUND, Episodes, Observer
from usv_gym.envs.scene import TwinOverlay
from usv_kernel.arrays import flat_size
from usv_kernel.errors import UsvTwinError
from usv_kernel.records import field_at, record_size, structured

__all__ = [
    "HORIZONS",
    "TWIN_OBSERVATION",
    "TWIN_SETS",
    "TwinObserver",
    "TwinOptions",
    "twins_of",
]

Array = NDArray[np.float64]

_ALL = slice(None)

TWIN_SETS = ("twin", "twin_params", "twin_health", "twin_attitude")
"""Names of the observation sets with a twin."""

_HEALTH = slice(field_at(NOTE, "health"), field_at(NOTE, "health") + record_size(INTEGRITY))
_ALL_STATUSES = _HEALTH.start + field_at(INTEGRITY, "statuses")
_LOOK = field_at(SETTINGS, "look")
_FORECASTING = field_at(SETTINGS, "forecasting")


PRIORS = ("boat", "class", "fleet")
"""What a twin knows of its boat before any data, at most: what earlier runs of the boat taught (the
prior of the particulars), its class, or boats of its kind. What is not there leaves the next."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class TwinOptions:
    """Options of the twins of an environment, see :class:`twin.sim.wrapper.TwinObservation`."""

    twin: str | Predictor = DEFAULT  # a name, or a predictor, of which many boats get copies
    particulars: Particulars | None = None  # those of the vessel if left out
    twin_prior: str = "boat"  # one of PRIORS
    band_period: float = 5.0  # the standard deviations ahead are updated this often, s
    twin_seed: int = 0
    observation: str = "twin"  # one of TWIN_SETS
    forecast_scores: bool = True  # grade the forecasts

    def __post_init__(self) -> None:
        if self.observation not in TWIN_SETS:
            raise UsvTwinError(f"observation = {self.observation!r}; known: {', '.join(TWIN_SETS)}")
        if self.twin_prior not in PRIORS:
            raise UsvTwinError(f"twin_prior = {self.twin_prior!r}; known: {', '.join(PRIORS)}")
        if not (math.isfinite(self.band_period) and self.band_period >= 0.0):
            raise PredictorError(f"band_period = {self.band_period} must be finite and 0 or more")


class TwinObserver(Observer):
    """Twins of n boats, and their parts of the observations.

    Of the episodes only measurements, commands and paths are used, and the truth to grade.
    ``twin`` is that of the first boat, as new. The observation ``"twin_params"`` adds the
    parameters of the identified model and their standard deviations, both in units of the standard
    deviations that they had at the start; ``"twin_health"`` adds how far each sensor is trusted,
    and ``"twin_attitude"`` roll, pitch and heave, with six degrees of freedom. ``kind`` is the
    place of their vessel among the kinds of the episodes.
    """

    def __init__(self, episodes: Episodes, twin: Twin, options: TwinOptions, kind: int = 0) -> None:
        self.episodes, self.first, self.band_period = episodes, twin, options.band_period
        self.kind, self._forecasting, observation = kind, True, options.observation
        # longer rows than those of the plans would be no test of them
        self._grading = options.forecast_scores and episodes.simulation.dt <= LONGEST_STEP
        more = grades_size(*self._model_size(twin)) if self._grading else 0
        self._notes = np.zeros((episodes.n, record_size(NOTE) + more))
        self.notes, self._fresh = structured(self._notes, NOTE), np.zeros_like(self._notes[:1])
        fresh = structured(self._fresh, NOTE)
        for name in ("last", "begun", "shown"):
            fresh[name] = math.nan
        fresh["health"] = twin.monitor.record
        if self._grading:
            self._fresh[0, GRADES_AT] = FORECAST_EVERY_S  # the first field: when the first is kept
        self._notes[:] = self._fresh
        status = self.notes["health"]["sensors"]["status"]
        self._infos = {"twin_position_error_m": self.position_error}
        self._infos |= {f"twin_health_{name}": status[:, k] for k, name in enumerate(SENSORS)}
        self.scores = np.empty(episodes.n, dtype=object)
        """Scores (n,) of the forecasts of each boat's episode, see :class:`ForecastScores`."""
        self.scores.fill(NO_SCORES)
        if options.forecast_scores:
            self._infos["twin_forecast"] = self.scores
        self._first_infos: dict[str, Any] = {}
        self._first_statuses = math.nan
        graded = self._notes[:, GRADES_AT + GRADED_AT] if self._grading else np.zeros(1)
        # of one boat a number, which is quicker to compare
        self._count: Callable[[], Any] = graded.item if episodes.n == 1 else graded.tolist
        self._graded: Any = self._count()
        self._sums = slice(GRADES_AT + SUMS_AT.start, GRADES_AT + SUMS_AT.stop)
        self.names: tuple[str, ...] = TWIN_OBSERVATION
        self._observation = observation
        self.motions = np.zeros((episodes.n, 0))
        """What is remembered of roll, pitch and heave of each boat; nothing with dof=3."""
        if episodes.simulation.dof == 6:
            self._blank_motion = initial_motion()
            self.motions = np.tile(self._blank_motion, (episodes.n, 1))
            roll = self.notes["roll"]
            own = ("twin_roll_rad", "twin_pitch_rad", "roll_rad", "pitch_rad")
            self._infos |= {name: roll[:, k] for k, name in enumerate(own)}
        if observation == "twin_attitude":
            if episodes.simulation.dof != 6:
                raise UsvTwinError(
                    "observation = 'twin_attitude': a boat with dof=3 does not roll; use dof=6"
                )
            self.names += ATTITUDE_OBSERVATION
            quiet = self.notes["quiet"]
            self._infos |= {
                f"twin_quiet_{span:g}s": quiet[:, k] for k, span in enumerate(QUIET_SPANS)
            }
            self._infos["twin_hs_m"] = self.notes["hs"]
        self._moving = [
            (name, values.item)
            for name, values in self._infos.items()
            if not name.startswith("twin_health_")
        ]
        """Infos that change in every step, and what reads them."""
        if observation == "twin_health":
            self.names += HEALTH_OBSERVATION
        elif observation == "twin_params":
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
        return self._infos

    def first_infos(self) -> dict[str, Any]:
        """See :class:`Observer`; statuses are read when one has changed."""
        statuses = self._notes.item(_ALL_STATUSES)
        if statuses != self._first_statuses:
            self._first_statuses = statuses
            self._first_infos = super().first_infos()
        found = self._first_infos.copy()
        for name, item in self._moving:
            found[name] = item(0)
        return found

    def reset(self, i: int) -> None:
        """Let boat i begin an episode with a twin that has seen nothing yet."""
        self._notes[i] = self._fresh[0]
        self.scores[i] = NO_SCORES
        if self.motions.shape[1]:
            self.motions[i] = self._blank_motion
        self._forget(i)

    def leave_out_forecasts(self) -> None:
        """Make no forecasts from now on: nobody sees, grades or draws them."""
        self._forecasting = False

    def leave(self, i: int) -> None:
        """Let boat i begin an episode as a boat of another kind: its rows are not taken."""
        self._notes[i, :1] = self.notes["shown"][i] = math.inf

    def overlay(self, i: int) -> TwinOverlay | None:
        """Return the twin of boat i for pictures; None before its first row or forecast."""
        note = self.notes[i]
        if not math.isfinite(note["last"]) or not self._forecasting:
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
        """Let the twins of boats with a new row take it, and write their parts of ``obs`` (n, D).

        Without ``look``, the row is taken in and no more. ``rows`` are the boats to look at.
        """
        self._observe(obs, look, rows)
        if look:
            self.finish(obs, rows)

    def finish(self, obs: NDArray[np.float32], rows: slice = _ALL) -> None:
        """See :class:`Observer`."""
        if self._count() != self._graded:
            self._take_scores()
        if self._observation not in ("twin_health", "twin_params"):
            return
        at = len(self.episodes.observation) + len(TWIN_OBSERVATION)
        if self._observation == "twin_health":
            status = self.notes["health"]["sensors"]["status"][rows]
            obs[rows, at:] = TRUST[status.astype(np.intp)]
        else:
            xi, sd = self._identified(rows)
            half = at + xi.shape[1]
            obs[rows, at:half] = ((xi - self._prior) / self._prior_sd).clip(-BOUND, BOUND)
            obs[rows, half:] = (sd / self._prior_sd).clip(-BOUND, BOUND)

    def _take_scores(self) -> None:
        """Hand out the scores of boats with newly graded forecasts."""
        before, now = self._graded, self._count()
        self._graded = now
        for i, pair in enumerate(
            [(before, now)] if len(self.scores) == 1 else zip(before, now, strict=True)
        ):
            if pair[0] != pair[1]:
                sums = self._notes[i, self._sums].copy()
                self.scores[i] = ForecastScores(sums.reshape(NO_SCORES.sums.shape))

    def _model_size(self, twin: Twin) -> tuple[int, int]:
        """Return parameters of a model that is kept with each forecast, and rows of its waves."""
        return 0, 0

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

    def __init__(self, episodes: Episodes, twin: Twin, options: TwinOptions, kind: int = 0) -> None:
        super().__init__(episodes, twin, options, kind)
        self._waiting: list[deque[Forecaster]] = [deque() for _ in range(episodes.n)]
        self.twins = [twin, *(copy.deepcopy(twin) for _ in range(episodes.n - 1))]
        for note, one in zip(self._notes, self.twins, strict=True):
            one.monitor.remember(note[_HEALTH])
        for motion, one in zip(self.motions, self.twins, strict=True):
            if motion.size:
                one.motion.remember(motion)
        self._plan = np.zeros((ROWS, N_ACT))

    def _state(self, i: int) -> Array:
        return np.array(self.twins[i].predictor.state, dtype=np.float64)

    def _forget(self, i: int) -> None:
        self.twins[i].reset()
        self._waiting[i].clear()

    def _grade(self, i: int, dt: float) -> None:
        """Take a row of boat i, and grade the forecasts whose time has come."""
        note = self._notes[i]
        more = follow_forecasts(dt, self.episodes.simulation.boats[i], note, GRADES_AT, 0, 0)
        while more:
            next_plan(note, GRADES_AT, self._plan)
            known = self._waiting[i].popleft()(self._plan, LONG_STEP)
            more = grade_known(np.ascontiguousarray(known, dtype=np.float64), note, GRADES_AT)

    def _keep(self, i: int) -> None:
        """Keep the forecast of this moment of boat i, if it is time."""
        sim, twin, note = self.episodes.simulation, self.twins[i], self._notes[i]
        if not (is_due(sim.boats[i], note, GRADES_AT) and twin.predictor.ready):
            return
        doubted = twin.monitor.commands_doubted
        start = twin.predictor.predict(self._plan[:1], LONG_STEP).start.astype(np.float64)
        keep_forecast_flat(
            sim.rows[i], self.episodes.shared[self.kind], note, start, doubted, self.band_period
        )
        self._waiting[i].append(twin.predictor.forecaster(doubted))

    def _note_forecast(self, i: int, t: float) -> None:
        """Note what the twin of boat i forecasts at time t."""
        note, twin = self.notes[i], self.twins[i]
        self._plan[:] = self.episodes.simulation.reported[i]
        if t >= note["covs_due"]:
            note["covs_due"] = t + self.band_period - 1e-9
            prediction = twin.predictor.predict(self._plan, LONG_STEP)
            note["ahead"][:] = prediction.mean[HORIZON_ROWS]
            note["covs"][:] = prediction.cov[HORIZON_ROWS]
            spread = prediction.cov[HORIZON_ROWS] - prediction.start_cov
            note["spread"][:] = spread[:, [0, 0, 1], [0, 1, 1]]
        else:
            note["ahead"][:] = twin.predictor.mean(self._plan, LONG_STEP)[HORIZON_ROWS]

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
            dt, twin = take_row(boat, self._notes[i]), self.twins[i]
            t = note["last"].item()
            if dt >= 0.0:
                # arrays that a twin keeps must not change with the next row
                twin.feed(t, note["z"].copy(), sim.reported[i].copy())
                if twin.motion.active:
                    note_attitude_flat(boat, self._notes[i], twin.motion.memory)
                if self._grading:
                    self._grade(i, dt)
            if not look or note["shown"] == note["last"]:
                continue
            note["shown"] = note["last"]
            if self._forecasting:
                self._note_forecast(i, t)
            np.fill_diagonal(note["now"], twin.predictor.estimate().sd ** 2)
            s = np.ascontiguousarray(twin.predictor.state, dtype=np.float64)
            own = obs[i, len(self.episodes.observation) :]
            describe_flat(s, boat, self._notes[i], task.points[i], task.rules, own)
            if self._grading:
                self._keep(i)
            if self._observation == "twin_attitude":
                motion, own = twin.motion, own[len(TWIN_OBSERVATION) :]
                describe_motion_flat(
                    s, self._notes[i], motion.memory, motion.settings, motion.scratch, own
                )


class CompiledTwins(TwinObserver):
    """All twins in one call; what each remembers is a row of a few arrays.

    Of one boat the arrays are the predictor's own.
    """

    def __init__(self, episodes: Episodes, twin: Twin, options: TwinOptions, kind: int = 0) -> None:
        super().__init__(episodes, twin, options, kind)
        predictor = self._predictor = _compiled(twin)
        self._single, self._cmd = episodes.n == 1, episodes.simulation.reported[0]
        if self._single:
            twin.monitor.remember(self._notes[0, _HEALTH])
            if self.motions.shape[1]:
                twin.motion.remember(self.motions[0])
        own, many = predictor.memory, episodes.n
        self._blank = [array.copy() for array in own]
        self.memory = type(own)(
            *(array[None] if many == 1 else np.repeat(array[None], many, axis=0) for array in own)
        )
        gps_var = predictor.particulars.instruments.gps_bias_sd**2
        shown = float(options.observation == "twin_attitude")
        given = options.band_period, gps_var, 1.0, shown, float(self._grading), 1.0
        self._settings = np.concatenate([given, integrity_settings(twin.particulars)])
        self._given, self._scratch = self._config(), plain((self._work(), self._buffers()))
        self._motion_work = twin.motion.scratch if self.motions.shape[1] > 0 else np.zeros(0)
        # threads need their own
        self._all = [self._arguments(rows, own=True) for rows in episodes.blocks]
        self._looks = [self._settings, *(each[0][4] for each in self._all)]
        self._look: bool | None = None
        """Whether the kernels write observations; None where that may differ between them."""
        self.by_block = not self._single

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Become a copy; a copied predictor has laid out its memory anew."""
        vars(self).update(state)
        if self._single:
            own = self._predictor.memory
            self.memory = type(own)(*(array[None] for array in own))
            self._all = [(each[0], tuple(self.memory), *each[2:]) for each in self._all]

    @property
    def boats(self) -> dict[str, Any]:
        """What the twins remember, by name: ``boats["filter"]["P"]`` is (n, 6 + p, 6 + p)."""
        parts = self.memory._asdict()
        return {
            name: parts[name].view(dtype)[:, 0] for name, dtype in self._predictor.dtypes.items()
        }

    def _model_size(self, twin: Twin) -> tuple[int, int]:
        return len(_compiled(twin).ukf.xi), 0

    def _config(self) -> Any:
        """Return what the kernels are given of the predictor."""
        nav, given, model = self._predictor.config
        return np.concatenate([nav, given]), *plain(model)

    def _work(self) -> Any:
        """Return the scratch of the predictor."""
        return np.concatenate(self._predictor.work)

    def _buffers(self) -> Any:
        """Return buffers of a forecast."""
        return np.zeros(flat_size(forecast_of, len(self._predictor.ukf.xi), ROWS, 0))

    def _state(self, i: int) -> Array:
        return self.memory.filter[i, :N_STATES].copy()

    def _forget(self, i: int) -> None:
        if self._single:
            self.first.reset()
            return
        for memory, blank in zip(self.memory, self._blank, strict=True):
            memory[i] = blank

    def leave_out_forecasts(self) -> None:
        """See :meth:`TwinObserver.leave_out_forecasts`."""
        super().leave_out_forecasts()
        for settings in self._looks:
            settings[_FORECASTING] = 0.0

    def twin(self, i: int) -> Twin:
        """See :meth:`TwinObserver.twin`."""
        twin = copy.deepcopy(self.first)
        predictor = _compiled(twin)
        for array, memory in zip(predictor.memory, self.memory, strict=True):
            array[:] = memory[i]
        twin.monitor.memory[:] = self._notes[i, _HEALTH]
        if self.motions.shape[1]:
            twin.motion.memory[:] = self.motions[i]
        twin.t = predictor.t = self.notes["last"].item(i)
        twin.begun = self.notes["begun"].item(i)
        twin.cmd = self.episodes.simulation.reported[i].copy()
        return twin

    def _identified(self, rows: slice) -> tuple[Array, Array]:
        """See :class:`TwinObserver`."""
        state = self.boats["filter"][rows]
        variances = np.diagonal(state["P"], axis1=1, axis2=2)
        return state["x"][:, N_STATES:], np.sqrt(variances[:, N_STATES:])

    def _observe(self, obs: NDArray[np.float32], look: bool, rows: slice) -> None:
        if look is not self._look:
            self._look = look
            for settings in self._looks:
                settings[_LOOK] = look
        if self._single:
            self._observe_rows(*self._all[0], obs)
            twin = self.first
            # the first fields of a note: time of the last row, and of the first
            twin.t = self._predictor.t = self._notes.item(0)
            twin.begun = self._notes.item(1)
            twin.cmd = self._cmd
            twin.note_health()
        elif rows != _ALL:
            self._observe_rows(*self._arguments(rows), obs[rows])
        elif len(self._all) == 1:
            self._observe_rows(*self._all[0], obs)
        else:
            blocks = self.episodes.blocks
            self.episodes.each(lambda j: self._observe_rows(*self._all[j], obs[blocks[j]]))

    def observe_block(self, j: int, obs: NDArray[np.float32], look: bool) -> None:
        """See :class:`Observer`."""
        self._looks[1 + j][_LOOK], self._look = look, None
        self._observe_rows(*self._all[j], obs)

    def _arguments(self, rows: slice, own: bool = False) -> tuple[Any, ...]:
        sim, task = self.episodes.simulation, self.episodes.task
        boats = Boats(
            sim.rows[rows],
            task.points[rows],
            self._notes[rows],
            self.episodes.shared[self.kind],
            self._settings.copy() if own else self._settings,
            *self._motion_arguments(rows, own),
        )
        scratch = copy.deepcopy(self._scratch) if own else self._scratch
        memory = (array[rows] for array in self.memory)
        return tuple(boats), tuple(memory), self._given, *scratch

    def _motion_arguments(self, rows: slice, own: bool) -> tuple[Any, Any, Any]:
        """Return what of :class:`Boats` is about roll, pitch and heave."""
        if not self.motions.shape[1]:
            return None, None, None
        work = self._motion_work.copy() if own else self._motion_work
        return self.motions[rows], self.first.motion.settings, work

    @property
    def rollout_inputs(self) -> RolloutInputs:
        """What the models of all boats are rolled from, for :mod:`twin.agents.mpc`; views."""
        return self._predictor.rollout_inputs(self.memory)

    @property
    def joint(self) -> JointUKF:
        """What the models have in common: structure, lags, envelope, unit of shaft speed."""
        return self._predictor.ukf

    _observe_rows: ClassVar[Callable[..., Any]] = staticmethod(observe_ukf)


def _compiled(twin: Twin) -> UKFPredictor:
    assert isinstance(twin.predictor, UKFPredictor)
    return twin.predictor


class CompiledPlusTwins(CompiledTwins):
    """The same with refits."""

    def _model_size(self, twin: Twin) -> tuple[int, int]:
        return len(_compiled(twin).ukf.xi), ROWS

    def _config(self) -> Any:
        return plain(self._predictor.config)

    def _work(self) -> Any:
        return plain(self._predictor.work)

    def _buffers(self) -> Any:
        """Return buffers of a forecast."""
        predictor = self._predictor
        assert isinstance(predictor, PlusPredictor)
        normal = predictor.normal
        D, p = normal[0].shape
        return (
            np.zeros(flat_size(forecast_of, p, ROWS, WAVE_STEPS)),
            np.zeros(flat_size(draws_of, p, ROWS, WAVE_STEPS, D)),
            normal,
        )

    _observe_rows = staticmethod(observe_plus)


def twins_of(episodes: Episodes, options: TwinOptions) -> tuple[TwinObserver, ...]:
    """Return the twins of n boats, for each kind of boat.

    The deck point of their particulars is that of the episodes.
    """
    sim, twin, given, found = episodes.simulation, options.twin, options.particulars, []
    if len(episodes.kinds) > 1 and (given is not None or isinstance(twin, Predictor)):
        raise PredictorError(
            "particulars and a predictor are those of one vessel; with several, leave out the "
            "particulars and name the predictor"
        )
    for number, kind in enumerate(episodes.kinds):
        more: dict[str, Any] = {}
        if not isinstance(twin, Predictor):
            needs = predictor_class(twin).needs_simulator
            if needs and (len(episodes.seas) > 1 or episodes.worlds.active):
                raise PredictorError(
                    f"{twin} is given the sea and the boat: name one of each, not "
                    f"{len(episodes.seas)} seas, or what differs from episode to episode"
                )
            more = simulator_options(twin, kind.vessel, episodes.seas[0], sim.dof)
        about = given or particulars_of(kind.vessel, sim.suite, sim.dof)
        if options.twin_prior != "boat":
            design = about.design if options.twin_prior == "class" else ""
            about = dataclasses.replace(about, design=design, prior=None)
        if sim.dof == 6:
            about = with_deck_point(about, kind.deck_point)
        first = Twin(about, twin, seed=options.twin_seed, **more)
        make = _COMPILED.get(type(first.predictor), SeparateTwins)
        found.append(make(episodes, first, options, number))
    return tuple(found)


_COMPILED: dict[type[Predictor], type[TwinObserver]] = {
    UKFPredictor: CompiledTwins,
    PlusPredictor: CompiledPlusTwins,
}
"""Exactly these classes: a subclass may do anything."""
