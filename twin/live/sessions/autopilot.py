"""Who steers a simulated boat: a hand, a manoeuvre, or line of sight along a path."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from twin.agents.controllers import LOS
from twin.channels import R
from twin.live.sessions.session import SessionError
from twin.live.sessions.tracker import HORIZON, PLAN_STEP
from usv_gym.envs.scoring import follow
from usv_gym.envs.tasks import Curves
from usv_gym.manoeuvring.manoeuvres import MANOEUVRES, commands
from usv_gym.vessel.vessel import Vessel

__all__ = [
    "AUTOPILOTS",
    "Autopilot",
]

Array = NDArray[np.float64]

AUTOPILOTS = ("off", *MANOEUVRES, "path")
"""``off``: by hand; a manoeuvre, from the moment on at which it is chosen; or a path."""

DECISION, STEADY = 0.5, 4.0
"""Time between two decisions along a path, and over which they are averaged for a forecast, s."""


class Autopilot:
    """Commands of a boat from those of a hand or one of :data:`AUTOPILOTS`, ``autopilot``.

    A hand sets ``throttle``, part of the nominal shaft speed, and ``angle``, rad, above 0 to
    starboard. ``path`` (K, 2) are the way points, m north and east; none where no path is followed.
    """

    def __init__(self, vessel: Vessel, speed: float, rng: np.random.Generator) -> None:
        self.vessel, self.speed = vessel, speed
        self.throttle, self.angle, self.autopilot = 1.0, 0.0, "off"
        self.path = np.empty((0, 2))
        self._nominal = vessel.values["shaft_speed_manoeuvring"]
        self._since, self._decided = 0.0, -math.inf
        self._rng, self._random_seed = rng, int(rng.integers(2**32))
        self._steered = self._steady = vessel.command(self._nominal, 0.0)

    def hand_over(self, autopilot: str, t: float, state: Array) -> None:
        """Let another autopilot steer from time t (s) and state (6,) on."""
        if autopilot not in AUTOPILOTS:
            raise SessionError(
                f"no autopilot is called {autopilot!r}; use one of {', '.join(AUTOPILOTS)}"
            )
        self.autopilot, self._since = autopilot, t
        self.path = np.empty((0, 2))
        if autopilot == "path":
            self._draw_path(state)

    def command(self, t: float, state: Array) -> Array:
        """Return the commands (4,) at a time (s) and estimated state (6,)."""
        if self.autopilot in MANOEUVRES:
            return self._manoeuvre(t, np.zeros(1))[0]
        if self.autopilot == "path":
            return self._along_path(t, state)
        most = self.vessel.helm_max
        return self.vessel.command(self._nominal * self.throttle, min(max(self.angle, -most), most))

    def plan(self, t: float) -> str | Array:
        """Return the commands to come, as :meth:`twin.digital_twin.Twin.predict` takes them."""
        if self.autopilot in MANOEUVRES:
            return self._manoeuvre(t, np.arange(0.0, HORIZON, PLAN_STEP))
        if self.autopilot == "path":  # corrections of waves and noise cancel over time
            return np.tile(self._steady, (round(HORIZON / PLAN_STEP), 1))
        return "hold"

    def _manoeuvre(self, t: float, ahead: Array) -> Array:
        """Return the commands (K, 4) of the manoeuvre in so many seconds (K,) from now."""
        # a function of time: random parts come from the same seed at each call
        rng, now = np.random.default_rng(self._random_seed), t - self._since
        times = np.append(0.0, now + ahead)
        shaft = self._nominal * self.throttle
        return commands(self.autopilot, times, self.vessel, rng, shaft)[1:]

    def _draw_path(self, state: Array) -> None:
        """Draw a curve that begins at the estimated position."""
        task = Curves(1, self.speed, self.vessel.values["length_waterline"])
        task.reset(0, self._rng)
        x, y, psi = state[:3]
        c, s = math.cos(psi), math.sin(psi)
        self.path = task.points[0] @ np.array([[c, s], [-s, c]]) + [x, y]
        self._leg, self._reach, self._decided = 0, float(task.rules["reach"]), -math.inf
        self._los = LOS()
        self._los.fit(self.vessel, self.speed, DECISION, self._reach)

    def _along_path(self, t: float, state: Array) -> Array:
        """Return what line of sight commands, twice a second."""
        if t < self._decided + DECISION - 1e-9:
            return self._steered
        if self._leg + 2 >= len(self.path):
            self._draw_path(state)
        self._decided = t
        x, y, psi, u = state[:4]
        r = state[R]
        errors = np.empty(4)
        self._leg = follow(x, y, psi, self.path, self._leg, self._reach, errors)
        e, to_go, off, turn = errors
        motion = [e, to_go, math.cos(off), math.sin(off), math.cos(turn), math.sin(turn)]
        motion += [r, u / self.speed]
        shaft, helm = self._los.steer(np.array([motion]))[0]
        full = self.throttle * self.vessel.values["shaft_speed_service"]
        self._steered = self.vessel.command(shaft * full, helm * self.vessel.helm_max)
        self._steady = self._steady + DECISION / STEADY * (self._steered - self._steady)
        return self._steered
