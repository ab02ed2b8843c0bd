"""The digital twin: it takes rows of a log one by one, estimates, and predicts."""

from __future__ import annotations

import copy
import dataclasses
import math
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin.batch import HEALTH, Twins
from twin.channels import COMMANDS, MEASUREMENTS, MOTION_AT, MOTION_END, STATE, TIME
from twin.checkpoint import (
    StateError,
    check_fields,
    plain_options,
    read,
    with_prefix,
    without_prefix,
    write,
)
from twin.integrity.history import HealthHistory
from twin.integrity.monitor import SensorMonitor, SensorStatus
from twin.integrity.sensing import ROW
from twin.logs.clock import MONTH_S
from twin.logs.datum import Datum
from twin.logs.log import Log
from twin.logs.tables import StateTable
from twin.motion.attitude import is_measured
from twin.motion.deck_motion import MotionEstimate
from twin.motion.forecast_state import CHANNELS, HORIZONS
from twin.motion.sea_estimate import SeaEstimate
from twin.particulars import Particulars
from twin.predictors.base import Estimate, Prediction, Predictor, check_forecast
from twin.predictors.registry import DEFAULT, PREDICTORS, base_name, make_predictor
from usv_kernel.errors import ArgumentError, UsvTwinError
from usv_kernel.records import field_at

__all__ = [
    "PLANS",
    "Twin",
    "TwinError",
    "known_plan",
]

Array = NDArray[np.float64]

_LAST, _BEGUN, _LOST_AT = (field_at(ROW, name) for name in ("last", "begun", "lost_at"))

_RATES = ("p_radps", "q_radps", "vertical_speed_mps")
"""Columns of roll rate, pitch rate and vertical speed of the origin."""

MOTION_AHEAD = float(HORIZONS[-1])
MOTION_STEP = 0.05
"""How far roll, pitch and heave are forecast, and the finest step of a plan made for that, s."""

LOST, LOST_SHOWN = "navigation began again from the sensors: it or they were far off", 10.0
"""Said of a navigation filter that took refused samples after all, and for how long, s."""

PLANS = ("hold", "known")
"""``hold``: the last command stays. ``known``: the commands that the log went on with."""


class TwinError(UsvTwinError):
    """Rows or plans that the twin cannot use; the message names the entry and the remedy."""


