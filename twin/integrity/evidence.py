"""What the sensors and commands of a log say of each other: one likelihood for all comparisons.

All sensors are brought to an even grid. A comparison gives two signals that are equal where sensors
and commands are sound: positions and integrated velocity, angles and integrated gyros, velocity and
integrated accelerometers in the earth's axes, the velocity over ground and that along the heading,
changes of yaw rate and speed and what the commands make of them. The squares that are left between
them, over those of both, are ``rho``: 0 for equal signals, about 1 for strangers, 2 for opposite
ones. With n independent samples, the log-likelihood is ``-n/2 log rho``, whatever the units, so
those of several comparisons add up.

Sources: Fossen 2021, Sec. 14.2 (strapdown equations); Bayley and Hammersley 1946 (effective number
of correlated samples); Huber 1964 (bounded influence).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from twin.channels import COMMANDS, MEASUREMENTS
from twin.integrity.rows import ANGLES, FIX, FORCES, GYROS, SAMPLES_MIN, SENSORS, SIZE_MAX, VELOCITY
from twin.logs.clock import GAP_STEPS
from twin.logs.recording import Recording
from twin.logs.signals import ENOUGH, averaged, integrated, ways
from twin.particulars import GRAVITY, Instruments
from usv_kernel.scalar import rotation

__all__ = [
    "BY_COMMANDS",
    "GYRO_ZERO_RADPS",
    "RAW_HEADING",
    "RHO_MIN",
    "Comparison",
    "Evidence",
    "Signals",
    "angle_rate",
    "gain",
    "level_forces",
    "log_likelihood",
    "signals_of",
]

Array = npt.NDArray[np.float64]
Pair = tuple[npt.NDArray[Any], npt.NDArray[Any]]

GRID_S = 0.1
GRID_POINTS = 20_000
"""Step of the grid, s, and its most points: of longer logs it is coarser."""

RHO_MIN = 0.002
"""Least rho, the sum of squared differences of two signals over the sum of their squares."""

GYRO_ZERO_RADPS = 0.01
"""Largest bias of a gyro."""

SLIP_MAX = 0.5
"""Largest current as a share of the speed, and largest drift angle in quick turns, rad."""

SLOW_S = 6.0
"""Period above which signals hold heel, trim, current and drift of sensors."""

TILT_RAD = math.radians(2.0)
"""Typical mean heel and trim of a boat without AHRS."""

EXCITATION_SHARE_MIN = 0.02
"""Least change of a command, as a share of its size, that excites the boat."""

ARC_RAD = 1.5
SLOW_SHARE = 0.2
"""Largest turn, and least share of the largest speed, at which a displacement has a direction."""

HORIZONS_S = tuple(2.0**k for k in range(6))
"""Response times of the boat that are tried; that of the highest likelihood counts."""

RAW_HEADING = "compass_raw"
"""A column beside those of a log: the heading as the file has it, never unwrapped or averaged."""


@dataclass(frozen=True, eq=False)
class Signals:
    """Columns of a log at common times; NaN where there is nothing."""

    t: Array
    columns: Mapping[str, Array]
    intervals: Mapping[str, float] = field(default_factory=dict)  # between samples of a column, s
    way_s: float = 2.0  # over which the way of the fixes is several times their noise
    latency: float = 0.0  # of the GPS, which is taken out, s

    def __getitem__(self, name: str) -> Array:
        return self.columns[name]

    @property
    def step(self) -> float:
        """Of the grid, s."""
        return float(self.t[1] - self.t[0])

    def has(self, *names: str) -> bool:
        """Return whether columns are there, with enough samples to compare."""
        return all(np.isfinite(self[name]).sum() >= SAMPLES_MIN for name in names)

    def stacked(self, *names: str) -> Array:
        """Return columns, shape (k, N)."""
        return np.array([self[name] for name in names])

    def level(self, pair: tuple[str, str]) -> npt.NDArray[np.complex128]:
        """Return two columns as one complex number: north and east, ahead and starboard."""
        return self[pair[0]] + 1j * self[pair[1]]

    def having(self, names: tuple[str, ...], values: Array) -> Signals:
        """Return signals with other values (k, N) of some columns."""
        changed = dict(zip(names, values, strict=True))
        return dataclasses.replace(self, columns={**self.columns, **changed})

    def width(self, least: float, samples: float, *names: str) -> int:
        """Return a width in steps: of a time (s), or of samples of the slowest of some columns."""
        slowest = max(self.intervals.get(name, 0.0) for name in names)
        return max(round(max(least, samples * slowest) / self.step), 2)


def signals_of(recording: Recording, instruments: Instruments | None = None) -> Signals | None:
    """Return the signals of a recording; None where there are too few rows.

    Parameters
    ----------
    recording : Recording
        The log.
    instruments : Instruments, optional
        Their stated latency and mounting are taken out.
    """
    if len(recording.t) < SAMPLES_MIN:
        return None
    steps = np.diff(recording.t)
    rows, longest = float(np.median(steps)), 2.0 * HORIZONS_S[-1]
    if (steps > max(longest, GAP_STEPS * rows)).any():  # nothing is compared across them
        steps = np.minimum(steps, max(longest, GAP_STEPS * rows))
        recording = dataclasses.replace(recording, t=np.append(0.0, np.cumsum(steps)))
    t = recording.t
    stated = instruments or Instruments()
    step = max(GRID_S, rows, float(t[-1] - t[0]) / GRID_POINTS)
    grid = np.arange(t[0], t[-1], step)
    if len(grid) < SAMPLES_MIN:
        return None
    last = (np.searchsorted(t, grid, "right") - 1).clip(0)
    columns, intervals = dict[str, Array](), dict[str, float]()
    way_s = 2.0
    for j, name in enumerate(COMMANDS):
        given = np.nan_to_num(recording.cmd[:, j])
        means = averaged(t, given, grid, step) if step > 2.0 * rows else given[last]
        columns[name] = np.where(np.isfinite(means), means, given[last])
    for name in MEASUREMENTS:
        columns[name] = np.full(len(grid), math.nan)
    columns[RAW_HEADING] = columns["compass_rad"]
    for names in SENSORS.values():
        at, values = recording.samples(*names)
        if len(at) <= ENOUGH:
            continue
        intervals |= dict.fromkeys(names, float(np.median(np.diff(at))))
        late = stated.gps_latency if names in (FIX, VELOCITY) else 0.0
        if names == ("compass_rad",):
            raw = values[(np.searchsorted(at, grid, "right") - 1).clip(0), 0]
            values = np.unwrap(values, axis=0)
        even = averaged(at - late, values, grid, step)
        columns |= dict(zip(names, even.T, strict=True))
        if names == ("compass_rad",):
            columns[RAW_HEADING] = np.where(np.isfinite(even[:, 0]), raw, math.nan)
        if names == FIX:
            way_s = ways(at, values)[2]
    s = Signals(grid, columns, intervals, way_s, latency=stated.gps_latency)
    if stated.imu_mounting == (0.0, 0.0, 0.0):
        return s
    # upright where axes are missing
    turn, gyros, forces = (
        np.array(rotation(stated.imu_mounting)),
        s.stacked(*GYROS),
        s.stacked(*FORCES),
    )
    if not s.has(*GYROS[:2]):
        gyros[:2] = 0.0
    if not s.has(FORCES[2]):
        forces[2] = -GRAVITY
    return s.having((*GYROS, *FORCES), np.concatenate([turn @ gyros, turn @ forces]))


class Comparison(NamedTuple):
    """What is left between two signals."""

    rho: float
    """Squares that are left, over those of both."""
    independent: float
    """Samples of what is left that are independent, of ..."""
    samples: int
    """... number of samples."""
    uses: frozenset[str] = frozenset()
    """Columns that it was made of."""


def _compare(x: npt.NDArray[Any], y: npt.NDArray[Any], uses: frozenset[str]) -> Comparison | None:
    """Return how well two signals (n,) agree, by Huber's weights; None where they are too few."""
    ok = np.isfinite(x) & np.isfinite(y)
    if ok.sum() < ENOUGH // 2:
        return None
    x, y = x[ok], y[ok]
    left = np.abs(x - y)
    weight = np.minimum(1.0, 4.0 * float(np.median(left)) / np.maximum(left, 1e-300))
    both = float(weight @ (np.abs(x) ** 2 + np.abs(y) ** 2))
    square = float(weight @ left**2)
    if not 0.0 < both < SIZE_MAX:
        return None
    d = np.sqrt(weight) * (x - y)
    # neighbours say the same
    along = float(np.real(np.vdot(d[1:], d[:-1]))) / max(square, 1e-300)
    same = min(max(along, 0.0), 0.95)
    return Comparison(square / both + RHO_MIN, len(x) * (1.0 - same) / (1.0 + same), len(x), uses)


