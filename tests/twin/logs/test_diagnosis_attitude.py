"""Faults of the sensors of roll, pitch and heave are named; sound ones are not blamed."""

from __future__ import annotations

import functools
import math
import re
from collections.abc import Callable

import numpy as np
import pytest

from twin import Log
from twin.channels import (
    ACCEL_Z,
    AHRS_PITCH,
    AHRS_ROLL,
    GPS_VZ,
    GPS_Z,
    GYRO_X,
    GYRO_Y,
    MOTION_AT,
)
from twin.logs.diagnosis.attitude import check_attitude
from twin.logs.diagnosis.diagnose import diagnose
from twin.logs.diagnosis.findings import Recording
from twin.logs.diagnosis.heading import check_heading
from twin.sim.bridge import particulars_of, simulate
from usv_gym import SensorSuite, Vessel
from usv_gym.world.sea import SeaState
from usv_kernel.channels import ACCEL_X, ACCEL_Y, GYRO
from usv_kernel.scalar import rotation

OWN = {
    *("axis-dead", "accel-unit", "accel-gravity", "accel-up", "accel-swapped", "imu-askew"),
    *("ahrs-unit", "gyro-swapped", "tilt-sign", "tilt-unit", "climb-sign"),
}


@functools.cache
def run(scenario: str, vessel: str = "usv75", sea: str = "2", seed: int = 0) -> Log:
    state = SeaState.named(sea)
    boat = Vessel.load(vessel)
    return simulate(scenario, vessel=boat, sea=state, duration=90, seed=seed, dof=6)


def codes(log: Log, z: np.ndarray) -> set[str]:
    recording = Recording(log.t, z, log.cmd, log.t)
    return {finding.code for finding in diagnose(recording).findings} & OWN


def scaled(factor: float, *columns: int) -> Callable[[np.ndarray], None]:
    def change(z: np.ndarray) -> None:
        z[:, list(columns)] *= factor

    return change


def swapped(a: int, b: int) -> Callable[[np.ndarray], None]:
    def change(z: np.ndarray) -> None:
        z[:, [a, b]] = z[:, [b, a]]

    return change


def askew(*angles: float) -> Callable[[np.ndarray], None]:
    def change(z: np.ndarray) -> None:
        for columns in ([ACCEL_X, ACCEL_Y, ACCEL_Z], [GYRO_X, GYRO_Y, GYRO]):
            z[:, columns] = z[:, columns] @ rotation(angles)

    return change


def without_gravity(z: np.ndarray) -> None:
    z[:, ACCEL_Z] += 9.81


def dead(column: int) -> Callable[[np.ndarray], None]:
    def change(z: np.ndarray) -> None:
        z[:, column] = 0.125

    return change


def dying(column: int) -> Callable[[np.ndarray], None]:
    def change(z: np.ndarray) -> None:
        z[900:, column] = z[900, column]

    return change


FAULTS = {
    "roll gyro dies": (dying(GYRO_X), "axis-dead"),
    "roll of the AHRS dies": (dying(AHRS_ROLL), "axis-dead"),
    "side accelerometer dies": (dying(ACCEL_Y), "axis-dead"),
    "g": (scaled(1 / 9.81, ACCEL_X, ACCEL_Y, ACCEL_Z), "accel-unit"),
    "no gravity": (without_gravity, "accel-gravity"),
    "z up": (scaled(-1.0, ACCEL_Z), "accel-up"),
    "x and z swapped": (swapped(ACCEL_X, ACCEL_Z), "accel-swapped"),
    "askew": (askew(0.25, 0.0, 0.0), "imu-askew"),
    "askew ahead": (askew(0.0, -0.2, 0.3), "imu-askew"),
    "turned": (askew(0.0, 0.0, -0.2), "imu-askew"),
    "angles in degrees": (scaled(180 / math.pi, AHRS_ROLL, AHRS_PITCH), "ahrs-unit"),
    "gyros swapped": (swapped(GYRO_X, GYRO_Y), "gyro-swapped"),
    "roll reversed": (scaled(-1.0, AHRS_ROLL), "tilt-sign"),
    "pitch rate reversed": (scaled(-1.0, GYRO_Y), "tilt-sign"),
    "roll and its rate reversed": (scaled(-1.0, AHRS_ROLL, GYRO_X), "tilt-sign"),
    "pitch and its rate reversed": (scaled(-1.0, AHRS_PITCH, GYRO_Y), "tilt-sign"),
    "accelerations to port": (scaled(-1.0, ACCEL_Y), "tilt-sign"),
    "only z in g": (scaled(1 / 9.81, ACCEL_Z), "accel-gravity"),
    "rates in degrees": (scaled(180 / math.pi, GYRO_X, GYRO_Y), "tilt-unit"),
    "height up": (scaled(-1.0, GPS_Z, GPS_VZ), "climb-sign"),
    "dead roll gyro": (dead(GYRO_X), "axis-dead"),
}


