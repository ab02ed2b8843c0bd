"""Forecasts of roll, pitch, heave and the vertical speed of the deck, learned while sailing.

Each channel at each horizon is a linear function of the last seconds of roll, pitch, their rates,
vertical speed and vertical acceleration. Its weights come from ridge regression on the last two
minutes. What a forecast was worth is measured as soon as the motion is known: it is drawn back to
the mean where it showed no skill, and its interval has the size of the errors that it made.

Heel and trim of a manoeuvre are no waves. They are taken out before, as a multiple of the twin's
own acceleration, and put back for the manoeuvre to come.

Source: docs/explanation/attitude.md; Hoerl and Kennard 1970 (ridge regression).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from twin.motion.state import ANGLE, CLIMB, HEAVE, RATE_BIAS
from twin.motion.state import MEMORY as MEMORY_OF_HEAVE
from twin.particulars import GRAVITY, Particulars
from usv_kernel.jit import inlined, kernel
from usv_kernel.records import record_size
from usv_kernel.scalar import sincos

__all__ = [
    "CHANNELS",
    "DECK_SPEED",
    "FORECAST",
    "FORECAST_SETTINGS",
    "FORECAST_WORK",
    "HEAVE_CHANNEL",
    "HORIZONS",
    "N_CHANNELS",
    "PITCH",
    "QUIET_SPANS",
    "ROLL",
    "error_now",
    "forecast_motion",
    "forecast_settings",
    "initial_forecast",
    "quiet_probabilities",
    "take_motion",
]

Array = NDArray[np.float64]

CHANNELS = ("roll_rad", "pitch_rad", "heave_m", "deck_speed_mps")
"""What is forecast. Heave and the vertical speed of the deck point are positive down."""

ROLL, PITCH, HEAVE_CHANNEL, DECK_SPEED = range(len(CHANNELS))

N_CHANNELS = len(CHANNELS)

HORIZONS = np.concatenate([np.arange(1, 13) * 0.25, np.arange(7, 11) * 0.5, np.arange(6.0, 11.0)])
"""Times ahead of the forecasts, s."""

N_HORIZONS = len(HORIZONS)

LAST = float(HORIZONS[-1])

TARGETS = N_CHANNELS * N_HORIZONS

LAGS = 16
"""Samples of each signal that a forecast is made from ..."""

LAG, LAG_LENGTH = 0.2, 6.336
"""... and the time between them, s, on a boat of this length (m). It grows with the root of it."""

BASE = 0.05
"""Time between the rows that are kept, s; more for ships."""

TICK = 4
"""Of these rows one in so many is learned from."""

SIGNALS = 7
"""Roll, pitch, their rates, heave, vertical speed, vertical acceleration; the deck's vertical speed
follows."""

PLACES = (0, 1, 4, 7)
"""Where the channels stand among these."""

N_FEATURES = LAGS * SIGNALS

N_TERMS = N_FEATURES + 1

RING_ROWS = round(LAST / BASE) + TICK * LAGS

PENALTY = 0.01
"""Of the ridge, in units of the features' own energy."""

MEMORY = 60.0
"""Time after which what was learned weighs a third, s."""

REFIT = 10.0
"""Time between fits, s."""

LEARNED = 25.0
"""Time of data before the first fit, s."""

VERIFIED = 60.0
"""Time after which a verified error weighs a third, s."""

TRUST_TICKS = 60.0
"""So many ticks does the error of a fit on its own data count, beside the verified ones."""

FIT_SHARE = 0.5
"""Share of the features that a fit is taken to use up."""

PRIOR_SD = (0.05, 0.05, 0.2, 0.3)
"""Standard deviation of each channel before it is known: rad, rad, m, m/s ..."""

PRIOR_TIME = 3.0
"""... which counts as so many seconds of data."""

HEEL_TIME, HEEL_MEMORY = 2.0, 300.0
"""Heel and trim are compared with means of this time, over this time, s."""

HEEL, HEEL_SD = (-0.2, 0.0), (0.3, 0.1)
"""Roll and pitch for an acceleration of 1 g to starboard and forward, before any data, rad."""

HEEL_NOISE = 0.02
"""What else lets a mean angle wander, rad ..."""

HEEL_SAMPLE = 5.0
"""... for so long, s."""

ERRORS = 64
"""Forecasts whose errors are kept for the probability of a quiet deck, the newest ..."""

ERROR_PERIOD = 1.6
"""... and the time between them, s."""

QUIET_SPANS = (2.0, 3.0, 5.0)
"""Times for which the deck may stay quiet, s."""

N_QUIET = int(np.searchsorted(HORIZONS, QUIET_SPANS[-1])) + 1
"""Horizons within them."""

ERROR_TIMES = (10.0, 10.0, MEMORY_OF_HEAVE, 1.0)
"""How long an error of the estimate of each channel lasts, s."""