def gain(before: Comparison | None, after: Comparison | None) -> float:
    """Return by how much the log-likelihood of one comparison grows."""
    if before is None or after is None:
        return 0.0
    count = min((before, after), key=lambda each: each.rho).independent
    return 0.5 * count * math.log(before.rho / after.rho)


# --- the comparisons --------------------------------------------------------------------------


def _mean(
    values: npt.NDArray[Any], count: int, at: slice | npt.NDArray[np.intp] = slice(None)
) -> npt.NDArray[Any]:
    """Return centred means over ``count`` steps, at some or all; NaN where some are missing."""
    lost = np.isnan(values)
    total = np.concatenate(
        [[0.0], np.cumsum(np.where(lost, 0.0, values) if lost.any() else values)]
    )
    first = np.arange(len(values))[at] - count // 2
    whole = (first >= 0) & (first + count <= len(values))
    if lost.any():
        missing = np.concatenate([[0], np.cumsum(lost)])
        whole[whole] = missing[first[whole] + count] == missing[first[whole]]
    found = np.full(len(first), np.nan, dtype=total.dtype)
    found[whole] = (total[first[whole] + count] - total[first[whole]]) / count
    return found


def _sum(values: npt.NDArray[Any], step: float) -> npt.NDArray[Any]:
    """Return the integral of signals over time; NaN where they are missing."""
    lost = np.isnan(values)
    t: Array = np.asarray(step * np.arange(len(values)), np.float64)
    total = np.asarray(integrated(t, np.where(lost, 0.0, values)))
    total[lost] = np.nan
    return total


