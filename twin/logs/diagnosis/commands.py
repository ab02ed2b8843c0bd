"""Commands: their units, sides and signs, by what the boat does."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from twin.logs.columns import SHARE, Array
from twin.logs.diagnosis.findings import ERROR, NOTE, WARNING, Finding, Recording
from twin.logs.diagnosis.signals import ENOUGH, averaged, integrated, sampled, ways
from twin.particulars import Particulars

__all__ = [
    "Effect",
    "check_commands",
    "is_idle",
    "speed_of",
    "surge_effect",
    "yaw_effects",
]

_HORIZONS = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0)
"""Times over which a command is to change the motion, s; the one that explains most counts."""

_CLEAR, _SHARE = 4.0, 0.15
"""An effect is seen if it is so many standard deviations, and explains this share."""

_SWINGS, _STRONG, _MOST = 3, 8.0, 0.5
"""A command that swings less often could be wind that turns a boat: it must explain more."""

_LEAST_ADVANCE, _LEAST_LENGTHS = 0.008, 0.001
"""Every propeller takes a boat farther than this in a revolution: m, and lengths of the boat."""

_MOST_LENGTHS = 0.6
"""... and none farther than this, lengths."""

_BEYOND, _FULL = 5.0, 2.5
"""No shaft turns so many times as fast as the particulars say; nor so many times as fast, and
exactly as far as a scale goes."""

_SCALES = {1.0: "shares of full throttle", 100.0: "per cent"}

_UNITS = {60.0: "rpm", 2.0 * math.pi: "rad/s"}

_MOST_ANGLE = 1.3
"""Few rudders and drives turn farther than this, rad."""

_FIXED_ANGLE, _UNEQUAL = 0.05, 0.05
"""Angles that move by less, rad, are those of fixed units; and shaft speeds that differ by more of
their mean steer a boat without angles."""


_CIRCLES, _ONE_WAY = 2.0, 0.8
"""So many full turns, this share of all turning, against a command: no wind turns a boat so."""


_ANSWER, _ANSWERS, _PART = 0.5, 0.4, 0.15
"""A command holds a heading where heading and rate of turn (over the first, s) explain this share
of it, and each of them this part of its standard deviation."""


class Effect(NamedTuple):
    """What a command does to the motion, by regression."""

    gain: float
    """Acceleration for one unit of the command."""
    sd: float
    share: float
    """Of the variance of the acceleration that it explains beyond the motion itself."""
    horizon: float
    """Time over which it was seen, s."""
    swings: int = _SWINGS
    """How often the command went from one side to the other."""

    @property
    def clear(self) -> bool:
        """Whether the data tell its sign."""
        clear, share = (_CLEAR, _SHARE) if self.swings >= _SWINGS else (_STRONG, _MOST)
        return abs(self.gain) > clear * self.sd and self.share > share


def _regress(
    change: Array, motion: list[Array], commands: list[Array], horizon: float
) -> list[Effect]:
    """Return the effects of commands on the change of a motion that decays by itself."""
    ok = np.isfinite(change)
    for column in (*motion, *commands):
        ok &= np.isfinite(column)
    count = int(ok.sum())
    if count < ENOUGH:
        return []
    y = change[ok]
    own = np.column_stack([*(column[ok] for column in motion), np.ones(count)])
    scale = [max(float(np.std(column[ok])), 1e-300) for column in commands]
    A = np.column_stack([own, *(c[ok] / s for c, s in zip(commands, scale, strict=True))])
    if np.linalg.cond(A / np.sqrt((A**2).mean(axis=0) + 1e-300)) > 1e4:
        return []
    fit = np.linalg.lstsq(A, y, rcond=None)[0]
    left = y - A @ fit
    cov = np.linalg.pinv(A.T @ A) * float(left @ left) / max(count - A.shape[1], 1)
    effects = []
    for i in range(len(commands)):
        k = own.shape[1] + i
        rest = np.delete(A, k, axis=1)
        without = y - rest @ np.linalg.lstsq(rest, y, rcond=None)[0]
        share = 1.0 - float(left @ left) / max(float(without @ without), 1e-300)
        sd = math.sqrt(max(float(cov[k, k]), 0.0))
        unit = scale[i] * horizon
        effects.append(Effect(float(fit[k]) / unit, sd / unit, share, horizon))
    return effects


def _turning(recording: Recording) -> tuple[Array, Array] | None:
    """Return times and the integral of the yaw rate, from the compass; None without one."""
    t, compass = recording.samples("compass_rad")
    if len(t) < 3 * ENOUGH:
        return None
    return t, np.unwrap(compass[:, 0])


def yaw_effects(recording: Recording, sign: float = 1.0) -> dict[str, Effect]:
    """Return what commands do to the yaw rate: ``difference`` of thrusts, ``steering``, each side.

    Parameters
    ----------
    recording : Recording
        Times, compass and commands are used.
    sign : float
        -1 where the shaft speeds have the wrong sign.

    Returns
    -------
    dict of str to Effect
        Gains above 0 turn to starboard. ``difference`` is left less right squared shaft speed,
        ``steering`` the angle times thrust; ``left`` and ``right`` each unit's own thrust.
        Commands that do not change are not in it.

    Notes
    -----
    The change of the yaw rate over a time is regressed on the rate at its beginning and on the
    commands within it. So a helmsman who answers the motion does not turn the sign.
    """
    turning, n = _turning(recording), recording.cmd[:, :2]
    if turning is None or not np.isfinite(n).any():
        return {}
    force, angle, signals = _steering(recording, sign)
    total = force.sum(axis=1)
    signals = {
        name: value
        for name, value in signals.items()
        if np.std(value) > 0.02 * max(float(np.abs(total).max()) * _reach(name, angle), 1e-12)
    }
    if not signals:
        return {}
    best = _best(recording, turning, signals)
    if "difference" in best and "steering" not in signals:
        sides = {"left": force[:, 0], "right": force[:, 1]}
        if min(np.std(value) for value in sides.values()) > 0.05 * np.abs(force).max():
            best |= _best(recording, turning, sides)
    return best


def _steering(recording: Recording, sign: float) -> tuple[Array, Array, dict[str, Array]]:
    """Return squared shaft speeds (N, 2), mean angles (N,), and what turns the boat (N,)."""
    n = recording.cmd[:, :2]
    force = sign * np.nan_to_num(n * np.abs(n))
    angle = np.nan_to_num(recording.cmd[:, 2:]).mean(axis=1)
    total = force.sum(axis=1)
    steering = angle * (total if np.ptp(total) > 0.0 or total.any() else 1.0)
    return force, angle, {"difference": force[:, 0] - force[:, 1], "steering": steering}


def _circles(recording: Recording, signal: Array) -> float:
    """Return how many full turns the boat makes to the side of a steady command, if most are.

    Below 0: to the other side. 0: too few, or to both.
    """
    turning, most = _turning(recording), float(np.abs(signal).max(initial=0.0))
    if turning is None or most == 0.0:
        return 0.0
    t, psi = turning
    grid = np.arange(t[0], t[-1], max(2.0, 10.0 * float(np.median(np.diff(t)))))
    held = np.interp(grid[:-1], recording.t, signal)
    turned = np.where(np.abs(held) > 0.25 * most, np.diff(np.interp(grid, t, psi)), 0.0)
    along = float(turned @ np.sign(held))
    if abs(along) < _ONE_WAY * float(np.abs(turned).sum()):
        return 0.0
    circles = along / (2.0 * math.pi)
    return circles if abs(circles) > _CIRCLES else 0.0


def _swings(value: Array) -> int:
    """Return how often a command goes from one side of its middle to the other."""
    middle, half = float(np.mean(value)), 0.25 * float(np.std(value))
    side = np.sign(value - middle)[np.abs(value - middle) > half]
    return int((np.diff(side) != 0.0).sum())


def _reach(name: str, angle: Array) -> float:
    return max(float(np.abs(angle).max()), 1e-12) if name == "steering" else 1.0


def _best(
    recording: Recording, turning: tuple[Array, Array], signals: dict[str, Array]
) -> dict[str, Effect]:
    """Return the effects over the horizon that explains most."""
    t, psi = turning
    step = float(np.median(np.diff(t)))
    span = float(t[-1] - t[0])
    found: dict[str, Effect] = {}
    summed = {name: integrated(recording.t, value) for name, value in signals.items()}
    for horizon in _HORIZONS:
        if horizon < 3.0 * step or span < 25.0 * horizon:
            continue
        at = np.arange(t[0] + horizon, t[-1] - 2.0 * horizon, horizon)
        edges = [sampled(t, psi, at + k * horizon) for k in (-0.5, 0.0, 0.5, 1.0, 1.5)]
        # mean rates around the two ends; the commands act in between
        before, after = edges[2] - edges[0], edges[4] - edges[2]
        means = [
            sampled(recording.t, value, at + horizon) - sampled(recording.t, value, at)
            for value in summed.values()
        ]
        effects = _regress(
            (after - before) / horizon, [before / horizon], [m / horizon for m in means], horizon
        )
        for name, effect in zip(signals, effects, strict=False):
            if name not in found or _strength(effect) > _strength(found[name]):
                found[name] = effect
    return {name: effect._replace(swings=_swings(signals[name])) for name, effect in found.items()}


def _strength(effect: Effect) -> float:
    return effect.share * min(abs(effect.gain) / max(effect.sd, 1e-300), 100.0)


def speed_of(recording: Recording) -> tuple[Array, Array, Array] | None:
    """Return times (M,), velocities over ground (M, 2) and their headings (M,) from the fixes."""
    t, fix = recording.samples("gps_x_m", "gps_y_m")
    turning = _turning(recording)
    if len(t) < 3 * ENOUGH or turning is None:
        return None
    way, middle, step = ways(t, fix)
    if not np.isfinite(way).any():
        return None
    return middle, way / step, averaged(*turning, middle, step)


def surge_effect(recording: Recording) -> Effect | None:
    """Return what the total thrust does to the speed ahead; None where it does not change."""
    motion, n = speed_of(recording), recording.cmd[:, :2]
    if motion is None or not np.isfinite(n).any():
        return None
    total = np.nan_to_num(n * np.abs(n)).sum(axis=1)
    if np.std(total) < 0.1 * np.abs(total).max():
        return None
    middle, velocity, psi = motion
    if len(middle) < ENOUGH + 4:
        return None
    ahead = velocity[:, 0] * np.cos(psi) + velocity[:, 1] * np.sin(psi)
    step = float(middle[1] - middle[0])
    summed = integrated(recording.t, total)
    # from the middle of one step to that of the next
    pushed = np.diff(sampled(recording.t, summed, middle)) / step
    turned = np.diff(psi) / step
    own = [ahead[:-1], ahead[:-1] * np.abs(ahead[:-1]), turned**2]
    effects = _regress(np.diff(ahead) / step, own, [pushed], 1.0)
    return effects[0] if effects else None


def check_commands(recording: Recording, particulars: Particulars | None = None) -> list[Finding]:
    """Return what is wrong with units, signs and sides of the commands.

    Parameters
    ----------
    recording : Recording
        To be checked.
    particulars : Particulars, optional
        Of the boat: its length and its shaft speed at its speed tell units better.
    """
    found = _angles(recording) + _shafts(recording, particulars) + _kind(recording, particulars)
    surge = surge_effect(recording)
    wrong = surge is not None and surge.clear and surge.gain < 0.0
    if wrong and surge is not None:
        found.append(
            Finding(
                ERROR,
                "thrust-sign",
                f"{recording.called('n_left_rps', 'n_right_rps')}: the boat slows down when more "
                "thrust ahead is commanded",
                "turn the sign of the shaft speeds (scale = -1.0 in a mapping file), or of the "
                "compass (offset = 3.1416)",
                surge._asdict(),
            )
        )
    sign = -1.0 if wrong else 1.0
    yaw = yaw_effects(recording, sign)
    return found + (_against(recording, yaw, sign) or _sides(recording, yaw, sign))


def _against(recording: Recording, yaw: dict[str, Effect], sign: float) -> list[Finding]:
    """Return a finding where the boat circles against commands that do not change enough."""
    if not len(recording.t):
        return []
    steered = bool(np.nan_to_num(recording.cmd[:, 2:]).any())
    name = "steering" if steered else "difference"
    if name in yaw and yaw[name].clear:
        return []
    circles = _circles(recording, _steering(recording, sign)[2][name])
    if circles >= 0.0:
        return []
    if steered:
        called = recording.called("delta_left_rad", "delta_right_rad")
        code, what = "steering-sign", f"{called}: the boat turns against the angle"
        remedy = "turn its sign: scale = -1.0 in a mapping file; above 0 turns to starboard"
    else:
        called = recording.called("n_left_rps", "n_right_rps")
        code, what = "sides-swapped", f"{called}: the boat turns to the side that pushes more"
        remedy = "swap the two columns in a mapping file, or turn their sign if both run backwards"
    what += f", {-circles:.1f} times around: no wind does that"
    return [Finding(ERROR, code, what, remedy, {"circles": circles})]


def _holds_heading(recording: Recording, name: str, sign: float) -> bool:
    """Return whether a command answers heading and rate of turn, against both."""
    signal, turning = _steering(recording, sign)[2][name], _turning(recording)
    if turning is None or not np.std(signal) > 0.0:
        return False
    t, psi = turning
    grid = np.arange(t[0] + 1.0, t[-1] - 1.0, max(_ANSWER, 3.0 * float(np.median(np.diff(t)))))
    if len(grid) < ENOUGH:
        return False
    half = 0.5 * _ANSWER
    rate = (np.interp(grid + half, t, psi) - np.interp(grid - half, t, psi)) / _ANSWER
    motion = np.column_stack([np.interp(grid, t, psi), rate, np.ones(len(grid))])
    y = np.interp(grid, recording.t, signal)
    fit = np.linalg.lstsq(motion, y, rcond=None)[0]
    parts = fit[:2] * motion[:, :2].std(axis=0) / max(float(np.std(y)), 1e-300)
    answers = np.var(y - motion @ fit) < (1.0 - _ANSWERS) * np.var(y)
    return bool(answers and parts.max() < -_PART)


def _sides(recording: Recording, yaw: dict[str, Effect], sign: float) -> list[Finding]:
    """Return findings about swapped sides, a wrong sign of the angle, and a dead unit."""
    found = []
    shafts = recording.called("n_left_rps", "n_right_rps")
    angles = recording.called("delta_left_rad", "delta_right_rad")
    texts = {
        "difference": (
            "sides-swapped",
            f"{shafts}: left and right are swapped: more thrust on the left turns the boat to port",
            "swap the two columns in a mapping file, or turn their sign if both run backwards",
        ),
        "steering": (
            "steering-sign",
            f"{angles}: a positive angle turns the boat to port",
            "turn its sign: scale = -1.0 in a mapping file; above 0 turns to starboard",
        ),
    }
    for name, (code, what, remedy) in texts.items():
        effect = yaw.get(name)
        if effect is None:
            continue
        # in waves, a command that answers the motion seems to cause it
        if effect.clear and effect.gain < 0.0 and not _holds_heading(recording, name, sign):
            what += f", which explains {effect.share:.0%} of its turning"
            found.append(Finding(ERROR, code, what, remedy, effect._asdict()))
    left, right = yaw.get("left"), yaw.get("right")
    if left is not None and right is not None:
        for dead, name, other in ((left, "left", right), (right, "right", left)):
            most = abs(dead.gain) + 3.0 * dead.sd
            if other.clear and abs(other.gain) > 10.0 * other.sd and most < 0.3 * abs(other.gain):
                found.append(
                    Finding(
                        WARNING,
                        f"{name}-unit-dead",
                        f"{recording.called(f'n_{name}_rps')}: the {name} unit hardly turns the "
                        f"boat ({abs(dead.gain / other.gain):.0%} of the other's effect)",
                        "check this thruster, or whether its command is recorded",
                        {"gain": dead.gain, "other_gain": other.gain, "sd": dead.sd},
                    )
                )
    if not any(effect.clear for effect in yaw.values()):
        found.append(
            Finding(
                NOTE,
                "sides-unknown",
                "the commands steer too little to tell their sides and signs",
                "record a zigzag by hand to have them checked",
            )
        )
    return found


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
    return found


def _no_commands(name: str, motion: tuple[Array, Array, Array] | None) -> list[Finding]:
    """Return a finding where a boat goes without a command."""
    if motion is None:
        return []
    way = np.nansum(np.hypot(*motion[1].T)) * float(np.median(np.diff(motion[0])))
    if way < 20.0:
        return []
    what = f"{name}: all commands are 0, but the boat goes"
    remedy = "record the commands; without them a twin cannot learn"
    return [Finding(ERROR, "commands-missing", what, remedy)]


def _by_particulars(
    name: str, seen: Array, particulars: Particulars | None
) -> list[Finding]:
    """Return a finding about shaft speeds far from what the particulars state, in rest or not."""
    if particulars is None or SHARE in name:
        return []
    turning = np.abs(seen[seen != 0.0])
    usual, most = float(np.quantile(turning, 0.95)), float(turning.max())
    stated = particulars.shaft_speed
    evidence = {"usual": usual, "most": most, "stated": stated}
    full = _SCALES.get(most)
    if full is not None and not 1.0 / _FULL < most / stated < _FULL:
        what = f"{name}: at most {most:g}, as {full} go, where the particulars say {stated:.3g}"
        remedy = "scale = ... in a mapping: rev/s at full throttle over this number"
        return [Finding(ERROR, "shaft-unit", what + " rev/s", remedy, evidence)]
    if usual < _BEYOND * stated:
        return []
    what = (
        f"{name}: up to {usual:.4g} rev/s, {usual / stated:.2g} times what the particulars say "
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
            return [Finding(ERROR, "shaft-unit", what, remedy, evidence)]
        if 0.7 < ratio * unit < 1.4:
            what = f"{said}, {1.0 / ratio:.2g} times too much for this boat: rev/s read as {text}"
            return [Finding(ERROR, "shaft-unit", what, "take the conversion out", evidence)]
    if not shares and not _LEAST_LENGTHS < advance / particulars.length < _MOST_LENGTHS:
        what = f"{said}, {advance / particulars.length:.2g} of its length"
        return [Finding(ERROR, "shaft-unit", what, remedy, evidence)]
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
