"""Observations made to order: lists of entries, and the compact sets."""

import numpy as np
import pytest

from twin.agents.controllers import make_controller
from twin.agents.evaluation import make_envs
from twin.sim.compact import COMPACT, COMPACT_ORACLE, COMPACT_PARAMS, COMPACT_RAW
from twin.sim.wrapper import make_env, make_vector_env
from usv_kernel.errors import UsvTwinError

NAMES = make_env(twin="ukf").observation_names


@pytest.mark.parametrize(
    ("small", "whole", "entries"),
    [
        ("compact", "twin", COMPACT),
        ("compact_raw", "raw", COMPACT_RAW),
        ("compact_oracle", "oracle", COMPACT_ORACLE),
    ],
)
@pytest.mark.parametrize("vessel", ["usv75", "otter"])
def test_compact_sets_are_scaled_entries_by_the_scales_of_the_twin(
    small, whole, entries, vessel
) -> None:
    options = {"vessel": vessel, "vessel_spread": 0.2}
    one, full = (make_env(observation=name, **options) for name in (small, whole))
    few, many = one.reset(seed=1)[0], full.reset(seed=1)[0]
    shows_twin = any(name.startswith("twin_") for name in full.observation_names)
    assert shows_twin == (whole == "twin")
    for _ in range(60):
        few, many = one.step([0.5, 0.2])[0], full.step([0.5, 0.2])[0]
    seen = dict(zip(full.observation_names, many.astype(float), strict=True))
    twins = {row.name.removeprefix("compact_"): row for row in COMPACT}
    length = full.vessel.values["length_waterline"]
    pair = full.vessel.kind == "thruster_pair"
    assert one.observation_names == tuple(row.name for row in entries)
    for entry, value in zip(entries, few, strict=True):
        twin = twins[entry.name.split("_", 1 if whole == "twin" else 2)[-1]]
        assert (entry.offset, entry.scale, entry.near, entry.per_turn) == (
            twin.offset, twin.scale, twin.near, twin.per_turn
        )  # fmt: skip
        row = entry.of_pair if pair and entry.of_pair else entry
        if row.near:
            left = 100.0 * seen[row.source] - 2.0 * length
            expected = row.near * np.exp(-max(left, 0.0) / (4.0 / 3.0 * length))
        else:
            scale = row.scale * full.speed / length if row.per_turn else row.scale
            expected = np.clip((seen[row.source] - row.offset) / scale, -5.0, 5.0)
        assert value == pytest.approx(expected, abs=1e-5), entry.name


@pytest.mark.parametrize("twin", ["ukf", "dsw-ukf-plus", "persistence"])
@pytest.mark.parametrize("vessel", ["usv75", "usv75|otter"])
def test_forecasts_that_nobody_reads_are_not_made_and_change_no_entry(twin, vessel) -> None:
    found = []
    for scores in (True, False):
        envs = make_vector_env(
            2, twin=twin, vessel=vessel, observation="compact", forecast_scores=scores,
            frame_skip=4, max_episode_steps=6, autoreset_mode="SameStep",
        )  # fmt: skip
        seen = [envs.reset(seed=5)[0]]
        for _ in range(8):
            obs, rewards, *_ = envs.step(np.full((2, 2), 0.3))
            seen += [obs, rewards]
        found.append(np.concatenate([one.ravel() for one in seen]))
        drawn = [envs.observer.overlay(i) is not None for i in range(2)]
        assert drawn == [scores, scores]
    np.testing.assert_array_equal(*found)