@pytest.mark.parametrize("scenario", ["heading135", "zigzag"])
@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_named_and_no_other(scenario: str, fault: str) -> None:
    change, code = FAULTS[fault]
    log = run(scenario)
    z = log.z.copy()
    change(z)
    assert codes(log, z) == {code}


@pytest.mark.parametrize("vessel", ["usv75", "otter", "wamv16", "telemetron"])
@pytest.mark.parametrize("scenario", ["heading0", "heading90", "turn"])
@pytest.mark.parametrize("sea", ["0", "3"])
def test_sound_sensors_are_not_blamed(vessel: str, scenario: str, sea: str) -> None:
    log = run(scenario, vessel, sea, 1)
    assert codes(log, log.z) == set()


def test_a_stated_mounting_is_no_fault() -> None:
    suite = SensorSuite(imu_mounting=(0.3, 0.1, -0.5))
    boat = Vessel.load("usv75")
    log = simulate(
        "heading135", vessel=boat, sea=SeaState.named("2"), duration=90, seed=0, dof=6, suite=suite
    )
    recording = Recording(log.t, log.z, log.cmd, log.t)
    stated = diagnose(recording, particulars_of(boat, suite, 6))
    assert "imu-askew" not in {finding.code for finding in stated.findings}
    found = {finding.code: finding for finding in diagnose(recording).findings}
    evidence = found["imu-askew"].evidence
    # the boat's own heel and trim are within 2 degrees
    assert evidence["roll_rad"] == pytest.approx(0.3, abs=0.05)
    assert evidence["pitch_rad"] == pytest.approx(0.1, abs=0.05)


@pytest.mark.parametrize("scenario", ["heading135", "zigzag"])
def test_waves_are_no_latency_and_no_bias_of_the_gyro(scenario: str) -> None:
    """Roll and pitch are taken out before the other sensors are compared."""
    log = run(scenario, "usv75", "3", 2)
    measured = diagnose(Recording(log.t, log.z, log.cmd, log.t)).measured
    assert measured.gyro is not None
    assert abs(measured.gyro.bias) < 1e-3
    assert measured.imu is None or abs(measured.imu.latency - 0.1) < 0.1


def test_a_log_without_them_has_no_finding() -> None:
    log = run("zigzag")
    z = log.z.copy()
    z[:, MOTION_AT:] = np.nan
    assert codes(log, z) == set()


def test_an_imu_turned_about_its_third_axis_is_measured() -> None:
    boat, suite = Vessel.load("usv75"), SensorSuite(imu_mounting=(0.0, 0.0, 0.3))
    log = simulate(
        "heading135", vessel=boat, sea=SeaState.named("2"), duration=90, seed=0, dof=6, suite=suite
    )
    recording = Recording(log.t, log.z, log.cmd, log.t)
    (found,) = [f for f in diagnose(recording).findings if f.code == "imu-askew"]
    assert found.evidence["yaw_rad"] == pytest.approx(0.3, abs=0.02)
    stated = diagnose(recording, particulars_of(boat, suite, 6))
    assert "imu-askew" not in {finding.code for finding in stated.findings}


def yawed(degrees: float) -> Callable[[np.ndarray], None]:
    return askew(0.0, 0.0, math.radians(degrees))


def pitched(degrees: float) -> Callable[[np.ndarray], None]:
    return askew(0.0, math.radians(degrees), 0.0)


