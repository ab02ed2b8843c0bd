"""Where and when the origin of a log lies: a plane that touches the Earth, and the clock."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pymap3d

from twin.logs.errors import LogError

__all__ = [
    "DATUM",
    "FEW",
    "FIXES",
    "Datum",
    "Plane",
    "from_minutes",
    "in_minutes",
    "odd_minutes",
]

Array = npt.NDArray[np.float64]

DATUM = ("datum_latitude_deg", "datum_longitude_deg", "datum_epoch_s")
"""Columns of a log's file that hold its datum, each with one value."""

FIXES = ("latitude_deg", "longitude_deg")
"""Columns that only place a log whose positions are in metres: where each fix was."""

FEW = 0.1
"""At most this share of the samples are single faults."""

_MISFIT = 5.0
_MISFIT_SHARE = 0.005
"""Nine fixes in ten lie within so many metres of their place on the plane, or within this share of
the way to the middle of them all: loggers have maps of their own, which are less exact."""

_LAST_YEAR = 253402300799.0
"""End of the year 9999, s since 1970."""


def in_minutes(latitude: Array, longitude: Array) -> bool:
    """Return whether most numbers can be degrees and minutes in one, ddmm.mm, as NMEA has them."""
    pairs = (latitude, 9000.0), (longitude, 18000.0)
    return all(odd_minutes(*each).sum() <= FEW * np.isfinite(each[0]).sum() for each in pairs)


def odd_minutes(values: Array, most: float) -> npt.NDArray[np.bool_]:
    """Return which numbers are no degrees and minutes in one, of up to ``most``."""
    size = np.abs(values)
    return np.asarray((size > most) | (size % 100.0 >= 60.0))


def from_minutes(values: Array) -> Array:
    """Return degrees of numbers that are degrees and minutes in one, ddmm.mm."""
    degrees = np.trunc(0.01 * values)
    return np.asarray(degrees + (values - 100.0 * degrees) / 60.0)


@dataclass(frozen=True)
class Plane:
    """The plane that touches the Earth (WGS 84) at an origin: metres north and east of it.

    Places lie on the ellipsoid and are taken straight down, or up, to the plane. They are those of
    this side of the Earth.

    Parameters
    ----------
    latitude, longitude : float
        Of the origin, degrees.
    """

    latitude: float
    longitude: float

    @classmethod
    def through(cls, fixes: tuple[Array, Array], metres: tuple[Array, Array], source: str) -> Plane:
        """Return the plane on which fixes, degrees, lie at places north and east, m.

        Raises
        ------
        LogError
            If the two move otherwise: by a factor, swapped, or turned.
        """
        known = np.isfinite(np.sum([*fixes, *metres], axis=0))
        if not known.any():
            raise LogError(f"{source}: [datum]: no row has latitude, longitude and a position")
        latitude, longitude, x, y = (values[known] for values in (*fixes, *metres))
        plane = cls(float(latitude[0]), float(longitude[0]))
        for _ in range(5):  # north at the origin is not quite north at the fixes
            north, east = plane.metres(latitude, longitude)
            off = float(np.median(north - x)), float(np.median(east - y))
            plane = cls(*map(float, plane.degrees(*off)))
        north, east = plane.metres(latitude, longitude)
        error = float(np.quantile(np.hypot(north - x, east - y), 0.9))
        extent = float(np.quantile(np.hypot(x - np.median(x), y - np.median(y)), 0.9))
        if error > max(_MISFIT, _MISFIT_SHARE * extent):
            raise LogError(
                f"{source}: [datum]: latitude and longitude move otherwise than gps_x_m and "
                f"gps_y_m (by {error:.3g} m); check scale, order and frame, or use [position]"
            )
        return plane

    def metres(self, latitude: Any, longitude: Any) -> tuple[Any, Any]:
        """Return metres north and east of the origin; of numbers or arrays, degrees."""
        origin = self.latitude, self.longitude, 0.0
        east, north, _ = pymap3d.geodetic2enu(latitude, longitude, 0.0, *origin)
        return north, east

    def degrees(self, north: Any, east: Any) -> tuple[Any, Any]:
        """Return latitude and longitude, degrees, of places north and east of the origin, m."""
        down: Any = 0.0
        with np.errstate(over="ignore", invalid="ignore"):  # a place may be any number
            for _ in range(3):  # down to the ellipsoid: within 1 cm as far as 500 km off
                latitude, longitude, height = pymap3d.enu2geodetic(
                    east, north, -down, self.latitude, self.longitude, 0.0
                )
                down = down + height
        return latitude[()], np.remainder(longitude + 180.0, 360.0)[()] - 180.0


