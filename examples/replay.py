"""Send a log as the live stream of a boat: for ``usv-twin view --nmea`` or ``--mavlink``.

``python examples/replay.py run.csv --nmea udp://:10110 --speed 5`` sends NMEA 0183 to this machine,
``--mavlink udp://:14550`` MAVLink 2. Without a log it is the recorded run, a hundred times as fast.
"""

from __future__ import annotations

import argparse
import itertools
import math
import time
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, date, datetime

import numpy as np
from numpy.typing import NDArray

from twin import Log, recorded_runs
from twin.channels import MEASUREMENTS
from twin.live.protocols.mavlink import (
    UNKNOWN_HEADING,
    UNKNOWN_PLACE,
    UNKNOWN_SPEED,
    MavlinkWriter,
    Servos,
)
from twin.logs.datum import Plane
from twin.logs.wire.nmea import DAY, KNOT
from twin.logs.wire.sockets import FeedError, needed, open_socket
from twin.sim.recorded import particulars_for_log

Array = NDArray[np.float64]

ORIGIN = (59.43, 10.47)
"""Where a log without a place lies unless given: in the Oslofjord, degrees."""

HELLO = 1.0
"""Time between two heartbeats of the autopilot, s of the log."""

NOT_IN_NMEA = ("accel_x_mps2", "accel_y_mps2", "accel_z_mps2", "gps_vz_mps")
"""Measurements that no sentence of NMEA 0183 holds."""


class NmeaRows:
    """Sentences of a talker, which has two letters; with ``tag`` rows have TAG blocks of time."""

    def __init__(self, talker: str, *, tag: bool = False) -> None:
        self.checksum = needed("pynmeagps").calc_checksum
        self.talker, self.tag = talker, tag

    def line(self, kind: str, *fields: str) -> str:
        """Return a sentence with its checksum."""
        return self._whole(self.talker + kind, *fields)

    def _whole(self, *fields: str) -> str:
        content = ",".join(fields)
        return f"${content}*{self.checksum(content)}\r\n"

    def gga(
        self, stamp: float, place: tuple[float, float], quality: int, height: float = math.nan
    ) -> str:
        """Return a fix; ``stamp`` is the time of day, s, ``height`` m above the sea."""
        metres = "" if math.isnan(height) else f"{height:.3f}"
        about = f"{quality}", "12", "0.8", metres, "M", "", "M", "", ""
        return self.line("GGA", clock_text(stamp), *place_texts(place), *about)

    def rmc(
        self,
        stamp: float,
        day: date,
        place: tuple[float, float] | None,
        velocity: tuple[float, float] | None,
        mode: str,
    ) -> str:
        """Return velocity over ground, m/s north and east, with place and date."""
        sides = ["", "", "", ""] if place is None else place_texts(place)
        motion = "", ""
        if velocity is not None:
            course = round(math.degrees(math.atan2(*velocity[::-1])) % 360.0, 3) % 360.0
            motion = f"{math.hypot(*velocity) / KNOT:.4f}", f"{course:.3f}"
        return self.line(
            "RMC", clock_text(stamp), "A", *sides, *motion, f"{day:%d%m%y}", "", "", mode
        )

    def hdt(self, heading: float) -> str:
        """Return a true heading, given in rad."""
        return self.line("HDT", f"{round(math.degrees(heading) % 360.0, 4) % 360.0:.4f}", "T")

    def rot(self, rate: float) -> str:
        """Return a rate of turn, given in rad/s."""
        return self.line("ROT", f"{60.0 * math.degrees(rate):.4f}", "A")

    def tilt(self, stamp: float, angles: tuple[float, float]) -> str:
        """Return roll and pitch, given in rad; fields of what is NaN are empty."""
        texts = ("" if math.isnan(value) else f"{math.degrees(value):+.4f}" for value in angles)
        return self._whole("PASHR", clock_text(stamp), "", "", *texts, "", "", "", "", "1")

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
        lines = [self.line("ZDA", clock_text(stamp), *f"{moment:%d %m %Y}".split(), "00", "00")]
        if place is not None:
            lines.append(self.gga(stamp, place, quality=4, height=-known["gps_z_m"]))
        if moves:
            lines.append(self.rmc(stamp, moment.date(), place, (north, east), mode="A"))
        if not math.isnan(known["compass_rad"]):
            lines.append(self.hdt(known["compass_rad"]))
        if not math.isnan(known["gyro_radps"]):
            lines.append(self.rot(known["gyro_radps"]))
        tilt = known["ahrs_roll_rad"], known["ahrs_pitch_rad"]
        if not all(map(math.isnan, tilt)):
            lines.append(self.tilt(stamp, tilt))
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
            lines = [f"\\{block}*{self.checksum(block)}\\{line}" for line in lines]
        return lines