@pytest.mark.parametrize("twin", ["ukf", "dsw-ukf-plus", "persistence"])
def test_forecasts_are_made_where_they_are_shown_or_drawn(twin) -> None:
    names, options = ["twin_surge", "ahead_5s_forward"], {"twin": twin, "forecast_scores": False}
    listed = make_env(observation=names, **options)
    pictured = make_env(observation="compact", render_mode="rgb_array", **options)
    full = make_env(observation="twin", twin=twin)
    for env in (listed, pictured, full):
        env.reset(seed=2)
    for _ in range(30):
        seen, whole = listed.step([0.5, 0.1])[0], full.step([0.5, 0.1])[0]
        pictured.step([0.5, 0.1])
    np.testing.assert_array_equal(seen, whole[[NAMES.index(name) for name in names]])
    ahead = [env.observer.overlay(0).ahead for env in (pictured, full)]
    np.testing.assert_array_equal(*ahead)


@pytest.mark.parametrize("vessel", ["usv75", "otter"])
def test_compact_entries_have_one_size_when_los_sails(vessel) -> None:
    """Held shafts do not vary at all: it is agents that move them."""
    seen = []
    for sea, faults in (("0", "none"), ("2", "gps30"), ("4", "gps30")):
        worlds = {"twin": "ukf", "sea": sea, "faults": faults, "vessel": vessel}
        envs, shown = (
            make_envs(6, observation=name, autoreset_mode="SameStep", **worlds)
            for name in ("twin", "compact")
        )
        pilot = make_controller("los-twin")
        obs, _ = envs.reset(seed=4000)
        small, _ = shown.reset(seed=4000)
        pilot.begin(envs)
        for _ in range(240):
            seen.append(small)
            actions = pilot.act(obs)
            obs, small = envs.step(actions)[0], shown.step(actions)[0]
    sd = dict(zip(shown.unwrapped.observation_names, np.concatenate(seen).std(axis=0), strict=True))
    steady = sd.pop("compact_shaft") if vessel == "usv75" else 0.0
    assert steady == pytest.approx(0.0, abs=1e-5)
    assert all(0.25 < value < 3.0 for value in sd.values()), sd


def test_compact_params_hold_coefficients_in_units_of_the_class() -> None:
    for vessel in ("usv75", "otter", "kvlcc2_l7"):
        options = {"twin": "ukf", "vessel": vessel, "frame_skip": 10}
        small = make_env(observation="compact_params", **options)
        whole = make_env(observation="twin_params", **options)
        one, other = small.reset(seed=0)[0], whole.reset(seed=0)[0]
        assert len(one) == len(COMPACT_PARAMS) == 30
        np.testing.assert_allclose(one[14:22], 0.0, atol=1e-6)
        np.testing.assert_allclose(one[22:], 1.0, atol=1e-6)
        for _ in range(40):
            one, other = small.step([0.7, 0.3])[0], whole.step([0.7, 0.3])[0]
        entries = dict(zip(whole.observation_names, other, strict=True))
        for scaled, value in zip(COMPACT_PARAMS[14:], one[14:], strict=True):
            name = next(name for name in scaled.source if name in entries)
            assert value == pytest.approx(np.clip(entries[name], -5.0, 5.0), abs=1e-6)
        assert (one[14:22] != 0.0).all()


def test_a_list_needs_no_twin_where_no_entry_is_of_one() -> None:
    env = make_env(observation=["to_go", "yaw_rate"])
    assert env.observer.names == () and env.reset(seed=0)[0].shape == (2,)
    health = make_env(twin="ukf", observation=["health_gps", "twin_surge"])
    assert health.reset(seed=0)[0].shape == (2,)


def test_wrong_lists_are_refused() -> None:
    for wrong, match in (
        ([], "one entry or more"),
        (["yaw_rate", "yaw_rate"], "none twice"),
        (["twin_surg"], "twin_surg"),
        (["raw"], "for the set, write observation='raw'"),
        (["twin_surge", "true_surge"], "no set has all"),
        ("compacted", "compacted.*or a list"),
        ([1], "or a list"),
    ):
        with pytest.raises(UsvTwinError, match=match):
            make_env(twin="ukf", observation=wrong)
    with pytest.raises(UsvTwinError, match="needs a twin"):
        make_env(twin=None, observation="compact")
