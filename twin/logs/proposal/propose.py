"""A first mapping file for a log of unknown columns, from their names and values."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np

from twin.channels import COMMANDS, MEASUREMENTS
from twin.logs.agreement import Agreement, gyro_on_compass, heading_on_track, velocity_on_fixes
from twin.logs.autopilot.readers import is_autopilot_log
from twin.logs.checks import in_degrees
from twin.logs.clock import wild_stamps
from twin.logs.columns import OTHER_UNITS, SINGLE, UNITS, Array
from twin.logs.errors import LogError
from twin.logs.log import read_table
from twin.logs.proposal.commands import find_commands, find_pulses
from twin.logs.proposal.header_words import (
    NAMES,
    is_setpoint,
    is_shaft,
    is_steering,
    is_turn_rate,
    means,
    sides_of,
    unit_of,
    words_of,
)
from twin.logs.proposal.positions import angle_unit, find_position, is_from_east
from twin.logs.proposal.sheet import (
    Columns,
    Proposal,
    add_line,
    clean,
    entry,
    known,
    pick,
    put,
    read_columns,
)
from twin.logs.proposal.time_columns import find_time
from twin.logs.rosbag import is_bag

__all__ = ["Proposal", "propose"]


_FASTEST = 3.0
"""No boat turns faster for more than a moment, rad/s."""


def propose(path: str | Path, order: str = "", zone: str = "") -> Proposal:
    """Return a mapping for the columns of a CSV or Parquet file.

    Parameters
    ----------
    path : str or Path
        The log.
    order : str
        ``day-first`` or ``month-first``, where dates leave it open.
    zone : str
        By how much the clock is ahead of UTC, as ``-05:00``, where its name leaves it open.

    Returns
    -------
    Proposal
        With ``choices`` or ``zone`` where an answer is needed and not given.

    Raises
    ------
    LogError
        Where the file cannot be read.
    """
    path = Path(path)
    if is_bag(path) or is_autopilot_log(path):
        read_table(path)
        raise LogError(f"{path}: is read as it is, or by the mapping that it has")
    columns = read_columns(path)
    found = Proposal()
    t = _time(columns, found, (order, zone))
    own = _own_names(columns, found)
    if "gps_x_m" not in own:
        fix = find_position(columns, found, t)
    elif t is None or "gps_y_m" not in own:
        fix = None
    else:
        fix = clean(t, np.column_stack([own["gps_x_m"], own["gps_y_m"]]))
    if "gps_vx_mps" not in own and not _velocity(columns, found, t, fix):
        _components(columns, found, t, fix)
    if "compass_rad" not in own:
        heading = _heading(columns, found, t, fix)
    else:
        heading = None if t is None else clean(t, own["compass_rad"])
    if "gyro_radps" not in own:
        _gyro(columns, found, t, heading)
    _plain(columns, found)
    find_commands(columns, found, own)
    find_pulses(columns, found)
    text = [name for name in columns.left if name not in columns.numbers]
    plain = [name for name in columns.left if name in columns.numbers]
    for names, why in ((plain, ""), (text, " (empty, or no numbers)")):
        if names:
            shown = ", ".join(name.strip() or repr(name) for name in names)
            found.questions.append(f"left out{why}: {shown}")
    return found


def _time(columns: Columns, found: Proposal, answers: tuple[str, str]) -> Array | None:
    """Find the time, and return it in seconds."""
    time = find_time(columns.text, columns.numbers, columns.left, answers)
    found.questions += time.questions
    found.choices, found.zone = time.choices, time.zone
    if answers[1] and "zone =" not in time.more:
        found.questions.append(f"the times need no zone: {answers[1]} is left out")
    if not time.names:
        found.missing.append("t_s")
        return None
    *date, clock = [columns.take(name) for name in time.names]
    line = entry("t_s", clock, time.unit, time.more, time.why)
    if date:
        one, other = (json.dumps(name, ensure_ascii=False) for name in (date[0], clock))
        line = line.replace(f"from = {other}", f"from = [{one}, {other}]")
    add_line(found, "columns", line)
    if time.seconds is None or not (wild := wild_stamps(time.seconds)).any():
        return time.seconds
    row = int(np.argmax(wild))
    found.questions.append(
        f"{clock}: {wild.sum()} stamp(s) are far from all others (row {row + 1}: "
        f"{columns.text[clock][row].strip()}): the clock was not set there, their rows are left out"
    )
    return np.where(wild, np.nan, time.seconds)


_OTHER_NAMES = {"wind_true_mps": "wind_mps", "wind_true_from_rad": "wind_from_rad"}
"""Names of recorded data sets."""


def _own_names(columns: Columns, found: Proposal) -> dict[str, Array]:
    """Take the columns that have the names of this package, and return their values in SI units."""
    own: dict[str, Array] = {}
    degrees = _positions_in_degrees(columns)
    for name in [name for name in columns.left if name in columns.numbers]:
        if degrees and name in MEASUREMENTS[:2]:
            continue  # for [position]
        given = _OTHER_NAMES.get(name, name)
        target, factor = OTHER_UNITS.get(given, (given, 1.0))
        if target in (*COMMANDS, *SINGLE, *MEASUREMENTS) and target not in own:
            unit = "" if target == given else given.rpartition("_")[2]
            own[target] = factor * columns.numbers[name]
            put(columns, found, target, name, unit)
    for one, other in (("gps_x_m", "gps_y_m"), ("gps_vx_mps", "gps_vy_mps")):
        if (one in own) != (other in own):
            found.missing.append(other if one in own else one)
    return own


def _positions_in_degrees(columns: Columns) -> bool:
    """Return whether the columns that are named as metres hold latitude and longitude."""
    names = MEASUREMENTS[:2]
    if not all(name in columns.numbers and name in columns.left for name in names):
        return False
    fix = np.column_stack([columns.numbers[name] for name in names])
    return bool(in_degrees(fix[np.isfinite(fix).all(axis=1)]))


def _components(
    columns: Columns, found: Proposal, t: Array | None, fix: tuple[Array, Array] | None
) -> None:
    """Find velocities to north and east; the fixes tell the unit, and whether they are that."""
    north, east = pick(columns, "to_north"), pick(columns, "to_east")
    if north is None or east is None:
        return
    fit = None
    if t is not None and fix is not None:
        velocity = np.column_stack([columns.numbers[north], columns.numbers[east]])
        fit = velocity_on_fixes(fix, clean(t, velocity))
    sound = fit is not None and fit.coherence > 0.9 and abs(fit.turned) < 0.3
    unit = "" if fit is None or not sound else _speed_unit(fit.ratio)
    hundredths = fit is not None and sound and abs(100.0 * fit.ratio - 1.0) < 0.12
    if not unit and not hundredths:
        found.questions.append(
            f"{north}, {east}: are these m/s to north and east? The fixes do not say so"
        )
        return
    more = "scale = 0.01" if hundredths else ""
    for target, name in (("gps_vx_mps", north), ("gps_vy_mps", east)):
        given = "" if unit in ("", "mps") else unit
        put(columns, found, target, name, given, more, "as the fixes say")


def _velocity(
    columns: Columns, found: Proposal, t: Array | None, fix: tuple[Array, Array] | None
) -> bool:
    """Find speed and course over ground, if they are there; the fixes tell the speed's unit."""
    speed, course = pick(columns, "speed"), pick(columns, "course")
    if speed is None or course is None or speed == course:
        return False
    radians = angle_unit(course, columns.numbers[course]) == "rad"
    angle = columns.numbers[course] * (1.0 if radians else math.pi / 180.0)
    unit = unit_of(speed, ("kn", "kmph", "mps", "mph", "ftps"))
    why = ""
    if t is not None and fix is not None:
        value = columns.numbers[speed]
        velocity = np.column_stack([value * np.cos(angle), value * np.sin(angle)])
        fit = velocity_on_fixes(fix, clean(t, velocity))
        by_fixes = "" if fit is None else _speed_unit(fit.ratio)
        if by_fixes and unit and by_fixes != unit:
            found.questions.append(f"{speed}: named {unit}, but the fixes say {by_fixes}")
        if by_fixes:
            unit, why = by_fixes, "as the fixes say"
    if not unit:
        found.questions.append(f"{speed}: knots or m/s? m/s is taken")
    given = "" if unit in ("", "mps") else unit
    put(columns, found, "speed", speed, given, why=why, table="velocity")
    put(columns, found, "course", course, "" if radians else "deg", table="velocity")
    return True


