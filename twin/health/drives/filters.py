"""Kernels of the filters that hold commands against the motion: one for each hypothesis.

In a step of about a second, yaw rate and surge change by

    dr = a1 r + a2 r |r| + a3 M + a4 D + a5 u v + a6
    du = b1 u + b2 u |u| + b3 T + b4 r^2 + b5 v r

with the thrust T that a hypothesis says the commands made, the moment M of its steering part and
the difference D of the sides. All are in nominal units. Each filter is an extended Kalman filter of
yaw rate or surge and the six parameters. Waves are its measurement noise, whose level is learned.
The likelihood of its innovations says how well a hypothesis explains the motion.
"""

from __future__ import annotations

import math

import numpy as np

from twin.health.state import ABSENT, COMMAND_TERMS, FILTER_STATES, GPS, HYPOTHESES
from usv_kernel.jit import inlined, kernel

__all__ = [
    "AS_GIVEN",
    "DIFFERENCE",
    "HELD",
    "LEFT_DEAD",
    "MOMENT",
    "MOTION_MAX",
    "RIGHT_DEAD",
    "SIDES_SWAPPED",
    "SURGE",
    "WARM_UP",
    "YAW",
    "begin_filters",
    "copy_filter",
    "is_surge_unknown",
    "log_likelihood",
    "restart_motion",
    "step_filter",
    "surge_change",
    "thrust_of",
    "write_effects",
]

YAW, SURGE = range(2)

EFFECTS = np.array(
    [
        # thrust of left, right; steering of left, right; difference of thrust of left, right
        [[1.0, 1.0], [1.0, 1.0], [1.0, -1.0]],  # as given
        [[-1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0]],  # all reversed
        [[1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]],  # steering reversed
        [[-1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]],  # thrust reversed
        [[1.0, 1.0], [1.0, 1.0], [-1.0, 1.0]],  # sides swapped
        [[0.0, 1.0], [0.0, 1.0], [0.0, -1.0]],  # left thruster dead
        [[1.0, 0.0], [1.0, 0.0], [1.0, 0.0]],  # right thruster dead
        [[1.0, 1.0], [1.0, 1.0], [1.0, -1.0]],  # at rest, but the boat gets others
    ]
)
"""What may be wrong with commands: factors of the sides in what a boat makes of them."""

AS_GIVEN, SIDES_SWAPPED, LEFT_DEAD, RIGHT_DEAD, HELD = 0, 4, 5, 6, 7

THRUST, MOMENT, DIFFERENCE, DRIFT = 3, 3, 4, 5
"""Places of effects in a filter's state: thrust of surge, the others of yaw."""

LEFT_THRUST, LEFT_MOMENT = 0, 2
"""Places in the drive of what the left side makes; that of the right side follows."""

WARM_UP = 35.0
"""Steps before anything is concluded."""

SCALE, SCALE_SD = 0.4, 0.6
"""Expected acceleration by nominal thrust, and its standard deviation, in nominal speeds squared
over a length: catamarans reach their speed in a length, planing boats in three."""

PART_SD = 0.3
"""Standard deviation of shares: of the linear part of the drag, half of it expected, and of the
drag at nominal speed in the nominal thrust."""

LEVER_SD = 3.0
"""Standard deviation of the yaw acceleration by a difference of thrust, in those expected: the
sides sit about as far apart as a boat's radius of gyration times its length to beam ratio."""

DAMPING, DAMPING_SD, STEERING_SD, DRIFT_SD, CONSTANT_SD = -0.3, 0.5, 1.0, 0.4, 0.02
"""Priors of yaw: linear damping, and standard deviations of damping, steering, drift, constant."""

TURN_SD, CORIOLIS, CORIOLIS_SD = 1.0, 1.3, 0.4
"""Priors of surge: drag of a turn, and the centripetal acceleration of a drifting boat, which
exceeds its mass's by the added mass."""

START_SD = 0.05
"""Standard deviation of the motion at the start."""

WALKS = np.array([[0.3, 0.3, 0.6, 0.07, 0.3, 0.03], [0.035, 0.115, 0.115, 0.35, 0.17, 0.0]])
WALK = 0.013
"""By this share of what a parameter typically is, it wanders in a step."""

MODEL_SHARE = 0.53
"""Standard deviation of what the model leaves out in a step, in levels of the waves."""

BRAKE, BRAKE_SD = 0.2, 0.3
"""Drag of stopped propellers at nominal speed, and the standard deviation of it and of the hull's
drag at untried speeds, in nominal thrusts."""

UNKNOWN_THRUST, UNKNOWN_STEERING = 0.3, 0.4
"""Standard deviations of thrust and steering about those of before, in nominal thrusts, where
shafts are said to be at rest and are not."""

UNKNOWN_SWAY = 0.2
"""Standard deviation of the sway without GPS, in nominal speeds; it is taken for zero."""

