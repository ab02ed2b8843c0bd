"""Seas that change, as a text: values with their times, such as ``0.3@0,0.9@60``."""

from __future__ import annotations

import bisect
import math
from collections.abc import Sequence
from itertools import pairwise

from usv_gym.world.recorded_spectrum import SeaError
from usv_gym.world.sea import SeaKeyframe, SeaState

__all__ = ["SCHEDULE_HELP", "changing_sea", "parse_values"]

SCHEDULE_HELP = "One number, or values with their times in s: 0.3@0,0.9@60."
"""What a text of :func:`parse_values` may be, for messages."""

_TURN = 2.0 * math.pi

Values = tuple[tuple[float, float], ...]
"""Times (s) and values."""


def parse_values(text: str | float, name: str) -> Values:
    """Return the times (s) and values that a text stands for; one number holds from 0 s on.

    Parameters
    ----------
    text : str or float
        A number, or items ``value@time`` in the order of time, joined by commas.
    name : str
        Of the option, for messages.

    Raises
    ------
    SeaError
        Names the option and what it may be.
    """
    wrong = SeaError(
        f"{name} = {text!r}: write one number, or values with their times in s, as 0.3@0,0.9@60"
    )
    found: list[tuple[float, float]] = []
    items = str(text).split(",")
    for item in items:
        value, mark, time = item.partition("@")
        if not mark and len(items) > 1:
            raise wrong
        try:
            found.append((float(time) if mark else 0.0, float(value)))
        except ValueError:
            raise wrong from None
        if not all(map(math.isfinite, found[-1])):
            raise SeaError(f"{name} = {text!r}: {item!r} is not finite; write value@time")
    if found[0][0] < 0.0:
        raise SeaError(f"{name} = {text!r}: times begin at 0 s, but {found[0][0]:g} s is given")
    for before, after in pairwise(item[0] for item in found):
        if after <= before:
            raise SeaError(
                f"{name} = {text!r}: times must rise, but {after:g} s follows {before:g} s"
            )
    return tuple(found)


def _at(values: Values, t: float, *, turning: bool = False) -> float:
    """Return the value at a time, between two of them by a straight line."""
    row = bisect.bisect_right(values, t, key=lambda item: item[0])
    if row in (0, len(values)):
        return values[max(row - 1, 0)][1]
    (begin, first), (end, last) = values[row - 1 : row + 1]
    way = math.remainder(last - first, _TURN) if turning else last - first
    return first + (t - begin) / (end - begin) * way


def changing_sea(
    state: SeaState,
    hs: str | float | None = None,
    wind: str | float | None = None,
    wind_from_deg: str | float | None = None,
) -> SeaState:
    """Return a sea state with other waves and wind, which may change as time goes on.

    Parameters
    ----------
    state : SeaState
        The sea state; what is None stays as it is there, also where that changes.
    hs, wind, wind_from_deg : str or float, optional
        Wave height (m), wind speed (m/s) and where the wind comes from (degrees): a number, or a
        text for :func:`parse_values`.

    Raises
    ------
    SeaError
        Names the option that is wrong, and the remedy.
    """
    given = {"hs": hs, "wind": wind, "wind_from": wind_from_deg}
    parsed = {name: parse_values(v, name) for name, v in given.items() if v is not None}
    if "wind_from" in parsed:
        parsed["wind_from"] = tuple((t, math.radians(v) % _TURN) for t, v in parsed["wind_from"])
    if not parsed:
        return state
    if not state.schedule and all(len(values) == 1 for values in parsed.values()):
        return state.replace(**{name: values[0][1] for name, values in parsed.items()})
    own: Sequence[SeaKeyframe] = state.schedule or (SeaKeyframe(0.0, state.hs, state.wind),)
    for name in given:
        if name not in parsed:
            values = [(one.time, getattr(one, name)) for one in own]
            parsed[name] = tuple((t, state.wind_from if v is None else v) for t, v in values)
    times = sorted({item[0] for values in parsed.values() for item in values})
    schedule = [
        SeaKeyframe(
            t,
            _at(parsed["hs"], t),
            _at(parsed["wind"], t),
            _at(parsed["wind_from"], t, turning=True) % _TURN,
        )
        for t in times
    ]
    return state.replace(schedule=schedule)
