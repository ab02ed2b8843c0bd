"""Logs out of foreign files: mappings, ROS 2 bags, damaged files, files larger than a log."""

from __future__ import annotations

import gzip
import math
import sys
from functools import partial
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests.twin.logs.foreign import (
    ALL_ROWS,
    COLUMN,
    FOREIGN,
    MAPPINGS,
    foreign,
    record,
    refused,
    run,
    written,
)
from twin.channels import (
    AHRS_PITCH,
    AHRS_ROLL,
    APPARENT_FROM,
    APPARENT_SPEED,
    COMMANDS,
    MEASUREMENTS,
    WIND_FROM,
    WIND_SPEED,
)
from twin.logs import files, mapping, parquet
from twin.logs import readers as table
from twin.logs.errors import LogError
from twin.logs.log import Log, sibling_path
from twin.logs.mapping import Layout
from twin.logs.tables import StateTable
from usv_kernel.errors import UsvTwinError

# --- files beside a log -----------------------------------------------------------------------


def says(log: Log, name: str, what: str) -> bool:
    """Return whether a note says something of a column or topic, among others or alone."""
    notes = [note.rpartition(": ") for note in log.notes]
    return any(name in names.split(", ") and said.startswith(what) for names, _, said in notes)


def test_cells_in_quotes_are_those_of_plain_ones(tmp_path: Path) -> None:
    run(50).write(tmp_path / "a.csv")
    lines = (tmp_path / "a.csv").read_text().splitlines()
    lines[20] = ",".join(f'"{cell}"' for cell in lines[20].split(","))
    plain, quoted = (
        Log.read(tmp_path / "a.csv"),
        Log.read(written(tmp_path / "b.csv", "\n".join(lines))),
    )
    for name in ("t", "z", "cmd"):
        assert np.array_equal(getattr(plain, name), getattr(quoted, name), equal_nan=True)


@pytest.mark.parametrize(
    "name", ["a.b.csv", "a.b.csv.gz", "a.b.parquet", "a.b.mcap", "a.b.db3", "a.b"]
)
def test_sibling_path_replaces_the_ending(name: str) -> None:
    assert sibling_path(Path("x") / name, ".toml") == Path("x") / "a.b.toml"


# --- mappings of columns ----------------------------------------------------------------------


@pytest.mark.parametrize("name", ["a.csv", "a.csv.gz", "a.parquet"])
def test_mapped_columns_are_converted(tmp_path: Path, name: str) -> None:
    log, path = run(), tmp_path / name
    mapping = written(tmp_path / "m.toml", FOREIGN)
    if name.endswith(".parquet"):
        foreign(log).write_parquet(path)
    else:
        text = foreign(log).write_csv().encode()
        path.write_bytes(gzip.compress(text) if name.endswith(".gz") else text)
    back = Log.read(path, mapping)
    np.testing.assert_allclose(back.t, log.t, atol=1e-12)
    np.testing.assert_allclose(back.cmd, log.cmd[:, [0, 0, 2, 2]], atol=1e-12)
    z = dict(zip(MEASUREMENTS, back.z.T, strict=True))
    for key in ("gps_x_m", "gps_y_m"):
        np.testing.assert_allclose(z[key], log.z[:, COLUMN[key]], rtol=1e-6, atol=1e-7)
    for key in ("gps_vx_mps", "gps_vy_mps", "compass_rad", "gyro_radps"):
        np.testing.assert_allclose(z[key], log.z[:, COLUMN[key]], atol=1e-12)
    np.testing.assert_allclose(z["wind_mps"], 1.0 + log.z[:, COLUMN["wind_mps"]], atol=1e-12)
    notes = "\n".join(back.notes)
    assert f"1 column(s) not in {mapping}: remark" in notes
    assert "(one for both sides): from rudder times -0.0174533" in notes
    assert "metres north and east of latitude 60.0, longitude 179.9999" in notes
    mapping.rename(tmp_path / "a.mapping.toml")
    assert np.array_equal(Log.read(path).z, back.z, equal_nan=True)