SCALE_KNOWN, SCALE_MIN = 0.2, 0.03
"""Once learned, the acceleration by thrust is known to this share of it, or of the least of any
boat: at a constant speed thrust and drag could else both fade, and explain anything."""

ROBUST = 9.4
"""Squared innovations above so many variances count less: a single wave says little."""

FREEDOM = 10.5
"""Degrees of freedom of Student's distribution of the innovations: waves come in groups."""

DECAY_MAX = 1.05
"""A motion without force grows by no more in a step: beyond, the parameters are not yet known."""

MOTION_MAX = 3.0
"""No boat turns or moves faster, in nominal units."""

VARIANCE_MIN = 1e-12


@inlined
def _effect(kind, k, drive):
    """Return what a hypothesis makes of the drive: thrust, steering moment or difference."""
    first = LEFT_MOMENT if kind == 1 else LEFT_THRUST
    return EFFECTS[k, kind, 0] * drive[first] + EFFECTS[k, kind, 1] * drive[first + 1]


@inlined
def is_surge_unknown(health):
    """Return whether there is no GPS: the yaw rate alone then says what the commands do."""
    return health.sensors[GPS].status == ABSENT and health.sensors[GPS].interval > 0.0


@inlined
def thrust_of(drive):
    """Return the thrust of a drive, in nominal ones."""
    return drive[LEFT_THRUST] + drive[LEFT_THRUST + 1]


@inlined
def _surge_terms(u, v, r, thrust):
    """Return what the parameters of surge multiply."""
    return u, u * abs(u), thrust, r * r, v * r


@inlined
def surge_change(u, v, r, health):
    """Return by how much surge changes in a step, by the hypothesis in force; nominal units."""
    force = int(health.hypothesis)
    x, change = health.filters[force].x[SURGE], 0.0
    terms = _surge_terms(u, v, r, _effect(0, force, health.drive))
    for i in range(len(terms)):
        change += x[1 + i] * terms[i]
    return change


@inlined
def write_effects(health):
    """Write thrust, steering moment and difference of thrust of the last step by hypothesis."""
    for k in range(HYPOTHESES):
        drive = health.held_drive if k == HELD and health.at_rest > 0.0 else health.mean_drive
        for kind in range(3):
            health.effects[k, kind] = _effect(kind, k, drive)


@kernel
def begin_filters(health, length):
    """Set all filters to what is expected of any boat, in a step of so many lengths."""
    scale, spread = SCALE * length, SCALE_SD * length
    for k in range(HYPOTHESES):
        for axis in range(2):
            x, P = health.filters[k].x[axis], health.filters[k].P[axis]
            for i in range(FILTER_STATES):
                x[i] = 0.0
                for j in range(FILTER_STATES):
                    P[i, j] = 0.0
            P[0, 0] = START_SD**2
        x, P = health.filters[k].x[YAW], health.filters[k].P[YAW]
        x[1], x[DIFFERENCE] = DAMPING * length, scale
        P[1, 1] = P[2, 2] = (DAMPING_SD * length) ** 2
        P[MOMENT, MOMENT] = (STEERING_SD * length) ** 2
        P[DIFFERENCE, DIFFERENCE] = (LEVER_SD * scale) ** 2
        P[5, 5], P[6, 6] = (DRIFT_SD * length) ** 2, (CONSTANT_SD * length) ** 2
        x, P = health.filters[k].x[SURGE], health.filters[k].P[SURGE]
        # at the nominal speed thrust and drag are equal, however large
        x[1] = x[2] = -0.5 * scale
        x[THRUST], x[5] = scale, CORIOLIS * length
        P[1, 1] = P[2, 2] = 0.25 * spread**2 + (PART_SD * scale) ** 2
        P[1, 2] = P[2, 1] = 0.25 * spread**2 - (PART_SD * scale) ** 2
        P[1, THRUST] = P[THRUST, 1] = P[2, THRUST] = P[THRUST, 2] = -0.5 * spread**2
        P[THRUST, THRUST] = spread**2 + (PART_SD * scale) ** 2
        P[4, 4], P[5, 5] = (TURN_SD * length) ** 2, (CORIOLIS_SD * length) ** 2


@inlined
def copy_filter(health, k, source):
    """Give a hypothesis the filter of another: up to now they say the same."""
    to, of = health.filters[k], health.filters[source]
    for axis in range(2):
        for i in range(FILTER_STATES):
            to.x[axis, i] = of.x[axis, i]
            for j in range(FILTER_STATES):
                to.P[axis, i, j] = of.P[axis, i, j]


@kernel
def restart_motion(first, health):
    """Begin again from the present motion, after a gap: yaw rate and surge, or surge alone."""
    for k in range(HYPOTHESES):
        for axis in range(first, 2):
            x, P = health.filters[k].x[axis], health.filters[k].P[axis]
            x[0] = health.motion[axis]
            for j in range(FILTER_STATES):
                P[0, j] = P[j, 0] = 0.0
            P[0, 0] = 2.0 * health.wave_level[axis] ** 2 + START_SD**2


