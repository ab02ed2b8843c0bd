"""Rows and sections of the validation page, and results that several sections share."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
import polars as pl
from numpy.typing import NDArray
from scipy.signal import welch

from usv_gym.hydro.table import HydroError, HydroTable
from usv_gym.manoeuvring import rao, trials
from usv_gym.manoeuvring.track import Track
from usv_gym.manoeuvring.trials import StandardTrials
from usv_gym.physics import KNOT, ship, spectra, waves
from usv_gym.physics import frames as fr
from usv_gym.physics import weather as wx
from usv_gym.vessel.vessel import Vessel
from usv_gym.world.realisation import Sea
from usv_gym.world.recorded_spectrum import Spectrum
from usv_gym.world.sea import SeaState

__all__ = [
    "KINDS",
    "Row",
    "Section",
    "Study",
    "an_hour",
    "peak_period",
    "realise",
    "rows",
    "shared_folder",
    "under_way",
]

Array = NDArray[np.float64]

DEGREE = math.pi / 180.0

KINDS = ("relative", "absolute", "factor", "below", "reported")
"""Kinds of tolerance; ``below``: an upper bound of the size; ``reported``: not tested."""

SEPARATE = "separate computation"
"""Source of references that other code computed from the same equations."""

ORIGIN = {"origin": 0.0, "heading": 0.0}


@dataclass(frozen=True)
class Row:
    """A computed number and its reference."""

    item: str  # name, with the unit
    value: float | None  # computed value; None if it is skipped or does not exist
    reference: float | None  # published, measured or exact value; None if it is skipped
    tolerance: float | None  # largest difference, see kind; None if the row is only reported
    source: str
    kind: str = "relative"  # one of KINDS
    digits: int = 4  # significant figures on the page
    skipped: str = ""  # reason why there is no value; empty if there is one

    @property
    def ok(self) -> bool | None:
        """Whether the value is within the tolerance; None if that is not tested."""
        value, want, allowed = self.value, self.reference, self.tolerance
        if self.skipped or self.kind == "reported":
            return None
        if value is None or want is None or allowed is None or not math.isfinite(value):
            return False
        if self.kind == "factor":
            return bool(want / allowed <= value <= want * allowed)
        if self.kind == "below":
            return bool(abs(value) < allowed)
        scale = abs(want) if self.kind == "relative" else 1.0
        return bool(abs(value - want) <= allowed * scale)


def rows(
    entries: Iterable[tuple[str, float | None, float | None]],
    source: str,
    tolerance: float | None = None,
    kind: str = "relative",
    digits: int = 4,
) -> list[Row]:
    """Return rows from (item, value, reference) with one source and tolerance; see :class:`Row`."""
    kind = kind if tolerance is not None else "reported"
    return [
        Row(item, value, reference, tolerance, source, kind, digits)
        for item, value, reference in entries
    ]


@dataclass(frozen=True)
class Section:
    """A section of the page: title, text, rows, and captions of pictures by file name."""

    title: str
    text: str
    rows: tuple[Row, ...]
    pictures: dict[str, str] = field(default_factory=dict)


class Recording(NamedTuple):
    """A recorded run of KVLCC2, and the same run of the model."""

    measured: Track
    replayed: Track


class Run(NamedTuple):
    """A recorded run of KVLCC2."""

    title: str
    switch: float
    """Change of heading at which the helm reverses, degrees; 0 for a turning circle."""


RUNS = {
    "marin_tc_35": Run("MARIN 35 deg turn to port", 0.0),
    "marin_zz_10": Run("MARIN 10/10 zigzag, port first", 10.0),
    "marin_zz_20": Run("MARIN 20/20 zigzag, port first", 20.0),
    "hsva_z_10_10_s": Run("HSVA 10/10 zigzag, starboard first", 10.0),
    "hsva_z_20_10_s": Run("HSVA 20/10 zigzag, starboard first", 10.0),
    "hsva_z_05_01": Run("HSVA 5/1 zigzag", 1.0),
    "hsva_z_10_05": Run("HSVA 10/5 zigzag", 5.0),
    "hsva_z_15_05": Run("HSVA 15/5 zigzag", 5.0),
    "hsva_z_30_05": Run("HSVA 30/5 zigzag", 5.0),
}
"""Recorded runs of ``kvlcc2_simman2008`` by file name."""

HEADINGS = {"head": 180.0, "bow-quarter": 135.0, "beam": 90.0, "stern-quarter": 45.0}

SPEEDS = (0.0, 5.58)

CASES = {
    "L7, n = 10.4 rps": ("kvlcc2_l7", 10.4, 1.179),
    "L7, n = 11.85 rps": ("kvlcc2_l7", 11.85, 1.179),
    "full scale, n = 1.53 rps": ("kvlcc2", 1.53, 15.5 * KNOT),
    "full scale, n = 1.778 rps": ("kvlcc2", 1.778, 15.5 * KNOT),
}
"""KVLCC2: vessel, shaft speed (rev/s) and speed of the approach (m/s)."""

JENSEN_HULL = {"length": 6.336, "beam": 2.714, "draft": 0.526, "block": 0.3689}
"""The 7.5 m boat in Jensen's closed forms, m."""

