"""The twin's model of the boat: 25 parameters, in which its accelerations are linear.

    u' = X_uu u|u| + X_vv v^2 + X_vr v r + X_rr r^2 + T_uL nL|nL| cos dL + T_uR nR|nR| cos dR
    v' = Y_u u + Y_v v + Y_r r + Y_v|v| v|v| + Y_v|r| v|r| + Y_r|r| r|r| + Y_ur u r
         + T_vL nL|nL| sin dL + T_vR nR|nR| sin dR
    r' = N_u u + N_v v + N_r r + N_v|v| v|v| + N_v|r| v|r| + N_r|r| r|r| + N_vvr v^2 r
         + N_vrr v r^2 + T_rL nL|nL| sin dL + T_rR nR|nR| sin dR
    x' = u cos(psi) - v sin(psi),  y' = u sin(psi) + v cos(psi),  psi' = r

The state is s = (x, y, psi, u, v, r): m north and east, rad clockwise, m/s forward and to
starboard over the ground, rad/s. The actuators are act = (nL, nR, dL, dR): rev/s, rad. A
positive drive angle turns to starboard, so that T_v < 0 (the stern is pushed to port) and
T_r > 0. Boats with fixed propellers steer by unequal thrust: there the yaw rows are
+T_rL nL|nL| and -T_rR nR|nR|, and again both T_r > 0.

What differs from the paper's print: sin, not cos, of the angle in sway and yaw; no stray v in
the yaw thrust; u|u| and n|n| instead of squares, for astern; N_v|v| and N_v|r| as in the
paper's tables; N_r|r| with r|r|; actuators that can also return to 0 (Eq 27 cannot).

Source: Qu et al. 2025, Eq (20)-(27), with the corrections of physics.md section 10.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from twin.particulars import Particulars
from twin.ukf import POINTS, SCRATCH, SLOPE, sigma_points, time_update
from usv_kernel import kernel

__all__ = [
    "LIMITS",
    "N_ACT",
    "N_STATES",
    "N_XI",
    "PAPER_TABLE_2",
    "PAPER_TABLE_3",
    "PARAMETER_NAMES",
    "PARAMETER_UNITS",
    "X_END",
    "Y_END",
    "accelerations",
    "derivative",
    "follow",
    "hand_prior",
    "hull_regressors",
    "hull_terms",
    "is_differential",
    "joint_predict",
    "parameter_scales",
    "propagate_points",
    "regressors",
    "roll_out",
    "step",
    "thrust_regressors",
    "thrust_terms",
]

Array = NDArray[np.float64]

PARAMETER_NAMES = (
    *("X_uu", "X_vv", "X_vr", "X_rr", "T_uL", "T_uR"),
    *("Y_u", "Y_v", "Y_r", "Y_v|v|", "Y_v|r|", "Y_r|r|", "Y_ur", "T_vL", "T_vR"),
    *("N_u", "N_v", "N_r", "N_v|v|", "N_v|r|", "N_r|r|", "N_vvr", "N_vrr", "T_rL", "T_rR"),
)
"""The parameters xi in order: surge, sway, yaw."""

PARAMETER_UNITS = (
    *("1/m", "1/m", "1/rad", "m/rad2", "m/rev2", "m/rev2"),
    *("1/s", "1/s", "m/(s rad)", "1/m", "1/rad", "m/rad2", "1/rad", "m/rev2", "m/rev2"),
    *("rad/(m s)", "rad/(m s)", "1/s", "rad/m2", "1/m", "1/rad", "s/m2", "s/(m rad)"),
    *("rad/rev2", "rad/rev2"),
)
"""Their units."""

N_STATES, N_ACT, N_XI = 6, 4, 25
X_END, Y_END = 6, 15
"""xi[:X_END] is surge, xi[X_END:Y_END] sway, xi[Y_END:] yaw."""

LIMITS = np.array(
    [[N_STATES, N_STATES]] * 3
    + [
        [N_STATES, N_STATES + X_END],
        [N_STATES + X_END, N_STATES + Y_END],
        [N_STATES + Y_END, N_STATES + N_XI],
    ]
)
"""Columns of the joint vector (s, xi) that each row's acceleration depends on (for twin.ukf)."""

