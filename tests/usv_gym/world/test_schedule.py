"""Seas that change as time goes on, as texts and in environments."""

from __future__ import annotations

import math

import gymnasium as gym
import numpy as np
import pytest

import usv_gym  # noqa: F401 - registers the environment
from tests.usv_gym.world.seas import realise
from usv_gym import SEA_STATES, SeaKeyframe, SeaState
from usv_gym.physics import weather as wx
from usv_gym.world.recorded_spectrum import SeaError
from usv_gym.world.schedule import changing_sea, parse_values

TWO = SeaState.named("2")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("0.3", ((0.0, 0.3),)),
        (0.3, ((0.0, 0.3),)),
        ("0.3@0,0.9@60", ((0.0, 0.3), (60.0, 0.9))),
        (" 1e-1@5 , 2@7.5", ((5.0, 0.1), (7.5, 2.0))),
    ],
)
def test_texts_are_values_with_times(text: str | float, expected: tuple) -> None:
    assert parse_values(text, "hs") == expected


@pytest.mark.parametrize(
    "text",
    ["", "high", "0.3,0.9", "0.3@", "@3", "0.3@1@2", "0.3@60,0.9@0", "0.3@-5,0.9@5", "nan"],
)
def test_texts_that_make_no_sense_are_refused(text: str) -> None:
    with pytest.raises(SeaError, match=r"^hs = "):
        parse_values(text, "hs")


def test_single_numbers_give_the_sea_that_they_gave_before() -> None:
    made = changing_sea(TWO, "0.7", "6", "90")
    assert made == TWO.replace(hs=0.7, wind=6.0, wind_from=math.radians(90.0))
    assert changing_sea(TWO) is TWO


def test_what_is_not_given_stays() -> None:
    made = changing_sea(TWO, hs="0.3@0,0.9@60")
    assert made.schedule == (
        SeaKeyframe(0.0, 0.3, 4.5, TWO.wind_from),
        SeaKeyframe(60.0, pytest.approx(0.9), 4.5, TWO.wind_from),
    )


def test_times_of_both_are_joined_and_the_wind_turns_the_short_way() -> None:
    made = changing_sea(TWO, "0.4@0,0.8@40", "4@20,10@30", "350@0,10@40")
    found = [(k.time, k.hs, k.wind, math.degrees(k.wind_from) % 360.0) for k in made.schedule]
    assert found == [
        pytest.approx((0.0, 0.4, 4.0, 350.0)),
        pytest.approx((20.0, 0.6, 4.0, 0.0)),
        pytest.approx((30.0, 0.7, 10.0, 5.0)),
        pytest.approx((40.0, 0.8, 10.0, 10.0)),
    ]


def wind_at(state: SeaState, t: float) -> tuple[float, float]:
    """Return speed (m/s) and direction (degrees) of the mean wind."""
    sea = realise(state.replace(gusts="none"))
    north, east = wx.air_velocity(t, sea.gusts, sea.weather)
    return math.hypot(north, east), math.degrees(math.atan2(-east, -north)) % 360.0


def test_a_squall_is_ten_metres_a_second_for_twenty_seconds() -> None:
    squall = SEA_STATES["squall"]
    for t, expected in ((60.0, (4.5, 135.0)), (95.0, (14.5, 175.0)), (115.0, (4.5, 135.0))):
        assert wind_at(squall, t) == pytest.approx(expected)
    # of another direction all of it is turned
    assert wind_at(squall.turned(math.radians(300.0)), 95.0) == pytest.approx((14.5, 340.0))


def test_a_building_sea_goes_from_sea_2_to_sea_3_in_a_minute() -> None:
    first, last = SEA_STATES["building"].schedule
    assert last.time - first.time == 60.0
    for keyframe, name in ((first, "2"), (last, "3")):
        assert (keyframe.hs, keyframe.wind) == (SEA_STATES[name].hs, SEA_STATES[name].wind)


SCHEDULE = [(0.0, 0.2, 3.0), (4.0, 1.0, 12.0, 1.0)]


def test_environments_take_a_schedule() -> None:
    options = {"twin": None, "suite": "best", "task": "free"}
    changing = gym.make("USVTwin-v0", **options, schedule=SCHEDULE)
    steady = gym.make("USVTwin-v0", **options, schedule=SCHEDULE[:1])
    assert changing.unwrapped.seas[0].schedule[1] == SeaKeyframe(*SCHEDULE[1])
    names = list(changing.unwrapped.observation_names)
    at, felt = [names.index("wind_ahead"), names.index("wind_starboard")], []
    for env in (changing, steady):
        env.reset(seed=4)
        for _ in range(160):
            obs = env.step(np.array([0.5, 0.5], np.float32))[0]
        felt.append(np.hypot(*obs[at]))
    # 12 m/s after the change against 3, in units of 10 m/s
    assert felt[0] > felt[1] + 0.4


def test_an_empty_schedule_leaves_the_sea_as_it_is() -> None:
    env = gym.make("USVTwin-v0", twin=None, schedule=())
    assert env.unwrapped.seas == (TWO,)
