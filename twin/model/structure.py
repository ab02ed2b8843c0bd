"""Model structures: which terms the accelerations of a twin's model are made of.

A structure is a list of parameters. Each multiplies one *term*, a known function of velocities,
heading, actuators and wind, in the equation of surge, sway or yaw:

    u' = sum of X_k term_k,   v' = sum of Y_k term_k,   r' = sum of N_k term_k

so that the accelerations are linear in the parameters, and one filter serves every structure.
A new structure is a new list in :data:`TERMS`, and a new term a line of it. A new regressor is an
index before LEFT_COS, its value in :func:`state_terms`, its slopes in :func:`term_slopes`, and its
place among :data:`BY_U` to :data:`BY_PSI`.

``paper``
    the 25 parameters of Eq (20)-(21). These differ from the print: sin, not cos, of the angle in
    sway and yaw, and no stray v in the yaw thrust. It has u|u| and n|n| instead of squares, for
    astern. N_v|v| and N_v|r| as in the paper's tables; N_r|r| with r|r|. Boats with fixed
    propellers steer by unequal thrust: their yaw rows are +T_rL nL|nL| and -T_rR nR|nR|.
``mmg``
    about thirty, dimensionless but for the length. They are a resistance with a hump (cubic in u),
    damping that grows with speed, and thrust that falls with advance. A rudder or drive in the
    inflow of hull and propeller, apparent wind, and slow biases follow. The biases of yaw go with
    the heading, once and twice around. Wind and waves turn a boat that lies across them, and what
    is not measured must be learned. Left and right propeller enter as their mean and difference,
    because nothing tells them apart when they turn at the same speed. No two thrusters are equal:
    N_mn and X_dn are the turning by their mean and the push by their difference. A tanker has one
    propeller, and neither: N_dn is the turning of one that runs astern. Behind it, flow
    from port is not straightened as flow from starboard is. Y_S and N_S, of tankers alone, are what
    the rudder's lift gains from one side and loses from the other.

Both can have two *earth-fixed accelerations* (E_north, E_east) for what wind and current do beyond
the model. They enter surge and sway together.

Source: Qu et al. 2025, Eq (20)-(22), with the corrections of
docs/explanation/ship_and_sea.md, What the paper gets wrong; docs/explanation/twin.md, Tankers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from usv_kernel.errors import UsvTwinError
from usv_kernel.jit import inlined, kernel
from usv_kernel.scalar import fma

__all__ = [
    "BY_CURRENT",
    "BY_PSI",
    "BY_R",
    "BY_U",
    "BY_V",
    "CURRENT",
    "ENVIRONMENT",
    "MODELS",
    "N_STATES",
    "N_TERMS",
    "TERMS",
    "UNEQUAL_THRUSTERS",
    "ModelTerms",
    "Structure",
    "StructureError",
    "Term",
    "accelerations",
    "gather",
    "inflow",
    "nominal_speed",
    "rates",
    "state_terms",
    "structure_of",
    "term_slopes",
    "thrust_rates",
    "thrust_terms",
]

Array = NDArray[np.float64]


class ModelTerms(NamedTuple):
    """A structure as kernels read it."""

    which: NDArray[np.uint64]  # (3, p) term of each parameter in surge, sway and yaw
    limits: NDArray[np.int64]  # (6, 2) columns of (s, xi) that the rate of each state depends on
    hull: Array  # (5,) constants: FULL, HEADING, LENGTH, SOFT, CURRENT


N_STATES = 6
"""States that stand before the parameters in a joint vector: x, y, psi, u, v, r."""

(
    U_U, VV, VR, RR, U, V, R, V_V, V_R, R_R, UR, VVR, VRR, COS, SIN, MINUS_SIN,
    UUU, UV, AU_V, AU_R, AV_R, ONE, COS_TWICE, SIN_TWICE, WIND_X, WIND_Y, WIND_N,
    ADVANCE_COS, ADVANCE_SIN, FIN_DRAG, FIN_LIFT, FIN_SIDE,
    LEFT_COS, RIGHT_COS, LEFT_SIN, RIGHT_SIN, LEFT, MINUS_RIGHT,
    MEAN_COS, MEAN_SIN, DIFFERENCE, ASTERN_RACE,
    SHAFT_COS, SHAFT_SIN, RACE_LEFT, RACE_RIGHT,
    COS_LEFT, SIN_LEFT, COS_RIGHT, SIN_RIGHT,
    _ZERO, BY_CURRENT,
) = range(52)  # fmt: skip

N_TERMS = BY_CURRENT + 6
"""Number of regressors. Those before LEFT_COS depend on the state, the rest on the actuators alone;
those before UUU, a multiple of four, are in every structure, the others of the state in ``mmg``.
The six from BY_CURRENT on are slopes by the current: north and east, in surge, sway and yaw. They
are 0 but where a model is linearised."""

FULL, HEADING, LENGTH, SOFT, CURRENT = range(5)
"""Places of the hull's constants: 1 where all regressors are computed, 1 where the heading is
needed, length (m), softening (m2/s2), index of the current's first parameter (-1 without)."""

