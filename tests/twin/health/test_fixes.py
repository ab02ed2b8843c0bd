"""Fixes that stand while the boat moves, and steps of the clock."""

from __future__ import annotations

import copy
import dataclasses
import math

import numpy as np
import pytest

from tests.twin.health.watching import START, base, watch, watch_fault
from twin import Twin
from twin.benchmark.sensor_faults import Rows, SensorFault
from twin.sim.bridge import particulars_of, simulate
from usv_gym import SeaState, Vessel
from usv_kernel.channels import ACCEL_X, ACCEL_Y, COMPASS, GPS_VX, GPS_VY, GPS_X, GPS_Y, GYRO

VELOCITY = (GPS_VX, GPS_VY)

NO_VELOCITY_OR_ACCELERATION = (*VELOCITY, ACCEL_X, ACCEL_Y)

VESSELS = ("usv75", "otter", "wamv16")


def stand(noise: float) -> SensorFault:
    """Return a fault in which fixes stand but for a noise, m."""

    def change(rows: Rows) -> None:
        z, before = rows.z, rows.before[: len(rows.before) - len(rows.z), GPS_X : GPS_Y + 1]
        last = before[np.isfinite(before[:, 0])][-1]
        given = np.isfinite(z[:, GPS_X])
        size = int(given.sum()), 2
        z[given, GPS_X : GPS_Y + 1] = last + noise * rows.rng.normal(size=size)

    return SensorFault("test", "", 25.0, ("gps",), change)


@pytest.mark.parametrize("noise", [0.01, 0.2])
@pytest.mark.parametrize("missing", [(), VELOCITY, NO_VELOCITY_OR_ACCELERATION])
@pytest.mark.parametrize("vessel", VESSELS)
def test_fixes_that_stand_but_for_noise_name_the_gps_and_it_comes_back(vessel, missing, noise):
    found = watch_fault(stand(noise), vessel=vessel, missing=missing, after=12.0)
    assert found.named == {"gps"}, found.findings
    # the velocity of a slow boat may give in first: then the jump at the end sets the fixes right
    slow = vessel == "otter" and missing == VELOCITY and noise == 0.2
    assert found.first("gps") < (26.0 if slow else 6.0), found.findings
    assert any("repeats itself" in f.why for f in found.findings), found.findings
    # it is not taken back meanwhile
    assert max(f.after for f in found.findings) - found.first("gps") < 3.0, found.findings
    assert "excluded" not in found.last.values(), found.last


@pytest.mark.parametrize("missing", [(), VELOCITY, NO_VELOCITY_OR_ACCELERATION])
@pytest.mark.parametrize("vessel", VESSELS)
def test_boat_that_reverses_and_lies_still_keeps_its_gps(vessel, missing):
    boat, n = Vessel.load(vessel), particulars_of(Vessel.load(vessel)).shaft_speed
    t = np.arange(0.0, 120.0, 0.05)
    cmd = np.zeros((len(t), 4))
    phase = t % 60.0
    cmd[:, :2] = np.where(phase < 30.0, n, np.where(phase < 36.0, -n, 0.0))[:, None]
    sea = SeaState(hs=0.05, wind=4.5, current=0.2)
    log = simulate(cmd, vessel=boat, sea=sea, duration=120.0, seed=1)
    log.z[:, list(missing)] = np.nan
    twin = Twin(particulars_of(boat), "ukf")
    twin.run(log)
    assert not [note for note in twin.notes if note.startswith("gps excluded")], twin.notes


