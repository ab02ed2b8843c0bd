"""GPS, IMU and compass: noisy, biased, late, and sometimes gone."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from usv_gym.physics import frames as fr
from usv_kernel import kernel

__all__ = ["CHANNELS", "FAULT_KINDS", "Fault", "FaultError", "SensorSuite", "parse_faults"]

CHANNELS = (
    "gps_x_m",
    "gps_y_m",
    "gps_vx_mps",
    "gps_vy_mps",
    "compass_rad",
    "gyro_radps",
    "accel_x_mps2",
    "accel_y_mps2",
)
"""Entries of a measurement row; NaN where there is no new sample."""
GPS, COMPASS, IMU = slice(0, 4), slice(4, 5), slice(5, 8)

# noise columns: white for each channel, then the drive of each bias
NOISE_GPS, NOISE_COMPASS, NOISE_IMU = 6, 2, 6
NOISE_SIZE = NOISE_GPS + NOISE_COMPASS + NOISE_IMU
BIAS_SIZE = 6
GPS_BIT, COMPASS_BIT, IMU_BIT = 1, 2, 4
FAULT_KINDS = {
    "gps": GPS_BIT,
    "imu": IMU_BIT,
    "compass": COMPASS_BIT,
    "all": GPS_BIT | COMPASS_BIT | IMU_BIT,
}
"""Which sensors each kind of loss takes away."""


class FaultError(ValueError):
    """A fault that cannot be; the message names it and the remedy."""


@dataclass(frozen=True, kw_only=True)
class SensorSuite:
    """Errors and rates of the sensors.

    Parameters
    ----------
    gps_white, gps_bias, gps_bias_time : float
        Position: white part (m), first-order Gauss-Markov part (m) and its time (s).
    doppler_white : float
        Velocity over ground, m/s.
    gps_latency : float
        Age of a fix when it arrives, s.
    compass_white, compass_bias, compass_bias_time : float
        Heading, rad and s.
    gyro_white, gyro_bias, gyro_bias_time : float
        Yaw rate, rad/s and s.
    accel_white, accel_bias, accel_bias_time : float
        Specific force, m/s2 and s.
    gps_every, compass_every, imu_every : int
        A new sample each so many control steps.
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
    accel_white: float = 0.01 * 9.80665
    accel_bias: float = 0.005 * 9.80665
    accel_bias_time: float = 110.0
    gps_every: int = 1
    compass_every: int = 1
    imu_every: int = 1

    def __post_init__(self) -> None:
        for item in dataclasses.fields(self):
            value = getattr(self, item.name)
            positive = item.name.endswith(("_time", "_every"))
            if not math.isfinite(value) or value < 0 or (positive and value <= 0):
                rule = "above 0" if positive else "0 or more"
                raise FaultError(f"sensor {item.name} = {value}: must be finite and {rule}")

    @classmethod
    def perfect(cls) -> SensorSuite:
        """Return sensors without any error or delay."""
        zero = {
            item.name: 0.0
            for item in dataclasses.fields(cls)
            if not item.name.endswith(("_time", "_every"))
        }
        return cls(**zero)  # type: ignore[arg-type]

    def pack(self, dt: float) -> np.ndarray:
        """Return the numbers that :func:`measure` reads, for control steps of dt s."""
        decay = [
            math.exp(-dt / t)
            for t in (
                self.gps_bias_time,
                self.compass_bias_time,
                self.gyro_bias_time,
                self.accel_bias_time,
            )
        ]
        return np.array(
            [
                *(self.gps_white, self.doppler_white, self.compass_white),
                *(self.gyro_white, self.accel_white),
                *(self.gps_bias, self.compass_bias, self.gyro_bias, self.accel_bias),
                *decay,
                *(self.gps_every, self.compass_every, self.imu_every),
            ],
            dtype=float,
        )

    def delay_steps(self, dt: float) -> int:
        """Return the latency of the GPS in control steps."""
        return round(self.gps_latency / dt)


@dataclass(frozen=True)
class Fault:
    """Sensors of one kind are gone for a while.

    Parameters
    ----------
    kind : str
        One of :data:`FAULT_KINDS`.
    start, duration : float
        When it begins and how long it lasts, s.
    """

    kind: str
    start: float
    duration: float

    def __post_init__(self) -> None:
        if self.kind not in FAULT_KINDS:
            raise FaultError(f"no sensor fault is called {self.kind!r}; use {_kinds()}")
        if not (math.isfinite(self.start) and math.isfinite(self.duration) and self.duration > 0):
            raise FaultError(
                f"{self.kind} fault: start and duration must be finite and the duration above 0, "
                f"got {self.start} and {self.duration}"
            )


def _kinds() -> str:
    return ", ".join(FAULT_KINDS)


def parse_faults(text: str, start: float) -> tuple[Fault, ...]:
    """Return the faults that a text such as ``gps10`` or ``none`` stands for.

    Parameters
    ----------
    text : str
        ``none``, or a kind and its seconds; several joined by ``+`` (``gps10+imu5``).
    start : float
        When they begin, s.

    Raises
    ------
    FaultError
        Names the text and what it may be.
    """
    if text == "none":
        return ()
    faults = []
    for part in text.split("+"):
        match = re.fullmatch(r"([a-z]+)(\d+(?:\.\d+)?)", part)
        if not match:
            raise FaultError(
                f"fault {text!r} is not understood; write none, or a kind and seconds such as "
                f"gps10 (kinds: {_kinds()})"
            )
        faults.append(Fault(match[1], start, float(match[2])))
    return tuple(faults)


