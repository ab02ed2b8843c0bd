"""Faults are named soon at every rate, sound sensors stay, and the estimate is as without one."""

import copy
import dataclasses
import functools
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from tests.twin.rows import Sensed
from twin import Log, Particulars, Twin
from twin.benchmark.loading import with_faults
from twin.channels import MEASUREMENTS
from twin.integrity.monitor import SensorMonitor, SensorStatus, run_over
from twin.integrity.state import FROZEN, SENSORS, STATUSES, initial_integrity
from twin.sim.bridge import measurement_row, particulars_of, simulate
from usv_gym import SeaState, SensorSuite, Vessel
from usv_gym.world.faults import parse_faults
from usv_gym.world.simulation import Simulation

START_S = 70.0
"""When faults begin."""

COMPASS_HZ = {20: 20.0, 5: 10.0, 1: 5.0}


def suite(rate: int) -> SensorSuite:
    return dataclasses.replace(SensorSuite(), gps_rate=float(rate), compass_rate=COMPASS_HZ[rate])


@functools.cache
def begun(
    vessel: str, rate: int, loss: str = "none", start: float = START_S
) -> tuple[Log, Twin, int]:
    """Return a clean zigzag, a twin that has seen it until faults begin, and its next row."""
    boat = Vessel.load(vessel)
    log = simulate(
        "zigzag",
        vessel=boat,
        sea=SeaState(hs=0.4),
        duration=start + 50.0,
        seed=5,
        suite=suite(rate),
    )
    rows = with_faults(log, parse_faults(loss, start))
    twin, first = (
        Twin(particulars_of(boat, suite(rate)), "ukf"),
        int(np.searchsorted(log.t, start)),
    )
    for k in range(first):
        twin.step(rows.t[k], rows.z[k], rows.cmd[k])
    return rows, twin, first


def sailed(
    vessel: str, rate: int, fault: str, end: float, loss: str = "none", start: float = START_S
):
    """Return when each sensor was first named, what was excluded, and the error of position."""
    log, twin, first = begun(vessel, rate, loss, start)
    twin, rows = copy.deepcopy(twin), with_faults(log, parse_faults(fault, start))
    named: dict[str, float] = {}
    excluded: set[str] = set()
    for k in range(first, int(np.searchsorted(log.t, end))):
        twin.step(rows.t[k], rows.z[k], rows.cmd[k])
        for sensor in SENSORS:
            status = twin.health[sensor].status
            if status in ("doubtful", "excluded"):
                named.setdefault(sensor, rows.t[k] - start)
            if status == "excluded":
                excluded.add(sensor)
    assert log.truth is not None
    truth = log.truth[np.searchsorted(log.t, twin.t)]
    return twin, named, excluded, float(np.hypot(*(twin.estimate().state[:2] - truth[:2])))


FAULTS = [
    ("gps-jump=20:10", "gps", 2.0),
    ("gps-frozen10", "gps", 3.0),
    ("velocity-scale=1.944:15", "gps", 4.0),
    ("compass-bias=0.5:15", "compass", 2.0),
    ("compass-ramp=0.05:15", "compass", 4.0),
    ("gyro-bias=0.1:15", "gyro", 3.0),
    ("gyro-sign15", "gyro", 3.0),
    ("gyro-frozen15", "gyro", 3.0),
    ("accel_x-bias=1:15", "accelerometers", 4.0),
]


@pytest.mark.parametrize("rate", [20, 5, 1])
@pytest.mark.parametrize(("fault", "sensor", "within"), FAULTS, ids=[row[0] for row in FAULTS])
def test_fault_is_named_soon_and_alone_at_every_rate(fault, sensor, within, rate):
    _, named, excluded, _ = sailed("usv75", rate, fault, START_S + 12.0)
    assert named[sensor] < within
    assert excluded <= {sensor}


@pytest.mark.parametrize("fault", [row[0] for row in FAULTS])
def test_twin_is_where_it_would_be_without_the_fault(fault):
    _, _, _, clean = sailed("usv75", 5, "none", START_S + 27.0)
    twin, _, _, error = sailed("usv75", 5, fault, START_S + 27.0)
    assert error < clean + 1.0
    assert all(twin.health[name].status == "ok" for name in SENSORS)


@pytest.mark.parametrize("fault", ["gyro-sign15", "gyro-bias=0.1:15", "compass-bias=0.5:15"])
def test_without_gps_the_commands_tell_gyro_from_compass(fault):
    sensor = fault.split("-")[0]
    _, named, excluded, _ = sailed("usv75", 5, fault, START_S + 14.0, loss="gps40@60")
    assert named[sensor] < 3.0
    assert excluded == {sensor}