def _speed_unit(ratio: float) -> str:
    """Return the unit of a speed that is so many times too small."""
    off = {unit: abs(ratio / scale - 1.0) for unit, scale in UNITS["mps"].items()}
    nearest = min(off, key=lambda unit: off[unit])
    return nearest if off[nearest] < 0.12 else ""


def _heading(
    columns: Columns, found: Proposal, t: Array | None, fix: tuple[Array, Array] | None
) -> tuple[Array, Array] | None:
    """Find the heading; the track tells whether it counts from east. Return it in rad."""
    name = pick(columns, "heading")
    if name is None:
        found.missing.append("compass_rad")
        return None
    if means(name, NAMES["magnetic"]):
        found.questions.append(
            f"{name}: from magnetic north? Then add the variation, east above 0, to its offset, rad"
        )
    values, more, why = columns.numbers[name], "", ""
    most = float(np.abs(known(values)).max(initial=0.0))
    scale = 1.0 if not 3000.0 < most <= 36000.0 else 0.1 if most <= 3600.0 else 0.01
    unit, degree = angle_unit(name, values), math.pi / 180.0
    if unit == "deg" and t is not None and fix is not None:
        ways = {("deg", part): part * degree for part in (1.0, 0.1, 0.01)}
        ways |= {} if unit_of(name, ("deg",)) else {("rad", 1.0): 1.0}
        fits = {way: heading_on_track(fix, clean(t, k * values)) for way, k in ways.items()}
        goes = {way: 0.0 if f is None else max(f.coherence, f.mirrored) for way, f in fits.items()}
        best = max(goes, key=lambda way: goes[way])
        if goes[best] > goes[unit, scale] + 0.3:
            unit, scale = best
            why = (
                "as the track says" if unit == "deg" else "turns are counted on, as the track says"
            )
    more = f"scale = {scale:g}" * (scale < 1.0)
    values = scale * values * (degree if unit == "deg" else 1.0)
    heading = None if t is None else clean(t, values)
    east = False if heading is None or fix is None else is_from_east(fix, heading)
    if east is None:
        found.questions.append(
            f"{name}: turns against the track; check its sign, or that of latitude or longitude"
        )
    elif east and heading is not None:
        more = f"{more}, " * bool(more) + 'frame = "enu"'
        why = "it counts from east, as the track says"
        axes = "latitude and longitude" if "position" in found.lines else "north and east"
        found.questions.append(f"{name}: counts from east, or {axes} are swapped")
        heading = heading[0], 0.5 * math.pi - heading[1]
    put(columns, found, "compass_rad", name, "deg" if unit == "deg" else "", more, why)
    return heading


