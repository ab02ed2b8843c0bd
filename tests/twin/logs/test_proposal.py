"""Proposed mappings read logs of other programs as what they are."""

from __future__ import annotations

import math
from collections.abc import Callable
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from twin.channels import ACCEL_Z, AHRS_PITCH, AHRS_ROLL, GPS_Z, GYRO_X, GYRO_Y
from twin.cli.main import app
from twin.logs.dates import date_formats, dates
from twin.logs.errors import LogError
from twin.logs.log import Log
from twin.logs.proposal.propose import propose
from twin.sim.bridge import simulate
from usv_gym import SeaState, Vessel
from usv_gym.world.sensors import SensorSuite
from usv_kernel.channels import ACCEL_X, ACCEL_Y, GYRO

START = datetime(2024, 5, 13, 9, 30, tzinfo=timezone(timedelta(hours=2)))
LATITUDE, LONGITUDE = 59.43, 10.47
KNOT = 1852.0 / 3600.0


@pytest.fixture(scope="module")
def run() -> Log:
    """Return a zigzag of a boat with drives, and sensors of a good grade."""
    return simulate(
        "zigzag",
        vessel=Vessel.load("usv75"),
        sea=SeaState(hs=0.2, wind=3.0),
        duration=120.0,
        seed=1,
        suite=SensorSuite(gps_white=0.05, gps_bias=0.0, gps_latency=0.0),
    )


Column = Callable[[Log], list[str]]


def numbers(values: Callable[[Log], np.ndarray], digits: int = 9) -> Column:
    return lambda log: [f"{x:.{digits}f}" for x in values(log)]


def stamps(form: str) -> Column:
    def column(log: Log) -> list[str]:
        texts = ((START + timedelta(seconds=float(t))).strftime(form) for t in log.t)
        return [text.replace("+0200", "+02:00") for text in texts]

    return column


TO_NORTH, TO_EAST = 111_415.0, 56_895.0  # metres in a degree there
lat = numbers(lambda log: LATITUDE + log.z[:, 0] / TO_NORTH)
lon = numbers(lambda log: LONGITUDE + log.z[:, 1] / TO_EAST)
speed = numbers(lambda log: np.hypot(log.z[:, 2], log.z[:, 3]))
knots = numbers(lambda log: np.hypot(log.z[:, 2], log.z[:, 3]) / KNOT)
course = numbers(lambda log: np.degrees(np.arctan2(log.z[:, 3], log.z[:, 2])) % 360.0)
heading = numbers(lambda log: np.degrees(log.z[:, 4]) % 360.0)
rate = numbers(lambda log: np.degrees(log.z[:, 5]))

