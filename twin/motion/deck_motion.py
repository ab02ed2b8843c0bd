"""Roll, pitch and heave of one boat, as users see them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin.channels import AHRS_ROLL, MOTION_AT, PSI, R, U
from twin.checkpoint import State, check_fields, fill, record_views
from twin.motion.attitude import take_attitude
from twin.motion.forecast import forecast_motion, quiet_probabilities
from twin.motion.forecast_state import (
    CHANNELS,
    FORECAST,
    FORECAST_SETTINGS,
    FORECAST_WORK,
    HORIZONS,
    N_CHANNELS,
    QUIET_SPANS,
    forecast_settings,
    initial_forecast,
)
from twin.motion.learning import error_now, leak_variance, take_motion
from twin.motion.sea_estimate import SEA_MOMENTS, SeaEstimate, estimate_sea, take_sea
from twin.motion.state import (
    ANGLE,
    ATTITUDE,
    ATTITUDE_SETTINGS,
    CLIMB,
    HEAVE,
    NO_SAMPLE_AGE_S,
    attitude_settings,
    initial_attitude,
)
from twin.motion.upright import turn_upright
from twin.particulars import GRAVITY, Particulars
from usv_kernel.channels import ACCEL_X, ACCEL_Y, MOTION_CHANNELS, SENSOR_CHANNELS
from usv_kernel.jit import kernel
from usv_kernel.records import as_record, field_at, record_size

__all__ = [
    "MOTION",
    "MOTION_SETTINGS",
    "MOTION_WORK",
    "DeckMotion",
    "MotionEstimate",
    "MotionForecast",
    "accelerations_ahead",
    "initial_motion",
    "motion_settings",
    "take_row",
]

Array = NDArray[np.float64]

Z90 = 1.6448536269514722
"""Half the width of the middle 90 % of a normal distribution, standard deviations."""

MOTION = np.dtype([("attitude", ATTITUDE), ("forecast", FORECAST), ("sea", SEA_MOMENTS)])
"""All that is remembered of a boat's roll, pitch and heave."""

MOTION_SETTINGS = np.dtype([("attitude", ATTITUDE_SETTINGS), ("forecast", FORECAST_SETTINGS)])

MOTION_WORK = np.dtype(
    [
        ("forecast", FORECAST_WORK),
        ("velocity", "f8", 3),
        ("ahead", "f8", (1 + len(HORIZONS), 2)),
        ("mean", "f8", (1 + len(HORIZONS), N_CHANNELS)),
        ("var", "f8", (1 + len(HORIZONS), N_CHANNELS)),
        ("quiet", "f8", len(QUIET_SPANS)),
    ]
)
"""Scratch; one serves many boats."""

REPORT_AFTER_S = 1.0
NOTE_AFTER_S = 3.0
"""Silence of a channel from which on it is reported now, and noted of the run."""

_SILENT = "{} has been silent or unchanged for {:.1f} s; the others bridge it"

_REFUSED_MIN = 10.0

VERIFIED_MIN = 5
"""Verified forecasts from which on intervals and probabilities say something."""

_ROWS = field_at(MOTION, "attitude") + field_at(ATTITUDE, "rows")

_AXES = (*MOTION_CHANNELS, *SENSOR_CHANNELS[ACCEL_X : ACCEL_Y + 1])


def _places(channels: str, planar: str) -> list[int]:
    """Return the places in memory of a field of each of the axes."""
    begin = field_at(MOTION, "attitude")
    first = begin + field_at(ATTITUDE, channels)
    accel = begin + field_at(ATTITUDE, planar) + 1
    return [*range(first, first + len(MOTION_CHANNELS)), accel, accel + 1]


_AGES = _places("ages", "planar_ages")
_LAST = _places("last", "planar")

_SUSPECT_AT = field_at(MOTION, "attitude") + field_at(ATTITUDE, "doubted")

_TILT_SENSORS = tuple(
    (MOTION_CHANNELS[k], MOTION_CHANNELS[AHRS_ROLL - MOTION_AT + k]) for k in range(2)
)
"""The gyro and the angle of the AHRS of roll and of pitch."""


def initial_motion() -> Array:
    """Return the memory of a boat before its first row: :data:`MOTION` as flat float64."""
    sea = np.zeros(record_size(SEA_MOMENTS))
    return np.concatenate([initial_attitude(), initial_forecast(), sea])


def motion_settings(particulars: Particulars) -> Array:
    """Return :data:`MOTION_SETTINGS` of a boat as flat float64."""
    return np.concatenate([attitude_settings(particulars), forecast_settings(particulars)])


