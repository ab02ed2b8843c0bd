"""Each detector names the sensor at fault, and no other; and takes it back afterwards."""

from __future__ import annotations

import copy
import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.twin.health.watching import MANOEUVRES, START, Watch, base, watch, watch_fault
from twin import Twin
from twin.benchmark.sensor_faults import (
    SENSOR_FAULTS,
    Rows,
    SensorFault,
    inject,
    simulate_with,
)
from twin.digital_twin import LOST_SHOWN
from twin.sim.bridge import particulars_of, simulate
from usv_gym import SeaState, Vessel
from usv_kernel.channels import (
    ACCEL_X,
    ACCEL_Y,
    COMPASS,
    GPS_VX,
    GPS_VY,
    GPS_X,
    GPS_Y,
    GYRO,
    SENSOR_CHANNELS,
)

few = settings(max_examples=8, derandomize=True)

manoeuvres = st.sampled_from(MANOEUVRES)

starts = st.floats(START, START + 12.0)
"""A leg of the zigzag."""

signs = st.sampled_from((-1.0, 1.0))

angles = st.floats(-math.pi, math.pi)


def size(low: float, high: float) -> st.SearchStrategy[float]:
    """Return magnitudes over decades."""
    return st.floats(math.log(low), math.log(high)).map(math.exp)


def fault(change, seconds: float = 20.0) -> SensorFault:
    return SensorFault("test", "", seconds, (), change)


def check(found: Watch, sensor: str, within: float, start: float = START, why: str = "") -> None:
    """Only this sensor was excluded, soon, for this reason; and all are in use at the end."""
    assert found.named == {sensor}, found.findings
    assert found.first(sensor) <= start - START + within, found.findings
    assert any(f.sensor == sensor and why in f.why for f in found.findings), found.findings
    assert set(found.last.values()) == {"ok"}, found.last


@few
@given(manoeuvres, starts, signs, size(0.08, 2.0))
def test_gyro_bias_names_the_gyro(manoeuvre, start, sign, bias):
    def change(rows: Rows) -> None:
        rows.z[:, GYRO] += sign * bias

    check(watch_fault(fault(change), manoeuvre, start=start), "gyro", 11.0, start, "contradicted")


vessels = pytest.mark.parametrize("vessel", ["usv75", "otter", "wamv16"])


@vessels
@pytest.mark.parametrize("manoeuvre", ["zigzag", "turn-zigzag"])
@pytest.mark.parametrize("factor", [-1.0, math.degrees(1.0), math.radians(1.0)])
def test_gyro_with_wrong_sign_or_unit_is_named_once(factor, manoeuvre, vessel):
    """The compass is in doubt at most: what it turns in proportion is what the course follows."""

    def change(rows: Rows) -> None:
        rows.z[:, GYRO] *= factor

    found = watch_fault(fault(change, 40.0), manoeuvre, vessel, after=59.0)
    assert found.named == {"gyro"}, found.findings
    assert len(found.findings) <= 6, found.findings
    assert set(found.last.values()) == {"ok"}, found.last


@vessels
@pytest.mark.parametrize("sensor", [GYRO, COMPASS])
def test_course_says_which_of_two_signs_is_wrong(sensor, vessel):
    boat, names = Vessel.load(vessel), {GYRO: "gyro", COMPASS: "compass"}
    log = simulate("zigzag", vessel=boat, sea=SeaState(hs=0.05), duration=60.0, seed=1)
    log.z[:, sensor] *= -1.0
    found = watch(Twin(particulars_of(boat), "ukf"), log, 0)
    assert found.last[names.pop(sensor)] == "excluded", found.findings
    assert found.last[names.popitem()[1]] == "ok", found.findings
    assert len(found.findings) <= 6, found.findings


@few
@given(manoeuvres, starts)
def test_frozen_gyro_names_the_gyro(manoeuvre, start):
    found = watch_fault(SENSOR_FAULTS["gyro-frozen"], manoeuvre, start=start)
    check(found, "gyro", 3.0, start, "repeats itself")


