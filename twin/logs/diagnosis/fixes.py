"""Fixes by themselves: steps aside, spikes, and fixes that stand still while the boat goes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from twin.logs.columns import Array
from twin.logs.diagnosis.findings import ERROR, WARNING, Finding, Recording
from twin.logs.diagnosis.signals import ENOUGH, averaged, runs_of, ways
from twin.logs.diagnosis.track import thrust

__all__ = ["MANY", "Stand", "check_fixes", "find_stands", "rows_that_catch_up", "within"]

MANY = 0.1
"""From this share of the fixes on, false ones spoil a log."""

_OUTLIER = 15.0
"""A fix is out of line if it is aside by more than so many times the median deviation."""

_STEP = 0.1
"""A smaller step aside is not worth a word, m."""

_EVEN = 3.0
"""A step over so many times the median interval may be way, and counts as no step aside."""

_FEW, _SINGLE = 3, 0.01
"""More steps than the first, and than the second as a share of the fixes, are no single ones:
stamps jitter, or the boat is quick."""

_WINDOW = 11
"""A spike is aside from the median of so many fixes, itself in the middle."""

_SPIKE, _SPIKES = 2.0, 4
"""A smaller spike is none, m. Fewer spikes than this are left to the search for steps."""

_TURN, _TOP = 4.0, 0.95
"""A boat that turns leaves the median of its fixes by up to so many steps at its top speed, which
is this quantile of its speeds: those above may be false."""

_TYPICAL = 0.75
"""The typical speed of a boat that goes is this quantile: it may also rest at times."""

_CATCHES_UP, _CATCHES_UP_STEPS = 1.0, 8.0
"""A shorter step catches up with nothing: in m, and in median steps."""

_MOST_STEPS = 1000
"""Most steps that are tried; more are noise."""

_LAST = 9
"""The place where fixes stand still is the median of so many before they catch up."""

_STILL, _STILL_SHARE = 0.1, 0.02
"""Fixes stand still within this, m, or this share of the step that follows ..."""

_STILL_SCATTER, _STILL_MOST = 4.5, 0.1
"""... or, up to this share of the step, within so many median distances from their place: of
Gaussian noise, one fix of a million is outside."""

_LONG, _STANDS = 3.0, ENOUGH // 2
"""Fixes that stand for a shorter time, s, or are fewer, tell nothing."""

_PASSED = (0.3, 3.0)
"""A step catches up if it is as long as the way at the typical speed, times a factor in between."""

_GOES = 0.3
"""A boat goes from this share of its typical speed on."""

_LEAPS = 10.0
"""Fixes beside a stand that go so many times the typical speed leap to a false place and back."""

_DRIVEN, _BEFORE = 0.5, 2
"""A boat is driven from this share of its strong thrust (or speed) on, also in so many windows
before: it needs time to get under way."""

_STRONG = 0.9
"""Strong thrust, or speed, is this quantile."""

_STOPPED, _STOPPED_FOR = 0.1, 10.0
"""Fixes stand if they go slower than this share of the typical speed while the boat is driven, for
at least this long, s."""

_LOW, _CONSISTENT, _OTHERS = 0.1, 0.5, 8
"""Thrust tells speed if this quantile of the speeds over thrust is above this share of their
median, in at least so many other windows."""


class Stand(NamedTuple):
    """A stretch in which fixes stand still while the boat goes."""

    start: float
    """Time of its first fix, s ..."""
    end: float
    """... and of its last."""
    caught_up: float
    """Step that ends it, m; 0 where none does."""
    why: str
    """What says that the boat goes."""
    sure: bool
    """Whether the boat cannot have been held or aground instead."""


def check_fixes(recording: Recording, t: Array, fix: Array, stands: list[Stand]) -> list[Finding]:
    """Return a finding where fixes stand still, or else jump aside.

    Parameters
    ----------
    recording : Recording
        For the names of its columns.
    t, fix : ndarray, shape (N,) and (N, 2)
        Times, s, and positions, m, without those that no boat can reach.
    stands : list of Stand
        From :func:`find_stands`.
    """
    if len(t) < 3 * ENOUGH:
        return []
    names = recording.called("gps_x_m", "gps_y_m")
    return _stand(names, t, stands) if stands else _spikes_or_steps(names, t, fix)


def find_stands(recording: Recording, t: Array, fix: Array) -> list[Stand]:
    """Return where fixes stand still while the boat goes.

    Parameters
    ----------
    recording, t, fix
        As for :func:`check_fixes`.
    """
    if len(t) < 3 * ENOUGH:
        return []
    return [
        Stand(float(t[i]), float(t[k]), float(np.hypot(*(fix[k + 1] - fix[i]))), "", True)
        for i, k in rows_that_catch_up(t, fix)
    ] or _stands_driven(recording, t, fix)


def within(t: Array, stands: list[Stand]) -> npt.NDArray[np.bool_]:
    """Return which times (N,), s, lie in stretches in which fixes stand still."""
    inside = np.zeros(len(t), dtype=np.bool_)
    for each in stands:
        inside |= (t >= each.start) & (t <= each.end)
    return inside


def _stand(names: str, t: Array, stands: list[Stand]) -> list[Finding]:
    """Return the finding about fixes that stand still."""
    lost = int(within(t, stands).sum())
    longest = max(each.end - each.start for each in stands)
    # of those that catch up the one that is farthest off, else the longest
    worst = max(stands, key=lambda each: (each.caught_up, each.end - each.start))
    what = (
        f"{names}: the fixes stand still for {worst.end - worst.start:.0f} s, from t = "
        f"{worst.start:.1f} to {worst.end:.1f} s"
    )
    what += f", and then catch up by {worst.caught_up:.2g} m" if worst.caught_up else ""
    what += f", while {worst.why}" if worst.why else ""
    what += f"; {len(stands)} times" if len(stands) > 1 else ""
    remedy = "the receiver or its filter held the last fix: empty these cells"
    remedy += "" if worst.sure else "; or the boat was held or aground"
    evidence = {
        "most_m": worst.caught_up,
        "longest_s": longest,
        "at_s": worst.start,
        "until_s": worst.end,
        "times": float(len(stands)),
    }
    severity = ERROR if worst.sure and lost > MANY * len(t) else WARNING
    return [Finding(severity, "fix-stands", what, remedy, evidence)]


def _spikes_or_steps(names: str, t: Array, fix: Array) -> list[Finding]:
    """Return the finding that explains more fixes: spikes, or steps aside."""
    spikes, steps = _spikes(names, t, fix), _steps(names, t, fix)
    if not spikes or not steps:
        return spikes or steps
    return spikes if spikes[0].evidence["fixes"] > steps[0].evidence["times"] else steps


def _steps(names: str, t: Array, fix: Array) -> list[Finding]:
    """Return a finding where fixes step aside and stay there."""
    step, width = np.diff(fix, axis=0), np.diff(t)
    speed = step / width[:, None]
    # the part of the jump that the steps around it do not explain
    near = np.median([speed[:-4], speed[1:-3], speed[3:-1], speed[4:]], axis=0)
    left = np.hypot(*(step[2:-2] - width[2:-2, None] * near).T)
    even = width[2:-2] < _EVEN * float(np.median(width))
    bound = max(_STEP, _OUTLIER * float(np.median(left)))
    wild = np.flatnonzero((left > bound) & even)
    if not 0 < len(wild) <= max(_FEW, _SINGLE * len(t)):
        return []
    most = int(wild[np.argmax(left[wild])])
    at, length = float(t[most + 3]), float(left[most])
    what = (
        f"{names}: the fixes step aside by up to {length:.2g} m from one to the next (at t = "
        f"{at:.1f} s), {len(wild)} time(s)"
    )
    remedy = "the receiver changed satellites or mode: expect errors of the position of this size"
    evidence = {"most_m": length, "at_s": at, "times": float(len(wild))}
    return [Finding(WARNING, "fix-steps", what, remedy, evidence)]


def _spikes(names: str, t: Array, fix: Array) -> list[Finding]:
    """Return a finding where fixes jump aside and come back, again and again."""
    half = _WINDOW // 2
    windows = np.lib.stride_tricks.sliding_window_view(fix, _WINDOW, axis=0)
    # along a track the middle of its neighbours is their median, however they are spaced
    far = np.hypot(*(fix[half:-half] - np.median(windows, axis=-1)).T)
    at = t[half:-half]
    near = far <= max(_SPIKE, _OUTLIER * float(np.median(far)))
    speed = np.hypot(*np.diff(fix[half:-half][near], axis=0).T) / np.diff(at[near])
    if len(speed) < ENOUGH:
        return []
    # a turn of a boat that goes fast is no spike
    quick = _TURN * float(np.quantile(speed, _TOP)) * float(np.median(np.diff(t)))
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


def rows_that_catch_up(t: Array, fix: Array) -> list[tuple[int, int]]:
    """Return first and last row of each stretch in which fixes stand still, and then catch up.

    Parameters
    ----------
    t, fix : ndarray, shape (N,) and (N, 2)
        Times, s, and positions, m, of a boat that goes.
    """
    step = np.hypot(*np.diff(fix, axis=0).T)
    way, middle, width = ways(t, fix)
    speed = np.hypot(*way.T) / width
    speed = speed[np.isfinite(speed)]
    if not len(middle) or not len(speed):
        return []
    typical = max(float(np.quantile(speed, _TYPICAL)), 1e-12)
    bound = max(_CATCHES_UP, _CATCHES_UP_STEPS * float(np.median(step)))
    found = []
    for k in np.flatnonzero(step > bound)[:_MOST_STEPS]:
        start = _stood_from(fix[: k + 1], float(step[k]))
        length = float(t[k] - t[start])
        if k - start < _STANDS or length < _LONG:
            continue
        passed = step[k] / (length * typical)
        gone = np.array([_went(t, fix, start, -1), _went(t, fix, int(k) + 1, 1)]) / typical
        goes = (gone > _GOES).all() and (gone < _LEAPS).all()
        if _PASSED[0] < passed < _PASSED[1] and goes:
            found.append((start, int(k)))
    return found


def _stands_driven(recording: Recording, t: Array, fix: Array) -> list[Stand]:
    """Return where fixes stand still while velocity or commands say that the boat goes.

    They need not catch up: the log may end before, or the boat has come back.
    """
    way, middle, width = ways(t, fix)
    if len(middle) < _OTHERS:
        return []
    speed = np.hypot(*way.T) / width
    at, velocity = recording.samples("gps_vx_mps", "gps_vy_mps")
    ahead = thrust(recording)
    sources: dict[str, Array] = {}
    by_velocity = "the speed over ground says that the boat goes"
    if len(at) >= ENOUGH:
        sources[by_velocity] = np.hypot(*averaged(at, velocity, middle, width).T)
    if ahead is not None:
        drive = np.sqrt(np.abs(averaged(*ahead, middle, width)))
        late = [np.roll(drive, k) for k in range(_BEFORE + 1)]
        sources["the boat is driven as where it goes"] = np.minimum.reduce(late)
    half = 0.5 * width
    for why, drive in sources.items():
        found = [
            Stand(
                float(middle[i] - half), float(middle[j - 1] + half), 0.0, why, why == by_velocity
            )
            for i, j in runs_of(_is_still(speed, drive))
            if (j - i) * width >= _STOPPED_FOR
        ]
        if found:
            return found
    return []


def _is_still(speed: Array, drive: Array) -> npt.NDArray[np.bool_]:
    """Return in which windows a boat hardly goes, although driven as where it goes.

    Parameters
    ----------
    speed, drive : ndarray, shape (N,)
        Speed of the fixes, m/s, and what is about proportional to it; NaN where unknown.
    """
    none = np.zeros(len(speed), dtype=np.bool_)
    known = np.isfinite(speed) & np.isfinite(drive)
    if known.sum() < _OTHERS:
        return none
    strong = float(np.quantile(drive[known], _STRONG))
    driven = known & (drive > max(_DRIVEN * strong, 1e-9))
    if driven.sum() < _OTHERS:
        return none
    gain = np.where(driven, speed / np.where(driven, drive, 1.0), np.inf)
    still = gain < _STOPPED * float(np.median(gain[driven]))
    others = gain[driven & ~still]
    consistent = len(others) >= _OTHERS and np.quantile(others, _LOW) > _CONSISTENT * np.median(
        others
    )
    return still if consistent else none


def _stood_from(fix: Array, step: float) -> int:
    """Return from which row fixes (N, 2) stand still until the last, before a step, m."""
    last = fix[-_LAST:]
    place = np.median(last, axis=0)
    scatter = _STILL_SCATTER * float(np.median(np.hypot(*(last - place).T)))
    radius = max(_STILL, _STILL_SHARE * step, min(scatter, _STILL_MOST * step))
    apart = np.flatnonzero(np.hypot(*(fix - place).T) > radius)
    return int(apart[-1]) + 1 if len(apart) else 0


def _went(t: Array, fix: Array, row: int, way: int) -> float:
    """Return the mean speed in the seconds before (way -1) or after (1) a row; 0 if unknown."""
    edge = t[row] + way * _LONG
    other = int(np.searchsorted(t, edge).clip(0, len(t) - 1))
    time = abs(float(t[other] - t[row]))
    return float(np.hypot(*(fix[other] - fix[row]))) / time if time > 0.0 else 0.0
