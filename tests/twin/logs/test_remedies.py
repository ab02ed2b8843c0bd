"""Messages about foreign logs name the cause and a remedy that ends the matter."""

from __future__ import annotations

from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from twin.cli.main import app
from twin.logs.errors import LogError
from twin.logs.log import Log
from twin.logs.recording import clashing_rows

HEAD = "time,lat,lon,heading_deg,rpm_left,rpm_right"
NAME = "boat1_usv_circle"


def write(path: Path, lines: list[str]) -> Path:
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def rows(times: list[str]) -> list[str]:
    return [
        f"{t},{59.9 + 1e-5 * k:.9f},{10.7 + 1e-5 * k:.9f},{k % 90},{600 + k},600"
        for k, t in enumerate(times)
    ]


def mapped(path: Path) -> Log:
    result = CliRunner().invoke(app, ["mapping", str(path)])
    assert result.exit_code == 0, result.output
    return Log.read(path)


def refusal(path: Path) -> str:
    with pytest.raises(LogError) as caught:
        Log.read(path)
    return str(caught.value)


# --- times --------------------------------------------------------------------------------------

START = datetime(2024, 4, 23, 15, 30, 52)


def test_a_time_of_day_gives_no_date(tmp_path: Path) -> None:
    times = [f"{START + timedelta(seconds=0.5 * k):%H%M%S.%f}" for k in range(150)]
    log = mapped(write(tmp_path / "a.csv", [HEAD, *rows(times)]))
    assert log.datum is not None and log.datum.epoch is None
    assert any("15:30:52, the log keeps no date" in text for text in log.notes)


@pytest.mark.parametrize(("unit", "scale"), [("ms", 1e3), ("us", 1e6), ("ns", 1e9), ("s", 1.0)])
def test_unix_times_keep_their_date(tmp_path: Path, unit: str, scale: float) -> None:
    digits = 2 if scale == 1.0 else 0
    times = [f"{scale * (1713886252.25 + 0.5 * k):.{digits}f}" for k in range(150)]
    head = HEAD.replace("time", f"timestamp_{unit}")
    log = mapped(write(tmp_path / "a.csv", [head, *rows(times)]))
    assert log.datum is not None
    dates = log.datum.utc(log.t[:1])
    assert dates is not None
    assert abs(dates[0] - np.datetime64("2024-04-23T15:30:52.25")) < np.timedelta64(1, "ms")


def test_whole_seconds_are_one_finding(tmp_path: Path) -> None:
    times = [f"{START + timedelta(seconds=k // 5):%Y-%m-%d %H:%M:%S}" for k in range(300)]
    path = write(tmp_path / "a.csv", [HEAD, *rows(times)])
    assert CliRunner().invoke(app, ["mapping", str(path)]).exit_code == 0
    output = CliRunner().invoke(app, ["check", str(path), "--no-picture"]).output
    about = [line for line in output.splitlines() if "time of the row before" in line]
    assert len(about) == 1 and "as times in whole seconds do" in about[0]
    assert "merged" not in output and "time does not increase" not in output
    assert "record fractions of a second" in refusal(path)


@given(st.lists(st.tuples(st.integers(0, 3), st.sampled_from([0.0, 1.0, np.nan])), max_size=12))
def test_rows_clash_where_two_of_one_time_differ(cells: list[tuple[int, float]]) -> None:
    t = np.sort(np.array([cell[0] for cell in cells], dtype=np.float64))
    x = np.array([cell[1] for cell in cells], dtype=np.float64)
    known = [set(x[(t == each) & ~np.isnan(x)].tolist()) for each in np.unique(t)]
    assert (clashing_rows({"t_s": t, "x": x}) > 0) == any(len(each) > 1 for each in known)


# --- columns and lines --------------------------------------------------------------------------


def test_the_first_error_of_a_foreign_log_names_mapping_new(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", [HEAD, *rows([str(k) for k in range(30)])])
    assert f"usv-twin mapping {path}" in refusal(path)


def test_fixed_thrusters_need_no_column_of_angles(tmp_path: Path) -> None:
    path = write(
        tmp_path / "a.csv",
        ["t_s,n_left_rps,n_right_rps,gps_x_m,gps_y_m,compass_rad"]
        + [f"{k},{k},3,{k},0,{0.1 * k}" for k in range(30)],
    )
    message = refusal(path)
    assert "delta_left_rad, delta_right_rad missing" in message
    assert "for fixed thrusters write delta_rad = 0.0" in message


@pytest.mark.parametrize(
    ("above", "words"),
    [
        (["# logger v1.2"], "line 1 looks like comments"),
        (["# logger v1.2", "# Otter"], "lines 1 to 2 look like comments"),
        (["Otter", "23 April", "rough"], "lines 1 to 3 look like comments"),
        (["# Otter, rough, windy", "% 2024"], "lines 1 to 2 look like comments"),
    ],
)
def test_lines_above_the_header_are_named(tmp_path: Path, above: list[str], words: str) -> None:
    path = write(tmp_path / "a.csv", [*above, HEAD, *rows([str(k) for k in range(30)])])
    assert words in refusal(path)
    output = CliRunner().invoke(app, ["mapping", str(path)]).output
    assert words in " ".join(output.split())


def test_a_header_may_begin_with_a_mark_of_comments(tmp_path: Path) -> None:
    names = "# t_s,n_rps,delta_rad,gps_x_m,gps_y_m,compass_rad"
    path = write(tmp_path / "a.csv", [names, *(f"{k},1,0,{k},0,0" for k in range(30))])
    assert "comments" not in refusal(path)


@pytest.mark.parametrize("latitude", ["5954.4200", "-3330.6000"])
def test_degrees_and_minutes_in_one_number_are_read(tmp_path: Path, latitude: str) -> None:
    lines = [f"{k},{latitude},01043.2{k:03d},{k % 90},600,{600 + k}" for k in range(60)]
    path = write(tmp_path / "a.csv", [HEAD, *lines])
    result = CliRunner().invoke(app, ["mapping", str(path)])
    assert 'unit = "ddmm"' in result.output
    log = Log.read(path)
    degrees = {"5954.4200": 59.907, "-3330.6000": -33.51}[latitude]
    assert log.datum is not None and log.datum.plane is not None
    assert log.datum.plane.latitude == pytest.approx(degrees, abs=1e-9)
    assert log.datum.plane.longitude == pytest.approx(10.0 + 43.2 / 60.0, abs=1e-9)
    mapping = path.with_suffix(".mapping.toml")
    mapping.write_text(mapping.read_text().replace("ddmm", "deg"))
    message = refusal(path)
    assert "ddmm.mm" in message and 'unit = "ddmm"' in message
