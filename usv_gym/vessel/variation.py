"""Boats of one kind that differ: how they are drawn, and which are kept.

The law is that of :meth:`usv_gym.Vessel.varied`. A drawn boat is checked in compiled code, so that
an environment can draw one at every reset.
"""

from __future__ import annotations

import math
from collections import namedtuple
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from usv_gym.physics import frames as fr
from usv_gym.physics import parameters as par
from usv_gym.physics import ship
from usv_gym.physics.hull import hull_forces
from usv_gym.physics.propulsion import propulsion_forces
from usv_gym.physics.waves import FACTOR_ROWS, LOAD_ROWS, WAVE_ROWS
from usv_gym.physics.weather import WEATHER, constant
from usv_kernel.arrays import shaped
from usv_kernel.jit import inlined, kernel
from usv_kernel.random import borrowed_stream, fill_normal
from usv_kernel.records import Record, as_record, field_at, record_size

__all__ = [
    "FACTORS",
    "FIXED",
    "LAW",
    "NO_SPEED",
    "SHAFT_SPEEDS",
    "SIDES_AT",
    "TRIES",
    "Factors",
    "draw",
    "draw_boat",
    "law_of",
    "scratch_of_draws",
]

Array = NDArray[np.float64]

# fmt: off
_GEOMETRY = frozenset((
    "length_waterline", "beam", "draft", "block_coefficient", "mass", "x_G", "KG", "I_xx", "I_yy",
    "I_zz", "x_F", "GM_T", "GM_L", "propeller_diameter", "x_P", "y_P", "z_P", "A_R",
    "rudder_height", "x_P_prime", "x_R_prime", "A_F", "A_L", "s_L", "s_H",
))
"""Geometry and inertia; they vary less than coefficients, see :meth:`Vessel.varied`."""

FIXED = frozenset((
    "kind", "water_density", "units", "shaft_lag", "shaft_rate", "shaft_speed_max",
    "shaft_speed_service", "shaft_speed_manoeuvring", "steer_lag", "steer_rate", "steer_max",
))
"""Water, engines and steering gear: equal in all boats of a kind."""

_LOADED = ("mass", "I_xx", "I_yy", "I_zz", "draft", "m_x", "m_y", "m_z", "J_xx", "J_yy", "J_zz")
"""What grows with the load; the sides of the hull are taken as vertical."""
# fmt: on

FACTORS = (*par.SCALARS, "resistance_force", "resistance_speed", "thrust_left", "thrust_right")
"""What the factors of a drawn boat multiply, see :class:`usv_gym.vessel.vessel.DrawnBoat`."""

Factors = namedtuple("Factors", FACTORS)  # type: ignore[misc]
"""The same by name: ``factors.mass``."""

SHAFT_SPEEDS = ("shaft_speed_manoeuvring", "shaft_speed_service", "shaft_speed_max")

TRIES = 1000
"""Boats that are drawn at most."""

SPEED_FACTOR = 4.0 / 3.0
"""Largest ratio of speeds between boats of a kind."""

_N_SCALARS = len(par.SCALARS)

_LENGTH, _OVERALL, _BEAM, _PLANE = (
    par.SCALARS.index(key) for key in ("length_waterline", "length_overall", "beam", "A_wp")
)

_LOAD_AT = tuple(par.SCALARS.index(key) for key in _LOADED)

_SPEEDS_AT, _FORCES_AT, SIDES_AT = (
    slice(field_at(par.PARAMETERS, key), field_at(par.PARAMETERS, key) + size)
    for key, size in (
        ("resistance_speed", par.RESISTANCE_POINTS),
        ("resistance_force", par.RESISTANCE_POINTS),
        ("side_thrust", 2),
    )
)

_STEP = 1e-6
"""Of the central differences."""

_SPEED_ERROR = 1e-10
"""Error of a steady speed, m/s."""

_WEATHER_SIZE = record_size(WEATHER)