def test_the_first_fix_is_the_datum_and_no_fix_is_missing(tmp_path: Path) -> None:
    log = run()
    mapping = written(tmp_path / "m.toml", FOREIGN.replace("datum", "# datum"))
    frame = foreign(log).with_row_index()
    lost = pl.col("index") < 3
    frame = frame.with_columns(pl.when(lost).then(0.0).otherwise(pl.col("lat", "lon")).name.keep())
    frame.write_parquet(tmp_path / "a.parquet")
    back = Log.read(tmp_path / "a.parquet", mapping)
    assert np.isnan(back.z[:3, :2]).all()
    np.testing.assert_allclose(back.z[3:, :2], log.z[3:, :2] - log.z[3, :2], atol=1e-3)
    frame = frame.with_columns(pl.when(lost).then(10.0).otherwise(pl.col("lat")).alias("lat"))
    frame.write_parquet(tmp_path / "a.parquet")
    back = Log.read(tmp_path / "a.parquet", mapping)  # fixes of elsewhere are no datum
    assert np.isnan(back.z[:3, :2]).all()
    np.testing.assert_allclose(back.z[3:, :2], log.z[3:, :2] - log.z[3, :2], atol=1e-3)


@pytest.mark.parametrize("form", ["%Y-%m-%d %H:%M:%S%.6f", "%Y-%m-%dT%H:%M:%S%.6fZ", ""])
def test_dates_and_times_become_seconds(tmp_path: Path, form: str) -> None:
    log = run()
    start = pl.datetime(2025, 7, 24, 15, 45)
    frame = foreign(log).with_columns(start + pl.duration(milliseconds="ms")).drop("ms")
    mapping = written(
        tmp_path / "m.toml", FOREIGN.replace('"ms", unit = "ms"', '"datetime", unit = "datetime"')
    )
    path = tmp_path / ("a.csv" if form else "a.parquet")
    if form:
        frame.with_columns(pl.col("datetime").dt.strftime(form)).write_csv(path)
    else:
        frame.write_parquet(path)
    back = Log.read(path, mapping)
    np.testing.assert_allclose(back.t, log.t, atol=1e-6)
    assert "t_s: counted from 2025-07-24 15:45:00 UTC" in back.notes
    if form:
        written(path, path.read_text().replace("15:45:07.2", "15:4x:07.2"))
        message = refused(path, mapping)
        assert "column datetime, line 74: '2025-07-24" in message
        assert "is not a date and time; correct it" in message


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[columns", "is not valid TOML"),
        ("[column]\n", "top: unknown key 'column'"),
        ("[columns]\ncompas_rad = 'x'", "did you mean compass_rad?"),
        ("[columns]\nt_s = { from = 't', unit = 'hours' }", "t_s: unknown unit 'hours'; known he"),
        ("[columns]\nt_s = { topic = '/a', field = 'b' }", "t_s: a message has its own time"),
        ("[columns]\nt_s = { unit = 's' }", 't_s: needs from = "column of the file", or topic'),
        ("[columns]\nt_s = { from = 't', scale = 'x' }", "t_s scale: 'x' must be a finite number"),
        ("[columns]\nt_s = 1.0", "t_s: must be a table with the keys from, topic"),
        ("[columns]\nn_rps = 1.0\nn_left_rps = 2.0", "n_left_rps: is given twice; remove one"),
        ("[columns]\ngps_x_m = { from = 'e', frame = 'enu' }", "name the field that points north"),
        ("[position]\ndatum = [1.0]", "[position] datum: must be [latitude, longitude]"),
        ("[heading]\nquaternion = ['x']", "[heading] quaternion: must be a field, or the columns"),
        ("[heading]\nframe = 'nwu'", "[heading] frame: 'nwu' must be"),
        ("[rows]\nstart_s = 2.0\nstop_s = 1.0", "[rows]: start_s must be below stop_s"),
        ("stamp = 'now'", "stamp: 'now' must be"),
    ],
)
def test_wrong_mapping_is_refused_with_its_place(tmp_path: Path, text: str, words: str) -> None:
    path = written(tmp_path / "m.toml", text)
    with pytest.raises(LogError) as caught:
        Layout.load(path)
    assert str(caught.value).startswith(f"{path}: ") and words in str(caught.value)


