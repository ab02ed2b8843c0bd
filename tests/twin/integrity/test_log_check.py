"""Each fault that is put into a sound log is named, and a sound log has none."""

import dataclasses
import functools
import json
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twin.channels import COMMANDS, MEASUREMENTS
from twin.cli.pictures import draw_check
from twin.integrity.findings import ERROR, NOTE, WARNING, Finding
from twin.integrity.instruments import renewed
from twin.integrity.log_check import LogCheck, check_log, check_recording
from twin.integrity.rows import check_silence
from twin.logs.datasets import known_ship
from twin.logs.log import Log, read_table
from twin.logs.recording import Recording
from twin.particulars import Instruments, Particulars, ParticularsError
from twin.sim.bridge import particulars_of, simulate
from usv_gym import SeaState, SensorSuite, Vessel

Columns = dict[str, np.ndarray]
Fault = Callable[[Columns], None]
"""Changes columns of a log in place; ``t_s`` is its time."""

KNOT = 1852.0 / 3600.0

FIX, VELOCITY = ("gps_x_m", "gps_y_m"), ("gps_vx_mps", "gps_vy_mps")
SHAFTS, ANGLES = COMMANDS[:2], COMMANDS[2:]
GYROS = ("gyro_x_radps", "gyro_y_radps", "gyro_radps")
FORCES = ("accel_x_mps2", "accel_y_mps2", "accel_z_mps2")


@functools.cache
def sound(
    vessel: str, scenario: str, hs: float = 0.3, seed: int = 4, dof: int = 3, current: float = 0.0
) -> tuple[Log, Particulars]:
    """Return a simulated log and the particulars of its boat."""
    boat, suite = Vessel.load(vessel), SensorSuite()
    sea = SeaState(hs=hs, wind=3.0, current=current, current_to=1.0)
    log = simulate(scenario, vessel=boat, sea=sea, duration=150.0, seed=seed, suite=suite, dof=dof)
    return log, particulars_of(boat, suite, dof)


def columns_of(log: Log) -> Columns:
    """Return a copy of the columns of a log."""
    columns = {"t_s": log.t.copy(), **dict(zip(COMMANDS, log.cmd.T.copy(), strict=True))}
    return columns | dict(zip(MEASUREMENTS, log.z.T.copy(), strict=True))


def recording(log: Log, *faults: Fault) -> Recording:
    """Return the recording of a log with faults."""
    columns = columns_of(log)
    for fault in faults:
        fault(columns)
    return Recording.of(columns, {}, log.name)


def scaled(factor: float, *names: str, plus: float = 0.0) -> Fault:
    def fault(data: Columns) -> None:
        for name in names:
            data[name] = factor * data[name] + plus

    return fault


def swapped(one: str, other: str) -> Fault:
    def fault(data: Columns) -> None:
        data[one], data[other] = data[other], data[one]

    return fault


def late(seconds: float, *names: str) -> Fault:
    def fault(data: Columns) -> None:
        rows = round(seconds / float(np.median(np.diff(data["t_s"]))))
        for name in names:
            data[name] = np.concatenate([np.full(rows, np.nan), data[name][:-rows]])

    return fault


def turned(degrees: float, *pairs: tuple[str, str]) -> Fault:
    """Turn pairs of columns by an angle from the first to the second."""

    def fault(data: Columns) -> None:
        for pair in pairs:
            x, y = (data[name] for name in pair)
            both = (x + 1j * y) * np.exp(1j * math.radians(degrees))
            data[pair[0]], data[pair[1]] = both.real, both.imag

    return fault


def during(start: float, end: float, change: Fault) -> Fault:
    """Put a fault into a stretch only, s."""

    def fault(data: Columns) -> None:
        inside = (data["t_s"] > start) & (data["t_s"] < end)
        part = {name: values[inside] for name, values in data.items()}
        change(part)
        for name, values in part.items():
            data[name][inside] = values

    return fault


def held(*names: str) -> Fault:
    """Let sensors repeat their first value."""

    def fault(data: Columns) -> None:
        for name in names:
            known = np.isfinite(data[name])
            if known.any():
                data[name][:] = data[name][known][0]

    return fault


def without(*names: str) -> Fault:
    return scaled(math.nan, *names)


def course_in_degrees(data: Columns) -> None:
    speed = np.hypot(*(data[name] for name in VELOCITY))
    course = np.degrees(np.arctan2(data["gps_vy_mps"], data["gps_vx_mps"])) % 360.0
    data["gps_vx_mps"], data["gps_vy_mps"] = speed * np.cos(course), speed * np.sin(course)


def heading_in_degrees(data: Columns) -> None:
    data["compass_rad"] = np.degrees(data["compass_rad"]) % 360.0


def heading_from_east(data: Columns) -> None:
    data["compass_rad"] = 0.5 * math.pi - data["compass_rad"]


def latitude_and_longitude(data: Columns) -> None:
    data["gps_x_m"] = 59.43 + data["gps_x_m"] / 111_000.0
    data["gps_y_m"] = 10.47 + data["gps_y_m"] / 57_000.0