def clock_text(stamp: float) -> str:
    """Return a time of day, s, as ``hhmmss.sss``."""
    ms = round(1000.0 * stamp) % 86400000
    minutes, ms = divmod(ms, 60000)
    return f"{minutes // 60:02d}{minutes % 60:02d}{ms // 1000:02d}.{ms % 1000:03d}"


def place_texts(place: tuple[float, float]) -> list[str]:
    """Return latitude and longitude, degrees, as ``ddmm.mmmmmmm`` and side each."""
    texts = []
    for angle, sides, digits in zip(place, ("NS", "EW"), (2, 3), strict=True):
        degrees, rest = divmod(round(abs(angle) * 60e7), 600000000)
        minutes, part = divmod(rest, 10000000)
        texts += [f"{degrees:0{digits}d}{minutes:02d}.{part:07d}", sides[int(angle < 0.0)]]
    return texts


class MavlinkRows(MavlinkWriter):
    """Messages of a row of a log; ``servos`` say how commands become pulses."""

    def __init__(self, servos: Servos, system: int = 1) -> None:
        super().__init__(system)
        self.servos = servos

    def hello(self) -> bytes:
        """Return the heartbeat of a boat."""
        d = self.dialect
        made = d.MAVLink_heartbeat_message
        boat, autopilot = d.MAV_TYPE_SURFACE_BOAT, d.MAV_AUTOPILOT_INVALID
        return self.pack(made(boat, autopilot, 0, 0, d.MAV_STATE_ACTIVE, 3))

    def position(
        self,
        stamp: float,
        place: tuple[float, float] | None,
        velocity: tuple[float, float] | None,
        down: tuple[float, float] = (math.nan, math.nan),
    ) -> bytes:
        """Return place (degrees), velocity over ground (m/s north, east), and both down."""
        lat = lon = UNKNOWN_PLACE
        if place is not None:
            lat, lon = (round(1e7 * value) for value in place)
        vx = vy = UNKNOWN_SPEED
        if velocity is not None:
            vx, vy = (min(max(round(100.0 * v), 1 - 2**15), 2**15 - 2) for v in velocity)
        # 0 stands for no height
        height = 0 if math.isnan(down[0]) else round(-1000.0 * down[0]) or 1
        vz = UNKNOWN_SPEED if math.isnan(down[1]) else round(100.0 * down[1])
        made = self.dialect.MAVLink_global_position_int_message
        return self.pack(
            made(milliseconds(stamp), lat, lon, height, 0, vx, vy, vz, UNKNOWN_HEADING)
        )

    def attitude(
        self,
        stamp: float,
        heading: float,
        rate: float,
        tilt: tuple[float, float] = (math.nan, math.nan),
        rates: tuple[float, float] = (math.nan, math.nan),
    ) -> bytes:
        """Return heading, roll and pitch, rad, and rates, rad/s; NaN where it is not known."""
        yaw = math.remainder(heading, 2.0 * math.pi)
        made = self.dialect.MAVLink_attitude_message
        return self.pack(made(milliseconds(stamp), *tilt, yaw, *rates, rate))

    def imu(self, stamp: float, force: tuple[float, float, float]) -> bytes:
        """Return the specific force forward, to starboard and down, m/s2; NaN where unknown."""
        made = self.dialect.MAVLink_highres_imu_message
        known = [not math.isnan(value) for value in force]
        numbers = (value if here else 0.0 for value, here in zip(force, known, strict=True))
        still = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        # bits of the last field: which parts are new
        flags = sum(here << bit for bit, here in enumerate(known))
        return self.pack(made(round(1e6 * stamp), *numbers, *still, flags))

    def wind(self, stamp: float, known: dict[str, float]) -> list[bytes]:
        """Return the true wind of measurements by name; no message holds the apparent one."""
        speed, angle = known["wind_mps"], known["wind_from_rad"]
        if math.isnan(speed) or math.isnan(angle):
            return []
        made = self.dialect.MAVLink_wind_cov_message
        air = -speed * math.cos(angle), -speed * math.sin(angle), 0.0
        return [self.pack(made(round(1e6 * stamp), *air, *[math.nan] * 5))]

    def row(
        self, stamp: float, z: Array, cmd: Array, place: tuple[float, float] | None
    ) -> list[bytes]:
        """Return the messages of one row of a log, a time (s) after the autopilot started.

        ``z`` (19,) has NaN where there is no measurement; ``place`` is latitude and longitude of
        the fix, degrees.
        """
        known = dict.fromkeys(MEASUREMENTS, math.nan)
        known |= zip(MEASUREMENTS, z.tolist(), strict=False)
        velocity = known["gps_vx_mps"], known["gps_vy_mps"]
        moves = not any(map(math.isnan, velocity))
        heading, rate = known["compass_rad"], known["gyro_radps"]
        made = []
        if place is not None or moves:
            down = known["gps_z_m"], known["gps_vz_mps"]
            made.append(self.position(stamp, place, velocity if moves else None, down=down))
        tilt = known["ahrs_roll_rad"], known["ahrs_pitch_rad"]
        rates = known["gyro_x_radps"], known["gyro_y_radps"]
        if not all(map(math.isnan, (heading, rate, *tilt, *rates))):
            made.append(self.attitude(stamp, heading, rate, tilt, rates))
        force = known["accel_x_mps2"], known["accel_y_mps2"], known["accel_z_mps2"]
        if not all(map(math.isnan, force)):
            made.append(self.imu(stamp, force))
        made += self.wind(stamp, known)
        if self.servos is not None:
            message = self.dialect.MAVLink_servo_output_raw_message
            micros = round(1e3 * round(1e3 * stamp)) % 2**32
            made.append(self.pack(message(micros, 0, *self.servos.widths(cmd))))
        return made


