"""Faults of sensors: lost, frozen, spiked or scaled samples, once, at random or in bursts."""

from __future__ import annotations

import dataclasses
import math
import re
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from usv_gym.world.channels import (
    AHRS_BIT,
    AXIS_BITS,
    BITS,
    COMPASS_BIT,
    GPS_BIT,
    IMU_BIT,
    WIND_BIT,
)
from usv_kernel.arrays import alloca_f64
from usv_kernel.channels import MOTION_CHANNELS, SENSOR_CHANNELS, WIND_CHANNELS
from usv_kernel.errors import UsvTwinError, did_you_mean, is_finite
from usv_kernel.jit import kernel
from usv_kernel.random import STREAM, fill_uniform, next_word, start_stream
from usv_kernel.records import Record
from usv_kernel.streams import hash_numbers

__all__ = [
    "EFFECTS",
    "FAULT",
    "FAULTS_HELP",
    "FAULT_KINDS",
    "ON",
    "Bursts",
    "Disturbance",
    "Fault",
    "FaultError",
    "FaultWarning",
    "RandomFaults",
    "apply_faults",
    "fault_keys",
    "fault_records",
    "ineffective_fault",
    "parse_faults",
    "seed_faults",
    "start_streams",
    "strike",
]

FAULT_KINDS = {
    "gps": GPS_BIT,
    "imu": IMU_BIT,
    "compass": COMPASS_BIT,
    "ahrs": AHRS_BIT,
    "all": GPS_BIT | COMPASS_BIT | IMU_BIT | AHRS_BIT | WIND_BIT,
    "wind": WIND_BIT,
    **AXIS_BITS,
}
"""Which sensors each kind of fault strikes; wind is the anemometer, ``gyro_x`` and the like are
single axes of the IMU."""

CHANNELS = len(SENSOR_CHANNELS) + len(MOTION_CHANNELS) + len(WIND_CHANNELS)
"""Channels that faults strike, in the order of SENSOR_CHANNELS, MOTION_CHANNELS, WIND_CHANNELS."""

LOSS, FROZEN, SPIKES, SCALED = 0, 1, 2, 3

EFFECTS = {
    "loss": LOSS,
    "frozen": FROZEN,
    "spikes": SPIKES,
    "zero": SCALED,
    "reversed": SCALED,
    "scaled": SCALED,
}
"""What a fault does: no sample; the last sample again, as if new; samples far off; zeros, as of a
dead axis; the wrong sign; samples times a factor."""

_FACTORS = {"zero": 0.0, "reversed": -1.0}
"""Factors of effects that have one of their own."""

FACTOR_MAX = 1e6
"""Largest factor of a fault."""

FAULT = np.dtype(
    [
        ("bits", float),  # sum of the bits of the sensors that it strikes
        ("start", float),  # s, of the present window; NaN: not used
        ("end", float),  # s
        ("effect", float),  # one of EFFECTS
        ("chance", float),  # share of samples with a spike
        ("gap", float, 2),  # s, shortest and longest time between random windows; 0: none
        ("length", float, 2),  # s, shortest and longest random window
        ("enter", float),  # probability that a burst begins in a step
        ("leave", float),  # probability that it ends; 0: no bursts
        ("bursting", float),  # 1 within a burst
        ("sizes", float, CHANNELS),  # spike of each channel, in its unit
        ("factor", float),  # of the samples, where they are scaled
        ("stream", "u8", STREAM),  # generator of its random numbers
    ]
)
"""A fault as kernels read and advance it."""

KEY_SIZE = 4
"""Numbers that tell the generators of faults apart, see :func:`fault_keys`."""


class FaultError(UsvTwinError):
    """An invalid sensor or fault; the message names it and the remedy."""


class FaultWarning(UserWarning):
    """A fault that changes nothing."""


