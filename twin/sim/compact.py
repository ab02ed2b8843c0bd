"""The compact observation: few entries of one size, for agents that learn quickly.

The entries and their scales were chosen by training, on boats that no evaluation has; the standard
deviations under ``los-twin`` stand in docs/reference/environment.md.
"""

from __future__ import annotations

from collections.abc import Sequence

from twin.sim.batched_twins import TWIN_SETS
from twin.sim.twin_observation import ATTITUDE_OBSERVATION, TWIN_OBSERVATION
from usv_gym.envs.selection import NEAR, Scaled
from usv_kernel.errors import UsvTwinError

__all__ = ["COMPACT", "COMPACT_PARAMS", "COMPACT_SETS", "SCALED", "set_of", "shows_forecast"]

_RIGHT = Scaled("compact_drive", "shaft_right", 0.7, 0.2)

COMPACT = (
    Scaled("compact_surge", "twin_surge", 1.0, 0.2),
    Scaled("compact_sway", "twin_sway", 0.0, 0.1),
    Scaled("compact_yaw_rate", "twin_yaw_rate", 0.0, 0.17, per_turn=True),
    Scaled("compact_cross_track", "twin_cross_track", 0.0, 0.2),
    Scaled("compact_to_go", "twin_to_go", 0.4, 0.3),
    Scaled("compact_cos_course_error", "twin_cos_course_error", 1.0, 0.1),
    Scaled("compact_sin_course_error", "twin_sin_course_error", 0.0, 0.4),
    Scaled("compact_cos_next_turn", "twin_cos_next_turn", 0.8, 0.3),
    Scaled("compact_sin_next_turn", "twin_sin_next_turn", 0.0, 0.5),
    Scaled("compact_shaft", "shaft_left", 0.7, 0.2),
    Scaled("compact_drive", "drive_left", 0.0, 0.4, of_pair=_RIGHT),
    Scaled("compact_gps_age", "gps_age", 0.0, 1.0),
    Scaled("compact_sd_starboard", "twin_sd_starboard", 0.1, 0.15),
    Scaled(f"compact_{NEAR}", "twin_to_go", near=3.0),
)
"""Entries of the set ``compact``."""

_COEFFICIENTS = {
    "thrust_left": ("T_uL", "X_nn"),
    "thrust_right": ("T_uR", "X_nu"),
    "turning_left": ("T_rL", "N_mn", "N_F"),
    "turning_right": ("T_rR", "N_S", "N_dn"),
    "yaw_damping": ("N_r", "N_|u|r"),
    "drift_damping": ("Y_v", "Y_|u|v"),
    "drift_in_turn": ("Y_r", "Y_ur"),
    "drift_moment": ("N_v", "N_uv"),
}
"""Coefficients that say how a boat turns, drives and drifts, in the two models of a twin."""

COMPACT_PARAMS = (
    *COMPACT,
    *(
        Scaled(f"compact_{part}_{role}", tuple(f"{part}_{name}" for name in names))
        for part in ("xi", "sd")
        for role, names in _COEFFICIENTS.items()
    ),
)
"""Entries of the set ``compact_params``: these coefficients, less those of the class, and their
standard deviations, in units of the class's spread."""

COMPACT_SETS: dict[str, tuple[str, Sequence[Scaled]]] = {
    "compact": ("twin", COMPACT),
    "compact_params": ("twin_params", COMPACT_PARAMS),
}
"""Names of these sets: the set that each is made of, and its entries."""

SCALED = {one.name: one for one in COMPACT_PARAMS}
"""The entries of both by name: a list of entries may have them beside others."""

_BEGINNINGS = (
    ("twin_health", ("health_",)),
    ("twin_attitude", (*ATTITUDE_OBSERVATION,)),
    ("twin", (*TWIN_OBSERVATION,)),
    ("twin_params", ("xi_", "sd_")),
    ("oracle", ("true_",)),
)
"""Sets, and how names of entries begin that they alone have."""


def set_of(names: Sequence[str]) -> str:
    """Return the smallest set that has all of some entries; unknown names count as sensors'."""
    found = []
    for name in map(_source, names):
        sets = [one for one, begin in _BEGINNINGS if name.startswith(begin)]
        found += sets[:1] or (["raw_stacked"] if name.endswith("_before") else [])
    needed = set(found)
    if len(needed) > 1 and needed <= set(TWIN_SETS):
        needed.discard("twin")
    if len(needed) > 1:
        raise UsvTwinError(
            f"observation: no set has all of these entries; they are of {', '.join(sorted(needed))}"
        )
    return next(iter(needed), "raw")


def shows_forecast(wanted: Sequence[str | Scaled]) -> bool:
    """Return whether entries are made of a twin's forecasts of the motion on the water."""
    names = (one.source if isinstance(one, Scaled) else one for one in wanted)
    listed = ((name,) if isinstance(name, str) else name for name in names)
    return any(name.startswith("ahead_") for each in listed for name in each)


def _source(name: str) -> str:
    """Return the entry that another one is made of, or the entry itself."""
    source = SCALED[name].source if name in SCALED else name
    return source if isinstance(source, str) else source[0]