def scratch_of_draws() -> Array:
    """Return the scratch of :func:`draw_boat`: calm weather, and rows to work in."""
    scratch = np.zeros(_WEATHER_SIZE + ship.WORK_ROWS * fr.STATE_SIZE)
    scratch[:_WEATHER_SIZE] = np.array([constant()]).view(float)
    return scratch


@kernel
def _surplus(u: float, p: Record, state: np.ndarray) -> float:
    """Return the thrust left over at a speed (m/s) straight ahead, N."""
    return propulsion_forces(u, 0.0, 0.0, state, p)[0] + hull_forces(u, 0.0, 0.0, p)[0]


@kernel
def steady_speed(n: float, p: Record, state: np.ndarray) -> float:
    """Return the steady speed (m/s) straight ahead in calm water, or -1 if there is none.

    ``n`` is the speed of all shafts, rev/s; ``state`` (16,) is scratch. By false position with
    halved weights (Illinois).
    """
    for i in range(fr.STATE_SIZE):
        state[i] = 0.0
    state[fr.N_LEFT] = state[fr.N_RIGHT] = n
    low, high = 0.0, 4.0 * n * p.propeller_diameter + 1.0
    f_low, f_high = _surplus(low, p, state), _surplus(high, p, state)
    while f_high > 0.0 and high < 200.0:
        high *= 2.0
        f_high = _surplus(high, p, state)
    if not (f_low > 0.0 and f_high < 0.0):
        return -1.0
    side = 0
    for _ in range(200):
        u = (low * f_high - high * f_low) / (f_high - f_low)
        f = _surplus(u, p, state)
        if high - low < _SPEED_ERROR or f == 0.0:
            return u
        moved = min(u - low, high - u)
        if f > 0.0:
            low, f_low = u, f
            f_high *= 0.5 if side == 1 else 1.0
            side = 1
        else:
            high, f_high = u, f
            f_low *= 0.5 if side == -1 else 1.0
            side = -1
        if moved < 0.1 * _SPEED_ERROR:
            return u
    return 0.5 * (low + high)


@kernel
def _growth(n: float, speed: float, p: Record, scratch: np.ndarray) -> float:
    """Return the growth rate of drift and turning on a straight course in a calm sea, 1/s."""
    work = shaped(scratch, _WEATHER_SIZE, (ship.WORK_ROWS, fr.STATE_SIZE))
    state, trial, out = work[0], work[1], work[2]
    boat, air = ship.Ship(p, 3), ship.Air(0.0, 0.0, 1.0)
    loads, factors = shaped(scratch, 0, (0, LOAD_ROWS, 0)), shaped(scratch, 0, (FACTOR_ROWS, 0))
    waves, gusts = shaped(scratch, 0, (WAVE_ROWS, 0)), shaped(scratch, 0, (3, 0))
    sea = ship.Sea(waves, gusts, as_record(scratch, WEATHER), factors, loads)
    for i in range(fr.STATE_SIZE):
        state[i] = 0.0
    state[fr.U] = speed
    state[fr.N_LEFT] = state[fr.N_RIGHT] = n
    cmd = state[fr.N_LEFT :]
    slopes_v, slopes_r = (0.0, 0.0), (0.0, 0.0)
    for j in range(2):
        row = fr.V if j == 0 else fr.R
        for i in range(fr.STATE_SIZE):
            trial[i] = state[i]
        trial[row] = _STEP
        ship.derivative(trial, cmd, boat, sea, air, 0.0, out)
        v, r = out[fr.V], out[fr.R]
        trial[row] = -_STEP
        ship.derivative(trial, cmd, boat, sea, air, 0.0, out)
        slope = (v - out[fr.V]) / (2.0 * _STEP), (r - out[fr.R]) / (2.0 * _STEP)
        if j == 0:
            slopes_v = slope
        else:
            slopes_r = slope
    half = 0.5 * (slopes_v[0] + slopes_r[1])
    determinant = slopes_v[0] * slopes_r[1] - slopes_v[1] * slopes_r[0]
    return half + math.sqrt(max(half * half - determinant, 0.0))


