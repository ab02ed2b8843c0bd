"""Times of unknown logs are read as what they are, or asked about."""

from __future__ import annotations

import math
from collections.abc import Callable
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from twin.cli.main import app
from twin.logs.dates import Midnight, past_midnight
from twin.logs.errors import LogError
from twin.logs.log import Log
from twin.logs.proposal.propose import propose

START = datetime(2024, 4, 5, 11, 58)
EPOCH = 1712318280.0  # of that in UTC
ROWS = 300
STEP = 0.5


def write(path: Path, head: str, cells: Callable[[datetime], str], **more: object) -> Path:
    """Write a log of a circle with two shafts; ``cells`` are those of the time."""
    start = more.get("start", START)
    assert isinstance(start, datetime)
    lines = [f"{head},{more.get('names', 'lat,lon,SOG (kn),COG,heading')},left,right"]
    for k in range(ROWS):
        t = STEP * k
        course = 0.05 * t
        north, east = 40.0 * math.sin(course), -40.0 * math.cos(course)
        lat, lon = 59.9 + north / 111_400.0, 10.7 + east / 55_900.0
        degrees = math.degrees(course) % 360.0
        row = f"{lat:.8f},{lon:.8f},{2.0 * 3600.0 / 1852.0:.3f},{degrees:.2f},{degrees:.2f},300,500"
        lines.append(f"{cells(start + timedelta(seconds=t))},{row}")
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def mapped(path: Path, *options: str) -> Log:
    """Return the log, read by the mapping that is proposed for it."""
    result = CliRunner().invoke(app, ["mapping", str(path), *options])
    assert result.exit_code == 0, result.output
    log = Log.read(path)
    assert log.t[-1] - log.t[0] == pytest.approx(STEP * (ROWS - 1), abs=1e-3)
    assert np.diff(log.t) == pytest.approx(STEP, abs=1e-3)
    return log


def part(t: datetime, digits: int = 3) -> str:
    return f"{t.microsecond:06d}"[:digits]


DATES: dict[str, tuple[str, Callable[[datetime], str], float]] = {
    "UTC": ("Time", lambda t: f"{t:%Y-%m-%d %H:%M:%S.%f} UTC", 0.0),
    "GMT": ("Time", lambda t: f"{t:%d %b %Y %H:%M:%S.%f} GMT", 0.0),
    "CEST": ("Time", lambda t: f"{t:%Y-%m-%d %H:%M:%S.%f} CEST", -7200.0),
    "Python logging": ("Time", lambda t: f'"{t:%Y-%m-%d %H:%M:%S},{part(t)}"', 0.0),
    "colon": ("Time", lambda t: f"{t:%Y-%m-%d %H:%M:%S}:{part(t)}", 0.0),
    "ISO basic": ("Time", lambda t: f"{t:%Y%m%dT%H%M%S.%f}Z", 0.0),
    "digits": ("Time", lambda t: f"{t:%Y%m%d%H%M%S}.{part(t, 4)}", 0.0),
    "date and time": ("Date,Time", lambda t: f"{t:%d.%m.%Y,%H:%M:%S.%f}", 0.0),
    "ISO date and time": ("date,time", lambda t: f"{t:%Y-%m-%d,%H:%M:%S.%f}", 0.0),
    "numbers": ("date,utc", lambda t: f"{t:%Y%m%d,%H%M%S}.{part(t, 2)}", 0.0),
    "NMEA": ("date,utc", lambda t: f"{t:%d%m%y,%H%M%S}.{part(t, 2)}", 0.0),
}


@pytest.mark.parametrize("name", DATES)
def test_dates_of_loggers_are_recognised(tmp_path: Path, name: str) -> None:
    head, cells, ahead = DATES[name]
    options = ("--dates", "day-first") if name == "date and time" else ()
    log = mapped(write(tmp_path / "run.csv", head, cells), *options)
    assert log.datum is not None and log.datum.epoch == pytest.approx(EPOCH + ahead, abs=0.01)


@pytest.mark.parametrize("name", ["date and time", "numbers", "clock", "clock in digits"])
def test_logs_go_on_past_midnight(tmp_path: Path, name: str) -> None:
    clocks: dict[str, tuple[str, Callable[[datetime], str]]] = {
        "clock": ("Time", lambda t: f"{t:%H:%M:%S.%f}"),
        "clock in digits": ("utc", lambda t: f"{t:%H%M%S}.{part(t, 2)}"),
    }
    head, cells = clocks[name] if name in clocks else DATES[name][:2]
    late = datetime(2024, 4, 5, 23, 58, 30)
    options = ("--dates", "day-first") if name == "date and time" else ()
    log = mapped(write(tmp_path / "run.csv", head, cells, start=late), *options)
    assert any("passes midnight" in note for note in log.notes) == (name in clocks)


