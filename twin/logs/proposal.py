"""A first mapping file for a log of unknown columns, from their names and values."""

from __future__ import annotations

import gzip
import io
import json
import math
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from twin.channels import COMMANDS, MEASUREMENTS
from twin.logs.columns import OTHER_UNITS, SINGLE, Array
from twin.logs.dates import DateFormat
from twin.logs.datum import radii
from twin.logs.diagnosis.heading import gyro_on_compass
from twin.logs.diagnosis.position import velocity_on_fixes
from twin.logs.diagnosis.track import compass_on_track
from twin.logs.errors import LogError
from twin.logs.header_words import (
    NAMES,
    SHAFT,
    STEER,
    is_command,
    is_side,
    means,
    sides_of,
    unit_of,
    words_of,
)
from twin.logs.readers import CsvFile, ParquetFile, ragged_line, with_points
from twin.logs.time_proposal import find_time

if TYPE_CHECKING:
    import polars as pl

__all__ = [
    "Proposal",
    "propose",
]

_ROWS, _LOOK = 200_000, 1000
"""Rows that are looked at, and those whose cells are counted."""


@dataclass
class Proposal:
    """A mapping file to begin with.

    Parameters
    ----------
    lines : dict of str to list of str
        Lines of each table of the file.
    missing : list of str
        What each log needs, and no column seems to hold.
    questions : list of str
        What the values leave open.
    choices : list of DateFormat
        Two formats, where day and month are open.
    zone : str
        The name of a zone, where it means several.
    """

    lines: dict[str, list[str]] = field(default_factory=dict)
    missing: list[str] = field(default_factory=list)
    questions: list[str] = field(default_factory=list)
    choices: list[DateFormat] = field(default_factory=list)
    zone: str = ""

    def text(self, source: str) -> str:
        """Return the text of the mapping file."""
        out = [f"# Proposed for {source} by usv-twin mapping new: check every line."]
        out += [f"# ? {question}" for question in self.questions]
        for table in ("columns", "position", "velocity"):
            rows = list(self.lines.get(table, []))
            if table == "columns":
                rows += [f"# {name} = ?    # no column seems to hold it" for name in self.missing]
            if rows:
                out += ["", f"[{table}]", *rows]
        return "\n".join(out) + "\n"


@dataclass
class _Columns:
    """Cells of a file: as text, and as numbers where they are numbers."""

    text: pl.DataFrame
    numbers: dict[str, Array]
    left: list[str]

    def take(self, name: str) -> str:
        self.left.remove(name)
        return name


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
    columns = _read(path)
    found = Proposal()
    t = _time(columns, found, (order, zone))
    own = _own_names(columns, found)
    fix = own.position(t) if own.has("gps_x_m") else _position(columns, found, t)
    if not own.has("gps_vx_mps") and not _velocity(columns, found, t, fix):
        _components(columns, found, t, fix)
    heading = own.heading(t) if own.has("compass_rad") else _heading(columns, found, t, fix)
    if not own.has("gyro_radps"):
        _gyro(columns, found, t, heading)
    _motion(columns, found)
    _plain(columns, found)
    _commands(columns, found, own)
    _pulses(columns, found)
    if columns.left:
        found.questions.append(f"left out: {', '.join(columns.left)}")
    return found


