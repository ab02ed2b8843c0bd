"""Boats whose runs others recorded, known by the columns of the file.

The runs of the Esso Osaka (a 3 m tanker on a pond) and of the KVLCC2 (a 7 m tanker in the basins of
MARIN and HSVA) are no part of the project: their licences forbid passing them on. ``Log.read``
knows their columns (``twin/logs/mappings``), and here are their particulars (``twin/logs/ships``).
"""

from __future__ import annotations

from pathlib import Path

from twin.logs.errors import LogError
from twin.logs.parquet import column_file
from twin.particulars import Particulars

__all__ = ["known_ship"]

_TANKER = {"x_m", "y_m", "psi_rad", "n_rps", "delta_rad"}

_SHIPS = {
    "ships/esso_osaka.toml": {*_TANKER, "wind_true_from_rad"},
    "ships/kvlcc2_marin.toml": {*_TANKER, "x_int_m", "xdot_mps", "ydot_mps"},
    "ships/kvlcc2_hsva.toml": {*_TANKER, "xdot_mps", "ydot_mps"},
    "recorded/boat1_usv_circle.toml": {
        *("x_m", "y_m", "psi_rad", "sog_mps", "cog_rad", "pwm_l_us", "pwm_r_us")
    },
}
"""Particulars, and the columns by which a run of theirs is known wherever it lies."""


def known_ship(path: str | Path) -> Particulars | None:
    """Return the particulars of the boat of a recorded run, if its columns are known."""
    path = Path(path)
    try:
        header = set(column_file(path).header)
    except LogError:
        return None
    for name, columns in _SHIPS.items():
        if columns <= header:
            return Particulars.load(Path(__file__).parent / name)
    return None
