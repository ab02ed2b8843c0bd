"""Servo outputs of an autopilot as commands, and what its parameters say of the boat."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from twin.channels import COMMANDS
from twin.logs.columns import SHARE, Array
from twin.logs.errors import LogError
from twin.particulars import Particulars

__all__ = [
    "FULL_ANGLE",
    "Output",
    "Outputs",
    "particulars_of_parameters",
]

STEERING = 26
THROTTLE = 70
THROTTLE_LEFT = 73
THROTTLE_RIGHT = 74
"""Values of SERVOx_FUNCTION.
Source: https://ardupilot.org/rover/docs/rover-motor-and-servo-configuration.html"""

MOTORS = range(33, 41)
"""Values of SERVOx_FUNCTION for the motors of a frame that also moves sideways."""

FULL_ANGLE = 30.0
"""Full helm where no parameter states it, degrees."""

HIGHEST = 32
"""Most outputs."""

UNUSED = 65535.0
"""Pulse width of an output that is not used, us; so is 0."""


@dataclass(frozen=True)
class Output:
    """A servo output: its number from 1, its pulse widths (us), and whether it is reversed."""

    number: int
    low: float = 1100.0
    middle: float = 1500.0
    high: float = 1900.0
    reversed: bool = False

    def share(self, widths: Array) -> Array:
        """Return the command that pulse widths (n,) stand for, -1 to 1 within the limits.

        NaN where the output is not used.
        """
        beyond = widths - self.middle
        side = np.where(beyond > 0.0, self.high - self.middle, self.middle - self.low)
        share = np.where(side > 0.0, beyond / np.where(side > 0.0, side, 1.0), 0.0)
        used = (widths > 0.0) & (widths < UNUSED)
        return np.where(used, -share if self.reversed else share, np.nan)


@dataclass(frozen=True)
class Outputs:
    """Which outputs drive the boat.

    Parameters
    ----------
    left, right : Output
        Throttles; the same one for a single throttle.
    steering : Output or None
        Rudder or drives; None for a boat that steers by its throttles.
    shaft_speed : float
        Shaft speed at full throttle, rev/s; 1 where the log counts in shares of full throttle.
    angle : float
        Full helm, rad.
    notes : tuple of str
        What was assumed.
    """

    left: Output
    right: Output
    steering: Output | None
    shaft_speed: float = 1.0
    angle: float = math.radians(FULL_ANGLE)
    notes: tuple[str, ...] = ()

    @classmethod
    def of(
        cls, parameters: Mapping[str, float], servos: Mapping[str, float], source: str
    ) -> Outputs:
        """Return the outputs that parameters and the table [servos] of a mapping name.

        Raises
        ------
        LogError
            Where they name no throttle. ``source`` is the log, for the message.
        """
        found: dict[int, int] = {}
        for number in range(HIGHEST, 0, -1):  # of several outputs of a function, the first
            value = parameters.get(f"SERVO{number}_FUNCTION", math.nan)
            if value == value:
                found[round(value)] = number
        asked = {
            name: int(servos[name]) for name in ("left", "right", "steering") if name in servos
        }
        one = found.get(THROTTLE, 0)
        left = asked.get("left", found.get(THROTTLE_LEFT, one))
        right = asked.get("right", found.get(THROTTLE_RIGHT, one))
        steering = asked.get("steering", found.get(STEERING, 0))
        if not (left and right):
            raise LogError(f"{source}: {_no_throttle(parameters, found)}")
        notes = []
        angle = servos.get("angle_deg", 0.0) or parameters.get("MOT_VEC_ANGLEMAX", 0.0)
        if not 0.0 < angle <= 180.0:
            angle = FULL_ANGLE
            if steering:
                notes.append(
                    f"full helm is taken to be {angle:g} degrees; state angle_deg in [servos] of a "
                    "mapping file"
                )
        if "shaft_speed" not in servos:
            notes.append(
                "shaft speeds are shares of full throttle; for others state shaft_speed (rev/s) in "
                "[servos] of a mapping file"
            )
        throttles = (f"left throttle {left}, right throttle {right}", f"throttle {left}")
        helm = f", steering {steering}" if steering else ""
        notes.insert(0, f"servo outputs: {throttles[left == right]}{helm}")
        return cls(
            _output(parameters, left, source),
            _output(parameters, right, source),
            _output(parameters, steering, source) if steering else None,
            servos.get("shaft_speed", 1.0),
            math.radians(angle),
            tuple(notes),
        )

    def commands(self, widths: Mapping[int, tuple[Array, Array]]) -> list[tuple[Array, dict]]:
        """Return times and commands by column from times and pulse widths by output.

        A throttle without pulses stands still; a rudder stays where it was (NaN).
        """
        made = []
        sides = {COMMANDS[0]: self.left, COMMANDS[1]: self.right}
        for name, output in sides.items():
            t, width = widths[output.number]
            share = np.nan_to_num(output.share(width), nan=0.0)
            made.append((t, {name: self.shaft_speed * share}))
        if self.steering is None:
            t = widths[self.left.number][0]
            made.append((t, dict.fromkeys(COMMANDS[2:], np.zeros(len(t)))))
        else:
            t, width = widths[self.steering.number]
            share = self.steering.share(width)
            if len(share) and np.isnan(share[0]):
                share[0] = 0.0
            made.append((t, dict.fromkeys(COMMANDS[2:], self.angle * share)))
        return made

    @property
    def names(self) -> dict[str, str]:
        """What the log calls its commands, by column."""
        unit = SHARE if self.shaft_speed == 1.0 else "rev/s"
        sides = {COMMANDS[0]: self.left, COMMANDS[1]: self.right}
        named = {key: f"servo output {side.number} ({unit})" for key, side in sides.items()}
        if self.steering is not None:
            steering = f"servo output {self.steering.number}"
            named |= dict.fromkeys(COMMANDS[2:], steering)
        return named

    @property
    def numbers(self) -> tuple[int, ...]:
        """The outputs that are needed."""
        steering = () if self.steering is None else (self.steering.number,)
        return tuple(dict.fromkeys((self.left.number, self.right.number, *steering)))