@pytest.mark.parametrize("vessel", ["usv75", "otter", "wamv16"])
def test_without_gps_the_commands_tell_a_bias_of_the_accelerometers(vessel):
    twin, named, _, error = sailed(vessel, 5, "accel_x-bias=1:30", 165.0, "gps50@130", 140.0)
    assert named["accelerometers"] > 0.0
    assert named["accelerometers"] < 8.0
    # a bias of 1 m/s2 alone makes 300 m in this time
    assert error < 30.0
    assert twin.health["compass"].status == "ok"


@pytest.mark.parametrize("vessel", ["usv75", "otter", "wamv16"])
def test_reversed_commands_are_named_and_sensors_stay(vessel):
    _, named, excluded, _ = sailed(vessel, 5, "commands-sign30", START_S + 15.0)
    assert named["commands"] < 10.0
    assert excluded == {"commands"}


@pytest.mark.parametrize("fault", ["accelerometers-scale=3.28:20", "accel_x-bias=1:20"])
@pytest.mark.parametrize("vessel", ["usv75", "wamv16"])
def test_accelerometers_are_held_against_commands_from_an_early_loss_on(vessel, fault):
    _, named, excluded, _ = sailed(vessel, 5, fault, 118.0, "gps35@85", 90.0)
    assert 0.0 < named["accelerometers"] < 20.0
    assert excluded <= {"accelerometers"}


@pytest.mark.parametrize(("gentle_rps", "full_rps"), [(2.0, 8.0), (3.0, 16.0), (6.0, 25.0)])
def test_commands_of_a_boat_that_sails_for_the_first_time_in_a_loss_are_sound(gentle_rps, full_rps):
    boat, rng = Vessel.load("otter"), np.random.default_rng(4)
    sim = Simulation(1, boat, SeaState(hs=0.0), suite=suite(5), dt=0.05)
    sim.reset([0], [np.random.default_rng(4)], speed=0.0)
    sensed, cmd = Sensed(particulars_of(boat, suite(5))), np.zeros(4)
    for k in range(3200):
        t = 0.05 * k
        if k % 100 == 0:
            gentle = rng.uniform(-gentle_rps, gentle_rps, 2)
            full = rng.choice([0.1 * full_rps, full_rps], 2)
            cmd[:2] = gentle if t < 30.0 else full if t > 100.0 else 0.0
        sim.step(cmd[None])
        z = measurement_row(sim.z[0])
        if t > 80.0:
            z[:4] = np.nan
        sensed.take(t, z, cmd)
        assert sensed.monitor.statuses(0.0)["commands"].status == "ok"


def watched(log: Log, about: Particulars) -> Iterator[SensorMonitor]:
    """Yield the monitor after each row of a log."""
    boat = Sensed(about)
    for t, z, cmd in log:
        boat.take(t, z, cmd)
        yield boat.monitor


@pytest.mark.parametrize("rate", [20, 5, 1])
@pytest.mark.parametrize("vessel", ["usv75", "otter", "telemetron"])
def test_sound_sensors_are_silent(vessel, rate):
    boat = Vessel.load(vessel)
    hs = 0.2 if vessel == "otter" else 0.9
    log = simulate(
        "random", vessel=boat, sea=SeaState(hs=hs), duration=150.0, seed=rate, suite=suite(rate)
    )
    seen = set()
    for monitor in watched(log, particulars_of(boat, suite(rate))):
        seen |= {one.status for one in monitor.statuses(0.0).values()}
    assert seen <= {"ok", "absent"}


@pytest.mark.parametrize("rate", [20, 5, 1])
@pytest.mark.parametrize("vessel", ["otter", "wamv16"])
def test_sound_sensors_of_a_small_boat_without_accelerometers_are_silent_in_waves(vessel, rate):
    boat = Vessel.load(vessel)
    log = simulate(
        "random", vessel=boat, sea=SeaState(hs=0.9), duration=150.0, seed=rate, suite=suite(rate)
    )
    z = log.z.copy()
    z[:, [MEASUREMENTS.index("accel_x_mps2"), MEASUREMENTS.index("accel_y_mps2")]] = np.nan
    statuses, _ = run_over(particulars_of(boat, suite(rate)), log.t, z, log.cmd)
    assert {STATUSES[int(one)] for one in np.unique(statuses)} <= {"ok", "absent"}