STAYS = np.exp(-HORIZONS / np.array(ERROR_TIMES)[:, None]).ravel()
"""Share of such an error that is left at each horizon."""

QUIET_CHANNELS = (ROLL, PITCH, DECK_SPEED)

_STEPS = round(LAST / (TICK * BASE))

FORECAST = np.dtype(
    [
        ("ring", "f8", (RING_ROWS, SIGNALS + 1)),  # signals and deck speed
        ("before", "f8", SIGNALS + 1),  # those of the row before
        ("t_before", "f8"),  # its time, s; NaN before the first
        ("begun", "f8"),  # time of the first row of the ring, s
        ("rows", "f8"),  # rows of the ring so far
        ("gram", "f8", (N_TERMS, N_TERMS)),  # weighted sums of products of 1 and features, upper
        ("cross", "f8", (N_TERMS, TARGETS)),  # ... and of targets
        ("squares", "f8", TARGETS),  # ... and of their squares
        ("weight", "f8"),  # of the next tick; grows, so that older ones count less
        ("weights", "f8", 2),  # sums of the weights and of their squares
        ("fitted", "f8"),  # ticks until the next fit
        ("coefficients", "f8", (N_TERMS, TARGETS)),  # of the fit; first those of 1
        ("means", "f8", TARGETS),  # of the targets at the fit
        ("fit_var", "f8", TARGETS),  # variances of its errors
        ("fit_worth", "f8", TARGETS),  # share of the variance that it explains
        ("is_fit", "f8"),  # 1 once there is a fit
        ("made", "f8", (_STEPS, TARGETS)),  # forecasts of past ticks, deviations from the means
        ("made_at", "f8", (_STEPS, 2)),  # number of their tick, 1 where there was a fit
        ("made_means", "f8", (_STEPS, TARGETS)),
        ("verified", "f8", (3, TARGETS)),  # mean squares: forecast, forecast times truth, truth
        ("verifications", "f8"),  # how many ticks these stand for
        ("errors", "f8", (ERRORS, 3, N_QUIET)),  # of QUIET_CHANNELS
        ("n_errors", "f8"),
        ("noise", "f8", N_CHANNELS),  # variances of the estimates of the channels
        ("moments", "f8", (3, N_CHANNELS)),  # mean, mean square, and seconds of each channel
        ("smooth", "f8", (2, 2)),  # mean angles and mean accelerations / g, of roll and pitch
        ("speed", "f8"),  # forward, of the row before, m/s
        ("heel_sums", "f8", (2, 5)),  # of 1, a, y, a a, a y
        ("heel", "f8", 2),  # roll and pitch for 1 g
    ]
)
"""What is remembered for forecasts. All are float64, so that it fits into flat memory."""

FORECAST_SETTINGS = np.dtype(
    [
        ("base", "f8"),  # s between rows of the ring
        ("lag", "f8"),  # rows between the samples of a forecast
        ("deck", "f8", 3),  # the deck point: m forward, to starboard, down
        ("limits", "f8", 3),  # of QUIET_CHANNELS
        ("at", "f8", N_HORIZONS),  # HORIZONS in rows of the ring
    ]
)

FORECAST_WORK = np.dtype(
    [
        ("features", "f8", N_TERMS),
        ("targets", "f8", TARGETS),
        ("scale", "f8", N_TERMS),
        ("factor", "f8", (N_FEATURES, N_FEATURES)),
        ("right", "f8", (N_FEATURES, TARGETS)),
        ("now", "f8", SIGNALS + 1),
    ]
)
"""Scratch; one serves many boats."""


def initial_forecast() -> Array:
    """Return the memory of a boat before its first row: :data:`FORECAST` as flat float64."""
    memory = np.zeros(record_size(FORECAST))
    record = memory.view(FORECAST)[0]
    record["t_before"] = record["speed"] = np.nan
    record["weight"] = 1.0
    record["heel"] = HEEL
    record["made_at"] = -1.0
    return memory


