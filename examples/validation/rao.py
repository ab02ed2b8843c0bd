"""Response amplitudes in regular waves.

They come from a simulation in six degrees of freedom, in a wave so low that the response is linear.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from usv_gym.physics import GRAVITY, ship
from usv_gym.physics import frames as fr
from usv_gym.vessel.vessel import Vessel
from usv_gym.world.realisation import Sea

__all__ = [
    "Response",
    "respond",
    "responses",
]

Array = NDArray[np.float64]

SETTLING_TIME = 30.0
"""Time after which the motion is steady, s; transients of usv75 last 10 s."""

SLOWEST = 0.2
"""Smallest encounter frequency of a simulation, rad/s; the period sets its length."""

_DT = 0.025


class Response(NamedTuple):
    """Amplitudes per wave amplitude: numbers, or arrays over the wave frequency."""

    encounter: Array
    """Encounter frequency, rad/s; below 0 where the boat overtakes the waves."""
    heave: Array
    """m/m."""
    roll: Array
    """rad/m."""
    pitch: Array
    """rad/m."""
    north: Array
    """m/m; the boat heads north."""
    east: Array
    """m/m."""


def respond(
    vessel: Vessel, omega: float, heading: float, *, speed: float = 0.0, amplitude: float = 1e-3
) -> Response:
    """Simulate straight motion in a regular wave, and return the amplitudes.

    ``omega`` is its circular frequency, rad/s, ``heading`` its direction less that of the boat,
    rad: 0 following, pi head sea; ``amplitude`` in m. The boat has a constant shaft speed, for
    ``speed``, m/s. Amplitudes are NaN if the encounter frequency is below :data:`SLOWEST`.
    """
    n = vessel.shaft_speed_for(speed)
    k = omega**2 / GRAVITY
    expected = omega - k * speed * math.cos(heading)
    if abs(expected) < SLOWEST:
        return Response(np.array(expected), *np.full(5, math.nan))
    seconds = SETTLING_TIME + max(20.0, 4.0 * math.pi / abs(expected))
    sea = Sea.regular(vessel, omega, amplitude, to=heading)
    states = np.zeros((math.ceil(seconds / _DT) + 1, fr.STATE_SIZE))
    states[0, [fr.U, fr.N_LEFT, fr.N_RIGHT]] = speed, n, n
    cmds = np.tile(vessel.command(n, 0.0), (len(states) - 1, 1))
    work = np.zeros((ship.WORK_ROWS, fr.STATE_SIZE))
    ship.sail(states, cmds, ship.Ship(vessel.packed, 6), sea.arrays(), _DT, work)
    t = _DT * np.arange(len(states))
    late = t >= SETTLING_TIME
    t, states = t[late], states[late]
    # encounter frequency at the actual mean speed
    made = np.polyfit(t, states[:, [fr.X, fr.Y]], 1)[0]
    encounter = omega - k * (made[0] * math.cos(heading) + made[1] * math.sin(heading))
    basis = np.stack([np.cos(encounter * t), np.sin(encounter * t), np.ones_like(t), t], axis=1)
    motions = states[:, [fr.Z, fr.PHI, fr.THETA, fr.X, fr.Y]]
    fit = np.linalg.lstsq(basis, motions, rcond=None)[0]
    return Response(np.array(encounter), *np.hypot(fit[0], fit[1]) / amplitude)


def responses(
    vessel: Vessel,
    omega: ArrayLike,
    heading: float,
    *,
    speed: float = 0.0,
    amplitude: float = 1e-3,
) -> Response:
    """Return :func:`respond` for several wave frequencies (M,), as arrays."""
    each = [
        respond(vessel, float(w), heading, speed=speed, amplitude=amplitude)
        for w in np.asarray(omega, dtype=float)
    ]
    return Response(*np.array(each).T)