MOUNTED = {
    # fault, names that tell it, and logs of MOTIONS in which it cannot be known without an AHRS
    "forces swapped": (swapped(ACCEL_X, ACCEL_Y), {"accel-swapped"}, ()),
    "roll and pitch rate swapped": (swapped(GYRO_X, GYRO_Y), {"gyro-swapped"}, (0,)),
    "pitch and yaw rate swapped": (swapped(GYRO_Y, GYRO), {"gyro-swapped"}, (0,)),
    "rates in degrees": (
        scaled(180 / math.pi, GYRO_X, GYRO_Y, GYRO),
        {"tilt-unit", "gyro-degrees"},
        (),
    ),
    "two rates in degrees": (scaled(180 / math.pi, GYRO_X, GYRO_Y), {"tilt-unit"}, ()),
    "force ahead in g": (scaled(1 / 9.81, ACCEL_X), {"accel-unit"}, ()),
    "force aside in g": (scaled(1 / 9.81, ACCEL_Y), {"accel-unit"}, ()),
    "force down in g": (scaled(1 / 9.81, ACCEL_Z), {"accel-gravity", "accel-unit"}, ()),
    "aside and down swapped": (swapped(ACCEL_Y, ACCEL_Z), {"accel-swapped"}, ()),
    "climb in cm/s": (scaled(100.0, GPS_VZ), {"climb-unit"}, ()),
    # without AHRS where 85 % of the motion are explained: not in small and in following seas
    "turned to starboard": (yawed(10.0), {"imu-askew"}, (0, 2, 4, 6, 7)),
    "turned to port": (yawed(-10.0), {"imu-askew"}, (0, 2, 4, 6, 7)),
    "bow up": (pitched(5.0), {"imu-askew"}, ()),
    "bow down": (pitched(-5.0), {"imu-askew"}, ()),
}

MOTIONS = (
    *(("usv75", "heading45", "1"), ("usv75", "mission", "1")),
    *(("usv75", "heading45", "2"), ("usv75", "mission", "2")),
    *(("usv75", "heading45", "3"), ("usv75", "mission", "3")),
    *(("otter", "heading45", "1"), ("otter", "mission", "1")),
    *(("otter", "heading45", "2"), ("otter", "mission", "2")),
    *(("otter", "heading45", "3"), ("otter", "mission", "3")),
)
"""Straight runs and lawn mowers."""


@functools.cache
def sailed(which: int) -> Log:
    vessel, scenario, sea = MOTIONS[which]
    return simulate(
        scenario,
        vessel=Vessel.load(vessel),
        sea=SeaState.named(sea),
        duration=150 if scenario != "mission" else 240,
        seed=0,
        dof=6,
    )


def named(log: Log, z: np.ndarray) -> set[str]:
    """Return the codes of errors and warnings of the IMU."""
    found = diagnose(Recording(log.t, z, log.cmd, log.t)).findings
    of_imu = OWN | {"climb-unit", "accel-axes", "accel-mirrored", "gyro-degrees"}
    return {finding.code for finding in found if finding.severity != "note"} & of_imu


def without_ahrs(z: np.ndarray, ahrs: bool) -> np.ndarray:
    z = z.copy()
    if not ahrs:
        z[:, [AHRS_ROLL, AHRS_PITCH]] = np.nan
    return z


@pytest.mark.parametrize("ahrs", [True, False], ids=["ahrs", "no ahrs"])
@pytest.mark.parametrize("which", range(len(MOTIONS)), ids=["-".join(m) for m in MOTIONS])
def test_sound_imus_of_straight_runs_and_lawn_mowers_are_not_blamed(which: int, ahrs: bool) -> None:
    log = sailed(which)
    assert named(log, without_ahrs(log.z, ahrs)) == set()


@pytest.mark.parametrize("ahrs", [True, False], ids=["ahrs", "no ahrs"])
@pytest.mark.parametrize("fault", MOUNTED)
def test_axes_units_and_mounting_are_named(fault: str, ahrs: bool) -> None:
    change, codes_of, blind = MOUNTED[fault]
    missed = []
    for which in range(len(MOTIONS)):
        log = sailed(which)
        z = without_ahrs(log.z, ahrs)
        change(z)
        recording = Recording(log.t, z, log.cmd, log.t)
        found = {finding.code for finding in check_attitude(recording)}
        if fault == "rates in degrees":
            found |= {finding.code for finding in check_heading(recording)}
        if not codes_of & found:
            missed.append((which, found))
    assert [entry for entry in missed if ahrs or entry[0] not in blind] == []


