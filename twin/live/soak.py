"""A day of a feed: what a simulated boat says over a poor link, hour after hour, and its twin."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from twin.benchmark.soak import inspect_twin, resident_memory
from twin.channels import MEASUREMENTS
from twin.digital_twin import Twin
from twin.live.protocols.nmea import NmeaFeed
from twin.live.protocols.replay import LinkImpairment, NmeaStream, schedule
from twin.logs.log import Log
from twin.sim.bridge import CONTROL_STEP, TRUE_STATE, measurement_row, particulars_of
from usv_gym.vessel.vessel import Vessel
from usv_gym.world.faults import parse_faults
from usv_gym.world.simulation import Simulation

__all__ = ["FeedSoak", "soak_feed"]

PIECE = 300.0
"""Length of the pieces in which the boat is simulated, s."""

EVERY = 20
"""Rows between two forecasts and answers."""

LINK = LinkImpairment(late=0.02, doubled=0.02, swapped=0.02, broken=0.02)
"""Share of the datagrams that each thing happens to."""

ORIGIN = 63.43, 10.4
"""Latitude and longitude of the start, degrees."""


START = 1.7e9
"""UNIX time of the start, s."""


class FeedSoak(NamedTuple):
    """What a feed and its twin did."""

    hours: float
    datagrams: int
    rows: int
    crashes: int
    not_finite: int
    not_definite: int
    error: float  # median error of the estimated position, m
    pace: float  # seconds of the stream in one second
    growth: float  # of the memory, MB


def soak_feed(
    hours: float, seed: int, progress: Callable[[float], None] = lambda done: None
) -> FeedSoak:
    """Let a boat with all faults send NMEA over a poor link for hours, and twin it with ``ukf``.

    ``progress`` is called with the hours that are done.
    """
    boat, rng = Vessel.load("usv75"), np.random.default_rng(seed)
    simulation = Simulation(1, boat, "2", faults=parse_faults("on", 0.0))
    simulation.reset([0], rng.spawn(1))
    particulars = particulars_of(boat)
    twin = Twin(particulars, "ukf", seed=seed)
    counts = dict.fromkeys(("crashes", "not_finite", "not_definite"), 0)
    errors: list[float] = []
    now, datagrams, rows, done = 0.0, 0, 0, 0.0
    begun, memory = time.perf_counter(), math.nan
    with NmeaFeed(None, particulars, clock=lambda: now) as feed:
        while done < 3600.0 * hours:
            log = _piece(simulation, boat, rng)
            stream = NmeaStream(ORIGIN, START)
            for datagram in schedule(log, stream, disturb=LINK, seed=int(rng.integers(2**31))):
                now, datagrams = max(now, datagram.due), datagrams + 1
                try:
                    feed.receive(datagram.data, now, ("127.0.0.1", 9))
                    for t, z, cmd in feed.take():
                        twin.step(t, z, cmd)
                        rows += 1
                        if rows % EVERY == 0:
                            inspect_twin(twin, counts)
                            feed.send(twin.estimate(), twin.predict("hold"), twin.health)
                            # rows count from the first one, a step after the start
                            k = round((t + CONTROL_STEP - log.t[0]) / CONTROL_STEP)
                            if 0 <= k < len(log) and log.truth is not None:
                                off = twin.estimate().state[:2] - log.truth[k, :2]
                                errors.append(float(np.hypot(*off)))
                except Exception:  # whatever it is, it is counted
                    counts["crashes"] += 1
            done += PIECE
            progress(done / 3600.0)
            memory = resident_memory() if math.isnan(memory) else memory
    pace, growth = done / (time.perf_counter() - begun), resident_memory() - memory
    error = float(np.median(errors))
    return FeedSoak(hours, datagrams, rows, **counts, error=error, pace=pace, growth=growth)


def _piece(simulation: Simulation, boat: Vessel, rng: np.random.Generator) -> Log:
    """Sail on under random commands, and return the log of this piece."""
    steps = round(PIECE / CONTROL_STEP)
    t, cmd = np.empty(steps), np.empty((steps, 4))
    z, truth = np.empty((steps, len(MEASUREMENTS))), np.empty((steps, 6))
    for k in range(steps):
        if k % 200 == 0:
            n = boat.values["shaft_speed_manoeuvring"] * rng.uniform(0.5, 1.3)
            command = boat.command(n, boat.helm_max * rng.uniform(-1.0, 1.0))[None]
        simulation.step(command)
        t[k], cmd[k] = simulation.t[0], command[0]
        z[k] = measurement_row(simulation.z[0])
        truth[k] = simulation.state[0, TRUE_STATE]
    return Log(t=t, z=z, cmd=cmd, truth=truth, name="soak")
