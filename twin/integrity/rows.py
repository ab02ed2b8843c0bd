"""Exact rules for the rows of a log: stamps, cells, repetition, leaps, kind of commands."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from twin.channels import COMMANDS, MEASUREMENTS, WIND_SPEED
from twin.filters.navigation_state import ACCEL_LIMIT, TURN_LIMIT
from twin.integrity.findings import ERROR, NOTE, WARNING, Finding
from twin.integrity.screening import CHANGED_SD
from twin.logs.checks import is_gap
from twin.logs.clock import (
    GAP_STEPS,
    HOUR_S,
    hours_of,
    order_remedy,
    set_back,
    spread,
    stood_in_gap,
    wild_stamps,
)
from twin.logs.columns import SHARE, UNITS
from twin.logs.datum import FEW
from twin.logs.jumps import FAST_MPS, find_jumps
from twin.logs.marks import HEADINGS, marks_of
from twin.logs.recording import Recording, repeated
from twin.logs.signals import ENOUGH, averaged, interpolation_residual, robust_sd, ways
from twin.particulars import Particulars

__all__ = [
    "ANGLES",
    "FIX",
    "FORCES",
    "GYROS",
    "SAMPLES_MIN",
    "SENSORS",
    "SIZE_MAX",
    "STAMP_JITTER_S",
    "VELOCITY",
    "check_cells",
    "check_commands",
    "check_silence",
    "check_time",
    "fix_scatter",
    "is_dead",
    "speed_of",
    "without_leaps",
    "without_marks",
]

Array = npt.NDArray[np.float64]

FIX = ("gps_x_m", "gps_y_m")
VELOCITY = ("gps_vx_mps", "gps_vy_mps")
GYROS = ("gyro_x_radps", "gyro_y_radps", "gyro_radps")
FORCES = ("accel_x_mps2", "accel_y_mps2", "accel_z_mps2")
ANGLES = ("ahrs_roll_rad", "ahrs_pitch_rad")

SENSORS: dict[str, tuple[str, ...]] = {
    "fix": FIX,
    "velocity": VELOCITY,
    "compass": ("compass_rad",),
    "gyro": GYROS[2:],
    "accelerometers": FORCES[:2],
    "wind": ("wind_mps", "wind_from_rad"),
    "roll and pitch gyros": GYROS[:2],
    "vertical accelerometer": FORCES[2:],
    "AHRS": ANGLES,
    "height": ("gps_z_m",),
    "vertical speed": ("gps_vz_mps",),
}
"""Sensors and the columns that come together."""

OPTIONAL = frozenset(MEASUREMENTS[WIND_SPEED:])
"""Columns of wind, roll, pitch and heave, which a twin does not need."""

SAMPLES_MIN = 3 * ENOUGH
"""Least number of samples from which motion is estimated."""

ROW_STEP_MAX_S = 5.0
"""Largest plausible median step between rows."""

JITTER_SHARE = 0.05
"""Spread of the time steps, as a share of their median, above which they jitter."""

STAMP_JITTER_S = 0.03
"""Jitter of the time stamps of fixes above which it is reported."""

OUTAGE_MIN_S = 2.0
FROZEN_MAX_S = 0.5
"""Least outage of a sensor that is reported, and longest time for which all sensors may repeat
their samples at once."""

LEAP_DEVIATIONS = 15.0
LEAP_M = 0.1
LEAP_RAD = math.radians(4.0)
"""Least deviation of a leap: in median deviations, in m, and in rad."""

SIZE_MAX = 1e100
"""Bound of an estimated scatter."""

SAILING_MIN_M = 20.0
"""Distance above which a boat counts as sailing."""

GROSS_RATIO = 4.0
"""Size of a gross error over the usual size of its column ..."""

GROSS_OTHER_MIN = 400.0
GROSS_MIN = {"mps": FAST_MPS, "radps": TURN_LIMIT, "mps2": ACCEL_LIMIT}
"""... and its least size, in the unit of its column, and where a unit has no entry."""

LARGE_ANGLE_RAD = 0.5 * math.pi
"""Largest usual angle of rudders and drives."""

SHAFT_FAR = 5.0
SHAFT_NEAR = 1.4
"""Factors within which speed over shaft speed matches that of the particulars, and a unit."""


def check_time(recording: Recording) -> list[Finding]:
    """Return what is wrong with the stamps of the rows, and with those of the fixes."""
    t = recording.t
    found = _order(recording.stamps, recording.motion, recording.clashes)
    if len(t) < ENOUGH:
        return found
    step = np.diff(t)
    median = float(np.median(step))
    if median >= ROW_STEP_MAX_S:
        what = f"rows are {median:.4g} s apart"
        remedy = 'if t_s counts milliseconds, give it unit = "ms" in a mapping file'
        found.append(Finding(WARNING, "time-unit", what, remedy, "time", median))
    gap = is_gap(t)
    if gap.any():
        row = int(np.argmax(step))
        span = {"start": float(t[row]), "end": float(t[row + 1])}
        remedy = "the twin forecasts across them; check what stopped the logger"
        hours = hours_of(float(step[row]) - median, median)
        if stood_in_gap(*recording.samples(*FIX), *span.values()):
            remedy += ", or the clock was set forward: the boat did not move meanwhile"
        elif hours:
            remedy += ", or whether the clock was set forward"
        what = (
            f"{gap.sum()} gap(s) in time above {GAP_STEPS:.0f} x the median step, the longest "
            f"{step[row]:.1f} s at t = {t[row]:.1f} s"
            + f": {hours / HOUR_S:g} h, as local time is; the clock is not UTC"
            * (hours > 0.0)
        )
        found.append(Finding(WARNING, "gap", what, remedy, "time", float(step[row]), **span))
    jitter, whose = _uneven(step[~gap]), _uneven_sensors(recording)
    if jitter > JITTER_SHARE * median and whose:
        what = f"the stamps of {whose} jitter: steps of {median:.3g} s spread by {jitter:.2g} s"
        remedy = "stamp samples when they are taken, not when they are written"
        found.append(Finding(WARNING, "jitter", what, remedy, "time", jitter))
    along, across, speed = fix_scatter(*recording.samples(*FIX))
    if speed > FAST_MPS:
        what = f"the fixes go at {speed:.3g} m/s: rows are {median:.3g} s apart"
        remedy = 'if the time counts minutes or so, unit = "min" for t_s in a mapping file'
        found.append(Finding(ERROR, "unit", what, remedy, "time", speed))
    late = math.sqrt(max(along**2 - across**2, 0.0)) / max(speed, 1e-9)
    if along > 2.0 * across and late > STAMP_JITTER_S:
        what = (
            f"the stamps of the fixes jitter by {late:.2f} s: at {speed:.1f} m/s they scatter by "
            f"{along:.2g} m along the track, {across:.2g} m across it"
        )
        remedy = f"log the time that the receiver states, or set gps_sd to {along:.2g} or more"
        found.append(Finding(WARNING, "jitter", what, remedy, "fix", late))
    return found


def _uneven(steps: Array) -> float:
    """Return by how much steps of time spread, s; 0 where most of them are the same."""
    same = np.isclose(steps, np.median(steps), rtol=1e-3).mean()
    return 0.0 if same > 0.5 else robust_sd(steps)


def _uneven_sensors(recording: Recording) -> str:
    """Return the sensors whose time stamps jitter.

    Rows that only hold the samples of several regular sensors are as irregular as their union.
    """
    uneven = dict[str, bool]()
    for sensor, names in SENSORS.items():
        values = recording.z[:, [MEASUREMENTS.index(name) for name in names]]
        given = np.isfinite(values).all(axis=1)
        # rows may hold the last sample until the next one
        times = recording.t[given], recording.t[given & ~repeated(values)]
        steps = [np.diff(t) for t in times if len(t) > ENOUGH]
        if steps:
            uneven[sensor] = all(_uneven(each) > JITTER_SHARE * np.median(each) for each in steps)
    return "the rows" if all(uneven.values()) else ", ".join(k for k, v in uneven.items() if v)


def _order(stamps: Array, motion: Array | None, clashes: int) -> list[Finding]:
    """Return findings about times that are wild, empty, equal or go back."""
    found = []

    def say(what: str, remedy: str, size: float, severity: str = ERROR) -> None:
        found.append(Finding(severity, "time", what, remedy, "time", size))

    wild = wild_stamps(stamps)
    if wild.any():
        row = int(np.argmax(wild))
        say(
            f"{wild.sum()} stamp(s) are far from all others (row {row + 1}: {stamps[row]:.10g} s)",
            "the clock was not set there: correct these stamps; their rows are left out",
            float(wild.sum()),
            WARNING,
        )
        stamps = stamps[~wild]
        motion = None if motion is None else motion[~wild]
    valid = stamps[np.isfinite(stamps)]
    empty, step = len(stamps) - len(valid), np.diff(valid)
    if empty:
        what = f"{empty} of {len(stamps)} rows have no time"
        say(what, "fill in the time or remove these rows", float(empty))
    back = step < 0.0
    if back.any():
        size, steps = -float(step.min()), set_back(stamps, motion)
        what = f"time goes back {back.sum()} time(s), by up to {size:.3g} s"
        remedy = "" if steps else order_remedy(stamps, motion)
        if steps:
            row, size = max(steps, key=lambda each: each[1])
            what = f"the clock was set back by {size:.2f} s in row {row + 1}"
            remedy = f"add {size:.2f} s to all later stamps; the rest is checked as if they had it"
        if size % HOUR_S == 0.0:
            what += f": {size / HOUR_S:g} h, as local time is; the clock of the rows is not UTC"
        say(what, remedy, size)
    equal = int((step == 0.0).sum())
    if equal:
        what = f"{equal} of {len(valid)} rows have the time of the row before"
        remedy = "they do not contradict it, and are merged with it when the log is read"
        spreads = clashes and spread(valid) is not None
        if spreads:
            remedy = "they are spread over the time that the clock counts by"
        elif clashes:
            what += f"; {clashes} of them have other values, as times in whole seconds do"
            remedy = "record fractions of a second, or keep one row of each time"
        say(what, remedy, float(equal), ERROR if clashes and not spreads else NOTE)
    return found


def fix_scatter(t: Array, fix: Array) -> tuple[float, float, float]:
    """Return scatter of fixes along and across the track, m, and the speed, m/s; 0 if unknown.

    A stamp that is wrong by dt moves the fix along the track by speed times dt, not across it.
    """
    if len(t) < SAMPLES_MIN:
        return 0.0, 0.0, 0.0
    left, way = interpolation_residual(t, fix), fix[4:] - fix[:-4]
    length = np.hypot(*way.T)
    speed = length / (t[4:] - t[:-4])
    fast = (speed > 0.5 * np.median(speed)) & (length > 0.0)
    if fast.sum() < 2 * ENOUGH:
        return 0.0, 0.0, 0.0
    ahead = way[fast] / length[fast, None]
    along = robust_sd((left[fast] * ahead).sum(axis=1))
    across = robust_sd(left[fast, 1] * ahead[:, 0] - left[fast, 0] * ahead[:, 1])
    return min(along, SIZE_MAX), min(across, SIZE_MAX), float(np.median(speed[fast]))


def is_dead(values: Array) -> bool:
    """Return whether a column of enough samples has one value only."""
    seen = values[np.isfinite(values)]
    return len(seen) >= ENOUGH and bool((seen == seen[0]).all())


def check_cells(recording: Recording) -> list[Finding]:
    """Return findings about rows, samples and columns that are not there, dead or infinite."""
    if len(recording.t) < ENOUGH:
        valid = recording.stamps[np.isfinite(recording.stamps)]
        if len(valid) >= ENOUGH and (np.diff(valid) < 0.0).any():
            return []  # there are rows enough, but not in the order of their times
        what = f"{len(recording.t)} rows with a time of their own"
        remedy = "record for longer: some minutes, with turns"
        return [Finding(ERROR, "missing", what, remedy, "time")]
    found = []
    if recording.infinite:
        what = f"{recording.infinite} cells are infinite"
        found.append(Finding(ERROR, "mark", what, "leave cells without a value empty", "cells"))
    empty = int(np.isnan(recording.cmd).any(axis=1).sum())
    if empty:
        what = f"{empty} of {len(recording.t)} rows come before the first command"
        remedy = "fill in the commands in force, or remove these rows"
        found.append(Finding(WARNING, "missing", what, remedy, "commands"))
    for name, values in zip(MEASUREMENTS, recording.z.T, strict=True):
        given, count = recording.called(name), int(np.isfinite(values).sum())
        if name in ("gps_x_m", "compass_rad") and count < ENOUGH:
            what = f"{given}: {count} samples"
            found.append(Finding(ERROR, "missing", what, "position and heading are needed", name))
        if is_dead(values):
            what = f"{given}: all {count} values are {np.nanmax(values):.6g}"
            remedy = "a dead sensor: empty its cells or remove the column"
            if name in OPTIONAL:
                remedy = "the twin does without it"
            severity = NOTE if name in OPTIONAL else ERROR
            found.append(Finding(severity, "dead", what, remedy, name))
    return found


def check_silence(recording: Recording) -> list[Finding]:
    """Return findings where a sensor that works gives nothing new for long, or all at once do."""
    moving = tuple(
        name
        for name, values in zip(MEASUREMENTS, recording.z.T, strict=True)
        if np.mean(np.abs(np.diff(values)) > 0.0) > 0.5
    )
    found = _silent(recording, "rows", moving, FROZEN_MAX_S, GAP_STEPS) if len(moving) > 1 else []
    for sensor, names in SENSORS.items():
        lost = _silent(recording, sensor, names)
        if not lost and names not in (FIX, VELOCITY):
            lost = [each for name in names for each in _silent(recording, name, (name,))]
        found += lost
    return found


def _silent(
    recording: Recording,
    sensor: str,
    names: tuple[str, ...],
    least_s: float = OUTAGE_MIN_S,
    intervals: float = 2.0 * GAP_STEPS,
) -> list[Finding]:
    """Return a finding on the longest silence of columns, missing or the same, if it is long.

    One that repeats itself elsewhere too is coarse, of a boat that rests, unless it goes on with
    its largest step, or the gyro turned by more than that.
    """
    z = recording.z[:, [MEASUREMENTS.index(name) for name in names]]
    given = np.isfinite(z).all(axis=1)
    t, values = recording.t[given], z[given]
    if len(t) < ENOUGH or is_dead(values[:, 0]):
        return []
    step = np.diff(values, axis=0)
    if names[0] in HEADINGS:  # past a whole turn is no step
        step = np.remainder(step + math.pi, 2.0 * math.pi) - math.pi
    size = np.sqrt((step**2).sum(axis=1))
    new = np.append(0, np.flatnonzero(size > 0.0) + 1)
    edges = np.concatenate(([recording.t[0]], t[new], [recording.t[-1]]))
    # gaps that the clock skipped are reported for the clock
    step = np.where(is_gap(recording.t), 0.0, np.diff(recording.t))
    silence = np.diff(np.interp(edges, recording.t, np.append(0.0, np.cumsum(step))))
    bound = max(intervals * float(np.median(np.diff(edges))), least_s)
    # share of the rows in each silence that hold a value, the same one, as rows do on average
    rows = np.searchsorted(recording.t, edges)
    held = np.append(0, np.cumsum(given))[rows]
    still = np.diff(held) - 1 > 0.5 * given.mean() * (np.diff(rows) - 1)
    after = np.concatenate(([0.0], size[new[1:] - 1], [0.0]))
    wrong = still
    if sensor != "rows":
        same, rests = size == 0.0, np.zeros(len(after), dtype=np.bool_)
        if names == VELOCITY:
            # rows between the samples repeat the fix, too; a boat that rests has 0
            same &= ~repeated(recording.z[:, :2])[given][1:]
            rests = np.append(False, ~values[new].any(axis=1))
        times = np.append(0, np.cumsum(same))
        repeats = np.diff(np.concatenate(([0], times[new], times[-1:])))
        if sensor in ("compass", "velocity"):
            after = np.fmax(after, _changed(recording, sensor, t[new], values[new], edges))
        alone = (repeats == same.sum()) & ~rests
        wrong = ~still | alone | (after > np.partition(size, -2)[-2])
    long = np.flatnonzero((silence > bound) & wrong)
    if not len(long):
        return []
    k = long[np.argmax(silence[long])]
    what = (
        f"{'all sensors at once' if sensor == 'rows' else recording.called(*names)}: "
        f"{'the same values' if still[k] else 'no sample'} for up to {silence[k]:.1f} s (from t = "
        f"{edges[k]:.1f} s), {len(long)} time(s) longer than {bound:.1f} s"
    )
    remedy = "the twin bridges it and grows unsure; expect wider intervals there"
    if sensor == "rows":
        remedy = "the logger wrote old samples with new times: log each once, with its own time"
    elif still[k]:
        remedy = "the sensor had stopped: empty these cells"
    span = {"start": float(edges[k]), "end": float(edges[k + 1])}
    code = "frozen" if still[k] else "lost"
    return [Finding(WARNING, code, what, remedy, sensor, float(silence[k]), **span)]


def _changed(recording: Recording, sensor: str, t: Array, values: Array, edges: Array) -> Array:
    """Return by how much heading or velocity changed at least between edges (K,), s, as (K - 1,).

    ``t`` and ``values`` (M, k) are new samples, held from the second on against what other sensors
    say. A line is fitted to the difference of heading and integrated gyro: its slope is the gyro's
    bias. What is left is at worst the random walk of the gyro's white noise, whose variance about
    such a line is 1/15 of that after the same time. So :data:`CHANGED_SD` of its standard
    deviations to both sides are taken off.
    """
    at, said, drifts = _said_by_others(recording, sensor)
    if min(len(t), len(at)) < ENOUGH:
        return np.zeros(len(edges) - 1)
    own = np.unwrap(values[1:], axis=0) if sensor == "compass" else values[1:]
    apart = np.column_stack([np.interp(t[1:], at, each) for each in said.T]) - own
    after, share = t[1:] - t[1:].mean(), np.zeros(len(edges) - 1)
    if drifts:
        bias = after @ apart / (after @ after)
        apart, said = apart - np.outer(after, bias), said - np.outer(at, bias)
        share = np.diff(edges) / (t[-1] - t[1])
    begins = np.searchsorted(at, edges[:-1]).clip(max=len(at) - 1)
    change = np.maximum.reduceat(said, begins) - np.minimum.reduceat(said, begins)
    # of the walk after a stretch, and of the bias found before it, over the time of the line
    sd = np.linalg.norm(np.std(apart, axis=0)) * np.sqrt(15.0 * share * (1.0 + share) + 1.0)
    return np.maximum(np.linalg.norm(change, axis=1) - 2.0 * CHANGED_SD * sd, 0.0)


def _said_by_others(recording: Recording, sensor: str) -> tuple[Array, Array, bool]:
    """Return times (N,), s, heading or velocity (N, k) by other sensors, and whether it drifts.

    A velocity goes with the ways between fixes; a heading with the integrated gyro, else with the
    axis along which a boat moves that is not slow.
    """
    rate = np.nan_to_num(recording.z[:, MEASUREMENTS.index(GYROS[2])])
    if sensor == "compass" and rate.any():
        angle = np.append(0.0, np.cumsum(rate[1:] * np.diff(recording.t)))
        return recording.t, angle[:, None], True
    at, velocity = speed_of(recording) or (np.empty(0), np.empty((0, 2)))
    if sensor == "compass":
        speed = np.hypot(*velocity.T)
        at, velocity = (each[speed > 0.5 * speed.max(initial=0.0)] for each in (at, velocity))
        axis = 2.0 * np.arctan2(velocity[:, 1], velocity[:, 0])
        velocity = 0.5 * np.unwrap(axis)[:, None]
    return at, velocity, False


def without_leaps(recording: Recording) -> tuple[Recording, list[Finding]]:
    """Return a recording without fixes that no boat reaches, and findings about leaps."""
    found, jumps = list[Finding](), find_jumps(recording.t, recording.z[:, :2])
    if jumps is not None:
        t, lost = recording.t, len(jumps.lost)
        what = (
            f"{recording.called(*FIX)}: {lost} of {jumps.fixes} fixes cannot be reached from the "
            f"others (a jump of {jumps.length:.4g} m at t = {t[jumps.after]:.1f} s)"
        )
        remedy = "single ones are left out when the log is read; else empty these cells"
        severity = WARNING if lost < FEW * jumps.fixes else ERROR
        span = {"start": float(t[jumps.lost[0]]), "end": float(t[jumps.lost[-1]])}
        found.append(Finding(severity, "jump", what, remedy, "fix", jumps.length, **span))
        recording = recording.without(FIX, jumps.lost)
    for sensor, least, unit in (("fix", LEAP_M, "m"), ("compass", LEAP_RAD, "rad")):
        t, values = recording.samples(*SENSORS[sensor])
        if len(t) < SAMPLES_MIN:
            continue
        if sensor == "compass":
            values = np.unwrap(values, axis=0)
        step, width = np.diff(values, axis=0), np.diff(t)
        speed = step / width[:, None]
        # the part of the step that those around it do not explain
        near = np.median([speed[:-4], speed[1:-3], speed[3:-1], speed[4:]], axis=0)
        left = np.sqrt(((step[2:-2] - width[2:-2, None] * near) ** 2).sum(axis=1))
        left[width[2:-2] > 0.5 * GAP_STEPS * np.median(width)] = 0.0
        wild = np.flatnonzero(left > max(least, LEAP_DEVIATIONS * float(np.median(left))))
        if not 0 < SAMPLES_MIN * len(wild) <= len(t):  # else the values are coarse
            continue
        most = int(np.argmax(left))
        at, size = float(t[most + 3]), float(left[most])
        what = (
            f"{recording.called(*SENSORS[sensor])}: leaps by up to {size:.2g} {unit} from one "
            f"sample to the next (at t = {at:.1f} s), {len(wild)} time(s)"
        )
        remedy = "the receiver or filter was corrected: expect errors of this size"
        found.append(Finding(WARNING, "jump", what, remedy, sensor, size, start=at, end=at))
    return recording, found


def without_marks(
    recording: Recording, particulars: Particulars | None = None
) -> tuple[Recording, list[Finding]]:
    """Return a recording without samples that are absurdly far from the others, and findings.

    Such are glitches, and numbers that stand for "no value". These may come often: so each distinct
    value counts once. Fixes have a rule of their own (:func:`without_leaps`). A command is absurd
    that is as far from the others, and from what the shafts of the boat or an angle can be.
    """
    found, least = list[Finding](), dict(GROSS_MIN)
    if particulars is not None:
        least["rps"] = GROSS_RATIO * particulars.shaft_speed
    channels, table = (*MEASUREMENTS, *COMMANDS), np.column_stack([recording.z, recording.cmd])
    others = ((name,) for name in MEASUREMENTS if name not in (*FIX, *VELOCITY))
    for names in (VELOCITY, *others, COMMANDS[:2], COMMANDS[2:]):
        sensor = names[0]
        if sensor in COMMANDS:
            least["rad"] = LARGE_ANGLE_RAD
        # made of speed and course, or of throttle and steering, a mark is in both
        values = table[:, [channels.index(name) for name in names]].T
        if names == VELOCITY:
            values, sensor = np.hypot(*values)[None], "velocity"
        values = np.take_along_axis(values, np.abs(values).argmax(axis=0)[None], axis=0)[0]
        seen = np.unique(values[np.isfinite(values)])
        middle = np.median(seen) if len(seen) else 0.0
        size = np.abs(values - (0.0 if len(names) > 1 else middle))
        angle, command = sensor in HEADINGS, sensor in COMMANDS
        marks = marks_of(values, 2.0 * math.pi if angle else math.inf) if angle or command else []
        often = np.isin(values, marks)
        distinct = np.unique(size[np.isfinite(size) & ~often].round(9))
        if len(distinct) < (1 if command else ENOUGH):  # commands may be few steps
            continue
        usual, unit = float(np.quantile(distinct, 1.0 - FEW)), names[0].rpartition("_")[2]
        absurd = size > max(GROSS_RATIO * usual, least.get(unit, GROSS_OTHER_MIN))
        if angle:
            absurd |= often
        elif command and len(distinct) >= ENOUGH:
            absurd |= often & (size > (least["rad"] if unit == "rad" else GROSS_RATIO * usual))
        rows = np.flatnonzero(absurd)
        if not len(rows):
            continue
        recording = recording.without(names, rows)
        count, row = int(np.isfinite(values).sum()), rows[np.argmax(size[rows])]
        other = {"mps": "kn", "rad": "deg"}.get(unit, unit)
        shown = f" ({values[row] / UNITS[unit][other]:.5g} {other})" if other != unit else ""
        what = (
            f"{recording.called(*names)}: {len(rows)} of {count} samples are absurd, up to "
            f"{values[row]:.5g}{shown} at t = {recording.t[row]:.1f} s: glitches, or marks for "
            '"no value"'
        )
        remedy = (
            f"name them in the mapping, as empty = [{'0, 65535' if command else '999'}], or leave "
            "these cells empty; here they are left out, and the rest is checked"
        )
        severity = WARNING if len(rows) < FEW * count or OPTIONAL.issuperset(names) else ERROR
        span = {"start": float(recording.t[rows[0]]), "end": float(recording.t[rows[-1]])}
        found.append(Finding(severity, "mark", what, remedy, sensor, float(values[row]), **span))
    return recording, found


def check_commands(recording: Recording, particulars: Particulars | None) -> list[Finding]:
    """Return what is wrong with units and kind of the commands."""
    n, delta = np.nan_to_num(recording.cmd[:, :2]), np.nan_to_num(recording.cmd[:, 2:])
    name, angles = recording.called(*COMMANDS[:2]), recording.called(*COMMANDS[2:])
    found, most = [], float(np.abs(delta).max(initial=0.0))
    if most > LARGE_ANGLE_RAD:
        what = f"{angles}: angles of up to {most:.3g} rad, {math.degrees(most):.0f} degrees"
        remedy = 'if these are degrees, unit = "deg" for the angles in the mapping'
        severity = ERROR if most > math.pi else WARNING
        found.append(Finding(severity, "unit", what, remedy, "steering", most))
    motion = speed_of(recording)
    if motion is not None and len(motion[0]) > 1:
        at, speed = motion[0], np.hypot(*motion[1].T)
        way = float(speed.sum() * np.median(np.diff(at)))
        used = {"left": n[:, 0].any(), "right": n[:, 1].any()}
        still = [side for side, moves in used.items() if not moves]
        if way > SAILING_MIN_M and still:
            sensor, severity = ("commands", ERROR) if len(still) > 1 else (still[0], WARNING)
            code, which = ("missing", name) if len(still) > 1 else ("sides", f"n_{still[0]}_rps")
            what = f"{which}: 0 in all rows while the boat sails {way:.0f} m"
            remedy = "record them all; a boat with one shaft only has one column, n_rps"
            found.append(Finding(severity, code, what, remedy, sensor))
        commanded = recording.cmd[np.isfinite(recording.cmd).all(axis=1)]
        if not still and (commanded == commanded[:1]).all():
            what = "commands: the same in all rows: this log does not tell whether they are right"
            remedy = "record the commands in force, with turns and changes of thrust"
            found.append(Finding(NOTE, "unchecked", what, remedy, "commands"))
        if particulars is not None and SHARE not in name and n.any():
            found += _shaft_unit(recording, name, n, at, speed, particulars)
    if particulars is not None:
        fixed, moved = particulars.steering == "differential", bool(np.ptp(delta, axis=0).any())
        unequal = not delta.any() and (n[:, 0] != n[:, 1]).mean() > 0.5
        if moved if fixed else unequal:
            other = "drives" if fixed else "differential"
            what = f"{angles}: {'these move' if fixed else '0 in all rows, and the shafts differ'}"
            mix = "[skid_steering] of throttle and steering" if fixed else "other columns"
            remedy = f'steering = "{other}" in the particulars, or {mix} in the mapping'
            found.append(Finding(WARNING, "unit", what, remedy, "steering"))
    return found


def speed_of(recording: Recording) -> tuple[Array, Array] | None:
    """Return times (M,), s, and velocities over ground (M, 2), m/s, of the fixes, if any."""
    t, fix = recording.samples(*FIX)
    if len(t) < SAMPLES_MIN:
        return None
    way, middle, step = ways(t, fix)
    known = np.isfinite(way).all(axis=1)
    return (middle[known], way[known] / step) if known.any() else None


def _shaft_unit(
    recording: Recording, name: str, n: Array, at: Array, speed: Array, particulars: Particulars
) -> list[Finding]:
    """Return a finding about shaft speeds in another unit, by the way that a turn makes."""
    typical = float(np.quantile(np.abs(n[n != 0.0]), 0.95))
    turns = averaged(recording.t, np.abs(n).mean(axis=1), at, 2.0 * float(np.median(np.diff(at))))
    fast = (speed > 0.5 * speed.max()) & (turns > 0.5 * np.nanmax(turns, initial=0.0))
    times = max(typical / particulars.shaft_speed, 1.0)  # a boat that rests: by size alone
    if fast.sum() >= ENOUGH // 2:
        advance = float(np.quantile(speed[fast] / turns[fast], 0.75))
        times = particulars.speed / particulars.shaft_speed / advance
    if 1.0 / SHAFT_FAR < times < SHAFT_FAR:
        return []
    remedy, severity = "state it in the mapping: scale = ... for shares and per cent", WARNING
    unit = "another unit"
    for known, factor, how in (
        ("rpm", 60.0, 'unit = "rpm" in the mapping'),
        ("rad/s", 2.0 * math.pi, 'unit = "radps" in the mapping'),
    ):
        if 1.0 / SHAFT_NEAR < times / factor < SHAFT_NEAR:
            unit, remedy, severity = known, how, ERROR
    if n.min() > 0.5 * n.max() > SHAFT_FAR * particulars.shaft_speed:
        unit, severity = "pulse widths", ERROR
        remedy = "make neutral 0: scale = 0.02, offset = -30.0 for 1500 us"
    what = f"{name}: up to {typical:.4g}, {times:.3g} times too large: {unit}"
    remedy += ", or correct speed and shaft_speed in the particulars"
    return [Finding(severity, "unit", what, remedy, "shafts", times)]
