"""How parameters change when a thruster gives another share of its thrust.

A boat whose left thruster gives the share e of its thrust moves as one with other parameters and
both thrusters sound. In most terms that is exact: of the mean and the difference of two thrusts,
each becomes a part of the other. The rest is the nearest in the sense of least squares, over the
speeds, turns and commands that are common.
"""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.model.structure import (
    ADVANCE_COS,
    ASTERN_RACE,
    FIN_SIDE,
    FULL,
    LEFT_COS,
    LENGTH,
    N_STATES,
    N_TERMS,
    ModelTerms,
    nominal_speed,
    state_terms,
    thrust_terms,
)

__all__ = ["SIDES", "share_slopes"]

SIDES = 2
"""Left and right."""

_BY_THRUST = (*range(ADVANCE_COS, FIN_SIDE + 1), *range(LEFT_COS, ASTERN_RACE + 1))

_SPEEDS = (0.4, 0.8, 1.2)
_DRIFTS = (-0.1, 0.0, 0.1)
_TURNS = (-0.2, 0.0, 0.2)
_SHAFTS = (0.4, 0.8, 1.2)
_ANGLES = (-0.4, 0.0, 0.4)
"""Motions in nominal units, and drive angles, rad."""

_LESS = 0.5
"""Share of the thrust that is taken away to find the slopes: they are meant for large changes."""


def share_slopes(model: ModelTerms) -> NDArray[Any]:
    """Return how the parameters change with the shares of thrust.

    Returns
    -------
    ndarray, shape (2, p, p)
        For the left and right side a matrix: times the parameters it is their slope by the share
        of the thrust that this side gives.
    """
    hull, p = model.hull, model.which.shape[1]
    speed = nominal_speed(hull)
    # shaft speeds are in nominal speeds where all terms are in use
    unit = speed if hull[FULL] > 0.0 else 1.0
    motions = list(itertools.product(_SPEEDS, _DRIFTS, _TURNS, _SHAFTS, _SHAFTS, _ANGLES))
    terms = np.zeros((1 + SIDES, len(motions), N_TERMS))
    still = np.zeros(2)
    for k, (u, v, r, left, right, angle) in enumerate(motions):
        c, s = math.cos(angle), math.sin(angle)
        motion = u * speed, v * speed, r * speed / hull[LENGTH]
        less = math.sqrt(1.0 - _LESS)
        for row, a, b in zip(terms[:, k], (1.0, less, 1.0), (1.0, 1.0, less), strict=True):
            thrust_terms(a * unit * left, b * unit * right, c, s, c, s, row)
            state_terms(*motion, 1.0, 0.0, still, hull, row)
    slopes = np.zeros((SIDES, p, p))
    for i in range(3):
        low, high = model.limits[3 + i] - N_STATES
        own = low + np.flatnonzero(np.isin(model.which[i, low:high], _BY_THRUST))
        which = model.which[i, own].astype(int)
        whole = terms[0][:, which]
        size = np.abs(whole).max(axis=0, initial=1e-12)
        for side in range(SIDES):
            lost = (whole - terms[1 + side][:, which]) / _LESS
            found = np.linalg.lstsq(whole / size, lost, rcond=1e-6)[0] / size[:, None]
            slopes[side][np.ix_(own, own)] = found
    return slopes