def forecast_settings(particulars: Particulars) -> Array:
    """Return :data:`FORECAST_SETTINGS` of a boat as flat float64."""
    memory = np.zeros(record_size(FORECAST_SETTINGS))
    record = memory.view(FORECAST_SETTINGS)[0]
    scale = math.sqrt(particulars.length / LAG_LENGTH)
    base = BASE * max(round(scale), 1)
    record["base"], record["lag"] = base, min(max(round(LAG * scale / base), 2), TICK)
    deck = particulars.deck
    record["deck"] = deck.point_of(particulars.length)
    record["limits"] = deck.max_tilt, deck.max_tilt, deck.max_speed
    record["at"] = HORIZONS / base
    return memory


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
    share = min(dt / HEEL_TIME, 1.0)
    for k in range(2):
        a = u * r / GRAVITY if k == 0 else (u - memory.speed) / dt / GRAVITY
        y = attitude.tilt[k, ANGLE]
        memory.smooth[0, k] += share * (y - memory.smooth[0, k])
        memory.smooth[1, k] += share * (a - memory.smooth[1, k])
        y, a, sums = memory.smooth[0, k], memory.smooth[1, k], memory.heel_sums[k]
        fade = math.exp(-dt / HEEL_MEMORY)
        for j in range(5):
            value = 1.0 if j == 0 else a if j == 1 else y if j == 2 else a * a if j == 3 else a * y
            sums[j] = fade * sums[j] + dt * value
        var, n = HEEL_NOISE**2 * HEEL_SAMPLE, sums[0]
        information = (sums[3] - sums[1] * sums[1] / n) / var
        seen = (sums[4] - sums[1] * sums[2] / n) / var
        before = 1.0 / HEEL_SD[k] ** 2
        memory.heel[k] = (HEEL[k] * before + seen) / (before + information)
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
def _write_features(row, lag, memory, out):
    """Write 1 and the signals of the last seconds before a row of the ring."""
    out[0] = 1.0
    at = 1
    for i in range(LAGS):
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
        out[i] += PENALTY
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
    samples = total * total / memory.weights[1]
    used = min(FIT_SHARE * n / samples, 0.75)
    for k in range(TARGETS):
        m = first[k] / total
        whole = max(memory.squares[k] / total - m * m, 1e-12)
        memory.fit_var[k] = min(max(memory.fit_var[k], 0.0) / (1.0 - used), whole)
        memory.fit_worth[k] = 1.0 - memory.fit_var[k] / whole
    memory.is_fit = 1.0


@inlined
def _apply(memory, x, out):
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
    made, means = memory.made[tick % _STEPS], memory.made_means[tick % _STEPS]
    note = memory.made_at[tick % _STEPS]
    if note[0] != tick or note[1] == 0.0:
        return
    memory.verifications += 1.0
    share = max(1.0 / memory.verifications, period / VERIFIED)
    for k in range(TARGETS):
        a, b = made[k], targets[k] - means[k]
        memory.verified[0, k] += share * (a * a - memory.verified[0, k])
        memory.verified[1, k] += share * (a * b - memory.verified[1, k])
        memory.verified[2, k] += share * (b * b - memory.verified[2, k])
    every = max(round(ERROR_PERIOD / period), 1)
    if tick % every == 0:
        errors = memory.errors[int(memory.n_errors) % ERRORS]
        for c in range(3):
            first = QUIET_CHANNELS[c] * N_HORIZONS
            for h in range(N_QUIET):
                k = first + h
                errors[c, h] = targets[k] - means[k] - _skill(memory, k) * made[k]
        memory.n_errors += 1.0


