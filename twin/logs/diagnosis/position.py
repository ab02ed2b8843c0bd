"""Fixes and speed over ground: noise, jumps, units, stamps, delay."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from twin.logs.columns import Array
from twin.logs.diagnosis.findings import ERROR, WARNING, Finding, Recording
from twin.logs.diagnosis.signals import (
    ENOUGH,
    averaged,
    best_lag,
    integrated,
    interpolation_residual,
    robust_sd,
    ways,
)

__all__ = [
    "Jumps",
    "StampFit",
    "VelocityFit",
    "agrees",
    "check_position",
    "find_jumps",
    "fix_stamps",
    "in_degrees",
    "velocity_on_fixes",
]

_JUMP, _FAST = 50.0, 30.0
"""Between two fixes no boat goes farther than this, m, and this fast, m/s (58 knots)."""

_FAR = 1e9
"""No boat goes farther than this between two fixes, m, whatever the unit."""

_PIECES = 1000
"""Most pieces between jumps that are joined to a track."""

_STAMP_JITTER = 0.03
"""Stamps of fixes that jitter by more than this are worth a word, s."""

_STEP, _STEP_NOISE = 0.1, 15.0
"""A fix that steps by more than this (m) and so many times the median step aside has jumped."""

_SINGLE = 0.01
"""More than this share of the fixes are no single jumps: stamps jitter, or the boat is quick."""

_WINDOW, _SPIKE, _SPIKES = 11, 2.0, 4
"""A fix farther than the second (m) from the median of so many is a spike; fewer than the third are
left to the search for steps."""

_STILL, _STILL_SHARE, _LONG_STILL, _CAUGHT_UP = 0.1, 0.02, 3.0, 1.0
"""Fixes stand still within this, m, or this share of the step that follows; for longer than this,
s; a shorter step, m, catches up with nothing."""

_LATE, _MOST_LATE = 0.25, 3.0
"""A delay between fixes and velocity worth a word, and the largest looked for, s."""

_LAG_GAIN = 1.4
"""A lag is one if without it so many times as much is left unexplained."""

_UNITS = {
    0.514444: "knots read as m/s",
    1.943844: "m/s read as knots",
    0.277778: "km/h read as m/s",
    3.6: "m/s read as km/h",
    0.3048: "feet read as metres in the speed",
    3.28084: "feet read as metres in the position",
    0.01: "cm/s read as m/s",
    1000.0: "positions in mm, or time in ms",
    0.001: "positions in km, or speeds in mm/s",
}
"""Way of the fixes over that of the velocity, and what it stands for."""

_UNIT_NEAR, _RATIO_NEAR = 0.06, 0.15
"""A ratio within this share of a unit's is that unit; within this share of 1 it is sound."""

_AGREES_ANGLE, _AGREES_COHERENCE = math.radians(45.0), 0.7
"""Angle and coherence beyond which a velocity contradicts the track of the fixes."""


class Jumps(NamedTuple):
    """Fixes that no boat can reach from the others."""

    lost: npt.NDArray[np.intp]
    """Their rows."""
    fixes: int
    """How many rows hold a fix."""
    before: int
    """Row of the fix before the first jump ..."""
    after: int
    """... and of that after it."""
    length: float
    """Of the first jump, m."""


