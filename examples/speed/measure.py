"""Speed of the package beside Gymnasium's Pendulum: rates, first use, refit and forecast.

All cases take turns in short bursts; shown are medians over the rounds, in CPU time of one core.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable

import gymnasium as gym
import numpy as np

import usv_gym
from twin import Twin
from twin.sim.bridge import particulars_of, simulate

BASELINE = "Pendulum"
STEPS = 512
"""Environment steps in a burst: a boat's block of noise, and several forecasts."""
BOATS, BATCH_STEPS = 256, 60
"""Boats of a batch, and its steps in a burst."""
DT = 0.05
"""Time between rows, s."""
AHEAD = np.array([0.8, 0.1], np.float32)
"""Action of a wide turn: shaft speed and drive angle."""

Burst = tuple[Callable[[], object], int]
"""What is timed, and how many operations it does."""


def environment(name: str, action: np.ndarray, steps_before: int = 0, **options: object) -> Burst:
    env = gym.make(name, max_episode_steps=10**9, **options)
    env.reset(seed=0)
    for _ in range(steps_before):
        env.step(action)

    def run() -> None:
        for _ in range(STEPS):
            env.step(action)

    return run, STEPS


def batch(twin: str | None) -> Burst:
    options = {"task": "free", "twin": twin, "num_threads": 1, "max_episode_steps": None}
    envs = gym.make_vec("USVTwin-v0", num_envs=BOATS, **options)
    envs.reset(seed=0)
    actions = np.tile(AHEAD, (BOATS, 1))

    def run() -> None:
        for _ in range(BATCH_STEPS):
            envs.step(actions)

    return run, BATCH_STEPS * BOATS


def running_twin(predictor: str, **options: object) -> tuple[Twin, Callable[[], None]]:
    """Return a twin after two minutes of a zigzag, and what gives its predictor 200 rows more."""
    vessel = usv_gym.Vessel.load("usv75")
    sea = usv_gym.SeaState.named("2")
    log = simulate("zigzag", vessel=vessel, sea=sea, duration=120.0, seed=0)
    twin = Twin(particulars_of(vessel), predictor, **options)
    twin.run(log)
    rows = list(zip(log.z[-200:], log.cmd[-200:], strict=True))

    def more() -> None:
        begin = twin.predictor.estimate().t
        for k, (z, cmd) in enumerate(rows, start=1):
            twin.predictor.update(begin + DT * k, DT, z, cmd)

    return twin, more


def rows(predictor: str, **options: object) -> Burst:
    return running_twin(predictor, **options)[1], 200


def forecast(predictor: str) -> Burst:
    twin = running_twin(predictor)[0]

    def run() -> None:
        for _ in range(10):
            twin.predict(horizon=10.0)

    return run, 10


def sail(twin: str | None, **options: object) -> Burst:
    return environment("USVTwin-v0", AHEAD, task="free", twin=twin, **options)


CASES: dict[str, Callable[[], Burst]] = {
    BASELINE: lambda: environment("Pendulum-v1", np.zeros(1, np.float32)),
    "env": lambda: sail(None),
    "env, 6 degrees of freedom": lambda: sail(None, dof=6),
    "env with ukf": lambda: sail("ukf"),
    # its window is full after two minutes
    "env with dsw-ukf-plus": lambda: sail("dsw-ukf-plus", steps_before=2400),
    f"batch of {BOATS}, a boat": lambda: batch(None),
    f"batch of {BOATS} with ukf, a boat": lambda: batch("ukf"),
    "row of ukf": lambda: rows("ukf"),
    "row of dsw-ukf-plus": lambda: rows("dsw-ukf-plus"),
    "row and refit of dsw-ukf-plus": lambda: rows("dsw-ukf-plus", period=DT),
    "10 s forecast of ukf": lambda: forecast("ukf"),
    "10 s forecast of dsw-ukf-plus": lambda: forecast("dsw-ukf-plus"),
}


def measure(cases: dict[str, Callable[[], Burst]], rounds: int) -> dict[str, list[float]]:
    """Return the CPU seconds of an operation of each case in each round."""
    bursts = {name: make() for name, make in cases.items()}
    for run, _ in bursts.values():
        run()  # compiles
    seconds: dict[str, list[float]] = {name: [] for name in cases}
    for _ in range(rounds):
        for name, (run, count) in bursts.items():
            begun = time.process_time()
            run()
            seconds[name].append((time.process_time() - begun) / count)
    return seconds


FIRST_USE = """
import time, gymnasium as gym, usv_gym
env = gym.make("USVTwin-v0")
env.reset(seed=0)
for _ in range(60):
    env.step(env.action_space.sample())
print(time.process_time())
"""


def first_use_seconds() -> tuple[float, float]:
    """Return the CPU seconds of a process that makes and steps an environment: cold, warm."""
    with tempfile.TemporaryDirectory() as empty:
        settings = {**os.environ, "NUMBA_CACHE_DIR": empty, "USV_TWIN_QUIET": "1"}
        command = [sys.executable, "-c", FIRST_USE]
        cold, warm = (
            float(subprocess.run(command, env=settings, capture_output=True, check=True).stdout)
            for _ in range(2)
        )
    return cold, warm


def table(seconds: dict[str, list[float]]) -> str:
    """Return a row for each case: time, rate, and the rate beside that of the baseline."""
    lines = ["| what | µs | per second | ratio |", "|---|---|---|---|"]
    for name, times in seconds.items():
        median = statistics.median(times)
        pairs = zip(seconds[BASELINE], times, strict=True)
        ratio = statistics.median(slow / fast for slow, fast in pairs)
        rate = f"{1.0 / median:,.0f}".replace(",", " ")
        lines.append(f"| {name} | {1e6 * median:.3g} | {rate} | {ratio:.2g} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=30, help="bursts of each case [30]")
    parser.add_argument("--no-first-use", action="store_true", help="compile nothing anew")
    given = parser.parse_args()
    print(table(measure(CASES, given.rounds)))
    if not given.no_first_use:
        cold, warm = first_use_seconds()
        print(f"\nFirst use of the environment: {cold:.0f} CPU s cold, {warm:.1f} s warm.")


if __name__ == "__main__":
    main()
