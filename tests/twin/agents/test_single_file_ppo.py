"""The example of PPO in one file learns, and writes what it learned."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("torch", reason="the example needs torch: pip install 'usv-twin[rl]'")

from tests.twin.live.wire import load_example
from twin.agents.evaluation import evaluate
from twin.agents.policy import Policy

SMALL = {"boats": 64, "minibatch": 512}


@pytest.fixture(scope="module")
def ppo():
    return load_example("08_single_file_ppo.py")


def untrained(policy):
    """Return the policy that steers straight on at the nominal speed."""
    first, last = policy.layers[:-1], policy.layers[-1]
    nominal = np.array([last[1][0], 0.0])
    return replace(policy, layers=[*first, (np.zeros_like(last[0]), nominal)])


def test_single_file_ppo_halves_the_distance_off_the_path(ppo, tmp_path):
    agent, curve = ppo.train(ppo.Args(**SMALL, decisions=81_920))
    assert len(curve) == 20
    assert curve[-1] < 0.5 * curve[0]
    saved = tmp_path / "policy.npz"
    ppo.save(agent, ppo.Args(policy=str(saved)))
    before, after = (
        np.mean([row["off_path_m"] for row in evaluate(policy, seeds=range(8))])
        for policy in (untrained(Policy.load(saved)), Policy.load(saved))
    )
    assert after < 0.3 * before


def test_single_file_ppo_repeats_a_seed_to_the_bit(ppo):
    options = {**SMALL, "boats": 8, "rollout": 16, "decisions": 256}
    (agent, curve), (again, same) = (ppo.train(ppo.Args(**options)) for _ in range(2))
    assert curve == same
    for name, part in agent.state_dict().items():
        np.testing.assert_array_equal(part, again.state_dict()[name])


def test_single_file_ppo_keeps_the_policy_when_stopped(ppo, monkeypatch, capsys):
    calls = []

    def stop(*_):
        calls.append(1)
        raise KeyboardInterrupt

    monkeypatch.setattr(ppo, "update", stop)
    agent, curve = ppo.train(ppo.Args(**{**SMALL, "boats": 2, "rollout": 2, "decisions": 16}))
    assert len(calls) == 1 and curve == []
    assert "kept" in capsys.readouterr().out
    assert agent.actor[0].in_features == 14
