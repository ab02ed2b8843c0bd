"""What a twin notes of sensors that were in doubt."""

import re

import numpy as np
import pytest

from twin import Log, Twin
from twin.integrity.history import CHANGES_KEPT, HealthHistory
from twin.integrity.monitor import SensorMonitor, SensorStatus
from twin.integrity.state import (
    ABSENT,
    CONTRADICTS,
    EXCLUDED,
    OK,
    SENSORS,
    initial_integrity,
)
from twin.sim.bridge import particulars_of, simulate
from usv_gym import Fault, SeaState, Vessel

PARTICULARS = particulars_of(Vessel.load("usv75"))


def history_of(changes) -> HealthHistory:
    """Return the history of rows every second in which one sensor changes its status."""
    monitor = SensorMonitor(initial_integrity(PARTICULARS))
    history = HealthHistory(monitor)
    for t in range(10):
        for sensor, status, reason in changes.get(t, ()):
            check = monitor.record["sensors"][SENSORS.index(sensor)]
            check["status"], check["reason"], check["since"] = status, reason, t
        history.take(100.0 + t, 100.0, {})
    return history


def test_each_stretch_of_a_bad_status_leaves_one_line_with_its_reason():
    history = history_of(
        {
            0: [("compass", OK, 0.0), ("gps", OK, 0.0)],
            3: [("compass", EXCLUDED, CONTRADICTS), ("gyro", OK, 0.0)],
            5: [("gps", ABSENT, 0.0)],
            7: [("compass", OK, 0.0)],
        }
    )
    assert history.lines() == (
        "compass excluded from 103.0 to 107.0 s: contradicts the other sensors",
        "gps absent from 105.0 s on",
    )


def test_channel_that_goes_from_one_trouble_to_another_leaves_two_lines():
    troubles = {}
    history = HealthHistory(SensorMonitor(initial_integrity(PARTICULARS)))
    for t in range(10):
        status = "excluded" if t < 6 else "absent"
        troubles = {"wind": SensorStatus(status, t, f"wind is {status}")} if t > 2 else {}
        history.take(float(t), 0.0, troubles)
    assert [line.split(" from")[0] for line in history.lines()] == ["wind excluded", "wind absent"]


def test_status_at_a_time_is_that_of_the_row_before_it():
    history = history_of({2: [("gyro", OK, 0.0)], 4: [("gyro", EXCLUDED, CONTRADICTS)]})
    assert history.at(99.9) == {}
    assert [history.at(t)["gyro"].status for t in (100.0, 102.0, 103.99, 104.0, 200.0)] == [
        *("absent", "ok", "ok", "excluded", "excluded")
    ]
    assert history.at(150.0)["gyro"].since == 104.0


def test_a_sensor_that_comes_and_goes_does_not_fill_the_memory():
    monitor = SensorMonitor(initial_integrity(PARTICULARS))
    history = HealthHistory(monitor)
    for t in range(2 * CHANGES_KEPT):
        monitor.record["sensors"]["status"] = OK if t % 2 else ABSENT
        history.take(float(t), 0.0, {})
    assert 0 < len(history.lines()) <= len(SENSORS) * CHANGES_KEPT / 2
    assert history.at(2.0 * CHANGES_KEPT)["gps"].status == "ok"


@pytest.fixture(scope="module")
def log() -> Log:
    sea, faults = SeaState.named("2"), (Fault("gps", 30.0, 8.0),)
    vessel = Vessel.load("usv75")
    log = simulate("zigzag", vessel=vessel, sea=sea, duration=50.0, seed=3, faults=faults)
    frozen = (log.t >= 10.0) & (log.t < 20.0)
    z = log.z.copy()
    z[frozen, 5] = z[np.flatnonzero(frozen)[0], 5]
    return Log(log.t, z, log.cmd, None, "frozen")


def test_a_run_over_a_log_leaves_lines_that_name_the_culprit(log):
    twin = Twin(PARTICULARS, "ukf")
    twin.run(log)
    assert [line for line in twin.notes if line.startswith("gyro excluded from 1")]
    absent = r"gps absent from (29\.9|30\.0) to 38\.[0-2] s: has gone silent"
    assert [line for line in twin.notes if re.fullmatch(absent, line)]
    assert all(" from " in line and len(line) < 100 for line in twin.notes)
    other = Twin(PARTICULARS, "ukf")
    for row in log:
        other.step(*row)
    assert other.notes == twin.notes
    other.reset()
    assert other.notes == ()