CURRENT_SD = 0.3
CURRENT_SHARE = 0.1
"""Standard deviation of each component of the current before any data, m/s, and at most in nominal
speeds: no one sails a boat or a ship's model where the water runs as fast."""

WAKE_SQUARED = 0.4
SLIPSTREAM = 0.6
ASTERN = 0.1
"""Inflow of a rudder or drive: parts of u|u| and of (P n)|P n|, the second less astern."""

SOFT_SPEED = 0.05
"""Flow below which the inflow is softened, in nominal speeds."""

STRAIGHTENING = 0.5
LEVER = 0.71
"""Flow straightening and effective lever over length at the stern.

Source: docs/explanation/twin.md, Tankers.
"""


@inlined
def thrust_terms(n_left, n_right, cos_left, sin_left, cos_right, sin_right, terms):
    """Write the terms that depend on the actuators alone.

    Parameters
    ----------
    n_left, n_right : float
        Shaft speeds in the unit of the structure.
    cos_left, sin_left, cos_right, sin_right : float
        Of the drive angles.
    terms : (N_TERMS,) array
        Those from LEFT_COS on are written.
    """
    left, right = n_left * abs(n_left), n_right * abs(n_right)
    terms[LEFT_COS], terms[RIGHT_COS] = left * cos_left, right * cos_right
    terms[LEFT_SIN], terms[RIGHT_SIN] = left * sin_left, right * sin_right
    terms[LEFT], terms[MINUS_RIGHT] = left, -right
    terms[MEAN_COS] = 0.5 * (left * cos_left + right * cos_right)
    terms[MEAN_SIN] = 0.5 * (left * sin_left + right * sin_right)
    terms[DIFFERENCE] = 0.5 * (left * cos_left - right * cos_right)
    terms[SHAFT_COS] = 0.5 * (abs(n_left) * cos_left + abs(n_right) * cos_right)
    terms[SHAFT_SIN] = 0.5 * (abs(n_left) * sin_left + abs(n_right) * sin_right)
    terms[RACE_LEFT] = (SLIPSTREAM if n_left > 0.0 else ASTERN * SLIPSTREAM) * left
    terms[RACE_RIGHT] = (SLIPSTREAM if n_right > 0.0 else ASTERN * SLIPSTREAM) * right
    terms[ASTERN_RACE] = 0.5 * (min(n_left, 0.0) ** 2 + min(n_right, 0.0) ** 2)
    terms[COS_LEFT], terms[SIN_LEFT] = cos_left, sin_left
    terms[COS_RIGHT], terms[SIN_RIGHT] = cos_right, sin_right
    for k in range(_ZERO, N_TERMS):
        terms[k] = 0.0


@inlined
def current_of(xi, first, hull):
    """Return the velocity of the water to north and east, m/s, from (first + p,) parameters."""
    at = int(hull[CURRENT])
    if at < 0:
        return 0.0, 0.0
    return xi[first + at], xi[first + at + 1]


@inlined
def through_water(velocity, heading, wind, current):
    """Return velocities through the water, wind over it, and the current ahead and to starboard.

    Parameters
    ----------
    velocity, heading : tuple of float
        u, v over the ground, m/s; cosine and sine of the heading.
    wind, current : (2,) array, tuple of float
        To north and east, m/s. Zeros are a wind that is not known.

    Source: Fossen 2021, 10.3: an even current turns with the boat, and adds no force of its own.
    """
    c, s = heading
    north, east = current
    ahead, aside = north * c + east * s, east * c - north * s
    over = (0.0, 0.0)
    if wind[0] != 0.0 or wind[1] != 0.0:
        over = wind[0] - north, wind[1] - east
    return (velocity[0] - ahead, velocity[1] - aside), over, (ahead, aside)


@inlined
def nominal_speed(hull):
    """Return the boat's nominal speed, m/s, from the constants of its structure."""
    return math.sqrt(hull[SOFT]) / SOFT_SPEED


@inlined
def inflow(u, race, soft):
    """Return the flow along the keel at a rudder or drive, m/s, and its slope in u."""
    square = WAKE_SQUARED * u * abs(u) + race
    size = abs(square) + soft
    root = math.sqrt(size)
    return square / root, 2.0 * WAKE_SQUARED * abs(u) * (size - 0.5 * abs(square)) / (size * root)


