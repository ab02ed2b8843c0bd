"""Each fault that is put into a sound log is named, and a sound log has none."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.twin.integrity.damaged import (
    FAULTS,
    FIX,
    RUNS,
    SHAFTS,
    TILTED,
    VELOCITY,
    columns_of,
    course_in_degrees,
    late,
    recording,
    scaled,
    sound,
    step_aside,
    swapped,
    without,
)
from twin.channels import COMMANDS, MEASUREMENTS
from twin.cli.pictures import draw_check
from twin.integrity.findings import ERROR, NOTE, WARNING, Finding
from twin.integrity.log_check import LogCheck, check_recording
from twin.logs.datasets import known_ship
from twin.logs.log import read_table
from twin.logs.recording import Recording
from twin.particulars import Instruments, Particulars, ParticularsError


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
    path.write_text(check.particulars_text(boat), encoding="utf-8")
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