@kernel
def take_row(t, dt, z, state, ready, memory, given, work):
    """Take a row, and turn its measurements into those of an upright boat.

    Parameters
    ----------
    t, dt : float
        Time, and time since the row before, s.
    z : ndarray, shape (19,)
        In the order of ``twin.channels.MEASUREMENTS``; written to.
    state : ndarray, shape (6,)
        What the twin said of the boat after the row before.
    ready : bool
        Whether that means anything.
    memory, given, work : record
        ``MOTION``, ``MOTION_SETTINGS`` and ``MOTION_WORK``.
    """
    velocity = work.velocity
    for k in range(3):
        velocity[k] = state[U + k] if ready else math.nan
    heading = state[PSI] if ready else math.nan
    take_attitude(t, dt, z, velocity, memory.attitude, given.attitude)
    take_motion(t, velocity, memory.attitude, memory.forecast, given.forecast, work.forecast)
    take_sea(dt, heading, velocity, memory.attitude, memory.sea)
    turn_upright(heading, memory.attitude, given.attitude, z)


@kernel
def accelerations_ahead(times, states, start, ahead):
    """Write the accelerations of a forecast to starboard and forward, in units of gravity.

    Parameters
    ----------
    times : ndarray, shape (K,)
        Times of the forecast states after now, s, rising.
    states : ndarray, shape (K, 6)
        In the order of ``twin.channels.STATE``.
    start : ndarray, shape (6,)
        State now.
    ahead : ndarray, shape (1 + 21, 2)
        Written: now and at ``HORIZONS``.
    """
    k = 0
    for h in range(ahead.shape[0]):
        at = HORIZONS[h - 1] if h > 0 else 0.0
        while k < times.shape[0] - 1 and times[k] < at - 1e-9:
            k += 1
        t1, t0 = times[k], times[k - 1] if k > 0 else 0.0
        share = min(max((at - t0) / (t1 - t0), 0.0), 1.0)
        u0, r0 = (states[k - 1, U], states[k - 1, R]) if k > 0 else (start[U], start[R])
        u, r = u0 + share * (states[k, U] - u0), r0 + share * (states[k, R] - r0)
        ahead[h, 0] = u * r / GRAVITY
        ahead[h, 1] = (states[k, U] - u0) / (t1 - t0) / GRAVITY


@kernel
def _forecast(times, states, start, memory, given, work):
    """Write means, variances and probabilities to the scratch."""
    own, of, scratch = (
        as_record(memory, MOTION),
        as_record(given, MOTION_SETTINGS),
        as_record(work, MOTION_WORK),
    )
    mean, var = scratch.mean, scratch.var
    accelerations_ahead(times, states, start, scratch.ahead)
    forecast_motion(
        scratch.ahead, own.attitude, own.forecast, of.forecast, scratch.forecast, mean, var
    )
    quiet_probabilities(mean, var, own.forecast, of.forecast, scratch.quiet)


@kernel
def _errors(memory, given, out):
    """Write the variances of the estimates of the channels."""
    own, of = as_record(memory, MOTION), as_record(given, MOTION_SETTINGS)
    for c in range(N_CHANNELS):
        leak = leak_variance(c, own.attitude, own.forecast)
        out[c] = error_now(c, own.attitude, of.forecast) + leak


@dataclass(frozen=True)
class MotionEstimate:
    """Attitude and vertical motion of a boat at its last row.

    Parameters
    ----------
    t : float
        Time, s.
    roll, pitch : float
        rad; above 0: starboard side down, bow up.
    roll_rate, pitch_rate : float
        Body rates, rad/s.
    heave, vertical_speed : float
        Of the origin, m and m/s, down; heave is counted from its mean.
    deck_speed : float
        Vertical speed of the deck point of the particulars, m/s, down.
    sd : ndarray, shape (4,)
        Standard deviations of roll, pitch, heave and deck speed.
    """

    t: float
    roll: float
    pitch: float
    roll_rate: float
    pitch_rate: float
    heave: float
    vertical_speed: float
    deck_speed: float
    sd: Array

    @property
    def mean(self) -> Array:
        """Roll, pitch, heave and deck speed, shape (4,), beside ``sd``."""
        return np.array([self.roll, self.pitch, self.heave, self.deck_speed])


