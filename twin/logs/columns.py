"""Names and units of the columns of a log, and how a column comes from a file."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from twin.channels import COMMANDS, MEASUREMENTS, TIME, TRUTH
from twin.logs.datum import Plane

__all__ = [
    "EMPTY",
    "OTHER_UNITS",
    "REQUIRED",
    "SHARE",
    "SINGLE",
    "UNITS",
    "Entry",
    "notes_of",
]

Array = npt.NDArray[np.float64]

EMPTY = ("", "nan", "NaN", "NAN", "NA", "N/A", "#N/A", "null", "NULL", "None", "-", "--", "---")
"""Cells that hold no value."""

REQUIRED = (TIME, *COMMANDS, "gps_x_m", "gps_y_m", "compass_rad")

SINGLE = {"n_rps": COMMANDS[:2], "delta_rad": COMMANDS[2:]}
"""Columns of a ship with one propeller or one rudder, and the columns that they fill."""

SHARE = "share of full throttle"
"""Said with what a file calls its shaft speeds, where that is their unit."""

_DEGREE = math.pi / 180.0

UNITS: dict[str, dict[str, float]] = {
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "day": 86400.0},
    "m": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "km": 1e3, "ft": 0.3048},
    "mps": {"mps": 1.0, "kn": 1852.0 / 3600.0, "kmph": 1.0 / 3.6, "ftps": 0.3048, "mph": 0.44704},
    "mps2": {"mps2": 1.0, "g": 9.80665},
    "rad": {"rad": 1.0, "deg": _DEGREE},
    "radps": {"radps": 1.0, "degps": _DEGREE, "degpmin": _DEGREE / 60.0},
    "rps": {"rps": 1.0, "rpm": 1.0 / 60.0, "radps": 0.5 / math.pi},
}
"""Units that a mapping file may name, by the unit at the end of the log's column."""

OTHER_UNITS = {
    f"{name.rpartition('_')[0]}_{unit}": (name, UNITS[own][unit])
    for name in (*COMMANDS, *SINGLE, *MEASUREMENTS, *TRUTH)
    for own, unit in (("rad", "deg"), ("radps", "degps"), ("rps", "rpm"))
    if name.endswith(f"_{own}")
}
"""Columns in degrees and rpm: the SI column that each gives, and its factor."""


@dataclass(frozen=True)
class Entry:
    """Columns of a log and what they are made of."""

    names: tuple[str, ...]  # columns of the log
    # columns of a file, or fields of a message (pose.pose.position.x; with ? at the end: NaN where
    # the message has none)
    sources: tuple[str, ...]
    # takes one array per source, gives one per name; None hands the one source to each name
    convert: Callable[[Sequence[Array]], Sequence[Array]] | None = None
    topic: str = ""  # of the messages; empty for a file of columns
    note: str = ""  # for the user
    clock: bool = False  # whether the source is a date and time, not a number
    format: str = ""  # of that date, as %d/%m/%Y %H:%M:%S; empty for ISO 8601
    date: str = ""  # column of the date, where the source is a time of day
    zone: str = ""  # of its clock, if it is not UTC
    # sources that are pulse widths, and the numbers that are none, but for those stated
    pulses: tuple[tuple[str, tuple[float, ...]], ...] = ()
    # takes what convert takes, returns the plane on which it puts positions, if any
    plane: Callable[[Sequence[Array]], Plane | None] | None = None

    def columns(self, values: Sequence[Array]) -> dict[str, Array]:
        """Return the log's columns from the sources' values, each of shape (N,)."""
        with np.errstate(over="ignore", invalid="ignore"):  # refused later, with its place
            made = [*values] * len(self.names) if self.convert is None else self.convert(values)
        return dict(zip(self.names, made, strict=True))


def notes_of(entries: Sequence[Entry]) -> list[str]:
    """Return what the user should know of how columns were made, in one note."""
    told = [entry.note for entry in entries if entry.note]
    return ["; ".join(told)] if told else []
