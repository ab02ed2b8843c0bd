import math
from datetime import UTC, datetime

import numpy as np
import pytest

from tests.twin.live.wire import Wire, example
from twin.channels import (
    AHRS_PITCH,
    AHRS_ROLL,
    APPARENT_FROM,
    APPARENT_SPEED,
    GPS_Z,
    MEASUREMENTS,
    WIND_FROM,
    WIND_SPEED,
)
from twin.logs.wire.nmea import KNOT, NmeaFeed
from twin.particulars import Particulars

pynmeagps = pytest.importorskip("pynmeagps", reason="needs pynmeagps: pip install 'usv-twin[view]'")

START = datetime(2024, 2, 29, 23, 59, 50, tzinfo=UTC).timestamp()


def line(body: str, tag: str = "") -> bytes:
    sum_of = pynmeagps.calc_checksum
    block = f"\\{tag}*{sum_of(tag)}\\" if tag else ""
    return f"{block}${body}*{sum_of(body)}\r\n".encode()


GGA = "GPGGA,120000.00,5930.0000000,N,01030.0000000,E,1,08,0.9,2.0,M,40.0,M,,"
RMC = "GNRMC,120000.00,A,5930.00000,N,01030.00000,E,10.0,090.0,010124,,,A,V"


@pytest.fixture
def wire(usv: Particulars) -> Wire:
    return Wire(NmeaFeed, usv)


def row(wire: Wire) -> np.ndarray:
    (_, z, _), *rest = wire.take(after=1.0)
    assert not rest
    return z


def test_gga_and_rmc_of_an_epoch_are_one_fix(wire: Wire) -> None:
    wire.tell(line(GGA), line(RMC))
    z = row(wire)
    plane = wire.feed.plane
    assert (plane.latitude, plane.longitude) == pytest.approx((59.5, 10.5), abs=1e-12)
    assert z[:2].tolist() == [0.0, 0.0]
    # ten knots to the east; u-blox says V for the navigational status, which is no lack of a fix
    assert z[2:4] == pytest.approx([0.0, 18520.0 / 3600.0]) and z[GPS_Z] == -2.0
    assert wire.balance()["used"] == 2


def test_heading_and_rate_of_turn(wire: Wire) -> None:
    wire.tell(line("HEHDT,270.0,T") + line("TIROT,-60.0,A"))
    z = row(wire)
    assert z[4] == pytest.approx(1.5 * math.pi)
    assert z[5] == pytest.approx(-math.radians(1.0))  # a degree a second, to port


@pytest.mark.parametrize(
    ("number", "angles", "expected"),
    [
        ("0", "5.0,A,-10.0,A", (10.0, 10.0, -10.0, 5.0)),
        ("1", "5.0,A,-10.0,A", (None, 10.0, -10.0, 5.0)),
        ("2", "5.0,A,,V", (10.0, None, 5.0, 5.0)),  # a single rudder is that of both sides
    ],
)
def test_commands_are_read(
    wire: Wire, usv: Particulars, number: str, angles: str, expected: tuple[float | None, ...]
) -> None:
    wire.tell(line(f"IIRPM,S,{number},600.0,,A") + line(f"IIRSA,{angles}"))
    wire.take(after=1.0)
    ((_, _, cmd),) = wire.rows
    left, right, *turned = (usv.shaft_speed if value is None else value for value in expected)
    assert cmd == pytest.approx([left, right, *map(math.radians, turned)])


