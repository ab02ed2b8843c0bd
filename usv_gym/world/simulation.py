"""n boats in n seas with their sensors: all that happens in the world, without any API."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from usv_gym.physics import frames as fr
from usv_gym.physics import parameters as par
from usv_gym.physics import ship
from usv_gym.physics import weather as wx
from usv_gym.physics.waves import WAVE_ROWS, factor_room
from usv_gym.vessel.vessel import Vessel
from usv_gym.world import sensors
from usv_gym.world.sea import Sea, SeaState, choice
from usv_gym.world.sensors import Disturbance, SensorSuite
from usv_kernel.arrays import shaped
from usv_kernel.errors import UsvTwinError
from usv_kernel.jit import inlined, kernel
from usv_kernel.simd import padded

__all__ = [
    "Simulation",
    "SimulationError",
]

NOISE_ROWS = 512, 128
"""Control steps of noise that are drawn at a time: for one boat, and for each of many."""


class SimulationError(UsvTwinError):
    """A simulation that cannot be set up; the message names the argument and the remedy."""


# one row of numbers per boat: where each part begins
STATE = 0

CMD = STATE + fr.STATE_SIZE

Z = CMD + fr.COMMAND_SIZE

BIAS = Z + len(sensors.CHANNELS)

WEATHER = BIAS + sensors.MEMORY_SIZE

TIME = WEATHER + wx.WEATHER_SIZE

COUNT = TIME + 1

NOISE_UNTIL = COUNT + 1  # the step for which no noise has been drawn yet

WORK = NOISE_UNTIL + 1

MEAN_RATE = WORK + ship.WORK_ROWS * fr.STATE_SIZE

RECORD_SIZE = MEAN_RATE + fr.STATE_SIZE

# then parts whose size hangs on sea, faults and delay: their places and sizes in the layout
WAVES, COMPONENTS, GUSTS, GUST_COMPONENTS = 0, 1, 2, 3

NOISE, BLOCK, NOISE_WIDTH, FAULTS, MAX_FAULTS, RING, RING_ROWS, ROW_SIZE = 4, 5, 6, 7, 8, 9, 10, 11

# what all boats share: control step in s, integration steps in it, degrees of freedom, then the
# packed vessel and the packed sensor suite
STEP, SUBSTEPS, DOF, VESSEL = 0, 1, 2, 3

SUITE = VESSEL + par.PACKED_SIZE


@inlined
def sea_parts(boat: np.ndarray, layout: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return waves (7, M) and gusts (3, G) of a boat's row, as views."""
    M, G = layout[COMPONENTS], layout[GUST_COMPONENTS]
    waves = shaped(boat, layout[WAVES], (WAVE_ROWS, M))
    return waves, shaped(boat, layout[GUSTS], (3, G))