def _read(path: Path) -> _Columns:
    """Return the cells of the first rows of a file."""
    import polars as pl

    if path.suffix == ".parquet":
        frame = pl.scan_parquet(ParquetFile(path).path, glob=False).head(_ROWS).collect()
        frame = frame.with_columns(pl.all().cast(pl.String))
    else:
        file = CsvFile(path)
        with gzip.open(path, "rb") if file.packed else path.open("rb") as raw:
            for _ in range(file.blank):
                raw.readline()
            lines = [raw.readline() for _ in range(_ROWS)]
        # a surplus comma would shift the cells: of "Fri, 05 Apr", or of seconds with a comma
        ragged = ragged_line(b"".join(lines[1:_LOOK]), file.blank + 2, len(file.header), file.mark)
        if ragged:
            raise LogError(f"{path}: {ragged}, or put cells that hold a comma in quotes")
        try:
            frame = pl.read_csv(
                io.BytesIO(b"".join(lines)),
                infer_schema=False,
                separator=file.mark,
                encoding="utf8-lossy",
                truncate_ragged_lines=True,
            )
            frame = frame if file.mark == "," else with_points(frame)
        except pl.exceptions.PolarsError as error:
            raise LogError(f"{path}: {str(error).splitlines()[0]}") from None
        frame = frame.rename({name: name.strip() for name in frame.columns})
    numbers = {}
    for name in frame.columns:
        cells = frame[name].str.strip_chars()
        values = cells.cast(pl.Float64, strict=False)
        filled = int((cells.is_not_null() & (cells != "")).sum())
        if filled and values.is_not_null().sum() > 9 * filled // 10:
            numbers[name] = values.to_numpy().astype(np.float64, copy=False)
    return _Columns(frame, numbers, list(frame.columns))


def _pick(columns: _Columns, meaning: str, *, numeric: bool = True) -> str | None:
    """Return the first column of a meaning, shorter names first."""
    there = [
        name
        for name in columns.left
        if (name in columns.numbers or not numeric)
        and means(name, NAMES[meaning])
        and "rpm" not in words_of(name)  # the r of rpm_r is a side
    ]
    exact = [name for name in there if re.fullmatch(NAMES[meaning], "".join(words_of(name)[:1]))]
    return min(exact or there, key=lambda name: len(words_of(name)), default=None)


def _entry(name: str, source: str, unit: str = "", more: str = "", why: str = "") -> str:
    """Return a line of a table."""
    parts = [f"from = {json.dumps(source, ensure_ascii=False)}"]
    parts += [f'unit = "{unit}"'] if unit else []
    parts += [more] if more else []
    value = f"{{ {', '.join(parts)} }}" if len(parts) > 1 else parts[0].removeprefix("from = ")
    return f"{name} = {value}" + (f"  # {why}" if why else "")


def _add(found: Proposal, table: str, line: str) -> None:
    found.lines.setdefault(table, []).append(line)


def _time(columns: _Columns, found: Proposal, answers: tuple[str, str]) -> Array | None:
    """Find the time, and return it in seconds."""
    time = find_time(columns.text, columns.numbers, columns.left, answers)
    found.questions += time.questions
    found.choices, found.zone = time.choices, time.zone
    if not time.names:
        found.missing.append("t_s")
        return None
    *date, clock = [columns.take(name) for name in time.names]
    line = _entry("t_s", clock, time.unit, time.more, time.why)
    if date:
        two = f"from = [{json.dumps(date[0])}, {json.dumps(clock)}]"
        line = line.replace(f"from = {json.dumps(clock, ensure_ascii=False)}", two)
    _add(found, "columns", line)
    return time.seconds


def _known(values: Array) -> Array:
    return values[np.isfinite(values)]


@dataclass
class _Own:
    """Columns that have the names of a log of this package, in SI units."""

    values: dict[str, Array] = field(default_factory=dict)

    def has(self, name: str) -> bool:
        return name in self.values

    def position(self, t: Array | None) -> tuple[Array, Array] | None:
        if t is None or not self.has("gps_y_m"):
            return None
        return _clean(t, np.column_stack([self.values["gps_x_m"], self.values["gps_y_m"]]))

    def heading(self, t: Array | None) -> tuple[Array, Array] | None:
        return None if t is None else _clean(t, self.values["compass_rad"])


_OTHER_NAMES = {"wind_true_mps": "wind_mps", "wind_true_from_rad": "wind_from_rad"}
"""Names of recorded data sets."""