def _changes(values: npt.NDArray[Any], width: int, order: int = 1) -> npt.NDArray[Any]:
    """Return changes of means over half a width from each width to the next."""
    means = _mean(values, max(width // 2, 1), slice(width // 2, None, width))
    return np.diff(means, n=order)


def _tilt(s: Signals) -> tuple[Array, Array]:
    """Return roll and pitch: of the AHRS, else the fast part of the integrated gyros, else 0."""
    if s.has(*ANGLES):
        return s[ANGLES[0]], s[ANGLES[1]]
    if not s.has(*GYROS[:2]):
        return np.zeros(len(s.t)), np.zeros(len(s.t))
    total = [_sum(s[name], s.step) for name in GYROS[:2]]
    slow = s.width(SLOW_S, 0.0, *GYROS)
    return total[0] - _mean(total[0], slow), total[1] - _mean(total[1], slow)


def angle_rate(axis: int, roll: Array, pitch: Array, gyros: Array) -> Array:
    """Return the rate of roll, pitch or heading (axis 0, 1 or 2) that gyros (3, N) measure."""
    if axis == 1:
        return np.asarray(gyros[1] * np.cos(roll) - gyros[2] * np.sin(roll))
    turn = gyros[1] * np.sin(roll) + gyros[2] * np.cos(roll)
    return np.asarray(gyros[0] + np.tan(pitch) * turn if axis == 0 else turn / np.cos(pitch))


def level_forces(roll: Array, pitch: Array, forces: Array) -> tuple[Array, Array]:
    """Return the level parts, ahead and to starboard, of specific forces (3, N)."""
    down = forces[1] * np.sin(roll) + forces[2] * np.cos(roll)
    aside = forces[1] * np.cos(roll) - forces[2] * np.sin(roll)
    return forces[0] * np.cos(pitch) + down * np.sin(pitch), aside


def _angle_and_gyro(s: Signals, name: str, axis: int, least_s: float) -> Pair:
    """Changes of an angle, and of the integrated gyro less its bias."""
    width = s.width(least_s, 6.0, name, GYROS[axis])
    turn = s[GYROS[axis]]
    if s.has(*ANGLES, *GYROS):
        turn = angle_rate(axis, s[ANGLES[0]], s[ANGLES[1]], s.stacked(*GYROS))
    angle, rate = s[name], _sum(turn, s.step)
    x = _changes(angle, width)
    # as long as noise is a part of it
    while len(x) > 2 * SAMPLES_MIN and np.nanstd(x) < np.nanstd(np.diff(x, n=3)):
        width *= 2
        x = _changes(angle, width)
    y = _changes(rate, width)
    bound = GYRO_ZERO_RADPS * width * s.step
    bias = float(np.nan_to_num(np.nanmedian(y - x))) if np.isfinite(y - x).any() else 0.0
    return x, y - bound * math.tanh(bias / bound)


def _accelerations(s: Signals) -> npt.NDArray[np.complex128]:
    """Return level accelerations north and east, but for their means, by the specific forces."""
    forces = s.stacked(*FORCES)
    if not s.has(FORCES[2]):
        forces[2] = -GRAVITY
    ahead, aside = level_forces(*_tilt(s), forces)
    level = (ahead - np.nanmean(ahead)) + 1j * (aside - np.nanmean(aside))
    return level * np.exp(1j * s["compass_rad"])


def _both(s: Signals, x: npt.NDArray[Any], rate: npt.NDArray[Any], width: int, order: int) -> Pair:
    """Return changes of a signal, and of the integral of its rate."""
    return _changes(x, width, order), _changes(_sum(rate, s.step), width, order)


def _fixes_and_velocity(s: Signals) -> Pair:
    """Way of the fixes, and of the integrated velocity."""
    return _both(s, s.level(FIX), s.level(VELOCITY), s.width(s.way_s, 2.0, *FIX), 1)


def _velocity_and_forces(s: Signals) -> Pair:
    """Changes of velocity (of GPS or fixes), and of the integrated level specific forces."""
    force = _accelerations(s)
    if s.has(*VELOCITY):
        return _both(s, s.level(VELOCITY), force, s.width(1.0, 2.0, *VELOCITY), 2)
    return _both(s, s.level(FIX), _sum(force, s.step), s.width(2.0, 4.0, *FIX), 3)


def _climb_and_force(s: Signals) -> Pair:
    """Changes of the vertical speed, and of the integrated vertical force."""
    force = s[FORCES[2]] - np.nanmean(s[FORCES[2]])
    return _both(s, s["gps_vz_mps"], force, s.width(0.5, 2.0, "gps_vz_mps"), 2)


def _height_and_climb(s: Signals) -> Pair:
    """Changes of the height, and of the integrated vertical speed."""
    return _both(s, s["gps_z_m"], s["gps_vz_mps"], s.width(1.0, 2.0, "gps_z_m"), 2)


def _force_and_gravity(s: Signals) -> Pair:
    """Mean specific force, and gravity with the acceleration of turns."""
    nothing = np.zeros(len(s.t))
    if not s.has(*FORCES):
        return nothing, np.full(len(s.t), math.nan)
    speed = np.abs(s.level(VELOCITY)) if s.has(*VELOCITY) else nothing
    around = np.gradient(s["compass_rad"], s.step) * speed if s.has("compass_rad") else nothing
    roll, pitch = s.stacked(*ANGLES) if s.has(*ANGLES) else (nothing, nothing)
    expected = (
        GRAVITY * np.sin(pitch),
        around - GRAVITY * np.sin(roll) * np.cos(pitch),
        -GRAVITY * np.cos(roll) * np.cos(pitch),
    )
    width = s.width(SLOW_S, 0.0, *FORCES)
    x, y = (
        np.concatenate([_mean(column, width, slice(width // 2, None, width)) for column in each])
        for each in (s.stacked(*FORCES), expected)
    )
    return x, y


def _along(s: Signals, velocity: npt.NDArray[Any], width: int) -> Pair:
    """Return velocities over ground, and their prediction from heading and commands.

    Its speed ahead is free; in turns it drifts in proportion to the yaw rate; the current is one.
    Velocities are means over a width of steps, in the middles of such widths.
    """
    rows = np.arange(width, len(s.t), width)[: len(velocity)]
    v, heading = velocity[: len(rows)], _mean(s["compass_rad"], width, rows)
    # both sides: a propeller that runs backwards gives less thrust
    thrust = _mean(s.stacked(*COMMANDS[:2]).max(axis=0), width, rows)
    turned = np.gradient(heading) if len(rows) > 1 else heading
    # the way of a boat that turns on the spot tells no direction
    ok = np.isfinite(v) & (np.abs(turned) < ARC_RAD)
    ok &= np.abs(v) > SLOW_SHARE * np.fmax.reduce(np.abs(v), initial=0.0)
    if ok.sum() < ENOUGH // 2:
        return v[:0], v[:0]
    v, axes, turned = v[ok], np.exp(1j * heading[ok]), turned[ok]
    size = max(float(np.sqrt(np.mean(np.abs(v) ** 2))), 1e-300)
    # current north and east and drift, as shares of the speed, by ridge regression of the sway
    side = (v * axes.conj()).imag / size
    known = np.column_stack([-axes.imag, axes.real, turned / max(float(np.std(turned)), 1e-9)])
    fit = np.zeros(3)
    for _ in range(3):
        left = side - known @ fit
        weight = float(left @ left) / len(v) / SLIP_MAX**2 * np.eye(3)
        fit = np.linalg.solve(known.T @ known + weight + 1e-12 * np.eye(3), known.T @ side)
    # no current is as fast as the boat, whatever it would explain
    share = min(1.0, SLIP_MAX / max(math.hypot(fit[0], fit[1]), 1e-9))
    current, drift = size * share * (fit[0] + 1j * fit[1]), np.clip(fit[2], -SLIP_MAX, SLIP_MAX)
    sign = np.where(thrust[ok] < 0.0, -1.0, 1.0)
    ahead = sign * np.maximum(sign * ((v - current) * axes.conj()).real, 0.0)
    return v, current + axes * (ahead + 1j * size * drift * known[:, 2])


def _track(s: Signals) -> Pair:
    """Velocity of the fixes, and that along the heading."""
    width = s.width(s.way_s, 2.0, *FIX)
    return _along(s, _changes(s.level(FIX), width) / (width * s.step), width)


def _course(s: Signals) -> Pair:
    """Velocity over ground, and that along the heading."""
    width = s.width(2.0, 2.0, *VELOCITY)
    return _along(s, _mean(s.level(VELOCITY), width, slice(width, None, width)), width)


def _explained(change: Array, own: list[Array], commands: list[Array]) -> tuple[float, Pair]:
    """Return a change without what the motion itself explains, and what commands make of it.

    More of a command makes more of the motion: no effect is below 0. The first number is the
    log-likelihood by which commands of either sign explain the change.
    """
    from scipy.optimize import nnls  # takes half a second

    ok = np.isfinite(np.array([change, *own, *commands])).all(axis=0)
    if ok.sum() < ENOUGH:
        return 0.0, (change[:0], change[:0])
    known = np.column_stack([*(column[ok] for column in own), np.ones(int(ok.sum()))])
    both = np.column_stack([change[ok], *(column[ok] for column in commands)])
    left = both - known @ np.linalg.lstsq(known, both, rcond=1e-9)[0]
    size = np.linalg.norm(left, axis=0)
    size[size < EXCITATION_SHARE_MIN * np.linalg.norm(both, axis=0)] = math.inf
    y, made = left[:, 0], left[:, 1:] / np.maximum(size[1:], 1e-300)
    either = y - made @ np.linalg.lstsq(made, y, rcond=1e-9)[0]
    shrunk = max(float(either @ either), 1e-300) / max(float(y @ y), 1e-300)
    return -0.5 * len(y) * math.log(shrunk), (y, np.asarray(made @ nnls(made, y)[0]))


def _turns_by(s: Signals, horizon: float) -> tuple[Array, list[Array], list[Array]]:
    """Return changes of the turn from one time to the next, the turn before, the acts between."""
    shafts, steering, heading = s.stacked(*COMMANDS[:2]), s.stacked(*COMMANDS[2:]), s["compass_rad"]
    force = shafts * np.abs(shafts)
    total = force.sum(axis=0)
    acts = [force[0] - force[1]]
    if np.ptp(steering) > 0.0:
        if np.std(acts[0]) < EXCITATION_SHARE_MIN * np.abs(total).max(initial=0.0):
            del acts[0]
        acts.append(steering.mean(axis=0) * (total if total.any() else np.ones_like(total)))
    half = max(round(0.5 * horizon / s.step), 1)
    rows = np.arange(2 * half, len(s.t) - 3 * half, 2 * half)
    if half * s.step < s.intervals.get("compass_rad", 0.0):
        rows = rows[:0]
    # mean rates around the two ends; the commands act in between
    before = heading[rows + half] - heading[rows - half]
    after = heading[rows + 3 * half] - heading[rows + half]
    return after - before, [before], [_mean(each, 2 * half, rows + half) for each in acts]


def _yaw_and_commands(s: Signals) -> Pair:
    """Changes of the yaw rate by the compass, and what the commands make of it at their horizon."""
    tried = [_explained(*_turns_by(s, horizon)) for horizon in HORIZONS_S]
    return max(tried, key=lambda each: each[0])[1]


def _surge_and_thrust(s: Signals) -> Pair:
    """Changes of the speed ahead by the fixes, and what the thrust makes of it."""
    width = s.width(s.way_s, 2.0, *FIX)
    way = _changes(s.level(FIX), width) / (width * s.step)
    rows = np.arange(width, len(s.t), width)[: len(way)]
    heading = _mean(s["compass_rad"], width, rows)
    ahead, turned = (way[: len(rows)] * np.exp(-1j * heading)).real, np.diff(heading)
    shafts = s.stacked(*COMMANDS[:2])
    middles = np.minimum(rows + width // 2, len(s.t) - 1)[:-1]
    between = _mean((shafts * np.abs(shafts)).sum(axis=0), width, middles)
    now = np.where(np.abs(turned) < ARC_RAD, ahead[:-1], math.nan)
    return _explained(np.diff(ahead), [now, now * np.abs(now), turned**2], [between])[1]


BY_GRAVITY, BY_COMMANDS = "gravity and accelerometers", ("turns and commands", "speed and thrust")
"""The comparison with a constant; those that need a model of the boat."""

COMPARISONS: dict[str, Callable[[Signals], Pair]] = {
    "fixes and velocity": _fixes_and_velocity,
    "turns of compass and gyro": lambda s: _angle_and_gyro(s, "compass_rad", 2, 2.0),
    "track and compass": _track,
    "course and compass": _course,
    "velocity and accelerometers": _velocity_and_forces,
    "roll of AHRS and gyro": lambda s: _angle_and_gyro(s, ANGLES[0], 0, 0.5),
    "pitch of AHRS and gyro": lambda s: _angle_and_gyro(s, ANGLES[1], 1, 0.5),
    "vertical speed and accelerometer": _climb_and_force,
    "height and vertical speed": _height_and_climb,
    BY_GRAVITY: _force_and_gravity,
    BY_COMMANDS[0]: _yaw_and_commands,
    BY_COMMANDS[1]: _surge_and_thrust,
}
"""By name, the function of two signals that are equal where no sensor is at fault."""

Evidence = dict[str, Comparison | None]


class _Watched(dict[str, Array]):
    """Columns that remember which of them were read."""

    def __init__(self, columns: Mapping[str, Array]) -> None:
        super().__init__(columns)
        self.read = set[str]()

    def __getitem__(self, name: str) -> Array:
        self.read.add(name)
        return super().__getitem__(name)


def log_likelihood(
    s: Signals, changed: tuple[str, ...] = (), before: Evidence | None = None
) -> Evidence:
    """Return all comparisons of signals.

    Parameters
    ----------
    s : Signals
        To be compared.
    changed : tuple of str, optional
        Columns that differ from those of ``before``; only their comparisons are made anew.
    before : dict, optional
        Comparisons of the others.
    """
    found: Evidence = {}
    for name, pair in COMPARISONS.items():
        if before is not None:
            known = before[name]
            if known is None or known.uses.isdisjoint(changed):
                found[name] = known
                continue
        columns = _Watched(s.columns)
        with np.errstate(all="ignore"):
            x, y = pair(dataclasses.replace(s, columns=columns))
        one = _compare(x, y, frozenset(columns.read))
        if name == BY_GRAVITY and one is not None:
            # boats heel and trim, all along: each window counts
            windows = len(s.t) // s.width(SLOW_S, 0.0, *FORCES)
            tilt = (0.5 if s.has(*ANGLES) else 1.0) * TILT_RAD
            one = Comparison(one.rho - RHO_MIN + tilt**2, windows, windows, one.uses)
        found[name] = one
    return found