@inlined
def _write_regressors(axis, k, r, u, v, health):
    """Write what the parameters of an axis multiply."""
    f, effects = health.regressors, health.effects
    if axis == YAW:
        f[0], f[1], f[2], f[3] = r, r * abs(r), effects[k, 1], effects[k, 2]
        f[4], f[5] = u * v, 1.0
    else:
        f[0], f[1], f[2], f[3], f[4] = _surge_terms(u, v, r, effects[k, 0])
        f[5] = 0.0


@inlined
def _bound_scale(x, P, length, gain):
    """Make the acceleration by thrust known to a share of it, as by a measurement that agrees."""
    most = (SCALE_KNOWN * max(abs(x[THRUST]), SCALE_MIN * length)) ** 2
    variance = P[THRUST, THRUST]
    if variance > most:
        for i in range(FILTER_STATES):
            gain[i] = P[i, THRUST]
        share = (1.0 - most / variance) / variance
        for i in range(FILTER_STATES):
            for j in range(FILTER_STATES):
                P[i, j] -= share * gain[i] * gain[j]


@kernel
def step_filter(axis, k, motion, length, learn, health):
    """Advance the filter of a hypothesis by a step.

    Parameters
    ----------
    axis, k : int
        0 for yaw, 1 for surge; the hypothesis.
    motion : tuple of float
        Its yaw rate and surge before the step, in nominal units.
    length : float
        Length of the step, in lengths over nominal speed.
    learn : bool
        Whether the parameters are corrected too, or only the motion.
    health : record
        ``HEALTH``: the filter is advanced in place.

    Returns
    -------
    innovation, variance : float
        Of the motion measured, in nominal units.
    """
    x, P = health.filters[k].x[axis], health.filters[k].P[axis]
    f, gain = health.regressors, health.gain
    r, u = motion
    learned = health.steps > WARM_UP
    _write_regressors(axis, k, r, u, health.mean_sway, health)
    change = 0.0
    for i in range(COMMAND_TERMS):
        change += f[i] * x[1 + i]
    decay = 1.0 + x[1] + 2.0 * x[2] * abs(r if axis == YAW else u)
    stopped = axis == SURGE and health.at_rest > 0.0 and k != HELD
    if stopped:
        # a boat that coasts teaches nothing of its thrust
        change -= BRAKE * x[THRUST] * u * abs(u)
        decay -= 2.0 * BRAKE * x[THRUST] * abs(u)
    decay = min(max(decay, 0.0), DECAY_MAX)
    x[0] += change
    level = health.wave_level[axis]
    variance = decay * decay * P[0, 0] + (MODEL_SHARE * level) ** 2
    if stopped:
        variance += (BRAKE_SD * x[THRUST] * abs(u)) ** 2
    if axis == YAW and is_surge_unknown(health):
        variance += (UNKNOWN_SWAY * x[DRIFT] * u) ** 2
    if k == HELD and health.at_rest > 0.0:
        if axis == YAW:
            variance += UNKNOWN_STEERING**2 * (x[MOMENT] ** 2 + x[DIFFERENCE] ** 2)
        else:
            variance += (UNKNOWN_THRUST * x[THRUST]) ** 2
    for j in range(1, FILTER_STATES):
        gain[j] = 0.0
        for i in range(COMMAND_TERMS):
            gain[j] += f[i] * P[1 + i, j]
    for i in range(COMMAND_TERMS):
        variance += 2.0 * decay * f[i] * P[1 + i, 0] + f[i] * gain[1 + i]
    P[0, 0] = max(variance, VARIANCE_MIN)
    for j in range(1, FILTER_STATES):
        P[0, j] = decay * P[0, j] + gain[j]
        P[j, 0] = P[0, j]
        P[j, j] += (WALK * length * WALKS[axis, j - 1]) ** 2
    innovation, S = health.motion[axis] - x[0], P[0, 0] + level * level
    weighted = max(S, innovation * innovation / ROBUST)
    for i in range(FILTER_STATES):
        gain[i] = P[i, 0]
    for i in range(FILTER_STATES):
        if learn or i == 0:
            x[i] += gain[i] * innovation / weighted
        for j in range(FILTER_STATES):
            if learn or i == 0 or j == 0:
                P[i, j] -= gain[i] * gain[j] / weighted
        P[i, i] = max(P[i, i], VARIANCE_MIN)
    x[0] = min(max(x[0], -MOTION_MAX), MOTION_MAX)
    if axis == SURGE and learned:
        _bound_scale(x, P, length, gain)
    return innovation, S


@inlined
def log_likelihood(innovation, S):
    """Return the logarithm of Student's density of an innovation, less a constant."""
    square = innovation * innovation / S
    return -0.5 * math.log(S) - 0.5 * (FREEDOM + 1.0) * math.log(1.0 + square / FREEDOM)
