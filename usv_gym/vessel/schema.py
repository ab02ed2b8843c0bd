"""Schema of vessel files: tables, keys, units and bounds, and the checks of their values."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from usv_gym.physics import KNOT
from usv_gym.physics import parameters as par
from usv_kernel.errors import UsvTwinError

__all__ = [
    "KIND_SCHEMA",
    "OPTIONAL",
    "SCHEMA",
    "UNITS",
    "ZETA_ROLL_VISCOUS",
    "VesselError",
    "check_kind",
    "check_resistance",
    "check_values",
    "keys_of",
]


class VesselError(UsvTwinError):
    """A vessel that cannot be used; the message names the file, the key and the remedy."""


# fmt: off
UNITS: dict[str, dict[str, float]] = {
    "m": {"m": 1.0, "mm": 1e-3}, "m2": {"m2": 1.0}, "kg": {"kg": 1.0, "t": 1e3},
    "kg m2": {"kg m2": 1.0}, "kg/m3": {"kg/m3": 1.0}, "m/s": {"m/s": 1.0, "kn": KNOT},
    "N": {"N": 1.0, "kN": 1e3}, "s": {"s": 1.0}, "rev/s": {"rev/s": 1.0, "rpm": 1.0 / 60.0},
    "rev/s2": {"rev/s2": 1.0, "rpm/s": 1.0 / 60.0}, "kg/s": {"kg/s": 1.0}, "kg/m": {"kg/m": 1.0},
    "kg m2/s": {"kg m2/s": 1.0}, "kg m2 s": {"kg m2 s": 1.0},
    "rad": {"rad": 1.0, "deg": math.pi / 180.0}, "rad/s": {"rad/s": 1.0, "deg/s": math.pi / 180.0},
    "1/rad": {"1/rad": 1.0, "1/deg": 180.0 / math.pi}, "1": {"1": 1.0},
}
"""SI unit -> units that a file may use, with their factors."""

HULL_TERMS = (
    *("R_0", "X_vv", "X_vr", "X_rr", "X_vvvv"),
    *(f"{force}_{term}" for force in "YN" for term in ("v", "r", "vvv", "vvr", "vrr", "rrr")),
)
"""Terms of the hull polynomial."""

DAMPING = {
    "D_u": ("kg/s", "0"), "D_uu": ("kg/m", "0"), "D_v": ("kg/s", "0"), "D_vv": ("kg/m", "0"),
    "D_r": ("kg m2/s", "0"), "D_rr": ("kg m2", "0"), "D_rrr": ("kg m2 s", "0"),
}

# table -> key -> (SI unit, bound): "+" above 0, "0" 0 or more, "" any
SCHEMA: dict[str, dict[str, tuple[str, str]]] = {
    "particulars": {
        "length_overall": ("m", "+"), "length_waterline": ("m", "+"), "beam": ("m", "+"),
        "draft": ("m", "+"), "block_coefficient": ("1", "+"), "water_density": ("kg/m3", "+"),
        "hull_beam": ("m", "+"), "spacing": ("m", "+"),
        "mass": ("kg", "+"), "x_G": ("m", ""), "KG": ("m", "+"), "I_xx": ("kg m2", "+"),
        "I_yy": ("kg m2", "+"), "I_zz": ("kg m2", "+"), "m_x": ("kg", "0"), "m_y": ("kg", "0"),
        "J_zz": ("kg m2", "0"),
    },
    "seakeeping": {
        "A_wp": ("m2", "+"), "x_F": ("m", ""), "GM_T": ("m", "+"), "GM_L": ("m", "+"),
        "m_z": ("kg", "0"), "J_xx": ("kg m2", "0"), "J_yy": ("kg m2", "0"),
        "zeta_heave": ("1", "0"), "zeta_roll": ("1", "0"), "zeta_pitch": ("1", "0"),
        "zeta_roll_viscous": ("1", "0"), "z_H": ("m", ""),
    },
    "hull": {**{key: ("1", "") for key in HULL_TERMS}, "C_d_crossflow": ("1", "0"), **DAMPING},
    "propulsion": {
        "units": ("1", "+"), "propeller_diameter": ("m", "+"), "k_0": ("1", "+"), "k_1": ("1", ""),
        "k_2": ("1", ""), "astern": ("1", "0"), "wake_fraction": ("1", ""),
        "thrust_deduction": ("1", ""), "y_P": ("m", "0"), "z_P": ("m", ""),
        "shaft_lag": ("s", "+"), "shaft_rate": ("rev/s2", "+"), "shaft_speed_max": ("rev/s", "+"),
        "shaft_speed_service": ("rev/s", "+"), "shaft_speed_manoeuvring": ("rev/s", "+"),
    },
    "wind": {
        "A_F": ("m2", "+"), "A_L": ("m2", "+"), "s_L": ("m", ""), "s_H": ("m", "0"),
        "kappa_wind": ("1", "0"), "CD_t": ("1", "+"), "CD_l_bow": ("1", "+"),
        "CD_l_stern": ("1", "+"), "delta_wind": ("1", "0"),
    },
}

_STEERED = {
    "steer_lag": ("s", "+"), "steer_rate": ("rad/s", "+"), "steer_max": ("rad", "+"),
    "A_R": ("m2", "0"), "f_alpha": ("1/rad", "0"),
}

# kind of propulsion -> its additional keys in [propulsion]
KIND_SCHEMA: dict[str, dict[str, tuple[str, str]]] = {
    "steerable_drive": {**_STEERED, "x_P": ("m", ""), "slipstream": ("1", "0")},
    "propeller_rudder": {
        **_STEERED,
        "rudder_height": ("m", "+"), "C_1": ("1", "0"), "C_2_plus": ("1", "0"),
        "C_2_minus": ("1", "0"), "x_P_prime": ("1", ""), "epsilon": ("1", "+"),
        "kappa": ("1", "0"), "l_R_prime": ("1", ""), "gamma_R_plus": ("1", "0"),
        "gamma_R_minus": ("1", "0"), "t_R": ("1", ""), "a_H": ("1", "0"), "x_H_prime": ("1", ""),
        "x_R_prime": ("1", ""),
    },
    "thruster_pair": {},
}
# fmt: on

OPTIONAL = frozenset(("hull_beam", "spacing", "zeta_roll_viscous", *SCHEMA["hull"]))
"""Keys that a vessel may lack: of a catamaran, of a hydrodynamic table, or terms of the hull."""

ZETA_ROLL_VISCOUS = 0.05
"""Share of the critical roll damping beyond radiated waves, where a vessel with a table has none.