SPIKE_SIZES = (
    *(20.0, 20.0, 2.0, 2.0, 0.5, 0.3, 5.0, 5.0),
    *(0.3, 0.3, 5.0, 0.3, 0.3, 20.0, 2.0),
    *(10.0, 1.0),
)
"""How far a spike is off, in the unit of each of :data:`SENSOR_CHANNELS`, :data:`MOTION_CHANNELS`
and :data:`WIND_CHANNELS`. By judgement: far beyond the noise, but possible."""


@dataclass(frozen=True)
class Disturbance(ABC):
    """What a fault does to which sensors; subclasses define when.

    Parameters
    ----------
    kind : str
        One of :data:`FAULT_KINDS`. ``all`` strikes them all at the same moments.
    effect : str
        One of :data:`EFFECTS`.
    chance : float
        Share of samples that a fault of ``spikes`` spoils.
    sizes : tuple of float
        How far a spike is off in each of :data:`SENSOR_CHANNELS`, each with a random sign; those
        of :data:`MOTION_CHANNELS`, and then of :data:`WIND_CHANNELS`, may follow.
    factor : float
        What a fault of ``scaled`` multiplies samples by.
    """

    kind: str
    effect: str = dataclasses.field(default="loss", kw_only=True)
    chance: float = dataclasses.field(default=0.1, kw_only=True)
    sizes: tuple[float, ...] = dataclasses.field(default=SPIKE_SIZES, kw_only=True)
    factor: float = dataclasses.field(default=2.0, kw_only=True)

    code: ClassVar[int]

    def __post_init__(self) -> None:
        if self.kind not in FAULT_KINDS:
            raise FaultError(
                f"no sensor fault is called {self.kind!r}{did_you_mean(self.kind, FAULT_KINDS)}; "
                f"use {', '.join(FAULT_KINDS)}"
            )
        if self.effect not in EFFECTS:
            raise FaultError(
                f"{self.kind} fault: there is no effect {self.effect!r}; use {', '.join(EFFECTS)}"
            )
        if not (is_finite(self.chance) and 0.0 <= self.chance <= 1.0):
            raise FaultError(
                f"{self.kind} fault: the chance of a spike must lie in [0, 1], got {self.chance}"
            )
        upright = len(SENSOR_CHANNELS)
        known = ((upright,), (upright + len(MOTION_CHANNELS),), (CHANNELS,))
        if np.shape(self.sizes) not in known or not all(map(is_finite, self.sizes)):
            raise FaultError(
                f"{self.kind} fault: sizes must be {len(SENSOR_CHANNELS)} finite numbers, one for "
                "each of usv_kernel.channels.SENSOR_CHANNELS, or also one for each of "
                f"MOTION_CHANNELS, and of WIND_CHANNELS, got {self.sizes}"
            )

        if not (is_finite(self.factor) and abs(self.factor) <= FACTOR_MAX):
            raise FaultError(
                f"{self.kind} fault: the factor must be a number from {-FACTOR_MAX:g} to "
                f"{FACTOR_MAX:g}, got {self.factor!r}"
            )

    @abstractmethod
    def _timing(self, dt: float) -> dict[str, Any]:
        """Return the fields of the record that say when it strikes."""

    def record(self, dt: float) -> Record:
        """Return the record that :func:`measure` reads, for control steps of dt s."""
        record = np.zeros(1, FAULT)[0]
        record["bits"], record["effect"] = FAULT_KINDS[self.kind], EFFECTS[self.effect]
        record["chance"] = self.chance
        record["sizes"] = (*self.sizes, *SPIKE_SIZES[len(self.sizes) :])
        record["factor"] = _FACTORS.get(self.effect, self.factor)
        for name, value in self._timing(dt).items():
            record[name] = value
        return record


@dataclass(frozen=True)
class Fault(Disturbance):
    """A fault of the sensors of one kind, for a while.

    Parameters
    ----------
    kind, effect, chance, sizes, factor
        What is struck and how: see :class:`Disturbance`.
    start, duration : float
        When it begins and how long it lasts, s.
    """

    start: float
    duration: float

    code = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (is_finite(self.start) and is_finite(self.duration) and self.duration > 0):
            raise FaultError(
                f"{self.kind} fault: start and duration must be finite and the duration above 0, "
                f"got {self.start} and {self.duration}"
            )

    def _timing(self, dt: float) -> dict[str, Any]:
        return {"start": self.start, "end": self.start + self.duration}


