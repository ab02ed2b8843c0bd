import math
import socket

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.twin.live.wire import Wire, example, free_port
from twin.live.protocols.mavlink import MavlinkFeed, Servos
from twin.logs.wire.feed import BYTES_MAX, Message
from twin.logs.wire.nmea import NmeaFeed
from twin.logs.wire.sockets import FeedError, parse_address
from twin.particulars import Particulars

pytest.importorskip("pynmeagps", reason="needs pynmeagps: pip install 'usv-twin[view]'")
pytest.importorskip("pymavlink", reason="needs pymavlink: pip install 'usv-twin[view]'")


@pytest.mark.parametrize(
    ("address", "found"),
    [
        ("udp://:10110", ("127.0.0.1", 10110)),
        ("udp://0.0.0.0:1", ("0.0.0.0", 1)),
        ("udp://[::1]:10110", ("::1", 10110)),
        ("udp://boat.local:65535", ("boat.local", 65535)),
    ],
)
def test_addresses_are_read_or_refused(address: str, found: tuple[str, int]) -> None:
    assert parse_address(address) == found


@pytest.mark.parametrize(
    "address",
    ["tcp://:10110", "10110", "udp://:0", "udp://localhost", "udp://:99999", "udp://:10110/gps"],
)
def test_wrong_addresses_are_reported(address: str) -> None:
    with pytest.raises(FeedError):
        parse_address(address)


def test_a_port_in_use_is_reported(usv: Particulars) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        address = f"udp://:{taken.getsockname()[1]}"
        with pytest.raises(FeedError, match="cannot listen"):
            NmeaFeed(address, usv)


class MessageFeed(NmeaFeed):
    """A feed of messages that are given as they are."""

    def decode(self, data):  # type: ignore[no-untyped-def]
        yield eval(data, {"Message": Message})


def message(kind: str, t: float | None, **values: float) -> bytes:
    return repr(Message(kind, t, values)).encode()


def times(wire: Wire) -> list[float]:
    return [row[0] for row in wire.rows]


def test_rows_wait_for_what_was_overtaken(usv: Particulars) -> None:
    wire = Wire(MessageFeed, usv)
    for t in (100.0, 100.2, 100.1, 100.3, 100.4, 100.4, 101.0, 100.35, 101.5):
        wire.tell(message("a", t, compass_rad=t - 100.0), after=0.1)
    wire.take(after=1.0)
    assert times(wire) == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4, 1.0, 1.5])
    assert [z[4] for _, z, _ in wire.rows] == pytest.approx(times(wire))
    counts = wire.balance()
    assert (counts["out of order"], counts["doubled"], counts["late"]) == (1, 1, 1)


def test_commands_hold_and_their_absence_is_reported(usv: Particulars) -> None:
    wire = Wire(MessageFeed, usv)
    wire.tell(message("a", 1.0, compass_rad=1.0))
    wire.take(after=1.0)
    assert wire.rows[0][2].tolist() == [usv.shaft_speed, usv.shaft_speed, 0.0, 0.0]
    assert len(wire.feed.notes) == 1 and "no shaft speed has come" in wire.feed.notes[0]
    wire.tell(message("n", 2.0, n_left_rps=1.0, n_right_rps=-1.0))
    wire.tell(message("a", 3.0, compass_rad=1.0))
    wire.take(after=1.0)
    assert [row[2][0] for row in wire.rows] == [usv.shaft_speed, 1.0, 1.0]
    assert wire.feed.notes == ()


@pytest.mark.parametrize("speed", [1.0, 10.0])
def test_a_clock_that_begins_again_does_not_stall(usv: Particulars, speed: float) -> None:
    wire = Wire(MessageFeed, usv)
    for start in (1000.0, 200.0, 200.0):  # the third time with the same times as the second
        for i in range(100):
            wire.tell(message("a", start + 0.1 * i, compass_rad=1.0), after=0.1 / speed)
    wire.take(after=1.0)
    t = np.array(times(wire))
    assert (np.diff(t) > 0.0).all()
    # 3 s are given up for each new beginning, and the time goes on by our clock
    assert len(t) == pytest.approx(300 - 60, abs=4)
    assert t[-1] == pytest.approx(29.9, abs=0.3)


def test_a_clock_that_wraps_goes_on(usv: Particulars) -> None:
    wire = Wire(MessageFeed, usv)
    for t in (86399.8, 86399.9, 0.0, 0.1):
        wire.tell(message("a", t, compass_rad=1.0), after=0.1)
    wire.take(after=1.0)
    assert times(wire) == pytest.approx([0.0, 0.1, 0.2, 0.3])


