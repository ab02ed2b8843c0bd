"""Steps of the two small Kalman filters of roll, pitch and heave.

They work in place, on states (n,) and covariances (n, n).

Source: Sarkka and Svensson 2023, Sec. 6.3 (Kalman filter).
"""

from __future__ import annotations

import math

from twin.motion.state import ANGLE, N_TILT, RATE_BIAS
from usv_kernel.arrays import alloca_f64
from usv_kernel.jit import inlined
from usv_kernel.scalar import sincos

__all__ = ["correct", "fade", "propagate", "turn_covariance"]

STATES_MAX = 8
"""Largest number of states."""


@inlined
def correct(x, P, seen, error, var, gate):
    """Correct a state by one number that measures one or two of its entries; return if it is used.

    ``seen`` holds their places, the same twice for one.
    """
    n, i, j = x.shape[0], seen[0], seen[1]
    both, PH = 1.0 if i != j else 0.0, alloca_f64(STATES_MAX)
    for k in range(n):
        PH[k] = P[k, i] + both * P[k, j]
    total = var + PH[i] + both * PH[j]
    if error * error > gate * gate * total:
        return False
    for k in range(n):
        gain = PH[k] / total
        x[k] += gain * error
        for m in range(n):
            P[k, m] -= gain * PH[m]
    return True


@inlined
def propagate(P, F):
    """Write F P F' to P (4, 4), for F that is the identity but for its first two rows.

    ``F`` holds three numbers: of P[0, 1], of P[0, 2] and of P[1, 2].
    """
    a, b, c = F
    for j in range(P.shape[0]):
        P[0, j] += a * P[1, j] + b * P[2, j]
        P[1, j] += c * P[2, j]
    for i in range(P.shape[0]):
        P[i, 0] += a * P[i, 1] + b * P[i, 2]
        P[i, 1] += c * P[i, 2]


@inlined
def turn_covariance(P, dt, turned):
    """Propagate the covariance of both tilts over a step in which the boat turns by an angle.

    An error of roll becomes one of pitch, while the errors of the sensors turn with the boat.
    """
    i, k = ANGLE, N_TILT + ANGLE
    s, c = sincos(turned)
    for j in range(P.shape[0]):
        roll, pitch = P[i, j], P[k, j]
        P[i, j] = c * roll + s * pitch - dt * P[i + RATE_BIAS, j]
        P[k, j] = c * pitch - s * roll - dt * P[k + RATE_BIAS, j]
    for j in range(P.shape[0]):
        roll, pitch = P[j, i], P[j, k]
        P[j, i] = c * roll + s * pitch - dt * P[j, i + RATE_BIAS]
        P[j, k] = c * pitch - s * roll - dt * P[j, k + RATE_BIAS]


@inlined
def fade(x, P, i, time, dt, sd):
    """Let a first-order Gauss-Markov state fade, and grow its variance."""
    stay = math.exp(-dt / time)
    x[i] *= stay
    for j in range(x.shape[0]):
        P[i, j] *= stay
        P[j, i] *= stay
    P[i, i] += (1.0 - stay * stay) * sd * sd
