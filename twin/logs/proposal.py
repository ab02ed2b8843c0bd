"""A first mapping file for a log of unknown columns, from their names and values."""

from __future__ import annotations

import gzip
import io
import json
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from twin.logs.columns import Array, LogError
from twin.logs.dates import DateFormat, date_formats
from twin.logs.datum import radii
from twin.logs.diagnosis.heading import gyro_on_compass
from twin.logs.diagnosis.position import velocity_on_fixes
from twin.logs.diagnosis.track import compass_on_track
from twin.logs.readers import CsvFile, ParquetFile, dates

if TYPE_CHECKING:
    import polars as pl

__all__ = [
    "Proposal",
    "propose",
]

_ROWS = 200_000
"""Rows that are looked at."""

_SIDES = {"left": r"left|port|ps|l|1", "right": r"right|starboard|stbd|sb|r|2"}

_SHAFT = r"n|rpm|rps|pwm|shaft|motor|thruster|throttle|prop|propeller|esc|servo|engine|revs"

_STEER = r"delta|rudder|steer|steering|angle|azimuth|drive|nozzle|helm"

_NAMES = {
    "time": r"t|time|timestamp|stamp|date|datetime|utc|epoch|clock",
    "latitude": r"lat|latitude",
    "longitude": r"lon|lng|long|longitude",
    "north": r"x|north|northing",
    "east": r"y|east|easting",
    "speed": r"sog|speed|velocity|groundspeed",
    "course": r"cog|course|track",
    "heading": r"heading|hdg|psi|yaw|compass|hdt|head|bearing",
    "gyro": r"gyro|rot|yawrate|r|gz|turn",
    "accel_x": r"ax|accx|accelx",
    "accel_y": r"ay|accy|accely",
    "wind_speed": r"tws|windspeed",
    "wind_from": r"twd|winddirection|winddir|windfrom",
}
"""Words in the names of columns, by what they mean."""

_UNIT_WORDS = {
    "deg": r"deg|degs|degree|degrees|°",
    "rad": r"rad|rads|radians",
    "kn": r"kn|kt|kts|knot|knots",
    "kmph": r"kmh|kmph|kph",
    "mps": r"mps|ms1",
    "degps": r"degps|dps|degs",
    "degpmin": r"degpmin|degmin|dpm",
    "radps": r"radps|rads",
    "rpm": r"rpm",
    "rps": r"rps|hz",
    "ms": r"ms|msec|millis|milliseconds",
    "us": r"us|usec|micros",
    "ns": r"ns|nsec",
    "g": r"g",
}


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
    """

    lines: dict[str, list[str]] = field(default_factory=dict)
    missing: list[str] = field(default_factory=list)
    questions: list[str] = field(default_factory=list)
    choices: list[DateFormat] = field(default_factory=list)

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


def propose(path: str | Path, order: str = "") -> Proposal:
    """Return a mapping for the columns of a CSV or Parquet file.

    Parameters
    ----------
    path : str or Path
        The log.
    order : str
        ``day-first`` or ``month-first``, where dates leave it open.

    Returns
    -------
    Proposal
        With ``choices`` where the order is needed and not given.

    Raises
    ------
    LogError
        Where the file cannot be read.
    """
    path = Path(path)
    columns = _read(path)
    found = Proposal()
    t = _time(columns, found, order)
    fix = _position(columns, found, t)
    _velocity(columns, found, t, fix)
    heading = _heading(columns, found, t, fix)
    _gyro(columns, found, t, heading)
    _plain(columns, found)
    _commands(columns, found)
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
        try:
            frame = pl.read_csv(
                io.BytesIO(b"".join(lines)),
                infer_schema=False,
                encoding="utf8-lossy",
                truncate_ragged_lines=True,
            )
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


def _words(name: str) -> list[str]:
    """Return the words of a column's name, in lower case."""
    split = re.sub(r"([a-z])([A-Z])", r"\1 \2", name)
    return [word for word in re.split(r"[^a-z0-9°]+", split.lower()) if word]


def _means(name: str, pattern: str) -> bool:
    """Return whether a name has a word of a pattern, or joins to one."""
    words = _words(name)
    # longer words first, and letters alone only if they are the name without its unit
    for word in words:
        if re.fullmatch(pattern, word) and (len(word) > 2 or word == words[0]):
            return True
    return any(re.fullmatch(pattern, "".join(words[i : i + 2])) for i in range(len(words)))


