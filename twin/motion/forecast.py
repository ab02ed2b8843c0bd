"""Forecasts of roll, pitch, heave and the vertical speed of the deck, learned while sailing.

Each channel at each horizon is a linear function of the last seconds of roll, pitch, their rates,
heave, vertical speed and vertical acceleration. Its weights come from ridge regression on the last
minutes: see :mod:`twin.motion.learning`. What a forecast was worth is measured as soon as the
motion is known. It shrinks to the mean where it showed no skill, and its interval has the size of
the errors that it made.

Source: docs/explanation/attitude.md; Hoerl and Kennard 1970 (ridge regression).
"""

from __future__ import annotations

import math

from twin.motion.forecast_state import (
    ERROR_LEFT,
    FIT_PRIOR_TICKS,
    HEAVE_CHANNEL,
    HORIZONS,
    N_CHANNELS,
    N_ERRORS,
    N_HORIZONS,
    N_LAGS,
    N_QUIET,
    PITCH,
    PRIOR_SD,
    PRIOR_TIME_S,
    QUIET_CHANNELS,
    QUIET_SPANS,
    UNSURE_SHARE,
)
from twin.motion.learning import apply_fit, leak_variance, skill, write_features
from twin.motion.state import ANGLE, HEAVE
from usv_kernel.jit import inlined, kernel

__all__ = ["forecast_motion", "quiet_probabilities"]


@inlined
def _variance(memory, k):
    """Return the variance of the errors of a forecast, against the truth."""
    n, s, noise = memory.verifications, skill(memory, k), memory.noise[k // N_HORIZONS]
    a, c, b = memory.verified[0, k], memory.verified[1, k], memory.verified[2, k]
    seen = max(b - 2.0 * s * c + s * s * a, 0.0)
    var = (n * seen + FIT_PRIOR_TICKS * memory.fit_var[k]) / (n + FIT_PRIOR_TICKS)
    # against estimates, whose errors are in both
    return max(var + (2.0 * s * memory.gain[k] * ERROR_LEFT[k] - 1.0) * noise, 0.5 * noise)


@kernel
def forecast_motion(ahead, attitude, memory, given, work, mean, var):
    """Write forecasts of all channels, now and at :data:`HORIZONS`.

    Parameters
    ----------
    ahead : ndarray, shape (1 + 21, 2)
        The twin's accelerations to starboard and forward in units of gravity, now and at the
        horizons.
    attitude, memory, given, work
        As for :func:`take_motion`; only ``work`` is written to.
    mean, var : ndarray, shape (1 + 21, 4)
        Written: means and variances in the order of :data:`CHANNELS`.
    """
    row = int(memory.rows) - 1
    ready = memory.is_fit > 0.0 and row - (N_LAGS - 1) * int(given.lag) >= 0
    if ready:
        write_features(row, int(given.lag), memory, work.features)
        apply_fit(memory, work.features, work.targets)
    for c in range(N_CHANNELS):
        now = memory.noise[c]
        mean[0, c] = (
            attitude.tilt[c, ANGLE]
            if c <= PITCH
            else attitude.vertical[HEAVE]
            if c == HEAVE_CHANNEL
            else memory.before[7]
        )
        leak = leak_variance(c, attitude, memory)
        var[0, c] = now + leak
        seconds = memory.moments[2, c]
        m = memory.moments[0, c]
        spread = max(memory.moments[1, c] - m * m, 0.0)
        prior = PRIOR_SD[c] ** 2
        spread = (seconds * spread + PRIOR_TIME_S * prior) / (seconds + PRIOR_TIME_S)
        for h in range(N_HORIZONS):
            k = c * N_HORIZONS + h
            if ready:
                mean[1 + h, c] = memory.means[k] + skill(memory, k) * work.targets[k]
                var[1 + h, c] = _variance(memory, k) + leak
            else:
                mean[1 + h, c] = m
                var[1 + h, c] = spread + now + leak
            if c <= PITCH:
                mean[1 + h, c] += memory.heel[c] * ahead[1 + h, c]


@kernel
def quiet_probabilities(mean, var, memory, given, out):
    """Write the probabilities that the deck stays within its limits for :data:`QUIET_SPANS`.

    The errors of past forecasts are laid on the present one, with both signs: waves go up and down
    alike. The share of them with which all channels stay within their limits is the probability.
    Before there are any, and where a channel
    is hardly measured, it comes from the variances.

    Parameters
    ----------
    mean, var : ndarray, shape (1 + 21, 4)
        Of :func:`forecast_motion`.
    memory, given
        As for :func:`take_motion`.
    out : ndarray, shape (3,)
        Written.
    """
    count = min(int(memory.n_errors), N_ERRORS)
    for c in range(3):
        channel, limit = QUIET_CHANNELS[c], given.limits[c]
        if var[0, channel] > (UNSURE_SHARE * limit) ** 2:
            count = 0  # errors against estimates that are worth little
    for s in range(len(QUIET_SPANS)):
        last = 0
        while last < N_QUIET and HORIZONS[last] <= QUIET_SPANS[s] + 1e-9:
            last += 1
        quiet = 0.0
        for e in range(count):
            for sign in (-1.0, 1.0):
                quiet += 1.0 if _stays_inside(mean, memory.errors[e], sign, given, last) else 0.0
        if count > 0:
            out[s] = (quiet + 0.5) / (2.0 * count + 1.0)
        else:
            out[s] = _independent(mean, var, given, last)


@inlined
def _stays_inside(mean, errors, sign, given, last):
    """Return whether the deck stays quiet, if the errors of a past forecast come again."""
    for c in range(3):
        channel, limit = QUIET_CHANNELS[c], given.limits[c]
        if not abs(mean[0, channel]) < limit:
            return False
        for h in range(last):
            if not abs(mean[1 + h, channel] + sign * errors[c, h]) < limit:
                return False
    return True


@inlined
def _independent(mean, var, given, last):
    """Return the probability that all channels are within their limits at one horizon, at worst."""
    least = 1.0
    for h in range(last + 1):
        chance = 1.0
        for c in range(3):
            channel, limit = QUIET_CHANNELS[c], given.limits[c]
            width = math.sqrt(2.0 * max(var[h, channel], 1e-12))
            m = mean[h, channel]
            chance *= 0.5 * (math.erf((limit - m) / width) + math.erf((limit + m) / width))
        least = min(least, chance)
    return least