def test_times_of_day_go_on_from_piece_to_piece() -> None:
    state = Midnight()
    first = past_midnight(np.array([86398.0, 86399.0]), state)
    second = past_midnight(np.array([0.0, 1.0, 5.0, 4.0]), state)
    assert [*first, *second] == [86398.0, 86399.0, 86400.0, 86401.0, 86405.0, 86404.0]
    assert state.days == 1


def test_days_of_a_spreadsheet_are_no_seconds(tmp_path: Path) -> None:
    def days(t: datetime) -> str:
        return f"{(t - datetime(1899, 12, 30)).total_seconds() / 86400.0:.9f}"

    mapped(write(tmp_path / "run.csv", "Time", days))
    assert 'unit = "day"' in (tmp_path / "run.mapping.toml").read_text()


def test_hours_minutes_and_seconds_in_one_number_are_no_seconds(tmp_path: Path) -> None:
    path = write(tmp_path / "run.csv", "utc", lambda t: f"{t:%H%M%S}.{part(t, 2)}")
    assert 'format = "%H%M%S%.f"' in propose(path).lines["columns"][0]
    # seconds stay seconds
    path = write(tmp_path / "s.csv", "t", lambda t: f"{(t - START).total_seconds() + 1e4:.2f}")
    assert propose(path).lines["columns"][0] == 't_s = "t"'


def test_an_ambiguous_zone_asks(tmp_path: Path) -> None:
    path = write(tmp_path / "run.csv", "Time", lambda t: f"{t:%Y-%m-%d %H:%M:%S.%f} EST")
    result = CliRunner().invoke(app, ["mapping", str(path)])
    assert result.exit_code == 2 and "EST is the name of several zones" in result.output
    assert not (tmp_path / "run.mapping.toml").exists()
    log = mapped(path, "--zone", "-05:00")
    assert log.datum is not None and log.datum.epoch == pytest.approx(EPOCH + 5 * 3600.0)
    result = CliRunner().invoke(app, ["mapping", str(path), "--zone", "EST"])
    assert result.exit_code == 2 and "-05:00" in result.output


@pytest.mark.parametrize("head", ["Time (CEST)", "DateTime UTC+2", "Ortszeit", "time (Oslo)"])
def test_a_zone_in_the_header_or_asked_for_is_written_and_used(tmp_path: Path, head: str) -> None:
    path = write(tmp_path / "run.csv", head, lambda t: f"{t:%Y-%m-%d %H:%M:%S.%f}")
    told = head in ("Time (CEST)", "DateTime UTC+2")
    assert told or any("--zone" in question for question in propose(path).questions)
    log = mapped(path, *(() if told else ("--zone", "+02:00")))
    assert log.datum is not None and log.datum.epoch == pytest.approx(EPOCH - 7200.0)
    # what was asked for counts more than the header, and less than the dates themselves
    log = mapped(path, "--zone", "+03:00", "--force")
    assert log.datum is not None and log.datum.epoch == pytest.approx(EPOCH - 10800.0)
    path = write(tmp_path / "run.csv", head, lambda t: f"{t:%Y-%m-%d %H:%M:%S.%f}Z")
    log = mapped(path, "--zone", "+03:00", "--force")
    assert log.datum is not None and log.datum.epoch == pytest.approx(EPOCH)
    assert any("+03:00 is left out" in text for text in propose(path, "", "+03:00").questions)


@pytest.mark.parametrize("names", ["Datum,Uhrzeit", "Fecha,Hora", "Data,Ora", "日期,时间"])
@pytest.mark.parametrize("form", ["%d.%m.%Y,%H:%M:%S.%f", "%Y%m%d,%H:%M:%S.%f"])
def test_a_date_beside_a_time_is_one_in_any_language(tmp_path: Path, names: str, form: str) -> None:
    path = write(tmp_path / "run.csv", names, lambda t: t.strftime(form))
    log = mapped(path, "--dates", "day-first")
    assert log.datum is not None and log.datum.epoch == pytest.approx(EPOCH, abs=0.01)