def _unit(name: str, among: Sequence[str]) -> str:
    """Return the unit that a name ends with, if it is one of some."""
    squeezed = re.sub(r"[^a-z0-9°]", "", name.lower().replace("/s", "ps").replace("/h", "ph"))
    words = [
        *_words(name.replace("/s", "ps").replace("/h", "ph").replace("/min", "pmin")),
        squeezed,
    ]
    for unit in among:
        if any(re.fullmatch(_UNIT_WORDS[unit], word) for word in words[1:]):
            return unit
    return ""


def _pick(columns: _Columns, meaning: str, *, numeric: bool = True) -> str | None:
    """Return the first column of a meaning, shorter names first."""
    there = [
        name
        for name in columns.left
        if (name in columns.numbers or not numeric)
        and _means(name, _NAMES[meaning])
        and "rpm" not in _words(name)  # the r of rpm_r is a side
    ]
    exact = [name for name in there if re.fullmatch(_NAMES[meaning], "".join(_words(name)[:1]))]
    return min(exact or there, key=lambda name: len(_words(name)), default=None)


def _entry(name: str, source: str, unit: str = "", more: str = "", why: str = "") -> str:
    """Return a line of a table."""
    parts = [f"from = {json.dumps(source, ensure_ascii=False)}"]
    parts += [f'unit = "{unit}"'] if unit else []
    parts += [more] if more else []
    value = f"{{ {', '.join(parts)} }}" if len(parts) > 1 else parts[0].removeprefix("from = ")
    return f"{name} = {value}" + (f"  # {why}" if why else "")


def _add(found: Proposal, table: str, line: str) -> None:
    found.lines.setdefault(table, []).append(line)


def _time(columns: _Columns, found: Proposal, order: str) -> Array | None:
    """Find the time, and return it in seconds."""
    named = [name for name in columns.left if _means(name, _NAMES["time"])]
    dated = [name for name in named if name not in columns.numbers]
    for name in dated:
        cells = columns.text[name].drop_nulls().to_list()
        formats = date_formats(cells)
        if not formats:
            continue
        if len(formats) > 1:
            chosen = [each for each in formats if each.order == order]
            if not chosen:
                found.choices = formats
                found.questions.append(f"{name}: {cells[0]!r}: day first or month first?")
            formats = chosen or formats
        form = formats[0].format
        if form and "%d" not in form and "%j" not in form:
            why = "a time without a date: a log across midnight would go back"
        else:
            why = "dates without a zone count as UTC" if not re.search(r"%#?z", form) else ""
            why = "" if not form and re.search(r"(Z|[+-]\d\d:?\d\d)$", cells[0].strip()) else why
        more = f"format = {json.dumps(form)}" if form else ""
        _add(found, "columns", _entry("t_s", columns.take(name), "datetime", more, why))
        seconds = dates(columns.text[name].str.strip_chars(), form)
        return seconds.to_numpy().astype(np.float64, copy=False)
    rising = [
        name
        for name in named
        if name in columns.numbers and (np.diff(_known(columns.numbers[name])) >= 0.0).all()
    ]
    if not rising:
        found.missing.append("t_s")
        return None
    name = min(rising, key=lambda each: len(each))
    values = columns.numbers[name]
    unit = _unit(name, ("ms", "us", "ns")) or _time_unit(values)
    scale = {"": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}[unit]
    start = float(_known(values)[0]) * scale
    more = f"offset = {-start!r}" if start > 1e6 else ""
    why = "counted from the first row" if more else ""
    _add(found, "columns", _entry("t_s", columns.take(name), unit, more, why))
    return np.asarray(values * scale - (start if more else 0.0))


def _time_unit(values: Array) -> str:
    """Return the unit of times without one in the name, from their size and step."""
    known = _known(values)
    step = float(np.median(np.diff(known))) if len(known) > 1 else 0.0
    for unit, least, epoch in (("ns", 1e6, 1e17), ("us", 1e3, 1e14), ("ms", 5.0, 1e11)):
        if known[-1] > epoch or (step >= least and unit != "ns"):
            return unit
    return ""


def _known(values: Array) -> Array:
    return values[np.isfinite(values)]


