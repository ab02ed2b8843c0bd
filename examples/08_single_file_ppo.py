"""PPO in one file: torch and numpy, and the boats in one compiled step of ``gym.make_vec``.

    python examples/08_single_file_ppo.py
    python examples/08_single_file_ppo.py --decisions 786432 --sea "0|2|4" --faults "none|gps30"

It prints how far the boats were off the path, and writes the policy; ``usv-twin evaluate
ppo_policy.npz los-twin`` compares it. Ctrl-C ends it early and keeps what was learned. All
arguments: ``--help``.
"""

import argparse
import time
from dataclasses import dataclass, fields

import gymnasium as gym
import numpy as np
import torch
from torch import nn

import usv_gym  # noqa: F401 - registers the environment
from twin.agents.policy import Policy


@dataclass
class Args:
    # the boats
    sea: str = "2"  # one of "0|2|4" is drawn for each episode
    faults: str = "none"  # losses of sensors, such as "none|gps10|gps30"
    boats: int = 256
    episode: int = 240  # decisions of half a second
    # the training
    seed: int = 0
    decisions: int = 262_144  # of all boats together
    rollout: int = 64  # decisions of each boat between two updates
    epochs: int = 10
    minibatch: int = 1024
    learning_rate: float = 3e-3  # at the start; 0 at the end
    gamma: float = 0.95
    gae_lambda: float = 0.95
    clip: float = 0.2
    grad_norm: float = 0.5
    cross_track: float = 3.0  # weight of the distance off the path in the reward
    reward_scale: float = 0.1
    reward_least: float = -10.0  # a failure costs much more than any decision else
    policy: str = "ppo_policy.npz"  # written at the end