@dataclass(frozen=True)
class MotionForecast:
    """Forecast of roll, pitch, heave and the vertical speed of the deck point.

    Parameters
    ----------
    t0 : float
        Time at which it was made, s.
    t : ndarray, shape (22,)
        Times of the rows, s: now, and then ``twin.motion.HORIZONS`` ahead.
    mean, sd : ndarray, shape (22, 4)
        In the order of ``twin.motion.CHANNELS``.
    quiet : ndarray, shape (3,)
        Probabilities that roll, pitch and deck speed stay within the limits of the particulars for
        the next 2, 3 and 5 s.
    ready : bool
        Whether past forecasts have been compared with what came. Before, about a minute after the
        start, means and probabilities say little.
    """

    t0: float
    t: Array
    mean: Array
    sd: Array
    quiet: Array
    ready: bool = True

    @property
    def known_quiet(self) -> Array:
        """The probabilities of ``quiet``, NaN before they are ``ready``: for files and feeds."""
        return self.quiet if self.ready else np.full_like(self.quiet, math.nan)

    @property
    def low(self) -> Array:
        """5 % points, shape (22, 4)."""
        return self.mean - Z90 * self.sd

    @property
    def high(self) -> Array:
        """95 % points, shape (22, 4)."""
        return self.mean + Z90 * self.sd

    def at(self, horizons: ArrayLike) -> tuple[Array, Array]:
        """Return means and standard deviations, each (h, 4), at times after t0 (h,), s.

        Between the rows they are interpolated; after the last one they stay.
        """
        from scipy.interpolate import CubicSpline  # takes as long as all other imports of twin

        after = self.t - self.t0
        times = np.clip(np.asarray(horizons, dtype=np.float64), 0.0, after[-1])
        sd = np.stack([np.interp(times, after, column) for column in self.sd.T], axis=1)
        return CubicSpline(after, self.mean)(times), sd

    def columns(self, t: Array) -> dict[str, Array]:
        """Return columns by name at times (N,): means, then ``sd_``, ``low_`` and ``high_``.

        Then those of :attr:`known_quiet`, from ``t0`` on and so the same in every row.
        """
        mean, sd = self.at(t - self.t0)
        parts = {"": mean, "sd_": sd, "low_": mean - Z90 * sd, "high_": mean + Z90 * sd}
        moments = {
            f"{kind}{name}": part[:, k]
            for kind, part in parts.items()
            for k, name in enumerate(CHANNELS)
        }
        quiet = zip(QUIET_SPANS, self.known_quiet.tolist(), strict=True)
        return moments | {f"quiet_{span:g}s": np.full(len(t), chance) for span, chance in quiet}