def _own_names(columns: _Columns, found: Proposal) -> _Own:
    """Take the columns that have the names of this package: as they are, or in degrees or rpm."""
    own = _Own()
    for name in [name for name in columns.left if name in columns.numbers]:
        given = _OTHER_NAMES.get(name, name)
        target, factor = OTHER_UNITS.get(given, (given, 1.0))
        if target in (*COMMANDS, *SINGLE, *MEASUREMENTS) and not own.has(target):
            unit = "" if target == given else given.rpartition("_")[2]
            own.values[target] = factor * columns.numbers[name]
            _add(found, "columns", _entry(target, columns.take(name), unit))
    for one, other in (("gps_x_m", "gps_y_m"), ("gps_vx_mps", "gps_vy_mps")):
        if own.has(one) != own.has(other):
            found.missing.append(other if own.has(one) else one)
    return own


def _position(columns: _Columns, found: Proposal, t: Array | None) -> tuple[Array, Array] | None:
    """Find the position, and return times and metres north and east."""
    latitude, longitude = _pick(columns, "latitude"), _pick(columns, "longitude")
    if latitude is not None and longitude is not None:
        lat, lon = columns.numbers[latitude], columns.numbers[longitude]
        most = float(np.abs(_known(lat)).max(initial=0.0))
        if most > 1e6 and float(np.abs(_known(lon)).max(initial=0.0)) <= 1.8e9:
            lat, lon, most = 1e-7 * lat, 1e-7 * lon, 1e-7 * most
            _add(found, "position", "scale = 1e-7  # as MAVLink has them")
        if most > 90.0 and float(np.abs(_known(lon)).max()) <= 90.0:
            found.questions.append(
                f"{latitude} reaches {most:.4g} degrees: latitude and longitude are swapped, and "
                "taken so"
            )
            latitude, longitude, lat, lon = longitude, latitude, lon, lat
        elif most > 90.0:
            found.questions.append(
                f"{latitude} reaches {most:.6g}: convert it to degrees before (NMEA has degrees "
                "and minutes in one number)"
            )
        elif _is_swapped(columns, t, lat, lon):
            found.questions.append(
                f"{latitude}, {longitude}: the course over ground goes with them only if latitude "
                "and longitude are swapped, and they are taken so"
            )
            latitude, longitude, lat, lon = longitude, latitude, lon, lat
        rows = [
            f"{key} = {json.dumps(columns.take(name), ensure_ascii=False)}"
            for key, name in (("latitude", latitude), ("longitude", longitude))
        ]
        for row in rows:
            _add(found, "position", row)
        return None if t is None or most > 90.0 else _metres(t, lat, lon)
    for name in columns.left:
        if name not in columns.numbers and means(name, NAMES["latitude"]):
            cell = columns.text[name].drop_nulls().first()
            found.questions.append(f"{name}: {cell!r} is no number; write degrees, south below 0")
    north, east = _pick(columns, "north"), _pick(columns, "east")
    if north is None or east is None:
        found.missing += ["gps_x_m", "gps_y_m"]
        return None
    _add(found, "columns", _entry("gps_x_m", columns.take(north), why="north?"))
    _add(found, "columns", _entry("gps_y_m", columns.take(east), why="east?"))
    if t is None:
        return None
    return _clean(t, np.column_stack([columns.numbers[north], columns.numbers[east]]))


def _metres(t: Array, lat: Array, lon: Array) -> tuple[Array, Array] | None:
    """Return times and metres north and east of the first fix, of degrees."""
    first = (lat != 0.0) & np.isfinite(lat) & np.isfinite(lon)
    if not first.any():
        return None
    to_north, to_east = radii(float(lat[first][0]))
    north = np.radians(lat - lat[first][0]) * to_north
    return _clean(t, np.column_stack([north, np.radians(lon - lon[first][0]) * to_east]))


def _is_swapped(columns: _Columns, t: Array | None, lat: Array, lon: Array) -> bool:
    """Return whether speed and course over ground say that latitude and longitude are swapped."""
    speed, course = _pick(columns, "speed"), _pick(columns, "course")
    if t is None or speed is None or course is None or speed == course:
        return False
    angle = columns.numbers[course]
    angle = angle if _angle_unit(course, angle) == "rad" else np.radians(angle)
    value = columns.numbers[speed]
    velocity = _clean(t, np.column_stack([value * np.cos(angle), value * np.sin(angle)]))
    coherence = []
    for one, other in ((lat, lon), (lon, lat)):
        if np.abs(_known(one)).max(initial=0.0) > 90.0:
            return False
        fix = _metres(t, one, other)
        fit = None if fix is None else velocity_on_fixes(fix, velocity)
        aligned = fit is not None and abs(fit.turned) < 0.3
        coherence.append(fit.coherence if fit is not None and aligned else 0.0)
    return coherence[1] > 0.9 and coherence[0] < 0.6


