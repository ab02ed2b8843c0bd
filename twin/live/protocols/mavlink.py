"""MAVLink 2 (and 1) over UDP: messages of an autopilot as rows, and messages to it.

Taken are GLOBAL_POSITION_INT (fix and velocity, with height and climb), ATTITUDE (heading, roll,
pitch and rates), the accelerometers of HIGHRES_IMU, SCALED_IMU or RAW_IMU, and SERVO_OUTPUT_RAW
(commands, by :class:`Servos`). The gyros of the IMU count where ATTITUDE has no rates, and of
HIGHRES_IMU what its flags name. WIND_COV and ArduPilot's WIND are the true wind. They are of one
component: the first that sends GLOBAL_POSITION_INT, or the autopilot (component 1) with ATTITUDE.
While GPS_RAW_INT says that there is no fix, the position is no measurement but the autopilot's own
dead reckoning, and counts as void. The largest value of a field of GLOBAL_POSITION_INT, and NaN in
ATTITUDE, mean that it is not known.

A feed only listens. ``twin.live.external`` is what sends the twin's estimate to an autopilot, as
its onboard computer (component 191).

Source: MAVLink common message set, https://mavlink.io/en/messages/common.html
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.channels import PSI, R, U, V, X, Y
from twin.logs.wire.feed import Feed, Message
from twin.logs.wire.sockets import Address, needed
from twin.particulars import GRAVITY, Particulars
from twin.predictors.base import Estimate
from twin.tilt import body_velocity, body_yaw_rate
from usv_kernel.servos import Servos

__all__ = [
    "JumpCounter",
    "MavlinkFeed",
    "MavlinkWriter",
    "Servos",
    "new_parser",
]

Array = NDArray[np.float64]

DIALECT = "pymavlink.dialects.v20.ardupilotmega"
"""The common message set, and WIND."""

WRAP = 2.0**32

UNKNOWN_SPEED = 2**15 - 1
UNKNOWN_PLACE = 2**31 - 1
UNKNOWN_HEADING = 2**16 - 1

CLOCK_TOLERANCE_S = 5.0
"""Largest difference to the time of the last message of a servo output of the same clock."""

RATES_TIMEOUT_S = 2.0
"""Age of the last rates of ATTITUDE from which on those of the IMU count."""

_IMU_PARTS = (
    *("accel_x_mps2", "accel_y_mps2", "accel_z_mps2"),
    *("gyro_x_radps", "gyro_y_radps", "gyro_radps"),
)
"""What an IMU measures, in the order of the flags of HIGHRES_IMU."""

ALL_PARTS = 2 ** len(_IMU_PARTS) - 1

AUTOPILOT = 1
ONBOARD = 191
"""Components: MAV_COMP_ID_AUTOPILOT1, and that of the twin, MAV_COMP_ID_ONBOARD_COMPUTER."""


JUMP_MIN_M = 0.5
"""Distance beyond what its velocity explains, from which on an estimate has jumped."""


class JumpCounter:
    """Counts the jumps of an estimate, as the field ``reset_counter`` of ODOMETRY does.

    An EKF refuses a place far from its own, unless the counter says that the estimate was reset.
    """

    def __init__(self) -> None:
        self.count = 0
        self._last: tuple[float, float, float, float, float] | None = None

    def take(self, t: float, state: Array) -> int:
        """Take a time (s) and state (6,), in order; return the count, from 0 to 255."""
        psi, u, v = state[PSI : V + 1].tolist()
        north, east = u * math.cos(psi) - v * math.sin(psi), u * math.sin(psi) + v * math.cos(psi)
        if self._last is not None:
            before, x, y, vx, vy = self._last
            dt = t - before
            ahead = x + 0.5 * dt * (vx + north), y + 0.5 * dt * (vy + east)
            if math.dist(ahead, (state[X], state[Y])) > JUMP_MIN_M:
                self.count = (self.count + 1) % 256
        self._last = t, float(state[X]), float(state[Y]), north, east
        return self.count


class MavlinkFeed(Feed):
    """Messages of an autopilot as rows; without ``servos``, the outputs are those of the boat.

    See :class:`~twin.logs.wire.feed.Feed` and :meth:`Servos.of`.
    """

    modulus = WRAP / 1000.0

    def __init__(
        self,
        address: str | None,
        particulars: Particulars,
        *,
        servos: Servos | None = None,
        **options: Any,
    ) -> None:
        self.servos = servos or Servos.of(particulars)
        self.system: int | None = None
        self._component = AUTOPILOT
        self._parser = new_parser()
        self._lost = False
        self._boot = math.nan
        self._heard = -math.inf
        self._rated: dict[str, float] = {}
        super().__init__(address, particulars, **options)

    def receive(self, data: bytes, arrival: float, source: Address | None = None) -> None:
        """See :meth:`Feed.receive`."""
        self._heard = arrival
        super().receive(data, arrival, source)

    def decode(self, data: bytes) -> Iterator[Message | str]:
        """Yield the messages of a datagram; see :meth:`Feed.decode`."""
        if self._parser.buf_len() and data[:1] in (b"\xfd", b"\xfe"):
            yield "broken"  # the last datagram ended in a message that this one does not continue
            self._parser = new_parser()
        for item in self._parser.parse_buffer(data) or ():
            yield self._message(item)

    def _message(self, item: Any) -> Message | str:
        """Return what a message says, or how it counts."""
        kind = item.get_type()
        if kind == "BAD_DATA":
            return "broken"
        system, component = item.get_srcSystem(), item.get_srcComponent()
        if component == ONBOARD and system == self.system:
            return "own"
        read = self._readers().get(kind)
        # a gimbal sends its attitude, too
        known = kind == "GLOBAL_POSITION_INT" or (kind == "ATTITUDE" and component == AUTOPILOT)
        if self.system is None and known:
            self.system = system
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
        timed = abs(stamp - self._boot) < CLOCK_TOLERANCE_S
        values = {}
        parts = item.xacc, item.yacc, item.zacc, item.xgyro, item.ygyro, item.zgyro
        for bit, (name, part) in enumerate(zip(_IMU_PARTS, parts, strict=True)):
            # the autopilot's own rates have lost the bias of its gyros
            rated = self._heard - self._rated.get(name, -math.inf) < RATES_TIMEOUT_S
            if flags & 1 << bit and math.isfinite(part) and not rated:
                values[name] = (force if bit < 3 else turn) * float(part)
        return Message("imu", stamp if timed else None, values, void=not values)

    def _servo_outputs(self, item: Any) -> Message:
        widths = [getattr(item, f"servo{i}_raw") for i in range(1, 17)]
        # 32 bits of microseconds wrap every 72 minutes, those of milliseconds later
        stamp = item.time_usec / 1e6
        stamp += round((self._boot - stamp) * 1e6 / WRAP) * WRAP / 1e6 if self._boot >= 0.0 else 0.0
        timed = abs(stamp - self._boot) < CLOCK_TOLERANCE_S
        values = self.servos.commands(widths) if item.port == 0 else {}
        return Message("servos", stamp if timed else None, values, void=not values)

    def _wind_cov(self, item: Any) -> Message:
        """Return the true wind, given as the velocity of the air."""
        stamp = item.time_usec / 1e6
        timed = abs(stamp - self._boot) < CLOCK_TOLERANCE_S
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


def new_parser() -> Any:
    """Return a parser of MAVLink messages that goes on after broken ones."""
    made = needed(DIALECT).MAVLink(None)
    made.robust_parsing = True
    return made


class MavlinkWriter:
    """Messages of a component, each as a datagram; ``link`` has its system and its count."""

    def __init__(self, system: int = 1, component: int = 1) -> None:
        self.dialect = needed(DIALECT)
        self.link = self.dialect.MAVLink(None, srcSystem=system, srcComponent=component)

    def heartbeat(self) -> bytes:
        """Return the sign of life of an onboard computer."""
        d = self.dialect
        kind, autopilot = d.MAV_TYPE_ONBOARD_CONTROLLER, d.MAV_AUTOPILOT_INVALID
        made = d.MAVLink_heartbeat_message
        return self.pack(made(kind, autopilot, 0, 0, d.MAV_STATE_ACTIVE, 3))

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
            q=_quaternion(psi, tilt),
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

    def pack(self, message: Any) -> bytes:
        """Return a message as the next one of this component."""
        packed = bytes(message.pack(self.link))
        self.link.seq = (self.link.seq + 1) % 256
        return packed


def _quaternion(heading: float, tilt: tuple[float, float]) -> list[float]:
    """Return the quaternion w, x, y, z of heading, roll and pitch, rad."""
    from scipy.spatial.transform import Rotation  # takes half a second

    roll, pitch = tilt
    x, y, z, w = Rotation.from_euler("ZYX", [heading, pitch, roll]).as_quat().tolist()
    return [w, x, y, z]


def _triangle(sd: list[float]) -> list[float]:
    """Return the upper triangle of a diagonal covariance (6, 6), row by row."""
    return [sd[i] ** 2 if i == j else 0.0 for i in range(6) for j in range(i, 6)]
