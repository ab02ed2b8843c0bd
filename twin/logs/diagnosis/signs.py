"""Signs and sides of commands, by what they do to the motion."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Collection
from typing import NamedTuple

import numpy as np

from twin.logs.columns import Array
from twin.logs.diagnosis.findings import ERROR, NOTE, WARNING, Finding, Recording
from twin.logs.diagnosis.signals import ENOUGH, averaged, integrated, sampled, ways
from twin.logs.diagnosis.track import BOTH_MIRRORED, compass_reversed, thrust_sign

__all__ = [
    "Effect",
    "check_each_side",
    "check_signs",
    "speed_of",
    "surge_effect",
    "turned_by",
    "yaw_effects",
]

_HORIZONS = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0)
"""Times over which a command is to change the motion, s; the one that explains most counts."""

_CLEAR, _SHARE = 4.0, 0.15
"""An effect is seen if it is so many standard deviations, and explains this share."""

_SWINGS, _STRONG, _MOST = 3, 8.0, 0.5
"""A command that swings less often could be wind that turns a boat: it must explain more."""

_CHANGE = 0.1
"""A total thrust that spreads by less of its largest value tells nothing."""

_BETTER = 8.0
"""Log-likelihood by which a wrong sign must explain the motion better; also the price of a second
fault."""

_AGREE, _TURNS_ABOUT = 0.8, 0.5
"""Share of the way that goes as the thrust pushes: above the first it agrees, below the second it
tells nothing."""

_HEADING = {
    "compass-beyond-turn",
    "compass-degrees",
    "compass-late",
    "compass-offset",
    "compass-reversed",
    "compass-sign",
    "track-mirrored",
}
"""Faults of the heading that feign wrong commands."""

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
    times: int = 0
    """At which it was seen, this number."""

    @property
    def clear(self) -> bool:
        """Whether the data tell its sign."""
        clear, share = (_CLEAR, _SHARE) if self.swings >= _SWINGS else (_STRONG, _MOST)
        return abs(self.gain) > clear * self.sd and self.share > share

    @property
    def likelihood(self) -> float:
        """Logarithm of how much more likely the command makes the motion; 0 for a gain below 0."""
        if self.gain <= 0.0:
            return 0.0
        return -0.5 * self.times * math.log(max(1.0 - self.share, 1e-9))


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
        effects.append(Effect(float(fit[k]) / unit, sd / unit, share, horizon, times=count))
    return effects


def _turning(recording: Recording) -> tuple[Array, Array] | None:
    """Return times and the integral of the yaw rate, from the compass; None without one."""
    t, compass = recording.samples("compass_rad")
    if len(t) < 3 * ENOUGH:
        return None
    return t, np.unwrap(compass[:, 0])


def yaw_effects(recording: Recording) -> dict[str, Effect]:
    """Return what commands do to the yaw rate: ``difference`` of thrusts, ``steering``, each side.

    Parameters
    ----------
    recording : Recording
        Times, compass and commands are used.

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
    force, angle, signals = _steering(recording)
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


def _steering(recording: Recording) -> tuple[Array, Array, dict[str, Array]]:
    """Return squared shaft speeds (N, 2), mean angles (N,), and what turns the boat (N,)."""
    n = recording.cmd[:, :2]
    force = np.nan_to_num(n * np.abs(n))
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
    n = recording.cmd[:, :2]
    total = np.nan_to_num(n * np.abs(n)).sum(axis=1)
    if not len(total) or np.std(total) < _CHANGE * np.abs(total).max():
        return None
    effects = _surge(recording, [total])
    return effects[0] if effects else None


def _surge(recording: Recording, thrusts: list[Array]) -> list[Effect]:
    """Return what thrusts (N,) do to the speed ahead; nothing where that is not known."""
    motion = speed_of(recording)
    if motion is None or not np.isfinite(recording.cmd[:, :2]).any():
        return []
    middle, velocity, psi = motion
    if len(middle) < ENOUGH + 4:
        return []
    ahead = velocity[:, 0] * np.cos(psi) + velocity[:, 1] * np.sin(psi)
    step = float(middle[1] - middle[0])
    # from the middle of one step to that of the next
    pushed = [
        np.diff(sampled(recording.t, integrated(recording.t, thrust), middle)) / step
        for thrust in thrusts
    ]
    turned = np.diff(psi) / step
    own = [ahead[:-1], ahead[:-1] * np.abs(ahead[:-1]), turned**2]
    return _regress(np.diff(ahead) / step, own, pushed, 1.0)


def turned_by(recording: Recording, yaw: dict[str, Effect] | None = None) -> int:
    """Return 1 where the commands turn the boat as the compass says, -1 against it, else 0.

    Parameters
    ----------
    recording : Recording
        Times, compass and commands are used.
    yaw : dict of str to Effect, optional
        From :func:`yaw_effects`.
    """
    if not len(recording.t):
        return 0
    effects = yaw_effects(recording) if yaw is None else yaw
    name = "steering" if np.nan_to_num(recording.cmd[:, 2:]).any() else "difference"
    effect = effects.get(name)
    if effect is not None and effect.clear:
        sign = 1 if effect.gain > 0.0 else -1
        # in waves, a command that answers the motion seems to cause it
        return 0 if _answers(recording, name) == sign else sign
    return int(np.sign(_circles(recording, _steering(recording)[2][name])))


