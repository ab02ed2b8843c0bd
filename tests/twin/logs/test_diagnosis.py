"""Every fault that is put into a sound log is named, and a sound log has none."""

from __future__ import annotations

import dataclasses
import functools
import json
import math
from collections.abc import Callable, Collection
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.twin.logs.log_faults import (
    Fault,
    changed,
    clock_set_back,
    course_as_radians,
    degrees_wrapped,
    frozen,
    gaps,
    jitter,
    jump,
    late_by,
    milliseconds,
    no_fix,
    stale,
    swapped_latitude,
    to_latitude,
)
from twin.channels import COMMANDS, MEASUREMENTS
from twin.cli.pictures import draw_check
from twin.logs.check import LogCheck
from twin.logs.datasets import known_ship
from twin.logs.diagnosis.diagnose import Diagnosis, diagnose
from twin.logs.diagnosis.findings import ERROR, NOTE, Finding, Recording
from twin.logs.diagnosis.heading import gyro_on_compass
from twin.logs.diagnosis.instruments import estimate_instruments, particulars_text
from twin.logs.diagnosis.signals import best_lag, fit_line, white_noise
from twin.logs.log import Log, read_table
from twin.particulars import Instruments, Particulars, ParticularsError
from twin.sim.bridge import particulars_of, simulate
from twin.sim.wrapper import log_of
from usv_gym import SeaState, Vessel
from usv_gym.world.sensors import SensorSuite

KNOT = 1852.0 / 3600.0
X, Y, VX, VY, PSI, R, AX, AY = range(8)

CASES = (
    # vessel, manoeuvre, Hs, wind, seed, sensors that differ
    ("usv75", "zigzag", 0.5, 4.5, 0, {}),
    ("usv75", "zigzag", 1.5, 9.0, 1, {}),
    ("usv75", "turn", 0.0, 0.0, 2, {}),
    ("usv75", "turn", 0.8, 6.0, 3, {}),
    ("usv75", "random", 0.0, 0.0, 4, {}),
    ("usv75", "random", 0.5, 4.5, 5, {"gps_rate": 5.0, "compass_rate": 10.0}),
    ("usv75", "random", 1.2, 8.0, 6, {"gps_rate": 1.0, "gps_white": 1.0}),
    ("usv75", "turn-zigzag", 0.5, 4.5, 7, {"imu_rate": 10.0, "compass_rate": 5.0}),
    ("usv75", "straight", 0.3, 3.0, 8, {}),
    ("otter", "zigzag", 0.2, 3.0, 9, {"gps_white": 0.1}),
    ("otter", "random", 0.0, 0.0, 10, {}),
    ("otter", "random", 0.1, 3.0, 11, {"gps_rate": 4.0, "gps_latency": 0.2}),
    ("otter", "turn", 0.0, 2.0, 12, {"gps_white": 0.02, "gps_bias": 0.05}),
    ("wamv16", "zigzag", 0.1, 3.0, 13, {}),
    ("wamv16", "random", 0.3, 5.0, 14, {}),
    ("wamv16", "random", 0.0, 0.0, 15, {"gps_rate": 10.0}),
    ("telemetron", "zigzag", 0.5, 5.0, 16, {}),
    ("telemetron", "random", 0.5, 5.0, 17, {}),
    ("telemetron", "random", 1.0, 8.0, 18, {"gps_rate": 5.0}),
    ("kvlcc2_l7", "zigzag", 0.0, 0.0, 19, {"gps_white": 0.02, "gps_bias": 0.0}),
    ("kvlcc2_l7", "zigzag", 0.05, 1.0, 20, {}),
    ("kvlcc2_l7", "turn", 0.0, 0.0, 21, {"gps_white": 0.05}),
    ("kvlcc2", "zigzag", 2.0, 8.0, 22, {}),
)


@functools.cache
def clean(index: int, duration: float = 180.0) -> tuple[Log, Particulars]:
    """Return a simulated log and the boat's particulars."""
    name, manoeuvre, hs, wind, seed, sensors = CASES[index]
    vessel, suite = Vessel.load(name), SensorSuite(**sensors)
    sea = SeaState(hs=hs, wind=wind, wind_from=0.25 * seed)
    long = duration if name != "kvlcc2" else 900.0
    log = simulate(manoeuvre, vessel=vessel, sea=sea, duration=long, seed=seed, suite=suite)
    return log, particulars_of(vessel, suite)