LOGGERS: dict[str, dict[str, Column]] = {
    "survey boat": {
        "Date": stamps("%Y-%m-%dT%H:%M:%S.%f%z"),
        "Lat": lat,
        "Lon": lon,
        "SOG": knots,
        "COG": course,
        "Heading": heading,
        "ROT": numbers(lambda log: 60.0 * np.degrees(log.z[:, 5])),
        "RPM left": numbers(lambda log: 60.0 * log.cmd[:, 0]),
        "RPM right": numbers(lambda log: 60.0 * log.cmd[:, 1]),
        "Rudder angle": numbers(lambda log: np.degrees(log.cmd[:, 2])),
        "Battery": numbers(lambda log: 24.0 + 0.0 * log.t),
    },
    "autopilot": {
        "timestamp_ms": numbers(lambda log: 1.7e12 + 1000.0 * log.t, 3),
        "latitude": lat,
        "longitude": lon,
        "ground_speed_mps": speed,
        "course_deg": course,
        "yaw_rad": numbers(lambda log: np.remainder(0.5 * math.pi - log.z[:, 4], 2.0 * math.pi)),
        "yaw_rate_degps": numbers(lambda log: -np.degrees(log.z[:, 5])),
        "n_rps": numbers(lambda log: log.cmd[:, 0]),
        "rudder_rad": numbers(lambda log: log.cmd[:, 2]),
    },
    "American": {
        "Time": stamps("%m/%d/%Y %I:%M:%S.%f %p"),
        "North (m)": numbers(lambda log: log.z[:, 0]),
        "East (m)": numbers(lambda log: log.z[:, 1]),
        "Speed (kts)": knots,
        "Course (deg)": course,
        "Compass (deg)": heading,
        "Yaw Rate (deg/s)": rate,
        "Throttle port": numbers(lambda log: 100.0 * log.cmd[:, 0] / log.cmd[:, 0].max()),
        "Throttle starboard": numbers(lambda log: 100.0 * log.cmd[:, 1] / log.cmd[:, 1].max()),
        "Steering (deg)": numbers(lambda log: np.degrees(log.cmd[:, 2])),
    },
    "ArduPilot": {
        "TimeUS": numbers(lambda log: 1e6 * log.t + 5e7, 0),
        "Lat": lat,
        "Lng": lon,
        "Spd": speed,
        "GCrs": course,
        "Yaw": heading,
        "GyrX": numbers(lambda log: 0.1 * np.sin(0.7 * log.t)),
        "GyrZ": numbers(lambda log: log.z[:, 5]),
        "RCOU.C1": numbers(lambda log: 1500.0 + 20.0 * log.cmd[:, 0]),
        "RCOU.C3": numbers(lambda log: 1500.0 + 20.0 * log.cmd[:, 1]),
        "rudder_rad": numbers(lambda log: log.cmd[:, 2]),
    },
    "MAVLink": {
        "time_boot_ms": numbers(lambda log: 1000.0 * log.t, 3),
        "lat_e7": numbers(lambda log: 1e7 * (LATITUDE + log.z[:, 0] / TO_NORTH), 0),
        "lon_e7": numbers(lambda log: 1e7 * (LONGITUDE + log.z[:, 1] / TO_EAST), 0),
        "vx": numbers(lambda log: 100.0 * log.z[:, 2]),
        "vy": numbers(lambda log: 100.0 * log.z[:, 3]),
        "hdg_cdeg": numbers(lambda log: 100.0 * (np.degrees(log.z[:, 4]) % 360.0)),
        "yaw_rate_dps": rate,
        "n_l": numbers(lambda log: log.cmd[:, 0]),
        "n_r": numbers(lambda log: log.cmd[:, 1]),
        "delta_l": numbers(lambda log: log.cmd[:, 2]),
        "delta_r": numbers(lambda log: log.cmd[:, 3]),
    },
    "motors": {
        "Zeit": stamps("%Y-%m-%d %H:%M:%S.%f %z"),
        "gps.lat": lat,
        "gps.lon": lon,
        "gps.speed_kmh": numbers(lambda log: 3.6 * np.hypot(log.z[:, 2], log.z[:, 3])),
        "gps.course": course,
        "imu.yaw": numbers(lambda log: np.remainder(log.z[:, 4], 2.0 * math.pi)),
        "imu.gyro_z": numbers(lambda log: log.z[:, 5]),
        "Port motor rpm": numbers(lambda log: 60.0 * log.cmd[:, 0]),
        "Stbd motor rpm": numbers(lambda log: 60.0 * log.cmd[:, 1]),
        "left_drive_angle": numbers(lambda log: log.cmd[:, 2]),
        "right_drive_angle": numbers(lambda log: log.cmd[:, 3]),
    },
    "swapped": {
        "t": numbers(lambda log: log.t),
        "Latitude": numbers(lambda log: 110.47 + log.z[:, 1] / TO_EAST),
        "Longitude": lat,
        "speed_kmh": numbers(lambda log: 3.6 * np.hypot(log.z[:, 2], log.z[:, 3])),
        "cog": course,
        "hdg": heading,
        "n1": numbers(lambda log: log.cmd[:, 0]),
        "n2": numbers(lambda log: log.cmd[:, 1]),
        "delta1": numbers(lambda log: log.cmd[:, 2]),
        "delta2": numbers(lambda log: log.cmd[:, 3]),
    },
}