@inlined
def _fin(u, aside, k, hull, terms):
    """Return half of drag, lift and side force of the left (0) or right (1) rudder or drive."""
    along = inflow(u, terms[RACE_LEFT + k], hull[SOFT])[0]
    c, s = terms[COS_LEFT + 2 * k], terms[SIN_LEFT + 2 * k]
    speed = math.sqrt(along * along + aside * aside)
    normal = speed * (s * along - c * aside)
    return 0.5 * s * normal, 0.5 * c * normal, 0.5 * c * speed * c * abs(aside)


@inlined
def state_terms(u, v, r, cos_psi, sin_psi, wind, hull, terms):
    """Write the terms that depend on the state; those of the actuators must be there.

    u, v, r are velocities through the water. ``wind`` (2,) is that over the water to north and
    east, m/s, zeros where it is not known. ``hull`` (5,) are the constants of the structure.
    """
    terms[U_U], terms[VV], terms[VR], terms[RR] = u * abs(u), v * v, v * r, r * r
    terms[U], terms[V], terms[R] = u, v, r
    terms[V_V], terms[V_R], terms[R_R], terms[UR] = v * abs(v), v * abs(r), r * abs(r), u * r
    terms[VVR], terms[VRR] = v * v * r, v * r * r
    terms[COS], terms[SIN], terms[MINUS_SIN] = cos_psi, sin_psi, -sin_psi
    if hull[FULL] == 0.0:
        return
    terms[UUU] = u * u * u
    terms[UV], terms[AU_V], terms[AU_R], terms[AV_R] = u * v, abs(u) * v, abs(u) * r, abs(v) * r
    terms[ONE] = 1.0
    terms[COS_TWICE] = cos_psi * cos_psi - sin_psi * sin_psi
    terms[SIN_TWICE] = 2.0 * sin_psi * cos_psi
    terms[WIND_X] = terms[WIND_Y] = terms[WIND_N] = 0.0
    if wind[0] != 0.0 or wind[1] != 0.0:
        ahead = wind[0] * cos_psi + wind[1] * sin_psi - u
        aside = wind[1] * cos_psi - wind[0] * sin_psi - v
        speed = math.sqrt(ahead * ahead + aside * aside)
        terms[WIND_X], terms[WIND_Y], terms[WIND_N] = speed * ahead, speed * aside, ahead * aside
    terms[ADVANCE_COS], terms[ADVANCE_SIN] = u * terms[SHAFT_COS], u * terms[SHAFT_SIN]
    aside = STRAIGHTENING * (LEVER * hull[LENGTH] * r - v)
    drag, lift, side = _fin(u, aside, 0, hull, terms)
    same = terms[RACE_RIGHT] == terms[RACE_LEFT]
    same = same and terms[COS_RIGHT] == terms[COS_LEFT] and terms[SIN_RIGHT] == terms[SIN_LEFT]
    if same:  # the common case
        drag, lift, side = drag + drag, lift + lift, side + side
    else:
        more = _fin(u, aside, 1, hull, terms)
        drag, lift, side = drag + more[0], lift + more[1], side + more[2]
    terms[FIN_DRAG], terms[FIN_LIFT], terms[FIN_SIDE] = drag, lift, side


_SHIP = (WIND_X, WIND_Y, WIND_N, FIN_DRAG, FIN_LIFT, FIN_SIDE)

BY_U = np.array([U_U, UUU, U, UR, UV, AU_V, AU_R, ADVANCE_COS, ADVANCE_SIN, *_SHIP])

BY_V = np.array([VV, VR, V, V_V, V_R, VVR, VRR, UV, AU_V, AV_R, *_SHIP])

BY_R = np.array([VR, RR, R, V_R, R_R, UR, VVR, VRR, AU_R, AV_R, *_SHIP[3:]])

BY_PSI = np.array([COS, SIN, MINUS_SIN, COS_TWICE, SIN_TWICE, WIND_X, WIND_Y, WIND_N])
"""Terms that change with u, v, r and psi: those whose slopes :func:`term_slopes` writes."""


