"""Faults of sensors, commands and thrusters: what they do, and when: once, at random, in bursts."""

from __future__ import annotations

import dataclasses
import math
import re
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from usv_gym.world.channels import (
    AHRS_BIT,
    AXIS_BITS,
    BITS,
    COMMANDS_BIT,
    COMPASS_BIT,
    FIXES_BIT,
    GPS_BIT,
    IMU_BIT,
    LEFT_BIT,
    RIGHT_BIT,
    STEERING_BIT,
    VELOCITY_BIT,
    WIND_BIT,
)
from usv_kernel.arrays import alloca_f64
from usv_kernel.channels import MOTION_CHANNELS, SENSOR_CHANNELS, WIND_CHANNELS
from usv_kernel.errors import UsvTwinError, did_you_mean, is_finite
from usv_kernel.jit import inlined, kernel
from usv_kernel.random import STREAM, fill_uniform, next_word, start_stream
from usv_kernel.records import Record
from usv_kernel.streams import hash_numbers

__all__ = [
    "AMOUNTS",
    "CHANNELS",
    "EFFECTS",
    "FAULT",
    "FAULTS_HELP",
    "FAULT_KINDS",
    "ON",
    "REPORTED",
    "STRUCK",
    "THRUSTERS",
    "Bursts",
    "Disturbance",
    "Fault",
    "FaultError",
    "FaultWarning",
    "RandomFaults",
    "apply_faults",
    "drive",
    "fault_keys",
    "fault_of_table",
    "fault_records",
    "fault_text",
    "ineffective_fault",
    "memory_rows",
    "parse_faults",
    "seed_faults",
    "start_streams",
    "strike",
]

FAULT_KINDS = {
    "gps": GPS_BIT,
    "fixes": FIXES_BIT,
    "velocity": VELOCITY_BIT,
    "compass": COMPASS_BIT,
    "imu": IMU_BIT,
    "gyro": AXIS_BITS["gyro_x"] | AXIS_BITS["gyro_y"] | AXIS_BITS["gyro_z"],
    "accelerometers": AXIS_BITS["accel_x"] | AXIS_BITS["accel_y"] | AXIS_BITS["accel_z"],
    **AXIS_BITS,
    "ahrs": AHRS_BIT,
    "wind": WIND_BIT,
    "all": GPS_BIT | COMPASS_BIT | IMU_BIT | AHRS_BIT | WIND_BIT,
    "commands": COMMANDS_BIT,
    "steering": STEERING_BIT,
    "left": LEFT_BIT,
    "right": RIGHT_BIT,
}
"""What each kind of fault strikes: ``fixes`` and ``velocity`` are those of the GPS alone,
``gyro_x`` and the like single axes of the IMU, ``wind`` the anemometer, ``all`` all sensors.
``commands`` are those that are reported, ``steering`` the angles among them; the boat does as it
was told. ``left`` and ``right`` are thrusters of the boat."""

REPORTED = ("commands", "steering")
THRUSTERS = ("left", "right")
"""Kinds that strike what a twin is told of the commands, and what the boat makes of them."""

SENSOR_KINDS = tuple(kind for kind in FAULT_KINDS if kind not in (*REPORTED, *THRUSTERS))

CHANNELS = len(SENSOR_CHANNELS) + len(MOTION_CHANNELS) + len(WIND_CHANNELS)
"""Channels of the sensors, in the order of SENSOR_CHANNELS, MOTION_CHANNELS, WIND_CHANNELS."""

STRUCK = CHANNELS + 4
"""Numbers of a row that faults strike: those of the sensors, then the four reported commands."""

LOSS, FROZEN, SPIKES, SCALED, SWAPPED, OFFSET, LATE, STALL, GARBAGE = range(9)

EFFECTS = {
    "loss": LOSS,
    "frozen": FROZEN,
    "spikes": SPIKES,
    "zero": SCALED,
    "sign": SCALED,
    "scale": SCALED,
    "jump": OFFSET,
    "bias": OFFSET,
    "ramp": OFFSET,
    "swapped": SWAPPED,
    "late": LATE,
    "stall": STALL,
    "garbage": GARBAGE,
}
"""What a fault does, and how kernels know it:

``loss``: no sample. ``frozen``: the last sample again, as if new. ``spikes``: some samples are far
off. ``zero``: 0, as of a dead axis or thruster. ``sign``: the wrong sign. ``scale``: times a
factor. ``jump``: fixes too far north. ``bias``: an error that stays. ``ramp``: one that grows; a
whole GPS is drawn away to the north, fixes and velocity alike. ``swapped``: north and east, two
axes or the two sides exchanged. ``late``: samples of some seconds ago. ``stall``: none, and then
the missed ones at twice their pace, until it has caught up. ``garbage``: numbers of any size.
"""

