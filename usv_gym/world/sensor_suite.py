"""Errors, rates, delays and places of the sensors of a boat, and their grades."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from usv_gym.physics import GRAVITY
from usv_gym.world.faults import FaultError
from usv_kernel.errors import check_options, is_finite
from usv_kernel.records import Record
from usv_kernel.scalar import rotation

__all__ = ["GRADES", "SUITE", "SensorSuite"]

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
        ("climb_bias", float),
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
        # age of a sample when it arrives, control steps
        ("gps_delay", float),
        ("compass_delay", float),
        ("imu_delay", float),
        ("ahrs_delay", float),
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
"""Largest age of a sample when it arrives, s."""

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
    gps_latency, compass_latency, imu_latency, ahrs_latency : float
        Age of a sample when it arrives, s. The IMU is that of all its axes.
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
    height_white, height_bias, height_bias_time, climb_white, climb_bias : float
        Height (m, s) and vertical speed (m/s) of each fix, with six degrees of freedom. The bias of
        the speed drifts with that of the height.
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
    compass_latency: float = 0.0
    imu_latency: float = 0.0
    ahrs_latency: float = 0.0
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
    climb_bias: float = 0.0
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
            if item.name.endswith("_latency") and value > LATENCY_MAX:
                raise FaultError(
                    f"sensor {item.name} = {value:g} s: must be {LATENCY_MAX:g} s or less"
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
    def of(cls, suite: str | SensorSuite | Mapping[str, Any] | None) -> SensorSuite:
        """Return a suite by the name of its grade or by its fields; None: the typical one."""
        if suite is None:
            return cls()
        if isinstance(suite, Mapping):  # as in the JSON of an environment
            check_options("suite", suite, [item.name for item in dataclasses.fields(cls)])
            table: Any = {k: tuple(v) if isinstance(v, list) else v for k, v in suite.items()}
            return cls(**table)
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
            elif kind == "delay":
                record[name] = self.delay_steps(dt, source)
            elif kind == "share":
                record[name] = min(dt * getattr(self, f"{source}_rate"), 1.0)
            else:
                record[name] = getattr(self, name)
        return record

    def delay_steps(self, dt: float, sensor: str = "gps") -> int:
        """Return the latency of a sensor in control steps of dt s."""
        return round(getattr(self, f"{sensor}_latency") / dt)

    def delay_rows(self, dt: float) -> int:
        """Return the rows of the delay line that GPS, compass, IMU and AHRS share."""
        return 1 + max(self.delay_steps(dt, sensor) for sensor in ("gps", "compass", "imu", "ahrs"))

    @property
    def has_anemometer(self) -> bool:
        """Whether the apparent wind is measured."""
        return self.wind_rate > 0.0

    def wind_rows(self, dt: float) -> int:
        """Return the rows of the delay line of an anemometer; 0 where there is none."""
        return 1 + self.delay_steps(dt, "wind") if self.has_anemometer else 0


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
