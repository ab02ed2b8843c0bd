"""Ridge regression of future motion on past motion, and how its forecasts turned out.

Heel and trim of a manoeuvre are no waves. They are taken out first, as a multiple of the twin's
own acceleration, and a forecast puts them back for the manoeuvre to come.
"""

from __future__ import annotations

import math

from twin.motion.forecast_state import (
    CLIMB_LEAK,
    DECK_SPEED,
    ERROR_LEFT,
    ERROR_PERIOD_S,
    ERROR_PLACES,
    FIRST_FIT_S,
    FIT_PRIOR_TICKS,
    FORGETTING_S,
    FREEDOM_SHARE,
    HEAVE_CHANNEL,
    HEAVE_LEAK_ALONE,
    HEAVE_LEAK_GNSS,
    HEEL_FORGETTING_S,
    HEEL_MEAN_S,
    HEEL_NOISE_RAD,
    HEEL_NOISE_S,
    HEEL_PRIOR,
    HEEL_PRIOR_SD,
    LONGEST_S,
    N_CHANNELS,
    N_ERRORS,
    N_FEATURES,
    N_HORIZONS,
    N_LAGS,
    N_QUIET,
    N_TERMS,
    PITCH,
    PLACES,
    QUIET_CHANNELS,
    REFIT_S,
    RIDGE,
    RING_ROWS,
    SIGNALS,
    STEPS,
    TARGETS,
    TICK_ROWS,
    VERIFIED_FORGETTING_S,
)
from twin.motion.state import ANGLE, CLIMB, CLIMB_TIMEOUT_S, HEAVE, N_TILT, RATE_BIAS
from twin.particulars import GRAVITY
from usv_kernel.jit import inlined, kernel
from usv_kernel.scalar import sincos

__all__ = ["apply_fit", "error_now", "leak_variance", "skill", "take_motion", "write_features"]


@inlined
def _signals(attitude, given, velocity, memory, out):
    """Write the signals of a row, without heel and trim of the manoeuvre, and deck speed."""
    phi, theta = attitude.tilt[0, ANGLE], attitude.tilt[1, ANGLE]
    p, q, r = attitude.rate[0], attitude.rate[1], attitude.rate[2]
    out[0], out[1] = phi, theta
    u = velocity[0]
    if math.isfinite(u):
        out[0] -= memory.heel[0] * u * r / GRAVITY
        out[1] -= memory.heel[1] * memory.smooth[1, 1]
    out[2], out[3] = p, q
    out[4], out[5] = attitude.vertical[HEAVE], attitude.vertical[CLIMB]
    out[6] = attitude.lift
    a, b, c = given.deck[0], given.deck[1], given.deck[2]
    s, g = sincos(phi)
    d, e = sincos(theta)
    x, y, z = q * c - r * b, r * a - p * c, p * b - q * a
    out[7] = out[5] - d * x + e * (s * y + g * z)


@inlined
def _learn_heel(dt, velocity, attitude, memory):
    """Learn how much the boat heels and trims with its own accelerations."""
    u, r = velocity[0], attitude.rate[2]
    if not (math.isfinite(u) and math.isfinite(memory.speed)) or dt <= 0.0:
        memory.speed = u
        return
    share = min(dt / HEEL_MEAN_S, 1.0)
    for k in range(2):
        a = u * r / GRAVITY if k == 0 else (u - memory.speed) / dt / GRAVITY
        y = attitude.tilt[k, ANGLE]
        memory.smooth[0, k] += share * (y - memory.smooth[0, k])
        memory.smooth[1, k] += share * (a - memory.smooth[1, k])
        y, a, sums = memory.smooth[0, k], memory.smooth[1, k], memory.heel_sums[k]
        fade = math.exp(-dt / HEEL_FORGETTING_S)
        for j in range(5):
            value = 1.0 if j == 0 else a if j == 1 else y if j == 2 else a * a if j == 3 else a * y
            sums[j] = fade * sums[j] + dt * value
        var, n = HEEL_NOISE_RAD**2 * HEEL_NOISE_S, sums[0]
        information = (sums[3] - sums[1] * sums[1] / n) / var
        seen = (sums[4] - sums[1] * sums[2] / n) / var
        before = 1.0 / HEEL_PRIOR_SD[k] ** 2
        memory.heel[k] = (HEEL_PRIOR[k] * before + seen) / (before + information)
    memory.speed = u


