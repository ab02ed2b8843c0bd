"""Motions in waves by linear frequency-domain theory, and what a ship in time takes from them.

The ship in time has constant added masses and dampings: those of a table at the natural frequency
of each mode. A table's own change with frequency. In a wave of one frequency the difference is a
load that goes with the motion. :func:`equivalent_loads` adds it to the excitation, so that at rest
the ship in time moves as the table says.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from usv_gym.hydro.table import Array, Complex, HydroError, HydroTable
from usv_gym.physics import GRAVITY

__all__ = [
    "Frequencies",
    "Matrices",
    "equivalent_loads",
    "natural_frequencies",
    "natural_values",
    "response",
    "ship_matrices",
]

SURGE, SWAY, HEAVE, ROLL, PITCH, YAW = range(6)

_FREE = [SWAY, YAW]  # what moves along with roll

_GRID = 600  # frequencies in the search for natural ones


class Matrices(NamedTuple):
    """A ship at rest, linear: matrices (6, 6) about the origin, SI units."""

    body: Array
    """Mass and inertia of the boat itself."""
    added_mass: Array
    damping: Array
    """Of radiated waves."""
    viscous: Array
    """Damping beyond that."""
    stiffness: Array

    def impedance(self, omega: Array) -> Complex:
        """Return (n, 6, 6): load amplitude over motion amplitude at frequencies (n,), rad/s."""
        w = np.asarray(omega, dtype=float)[:, None, None]
        damping = self.damping + self.viscous
        return np.asarray(self.stiffness - w**2 * (self.body + self.added_mass) - 1j * w * damping)


def ship_matrices(v: Mapping[str, float]) -> Matrices:
    """Return the matrices of the ship in time from a vessel's numbers, SI units.

    They are those of :func:`usv_gym.physics.rigid_body.accelerate_6`, and of restoring and damping
    in :mod:`usv_gym.physics.hull`, for small motions at rest. Linear drag of sway and yaw
    (``D_v``, ``D_r``) is left out.
    """
    m, x_G, z_G, x_F, z_H = v["mass"], v["x_G"], v["draft"] - v["KG"], v["x_F"], v["z_H"]
    body = np.diag(
        [
            *[m] * 3,
            v["I_xx"] + m * z_G**2,
            v["I_yy"] + m * (x_G**2 + z_G**2),
            v["I_zz"] + m * x_G**2,
        ]
    )
    _couple(body, {(0, 4): m * z_G, (1, 3): -m * z_G, (1, 5): m * x_G})
    _couple(body, {(2, 4): -m * x_G, (3, 5): -m * x_G * z_G})
    m_x, m_y, m_z = v["m_x"], v["m_y"], v["m_z"]
    added = np.diag(
        [
            *(m_x, m_y, m_z, v["J_xx"] + m_y * z_H**2),
            v["J_yy"] + m_z * x_F**2 + m_x * z_H**2,
            v["J_zz"],
        ]
    )
    _couple(added, {(0, 4): m_x * z_H, (1, 3): -m_y * z_H, (2, 4): -m_z * x_F})
    C_33, C_44, C_55 = _stiffness(v)
    stiffness = np.diag([0.0, 0.0, C_33, C_44, C_55 + C_33 * x_F**2, 0.0])
    _couple(stiffness, {(2, 4): -C_33 * x_F})
    B_33 = 2.0 * v["zeta_heave"] * np.sqrt(C_33 * (m + m_z))
    B_44 = 2.0 * np.sqrt(C_44 * (v["I_xx"] + v["J_xx"]))
    B_55 = 2.0 * v["zeta_pitch"] * np.sqrt(C_55 * (v["I_yy"] + v["J_yy"]))
    zeta = v.get("zeta_roll_viscous", 0.0)
    damping = np.diag([0.0, 0.0, B_33, (v["zeta_roll"] - zeta) * B_44, B_55 + B_33 * x_F**2, 0.0])
    _couple(damping, {(2, 4): -B_33 * x_F})
    return Matrices(body, added, damping, np.diag([0.0, 0, 0, zeta * B_44, 0, 0]), stiffness)


def _couple(matrix: Array, entries: Mapping[tuple[int, int], float]) -> None:
    for (i, j), value in entries.items():
        matrix[i, j] = matrix[j, i] = value


def _stiffness(v: Mapping[str, float]) -> tuple[float, float, float]:
    """Return the restoring coefficients of heave, roll and pitch about the water plane's centre."""
    weight = v["mass"] * GRAVITY
    return v["water_density"] * GRAVITY * v["A_wp"], weight * v["GM_T"], weight * v["GM_L"]


