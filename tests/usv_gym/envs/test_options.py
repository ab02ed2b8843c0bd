"""Every keyword of gym.make and gym.make_vec: what is wrong is named, what is taken sails."""

import copy
import dataclasses
import inspect
import math
import signal
import subprocess
import sys
import time
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec

import usv_gym
from twin.sim.wrapper import make_env, make_vector_env
from usv_gym import SeaState
from usv_gym.envs.config import EnvConfig
from usv_gym.envs.env import USVEnv
from usv_gym.envs.tasks import TASKS
from usv_gym.envs.vector import USVVectorEnv
from usv_gym.world.faults import FaultError
from usv_gym.world.sensors import SensorSuite
from usv_kernel.errors import UsvTwinError

SEVERAL, RANGE = (1, 2, 3, 4), range(3)

WRONG = [
    *(-1, -0.5, 1e300, -1e300, math.nan, math.inf, -math.inf, 2**70, 10**400, 1j, b"x", "\0"),
    *("x", "", "nan", "../x", "a" * 5000, [1], [[1]], SEVERAL, {"a": 1}, {1, 2}, RANGE),
    *(object(), len, np.array([1.0, 2.0]), np.full(2, np.nan)),
]
"""No keyword takes these, but for those in TAKEN."""

ODD = [
    *(*WRONG, None, True, False, 0, 1, 3, 0.5, 1e-12, 5e-324, 1e-308, 1e9, [], {}, ()),
    *(np.array(1.0), np.float32(0.05), np.int64(3)),
]
"""What a keyword may take or refuse, but must not choke on."""

TAKEN = {
    "wind_from_deg": (-1, -0.5),
    "heading_deg": (-1, -0.5),
    "sea": (SEVERAL, RANGE, *WRONG[17:18]),
}
"""Exceptions: degrees below 0, and several seas."""

GYMNASIUM = {"max_episode_steps"}
"""What gym.make itself checks, with an error of its own that names it."""


def keywords(*functions) -> set[str]:
    """Return the named arguments of functions."""
    kinds = inspect.Parameter.KEYWORD_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD
    found = (p for f in functions for p in inspect.signature(f).parameters.values())
    return {p.name for p in found if p.kind in kinds} - {"self", "observer"}


SINGLE = sorted(keywords(make_env, USVEnv.__init__) | set(EnvConfig.names()))
MANY = sorted(keywords(make_vector_env, USVVectorEnv.__init__) | set(EnvConfig.names()))
OF_ONE = sorted(set(SINGLE) - set(EnvConfig.names()) - GYMNASIUM)
"""What single environments check themselves; the rest is checked for them and many at once."""


def make(many: bool, **options):
    if many:
        return gym.make_vec("USVTwin-v0", **{"num_envs": 2, "twin": None, **options})
    return gym.make("USVTwin-v0", **{"twin": None, **options})


def sails(env, steps: int) -> None:
    """Sail straight on, and check every observation and reward."""
    observation = env.reset(seed=1)[0]
    action = np.zeros(env.action_space.shape, np.float32)
    for _ in range(steps):
        assert env.observation_space.contains(observation) and np.isfinite(observation).all()
        observation, reward = env.step(action)[:2]
        assert np.isfinite(reward).all()
    env.close()


def named(error: UsvTwinError, name: str) -> bool:
    words = {"faults": "fault", "suite": "sensor", "twin": "predictor"}
    text = str(error)
    return (name in text or words.get(name, name) in text) and len(text) <= 1500


def made_or_named(make, name: str):
    """Return what could be made; None where an error names the keyword."""
    try:
        return make()
    except UsvTwinError as error:
        if not named(error, name):
            raise
    return None


@pytest.mark.parametrize(
    ("name", "many"), [*((name, True) for name in MANY), *((name, False) for name in OF_ONE)]
)
def test_what_is_wrong_is_named_and_what_is_taken_sails(name, many):
    for value in ODD:
        made = made_or_named(lambda value=value: make(many, **{name: value}), name)
        if made is not None:
            taken = any(value is one for one in TAKEN.get(name, ()))
            assert taken or not any(value is one for one in WRONG), value
            sails(made, 10)


@pytest.mark.parametrize("kind", [SeaState, SensorSuite])
def test_fields_of_seas_and_sensors_are_named_or_sail(kind):
    option = "sea" if kind is SeaState else "suite"
    for item in dataclasses.fields(kind):
        for value in ODD:
            made = made_or_named(lambda f=item.name, v=value: kind(**{f: v}), item.name)
            if made is not None:
                sails(make(False, **{option: made}), 5)


