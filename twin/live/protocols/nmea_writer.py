"""NMEA 0183: sentences of what a boat measures, and of what the twin says."""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import UTC, date, datetime

import numpy as np
from numpy.typing import NDArray

from twin.channels import MEASUREMENTS
from twin.live.protocols.sockets import needed

__all__ = [
    "DAY",
    "KNOT",
    "NOT_IN_NMEA",
    "NmeaWriter",
]

Array = NDArray[np.float64]

DAY = 86400.0

KNOT = 1852.0 / 3600.0

NOT_IN_NMEA = ("accel_x_mps2", "accel_y_mps2", "accel_z_mps2", "gps_vz_mps")
"""Measurements that no sentence of NMEA 0183 holds."""


class NmeaWriter:
    """Sentences of a talker.

    Parameters
    ----------
    talker : str
        Two letters.
    tag : bool
        Whether :meth:`row` puts a TAG block with the time before each sentence.
    """

    def __init__(self, talker: str, *, tag: bool = False) -> None:
        self._checksum = needed("pynmeagps").calc_checksum
        self.talker, self.tag = talker, tag

    def line(self, kind: str, *fields: str) -> str:
        """Return a sentence with its checksum."""
        return self._whole(self.talker + kind, *fields)

    def _whole(self, *fields: str) -> str:
        content = ",".join(fields)
        return f"${content}*{self._checksum(content)}\r\n"

    def gga(
        self,
        stamp: float,
        latitude: float,
        longitude: float,
        quality: int,
        height: float = math.nan,
    ) -> str:
        """Return a fix; ``stamp`` is the time of day, s, ``height`` m above the sea."""
        place = _text(latitude, "NS", 2, 7), _text(longitude, "EW", 3, 7)
        satellites = ("", "") if quality == 6 else ("12", "0.8")
        return self.line(
            "GGA",
            _clock(stamp),
            *place[0],
            *place[1],
            f"{quality}",
            *satellites,
            "" if math.isnan(height) else f"{height:.3f}",
            "M",
            "",
            "M",
            "",
            "",
        )

    def rmc(
        self,
        stamp: float,
        day: date,
        place: tuple[float, float] | None,
        north: float | None,
        east: float | None,
        mode: str,
    ) -> str:
        """Return velocity over ground, m/s, with place and date."""
        sides: tuple[str, ...] = ("", "", "", "")
        if place is not None:
            sides = (*_text(place[0], "NS", 2, 7), *_text(place[1], "EW", 3, 7))
        motion = ("", "")
        if north is not None and east is not None:
            speed = f"{math.hypot(north, east) / KNOT:.4f}"
            course = round(math.degrees(math.atan2(east, north)) % 360.0, 3) % 360.0
            motion = speed, f"{course:.3f}"
        return self.line("RMC", _clock(stamp), "A", *sides, *motion, f"{day:%d%m%y}", "", "", mode)

    def hdt(self, heading: float) -> str:
        """Return a true heading, given in rad."""
        return self.line("HDT", f"{round(math.degrees(heading) % 360.0, 4) % 360.0:.4f}", "T")

    def rot(self, rate: float) -> str:
        """Return a rate of turn, given in rad/s."""
        return self.line("ROT", f"{60.0 * math.degrees(rate):.4f}", "A")

    def wind(self, known: dict[str, float]) -> list[str]:
        """Return what measurements by name hold of the apparent and of the true wind."""
        lines = []
        speed, angle = known["apparent_wind_mps"], known["apparent_wind_rad"]
        if not (math.isnan(speed) or math.isnan(angle)):
            degrees = round(math.degrees(angle) % 360.0, 2) % 360.0
            lines.append(self.line("MWV", f"{degrees:.2f}", "R", f"{speed:.3f}", "M", "A"))
        speed, angle = known["wind_mps"], known["wind_from_rad"]
        if not (math.isnan(speed) or math.isnan(angle)):
            degrees = round(math.degrees(angle) % 360.0, 2) % 360.0
            knots, metres = f"{speed / KNOT:.3f}", f"{speed:.3f}"
            lines.append(self.line("MWD", f"{degrees:.2f}", "T", "", "M", knots, "N", metres, "M"))
        return lines

    def angles(self, values: dict[str, float]) -> list[str]:
        """Return the angles (rad) or rates (rad/s) of transducers by name, without NaN."""
        known = {name: value for name, value in values.items() if not math.isnan(value)}
        parts = [("A", f"{math.degrees(v):.4f}", "D", name) for name, v in known.items()]
        return [self.line("XDR", *(field for part in parts for field in part))] if parts else []

    def attitude(
        self,
        stamp: float,
        heading: float,
        tilt: tuple[float, float],
        heave: float = math.nan,
        sd: Sequence[float] | Array = (),
    ) -> str:
        """Return heading, roll, pitch and their standard deviations (rad), and heave (m, down).

        Fields of what is NaN are empty.
        """
        degrees = [math.degrees(value) for value in (heading % (2.0 * math.pi), *tilt)]
        fields = (
            *("PASHR", _clock(stamp)),
            *(("", "") if math.isnan(heading) else (f"{degrees[0]:.2f}", "T")),
            *("" if math.isnan(value) else f"{value:+.4f}" for value in degrees[1:]),
            "" if math.isnan(heave) else f"{-heave:+.2f}",
            *(f"{math.degrees(value):.3f}" for value in sd),
            *[""] * (2 - len(sd)),
            *("", "1"),
        )
        return self._whole(*fields)

    def motion(self, stamp: float, after: float, mean: Array, sd: Array) -> str:
        """Return a forecast (4,) of roll, pitch, heave and deck speed, with deviations (4,)."""
        values = [*np.degrees(mean[:2]), *mean[2:], *np.degrees(sd[:2]), *sd[2:]]
        texts = [f"{min(max(value, -999.0), 999.0):.2f}" for value in values]
        fields = ("PUTWM", _clock(stamp), f"{after:.1f}", *texts)
        return self._whole(*fields)

    def quiet(self, stamp: float, probabilities: Array) -> str:
        """Return the probabilities (3,) of a quiet deck; fields of what is NaN are empty."""
        values = probabilities.tolist()
        texts = ("" if math.isnan(value) else f"{value:.2f}" for value in values)
        fields = ("PUTWQ", _clock(stamp), *texts)
        return self._whole(*fields)

    def predicted(
        self, stamp: float, after: float, place: tuple[float, float], heading: float, cov: Array
    ) -> str:
        """Return a point of a prediction; see the head of this module.

        Parameters
        ----------
        stamp, after : float
            Time of day at which it was made, and the horizon, s.
        place : tuple of float
            Latitude and longitude, degrees.
        heading : float
            Rad.
        cov : ndarray, shape (2, 2)
            Covariance of north and east, m2.
        """
        sd = np.sqrt(np.maximum(np.diagonal(cov), 0.0))
        both = float(sd[0] * sd[1])
        correlation = min(max(float(cov[0, 1]) / both, -1.0), 1.0) if both > 0.0 else 0.0
        fields = (
            *("PUTWP", _clock(stamp), f"{after:.1f}"),
            *_text(place[0], "NS", 2, 5),
            *_text(place[1], "EW", 3, 5),
            f"{round(math.degrees(heading) % 360.0, 1) % 360.0:.1f}",
            *(f"{min(value, 999.99):.2f}" for value in sd.tolist()),
            f"{correlation:.2f}",
        )
        return self._whole(*fields)

    def health(self, stamp: float, sensor: str, status: str) -> str:
        """Return the new status of a sensor; see the head of this module."""
        fields = ("PUTWH", _clock(stamp), sensor, status)
        return self._whole(*fields)

    def row(
        self, when: float, z: Array, cmd: Array, place: tuple[float, float] | None
    ) -> list[str]:
        """Return the sentences of one row of a log, the time of the row (ZDA) first.

        Those of :data:`NOT_IN_NMEA` are left out.

        Parameters
        ----------
        when : float
            UNIX time, s.
        z, cmd : ndarray, shapes (19,), (4,)
            Measurements, NaN where there is none, and commands.
        place : tuple of float or None
            Latitude and longitude of the fix, degrees.
        """
        moment = datetime.fromtimestamp(round(when, 3), UTC)
        stamp = when % DAY
        known = dict.fromkeys(MEASUREMENTS, math.nan)
        known |= zip(MEASUREMENTS, z.tolist(), strict=False)
        north, east = known["gps_vx_mps"], known["gps_vy_mps"]
        moves = not (math.isnan(north) or math.isnan(east))
        lines = [self.line("ZDA", _clock(stamp), *f"{moment:%d %m %Y}".split(), "00", "00")]
        if place is not None:
            lines.append(self.gga(stamp, *place, quality=4, height=-known["gps_z_m"]))
        if moves:
            lines.append(self.rmc(stamp, moment.date(), place, north, east, mode="A"))
        if not math.isnan(known["compass_rad"]):
            lines.append(self.hdt(known["compass_rad"]))
        if not math.isnan(known["gyro_radps"]):
            lines.append(self.rot(known["gyro_radps"]))
        tilt = known["ahrs_roll_rad"], known["ahrs_pitch_rad"]
        if not all(map(math.isnan, tilt)):
            lines.append(self.attitude(stamp, math.nan, tilt))
            lines += self.angles(dict(zip(("ROLL", "PTCH"), tilt, strict=True)))
        rates = known["gyro_x_radps"], known["gyro_y_radps"]
        lines += self.angles(dict(zip(("ROLLRATE", "PTCHRATE"), rates, strict=True)))
        lines += self.wind(known)
        left, right, *angles = cmd.tolist()
        lines += [
            self.line("RPM", "S", number, f"{60.0 * speed:.4f}", "", "A")
            for number, speed in (("1", right), ("2", left))
        ]
        port, starboard = (f"{math.degrees(angle):.4f}" for angle in angles)
        lines.append(self.line("RSA", starboard, "A", port, "A"))
        if self.tag:
            block = f"c:{round(1000.0 * when)}"
            lines = [f"\\{block}*{self._checksum(block)}\\{line}" for line in lines]
        return lines


def _clock(stamp: float) -> str:
    """Return a time of day, s, as ``hhmmss.sss``."""
    ms = round(1000.0 * stamp) % 86400000
    minutes, ms = divmod(ms, 60000)
    return f"{minutes // 60:02d}{minutes % 60:02d}{ms // 1000:02d}.{ms % 1000:03d}"


def _text(angle: float, sides: str, digits: int, decimals: int) -> Sequence[str]:
    """Return an angle, degrees, as ``ddmm.mmm`` and its side."""
    unit = 10**decimals
    degrees, rest = divmod(round(abs(angle) * 60.0 * unit), 60 * unit)
    minutes, part = divmod(rest, unit)
    text = f"{degrees:0{digits}d}{minutes:02d}.{part:0{decimals}d}"
    return text, sides[0] if angle >= 0.0 else sides[1]