@dataclass(frozen=True, kw_only=True)
class Datum:
    """Where and when a log has its origin, as far as that is known.

    Parameters
    ----------
    latitude, longitude : float or None
        Of x = y = 0, degrees (WGS 84); None where a log has metres only.
    epoch : float or None
        Time of t = 0, s since 1970 (UTC); None where a log has no absolute time.

    Raises
    ------
    LogError
        For numbers that are no place on Earth or no time.
    """

    latitude: float | None = None
    longitude: float | None = None
    epoch: float | None = None

    def __post_init__(self) -> None:
        bounds = {"latitude": 90.0, "longitude": 360.0, "epoch": _LAST_YEAR}
        for name, most in bounds.items():
            value = getattr(self, name)
            if value is None:
                continue
            number = isinstance(value, (int, float)) and not isinstance(value, bool)
            if not number or not abs(value) <= most:
                raise LogError(f"datum: {name} = {value!r} must be a number within {most:.10g}")
            object.__setattr__(self, name, float(value))
        if (self.latitude is None) != (self.longitude is None):
            raise LogError("datum: latitude and longitude come together; give both or none")

    @property
    def plane(self) -> Plane | None:
        """The plane on which positions are measured; None where it is not known."""
        if self.latitude is None or self.longitude is None:
            return None
        return Plane(self.latitude, self.longitude)

    def utc(self, t: Array) -> npt.NDArray[np.datetime64] | None:
        """Return times of a log, s, as dates to the microsecond; None without an epoch."""
        if self.epoch is None:
            return None
        whole = math.floor(self.epoch)
        since = np.round((t + (self.epoch - whole)) * 1e6)
        known = np.isfinite(since)
        dates = np.where(known, since, 0.0).astype("timedelta64[us]") + np.datetime64(whole, "s")
        return np.where(known, dates, np.datetime64("NaT")).astype("datetime64[us]")

    def __str__(self) -> str:
        place = f"latitude {self.latitude}, longitude {self.longitude}"
        parts = [] if self.latitude is None else [place]
        if self.epoch is not None:
            parts.append(f"t = 0 at {self.date}")
        return "; ".join(parts)

    @property
    def date(self) -> str:
        """The date of t = 0, for messages; empty where it is not known."""
        dates = self.utc(np.zeros(1))
        return "" if dates is None else f"{dates[0]} UTC"

    def same_place(self, other: Datum) -> bool:
        """Return whether the origins are equal to a centimetre, or one is not known."""
        one, two = self.plane, other.plane
        if one is None or two is None:
            return True
        return math.hypot(*one.metres(two.latitude, two.longitude)) < 0.01

    def same_clock(self, other: Datum) -> bool:
        """Return whether t = 0 is the same time to a millisecond, or one is not known."""
        if self.epoch is None or other.epoch is None:
            return True
        return abs(self.epoch - other.epoch) < 1e-3

    def to_json(self) -> dict[str, float | None]:
        """Return latitude, longitude and epoch by name."""
        return dict(vars(self))

    @classmethod
    def from_columns(cls, columns: Mapping[str, Array], source: str) -> Datum | None:
        """Return the datum that a file states in the columns :data:`DATUM`; None without any.

        Parameters
        ----------
        columns : mapping of str to ndarray
            Of the log.
        source : str
            File, for messages.
        """
        found = {}
        for name in DATUM:
            given = columns.get(name, np.zeros(0))
            values = np.unique(given[np.isfinite(given)])
            if len(values) > 1:
                raise LogError(
                    f"{source}: column {name} holds {len(values)} values, and a log has one "
                    "datum; split the file where it changes"
                )
            found[name.split("_")[1]] = float(values[0]) if len(values) else None
        return None if set(found.values()) == {None} else cls(**found)

    def columns(self, rows: int) -> dict[str, Array]:
        """Return the columns :data:`DATUM` of a file, as far as the datum is known."""
        values = zip(DATUM, (self.latitude, self.longitude, self.epoch), strict=True)
        return {name: np.full(rows, value) for name, value in values if value is not None}
