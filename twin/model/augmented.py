"""State and parameters as one vector: sigma points through the model, and their prediction."""

from __future__ import annotations

from twin.filters.ukf import POINTS, SLOPE, sigma_points, time_update
from twin.model.dynamics import all_terms
from twin.model.structure import N_STATES, accelerations, state_terms
from usv_kernel.jit import inlined, kernel
from usv_kernel.scalar import sincos

__all__ = [
    "joint_predict",
    "propagate_points",
]


@kernel
def propagate_points(act, wind, kit, h, terms, work):
    """Send the sigma points of twin.filters.ukf through :func:`step`, and write the model's slope.

    Parameters
    ----------
    act, wind, kit, terms
        See :func:`derivative`.
    h : float
        Step, s.
    work : array
        ``ukf.workspace(6, p)``: the states of its points are replaced, the slope is written.

    Source: Eq (25).
    """
    points = work[POINTS]
    slope = work[SLOPE]
    which, limits, hull = kit
    all_terms(points[0], act, wind, kit, terms)
    for i in range(3):
        low, high = limits[3 + i, 0], limits[3 + i, 1]
        row, term = slope[3 + i, low:high], which[i, low - N_STATES :]
        for k in range(high - low):
            row[k] = h * terms[term[k]]
    psi = points[0, 2]
    sin_0, cos_0 = sincos(psi)
    sin_psi, cos_psi = sin_0, cos_0
    for i in range(points.shape[0]):
        point = points[i]
        u, v, r = point[3], point[4], point[5]
        if point[2] == psi:  # Half of the points move no heading.
            cos_psi, sin_psi = cos_0, sin_0
        else:
            sin_psi, cos_psi = sincos(point[2])
        state_terms(u, v, r, cos_psi, sin_psi, wind, hull, terms)
        du, dv, dr = accelerations(terms, kit, point, N_STATES)
        point[0] += h * (u * cos_psi - v * sin_psi)
        point[1] += h * (u * sin_psi + v * cos_psi)
        point[2] += h * r
        point[3] += h * du
        point[4] += h * dv
        point[5] += h * dr


@inlined
def joint_predict(x, P, act, wind, kit, h, Q_s, q_xi, weights, terms, work):
    """Predict state and parameters over one step with the structured UKF.

    Parameters
    ----------
    x : (6 + p,) array
        Mean of (s, xi); predicted in place.
    P : (6 + p, 6 + p) array
        Its covariance; predicted in place.
    act, wind, kit, terms
        See :func:`derivative`; actuators during the step.
    h : float
        Step, s.
    Q_s : (6, 6) array
        Process noise of the states for this step.
    q_xi : (p,) array
        Variance that each parameter's random walk adds in this step.
    weights : (4,) array
        From ``ukf.scaled_weights(6 + p, ...)``.
    work : array
        From ``ukf.workspace(6, p)``.

    Returns
    -------
    int
        Number of numerical repairs (see twin.filters.ukf); 0 as a rule.

    Source: Eq (28)-(30), (34), (43).
    """
    repairs = sigma_points(x, P, weights, work)
    propagate_points(act, wind, kit, h, terms, work)
    return repairs + time_update(x, P, Q_s, q_xi, kit[1], weights, work)