@kernel
def drift_growth(p: Record, shafts: np.ndarray, scratch: np.ndarray) -> float:
    """Return the largest growth rate of drift over shaft speeds, per ship length; inf: no speed."""
    most = -math.inf
    for k in range(shafts.shape[0]):
        speed = steady_speed(shafts[k], p, scratch[_WEATHER_SIZE:])
        if not speed > 0.0:
            return math.inf
        most = max(most, _growth(shafts[k], speed, p, scratch) * p.length_waterline / speed)
    return most


LAW = np.dtype(
    [
        # standard deviation of each factor but for those of the sides; negative: it stays 1
        ("sd", float, _N_SCALARS + 2),
        ("sides", float),  # standard deviation of the factor of each side's thrust
        ("nominal", float, record_size(par.PARAMETERS)),  # flat parameters of the nominal boat
        # shaft speeds at which it is to keep its course, rev/s; the first is that of its speed
        ("shafts", float, len(SHAFT_SPEEDS)),
        ("speed", float),  # of the nominal boat, m/s
        ("growth", float),  # largest growth rate of drift
        ("varies", float),  # 1 if the coefficients are drawn
    ]
)
"""How the boats of a kind are drawn and checked."""

NO_BOAT = -1.0
NO_SPEED = -2.0
"""What stands in place of the speed: no boat was found, or its load leaves it none."""


@inlined
def _clipped(factor):
    """Return a factor from 0.1 to 1.9."""
    return min(max(factor, 0.1), 1.9)


@kernel
def _fill(factors: np.ndarray, law: Record, flat: np.ndarray) -> None:
    """Write flat parameters: the nominal ones times factors."""
    nominal = law.nominal
    for i in range(_N_SCALARS):
        flat[i] = nominal[i] * factors[i]
    for i in range(par.RESISTANCE_POINTS):
        speed, force = _SPEEDS_AT.start + i, _FORCES_AT.start + i
        flat[speed] = nominal[speed] * factors[_N_SCALARS + 1]
        flat[force] = nominal[force] * factors[_N_SCALARS]
    for i in range(2):
        side = SIDES_AT.start + i
        flat[side] = (1.0 + nominal[side]) * factors[_N_SCALARS + 2 + i] - 1.0


@kernel
def _try(law: Record, factors: np.ndarray, flat: np.ndarray, scratch: np.ndarray) -> float:
    """Write flat parameters of a boat, and return its speed, or NO_BOAT: draw it again.

    ``factors`` begin with standard normal numbers, and become the factors.
    """
    for i in range(_N_SCALARS + 2):
        normal = factors[i]
        factors[i] = _clipped(1.0 + law.sd[i] * normal) if law.sd[i] >= 0.0 else 1.0
    factors[_OVERALL] = factors[_LENGTH]
    factors[_PLANE] = factors[_LENGTH] * factors[_BEAM]
    _fill(factors, law, flat)
    p = as_record(flat, par.PARAMETERS)
    volume = p.block_coefficient * p.length_waterline * p.beam * p.draft
    ratio = volume * p.water_density / p.mass
    if not (ratio > 0.8 and ratio < 1.25 and p.wake_fraction < 1.0 and p.thrust_deduction < 1.0):
        return NO_BOAT
    speed = steady_speed(law.shafts[0], p, scratch[_WEATHER_SIZE:])
    ratio = speed / law.speed
    if not (ratio >= 1.0 / SPEED_FACTOR and ratio <= SPEED_FACTOR):
        return NO_BOAT
    return speed if drift_growth(p, law.shafts[:], scratch) <= law.growth else NO_BOAT


@kernel
def _finish(
    load: float, law: Record, factors: np.ndarray, flat: np.ndarray, scratch: np.ndarray
) -> float:
    """Draw the thrust of the sides, load the boat, and return its speed, or NO_SPEED.

    The factors of the sides are standard normal numbers, if they vary.
    """
    if law.sides > 0.0:
        for i in range(_N_SCALARS + 2, len(FACTORS)):
            factors[i] = _clipped(1.0 + law.sides * factors[i])
    for i in _LOAD_AT:
        factors[i] *= load
    _fill(factors, law, flat)
    p = as_record(flat, par.PARAMETERS)
    speed = steady_speed(law.shafts[0], p, scratch[_WEATHER_SIZE:])
    return speed if speed > 0.0 else NO_SPEED


