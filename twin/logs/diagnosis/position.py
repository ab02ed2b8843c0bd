"""Fixes against each other and the speed over ground: jumps, units, stamps, delay."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from twin.logs.columns import Array
from twin.logs.datum import Plane
from twin.logs.diagnosis.findings import ERROR, WARNING, Finding, Recording
from twin.logs.diagnosis.fixes import (
    MANY,
    check_fixes,
    find_stands,
    rows_that_catch_up,
    within,
)
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
    "exchanged",
    "find_jumps",
    "fix_stamps",
    "in_degrees",
    "velocity_on_fixes",
]

_JUMP, _FAST = 50.0, 30.0
"""Between two fixes no boat goes farther than this, m, and this fast, m/s (58 knots)."""

_FAR = 1e9
"""No boat goes farther than this between two fixes, m, whatever the unit."""

_TOP_LATITUDE = 89.0
"""Where longitudes are larger, degrees, they are no latitudes."""

_PIECES = 1000
"""Most pieces between jumps that are joined to a track."""

_STAMP_JITTER = 0.03
"""Stamps of fixes that jitter by more than this are worth a word, s."""

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

_STRAIGHT, _COHERENT, _EXCHANGED = math.radians(10.0), 0.9, 0.05
"""A velocity points along the track of the fixes within this angle, with this coherence. If only
fixes with latitude and longitude exchanged do so, as fast within this share, they are exchanged."""

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

    Notes
    -----
    A boat goes on while its fixes stand still. So where they catch up, the way counts from the
    start of the stand.
    """
    rows = np.flatnonzero(np.isfinite(fix).all(axis=1))
    if len(rows) < 2:
        return None
    t, fix = t[rows], fix[rows]
    length = np.hypot(*np.diff(fix, axis=0).T)
    if not (length > _JUMP + _FAST * np.diff(t)).any():
        return None
    known = t.copy()
    for start_of, last in rows_that_catch_up(t, fix):
        known[last] = t[start_of]

    def reached(first: npt.NDArray[np.intp], then: int) -> npt.NDArray[np.bool_]:
        way = np.hypot(*(fix[then] - fix[first]).T)
        return np.asarray(way <= _JUMP + _FAST * (t[then] - known[first]), dtype=np.bool_)

    broken = np.flatnonzero(length > _JUMP + _FAST * (t[1:] - known[:-1]))
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
                WARNING if lost < MANY * len(t) else ERROR,
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
    stands = find_stands(recording, t, fix)
    found += check_fixes(recording, t, fix, stands)
    going = ~within(t, stands)
    fit = velocity_on_fixes((t[going], fix[going]), recording.samples("gps_vx_mps", "gps_vy_mps"))
    return found + _velocity(recording, fit)


def exchanged(recording: Recording) -> tuple[Recording, list[Finding]]:
    """Return a recording, with latitude and longitude exchanged where the velocity says so.

    Parameters
    ----------
    recording : Recording
        Without jumps.

    Notes
    -----
    A degree of longitude is shorter than one of latitude. So exchanged ones also change the length
    of the way, and a velocity over ground whose axes are exchanged does not fit them.
    """
    plane = recording.plane
    if plane is None or abs(plane.longitude) > _TOP_LATITUDE:
        return recording, []
    velocity = recording.samples("gps_vx_mps", "gps_vy_mps")
    as_given = velocity_on_fixes(recording.samples("gps_x_m", "gps_y_m"), velocity)
    if as_given is None or _points_along(as_given):
        return recording, []
    latitude, longitude = plane.degrees(*recording.z[:, :2].T)
    z = recording.z.copy()
    z[:, :2] = np.column_stack(Plane(plane.longitude, plane.latitude).metres(longitude, latitude))
    mended = replace(recording, z=z)
    fit = velocity_on_fixes(mended.samples("gps_x_m", "gps_y_m"), velocity)
    if fit is None or not _points_along(fit) or abs(fit.ratio - 1.0) > _EXCHANGED:
        return recording, []
    what = (
        f"{recording.called('gps_x_m', 'gps_y_m')}: latitude and longitude are exchanged; the "
        "other way round, the fixes go as the speed over ground says"
    )
    remedy = "exchange the two in the mapping; the rest is checked as if they were"
    evidence = {"ratio": as_given.ratio, "ratio_exchanged": fit.ratio}
    return mended, [Finding(ERROR, "position-exchanged", what, remedy, evidence)]


def _points_along(fit: VelocityFit) -> bool:
    """Return whether a velocity points along the track of the fixes."""
    return fit.coherence > _COHERENT and abs(fit.turned) < _STRAIGHT


def _raised(scatter: float, gps_sd: float) -> str:
    """Return what to do about a scatter (m) that the particulars do not cover, or that they do."""
    if gps_sd > 0.98 * scatter:  # of rounded numbers
        return f"; gps_sd = {gps_sd:.3g} in the particulars covers it"
    return f"; else raise gps_sd to {scatter:.2g}"


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
