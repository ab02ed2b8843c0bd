"""The twin's model in continuous time: terms, derivative, one Euler step."""

from __future__ import annotations

import math

from twin.channels import PSI, R, U, V, X, Y
from twin.model.structure import (
    BY_CURRENT,
    CURRENT,
    N_STATES,
    Structure,
    accelerations,
    current_of,
    state_terms,
    structure_of,
    through_water,
    thrust_terms,
)
from twin.particulars import Particulars
from usv_kernel.jit import inlined, kernel

__all__ = [
    "N_ACT",
    "current_terms",
    "derivative",
    "drive",
    "model_of",
    "rates_over_ground",
    "step",
]

N_ACT = 4


def model_of(
    particulars: Particulars,
    name: str,
    *,
    biased: bool = False,
    tanker: bool | None = None,
    current: bool = False,
) -> Structure:
    """Return the model structure of a boat; StructureError lists the names that there are.

    Parameters
    ----------
    particulars : Particulars
        Main particulars and steering are used.
    name : str
        One of ``twin.model.structure.MODELS``.
    biased : bool
        Add two earth-fixed accelerations where the structure has none.
    tanker : bool, optional
        Whether it is one; what the particulars say if left out.
    current : bool
        Add the velocity of the water.

    Raises
    ------
    StructureError
        Lists the names that there are.
    """
    return structure_of(
        name,
        particulars.length,
        particulars.speed,
        particulars.shaft_speed,
        differential=particulars.steering == "differential",
        tanker=particulars.tanker if tanker is None else tanker,
        biased=biased,
        current=current,
    )


@inlined
def drive(act, terms):
    """Write the terms of the actuators."""
    left = right = math.cos(act[2]), math.sin(act[2])
    if act[3] != act[2]:
        right = math.cos(act[3]), math.sin(act[3])
    thrust_terms(act[0], act[1], left[0], left[1], right[0], right[1], terms)


@inlined
def rates_over_ground(motion, wind, current, xi, first, model, terms):
    """Return the three accelerations over the ground; the terms of the actuators must be there.

    Parameters
    ----------
    motion : tuple of float
        u, v over the ground (m/s), r (rad/s), cosine and sine of the heading.
    wind, current
        See :func:`twin.model.structure.through_water`.
    xi, first, model, terms
        See :func:`twin.model.structure.accelerations`.
    """
    u, v, r, c, s = motion
    (u, v), over, (ahead, aside) = through_water((u, v), (c, s), wind, current)
    state_terms(u, v, r, c, s, over, model.hull, terms)
    du, dv, dr = accelerations(terms, model, xi, first)
    return du + r * aside, dv - r * ahead, dr


@inlined
def current_terms(motion, wind, xi, first, model, terms):
    """Write the accelerations' slopes by the current among the terms, by differences."""
    if not model.hull[CURRENT] >= 0.0:
        return
    small, (north, east) = 1e-4, current_of(xi, first, model.hull)
    by_north = rates_over_ground(motion, wind, (north + small, east), xi, first, model, terms)
    by_east = rates_over_ground(motion, wind, (north, east + small), xi, first, model, terms)
    rate = rates_over_ground(motion, wind, (north, east), xi, first, model, terms)
    for i in range(3):
        terms[BY_CURRENT + 2 * i] = (by_north[i] - rate[i]) / small
        terms[BY_CURRENT + 2 * i + 1] = (by_east[i] - rate[i]) / small


@kernel
def derivative(s, xi, act, wind, model, terms, out):
    """Write the time derivative (6,) of the state, and leave the terms in ``terms`` (N_TERMS,).

    ``act`` has shaft speeds in the unit of the structure. ``wind`` (2,) is the true wind to north
    and east, m/s, zeros where it is not known. Source: Eq (20), (26).
    """
    drive(act, terms)
    cos_psi, sin_psi = math.cos(s[PSI]), math.sin(s[PSI])
    out[X] = s[U] * cos_psi - s[V] * sin_psi
    out[Y] = s[U] * sin_psi + s[V] * cos_psi
    out[PSI] = s[R]
    motion, current = (s[U], s[V], s[R], cos_psi, sin_psi), current_of(xi, 0, model.hull)
    out[U], out[V], out[R] = rates_over_ground(motion, wind, current, xi, 0, model, terms)


@kernel
def step(s, xi, act, wind, model, h, terms, out):
    """Write the state one Euler step h (s) later to ``out``, not ``s`` itself. Source: Eq (25)."""
    derivative(s, xi, act, wind, model, terms, out)
    for k in range(N_STATES):
        out[k] = s[k] + h * out[k]