def test_whitened_innovations_of_sound_sensors_are_white():
    """Windowed means have the variance of white noise: the level that is learned stays near 1."""
    log, twin, _ = begun("usv75", 5)
    assert len(log) > 1000
    level = twin.monitor.record["bank"]["level"][:3]
    assert (level >= 1.0).all()
    assert level.mean() < 1.5


def test_dead_reckoning_of_a_filter_without_gps_claims_what_it_errs():
    """Normalised squared errors of the filter that leaves the GPS out: chi-square of two."""
    squares = []
    for seed in range(6):
        boat = Vessel.load("wamv16")
        log = simulate(
            "zigzag", vessel=boat, sea=SeaState(hs=0.3), duration=80.0, seed=seed, suite=suite(5)
        )
        particulars = particulars_of(boat, suite(5))
        *_, monitor = watched(log, particulars)
        one = monitor.record["bank"]["filters"][3]
        assert log.truth is not None
        error = one["x"][:2] - log.truth[-1, :2]
        cov = one["P"][:2, :2] + particulars.instruments.gps_bias_sd**2 * np.eye(2)
        squares.append(error @ np.linalg.solve(cov, error))
    assert 0.3 < np.mean(squares) < 6.0


def test_the_state_of_a_monitor_is_all_that_it_remembers():
    twin = begun("usv75", 5)[1]
    other = SensorMonitor(initial_integrity(twin.particulars))
    other.load_state_dict(twin.monitor.state_dict())
    np.testing.assert_array_equal(other.memory, twin.monitor.memory)


def test_a_status_prints_as_words():
    status = SensorStatus("excluded", 88.42599987983704, "gps jumped")
    assert str(status) == "excluded since 88.4 s: gps jumped"
    assert str(SensorStatus("absent", np.nan, "")) == "absent"


numbers = st.one_of(
    st.floats(width=64),
    st.floats(-10.0, 10.0),
    st.sampled_from((0.0, 1e-300, 1e300, -1e300, np.nan, np.inf, -np.inf)),
)


@settings(max_examples=60, derandomize=True)
@given(
    arrays(float, (12, 10), elements=numbers),
    arrays(float, (12, 4), elements=numbers),
    st.lists(st.sampled_from((1e-9, 0.01, 0.05, 1.0, 100.0, 1e6)), min_size=12, max_size=12),
)
def test_what_is_let_through_is_possible_under_any_rows(z, cmd, steps):
    twin = begun("usv75", 5)[1]
    boat = Sensed(twin.particulars)
    boat.monitor.memory[:] = twin.monitor.memory
    for _ in range(8):
        for row, dt in enumerate(steps):
            boat.row["last"] = 0.0
            out = boat.take(
                dt, np.pad(z[row], (0, 9), constant_values=np.nan), cmd[row], ready=True
            )
            assert not np.isinf(out[:8]).any()
    x = boat.monitor.record["bank"]["filters"]["x"]
    assert np.isfinite(x).all()


@settings(max_examples=5, derandomize=True)
@given(st.integers(0, 2**32))
def test_boat_recovers_from_garbage(seed):
    """After 10 s of it all sensors are in use again."""
    log, twin, first = begun("usv75", 5)
    twin, z, rng = copy.deepcopy(twin), log.z.copy(), np.random.default_rng(seed)
    struck = (log.t >= START_S) & (log.t < START_S + 10.0)
    noise = rng.normal(size=z[struck, :8].shape) * 10.0 ** rng.uniform(-3, 12, z[struck, :8].shape)
    z[struck, :8] = np.where(np.isfinite(z[struck, :8]), noise, np.nan)
    for k in range(first, int(np.searchsorted(log.t, START_S + 40.0))):
        twin.step(log.t[k], z[k], log.cmd[k])
    assert {twin.health[name].status for name in SENSORS} == {"ok"}
    assert log.truth is not None
    truth = log.truth[np.searchsorted(log.t, twin.t), :2]
    assert np.hypot(*(twin.estimate().state[:2] - truth)) < 5.0


