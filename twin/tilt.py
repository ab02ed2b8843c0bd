"""Velocity and turning of a heeled boat in its own axes; the twin's state is in upright ones."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["body_velocity", "body_yaw_rate"]

Array = NDArray[np.float64]

COS_ROLL_MIN = 0.1
"""Least cosine of the roll: a boat on its side turns its heading by pitching alone."""


def body_velocity(upright: ArrayLike, tilt: ArrayLike) -> Array:
    """Return velocities in the axes of the boat, shape (..., 3), m/s.

    Parameters
    ----------
    upright : array_like, shape (..., 3)
        Velocities forward, to starboard and down of an upright boat of the same heading, m/s.
    tilt : array_like, shape (..., 2)
        Roll and pitch, rad.

    Notes
    -----
    Source: Fossen 2021, Handbook of Marine Craft Hydrodynamics and Motion Control, equation 2.31.
    """
    ahead, side, down = np.moveaxis(np.asarray(upright, dtype=np.float64), -1, 0)
    roll, pitch = np.moveaxis(np.asarray(tilt, dtype=np.float64), -1, 0)
    low = np.sin(pitch) * ahead + np.cos(pitch) * down
    return np.stack(
        [
            np.cos(pitch) * ahead - np.sin(pitch) * down,
            np.cos(roll) * side + np.sin(roll) * low,
            np.cos(roll) * low - np.sin(roll) * side,
        ],
        axis=-1,
    )


def body_yaw_rate(turn: ArrayLike, tilt: ArrayLike, pitch_rate: ArrayLike) -> Array:
    """Return the rates about the axis down of the boat, shape (...), rad/s.

    Parameters
    ----------
    turn : array_like, shape (...)
        Rates of the heading, rad/s.
    tilt : array_like, shape (..., 2)
        Roll and pitch, rad.
    pitch_rate : array_like, shape (...)
        Rates about the axis to starboard of the boat, rad/s.
    """
    roll, pitch = np.moveaxis(np.asarray(tilt, dtype=np.float64), -1, 0)
    turn, pitch_rate = np.asarray(turn, dtype=np.float64), np.asarray(pitch_rate, dtype=np.float64)
    upright = np.abs(np.cos(roll)) >= COS_ROLL_MIN
    share = np.where(upright, np.cos(roll), 1.0)
    found = (turn * np.cos(pitch) - pitch_rate * np.sin(roll)) / share
    return np.asarray(np.where(upright, found, turn))
