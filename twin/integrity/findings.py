"""What the check of a log says."""

from __future__ import annotations

import math
from dataclasses import dataclass

__all__ = ["ERROR", "NOTE", "SEVERITIES", "WARNING", "Finding"]

ERROR, WARNING, NOTE = "error", "warning", "note"

SEVERITIES = (ERROR, WARNING, NOTE)
"""``error``: the log cannot be used so. ``warning``: the twin will be worse. ``note``: sound,
but good to know."""


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong with a log.

    Parameters
    ----------
    severity : str
        One of :data:`SEVERITIES`.
    code : str
        Stable, for programs: ``time``, ``time-unit``, ``gap``, ``jitter``, ``missing``, ``mark``,
        ``dead``, ``lost``, ``frozen``, ``jump``, ``contradiction``, ``unit``, ``sign``, ``axes``,
        ``sides``, ``offset``, ``scale``, ``bias``, ``late`` or ``unchecked``.
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
