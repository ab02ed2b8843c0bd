"""Mapping files: which column or message of a foreign record is which column of a log.

A mapping is a TOML file. For a CSV or Parquet file with columns of other names::

    [columns]                                       # log column = column of the file
    t_s = { from = "time", unit = "ms" }            # or unit = "datetime" for dates and times,
                                                    # format = "%d/%m/%Y %I:%M:%S %p" unless ISO
                                                    # from = ["date", "time"] of two columns;
                                                    # zone = "+02:00" or "Europe/Oslo", if not UTC
    n_rps = { from = "shaft", unit = "rpm" }        # one propeller: put on both sides
    delta_rad = { from = "rudder", unit = "deg", scale = -1.0 }
    wind_mps = { from = "TWS", unit = "kn", offset = 0.0, empty = [-999] }  # no values
    delta_left_rad = 0.0                            # a constant

    [position]                                      # latitude, longitude (degrees) -> metres
    latitude = "lat"                                # each also as { from = "lat", scale = -1.0 },
    longitude = "lon"                               # or with hemisphere = "E/W", a column
    datum = [38.86580, 121.53438]                   # left out: the first fix
    scale = 1e-7                                    # of latitude and longitude, to degrees
    unit = "ddmm"                                   # degrees and minutes in one number, ddmm.mm

    [skid_steering]                                 # in place of shaft speeds and angles:
    throttle = "ahead"                              # left is throttle + steering,
    steering = { from = "turn", scale = 1.0 }       # right is throttle - steering

    [datum]                                         # positions in metres: where that was
    latitude = "lat"
    longitude = "lon"

    [velocity]                                      # speed and course over ground
    speed = { from = "SOG", unit = "kn" }
    course = { from = "COG", unit = "deg" }

    [attitude]                                      # roll and pitch of a quaternion
    quaternion = ["qx", "qy", "qz", "qw"]
    frame = "ned"

    [wind]                                          # velocity of the air over ground, m/s, and
    vector = ["wx", "wy"]                           # [apparent_wind]: on board
    frame = "enu"                                   # east and north; ahead and to port

    [rows]                                          # of a long file: a piece, or fewer rows
    start_s = 100.0
    stop_s = 700.0
    step_s = 0.1

Of a log of an autopilot only [rows] and this table, each key of which may be left out::

    [servos]                                        # instead of its parameters
    left = 1                                        # output of the left throttle ...
    right = 3                                       # ... and of the right one, or the same
    steering = 2                                    # output of rudder or drives
    shaft_speed = 16.5                              # rev/s at full throttle, else shares of it
    angle_deg = 30.0                                # full helm

For a ROS 2 bag each entry names its ``topic`` and ``field`` instead of ``from``; the whole is
in ``twin/logs/mappings/ros2_example.toml``.

A mapping that ships, or that another package adds by an entry point in the group
``usv_twin.mappings``, is named without a path, and is found by itself for a log of its columns
whose name fits its ``files = "pattern*"``.
"""

from __future__ import annotations

import difflib
import functools
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatch
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

import numpy as np

from twin.channels import COMMANDS, MEASUREMENTS, TIME, TRUE_MOTION, TRUTH
from twin.logs.columns import REQUIRED, SINGLE, UNITS, Array, Entry
from twin.logs.dates import ahead_of_utc
from twin.logs.datum import FIXES, Datum, Plane, from_minutes, in_minutes
from twin.logs.errors import LogError
from twin.logs.marks import NO_PULSES
from usv_kernel.channels import WIND_CHANNELS
from usv_kernel.files import read_toml

__all__ = [
    "GROUP",
    "Layout",
    "layout_of",
    "mapping_path",
]

_COLUMNS = (TIME, *COMMANDS, *SINGLE, *MEASUREMENTS, *TRUTH, *TRUE_MOTION)

_TABLES = (
    *("columns", "position", "velocity", "skid_steering", "heading", "attitude"),
    *("wind", "apparent_wind", "datum", "rows", "servos"),
)

_SERVOS = {"left": 32.0, "right": 32.0, "steering": 32.0, "shaft_speed": 1e4, "angle_deg": 180.0}
"""Keys of [servos], and their largest values."""

