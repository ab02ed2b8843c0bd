"""Regressions on main particulars: hull forces, added masses, hydrostatics.

Each function takes a :class:`Form` and returns an :class:`Estimate`: numbers, source, and a note
for each particular outside the data of the regression. Primed coefficients are dimensionless as in
:mod:`usv_gym.physics`. Of a catamaran, each hull is estimated by itself, and the sum is returned:
interference of the hulls, in waves or wake, is neglected.
Bounds are those of the ship types of each regression, as few sources print
their own.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from usv_gym.vessel.vessel import Vessel

__all__ = [
    "Estimate",
    "Form",
    "cross_flow",
    "heave_of_two_hulls",
    "hydrostatics",
    "kijima",
    "kijima_rudder",
    "pitch_damping",
    "soding",
    "yoshimura",
    "zhou",
]

# beam over twice the draft, and drag coefficient (Hoerner 1965, read off by Leite et al. 1998)
# fmt: off
_HOERNER = np.array([
    (0.0109, 1.966), (0.1766, 1.966), (0.3530, 1.898), (0.4519, 1.787), (0.4728, 1.584),
    (0.4929, 1.279), (0.5585, 1.084), (0.6464, 0.9986), (0.8336, 0.8796), (0.9880, 0.8284),
    (1.3081, 0.7599), (1.6392, 0.6914), (1.8600, 0.6571), (2.3129, 0.6307), (2.6000, 0.5962),
    (3.0088, 0.5868), (3.4508, 0.5859), (4.0031, 0.5593),
])
# fmt: on

MERCHANT = {"L/B": (5.0, 8.0), "B/d": (2.0, 4.5), "C_b": (0.5, 0.87)}
"""Hulls of cargo ships: bounds of most regressions."""

FISHING = {"L/B": (4.0, 8.0), "B/d": (2.0, 4.5), "C_b": (0.45, 0.87)}
"""Cargo ships and the fishing vessels of Yoshimura and Masumoto 2012."""


@dataclass(frozen=True, kw_only=True)
class Form:
    """Main particulars of a hull, or of each of two equal ones."""

    # at the water line, m
    length: float
    beam: float
    draft: float
    block_coefficient: float  # displaced volume over length, beam and draft
    water_density: float = 1025.0  # kg/m3
    x_G: float = 0.0  # centre of gravity forward of midship, m
    hulls: int = 1  # 2 of a catamaran
    spacing: float = 0.0  # between the centre lines of two hulls, m

    @classmethod
    def of(cls, vessel: Vessel) -> Form:
        """Return those of a vessel."""
        v = vessel.values
        hulls, beam = (2, v["hull_beam"]) if "hull_beam" in v else (1, v["beam"])
        return cls(
            length=v["length_waterline"],
            beam=beam,
            draft=v["draft"],
            block_coefficient=v["block_coefficient"] * (v["beam"] / (hulls * beam)),
            water_density=v["water_density"],
            x_G=v["x_G"],
            hulls=hulls,
            spacing=v.get("spacing", 0.0),
        )

    @property
    def volume(self) -> float:
        """Displaced volume of all hulls, m3."""
        return self.hulls * self.block_coefficient * self.length * self.beam * self.draft

    @property
    def mass(self) -> float:
        """Displaced mass of all hulls, kg."""
        return self.water_density * self.volume

    @property
    def ratios(self) -> dict[str, float]:
        """The ratios that bound the regressions."""
        return {
            "L/B": self.length / self.beam,
            "B/d": self.beam / self.draft,
            "C_b": self.block_coefficient,
        }


@dataclass(frozen=True)
class Estimate:
    """Numbers from a regression (author and year), by names as in vessel files.

    There is a note for each particular out of range, and for each impossible result.
    """

    source: str
    values: Mapping[str, float]
    notes: tuple[str, ...] = ()

    def __getitem__(self, key: str) -> float:
        return self.values[key]


def _estimate(
    source: str,
    form: Form,
    values: dict[str, float],
    bounds: Mapping[str, tuple[float, float]],
    *more: str,
) -> Estimate:
    """Return an estimate with notes on particulars out of bounds."""
    ratios = form.ratios
    notes = [
        f"{source}: {name} is {ratios[name]:.3g}, based on hulls of {low:g} to {high:g}"
        for name, (low, high) in bounds.items()
        if not low <= ratios[name] <= high
    ]
    return Estimate(source, values, (*notes, *more))


def kijima(form: Form, m_x_prime: float) -> Estimate:
    """Return the linear hull coefficients after Kijima and Inoue.

    ``m_x_prime`` is the added mass in surge of all hulls over ``rho L^2 d / 2``.
    Source: Inoue et al. 1981, Kijima et al. 1990. N_v includes the moment of the added masses in
    drift. :func:`cross_flow` replaces the other terms.
    """
    L, B, d, C_b = form.length, form.beam, form.draft, form.block_coefficient
    k, c = 2.0 * d / L, C_b * B / L
    values = {
        "Y_v": -(math.pi / 2.0 * k + 1.4 * c),
        "Y_r": math.pi / 4.0 * k + m_x_prime / form.hulls,
        "N_v": -k,
        "N_r": -0.54 * k + k * k,
    }
    values = {key: form.hulls * value for key, value in values.items()}
    return _estimate("Kijima 1990", form, values, MERCHANT, *_damped("Kijima 1990", values))


def yoshimura(form: Form, m_x_prime: float, m_y_prime: float) -> Estimate:
    """Return all hull coefficients but R_0 after Yoshimura and Masumoto 2012.

    Added masses in surge and sway are over ``rho L^2 d / 2``.
    """
    L, B, d, C_b = form.length, form.beam, form.draft, form.block_coefficient
    k, c, slender = 2.0 * d / L, C_b * B / L, L / B
    values = {
        "X_vv": 1.15 * c - 0.18,
        "X_vr": m_y_prime - 1.91 * c + 0.08,
        "X_rr": -0.085 * c + 0.008 - form.x_G / L * m_y_prime,
        "X_vvvv": -6.68 * c + 1.1,
        "Y_v": -(math.pi / 2.0 * k + 1.4 * c),
        "Y_r": m_x_prime + 0.5 * c,
        "Y_vvv": -0.185 * slender + 0.48,
        "Y_vvr": -0.75,
        "Y_vrr": -(0.26 * (1.0 - C_b) * slender + 0.11),
        "Y_rrr": -0.051,
        "N_v": -k,
        "N_r": -0.54 * k + k * k,
        "N_vvv": -(-0.69 * C_b + 0.66),
        "N_vvr": 1.55 * c - 0.76,
        "N_vrr": -0.075 * (1.0 - C_b) * slender - 0.098,
        "N_rrr": 0.25 * c - 0.056,
    }
    source = "Yoshimura and Masumoto 2012"
    return _estimate(source, form, values, FISHING, *_damped(source, values))


def _damped(source: str, values: Mapping[str, float]) -> list[str]:
    """Return a note for each damping coefficient with the wrong sign."""
    return [
        f"{source}: {key} is {values[key]:.3g}, and must not be above 0"
        for key in ("Y_v", "N_r", "Y_vvv", "N_rrr")
        if values.get(key, -1.0) > 0.0
    ]


def soding(form: Form) -> Estimate:
    """Return the added mass in surge, kg.

    Source: Soding 1982, as in MSS; of a prolate body, for any slender hull.
    """
    volume = form.volume / form.hulls
    m_x = form.hulls * 2.7 * form.water_density * volume ** (5.0 / 3.0) / form.length**2
    values = {"m_x": m_x}
    return _estimate("Soding 1982", form, values, {"L/B": (2.0, 12.0)})


def zhou(form: Form) -> Estimate:
    """Return the added mass in sway (kg) and the added inertia in yaw (kg m2).

    Source: regressions of Zhou et al. 1983 on the charts of Motora 1959. A hull of a catamaran that
    is deeper than half its beam lies outside them. It is taken at B/d = 2; from there on, sway and
    yaw grow with the square of the draft (strip theory, Newman 1977, section 7.4).
    """
    L, B, d, C_b = form.length, form.beam, form.draft, form.block_coefficient
    deep = max(2.0 * d / B, 1.0) if form.hulls > 1 else 1.0
    d = d / deep
    a, b, e = L / B, d / B, d * L / (B * B)
    sway = (
        0.882
        - 0.54 * C_b * (1.0 - 1.6 * b)
        - 0.156 * a * (1.0 - 0.673 * C_b)
        + 0.826 * e * (1.0 - 0.678 * b)
        - 0.638 * C_b * e * (1.0 - 0.669 * b)
    )
    gyradius = (
        L / 100.0 * (33.0 - 76.85 * C_b * (1.0 - 0.784 * C_b) + 3.43 * a * (1.0 - 0.63 * C_b))
    )
    values = {
        "m_y": deep * sway * form.mass,
        "J_zz": deep * form.mass * gyradius * gyradius,
    }
    negative = f"Zhou 1983: m_y is {values['m_y']:.3g} kg, and must be above 0"
    bounds = {"L/B": (4.0, 10.0), "B/d": (2.0, 5.0), "C_b": (0.5, 0.85)}
    more = () if values["m_y"] > 0.0 else (negative,)
    return _estimate("Zhou 1983", form, values, bounds, *more)


def hydrostatics(form: Form, water_plane: float) -> Estimate:
    """Return KB, BM_T and BM_L in m, for a coefficient of the water plane.

    Source: KB by Morrish; inertia of the water plane by D'Arcangelo 1969, and of two hulls by the
    parallel axis theorem. The coefficient is of one hull: its area over length and beam.
    """
    L, B, d = form.length, form.beam, form.draft
    volume = form.volume / form.hulls
    apart = water_plane * L * B * (0.5 * form.spacing) ** 2 / volume
    values = {
        "KB": d / 3.0 * (2.5 - form.block_coefficient / water_plane),
        "BM_T": max(0.1216 * water_plane - 0.0410, 0.0) * L * B**3 / volume + apart,
        "BM_L": (0.350 * water_plane**2 - 0.405 * water_plane + 0.146) * L**3 * B / volume,
    }
    source = "D'Arcangelo 1969"
    notes = []
    if not 0.6 <= water_plane <= 0.98:
        notes.append(f"{source}: water-plane coefficient is {water_plane:.3g}, typical 0.6 to 0.98")
    return _estimate(source, form, values, {}, *notes)


def heave_of_two_hulls(form: Form, water_plane: float) -> Estimate:
    """Return the added mass in heave (kg) and inertias in roll and pitch (kg m2) of a catamaran.

    It is that of half a circular cylinder as wide as the hull, pi rho B^2 / 8 a metre. It acts over
    the share of the length that the water plane fills. In roll it acts half the spacing off the
    centre line; in pitch at a quarter of the length. Source: Newman 1977, section 4.13.
    """
    strip = math.pi / 8.0 * form.water_density * form.beam**2
    m_z = form.hulls * strip * water_plane * form.length
    values = {
        "m_z": m_z,
        "J_xx": m_z * (0.5 * form.spacing) ** 2,
        "J_yy": m_z * (0.25 * form.length) ** 2,
    }
    return _estimate("strip theory", form, values, {})


def pitch_damping(form: Form) -> Estimate:
    """Return the share of the critical damping in pitch that radiated waves take.

    Source: closed form of Jensen et al. 2004 at their natural frequency, for a box as wide as beam
    times block coefficient; of each hull. On three small boats of the package it lies within 5 %
    of a boundary-element code. Kept within 0.05 and 0.35.
    """
    ratio = form.block_coefficient * form.beam / (2.0 * form.draft)
    wave = 2.0 * math.sin(0.5 * min(ratio, math.pi)) * math.exp(-0.5)
    zeta = min(max(wave**2 / (2.0 * ratio), 0.05), 0.35)
    return _estimate("Jensen 2004", form, {"zeta_pitch": zeta}, {"B/d": (1.0, 6.0)})


def kijima_rudder(form: Form) -> Estimate:
    """Return a_H, t_R and epsilon of a rudder behind one screw.

    Source: Kijima et al. 1990. For outboard drives use 0, 0 and 1.
    """
    C_b = form.block_coefficient
    c = C_b * form.beam / form.length
    values = {
        "a_H": 0.627 * C_b - 0.153,
        "t_R": 1.0 - (0.28 * C_b + 0.55),
        "epsilon": -156.2 * c * c + 41.6 * c - 1.76,
    }
    notes = [
        f"Kijima 1990: {key} is {values[key]:.3g}, and must be above {low:g}"
        for key, low in (("a_H", 0.0), ("epsilon", 0.5))
        if values[key] <= low
    ]
    return _estimate("Kijima 1990", form, values, MERCHANT, *notes)


def cross_flow(form: Form) -> Estimate:
    """Return the drag coefficient of sections in cross-flow.

    Source: Hoerner 1965 as a function of ``B / (2 d)``, linear between the points. Of two hulls,
    one lies in the shelter of the other and adds nothing (as in MSS otter.m).
    """
    drag = float(np.interp(form.beam / (2.0 * form.draft), *_HOERNER.T))
    return _estimate("Hoerner 1965", form, {"C_d_crossflow": drag}, {"B/d": (0.1, 8.0)})