def check_signs(recording: Recording, heading: Collection[Finding] = ()) -> list[Finding]:
    """Return what is wrong with signs and sides of the commands.

    One explanation is given: that which explains the motion best.

    Parameters
    ----------
    recording : Recording
        To be checked.
    heading : collection of Finding
        About the heading. Where it is at fault, the motion does not tell.
    """
    fault = next((finding for finding in heading if _is_of_heading(finding)), None)
    if fault is not None:
        return [
            Finding(
                NOTE,
                "commands-unchecked",
                "signs and sides of the commands are not checked: heading or track are at fault",
                "mend that first, then check again",
            )
        ]
    if any(finding.code == "thrust-sign" for finding in heading):
        return []
    yaw = yaw_effects(recording)
    surge = surge_effect(recording)
    if surge is not None and surge.clear and surge.gain < 0.0:
        what = "slows down when more thrust ahead is commanded"
        # a wrong sign of both shafts also turns their effect on the heading
        if turned_by(recording, yaw) > 0:
            turns = f"the boat {what}, but turns as commanded"
            return [compass_reversed(recording, turns, surge)]
        return [thrust_sign(recording, f"the boat {what}", surge)]
    return _against(recording, yaw) or _sides(recording, yaw)


def _is_of_heading(finding: Finding) -> bool:
    """Return whether a finding says that the heading is wrong by more than commands can stand."""
    return finding.severity != NOTE and finding.code in _HEADING


def check_each_side(recording: Recording) -> tuple[list[Finding], Recording]:
    """Return a finding where one of two thrusters has the wrong sign, and the log with it mended.

    Parameters
    ----------
    recording : Recording
        To be checked.

    Notes
    -----
    The motion is regressed on total and difference of the thrusts, as each explanation has them:
    sound, both signs wrong, one sign wrong, sides swapped. One is named if it makes the motion
    much more likely than all the others.
    """
    found = _one_side(recording)
    if found is None:
        return [], recording
    cmd = recording.cmd.copy()
    cmd[:, 0 if found.code == "left-sign" else 1] *= -1.0
    return [found], dataclasses.replace(recording, cmd=cmd)


def _one_side(recording: Recording) -> Finding | None:
    """Return the finding about one thruster with the wrong sign, if there is one."""
    n = recording.cmd[:, :2]
    force = np.nan_to_num(n * np.abs(n))
    steered = np.nan_to_num(recording.cmd[:, 2:]).any()
    turning = _turning(recording)
    if turning is None or steered or not force.any():
        return None
    most = float(np.abs(force).sum(axis=1).max())
    sides = {"left": force[:, 0], "right": force[:, 1]}
    if min(np.std(value) for value in sides.values()) < 0.02 * most:
        return None

    motion = speed_of(recording)

    def pushed(left: float, right: float) -> float:
        """Return the share of the way that goes as the total thrust pushes, less that against."""
        return 0.0 if motion is None else _pushed(recording.t, force @ [left, right], motion)

    def explained(left: float, right: float, turn: float = 1.0) -> tuple[float, float]:
        """Return the likelihood of the motion, and the largest share that is explained."""
        signed = force * [left, right]
        total, difference = signed.sum(axis=1), turn * (signed[:, 0] - signed[:, 1])
        found = _surge(recording, [total]) if np.std(total) > _CHANGE * most else []
        found += _best(recording, turning, {"difference": difference}).values()
        share = max((each.share for each in found if each.gain > 0.0), default=0.0)
        against = _BETTER if pushed(left, right) < -_AGREE else 0.0
        return sum(each.likelihood for each in found) - against, share

    one = {"left": explained(-1.0, 1.0), "right": explained(1.0, -1.0)}
    name, (best, share) = max(one.items(), key=lambda item: item[1][0])
    others = [value[0] for key, value in one.items() if key != name]
    # sound, both signs wrong, sides swapped, the compass back to front
    others += [explained(*signs)[0] for signs in ((1.0, 1.0), (-1.0, -1.0))]
    others += [explained(1.0, 1.0, -1.0)[0], explained(-1.0, -1.0, -1.0)[0]]
    # two faults at once are less likely
    others += [explained(*signs, -1.0)[0] - _BETTER for signs in ((-1.0, 1.0), (1.0, -1.0))]
    if share < _SHARE or best < max(others) + _BETTER:
        return None
    # a thruster that does nothing has no sign
    own = 0 if name == "left" else 1
    seen = [
        effects[own]._replace(gain=turn * effects[own].gain)
        for turn, effects in (
            (1.0, _surge(recording, list(sides.values()))),
            (1.0 - 2.0 * own, list(_best(recording, turning, sides).values())),
        )
        if effects
    ]
    if not seen:
        # only together do they tell: the boat goes one way while their total turns about
        signs = (-1.0, 1.0) if name == "left" else (1.0, -1.0)
        if pushed(*signs) < _AGREE or abs(pushed(1.0, 1.0)) > _TURNS_ABOUT:
            return None
    elif not any(effect.gain < -_CLEAR * effect.sd for effect in seen):
        return None
    return Finding(
        ERROR,
        f"{name}-sign",
        f"{recording.called(f'n_{name}_rps')}: the {name} thruster pushes against its command, "
        f"which explains {share:.0%} of the motion",
        "turn the sign of this column alone: scale = -1.0 in a mapping file",
        {"likelihood": best, "next": max(others)},
    )