_ROW_KINDS = (*SENSOR_KINDS, *REPORTED)
"""Kinds that strike what a row says."""

_BIASES = {
    **dict.fromkeys(("gyro", "gyro_x", "gyro_y", "gyro_z"), 0.1),
    **dict.fromkeys(("accelerometers", "accel_x", "accel_y", "accel_z"), 1.0),
    "velocity": 1.0,
    "compass": 0.5,
    "ahrs": 0.1,
    "wind": 5.0,
}
"""By kind, of those that have one unit, the usual bias; a ramp makes a tenth of it a second."""

AMOUNTS: dict[str, dict[str, float | None]] = {
    **{name: dict.fromkeys(SENSOR_KINDS) for name in ("loss", "spikes")},
    **{name: dict.fromkeys(_ROW_KINDS) for name in ("frozen", "stall", "garbage")},
    **{name: dict.fromkeys(FAULT_KINDS) for name in ("zero", "sign")},
    "scale": {**dict.fromkeys(_ROW_KINDS, 2.0), **dict.fromkeys(THRUSTERS, 0.7)},
    "jump": {"gps": 20.0, "fixes": 20.0},
    "bias": dict(_BIASES),
    "ramp": {"gps": 0.5, "fixes": 0.5, **{kind: bias / 10.0 for kind, bias in _BIASES.items()}},
    "swapped": dict.fromkeys(
        ("gps", "fixes", "velocity", "gyro", "accelerometers", "imu", "ahrs", "all", *REPORTED)
    ),
    "late": dict.fromkeys(_ROW_KINDS, 2.0),
}
"""By effect, the kinds that have it, each with its amount where none is given; None: it takes none.

A factor of ``scale``, of a thruster's shaft speed; s of ``late``; m of ``jump``; of ``bias`` the
unit of the sensor (m/s, rad, rad/s, m/s2), of ``ramp`` that a second. All axes of a sensor get it;
of GPS velocity the northern one, of the wind its speed."""

RENAMED = {"reversed": "sign", "scaled": "scale"}
"""Names that effects had before, for the message that refuses them."""

_FACTORS = {"zero": 0.0, "sign": -1.0}
"""Factors of effects that have one of their own."""

AMOUNT_MAX = 1e9
"""Largest amount of a fault."""

DELAY_MAX_S = 300.0
"""Longest delay and longest stall, s: all rows of that time are kept."""

PARTNERS = (1, 0, 3, 2, 4, 5, 7, 6, 9, 8, 10, 12, 11, 13, 14, 15, 16, 18, 17, 20, 19)
"""Place in a row with which ``swapped`` exchanges each number; its own: with none."""

_ADDED_TO = np.array([1, 0, 1, 0, *[1] * 9, 0, 0, 1, 0, *[0] * 4])
"""1 for the numbers of a row that offsets are added to: of vectors the northern part alone."""

_BITS = np.array(BITS)

