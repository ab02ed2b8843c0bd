"""MAVLink 2 (and 1) over UDP: messages of an autopilot as rows, and the twin's estimates back.

Taken are GLOBAL_POSITION_INT (fix and velocity, with height and climb), ATTITUDE (heading, roll,
pitch and rates), the accelerometers of HIGHRES_IMU, SCALED_IMU or RAW_IMU, and SERVO_OUTPUT_RAW
(commands, by :class:`Servos`). The gyros of the IMU count where ATTITUDE has no rates, and of
HIGHRES_IMU what its flags name. WIND_COV and ArduPilot's WIND are the true wind. They are of one
component: the first that sends GLOBAL_POSITION_INT, or the autopilot (component 1) with ATTITUDE.
While GPS_RAW_INT says that there is no fix, the position is no measurement but the autopilot's own
dead reckoning, and counts as void. The largest value of a field of GLOBAL_POSITION_INT, and NaN in
ATTITUDE, mean that it is not known.

The twin answers as the onboard computer (component 191) of that system, with HEARTBEAT once a
second. Its estimates are GLOBAL_POSITION_INT, ATTITUDE and ODOMETRY (in the local frame of the
autopilot, whose origin it asks for, with variances). Its forecasts are
TRAJECTORY_REPRESENTATION_WAYPOINTS (positions, velocities and headings 2, 4, 6, 8, 10 s ahead,
local NED). For each, DEBUG_FLOAT_ARRAY ``sd_pos`` has seconds ahead and standard deviations north
and east, m. Where roll and pitch are known, ATTITUDE has them, DEBUG_FLOAT_ARRAY ``motion`` has
rows of nine numbers: seconds ahead, then roll, pitch (rad), heave (m, down), vertical speed of the
deck (m/s, down) and their standard deviations. ``quiet`` has the probabilities of a deck that stays
quiet for 2, 3 and 5 s, NaN until past forecasts were compared with what came.

Source: MAVLink common message set, https://mavlink.io/en/messages/common.html
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.channels import PSI, R, U, V, X, Y
from twin.live.protocols.feed import Feed, Message
from twin.live.protocols.nmea import HORIZONS, MOTION_HORIZONS
from twin.live.protocols.sockets import Address, needed
from twin.particulars import GRAVITY, Particulars
from twin.predictors.base import Estimate, Prediction
from twin.tilt import body_velocity, body_yaw_rate
from usv_kernel.servos import Servos

__all__ = [
    "JumpCounter",
    "MavlinkFeed",
    "MavlinkWriter",
    "Servos",
]

Array = NDArray[np.float64]

WRAP = 2.0**32

UNKNOWN_SPEED, UNKNOWN_PLACE, UNKNOWN_HEADING = 2**15 - 1, 2**31 - 1, 2**16 - 1

NEAR = 5.0
"""A servo output whose time differs by more than this, s, from the last one has another clock."""

RATES_GONE = 2.0
"""So long after the last rates of ATTITUDE those of the IMU count, s."""

HEARTBEAT = 1.0
"""Time between two, s."""

REQUEST_MESSAGE, ORIGIN_MESSAGE = 512, 49
"""Command that asks for a message, and the message GPS_GLOBAL_ORIGIN."""

_IMU_PARTS = (
    *("accel_x_mps2", "accel_y_mps2", "accel_z_mps2"),
    *("gyro_x_radps", "gyro_y_radps", "gyro_radps"),
)
"""What an IMU measures, in the order of the flags of HIGHRES_IMU."""

ALL_PARTS = 2 ** len(_IMU_PARTS) - 1

AUTOPILOT, ONBOARD = 1, 191
"""Components: MAV_COMP_ID_AUTOPILOT1, and that of the twin, MAV_COMP_ID_ONBOARD_COMPUTER."""


JUMP = 0.5
"""An estimate that moves by more than its velocity explains and this, m, has jumped."""


class JumpCounter:
    """Counts the jumps of an estimate, as the field ``reset_counter`` of ODOMETRY does.

    An EKF refuses a place far from its own, unless the counter says that the estimate was reset.
    """

    def __init__(self) -> None:
        self.count = 0
        self._last: tuple[float, float, float, float, float] | None = None

    def take(self, t: float, state: Array) -> int:
        """Take a time (s) and state (6,), in order; return the count, from 0 to 255."""
        c, s = math.cos(state[PSI]), math.sin(state[PSI])
        north, east = state[U] * c - state[V] * s, state[U] * s + state[V] * c
        if self._last is not None:
            before, x, y, vx, vy = self._last
            dt = t - before
            ahead = x + 0.5 * dt * (vx + north), y + 0.5 * dt * (vy + east)
            if math.dist(ahead, (state[X], state[Y])) > JUMP:
                self.count = (self.count + 1) % 256
        self._last = t, float(state[X]), float(state[Y]), float(north), float(east)
        return self.count


class MavlinkFeed(Feed):
    """Messages of an autopilot as rows; without ``servos``, the outputs are those of the boat.

    See :class:`~twin.live.protocols.feed.Feed` and :meth:`Servos.of`.
    """

    modulus = WRAP / 1000.0

    def __init__(
        self,
        address: str | None,
        particulars: Particulars,
        reply: str | None = None,
        *,
        servos: Servos | None = None,
        **options: Any,
    ) -> None:
        self._writer = MavlinkWriter(component=ONBOARD)
        self.servos = servos or Servos.of(particulars)
        self.system: int | None = None
        self._component = AUTOPILOT
        self._parser = self._writer.parser()
        self._lost = False
        self._boot = math.nan
        self._greeted = -math.inf
        self._jumps = JumpCounter()
        self._heard = -math.inf
        self._rated: dict[str, float] = {}
        self.local_origin: tuple[float, float] | None = None
        super().__init__(address, particulars, reply, **options)

    def receive(self, data: bytes, arrival: float, source: Address | None = None) -> None:
        """See :meth:`Feed.receive`."""
        self._heard = arrival
        super().receive(data, arrival, source)

    def decode(self, data: bytes) -> Iterator[Message | str]:
        """Yield the messages of a datagram; see :meth:`Feed.decode`."""
        if self._parser.buf_len() and data[:1] in (b"\xfd", b"\xfe"):
            yield "broken"  # the last datagram ended in a message that this one does not continue
            self._parser = self._writer.parser()
        for item in self._parser.parse_buffer(data) or ():
            yield self._message(item)

    def greet(self, now: float) -> Iterator[bytes]:
        """Yield the heartbeat, once a second, and the question for the local origin."""
        if now - self._greeted >= HEARTBEAT:
            self._greeted = now
            yield self._writer.heartbeat()
            if self.system is not None and self.local_origin is None:
                yield self._writer.command(self.system, REQUEST_MESSAGE, ORIGIN_MESSAGE)

    @property
    def offset(self) -> tuple[float, float]:
        """Origin of the autopilot's local frame, m north and east of ours; 0 until it is known."""
        if self._plane is None or self.local_origin is None:
            return 0.0, 0.0
        north, east = self._plane.metres(*self.local_origin)
        return float(north), float(east)

    def encode(self, estimate: Estimate, prediction: Prediction | None) -> Iterator[bytes]:
        """Yield the twin's estimates, a message in each datagram; see :meth:`Feed.encode`."""
        write, now = self._writer, self.stamp_of(estimate.t)
        latitude, longitude, north, east = self.place_of(estimate.state)
        heading, rate = float(estimate.state[PSI]), float(estimate.state[R])
        motion = estimate.motion
        down = math.nan, 0.0 if motion is None else motion.vertical_speed
        yield write.position(now, (latitude, longitude), (north, east), heading, down)
        if motion is None:
            yield write.attitude(now, heading, rate)
        else:
            tilt, rates = (motion.roll, motion.pitch), (motion.roll_rate, motion.pitch_rate)
            turn = float(body_yaw_rate(rate, tilt, motion.pitch_rate))
            yield write.attitude(now, heading, turn, tilt, rates)
        resets = self._jumps.take(estimate.t, estimate.state)
        origin = self.offset
        yield write.odometry(now, estimate, origin=origin, resets=resets)
        if prediction is not None:
            end = float(prediction.t[-1] - prediction.t0) + 1e-6
            horizons = np.array([h for h in HORIZONS if h <= end])
            if len(horizons):
                mean, cov = prediction.at(horizons)
                made = self.stamp_of(prediction.t0)
                yield write.trajectory(made, mean)
                sd = np.sqrt(np.maximum(np.diagonal(cov, axis1=1, axis2=2)[:, :2], 0.0))
                yield write.floats(made, b"sd_pos", np.column_stack([horizons, sd]))
            if (ahead := prediction.motion) is not None:
                times = (0.0, *MOTION_HORIZONS)
                table = np.column_stack([times, *ahead.at(times)])
                yield write.floats(self.stamp_of(prediction.t0), b"motion", table)
                yield write.floats(self.stamp_of(prediction.t0), b"quiet", ahead.known_quiet)

    def encode_health(self, stamp: float, sensor: str, status: str, why: str) -> bytes:
        """See :meth:`Feed.encode_health`; a STATUSTEXT, which ground stations show and speak."""
        return self._writer.text(why or f"{sensor} {status}", status != "ok")

    def _message(self, item: Any) -> Message | str:
        """Return what a message says, or how it counts."""
        kind = item.get_type()
        if kind == "BAD_DATA":
            return "broken"
        system, component = item.get_srcSystem(), item.get_srcComponent()
        if component == ONBOARD and system in (self.system, self._writer.system):
            return "own"
        read = self._readers().get(kind)
        # a gimbal sends its attitude, too
        known = kind == "GLOBAL_POSITION_INT" or (kind == "ATTITUDE" and component == AUTOPILOT)
        if self.system is None and known:
            self.system = self._writer.system = system
            self._component = component
        if kind == "HEARTBEAT" and self.system in (None, system):  # says that it is there
            return Message("heartbeat")
        followed = (system, component) == (self.system, self._component)
        return read(item) if read is not None and followed else "unknown"

    def _readers(self) -> dict[str, Callable[[Any], Message]]:
        """Return what reads each kind of message."""
        return {
            "GLOBAL_POSITION_INT": self._position,
            "ATTITUDE": self._attitude,
            "HIGHRES_IMU": self._imu,
            "SCALED_IMU": self._imu,
            "RAW_IMU": self._imu,
            "SERVO_OUTPUT_RAW": self._servo_outputs,
            "GPS_RAW_INT": self._receiver,
            "GPS_GLOBAL_ORIGIN": self._local_origin,
            "WIND_COV": self._wind_cov,
            "WIND": self._wind,
        }

    def _position(self, item: Any) -> Message:
        self._boot = stamp = item.time_boot_ms / 1000.0
        place = None
        if not self._lost and UNKNOWN_PLACE not in (item.lat, item.lon) and (item.lat or item.lon):
            place = item.lat / 1e7, item.lon / 1e7
        values = {}
        if not self._lost and UNKNOWN_SPEED not in (item.vx, item.vy):
            values = {"gps_vx_mps": item.vx / 100.0, "gps_vy_mps": item.vy / 100.0}
            if item.vz != UNKNOWN_SPEED:
                values["gps_vz_mps"] = item.vz / 100.0
        # 0 is what a sender without a height writes
        if place is not None and item.alt != 0:
            values["gps_z_m"] = -item.alt / 1000.0
        return Message("position", stamp, values, place, void=place is None and not values)

    def _attitude(self, item: Any) -> Message:
        self._boot = stamp = item.time_boot_ms / 1000.0
        yaw = item.yaw % (2.0 * math.pi) if math.isfinite(item.yaw) else item.yaw
        found = {"compass_rad": yaw, "gyro_radps": item.yawspeed}
        found |= {"ahrs_roll_rad": item.roll, "ahrs_pitch_rad": item.pitch}
        found |= {"gyro_x_radps": item.rollspeed, "gyro_y_radps": item.pitchspeed}
        values = {name: value for name, value in found.items() if not math.isnan(value)}
        self._rated |= dict.fromkeys(values.keys() & set(_IMU_PARTS), self._heard)
        return Message("attitude", stamp, values, void=not values)

    def _imu(self, item: Any) -> Message:
        """Return accelerations and rates of an IMU; milli-g are of the autopilot's own scale."""
        force, turn, flags = 1.0, 1.0, ALL_PARTS
        if item.get_type() == "HIGHRES_IMU":
            flags = item.fields_updated
        else:
            force, turn = GRAVITY / 1000.0, 1.0 / 1000.0
        if item.get_type() == "SCALED_IMU":
            stamp = item.time_boot_ms / 1000.0
        else:
            stamp = item.time_usec / 1e6
        timed = abs(stamp - self._boot) < NEAR
        values = {}
        parts = item.xacc, item.yacc, item.zacc, item.xgyro, item.ygyro, item.zgyro
        for bit, (name, part) in enumerate(zip(_IMU_PARTS, parts, strict=True)):
            # the autopilot's own rates have lost the bias of its gyros
            rated = self._heard - self._rated.get(name, -math.inf) < RATES_GONE
            if flags & 1 << bit and math.isfinite(part) and not rated:
                values[name] = (force if bit < 3 else turn) * float(part)
        return Message("imu", stamp if timed else None, values, void=not values)

    def _servo_outputs(self, item: Any) -> Message:
        widths = [getattr(item, f"servo{i}_raw") for i in range(1, 17)]
        # 32 bits of microseconds wrap every 72 minutes, those of milliseconds later
        stamp = item.time_usec / 1e6
        stamp += round((self._boot - stamp) * 1e6 / WRAP) * WRAP / 1e6 if self._boot >= 0.0 else 0.0
        timed = abs(stamp - self._boot) < NEAR
        values = self.servos.commands(widths) if item.port == 0 else {}
        return Message("servos", stamp if timed else None, values, void=not values)

    def _wind_cov(self, item: Any) -> Message:
        """Return the true wind, given as the velocity of the air."""
        stamp = item.time_usec / 1e6
        timed = abs(stamp - self._boot) < NEAR
        speed = math.hypot(item.wind_x, item.wind_y)
        values = {}
        if math.isfinite(speed):
            values = {"wind_mps": speed, "wind_from_rad": math.atan2(-item.wind_y, -item.wind_x)}
        return Message("wind", stamp if timed else None, values, void=not values)

    def _wind(self, item: Any) -> Message:
        """Return the true wind of ArduPilot, by the direction that it comes from, degrees."""
        values = {}
        if math.isfinite(item.direction) and 0.0 <= item.speed < math.inf:
            turned = math.remainder(math.radians(item.direction), 2.0 * math.pi)
            values = {"wind_mps": item.speed, "wind_from_rad": turned}
        return Message("wind", None, values, void=not values)

    def _receiver(self, item: Any) -> Message:
        # 0: no receiver, 1: no fix
        self._lost = item.fix_type < 2
        return Message("receiver", void=self._lost)

    def _local_origin(self, item: Any) -> Message:
        if item.latitude or item.longitude:  # 0, 0 is what a sender without one writes
            self.local_origin = item.latitude / 1e7, item.longitude / 1e7
        return Message("origin", void=self.local_origin is None)


