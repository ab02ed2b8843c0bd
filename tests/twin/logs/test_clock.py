"""Clocks that were not set, were set while they ran, or count coarsely: named, and read right."""

from __future__ import annotations

import math
from collections.abc import Callable
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from twin.cli.main import app
from twin.digital_twin import Twin, TwinError
from twin.integrity.evidence import GRID_POINTS, signals_of
from twin.integrity.log_check import check_log
from twin.integrity.rows import SAMPLES_MIN
from twin.logs.clock import wild_stamps
from twin.logs.errors import LogError
from twin.logs.log import Log
from twin.logs.recording import Recording

START, ROWS, STEP = datetime(2024, 4, 5, 11, 58), 600, 0.2


def write(path: Path, cells: Callable[[int], str], rows: int = ROWS, step: float = STEP) -> Path:
    """Write a log of a boat in circles; ``cells`` returns the time of a row as text."""
    lines = ["time,lat,lon,heading_deg,n_left_rps,n_right_rps"]
    for k in range(rows):
        course = 0.05 * step * k
        lat = 59.9 + 40.0 * math.sin(course) / 111_400.0
        lon = 10.7 - 40.0 * math.cos(course) / 55_900.0
        heading = math.degrees(course) % 360.0
        lines.append(f"{cells(k)},{lat:.8f},{lon:.8f},{heading:.2f},{5.0 + 1e-3 * (k % 7)},8")
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def mapped(path: Path) -> tuple[Log, str]:
    """Return the log by the mapping that is proposed for it, and what was said of it."""
    result = CliRunner().invoke(app, ["mapping", str(path)])
    assert result.exit_code == 0, result.output
    return Log.read(path), " ".join(result.output.split())


def serious(path: Path) -> list[str]:
    return [each.text for each in check_log(path).findings if each.severity != "note"]


def date(k: int, start: datetime = START) -> str:
    return f"{start + timedelta(seconds=STEP * k):%Y-%m-%d %H:%M:%S.%f}"


# --- stamps of a clock that was not set ---------------------------------------------------------

UNSET: dict[str, tuple[Callable[[int], str], int]] = {
    "a counter's largest number": (lambda k: "4294967.295" if k == 300 else f"{STEP * k:.2f}", 1),
    "zeros": (lambda k: "0" if k % 100 == 50 else f"{1.7e9 + STEP * k:.2f}", 6),
    "an hour within minutes": (lambda k: f"{STEP * k + 3600 * (k == 300):.2f}", 1),
    "a second of the log again": (lambda k: f"{80.0 if k == 300 else STEP * k:.2f}", 1),
    "1970 until the first fix": (lambda k: date(k, datetime(1970, 1, 1) if k < 40 else START), 40),
    "the maker's date until then": (
        lambda k: date(k, datetime(2024, 1, 1) if k < 40 else START),
        40,
    ),
    "dates of zeros": (lambda k: "0000-00-00 00:00:00" if k < 30 else date(k, START), 30),
    "a date from afar": (lambda k: date(k, datetime(2070, 1, 1) if k == 99 else START), 1),
}


@pytest.mark.parametrize("name", UNSET)
def test_stamps_of_a_clock_that_was_not_set_cost_their_rows_and_are_named(
    tmp_path: Path, name: str
) -> None:
    cells, lost = UNSET[name]
    path = write(tmp_path / "a.csv", cells)
    log, said = mapped(path)
    assert f"{lost} stamp(s) are far from all others" in said
    assert len(log) == ROWS - lost
    assert log.t[-1] - log.t[0] < STEP * ROWS
    if log.datum is not None and log.datum.epoch is not None and "zeros" not in name:
        dates = log.datum.utc(log.t[:1])
        assert dates is not None and str(dates[0]).startswith("2024-04-05T11:58")
    assert any(f"{lost} of {ROWS} rows left out" in note for note in log.notes)
    assert serious(path)[0].startswith(f"{lost} stamp(s) are far from all others")