@few
@given(manoeuvres, starts)
def test_frozen_imu_names_gyro_and_accelerometers(manoeuvre, start):
    found = watch_fault(SENSOR_FAULTS["imu-frozen"], manoeuvre, start=start, after=25.0)
    assert found.named == {"gyro", "accelerometers"}, found.findings
    assert max(map(found.first, found.named)) <= start - START + 3.0
    assert set(found.last.values()) == {"ok"}, found.last


@few
@given(manoeuvres, starts, st.floats(0.8, 2.0 * math.pi - 0.8))
def test_turned_compass_names_the_compass(manoeuvre, start, angle):
    def change(rows: Rows) -> None:
        rows.z[:, COMPASS] += angle

    check(watch_fault(fault(change), manoeuvre, start=start), "compass", 0.2, start, "jumped")


@few
@given(manoeuvres, starts)
def test_frozen_compass_names_the_compass(manoeuvre, start):
    found = watch_fault(SENSOR_FAULTS["compass-frozen"], manoeuvre, start=start, after=25.0)
    check(found, "compass", 6.0, start, "repeats itself")


@few
@given(manoeuvres, starts, signs, st.floats(0.05, 0.3))
def test_drifting_compass_names_the_compass(manoeuvre, start, sign, rate):
    def change(rows: Rows) -> None:
        rows.z[:, COMPASS] += sign * rate * rows.since

    found = watch_fault(fault(change), manoeuvre, start=start, after=35.0)
    check(found, "compass", 17.0, start, "contradicted")


@few
@given(manoeuvres, starts, angles, size(12.0, 1e5))
def test_gps_jump_names_the_gps(manoeuvre, start, direction, distance):
    def change(rows: Rows) -> None:
        rows.z[:, GPS_X] += distance * math.cos(direction)
        rows.z[:, GPS_Y] += distance * math.sin(direction)

    check(watch_fault(fault(change), manoeuvre, start=start), "gps", 0.2, start, "jumped")


@few
@given(manoeuvres, angles, st.floats(0.4, 3.0))
def test_slow_pull_names_the_gps(manoeuvre, direction, speed):
    def change(rows: Rows) -> None:
        rows.z[:, GPS_X] += speed * math.cos(direction) * rows.since
        rows.z[:, GPS_Y] += speed * math.sin(direction) * rows.since

    found = watch_fault(fault(change, 30.0), manoeuvre)
    check(found, "gps", 2.0 / speed + 4.0, why="velocity")


@few
@given(manoeuvres, angles, st.floats(0.5, 1.5))
def test_gps_that_was_drawn_away_is_soon_trusted_again(manoeuvre, direction, speed):
    """A slow pull shows when it ends, as the velocity jumps back; a fast one at once."""
    north, east = speed * math.cos(direction), speed * math.sin(direction)

    def change(rows: Rows) -> None:
        rows.z[:, GPS_X] += north * rows.since
        rows.z[:, GPS_Y] += east * rows.since
        rows.z[:, GPS_VX] += north
        rows.z[:, GPS_VY] += east

    found = watch_fault(fault(change, 50.0), manoeuvre, after=25.0)
    back = [f for f in found.findings if f.sensor == "gps" and f.status == "excluded"]
    assert any("velocity" in f.why for f in back), found.findings
    assert "excluded" not in found.last.values(), found.last


@few
@given(manoeuvres, st.sampled_from(("usv75", "otter", "wamv16")), signs, st.floats(0.6, 2.6))
def test_compass_turned_for_good_is_not_taken_back(manoeuvre, vessel, sign, angle):
    """For as long as the course over ground contradicts it, also after a minute."""

    def change(rows: Rows) -> None:
        rows.z[:, COMPASS] += sign * angle

    found = watch_fault(fault(change, 90.0), manoeuvre, vessel, after=0.0)
    assert found.last["compass"] == "excluded", found.findings


@few
@given(manoeuvres)
def test_without_a_gyro_a_compass_comes_back(manoeuvre):
    def change(rows: Rows) -> None:
        rows.z[:, COMPASS] = 1e9

    found = watch_fault(fault(change, 20.0), manoeuvre, after=30.0, missing=(GYRO,))
    assert found.first("compass") < 0.5, found.findings
    assert found.last["compass"] == "ok", found.findings


