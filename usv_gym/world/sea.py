"""Sea states: what they are called, and one realisation of one of them."""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from usv_gym.physics import GRAVITY, spectra
from usv_gym.physics import weather as wx
from usv_gym.world.realisation import GUST_COMPONENTS
from usv_gym.world.recorded_spectrum import SeaError, Spectrum
from usv_kernel.errors import is_finite
from usv_kernel.records import Record

__all__ = [
    "DRIFT_WAVES",
    "GUSTS",
    "SEA_STATES",
    "SeaKeyframe",
    "SeaState",
]

Array = NDArray[np.float64]

SPECTRA = ("pm", "jonswap", "ittc")

DISCRETISATIONS = ("equal-energy", "random-frequency")

GUSTS = (*spectra.GUST_SPECTRA, "none")

# shares of the energy between which random frequencies lie; the tail beyond would thin them
_BAND = np.array([0.001, 0.999])

DRIFT_WAVES = 200
"""Waves whose mean drift is summed."""

_TURN = 2.0 * math.pi

SMALLEST = 1e-6
"""Smaller heights (m) and speeds (m/s) count as 0: their spectra would have no energy."""

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


class SeaKeyframe(NamedTuple):
    """One moment of a schedule: time (s), Hs (m), wind (m/s) and where it comes from (rad).

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
        Mean direction that the waves go to, rad; None: down the wind (on a schedule: the wind
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
    schedule : sequence of SeaKeyframe
        Up to eight moments between which Hs and wind change linearly (the direction the short way
        round). Before the first and after the last they are held. ``hs`` and ``wind`` are then left
        out, and become the greatest of the schedule. The waves are one realisation at the greatest
        Hs times a gain: their periods are those of the greatest Hs throughout. Gusts are drawn for
        the greatest wind, and scaled with the wind.
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
    schedule: Sequence[SeaKeyframe] = ()

    def __post_init__(self) -> None:
        if isinstance(self.spreading, float) and self.spreading == math.inf:
            object.__setattr__(self, "spreading", None)
        for item in dataclasses.fields(self):
            if item.name not in (*_CHOICES, "schedule"):
                _check(item.name, getattr(self, item.name), optional=item.default is None)
        for name in ("hs", "wind", "current"):
            if 0.0 < getattr(self, name) < SMALLEST:
                object.__setattr__(self, name, 0.0)
        if self.components != int(self.components):
            raise SeaError(f"components = {self.components}: must be a whole number")
        self._read_spectrum()
        for name, known in _CHOICES.items():
            value = getattr(self, name)
            if isinstance(value, Spectrum):
                continue
            if not isinstance(value, str) or value not in known:
                raise SeaError(f"{name} = {value!r}: unknown; known: {', '.join(known)}")
        if self.tp is not None and self.spectrum not in ("jonswap", "ittc"):
            raise SeaError(
                f"tp = {self.tp}: only the spectra jonswap and ittc take a period of their own"
            )
        if self.spectrum != "jonswap" and self.gamma != type(self).gamma:
            raise SeaError(
                f"gamma = {self.gamma}: only the spectrum jonswap takes a peak enhancement"
            )
        self._check_schedule()
        if self.tp is not None and self.hs > STEEPEST * GRAVITY * self.tp**2 / _TURN:
            raise SeaError(
                f"hs = {self.hs:g} m with tp = {self.tp:g} s: such waves break; the height must be "
                f"at most {STEEPEST * GRAVITY * self.tp**2 / _TURN:.2g} m (a seventh of the length)"
            )

    def _read_spectrum(self) -> None:
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
        if isinstance(spectrum, Spectrum) and self.hs == 0.0 and not self.schedule:
            object.__setattr__(self, "hs", spectrum.moments.hs)

    def _check_schedule(self) -> None:
        """Check the schedule, and take the greatest height and wind from it."""
        try:
            schedule = tuple(SeaKeyframe(*keyframe) for keyframe in self.schedule)
        except TypeError:
            raise SeaError(
                f"schedule = {self.schedule!r}: must be a sequence of (time, hs, wind) or "
                "(time, hs, wind, wind_from)"
            ) from None
        object.__setattr__(self, "schedule", schedule)
        if not schedule:
            return
        if len(schedule) > wx.KEYFRAMES:
            raise SeaError(
                f"schedule of {len(schedule)} moments: must have {wx.KEYFRAMES} or fewer"
            )
        for i, keyframe in enumerate(schedule):
            for name, value in keyframe._asdict().items():
                _check(name, value, f"schedule[{i}].", optional=name == "wind_from")
            if i > 0 and keyframe.time <= schedule[i - 1].time:
                raise SeaError(
                    f"schedule[{i}].time = {keyframe.time}: must come after {schedule[i - 1].time}"
                )
        for name in ("hs", "wind"):
            greatest = max(getattr(keyframe, name) for keyframe in schedule)
            if getattr(self, name) not in (0.0, greatest):
                raise SeaError(
                    f"{name} = {getattr(self, name)}: must be left out where a schedule gives it"
                )
            object.__setattr__(self, name, greatest)

    @classmethod
    def named(cls, name: str | int | SeaState | Mapping[str, Any]) -> SeaState:
        """Return a sea state by its name in :data:`SEA_STATES` (or the one handed in)."""
        if isinstance(name, SeaState):
            return name
        if isinstance(name, Mapping):  # the table of its fields, as in spec.to_json()
            if unknown := set(name) - {each.name for each in dataclasses.fields(cls)}:
                raise SeaError(f"a sea state has no field {min(unknown)!r}")
            return cls(**name)
        if isinstance(name, int):
            name = str(name)
        try:
            return SEA_STATES[name]
        except (KeyError, TypeError):
            raise SeaError(
                f"no sea state is called {name!r}; known: {', '.join(SEA_STATES)}; | parts several"
            ) from None

    @classmethod
    def any_of(cls, seas: str | int | SeaState | Sequence[str | SeaState]) -> tuple[SeaState, ...]:
        """Return the sea states of which one is to be drawn; a text may hold several: ``0|2|4``."""
        if isinstance(seas, str):
            return tuple(cls.named(name.strip()) for name in seas.split("|"))
        if not isinstance(seas, Sequence):
            return (cls.named(seas),)
        if not seas:
            raise SeaError("an empty list of sea states; give one or more")
        return tuple(cls.named(one) for one in seas)

    @classmethod
    def from_wind(cls, wind: float, **others: Any) -> SeaState:
        """Return the sea that a mean wind (m/s, at 10 m) fully develops, with further fields.

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
        if "schedule" in given:  # height and wind are its own
            given = {"hs": 0.0, "wind": 0.0} | given
        return dataclasses.replace(self, **given)

    def turned(self, wind_from: float) -> SeaState:
        """Return the sea state with all its wind turned, to come from ``wind_from`` (rad)."""
        turn = wind_from - self.wind_from
        schedule = [
            one if one.wind_from is None else one._replace(wind_from=(one.wind_from + turn) % _TURN)
            for one in self.schedule
        ]
        return self.replace(wind_from=wind_from, schedule=schedule or None)

    def wave_spectrum(self) -> Spectrum:
        """Return the spectrum of the waves as a fine table (on a schedule: of the highest).

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

    @property
    def wave_components(self) -> int:
        """How many components its waves have."""
        return int(self.components) if self.hs > 0.0 else 0

    @property
    def gust_components(self) -> int:
        """How many components its gusts have."""
        return GUST_COMPONENTS if self.wind > 0.0 and self.gusts != "none" else 0

    @property
    def is_closed_form(self) -> bool:
        """Whether its frequencies follow from shares of the energy without a table."""
        return self.spectrum == "pm" and self.discretisation == "equal-energy"

    @cached_property
    def _table(self) -> tuple[Spectrum, Array]:
        """The spectrum as a table, and the share of the energy below each of its points."""
        table = self.wave_spectrum()
        return table, spectra.energy_shares(table.omega, table.density)

    @cached_property
    def mean_weather(self) -> Record:
        """Weather without waves' drift and without current."""
        weather = wx.constant(wind=self.wind, wind_from=self.wind_from)
        weather["speed_sd"], weather["speed_tau"] = self.wind_sd, self.wind_tau
        weather["from_sd"], weather["from_tau"] = self.wind_from_sd, self.wind_from_tau
        weather["changes"] = max(len(self.schedule) - 1, 0)
        for i, keyframe in enumerate(self.schedule):
            gain = keyframe.hs / self.hs if self.hs > 0.0 else 1.0
            weather["keyframe_t"][i], weather["wave_gain"][i] = keyframe.time, gain
            weather["wind_speed"][i] = keyframe.wind
            weather["wind_from"][i] = self._wind_from(keyframe)
        return weather

    @property
    def waves_to(self) -> float:
        """Mean direction that the waves go to, rad."""
        if self.wave_to is not None:
            return self.wave_to
        highest = max(self.schedule, key=lambda keyframe: keyframe.hs, default=None)
        return math.pi + (self.wind_from if highest is None else self._wind_from(highest))

    @cached_property
    def drift_waves(self) -> tuple[Array, Array, Array]:
        """Waves whose mean drift is summed: frequencies, amplitudes (m), directions off the mean.

        The drift of a sea is that of its spectrum. The few short components of one realisation
        would make it a matter of chance for small boats.
        """
        table = self._table[0]
        step = 0.5 * np.diff(table.omega) * (table.density[1:] + table.density[:-1])
        energy = np.concatenate([[0.0], np.cumsum(step)])
        edges = np.geomspace(table.omega[0], table.omega[-1], DRIFT_WAVES + 1)
        amplitude = np.sqrt(2.0 * np.diff(np.interp(edges, table.omega, energy)))
        # the golden section deals out directions evenly, whatever part of the waves counts
        shares = (0.5 + 0.6180339887498949 * np.arange(DRIFT_WAVES, dtype=float)) % 1.0
        aside = (
            np.interp(shares, *self.directions) if self.directions.size else np.zeros(len(shares))
        )
        return np.sqrt(edges[1:] * edges[:-1]), amplitude, aside

    @cached_property
    def directions(self) -> Array:
        """Shares (2, P) of the energy that goes further left than directions off the mean, rad."""
        if self.spreading is None:
            return np.zeros((2, 0))
        from scipy.special import betainc  # takes a while, and few seas need it

        # (1 + sin)/2 of a cos^2s direction has a beta distribution
        aside, shape = np.linspace(-0.5 * math.pi, 0.5 * math.pi, 2001), self.spreading + 0.5
        return np.stack([betainc(shape, shape, 0.5 + 0.5 * np.sin(aside)), aside])

    @cached_property
    def frequencies(self) -> Array:
        """What components are drawn of: uniform numbers, frequencies and relative energies (3, P).

        A component of a number x has the frequency (rad/s) that stands there beside x, and a share
        of the energy by the third row. P = 0 where closed form gives both, or without waves.
        """
        if self.hs == 0.0 or self.is_closed_form:
            return np.zeros((3, 0))
        table, shares = self._table
        if self.discretisation == "equal-energy":
            return np.stack([shares, table.omega, np.ones(len(shares))])
        low, high = np.interp(_BAND, shares, table.omega)
        # bins of equal ratio: their width grows with the frequency
        number = np.log(table.omega / low) / math.log(high / low)
        return np.stack([number, table.omega, table.density * table.omega])

    def _wind_from(self, keyframe: SeaKeyframe) -> float:
        return self.wind_from if keyframe.wind_from is None else keyframe.wind_from


