"""Sea states: names, checks, realisations."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from usv_gym import SEA_STATES, SeaState, Vessel
from usv_gym.physics import GRAVITY, ship, waves
from usv_gym.sea import SeaError

BOAT = Vessel.load("usv75")


def realise(state: SeaState, seed: int = 0):  # type: ignore[no-untyped-def]
    return state.realise(BOAT, *np.random.default_rng(seed).spawn(2))


@pytest.mark.parametrize("name", SEA_STATES)
def test_every_named_sea_state_can_be_sailed(name: str) -> None:
    state = SeaState.named(name)
    sea = realise(state)
    assert sea.waves.shape == (waves.WAVE_ROWS, 100 if state.hs else 0)
    for array in (sea.waves, sea.gusts, sea.steady):
        assert array.dtype == np.float64
        assert array.flags.c_contiguous
        assert np.all(np.isfinite(array))
    # equal energies: Hs = 4 sqrt(sum a^2 / 2), to the bit but rounding
    height = 4.0 * math.sqrt(0.5 * np.sum(sea.waves[waves.AMPLITUDE] ** 2))
    assert height == pytest.approx(state.hs, rel=1e-12)


def test_heights_and_winds_rise_with_the_number() -> None:
    states = [SEA_STATES[str(number)] for number in range(7)]
    assert all(a.hs < b.hs and a.wind < b.wind for a, b in pairwise(states))
    # sea state 2 is the paper's: Hs .5 m, wind 4.5 m/s from the south-east (issue, Table 1)
    two = SEA_STATES["2"]
    assert (two.hs, two.wind, math.degrees(two.wind_from)) == (0.5, 4.5, pytest.approx(135.0))


def test_deep_water_waves_run_down_the_wind_unless_told() -> None:
    sea = realise(SeaState(hs=1.0, wind=8.0, wind_from=math.radians(135.0)))
    north, east = sea.waves[waves.K_NORTH], sea.waves[waves.K_EAST]
    np.testing.assert_allclose(np.arctan2(east, north), math.radians(-45.0), rtol=1e-12)
    np.testing.assert_allclose(
        np.hypot(north, east), sea.waves[waves.OMEGA] ** 2 / GRAVITY, rtol=1e-12
    )
    told = realise(SeaState(hs=1.0, wind=8.0, wave_to=0.3))
    np.testing.assert_allclose(
        np.arctan2(told.waves[waves.K_EAST], told.waves[waves.K_NORTH]), 0.3, rtol=1e-12
    )


def test_current_goes_where_it_is_said_to() -> None:
    sea = realise(SeaState(current=2.0, current_to=math.radians(90.0)))
    assert sea.steady[ship.CURRENT_EAST] == pytest.approx(2.0)
    assert abs(sea.steady[ship.CURRENT_NORTH]) < 1e-15


def test_one_seed_one_sea() -> None:
    state = SeaState.named("3")
    one, same, other = realise(state, 1), realise(state, 1), realise(state, 2)
    np.testing.assert_array_equal(one.waves, same.waves)
    np.testing.assert_array_equal(one.gusts, same.gusts)
    assert not np.any(one.waves[waves.PHASE] == other.waves[waves.PHASE])
    assert not np.any(one.gusts[1] == other.gusts[1])


def test_the_sea_never_repeats_within_an_hour() -> None:
    """Equal steps of frequency would repeat after 2 pi over the step (physics.md 5.2)."""
    sea = realise(SeaState.named("2"))
    t = np.arange(0.0, 120.0, 0.25)
    first = np.array([waves.elevation(0.0, 0.0, x, sea.waves) for x in t])
    for later in range(120, 3600, 40):
        again = np.array([waves.elevation(0.0, 0.0, x + later, sea.waves) for x in t])
        assert abs(np.corrcoef(first, again)[0, 1]) < 0.9


def test_waves_and_gusts_have_sources_of_their_own() -> None:
    both = realise(SeaState(hs=0.5, wind=5.0))
    no_wind = realise(SeaState(hs=0.5))
    no_waves = realise(SeaState(wind=5.0))
    np.testing.assert_array_equal(both.waves, no_wind.waves)
    np.testing.assert_array_equal(both.gusts, no_waves.gusts)
    assert no_wind.gusts.shape == (3, 0)
    assert realise(SeaState(wind=5.0, gusty=False)).gusts.shape == (3, 0)


@pytest.mark.parametrize(
    ("name", "value", "rule"),
    [
        ("hs", -0.1, "between 0 and 20"),
        ("hs", 25.0, "between 0 and 20"),
        ("wind", -1.0, "between 0 and 75"),
        ("current", -1.0, "between 0 and 10"),
        ("hs", math.nan, "finite"),
        ("wind_from", math.inf, "finite"),
        ("wave_to", math.nan, "finite"),
        ("components", 0, "between 1 and 10000"),
        ("components", 20_000, "between 1 and 10000"),
    ],
)
def test_seas_that_cannot_be(name: str, value: float, rule: str) -> None:
    with pytest.raises(SeaError, match=f"{name} = {value}: must .*{rule}"):
        SeaState(**{name: value})  # type: ignore[arg-type]


def test_unknown_names_list_those_there_are() -> None:
    with pytest.raises(SeaError, match="'9'; known: calm, 0, 1, 2, 3"):
        SeaState.named("9")
    state = SeaState(hs=0.2)
    assert SeaState.named(state) is state


def test_replace_changes_what_is_given() -> None:
    two = SeaState.named("2")
    changed = two.replace(hs=1.0, wind=None)
    assert (changed.hs, changed.wind) == (1.0, two.wind)
    assert two.replace(hs=0.0).hs == 0.0  # nought is a value
    with pytest.raises(SeaError, match="hs"):
        two.replace(hs=-1.0)
