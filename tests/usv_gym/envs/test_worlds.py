"""Worlds that differ: what is drawn, what of it is shown, and that one boat is as in many."""

import math

import gymnasium as gym
import numpy as np
import pytest

import usv_gym  # noqa: F401 - registers the environment
from usv_gym import Vessel
from usv_gym.envs.env import USVEnv
from usv_gym.envs.vector import USVVectorEnv
from usv_gym.physics import frames as fr
from usv_gym.physics import waves
from usv_gym.vessel.vessel import BoatClass, VesselError
from usv_kernel.errors import UsvTwinError

ALL = {
    "vessel_spread": 0.3,
    "wind_from_deg": "any",
    "current": "any",
    "heading_deg": "any",
    "load": (0.8, 1.2),
    "sea": "0|2|squall",
    "faults": "none|gps10|imu-random+gps-bursts",
}


def test_infos_say_what_was_drawn_where_an_episode_begins() -> None:
    envs = USVVectorEnv(3, autoreset_mode="SameStep", frame_skip=10, **ALL)
    _, infos = envs.reset(seed=0, options={"first_episode_steps": np.array([2, 9, 9])})
    assert infos["_drawn"].all() and len(set(infos["drawn"]["wind_from_deg"])) == 3
    infos = envs.step(np.zeros((3, 2)))[-1]
    assert "drawn" not in infos
    infos = envs.step(np.zeros((3, 2)))[-1]
    assert infos["_drawn"].tolist() == [True, False, False]
    assert infos["drawn"]["_load"].tolist() == [True, False, False]
    assert infos["drawn"]["faults"][1] is None and "drawn" not in infos["final_info"]


def test_drawn_numbers_are_those_of_the_simulated_boat() -> None:
    env, faults = USVEnv(**ALL), set()
    for seed in range(5):
        drawn = env.reset(seed=seed)[1]["drawn"]
        faults.add(drawn["faults"])
        boat, packed = env.simulation.boats[0], env.vessel.packed
        for key in ("mass", "Y_v", "k_0", "length_overall"):
            factor = getattr(drawn["vessel_factors"], key)
            assert boat["vessel"][key] == pytest.approx(factor * packed[key], rel=1e-12)
            assert factor != 1.0
        left, right = drawn["vessel_factors"][-2:]
        assert boat["vessel"]["side_thrust"].tolist() == pytest.approx([left - 1, right - 1])
        to = math.radians(drawn["current_to_deg"])
        north = drawn["current_mps"] * math.cos(to)
        assert boat["weather"]["current_north"] == pytest.approx(north)
        heading = math.degrees(boat["state"][fr.PSI]) % 360.0
        assert heading == pytest.approx(drawn["heading_deg"]) and 0.8 <= drawn["load"] <= 1.2
        assert math.degrees(boat["weather"]["wind_from"][0]) % 360.0 == pytest.approx(
            drawn["wind_from_deg"]
        )
    assert len(faults) > 2  # those after 10 to 60 s are told with their time


def test_options_leave_each_other_and_the_path_as_they_were() -> None:
    plain = USVEnv(sea="2")
    plain.reset(seed=1)
    some = {"current": "any", "wind_from_deg": "any"}
    one, other = USVEnv(sea="2", **some), USVEnv(sea="2", vessel_spread=0.3, **some)
    drawn = [env.reset(seed=1)[1]["drawn"] for env in (one, other)]
    rows = [waves.OMEGA, waves.PHASE, waves.AMPLITUDE]
    for _ in range(3):  # in the episodes that follow as well
        for key in ("current_mps", "current_to_deg", "wind_from_deg"):
            assert drawn[0][key] == drawn[1][key]
        for env in (one, other):
            np.testing.assert_array_equal(env.task.points, plain.task.points)
            np.testing.assert_array_equal(
                env.simulation.waves[0, rows], plain.simulation.waves[0, rows]
            )
        plain.reset()
        drawn = [env.reset()[1]["drawn"] for env in (one, other)]


def test_a_heading_turns_the_path_with_the_boat() -> None:
    still = {"sea": "0", "suite": "perfect"}
    north, east = USVEnv(**still), USVEnv(**still, heading_deg=90.0)
    for env in (north, east):
        env.reset(seed=5)
        for _ in range(40):
            env.step([0.7, 0.3])
    turned = np.stack([north.task.points[0, :, 1] * -1.0, north.task.points[0, :, 0]], axis=1)
    np.testing.assert_allclose(east.task.points[0], turned, atol=1e-9)
    np.testing.assert_allclose(east.task.errors, north.task.errors, atol=1e-9)


