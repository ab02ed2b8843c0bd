"""Times of unknown logs are read as what they are, or asked about."""

from __future__ import annotations

import math
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from zoneinfo import ZoneInfo

import numpy as np
import pytest
from typer.testing import CliRunner

from twin.cli.main import app
from twin.integrity.log_check import check_log
from twin.logs.dates import Midnight, date_formats, dates, is_time_of_day, past_midnight
from twin.logs.errors import LogError
from twin.logs.log import Log
from twin.logs.proposal.propose import propose
from twin.logs.proposal.time_columns import find_time

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
    "dash": ("Time", lambda t: f"{t:%Y%m%d-%H%M%S}.{part(t)}", 0.0),
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


@pytest.mark.parametrize(
    "head", ["Time (CEST)", "DateTime UTC+2", "Time_CEST", "Ortszeit", "time (Oslo)"]
)
def test_a_zone_in_the_header_or_asked_for_is_written_and_used(tmp_path: Path, head: str) -> None:
    path = write(tmp_path / "run.csv", head, lambda t: f"{t:%Y-%m-%d %H:%M:%S.%f}")
    told = head in ("Time (CEST)", "DateTime UTC+2", "Time_CEST")
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


@pytest.mark.parametrize(
    ("option", "ahead"),
    [
        *(("2", 7200.0), ("+2", 7200.0), ("-5", -18000.0), ("UTC+5:30", 19800.0)),
        *(("0930", 34200.0), ("CEST", 7200.0), ("Europe/Berlin", 7200.0)),
        ("America/St_Johns", -9000.0),
    ],
)
def test_a_zone_may_be_bare_hours_or_a_place(tmp_path: Path, option: str, ahead: float) -> None:
    """Those of a place are of its time of the year: in April summer time."""
    path = write(tmp_path / "run.csv", "Time", lambda t: f"{t:%Y-%m-%d %H:%M:%S.%f}")
    log = mapped(path, f"--zone={option}")
    assert log.datum is not None and log.datum.epoch == pytest.approx(EPOCH - ahead)


@pytest.mark.parametrize(
    ("cell", "ahead"),
    [
        *(("Europe/Zurich", 7200.0), ("America/Argentina/Ushuaia", -10800.0), ("MESZ", 7200.0)),
        *(("UTC+02:00", 7200.0), ("GMT-0330", -12600.0), ("UTC", 0.0), ("Z", 0.0)),
    ],
)
def test_a_zone_in_the_cells_is_read(tmp_path: Path, cell: str, ahead: float) -> None:
    path = write(tmp_path / "run.csv", "Time", lambda t: f"{t:%Y-%m-%d %H:%M:%S.%f} {cell}")
    log = mapped(path)
    assert log.datum is not None and log.datum.epoch == pytest.approx(EPOCH - ahead)


def test_a_place_in_the_header_is_a_zone_and_knows_winter(tmp_path: Path) -> None:
    january = datetime(2024, 1, 5, 11, 58)
    cells = "{:%Y-%m-%d %H:%M:%S.%f}".format
    log = mapped(write(tmp_path / "run.csv", "Time (Europe/Oslo)", cells, start=january))
    assert log.datum is not None and log.datum.epoch == pytest.approx(EPOCH - 91 * 86400.0 - 3600.0)


def test_a_clock_of_a_place_goes_on_where_it_is_set_forward(tmp_path: Path) -> None:
    def cells(t: datetime) -> str:
        hour = timedelta(hours=1 if t >= datetime(2024, 3, 31, 2) else 0)
        return f"{t + hour:%Y-%m-%d %H:%M:%S.%f}"

    path = write(tmp_path / "run.csv", "Time", cells, start=datetime(2024, 3, 31, 1, 59))
    mapped(path, "--zone", "Europe/Berlin")


@pytest.mark.parametrize("option", ["Oslo", "EST", "25", "../etc", "summer", "Europe"])
def test_what_is_no_zone_is_refused_with_the_ways(tmp_path: Path, option: str) -> None:
    path = write(tmp_path / "run.csv", "Time", lambda t: f"{t:%Y-%m-%d %H:%M:%S.%f}")
    result = CliRunner().invoke(app, ["mapping", str(path), "--zone", option])
    assert result.exit_code == 2
    assert "-05:00" in result.output and "Europe/Berlin" in " ".join(result.output.split())
    mapping = f'[columns]\nt_s = {{ from = "Time", unit = "datetime", zone = "{option}" }}\n'
    (tmp_path / "run.mapping.toml").write_text(mapping)
    with pytest.raises(LogError, match=r"t_s: zone .*Europe/Berlin"):
        Log.read(path)