@dataclass(frozen=True)
class RandomFaults(Disturbance):
    """Faults that come and go at random without end.

    Parameters
    ----------
    kind, effect, chance, sizes, factor
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
            sound = np.shape(span) == (2,) and all(map(is_finite, span))
            if not (sound and 0.0 < span[0] <= span[1]):
                raise FaultError(
                    f"{self.kind} fault: {name} must be the shortest and the longest time in s, "
                    f"both above 0 and finite, got {span}"
                )
        _finite_start(self.kind, self.start)

    def _timing(self, dt: float) -> dict[str, Any]:
        # an empty window, after which the first real one is drawn
        return {"start": self.start, "end": self.start, "gap": self.gap, "length": self.duration}


@dataclass(frozen=True)
class Bursts(Disturbance):
    """Faults in bursts: a Gilbert-Elliott chain, drawn at each control step.

    Source: Gilbert 1960, Elliott 1963: p from good to bad and r back in each step. The share is p /
    (p + r), the mean burst 1 / r steps.

    Parameters
    ----------
    kind, effect, chance, sizes, factor
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
        if not (is_finite(self.loss) and 0.0 < self.loss < 1.0):
            raise FaultError(
                f"{self.kind} bursts: the loss must be a share above 0 and below 1, got {self.loss}"
            )
        if not (is_finite(self.mean) and self.mean > 0.0):
            raise FaultError(
                f"{self.kind} bursts: the mean length must be finite and above 0 s, got {self.mean}"
            )
        _finite_start(self.kind, self.start)

    def _timing(self, dt: float) -> dict[str, Any]:
        leave = dt / self.mean
        enter = leave * self.loss / (1.0 - self.loss)
        if max(leave, enter) > 1.0 + 1e-9:
            raise FaultError(
                f"{self.kind} bursts of {self.mean:g} s with a loss of {self.loss:g} do not fit "
                f"steps of {dt:g} s; make them longer or the loss smaller"
            )
        return {"start": self.start, "enter": enter, "leave": leave}


def _finite_start(kind: str, start: float) -> None:
    if not is_finite(start):
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
    Bursts("ahrs", loss=0.02, mean=0.5),
    RandomFaults("ahrs", effect="spikes"),
    Bursts("wind", loss=0.05, mean=2.0),
    RandomFaults("wind", effect="spikes"),
    RandomFaults("wind", effect="frozen"),
    RandomFaults("all", gap=(60.0, 180.0), duration=(1.0, 5.0)),
)
"""What the text ``on`` stands for: whatever comes and goes with sensors does, again and again."""

_NUMBER = r"(\d+(?:\.\d+)?)"

_FAULT = re.compile(
    rf"([a-z_]+)(?:-({'|'.join(EFFECTS)}))?"
    rf"(?:{_NUMBER}|(-random)|-bursts(?:{_NUMBER}x{_NUMBER})?)(?:@{_NUMBER})?",
    re.ASCII,
)

FAULTS_HELP = (
    "none; on for all of them; or a kind and seconds, such as gps10. gps10@30 begins at second 30, "
    "gps-frozen5 and gyro_x-zero20 have an effect, gps-random comes again and again. gps-bursts "
    "and gps-bursts10x2 come in bursts: of the latter 10 % of the time, 2 s each. + joins several "
    f"(kinds: {', '.join(FAULT_KINDS)}; effects: {', '.join(EFFECTS)})"
)
"""What a text of faults may be, for messages."""