def _position(columns: _Columns, found: Proposal, t: Array | None) -> tuple[Array, Array] | None:
    """Find the position, and return times and metres north and east."""
    latitude, longitude = _pick(columns, "latitude"), _pick(columns, "longitude")
    if latitude is not None and longitude is not None:
        lat, lon = columns.numbers[latitude], columns.numbers[longitude]
        most = float(np.abs(_known(lat)).max())
        if most > 90.0 and float(np.abs(_known(lon)).max()) <= 90.0:
            found.questions.append(
                f"{latitude} reaches {most:.4g} degrees: latitude and longitude are swapped, and "
                "taken so"
            )
            latitude, longitude, lat, lon = longitude, latitude, lon, lat
        elif most > 90.0:
            found.questions.append(
                f"{latitude} reaches {most:.6g}: convert it to degrees before (1e-7 degrees of "
                "MAVLink, or degrees and minutes of NMEA)"
            )
        rows = [
            f"{key} = {json.dumps(columns.take(name), ensure_ascii=False)}"
            for key, name in (("latitude", latitude), ("longitude", longitude))
        ]
        for row in rows:
            _add(found, "position", row)
        first = (lat != 0.0) & np.isfinite(lat) & np.isfinite(lon)
        if t is None or not first.any() or most > 90.0:
            return None
        to_north, to_east = radii(float(lat[first][0]))
        metres = np.column_stack(
            [np.radians(lat - lat[first][0]) * to_north, np.radians(lon - lon[first][0]) * to_east]
        )
        return _clean(t, metres)
    north, east = _pick(columns, "north"), _pick(columns, "east")
    if north is None or east is None:
        found.missing += ["gps_x_m", "gps_y_m"]
        return None
    _add(found, "columns", _entry("gps_x_m", columns.take(north), why="north?"))
    _add(found, "columns", _entry("gps_y_m", columns.take(east), why="east?"))
    if t is None:
        return None
    return _clean(t, np.column_stack([columns.numbers[north], columns.numbers[east]]))


def _clean(t: Array, values: Array) -> tuple[Array, Array]:
    """Return the rows whose time advances and whose values are new."""
    table = values if values.ndim == 2 else values[:, None]
    ok = np.isfinite(t) & np.isfinite(table).all(axis=1)
    t, values, table = t[ok], values[ok], table[ok]
    new = np.ones(len(t), dtype=np.bool_)
    new[1:] = t[1:] > np.maximum.accumulate(t)[:-1]
    new[1:] &= (table[1:] != table[:-1]).any(axis=1)
    return t[new], values[new]


def _velocity(
    columns: _Columns, found: Proposal, t: Array | None, fix: tuple[Array, Array] | None
) -> None:
    """Find speed and course over ground; the fixes tell the unit of the speed."""
    speed, course = _pick(columns, "speed"), _pick(columns, "course")
    if speed is None or course is None:
        return
    radians = _angle_unit(course, columns.numbers[course]) == "rad"
    angle = columns.numbers[course] * (1.0 if radians else math.pi / 180.0)
    unit = _unit(speed, ("kn", "kmph", "mps"))
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


def _speed_unit(ratio: float) -> str:
    """Return the unit of a speed that is so many times too small."""
    units = {"mps": 1.0, "kn": 1852.0 / 3600.0, "kmph": 1.0 / 3.6}
    return next((unit for unit, scale in units.items() if abs(ratio / scale - 1.0) < 0.12), "")


def _angle_unit(name: str, values: Array) -> str:
    """Return ``deg`` or ``rad``, from the name, else from the values."""
    most = float(np.abs(_known(values)).max(initial=0.0))
    if most > 4.0 * math.pi:
        return "deg"
    return _unit(name, ("deg", "rad")) or ("deg" if most > 2.0 * math.pi else "rad")


def _heading(
    columns: _Columns, found: Proposal, t: Array | None, fix: tuple[Array, Array] | None
) -> tuple[Array, Array] | None:
    """Find the heading; the track tells whether it counts from east. Return it in rad."""
    name = _pick(columns, "heading")
    if name is None:
        found.missing.append("compass_rad")
        return None
    unit = _angle_unit(name, columns.numbers[name])
    values = columns.numbers[name] * (math.pi / 180.0 if unit == "deg" else 1.0)
    more = why = ""
    known = None if t is None else _clean(t, values)
    if known is not None and fix is not None:
        fit = compass_on_track(fix, known)
        if fit is not None and fit.mirrored > 0.7 and fit.mirrored > fit.along + 0.3:
            if abs(fit.mirror - 0.5 * math.pi) < 0.6:
                more, why = 'frame = "enu"', "it counts from east, as the track says"
                known = known[0], 0.5 * math.pi - known[1]
            else:
                found.questions.append(f"{name}: turns against the track; check its sign")
    line = _entry("compass_rad", columns.take(name), "deg" if unit == "deg" else "", more, why)
    _add(found, "columns", line)
    return known


