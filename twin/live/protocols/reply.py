"""The twin's estimate as sentences of NMEA 0183 over UDP.

They go out under the talker U9, as NMEA 0183 leaves U0 to U9 to users: GGA of quality 6
(estimated), RMC of mode E, HDT and ROT.
"""

from __future__ import annotations

import contextlib
import math
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np

from twin.channels import PSI, R, X, Y
from twin.logs.datum import Plane
from twin.logs.wire.feed import velocity_over_ground
from twin.logs.wire.nmea import DAY, KNOT, OWN
from twin.logs.wire.sockets import needed, open_socket
from twin.predictors.base import Estimate

__all__ = ["NmeaReply"]


class NmeaReply:
    """Sends the twin's estimate to ``udp://HOST:PORT``."""

    def __init__(self, address: str) -> None:
        self._library = needed("pynmeagps")
        self._socket, self._target = open_socket(address, bind=False)

    def send(self, plane: Plane, stamp: float, estimate: Estimate) -> None:
        """Send an estimate at a time of day, s; nothing goes out before it is ready."""
        if estimate.ready and np.isfinite(estimate.state).all():
            with contextlib.suppress(OSError):  # nobody listens there, or the line is full
                self._socket.sendto(self.encode(plane, stamp, estimate), self._target)

    def encode(self, plane: Plane, stamp: float, estimate: Estimate) -> bytes:
        """Return the datagram of an estimate."""
        state = estimate.state
        latitude, longitude = map(float, plane.degrees(state[X], state[Y]))
        north, east = velocity_over_ground(state)
        moment = (datetime.min + timedelta(seconds=stamp % DAY)).time()
        place: dict[str, Any] = {"time": moment, "lat": latitude, "lon": longitude}
        motion = {
            "spd": round(math.hypot(north, east) / KNOT, 4),
            "cog": round(math.degrees(math.atan2(east, north)) % 360.0, 3) % 360.0,
        }
        today = {"date": datetime.now(UTC).date(), "mv": "", "status": "A", "posMode": "E"}
        heading = round(math.degrees(state[PSI]) % 360.0, 4) % 360.0
        rate = round(60.0 * math.degrees(state[R]), 4)
        unknown = {"numSV": "", "HDOP": "", "alt": "", "sep": "", "diffStation": ""}
        sentences = {
            "GGA": {**place, "quality": 6, **unknown},
            "RMC": {**place, **motion, **today},
            "HDT": {"headingT": heading, "headingTu": "T"},
            "ROT": {"rot": rate, "valid": "A"},
        }
        made = self._library.NMEAMessage
        return b"".join(
            made(OWN, kind, 0, hpnmeamode=1, **fields).serialize()
            for kind, fields in sentences.items()
        )

    def close(self) -> None:
        """Let go of the socket."""
        self._socket.close()