@kernel
def term_slopes(velocity, heading, wind, hull, terms, slopes):
    """Write the derivatives of the state's terms by u, v, r and psi.

    Parameters
    ----------
    velocity, heading : tuple of float
        u, v (m/s), r (rad/s); cosine and sine of the heading.
    wind, hull
        See :func:`state_terms`.
    terms : (N_TERMS,) array
        As :func:`state_terms` left it.
    slopes : (4, N_TERMS) array
        Written where a derivative is not always 0; hand in zeros.
    """
    u, v, r = velocity
    cos_psi, sin_psi = heading
    slopes[0, U_U], slopes[1, VV] = 2.0 * abs(u), 2.0 * v
    slopes[1, VR], slopes[2, VR], slopes[2, RR] = r, v, 2.0 * r
    slopes[0, U], slopes[1, V], slopes[2, R] = 1.0, 1.0, 1.0
    slopes[1, V_V], slopes[2, R_R] = 2.0 * abs(v), 2.0 * abs(r)
    slopes[1, V_R], slopes[2, V_R] = abs(r), math.copysign(v, v * r)
    slopes[0, UR], slopes[2, UR] = r, u
    slopes[1, VVR], slopes[2, VVR] = 2.0 * v * r, v * v
    slopes[1, VRR], slopes[2, VRR] = r * r, 2.0 * v * r
    slopes[3, COS], slopes[3, SIN], slopes[3, MINUS_SIN] = -sin_psi, cos_psi, -cos_psi
    if hull[FULL] == 0.0:
        return
    slopes[0, UUU] = 3.0 * u * u
    slopes[0, UV], slopes[1, UV] = v, u
    slopes[0, AU_V], slopes[1, AU_V] = math.copysign(v, u * v), abs(u)
    slopes[0, AU_R], slopes[2, AU_R] = math.copysign(r, u * r), abs(u)
    slopes[1, AV_R], slopes[2, AV_R] = math.copysign(r, v * r), abs(v)
    slopes[3, COS_TWICE], slopes[3, SIN_TWICE] = -2.0 * terms[SIN_TWICE], 2.0 * terms[COS_TWICE]
    for i in range(4):
        slopes[i, WIND_X] = slopes[i, WIND_Y] = slopes[i, WIND_N] = 0.0
    if wind[0] != 0.0 or wind[1] != 0.0:
        forth = wind[0] * cos_psi + wind[1] * sin_psi
        across = wind[1] * cos_psi - wind[0] * sin_psi
        ahead, aside = forth - u, across - v
        speed = max(math.sqrt(ahead * ahead + aside * aside), 1e-9)
        xx, xy = speed + ahead * ahead / speed, ahead * aside / speed
        yy = speed + aside * aside / speed
        slopes[0, WIND_X], slopes[1, WIND_X] = -xx, -xy
        slopes[0, WIND_Y], slopes[1, WIND_Y] = -xy, -yy
        slopes[0, WIND_N], slopes[1, WIND_N] = -aside, -ahead
        # turning the boat turns the wind the other way
        slopes[3, WIND_X] = xx * across - xy * forth
        slopes[3, WIND_Y] = xy * across - yy * forth
        slopes[3, WIND_N] = aside * across - ahead * forth
    slopes[0, ADVANCE_COS], slopes[0, ADVANCE_SIN] = terms[SHAFT_COS], terms[SHAFT_SIN]
    turn = STRAIGHTENING * LEVER * hull[LENGTH]
    aside = turn * r - STRAIGHTENING * v
    for i in range(3):
        slopes[i, FIN_DRAG] = slopes[i, FIN_LIFT] = slopes[i, FIN_SIDE] = 0.0
    for k in range(2):
        along, steep = inflow(u, terms[RACE_LEFT + k], hull[SOFT])
        c, s = terms[COS_LEFT + 2 * k], terms[SIN_LEFT + 2 * k]
        speed = max(math.sqrt(along * along + aside * aside), 1e-9)
        attack = s * along - c * aside
        by_along = along / speed * attack + speed * s
        by_aside = aside / speed * attack - speed * c
        side_along = along / speed * c * abs(aside)
        side_aside = math.copysign(aside / speed * aside + speed, aside) * c
        for i in range(3):
            inner = steep if i == 0 else (-STRAIGHTENING if i == 1 else turn)
            slope = (by_along if i == 0 else by_aside) * inner
            slopes[i, FIN_DRAG] += 0.5 * s * slope
            slopes[i, FIN_LIFT] += 0.5 * c * slope
            slopes[i, FIN_SIDE] += 0.5 * c * (side_along if i == 0 else side_aside) * inner


@inlined
def accelerations(terms, model, xi, first):
    """Return the three accelerations from terms and parameters.

    Parameters
    ----------
    terms : (N_TERMS,) array
        All terms.
    model : ModelTerms
        Of the structure.
    xi : (first + p,) array
        Parameters, from entry ``first`` on.
    first : int
        0, or the number of states if these stand before the parameters.

    Returns
    -------
    tuple of 3 floats
        du/dt, dv/dt in m/s2 and dr/dt in rad/s2.

    Source: Eq (20), (23).
    """
    return (
        _sum(0, terms, model, xi, first),
        _sum(1, terms, model, xi, first),
        _sum(2, terms, model, xi, first),
    )


@inlined
def _sum(i, terms, model, xi, first):
    """Return one of :func:`accelerations`."""
    which, limits = model.which, model.limits
    low, high = limits[3 + i, 0] - N_STATES, limits[3 + i, 1] - N_STATES
    term, factor = which[i, low:high], xi[first + low :]
    total = 0.0
    for k in range(high - low):
        total += terms[term[k]] * factor[k]
    return total