FAULT = np.dtype(
    [
        ("bits", float),  # sum of the bits of what it strikes
        ("start", float),  # s, of the present window; NaN: not used
        ("end", float),  # s
        ("effect", float),  # one of EFFECTS
        ("chance", float),  # share of samples with a spike
        ("gap", float, 2),  # s, shortest and longest time between random windows; 0: none
        ("length", float, 2),  # s, shortest and longest random window
        ("enter", float),  # probability that a burst begins in a step
        ("leave", float),  # probability that it ends; 0: no bursts
        ("bursting", float),  # 1 within a burst
        ("active", float),  # 1 if it struck the last row
        ("since", float),  # s, when it began to strike
        ("sizes", float, STRUCK),  # spike of each number of a row, in its unit
        ("offsets", float, STRUCK),  # errors that are added ...
        ("rates", float, STRUCK),  # ... and how much they grow a second
        ("factor", float),  # of the samples, where they are scaled
        ("delay", float),  # s, of late samples
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
    """Kind and effect of a fault; subclasses define its times.

    Parameters
    ----------
    kind : str
        One of :data:`FAULT_KINDS`. ``all`` strikes all sensors at the same moments.
    effect : str
        One of :data:`EFFECTS`.
    amount : float, optional
        How much, see :data:`AMOUNTS`.
    chance : float
        Share of samples that a fault of ``spikes`` spoils.
    sizes : tuple of float
        How far a spike is off in each of :data:`SENSOR_CHANNELS`, each with a random sign; those
        of :data:`MOTION_CHANNELS`, and then of :data:`WIND_CHANNELS`, may follow.
    """

    kind: str
    effect: str = dataclasses.field(default="loss", kw_only=True)
    amount: float | None = dataclasses.field(default=None, kw_only=True)
    chance: float = dataclasses.field(default=0.1, kw_only=True)
    sizes: tuple[float, ...] = dataclasses.field(default=SPIKE_SIZES, kw_only=True)

    code: ClassVar[int]

    def __post_init__(self) -> None:
        if self.kind not in FAULT_KINDS:
            raise FaultError(
                f"no fault is called {self.kind!r}{did_you_mean(self.kind, FAULT_KINDS)}; "
                f"use {', '.join(FAULT_KINDS)}"
            )
        self._check_effect()
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

    def _check_effect(self) -> None:
        """Refuse an effect that the kind does not have, or an impossible amount of it."""
        kind, effect = self.kind, self.effect
        if effect not in EFFECTS:
            new = f"is called {RENAMED[effect]!r}" if effect in RENAMED else "does not exist"
            raise FaultError(f"{kind} fault: effect {effect!r} {new}; use {', '.join(EFFECTS)}")
        if kind not in AMOUNTS[effect]:
            own = (name for name, kinds in AMOUNTS.items() if kind in kinds)
            raise FaultError(f"{kind} fault: it has no effect {effect!r}; use {', '.join(own)}")
        usual = AMOUNTS[effect][kind]
        if self.amount is None:
            object.__setattr__(self, "amount", usual)
            return
        if usual is None:
            raise FaultError(
                f"{kind} fault: {effect!r} takes no amount, got {self.amount!r}; leave it out"
            )
        low, high = (1e-3, DELAY_MAX_S) if effect == "late" else (-AMOUNT_MAX, AMOUNT_MAX)
        if not (is_finite(self.amount) and low <= self.amount <= high):
            raise FaultError(
                f"{kind} fault: the amount of {effect!r} must be a number from {low:g} to "
                f"{high:g}, got {self.amount!r}"
            )

    @abstractmethod
    def _timing(self, dt: float) -> dict[str, Any]:
        """Return the fields of the record that say when it strikes."""

    def _longest(self) -> float:
        """Return the longest time that it lasts without a break, s."""
        return math.inf

    def _check_stall(self) -> None:
        """Refuse a stall of more rows than can be kept."""
        if self.effect == "stall" and not self._longest() <= DELAY_MAX_S:
            raise FaultError(
                f"{self.kind} fault: a stall must last {DELAY_MAX_S:g} s at most, got "
                f"{self._longest():g} s; use windows that are shorter, and no bursts"
            )

    @property
    def delay(self) -> float:
        """Age of the oldest samples that it hands out, s."""
        if self.effect == "stall":
            return self._longest()
        return float(self.amount or 0.0) if self.effect == "late" else 0.0

    def _errors(self) -> tuple[np.ndarray, np.ndarray]:
        """Return offsets of a row (21,), and their rates per second."""
        none = np.zeros(STRUCK)
        if EFFECTS[self.effect] != OFFSET:
            return none, none
        added = np.where(_BITS & FAULT_KINDS[self.kind], _ADDED_TO, 0) * float(self.amount or 0.0)
        if self.effect == "bias":
            return added, none
        if self.effect == "jump":
            return np.where(_BITS & FIXES_BIT, added, 0.0), none
        # a GPS that is drawn away says the velocity with which it is
        speeds = np.where(_BITS & VELOCITY_BIT, added, 0.0) if self.kind == "gps" else none
        return speeds, added - speeds

    def record(self, dt: float) -> Record:
        """Return the record that :func:`strike` reads, for control steps of dt s."""
        record = np.zeros(1, FAULT)[0]
        record["bits"], record["effect"] = FAULT_KINDS[self.kind], EFFECTS[self.effect]
        record["chance"] = self.chance
        record["sizes"][:CHANNELS] = (*self.sizes, *SPIKE_SIZES[len(self.sizes) :])
        record["offsets"], record["rates"] = self._errors()
        record["factor"] = _FACTORS.get(self.effect, self.amount or 0.0)
        record["delay"] = self.delay
        for name, value in self._timing(dt).items():
            record[name] = value
        return record


@dataclass(frozen=True)
class Fault(Disturbance):
    """A fault of one kind, for a while.

    Parameters
    ----------
    kind, effect, amount, chance, sizes
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
        self._check_stall()

    def _longest(self) -> float:
        return self.duration

    def _timing(self, dt: float) -> dict[str, Any]:
        return {"start": self.start, "end": self.start + self.duration}


@dataclass(frozen=True)
class RandomFaults(Disturbance):
    """Faults that come and go at random without end.

    Parameters
    ----------
    kind, effect, amount, chance, sizes
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
        self._check_stall()

    def _longest(self) -> float:
        return self.duration[1]

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
    kind, effect, amount, chance, sizes
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
        self._check_stall()

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
_AMOUNT = r"=(-?\d+(?:\.\d+)?)"

_FAULT = re.compile(
    rf"([a-z_]+)(?:-([a-z]+))?"
    rf"(?:(?:{_AMOUNT}:)?{_NUMBER}|(?:{_AMOUNT})?(?:(-random)|-bursts(?:{_NUMBER}x{_NUMBER})?))"
    rf"(?:@{_NUMBER})?",
    re.ASCII,
)

FAULTS_HELP = (
    "none; on for all that comes and goes with sensors; or a kind and seconds, such as gps10. "
    "gps10@30 begins at second 30, gps-frozen5 and gyro_x-zero20 have an effect, gps-jump=20:10 "
    "and compass-bias=-0.2:10@30 an amount in the unit of the sensor. gps-random comes again and "
    "again. gps-bursts and gps-bursts10x2 come in bursts: of the latter 10 % of the time, 2 s "
    f"each. + joins several (kinds: {', '.join(FAULT_KINDS)}; effects: {', '.join(EFFECTS)})"
)
"""What a text of faults may be, for messages."""


def parse_faults(text: str, start: float) -> tuple[Disturbance, ...]:
    """Return the faults that a text such as ``gps10`` or ``none`` stands for.

    Parameters
    ----------
    text : str
        ``none``; ``on``, see :data:`ON`; or parts joined by ``+``. A part is a kind, then ``-`` and
        an effect (``loss`` if left out), then ``=`` and its amount (see :data:`AMOUNTS`), then
        when, and last ``@`` and its start in s. When is seconds, behind a ``:`` if there is an
        amount, ``-random`` (see :class:`RandomFaults`) or ``-bursts`` (see :class:`Bursts`). Per
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


def fault_of_table(table: Mapping[str, Any]) -> Disturbance:
    """Return the fault of which this is the table of fields, as JSON of a spec holds it."""
    for kind in (Fault, RandomFaults, Bursts):
        if table.keys() == {one.name for one in dataclasses.fields(kind)}:
            spans = {key: tuple(one) for key, one in table.items() if isinstance(one, list)}
            return kind(**{**table, **spans})
    raise FaultError(f"fault {dict(table)!r}: a table needs all fields of a fault, and no others")


def _plain(number: float) -> str:
    """Return a number as digits, without an exponent."""
    return np.format_float_positional(number, trim="-")


def fault_text(fault: Disturbance, start: float | None = None) -> str:
    """Return a fault as the text that :func:`parse_faults` reads, its start to a tenth of a second.

    Gaps and durations of random faults, and sizes of spikes, are not in it. A ``start`` (s)
    replaces that of a :class:`Fault`.
    """
    name = fault.kind if fault.effect == "loss" else f"{fault.kind}-{fault.effect}"
    amount = ""
    if fault.amount is not None and fault.amount != AMOUNTS[fault.effect][fault.kind]:
        amount = f"={_plain(fault.amount)}"
    if isinstance(fault, Fault):
        seconds = f"{':' if amount else ''}{_plain(fault.duration)}"
        return f"{name}{amount}{seconds}@{fault.start if start is None else start:.1f}"
    when = "-random"
    if isinstance(fault, Bursts):
        when = f"-bursts{_plain(round(100.0 * fault.loss, 9))}x{_plain(fault.mean)}"
    begin = getattr(fault, "start", 0.0)
    return f"{name}{amount}{when}" + (f"@{_plain(begin)}" if begin else "")


def _fault(match: re.Match[str], start: float) -> Disturbance:
    """Return the fault that the groups of a match stand for."""
    kind, effect, once, seconds, again, random, loss, mean, at = match.groups()
    given = once or again
    how: dict[str, Any] = {"effect": effect or "loss", "amount": float(given) if given else None}
    if seconds:
        return Fault(kind, float(at) if at else start, float(seconds), **how)
    begin = float(at or 0.0)
    if random:
        return RandomFaults(kind, start=begin, **how)
    if loss:
        return Bursts(kind, float(loss) / 100.0, float(mean), begin, **how)
    return Bursts(kind, start=begin, **how)


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
    if any(one.kind == "gyro" and one.effect == "swapped" for one in faults) and dof == 3:
        return "a boat with dof=3 has one gyro, and nothing to swap it with; use dof=6"
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
        hash_numbers(numbers, scratch[:2], stream)
        start_stream(stream, faults[i].stream)


def seed_faults(
    records: np.ndarray, faults: Sequence[Disturbance], rng: np.random.Generator
) -> None:
    """Give each record (F,) a generator; it stays the same whatever faults are beside it."""
    seed_sequence: Any = rng.bit_generator.seed_seq
    words = seed_sequence.spawn(1)[0].generate_state(STREAM, np.uint64)
    start_streams(words, fault_keys(faults), np.zeros((4, 8), np.uint64), records)


def memory_rows(faults: Sequence[Disturbance], dt: float) -> int:
    """Return how many rows :func:`strike` must remember with control steps of dt s; 0: none."""
    longest = max((fault.delay for fault in faults), default=0.0)
    return math.ceil(longest / dt) + 2 if longest > 0.0 else 0


def apply_faults(
    t: np.ndarray,
    z: np.ndarray,
    cmd: np.ndarray,
    faults: Sequence[Disturbance],
    rng: np.random.Generator,
    columns: Sequence[int] | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Return recorded measurements and commands (N, 4) as they would be with faults.

    ``t`` (N,) in s; starts of faults count from the first. ``columns`` are the places of
    :data:`SENSOR_CHANNELS`, :data:`MOTION_CHANNELS` and :data:`WIND_CHANNELS` in the rows of ``z``.
    If left out, rows begin with the first and may end with the others. What else there is, is kept.

    Raises
    ------
    FaultError
        For a thruster: what the boat would have done is not known.
    """
    for fault in faults:
        if fault.kind in THRUSTERS:
            raise FaultError(
                f"{fault.kind} fault: what a recorded boat would have done without a thruster is "
                "not known; use it where a boat is simulated"
            )
    if not faults:
        return z.copy(), cmd.copy()
    step = float(np.median(np.diff(t))) if len(t) > 1 else 1.0
    records = fault_records(faults, step)
    seed_faults(records, faults, rng)
    if columns is None:
        behind = CHANNELS - len(SENSOR_CHANNELS) if z.shape[1] >= CHANNELS else 0
        columns = [*range(len(SENSOR_CHANNELS)), *range(-behind, 0)]
    rows = np.full((len(t), STRUCK), math.nan)
    rows[:, : len(columns)], rows[:, CHANNELS:] = z[:, columns], cmd
    last = np.full(STRUCK, math.nan)
    # rows of a log may be closer than its typical step
    memory = np.zeros((len(t) if memory_rows(faults, step) else 0, 1 + STRUCK))
    for k in range(len(t)):
        strike(float(t[k] - t[0]), k, records, last, memory, rows[k])
    out = z.copy()
    out[:, columns] = rows[:, : len(columns)]
    return out, rows[:, CHANNELS:].copy()


@inlined
def _is_on(t, fault, draw, hit):
    """Advance a fault's windows to t (s), and return whether it strikes then."""
    if t < fault.start:
        return False
    if fault.leave > 0.0:
        bursting = draw >= fault.leave if fault.bursting > 0.0 else draw < fault.enter
        if bursting and fault.bursting == 0.0:
            fault.since = t
        fault.bursting = 1.0 if bursting else 0.0
        return bursting
    # a stall takes as long again until it has caught up
    over = fault.end + (fault.end - fault.start if fault.effect == STALL else 0.0)
    if t >= over:
        if fault.gap[0] > 0.0:
            fault.start = t + fault.gap[0] + (fault.gap[1] - fault.gap[0]) * draw
            fault.end = fault.start + fault.length[0] + (fault.length[1] - fault.length[0]) * hit
        return False
    fault.since = fault.start
    return True


_SLACK = 1e-6
"""Times of rows that differ by less are the same, s."""


@inlined
def _recalled(j, after, until, count, memory):
    """Return the newest sample j of the rows in a span of time, (after, until] in s; NaN: none."""
    rows = memory.shape[0]
    for back in range(min(count + 1, rows)):
        row = memory[(count - back) % rows]
        if row[0] > until + _SLACK:
            continue
        if row[0] <= after + _SLACK:
            break
        if math.isfinite(row[1 + j]):
            return row[1 + j]
    return math.nan


@inlined
def _held(j, last):
    """Return the last output of channel j; a command before the first is 0."""
    return last[j] if j < CHANNELS or math.isfinite(last[j]) else 0.0


@inlined
def _recall(t, count, fault, last, memory, z):
    """Replace the numbers that a fault strikes by the delayed samples of this time."""
    before = memory[(count - 1) % memory.shape[0], 0] if count > 0 else -math.inf
    after, until = before - fault.delay, t - fault.delay
    if fault.effect == STALL:
        after = max(fault.start + 2.0 * (before - fault.end), fault.start - 2.0 * _SLACK)
        until = fault.start + 2.0 * (t - fault.end)
    for j in range(z.shape[0]):
        if int(fault.bits) & BITS[j]:
            z[j] = _recalled(j, after, until, count, memory)
            if j >= CHANNELS and math.isnan(z[j]):  # the boat goes on by the last command
                z[j] = _held(j, last)


@kernel
def strike(
    t: float,
    count: int,
    faults: np.ndarray,
    last: np.ndarray,
    memory: np.ndarray,
    z: np.ndarray,
) -> None:
    """Apply the faults to the row z (21,) of time t (s), in place; NaN: no sample.

    ``count`` is the number of the row, from 0. Faults (F,), ``last``, the row handed out last, and
    ``memory`` (:func:`memory_rows`, 22), times and sound rows so far, are advanced in place. Faults
    of the same channel act one after the other, losses and frozen samples last. Each fault draws
    three uniform numbers in each step; garbage draws two more for each sample.
    """
    lost, frozen = 0, 0
    numbers, pair = alloca_f64(3), alloca_f64(2)
    if memory.shape[0] > 0:
        row = memory[count % memory.shape[0]]
        row[0] = t
        for j in range(z.shape[0]):
            row[1 + j] = z[j]
    for i in range(faults.shape[0]):
        fault = faults[i]
        fault.active = 0.0
        if math.isnan(fault.start):  # not used
            continue
        fill_uniform(fault.stream, numbers)
        draw, hit, signs = numbers[0], numbers[1], numbers[2]
        if not _is_on(t, fault, draw, hit):
            continue
        fault.active = 1.0
        bits = int(fault.bits)
        if fault.effect == LOSS or (fault.effect == STALL and t < fault.end):
            lost |= bits
        elif fault.effect == FROZEN:
            frozen |= bits
        elif fault.effect == SCALED:
            for j in range(z.shape[0]):
                if bits & BITS[j]:
                    z[j] *= fault.factor
        elif fault.effect == OFFSET:
            for j in range(z.shape[0]):
                if bits & BITS[j]:
                    z[j] += fault.offsets[j] + fault.rates[j] * (t - fault.since)
        elif fault.effect == SWAPPED:
            for j in range(z.shape[0]):
                other = PARTNERS[j]
                if bits & BITS[j] and j < other:
                    z[j], z[other] = z[other], z[j]
        elif fault.effect == GARBAGE:
            for j in range(z.shape[0]):
                if bits & BITS[j] and math.isfinite(z[j]):
                    fill_uniform(fault.stream, pair)
                    z[j] = (2.0 * pair[0] - 1.0) * 10.0 ** (15.0 * pair[1] - 3.0)
        elif fault.effect == LATE or fault.effect == STALL:
            _recall(t, count, fault, last, memory, z)
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
            z[j] = math.nan if j < CHANNELS else _held(j, last)
        elif math.isfinite(z[j]):
            if frozen & bit:
                z[j] = _held(j, last)
            last[j] = z[j]


@inlined
def drive(command, faults, drives):
    """Write the command (4,) of the drives after faults (F,) of the thrusters."""
    for k in range(4):
        drives[k] = command[k]
    for i in range(faults.shape[0]):
        fault = faults[i]
        if fault.active > 0.0 and fault.bits == LEFT_BIT:
            drives[0] *= fault.factor
        elif fault.active > 0.0 and fault.bits == RIGHT_BIT:
            drives[1] *= fault.factor