def recording(log: Log) -> Recording:
    """Return a log as a file would give it."""
    data = {"t_s": log.t, **dict(zip(COMMANDS, log.cmd.T, strict=True))}
    data |= dict(zip(MEASUREMENTS, log.z.T, strict=True))
    return Recording.of(data, {}, log.name)


def alarms(found: Diagnosis) -> list[str]:
    return [finding.code for finding in found.findings if finding.severity != NOTE]


def without_imu(log: Log) -> Log:
    z = log.z.copy()
    z[:, [R, AX, AY]] = np.nan
    return Log(log.t, z, log.cmd)


def without_velocity(log: Log) -> Log:
    z = log.z.copy()
    z[:, [VX, VY]] = np.nan
    return Log(log.t, z, log.cmd)


EACH = [
    pytest.param(index, marks=() if index % 6 == 0 else pytest.mark.slow)
    for index in range(len(CASES))
]


@pytest.mark.parametrize("index", EACH)
def test_sound_logs_have_no_finding(index: int) -> None:
    log, boat = clean(index)
    for each, particulars in ((log, boat), (without_velocity(without_imu(log)), None)):
        found = diagnose(recording(each), particulars)
        assert not alarms(found), [finding.text for finding in found.findings]


# --- faults -----------------------------------------------------------------------------------


measured, commanded = functools.partial(changed, 1), functools.partial(changed, 2)


STEERED = (0, 1, 4, 5, 7, 16, 19)  # zigzags and random runs of boats with drives or a rudder
UNEQUAL = (9, 10, 11, 13, 14, 15)  # the same of pairs of thrusters
TURNING = (0, 1, 4, 5, 6, 7, 9, 10, 11, 13, 14, 15, 16, 17, 18)
ROUND = (0, 1, 4, 5, 6, 7, 9, 10, 11, 16, 17, 18)  # and not drifting about one heading
CHANGING = (4, 5, 6, 10, 11, 14, 15, 17, 18)  # also in thrust
IN_WAVES = (0, 1, 3, 5, 6, 7, 14, 16, 17, 18)

