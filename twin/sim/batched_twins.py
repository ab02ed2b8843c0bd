"""What twins add to observations: n boats in one compiled call where the predictor has one.

The twins themselves are a :class:`twin.batch.Twins`; here their state is described. What is noted
of a boat for that stands behind its row.
"""

from __future__ import annotations

import copy
import dataclasses
import math
from abc import abstractmethod
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.batch import HEALTH, Twins
from twin.digital_twin import Twin
from twin.identification.joint_ukf import JointUKF
from twin.integrity.sensing import ROW
from twin.integrity.state import INTEGRITY, SENSORS
from twin.model.dynamics import N_ACT
from twin.model.rollout import HORIZON_ROWS, HORIZONS, LONG_STEP
from twin.motion.forecast_state import QUIET_SPANS
from twin.particulars import Particulars
from twin.predictors.base import Forecaster, Predictor
from twin.predictors.forecast import draws_of, forecast_of
from twin.predictors.registry import DEFAULT, PredictorError, predictor_class
from twin.predictors.ukf import RolloutInputs
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
    Scene,
    describe_row,
    give_row,
    keep_forecast_flat,
    observe_plus,
    observe_ukf,
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

_ROW = record_size(ROW)
_ALL_STATUSES = HEALTH.start + field_at(INTEGRITY, "statuses")
_COMMANDS_DOUBTED = HEALTH.start + field_at(INTEGRITY, "commands_doubted")
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
        self.kind, observation = kind, options.observation
        # longer rows than those of the plans would be no test of them
        self._grading = options.forecast_scores and episodes.simulation.dt <= LONGEST_STEP
        self._sizes = 0, 0
        if twin.twins.kernel:  # its model is kept with each forecast, and so are the waves
            model = twin.twins.model
            self._sizes = len(model.ukf.xi), 0 if model.sources.window is None else ROWS
        more = grades_size(*self._sizes) if self._grading else 0
        n, beside = episodes.n, record_size(NOTE) - _ROW + more
        twin.reset()
        self.twins = Twins(twin.particulars, twin.predictor, n, beside, episodes.blocks)
        if n == 1:
            twin.attach(self.twins)
        shown = float(observation == "twin_attitude")
        gps_var = twin.particulars.instruments.gps_bias_sd**2
        given = [options.band_period, gps_var, shown, float(self._grading), 1.0]
        self.twins.settings = np.concatenate([self.twins.settings, given])
        self._notes = self.twins.rows
        self.notes, self._fresh = structured(self._notes, NOTE), np.zeros(beside)
        self._fresh[field_at(NOTE, "shown") - _ROW] = math.nan
        if self._grading:
            self._fresh[GRADES_AT - _ROW] = FORECAST_EVERY_S  # when the first is kept
        self._notes[:, _ROW:] = self._fresh
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
        if episodes.simulation.dof == 6:
            self.twins.measure_motion()
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
        if self.episodes.n == 1:
            self.first.reset()
        else:
            self.twins.reset(i)
        self._notes[i, _ROW:] = self._fresh
        self.scores[i] = NO_SCORES

    def leave_out_forecasts(self) -> None:
        """Make no forecasts from now on: nobody sees, grades or draws them."""
        self.twins.settings[_FORECASTING] = 0.0

    def leave(self, i: int) -> None:
        """Let boat i begin an episode as a boat of another kind: its rows are not taken."""
        self.notes["last"][i] = self.notes["shown"][i] = math.inf

    def overlay(self, i: int) -> TwinOverlay | None:
        """Return the twin of boat i for pictures; None before its first row or forecast."""
        note = self.notes[i]
        if not math.isfinite(note["last"]) or not self.twins.settings[_FORECASTING]:
            return None
        return TwinOverlay(
            state=self.twins.state(i),
            cov=note["now"][:2, :2].copy(),
            horizons=HORIZONS.copy(),
            ahead=note["ahead"].copy(),
            covs=note["covs"][:, :2, :2].copy(),
        )

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
            xi, sd = self.twins.parameters(rows)
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

    @abstractmethod
    def _observe(self, obs: NDArray[np.float32], look: bool, rows: slice) -> None: ...

    def twin(self, i: int) -> Twin:
        """Return a copy of the twin of boat i as it is now."""
        twin = copy.deepcopy(self.first)
        twin.take_over(self.twins, i)
        return twin

    def _scene(self, rows: slice) -> Any:
        """Return :class:`Scene` of some boats as a plain tuple."""
        points, shared = self.episodes.task.points, self.episodes.shared[self.kind]
        return tuple(Scene(self.episodes.simulation.rows[rows], points[rows], shared))


