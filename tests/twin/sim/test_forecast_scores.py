"""The scores in ``info`` are those that the benchmark's definitions give on the episode's log."""

import pickle

import numpy as np
import pytest

import usv_gym  # noqa: F401 - registers the environment
from twin.benchmark.scores import CHANNELS, score
from twin.digital_twin import Twin
from twin.sim.bridge import particulars_of
from twin.sim.forecast_scores import HORIZONS, NAMES, ForecastScores
from twin.sim.wrapper import log_of, make_env
from usv_gym import Fault
from usv_gym.world.faults import FaultWarning

LOSS = 12.0, 17.0
OPTIONS = {"task": "free", "faults": [Fault("gps", LOSS[0], LOSS[1] - LOSS[0])]}
PREDICTORS = ["ukf", "dsw-ukf-plus", "dsw-ukf", "var"]


def sail(env, steps, seed=3, every=7):
    """Sail with a command that changes; return the last info."""
    rng = np.random.default_rng(0)
    env.reset(seed=seed)
    for k in range(steps):
        if k % every == 0:
            action = np.array([rng.uniform(0.3, 1.0), rng.uniform(-1.0, 1.0)])
        info = env.step(action)[-1]
    return info


def scores_of(log, twin, decision):
    """Return the benchmark's scores of forecasts made at whole seconds, by plan and place."""
    found = {(plan, lost): [] for plan in ("known", "held") for lost in (False, True)}
    for row, (t, z, cmd) in enumerate(log.without_truth()):
        twin.step(t, z, cmd)
        ahead = row + np.round(HORIZONS / 0.05).astype(int)
        whole = t > 0.0 and abs(t - round(t)) < 1e-9 and row % decision == 0
        if not whole or ahead[-1] >= len(log) or not twin.predictor.ready:
            continue
        known = log.cmd[row + 1 : row + 201].reshape(20, 10, 4).mean(axis=1)
        for plan, commands in (("known", known), ("held", "hold")):
            prediction = twin.predict(commands, dt=0.5)
            truth = log.truth[[row, *ahead]].copy()
            lost = LOSS[0] <= t < LOSS[1]
            found[plan, lost].append(score(prediction, truth, HORIZONS.tolist()))
    return found


def assert_equal(info, found, has_quantiles):
    scores = info["twin_forecast"]
    for (plan, lost), parts in found.items():
        place = "_loss" if lost else ""
        assert scores[f"n{place}"] == len(parts) > 0
        for h, horizon in enumerate(HORIZONS):
            name = f"{plan}{place}_{horizon:g}s"
            psi, u = CHANNELS.index("psi"), CHANNELS.index("u")
            expected = {
                "displacement_m": np.mean([one.displacement[h] for one in parts]),
                "heading_rad": np.mean([abs(one.error[h, psi]) for one in parts]),
                "speed_mps": np.mean([abs(one.error[h, u]) for one in parts]),
            }
            if plan == "held":
                expected["displacement_coverage90"] = np.mean([p.covered[h, -1] for p in parts])
                if not has_quantiles:
                    expected["heading_coverage90"] = np.mean([p.covered[h, psi] for p in parts])
                    expected["speed_coverage90"] = np.mean([p.covered[h, u] for p in parts])
            for what, value in expected.items():
                assert scores[f"{name}_{what}"] == pytest.approx(value, rel=1e-6, abs=1e-8), what


@pytest.mark.parametrize("frame_skip", [1, 10])
@pytest.mark.parametrize("twin", PREDICTORS)
def test_scores_equal_those_of_the_benchmark_on_the_log(twin, frame_skip):
    options = OPTIONS | {"frame_skip": frame_skip, "record": True, "band_period": 0.0}
    env = make_env(twin=twin, **options)
    info = sail(env, 560 // frame_skip, every=7 if frame_skip == 1 else 1)
    again = Twin(particulars_of(env.vessel, env.simulation.suite), twin)
    found = scores_of(log_of(env), again, frame_skip)
    assert_equal(info, found, twin == "dsw-ukf-plus")


def test_coverage_counts_only_forecasts_with_new_standard_deviations():
    scores = sail(make_env(twin="ukf", band_period=5.0, **OPTIONS), 560)["twin_forecast"]
    total = scores["n"] + scores["n_loss"]
    # at 5, 10 and 15 s; a forecast is graded 10 s later
    assert total == 18
    assert scores["n_intervals"] + scores["n_intervals_loss"] == 3


def test_grading_can_be_switched_off_and_changes_no_observation():
    on, off = (
        make_env(twin="ukf", **OPTIONS),
        make_env(twin="ukf", forecast_scores=False, **OPTIONS),
    )
    graded, plain = sail(on, 300), sail(off, 300)
    assert "twin_forecast" not in plain
    assert graded["twin_forecast"]["n"] > 0
    np.testing.assert_array_equal(on.step(np.zeros(2))[0], off.step(np.zeros(2))[0])


@pytest.mark.parametrize("observation", ["raw", "raw_stacked", "oracle"])
def test_a_twin_that_the_agent_does_not_see_is_graded(observation):
    unseen = make_env(observation=observation, twin="ukf", forecast_scores=True, **OPTIONS)
    alone = make_env(observation=observation, twin="ukf", **OPTIONS)
    ours = make_env(twin="ukf", **OPTIONS)
    scores = [sail(env, 300) for env in (unseen, alone, ours)]
    assert "twin_forecast" not in scores[1]
    assert scores[0]["twin_forecast"] == scores[2]["twin_forecast"]
    np.testing.assert_array_equal(unseen.step(np.zeros(2))[0], alone.step(np.zeros(2))[0])


@pytest.mark.parametrize("options", [{}, {"suite": "best"}])
def test_the_loss_of_a_sensor_that_is_not_there_is_none(options):
    faults = [Fault("ahrs", 12.0, 8.0), *([Fault("wind", 12.0, 8.0)] if not options else [])]
    with pytest.warns(FaultWarning):
        env = make_env(twin="ukf", task="free", faults=faults, **options)
    assert sail(env, 420)["twin_forecast"]["n_loss"] == 0


def test_steps_that_do_not_divide_a_second_are_graded_too():
    scores = sail(make_env(twin="ukf", dt=0.07, dt_physics=0.07, **OPTIONS), 310)["twin_forecast"]
    same = sail(make_env(twin="ukf", **OPTIONS), 420, every=10)["twin_forecast"]
    assert scores["n"] + scores["n_loss"] == same["n"] + same["n_loss"] == 11
    assert scores["known_10s_displacement_m"] < 5.0 * same["known_10s_displacement_m"]


def test_longer_steps_than_those_of_a_plan_are_not_graded():
    scores = sail(make_env(twin="ukf", dt=1.0, task="free"), 30)["twin_forecast"]
    assert dict(scores) == {"n": 0, "n_loss": 0, "n_intervals": 0, "n_intervals_loss": 0}


def test_scores_are_a_mapping_that_can_be_pickled():
    scores = sail(make_env(twin="ukf", **OPTIONS), 560)["twin_forecast"]
    assert isinstance(scores, ForecastScores)
    assert set(scores) <= set(NAMES)
    assert all(isinstance(value, float) for value in scores.values())
    assert pickle.loads(pickle.dumps(scores)) == scores
    with pytest.raises(KeyError, match="name of no score"):
        scores["held_3s_displacement_m"]