ARRIVED = 1e-7
"""Part of its target within which an actuator counts as there."""

STEP_MAX = 0.25
"""Longest integration step of :func:`roll_out`, s."""

PAPER_TABLE_2 = np.concatenate(
    (
        [-0.01933487, -0.13319095, 0.47497131, 0.02046881, 0.00750947, 0.00750947],
        [
            0.14275839,
            -0.13801318,
            -0.10806983,
            -0.34930751,
            0.17874066,
            0.05575388,
            0.58329755,
            0.13710593,
            -0.07592142,
        ],
        [
            -0.01698518,
            0.03176391,
            -0.17702271,
            -0.04692461,
            0.17730327,
            0.07858179,
            0.11225423,
            0.08986971,
            0.00568659,
            0.00568859,
        ],
    )
)
"""Table 2, identified in a 20 degree turn. No boat: it has no stable motion. For tests only."""

PAPER_TABLE_3 = np.concatenate(
    (
        [-0.01520207, 0.87067625, 0.85951994, -0.09341181, 0.01141719, 0.01141719],
        [
            -0.01204963,
            -0.07585661,
            -0.53618141,
            -0.32916798,
            0.30233231,
            0.13383581,
            0.32354393,
            0.01002316,
            0.00686091,
        ],
        [
            -0.00045943,
            0.04981479,
            -0.29850031,
            -0.06855151,
            -0.06284036,
            -0.09460934,
            0.14198421,
            0.10663989,
            0.00136872,
            0.00107281,
        ],
    )
)
"""Table 3, identified in a 20/-20 degree zigzag. No boat either: it speeds up in turns."""


@kernel
def hull_terms(u, v, r):
    """Return the 19 regressors that depend on the velocities.

    Parameters
    ----------
    u, v, r : float
        Velocities, m/s and rad/s.

    Returns
    -------
    tuple of 19 floats
        Four of surge, seven of sway, eight of yaw; in registers, for the inner loops.

    Source: Eq (22).
    """
    v_v, v_r, r_r = v * abs(v), v * abs(r), r * abs(r)
    vv, rr = v * v, r * r
    surge = (u * abs(u), vv, v * r, rr)
    sway = (u, v, r, v_v, v_r, r_r, u * r)
    yaw = (u, v, r, v_v, v_r, r_r, vv * r, rr * v)
    return surge + sway + yaw


@kernel
def thrust_terms(n_left, n_right, cos_left, sin_left, cos_right, sin_right, differential):
    """Return the 6 regressors that depend on the actuators.

    Parameters
    ----------
    n_left, n_right : float
        Shaft speeds, rev/s.
    cos_left, sin_left, cos_right, sin_right : float
        Of the drive angles.
    differential : float
        1 if the boat steers by unequal thrust, 0 if by the drive angles.

    Returns
    -------
    tuple of 6 floats
        Left and right of surge, sway, yaw.

    Source: Eq (22) with sin in sway and yaw.
    """
    left, right = n_left * abs(n_left), n_right * abs(n_right)
    yaw_left = left if differential > 0.5 else left * sin_left
    yaw_right = -right if differential > 0.5 else right * sin_right
    return (
        left * cos_left,
        right * cos_right,
        left * sin_left,
        right * sin_right,
        yaw_left,
        yaw_right,
    )


@kernel
def hull_regressors(u, v, r, phi):
    """Write :func:`hull_terms` to their places in the 25 regressors phi."""
    terms = hull_terms(u, v, r)
    for k in range(4):
        phi[k] = terms[k]
    for k in range(7):
        phi[X_END + k] = terms[4 + k]
    for k in range(8):
        phi[Y_END + k] = terms[11 + k]