def fixes_aside(data: Columns) -> None:
    for name in FIX:
        data[name][(data["t_s"] > 40.0) & (data["t_s"] < 42.0)] += 500.0


def step_aside(data: Columns) -> None:
    data["gps_y_m"][data["t_s"] > 50.0] += 20.0


def marks(data: Columns) -> None:
    data["compass_rad"][::7] = -999.0


def clock_set_back(data: Columns) -> None:
    data["t_s"] = data["t_s"] - 5.0 * (data["t_s"] > 50.0)


def hour_back(data: Columns) -> None:
    data["t_s"] = data["t_s"] + 4000.0 - 3600.0 * (data["t_s"] > 50.0)


def gap(data: Columns) -> None:
    kept = (data["t_s"] < 60.0) | (data["t_s"] > 64.0)
    for name, values in data.items():
        data[name] = values[kept]


def jitter(data: Columns) -> None:
    step = float(np.median(np.diff(data["t_s"])))
    data["t_s"] = data["t_s"] + step * np.random.default_rng(1).uniform(-0.4, 0.4, len(data["t_s"]))


def stale_rows(data: Columns) -> None:
    for start in range(200, len(data["t_s"]) - 100, 400):
        for name in MEASUREMENTS:
            data[name][start : start + 30] = data[name][start]


FAULTS: dict[str, tuple[str, str, Fault]] = {
    # name: a boat's log in RUNS, code and sensor of its only finding, and the fault
    "gyro in degrees": ("usv75", "unit:gyro", scaled(180.0 / math.pi, "gyro_radps")),
    "gyro to port": ("otter", "sign:gyro", scaled(-1.0, "gyro_radps")),
    "gyro too large": ("usv75", "scale:gyro", scaled(1.3, "gyro_radps")),
    "gyro off zero": ("otter", "bias:gyro", scaled(1.0, "gyro_radps", plus=0.03)),
    "gyro late": ("otter", "late:gyro", late(0.5, "gyro_radps")),
    "gyro stops": ("usv75", "frozen:gyro", during(50.0, 75.0, held("gyro_radps"))),
    "compass in degrees": ("usv75", "unit:compass", heading_in_degrees),
    "compass to port": ("usv75", "sign:compass", scaled(-1.0, "compass_rad")),
    "compass from east": ("otter", "axes:compass", heading_from_east),
    "compass askew": ("otter", "offset:compass", scaled(1.0, "compass_rad", plus=0.6)),
    "compass reversed": ("usv75", "offset:compass", scaled(1.0, "compass_rad", plus=math.pi)),
    "compass late": ("otter", "late:compass", late(0.5, "compass_rad")),
    "north and east swapped": ("otter", "axes:fixes", swapped(*FIX)),
    "fixes in degrees": ("otter", "unit:fixes", latitude_and_longitude),
    "knots": ("usv75", "unit:velocity", scaled(1.0 / KNOT, *VELOCITY)),
    "cm/s": ("otter", "unit:velocity", scaled(100.0, *VELOCITY)),
    "course in degrees": ("usv75", "unit:velocity", course_in_degrees),
    "velocity reversed": ("otter", "sign:velocity", scaled(-1.0, *VELOCITY)),
    "velocity swapped": ("usv75", "axes:velocity", swapped(*VELOCITY)),
    "GPS late": ("usv75", "late:gps", late(0.6, *FIX, *VELOCITY)),
    "accelerometers in g": ("usv75", "unit:accelerometers", scaled(1 / 9.80665, *FORCES[:2])),
    "accelerometers swapped": ("usv75", "axes:accelerometers", swapped(*FORCES[:2])),
    "rpm": ("otter", "unit:shafts", scaled(60.0, *SHAFTS)),
    "pulses": ("otter", "unit:shafts", scaled(10.0, *SHAFTS, plus=1500.0)),
    "angles in degrees": ("usv75", "unit:steering", scaled(180.0 / math.pi, *ANGLES)),
    "angle to port": ("usv75", "sign:steering", scaled(-1.0, *ANGLES)),
    "sides swapped": ("otter", "sides:commands", swapped(*SHAFTS)),
    "thrust reversed": ("otter", "sign:commands", scaled(-1.0, *SHAFTS)),
    "left reversed": ("otter", "sign:left", scaled(-1.0, SHAFTS[0])),
    "no commands": ("otter", "missing:commands", scaled(0.0, *SHAFTS)),
    "milliseconds": ("usv75", "time-unit:time", scaled(1000.0, "t_s")),
    "clock set back": ("usv75", "time:time", clock_set_back),
    "clock set back by an hour": ("otter", "time:time", hour_back),
    "gap": ("otter", "gap:time", gap),
    "jitter": ("usv75", "jitter:time", jitter),
    "stale rows": ("usv75", "frozen:rows", stale_rows),
    "fixes aside": ("usv75", "jump:fix", fixes_aside),
    "marks": ("otter", "mark:compass_rad", marks),
    "dead compass": ("usv75", "dead:compass_rad", held("compass_rad")),
    "dead velocity": ("otter", "dead:gps_vx_mps", held(*VELOCITY)),
}