def _check(name: str, value: object, where: str = "", *, optional: bool = False) -> None:
    """Refuse a number that is none, or out of its range; None passes where it is optional."""
    if value is None and optional:
        return
    if not is_finite(value):
        raise SeaError(f"{where}{name} = {value!r}: must be a finite number")
    low, high = _RANGES.get(name, (-math.inf, math.inf))
    if not low <= value <= high:  # type: ignore[operator]
        hint = " (in rad: math.radians(90) is from or to the east)" if high == _TURN else ""
        raise SeaError(f"{where}{name} = {value}: must lie between {low:g} and {high:g}{hint}")


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
    # sea 2, with 10 m/s more wind for 20 s that veers by 40 degrees; and on its way to sea 3
    "squall": SeaState(
        schedule=(
            SeaKeyframe(85.0, 0.5, 4.5),
            SeaKeyframe(90.0, 0.5, 14.5, math.radians(175.0)),
            SeaKeyframe(105.0, 0.5, 14.5, math.radians(175.0)),
            SeaKeyframe(110.0, 0.5, 4.5),
        )
    ),
    "building": SeaState(schedule=(SeaKeyframe(40.0, 0.5, 4.5), SeaKeyframe(100.0, 1.25, 7.5))),
}
"""Sea states by name; the last two change as time goes on, see :class:`SeaKeyframe`."""