@kernel
def thrust_regressors(act, differential, phi):
    """Write :func:`thrust_terms` to their places in the 25 regressors phi.

    Parameters
    ----------
    act : (4,) array
        Shaft speeds left and right, rev/s; drive angles left and right, rad.
    differential : float
        1 if the boat steers by unequal thrust, 0 if by the drive angles.
    phi : (25,) array
        Regressors; the thrust entries are written.
    """
    terms = thrust_terms(
        act[0],
        act[1],
        math.cos(act[2]),
        math.sin(act[2]),
        math.cos(act[3]),
        math.sin(act[3]),
        differential,
    )
    for k in range(2):
        phi[X_END - 2 + k] = terms[k]
        phi[Y_END - 2 + k] = terms[2 + k]
        phi[N_XI - 2 + k] = terms[4 + k]


@kernel
def regressors(u, v, r, act, differential, phi):
    """Write all 25 regressors, so that each acceleration is its block of phi times that of xi.

    Parameters
    ----------
    u, v, r : float
        Velocities, m/s and rad/s.
    act : (4,) array
        Shaft speeds left and right, rev/s; drive angles left and right, rad.
    differential : float
        1 if the boat steers by unequal thrust, 0 if by the drive angles.
    phi : (25,) array
        Written: surge ``phi[:6]``, sway ``phi[6:15]``, yaw ``phi[15:]``.

    Source: Eq (22).
    """
    thrust_regressors(act, differential, phi)
    hull_regressors(u, v, r, phi)


@kernel
def accelerations(phi, xi, first):
    """Return the three accelerations from regressors and parameters.

    Parameters
    ----------
    phi : (25,) array
        Regressors.
    xi : (first + 25,) array
        Parameters, from entry ``first`` on.
    first : int
        0, or the number of states if these stand before the parameters.

    Returns
    -------
    tuple of 3 floats
        du/dt, dv/dt in m/s2 and dr/dt in rad/s2.

    Source: Eq (20), (23).
    """
    du = 0.0
    for k in range(X_END):
        du += phi[k] * xi[first + k]
    dv = 0.0
    for k in range(X_END, Y_END):
        dv += phi[k] * xi[first + k]
    dr = 0.0
    for k in range(Y_END, N_XI):
        dr += phi[k] * xi[first + k]
    return du, dv, dr


@kernel
def derivative(s, xi, act, differential, phi, out):
    """Write the time derivative of the state.

    Parameters
    ----------
    s : (6,) array
        State x, y (m), psi (rad), u, v (m/s), r (rad/s).
    xi : (25,) array
        Parameters.
    act : (4,) array
        Shaft speeds left and right, rev/s; drive angles left and right, rad.
    differential : float
        1 if the boat steers by unequal thrust, 0 if by the drive angles.
    phi : (25,) array
        Room for the regressors.
    out : (6,) array
        The derivative.

    Source: Eq (20), (26).
    """
    regressors(s[3], s[4], s[5], act, differential, phi)
    cos_psi = math.cos(s[2])
    sin_psi = math.sin(s[2])
    out[0] = s[3] * cos_psi - s[4] * sin_psi
    out[1] = s[3] * sin_psi + s[4] * cos_psi
    out[2] = s[5]
    out[3], out[4], out[5] = accelerations(phi, xi, 0)


@kernel
def step(s, xi, act, differential, h, phi, out):
    """Write the state one Euler step later.

    Parameters
    ----------
    s, xi, act, differential, phi
        See :func:`derivative`.
    h : float
        Step, s.
    out : (6,) array
        The later state; not ``s`` itself.

    Source: Eq (25).
    """
    derivative(s, xi, act, differential, phi, out)
    for k in range(N_STATES):
        out[k] = s[k] + h * out[k]