RUNS = {"usv75": ("usv75", "random", 0.5), "otter": ("otter", "random", 0.1)}

TILTED: dict[str, tuple[str, Fault]] = {
    "all in g": ("unit:accelerometers", scaled(1 / 9.80665, *FORCES)),
    "no gravity": ("unit:accelerometers", scaled(1.0, FORCES[2], plus=9.80665)),
    "z up": ("sign:accelerometers", scaled(-1.0, FORCES[2])),
    "x and z swapped": ("axes:accelerometers", swapped(FORCES[0], FORCES[2])),
    "gravity too large": ("scale:accelerometers", scaled(1.1, *FORCES)),
    "accelerometers turned": ("axes:accelerometers", turned(90.0, FORCES[:2])),
    "gyros swapped": ("axes:gyro", swapped(*GYROS[:2])),
    "pitch rate reversed": ("sign:gyro", scaled(-1.0, GYROS[1])),
    "roll rate in degrees": ("unit:gyro", scaled(180.0 / math.pi, GYROS[0])),
    "roll reversed": ("sign:ahrs", scaled(-1.0, "ahrs_roll_rad")),
    "AHRS in degrees": ("unit:ahrs", scaled(180.0 / math.pi, "ahrs_roll_rad", "ahrs_pitch_rad")),
    "IMU turned": ("axes:imu", turned(10.0, FORCES[:2], GYROS[:2])),
    "IMU heeled": ("axes:imu", turned(12.0, FORCES[1:], GYROS[1:])),
    "climb in cm/s": ("unit:climb", scaled(100.0, "gps_vz_mps")),
    "roll rate stops": ("frozen:gyro_x_radps", during(60.0, 120.0, held(GYROS[0]))),
}


def serious(check: LogCheck) -> set[str]:
    """Return code and sensor of each error and warning."""
    return {f"{f.code}:{f.sensor}" for f in check.findings if f.severity != NOTE}


def finding(check: LogCheck, code: str) -> Finding:
    return next(each for each in check.findings if f"{each.code}:{each.sensor}" == code)


SOUND = (
    ("usv75", "zigzag", 0.5, 3),
    ("usv75", "random", 1.0, 3),
    ("usv75", "straight", 0.3, 3),
    ("otter", "random", 0.0, 3),
    ("otter", "zigzag", 0.2, 3),
    ("wamv16", "turn", 0.2, 3),
    ("kvlcc2_l7", "zigzag", 0.0, 3),
    ("usv75", "heading135", 0.5, 6),
    ("otter", "random", 0.5, 6),
)


@pytest.mark.parametrize(("vessel", "scenario", "hs", "dof"), SOUND)
def test_sound_logs_have_no_finding(vessel: str, scenario: str, hs: float, dof: int) -> None:
    log, boat = sound(vessel, scenario, hs, dof=dof)
    assert serious(check_recording(recording(log), boat)) == set()
    poor = recording(log, without(*VELOCITY, "gyro_radps", "accel_x_mps2", "accel_y_mps2"))
    assert serious(check_recording(poor)) == set()


@pytest.mark.parametrize("vessel", ["otter", "wamv16", "telemetron"])
def test_a_sound_log_without_accelerometers_has_no_finding_in_waves(vessel: str) -> None:
    log, boat = sound(vessel, "turn-zigzag", 0.6, seed=10)
    bare = recording(log, without("accel_x_mps2", "accel_y_mps2"))
    assert serious(check_recording(bare, boat)) == set()


def test_commands_that_never_change_are_said_to_be_unchecked() -> None:
    log, boat = sound("otter", "zigzag", 0.2)
    same = recording(log, scaled(0.0, *COMMANDS[:2], plus=8.0))
    assert finding(check_recording(same, boat), "unchecked:commands").severity == NOTE


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_is_named(name: str) -> None:
    run, code, fault = FAULTS[name]
    log, boat = sound(*RUNS[run])
    found = serious(check_recording(recording(log, fault), boat))
    assert code in found
    assert {each.partition(":")[0] for each in found} == {code.partition(":")[0]}


@pytest.mark.parametrize("name", TILTED)
def test_a_fault_of_roll_pitch_or_heave_is_named(name: str) -> None:
    code, fault = TILTED[name]
    log, boat = sound("otter", "random", 0.5, dof=6)
    assert code in serious(check_recording(recording(log, fault), boat))


def test_a_course_in_degrees_is_named_on_a_boat_that_planes() -> None:
    """It slides in turns, so that only the fixes tell the course."""
    log, boat = sound("telemetron", "zigzag", 0.5)
    assert serious(check_recording(recording(log, course_in_degrees), boat)) == {"unit:velocity"}


def test_a_fix_far_away_that_is_held_is_a_jump_and_no_mark() -> None:
    def hold(data: dict[str, np.ndarray]) -> None:
        for name in FIX:
            data[name][1000:1004] = 700.0

    log, boat = sound(*RUNS["otter"])
    assert serious(check_recording(recording(log, hold), boat)) == {"jump:fix"}


