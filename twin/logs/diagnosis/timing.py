"""Time: order, rate, gaps, jitter, and sensors that stop."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from twin.channels import MEASUREMENTS
from twin.logs.clock import SORT, set_back, stood_in_gap
from twin.logs.columns import Array
from twin.logs.diagnosis.findings import ERROR, NOTE, WARNING, Finding, Recording, repeated
from twin.logs.diagnosis.signals import ENOUGH, robust_sd, runs_of

__all__ = [
    "GAP_STEPS",
    "SENSORS",
    "STALE",
    "check_timing",
    "is_gap",
    "longest_gap",
    "sensor_rates",
    "stale_spans",
]

GAP_STEPS = 5.0
"""A longer step of time is a gap, in median steps."""

_SKIP_STEPS = 2.5
"""A longer step, up to a gap, has skipped rows."""

_JITTER = 0.05
"""Steps that spread by more than this share of the median one jitter."""

_SLOW_STEP = 5.0
"""Longest regular step between a logger's rows, s."""

_OUTAGE_SAMPLES, _OUTAGE = 10.0, 2.0
"""A sensor is lost when it is silent for so many of its intervals and so many seconds."""

STALE = 0.5
"""Longest time over which a working sensor of a moving boat repeats itself to the last digit, s."""

_LONG, _MISSED = 10.0, 0.2
"""A yaw rate that stays the same for longer than this, s, while the compass turns by more than
this besides, rad, stands still."""

_JUMPS = {"fix": 2.0, "velocity": 0.3, "compass": 0.1, "gyro": 0.05, "accelerometers": 0.1}
"""Least jump of a sensor that goes on after it was frozen."""

SENSORS = {
    "fix": ("gps_x_m", "gps_y_m"),
    "velocity": ("gps_vx_mps", "gps_vy_mps"),
    "compass": ("compass_rad",),
    "gyro": ("gyro_radps",),
    "accelerometers": ("accel_x_mps2", "accel_y_mps2"),
    "wind": ("wind_mps", "wind_from_rad"),
}
"""Sensors and the columns that come together."""

TILT_SENSORS = {
    "roll and pitch gyros": ("gyro_x_radps", "gyro_y_radps"),
    "vertical accelerometer": ("accel_z_mps2",),
    "AHRS": ("ahrs_roll_rad", "ahrs_pitch_rad"),
    "height": ("gps_z_m",),
    "vertical speed": ("gps_vz_mps",),
}
"""Those of roll, pitch and heave, which few boats have."""


def is_gap(t: Array) -> npt.NDArray[np.bool_]:
    """Return which steps of time are gaps, shape (N - 1,)."""
    step = np.diff(t)
    return np.asarray(step > GAP_STEPS * np.median(step))


def longest_gap(t: Array, valid: npt.NDArray[np.bool_]) -> tuple[float, float]:
    """Return length and start of the longest run of rows without a sample, s."""
    edge = np.diff(np.concatenate(([1], valid.astype(np.int8), [1])))
    first, after = np.flatnonzero(edge == -1), np.flatnonzero(edge == 1)
    # A run lasts until the next sample; at the end of the log, for one step beyond it.
    until = np.append(t, t[-1] + np.median(np.diff(t)))[after]
    longest = int(np.argmax(until - t[first]))
    return float(until[longest] - t[first[longest]]), float(t[first[longest]])


def sensor_rates(recording: Recording) -> dict[str, float]:
    """Return new samples a second of each sensor, from the median interval; 0 for none.

    Sensors of roll, pitch and heave are left out where there are none.
    """
    rates = {}
    for sensor, names in SENSORS.items():
        at = recording.samples(*names)[0]
        rates[sensor] = 1.0 / float(np.median(np.diff(at))) if len(at) > 1 else 0.0
    for sensor, names in TILT_SENSORS.items():
        at = recording.samples(*names)[0]
        if len(at) > 1:
            rates[sensor] = 1.0 / float(np.median(np.diff(at)))
    return rates


def check_timing(recording: Recording) -> list[Finding]:
    """Return what is wrong with the times of a log and of its sensors."""
    found = _order(recording.stamps, recording.clashes)
    t = recording.t
    if len(t) < ENOUGH:
        return found
    step = np.diff(t)
    median = float(np.median(step))
    if median >= _SLOW_STEP:
        found.append(
            Finding(
                WARNING,
                "time-unit",
                f"rows are {median:.4g} s apart",
                'if t_s counts milliseconds, give it unit = "ms" in a mapping file',
                {"median_step_s": median},
            )
        )
    found += _gaps(recording, step, median) + _jitter(step, median)
    found += _stale(recording)
    for sensor, names in SENSORS.items():
        found += _outages(recording, sensor, names)
    return found


