"""Sound logs, and faults that are put into them."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable

import numpy as np

from twin.channels import COMMANDS, MEASUREMENTS
from twin.logs.log import Log
from twin.logs.recording import Recording
from twin.particulars import Particulars
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