def find_jumps(t: Array, fix: Array) -> Jumps | None:
    """Return the fixes that no boat can reach from the others, or None where all can be.

    Parameters
    ----------
    t, fix : ndarray, shape (N,) and (N, 2)
        Times, s, and positions, m; NaN in rows without a fix.
    """
    rows = np.flatnonzero(np.isfinite(fix).all(axis=1))
    if len(rows) < 2:
        return None
    t, fix = t[rows], fix[rows]

    def reached(first: npt.NDArray[np.intp], then: int) -> npt.NDArray[np.bool_]:
        way = np.hypot(*(fix[then] - fix[first]).T)
        return np.asarray(way <= _JUMP + _FAST * (t[then] - t[first]), dtype=np.bool_)

    length = np.hypot(*np.diff(fix, axis=0).T)
    broken = np.flatnonzero(length > _JUMP + _FAST * np.diff(t))
    if not len(broken):
        return None
    # The longest chain of pieces, each of which can be reached from the one before.
    start, end = np.append(0, broken + 1), np.append(broken, len(t) - 1)
    kept = (end - start + 1).astype(np.int64)
    before = np.full(len(start), -1)
    if len(start) <= _PIECES:
        for j in range(1, len(start)):
            chain = np.where(reached(end[:j], int(start[j])), kept[:j], 0)
            best = int(np.argmax(chain))
            if chain[best]:
                kept[j], before[j] = kept[j] + chain[best], best
    good = np.zeros(len(t), dtype=np.bool_)
    piece = int(np.argmax(kept))
    while piece >= 0:
        good[start[piece] : end[piece] + 1] = True
        piece = int(before[piece])
    first = int(broken[0])
    return Jumps(
        rows[~good], len(rows), int(rows[first]), int(rows[first + 1]), float(length[first])
    )


class StampFit(NamedTuple):
    """Noise of fixes along and across the track, from fix to fix."""

    along: float
    across: float
    speed: float
    """Median, m/s."""
    jitter: float
    """Of the stamps, s: what explains more noise along the track than across it."""


def fix_stamps(t: Array, fix: Array) -> StampFit | None:
    """Return the noise of fixes along and across the track; None where the boat hardly moves.

    Parameters
    ----------
    t, fix : ndarray, shape (N,) and (N, 2)
        Times, s, and positions, m.

    Notes
    -----
    A stamp that is wrong by dt moves the fix along the track by speed times dt, not across it.
    """
    if len(t) < 3 * ENOUGH:
        return None
    left = interpolation_residual(t, fix)
    way = fix[4:] - fix[:-4]
    length = np.hypot(*way.T)
    speed = length / (t[4:] - t[:-4])
    fast = (speed > 0.5 * np.median(speed)) & (length > 0.0)
    if fast.sum() < 2 * ENOUGH:
        return None
    ahead = way[fast] / length[fast, None]
    along = robust_sd((left[fast] * ahead).sum(axis=1))
    across = robust_sd(left[fast, 1] * ahead[:, 0] - left[fast, 0] * ahead[:, 1])
    middle = float(np.median(speed[fast]))
    extra = math.sqrt(max(along**2 - across**2, 0.0))
    return StampFit(along, across, middle, extra / middle)


class VelocityFit(NamedTuple):
    """How the way of the fixes goes with the integrated velocity over ground."""

    ratio: float
    """Of their lengths; 0.514 for knots read as m/s."""
    ratio_sd: float
    turned: float
    """Angle from velocity to way, rad."""
    coherence: float
    """Correlation of way and velocity as complex numbers; 1: one ratio and one angle."""
    mirrored: float
    """The same with east and west of the velocity swapped ..."""
    mirror: float
    """... and its angle, rad."""
    lag: float
    """By which the velocity is later than the fixes, s; 0 where they do not tell."""