def write(
    path: Path, log: Log, columns: dict[str, Column], mark: str = ",", point: str = "."
) -> Path:
    cells = [[cell.replace(".", point) for cell in make(log)] for make in columns.values()]
    rows = [mark.join(columns), *(mark.join(row) for row in zip(*cells, strict=True))]
    path.write_text("\n".join(rows).replace("nan", "") + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize("name", LOGGERS)
def test_a_proposed_mapping_reads_the_log(tmp_path: Path, run: Log, name: str) -> None:
    path = write(tmp_path / "run.csv", run, LOGGERS[name])
    result = CliRunner().invoke(app, ["mapping", str(path)])
    assert result.exit_code == 0, result.output
    taken = CliRunner().invoke(app, ["mapping", str(path), "-o", str(path.with_suffix(".toml"))])
    assert taken.exit_code == 2 and "particulars" in taken.output
    back = Log.read(path)
    assert np.abs(back.t - run.t - (back.t[0] - run.t[0])).max() < 2e-3
    for column in (0, 1):
        error = back.z[:, column] - run.z[:, column]
        assert np.nanmax(np.abs(error - np.nanmean(error))) < 0.5
    assert np.nanmax(np.abs(back.z[:, 2:4] - run.z[:, 2:4])) < 1e-3
    turned = np.remainder(back.z[:, 4] - run.z[:, 4] + math.pi, 2.0 * math.pi) - math.pi
    assert np.nanmax(np.abs(turned)) < 1e-6
    if name != "swapped":
        assert np.nanmax(np.abs(back.z[:, 5] - run.z[:, 5])) < 1e-6
    scale = {"American": 100.0 / run.cmd[:, 0].max(), "ArduPilot": 0.4}.get(name, 1.0)
    assert np.abs(back.cmd[:, :2] - scale * run.cmd[:, :2]).max() < 1e-6
    assert np.abs(back.cmd[:, 2:] - run.cmd[:, 2:]).max() < 1e-6
    checked = CliRunner().invoke(app, ["check", str(path), "--no-picture"])
    assert checked.exit_code == 0 or "shaft" in checked.output, checked.output


@pytest.mark.parametrize(("mark", "point"), [(";", "."), (";", ","), ("\t", "."), ("\t", ",")])
@pytest.mark.parametrize("name", ["survey boat", "motors"])
def test_semicolons_tabs_and_decimal_commas_are_read(
    tmp_path: Path, run: Log, name: str, mark: str, point: str
) -> None:
    same, other = tmp_path / "a.csv", tmp_path / "b.csv"
    write(same, run, LOGGERS[name])
    write(other, run, LOGGERS[name], mark, point)
    for path in (same, other):
        result = CliRunner().invoke(app, ["mapping", str(path)])
        assert result.exit_code == 0, result.output
    a, b = Log.read(same), Log.read(other)
    np.testing.assert_allclose(a.t, b.t, atol=1e-6)
    np.testing.assert_allclose(a.z, b.z, atol=1e-9)
    np.testing.assert_allclose(a.cmd, b.cmd, atol=1e-9)


def test_commas_that_part_thousands_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    rows = [f"{k};0.5;{k};1,234.5;0.1" for k in range(9)]
    path.write_text("t_s;n_rps;gps_x_m;gps_y_m;compass_rad\n" + "\n".join(rows) + "\n")
    with pytest.raises(LogError, match=r"'1,234\.5' is not a number"):
        Log.read(path)


def test_what_is_open_is_asked(tmp_path: Path, run: Log) -> None:
    """Swapped within 90 degrees, a date apart, text, and velocities that are not over ground."""
    columns = {
        "Date": stamps("%Y-%m-%d"),
        "Clock": stamps("%H:%M:%S.%f"),
        "Latitude": lon,
        "Longitude": lat,
        "vx": numbers(lambda log: np.sin(log.t)),
        "vy": numbers(lambda log: np.cos(log.t)),
        "Heading": heading,
        "n1": numbers(lambda log: log.cmd[:, 0]),
        "n2": numbers(lambda log: log.cmd[:, 1]),
    }
    text = propose(write(tmp_path / "a.csv", run, columns)).text("a.csv")
    assert 'from = ["Date", "Clock"]' in text and "keeps no date" not in text
    assert "or latitude and longitude are swapped" in text
    assert "vx, vy: are these m/s to north and east?" in text and "gps_vx_mps" not in text
    columns["Latitude"] = lambda log: ["by the quay"] * len(log)
    text = propose(write(tmp_path / "b.csv", run, columns)).text("b.csv")
    assert "left out (empty, or no numbers): Latitude" in text


def test_an_ambiguous_date_asks(tmp_path: Path, run: Log) -> None:
    columns = {**LOGGERS["American"], "Time": lambda log: ["03/05/2024 09:30:00"] * len(log)}
    path = write(tmp_path / "run.csv", run, columns)
    result = CliRunner().invoke(app, ["mapping", str(path)])
    assert result.exit_code == 2
    assert "day first or month first?" in result.output
    assert not (tmp_path / "run.mapping.toml").exists()
    result = CliRunner().invoke(app, ["mapping", str(path), "--dates", "day-first"])
    assert result.exit_code == 0
    assert 'format = "%d/%m/%Y %H:%M:%S%.f"' in (tmp_path / "run.mapping.toml").read_text()
    again = CliRunner().invoke(app, ["mapping", str(path), "--dates", "day-first"])
    assert again.exit_code == 2 and "--force" in again.output


def test_swapped_latitude_and_longitude_are_refused(tmp_path: Path, run: Log) -> None:
    path = write(tmp_path / "run.csv", run, LOGGERS["swapped"])
    assert CliRunner().invoke(app, ["mapping", str(path)]).exit_code == 0
    mapping = tmp_path / "run.mapping.toml"
    text = mapping.read_text()
    assert 'latitude = "Longitude"' in text and "swapped" in text
    text = text.replace('latitude = "Longitude"', 'latitude = "Latitude"')
    mapping.write_text(text.replace('longitude = "Latitude"', 'longitude = "Longitude"'))
    with pytest.raises(LogError, match="latitude and longitude are swapped"):
        Log.read(path)


@pytest.mark.parametrize(
    ("texts", "formats"),
    [
        (["2024-05-03T09:30:00+02:00"], [""]),
        (["2024-05-03 09:30:00.25"], [""]),
        (["2024/05/03 09:30:00"], ["%Y/%m/%d %H:%M:%S%.f"]),
        (["13/05/2024 9:30:00"], ["%d/%m/%Y %H:%M:%S%.f"]),
        (["05/13/2024 9:30:00 am"], ["%m/%d/%Y %I:%M:%S%.f %p"]),
        (["3/5/2024 9:30"], ["%d/%m/%Y %H:%M", "%m/%d/%Y %H:%M"]),
        (["3/5/2024 23:59:59", "4/5/2024 00:00:00"], ["%d/%m/%Y %H:%M:%S%.f"]),
        (["5/3/2024 23:59:59", "5/4/2024 00:00:00"], ["%m/%d/%Y %H:%M:%S%.f"]),
        (["3.5.24, 09:30:00 +0200", "20.5.24, 09:30:00 +0200"], ["%d.%m.%y, %H:%M:%S%.f %#z"]),
        (["03-May-2024 09:30:00"], ["%d-%b-%Y %H:%M:%S%.f"]),
        (["2024-05-03 09:30:00.5 +0200"], ["%Y-%m-%d %H:%M:%S%.f %#z"]),
        (["09:30:00.5"], ["%H:%M:%S%.f"]),
        (["soon"], []),
        ([], []),
    ],
)
def test_formats_of_dates_are_recognised(texts: list[str], formats: list[str]) -> None:
    assert [each.format for each in date_formats(texts)] == formats


@pytest.mark.parametrize(
    "text",
    ["20240503T093000", "2024-05-03T093000Z", "2024-05-03T09:30:00.0 Z", "2024-05- 3 9:30"],
)
def test_dates_of_iso_8601_may_lack_marks(text: str) -> None:
    assert dates([text]) == datetime(2024, 5, 3, 9, 30, tzinfo=UTC).timestamp()


def test_sides_of_shaft_speeds_are_no_yaw_rate(tmp_path: Path) -> None:
    file = tmp_path / "rpm.csv"
    rows = [f"{k},{k},0,0.1,{800 + k % 7},{810 + k % 5}" for k in range(60)]
    file.write_text("t_s,x,y,heading_rad,rpm_l,rpm_r\n" + "\n".join(rows) + "\n", encoding="utf-8")
    lines = propose(file).lines["columns"]
    assert 'n_left_rps = { from = "rpm_l", unit = "rpm" }' in lines
    assert 'n_right_rps = { from = "rpm_r", unit = "rpm" }' in lines
    assert not any(line.startswith("gyro") for line in lines)


def test_roll_pitch_and_heave_are_proposed(tmp_path: Path) -> None:
    """Degrees, g, a height that counts up and a third axis that points up."""
    log = simulate(
        "zigzag",
        vessel=Vessel.load("usv75"),
        sea=SeaState(hs=0.5, wind=3.0),
        duration=60.0,
        seed=1,
        dof=6,
        suite=SensorSuite(gps_white=0.05, gps_bias=0.0, gps_latency=0.0),
    )
    z = log.z
    columns = {
        "time": log.t,
        "x": z[:, 0],
        "y": z[:, 1],
        "altitude": 40.0 - z[:, GPS_Z],
        "heading_deg": np.degrees(z[:, 4]) % 360.0,
        "gx_dps": np.degrees(z[:, GYRO_X]),
        "gy_dps": np.degrees(z[:, GYRO_Y]),
        "gz_dps": np.degrees(z[:, GYRO]),
        "ax_g": z[:, ACCEL_X] / 9.80665,
        "ay_g": z[:, ACCEL_Y] / 9.80665,
        "az_g": -z[:, ACCEL_Z] / 9.80665,
        "roll": np.degrees(z[:, AHRS_ROLL]),
        "pitch": np.degrees(z[:, AHRS_PITCH]),
        "rpm_left": 60.0 * log.cmd[:, 0],
        "rpm_right": 60.0 * log.cmd[:, 1],
        "rudder": np.degrees(log.cmd[:, 2]),
    }
    path = tmp_path / "boat.csv"
    np.savetxt(
        path,
        np.column_stack(list(columns.values())),
        delimiter=",",
        header=",".join(columns),
        comments="",
    )
    mapping = tmp_path / "boat.mapping.toml"
    mapping.write_text(propose(path).text("boat.csv"), encoding="utf-8")
    seen = Log.read(path, mapping).z
    for column in (GYRO_X, GYRO_Y, GYRO, ACCEL_X, ACCEL_Y, ACCEL_Z, AHRS_ROLL, AHRS_PITCH):
        np.testing.assert_allclose(seen[:, column], z[:, column], atol=1e-9)
    fixes = np.isfinite(seen[:, GPS_Z])
    np.testing.assert_allclose(seen[fixes, GPS_Z], z[fixes, GPS_Z] - 40.0, atol=1e-9)


def test_parquet_of_other_programs_is_proposed(run: Log, tmp_path: Path) -> None:
    """An index without a name, words as categories in small groups of rows, and lists."""
    import polars as pl

    rows = len(run)
    frame = pl.DataFrame(
        {
            "": range(rows),
            "mode": pl.Series(["auto", "manual"] * (rows // 2) + ["auto"] * (rows % 2)).cast(
                pl.Categorical
            ),
            "cells": [[1.0, 2.0]] * rows,
            "t_s": run.t,
            "gps_x_m": run.z[:, 0],
            "gps_y_m": run.z[:, 1],
            "compass_rad": run.z[:, 4],
        }
    )
    frame.write_parquet(tmp_path / "a.parquet", row_group_size=50)
    text = propose(tmp_path / "a.parquet").text("a.parquet")
    assert "gps_x_m" in text and "compass_rad" in text