def _clean(t: Array, values: Array) -> tuple[Array, Array]:
    """Return the rows whose time advances and whose values are new."""
    table = values if values.ndim == 2 else values[:, None]
    ok = np.isfinite(t) & np.isfinite(table).all(axis=1)
    t, values, table = t[ok], values[ok], table[ok]
    new = np.ones(len(t), dtype=np.bool_)
    new[1:] = t[1:] > np.maximum.accumulate(t)[:-1]
    new[1:] &= (table[1:] != table[:-1]).any(axis=1)
    return t[new], values[new]


def _components(
    columns: _Columns, found: Proposal, t: Array | None, fix: tuple[Array, Array] | None
) -> None:
    """Find velocities to north and east; the fixes tell the unit, and whether they are that."""
    north, east = _pick(columns, "to_north"), _pick(columns, "to_east")
    if north is None or east is None:
        return
    fit = None
    if t is not None and fix is not None:
        velocity = np.column_stack([columns.numbers[north], columns.numbers[east]])
        fit = velocity_on_fixes(fix, _clean(t, velocity))
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
        _add(found, "columns", _entry(target, columns.take(name), given, more, "as the fixes say"))


def _velocity(
    columns: _Columns, found: Proposal, t: Array | None, fix: tuple[Array, Array] | None
) -> bool:
    """Find speed and course over ground, if they are there; the fixes tell the speed's unit."""
    speed, course = _pick(columns, "speed"), _pick(columns, "course")
    if speed is None or course is None or speed == course:
        return False
    radians = _angle_unit(course, columns.numbers[course]) == "rad"
    angle = columns.numbers[course] * (1.0 if radians else math.pi / 180.0)
    unit = unit_of(speed, ("kn", "kmph", "mps"))
    why = ""
    if t is not None and fix is not None:
        value = columns.numbers[speed]
        velocity = np.column_stack([value * np.cos(angle), value * np.sin(angle)])
        fit = velocity_on_fixes(fix, _clean(t, velocity))
        by_fixes = "" if fit is None else _speed_unit(fit.ratio)
        if by_fixes and unit and by_fixes != unit:
            found.questions.append(f"{speed}: named {unit}, but the fixes say {by_fixes}")
        if by_fixes:
            unit, why = by_fixes, "as the fixes say"
    if not unit:
        found.questions.append(f"{speed}: knots or m/s? m/s is taken")
    _add(
        found,
        "velocity",
        _entry("speed", columns.take(speed), "" if unit in ("", "mps") else unit, why=why),
    )
    _add(found, "velocity", _entry("course", columns.take(course), "" if radians else "deg"))
    return True


def _speed_unit(ratio: float) -> str:
    """Return the unit of a speed that is so many times too small."""
    units = {"mps": 1.0, "kn": 1852.0 / 3600.0, "kmph": 1.0 / 3.6}
    return next((unit for unit, scale in units.items() if abs(ratio / scale - 1.0) < 0.12), "")


def _angle_unit(name: str, values: Array) -> str:
    """Return ``deg`` or ``rad``, from the name, else from the values."""
    most = float(np.abs(_known(values)).max(initial=0.0))
    if most > 4.0 * math.pi:
        return "deg"
    return unit_of(name, ("deg", "rad")) or ("deg" if most > 2.0 * math.pi else "rad")


