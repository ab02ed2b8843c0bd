"""Files that are no log, and the runs that come with the package."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest

from tests.twin.logs.reading import refused
from twin.logs.columns import REQUIRED
from twin.logs.log import Log, recorded_runs
from twin.particulars import Particulars

HEADER = ",".join(REQUIRED).encode()
ROW = b"0,1,1,0,0,5,6,0.1"
ZIPPED = gzip.compress(HEADER + b"\n" + ROW + b"\n" + ROW.replace(b"0", b"2", 1) + b"\n", mtime=0)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.csv", HEADER + b"\n" + ROW + b"\n\0\0\0", "is a binary file"),
        ("a.csv", b"", "the file is empty; write a header"),
        ("a.csv", b"\n\n", "the file is empty"),
        ("a.csv.gz", b"", "the file is empty"),
        ("a.csv.gz", gzip.compress(b""), "the file is empty"),
        ("a.csv", HEADER, "no row of data after the header (line 1); record"),
        ("a.csv", HEADER + b"\n\n", "no row of data after the header"),
        ("a.csv", HEADER + b"\n" + ROW, "1 row of data after the header; a log needs two"),
        ("a.csv", ROW + b"\n" + ROW, "line 1 holds numbers; put a header of column names"),
        ("a.csv", b"2024-05-03T09:30:00Z,38.8,3.2,90\n" * 9, "line 1 holds numbers; put a header"),
        ("a.csv", b"sep=,\n" + HEADER + b"\n" + ROW, "line 1 looks like comments above the header"),
        ("a.csv", HEADER.replace(b",", b";"), "no row of data after the header (line 1); record"),
        ("a.csv", HEADER + b"\r" + ROW, "the lines end in CR only; save the file with LF"),
        ("a.csv", HEADER + b"\n" + ROW + b"\n" + ROW + b",7,8", "line 3 has 10 cells but the he"),
        (
            "a.csv",
            HEADER + b"\n" + b",".join([b"0,5"] * 8) + b"\n",
            "where the comma is the decimal mark, separate the cells by semicolons or tabs",
        ),
        (
            "a.csv",
            HEADER + (b"\n" + b",".join([b'"0,5"'] * 8)) * 2 + b"\n",
            "if the comma is the decimal mark, separate the cells by semicolons or tabs",
        ),
        (
            "a.csv",
            b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR",
            "is a binary file or UTF-16 text, not CSV; save",
        ),
        ("a.csv", HEADER.decode().encode("utf-16"), "is a binary file or UTF-16 text"),
        ("a.csv", b"\xff\xfft_s,x\n1,2\n", "line 1 is not UTF-8 text; save"),
        ("a.csv.gz", HEADER + b"\n", "is not a gzip file although its name ends in .gz; compress"),
        ("a.csv.gz", ZIPPED[:-9], "the gzip file is damaged or cut off"),
        ("a.csv.gz", ZIPPED[:20] + b"\0\0" + ZIPPED[22:], "the gzip file is damaged or cut off"),
        ("a.csv.gz", ZIPPED[:-8] + bytes(8), "the gzip file is damaged or cut off (CRC"),
    ],
    ids=lambda value: str(value)[:24] if isinstance(value, str) else "",
)
def test_file_that_is_no_log_is_refused(
    tmp_path: Path, name: str, content: bytes, words: str
) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    assert words in refused(path)


def test_damaged_gzip_tells_how_to_rescue_its_start(tmp_path: Path) -> None:
    path = tmp_path / "a.csv.gz"
    path.write_bytes(ZIPPED[: len(ZIPPED) // 2])
    assert "copy it again" in (message := refused(path))
    assert "zcat a.csv.gz" in message


def test_gzip_is_recognised_by_its_content(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_bytes(ZIPPED)
    assert len(Log.read(tmp_path / "a.csv")) == 2


@pytest.mark.parametrize("name", ["absent.csv", "."])
def test_file_that_cannot_be_read(tmp_path: Path, name: str) -> None:
    assert "cannot be read (" in refused(tmp_path / name)


def test_shipped_run_is_consistent() -> None:
    log = Log.read(recorded_runs()["boat1_usv_circle"])
    new = ~np.isnan(log.z[:, :4]).any(axis=1)
    x, y, vx, vy = log.z[new, :4].T
    step = np.hypot(np.diff(x), np.diff(y))[60:].mean()
    speed = np.hypot(vx, vy)[60:].mean()
    # Fixes every 0.2 s; the source's own x and y would give 1.11 here.
    assert step / (0.2 * speed) == pytest.approx(1.0, abs=2e-3)
    # It goes where it points, and more thrust to port turns it to starboard.
    heading = np.interp(log.t[new], log.t[~np.isnan(log.z[:, 4])], log.z[~np.isnan(log.z[:, 4]), 4])
    assert np.mean(np.cos(heading - np.arctan2(vy, vx))) > 0.99
    turn = np.gradient(heading, log.t[new])
    unequal = (log.cmd[:, 0] - log.cmd[:, 1])[new]
    lag = 2
    assert np.corrcoef(turn[lag:], unequal[:-lag])[0, 1] > 0.5


@pytest.mark.parametrize("name", recorded_runs())
def test_shipped_runs_have_particulars_and_a_notice(name: str) -> None:
    path = recorded_runs()[name]
    boat = Particulars.load(path.with_name(f"{name}.toml"))
    log = Log.read(path)
    speed = np.nanmean(np.hypot(log.z[:, 2], log.z[:, 3]))
    assert boat.speed == pytest.approx(speed, rel=0.05)
    assert boat.shaft_speed == pytest.approx(log.cmd[:, :2].mean(), rel=0.05)
    notice = path.with_name("NOTICE.txt").read_text(encoding="ascii")
    assert path.name in notice
    assert "MIT License" in notice


OTHERS = {
    b'<?xml version="1.0"?>\n<gpx><trk><trkseg>\n': "a GPX track",
    b'<gpx version="1.1" creator="x">\n': "a GPX track",
    b'<?xml version="1.0"?>\n<kml><Document>\n': "XML",
    b"(1714728600.952003) can0 09F80101#7D0BAA1838850001\n": "a record of a CAN bus",
    b"  can1  18EA00FE   [3]  00 EE 00\n": "a record of a CAN bus",
    b" (2024-05-03 09:30:00.952)  can0  RX - -  09F80101   [2]  7D 0B\n": "a record of a CAN bus",
    b"2024-05-03T09:30:00.123Z,2,127250,10,255,8,00,5a,6b\n": "a record of a CAN bus",
    b'{"context":"vessels.self","updates":[{"values":[]}]}\n': "a file of Signal K deltas",
    b'[{"updates":[{"values":[]}],"context":"vessels.self"}]\n': "a file of Signal K deltas",
    b"PARM, 1000, SYSID_THISMAV, 1\nGPS, 1000000, 3, 100\n": "a DataFlash log",
    b"2024-05-03 09:30:00.00: ATTITUDE {time_boot_ms : 1000}\n": "a telemetry log of MAVLink",
    b"PAR1\x15\x04\0": "a Parquet file",
    b'{"t": 1.0, "lat": 41.5}\n{"t": 2.0, "lat": 41.5}\n': "JSON",
    b"FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns\n": "a DataFlash log",
    b"!Boat,Utc,BSP,HDG,Lat,Lon\n!boat,0,1,13,48,49\n": "a log of Expedition",
    b"Lat: 41.5000, Lon: -70.600, Heading: 90.5\n" * 3: "a file of lines of names and values",
    b"ULog\x01\x12\x35\x01": "a log of PX4",
    b"PK\3\4\x14\0": "a spreadsheet",
    b"\x0e\x10\x43\x08\x78\x06\x09\x00.FIT\0\0": "a GPX track or one of its kind",
    b"AXXXABC FLIGHT:1\nHFFXA035\nB1602405107126N00149300WA0028000421\n": "a GPX track or one",
    b"09:30:00.123 R 09F80102 CC 9D 25 12 34 56 78 9A\n": "a record of a CAN bus",
    b"A093000.123 09FF7 1FA01 2FA0B4\n": "a record of a CAN bus",
    b"---\nlatitude: 41.5\nlongitude: -70.6\n---\nlatitude: 41.5\n": "YAML",
    b"header:\n  stamp:\n    sec: 1\n---\nheader:\n": "YAML",
    b'received_at,protocol,raw_data\n2024,NMEA0183,"$GPRMC,093000.00,A"\n': "CSV of NMEA 0183",
    b"\x93NUMPY\x01\x00v\x00{'descr'": "a NumPy array",
    b"# Main particulars for the twin.\n\n[particulars]\nlength = 2.0\n": "TOML of a boat",
    b'[[ship]]\nname = "one"\n': "TOML of a boat",
    b'zone = "UTC"\n\n[columns]  # of ours\nt_s = "t"\n': "TOML, as mappings are",
    b"ARROW1\0\0": "an Arrow or Feather file",
    b"\xb5\x62\x01\x07\x5c\x00": "a record of a u-blox receiver",
}


@pytest.mark.parametrize("content", OTHERS, ids=OTHERS.values())
def test_files_of_other_kinds_are_named_in_one_sentence(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "a.log"
    path.write_bytes(content)
    message = refused(path)
    assert f"this is {OTHERS[content]}" in message
    for word in ("comma is", "header of column names", "missing"):
        assert word not in message
