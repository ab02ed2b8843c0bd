"""Exact rules for the rows of a log: stamps, cells, repetition, leaps, kind of commands."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import numpy.typing as npt

from twin.channels import MEASUREMENTS, MOTION_AT
from twin.integrity.findings import ERROR, NOTE, WARNING, Finding
from twin.logs.checks import GAP_STEPS, is_gap
from twin.logs.clock import SORT, set_back, stood_in_gap
from twin.logs.columns import SHARE, UNITS
from twin.logs.jumps import find_jumps
from twin.logs.recording import Recording, wild_stamps
from twin.logs.signals import ENOUGH, averaged, interpolation_residual, robust_sd, runs_of, ways
from twin.particulars import Particulars

__all__ = [
    "SENSORS",
    "check_cells",
    "check_commands",
    "check_leaps",
    "check_silence",
    "check_time",
    "fix_scatter",
    "sensor_rates",
    "speed_of",
    "without_marks",
]

Array = npt.NDArray[np.float64]

SENSORS = {
    "fix": ("gps_x_m", "gps_y_m"),
    "velocity": ("gps_vx_mps", "gps_vy_mps"),
    "compass": ("compass_rad",),
    "gyro": ("gyro_radps",),
    "accelerometers": ("accel_x_mps2", "accel_y_mps2"),
    "wind": ("wind_mps", "wind_from_rad"),
    "roll and pitch gyros": ("gyro_x_radps", "gyro_y_radps"),
    "vertical accelerometer": ("accel_z_mps2",),
    "AHRS": ("ahrs_roll_rad", "ahrs_pitch_rad"),
    "height": ("gps_z_m",),
    "vertical speed": ("gps_vz_mps",),
}
"""Sensors and the columns that come together."""

ROWS_S = 5.0
"""Rows that are farther apart, in the median, hardly count seconds."""

SKIP_STEPS, JITTER = 2.5, 0.05
"""A longer step, up to a gap, has skipped rows; steps that spread by more of the median jitter."""

HOUR_S = 3600.0

SILENT_S, SILENT_SAMPLES = 2.0, 10.0
"""A sensor is lost when it is silent for so long, and for so many of its intervals."""

STALE_S, DEAD_S = 0.5, 10.0
"""All sensors never repeat themselves at once for longer than the first; none does alone for longer
than the second."""

JUMPS = {"fix": 2.0, "velocity": 0.3, "compass": 0.1, "gyro": 0.05, "accelerometers": 0.1}
"""Least leap of a sensor that goes on after it stood still: m, m/s, rad, rad/s, m/s2."""

MARKS = (999.0, 9999.0, 99999.0, 999999.0)
"""Programs write these numbers, of either sign, where there is no value."""

OUTLIER, LEAP_M, LEAP_RAD = 15.0, 0.1, math.radians(4.0)
"""A leap is so many times the median deviation, and at least so large."""

SINGLE = 0.01
"""Leaps of more than this share of the samples, and more than three, are no single ones."""

SPIKE_M, SPIKE_ROWS = 2.0, 11
"""A spike is that far from the median of so many fixes."""

STAMPS_S = 0.03
"""Stamps of fixes that jitter by more are worth a word."""

HUGE = 1e100
"""No scatter is larger."""

SAILS_M = 20.0
"""A boat that goes farther sails."""

MOST_ANGLE = 1.3
"""Few rudders and drives turn farther, rad."""

SHAFT_FAR = 5.0
"""Speed over shaft speed is that of the particulars within this factor."""


def sensor_rates(recording: Recording) -> dict[str, float]:
    """Return new samples a second of each sensor, from the median interval; 0 for none."""
    rates = {}
    for sensor, names in SENSORS.items():
        at = recording.samples(*names)[0]
        if len(at) > 1 or MEASUREMENTS.index(names[0]) < MOTION_AT:
            rates[sensor] = 1.0 / float(np.median(np.diff(at))) if len(at) > 1 else 0.0
    return rates


def check_time(recording: Recording) -> list[Finding]:
    """Return what is wrong with the stamps of the rows, and with those of the fixes."""
    stamps, t = recording.stamps, recording.t
    found = _order(stamps, recording.clashes)
    if len(t) < ENOUGH:
        return found
    step = np.diff(t)
    median = float(np.median(step))
    if median >= ROWS_S:
        what = f"rows are {median:.4g} s apart"
        remedy = 'if t_s counts milliseconds, give it unit = "ms" in a mapping file'
        found.append(Finding(WARNING, "time-unit", what, remedy, "time", median))
    gap = is_gap(t)
    if gap.any():
        row = int(np.argmax(step))
        remedy = "the twin forecasts across them; check what stopped the logger"
        fixes = recording.samples("gps_x_m", "gps_y_m")
        if stood_in_gap(*fixes, float(t[row]), float(t[row + 1])):
            remedy += ", or the clock was set forward: the boat did not move meanwhile"
        what = (
            f"{gap.sum()} gap(s) in time above {GAP_STEPS:.0f} x the median step, the longest "
            f"{step[row]:.1f} s at t = {t[row]:.1f} s"
        )
        span = {"start": float(t[row]), "end": float(t[row + 1])}
        found.append(Finding(WARNING, "gap", what, remedy, "time", float(step[row]), **span))
    skipped = (step > SKIP_STEPS * median) & ~gap
    if skipped.any():
        most = float(step[skipped].max())
        what = f"{skipped.sum()} step(s) of up to {most:.2f} s among steps of {median:.3g} s"
        remedy = "rows are missing: harmless if few; a logger that is too busy drops rows"
        found.append(Finding(WARNING, "gap", what, remedy, "rows", most))
    spread = robust_sd(step[step < SKIP_STEPS * median])
    if spread > JITTER * median:
        what = f"the stamps of the rows jitter: steps of {median:.3g} s spread by {spread:.2g} s"
        remedy = "stamp samples when they are taken, not when they are written"
        found.append(Finding(WARNING, "jitter", what, remedy, "time", spread))
    along, across, speed = fix_scatter(*recording.samples("gps_x_m", "gps_y_m"))
    late = math.sqrt(max(along**2 - across**2, 0.0)) / max(speed, 1e-9)
    if along > 2.0 * across and late > STAMPS_S:
        what = (
            f"the stamps of the fixes jitter by {late:.2f} s: at {speed:.1f} m/s they scatter by "
            f"{along:.2g} m along the track, {across:.2g} m across it"
        )
        remedy = f"log the time that the receiver states, or set gps_sd to {along:.2g} or more"
        found.append(Finding(WARNING, "jitter", what, remedy, "fix", late))
    return found


def _order(stamps: Array, clashes: int) -> list[Finding]:
    """Return findings about times that are empty, equal or go back."""
    found = []
    wild = wild_stamps(stamps)
    if wild.any():
        row = int(np.argmax(wild))
        what = (
            f"{wild.sum()} stamp(s) are far from all others (row {row + 1}: {stamps[row]:.10g} s)"
        )
        remedy = "the clock was not set there: correct these stamps or remove the rows"
        found.append(Finding(ERROR, "time", what, remedy, "time", float(wild.sum())))
        stamps = stamps[~wild]
    valid = stamps[np.isfinite(stamps)]
    step = np.diff(valid)
    if len(valid) < len(stamps):
        what = f"{len(stamps) - len(valid)} of {len(stamps)} rows have no time"
        remedy = "fill in the time or remove these rows"
        found.append(Finding(ERROR, "time", what, remedy, "time"))
    back = step < 0.0
    if back.any():
        steps, row = set_back(stamps), int(np.argmin(step))
        if steps:
            first, size = max(steps, key=lambda each: each[1])
            what = f"the clock was set back by {size:.2f} s in row {first + 1}"
            remedy = f"add {size:.2f} s to all later stamps; the rest is checked as if they had it"
            if abs(size - HOUR_S) < 2.0 * float(np.median(step[~back])):
                what += ": an hour, as local time is; the clock of the rows is not UTC"
        else:
            size = -float(step[row])
            what = f"time goes back {back.sum()} time(s), by up to {size:.3g} s"
            remedy = f"{SORT}, or cut the log where it starts again"
            if abs(size - HOUR_S) < 5.0 * abs(float(np.median(step))):
                remedy = "an hour: add 3600 s to all later stamps; do not sort the rows"
        found.append(Finding(ERROR, "time", what, remedy, "time", size))
    equal = int((step == 0.0).sum())
    if equal:
        what = f"{equal} of {len(valid)} rows have the time of the row before"
        if not clashes:
            remedy = "they do not contradict it, and are merged with it when the log is read"
            return [*found, Finding(NOTE, "time", what, remedy, "time", float(equal))]
        if 2 * equal > len(valid):
            what += ", as times in whole seconds do"
        what += f"; {clashes} of them have other values"
        remedy = "record fractions of a second, or keep one row of each time"
        found.append(Finding(ERROR, "time", what, remedy, "time", float(equal)))
    return found


def fix_scatter(t: Array, fix: Array) -> tuple[float, float, float]:
    """Return scatter of fixes along and across the track, m, and the speed, m/s; 0 if unknown.

    A stamp that is wrong by dt moves the fix along the track by speed times dt, not across it.
    """
    if len(t) < 3 * ENOUGH:
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
    return min(along, HUGE), min(across, HUGE), float(np.median(speed[fast]))


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
    for name in ("gps_x_m", "compass_rad"):
        count = int(np.isfinite(recording.z[:, MEASUREMENTS.index(name)]).sum())
        if count < ENOUGH:
            what = f"{recording.called(name)}: {count} samples"
            found.append(Finding(ERROR, "missing", what, "position and heading are needed", name))
    if recording.infinite:
        what = f"{recording.infinite} cells are infinite"
        found.append(Finding(ERROR, "mark", what, "leave cells without a value empty", "cells"))
    empty = int(np.isnan(recording.cmd).any(axis=1).sum())
    if empty:
        what = f"{empty} of {len(recording.t)} rows come before the first command"
        remedy = "fill in the commands in force, or remove these rows"
        found.append(Finding(WARNING, "missing", what, remedy, "commands"))
    for j, name in enumerate(MEASUREMENTS):
        rows = np.flatnonzero(np.isfinite(recording.z[:, j]))
        values = recording.z[rows, j]
        if len(values) < ENOUGH:
            continue
        given = recording.called(name)
        if (values == values[0]).all():
            what = f"{given}: all {len(values)} values are {values[0]:.6g}"
            remedy = "a dead sensor: empty its cells or remove the column"
            severity = ERROR if j < MOTION_AT else WARNING
            found.append(Finding(severity, "dead", what, remedy, name))
            continue
        found += _repeats(recording, j, rows, values)
    return found + _stale(recording)


def _repeats(
    recording: Recording, j: int, rows: npt.NDArray[np.intp], values: Array
) -> list[Finding]:
    """Return a finding where a column that changes from row to row is the same for long."""
    if j in (0, 1, 4):  # fixes and headings repeat while a boat rests
        return []
    same, t = np.diff(values) == 0.0, recording.t[rows]
    runs = [(i, k) for i, k in runs_of(same) if t[k] - t[i] > DEAD_S and k - i >= ENOUGH]
    if not runs:
        return []
    i, k = max(runs, key=lambda run: t[run[1]] - t[run[0]])
    if np.mean(np.delete(same, slice(i, k))) > 0.5:
        return []
    what = (
        f"{recording.called(MEASUREMENTS[j])}: from t = {t[i]:.1f} to {t[k]:.1f} s all values are "
        f"{values[i]:g}"
    )
    span = {"start": float(t[i]), "end": float(t[k])}
    remedy = "the sensor had stopped: empty these cells"
    return [Finding(WARNING, "frozen", what, remedy, MEASUREMENTS[j], **span)]


def _stale(recording: Recording) -> list[Finding]:
    """Return a finding where all sensors repeat themselves at once: the logger did."""
    finite = np.isfinite(recording.z)
    moving = [
        j
        for j in range(len(MEASUREMENTS))
        if finite[:, j].mean() > 0.8 and np.mean(np.diff(recording.z[finite[:, j], j]) == 0.0) < 0.5
    ]
    if len(moving) < 2:
        return []
    z, t = recording.z[:, moving], recording.t
    same = np.append(False, (z[1:] == z[:-1]).all(axis=1))
    runs = [(float(t[i - 1]), float(t[j - 1])) for i, j in runs_of(same)]
    long = [run for run in runs if run[1] - run[0] > STALE_S]
    if not long:
        return []
    start, end = max(long, key=lambda run: run[1] - run[0])
    what = (
        f"all sensors repeat their last values at once for up to {end - start:.1f} s, {len(long)} "
        f"time(s) longer than {STALE_S:g} s"
    )
    remedy = (
        "the logger wrote old samples with new times: missing time; log each sample once, with its "
        "own time"
    )
    return [Finding(WARNING, "frozen", what, remedy, "rows", end - start, start=start, end=end)]


def check_silence(recording: Recording) -> list[Finding]:
    """Return findings where a sensor that works gives no new sample for long."""
    found = []
    step = np.diff(recording.t)
    # gaps that the clock skipped are reported for the clock
    skipped = np.append(0.0, np.cumsum(np.where(is_gap(recording.t), step, 0.0)))
    for sensor, names in SENSORS.items():
        at, _ = recording.samples(*names)
        if len(at) < ENOUGH:
            continue
        edges = np.concatenate(([recording.t[0]], at, [recording.t[-1]]))
        silence = np.diff(edges) - np.diff(np.interp(edges, recording.t, skipped))
        bound = max(SILENT_SAMPLES * float(np.median(np.diff(at))), SILENT_S)
        lost = silence > bound
        if not lost.any():
            continue
        row = int(np.argmax(silence))
        columns = [MEASUREMENTS.index(name) for name in names]
        inside = (recording.t > edges[row]) & (recording.t < edges[row + 1])
        given = np.isfinite(recording.z[inside][:, columns]).all(axis=1)
        still = len(given) and given.mean() > 0.5
        if still and not _is_frozen(recording, sensor, columns, edges[row : row + 2]):
            continue
        what = (
            f"{recording.called(*names)}: {'the same' if still else 'no'} {sensor} "
            f"{'value' if still else 'sample'} for up to {silence[row]:.1f} s (from t = "
            f"{edges[row]:.1f} s), {lost.sum()} time(s) longer than {bound:.1f} s"
        )
        remedy = "the twin bridges it and grows unsure; expect wider intervals there"
        if still:
            remedy = "the sensor had stopped: empty these cells"
        span = {"start": float(edges[row]), "end": float(edges[row + 1])}
        code = "frozen" if still else "lost"
        found.append(Finding(WARNING, code, what, remedy, sensor, float(silence[row]), **span))
    return found


def _is_frozen(recording: Recording, sensor: str, columns: list[int], span: Array) -> bool:
    """Return whether a sensor that stands still does so by a fault.

    It never repeats itself otherwise, or leaps where it goes on: a coarse one does neither.
    """
    seen = np.isfinite(recording.z[:, columns]).all(axis=1)
    t, values = recording.t[seen], recording.z[seen][:, columns]
    step = np.sqrt((np.diff(values, axis=0) ** 2).sum(axis=1))
    inside = (t[1:] > span[0]) & (t[1:] < span[1])
    others = step[~inside]
    if not len(others) or (np.mean(others == 0.0) < 0.02 and span[1] - span[0] > DEAD_S / 2.0):
        return bool(len(others))
    after = step[(t[1:] >= span[1])][:1]
    moved = others[others > 0.0]
    least = JUMPS.get(sensor, 0.0)
    return bool(len(after) and len(moved) and after[0] > max(least, 8.0 * np.median(moved)))


def check_leaps(recording: Recording) -> list[Finding]:
    """Return findings about fixes that no boat reaches, spikes, and leaps of fixes and heading."""
    t, fix = recording.samples("gps_x_m", "gps_y_m")
    found, names = [], recording.called("gps_x_m", "gps_y_m")
    jumps = find_jumps(t, fix) if len(t) >= ENOUGH else None
    if jumps is not None:
        lost = len(jumps.lost)
        what = (
            f"{names}: {lost} of {len(t)} fixes cannot be reached from the others (a jump of "
            f"{jumps.length:.4g} m at t = {t[jumps.after]:.1f} s)"
        )
        remedy = "single ones are left out when the log is read; else empty these cells"
        severity = WARNING if lost < 0.1 * len(t) else ERROR
        span = {"start": float(t[jumps.lost[0]]), "end": float(t[jumps.lost[-1]])}
        found.append(Finding(severity, "jump", what, remedy, "fix", jumps.length, **span))
        t, fix = np.delete(t, jumps.lost), np.delete(fix, jumps.lost, axis=0)
    found += _spikes(names, t, fix) or _leap(names, "fix", t, fix, LEAP_M, "m")
    at, compass = recording.samples("compass_rad")
    psi = np.unwrap(compass, axis=0)
    return found + _leap(recording.called("compass_rad"), "compass", at, psi, LEAP_RAD, "rad")


def _leap(
    names: str, sensor: str, t: Array, values: Array, least: float, unit: str
) -> list[Finding]:
    """Return a finding where single values step aside and stay there."""
    if len(t) < 3 * ENOUGH:
        return []
    step, width = np.diff(values, axis=0), np.diff(t)
    speed = step / width[:, None]
    # the part of the step that those around it do not explain
    near = np.median([speed[:-4], speed[1:-3], speed[3:-1], speed[4:]], axis=0)
    left = np.sqrt(((step[2:-2] - width[2:-2, None] * near) ** 2).sum(axis=1))
    even = width[2:-2] < 3.0 * float(np.median(width))
    wild = np.flatnonzero((left > max(least, OUTLIER * float(np.median(left)))) & even)
    if not 0 < len(wild) <= max(3, SINGLE * len(t)):
        return []
    most = int(wild[np.argmax(left[wild])])
    at, size = float(t[most + 3]), float(left[most])
    what = (
        f"{names}: leaps by up to {size:.2g} {unit} from one sample to the next (at t = {at:.1f} "
        f"s), {len(wild)} time(s)"
    )
    remedy = "the receiver or filter was corrected: expect errors of this size"
    return [Finding(WARNING, "jump", what, remedy, sensor, size, start=at, end=at)]


def _spikes(names: str, t: Array, fix: Array) -> list[Finding]:
    """Return a finding where fixes jump aside and come back, again and again."""
    if len(t) < 3 * ENOUGH:
        return []
    half = SPIKE_ROWS // 2
    windows = np.lib.stride_tricks.sliding_window_view(fix, SPIKE_ROWS, axis=0)
    far = np.hypot(*(fix[half:-half] - np.median(windows, axis=-1)).T)
    at = t[half:-half]
    near = far <= max(SPIKE_M, OUTLIER * float(np.median(far)))
    if near.sum() < ENOUGH:
        return []
    speed = np.hypot(*np.diff(fix[half:-half][near], axis=0).T) / np.diff(at[near])
    # a turn of a boat that goes fast is no spike
    quick = 4.0 * float(np.quantile(speed, 0.95)) * float(np.median(np.diff(t)))
    wild = np.flatnonzero(~near & (far > quick))
    if len(wild) < 4:
        return []
    most, first, last = float(far[wild].max()), float(at[wild[0]]), float(at[wild[-1]])
    what = f"{names}: {len(wild)} of {len(t)} fixes jump aside by up to {most:.2g} m and back"
    remedy = "reflections or lost satellites: empty these cells"
    return [Finding(WARNING, "jump", what, remedy, "fix", most, start=first, end=last)]


def without_marks(recording: Recording) -> tuple[Recording, list[Finding]]:
    """Return a recording without numbers that stand for "no value", and a finding about each."""
    z, found = recording.z.copy(), []
    factors = sorted({factor for units in UNITS.values() for factor in units.values()})
    speed = np.hypot(recording.z[:, 2], recording.z[:, 3])
    groups = [((name,), recording.z[:, j]) for j, name in enumerate(MEASUREMENTS)]
    # made of speed and course, a mark is in both
    for names, values in [*groups, (("gps_vx_mps", "gps_vy_mps"), speed)]:
        seen, count = np.unique(values[np.isfinite(values)], return_counts=True)
        for value in seen[count >= 3]:
            shown = [
                f * m for f in factors for m in MARKS if abs(abs(value) - f * m) < 1e-9 * f * m
            ]
            others = np.repeat(seen[seen != value], count[seen != value])
            if not shown or len(others) < ENOUGH:
                continue
            low, high = np.quantile(others, [0.01, 0.99])
            if max(low - value, value - high) < high - low:
                continue
            rows = np.abs(values - value) <= 1e-9 * abs(value)
            for name in names:
                z[rows, MEASUREMENTS.index(name)] = np.nan
            mark = next(m for f in factors for m in MARKS if abs(abs(value) - f * m) < 1e-9 * f * m)
            what = (
                f"{recording.called(*names)}: {rows.sum()} of {np.isfinite(values).sum()} values "
                f'are {math.copysign(mark, value):g}, far from all others: a mark for "no value"'
            )
            remedy = "leave these cells empty; here they are left out, and the rest is checked"
            found.append(Finding(ERROR, "mark", what, remedy, names[0], mark))
            break
    return (dataclasses.replace(recording, z=z), found) if found else (recording, [])


def check_commands(recording: Recording, particulars: Particulars | None) -> list[Finding]:
    """Return what is wrong with units and kind of the commands."""
    n, delta = np.nan_to_num(recording.cmd[:, :2]), np.nan_to_num(recording.cmd[:, 2:])
    name, angles = (
        recording.called(*columns)
        for columns in (("n_left_rps", "n_right_rps"), ("delta_left_rad", "delta_right_rad"))
    )
    found, most = [], float(np.abs(delta).max(initial=0.0))
    if most > MOST_ANGLE:
        what = f"{angles}: angles of up to {most:.3g} rad, {math.degrees(most):.0f} degrees"
        remedy = 'if these are degrees, unit = "deg" for the angles in the mapping'
        severity = ERROR if most > math.pi else WARNING
        found.append(Finding(severity, "unit", what, remedy, "steering", most))
    motion = speed_of(recording)
    speed = np.zeros(0), np.zeros(0)
    way = 0.0
    if motion is not None and len(motion[0]) > 1:
        speed = motion[0], np.hypot(*motion[1].T)
        way = float(speed[1].sum() * np.median(np.diff(motion[0])))
    if not n.any():
        what, remedy = f"{name}: all commands are 0, but the boat goes", "record the commands"
        return found + [Finding(ERROR, "missing", what, remedy, "commands")] * (way > SAILS_M)
    for j, side in enumerate(("left", "right")):
        if not n[:, j].any() and way > SAILS_M:
            what = f"n_{side}_rps is 0 in all rows while the boat sails {way:.0f} m"
            remedy = "record this command too; a boat with one shaft only has one column, n_rps"
            found.append(Finding(WARNING, "sides", what, remedy, side))
    if SHARE not in name:
        found += _shaft_unit(recording, name, n, speed, particulars)
    if particulars is not None:
        unequal = float(np.abs(n[:, 0] - n[:, 1]).mean() / max(np.abs(n).mean(), 1e-300))
        fixed, moved = particulars.steering == "differential", float(np.ptp(delta, axis=0).max())
        if fixed and moved > 0.05:
            what, other = f"{angles}: the angle moves, but the thrusters are fixed", "drives"
        elif not fixed and not delta.any() and unequal > 0.05:
            what, other = f"{name}: no angle moves, but the shaft speeds differ", "differential"
        else:
            return found
        remedy = f'steering = "{other}" in the particulars, or other columns in the mapping'
        found.append(Finding(WARNING, "unit", what, remedy, "steering"))
    return found


def speed_of(recording: Recording) -> tuple[Array, Array] | None:
    """Return times (M,), s, and velocities over ground (M, 2), m/s, of the fixes, if any."""
    t, fix = recording.samples("gps_x_m", "gps_y_m")
    if len(t) < 3 * ENOUGH:
        return None
    way, middle, step = ways(t, fix)
    known = np.isfinite(way).all(axis=1)
    return (middle[known], way[known] / step) if known.any() else None


def _shaft_unit(
    recording: Recording,
    name: str,
    n: Array,
    speed: tuple[Array, Array],
    particulars: Particulars | None,
) -> list[Finding]:
    """Return a finding about shaft speeds in another unit: by their size, and the way they make."""
    seen = np.abs(n[n != 0.0])
    typical, most = float(np.quantile(seen, 0.95)), float(seen.max())
    least = float(n.min())
    pulses = least >= 800.0 and most <= 2200.0 and np.ptp(n) > 20.0
    length = None if particulars is None else particulars.length
    stated = None if particulars is None else particulars.shaft_speed
    advance = math.nan
    if len(speed[0]) > 8:
        step = float(np.median(np.diff(speed[0])))
        turns = averaged(recording.t, np.abs(n).mean(axis=1), speed[0], 2.0 * step)
        fast = (speed[1] > 0.4 * speed[1].max()) & (turns > 0.2 * np.nanmax(turns, initial=0.0))
        if fast.sum() >= 5:
            advance = float(np.quantile(speed[1][fast] / turns[fast], 0.75))
    ratio = math.nan
    if particulars is not None and stated is not None:
        ratio = particulars.speed / stated / advance
        if not math.isfinite(ratio):
            ratio = typical / stated  # a boat that rests: by the size of the commands alone
            ratio = 1.0 if ratio < SHAFT_FAR else ratio
    small = advance < (0.008 if length is None else 0.001 * length)
    large = length is not None and advance > 0.6 * length
    scale = {1.0: "shares of full throttle", 100.0: "per cent"}.get(most)
    if stated is None or 1.0 / 2.5 < most / stated < 2.5:
        scale = None
    far = ratio > SHAFT_FAR or ratio < 1.0 / SHAFT_FAR or small or large
    far |= stated is not None and typical > SHAFT_FAR * stated
    if pulses and (far or stated is None):
        what = f"{name}: between {least:.0f} and {most:.0f}, never 0, as pulse widths are"
        remedy = "make neutral 0: scale = 0.02, offset = -30.0 in a mapping file for 1500 us"
        return [Finding(ERROR, "unit", what, remedy, "shafts", ratio)]
    units = {60.0: ("rpm", 'unit = "rpm"'), 2.0 * math.pi: ("rad/s", 'unit = "radps"')}
    for factor, (unit, remedy) in units.items():
        if 0.7 < ratio / factor < 1.4 or 0.7 < ratio * factor < 1.4:
            said = unit if ratio > 1.0 else f"rev/s taken for {unit}"
            what = f"{name}: up to {typical:.4g}, {ratio:.3g} times too large: {said}"
            remedy += " in the mapping, or correct speed and shaft_speed in the particulars"
            return [Finding(ERROR, "unit", what, remedy, "shafts", ratio)]
    if scale is None and not far:
        return []
    what = f"{name}: up to {typical:.4g}" + (f", as {scale} go" if scale else "")
    what += f", {ratio:.2g} times what the particulars say" if ratio == ratio else ""
    remedy = (
        'state the unit in the mapping: unit = "rpm", or scale = ... for shares and per cent; or '
        "correct length, speed and shaft_speed in the particulars"
    )
    sure = scale is not None or small or large or typical > SHAFT_FAR * (stated or math.inf)
    return [Finding(ERROR if sure else WARNING, "unit", what, remedy, "shafts", ratio)]