def milliseconds(stamp: float) -> int:
    """Return a time, s, in whole milliseconds of 32 bits."""
    return round(1000.0 * stamp) % 2**32


@dataclass(frozen=True)
class Datagram:
    """What is sent at once."""

    due: float  # when, s of the log
    data: bytes
    messages: int = 1  # how many messages it holds


class Stream(ABC):
    """Rows of a log as datagrams.

    ``origin`` is latitude and longitude, degrees, of north = east = 0 in the log; ``start`` the
    sender's clock at time 0 of the log, s.
    """

    def __init__(self, origin: tuple[float, float], start: float) -> None:
        if not (abs(origin[0]) < 90.0 and abs(origin[1]) <= 180.0):
            raise FeedError(
                f"origin {origin[0]:g}, {origin[1]:g}: latitude must be within 90 and longitude "
                "within 180 degrees"
            )
        self.plane, self.start = Plane(*origin), start

    def place(self, z: Array) -> tuple[float, float] | None:
        """Return latitude and longitude of a row, degrees."""
        north, east = z[:2].tolist()
        return None if math.isnan(north + east) else self.plane.degrees(north, east)

    @abstractmethod
    def row(self, t: float, z: Array, cmd: Array) -> Iterator[Datagram]:
        """Yield the datagrams of a row."""


class NmeaStream(Stream):
    """Rows as NMEA 0183, a datagram for each.

    ``start`` is UNIX time, by default now; with ``tag`` each sentence has a TAG block with its
    time.
    """

    def __init__(
        self,
        origin: tuple[float, float] = ORIGIN,
        start: float | None = None,
        *,
        tag: bool = False,
    ) -> None:
        super().__init__(origin, time.time() if start is None else start)
        self._writer = NmeaRows("GP", tag=tag)

    def row(self, t: float, z: Array, cmd: Array) -> Iterator[Datagram]:
        """Yield the datagram of a row."""
        lines = self._writer.row(self.start + t, z, cmd, self.place(z))
        yield Datagram(t, "".join(lines).encode(), len(lines))