FAULTS: dict[str, tuple[Fault, Collection[str], Collection[int]]] = {
    "gyro in degrees": (measured(R)(np.degrees), {"gyro-degrees"}, TURNING),
    "gyro with the wrong sign": (measured(R)(np.negative), {"gyro-sign"}, TURNING),
    "gyro scale 1.3": (measured(R)(lambda z: 1.3 * z), {"gyro-scale"}, TURNING),
    "gyro scale 0.8": (measured(R)(lambda z: 0.8 * z), {"gyro-scale"}, TURNING),
    "gyro bias": (measured(R)(lambda z: z + 0.03), {"gyro-bias"}, TURNING),
    "gyro late": (late_by(0.5, R), {"gyro-late"}, TURNING),
    "compass late": (late_by(0.5, PSI), {"compass-late"}, TURNING),
    "gyro frozen": (frozen(50.0, 75.0, R), {"gyro-compass", "gyro-frozen"}, TURNING),
    "compass in degrees": (measured(PSI)(degrees_wrapped), {"compass-degrees"}, TURNING),
    "compass 45 degrees off": (
        measured(PSI)(lambda z: z + math.radians(45.0)),
        {"compass-offset"},
        ROUND[:-1],  # the last one's leeway in wind could as well be an offset
    ),
    "compass back to front": (measured(PSI)(lambda z: z + math.pi), {"compass-reversed"}, TURNING),
    "compass from east": (
        measured(PSI, R)(lambda z: [0.5 * math.pi, 0.0] - z),
        {"track-mirrored"},
        ROUND,
    ),
    "latitude and longitude swapped": (
        measured(X, Y)(swapped_latitude),
        {"track-mirrored"},
        ROUND,
    ),
    "latitude and longitude as metres": (
        measured(X, Y)(to_latitude),
        {"position-degrees"},
        TURNING,
    ),
    "knots as m/s": (measured(VX, VY)(lambda z: z / KNOT), {"speed-unit"}, TURNING),
    "km/h as m/s": (measured(VX, VY)(lambda z: 3.6 * z), {"speed-unit"}, TURNING),
    "course in degrees": (measured(VX, VY)(course_as_radians), {"course-unit"}, TURNING),
    "velocity reversed": (measured(VX, VY)(lambda z: -z), {"velocity-reversed"}, TURNING),
    "velocity swapped": (measured(VX, VY)(lambda z: z[:, ::-1]), {"velocity-mirrored"}, ROUND),
    "GPS late": (late_by(0.5, X, Y, VX, VY), {"gps-late"}, IN_WAVES),
    "accelerometers in g": (measured(AX, AY)(lambda z: z / 9.81), {"accel-unit"}, IN_WAVES),
    "accelerometers turned": (
        measured(AX, AY)(lambda z: z[:, ::-1] * [1.0, -1.0]),
        {"accel-axes", "accel-mirrored"},
        IN_WAVES,
    ),
    "rpm as rev/s": (commanded(0, 1)(lambda n: 60.0 * n), {"shaft-unit"}, range(len(CASES))),
    "rad/s as rev/s": (commanded(0, 1)(lambda n: 2.0 * math.pi * n), {"shaft-unit"}, TURNING),
    "pulse widths": (
        commanded(0, 1)(lambda n: 1500.0 + 10.0 * n),
        {"shaft-pwm", "shaft-unit"},
        TURNING,
    ),
    "angles in degrees": (commanded(2, 3)(np.degrees), {"angle-degrees"}, STEERED),
    "angle with the wrong sign": (commanded(2, 3)(np.negative), {"steering-sign"}, STEERED),
    "sides swapped": (commanded(0, 1)(lambda n: n[:, ::-1]), {"sides-swapped"}, UNEQUAL),
    "thrust with the wrong sign": (
        commanded(0, 1)(np.negative),
        {"thrust-sign", "compass-reversed"},
        CHANGING,
    ),
    "no commands": (commanded(0, 1)(lambda n: 0.0 * n), {"commands-missing"}, TURNING),
    "jitter": (jitter, {"time-jitter"}, TURNING),
    "gaps": (gaps, {"time-gaps"}, TURNING),
    "clock set back": (clock_set_back, {"time-back"}, TURNING),
    "milliseconds": (milliseconds, {"time-unit"}, TURNING),
    "no fix for 15 s": (no_fix, {"fix-lost"}, TURNING),
    "fixes frozen for 20 s": (frozen(40.0, 60.0, X, Y, VX, VY), {"fix-frozen"}, IN_WAVES),
    "stale rows": (stale, {"stale-rows"}, (0, 1, 2, 3, 4, 9, 10, 14, 16)),
    "a step of 20 m": (
        lambda t, z, cmd: (t, z + np.outer(t > 50.0, [14.0] * 2 + [0.0] * (z.shape[1] - 2)), cmd),
        {"fix-steps"},
        (0, 1, 4, 5, 7, 9, 13, 14, 16),
    ),
    "a jump of 700 m": (jump, {"fix-jumps"}, TURNING),
}


def unseen(name: str, cases: Collection[int]) -> dict[object, list[str]]:
    """Return the cases in which a fault is not named, with what is said instead."""
    fault, codes, _ = FAULTS[name]
    missed = {}
    for index in cases:
        log, boat = clean(index)
        t, z, cmd = fault(log.t, log.z, log.cmd)
        data = {"t_s": t, **dict(zip(COMMANDS, cmd.T, strict=True))}
        data |= dict(zip(MEASUREMENTS, z.T, strict=True))
        found = diagnose(Recording.of(data, {}, log.name), boat)
        if not codes & {finding.code for finding in found.findings}:
            missed[CASES[index][:5]] = alarms(found)
    return missed


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_is_named(name: str) -> None:
    cases = list(FAULTS[name][2])
    first = list(FAULTS).index(name)
    assert not unseen(name, [cases[first % len(cases)]])


@pytest.mark.slow
@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_is_named_on_every_boat_and_sea(name: str) -> None:
    assert not unseen(name, FAULTS[name][2])


@settings(max_examples=8, deadline=None)
@given(
    scale=st.floats(0.3, 3.0).filter(lambda s: abs(s - 1.0) > 0.2),
    bias=st.floats(0.02, 0.2),
    late=st.floats(0.25, 1.5),
    sign=st.sampled_from([-1.0, 1.0]),
)
def test_scale_bias_and_delay_of_a_gyro_are_measured(
    scale: float, bias: float, late: float, sign: float
) -> None:
    log, _ = clean(0)
    t, psi, rate = log.t, log.z[:, PSI], log.z[:, R]
    fit = gyro_on_compass(t, psi, t + late, sign * scale * rate + bias)
    assert fit is not None
    assert fit.scale == pytest.approx(sign * scale, rel=0.03)
    assert fit.bias == pytest.approx(bias, abs=0.01 * scale)
    assert fit.lag == pytest.approx(late, abs=0.03)