def test_mapping_of_absent_columns_is_refused(tmp_path: Path) -> None:
    run().write(path := tmp_path / "a.csv")
    mapping = written(tmp_path / "m.toml", "[columns]\ncompass_rad = 'compas_rad'")
    message = refused(path, mapping)
    assert (
        f"has no column 'compas_rad', which {mapping} asks for; did you mean compass_ra" in message
    )
    assert "(line 1 has: t_s, n_left_rps" in message
    written(mapping, "[columns]\ncompass_rad = { topic = '/a', field = 'b' }")
    assert "a file of columns needs from =, not topic" in refused(path, mapping, mapping)
    assert "cannot be read (No such" in refused(path, tmp_path / "b", tmp_path / "b")


def test_quaternion_becomes_heading(tmp_path: Path) -> None:
    log = run()
    half = 0.5 * (0.5 * math.pi - log.z[:, 4])
    log.write(tmp_path / "a.csv")
    frame = pl.read_csv(tmp_path / "a.csv").drop("compass_rad")
    frame.with_columns(
        qx=pl.lit(0.0), qy=pl.lit(0.0), qz=pl.Series(np.sin(half)), qw=pl.Series(np.cos(half))
    ).write_csv(tmp_path / "a.csv")
    mapping = written(tmp_path / "m.toml", "[heading]\nquaternion = ['qx', 'qy', 'qz', 'qw']")
    heading = Log.read(tmp_path / "a.csv", mapping).z[:, 4]
    np.testing.assert_allclose(heading, np.mod(log.z[:, 4], 2.0 * math.pi), atol=1e-12)


@pytest.mark.parametrize("frame", ["ned", "enu"])
def test_quaternion_becomes_roll_and_pitch(tmp_path: Path, frame: str) -> None:
    """In ROS, the body's second axis points to port and its third up: pitch changes its sign."""
    log = run()
    n = len(log)
    roll, pitch = 0.3 * np.sin(0.1 * np.arange(n)), 0.2 * np.cos(0.07 * np.arange(n))
    sign = -1.0 if frame == "enu" else 1.0
    turn = Rotation.from_euler("ZYX", np.stack([log.z[:, 4], sign * pitch, roll], axis=1))
    log.write(tmp_path / "a.csv")
    parts = dict(zip(("qx", "qy", "qz", "qw"), 2.0 * turn.as_quat().T, strict=True))
    pl.read_csv(tmp_path / "a.csv").with_columns(
        **{name: pl.Series(values) for name, values in parts.items()}
    ).write_csv(tmp_path / "a.csv")
    text = f"[attitude]\nquaternion = ['qx', 'qy', 'qz', 'qw']\nframe = '{frame}'"
    z = Log.read(tmp_path / "a.csv", written(tmp_path / "m.toml", text)).z
    np.testing.assert_allclose(z[:, AHRS_ROLL], roll, atol=1e-12)
    np.testing.assert_allclose(z[:, AHRS_PITCH], pitch, atol=1e-12)


@pytest.mark.parametrize(
    ("frame", "air", "wind_from"),
    # to the west and a little north; aft and a little to port
    [("enu", (-3.0, 1.0), math.atan2(3.0, -1.0)), ("ned", (-3.0, -1.0), math.atan2(1.0, 3.0))],
)
def test_velocity_of_the_air_becomes_wind(
    tmp_path: Path, frame: str, air: tuple[float, float], wind_from: float
) -> None:
    log = run()
    log.write(path := tmp_path / "a.csv")
    speed = np.linspace(1.0, 2.0, len(log))
    columns = {name: pl.Series(value * speed) for name, value in zip("xy", air, strict=True)}
    drop = ["wind_mps", "wind_from_rad", "apparent_wind_mps", "apparent_wind_rad"]
    pl.read_csv(path).drop(drop).with_columns(**columns).write_csv(path)
    tables = "[{}]\nvector = ['x', 'y']\nframe = '{}'\n"
    text = "".join(tables.format(name, frame) for name in ("wind", "apparent_wind"))
    z = Log.read(path, written(tmp_path / "m.toml", text)).z
    for place in (WIND_SPEED, APPARENT_SPEED):
        np.testing.assert_allclose(z[:, place], math.sqrt(10.0) * speed)
    np.testing.assert_allclose(z[:, WIND_FROM], wind_from)
    # ahead, and a little from starboard
    np.testing.assert_allclose(z[:, APPARENT_FROM], math.atan2(1.0, 3.0))


