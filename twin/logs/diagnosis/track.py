"""The track over ground against the heading: offsets, mirrored axes, astern for ahead."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from twin.logs.columns import Array
from twin.logs.diagnosis.findings import ERROR, NOTE, WARNING, Finding, Recording
from twin.logs.diagnosis.signals import ENOUGH, averaged, fit_line, sampled, ways

__all__ = [
    "TrackFit",
    "check_track",
    "compass_on_track",
    "thrust",
]

TURN = 2.0 * math.pi

_OFFSET_STRAIGHT, _OFFSET_ROUND = math.radians(30.0), math.radians(12.0)
"""Leeway and current turn the track by less than this from the heading: on few headings, and
where the log has all of them, rad."""

_MIRROR = 0.7
"""A mean resultant length above this is one direction."""


class TrackFit(NamedTuple):
    """How the track over ground goes with the heading."""

    along: float
    """Mean resultant length of course less heading, weighted by the way; 1: one angle."""
    offset: float
    """That angle on a straight course, rad ..."""
    offset_sd: float
    """... and its standard deviation; infinite on a circle."""
    in_current: float
    """The same angle where a constant current is allowed for, rad; NaN on a straight course."""
    mirrored: float
    """Mean resultant length of course plus heading ..."""
    mirror: float
    """... and that angle, rad."""
    headings: float
    """Mean resultant length of the heading itself; 1: a straight line."""
    way: float
    """Length of the track that was compared, m."""


def compass_on_track(
    fix: tuple[Array, Array],
    compass: tuple[Array, Array],
    thrust: tuple[Array, Array] | None = None,
) -> TrackFit | None:
    """Return how a compass agrees with the track of fixes, or None where there is no track.

    Parameters
    ----------
    fix : tuple of ndarray, shape (N,) and (N, 2)
        Times, s, and positions north and east, m.
    compass : tuple of ndarray, shape (M,)
        Times and headings, rad.
    thrust : tuple of ndarray, shape (K,), optional
        Times and what drives the boat, above 0 ahead. Where it is below 0 the boat is taken to
        go astern.
    """
    if len(fix[0]) < ENOUGH or len(compass[0]) < ENOUGH:
        return None
    way, middle, step = ways(*fix)
    length, course = np.hypot(*way.T), np.arctan2(way[:, 1], way[:, 0])
    t, psi = compass[0], np.unwrap(compass[1])
    width = 0.5 * step
    turned = (sampled(t, psi, middle + width) - sampled(t, psi, middle - width)) / step
    psi = averaged(t, psi, middle, step)
    ok = np.isfinite(length) & np.isfinite(psi) & np.isfinite(turned)
    ok &= length > 0.2 * float(np.fmax.reduce(length, initial=1e-9))
    if ok.sum() < 8:
        return None
    length, course, psi, turned = length[ok], course[ok], psi[ok], turned[ok]
    if thrust is not None:
        course = np.where(
            averaged(*thrust, middle[ok] - width, step) < 0.0, course + math.pi, course
        )

    def mean(angle: Array) -> complex:
        return complex((length * np.exp(1j * angle)).sum() / length.sum())

    along, across = mean(course - psi), mean(course + psi)
    current = _offset_in_current(length / step, course, psi)
    # leeway in turns goes with their curvature, and is none of the offset
    left = np.remainder(course - psi - np.angle(along) + math.pi, TURN) - math.pi
    curvature = turned * step / length
    line = fit_line(curvature, left)
    bent = np.abs(curvature) > 0.3 * np.quantile(np.abs(curvature), 0.9)
    # on a circle nothing tells leeway from an offset
    circle = bent.mean() > 0.7 and abs(float(np.sign(curvature[bent]).mean())) > 0.6
    return TrackFit(
        abs(along),
        float(np.remainder(np.angle(along) + line.offset + math.pi, TURN) - math.pi),
        math.inf if circle else line.offset_sd,
        current,
        abs(across),
        float(np.angle(across)),
        abs(mean(psi)),
        float(length.sum()),
    )


def _offset_in_current(speed: Array, course: Array, psi: Array) -> float:
    """Return the angle from heading to motion through water that drifts; NaN on few headings."""
    ahead = np.exp(1j * psi)
    if abs(ahead.mean()) > 0.9:
        return math.nan
    A = np.column_stack([ahead, np.ones_like(ahead)])
    fit = np.linalg.lstsq(A, speed * np.exp(1j * course), rcond=None)[0]
    return float(np.angle(fit[0]))


def thrust(recording: Recording) -> tuple[Array, Array] | None:
    """Return times and the thrust that is commanded, in squared shaft speeds; None if unknown."""
    n = recording.cmd[:, :2]
    if not np.isfinite(n).any() or not np.fmax.reduce(np.abs(n).ravel()) > 0.0:
        return None
    return recording.t, np.nan_to_num(n * np.abs(n)).sum(axis=1)


def check_track(
    recording: Recording, fix: tuple[Array, Array], compass: tuple[Array, Array]
) -> list[Finding]:
    """Return what is wrong with a compass that does not point where the boat goes.

    Parameters
    ----------
    recording : Recording
        For its commands and the names of its columns.
    fix, compass : tuple of ndarray
        As for :func:`compass_on_track`.
    """
    plain = compass_on_track(fix, compass)
    fit = compass_on_track(fix, compass, thrust(recording))
    if plain is None or fit is None:
        return []
    if plain.mirrored > _MIRROR and plain.mirrored > plain.along + 0.3:
        return [_mirrored(recording, plain)]
    if fit.along < _MIRROR:
        return []
    name, evidence = recording.called("compass_rad"), fit._asdict()
    degrees = math.degrees(fit.offset)
    if abs(degrees) > 150.0:
        return [_reversed(recording, plain, fit)]
    bound = _OFFSET_ROUND if fit.headings < 0.5 else _OFFSET_STRAIGHT
    if not abs(fit.offset) > bound + 3.0 * fit.offset_sd:
        return []
    if math.isfinite(fit.in_current) and fit.in_current * np.sign(fit.offset) < bound:
        return []
    few = fit.headings >= 0.5
    remedy = (
        "current, leeway, or the compass: more headings would tell"
        if few
        else f"offset = {fit.offset:.3f} in a mapping (magnetic variation, or a sensor askew)"
    )
    what = (
        f"{name}: the track goes {abs(degrees):.0f} degrees to the "
        f"{'right' if degrees > 0.0 else 'left'} of the compass"
        + (" on few headings" if few else "")
    )
    return [Finding(NOTE if few else WARNING, "compass-offset", what, remedy, evidence)]


def _reversed(recording: Recording, plain: TrackFit, fit: TrackFit) -> Finding:
    """Return the finding about a boat that goes astern where it is commanded ahead."""
    if plain.along > _MIRROR and abs(plain.offset) < 0.5:
        shafts = recording.called("n_left_rps", "n_right_rps")
        return Finding(
            ERROR,
            "thrust-sign",
            f"{shafts}: the boat goes ahead where the commands are astern",
            "turn the sign of the shaft speeds: scale = -1.0 in a mapping file",
            fit._asdict(),
        )
    return Finding(
        ERROR,
        "compass-reversed",
        f"{recording.called('compass_rad')}: the boat goes "
        f"{abs(math.degrees(fit.offset)):.0f} degrees from where it points, and is not commanded "
        "astern",
        "the compass sits back to front (offset = 3.1416), or the shaft speeds have the wrong sign",
        fit._asdict(),
    )


def _mirrored(recording: Recording, fit: TrackFit) -> Finding:
    """Return the finding about a track that turns the other way than the compass."""
    fixes, name = recording.called("gps_x_m", "gps_y_m"), recording.called("compass_rad")
    quarter = round(fit.mirror / (0.5 * math.pi)) % 4
    reasons = {
        0: f"{recording.called('gps_y_m')} or {name} has the wrong sign",
        1: "north and east (latitude and longitude) are swapped, or the compass counts from east",
        2: f"{recording.called('gps_x_m')} has the wrong sign, or the compass counts from south",
        3: "north and east are swapped with a wrong sign, or the compass counts from west",
    }
    return Finding(
        ERROR,
        "track-mirrored",
        f"{fixes}: the track turns against the compass: {reasons[quarter]}",
        "correct the mapping: x is north, y is east, the heading runs clockwise from north "
        '(frame = "enu" for one that runs from east)',
        fit._asdict(),
    )