@few
@given(manoeuvres)
def test_without_a_gyro_the_course_names_a_frozen_compass(manoeuvre):
    found = watch_fault(SENSOR_FAULTS["compass-frozen"], manoeuvre, after=60.0, missing=(GYRO,))
    assert "compass" in found.named, found.findings
    assert found.last["compass"] == "ok", found.findings


VELOCITY = (GPS_VX, GPS_VY)


@few
@given(manoeuvres, angles)
def test_without_a_velocity_pulled_fixes_come_back(manoeuvre, direction):
    def change(rows: Rows) -> None:
        rows.z[:, GPS_X] += math.cos(direction) * rows.since
        rows.z[:, GPS_Y] += math.sin(direction) * rows.since

    found = watch_fault(fault(change, 20.0), manoeuvre, after=75.0, missing=VELOCITY)
    # the current that the pull made may still be doubted
    assert "excluded" not in found.last.values(), found.findings


@few
@given(manoeuvres, starts, angles, size(25.0, 1e5))
def test_without_a_velocity_jumps_name_the_gps(manoeuvre, start, direction, distance):
    def change(rows: Rows) -> None:
        rows.z[:, GPS_X] += distance * math.cos(direction)
        rows.z[:, GPS_Y] += distance * math.sin(direction)

    found = watch_fault(fault(change), manoeuvre, start=start, missing=VELOCITY)
    check(found, "gps", 0.2, start, "jumped")


@few
@given(manoeuvres, st.sampled_from((0.0, -1.0, 1.944)))
def test_fixes_are_used_though_their_velocity_is_wrong(manoeuvre, factor):
    """It is zero, of the wrong sign, or in knots."""

    def change(rows: Rows) -> None:
        rows.z[:, list(VELOCITY)] *= factor

    found = watch_fault(fault(change, 25.0), manoeuvre, after=20.0)
    assert found.named == {"gps"}, found.findings
    doubts = [f.after for f in found.findings if "contradicts its fixes" in f.why]
    assert doubts and doubts[0] < 8.0, found.findings
    assert set(found.last.values()) == {"ok"}, found.last


@few
@given(manoeuvres, starts)
def test_frozen_gps_names_the_gps(manoeuvre, start):
    found = watch_fault(SENSOR_FAULTS["gps-frozen"], manoeuvre, start=start)
    check(found, "gps", 3.0, start, "repeats itself")


@few
@given(manoeuvres, starts)
def test_late_gps_names_the_gps(manoeuvre, start):
    late = dataclasses.replace(SENSOR_FAULTS["gps-late"], seconds=20.0)
    check(watch_fault(late, manoeuvre, start=start), "gps", 1.0, start)


@few
@given(st.sampled_from((("zigzag", "wamv16"), ("zigzag", "usv75"), ("random", "usv75"))), starts)
def test_late_gps_is_not_taken_back_while_it_is_late(sailed, start):
    """A slower boat is soon as near to dead reckoning as its late fixes are."""
    found = watch_fault(SENSOR_FAULTS["gps-late"], *sailed, start=start, after=0.0)
    assert found.last["gps"] == "excluded", found.findings


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("seconds", [1.5, 2.0])
def test_gps_that_is_a_little_late_never_names_the_accelerometers(seed, seconds):
    """It may come back near dead reckoning; its velocity then contradicts the accelerometers."""

    def change(rows: Rows) -> None:
        n, late = len(rows.z), round(seconds / rows.dt)
        first = len(rows.before) - n - late
        rows.z[:, GPS_X:COMPASS] = rows.before[first : first + n, GPS_X:COMPASS]

    late, boat, sea = fault(change, 30.0), Vessel.load("usv75"), SeaState(hs=0.5, wind=4.5)
    log = simulate_with(late, 90.0, "zigzag", boat, sea, duration=125.0, seed=seed)
    found = watch(Twin(particulars_of(boat), "ukf"), inject(log, late, 90.0, seed), 0)
    assert found.named == {"gps"}, found.findings


