"""What the sensors and commands of a log say of each other: one likelihood for all comparisons.

All sensors are brought to an even grid. A comparison gives two signals that are equal where sensors
and commands are sound: the way of the fixes and the integrated velocity, turns of compass and gyro,
the velocity over ground and that along the heading, its changes and the integrated accelerometers
turned into the earth's axes, changes of yaw rate and speed and what the commands make of them. The
squares that are left between them, over those of both, are ``rho``: 0 for equal signals, about 1
for strangers, 2 for opposite ones. With n independent samples, the log-likelihood is
``-n/2 log rho``, whatever the units, so those of several comparisons add up.

Sources: Fossen 2021, Sec. 14.2 (strapdown equations); Bayley and Hammersley 1946 (effective number
of correlated samples); Huber 1964 (bounded influence).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.optimize import nnls

from twin.logs.recording import Recording
from twin.logs.signals import ENOUGH, averaged, integrated, ways
from twin.particulars import GRAVITY, Instruments
from usv_kernel.scalar import rotation

__all__ = [
    "BY_COMMANDS",
    "Comparison",
    "Signals",
    "compare",
    "gain",
    "log_likelihood",
    "signals_of",
    "touched",
]

Array = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex128]

STEP_S, POINTS = 0.1, 20_000
"""Step of the grid, s, and its most points: of longer logs it is coarser."""

FLOOR = 0.002
"""No two sensors agree better: squares that are left over the squares of both."""

BIAS = 0.01
"""A gyro's zero is off by less, rad/s."""

CURRENT, DRIFT = 0.3, 0.5
"""A current is about this share of the speed; in its quickest turns a hull drifts by this, rad."""

SLOW_S = 6.0
"""Motion that is slower is heel, trim, drift of sensors and current, s."""

WEIGHED_S = 5.0
"""Gravity is the mean over so long."""

TILT = math.radians(2.0), math.radians(1.0)
"""A boat heels and trims by about the first in the mean, rad; an AHRS is off by the second."""

ARC, SLOW = 1.5, 0.2
"""Over a larger turn a way tells no direction, rad; nor below this share of the largest speed."""

HORIZONS_S = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0)
"""Times over which a command changes the motion, s; the one that explains most counts."""

ANSWERS, ANSWERS_BOTH = 0.4, 0.15
"""A command of which heading and yaw rate explain this share, and each a part of its standard
deviation, holds a course: it answers the waves."""


@dataclass(frozen=True, eq=False)
class Signals:
    """Sensors and commands of a log at even steps; NaN where there is nothing.

    Positions, velocities and horizontal forces are complex: north and east, ahead and starboard.
    """

    t: Array
    fix: Complex
    velocity: Complex
    heading: Array
    raw_heading: Array  # as the file has it, the nearest sample
    gyros: Array  # (N, 3)
    forces: Array  # (N, 3)
    angles: Array  # (N, 2) roll and pitch of an AHRS
    height: Array
    climb: Array
    shafts: Array  # (N, 2)
    steering: Array  # (N, 2)
    intervals: dict[str, float]  # between samples, s
    way_s: float = 2.0  # over which the way of the fixes is several times their noise
    horizon_s: float = 0.0  # over which commands explain the turning best; 0: not at all
    latency: float = 0.0  # of the GPS, which is taken out, s
    whole: bool = False  # rows of a log: delays are whole steps

    @property
    def step(self) -> float:
        """Of the grid, s."""
        return float(np.median(np.diff(self.t[:1000]))) if self.whole else self.t[1] - self.t[0]

    def has(self, *names: str) -> bool:
        """Return whether signals are there, enough to compare."""
        sides = (getattr(self, name).reshape(len(self.t), -1)[:, -1] for name in names)
        return all(len(side) - np.count_nonzero(np.isnan(side)) > 5 * ENOUGH for side in sides)

    def late(self, seconds: float, *names: str) -> Signals:
        """Return them with signals as if taken so many seconds later: what undoes a delay."""
        changed = {}
        for name in names:
            values = getattr(self, name)
            if self.whole:
                steps = round(seconds / self.step)
                changed[name] = np.roll(values, -steps, axis=0)
                continue
            flat = values.reshape(len(values), -1)
            at = self.t + seconds
            parts = [np.interp(at, self.t, column) for column in flat.T]
            moved = np.column_stack(parts).reshape(values.shape)
            moved[(at < self.t[0]) | (at > self.t[-1])] = np.nan
            changed[name] = moved
        return dataclasses.replace(self, **changed)


