"""The contract of predictors: rows of measurements and commands in, forecasts out.

A predictor takes one row after the other, and forecasts the motion under a plan of commands at
any time. It uses neither the truth, nor later rows, nor another predictor.
"""

from __future__ import annotations

import copy
import functools
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.channels import STATE, TIME
from twin.checkpoint import State, restore_attributes, saved_attributes
from twin.identification.identifiability import Identifiability
from twin.logs.datum import Datum
from twin.logs.tables import StateTable
from twin.motion.deck_motion import Z90, MotionEstimate, MotionForecast
from twin.particulars import Particulars
from usv_kernel.errors import UsvTwinError

__all__ = [
    "Z90",
    "Estimate",
    "ForecastError",
    "Forecaster",
    "ParametersInUse",
    "Prediction",
    "Predictor",
    "check_forecast",
    "plain",
]

Array = NDArray[Any]


Forecaster = Callable[[Array, float], Array]
"""Predicts states (K, 6) under a plan (K, 4) with rows of a given step, s."""


class ForecastError(UsvTwinError):
    """A forecast with NaN or infinity; the message names predictor, origin, step and channel."""


def plain(value: Any) -> Any:
    """Return NamedTuples as plain tuples, all the way down."""
    return tuple(map(plain, value)) if isinstance(value, tuple) else value


def check_forecast(predictor: str, t0: float, after: Array, states: Array) -> None:
    """Refuse forecast states that are not finite.

    Parameters
    ----------
    predictor : str
        Name, for the message.
    t0 : float
        Time at which the forecast was made, s.
    after : ndarray, shape (K,)
        Times of its steps after t0, s.
    states : ndarray, shape (K, 6) or (K, 6, 6)
        States of each step, or covariances.

    Raises
    ------
    ForecastError
        Names predictor, origin, step and channel.
    """
    if np.isfinite(states).all():
        return
    # the first step, and in it the first entry
    step, channel = (int(part) for part in np.argwhere(~np.isfinite(states))[0][:2])
    what = "covariance" if states.ndim == 3 else "forecast"
    entries = np.ravel(states[step, channel])
    value = entries[~np.isfinite(entries)][0]
    raise ForecastError(
        f"{predictor}: its {what} made at t = {t0:.2f} s is not finite: {STATE[channel]} is "
        f"{value} at step {step + 1} of {len(states)}, {after[step]:g} s ahead; every step must "
        "have a number"
    )


@dataclass(frozen=True)
class Estimate:
    """State and parameters, estimated by a predictor.

    Parameters
    ----------
    t : float
        Time of the last row, s.
    state, sd : ndarray, shape (6,)
        State in the order of :data:`twin.channels.STATE`, and its standard deviation.
    params, params_sd : ndarray, shape (p,)
        Model parameters and their standard deviations; empty where there is no model.
    ready : bool
        False until a first fix and a first heading have come; the rest means nothing then.
    motion : MotionEstimate, optional
        Roll, pitch and heave, where the log shows them; from ``Twin.estimate`` only.
    """

    t: float
    state: Array
    sd: Array
    params: Array
    params_sd: Array
    ready: bool
    motion: MotionEstimate | None = None

    def __repr__(self) -> str:
        """Return time and state; ``sd`` and ``params`` have the rest."""
        state = ", ".join(f"{value:.3g}" for value in self.state)
        return f"Estimate(t = {self.t:.2f} s, state {state})"