@pytest.mark.parametrize(("knots", "rows"), [(1273.9, 3), (60.0, 1), (60.0, 6)])
@pytest.mark.parametrize("run", ["otter", "usv75"])
def test_an_absurd_velocity_is_named_and_no_other_fault(knots: float, rows: int, run: str) -> None:
    """As MAVLink's unknown speed of 65535 cm/s, or a glitch of the receiver."""

    def glitch(data: dict[str, np.ndarray]) -> None:
        inside = slice(1000, 1000 + rows)
        course = np.arctan2(data[VELOCITY[1]][inside], data[VELOCITY[0]][inside])
        for name, part in zip(VELOCITY, (np.cos, np.sin), strict=True):
            data[name][inside] = knots * 1852.0 / 3600.0 * part(np.nan_to_num(course))

    log, boat = sound(*RUNS[run])
    check = check_recording(recording(log, glitch), boat)
    assert serious(check) == {"mark:velocity"}
    found = finding(check, "mark:velocity")
    assert found.size == pytest.approx(knots * 1852.0 / 3600.0) and f"({knots:g} kn)" in found.what
    assert check.agreed == pytest.approx(check_recording(recording(log), boat).agreed, abs=0.02)


def test_a_velocity_backwards_has_a_wrong_sign_and_no_other_unit() -> None:
    def backwards(data: dict[str, np.ndarray]) -> None:
        for name in VELOCITY:
            data[name] = -data[name]

    log, boat = sound(*RUNS["otter"])
    check = check_recording(recording(log, backwards), boat)
    assert serious(check) == {"sign:velocity"}


def test_a_time_in_minutes_is_named_by_the_speed_of_the_fixes() -> None:
    log, boat = sound(*RUNS["otter"])
    minutes = dataclasses.replace(recording(log), t=log.t / 60.0, stamps=log.t / 60.0)
    assert 'unit = "min"' in finding(check_recording(minutes, boat), "unit:time").remedy


def test_a_compass_that_stops_is_named_though_it_passes_north_elsewhere() -> None:
    log, boat = sound(*RUNS["otter"])

    def stop(data: dict[str, np.ndarray]) -> None:
        heading = np.remainder(data["compass_rad"], 2.0 * math.pi)
        late = log.t >= log.t[0] + 60.0
        rows = np.flatnonzero(late & np.isfinite(heading))
        rows = rows[log.t[rows] < log.t[rows[0]] + 20.0]
        heading[rows] = heading[rows[0]]
        data["compass_rad"] = heading

    check = check_recording(recording(log, stop), boat)
    assert any(each.code == "frozen" and "compass" in each.what for each in check.findings)


@pytest.mark.parametrize("others", [(), ("gyro_radps",)])
@pytest.mark.parametrize(
    ("start", "end"), [(-1.0, 40.0), (60.0, 100.0), (110.0, 1e3), (-1.0, 138.0), (12.0, 1e3)]
)
def test_a_coarse_compass_that_stops_at_an_end_of_the_log_is_named(
    start: float, end: float, others: tuple[str, ...]
) -> None:
    """By the gyro, or without it by the track."""
    log, boat = sound(*RUNS["otter"])
    names = ("compass_rad",)

    def coarse(data: Columns) -> None:
        data["compass_rad"] = np.radians(np.degrees(data["compass_rad"]).round(0))

    faults = coarse, during(start, end, held(*names)), without(*others)
    check = check_recording(recording(log, *faults), boat)
    assert serious(check) == {"frozen:compass"}
    found = finding(check, "frozen:compass")
    assert found.start == pytest.approx(max(start, 0.0), abs=1.5)
    assert found.end == pytest.approx(min(end, log.t[-1]), abs=1.5)


def test_a_coarse_compass_of_a_boat_that_rests_has_not_stopped() -> None:
    rng, t = np.random.default_rng(3), 0.1 * np.arange(2000)
    rate = np.where(t < 120.0, 0.2 * np.sin(0.1 * t), 0.0)
    headings = np.degrees(0.1 * np.cumsum(rate))
    data = {
        "t_s": t,
        "compass_rad": np.radians(headings.round(0)),
        "gyro_radps": rate + 0.02 + 0.01 * rng.standard_normal(len(t)),
        "gps_x_m": rng.standard_normal(len(t)),
        "gps_y_m": rng.standard_normal(len(t)),
    }
    assert not check_silence(Recording.of(data, {}, "rest"))


