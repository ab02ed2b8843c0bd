"""Which columns of an unknown log hold the position, and in which order."""

from __future__ import annotations

import json
import math

import numpy as np

from twin.channels import MEASUREMENTS
from twin.logs.checks import in_degrees
from twin.logs.columns import Array
from twin.logs.datum import Plane
from twin.logs.files import number_of
from twin.logs.proposal.agreement import heading_on_track
from twin.logs.proposal.header_words import NAMES, means, unit_of
from twin.logs.proposal.sheet import Columns, Proposal, add_line, clean, known, pick, put

__all__ = ["angle_unit", "find_position", "is_from_east", "place_degrees"]

_NMEA = 18060.0
"""Degrees and minutes in one number are below this."""


def find_position(columns: Columns, found: Proposal, t: Array | None) -> tuple[Array, Array] | None:
    """Find the position, and return times and metres north and east."""
    latitude, longitude = pick(columns, "latitude"), pick(columns, "longitude")
    if latitude is not None and longitude is not None:
        return place_degrees(columns, found, t, (latitude, longitude))
    _ask_texts(columns, found)
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
    put(columns, found, "gps_x_m", north, why="north?")
    put(columns, found, "gps_y_m", east, why="east?")
    return None if t is None else clean(t, fix)


def _ask_texts(columns: Columns, found: Proposal) -> None:
    """Name latitudes and longitudes that are texts."""
    for name in columns.left:
        if name in columns.numbers or not any(
            means(name, NAMES[meaning]) for meaning in ("latitude", "longitude")
        ):
            continue
        cell = next((cell for cell in columns.text[name] if number_of(cell) is None), None)
        if cell is not None:
            side = "south" if means(name, NAMES["latitude"]) else "west"
            found.questions.append(f"{name}: {cell!r} is no number; write degrees, {side} below 0")


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
    lat, lon = (columns.numbers[name] for name in names)
    most = [float(np.abs(known(each)).max(initial=0.0)) for each in (lat, lon)]
    if most[0] > 1e6 and most[1] <= 1.8e9:
        lat, lon = 1e-7 * lat, 1e-7 * lon
        most = [1e-7 * each for each in most]
        add_line(found, "position", "scale = 1e-7  # as MAVLink has them")
    if most[0] > 90.0 >= most[1]:
        found.questions.append(
            f"{names[0]} reaches {most[0]:.4g} degrees: latitude and longitude are swapped, and "
            "taken so"
        )
        names, (lat, lon), most = names[::-1], (lon, lat), most[::-1]
    elif most[0] > 90.0:
        nmea = most[0] < 9060.0 and most[1] < _NMEA
        found.questions.append(
            f"{names[0]} reaches {most[0]:.6g}, no latitude: convert it to degrees before"
            + " (NMEA has degrees and minutes in one number, ddmm.mm)" * nmea
        )
    for key, name in zip(("latitude", "longitude"), names, strict=True):
        add_line(found, "position", f"{key} = {json.dumps(columns.take(name), ensure_ascii=False)}")
    return None if t is None or most[0] > 90.0 else _metres(t, lat, lon)


def _metres(t: Array, lat: Array, lon: Array) -> tuple[Array, Array] | None:
    """Return times and metres north and east of the first fix, of degrees."""
    first = (lat != 0.0) & np.isfinite(lat) & np.isfinite(lon)
    if not first.any():
        return None
    plane = Plane(float(lat[first][0]), float(lon[first][0]))
    return clean(t, np.column_stack(plane.metres(lat, lon)))


def is_from_east(fix: tuple[Array, Array], heading: tuple[Array, Array]) -> bool | None:
    """Return whether the track says that a heading (rad) counts from east; None if it turns wrong.

    The same holds for a heading from north where latitude and longitude are swapped.
    """
    fit = heading_on_track(fix, heading)
    if fit is None or not (fit.mirrored > 0.7 and fit.mirrored > fit.coherence + 0.3):
        return False
    return True if abs(fit.mirror - 0.5 * math.pi) < 0.6 else None


def angle_unit(name: str, values: Array) -> str:
    """Return ``deg`` or ``rad``, from the name, else from the values."""
    most = float(np.abs(known(values)).max(initial=0.0))
    if most > 4.0 * math.pi:
        return "deg"
    return unit_of(name, ("deg", "rad")) or ("deg" if most > 2.0 * math.pi else "rad")