@pytest.mark.parametrize(
    "form",
    [
        *(
            "5. April {:%Y}",
            "05-avr-{:%Y}",
            "5 avril {:%Y},",
            "5 de abril de {:%Y}",
            "05.apr.{:%y}",
        ),
        *("Fr, 5. Apr. {:%Y}", "vendredi 5 avril {:%Y}", "ven. 5 avr. {:%Y}", "April 5, {:%Y}"),
        *("5 de abril de {:%Y}", "{:%Y}-Apr-05", "mar 5 abr {:%Y}"),
    ],
)
def test_names_of_months_of_other_languages_are_read(tmp_path: Path, form: str) -> None:
    path = write(tmp_path / "run.csv", "Zeit", lambda t: f'"{form.format(t)} {t:%H:%M:%S.%f}"')
    log = mapped(path)
    assert log.datum is not None and log.datum.epoch == pytest.approx(EPOCH, abs=0.01)


MONTHS = {
    "German": "Januar Februar März April Mai Juni Juli August September Oktober November Dezember",
    "French": "janvier février mars avril mai juin juillet août septembre octobre novembre "
    "décembre",
    "Spanish": "enero febrero marzo abril mayo junio julio agosto septiembre octubre noviembre "
    "diciembre",
    "Italian": "gennaio febbraio marzo aprile maggio giugno luglio agosto settembre ottobre "
    "novembre dicembre",
    "Portuguese": "janeiro fevereiro março abril maio junho julho agosto setembro outubro novembro "
    "dezembro",
    "Dutch": "januari februari maart april mei juni juli augustus september oktober november "
    "december",
    "Norwegian": "januar februar mars april mai juni juli august september oktober november "
    "desember",
    "Danish": "januar februar marts april maj juni juli august september oktober november december",
    "short German": "Jan Feb Mrz Apr Mai Jun Jul Aug Sep Okt Nov Dez",
    "short French": "janv. févr. mars avr. mai juin juil. août sept. oct. nov. déc.",
}


@pytest.mark.parametrize("language", MONTHS)
def test_each_month_is_read(language: str) -> None:
    texts = [f"3 {name} 2024 10:00:00" for name in MONTHS[language].split()]
    numbers = [f"2024-{month:02d}-03 10:00:00" for month in range(1, 13)]
    (form,) = date_formats(texts)
    assert dates(texts, form.format).tolist() == dates(numbers).tolist()


def test_the_dates_of_c_have_the_year_last() -> None:
    assert date_formats(["Fri Apr 05 11:58:00.25 2024"])[0].format == "%a %b %d %H:%M:%S%.f %Y"
    texts = ["Fri Apr  5 11:58:00 2024", "Fri Apr  5 11:58:01 2024"]
    (form,) = date_formats(texts)
    assert dates(texts, form.format).tolist() == [EPOCH, EPOCH + 1.0]
    assert date_formats(["Fri Apr  5 11:58:00 CEST 2024"])[0].zone == "CEST"


def test_names_of_months_that_are_not_known_are_named_with_the_way_out(tmp_path: Path) -> None:
    path = write(tmp_path / "run.csv", "time", lambda t: f"5 апреля {t:%Y %H:%M:%S.%f}")
    assert any("months of other languages" in text for text in propose(path).questions)


@pytest.mark.parametrize("names", ["Datum,Uhrzeit", "Fecha,Hora", "Data,Ora", "日期,时间"])
@pytest.mark.parametrize(
    "form", ["%d.%m.%Y,%H:%M:%S.%f", "%Y%m%d,%H:%M:%S.%f", "%d.%m.%y,%H.%M.%S.%f"]
)
def test_a_date_beside_a_time_is_one_in_any_language(tmp_path: Path, names: str, form: str) -> None:
    path = write(tmp_path / "run.csv", names, lambda t: t.strftime(form))
    log = mapped(path, "--dates", "day-first")
    assert log.datum is not None and log.datum.epoch == pytest.approx(EPOCH, abs=0.01)


def test_points_stand_for_colons_where_there_are_seconds(tmp_path: Path) -> None:
    text = {"a day": ["03.05.24"] * 60, "Uhr": [f"08.03.{k:02d}" for k in range(60)]}
    found = find_time(text, {}, list(text), ("day-first", ""))
    assert found.names == ("a day", "Uhr") and found.seconds is not None
    assert found.seconds == pytest.approx(1714723380.0 + np.arange(60.0))
    (one,) = date_formats(["2024-05-03 08.03.10.250"])
    assert dates(["2024-05-03 08.03.10.250"], one.format) == [1714723390.25]
    assert not any(map(is_time_of_day, ("08.03", "2024.05.03", "03.05.2024", "12.50 NM")))


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
        (" }", ', zone = "EST" }', "ahead of UTC, such as -05:00"),
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


@pytest.mark.parametrize("cell", ["UTC+2", "(UTC+2)", "(MESZ)", "CEST"])
def test_zones_of_other_spellings_in_the_cells_are_read(tmp_path: Path, cell: str) -> None:
    path = write(tmp_path / "a.csv", "Time", lambda t: f"{t:%d. %b %Y %H:%M:%S.%f} {cell}")
    log = mapped(path)
    assert log.datum is not None and log.datum.epoch == pytest.approx(EPOCH - 7200.0, abs=0.01)