class Twin:
    """The digital twin of a boat, updated row by row from measurements and commands.

    Parameters
    ----------
    particulars : Particulars
        The boat and its instruments.
    predictor : str or Predictor
        A name in ``twin.PREDICTORS``, options behind a colon (``"ukf:model=mmg"``), or a
        predictor object.
    seed : int
        Of predictors that draw random numbers.
    **options
        Options of the predictor's class.

    Raises
    ------
    ArgumentError
        ``particulars`` are no Particulars, but for instance a name or a path.

    Attributes
    ----------
    predictor : Predictor
        Estimates and predicts.
    name : str or None
        Its name in ``twin.PREDICTORS``; None for an object.
    twins : Twins
        What is remembered, as a batch of one.
    t : float
        Time of the last row, s; NaN before the first.
    cmd : ndarray, shape (4,)
        Its command.
    datum : Datum or None
        Latitude, longitude and date of the origin, as the log of :meth:`run` had them.

    Examples
    --------
    >>> from twin import Log, Particulars, Twin, recorded_runs
    >>> path = recorded_runs()["boat1_usv_circle"]
    >>> twin = Twin(Particulars.load(path.with_name("boat1_usv_circle.toml")))
    >>> track = twin.run(Log.read(path))
    >>> track["u_mps"].shape == track.shape
    True
    >>> prediction = twin.predict("hold", horizon=10.0)
    >>> prediction.mean.shape
    (40, 6)
    """

    def __init__(
        self,
        particulars: Particulars,
        predictor: str | Predictor = DEFAULT,
        *,
        seed: int = 0,
        **options: Any,
    ) -> None:
        if not isinstance(particulars, Particulars):
            raise ArgumentError(
                f"particulars = {particulars!r} must be a twin.Particulars: Particulars.load(path) "
                "of a file, or twin.sim.bridge.particulars_of(usv_gym.Vessel.load(name)) of a "
                "vessel"
            )
        self.particulars = particulars
        self.name = None if isinstance(predictor, Predictor) else predictor
        self.seed, self.options = seed, options
        if isinstance(predictor, Predictor):
            if options:
                kind = type(predictor).__name__
                raise TwinError(f"{', '.join(options)}: give options where the {kind} is made")
            self.predictor = predictor
        else:
            self.predictor = make_predictor(predictor, particulars, seed=seed, **options)
        self.twins = Twins(particulars, self.predictor)
        self.monitor = SensorMonitor(self.twins.rows[0, HEALTH])
        self.health_history = HealthHistory(self.monitor)
        self.datum: Datum | None = None
        self._noted: Any = None
        self.attach(self.twins)

    def attach(self, twins: Twins) -> None:
        """Be the one boat of these twins from now on."""
        self.twins, self.predictor, self.motion = twins, twins.predictors[0], twins.motion
        self.monitor.memory = twins.rows[0, HEALTH]

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Become a copy."""
        vars(self).update(state)
        self.attach(self.twins)

    def take_over(self, twins: Twins, i: int) -> None:
        """Become a copy of boat i of twins."""
        own = self.twins
        if not own.kernel:
            own.predictors[0] = copy.deepcopy(twins.predictors[i])
        if twins.motions is not None:
            own.measure_motion()
            own.motions[0] = twins.motions[i]  # type: ignore[index]
        own.rows[0] = twins.rows[i, : own.rows.shape[1]]
        for memory, theirs in zip(own.memory, twins.memory, strict=True):
            memory[0] = theirs[i]
        self.attach(own)
        self._tell_time()

    @property
    def t(self) -> float:
        """Time of the last row, s."""
        return self.twins.rows.item(0, _LAST)

    @property
    def begun(self) -> float:
        """Time of the first row, s; NaN before it."""
        return self.twins.rows.item(0, _BEGUN)

    @property
    def cmd(self) -> Array:
        """Command (4,) of the last row."""
        return np.array(self.twins.boats["cmd"][0])

    @property
    def _lost_at(self) -> float:
        """When the navigation was last found lost, s; NaN: never."""
        return self.twins.rows.item(0, _LOST_AT)

    def __repr__(self) -> str:
        """Return predictor, boat and time."""
        name = self.name or type(self.predictor).__name__
        now = "no row yet" if math.isnan(self.t) else f"t = {self.t:.2f} s"
        return f"Twin({name} of {self.particulars.name}, {now})"

    def reset(self) -> None:
        """Return to the state before the first row."""
        self.twins.reset(0)
        self.health_history.reset()
        self._noted = None

    def save(self, path: str | Path) -> None:
        """Write all that the twin knows to a file, to go on from later with :meth:`load`.

        The file holds fields by name. It stays readable as long as the format version does.

        Parameters
        ----------
        path : str or Path
            File, for instance ``boat.twin``. One that is there is replaced once the new one
            is whole on the disk.

        Raises
        ------
        StateError
            The predictor or its options hold something that cannot be saved: options are numbers,
            texts, arrays of numbers, and lists of those. Hand in a predictor with others as an
            object.
        """
        state = self.predictor.state_dict()
        kept = {name: value for name, value in state.items() if isinstance(value, np.ndarray)}
        header = {
            "predictor": self.name,
            "class": type(self.predictor).__name__,
            "seed": self.seed,
            "options": plain_options(self.options),
            "particulars": dataclasses.asdict(self.particulars),
            "datum": None if self.datum is None else self.datum.to_json(),
            "t": self.t,
            "begun": self.begun,
            "lost_at": self._lost_at,
            "state": {name: value for name, value in state.items() if name not in kept},
        }
        arrays = {
            "command": self.cmd,
            **with_prefix("state", kept),
            **with_prefix("health", self.monitor.state_dict()),
            **with_prefix("motion", self.motion.state_dict()),
        }
        write(path, header, arrays)

    @classmethod
    def load(cls, path: str | Path, predictor: Predictor | None = None) -> Twin:
        """Return the twin that :meth:`save` wrote: it goes on as if it had never stopped.

        Parameters
        ----------
        path : str or Path
            The file.
        predictor : Predictor, optional
            Where the saved one was handed in as an object: a newly made one of the same class
            for the same boat. It takes over what the saved one remembers.

        Returns
        -------
        Twin
            With the same versions of the packages, going on from it gives the same bits.

        Raises
        ------
        StateError
            The file is no saved twin, is damaged, has another format version, or was not made
            for this predictor or boat. The message names the file, the field and the remedy.
        """
        header, arrays = read(path)
        try:
            return cls._from_saved(header, arrays, predictor)
        except ImportError:
            raise
        except StateError as error:
            raise StateError(f"{path}: {error}") from None
        except Exception as error:  # constructors refuse damaged values in many ways
            raise StateError(
                f"{path}: is damaged ({type(error).__name__}: {error}); use an earlier copy of the "
                "file"
            ) from None

    @classmethod
    def _from_saved(
        cls, header: dict[str, Any], arrays: dict[str, Array], predictor: Predictor | None
    ) -> Twin:
        """Return the twin of a header and its arrays."""
        about = dict(header["particulars"])
        instruments, deck = about.pop("instruments"), about.pop("deck")
        particulars = Particulars.from_tables(about, instruments, deck)
        name, seed, t, options = (header[key] for key in ("predictor", "seed", "t", "options"))
        if predictor is not None:
            if predictor.particulars != particulars:
                raise StateError(
                    f"was made for the boat {particulars.name!r} with other particulars or "
                    f"instruments than {predictor.particulars.name!r}; use the same ones"
                )
            twin = cls(particulars, predictor)
        elif name is None:
            raise StateError(
                f"was saved with a predictor given as an object (of class {header['class']}); give "
                "a new one: Twin.load(path, predictor=...)"
            )
        elif base_name(name) not in PREDICTORS:
            raise StateError(
                f"was saved with the predictor {name!r}, which is not known here; known: "
                f"{', '.join(PREDICTORS)}; give one of its class: Twin.load(path, predictor=...)"
            )
        else:
            twin = cls(particulars, name, seed=seed, **options)
        twin.name, twin.seed, twin.options = name, seed, options
        if header["class"] != type(twin.predictor).__name__:
            raise StateError(
                f"holds a {header['class']}, not a {type(twin.predictor).__name__}; give a "
                "predictor of that class"
            )
        twin.predictor.load_state_dict(without_prefix("state", arrays) | header["state"])
        check_fields({"t": t, "command": arrays["command"]}, {"t": twin.t, "command": twin.cmd})
        twin.datum = None if header["datum"] is None else Datum(**header["datum"])
        twin.monitor.load_state_dict(without_prefix("health", arrays))
        if motion := without_prefix("motion", arrays):
            twin.twins.measure_motion()
            twin.motion.load_state_dict(motion)
        row, begun, lost_at = twin.twins.boats[0], float(header["begun"]), float(header["lost_at"])
        row["last"], row["begun"], row["lost_at"], row["cmd"] = t, begun, lost_at, arrays["command"]
        now = twin.predictor.estimate()
        if now.ready and not abs(now.t - twin.t) <= 1e-6:
            raise StateError(
                f"field 't' = {t} is not the time of the predictor's last row ({now.t}); use an "
                "earlier copy of the file"
            )
        return twin

    def step(self, t: float, z: ArrayLike, cmd: ArrayLike) -> None:
        """Take one row.

        Parameters
        ----------
        t : float
            Time, s; later than that of the row before.
        z : array_like, shape (19,), (17,) or (10,)
            Measurements in the order of ``twin.channels.MEASUREMENTS``; NaN is missing. The last
            two, of the apparent wind, may be left out, and the seven of roll, pitch and heave.
        cmd : array_like, shape (4,)
            Command that was in force since the row before, in the order of
            ``twin.channels.COMMANDS``.

        Raises
        ------
        TwinError
            Names what is wrong; the twin is then as it was before.
        """
        z = np.asarray(z, dtype=np.float64)
        # a copy, as the caller may reuse its array
        cmd = np.array(cmd, dtype=np.float64)
        if z.shape in ((MOTION_AT,), (MOTION_END,)):
            z = np.concatenate([z, np.full(len(MEASUREMENTS) - len(z), math.nan)])
        if z.shape != (len(MEASUREMENTS),) or cmd.shape != (len(COMMANDS),):
            raise TwinError(
                f"z has shape {z.shape} and cmd {cmd.shape}; they must be "
                f"({len(MEASUREMENTS)},) and ({len(COMMANDS)},): see twin.channels"
            )
        if not math.isfinite(t) or t <= self.t:
            raise TwinError(f"t = {t} must be finite and later than the row before ({self.t})")
        if t - self.t > MONTH_S:
            raise TwinError(
                f"t = {t} is more than a month after the row before ({self.t}): a clock that was "
                "not set gave one of them; leave that row out, or begin with a new twin"
            )
        if not all(map(math.isfinite, cmd.tolist())):
            raise TwinError(f"cmd = {cmd} holds NaN or infinity; give the last command")
        self.feed(t, z, cmd)

    def feed(self, t: float, z: Array, cmd: Array) -> None:
        """Take one row without checks of its form; see :meth:`step`."""
        if self.twins.motions is None and is_measured(z):
            self.twins.measure_motion()
        self.twins.take(t, z, cmd)
        self.note_health()

    def _tell_time(self) -> None:
        """Tell a predictor whose rows a kernel took when the last was."""
        if self.twins.kernel:
            self.predictor.t = self.t  # type: ignore[attr-defined]

    def note_health(self) -> None:
        """Note which sensors, or the navigation, changed their status in the row just taken."""
        self._tell_time()
        lost = self.t < self._lost_at + LOST_SHOWN
        noted = self.monitor.all_statuses, lost, self.motion.lasting()
        if noted != self._noted:
            self._noted = noted
            troubles = self._others(self.motion.lasting_troubles())
            self.health_history.take(self.t, self.begun, troubles)

    @property
    def health(self) -> dict[str, SensorStatus]:
        """Status of each sensor by its name: ok, doubtful, excluded or absent; since when; why.

        That of the navigation filter is ``navigation``. Those of roll, pitch, heave and wind are
        named only while they are in trouble. A GPS that is drawn away looks like a current. Where
        that is too large, or changes too fast, the GPS is doubtful.
        """
        return self.monitor.statuses(self.begun) | self._others(self.motion.troubles())

    def _others(self, channels: dict[str, tuple[str, float, str]]) -> dict[str, SensorStatus]:
        """Return the status of the navigation filter, and those of what else is in trouble.

        ``channels`` are those of roll, pitch and heave: status, age (s), why.
        """
        again = self._lost_at + LOST_SHOWN  # NaN: it never began again
        found = {"navigation": SensorStatus("doubtful", self._lost_at, LOST)}
        if not self.t < again:
            since = self.begun if math.isnan(again) else again
            found["navigation"] = SensorStatus("ok", since, "")
        if self.monitor.doubts_wind:
            found["wind"] = self.monitor.wind_status(self.begun)
        for name, (status, age, why) in channels.items():
            found[name] = SensorStatus(status, self.t - age, why)
        return found

    @property
    def notes(self) -> tuple[str, ...]:
        """A line for each stretch of the rows taken in which a sensor was not ok.

        For instance ``"compass excluded from 12.0 to 31.5 s: contradicted the other sensors"``.
        A saved twin does not keep them, nor does a copy from a vector environment.
        """
        return self.health_history.lines()

    def run(self, log: Log, on_row: Callable[[], object] | None = None) -> StateTable:
        """Take every row of a log, one after the other.

        Parameters
        ----------
        log : Log
            The run, or its next piece.
        on_row : callable, optional
            Called without arguments after each row, for instance to show progress.

        Returns
        -------
        StateTable, shape (N,)
            A structured array of the estimates at each row: time, state and parameters with their
            standard deviations, and those of ``twin.motion.CHANNELS`` where the log shows roll,
            pitch or heave. Roll rate, pitch rate and the vertical speed of the origin follow:
            ``p_radps``, ``q_radps`` and ``vertical_speed_mps`` (down). Latitude, longitude and date
            are there where the log has them. It has ``to_pandas()``, ``to_polars()`` and
            ``write(path)``. Without a table: ``for row in log: twin.step(*row)``. Sensors that were
            in doubt are in :attr:`notes`.

        Raises
        ------
        TwinError
            Names what is wrong, for instance an origin other than that of the log before.
        ArgumentError
            ``log`` is a path.
        """
        if isinstance(log, (str, Path)):
            raise ArgumentError(f"log = {str(log)!r} must be a Log: Log.read(path) reads a file")
        self.locate(log.datum)
        parameters = self.predictor.parameter_names
        deck = np.full((len(log), 2, len(CHANNELS)), math.nan)
        rates = np.full((len(log), len(_RATES)), math.nan)
        states, state_sds = np.full((2, len(log), len(STATE)), math.nan)
        params, param_sds = np.full((2, len(log), len(parameters)), math.nan)
        for k, (t, z, cmd) in enumerate(log):
            self.step(t, z, cmd)
            found = self.predictor.estimate()
            if found.ready:
                states[k], state_sds[k] = found.state, found.sd
                params[k], param_sds[k] = found.params, found.params_sd
            if (now := self.motion.estimate()) is not None:
                deck[k] = now.mean, now.sd
                rates[k] = now.roll_rate, now.pitch_rate, now.vertical_speed
            if on_row is not None:
                on_row()
        columns = {TIME: log.t}
        for names, means, sds in ((STATE, states, state_sds), (parameters, params, param_sds)):
            columns |= dict(zip(names, means.T, strict=True))
            columns |= {f"sd_{name}": sd for name, sd in zip(names, sds.T, strict=True)}
        if self.motion.active:
            for j, kind in enumerate(("", "sd_")):
                columns |= {f"{kind}{name}": deck[:, j, c] for c, name in enumerate(CHANNELS)}
            columns |= dict(zip(_RATES, rates.T, strict=True))
        return StateTable.of(columns, self.datum)

    def locate(self, datum: Datum | None) -> None:
        """Take over the datum of a log that is about to come.

        Raises
        ------
        TwinError
            If its origin is not that of the rows before.
        """
        if datum is None:
            return
        if self.datum is None or math.isnan(self.t):
            self.datum = datum
        elif not self.datum.same_place(datum):
            raise TwinError(
                f"the log's origin is {datum.latitude}, {datum.longitude}, and that of the rows "
                f"before {self.datum.latitude}, {self.datum.longitude}. State the latter as datum "
                "= [latitude, longitude] in [position] of the log's mapping file"
            )
        elif not self.datum.same_clock(datum):
            raise TwinError(
                f"the log's t = 0 is {datum.date}, and that of the rows before {self.datum.date}. "
                "Give all its times since the latter, or as seconds since 1970 in both logs"
            )

    def estimate(self) -> Estimate:
        """Return state and parameters with their standard deviations, and the attitude."""
        motion = self.motion.estimate()
        estimate = self.predictor.estimate()
        return estimate if motion is None else dataclasses.replace(estimate, motion=motion)

    @property
    def attitude(self) -> MotionEstimate | None:
        """Roll, pitch and heave at the last row; None where nothing measures them."""
        return self.motion.estimate()

    @property
    def sea(self) -> SeaEstimate | None:
        """Height, period and direction of the waves; None where nothing measures the motion."""
        return self.motion.sea()

    def predict(
        self, plan: str | ArrayLike = "hold", *, horizon: float = 10.0, dt: float = 0.25
    ) -> Prediction:
        """Predict where the boat will be; nothing of the twin changes by it.

        Parameters
        ----------
        plan : "hold" or array_like, shape (K, 4)
            Commands of the future: row k is in force from k to k + 1 times dt from now.
            ``"hold"`` keeps the last command. The commands that a log went on with
            (``"known"`` in the benchmark) come as an array from :func:`known_plan`.
        horizon : float
            How far, s, with ``"hold"``; an array is as long as it is.
        dt : float
            Time between rows of the plan and of the answer, s.

        Returns
        -------
        Prediction
            Before ``estimate().ready`` it is finite, but starts at the origin and means nothing.
            Its ``motion`` has the forecast of roll, pitch, heave and the vertical speed of the
            deck, and the probability that it stays quiet, where the log shows such motion. It
            reaches 10 s ahead for any horizon: after the plan, the last command stays.

        Raises
        ------
        TwinError
            Names what is wrong with the plan, and the remedy.
        ForecastError
            The predictor answered with NaN or infinity; names it, the step and the channel.
        """
        if not (math.isfinite(dt) and dt > 0.0 and math.isfinite(horizon) and horizon > 0.0):
            raise TwinError(f"horizon = {horizon} and dt = {dt} must be finite and above 0")
        if isinstance(plan, str):
            if plan == "known":
                raise TwinError(
                    "plan = 'known': a twin does not know the commands to come; take them from "
                    "a log, as plan=known_plan(log, row, horizon, dt), with the same dt"
                )
            if plan != "hold":
                raise TwinError(f"plan = {plan!r}; use 'hold' or an array of commands (K, 4)")
            held, doubted = self.monitor.trusted(self.cmd), False
            rows = np.tile(held, (max(round(horizon / dt), 1), 1))
        else:
            rows = np.ascontiguousarray(plan, dtype=np.float64)
            if rows.ndim != 2 or rows.shape[1] != len(COMMANDS) or len(rows) == 0:
                raise TwinError(
                    f"plan has shape {rows.shape}; it must be (K, {len(COMMANDS)}), with the "
                    f"columns {', '.join(COMMANDS)}"
                )
            if not np.isfinite(rows).all():
                raise TwinError("plan holds NaN or infinity; every command must be a number")
            doubted = self.monitor.commands_doubted
        # what the drives got may not be known, but what they will get is
        with self.predictor.drives_at(rows[0]) if doubted else nullcontext():
            return self._with_motion(self.predictor.predict(rows, dt), rows, dt)

    def _with_motion(self, prediction: Prediction, rows: Array, dt: float) -> Prediction:
        """Return a finite prediction with that of roll, pitch and heave, if measured."""
        self._check_forecast(prediction.t0, prediction.t, prediction.mean)
        self._check_forecast(prediction.t0, prediction.t, prediction.cov)
        if not self.motion.active:
            return prediction
        after, states = prediction.t - prediction.t0, prediction.mean
        if after[-1] < MOTION_AHEAD - 1e-6:
            # the forecast of the motion is longer: the last command stays
            step = max(dt, MOTION_STEP)
            middle = step * (np.arange(math.ceil(MOTION_AHEAD / step - 1e-6)) + 0.5)
            plan = rows[np.minimum((middle / dt).astype(int), len(rows) - 1)]
            after, states = np.asarray(middle + 0.5 * step), self.predictor.mean(plan, step)
            self._check_forecast(prediction.t0, prediction.t0 + after, states)
        motion = self.motion.forecast(after, states, prediction.start)
        return dataclasses.replace(prediction, motion=motion)

    def _check_forecast(self, t0: float, times: Array, states: Array) -> None:
        """Refuse a forecast that is not finite."""
        check_forecast(self.name or type(self.predictor).__name__, t0, times - t0, states)


def known_plan(log: Log, row: int, horizon: float, dt: float) -> Array:
    """Return the commands that a log went on with after a row.

    Parameters
    ----------
    log : Log
        The run.
    row : int
        Row at which the prediction is made.
    horizon, dt : float
        Length and step of the plan, s.

    Returns
    -------
    ndarray, shape (K, 4)
        The last command of the log is held where it ends.

    Raises
    ------
    TwinError
        The log has no such row.
    """
    if not -len(log) <= row < len(log):
        raise TwinError(f"row = {row}: the log has {len(log)} rows, 0 to {len(log) - 1}")
    middle = log.t[row] + dt * (np.arange(max(round(horizon / dt), 1)) + 0.5)
    # a row's command was in force up to the row's time
    rows = np.searchsorted(log.t, middle, side="left")
    return log.cmd[np.minimum(rows, len(log) - 1)]