def each_second(filled: bool) -> Fault:
    """Let the GPS come once a second, with empty cells or repeated ones in between."""

    def fault(data: Columns) -> None:
        rows = np.arange(len(data["t_s"]))
        for name in (*FIX, *VELOCITY):
            last = data[name][rows // 20 * 20]
            data[name] = last if filled else np.where(rows % 20 == 0, last, math.nan)

    return fault


@pytest.mark.parametrize("filled", [False, True])
@pytest.mark.parametrize(("start", "end"), [(59.9, 73.0), (119.9, 1e3)])
@pytest.mark.parametrize("run", RUNS)
def test_a_velocity_that_stops_is_named_where_the_gps_is_slower_than_the_rows(
    run: str, start: float, end: float, filled: bool
) -> None:
    log, boat = sound(*RUNS[run])

    def stop(data: Columns) -> None:
        part = np.isfinite(data[VELOCITY[0]]) & (data["t_s"] > start) & (data["t_s"] < end)
        for name in VELOCITY:
            data[name][part] = data[name][part][0]

    assert serious(check_recording(recording(log, each_second(filled)), boat)) == set()
    check = check_recording(recording(log, each_second(filled), stop), boat)
    assert serious(check) == {"frozen:velocity"}
    assert "the same values" in finding(check, "frozen:velocity").what


def test_the_velocity_of_a_boat_that_rests_is_0_and_not_frozen() -> None:
    rng, t = np.random.default_rng(3), 0.1 * np.arange(1500)
    speed = np.where(t < 75.0, 1.0 + 0.1 * rng.standard_normal(len(t)), 0.0)
    data = {"t_s": t, "gps_x_m": np.cumsum(0.1 * speed) + 0.1 * rng.standard_normal(len(t))}
    data |= {"gps_y_m": 0.1 * rng.standard_normal(len(t))}
    data |= {VELOCITY[0]: speed, VELOCITY[1]: 0.0 * t}
    data["compass_rad"] = 0.01 * rng.standard_normal(len(t))
    assert not check_silence(Recording.of(data, {}, "rest"))


@pytest.mark.parametrize("run", RUNS)
def test_a_coarse_velocity_is_not_frozen_and_its_noise_is_that_of_rounding(run: str) -> None:
    """Of both parts: (0.5 m/s)^2 / 24 along, and (10 degrees times the speed)^2 / 24 across."""

    def coarse(data: Columns) -> None:
        speed = 0.5 * (np.hypot(*(data[name] for name in VELOCITY)) / 0.5).round()
        course = np.arctan2(data[VELOCITY[1]], data[VELOCITY[0]]) / math.radians(10.0)
        course = np.mod(math.radians(10.0) * course.round(), 2.0 * math.pi)  # as a mapping does
        data[VELOCITY[0]], data[VELOCITY[1]] = speed * np.cos(course), speed * np.sin(course)

    log, boat = sound(*RUNS[run])
    check = check_recording(recording(log, coarse), boat)
    assert not any(each.code == "frozen" for each in check.findings)
    typical = float(np.nanmedian(np.hypot(*log.z[:, 2:4].T)))
    rounding = math.hypot(0.5, math.radians(10.0) * typical) / math.sqrt(24.0)
    assert check.instruments.doppler_sd == pytest.approx(rounding, rel=0.3)


@pytest.mark.parametrize("swap", [False, True])
def test_marks_of_pulses_hide_no_swapped_sides(swap: bool, tmp_path: Path) -> None:
    """Of commands in few steps, under a mapping that states another mark."""
    log, boat = sound(*RUNS["otter"])
    data, scale = columns_of(log), float(np.abs(log.cmd[:, :2]).max()) / 400.0
    pulses = [50.0 * ((1500.0 + data[name] / scale) / 50.0).round() for name in SHAFTS]
    for row in range(100, 2900, 100):
        for part in pulses:
            part[row : row + 5] = 65535.0 if row % 200 else 0.0
    given = {"t_s": data["t_s"], **dict(zip(("l", "r"), pulses[:: -1 if swap else 1], strict=True))}
    given |= {name: data[name] for name in (*FIX, *VELOCITY, "compass_rad", "gyro_radps")}
    table = np.column_stack(list(given.values()))
    path, mapping = tmp_path / "run.csv", tmp_path / "run.mapping.toml"
    np.savetxt(path, table, "%.6f", ",", header=",".join(given), comments="")
    more = f"scale = {scale}, offset = {-1500.0 * scale}, empty = [-1.0]"
    lines = [f'n_{side}_rps = {{ from = "{side[0]}", {more} }}' for side in ("left", "right")]
    lines += [f'{name} = "{name}"' for name in given if len(name) > 1]
    mapping.write_text("\n".join(["[columns]", "delta_rad = 0.0", *lines]), encoding="utf-8")
    check = check_log(path, mapping, boat)
    assert serious(check) == ({"sides:commands"} if swap else set())
    assert any("pulses are 0, 65535 us wide" in each for each in check.notes)


def test_marks_among_few_commands_are_named() -> None:
    def unknown(data: Columns) -> None:
        for name in SHAFTS:
            data[name] = 2.0 * (data[name] / 2.0).round()
            data[name][100::50] = 1300.0

    log, boat = sound(*RUNS["otter"])
    assert serious(check_recording(recording(log, unknown), boat)) == {"mark:n_left_rps"}


def test_marks_among_the_commands_are_named_and_no_other_fault() -> None:
    """Pulse widths of 65535 and 0 us, mapped by 0.02 per us from 1500 us."""

    def unknown(data: dict[str, np.ndarray]) -> None:
        for row, pulse in ((1000, 65535.0), (2000, 0.0)):
            for name in COMMANDS[:2]:
                data[name][row : row + 3] = 20.0 * (0.02 * pulse - 30.0)

    log, boat = sound(*RUNS["otter"])
    check = check_recording(recording(log, unknown), boat)
    assert serious(check) == {"mark:n_left_rps"}
    found = finding(check, "mark:n_left_rps")
    assert "empty = [0, 65535]" in found.remedy
    assert (found.start, found.end) == pytest.approx((log.t[1000], log.t[2002]))


def test_remedies_of_scale_and_offset_hold_over_those_of_the_mapping() -> None:
    """A mapping may have scale and offset: a remedy says how these change, not what they are."""
    log, boat = sound(*RUNS["otter"])
    for factor, plus, code in ((-1.0, 0.0, "sign:compass"), (1.0, 0.5, "offset:compass")):
        fault = scaled(factor, "compass_rad", plus=plus)
        remedy = finding(check_recording(recording(log, fault), boat), code).remedy
        assert "scale = " not in remedy and "offset = " not in remedy
        assert remedy.startswith(
            "multiply scale and offset by -1" if factor < 0.0 else "add -0.4"
        ), remedy


@pytest.mark.parametrize(("degrees", "severity"), [(70.0, WARNING), (123.0, ERROR)])
def test_a_heading_that_points_backwards_is_an_error(degrees: float, severity: str) -> None:
    log, boat = sound("otter", "random", 0.1, current=0.2)
    fault = scaled(1.0, "compass_rad", plus=math.radians(degrees))
    check = check_recording(recording(log, fault), boat)
    assert finding(check, "offset:compass").severity == severity


def test_a_boat_that_rests_and_sails_for_a_moment_is_not_absurd() -> None:
    boat = sound(*RUNS["otter"])[1]
    t = np.arange(0.0, 150.0, 0.1)
    speed = np.where((t > 100.0) & (t < 101.2), 4.0, 0.0)
    data = {"t_s": t, "gps_x_m": np.cumsum(0.1 * speed) + 0.01 * np.sin(7.0 * t)}
    data |= {"gps_y_m": 0.01 * np.cos(7.0 * t), "compass_rad": 0.01 * np.sin(3.0 * t)}
    data |= {VELOCITY[0]: speed, VELOCITY[1]: 0.01 * np.sin(t), **dict.fromkeys(COMMANDS, 0.0 * t)}
    check = check_recording(Recording.of(data, {}, "log"), boat)
    assert not any(each.code == "mark" for each in check.findings)


def test_a_step_aside_is_named_with_its_size_and_time() -> None:
    log, boat = sound(*RUNS["otter"])
    found = finding(check_recording(recording(log, step_aside), boat), "jump:fix")
    assert found.size == pytest.approx(20.0, abs=1.5)
    assert found.start == pytest.approx(50.0, abs=1.0)


@settings(max_examples=6, deadline=None)
@given(scale=st.floats(0.4, 2.5).filter(lambda s: abs(s - 1.0) > 0.2))
def test_the_scale_of_a_gyro_lies_in_its_interval(scale: float) -> None:
    log, boat = sound(*RUNS["usv75"])
    found = finding(
        check_recording(recording(log, scaled(scale, "gyro_radps")), boat), "scale:gyro"
    )
    assert found.size == pytest.approx(1.0 / scale, rel=0.03)
    assert found.low < found.size < found.high


@pytest.mark.parametrize("degrees", [-20.0, 15.0, 70.0])
def test_a_turned_compass_is_measured_in_current(degrees: float) -> None:
    """Legs in several directions tell it from current and leeway."""
    log, boat = sound("otter", "random", 0.1, current=0.2)
    fault = scaled(1.0, "compass_rad", plus=math.radians(degrees))
    check = check_recording(recording(log, fault), boat)
    found = finding(check, "offset:compass")
    assert math.degrees(found.size) == pytest.approx(-degrees, abs=4.0)
    assert serious(check) == {"offset:compass"}


def test_one_heading_does_not_tell_whether_the_compass_is_off() -> None:
    log, _ = sound("otter", "straight", 0.1)
    check = check_recording(recording(log))
    assert finding(check, "unchecked:compass").severity == NOTE


def test_a_rival_that_explains_as_much_is_named() -> None:
    """Without a velocity, fixes that go backwards look like a compass back to front."""
    log, boat = sound(*RUNS["otter"])
    fault = scaled(1.0, "compass_rad", plus=math.pi)
    bare = recording(log, fault, without(*VELOCITY, "accel_x_mps2", "accel_y_mps2"))
    (found,) = (f for f in check_recording(bare, boat).findings if f.severity != NOTE)
    assert "or else" in found.remedy


# --- instruments ------------------------------------------------------------------------------


def test_latency_and_noise_of_the_instruments_are_estimated() -> None:
    log, boat = sound("usv75", "random", 1.0)
    check = check_recording(recording(log, late(0.4, *FIX, *VELOCITY)), boat)
    instruments = check.instruments
    assert instruments.gps_latency == pytest.approx(0.5, abs=0.06)  # 0.1 s of its own
    assert instruments.doppler_sd == pytest.approx(0.05, rel=0.2)
    assert instruments.compass_sd == pytest.approx(math.radians(0.4), rel=0.1)
    assert instruments.gyro_sd == pytest.approx(math.radians(0.05), rel=0.1)
    assert "gps_bias_sd" not in check.reasons
    assert instruments.gps_bias_sd == Instruments().gps_bias_sd


def test_written_particulars_are_read_back(tmp_path: Path) -> None:
    log, boat = sound(*RUNS["usv75"])
    check = check_recording(recording(log), boat)
    path = tmp_path / "boat.toml"
    text, _ = renewed(check.particulars_text(), boat.to_toml())
    path.write_text(text, encoding="utf-8")
    back = Particulars.load(path)
    assert dataclasses.replace(back, instruments=boat.instruments) == boat
    assert back.instruments == check.instruments


def test_unknown_particulars_are_to_be_filled_in(tmp_path: Path) -> None:
    log, _ = sound(*RUNS["otter"])
    path = tmp_path / "boat.toml"
    text = check_recording(recording(log)).particulars_text()
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ParticularsError, match="length, beam, draft, mass"):
        Particulars.load(path)
    for key in ("length", "beam", "draft", "mass"):
        text = text.replace(f"# {key} = ?", f"{key} = {300.0 if key == 'mass' else 1.0}")
    path.write_text(text, encoding="utf-8")
    assert Particulars.load(path).steering == "differential"