def velocity_on_fixes(
    fixes: tuple[Array, Array], velocities: tuple[Array, Array]
) -> VelocityFit | None:
    """Return how velocity over ground goes with the fixes; None where there is no way.

    Parameters
    ----------
    fixes : tuple of ndarray, shape (N,) and (N, 2)
        Times, s, and positions, m.
    velocities : tuple of ndarray, shape (M,) and (M, 2)
        Times and velocities north and east, m/s.
    """
    if len(fixes[0]) < ENOUGH or len(velocities[0]) < ENOUGH:
        return None
    way, middle, step = ways(*fixes)
    if len(middle) < 8:
        return None
    t, velocity = velocities
    summed = integrated(t, velocity)
    edges = np.append(middle - 0.5 * step, middle[-1] + 0.5 * step)
    by_velocity = np.diff(averaged(t, summed, edges, 0.5 * step), axis=0)
    # false for NaN too
    ok = (np.abs(way) < _FAR).all(axis=1) & (np.abs(by_velocity) < _FAR).all(axis=1)
    if ok.sum() < 8:
        return None
    a, b = way[ok] @ (1.0, 1j), by_velocity[ok] @ (1.0, 1j)
    size = math.sqrt(float((np.abs(a) ** 2).sum() * (np.abs(b) ** 2).sum()))
    if size == 0.0:
        return None
    along, across = complex(a @ b.conj()) / size, complex(a @ b) / size
    ratio, spread = _complex_slope(a, b)
    if abs(along) < 0.5:  # no common direction: compare lengths only
        ratio = math.sqrt(float((np.abs(a) ** 2).sum() / (np.abs(b) ** 2).sum()))
    return VelocityFit(
        ratio,
        spread,
        float(np.angle(along)),
        abs(along),
        abs(across),
        float(np.angle(across)),
        _lag_of_velocity(fixes, (t, summed)),
    )


def _complex_slope(a: npt.NDArray[Any], b: npt.NDArray[Any]) -> tuple[float, float]:
    """Return how many times as long a is as b, by Huber's loss, and its standard deviation."""
    weight = np.ones(len(a))
    for _ in range(10):
        power = float((weight * np.abs(b) ** 2).sum())
        slope = complex((weight * a * b.conj()).sum()) / power
        left = np.abs(a - slope * b)
        scale = max(1.2 * float(np.median(left)), 1e-12)
        weight = np.minimum(1.0, 2.0 * scale / np.maximum(left, 1e-300))
    mean_square = float((weight * left**2).sum() / weight.sum())
    return abs(slope), math.sqrt(mean_square / power)


def _lag_of_velocity(fixes: tuple[Array, Array], summed: tuple[Array, Array]) -> float:
    """Return by how much the velocity is later than the fixes, s; 0 where they do not tell."""
    start, end = max(fixes[0][0], summed[0][0]), min(fixes[0][-1], summed[0][-1])
    step = max(float(np.median(np.diff(each[0]))) for each in (fixes, summed))
    width = max(1.0, 4.0 * step)
    if end - start < 20.0 * width:
        return 0.0

    def changes(signal: tuple[Array, Array], at: Array) -> Array:
        """Return the change of the mean velocity from one window to the next."""
        before, now, after = (averaged(*signal, at + k * width, width) for k in (-1, 0, 1))
        return np.asarray(after - 2.0 * now + before)

    found = best_lag(
        lambda at: changes(fixes, at),
        lambda at: changes(summed, at),
        np.arange(start + width, end - width, max(step, 0.05)),
        most=_MOST_LATE,
        width=width,
    )
    if found is None or found.correlation < 0.6 or found.gain < _LAG_GAIN:
        return 0.0
    return found.seconds if abs(found.seconds) > 4.0 * found.sd else 0.0


