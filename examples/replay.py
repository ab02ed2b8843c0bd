"""Send a log as the live stream of a boat: for ``usv-twin view --nmea`` or ``--mavlink``.

``python examples/replay.py run.csv --nmea udp://:10110 --speed 5`` sends NMEA 0183 to this machine,
``--mavlink udp://:14550`` MAVLink 2. Without a log it is the recorded run, a hundred times as fast.
"""

from __future__ import annotations

import argparse
from collections import Counter

from twin import Log, recorded_runs
from twin.live.protocols.mavlink import Servos
from twin.live.protocols.replay import (
    ORIGIN,
    MavlinkStream,
    NmeaStream,
    Stream,
    replay,
)
from twin.sim.recorded import particulars_for_log


def main(arguments: list[str] | None = None) -> None:
    """Send a log."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("log", nargs="?", default=str(recorded_runs()["boat1_usv_circle"]))
    parser.add_argument("--nmea", metavar="udp://HOST:PORT", help="send NMEA 0183")
    parser.add_argument("--mavlink", metavar="udp://HOST:PORT", help="send MAVLink 2")
    parser.add_argument("--ship", help="boat whose full throttle scales MAVLink's servo outputs")
    parser.add_argument("--speed", type=float, help="factor on the speed of time")
    parser.add_argument("--loop", action="store_true", help="start over at the end, for ever")
    given = parser.parse_args(arguments)
    log = Log.read(given.log)
    plane = None if log.datum is None else log.datum.plane
    place = ORIGIN if plane is None else (plane.latitude, plane.longitude)
    if given.mavlink:
        boat = particulars_for_log(given.log, given.ship)
        stream: Stream = MavlinkStream(Servos.of(boat), place)
    else:
        stream = NmeaStream(place)
    target = given.mavlink or given.nmea or "udp://:10110"
    speed = given.speed or (1.0 if given.mavlink or given.nmea else 100.0)
    counts: Counter[str] = Counter()
    print(f"sending {log.name} to {target}, {speed:g} times as fast")
    try:
        replay(log, stream, target, speed=speed, loop=given.loop, counts=counts)
    except KeyboardInterrupt:
        print("stopped: the rest is not sent")
    print("sent:", ", ".join(f"{count} {name}" for name, count in counts.items() if count))


if __name__ == "__main__":
    main()
