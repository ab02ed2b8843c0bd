import runpy
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.twin.live.wire import Wire, example, free_port
from twin.live.protocols.mavlink import MavlinkFeed, Servos
from twin.logs.log import Log
from twin.logs.wire.feed import Feed
from twin.logs.wire.nmea import NmeaFeed
from twin.logs.wire.sockets import needed
from twin.particulars import Particulars
from twin.sim.bridge import particulars_of, simulate
from usv_gym import SeaState, Vessel
from usv_kernel.errors import UsvTwinError

pytest.importorskip("pynmeagps", reason="needs pynmeagps: pip install 'usv-twin[view]'")
pytest.importorskip("pymavlink", reason="needs pymavlink: pip install 'usv-twin[view]'")

ROOT = Path(__file__).resolve().parents[4]

MIDNIGHT = 1.7e9 - 1.7e9 % 86400
KINDS: dict[str, tuple[type[Feed], Callable[[Particulars], example.Stream], float, float]] = {
    # resolutions: 1e-7 minutes and 1e-7 degrees, 1e-4 knots and 1 cm/s
    "nmea": (NmeaFeed, lambda boat: example.NmeaStream(start=MIDNIGHT - 10.0), 4e-4, 2e-4),
    "tagged": (
        NmeaFeed,
        lambda boat: example.NmeaStream(start=MIDNIGHT - 10.0, tag=True),
        4e-4,
        2e-4,
    ),
    "mavlink": (
        MavlinkFeed,
        lambda boat: example.MavlinkStream(Servos.of(boat), start=2**32 / 1000 - 10.0),
        1.2e-2,
        5.1e-3,
    ),
}
kinds = pytest.mark.parametrize("kind", KINDS)


@pytest.fixture(scope="module")
def simulated() -> tuple[Log, Particulars]:
    """Return half a minute of a simulated zigzag, with a gyro, and its boat."""
    vessel = Vessel.load("usv75")
    return simulate(
        "zigzag", vessel=vessel, sea=SeaState.named("2"), duration=30.0, seed=2
    ), particulars_of(vessel)


def check_same(log: Log, wire: Wire, place: float, velocity: float, n_step: float) -> None:
    t, z, cmd = wire.arrays()
    assert len(t) == len(log)
    assert np.abs(t - (log.t - log.t[0])).max() < 1.1e-3
    first = int(np.argmax(np.isfinite(log.z[:, 0])))
    there = log.z.copy()
    there[:, :2] -= log.z[first, :2]
    # wind has no messages here, and NMEA none of accelerations
    there[:, 8 if isinstance(wire.feed, MavlinkFeed) else 6 :] = np.nan
    assert (np.isnan(z) == np.isnan(there)).all()
    apart = np.abs(z - there)
    apart[:, 4] = np.abs(np.remainder(z[:, 4] - there[:, 4] + np.pi, 2 * np.pi) - np.pi)
    bounds = [place, place, velocity, velocity, 1e-5, 1e-5, 1e-5, 1e-5]
    assert (np.nan_to_num(apart[:, :8]).max(axis=0) <= bounds).all()
    assert np.abs(cmd - log.cmd).max() <= n_step


@kinds
def test_a_simulated_run_comes_back(simulated: tuple[Log, Particulars], kind: str) -> None:
    log, boat = simulated
    feed, stream, place, velocity = KINDS[kind]
    wire = Wire(feed, boat)
    wire.replay(log, stream(boat), 20.0 if kind == "mavlink" else 5.0)
    check_same(log, wire, place, velocity, 2.0 * boat.shaft_speed / 400.0)


def test_the_pace_is_that_of_the_log(simulated: tuple[Log, Particulars]) -> None:
    now, log = [0.0], simulated[0]

    def sleep(seconds: float) -> None:
        now[0] += seconds

    address = f"udp://:{free_port()}"
    counted = example.replay(
        log, example.NmeaStream(), address, speed=4.0, clock=lambda: now[0], sleep=sleep
    )
    assert now[0] == pytest.approx((log.t[-1] - log.t[0]) / 4.0)
    assert counted["rows"] == counted["datagrams"] == len(log)


def test_the_example_sends_a_log(tmp_path, simulated: tuple[Log, Particulars]) -> None:  # type: ignore[no-untyped-def]
    path = tmp_path / "run.csv"
    simulated[0].slice(0.0, 5.0).write(path)
    send = runpy.run_path(str(ROOT / "examples" / "replay.py"))["main"]
    for kind, feed_of in (("--nmea", NmeaFeed), ("--mavlink", MavlinkFeed)):
        address = f"udp://:{free_port()}"
        with feed_of(address, simulated[1]) as feed:
            send([str(path), kind, address, "--speed", "10", "--ship", "usv75"])
            feed.take()
            assert feed.counts["used"] > 100


@pytest.mark.parametrize(
    ("address", "speed", "place"),
    [
        ("tcp://:1", 1.0, example.ORIGIN),
        ("udp://:1", 0.0, example.ORIGIN),
        ("udp://:1", 1.0, (91.0, 0.0)),
    ],
)
def test_what_cannot_be_sent_is_refused(
    simulated: tuple[Log, Particulars], address: str, speed: float, place: tuple[float, float]
) -> None:
    with pytest.raises(UsvTwinError):
        example.replay(simulated[0], example.NmeaStream(place), address, speed=speed)


def test_a_missing_library_is_reported(monkeypatch: pytest.MonkeyPatch, usv: Particulars) -> None:
    def without(module: str) -> object:
        raise ModuleNotFoundError(module)

    monkeypatch.setattr("twin.logs.wire.sockets.importlib.import_module", without)
    for module in ("pynmeagps", "pymavlink.dialects.v20.common"):
        with pytest.raises(ImportError, match=r"pip install 'usv-twin\[view\]'"):
            needed(module)
    with pytest.raises(ImportError, match="pynmeagps"):
        NmeaFeed(f"udp://:{free_port()}", usv)