@pytest.mark.parametrize(
    ("body", "way"),
    [
        (GGA.replace(",E,1,", ",E,0,"), "void"),
        (GGA.replace(",E,1,", ",E,6,"), "void"),
        (GGA.replace("5930.0000000", "0000.0000").replace("01030.0000000", "00000.0000"), "void"),
        (RMC.replace(",A,5", ",V,5"), "void"),
        (RMC.replace(",A,V", ",N"), "void"),
        ("TIROT,-60.0,V", "void"),
        ("HEHDT,,T", "void"),
        (GGA.replace("5930", "9130"), "broken"),
        (GGA.replace("01030", "18130"), "broken"),
        (GGA.replace(",N,", ",X,"), "broken"),
        (GGA.replace("120000", "250000"), "broken"),
        ("GPGGA,120000", "broken"),
        ("HEHDT,361.0,T", "broken"),
        ("HEHDT,nan,T", "broken"),
        (RMC.replace(",10.0,", ",1e300,"), "broken"),
        ("IIRSA,500.0,A,,V", "broken"),
        ("GPGSV,3,1,11", "unknown"),
        ("GPXYZ,3,1,11", "unknown"),
        ("PSRF103,00,01,00,01", "unknown"),
        ("PASHR,ATT,333631.0000,,,,,,", "void"),
        # no ambiguity found
        ("PASHR,ATT,74432.0000,35.3421,0.0000,0.0000,0.0013,19150.0205,1", "void"),
        ("PASHR,120000.000,,,,,,,,,0,0", "void"),
        ("PASHR,POS,1,08,120000.00", "unknown"),
        ("PASHR,ATT,74432.0000", "broken"),
        ("PASHR,120000.000,090.00,T,-95.000,+02.500,,,,,1,1", "broken"),
        ("WIMWV,30.0,T,10.0,M,A", "unknown"),
        ("WIMWV,,R,,M,A", "void"),
        ("WIMWV,30.0,R,-1.0,M,A", "broken"),
        ("WIMWV,30.0,R,10.0,X,A", "broken"),
        ("WIMWV,30.0,R,1e9,M,A", "broken"),
        ("WIMWD,,T,,M,,N,,M", "void"),
        ("WIMWD,-3.0,T,,M,1.0,N,1.0,M", "broken"),
    ],
)
def test_what_is_no_measurement_is_counted(wire: Wire, body: str, way: str) -> None:
    wire.tell(line(body))
    assert wire.balance() == {"received": 1, way: 1}
    assert wire.take(after=1.0) == []


@pytest.mark.parametrize(
    "data",
    [
        line(GGA)[:-5] + b"\r\n",  # no checksum
        line(GGA).replace(b"5930", b"5931"),
        line(GGA)[:40],
        b"\x00\xff\xfe binary \x80",
        b"$" + 2000 * b"A",
        line("HEHDT,270.0,T", "c:1700000000123").replace(b"c:17", b"c:18"),
        "$GPGGA,\u00e9,*00\r\n".encode(),
    ],
)
def test_broken_lines_do_not_spoil_their_neighbours(wire: Wire, data: bytes) -> None:
    wire.tell(data, line("HEHDT,270.0,T"))
    counts = wire.balance()
    assert (counts["broken"], counts["used"]) == (1, 1)


def test_lines_however_they_are_cut(wire: Wire) -> None:
    text = line(GGA).replace(b"\r\n", b"\n") + line("HEHDT,270.0,T")
    wire.tell(text[:30], text[30:80], text[80:].rstrip(), line("TIROT,6.0,A"))
    assert wire.balance() == {"received": 3, "used": 3}
    assert row(wire)[[0, 4]] == pytest.approx([0.0, 1.5 * math.pi])


@pytest.mark.parametrize("unit", ["ms", "s"])
def test_tag_blocks_tell_the_time(wire: Wire, unit: str) -> None:
    for i in range(5):
        stamp = 1700000000 + 2 * i
        tag = f"s:r1,c:{stamp}" if unit == "s" else f"g:1-1-1,c:{stamp}500"
        wire.tell(line(f"HEHDT,{10 * i}.0,T", tag))  # all at once, as a file is sent
    wire.take(after=1.0)
    assert [t for t, _, _ in wire.rows] == pytest.approx([0.0, 2.0, 4.0, 6.0, 8.0])


