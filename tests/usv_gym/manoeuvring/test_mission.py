"""A mission keeps to its legs, and is the same whatever the twin's sensors lose."""

from itertools import islice

import numpy as np
import pytest

from twin.benchmark.loading import load_run
from twin.benchmark.protocol import Settings, units
from twin.sim.bridge import CONTROL_STEP_S, simulate
from usv_gym import Fault, SeaState, Vessel
from usv_gym.manoeuvring.mission import CURRENT, CURRENT_TO, time_to_know, way_points

SEA = SeaState.named("2").replace(current=CURRENT, current_to=CURRENT_TO)


def distance_to_legs(place, corners):
    """Return the distance of places (N, 2) to the nearest leg between corners (K, 2)."""
    begin, leg = corners[:-1], np.diff(corners, axis=0)
    share = np.sum((place[:, None] - begin) * leg, axis=2) / np.sum(leg**2, axis=1)
    nearest = begin + np.clip(share, 0.0, 1.0)[..., None] * leg
    return np.linalg.norm(place[:, None] - nearest, axis=2).min(axis=1)


@pytest.mark.parametrize("name", ["usv75", "otter", "wamv16"])
def test_a_boat_keeps_to_the_legs(name):
    vessel = Vessel.load(name)
    length = vessel.values["length_waterline"]
    duration = time_to_know(vessel) + 30.0
    log = simulate("mission", vessel=vessel, sea=SEA, duration=duration, seed=1)
    corners = np.array([*islice(way_points(length, log.truth[0, :2], log.truth[0, 2]), 6)])
    off = distance_to_legs(log.truth[:, :2], corners)
    # a boat cuts and overshoots corners; in between it is on its leg
    assert np.median(off) < 0.6 * length
    passed = np.linalg.norm(log.truth[:, None, :2] - corners[:4], axis=2).min(axis=0)
    assert (passed < 5.0 * length).all()


def test_a_loss_of_gps_does_not_change_the_track():
    vessel, fault = Vessel.load("otter"), Fault("gps", 10.0, 30.0)
    whole, lost = (
        simulate("mission", vessel=vessel, sea=SEA, duration=60.0, seed=3, faults=faults)
        for faults in ((), (fault,))
    )
    np.testing.assert_array_equal(whole.truth, lost.truth)
    struck = (lost.t >= 10.0) & (lost.t < 40.0)
    assert np.isnan(lost.z[struck, 0]).all()


def test_a_benchmark_sails_both_directions_before_a_loss_that_ends_in_time():
    settings = Settings(scenarios=("mission",), faults=("gps60",), vessel="otter", seeds=(0,))
    run = load_run(settings, units(settings)[0])
    assert run.identify == pytest.approx(time_to_know(settings.boat(0)))
    before = run.reference.truth[run.reference.t < run.identify, 2]
    assert np.cos(before).max() > 0.9
    assert np.cos(before).min() < -0.9
    assert run.reference.t[-1] > run.identify + settings.fault_after_s + 60.0
    # the boat drifts with a current, although the sea of the settings has none
    assert run.simulator[1].current == CURRENT
    assert run.reference.t[1] == pytest.approx(CONTROL_STEP_S)