def check_position(recording: Recording, gps_sd: float = 0.0) -> list[Finding]:
    """Return what is wrong with fixes and with the velocity over ground.

    Parameters
    ----------
    recording : Recording
        To be checked.
    gps_sd : float
        Standard deviation of a fix as the particulars have it, m; 0 where there are none.
    """
    t, fix = recording.samples("gps_x_m", "gps_y_m")
    if len(t) < ENOUGH:
        return []
    names = recording.called("gps_x_m", "gps_y_m")
    jumps = find_jumps(t, fix)
    degrees = in_degrees(fix if jumps is None else np.delete(fix, jumps.lost, axis=0))
    if degrees:
        return [
            Finding(
                ERROR,
                "position-degrees",
                f"{names}: {degrees}",
                "give latitude and longitude in [position] of a mapping file, as usv-twin mapping "
                "new does",
                {"north": float(np.median(fix[:, 0])), "east": float(np.median(fix[:, 1]))},
            )
        ]
    found = []
    if jumps is not None:
        lost = len(jumps.lost)
        found.append(
            Finding(
                WARNING if lost < 0.1 * len(t) else ERROR,
                "fix-jumps",
                f"{names}: {lost} of {len(t)} fixes cannot be reached from the others (a jump of "
                f"{jumps.length:.4g} m at t = {t[jumps.after]:.1f} s)",
                "single ones are left out when the log is read; else empty these cells",
                {"fixes": lost, "first_m": jumps.length},
            )
        )
        t, fix = np.delete(t, jumps.lost), np.delete(fix, jumps.lost, axis=0)
    stamps = fix_stamps(t, fix)
    if stamps is not None and stamps.along > 2.0 * stamps.across and stamps.jitter > _STAMP_JITTER:
        found.append(
            Finding(
                WARNING,
                "fix-stamps",
                f"{names}: the stamps of the fixes jitter by {stamps.jitter:.2f} s: at "
                f"{stamps.speed:.1f} m/s they scatter by {stamps.along:.2g} m along the track, "
                f"{stamps.across:.2g} m across it",
                "log the time that the receiver states, not that of arrival"
                + _raised(max(stamps.along, stamps.across), gps_sd),
                stamps._asdict(),
            )
        )
    found += _stands(names, t, fix) or _spikes_or_steps(names, t, fix)
    fit = velocity_on_fixes((t, fix), recording.samples("gps_vx_mps", "gps_vy_mps"))
    return found + _velocity(recording, fit)


def _raised(scatter: float, gps_sd: float) -> str:
    """Return what to do about a scatter (m) that the particulars do not cover, or that they do."""
    if gps_sd > 0.98 * scatter:  # of rounded numbers
        return f"; gps_sd = {gps_sd:.3g} in the particulars covers it"
    return f"; else raise gps_sd to {scatter:.2g}"


def _steps(names: str, t: Array, fix: Array) -> list[Finding]:
    """Return a finding where fixes step aside and stay there."""
    if len(t) < 3 * ENOUGH:
        return []
    step, width = np.diff(fix, axis=0), np.diff(t)
    speed = step / width[:, None]
    # the part of the jump that the steps around it do not explain
    near = np.median([speed[:-4], speed[1:-3], speed[3:-1], speed[4:]], axis=0)
    left = np.hypot(*(step[2:-2] - width[2:-2, None] * near).T)
    even = width[2:-2] < 3.0 * float(np.median(width))
    bound = max(_STEP, _STEP_NOISE * float(np.median(left)))
    wild = np.flatnonzero((left > bound) & even)
    if not 0 < len(wild) <= max(3, _SINGLE * len(t)):
        return []
    most = int(wild[np.argmax(left[wild])])
    at, length = float(t[most + 3]), float(left[most])
    return [
        Finding(
            WARNING,
            "fix-steps",
            f"{names}: the fixes step aside by up to {length:.2g} m from one to the next (at t = "
            f"{at:.1f} s), {len(wild)} time(s)",
            "the receiver changed satellites or mode: expect errors of the position of this size",
            {"most_m": length, "at_s": at, "times": float(len(wild))},
        )
    ]


def _spikes_or_steps(names: str, t: Array, fix: Array) -> list[Finding]:
    """Return the finding that explains more fixes: spikes, or steps aside."""
    spikes, steps = _spikes(names, t, fix), _steps(names, t, fix)
    if not spikes or not steps:
        return spikes or steps
    return spikes if spikes[0].evidence["fixes"] > steps[0].evidence["times"] else steps


