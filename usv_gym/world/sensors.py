"""GPS, IMU and compass: noisy, biased, late, tilted with the boat, and sometimes gone."""

from __future__ import annotations

import dataclasses
import math
import re
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from usv_gym.physics import GRAVITY
from usv_gym.physics import frames as fr
from usv_kernel.errors import UsvTwinError
from usv_kernel.jit import kernel

__all__ = [
    "CHANNELS",
    "EFFECTS",
    "FAULTS_HELP",
    "FAULT_KINDS",
    "GRADES",
    "ON",
    "Bursts",
    "Disturbance",
    "Fault",
    "FaultError",
    "RandomFaults",
    "SensorSuite",
    "parse_faults",
    "spoiled",
]

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

# noise columns: white for each channel, then the drive of each bias; three more for each fault
NOISE_GPS, NOISE_COMPASS, NOISE_IMU = 6, 2, 6

NOISE_SIZE = NOISE_GPS + NOISE_COMPASS + NOISE_IMU

NOISE_FAULT = 3

# what the sensors of a boat remember: biases, then the last sample of each channel
BIAS_SIZE = 6

MEMORY_SIZE = BIAS_SIZE + len(CHANNELS)

GPS_BIT, COMPASS_BIT, IMU_BIT = 1, 2, 4

FAULT_KINDS = {
    "gps": GPS_BIT,
    "imu": IMU_BIT,
    "compass": COMPASS_BIT,
    "all": GPS_BIT | COMPASS_BIT | IMU_BIT,
}
"""Which sensors each kind of fault strikes."""

LOSS, FROZEN, SPIKES = 0, 1, 2

EFFECTS = {"loss": LOSS, "frozen": FROZEN, "spikes": SPIKES}
"""What a fault does: no sample; the last sample again, as if new; samples far off."""

# a row of suite numbers: errors, then decays of the biases, rates, lever arms
DECAY, SHARE, GPS_ARM, IMU_ARM = 9, 13, 16, 19

# a row of fault numbers
BITS, START, END, EFFECT, CHANCE, GAP, LENGTH, ENTER, LEAVE, BURSTING, SIZES = (
    *(0, 1, 2, 3, 4, 5, 7, 9, 10, 11, 12),
)

FAULT_SIZE = SIZES + len(CHANNELS)

LATENCY_MAX = 10.0
"""Largest age of a fix, s."""


def _finite(value: object) -> bool:
    """Return whether something is a finite number."""
    number = isinstance(value, (int, float, np.number)) and not isinstance(value, bool)
    return number and math.isfinite(value)  # type: ignore[arg-type]


