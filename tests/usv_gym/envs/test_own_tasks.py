"""Tasks of one's own, weights of the reward, and docking."""

import math
import sys
from pathlib import Path

import numpy as np
import pytest

from usv_gym.envs.env import USVEnv
from usv_gym.envs.scoring import ALONGSIDE, FAILURE_COST, TaskError
from usv_gym.envs.tasks import Docking, PathFollowing, Score, Task
from usv_gym.physics import frames as fr
from usv_kernel.errors import UsvTwinError

EXAMPLES = Path(__file__).resolve().parents[3] / "examples"


class Line(Task):
    """Sail north for some lengths; rated by the way made good."""

    terms = ("north", "change")
    legs = 1

    def path(self, rng):
        return np.array([[0.0, 0.0], [rng.uniform(5.0, 9.0) * self.length, 0.0]])

    def score(self, step):
        done = step.errors[:, 1] < 0.0
        change = np.abs(step.action[:, 0] - step.before[:, 0])
        north = step.state[:, fr.U] * np.cos(step.state[:, fr.PSI])
        return Score({"north": north / self.speed, "change": -change}, done, done)


def begin(env: USVEnv) -> None:
    env.reset(seed=0)
    env.step([0.0, 0.0])


@pytest.fixture
def orbit(monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.syspath_prepend(str(EXAMPLES))
    yield "orbit_task:Orbit"
    sys.modules.pop("orbit_task", None)


def test_rewards_of_an_own_task_are_what_its_file_says() -> None:
    env = USVEnv(task=Line, sea="0", reward_weights={"north": 2.0})
    env.reset(seed=0)
    last, total = env.episodes.nominal_action[0], 0
    for k in range(400):
        action = np.array([0.9, 0.0]) if k % 3 else np.array([0.5, 0.0])
        _, reward, terminated, _, info = env.step(action)
        state = env.simulation.state[0]
        north = 2.0 * state[fr.U] * math.cos(state[fr.PSI]) / env.speed
        change = -abs(action[0] - last)
        assert info["reward_terms"] == pytest.approx({"north": north, "change": change})
        assert reward == pytest.approx(north + change)
        last, total = action[0], k
        if terminated:
            break
    assert terminated and info["is_success"] and 50 < total < 390
    assert env.simulation.state[0, fr.X] == pytest.approx(env.task.points[0, 1, 0], abs=0.5)


def test_an_own_task_is_found_by_module_and_class(orbit) -> None:
    env = USVEnv(task=orbit)
    assert type(env.task).__name__ == "Orbit" and env.task.is_own
    env.reset(seed=1)
    terms = env.step([0.8, 0.0])[-1]["reward_terms"]
    assert tuple(terms) == ("progress", "distance", "effort", "failure")


WRONG_TASKS = {
    "shape": {"path": lambda self, rng: np.zeros((3, 2))},
    "must draw its path": {},
    "the terms north, change": {"score": lambda self, step: Score({}, step.t > 0, step.t > 0)},
    "is not finite": {
        "score": lambda self, step: Score(
            {"north": step.t * math.nan, "change": step.t}, step.t > 0, step.t > 0
        )
    },
    "gave None": {"score": lambda self, step: None},
}


@pytest.mark.parametrize("message", WRONG_TASKS)
def test_wrong_tasks_are_named(message) -> None:
    base = Task if message == "must draw its path" else Line
    env = USVEnv(task=type("Wrong", (base,), WRONG_TASKS[message]))
    with pytest.raises(TaskError, match=message):
        begin(env)


def test_tasks_that_cannot_be_found_are_named() -> None:
    for wrong in ("no_module_of_this_name:Task", "math:pi", "math:", "pth", int):
        with pytest.raises(TaskError, match=r"module:Class"):
            USVEnv(task=wrong)
    with pytest.raises(TaskError, match="rates its steps itself"):
        USVEnv(task=Line, dof=6, motion_penalty=0.5)
    many = type("Many", (Line,), {"terms": tuple("abcdefghi")})
    with pytest.raises(TaskError, match="9 terms; use 8"):
        USVEnv(task=many)


def test_weights_multiply_parts_of_the_reward() -> None:
    plain = USVEnv(sea="3")
    weighted = USVEnv(sea="3", reward_weights={"cross_track": 3.0, "progress": 0.0})
    for env in (plain, weighted):
        env.reset(seed=4)
    for _ in range(60):
        one, other = (env.step([0.6, 0.4]) for env in (plain, weighted))
        terms, more = one[-1]["reward_terms"], other[-1]["reward_terms"]
        assert more["cross_track"] == 3.0 * terms["cross_track"] and more["progress"] == 0.0
        assert more["effort"] == terms["effort"]
        assert other[1] == pytest.approx(sum(more.values()), abs=1e-12)
    still = USVEnv(dof=6, task="seakeeping", reward_weights={"motion": 2.0})
    plain = USVEnv(dof=6, task="seakeeping")
    pair = []
    for env in (still, plain):
        env.reset(seed=0)
        pair.append(env.step([0.7, 0.0])[-1]["reward_terms"]["motion"])
    assert pair[0] == pytest.approx(2.0 * pair[1]) and pair[1] < 0.0


def test_wrong_weights_are_refused() -> None:
    for wrong in (
        {"cross": 1.0},
        {"effort": -1.0},
        {"effort": math.nan},
        {"motion": 1.0},
        3.0,
        "x",
    ):
        with pytest.raises(UsvTwinError, match="reward_weights"):
            USVEnv(reward_weights=wrong)


# ------------------------------------------------- docking
def at_berth(env: USVEnv, ahead: float, angle: float, speed: float) -> tuple:
    """Put the boat on its last leg, so far before the berth (m), and take a step."""
    env.reset(seed=2)
    start, berth = env.task.points[0, 1:]
    course = math.atan2(*(berth - start)[::-1])
    place = berth - ahead * np.array([math.cos(course), math.sin(course)])
    state = env.simulation.state[0]
    state[[fr.X, fr.Y]], state[fr.PSI] = place, course + angle
    state[[fr.U, fr.V, fr.R]] = speed, 0.0, 0.0
    state[fr.N_LEFT :] = 0.0
    env.task.records["leg"][0] = 1.0
    return env.step([0.0, 0.0])


@pytest.mark.parametrize("vessel", ["usv75", "otter"])
def test_docked_is_at_the_berth_along_it_and_at_rest(vessel) -> None:
    env = USVEnv(task="docking", sea="0", vessel=vessel)
    length, rest = env.task.length, float(env.task.rules["rest"])
    assert rest == pytest.approx(max(0.1 * env.speed, 0.25))
    cases = {
        (0.2 * length, 0.0, 0.0): True,
        (-0.2 * length, 0.8 * ALONGSIDE, 0.0): True,
        (0.8 * length, 0.0, 0.0): False,  # not there yet
        (0.0, 1.3 * ALONGSIDE, 0.0): False,
        (0.0, 0.0, 2.0 * rest): False,
    }
    for case, docked in cases.items():
        *_, terminated, _, info = at_berth(env, *case)
        assert (terminated, info["is_success"]) == (docked, docked), case
        assert info["reward_terms"]["failure"] == 0.0


def test_a_boat_that_runs_over_its_berth_strikes_the_quay() -> None:
    env = USVEnv(task="docking", sea="0")
    *_, terminated, _, info = at_berth(env, -1.2 * env.task.length, 0.0, 1.0)
    assert terminated and not info["is_success"]
    assert info["reward_terms"]["failure"] == -FAILURE_COST


def test_terms_of_docking_are_what_its_class_says() -> None:
    env = USVEnv(task="docking", sea="0")
    ahead, angle, speed = 3.0 * env.task.length, 0.5, 0.8 * env.speed
    _, reward, _, _, info = at_berth(env, ahead, angle, speed)
    state, errors = env.simulation.state[0], env.task.errors[0]
    distance = math.hypot(*errors[:2])
    over = math.hypot(state[fr.U], state[fr.V]) / env.speed - distance / (6.0 * env.task.length)
    nominal = env.episodes.nominal_action
    expected = {
        "distance": -0.5 * distance / env.task.unit,
        "speed": -0.5 * over,
        "effort": -0.05 * np.abs(nominal).sum(),
        "failure": 0.0,
        "heading": -0.25 * (1.0 - math.cos(errors[2])),
    }
    assert info["reward_terms"] == pytest.approx(expected)
    assert reward == pytest.approx(sum(expected.values()))


def test_paths_of_docking_are_as_its_class_says() -> None:
    task = Docking(1, 5.0, 6.0)
    for seed in range(50):
        points = task.path(np.random.default_rng(seed))
        legs = np.diff(points, axis=0)
        lengths, courses = np.hypot(*legs.T) / 6.0, np.arctan2(legs[:, 1], legs[:, 0])
        assert 5.0 <= lengths[0] <= 9.0 and 4.0 <= lengths[1] <= 6.0
        assert np.abs(np.diff([0.0, *courses])).max() <= math.radians(60.0) + 1e-9


class Short(Line):
    """Over after a fixed time, amid a decision."""

    def score(self, step):
        score, over = super().score(step), step.t > 0.62
        return Score(score.terms, over, over)


@pytest.mark.parametrize("task", [Short, Line, "path"])
def test_a_decision_ends_with_the_step_that_ends_the_episode(task) -> None:
    """Decisions of ten steps and of one get the same, but for what is new since the last."""
    seen = []
    for frames in (10, 1):
        env = USVEnv(task=task, sea="2", frame_skip=frames)
        env.reset(seed=3)
        over, k, total = False, 0, 0.0
        while not over:  # straight on leaves the path
            obs, reward, over, _, info = env.step([1.0, 0.0])
            k, total = k + 1, total + reward
            assert k < 20000
        names = env.unwrapped.observation_names
        kept = [j for j, name in enumerate(names) if not name.endswith("_valid")]
        seen.append((obs[kept], info["t_s"], total))
        env.close()
    np.testing.assert_array_equal(seen[0][0], seen[1][0])
    assert seen[0][1:] == pytest.approx(seen[1][1:])


class Legs(PathFollowing):
    """A path whose legs are drawn in compiled code."""

    legs = 2
    given: object = ((10.0, 30.0, 40.0), (90.0, 50.0, 50.0))

    def ranges(self):
        return self.given


def of_legs(given: object, **others: object) -> type[Task]:
    return type("Own", (Legs,), {"given": given, **others})


def test_legs_by_ranges_lie_within_them() -> None:
    env, found = USVEnv(task=Legs, sea="0"), []
    for seed in range(40):
        env.reset(seed=seed)
        legs = np.diff(env.task.points[0], axis=0)
        lengths, courses = np.hypot(*legs.T), np.degrees(np.arctan2(legs[:, 1], legs[:, 0]))
        assert 30.0 <= lengths[0] <= 40.0 and lengths[1] == pytest.approx(50.0)
        found.append([courses[0], courses[1] - courses[0]])
    turns = np.abs(found).max(axis=0)
    assert 5.0 < turns[0] <= 10.0 and 45.0 < turns[1] <= 90.0


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ([(10.0, 50.0, 60.0)] * 3, "legs = 2"),
        ([(10.0, math.nan, 60.0)] * 2, "three finite numbers"),
        ("abc", "three finite numbers"),
        ([(10.0, 60.0, 50.0)] * 2, "no shorter"),
        ([(200.0, 50.0, 60.0)] * 2, "180 degrees"),
        ([(10.0, -5.0, 60.0)] * 2, "above 0"),
        (None, "override path"),
    ],
)
def test_ranges_that_are_none_are_refused(given, expected) -> None:
    with pytest.raises(TaskError, match=expected):
        USVEnv(task=of_legs(given)).reset(seed=0)
    with pytest.raises(TaskError, match=expected):
        of_legs(given)(1, 5.0, 6.0).path(np.random.default_rng(0))


def test_long_paths_and_resets_of_ones_own_are_drawn_by_python() -> None:
    long = USVEnv(task=of_legs([(10.0, 50.0, 60.0)] * 20, legs=20))
    long.reset(seed=0)
    assert np.hypot(*np.diff(long.task.points[0], axis=0).T).min() >= 50.0

    def reset(self, i, rng, heading=0.0):
        Task.reset(self, i, rng, heading)
        self.points[i, 1] = 123.0, 0.0

    own = USVEnv(task=type("Own", (PathFollowing,), {"reset": reset}))
    own.reset(seed=0)
    assert own.task.points[0, 1].tolist() == [123.0, 0.0]