_COLUMNS = {
    "fix": ("gps_x_m", "gps_y_m"),
    "velocity": ("gps_vx_mps", "gps_vy_mps"),
    "heading": ("compass_rad",),
    "yaw": ("gyro_radps",),
    "tilting": ("gyro_x_radps", "gyro_y_radps"),
    "push": ("accel_x_mps2", "accel_y_mps2"),
    "lift": ("accel_z_mps2",),
    "angles": ("ahrs_roll_rad", "ahrs_pitch_rad"),
    "height": ("gps_z_m",),
    "climb": ("gps_vz_mps",),
}


def signals_of(recording: Recording, instruments: Instruments | None = None) -> Signals | None:
    """Return the signals of a recording; None where there are too few rows.

    Parameters
    ----------
    recording : Recording
        The log.
    instruments : Instruments, optional
        Their stated latency and mounting are taken out.
    """
    if len(recording.t) < 3 * ENOUGH:
        return None
    samples = {name: recording.samples(*columns) for name, columns in _COLUMNS.items()}
    rows = float(np.median(np.diff(recording.t)))
    intervals = {
        name: float(np.median(np.diff(t))) for name, (t, _) in samples.items() if len(t) > ENOUGH
    }
    span = float(recording.t[-1] - recording.t[0])
    step = max(STEP_S, rows, span / POINTS)
    grid = np.arange(recording.t[0], recording.t[-1], step)
    if len(grid) < 3 * ENOUGH:
        return None
    even: dict[str, Array] = {}
    for name, (t, given) in samples.items():
        values = np.unwrap(given, axis=0) if name == "heading" else given
        if len(t) > ENOUGH:
            even[name] = averaged(t, values, grid, step)
        else:
            even[name] = np.full((len(grid), values.shape[1]), np.nan)
    cmd = np.nan_to_num(recording.cmd)
    held = cmd[(np.searchsorted(recording.t, grid, "right") - 1).clip(0)]
    if step > 2.0 * rows:
        means = averaged(recording.t, cmd, grid, step)
        held = np.where(np.isfinite(means), means, held)
    gyros = np.column_stack([even["tilting"], even["yaw"]])
    forces = np.column_stack([even["push"], even["lift"]])
    if not np.isfinite(gyros[:, :2]).any():
        gyros[:, :2] = 0.0
    if not np.isfinite(forces[:, 2]).any():
        forces[:, 2] = -GRAVITY
    stated = instruments or Instruments()
    if stated.imu_mounting != (0.0, 0.0, 0.0):
        turn = np.array(rotation(stated.imu_mounting))
        gyros, forces = gyros @ turn.T, forces @ turn.T
    t_fix, fix = samples["fix"]
    signals = Signals(
        grid,
        _complex(even["fix"]),
        _complex(even["velocity"]),
        even["heading"][:, 0],
        _nearest(*samples["heading"], grid, even["heading"][:, 0]),
        gyros,
        forces,
        even["angles"],
        even["height"][:, 0],
        even["climb"][:, 0],
        held[:, :2],
        held[:, 2:],
        intervals,
        ways(t_fix, fix)[2] if len(t_fix) > ENOUGH else 2.0,
        latency=stated.gps_latency,
    )
    signals = signals.late(stated.gps_latency, "fix", "velocity")
    shares = {horizon: _share(*_turns_by(signals, horizon)) for horizon in HORIZONS_S}
    best = max(shares, key=lambda horizon: shares[horizon])
    return dataclasses.replace(signals, horizon_s=best if shares[best] > 0.0 else 0.0)


def _nearest(t: Array, values: Array, grid: Array, even: Array) -> Array:
    """Return the last samples before times; NaN where the signal at even steps is missing."""
    if not len(t):
        return even
    last = values[(np.searchsorted(t, grid, "right") - 1).clip(0), 0]
    return np.where(np.isfinite(even), last, np.nan)