@pytest.mark.parametrize(
    "body",
    [
        "PASHR,120000.000,090.00,T,-05.000,+02.500,+0.10,0.03,0.03,0.1,1,1",
        "PASHR,ATT,345600.0000,90.0000,2.5000,-5.0000,0.0024,0.0144,0",
        "PASHR,AT2,345600.0000,90.0000,2.5000,-5.0000,0.0024,0.0144,0,00,0.667,1.7814",
        "PASHR,HPR,120000.00,90.0000,2.5000,-5.0000,0.0024,0.0144,0,1,0,0.667",
        "YXXDR,A,-5.0,D,ROLL,A,2.5,D,PTCH,C,20.0,C,AIR",
        "IIXDR,A,2.5,D,Pitch,A,-5.0,D,Roll",
        "HCXDR,A,171,D,YAW,A,2.5,D,PITCH,A,-5,D,ROLL,G,367,,MAGX",
        "IIXDR,A,-5.0,D,HEEL,A,2.5,D,PITCH#1,A,9.0,D,ROLLRATE",
    ],
    ids=["PASHR", "ATT", "AT2", "HPR", "XDR", "names", "yaw", "heel"],
)
def test_roll_and_pitch_are_read(wire: Wire, body: str) -> None:
    wire.tell(line(body))
    z = row(wire)
    assert np.degrees(z[[AHRS_ROLL, AHRS_PITCH]]) == pytest.approx([-5.0, 2.5])
    assert wire.balance()["used"] == 1


@pytest.mark.parametrize("tag", ["", "c:1709207999000"])
def test_roll_and_pitch_in_a_sentence_each_are_both_taken(wire: Wire, tag: str) -> None:
    said = [line(f"IIXDR,A,{v},D,{name}", tag) for v, name in ((2.5, "PTCH"), (-5.0, "ROLL"))]
    wire.tell(b"".join([line(GGA.replace("120000", "115959")), *said]))
    z = row(wire)
    assert np.degrees(z[[AHRS_ROLL, AHRS_PITCH]]) == pytest.approx([-5.0, 2.5])
    assert wire.balance() == {"received": 3, "used": 3}


def test_height_roll_pitch_and_rates_go_out_as_they_come_in(wire: Wire) -> None:
    z = np.full(len(MEASUREMENTS), np.nan)
    names = ("gps_x_m", "gps_y_m", "gps_z_m", "compass_rad", "ahrs_roll_rad", "ahrs_pitch_rad",
             "gyro_radps", "gyro_x_radps", "gyro_y_radps")  # fmt: skip
    at = [MEASUREMENTS.index(name) for name in names]
    z[at] = (0.0, 0.0, -1.25, 0.2, 0.1, -0.05, 0.03, -0.2, 0.15)
    lines = example.NmeaRows("GP").row(START, z, np.zeros(4), (59.5, 10.5))
    kinds = [text[1:6] for text in lines]
    assert kinds.count("GPXDR") == 2 and "PASHR" in kinds
    assert max(map(len, lines)) <= 82
    gga = next(text for text in lines if text.startswith("$GPGGA")).split(",")
    assert gga[9:11] == ["1.250", "M"]
    wire.tell("".join(lines).encode())
    back = wire.take(after=1.0)[0][1]
    assert back[at[2:]] == pytest.approx(z[at[2:]], abs=2e-6)
    assert np.isnan(np.delete(back, at)).all()


@pytest.mark.parametrize(
    ("body", "expected"),
    [
        ("WIMWV,30.0,R,10.0,M,A", (10.0, math.radians(30.0))),
        ("WIMWV,270.0,R,10.0,N,A", (18520.0 / 3600.0, -math.radians(90.0))),
        ("IIMWV,180.0,R,36.0,K,A", (10.0, math.pi)),
    ],
)
def test_the_apparent_wind_is_read(wire: Wire, body: str, expected: tuple[float, float]) -> None:
    wire.tell(line(GGA), line(body))
    z = row(wire)
    assert abs(z[APPARENT_FROM]) == pytest.approx(abs(expected[1]))
    assert (z[APPARENT_SPEED], math.sin(z[APPARENT_FROM])) == pytest.approx(
        (expected[0], math.sin(expected[1])), abs=1e-9
    )


