"""Text logs of NMEA 0183 are read by the sentences that the live feed knows."""

from __future__ import annotations

import functools
import gzip
import math
import operator
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from tests.twin.logs.reading import refused
from twin.cli.main import app
from twin.logs.log import Log, read_table

pytest.importorskip("pynmeagps", reason="needs pynmeagps: pip install 'usv-twin[view]'")

SECONDS = 120


def sentence(body: str) -> str:
    return f"${body}*{functools.reduce(operator.xor, map(ord, body)):02X}"


def lines(start: int = 34_200, first: str = "GGA", headings: int = 5) -> list[str]:
    """Return sentences of a boat that turns at 1.5 degrees/s and goes 2 m/s, a fix a second."""
    found = []
    for k in range(SECONDS):
        moment = (start + k) % 86400
        clock = f"{moment // 3600:02d}{moment // 60 % 60:02d}{moment % 60:02d}.00"
        course = math.radians(1.5 * k)
        north, east = (2.0 / math.radians(1.5)) * np.array([math.sin(course), 1 - math.cos(course)])
        minutes = f"{30.0 + north / 1852.0:09.6f},N,070{36.0 - east / 1387.0:09.6f},W"
        place = f"41{minutes}"
        if first == "GGA":
            found.append(sentence(f"GPGGA,{clock},{place},1,08,0.9,1.0,M,-30.0,M,,"))
            found.append(sentence(f"GPRMC,{clock},A,{place},3.9,{1.5 * k:.1f},030524,14.0,W"))
        else:
            found.append(sentence(f"GPGLL,{place},{clock},A,A"))
        found += [
            sentence(f"HCHDG,{(1.5 * (k + j / headings) + 14.0) % 360.0:.2f},,,14.0,W")
            for j in range(headings)
        ]
        found.append(sentence("IIDPT,010.0,-1.0,"))
    return found


def written(path: Path, text: list[str], end: str = "\n") -> Path:
    path.write_bytes((end.join(text) + end).encode())
    path.with_name("a.mapping.toml").write_text("[columns]\nn_rps = 0.0\ndelta_rad = 0.0\n")
    return path


@pytest.mark.parametrize("end", ["\n", "\r\n"])
@pytest.mark.parametrize("first", ["GGA", "GLL"])
@pytest.mark.parametrize("name", ["a.nmea", "a.log", "a.txt"])
def test_a_log_of_sentences_is_read(tmp_path: Path, end: str, first: str, name: str) -> None:
    path = written(tmp_path / name, lines(first=first), end)
    mapping = path.with_name("a.mapping.toml")
    log = Log.read(path, mapping)
    assert log.t[-1] - log.t[0] == pytest.approx(SECONDS - 1.0, abs=1.0)
    fixes = np.isfinite(log.z[:, 0])
    assert fixes.sum() == SECONDS
    heading = np.isfinite(log.z[:, 4])
    assert heading.sum() > 4 * SECONDS
    expected = 1.5 * (log.t[heading] - log.t[fixes][0])
    off = np.remainder(np.degrees(log.z[heading, 4]) - expected + 180.0, 360.0) - 180.0
    assert np.abs(off).max() < 2.0
    assert log.datum is not None and log.datum.latitude == pytest.approx(41.5, abs=1e-6)
    if first == "GGA":
        assert log.datum.utc(log.t[:1])[0] == np.datetime64("2024-05-03T09:30:00")  # type: ignore[index]
        assert np.hypot(*log.z[fixes, 2:4].T) == pytest.approx(2.0, abs=0.02)


@pytest.mark.parametrize("stamp", ["2024-05-03T09:30:00.123Z ", "1714728600.5,", "12.3;N;", "7\t"])
def test_logs_with_stamps_of_their_logger_or_gzipped_are_read(tmp_path: Path, stamp: str) -> None:
    log = Log.read(written(tmp_path / "a.nmea", lines()))
    path = tmp_path / "a.nmea.gz"
    path.write_bytes(gzip.compress("\n".join(stamp + line for line in lines()).encode()))
    assert np.array_equal(Log.read(path).z, log.z, equal_nan=True)


def test_the_clock_of_a_receiver_before_its_first_fix_is_left_out(tmp_path: Path) -> None:
    void = [sentence(f"GPRMC,0000{k:02d}.00,V,,,,,,,060180,,,N") for k in range(20)]
    table = read_table(written(tmp_path / "a.nmea", void + lines()))
    assert np.ptp(table.data["t_s"]) == pytest.approx(SECONDS - 1.0, abs=1.0)
    assert any("20 line(s) before the first that tells the time" in note for note in table.notes)


def test_commands_that_came_are_not_those_of_the_mapping(tmp_path: Path) -> None:
    rpm = [part for line in lines() for part in (line, sentence("IIRPM,S,0,300.0,,A"))]
    assert Log.read(written(tmp_path / "a.nmea", rpm)).cmd[-1].tolist() == [5.0, 5.0, 0.0, 0.0]


def test_cut_lines_and_midnight_cost_no_row(tmp_path: Path) -> None:
    text = lines(start=86_400 - 60)
    text[0] = text[0][12:]
    text[-1] = text[-1][:9]
    log = Log.read(written(tmp_path / "a.nmea", text))
    assert log.t[-1] - log.t[0] == pytest.approx(SECONDS - 1.0, abs=1.0)
    assert np.isfinite(log.z[:, 0]).sum() >= SECONDS - 1


def test_zda_gives_the_date(tmp_path: Path) -> None:
    zda = sentence("GPZDA,093000.00,03,05,2024,00,00")
    log = Log.read(written(tmp_path / "a.nmea", [zda, *lines(first="GLL")]))
    assert log.datum is not None
    assert log.datum.utc(log.t[:1])[0] == np.datetime64("2024-05-03T09:30:00")  # type: ignore[index]


def test_what_a_log_of_sentences_lacks_is_said(tmp_path: Path) -> None:
    path = written(tmp_path / "a.nmea", lines())
    path.with_name("a.mapping.toml").unlink()
    assert "n_left_rps, n_right_rps, delta_left_rad, delta_right_rad missing" in refused(path)
    result = CliRunner().invoke(app, ["mapping", str(path)])
    assert result.exit_code == 2 and "a log of NMEA 0183" in " ".join(result.output.split())
    bare = [text for text in lines() if "HDG" not in text]
    path = written(tmp_path / "a.nmea", bare)
    assert "column(s) compass_rad missing" in (said := refused(path)) and "PASHR" in said
    assert any("no heading has come; DPT: not followed" in note for note in read_table(path).notes)
    written(path, [text for text in bare if "DPT" in text])
    assert "no sentence tells the time" in refused(path)
    written(path, lines())
    path.with_name("a.mapping.toml").write_text('[columns]\ncompass_rad = "HDG"\n')
    with pytest.raises(Exception, match="the sentences of an NMEA log are known"):
        Log.read(path)