# --- any rows ---------------------------------------------------------------------------------

COLUMNS = (*COMMANDS, *MEASUREMENTS)


@settings(max_examples=40, deadline=None)
@given(data=st.data(), seed=st.integers(0, 2**32 - 1), rows=st.integers(0, 400))
def test_any_columns_give_findings(data: st.DataObject, seed: int, rows: int) -> None:
    """Noise, constants, holes, steps and numbers of any size: no error, and a report in JSON."""
    rng = np.random.default_rng(seed)
    kinds: dict[str, Callable[[], np.ndarray]] = {
        "noise": lambda: rng.standard_normal(rows),
        "walk": lambda: np.cumsum(rng.standard_normal(rows)),
        "constant": lambda: np.full(rows, rng.standard_normal()),
        "zero": lambda: np.zeros(rows),
        "ramp": lambda: np.linspace(0.0, 100.0, rows),
        "holes": lambda: np.where(rng.random(rows) < 0.7, np.nan, rng.standard_normal(rows)),
        "late": lambda: np.where(np.arange(rows) < 0.9 * rows, np.nan, rng.standard_normal(rows)),
        "steps": lambda: np.repeat(rng.standard_normal(rows), 7)[:rows],
        "huge": lambda: 1e300 * rng.standard_normal(rows),
        "infinite": lambda: np.where(rng.random(rows) < 0.1, np.inf, rng.standard_normal(rows)),
        "none": lambda: np.full(rows, np.nan),
    }
    times: dict[str, Callable[[], np.ndarray]] = {
        "even": lambda: 0.1 * np.arange(rows),
        "rough": lambda: np.cumsum(rng.exponential(0.2, rows)),
        "gaps": lambda: np.cumsum(np.where(rng.random(rows) < 0.05, 40.0, 0.1)),
        "years": lambda: np.cumsum(np.where(rng.random(rows) < 0.01, 1e9, 0.1)),
        "back": lambda: 0.1 * np.arange(rows) + 0.5 * rng.standard_normal(rows),
        "holes": lambda: np.where(rng.random(rows) < 0.2, np.nan, np.arange(rows)),
    }
    names = data.draw(st.sets(st.sampled_from(COLUMNS)))
    table = {name: kinds[data.draw(st.sampled_from(sorted(kinds)))]() for name in sorted(names)}
    table["t_s"] = times[data.draw(st.sampled_from(sorted(times)))]()
    check = check_recording(Recording.of(table, {}, "any"))
    json.dumps(check.to_json(), allow_nan=False)
    check.particulars_text()
    if rows > 1 and seed % 10 == 0:
        assert draw_check(check).startswith(b"\x89PNG")