def _heading(
    columns: _Columns, found: Proposal, t: Array | None, fix: tuple[Array, Array] | None
) -> tuple[Array, Array] | None:
    """Find the heading; the track tells whether it counts from east. Return it in rad."""
    name = _pick(columns, "heading")
    if name is None:
        found.missing.append("compass_rad")
        return None
    values, more, why = columns.numbers[name], "", ""
    if 3000.0 < np.abs(_known(values)).max(initial=0.0) <= 36000.0:
        values, more, why = 0.01 * values, "scale = 0.01", "hundredths of degrees"
    unit = _angle_unit(name, values)
    values = values * (math.pi / 180.0 if unit == "deg" else 1.0)
    known = None if t is None else _clean(t, values)
    if known is not None and fix is not None:
        fit = compass_on_track(fix, known)
        if fit is not None and fit.mirrored > 0.7 and fit.mirrored > fit.along + 0.3:
            if abs(fit.mirror - 0.5 * math.pi) < 0.6:
                more = f"{more}, " * bool(more) + 'frame = "enu"'
                why = "it counts from east, as the track says"
                if "position" in found.lines:
                    found.questions.append(
                        f"{name}: counts from east, or latitude and longitude are swapped"
                    )
                known = known[0], 0.5 * math.pi - known[1]
            else:
                found.questions.append(f"{name}: turns against the track; check its sign")
    line = _entry("compass_rad", columns.take(name), "deg" if unit == "deg" else "", more, why)
    _add(found, "columns", line)
    return known


def _gyro(
    columns: _Columns, found: Proposal, t: Array | None, heading: tuple[Array, Array] | None
) -> None:
    """Find the yaw rate; the heading tells which it is, its unit and sign."""
    best, name = None, _pick(columns, "gyro")
    if name is None:
        return
    if t is not None and heading is not None:
        for each in columns.left:
            if each not in columns.numbers or not means(each, NAMES["gyro"]):
                continue
            fit = gyro_on_compass(*heading, *_clean(t, columns.numbers[each]))
            if fit is not None and (best is None or abs(fit.correlation) > abs(best.correlation)):
                best, name = fit, each
    unit = unit_of(name, ("degpmin", "degps", "radps"))
    scale = {"degps": math.pi / 180.0, "degpmin": math.pi / 10800.0}
    more = why = ""
    if best is not None and abs(best.correlation) > 0.8:
        for each in ("radps", "degps", "degpmin"):
            if 0.7 < abs(best.scale) * scale.get(each, 1.0) < 1.4:
                unit, why = each, "as the heading says"
        if best.scale < 0.0:
            more, why = "scale = -1.0", "it turns against the heading"
    elif best is not None:
        found.questions.append(f"{name}: does not turn as the heading does; is it the yaw rate?")
    given = "" if unit in ("", "radps") else unit
    _add(found, "columns", _entry("gyro_radps", columns.take(name), given, more, why))


def _motion(columns: _Columns, found: Proposal) -> None:
    """Find roll, pitch and heave; ``usv-twin log check`` tells whether signs and axes are right."""
    for target, meaning in (("ahrs_roll_rad", "roll"), ("ahrs_pitch_rad", "pitch")):
        name = _pick(columns, meaning)
        if name is not None:
            steep = np.abs(_known(columns.numbers[name])).max(initial=0.0) > 0.5 * math.pi
            unit = "deg" if steep else unit_of(name, ("deg", "rad"))
            _add(found, "columns", _entry(target, columns.take(name), "deg" * (unit == "deg")))
    for target, meaning in (("gyro_x_radps", "gyro_x"), ("gyro_y_radps", "gyro_y")):
        name = _pick(columns, meaning)
        if name is not None:
            _add(found, "columns", _entry(target, columns.take(name), unit_of(name, ("degps",))))
    name = _pick(columns, "accel_z")
    if name is not None:
        up = float(np.median(_known(columns.numbers[name]))) > 0.0
        more, why = ("scale = -1.0", "it points up") if up else ("", "")
        line = _entry("accel_z_mps2", columns.take(name), unit_of(name, ("g",)), more, why)
        _add(found, "columns", line)
    for target, meaning in (("gps_z_m", "height"), ("gps_vz_mps", "climb")):
        name = _pick(columns, meaning)
        if name is not None:
            line = _entry(target, columns.take(name), "", "scale = -1.0", "down is above 0")
            _add(found, "columns", line)


