"""What an autopilot says of itself, gathered from its MAVLink messages."""

from __future__ import annotations

from collections import deque
from typing import Any

__all__ = ["ACCEPTED", "AUTO", "HOLD", "MODES", "AutopilotPeer"]

AUTOPILOT = 1
"""Component MAV_COMP_ID_AUTOPILOT1."""

ARMED = 128
"""Flag MAV_MODE_FLAG_SAFETY_ARMED."""

MODES = {0: "Manual", 1: "Acro", 3: "Steering", 4: "Hold", 5: "Loiter", 10: "Auto", 11: "RTL"}
"""Modes of ArduPilot's Rover by number, as far as they are named in messages."""

HOLD, AUTO = 4, 10

ACCEPTED = 0
"""MAV_RESULT_ACCEPTED."""

TEXTS = 50
"""So many texts are kept."""


class AutopilotPeer:
    """The autopilot that is followed: the first one whose heartbeat comes.

    Attributes
    ----------
    system : int or None
        Its system; None before its first heartbeat.
    armed : bool
    mode : int or None
        Custom mode, see :data:`MODES`.
    origin : tuple of float or None
        Latitude and longitude of its local frame, degrees.
    results : dict of int to int
        Result of the last answer to each command that it answered.
    parameters : dict of str to float
        Parameters that it has stated.
    texts : deque of str
        What it said to the operator, the last ones.
    """

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Forget all that it said."""
        self.system: int | None = None
        self.armed = False
        self.mode: int | None = None
        self.origin: tuple[float, float] | None = None
        self.results: dict[int, int] = {}
        self.parameters: dict[str, float] = {}
        self.texts: deque[str] = deque(maxlen=TEXTS)

    @property
    def mode_name(self) -> str:
        """Name of its mode."""
        return MODES.get(-1 if self.mode is None else self.mode, f"mode {self.mode}")

    def hear(self, item: Any) -> None:
        """Take a message of pymavlink; those of others are passed over."""
        if item.get_srcComponent() != AUTOPILOT:
            return
        kind = item.get_type()
        if self.system is None and kind == "HEARTBEAT":
            self.system = item.get_srcSystem()
        if item.get_srcSystem() != self.system:
            return
        if kind == "HEARTBEAT":
            self.armed = bool(item.base_mode & ARMED)
            self.mode = int(item.custom_mode)
        elif kind == "GPS_GLOBAL_ORIGIN":
            place = item.latitude / 1e7, item.longitude / 1e7
            if any(place) and abs(place[0]) <= 90.0 and abs(place[1]) <= 180.0:
                self.origin = place
        elif kind == "COMMAND_ACK":
            self.results[int(item.command)] = int(item.result)
        elif kind == "PARAM_VALUE":
            self.parameters[str(item.param_id)] = float(item.param_value)
        elif kind == "STATUSTEXT":
            self.texts.append(str(item.text).rstrip("\0"))
