"""Timed manoeuvres: properties of all, and the shape of each."""

import math

import numpy as np
import pytest

from usv_gym import Vessel
from usv_gym.manoeuvring.manoeuvres import (
    ANGLE,
    APPROACH,
    LEG,
    MANOEUVRES,
    SWITCH,
    ManoeuvreError,
    commands,
)

T = 0.05 * np.arange(4000)
BOAT = Vessel.load("usv75")
N = BOAT.values["shaft_speed_manoeuvring"]


def given(name: str, seed: int = 0) -> np.ndarray:
    return commands(name, T, BOAT, np.random.default_rng(seed))


@pytest.mark.parametrize("name", MANOEUVRES)
def test_commands_are_bounded_and_straight_on_approach(name: str) -> None:
    cmd = given(name)
    assert cmd.shape == (len(T), 4)
    assert np.all(np.isfinite(cmd))
    assert np.all((cmd[:, :2] > 0.0) & (cmd[:, :2] <= N))
    assert np.max(np.abs(cmd[:, 2:])) <= math.radians(30.0)
    # both units together
    np.testing.assert_array_equal(cmd[:, 0], cmd[:, 1])
    np.testing.assert_array_equal(cmd[:, 2], cmd[:, 3])
    assert np.all(cmd[T < APPROACH] == [N, N, 0.0, 0.0])
    np.testing.assert_array_equal(cmd, given(name))


@pytest.mark.parametrize("name", MANOEUVRES)
def test_commands_do_not_depend_on_the_duration(name: str) -> None:
    short = commands(name, T[:700], BOAT, np.random.default_rng(0))
    np.testing.assert_array_equal(short, given(name)[:700])


def test_turn_holds_its_angle() -> None:
    assert np.all(given("straight")[:, 2] == 0.0)
    assert np.all(given("turn")[T >= APPROACH, 2] == math.radians(20.0))


def test_zigzag_has_equal_legs_to_both_sides() -> None:
    angle = given("zigzag")[:, 2]
    for leg in range(5):
        since = T - (APPROACH + leg * LEG)
        inside = (since > 0.01) & (since < LEG - 0.01)
        assert np.all(angle[inside] == (ANGLE if leg % 2 == 0 else -ANGLE))


def test_turn_zigzag_changes_at_its_switch() -> None:
    angle = given("turn-zigzag")[:, 2]
    np.testing.assert_array_equal(angle[T < SWITCH], given("turn")[T < SWITCH, 2])
    assert np.all(angle[(T > SWITCH) & (T < SWITCH + LEG - 0.01)] == -ANGLE)
    later = (T > SWITCH + LEG + 0.01) & (T < SWITCH + 2 * LEG - 0.01)
    assert np.all(angle[later] == ANGLE)


def test_random_steps_last_3_to_10_seconds() -> None:
    cmd = given("random")
    changes = T[1:][np.any(np.diff(cmd, axis=0) != 0.0, axis=1)]
    assert changes[0] == pytest.approx(APPROACH, abs=0.06)
    held = np.diff(changes)
    # sampled at 20 Hz
    assert np.all((held > 2.94) & (held < 10.06))
    assert len(held) > 20
    assert not np.array_equal(cmd, given("random", seed=1))


def test_a_thruster_pair_steers_by_unequal_speeds() -> None:
    otter = Vessel.load("otter")
    cmd = commands("turn", T, otter, np.random.default_rng(0), n=N)
    share = given("turn")[:, 2] / math.radians(30.0)
    # thrust goes with the square of the speed: the sum stays
    np.testing.assert_allclose(cmd[:, 0] ** 2, N**2 * (1.0 + share), rtol=1e-12)
    np.testing.assert_allclose(cmd[:, 1] ** 2, N**2 * (1.0 - share), rtol=1e-12)
    assert np.all(cmd[:, 2:] == 0.0)


def test_unknown_names_are_refused_with_the_known_ones() -> None:
    with pytest.raises(ManoeuvreError, match="'loop'; known: straight, turn, zigzag"):
        given("loop")
