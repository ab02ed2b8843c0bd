"""The twin's model in continuous time: terms, derivative, one Euler step."""

from __future__ import annotations

import math

from twin.channels import PSI, R, U, V, X, Y
from twin.model.structure import (
    N_STATES,
    Structure,
    accelerations,
    state_terms,
    structure_of,
    thrust_terms,
)
from twin.particulars import Particulars
from usv_kernel.jit import inlined, kernel

__all__ = [
    "N_ACT",
    "all_terms",
    "derivative",
    "model_of",
    "step",
]

N_ACT = 4


def model_of(
    particulars: Particulars, name: str, *, biased: bool = False, tanker: bool | None = None
) -> Structure:
    """Return the model structure of a boat; StructureError lists the names that there are.

    ``name`` is one of ``twin.model.structure.MODELS``. ``biased`` adds two earth-fixed
    accelerations where the structure has none. ``tanker`` follows from the particulars if left out.
    """
    return structure_of(
        name,
        particulars.length,
        particulars.speed,
        particulars.shaft_speed,
        differential=particulars.steering == "differential",
        tanker=particulars.tanker if tanker is None else tanker,
        biased=biased,
    )


@inlined
def all_terms(s, act, wind, model, terms):
    """Write every term of a state and of its actuators; arguments as for :func:`derivative`."""
    thrust_terms(
        act[0],
        act[1],
        math.cos(act[2]),
        math.sin(act[2]),
        math.cos(act[3]),
        math.sin(act[3]),
        terms,
    )
    state_terms(s[U], s[V], s[R], math.cos(s[PSI]), math.sin(s[PSI]), wind, model.hull, terms)


@kernel
def derivative(s, xi, act, wind, model, terms, out):
    """Write the time derivative (6,) of the state, and leave the terms in ``terms`` (50,).

    ``act`` has shaft speeds in the unit of the structure. ``wind`` (2,) is the true wind to north
    and east, m/s, zeros where it is not known. Source: Eq (20), (26).
    """
    all_terms(s, act, wind, model, terms)
    cos_psi, sin_psi = math.cos(s[PSI]), math.sin(s[PSI])
    out[X] = s[U] * cos_psi - s[V] * sin_psi
    out[Y] = s[U] * sin_psi + s[V] * cos_psi
    out[PSI] = s[R]
    out[U], out[V], out[R] = accelerations(terms, model, xi, 0)


@kernel
def step(s, xi, act, wind, model, h, terms, out):
    """Write the state one Euler step h (s) later to ``out``, not ``s`` itself. Source: Eq (25)."""
    derivative(s, xi, act, wind, model, terms, out)
    for k in range(N_STATES):
        out[k] = s[k] + h * out[k]