def test_rows_are_cut_and_thinned(tmp_path: Path) -> None:
    log = run(truth=True)
    log.z[5:9, 0] = np.nan
    log.write(path := tmp_path / "a.csv")
    mapping = written(tmp_path / "m.toml", "[rows]\nstart_s = 3.0\nstop_s = 8.95\n")
    piece, same = Log.read(path, mapping), log.slice(3.0, 8.95)
    np.testing.assert_array_equal(piece.t, same.t)
    np.testing.assert_array_equal(piece.truth, same.truth)
    assert f"140 of 200 rows left out or merged: [rows] of {mapping}" in piece.notes
    written(mapping, "[rows]\nstep_s = 0.5\n")
    thin = Log.read(path, mapping)
    np.testing.assert_allclose(thin.t, log.t[4::5])
    # the last sample in each half second
    np.testing.assert_array_equal(thin.z[:3, 0], log.z[[4, 9, 14], 0])
    np.testing.assert_array_equal(thin.cmd, log.cmd[4::5])


def test_known_record_without_a_column_is_refused(tmp_path: Path) -> None:
    log = run()
    frame = pl.DataFrame({"t_s": log.t, "n_rps": log.cmd[:, 0], "delta_rad": log.cmd[:, 2]})
    names = {"x_m": 0, "y_m": 1, "psi_rad": 4, "r_radps": 5}
    frame = frame.with_columns(**{key: pl.Series(log.z[:, j]) for key, j in names.items()})
    frame.write_csv(tmp_path / "a.csv")
    back = Log.read(tmp_path / "a.csv")
    np.testing.assert_array_equal(back.z[:, [0, 1, 4, 5]], log.z[:, [0, 1, 4, 5]])
    frame.drop("psi_rad").write_csv(tmp_path / "a.csv")
    assert "column(s) compass_rad missing; add" in refused(tmp_path / "a.csv")
    frame.drop("psi_rad", "n_rps").write_csv(tmp_path / "a.csv")
    assert "n_right_rps, gps_x_m, gps_y_m, compass_rad missing" in refused(tmp_path / "a.csv")


# --- bags -------------------------------------------------------------------------------------


@pytest.mark.parametrize("storage", ["SQLITE3", "MCAP"])
@pytest.mark.parametrize("bare", [False, True])
def test_a_bag_reads_back_as_the_log_it_was_made_from(
    tmp_path: Path, storage: str, bare: bool
) -> None:
    log = run()
    # commands change at rows where they are sent
    log.cmd[:] = np.repeat(log.cmd[1::2], 2, axis=0)[np.r_[0, 0 : len(log) - 1]]
    path = record(tmp_path / "bag", log, storage, late=20_000_000)
    mapping = written(
        tmp_path / "m.toml", ALL_ROWS.replace('stamp = "header"', 'stamp = "receive"')
    )
    if bare:
        (path,) = [file for file in path.iterdir() if file.suffix in (".mcap", ".db3")]
    back = Log.read(path, mapping)
    np.testing.assert_allclose(back.t, log.t, atol=2e-9)
    np.testing.assert_allclose(back.cmd[1:], log.cmd[1:], rtol=1e-15)
    z = dict(zip(MEASUREMENTS, back.z.T, strict=True))
    for key in ("gyro_radps", "accel_x_mps2", "accel_y_mps2"):
        np.testing.assert_array_equal(z[key], log.z[:, COLUMN[key]])
    turned = np.mod(log.z[:, 4], 2.0 * math.pi)
    np.testing.assert_allclose(z["compass_rad"], turned, atol=1e-14)
    for key in ("gps_vx_mps", "gps_vy_mps"):
        np.testing.assert_array_equal(z[key][::5], log.z[::5, COLUMN[key]])
        assert np.isnan(np.delete(z[key], np.s_[::5])).all()
    assert np.isnan(z["gps_x_m"][0])  # status: no fix
    for key in ("gps_x_m", "gps_y_m"):
        np.testing.assert_allclose(z[key][5::5], log.z[5::5, COLUMN[key]], rtol=1e-6, atol=1e-7)
    assert says(back, "/imu/data", "time of receipt")
    assert "t_s: counted from 2025-07-24 15:45:00 UTC" in back.notes
    assert says(back, "gps_x_m", "no value in 161 of 200 rows")
    mapping.rename(sibling_path(path, ".mapping.toml"))
    assert np.array_equal(Log.read(path).z, back.z, equal_nan=True)


