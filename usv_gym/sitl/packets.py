"""Packets of ArduPilot's JSON interface: pulse widths come, the motion of the boat goes back.

Source: https://ardupilot.org/dev/docs/sitl-with-JSON.html
"""

from __future__ import annotations

import json
import struct
from typing import NamedTuple

__all__ = ["Motion", "ServoPacket", "decode_servos", "encode_motion"]

_FORMATS = {18458: struct.Struct("<HHI16H"), 29569: struct.Struct("<HHI32H")}
"""Magic number -> packet: magic, frame rate, frame count, pulse widths of 16 or 32 outputs."""

_MAGIC = struct.Struct("<H")


class ServoPacket(NamedTuple):
    """What an autopilot sends for each step."""

    frame_rate: int  # Hz that it would like
    number: int  # of the packet; a repeated one has the same number
    widths: tuple[int, ...]  # pulse widths of 16 or 32 outputs, us; 0 is no output


class Motion(NamedTuple):
    """The motion of a boat, as an autopilot's sensors are made of it."""

    t: float  # s since the start
    gyro: tuple[float, float, float]  # rad/s, about the boat's axes forward, starboard, down
    force: tuple[float, float, float]  # specific force along them, m/s2; at rest (0, 0, -9.81)
    place: tuple[float, float, float]  # m north, east, down
    attitude: tuple[float, float, float]  # roll, pitch, yaw, rad
    velocity: tuple[float, float, float]  # over ground, m/s north, east, down


def decode_servos(data: bytes) -> ServoPacket | None:
    """Return the packet in a datagram; None for anything else."""
    if len(data) < _MAGIC.size:
        return None
    form = _FORMATS.get(_MAGIC.unpack_from(data)[0])
    if form is None or len(data) != form.size:
        return None
    rate, number, *widths = form.unpack(data)[1:]
    return ServoPacket(rate, number, tuple(widths))


def encode_motion(motion: Motion) -> bytes:
    """Return the answer to a packet: one line of JSON.

    ArduPilot's parser takes no blank after a colon, and loses a first line that does not begin
    with a line feed.
    """
    content = {
        "timestamp": motion.t,
        "imu": {"gyro": motion.gyro, "accel_body": motion.force},
        "position": motion.place,
        "attitude": motion.attitude,
        "velocity": motion.velocity,
    }
    text = json.dumps(content, separators=(",", ":"), allow_nan=False)
    return f"\n{text}\n".encode()
