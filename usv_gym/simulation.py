"""n boats in n seas with their sensors: all that happens in the world, without any API."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from usv_gym import sensors
from usv_gym.physics import frames as fr
from usv_gym.physics import ship
from usv_gym.physics.waves import FACTOR_ROWS
from usv_gym.sea import SeaState
from usv_gym.sensors import Fault, SensorSuite
from usv_gym.vessel import Vessel
from usv_kernel import kernel

__all__ = ["Simulation", "SimulationError"]

NOISE_BLOCK = 512
"""Control steps of sensor noise that are drawn at a time."""


class SimulationError(ValueError):
    """A simulation that cannot be set up; the message names the argument and the remedy."""


@kernel
def _advance(
    states: np.ndarray,
    cmds: np.ndarray,
    p: np.ndarray,
    waves: np.ndarray,
    gusts: np.ndarray,
    steady: np.ndarray,
    t: np.ndarray,
    count: np.ndarray,
    dt: float,
    substeps: int,
    factors: np.ndarray,
    work: np.ndarray,
    suite: np.ndarray,
    noise: np.ndarray,
    faults: np.ndarray,
    bias: np.ndarray,
    ring: np.ndarray,
    z: np.ndarray,
) -> None:
    """Advance every boat by one control step and let its sensors measure."""
    h = dt / substeps
    for i in range(states.shape[0]):
        for j in range(substeps):
            ship.step(
                states[i],
                cmds[i],
                p,
                waves[i],
                gusts[i],
                steady[i],
                t[i] + j * h,
                h,
                factors[i],
                work[i],
            )
        count[i] += 1
        t[i] = count[i] * dt  # whole multiples of the step do not drift
        sensors.measure(
            states[i],
            work[i, 0],
            t[i],
            count[i],
            dt,
            suite,
            noise[i, count[i] % noise.shape[1]],
            faults[i],
            bias[i],
            ring[i],
            z[i],
        )


class Simulation:
    """n boats of one kind, each in a sea of its own.

    Parameters
    ----------
    n : int
        Number of boats.
    vessel : Vessel
        The kind of boat.
    sea : SeaState
        The sea state; each boat gets its own realisation at each reset.
    suite : SensorSuite
        Errors and rates of the sensors.
    faults : sequence of Fault or callable
        Losses of sensors, the same for every boat, or a function of a generator that draws
        them anew at each reset.
    max_faults : int
        Most faults that the function returns.
    dt : float
        Control step, s.
    dt_physics : float
        Integration step, s; dt must be a whole multiple of it.

    Attributes
    ----------
    state : ndarray, shape (n, 16)
        True state; layout in :mod:`usv_gym.physics.frames`.
    z : ndarray, shape (n, 8)
        What the sensors said last; order of :data:`usv_gym.sensors.CHANNELS`.
    cmd : ndarray, shape (n, 4)
        Command of the last step.
    t : ndarray, shape (n,)
        Time since reset, s.
    """

    def __init__(
        self,
        n: int,
        vessel: Vessel,
        sea: SeaState,
        *,
        suite: SensorSuite | None = None,
        faults: Sequence[Fault] | Callable[[np.random.Generator], Sequence[Fault]] = (),
        max_faults: int = 4,
        dt: float = 0.05,
        dt_physics: float = 0.05,
    ) -> None:
        substeps = round(dt / dt_physics) if dt_physics > 0 else 0
        if not (dt > 0 and substeps >= 1 and math.isclose(substeps * dt_physics, dt)):
            raise SimulationError(
                f"dt = {dt} s must be a whole multiple of dt_physics = {dt_physics} s"
            )
        self.n, self.vessel, self.sea, self.dt, self.substeps = n, vessel, sea, dt, substeps
        self.suite = SensorSuite() if suite is None else suite
        self._draw_faults = faults if callable(faults) else None
        fixed = () if callable(faults) else tuple(faults)
        max_faults = max_faults if callable(faults) else len(fixed)
        quiet = np.random.default_rng(0)
        example = sea.realise(vessel, quiet, quiet)
        self.state = np.zeros((n, fr.STATE_SIZE))
        self.cmd = np.zeros((n, fr.COMMAND_SIZE))
        self.t = np.zeros(n)
        self.z = np.full((n, len(sensors.CHANNELS)), math.nan)
        self.count = np.zeros(n, dtype=np.int64)
        self._p = vessel.packed.copy()
        self.waves = np.zeros((n, *example.waves.shape))
        self.gusts = np.zeros((n, *example.gusts.shape))
        self.steady = np.zeros((n, *example.steady.shape))
        self._factors = np.zeros((n, FACTOR_ROWS, self.waves.shape[2]))
        self._work = np.zeros((n, ship.WORK_ROWS, fr.STATE_SIZE))
        self._suite = self.suite.pack(dt)
        self._noise = np.zeros((n, NOISE_BLOCK, sensors.NOISE_SIZE))
        self._faults = np.full((n, max_faults, 3), math.nan)
        if fixed:
            self._faults[:] = sensors.fault_windows(fixed)
        self._bias = np.zeros((n, sensors.BIAS_SIZE))
        self._ring = np.zeros((n, self.suite.delay_steps(dt) + 1, 4))
        self._noise_rngs: list[tuple[np.random.Generator, ...]] = [()] * n
        self._start_speed = vessel.straight_speed(vessel.values["shaft_speed_manoeuvring"])

    def reset(self, boats: Sequence[int], rngs: Sequence[np.random.Generator]) -> None:
        """Put some boats back to the start: straight ahead, at the manoeuvring speed.

        Parameters
        ----------
        boats : sequence of int
            Which boats.
        rngs : sequence of numpy.random.Generator
            One for each of them. Waves, gusts, GPS, compass, IMU and faults each get a
            child, so that switching one off leaves the others as they were.
        """
        n_start = self.vessel.values["shaft_speed_manoeuvring"]
        for i, rng in zip(boats, rngs, strict=True):
            rng_waves, rng_gusts, rng_gps, rng_compass, rng_imu, rng_faults = rng.spawn(6)
            sea = self.sea.realise(self.vessel, rng_waves, rng_gusts)
            self.waves[i], self.gusts[i], self.steady[i] = sea.waves, sea.gusts, sea.steady
            self._noise_rngs[i] = (rng_gps, rng_compass, rng_imu)
            self._refill(i)
            if self._draw_faults is not None:
                windows = sensors.fault_windows(tuple(self._draw_faults(rng_faults)))
                self._faults[i] = math.nan
                self._faults[i, : len(windows)] = windows
            self.state[i] = 0.0
            self.state[i, fr.U] = self._start_speed
            self.state[i, fr.N_LEFT] = self.state[i, fr.N_RIGHT] = n_start
            self.cmd[i] = n_start, n_start, 0.0, 0.0
            self.t[i], self.count[i] = 0.0, 0
            self._ring[i] = 0.0
            self._work[i] = 0.0
            noise = self._noise[i, 0]
            sensors.start_biases(self._suite, noise, self._bias[i])
            sensors.measure(
                self.state[i],
                self._work[i, 0],
                0.0,
                0,
                0.0,
                self._suite,
                noise,
                self._faults[i],
                self._bias[i],
                self._ring[i],
                self.z[i],
            )

    def step(self, cmd: np.ndarray) -> None:
        """Advance every boat by one control step.

        Parameters
        ----------
        cmd : ndarray, shape (n, 4)
            Left and right shaft speed (rev/s), left and right drive angle (rad); finite.
        """
        self.cmd[:] = cmd
        for i in range(self.n):
            if (self.count[i] + 1) % NOISE_BLOCK == 0:
                self._refill(i)
        _advance(
            self.state,
            self.cmd,
            self._p,
            self.waves,
            self.gusts,
            self.steady,
            self.t,
            self.count,
            self.dt,
            self.substeps,
            self._factors,
            self._work,
            self._suite,
            self._noise,
            self._faults,
            self._bias,
            self._ring,
            self.z,
        )

    def _refill(self, i: int) -> None:
        """Draw the next block of sensor noise of one boat, each sensor from its own source."""
        rng_gps, rng_compass, rng_imu = self._noise_rngs[i]
        a, b = sensors.NOISE_GPS, sensors.NOISE_GPS + sensors.NOISE_COMPASS
        self._noise[i, :, :a] = rng_gps.standard_normal((NOISE_BLOCK, sensors.NOISE_GPS))
        self._noise[i, :, a:b] = rng_compass.standard_normal((NOISE_BLOCK, sensors.NOISE_COMPASS))
        self._noise[i, :, b:] = rng_imu.standard_normal((NOISE_BLOCK, sensors.NOISE_IMU))