@dataclass(frozen=True)
class Prediction:
    """Forecast states and their uncertainty.

    Parameters
    ----------
    t0 : float
        Time at which it was made, s.
    start, start_cov : ndarray, shapes (6,), (6, 6)
        State that it starts from, in the order of :data:`twin.channels.STATE`, and its covariance.
    t : ndarray, shape (K,)
        Times of the forecast, s.
    mean : ndarray, shape (K, 6)
        Predicted states; heading not wrapped.
    cov : ndarray, shape (K, 6, 6)
        Covariances of their errors.
    low, high : ndarray, shape (K, 6)
        5 % and 95 % points; left out, those of normal errors.
    motion : MotionForecast, optional
        Roll, pitch, heave and the vertical speed of the deck, where the log shows them.
    """

    t0: float
    start: Array
    start_cov: Array
    t: Array
    mean: Array
    cov: Array
    low: Array = None  # type: ignore[assignment]
    high: Array = None  # type: ignore[assignment]
    motion: MotionForecast | None = None

    def __post_init__(self) -> None:
        for name, side in (("low", -Z90), ("high", Z90)):
            if getattr(self, name) is None:
                object.__setattr__(self, name, self.mean + side * self.sd)

    def __repr__(self) -> str:
        """Return from when, and how far it reaches; ``table()`` has the numbers."""
        ahead = float(self.t[-1] - self.t0) if len(self.t) else 0.0
        return f"Prediction(from t = {self.t0:.2f} s, {ahead:g} s ahead in {len(self.t)} steps)"

    @property
    def sd(self) -> Array:
        """Standard deviations, shape (K, 6)."""
        return np.sqrt(np.maximum(np.diagonal(self.cov, axis1=1, axis2=2), 0.0))

    def table(self, datum: Datum | None = None) -> StateTable:
        """Return the forecast as a structured array, with ``to_pandas()`` and ``write(path)``.

        Its columns are ``t_s``; date, latitude and longitude where the datum has them. Then the
        means by the names of ``twin.channels.STATE``; and those with ``sd_``, ``low_`` and
        ``high_``. Where there is a ``motion``, those of ``twin.motion.CHANNELS`` follow, and
        ``quiet_2s``, ``quiet_3s`` and ``quiet_5s``: the probabilities of a quiet deck from ``t0``
        on, the same in every row. They are NaN, an empty cell of a file, until ``motion.ready``.

        Parameters
        ----------
        datum : Datum, optional
            Where and when t = x = y = 0 is: ``twin.datum`` or ``log.datum``.
        """
        parts = {"": self.mean, "sd_": self.sd, "low_": self.low, "high_": self.high}
        columns = {
            f"{kind}{name}": part[:, k]
            for kind, part in parts.items()
            for k, name in enumerate(STATE)
        }
        more = {} if self.motion is None else self.motion.columns(self.t)
        return StateTable.of({TIME: self.t, **columns, **more}, datum)

    def at(self, horizons: Array) -> tuple[Array, Array]:
        """Return mean (h, 6) and covariance (h, 6, 6) at times after t0, interpolated.

        Parameters
        ----------
        horizons : array_like, shape (h,)
            Seconds after t0, within the prediction.
        """
        return (
            self._between(self.start, self.mean, horizons),
            self._between(self.start_cov, self.cov, horizons),
        )

    def interval(self, horizons: Array) -> tuple[Array, Array]:
        """Return the 5 % and 95 % points, each (h, 6), at times after t0, interpolated.

        Parameters
        ----------
        horizons : array_like, shape (h,)
            Seconds after t0, within the prediction.
        """
        half = Z90 * np.sqrt(np.maximum(np.diagonal(self.start_cov), 0.0))
        return (
            self._between(self.start - half, self.low, horizons),
            self._between(self.start + half, self.high, horizons),
        )

    def _between(self, first: Array, later: Array, horizons: Array) -> Array:
        """Return values at times after t0, linearly between those of the start and the rows."""
        after = np.concatenate([[0.0], self.t - self.t0])
        values = np.concatenate([first[None], later])
        place = np.interp(horizons, after, np.arange(len(after)))
        low = np.minimum(place.astype(int), len(after) - 2)
        share = (place - low).reshape(-1, *[1] * (values.ndim - 1))
        return values[low] + share * (values[low + 1] - values[low])


class ParametersInUse(NamedTuple):
    """Which of several candidates for its parameters a predictor forecasts with."""

    name: str
    """The candidate in plain words, such as ``"the joint filter"``."""
    is_prior: bool
    """Whether it is the prior, so that the parameters say nothing of the data."""
    refit: tuple[Array, Array] | None = None
    """Mean and standard deviations, each (p,), of the best refit; None before the first."""