@kernel
def propagate_points(act, differential, h, work):
    """Send the sigma points of twin.ukf through :func:`step`, and write the model's slope.

    Parameters
    ----------
    act : (4,) array
        Shaft speeds left and right, rev/s; drive angles left and right, rad.
    differential : float
        1 if the boat steers by unequal thrust, 0 if by the drive angles.
    h : float
        Step, s.
    work : array
        ``ukf.workspace(6, 25)``: the states of its points are replaced, the slope is written.

    Source: Eq (25).
    """
    points = work[POINTS]
    slope = work[SLOPE]
    phi = work[SCRATCH, 0]
    thrust_regressors(act, differential, phi)
    psi = points[0, 2]
    cos_psi = cos_0 = math.cos(psi)
    sin_psi = sin_0 = math.sin(psi)
    for i in range(points.shape[0]):
        point = points[i]
        u, v, r = point[3], point[4], point[5]
        if point[2] == psi:  # Half of the points move no heading.
            cos_psi, sin_psi = cos_0, sin_0
        else:
            cos_psi, sin_psi = math.cos(point[2]), math.sin(point[2])
        hull_regressors(u, v, r, phi)
        du, dv, dr = accelerations(phi, point, N_STATES)
        point[0] += h * (u * cos_psi - v * sin_psi)
        point[1] += h * (u * sin_psi + v * cos_psi)
        point[2] += h * r
        point[3] += h * du
        point[4] += h * dv
        point[5] += h * dr
        if i == 0:
            for k in range(X_END):
                slope[3, N_STATES + k] = h * phi[k]
            for k in range(X_END, Y_END):
                slope[4, N_STATES + k] = h * phi[k]
            for k in range(Y_END, N_XI):
                slope[5, N_STATES + k] = h * phi[k]


@kernel
def joint_predict(x, P, act, differential, h, Q_s, q_xi, weights, work):
    """Predict state and parameters over one step with the structured UKF.

    Parameters
    ----------
    x : (31,) array
        Mean of (s, xi); predicted in place.
    P : (31, 31) array
        Its covariance; predicted in place.
    act : (4,) array
        Actuators during the step: rev/s, rad.
    differential : float
        1 if the boat steers by unequal thrust, 0 if by the drive angles.
    h : float
        Step, s.
    Q_s : (6, 6) array
        Process noise of the states for this step.
    q_xi : (25,) array
        Variance that each parameter's random walk adds in this step.
    weights : (4,) array
        From ``ukf.scaled_weights(31, ...)``.
    work : array
        From ``ukf.workspace(6, 25)``.

    Returns
    -------
    int
        Number of numerical repairs (see twin.ukf); 0 as a rule.

    Source: Eq (28)-(30), (34), (43).
    """
    repairs = sigma_points(x, P, weights, work)
    propagate_points(act, differential, h, work)
    return repairs + time_update(x, P, Q_s, q_xi, LIMITS, weights, work)


@kernel
def follow(value, target, lag, rate, h):
    """Return where a lagged, rate-limited actuator is after a time h, exactly.

    It solves ``usv_kernel.actuate`` for a constant target: straight at full rate, then an
    exponential. So a lag far shorter than the step does no harm.

    Parameters
    ----------
    value, target : float
        Where the actuator is and where it is told to go, in its own unit.
    lag : float
        Time constant, s; above 0.
    rate : float
        Largest speed, units per s; infinity for none.
    h : float
        Time, s.

    Returns
    -------
    float
        Later value, in the same unit.
    """
    gap = target - value
    if abs(gap) <= ARRIVED * abs(target):
        return target
    reach = rate * lag  # Within this gap the lag, not the rate, sets the speed.
    if abs(gap) > reach:
        straight = (abs(gap) - reach) / rate
        if h <= straight:
            return value + math.copysign(rate * h, gap)
        h -= straight
        gap = math.copysign(reach, gap)
    return target - gap * math.exp(-h / lag)


@kernel
def _rates(u, v, r, thrust, xi):
    """Return the derivatives of u, v, r at given thrust accelerations."""
    terms = hull_terms(u, v, r)
    du, dv, dr = thrust
    for k in range(4):
        du += terms[k] * xi[k]
    for k in range(7):
        dv += terms[4 + k] * xi[X_END + k]
    for k in range(8):
        dr += terms[11 + k] * xi[Y_END + k]
    return du, dv, dr


