"""One fault has one finding: what follows from a fault is not named beside it."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable

import numpy as np
import pytest

from twin.channels import COMMANDS, MEASUREMENTS
from twin.logs.datum import Plane
from twin.logs.diagnosis.diagnose import diagnose
from twin.logs.diagnosis.findings import ERROR, NOTE, Finding, Recording
from twin.logs.diagnosis.position import find_jumps
from twin.sim.bridge import simulate
from usv_gym import SeaState, Vessel

X, Y, VX, VY, PSI = range(5)

Fault = Callable[[np.ndarray, np.ndarray, np.ndarray], None]
"""Changes measurements and commands in place; the first array is the time."""


@functools.cache
def simulated(vessel: str, manoeuvre: str = "zigzag", seed: int = 4) -> Recording:
    sea = SeaState(hs=0.1, wind=2.0)
    ship = Vessel.load(vessel)
    log = simulate(manoeuvre, vessel=ship, sea=sea, duration=150.0, seed=seed)
    return Recording(log.t, log.z, log.cmd, log.t)


def found_with(fault: Fault, vessel: str = "otter", manoeuvre: str = "zigzag") -> list[Finding]:
    sound = simulated(vessel, manoeuvre)
    z, cmd = sound.z.copy(), sound.cmd.copy()
    fault(sound.t, z, cmd)
    return list(diagnose(dataclasses.replace(sound, z=z, cmd=cmd)).findings)


def serious(findings: list[Finding]) -> list[str]:
    return [finding.code for finding in findings if finding.severity != NOTE]


@pytest.mark.parametrize("vessel", ["otter", "wamv16"])
@pytest.mark.parametrize("manoeuvre", ["zigzag", "random"])
def test_sound_log_has_no_finding(vessel: str, manoeuvre: str) -> None:
    assert serious(found_with(lambda t, z, cmd: None, vessel, manoeuvre)) == []


@pytest.mark.parametrize("vessel", ["otter", "wamv16"])
@pytest.mark.parametrize("side", [0, 1])
def test_reversed_thruster_of_a_zigzag_is_named_and_the_compass_is_not(
    vessel: str, side: int
) -> None:
    """The total of the commands turns about, while the boat goes ahead all the time."""

    def fault(t: np.ndarray, z: np.ndarray, cmd: np.ndarray) -> None:
        cmd[:, side] *= -1.0

    assert serious(found_with(fault, vessel)) == [f"{('left', 'right')[side]}-sign"]


@pytest.mark.parametrize("scale", [-1.0, -0.5, 0.3])
def test_commands_do_not_change_the_offset_of_a_compass(scale: float) -> None:
    """Course and heading agree by themselves, whatever one thruster is said to do."""

    def fault(t: np.ndarray, z: np.ndarray, cmd: np.ndarray) -> None:
        cmd[:, 0] *= scale

    assert not {"compass-offset", "compass-reversed"} & set(serious(found_with(fault)))


@pytest.mark.parametrize("degrees", [70.0, 90.0, -90.0, 120.0])
@pytest.mark.parametrize("vessel", ["otter", "wamv16"])
def test_turned_compass_is_named_alone(degrees: float, vessel: str) -> None:
    def fault(t: np.ndarray, z: np.ndarray, cmd: np.ndarray) -> None:
        z[:, PSI] += math.radians(degrees)

    assert serious(found_with(fault, vessel)) == ["compass-offset"]


COMPASS_RUNS = (
    # vessel, manoeuvre, speed of the current, m/s, and where it goes, rad
    ("usv75", "zigzag", 0.2, 1.0),
    ("usv75", "random", 0.2, 4.0),
    ("otter", "turn-zigzag", 0.2, 2.0),
    ("otter", "random", 0.1, 5.0),
    ("wamv16", "turn-zigzag", 0.2, 0.5),
    ("wamv16", "mission", 0.1, 3.0),
)


@functools.cache
def in_current(run: int) -> Recording:
    vessel, manoeuvre, current, to = COMPASS_RUNS[run]
    sea = SeaState(hs=0.1, wind=3.0, current=current, current_to=to)
    log = simulate(manoeuvre, vessel=Vessel.load(vessel), sea=sea, duration=200.0, seed=run)
    return Recording(log.t, log.z, log.cmd, log.t)


@pytest.mark.parametrize("run", range(len(COMPASS_RUNS)))
@pytest.mark.parametrize("degrees", [-15.0, 0.0, 15.0])
def test_compass_that_is_off_is_named_with_its_angle(run: int, degrees: float) -> None:
    """Legs in several directions tell it from current and leeway."""
    sound = in_current(run)
    z = sound.z.copy()
    z[:, PSI] += math.radians(degrees)
    found = diagnose(dataclasses.replace(sound, z=z))
    fit = found.measured.track
    assert fit is not None and fit.is_known
    assert abs(math.degrees(fit.legs) + degrees) < 4.0
    assert serious(list(found.findings)) == (["compass-offset"] if degrees else [])


def test_one_heading_does_not_tell_whether_the_compass_is_off() -> None:
    fit = diagnose(simulated("otter", "straight")).measured.track
    assert fit is not None and not fit.is_known


def test_turned_accelerometers_are_still_named() -> None:
    def fault(t: np.ndarray, z: np.ndarray, cmd: np.ndarray) -> None:
        ax, ay = MEASUREMENTS.index("accel_x_mps2"), MEASUREMENTS.index("accel_y_mps2")
        z[:, ax], z[:, ay] = -z[:, ay].copy(), z[:, ax].copy()

    assert "accel-axes" in serious(found_with(fault))


@pytest.mark.parametrize("size", [10.0, 24.0])
@pytest.mark.parametrize("share", [0.03, 0.15])
def test_spikes_are_counted(size: float, share: float) -> None:
    counts = []

    def fault(t: np.ndarray, z: np.ndarray, cmd: np.ndarray) -> None:
        rng = np.random.default_rng(2)
        rows = np.flatnonzero(np.isfinite(z[:, X]) & (t > 30.0) & (t < 100.0))
        rows = rows[rng.random(len(rows)) < share]
        angle = rng.uniform(0.0, 2.0 * math.pi, len(rows))
        z[rows, X] += size * np.cos(angle)
        z[rows, Y] += size * np.sin(angle)
        counts.append(len(rows))

    found = {finding.code: finding for finding in found_with(fault)}
    spikes = found["fix-spikes"].evidence
    assert abs(spikes["fixes"] - counts[0]) <= 0.05 * counts[0] + 1
    assert abs(spikes["most_m"] / size - 1.0) < 0.2
    assert 30.0 <= spikes["from_s"] < spikes["until_s"] <= 100.0


@pytest.mark.parametrize("side", [0, 1])
@pytest.mark.parametrize("manoeuvre", ["zigzag", "random"])
def test_command_that_is_zero_throughout_is_named(side: int, manoeuvre: str) -> None:
    def fault(t: np.ndarray, z: np.ndarray, cmd: np.ndarray) -> None:
        cmd[:, side] = 0.0

    found = found_with(fault, "otter", manoeuvre)
    assert serious(found) == [f"{('left', 'right')[side]}-unit-dead"]
    assert "is 0 in all rows while the boat sails" in found[0].what


def test_course_in_the_wrong_unit_feigns_no_unit_of_speed() -> None:
    def fault(t: np.ndarray, z: np.ndarray, cmd: np.ndarray) -> None:
        speed, course = np.hypot(z[:, VX], z[:, VY]), np.arctan2(z[:, VY], z[:, VX])
        course = np.degrees(course) % 360.0
        z[:, VX], z[:, VY] = speed * np.cos(course), speed * np.sin(course)

    assert serious(found_with(fault, "otter", "turn")) == ["course-unit"]


def test_swapped_fixes_feign_no_fault_of_the_velocity() -> None:
    def fault(t: np.ndarray, z: np.ndarray, cmd: np.ndarray) -> None:
        z[:, [X, Y]] = z[:, [Y, X]]

    assert serious(found_with(fault, "otter", "random")) == ["track-mirrored"]


@pytest.mark.parametrize("mark", [-999.0, 999.0, -9999.0, 9999.0])
@pytest.mark.parametrize("unit", [1.0, math.radians(1.0)])
def test_marks_for_no_value_are_named_alone(mark: float, unit: float) -> None:
    """Before, they were taken for faults of the sensor, or of its unit."""

    def fault(t: np.ndarray, z: np.ndarray, cmd: np.ndarray) -> None:
        z[::7, PSI] = mark * unit

    found = found_with(fault)
    assert serious(found) == ["no-value-compass_rad"]
    assert f"{mark:g}" in found[0].what


@pytest.mark.parametrize("length", [10.0, 25.0])
@pytest.mark.parametrize("scatter", [0.0, 0.05])
def test_fixes_that_stand_and_catch_up_are_named(length: float, scatter: float) -> None:
    def fault(t: np.ndarray, z: np.ndarray, cmd: np.ndarray) -> None:
        rows = np.flatnonzero((t > 60.0) & (t < 60.0 + length) & np.isfinite(z[:, X]))
        noise = scatter * np.random.default_rng(1).standard_normal((len(rows), 2))
        z[rows[:, None], [X, Y]] = z[rows[0], [X, Y]] + noise
        z[:, [VX, VY]] = np.nan

    found = {finding.code: finding for finding in found_with(fault)}
    code = "fix-stands" if scatter else "fix-frozen"
    assert abs(found[code].evidence["longest_s"] - length) < 1.5
    assert "fix-steps" not in found


@pytest.mark.parametrize("vessel", ["otter", "usv75"])
@pytest.mark.parametrize("velocity", [True, False])
def test_fixes_that_stand_to_the_end_are_named(vessel: str, velocity: bool) -> None:
    """They never catch up: velocity or commands say that the boat goes."""

    def fault(t: np.ndarray, z: np.ndarray, cmd: np.ndarray) -> None:
        rows = np.flatnonzero((t > 125.0) & np.isfinite(z[:, X]))
        noise = 0.05 * np.random.default_rng(1).standard_normal((len(rows), 2))
        z[rows[:, None], [X, Y]] = z[rows[0], [X, Y]] + noise
        if velocity:
            cmd[:] = 0.0
        else:
            z[:, [VX, VY]] = np.nan

    found = {finding.code: finding for finding in found_with(fault, vessel)}
    assert found["fix-stands"].evidence["longest_s"] > 15.0
    assert 115.0 < found["fix-stands"].evidence["at_s"] < 135.0


@pytest.mark.parametrize("velocity", [True, False])
def test_fixes_that_stand_for_long_are_the_only_error(velocity: bool) -> None:
    """The jump that ends a stand is no jump, and the velocity over ground is sound."""

    def fault(t: np.ndarray, z: np.ndarray, cmd: np.ndarray) -> None:
        rows = np.flatnonzero((t > 50.0) & (t < 110.0) & np.isfinite(z[:, X]))
        noise = 0.05 * np.random.default_rng(1).standard_normal((len(rows), 2))
        z[rows[:, None], [X, Y]] = z[rows[0], [X, Y]] + noise
        if not velocity:
            z[:, [VX, VY]] = np.nan

    (found,) = (each for each in found_with(fault, "usv75") if each.severity != NOTE)
    assert (found.code, found.severity) == ("fix-stands", ERROR)
    assert found.evidence["most_m"] > 50.0
    assert abs(found.evidence["at_s"] - 50.0) < 2.0
    assert abs(found.evidence["until_s"] - 110.0) < 2.0


def test_a_velocity_is_not_blamed_for_fixes_that_stand_to_the_end() -> None:
    def fault(t: np.ndarray, z: np.ndarray, cmd: np.ndarray) -> None:
        rows = np.flatnonzero((t > 100.0) & np.isfinite(z[:, X]))
        noise = 0.05 * np.random.default_rng(1).standard_normal((len(rows), 2))
        z[rows[:, None], [X, Y]] = z[rows[0], [X, Y]] + noise

    assert serious(found_with(fault)) == ["fix-stands"]


@pytest.mark.parametrize("manoeuvre", ["zigzag", "random"])
def test_exchanged_latitude_and_longitude_are_the_only_finding(manoeuvre: str) -> None:
    """The speed over ground tells it, also on a straight track, and is not blamed."""
    sound = simulated("otter", manoeuvre)
    latitude, longitude = Plane(63.4, 10.4).degrees(*sound.z[:, [X, Y]].T)
    wrong = Plane(10.4, 63.4)
    z = sound.z.copy()
    z[:, [X, Y]] = np.column_stack(wrong.metres(longitude, latitude))
    found = diagnose(dataclasses.replace(sound, z=z, plane=wrong)).findings
    assert serious(list(found)) == ["position-exchanged"]
    found = diagnose(dataclasses.replace(sound, plane=Plane(63.4, 10.4))).findings
    assert serious(list(found)) == []


def test_a_false_fix_of_a_boat_that_stopped_is_left_out() -> None:
    t = np.arange(0.0, 300.0, 0.2)
    x = 0.3 * np.cumsum((t < 100.0) | (t > 180.0))
    fix = np.column_stack([x, np.zeros_like(x)])
    fix += 0.05 * np.random.default_rng(0).standard_normal(fix.shape)
    fix[800, 1] += 100.0
    jumps = find_jumps(t, fix)
    assert jumps is not None
    assert jumps.lost.tolist() == [800]


def test_a_boat_that_is_stopped_does_not_stand_by_fault() -> None:
    def stopped(t: np.ndarray, z: np.ndarray, cmd: np.ndarray) -> None:
        rows = np.flatnonzero((t > 100.0) & np.isfinite(z[:, X]))
        noise = 0.05 * np.random.default_rng(1).standard_normal((len(rows), 2))
        z[rows[:, None], [X, Y]] = z[rows[0], [X, Y]] + noise
        z[t > 100.0, VX : VY + 1] *= 0.01
        cmd[t > 100.0] = 0.0

    assert "fix-stands" not in {finding.code for finding in found_with(stopped)}


def with_stamps(stamps: np.ndarray, vessel: str = "otter") -> list[Finding]:
    sound = simulated(vessel)
    data = {"t_s": stamps, **dict(zip(MEASUREMENTS, sound.z.T, strict=True))}
    data |= dict(zip(COMMANDS, sound.cmd.T, strict=True))
    return list(diagnose(Recording.of(data, {}, "log")).findings)


@pytest.mark.parametrize("seconds", [0.5, 3.0, 20.0])
def test_a_clock_set_back_is_the_only_finding(seconds: float) -> None:
    t = simulated("otter").t
    (found,) = (each for each in with_stamps(t - seconds * (t > 60.0)) if each.severity != NOTE)
    assert found.code == "time-back"
    assert found.evidence["set_back_s"] == pytest.approx(seconds, abs=0.02)
    assert f"add {seconds:.2f} s to all later stamps" in found.remedy


def test_single_rows_out_of_order_are_to_be_sorted() -> None:
    t = simulated("otter").t.copy()
    t[[500, 501, 900, 901]] = t[[501, 500, 901, 900]]
    found = {each.code: each for each in with_stamps(t)}
    assert "sort the rows by time" in found["time-back"].remedy
    # a log that starts again is no clock that was set
    t = simulated("otter").t
    found = {each.code: each for each in with_stamps(np.where(t > 75.0, t - 75.0, t))}
    assert "set_back_s" not in found["time-back"].evidence


def test_a_clock_set_forward_is_no_gap() -> None:
    sound = simulated("usv75")
    t, length = sound.t, 10.0
    found = {each.code: each for each in with_stamps(t + length * (t > 60.0), "usv75")}
    assert "the clock was set forward" in found["time-gaps"].remedy
    kept = (t < 60.0) | (t > 60.0 + length)
    parts = {"t": t[kept], "stamps": t[kept], "z": sound.z[kept], "cmd": sound.cmd[kept]}
    found = {each.code: each for each in diagnose(dataclasses.replace(sound, **parts)).findings}
    assert "the clock was set forward" not in found["time-gaps"].remedy


@pytest.mark.parametrize("columns", [(5,), (PSI,), (VX, VY)])
def test_a_dead_sensor_is_named_once(columns: tuple[int, ...]) -> None:
    def fault(t: np.ndarray, z: np.ndarray, cmd: np.ndarray) -> None:
        seen = np.isfinite(z[:, columns[0]])
        for column in columns:
            z[seen, column] = 0.0

    assert serious(found_with(fault)) == ["sensor-dead"]


def test_rows_out_of_order_are_not_too_few() -> None:
    sound = simulated("otter")
    order = np.random.default_rng(0).permutation(len(sound.t))
    data = {name: sound.z[order, j] for j, name in enumerate(MEASUREMENTS)}
    data["t_s"] = sound.t[order]
    found = list(diagnose(Recording.of(data, {}, "log")).findings)
    assert serious(found) == ["time-back"]


def test_few_rows_are_too_few() -> None:
    sound = simulated("otter")
    data = {name: sound.z[:10, j] for j, name in enumerate(MEASUREMENTS)}
    data["t_s"] = sound.t[:10]
    assert "too-short" in serious(list(diagnose(Recording.of(data, {}, "log")).findings))


@pytest.mark.parametrize("columns", [(VX, VY), (VX,), (VY,)])
def test_marks_for_no_value_in_a_velocity_are_named(columns: tuple[int, ...]) -> None:
    def marked(t: np.ndarray, z: np.ndarray, cmd: np.ndarray) -> None:
        for j in columns:
            z[50:900:40, j] = -999.0

    names = {MEASUREMENTS[j] for j in columns}
    codes = set(serious(found_with(marked)))
    assert codes and codes <= {f"no-value-{name}" for name in names}


def test_a_heading_of_99_degrees_is_no_mark() -> None:
    def whole(t: np.ndarray, z: np.ndarray, cmd: np.ndarray) -> None:
        z[:, PSI] = np.radians(np.round(np.degrees(z[:, PSI])))
        z[100:400:100, PSI] = np.radians(99.0)

    assert "no-value-compass_rad" not in serious(found_with(whole))
