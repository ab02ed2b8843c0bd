"""Rest, and motion without a command: current, wind, or a unit that is stuck."""

from __future__ import annotations

import math

import numpy as np

from twin.logs.columns import Array
from twin.logs.diagnosis.commands import is_idle
from twin.logs.diagnosis.findings import NOTE, WARNING, Finding, Recording
from twin.logs.diagnosis.signals import ENOUGH, averaged, runs_of, white_noise

__all__ = [
    "check_forces",
    "idle_stretches",
]

_IDLE = 20.0
"""Shorter stretches without a command tell nothing, s."""

_WINDOW = 5.0
"""Speeds are means over so many seconds, s."""

_REST = 0.05
"""A boat below this speed rests, m/s."""

_GAIN, _YAW_GAIN = 0.15, 0.03
"""What a boat gains without a command is a force: speed, m/s, and yaw rate, rad/s."""

_STEADY, _STEADY_TIME = 0.9, 60.0
"""A speed that keeps this share over such a time without a command is a drift, s."""

_DRIFT = 0.1
"""A slower drift is not worth a word, m/s."""


def idle_stretches(recording: Recording) -> list[tuple[float, float]]:
    """Return start and end of each long stretch without a command, s."""
    t = recording.t
    runs = runs_of(is_idle(recording))
    return [(float(t[i]), float(t[j - 1])) for i, j in runs if t[j - 1] - t[i] > _IDLE]


def check_forces(recording: Recording) -> list[Finding]:
    """Return where the boat rests, and where it moves although nothing is commanded."""
    t, fix = recording.samples("gps_x_m", "gps_y_m")
    if len(t) < 3 * ENOUGH or not recording.cmd[:, :2].any():
        return []
    noise = math.hypot(white_noise(t, fix[:, 0]), white_noise(t, fix[:, 1]))
    rate = 1.0 / max(float(np.median(np.diff(t))), 1e-6)
    speed_sd = noise / math.sqrt(max(0.5 * _WINDOW * rate, 1.0)) * math.sqrt(2.0) / _WINDOW
    found: list[Finding] = []
    rested = 0.0
    worst: tuple[float, Finding] | None = None
    for start, end in idle_stretches(recording):
        grid = np.arange(start, end - _WINDOW, 0.5 * _WINDOW)
        ends = [averaged(t, fix, grid + k * _WINDOW, 0.5 * _WINDOW) for k in (0, 1)]
        velocity = (ends[1] - ends[0]) / _WINDOW
        ok = np.isfinite(velocity).all(axis=1)
        grid, velocity = grid[ok], velocity[ok]
        if len(grid) < 5:
            continue
        speed = np.hypot(*velocity.T)
        rested += 0.5 * _WINDOW * float((speed < _REST + 2.0 * speed_sd).sum())
        force = _force(recording, grid, velocity, speed_sd)
        if force is not None and (worst is None or force[0] > worst[0]):
            worst = force
    if worst is not None:
        found.append(worst[1])
    if rested > _IDLE:
        found.append(
            Finding(
                NOTE,
                "rest",
                f"the boat rests for {rested:.0f} s of {recording.t[-1] - recording.t[0]:.0f} s",
                "a twin learns nothing there; start and stop it with [rows] in a mapping file",
                {"rest_s": rested},
            )
        )
    return found


def _gained(values: Array) -> tuple[float, int]:
    """Return the largest rise of smoothed values, and where it ends."""
    middle = np.median([values[:-2], values[1:-1], values[2:]], axis=0)
    rise = middle - np.minimum.accumulate(middle)
    at = int(np.argmax(rise))
    return float(rise[at]), at + 1


def _force(
    recording: Recording, grid: Array, velocity: Array, speed_sd: float
) -> tuple[float, Finding] | None:
    """Return how strong a force is in a stretch without a command, and the finding."""
    speed = np.hypot(*velocity.T)
    third = max(len(grid) // 3, 1)
    first, last = float(np.median(speed[:third])), float(np.median(speed[-third:]))
    drift = np.median(velocity[-third:], axis=0)
    to = math.degrees(math.atan2(drift[1], drift[0])) % 360.0
    span = f"t = {grid[0]:.0f} to {grid[-1] + _WINDOW:.0f} s"
    evidence = {"from_s": float(grid[0]), "first_mps": first, "last_mps": last, "to_deg": to}
    gained, at = _gained(speed)
    if gained > _GAIN + 5.0 * speed_sd:
        to = math.degrees(math.atan2(velocity[at, 1], velocity[at, 0])) % 360.0
        what = (
            f"the boat gains {gained:.2f} m/s towards {to:.0f} degrees until t = {grid[at]:.0f} s "
            f"while nothing is commanded ({span})"
        )
        remedy = "wind, current, a tow, or a thruster that is stuck or not recorded"
        evidence |= {"gained_mps": gained, "to_deg": to}
        return gained, Finding(WARNING, "force", what, remedy, evidence)
    long = grid[-1] - grid[0] > _STEADY_TIME
    if long and last > max(_DRIFT + 3.0 * speed_sd, _STEADY * first):
        what = (
            f"the boat drifts at {last:.2f} m/s towards {to:.0f} degrees while nothing is "
            f"commanded ({span})"
        )
        remedy = "current or wind: the twin takes it as a slow disturbance"
        return last, Finding(WARNING, "drift", what, remedy, evidence)
    return _spin(recording, grid, span)


def _spin(recording: Recording, grid: Array, span: str) -> tuple[float, Finding] | None:
    """Return how much yaw rate a boat gains without a command, and the finding."""
    t, compass = recording.samples("compass_rad")
    if len(t) < ENOUGH:
        return None
    psi = np.unwrap(compass[:, 0])
    rate = np.diff(averaged(t, psi, np.append(grid, grid[-1] + 2.5), 2.0)) / np.diff(
        np.append(grid, grid[-1] + 2.5)
    )
    rate, grid = rate[np.isfinite(rate)], grid[np.isfinite(rate)]
    if len(rate) < 5:
        return None
    gained, at = _gained(np.abs(rate))
    if gained < _YAW_GAIN:
        return None
    what = (
        f"the boat begins to turn at {abs(rate[at]):.2f} rad/s at t = {grid[at]:.0f} s while "
        f"nothing is commanded ({span})"
    )
    remedy = "a thruster that is stuck or not recorded, or a gust"
    evidence = {"from_s": float(grid[0]), "at_s": float(grid[at]), "gained_radps": gained}
    return gained, Finding(WARNING, "spin", what, remedy, evidence)