def test_a_log_goes_on_across_the_change_of_clocks(tmp_path: Path) -> None:
    """Clocks of central Europe were put forward at 01:00 UTC on 31 March 2024."""
    summer = datetime(2024, 3, 31, 1, tzinfo=UTC)
    start = summer - timedelta(seconds=6)
    rows = []
    for k in range(60):
        now = start + timedelta(seconds=0.2 * k)
        name, ahead = ("CET", 1) if now < summer else ("CEST", 2)
        shown = f"{now + timedelta(hours=ahead):%d. %b %Y %H:%M:%S.%f} {name}"
        rows.append(f"{shown},{1e-5 * k + 59.43:.6f},10.47,{k % 7},5,{k % 3}")
    path = tmp_path / "a.csv"
    path.write_text("\n".join(["Time,lat,lon,heading_deg,n_left_rps,n_right_rps", *rows]))
    assert CliRunner().invoke(app, ["mapping", str(path)]).exit_code == 0
    log = Log.read(path)
    assert log.datum is not None and log.datum.epoch == pytest.approx(start.timestamp(), abs=0.01)
    assert np.diff(log.t) == pytest.approx(0.2, abs=1e-6)


CHANGES = {
    "Europe/Berlin": (datetime(2024, 10, 27, 1, tzinfo=UTC), datetime(2024, 3, 31, 1, tzinfo=UTC)),
    "America/New_York": (
        datetime(2024, 11, 3, 6, tzinfo=UTC),
        datetime(2024, 3, 10, 7, tzinfo=UTC),
    ),
}


def across(path: Path, change: datetime, cell: Callable[[datetime], str], place: str) -> Path:
    """Write a log of a local clock that is set a minute after its start."""
    first = (change - timedelta(seconds=60)).replace(tzinfo=None)

    def shown(now: datetime) -> str:
        return cell(now.replace(tzinfo=UTC).astimezone(ZoneInfo(place)))

    return write(path, "Time", shown, start=first)


@pytest.mark.parametrize("place", CHANGES)
@pytest.mark.parametrize("season", [0, 1])
def test_a_local_clock_that_is_set_is_named_and_undone_by_its_place(
    tmp_path: Path, place: str, season: int
) -> None:
    change = CHANGES[place][season]
    path = across(tmp_path / "run.csv", change, lambda t: f"{t:%Y-%m-%d %H:%M:%S.%f}", place)
    said = CliRunner().invoke(app, ["mapping", str(path)]).output
    assert f"is set {'forward' if season else 'back'} by an hour at row 121" in said
    found = " ".join(each.what for each in check_log(path).findings)
    assert "1 h, as local time is" in found
    log = mapped(path, "--zone", place, "--force")
    assert log.datum is not None
    assert log.datum.epoch == pytest.approx(change.timestamp() - 60.0, abs=1e-3)
    assert not any("lack zeros" in note for note in log.notes)


@pytest.mark.parametrize("zone", ["America/New_York", "-05:00"])
@pytest.mark.parametrize("season", [0, 1])
def test_each_name_of_a_zone_in_the_cells_is_its_own_time(
    tmp_path: Path, zone: str, season: int
) -> None:
    """EDT is an hour ahead of EST, whose place or hours are asked, for it is that of several."""
    place = "America/New_York"
    change = CHANGES[place][season]
    path = across(tmp_path / "run.csv", change, lambda t: f"{t:%Y-%m-%d %H:%M:%S.%f %Z}", place)
    asked = CliRunner().invoke(app, ["mapping", str(path)])
    assert asked.exit_code == 2 and "EST is the name of several zones" in asked.output
    log = mapped(path, f"--zone={zone}")
    assert log.datum is not None
    assert log.datum.epoch == pytest.approx(change.timestamp() - 60.0, abs=1e-3)


def test_the_hour_that_comes_twice_is_the_second_where_its_end_or_name_says_so(
    tmp_path: Path,
) -> None:
    """And where neither does, a note says that it was taken for the first."""
    place, plain = "America/New_York", "%Y-%m-%d %H:%M:%S.%f"
    cases = ((3600, plain, False), (600, f"{plain} %Z", False), (-1200, plain, True))
    for late, form, open_end in cases:
        begin = CHANGES[place][0] + timedelta(seconds=late)
        path = across(tmp_path / "run.csv", begin, lambda t, f=form: f"{t:{f}}", place)
        log = mapped(path, "--zone", place, "--force")
        assert log.datum is not None
        assert log.datum.epoch == pytest.approx(begin.timestamp() - 60.0, abs=1e-3)
        assert any("this hour twice" in note for note in log.notes) == open_end


def test_the_zone_of_the_cells_wins_over_another_one(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", "Time", lambda t: f"{t:%d. %b %Y %H:%M:%S.%f} CEST")
    said = propose(path, "", "America/New_York").text("a.csv")
    assert "# ? Time: CEST in the cells is taken, and not America/New_York" in said
    assert 'zone = "+02:00"' in said