@inlined
def sensor_parts(boat: np.ndarray, layout: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return noise (B, W), faults (F, FAULT_SIZE) and delay line (D, 4) of a row, as views."""
    B, W, F, D = layout[BLOCK], layout[NOISE_WIDTH], layout[MAX_FAULTS], layout[RING_ROWS]
    width = sensors.FAULT_SIZE
    noise = shaped(boat, layout[NOISE], (B, W))
    faults = shaped(boat, layout[FAULTS], (F, width))
    return noise, faults, shaped(boat, layout[RING], (D, 4))


@kernel
def advance(
    boat: np.ndarray, layout: np.ndarray, constants: np.ndarray, factors: np.ndarray
) -> None:
    """Advance one boat by one control step and let its sensors measure.

    Parameters
    ----------
    boat : ndarray, shape (layout[ROW_SIZE],)
        All numbers of the boat; parts as named above. The command is read from it.
    layout : ndarray of int, shape (12,)
        Places and sizes of the parts that follow the record.
    constants : ndarray, shape (SUITE + ...,)
        What all boats share.
    factors : ndarray, shape (13, M)
        Scratch, from :func:`usv_gym.physics.waves.factor_room`.
    """
    state, cmd = boat[STATE:CMD], boat[CMD:Z]
    work = shaped(boat, WORK, (ship.WORK_ROWS, fr.STATE_SIZE))
    waves, gusts = sea_parts(boat, layout)
    noise, faults, ring = sensor_parts(boat, layout)
    p, suite = constants[VESSEL:SUITE], constants[SUITE:]
    dt, substeps, dof = constants[STEP], int(constants[SUBSTEPS]), int(constants[DOF])
    h = dt / substeps
    count = int(boat[COUNT]) + 1
    normal = noise[count % noise.shape[0]]
    weather = boat[WEATHER:TIME]
    wx.drift_on(weather, dt, normal[normal.size - 2], normal[normal.size - 1])
    mean = boat[MEAN_RATE:RECORD_SIZE]
    mean[:] = 0.0
    for j in range(substeps):
        t = boat[TIME] + j * h
        ship.step(state, cmd, p, waves, gusts, weather, t, h, dof, factors, work)
        for i in range(fr.STATE_SIZE):
            mean[i] += work[0, i] / substeps
    boat[COUNT] = count
    boat[TIME] = count * dt  # whole multiples of the step do not drift
    sensors.measure(
        *(state, mean, boat[TIME], count, dt, suite, normal, faults),
        *(boat[BIAS:WEATHER], ring, boat[Z:BIAS]),
    )


@kernel
def out_of_noise(boats: np.ndarray) -> bool:
    """Return whether some boat needs a new block of noise before its next step."""
    out = False
    for i in range(boats.shape[0]):
        out = out or boats[i, COUNT] + 1.0 >= boats[i, NOISE_UNTIL]
    return out


@kernel
def _advance_all(
    boats: np.ndarray, layout: np.ndarray, constants: np.ndarray, factors: np.ndarray
) -> bool:
    """Advance every boat; return False, with nothing done, if noise is to be drawn first."""
    if out_of_noise(boats):
        return False
    for i in range(boats.shape[0]):
        advance(boats[i], layout, constants, factors)
    return True


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
    faults : sequence of Disturbance or callable
        Faults of sensors, the same for every boat, or a function of a generator that draws
        them anew at each reset.
    max_faults : int
        Most faults that the function returns.
    dof : int
        Degrees of freedom: 3 (surge, sway, yaw) or 6 (and heave, roll, pitch).
    dt : float
        Control step, s.
    dt_physics : float
        Integration step, s; dt must be a whole multiple of it.
    changing : bool
        Whether to make room for other seas than these: see :meth:`change_sea`.

    Attributes
    ----------
    state : ndarray, shape (n, 16)
        True state; layout in :mod:`usv_gym.physics.frames`.
    z : ndarray, shape (n, 8)
        What the sensors said last; order of :data:`usv_gym.world.sensors.CHANNELS`.
    cmd : ndarray, shape (n, 4)
        Command of the last step.
    t : ndarray, shape (n,)
        Time since reset, s.
    faults : ndarray, shape (n, F, FAULT_SIZE)
        Faults of sensors of this episode, as :func:`usv_gym.world.sensors.fault_rows` gives them; NaN
        where there are fewer.
    """

    def __init__(
        self,
        n: int,
        vessel: str | Path | Vessel,
        sea: str | SeaState | Sequence[str | SeaState],
        *,
        suite: str | SensorSuite | None = None,
        faults: (
            Sequence[Disturbance] | Callable[[np.random.Generator], Sequence[Disturbance]]
        ) = (),
        max_faults: int = 4,
        dof: int = 3,
        dt: float = 0.05,
        dt_physics: float = 0.05,
        changing: bool = False,
    ) -> None:
        sound = math.isfinite(dt) and math.isfinite(dt_physics) and dt_physics > 0
        substeps = round(dt / dt_physics) if sound else 0
        if not (substeps >= 1 and math.isclose(substeps * dt_physics, dt)):
            raise SimulationError(
                f"dt = {dt} s must be a whole multiple of dt_physics = {dt_physics} s"
            )
        if dof not in (3, 6):
            raise SimulationError(f"dof = {dof!r}: must be 3 or 6")
        if not (isinstance(n, (int, np.integer)) and n >= 1):
            raise SimulationError(f"n = {n!r}: must be a whole number of boats, 1 or more")
        vessel, suite = Vessel.load(vessel), SensorSuite.of(suite)
        self.seas = SeaState.any_of(sea)
        self.dof = int(dof)
        self.n, self.vessel, self.dt, self.substeps = n, vessel, dt, substeps
        self.suite = suite
        fixed = () if callable(faults) else tuple(faults)
        if not all(isinstance(fault, Disturbance) for fault in fixed):
            raise SimulationError(
                f"faults = {faults!r}: give a sequence of usv_gym.Fault and the like "
                "(usv_gym.world.sensors.parse_faults reads a text)"
            )
        sensors.fault_rows(fixed, dt)  # what does not fit dies here, not at the first reset
        max_faults = max_faults if callable(faults) else len(fixed)
        self._given_faults = faults if callable(faults) else fixed
        quiet = np.random.default_rng(0)
        seas = (*self.seas, SeaState(hs=1.0, wind=1.0)) if changing else self.seas
        examples = [sea.realise(vessel, quiet, quiet) for sea in seas]
        width = sensors.NOISE_SIZE + sensors.NOISE_FAULT * max_faults + wx.NOISE_SIZE
        self._block = NOISE_ROWS[n > 1]
        shapes = {
            WAVES: (WAVE_ROWS, padded(max(example.waves.shape[1] for example in examples))),
            GUSTS: max(example.gusts.shape for example in examples),
            NOISE: (self._block, width),
            FAULTS: (max_faults, sensors.FAULT_SIZE),
            RING: (self.suite.delay_steps(dt) + 1, 4),
        }
        ends = np.cumsum([RECORD_SIZE, *map(math.prod, shapes.values())])
        self.boats = np.zeros((n, ends[-1]))
        parts = {
            part: self.boats[:, begin:end].reshape(n, *shape)
            for (part, shape), begin, end in zip(shapes.items(), ends[:-1], ends[1:], strict=True)
        }
        self.waves, self.gusts, self._noise = parts[WAVES], parts[GUSTS], parts[NOISE]
        self.faults, self._rings = parts[FAULTS], parts[RING]
        self.records = self.boats[:, :RECORD_SIZE]
        self.state = self.records[:, STATE:CMD]
        self.cmd = self.records[:, CMD:Z]
        self.z = self.records[:, Z:BIAS]
        self.z[:] = math.nan
        self.weather = self.records[:, WEATHER:TIME]
        self.t = self.records[:, TIME]
        self.faults[:] = math.nan
        layout = np.zeros(ROW_SIZE + 1, dtype=np.int64)
        layout[list(shapes)] = ends[:-1]
        layout[[COMPONENTS, GUST_COMPONENTS]] = shapes[WAVES][1], shapes[GUSTS][1]
        layout[[BLOCK, NOISE_WIDTH]] = shapes[NOISE]
        layout[[MAX_FAULTS, RING_ROWS, ROW_SIZE]] = max_faults, shapes[RING][0], ends[-1]
        shared = [dt, substeps, dof], vessel.packed, self.suite.pack(dt)
        self.constants = np.concatenate(shared)
        self.arguments = (self.boats, layout, self.constants, factor_room(shapes[WAVES][1]))
        """What the kernels :func:`advance` and those built on it take, for all boats."""
        self._noise_rngs: list[tuple[np.random.Generator, ...]] = [()] * n
        self._asleep = set(range(n))
        self._start_speed = vessel.straight_speed(vessel.values["shaft_speed_manoeuvring"])

    def reset(self, boats: Sequence[int], rngs: Sequence[np.random.Generator]) -> None:
        """Put some boats back to the start: straight ahead, at the manoeuvring speed.

        With six degrees of freedom they begin on the surface of the sea, moving with it.

        Parameters
        ----------
        boats : sequence of int
            Which boats.
        rngs : sequence of numpy.random.Generator
            One for each of them. Waves, gusts, GPS, compass, IMU and faults each get a
            child, so that switching one off leaves the others as they were.
        """
        n_start = self.vessel.values["shaft_speed_manoeuvring"]
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
            self._asleep.discard(i)
            rng_waves, rng_gusts, rng_gps, rng_compass, rng_imu, *others = rng.spawn(7)
            rng_faults, rng_sea = others
            self._fill(i, choice(self.seas, rng_sea).realise(self.vessel, rng_waves, rng_gusts))
            # a child: with or without gusts, the slow wind is the same
            (rng_weather,) = rng_gusts.spawn(1)
            given = self._given_faults
            faults = tuple(given(rng_faults) if callable(given) else given)
            self.faults[i] = math.nan
            self.faults[i, : len(faults)] = sensors.fault_rows(faults, self.dt)
            sources = sensors.fault_sources(faults, rng_faults)
            self._noise_rngs[i] = (rng_gps, rng_compass, rng_imu, rng_weather, *sources)
            self.records[i, TIME] = self.records[i, COUNT] = self.records[i, NOISE_UNTIL] = 0.0
            self._refill(int(i))
            self.state[i] = 0.0
            self.state[i, fr.U] = self._start_speed
            self.state[i, fr.N_LEFT] = self.state[i, fr.N_RIGHT] = n_start
            self.cmd[i] = n_start, n_start, 0.0, 0.0
            self._float(i)
            self.records[i, WORK:] = 0.0
            self._rings[i] = 0.0
            noise, memory = self._noise[i, 0], self.records[i, BIAS:WEATHER]
            wx.drift_on(self.weather[i], math.inf, *noise[-wx.NOISE_SIZE :])
            suite = self.constants[SUITE:]
            still = np.zeros(fr.STATE_SIZE)
            sensors.start_memory(suite, noise, memory)
            sensors.measure(
                *(self.state[i], still, 0.0, 0, 0.0, suite, noise, self.faults[i], memory),
                *(self._rings[i], self.z[i]),
            )

    def change_sea(
        self, i: int, sea: str | SeaState, rng: np.random.Generator, *, waves: bool = True
    ) -> None:
        """Put boat i into another sea, from now on until its reset.

        With six degrees of freedom it is set on the new surface, moving with it. The slow
        changes of the wind begin at its mean.

        Parameters
        ----------
        i : int
            Which boat.
        sea : str or SeaState
            The new sea state.
        rng : numpy.random.Generator
            For its waves and gusts.
        waves : bool
            Whether the waves change, too; else the wind alone does.
        """
        new = SeaState.named(sea).realise(self.vessel, *rng.spawn(2))
        for kind, room, components in (
            ("waves", self.waves, new.waves),
            ("gusts", self.gusts, new.gusts),
        ):
            if components.shape[1] > room.shape[2]:
                raise SimulationError(
                    f"change_sea: {components.shape[1]} components of {kind}, but there is room "
                    f"for {room.shape[2]}: make the simulation with changing=True, or with a sea "
                    "of as many components"
                )
        self._fill(i, new, waves=waves)
        if waves:
            self._float(i)

    def _fill(self, i: int, sea: Sea, *, waves: bool = True) -> None:
        """Write a sea to the room of boat i, or its wind alone."""
        drift = self.weather[i, wx.DRIFT : wx.DRIFT_END].copy()
        # where seas differ in their number of waves, the rest of the room holds none
        for room, components in ((self.waves, sea.waves), (self.gusts, sea.gusts))[not waves :]:
            room[i] = 0.0
            room[i, :, : components.shape[1]] = components
        self.weather[i] = sea.weather
        if not waves:  # the mean drift is theirs
            self.weather[i, wx.DRIFT : wx.DRIFT_END] = drift

    def _float(self, i: int) -> None:
        """Set boat i on the surface of its sea, where it may heave."""
        if self.dof == 6:
            p, factors = self.constants[VESSEL:SUITE], self.arguments[3]
            ship.float_on(self.state[i], self.waves[i], self.weather[i], p, factors)

    def step(self, cmd: np.ndarray) -> None:
        """Advance every boat by one control step.

        Parameters
        ----------
        cmd : ndarray, shape (n, 4)
            Left and right shaft speed (rev/s), left and right drive angle (rad); finite.
        """
        if self._asleep:
            raise SimulationError("call reset() for every boat before step()")
        cmd = np.asarray(cmd, dtype=float)
        if cmd.shape != self.cmd.shape or not np.isfinite(cmd).all():
            raise SimulationError(
                f"cmd of shape {cmd.shape}: must be finite numbers of shape {self.cmd.shape}"
            )
        self.cmd[:] = cmd
        if not _advance_all(*self.arguments):
            self.draw_noise()
            _advance_all(*self.arguments)

    def draw_noise(self) -> None:
        """Draw the next block of noise of every boat whose block is used up."""
        used_up = self.records[:, COUNT] + 1.0 >= self.records[:, NOISE_UNTIL]
        for i in np.flatnonzero(used_up):
            self._refill(int(i))

    def _refill(self, i: int) -> None:
        """Draw the next block of noise of one boat, each source from its own generator."""
        rng_gps, rng_compass, rng_imu, rng_weather, *rngs_faults = self._noise_rngs[i]
        a, b = sensors.NOISE_GPS, sensors.NOISE_GPS + sensors.NOISE_COMPASS
        c, width = sensors.NOISE_SIZE, sensors.NOISE_FAULT
        noise, rows = self._noise[i], self._block
        noise[:, :a] = rng_gps.standard_normal((rows, sensors.NOISE_GPS))
        noise[:, a:b] = rng_compass.standard_normal((rows, sensors.NOISE_COMPASS))
        noise[:, b:c] = rng_imu.standard_normal((rows, sensors.NOISE_IMU))
        for j, rng in enumerate(rngs_faults):
            noise[:, c + width * j : c + width * (j + 1)] = rng.random((rows, width))
        noise[:, -wx.NOISE_SIZE :] = rng_weather.standard_normal((rows, wx.NOISE_SIZE))
        self.records[i, NOISE_UNTIL] += rows
