"""An agent in the view sails the episode of its evaluation."""

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from twin import Log
from twin.agents.controllers import make_controller
from twin.agents.evaluation import evaluate
from twin.live.sessions.policy import PolicySession
from twin.live.sessions.session import SessionError


@pytest.fixture
def session(tmp_path: Path) -> Iterator[PolicySession]:
    agent = make_controller("los-twin")
    made = PolicySession(agent, tmp_path, seed=5, predictor="ukf", sea="2", max_episode_steps=60)
    yield made
    made.envs.close()


def sail(session: PolicySession, until: float) -> None:
    """Sail until a time of this episode, or to its end, as fast as it goes."""
    seed = session.seed
    while session.seed == seed and session.t < until - 1e-6:
        session._anchor = time.monotonic() - 0.05 - 1e-6, session.t
        session._advance()


def test_view_sails_the_evaluated_episode(session: PolicySession) -> None:
    sail(session, 31.0)
    assert session.seed == 6
    expected: Any
    (expected,) = evaluate(make_controller("los-twin"), seeds=(5,), max_episode_steps=60)
    assert session._result.startswith(f"seed 5: {expected['off_path_m']:.2f} m off the path, did")


def test_each_row_of_the_episode_is_shown_once(session: PolicySession) -> None:
    session.record(True)
    sail(session, 10.0)
    session.record(False)
    assert session.recorded is not None
    log = Log.read(session.recorded)
    np.testing.assert_allclose(np.diff(log.t), 0.05, atol=1e-6)
    assert log.t[-1] == pytest.approx(10.0)
    shown = session._look()
    assert shown.t == pytest.approx(10.0) and len(shown.path) == 7
    assert shown.notes[0] == "los-twin sails seed 5"
    assert np.hypot(*(shown.boat[:2] - shown.track[-1])) < 5.0


def test_gps_is_lost_from_the_next_decision_on(session: PolicySession) -> None:
    sail(session, 5.0)
    session.lose("gps", 10.0)
    sail(session, 14.0)
    assert session._look().gps_lost and not session.is_lost("gps")
    sail(session, 20.0)
    assert not session._look().gps_lost
    session.toggle_loss("imu")
    assert session.is_lost("imu")
    with pytest.raises(SessionError):
        session.lose("sonar", 1.0)


def test_next_episode_begins_with_the_next_seed(session: PolicySession) -> None:
    sail(session, 3.2)  # between two decisions
    session.toggle_loss("gps")
    session.next_episode()
    assert session.seed == 6 and session.t == 0.0
    assert not session.is_lost("gps")
    sail(session, 2.0)
    assert session.t == pytest.approx(2.0)