def test_the_time_of_a_message_is_its_header(tmp_path: Path) -> None:
    log = run()
    mapping = written(tmp_path / "m.toml", ALL_ROWS)
    path = record(tmp_path / "a", log, "MCAP", late=20_000_000)
    back = Log.read(path, mapping)
    # commands have no header: their time is that of receipt, 20 ms after the others'
    assert len(back) == 200 + 100 - 1
    assert says(back, "/imu/data", "time of the header")
    assert says(back, "/steering", "time of receipt")
    assert "1 row(s) before the first command left out" in back.notes
    path = record(tmp_path / "b", log, "MCAP", stamped=False)
    assert says(Log.read(path, mapping), "/imu/data", "time of receipt")
    path = record(tmp_path / "c", log, "MCAP", late=50 * 10**9)
    message = refused(path, mapping)
    assert "header stamps and times of receipt differ by 50 s, and not every topic" in message
    thin = Log.read(
        record(tmp_path / "d", log, "MCAP", late=20_000_000), MAPPINGS / "ros2_example.toml"
    )
    assert len(np.unique(np.floor(thin.t / 0.05 + 1e-9))) == len(thin) == 200


def test_messages_out_of_order_are_sorted(tmp_path: Path) -> None:
    log = run()
    mapping = written(tmp_path / "m.toml", ALL_ROWS)
    order = np.arange(200)
    order[[50, 51]] = 51, 50
    back = Log.read(record(tmp_path / "a", log, "SQLITE3", order=order), mapping)
    assert len(back) == 200


def test_bag_without_a_mapped_topic_is_refused(tmp_path: Path) -> None:
    path = record(tmp_path / "a", run(), "MCAP")
    message = refused(path)
    assert (
        "a bag needs a mapping of its topics: --mapping FILE, or a.mapping.toml next to" in message
    )
    assert "/gps/fix (sensor_msgs/msg/NavSatFix), " in message
    mapping = written(tmp_path / "m.toml", ALL_ROWS.replace("/steering", "/rudder"))
    assert f"has no topic /rudder, which {mapping} asks for (topics: /gps/fix" in refused(
        path, mapping
    )
    written(mapping, ALL_ROWS.replace("angular_velocity.z", "angular_rate.z"))
    message = refused(path, mapping)
    assert "topic /imu/data (sensor_msgs/msg/Imu): no field angular_rate.z; the message" in message
    written(mapping, ALL_ROWS.replace('"angular_velocity.z"', '"header.frame_id"'))
    assert "the field header.frame_id is a str, no number" in refused(path, mapping)
    written(mapping, ALL_ROWS.split("[position]")[0])
    assert "column(s) gps_x_m, gps_y_m, compass_rad missing; name them in" in refused(path, mapping)
    written(mapping, FOREIGN)
    assert "a bag needs topic = and field =, not from =" in refused(path, mapping, mapping)