class MavlinkStream(Stream):
    """Rows as MAVLink 2, up to three messages for each.

    ``start`` is the time since the autopilot started, by default 10 s.
    """

    def __init__(
        self, servos: Servos, origin: tuple[float, float] = ORIGIN, start: float = 10.0
    ) -> None:
        super().__init__(origin, start)
        self._writer = MavlinkRows(servos)
        self._greeted = -math.inf

    def row(self, t: float, z: Array, cmd: Array) -> Iterator[Datagram]:
        """Yield the datagrams of a row."""
        if t - self._greeted >= HELLO:
            self._greeted = t
            yield Datagram(t, self._writer.hello())
        for data in self._writer.row(self.start + t, z, cmd, self.place(z)):
            yield Datagram(t, data)


def schedule(
    log: Log, stream: Stream, *, loop: bool = False, counts: Counter[str] | None = None
) -> Iterator[Datagram]:
    """Yield the datagrams of a log in the order in which they are sent.

    Samples that are NaN are not sent. With ``loop`` it begins again at the end, for ever; the time
    goes on. ``counts`` receives the rows, datagrams and messages.
    """
    counts = Counter() if counts is None else counts
    length = float(log.t[-1] - log.t[0]) + log.dt
    for lap in itertools.count() if loop else (0,):
        for t, z, cmd in log:
            counts["rows"] += 1
            for datagram in stream.row(t + lap * length, z, cmd):
                counts["datagrams"] += 1
                counts["messages"] += datagram.messages
                yield datagram


def replay(
    log: Log,
    stream: Stream,
    address: str,
    *,
    speed: float = 1.0,
    loop: bool = False,
    progress: Callable[[float], None] = lambda t: None,
    counts: Counter[str] | None = None,
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], None] = time.sleep,
) -> Counter[str]:
    """Send a log to ``udp://HOST:PORT`` as a boat's stream, ``speed`` times as fast as it happened.

    ``progress`` receives the time of the log that is sent, s. Returned are the counts: those of
    :func:`schedule`, and datagrams ``unsent``.
    """
    if len(log) < 2:
        raise FeedError(f"{log.name}: has {len(log)} row(s); a stream needs two")
    if not (math.isfinite(speed) and speed > 0.0):
        raise FeedError(f"speed {speed}: must be finite and above 0; 1 is as it happened")
    counts = Counter() if counts is None else counts
    output, target = open_socket(address, bind=False)
    with output:
        begun = clock()
        for datagram in schedule(log, stream, loop=loop, counts=counts):
            wait = begun + (datagram.due - float(log.t[0])) / speed - clock()
            if wait > 0.0:
                sleep(wait)
            try:
                output.sendto(datagram.data, target)
            except OSError:
                counts["unsent"] += 1
            progress(datagram.due)
    return counts


def main(arguments: list[str] | None = None) -> None:
    """Send a log."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("log", nargs="?", default=str(recorded_runs()["boat1_usv_circle"]))
    parser.add_argument("--nmea", metavar="udp://HOST:PORT", help="send NMEA 0183")
    parser.add_argument("--mavlink", metavar="udp://HOST:PORT", help="send MAVLink 2")
    parser.add_argument("--ship", help="boat whose full throttle scales MAVLink's servo outputs")
    parser.add_argument("--speed", type=float, help="factor on the speed of time")
    parser.add_argument("--loop", action="store_true", help="start over at the end, for ever")
    given = parser.parse_args(arguments)
    log = Log.read(given.log)
    plane = None if log.datum is None else log.datum.plane
    place = ORIGIN if plane is None else (plane.latitude, plane.longitude)
    if given.mavlink:
        boat = particulars_for_log(given.log, given.ship)
        stream: Stream = MavlinkStream(Servos.of(boat), place)
    else:
        stream = NmeaStream(place)
    target = given.mavlink or given.nmea or "udp://:10110"
    speed = given.speed or (1.0 if given.mavlink or given.nmea else 100.0)
    counts: Counter[str] = Counter()
    print(f"sending {log.name} to {target}, {speed:g} times as fast")
    try:
        replay(log, stream, target, speed=speed, loop=given.loop, counts=counts)
    except KeyboardInterrupt:
        print("stopped: the rest is not sent")
    print("sent:", ", ".join(f"{count} {name}" for name, count in counts.items() if count))


if __name__ == "__main__":
    main()