@pytest.mark.parametrize("bias_from", [62.0, 92.0])
def test_accelerometers_that_fail_after_a_jump_do_not_cost_the_gps_for_good(bias_from):
    boat = Vessel.load("usv75")
    sea = SeaState(hs=0.5, wind=4.5)
    log = simulate("zigzag", vessel=boat, sea=sea, duration=bias_from + 150.0, seed=1)
    twin = Twin(particulars_of(boat), "ukf")
    for t, z, cmd in log.without_truth():
        z = z.copy()
        z[GPS_X] += 500.0 if bias_from - 2.0 <= t < bias_from + 4.0 else 0.0
        z[ACCEL_X] += 1.0 if t >= bias_from else 0.0
        twin.step(t, z, cmd.copy())
    assert twin.health["gps"].status == "ok"
    assert twin.health["accelerometers"].status == "excluded"
    assert np.hypot(*(np.asarray(twin.estimate().state)[:2] - log.truth[-1, :2])) < 10.0


@vessels
def test_commands_say_whether_gps_or_accelerometers_are_at_fault(vessel):
    """Ten seconds after the GPS jumped it is the more likely one, but for what the commands say."""

    def change(rows: Rows) -> None:
        rows.z[rows.since < 6.0, GPS_X] += 500.0
        rows.z[rows.since > 16.0, ACCEL_X] += 1.0

    log, twin, first = base("zigzag", vessel)
    twin, start = copy.deepcopy(twin), START + 35.0
    faulty = inject(log, fault(change, 60.0), start, seed=1)
    end = int(np.searchsorted(log.t, start + 26.0))
    found = watch(twin, faulty, first, end)
    assert found.last["gps"] == "ok", found.findings
    assert found.last["accelerometers"] == "excluded", found.findings


@few
@given(st.sampled_from(("zigzag", "random")), st.floats(4.0, 8.0))
def test_gps_that_falls_behind_is_late(manoeuvre, seconds):
    """Fix and velocity agree with each other all the time."""

    def change(rows: Rows) -> None:
        n = len(rows.z)
        late = np.minimum(seconds, 0.4 * rows.since) / rows.dt
        row = np.arange(len(rows.before) - n, len(rows.before)) - late
        whole = np.arange(len(rows.before))
        for j in (GPS_X, GPS_Y, GPS_VX, GPS_VY):
            rows.z[:, j] = np.interp(row, whole, rows.before[:, j])

    # what was wrong for long is taken back after a minute
    check(watch_fault(fault(change, 30.0), manoeuvre, after=65.0), "gps", 25.0)


# of 0.8 m/s^2, half of the biases are found within 10 s, of 1.0 all but one of 48
@few
@given(manoeuvres, starts, signs, st.floats(1.2, 5.0), st.sampled_from((ACCEL_X, ACCEL_Y)))
def test_accelerometer_bias_names_the_accelerometers(manoeuvre, start, sign, bias, channel):
    def change(rows: Rows) -> None:
        rows.z[:, channel] += sign * bias

    found = watch_fault(fault(change), manoeuvre, start=start)
    check(found, "accelerometers", 10.0, start, "contradicted")


SENSOR_OF = {**dict.fromkeys(SENSOR_CHANNELS[:4], "gps"), "compass_rad": "compass"} | {
    "gyro_radps": "gyro",
    **dict.fromkeys(SENSOR_CHANNELS[6:], "accelerometers"),
}


@pytest.mark.parametrize("channel", SENSOR_CHANNELS)
@settings(max_examples=3, derandomize=True)
@given(manoeuvres, signs, size(1e8, 1e300))
def test_impossible_numbers_name_the_sensor(channel, manoeuvre, sign, value):
    def change(rows: Rows) -> None:
        rows.z[:, SENSOR_CHANNELS.index(channel)] = sign * value

    found = watch_fault(fault(change, 10.0), manoeuvre)
    check(found, SENSOR_OF[channel], 0.2, why="numbers that no boat gives")


@pytest.mark.parametrize(
    ("factors", "why"),
    [
        ((-1.0, -1.0, -1.0, -1.0), "wrong sign"),
        ((-1.0, -1.0, 1.0, 1.0), "wrong sign"),
        ((1.0, 1.0, -1.0, -1.0), "wrong sign"),
        ((0.0, 0.0, 0.0, 0.0), "do not explain"),
        ((1e9, 1e9, 1e9, 1e9), "numbers that no boat gives"),
    ],
    ids=["reversed", "thrust reversed", "steering reversed", "zero", "absurd"],
)
@few
@given(st.sampled_from(("zigzag", "random")), starts)
def test_wrong_commands_name_the_commands(factors, why, manoeuvre, start):
    def change(rows: Rows) -> None:
        rows.cmd[:] *= factors

    found = watch_fault(fault(change, 20.0), manoeuvre, start=start)
    if factors == (1.0, 1.0, -1.0, -1.0):
        # steering alone shows where it changes, and then only after a time
        assert found.named <= {"commands"}
    else:
        # soon in a zigzag; where the helm rests longer, it takes longer
        check(found, "commands", 18.0, start, why)