def turned(degrees: float, *columns: int) -> Callable[[np.ndarray], None]:
    def change(z: np.ndarray) -> None:
        c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
        x, y = z[:, columns[0]].copy(), z[:, columns[1]].copy()
        z[:, columns[0]], z[:, columns[1]] = c * x - s * y, s * x + c * y

    return change


def during(first: int, last: int, change: Callable[[np.ndarray], None]) -> Callable[..., None]:
    def partly(z: np.ndarray) -> None:
        part = z[first:last].copy()
        change(part)
        z[first:last] = part

    return partly


SINGLE = {
    # fault, the columns that must be named and no others, and a word of the finding
    "accelerometers to port": (
        turned(90.0, ACCEL_X, ACCEL_Y),
        "accel_x_mps2, accel_y_mps2",
        "by -(8|9)",
    ),
    "accelerometers halfway": (
        turned(45.0, ACCEL_X, ACCEL_Y),
        "accel_x_mps2, accel_y_mps2",
        "by -4",
    ),
    "gyros to port": (turned(90.0, GYRO_X, GYRO_Y), "gyro_x_radps, gyro_y_radps", "by -(8|9)"),
    "roll gyro in degrees": (scaled(180 / math.pi, GYRO_X), "gyro_x_radps", "degrees per second"),
    "pitch gyro in degrees": (scaled(180 / math.pi, GYRO_Y), "gyro_y_radps", "degrees per second"),
    "gyros in mrad/s": (
        scaled(1000.0, GYRO_X, GYRO_Y, GYRO),
        "gyro_x_radps, gyro_y_radps, gyro_radps",
        "mrad/s",
    ),
    "accelerometers too large": (
        scaled(1.1, ACCEL_X, ACCEL_Y, ACCEL_Z),
        "accel_x_mps2, accel_y_mps2, accel_z_mps2",
        "gravity is 1.",
    ),
    "roll gyro reversed for a while": (
        during(1000, 2200, scaled(-1.0, GYRO_X)),
        "gyro_x_radps",
        "from about t =",
    ),
    "height up": (scaled(-1.0, GPS_Z), "gps_z_m", "points up"),
    "height in feet": (scaled(1 / 0.3048, GPS_Z), "gps_z_m", "feet"),
}


@pytest.mark.parametrize("ahrs", [True, False], ids=["ahrs", "no ahrs"])
@pytest.mark.parametrize("vessel", ["otter", "wamv16"])
@pytest.mark.parametrize("fault", SINGLE)
def test_one_cause_gives_one_finding_of_its_columns(fault: str, vessel: str, ahrs: bool) -> None:
    change, columns, word = SINGLE[fault]
    log = simulate(
        "random",
        vessel=Vessel.load(vessel),
        sea=SeaState.named("3"),
        duration=150,
        seed=405,
        dof=6,
    )
    z = without_ahrs(log.z, ahrs)
    change(z)
    findings = check_attitude(Recording(log.t, z, log.cmd, log.t))
    assert [finding.what.split(":")[0] for finding in findings] == [columns]
    assert re.search(word, findings[0].what)


def test_a_fault_of_a_while_names_its_time_and_no_unit() -> None:
    log = run("random", "otter", "3", 406)
    z = log.z.copy()
    during(600, 1200, scaled(2.0, GYRO_Y))(z)
    (found,) = check_attitude(Recording(log.t, z, log.cmd, log.t))
    assert found.code == "axis-faulty"
    assert found.evidence["from_s"] == pytest.approx(30.0, abs=12.0)
    assert found.evidence["to_s"] == pytest.approx(60.0, abs=12.0)
    assert "scale" not in found.remedy
    assert "deg" not in found.remedy


def test_axes_that_hardly_move_are_said_to_be_unchecked() -> None:
    log = run("heading90", "usv75", "1", 1)
    unchecked = diagnose(
        Recording(log.t, without_ahrs(log.z, False), log.cmd, log.t)
    ).measured.unchecked
    moving = run("random", "otter", "3", 406)
    checked = diagnose(Recording(moving.t, moving.z, moving.cmd, moving.t)).measured.unchecked
    assert unchecked is not None
    assert "accel_x_mps2" in unchecked
    assert checked == ()
