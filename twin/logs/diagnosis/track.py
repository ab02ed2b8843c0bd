"""The track over ground against the heading: offsets, mirrored axes, astern for ahead."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from twin.logs.columns import Array
from twin.logs.diagnosis.findings import ERROR, NOTE, WARNING, Finding, Recording
from twin.logs.diagnosis.signals import ENOUGH, averaged, fit_line, robust_sd, sampled, ways

__all__ = [
    "BOTH_MIRRORED",
    "SURE",
    "TrackFit",
    "check_track",
    "compass_on_track",
    "compass_reversed",
    "thrust",
    "thrust_sign",
]

TURN = 2.0 * math.pi

_OFFSET_STRAIGHT, _OFFSET_ROUND = math.radians(30.0), math.radians(12.0)
"""Leeway and current turn the track by less than this from the heading: on few headings, and
where the log has all of them, rad."""

_NO_LEEWAY = math.radians(45.0)
"""Leeway and current seldom turn the track of a boat that steers by more than this, rad."""

_MIRROR = 0.7
"""A mean resultant length above this is one direction."""

_ONE_WAY = 0.9
"""Above this a boat goes one way all the time, ahead or at one angle."""

_CURRENT, _DRIFT = 0.5, 1.0
"""A current is about this share of the speed, or less; and of the speed of one that drifts."""

_ASTERN = math.radians(150.0)
"""A boat goes astern where its track is farther than this from the heading, rad."""

_STRAIGHT = 0.995
"""Mean resultant length of the heading of a straight course."""

SURE, _LIKELY = 4.0, 1.0
"""Log-odds from which a mirrored track is sure, and from which it is likely."""

_NEVER_LESS = 0.05**2
"""A mean square that is left counts as no less: waves and leeway bend any track by .05 rad."""

BOTH_MIRRORED = (
    '; or latitude and longitude are swapped, and frame = "enu" hides it: exchange the two and '
    "take the frame out"
)
"""A remedy: a track and a heading that are mirrored alike agree, and turn against the commands."""

_EXPLAINED = 0.75
"""A track that leaves more than this share of its speed unexplained tells nothing."""


_ARC = 1.5
"""Over a larger turn a chord tells no direction, rad."""

_DRIFT_ANGLE = 0.5
"""In turns the hull drifts sideways by about this angle, or less, rad ..."""

_DRIFT_SHARE = 0.4
"""... which is not quite proportional to the yaw rate: this share of it is taken for unknown."""

_LEEWAY_SHARE = 0.07
"""Leeway is not quite a current: this share of both is taken for unknown."""

_PASSES = 3
"""The angle is found so often, each time in axes turned by the last one."""

_CRAB = math.radians(1.5)
"""A sound boat goes off its heading by about this: hull, thrusters and wind are never even, rad."""

_KNOWN, _OFF, _OFF_SURE = math.radians(4.0), math.radians(10.0), 3.0
"""An offset over legs is known with a smaller standard deviation than the first, rad; a compass is
off from the second on, rad, and so many standard deviations."""


class TrackFit(NamedTuple):
    """How the track over ground goes with the heading."""

    along: float
    """Mean resultant length of course less heading, weighted by the way; 1: one angle; 0 also
    where few ways are long enough."""
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
    odds: float
    """Logarithm of how much more likely the track is than its mirror image; see Notes of
    :func:`compass_on_track`."""
    left: float
    """Share of the speed that heading and a constant current leave unexplained ..."""
    left_mirrored: float
    """... and that the mirrored heading leaves."""
    steady: float
    """Angle from heading to motion through the water, rad, where the current is a small one."""
    legs: float
    """The same over legs in several directions, without current and drift in turns, rad ..."""
    legs_sd: float
    """... and its standard deviation; large where the legs do not tell, infinite without any."""

    @property
    def is_known(self) -> bool:
        """Whether the legs tell by how much the compass is off."""
        return self.legs_sd < _KNOWN


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

    Notes
    -----
    The velocity over ground is a constant times speed along the heading, plus a constant current
    that is small against the speed. ``odds`` compares the residuals of this fit with those for the
    heading mirrored, by the number of independent ones, and the currents that each needs.
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
    # slow ways tell little: without enough others, only their turning is compared
    fast = ok & (length > 0.2 * float(np.fmax.reduce(length, initial=1e-9)))
    enough = bool(fast.sum() >= 8)
    if enough:
        ok = fast
    if ok.sum() < 8:
        return None
    length, course, psi, turned = length[ok], course[ok], psi[ok], turned[ok]
    astern = np.zeros(len(course), dtype=np.bool_)
    if thrust is not None:
        astern = averaged(*thrust, middle[ok] - width, step) < 0.0
    velocity = length * np.exp(1j * course) / step
    course = np.where(astern, course + math.pi, course)

    def mean(angle: Array) -> complex:
        return complex((length * np.exp(1j * angle)).sum() / length.sum())

    along, across = mean(course - psi), mean(course + psi)
    current = _offset_in_current(length / step, course, psi)
    # leeway in turns is proportional to their curvature, and not part of the offset
    left = np.remainder(course - psi - np.angle(along) + math.pi, TURN) - math.pi
    curvature = turned * step / length
    line = fit_line(curvature, left)
    bent = np.abs(curvature) > 0.3 * np.quantile(np.abs(curvature), 0.9)
    # on a circle, leeway and offset are not separable
    circle = bent.mean() > 0.7 and abs(float(np.sign(curvature[bent]).mean())) > 0.6
    return TrackFit(
        abs(along) if enough else 0.0,
        float(np.remainder(np.angle(along) + line.offset + math.pi, TURN) - math.pi),
        math.inf if circle else line.offset_sd,
        current,
        abs(across) if enough else 0.0,
        float(np.angle(across)),
        abs(mean(psi)),
        float(length.sum()),
        *_odds(velocity, astern, psi),
        *_offset_over_legs(velocity, astern, psi, turned * step),
    )


def _offset_over_legs(
    velocity: npt.NDArray[Any], astern: npt.NDArray[np.bool_], psi: Array, turned: Array
) -> tuple[float, float]:
    """Return the angle from heading to motion through the water, and its standard deviation, rad.

    Parameters
    ----------
    velocity, astern, psi : ndarray, shape (N,)
        Over ground, m/s, as complex numbers; where the boat goes astern; heading, rad.
    turned : ndarray, shape (N,)
        By how much the heading turns meanwhile, rad.

    Notes
    -----
    Of the velocity in axes of the compass, the part abeam is the part ahead times the tangent of
    the angle, plus a constant current turned into these axes, plus a drift in proportion to the
    yaw rate. This is linear in the tangent, whatever the speed through the water is. Current and
    drift have priors, so legs that do not separate them leave a large standard deviation.
    """
    # an arc is longer than its chord
    over_ground = velocity / np.sinc(turned / TURN)
    ahead = np.where(astern, -1.0, 1.0) * over_ground * np.exp(-1j * psi)
    angle, sd = float(np.angle(ahead.sum())), math.inf
    for _ in range(_PASSES):
        axes = psi + angle
        body = over_ground * np.exp(-1j * axes)
        # a hull that goes the other way drifts otherwise
        sense = math.copysign(1.0, float(body.real.sum()))
        ok = (np.abs(turned) < _ARC) & (sense * body.real > 0.0)
        if ok.sum() < ENOUGH // 2:
            return math.nan, math.inf
        more, sd = _abeam(body[ok], axes[ok], turned[ok])
        angle += more
    return float(np.remainder(angle + math.pi, TURN) - math.pi), sd


def _abeam(body: npt.NDArray[Any], psi: Array, turned: Array) -> tuple[float, float]:
    """Return the angle of a velocity in turned axes, and its standard deviation, rad."""
    u, v = body.real, body.imag
    speed = math.sqrt(float(np.mean(np.abs(body) ** 2)))
    A = np.column_stack([u, -np.sin(psi), np.cos(psi), turned])
    current, drift = _CURRENT * speed, _DRIFT_ANGLE * speed / max(float(np.std(turned)), 1e-9)
    prior = np.diag([0.0, current**-2, current**-2, drift**-2])
    weight, square = np.ones(len(u)), speed**2
    for _ in range(15):
        normal = A.T @ (A * weight[:, None]) / square
        fit = np.linalg.lstsq(normal + prior, A.T @ (weight * v) / square, rcond=None)[0]
        left = v - A @ fit
        scale = max(robust_sd(left), 1e-3 * speed)
        weight = np.minimum(1.0, 2.0 * scale / np.maximum(np.abs(left), 1e-300))
        # of what is left, neighbours say the same
        same = max(float(left[1:] @ left[:-1]) / max(float(left @ left), 1e-300), 0.0)
        square = max(float(weight @ left**2 / weight.sum()), 1e-6 * speed**2)
        square *= (1.0 + same) / max(1.0 - same, 1e-3)
    # on one heading, a speed that changes tells an angle only if wind and current are constant
    steady = np.column_stack([np.full(len(u), speed), A[:, 1:]])
    variance = max(
        float(np.linalg.pinv(each.T @ (each * weight[:, None]) / square + prior)[0, 0])
        for each in (A, steady)
    )
    curved = _DRIFT_SHARE * float(fit[3] * (turned @ u) / (u @ u))
    # what no current explains is one error all through the log
    misfit = max((_LEEWAY_SHARE * math.hypot(fit[1], fit[2])) ** 2, 1e-9 * speed**2)
    uneven = float(np.linalg.pinv(steady.T @ steady / (len(u) * misfit) + prior)[0, 0])
    return math.atan(fit[0]), math.sqrt(variance + curved**2 + uneven + _CRAB**2)


class _Along(NamedTuple):
    """A velocity over ground as speed along a heading and a constant current."""

    square: float
    """Mean square that is left, of that of the velocity."""
    current: float
    """Of the root mean square speed, over what is likely."""
    angle: float
    """From the heading, rad."""
    independent: float
    """Samples that are independent."""


def _along(
    velocity: npt.NDArray[Any], ahead: npt.NDArray[Any], current: float = _CURRENT
) -> _Along:
    """Return how a velocity goes along a vector ahead, with a constant current of about a size."""
    power = float((np.abs(velocity) ** 2).mean())
    A = np.column_stack([ahead, np.ones_like(ahead)])
    normal, right = A.conj().T @ A, A.conj().T @ velocity
    fit = np.linalg.lstsq(A, velocity, rcond=None)[0]
    square = float((np.abs(velocity - A @ fit) ** 2).mean())
    normal[1, 1] += square / (current**2 * power)
    fit = np.linalg.lstsq(normal, right, rcond=None)[0]
    left = velocity - A @ fit
    total = float((np.abs(left) ** 2).sum())
    correlation = min(abs(complex(left[1:] @ left[:-1].conj())) / max(total, 1e-300), 1.0)
    return _Along(
        max(total / len(left) / power, _NEVER_LESS),
        float(abs(fit[1])) / math.sqrt(power) / current,
        float(np.angle(fit[0])),
        len(left) * (1.0 - correlation) / (1.0 + correlation),
    )


def _odds(
    velocity: npt.NDArray[Any], astern: npt.NDArray[np.bool_], psi: Array
) -> tuple[float, float, float, float]:
    """Return log-odds of a heading against its mirror image, what both leave, and the angle."""
    sign, speed = np.where(astern, -1.0, 1.0), np.abs(velocity)
    ways_on = (sign, np.ones_like(sign)) if astern.any() else (sign,)
    plain, mirrored = (
        min(_along(velocity, each * speed * np.exp(1j * turn * psi)) for each in ways_on)
        for turn in (1.0, -1.0)
    )
    odds = _log_odds(plain, mirrored)
    # a boat whose speed through the water is constant may drift as fast as it goes
    drifting = _along(velocity, sign * np.exp(1j * psi), _DRIFT)
    if abs(drifting.angle) < 0.5 * math.pi:
        odds = max(odds, _log_odds(drifting, mirrored))
    steady = _along(velocity, sign * speed * np.exp(1j * psi)).angle
    return odds, math.sqrt(plain.square), math.sqrt(mirrored.square), steady


def _log_odds(first: _Along, second: _Along) -> float:
    """Return the logarithm of how much more likely the first explanation is than the second."""
    count = min(first, second).independent
    odds = count * math.log(second.square / first.square)
    return odds + 0.5 * (second.current**2 - first.current**2)


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
    recording: Recording,
    fix: tuple[Array, Array],
    compass: tuple[Array, Array],
    gyro: int = 0,
    commands: int = 0,
) -> list[Finding]:
    """Return what is wrong with a compass that does not point where the boat goes.

    Parameters
    ----------
    recording : Recording
        For its commands and the names of its columns.
    fix, compass : tuple of ndarray
        As for :func:`compass_on_track`.
    gyro, commands : int
        1 where they turn as the compass does, -1 against it, 0 where they do not tell.
    """
    plain = compass_on_track(fix, compass)
    fit = compass_on_track(fix, compass, thrust(recording))
    if plain is None or fit is None:
        return []
    shown = fit.left_mirrored < _EXPLAINED and fit.headings < _STRAIGHT
    if fit.odds < -_LIKELY and shown:
        return [_mirrored(recording, plain, fit, gyro, commands)]
    found = _off(recording, plain, fit, commands)
    if not found and fit.odds < 0.0 and shown:
        found.append(
            Finding(
                NOTE,
                "track-unknown",
                f"{recording.called('gps_x_m', 'gps_y_m')}: track and compass agree no better than "
                "with north and east swapped",
                "this track cannot tell: record two full circles to have it checked",
                fit._asdict(),
            )
        )
    return found


def _off(recording: Recording, plain: TrackFit, fit: TrackFit, commands: int) -> list[Finding]:
    """Return a finding where the track goes off to one side of the compass, or astern."""
    if _is_ahead(plain, fit):
        fit = plain  # course and heading agree by themselves, and the commands are wrong
    if fit.is_known and abs(fit.legs) < _ASTERN:
        return _off_legs(recording, fit)
    off = fit.left < _EXPLAINED and abs(fit.steady) > _OFFSET_STRAIGHT
    if fit.along < _MIRROR and not off:
        return []
    offset = fit.offset if fit.along >= _MIRROR else fit.steady
    if abs(offset) > _ASTERN:
        # one thruster with a wrong sign also turns the total thrust
        sure = fit.along >= _MIRROR or (fit.along > 0.0 and abs(plain.steady) > _ASTERN)
        return [_reversed(recording, plain, fit, commands)] if sure else []
    few = fit.headings >= 0.5
    bound = _OFFSET_STRAIGHT if few else _OFFSET_ROUND
    seen = fit.along >= _MIRROR and abs(fit.offset) > bound + 3.0 * fit.offset_sd
    if math.isfinite(fit.in_current) and fit.in_current * np.sign(fit.offset) < bound:
        seen = False
    if not seen and not off:
        return []
    if not seen:
        offset = fit.steady
    far = abs(offset) > _NO_LEEWAY
    if few and not far:
        remedy = "current, leeway, or the compass: more headings would tell"
    elif few or not seen:
        remedy = (
            "leeway is seldom so large: the compass is off (offset in a mapping), or north and "
            "east of the fixes are swapped or mirrored; a log with turns tells which"
        )
    else:
        remedy = f"offset = {offset:.3f} in a mapping (magnetic variation, or a sensor askew)"
    degrees = math.degrees(offset)
    what = (
        f"{recording.called('compass_rad')}: the track goes {abs(degrees):.0f} degrees to the "
        f"{'right' if degrees > 0.0 else 'left'} of the compass"
        + (" on few headings" if few else "")
    )
    severity = WARNING if far or (seen and not few) else NOTE
    return [Finding(severity, "compass-offset", what, remedy, fit._asdict())]


def _off_legs(recording: Recording, fit: TrackFit) -> list[Finding]:
    """Return a finding where legs in several directions say that the compass is off."""
    if abs(fit.legs) < max(_OFF, _OFF_SURE * fit.legs_sd):
        return []
    degrees = math.degrees(fit.legs)
    what = (
        f"{recording.called('compass_rad')}: the track goes {abs(degrees):.0f} degrees "
        f"(standard deviation {math.degrees(fit.legs_sd):.0f}) to the "
        f"{'right' if degrees > 0.0 else 'left'} of the compass, in any direction"
    )
    remedy = f"offset = {fit.legs:.3f} in a mapping (magnetic variation, or a sensor askew)"
    return [Finding(WARNING, "compass-offset", what, remedy, fit._asdict())]


def _is_ahead(plain: TrackFit, fit: TrackFit) -> bool:
    """Return whether a boat goes ahead throughout, although commands say astern at times."""
    agree = plain.along >= _ONE_WAY and abs(plain.offset) < _ASTERN
    # reversed commands say astern all the time, and fit.along stays high
    return agree and fit.along < _MIRROR and fit.along < plain.along


def _reversed(recording: Recording, plain: TrackFit, fit: TrackFit, commands: int) -> Finding:
    """Return the finding about a boat that goes astern where it is commanded ahead."""
    ahead = plain.along > _MIRROR and abs(plain.offset) < 0.5
    # a wrong sign of both shafts also turns their effect on the heading
    if commands < 0 or (ahead and not commands):
        return thrust_sign(recording, "the boat goes ahead where the commands are astern", fit)
    return compass_reversed(
        recording,
        f"the boat goes {abs(math.degrees(fit.offset)):.0f} degrees from where it points, and is "
        "not commanded astern",
        fit,
    )


def thrust_sign(recording: Recording, what: str, fit: Any) -> Finding:
    """Return the finding that shaft speeds have the wrong sign."""
    return Finding(
        ERROR,
        "thrust-sign",
        f"{recording.called('n_left_rps', 'n_right_rps')}: {what}",
        "turn the sign of the shaft speeds (scale = -1.0 in a mapping file), or of the compass "
        f"(offset = 3.1416){BOTH_MIRRORED}",
        fit._asdict(),
    )


def compass_reversed(recording: Recording, what: str, fit: Any) -> Finding:
    """Return the finding that a compass sits back to front."""
    return Finding(
        ERROR,
        "compass-reversed",
        f"{recording.called('compass_rad')}: {what}",
        "the compass sits back to front (offset = 3.1416), or the shaft speeds have the wrong sign",
        fit._asdict(),
    )


def _mirrored(
    recording: Recording, plain: TrackFit, fit: TrackFit, gyro: int, commands: int
) -> Finding:
    """Return the finding about a track that turns the other way than the compass.

    Where the gyro, or the commands, turn as the track does, it is the compass; where they turn as
    the compass does, it is the fixes. Compass and gyro of one device can be wrong together.
    """
    fixes, name = recording.called("gps_x_m", "gps_y_m"), recording.called("compass_rad")
    quarter = round(plain.mirror / (0.5 * math.pi)) % 4
    north, east = recording.called("gps_x_m"), recording.called("gps_y_m")
    of_fixes = {
        0: f"{east} has the wrong sign",
        1: "north and east (latitude and longitude) are swapped",
        2: f"{north} has the wrong sign",
        3: "north and east are swapped with a wrong sign",
    }[quarter]
    of_compass = {
        0: f"{name} has the wrong sign",
        1: "the compass counts from east",
        2: "the compass counts from south",
        3: "the compass counts from west",
    }[quarter]
    if gyro < 0 or (gyro == 0 and commands < 0):
        reason = of_compass
    elif commands < 0:
        reason = f"{of_compass}, with the gyro"
    elif commands > 0:
        reason = of_fixes
    else:
        reason = f"{of_fixes}, or {of_compass}"
    sure = fit.odds < -SURE
    return Finding(
        ERROR if sure else WARNING,
        "track-mirrored",
        f"{fixes}: the track turns against the compass: {'' if sure else 'probably '}{reason}",
        "correct the mapping: x is north, y is east, the heading runs clockwise from north "
        '(frame = "enu" for one that runs from east); then check again',
        fit._asdict(),
    )
