"""Commands: their units, by what the boat does and by its particulars."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from twin.logs.columns import SHARE, Array
from twin.logs.diagnosis.findings import ERROR, WARNING, Finding, Recording
from twin.logs.diagnosis.signals import averaged
from twin.logs.diagnosis.signs import speed_of
from twin.particulars import Particulars

__all__ = [
    "check_commands",
    "is_idle",
]

_LEAST_ADVANCE, _LEAST_LENGTHS = 0.008, 0.001
"""Every propeller takes a boat farther than this in a revolution: m, and lengths of the boat."""

_MOST_LENGTHS = 0.6
"""... and none farther than this, lengths."""

_BEYOND, _FULL = 5.0, 2.5
"""No shaft turns so many times as fast as the particulars say; nor so many times as fast, and
exactly as far as a scale goes."""

_SCALES = {1.0: "shares of full throttle", 100.0: "per cent"}

_UNITS = {60.0: "rpm", 2.0 * math.pi: "rad/s"}

_SAILS = 20.0
"""A boat that goes farther than this sails, m."""

_MOST_ANGLE = 1.3
"""Few rudders and drives turn farther than this, rad."""

_FIXED_ANGLE, _UNEQUAL = 0.05, 0.05
"""Angles that move by less, rad, are those of fixed units; and shaft speeds that differ by more of
their mean steer a boat without angles."""


def check_commands(recording: Recording, particulars: Particulars | None = None) -> list[Finding]:
    """Return what is wrong with units and kind of the commands.

    Parameters
    ----------
    recording : Recording
        To be checked.
    particulars : Particulars, optional
        Of the boat: its length and its shaft speed at its speed tell units better.
    """
    return _angles(recording) + _shafts(recording, particulars) + _kind(recording, particulars)


def _kind(recording: Recording, particulars: Particulars | None) -> list[Finding]:
    """Return a finding where the commands steer in another way than the particulars say."""
    if particulars is None or not len(recording.t):
        return []
    angle = np.nan_to_num(recording.cmd[:, 2:])
    n = np.nan_to_num(recording.cmd[:, :2])
    moved = float(np.ptp(angle, axis=0).max(initial=0.0))
    mean = float(np.abs(n).mean())
    unequal = float(np.abs(n[:, 0] - n[:, 1]).mean()) / max(mean, 1e-300)
    evidence = {"angle_rad": moved, "unequal": unequal}
    fixed = particulars.steering == "differential"
    if fixed and moved > _FIXED_ANGLE:
        what = (
            f"{recording.called('delta_left_rad', 'delta_right_rad')}: the angle moves by "
            f"{math.degrees(moved):.0f} degrees, but the particulars say fixed thrusters"
        )
        remedy = 'set steering = "drives" in the particulars, or leave the angle out'
    elif not fixed and not angle.any() and unequal > _UNEQUAL:
        what = (
            f"{recording.called('n_left_rps', 'n_right_rps')}: the shaft speeds differ by "
            f"{unequal:.0%} and no angle moves, but the particulars say that the drives turn"
        )
        remedy = 'set steering = "differential" in the particulars, or record the angle'
    else:
        return []
    return [Finding(WARNING, "steering-kind", what, remedy, evidence)]


def _angles(recording: Recording) -> list[Finding]:
    """Return a finding about angles that must be degrees."""
    delta = recording.cmd[:, 2:]
    most = float(np.fmax.reduce(np.abs(delta).ravel(), initial=0.0))
    if most <= _MOST_ANGLE:
        return []
    return [
        Finding(
            ERROR if most > math.pi else WARNING,
            "angle-degrees",
            f"{recording.called('delta_left_rad', 'delta_right_rad')}: angles of up to {most:.3g} "
            f"rad, {math.degrees(most):.0f} degrees",
            "if these are degrees, name the columns delta_left_deg and delta_right_deg (in a "
            'mapping: unit = "deg")',
            {"most_rad": most},
        )
    ]


def _shafts(recording: Recording, particulars: Particulars | None) -> list[Finding]:
    """Return findings about shaft speeds in another unit than rev/s, or none at all."""
    n = recording.cmd[:, :2]
    name = recording.called("n_left_rps", "n_right_rps")
    seen = n[np.isfinite(n)]
    if not len(seen):
        return []
    motion = speed_of(recording)
    if not seen.any():
        return _no_commands(name, motion)
    found = _by_motion(recording, name, motion, particulars)
    if not any(finding.severity == ERROR for finding in found):
        found = _by_particulars(name, seen, particulars) or found
    pulses = seen.min() >= 800.0 and np.ptp(seen) > 20.0 and seen.max() <= 2200.0
    if pulses and found and not any("rpm, not" in finding.what for finding in found):
        what = (
            f"{name}: between {seen.min():.0f} and {seen.max():.0f}, never 0, as pulse widths are"
        )
        remedy = "make neutral 0: scale = 0.02, offset = -30.0 in a mapping file for 1500 us"
        evidence = {"least": float(seen.min()), "most": float(seen.max())}
        return [Finding(ERROR, "shaft-pwm", what, remedy, evidence)]
    return found + _zero_throughout(recording, motion)


def _no_commands(name: str, motion: tuple[Array, Array, Array] | None) -> list[Finding]:
    """Return a finding where a boat goes without a command."""
    if _way(motion) < _SAILS:
        return []
    what = f"{name}: all commands are 0, but the boat goes"
    remedy = "record the commands; without them a twin cannot learn"
    return [Finding(ERROR, "commands-missing", what, remedy)]


def _way(motion: tuple[Array, Array, Array] | None) -> float:
    """Return how far the boat goes, m; 0 where that is unknown."""
    if motion is None:
        return 0.0
    return float(np.nansum(np.hypot(*motion[1].T)) * np.median(np.diff(motion[0])))


def _zero_throughout(
    recording: Recording, motion: tuple[Array, Array, Array] | None
) -> list[Finding]:
    """Return a finding where one of two shafts is never commanded while the boat sails."""
    names = ("n_left_rps", "n_right_rps")
    still = [not np.nan_to_num(recording.cmd[:, j]).any() for j in (0, 1)]
    way = _way(motion)
    if still[0] == still[1] or way < _SAILS:
        return []
    side = 0 if still[0] else 1
    what = (
        f"{recording.called(names[side])} is 0 in all rows while the boat sails "
        f"{way:.0f} m and {recording.called(names[1 - side])} is used"
    )
    remedy = "record this command too; a boat that has one shaft only has one column, n_rps"
    code = f"{('left', 'right')[side]}-unit-dead"
    return [Finding(WARNING, code, what, remedy, {"way_m": way})]


def _by_particulars(name: str, seen: Array, particulars: Particulars | None) -> list[Finding]:
    """Return a finding about shaft speeds far from what the particulars state, in rest or not."""
    if particulars is None or SHARE in name:
        return []
    turning = np.abs(seen[seen != 0.0])
    typical, most = float(np.quantile(turning, 0.95)), float(turning.max())
    stated = particulars.shaft_speed
    evidence = {"typical": typical, "most": most, "stated": stated}
    full = _SCALES.get(most)
    if full is not None and not 1.0 / _FULL < most / stated < _FULL:
        what = f"{name}: at most {most:g}, as {full} go, where the particulars say {stated:.3g}"
        remedy = (
            "scale = ... in a mapping: rev/s at full throttle over this number; or correct "
            "shaft_speed in the particulars"
        )
        return [Finding(ERROR, "shaft-unit", what + " rev/s", remedy, evidence)]
    if typical < _BEYOND * stated:
        return []
    what = (
        f"{name}: up to {typical:.4g} rev/s, {typical / stated:.2g} times what the particulars say "
        f"({stated:.3g})"
    )
    remedy = (
        'state the unit in a mapping: unit = "rpm" or "radps" (or scale = ... for per cent), or '
        "correct shaft_speed in the particulars"
    )
    return [Finding(ERROR, "shaft-unit", what, remedy, evidence)]


def _by_motion(
    recording: Recording,
    name: str,
    motion: tuple[Array, Array, Array] | None,
    particulars: Particulars | None,
) -> list[Finding]:
    """Return a finding about shaft speeds that the way of the boat contradicts."""
    if motion is None:
        return []
    middle, velocity = motion[:2]
    speed = np.hypot(*velocity.T)
    shaft = np.nan_to_num(np.abs(recording.cmd[:, :2])).mean(axis=1)
    step = float(np.median(np.diff(middle)))
    turns = averaged(recording.t, shaft, middle, 2.0 * step)
    fast = (speed > 0.4 * np.fmax.reduce(speed)) & (turns > 0.2 * np.fmax.reduce(turns))
    if fast.sum() < 5:
        return []
    advance = float(np.quantile(speed[fast] / turns[fast], 0.75))
    return _advance(name, advance, float(np.median(turns[fast])), particulars)


def _advance(
    name: str, advance: float, turns: float, particulars: Particulars | None
) -> list[Finding]:
    """Return a finding about an impossible way in a revolution."""
    evidence = {"advance_m": advance, "shaft_speed": turns}
    said = (
        f"{name}: {turns:.4g} rev/s at {advance * turns:.2g} m/s, {advance:.2g} m in a revolution"
    )
    remedy = 'state the unit in a mapping: unit = "rpm" (or scale = ... for per cent)'
    stated = ", or correct length, speed and shaft_speed in the particulars"
    shares = SHARE in name  # no shaft speeds: the particulars alone could contradict them
    if particulars is None:
        if shares or advance >= _LEAST_ADVANCE:
            return []
        return [Finding(ERROR, "shaft-unit", f"{said}: no propeller is so small", remedy, evidence)]
    ratio = particulars.speed / particulars.shaft_speed / max(advance, 1e-12)
    for unit, text in () if shares else _UNITS.items():
        if 0.7 < ratio / unit < 1.4:
            what = f"{said}, {ratio:.2g} times too little for this boat: {text}, not rev/s"
            remedy = f'state the unit in a mapping: unit = "{"rpm" if unit > 10.0 else "radps"}"'
            return [Finding(ERROR, "shaft-unit", what, remedy + stated, evidence)]
        if 0.7 < ratio * unit < 1.4:
            what = f"{said}, {1.0 / ratio:.2g} times too much for this boat: rev/s read as {text}"
            remedy = "take the conversion out"
            return [Finding(ERROR, "shaft-unit", what, remedy + stated, evidence)]
    if not shares and not _LEAST_LENGTHS < advance / particulars.length < _MOST_LENGTHS:
        what = f"{said}, {advance / particulars.length:.2g} of its length"
        return [Finding(ERROR, "shaft-unit", what, remedy + stated, evidence)]
    if not 0.2 < ratio < 5.0:
        what = f"{said}; the particulars say {ratio * advance:.2g} m"
        remedy = (
            "give speed and shaft_speed in the particulars that belong together, in the log's unit"
        )
        return [Finding(WARNING, "shaft-speed", what, remedy, evidence)]
    return []


def is_idle(recording: Recording) -> npt.NDArray[np.bool_]:
    """Return the rows, shape (N,), in which no thrust is commanded."""
    n = np.nan_to_num(np.abs(recording.cmd[:, :2])).max(axis=1)
    return np.asarray(n <= 0.03 * max(float(n.max()), 1e-12))
