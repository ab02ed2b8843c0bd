"""Runs behind a view: simulated, recorded and fed."""

import errno
import math
import time
from pathlib import Path

import numpy as np
import pytest

from tests.twin.live.wire import setup, wait
from twin import Log, Particulars, Twin
from twin.digital_twin import TwinError
from twin.live.sessions.feed import FeedSession
from twin.live.sessions.log import LogSession
from twin.live.sessions.simulated import SimulatedSession
from twin.live.sessions.tracker import HORIZON_S, PLAN_STEP_S
from twin.logs.datum import Datum, Plane
from twin.logs.wire.feed import Feed
from twin.sim.bridge import particulars_of, simulate
from usv_gym import SeaState, Vessel
from usv_gym.physics import frames as fr

VESSEL = Vessel.load("usv75")


def sail(session: SimulatedSession, seconds: float) -> None:
    """Live so long, as fast as it goes, without a thread."""
    session._anchor = time.monotonic() - seconds, session.t
    end = session.t + seconds
    while session.t < end - 1e-6:
        session._obey()
        session._advance()
        session._anchor = time.monotonic() - (end - session.t) - 1e-6, session.t


def test_helm_and_throttle_steer(tmp_path):
    session = SimulatedSession(setup(predictor="ukf", sea=SeaState()), tmp_path)
    sail(session, 5.0)
    straight = session.simulation.state[0, fr.PSI]
    session.helm.angle = math.radians(20.0)
    sail(session, 5.0)
    assert session.simulation.state[0, fr.PSI] > straight + 0.3  # to starboard
    session.helm.throttle = 0.0
    sail(session, 20.0)
    assert session.simulation.state[0, fr.U] < 2.0
    session.helm.angle = 3.0  # more than the drives can
    sail(session, 1.0)
    assert session.simulation.cmd[0, 2] == pytest.approx(VESSEL.helm_max)


def test_gps_and_imu_are_lost_and_found_again(tmp_path):
    session = SimulatedSession(setup(predictor="dsw-ukf-plus"), tmp_path)
    other = SimulatedSession(setup(predictor="dsw-ukf-plus"), tmp_path)
    sail(session, 40.0)
    sail(other, 50.0)  # and loses nothing
    sure = other._look().overlay.covs.trace(axis1=1, axis2=2)
    before = len(session.monitor.fixes)
    session.order(session.lose, "gps", math.inf)
    session.order(session.lose, "imu", 2.0)
    sail(session, 1.0)
    seen = session._look()
    assert seen.imu_lost
    fixes = seen.fixes
    sail(session, 9.0)
    seen = session._look()
    assert seen.gps_lost and seen.gps_age > 9.0 and not seen.imu_lost
    np.testing.assert_array_equal(seen.fixes, fixes)
    assert before <= len(fixes) <= before + 2
    unsure = seen.overlay.covs.trace(axis1=1, axis2=2)
    # measured: 3.8 times now, and more than twice in a second
    assert unsure[0] > 2.0 * sure[0]
    assert unsure[3] > 1.3 * sure[3]
    session.order(session.lose, "gps", 0.0)
    sail(session, 3.0)
    assert not session._look().gps_lost


def test_the_weather_changes_under_way(tmp_path):
    session = SimulatedSession(setup(predictor="ukf", sea=SeaState()), tmp_path)
    sail(session, 3.0)
    assert not session._look().sea.waves.any()
    session.order(session.change_sea, SeaState.named("4"))
    sail(session, 5.0)
    seen = session._look()
    places = np.random.default_rng(0).uniform(-500.0, 500.0, (4000, 2))
    heights = seen.sea.elevation(*places.T, seen.t)
    assert 4.0 * heights.std() == pytest.approx(2.5, rel=0.15)
    assert np.isfinite(session.simulation.state).all()
    # the boat floats on the surface that is drawn
    x, y, z = seen.boat[[fr.X, fr.Y, fr.Z]]
    assert -z == pytest.approx(seen.sea.elevation(x, y, seen.t), abs=0.8)


