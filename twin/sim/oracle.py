"""The oracle: the best possible prediction, with the true boat in mean wind and current.

It sails the ship of the simulation, in the mean wind and current, which it is given; waves and
gusts are unknown to it. It is the reference from which the benchmark measures the excess error. On
a real boat there is no such thing.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.filters.navigation_ekf import GAP_MAX_S
from twin.logs.log import Log
from twin.particulars import Particulars
from twin.predictors.baselines import COMMANDED, GRID, HistoryPredictor
from twin.predictors.registry import (
    PredictorError,
    options_of,
    predictor_class,
)
from twin.sim.bridge import TRUE_STATE, particulars_of
from usv_gym.physics import frames as fr
from usv_gym.physics import ship
from usv_gym.vessel.vessel import Vessel, vessel_names
from usv_gym.world.sea import SeaState
from usv_gym.world.simulation import Simulation
from usv_kernel.jit import kernel

__all__ = [
    "Oracle",
    "check_simulator",
    "known_vessel",
    "simulator_options",
]

Array = NDArray[Any]

OBSERVER_GAIN_PER_S = 0.5
"""Gain with which the oracle's velocities follow those of the navigation.

Source: docs/explanation/twin.md, Waves and prediction intervals.
"""

STEP_MAX_S = 0.05
"""Longest integration step: that of the simulation."""

_EXTRA = COMMANDED.stop
"""First extra column of a row of the history; from there on time, then the state of the ship."""

_TIME, _SHIP = 0, 1

_SIZE = _SHIP + fr.STATE_SIZE


class _True(NamedTuple):
    """The true ship in steady weather, and scratch."""

    vessel: Any  # usv_gym.physics.ship.Ship
    sea: Any  # mean wind and current, no waves
    limits: Any  # (3,) largest abs(u), abs(v), m/s, and abs(r), rad/s
    work: Any  # (ship.WORK_ROWS + 1, 16) of a step, and a state


@kernel
def _sail(state, cmd, t, dt, true):
    """Sail a ship for dt under a command, in place; velocities stay within the limits."""
    steps, limits = math.ceil(dt / STEP_MAX_S - 1e-9), true.limits
    for j in range(steps):
        h = dt / steps
        ship.step(state, cmd, true.vessel, true.sea, t + j * h, h, true.work)
        total = 0.0
        for i in range(fr.STATE_SIZE):
            total += state[i]
        if not math.isfinite(total):  # capsized, with infinite numbers
            for i in range(fr.STATE_SIZE):
                state[i] = 0.0
        state[fr.U] = min(max(state[fr.U], -limits[0]), limits[0])
        state[fr.V] = min(max(state[fr.V], -limits[1]), limits[1])
        state[fr.R] = min(max(state[fr.R], -limits[2]), limits[2])


@kernel
def _roll(starts, plans, dt, true, out):
    """Write where ships get from their starts (B, 17) under plans (B, K, 4): (B, K, 16)."""
    state = true.work[ship.WORK_ROWS]
    for b in range(plans.shape[0]):
        for i in range(fr.STATE_SIZE):
            state[i] = starts[b, _SHIP + i]
        for k in range(plans.shape[1]):
            _sail(state, plans[b, k], starts[b, _TIME] + k * dt, dt, true)
            for i in range(fr.STATE_SIZE):
                out[b, k, i] = state[i]


def known_vessel(particulars: Particulars) -> Vessel:
    """Return the vessel of this package that particulars were made of.

    PredictorError for any other boat: the true one is not known.
    """
    name = particulars.name
    if name in vessel_names():
        vessel = Vessel.load(name)
        true = particulars_of(vessel)
        numbers = ("length", "beam", "draft", "mass", "speed", "shaft_speed")
        if all(math.isclose(getattr(true, k), getattr(particulars, k)) for k in numbers):
            return vessel
    raise PredictorError(
        f"oracle: the true boat behind {name!r} is not known. It runs where the vessel is handed "
        "in (benchmark, environment), and on simulated logs of an unchanged vessel"
    )


def check_simulator(predictor: str, log: Log, particulars: Particulars) -> None:
    """Refuse a predictor that needs the true boat where it is not known.

    PredictorError for a recorded run (no truth), or a boat that is none of the package's vessels.
    """
    if not predictor_class(predictor).needs_simulator:
        return
    if log.truth is None:
        raise PredictorError(
            f"{predictor}: the true boat of {log.name!r} is not known, a recorded run has none; "
            "choose another predictor"
        )
    known_vessel(particulars)


def simulator_options(predictor: str, vessel: Vessel, sea: SeaState, dof: int) -> dict[str, Any]:
    """Return what a predictor is given of the simulator; nothing, unless it asks for it.

    What its name holds stays as it is.
    """
    if not predictor_class(predictor).needs_simulator:
        return {}
    given = {"vessel": vessel, "sea": sea, "dof": dof}
    return {key: value for key, value in given.items() if key not in options_of(predictor)}


class Oracle(HistoryPredictor):
    """The true ship in the mean wind and current, from a filtered start.

    Position and heading come from the tight navigation filter, speeds and yaw rate from an
    observer. The observer is a simulated copy of the ship, corrected towards the navigation's
    velocities with the gain :data:`OBSERVER_GAIN_PER_S`. So it filters out the motion that single
    waves cause. The actuators follow the commands as the true ones do. Waves, their mean drift,
    gusts and the slow changes of the wind are not known to it. Intervals are those of
    :class:`~twin.predictors.baselines.HistoryPredictor`.

    ``vessel`` is the true boat; left out, the package's vessel of which the particulars speak.
    ``sea`` gives mean wind and current; calm if left out. ``dof`` is 3 or 6. Nothing is drawn at
    random here.
    """

    tuning = "none: it knows the boat"
    needs_simulator = True
    steady = True
    constants = ("_true",)

    def __init__(
        self,
        particulars: Particulars,
        *,
        vessel: Vessel | None = None,
        sea: SeaState | None = None,
        dof: int = 3,
        seed: int = 0,
    ) -> None:
        vessel = vessel or known_vessel(particulars)
        steady = (sea or SeaState()).replace(wind_sd=0.0, wind_from_sd=0.0)
        quiet = Simulation(1, vessel, steady)
        quiet.reset([0], [np.random.default_rng(0)])
        U, L = particulars.speed, particulars.length
        self._true = _True(
            ship.Ship(vessel.packed.copy(), dof),
            ship.calm_sea(quiet.sea(0).weather),
            np.array([4.0 * U, 4.0 * U, 4.0 * U / L]),
            np.zeros((ship.WORK_ROWS + 1, fr.STATE_SIZE)),
        )
        super().__init__(particulars, seed=seed)

    def reset(self) -> None:
        """Forget everything that was seen."""
        super().reset()
        self._extra = np.zeros(_SIZE)
        self._last = np.zeros(10 + _SIZE)
        self._begun = False

    def extra_columns(self, dt: float) -> Array:
        """Return the time and the state of the observer's ship, shape (17,)."""
        out = self._extra.copy()
        state, n = out[_SHIP:], self.navigator.n
        _sail(state, self._cmd, self.t - dt, min(dt, GAP_MAX_S), self._true)
        if not self._begun:
            state[fr.N_LEFT :] = self._cmd
        share = -math.expm1(-OBSERVER_GAIN_PER_S * dt) if self._begun else 1.0
        for entry, value in zip((fr.U, fr.V, fr.R), n[3:6], strict=True):
            state[entry] += share * (value - state[entry])
        state[fr.X], state[fr.Y], state[fr.PSI] = n[:3]
        self._begun = self.navigator.ready
        out[_TIME] = self.t
        return out

    @property
    def look_back(self) -> float:
        """See :attr:`HistoryPredictor.look_back`: a forecast needs its own row alone."""
        return 0.0

    def path(self, plan: Array, dt: float) -> Array:
        """Return the predicted states (K, 6) under a plan."""
        return self._paths(self._extra[None], plan[None], dt)[0]

    def forecast(self, rows: Array, origins: Array, plans: Array) -> Array:
        """Return forecasts; see :meth:`HistoryPredictor.forecast`."""
        return self._paths(rows[origins, _EXTRA:], plans, GRID)

    def _paths(self, starts: Array, plans: Array, dt: float) -> Array:
        out = np.empty((*plans.shape[:2], fr.STATE_SIZE))
        plans = np.ascontiguousarray(plans)
        _roll(starts, plans, dt, self._true, out)
        return out[:, :, TRUE_STATE]