@kernel
def gather(model, xi, shares):
    """Write what each term adds to the accelerations, for many calls of :func:`rates`.

    Parameters
    ----------
    model : ModelTerms
        Of the structure.
    xi : (p,) array
        Parameters.
    shares : (N_TERMS, 4) array
        Coefficients of the terms in du/dt, dv/dt, dr/dt; the fourth fills up.
    """
    which, limits = model.which, model.limits
    shares[:] = 0.0
    for i in range(3):
        for k in range(limits[3 + i, 0] - N_STATES, limits[3 + i, 1] - N_STATES):
            shares[which[i, k], i] += xi[k]


@kernel
def thrust_rates(terms, shares, out):
    """Write the three accelerations (3,) that the actuators give, whatever the state.

    Not fused: what left and right do against each other cancels to the last bit.
    """
    for i in range(3):
        out[i] = 0.0
    for k in range(LEFT_COS, SHAFT_COS):
        for i in range(3):
            out[i] += shares[k, i] * terms[k]


@inlined
def _three_sums(first, factors, rows):
    """Return the sums over k < UUU of ``factors[k] * rows[k, :3]``, begun with ``first`` (3,).

    Every fourth term goes into a sum of its own, so that they need not wait for each other.
    """
    a0, a1, a2 = first[0], first[1], first[2]
    b0 = b1 = b2 = c0 = c1 = c2 = d0 = d1 = d2 = 0.0
    for k in range(0, UUU, 4):
        x, y, z, w = factors[k], factors[k + 1], factors[k + 2], factors[k + 3]
        a0, a1, a2 = fma(x, rows[k, 0], a0), fma(x, rows[k, 1], a1), fma(x, rows[k, 2], a2)
        b0 = fma(y, rows[k + 1, 0], b0)
        b1 = fma(y, rows[k + 1, 1], b1)
        b2 = fma(y, rows[k + 1, 2], b2)
        c0 = fma(z, rows[k + 2, 0], c0)
        c1 = fma(z, rows[k + 2, 1], c1)
        c2 = fma(z, rows[k + 2, 2], c2)
        d0 = fma(w, rows[k + 3, 0], d0)
        d1 = fma(w, rows[k + 3, 1], d1)
        d2 = fma(w, rows[k + 3, 2], d2)
    return (a0 + b0) + (c0 + d0), (a1 + b1) + (c1 + d1), (a2 + b2) + (c2 + d2)


@inlined
def rates(terms, shares, hull, thrust):
    """Return the three accelerations from terms, gathered parameters and :func:`thrust_rates`."""
    du, dv, dr = _three_sums(thrust, terms, shares)
    if hull[FULL] > 0.0:
        for k in range(UUU, LEFT_COS):
            du = fma(shares[k, 0], terms[k], du)
            dv = fma(shares[k, 1], terms[k], dv)
            dr = fma(shares[k, 2], terms[k], dr)
    return du, dv, dr


class StructureError(UsvTwinError):
    """A model structure that is not known; the message lists those that are."""


@dataclass(frozen=True, eq=False)
class Structure:
    """Parameters of a model, and what kernels need of them.

    Parameters
    ----------
    name : str
        One of :data:`MODELS`.
    parameters : tuple of str
        Names of the p parameters: surge, then those common to surge and sway, those of the current,
        sway, yaw.
    units : tuple of str
        Their units.
    scales : ndarray, shape (p,)
        Natural unit of each in powers of L, U and n, by which it becomes dimensionless.
    terms : ModelTerms
        Terms, limits and hull constants, for kernels.
    n_unit : float
        Shaft speeds are multiplied by this before they enter the terms.
    mean, sd : ndarray, shape (p,)
        Prior of each parameter before any data, in SI units.
    """

    name: str
    parameters: tuple[str, ...]
    units: tuple[str, ...]
    scales: Array
    terms: ModelTerms
    n_unit: float
    mean: Array
    sd: Array

    def __len__(self) -> int:
        """Return the number of parameters."""
        return len(self.parameters)

    @property
    def blocks(self) -> dict[str, tuple[int, int]]:
        """First and last + 1 of the parameters in the equations of surge, sway and yaw."""
        first = (self.terms.limits[3:] - N_STATES).tolist()
        return {name: (a, b) for name, (a, b) in zip(("surge", "sway", "yaw"), first, strict=True)}


class Term(NamedTuple):
    """A parameter of a structure, and what it multiplies in which equation."""

    name: str
    unit: str
    equation: str  # X, Y or N; E is surge and sway together, C the velocity of the water in all
    regressor: int  # U_U ... ASTERN_RACE; term_slopes has its slopes
    powers: tuple[int, int, int]  # of L, U and n in the natural unit
    mean: float  # prior mean, in natural units ...
    sd: float  # ... and its standard deviation
    group: str = ""  # by which it is left out (:func:`structure_of`), or "environment"