def _gyro(
    columns: _Columns, found: Proposal, t: Array | None, heading: tuple[Array, Array] | None
) -> None:
    """Find the yaw rate; the heading tells its unit and sign."""
    name = _pick(columns, "gyro")
    if name is None:
        return
    unit = _unit(name, ("degpmin", "degps", "radps"))
    scale = {"degps": math.pi / 180.0, "degpmin": math.pi / 10800.0}
    more = why = ""
    if t is not None and heading is not None:
        at, rate = _clean(t, columns.numbers[name])
        fit = gyro_on_compass(*heading, at, rate)
        if fit is not None and abs(fit.correlation) > 0.8:
            for each in ("radps", "degps", "degpmin"):
                if 0.7 < abs(fit.scale) * scale.get(each, 1.0) < 1.4:
                    unit, why = each, "as the heading says"
            if fit.scale < 0.0:
                more, why = "scale = -1.0", "it turns against the heading"
    _add(
        found,
        "columns",
        _entry("gyro_radps", columns.take(name), "" if unit in ("", "radps") else unit, more, why),
    )


def _plain(columns: _Columns, found: Proposal) -> None:
    """Find accelerometers and wind."""
    for target, meaning, units in (
        ("accel_x_mps2", "accel_x", ("g",)),
        ("accel_y_mps2", "accel_y", ("g",)),
        ("wind_mps", "wind_speed", ("kn", "kmph")),
    ):
        name = _pick(columns, meaning)
        if name is not None:
            _add(found, "columns", _entry(target, columns.take(name), _unit(name, units)))
    name = _pick(columns, "wind_from")
    if name is not None:
        unit = _angle_unit(name, columns.numbers[name])
        line = _entry("wind_from_rad", columns.take(name), "deg" if unit == "deg" else "")
        _add(found, "columns", line)


def _commands(columns: _Columns, found: Proposal) -> None:
    """Find shaft speeds and steering angles, of one unit or two."""
    for pattern, single, pair, convert in (
        (_SHAFT, "n_rps", ("n_left_rps", "n_right_rps"), _shaft),
        (_STEER, "delta_rad", ("delta_left_rad", "delta_right_rad"), _steer),
    ):
        there = [n for n in columns.left if n in columns.numbers and _is_command(n, pattern)]
        sides = {
            side: next((n for n in there if _means_side(n, words)), None)
            for side, words in _SIDES.items()
        }
        if sides["left"] is not None and sides["right"] is not None:
            for target, source in zip(pair, (sides["left"], sides["right"]), strict=True):
                _add(found, "columns", convert(target, source, columns))
        elif there:
            _add(found, "columns", convert(single, there[0], columns))
        elif single == "delta_rad":
            line = "delta_rad = 0.0  # no angle found: fixed thrusters"
            _add(found, "columns", line)
        else:
            found.missing.append("n_left_rps, n_right_rps (or n_rps)")


def _is_command(name: str, pattern: str) -> bool:
    return any(re.fullmatch(rf"({pattern})(l|r|\d|left|right|port|stbd)?", w) for w in _words(name))


def _means_side(name: str, words: str) -> bool:
    return any(
        re.fullmatch(rf"({words})|[a-z]{{2,}}({words})", word) or re.fullmatch(rf"n({words})", word)
        for word in _words(name)
    )


def _shaft(target: str, name: str, columns: _Columns) -> str:
    values = _known(columns.numbers[name])
    most = float(np.abs(values).max(initial=0.0))
    if len(values) and values.min() >= 800.0 and most <= 2200.0 and "rpm" not in _words(name):
        more = "scale = 0.02, offset = -30.0"
        return _entry(target, columns.take(name), "", more, "pulse width, 1500 us: stop")
    words = _words(name)
    if "rpm" in words or most > 150.0:
        return _entry(target, columns.take(name), "rpm")
    return _entry(target, columns.take(name), "", "", "rev/s, or any unit: as in the particulars")


def _steer(target: str, name: str, columns: _Columns) -> str:
    most = float(np.abs(_known(columns.numbers[name])).max(initial=0.0))
    unit = _unit(name, ("deg", "rad")) or ("deg" if most > 1.6 else "rad")
    why = "above 0 must turn to starboard"
    return _entry(target, columns.take(name), "deg" if unit == "deg" else "", "", why)
