"""Sea states: what they are called, and one realisation of one of them."""

from __future__ import annotations

import csv
import dataclasses
import gzip
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from usv_gym.physics import GRAVITY, ship, spectra, waves
from usv_gym.physics import weather as wx
from usv_gym.vessel.vessel import Vessel
from usv_kernel.errors import UsvTwinError
from usv_kernel.records import Record

__all__ = [
    "SEA_STATES",
    "Sea",
    "SeaError",
    "SeaState",
    "Spectrum",
    "Stage",
    "choice",
]

Array = NDArray[np.float64]

_T = TypeVar("_T")

SPECTRA = ("pm", "jonswap", "ittc")

DISCRETISATIONS = ("equal-energy", "random-frequency")

GUSTS = (*spectra.GUST_SPECTRA, "none")

GUST_COMPONENTS = 32

_GUST_BAND_HZ = (1.0 / 600.0, 0.5)

# shares of the energy between which random frequencies lie; the tail beyond would thin them
_BAND = np.array([0.001, 0.999])

_TURN = 2.0 * math.pi

STEEPEST = 1.0 / 7.0
"""Height over length at which waves break."""

_RANGES = {
    **{name: (-_TURN, _TURN) for name in ("wind_from", "wave_to", "current_to")},
    "hs": (0.0, 20.0),
    "wind": (0.0, 75.0),
    "current": (0.0, 10.0),
    "components": (1, 10_000),
    "tp": (0.1, 60.0),
    "gamma": (1.0, 10.0),
    "spreading": (0.0, 1000.0),
    "wind_sd": (0.0, 20.0),
    "wind_tau": (1.0, 1e5),
    "wind_from_sd": (0.0, math.pi),
    "wind_from_tau": (1.0, 1e5),
}

_CHOICES = {"spectrum": SPECTRA, "discretisation": DISCRETISATIONS, "gusts": GUSTS}


class SeaError(UsvTwinError):
    """A sea state that cannot be; the message names the value and the remedy."""


@dataclass(frozen=True, eq=False)
class Spectrum:
    """A wave spectrum as a table, straight between its points and nought beyond them.

    Parameters
    ----------
    omega : array_like, shape (n,)
        Rising circular frequency, rad/s; above 0.
    density : array_like, shape (n,)
        Density, m2 s/rad; not below 0.
    """

    omega: Array
    density: Array

    def __post_init__(self) -> None:
        for name in ("omega", "density"):
            object.__setattr__(self, name, np.array(getattr(self, name), dtype=float))
        omega, density = self.omega, self.density
        if not (omega.ndim == 1 and omega.shape == density.shape and len(omega) >= 3):
            raise SeaError(
                f"spectrum of {omega.size} frequencies and {density.size} densities: "
                "must have one density for each of 3 frequencies or more"
            )
        for name, value in (("frequency", omega), ("density", density)):
            if not np.all(np.isfinite(value)):
                row = int(np.argmin(np.isfinite(value))) + 1
                raise SeaError(f"spectrum row {row}: {name} must be a finite number")
        if omega[0] <= 0.0 or np.any(np.diff(omega) <= 0.0):
            rising = np.diff(omega, prepend=0.0) > 0.0
            raise SeaError(
                f"spectrum row {int(np.argmin(rising)) + 1}: frequency must be above 0 and "
                "above that of the row before; sort the rows"
            )
        if np.any(density < 0.0):
            raise SeaError(
                f"spectrum row {int(np.argmax(density < 0.0)) + 1}: density must not be below 0"
            )
        if not np.any(density > 0.0):
            raise SeaError("spectrum of no energy: some density must be above 0")

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Spectrum:
        """Read a spectrum from a CSV file, gzipped or not.

        Parameters
        ----------
        path : path
            Two columns under the header ``frequency_hz,density_m2_per_hz`` or
            ``omega_radps,density_m2s_per_rad``.

        Returns
        -------
        Spectrum
        """
        path = Path(path)
        try:
            raw = path.read_bytes()
            text = (gzip.decompress(raw) if path.suffix == ".gz" else raw).decode("utf-8-sig")
        except (OSError, EOFError, UnicodeDecodeError) as error:
            raise SeaError(f"{path}: cannot be read as a spectrum ({error})") from None
        lines = [line for line in text.splitlines() if not line.startswith("#")]
        rows = [row for row in csv.reader(lines) if row]
        header = ",".join(cell.strip() for cell in rows[0]) if rows else ""
        if header not in _PER_RADIAN:
            raise SeaError(f"{path}: header {header!r} must be {' or '.join(_PER_RADIAN)}")
        for i, row in enumerate(rows[1:], start=1):
            if not _numbers(row):
                raise SeaError(f"{path}: spectrum row {i}: {','.join(row)!r} must be two numbers")
        values = np.array([_numbers(row) for row in rows[1:]]).reshape(-1, 2)
        # many files begin with a row at 0 Hz, which is no wave
        values = values[1:] if len(values) and values[0, 0] == 0.0 else values
        scale = _PER_RADIAN[header]
        try:
            return cls(values[:, 0] * scale, values[:, 1] / scale)
        except SeaError as error:
            raise SeaError(f"{path}: {error}") from None

    @property
    def moments(self) -> spectra.Moments:
        """What the spectrum says: m0, Hs, Tp, Tm01, Tm02."""
        return spectra.moments(self.omega, self.density)

    def refined(self, points: int = 4001) -> Spectrum:
        """Return the same spectrum with points in between, fine enough for its integrals."""
        between = np.linspace(self.omega[0], self.omega[-1], points)
        omega = np.union1d(self.omega, between)
        return Spectrum(omega, np.interp(omega, self.omega, self.density))