@pytest.mark.parametrize("hs", [5e-324, 1e-308, 1e-12, 1e-7])
def test_heights_and_winds_of_nothing_are_calm(hs):
    calm = make(False, hs=0.0, wind=0.0)
    tiny = make(False, hs=hs, wind=hs)
    for env in (calm, tiny):
        env.reset(seed=3)
    for _ in range(50):
        a, b = (env.step(np.zeros(2, np.float32))[0] for env in (calm, tiny))
        np.testing.assert_array_equal(a, b)


LONG = """
import sys, numpy as np, gymnasium as gym, usv_gym
env = gym.make_vec("USVTwin-v0", num_envs=400, twin=None, sea="4", dt=1.0, dt_physics=1e-3)
env.reset(seed=1)
print("begun", flush=True)
for _ in range(1000):
    env.step(np.zeros(env.action_space.shape, np.float32))
"""


def test_ctrl_c_is_heard_in_a_step_of_many_boats():
    """One step takes minutes: 400 boats of 1000 integration steps each, in waves."""
    with subprocess.Popen(
        [sys.executable, "-c", LONG], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout.readline() == "begun\n"
        time.sleep(3.0)
        assert process.poll() is None
        process.send_signal(signal.SIGINT)
        complaint = process.communicate(timeout=30)[1]
    assert "KeyboardInterrupt" in complaint and process.returncode != 0


def test_parts_of_a_long_step_change_no_bit(monkeypatch):
    """Boats are stepped in parts where a step is long; the parts do not matter."""
    runs = []
    for work in (20_000, 3):
        monkeypatch.setattr("usv_gym.world.simulation.WORK_MAX", work)
        env = gym.make_vec("USVTwin-v0", num_envs=5, twin="ukf", sea="3")
        assert len(env.unwrapped.episodes.blocks) == (1 if work > 5 else 2)
        seen = [env.reset(seed=4)[0].copy()]
        seen += [env.step(np.full((5, 2), 0.3, np.float32))[0].copy() for _ in range(40)]
        runs.append(np.array(seen))
    np.testing.assert_array_equal(*runs)


@pytest.mark.parametrize(
    "faults",
    [
        [usv_gym.Fault("gps", start=5.0, duration=10.0)],
        usv_gym.Fault("compass", 5.0, 3.0, effect="bias", amount=0.2),
        [usv_gym.RandomFaults("imu", effect="spikes", gap=(2.0, 6.0)), usv_gym.Bursts("gps")],
    ],
)
def test_an_environment_with_faults_is_made_again_from_the_json_of_its_spec(faults: Any) -> None:
    others = {"twin": "persistence", "task": "free", "band_period": 2.0, "sea": SeaState(hs=0.7)}
    env = gym.make("USVTwin-v0", faults=faults, **others)
    spec = EnvSpec.from_json(env.spec.to_json())  # type: ignore[union-attr]
    again = gym.make(spec)
    for one in (env, again):
        one.reset(seed=3)
    for _ in range(200):
        action = env.action_space.sample()
        np.testing.assert_array_equal(env.step(action)[0], again.step(action)[0])


def test_sensors_and_numbers_of_numpy_are_made_again_from_the_json_of_a_spec() -> None:
    suite = SensorSuite(gps_white=0.7, gps_arm=(0.5, 0.0, -1.0))
    env = make(False, suite=suite, load=np.float32(0.75), frame_skip=np.int64(2))
    again = gym.make(EnvSpec.from_json(env.spec.to_json()))  # type: ignore[union-attr]
    assert again.unwrapped.simulation.suite == suite
    assert again.unwrapped.episodes.frame_skip == 2
    with pytest.raises(UsvTwinError, match="gps_wite"):
        make(False, suite={"gps_wite": 0.7})


@pytest.mark.parametrize("vector", [False, True])
@pytest.mark.parametrize("name", ["vessel", "task"])
def test_a_spec_with_an_object_that_has_no_json_names_the_remedy(name: str, vector: bool) -> None:
    given: Any = usv_gym.Vessel.load("otter") if name == "vessel" else TASKS["station"]
    env = make(vector, **{name: given})
    for one in (env, copy.deepcopy(env)):
        with pytest.raises(UsvTwinError, match=rf"{name}.*name or file.*module:Class"):
            one.spec.to_json()


def test_a_table_that_is_no_fault_is_refused() -> None:
    with pytest.raises(FaultError, match="needs all fields of a fault"):
        gym.make("USVTwin-v0", twin=None, faults=[{"kind": "gps"}])