def _plain(columns: _Columns, found: Proposal) -> None:
    """Find accelerometers and wind."""
    for target, meaning, units in (
        ("accel_x_mps2", "accel_x", ("g",)),
        ("accel_y_mps2", "accel_y", ("g",)),
        ("wind_mps", "wind_speed", ("kn", "kmph")),
        ("apparent_wind_mps", "apparent_speed", ("kn", "kmph")),
    ):
        name = _pick(columns, meaning)
        if name is not None:
            _add(found, "columns", _entry(target, columns.take(name), unit_of(name, units)))
    for target, meaning in (
        ("wind_from_rad", "wind_from"),
        ("apparent_wind_rad", "apparent_from"),
    ):
        name = _pick(columns, meaning)
        if name is not None:
            unit = _angle_unit(name, columns.numbers[name])
            line = _entry(target, columns.take(name), "deg" if unit == "deg" else "")
            _add(found, "columns", line)


def _commands(columns: _Columns, found: Proposal, own: _Own) -> None:
    """Find shaft speeds and steering angles, of one unit or two."""
    for pattern, single, pair, convert in (
        (SHAFT, "n_rps", ("n_left_rps", "n_right_rps"), _shaft),
        (STEER, "delta_rad", ("delta_left_rad", "delta_right_rad"), _steer),
    ):
        if any(own.has(name) for name in (single, *pair)):
            continue
        there = [n for n in columns.left if n in columns.numbers and is_command(n, pattern)]
        sides = sides_of(there)
        if not there and pattern == SHAFT:
            # plain "left" and "right"
            bare = [n for n in columns.left if n in columns.numbers and is_side(n)]
            sides = sides_of(bare)
            if sides is not None:
                found.questions.append(f"{sides[0]}, {sides[1]}: taken as the shafts")
        if sides is not None:
            for target, source in zip(pair, sides, strict=True):
                _add(found, "columns", convert(target, source, columns))
        elif there:
            _add(found, "columns", convert(single, there[0], columns))
        elif single == "delta_rad":
            line = "delta_rad = 0.0  # no angle found: fixed thrusters"
            _add(found, "columns", line)
        else:
            found.missing.append("n_left_rps, n_right_rps (or n_rps)")


def _pulses(columns: _Columns, found: Proposal) -> None:
    """Take two columns of pulse widths as the shafts, where no column is named so."""
    lacking = "n_left_rps, n_right_rps (or n_rps)"
    pulses = [
        name
        for name in columns.left
        if (values := _known(columns.numbers.get(name, np.empty(0)))).size
        and values.min() >= 800.0
        and values.max() <= 2200.0
        and (np.ptp(values) > 20.0 or means(name, NAMES["channel"]))
    ]
    if lacking not in found.missing or len(pulses) != 2:
        return
    found.missing.remove(lacking)
    found.questions.append(f"{pulses[0]}, {pulses[1]}: left and right? Or throttle and steering?")
    for target, name in zip(("n_left_rps", "n_right_rps"), pulses, strict=True):
        _add(found, "columns", _shaft(target, name, columns))


def _shaft(target: str, name: str, columns: _Columns) -> str:
    values = _known(columns.numbers[name])
    most = float(np.abs(values).max(initial=0.0))
    if len(values) and values.min() >= 800.0 and most <= 2200.0 and "rpm" not in words_of(name):
        more = "scale = 0.02, offset = -30.0"
        return _entry(target, columns.take(name), "", more, "pulse width, 1500 us: stop")
    words = words_of(name)
    if "rpm" in words or most > 150.0:
        return _entry(target, columns.take(name), "rpm")
    return _entry(target, columns.take(name), "", "", "rev/s, or any unit: as in the particulars")


def _steer(target: str, name: str, columns: _Columns) -> str:
    most = float(np.abs(_known(columns.numbers[name])).max(initial=0.0))
    unit = unit_of(name, ("deg", "rad")) or ("deg" if most > 1.6 else "rad")
    why = "above 0 must turn to starboard"
    return _entry(target, columns.take(name), "deg" if unit == "deg" else "", "", why)
