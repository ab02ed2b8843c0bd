"""The options of the environment, documented once."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
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
from usv_kernel.errors import (
    UsvTwinError,
    check_number,
    check_options,
    check_whole,
    is_finite,
)

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


SPREAD_MAX = 0.5
"""Largest spread of the boats: of more, hardly one of a thousand holds speed and course."""

Span = tuple[float, float]

DEGREES = (-DEGREES_MAX, DEGREES_MAX)
LOADS = (0.5, 1.5)
CURRENTS = (0.0, 10.0)
"""Bounds of angles (degrees), of factors of the mass, and of speeds of the current (m/s)."""

CURRENT_ANY = (0.0, 0.5)
"""Speeds of any current, m/s."""


def _span(name: str, given: Any, bounds: Span) -> Span:
    """Return a number, a range or "any" as a range."""
    if isinstance(given, str) and given == "any" and bounds == DEGREES:
        return 0.0, 360.0
    if isinstance(given, str):
        anything = "" if bounds == LOADS else ", 'any'"
        raise UsvTwinError(f"{name} = {given!r}: must be a number{anything} or (low, high)")
    if not isinstance(given, Sequence):
        check_number(name, given, *bounds)
        return float(given), float(given)
    if len(given) != 2:
        raise UsvTwinError(f"{name} = {given!r}: a range needs two numbers, (low, high)")
    low, high = given
    for value in given:
        check_number(name, value, *bounds)
    if low > high:
        raise UsvTwinError(f"{name} = {given!r}: the first of a range must be the smaller one")
    return float(low), float(high)


@dataclass(frozen=True, kw_only=True)
class EnvConfig:
    """Options of ``gym.make("USVTwin-v0", ...)`` that every environment takes.

    Parameters
    ----------
    vessel : str or Path or Vessel or sequence of them
        Name, TOML file or object. Of several, as in ``"usv75|otter"``, each episode draws one. A
        twin knows which one.
    sea : str or SeaState or sequence of them
        Name in :data:`usv_gym.world.sea.SEA_STATES`, or an object. Of several, as in ``"0|2|4"``,
        each episode draws one.
    hs, wind, wind_from_deg : float, optional
        Change the sea state's wave height (m), wind speed (m/s) and where the wind comes
        from (degrees). ``wind_from_deg`` may be a range (low, high), or ``"any"``: each episode
        draws one, and turns all wind of the sea state by it.
    schedule : sequence of SeaKeyframe, optional
        Moments (time, hs, wind) or (time, hs, wind, wind_from), between which wave height and wind
        change: see :class:`usv_gym.world.sea.SeaState`. Times are those of the episode, s;
        ``wind_from`` is in rad. It replaces ``hs`` and ``wind``.
    current : float or "any" or tuple, optional
        Replaces the sea state's: speed (m/s) and where it goes to (degrees), each a number, a range
        (low, high) to draw from, or ``"any"``. A single number is a speed to any side; ``"any"``
        alone is up to 0.5 m/s to any side.
    heading_deg : float or "any" or tuple of float
        Heading at the start, degrees, or a range to draw from. The path turns with it.
    vessel_spread : float
        Spread of the boats: each episode draws one by :meth:`usv_gym.Vessel.varied`, and the thrust
        of each side with a third of the spread. A twin knows the nominal vessel only.
    load : float or tuple of float
        Factor of mass, moments of inertia, added masses and draft; of a range, one is drawn.
    suite : SensorSuite or str, optional
        Errors and rates of the sensors, or one of :data:`usv_gym.world.sensors.GRADES`
        (``"typical"``, ``"best"``, ``"consumer"``, ``"perfect"``).
    faults : str or sequence of Disturbance
        ``"none"``, ``"on"`` (everything, again and again), a text, or faults with their times.
        Texts are such as ``"gps10"`` (10 s without GPS, beginning at random between 10 and 60 s) or
        ``"gps-jump=20:10@30+imu-spikes-random"``, see
        :func:`usv_gym.world.faults.parse_faults`. Of several texts, as in ``"none|gps10|gps30"``,
        each episode draws one. A fault may be the table of its fields, as in ``spec.to_json()``.
    task : str or type
        One of :data:`usv_gym.envs.tasks.TASKS`, ``module:Class`` of a task of your own, or its
        class: see :class:`usv_gym.envs.tasks.Task`.
    reward_weights : mapping of str to float, optional
        Factors of parts of the reward, such as ``{"cross_track": 3.0}``; others have 1.
    motion_penalty : float, optional
        Weight of the reward's term ``motion``, with ``dof=6``: minus the square of the roll over 10
        degrees, and that of the vertical acceleration of the deck point over 2 m/s2. Left out, it
        is that of the task: 0, but for ``"seakeeping"``.
    deck_point : tuple of float, optional
        Point of the deck where the vertical acceleration counts, m forward, to starboard and down
        of the origin; 0.4 lengths forward if left out. It is that of the twin's forecasts, too,
        and needs ``dof=6``.
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

    vessel: str | Path | Vessel | Sequence[str | Path | Vessel] = "usv75"
    sea: str | SeaState | Sequence[str | SeaState] = "2"
    hs: float | None = None
    wind: float | None = None
    wind_from_deg: float | str | Sequence[float] | None = None
    schedule: Sequence[SeaKeyframe] | None = None
    current: float | str | Sequence[Any] | None = None
    heading_deg: float | str | Sequence[float] = 0.0
    vessel_spread: float = 0.0
    load: float | Sequence[float] = 1.0
    suite: SensorSuite | str | None = None
    faults: str | Sequence[Disturbance] = "none"
    task: str | type = "path"
    reward_weights: Mapping[str, float] | None = None
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
        check_number("vessel_spread", self.vessel_spread, 0.0, SPREAD_MAX)
        if self.wind_from_deg is not None:
            self.wind_span()
        self.load_span(), self.current_spans(), self.heading_span()
        if self.motion_penalty is not None:
            check_number("motion_penalty", self.motion_penalty, 0.0, PENALTY_MAX)
        if self.deck_point is not None:
            _check_point(self.deck_point)
            if self.dof != 6:
                raise UsvTwinError(
                    f"deck_point = {self.deck_point!r}: the deck of a boat with dof={self.dof} "
                    "does not move; use dof=6, or leave it out"
                )
            object.__setattr__(self, "deck_point", tuple(map(float, self.deck_point)))
        if not isinstance(self.reward_weights, Mapping | None):
            raise UsvTwinError(
                f"reward_weights = {self.reward_weights!r}: must be a dict of terms and numbers"
            )
        substeps_of(self.dt, self.dt_physics)

    def wind_span(self) -> Span | None:
        """Return the range of directions that the wind comes from, degrees; None: not drawn."""
        given = self.wind_from_deg
        if given is None:
            return None
        span = _span("wind_from_deg", given, DEGREES)
        return None if is_finite(given) else span

    def load_span(self) -> Span:
        """Return the range of factors of the mass."""
        return _span("load", self.load, LOADS)

    def heading_span(self) -> Span:
        """Return the range of headings at the start, degrees."""
        return _span("heading_deg", self.heading_deg, DEGREES)

    def current_spans(self) -> tuple[Span, Span] | None:
        """Return the ranges of the current's speed, m/s, and direction, degrees; None: not set."""
        given: Any = self.current
        if given is None:
            return None
        if isinstance(given, str) or is_finite(given):
            given = given, "any"
        if not isinstance(given, Sequence) or len(given) != 2:
            raise UsvTwinError(
                f"current = {given!r}: give a speed (m/s), (speed, to) with degrees, or 'any'; "
                "each of the two may be a range (low, high) or 'any'"
            )
        speed, to = given
        if isinstance(speed, str) and speed == "any":
            speed = CURRENT_ANY
        return _span("current[0]", speed, CURRENTS), _span("current[1]", to, DEGREES)

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
        angle: Any = self.wind_from_deg
        wind_from = math.radians(angle % 360.0) if is_finite(angle) else None
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