@pytest.mark.parametrize(
    "body", ["WIMWD,225.0,T,,M,19.4384,N,10.0,M", "WIMWD,225.0,T,220.0,M,19.43844,N,,"]
)
def test_the_true_wind_is_read(wire: Wire, body: str) -> None:
    wire.tell(line(GGA), line(body))
    z = row(wire)
    assert z[[WIND_SPEED, WIND_FROM]] == pytest.approx([10.0, math.radians(225.0)], rel=1e-5)


# --- headings, places and speeds in other sentences ---------------------------------------------

GLL = "GPGLL,5900.0000,N,01000.0000,E,120000.00,A,A"
VARIED = "GPRMC,120000.00,A,5900.0000,N,01000.0000,E,4.0,90.0,240424,3.0,E"


@pytest.mark.parametrize(
    ("bodies", "degrees"),
    [
        (["HCHDG,80.0,1.0,E,14.0,W"], 67.0),
        (["HCHDG,2.0,,,10.0,W"], 352.0),
        ([VARIED, "HCHDM,80.0,M"], 83.0),
        ([VARIED, "HCHDG,80.0,,,,"], 83.0),
        (["GNTHS,80.5,A"], 80.5),
        (["IIVHW,80.5,T,95.0,M,4.0,N,7.4,K"], 80.5),
        ([VARIED, "IIVHW,,T,95.0,M,4.0,N,7.4,K"], 98.0),
        (["PASHR,120000.00,80.50,T,+1.20,-0.50,+0.10,0.02,0.02,0.03,1,1"], 80.5),
        (["HEHDT,70.0,T", "HCHDG,80.0,1.0,E,14.0,W"], 70.0),
    ],
)
def test_headings_of_each_sentence_are_read(wire: Wire, bodies: list[str], degrees: float) -> None:
    wire.tell(line(GGA), *map(line, bodies))
    seen = [z[4] for _, z, _ in wire.take(after=1.0) if np.isfinite(z[4])]
    assert np.degrees(seen) == pytest.approx([degrees])
    assert not any("no heading" in note for note in wire.feed.notes)


def test_a_magnetic_heading_without_a_variation_is_said_to_wait_for_it(wire: Wire) -> None:
    wire.tell(line(GGA), line("HCHDM,80.0,M"), line("GPGSV,1,1,00"))
    assert np.isnan([z[4] for _, z, _ in wire.take(after=1.0)]).all()
    assert wire.balance()["void"] == 1
    note = next(note for note in wire.feed.notes if "no heading" in note)
    assert "no variation (HDG, RMC)" in note and "GSV: not followed" in note


def test_a_place_comes_from_gns_whose_systems_have_a_fix(wire: Wire) -> None:
    gns = "GNGNS,{},5912.0000,N,01042.0000,E,{},12,0.8,3.0,40.0,,"
    wire.tell(line(gns.format("120000.00", "NN")), line(gns.format("120001.00", "AN")))
    (row,) = (z for _, z, _ in wire.take(after=1.0) if np.isfinite(z[0]))
    assert row[:2] == pytest.approx([0.0, 0.0]) and wire.balance()["void"] == 1


def test_place_and_speed_come_from_gll_and_vtg_where_nothing_better_comes(wire: Wire) -> None:
    vtg = "GPVTG,90.0,T,104.0,M,2.5,N,4.6,K,A"
    wire.tell(line(GLL) + line(vtg))
    (_, z, _) = wire.take(after=1.0)[0]
    assert z[:2] == pytest.approx([0.0, 0.0]) and z[2:4] == pytest.approx([0.0, 2.5 * KNOT])
    later = [text.replace("120000", "120001") for text in (VARIED, GLL)]
    wire.tell(*map(line, (*later, vtg)))
    rows = [z for _, z, _ in wire.take(after=1.0) if np.isfinite(z[2])]
    assert [row[3] for row in rows] == pytest.approx([4.0 * KNOT])