def test_latency_and_noise_of_the_instruments_are_estimated() -> None:
    log, boat = clean(1)
    t, z, cmd = late_by(0.4, X, Y, VX, VY)(log.t, log.z, log.cmd)
    found = diagnose(recording(Log(t, z, cmd)), boat)
    instruments, reasons = estimate_instruments(found)
    assert instruments.gps_latency == pytest.approx(0.5, abs=0.05)  # 0.1 s of its own
    assert instruments.gps_sd == pytest.approx(0.4, rel=0.1)
    assert instruments.doppler_sd == pytest.approx(0.05, rel=0.2)
    assert instruments.compass_sd == pytest.approx(math.radians(0.4), rel=0.1)
    assert instruments.gyro_sd == pytest.approx(math.radians(0.05), rel=0.1)
    assert instruments.accel_sd == pytest.approx(math.hypot(0.0981, 0.07), rel=0.1)
    assert "gps_bias_sd" not in reasons
    assert instruments.gps_bias_sd == Instruments().gps_bias_sd


def test_written_particulars_are_read_back(tmp_path: Path) -> None:
    log, boat = clean(1)
    found = diagnose(recording(log), boat)
    path = tmp_path / "boat.toml"
    path.write_text(particulars_text(found, boat), encoding="utf-8")
    back = Particulars.load(path)
    assert dataclasses.replace(back, instruments=boat.instruments) == boat
    assert back.instruments == estimate_instruments(found, boat.instruments)[0]


def test_unknown_particulars_are_to_be_filled_in(tmp_path: Path) -> None:
    log, _ = clean(9)
    text = particulars_text(diagnose(recording(log)))
    path = tmp_path / "boat.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ParticularsError, match="length, beam, draft, mass"):
        Particulars.load(path)
    for key in ("length", "beam", "draft", "mass"):
        text = text.replace(f"# {key} = ?", f"{key} = {300.0 if key == 'mass' else 1.0}")
    path.write_text(text, encoding="utf-8")
    assert Particulars.load(path).steering == "differential"


# --- rest, and forces without a command -------------------------------------------------------


def driven(left: np.ndarray, right: np.ndarray, current: float = 0.0) -> Log:
    """Return a log of the Otter under shares of its nominal shaft speed, 20 a second."""
    vessel = Vessel.load("otter")
    n = particulars_of(vessel).shaft_speed
    cmd = n * np.column_stack([left, right, 0.0 * left, 0.0 * left])
    sea = SeaState(current=current, current_to=1.0)
    suite = SensorSuite(gps_white=0.1, gps_bias=0.0)
    log = simulate(cmd, vessel=vessel, sea=sea, duration=0.05 * len(left), seed=3, suite=suite)
    return Log(log.t, log.z, log.cmd)


def pulses(*parts: tuple[float, float]) -> np.ndarray:
    """Return thrusts for so many seconds each."""
    return np.concatenate([np.full(round(20.0 * seconds), share) for seconds, share in parts])


def codes_of(log: Log, *hidden: tuple[float, float]) -> set[str]:
    """Return the codes of a log from which the commands of some times are left out."""
    cmd = log.cmd.copy()
    for start, end in hidden:
        cmd[(log.t > start) & (log.t < end)] = 0.0
    found = diagnose(recording(Log(log.t, log.z, cmd)))
    return {finding.code for finding in found.findings}


FORCES = {"force", "drift", "spin"}


def test_rest_is_noted_and_coasting_is_no_force() -> None:
    thrust = pulses((60, 1.0), (120, 0.0), (30, 0.7))
    codes = codes_of(driven(thrust, thrust))
    assert "rest" in codes
    assert not codes & FORCES


def test_a_current_is_a_drift() -> None:
    thrust = pulses((60, 1.0), (150, 0.0))
    codes = codes_of(driven(thrust, thrust, current=0.4))
    assert "drift" in codes
    assert "rest" not in codes


def test_thrust_that_is_not_recorded_is_a_force() -> None:
    thrust = pulses((40, 1.0), (60, 0.0), (60, 0.8), (60, 0.0))
    log = driven(thrust, thrust)
    assert not codes_of(log) & FORCES
    assert "force" in codes_of(log, (90.0, 170.0))


def test_a_stuck_thruster_turns_the_boat() -> None:
    thrust = pulses((40, 0.6), (60, 0.0), (60, 0.7), (60, 0.0))
    log = driven(thrust, 0.0 * thrust)
    assert codes_of(log, (90.0, 170.0)) & {"spin", "force"}