@pytest.mark.parametrize("speed", [0.5, 1.0, 20.0])
def test_messages_without_a_time_are_placed_by_the_senders_clock(
    usv: Particulars, speed: float
) -> None:
    rng = np.random.default_rng(1)
    wire = Wire(MessageFeed, usv, period=0.02)
    sent = []
    for i in range(600):
        t = 0.05 * i
        wire.now = t / speed + 0.002 * rng.random() / speed
        if i % 4 == 0:
            wire.tell(message("g", 500.0 + t, gps_vx_mps=1.0))
        wire.now = (t + 0.025) / speed
        wire.tell(message("h", None, compass_rad=1e-3 * i))
        sent.append(t + 0.025)
    wire.take(after=1.0)
    found = {round(1e3 * z[4]): t for t, z, _ in wire.rows if not math.isnan(z[4])}
    late = [found[i] - sent[i] for i in range(100, 600)]
    assert np.abs(late).max() < 0.01


def test_a_flood_does_not_hang_the_caller(usv: Particulars) -> None:
    with NmeaFeed(f"udp://:{free_port()}", usv) as feed:
        host, port = feed._socket.getsockname()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            for _ in range(4000):
                sender.sendto(b"$GPGSV,1*00\r\n" * 80, (host, port))
        feed.take()
        assert 0 < feed.counts["received"] <= 1.1 * BYTES_MAX / 13
        for _ in range(200):
            feed.take()
        assert feed.counts["received"] <= 4000 * 80


BOAT = Particulars(name="b", length=6.0, beam=2.0, draft=0.5, mass=2e3, speed=5.0, shaft_speed=20.0)
NMEA = example.NmeaRows("GP")
TIMES = st.floats(0.0, 86399.0)
NUMBERS = st.sampled_from(["", "0", "-1", "nan", "inf", "1e308", "-1e-300", "361", "x", "12.5"])
SENTENCES = st.builds(
    lambda kind, fields: NMEA.line(kind, *fields).encode(),
    st.sampled_from(["GGA", "RMC", "HDT", "ROT", "RPM", "RSA", "ZDA", "GSV", "XXX"]),
    st.lists(
        st.one_of(NUMBERS, st.sampled_from(["A", "N", "E", "120000.5", "20000.0", "5930.5", "S"])),
        max_size=14,
    ),
)
FIXES = st.builds(
    lambda t, lat, lon: NMEA.gga(t, (lat, lon), 4).encode(),
    TIMES,
    st.floats(-200.0, 200.0),
    st.floats(-400.0, 400.0),
)
LINK = example.MavlinkRows(Servos.of(BOAT))
WIDE = st.floats(allow_nan=True, allow_infinity=True, width=32)
PACKETS = st.one_of(
    st.builds(LINK.attitude, TIMES, st.floats(-7.0, 7.0), WIDE),
    st.builds(
        LINK.position,
        TIMES,
        st.tuples(st.floats(-200, 200), st.floats(-210, 210)),
        st.tuples(st.floats(-400, 400), st.floats(-400, 400)),
    ),
    st.builds(
        lambda t, n: LINK.row(t, np.full(17, np.nan), np.array([n, n, 0.1, 0.1]), None)[0],
        TIMES,
        st.floats(-100.0, 100.0),
    ),
)


def corrupted(sound: st.SearchStrategy[bytes]) -> st.SearchStrategy[list[bytes]]:
    cut = st.builds(lambda data, n: data[: n % (len(data) + 1)], sound, st.integers(0, 300))
    turned = st.builds(
        lambda data, at, bit: bytes(
            byte ^ (1 << bit) if i == at % len(data) else byte for i, byte in enumerate(data)
        ),
        sound,
        st.integers(0, 300),
        st.integers(0, 7),
    )
    return st.lists(st.one_of(st.binary(max_size=400), sound, cut, turned), max_size=12)


@pytest.mark.parametrize(
    ("kind", "wires"),
    [(NmeaFeed, corrupted(st.one_of(SENTENCES, FIXES))), (MavlinkFeed, corrupted(PACKETS))],
    ids=["nmea", "mavlink"],
)
def test_whatever_comes_is_survived(kind, wires) -> None:  # type: ignore[no-untyped-def]
    @settings(max_examples=300, deadline=None)
    @given(wires, st.floats(0.0, 5.0))
    def survive(datagrams: list[bytes], pause: float) -> None:
        wire = Wire(kind, BOAT)
        for data in datagrams:
            wire.tell(data, after=pause)
        wire.take(after=10.0)
        wire.balance()
        if wire.rows:
            t, z, cmd = wire.arrays()
            assert np.isfinite(t).all() and np.isfinite(cmd).all() and (np.diff(t) > 0.0).all()
            assert not np.isinf(z).any()

    survive()
