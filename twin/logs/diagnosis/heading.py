"""Heading and yaw rate: compass against gyro, degrees, steps, sensors that are dead."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from twin.channels import MEASUREMENTS
from twin.logs.columns import Array
from twin.logs.diagnosis.findings import ERROR, NOTE, WARNING, Finding, Recording
from twin.logs.diagnosis.signals import (
    ENOUGH,
    Lag,
    best_lag,
    fit_line,
    integrated,
    robust_sd,
    sampled,
    white_noise,
)
from twin.logs.diagnosis.timing import STALE, stale_spans
from twin.logs.diagnosis.track import SURE, check_track, compass_on_track, thrust

__all__ = [
    "DEGREE",
    "GyroFit",
    "check_dead",
    "check_heading",
    "compass_in_degrees",
    "dead_columns",
    "gyro_lag",
    "gyro_on_compass",
    "is_late",
    "turn_ratio",
]

DEGREE = math.pi / 180.0

TURN = 2.0 * math.pi

_WINDOW = 2.0
"""Turning is compared over so many seconds."""

_LATE = 2.0
"""Largest lag between gyro and compass that is looked for, s."""

_LAG_GAIN = 1.4
"""A lag is one if without it so many times as much is left unexplained."""

_QUICK = 0.05
"""Turns over a window that spread by less, rad, tell nothing of a delay."""

_SEEN, _SURE = 3.0, 4.0
"""Turns are seen from so many times the noise on; a scale is sure within so many of its sd."""

_ZERO = 0.02
"""Zero of a gyro that a steady turn cannot tell from its scale, rad/s."""

_DEVIATION = math.radians(4.0)
"""A compass is off by about this from heading to heading, rad: on few headings that is scale."""

_SCALE, _BIAS, _LAG = 0.1, 0.01, 0.15
"""Errors of a gyro that are worth a word: of scale, of zero (rad/s), of time (s)."""

_SHORT, _STRETCH = 0.5, 5.0
"""Gyro and compass must agree over half a second, in each stretch of so many, s ..."""

_DISAGREE, _DISAGREE_NOISE, _DISAGREE_SHARE = 0.05, 3.0, 0.5
"""... within this (rad/s), so many times what their noise explains, and this share of the rate."""

_STEP, _STEP_NOISE = math.radians(4.0), 15.0
"""A compass that steps by more than this (rad) and so many times its noise has jumped."""


class GyroFit(NamedTuple):
    """How a gyro measures the turning that a compass shows: rate = (1/slope) (gyro - bias)."""

    scale: float
    """Gyro over compass; below 0 for a wrong sign."""
    scale_sd: float
    bias: float
    """Of the gyro, rad/s."""
    bias_sd: float
    lag: float
    """By which the gyro is late, s; below 0: the compass is; 0 where they do not tell."""
    correlation: float
    """Of the turns over windows."""
    turned: float
    """Standard deviation of these turns, rad; of a steady turn, their root mean square ..."""
    blurred: float
    """... and what the noise of both adds to one."""
    swing: float
    """Standard deviation of the heading, rad."""
    disagree: float
    """Standard deviation of gyro less compass over half a second, rad/s ..."""
    expected: float
    """... and what the noise of both explains."""
    worst: float
    """The same in the stretch of 5 s where they disagree most ..."""
    worst_at: float
    """... its time, s ..."""
    worst_turn: float
    """... and the larger of their rates there, rad/s."""


def gyro_on_compass(t_compass: Array, compass: Array, t_gyro: Array, gyro: Array) -> GyroFit | None:
    """Return how a gyro agrees with a compass, or None where samples are too few.

    Parameters
    ----------
    t_compass, compass : ndarray, shape (N,)
        Times, s, and headings, rad, wrapped or not.
    t_gyro, gyro : ndarray, shape (M,)
        Times and yaw rates, rad/s.

    Notes
    -----
    Turns of the compass over windows are regressed on the integrated gyro by Huber's loss, after
    their lag is taken out.
    """
    if len(compass) < ENOUGH or len(gyro) < ENOUGH:
        return None
    psi, theta = np.unwrap(compass), integrated(t_gyro, gyro)
    compass_noise = white_noise(t_compass, psi)
    # of the integral over a second
    gyro_noise = white_noise(t_gyro, gyro) * math.sqrt(float(np.median(np.diff(t_gyro))))
    coarse: float = max(float(np.median(np.diff(t_compass))), float(np.median(np.diff(t_gyro))))
    start, end = max(t_compass[0], t_gyro[0]), min(t_compass[-1], t_gyro[-1])
    window = float(max(_WINDOW, 6.0 * coarse))
    if end - start < 10.0 * window:
        return None

    found = _lag(t_compass, psi, t_gyro, theta)
    late = found.seconds if found is not None and is_late(found) else 0.0

    at = np.arange(start + 0.5 * window, end - 0.5 * window, 0.5 * window)
    x, y = _turned(t_compass, psi, window, at), _turned(t_gyro, theta, window, at + late)
    ok = np.isfinite(x) & np.isfinite(y)
    if ok.sum() < 10:
        return None
    x, y = x[ok], y[ok]
    # windows overlap by half: the standard deviations are those of fewer points
    if math.sqrt(2.0) * compass_noise > gyro_noise * math.sqrt(window):
        line = fit_line(y, x)
        scale = 1.0 / line.slope if line.slope != 0.0 else math.inf
        scale_sd, bias = 1.5 * line.slope_sd * scale**2, -line.offset * scale
    else:
        line = fit_line(x, y)
        scale, scale_sd, bias = line.slope, 1.5 * line.slope_sd, line.offset
    short = float(max(_SHORT, 2.0 * coarse))
    at = np.arange(start + short, end - short, 0.5 * short)
    rate = _turned(t_compass, psi, short, at) / short
    left = _turned(t_gyro, theta, short, at + late) / short - rate
    known = left[np.isfinite(left)]
    width = max(round(_STRETCH / (0.5 * short)), 1)
    rough, turning = (
        _local(left, width),
        np.maximum(_local(rate, width), _local(left + rate, width)),
    )
    bad = int(np.argmax(np.where(rough > _DISAGREE_SHARE * turning, rough, 0.0)))
    noise = math.hypot(math.sqrt(2.0) * compass_noise / short, gyro_noise / math.sqrt(short))
    # noise of a gyro in degrees is in degrees too
    own = gyro_noise * math.sqrt(window) / max(abs(scale), 1.0)
    blurred = math.hypot(math.sqrt(2.0) * compass_noise, own)
    both = float(np.corrcoef(x, y)[0, 1]) if min(np.std(x), np.std(y)) > 0.0 else 0.0
    bias, bias_sd = bias / window, 1.5 * line.offset_sd / window
    turned, size = float(np.std(x)), math.sqrt(float((x**2).mean()))
    if turned < _SEEN * blurred < size:
        # in a steady turn, zero and scale of the gyro are one: most of it is scale
        power = math.sqrt(float((y**2).mean()))
        scale, both = float(x @ y) / float(x @ x), float((x * y).mean()) / max(size * power, 1e-300)
        spread = float(np.std(y - scale * x)) / math.sqrt(0.5 * len(x))
        scale_sd, turned = math.hypot(_ZERO * window, spread) / size, size
        sure = abs(scale - 1.0) > _SURE * scale_sd
        bias, bias_sd = (0.0, _ZERO) if sure else (float((y - x).mean()) / window, spread / window)
    return GyroFit(
        scale,
        scale_sd,
        bias,
        bias_sd,
        late,
        both,
        turned,
        blurred,
        float(np.std(psi)),
        float(np.std(known)) if len(known) else math.nan,
        noise,
        float(rough[bad]),
        float(at[bad]),
        float(turning[bad]),
    )


def gyro_lag(t_compass: Array, compass: Array, t_gyro: Array, gyro: Array) -> Lag | None:
    """Return by how much a gyro is later than a compass, with the correlation at each lag.

    Parameters
    ----------
    t_compass, compass, t_gyro, gyro : ndarray
        As for :func:`gyro_on_compass`.
    """
    if len(compass) < ENOUGH or len(gyro) < ENOUGH:
        return None
    return _lag(t_compass, np.unwrap(compass), t_gyro, integrated(t_gyro, gyro))


def is_late(lag: Lag) -> bool:
    """Return whether a lag between gyro and compass is one, and no accident."""
    clear = abs(lag.correlation) > 0.7 and abs(lag.seconds) > 4.0 * lag.sd
    return clear and lag.gain > _LAG_GAIN


def _turned(t: Array, angle: Array, width: float, at: Array) -> Array:
    """Return by how much an angle turns over a width around other times."""
    return sampled(t, angle, at + 0.5 * width) - sampled(t, angle, at - 0.5 * width)


def _lag(t_compass: Array, psi: Array, t_gyro: Array, theta: Array) -> Lag | None:
    """Return the lag of an integrated gyro behind an unwrapped compass."""
    coarse = max(float(np.median(np.diff(t))) for t in (t_compass, t_gyro))
    start, end = max(t_compass[0], t_gyro[0]), min(t_compass[-1], t_gyro[-1])
    width = 0.5 * max(_WINDOW, 6.0 * coarse)
    if end - start < 20.0 * width:
        return None
    return best_lag(
        lambda at: _turned(t_compass, psi, width, at),
        lambda at: _turned(t_gyro, theta, width, at),
        np.arange(start, end, max(coarse, 0.02)),
        most=min(_LATE, 0.2 * float(end - start)),
        width=width,
    )


def _local(values: Array, width: int) -> Array:
    """Return the root mean square of values around each, without those that are NaN."""
    square = np.where(np.isfinite(values), values, 0.0) ** 2
    count = np.convolve(np.isfinite(values), np.ones(width), "same")
    return np.asarray(np.sqrt(np.convolve(square, np.ones(width), "same") / np.maximum(count, 1)))


def turn_ratio(t_compass: Array, psi: Array, t_gyro: Array, gyro: Array) -> float:
    """Return how many times as fast a gyro turns as a heading; 0 where they turn otherwise.

    Parameters
    ----------
    t_compass, psi : ndarray, shape (N,)
        Times, s, and headings, rad, wrapped or not.
    t_gyro, gyro : ndarray, shape (M,)
        Times and yaw rates.
    """
    grid = coarse_grid(t_compass)
    by_gyro = np.diff(np.interp(grid, t_gyro, integrated(t_gyro, gyro)))
    by_compass = np.diff(np.interp(grid, t_compass, np.unwrap(psi)))
    both, square = float(by_compass @ by_gyro), float(by_compass @ by_compass)
    similar = both > 0.9 * math.sqrt(square * float(by_gyro @ by_gyro))
    return float(both / max(square, 1e-9)) if similar else 0.0


def coarse_grid(t: Array) -> Array:
    """Return times 2 s apart, or ten steps if those are longer."""
    step = max(2.0, 10.0 * float(np.median(np.diff(t))), (t[-1] - t[0]) / 1e5)
    return np.arange(t[0], t[-1], step)


def compass_in_degrees(
    compass: tuple[Array, Array], fix: tuple[Array, Array], gyro: tuple[Array, Array]
) -> str:
    """Return why headings taken as radians must be degrees, or nothing.

    Parameters
    ----------
    compass, fix, gyro : tuple of ndarray
        Times (N,) and samples: headings (N,), positions (N, 2), yaw rates (N,).
    """
    at, heading = compass
    if len(heading) < ENOUGH or np.abs(heading).max() <= 2.1 * math.pi:
        return ""
    if len(fix[0]) >= ENOUGH:
        grid = coarse_grid(fix[0])
        way = np.diff([np.interp(grid, fix[0], column) for column in fix[1].T])
        psi = heading[np.searchsorted(at, grid[1:]).clip(max=len(at) - 1)]
        length, course = np.hypot(*way), np.arctan2(way[1], way[0])
        ahead = [
            length @ np.cos(scale * psi - course) / max(length.sum(), 1e-9)
            for scale in (1.0, DEGREE)
        ]
        if ahead[0] < 0.5 and ahead[1] > 0.9:
            return "taken as degrees the boat goes where it points, as radians not"
    if len(gyro[0]) >= ENOUGH:
        times = turn_ratio(at, heading, *gyro)
        if not 0.5 < times < 2.0 and 0.5 < turn_ratio(at, DEGREE * heading, *gyro) < 2.0:
            return "taken as degrees it turns as the yaw rate says, as radians not"
    return ""


def check_heading(recording: Recording, commands: int = 0) -> list[Finding]:
    """Return what is wrong with compass and gyro, by each other and by the track.

    Parameters
    ----------
    recording : Recording
        To be checked.
    commands : int
        1 where the commands turn the boat as the compass says, -1 against it, 0 where they do not
        tell.
    """
    at, values = recording.samples("compass_rad")
    compass = at, values[:, 0]
    t_fix, fix = recording.samples("gps_x_m", "gps_y_m")
    t_gyro, rates = recording.samples("gyro_radps")
    gyro = t_gyro, rates[:, 0]
    if len(at) < ENOUGH:
        return []
    degrees = _beyond_a_turn(recording, compass, (t_fix, fix), gyro)
    if any(finding.severity == ERROR for finding in degrees):
        compass = at, DEGREE * compass[1]
    steps = _steps(recording, compass)
    fit = gyro_on_compass(*compass, *gyro)
    by_gyro = _gyro(recording, fit, _as_logged(recording), bool(steps))
    against = [finding for finding in by_gyro if finding.code == "gyro-sign"]
    sees = fit is not None and fit.turned > _SEEN * fit.blurred and fit.correlation > 0.8
    track = check_track(recording, (t_fix, fix), compass, -1 if against else int(sees), commands)
    mirrored = any(finding.code == "track-mirrored" for finding in track)
    if against and (mirrored or (commands < 0 and not _is_plain(recording, compass))):
        # two against one: the compass is the one that is wrong
        by_gyro = [] if mirrored else [_compass_sign(recording, against[0])]
    return degrees + steps + by_gyro + track


def _is_plain(recording: Recording, compass: tuple[Array, Array]) -> bool:
    """Return whether the track turns as a compass does."""
    fit = compass_on_track(recording.samples("gps_x_m", "gps_y_m"), compass, thrust(recording))
    return fit is not None and fit.odds > SURE


def _compass_sign(recording: Recording, against: Finding) -> Finding:
    """Return the finding about a compass that turns against gyro and commands."""
    return Finding(
        ERROR,
        "compass-sign",
        f"{recording.called('compass_rad')}: the compass turns against the gyro and the commands",
        'turn its sign: the heading runs clockwise from north (frame = "enu" in a mapping for one '
        "that runs from east); then check again",
        against.evidence,
    )


def dead_columns(recording: Recording) -> list[int]:
    """Return the columns of ``MEASUREMENTS`` in which all values are equal."""
    found = []
    for j, values in enumerate(recording.z.T):
        seen = values[np.isfinite(values)]
        if len(seen) >= ENOUGH and (seen == seen[0]).all():
            found.append(j)
    return found


def check_dead(recording: Recording) -> list[Finding]:
    """Return findings about columns in which all values are equal."""
    found = []
    for j in dead_columns(recording):
        values = recording.z[np.isfinite(recording.z[:, j]), j]
        what = f"{recording.called(MEASUREMENTS[j])}: all {len(values)} values are {values[0]:.6g}"
        remedy = "a dead sensor: empty its cells or remove the column"
        found.append(Finding(ERROR, "sensor-dead", what, remedy, {"value": float(values[0])}))
    return found


def _beyond_a_turn(
    recording: Recording,
    compass: tuple[Array, Array],
    fix: tuple[Array, Array],
    gyro: tuple[Array, Array],
) -> list[Finding]:
    """Return a finding where a compass is beyond a turn: in degrees, unwrapped, or either."""
    most = float(np.abs(compass[1]).max())
    name = recording.called("compass_rad")
    if most <= TURN + 1e-6:
        return []
    why = compass_in_degrees(compass, fix, gyro) or _steps_of_degrees(compass[1])
    if why:
        return [
            Finding(
                ERROR,
                "compass-degrees",
                f"{name}: |compass| up to {most:.4g} rad; {why}",
                'name the column compass_deg (in a mapping: unit = "deg")',
                {"most_rad": most},
            )
        ]
    track = compass_on_track(fix, compass)
    turns = gyro_on_compass(*compass, *gyro)
    sound = (track is not None and track.along > 0.9 and track.headings < 0.9) or (
        turns is not None and turns.correlation > 0.9
    )
    return [
        Finding(
            NOTE if sound else WARNING,
            "compass-beyond-turn",
            f"{name}: |compass| up to {most:.4g} rad, more than a turn"
            + (": unwrapped, as track or gyro confirm" if sound else ""),
            "no harm" if sound else "if these are degrees, name the column compass_deg",
            {"most_rad": most},
        )
    ]


def _steps_of_degrees(heading: Array) -> str:
    """Return a reason where a heading steps by 360 as it passes north."""
    step = np.abs(np.diff(heading))
    wild = (step > 2.1 * math.pi) & (np.abs(step - 360.0) < 30.0)
    return f"it steps by {step[wild].max():.4g} as degrees do at north" if wild.any() else ""


def _as_logged(recording: Recording) -> GyroFit | None:
    """Return how gyro and compass agree in all rows, where many repeat old samples; else None."""
    if max(stale_spans(recording), default=0.0) <= STALE:
        return None
    compass, gyro = recording.z[:, 4], recording.z[:, 5]
    rows, turns = np.isfinite(compass), np.isfinite(gyro)
    return gyro_on_compass(recording.t[rows], compass[rows], recording.t[turns], gyro[turns])


def _gyro(
    recording: Recording, fit: GyroFit | None, logged: GyroFit | None, steps: bool
) -> list[Finding]:
    """Return findings about a gyro that does not measure what the compass shows.

    ``logged`` compares all rows, also those that repeat old samples.
    """
    if fit is None:
        return []
    name, evidence = recording.called("gyro_radps"), fit._asdict()
    found = []
    clear = fit.turned > _SEEN * fit.blurred and abs(fit.correlation) > 0.8
    margin = max(_SURE * fit.scale_sd, _DEVIATION / max(fit.swing, 1e-9))
    if clear and fit.scale < 0.0 and 1.0 - fit.scale > _SURE * fit.scale_sd:
        found.append(
            Finding(
                ERROR,
                "gyro-sign",
                f"{name}: the gyro turns against the compass (scale {fit.scale:.2f})",
                "turn its sign: scale = -1.0 in a mapping file; above 0 is to starboard",
                evidence,
            )
        )
    times = abs(fit.scale)
    if clear and 40.0 < times < 80.0:
        found.append(
            Finding(
                ERROR,
                "gyro-degrees",
                f"{name}: {times:.3g} times the rate at which the heading turns: degrees",
                'name the column gyro_degps (in a mapping: unit = "degps")',
                evidence,
            )
        )
    elif clear and abs(times - 1.0) > max(_SCALE, margin):
        found.append(
            Finding(
                ERROR if not 0.5 < times < 2.0 else WARNING,
                "gyro-scale",
                f"{name}: the gyro turns {times:.3g} times as fast as the compass",
                f"check its unit and scale; scale = {1.0 / times:.4g} in a mapping corrects it",
                evidence,
            )
        )
    if abs(fit.bias) > max(_BIAS, 5.0 * fit.bias_sd) * max(times, 1.0):
        found.append(
            Finding(
                WARNING,
                "gyro-bias",
                f"{name}: the gyro shows {fit.bias:+.3f} rad/s more than the compass turns",
                f"take it off: offset = {-fit.bias:.4g} in a mapping, or gyro_bias_sd = "
                f"{abs(fit.bias):.2g} in the particulars",
                evidence,
            )
        )
    if clear and fit.turned > _QUICK and abs(fit.lag) > _LAG:
        late = "gyro" if fit.lag > 0.0 else "compass"
        found.append(
            Finding(
                WARNING,
                f"{late}-late",
                f"the {late} comes {abs(fit.lag):.2f} s after the "
                f"{'compass' if late == 'gyro' else 'gyro'}",
                "look for a filter in the sensor, or leave the late column out",
                evidence,
            )
        )
    if not any(finding.severity == ERROR for finding in found):
        found += _disagreement(fit, logged, steps)
    return found


def _disagreement(fit: GyroFit, logged: GyroFit | None, steps: bool) -> list[Finding]:
    """Return a finding where gyro and compass differ in samples, or else in rows as logged."""
    wrong = [each for each in (fit, logged) if each is not None and _disagree(each, steps)]
    if not wrong:
        return []
    worst = max(wrong, key=lambda each: each.worst)
    if worst is logged:
        remedy = "rows repeat old samples there and then jump: empty their cells, or raise gyro_sd"
    else:
        remedy = (
            "one of them froze, jumped or failed: look at both there, and empty the false cells "
            "or raise gyro_sd"
        )
    what = (
        f"gyro and compass disagree by {worst.worst:.2g} rad/s around t = {worst.worst_at:.0f} s, "
        f"by {worst.disagree:.2g} in all (standard deviation over half a second; their noise "
        f"explains {worst.expected:.2g})"
    )
    return [Finding(WARNING, "gyro-compass", what, remedy, worst._asdict())]


def _disagree(fit: GyroFit, steps: bool) -> bool:
    bound = max(_DISAGREE, _DISAGREE_NOISE * fit.expected)
    local = fit.worst > bound and fit.worst > _DISAGREE_SHARE * fit.worst_turn
    return fit.disagree > bound or (local and not steps)


def _steps(recording: Recording, compass: tuple[Array, Array]) -> list[Finding]:
    """Return a finding where a compass steps aside and stays there."""
    t, psi = compass[0], np.unwrap(compass[1])
    if len(t) < 3 * ENOUGH:
        return []
    step, width = np.diff(psi), np.diff(t)
    rate = step / width
    # the part of the jump that the steps around it do not explain
    left = step[2:-2] - width[2:-2] * np.median(
        [rate[:-4], rate[1:-3], rate[3:-1], rate[4:]], axis=0
    )
    bound = max(_STEP, _STEP_NOISE * robust_sd(left))
    wild = np.flatnonzero((np.abs(left) > bound) & (width[2:-2] < 5.0 * np.median(width)))
    if not len(wild):
        return []
    most = int(wild[np.argmax(np.abs(left[wild]))])
    degrees, at = math.degrees(abs(left[most])), float(t[most + 3])
    return [
        Finding(
            WARNING,
            "compass-steps",
            f"{recording.called('compass_rad')}: the compass steps by up to {degrees:.0f} degrees "
            f"from one sample to the next (at t = {at:.1f} s), {len(wild)} time(s)",
            "a fault of the sensor or of its filter: empty the false cells",
            {"most_rad": float(abs(left[most])), "at_s": at, "times": float(len(wild))},
        )
    ]