# Source of means: docs/explanation/twin.md, Identifiability; those of `mmg` are the same boat's at
# nominal speed.
_PAPER = (
    Term("X_uu", "1/m", "X", U_U, (-1, 0, 0), -0.1901, 0.06336),
    Term("X_vv", "1/m", "X", VV, (-1, 0, 0), -0.1521, 0.3168),
    Term("X_vr", "1/rad", "X", VR, (0, 0, 0), 1.29, 0.3),
    Term("X_rr", "m/rad2", "X", RR, (1, 0, 0), 0.0, 0.03157),
    Term("T_uL", "m/rev2", "X", LEFT_COS, (-1, 2, -2), 0.0814, 0.02612),
    Term("T_uR", "m/rev2", "X", RIGHT_COS, (-1, 2, -2), 0.0814, 0.02612),
    Term("Y_u", "1/s", "Y", U, (-1, 1, 0), 0.0, 0.01173),
    Term("Y_v", "1/s", "Y", V, (-1, 1, 0), -1.044, 0.528),
    Term("Y_r", "m/(s rad)", "Y", R, (0, 1, 0), 0.2167, 0.1481),
    Term("Y_v|v|", "1/m", "Y", V_V, (-1, 0, 0), -1.077, 1.901),
    Term("Y_v|r|", "1/rad", "Y", V_R, (0, 0, 0), 0.0, 1.0),
    Term("Y_r|r|", "m/rad2", "Y", R_R, (1, 0, 0), 0.0, 0.07891),
    Term("Y_ur", "1/rad", "Y", UR, (0, 0, 0), -0.78, 0.2),
    Term("T_vL", "m/rev2", "Y", LEFT_SIN, (-1, 2, -2), -0.1045, 0.06965),
    Term("T_vR", "m/rev2", "Y", RIGHT_SIN, (-1, 2, -2), -0.1045, 0.06965),
    Term("N_u", "rad/(m s)", "N", U, (-2, 1, 0), 0.0, 0.03717),
    Term("N_v", "rad/(m s)", "N", V, (-2, 1, 0), -2.141, 2.23),
    Term("N_r", "1/s", "N", R, (-1, 1, 0), -2.405, 1.173),
    Term("N_v|v|", "rad/m2", "N", V_V, (-2, 0, 0), 0.0, 4.014),
    Term("N_v|r|", "1/m", "N", V_R, (-1, 0, 0), 0.0, 6.336),
    Term("N_r|r|", "1/rad", "N", R_R, (0, 0, 0), -0.7, 1.0),
    Term("N_vvr", "s/m2", "N", VVR, (-1, -1, 0), -6.843, 10.26),
    Term("N_vrr", "s/(m rad)", "N", VRR, (0, -1, 0), 0.0, 2.7),
    Term("T_rL", "rad/rev2", "N", LEFT_SIN, (-2, 2, -2), 0.6068, 0.331),
    Term("T_rR", "rad/rev2", "N", RIGHT_SIN, (-2, 2, -2), 0.6068, 0.331),
)

_CURRENT = (
    Term("C_north", "m/s", "C", _ZERO, (0, 0, 0), 0.0, CURRENT_SD, "environment"),
    Term("C_east", "m/s", "C", _ZERO, (0, 0, 0), 0.0, CURRENT_SD, "environment"),
)

_BIASES = (
    Term("E_north", "m/s2", "E", COS, (-1, 2, 0), 0.0, 0.0087, "environment"),
    Term("E_east", "m/s2", "E", SIN, (-1, 2, 0), 0.0, 0.0087, "environment"),
)

