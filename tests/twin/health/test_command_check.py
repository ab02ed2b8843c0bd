"""The check of the commands: right ones at any rate of rows, idle boats, and stops."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twin import Twin
from twin.logs.log import Log
from twin.sim.bridge import CONTROL_STEP, particulars_of, prepare, sail, simulate
from usv_gym import SeaState, Vessel
from usv_gym.world.simulation import Simulation

few = settings(max_examples=8, derandomize=True)

SEAS = {"usv75": 0.5, "otter": 0.06, "wamv16": 0.2}
"""Significant wave heights that the boats meet, m."""

STOP = 90.0
"""When the commands become zero, s."""


def sea_of(vessel: str) -> SeaState:
    return SeaState(hs=SEAS[vessel], wind=4.5)


@functools.cache
def survey(vessel: str, seed: int) -> Log:
    """Return a lawn mower that an autopilot sails."""
    boat = Vessel.load(vessel)
    return simulate("mission", vessel=boat, sea=sea_of(vessel), duration=300.0, seed=seed)


def command_notes(vessel: str, rows) -> list[str]:
    twin = Twin(particulars_of(Vessel.load(vessel)), "ukf")
    for t, z, cmd in rows:
        twin.step(t, z.copy(), cmd.copy())
    return [note for note in twin.notes if note.startswith("commands")]


@few
@given(
    st.sampled_from(tuple(SEAS)),
    st.integers(50, 53),
    st.sampled_from((1, 2, 4, 5, 10)),
    st.integers(0, 4),
)
def test_right_commands_of_an_autopilot_raise_nothing_at_any_rate(vessel, seed, every, first):
    rows = list(survey(vessel, seed).without_truth())[first::every]
    assert not command_notes(vessel, rows)


@pytest.mark.parametrize("seed", range(50, 56))
def test_right_commands_of_an_otter_raise_nothing_at_4_hz(seed):
    rows = list(survey("otter", seed).without_truth())[::5]
    assert not command_notes("otter", rows)


@few
@given(st.integers(8, 14), st.floats(60.0, 120.0), st.integers(0, 3))
def test_idle_time_teaches_nothing_of_the_commands(driven, idle, seed):
    # ten seconds of turning on the spot, a long rest, and then the boat sails
    vessel = Vessel.load("otter")
    nominal = particulars_of(vessel).shaft_speed
    commands = np.zeros((round((driven + idle + 60.0) / CONTROL_STEP), 4))
    t = np.arange(len(commands)) * CONTROL_STEP
    commands[t < driven, :2] = 0.7 * nominal, -0.6 * nominal
    commands[t > driven + idle, :2] = nominal
    twin = Twin(particulars_of(vessel), "ukf")
    log = simulate(commands, vessel=vessel, sea=SeaState(hs=0.02), duration=1.0, seed=seed)
    health, steps = twin.monitor.record, []
    for now, z, cmd in log.without_truth():
        twin.step(now, z.copy(), cmd.copy())
        if driven + 20.0 < now < driven + idle:
            steps.append((health["steps"], *health["filters"]["x"][0, :, 1:].ravel()))
        assert health["sensors"]["status"][-1] < 2 or now < 1.0
    assert np.ptp(steps, axis=0).max() == 0.0


@functools.cache
def stopped(vessel: str, manoeuvre: str, seed: int, reaches: bool) -> tuple:
    """Return a run with commands that become zero, and whether the boat gets them too."""
    simulation = Simulation(1, Vessel.load(vessel), sea_of(vessel), dt=CONTROL_STEP)
    run = prepare(simulation, manoeuvre, STOP + 20.0, seed)

    def stop(t, _, command):
        if reaches and t >= STOP - 1e-6:
            command[:2] = 0.0

    rows = [(t, z.copy(), cmd.copy()) for t, z, cmd in sail(run, stop).without_truth()]
    for t, _, cmd in rows:
        if t > STOP + 1e-6:
            cmd[:2] = 0.0
    return tuple(rows)


@few
@given(
    st.sampled_from(tuple(SEAS)),
    st.sampled_from(("zigzag", "random", "mission")),
    st.integers(0, 3),
)
def test_boat_that_stops_as_commanded_raises_nothing(vessel, manoeuvre, seed):
    assert not command_notes(vessel, stopped(vessel, manoeuvre, seed, True))


@pytest.mark.parametrize(("vessel", "within"), [("usv75", 4.0), ("otter", 5.0), ("wamv16", 7.0)])
def test_zero_commands_of_a_boat_that_sails_on_are_named(vessel, within):
    delays = []
    for seed in range(5):
        twin = Twin(particulars_of(Vessel.load(vessel)), "ukf")
        first = np.inf
        for t, z, cmd in stopped(vessel, "zigzag", seed, False):
            twin.step(t, z.copy(), cmd.copy())
            if t > STOP and first == np.inf and twin.health["commands"].status != "ok":
                first = t - STOP
        delays.append(first)
    assert np.median(delays) < within


@pytest.mark.parametrize("every", [1, 10, 20])
@pytest.mark.parametrize("vessel", ["usv75", "otter"])
def test_zero_commands_are_not_trusted_while_the_boat_sails_on(vessel, every):
    for seed in range(2):
        twin = Twin(particulars_of(Vessel.load(vessel)), "ukf")
        for t, z, cmd in list(stopped(vessel, "zigzag", seed, False))[::every]:
            twin.step(t, z.copy(), cmd.copy())
            if t > STOP and twin.health["commands"].status != "ok":
                assert twin.monitor.trusted(cmd)[:2].all()