@inlined
def _entry(memory, row, j):
    """Return a signal at a row of the ring that need not be whole."""
    low = math.floor(row)
    share = row - low
    value = memory.ring[low % RING_ROWS, j]
    if share > 1e-6:
        value += share * (memory.ring[(low + 1) % RING_ROWS, j] - value)
    return value


@inlined
def write_features(row, lag, memory, out):
    """Write 1 and the signals of the last seconds before a row of the ring."""
    out[0] = 1.0
    at = 1
    for i in range(N_LAGS):
        values = memory.ring[(row - i * lag) % RING_ROWS]
        for j in range(SIGNALS):
            out[at] = values[j]
            at += 1


@inlined
def _add_products(memory, x, y):
    """Add one sample to the sums of the regression."""
    w = memory.weight
    for i in range(N_TERMS):
        row, a = memory.gram[i], w * x[i]
        for j in range(i, N_TERMS):
            row[j] += a * x[j]
        row = memory.cross[i]
        for j in range(TARGETS):
            row[j] += a * y[j]
    for j in range(TARGETS):
        memory.squares[j] += w * y[j] * y[j]
    memory.weights[0] += w
    memory.weights[1] += w * w


@inlined
def _fade(memory, growth):
    """Let older samples count less: the next ones weigh more, until all are scaled back."""
    memory.weight *= growth
    if memory.weight > 1e6:
        scale = 1.0 / memory.weight
        for i in range(N_TERMS):
            for j in range(N_TERMS):
                memory.gram[i, j] *= scale
            for j in range(TARGETS):
                memory.cross[i, j] *= scale
        for j in range(TARGETS):
            memory.squares[j] *= scale
        memory.weights[0] *= scale
        memory.weights[1] *= scale * scale
        memory.weight = 1.0