def test_a_restart_sails_the_same_run_again(tmp_path):
    session = SimulatedSession(setup(predictor="ukf"), tmp_path, "zigzag")
    sail(session, 5.0)
    first = session.simulation.state.copy(), session.monitor.twin.estimate().state
    session.order(session.restart)
    session._obey()
    assert session.message == "" and session.t == 0.0
    sail(session, 5.0)
    np.testing.assert_array_equal(session.simulation.state, first[0])
    np.testing.assert_array_equal(session.monitor.twin.estimate().state, first[1])


def test_a_recorded_log_is_a_log_with_truth_and_particulars(tmp_path):
    session = SimulatedSession(setup(predictor="ukf"), tmp_path, "zigzag")
    sail(session, 2.0)
    session.record(True)
    sail(session, 6.0)
    session.record(False)
    log = Log.read(session.recorded)
    assert len(log) == 120 and log.truth is not None
    assert log.t[0] == pytest.approx(2.05)
    np.testing.assert_allclose(log.truth[-1, :2], session.simulation.state[0, :2])
    assert Particulars.load(session.recorded.with_suffix(".toml")) == session.particulars
    session.record(True)  # another one, in a file of its own
    sail(session, 1.0)
    first = session.recorded
    session.record(False)
    assert session.recorded != first and len(Log.read(first)) == 120


def test_an_order_that_fails_in_any_way_is_reported_and_the_boat_sails_on(tmp_path):
    session = SimulatedSession(setup(predictor="persistence"), tmp_path)
    session.start()
    for error in (TypeError("x"), KeyError("x"), ZeroDivisionError("x"), MemoryError("x")):

        def fail(error: Exception = error) -> None:
            raise error

        session.order(fail)
        wait(lambda name=error: session.message.startswith(type(name).__name__))
    session.order(session.steer, "nobody")
    wait(lambda: "no autopilot is called 'nobody'" in session.message)
    session.stop()
    assert session.error is None and session.helm.autopilot == "off"


def test_a_vessel_that_runs_away_is_stopped_and_said(tmp_path):
    session = SimulatedSession(setup(predictor="persistence"), tmp_path)
    sail(session, 1.0)
    session.record(True)
    session.simulation.state[0, fr.U] = math.nan
    session._anchor = time.monotonic() - 1.0, session.t
    session._advance()
    assert session.paused and "restart, and go on" in session.message
    assert session.kept == 0
    session.order(session.restart)
    session._obey()
    session.set_paused(False)
    sail(session, 1.0)
    assert np.isfinite(session.simulation.state).all()


def test_a_log_that_the_disk_does_not_take_ends_and_the_boat_sails_on(tmp_path, monkeypatch):
    session = SimulatedSession(setup(predictor="persistence"), tmp_path)
    session.order(session.toggle_record)
    sail(session, 2.0)

    def fail(*row):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(session.recorder, "add", fail)
    sail(session, 1.0)
    assert "No space left on device" in session.message and not session.recording


def test_the_thread_keeps_the_pace_and_writes_the_log_when_it_is_stopped(tmp_path):
    session = SimulatedSession(setup(predictor="ukf"), tmp_path)
    session.set_scale(5.0)
    session.start()
    wait(lambda: session.snapshot is not None)
    session.order(session.record, True)
    wait(lambda: session.recording)
    t = session.t
    wait(lambda: session.t > t + 5.0)
    session.order(session.set_paused, True)
    wait(lambda: session.paused)
    time.sleep(0.2)
    stands = session.t
    time.sleep(0.3)
    assert session.t == stands
    session.stop()
    assert session.error is None
    assert len(Log.read(session.recorded)) > 50


@pytest.fixture
def log() -> Log:
    return simulate("zigzag", vessel=VESSEL, sea=SeaState.named("2"), duration=40.0, seed=2)


def through(log: Log, tmp_path: Path, plan: str = "known") -> LogSession:
    session = LogSession(log, Twin(particulars_of(VESSEL), "ukf"), VESSEL, tmp_path, plan)
    session.start()
    wait(lambda: session.done == log.t[-1])
    return session


