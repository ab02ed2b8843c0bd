"""Training with Stable-Baselines3: reproducible, and it goes on where it was stopped.

A run is a folder. Every ``EVERY`` decisions it comes to a break. The policy is evaluated on fixed
seeds, and all that training needs is written to the folder. Then every random number generator is
seeded from the run's seed and the decisions made, and every boat begins an episode. So a run that
goes on from a checkpoint is the run that was never stopped.
"""

from __future__ import annotations

import functools
import importlib.util
import io
import json
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from twin.agents.controllers import make_controller
from twin.agents.evaluation import EPISODE, FIRST_TRAINING_SEED, FRAME_SKIP, evaluate, make_envs
from twin.agents.hyperparameters import (
    ALGORITHMS,
    CORRECTING,
    SCHEDULES,
    algorithm_class,
    check_algorithm,
    check_hyperparameters,
    hyperparameters,
    schedule,
    torch_options,
)
from twin.agents.policy import AgentError, Policy
from twin.agents.weights import begin_nominal, policy_of
from twin.parallel import results_of
from twin.sim.compact import COMPACT_SETS
from twin.sim.wrapper import resolved
from usv_gym.envs.tasks import make_task
from usv_kernel import __version__
from usv_kernel.errors import UsvTwinError
from usv_kernel.files import read_json, write_whole

if TYPE_CHECKING:
    from stable_baselines3.common.vec_env import VecNormalize

__all__ = [
    "Plan",
    "Run",
    "train",
    "train_all",
]


EVERY = 131_072
"""Decisions between two checkpoints."""

CURVE_SEEDS = tuple(range(800_000, 800_016))
"""Episodes behind each point of a learning curve."""

NOTES, CHECKPOINT, CURVE, POLICY = "run.json", "checkpoint.pt", "curve.csv", "policy.npz"
"""Files of a run."""

REPLAY = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")
"""Arrays of a replay buffer of Stable-Baselines3."""


@dataclass(frozen=True)
class Plan:
    """What is trained."""

    algo: str  # one of ALGORITHMS
    # what the agent sees: one of twin.sim.wrapper.OBSERVATIONS, or names of entries
    observation: str | Sequence[str]
    steps: int  # decisions of all boats together
    seed: int = 0  # of the run
    # options of the environment; of "a|b" one is drawn at each reset
    twin: str = "ukf"
    task: str = "path"
    sea: str = "0|2|4"
    faults: str = "none|gps10|gps30|gps60"
    vessel: str = "usv75"
    # steps of 0.05 s for which a decision is held, and decisions in an episode
    frame_skip: int = FRAME_SKIP
    max_episode_steps: int = EPISODE
    vessel_spread: float = 0.0  # of the boats
    # further options of the environment, such as current and wind_from_deg
    world: Mapping[str, Any] = field(default_factory=dict)
    every: int = EVERY  # decisions between two checkpoints
    # weights of terms of the reward, beside those of the hyperparameters
    reward_weights: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_algorithm(self.algo)
        try:
            resolved(self.observation)
        except UsvTwinError as error:
            raise AgentError(str(error)) from None
        if self.task == "free":
            raise AgentError("task = 'free' has no reward: there is nothing to learn")
        for name, least in (("steps", 1), ("seed", 0), ("every", 1)):
            value = getattr(self, name)
            if not isinstance(value, int) or value < least:
                raise AgentError(f"{name} = {value!r}: must be a whole number, {least} or more")

    @property
    def name(self) -> str:
        """Name in tables."""
        seen = self.observation
        return f"{self.algo}-{seen if isinstance(seen, str) else f'{len(seen)}-entries'}"

    @property
    def environment(self) -> dict[str, Any]:
        """Options of :func:`~twin.agents.evaluation.make_envs`."""
        named = ("twin", "task", "sea", "faults", "vessel", "frame_skip", "max_episode_steps")
        options = {name: getattr(self, name) for name in named}
        options |= {"vessel_spread": self.vessel_spread} if self.vessel_spread else {}
        return options | dict(self.world)


@dataclass(frozen=True)
class Run:
    """What a training came to."""

    folder: Path
    policy: Policy
    # decisions, wall_s, cpu_s, return, cross_track_m, off_path_m, success at each checkpoint
    curve: list[dict[str, float]]

    @classmethod
    def of(cls, folder: Path) -> Run:
        """Return the run of a folder; AgentError where it has not ended, or is no run."""
        import polars as pl

        if not (folder / POLICY).exists():
            went = "has not ended: the command that began it goes on with it"
            raise AgentError(f"{folder}: {went if (folder / NOTES).exists() else 'is no run'}")
        path = folder / CURVE
        try:
            curve = pl.read_csv(path).cast(pl.Float64).to_dicts()
        except (OSError, pl.exceptions.PolarsError) as error:
            raise AgentError(
                f"{path}: is no learning curve ({error}); delete {folder} and train again"
            ) from None
        return cls(folder, Policy.load(folder / POLICY), curve)