@pytest.mark.parametrize("side", [0, 1])
def test_a_dead_unit_is_named(side: int) -> None:
    steps = np.random.default_rng(0).uniform(0.3, 1.0, (2, 60))
    sides = [np.repeat(step, 60) for step in steps]
    asked = list(sides)
    sides[side] = np.full(len(sides[side]), 0.6)  # runs on, whatever it is asked
    log = driven(sides[0], sides[1])
    cmd = log.cmd.copy()
    cmd[1:, side] = asked[side] * log.cmd[5, side] / 0.6
    found = diagnose(recording(Log(log.t, log.z, cmd)))
    assert f"{('left', 'right')[side]}-unit-dead" in alarms(found)


COLUMNS = (*COMMANDS, *MEASUREMENTS)


@settings(max_examples=60, deadline=None)
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
        "back": lambda: 0.1 * np.arange(rows) + 0.5 * rng.standard_normal(rows),
        "holes": lambda: np.where(rng.random(rows) < 0.2, np.nan, np.arange(rows)),
    }
    names = data.draw(st.sets(st.sampled_from(COLUMNS)))
    table = {name: kinds[data.draw(st.sampled_from(sorted(kinds)))]() for name in sorted(names)}
    table["t_s"] = times[data.draw(st.sampled_from(sorted(times)))]()
    found = diagnose(Recording.of(table, {}, "any"))
    json.dumps(found.to_json(), allow_nan=False)
    particulars_text(found)
    if rows > 1:
        check = LogCheck(found.findings, (), (), (), None, found)
        assert draw_check(check).startswith(b"\x89PNG") if seed % 10 == 0 else True


@pytest.mark.parametrize("huge", [name for name in COLUMNS if name in MEASUREMENTS])
def test_a_channel_of_absurd_size_gives_findings(huge: str) -> None:
    rng, rows = np.random.default_rng(0), 400
    table = {name: np.full(rows, rng.standard_normal()) for name in COLUMNS}
    table["compass_rad"] = np.linspace(0.0, 100.0, rows)
    table[huge] = 1e300 * rng.standard_normal(rows)
    table["t_s"] = np.arange(rows)
    without = {name: column for name, column in table.items() if not name.startswith("ahrs")}
    for columns in (table, without):
        json.dumps(diagnose(Recording.of(columns, {}, "any")).to_json(), allow_nan=False)


def test_episodes_of_the_environment_are_sound() -> None:
    env = gym.make("USVTwin-v0", record=True)
    env.reset(seed=0)
    for step in range(600):
        _, _, over, cut, _ = env.step(np.array([0.8, 0.6 * math.sin(0.05 * step)], np.float32))
        if over or cut:
            break
    log = log_of(env)
    env.close()
    assert not alarms(diagnose(recording(log)))


# --- estimators -------------------------------------------------------------------------------


def test_a_lag_is_found_between_samples() -> None:
    rng = np.random.default_rng(0)
    at = np.arange(0.0, 100.0, 0.05)
    rough = np.convolve(rng.standard_normal(len(at)), np.ones(20), "same")
    lag = best_lag(
        lambda grid: np.interp(grid, at, rough),
        lambda grid: np.interp(grid - 0.473, at, rough),
        np.arange(2.0, 98.0, 0.05),
        most=2.0,
        width=1.0,
    )
    assert lag is not None
    assert lag.seconds == pytest.approx(0.473, abs=0.01)


@pytest.mark.parametrize("uneven", [False, True])
def test_white_noise_is_measured_on_a_moving_signal(uneven: bool) -> None:
    rng = np.random.default_rng(2)
    t = 0.1 * np.arange(5000) + (0.03 * rng.random(5000) if uneven else 0.0)
    values = 50.0 * np.sin(0.2 * t) + 0.3 * rng.standard_normal(len(t))
    values[::100] += 20.0  # outliers
    assert white_noise(t, values) == pytest.approx(0.3, rel=0.1)


def test_a_line_is_fitted_through_outliers() -> None:
    rng = np.random.default_rng(3)
    x = rng.standard_normal(300)
    y = 2.0 * x + 1.0 + 0.1 * rng.standard_normal(300)
    y[:20] += 30.0
    line = fit_line(x, y)
    assert line.slope == pytest.approx(2.0, abs=0.05)
    assert line.offset == pytest.approx(1.0, abs=0.1)


# --- what others recorded ---------------------------------------------------------------------