def test_a_moment_of_a_log_shows_the_estimate_and_what_happened(log, tmp_path):
    session = through(log, tmp_path, "hold")
    session.order(session.set_paused, True)
    for t in (30.0, 12.0, 3.0):  # back and forth
        session.order(session.seek, t)
        wait(lambda t=t: session.at == t and abs(session.snapshot.t - t) < 0.2)
        now = session.snapshot
        twin = Twin(particulars_of(VESSEL), "ukf")
        twin.run(log.slice(t1=now.t + 1e-6))
        mean = twin.predict("hold", horizon=HORIZON_S, dt=PLAN_STEP_S).mean
        np.testing.assert_allclose(now.overlay.ahead, mean)
        later = log.slice(now.t + 1e-6, now.t + HORIZON_S + 1e-6)
        np.testing.assert_array_equal(now.ahead, later.truth[:, :2])
        row = np.argmin(np.abs(log.t - now.t))
        np.testing.assert_array_equal(now.boat[[fr.X, fr.Y]], log.truth[row, :2])
        assert session.history().t[-1] <= t + 1e-6
    session.stop()


def test_a_log_of_one_row_and_one_without_fixes_are_shown(tmp_path, log):
    one = log.slice(t1=0.01)
    session = through(one, tmp_path)
    wait(lambda: session.snapshot is not None)
    session.stop()
    blind = Log(log.t, np.full_like(log.z, math.nan), log.cmd, None, "blind")
    session = through(blind, tmp_path)
    wait(lambda: session.snapshot is not None)
    assert session.snapshot.overlay is None
    assert not np.isfinite(session.snapshot.boat[fr.X])
    session.stop()


class LogFeed(Feed):
    """Rows of a log, some at a time."""

    modulus = 86400.0

    def __init__(self, log: Log) -> None:
        super().__init__(None, particulars_of(VESSEL))
        self.plane = Plane(59.43, 10.47)
        self.rows = list(log)
        self.closed = False

    notes = ("said so",)

    def decode(self, data):
        return iter(())

    def take(self):
        rows, self.rows = self.rows[:10], self.rows[10:]
        self.counts["received"] += len(rows)
        return rows

    def close(self):
        self.closed = True


def test_a_feed_is_followed_recorded_and_closed(log, tmp_path):
    feed = LogFeed(log)
    session = FeedSession(feed, Twin(particulars_of(VESSEL), "ukf"), VESSEL, tmp_path)
    session.record(True)
    session.start()
    wait(lambda: not feed.rows and session.snapshot is not None and session.snapshot.t > 39.99)
    now = session.snapshot
    assert f"received {len(log)}" in now.notes[0] and now.notes[1] == "said so"
    twin = Twin(particulars_of(VESSEL), "ukf")
    twin.run(log)
    np.testing.assert_allclose(now.overlay.state, twin.estimate().state)
    session.stop()
    assert feed.closed
    assert not now.has_imu or not now.imu_lost
    kept = Log.read(session.recorded)
    np.testing.assert_array_equal(kept.t, log.t)
    assert kept.truth is None
    assert kept.datum == Datum(latitude=59.43, longitude=10.47)


def test_a_feed_that_falls_silent_is_reported(log, tmp_path, monkeypatch):
    monkeypatch.setattr("twin.live.sessions.feed.SILENT_AFTER_S", 0.4)
    feed = LogFeed(log.slice(t1=20.0))
    session = FeedSession(feed, Twin(particulars_of(VESSEL), "ukf"), VESSEL, tmp_path)
    session.start()
    wait(lambda: session.snapshot is not None and session.snapshot.silence > 1.0)
    seen = session.snapshot
    assert seen.gps_lost and seen.imu_lost and seen.gps_age > 1.0
    feed.rows = list(log.slice(t0=20.0))
    wait(lambda: session.snapshot.silence == 0.0)
    wait(lambda: not feed.rows)
    session.order(session.forget)
    wait(lambda: not session.monitor.fixes and not session.monitor.twin.estimate().ready)
    session.stop()
    assert session.error is None


def test_a_twin_that_is_given_the_commands_that_follow_is_better(log, tmp_path):
    errors = []
    for plan in ("known", "hold"):
        session = through(log, tmp_path, plan)
        errors.append(np.nanmean(session.monitor.history().error))
        session.stop()
    assert errors[0] < errors[1]
    with pytest.raises(TwinError, match="hold or known"):
        LogSession(log, Twin(particulars_of(VESSEL), "ukf"), VESSEL, tmp_path, "guess")
