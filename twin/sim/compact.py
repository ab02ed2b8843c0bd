"""The compact observation: few entries of one size, for agents that learn quickly.

The entries and their scales were chosen by training, on boats that no evaluation has; the standard
deviations under ``los-twin`` stand in docs/reference/environment.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from twin.sim.batched_twins import TWIN_SETS
from twin.sim.twin_observation import ATTITUDE_OBSERVATION
from usv_gym.envs.selection import NEAR, Scaled
from usv_kernel.errors import UsvTwinError

__all__ = [
    "COMPACT",
    "COMPACT_ORACLE",
    "COMPACT_PARAMS",
    "COMPACT_RAW",
    "COMPACT_SETS",
    "SCALED",
    "set_of",
    "shows_forecast",
]

_TWIN, _RAW, _TRUE = "compact_", "compact_raw_", "compact_true_"
"""How entries made of those of the twin, of the sensors and of the truth begin."""


class _Row(NamedTuple):
    """An entry of the compact sets: what it is made of in each, "" for none, and its scale."""

    role: str
    twin: str
    raw: str
    true: str
    offset: float
    scale: float
    more: Mapping[str, Any] = {}


_ROWS = (
    _Row("surge", "twin_surge", "speed_forward", "true_surge", 1.0, 0.2),
    _Row("sway", "twin_sway", "speed_starboard", "true_sway", 0.0, 0.1),
    _Row("yaw_rate", "twin_yaw_rate", "yaw_rate", "true_yaw_rate", 0.0, 0.17, {"per_turn": True}),
    *(
        _Row(role, f"twin_{role}", role, f"true_{role}", offset, scale)
        for role, offset, scale in (
            ("cross_track", 0.0, 0.2),
            ("to_go", 0.4, 0.3),
            ("cos_course_error", 1.0, 0.1),
            ("sin_course_error", 0.0, 0.4),
            ("cos_next_turn", 0.8, 0.3),
            ("sin_next_turn", 0.0, 0.5),
        )
    ),
    _Row("shaft", "shaft_left", "shaft_left", "true_shaft_left", 0.7, 0.2),
    _Row("drive", "drive_left", "drive_left", "true_drive_left", 0.0, 0.4),
    _Row("gps_age", "gps_age", "gps_age", "", 0.0, 1.0),
    _Row("sd_starboard", "twin_sd_starboard", "", "", 0.1, 0.15),
    _Row(NEAR, "twin_to_go", "to_go", "true_to_go", 0.0, 1.0, {"near": 3.0}),
)

_PAIR = {"drive_left": "shaft_right", "true_drive_left": "true_shaft_right"}
"""What stands in the place of an angle for a vessel that steers by a pair of thrusters."""


def _entries(begin: str, source: Callable[[_Row], str]) -> tuple[Scaled, ...]:
    """Return the entries of a set, whose names begin so, by what each row is made of there."""
    shaft = next(row for row in _ROWS if row.role == "shaft")
    found = []
    for row in filter(source, _ROWS):
        one = Scaled(begin + row.role, source(row), row.offset, row.scale, **row.more)
        if one.source in _PAIR:
            pair = one._replace(source=_PAIR[one.source], offset=shaft.offset, scale=shaft.scale)
            one = one._replace(of_pair=pair)
        found.append(one)
    return tuple(found)


COMPACT = _entries(_TWIN, lambda row: row.twin)
"""Entries of the set ``compact``."""

COMPACT_RAW = _entries(_RAW, lambda row: row.raw)
"""Entries of the set ``compact_raw``: the same of the sensors, which have no deviation."""

COMPACT_ORACLE = _entries(_TRUE, lambda row: row.true)
"""Entries of the set ``compact_oracle``: the same of the truth, which no loss makes older."""

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
    "compact_raw": ("raw", COMPACT_RAW),
    "compact": ("twin", COMPACT),
    "compact_params": ("twin_params", COMPACT_PARAMS),
    "compact_oracle": ("oracle", COMPACT_ORACLE),
}
"""Names of these sets: the set that each is made of, and its entries."""

SCALED = {one.name: one for _of, entries in COMPACT_SETS.values() for one in entries}
"""The entries of all of them by name: a list of entries may have them beside others."""

_BEGINNINGS = (
    ("twin_health", ("health_",)),
    ("twin_attitude", (*ATTITUDE_OBSERVATION,)),
    ("twin", ("twin_", "ahead_")),
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
