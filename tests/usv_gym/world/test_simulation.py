"""The simulation: many boats are one boat many times; each randomness stands alone."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from usv_gym import Fault, SeaState, SensorSuite, Vessel
from usv_gym.physics import frames as fr
from usv_gym.world.simulation import Simulation, SimulationError
from usv_gym.world.start import FaultSets

BOAT = Vessel.load("usv75")
SEA = SeaState.named("2").replace(current=0.4, current_to=1.0)
STEPS = 612
CMD = np.random.default_rng(9).uniform([5, 5, -0.4, -0.4], [25, 25, 0.4, 0.4], (STEPS, 4))


GPS_LOSS = FaultSets([[Fault("gps", 0.0, 3.0)]], [[True]], (2.0, 8.0))


def run(seed: int = 3, steps: int = STEPS, **kwargs: object) -> tuple[np.ndarray, np.ndarray]:
    """Return the true states and measurements of one boat."""
    sim = Simulation(1, BOAT, kwargs.pop("sea", SEA), **kwargs)  # type: ignore[arg-type]
    sim.reset([0], [np.random.default_rng(seed)])
    states, z = [sim.state[0].copy()], [sim.z[0].copy()]
    for k in range(steps):
        sim.step(CMD[k][None])
        states.append(sim.state[0].copy())
        z.append(sim.z[0].copy())
    return np.array(states), np.array(z)


def test_a_seed_is_a_run() -> None:
    states, z = run()
    again, z_again = run()
    np.testing.assert_array_equal(states, again)
    np.testing.assert_array_equal(z, z_again)
    other, z_other = run(seed=4)
    assert np.all(states[1:, fr.X] != other[1:, fr.X])
    assert np.all(z[5:, 5] != z_other[5:, 5])


def test_sensors_do_not_move_the_boat() -> None:
    states, _ = run()
    perfect, _ = run(suite=SensorSuite.perfect())
    np.testing.assert_array_equal(states, perfect)
    faulty, _ = run(faults=GPS_LOSS)
    np.testing.assert_array_equal(states, faulty)


def test_it_starts_straight_ahead_at_its_speed() -> None:
    states, _ = run(sea=SeaState(), steps=0)
    n = BOAT.values["shaft_speed_manoeuvring"]
    expected = np.zeros(fr.STATE_SIZE)
    expected[fr.U] = BOAT.straight_speed(n)
    expected[fr.N_LEFT : fr.N_RIGHT + 1] = n
    np.testing.assert_array_equal(states[0], expected)


@pytest.mark.parametrize("dof", [3, 6])
def test_it_starts_at_rest_where_it_is_put(dof: int) -> None:
    simulation = Simulation(1, BOAT, "2", dof=dof)
    rng = np.random.default_rng(0)
    simulation.reset([0], [rng], speed=0.0, heading=1.2, at=(40.0, -30.0))
    state = simulation.state[0]
    assert state[[fr.X, fr.Y, fr.PSI]].tolist() == [40.0, -30.0, 1.2]
    assert not state[[fr.U, fr.V, fr.R]].any() and not state[fr.N_LEFT :].any()
    assert not simulation.cmd.any()
    assert bool(state[fr.Z]) == (dof == 6)  # on the waves of that place


def test_it_starts_at_a_speed_that_it_keeps() -> None:
    simulation = Simulation(1, BOAT, SeaState())
    simulation.reset([0], [np.random.default_rng(0)], speed=3.0, heading=-1.0)
    for _ in range(200):
        simulation.step(simulation.cmd)
    assert simulation.state[0, fr.U] == pytest.approx(3.0, rel=1e-6)
    assert simulation.state[0, fr.PSI] == -1.0


def test_the_start_leaves_sea_and_noise_as_they_were() -> None:
    one, two = (Simulation(1, BOAT, "3") for _ in range(2))
    one.reset([0], [np.random.default_rng(5)])
    two.reset([0], [np.random.default_rng(5)], speed=0.0, at=(5.0, 5.0))
    np.testing.assert_array_equal(one.waves, two.waves)
    np.testing.assert_array_equal(one.z[0, 6:8], two.z[0, 6:8])


def test_shorter_physics_steps_change_little() -> None:
    coarse, _ = run(sea=SeaState(), steps=100)
    fine, _ = run(sea=SeaState(), steps=100, dt_physics=0.01)
    # calm water, 5 s with a new random command each step: RK4's error where it is not smooth
    np.testing.assert_allclose(fine, coarse, atol=5e-3)
    assert np.any(fine != coarse)


@pytest.mark.parametrize(("vessel", "sea"), [("usv75", "4"), ("otter", "2"), ("wamv16", "3")])
def test_six_degrees_begin_on_the_surface_of_the_sea(vessel: str, sea: str) -> None:
    """No fall into the sea: the first seconds are like those that follow."""
    first, later = [], []
    for seed in range(4):
        simulation = Simulation(1, Vessel.load(vessel), SeaState.named(sea), dof=6)
        simulation.reset([0], [np.random.default_rng(seed)])
        heave = [simulation.state[0, fr.W]]
        for _ in range(600):
            simulation.step(simulation.cmd)
            heave.append(simulation.state[0, fr.W])
        jerk = np.abs(np.diff(heave)) / simulation.dt
        first.append(np.max(jerk[:60]))
        later.append(np.max(jerk[200:]))
    assert np.mean(first) < 1.5 * np.mean(later)


def test_the_imu_reports_the_mean_of_the_whole_control_step() -> None:
    """Also where that is cut into several steps of integration."""
    simulation = Simulation(
        1,
        BOAT,
        SeaState.named("3"),
        suite=SensorSuite.perfect(),
        dof=6,
        dt=0.1,
        dt_physics=0.0125,
    )
    simulation.reset([0], [np.random.default_rng(1)])
    for _ in range(100):
        before = simulation.state[0].copy()
        simulation.step(simulation.cmd)
        mean = simulation.boats["mean_rate"][0]
        change = (simulation.state[0] - before) / simulation.dt
        np.testing.assert_allclose(mean, change, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: Simulation(0, BOAT, SEA), "n = 0"),
        (lambda: Simulation(1, BOAT, SEA, dt=0.05, dt_physics=0.03), "dt_physics = 0.03"),
        (lambda: Simulation(1, BOAT, SEA, dt=0.05, dt_physics=0.0), "dt_physics = 0.0"),
        (lambda: Simulation(1, BOAT, SEA, dt=math.inf), "dt = inf"),
        (lambda: Simulation(1, BOAT, SEA, faults="gps10"), "parse_faults"),
        (lambda: Simulation(1, "usv75", "calm").step(np.zeros((1, 4))), "call reset"),
        (lambda: Simulation(2, BOAT, SEA).reset([2], [np.random.default_rng(0)]), "from 0 to 1"),
        (lambda: Simulation(1, BOAT, SEA).reset([0], [0]), "default_rng"),
        (lambda: Simulation(1, BOAT, SEA).reset([], [], speed=99.0), "speed = 99.0: must be"),
        (lambda: Simulation(1, BOAT, SEA).reset([], [], heading=9.0), "heading = 9.0"),
        (lambda: Simulation(1, BOAT, SEA).reset([], [], at=(1.0,)), "m north and east"),
    ],
)
def test_what_a_simulation_cannot_do_is_reported(call: Callable[[], object], words: str) -> None:
    with pytest.raises(SimulationError, match=words):
        call()


@pytest.mark.parametrize("cmd", [np.zeros(4), np.full((1, 4), math.nan), np.zeros((2, 4))])
def test_a_bad_command_changes_nothing(cmd: np.ndarray) -> None:
    simulation = Simulation(1, "usv75", "2", suite="best")
    simulation.reset([0], [np.random.default_rng(0)])
    before = simulation.rows.copy()
    with pytest.raises(SimulationError, match=r"finite numbers of shape \(1, 4\)"):
        simulation.step(cmd)
    np.testing.assert_array_equal(simulation.rows, before)