DATA = Path(__file__).resolve().parents[3].parent / "shared" / "data"


def found_in(folder: str, run: str) -> dict[str, Finding]:
    path = DATA / folder / f"{run}.csv.gz"
    if not path.exists():
        pytest.skip(f"{path} is absent: recorded runs are not part of the project")
    table = read_table(path)
    boats = {"otter_oslofjord": "otter.toml", "blueboat_trondheim": "blueboat.toml"}
    boat = DATA / folder / boats[folder] if folder in boats else None
    found = diagnose(
        Recording.of(table.data, table.given, table.name, table.plane),
        Particulars.load(boat) if boat else known_ship(path),
    )
    return {f.code: f for f in found.findings if f.severity != NOTE}


def runs_in(folder: str) -> list[str]:
    runs = sorted(path.name.removesuffix(".csv.gz") for path in (DATA / folder).glob("*.csv.gz"))
    return [run for run in runs if "open_water" not in run] or ["any"]


def swapped(folder: str, run: str) -> dict[str, Finding]:
    """Return the findings on a run with left and right swapped."""
    path = DATA / folder / f"{run}.csv.gz"
    if not path.exists():
        pytest.skip(f"{path} is absent: recorded runs are not part of the project")
    table = read_table(path)
    data = dict(table.data)
    data["n_left_rps"], data["n_right_rps"] = data["n_right_rps"], data["n_left_rps"]
    found = diagnose(Recording.of(data, table.given, table.name))
    return {f.code: f for f in found.findings if f.severity != NOTE}


def test_gyro_and_compass_of_the_otter_disagree() -> None:
    """Its README: by 0.1 rad/s. The logger wrote old samples with new times."""
    found = found_in("otter_oslofjord", "otter_16-07-36")
    assert found["gyro-compass"].evidence["worst"] == pytest.approx(0.1, abs=0.02)
    assert "repeat old samples" in found["gyro-compass"].remedy
    assert "gyro-late" not in found
    assert found["stale-rows"].evidence["times"] > 20
    assert found["stale-rows"].evidence["longest_s"] > 2.0


@pytest.mark.parametrize("run", runs_in("otter_oslofjord"))
def test_jitter_of_the_otter_is_named(run: str) -> None:
    found = found_in("otter_oslofjord", run)
    assert {"time-jitter", "fix-stamps"} <= set(found)
    assert 0.04 < found["fix-stamps"].evidence["jitter"] < 0.1
    assert not [f.text for f in found.values() if f.severity == ERROR]


def test_jump_of_the_gnss_of_the_esso_osaka_is_named() -> None:
    """Its README: isolated jumps of 0.15 to 0.74 m."""
    found = found_in("esso_osaka_frt", "zigzag_31-Jul-2020_13_57_45")
    assert found["fix-steps"].evidence["most_m"] == pytest.approx(0.43, abs=0.1)


def test_false_fix_and_clock_gaps_of_the_otter_are_named() -> None:
    found = found_in("otter_oslofjord", "otter_12-44-08")
    assert found["fix-jumps"].evidence["fixes"] == 1
    assert found["time-skips"].evidence["longest_s"] == pytest.approx(0.43, abs=0.01)


@pytest.mark.parametrize("run", runs_in("blueboat_trondheim"))
def test_swapped_sides_of_the_blueboat_are_named(run: str) -> None:
    """Its source has left and right swapped; the runs are put right."""
    assert "sides-swapped" not in found_in("blueboat_trondheim", run)
    if run not in ("blueboat_218", "blueboat_221", "blueboat_232"):  # these hardly steer
        assert "sides-swapped" in swapped("blueboat_trondheim", run)


ALLOWED = {
    # GNSS jumps, and the heading with them, as the README says; its berthing runs have thrusters
    # that were not recorded
    "esso_osaka_frt": {"compass-steps", "gyro-compass", "fix-steps", "force", "drift", "spin"},
    "kvlcc2_simman2008": set(),
    "boat1_usv": {"fix-stamps"},  # jittered stamps, fixes in every second row
    # position and yaw rate are a filter's output
    "blueboat_trondheim": {"gyro-compass", "gyro-late", "fix-steps"},
}


@pytest.mark.parametrize(("folder", "run"), [(f, r) for f in ALLOWED for r in runs_in(f)])
def test_recorded_runs_have_no_false_alarm(folder: str, run: str) -> None:
    found = found_in(folder, run)
    assert set(found) <= ALLOWED[folder], [finding.text for finding in found.values()]
