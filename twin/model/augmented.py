"""State and parameters as one vector: sigma points through the model, and their prediction."""

from __future__ import annotations

from typing import Any, NamedTuple

from twin.channels import PSI, R, U, V, X, Y
from twin.filters.ukf import sigma_points, time_update
from twin.model.dynamics import current_terms, drive, rates_over_ground
from twin.model.structure import BY_CURRENT, N_STATES, N_TERMS, current_of
from usv_kernel.jit import inlined, kernel
from usv_kernel.scalar import sincos

__all__ = [
    "JointConfig",
    "JointState",
    "JointWorkspace",
    "joint_predict",
    "propagate_points",
]


class JointState(NamedTuple):
    """What :func:`joint_predict` needs of a state; others may have more fields."""

    x: Any  # (6 + p,) mean of (s, xi): m, rad, m/s, rad/s, parameters
    P: Any  # (6 + p, 6 + p) its covariance
    act: Any  # (4,) actuators during the step: in the unit of the structure, rad
    wind: Any  # (2,) true wind to north and east, m/s; zeros where it is not known


class JointConfig(NamedTuple):
    """What it needs of a configuration."""

    model: Any  # ModelTerms
    weights: Any  # (4,) from ``ukf.scaled_weights(6 + p, ...)``


class JointWorkspace(NamedTuple):
    """What it needs of a workspace."""

    Q: Any  # (6, 6) process noise of the states for this step
    q_xi: Any  # (p,) variance that each parameter's random walk adds in this step
    terms: Any  # (N_TERMS,) terms of the model
    sigma: Any  # UKFWorkspace


@kernel
def propagate_points(act, wind, model, h, terms, sigma):
    """Send the sigma points through the model; write its slope. Source: Eq (25)."""
    points, slope = sigma.points, sigma.slope
    psi = points[0, 2]
    sin_0, cos_0 = sincos(psi)
    drive(act, terms)
    motion, current = (
        (points[0, 3], points[0, 4], points[0, 5], cos_0, sin_0),
        current_of(points[0], N_STATES, model.hull),
    )
    rates_over_ground(motion, wind, current, points[0], N_STATES, model, terms)
    current_terms(motion, wind, points[0], N_STATES, model, terms)
    for i in range(3):
        low, high = model.limits[3 + i, 0], model.limits[3 + i, 1]
        row, term = slope[3 + i, low:high], model.which[i, low - N_STATES :]
        for k in range(high - low):
            row[k] = h * terms[term[k]]
    for k in range(BY_CURRENT, N_TERMS):
        terms[k] = 0.0
    sin_psi, cos_psi = sin_0, cos_0
    for i in range(points.shape[0]):
        point = points[i]
        u, v, r = point[U], point[V], point[R]
        if point[PSI] == psi:  # Half of the points move no heading.
            cos_psi, sin_psi = cos_0, sin_0
        else:
            sin_psi, cos_psi = sincos(point[PSI])
        motion, current = (u, v, r, cos_psi, sin_psi), current_of(point, N_STATES, model.hull)
        du, dv, dr = rates_over_ground(motion, wind, current, point, N_STATES, model, terms)
        point[X] += h * (u * cos_psi - v * sin_psi)
        point[Y] += h * (u * sin_psi + v * cos_psi)
        point[PSI] += h * r
        point[U] += h * du
        point[V] += h * dv
        point[R] += h * dr


@inlined
def joint_predict(state, h, config, work):
    """Predict state and parameters over a step h (s) with the structured UKF, in place.

    Returned is the number of numerical repairs (see twin.filters.ukf); 0 as a rule.
    Source: Eq (28)-(30), (34), (43).
    """
    repairs = sigma_points(state.x, state.P, config.weights, work.sigma)
    propagate_points(state.act, state.wind, config.model, h, work.terms, work.sigma)
    limits = config.model.limits
    return repairs + time_update(
        state.x, state.P, work.Q, work.q_xi, limits, config.weights, work.sigma
    )