def test_incomplete_bag_is_refused(tmp_path: Path) -> None:
    path = record(tmp_path / "a", run(), "MCAP")
    (file,) = path.glob("*.mcap")
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(file.read_bytes()[:-500])
    mapping = written(tmp_path / "m.toml", ALL_ROWS)
    for bad in (cut, written(tmp_path / "empty.mcap", ""), written(tmp_path / "text.db3", "t_s\n")):
        message = refused(bad, mapping)
        assert "the bag is damaged, cut off or no ROS bag (" in message
        assert "mcap recover IN.mcap -o OUT.mcap" in message
    (path / "metadata.yaml").unlink()
    assert "ros2 bag reindex FOLDER" in refused(path, mapping)
    assert "cannot be read (No such file" in refused(tmp_path / "none.mcap", mapping)


# --- damaged and overlong files ---------------------------------------------------------------


def log_or_message(path: Path, mapping: Path | None = None) -> None:
    """Check that a file gives a complaint about it, or all that each log must hold."""
    try:
        log = Log.read(path, mapping)
    except LogError as error:
        if not str(error).startswith(f"{path}: "):
            raise
        return
    assert np.isfinite(log.t).all() and (np.diff(log.t) > 0.0).all()
    assert np.isfinite(log.cmd).all() and log.cmd.shape == (len(log), len(COMMANDS))
    assert not np.isinf(log.z).any() and log.z.shape == (len(log), len(MEASUREMENTS))


def test_parquet_page_over_which_polars_ends_its_process_is_a_message(tmp_path: Path) -> None:
    """One bit turns a page of 5 values to one of -6, for which polars 2.1 wants 2**61 bytes."""
    frame = pl.DataFrame({"t_s": np.arange(5.0)})
    frame.write_parquet(path := tmp_path / "a.parquet", compression="uncompressed")
    head = b",\x15\x0a"  # a data page, and its number of values, twice as Thrift has it
    assert head in path.read_bytes()
    path.write_bytes(path.read_bytes().replace(head, b",\x15\x0b", 1))
    assert "the Parquet file is damaged or cut off (" in refused(path)


@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_broken_columns_give_a_log_or_a_message(tmp_path: Path, data: st.DataObject) -> None:
    """Cells, rows and columns that are dropped, doubled, shuffled, frozen, moved or replaced."""
    log = run(60, truth=True)
    log.write(tmp_path / "a.csv")
    rows = (tmp_path / "a.csv").read_text().splitlines()
    header, cells = rows[0].split(","), [row.split(",") for row in rows[1:]]
    number = st.floats(allow_nan=True, allow_infinity=True).map(repr)
    cell = number | st.sampled_from(["", "-", "12,5", "1e999", "nan", '"', "1.2.3", "\x00", "é"])
    for _ in range(data.draw(st.integers(1, 4))):
        a, b = sorted(data.draw(st.tuples(*[st.integers(0, len(cells) - 1)] * 2)))
        j = data.draw(st.integers(0, len(header) - 1))
        match data.draw(st.integers(0, 6)):
            case 0:
                cells[a][j] = data.draw(cell)
            case 1:
                cells[a:b] = cells[a:b] * 2
            case 2:
                cells[a:b] = reversed(cells[a:b])
            case 3:
                for row in cells[a:b]:
                    row[j] = cells[a][j]
            case 4:
                for row in cells[a:b]:
                    row[j] = repr(float(row[j] or "nan") + 500.0) if _number(row[j]) else row[j]
            case 5:
                header[j] = data.draw(st.sampled_from(header))
            case 6:
                del cells[a]
        cells = [list(row) for row in cells] or [[""] * len(header)]
    text = "\n".join([",".join(header), *(",".join(row) for row in cells)])
    path = written(tmp_path / "b.csv", text)
    log_or_message(path)


def _number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.parquet", b"", "the file is empty; write it again"),
        ("a.parquet", b"t_s,x\n", "is not a Parquet file; write it again, or give a CSV file"),
        ("a.parquet", b"PAR1", "the Parquet file is damaged or cut off ("),
        ("a.csv", b"t_s,gps_x_m,compass_rad\n" + b"1" * 5000, "column(s) n_left_rps"),
    ],
)
def test_other_files_are_refused(tmp_path: Path, name: str, content: bytes, words: str) -> None:
    (tmp_path / name).write_bytes(content)
    assert words in refused(tmp_path / name)


