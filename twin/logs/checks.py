"""Checks and repairs of the columns of a log: time, commands, dead sensors, units, jumps."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from twin.channels import MEASUREMENTS, WIND_SPEED
from twin.logs.agreement import gyro_on_compass, heading_on_track
from twin.logs.clock import GAP_STEPS, set_back_remedy
from twin.logs.columns import Array
from twin.logs.datum import FEW
from twin.logs.errors import LogError
from twin.logs.jumps import find_jumps
from twin.logs.readers import Table
from twin.logs.recording import held, motion_of, repeated
from twin.logs.signals import ENOUGH, runs_of
from usv_kernel.channels import COMPASS, GYRO

__all__ = [
    "DEGREE",
    "check_drive",
    "check_measurement",
    "check_turning",
    "checked_time",
    "drop_jumps",
    "drop_repeats",
    "held_command",
    "in_degrees",
    "is_gap",
    "stream_end",
]

DEGREE = math.pi / 180.0

_WHOLE_TURN = 0.35
"""A step this near to whole turns is one of unwrapping, rad."""

_MANY = 0.01
"""Larger shares of such steps are no glitches."""

_COHERENT = 0.9
"""Signals with a larger correlation go with each other."""

_STOPPED = 1.0
"""Commands that are absent for longer may have stopped, s."""


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
        remedy = set_back_remedy(t, motion_of(table.data))
        if step[row - 1] == 0.0:
            remedy = "record fractions of a second, or keep one row of each time"
        raise LogError(
            f"{given}, {table.line(row)}: time does not increase ({t[row]:.10g} s after "
            f"{t[row - 1]:.10g} s); {remedy}"
        )
    gaps = is_gap(t)
    if gaps.any():
        row = int(np.argmax(step))
        table.notes.append(
            f"t_s: {gaps.sum()} time gap(s) above {GAP_STEPS:.0f} x the median step "
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
    return held(values)


def stream_end(t: Array, commands: Array, notes: list[str]) -> float:
    """Return when commands (m, N) stop for good before the log does, s; infinite if they do not.

    A log may hold each command until it changes. So the cells at the end must be empty for longer
    than :data:`_STOPPED` s, and for twice as long as any before.
    """
    given = t[~np.isnan(commands).any(axis=0)]
    if not len(given) or given[-1] == t[-1]:
        return math.inf
    longest = float(np.max(np.diff(given), initial=0.0))
    if t[-1] - given[-1] <= max(_STOPPED, 2.0 * longest):
        return math.inf
    notes.append(f"no command after t = {given[-1]:.1f} s, the last one held")
    return float(given[-1])


def check_measurement(t: Array, values: Array, name: str, table: Table) -> None:
    """Refuse a dead sensor, or leave out one of wind, roll, pitch, heave; note what is missing."""
    rows, given = len(values), table.given[name]
    valid = ~np.isnan(values)
    count = int(valid.sum())
    if count == 0:
        table.notes.append(f"{given}: all {rows} cells empty, taken as never measured")
        return
    samples = values[valid]
    dead = count >= ENOUGH and (samples == samples[0]).all()
    if dead and name in MEASUREMENTS[WIND_SPEED:]:
        values[:] = np.nan
        table.notes.append(
            f"{given}: all {count} values are equal, as of a dead sensor; taken as never measured"
        )
        return
    if dead:
        last = rows - 1 - int(np.argmax(valid[::-1]))
        raise LogError(
            f"{table.source}: column {given}, {table.line(int(np.argmax(valid)))} to "
            f"{table.line(last)}: all {count} values are equal, as of a dead sensor; leave its "
            "cells empty or remove the column"
        )
    if count < rows:
        note = f"{given}: no value in {rows - count} of {rows} rows ({_longest_gap(t, valid)})"
        if note not in table.notes:  # one column of the file may give two
            table.notes.append(note)
    if name in ("compass_rad", "wind_from_rad", "apparent_wind_rad"):
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
    wild = (np.abs(step) > 2.0 * math.pi + _WHOLE_TURN) & (residual > _WHOLE_TURN)
    if wild.sum() > _MANY * len(step):
        worst = int(np.argmax(np.where(wild, np.abs(step), 0.0)))
        raise LogError(
            f"{table.source}: column {table.given[name]}, {table.line(int(rows[worst + 1]))}: "
            f"{name} steps by {step[worst]:.4g} rad, as degrees do; {_in_degrees(name)}"
        )


def check_turning(t: Array, z: Array, table: Table) -> None:
    """Refuse a heading or a yaw rate that goes with the motion only if it is taken as degrees."""
    fix, compass, gyro = (np.isfinite(z[:, j]) for j in (0, COMPASS, GYRO))

    def goes(heading_unit: float, rate_unit: float) -> tuple[bool, bool]:
        """Return whether the heading goes with the track, and with the yaw rate."""
        heading = t[compass], heading_unit * z[compass, COMPASS]
        turning = t[gyro], rate_unit * z[gyro, GYRO]
        found = heading_on_track((t[fix], z[fix, :2]), heading), gyro_on_compass(*heading, *turning)
        by_track, by_gyro = (
            each is not None and each.coherence > _COHERENT and 0.5 < each.ratio < 2.0
            for each in found
        )
        return by_track, by_gyro

    as_radians = goes(1.0, 1.0)
    turns = np.abs(z[compass, COMPASS]).max(initial=0.0) > 2.0 * math.pi
    for name, units, why in (
        (
            "compass_rad",
            (DEGREE if turns else 1.0, 1.0),
            "as radians it does not go with the motion",
        ),
        ("gyro_radps", (1.0, DEGREE), "about 57 times the rate at which the heading turns"),
    ):
        if any(now and not was for now, was in zip(goes(*units), as_radians, strict=True)):
            raise LogError(
                f"{table.source}: column {table.given[name]}: {why}; {_in_degrees(name)}"
            )


def drop_jumps(t: Array, z: Array, table: Table) -> None:
    """Set fixes that no boat can reach from the others to NaN, in place; refuse many of them."""
    jumps = find_jumps(t, z[:, :2])
    if jumps is None:
        return
    lost = len(jumps.lost)
    where = (
        f"{table.line(jumps.after)}: the position jumps by {jumps.length:.4g} m in "
        f"{t[jumps.after] - t[jumps.before]:.3g} s"
    )
    given = _called(table, slice(0, 2))
    if lost > FEW * jumps.fixes:
        raise LogError(
            f"{table.source}: column(s) {given}, "
            f"{where} and stays away. Read the pieces one by one with start_s and stop_s in [rows] "
            "of a mapping file, or empty the false cells"
        )
    z[jumps.lost, :2] = np.nan
    table.notes.append(
        f"{given}: {lost} of {jumps.fixes} fixes cannot be reached from the others, left "
        f"out ({where})"
    )


def drop_repeats(t: Array, z: Array, table: Table) -> None:
    """Set samples that only repeat the last one to NaN, in place."""
    fix, velocity = slice(0, 2), slice(2, 4)
    compass = slice(4, 5)
    stale = repeated(z[:, fix])
    parts = [
        (fix, stale, "fixes"),
        (velocity, stale & repeated(z[:, velocity]), "velocities of repeated fixes"),
        (compass, repeated(z[:, compass]), "values"),
    ]
    for part, stands, what in parts:
        if stands.any():
            total = int((~np.isnan(z[:, part]).any(axis=1)).sum())
            z[stands, part] = np.nan
            gap = _longest_gap(t, ~stands & np.isfinite(z[:, part.start]))
            table.notes.append(
                f"{_called(table, part)}: {stands.sum()} of {total} {what} repeat the "
                f"last one, taken as no new sample ({gap})"
            )


def _called(table: Table, part: slice) -> str:
    """Return what the file calls measurements, each once."""
    return ", ".join(dict.fromkeys(table.given.get(name, name) for name in MEASUREMENTS[part]))


def _longest_gap(t: Array, valid: npt.NDArray[np.bool_]) -> str:
    """Return the length and the start of the longest run of rows without a sample."""
    # a run lasts until the next sample; at the end of the log, for one step beyond it
    until = np.append(t, t[-1] + np.median(np.diff(t)))
    runs = [(float(until[end] - t[first]), float(t[first])) for first, end in runs_of(~valid)]
    return "longest gap {:.1f} s at t = {:.1f} s".format(*max(runs, key=lambda run: run[0]))


def is_gap(t: Array) -> npt.NDArray[np.bool_]:
    """Return which steps of time are gaps, shape (N - 1,)."""
    step = np.diff(t)
    return np.asarray(step > GAP_STEPS * np.median(step))


def in_degrees(fix: Array) -> str:
    """Return why positions (N, 2) without NaN must be latitude and longitude, or nothing."""
    # a receiver without satellites writes (0, 0): this is no place of the boat
    fix = fix[fix.any(axis=1)]
    if len(fix) < ENOUGH:
        return ""
    middle, spread = np.abs(np.median(fix, axis=0)), np.ptp(fix, axis=0)
    if 0.0 < spread.max() < 0.2 and 100.0 * spread.max() < middle.max() <= 180.0:
        return (
            f"all lie within {spread.max():.2g} of ({np.median(fix[:, 0]):.5g}, "
            f"{np.median(fix[:, 1]):.5g}), as degrees of latitude and longitude do"
        )
    return ""