class Predictor(ABC):
    """The contract of every entry of ``twin.PREDICTORS``.

    Parameters
    ----------
    particulars : Particulars
        Main particulars and instruments.
    seed : int
        For predictors that draw random numbers; the same seed gives the same bits.
    """

    trains = False
    """Whether the class takes ``train_at``: seconds of data after which it trains itself."""
    parameter_names: tuple[str, ...] = ()
    """Names of the parameters in ``Estimate.params`` ..."""
    parameter_units: tuple[str, ...] = ()
    """... their units ..."""
    parameter_blocks: Mapping[str, tuple[int, int]] = MappingProxyType({})
    """... and first and last + 1 of those in the equation of each motion."""
    is_compiled = False
    """Whether exactly this class keeps all that it remembers in ``memory``, and has a kernel in
    :mod:`twin.row_steps`."""
    needs_simulator = False
    """Whether the class takes the simulator's ``vessel``, ``sea`` and ``dof``."""
    tuning: ClassVar[str] = "not stated"
    """What was searched for its settings, in one line: the benchmark prints it."""
    files: ClassVar[tuple[str, ...]] = ()
    """Files that the class reads, such as weights; a folder stands for all in it. Paths count from
    the folder of the class's module. A kept result of a benchmark is not reused once one of them,
    the module, or one that it imports from there changes. A subclass names its own; those of its
    bases count too."""
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = MappingProxyType({})
    """Named groups of options, for names such as ``dsw-ukf:printed``."""
    constants: ClassVar[tuple[str, ...]] = ("particulars", "seed", "made_with")
    """Attributes that :meth:`state_dict` leaves out: they never change, or follow from others.
    A subclass names its own; those of its bases count too."""
    made_with: tuple[tuple[Any, ...], dict[str, Any]]
    """Arguments of the constructor, with which a copy is made."""

    def __new__(cls, *args: Any, **options: Any) -> Any:
        """Keep the constructor's arguments."""
        predictor = super().__new__(cls)
        predictor.made_with = args, options
        return predictor

    def __init__(self, particulars: Particulars, *, seed: int = 0) -> None:
        self.particulars = particulars
        self.seed = seed

    def with_common_error(self, cov: Array) -> Array:
        """Return covariances (..., 6, 6) with the drifting part of the GPS error added.

        It is the same throughout a prediction, and no filter can tell it from the position.
        """
        cov = cov.copy()
        for i in (0, 1):
            cov[..., i, i] += self.particulars.instruments.gps_bias_sd**2
        return cov

    @property
    def ready(self) -> bool:
        """True once a first fix and a first heading have come."""
        return self.estimate().ready

    @property
    def lost(self) -> bool:
        """True after a row from whose refused samples the navigation began again: it was lost."""
        return False

    def current(self) -> tuple[float, float, float] | None:
        """Return the assumed velocity of the water to north and east, and its standard deviation.

        All in m/s; None where there is no estimate.
        """
        return None

    def suspend_learning(self, commands: bool, motion: bool) -> None:
        """Learn nothing from the rows that follow while one of the two holds.

        A predictor without a model has nothing to do.

        Parameters
        ----------
        commands : bool
            Whether the commands do not explain the motion.
        motion : bool
            Whether GPS or compass are at fault and left out, so that states come from the rest.
        """
        return

    def begin_again(self, restart: Any) -> None:
        """Begin again elsewhere in the next row: a sensor that was used is found at fault.

        A predictor without a navigation of its own has nothing to do.

        Parameters
        ----------
        restart : record
            See ``twin.filters.navigation_state.RESTART``.
        """
        return

    @abstractmethod
    def reset(self) -> None:
        """Return to the state before the first row."""

    @abstractmethod
    def update(self, t: float, dt: float, z: Array, cmd: Array) -> None:
        """Take one row.

        Parameters
        ----------
        t, dt : float
            Time of the row and time since the row before, s; dt is 0 in the first row.
        z : ndarray, shape (19,)
            Measurements in the order of ``twin.channels.MEASUREMENTS``; NaN is missing.
        cmd : ndarray, shape (4,)
            Command that was in force since the row before, in the order of
            ``twin.channels.COMMANDS``.
        """

    @property
    @abstractmethod
    def state(self) -> Array:
        """Estimated state, (6,) in the order of :data:`twin.channels.STATE`; may be a view."""

    @property
    def navigation(self) -> Array:
        """State by the sensors alone, shape (6,), for the sensor checks; may be a view.

        A model that has the commands would agree with them. Here: :attr:`state`.
        """
        return self.state

    @contextmanager
    def drives_at(self, command: Array) -> Iterator[None]:
        """Predict as if the drives were at a command (4,); what they do is not known.

        For predictors without a model, this changes nothing.
        """
        yield

    def parameters_in_use(self) -> ParametersInUse | None:
        """Return the candidate whose parameters :meth:`estimate` gives; None without a choice."""
        return None

    @abstractmethod
    def estimate(self) -> Estimate:
        """Return the estimate after the last row."""

    def identifiability(self) -> Identifiability | None:
        """Return how well the data determine the parameters; None where there is no model."""
        return None

    def mean(self, plan: Array, dt: float) -> Array:
        """Return the predicted states (K, 6) alone, where that is cheaper.

        Parameters
        ----------
        plan, dt
            As for :meth:`predict`.
        """
        return self.predict(plan, dt).mean

    def forecaster(self, doubted: bool = False) -> Forecaster:
        """Return what predicts from this moment, also after more rows have come.

        It takes plan and dt of :meth:`mean`, and returns what :meth:`mean` returns now.

        Parameters
        ----------
        doubted : bool
            Whether what the drives do is not known: they are then at the plan's first command.
        """
        return functools.partial(_forecast, copy.deepcopy(self), doubted)

    def _left_out(self) -> set[str]:
        """Return the constants of the class and its bases, and the constructor's arguments."""
        names = {name for kind in type(self).__mro__ for name in vars(kind).get("constants", ())}
        given = [*self.made_with[0], *self.made_with[1].values()]
        plain = (bool, int, float, str, type(None), np.ndarray, list)
        return names | {
            name
            for name, value in vars(self).items()
            if not isinstance(value, plain) and any(value is one for one in given)
        }

    def state_dict(self) -> State:
        """Return all that the predictor remembers, as fields by name.

        This one walks the attributes: see :func:`twin.checkpoint.saved_attributes`.

        Returns
        -------
        dict of str to ndarray, float, int, bool, str or None
            Copies.

        Raises
        ------
        StateError
            Names an attribute that cannot be saved.
        """
        return saved_attributes(self, self._left_out())

    def load_state_dict(self, state: State) -> None:
        """Take over what :meth:`state_dict` returned, of the same class, boat and options.

        Parameters
        ----------
        state : dict
            Fields by name.

        Raises
        ------
        StateError
            Names the field that does not fit, and the remedy.
        """
        restore_attributes(self, state, self._left_out())

    @abstractmethod
    def predict(self, plan: Array, dt: float) -> Prediction:
        """Predict the motion under a plan; nothing of the predictor's state changes by it.

        Parameters
        ----------
        plan : ndarray, shape (K, 4)
            Commands; row k is in force from k to k + 1 times dt after the last row.
        dt : float
            Time between rows of the plan, s.

        Returns
        -------
        Prediction
            At the ends of the rows of the plan; always finite.
        """


def _forecast(now: Predictor, doubted: bool, plan: Array, dt: float) -> Array:
    """Do what :meth:`Predictor.forecaster` returns; ``now`` is the predictor of that moment."""
    with now.drives_at(plan[0]) if doubted else nullcontext():
        return now.mean(plan, dt)
