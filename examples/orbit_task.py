"""A task of your own: sail once around a buoy, four lengths away from it.

``gym.make("USVTwin-v0", task="orbit_task:Orbit")`` finds it where this file lies in the working
directory or on the path. ``python orbit_task.py`` sails it with line-of-sight guidance.
"""

import gymnasium as gym
import numpy as np

import usv_gym  # noqa: F401 - registers the environment
from twin.agents.controllers import make_controller
from usv_gym.envs.tasks import Score, Step, Task
from usv_gym.physics import frames as fr

RADIUS, NEAREST = 4.0, 1.5  # lengths


class Orbit(Task):
    """Keep a distance of four lengths from a buoy, and go around it once."""

    terms = ("progress", "distance", "effort", "failure")
    legs = 24
    reach = 0.5  # a way point counts as passed within half a length

    def path(self, rng: np.random.Generator) -> np.ndarray:
        """Return a polygon around the buoy, which the boat meets at the origin."""
        side = rng.choice([-1.0, 1.0])  # the buoy is to port or to starboard
        turn = np.linspace(0.0, 2.0 * np.pi, self.legs + 1)
        north, east = np.sin(turn), side * (1.0 - np.cos(turn))
        return RADIUS * self.length * np.stack([north, east], axis=1)

    def score(self, step: Step) -> Score:
        """Rate one step; each array has an entry for each boat."""
        buoy = 0.5 * (step.points[:, 0] + step.points[:, self.legs // 2])
        north, east = step.state[:, fr.X] - buoy[:, 0], step.state[:, fr.Y] - buoy[:, 1]
        distance = np.sqrt(north * north + east * east)
        away = np.abs(distance - RADIUS * self.length)
        near = distance < NEAREST * self.length
        far = away > self.rules["area"]
        along = step.state[:, fr.U] * np.cos(step.errors[:, 2])
        done = (step.leg == self.legs - 1) & (step.errors[:, 1] < self.rules["reach"])
        change = np.abs(step.action[:, 0] - step.before[:, 0])
        change = change + np.abs(step.action[:, 1] - step.before[:, 1])
        return Score(
            terms={
                "progress": 1.0 - np.abs(along / self.speed - 1.0),
                "distance": -np.minimum(away / self.unit, 2.0),
                "effort": -0.05 * change,
                "failure": np.where(near | far, -500.0, 0.0),
            },
            success=done,
            over=done | near | far,
        )


def main() -> None:
    envs = gym.make_vec(
        "USVTwin-v0",
        num_envs=4,
        task=Orbit,
        reward_weights={"distance": 3.0},
        twin="ukf",
        frame_skip=10,
        max_episode_steps=240,
    )
    pilot = make_controller("los-twin")
    obs, _ = envs.reset(seed=0)
    pilot.begin(envs)
    success = np.zeros(4, dtype=bool)
    over = np.zeros(4, dtype=bool)
    while not over.all():
        obs, _, terminated, truncated, info = envs.step(pilot.act(obs))
        success |= info["is_success"] & ~over
        over |= terminated | truncated
    print(f"{success.sum()} of 4 boats went around the buoy")


if __name__ == "__main__":
    main()