class FaultError(UsvTwinError):
    """A sensor or a fault that cannot be; the message names it and the remedy."""


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

    def __post_init__(self) -> None:
        for item in dataclasses.fields(self):
            value = getattr(self, item.name)
            if item.name.endswith("_arm"):
                if np.ndim(value) != 1 or len(value) != 3 or not all(map(_finite, value)):
                    raise FaultError(
                        f"sensor {item.name} = {value}: must be three finite lengths in m "
                        "(forward, to starboard, down)"
                    )
                continue
            positive = item.name.endswith(("_time", "_rate"))
            if not _finite(value) or value < 0 or (positive and value <= 0):
                rule = "above 0" if positive else "0 or more"
                raise FaultError(f"sensor {item.name} = {value!r}: must be finite and {rule}")
        if self.gps_latency > LATENCY_MAX:
            raise FaultError(
                f"sensor gps_latency = {self.gps_latency:g} s: must be {LATENCY_MAX:g} s or less"
            )

    @classmethod
    def perfect(cls) -> SensorSuite:
        """Return sensors without any error or delay, one sample with each control step."""
        values = {
            item.name: 1e6 if item.name.endswith("_rate") else 0.0
            for item in dataclasses.fields(cls)
            if not item.name.endswith(("_time", "_arm"))
        }
        return cls(**values)  # type: ignore[arg-type]

    @classmethod
    def grade(cls, name: str) -> SensorSuite:
        """Return the sensors of one of :data:`GRADES`.

        Parameters
        ----------
        name : str
            ``typical``: the defaults, 1.1 m of position error (one standard deviation) and
            a magnetometer. ``best``: .73 m, and IMU and heading of an MTi-300 class unit.
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
        """Return a suite by the name of its grade (or the one handed in; None: the usual)."""
        if suite is None:
            return cls()
        return suite if isinstance(suite, SensorSuite) else cls.grade(suite)

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
        share = [min(dt * rate, 1.0) for rate in (self.gps_rate, self.compass_rate, self.imu_rate)]
        return np.array(
            [
                *(self.gps_white, self.doppler_white, self.compass_white),
                *(self.gyro_white, self.accel_white),
                *(self.gps_bias, self.compass_bias, self.gyro_bias, self.accel_bias),
                *(*decay, *share, *self.gps_arm, *self.imu_arm),
            ],
            dtype=float,
        )

    def delay_steps(self, dt: float) -> int:
        """Return the latency of the GPS in control steps."""
        return round(self.gps_latency / dt)


GRADES = {
    # GPS of physics.md section 8; IMU and heading of an MTi-300 class data sheet: .01
    # deg/s/sqrt(Hz) and 60 ug/sqrt(Hz), white at 20 Hz by sqrt(20); biases stable to 10 deg/h
    # and 15 ug; heading 1 deg RMS in all
    "best": SensorSuite(
        gps_white=0.2,
        gps_bias=0.7,
        compass_white=math.radians(0.3),
        compass_bias=math.radians(0.95),
        gyro_white=math.radians(0.01 * math.sqrt(20.0)),
        gyro_bias=math.radians(10.0 / 3600.0),
        accel_white=60e-6 * GRAVITY * math.sqrt(20.0),
        accel_bias=15e-6 * GRAVITY,
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
    ),
    "typical": SensorSuite(),
    "perfect": SensorSuite.perfect(),
}
"""Suites by name, for :meth:`SensorSuite.grade`."""

SPIKE_SIZES = (20.0, 20.0, 2.0, 2.0, 0.5, 0.3, 5.0, 5.0)
"""How far a spike is off, in the unit of each of :data:`CHANNELS`. By judgement: far beyond
the noise, not beyond belief."""


@dataclass(frozen=True)
class Disturbance(ABC):
    """What a fault does to which sensors; when it does so is the subclass's affair.

    Parameters
    ----------
    kind : str
        One of :data:`FAULT_KINDS`. ``all`` strikes the three at the same moments.
    effect : str
        One of :data:`EFFECTS`.
    chance : float
        Share of samples that a fault of ``spikes`` spoils.
    sizes : tuple of float
        How far a spike is off in each of :data:`CHANNELS`, each with a random sign.
    """

    kind: str
    effect: str = dataclasses.field(default="loss", kw_only=True)
    chance: float = dataclasses.field(default=0.1, kw_only=True)
    sizes: tuple[float, ...] = dataclasses.field(default=SPIKE_SIZES, kw_only=True)

    code: ClassVar[int]

    def __post_init__(self) -> None:
        if self.kind not in FAULT_KINDS:
            raise FaultError(
                f"no sensor fault is called {self.kind!r}; use {', '.join(FAULT_KINDS)}"
            )
        if self.effect not in EFFECTS:
            raise FaultError(
                f"{self.kind} fault: there is no effect {self.effect!r}; use {', '.join(EFFECTS)}"
            )
        if not (_finite(self.chance) and 0.0 <= self.chance <= 1.0):
            raise FaultError(
                f"{self.kind} fault: the chance of a spike must lie in [0, 1], got {self.chance}"
            )
        if np.shape(self.sizes) != (len(CHANNELS),) or not all(map(_finite, self.sizes)):
            raise FaultError(
                f"{self.kind} fault: sizes must be {len(CHANNELS)} finite numbers, one for each "
                f"of usv_gym.world.sensors.CHANNELS, got {self.sizes}"
            )

    @abstractmethod
    def _timing(self, dt: float) -> dict[int, float]:
        """Return the entries of the row that say when it strikes."""

    def row(self, dt: float) -> np.ndarray:
        """Return the numbers that :func:`measure` reads, for control steps of dt s."""
        row = np.zeros(FAULT_SIZE)
        row[BITS], row[EFFECT] = FAULT_KINDS[self.kind], EFFECTS[self.effect]
        row[CHANCE], row[SIZES:] = self.chance, self.sizes
        for entry, value in self._timing(dt).items():
            row[entry] = value
        return row


@dataclass(frozen=True)
class Fault(Disturbance):
    """A fault of the sensors of one kind, for a while.

    Parameters
    ----------
    kind, effect, chance, sizes
        What is struck and how: see :class:`Disturbance`.
    start, duration : float
        When it begins and how long it lasts, s.
    """

    start: float
    duration: float

    code = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (_finite(self.start) and _finite(self.duration) and self.duration > 0):
            raise FaultError(
                f"{self.kind} fault: start and duration must be finite and the duration above 0, "
                f"got {self.start} and {self.duration}"
            )

    def _timing(self, dt: float) -> dict[int, float]:
        return {START: self.start, END: self.start + self.duration}


@dataclass(frozen=True)
class RandomFaults(Disturbance):
    """Faults that come and go at random without end.

    Parameters
    ----------
    kind, effect, chance, sizes
        What is struck and how: see :class:`Disturbance`.
    gap, duration : tuple of float
        Shortest and longest time between two, and of each, s; uniform.
    start : float
        When the first gap begins, s.
    """

    gap: tuple[float, float] = (20.0, 60.0)
    duration: tuple[float, float] = (2.0, 10.0)
    start: float = 0.0

    code = 1

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, span in (("gap", self.gap), ("duration", self.duration)):
            sound = np.shape(span) == (2,) and all(map(_finite, span))
            if not (sound and 0.0 < span[0] <= span[1]):
                raise FaultError(
                    f"{self.kind} fault: {name} must be the shortest and the longest time in s, "
                    f"both above 0 and finite, got {span}"
                )
        _finite_start(self.kind, self.start)

    def _timing(self, dt: float) -> dict[int, float]:
        # a window that is over when it begins: the first one is drawn then
        return {
            **{START: self.start, END: self.start},
            **{GAP: self.gap[0], GAP + 1: self.gap[1]},
            **{LENGTH: self.duration[0], LENGTH + 1: self.duration[1]},
        }


@dataclass(frozen=True)
class Bursts(Disturbance):
    """Faults in bursts: a Gilbert-Elliott chain, drawn anew with each control step.

    Source: Gilbert 1960, Elliott 1963: p from good to bad and r back in each step give the
    share p / (p + r) and bursts of 1 / r steps.

    Parameters
    ----------
    kind, effect, chance, sizes
        What is struck and how: see :class:`Disturbance`.
    loss : float
        Mean share of steps that are struck, above 0 and below 1.
    mean : float
        Mean length of a burst, s.
    start : float
        When they begin, s.
    """

    loss: float = 0.1
    mean: float = 2.0
    start: float = 0.0

    code = 2

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (_finite(self.loss) and 0.0 < self.loss < 1.0):
            raise FaultError(
                f"{self.kind} bursts: the loss must be a share above 0 and below 1, got {self.loss}"
            )
        if not (_finite(self.mean) and self.mean > 0.0):
            raise FaultError(
                f"{self.kind} bursts: the mean length must be finite and above 0 s, got {self.mean}"
            )
        _finite_start(self.kind, self.start)

    def _timing(self, dt: float) -> dict[int, float]:
        leave = dt / self.mean
        enter = leave * self.loss / (1.0 - self.loss)
        if max(leave, enter) > 1.0 + 1e-9:
            raise FaultError(
                f"{self.kind} bursts of {self.mean:g} s with a loss of {self.loss:g} do not fit "
                f"steps of {dt:g} s; make them longer or the loss smaller"
            )
        return {START: self.start, ENTER: enter, LEAVE: leave}


def _finite_start(kind: str, start: float) -> None:
    if not _finite(start):
        raise FaultError(f"{kind} fault: the start must be finite, got {start!r}")


ON: tuple[Disturbance, ...] = (
    Bursts("gps"),
    RandomFaults("gps", effect="spikes"),
    RandomFaults("gps", effect="frozen", duration=(1.0, 5.0)),
    Bursts("compass", loss=0.05, mean=0.5),
    RandomFaults("compass", effect="spikes"),
    RandomFaults("compass", effect="frozen", duration=(1.0, 5.0)),
    Bursts("imu", loss=0.02, mean=0.2),
    RandomFaults("imu", effect="spikes"),
    RandomFaults("imu", effect="frozen", duration=(0.5, 2.0)),
    RandomFaults("all", gap=(60.0, 180.0), duration=(1.0, 5.0)),
)
"""What the text ``on`` stands for: everything that can go wrong does, again and again."""

_NUMBER = r"(\d+(?:\.\d+)?)"

_FAULT = re.compile(
    rf"([a-z]+)(?:-({'|'.join(EFFECTS)}))?"
    rf"(?:{_NUMBER}|(-random)|-bursts(?:{_NUMBER}x{_NUMBER})?)(?:@{_NUMBER})?",
    re.ASCII,
)

FAULTS_HELP = (
    "none, or a kind and seconds such as gps10, from a given second on gps10@30, with an effect "
    "gps-frozen5 or imu-spikes20, again and again gps-random, in bursts gps-bursts or "
    "gps-bursts10x2 (10 % of the time, 2 s each), several joined by +; or on for all of them "
    f"(kinds: {', '.join(FAULT_KINDS)}; effects: {', '.join(EFFECTS)})"
)
"""What a text of faults may be, for messages."""


def parse_faults(text: str, start: float) -> tuple[Disturbance, ...]:
    """Return the faults that a text such as ``gps10`` or ``none`` stands for.

    Parameters
    ----------
    text : str
        ``none``; ``on``, see :data:`ON`; or parts joined by ``+``. A part is a kind, then
        ``-`` and an effect (``loss`` if left out), then when: seconds, ``-random`` (see
        :class:`RandomFaults`) or ``-bursts`` (see :class:`Bursts`; per cent and mean
        seconds may follow as in ``gps-bursts10x2``), and last ``@`` and its start in s.
    start : float
        When windows without ``@`` begin, s; random ones and bursts begin at 0.

    Raises
    ------
    FaultError
        Names the text and what it may be.
    """
    if text == "none":
        return ()
    if text == "on":
        return ON
    faults = []
    for part in text.split("+"):
        match = _FAULT.fullmatch(part)
        if not match:
            raise FaultError(f"fault {text!r} is not understood; write {FAULTS_HELP}")
        try:
            faults.append(_fault(match, start))
        except FaultError as error:
            raise FaultError(f"fault {part!r}: {error}") from None
    return tuple(faults)


def _fault(match: re.Match[str], start: float) -> Disturbance:
    """Return the fault that the groups of a match stand for."""
    kind, effect, seconds, random, loss, mean, at = match.groups()
    effect = effect or "loss"
    if seconds:
        return Fault(kind, float(at) if at else start, float(seconds), effect=effect)
    begin = float(at or 0.0)
    if random:
        return RandomFaults(kind, effect=effect, start=begin)
    if loss:
        return Bursts(kind, float(loss) / 100.0, float(mean), begin, effect=effect)
    return Bursts(kind, start=begin, effect=effect)


def fault_rows(faults: Sequence[Disturbance], dt: float) -> np.ndarray:
    """Return an array (F, FAULT_SIZE) for :func:`measure` with control steps of dt s."""
    return np.array([fault.row(dt) for fault in faults]).reshape(-1, FAULT_SIZE)


def fault_sources(
    faults: Sequence[Disturbance], rng: np.random.Generator
) -> list[np.random.Generator]:
    """Return a generator for each fault; it stays the same whatever faults are beside it."""
    (child,) = rng.spawn(1)
    seed = int(child.integers(2**63))
    seen: dict[tuple[int, ...], int] = {}
    sources = []
    for fault in faults:
        key = (fault.code, FAULT_KINDS[fault.kind], EFFECTS[fault.effect])
        seen[key] = seen.get(key, -1) + 1
        sources.append(np.random.default_rng([seed, *key, seen[key]]))
    return sources


def spoiled(
    t: np.ndarray, z: np.ndarray, faults: Sequence[Disturbance], rng: np.random.Generator
) -> np.ndarray:
    """Return recorded measurements as they would be with faults of the sensors.

    Parameters
    ----------
    t : ndarray, shape (N,)
        Time, s; starts of faults count from the first.
    z : ndarray, shape (N, 8 or more)
        Rows that begin with :data:`CHANNELS`; what follows is kept.
    faults : sequence of Disturbance
        What goes wrong.
    rng : numpy.random.Generator
        Its randomness.

    Returns
    -------
    ndarray, shape of z
    """
    if not faults:
        return z.copy()
    step = float(np.median(np.diff(t))) if len(t) > 1 else 1.0
    rows, out, last = fault_rows(faults, step), z.copy(), np.full(len(CHANNELS), math.nan)
    draws = [source.random((len(t), NOISE_FAULT)) for source in fault_sources(faults, rng)]
    noise = np.hstack([np.zeros((len(t), NOISE_SIZE)), *draws])
    for k in range(len(t)):
        _spoil(float(t[k] - t[0]), noise[k], rows, last, out[k, : len(CHANNELS)])
    return out


@kernel
def start_memory(suite: np.ndarray, noise: np.ndarray, memory: np.ndarray) -> None:
    """Write what the sensors remember at the start: settled biases, and no sample.

    Parameters
    ----------
    suite : ndarray
        Packed :class:`SensorSuite`.
    noise : ndarray, shape (14 + 3 F,)
        As for :func:`measure`.
    memory : ndarray, shape (14,)
        Written: biases of GPS north, GPS east (m), compass (rad), gyro (rad/s) and
        accelerometers (m/s2), then the last sample of each of :data:`CHANNELS`.
    """
    memory[0] = suite[5] * noise[4]
    memory[1] = suite[5] * noise[5]
    memory[2] = suite[6] * noise[7]
    memory[3] = suite[7] * noise[11]
    memory[4] = suite[8] * noise[12]
    memory[5] = suite[8] * noise[13]
    memory[BIAS_SIZE:] = math.nan


@kernel
def _drift(value: float, sd: float, decay: float, normal: float) -> float:
    """Return a first-order Gauss-Markov bias one step later."""
    return decay * value + sd * math.sqrt(1.0 - decay * decay) * normal


@kernel
def _due(count: int, share: float) -> bool:
    """Return whether a sample falls on this control step, ``share`` of them having one."""
    # 1e-9: room for rounding where count * share is a whole number
    return share >= 1.0 or math.floor(count * share + 1e-9) > math.floor((count - 1) * share + 1e-9)


@kernel
def _spoil(
    t: float, noise: np.ndarray, faults: np.ndarray, last: np.ndarray, z: np.ndarray
) -> None:
    """Let the faults have their way with the samples z (8,) of time t.

    ``faults`` (F, FAULT_SIZE) and ``last`` (8,), the samples handed out last, are advanced.
    """
    lost, frozen = 0, 0
    for i in range(faults.shape[0]):
        row = faults[i]
        if not t >= row[START]:  # NaN: a row that is not used
            continue
        first = NOISE_SIZE + NOISE_FAULT * i
        draw, hit, signs = noise[first], noise[first + 1], noise[first + 2]
        if row[LEAVE] > 0.0:
            row[BURSTING] = draw >= row[LEAVE] if row[BURSTING] > 0.0 else draw < row[ENTER]
            if row[BURSTING] == 0.0:
                continue
        elif t >= row[END]:
            if row[GAP] > 0.0:
                row[START] = t + row[GAP] + (row[GAP + 1] - row[GAP]) * draw
                row[END] = row[START] + row[LENGTH] + (row[LENGTH + 1] - row[LENGTH]) * hit
            continue
        bits = int(row[BITS])
        if row[EFFECT] == LOSS:
            lost |= bits
        elif row[EFFECT] == FROZEN:
            frozen |= bits
        elif hit < row[CHANCE]:
            # the binary digits of one number are as many signs
            for j in range(z.shape[0]):
                signs *= 2.0
                up = signs >= 1.0
                signs -= 1.0 if up else 0.0
                if bits & (GPS_BIT if j < 4 else COMPASS_BIT if j == 4 else IMU_BIT):
                    z[j] += row[SIZES + j] if up else -row[SIZES + j]
    for j in range(z.shape[0]):
        bit = GPS_BIT if j < 4 else COMPASS_BIT if j == 4 else IMU_BIT
        if lost & bit:
            z[j] = math.nan
        elif math.isfinite(z[j]):
            if frozen & bit:
                z[j] = last[j]
            last[j] = z[j]


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
    memory: np.ndarray,
    ring: np.ndarray,
    z: np.ndarray,
) -> None:
    """Write what the sensors say now.

    The IMU feels the acceleration of the place where it sits less gravity, which leaks into
    its horizontal axes with roll and pitch: with a = nu' + omega x nu of the origin,
    ``f = a + omega' x r + omega x (omega x r) - R^T (0, 0, g)``.

    Source: Fossen 2021, Eq 14.16-14.20; physics.md 2.1 for the signs.

    Parameters
    ----------
    state, mean_rate : ndarray, shape (16,)
        State now, and its mean time derivative over the dt that led here (an IMU hands
        out means over its interval).
    t : float
        Time, s.
    count : int
        Control steps since the start.
    dt : float
        Time over which mean_rate is the mean, s; 0 at the start.
    suite : ndarray
        Packed :class:`SensorSuite`.
    noise : ndarray, shape (14 + 3 F,)
        Numbers for this step: standard normal, then three of [0, 1) for each fault.
    faults : ndarray, shape (F, FAULT_SIZE)
        See :func:`fault_rows`; advanced in place.
    memory : ndarray, shape (14,)
        See :func:`start_memory`; advanced in place.
    ring : ndarray, shape (delay + 1, 4)
        Past positions and velocities for the latency, advanced in place.
    z : ndarray, shape (8,)
        Written; order of :data:`CHANNELS`, NaN where there is no new sample.
    """
    if count > 0:
        memory[0] = _drift(memory[0], suite[5], suite[DECAY], noise[4])
        memory[1] = _drift(memory[1], suite[5], suite[DECAY], noise[5])
        memory[2] = _drift(memory[2], suite[6], suite[DECAY + 1], noise[7])
        memory[3] = _drift(memory[3], suite[7], suite[DECAY + 2], noise[11])
        memory[4] = _drift(memory[4], suite[8], suite[DECAY + 3], noise[12])
        memory[5] = _drift(memory[5], suite[8], suite[DECAY + 3], noise[13])
    phi, theta, psi = state[fr.PHI], state[fr.THETA], state[fr.PSI]
    p, q, r = state[fr.P], state[fr.Q], state[fr.R]
    ahead, side, low = suite[GPS_ARM], suite[GPS_ARM + 1], suite[GPS_ARM + 2]
    north, east, _ = fr.rotate(phi, theta, psi, ahead, side, low)
    v_north, v_east, _ = fr.rotate(
        phi,
        theta,
        psi,
        state[fr.U] + (q * low - r * side),
        state[fr.V] + (r * ahead - p * low),
        state[fr.W] + (p * side - q * ahead),
    )
    delay = ring.shape[0] - 1
    now = count % ring.shape[0]
    ring[now, 0], ring[now, 1] = state[fr.X] + north, state[fr.Y] + east
    ring[now, 2], ring[now, 3] = v_north, v_east
    for i in range(z.shape[0]):
        z[i] = math.nan
    # a late receiver has nothing to say until its first fix is old enough
    if count >= delay and _due(count - delay, suite[SHARE]):
        old = (count - delay) % ring.shape[0]
        z[0] = ring[old, 0] + memory[0] + suite[0] * noise[0]
        z[1] = ring[old, 1] + memory[1] + suite[0] * noise[1]
        z[2] = ring[old, 2] + suite[1] * noise[2]
        z[3] = ring[old, 3] + suite[1] * noise[3]
    if _due(count, suite[SHARE + 1]):
        z[4] = psi + memory[2] + suite[2] * noise[6]
    if _due(count, suite[SHARE + 2]):
        half = 0.5 * dt
        z[5] = r + memory[3] + suite[3] * noise[8]
        u = state[fr.U] - half * mean_rate[fr.U]
        v = state[fr.V] - half * mean_rate[fr.V]
        w = state[fr.W] - half * mean_rate[fr.W]
        p -= half * mean_rate[fr.P]
        q -= half * mean_rate[fr.Q]
        r -= half * mean_rate[fr.R]
        phi -= half * mean_rate[fr.PHI]
        theta -= half * mean_rate[fr.THETA]
        ahead, side, low = suite[IMU_ARM], suite[IMU_ARM + 1], suite[IMU_ARM + 2]
        # omega x r, the velocity of the place in the boat's turning
        u_arm, v_arm, w_arm = q * low - r * side, r * ahead - p * low, p * side - q * ahead
        x_arm = mean_rate[fr.Q] * low - mean_rate[fr.R] * side + q * w_arm - r * v_arm
        y_arm = mean_rate[fr.R] * ahead - mean_rate[fr.P] * low + r * u_arm - p * w_arm
        f_x = mean_rate[fr.U] - v * r + w * q + x_arm + GRAVITY * math.sin(theta)
        f_y = mean_rate[fr.V] + u * r - w * p + y_arm
        f_y -= GRAVITY * math.cos(theta) * math.sin(phi)
        z[6] = f_x + memory[4] + suite[4] * noise[9]
        z[7] = f_y + memory[5] + suite[4] * noise[10]
    if faults.shape[0] > 0:
        _spoil(t, noise, faults, memory[BIAS_SIZE:], z)
