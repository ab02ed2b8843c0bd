"""The monitor is silent in clean runs, is saved and loaded, and survives any numbers."""

from __future__ import annotations

import copy

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from tests.twin.health.watching import MANOEUVRES, START, base, watch, watch_fault
from twin import Twin
from twin.benchmark.sensor_faults import SENSOR_FAULTS, inject
from twin.health.monitor import SensorStatus
from twin.sim.bridge import particulars_of, simulate
from usv_gym import SeaState, SensorSuite, Vessel

HS = (0.0, 0.1, 0.3, 0.88, 1.88)
"""Significant wave heights of sea states 0 to 4, m."""


def clean_run(vessel: str, sea: int, seed: int, duration: float, **options):
    """Return what is said of a run without fault."""
    boat, suite = Vessel.load(vessel), options.pop("suite", None)
    dof = options.pop("dof", 3)
    hs = HS[sea] * (0.3 if vessel == "otter" else 1.0)
    log = simulate(
        options.pop("manoeuvre", "zigzag"),
        vessel=boat,
        sea=SeaState(hs=hs, wind=2.0 + 3.0 * sea),
        duration=duration,
        seed=seed,
        suite=suite,
        dof=dof,
    )
    return watch(Twin(particulars_of(boat, suite, dof), "ukf"), log, 0)


@pytest.mark.parametrize("sea", range(5))
@pytest.mark.parametrize("vessel", ["usv75", "otter"])
def test_clean_run_raises_nothing(vessel, sea):
    manoeuvre = ("zigzag", "turn", "random", "straight", "turn-zigzag")[sea]
    assert not clean_run(vessel, sea, sea, 150.0, manoeuvre=manoeuvre).findings


@pytest.mark.parametrize("dof", [3, 6])
def test_clean_run_with_coarse_sensors_raises_nothing(dof):
    suite = SensorSuite(gps_rate=1.0, gps_latency=0.3, compass_rate=5.0, imu_rate=10.0)
    assert not clean_run("usv75", 2, 3, 150.0, suite=suite, dof=dof).findings


@pytest.mark.slow
@pytest.mark.parametrize("sea", range(5))
@pytest.mark.parametrize("vessel", ["usv75", "otter"])
def test_long_clean_run_raises_nothing(vessel, sea):
    assert not clean_run(vessel, sea, 100 + sea, 1800.0, manoeuvre="random").findings


@pytest.mark.parametrize("name", ["compass-turned", "gps-jump", "commands-reversed", "gyro-bias"])
def test_saved_twin_goes_on_to_the_bit(tmp_path, name):
    """The file is written in the middle of a fault."""
    log, twin, first = base("zigzag")
    twin, faulty = copy.deepcopy(twin), inject(log, SENSOR_FAULTS[name], START, 1)
    middle, end = np.searchsorted(faulty.t, [START + 6.0, START + 40.0])
    watch(twin, faulty, first, int(middle))
    assert "excluded" in {item.status for item in twin.health.values()}
    twin.save(tmp_path / "boat.twin")
    other = Twin.load(tmp_path / "boat.twin")
    assert other.health == twin.health
    watch(twin, faulty, int(middle), int(end))
    watch(other, faulty, int(middle), int(end))
    np.testing.assert_array_equal(other.monitor.memory, twin.monitor.memory)
    np.testing.assert_array_equal(other.estimate().state, twin.estimate().state)
    sensors = {"gps", "compass", "gyro", "accelerometers", "commands"}
    assert set(twin.health) == sensors | {"navigation"}


def test_a_status_prints_as_words():
    status = SensorStatus("excluded", 88.42599987983704, "gps jumped")
    assert str(status) == "excluded since 88.4 s: gps jumped"
    assert f"{SensorStatus('ok', 0.0, '')}" == "ok since 0.0 s"
    assert str(SensorStatus("absent", np.nan, "")) == "absent"
    assert str(base("zigzag")[1].health["navigation"]) == "ok since 0.0 s"


def test_reset_monitor_knows_nothing():
    log, twin = base("zigzag")[:2]
    twin = copy.deepcopy(twin)
    twin.reset()
    fresh = Twin(twin.particulars, "ukf")
    for row in range(200):
        for one in (twin, fresh):
            one.step(log.t[row], log.z[row], log.cmd[row])
    np.testing.assert_array_equal(twin.monitor.memory, fresh.monitor.memory)


def test_status_says_since_when_and_why():
    found = watch_fault(SENSOR_FAULTS["gps-jump"], start=START, after=-5.0)
    assert found.last["gps"] == "excluded"
    log, twin, first = base("zigzag")
    twin, faulty = copy.deepcopy(twin), inject(log, SENSOR_FAULTS["gps-jump"], START, 1)
    watch(twin, faulty, first, int(np.searchsorted(faulty.t, START + 5.0)))
    status = twin.health["gps"]
    assert status.status == "excluded"
    assert status.since == pytest.approx(START, abs=0.06)
    assert status.why == "gps jumped"
    assert twin.health["compass"].why == ""


numbers = st.one_of(
    st.floats(width=64),
    st.floats(-10.0, 10.0),
    st.sampled_from((0.0, 1e-300, 1e300, -1e300, np.nan, np.inf, -np.inf)),
)


@settings(max_examples=60, derandomize=True)
@given(
    arrays(float, (12, 10), elements=numbers),
    arrays(float, (12, 4), elements=numbers),
    arrays(float, (12, 6), elements=numbers),
    st.lists(st.sampled_from((1e-9, 0.01, 0.05, 1.0, 100.0, 1e6)), min_size=12, max_size=12),
    st.sampled_from(MANOEUVRES),
)
def test_memory_stays_finite_under_any_rows(z, cmd, state, steps, manoeuvre):
    monitor = copy.deepcopy(base(manoeuvre)[1].monitor)
    for _ in range(8):
        for row, dt in enumerate(steps):
            out = monitor.check(dt, z[row], cmd[row], state[row], True)[0]
            assert not np.isinf(out[:8]).any()
    for name, view in monitor.views().items():
        assert not np.isinf(view).any(), name
    monitor.load_state_dict(monitor.state_dict())


@settings(max_examples=10, derandomize=True)
@given(st.integers(0, 2**32), st.sampled_from(MANOEUVRES))
def test_boat_recovers_from_any_rows(seed, manoeuvre):
    """After 10 s of garbage all sensors are in use again."""
    log, twin, first = base(manoeuvre)
    twin = copy.deepcopy(twin)
    faulty = inject(log, SENSOR_FAULTS["garbage"], START, seed)
    found = watch(twin, faulty, first, int(np.searchsorted(log.t, START + 35.0)))
    assert set(found.last.values()) == {"ok"}
    assert (
        np.hypot(*(twin.estimate().state[:2] - log.truth[np.searchsorted(log.t, twin.t), :2])) < 8.0
    )
