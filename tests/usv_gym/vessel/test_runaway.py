"""Vessels whose motion runs away are found and refused."""

import dataclasses
import re
from importlib import resources
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from usv_gym.design.checks import inspect
from usv_gym.vessel.runaway import check_motion
from usv_gym.vessel.vessel import Vessel, VesselError, vessel_names
from usv_gym.world.simulation import Simulation, SimulationError

NUMBER = re.compile(r"(\w+) = \{ value = (-?[\d.eE+-]+)")

DRAG = {"usv75": ("D_uu", 3e6), "kvlcc2_l7": ("N_rrr", -3e3), "wamv16": ("C_d_crossflow", 4e4)}


def changed(name: str, key: str, value: float) -> Vessel:
    boat = Vessel.load(name)
    return dataclasses.replace(boat, values={**boat.values, key: value}, design="")


def step(env, count: int) -> None:
    for _ in range(count):
        env.step(np.zeros(env.action_space.shape, np.float32))


def sail(boat: Vessel, dof: int, seconds: float) -> np.ndarray:
    """Return the state after hard manoeuvres in sea 4."""
    simulation = Simulation(1, boat, "4", dof=dof)
    simulation.reset([0], [np.random.default_rng(1)])
    n = boat.values["shaft_speed_max"]
    helms = (n, boat.helm_max), (-n, boat.helm_max), (n, -boat.helm_max)
    for k in range(round(seconds / simulation.dt)):
        simulation.step(boat.command(*helms[k // 100 % 3])[None])
    return simulation.state[0]


@pytest.mark.parametrize("dof", [3, 6])
@pytest.mark.parametrize("name", vessel_names())
def test_shipped_vessels_and_their_like_do_not_run_away(name, dof):
    boat = Vessel.load(name)
    check_motion(boat, dof, 0.05)
    for seed in range(2):
        check_motion(boat.varied(np.random.default_rng(seed), 0.15), dof, 0.05)


@pytest.mark.parametrize("name", DRAG)
def test_too_much_drag_is_refused_everywhere(name):
    boat = changed(name, *DRAG[name])
    for make in (
        lambda: gym.make("USVTwin-v0", vessel=boat),
        lambda: gym.make_vec("USVTwin-v0", num_envs=2, vessel=boat),
        lambda: Simulation(1, boat, "2"),
    ):
        with pytest.raises(VesselError, match=f"{name}: the motion runs away .* units and signs"):
            make()
    assert any("runs away" in finding.text for finding in inspect(boat).errors)


def test_inertia_that_only_waves_would_show_is_refused():
    boat = changed("kvlcc2_l7", "I_yy", 514.0 * Vessel.load("kvlcc2_l7").values["I_yy"])
    with pytest.raises(VesselError, match="6 degrees of freedom"):
        check_motion(boat, 6, 0.05)


def test_a_stiff_vessel_sails_with_the_step_that_the_message_names():
    boat = changed("otter", "D_rr", 1.5e4)
    with pytest.raises(VesselError, match="stays bounded") as caught:
        check_motion(boat, 3, 0.05)
    step = float(str(caught.value).split("stays bounded with dt_physics = ")[1].split()[0])
    assert 0.0 < step < 0.05
    check_motion(boat, 3, step)
    simulation = Simulation(1, boat, "2", dt_physics=step)
    simulation.reset([0], [np.random.default_rng(0)])
    for _ in range(200):
        simulation.step(boat.command(10.0, boat.helm_max)[None])
    assert np.isfinite(simulation.state).all()


def test_a_state_that_diverges_is_an_error(monkeypatch):
    for target in (
        lambda: gym.make("USVTwin-v0", dof=6),
        lambda: gym.make_vec("USVTwin-v0", num_envs=3),
        lambda: gym.make_vec("USVTwin-v0", num_envs=4, vectorization_mode="vector_entry_point"),
    ):
        env = target()
        env.reset(seed=1)
        unwrapped = env.unwrapped
        episodes = unwrapped.episodes
        episodes.simulation.state[-1, 6] = 1e308
        with pytest.raises(SimulationError, match=r"boat \d \(usv75\) ran away after 0.05 s"):
            step(env, 3)
        env.reset(seed=1)
        step(env, 1)
        env.close()


@pytest.mark.parametrize(("count", "seed"), [(40, 3), pytest.param(300, 1, marks=pytest.mark.slow)])
def test_mutated_vessels_are_refused_or_sail(count: int, seed: int, tmp_path: Path) -> None:
    """One number of a shipped file is multiplied by up to a million, turned round or zero."""
    rng = np.random.default_rng(seed)
    refused = sailed = late = 0
    for _ in range(count):
        name = str(rng.choice(vessel_names()))
        text = resources.files("usv_gym.vessel").joinpath("vessels", f"{name}.toml").read_text()
        numbers = list(NUMBER.finditer(text))
        chosen = numbers[int(rng.integers(len(numbers)))]
        factor = (10.0 ** rng.uniform(-6, 6), 10.0 ** rng.uniform(0, 7), -1.0, 0.0)
        value = float(chosen[2]) * factor[int(rng.integers(4))]
        (tmp_path / "mutant.toml").write_text(
            f"{text[: chosen.start(2)]}{value!r}{text[chosen.end(2) :]}"
        )
        try:
            boat = Vessel.load(tmp_path / "mutant.toml")
        except VesselError:
            continue
        for dof in (3, 6):
            try:
                state = sail(boat, dof, 60.0)
            except VesselError:
                refused += 1
                continue
            except SimulationError:
                late += 1
                continue
            sailed += 1
            assert np.isfinite(state).all()
    assert sailed > 0.5 * count and refused > 0.05 * count
    assert late <= 3 + 0.02 * count  # grows over half a minute; no row was written
