"""The real ArduRover on our boats: ``pytest -m ardupilot`` with its path in USV_TWIN_ARDUROVER."""

import os
from pathlib import Path

import numpy as np
import pytest

from tests.twin.live.wire import load_example

flights = load_example("autopilot/flights.py")
HOLD, Flight, lose = flights.HOLD, flights.Flight, flights.lose
PROGRAM = os.environ.get("USV_TWIN_ARDUROVER", "")

pytestmark = [
    pytest.mark.ardupilot,
    pytest.mark.skipif(
        not Path(PROGRAM).is_file(),
        reason="USV_TWIN_ARDUROVER is not the path of ArduPilot's ardurover",
    ),
]

# one and a half times the targets of usv75: runs differ, as MAVLink is not in lock-step
ERROR, AFTER = 12.0, 4.5


@pytest.mark.parametrize("seed", [1, 2])
def test_ardurover_sails_on_by_the_twin(seed: int, tmp_path: Path) -> None:
    flight = Flight(Path(PROGRAM), tmp_path, "usv75", seed=seed, predictor="dsw-ukf-plus")
    try:
        found = lose(flight, 60.0, ("usv75", "dsw-ukf-plus", seed))
    finally:
        flight.close()
    assert found.auto
    assert found.error < ERROR
    assert found.after < AFTER
    assert found.packets["lost"] == 0
    assert flight.navigation is not None and flight.navigation.state == "ready"


def test_ardurover_holds_without_the_twin(tmp_path: Path) -> None:
    flight = Flight(Path(PROGRAM), tmp_path, "otter", seed=1)
    try:
        found = lose(flight, 30.0, ("otter", "none", 1))
    finally:
        flight.close()
    assert not found.auto
    assert flight.station.modes[-1][1] == HOLD


def test_ardurover_completes_a_mission(tmp_path: Path) -> None:
    flight = Flight(Path(PROGRAM), tmp_path, "otter", seed=2)
    try:
        flight.until(500.0)
    finally:
        flight.close()
    assert flight.station.done
    track = flight.run.log.slice(60.0).truth
    assert track is not None
    off = [flight.off_track(place) for place in track[::20, :2]]
    assert np.sqrt(np.mean(np.square(off))) < 2.5