_ENU = {
    # angles turn the other way and begin at east; y of the body points to port, z up
    **dict.fromkeys(("compass_rad", "true_psi_rad", "wind_from_rad"), (-1.0, 0.5 * math.pi)),
    **dict.fromkeys(("gyro_radps", "true_r_radps", "accel_y_mps2", "true_v_mps"), (-1.0, 0.0)),
    **dict.fromkeys(("accel_x_mps2", "true_u_mps"), (1.0, 0.0)),
    **dict.fromkeys(("gyro_x_radps", "ahrs_roll_rad"), (1.0, 0.0)),
    **dict.fromkeys(("gyro_y_radps", "ahrs_pitch_rad", "accel_z_mps2"), (-1.0, 0.0)),
    **dict.fromkeys(("gps_z_m", "gps_vz_mps"), (-1.0, 0.0)),
}

_FAR = 1e5
"""Largest distance from the middle fix at which the first fix is the datum, m."""


@dataclass(frozen=True)
class Layout:
    """What a mapping file says."""

    entries: tuple[Entry, ...] = ()  # in the order of the file
    source: str = ""  # file, for messages
    # rows with start <= t_s < stop are read, s
    start: float = -math.inf
    stop: float = math.inf
    # rows of each step seconds become one, which holds the last sample of each column; 0 for all
    # rows
    step: float = 0.0
    stamp: str = "header"  # header or receive: which time of a message counts
    files: str = "*"  # pattern of the names of the logs that it is for, where it is known by name
    # of an autopilot's log: outputs, rev/s at full throttle and degrees at full helm
    servos: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def load(cls, path: str | Path) -> Layout:
        """Read a TOML file as in the head of this module; LogError names key and remedy."""
        path = Path(path)
        return _Parser(str(path)).layout(read_toml(path, LogError))


GROUP = "usv_twin.mappings"
"""Group of the entry points by which other packages add mappings: the path of a file each."""


@functools.cache
def _known() -> dict[str, Path | EntryPoint]:
    """Return mappings by name, those of other packages first; those that ship keep their names."""
    shipped = sorted(Path(__file__).with_name("mappings").glob("*.toml"))
    return {
        **{entry.name: entry for entry in entry_points(group=GROUP)},
        **{path.stem: path for path in shipped},
    }


def mapping_path(source: str | Path) -> Path:
    """Return the file of a mapping that ships or that another package adds, or the path given.

    Others add one by an entry point in the group :data:`GROUP`::

        [project.entry-points."usv_twin.mappings"]
        our_logger = "my_package:MAPPING"

    LogError: the entry point names no file.
    """
    found = _known().get(str(source), source)
    if not isinstance(found, EntryPoint):
        return Path(found)
    try:
        return Path(found.load())
    except Exception as error:  # foreign code may raise anything when it is imported
        raise LogError(
            f"mapping {source!r}: the entry point {found.value} of another package gives no path "
            f"of a file ({type(error).__name__}: {error}); mend or remove that package"
        ) from error


def layout_of(name: str, header: Sequence[str]) -> Layout | None:
    """Return the mapping that is known for a record of these columns, if there is one.

    The first fits of whose columns for what each log needs at most one is not there, which is then
    said.
    """
    for kind in _known():
        layout = Layout.load(mapping_path(kind))
        if not fnmatch(name, layout.files) or any(entry.topic for entry in layout.entries):
            continue
        there = {entry for entry in layout.entries if set(entry.sources) <= set(header)}
        absent = {
            source
            for entry in layout.entries
            if entry not in there and set(entry.names) & set(REQUIRED)
            for source in entry.sources
        }
        if len(absent) <= 1:
            kept = tuple(entry for entry in layout.entries if entry in there)
            return replace(layout, source=f"{kind}.toml", entries=kept)
    return None


