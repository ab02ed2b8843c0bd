"""Scalar functions for kernels: fused multiply-add, sine and cosine, angles, actuator lag."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

from usv_kernel.jit import inlined, kernel

__all__ = [
    "actuate",
    "fma",
    "rotation",
    "sincos",
    "wrap",
]


@intrinsic
def fma(typing_context, a, b, c):
    """Return a * b + c with one rounding, in one instruction; for kernels only.

    An explicit instruction rounds in the same way with every compiler.
    """

    def generate(context, builder, signature, arguments):
        return builder.fma(*arguments)

    return types.float64(types.float64, types.float64, types.float64), generate


@intrinsic
def _bits(typing_context, x):
    """Return the bits of a float64 as a whole number."""

    def generate(context, builder, signature, arguments):
        return builder.bitcast(arguments[0], ir.IntType(64))

    return types.int64(types.float64), generate


@intrinsic
def _flipped(typing_context, x, number):
    """Return x, or -x where the last bit but one of a whole number is set."""

    def generate(context, builder, signature, arguments):
        whole = ir.IntType(64)
        sign = builder.shl(builder.and_(arguments[1], whole(2)), whole(62))
        bits = builder.xor(builder.bitcast(arguments[0], whole), sign)
        return builder.bitcast(bits, ir.DoubleType())

    return types.float64(types.float64, types.int64), generate


# pi/2 as 33 bits and a rest: their products with an integer are exact (Cody-Waite)
_TWO_OVER_PI = 6.36619772367581382433e-01

_PIO2_HIGH = 1.57079632673412561417e00

_PIO2_LOW = 6.07710050650619224932e-11

# adding and subtracting 1.5 * 2^52 rounds to an integer, and vectorises, unlike floor()
_ROUND = 6755399441055744.0


@inlined
def sincos(x: float) -> tuple[float, float]:
    """Return sine and cosine to 2e-15 without branches, so that loops vectorise.

    For |x| below 1e6, where the argument reduction is exact.
    """
    turned = fma(x, _TWO_OVER_PI, _ROUND)
    n = turned - _ROUND
    r = fma(-n, _PIO2_LOW, fma(-n, _PIO2_HIGH, x))
    z = r * r
    s = fma(z, -7.64716373181981647590e-13, 1.60590438368216145994e-10)
    s = fma(z, fma(z, s, -2.50521083854417187751e-08), 2.75573192239858906526e-06)
    s = fma(z, fma(z, s, -1.98412698412698412698e-04), 8.33333333333333333333e-03)
    s = fma(r * z, fma(z, s, -1.66666666666666666667e-01), r)
    c = fma(z, -1.14707455977297247139e-11, 2.08767569878680989792e-09)
    c = fma(z, fma(z, c, -2.75573192239858906526e-07), 2.48015873015873015873e-05)
    c = fma(z, fma(z, c, -1.38888888888888888889e-03), 4.16666666666666666667e-02)
    c = fma(z, fma(z, c, -0.5), 1.0)
    # the last two bits of a rounded number are those of the integer: the quadrant
    quadrant = _bits(turned)
    odd = quadrant & 1 != 0
    sine, cosine = (c if odd else s), (s if odd else c)
    return _flipped(sine, quadrant), _flipped(cosine, quadrant + 1)


@inlined
def wrap(angle: float) -> float:
    """Return the angle in [-pi, pi)."""
    return angle - 2.0 * math.pi * math.floor(angle / (2.0 * math.pi) + 0.5)


@kernel
def actuate(value: float, target: float, lag: float, rate: float) -> float:
    """Return the rate of change (units per s) of a first-order actuator with a rate limit.

    ``lag`` is the time constant, s, above 0; ``rate`` the largest rate, units per s.
    It replaces Eq (11) and (27) of Qu et al. 2025, which can only move away from zero.
    """
    return min(max((target - value) / lag, -rate), rate)


def rotation(angles: Sequence[float]) -> np.ndarray:
    """Return the matrix (3, 3) that turns a vector from axes at roll, pitch and yaw (rad) back.

    Source: Fossen 2021, Eq 2.31: R_z(yaw) R_y(pitch) R_x(roll).
    """
    (s1, s2, s3), (c1, c2, c3) = np.sin(angles), np.cos(angles)
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, c1, -s1], [0.0, s1, c1]])
    about_y = np.array([[c2, 0.0, s2], [0.0, 1.0, 0.0], [-s2, 0.0, c2]])
    about_z = np.array([[c3, -s3, 0.0], [s3, c3, 0.0], [0.0, 0.0, 1.0]])
    return about_z @ about_y @ about_x