def natural_values(table: HydroTable, values: Mapping[str, float]) -> dict[str, float]:
    """Return what a table says of a vessel's heave, roll and pitch, by key of the vessel file.

    They are the water plane and GM of its hull if it has them, then added masses and dampings at
    the natural frequency of each mode. Those of pitch are about the centre of the water plane.
    Those of roll make the ship's roll, with sway and yaw free, oscillate as the table's.
    """
    static = {}
    if table.hydrostatics is not None:
        static = dict(zip(("A_wp", "x_F", "GM_T", "GM_L"), table.hydrostatics, strict=True))
    v = {**values, **static}
    at = natural_frequencies(table, v)
    C_33, C_44, C_55 = _stiffness(v)
    m, x_F = v["mass"], v["x_F"]
    of_heave, of_pitch = (_about(x_F, *table.at(omega)) for omega in (at.heave, at.pitch))
    m_z, B_33 = (float(matrix[0, 2, 2]) for matrix in of_heave)
    J_yy, B_55 = (float(matrix[0, 4, 4]) for matrix in of_pitch)

    zeta = v.get("zeta_roll_viscous", 0.0)
    v |= {"m_z": m_z, "J_yy": J_yy, "J_xx": 0.0, "zeta_roll": zeta}
    w = np.array([at.roll])
    ours = ship_matrices(v)
    alone = ours.stiffness - w[:, None, None] ** 2 * (ours.body + ours.added_mass)
    difference = complex(
        (_roll_alone(alone.astype(complex)) - _roll_alone(_of_table(table, v, w)))[0]
    )
    J_xx = max(difference.real / at.roll**2, 0.0)
    B_44 = max(difference.imag / at.roll, 0.0)
    return {
        **static,
        "m_z": m_z,
        "J_xx": J_xx,
        "J_yy": J_yy,
        "zeta_heave": B_33 / (2.0 * math.sqrt(C_33 * (m + m_z))),
        "zeta_roll": B_44 / (2.0 * math.sqrt(C_44 * (v["I_xx"] + J_xx))) + zeta,
        "zeta_pitch": B_55 / (2.0 * math.sqrt(C_55 * (v["I_yy"] + J_yy))),
    }


class Frequencies(NamedTuple):
    """Natural frequencies without damping, rad/s."""

    heave: float
    roll: float
    pitch: float


def natural_frequencies(table: HydroTable, values: Mapping[str, float]) -> Frequencies:
    """Return where inertia, with the added mass of each frequency, and restoring are equal.

    Heave and pitch are about the centre of the water plane and by themselves, roll has sway and
    yaw free. ``values`` are the vessel's numbers. HydroError: one lies outside the table.
    """
    stiffness = _stiffness(values)
    m, z_G, x_F = values["mass"], values["draft"] - values["KG"], values["x_F"]
    omega = np.linspace(table.omega[0], table.omega[-1], _GRID)
    A = _about(x_F, *table.at(omega))[0]
    I_y = values["I_yy"] + m * ((values["x_G"] - x_F) ** 2 + z_G**2)
    crossing = {
        "heave": stiffness[0] - omega**2 * (m + A[:, 2, 2]),
        "roll": _roll_alone(_of_table(table, values, omega)).real,
        "pitch": stiffness[2] - omega**2 * (I_y + A[:, 4, 4]),
    }
    return Frequencies(*(float(omega[_crossing(c, mode)]) for mode, c in crossing.items()))