@pytest.mark.parametrize("seconds", [10.0, 20.0])
@pytest.mark.parametrize("vessel", VESSELS)
def test_frozen_fixes_that_catch_up_slowly_are_not_used_on_the_way(vessel, seconds):
    log, twin, first = base("zigzag", vessel, VELOCITY)
    assert log.truth is not None
    share = np.interp(log.t, [START + 25.0, START + 25.0 + seconds], [1.0, 0.0])
    share[log.t < START] = 0.0
    held = log.truth[np.searchsorted(log.t, START), :2]
    moved = dataclasses.replace(log, z=log.z.copy())
    moved.z[:, GPS_X : GPS_Y + 1] += share[:, None] * (held - log.truth[:, :2])
    twin, used = copy.deepcopy(twin), []
    for row in range(first, len(log)):
        twin.step(log.t[row], moved.z[row], log.cmd[row])
        found = twin.estimate()
        error = math.dist(found.state[:2], log.truth[row, :2])
        if twin.health["gps"].status == "ok" and log.t[row] > START + 8.0:
            used.append(error - 4.0 * math.hypot(*found.sd[:2]))
    assert max(used) < 5.0
    assert twin.health["gps"].status == "ok"


@pytest.mark.parametrize("tau", [0.5, 1.0, 2.0])
@pytest.mark.parametrize("vessel", VESSELS)
def test_boat_that_hits_something_keeps_its_gps(vessel, tau):
    """Its thrust goes on, and nothing measures its velocity."""
    log, twin, first = base("straight", vessel, VELOCITY)
    assert log.truth is not None
    at, rng = int(np.searchsorted(log.t, START)), np.random.default_rng(1)
    x, y, psi, u = log.truth[at, :4]
    left = np.exp(-(log.t[at:] - START) / tau)
    z, cmd = log.z.copy(), log.cmd.copy()
    seen, n = np.isfinite(z[at:, GPS_X]), len(left)
    z[at:, GPS_X] = x + u * math.cos(psi) * tau * (1.0 - left) + 0.3 * rng.normal(size=n)
    z[at:, GPS_Y] = y + u * math.sin(psi) * tau * (1.0 - left) + 0.3 * rng.normal(size=n)
    z[at:][~seen, GPS_X : GPS_Y + 1] = np.nan
    z[at:, COMPASS], z[at:, GYRO] = psi + 0.01 * rng.normal(size=n), 0.003 * rng.normal(size=n)
    z[at:, ACCEL_X] = -u / tau * left + 0.05 * rng.normal(size=n)
    z[at:, ACCEL_Y] = 0.05 * rng.normal(size=n)
    cmd[at:] = cmd[at]
    found = watch(copy.deepcopy(twin), dataclasses.replace(log, z=z, cmd=cmd), first)
    assert "gps" not in found.named, found.findings


@pytest.mark.parametrize("seconds", [2.5, 5.0])
def test_rare_fixes_accuse_no_accelerometers(seconds):
    log, twin, first = base("random", "usv75", VELOCITY)
    z, due = log.z.copy(), -1.0
    for row in np.flatnonzero(np.isfinite(z[:, GPS_X])):
        if log.t[row] < due:
            z[row, GPS_X : GPS_Y + 1] = np.nan
        else:
            due = log.t[row] + seconds
    found = watch(copy.deepcopy(twin), dataclasses.replace(log, z=z), first)
    assert "accelerometers" not in found.named, found.findings


@pytest.mark.parametrize("seconds", [1.0, 3.0, 10.0])
@pytest.mark.parametrize("vessel", VESSELS)
def test_step_of_the_clock_blames_no_sensor(vessel, seconds):
    log, twin, first = base("zigzag", vessel)
    later = log.t + np.where(log.t >= START, seconds, 0.0)
    found = watch(copy.deepcopy(twin), dataclasses.replace(log, t=later), first)
    assert not found.findings


@pytest.mark.parametrize("seconds", [3.0, 10.0])
@pytest.mark.parametrize("start", [START, START + 5.0])
def test_missing_rows_blame_no_sensor(start, seconds):
    log, twin, first = base("zigzag")
    kept = (log.t < start) | (log.t >= start + seconds)
    columns = {name: getattr(log, name)[kept] for name in ("t", "z", "cmd", "truth")}
    found = watch(copy.deepcopy(twin), dataclasses.replace(log, **columns), first)
    assert not found.findings
