"""Who steers a simulated boat: a hand, or a manoeuvre."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from twin.live.sessions.session import SessionError
from twin.live.sessions.tracker import HORIZON_S, PLAN_STEP_S
from usv_gym.manoeuvring.manoeuvres import MANOEUVRES, commands
from usv_gym.vessel.vessel import Vessel

__all__ = [
    "AUTOPILOTS",
    "Autopilot",
]

Array = NDArray[np.float64]

AUTOPILOTS = ("off", *MANOEUVRES)
"""``off``: by hand; or a manoeuvre, from the moment on at which it is chosen."""


class Autopilot:
    """Commands of a boat from those of a hand or one of :data:`AUTOPILOTS`, ``autopilot``.

    A hand sets ``throttle``, part of the nominal shaft speed, and ``angle``, rad, above 0 to
    starboard.
    """

    def __init__(self, vessel: Vessel, rng: np.random.Generator) -> None:
        self.vessel = vessel
        self.throttle, self.angle, self.autopilot = 1.0, 0.0, "off"
        self._nominal = vessel.values["shaft_speed_manoeuvring"]
        self._since, self._random_seed = 0.0, int(rng.integers(2**32))

    def hand_over(self, autopilot: str, t: float) -> None:
        """Let another autopilot steer from time t (s) on."""
        if autopilot not in AUTOPILOTS:
            raise SessionError(
                f"no autopilot is called {autopilot!r}; use one of {', '.join(AUTOPILOTS)}"
            )
        self.autopilot, self._since = autopilot, t

    def command(self, t: float) -> Array:
        """Return the commands (4,) at a time (s)."""
        if self.autopilot in MANOEUVRES:
            return self._manoeuvre(t, np.zeros(1))[0]
        most = self.vessel.helm_max
        return self.vessel.command(self._nominal * self.throttle, min(max(self.angle, -most), most))

    def plan(self, t: float) -> str | Array:
        """Return the commands to come, as :meth:`twin.digital_twin.Twin.predict` takes them."""
        if self.autopilot in MANOEUVRES:
            return self._manoeuvre(t, np.arange(0.0, HORIZON_S, PLAN_STEP_S))
        return "hold"

    def _manoeuvre(self, t: float, ahead: Array) -> Array:
        """Return the commands (K, 4) of the manoeuvre in so many seconds (K,) from now."""
        # a function of time: random parts come from the same seed at each call
        rng, now = np.random.default_rng(self._random_seed), t - self._since
        times = np.append(0.0, now + ahead)
        shaft = self._nominal * self.throttle
        return commands(self.autopilot, times, self.vessel, rng, shaft)[1:]
