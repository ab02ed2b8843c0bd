"""Which columns of an unknown log hold the position, and in which order."""

from __future__ import annotations

import json
import math
from collections.abc import Callable

import numpy as np

from twin.channels import MEASUREMENTS
from twin.logs.agreement import heading_on_track, turns_as_driven, velocity_on_fixes
from twin.logs.checks import in_degrees
from twin.logs.columns import Array
from twin.logs.datum import Plane, from_minutes, in_minutes, odd_minutes
from twin.logs.files import hemispheres
from twin.logs.proposal.header_words import is_shaft, sides_of, unit_of
from twin.logs.proposal.sheet import (
    Columns,
    Proposal,
    add_line,
    clean,
    entry,
    is_pulses,
    known,
    pick,
    put,
)

__all__ = ["angle_unit", "find_position", "is_from_east", "place_degrees"]


def find_position(columns: Columns, found: Proposal, t: Array | None) -> tuple[Array, Array] | None:
    """Find the position, and return times and metres north and east."""
    latitude, longitude = pick(columns, "latitude"), pick(columns, "longitude")
    if latitude is not None and longitude is not None:
        return place_degrees(columns, found, t, (latitude, longitude))
    north, east = pick(columns, "north"), pick(columns, "east")
    if all(name in columns.left and name in columns.numbers for name in MEASUREMENTS[:2]):
        north, east = MEASUREMENTS[:2]
    if north is None or east is None:
        found.missing += ["gps_x_m", "gps_y_m"]
        return None
    fix = np.column_stack([columns.numbers[north], columns.numbers[east]])
    if in_degrees(fix[np.isfinite(fix).all(axis=1)]):
        found.questions.append(f"{north}, {east}: degrees of latitude and longitude, by their size")
        return place_degrees(columns, found, t, (north, east))
    lat, lon = fix.T
    if _is_swapped(columns, t, lat, lon, _level) or _is_swapped_by_heading(
        columns, t, lat, lon, _level
    ):
        found.questions.append(f"{north} is east and {east} north, as course or commands say")
        north, east, fix = east, north, fix[:, ::-1]
    put(columns, found, "gps_x_m", north, why="north?")
    put(columns, found, "gps_y_m", east, why="east?")
    return None if t is None else clean(t, fix)


def place_degrees(
    columns: Columns, found: Proposal, t: Array | None, names: tuple[str, str]
) -> tuple[Array, Array] | None:
    """Write the table [position], and return times and metres north and east.

    Parameters
    ----------
    columns : Columns
        Of the log.
    found : Proposal
        Gets the table, and questions.
    t : ndarray, shape (N,), or None
        Time, s.
    names : tuple of str
        Columns of latitude and longitude, by their names.
    """
    sides = [_hemisphere(columns, letters) for letters in ("NS", "EW")]
    for name in columns.left if sides[1] is None else ():
        cells = {cell.strip().upper() for cell in columns.text[name]}
        if "O" in cells and cells <= {"O", "E", "W", ""}:
            found.questions.append(
                f'{columns.take(name)}: is "O" east, as in German, or west, as in French? '
                "Longitudes are taken as they are; write E and W there, or, if all are west, give "
                f"{names[1]} scale = -1.0"
            )
            break
    lat, lon = (
        columns.numbers[name] if side is None else np.abs(columns.numbers[name]) * side[1]
        for name, side in zip(names, sides, strict=True)
    )
    # most of them: a receiver without a fix says 91 and 181 degrees
    most = [float(np.quantile(np.append(0.0, np.abs(known(each))), 0.75)) for each in (lat, lon)]
    if most[0] > 1e6 and most[1] <= 1.8e9:
        lat, lon = 1e-7 * lat, 1e-7 * lon
        most = [1e-7 * each for each in most]
        add_line(found, "position", "scale = 1e-7  # as MAVLink has them")
    if 0.0 < most[0] <= 0.5 * math.pi and 0.0 < most[1] <= math.pi:
        found.questions.append(
            f"{names[0]}, {names[1]}: radians, by their size; else drop the scale"
        )
        add_line(found, "position", f"scale = {180.0 / math.pi!r}  # radians")
        lat, lon = np.degrees(lat), np.degrees(lon)
        most = [math.degrees(each) for each in most]
    swapped = ""
    if most[0] > 180.0 and in_minutes(lat, lon):
        add_line(found, "position", 'unit = "ddmm"  # degrees and minutes, as NMEA has them')
        for name, values, limit in zip(names, (lat, lon), (9000.0, 18000.0), strict=True):
            if len(rows := np.flatnonzero(odd_minutes(values, limit))):
                found.questions.append(
                    f"{name}: {len(rows)} cell(s) are no degrees and minutes (row {rows[0] + 1}: "
                    f"{columns.text[name][rows[0]].strip()}): empty them"
                )
        lat, lon = from_minutes(lat), from_minutes(lon)
        most = [0.01 * each for each in most]
    if most[0] > 90.0 >= most[1]:
        swapped = (
            f"{names[0]} reaches {most[0]:.4g} degrees: latitude and longitude are swapped, and "
            "taken so"
        )
    elif most[0] > 90.0:
        found.questions.append(
            f"{names[0]} reaches {most[0]:.6g}, no latitude: convert it to degrees before"
        )
    elif _is_swapped(columns, t, lat, lon):
        swapped = (
            f"{names[0]}, {names[1]}: the course over ground goes with them only if latitude "
            "and longitude are swapped, and they are taken so"
        )
    elif _is_swapped_by_heading(columns, t, lat, lon):
        swapped = (
            f"{names[0]}, {names[1]}: heading and commands go with them only if latitude and "
            "longitude are swapped, and they are taken so"
        )
    if swapped:
        found.questions.append(swapped)
        names, (lat, lon), most = names[::-1], (lon, lat), most[::-1]
        sides = sides[::-1]
    for key, name, side in zip(("latitude", "longitude"), names, sides, strict=True):
        more = (
            f"hemisphere = {json.dumps(columns.take(side[0]), ensure_ascii=False)}" if side else ""
        )
        add_line(found, "position", entry(key, columns.take(name), more=more))
    return None if t is None or most[0] > 90.0 else _metres(t, lat, lon)