@kernel
def _fit(memory, work):
    """Solve the ridge regression for all channels and horizons at once, by Cholesky factors."""
    n, total = N_FEATURES, memory.weights[0]
    scale, U, B = work.scale, work.factor, work.right
    mean, first = memory.gram[0], memory.cross[0]
    for i in range(n):
        m = mean[i + 1] / total
        var = memory.gram[i + 1, i + 1] / total - m * m
        scale[i + 1] = 1.0 / math.sqrt(max(var, 1e-12))
    for i in range(n):
        row, out, m = memory.gram[i + 1], U[i], mean[i + 1] / total
        for j in range(i, n):
            out[j] = (row[j + 1] / total - m * mean[j + 1] / total) * scale[i + 1] * scale[j + 1]
        out[i] += RIDGE
        row, out = memory.cross[i + 1], B[i]
        for j in range(TARGETS):
            out[j] = (row[j] / total - m * first[j] / total) * scale[i + 1]
    for j in range(TARGETS):
        m = first[j] / total
        # heave is counted from its mean: another one is an error of the estimate
        memory.means[j] = 0.0 if j // N_HORIZONS == HEAVE_CHANNEL else m
        memory.fit_var[j] = max(memory.squares[j] / total - m * m, 0.0)
    for i in range(n):
        d, pivot = 1.0 / math.sqrt(max(U[i, i], 1e-12)), U[i]
        for k in range(i, n):
            pivot[k] *= d
        for j in range(i + 1, n):
            row, a = U[j], pivot[j]
            for k in range(j, n):
                row[k] -= a * pivot[k]
        right = B[i]
        for k in range(TARGETS):
            right[k] *= d
            memory.fit_var[k] -= right[k] * right[k]
        for j in range(i + 1, n):
            row, a = B[j], pivot[j]
            for k in range(TARGETS):
                row[k] -= a * right[k]
    for i in range(n - 1, -1, -1):
        d, right = 1.0 / U[i, i], B[i]
        for k in range(TARGETS):
            right[k] *= d
        for j in range(i):
            row, a = B[j], U[j, i]
            for k in range(TARGETS):
                row[k] -= a * right[k]
    for k in range(TARGETS):
        memory.coefficients[0, k] = 0.0
    for i in range(n):
        row, right, a, m = memory.coefficients[i + 1], B[i], scale[i + 1], mean[i + 1] / total
        offsets = memory.coefficients[0]
        for k in range(TARGETS):
            row[k] = a * right[k]
            offsets[k] -= m * row[k]
    for k in range(TARGETS):
        j = ERROR_PLACES[k // N_HORIZONS]
        memory.gain[k] = 0.0
        for i in range(N_LAGS):
            memory.gain[k] += memory.coefficients[1 + i * SIGNALS + j, k]
    samples = total * total / memory.weights[1]
    used = min(FREEDOM_SHARE * n / samples, 0.75)
    for k in range(TARGETS):
        m = first[k] / total
        whole = max(memory.squares[k] / total - m * m, 1e-12)
        memory.fit_var[k] = min(max(memory.fit_var[k], 0.0) / (1.0 - used), whole)
        memory.fit_worth[k] = 1.0 - memory.fit_var[k] / whole
    memory.is_fit = 1.0


@inlined
def apply_fit(memory, x, out):
    """Write the forecast deviations from the means (TARGETS,) of features x."""
    for k in range(TARGETS):
        out[k] = 0.0
    for i in range(N_TERMS):
        row, a = memory.coefficients[i], x[i]
        for k in range(TARGETS):
            out[k] += a * row[k]


@inlined
def _verify(tick, memory, targets, period):
    """Compare the forecast of a past tick with what came."""
    made, means = memory.made[tick % STEPS], memory.made_means[tick % STEPS]
    note = memory.made_at[tick % STEPS]
    if note[0] != tick or note[1] == 0.0:
        return
    memory.verifications += 1.0
    share = max(1.0 / memory.verifications, period / VERIFIED_FORGETTING_S)
    for k in range(TARGETS):
        a, b = made[k], targets[k] - means[k]
        memory.verified[0, k] += share * (a * a - memory.verified[0, k])
        memory.verified[1, k] += share * (a * b - memory.verified[1, k])
        memory.verified[2, k] += share * (b * b - memory.verified[2, k])
    every = max(round(ERROR_PERIOD_S / period), 1)
    if tick % every == 0:
        errors = memory.errors[int(memory.n_errors) % N_ERRORS]
        for c in range(3):
            first = QUIET_CHANNELS[c] * N_HORIZONS
            for h in range(N_QUIET):
                k = first + h
                errors[c, h] = targets[k] - means[k] - skill(memory, k) * made[k]
        memory.n_errors += 1.0


@inlined
def skill(memory, k):
    """Return the share of a forecast deviation that counts, from the verified ones.

    Forecast and what came after hold the same error of the estimate, which is no skill.
    """
    shared = memory.gain[k] * ERROR_LEFT[k] * memory.noise[k // N_HORIZONS]
    worth = (memory.verified[1, k] - shared) / max(memory.verified[0, k], 1e-12)
    # until enough are verified, the fit itself counts
    n = memory.verifications
    worth = (n * worth + FIT_PRIOR_TICKS * memory.fit_worth[k]) / (n + FIT_PRIOR_TICKS)
    return min(max(worth, 0.0), 1.0)


@inlined
def _tick(row, memory, given, work):
    """Learn from the motion that has become known, and note a forecast from now."""
    base, lag = given.base, int(given.lag)
    period, tick = TICK_ROWS * base, row // TICK_ROWS
    old = row - round(LONGEST_S / base)
    if old - (N_LAGS - 1) * lag >= 0:
        y = work.targets
        for h in range(N_HORIZONS):
            for c in range(N_CHANNELS):
                j = PLACES[c]
                y[c * N_HORIZONS + h] = _entry(memory, old + given.at[h], j)
        _verify(old // TICK_ROWS, memory, y, period)
        write_features(old, lag, memory, work.features)
        _add_products(memory, work.features, y)
        _fade(memory, math.exp(period / FORGETTING_S))
        memory.fitted -= 1.0
        if (
            memory.weights[0] ** 2 / memory.weights[1] * period >= FIRST_FIT_S
            and memory.fitted <= 0.0
        ):
            _fit(memory, work)
            memory.fitted = max(round(REFIT_S / period), 1)
    place = tick % STEPS
    memory.made_at[place, 0] = tick
    memory.made_at[place, 1] = memory.is_fit
    if memory.is_fit > 0.0:
        write_features(row, lag, memory, work.features)
        apply_fit(memory, work.features, memory.made[place])
        for k in range(TARGETS):
            memory.made_means[place, k] = memory.means[k]


@kernel
def take_motion(t, velocity, attitude, memory, given, work):
    """Take the attitude of a row: learn from it, and note what forecasts begin with.

    Parameters
    ----------
    t : float
        Time of the row, s.
    velocity : ndarray, shape (3,)
        Speed forward and to starboard (m/s) and rate of turn (rad/s) by the twin; NaN where it has
        none.
    attitude : record of ``twin.motion.state.ATTITUDE``
        After the row.
    memory : record of :data:`FORECAST`
        Advanced in place.
    given : record of :data:`FORECAST_SETTINGS`
        Of the boat.
    work : record of :data:`FORECAST_WORK`
        Scratch.
    """
    dt = t - memory.t_before if math.isfinite(memory.t_before) else 0.0
    _learn_heel(dt, velocity, attitude, memory)
    now = work.now
    _signals(attitude, given, velocity, memory, now)
    for c in range(N_CHANNELS):
        memory.noise[c] = error_now(c, attitude, given)
    base = given.base
    if attitude.rows <= 1.0 or not math.isfinite(memory.t_before):
        # a start or a gap: the past has no link to what comes
        memory.rows, memory.begun = 0.0, t
    else:
        for c in range(N_CHANNELS):
            y, moments = now[PLACES[c]], memory.moments
            moments[2, c] += dt
            share = min(dt / min(moments[2, c], FORGETTING_S), 1.0) if moments[2, c] > 0.0 else 1.0
            moments[0, c] += share * (y - moments[0, c])
            moments[1, c] += share * (y * y - moments[1, c])
    while memory.begun + memory.rows * base <= t + 1e-6:
        row, due = int(memory.rows), memory.begun + memory.rows * base
        share = min((due - memory.t_before) / dt, 1.0) if dt > 0.0 and row > 0 else 1.0
        kept = memory.ring[row % RING_ROWS]
        for j in range(SIGNALS + 1):
            kept[j] = (
                now[j]
                if share > 1.0 - 1e-6
                else memory.before[j] + share * (now[j] - memory.before[j])
            )
        memory.rows += 1.0
        if row % TICK_ROWS == 0:
            _tick(row, memory, given, work)
    for j in range(SIGNALS + 1):
        memory.before[j] = now[j]
    memory.t_before = t


@inlined
def leak_variance(c, attitude, memory):
    """Return the variance of what the vertical filter takes from the waves themselves.

    It leaves out slow motion and shifts the rest in time, much more so without GNSS.
    """
    heave, climb = memory.moments[1, HEAVE_CHANNEL], memory.moments[1, DECK_SPEED]
    alone = attitude.ages[6] > CLIMB_TIMEOUT_S
    if c == HEAVE_CHANNEL:
        share = HEAVE_LEAK_ALONE if alone else HEAVE_LEAK_GNSS
        return share * share * heave
    return CLIMB_LEAK**2 * climb if c == DECK_SPEED and alone else 0.0


@inlined
def error_now(c, attitude, given):
    """Return the variance of the drifting error of the estimate of a channel."""
    if c <= PITCH:
        at = c * N_TILT + ANGLE
        return attitude.P[at, at]
    climb = attitude.P_vertical[CLIMB, CLIMB]
    if c == HEAVE_CHANNEL:
        return attitude.P_vertical[HEAVE, HEAVE]
    a, b = given.deck[0], given.deck[1]
    rate = (a * a + b * b) * attitude.P[RATE_BIAS, RATE_BIAS]
    return climb + rate