def _order(stamps: Array, clashes: int) -> list[Finding]:
    """Return findings about times that are empty, equal or go back.

    Of the equal ones, ``clashes`` rows contradict the row before.
    """
    found = []
    empty = int((~np.isfinite(stamps)).sum())
    if empty:
        found.append(
            Finding(
                ERROR,
                "time-empty",
                f"{empty} of {len(stamps)} rows have no time",
                "fill in the time or remove these rows",
                {"rows": empty},
            )
        )
    valid = stamps[np.isfinite(stamps)]
    step = np.diff(valid)
    back = step < 0.0
    if back.any():
        found.append(_back(stamps, valid, step))
    equal = int((step == 0.0).sum())
    if equal:
        found.append(_equal(valid, equal, clashes))
    return found


def _back(stamps: Array, valid: Array, step: Array) -> Finding:
    """Return the finding about a clock that was set back, or rows out of order."""
    row, times = int(np.argmin(step)), int((step < 0.0).sum())
    evidence = {"times": float(times), "most_s": float(-step[row])}
    steps = set_back(stamps)
    if steps:
        first, seconds = max(steps, key=lambda each: each[1])
        before = stamps[:first][np.isfinite(stamps[:first])][-1]
        what = f"the clock was set back by {seconds:.2f} s at t = {before:.1f} s"
        what += f"; {times} times in all" if times > 1 else ""
        remedy = f"add {seconds:.2f} s to all later stamps; the rest is checked as if they had it"
        evidence["set_back_s"] = seconds
        return Finding(ERROR, "time-back", what, remedy, evidence)
    what = (
        f"time goes back {times} time(s), at most by {-step[row]:.3g} s (at t = {valid[row]:.1f} s)"
    )
    remedy = f"{SORT}, or cut the log where it starts again"
    return Finding(ERROR, "time-back", what, remedy, evidence)


def _equal(valid: Array, equal: int, clashes: int) -> Finding:
    """Return the finding about rows with the time of the row before."""
    what = f"{equal} of {len(valid)} rows have the time of the row before"
    evidence = {"rows": float(equal), "clashes": float(clashes)}
    if not clashes:
        remedy = "they do not contradict it, and are merged with it when the log is read"
        return Finding(NOTE, "time-equal", what, remedy, evidence)
    if 2 * equal > len(valid):
        what += ", as times in whole seconds do"
    what += f"; {clashes} of them have other values"
    remedy = "record fractions of a second, or keep one row of each time"
    return Finding(ERROR, "time-equal", what, remedy, evidence)


def _gaps(recording: Recording, step: Array, median: float) -> list[Finding]:
    """Return findings about gaps and skipped rows."""
    found, t = [], recording.t
    gap = is_gap(t)
    if gap.any():
        row = int(np.argmax(step))
        remedy = "the twin forecasts across them; check what stopped the logger"
        fixes = recording.samples("gps_x_m", "gps_y_m")
        if stood_in_gap(*fixes, float(t[row]), float(t[row + 1])):
            remedy += ", or the clock was set forward: the boat did not move meanwhile"
        found.append(
            Finding(
                WARNING,
                "time-gaps",
                f"{gap.sum()} gap(s) in time above {GAP_STEPS:.0f} x the median step, the longest "
                f"{step[row]:.1f} s at t = {t[row]:.1f} s",
                remedy,
                {
                    "gaps": float(gap.sum()),
                    "longest_s": float(step[row]),
                    "at_s": float(t[row]),
                    "total_s": float(step[gap].sum()),
                },
            )
        )
    skipped = (step > _SKIP_STEPS * median) & ~gap
    if skipped.any():
        found.append(
            Finding(
                WARNING,
                "time-skips",
                f"{skipped.sum()} step(s) of up to {step[skipped].max():.2f} s among steps of "
                f"{median:.3g} s: rows are missing",
                "harmless if few; a logger that is too busy drops rows",
                {"steps": float(skipped.sum()), "longest_s": float(step[skipped].max())},
            )
        )
    return found


def _jitter(step: Array, median: float) -> list[Finding]:
    """Return a finding where the stamps of the rows jitter."""
    spread = robust_sd(step[step < _SKIP_STEPS * median])
    if spread < _JITTER * median:
        return []
    return [
        Finding(
            WARNING,
            "time-jitter",
            f"the stamps of the rows jitter: steps of {median:.3g} s spread by {spread:.2g} s",
            "stamp samples when they are taken, not when they are written",
            {"median_step_s": median, "sd_s": spread},
        )
    ]


def stale_spans(recording: Recording) -> list[float]:
    """Return how long, in s, all sensors repeat themselves at once, each time that they do."""
    finite = np.isfinite(recording.z)
    moving = [
        j
        for j in range(len(MEASUREMENTS))
        if finite[:, j].mean() > 0.8 and np.mean(np.diff(recording.z[finite[:, j], j]) == 0.0) < 0.5
    ]
    if len(moving) < 2:
        return []
    z = recording.z[:, moving]
    same = np.zeros(len(z), dtype=np.bool_)
    same[1:] = (z[1:] == z[:-1]).all(axis=1)
    t = recording.t
    return [float(t[j - 1] - t[i - 1]) for i, j in runs_of(same)]