_MMG = (
    Term("X_u", "1/s", "X", U, (-1, 1, 0), 0.0, 0.1),
    Term("X_u|u|", "1/m", "X", U_U, (-1, 0, 0), -0.19, 0.15),
    Term("X_uuu", "s/m2", "X", UUU, (-1, -1, 0), 0.0, 0.1),
    Term("X_vv", "1/m", "X", VV, (-1, 0, 0), -0.15, 0.3),
    Term("X_vr", "1/rad", "X", VR, (0, 0, 0), 1.29, 0.3),
    Term("X_rr", "m/rad2", "X", RR, (1, 0, 0), 0.0, 0.03),
    Term("X_nn", "1/m", "X", MEAN_COS, (-1, 0, 0), 0.38, 0.12),
    Term("X_dn", "1/m", "X", DIFFERENCE, (-1, 0, 0), 0.0, 0.04, "unequal thrusters"),
    Term("X_nu", "1/m", "X", ADVANCE_COS, (-1, 0, 0), -0.19, 0.12),
    Term("X_F", "1/m", "X", FIN_DRAG, (-1, 0, 0), -0.05, 0.1),
    Term("X_w", "1/m", "X", WIND_X, (-1, 0, 0), 0.003, 0.003),
    *_BIASES,
    Term("Y_v", "1/s", "Y", V, (-1, 1, 0), -0.2, 0.2, "at rest"),
    Term("Y_|u|v", "1/m", "Y", AU_V, (-1, 0, 0), -1.044, 0.528),
    Term("Y_ur", "1/rad", "Y", UR, (0, 0, 0), -0.56, 0.25),
    Term("Y_v|v|", "1/m", "Y", V_V, (-1, 0, 0), -1.077, 1.9),
    Term("Y_v|r|", "1/rad", "Y", V_R, (0, 0, 0), 0.0, 1.0),
    Term("Y_|v|r", "1/rad", "Y", AV_R, (0, 0, 0), 0.0, 1.0),
    Term("Y_r|r|", "m/rad2", "Y", R_R, (1, 0, 0), 0.0, 0.079),
    Term("Y_nn", "1/m", "Y", MEAN_SIN, (-1, 0, 0), -0.15, 0.12),
    Term("Y_nu", "1/m", "Y", ADVANCE_SIN, (-1, 0, 0), 0.0, 0.08),
    Term("Y_F", "1/m", "Y", FIN_LIFT, (-1, 0, 0), -0.06, 0.15),
    Term("Y_S", "1/m", "Y", FIN_SIDE, (-1, 0, 0), 0.0, 0.06, "one rudder"),
    Term("Y_w", "1/m", "Y", WIND_Y, (-1, 0, 0), 0.006, 0.006),
    Term("N_uv", "rad/m2", "N", UV, (-2, 0, 0), -1.5, 2.2),
    Term("N_r", "1/s", "N", R, (-1, 1, 0), -1.0, 1.0, "at rest"),
    Term("N_|u|r", "1/m", "N", AU_R, (-1, 0, 0), -2.4, 1.2),
    Term("N_v|v|", "rad/m2", "N", V_V, (-2, 0, 0), 0.0, 4.0),
    Term("N_v|r|", "1/m", "N", V_R, (-1, 0, 0), 0.0, 4.0),
    Term("N_|v|r", "1/m", "N", AV_R, (-1, 0, 0), -1.0, 4.0),
    Term("N_r|r|", "1/rad", "N", R_R, (0, 0, 0), -0.7, 1.0),
    Term("N_nn", "rad/m2", "N", MEAN_SIN, (-2, 0, 0), 0.8, 0.6),
    Term("N_nu", "rad/m2", "N", ADVANCE_SIN, (-2, 0, 0), 0.0, 0.4),
    Term("N_F", "rad/m2", "N", FIN_LIFT, (-2, 0, 0), 0.4, 0.8),
    Term("N_S", "rad/m2", "N", FIN_SIDE, (-2, 0, 0), 0.0, 0.3, "one rudder"),
    Term("N_dn", "rad/m2", "N", DIFFERENCE, (-2, 0, 0), 0.3, 0.2),
    Term("N_mn", "rad/m2", "N", MEAN_COS, (-2, 0, 0), 0.0, 0.01, "unequal thrusters"),
    Term("N_w", "rad/m2", "N", WIND_N, (-2, 0, 0), 0.0, 0.004),
    Term("N_0", "rad/s2", "N", ONE, (-2, 2, 0), 0.0, 0.01, "environment"),
    Term("N_cos", "rad/s2", "N", COS, (-2, 2, 0), 0.0, 0.01, "environment"),
    Term("N_sin", "rad/s2", "N", SIN, (-2, 2, 0), 0.0, 0.01, "environment"),
    Term("N_cos2", "rad/s2", "N", COS_TWICE, (-2, 2, 0), 0.0, 0.012, "environment"),
    Term("N_sin2", "rad/s2", "N", SIN_TWICE, (-2, 2, 0), 0.0, 0.012, "environment"),
)

TERMS = {"paper": _PAPER, "mmg": _MMG}
"""Terms by the name of a structure: surge, both, sway, yaw. One more is one line more."""

MODELS = tuple(TERMS)
"""Names of the structures."""

UNEQUAL_THRUSTERS = tuple(term.name for term in _MMG if term.group == "unequal thrusters")
"""What unequal thrusters do: the push by their difference, the turning by their mean."""

ENVIRONMENT = tuple(term.name for term in (*_CURRENT, *_MMG) if term.group == "environment")
"""Parameters that are those of wind, current and sea of a day."""