_STEERS = {"drives": "turning its thrust", "differential": "unequal thrust"}


def _output(parameters: Mapping[str, float], number: int, source: str) -> Output:
    """Return an output with its limits, those of ArduPilot where none are stated."""
    name = f"SERVO{number}"
    low, middle, high = (
        parameters.get(f"{name}_{key}", default)
        for key, default in (("MIN", 1100.0), ("TRIM", 1500.0), ("MAX", 1900.0))
    )
    if not (0.0 < low <= middle <= high < UNUSED and low < high):
        raise LogError(
            f"{source}: {name}_MIN, _TRIM, _MAX = {low:g}, {middle:g}, {high:g} us must rise, from "
            "above 0; correct the parameters of the autopilot"
        )
    return Output(number, low, middle, high, parameters.get(f"{name}_REVERSED", 0.0) == 1.0)


def _no_throttle(parameters: Mapping[str, float], found: Mapping[int, int]) -> str:
    """Return why no output is a throttle, and the remedy."""
    remedy = "name the outputs in a mapping file: [servos] with left, right and steering"
    if not any(name.startswith("SERVO") for name in parameters):
        return (
            "has no parameters SERVOx_FUNCTION, so that nobody knows its throttles; download the "
            f"parameters while recording, or {remedy}"
        )
    if any(function in found for function in MOTORS):
        return f"the motors of a frame that moves sideways are no shafts of ours; {remedy}"
    functions = ", ".join(f"{number}: {function}" for function, number in sorted(found.items())[:8])
    return (
        f"no SERVOx_FUNCTION is {THROTTLE} (throttle), or {THROTTLE_LEFT} and {THROTTLE_RIGHT} "
        f"(left and right throttle) (outputs and functions: {functions}); {remedy}"
    )


def particulars_of_parameters(
    particulars: Particulars,
    parameters: Mapping[str, float],
    servos: Mapping[str, float],
    source: str,
) -> Particulars:
    """Return particulars whose shaft speed and instruments are those of a log with its parameters.

    Parameters
    ----------
    particulars : Particulars
        Of the boat, with its shaft speed in rev/s.
    parameters : mapping of str to float
        Of the autopilot. CRUISE_THROTTLE drives the boat at CRUISE_SPEED; GPS1_POS and INS_POS1 are
        the places of antenna and IMU.
    servos : mapping of str to float
        Table [servos] of the mapping. Where it states ``shaft_speed``, the log is in rev/s too.
    source : str
        The log, for messages.

    Raises
    ------
    LogError
        If the boat steers otherwise than the outputs can.
    """
    outputs = Outputs.of(parameters, servos, source)
    fixed = particulars.steering == "differential"
    if fixed if outputs.left == outputs.right else not fixed and outputs.steering is None:
        has = "one throttle" if fixed else "no steering output"
        raise LogError(
            f"{source}: {particulars.name} steers by {_STEERS[particulars.steering]}, but the "
            f"autopilot has {has}; name the right boat, or its outputs in [servos] of a mapping"
        )
    speed, throttle = (parameters.get(f"CRUISE_{name}", 0.0) for name in ("SPEED", "THROTTLE"))
    share = 0.5  # as for a live feed: full throttle is twice the nominal shaft speed
    if speed > 0.0 and throttle > 0.0:
        # shaft speed and speed of a displacement boat rise together
        share = 0.01 * throttle * particulars.speed / speed
    places: dict[str, Any] = {}
    for field, names in (("gps_arm", ("GPS1_POS", "GPS_POS1")), ("imu_arm", ("INS_POS1",))):
        for name in names:
            place = tuple(parameters.get(f"{name}_{axis}", 0.0) for axis in "XYZ")
            if any(place) and all(map(math.isfinite, place)):
                places[field] = place
    instruments = dataclasses.replace(particulars.instruments, **places)
    shaft_speed = particulars.shaft_speed if "shaft_speed" in servos else share
    return dataclasses.replace(particulars, shaft_speed=shaft_speed, instruments=instruments)
