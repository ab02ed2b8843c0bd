"""What the study of agents does: tasks, arms, controllers, and conditions of the evaluation."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from twin.agents.evaluation import EVALUATION_SEEDS, OUTAGES, SEAS
from twin.agents.hyperparameters import hyperparameters
from twin.agents.policy import AgentError
from twin.agents.training import CURVE_SEEDS, Plan

__all__ = [
    "ARMS",
    "CONDITIONS",
    "QUICK_ARMS",
    "STUDIES",
    "Condition",
    "Piece",
    "Settings",
    "Studied",
    "arm_named",
    "check",
    "name_of",
    "pieces",
    "quick",
]

POINTS, EVERY = 8, 65_536
"""Points of a learning curve at least, and decisions between two of them at most."""

ARMS = (
    *(("ppo", f"compact{of}") for of in ("_raw", "", "_params", "_oracle")),
    *((algo, "compact") for algo in ("ppo-residual", "ppo-mpc", "sac")),
    ("recurrent_ppo", "compact_raw"),
)
"""Algorithms and observation sets of the study."""

QUICK_ARMS = ARMS[:4]
"""Those of a study that shows only that everything runs."""

DRAWN = "|".join(SEAS)
"""One of the sea states at random."""

ANY = {"wind_from_deg": "any", "current": "any"}
"""Wind from any direction, and a current of up to 0.5 m/s to any."""

BOATS = tuple(range(920_000, 920_020))
"""Episodes of each condition with boats that differ: no training and no curve has them."""


@dataclass(frozen=True)
class Condition:
    """Where agents are evaluated, with each loss of GPS."""

    text: str
    seas: tuple[str, ...]  # each has all episodes
    seeds: tuple[int, ...]  # of the episodes
    # options of the environment, beside those of all conditions
    options: Mapping[str, Any] = field(default_factory=dict)


def _boats(text: str, **options: Any) -> Condition:
    """Return a condition with boats that differ, in any wind and current.

    Its episodes last up to 240 s, as a slow boat needs more than the 120 s of a training.
    """
    return Condition(text, (DRAWN,), BOATS, {**ANY, "max_episode_steps": 480, **options})


CONDITIONS = {
    "protocol": Condition("the nominal boat, one wind, no current", SEAS, EVALUATION_SEEDS),
    "spread 0": _boats("the nominal boat, any wind and current"),
    "spread .15": _boats("boats that differ by 15 %", vessel_spread=0.15),
    "spread .30": _boats("boats that differ by 30 %, as in training", vessel_spread=0.3),
    "spread .45": _boats("boats that differ by 45 %: held out", vessel_spread=0.45),
    "otter": _boats("another vessel, spread .15: held out", vessel="otter", vessel_spread=0.15),
}
"""Where agents are evaluated."""


@dataclass(frozen=True)
class Studied:
    """A task of the study, and what counts in it."""

    metric: str  # of an episode; the one that agents are compared by
    statistic: str  # of that metric, one of twin.agents.study.statistics.STATISTICS
    better: int  # 1: more is better; -1: less is
    title: str
    controllers: tuple[str, ...]
    against: tuple[str, ...]  # controllers that each arm is compared with
    level: str  # the controller whose level learning curves are to reach
    conditions: tuple[str, ...]


STUDIES = {
    "path": Studied(
        "off_path_m", "iqm", -1, "distance off the path, m (interquartile mean)",
        ("los", "los-twin", "mpc-twin", "mpc-steady", "los-oracle"), ("los-twin", "mpc-twin"),
        "los-twin", tuple(CONDITIONS),
    ),
    "docking": Studied(
        "success", "mean", 1, "share of episodes that end at rest in the berth",
        ("dock-twin", "dock-oracle"), ("dock-twin",), "dock-twin", tuple(CONDITIONS)[1:],
    ),
}  # fmt: skip
"""Tasks of the study."""


@dataclass(frozen=True)
class Settings:
    """What the study does."""

    task: str = "path"  # one of STUDIES
    arms: tuple[tuple[str, str], ...] = ARMS  # algorithms and observation sets
    # decisions of each training; left out: n_timesteps of the algorithm's hyperparameters
    steps: int | None = None
    seeds: tuple[int, ...] = tuple(range(8))  # trainings of each arm
    twin: str = "ukf"
    losses: tuple[str, ...] = OUTAGES  # with which each condition is evaluated
    conditions: Mapping[str, Condition] = field(default_factory=lambda: CONDITIONS)
    curve_seeds: tuple[int, ...] = CURVE_SEEDS  # episodes of each point of the learning curves
    # options of Plan, beside those of all trainings
    options: Mapping[str, Any] = field(default_factory=dict)
    # hyperparameters by algorithm; those of this package if left out
    hyper: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    @property
    def studied(self) -> Studied:
        """What counts in the task."""
        return STUDIES[self.task]

    @property
    def evaluated(self) -> dict[str, Condition]:
        """The conditions of the task by name."""
        names = self.studied.conditions
        return {name: one for name, one in self.conditions.items() if name in names}

    def plan(self, algo: str, observation: str, seed: int) -> Plan:
        """Return the plan of one training."""
        steps = self.steps or (self.hyper.get(algo) or hyperparameters(algo))["n_timesteps"]
        options: dict[str, Any] = {
            **{"every": min(EVERY, -(-steps // POINTS)), "vessel_spread": 0.3, "world": ANY},
            **{"sea": DRAWN, "faults": "|".join(OUTAGES), **self.options},
        }
        return Plan(algo, observation, steps, seed, twin=self.twin, task=self.task, **options)


def quick(settings: Settings) -> Settings:
    """Return the same study so small that it shows only that everything runs."""
    few = {
        name: dataclasses.replace(settings.conditions[name], seeds=BOATS[:4])
        for name in ("spread .15", "otter")
    }
    return dataclasses.replace(
        settings,
        arms=QUICK_ARMS,
        steps=settings.steps or 16_384,
        seeds=settings.seeds[:2],
        losses=("none", "gps30"),
        conditions=few,
        curve_seeds=settings.curve_seeds[:4],
    )


Piece = tuple[str, str, int | None]
"""Algorithm, observation set and seed; or a controller's name, nothing and None."""


def pieces(settings: Settings) -> list[Piece]:
    """Return all pieces of work, one seed of every arm before the next."""
    steered: list[Piece] = [(name, "", None) for name in settings.studied.controllers]
    return steered + [(*arm, seed) for seed in settings.seeds for arm in settings.arms]


def name_of(piece: Piece | tuple[str, str]) -> str:
    """Return the name of an agent in tables."""
    return f"{piece[0]}-{piece[1]}" if piece[1] else piece[0]


def arm_named(name: str) -> tuple[str, str]:
    """Return an arm by its name, such as ``ppo-residual-compact``: sets have no hyphen."""
    algo, observation = name.rpartition("-")[::2]
    if not algo:
        raise AgentError(f"no arm is called {name!r}; write algorithm-observation, as ppo-compact")
    return algo, observation


def check(settings: Settings) -> None:
    """Raise AgentError for what cannot be done, before hours are spent on it."""
    if settings.task not in STUDIES:
        raise AgentError(f"no study has the task {settings.task!r}; known: {', '.join(STUDIES)}")
    if not (settings.seeds and settings.arms):
        raise AgentError("a study needs an arm, and a seed to train it with")
    if len(set(settings.arms)) < len(settings.arms):
        raise AgentError(f"arms = {', '.join(map(name_of, settings.arms))}: name each only once")
    for algo, observation in settings.arms:
        settings.plan(algo, observation, 0)
