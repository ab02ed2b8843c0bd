"""What steers a batch of boats, whether it was written or trained."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from usv_gym.envs.vector import USVVectorEnv
from usv_gym.vessel.vessel import Vessel
from usv_kernel.errors import UsvTwinError

__all__ = [
    "Agent",
    "ControllerError",
    "check_actions",
    "interface_of",
    "shaft_speeds",
]


class Agent(Protocol):
    """Steers all boats of a vector environment at once.

    Attributes
    ----------
    name : str
        For tables.
    observation : str or list of str
        The observation set that it needs, or the entries, see :func:`twin.sim.wrapper.make_env`.
    actions : str, optional
        ``"units"`` if it steers each actuator, see :class:`usv_gym.envs.env.USVEnv`.
    """

    name: str

    @property
    def observation(self) -> str | list[str]:
        """See the class."""

    def begin(self, envs: USVVectorEnv) -> None:
        """Forget all there was: every boat of ``envs`` begins an episode.

        Where boats begin new ones at different times, what an agent remembers of a boat
        (integrals, plans, dead reckoning) goes on into its next episode.

        Parameters
        ----------
        envs : USVVectorEnv
            As it was reset. What is asked of it is its vessel, its options and the names of the
            observation's entries, never the truth.
        """

    def act(self, obs: NDArray[np.float32]) -> NDArray[np.float64]:
        """Return the actions, shape (n, 2), for observations (n, D); of units (n, A)."""


def interface_of(agent: Agent) -> dict[str, Any]:
    """Return the options of the environment that an agent sees and steers through."""
    return {"observation": agent.observation, "actions": getattr(agent, "actions", "common")}


class ControllerError(UsvTwinError):
    """A controller that is unknown or does not suit these boats; the message names the remedy."""


def check_actions(name: str, envs: USVVectorEnv) -> None:
    """Refuse boats that take something else than a shaft speed and an angle."""
    width = (envs.single_action_space.shape or (0,))[0]
    if width != 2:
        raise ControllerError(
            f"{name} gives a shaft speed and an angle, these boats take {width} numbers; make "
            "them with actions='common'"
        )
    if len(envs.episodes.kinds) > 1:
        names = ", ".join(kind.vessel.name for kind in envs.episodes.kinds)
        raise ControllerError(
            f"{name} is tuned by the particulars of one vessel, these boats are of several "
            f"({names}); name one vessel, or steer by a policy"
        )


def shaft_speeds(vessel: Vessel) -> tuple[float, float]:
    """Return the shaft speeds of full throttle and of the nominal speed, rev/s."""
    values = vessel.values
    return values["shaft_speed_service"], values["shaft_speed_manoeuvring"]