@kernel
def _thrust(act, turned, differential, xi):
    """Return the accelerations by thrust; ``turned`` holds cosines and sines of the drives."""
    terms = thrust_terms(act[0], act[1], turned[0], turned[1], turned[2], turned[3], differential)
    return (
        terms[0] * xi[X_END - 2] + terms[1] * xi[X_END - 1],
        terms[2] * xi[Y_END - 2] + terms[3] * xi[Y_END - 1],
        terms[4] * xi[N_XI - 2] + terms[5] * xi[N_XI - 1],
    )


@kernel
def _follow_all(act, command, shaft_lag, steer_lag, steer_rate, h, turned):
    """Advance the four actuators by h in place, and renew the sines of drives that moved."""
    for k in range(2):
        act[k] = follow(act[k], command[k], shaft_lag, math.inf, h)
        before = act[2 + k]
        act[2 + k] = follow(before, command[2 + k], steer_lag, steer_rate, h)
        if act[2 + k] != before:
            turned[2 * k], turned[2 * k + 1] = math.cos(act[2 + k]), math.sin(act[2 + k])


@kernel
def _bounded(value, bound):
    """Return the value within -bound ... bound; -bound for NaN."""
    if value >= bound:
        return bound
    return value if value > -bound else -bound


@kernel
def roll_out(
    s_0,
    xi,
    act_0,
    plan,
    dt_plan,
    shaft_lag,
    steer_lag,
    steer_rate,
    speed_max,
    turn_max,
    differential,
    out,
    out_act,
    turned,
):
    """Predict the motion under a plan of commands, actuators included.

    Runge-Kutta of fourth order at steps of at most :data:`STEP_MAX`. The velocities are held
    within an envelope throughout, so that the worst parameters give a finite motion.

    Parameters
    ----------
    s_0 : (6,) array
        State at the start: x, y (m), psi (rad), u, v (m/s), r (rad/s).
    xi : (25,) array
        Parameters.
    act_0 : (4,) array
        Actuators at the start: rev/s, rad.
    plan : (K, 4) array
        Commands; row k is in force from k to k + 1 times ``dt_plan``.
    dt_plan : float
        Time between rows, s.
    shaft_lag, steer_lag : float
        Time constants of shaft speed and drive angle, s; above 0.
    steer_rate : float
        Largest turning speed of the drives, rad/s.
    speed_max, turn_max : float
        Envelope: largest abs(u) and abs(v), m/s; largest abs(r), rad/s.
    differential : float
        1 if the boat steers by unequal thrust, 0 if by the drive angles.
    out : (K, 6) array
        Row k is the state at the end of row k of the plan ...
    out_act : (K, 4) array
        ... and this the actuators then.
    turned : (4,) array
        Room for cosine and sine of the drive angles, left and right.

    Source: Eq (25)-(27), with Eq (27) replaced by ``usv_kernel.actuate``.
    """
    x, y, psi = s_0[0], s_0[1], s_0[2]
    u = _bounded(s_0[3], speed_max)
    v = _bounded(s_0[4], speed_max)
    r = _bounded(s_0[5], turn_max)
    vx = u * math.cos(psi) - v * math.sin(psi)
    vy = u * math.sin(psi) + v * math.cos(psi)
    steps = max(math.ceil(dt_plan / STEP_MAX - 1e-9), 1)
    h = dt_plan / steps
    for k in range(2):
        turned[2 * k], turned[2 * k + 1] = math.cos(act_0[2 + k]), math.sin(act_0[2 + k])
    end = _thrust(act_0, turned, differential, xi)
    for row in range(plan.shape[0]):
        act = out_act[row]
        for k in range(N_ACT):
            act[k] = out_act[row - 1, k] if row > 0 else act_0[k]
        for _ in range(steps):
            start = end
            _follow_all(act, plan[row], shaft_lag, steer_lag, steer_rate, 0.5 * h, turned)
            middle = _thrust(act, turned, differential, xi)
            _follow_all(act, plan[row], shaft_lag, steer_lag, steer_rate, 0.5 * h, turned)
            end = _thrust(act, turned, differential, xi)
            du_1, dv_1, dr_1 = _rates(u, v, r, start, xi)
            u_2 = _bounded(u + 0.5 * h * du_1, speed_max)
            v_2 = _bounded(v + 0.5 * h * dv_1, speed_max)
            r_2 = _bounded(r + 0.5 * h * dr_1, turn_max)
            du_2, dv_2, dr_2 = _rates(u_2, v_2, r_2, middle, xi)
            u_3 = _bounded(u + 0.5 * h * du_2, speed_max)
            v_3 = _bounded(v + 0.5 * h * dv_2, speed_max)
            r_3 = _bounded(r + 0.5 * h * dr_2, turn_max)
            du_3, dv_3, dr_3 = _rates(u_3, v_3, r_3, middle, xi)
            u_4 = _bounded(u + h * du_3, speed_max)
            v_4 = _bounded(v + h * dv_3, speed_max)
            r_4 = _bounded(r + h * dr_3, turn_max)
            du_4, dv_4, dr_4 = _rates(u_4, v_4, r_4, end, xi)
            u_1, v_1, r_1 = u, v, r
            u = _bounded(u + h / 6.0 * (du_1 + 2.0 * (du_2 + du_3) + du_4), speed_max)
            v = _bounded(v + h / 6.0 * (dv_1 + 2.0 * (dv_2 + dv_3) + dv_4), speed_max)
            r = _bounded(r + h / 6.0 * (dr_1 + 2.0 * (dr_2 + dr_3) + dr_4), turn_max)
            # heading and place follow the velocities by Simpson's rule, with two sines a step;
            # the velocities in the middle are those of a cubic through both ends
            u_m = _bounded(0.5 * (u_1 + u) + 0.125 * h * (du_1 - du_4), speed_max)
            v_m = _bounded(0.5 * (v_1 + v) + 0.125 * h * (dv_1 - dv_4), speed_max)
            r_m = _bounded(0.5 * (r_1 + r) + 0.125 * h * (dr_1 - dr_4), turn_max)
            psi_m = psi + h / 24.0 * (5.0 * r_1 + 8.0 * r_m - r)
            psi += h / 6.0 * (r_1 + 4.0 * r_m + r)
            cos_m, sin_m = math.cos(psi_m), math.sin(psi_m)
            vx_1, vy_1 = vx, vy
            cos_psi, sin_psi = math.cos(psi), math.sin(psi)
            vx, vy = u * cos_psi - v * sin_psi, u * sin_psi + v * cos_psi
            x += h / 6.0 * (vx_1 + 4.0 * (u_m * cos_m - v_m * sin_m) + vx)
            y += h / 6.0 * (vy_1 + 4.0 * (u_m * sin_m + v_m * cos_m) + vy)
        out[row, 0], out[row, 1], out[row, 2] = x, y, psi
        out[row, 3], out[row, 4], out[row, 5] = u, v, r