def _spikes(names: str, t: Array, fix: Array) -> list[Finding]:
    """Return a finding where fixes jump aside and come back, again and again."""
    half = _WINDOW // 2
    if len(t) < 3 * ENOUGH:
        return []
    windows = np.lib.stride_tricks.sliding_window_view(fix, _WINDOW, axis=0)
    # along a track the middle of its neighbours is their median, however they are spaced
    far = np.hypot(*(fix[half:-half] - np.median(windows, axis=-1)).T)
    at = t[half:-half]
    near = far <= max(_SPIKE, _STEP_NOISE * float(np.median(far)))
    speed = np.hypot(*np.diff(fix[half:-half][near], axis=0).T) / np.diff(at[near])
    if len(speed) < ENOUGH:
        return []
    # a turn of a boat that goes fast is no spike
    quick = 4.0 * float(np.quantile(speed, 0.95)) * float(np.median(np.diff(t)))
    wild = np.flatnonzero(~near & (far > quick))
    if len(wild) < _SPIKES:
        return []
    most, first, last = float(far[wild].max()), float(at[wild[0]]), float(at[wild[-1]])
    what = (
        f"{names}: {len(wild)} of {len(t)} fixes jump aside by up to {most:.2g} m and back "
        f"(median {np.median(far[wild]):.2g} m; between t = {first:.1f} and {last:.1f} s)"
    )
    remedy = "reflections or lost satellites: empty these cells"
    evidence = {"fixes": float(len(wild)), "most_m": most, "from_s": first, "until_s": last}
    return [Finding(WARNING, "fix-spikes", what, remedy, evidence)]


def _stands(names: str, t: Array, fix: Array) -> list[Finding]:
    """Return a finding where fixes of a boat that goes stand still, and catch up at once."""
    if len(t) < 3 * ENOUGH:
        return []
    step = np.hypot(*np.diff(fix, axis=0).T)
    way, middle, width = ways(t, fix)
    speed = np.hypot(*way.T) / width
    speed = speed[np.isfinite(speed)]
    if not len(middle) or not len(speed):
        return []
    typical = float(np.quantile(speed, 0.75))
    found = []
    for k in np.flatnonzero(step > max(_CAUGHT_UP, 8.0 * float(np.median(step))))[:_PIECES]:
        last = fix[max(k - 8, 0) : k + 1]
        place = np.median(last, axis=0)
        scatter = 4.5 * float(np.median(np.hypot(*(last - place).T)))
        radius = max(_STILL, _STILL_SHARE * step[k], min(scatter, 5.0 * _STILL_SHARE * step[k]))
        apart = np.flatnonzero(np.hypot(*(fix[: k + 1] - place).T) > radius)
        start = int(apart[-1]) + 1 if len(apart) else 0
        length = float(t[k] - t[start])
        if k - start < ENOUGH // 2 or length < _LONG_STILL:
            continue
        passed = step[k] / (length * max(typical, 1e-12))
        gone = [_went(t, fix, start, -1), _went(t, fix, int(k) + 1, 1)]
        if 0.3 < passed < 3.0 and min(gone) > 0.3 * typical:
            found.append((float(step[k]), length, float(t[start])))
    if not found:
        return []
    most, length, at = max(found)
    longest = max(each[1] for each in found)
    what = (
        f"{names}: the fixes stand still for {length:.0f} s and then catch up by {most:.2g} m "
        f"(from t = {at:.1f} s), {len(found)} time(s)"
    )
    remedy = "the receiver or its filter held the last fix: empty these cells"
    evidence = {"most_m": most, "longest_s": longest, "at_s": at, "times": float(len(found))}
    return [Finding(WARNING, "fix-stands", what, remedy, evidence)]


def _went(t: Array, fix: Array, row: int, way: int) -> float:
    """Return the mean speed in the seconds before (way -1) or after (1) a row; 0 if unknown."""
    edge = t[row] + way * _LONG_STILL
    other = int(np.searchsorted(t, edge).clip(0, len(t) - 1))
    time = abs(float(t[other] - t[row]))
    return float(np.hypot(*(fix[other] - fix[row]))) / time if time > 0.0 else 0.0


