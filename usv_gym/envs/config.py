"""The options of the environment, documented once."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from usv_gym.vessel.vessel import Vessel
from usv_gym.world.faults import Disturbance
from usv_gym.world.recorded_spectrum import SeaError
from usv_gym.world.sea import SeaKeyframe, SeaState
from usv_gym.world.sensor_suite import ARM_MAX, SensorSuite
from usv_gym.world.simulation import substeps_of
from usv_kernel.errors import UsvTwinError, check_number, check_options, check_whole

__all__ = ["EnvConfig"]

FRAME_SKIP_MAX = 10_000
"""Most steps that an action is held for."""

PENALTY_MAX = 1e3
"""Largest weight of a reward's term."""

DEGREES_MAX = 3600.0
"""Largest angle that may be given, degrees."""


def _check_point(point: object) -> None:
    """Refuse a deck point that is not three lengths."""
    listed = isinstance(point, (tuple, list)) or (isinstance(point, np.ndarray) and point.ndim == 1)
    if not listed or len(point) != 3:  # type: ignore[arg-type]
        raise UsvTwinError(
            f"deck_point = {point!r}: must be three lengths in m (forward, to starboard, down)"
        )
    for length in point:  # type: ignore[attr-defined]
        check_number("deck_point", length, -ARM_MAX, ARM_MAX)


@dataclass(frozen=True, kw_only=True)
class EnvConfig:
    """Options of ``gym.make("USVTwin-v0", ...)`` that every environment takes.

    Parameters
    ----------
    vessel : str or Path or Vessel
        Name, TOML file or object.
    sea : str or SeaState or sequence of them
        Name in :data:`usv_gym.world.sea.SEA_STATES`, or an object. Of several, as in ``"0|2|4"``,
        each episode draws one.
    hs, wind, wind_from_deg : float, optional
        Change the sea state's wave height (m), wind speed (m/s) and where the wind comes
        from (degrees).
    schedule : sequence of SeaKeyframe, optional
        Moments (time, hs, wind) or (time, hs, wind, wind_from), between which wave height and wind
        change: see :class:`usv_gym.world.sea.SeaState`. Times are those of the episode, s;
        ``wind_from`` is in rad. It replaces ``hs`` and ``wind``.
    suite : SensorSuite or str, optional
        Errors and rates of the sensors, or one of :data:`usv_gym.world.sensors.GRADES`
        (``"typical"``, ``"best"``, ``"consumer"``, ``"perfect"``).
    faults : str or sequence of Disturbance
        ``"none"``, ``"on"`` (everything, again and again), a text, or faults with their times.
        Texts are such as ``"gps10"`` (10 s without GPS, beginning at random between 10 and 60 s) or
        ``"gps10@30+imu-spikes-random"``, see :func:`usv_gym.world.faults.parse_faults`. Of several
        texts, as in ``"none|gps10|gps30"``, each episode draws one.
    task : str
        One of :data:`usv_gym.envs.tasks.TASKS`.
    motion_penalty : float, optional
        Weight of the reward's term ``motion``, with ``dof=6``: minus the square of the roll over 10
        degrees, and that of the vertical acceleration of the deck point over 2 m/s2. Left out, it
        is that of the task: 0, but for ``"seakeeping"``.
    deck_point : tuple of float, optional
        Point of the deck where the vertical acceleration counts, m forward, to starboard and down
        of the origin; 0.4 lengths forward if left out. It is that of the twin's forecasts, too.
    actions : str
        ``"common"`` or ``"units"``.
    frame_skip : int
        Steps of ``dt`` that an action is held for; the reward is their sum, and sensors (and
        a twin) run in each of them.
    dof : int
        Degrees of freedom of the ship: 3 (surge, sway, yaw) or 6. With 6 it heaves, rolls and
        pitches in the waves, and the accelerometers measure gravity by the tilt.
    dt, dt_physics : float
        Control and integration step, s.
    """

    vessel: str | Path | Vessel = "usv75"
    sea: str | SeaState | Sequence[str | SeaState] = "2"
    hs: float | None = None
    wind: float | None = None
    wind_from_deg: float | None = None
    schedule: Sequence[SeaKeyframe] | None = None
    suite: SensorSuite | str | None = None
    faults: str | Sequence[Disturbance] = "none"
    task: str = "path"
    motion_penalty: float | None = None
    deck_point: tuple[float, float, float] | None = None
    actions: str = "common"
    frame_skip: int = 1
    dof: int = 3
    dt: float = 0.05
    dt_physics: float = 0.05

    def __post_init__(self) -> None:
        if not isinstance(self.actions, str) or self.actions not in ("common", "units"):
            raise UsvTwinError(f"actions = {self.actions!r}; use 'common' or 'units'")
        check_whole("frame_skip", self.frame_skip, 1, FRAME_SKIP_MAX)
        if self.wind_from_deg is not None:
            check_number("wind_from_deg", self.wind_from_deg, -DEGREES_MAX, DEGREES_MAX)
        if self.motion_penalty is not None:
            check_number("motion_penalty", self.motion_penalty, 0.0, PENALTY_MAX)
        if self.deck_point is not None:
            _check_point(self.deck_point)
            object.__setattr__(self, "deck_point", tuple(map(float, self.deck_point)))
        substeps_of(self.dt, self.dt_physics)

    @classmethod
    def names(cls) -> tuple[str, ...]:
        """Return the names of the options."""
        return tuple(field.name for field in dataclasses.fields(cls))

    @classmethod
    def of(cls, options: dict[str, Any], others: Sequence[str]) -> EnvConfig:
        """Return the configuration of options by name.

        Raises
        ------
        ArgumentError
            Names the options that exist; ``others`` are those of the environment itself.
        """
        given = (name for name in options if name not in others)
        check_options("the environment", given, (*others, *cls.names()))
        return cls(**options)

    def seas(self) -> tuple[SeaState, ...]:
        """Return the sea states, with wave height and wind as asked for."""
        angle = self.wind_from_deg
        wind_from = None if angle is None else math.radians(angle % 360.0)
        if isinstance(self.schedule, str):
            raise SeaError(
                f"schedule = {self.schedule!r}: must be a sequence of (time, hs, wind) or "
                "(time, hs, wind, wind_from), not a text; usv_gym.world.schedule.changing_sea "
                "makes one of such texts"
            )
        schedule = None if self.schedule is None else SeaState(schedule=self.schedule).schedule
        return tuple(
            state.replace(
                hs=self.hs, wind=self.wind, wind_from=wind_from, schedule=schedule or None
            )
            for state in SeaState.any_of(self.sea)
        )
