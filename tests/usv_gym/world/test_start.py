"""Kernels draw the start of an episode as Python does, to the bit."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from usv_gym import Fault, SeaState, Vessel
from usv_gym.world.faults import (
    STRUCK,
    Bursts,
    RandomFaults,
    fault_records,
    seed_faults,
    strike,
)
from usv_gym.world.simulation import Simulation
from usv_gym.world.start import FaultSets, is_compiled

SEAS = {
    "calm": SeaState(),
    "wind": SeaState(wind=5.0, gusts="harris", current=0.4, current_to=1.0),
    "two": SeaState.named("2"),
    "fixed waves": SeaState(hs=1.0, wind=8.0, wave_to=0.3, gusts="davenport", components=60),
    "squall": SeaState.named("squall"),
    "spread": SeaState(hs=0.5, wind=5.0, spreading=4.0),
    "jonswap": SeaState(hs=0.5, spectrum="jonswap"),
}

BOATS = {
    "usv75": Vessel.load("usv75"),
    "kvlcc2_l7": Vessel.load("kvlcc2_l7"),
    "no table": Vessel.load("usv75").without_table(),
    "two hulls": Vessel.load("otter").without_table(),
    "table without drift": Vessel.load("otter").with_table(
        dataclasses.replace(Vessel.load("otter").hydro, drift=None)
    ),
}


def begun(simulation: Simulation, seed: int) -> tuple[dict[str, np.random.Generator], int]:
    """Start one boat, and return the generators that it had."""
    simulation.reset([0], [np.random.default_rng(seed)])
    children = np.random.default_rng(seed).spawn(8)
    names = ("waves", "gusts", "gps", "compass", "imu", "faults", "sea", "motion")
    return dict(zip(names, children, strict=True)), int(simulation.worlds["sea"][0])


@pytest.mark.parametrize("boat", BOATS)
@pytest.mark.parametrize("turned", [False, True])
def test_a_started_sea_is_the_one_that_is_realised(boat, turned) -> None:
    vessel, states = BOATS[boat], list(SEAS.values())
    simulation, seen = Simulation(1, vessel, states), set()
    if turned:
        for name, value in (("wind_from", 0.3), ("current_north", 0.2), ("current_east", -0.1)):
            simulation.worlds[name] = value
    given = {"wind_from": 0.3, "current": (0.2, -0.1)} if turned else {}
    for seed in range(40):
        rngs, number = begun(simulation, seed)
        assert number == rngs["sea"].integers(len(states))
        sea = states[number].realise(vessel, rngs["waves"], rngs["gusts"], **given)
        seen.add(number)
        for ours, theirs in ((simulation.waves, sea.waves), (simulation.gusts, sea.gusts)):
            np.testing.assert_array_equal(ours[0, :, : theirs.shape[1]], theirs)
            assert not ours[0, :, theirs.shape[1] :].any()
        for name in sea.weather.dtype.names:
            if name not in ("speed_drift", "from_drift"):  # those are drawn later
                ours, theirs = simulation.weather[0][name], sea.weather[name]
                np.testing.assert_array_equal(ours, theirs, err_msg=name)
    assert len(seen) == len(states)


def test_mean_drift_is_that_of_each_boat_and_sea() -> None:
    """The drift that was summed last is kept: not for another direction."""
    boat, state = BOATS["usv75"], SEAS["two"]
    simulation = Simulation(2, boat, state)
    for wind_from in (0.1, 0.1, 2.0, math.nan, 0.1):
        simulation.worlds["wind_from"] = wind_from
        simulation.reset([0, 1], [np.random.default_rng(k) for k in range(2)])
        turn = {} if math.isnan(wind_from) else {"wind_from": wind_from}
        sea = state.realise(boat, *np.random.default_rng(0).spawn(2), **turn)
        for weather in simulation.weather:
            np.testing.assert_array_equal(weather["drift_table"], sea.weather["drift_table"])


def test_seas_that_python_draws_are_those_beyond_the_common() -> None:
    python = {name for name, state in SEAS.items() if not is_compiled(state)}
    assert python == {"spread", "jonswap"}


SETS = FaultSets(
    [
        [],
        [Fault("gps", 0.0, 10.0), Bursts("imu"), Fault("compass", 3.0, 4.0, effect="frozen")],
        [RandomFaults("all"), RandomFaults("gps", effect="spikes"), Fault("gps", 0.0, 5.0)],
    ],
    [[], [True, False, False], [False, False, True]],
    (10.0, 60.0),
)


def test_started_faults_are_those_that_are_seeded() -> None:
    simulation = Simulation(1, BOATS["usv75"], "2", faults=SETS)
    assert simulation.faults.shape == (1, 3)
    seen = set()
    for seed in range(20):
        rng = begun(simulation, seed)[0]["faults"]
        start, number = rng.uniform(10.0, 60.0), rng.integers(3)
        faults = [
            Fault(fault.kind, start, fault.duration) if moves else fault
            for fault, moves in zip(SETS.sets[number], SETS.moving[number], strict=True)
        ]
        expected = fault_records(faults, simulation.dt)
        seed_faults(expected, faults, rng)
        last, memory = np.zeros(STRUCK), np.zeros((0, 1 + STRUCK))
        strike(0.0, 0, expected, last, memory, np.zeros(STRUCK))  # as the sensors begin
        found = simulation.faults[0]
        assert np.isnan(found["start"][len(faults) :]).all()
        np.testing.assert_array_equal(found[: len(faults)], expected)
        begin = simulation.worlds["fault_start"][0]
        assert begin == start and (number == 0 or f"@{start:.1f}" in SETS.text(number, begin))
        seen.add(int(number))
    assert seen == {0, 1, 2}


def test_a_set_without_faults_is_called_none() -> None:
    assert SETS.text(0, 12.0) == "none" and FaultSets([]).most == 0
