"""Without GPS, accelerometers and commands are held against each other."""

from __future__ import annotations

import copy
import math

import numpy as np
import pytest

from tests.twin.health.watching import START, base, watch
from twin import Twin
from twin.benchmark.sensor_faults import Rows, SensorFault, inject
from twin.sim.bridge import particulars_of
from usv_gym import Vessel
from usv_kernel.channels import ACCEL_X, GPS_VY


def fault(change, seconds: float) -> SensorFault:
    return SensorFault("test", "", seconds, (), change)


@pytest.mark.parametrize("vessel", ["usv75", "otter", "wamv16"])
@pytest.mark.parametrize("manoeuvre", ["zigzag", "random"])
@pytest.mark.parametrize("bias", [-1.0, 0.0, 1.0])
def test_without_gps_the_commands_name_the_accelerometers(bias, manoeuvre, vessel):
    """No boat goes on accelerating; and what it errs stays below what the bias would make."""

    def change(rows: Rows) -> None:
        rows.z[:, : GPS_VY + 1] = math.nan
        rows.z[rows.since > 10.0, ACCEL_X] += bias

    log, twin, first = base(manoeuvre, vessel)
    start = START + 35.0  # thrust and drag are then known
    faulty = inject(log, fault(change, 40.0), start, seed=1)
    twin, end = copy.deepcopy(twin), int(np.searchsorted(log.t, start + 40.0))
    found = watch(twin, faulty, first, end)
    if bias == 0.0:
        assert not found.named
        return
    assert found.named == {"accelerometers"}, found.findings
    assert 45.0 < found.first("accelerometers") < 52.0, found.findings
    assert log.truth is not None
    # without the way taken back, a bias makes 30 m; without the check, over 100
    assert math.dist(twin.estimate().state[:2], log.truth[end - 1, :2]) < 10.0
    assert set(watch(twin, faulty, end).last.values()) == {"ok"}


@pytest.mark.parametrize("vessel", ["usv75", "otter"])
def test_without_gps_reversed_commands_are_not_blamed_on_the_accelerometers(vessel):
    """What is measured goes on as before; what is expected changed."""

    def change(rows: Rows) -> None:
        rows.z[:, : GPS_VY + 1] = math.nan
        rows.cmd[rows.since > 10.0] *= -1.0

    log, twin, first = base("zigzag", vessel)
    start = START + 35.0
    faulty = inject(log, fault(change, 30.0), start, seed=1)
    twin, end = copy.deepcopy(twin), int(np.searchsorted(log.t, start + 30.0))
    found = watch(twin, faulty, first, end)
    assert found.named == {"commands"}, found.findings
    assert 45.0 < found.first("commands") < 51.0, found.findings
    # they are right again, and the fixes say so
    assert set(watch(twin, faulty, end).last.values()) == {"ok"}


def test_predictors_from_a_history_take_the_bias_back_too():
    log, _, _ = base("zigzag")
    z, late = log.z.copy(), log.t > START + 35.0
    z[late, : GPS_VY + 1] = math.nan
    z[log.t > START + 45.0, ACCEL_X] += 1.0
    twin = Twin(particulars_of(Vessel.load("usv75")), "persistence")
    end = int(np.searchsorted(log.t, START + 70.0))
    for row in range(end):
        twin.step(log.t[row], z[row], log.cmd[row])
    assert twin.health["accelerometers"].status == "excluded"
    assert log.truth is not None
    # the bias alone would make 300 m
    assert math.dist(twin.estimate().state[:2], log.truth[end - 1, :2]) < 60.0
