"""Runs of a boat with faults, and what its twin's health says of them."""

from __future__ import annotations

import copy
import functools
from typing import NamedTuple

import numpy as np
from twin.health.state import SENSORS, STATUSES

from twin import Twin
from twin.benchmark.sensor_faults import SensorFault, inject
from twin.logs.log import Log
from twin.sim.bridge import particulars_of, simulate
from usv_gym import SeaState, Vessel

START = 60.0
"""When faults begin, s: the levels are then learned."""

END = 160.0

MANOEUVRES = ("zigzag", "random", "turn-zigzag")

IN_USE = tuple(STATUSES.index(status) for status in ("absent", "ok"))


class Finding(NamedTuple):
    """What was said of a sensor."""

    after: float  # s since the fault began
    sensor: str
    status: str
    why: str


class Watch(NamedTuple):
    """What was said during a run, and at its end."""

    findings: tuple[Finding, ...]
    last: dict[str, str]

    @property
    def named(self) -> set[str]:
        return {finding.sensor for finding in self.findings if finding.status == "excluded"}

    @property
    def mentioned(self) -> set[str]:
        return {finding.sensor for finding in self.findings}

    def first(self, sensor: str) -> float:
        """Return when a sensor was first mentioned, s after the fault began."""
        return min((f.after for f in self.findings if f.sensor == sensor), default=np.inf)


@functools.cache
def base(
    manoeuvre: str, vessel: str = "usv75", missing: tuple[int, ...] = ()
) -> tuple[Log, Twin, int]:
    """Return a run without fault, a twin that has seen its first minute, and its next row.

    The boat has no sensor for the channels that are missing.
    """
    boat = Vessel.load(vessel)
    sea = SeaState(hs=0.5 if vessel == "usv75" else 0.05, wind=4.5)
    log = simulate(manoeuvre, vessel=boat, sea=sea, duration=END, seed=7)
    log.z[:, list(missing)] = np.nan
    twin = Twin(particulars_of(boat), "ukf")
    first = int(np.searchsorted(log.t, START - 1.0))
    for row in range(first):
        twin.step(log.t[row], log.z[row], log.cmd[row])
    return log, twin, first


def watch(twin: Twin, log: Log, first: int, last: int | None = None) -> Watch:
    """Feed rows of a log to a twin; return when each doubt or exclusion, or its reason, begins."""
    findings: list[Finding] = []
    before = twin.monitor.record["sensors"][["status", "reason"]].copy()
    for row in range(first, len(log) if last is None else last):
        twin.step(log.t[row], log.z[row], log.cmd[row])
        now = twin.monitor.record["sensors"][["status", "reason"]]
        for k in np.flatnonzero(now != before):
            if now["status"][k] not in IN_USE:
                status = twin.health[SENSORS[k]]
                after = float(log.t[row]) - START
                findings.append(Finding(after, SENSORS[k], status.status, status.why))
        before = now.copy()
    return Watch(tuple(findings), {name: twin.health[name].status for name in SENSORS})


def watch_fault(
    fault: SensorFault,
    manoeuvre: str = "zigzag",
    vessel: str = "usv75",
    start: float = START,
    after: float = 15.0,
    missing: tuple[int, ...] = (),
) -> Watch:
    """Return what is said of a fault, from its beginning until some time after its end, s."""
    log, twin, first = base(manoeuvre, vessel, missing)
    end = np.searchsorted(log.t, start + fault.seconds + after)
    faulty = inject(log, fault, start, seed=1)
    return watch(copy.deepcopy(twin), faulty, first, int(end))