def train(
    plan: Plan,
    folder: str | Path,
    *,
    hyper: Mapping[str, Any] | None = None,
    progress: bool = False,
    curve_seeds: tuple[int, ...] = CURVE_SEEDS,
    num_threads: int = 1,
) -> Run:
    """Train an agent, or go on with it, until it is done; AgentError: the folder holds another run.

    The folder has ``run.json`` (the plan), ``checkpoint.pt`` until it ends, ``curve.csv``, ``log/``
    (what Stable-Baselines3 logs, as CSV, and for TensorBoard if that is installed), and at the end
    ``policy.npz``. ``hyper`` is that of :func:`hyperparameters` if left out; ``curve_seeds`` are
    the episodes of each point of the learning curve. ``num_threads`` share the boats, which changes
    no result.
    """
    folder = Path(folder)
    hyper = dict(hyperparameters(plan.algo) if hyper is None else hyper)
    check_hyperparameters(plan.algo, hyper, "hyper")
    notes = {"plan": asdict(plan), "hyper": hyper, "curve_seeds": list(curve_seeds)}
    _check_claim(folder, notes)
    if not (folder / POLICY).exists():
        import torch

        torch.set_num_threads(1)  # several are slower on networks of this size
        learner = _Learner(plan, folder, hyper, curve_seeds, num_threads)
        try:
            # only after the learner could be made
            write_whole(folder / NOTES, (json.dumps(notes, indent=1) + "\n").encode())
            learner.learn(progress)
        finally:
            learner.envs.close()
        learner.policy({**asdict(plan), "hyper": hyper, "version": __version__}).save(
            folder / POLICY
        )
    (folder / CHECKPOINT).unlink(missing_ok=True)
    return Run.of(folder)


def train_all(
    plans: Sequence[Plan], out: Path, *, jobs: int = 1, **options: Any
) -> Iterator[tuple[Plan, Run]]:
    """Train all plans, each in the folder ``out/<name>-<seed>``, and yield each as it is done.

    ``jobs`` are trained at once, which changes no result; ``options`` are those of :func:`train`.
    """
    calls = [
        functools.partial(train, plan, out / f"{plan.name}-{plan.seed}", **options)
        for plan in plans
    ]
    for i, run in results_of(calls, jobs=jobs):
        yield plans[i], run


def _check_claim(folder: Path, notes: dict[str, Any]) -> None:
    """Refuse a folder that is another run's."""
    path = folder / NOTES
    if not path.exists():
        return
    before, now = read_json(path, AgentError), json.loads(json.dumps(notes))
    if not isinstance(before, dict) or not isinstance(before.get("plan"), dict):
        raise AgentError(f"{path}: does not describe a run; delete {folder} or choose another one")
    before, now = ({**one.pop("plan"), **one} for one in (before, now))
    for name, value in now.items():
        if value != before.get(name):
            raise AgentError(
                f"{folder}: is a run with {name} = {before.get(name)}, not {value}; choose another "
                "folder, or delete this one"
            )


