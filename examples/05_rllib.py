"""Train PPO on USVTwin-v0 with Ray RLlib: two env runners, on this machine or on a cluster.

    python -m pip install -e '.[rllib]'
    python examples/05_rllib.py --iterations 50
    python examples/05_rllib.py --iterations 500 --runners 16 --address auto

``--address`` is that of a running cluster (``ray start --head``, and ``ray start --address=...``
on the other machines); every machine needs usv-twin. RLlib pins one release of Gymnasium (Ray 2.60:
1.2.2), which usv-twin takes too: a virtual environment of its own for RLlib is best.
"""

import argparse

import gymnasium as gym

try:
    import ray
    from ray.rllib.algorithms.ppo import PPOConfig
    from ray.rllib.core.rl_module.default_model_config import DefaultModelConfig
    from ray.tune import register_env
except ImportError as error:
    raise SystemExit(f"{error}: python -m pip install -e '.[rllib]'") from None


SCALE = 0.1


def boats(config):
    """Return all boats of an env runner, whose number RLlib gives as ``num_envs``."""
    import usv_gym  # noqa: F401 - registers the environment, in every worker

    envs = gym.make_vec("USVTwin-v0", **config)
    # a value function learns returns in the thousands too slowly
    return gym.wrappers.vector.TransformReward(envs, lambda reward: reward * SCALE)


parser = argparse.ArgumentParser(description="Train PPO on USVTwin-v0 with Ray RLlib.")
parser.add_argument("--iterations", type=int, default=3)
parser.add_argument("--runners", type=int, default=2, help="env runners, a CPU each")
parser.add_argument("--boats", type=int, default=16, help="boats of each env runner")
parser.add_argument("--decisions", type=int, default=4096, help="of all boats, each iteration")
parser.add_argument("--address", help="of a cluster; left out: one is started here")
given = parser.parse_args()

if given.address:
    ray.init(given.address, log_to_driver=False)
else:
    ray.init(num_cpus=given.runners, include_dashboard=False, log_to_driver=False)
register_env("boats", boats)
config = (
    PPOConfig()
    .environment(
        "boats",
        env_config={
            "observation": "twin",
            "twin": "ukf",
            "frame_skip": 10,  # a decision every half second
            "max_episode_steps": 240,
            "sea": "0|2|4",
            "faults": "none|gps10|gps30|gps60",
        },
    )
    .env_runners(
        num_env_runners=given.runners,
        num_envs_per_env_runner=given.boats,
        gym_env_vectorize_mode="vector_entry_point",
        sample_timeout_s=900.0,  # the first use compiles the kernels on every machine
    )
    .rl_module(
        model_config=DefaultModelConfig(
            fcnet_hiddens=[64, 64], fcnet_activation="tanh", vf_share_layers=False
        )
    )
    .training(
        train_batch_size_per_learner=given.decisions,
        minibatch_size=256,
        num_epochs=10,
        gamma=0.95,
        lr=1e-3,
        use_kl_loss=False,
        clip_param=0.2,
        vf_clip_param=float("inf"),  # RLlib's own cuts off errors above 10
    )
)
try:
    algorithm = config.build_algo()
    for i in range(given.iterations):
        result = algorithm.train()
        sampled = result["env_runners"]
        mean = sampled.get("episode_return_mean", float("nan")) / SCALE
        speed = sampled["num_env_steps_sampled"] / result["time_this_iter_s"]
        print(f"iteration {i + 1}: mean return {mean:.1f}, {speed:.0f} decisions/s", flush=True)
    algorithm.stop()
finally:
    ray.shutdown()