def network(inputs, outputs, last):
    layers = [nn.Linear(inputs, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh()]
    layers.append(nn.Linear(64, outputs))
    for layer, gain in zip(layers[::2], (2**0.5, 2**0.5, last), strict=True):
        nn.init.orthogonal_(layer.weight, gain)
        nn.init.zeros_(layer.bias)
    return nn.Sequential(*layers)


class Agent(nn.Module):
    def __init__(self, inputs, nominal_action):
        super().__init__()
        self.actor = network(inputs, len(nominal_action), 0.01)
        self.critic = network(inputs, 1, 1.0)
        # an untrained agent holds the nominal speed: it learns sooner than one that lies still
        self.actor[-1].bias.data = torch.tensor(nominal_action, dtype=torch.float32)
        self.log_sd = nn.Parameter(torch.full((len(nominal_action),), -1.0))

    def distribution(self, x):
        return torch.distributions.Normal(self.actor(x), self.log_sd.exp())


class Boats:
    """The environment as PPO sees it: inputs, rewards of this training, ends of episodes."""

    def __init__(self, args):
        self.args, self.rng = args, np.random.default_rng(args.seed)
        self.envs = gym.make_vec(
            "USVTwin-v0",
            num_envs=args.boats,
            observation="compact",  # fourteen entries of one size
            twin="ukf",
            frame_skip=10,
            max_episode_steps=args.episode,
            autoreset_mode="SameStep",
            sea=args.sea,
            faults=args.faults,
            reward_weights={"cross_track": args.cross_track},
        )

    def reset(self):
        # boats that begin together would end together
        first = self.rng.integers(1, self.args.episode + 1, self.args.boats)
        obs, _ = self.envs.reset(seed=self.args.seed, options={"first_episode_steps": first})
        return torch.from_numpy(obs)

    def step(self, actions):
        """Return inputs, rewards, ends, cut off boats with their last inputs, distances."""
        args = self.args
        obs, rewards, terminated, truncated, infos = self.envs.step(np.clip(actions, -1.0, 1.0))
        off = np.abs(infos["cross_track_m"])
        ended, cut, final = terminated | truncated, np.flatnonzero(truncated & ~terminated), None
        if ended.any():  # infos are those of the new episode there
            off[ended] = np.abs(infos["final_info"]["cross_track_m"][ended])
        if len(cut):
            final = torch.from_numpy(np.stack(infos["final_obs"][cut]))
        rewards = np.maximum(args.reward_scale * rewards, args.reward_least)
        return torch.from_numpy(obs), torch.from_numpy(rewards).float(), ended, (cut, final), off


def collect(agent, boats, x, args):
    """Sail a rollout; return inputs, actions, log probabilities, advantages, returns, the rest."""
    shape = args.rollout, args.boats
    xs, actions = torch.zeros(*shape, x.shape[1]), torch.zeros(*shape, len(agent.log_sd))
    log_probs, rewards, values, goes_on = (torch.zeros(shape) for _ in range(4))
    off = np.zeros(shape)
    with torch.no_grad():
        for t in range(args.rollout):
            chosen = agent.distribution(x)
            xs[t], actions[t], values[t] = x, chosen.sample(), agent.critic(x)[:, 0]
            log_probs[t] = chosen.log_prob(actions[t]).sum(1)
            x, rewards[t], ended, (cut, final), off[t] = boats.step(actions[t].numpy())
            goes_on[t] = torch.from_numpy(~ended).float()
            if len(cut):  # there was more to come
                rewards[t, cut] += args.gamma * agent.critic(final)[:, 0]
        advantages, advantage, value = torch.zeros(shape), 0.0, agent.critic(x)[:, 0]
        for t in reversed(range(args.rollout)):
            error = rewards[t] + args.gamma * goes_on[t] * value - values[t]
            advantage = error + args.gamma * args.gae_lambda * goes_on[t] * advantage
            advantages[t], value = advantage, values[t]
    batch = xs, actions, log_probs, advantages, advantages + values
    return [part.flatten(0, 1) for part in batch], x, off.mean()


def update(agent, optimizer, batch, args):
    """Improve actor and critic on a rollout."""
    for _ in range(args.epochs):
        for rows in torch.randperm(len(batch[0])).split(args.minibatch):
            x, action, log_prob, advantage, target = (part[rows] for part in batch)
            ratio = (agent.distribution(x).log_prob(action).sum(1) - log_prob).exp()
            advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
            clipped = ratio.clamp(1.0 - args.clip, 1.0 + args.clip)
            actor_loss = -torch.min(ratio * advantage, clipped * advantage).mean()
            critic_loss = 0.5 * (agent.critic(x)[:, 0] - target).square().mean()
            optimizer.zero_grad()
            (actor_loss + critic_loss).backward()
            nn.utils.clip_grad_norm_(agent.parameters(), args.grad_norm)
            optimizer.step()


def train(args):
    """Return the agent, and the mean distance off the path in each rollout, m."""
    torch.manual_seed(args.seed)
    torch.set_num_threads(1)  # several are slower on networks of this size
    boats = Boats(args)
    x, curve, begun = boats.reset(), [], time.perf_counter()
    agent = Agent(x.shape[1], boats.envs.unwrapped.episodes.nominal_action)
    optimizer = torch.optim.Adam(agent.parameters(), eps=1e-5)
    updates = max(args.decisions // (args.boats * args.rollout), 1)
    try:
        for i in range(updates):
            optimizer.param_groups[0]["lr"] = args.learning_rate * (1.0 - i / updates)
            batch, x, off = collect(agent, boats, x, args)
            update(agent, optimizer, batch, args)
            curve.append(off)
            done = (i + 1) * args.boats * args.rollout
            speed = done / (time.perf_counter() - begun)
            print(
                f"{done:8d} decisions: {off:6.2f} m off the path, {speed:6.0f} decisions/s",
                flush=True,
            )
    except KeyboardInterrupt:
        print("stopped; what was learned is kept")
    finally:
        boats.envs.close()
    return agent, curve


def save(agent, args):
    """Write the actor as a policy that ``usv-twin`` reads, with numpy alone."""
    names = gym.make("USVTwin-v0", observation="compact", twin="ukf").unwrapped.observation_names
    linear = [layer for layer in agent.actor if isinstance(layer, nn.Linear)]
    layers = [(one.weight.detach().numpy(), one.bias.detach().numpy()) for one in linear]
    settings = {**vars(args), "frame_skip": 10, "max_episode_steps": args.episode}
    mean, sd = np.zeros(len(names)), np.ones(len(names))
    policy = Policy("single-file-ppo", "compact", names, settings, mean, sd, 1e6, layers)
    policy.save(args.policy)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="PPO in one file on USVTwin-v0.")
    for one in fields(Args):
        option = "--" + one.name.replace("_", "-")
        parser.add_argument(option, type=type(one.default), default=one.default)
    args = Args(**vars(parser.parse_args()))
    agent, _ = train(args)
    save(agent, args)
    print(args.policy)