def test_the_observation_does_not_show_what_was_drawn() -> None:
    """At the start boats differ in their speed alone."""
    plain, varied = USVEnv(sea="0"), USVEnv(sea="0", vessel_spread=0.3, load=1.2)
    one, other = plain.reset(seed=2)[0], varied.reset(seed=2)[0]
    moves = [plain.observation_names.index(name) for name in ("speed_forward", "speed_starboard")]
    np.testing.assert_array_equal(np.delete(one, moves), np.delete(other, moves))
    assert plain.observation_names == varied.observation_names


def test_boats_of_a_class_have_unequal_sides() -> None:
    kind = BoatClass(Vessel.load("usv75"), 0.15, sides=0.05)
    rng = np.random.default_rng(0)
    sides = np.array([kind.draw(rng).vessel.side_thrust for _ in range(300)])
    np.testing.assert_allclose(sides.std(axis=0), 0.05, rtol=0.15)
    assert abs(np.corrcoef(sides.T)[0, 1]) < 0.2
    single = BoatClass(Vessel.load("kvlcc2_l7"), 0.15, sides=0.05)
    assert single.draw(rng).vessel.side_thrust == (0.0, 0.0)


def test_a_boat_with_a_stronger_left_side_turns_to_starboard() -> None:
    rates = []
    for seed in range(6):
        env = USVEnv(sea="0", vessel_spread=0.3)
        left, right = env.reset(seed=seed)[1]["drawn"]["vessel_factors"][-2:]
        for _ in range(100):
            env.step([0.7, 0.0])
        rates.append((left - right) * env.simulation.state[0, fr.R])
    assert all(rate > 0.0 for rate in rates)


def test_drawn_vessels_are_equal_to_those_that_are_checked() -> None:
    for name in ("usv75", "otter", "kvlcc2"):
        kind = BoatClass(Vessel.load(name), 0.2, sides=0.05)
        boat = kind.draw(np.random.default_rng(1), load=1.1)
        v = boat.vessel
        again = Vessel(
            name=v.name,
            title=v.title,
            kind=v.kind,
            values=v.values,
            resistance_speed=v.resistance_speed,
            resistance_force=v.resistance_force,
            side_thrust=v.side_thrust,
        )
        ours, theirs = (np.array([one.packed]).view(float) for one in (v, again))
        np.testing.assert_allclose(ours, theirs, rtol=1e-14)
        n = v.values["shaft_speed_manoeuvring"]
        assert boat.speed == pytest.approx(again.straight_speed(n), abs=1e-8)


WRONG = {
    "vessel_spread": (-0.1, 0.6, "x", None),
    "load": (0.1, (1.2, 0.8), (1.0,), "any"),
    "wind_from_deg": ("all", (1.0, 2.0, 3.0), (90.0, 10.0), (0.0, math.nan)),
    "current": (-1.0, "x", (1.0, 2.0, 3.0), (0.3, (0.0, 1e9)), {}),
    "heading_deg": ("north", None, (0.0, math.inf)),
}


@pytest.mark.parametrize("name", WRONG)
def test_wrong_worlds_are_refused_by_name(name) -> None:
    for value in WRONG[name]:
        with pytest.raises(UsvTwinError, match=name):
            USVEnv(**{name: value})


def test_vessels_that_cannot_share_an_environment_are_refused() -> None:
    with pytest.raises(VesselError, match=r"usv75 has 4, otter has 2; use actions='common'"):
        USVEnv(vessel="usv75|otter", actions="units")
    with pytest.raises(VesselError, match=r"with dof=6.*without_table"):
        USVEnv(vessel="usv75|kvlcc2", dof=6)


def test_pictures_show_the_vessel_that_was_drawn() -> None:
    envs = USVVectorEnv(6, vessel="usv75|otter", render_mode="rgb_array")
    _, infos = envs.reset(seed=0)
    drawn = [envs.renderer.scene(i).vessel.name for i in range(6)]
    assert drawn == infos["drawn"]["vessel"].tolist() and len(set(drawn)) == 2


@pytest.mark.parametrize("options", [{}, {"dof": 6}, {"dof": 6, "vessel": "otter"}])
def test_boats_in_a_calm_sea_equal_those_with_no_waves_around(options) -> None:
    seas = [
        gym.make_vec("USVTwin-v0", num_envs=6, twin=None, sea=sea, frame_skip=5, **options)
        for sea in ("0|4", "0")
    ]
    mixed, calm = (envs.reset(seed=3) for envs in seas)
    in_calm = mixed[1]["drawn"]["hs_m"] == 0.0
    assert 0 < in_calm.sum() < 6
    np.testing.assert_array_equal(mixed[0][in_calm], calm[0][in_calm])
    for k in range(20):
        both = [envs.step(np.full((6, 2), 0.04 * k)) for envs in seas]
        for one, other in zip(both[0][:4], both[1][:4], strict=True):
            np.testing.assert_array_equal(one[in_calm], other[in_calm])
        assert not np.array_equal(both[0][0][~in_calm], both[1][0][~in_calm])
