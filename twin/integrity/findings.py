"""What the check of a log says."""

from __future__ import annotations

import math
from dataclasses import dataclass

__all__ = ["CODES", "ERROR", "NOTE", "SEVERITIES", "WARNING", "Finding"]

ERROR, WARNING, NOTE = "error", "warning", "note"

SEVERITIES = (ERROR, WARNING, NOTE)
"""``error``: the log cannot be used so. ``warning``: the twin will be worse. ``note``: sound,
but good to know."""

CODES = {
    "time": "stamps that are empty, equal or go back",
    "time-unit": "stamps that are no seconds",
    "gap": "time without rows",
    "jitter": "stamps that are not those of the samples",
    "missing": "rows, samples or commands that are needed and not there",
    "mark": "numbers that stand for no value, or that no boat gives",
    "dead": "a column whose values are all equal",
    "lost": "a sensor that is silent for a while",
    "frozen": "a sensor that repeats itself, or stands still, while the boat moves",
    "jump": "values that leap and that no boat reaches",
    "contradiction": "a sensor that contradicts the others for a while",
    "unit": "values in another unit",
    "sign": "values with the wrong sign",
    "axes": "axes that are swapped, mirrored or turned",
    "sides": "left and right swapped, or one of them without effect",
    "offset": "a constant angle",
    "scale": "values too large or too small by a factor",
    "bias": "a zero that is off",
    "late": "samples that come late",
    "unchecked": "what the log does not tell",
}
"""What each code of a finding means."""


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong with a log.

    Parameters
    ----------
    severity : str
        One of :data:`SEVERITIES`.
    code : str
        One of :data:`CODES`; stable, for programs.
    what : str
        The fault in plain words, with its number.
    remedy : str
        What to do about it: the line of the mapping or particulars that mends it.
    sensor : str
        Which it concerns, such as ``gyro``.
    size, low, high : float
        The parameter that is off, and the interval in which it lies with 95 %; NaN without one.
    start, end : float
        Of the stretch that it concerns, s; NaN for the whole log.
    """

    severity: str
    code: str
    what: str
    remedy: str
    sensor: str = ""
    size: float = math.nan
    low: float = math.nan
    high: float = math.nan
    start: float = math.nan
    end: float = math.nan

    @property
    def text(self) -> str:
        """The finding and its remedy in one line."""
        return f"{self.what}; {self.remedy}" if self.remedy else self.what
