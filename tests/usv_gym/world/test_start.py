"""What the start of an episode draws: its sea, and its faults."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from tests.usv_gym.world.seas import realise
from usv_gym import Fault, SeaState, Vessel
from usv_gym.hydro.table import between
from usv_gym.physics import GRAVITY, waves
from usv_gym.world.faults import (
    STRUCK,
    Bursts,
    RandomFaults,
    fault_records,
    seed_faults,
    strike,
)
from usv_gym.world.simulation import Simulation
from usv_gym.world.start import FaultSets

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
def test_a_sea_comes_from_the_generators_of_its_boat(boat, turned) -> None:
    """Which one, its phases and frequencies, and where wind, current and waves go."""
    vessel, states = BOATS[boat], list(SEAS.values())
    simulation, seen = Simulation(1, vessel, states), set()
    if turned:
        for name, value in (("wind_from", 0.3), ("current_north", 0.2), ("current_east", -0.1)):
            simulation.worlds[name] = value
    for seed in range(40):
        rngs, number = begun(simulation, seed)
        assert number == rngs["sea"].integers(len(states))
        seen.add(number)
        state, sea = states[number], simulation.sea(0)
        within, turns = rngs["waves"].random((2, sea.waves.shape[1]))
        np.testing.assert_allclose(sea.waves[waves.PHASE], math.tau * turns, rtol=1e-15)
        assert sea.waves.shape[1] == (state.components if state.hs > 0.0 else 0)
        wind_from = 0.3 if turned else state.wind_from
        current = state.current * np.exp(1j * state.current_to) if not turned else 0.2 - 0.1j
        assert complex(sea.weather["current_north"], sea.weather["current_east"]) == current
        if not state.schedule:
            assert sea.weather["wind_from"][0] == pytest.approx(wind_from, rel=1e-12)
        if state.hs == 0.0:
            continue
        if state.is_closed_form:
            # energy below a frequency: S = A omega^-5 exp(-B omega^-4), A = .0081 g^2, B = 4 A/hs^2
            share = np.exp(-0.0324 * (GRAVITY / state.hs) ** 2 / sea.waves[waves.OMEGA] ** 4)
            bins = (np.arange(state.components) + within) / state.components
            np.testing.assert_allclose(share, bins, rtol=1e-9)
        north, east = sea.waves[[waves.K_NORTH, waves.K_EAST]]
        to = wind_from + math.pi if state.wave_to is None else state.wave_to
        if state.spreading is None and not state.schedule:
            np.testing.assert_allclose(np.exp(1j * np.arctan2(east, north)), np.exp(1j * to))
    assert len(seen) == len(states)


def test_a_changed_sea_is_one_of_its_own_wind_and_current() -> None:
    simulation = Simulation(1, "usv75", "0", changing=True)
    simulation.worlds["wind_from"], simulation.worlds["current_north"] = 0.3, 0.2
    simulation.reset([0], [np.random.default_rng(0)])
    simulation.change_sea(0, SEAS["spread"], np.random.default_rng(1))
    sea = simulation.sea(0)
    assert sea.weather["current_north"] == 0.0
    assert sea.weather["wind_from"][0] == SEAS["spread"].wind_from
    assert sea.waves.shape[1] == SEAS["spread"].components


def test_mean_drift_is_that_of_each_boat_and_sea() -> None:
    """The drift that was summed last is kept: not for another direction."""
    boat, state = BOATS["usv75"], SEAS["two"]
    simulation = Simulation(2, boat, state)
    for wind_from in (0.1, 0.1, 2.0, math.nan, 0.1):
        simulation.worlds["wind_from"] = wind_from
        simulation.reset([0, 1], [np.random.default_rng(k) for k in range(2)])
        alone = state if math.isnan(wind_from) else state.turned(wind_from)
        for weather in simulation.weather:
            found, own = weather["drift_table"], realise(alone, 9, boat).weather["drift_table"]
            np.testing.assert_allclose(found, own, rtol=1e-12)


def test_drift_of_spread_waves_is_that_of_the_waves_each() -> None:
    """Beside a sum over the table, wave by wave."""
    vessel, state = BOATS["usv75"], SEAS["spread"].replace(wave_to=0.4)
    found = realise(state, 0, vessel).weather["drift_table"]
    omega, amplitude, aside = state.drift_waves
    table, wanted = vessel.hydro, np.zeros((len(found), 3))
    scale = vessel.values["length_waterline"] / table.length
    drift = between(omega * math.sqrt(scale), table.omega, table.drift_around)
    drift *= (np.minimum(omega * math.sqrt(scale) / table.omega[0], 1.0) ** 4)[:, None, None]
    lobes = np.fft.fft(drift, axis=1) / drift.shape[1]
    for h in range(len(found)):
        angle = 0.4 + aside - math.tau * h / len(found)
        order = np.fft.fftfreq(drift.shape[1], 1.0 / drift.shape[1])
        turned = np.real(np.sum(lobes * np.exp(1j * np.outer(angle, order))[:, :, None], axis=1))
        wanted[h] = scale ** np.array([1, 1, 2]) * np.sum(amplitude[:, None] ** 2 * turned, axis=0)
    np.testing.assert_allclose(found, wanted, atol=0.01 * np.abs(wanted).max())


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