def is_differential(particulars: Particulars) -> float:
    """Return the kernels' argument ``differential``: 1.0 for steering by unequal thrust."""
    return 1.0 if particulars.steering == "differential" else 0.0


_POWERS = np.array(
    [
        *((-1, 0, 0), (-1, 0, 0), (0, 0, 0), (1, 0, 0), (-1, 2, -2), (-1, 2, -2)),
        *((-1, 1, 0), (-1, 1, 0), (0, 1, 0), (-1, 0, 0), (0, 0, 0), (1, 0, 0), (0, 0, 0)),
        *((-1, 2, -2), (-1, 2, -2)),
        *((-2, 1, 0), (-2, 1, 0), (-1, 1, 0), (-2, 0, 0), (-1, 0, 0), (0, 0, 0), (-1, -1, 0)),
        *((0, -1, 0), (-2, 2, -2), (-2, 2, -2)),
    ],
    dtype=np.float64,
)
"""Powers of length, speed and shaft speed in the natural unit of each parameter."""


def parameter_scales(length: float, speed: float, shaft_speed: float) -> Array:
    """Return the natural unit of each parameter, by which it becomes dimensionless.

    Lengths count in L, speeds in U, shaft speeds in n; hence times in L/U, accelerations in
    U^2/L, yaw rates in U/L and yaw accelerations in U^2/L^2:

    ====================================  =====================
    parameters                            natural unit
    ====================================  =====================
    X_uu, X_vv, Y_v|v|, N_v|r|            1 / L
    X_vr, Y_v|r|, Y_ur, N_r|r|            1
    X_rr, Y_r|r|                          L
    Y_u, Y_v, N_r                         U / L
    Y_r                                   U
    N_u, N_v                              U / L^2
    N_v|v|                                1 / L^2
    N_vvr                                 1 / (U L)
    N_vrr                                 1 / U
    T_uL, T_uR, T_vL, T_vR                U^2 / (L n^2)
    T_rL, T_rR                            U^2 / (L^2 n^2)
    ====================================  =====================

    Parameters
    ----------
    length : float
        L, m.
    speed : float
        U, m/s.
    shaft_speed : float
        n, rev/s.

    Returns
    -------
    (25,) array
        In the units of :data:`PARAMETER_UNITS`.
    """
    scales: Array = np.prod(np.array([length, speed, shaft_speed]) ** _POWERS, axis=1)
    return scales


