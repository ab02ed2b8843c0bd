"""Checks and repairs of the columns of a log: time, commands, dead sensors, units, jumps."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from twin.channels import MEASUREMENTS
from twin.logs.columns import Array, LogError
from twin.logs.readers import Table

__all__ = [
    "check_drive",
    "check_measurement",
    "check_turning",
    "checked_time",
    "drop_jumps",
    "drop_repeats",
    "held_command",
]

_CONSTANT_ROWS = 20
"""So many equal values are those of a dead sensor."""

_GAP_STEPS = 5.0
"""A longer step of time is a gap, in median steps."""

_WHOLE_TURN = 0.35
"""So near to whole turns a step is one of unwrapping, rad."""

_JUMP, _FAST = 50.0, 30.0
"""Between two fixes no boat goes farther than this, m, and this fast, m/s (58 knots)."""

_LOST = 0.1
"""More than this share of the fixes is no error of a receiver."""

_PIECES = 1000
"""Most pieces between jumps that are joined to a track."""


def checked_time(t: Array, table: Table) -> Array:
    """Return the time if it is complete and increasing; note its gaps."""
    given = table.source + ": column t_s"
    if len(t) < 2:
        raise LogError(
            f"{table.source}: {len(t)} row of data after the header; a log needs two or more"
            if len(t)
            else f"{table.source}: no row of data after the header (line 1); record a run first"
        )
    if np.isnan(t).any():
        row = int(np.argmax(np.isnan(t)))
        raise LogError(
            f"{given}, {table.line(row)}: empty; each row needs a time, else remove the row"
        )
    step = np.diff(t)
    if (step <= 0.0).any():
        row = int(np.argmax(step <= 0.0)) + 1
        raise LogError(
            f"{given}, {table.line(row)}: time does not increase ({t[row]:.10g} s after "
            f"{t[row - 1]:.10g} s); sort the rows by time and merge those with equal times"
        )
    gaps = step > _GAP_STEPS * np.median(step)
    if gaps.any():
        row = int(np.argmax(step))
        table.notes.append(
            f"t_s: {gaps.sum()} time gap(s) above {_GAP_STEPS:.0f} x the median step "
            f"{np.median(step):.4g} s, treated as missing data (longest {step[row]:.1f} s at "
            f"t = {t[row]:.1f} s, {table.line(row + 1)})"
        )
    return t


def held_command(values: Array, given: str, table: Table) -> Array:
    """Return a command with empty cells filled by the last one."""
    empty = np.isnan(values)
    if not empty.any():
        return values
    if empty[0]:
        raise LogError(
            f"{table.source}: column {given}, {table.line(0)}: empty, and there is no earlier "
            "command to hold; fill in the command in force or remove the first rows"
        )
    table.notes.append(
        f"{given}: {empty.sum()} of {len(values)} cells empty, the last command held"
    )
    rows = np.arange(len(values))
    return values[np.maximum.accumulate(np.where(empty, 0, rows))]


def check_measurement(t: Array, values: Array, name: str, table: Table) -> None:
    """Refuse a dead sensor and note what is missing."""
    rows, given = len(values), table.given[name]
    valid = ~np.isnan(values)
    count = int(valid.sum())
    if count == 0:
        table.notes.append(f"{given}: all {rows} cells empty, taken as never measured")
        return
    samples = values[valid]
    if count >= _CONSTANT_ROWS and (samples == samples[0]).all():
        last = rows - 1 - int(np.argmax(valid[::-1]))
        raise LogError(
            f"{table.source}: column {given}, {table.line(int(np.argmax(valid)))} to "
            f"{table.line(last)}: all {count} values are equal, as of a dead sensor; leave its "
            "cells empty or remove the column"
        )
    if count < rows:
        table.notes.append(
            f"{given}: {rows - count} of {rows} cells empty ({_longest_gap(t, valid)})"
        )
    if name in ("compass_rad", "wind_from_rad"):
        _check_angle(values, name, table)


def _in_degrees(name: str) -> str:
    """Return the remedy for degrees under a name of radians."""
    other = name.replace("_rad", "_deg")
    return f'name the column {other} (in a mapping: unit = "{other.rpartition("_")[2]}")'


def check_drive(values: Array, name: str, table: Table) -> None:
    """Refuse drive angles beyond half a turn."""
    if (most := np.abs(values).max()) > math.pi:
        row = int(np.argmax(np.abs(values)))
        raise LogError(
            f"{table.source}: column {table.given[name]}, {table.line(row)}: {name} is "
            f"{most:.4g} rad, more than half a turn; if these are degrees, {_in_degrees(name)}, "
            "else wrap the angle to within +-pi"
        )


def _check_angle(values: Array, name: str, table: Table) -> None:
    """Refuse an angle that steps as degrees do: unwrapped or not, radians step by less."""
    rows = np.flatnonzero(~np.isnan(values))
    with np.errstate(over="ignore"):
        step = np.diff(values[rows])
    # unwrapping that restarted steps by whole turns
    residual = np.abs(np.remainder(step + math.pi, 2.0 * math.pi) - math.pi)
    wild = (np.abs(step) > 2.1 * math.pi) & (residual > _WHOLE_TURN)
    if not wild.any():
        return
    given = table.given[name]
    worst = int(np.argmax(np.where(wild, np.abs(step), 0.0)))
    if (np.abs(np.abs(step[wild]) - 360.0) < 30.0).any() or wild.sum() > 0.01 * len(step):
        raise LogError(
            f"{table.source}: column {given}, {table.line(int(rows[worst + 1]))}: {name} steps by "
            f"{step[worst]:.4g} rad, as degrees do; {_in_degrees(name)}"
        )
    table.notes.append(
        f"{given}: {wild.sum()} step(s) of more than a turn; if these are degrees, "
        f"{_in_degrees(name)}"
    )


def check_turning(t: Array, z: Array, table: Table) -> None:
    """Refuse a heading or a yaw rate in degrees, where the motion tells."""
    seen = np.isfinite(z[:, [0, 4, 5]])
    fix, compass, gyro = (np.flatnonzero(column) for column in seen.T)
    if len(compass) < _CONSTANT_ROWS:
        return
    heading = z[compass, 4]
    if np.abs(heading).max() > 2.1 * math.pi and len(fix) >= _CONSTANT_ROWS:
        grid = _grid(t[fix])
        way = np.diff([np.interp(grid, t[fix], z[fix, j]) for j in (0, 1)])
        psi = heading[np.searchsorted(t[compass], grid[1:]).clip(max=len(compass) - 1)]
        length, course = np.hypot(*way), np.arctan2(way[1], way[0])
        ahead = [
            length @ np.cos(scale * psi - course) / max(length.sum(), 1e-9)
            for scale in (1.0, math.pi / 180.0)
        ]
        if ahead[0] < 0.5 and ahead[1] > 0.9:
            raise LogError(
                f"{table.source}: column {table.given['compass_rad']}: taken as degrees the boat "
                f"goes where it points, as radians not; {_in_degrees('compass_rad')}"
            )
    if len(gyro) >= _CONSTANT_ROWS:
        grid = _grid(t[compass])
        rate, step = z[gyro, 5], np.diff(t[gyro])
        angle = np.append(0.0, np.cumsum(0.5 * (rate[1:] + rate[:-1]) * step))
        turned_by_gyro = np.diff(np.interp(grid, t[gyro], angle))

        def ratio(psi: Array) -> float:
            """Return how many times as fast the gyro turns; 0 where they turn otherwise."""
            turned = np.diff(np.interp(grid, t[compass], np.unwrap(psi)))
            both, square = turned @ turned_by_gyro, turned @ turned
            similar = both > 0.9 * math.sqrt(square * (turned_by_gyro @ turned_by_gyro))
            return float(both / max(square, 1e-9)) if similar else 0.0

        times = ratio(heading)
        if 40.0 < times < 80.0:
            raise LogError(
                f"{table.source}: column {table.given['gyro_radps']}: {times:.3g} times "
                f"the rate at which the heading turns; {_in_degrees('gyro_radps')}"
            )
        beyond = np.abs(heading).max() > 2.1 * math.pi
        if beyond and not 0.5 < times < 2.0 and 0.5 < ratio(np.radians(heading)) < 2.0:
            raise LogError(
                f"{table.source}: column {table.given['compass_rad']}: taken as degrees it turns "
                f"as the yaw rate says, as radians not; {_in_degrees('compass_rad')}"
            )


def _grid(t: Array) -> Array:
    """Return times 2 s apart, or ten steps if those are longer."""
    step = max(2.0, 10.0 * float(np.median(np.diff(t))), (t[-1] - t[0]) / 1e5)
    return np.arange(t[0], t[-1], step)


def drop_jumps(t: Array, z: Array, table: Table) -> None:
    """Set fixes that no boat can reach from the others to NaN, in place; refuse many of them."""
    new = np.flatnonzero(np.isfinite(z[:, :2]).all(axis=1))
    if len(new) < 2:
        return
    place, at = z[new, :2], t[new]

    def reached(first: npt.NDArray[np.intp], then: int) -> npt.NDArray[np.bool_]:
        way = np.hypot(*(place[then] - place[first]).T)
        return np.asarray(way <= _JUMP + _FAST * (at[then] - at[first]), dtype=np.bool_)

    length = np.hypot(*np.diff(place, axis=0).T)
    broken = np.flatnonzero(length > _JUMP + _FAST * np.diff(at))
    if not len(broken):
        return
    row = int(broken[0])
    where = (
        f"{table.line(int(new[row + 1]))}: the position jumps by {length[row]:.4g} m in "
        f"{at[row + 1] - at[row]:.3g} s"
    )
    # The longest chain of pieces, each of which can be reached from the one before.
    start, end = np.append(0, broken + 1), np.append(broken, len(new) - 1)
    kept = (end - start + 1).astype(np.int64)
    before = np.full(len(start), -1)
    if len(start) <= _PIECES:
        for j in range(1, len(start)):
            chain = np.where(reached(end[:j], int(start[j])), kept[:j], 0)
            best = int(np.argmax(chain))
            if chain[best]:
                kept[j], before[j] = kept[j] + chain[best], best
    given = [table.given[name] for name in MEASUREMENTS[:2]]
    lost = len(new) - int(kept.max())
    if lost > _LOST * len(new):
        raise LogError(
            f"{table.source}: column(s) {', '.join(dict.fromkeys(given))}, "
            f"{where} and stays away; read the pieces one by one with start_s and stop_s in [rows] "
            "of a mapping file, or empty the false cells"
        )
    good = np.zeros(len(new), dtype=np.bool_)
    piece = int(np.argmax(kept))
    while piece >= 0:
        good[start[piece] : end[piece] + 1] = True
        piece = int(before[piece])
    z[new[~good], :2] = np.nan
    table.notes.append(
        f"gps_x_m, gps_y_m: {lost} of {len(new)} fixes cannot be reached from the others, left "
        f"out ({where})"
    )


def _repeated(values: Array) -> npt.NDArray[np.bool_]:
    """Return the rows of (N, k) values that equal the last complete row before them."""
    complete = np.flatnonzero(~np.isnan(values).any(axis=1))
    samples = values[complete]
    repeated = np.zeros(len(values), dtype=np.bool_)
    # Against the last valid sample, not the last row: reading twice changes nothing more.
    repeated[complete[1:]] = (samples[1:] == samples[:-1]).all(axis=1)
    return repeated


def drop_repeats(t: Array, z: Array, notes: list[str]) -> None:
    """Set samples that only repeat the last one to NaN, in place."""
    fix, velocity = slice(0, 2), slice(2, 4)
    compass = slice(4, 5)
    stale = _repeated(z[:, fix])
    parts = [
        (fix, stale, "fixes"),
        (velocity, stale & _repeated(z[:, velocity]), "velocities of repeated fixes"),
        (compass, _repeated(z[:, compass]), "values"),
    ]
    for part, repeated, what in parts:
        if repeated.any():
            total = int((~np.isnan(z[:, part]).any(axis=1)).sum())
            z[repeated, part] = np.nan
            gap = _longest_gap(t, ~repeated & np.isfinite(z[:, part.start]))
            notes.append(
                f"{', '.join(MEASUREMENTS[part])}: {repeated.sum()} of {total} {what} repeat the "
                f"last one, taken as no new sample ({gap})"
            )


def _longest_gap(t: Array, valid: npt.NDArray[np.bool_]) -> str:
    """Return the length and the start of the longest run of rows without a sample."""
    edge = np.diff(np.concatenate(([1], valid.astype(np.int8), [1])))
    first, after = np.flatnonzero(edge == -1), np.flatnonzero(edge == 1)
    # A run lasts until the next sample; at the end of the log, for one step beyond it.
    until = np.append(t, t[-1] + np.median(np.diff(t)))[after]
    longest = int(np.argmax(until - t[first]))
    return (
        f"longest gap {until[longest] - t[first[longest]]:.1f} s at t = {t[first[longest]]:.1f} s"
    )
