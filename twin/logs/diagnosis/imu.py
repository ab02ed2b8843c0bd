"""Accelerometers against the motion of the fixes: unit, axes, and the delay of the GPS."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from twin.logs.columns import Array
from twin.logs.diagnosis.findings import ERROR, WARNING, Finding, Recording
from twin.logs.diagnosis.signals import ENOUGH, Lag, averaged, best_lag, integrated, sampled
from twin.particulars import Particulars

__all__ = [
    "TILTED",
    "ImuFit",
    "check_imu",
    "imu_on_fixes",
]

_WINDOWS = (0.5, 1.0, 2.0, 4.0)
"""Changes of velocity are compared over so many seconds; what tells the delay best counts."""

_MOST_LATE = 3.0
"""Largest delay that is looked for, s."""

_ANGLE = 0.05
"""A bias turns the acceleration by about this angle, rad; on a circle that looks like a delay."""

_SCALE = 0.3
"""Where the accelerations differ by more than this share, tilt rules and no delay is claimed."""

_CORRELATION = 0.7
"""The accelerometers see the motion of the boat from this correlation on."""

_CHANCE = 5.0
"""Unrelated signals correlate by less than so many over the root of independent samples."""

_CLEAR = 0.85
"""From this correlation on a delay is claimed."""

_LATE = 0.3
"""A delay of the fixes worth a word beyond what the particulars state, s."""

_GRAVITY = 9.80665

TILTED = ("accel-axes", "accel-mirrored")
"""Findings that roll and pitch can feign where nothing takes them out."""


class ImuFit(NamedTuple):
    """How changes of velocity go with integrated accelerometers."""

    latency: float
    """By which the fixes are late, s."""
    latency_sd: float
    correlation: float
    scale: float
    """Of the acceleration by the fixes over that of the accelerometers."""
    turned: float
    """Angle from the accelerometers to the fixes, rad."""
    mirrored: float
    """Correlation with the sideways axis reversed."""


def imu_on_fixes(recording: Recording) -> tuple[ImuFit, Lag] | None:
    """Return how the accelerometers go with velocity over ground or fixes; None if not at all.

    The second is the correlation at each lag.

    Parameters
    ----------
    recording : Recording
        Compass, accelerometers, and velocity or else fixes are used.
    """
    t_imu, accel = recording.samples("accel_x_mps2", "accel_y_mps2")
    t_compass, compass = recording.samples("compass_rad")
    if len(t_imu) < 5 * ENOUGH or len(t_compass) < 5 * ENOUGH:
        return None
    t, velocity = recording.samples("gps_vx_mps", "gps_vy_mps")
    by_velocity = len(t) >= 5 * ENOUGH
    if not by_velocity:
        t, velocity = recording.samples("gps_x_m", "gps_y_m")
        if len(t) < 5 * ENOUGH:
            return None
    psi = sampled(t_compass, np.unwrap(compass[:, 0]), t_imu)
    ok = np.isfinite(psi)
    t_imu, accel, psi = t_imu[ok], accel[ok], psi[ok]
    if len(t_imu) < 5 * ENOUGH:
        return None
    found = [_compare((t, velocity), (t_imu, accel, psi), width, by_velocity) for width in _WINDOWS]
    known = [fit for fit in found if fit is not None]
    clear = [pair for pair in known if pair[0].correlation > _CORRELATION]
    if clear:
        return min(clear, key=lambda pair: pair[0].latency_sd)
    return max(known, key=lambda pair: pair[0].correlation, default=None)


def _compare(
    motion: tuple[Array, Array], imu: tuple[Array, Array, Array], width: float, by_velocity: bool
) -> tuple[ImuFit, Lag] | None:
    """Return the fit over one width of the windows."""
    t, values = motion
    t_imu, accel, psi = imu
    step = max(float(np.median(np.diff(t))), float(np.median(np.diff(t_imu))), 0.05)
    start, end = max(t[0], t_imu[0]) + 2.0 * width, min(t[-1], t_imu[-1]) - 2.0 * width
    if width < 2.0 * step or end - start < 30.0 * width:
        return None
    turn = np.exp(1j * psi)

    def of_imu(sign: float) -> tuple[Array, Array]:
        earth = (accel[:, 0] + sign * 1j * accel[:, 1]) * turn
        speed = integrated(t_imu, np.column_stack([earth.real, earth.imag]))
        return t_imu, speed if by_velocity else integrated(t_imu, speed)

    def changes(signal: tuple[Array, Array], at: Array) -> Array:
        """Return the second difference of means; it is blind to biases and drifts."""
        before, now, after = (averaged(*signal, at + k * width, width) for k in (-1.0, 0.0, 1.0))
        second = after - 2.0 * now + before
        if by_velocity:
            return np.asarray(second)
        further = averaged(*signal, at + 2.0 * width, width)
        return np.asarray(further - 3.0 * after + 3.0 * now - before)

    grid = np.arange(start, end, step)
    straight, reverse = of_imu(1.0), of_imu(-1.0)

    def find(turned: bool) -> Lag | None:
        return best_lag(
            lambda at: changes(straight, at),
            lambda at: changes((t, values), at),
            grid,
            most=_MOST_LATE,
            width=width,
            turned=turned,
        )

    lag = find(turned=False)
    # with unknown axes, a circle fits any delay
    known = lag is not None and lag.correlation > _CORRELATION and math.isfinite(lag.sd)
    if not known:
        straight_on, lag = lag, find(turned=True)
        # half a period later all signs are reversed
        if lag and straight_on and lag.correlation < straight_on.correlation + 0.2:
            return None
        # on a circle every angle of the axes fits with some delay
        if lag is not None and float(lag.curve.min()) > 0.8 * lag.correlation:
            return None
    if lag is None:
        return None
    moved = changes((t, values), grid + lag.seconds) @ (1.0, 1j)
    numbers = []
    for signal in (straight, reverse):
        by_imu = changes(signal, grid) @ (1.0, 1j)
        ok = np.isfinite(by_imu) & np.isfinite(moved)
        cross = complex(moved[ok] @ by_imu[ok].conj())
        power, own = float((np.abs(by_imu[ok]) ** 2).sum()), float((np.abs(moved[ok]) ** 2).sum())
        numbers.append((cross, power, math.sqrt(max(power * own, 1e-300))))
    (cross, power, size), (other, size_other) = numbers[0], numbers[1][::2]
    chance = _CHANCE / math.sqrt((end - start) / width)
    if max(abs(cross) / size, abs(other) / size_other) < chance:
        return None
    fit = ImuFit(
        lag.seconds if known else 0.0,
        math.hypot(lag.sd, _ANGLE / lag.sharpness) if known else math.inf,
        abs(cross) / size,
        abs(cross) / max(power, 1e-300),
        float(np.angle(cross)),
        abs(other) / size_other,
    )
    return fit, lag


def check_imu(
    fit: ImuFit | None, recording: Recording, particulars: Particulars | None = None
) -> list[Finding]:
    """Return what is wrong with accelerometers, and whether fixes are late.

    Parameters
    ----------
    fit : ImuFit or None
        From :func:`imu_on_fixes`.
    recording : Recording
        For the names of its columns.
    particulars : Particulars, optional
        State the delay that is known already.
    """
    if fit is None:
        return []
    names, evidence = recording.called("accel_x_mps2", "accel_y_mps2"), fit._asdict()
    if fit.mirrored > _CORRELATION and fit.mirrored > fit.correlation + 0.2:
        what = f"{names}: the accelerometers turn against the boat: a wrong sign or swapped axes"
        remedy = "x is forward, y to starboard; turn the sign of y, or swap them"
        return [Finding(ERROR, "accel-mirrored", what, remedy, evidence)]
    if fit.correlation < _CORRELATION:
        return []
    found = []
    same = any(0.5 < fit.scale / unit < 2.0 for unit in (1.0, _GRAVITY))
    if abs(fit.turned) > math.radians(45.0) and same:
        what = (
            f"{names}: the accelerometers point {math.degrees(abs(fit.turned)):.0f} degrees off "
            "the motion"
        )
        remedy = "check their axes: x is forward, y to starboard, specific force above 0 ahead"
        found.append(Finding(ERROR, "accel-axes", what, remedy, evidence))
    elif 0.6 < fit.scale / _GRAVITY < 1.6:
        what = f"{names}: the boat accelerates {fit.scale:.3g} times as much: these are g"
        found.append(
            Finding(ERROR, "accel-unit", what, 'state unit = "g" in a mapping file', evidence)
        )
    stated = 0.0 if particulars is None else particulars.instruments.gps_latency
    sound = fit.correlation > _CLEAR and abs(fit.scale - 1.0) < _SCALE
    if sound and fit.latency - stated > max(_LATE, 4.0 * fit.latency_sd):
        what = f"the GPS comes {fit.latency:.2f} s after the accelerometers" + (
            f"; the particulars say {stated:g} s" if particulars is not None else ""
        )
        remedy = f"state gps_latency = {fit.latency:.2g} in [instruments] of the particulars"
        found.append(Finding(WARNING, "gps-late", what, remedy, evidence))
    return found