A guess: bare hulls without speed have 0.02 to 0.08 by the components of Himeno 1981 and Ikeda 2004
(ITTC 7.5-02-07-04.5), most of it from eddies at the chines.
"""


def check_kind(kind: Any) -> str:
    """Return a kind of propulsion, or raise :class:`VesselError` for an unknown one."""
    if not isinstance(kind, str) or kind not in KIND_SCHEMA:
        raise VesselError(
            f"[propulsion] kind: must be one of {', '.join(KIND_SCHEMA)}, got {kind!r}"
        )
    return kind


def keys_of(table: str, kind: str) -> dict[str, tuple[str, str]]:
    """Return the keys of a table of a vessel file, with SI units and bounds, for a kind.

    ``table`` is a key of :data:`SCHEMA`, ``kind`` one of :data:`KIND_SCHEMA`.
    """
    return {**SCHEMA[table], **(KIND_SCHEMA[kind] if table == "propulsion" else {})}


def check_values(kind: str, values: Mapping[str, float]) -> None:
    """Check the SI numbers of a vessel against the schema and each other; hull terms may be absent.

    VesselError names the table, the key and the rule.
    """
    schema = {table: keys_of(table, kind) for table in SCHEMA}
    for table, keys in schema.items():
        for key, (unit, bound) in keys.items():
            if key in OPTIONAL and key not in values:
                continue
            value = values.get(key, math.nan)
            if not math.isfinite(value):
                raise VesselError(f"[{table}] {key}: must be a finite number, got {value}")
            if (bound == "+" and value <= 0.0) or (bound == "0" and value < 0.0):
                rule = "above 0" if bound == "+" else "0 or more"
                raise VesselError(f"[{table}] {key}: must be {rule}, got {value:g} {unit}")
    unknown = set(values) - {key for keys in schema.values() for key in keys}
    if unknown:
        raise VesselError(f"unknown value(s): {', '.join(sorted(unknown))}")
    v = values
    if ("hull_beam" in v) != ("spacing" in v):
        raise VesselError("[particulars] hull_beam and spacing: a catamaran needs both")
    if "hull_beam" in v and not v["hull_beam"] < v["spacing"] <= 1.01 * v["beam"] - v["hull_beam"]:
        raise VesselError(
            "[particulars] hull_beam and spacing: the hulls must not touch, and must lie within "
            f"the beam of {v['beam']:g} m; got {v['hull_beam']:g} and {v['spacing']:g} m"
        )
    volume = v["block_coefficient"] * v["length_waterline"] * v["beam"] * v["draft"]
    displaced = volume * v["water_density"]
    if not 0.8 < displaced / v["mass"] < 1.25:
        raise VesselError(
            f"[particulars] mass: {v['mass']:g} kg, but block coefficient, length, beam and "
            f"draft displace {displaced:.4g} kg; they must agree within 20 %"
        )
    for key in ("wake_fraction", "thrust_deduction"):
        if v[key] >= 1.0:
            raise VesselError(f"[propulsion] {key}: must be below 1, got {v[key]:g}")
    if kind == "steerable_drive" and v["x_P"] >= 0.0:
        raise VesselError("[propulsion] x_P: the drives must be aft (x_P below 0)")
    if v.get("steer_max", 0.0) > 0.5 * math.pi:
        raise VesselError(
            f"[propulsion] steer_max: must be at most 90 deg, got {v['steer_max']:g} rad"
        )
    if v["units"] not in (1.0, 2.0):
        raise VesselError(f"[propulsion] units: must be 1 or 2, got {v['units']:g}")
    if kind == "thruster_pair" and (v["units"] != 2.0 or v["y_P"] == 0.0):
        raise VesselError(
            "[propulsion] a thruster_pair steers by unequal thrust: units must be 2 and y_P above 0"
        )


def check_resistance(
    values: Mapping[str, float], speed: Sequence[float], force: Sequence[float]
) -> None:
    """Check the resistance curve of a vessel (m/s and N); :class:`VesselError` names the rule."""
    if not speed and not force:
        if not any(values.get(key, 0.0) > 0.0 for key in ("R_0", "D_u", "D_uu")):
            raise VesselError("[hull] needs a resistance curve, or one of R_0, D_u, D_uu")
        return
    if len(speed) != len(force) or not 3 <= len(speed) <= par.RESISTANCE_POINTS:
        raise VesselError(
            "[hull.resistance] speed and force need equally many points, 3 to "
            f"{par.RESISTANCE_POINTS}; got {len(speed)} and {len(force)}"
        )
    if not np.isfinite([*speed, *force]).all():
        raise VesselError("[hull.resistance] speed and force must be finite numbers")
    if speed[0] != 0.0 or force[0] != 0.0 or min(np.diff(speed)) <= 0.0 or min(force) < 0.0:
        raise VesselError(
            "[hull.resistance] must start at speed 0, force 0; speeds must rise and forces "
            "must not be negative"
        )
