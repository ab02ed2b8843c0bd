"""Heave, roll and pitch in regular waves, and independent formulas to hold them against.

Amplitudes come from the simulated ship, six degrees of freedom, in a wave so low that the
answer is linear. Beside them stand Jensen's closed forms of heave and pitch, and the pressure of
a wave integrated numerically over a box.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq
from scipy.special import spherical_jn

from usv_gym.physics import GRAVITY, ship, waves
from usv_gym.physics import frames as fr
from usv_gym.vessel.vessel import Vessel
from usv_gym.world.sea import Sea

__all__ = [
    "Response",
    "box_loads",
    "jensen",
    "respond",
    "responses",
    "shaft_speed_for",
]

Array = NDArray[np.float64]

SETTLE = 30.0
"""Time after which the motion is taken as steady, s; heave, roll and pitch are over in 10."""

SLOWEST = 0.2
"""Encounter frequency, rad/s, below which no amplitude is given: it would take too long."""

_DT = 0.025


class Response(NamedTuple):
    """Amplitudes over that of the wave, each a number or an array over the wave frequency."""

    encounter: Array
    """Frequency at which the boat meets the waves, rad/s; below 0 where it overtakes them."""
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


def shaft_speed_for(vessel: Vessel, speed: float) -> float:
    """Return the shaft speed in rev/s that holds a speed straight ahead in calm water.

    Parameters
    ----------
    vessel : Vessel
        The ship.
    speed : float
        Speed, m/s; 0 or more.
    """
    if speed <= 0.0:
        return 0.0
    top = 1.0
    while vessel.straight_speed(top) < speed:
        top *= 2.0
    return float(brentq(lambda n: vessel.straight_speed(n) - speed, 0.0, top, xtol=1e-10))


def respond(
    vessel: Vessel, omega: float, heading: float, *, speed: float = 0.0, amplitude: float = 1e-3
) -> Response:
    """Sail straight through one regular wave, and return the amplitudes of the motion.

    Parameters
    ----------
    vessel : Vessel
        The ship.
    omega : float
        Circular frequency of the wave, rad/s.
    heading : float
        Direction of the wave less that of the boat, rad: 0 following, pi head sea.
    speed : float
        Speed of the boat, m/s; held by its shafts.
    amplitude : float
        Amplitude of the wave, m.

    Returns
    -------
    Response
        Of numbers; NaN where the encounter frequency is below :data:`SLOWEST`.
    """
    return _respond(vessel, omega, heading, speed, amplitude, shaft_speed_for(vessel, speed))


def _respond(
    vessel: Vessel, omega: float, heading: float, speed: float, amplitude: float, n: float
) -> Response:
    k = omega**2 / GRAVITY
    expected = omega - k * speed * math.cos(heading)
    if abs(expected) < SLOWEST:
        return Response(np.array(expected), *np.full(5, math.nan))
    seconds = SETTLE + max(20.0, 4.0 * math.pi / abs(expected))
    sea = Sea.regular(vessel, omega, amplitude, to=heading)
    states = np.zeros((math.ceil(seconds / _DT) + 1, fr.STATE_SIZE))
    states[0, [fr.U, fr.N_LEFT, fr.N_RIGHT]] = speed, n, n
    cmds = np.tile(vessel.helm(n, 0.0), (len(states) - 1, 1))
    work = np.zeros((ship.WORK_ROWS, fr.STATE_SIZE))
    ship.sail(states, cmds, ship.Ship(vessel.packed, 6), sea.arrays(), _DT, work)
    t = _DT * np.arange(len(states))
    late = t >= SETTLE
    t, states = t[late], states[late]
    # the wave is met at the speed that the boat really makes
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
    """Return the amplitudes of the motion over wave frequency: :func:`respond` at each.

    Parameters
    ----------
    omega : array_like, shape (M,)
        Circular frequencies of the wave, rad/s.
    vessel, heading, speed, amplitude
        See :func:`respond`.

    Returns
    -------
    Response
        Of arrays of shape (M,).
    """
    n = shaft_speed_for(vessel, speed)
    each = [
        _respond(vessel, float(w), heading, speed, amplitude, n)
        for w in np.asarray(omega, dtype=float)
    ]
    return Response(*np.array(each).T)


def jensen(
    omega: ArrayLike,
    heading: float,
    *,
    speed: float,
    length: float,
    beam: float,
    draft: float,
    block: float,
) -> tuple[Array, Array]:
    """Return heave (m/m) and pitch (rad/m) of a box-shaped ship by Jensen's closed forms.

    Parameters
    ----------
    omega : array_like
        Circular frequency of the wave, rad/s.
    heading : float
        Direction of the wave less that of the boat, rad: 0 following, pi head sea.
    speed : float
        Speed of the boat, m/s; meant for Froude numbers below 0.4.
    length, beam, draft : float
        Of the water line, m.
    block : float
        Block coefficient; it narrows the beam.

    Notes
    -----
    Source: Jensen, Mansour and Olsen 2004; the pressure falls with exp(-k T) on every heading.
    """
    w = np.asarray(omega, dtype=float)
    k, B, T = w**2 / GRAVITY, beam * block, draft
    a = 1.0 - w * speed / GRAVITY * math.cos(heading)
    half = 0.5 * np.abs(k * math.cos(heading)) * length
    A = 2.0 * np.sin(0.5 * k * B * a**2) * np.exp(-k * T * a**2)
    f = np.sqrt((1.0 - k * T) ** 2 + (A**2 / (k * B * a**3)) ** 2)
    load = np.exp(-k * T) * f
    eta = 1.0 / np.hypot(1.0 - 2.0 * k * T * a**2, A**2 / (k * B * a**2))
    heave = eta * load * np.abs(np.sinc(half / math.pi))
    pitch = eta * load * (6.0 / length) * np.abs(spherical_jn(1, half))
    return heave, pitch


def box_loads(
    row: Array,
    x: float,
    y: float,
    psi: float,
    t: float,
    *,
    length: float,
    beam: float,
    draft: float,
    density: float,
) -> Array:
    """Return the loads of one wave on a box by numerical integration of its pressure.

    Parameters
    ----------
    row : ndarray, shape (7,)
        One wave component; rows in :mod:`usv_gym.physics.waves`.
    x, y, psi, t : float
        Place (m) and heading (rad) of the box, and time (s).
    length, beam, draft, density : float
        Of the box (m), and of the water (kg/m3).

    Returns
    -------
    ndarray, shape (6,)
        X, Y (N) and N (N m), then Z (N, down), K and M (N m).

    Notes
    -----
    Gauss-Legendre quadrature. Horizontally the gradient of the pressure over the volume stands
    for the pressure on the sides (Gauss' theorem), so that no nearly equal numbers are
    subtracted; vertically it is the pressure on the bottom.
    """
    nodes, weights = np.polynomial.legendre.leggauss(48)
    a, b = 0.5 * length * nodes[:, None], 0.5 * beam * nodes[None, :]
    area = 0.25 * length * beam * weights[:, None] * weights[None, :]
    k = math.hypot(row[waves.K_NORTH], row[waves.K_EAST])
    c, s = math.cos(psi), math.sin(psi)
    k_x = row[waves.K_NORTH] * c + row[waves.K_EAST] * s
    k_y = row[waves.K_EAST] * c - row[waves.K_NORTH] * s
    phase = row[waves.K_NORTH] * x + row[waves.K_EAST] * y - row[waves.OMEGA] * t
    phase = phase + row[waves.PHASE] + k_x * a + k_y * b
    z = -0.5 * draft * (1.0 - nodes)
    depth = float(np.sum(0.5 * draft * weights * np.exp(k * z)))
    pressure = density * GRAVITY * row[waves.AMPLITUDE]
    push = pressure * depth * area * np.sin(phase)
    up = pressure * math.exp(-k * draft) * area * np.cos(phase)
    # an upward force at (a, b): K = -b up, M = a up (bow up)
    return np.array(
        [
            k_x * np.sum(push),
            k_y * np.sum(push),
            np.sum(push * (k_y * a - k_x * b)),
            -np.sum(up),
            -np.sum(b * up),
            np.sum(a * up),
        ]
    )
