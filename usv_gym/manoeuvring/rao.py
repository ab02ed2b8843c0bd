"""Response amplitudes in regular waves, and independent formulas to compare them with.

Amplitudes come from a simulation in six degrees of freedom, in a wave so low that the response is
linear. The formulas are Jensen's closed forms of heave and pitch, and the numerical integral of
the wave pressure over a box.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import spherical_jn

from usv_gym.physics import GRAVITY, ship, waves
from usv_gym.physics import frames as fr
from usv_gym.vessel.vessel import Vessel
from usv_gym.world.realisation import Sea

__all__ = [
    "Box",
    "Response",
    "box_loads",
    "jensen",
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
    return _respond(vessel, omega, heading, speed, amplitude, vessel.shaft_speed_for(speed))


def _respond(
    vessel: Vessel, omega: float, heading: float, speed: float, amplitude: float, n: float
) -> Response:
    """Return amplitudes at a given shaft speed; see :func:`respond`."""
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
    n = vessel.shaft_speed_for(speed)
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

    ``omega`` is the circular frequency of the wave, rad/s. ``heading`` is its direction less that
    of the boat, rad: 0 following, pi head sea. ``speed`` is in m/s, for Froude numbers below 0.4.
    Lengths are of the water line, m; ``block`` reduces the beam.

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


class Box(NamedTuple):
    """A floating box in m, and the density of the water in kg/m3."""

    length: float
    beam: float
    draft: float
    density: float


def box_loads(row: Array, x: float, y: float, psi: float, t: float, box: Box) -> Array:
    """Return X, Y (N), N (N m), Z (N, down), K, M (N m) of one wave on a box, by quadrature.

    ``row`` (7,) is one wave component. Gauss-Legendre quadrature of the pressure on the bottom,
    and of its horizontal gradient over the volume. By Gauss' theorem this equals the pressure on
    the sides, without cancellation.
    """
    length, beam, draft, density = box
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