def _numbers(row: list[str]) -> list[float]:
    """Return the two numbers of a row; none if it does not hold two."""
    try:
        values = [float(cell) for cell in row]
    except ValueError:
        return []
    return values if len(values) == 2 else []


# header of a spectrum's file: rad/s in one unit of its frequency
_PER_RADIAN = {
    "frequency_hz,density_m2_per_hz": 2.0 * math.pi,
    "omega_radps,density_m2s_per_rad": 1.0,
}


class Stage(NamedTuple):
    """One moment of a course: time (s), Hs (m), wind (m/s) and where it comes from (rad).

    ``wind_from`` of None is that of the sea state.
    """

    time: float
    hs: float
    wind: float
    wind_from: float | None = None


@dataclass(frozen=True, kw_only=True)
class SeaState:
    """Waves, wind and current, as statistics.

    Parameters
    ----------
    hs : float
        Significant wave height, m. With a measured spectrum, 0 stands for that spectrum's
        own height; any other height scales it.
    wind : float
        Mean wind speed 10 m above the sea, m/s.
    wind_from : float
        Direction that the wind comes from, rad clockwise from north.
    wave_to : float or None
        Mean direction that the waves go to, rad; None: down the wind (on a course: the wind
        of the highest waves).
    current, current_to : float
        Speed (m/s) and direction (rad) of the current.
    components : int
        Number of wave components.
    spectrum : str, path or Spectrum
        ``"pm"`` (Pierson-Moskowitz by Hs), ``"jonswap"``, ``"ittc"``, or a measured one: a
        :class:`Spectrum`, or the path of its file (:meth:`Spectrum.read`).
    tp : float or None
        Peak period of ``"jonswap"`` or ``"ittc"``, s; None: that of ``"pm"``.
    gamma : float
        Peak enhancement of ``"jonswap"``.
    discretisation : str
        ``"equal-energy"``: one frequency at random in each of as many bins of equal energy
        as there are components, all amplitudes alike. ``"random-frequency"``: one in each of
        bins of equal ratio of frequencies, with the amplitude of the spectrum there. Neither
        repeats, and both have exactly the height asked for.
    spreading : float or None
        Exponent s of the directional spreading cos^2s, within 90 degrees of the mean, the
        same at all frequencies; None (or infinity): long-crested.
    gusts : str
        Spectrum of the gusts on top of the mean wind: ``"npd"``, ``"harris"``,
        ``"davenport"``, or ``"none"``.
    wind_sd, wind_tau : float
        Standard deviation (m/s) and time constant (s) of the slow Gauss-Markov change of the
        mean wind speed; kept within the mean speed either way.
    wind_from_sd, wind_from_tau : float
        The same for where the wind comes from, rad and s.
    course : sequence of Stage
        Up to eight moments between which Hs and wind change linearly (the direction the
        short way round); before the first and after the last they are held. ``hs`` and
        ``wind`` are then left out, and become the greatest of the course. The waves are one
        realisation at the greatest Hs times a gain: their periods are those of the greatest
        Hs throughout. Gusts are drawn for the greatest wind, and scaled with the wind.
    """

    hs: float = 0.0
    wind: float = 0.0
    wind_from: float = math.radians(135.0)
    wave_to: float | None = None
    current: float = 0.0
    current_to: float = 0.0
    components: int = 100
    spectrum: str | os.PathLike[str] | Spectrum = "pm"
    tp: float | None = None
    gamma: float = 3.3
    discretisation: str = "equal-energy"
    spreading: float | None = None
    gusts: str = "npd"
    wind_sd: float = 0.0
    wind_tau: float = 600.0
    wind_from_sd: float = 0.0
    wind_from_tau: float = 600.0
    course: Sequence[Stage] = ()

    def __post_init__(self) -> None:
        if self.spreading == math.inf:
            object.__setattr__(self, "spreading", None)
        for item in dataclasses.fields(self):
            if item.name not in (*_CHOICES, "course"):
                _check(item.name, getattr(self, item.name), optional=item.default is None)
        if self.components != int(self.components):
            raise SeaError(f"components = {self.components}: must be a whole number")
        self._take_spectrum()
        for name, known in _CHOICES.items():
            value = getattr(self, name)
            if not isinstance(value, Spectrum) and value not in known:
                raise SeaError(f"{name} = {value!r}: unknown; known: {', '.join(known)}")
        if self.tp is not None and self.spectrum not in ("jonswap", "ittc"):
            raise SeaError(
                f"tp = {self.tp}: only the spectra jonswap and ittc take a period of their own"
            )
        if self.spectrum != "jonswap" and self.gamma != type(self).gamma:
            raise SeaError(
                f"gamma = {self.gamma}: only the spectrum jonswap takes a peak enhancement"
            )
        self._take_course()
        if self.tp is not None and self.hs > STEEPEST * GRAVITY * self.tp**2 / _TURN:
            raise SeaError(
                f"hs = {self.hs:g} m with tp = {self.tp:g} s: such waves break; the height must be "
                f"at most {STEEPEST * GRAVITY * self.tp**2 / _TURN:.2g} m (a seventh of the length)"
            )

    def _take_spectrum(self) -> None:
        """Read a measured spectrum from its file, and take its height if none is given."""
        spectrum = self.spectrum
        named = isinstance(spectrum, str) and spectrum in SPECTRA
        if not named and isinstance(spectrum, str) and Path(spectrum).suffix not in (".csv", ".gz"):
            raise SeaError(
                f"spectrum = {spectrum!r}: unknown; known: {', '.join(SPECTRA)}, or the path of "
                "a .csv or .csv.gz file"
            )
        if not named and isinstance(spectrum, str | os.PathLike):
            spectrum = Spectrum.read(spectrum)
            object.__setattr__(self, "spectrum", spectrum)
        if isinstance(spectrum, Spectrum) and self.hs == 0.0 and not self.course:
            object.__setattr__(self, "hs", spectrum.moments.hs)

    def _take_course(self) -> None:
        """Check the course, and take the greatest height and wind from it."""
        try:
            course = tuple(Stage(*stage) for stage in self.course)
        except TypeError:
            raise SeaError(
                f"course = {self.course!r}: must be a sequence of (time, hs, wind) or "
                "(time, hs, wind, wind_from)"
            ) from None
        object.__setattr__(self, "course", course)
        if not course:
            return
        if len(course) > wx.KEYFRAMES:
            raise SeaError(f"course of {len(course)} moments: must have {wx.KEYFRAMES} or fewer")
        for i, stage in enumerate(course):
            for name, value in stage._asdict().items():
                _check(name, value, f"course[{i}].", optional=name == "wind_from")
            if i > 0 and stage.time <= course[i - 1].time:
                raise SeaError(
                    f"course[{i}].time = {stage.time}: must come after {course[i - 1].time}"
                )
        for name in ("hs", "wind"):
            greatest = max(getattr(stage, name) for stage in course)
            if getattr(self, name) not in (0.0, greatest):
                raise SeaError(
                    f"{name} = {getattr(self, name)}: must be left out where a course gives it"
                )
            object.__setattr__(self, name, greatest)

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

    @classmethod
    def any_of(cls, seas: str | int | SeaState | Sequence[str | SeaState]) -> tuple[SeaState, ...]:
        """Return the sea states of which one is to be drawn.

        Parameters
        ----------
        seas : str or SeaState or sequence of them
            A text may hold several names: ``"0|2|4"``.
        """
        if isinstance(seas, str):
            return tuple(cls.named(name.strip()) for name in seas.split("|"))
        if not isinstance(seas, Sequence):
            return (cls.named(seas),)
        if not seas:
            raise SeaError("an empty list of sea states; give one or more")
        return tuple(cls.named(one) for one in seas)

    @classmethod
    def from_wind(cls, wind: float, **others: Any) -> SeaState:
        """Return the sea that a wind fully develops.

        Parameters
        ----------
        wind : float
            Mean wind speed 10 m above the sea, m/s.
        **others
            Further fields of the sea state.

        Notes
        -----
        Source: Eq (15)-(16); PM by wind is PM by the Hs that follows from it.
        """
        _check("wind", wind)
        return cls(hs=spectra.pm_height(wind), wind=wind, **others)

    def replace(self, **changes: Any) -> SeaState:
        """Return the sea state with some values changed; None leaves a value as it is."""
        unknown = set(changes) - {item.name for item in dataclasses.fields(self)}
        if unknown:
            known = ", ".join(item.name for item in dataclasses.fields(self))
            raise SeaError(f"unknown value(s) {', '.join(sorted(unknown))}; known: {known}")
        given = {key: value for key, value in changes.items() if value is not None}
        if "course" in given:  # height and wind are its own
            given = {"hs": 0.0, "wind": 0.0} | given
        return dataclasses.replace(self, **given)

    def wave_spectrum(self) -> Spectrum:
        """Return the spectrum of the waves as a fine table (on a course: of the highest).

        Named spectra are cut off at a quarter of the peak frequency and at 25 times it,
        which leaves out 3e-6 of the energy. Without waves there is none.
        """
        if self.hs == 0.0:
            raise SeaError("hs = 0: a calm sea has no spectrum")
        if isinstance(self.spectrum, Spectrum):
            table = self.spectrum.refined()
            return Spectrum(table.omega, table.density * (self.hs / table.moments.hs) ** 2)
        tp = spectra.pm_peak_period(self.hs) if self.tp is None else self.tp
        omega = np.geomspace(0.25, 25.0, 8001) * (2.0 * math.pi / tp)
        if self.spectrum == "jonswap":
            return Spectrum(omega, spectra.jonswap_spectrum(omega, self.hs, tp, self.gamma))
        # PM is the ITTC spectrum of its own period
        return Spectrum(omega, spectra.ittc_spectrum(omega, self.hs, tp))

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
            Its slow changes of the wind start at the mean;
            :func:`usv_gym.physics.weather.advance_slow_wind` draws and moves them.
        """
        to = self.current_to
        weather = wx.constant(
            wind=self.wind,
            wind_from=self.wind_from,
            north=self.current * math.cos(to),
            east=self.current * math.sin(to),
        )
        weather["speed_sd"], weather["speed_tau"] = self.wind_sd, self.wind_tau
        weather["from_sd"], weather["from_tau"] = self.wind_from_sd, self.wind_from_tau
        weather["changes"] = max(len(self.course) - 1, 0)
        for i, stage in enumerate(self.course):
            gain = stage.hs / self.hs if self.hs > 0.0 else 1.0
            weather["keyframe_t"][i], weather["wave_gain"][i] = stage.time, gain
            weather["wind_speed"][i] = stage.wind
            weather["wind_from"][i] = self._wind_from(stage)
        components = self._waves(vessel, rng_waves, weather["drift_sums"])
        return Sea(waves=components, gusts=self._gusts(rng_gusts), weather=weather)

    def _wind_from(self, stage: Stage) -> float:
        return self.wind_from if stage.wind_from is None else stage.wind_from

    def _components(self, rng: np.random.Generator) -> tuple[Array, Array]:
        """Draw the frequencies (rad/s) of the components, and return their amplitudes (m)."""
        M = self.components
        # one at random in each of M bins, of equal energy or of equal width: never repeats
        within = np.arange(M) + rng.random(M)
        if self.discretisation == "random-frequency":
            table = self.wave_spectrum()
            low, high = spectra.quantile_frequencies(_BAND, table.omega, table.density)
            omega = low * (high / low) ** (within / M)
            # bins of equal ratio: their width grows with the frequency
            share = np.interp(omega, table.omega, table.density) * omega
            return omega, self.hs * np.sqrt(share / (8.0 * np.sum(share)))
        quantiles = np.clip(within / M, 1e-12, 1 - 1e-12)
        if self.spectrum == "pm":
            omega = spectra.pm_equal_energy(self.hs, quantiles)
        else:
            table = self.wave_spectrum()
            omega = spectra.quantile_frequencies(quantiles, table.omega, table.density)
        return omega, np.full(M, self.hs / math.sqrt(8.0 * M))

    def _waves(self, vessel: Vessel, rng: np.random.Generator, drift: Array) -> Array:
        """Draw the wave components, and write the sums of their mean drift."""
        if self.hs == 0.0:
            return np.zeros((waves.WAVE_ROWS, 0))
        omega, amplitude = self._components(rng)
        M = len(omega)
        phase = rng.uniform(0.0, 2.0 * math.pi, M)
        to = self.wave_to
        if to is None:
            highest = max(self.course, key=lambda stage: stage.hs, default=None)
            to = math.pi + (self.wind_from if highest is None else self._wind_from(highest))
        aside = np.zeros(M)
        if self.spreading is not None:
            from scipy.special import betaincinv  # takes a while, and few seas need it

            # (1 + sin)/2 of a cos^2s direction has a beta distribution; one direction at
            # random in each of M bins of equal energy, dealt out to the frequencies
            shape, shares = self.spreading + 0.5, (rng.permutation(M) + rng.random(M)) / M
            aside = np.arcsin(2.0 * betaincinv(shape, shape, shares) - 1.0)
        north = math.cos(to) * np.cos(aside) - math.sin(to) * np.sin(aside)
        east = math.sin(to) * np.cos(aside) + math.cos(to) * np.sin(aside)
        rows, drift[:] = wave_rows(vessel, omega, amplitude, north, east, phase)
        return rows

    def _gusts(self, rng: np.random.Generator) -> Array:
        if self.wind == 0.0 or self.gusts == "none":
            return np.zeros((3, 0))
        edges = np.geomspace(*_GUST_BAND_HZ, GUST_COMPONENTS + 1)
        f = edges[:-1] + rng.random(GUST_COMPONENTS) * np.diff(edges)
        spectrum = spectra.GUST_SPECTRA[self.gusts](f, self.wind)
        phases = rng.uniform(0.0, 2.0 * math.pi, GUST_COMPONENTS)
        return np.stack([2.0 * math.pi * f, phases, np.sqrt(2.0 * spectrum * np.diff(edges))])


def _check(name: str, value: object, where: str = "", *, optional: bool = False) -> None:
    """Refuse a number that is none, or out of its range; None passes where it is optional."""
    if value is None and optional:
        return
    number = isinstance(value, int | float | np.number) and not isinstance(value, bool)
    if not (number and math.isfinite(value)):  # type: ignore[arg-type]
        raise SeaError(f"{where}{name} = {value!r}: must be a finite number")
    low, high = _RANGES.get(name, (-math.inf, math.inf))
    if not low <= value <= high:  # type: ignore[operator]
        hint = " (in rad: math.radians(90) is from or to the east)" if high == _TURN else ""
        raise SeaError(f"{where}{name} = {value}: must lie between {low:g} and {high:g}{hint}")


def wave_rows(
    vessel: Vessel,
    omega: ArrayLike,
    amplitude: ArrayLike,
    north: ArrayLike,
    east: ArrayLike,
    phase: ArrayLike,
) -> tuple[Array, Array]:
    """Return wave components as the kernels read them, and the sums of their mean drift.

    Parameters
    ----------
    vessel : Vessel
        Its draft and length decide how deep the pressure reaches and which waves it reflects.
    omega, amplitude : array_like, shape (M,)
        Circular frequency (rad/s) and amplitude (m).
    north, east : array_like, shape (M,)
        Parts of the unit vector that each component goes along.
    phase : array_like, shape (M,)
        Phase at the origin at time 0, rad.

    Returns
    -------
    ndarray, shape (7, M), and ndarray, shape (6,)
    """
    omega, amplitude, north, east, phase = np.broadcast_arrays(
        *(np.atleast_1d(np.asarray(a, float)) for a in (omega, amplitude, north, east, phase))
    )
    k = omega**2 / GRAVITY
    rho_g, draft = vessel.values["water_density"] * GRAVITY, vessel.values["draft"]
    rows = np.zeros((waves.WAVE_ROWS, len(k)))
    rows[waves.OMEGA], rows[waves.AMPLITUDE], rows[waves.PHASE] = omega, amplitude, phase
    rows[waves.K_NORTH], rows[waves.K_EAST] = k * north, k * east
    rows[waves.PRESSURE] = rho_g * amplitude * -np.expm1(-k * draft) / k
    rows[waves.BOTTOM] = k * np.exp(-k * draft) / -np.expm1(-k * draft)
    L, drift = vessel.values["length_waterline"], np.zeros(waves.DRIFT_SUMS)
    for i, c in enumerate(waves.drift_coefficients_limited(2.0 * math.pi / (k * L))):
        load = 0.5 * rho_g * L ** (1 if i < 2 else 2) * c * amplitude**2
        drift[2 * i : 2 * i + 2] = np.sum(load * north), np.sum(load * east)
    return rows, drift


@dataclass(frozen=True)
class Sea:
    """One realisation, as the kernels read it.

    Parameters
    ----------
    waves : ndarray, shape (7, M)
        Wave components; rows in :mod:`usv_gym.physics.waves`.
    gusts : ndarray, shape (3, G)
        Circular frequency, phase and amplitude of the gusts.
    weather : record of :data:`usv_gym.physics.weather.WEATHER`
        Schedule, current, mean drift and slow wind.
    """

    waves: Array
    gusts: Array
    weather: Record

    @classmethod
    def calm(cls) -> Sea:
        """Return still water without wind."""
        empty = np.zeros((waves.WAVE_ROWS, 0))
        return cls(waves=empty, gusts=np.zeros((3, 0)), weather=wx.constant())

    @classmethod
    def regular(
        cls, vessel: Vessel, omega: float, amplitude: float, to: float = 0.0, phase: float = 0.0
    ) -> Sea:
        """Return a sea of one regular wave, without wind or mean drift.

        Parameters
        ----------
        vessel : Vessel
            The vessel that is to feel it.
        omega, amplitude : float
            Circular frequency (rad/s) and amplitude (m).
        to : float
            Direction that the wave goes to, rad.
        phase : float
            Phase at the origin at time 0, rad.
        """
        rows, _ = wave_rows(vessel, omega, amplitude, math.cos(to), math.sin(to), phase)
        return dataclasses.replace(cls.calm(), waves=rows)

    def arrays(self) -> ship.Sea:
        """Return the arrays that the ship's kernels take, with scratch of their own."""
        scratch = waves.factor_workspace(self.waves.shape[1])
        return ship.Sea(self.waves, self.gusts, self.weather, scratch)

    def elevation(self, x: ArrayLike, y: ArrayLike, t: ArrayLike) -> Array:
        """Return the height of the sea surface above rest in m, as the boat feels it.

        Parameters
        ----------
        x, y : array_like
            Places, m north and east.
        t : array_like
            Times, s; all three are broadcast against each other.

        Returns
        -------
        ndarray
            Of the shape that they have in common.
        """
        x, y, t = np.broadcast_arrays(*(np.asarray(value, dtype=float) for value in (x, y, t)))
        out = np.zeros(x.size)
        wx.surface(x.ravel(), y.ravel(), t.ravel(), self.waves, self.weather, out)
        return out.reshape(x.shape)


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


def choice(options: Sequence[_T], rng: np.random.Generator) -> _T:
    """Return one of some options, by chance where there are several."""
    return options[0] if len(options) == 1 else options[int(rng.integers(len(options)))]