@pytest.mark.parametrize(
    "change",
    [
        lambda t: t[np.r_[0:300, 301, 300, 302:600]],  # two rows exchanged
        lambda t: np.insert(np.delete(t, 300), 400, t[300]),  # one written late
        lambda t: np.where(np.arange(600) < 300, t, t - 2.0),  # a clock set back
        lambda t: t + 7200.0 * (np.arange(600) > 300),  # a pause
        lambda t: np.floor(t),
    ],
)
def test_other_troubles_of_time_are_no_stamps_of_an_unset_clock(
    change: Callable[[np.ndarray], np.ndarray],
) -> None:
    assert not wild_stamps(change(STEP * np.arange(600.0))).any()


def test_a_pause_of_weeks_costs_no_points_of_the_grid() -> None:
    """What is compared lies on both sides of it, at the step of the rows."""
    t = STEP * np.arange(600.0) + 1.5e6 * (np.arange(600) >= 300)
    signals = signals_of(Recording.of({"t_s": t, "compass_rad": np.sin(0.1 * t)}, {}, "log"))
    assert signals is not None
    assert signals.step == pytest.approx(STEP) and SAMPLES_MIN < len(signals.t) < GRID_POINTS / 10


def test_on_board_a_row_of_another_month_is_refused_and_costs_nothing(boat) -> None:
    twin = Twin(boat)
    z, cmd = np.full(19, np.nan), np.zeros(4)
    twin.step(0.0, z, cmd)
    with pytest.raises(TwinError, match="a clock that was not set"):
        twin.step(1.7e9, z, cmd)
    twin.step(0.1, z, cmd)
    assert twin.t == 0.1


# --- times that go back: what explains it, and is tried before it is proposed --------------------


def bare(k: int, unit: int) -> str:
    """Return the time of a row in seconds, a point, and milliseconds or nanoseconds as counted."""
    part = round((STEP * k) % 1.0 * 1000) % 1000
    return f"{int(STEP * k + 1e-6)}.{part * unit + 28 * unit // 1000 if unit > 1 else part + 7}"


LACKING = {
    "milliseconds": lambda k: bare(k, 1),
    "of 1970": lambda k: f"{1_700_000_000 + int(STEP * k + 1e-6)}.{bare(k, 1).split('.')[1]}",
    "nanoseconds of dates": lambda k: (
        f"{START + timedelta(seconds=int(STEP * k + 1e-6)):%Y/%m/%d %H:%M:%S}."
        f"{bare(k, 10**6).split('.')[1]}"
    ),
    "days first": lambda k: (
        f"{START + timedelta(seconds=int(STEP * k + 1e-6)):%d.%m.%Y %H:%M:%S}."
        f"{bare(k, 1).split('.')[1]}"
    ),
}


@pytest.mark.parametrize("name", LACKING)
def test_fractions_without_zeros_are_read_as_what_they_count(tmp_path: Path, name: str) -> None:
    path = write(tmp_path / "a.csv", LACKING[name])
    options = ["--dates", "day-first"] if name == "days first" else []
    result = CliRunner().invoke(app, ["mapping", str(path), *options])
    assert result.exit_code == 0 and "lack zeros in front" in " ".join(result.output.split())
    log = Log.read(path)
    assert len(log) == ROWS and np.diff(log.t) == pytest.approx(STEP, abs=2e-6)
    assert any("lack zeros in front" in note for note in log.notes)
    assert serious(path) == []


@pytest.mark.parametrize("digits", [1, 2, 3])
def test_fractions_that_only_drop_zeros_at_the_end_stay(tmp_path: Path, digits: int) -> None:
    path = write(tmp_path / "a.csv", lambda k: f"{round(STEP * k, digits)!r}")
    assert np.diff(mapped(path)[0].t) == pytest.approx(STEP)


@pytest.mark.parametrize("back", [40.0, 1800.0, 3600.0, 7200.0])
def test_a_clock_set_back_is_named_whatever_the_rows_before(tmp_path: Path, back: float) -> None:
    path = write(tmp_path / "a.csv", lambda k: f"{9000.0 + STEP * k - back * (k >= 150):.2f}")
    result = CliRunner().invoke(app, ["mapping", str(path)])
    mapping = path.with_name("a.mapping.toml")
    if "t_s = " not in mapping.read_text().replace("# t_s", ""):
        mapping.write_text(mapping.read_text().replace("[columns]", '[columns]\nt_s = "time"'))
    assert result.exit_code == 0
    found = [each for each in check_log(path).findings if each.code == "time"]
    assert [each.size for each in found] == [pytest.approx(back)]
    assert f"set back by {back:.2f} s in row 151" in found[0].what
    assert ("local time" in found[0].what) == (back % 3600.0 == 0.0)
    with pytest.raises(LogError, match=f"the clock was set back: add {back:g} s"):
        Log.read(path)