@pytest.mark.parametrize("seed", [11, 12, 13])
def test_dead_thruster_is_named_with_its_side(seed):
    """Of steerable drives it costs half the thrust, and hardly turns the boat."""
    boat, dead = Vessel.load("usv75"), SENSOR_FAULTS["thruster-dead"]
    sea = SeaState(hs=0.5, wind=4.5)
    log = simulate_with(dead, START, "zigzag", boat, sea, duration=START + 12.0, seed=seed)
    found = watch(Twin(particulars_of(boat), "ukf"), log, 0)
    assert found.mentioned == {"commands"} and 0.0 < found.first("commands") < 7.0
    assert any("left thruster" in finding.why for finding in found.findings)


@pytest.mark.parametrize("seed", [21, 22])
def test_garbage_does_not_move_the_boat(seed):
    """Plausible numbers among impossible ones are garbage too."""
    boat, garbage = Vessel.load("usv75"), SENSOR_FAULTS["garbage"]
    sea = SeaState(hs=0.5, wind=4.5)
    log = simulate("zigzag", vessel=boat, sea=sea, duration=START + 12.0, seed=seed)
    twin = Twin(particulars_of(boat), "ukf")
    for k, row in enumerate(inject(log, garbage, START, seed)):
        twin.step(*row)
        if log.t[k] > START:
            error = twin.estimate().state[:2] - log.truth[k, :2]
            assert np.hypot(*error) < 6.0


@few
@given(st.sampled_from(("zigzag", "random")), starts)
def test_swapped_sides_name_the_commands(manoeuvre, start):
    def change(rows: Rows) -> None:
        rows.cmd[:, [0, 1]] = rows.cmd[:, [1, 0]]

    found = watch_fault(fault(change), manoeuvre, "otter", start)
    # how soon depends on how the sides differ
    assert found.named <= {"commands"}


@few
@given(manoeuvres, starts, st.floats(5.0, 30.0))
def test_lost_sensors_are_absent_and_come_back(manoeuvre, start, seconds):
    def change(rows: Rows) -> None:
        rows.z[:] = math.nan

    found = watch_fault(fault(change, seconds), manoeuvre, start=start)
    assert not found.named
    assert set(found.last.values()) == {"ok"}
    silent = watch_fault(fault(change, seconds), manoeuvre, start=start, after=-0.5)
    assert list(silent.last.values()) == ["absent"] * 4 + ["ok"]


def watch_from_the_beginning(vessel: str, manoeuvre: str, change) -> dict:
    """Return what is said of commands that were wrong all the time."""
    log = base(manoeuvre, vessel)[0]
    cmd = log.cmd.copy()
    change(cmd)
    twin = Twin(base(manoeuvre, vessel)[1].particulars, "ukf")
    watch(twin, dataclasses.replace(log, cmd=cmd), 0)
    return twin.health


def steering_reversed(cmd):
    cmd[:, 2:] *= -1.0


def thrust_reversed(cmd):
    cmd[:, :2] *= -1.0


def sides_swapped(cmd):
    cmd[:, [0, 1]] = cmd[:, [1, 0]]


@pytest.mark.parametrize("manoeuvre", ["zigzag", "random"])
@pytest.mark.parametrize(
    ("vessel", "change"),
    [
        ("usv75", steering_reversed),
        ("usv75", thrust_reversed),
        ("otter", sides_swapped),
        ("otter", thrust_reversed),
    ],
)
def test_commands_wrong_from_the_beginning_are_named(vessel, change, manoeuvre):
    health = watch_from_the_beginning(vessel, manoeuvre, change)
    assert health["commands"].status == "doubtful"
    assert health["commands"].why == "commands have the wrong sign or swapped sides"
    assert {name for name, item in health.items() if item.status != "ok"} == {"commands"}


