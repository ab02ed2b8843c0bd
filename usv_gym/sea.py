"""Sea states: what they are called, and one realisation of one of them."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from usv_gym.physics import GRAVITY, ship, waves, wind
from usv_gym.vessel import Vessel

__all__ = ["SEA_STATES", "Sea", "SeaError", "SeaState"]

GUST_COMPONENTS = 32
_GUST_BAND_HZ = (1.0 / 600.0, 0.5)


class SeaError(ValueError):
    """A sea state that cannot be; the message names the value and the remedy."""


@dataclass(frozen=True, kw_only=True)
class SeaState:
    """Waves, wind and current, as statistics.

    Parameters
    ----------
    hs : float
        Significant wave height, m; Pierson-Moskowitz, long-crested.
    wind : float
        Mean wind speed 10 m above the sea, m/s.
    wind_from : float
        Direction that the wind comes from, rad clockwise from north.
    wave_to : float or None
        Direction that the waves go to, rad; None: down the wind.
    current, current_to : float
        Speed (m/s) and direction (rad) of the current.
    components : int
        Number of wave components.
    gusty : bool
        Gusts of the NPD spectrum on top of the mean wind.
    """

    hs: float = 0.0
    wind: float = 0.0
    wind_from: float = math.radians(135.0)
    wave_to: float | None = None
    current: float = 0.0
    current_to: float = 0.0
    components: int = 100
    gusty: bool = True

    def __post_init__(self) -> None:
        for item in dataclasses.fields(self):
            value = getattr(self, item.name)
            number = isinstance(value, (int, float, np.number))
            if value is not None and not (number and math.isfinite(value)):
                raise SeaError(f"{item.name} = {value!r}: must be a finite number")
        if self.components != int(self.components):
            raise SeaError(f"components = {self.components}: must be a whole number")
        for name, top in (("hs", 20.0), ("wind", 75.0), ("current", 10.0)):
            value = getattr(self, name)
            if not 0.0 <= value <= top:
                raise SeaError(f"{name} = {value}: must lie between 0 and {top:g}")
        if not 1 <= self.components <= 10_000:
            raise SeaError(f"components = {self.components}: must lie between 1 and 10000")

    @classmethod
    def named(cls, name: str | int | SeaState) -> SeaState:
        """Return a sea state by its name in :data:`SEA_STATES` (or the one handed in)."""
        if isinstance(name, SeaState):
            return name
        if isinstance(name, int):
            name = str(name)
        try:
            return SEA_STATES[name]
        except (KeyError, TypeError):
            raise SeaError(
                f"no sea state is called {name!r}; known: {', '.join(SEA_STATES)}"
            ) from None

    def replace(self, **changes: float | None) -> SeaState:
        """Return the sea state with some values changed; None leaves a value as it is."""
        given = {key: value for key, value in changes.items() if value is not None}
        return dataclasses.replace(self, **given)  # type: ignore[arg-type]

    def realise(
        self, vessel: Vessel, rng_waves: np.random.Generator, rng_gusts: np.random.Generator
    ) -> Sea:
        """Draw one sea.

        Parameters
        ----------
        vessel : Vessel
            Its draft and length decide how deep the pressure reaches and which waves it
            reflects.
        rng_waves, rng_gusts : numpy.random.Generator
            Sources of the phases.

        Returns
        -------
        Sea
        """
        steady = np.zeros(ship.STEADY_SIZE)
        steady[ship.WIND_SPEED] = self.wind
        steady[ship.WIND_FROM] = self.wind_from
        steady[ship.CURRENT_NORTH] = self.current * math.cos(self.current_to)
        steady[ship.CURRENT_EAST] = self.current * math.sin(self.current_to)
        components = self._waves(vessel, rng_waves, steady[ship.DRIFT :])
        return Sea(waves=components, gusts=self._gusts(rng_gusts), steady=steady)

    def _waves(self, vessel: Vessel, rng: np.random.Generator, drift: np.ndarray) -> np.ndarray:
        if self.hs == 0.0:
            return np.zeros((waves.WAVE_ROWS, 0))
        M = self.components
        # one frequency at random in each bin of equal energy: never repeats
        quantiles = (np.arange(M) + rng.random(M)) / M
        omega, amplitude = waves.pm_equal_energy(self.hs, np.clip(quantiles, 1e-12, 1 - 1e-12))
        k = omega**2 / GRAVITY
        direction = self.wind_from + math.pi if self.wave_to is None else self.wave_to
        rho_g = vessel.values["water_density"] * GRAVITY
        rows = np.zeros((waves.WAVE_ROWS, M))
        rows[waves.OMEGA] = omega
        rows[waves.K_NORTH] = k * math.cos(direction)
        rows[waves.K_EAST] = k * math.sin(direction)
        rows[waves.PHASE] = rng.uniform(0.0, 2.0 * math.pi, M)
        rows[waves.AMPLITUDE] = amplitude
        rows[waves.PRESSURE] = rho_g * amplitude * -np.expm1(-k * vessel.values["draft"]) / k
        rows[waves.BOTTOM] = rho_g * amplitude * np.exp(-k * vessel.values["draft"])
        L = vessel.values["length_waterline"]
        for i, c in enumerate(waves.drift_coefficients_limited(2.0 * math.pi / (k * L))):
            load = 0.5 * rho_g * L ** (1 if i < 2 else 2) * float(np.sum(c)) * amplitude**2
            drift[2 * i : 2 * i + 2] = load * math.cos(direction), load * math.sin(direction)
        return rows

    def _gusts(self, rng: np.random.Generator) -> np.ndarray:
        if self.wind == 0.0 or not self.gusty:
            return np.zeros((3, 0))
        edges = np.geomspace(*_GUST_BAND_HZ, GUST_COMPONENTS + 1)
        f = edges[:-1] + rng.random(GUST_COMPONENTS) * np.diff(edges)
        spectrum = wind.npd_spectrum(f, self.wind)
        phases = rng.uniform(0.0, 2.0 * math.pi, GUST_COMPONENTS)
        return np.stack([2.0 * math.pi * f, phases, np.sqrt(2.0 * spectrum * np.diff(edges))])


@dataclass(frozen=True)
class Sea:
    """One realisation, as the kernels read it.

    Parameters
    ----------
    waves : ndarray, shape (7, M)
        Wave components; rows in :mod:`usv_gym.physics.waves`.
    gusts : ndarray, shape (3, G)
        Circular frequency, phase and amplitude of the gusts.
    steady : ndarray, shape (STEADY_SIZE,)
        Mean wind, current and drift; layout in :mod:`usv_gym.physics.ship`.
    """

    waves: np.ndarray
    gusts: np.ndarray
    steady: np.ndarray


# Wave heights: upper bounds of WMO code 3700. Wind: what fully develops them, except for 2,
# which is the sea of the paper's trials.
SEA_STATES: dict[str, SeaState] = {
    "calm": SeaState(),
    "0": SeaState(),
    "1": SeaState(hs=0.1, wind=2.1),
    "2": SeaState(hs=0.5, wind=4.5),
    "3": SeaState(hs=1.25, wind=7.5),
    "4": SeaState(hs=2.5, wind=10.6),
    "5": SeaState(hs=4.0, wind=13.3),
    "6": SeaState(hs=6.0, wind=16.3),
}
