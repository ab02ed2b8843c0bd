"""Numbers of a column that stand for "no value"."""

from __future__ import annotations

import math

import numpy as np

from twin.logs.columns import Array
from twin.logs.signals import ENOUGH

__all__ = ["HEADINGS", "NO_PULSES", "NO_RPM", "RARE", "marks_of"]

NO_PULSES = -1.0, 0.0, 65535.0
"""Numbers of a servo or motor controller that gets no pulses, in place of their width, us."""

NO_RPM = -32768.0, 9999.0, 16383.75, 32767.0, 65535.0
"""Numbers of NMEA 2000, CAN and loggers for a shaft speed that is not available, rpm."""

HEADINGS = "compass_rad", "wind_from_rad", "apparent_wind_rad"
"""Columns of a log in which a receiver says 511, 999 or 360 degrees where it knows none."""

RARE = 0.01
"""Numbers of angles and commands that stand for none come in a larger share of the rows; commands
other than pulses lie among them."""


def marks_of(values: Array, turn: float = math.nan) -> list[float]:
    """Return the numbers of a speed, or of an angle that counts a turn so, that are no values.

    An infinite turn is that of numbers of either sign that are no headings.
    """
    seen, angle = values[np.isfinite(values)], turn == turn
    found: list[float] = []
    while len(seen) >= ENOUGH and len(np.unique(seen)) > 2:
        low, *_, high = np.unique(seen)
        for mark in (low, high):
            others = seen[seen != mark]
            beyond = max(others.min() - mark, mark - others.max())
            edge = np.diff((seen == mark).astype(np.int8)) != 0
            # a whole turn, more or -1 may be an angle beside others to the north
            apart = np.abs(np.remainder(np.diff(seen)[edge] / turn + 0.5, 1.0) - 0.5) > 1.0 / 12.0
            whole = turn * (1.0 - 1e-9)
            times = len(seen) - len(others)
            # nothing but a mark is said again and again so far from all that a speed passes through
            least = max(RARE * len(seen), 1.0) if angle else 1.0
            often = mark in (102.3, 1023.0) or times > least
            below = mark < 0.0 or (mark == 0.0 and often)
            # 359.996 is 360 once it is rounded, and of 511 and 999 both may be there
            full = turn * (1.0 + 1e-9)
            wide = mark > full and len(np.unique(others[others > full])) < 3
            whole_turn = mark >= whole >= others.max()
            turned = angle and ((below and others.min() >= 0.0) or whole_turn or wide)
            turned &= (apart.mean() > 0.5 and times > 1) or abs(mark) > 13.0 / 12.0 * turn
            # a heading that stands still is far from those of a few turns
            far = beyond > np.ptp(others) and often and not 0.0 < abs(mark) < turn < math.inf
            negative = not angle and mark < 0.0 <= others.min() and (often or mark.is_integer())
            if far or negative or turned:
                found.append(float(mark))
                seen = others
                break
        else:
            break
    return sorted(found)
