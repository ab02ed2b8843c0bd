"""A trained agent, or a controller, that sails episodes at the pace of the clock."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.agents.agent import Agent, interface_of
from twin.agents.evaluation import make_envs
from twin.live.sessions.sailing import SailingSession, losses, twin_of
from twin.live.sessions.session import Snapshot, sea_of
from twin.live.sessions.tracker import TwinMonitor
from twin.predictors.registry import DEFAULT
from twin.sim.bridge import TRUE_STATE, measurement_row, particulars_of
from usv_gym.envs.env import Recorded
from usv_gym.world.faults import Disturbance

__all__ = ["PolicySession"]

Array = NDArray[np.float64]


class PolicySession(SailingSession):
    """Episodes that an agent steers, one after the other, with a twin that looks on.

    The agent decides on its own observation, as in its training. Between two decisions the rows of
    the episode are shown one by one. The page can lose sensors, begin the next episode, and record
    logs.

    Parameters
    ----------
    agent : Agent
        Steers.
    folder : Path
        Logs are recorded there.
    seed : int
        Of the first episode; each one after it has the next seed.
    predictor : str
        Of the twin that is shown. That of the agent's observation is ``env["twin"]``.
    faults : sequence of Disturbance
        Faults of sensors beside those that are ordered.
    **env
        Options of :func:`twin.agents.evaluation.make_envs`, with one sea state.

    Raises
    ------
    AgentError
        The agent does not suit the environment.
    """

    def __init__(
        self, agent: Agent, folder: Path, *, seed: int = 0, predictor: str = DEFAULT,
        faults: Sequence[Disturbance] = (), **env: Any,
    ) -> None:  # fmt: skip
        self.agent = agent
        self.envs = make_envs(
            1,
            autoreset_mode="Disabled",
            record=True,
            **{**interface_of(agent), **env, "faults": (*losses(), *faults)},
        )
        vessel, self.simulation = self.envs.vessel, self.envs.simulation
        dof = self.simulation.dof
        particulars = particulars_of(vessel, self.simulation.suite, dof)
        super().__init__(vessel, particulars, folder)
        twin = twin_of(vessel, particulars, predictor, self.envs.seas[0], dof, seed)
        self.monitor = TwinMonitor(twin)
        self._result = "none has ended yet"
        self._rows: deque[Recorded] = deque()
        self._begin(seed)

    def next_episode(self) -> None:
        """Begin the next episode; a log that is being recorded ends."""
        self.record(False)
        self.forget()
        self._begin(self.seed + 1)

    def _begin(self, seed: int) -> None:
        """Begin the episode of a seed."""
        self.seed = seed
        self._obs = self.envs.reset(seed=[seed])[0]
        self.agent.begin(self.envs)
        self._off: list[float] = []
        self._over, self._shown = False, 0
        self._rows.clear()
        self._take_rows()
        self._play()
        self._anchor_now()

    def _decide(self) -> None:
        """Let the agent decide, and sail until its next decision."""
        step = self.envs.step(self.agent.act(self._obs))
        self._obs, info = step[0], step[4]
        self._off.append(abs(float(info["cross_track_m"][0])))
        self._over = bool(step[2][0] or step[3][0])
        if self._over:
            end = "reached its goal" if info["is_success"][0] else "did not reach its goal"
            self._result = f"seed {self.seed}: {np.mean(self._off):.2f} m off the path, {end}"
        self._take_rows()

    def _take_rows(self) -> None:
        """Take the rows that are new."""
        assert self.envs.recorder is not None
        rows = self.envs.recorder.rows[0]
        self._rows.extend(rows[self._shown :])
        self._shown = len(rows)

    def _play(self) -> None:
        """Show the next row."""
        self._row = row = self._rows.popleft()
        z, truth = measurement_row(row.z), row.state[list(TRUE_STATE)]
        self.monitor.step(row.t, z, row.cmd, truth)
        self._keep(row.t, z, row.cmd, truth)

    def _sail(self) -> bool:
        if not self._rows:
            if self._over:
                self.next_episode()
                return False
            self._decide()
        self._play()
        return True

    def _look(self) -> Snapshot:
        sea = sea_of(self.simulation)
        path = self.envs.task.points[0].copy()
        notes = f"{self.agent.name} sails seed {self.seed}", f"last episode: {self._result}"
        state = self._row.state.copy()
        return self._seen(state, path=path, sea=sea, notes=notes)

    def _close(self) -> None:
        self.envs.close()
        super()._close()
