"""Servo outputs of an autopilot: what their pulse widths command; simulator and twin agree here."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

from usv_kernel.errors import UsvTwinError

__all__ = ["ServoError", "Servos"]

OUTPUT_COMMANDS = ("n_left_rps", "n_right_rps", "delta_left_rad", "delta_right_rad")
"""Commands of a boat: shaft speeds, rev/s, and angles of drives or rudders, rad."""

OUTPUTS = 16
"""Outputs that may be commands: those of one SERVO_OUTPUT_RAW."""

UNUSED = 2**16 - 1
"""Pulse width of an unused output, us."""

FULL_SHAFT = 2.0
FULL_ANGLE = math.radians(30.0)
"""Full throttle, in nominal shaft speeds, and full helm, rad, where neither is given."""


class ServoError(UsvTwinError):
    """Outputs that there are not, or a scale without a width; the message names the remedy."""


class _Boat(Protocol):
    """What the default outputs depend on."""

    @property
    def shaft_speed(self) -> float: ...

    @property
    def steering(self) -> str: ...


@dataclass(frozen=True, kw_only=True)
class Servos:
    """Which servo outputs are the commands, and what they stand for.

    Notes
    -----
    The outputs are by default those of ArduPilot's Rover, of 1100, 1500 and 1900 us: steering 1 and
    throttle 3. For skid steering, they are left throttle 1 and right throttle 3.
    Source: https://ardupilot.org/rover/docs/rover-motor-and-servo-configuration.html
    """

    # at full throttle ahead, rev/s, and at full helm to starboard, rad
    shaft_speed: float
    angle: float
    # outputs of the throttles, from 1; the same one for a single throttle
    left: int = 3
    right: int = 3
    steering: int = 1  # output of rudder or drives; 0 for a boat that steers by its throttles
    # pulse widths full astern or to port, at rest, and full ahead or to starboard, us
    low: float = 1100.0
    middle: float = 1500.0
    high: float = 1900.0

    def __post_init__(self) -> None:
        """Refuse outputs that there are not, and a scale without a width."""
        for name, least in (("left", 1), ("right", 1), ("steering", 0)):
            value = getattr(self, name)
            if not least <= value <= OUTPUTS:
                raise ServoError(
                    f"servos: {name} = {value} must be an output from {least} to {OUTPUTS}"
                )
        if not 0.0 < self.low < self.middle < self.high < 65535.0:
            raise ServoError(
                f"servos: low, middle, high = {self.low:g}, {self.middle:g}, {self.high:g} us "
                "must rise, from above 0"
            )
        for name in ("shaft_speed", "angle"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise ServoError(f"servos: {name} = {value} must be finite and above 0")

    @classmethod
    def of(
        cls,
        particulars: _Boat,
        shaft_speed: float | None = None,
        angle: float | None = None,
    ) -> Servos:
        """Return the default outputs of a boat.

        ``shaft_speed`` at full throttle (rev/s) is twice the nominal one if left out, ``angle``,
        the full helm (rad), 30 degrees.
        """
        if shaft_speed is None:
            shaft_speed = FULL_SHAFT * particulars.shaft_speed
        skid = {"left": 1, "right": 3, "steering": 0}
        return cls(
            shaft_speed=shaft_speed,
            angle=FULL_ANGLE if angle is None else angle,
            **(skid if particulars.steering == "differential" else {}),
        )

    @property
    def outputs(self) -> tuple[tuple[str, int, float], ...]:
        """Column of a log, output and full value of each command that has an output."""
        throttles = ((self.left, self.shaft_speed), (self.right, self.shaft_speed))
        all_four = (*throttles, (self.steering, self.angle), (self.steering, self.angle))
        return tuple(
            (name, output, full)
            for name, (output, full) in zip(OUTPUT_COMMANDS, all_four, strict=True)
            if output
        )

    def commands(self, widths: Sequence[int]) -> dict[str, float]:
        """Return the commands of pulse widths, us; 0 and 65535 are outputs that are not used."""
        return {
            name: full * self._share(widths[output - 1])
            for name, output, full in self.outputs
            if output <= len(widths) and 0 < widths[output - 1] < UNUSED
        }

    def command(self, widths: Sequence[int]) -> list[float]:
        """Return all four commands of pulse widths, us; 0 where an output is not used."""
        known = self.commands(widths)
        return [known.get(name, 0.0) for name in OUTPUT_COMMANDS]

    def drives(self, widths: Sequence[int], dead: float = 10.0) -> bool:
        """Return whether all throttles have a pulse, and one is over ``dead`` us from its rest.

        An autopilot that starts gives pulses before it knows its outputs. ArduRover begins with
        1000 us at output 1 and none at the others, for two hundredths of a second.
        """
        throttles = [widths[k - 1] for k in (self.left, self.right) if k <= len(widths)]
        pulses = all(0 < width < UNUSED for width in throttles)
        return pulses and any(abs(width - self.middle) > dead for width in throttles)

    def widths(self, cmd: Iterable[float]) -> list[int]:
        """Return the pulse widths, us, of 16 outputs for a command; of two sides, their mean."""
        values = dict(zip(OUTPUT_COMMANDS, map(float, cmd), strict=True))
        found: dict[int, list[float]] = {}
        for name, output, full in self.outputs:
            found.setdefault(output, []).append(values[name] / full)
        widths = [0] * OUTPUTS
        for output, shares in found.items():
            share = sum(shares) / len(shares)
            side = self.high - self.middle if share > 0.0 else self.middle - self.low
            widths[output - 1] = min(max(round(self.middle + share * side), 1), 65534)
        return widths

    def _share(self, width: float) -> float:
        beyond = width - self.middle
        return beyond / (self.high - self.middle if beyond > 0.0 else self.middle - self.low)