def _about(x_F: float, *matrices: Array) -> list[Array]:
    """Return matrices (n, 6, 6) with heave and pitch about the centre of the water plane."""
    shift = np.eye(6)  # velocities at the origin from those at that centre
    shift[HEAVE, PITCH] = x_F
    return [np.asarray(shift.T @ matrix @ shift) for matrix in matrices]


def _of_table(table: HydroTable, values: Mapping[str, float], omega: Array) -> Complex:
    """Return the impedance (n, 6, 6) of a vessel without viscous damping."""
    A, B = table.at(omega)
    ship, w = ship_matrices(values), omega[:, None, None]
    return np.asarray(ship.stiffness - w**2 * (ship.body + A) - 1j * w * B)


def _roll_alone(impedance: Complex) -> Complex:
    """Return the impedance of roll (n,) with sway and yaw free."""
    free = impedance[:, _FREE][:, :, _FREE]
    along = np.linalg.solve(free, impedance[:, _FREE, ROLL][..., None])[..., 0]
    return np.asarray(impedance[:, ROLL, ROLL] - np.sum(impedance[:, ROLL, _FREE] * along, axis=1))


def _crossing(stiffness: Array, mode: str) -> int:
    """Return where the dynamic stiffness of a mode falls below 0 first."""
    below = stiffness < 0.0
    if not below.any() or below[0]:
        raise HydroError(
            f"the natural frequency of {mode} lies outside the frequencies of the table; make it "
            "with a wider range"
        )
    return int(np.argmax(below))


def equivalent_loads(
    table: HydroTable, values: Mapping[str, float], nominal: Mapping[str, float]
) -> Complex:
    """Return the loads on the ship in time (F, 2 (H - 1), 6) per wave amplitude, all round.

    ``nominal`` are the numbers of the vessel with which the table was loaded, ``values`` those of
    this one. A boat of the same kind takes the table by Froude's law and its loads in proportion
    to its restoring and its mass.
    """
    ratio = values["length_waterline"] / nominal["length_waterline"]
    table = table.scaled(ratio * nominal["length_waterline"] / table.length)
    F = table.around(table.excitation)
    lever = np.array([0, 0, 0, 1, 1, 1])
    power = ratio ** (3.0 + lever[:, None] + lever)
    share = np.ones(6)
    for mode, now, then in zip((2, 3, 4), _stiffness(values), _stiffness(nominal), strict=True):
        share[mode] = now / (then * ratio ** (2.0 if mode == HEAVE else 4.0))
    share[[0, 1, 5]] = values["mass"] / (nominal["mass"] * ratio**3)
    known, ours = ship_matrices(nominal), ship_matrices(values).impedance(table.omega)
    w = table.omega[:, None, None]
    beyond = -(w**2) * (table.added_mass - power * known.added_mass)
    beyond = beyond - 1j * w * (table.damping - power / np.sqrt(ratio) * known.damping)
    motion = np.linalg.solve(ours + beyond, np.swapaxes(F * share, 1, 2))
    return np.asarray(np.swapaxes(ours @ motion, 1, 2))


def response(table: HydroTable, values: Mapping[str, float]) -> Complex:
    """Return the motions (F, H, 6) of a vessel per wave amplitude: m/m and rad/m.

    ``values`` are the vessel's numbers; mass, restoring and viscous roll damping are theirs, added
    mass and radiation damping the table's at each frequency.
    """
    ship = ship_matrices(values)
    w = table.omega[:, None, None]
    whole = ship.stiffness - w**2 * (ship.body + table.added_mass)
    whole = whole - 1j * w * (table.damping + ship.viscous)
    motion = np.linalg.solve(whole, np.swapaxes(table.excitation, 1, 2))
    return np.asarray(np.swapaxes(motion, 1, 2))
