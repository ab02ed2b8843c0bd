"""A log keeps every number it is given, reports every repair, and refuses with a remedy."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from tests.twin.logs.reading import refused
from twin.channels import COMMANDS, MEASUREMENTS
from twin.logs.columns import REQUIRED
from twin.logs.errors import LogError
from twin.logs.log import Log, recorded_runs

Columns = dict[str, list[str]]
ROWS = 40


def columns(rows: int = ROWS) -> Columns:
    """Return the text cells of a sound log in which every measurement changes."""
    k = np.arange(rows)
    values = {"t_s": 0.1 * k}
    values |= {name: np.full(rows, 0.25 * j) for j, name in enumerate(COMMANDS)}
    values |= {name: np.sin(0.1 * k + j) for j, name in enumerate(MEASUREMENTS)}
    return {name: [repr(float(x)) for x in column] for name, column in values.items()}


def save(path: Path, table: Columns) -> Path:
    lines = [",".join(table), *(",".join(cells) for cells in zip(*table.values(), strict=True))]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def sound(rows: int = ROWS, truth: bool = False) -> Log:
    rng = np.random.default_rng(3)
    return Log(
        0.05 * np.arange(rows) + 0.01 * rng.random(rows),
        rng.standard_normal((rows, len(MEASUREMENTS))),
        rng.uniform(-1.0, 1.0, (rows, 4)),
        rng.standard_normal((rows, 6)) if truth else None,
    )


def same_bits(a: Log, b: Log) -> bool:
    pairs = [(a.t, b.t), (a.z, b.z), (a.cmd, b.cmd)]
    if (a.truth is None) != (b.truth is None):
        return False
    if a.truth is not None and b.truth is not None:
        pairs.append((a.truth, b.truth))
    return all(
        x.shape == y.shape
        and np.array_equal(np.isnan(x), np.isnan(y))
        and x[~np.isnan(x)].tobytes() == y[~np.isnan(y)].tobytes()
        for x, y in pairs
    )


# --- writing and reading back -----------------------------------------------------------------


numbers = st.floats(-1e300, 1e300)


def distinct(rows: int, most: float = 1e300) -> st.SearchStrategy[list[float]]:
    """Return columns in which nothing looks like a repeat or a dead sensor."""
    within = st.floats(-most, most)
    return st.lists(within, min_size=rows, max_size=rows, unique_by=lambda x: x + 0.0)


@settings(max_examples=30, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data(), rows=st.integers(2, 30), kind=st.sampled_from(["csv", "csv", "parquet"]))
def test_round_trip_of_any_numbers_keeps_the_bits(
    tmp_path: Path, data: st.DataObject, rows: int, kind: str
) -> None:
    # neither degrees nor a jump
    most = {"gps_x_m": 15.0, "gps_y_m": 15.0}
    most |= dict.fromkeys(("compass_rad", "wind_from_rad", "apparent_wind_rad"), 3.0)
    z = np.column_stack([data.draw(distinct(rows, most.get(k, 1e300))) for k in MEASUREMENTS])
    cmd = data.draw(hnp.arrays(np.float64, (rows, 4), elements=numbers))
    cmd[:, 2:] = data.draw(hnp.arrays(np.float64, (rows, 2), elements=st.floats(-3.0, 3.0)))
    z[data.draw(hnp.arrays(np.bool_, z.shape))] = np.nan
    log = Log(
        np.sort(data.draw(distinct(rows, 1e9))),
        z,
        cmd,
        data.draw(hnp.arrays(np.float64, (rows, 6), elements=numbers) | st.none()),
    )
    log.write(tmp_path / f"any.{kind}")
    assert same_bits(log, Log.read(tmp_path / f"any.{kind}"))


def test_what_was_read_and_repaired_reads_back_unchanged(tmp_path: Path) -> None:
    once = Log.read(recorded_runs()["boat1_usv_circle"])
    once.write(tmp_path / "once.csv")
    twice = Log.read(tmp_path / "once.csv")
    assert same_bits(once, twice)
    assert not any("repeat" in note for note in twice.notes)


def test_equal_logs_give_equal_gzip_files(tmp_path: Path) -> None:
    sound().write(tmp_path / "a.csv.gz")
    sound().write(tmp_path / "b.csv.gz")
    assert (tmp_path / "a.csv.gz").read_bytes() == (tmp_path / "b.csv.gz").read_bytes()


# --- a log in memory --------------------------------------------------------------------------


def test_length_step_rows_and_slices_are_those_of_the_arrays() -> None:
    log = sound(truth=True)
    assert len(log) == ROWS
    assert log.dt == np.median(np.diff(log.t))
    rows = list(log)
    assert len(rows) == ROWS
    t, z, cmd = rows[7]
    assert t == log.t[7]
    np.testing.assert_array_equal(z, log.z[7])
    np.testing.assert_array_equal(cmd, log.cmd[7])

    first, second = log.slice(t1=log.t[10]), log.slice(log.t[10])
    assert (len(first), len(second)) == (10, ROWS - 10)
    np.testing.assert_array_equal(np.concatenate((first.t, second.t)), log.t)
    part = log.slice(log.t[3], log.t[5])
    np.testing.assert_array_equal(part.z, log.z[3:5])
    np.testing.assert_array_equal(part.cmd, log.cmd[3:5])
    assert part.truth is not None and log.truth is not None
    np.testing.assert_array_equal(part.truth, log.truth[3:5])
    assert len(log.slice(5.0, 4.0)) == len(log.slice(1e9)) == 0
    with pytest.raises(LogError, match="two rows"):
        _ = log.slice(1e9).dt


@pytest.mark.parametrize(
    ("change", "place"),
    [
        ({"z": np.zeros((ROWS, 8))}, r"z has the shape \(40, 8\), expected \(N, 19\)"),
        ({"cmd": np.zeros((ROWS - 1, 4))}, "cmd has the shape"),
        ({"t": np.zeros((ROWS, 1))}, r"t has the shape \(40, 1\), expected \(N,\)"),
        ({"truth": np.zeros((ROWS, 3))}, "truth has the shape"),
        ({"cmd": np.full((ROWS, 4), np.nan)}, "cmd must be finite"),
        ({"z": np.full((ROWS, len(MEASUREMENTS)), np.inf)}, "z must be finite, or NaN"),
        ({"t": np.zeros(ROWS)}, r"t\[1\] <= t\[0\]"),
    ],
)
def test_arrays_of_wrong_shape_or_value_are_refused(change: dict[str, Any], place: str) -> None:
    log = sound()
    with pytest.raises(LogError, match=place):
        dataclasses.replace(log, **change)


# --- columns ----------------------------------------------------------------------------------


def test_order_of_columns_does_not_matter(tmp_path: Path) -> None:
    table = columns()
    straight = Log.read(save(tmp_path / "a.csv", table))
    turned = Log.read(save(tmp_path / "b.csv", dict(reversed(table.items()))))
    assert same_bits(straight, turned)
    assert straight.notes == turned.notes == ()


def test_degrees_and_rpm_are_converted(tmp_path: Path) -> None:
    table = columns()
    table |= {name: ["30.0"] * ROWS for name in ("delta_left_deg", "n_right_rpm")}
    degrees = ("compass_deg", "gyro_degps", "wind_from_deg", "true_psi_deg")
    table |= {name: table["compass_rad"] for name in degrees}
    for name in ("delta_left_rad", "n_right_rps", "gyro_radps", "compass_rad", "wind_from_rad"):
        del table[name]
    log = Log.read(save(tmp_path / "a.csv", table))
    assert log.cmd[5, 1] == pytest.approx(0.5, abs=1e-15)
    assert log.cmd[5, 2] == pytest.approx(math.radians(30.0), abs=1e-15)
    wave = np.radians(np.sin(0.1 * np.arange(ROWS) + 4.0))
    np.testing.assert_allclose(log.z[:, 4], wave, rtol=1e-14)
    np.testing.assert_allclose(log.z[:, 5], wave, rtol=1e-14)
    np.testing.assert_allclose(log.z[:, 9], wave, rtol=1e-14)
    assert log.truth is not None
    np.testing.assert_allclose(log.truth[:, 2], wave, rtol=1e-14)
    assert np.isnan(log.truth[:, [0, 1, 3, 4, 5]]).all()
    assert "delta_left_deg: converted to delta_left_rad" in log.notes[0]
    assert any("true_x_m" in note and "unknown" in note for note in log.notes)


def test_unknown_and_absent_columns_are_reported(tmp_path: Path) -> None:
    table = columns()
    table["battery_V"] = ["full; not a number"] * ROWS
    table["wind"] = table.pop("wind_mps")
    log = Log.read(save(tmp_path / "a.csv", table))
    assert np.isnan(log.z[:, 8]).all()
    assert log.notes == (
        "2 column(s) unknown, left out: battery_V, wind",
        "wind_mps: not in the file, taken as never measured",
    )


@pytest.mark.parametrize("name", REQUIRED)
def test_missing_column_is_named(tmp_path: Path, name: str) -> None:
    table = columns()
    del table[name]
    message = refused(save(tmp_path / "a.csv", table))
    assert f"column(s) {name} missing; add" in message


def test_one_propeller_and_one_rudder_are_put_on_both_sides(tmp_path: Path) -> None:
    table = columns()
    table["n_rpm"] = [repr(60.0 + k) for k in range(ROWS)]
    table["delta_rad"] = table.pop("delta_left_rad")
    for name in ("n_left_rps", "n_right_rps", "delta_right_rad"):
        del table[name]
    log = Log.read(save(tmp_path / "a.csv", table))
    np.testing.assert_allclose(log.cmd[:, 0], 1.0 + np.arange(ROWS) / 60.0, rtol=1e-15)
    np.testing.assert_array_equal(log.cmd[:, 0], log.cmd[:, 1])
    np.testing.assert_array_equal(log.cmd[:, 2:], 0.5)
    assert "delta_rad: one for both sides, delta_left_rad and delta_right_rad" in log.notes[0]
    table["n_left_rps"] = table["n_rpm"]
    message = refused(save(tmp_path / "a.csv", table))
    assert "columns n_rpm and n_left_rps both give n_left_rps; remove one" in message


def test_quantity_given_twice_is_refused(tmp_path: Path) -> None:
    table = columns()
    table["compass_deg"] = table["compass_rad"]
    message = refused(save(tmp_path / "a.csv", table))
    assert "columns compass_rad and compass_deg both give compass_rad; remove one" in message
    path = tmp_path / "b.csv"
    path.write_text("t_s,t_s," + ",".join(REQUIRED) + "\n")
    assert "column t_s stands twice in line 1; remove" in refused(path)


# --- cells ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "row", "cell", "words"),
    [
        ("gps_x_m", 6, "abc", "column gps_x_m, line 8: 'abc' is not a number; correct it"),
        (
            "t_s",
            6,
            "noon",
            "'noon' is not a number; correct it, or remove the row",
        ),
        ("n_left_rps", 0, "1_0", "column n_left_rps, line 2: '1_0' is not a number"),
        ("wind_mps", 3, "inf", "column wind_mps, line 5: the value is infinite; leave the cell"),
        ("t_s", 3, "-inf", "column t_s, line 5: the value is infinite"),
        ("gyro_radps", 3, "1e999", "column gyro_radps, line 5: the value is infinite"),
        ("t_s", 4, "", "column t_s, line 6: empty; each row needs a time"),
        ("t_s", 4, "NaN", "column t_s, line 6: empty"),
        ("t_s", 9, "0.8", "column t_s, line 11: time does not increase (0.8 s after 0.8 s); rec"),
        ("t_s", 9, "0.1", "column t_s, line 11: time does not increase (0.1 s after 0.8 s)"),
        (
            "delta_right_rad",
            0,
            "",
            "column delta_right_rad, line 2: empty, and there is no earlier",
        ),
    ],
)
def test_bad_cell_is_named(tmp_path: Path, name: str, row: int, cell: str, words: str) -> None:
    table = columns()
    table[name][row] = cell
    assert words in refused(save(tmp_path / "a.csv", table))


def test_line_numbers_count_blank_lines(tmp_path: Path) -> None:
    table = columns()
    table["gps_y_m"][3] = "?"
    table["t_s"][5] = "0.0"
    lines = save(tmp_path / "a.csv", table).read_text().splitlines()
    path = tmp_path / "b.csv"
    path.write_text("\n".join(["", lines[0], lines[1], "", *lines[2:]]) + "\n\n")
    assert "column gps_y_m, line 7" in refused(path)
    table["gps_y_m"][3] = ""
    lines = save(tmp_path / "a.csv", table).read_text().splitlines()
    path.write_text("\n".join(["", lines[0], lines[1], "", *lines[2:]]) + "\n\n")
    assert "column t_s, line 9" in refused(path)


def test_blank_lines_spaces_and_marks_of_missing_values_are_accepted(tmp_path: Path) -> None:
    table = columns()
    plain = save(tmp_path / "a.csv", table)
    lines = plain.read_text().splitlines()
    spaced = [line.replace(",", " ,  ") for line in lines]
    path = tmp_path / "b.csv"
    path.write_text("\ufeff" + "\r\n".join([*spaced[:5], "", *spaced[5:], "", ""]), "utf-8")
    log = Log.read(path)
    assert same_bits(log, Log.read(plain))
    assert log.notes == ("2 row(s) without a single value left out",)

    for row, cell in enumerate(("nan", "NA", "null", " NaN ", "")):
        table["gyro_radps"][row] = cell
    log = Log.read(save(path, table))
    assert np.isnan(log.z[:5, 5]).all() and np.isfinite(log.z[5:, 5]).all()


def test_text_that_is_not_utf8_in_an_unknown_column(tmp_path: Path) -> None:
    table = columns()
    table["remark"] = ["ok"] * ROWS
    path = save(tmp_path / "a.csv", table)
    path.write_bytes(path.read_bytes().replace(b"ok", b"\xfc\xe4"))
    assert len(Log.read(path)) == ROWS


def test_dead_sensor_is_refused(tmp_path: Path) -> None:
    table = columns()
    table["gyro_radps"] = ["", "", *["0.125"] * (ROWS - 3), ""]
    message = refused(save(tmp_path / "a.csv", table))
    assert "column gyro_radps, line 4 to line 40: all 37 values are equal" in message
    assert "leave its cells empty or remove the column" in message


def test_few_equal_values_are_no_dead_sensor(tmp_path: Path) -> None:
    table = columns(19)
    table["gyro_radps"] = ["0.125"] * 19
    assert (Log.read(save(tmp_path / "a.csv", table)).z[:, 5] == 0.125).all()


# --- missing data -----------------------------------------------------------------------------


def test_empty_measurements_are_missing_data(tmp_path: Path) -> None:
    table = columns(2000)
    for row in [*range(900, 1000), *range(1200, 1210)]:
        table["gps_x_m"][row] = ""
    table["wind_mps"][1990:] = [""] * 10
    log = Log.read(save(tmp_path / "a.csv", table))
    assert np.isnan(log.z[900:1000, 0]).all() and np.isnan(log.z[:, 0]).sum() == 110
    assert log.notes == (
        "gps_x_m: no value in 110 of 2000 rows (longest gap 10.0 s at t = 90.0 s)",
        "wind_mps: no value in 10 of 2000 rows (longest gap 1.0 s at t = 199.0 s)",
    )


def test_columns_that_miss_the_same_have_one_note(tmp_path: Path) -> None:
    table = columns(200)
    for name in ("gps_x_m", "gps_y_m", "gps_vx_mps", "gps_vy_mps"):
        table[name] = [cell if k % 5 == 0 else "" for k, cell in enumerate(table[name])]
    (note,) = Log.read(save(tmp_path / "a.csv", table)).notes
    assert note.startswith("gps_x_m, gps_y_m, gps_vx_mps, gps_vy_mps: no value in 160 of 200 rows")


def test_empty_command_holds_the_last(tmp_path: Path) -> None:
    table = columns()
    table["n_left_rps"] = [str(k) for k in range(ROWS)]
    table["n_left_rps"][5] = table["n_left_rps"][6] = table["n_left_rps"][9] = ""
    log = Log.read(save(tmp_path / "a.csv", table))
    np.testing.assert_array_equal(log.cmd[3:11, 0], [3, 4, 4, 4, 7, 8, 8, 10])
    assert log.notes == ("n_left_rps: 3 of 40 cells empty, the last command held",)


def test_time_gap_is_reported_as_missing_data(tmp_path: Path) -> None:
    table = columns()
    table["t_s"] = [repr(0.1 * k + (12.0 if k > 20 else 0.0)) for k in range(ROWS)]
    log = Log.read(save(tmp_path / "a.csv", table))
    assert len(log) == ROWS
    assert log.notes == (
        "t_s: 1 time gap(s) above 5 x the median step 0.1 s, treated as missing data "
        "(longest 12.1 s at t = 2.0 s, line 23)",
    )


def test_repeated_fixes_and_headings_are_no_new_sample(tmp_path: Path) -> None:
    table = columns()
    for name in ("gps_x_m", "gps_y_m", "gps_vx_mps", "gps_vy_mps", "compass_rad"):
        table[name][11] = table[name][10]
    # A hole does not make an old sample new.
    for name in ("gps_x_m", "gps_y_m"):
        table[name][12], table[name][13] = "", table[name][10]
    # One coordinate may stay the same, and so may the velocity or the gyro.
    table["gps_x_m"][21] = table["gps_x_m"][20]
    table["gps_vx_mps"][31], table["gps_vy_mps"][31] = (
        table["gps_vx_mps"][30],
        table["gps_vy_mps"][30],
    )
    table["gyro_radps"][16] = table["gyro_radps"][15]
    log = Log.read(save(tmp_path / "a.csv", table))
    assert np.flatnonzero(np.isnan(log.z[:, 0])).tolist() == [11, 12, 13]
    assert np.flatnonzero(np.isnan(log.z[:, 1])).tolist() == [11, 12, 13]
    assert np.flatnonzero(np.isnan(log.z[:, 2])).tolist() == [11]
    assert np.flatnonzero(np.isnan(log.z[:, 4])).tolist() == [11]
    assert np.isfinite(log.z[:, 5:]).all()
    assert log.notes[-3:] == (
        "gps_x_m, gps_y_m: 2 of 39 fixes repeat the last one, taken as no new sample "
        "(longest gap 0.3 s at t = 1.1 s)",
        "gps_vx_mps, gps_vy_mps: 1 of 40 velocities of repeated fixes repeat the last one, taken "
        "as no new sample (longest gap 0.1 s at t = 1.1 s)",
        "compass_rad: 1 of 40 values repeat the last one, taken as no new sample "
        "(longest gap 0.1 s at t = 1.1 s)",
    )


def straight_ahead_log(rows: int = 600, turn: float = 0.04) -> dict[str, np.ndarray]:
    """Return the columns of a boat that goes where it points, at 10 Hz."""
    t = 0.1 * np.arange(rows)
    psi = 1.2 + turn * t + 0.3 * np.sin(0.2 * t)
    vx, vy = 2.0 * np.cos(psi), 2.0 * np.sin(psi)
    rng = np.random.default_rng(5)
    return {
        "t_s": t,
        "n_left_rps": np.full(rows, 5.0),
        "n_right_rps": np.full(rows, 5.0),
        "delta_left_rad": 0.1 * np.sin(0.2 * t),
        "delta_right_rad": 0.1 * np.sin(0.2 * t),
        "gps_x_m": np.cumsum(0.1 * vx) + 0.05 * rng.standard_normal(rows),
        "gps_y_m": np.cumsum(0.1 * vy) + 0.05 * rng.standard_normal(rows),
        "compass_rad": psi + 0.005 * rng.standard_normal(rows),
        "gyro_radps": turn + 0.06 * np.cos(0.2 * t) + 0.002 * rng.standard_normal(rows),
        "wind_from_rad": 4.0 + 0.5 * rng.standard_normal(rows),
    }


def as_text(table: dict[str, np.ndarray]) -> Columns:
    return {k: ["" if x != x else repr(float(x)) for x in v] for k, v in table.items()}


@pytest.mark.parametrize("wrap", [False, True])
@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("delta_left_rad", "more than half a turn; if these are degrees, name the column delta_l"),
        ("compass_rad", "name the column compass_deg (in a mapping: unit = "),
        ("wind_from_rad", "as degrees do; name the column wind_from_deg"),
        ("gyro_radps", "times the rate at which the heading turns; name the column gyro_degps"),
    ],
)
def test_degrees_under_a_name_of_radians_are_refused(
    tmp_path: Path, name: str, words: str, wrap: bool
) -> None:
    table = straight_ahead_log()
    Log.read(save(tmp_path / "a.csv", as_text(table)))
    table[name] = np.degrees(table[name])
    if wrap and name != "gyro_radps":
        table[name] = np.mod(table[name] + 180.0, 360.0) - 180.0
    message = refused(save(tmp_path / "a.csv", as_text(table)))
    assert f"column {name}" in message and words in message


def test_a_heading_in_degrees_is_refused_beside_a_yaw_rate_in_degrees(tmp_path: Path) -> None:
    """They go with each other; the track tells."""
    table = straight_ahead_log()
    for name in ("compass_rad", "gyro_radps"):
        table[name] = np.degrees(table[name])
    assert "name the column compass_deg" in refused(save(tmp_path / "a.csv", as_text(table)))


@pytest.mark.parametrize("turn", [0.0, 0.04, -0.3])
@pytest.mark.parametrize("wrap", [0.0, math.pi, math.inf])
def test_radians_wrapped_or_not_are_accepted(tmp_path: Path, turn: float, wrap: float) -> None:
    table = straight_ahead_log(1200, turn)
    if wrap < math.inf:
        table["compass_rad"] = np.mod(table["compass_rad"] + wrap, 2.0 * math.pi) - wrap
    assert Log.read(save(tmp_path / "a.csv", as_text(table))).notes[1:] == ()


# --- jumps, equal times -----------------------------------------------------------------------


@pytest.mark.parametrize(("first", "count"), [(0, 1), (100, 1), (300, 40), (597, 3)])
def test_a_jump_and_back_is_left_out(tmp_path: Path, first: int, count: int) -> None:
    table = straight_ahead_log()
    table["gps_x_m"][first : first + count] += 500.0
    log = Log.read(save(tmp_path / "a.csv", as_text(table)))
    assert np.flatnonzero(np.isnan(log.z[:, 0])).tolist() == [*range(first, first + count)]
    line = first + 2 if first else 3
    note = f"{count} of 600 fixes cannot be reached from the others, left out (line {line}: "
    assert note in log.notes[-1]


@pytest.mark.parametrize("gap", [0, 50])
def test_a_jump_that_stays_is_refused(tmp_path: Path, gap: int) -> None:
    table = straight_ahead_log()
    table["gps_y_m"][300:] -= 500.0
    table["gps_x_m"][300 : 300 + gap] = np.nan
    message = refused(save(tmp_path / "a.csv", as_text(table)))
    assert f"line {302 + gap}: the position jumps by " in message
    assert "and stays away. Read the pieces one by one with start_s and stop_s" in message


def test_a_clock_that_was_set_back_is_not_to_be_sorted(tmp_path: Path) -> None:
    table = straight_ahead_log()
    table["t_s"][300:] -= 3.0
    message = refused(save(tmp_path / "a.csv", as_text(table)))
    assert "the clock was set back: add 3 s to all stamps from there on" in message
    table["t_s"] = straight_ahead_log()["t_s"]
    table["t_s"][[300, 301]] = table["t_s"][[301, 300]]
    assert "sort the rows by time" in refused(save(tmp_path / "a.csv", as_text(table)))


def test_a_jump_that_ends_a_stand_is_accepted(tmp_path: Path) -> None:
    table = straight_ahead_log(1200, 0.0)
    noise = 0.05 * np.random.default_rng(0).standard_normal((2, 600))
    for name, each in zip(("gps_x_m", "gps_y_m"), noise, strict=True):
        table[name][300:900] = table[name][300] + each
    log = Log.read(save(tmp_path / "a.csv", as_text(table)))
    assert np.isfinite(log.z[:, 0]).all()


def test_a_jump_of_a_boat_that_rests_ends_no_stand(tmp_path: Path) -> None:
    """It has gone nowhere meanwhile: one there and back is left out, one that stays is refused."""
    table = straight_ahead_log(1200, 0.0)
    for name, seed in (("gps_x_m", 1), ("gps_y_m", 2)):
        table[name] = 0.05 * np.random.default_rng(seed).standard_normal(1200)
    table["gps_x_m"][900] += 500.0
    log = Log.read(save(tmp_path / "a.csv", as_text(table)))
    assert np.flatnonzero(np.isnan(log.z[:, 0])).tolist() == [900]
    table["gps_x_m"][600:] += 500.0
    assert "line 602: the position jumps by " in refused(save(tmp_path / "b.csv", as_text(table)))


def test_a_position_of_noise_is_refused(tmp_path: Path) -> None:
    table = straight_ahead_log(3000)
    table["gps_x_m"] += 500.0 * np.random.default_rng(0).standard_normal(3000)
    assert "the position jumps by" in refused(save(tmp_path / "a.csv", as_text(table)))


def test_rows_of_equal_time_are_merged_unless_they_contradict(tmp_path: Path) -> None:
    table = straight_ahead_log()
    twice = {name: np.repeat(values, 2) for name, values in table.items()}
    log = Log.read(save(tmp_path / "a.csv", as_text(twice)))
    assert same_bits(log, Log.read(save(tmp_path / "b.csv", as_text(table))))
    assert log.notes[0].startswith("t_s: 600 of 1200 rows have the time of the row before and do")
    # each sensor in a row of its own
    twice["gps_x_m"][::2], twice["compass_rad"][1::2] = np.nan, np.nan
    assert same_bits(log, Log.read(save(tmp_path / "a.csv", as_text(twice))))
    twice["gps_x_m"][400] = 7.0
    message = refused(save(tmp_path / "a.csv", as_text(twice)))
    assert "column t_s, line 3: time does not increase (0 s after 0 s)" in message