@inlined
def _skill(memory, k):
    """Return the share of a forecast deviation to believe, from the verified ones.

    Forecast and what came after hold the same error of the estimate, which is no skill.
    """
    shared = STAYS[k] * memory.noise[k // N_HORIZONS]
    worth = (memory.verified[1, k] - shared) / max(memory.verified[0, k], 1e-12)
    # until enough are verified, the fit itself counts
    n = memory.verifications
    worth = (n * worth + TRUST_TICKS * memory.fit_worth[k]) / (n + TRUST_TICKS)
    return min(max(worth, 0.0), 1.0)


@inlined
def _variance(memory, k):
    """Return the variance of the errors of a forecast, against the truth."""
    n, s, noise = memory.verifications, _skill(memory, k), memory.noise[k // N_HORIZONS]
    a, c, b = memory.verified[0, k], memory.verified[1, k], memory.verified[2, k]
    seen = max(b - 2.0 * s * c + s * s * a, 0.0)
    var = (n * seen + TRUST_TICKS * memory.fit_var[k]) / (n + TRUST_TICKS)
    # against estimates, whose errors are in both
    return max(var + (2.0 * s * STAYS[k] - 1.0) * noise, 0.5 * noise)


@inlined
def _tick(row, memory, given, work):
    """Learn from the motion that has become known, and note a forecast from now."""
    base, lag = given.base, int(given.lag)
    period, tick = TICK * base, row // TICK
    old = row - round(LAST / base)
    if old - (LAGS - 1) * lag >= 0:
        y = work.targets
        for h in range(N_HORIZONS):
            for c in range(N_CHANNELS):
                j = PLACES[c]
                y[c * N_HORIZONS + h] = _entry(memory, old + given.at[h], j)
        _verify(old // TICK, memory, y, period)
        _write_features(old, lag, memory, work.features)
        _add_products(memory, work.features, y)
        _fade(memory, math.exp(period / MEMORY))
        memory.fitted -= 1.0
        if memory.weights[0] ** 2 / memory.weights[1] * period >= LEARNED and memory.fitted <= 0.0:
            _fit(memory, work)
            memory.fitted = max(round(REFIT / period), 1)
    place = tick % _STEPS
    memory.made_at[place, 0] = tick
    memory.made_at[place, 1] = memory.is_fit
    if memory.is_fit > 0.0:
        _write_features(row, lag, memory, work.features)
        _apply(memory, work.features, memory.made[place])
        for k in range(TARGETS):
            memory.made_means[place, k] = memory.means[k]


@kernel
def take_motion(t, velocity, attitude, memory, given, work):
    """Take the attitude of a row: learn from it, and note what forecasts begin with.

    Parameters
    ----------
    t : float
        Time of the row, s.
    velocity : ndarray, shape (2,)
        Speed forward and to starboard by the twin, m/s; NaN where it has none.
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
        memory.noise[c] = error_now(c, attitude, memory, given)
    base = given.base
    if attitude.rows <= 1.0 or not math.isfinite(memory.t_before):
        # a start or a gap: the past has no link to what comes
        memory.rows, memory.begun = 0.0, t
    else:
        for c in range(N_CHANNELS):
            y, moments = now[PLACES[c]], memory.moments
            moments[2, c] += dt
            share = min(dt / min(moments[2, c], MEMORY), 1.0) if moments[2, c] > 0.0 else 1.0
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
        if row % TICK == 0:
            _tick(row, memory, given, work)
    for j in range(SIGNALS + 1):
        memory.before[j] = now[j]
    memory.t_before = t


@inlined
def error_now(c, attitude, memory, given):
    """Return the variance of the estimate of a channel."""
    if c <= PITCH:
        return attitude.P[c, ANGLE, ANGLE]
    climb = attitude.P_vertical[CLIMB, CLIMB]
    if c == HEAVE_CHANNEL:
        # what the high pass leaves out or adds, beside the filter's own variance
        heave = memory.moments[1, HEAVE_CHANNEL]
        leak = 0.4 if attitude.ages[6] > 2.0 else 0.05
        return attitude.P_vertical[HEAVE, HEAVE] + leak * leak * heave
    a, b = given.deck[0], given.deck[1]
    rate = (a * a + b * b) * attitude.P[0, RATE_BIAS, RATE_BIAS]
    return climb + rate


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
    ready = memory.is_fit > 0.0 and row - (LAGS - 1) * int(given.lag) >= 0
    if ready:
        _write_features(row, int(given.lag), memory, work.features)
        _apply(memory, work.features, work.targets)
    for c in range(N_CHANNELS):
        now = memory.noise[c]
        mean[0, c] = (
            attitude.tilt[c, ANGLE]
            if c <= PITCH
            else attitude.vertical[HEAVE]
            if c == HEAVE_CHANNEL
            else memory.before[7]
        )
        var[0, c] = now
        seconds = memory.moments[2, c]
        m = memory.moments[0, c]
        spread = max(memory.moments[1, c] - m * m, 0.0)
        prior = PRIOR_SD[c] ** 2
        spread = (seconds * spread + PRIOR_TIME * prior) / (seconds + PRIOR_TIME)
        for h in range(N_HORIZONS):
            k = c * N_HORIZONS + h
            if ready:
                mean[1 + h, c] = memory.means[k] + _skill(memory, k) * work.targets[k]
                var[1 + h, c] = _variance(memory, k)
            else:
                mean[1 + h, c] = m
                var[1 + h, c] = spread + now
            if c <= PITCH:
                mean[1 + h, c] += memory.heel[c] * ahead[1 + h, c]


@kernel
def quiet_probabilities(mean, var, memory, given, out):
    """Write the probabilities that the deck stays within its limits for :data:`QUIET_SPANS`.

    The errors of past forecasts are laid on the present one. The share of them with which all
    channels stay within their limits is the probability.

    Parameters
    ----------
    mean, var : ndarray, shape (1 + 21, 4)
        Of :func:`forecast_motion`.
    memory, given
        As for :func:`take_motion`.
    out : ndarray, shape (3,)
        Written.
    """
    count = min(int(memory.n_errors), ERRORS)
    for s in range(len(QUIET_SPANS)):
        last = 0
        while last < N_QUIET and HORIZONS[last] <= QUIET_SPANS[s] + 1e-9:
            last += 1
        quiet = 0.0
        for e in range(count):
            inside = True
            for c in range(3):
                channel, limit = QUIET_CHANNELS[c], given.limits[c]
                inside = inside and abs(mean[0, channel]) < limit
                for h in range(last):
                    inside = inside and abs(mean[1 + h, channel] + memory.errors[e, c, h]) < limit
            quiet += 1.0 if inside else 0.0
        if count > 0:
            out[s] = (quiet + 0.5) / (count + 1.0)
        else:
            out[s] = _independent(mean, var, given, last)


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