def after_gap(fault: str) -> tuple[float, set[str]]:
    """Return the error 30 s after a gap without compass, and what was doubted in the last 10 s."""
    boat, end = Vessel.load("usv75"), START_S + 70.0
    log = simulate(
        "zigzag", vessel=boat, sea=SeaState(hs=0.4), duration=end + 5.0, seed=6, suite=suite(5)
    )
    rows = with_faults(log, parse_faults(f"compass60@60{fault}", end - 10.0))
    twin, doubted = Twin(particulars_of(boat, suite(5)), "ukf"), set[str]()
    gap = (log.t > START_S) & (log.t < START_S + 40.0)
    for k in np.flatnonzero(~gap & (log.t < end)):
        twin.step(rows.t[k], rows.z[k], rows.cmd[k])
        if rows.t[k] > end - 10.0:
            health = twin.health
            doubted |= {one for one in SENSORS if health[one].status in ("doubtful", "excluded")}
    assert log.truth is not None
    truth = log.truth[np.searchsorted(log.t, twin.t)]
    return float(np.hypot(*(twin.estimate().state[:2] - truth[:2]))), doubted


def test_bank_begins_again_after_a_gap_without_compass():
    error, doubted = after_gap("")
    assert error < 3.0
    assert not doubted
    error, doubted = after_gap("+gps-jump=50:20")
    assert error < 10.0
    assert "gps" in doubted


def test_gps_that_jumps_far_stays_out_until_it_is_back():
    _, _, excluded, error = sailed("usv75", 5, "gps-jump=200:30", START_S + 28.0)
    assert excluded == {"gps"}
    assert error < 10.0


def test_gps_that_comes_back_is_used_again_soon():
    twin, _, _, error = sailed("otter", 5, "none", START_S + 45.0, loss="gps30@75")
    assert twin.health["gps"].status == "ok"
    assert error < 3.0


@pytest.mark.parametrize("rate", [20, 5, 1])
def test_backlog_of_a_stall_is_missing_time(rate):
    stall = "all-stall10+commands-stall10"
    twin, _, _, error = sailed("usv75", rate, stall, START_S + 18.0)
    assert all("old samples" in twin.health[name].why for name in ("gps", "compass", "gyro"))
    # old samples are no estimate of where it is now
    sd = np.hypot(*twin.estimate().sd[:2])
    assert error < 3.0 * sd
    twin, _, _, error = sailed("usv75", rate, stall, START_S + 30.0)
    assert all(twin.health[name].status == "ok" for name in SENSORS)
    assert error < 3.0


def test_rare_rows_of_a_boat_without_compass_are_used():
    boat = Sensed(particulars_of(Vessel.load("usv75")))
    for k in range(20):
        row = np.array([10.0 * k, 1.0, *[np.nan] * 17])
        used = boat.take(5.0 * k, row, np.zeros(4))
        assert used[0] == 10.0 * k


@pytest.mark.parametrize("every", [1, 4, 20])
@pytest.mark.parametrize("step", [0.1, 0.5])
def test_a_coarse_velocity_is_frozen_only_if_the_boat_has_changed_its_own(step, every):
    """Steps of ``step`` kn without noise stand still on a straight leg, and not in a turn."""
    rng, t = np.random.default_rng(1), 0.05 * np.arange(2400)
    r = np.where(t // 40 % 2 == 0, 0.15 * np.sin(0.1 * np.pi * t), 0.0)
    psi = 0.05 * np.cumsum(r)
    v, z = (
        3.0 * np.stack([np.cos(psi), np.sin(psi)], axis=1),
        np.full((len(t), len(MEASUREMENTS)), np.nan),
    )
    z[:, :2] = 0.05 * np.cumsum(v, axis=0) + 0.3 * rng.standard_normal((len(t), 2))
    z[:, 2:4] = (step * 0.5144) * np.round(v / (step * 0.5144))
    noise = np.array([0.01, 0.002, 0.05, 0.05]) * rng.standard_normal((len(t), 4))
    z[:, 4:8] = np.stack([psi, r, 0.0 * r, 3.0 * r], axis=1) + noise
    z[np.arange(len(t)) % every > 0, :4] = np.nan
    cmd = np.tile([15.0, 15.0, 0.0, 0.0], (len(t), 1))
    about = dataclasses.replace(particulars_of(Vessel.load("usv75")), speed=3.0, shaft_speed=15.0)
    assert not (run_over(about, t, z, cmd)[1][:, 0] == FROZEN).any()
    frozen = t >= 85.0
    z[frozen, 2:4] += z[1700, 2:4] - z[frozen, 2:4]  # where there is a sample
    named = t[run_over(about, t, z, cmd)[1][:, 0] == FROZEN]
    assert 85.0 < named[0] < 85.0 + 6.0 * 0.05 * every + 4.0