class DeckMotion:
    """Estimates and forecasts roll, pitch and heave of a boat, row by row.

    Parameters
    ----------
    particulars : Particulars
        The boat, its instruments and its deck.

    Attributes
    ----------
    settings : ndarray
        :data:`MOTION_SETTINGS` of the boat.
    memory, scratch : ndarray
        All that is remembered, in the layout of :data:`MOTION`, and :data:`MOTION_WORK`. They are
        made when they are first needed: most logs do not show such motion.
    """

    def __init__(self, particulars: Particulars) -> None:
        self.settings = motion_settings(particulars)
        self._memory: Array | None = None
        self._scratch: Array | None = None

    @property
    def memory(self) -> Array:
        """See the class."""
        if self._memory is None:
            self._memory = initial_motion()
        return self._memory

    @property
    def scratch(self) -> Array:
        """See the class."""
        if self._scratch is None:
            self._scratch = np.zeros(record_size(MOTION_WORK))
        return self._scratch

    def remember(self, memory: Array) -> None:
        """Remember in this memory from now on; see :attr:`memory`."""
        self._memory = memory

    @property
    def record(self) -> Any:
        """The memory by name: a view."""
        return self.memory.view(MOTION)[0]

    def reset(self) -> None:
        """Forget everything."""
        if self._memory is not None:
            self._memory[:] = initial_motion()

    @property
    def active(self) -> bool:
        """Whether a row had a sample of one of ``usv_kernel.channels.MOTION_CHANNELS``."""
        return self._memory is not None and bool(self._memory[_ROWS] > 0.0)

    def estimate(self) -> MotionEstimate | None:
        """Return attitude and vertical motion at the last row; None where nothing measures them."""
        if not self.active:
            return None
        now, memory = self.record["attitude"], self.record["forecast"]
        (roll, pitch), vertical = now["tilt"][:, ANGLE].tolist(), now["vertical"]
        variance = np.empty(N_CHANNELS)
        _errors(self.memory, self.settings, variance)
        return MotionEstimate(
            t=float(memory["t_before"]),
            roll=roll,
            pitch=pitch,
            roll_rate=float(now["rate"][0]),
            pitch_rate=float(now["rate"][1]),
            heave=float(vertical[HEAVE]),
            vertical_speed=float(vertical[CLIMB]),
            deck_speed=float(memory["before"][-1]),
            sd=np.sqrt(np.maximum(variance, 0.0)),
        )

    def forecast(self, times: Array, states: Array, start: Array) -> MotionForecast | None:
        """Return the forecast; None where nothing measures roll, pitch and heave.

        Parameters
        ----------
        times : ndarray, shape (K,)
            Times after now of the forecast states, s.
        states : ndarray, shape (K, 6)
            The twin's forecast of the horizontal motion: the boat heels when it turns.
        start : ndarray, shape (6,)
            Its state now.
        """
        if not self.active:
            return None
        times, states, start = map(np.ascontiguousarray, (times, states, start))
        _forecast(times, states, start, self.memory, self.settings, self.scratch)
        t0 = float(self.record["forecast"]["t_before"])
        work = self.scratch.view(MOTION_WORK)[0]
        return MotionForecast(
            t0=t0,
            t=t0 + np.concatenate([[0.0], HORIZONS]),
            mean=work["mean"].copy(),
            sd=np.sqrt(np.maximum(work["var"], 0.0)),
            quiet=work["quiet"].copy(),
            ready=bool(self.record["forecast"]["n_errors"] >= VERIFIED_MIN),
        )

    def sea(self) -> SeaEstimate | None:
        """Return the waves as the motion shows them; None where nothing measures it."""
        if not self.active:
            return None
        return estimate_sea(self.memory[field_at(MOTION, "sea") :])

    def troubles(self) -> dict[str, tuple[str, float, str]]:
        """Return status, age (s) and reason, in words, of each motion channel in doubt.

        So it is with the horizontal accelerometers. Channels that never had a sample are not
        named: a boat need not have them.
        """
        found = self._suspected(REPORT_AFTER_S)
        for name, refused in zip(MOTION_CHANNELS, self.record["attitude"]["refused"], strict=True):
            if refused > _REFUSED_MIN:
                why = f"{name} contradicts the other sensors"
                found.setdefault(name, ("doubtful", 0.0, why))
        return found

    def lasting_troubles(self) -> dict[str, tuple[str, float, str]]:
        """Return the same of channels in trouble for longer than :data:`NOTE_AFTER_S`."""
        return self._suspected(NOTE_AFTER_S) if self.active else {}

    def lasting(self) -> tuple[list[int], list[int]]:
        """Return numbers of what :meth:`lasting_troubles` names: this is fast."""
        return self._beyond(NOTE_AFTER_S) if self.active else ([], [])

    def _suspected(self, beyond: float) -> dict[str, tuple[str, float, str]]:
        """Return status, age and reason of channels silent or in doubt for so long, s."""
        found, (silent, doubted) = {}, self._beyond(beyond)
        for k in silent:
            name, age = _AXES[k], self.memory.item(_AGES[k])
            found[name] = "excluded", age, _SILENT.format(name, age)
        for k in doubted:
            name, other = _TILT_SENSORS[k // 2] if k % 2 == 0 else _TILT_SENSORS[k // 2][::-1]
            why, age = f"{name} contradicts {other} and gravity", self.memory.item(_SUSPECT_AT + k)
            found.setdefault(name, ("excluded" if k % 2 else "doubtful", age, why))
        return found

    def _beyond(self, beyond: float) -> tuple[list[int], list[int]]:
        """Return axes without a new sample, and sensors of tilt in doubt, for so long, s."""
        late = [
            k for k, age in enumerate(self.memory[_AGES].tolist()) if beyond < age < NO_SAMPLE_AGE_S
        ]
        doubted = self.memory[_SUSPECT_AT : _SUSPECT_AT + 4].tolist()
        return (
            [k for k in late if math.isfinite(self.memory[_LAST[k]])],
            [k for k, age in enumerate(doubted) if age > beyond],
        )

    def views(self) -> dict[str, Array]:
        """Return what is remembered, by field."""
        found: dict[str, Array] = {}
        for part, kind in (("attitude", ATTITUDE), ("forecast", FORECAST), ("sea", SEA_MOMENTS)):
            begin = field_at(MOTION, part)
            piece = self.memory[begin : begin + record_size(kind)]
            found |= {f"{part}.{name}": view for name, view in record_views(piece, kind).items()}
        return found

    def state_dict(self) -> State:
        """Return all that is remembered, as fields by name; nothing before the first sample."""
        return {name: view.copy() for name, view in self.views().items()} if self.active else {}

    def load_state_dict(self, state: State) -> None:
        """Take over what :meth:`state_dict` returned.

        Raises
        ------
        StateError
            Names the field that is missing or damaged.
        """
        if not state:
            self.reset()
            return
        check_fields(state, self.views())
        fill(self.views(), state)