OMEGA = np.concatenate([[0.25, 0.4, 0.6], np.arange(0.8, 3.55, 0.1), np.arange(3.6, 7.1, 0.2)])
"""Wave frequencies of the response amplitudes, rad/s."""


def shared_folder(root: Path) -> Path | None:
    """Return the folder of recorded data, ``../shared`` or ``USV_TWIN_SHARED``; None if missing."""
    folder = Path(os.environ.get("USV_TWIN_SHARED") or root.resolve().parent / "shared")
    return folder if (folder / "data").is_dir() else None


class Study:
    """Results that several sections and pictures share, computed once; ``shared`` may be None."""

    def __init__(self, shared: Path | None) -> None:
        self.shared = shared
        self.boat = Vessel.load("usv75")
        self.model = Vessel.load("kvlcc2_l7")

    def table(self, name: str) -> HydroTable:
        """Return the hydrodynamic table of a vessel of the package, for its own length."""
        vessel = Vessel.load(name)
        if vessel.hydro is None:
            raise HydroError(f"{name} names no hydrodynamic table")
        return vessel.hydro

    def data(self, name: str) -> Path | None:
        """Return a folder of recorded data, None if it is missing."""
        folder = None if self.shared is None else self.shared / "data" / name
        return folder if folder is not None and folder.is_dir() else None

    @cached_property
    def tanker(self) -> dict[str, StandardTrials]:
        """Standard trials of KVLCC2 by case."""
        return {
            name: trials.standard_trials(Vessel.load(vessel), n, speed=speed)
            for name, (vessel, n, speed) in CASES.items()
        }

    @cached_property
    def recordings(self) -> dict[str, Recording]:
        """Recorded runs of KVLCC2 and their replays; empty without the data."""
        folder = self.data("kvlcc2_simman2008")
        if folder is None:
            return {}
        return {name: self._replay(folder / f"{name}.csv.gz") for name in RUNS}

    def _replay(self, path: Path) -> Recording:
        """Run the model from the recorded start with recorded rudder angle and shaft speed."""
        log = pl.read_csv(path)
        names = {"t": "t_s", "x": "x_m", "y": "y_m", "psi": "psi_rad", "u": "u_mps", "v": "v_mps"}
        names |= {"r": "r_radps", "delta": "delta_rad"}
        track = Track(**{ours: log[theirs].to_numpy() for ours, theirs in names.items()})
        shaft = log["n_rps"].to_numpy().astype(float)
        helm = track.helm
        states = np.zeros((len(track.t), fr.STATE_SIZE))
        columns = {"x": fr.X, "y": fr.Y, "psi": fr.PSI, "u": fr.U, "v": fr.V, "r": fr.R}
        for name, column in columns.items():
            states[0, column] = getattr(track, name)[0]
        runner, cmd = BoatInSea(self.model), np.empty(4)
        for k, dt in enumerate(np.diff(track.t)):
            # mean rudder angle and shaft speed of the step
            cmd[:2] = 0.5 * (shaft[k] + shaft[k + 1])
            cmd[2:] = 0.5 * (helm[k] + helm[k + 1])
            states[k + 1] = states[k]
            states[k + 1, fr.N_LEFT :] = cmd
            runner.step(states[k + 1], cmd, float(dt))
        motion = {name: states[:, column] for name, column in columns.items()}
        return Recording(track, Track(t=track.t, delta=helm, **motion))

    @cached_property
    def responses(self) -> dict[tuple[str, float], rao.Response]:
        """Response amplitudes of the 7.5 m boat at :data:`OMEGA` by heading and speed."""
        return {
            (name, speed): rao.responses(self.boat, OMEGA, angle * DEGREE, speed=speed)
            for name, angle in {**HEADINGS, "following": 0.0}.items()
            for speed in SPEEDS
        }

    def jensen(self, heading: str, speed: float, omega: Array = OMEGA) -> tuple[Array, Array]:
        """Return heave (m/m) and pitch (rad/m) of the 7.5 m boat by Jensen's closed forms."""
        angle = {**HEADINGS, "following": 0.0}[heading] * DEGREE
        return rao.jensen(omega, angle, speed=speed, **JENSEN_HULL)

    @cached_property
    def hours(self) -> dict[str, Hour]:
        """Twelve hours of the buoy near a PM spectrum, one a month; empty without the data."""
        folder = self.data("ndbc_wave_spectra")
        if folder is None:
            return {}
        about = pl.read_csv(folder / "ndbc46042_1996_params.csv.gz")
        about = about.filter(pl.col("mismatch_PM_HsTp") < 0.15)
        table = pl.read_csv(folder / "ndbc46042_1996_spectra.csv.gz")
        f = np.array([float(name[2:-2]) for name in table.columns[1:]])
        hours = {}
        for month in range(1, 13):
            part = about.filter(pl.col("time_utc").str.slice(5, 2) == f"{month:02d}")
            chosen = part.sort("Hs_m", "time_utc").row(part.height // 2, named=True)
            row = table.filter(pl.col("time_utc") == chosen["time_utc"]).row(0)
            density = np.array(row[1:], dtype=float)
            state = SeaState(
                spectrum=Spectrum(2.0 * math.pi * f, density / (2.0 * math.pi)), components=200
            )
            z, fine, estimate = an_hour(realise(state, self.boat), segment=400.0)
            binned = np.array([np.mean(estimate[np.abs(fine - at) < 0.00501]) for at in f])
            hours[chosen["time_utc"]] = Hour(
                f=f,
                density=density,
                estimate=binned,
                hs=(4.0 * float(np.std(z)), chosen["Hs_m"]),
                tm02=(
                    spectra.moments(2.0 * math.pi * fine, estimate / (2.0 * math.pi)).tm02,
                    chosen["Tm02_s"],
                ),
                tp=(peak_period(f, binned), peak_period(f, density)),
            )
        return hours


class Hour(NamedTuple):
    """An hour of the buoy, simulated and measured; pairs are (simulated, measured)."""

    f: Array
    density: Array
    estimate: Array
    hs: tuple[float, float]
    tm02: tuple[float, float]
    tp: tuple[float, float]

    @property
    def mismatch(self) -> float:
        """Integral of the absolute difference of the spectra over twice the energy."""
        difference = float(np.sum(np.abs(self.estimate - self.density)))
        return difference / (2.0 * float(np.sum(self.density)))


class BoatInSea:
    """One boat in one sea; calm by default."""

    def __init__(self, vessel: Vessel, sea: Sea | ship.Sea | None = None, dof: int = 3) -> None:
        self.p, self.dof = vessel.packed.copy(), dof
        self.sea = sea.arrays() if isinstance(sea, Sea) else sea or ship.calm_sea()
        self.work = np.zeros((ship.WORK_ROWS, fr.STATE_SIZE))

    def step(self, state: Array, cmd: Array, dt: float) -> None:
        """Advance a state in place, from time 0."""
        ship.step(state, cmd, ship.Ship(self.p, self.dof), self.sea, 0.0, dt, self.work)

    def run(self, state: Array, cmd: Array, seconds: float, dt: float = 0.05) -> Array:
        """Return the states of a run with a constant command, with the first."""
        steps = round(seconds / dt)
        states = np.empty((steps + 1, fr.STATE_SIZE))
        states[0] = state
        cmds = np.tile(np.asarray(cmd, dtype=float), (steps, 1))
        ship.sail(states, cmds, ship.Ship(self.p, self.dof), self.sea, dt, self.work)
        return states

    def derivative(self, state: Array, cmd: Array | None = None) -> Array:
        """Return the derivative of a state at time 0; default command: the present actuators."""
        out = np.zeros(fr.STATE_SIZE)
        weather, gusts = self.sea.weather, self.sea.gusts
        sea = self.sea
        waves.wave_factors(state[fr.PSI], sea.waves, sea.loads, self.p, 6, sea.factors)
        air, gain = wx.air_velocity(0.0, gusts, weather), wx.wave_gain(0.0, weather)
        cmd = state[fr.N_LEFT :].copy() if cmd is None else cmd
        moving = ship.Ship(self.p, self.dof)
        ship.derivative(state, cmd, moving, self.sea, ship.Air(*air, gain), 0.0, out)
        return out


def under_way(u: float, v: float = 0.0, r: float = 0.0, n: float = 0.0) -> Array:
    """Return the state of a boat that heads north with helm amidships."""
    state = np.zeros(fr.STATE_SIZE)
    state[[fr.U, fr.V, fr.R, fr.N_LEFT, fr.N_RIGHT]] = u, v, r, n, n
    return state


def realise(state: SeaState, vessel: Vessel, seed: int = 0) -> Sea:
    """Draw one sea from a seed."""
    return state.realise(vessel, *np.random.default_rng(seed).spawn(2))


def an_hour(sea: Sea, segment: float = 200.0) -> tuple[Array, Array, Array]:
    """Return the elevation at one place at 4 Hz, and its spectrum (m2/Hz) over Hz.

    ``segment`` is the length of Welch's segments, s.
    """
    z = sea.elevation(3.0, -5.0, np.arange(0.0, 3600.0, 0.25))
    f, density = welch(z, 4.0, nperseg=int(4 * segment))
    return z, f[1:], density[1:]


def peak_period(f: Array, density: Array) -> float:
    """Return the peak period in s from the mean frequency weighted with S^4.

    It has a smaller variance than the highest of many noisy bins.

    Source: Young 1995.
    """
    return float(np.sum(density**4) / np.sum(f * density**4))