def _hemisphere(columns: Columns, letters: str) -> tuple[str, Array] | None:
    """Return the column of north and south, or of east and west, and its signs, if there is one."""
    for name in columns.left:
        cells = columns.text[name] if name not in columns.numbers else []
        words = {cell.strip()[:1].upper() for cell in cells} - {""}
        if words and words <= {*letters} and (signs := hemispheres(cells)):
            return name, np.array(signs, dtype=np.float64)
    return None


_Place = Callable[[Array, Array, Array], tuple[Array, Array] | None]


def _metres(t: Array, lat: Array, lon: Array) -> tuple[Array, Array] | None:
    """Return times and metres north and east of the first fix, of degrees."""
    first = (lat != 0.0) & (np.abs(lat) <= 90.0) & np.isfinite(lon)
    if not first.any():
        return None
    plane = Plane(float(lat[first][0]), float(lon[first][0]))
    return clean(t, np.column_stack(plane.metres(lat, lon)))


def _level(t: Array, north: Array, east: Array) -> tuple[Array, Array]:
    """Return times and metres of positions that are metres."""
    return clean(t, np.column_stack([north, east]))


def _is_swapped(
    columns: Columns, t: Array | None, lat: Array, lon: Array, place: _Place = _metres
) -> bool:
    """Return whether speed and course over ground say that latitude and longitude are swapped."""
    speed, course = pick(columns, "speed"), pick(columns, "course")
    if t is None or speed is None or course is None or speed == course:
        return False
    angle = columns.numbers[course]
    angle = angle if angle_unit(course, angle) == "rad" else np.radians(angle)
    value = columns.numbers[speed]
    velocity = clean(t, np.column_stack([value * np.cos(angle), value * np.sin(angle)]))
    coherence = []
    for one, other in ((lat, lon), (lon, lat)):
        if place is _metres and np.abs(known(one)).max(initial=0.0) > 90.0:
            return False
        fix = place(t, one, other)
        fit = None if fix is None else velocity_on_fixes(fix, velocity)
        aligned = fit is not None and abs(fit.turned) < 0.3
        coherence.append(fit.coherence if fit is not None and aligned else 0.0)
    return coherence[1] > 0.9 and coherence[0] < 0.6


def is_from_east(fix: tuple[Array, Array], heading: tuple[Array, Array]) -> bool | None:
    """Return whether the track says that a heading (rad) counts from east; None if it turns wrong.

    The same holds for a heading from north where latitude and longitude are swapped.
    """
    fit = heading_on_track(fix, heading)
    if fit is None or not (fit.mirrored > 0.7 and fit.mirrored > fit.coherence + 0.3):
        return False
    return True if abs(fit.mirror - 0.5 * math.pi) < 0.6 else None


def _is_swapped_by_heading(
    columns: Columns, t: Array | None, lat: Array, lon: Array, place: _Place = _metres
) -> bool:
    """Return whether the heading counts from east by the track, but from north by the shafts.

    More thrust to port increases a heading that runs clockwise from north.
    """
    name = pick(columns, "heading")
    fix = None if t is None else place(t, lat, lon)
    beyond = place is _metres and np.abs(known(lon)).max(initial=0.0) > 90.0
    if t is None or fix is None or name is None or beyond:
        return False
    values = columns.numbers[name]
    if np.abs(known(values)).max(initial=0.0) > 3000.0:
        values = 0.01 * values
    angle = values if angle_unit(name, values) == "rad" else np.radians(values)
    if not is_from_east(fix, clean(t, angle)):
        return False
    there = [n for n in columns.left if n in columns.numbers and is_shaft(n)]
    sides = sides_of(there)
    if sides is None:
        return False
    thrust = []
    for each in sides:
        shaft = columns.numbers[each]
        n = shaft - 1500.0 * is_pulses(shaft)
        thrust.append(n * np.abs(n))
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        return turns_as_driven(t, angle, thrust[0] - thrust[1])


def angle_unit(name: str, values: Array) -> str:
    """Return ``deg`` or ``rad``, from the name, else from the values."""
    most = float(np.abs(known(values)).max(initial=0.0))
    if most > 4.0 * math.pi:
        return "deg"
    return unit_of(name, ("deg", "rad")) or ("deg" if most > 2.0 * math.pi else "rad")
