"""Actuators with lag and rate limit, followed exactly from their commands."""

from __future__ import annotations

import math

from usv_kernel.jit import inlined, kernel

__all__ = [
    "follow",
    "follow_all",
]

ARRIVED_SHARE = 1e-7
"""Part of its target within which an actuator counts as there."""


@inlined
def follow(value, target, lag, rate, h):
    """Return where a lagged, rate-limited actuator is after a time h (s), exactly.

    It solves :func:`usv_kernel.scalar.actuate` for a constant target: straight at full rate, then
    an exponential. So a lag far shorter than the step does no harm.
    """
    return _follow(value, target, lag, rate, h, math.exp(-h / lag))


@inlined
def _follow(value, target, lag, rate, h, stay):
    """Do as :func:`follow`, with exp(-h / lag) at hand."""
    gap = target - value
    if abs(gap) <= ARRIVED_SHARE * abs(target):
        return target
    reach = rate * lag  # Within this gap the lag, not the rate, sets the speed.
    if abs(gap) > reach:
        straight = (abs(gap) - reach) / rate
        if h <= straight:
            return value + math.copysign(rate * h, gap)
        stay = math.exp((straight - h) / lag)
        gap = math.copysign(reach, gap)
    return target - gap * stay


@kernel
def follow_all(act, command, lags, n_unit, h):
    """Move the four actuators towards their commands for a time h (s), in place.

    ``n_unit`` turns the command's shaft speeds into the unit of the structure. ``lags`` (3,) are
    the time constants of shaft speed and drive angle (s, above 0) and the largest turning speed of
    the drives (rad/s).
    """
    _follow_pair(act, 0, n_unit * command[0], n_unit * command[1], lags[0], math.inf, h)
    _follow_pair(act, 2, command[2], command[3], lags[1], lags[2], h)


@inlined
def _follow_pair(act, at, left, right, lag, rate, h):
    """Move two actuators, of which mostly both have arrived or both do the same."""
    a, b = act[at], act[at + 1]
    if a != left or b != right:
        stay = math.exp(-h / lag)
        act[at] = _follow(a, left, lag, rate, h, stay)
        same = a == b and left == right
        act[at + 1] = act[at] if same else _follow(b, right, lag, rate, h, stay)