def _gyro(
    columns: Columns, found: Proposal, t: Array | None, heading: tuple[Array, Array] | None
) -> None:
    """Find the yaw rate; the heading tells which it is, its unit and sign."""
    best: Agreement | None = None
    name, unit, more, why = pick(columns, "gyro"), "", "", ""
    scale = {"radps": 1.0, "degps": math.pi / 180.0, "degpmin": math.pi / 10800.0}
    # without a unit, turn is what steers, where nothing else does
    there = [each for each in columns.left if each in columns.numbers]
    steered = sum(map(is_steering, there)) > 1 or sides_of([*filter(is_shaft, there)]) is not None
    for each in there:
        plain = is_steering(each) and not is_setpoint(each) and "turn" in words_of(each)
        named = means(each, NAMES["gyro"]) or is_turn_rate(each) or (plain and steered)
        if not named or t is None or heading is None:
            continue
        fit = gyro_on_compass(*heading, *clean(t, columns.numbers[each]))
        if fit is None:
            continue
        sure = fit.coherence > 0.8
        says = [u for u, size in scale.items() if sure and 0.7 < fit.ratio * size < 1.4]
        if (plain and not says) or (best and best.coherence >= fit.coherence):
            continue
        best, name, unit, more = fit, each, "".join(says), ""
        why = "as the heading says" if says else ""
        if sure and abs(fit.turned) > 1.0:
            more, why = "scale = -1.0", "it turns against the heading"
    if name is None:
        return
    if best is not None and best.coherence <= 0.8:
        found.questions.append(f"{name}: does not turn as the heading does; is it the yaw rate?")
    elif best is not None and not unit:
        found.questions.append(
            f"{name}: turns as the heading does, but in which unit? By that, scale = "
            f"{1.0 / best.ratio:.3g}"
        )
    unit = unit or unit_of(name, ("degpmin", "degps", "radps"))
    if heading is None and not unit:
        if float(np.quantile(np.abs(known(columns.numbers[name])), 0.99)) > _FASTEST:
            unit, why = "degps", "by its size"
        else:
            found.questions.append(f"{name}: deg/s or rad/s? rad/s is taken")
    given = "" if unit in ("", "radps") else unit
    put(columns, found, "gyro_radps", name, given, more, why)