def test_zones_that_are_unknown_or_contradict_are_asked(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", "Time (ABC)", lambda t: f"{t:%Y-%m-%d %H:%M:%S.%f}")
    assert any("ABC: a zone?" in text for text in propose(path).questions)
    path = write(tmp_path / "a.csv", "Time (CEST)", lambda t: f"{t:%Y-%m-%d %H:%M:%S.%f}")
    said = propose(path, "", "-05:00").text("a.csv")
    assert "-05:00 is taken, as asked" in said and 'zone = "-05:00"' in said


@pytest.mark.parametrize("order", [slice(None, None, -1), np.r_[2, 1, 0, 5, 4, 3, 6:60]])
def test_rows_out_of_order_keep_their_time_column(tmp_path: Path, order: slice) -> None:
    path = write(tmp_path / "a.csv", "time", lambda t: f"{(t - START).total_seconds():.1f}")
    head, *rows = path.read_text().splitlines()
    path.write_text("\n".join([head, *np.array(rows[:60])[order]]) + "\n")
    assert 't_s = "time"' in propose(path).text("a.csv")


@pytest.mark.parametrize("head", ["utc,millis", "Datetime,uptime_ms"])
def test_a_count_beside_a_date_in_minutes_is_the_finer_clock(tmp_path: Path, head: str) -> None:
    path = write(
        tmp_path / "a.csv",
        head,
        lambda t: f"{t:%Y-%m-%d %H:%M},{1e3 * (t - START).total_seconds():.0f}",
    )
    said = propose(path).text("a.csv")
    assert 'unit = "ms"' in said and "no format" not in said


def test_unknown_dates_and_surplus_commas_are_said(tmp_path: Path) -> None:
    path = write(tmp_path / "run.csv", "Time", lambda t: f"{t:%H hours %M:%S}")
    assert any("no format of date and time that is known" in q for q in propose(path).questions)
    path = write(tmp_path / "bad.csv", "Time", lambda t: f"{t:%a, %d %b %Y %H:%M:%S} GMT")
    with pytest.raises(LogError, match="put cells that hold a comma in quotes"):
        propose(path)


def test_keys_of_the_time_are_checked(tmp_path: Path) -> None:
    path = write(tmp_path / "run.csv", "Date,Time", DATES["date and time"][1])
    good = 't_s = { from = ["Date", "Time"], unit = "datetime", format = "%d.%m.%Y %H:%M:%S%.f" }'
    mapping = tmp_path / "run.mapping.toml"
    for old, new, words in (
        ('["Date", "Time"]', '["Date"]', "or two"),
        ('unit = "datetime", format = "%d.%m.%Y %H:%M:%S%.f"', 'unit = "s"', "need unit"),
        (" }", ', zone = "CEST" }', "hours and minutes"),
        ('["Date", "Time"], unit = "datetime"', '"Date", unit = "date"', "known here: .*datetime"),
        ('%.f" }', '%.f%#z", zone = "+02:00" }', "none of their own"),
    ):
        mapping.write_text("[columns]\n" + good.replace(old, new) + "\n", encoding="utf-8")
        with pytest.raises(LogError, match=words):
            Log.read(path, mapping)


def test_plain_left_and_right_are_the_shafts(tmp_path: Path) -> None:
    found = propose(write(tmp_path / "run.csv", "t", lambda t: f"{(t - START).total_seconds()}"))
    assert 'n_left_rps = { from = "left", unit = "rpm" }  # by its size' in found.lines["columns"]
    assert "left, right: taken as the shafts" in found.questions


def test_course_tells_that_latitude_and_longitude_are_swapped(tmp_path: Path) -> None:
    log = mapped(
        write(
            tmp_path / "run.csv",
            "Time",
            DATES["UTC"][1],
            names="Longitude,Latitude,SOG (kn),COG,heading",
        )
    )
    text = (tmp_path / "run.mapping.toml").read_text()
    assert 'latitude = "Longitude"' in text and "enu" not in text and "swapped" in text
    way = np.hypot(*np.diff(log.z[:, :2], axis=0).T)
    assert way == pytest.approx(2.0 * STEP, abs=0.05)


def test_columns_with_the_names_of_a_log_are_taken(tmp_path: Path) -> None:
    names = ["t_s", "gps_x_m", "gps_y_m", "compass_deg", "n_left_rpm", "n_right_rpm"]
    names += ["wind_true_mps", "wind_true_from_rad"]
    rows = [
        f"{k},{2.0 * k},{0.5 * k},{14.0},{900 + k % 7},{900 + k % 5},{5.0},{1.0}" for k in range(60)
    ]
    path = tmp_path / "run.csv"
    path.write_text("\n".join([",".join(names), *rows]) + "\n", encoding="utf-8")
    found = propose(path)
    assert found.missing == [] and not any("left out" in text for text in found.questions)
    lines = found.lines["columns"]
    assert 'gps_x_m = "gps_x_m"' in lines
    assert 'compass_rad = { from = "compass_deg", unit = "deg" }' in lines
    assert 'n_left_rps = { from = "n_left_rpm", unit = "rpm" }' in lines
    assert 'wind_from_rad = "wind_true_from_rad"' in lines