class SeparateTwins(TwinObserver):
    """A predictor for each boat, asked one after the other; for any predictor."""

    def __init__(self, episodes: Episodes, twin: Twin, options: TwinOptions, kind: int = 0) -> None:
        super().__init__(episodes, twin, options, kind)
        self._waiting: list[deque[Forecaster]] = [deque() for _ in range(episodes.n)]
        self._plan = np.zeros((ROWS, N_ACT))

    def reset(self, i: int) -> None:
        """See :class:`TwinObserver`."""
        super().reset(i)
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
        sim, predictor, note = self.episodes.simulation, self.twins.predictors[i], self._notes[i]
        if not (is_due(sim.boats[i], note, GRADES_AT) and predictor.ready):
            return
        doubted = note.item(_COMMANDS_DOUBTED) > 0.0
        start = predictor.predict(self._plan[:1], LONG_STEP).start.astype(np.float64)
        keep_forecast_flat(
            sim.rows[i], self.episodes.shared[self.kind], note, start, doubted, self.band_period
        )
        self._waiting[i].append(predictor.forecaster(doubted))

    def _note_forecast(self, i: int, t: float) -> None:
        """Note what the twin of boat i forecasts at time t."""
        note, predictor = self.notes[i], self.twins.predictors[i]
        self._plan[:] = self.episodes.simulation.reported[i]
        if t >= note["covs_due"]:
            note["covs_due"] = t + self.band_period - 1e-9
            prediction = predictor.predict(self._plan, LONG_STEP)
            note["ahead"][:] = prediction.mean[HORIZON_ROWS]
            note["covs"][:] = prediction.cov[HORIZON_ROWS]
            spread = prediction.cov[HORIZON_ROWS] - prediction.start_cov
            note["spread"][:] = spread[:, [0, 0, 1], [0, 1, 1]]
        else:
            note["ahead"][:] = predictor.mean(self._plan, LONG_STEP)[HORIZON_ROWS]

    def _observe(self, obs: NDArray[np.float32], look: bool, rows: slice) -> None:
        twins, scene = self.twins, self._scene(_ALL)
        for i in range(self.episodes.n)[rows]:
            note, boat, predictor = (
                self.notes[i],
                self.episodes.simulation.boats[i],
                twins.predictors[i],
            )
            give_row(boat, self._notes[i])
            dt = twins.step_one(i)
            if dt >= 0.0:
                if self.episodes.n == 1:
                    self.first.note_health()
                if self._grading:
                    self._grade(i, dt)
            if not look or note["shown"] == note["last"]:
                continue
            note["shown"] = note["last"]
            if twins.settings[_FORECASTING]:
                self._note_forecast(i, note["last"].item())
            np.fill_diagonal(note["now"], predictor.estimate().sd ** 2)
            describe_row(i, twins.state(i), twins.parts[0][0], scene, obs)
            if self._grading:
                self._keep(i)


class CompiledTwins(TwinObserver):
    """All twins in one call."""

    def __init__(self, episodes: Episodes, twin: Twin, options: TwinOptions, kind: int = 0) -> None:
        super().__init__(episodes, twin, options, kind)
        waves = self._sizes[1] > 0
        self._kernel: Any = observe_plus if waves else observe_ukf
        self._given = [(self._scene(rows), self._buffers(waves)) for rows in episodes.blocks]
        self.by_block = episodes.n > 1

    def _buffers(self, waves: bool) -> tuple[Any, ...]:
        """Return memory of a forecast, and of its draws; threads need their own."""
        p, own = self._sizes[0], np.zeros
        if not waves:
            return (own(flat_size(forecast_of, p, ROWS, 0)),)
        normal = self.twins.model.normal
        draws = flat_size(draws_of, p, ROWS, WAVE_STEPS, len(normal[0]))
        return own(flat_size(forecast_of, p, ROWS, WAVE_STEPS)), own(draws), normal

    def _observe(self, obs: NDArray[np.float32], look: bool, rows: slice) -> None:
        if rows != _ALL:
            boats, *rest = self.twins.part(rows)
            self._kernel(look, boats, self._scene(rows), *rest, self._given[0][1], obs[rows])
        elif len(self._given) == 1:
            self.observe_block(0, obs, look)
            if self.episodes.n == 1:
                self.first.note_health()
        else:
            blocks = self.episodes.blocks
            self.episodes.each(lambda j: self.observe_block(j, obs[blocks[j]], look))

    def observe_block(self, j: int, obs: NDArray[np.float32], look: bool) -> None:
        """See :class:`Observer`."""
        (boats, memories, config, work), (scene, forecast) = self.twins.parts[j], self._given[j]
        self._kernel(look, boats, scene, memories, config, work, forecast, obs)

    @property
    def rollout_inputs(self) -> RolloutInputs:
        """What the models of all boats are rolled from, for :mod:`twin.agents.mpc`; views."""
        found: RolloutInputs = self.twins.model.rollout_inputs(self.twins.memory)
        return found

    @property
    def joint(self) -> JointUKF:
        """What the models have in common: structure, lags, envelope, unit of shaft speed."""
        found: JointUKF = self.twins.model.ukf
        return found


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
        make = CompiledTwins if first.twins.kernel else SeparateTwins
        found.append(make(episodes, first, options, number))
    return tuple(found)