def test_parquet_of_other_types_is_converted_or_refused(tmp_path: Path) -> None:
    log = run()
    log.write(path := tmp_path / "a.parquet")
    frame = pl.read_parquet(path)
    frame.with_columns(pl.col("gps_x_m").cast(pl.String)).write_parquet(path)
    np.testing.assert_array_equal(Log.read(path).z, log.z)
    bad = pl.when(pl.col("t_s") > 1.0).then(pl.lit("?")).otherwise(pl.col("gps_x_m"))
    frame.with_columns(bad.alias("gps_x_m")).write_parquet(path)
    assert "column gps_x_m, row 12: '?' is not a number; correct it" in refused(path)
    frame.with_columns(gps_x_m=pl.lit([1.0])).write_parquet(path)
    assert "column gps_x_m holds List(Float64), not numbers; convert it" in refused(path)
    frame.with_columns(gps_x_m=pl.datetime(2025, 1, 1)).write_parquet(path)
    assert "column gps_x_m holds dates, not numbers; convert it" in refused(path)
    frame[:1].write_parquet(path)
    assert "1 row of data after the header; a log needs two" in refused(path)


def test_block_size_changes_no_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = run()
    log.z[7] = np.nan
    whole = []
    for name in ("a.csv", "a.csv.gz", "a.parquet"):
        log.write(tmp_path / name)
        whole.append(Log.read(tmp_path / name))
    lines = (tmp_path / "a.csv").read_text().splitlines()
    bad = written(tmp_path / "b.csv", "\n".join([*lines[:150], "", lines[150] + "x", *lines[151:]]))
    place = refused(bad)
    thin = written(tmp_path / "m.toml", "[rows]\nstep_s = 0.7\n")
    thinned = Log.read(tmp_path / "a.csv", thin)
    monkeypatch.setattr(files, "_BLOCK_BYTES", 700)
    monkeypatch.setattr(parquet, "_BLOCK_ROWS", 30)
    for name, once in zip(("a.csv", "a.csv.gz", "a.parquet"), whole, strict=True):
        again = Log.read(tmp_path / name)
        np.testing.assert_array_equal(again.z, once.z)
        assert again.notes == once.notes
    assert refused(bad) == place
    np.testing.assert_array_equal(Log.read(tmp_path / "a.csv", thin).z, thinned.z)
    monkeypatch.setattr(files, "_BLOCK_BYTES", 64)
    assert "a line is longer than 1 MB; this is no CSV file" in refused(tmp_path / "a.csv")