def in_degrees(fix: Array) -> str:
    """Return why positions (N, 2) without NaN must be latitude and longitude, or nothing."""
    # a receiver without satellites writes (0, 0): this is no place of the boat
    fix = fix[fix.any(axis=1)]
    if len(fix) < ENOUGH:
        return ""
    middle, spread = np.abs(np.median(fix, axis=0)), np.ptp(fix, axis=0)
    small = spread.max() < 0.2 and spread.max() > 0.0
    if small and middle.max() > 100.0 * spread.max() and middle[0] <= 180.0 and middle[1] <= 180.0:
        return (
            f"all lie within {spread.max():.2g} of ({np.median(fix[:, 0]):.5g}, "
            f"{np.median(fix[:, 1]):.5g}), as degrees of latitude and longitude do"
        )
    return ""


def agrees(fit: VelocityFit | None) -> bool:
    """Return whether nothing says that the velocity over ground contradicts the fixes."""
    if fit is None:
        return True
    near = abs(fit.turned) < _AGREES_ANGLE and abs(fit.ratio - 1.0) < _RATIO_NEAR
    return near and fit.coherence > _AGREES_COHERENCE


def _velocity(recording: Recording, fit: VelocityFit | None) -> list[Finding]:
    """Return findings about a velocity over ground that the fixes contradict."""
    if fit is None:
        return []
    names, evidence = recording.called("gps_vx_mps", "gps_vy_mps"), fit._asdict()
    found = []
    # where their directions differ, lengths of way and velocity tell no unit
    along = fit.coherence > _AGREES_COHERENCE
    if along and abs(fit.ratio - 1.0) > max(_RATIO_NEAR, 4.0 * fit.ratio_sd):
        unit = next(
            (text for ratio, text in _UNITS.items() if abs(fit.ratio / ratio - 1.0) < _UNIT_NEAR),
            "",
        )
        found.append(
            Finding(
                ERROR,
                "speed-unit",
                f"{names}: the fixes go {fit.ratio:.3g} times as fast as the speed over ground says"
                + (f": {unit}" if unit else ""),
                'state the unit of the speed in a mapping, such as unit = "kn"'
                if unit
                else "check the units of speed, position and time",
                evidence,
            )
        )
    if fit.coherence < 0.7 and fit.mirrored > 0.8:
        found.append(
            Finding(
                ERROR,
                "velocity-mirrored",
                f"{names}: the velocity turns against the track of the fixes",
                "north and east are swapped or one has the wrong sign, in fixes or in velocity "
                "(x is north, y is east)",
                evidence,
            )
        )
    elif fit.coherence < 0.5:
        found.append(
            Finding(
                ERROR,
                "course-unit",
                f"{names}: the velocity does not point along the track (coherence "
                f"{fit.coherence:.2f})",
                'if the course is in degrees, state unit = "deg" in the mapping',
                evidence,
            )
        )
    elif fit.coherence > 0.8 and abs(fit.turned) > math.radians(135.0):
        found.append(
            Finding(
                ERROR,
                "velocity-reversed",
                f"{names}: the velocity points against the track of the fixes",
                "turn its sign: north and east are above 0",
                evidence,
            )
        )
    elif fit.coherence > 0.8 and abs(fit.turned) > math.radians(10.0):
        found.append(
            Finding(
                WARNING,
                "course-offset",
                f"{names}: the velocity points {math.degrees(abs(fit.turned)):.0f} degrees off the "
                "track of the fixes",
                "check the reference of the course: true north, clockwise",
                evidence,
            )
        )
    if abs(fit.lag) > _LATE and not found:
        late, other = ("velocity", "fixes") if fit.lag > 0.0 else ("fixes", "velocity")
        found.append(
            Finding(
                WARNING,
                f"{'velocity' if fit.lag > 0.0 else 'fix'}-late",
                f"the {late} comes {abs(fit.lag):.2f} s after the {other}",
                "look for a filter in the receiver, or leave the late columns out",
                evidence,
            )
        )
    return found
