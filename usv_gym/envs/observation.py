"""Observation sets that need no twin: what the last decisions saw, and the truth."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from usv_gym.envs.episodes import BOUND, EPISODE, EPISODES, Episodes, Observer
from usv_gym.envs.scoring import COURSE_ERROR, CROSS_TRACK, NEXT_TURN, TO_GO
from usv_gym.physics import frames as fr
from usv_gym.world.state import BOAT
from usv_kernel.jit import kernel
from usv_kernel.records import as_record

__all__ = [
    "OBSERVERS",
    "Stacked",
    "TrueState",
]

STACK = 8
"""Decisions in a stacked observation, this one included."""

_ALL = slice(None)

_TRUE = (
    *("surge", "sway", "yaw_rate", "cos_heading", "sin_heading", "cross_track", "to_go"),
    *("cos_course_error", "sin_course_error", "cos_next_turn", "sin_next_turn"),
    *("shaft_left", "shaft_right", "drive_left", "drive_right"),
)

(
    SURGE, SWAY, YAW_RATE, COS_HEADING, SIN_HEADING, OFF_PATH, TO_END,
    COS_COURSE_ERROR, SIN_COURSE_ERROR, COS_NEXT_TURN, SIN_NEXT_TURN, SHAFTS,
) = range(12)  # fmt: skip
"""Places of the entries above; a twin's estimate begins with the same entries."""


class Stacked(Observer):
    """The sensors' entries of the seven decisions before this one, the youngest first."""

    def __init__(self, episodes: Episodes) -> None:
        own = episodes.observation
        self.names = tuple(f"{name}_{k}_before" for k in range(1, STACK) for name in own)
        self._entries = len(own)
        self._steps = episodes.steps
        self._seen_at = np.zeros(episodes.n)
        self._before = np.zeros((episodes.n, STACK, len(own)), np.float32)

    def reset(self, i: int) -> None:
        """See :class:`Observer`; the first observation fills all places."""
        self._seen_at[i] = -1.0

    def observe(self, obs: NDArray[np.float32], look: bool = True, rows: slice = _ALL) -> None:
        """See :class:`Observer`."""
        if not look:
            return
        seen_at, before, steps = self._seen_at[rows], self._before[rows], self._steps[rows]
        now = obs[rows, : self._entries]
        new = seen_at < 0.0
        before[new] = now[new, None]
        moved = steps != seen_at
        before[moved, 1:] = before[moved, :-1]
        before[moved, 0] = now[moved]
        seen_at[:] = steps
        obs[rows, self._entries :] = before[:, 1:].reshape(len(before), -1)


@kernel
def _true_state(rows, episodes, shared, obs):
    """Write the truth behind the sensors' entries of each boat's observation."""
    for i in range(rows.shape[0]):
        episode = as_record(episodes[i], EPISODE)
        config = as_record(shared[int(episode.kind)], EPISODES)
        rules, state, errors = config.rules, as_record(rows[i], BOAT).state, episode.task.errors
        o = obs[i, int(config.entries) :]
        psi = state[fr.PSI]
        o[SURGE], o[SWAY] = state[fr.U] / rules.speed, state[fr.V] / rules.speed
        o[YAW_RATE] = state[fr.R]
        o[COS_HEADING], o[SIN_HEADING] = math.cos(psi), math.sin(psi)
        o[OFF_PATH], o[TO_END] = errors[CROSS_TRACK] / rules.unit, 0.1 * errors[TO_GO] / rules.unit
        o[COS_COURSE_ERROR], o[SIN_COURSE_ERROR] = (
            math.cos(errors[COURSE_ERROR]),
            math.sin(errors[COURSE_ERROR]),
        )
        o[COS_NEXT_TURN], o[SIN_NEXT_TURN] = (
            math.cos(errors[NEXT_TURN]),
            math.sin(errors[NEXT_TURN]),
        )
        for j in range(4):
            o[SHAFTS + j] = state[fr.N_LEFT + j] / config.scale[j]
        for j in range(o.shape[0]):
            o[j] = min(max(o[j], -BOUND), BOUND)


class TrueState(Observer):
    """What no boat can know: for comparison only."""

    names = tuple(f"true_{name}" for name in _TRUE)

    def __init__(self, episodes: Episodes) -> None:
        self._episodes = episodes

    def reset(self, i: int) -> None:
        """See :class:`Observer`; there is no state."""

    def observe(self, obs: NDArray[np.float32], look: bool = True, rows: slice = _ALL) -> None:
        """See :class:`Observer`."""
        if look:
            episodes = self._episodes
            _true_state(
                episodes.simulation.rows[rows], episodes.memory[rows], episodes.shared, obs[rows]
            )


OBSERVERS: dict[str, Callable[[Episodes], Observer] | None] = {
    "raw": None,
    "raw_stacked": Stacked,
    "oracle": TrueState,
}
"""Observer of each observation set, which adds entries to those of the sensors."""