def parse_faults(text: str, start: float) -> tuple[Disturbance, ...]:
    """Return the faults that a text such as ``gps10`` or ``none`` stands for.

    Parameters
    ----------
    text : str
        ``none``; ``on``, see :data:`ON`; or parts joined by ``+``. A part is a kind, then ``-`` and
        an effect (``loss`` if left out), then when, and last ``@`` and its start in s. When is
        seconds, ``-random`` (see :class:`RandomFaults`) or ``-bursts`` (see :class:`Bursts`). Per
        cent and mean seconds may follow, as in ``gps-bursts10x2``.
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
            raise FaultError(f"fault {text[:200]!r} is not understood; write {FAULTS_HELP}")
        try:
            faults.append(_fault(match, start))
        except FaultError as error:
            raise FaultError(f"fault {part!r}: {error}") from None
    return tuple(faults)


def fault_text(fault: Disturbance, start: float | None = None) -> str:
    """Return a fault as the text that :func:`parse_faults` reads, with rounded times.

    Gaps and durations of random faults, and sizes of errors, are not in it. A ``start`` (s)
    replaces that of a :class:`Fault`.
    """
    name = fault.kind if fault.effect == "loss" else f"{fault.kind}-{fault.effect}"
    if isinstance(fault, Fault):
        return f"{name}{fault.duration:g}@{fault.start if start is None else start:.1f}"
    if isinstance(fault, Bursts):
        return f"{name}-bursts{100.0 * fault.loss:g}x{fault.mean:g}@{fault.start:g}"
    return f"{name}-random"


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


def ineffective_fault(faults: Sequence[Disturbance], dof: int, anemometer: bool) -> str | None:
    """Return a sentence on a fault that changes nothing; None where all have an effect.

    Parameters
    ----------
    faults : sequence of Disturbance
        As given; those of :data:`ON` strike whatever there is.
    dof : int
        Degrees of freedom of the boat: 3 or 6.
    anemometer : bool
        Whether the sensors have an anemometer.
    """
    struck = {fault.kind for fault in faults if fault not in ON}
    if "ahrs" in struck and dof == 3:
        return "a boat with dof=3 has no AHRS: its fault changes nothing; use dof=6"
    for axis in sorted(struck & {"gyro_x", "gyro_y", "accel_z"}):
        if dof == 3:
            return f"a boat with dof=3 has no {axis}: its fault changes nothing; use dof=6"
    if "wind" in struck and not anemometer:
        return "these sensors have no anemometer: its fault changes nothing; use those of 'best'"
    return None


def fault_records(faults: Sequence[Disturbance], dt: float) -> np.ndarray:
    """Return an array (F,) of :data:`FAULT` for :func:`measure` with control steps of dt s."""
    records = np.zeros(len(faults), FAULT)
    for i, fault in enumerate(faults):
        records[i] = fault.record(dt)
    return records


def fault_keys(faults: Sequence[Disturbance]) -> NDArray[np.uint64]:
    """Return numbers (F, 4) of faults that stay the same whatever faults are beside them."""
    seen: dict[tuple[int, ...], int] = {}
    keys = np.zeros((len(faults), KEY_SIZE), np.uint64)
    for row, fault in zip(keys, faults, strict=True):
        # a number that stays the same whatever other kinds there are
        bits = FAULT_KINDS[fault.kind]
        kind = bits % AHRS_BIT if fault.kind == "all" else bits
        key = (fault.code, kind, EFFECTS[fault.effect])
        seen[key] = seen.get(key, -1) + 1
        row[:] = *key, seen[key]
    return keys


@kernel
def start_streams(
    words: np.ndarray, keys: np.ndarray, scratch: np.ndarray, faults: np.ndarray
) -> None:
    """Give each fault (F,) a generator, by its keys (F, 4).

    ``words`` (4,) start the generator of their common seed. ``scratch`` (4, 8) is uint64, as the
    others.
    """
    numbers, stream = scratch[3, : 1 + KEY_SIZE], scratch[2, STREAM : 2 * STREAM]
    start_stream(words, stream)
    seed = next_word(stream) >> np.uint64(1)
    for i in range(faults.shape[0]):
        numbers[0] = seed
        for k in range(KEY_SIZE):
            numbers[1 + k] = keys[i, k]
        hash_numbers(numbers, scratch[:3], stream)
        start_stream(stream, faults[i].stream)


def seed_faults(
    records: np.ndarray, faults: Sequence[Disturbance], rng: np.random.Generator
) -> None:
    """Give each record (F,) a generator; it stays the same whatever faults are beside it."""
    seed_sequence: Any = rng.bit_generator.seed_seq
    words = seed_sequence.spawn(1)[0].generate_state(STREAM, np.uint64)
    start_streams(words, fault_keys(faults), np.zeros((4, 8), np.uint64), records)


def apply_faults(
    t: np.ndarray,
    z: np.ndarray,
    faults: Sequence[Disturbance],
    rng: np.random.Generator,
    columns: Sequence[int] | None = None,
) -> np.ndarray:
    """Return recorded measurements as they would be with faults of the sensors.

    ``t`` (N,) in s; starts of faults count from the first. ``columns`` are the places of
    :data:`SENSOR_CHANNELS`, :data:`MOTION_CHANNELS` and :data:`WIND_CHANNELS` in the rows of ``z``.
    If left out, rows begin with the first and may end with the others. What else there is, is kept.
    """
    if not faults:
        return z.copy()
    step = float(np.median(np.diff(t))) if len(t) > 1 else 1.0
    records, out = fault_records(faults, step), z.copy()
    seed_faults(records, faults, rng)
    if columns is None:
        behind = CHANNELS - len(SENSOR_CHANNELS) if z.shape[1] >= CHANNELS else 0
        columns = [*range(len(SENSOR_CHANNELS)), *range(-behind, 0)]
    last = np.full(len(columns), math.nan)
    samples = np.ascontiguousarray(z[:, columns])
    for k in range(len(t)):
        strike(float(t[k] - t[0]), records, last, samples[k])
    out[:, columns] = samples
    return out


@kernel
def strike(t: float, faults: np.ndarray, last: np.ndarray, z: np.ndarray) -> None:
    """Apply the faults to the samples z (8,) or (17,) of time t (s), in place; NaN: none.

    Faults (F,) and ``last``, the samples handed out last, are advanced in place. Each fault draws
    three uniform numbers in each step.
    """
    lost, frozen = 0, 0
    numbers = alloca_f64(3)
    for i in range(faults.shape[0]):
        fault = faults[i]
        if math.isnan(fault.start):  # not used
            continue
        fill_uniform(fault.stream, numbers)
        if t < fault.start:
            continue
        draw, hit, signs = numbers[0], numbers[1], numbers[2]
        if fault.leave > 0.0:
            bursting = draw >= fault.leave if fault.bursting > 0.0 else draw < fault.enter
            fault.bursting = 1.0 if bursting else 0.0
            if not bursting:
                continue
        elif t >= fault.end:
            if fault.gap[0] > 0.0:
                fault.start = t + fault.gap[0] + (fault.gap[1] - fault.gap[0]) * draw
                fault.end = (
                    fault.start + fault.length[0] + (fault.length[1] - fault.length[0]) * hit
                )
            continue
        bits = int(fault.bits)
        if fault.effect == LOSS:
            lost |= bits
        elif fault.effect == FROZEN:
            frozen |= bits
        elif fault.effect == SCALED:
            for j in range(z.shape[0]):
                if bits & BITS[j]:
                    z[j] *= fault.factor
        elif hit < fault.chance:
            # the binary digits of one number are as many signs
            for j in range(z.shape[0]):
                signs *= 2.0
                up = signs >= 1.0
                signs -= 1.0 if up else 0.0
                if bits & BITS[j]:
                    z[j] += fault.sizes[j] if up else -fault.sizes[j]
    for j in range(z.shape[0]):
        bit = BITS[j]
        if lost & bit:
            z[j] = math.nan
        elif math.isfinite(z[j]):
            if frozen & bit:
                z[j] = last[j]
            last[j] = z[j]