@pytest.mark.parametrize("name", ["a.csv", "a.csv.gz", "a.parquet"])
def test_log_of_too_many_rows_is_refused(
    tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    run().write(path := tmp_path / name)
    monkeypatch.setattr(table, "MAX_ROWS", 100)
    monkeypatch.setattr(files, "_BLOCK_BYTES", 4000)
    monkeypatch.setattr(parquet, "_BLOCK_ROWS", 30)
    message = refused(path)
    assert "has more than 100 rows, the most that a log may have. Read a piece" in message
    for rows, count in (("start_s = 12.0", 80), ("stop_s = 9.95", 100), ("step_s = 0.5", 40)):
        mapping = written(tmp_path / "m.toml", f"[rows]\n{rows}\n")
        assert len(Log.read(path, mapping)) == count


def test_parquet_without_its_library_names_the_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (log := run()).write(path := tmp_path / "a.parquet")
    states = StateTable.of({"t_s": log.t, "x_m": log.t, "y_m": log.t})
    monkeypatch.setitem(sys.modules, "polars", None)
    acts = (partial(log.write, path), partial(Log.read, path), states.to_polars)
    for act in (*acts, partial(states.write, path)):
        with pytest.raises(UsvTwinError, match=r"pip install 'usv-twin\[parquet\]'"):
            act()


# --- the commands -----------------------------------------------------------------------------


def test_a_package_adds_a_mapping(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    written(tmp_path / "our.toml", 'files = "sail*"\n' + FOREIGN)
    written(tmp_path / "our_logger.py", "MAPPING = __file__.replace('our_logger.py', 'our.toml')")
    info = tmp_path / "our_logger-1.0.dist-info"
    info.mkdir()
    written(info / "METADATA", "Metadata-Version: 2.1\nName: our-logger\nVersion: 1.0\n")
    points = "ours = our_logger:MAPPING\nbroken = our_logger:NOTHING\n"
    written(info / "entry_points.txt", f"[{mapping.GROUP}]\n{points}")
    monkeypatch.syspath_prepend(tmp_path)
    log = run()
    for name in ("sail_1.csv", "other.csv"):
        foreign(log).write_csv(tmp_path / name)
    mapping._known.cache_clear()
    try:
        with pytest.raises(LogError, match="our_logger:NOTHING"):
            Log.read(tmp_path / "other.csv", "broken")
        del mapping._known()["broken"]
        named = Log.read(tmp_path / "other.csv", "ours")
        found = Log.read(tmp_path / "sail_1.csv")
        np.testing.assert_array_equal(found.z, named.z)
        with pytest.raises(LogError, match="missing"):
            Log.read(tmp_path / "other.csv")
    finally:
        mapping._known.cache_clear()


def test_a_bag_of_ros_1_and_a_folder_of_them_are_read(tmp_path: Path) -> None:
    pytest.importorskip("rosbags")
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store, rows = get_typestore(Stores.ROS1_NOETIC), 60
    number = store.types["std_msgs/msg/Float64"]

    def part(path: Path, begin: int) -> None:
        with Writer(path) as writer:
            topics = {
                name: writer.add_connection(f"/{name}", "std_msgs/msg/Float64", typestore=store)
                for name in ("x", "y", "psi", "n")
            }
            for k in range(begin, begin + rows):
                for name, value in (("x", 0.2 * k), ("y", 0.1 * k), ("psi", 0.01 * k), ("n", 5.0)):
                    data = store.serialize_ros1(number(data=value), "std_msgs/msg/Float64")
                    writer.write(topics[name], 1_714_728_600_000_000_000 + k * 10**8, data)

    (tmp_path / "parts").mkdir()
    part(tmp_path / "a.bag", 0)
    part(tmp_path / "parts" / "1.bag", 0)
    part(tmp_path / "parts" / "2.bag", rows)
    columns = {"gps_x_m": "x", "gps_y_m": "y", "compass_rad": "psi", "n_rps": "n"}
    lines = [f'{name} = {{ topic = "/{of}", field = "data" }}' for name, of in columns.items()]
    mapping = written(
        tmp_path / "m.toml", "\n".join(["[columns]", "delta_rad = 0.0", *lines]) + "\n"
    )
    for path, count in ((tmp_path / "a.bag", rows), (tmp_path / "parts", 2 * rows)):
        log = Log.read(path, mapping)
        assert len(log) in (count, count - 1)
        assert log.z[-1, 0] == pytest.approx(0.2 * (count - 1))
        assert np.diff(log.t) == pytest.approx(0.1)


def test_an_mcap_of_another_encoding_is_named(tmp_path: Path) -> None:
    writer = pytest.importorskip("mcap.writer")
    with (tmp_path / "a.mcap").open("wb") as file:
        mcap = writer.Writer(file)
        mcap.start(profile="", library="x")
        schema = mcap.register_schema("Position", "jsonschema", b'{"type":"object"}')
        channel = mcap.register_channel("position", "json", schema)
        mcap.add_message(channel, log_time=1, publish_time=1, data=b'{"lat": 41.5}')
        mcap.finish()
    mapping = written(tmp_path / "m.toml", "[columns]\nn_rps = 1.0\n")
    assert "an MCAP of JSON messages" in refused(tmp_path / "a.mcap", mapping)