def _pushed(t: Array, total: Array, motion: tuple[Array, Array, Array]) -> float:
    """Return how much of the way goes ahead or astern as a total thrust (N,) says; 1: all of it."""
    middle, velocity, psi = motion
    ahead = velocity[:, 0] * np.cos(psi) + velocity[:, 1] * np.sin(psi)
    way = np.hypot(*velocity.T)
    sign = np.sign(averaged(t, total, middle, 2.0 * float(np.median(np.diff(middle)))))
    ok = np.isfinite(ahead) & np.isfinite(sign)
    return float(ahead[ok] @ sign[ok]) / max(float(way[ok].sum()), 1e-300)


def _against(recording: Recording, yaw: dict[str, Effect]) -> list[Finding]:
    """Return a finding where the boat circles against commands that do not change enough."""
    if not len(recording.t):
        return []
    steered = bool(np.nan_to_num(recording.cmd[:, 2:]).any())
    name = "steering" if steered else "difference"
    if name in yaw and yaw[name].clear:
        return []
    circles = _circles(recording, _steering(recording)[2][name])
    if circles >= 0.0:
        return []
    if steered:
        called = recording.called("delta_left_rad", "delta_right_rad")
        code, what = "steering-sign", f"{called}: the boat turns against the angle"
        remedy = "turn its sign: scale = -1.0 in a mapping file; above 0 turns to starboard"
    else:
        called = recording.called("n_left_rps", "n_right_rps")
        code, what = "sides-swapped", f"{called}: the boat turns to the side that pushes more"
        remedy = (
            "swap the two columns in a mapping file, or turn their sign if both run backwards"
            + BOTH_MIRRORED
        )
    what += f", {-circles:.1f} times around: no wind does that"
    return [Finding(ERROR, code, what, remedy, {"circles": circles})]


def _answers(recording: Recording, name: str) -> int:
    """Return -1 where a command answers heading and rate of turn against both, 1 along both."""
    signal, turning = _steering(recording)[2][name], _turning(recording)
    if turning is None or not np.std(signal) > 0.0:
        return 0
    t, psi = turning
    grid = np.arange(t[0] + 1.0, t[-1] - 1.0, max(_ANSWER, 3.0 * float(np.median(np.diff(t)))))
    if len(grid) < ENOUGH:
        return 0
    half = 0.5 * _ANSWER
    rate = (np.interp(grid + half, t, psi) - np.interp(grid - half, t, psi)) / _ANSWER
    motion = np.column_stack([np.interp(grid, t, psi), rate, np.ones(len(grid))])
    y = np.interp(grid, recording.t, signal)
    fit = np.linalg.lstsq(motion, y, rcond=None)[0]
    parts = fit[:2] * motion[:, :2].std(axis=0) / max(float(np.std(y)), 1e-300)
    if not np.var(y - motion @ fit) < (1.0 - _ANSWERS) * np.var(y):
        return 0
    return -1 if parts.max() < -_PART else 1 if parts.min() > _PART else 0


def _sides(recording: Recording, yaw: dict[str, Effect]) -> list[Finding]:
    """Return findings about swapped sides, a wrong sign of the angle, and a dead unit."""
    found, doubtful = [], False
    shafts = recording.called("n_left_rps", "n_right_rps")
    angles = recording.called("delta_left_rad", "delta_right_rad")
    texts = {
        "difference": (
            "sides-swapped",
            f"{shafts}: left and right are swapped: more thrust on the left turns the boat to port",
            "swap the two columns in a mapping file, or turn their sign if both run backwards"
            + BOTH_MIRRORED,
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
        if not (effect.clear and effect.gain < 0.0):
            continue
        if _answers(recording, name) < 0:
            doubtful = True
        else:
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
    if len(recording.samples("compass_rad")[0]) < ENOUGH:
        what = "without a heading, sides and signs of the commands are not checked"
        found.append(Finding(NOTE, "sides-unknown", what, ""))
    elif doubtful or not any(effect.clear for effect in yaw.values()):
        what = "the commands steer too little to tell their sides and signs"
        remedy = "record a zigzag by hand to have them checked"
        found.append(Finding(NOTE, "sides-unknown", what, remedy))
    return found