def _complex(values: Array) -> Complex:
    return np.asarray(values[:, 0] + 1j * values[:, 1])


class Comparison(NamedTuple):
    """What is left between two signals."""

    rho: float
    """Squares that are left, over those of both."""
    independent: float
    """Samples of what is left that are independent, of ..."""
    samples: int
    """... so many."""


def compare(x: npt.NDArray[Any], y: npt.NDArray[Any]) -> Comparison | None:
    """Return how well two signals (n,) agree, by Huber's weights; None where they are too few."""
    ok = np.isfinite(x) & np.isfinite(y)
    if ok.sum() < ENOUGH // 2:
        return None
    x, y = x[ok], y[ok]
    left = np.abs(x - y)
    weight = np.minimum(1.0, 4.0 * float(np.median(left)) / np.maximum(left, 1e-300))
    both = float(weight @ (np.abs(x) ** 2 + np.abs(y) ** 2))
    square = float(weight @ left**2)
    if not 0.0 < both < 1e100:
        return None
    d = np.sqrt(weight) * (x - y)
    # neighbours say the same
    along = float(np.real(np.vdot(d[1:], d[:-1]))) / max(square, 1e-300)
    same = min(max(along, 0.0), 0.95)
    return Comparison(square / both + FLOOR, len(x) * (1.0 - same) / (1.0 + same), len(x))


def gain(before: Comparison | None, after: Comparison | None) -> float:
    """Return by how much the log-likelihood of one comparison grows."""
    if before is None or after is None:
        return 0.0
    count = min((before, after), key=lambda each: each.rho).independent
    return 0.5 * count * math.log(before.rho / after.rho)


# --- the comparisons --------------------------------------------------------------------------


def _mean(values: npt.NDArray[Any], count: int) -> npt.NDArray[Any]:
    """Return means over so many steps around each; NaN where some are missing."""
    lost = np.isnan(values)
    total = np.concatenate([[0.0], np.cumsum(np.where(lost, 0.0, values))])
    missing = np.concatenate([[0], np.cumsum(lost)])
    half, found = count // 2, np.full(len(values), np.nan, dtype=total.dtype)
    if count > len(values):
        return found
    means = (total[count:] - total[:-count]) / count
    means[missing[count:] > missing[:-count]] = np.nan
    found[half : half + len(means)] = means
    return found


def _sum(values: npt.NDArray[Any], step: float) -> npt.NDArray[Any]:
    """Return the integral of signals; NaN where they are missing."""
    lost = np.isnan(values)
    even: npt.NDArray[Any] = np.where(lost, 0.0, values)
    t: Array = np.asarray(step * np.arange(len(values)), np.float64)
    total = np.asarray(integrated(t, even))
    total[lost] = np.nan
    return total