@kernel
def draw_boat(
    stream: np.ndarray,
    load: float,
    law: Record,
    factors: np.ndarray,
    flat: np.ndarray,
    scratch: np.ndarray,
) -> float:
    """Draw a boat of a kind as :meth:`BoatClass.draw` does, and return its speed, m/s.

    ``factors`` of :data:`FACTORS` and ``flat`` parameters are written. NO_BOAT, NO_SPEED: there is
    none.
    """
    speed = law.speed
    factors[:] = 1.0
    if law.varies > 0.0:
        for _ in range(TRIES):
            fill_normal(stream, factors[: _N_SCALARS + 2])
            speed = _try(law, factors, flat, scratch)
            if speed > 0.0:
                break
        if not speed > 0.0:
            return NO_BOAT
    if law.sides > 0.0:
        fill_normal(stream, factors[_N_SCALARS + 2 :])
    if law.sides > 0.0 or load != 1.0:
        return _finish(load, law, factors, flat, scratch)
    if law.varies == 0.0:
        for k in range(flat.shape[0]):
            flat[k] = law.nominal[k]
    return speed


@kernel
def _drift(flat: np.ndarray, shafts: np.ndarray, scratch: np.ndarray) -> float:
    """Do :func:`drift_growth` on flat memory."""
    return drift_growth(as_record(flat, par.PARAMETERS), shafts, scratch)


@kernel
def _draw_flat(
    stream: np.ndarray, load: float, law: np.ndarray, out: tuple[np.ndarray, ...]
) -> float:
    """Do :func:`draw_boat` on flat memory; ``out`` are its last three arguments."""
    return draw_boat(stream, load, as_record(law, LAW), out[0], out[1], out[2])


def law_of(
    values: Mapping[str, float],
    nominal: Array,
    speed: float,
    spread: float,
    built: float,
    sides: float,
) -> Array:
    """Return flat memory of :data:`LAW` for boats like one with these values, for kernels.

    Parameters
    ----------
    values : Mapping[str, float]
        Numbers of the nominal boat, SI units.
    nominal : ndarray
        Its flat parameters.
    speed : float
        Its steady speed at the manoeuvring shaft speed, m/s.
    spread, built, sides : float
        Standard deviations of the factors of coefficients, of geometry and inertia, and of the
        thrust of each side.
    """
    record = np.zeros(1, LAW)
    law = record[0]
    law["sd"] = [built if key in _GEOMETRY else spread for key in par.SCALARS] + [spread, built]
    # numbers that a vessel lacks are filled in for kernels, and stay as they are
    for i, key in enumerate(par.SCALARS):
        if key not in values or key in FIXED:
            law["sd"][i] = -1.0
    law["sides"] = sides if values["units"] == 2.0 else 0.0
    law["nominal"], law["speed"] = nominal, speed
    law["shafts"] = shafts = np.array([values[key] for key in SHAFT_SPEEDS])
    law["varies"] = varies = spread + built > 0.0
    law["growth"] = max(_drift(nominal, shafts, scratch_of_draws()), 0.0) if varies else 0.0
    return record.view(float)


def draw(rng: np.random.Generator, load: float, law: Array) -> tuple[float, Array, Array]:
    """Return speed, factors and flat parameters of a boat, see :func:`draw_boat`."""
    factors, flat = np.ones(len(FACTORS)), np.zeros(record_size(par.PARAMETERS))
    with borrowed_stream(rng) as stream:
        speed = _draw_flat(stream, load, law, (factors, flat, scratch_of_draws()))
    return speed, factors, flat


assert record_size(par.PARAMETERS) == SIDES_AT.stop
