"""Sensors of a boat: noisy, biased, late, tilted with the boat, and sometimes lost."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from usv_gym.physics import GRAVITY
from usv_gym.physics import frames as fr
from usv_gym.world.faults import CHANNELS, FaultError, strike
from usv_gym.world.sampling import drift, is_due
from usv_kernel.channels import (
    ACCEL_X,
    ACCEL_Y,
    COMPASS,
    GPS_VX,
    GPS_VY,
    GPS_X,
    GPS_Y,
    GYRO,
    MOTION_CHANNELS,
    SENSOR_CHANNELS,
)
from usv_kernel.errors import is_finite
from usv_kernel.jit import inlined, kernel
from usv_kernel.records import Record, as_record, record_size
from usv_kernel.scalar import rotation

__all__ = [
    "DELAYED",
    "GRADES",
    "MOTION_NOISE_SIZE",
    "NOISE",
    "NOISE_SIZE",
    "SENSORS",
    "SUITE",
    "WIND_AT",
    "SensorSuite",
    "measure",
    "start_motion_sensors",
    "start_sensors",
]

NOISE = np.dtype(
    [
        # white noise of each channel, then what drives its bias; all standard normal
        ("gps", float, 4),
        ("gps_bias", float, 2),
        ("compass", float),
        ("compass_bias", float),
        ("gyro", float),
        ("accel", float, 2),
        ("gyro_bias", float),
        ("accel_bias", float, 2),
    ]
)
"""Random numbers of one control step; those of the faults follow."""

NOISE_SIZE = record_size(NOISE)

WIND_AT = len(SENSOR_CHANNELS) + len(MOTION_CHANNELS)
"""Place of the first of WIND_CHANNELS in a row of measurements."""

MOTION_NOISE = np.dtype(
    [
        # the same for what six degrees of freedom add
        ("gyro", float, 2),
        ("gyro_bias", float, 2),
        ("accel", float),
        ("accel_bias", float),
        ("ahrs", float, 2),
        ("ahrs_bias", float, 2),
        ("height", float),
        ("height_bias", float),
        ("climb", float),
    ]
)
"""More random numbers of one control step, with six degrees of freedom."""

MOTION_NOISE_SIZE = record_size(MOTION_NOISE)

DELAYED = 6
"""Numbers of a fix that wait for its latency: north, east, their speeds, down, its speed."""

SENSORS = np.dtype(
    [
        ("gps_bias", float, 2),  # m, north and east
        ("compass_bias", float),  # rad
        ("gyro_bias", float),  # rad/s
        ("accel_bias", float, 2),  # m/s2, forward and starboard
        ("gyro_xy_bias", float, 2),  # rad/s, about the axes forward and to starboard
        ("accel_z_bias", float),  # m/s2
        ("ahrs_bias", float, 2),  # rad, roll and pitch
        ("height_bias", float),  # m
        ("wind_bias", float),  # m/s
        ("wind_from_bias", float),  # rad
        ("wind", float, 2),  # apparent wind of this step before any fault, m/s and rad
        ("last", float, CHANNELS),  # last sample of each channel, NaN before the first
    ]
)
"""What the sensors of one boat remember."""

SUITE = np.dtype(
    [
        # standard deviations of the white noise
        ("gps_white", float),  # m
        ("doppler_white", float),  # m/s
        ("compass_white", float),  # rad
        ("gyro_white", float),  # rad/s
        ("accel_white", float),  # m/s2
        ("ahrs_white", float),  # rad
        ("height_white", float),  # m
        ("climb_white", float),  # m/s
        ("wind_white", float),  # m/s
        ("wind_from_white", float),  # rad
        # standard deviations of the biases, in the same units, and their decay in a step
        ("gps_bias", float),
        ("compass_bias", float),
        ("gyro_bias", float),
        ("accel_bias", float),
        ("ahrs_bias", float),
        ("height_bias", float),
        ("wind_bias", float),
        ("wind_from_bias", float),
        ("gps_decay", float),
        ("compass_decay", float),
        ("gyro_decay", float),
        ("accel_decay", float),
        ("ahrs_decay", float),
        ("height_decay", float),
        ("wind_decay", float),
        # share of control steps with a new sample
        ("gps_share", float),
        ("compass_share", float),
        ("imu_share", float),
        ("ahrs_share", float),
        ("wind_share", float),
        ("wind_height", float),  # m above the origin
        ("gps_arm", float, 3),  # m forward, to starboard, down from the origin
        ("imu_arm", float, 3),
        ("imu_mounting", float, (3, 3)),  # turns a vector of the boat into the axes of the IMU
    ]
)
"""A :class:`SensorSuite` as kernels read it, for one length of control step."""

ERROR_RANGE = 0.0, 1e6
"""Range of the sizes of errors, SI units."""

TIME_RANGE = 1e-6, 1e9
"""Range of times (s) and rates (Hz)."""

ARM_MAX = 1000.0
"""Largest distance of a sensor from the origin, m."""

LATENCY_MAX = 10.0
"""Largest age of a fix or of a sample of the wind, s."""

HEIGHT_RANGE = 0.1, ARM_MAX
"""Range of the height of an anemometer, m."""

OPTIONAL = ("ahrs_rate", "wind_rate")
"""Rates that may be 0: there is no such sensor."""


_TRIPLES = {
    "gps_arm": ("lengths in m (forward, to starboard, down)", ARM_MAX),
    "imu_arm": ("lengths in m (forward, to starboard, down)", ARM_MAX),
    "imu_mounting": ("angles in rad (roll, pitch, yaw)", math.pi),
}
"""What the fields of three numbers are, and how large they may be."""


def _check_triple(name: str, value: Any) -> None:
    """Refuse what is not three numbers within their range."""
    what, most = _TRIPLES[name]
    sound = isinstance(value, (tuple, list, np.ndarray)) and np.shape(value) == (3,)
    if not sound or not all(is_finite(number) and abs(number) <= most for number in value):
        raise FaultError(f"sensor {name} = {value}: must be three {what}, at most {most:.4g}")


@dataclass(frozen=True, kw_only=True)
class SensorSuite:
    """Errors, rates and places of the sensors.

    Parameters
    ----------
    gps_white, gps_bias, gps_bias_time : float
        Position: white part (m), first-order Gauss-Markov part (m) and its time (s).
    doppler_white : float
        Velocity over ground, m/s.
    gps_latency : float
        Age of a fix when it arrives, s.
    compass_white, compass_bias, compass_bias_time : float
        Heading (tilt-compensated), rad and s.
    gyro_white, gyro_bias, gyro_bias_time : float
        Turning rate about the boat's vertical axis, rad/s and s.
    accel_white, accel_bias, accel_bias_time : float
        Specific force along the boat's axes, m/s2 and s.
    gps_rate, compass_rate, imu_rate : float
        Samples per second, Hz; at most one comes with each control step.
    gps_arm, imu_arm : tuple of float
        Where antenna and IMU sit: m forward, to starboard and down from the origin.
    imu_mounting : tuple of float
        Roll, pitch and yaw of the axes of the IMU against those of the boat, rad.
    ahrs_white, ahrs_bias, ahrs_bias_time, ahrs_rate : float
        Roll and pitch of an AHRS, rad, s and Hz, with six degrees of freedom. Its error lasts for
        seconds. Rate 0: there is none.
    height_white, height_bias, height_bias_time, climb_white : float
        Height (m, s) and vertical speed (m/s) of each fix, with six degrees of freedom.
    wind_white, wind_bias, wind_from_white, wind_from_bias, wind_bias_time : float
        Speed (m/s) and direction (rad) of the apparent wind, and the time (s) of both biases.
    wind_rate, wind_latency, wind_height : float
        Samples per second (Hz) and their age (s) of an anemometer on a mast, and its height above
        the origin, m. Rate 0, the default: there is none, as on most boats of this size.
    """

    gps_white: float = 0.4
    gps_bias: float = 1.0
    gps_bias_time: float = 400.0
    doppler_white: float = 0.05
    gps_latency: float = 0.1
    compass_white: float = math.radians(0.4)
    compass_bias: float = math.radians(1.0)
    compass_bias_time: float = 300.0
    gyro_white: float = math.radians(0.05)
    gyro_bias: float = math.radians(0.01)
    gyro_bias_time: float = 270.0
    accel_white: float = 0.01 * GRAVITY
    accel_bias: float = 0.005 * GRAVITY
    accel_bias_time: float = 110.0
    gps_rate: float = 20.0
    compass_rate: float = 20.0
    imu_rate: float = 20.0
    gps_arm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    imu_arm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    imu_mounting: tuple[float, float, float] = (0.0, 0.0, 0.0)
    ahrs_white: float = math.radians(0.03)
    ahrs_bias: float = math.radians(0.2)
    ahrs_bias_time: float = 10.0
    ahrs_rate: float = 20.0
    height_white: float = 0.6
    height_bias: float = 1.5
    height_bias_time: float = 400.0
    climb_white: float = 0.08
    wind_white: float = 0.2
    wind_bias: float = 0.3
    wind_from_white: float = math.radians(2.0)
    wind_from_bias: float = math.radians(3.0)
    wind_bias_time: float = 300.0
    wind_rate: float = 0.0
    wind_latency: float = 0.25
    wind_height: float = 3.0

    def __post_init__(self) -> None:
        for item in dataclasses.fields(self):
            value = getattr(self, item.name)
            if item.name in _TRIPLES:
                _check_triple(item.name, value)
                continue
            low, high = TIME_RANGE if item.name.endswith(("_time", "_rate")) else ERROR_RANGE
            low = 0.0 if item.name in OPTIONAL else low
            if item.name == "wind_height":
                low, high = HEIGHT_RANGE
            if not is_finite(value) or not low <= value <= high:
                raise FaultError(
                    f"sensor {item.name} = {value!r}: must be a number from {low:g} to {high:g}"
                )
        for name in ("gps_latency", "wind_latency"):
            if getattr(self, name) > LATENCY_MAX:
                raise FaultError(
                    f"sensor {name} = {getattr(self, name):g} s: must be {LATENCY_MAX:g} s or less"
                )

    @classmethod
    def perfect(cls) -> SensorSuite:
        """Return sensors without any error or delay, one sample with each control step.

        There is no anemometer among them.
        """
        kept = (*_TRIPLES, "wind_rate", "wind_height")
        values = {
            item.name: 1e6 if item.name.endswith("_rate") else 0.0
            for item in dataclasses.fields(cls)
            if not item.name.endswith("_time") and item.name not in kept
        }
        return cls(**values)  # type: ignore[arg-type]

    @classmethod
    def grade(cls, name: str) -> SensorSuite:
        """Return the sensors of one of :data:`GRADES`.

        Parameters
        ----------
        name : str
            ``typical``: the defaults, 1.1 m of position error (one standard deviation) and
            a magnetometer. ``best``: .73 m, IMU and heading of an MTi-300 class unit, and an
            ultrasonic anemometer.
            ``consumer``: 2.7 m and sensors of a phone.
            ``perfect``: see :meth:`perfect`.

        Raises
        ------
        FaultError
            Names what there is.
        """
        if not isinstance(name, str) or name not in GRADES:
            raise FaultError(
                f"no grade of sensors is called {name!r}; use {', '.join(GRADES)} or a SensorSuite"
            )
        return GRADES[name]

    @classmethod
    def of(cls, suite: str | SensorSuite | None) -> SensorSuite:
        """Return a suite by the name of its grade (or the one handed in; None: the typical one)."""
        if suite is None:
            return cls()
        return suite if isinstance(suite, SensorSuite) else cls.grade(suite)

    def pack(self, dt: float) -> Record:
        """Return the record that :func:`measure` reads, for control steps of dt s."""
        record = np.zeros(1, SUITE)[0]
        for name in SUITE.names or ():
            source, kind = name.rpartition("_")[::2]
            if kind == "mounting":
                record[name] = rotation(self.imu_mounting).T
            elif kind == "decay":
                record[name] = math.exp(-dt / getattr(self, f"{source}_bias_time"))
            elif kind == "share":
                record[name] = min(dt * getattr(self, f"{source}_rate"), 1.0)
            else:
                record[name] = getattr(self, name)
        return record

    def delay_steps(self, dt: float) -> int:
        """Return the latency of the GPS in control steps."""
        return round(self.gps_latency / dt)

    @property
    def has_anemometer(self) -> bool:
        """Whether the apparent wind is measured."""
        return self.wind_rate > 0.0

    def wind_rows(self, dt: float) -> int:
        """Return the rows of the delay line of an anemometer; 0 where there is none."""
        return round(self.wind_latency / dt) + 1 if self.has_anemometer else 0


GRADES = {
    # GPS of ship_and_sea.md; IMU and heading of an MTi-300 class data sheet. .01 deg/s/sqrt(Hz) and
    # 60 ug/sqrt(Hz), white at 20 Hz by sqrt(20). Biases stable to 10 deg/h and 15 ug; heading 1 deg
    # RMS in all; roll and pitch by judgement
    "best": SensorSuite(
        gps_white=0.2,
        gps_bias=0.7,
        compass_white=math.radians(0.3),
        compass_bias=math.radians(0.95),
        gyro_white=math.radians(0.01 * math.sqrt(20.0)),
        gyro_bias=math.radians(10.0 / 3600.0),
        accel_white=60e-6 * GRAVITY * math.sqrt(20.0),
        accel_bias=15e-6 * GRAVITY,
        ahrs_bias=math.radians(0.15),
        height_white=0.3,
        height_bias=1.0,
        climb_white=0.05,
        # data sheet of a two-axis ultrasonic anemometer: 2 % at 12 m/s, 2 deg, 4 Hz
        wind_white=0.1,
        wind_bias=0.2,
        wind_from_white=math.radians(1.0),
        wind_from_bias=math.radians(2.0),
        wind_rate=4.0,
    ),
    # a phone under open sky is within 4.9 m (van Diggelen and Enge 2015); the rest by judgement,
    # two to three times the typical
    "consumer": SensorSuite(
        gps_white=1.0,
        gps_bias=2.5,
        doppler_white=0.1,
        compass_white=math.radians(1.0),
        compass_bias=math.radians(3.0),
        gyro_white=math.radians(0.1),
        gyro_bias=math.radians(0.03),
        accel_white=0.02 * GRAVITY,
        accel_bias=0.015 * GRAVITY,
        ahrs_bias=math.radians(0.8),
        height_white=1.5,
        height_bias=4.0,
        climb_white=0.15,
    ),
    "typical": SensorSuite(),
    "perfect": SensorSuite.perfect(),
}
"""Suites by name, for :meth:`SensorSuite.grade`."""


@kernel
def start_sensors(suite: Record, numbers: np.ndarray, sensors: Record) -> None:
    """Write what the sensors remember at the start: settled biases, and no sample.

    Parameters
    ----------
    suite : record of :data:`SUITE`
        Errors of the sensors.
    numbers : ndarray, shape (14 + 3 F,)
        Random numbers of a step; the first are those of :data:`NOISE`.
    sensors : record of :data:`SENSORS`
        Written.
    """
    noise = as_record(numbers, NOISE)
    sensors.gps_bias[0] = suite.gps_bias * noise.gps_bias[0]
    sensors.gps_bias[1] = suite.gps_bias * noise.gps_bias[1]
    sensors.compass_bias = suite.compass_bias * noise.compass_bias
    sensors.gyro_bias = suite.gyro_bias * noise.gyro_bias
    sensors.accel_bias[0] = suite.accel_bias * noise.accel_bias[0]
    sensors.accel_bias[1] = suite.accel_bias * noise.accel_bias[1]
    sensors.wind[:] = math.nan
    sensors.last[:] = math.nan


@kernel
def start_motion_sensors(suite: Record, numbers: np.ndarray, sensors: Record) -> None:
    """Write settled biases of the sensors of roll, pitch and heave.

    ``numbers`` (13,) are those of :data:`MOTION_NOISE`; see :func:`start_sensors`.
    """
    noise = as_record(numbers, MOTION_NOISE)
    for i in range(2):
        sensors.gyro_xy_bias[i] = suite.gyro_bias * noise.gyro_bias[i]
        sensors.ahrs_bias[i] = suite.ahrs_bias * noise.ahrs_bias[i]
    sensors.accel_z_bias = suite.accel_bias * noise.accel_bias
    sensors.height_bias = suite.height_bias * noise.height_bias


@inlined
def _mounted(mounting: np.ndarray, a: float, b: float, c: float, i: int) -> float:
    """Return the part of a vector of the boat along axis i of the IMU."""
    return mounting[i, 0] * a + mounting[i, 1] * b + mounting[i, 2] * c


@kernel
def measure(
    boat: Record,
    dt: float,
    suite: Record,
    numbers: np.ndarray,
    motion_numbers: np.ndarray,
    faults: np.ndarray,
    delay_line: np.ndarray,
) -> None:
    """Write what the sensors of a boat say now.

    The IMU measures specific force where it sits, along its own axes. Gravity leaks into the
    horizontal ones with roll and pitch: with a = nu' + omega x nu of the origin,
    ``f = a + omega' x r + omega x (omega x r) - R^T (0, 0, g)``.

    Source: Fossen 2021, Eq 14.16-14.20; docs/explanation/ship_and_sea.md, Sensors.

    Parameters
    ----------
    boat : record of :data:`usv_gym.world.state.BOAT`
        State, mean rate over the step and time are read; ``sensors`` is advanced; ``measurement``
        is written, NaN where there is no new sample.
    dt : float
        Time over which the mean rate is the mean, s; 0 at the start.
    suite : record of :data:`SUITE`
        Errors and rates.
    numbers : ndarray, shape (14 + 3 F,)
        Random numbers of this step: :data:`NOISE`, then three of [0, 1) for each fault.
    motion_numbers : ndarray, shape (13,) or (0,)
        :data:`MOTION_NOISE`; none with three degrees of freedom, whose boats have no such sensors.
    faults : ndarray of :data:`FAULT`, shape (F,)
        See :func:`fault_records`; advanced in place.
    delay_line : ndarray, shape (delay + 1, 6)
        Past positions and velocities for the latency, advanced in place.
    """
    state, mean_rate, sensors, z = boat.state, boat.mean_rate, boat.sensors, boat.measurement
    noise, count = as_record(numbers, NOISE), int(boat.step)
    if count > 0:
        gps, accel = sensors.gps_bias, sensors.accel_bias
        for i in range(2):
            gps[i] = drift(gps[i], suite.gps_bias, suite.gps_decay, noise.gps_bias[i])
            accel[i] = drift(accel[i], suite.accel_bias, suite.accel_decay, noise.accel_bias[i])
        sensors.compass_bias = drift(
            sensors.compass_bias, suite.compass_bias, suite.compass_decay, noise.compass_bias
        )
        sensors.gyro_bias = drift(
            sensors.gyro_bias, suite.gyro_bias, suite.gyro_decay, noise.gyro_bias
        )
    phi, theta, psi = state[fr.PHI], state[fr.THETA], state[fr.PSI]
    p, q, r = state[fr.P], state[fr.Q], state[fr.R]
    ahead, side, low = suite.gps_arm[0], suite.gps_arm[1], suite.gps_arm[2]
    north, east, down = fr.rotate(phi, theta, psi, ahead, side, low)
    v_north, v_east, v_down = fr.rotate(
        phi,
        theta,
        psi,
        state[fr.U] + (q * low - r * side),
        state[fr.V] + (r * ahead - p * low),
        state[fr.W] + (p * side - q * ahead),
    )
    delay = delay_line.shape[0] - 1
    newest = delay_line[count % delay_line.shape[0]]
    newest[GPS_X], newest[GPS_Y] = state[fr.X] + north, state[fr.Y] + east
    newest[GPS_VX], newest[GPS_VY] = v_north, v_east
    newest[DELAYED - 2], newest[DELAYED - 1] = state[fr.Z] + down, v_down
    for i in range(z.shape[0]):
        z[i] = math.nan
    # a receiver with latency gives nothing until its first fix is old enough
    has_fix = count >= delay and is_due(count - delay, suite.gps_share)
    old = delay_line[(count - delay) % delay_line.shape[0]]
    if has_fix:
        z[GPS_X] = old[GPS_X] + sensors.gps_bias[0] + suite.gps_white * noise.gps[0]
        z[GPS_Y] = old[GPS_Y] + sensors.gps_bias[1] + suite.gps_white * noise.gps[1]
        z[GPS_VX] = old[GPS_VX] + suite.doppler_white * noise.gps[2]
        z[GPS_VY] = old[GPS_VY] + suite.doppler_white * noise.gps[3]
    if is_due(count, suite.compass_share):
        z[COMPASS] = psi + sensors.compass_bias + suite.compass_white * noise.compass
    has_imu, mounting = is_due(count, suite.imu_share), suite.imu_mounting
    rate = p, q, r
    force = 0.0, 0.0, 0.0
    if has_imu:
        half = 0.5 * dt
        z[GYRO] = _mounted(mounting, p, q, r, 2) + sensors.gyro_bias
        z[GYRO] += suite.gyro_white * noise.gyro
        u = state[fr.U] - half * mean_rate[fr.U]
        v = state[fr.V] - half * mean_rate[fr.V]
        w = state[fr.W] - half * mean_rate[fr.W]
        p -= half * mean_rate[fr.P]
        q -= half * mean_rate[fr.Q]
        r -= half * mean_rate[fr.R]
        phi -= half * mean_rate[fr.PHI]
        theta -= half * mean_rate[fr.THETA]
        ahead, side, low = suite.imu_arm[0], suite.imu_arm[1], suite.imu_arm[2]
        # omega x r, the velocity of the IMU relative to the origin
        u_arm, v_arm, w_arm = q * low - r * side, r * ahead - p * low, p * side - q * ahead
        x_arm = mean_rate[fr.Q] * low - mean_rate[fr.R] * side + q * w_arm - r * v_arm
        y_arm = mean_rate[fr.R] * ahead - mean_rate[fr.P] * low + r * u_arm - p * w_arm
        z_arm = mean_rate[fr.P] * side - mean_rate[fr.Q] * ahead + p * v_arm - q * u_arm
        f_x = mean_rate[fr.U] - v * r + w * q + x_arm + GRAVITY * math.sin(theta)
        f_y = mean_rate[fr.V] + u * r - w * p + y_arm
        f_y -= GRAVITY * math.cos(theta) * math.sin(phi)
        f_z = mean_rate[fr.W] + v * p - u * q + z_arm
        f_z -= GRAVITY * math.cos(theta) * math.cos(phi)
        force = f_x, f_y, f_z
        z[ACCEL_X] = _mounted(mounting, f_x, f_y, f_z, 0) + sensors.accel_bias[0]
        z[ACCEL_Y] = _mounted(mounting, f_x, f_y, f_z, 1) + sensors.accel_bias[1]
        z[ACCEL_X] += suite.accel_white * noise.accel[0]
        z[ACCEL_Y] += suite.accel_white * noise.accel[1]
    if motion_numbers.shape[0] > 0:
        _measure_motion(boat, suite, motion_numbers, (rate, force), (has_imu, has_fix), old)
    if suite.wind_share > 0.0:
        for i in range(2):
            z[WIND_AT + i] = sensors.wind[i]
    if faults.shape[0] > 0:
        strike(boat.t, numbers[NOISE_SIZE:], faults, sensors.last, boat.measurement)


@inlined
def _measure_motion(boat, suite, numbers, imu, due, fix):
    """Write what an IMU of three axes, an AHRS and GNSS say of roll, pitch and heave.

    ``imu`` are body rates and specific force, ``due`` whether IMU and GNSS have a sample, and
    ``fix`` (6,) what the GNSS measured, all without errors.
    """
    sensors, z = boat.sensors, boat.measurement[len(SENSOR_CHANNELS) :]
    noise, count, mounting = as_record(numbers, MOTION_NOISE), int(boat.step), suite.imu_mounting
    (p, q, r), (f_x, f_y, f_z) = imu
    has_imu, has_fix = due
    gyro, ahrs = sensors.gyro_xy_bias, sensors.ahrs_bias
    if count > 0:
        for i in range(2):
            gyro[i] = drift(gyro[i], suite.gyro_bias, suite.gyro_decay, noise.gyro_bias[i])
            ahrs[i] = drift(ahrs[i], suite.ahrs_bias, suite.ahrs_decay, noise.ahrs_bias[i])
        sensors.accel_z_bias = drift(
            sensors.accel_z_bias, suite.accel_bias, suite.accel_decay, noise.accel_bias
        )
        sensors.height_bias = drift(
            sensors.height_bias, suite.height_bias, suite.height_decay, noise.height_bias
        )
    if has_imu:
        for i in range(2):
            z[i] = _mounted(mounting, p, q, r, i) + gyro[i] + suite.gyro_white * noise.gyro[i]
        z[2] = _mounted(mounting, f_x, f_y, f_z, 2) + sensors.accel_z_bias
        z[2] += suite.accel_white * noise.accel
    if suite.ahrs_share > 0.0 and is_due(count, suite.ahrs_share):
        z[3] = boat.state[fr.PHI] + ahrs[0] + suite.ahrs_white * noise.ahrs[0]
        z[4] = boat.state[fr.THETA] + ahrs[1] + suite.ahrs_white * noise.ahrs[1]
    if has_fix:
        z[5] = fix[DELAYED - 2] + sensors.height_bias + suite.height_white * noise.height
        z[6] = fix[DELAYED - 1] + suite.climb_white * noise.climb