_STUDY_MEAN = np.concatenate(
    (
        [-0.030, -0.024, 1.29, 0.0, 0.00935, 0.00935],
        [0.0, -0.89, 1.17, -0.17, 0.0, 0.0, -0.78, -0.012, -0.012],
        [0.0, -0.288, -2.05, 0.0, 0.0, -0.7, -0.2, 0.0, 0.011, 0.011],
    )
)
_STUDY_SD = np.concatenate(
    (
        [0.010, 0.05, 0.3, 0.2, 0.003, 0.003],
        [0.01, 0.45, 0.8, 0.3, 1.0, 0.5, 0.2, 0.008, 0.008],
        [0.005, 0.3, 1.0, 0.1, 1.0, 1.0, 0.3, 0.5, 0.006, 0.006],
    )
)
STUDY_LENGTH, STUDY_SPEED = 6.336, 5.4
"""Waterline (m) and speed (m/s) of the boat that prior and filter were tuned for."""
_STUDY_SCALES = parameter_scales(STUDY_LENGTH, STUDY_SPEED, 6.33)

# Fixed propellers .2 L off the middle turn a boat whose radius of gyration is .25 L.
_DIFFERENTIAL_MEAN, _DIFFERENTIAL_SD = 0.24, 0.14


def hand_prior(particulars: Particulars) -> tuple[Array, Array]:
    """Return what is believed of the parameters before any data, from main particulars.

    The prior of a boat of 6.336 m (waterline) at 5.4 m/s with 6.33 rev/s, made dimensionless by
    :func:`parameter_scales` and given the units of this boat. Where the boat steers by
    unequal thrust, T_r is (.24 +- .14) U^2 / (L n)^2 and T_v is 0 on average.

    Parameters
    ----------
    particulars : Particulars
        Length, speed, shaft speed and steering are used.

    Returns
    -------
    xi_0, sd_0 : (25,) arrays
        Mean and standard deviation of each parameter.

    Source: twin.md section 13.
    """
    scales = parameter_scales(particulars.length, particulars.speed, particulars.shaft_speed)
    mean = _STUDY_MEAN / _STUDY_SCALES * scales
    sd = _STUDY_SD / _STUDY_SCALES * scales
    if particulars.steering == "differential":
        mean[13:15] = 0.0
        mean[23:25] = _DIFFERENTIAL_MEAN * scales[23:25]
        sd[23:25] = _DIFFERENTIAL_SD * scales[23:25]
    return mean, sd