@pytest.mark.parametrize("name", ["gps_x_m", "compass_rad", "gyro_radps", "accel_z_mps2"])
def test_a_channel_of_absurd_size_gives_findings(name: str) -> None:
    log, _ = sound("otter", "random", 0.5, dof=6)
    check = check_recording(recording(log, scaled(1e300, name)))
    json.dumps(check.to_json(), allow_nan=False)


def test_a_wild_stamp_costs_no_more_than_its_row() -> None:
    log, boat = sound(*RUNS["otter"])
    columns = columns_of(log)
    columns["t_s"][1000] += 1.7e9
    found = check_recording(Recording.of(columns, {}, "log"), boat)
    assert "time:time" in serious(found)
    assert len(found.recording.t) == len(log) - 1


# --- what others recorded ---------------------------------------------------------------------

DATA = Path(__file__).resolve().parents[3].parent / "shared" / "data"

BOATS = {"otter_oslofjord": "otter.toml", "blueboat_trondheim": "blueboat.toml"}

RECORDED = {
    # what may be said of the runs of a folder, as their READMEs say
    "otter_oslofjord": {"jitter", "gap", "frozen", "lost", "jump", "contradiction"},
    "blueboat_trondheim": {"jump", "contradiction"},
    "boat1_usv": {"jitter"},
    "kvlcc2_simman2008": {"contradiction"},
    "esso_osaka_frt": {"jump", "contradiction", "frozen"},
}


