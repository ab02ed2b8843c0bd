"""n boats in n seas with their sensors, stepped together."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from usv_gym.physics import frames as fr
from usv_gym.physics import ship
from usv_gym.physics import weather as wx
from usv_gym.physics.waves import LOAD_HEADINGS, LOAD_ROWS, OMEGA, WAVE_ROWS, factor_workspace
from usv_gym.vessel.runaway import check_motion
from usv_gym.vessel.vessel import BoatClass, Vessel
from usv_gym.world import anemometer, sensors
from usv_gym.world.faults import CHANNELS, FAULT, STRUCK, Disturbance, drive, strike
from usv_gym.world.realisation import Sea, load_rows
from usv_gym.world.sea import SeaState
from usv_gym.world.sensors import SensorSuite
from usv_gym.world.start import DriftTable, FaultSets, Seas, draw_sea, draw_start
from usv_gym.world.state import (
    BOAT,
    SIMULATION,
    VESSEL,
    WORLD,
    fault_arrays,
    sea_arrays,
    sensor_arrays,
)
from usv_gym.world.streams import NOISE_STREAMS, Streams, spawned
from usv_kernel.arrays import alloca_f64, shaped, take
from usv_kernel.errors import UsvTwinError, check_number, check_whole
from usv_kernel.jit import inlined, kernel
from usv_kernel.random import fill_normal, start_stream
from usv_kernel.records import Record, as_record, field_at, record_size, structured
from usv_kernel.simd import padded

__all__ = [
    "RunawayError",
    "Simulation",
    "SimulationError",
    "advance",
]

DONE, NOT_FINITE, RAN_AWAY = range(3)
"""Result of a step: done; not done, as actions were not finite;
done, but a boat has run away."""

DT_RANGE = 1e-4, 10.0
"""Range of control and integration steps, s."""

SUBSTEPS_MAX = 1000
"""Most integration steps in a control step."""

BOATS_MAX = 100_000
"""Most boats; they take some 20 kB each, and 0.3 MB more in six degrees of freedom with a table."""

WORK_MAX = 20_000
"""Most integration steps in one call of a kernel, about a second in a sea of 1000 components:
Ctrl-C is heard between calls."""

STATE_MAX = 1e9
"""Bound of every entry of a plausible state, SI units."""

START_MAX_M = 1e6
"""Farthest start from the origin along each axis, m."""

_GPS, _COMPASS, _IMU, _MOTION, _WIND, _WEATHER = range(len(NOISE_STREAMS))

_KIND_AT = field_at(WORLD, "kind")
_SEA_AT = field_at(WORLD, "sea")

_COMPASS_AT, _GYRO_AT = (field_at(sensors.NOISE, name) for name in ("compass", "gyro"))
_NUMBERS = (
    sensors.NOISE_SIZE + sensors.MOTION_NOISE_SIZE + anemometer.WIND_NOISE_SIZE + wx.NOISE_SIZE
)
"""Random numbers of a control step, those of six degrees of freedom and an anemometer included."""


class SimulationError(UsvTwinError):
    """A simulation that cannot be set up; the message names the argument and the remedy."""


class RunawayError(SimulationError):
    """A boat whose state is no longer plausible; the message names boat and time."""


def substeps_of(dt: float, dt_physics: float) -> int:
    """Return the integration steps in a control step; SimulationError names the range."""
    check_number("dt", dt, *DT_RANGE, SimulationError)
    check_number("dt_physics", dt_physics, *DT_RANGE, SimulationError)
    substeps = round(dt / dt_physics)
    if not (1 <= substeps <= SUBSTEPS_MAX and math.isclose(substeps * dt_physics, dt)):
        raise SimulationError(
            f"dt = {dt!r} s must be a whole multiple of dt_physics = {dt_physics!r} s, at most "
            f"{SUBSTEPS_MAX} times it"
        )
    return substeps


@kernel
def advance(row: np.ndarray, config: Record, factors: np.ndarray) -> bool:
    """Advance one boat, a row of :mod:`usv_gym.world.state`, by one control step, with sensors.

    Return whether its state is still plausible. Its command is read. ``factors`` (16, width) is
    scratch, from :func:`usv_gym.physics.waves.factor_workspace`.
    """
    boat = as_record(row, BOAT)
    waves, gusts, loads = sea_arrays(row, config)
    sea = ship.Sea(waves, gusts, boat.weather, factors, loads)
    arrays, drives = (*fault_arrays(row, config), *sensor_arrays(row, config)), alloca_f64(4)
    drive(boat.command, arrays[0], drives)
    vessel = ship.Ship(boat.vessel, config.dof)
    h = config.dt / config.substeps
    step = int(boat.step) + 1
    noise = _draw_noise(boat.streams, config, alloca_f64(_NUMBERS))
    wx.advance_slow_wind(boat.weather, config.dt, noise.weather[0], noise.weather[1])
    mean, rate = boat.mean_rate, boat.work[0]
    mean[:] = 0.0
    for j in range(config.substeps):
        ship.step(boat.state, drives, vessel, sea, boat.t + j * h, h, boat.work)
        for i in range(fr.STATE_SIZE):
            mean[i] += rate[i] / config.substeps
    boat.step = step
    boat.t = step * config.dt  # whole multiples of the step do not drift
    _measure(config.dt, boat, config, noise, gusts, arrays)
    sound = True
    for i in range(fr.STATE_SIZE):
        sound = sound and abs(boat.state[i]) < STATE_MAX
    return sound


class _Noise(NamedTuple):
    """Standard normal numbers of a control step."""

    sensors: Any  # (14,) see sensors.NOISE
    motion: Any  # (13,) see sensors.MOTION_NOISE; (0,) with three degrees of freedom
    wind: Any  # (4,) see anemometer.WIND_NOISE; (0,) without an anemometer
    weather: Any  # (2,) of the slow wind


@inlined
def _draw_noise(streams, config, numbers):
    """Draw noise into scratch, each kind from its generator."""
    own, at = take(numbers, 0, (sensors.NOISE_SIZE,))
    motion, at = take(numbers, at, (sensors.MOTION_NOISE_SIZE if config.dof == 6 else 0,))
    wind_size = anemometer.WIND_NOISE_SIZE if config.suite.wind_share > 0.0 else 0
    wind, at = take(numbers, at, (wind_size,))
    weather, at = take(numbers, at, (wx.NOISE_SIZE,))
    fill_normal(streams[_GPS], own[:_COMPASS_AT])
    fill_normal(streams[_COMPASS], own[_COMPASS_AT:_GYRO_AT])
    fill_normal(streams[_IMU], own[_GYRO_AT:])
    fill_normal(streams[_MOTION], motion)
    fill_normal(streams[_WIND], wind)
    fill_normal(streams[_WEATHER], weather)
    return _Noise(own, motion, wind, weather)


@inlined
def _measure(dt, boat, config, noise, gusts, arrays):
    """Let the sensors measure, and report the command; then faults strike both."""
    faults, memory, delay_line, wind_line = arrays
    if noise.wind.shape[0] > 0:
        air = wx.air_velocity(boat.t, gusts, boat.weather)
        anemometer.measure_wind(boat, air, config.suite, noise.wind, wind_line)
    sensors.measure(boat, dt, config.suite, noise.sensors, noise.motion, delay_line)
    for k in range(fr.COMMAND_SIZE):
        boat.reported[k] = boat.command[k]
    if faults.shape[0] > 0:
        _strike(boat, faults, memory)


@kernel
def _strike(boat, faults, memory):
    """Apply the faults to measurements and reported commands."""
    z = alloca_f64(STRUCK)
    for j in range(CHANNELS):
        z[j] = boat.measurement[j]
    for k in range(fr.COMMAND_SIZE):
        z[CHANNELS + k] = boat.reported[k]
    strike(boat.t, int(boat.step), faults, boat.sensors.last, memory, z)
    for j in range(CHANNELS):
        boat.measurement[j] = z[j]
    for k in range(fr.COMMAND_SIZE):
        boat.reported[k] = z[CHANNELS + k]


@kernel
def _advance_all(rows: np.ndarray, shared: np.ndarray, factors: np.ndarray) -> int:
    """Advance every boat."""
    sound = True
    for i in range(rows.shape[0]):
        sound = advance(rows[i], as_record(shared, SIMULATION), factors) and sound
    return DONE if sound else RAN_AWAY


@kernel
def _start(
    row: np.ndarray, world: np.ndarray, shared: np.ndarray, states: np.ndarray, factors: np.ndarray
) -> None:
    """Put a boat to its start, draw its slow wind, and let its sensors begin.

    ``world`` is flat memory of WORLD, ``states`` (6 or more, 4) start its generators. With six
    degrees of freedom it is set on the surface of its sea.
    """
    boat, config = as_record(row, BOAT), as_record(shared, SIMULATION)
    arrays = (*fault_arrays(row, config), *sensor_arrays(row, config))
    for i in range(boat.streams.shape[0]):
        start_stream(states[i], boat.streams[i])
    boat.t = boat.step = 0.0
    for i in range(fr.STATE_SIZE):
        boat.state[i] = boat.mean_rate[i] = 0.0
        for j in range(ship.WORK_ROWS):
            boat.work[j, i] = 0.0
    begin, state = as_record(world, WORLD), boat.state
    state[fr.X], state[fr.Y], state[fr.PSI] = begin.x, begin.y, begin.heading
    state[fr.U] = begin.speed
    state[fr.N_LEFT] = state[fr.N_RIGHT] = begin.shaft_speed
    for i in range(fr.COMMAND_SIZE):
        boat.command[i] = state[fr.N_LEFT + i]
    arrays[2][:] = 0.0
    arrays[3][:] = 0.0
    if config.dof == 6:
        float_on_sea(row, config, factors)
    noise = _draw_noise(boat.streams, config, alloca_f64(_NUMBERS))
    wx.advance_slow_wind(boat.weather, math.inf, noise.weather[0], noise.weather[1])
    sensors.start_sensors(config.suite, noise.sensors, boat.sensors)
    if config.dof == 6:
        sensors.start_motion_sensors(config.suite, noise.motion, boat.sensors)
    if noise.wind.shape[0] > 0:
        anemometer.start_wind(config.suite, noise.wind, boat.sensors)
    gusts = shaped(row, config.gusts_at, (3, config.gust_components))
    _measure(0.0, boat, config, noise, gusts, arrays)


@kernel
def float_on_sea(row: np.ndarray, config: Record, factors: np.ndarray) -> None:
    """Set a boat on the surface of its sea."""
    boat = as_record(row, BOAT)
    waves, gusts, loads = sea_arrays(row, config)
    sea = ship.Sea(waves, gusts, boat.weather, factors, loads)
    ship.float_on(boat.state, boat.vessel, sea)


def parts_of(n: int, substeps: int, threads: int = 1) -> list[slice]:
    """Return the boats of each call of a kernel: a part for each thread, and none too long."""
    count = max(min(threads, n), -(-n * substeps // WORK_MAX))
    parts = np.array_split(np.arange(n), min(count, n))
    return [slice(int(part[0]), int(part[-1]) + 1) for part in parts]


class Simulation:
    """n boats of one kind, each in a sea of its own.

    Parameters
    ----------
    n : int
        Number of boats.
    vessel : str or Path or Vessel
        The kind of boat.
    sea : str or SeaState or sequence of them
        The sea state; each boat gets its own realisation at each reset. Of several, as in
        ``"0|2|4"``, one is drawn then.
    suite : str or SensorSuite, optional
        Errors and rates of the sensors.
    faults : sequence of Disturbance or FaultSets
        Faults of sensors, commands and thrusters: the same for every boat, or sets of which one is
        drawn at each reset.
    kinds : sequence of BoatClass, optional
        Kinds of boats, of which ``vessel`` is the first, see ``worlds``.
    dof : int
        Degrees of freedom: 3 (surge, sway, yaw) or 6 (and heave, roll, pitch).
    dt : float
        Control step, s.
    dt_physics : float
        Integration step, s; dt must be a whole multiple of it.
    changing : bool
        Whether other seas than these will follow: see :meth:`change_sea`.

    Attributes
    ----------
    state : ndarray, shape (n, 16)
        True state; layout in :mod:`usv_gym.physics.frames`.
    z : ndarray, shape (n, 17)
        What the sensors said last; order of :data:`usv_kernel.channels.SENSOR_CHANNELS`,
        ``MOTION_CHANNELS`` and ``WIND_CHANNELS``. Those of the motion are NaN with three degrees of
        freedom, those of the wind without an anemometer.
    cmd : ndarray, shape (n, 4)
        Command of the last step.
    reported : ndarray, shape (n, 4)
        The same as a twin is told of it: with faults of the commands.
    t : ndarray, shape (n,)
        Time since reset, s.
    faults : ndarray of FAULT, shape (n, F)
        Faults of this episode, see :func:`usv_gym.world.faults.fault_records`; those that are not
        used start at NaN.
    worlds : ndarray of WORLD, shape (n,)
        What the next episode of each boat begins with, a view of ``world_rows``. Whoever changes a
        boat's kind or factors writes its parameters, ``boats["vessel"]``, as well.
    boats : ndarray of BOAT, shape (n,)
        All of the above by name, see :data:`usv_gym.world.state.BOAT`; a view of ``rows``.
    rows : ndarray
        What the kernels take; see :mod:`usv_gym.world.state`.
    config, shared : record of SIMULATION, ndarray
        What all boats share, and the same as flat memory for kernels.
    """

    def __init__(
        self,
        n: int,
        vessel: str | Path | Vessel,
        sea: str | SeaState | Sequence[str | SeaState],
        *,
        suite: str | SensorSuite | None = None,
        faults: Sequence[Disturbance] | FaultSets = (),
        kinds: Sequence[BoatClass] | None = None,
        dof: int = 3,
        dt: float = 0.05,
        dt_physics: float = 0.05,
        changing: bool = False,
    ) -> None:
        substeps = substeps_of(dt, dt_physics)
        if isinstance(dof, bool) or not isinstance(dof, (int, np.integer)) or dof not in (3, 6):
            raise SimulationError(f"dof = {dof!r}: must be 3 or 6")
        check_whole("n", n, 1, BOATS_MAX, SimulationError)
        vessel, suite = Vessel.load(vessel), SensorSuite.of(suite)
        check_motion(vessel, dof, dt_physics)
        self.seas = SeaState.any_of(sea)
        self.dof = int(dof)
        self.n, self.vessel, self.dt, self.substeps = n, vessel, dt, substeps
        self.suite = suite
        if not isinstance(faults, FaultSets):
            known = isinstance(faults, Sequence)
            if not (known and all(isinstance(fault, Disturbance) for fault in faults)):
                raise SimulationError(
                    f"faults = {faults!r}: give a sequence of usv_gym.Fault and the like "
                    "(usv_gym.world.faults.parse_faults reads a text)"
                )
            faults = FaultSets([faults])
        self.fault_sets, self._faults = faults, faults.arrays(dt)
        self.kinds = tuple(kinds) if kinds else (BoatClass(vessel, 0.0),)
        if self.kinds[0].vessel is not vessel:
            name = self.kinds[0].vessel.name
            raise SimulationError(f"vessel = {vessel.name}: must be the first of kinds, {name}")
        seas = (*self.seas, SeaState(hs=1.0, wind=1.0)) if changing else self.seas
        width = padded(max(sea.wave_components for sea in seas))
        tabled = dof == 6 and vessel.hydro is not None and width > 0
        shapes = {
            "waves": (WAVE_ROWS, width),
            "gusts": (3, max(sea.gust_components for sea in seas)),
            "loads": (LOAD_HEADINGS if tabled else 0, LOAD_ROWS, width),
            "faults": (faults.most, record_size(FAULT)),
            "fault_memory": (faults.memory_rows(dt), 1 + STRUCK),
            "delay_line": (self.suite.delay_rows(dt), sensors.DELAYED),
            "wind_line": (suite.wind_rows(dt), anemometer.WIND_ROWS),
        }
        ends = np.cumsum([record_size(BOAT), *map(math.prod, shapes.values())])
        self.rows = np.zeros((n, ends[-1]))
        self._parts = [self.rows[part] for part in parts_of(n, substeps)]
        at = dict(zip(shapes, ends[:-1].tolist(), strict=True))
        parts = {
            name: self.rows[:, at[name] : at[name] + math.prod(shape)].reshape(n, *shape)
            for name, shape in shapes.items()
        }
        self.waves, self.gusts = parts["waves"], parts["gusts"]
        self._loads = parts["loads"]
        self.faults = parts["faults"].view(FAULT)[..., 0]
        self.boats = structured(self.rows, BOAT)
        self.state, self.cmd = self.boats["state"], self.boats["command"]
        self.reported = self.boats["reported"]
        self.z, self.weather, self.t = (
            self.boats["measurement"],
            self.boats["weather"],
            self.boats["t"],
        )
        self.z[:] = math.nan
        self.faults["start"] = math.nan
        shared = np.zeros(1, SIMULATION)
        config = shared[0]
        config["dt"], config["substeps"], config["dof"] = dt, substeps, dof
        config["suite"] = self.suite.pack(dt)
        self.boats["vessel"][:] = vessel.packed
        for name, begin in at.items():
            config[f"{name}_at"] = begin
        config["wave_components"], config["gust_components"] = width, shapes["gusts"][1]
        config["load_headings"] = shapes["loads"][0]
        config["wind_rows"] = shapes["wind_line"][0]
        config["fault_count"], config["delay_rows"] = faults.most, shapes["delay_line"][0]
        config["fault_memory_rows"] = shapes["fault_memory"][0]
        self.config, self.shared = config, shared.view(float)
        self.factors = factor_workspace(shapes["waves"][1])
        """Scratch of the kernels that advance boats; threads need copies."""
        self._not_reset = set(range(n))
        self.world_rows = np.zeros((n, record_size(WORLD)))
        self.worlds = structured(self.world_rows, WORLD)
        self.worlds["load"] = self.worlds["factors"] = 1.0
        first = self.kinds[0]
        self.worlds["speed"], self.worlds["shaft_speed"] = first.speed, first.shaft_speed
        for name in ("wind_from", "current_north", "current_east"):
            self.worlds[name] = math.nan
        self.sea_tables = Seas.of(self.seas)
        # kernels take plain tuples from Python much faster
        self._seas = tuple(self.sea_tables)
        self._tables: list[Any] = [tuple(DriftTable.of(kind.vessel)) for kind in self.kinds]
        self._scratch = np.zeros((4, 8), np.uint64)

    def vessel_of(self, i: int) -> Vessel:
        """Return the vessel of boat i in this episode."""
        world = self.worlds[i]
        return self.kinds[int(world["kind"])].boat(world["factors"], self.rows[i, VESSEL])

    def reset(
        self,
        boats: Sequence[int],
        rngs: Sequence[np.random.Generator],
        *,
        speed: float | None = None,
        heading: float = 0.0,
        at: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        """Reset some boats to the start: straight ahead, by default at the manoeuvring speed.

        With six degrees of freedom they begin on the surface of the sea, moving with it. Waves,
        gusts, GPS, compass, IMU, anemometer and faults each get a child of the boat's generator. So
        switching one off leaves the others as they were.

        Parameters
        ----------
        boats : sequence of int
            Which boats.
        rngs : sequence of numpy.random.Generator
            A generator for each of them.
        speed : float, optional
            Speed ahead over ground, m/s, with the shaft speed that keeps it in calm water; 0 is
            at rest with stopped shafts. Default: that of the manoeuvring shaft speed.
        heading : float
            Clockwise from north, rad.
        at : tuple of float
            Place, m north and east.

        Raises
        ------
        SimulationError
            Names the boat, generator or number that cannot be used.
        """
        start = self._checked_start(speed, heading, at)
        boats, rngs = list(boats), list(rngs)
        if len(boats) != len(rngs) or not set(boats) <= set(range(self.n)):
            raise SimulationError(
                f"reset of boats {boats} with {len(rngs)} generator(s): boats count from 0 to "
                f"{self.n - 1}, and each needs one generator"
            )
        for rng in rngs:
            if not isinstance(rng, np.random.Generator):
                raise SimulationError(
                    f"{rng!r} is no generator; use numpy.random.default_rng(seed)"
                )
        for i, rng in zip(boats, rngs, strict=True):
            for name, value in start.items():
                self.worlds[name][i] = value
            self.begin(int(i), spawned(rng, wind=self.suite.has_anemometer))

    def begin(self, i: int, streams: Streams) -> None:
        """Put boat i to its start, as its ``worlds`` say, with random numbers of its own."""
        self._not_reset.discard(i)
        row, world, states = self.rows[i], self.world_rows[i], streams.states
        kind = int(world[_KIND_AT])
        table, seas = self._tables[kind], self._seas
        draw_start(row, world, self.shared, states, seas, table, self._faults, self._scratch)
        self._fill_loads(i, self.seas[int(world[_SEA_AT])])
        _start(row, world, self.shared, states, self.factors)

    def _checked_start(
        self, speed: float | None, heading: float, at: tuple[float, float]
    ) -> dict[str, float]:
        """Return what boats begin with, by the names of WORLD."""
        check_number("heading", heading, -math.tau, math.tau, SimulationError)
        if np.shape(at) != (2,):
            raise SimulationError(f"at = {at!r}: must be two numbers, m north and east")
        for number in at:
            check_number("at", number, -START_MAX_M, START_MAX_M, SimulationError)
        u, n = self.kinds[0].speed, self.kinds[0].shaft_speed
        if speed is not None:
            most = self.vessel.values["shaft_speed_max"]
            top = self.vessel.straight_speed(most)
            check_number("speed", speed, 0.0, top, SimulationError)
            u, n = speed, self.vessel.shaft_speed_for(speed)
        return {"x": at[0], "y": at[1], "heading": heading, "speed": u, "shaft_speed": n}

    def change_sea(self, i: int, sea: str | SeaState, rng: np.random.Generator) -> None:
        """Put boat i into another sea, from now on until its reset.

        With six degrees of freedom it is set on the new surface, moving with it. The slow changes
        of the wind begin at its mean.
        """
        new = SeaState.named(sea)
        for kind, array, count in (
            ("waves", self.waves, new.wave_components),
            ("gusts", self.gusts, new.gust_components),
        ):
            if count > array.shape[2]:
                raise SimulationError(
                    f"change_sea: {count} components of {kind}, but space for {array.shape[2]}: "
                    "make the simulation with changing=True, or with a sea of as many components"
                )
        world, states = self.world_rows[i : i + 1].copy(), spawned(rng, wind=False).states
        for name in ("wind_from", "current_north", "current_east"):
            structured(world, WORLD)[name] = math.nan
        table, seas = self._tables[int(world[0, _KIND_AT])], tuple(Seas.of([new]))
        draw_sea(self.rows[i], world[0], self.shared, states, seas, table, self._scratch)
        self._fill_loads(i, new)
        if self.dof == 6:
            float_on_sea(self.rows[i], self.config, self.factors)

    def sea(self, i: int) -> Sea:
        """Return the sea of boat i as it was drawn for this episode, a copy."""
        count = np.count_nonzero(self.waves[i, OMEGA])
        waves, gusts = self.waves[i, :, :count].copy(), self.gusts[i].copy()
        return Sea(waves, gusts, self.weather[i].copy(), self.vessel_of(i))

    def _fill_loads(self, i: int, state: SeaState) -> None:
        """Write the loads of the waves of a sea state on boat i."""
        if self._loads.shape[1] == 0:
            return
        drawn = self.waves[i, :, : state.wave_components]
        loads, self._loads[i] = load_rows(self.vessel_of(i), drawn), 0.0
        self._loads[i, : len(loads), :, : loads.shape[2]] = loads

    def step(self, cmd: np.ndarray) -> None:
        """Advance every boat by one control step with finite commands (n, 4), rev/s and rad."""
        if self._not_reset:
            raise SimulationError("call reset() for every boat before step()")
        cmd = np.asarray(cmd, dtype=float)
        if cmd.shape != self.cmd.shape or not np.isfinite(cmd).all():
            raise SimulationError(
                f"cmd of shape {cmd.shape}: must be finite numbers of shape {self.cmd.shape}"
            )
        self.cmd[:] = cmd
        for rows in self._parts:
            if _advance_all(rows, self.shared, self.factors) == RAN_AWAY:
                raise self.runaway()

    def runaway(self) -> RunawayError:
        """Return the error of the boat whose state is no longer plausible."""
        sound = (np.abs(self.state) < STATE_MAX).all(axis=1)
        i = int(np.argmin(sound))
        return RunawayError(
            f"boat {i} ({self.vessel.name}) ran away after {self.t[i]:.6g} s: its state is no "
            "longer finite. Check its coefficients with usv-twin vessel check, take a smaller "
            "dt_physics or a calmer sea, and reset"
        )