class _Learner:
    """One training under way."""

    def __init__(
        self, plan: Plan, folder: Path, hyper: dict[str, Any], curve_seeds: tuple[int, ...],
        num_threads: int = 1,
    ) -> None:  # fmt: skip
        self.plan, self.folder, self.curve_seeds = plan, folder, curve_seeds
        algorithm = algorithm_class(plan.algo)
        from stable_baselines3.common.vec_env import VecNormalize

        from twin.agents.residual import ResidualVecEnv, ScaledReward
        from usv_gym.envs.sb3 import SB3VecEnv

        options = dict(hyper)
        for name in ("n_timesteps", "observation"):
            options.pop(name, None)
        reward = {"scale": 1.0, "least": -np.inf, **options.pop("reward", {})}
        terms = make_task(plan.task, 1, 1.0, 1.0).terms
        nominal = options.pop("reward_weights", {})
        weights = {name: nominal[name] for name in nominal if name in terms}
        weights |= plan.reward_weights
        residual = options.pop("residual", {})
        docks = "dock-twin" if plan.task == "docking" else "los-twin"
        self.base = residual.get("base", docks) if plan.algo in CORRECTING else ""
        self.share = residual.get("share", 0.5) if self.base else 1.0
        self.n, normalize = options.pop("n_envs", 64), options.pop("normalize", {})
        # without scores, forecasts that nobody reads are not made
        env: dict[str, Any] = {"forecast_scores": False, **plan.environment}
        env |= {"reward_weights": weights or None, "num_threads": num_threads}
        made = make_envs(self.n, observation=self._observation(), autoreset_mode="SameStep", **env)
        if "policy_kwargs" in options:
            options["policy_kwargs"] = torch_options(options["policy_kwargs"])
        for name in SCHEDULES:
            if options.get(name) is not None:
                options[name] = schedule(name, options[name])
        options["seed"] = _seed_of(plan.seed, 0)
        try:
            gamma = options.get("gamma", 0.99)
            boats: Any = SB3VecEnv(made)
            if self.base:
                base: Any = make_controller(self.base)
                seen = len(made.observation_names) - len(self._added)
                boats = ResidualVecEnv(boats, base, self.share, seen)
            boats = ScaledReward(boats, **reward)
            self.envs = VecNormalize(boats, gamma=gamma, **normalize)
            kind = ALGORITHMS[plan.algo][2]
            self.model: Any = algorithm(kind, self.envs, device="cpu", **options)
        except (AssertionError, AttributeError, TypeError, ValueError) as error:
            made.close()
            raise AgentError(f"hyperparameters of {plan.algo}: {error}") from None
        if not self.base:
            begin_nominal(self.model, made.episodes.nominal_action)
        self.curve: list[dict[str, float]] = []
        self.spent, self.since = np.zeros(2), _clocks()
        self._resume()

    def _open_log(self) -> None:
        """Log as CSV, a file for each time that it goes on, and for TensorBoard if installed."""
        from stable_baselines3.common.logger import Logger, make_output_format

        kinds = ["csv", "tensorboard"] if importlib.util.find_spec("tensorboard") else ["csv"]
        folder, suffix = str(self.folder / "log"), f"_{self.model.num_timesteps}"
        outputs = [make_output_format(kind, folder, suffix) for kind in kinds]
        self.model.set_logger(Logger(folder, outputs))

    def _observation(self) -> str | list[str]:
        """Return the observation of the boats: the agent's, and behind it what its base needs."""
        seen, self._added = self.plan.observation, list[str]()
        if not self.base:
            return seen if isinstance(seen, str) else list(seen)
        if isinstance(seen, str) and seen in COMPACT_SETS:
            seen = [one.name for one in COMPACT_SETS[seen][1]]
        if isinstance(seen, str):  # another whole set has them, or the base says what it lacks
            return seen
        base: Any = make_controller(self.base)
        self._added = [name for name in base.entries if name not in seen]
        return [*seen, *self._added]

    def learn(self, progress: bool = False) -> None:
        """Train to the end."""
        from stable_baselines3.common.callbacks import BaseCallback
        from torch.distributions import Distribution

        learner = self

        class Breaks(BaseCallback):
            """Comes to a break at the first rollout of the run, and every so many decisions."""

            following = -1

            def _on_rollout_start(self) -> None:
                steps = self.model.num_timesteps
                if steps >= self.following:
                    self.following = steps - steps % learner.plan.every + learner.plan.every
                    learner.take_break()

            def _on_step(self) -> bool:
                return True

        self._open_log()
        # torch would check each distribution; the boats refuse an action that is no number
        Distribution.set_default_validate_args(False)
        try:
            self.since = _clocks()
            left = self.plan.steps - self.model.num_timesteps
            if left > 0:
                # learn() would reset new boats before they are seeded; the break resets them after
                self.model._last_obs = np.empty(0)
                self.model.learn(
                    left, callback=Breaks(), reset_num_timesteps=False, progress_bar=progress
                )
            self.measure()
        finally:
            Distribution.set_default_validate_args(__debug__)
            self.model.logger.close()

    def take_break(self) -> None:
        """Evaluate, save, and start again, as a resumed run would."""
        model, steps = self.model, self.model.num_timesteps
        if not self.curve or self.curve[-1]["decisions"] < steps:
            self.measure()
            if steps:
                self._save()
        seed = _seed_of(self.plan.seed, steps)
        model.set_random_seed(seed)  # Python's, numpy's, torch's, the action space's, the boats'
        # boats that begin together would end together, and a rollout would hold one part of an
        # episode
        drawn = np.random.default_rng(seed).integers(1, self.plan.max_episode_steps + 1, self.n)
        self.envs.unwrapped.set_options({"first_episode_steps": drawn})
        model._last_obs = self.envs.reset()
        model._last_episode_starts = np.ones(self.envs.num_envs, dtype=np.bool_)
        model._last_original_obs = self.envs.get_original_obs()
        model.ep_info_buffer.clear()

    def policy(self, settings: dict[str, Any]) -> Policy:
        """Return the policy as it is now; ``settings`` are kept in its file."""
        plan = self.plan
        return policy_of(
            self.model, self.envs, plan.name, plan.observation, settings, self.base, self.share
        )

    def measure(self) -> None:
        """Add a point to the learning curve."""
        import polars as pl

        self.spent += _clocks() - self.since
        policy = self.policy({})
        options = self.plan.environment | {"forecast_scores": False}
        rows = evaluate(policy, seeds=self.curve_seeds, **options)
        wall, cpu = self.spent.round(3).tolist()
        point = {"decisions": self.model.num_timesteps, "wall_s": wall, "cpu_s": cpu}
        for name in ("return", "cross_track_m", "off_path_m", "success"):
            point[name] = round(float(np.mean([row[name] for row in rows])), 6)
            self.model.logger.record(f"evaluation/{name}", point[name])
        self.model.logger.dump(self.model.num_timesteps)
        self.curve.append(point)
        write_whole(self.folder / CURVE, pl.DataFrame(self.curve).write_csv().encode())
        self.since = _clocks()

    def _save(self) -> None:
        """Write a checkpoint of arrays and numbers only, so that loading it runs no code."""
        import torch

        model = self.model
        state = {
            "decisions": model.num_timesteps,
            "updates": model._n_updates,
            "spent": self.spent.tolist(),
            "curve": self.curve,
            "parameters": model.get_parameters(),
            "normalize": {
                name: [torch.as_tensor(rms.mean), torch.as_tensor(rms.var), rms.count]
                for name, rms in _averages(self.envs).items()
            },
        }
        if getattr(model, "log_ent_coef", None) is not None:
            state["log_ent_coef"] = model.log_ent_coef.detach()
        if (buffer := getattr(model, "replay_buffer", None)) is not None:
            rows = buffer.size()
            state["replay"] = {n: torch.from_numpy(getattr(buffer, n)[:rows]) for n in REPLAY}
            state["replay_end"] = [buffer.pos, buffer.full]
        packed = io.BytesIO()
        torch.save(state, packed)
        write_whole(self.folder / CHECKPOINT, packed.getvalue())

    def _resume(self) -> None:
        """Go on from the last checkpoint, if there is one."""
        import torch

        path = self.folder / CHECKPOINT
        if not path.exists():
            return
        try:
            self._restore(torch.load(path, weights_only=True))
        except Exception:  # damaged files fail in many ways
            raise AgentError(f"{path}: is damaged; delete {self.folder} and train again") from None

    def _restore(self, state: dict[str, Any]) -> None:
        """Take on the state of a checkpoint."""
        model = self.model
        model.set_parameters(state["parameters"], device="cpu")
        model.num_timesteps, model._n_updates = state["decisions"], state["updates"]
        self.spent, self.curve = np.array(state["spent"]), state["curve"]
        for name, rms in _averages(self.envs).items():
            mean, var, count = state["normalize"][name]
            rms.mean, rms.var, rms.count = mean.numpy(), var.numpy(), count
        if "log_ent_coef" in state:
            model.log_ent_coef.data.copy_(state["log_ent_coef"])
        if (buffer := getattr(model, "replay_buffer", None)) is not None:
            for name, rows in state["replay"].items():
                getattr(buffer, name)[: len(rows)] = rows.numpy()
            buffer.pos, buffer.full = state["replay_end"]


def _clocks() -> NDArray[np.float64]:
    """Return wall clock and CPU time of this process with all its threads, s."""
    return np.array([time.perf_counter(), time.process_time()])


def _averages(envs: VecNormalize) -> dict[str, Any]:
    """Return the running means and variances of observations and returns."""
    found = {"returns": envs.ret_rms}
    return found | {"observations": envs.obs_rms} if envs.norm_obs else found


def _seed_of(seed: int, steps: int) -> int:
    """Return the seed of the part after a break, which no evaluation uses."""
    drawn = int(np.random.SeedSequence([seed, steps]).generate_state(1)[0])
    return FIRST_TRAINING_SEED + drawn % FIRST_TRAINING_SEED