def test_rows_are_to_be_sorted_only_where_that_brings_them_in_order(tmp_path: Path) -> None:
    head = '[columns]\nt_s = "time"\ncompass_rad = { from = "heading_deg", unit = "deg" }\n'
    head += 'delta_rad = 0.0\n[position]\nlatitude = "lat"\nlongitude = "lon"\n'
    (tmp_path / "a.mapping.toml").write_text(head)
    path = write(tmp_path / "a.csv", lambda k: f"{STEP * k:.2f}")
    names, *rows = path.read_text().splitlines()
    order = np.argsort(np.arange(ROWS) + np.random.default_rng(1).uniform(0, 12, ROWS))
    path.write_text("\n".join([names, *(rows[k] for k in order)]) + "\n")
    assert "sort the rows by time" in serious(path)[0]
    path.write_text("\n".join([names, *rows, *rows[100:]]) + "\n")
    assert "sort" not in serious(path)[0] and "cut the log" in serious(path)[0]


# --- coarse clocks ------------------------------------------------------------------------------


def test_few_doubles_of_a_clock_in_whole_seconds_are_spread(tmp_path: Path) -> None:
    late = np.random.default_rng(1).normal(0.35, 0.25, ROWS)
    path = write(tmp_path / "a.csv", lambda k: f"{math.floor(k + late[k])}", step=1.0)
    doubles = int((np.diff(np.floor(np.arange(ROWS) + late)) == 0.0).sum())
    log, _ = mapped(path)
    assert doubles > 5 and len(log) == ROWS and np.diff(log.t).min() >= 0.5
    assert np.abs(log.t - np.floor(np.arange(ROWS) + late)).max() <= 0.5
    assert any(f"{doubles} of {ROWS} rows" in note and "spread" in note for note in log.notes)
    codes = {each.code for each in check_log(path).findings if each.severity != "note"}
    assert codes.isdisjoint({"time", "jitter", "gap"})


FINE: dict[str, tuple[str, Callable[[float], str]]] = {
    "ms since 1970": ("Date,timeStamp", lambda t: f"{1712318280000.0 + 1e3 * t:.4f}"),
    "s since 1970": ("Date,epoch", lambda t: f"{1712318280.0 + t:.3f}"),
    "before the date": ("timestamp_ms,Date", lambda t: f"{1e3 * t:.0f}"),
    "two counters": ("time,timestamp", lambda t: f"{t:.2f}"),
}


@pytest.mark.parametrize("name", FINE)
def test_of_two_clocks_the_finer_is_taken(tmp_path: Path, name: str) -> None:
    names, cell = FINE[name]

    def both(k: int) -> str:
        date = f"{START + timedelta(seconds=int(STEP * k)):%Y-%m-%d %H:%M:%S}"
        coarse = f"{math.floor(STEP * k)}" if name == "two counters" else date
        cells = [coarse, cell(STEP * k)]
        return ",".join(cells[::-1] if name == "before the date" else cells)

    path = write(tmp_path / "a.csv", both)
    path.write_text(path.read_text().replace("time,lat", f"{names},lat", 1))
    assert np.diff(mapped(path)[0].t) == pytest.approx(STEP, abs=1e-3)


def test_doubles_whose_own_stamps_are_missing_elsewhere_are_refused(tmp_path: Path) -> None:
    """As where rows are sorted by misread times: one of each second stands half a second late."""
    times = sorted(round(STEP * k + 0.6 * (k % 5 == 0), 2) for k in range(ROWS))
    assert (np.diff(times) == 0.0).sum() == ROWS // 5
    path = write(tmp_path / "a.csv", lambda k: f"{times[k]:.2f}")
    CliRunner().invoke(app, ["mapping", str(path)])
    with pytest.raises(LogError, match="time does not increase"):
        Log.read(path)