class _Parser:
    """Turns the tables of a mapping into entries; complains with the file and the key."""

    def __init__(self, source: str) -> None:
        self.source = source

    def fail(self, where: str, what: str) -> LogError:
        return LogError(f"{self.source}: {where}: {what}")

    def known(self, where: str, table: Any, keys: Sequence[str]) -> Mapping[str, Any]:
        if not isinstance(table, Mapping):
            raise self.fail(where, f"must be a table with the keys {', '.join(keys)}")
        for key in table:
            if key not in keys:
                near = difflib.get_close_matches(key, keys, n=1)
                hint = f"; did you mean {near[0]}?" if near else ""
                raise self.fail(where, f"unknown key {key!r}; known: {', '.join(keys)}{hint}")
        return table

    def number(self, where: str, value: Any) -> float:
        if (
            isinstance(value, bool)
            or not isinstance(value, int | float)
            or not math.isfinite(value)
        ):
            raise self.fail(where, f"{value!r} must be a finite number")
        return float(value)

    def layout(self, data: Mapping[str, Any]) -> Layout:
        self.known("top", data, ("stamp", "files", *_TABLES))
        stamp, files = data.get("stamp", "header"), self.text("top", data, "files", "*")
        if stamp not in ("header", "receive"):
            raise self.fail("stamp", f'{stamp!r} must be "header" or "receive"')
        entries = [
            self.column(name, given)
            for name, given in self.known("[columns]", data.get("columns", {}), _COLUMNS).items()
        ]
        makers = {"position": self.position, "velocity": self.velocity, "heading": self.heading}
        makers |= {"attitude": self.attitude, "datum": self.datum}
        makers["skid_steering"] = self.skid_steering
        for name in ("wind", "apparent_wind"):
            makers[name] = functools.partial(self.wind, name)
        entries += [make(data[key]) for key, make in makers.items() if key in data]
        names = [name for entry in entries for name in entry.names]
        for name in names:
            if names.count(name) > 1:
                raise self.fail(name, "is given twice; remove one of them")
        rows = self.known("[rows]", data.get("rows", {}), ("start_s", "stop_s", "step_s"))
        asked = {key.removesuffix("_s"): self.number(f"[rows] {key}", rows[key]) for key in rows}
        servos = self.servos(data.get("servos", {}))
        layout = Layout(
            tuple(entries), self.source, stamp=stamp, files=files, servos=servos, **asked
        )
        if not layout.start < layout.stop or layout.step < 0.0:
            raise self.fail("[rows]", "start_s must be below stop_s, and step_s not below 0")
        return layout

    def servos(self, table: Any) -> dict[str, float]:
        """Return the table [servos]."""
        found = {}
        for key, value in self.known("[servos]", table, tuple(_SERVOS)).items():
            number, most = self.number(f"[servos] {key}", value), _SERVOS[key]
            output = key in ("left", "right", "steering")
            if not 0.0 < number <= most or (output and number != round(number)):
                what = "an output from 1" if output else "above 0, up"
                raise self.fail(f"[servos] {key}", f"{value!r} must be {what} to {most:g}")
            found[key] = number
        return found

    def source_of(
        self, where: str, given: Any, unit: str, extra: Sequence[str] = ()
    ) -> tuple[str, str, float, float, Mapping[str, Any]]:
        """Return topic, source, factor, offset and the table of ``{from = ..., unit = ...}``."""
        table: Mapping[str, Any] = {"from": given} if isinstance(given, str) else given
        keys = ("from", "topic", "field", "unit", "scale", "offset", "empty", *extra)
        table = self.known(where, table, keys)
        source = table.get("field" if "topic" in table else "from")
        if not isinstance(source, str) or not isinstance(table.get("topic", ""), str):
            raise self.fail(
                where, 'needs from = "column of the file", or topic = "/name" and field = "path"'
            )
        factors = UNITS[unit]
        asked = table.get("unit", unit)
        units = [*factors, "datetime"] if unit == "s" else [*factors]
        if asked not in units:
            raise self.fail(where, f"unknown unit {asked!r}; known here: {', '.join(units)}")
        scale = self.number(f"{where} scale", table.get("scale", 1.0))
        offset = self.number(f"{where} offset", table.get("offset", 0.0))
        return table.get("topic", ""), source, factors.get(asked, 1.0) * scale, offset, table

    def column(self, name: str, given: Any) -> Entry:
        names = SINGLE.get(name, (name,))
        if isinstance(given, int | float) and name != TIME:
            value = self.number(name, given)
            return Entry(names, (), lambda _: [np.array(value)] * len(names))
        unit, date = name.rpartition("_")[2], ""
        if name == TIME and isinstance(given, Mapping) and isinstance(given.get("from"), list):
            parts = given["from"]
            if len(parts) != 2 or not all(isinstance(part, str) for part in parts):
                raise self.fail(name, 'from must be a column, or two: ["date", "time"]')
            if given.get("unit") != "datetime":
                raise self.fail(name, 'two columns need unit = "datetime"')
            date, given = parts[0], {**given, "from": parts[1]}
        topic, source, factor, offset, table = self.source_of(
            name, given, unit, ("frame", "format", "zone")
        )
        if name == TIME and topic:
            raise self.fail(name, "a message has its own time; choose it with stamp = ...")
        clock = table.get("unit") == "datetime"
        form = self.text(name, table, "format", "")
        if form and not clock:
            raise self.fail(name, 'format is for unit = "datetime"')
        zone = self.zone(
            name, self.text(name, table, "zone", ""), clock and not re.search("%[:#]?z", form)
        )
        frame = table.get("frame", "ned")
        if frame != "ned":
            if frame != "enu" or name not in _ENU:
                raise self.fail(
                    name,
                    f'frame = {frame!r}: "enu" is for {", ".join(_ENU)}; elsewhere name the '
                    "field that points north or east, and turn a sign with scale = -1.0",
                )
            sign, turn = _ENU[name]
            factor, offset = sign * factor, turn + sign * offset
        what = f"{topic}:{source}" if topic else source
        both = ", ".join(names) + (" (one for both sides)" if len(names) > 1 else "")
        return Entry(
            names,
            (source, date) if date else (source,),
            _first(factor, offset)
            if date
            else self.linear(name, len(names), factor, offset, table),
            topic,
            f"{both}: from {f'{date} and ' if date else ''}{what}" + _conversion(factor, offset),
            clock,
            form,
            date,
            zone,
            ((source, marks),) if (marks := self.pulses(name, factor, offset, table)) else (),
        )

    def pulses(
        self, where: str, factor: float, offset: float, table: Mapping[str, Any]
    ) -> tuple[float, ...]:
        """Return the marks of a command that comes as pulse widths, us, but for those stated."""
        command = where in COMMANDS or where in SINGLE or where.startswith("[skid")
        if not command or not 1e3 <= -offset / (factor or 1.0) <= 2e3:
            return ()
        return tuple(mark for mark in NO_PULSES if mark not in self.marks(where, table))

    def marks(self, where: str, table: Mapping[str, Any]) -> list[float]:
        """Return the numbers that are no values."""
        given = table.get("empty", [])
        if not isinstance(given, list):
            raise self.fail(f"{where} empty", f"{given!r} must be numbers in brackets")
        return [self.number(f"{where} empty", value) for value in given]

    def linear(
        self, where: str, count: int, factor: float, offset: float, table: Mapping[str, Any]
    ) -> Callable[[Sequence[Array]], Sequence[Array]] | None:
        """Return the conversion of one source to so many columns; None where none is needed."""
        marks = [*self.marks(where, table), *self.pulses(where, factor, offset, table)]
        if factor == 1.0 and offset == 0.0 and not marks:
            return None
        command = where in COMMANDS or where in SINGLE or where.startswith("[skid")

        def convert(values: Sequence[Array]) -> list[Array]:
            none = np.isin(values[0], marks)
            made = np.where(none, np.nan, values[0] * factor + offset)
            if command:  # nothing turns before the first one; later ones are held
                made[: int(np.argmin(none)) if not none.all() else None] = 0.0
            return [made] * count

        return convert

    def zone(self, name: str, text: str, allowed: bool) -> str:
        """Return the zone of a clock, if it is one."""
        if text and not allowed:
            raise self.fail(name, "zone is for dates that have none of their own")
        if text:
            try:
                ahead_of_utc(text)
            except LogError as error:
                raise self.fail(name, str(error)) from None
        return text

    def position(self, given: Any) -> Entry:
        keys = ("topic", "latitude", "longitude", "unit", "scale", "datum")
        table = self.known("[position]", given, keys)
        scale = self.number("[position] scale", table.get("scale", 1.0))
        if (unit := table.get("unit", "deg")) not in ("deg", "ddmm"):
            raise self.fail("[position] unit", f'{unit!r} must be "deg" or "ddmm"')
        datum = table.get("datum")
        if datum is not None:
            if not isinstance(datum, list) or len(datum) != 2:
                raise self.fail("[position] datum", "must be [latitude, longitude] in degrees")
            datum = tuple(self.number("[position] datum", value) for value in datum)
            Datum(latitude=datum[0], longitude=datum[1])  # refuses what is no place on Earth
        parts = [self.angle(key, table.get(key, key)) for key in ("latitude", "longitude")]
        topic = self.text("[position]", table, "topic", "")
        names = [part[0] for part in parts] + (["status.status?"] if topic else [])
        plane = None if datum is None else Plane(*datum)
        scales = scale * parts[0][2], scale * parts[1][2]
        sided = bool(parts[0][1]), bool(parts[1][1])
        position = _Position(plane, self.source, scales, sided, unit == "ddmm")
        return Entry(
            ("gps_x_m", "gps_y_m"),
            (*names, *(part[1] for part in parts if part[1])),
            position,
            topic,
            "gps_x_m, gps_y_m: metres north and east of "
            + (f"latitude {datum[0]}, longitude {datum[1]}" if datum else "the first fix"),
            plane=position.plane,
        )

    def angle(self, key: str, given: Any) -> tuple[str, str, float]:
        """Return the sources of a latitude or longitude and of its hemisphere, and its factor."""
        where = f"[position] {key}"
        table = self.known(
            where,
            {"from": given} if isinstance(given, str) else given,
            ("from", "hemisphere", "scale"),
        )
        name, side = (self.text(where, table, part, "") for part in ("from", "hemisphere"))
        if not name:
            raise self.fail(where, 'needs from = "column of the file"')
        return name, side, self.number(f"{where} scale", table.get("scale", 1.0))

    def datum(self, given: Any) -> Entry:
        table = self.known("[datum]", given, ("latitude", "longitude"))
        names = [self.text("[datum]", table, key, key) for key in ("latitude", "longitude")]
        return Entry(FIXES, tuple(names), lambda fixes: [*_fixes(fixes)])

    def text(self, where: str, table: Mapping[str, Any], key: str, default: str) -> str:
        value = table.get(key, default)
        if not isinstance(value, str):
            raise self.fail(f"{where} {key}", f"{value!r} must be a text")
        return value

    def velocity(self, given: Any) -> Entry:
        units = {"speed": "mps", "course": "rad"}
        topic, sources, values_of, _ = self.two("[velocity]", given, units)

        def convert(values: Sequence[Array]) -> list[Array]:
            speed, course = values_of(values)
            course = np.mod(course, 2.0 * math.pi)  # one course has one number
            return [speed * np.cos(course), speed * np.sin(course)]

        note = f"gps_vx_mps, gps_vy_mps: from speed {sources[0]} and course {sources[1]}"
        return Entry(("gps_vx_mps", "gps_vy_mps"), sources, convert, topic, note)

    def skid_steering(self, given: Any) -> Entry:
        units = {"throttle": "rps", "steering": "rps"}
        topic, sources, values_of, pulses = self.two("[skid_steering]", given, units)

        def convert(values: Sequence[Array]) -> list[Array]:
            ahead, turn = values_of(values)
            return [ahead + turn, ahead - turn, 0.0 * ahead, 0.0 * ahead]

        note = f"n_left_rps, n_right_rps: {sources[0]} plus and minus {sources[1]}"
        return Entry(COMMANDS, sources, convert, topic, note, pulses=pulses)

    def two(
        self, where: str, given: Any, units: Mapping[str, str]
    ) -> tuple[str, tuple[str, str], Callable[[Sequence[Array]], list[Array]], tuple[Any, ...]]:
        """Return topic and sources of a table of two keys, what gives both, which are pulses."""
        table = self.known(where, given, tuple(units))
        names = [f"{where} {key}" for key in units]
        one, other = (
            self.source_of(name, table.get(key, {}), unit)
            for name, (key, unit) in zip(names, units.items(), strict=True)
        )
        if one[0] != other[0]:
            raise self.fail(where, f"{' and '.join(units)} must come from the same topic")
        parts = list(zip(names, (one, other), strict=True))
        made = [self.linear(name, 1, *part[2:]) or list for name, part in parts]
        marked = [(part[1], self.pulses(name, *part[2:])) for name, part in parts]
        pulses = tuple(each for each in marked if each[1])

        def convert(values: Sequence[Array]) -> list[Array]:
            return [make([value])[0] for make, value in zip(made, values, strict=True)]

        return one[0], (one[1], other[1]), convert, pulses

    def quaternion(
        self, where: str, given: Any, *more: str
    ) -> tuple[Mapping[str, Any], tuple[str, ...], str]:
        """Return the table, the four sources and the frame of a quaternion."""
        table = self.known(where, given, ("topic", "quaternion", "frame", *more))
        parts = table.get("quaternion", "orientation")
        names = [f"{parts}.{axis}" for axis in "xyzw"] if isinstance(parts, str) else parts
        if not isinstance(names, list) or len(names) != 4:
            raise self.fail(f"{where} quaternion", "must be a field, or the columns [x, y, z, w]")
        return table, tuple(map(str, names)), self.frame(where, table)

    def heading(self, given: Any) -> Entry:
        table, sources, frame = self.quaternion("[heading]", given, "offset")
        offset = self.number("[heading] offset", table.get("offset", 0.0))
        return Entry(
            ("compass_rad",),
            sources,
            _yaw(frame == "enu", offset),
            self.text("[heading]", table, "topic", ""),
            f"compass_rad: from a quaternion in {frame.upper()}",
        )

    def attitude(self, given: Any) -> Entry:
        table, sources, frame = self.quaternion("[attitude]", given)
        return Entry(
            ("ahrs_roll_rad", "ahrs_pitch_rad"),
            sources,
            _tilt(frame == "enu"),
            self.text("[attitude]", table, "topic", ""),
            f"ahrs_roll_rad, ahrs_pitch_rad: from a quaternion in {frame.upper()}",
        )

    def wind(self, name: str, given: Any) -> Entry:
        where = f"[{name}]"
        table = self.known(where, given, ("topic", "vector", "frame"))
        fields = table.get("vector", ["vector.x", "vector.y"])
        if not isinstance(fields, list) or len(fields) != 2:
            raise self.fail(f"{where} vector", "must be the columns or fields [x, y]")
        frame = self.frame(where, table)
        return Entry(
            WIND_CHANNELS if name == "apparent_wind" else ("wind_mps", "wind_from_rad"),
            tuple(map(str, fields)),
            _source_of_air(frame == "enu", name == "apparent_wind"),
            self.text(where, table, "topic", ""),
            f"{name}: from a velocity in {frame.upper()}",
        )

    def frame(self, where: str, table: Mapping[str, Any]) -> str:
        """Return the frame of a table: that of ROS, unless it says otherwise."""
        frame = table.get("frame", "enu")
        if frame not in ("enu", "ned"):
            raise self.fail(f"{where} frame", f'{frame!r} must be "enu" or "ned"')
        return str(frame)