class MavlinkWriter:
    """Messages of a component, each as a datagram."""

    def __init__(self, system: int = 1, component: int = 1) -> None:
        self.dialect = needed("pymavlink.dialects.v20.ardupilotmega")  # the common set, and WIND
        self._link = self.dialect.MAVLink(None, srcSystem=system, srcComponent=component)

    @property
    def system(self) -> int:
        """Number of the system that speaks."""
        return int(self._link.srcSystem)

    @system.setter
    def system(self, system: int) -> None:
        self._link.srcSystem = system

    def parser(self) -> Any:
        """Return a new parser of messages that goes on after broken ones."""
        made = self.dialect.MAVLink(None)
        made.robust_parsing = True
        return made

    def heartbeat(self, kind: str = "MAV_TYPE_ONBOARD_CONTROLLER") -> bytes:
        """Return the sign of life of a system of some kind."""
        d = self.dialect
        return self.pack(
            d.MAVLink_heartbeat_message(
                getattr(d, kind), d.MAV_AUTOPILOT_INVALID, 0, 0, d.MAV_STATE_ACTIVE, 3
            )
        )

    def position(
        self,
        stamp: float,
        place: tuple[float, float] | None,
        velocity: tuple[float, float] | None,
        heading: float = math.nan,
        down: tuple[float, float] = (math.nan, math.nan),
    ) -> bytes:
        """Return place (degrees), velocity over ground (m/s north, east), and both down."""
        lat = lon = UNKNOWN_PLACE
        if place is not None:
            lat, lon = (round(1e7 * value) for value in place)
        vx = vy = UNKNOWN_SPEED
        if velocity is not None:
            vx, vy = (min(max(round(100.0 * v), 1 - 2**15), 2**15 - 2) for v in velocity)
        course = UNKNOWN_HEADING
        if not math.isnan(heading):
            course = round(100.0 * math.degrees(heading)) % 36000
        # 0 stands for no height
        height = 0 if math.isnan(down[0]) else round(-1000.0 * down[0]) or 1
        vz = UNKNOWN_SPEED if math.isnan(down[1]) else round(100.0 * down[1])
        made = self.dialect.MAVLink_global_position_int_message
        return self.pack(made(_ms(stamp), lat, lon, height, 0, vx, vy, vz, course))

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
        return self.pack(made(_ms(stamp), *tilt, yaw, *rates, rate))

    def odometry(
        self,
        stamp: float,
        estimate: Estimate,
        *,
        origin: tuple[float, float] = (0.0, 0.0),
        resets: int = 0,
        quality: int = 100,
    ) -> bytes:
        """Return an estimate with its variances; roll, pitch and heave where it has them.

        ``origin`` is that of the autopilot's local frame, m north and east. ``resets`` counts the
        jumps of the estimate. ``quality`` is per cent, -1 for an estimate that has failed.

        Notes
        -----
        ArduPilot takes frame MAV_FRAME_LOCAL_FRD alone, and an infinite or unknown variance stops
        it from arming. Variances of what is not estimated are 0. Velocities and rates are in the
        axes of the heeled boat; ArduPilot turns them back by the quaternion.
        """
        d = self.dialect
        x, y, psi, u, v, r = estimate.state.tolist()
        sd, motion = estimate.sd, estimate.motion
        velocity, rates = [u, v, 0.0], (0.0, 0.0, r)
        heave, tilt, off = 0.0, (0.0, 0.0), np.zeros(3)
        if motion is not None:
            heave, tilt, off = motion.heave, (motion.roll, motion.pitch), motion.sd[:3]
            velocity = body_velocity((u, v, motion.vertical_speed), tilt).tolist()
            turn = float(body_yaw_rate(r, tilt, motion.pitch_rate))
            rates = motion.roll_rate, motion.pitch_rate, turn
        made = d.MAVLink_odometry_message(
            time_usec=round(1e6 * stamp),
            frame_id=d.MAV_FRAME_LOCAL_FRD,
            child_frame_id=d.MAV_FRAME_BODY_FRD,
            x=x - origin[0],
            y=y - origin[1],
            z=heave,
            q=_quaternion(*tilt, psi),
            vx=velocity[0],
            vy=velocity[1],
            vz=velocity[2],
            rollspeed=rates[0],
            pitchspeed=rates[1],
            yawspeed=rates[2],
            pose_covariance=_triangle([sd[0], sd[1], off[2], off[0], off[1], sd[2]]),
            velocity_covariance=_triangle([sd[U], sd[V], 0.0, 0.0, 0.0, sd[R]]),
            reset_counter=resets,
            estimator_type=d.MAV_ESTIMATOR_TYPE_GPS_INS,
            quality=quality,
        )
        return self.pack(made)

    def command(self, system: int, command: int, *parameters: float) -> bytes:
        """Return a COMMAND_LONG to the autopilot of a system, with up to seven parameters."""
        values = [*parameters, *[0.0] * (7 - len(parameters))]
        made = self.dialect.MAVLink_command_long_message
        return self.pack(made(system, AUTOPILOT, command, 0, *values))

    def parameter(self, system: int, name: str, value: float) -> bytes:
        """Return the order to set a parameter of the autopilot of a system."""
        d = self.dialect
        kind = d.MAV_PARAM_TYPE_REAL32
        made = d.MAVLink_param_set_message
        return self.pack(made(system, AUTOPILOT, name.encode(), value, kind))

    def fix(
        self,
        stamp: float,
        place: tuple[float, float],
        velocity: tuple[float, float],
        sd: tuple[float, float],
        *,
        valid: bool = True,
    ) -> bytes:
        """Return an estimate as a GPS_INPUT: degrees, m/s north and east.

        ``sd`` are the standard deviations of place (m) and speed (m/s).
        """
        d = self.dialect
        unused = (
            d.GPS_INPUT_IGNORE_FLAG_ALT
            | d.GPS_INPUT_IGNORE_FLAG_VDOP
            | d.GPS_INPUT_IGNORE_FLAG_VEL_VERT
            | d.GPS_INPUT_IGNORE_FLAG_VERTICAL_ACCURACY
        )
        made = d.MAVLink_gps_input_message(
            time_usec=round(1e6 * stamp),
            gps_id=0,
            ignore_flags=unused,
            time_week_ms=0,
            time_week=0,
            fix_type=3 if valid else 1,
            lat=round(1e7 * place[0]),
            lon=round(1e7 * place[1]),
            alt=0.0,
            hdop=1.0,
            vdop=1.0,
            vn=velocity[0],
            ve=velocity[1],
            vd=0.0,
            speed_accuracy=sd[1],
            horiz_accuracy=sd[0],
            vert_accuracy=0.0,
            satellites_visible=12 if valid else 0,
        )
        return self.pack(made)

    def trajectory(self, stamp: float, states: Array) -> bytes:
        """Return up to five predicted states, shape (n, 6)."""
        c, s = np.cos(states[:, 2]), np.sin(states[:, 2])
        north = states[:, 3] * c - states[:, 4] * s
        east = states[:, 3] * s + states[:, 4] * c
        empty, still = [math.nan] * 5, np.zeros(len(states))
        columns = (states[:, 0], states[:, 1], still, north, east, still)
        x, y, z, vx, vy, vz = (_five(column) for column in columns)
        yaw, rate = _five(states[:, PSI]), _five(states[:, R])
        return self.pack(
            self.dialect.MAVLink_trajectory_representation_waypoints_message(
                round(1e6 * stamp),
                len(states),
                x,
                y,
                z,
                vx,
                vy,
                vz,
                empty,
                empty,
                empty,
                yaw,
                rate,
                [UNKNOWN_HEADING] * 5,
            )
        )

    def text(self, text: str, warning: bool) -> bytes:
        """Return a text for the operator, cut to 50 letters."""
        d = self.dialect
        severity = d.MAV_SEVERITY_WARNING if warning else d.MAV_SEVERITY_INFO
        return self.pack(d.MAVLink_statustext_message(severity, text.encode()[:50]))

    def floats(self, stamp: float, name: bytes, table: Array) -> bytes:
        """Return up to 58 numbers under a name."""
        data = [*table.ravel().tolist(), *[0.0] * (58 - table.size)]
        made = self.dialect.MAVLink_debug_float_array_message
        return self.pack(made(round(1e6 * stamp), name, 0, data))

    def pack(self, message: Any) -> bytes:
        """Return a message as the next one of this component."""
        packed = bytes(message.pack(self._link))
        self._link.seq = (self._link.seq + 1) % 256
        return packed


def _ms(stamp: float) -> int:
    """Return a time, s, in whole milliseconds of 32 bits."""
    return round(1000.0 * stamp) % int(WRAP)


def _five(values: Array) -> list[float]:
    """Return up to five values, NaN after them."""
    return [*values.tolist(), *[math.nan] * (5 - len(values))]


def _quaternion(roll: float, pitch: float, yaw: float) -> list[float]:
    """Return the quaternion w, x, y, z of angles, rad, turned by in the order yaw, pitch, roll."""
    (a, b, c), (d, e, f) = (
        tuple(turn(0.5 * angle) for angle in (roll, pitch, yaw)) for turn in (math.cos, math.sin)
    )
    w, x = a * b * c + d * e * f, d * b * c - a * e * f
    return [w, x, a * e * c + d * b * f, a * b * f - d * e * c]


def _triangle(sd: list[float]) -> list[float]:
    """Return the upper triangle of a diagonal covariance (6, 6), row by row."""
    return [sd[i] ** 2 if i == j else 0.0 for i in range(6) for j in range(i, 6)]