def checked(folder: str, run: str, change: Callable[[dict[str, np.ndarray]], None]) -> LogCheck:
    path = DATA / folder / f"{run}.csv.gz"
    if not path.exists():
        pytest.skip(f"{path} is absent: recorded runs are not part of the project")
    table = read_table(path)
    change(table.data)
    boat = Particulars.load(DATA / folder / BOATS[folder]) if folder in BOATS else known_ship(path)
    return check_recording(Recording.of(table.data, table.given, run, table.plane), boat)


def runs() -> list[tuple[str, str]]:
    names = [
        (folder, path.name.removesuffix(".csv.gz"))
        for folder in RECORDED
        for path in sorted((DATA / folder).glob("*.csv.gz"))
    ]
    return names or [("otter_oslofjord", "any")]


@pytest.mark.parametrize(("folder", "run"), runs())
def test_recorded_runs_have_no_false_alarm(folder: str, run: str) -> None:
    found = checked(folder, run, lambda data: None).findings
    said = {each.code for each in found if each.severity != NOTE}
    assert said <= RECORDED[folder], [each.text for each in found]
    assert all(each.severity in (NOTE, WARNING) for each in found)


def test_stalls_of_the_otter_are_named() -> None:
    """Its README: the logger wrote old samples with new times."""
    found = finding(checked("otter_oslofjord", "otter_16-07-36", lambda data: None), "frozen:rows")
    assert found.size > 2.0


@pytest.mark.parametrize("run", ["blueboat_223", "blueboat_225", "blueboat_234"])
def test_swapped_sides_of_the_blueboat_are_named(run: str) -> None:
    """Its source has left and right swapped; the runs are put right."""
    assert "sides:commands" in serious(checked("blueboat_trondheim", run, swapped(*SHAFTS)))


# --- what turns a verdict ------------------------------------------------------------------------


def constant(name: str, value: float) -> Callable[[dict[str, np.ndarray]], None]:
    def fault(data: dict[str, np.ndarray]) -> None:
        data[name] = np.full(len(data["t_s"]), value)

    return fault


@pytest.mark.parametrize("name", ["gps_z_m", "gps_vz_mps", "ahrs_roll_rad", "wind_mps"])
def test_a_dead_column_that_the_twin_does_without_is_a_note(name: str) -> None:
    log, boat = sound(*RUNS["otter"])
    found = check_recording(recording(log, constant(name, -1.0)), boat)
    assert serious(found) == set()
    assert finding(found, f"dead:{name}").severity == NOTE


@pytest.mark.parametrize("name", ["gps_z_m", "gps_vz_mps", "ahrs_pitch_rad"])
def test_a_fault_of_a_column_that_the_twin_does_without_is_no_error(name: str) -> None:
    log, boat = sound("otter", "random", 0.5, dof=6)
    found = check_recording(recording(log, scaled(100.0, name)), boat)
    assert {each.severity for each in found.findings} <= {WARNING, NOTE}


def of_several_rates(held_over: bool) -> Callable[[dict[str, np.ndarray]], None]:
    """Leave each sensor some rows of its own, at a regular rate, as a union of topics has them."""

    def fault(data: dict[str, np.ndarray]) -> None:
        rows = np.arange(len(data["t_s"]))
        periods = {FIX: (5, 0), VELOCITY: (5, 0), ("compass_rad",): (4, 1), ("gyro_radps",): (6, 2)}
        some = np.zeros(len(rows), dtype=bool)
        for names, (period, phase) in periods.items():
            own = rows % period == phase
            some |= own
            for name in names:
                values = np.where(own, data[name], np.nan)
                if held_over:
                    last = np.maximum.accumulate(np.where(own, rows, 0))
                    values = np.where(rows < phase, np.nan, data[name][last])
                data[name] = values
        without("accel_x_mps2", "accel_y_mps2")(data)
        for name, values in data.items():
            data[name] = values[some]

    return fault


@pytest.mark.parametrize("held_over", [False, True])
def test_regular_sensors_whose_rows_are_a_union_have_no_jitter(held_over: bool) -> None:
    log, boat = sound(*RUNS["usv75"])
    found = check_recording(recording(log, of_several_rates(held_over)), boat)
    assert np.std(np.diff(found.recording.t)) > 0.01
    assert "jitter:time" not in serious(found)


def test_sensors_whose_own_stamps_jitter_are_named() -> None:
    log, boat = sound(*RUNS["usv75"])
    rng = np.random.default_rng(2)

    def rough_fixes(data: dict[str, np.ndarray]) -> None:
        of_several_rates(False)(data)
        fixes = np.isfinite(data["gps_x_m"]) & np.isnan(data["compass_rad"])
        data["t_s"][fixes] += rng.uniform(-0.024, 0.024, fixes.sum())

    what = finding(check_recording(recording(log, rough_fixes), boat), "jitter:time").what
    assert "fix" in what and "compass" not in what