_NAMED = (
    ("gyro_x_radps", "gyro_x", ("degps",)),
    ("gyro_y_radps", "gyro_y", ("degps",)),
    ("accel_x_mps2", "accel_x", ("g",)),
    ("accel_y_mps2", "accel_y", ("g",)),
    ("accel_z_mps2", "accel_z", ("g",)),
    ("wind_mps", "wind_speed", ("kn", "kmph", "mps")),
    ("apparent_wind_mps", "apparent_speed", ("kn", "kmph", "mps")),
    ("gps_z_m", "height", ("ft",)),
    ("gps_vz_mps", "climb", ("kn", "ftps")),
)
"""Columns whose unit is in the name, if it is not that of the log: meaning, and those units."""


def _has_unit(found: Proposal, target: str, unit: str) -> bool:
    """Return whether a column that was found has a unit."""
    lines = [*found.lines.get("columns", []), *found.lines.get("velocity", [])]
    return any(line.startswith(f"{target} =") and f'unit = "{unit}"' in line for line in lines)


def _plain(columns: Columns, found: Proposal) -> None:
    """Find what needs no other column; ``usv-twin check`` tells whether signs are right."""
    for target, meaning in (("ahrs_roll_rad", "roll"), ("ahrs_pitch_rad", "pitch")):
        name = pick(columns, meaning)
        if name is not None:
            steep = np.abs(known(columns.numbers[name])).max(initial=0.0) > 0.5 * math.pi
            unit = "deg" if steep else unit_of(name, ("deg", "rad"))
            if not unit:  # a boat may heel by so many degrees, and by so many radians
                unit = "deg" if _has_unit(found, "compass_rad", "deg") else "rad"
                found.questions.append(f"{name}: deg or rad? {unit} is taken, as of the heading")
            put(columns, found, target, name, "deg" * (unit == "deg"))
    vertical = pick(columns, "accel_z")
    force = 0.0 if vertical is None else float(np.median(known(columns.numbers[vertical])))
    for target, meaning, units in _NAMED:
        name = pick(columns, meaning)
        if name is None:
            continue
        unit, more, why = unit_of(name, units), "", ""
        if not unit and meaning in ("gyro_x", "gyro_y") and not unit_of(name, ("radps",)):
            unit = "degps" * _has_unit(found, "gyro_radps", "degps")
            found.questions.append(f"{name}: deg/s or rad/s? {unit or 'radps'} is taken")
        elif not unit and meaning in ("wind_speed", "apparent_speed"):
            unit = "kn" if _has_unit(found, "speed", "kn") else "mps"
            found.questions.append(f"{name}: m/s or knots? {unit} is taken, as of the boat's speed")
        elif meaning.startswith("accel"):
            if vertical is None and not unit and not unit_of(name, ("mps2",)):
                found.questions.append(f"{name}: g or m/s2? m/s2 is taken")
            unit = "g" if unit or 0.5 < abs(force) < 2.0 or 500.0 < abs(force) < 2e3 else ""
            scale = 0.001 if abs(force) > 500.0 else 1.0  # thousandths
            if name == vertical and force > 0.0:
                scale, why = -scale, "it points up"
            more = f"scale = {scale}" * (scale != 1.0)
        elif meaning in ("height", "climb"):
            more, why = "scale = -1.0", "down is above 0"
        put(columns, found, target, name, unit.removeprefix("mps"), more, why)
    for target, meaning in (("wind_from_rad", "wind_from"), ("apparent_wind_rad", "apparent_from")):
        name = pick(columns, meaning)
        if name is not None:
            unit = angle_unit(name, columns.numbers[name])
            put(columns, found, target, name, "deg" if unit == "deg" else "")