@pytest.mark.parametrize("name", ["ukf", "dsw-ukf-plus", "dsw-ukf"])
@pytest.mark.parametrize("bad", [1, 2, 20])
def test_impossible_first_fixes_do_not_keep_a_twin_from_starting(name, bad):
    log, _, _ = base("zigzag")
    twin, left = Twin(particulars_of(Vessel.load("usv75")), name), bad
    for t, z, cmd in log.slice(0.0, 20.0).without_truth():
        z = z.copy()
        if left and math.isfinite(z[GPS_X]):
            z[GPS_X] = z[GPS_Y] = 1e9
            left -= 1
        twin.step(t, z, cmd)
    found, row = twin.estimate(), int(np.searchsorted(log.t, twin.t))
    assert found.ready and twin.health["gps"].status == "ok"
    assert np.hypot(*(found.state[:2] - log.truth[row, :2])) < 10.0


@few
@given(manoeuvres, starts)
def test_frozen_gps_velocity_is_not_used(manoeuvre, start):
    def change(rows: Rows) -> None:
        last = rows.before[: len(rows.before) - len(rows.z), GPS_VX : GPS_VY + 1]
        held = last[np.isfinite(last).all(axis=1)][-1]
        given = np.isfinite(rows.z[:, GPS_VX])
        rows.z[given, GPS_VX : GPS_VY + 1] = held

    found = watch_fault(fault(change), manoeuvre, start=start)
    assert not found.named
    assert found.mentioned == {"gps"} and found.first("gps") <= start - START + 3.0
    assert "repeats its velocity" in found.findings[0].why
    assert set(found.last.values()) == {"ok"}


def test_gps_that_starts_far_away_is_soon_taken_back():
    """Three seconds of fixes are no reason to doubt those that follow for a minute."""
    log, _, _ = base("zigzag")
    twin = Twin(particulars_of(Vessel.load("usv75")), "ukf")
    for t, z, cmd in log.slice(0.0, 30.0).without_truth():
        z = z.copy()
        z[GPS_X] += 85e3 if t < 3.0 else 0.0
        twin.step(t, z, cmd)
    row = int(np.searchsorted(log.t, twin.t))
    assert twin.health["gps"].status == "ok"
    assert np.hypot(*(twin.estimate().state[:2] - log.truth[row, :2])) < 10.0


def test_navigation_that_is_lost_says_so_and_begins_again(tmp_path):
    log, twin, first = base("zigzag")
    twin = copy.deepcopy(twin)
    twin.predictor.navigation[0] += 5000.0
    for row in range(first, first + 60):
        twin.step(log.t[row], log.z[row], log.cmd[row])
    found = twin.health["navigation"]
    assert found.status == "doubtful" and "began again" in found.why
    assert any(line.startswith("navigation doubtful") for line in twin.notes)
    assert np.hypot(*(twin.estimate().state[:2] - log.truth[row, :2])) < 10.0
    twin.save(tmp_path / "a.twin")
    assert Twin.load(tmp_path / "a.twin").health == twin.health
    for row in range(first + 60, first + 300):
        twin.step(log.t[row], log.z[row], log.cmd[row])
    assert twin.health["navigation"].status == "ok"
    assert twin.health["navigation"].since == pytest.approx(found.since + LOST_SHOWN, abs=0.2)


def test_receiver_that_holds_still_is_right():
    """At rest it repeats a velocity of 0 while its fixes wander by millimetres."""
    boat = Vessel.load("otter")
    log = simulate(np.zeros((1200, 4)), vessel=boat, sea=SeaState(), duration=60.0, seed=1)
    rows, rng = dataclasses.replace(log, z=log.z.copy()), np.random.default_rng(1)
    given = np.isfinite(rows.z[:, GPS_X])
    rows.z[given, GPS_X : GPS_Y + 1] = rng.normal(0.0, 0.002, (int(given.sum()), 2))
    rows.z[given, GPS_VX : GPS_VY + 1] = 0.0
    twin = Twin(particulars_of(boat), "ukf")
    twin.run(rows)
    assert not twin.notes, twin.notes
