"""External navigation against an EKF with ArduPilot's rules: a minute without GPS, and back."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import pytest

from tests.twin.live.external.fake_ekf import AUTO, HOLD, HOME, FakeEkf, LoopPort
from twin.digital_twin import Twin
from twin.live.external.navigation import STATES, ExternalNavigation
from twin.live.external.peer import AutopilotPeer
from twin.live.external.simulated import AutopilotRun, suite_of
from twin.sim.bridge import particulars_of
from usv_gym.sitl.backend import Backend
from usv_gym.vessel.vessel import Vessel
from usv_gym.world.faults import Fault
from usv_gym.world.sea import SeaState
from usv_gym.world.simulation import Simulation

SEA = SeaState(hs=0.5, wind=6.0, current=0.2, current_to=math.radians(60.0))
LOST, BACK = 120.0, 180.0
END = 186.0
LANES = [[10.0, 0.0], [120.0, 0.0], [120.0, 50.0], [10.0, 50.0], [10.0, 100.0], [120.0, 100.0]]
POINTS = np.array(LANES)


class Sailed(NamedTuple):
    ekf: FakeEkf
    run: AutopilotRun
    events: list[tuple[float, str]]
    stated: list[tuple[float, ...]]  # time, place and standard deviations of the twin

    def error(self, t: float) -> float:
        """Return how far the autopilot's own estimate is off at a time, m."""
        times = [at for at, _ in self.ekf.errors]
        return self.ekf.errors[int(np.searchsorted(times, t))][1]

    def states(self, after: float = 0.0) -> list[str]:
        names = [text.partition(":")[0] for t, text in self.events if t > after]
        return [name for name in names if name in STATES]


def sail(
    seed: int = 1, *, twin: bool = True, end: float = END, lost: float = LOST, **options: Any
) -> Sailed:
    boat, suite = Vessel.load("usv75"), suite_of("typical")
    faults = (Fault("gps", lost, BACK - LOST),)
    simulation = Simulation(
        1, boat, SEA, suite=suite, faults=faults, dof=6, dt=0.025, dt_physics=0.0125
    )
    backend = Backend(simulation, seed)
    events: list[tuple[float, str]] = []
    refuse = options.pop("refuse", False)
    ekf = FakeEkf(backend, POINTS, seed, external=twin)
    ekf.refuse_source = refuse
    navigation = None
    if twin:
        navigation = ExternalNavigation(lambda t, text: events.append((t, text)), **options)
    port = LoopPort(navigation.peer if navigation else AutopilotPeer(), ekf)
    run = AutopilotRun(
        backend,
        HOME,
        twin=Twin(particulars_of(boat, suite, 6)) if twin else None,
        navigation=navigation,
        port=port,  # type: ignore[arg-type]
    )
    stated: list[tuple[float, ...]] = []
    while ekf.pilot.last < end:
        ekf.step()
        if run.twin is not None and (now := run.twin.estimate()).ready:
            stated.append((now.t, *now.state[:2].tolist(), *now.sd[:2].tolist()))
    return Sailed(ekf, run, events, stated)


@pytest.fixture(scope="module")
def sailed() -> list[Sailed]:
    return [sail(seed) for seed in range(1, 6)]


def test_the_mission_goes_on_for_a_minute_without_gps(sailed: list[Sailed]) -> None:
    for one in sailed:
        assert [mode for _, mode in one.ekf.modes] == [AUTO]
        assert one.states() == ["ready", "lost", "aiding", "returning", "ready"]


def test_the_estimate_of_the_autopilot_stays_near_the_truth(sailed: list[Sailed]) -> None:
    errors = [one.error(BACK - 0.1) for one in sailed]
    assert np.median(errors) < 4.0
    assert max(errors) < 8.0


def test_the_estimate_is_right_three_seconds_after_the_gps_is_back(sailed: list[Sailed]) -> None:
    assert max(one.error(BACK + 3.0) for one in sailed) < 3.0


def test_the_stated_sd_holds_the_error(sailed: list[Sailed]) -> None:
    """The twin must not claim more than it knows: within three of its standard deviations."""
    for one in sailed:
        t, x, y, sd_x, sd_y = next(row for row in reversed(one.stated) if row[0] < BACK)
        truth = one.run.log.slice(t - 0.01).truth
        assert truth is not None
        assert abs(x - truth[0, 0]) < 3.0 * sd_x
        assert abs(y - truth[0, 1]) < 3.0 * sd_y


def test_without_a_twin_the_failsafe_holds_the_boat() -> None:
    one = sail(twin=False, end=LOST + 40.0)
    assert [mode for _, mode in one.ekf.modes] == [AUTO, HOLD]
    assert one.ekf.modes[1][0] == pytest.approx(LOST + 8.0, abs=0.5)
    assert math.hypot(*one.ekf.pilot.seen[-1].velocity[:2]) < 1.5  # it drifts


def test_the_same_seed_is_the_same_flight(sailed: list[Sailed]) -> None:
    again = sail(1)
    np.testing.assert_array_equal(again.run.log.truth, sailed[0].run.log.truth)
    assert again.events == sailed[0].events


def test_a_twin_that_has_seen_too_little_does_not_take_over() -> None:
    one = sail(end=60.0, lost=45.0)
    assert one.states() == ["lost"]
    assert "of 30 s under way" in one.events[-2][1]
    assert "fell to Hold" in one.events[-1][1]
    assert one.ekf.source == 1


def test_a_twin_that_no_longer_knows_gives_up() -> None:
    one = sail(end=LOST + 45.0, max_sd_m=2.0)
    assert one.states() == ["ready", "lost", "aiding", "gave up"]
    assert one.ekf.source == 1
    assert one.ekf.modes[-1][1] == HOLD


def test_a_source_that_is_refused_is_asked_for_again_and_said() -> None:
    one = sail(end=LOST + 4.0, refuse=True)
    refused = [text for _, text in one.events if "refused source set 2" in text]
    assert 4 <= len(refused) <= 7
    assert one.run.navigation is not None and one.run.navigation.state == "lost"