# A pair of fixed propellers .2 L off the middle turns a boat whose radius of gyration is .25 L. It
# has no angle, so no side force. Their thrusts are equal within 15 %.
_DIFFERENTIAL: dict[str, tuple[int, float, float]] = {
    "T_vL": (LEFT_SIN, 0.0, 0.06965),
    "T_vR": (RIGHT_SIN, 0.0, 0.06965),
    "T_rL": (LEFT, 0.24, 0.14),
    "T_rR": (MINUS_RIGHT, 0.24, 0.14),
    "Y_nn": (MEAN_SIN, 0.0, 0.1),
    "N_nn": (MEAN_SIN, 0.0, 0.1),
    "N_dn": (DIFFERENCE, 0.48, 0.28),
    "N_mn": (MEAN_COS, 0.0, 0.07),
}

# A laden ship of full form: most of it is under water. Drag of 0.3 m2 of side and 0.06 m2 of front
# for each tonne of a 3 m model. The centre of pressure is forward in a quartering wind. The race of
# a right-handed propeller that runs astern pushes its stern to port.
_TANKER: dict[str, tuple[int, float, float]] = {
    "X_w": (WIND_X, 0.0009, 0.0006),
    "Y_w": (WIND_Y, 0.002, 0.0012),
    "N_w": (WIND_N, -0.0035, 0.003),
    "N_dn": (ASTERN_RACE, 0.05, 0.05),
}


def structure_of(
    name: str,
    length: float,
    speed: float,
    shaft_speed: float,
    *,
    differential: bool = False,
    tanker: bool = False,
    biased: bool = False,
    current: bool = False,
) -> Structure:
    """Return a model structure for a boat.

    Parameters
    ----------
    name : str
        One of :data:`MODELS`.
    length, speed, shaft_speed : float
        On the waterline, m; nominal speed, m/s, and shaft speed at it, rev/s.
    differential : bool
        The boat steers by unequal thrust.
    tanker : bool
        It is a laden ship of full form, with one propeller.
    biased : bool
        Add the two earth-fixed accelerations where the structure has none.
    current : bool
        Add the velocity of the water.

    Returns
    -------
    Structure

    Raises
    ------
    StructureError
        Lists the names that there are.
    """
    if name not in TERMS:
        raise StructureError(f"no model structure is called {name!r}; known: {', '.join(MODELS)}")
    left_out = {"unequal thrusters" if tanker else "one rudder"}
    if not differential:
        # Damping of a boat that lies still and is turned on the spot, as a fixed pair of thrusters
        # does. It was measured on the Otter (yaw: 1 /s), Clearpath's Heron and the WAM-V 16 (sway
        # .2 to .4, yaw .8 to 1.3 nominal speeds over length). Source: Fossen 2021, 10.3 (Otter);
        # the simulators of Heron and VRX for the others.
        left_out.add("at rest")
    terms = [term for term in TERMS[name] if term.group not in left_out]
    sway = next(i for i, term in enumerate(terms) if term.equation == "Y")
    terms[sway:sway] = (
        *(_BIASES if biased and _BIASES[0] not in terms else ()),
        *(_CURRENT if current else ()),
    )
    special = _DIFFERENTIAL if differential else _TANKER if tanker else {}
    for k, term in enumerate(terms):
        if term.name in special:
            regressor, mean, sd = special[term.name]
            terms[k] = term._replace(regressor=regressor, mean=mean, sd=sd)
    equations = [term.equation for term in terms]
    limits = np.full((N_STATES, 2), N_STATES, dtype=np.int64)
    which = np.full((3, len(terms)), _ZERO, dtype=np.uint64)
    for i, members in enumerate(("XEC", "ECY", "CN")):
        columns = [k for k, equation in enumerate(equations) if equation in members]
        limits[3 + i] += (columns[0], columns[-1] + 1)
        which[i, columns] = [terms[k].regressor for k in columns]
        if current:
            at = equations.index("C")
            which[i, at : at + 2] = BY_CURRENT + 2 * i, BY_CURRENT + 2 * i + 1
    for k, term in enumerate(terms):
        if term.equation == "E":  # east and north as seen to starboard
            which[1, k] = MINUS_SIN if term.regressor == COS else COS
    mixed = name == "mmg"
    heading = float("E" in equations or mixed or current)
    water = float(equations.index("C")) if current else -1.0
    natural = np.array([length, speed, shaft_speed])
    scales = np.prod(natural ** np.array([term.powers for term in terms], float), axis=1)
    sd = scales * np.array([term.sd for term in terms])
    sd[np.array(equations) == "C"] = min(CURRENT_SD, CURRENT_SHARE * speed)
    return Structure(
        name=name,
        parameters=tuple(term.name for term in terms),
        units=tuple(term.unit for term in terms),
        scales=scales,
        terms=ModelTerms(
            which,
            limits,
            np.array([float(mixed), heading, length, (SOFT_SPEED * speed) ** 2, water]),
        ),
        # in `mmg` a shaft speed is the boat's speed that it gives in calm water
        n_unit=speed / shaft_speed if mixed else 1.0,
        mean=scales * np.array([term.mean for term in terms]),
        sd=sd,
    )
