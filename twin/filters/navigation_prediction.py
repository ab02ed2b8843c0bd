"""The prediction of the navigation filter: dead reckoning by IMU or model, and its covariance."""

from __future__ import annotations

import math
from typing import NamedTuple

from twin.filters.navigation_state import N_NAV, SPEED_LIMIT, TURN_LIMIT
from usv_kernel.jit import kernel

__all__ = [
    "Motion",
    "mend",
    "predict",
]


@kernel
def _cap(P, settings):
    """Keep variances below what can be; one that is cut also loses its correlations."""
    speed, turn = settings.velocity_var_0, settings.r_var_0
    for i in range(6):
        top = 1e8 * speed / turn  # ten thousand lengths
        if i == 2:
            top = 40.0
        elif i == 5:
            top = 100.0 * turn
        elif i > 2:
            top = 100.0 * speed
        if not P[i, i] <= top:
            for k in range(N_NAV):
                P[i, k] = 0.0
                P[k, i] = 0.0
            P[i, i] = top


@kernel
def mend(P, root):
    """Drop the correlations of a covariance that rounding has left without Cholesky factor."""
    for i in range(N_NAV):
        for j in range(i + 1):
            rest = P[i, j]
            for k in range(j):
                rest -= root[i, k] * root[j, k]
            if j < i:
                root[i, j] = rest / root[j, j]
            elif rest > 1e-11 * P[i, i]:
                root[i, i] = math.sqrt(rest)
            else:
                for a in range(N_NAV):
                    for b in range(a):
                        P[a, b] = 0.0
                        P[b, a] = 0.0
                return


class Motion(NamedTuple):
    """What drives a step of the prediction."""

    h: float  # s
    ax: float  # specific force or acceleration forward and to starboard, m/s2
    ay: float
    var: float  # what it adds to the variances of u and v
    is_force: bool  # whether ax and ay are specific forces
    r_mean: float  # yaw rate in the middle of the step, rad/s
    r_rate: float  # its growth where it will not be measured, rad/s2
    r_var: float  # what is added to its variance


@kernel
def predict(nav, settings, motion, A):
    """Advance mean and covariance by a step."""
    n, P, path, corrected = nav.n, nav.P, nav.path, nav.corrected
    h, ax, ay, driven = motion.h, motion.ax, motion.ay, motion.is_force
    r_mean, r_rate = motion.r_mean, motion.r_rate
    u, v, r = n[3], n[4], n[5]
    psi = n[2] + 0.5 * h * r_mean
    c, s = math.cos(psi), math.sin(psi)
    if driven:
        ax -= n[7] + n[10]
        ay -= n[8] + n[11]
        u_mean = u + 0.5 * h * (ax + v * r_mean)
        v_mean = v + 0.5 * h * (ay - u * r_mean)
        ax += v_mean * r_mean
        ay -= u_mean * r_mean
    else:
        u_mean, v_mean = u + 0.5 * h * ax, v + 0.5 * h * ay
    north, east = u_mean * c - v_mean * s, u_mean * s + v_mean * c
    # first five rows of A P; A = I + h F
    for k in range(N_NAV):
        A[0, k] = P[0, k] + h * (P[3, k] * c - P[4, k] * s - P[2, k] * east)
        A[1, k] = P[1, k] + h * (P[3, k] * s + P[4, k] * c + P[2, k] * north)
        A[2, k] = P[2, k] + h * P[5, k]
    if driven:
        for k in range(N_NAV):
            A[3, k] = P[3, k] + h * (r * P[4, k] + v * P[5, k] - P[7, k] - P[10, k])
            A[4, k] = P[4, k] - h * (r * P[3, k] + u * P[5, k] + P[8, k] + P[11, k])
    else:
        for k in range(N_NAV):
            A[3, k] = P[3, k]
            A[4, k] = P[4, k]
    # their part of (A P) A'; the rest of the columns stays
    for i in range(5):
        for k in range(5, N_NAV):
            P[i, k] = A[i, k]
            P[k, i] = A[i, k]
        P[i, 0] = A[i, 0] + h * (A[i, 3] * c - A[i, 4] * s - A[i, 2] * east)
        P[i, 1] = A[i, 1] + h * (A[i, 3] * s + A[i, 4] * c + A[i, 2] * north)
        P[i, 2] = A[i, 2] + h * A[i, 5]
        if driven:
            P[i, 3] = A[i, 3] + h * (r * A[i, 4] + v * A[i, 5] - A[i, 7] - A[i, 10])
            P[i, 4] = A[i, 4] - h * (r * A[i, 3] + u * A[i, 5] + A[i, 8] + A[i, 11])
        else:
            P[i, 3] = A[i, 3]
            P[i, 4] = A[i, 4]
    for i in range(5):
        for k in range(i):
            P[i, k] = P[k, i]
    decay = h / settings.bias_time
    P[3, 3] += motion.var
    P[4, 4] += motion.var
    P[5, 5] += motion.r_var
    P[6, 6] += 2.0 * decay * (settings.gyro_bias_var - P[6, 6])
    P[7, 7] += 2.0 * decay * (settings.accel_bias_var - P[7, 7])
    P[8, 8] += 2.0 * decay * (settings.accel_bias_var - P[8, 8])
    P[9, 9] += 2.0 * decay * (settings.compass_bias_var - P[9, 9])
    stay = math.exp(-h / settings.tilt_time)
    for i in range(10, N_NAV):
        for k in range(N_NAV):
            P[i, k] *= stay
            P[k, i] *= stay
        P[i, i] += (1.0 - stay * stay) * settings.tilt_var
        n[i] *= stay
    _cap(P, settings)
    n[0] += h * north
    n[1] += h * east
    n[2] += h * r_mean
    n[3] += h * ax
    n[4] += h * ay
    n[5] += h * r_rate
    for i in range(6, 10):
        n[i] *= 1.0 - decay
    fastest = SPEED_LIMIT * math.sqrt(settings.velocity_var_0)
    n[3] = min(max(n[3], -fastest), fastest)
    n[4] = min(max(n[4], -fastest), fastest)
    n[5] = min(max(n[5], -TURN_LIMIT), TURN_LIMIT)
    # the same step without the corrections that were made so far
    c, s = math.cos(psi - corrected[0]), math.sin(psi - corrected[0])
    path[0] += h * ((u_mean - corrected[1]) * c - (v_mean - corrected[2]) * s)
    path[1] += h * ((u_mean - corrected[1]) * s + (v_mean - corrected[2]) * c)
    path[2] += h * c
    path[3] += h * s