def _changes(values: npt.NDArray[Any], width: int, order: int = 1) -> npt.NDArray[Any]:
    """Return changes of means over half a width from each width to the next."""
    means = _mean(values, max(width // 2, 1))[width // 2 :: width]
    return np.diff(means, n=order)


def _steps(s: Signals, seconds: float) -> int:
    return max(round(seconds / s.step), 2)


def _way_width(s: Signals) -> int:
    return _steps(s, max(s.way_s, 2.0 * s.intervals.get("fix", 0.0)))


def _fixes(s: Signals) -> tuple[Complex, Complex]:
    """Way of the fixes, and of the integrated velocity."""
    width = _way_width(s)
    return _changes(s.fix, width), _changes(_sum(s.velocity, s.step), width)


def _tilt(s: Signals) -> tuple[Array, Array]:
    """Return roll and pitch: of the AHRS, else the fast part of the integrated gyros."""
    if s.has("angles"):
        return s.angles[:, 0], s.angles[:, 1]
    width = _steps(s, SLOW_S)
    total = [_sum(column, s.step) for column in s.gyros[:, :2].T]
    return total[0] - _mean(total[0], width), total[1] - _mean(total[1], width)


def _turning(s: Signals) -> Array:
    """Return the rate of turn of an upright boat by the gyros."""
    if not s.has("angles"):
        return s.gyros[:, 2]
    roll, pitch = s.angles.T
    return (s.gyros[:, 1] * np.sin(roll) + s.gyros[:, 2] * np.cos(roll)) / np.cos(pitch)


def _turns(s: Signals) -> tuple[Array, Array]:
    """Turns of the compass, and of the integrated gyro less its bias."""
    slowest = max(s.intervals.get("heading", 0.0), s.intervals.get("yaw", 0.0))
    width = _steps(s, max(2.0, 6.0 * slowest))
    rate = _sum(_turning(s), s.step)
    x, y = _changes(s.heading, width), _changes(rate, width)
    while len(x) > 8 * ENOUGH and np.nanstd(x) < 4.0 * np.nanstd(np.diff(x, n=3)) / 4.5:
        width *= 2
        x, y = _changes(s.heading, width), _changes(rate, width)
    bound = BIAS * width * s.step
    bias = float(np.nan_to_num(np.nanmedian(y - x))) if np.isfinite(y - x).any() else 0.0
    return x, y - min(max(bias, -bound), bound)


def _along(
    s: Signals, velocity: npt.NDArray[Any], rows: npt.NDArray[Any], width: int
) -> tuple[Complex, Complex]:
    """Return a velocity over ground, and that of a boat which goes as it points and is commanded.

    Its speed ahead is free; in turns it drifts in proportion to the yaw rate; the current is one.
    """
    rows = rows[: len(velocity)]
    velocity = velocity[: len(rows)]
    heading = _mean(s.heading, width)[rows]
    # both sides: a propeller that runs backwards gives less thrust
    thrust = _mean(s.shafts.max(axis=1), width)[rows]
    turned = np.gradient(heading)
    # the way of a boat that turns on the spot tells no direction
    ok = np.isfinite(velocity) & (np.abs(turned) < ARC)
    ok &= np.abs(velocity) > SLOW * np.fmax.reduce(np.abs(velocity), initial=0.0)
    fitted = np.full(len(velocity), np.nan, dtype=np.complex128)
    if ok.sum() < ENOUGH // 2:
        return velocity, fitted
    v, axes = velocity[ok], np.exp(1j * heading[ok])
    sign = np.where(thrust[ok] < 0.0, -1.0, 1.0)
    power = max(float(np.mean(np.abs(v) ** 2)), 1e-300)
    bend = turned[ok] / max(float(np.std(turned[ok])), 1e-9) * math.sqrt(power)
    current, drift = 0.0 + 0.0j, 0.0
    for _ in range(5):
        ahead = axes * np.maximum(sign * ((v - current) * axes.conj()).real, 0.0) * sign
        left = v - ahead - 1j * axes * drift * bend
        more = float(np.mean(np.abs(left - left.mean()) ** 2)) / (CURRENT**2 * power)
        # half of the plane is free: what the speed ahead takes up comes back in the next pass
        current = complex(left.mean()) / (1.0 + more / len(v) * 2.0)
        size = abs(current) / math.sqrt(power)
        current *= min(1.0, 2.0 * CURRENT / max(size, 1e-9))
        side = ((v - current) * axes.conj()).imag
        drift = float(side @ bend) / max(float(bend @ bend), 1e-300)
        drift = min(max(drift, -DRIFT), DRIFT)
    ahead = axes * np.maximum(sign * ((v - current) * axes.conj()).real, 0.0) * sign
    fitted[ok] = current + ahead + 1j * axes * drift * bend
    return velocity, fitted


def _track(s: Signals) -> tuple[Complex, Complex]:
    """Velocity of the fixes, and that along the heading."""
    width = _way_width(s)
    way = _changes(s.fix, width) / (width * s.step)
    return _along(s, way, np.arange(width // 2 * 2, len(s.t), width), width)


def _course(s: Signals) -> tuple[Complex, Complex]:
    """Velocity over ground, and that along the heading."""
    width = _steps(s, max(2.0, 2.0 * s.intervals.get("velocity", 0.0)))
    rows = np.arange(width, len(s.t), width)
    return _along(s, _mean(s.velocity, width)[rows], rows, width)


def _pushes(s: Signals) -> tuple[Complex, Complex]:
    """Changes of the velocity, and the integrated accelerometers in the axes of the earth."""
    roll, pitch = _tilt(s)
    x, y, z = s.forces.T
    down = y * np.sin(roll) + z * np.cos(roll)
    ahead = x * np.cos(pitch) + down * np.sin(pitch)
    aside = y * np.cos(roll) - z * np.sin(roll)
    level = (ahead - np.nanmean(ahead)) + 1j * (aside - np.nanmean(aside))
    speed = _sum(level * np.exp(1j * s.heading), s.step)
    if s.has("velocity"):
        width = _steps(s, max(1.0, 2.0 * s.intervals.get("velocity", 0.0)))
        return _changes(s.velocity, width, 2), _changes(speed, width, 2)
    width = _steps(s, max(2.0, 4.0 * s.intervals.get("fix", 0.0)))
    return _changes(s.fix, width, 3), _changes(_sum(speed, s.step), width, 3)


def _rolling(s: Signals) -> tuple[Array, Array]:
    """Changes of roll, and of the integrated gyro."""
    width = _steps(s, 0.5)
    roll, pitch = s.angles.T
    rate = s.gyros[:, 0] + np.tan(pitch) * (s.gyros[:, 2] * np.cos(roll))
    return _changes(roll, width), _changes(_sum(rate, s.step), width)


def _pitching(s: Signals) -> tuple[Array, Array]:
    """Changes of pitch, and of the integrated gyro."""
    width, roll = _steps(s, 0.5), s.angles[:, 0]
    rate = s.gyros[:, 1] * np.cos(roll) - s.gyros[:, 2] * np.sin(roll)
    return _changes(s.angles[:, 1], width), _changes(_sum(rate, s.step), width)


def _heaving(s: Signals) -> tuple[Array, Array]:
    """Changes of the vertical speed, and of the integrated vertical accelerometer."""
    width = _steps(s, max(0.5, 2.0 * s.intervals.get("climb", 0.0)))
    sunk = s.forces[:, 2] - np.nanmean(s.forces[:, 2])
    return _changes(s.climb, width, 2), _changes(_sum(sunk, s.step), width, 2)


def _rising(s: Signals) -> tuple[Array, Array]:
    """Fast part of the height, and of the integrated vertical speed."""
    width = _steps(s, max(1.0, 2.0 * s.intervals.get("height", 0.0)))
    climb = s.climb
    if not s.has("climb"):
        sunk = s.forces[:, 2] - np.nanmean(s.forces[:, 2])
        total = _sum(sunk, s.step)
        climb = total - _mean(total, _steps(s, SLOW_S))
    return _changes(s.height, width, 2), _changes(_sum(climb, s.step), width, 2)


def _weighing(s: Signals) -> tuple[Array, Array]:
    """Mean specific force, and gravity with the acceleration of turns."""
    if np.nanstd(s.forces[:, 2]) == 0.0:
        return np.zeros(0), np.zeros(0)  # not measured
    width = _steps(s, WEIGHED_S)
    speed = np.abs(s.velocity) if s.has("velocity") else np.zeros(len(s.t))
    around = np.gradient(s.heading, s.step) * speed if s.has("heading") else np.zeros(len(s.t))
    roll, pitch = s.angles.T if s.has("angles") else np.zeros((2, len(s.t)))
    expected = np.column_stack(
        [
            GRAVITY * np.sin(pitch),
            around - GRAVITY * np.sin(roll) * np.cos(pitch),
            -GRAVITY * np.cos(roll) * np.cos(pitch),
        ]
    )
    means = [
        np.concatenate([_mean(column, width)[width // 2 :: width] for column in each.T])
        for each in (s.forces, expected)
    ]
    return means[0], means[1]


def _explained(change: Array, own: list[Array], commands: list[Array]) -> tuple[Array, Array]:
    """Return a change without what the motion itself explains, and what commands make of it.

    More of a command makes more of the motion: no effect is below 0.
    """
    ok = np.isfinite(change)
    for column in (*own, *commands):
        ok &= np.isfinite(column)
    if ok.sum() < ENOUGH:
        return change[:0], change[:0]
    known = np.column_stack([*(column[ok] for column in own), np.ones(int(ok.sum()))])
    made = np.column_stack([column[ok] for column in commands])
    both = np.column_stack([change[ok], made])
    both = both - known @ np.linalg.lstsq(known, both, rcond=1e-9)[0]
    # of commands that hardly change nothing can be told
    size = np.linalg.norm(both[:, 1:], axis=0)
    moves = size > 0.02 * np.linalg.norm(made, axis=0)
    if not moves.any():
        return both[:, 0], np.zeros(len(both))
    made = np.where(moves, both[:, 1:] / np.maximum(size, 1e-300), 0.0)
    return both[:, 0], np.asarray(made @ nnls(made, both[:, 0])[0])


def _turns_by(s: Signals, horizon: float) -> tuple[Array, list[Array], list[Array]]:
    """Return changes of the turn from one time to the next, the turn before, the acts between."""
    force = s.shafts * np.abs(s.shafts)
    total, angle = force.sum(axis=1), s.steering.mean(axis=1)
    acts = [force[:, 0] - force[:, 1]]
    if np.ptp(s.steering) > 0.0:
        if np.std(acts[0]) < 0.02 * np.abs(total).max(initial=0.0):
            del acts[0]
        acts.append(angle * (total if total.any() else np.ones_like(total)))
    half = max(round(0.5 * horizon / s.step), 1)
    rows = np.arange(2 * half, len(s.t) - 3 * half, 2 * half)
    nothing = np.zeros(0)
    if 2 * half * s.step < 3.0 * s.intervals.get("heading", 0.0) or len(rows) < 25:
        return nothing, [nothing], [nothing]
    # mean rates around the two ends; the commands act in between
    before = s.heading[rows + half] - s.heading[rows - half]
    after = s.heading[rows + 3 * half] - s.heading[rows + half]
    return after - before, [before], [_mean(each, 2 * half)[rows + half] for each in acts]


def _yawing(s: Signals) -> tuple[Array, Array]:
    """Changes of the yaw rate by the compass, and what the commands make of it."""
    nothing = np.zeros(0)
    if s.horizon_s == 0.0 or _holds_course(s):
        return nothing, nothing
    change, own, acts = _turns_by(s, s.horizon_s)
    return _explained(change, own, acts) if acts else (nothing, nothing)


def _holds_course(s: Signals) -> bool:
    """Return whether the commands answer the motion: in waves they seem to cause it, then."""
    force = s.shafts * np.abs(s.shafts)
    asked = force[:, 0] - force[:, 1]
    if np.ptp(s.steering) > 0.0:
        asked = s.steering.mean(axis=1)
    rate = np.gradient(_mean(s.heading, _steps(s, 0.5)), s.step)
    motion = np.column_stack([s.heading, rate, np.ones_like(rate)])
    known = np.isfinite(motion).all(axis=1)
    spread = float(np.std(asked[known])) if known.any() else 0.0
    if known.sum() < 5 * ENOUGH or spread == 0.0:
        return False
    fit = np.linalg.lstsq(motion[known], asked[known], rcond=1e-9)[0]
    left = float(np.var(asked[known] - motion[known] @ fit)) / spread**2
    parts = fit[:2] * motion[known, :2].std(axis=0) / spread
    return left < 1.0 - ANSWERS and bool(
        abs(parts).min() > ANSWERS_BOTH and parts[0] * parts[1] > 0
    )


def _share(change: Array, own: list[Array], commands: list[Array]) -> float:
    """Return the share of a change that commands of either sign explain."""
    ok = np.isfinite(change)
    for column in (*own, *commands):
        ok &= np.isfinite(column)
    if ok.sum() < ENOUGH:
        return 0.0
    known = np.column_stack([*(column[ok] for column in own), np.ones(int(ok.sum()))])
    all_of = np.column_stack([known, *(column[ok] for column in commands)])
    left = [
        float(np.sum((change[ok] - A @ np.linalg.lstsq(A, change[ok], rcond=1e-9)[0]) ** 2))
        for A in (known, all_of)
    ]
    return 1.0 - left[1] / max(left[0], 1e-300)


def _surging(s: Signals) -> tuple[Array, Array]:
    """Changes of the speed ahead by the fixes, and what the thrust makes of it."""
    width = _way_width(s)
    way = _changes(s.fix, width) / (width * s.step)
    rows = np.arange(width // 2 * 2, len(s.t), width)[: len(way)]
    heading = _mean(s.heading, width)[rows]
    ahead = (way[: len(rows)] * np.exp(-1j * heading)).real
    if len(heading) > 1:
        ahead[np.abs(np.gradient(heading)) > ARC] = np.nan
    force = s.shafts * np.abs(s.shafts)
    middle = (
        _mean(force.sum(axis=1), width)[rows[0] + width // 2 :: width]
        if len(rows)
        else force[:0, 0]
    )
    count = min(len(ahead) - 1, len(middle))
    if count < ENOUGH or np.nanstd(middle) < 0.1 * np.abs(force.sum(axis=1)).max(initial=0.0):
        return np.zeros(0), np.zeros(0)
    now = ahead[:count]
    turned = np.diff(heading)[:count]
    change = ahead[1 : count + 1] - now
    return _explained(change, [now, now * np.abs(now), turned**2], [middle[:count]])


COMPARISONS: dict[str, tuple[tuple[str, ...], Callable[[Signals], tuple[Array, Array]]]] = {
    "fixes and velocity": (("fix", "velocity"), _fixes),  # type: ignore[dict-item]
    "turns of compass and gyro": (("heading", "gyros"), _turns),
    "track and compass": (("fix", "heading"), _track),  # type: ignore[dict-item]
    "course and compass": (("velocity", "heading"), _course),  # type: ignore[dict-item]
    "velocity and accelerometers": (("heading", "forces"), _pushes),  # type: ignore[dict-item]
    "roll of AHRS and gyro": (("angles", "gyros"), _rolling),
    "pitch of AHRS and gyro": (("angles", "gyros"), _pitching),
    "vertical speed and accelerometer": (("climb", "forces"), _heaving),
    "height and vertical speed": (("height", "forces"), _rising),
    "gravity and accelerometers": (("forces",), _weighing),
    "turns and commands": (("heading",), _yawing),
    "speed and thrust": (("fix", "heading"), _surging),
}
"""Signals that each needs, and what gives its two sides."""

BY_COMMANDS = ("turns and commands", "speed and thrust")
"""Comparisons with a model of the boat, which is rough."""

ALSO = {
    "turns of compass and gyro": ("angles",),
    "track and compass": ("shafts",),
    "course and compass": ("shafts",),
    "velocity and accelerometers": ("velocity", "fix", "gyros", "angles"),
    "gravity and accelerometers": ("heading", "velocity", "angles"),
    "height and vertical speed": ("climb",),
    "turns and commands": ("shafts", "steering"),
    "speed and thrust": ("shafts",),
}
"""What else changes them."""


def touched(name: str, changed: Collection[str]) -> bool:
    """Return whether a comparison uses one of some signals."""
    return not {*COMPARISONS[name][0], *ALSO.get(name, ())}.isdisjoint(changed)


Evidence = dict[str, Comparison | None]


def log_likelihood(
    s: Signals, changed: Collection[str] | None = None, before: Evidence | None = None
) -> Evidence:
    """Return all comparisons of signals.

    Parameters
    ----------
    s : Signals
        To be compared.
    changed : collection of str, optional
        Signals that differ from those of ``before``; only their comparisons are made anew.
    before : dict, optional
        Comparisons of the others.
    """
    found: Evidence = {}
    for name, (needs, pair) in COMPARISONS.items():
        if changed is not None and before is not None and not touched(name, changed):
            found[name] = before[name]
            continue
        with np.errstate(all="ignore"):
            one = compare(*pair(s)) if s.has(*needs) else None
        if name == "gravity and accelerometers" and one is not None:
            # boats heel and trim, all along, where no AHRS shows it: each window counts
            tilt = TILT[1] if s.has("angles") else TILT[0]
            windows = len(s.t) // _steps(s, WEIGHED_S)
            one = Comparison(one.rho - FLOOR + tilt**2, windows, windows)
        found[name] = one
    return found