def fault_windows(faults: Sequence[Fault]) -> np.ndarray:
    """Return an array (F, 3) of sensor bits, start and end for :func:`measure`."""
    return np.array(
        [(FAULT_KINDS[f.kind], f.start, f.start + f.duration) for f in faults], dtype=float
    ).reshape(-1, 3)


@kernel
def start_biases(suite: np.ndarray, noise: np.ndarray, bias: np.ndarray) -> None:
    """Write the biases at the start, drawn from where they settle.

    Parameters
    ----------
    suite : ndarray
        Packed :class:`SensorSuite`.
    noise : ndarray, shape (14,)
        Standard normal numbers.
    bias : ndarray, shape (6,)
        Written: GPS north, GPS east (m), compass (rad), gyro (rad/s), accelerometers (m/s2).
    """
    bias[0] = suite[5] * noise[4]
    bias[1] = suite[5] * noise[5]
    bias[2] = suite[6] * noise[7]
    bias[3] = suite[7] * noise[11]
    bias[4] = suite[8] * noise[12]
    bias[5] = suite[8] * noise[13]


@kernel
def _drift(value: float, sd: float, decay: float, normal: float) -> float:
    """Return a first-order Gauss-Markov bias one step later."""
    return decay * value + sd * math.sqrt(1.0 - decay * decay) * normal


@kernel
def measure(
    state: np.ndarray,
    mean_rate: np.ndarray,
    t: float,
    count: int,
    dt: float,
    suite: np.ndarray,
    noise: np.ndarray,
    faults: np.ndarray,
    bias: np.ndarray,
    ring: np.ndarray,
    z: np.ndarray,
) -> None:
    """Write what the sensors say now.

    Parameters
    ----------
    state, mean_rate : ndarray, shape (16,)
        State now, and its mean time derivative over the step that led here (an IMU hands
        out means over its interval).
    t : float
        Time, s.
    count : int
        Control steps since the start.
    dt : float
        Control step, s; 0 at the start.
    suite : ndarray
        Packed :class:`SensorSuite`.
    noise : ndarray, shape (14,)
        Standard normal numbers for this step.
    faults : ndarray, shape (F, 3)
        See :func:`fault_windows`.
    bias : ndarray, shape (6,)
        Advanced in place.
    ring : ndarray, shape (delay + 1, 4)
        Past positions and velocities for the latency, advanced in place.
    z : ndarray, shape (8,)
        Written; order of :data:`CHANNELS`, NaN where there is no new sample.
    """
    lost = 0
    for i in range(faults.shape[0]):
        if faults[i, 1] <= t < faults[i, 2]:
            lost |= int(faults[i, 0])
    if count > 0:
        bias[0] = _drift(bias[0], suite[5], suite[9], noise[4])
        bias[1] = _drift(bias[1], suite[5], suite[9], noise[5])
        bias[2] = _drift(bias[2], suite[6], suite[10], noise[7])
        bias[3] = _drift(bias[3], suite[7], suite[11], noise[11])
        bias[4] = _drift(bias[4], suite[8], suite[12], noise[12])
        bias[5] = _drift(bias[5], suite[8], suite[12], noise[13])
    delay = ring.shape[0] - 1
    now = count % ring.shape[0]
    ring[now, 0], ring[now, 1] = state[fr.X], state[fr.Y]
    ring[now, 2], ring[now, 3] = fr.to_earth(state[fr.U], state[fr.V], state[fr.PSI])
    for i in range(z.shape[0]):
        z[i] = math.nan
    # a late receiver has nothing to say until its first fix is old enough
    if not lost & GPS_BIT and count >= delay and (count - delay) % int(suite[13]) == 0:
        old = (count - delay) % ring.shape[0]
        z[0] = ring[old, 0] + bias[0] + suite[0] * noise[0]
        z[1] = ring[old, 1] + bias[1] + suite[0] * noise[1]
        z[2] = ring[old, 2] + suite[1] * noise[2]
        z[3] = ring[old, 3] + suite[1] * noise[3]
    if not lost & COMPASS_BIT and count % int(suite[14]) == 0:
        z[4] = state[fr.PSI] + bias[2] + suite[2] * noise[6]
    if not lost & IMU_BIT and count % int(suite[15]) == 0:
        u = state[fr.U] - 0.5 * dt * mean_rate[fr.U]
        v = state[fr.V] - 0.5 * dt * mean_rate[fr.V]
        r = state[fr.R] - 0.5 * dt * mean_rate[fr.R]
        z[5] = state[fr.R] + bias[3] + suite[3] * noise[8]
        z[6] = mean_rate[fr.U] - v * r + bias[4] + suite[4] * noise[9]
        z[7] = mean_rate[fr.V] + u * r + bias[5] + suite[4] * noise[10]