def _stale(recording: Recording) -> list[Finding]:
    """Return a finding where all sensors repeat themselves at once: the logger did."""
    stands = stale_spans(recording)
    long = [length for length in stands if length > STALE]
    if not long:
        return []
    return [
        Finding(
            WARNING,
            "stale-rows",
            f"all sensors repeat their last values at once for up to {max(long):.1f} s, "
            f"{len(long)} time(s) longer than {STALE:g} s, {sum(stands):.0f} s in all",
            "the logger wrote old samples with new times, so gyro and compass jump; log each "
            "sample once, with its own time",
            {"longest_s": max(long), "times": float(len(long)), "total_s": sum(stands)},
        )
    ]


def _outages(recording: Recording, sensor: str, names: tuple[str, ...]) -> list[Finding]:
    """Return findings where a sensor that works is silent for long, or repeats itself."""
    valid = np.isfinite(recording.z[:, [MEASUREMENTS.index(name) for name in names]]).all(axis=1)
    at = recording.t[valid]
    if len(at) < ENOUGH:
        return []
    edges = np.concatenate(([recording.t[0]], at, [recording.t[-1]]))
    silence = np.diff(edges)
    # gaps that the clock skipped are reported for the clock
    step = np.diff(recording.t)
    clock = np.append(0.0, np.cumsum(np.where(is_gap(recording.t), step, 0.0)))
    silence = silence - np.diff(np.interp(edges, recording.t, clock))
    bound = max(_OUTAGE_SAMPLES * float(np.median(np.diff(at))), _OUTAGE)
    lost = silence > bound
    found = []
    if lost.any():
        row = int(np.argmax(silence))
        found.append(
            Finding(
                WARNING,
                f"{sensor}-lost",
                f"{recording.called(*names)}: no {sensor} sample for up to {silence[row]:.1f} s "
                f"(from t = {edges[row]:.1f} s), {lost.sum()} time(s) longer than {bound:.1f} s",
                "the twin bridges it and grows unsure; expect wider intervals there",
                {
                    "longest_s": float(silence[row]),
                    "at_s": float(edges[row]),
                    "times": float(lost.sum()),
                    "total_s": float(silence[lost].sum()),
                },
            )
        )
    return found + _frozen(recording, sensor, names, bound)


def _frozen(
    recording: Recording, sensor: str, names: tuple[str, ...], bound: float
) -> list[Finding]:
    """Return a finding where a sensor repeats a value for long, unlike itself: it stopped."""
    columns = [MEASUREMENTS.index(name) for name in names]
    valid = np.isfinite(recording.z[:, columns]).all(axis=1)
    at, values = recording.t[valid], recording.z[valid][:, columns]
    stands = [(i, j) for i, j in runs_of(repeated(values)) if at[j - 1] - at[i - 1] > bound]
    if not stands:
        return []
    if sensor == "compass":
        values = np.unwrap(values, axis=0)
    new = values[~repeated(values)]
    common = float(np.median(np.hypot.reduce(np.diff(new, axis=0), axis=1))) if len(new) > 1 else 0
    least = max(_JUMPS.get(sensor, 0.0), 8.0 * common)
    # a sensor that never repeats itself otherwise is frozen even without a jump
    same = repeated(values)
    long = sum(j - i for i, j in stands)
    strict = int(same.sum()) - long < 0.02 * len(same)
    jumped = [
        (i, j)
        for i, j in stands
        if strict
        or (j < len(at) and float(np.hypot.reduce(values[j] - values[j - 1])) > least)
        or (sensor == "gyro" and _missed(recording, at[i - 1], at[j - 1], values[i, 0]) > _MISSED)
    ]
    if not jumped:
        return []
    length = [float(at[j - 1] - at[i - 1]) for i, j in jumped]
    worst = int(np.argmax(length))
    start = float(at[jumped[worst][0] - 1])
    return [
        Finding(
            WARNING,
            f"{sensor}-frozen",
            f"{recording.called(*names)}: the same {sensor} value for up to {length[worst]:.1f} s "
            f"(from t = {start:.1f} s), {len(jumped)} time(s)",
            "the sensor had stopped: empty these cells",
            {"longest_s": length[worst], "at_s": start, "times": float(len(jumped))},
        )
    ]


def _missed(recording: Recording, start: float, end: float, rate: float) -> float:
    """Return by how much the compass turns over a long time beyond a constant rate, rad."""
    t, compass = recording.samples("compass_rad")
    psi = np.unwrap(compass[:, 0])
    within = (t >= start) & (t <= end)
    if end - start < _LONG or within.sum() < ENOUGH:
        return 0.0
    return float(np.ptp(psi[within] - rate * t[within]))
