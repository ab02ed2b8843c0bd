"""The prediction of the navigation filter: dead reckoning by IMU or model, and its covariance."""

from __future__ import annotations

import math
from typing import NamedTuple

from twin.channels import PSI, R, U, V, X, Y
from twin.filters.navigation_state import (
    ACCEL_X_BIAS,
    ACCEL_Y_BIAS,
    COMPASS_BIAS,
    GYRO_BIAS,
    N_NAV,
    SPEED_LIMIT,
    TILT_X,
    TILT_Y,
    TURN_LIMIT,
)
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
    u, v, r = n[U], n[V], n[R]
    psi = n[PSI] + 0.5 * h * r_mean
    c, s = math.cos(psi), math.sin(psi)
    if driven:
        ax -= n[ACCEL_X_BIAS] + n[TILT_X]
        ay -= n[ACCEL_Y_BIAS] + n[TILT_Y]
        u_mean = u + 0.5 * h * (ax + v * r_mean)
        v_mean = v + 0.5 * h * (ay - u * r_mean)
        ax += v_mean * r_mean
        ay -= u_mean * r_mean
    else:
        u_mean, v_mean = u + 0.5 * h * ax, v + 0.5 * h * ay
    north, east = u_mean * c - v_mean * s, u_mean * s + v_mean * c
    # first five rows of A P; A = I + h F
    for k in range(N_NAV):
        A[X, k] = P[X, k] + h * (P[U, k] * c - P[V, k] * s - P[PSI, k] * east)
        A[Y, k] = P[Y, k] + h * (P[U, k] * s + P[V, k] * c + P[PSI, k] * north)
        A[PSI, k] = P[PSI, k] + h * P[R, k]
    if driven:
        for k in range(N_NAV):
            A[U, k] = P[U, k] + h * (r * P[V, k] + v * P[R, k] - P[ACCEL_X_BIAS, k] - P[TILT_X, k])
            A[V, k] = P[V, k] - h * (r * P[U, k] + u * P[R, k] + P[ACCEL_Y_BIAS, k] + P[TILT_Y, k])
    else:
        for k in range(N_NAV):
            A[U, k] = P[U, k]
            A[V, k] = P[V, k]
    # their part of (A P) A'; the rest of the columns stays
    for i in range(5):
        for k in range(5, N_NAV):
            P[i, k] = A[i, k]
            P[k, i] = A[i, k]
        P[i, X] = A[i, X] + h * (A[i, U] * c - A[i, V] * s - A[i, PSI] * east)
        P[i, Y] = A[i, Y] + h * (A[i, U] * s + A[i, V] * c + A[i, PSI] * north)
        P[i, PSI] = A[i, PSI] + h * A[i, R]
        if driven:
            P[i, U] = A[i, U] + h * (r * A[i, V] + v * A[i, R] - A[i, ACCEL_X_BIAS] - A[i, TILT_X])
            P[i, V] = A[i, V] - h * (r * A[i, U] + u * A[i, R] + A[i, ACCEL_Y_BIAS] + A[i, TILT_Y])
        else:
            P[i, U] = A[i, U]
            P[i, V] = A[i, V]
    for i in range(5):
        for k in range(i):
            P[i, k] = P[k, i]
    decay = h / settings.bias_time
    P[U, U] += motion.var
    P[V, V] += motion.var
    P[R, R] += motion.r_var
    P[GYRO_BIAS, GYRO_BIAS] += 2.0 * decay * (settings.gyro_bias_var - P[GYRO_BIAS, GYRO_BIAS])
    P[ACCEL_X_BIAS, ACCEL_X_BIAS] += (
        2.0 * decay * (settings.accel_bias_var - P[ACCEL_X_BIAS, ACCEL_X_BIAS])
    )
    P[ACCEL_Y_BIAS, ACCEL_Y_BIAS] += (
        2.0 * decay * (settings.accel_bias_var - P[ACCEL_Y_BIAS, ACCEL_Y_BIAS])
    )
    P[COMPASS_BIAS, COMPASS_BIAS] += (
        2.0 * decay * (settings.compass_bias_var - P[COMPASS_BIAS, COMPASS_BIAS])
    )
    stay = math.exp(-h / settings.tilt_time)
    for i in range(10, N_NAV):
        for k in range(N_NAV):
            P[i, k] *= stay
            P[k, i] *= stay
        P[i, i] += (1.0 - stay * stay) * settings.tilt_var
        n[i] *= stay
    _cap(P, settings)
    n[X] += h * north
    n[Y] += h * east
    n[PSI] += h * r_mean
    n[U] += h * ax
    n[V] += h * ay
    n[R] += h * r_rate
    for i in range(6, 10):
        n[i] *= 1.0 - decay
    fastest = SPEED_LIMIT * math.sqrt(settings.velocity_var_0)
    n[U] = min(max(n[U], -fastest), fastest)
    n[V] = min(max(n[V], -fastest), fastest)
    n[R] = min(max(n[R], -TURN_LIMIT), TURN_LIMIT)
    # the same step without the corrections that were made so far
    c, s = math.cos(psi - corrected[0]), math.sin(psi - corrected[0])
    path[0] += h * ((u_mean - corrected[1]) * c - (v_mean - corrected[2]) * s)
    path[1] += h * ((u_mean - corrected[1]) * s + (v_mean - corrected[2]) * c)
    path[2] += h * c
    path[3] += h * s