def _conversion(factor: float, offset: float) -> str:
    """Return what a conversion does, for the notes."""
    times = "" if factor == 1.0 else f" times {factor:.6g}"
    return times + ("" if offset == 0.0 else f" plus {offset:.6g}")


def _first(factor: float, offset: float) -> Callable[[Sequence[Array]], Sequence[Array]]:
    """Return the conversion of the first of several sources."""
    return lambda values: [values[0] * factor + offset]


@dataclass(frozen=True)
class _Position:
    """The conversion of latitude and longitude, degrees, to metres north and east."""

    datum: Plane | None
    source: str
    scales: tuple[float, float]  # of each, to degrees
    sided: tuple[bool, bool]  # whether each has a hemisphere, in the last sources
    minutes: bool = False  # degrees and minutes in one number

    def _degrees(self, values: Sequence[Array]) -> list[Array]:
        """Return latitude, longitude and status, if there is one."""
        count = len(values) - sum(self.sided)
        sides, both = iter(values[count:]), []
        for angle, scale, sided in zip(values[:2], self.scales, self.sided, strict=True):
            degrees = from_minutes(scale * angle) if self.minutes else scale * angle
            both.append(np.abs(degrees) * next(sides) if sided else degrees)
        return [*both, *values[2:count]]

    def __call__(self, values: Sequence[Array]) -> list[Array]:
        values = self._degrees(values)
        beyond = np.abs(values[0]) > 90.0
        most = 2 * int(beyond.sum()) > len(beyond)
        if most and not (np.abs(values[1]) > 90.0).any():
            raise LogError(
                f"{self.source}: [position]: latitudes of up to {np.nanmax(np.abs(values[0])):.4g} "
                "degrees: latitude and longitude are swapped; exchange the two columns"
            )
        if most:
            raise LogError(f"{self.source}: [position]: {_beyond(values)}")
        latitude, longitude = _fixes(values)
        plane = self._plane(latitude, longitude)
        return [latitude, longitude] if plane is None else [*plane.metres(latitude, longitude)]

    def plane(self, values: Sequence[Array]) -> Plane | None:
        """Return the plane of the datum, else that of the first fix, if there is one."""
        return self._plane(*_fixes(self._degrees(values)))

    def _plane(self, latitude: Array, longitude: Array) -> Plane | None:
        if self.datum is not None or np.isnan(latitude).all():
            return self.datum
        known = np.flatnonzero(np.isfinite(latitude))
        middle = [float(np.sort(each[known])[len(known) // 2]) for each in (latitude, longitude)]
        metres = Plane(*middle).metres(latitude[known], longitude[known])
        near = known[np.hypot(*metres) < _FAR]
        if not len(near):
            raise LogError(
                f"{self.source}: [position]: no fix is within {_FAR / 1e3:g} km of their middle, "
                f"{middle[0]:.6g}, {middle[1]:.6g}; state a datum = [latitude, longitude]"
            )
        return Plane(float(latitude[near[0]]), float(longitude[near[0]]))


def _beyond(values: Sequence[Array]) -> str:
    """Return the complaint about latitudes and longitudes that are no degrees."""
    most = f"latitudes of up to {np.nanmax(np.abs(values[0])):.7g} are no degrees"
    if in_minutes(*values[:2]):
        return (
            f"{most}: NMEA has degrees and minutes in one number, ddmm.mm; "
            'state unit = "ddmm" in [position], south and west below 0'
        )
    return f"{most}; write degrees to the file, or give their scale"


def _fixes(values: Sequence[Array]) -> tuple[Array, Array]:
    """Return latitude and longitude, NaN where the receiver has no fix."""
    latitude, longitude = (value.copy() for value in values[:2])
    # 0, 0 and a status below 0 are a receiver without a fix
    none = (latitude == 0.0) & (longitude == 0.0)
    none |= ~(np.abs(latitude) <= 90.0) | ~(np.abs(longitude) <= 360.0) | (longitude == 181.0)
    if len(values) > 2:
        none |= values[2] < 0.0
    latitude[none], longitude[none] = np.nan, np.nan
    return latitude, longitude


def _yaw(enu: bool, offset: float) -> Callable[[Sequence[Array]], Sequence[Array]]:
    """Return the conversion of a quaternion to heading, rad; Fossen 2021, Eq. 2.76."""

    def convert(values: Sequence[Array]) -> list[Array]:
        x, y, z, w = values
        yaw = np.arctan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)
        # all zero: a driver that knows no orientation
        yaw[(x == 0.0) & (y == 0.0) & (z == 0.0) & (w == 0.0)] = np.nan
        return [np.remainder((0.5 * math.pi - yaw if enu else yaw) + offset, 2.0 * math.pi)]

    return convert


def _tilt(enu: bool) -> Callable[[Sequence[Array]], Sequence[Array]]:
    """Return the conversion of a quaternion to roll and pitch, rad; Fossen 2021, Eq. 2.76.

    In ROS the second axis points to port, so that bow down is above 0.
    """

    def convert(values: Sequence[Array]) -> list[Array]:
        x, y, z, w = values
        roll = np.arctan2(2.0 * (w * x + y * z), w * w - x * x - y * y + z * z)
        length = x * x + y * y + z * z + w * w
        sine = 2.0 * (w * y - z * x) / np.where(length > 0.0, length, np.nan)
        pitch = np.arcsin(np.clip(sine, -1.0, 1.0))
        roll[length == 0.0] = np.nan
        return [roll, -pitch if enu else pitch]

    return convert


def _source_of_air(enu: bool, on_board: bool) -> Callable[[Sequence[Array]], Sequence[Array]]:
    """Return the conversion of an air velocity to its speed and the direction that it comes from.

    The axes are east and north, or ahead and to port; without ``enu`` north and east, or ahead
    and to starboard.
    """

    def convert(values: Sequence[Array]) -> list[Array]:
        x, y = values
        if enu:
            x, y = (x, -y) if on_board else (y, x)
        return [np.hypot(x, y), np.arctan2(-y, -x)]

    return convert
