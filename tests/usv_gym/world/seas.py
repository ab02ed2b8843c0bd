"""Seas, an hour of their elevation, and tables of spectra, for tests."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.signal import welch

from usv_gym import SeaState, Vessel
from usv_gym.world.realisation import Sea
from usv_gym.world.simulation import Simulation


def realise(state: SeaState, seed: int = 0, vessel: str | Vessel = "usv75") -> Sea:
    """Return the sea that a boat of a seed begins in."""
    simulation = Simulation(1, vessel, state)
    simulation.reset([0], [np.random.default_rng(seed)])
    return simulation.sea(0)


def an_hour(sea: Sea, segment: float = 200.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the elevation at one place at 4 Hz, frequencies (Hz) and density (m2/Hz).

    ``segment`` is the length of Welch's segments, s.
    """
    z = sea.elevation(3.0, -5.0, np.arange(0.0, 3600.0, 0.25))
    f, density = welch(z, 4.0, nperseg=int(4 * segment))
    return z, f[1:], density[1:]


def peak_period(f: np.ndarray, density: np.ndarray) -> float:
    """Return the peak period in s from the mean frequency weighted with S^4 (Young 1995).

    Its variance is smaller than that of the highest of many noisy bins.
    """
    return float(np.sum(density**4) / np.sum(f * density**4))


def write(path: Path, header: str, rows: list[object]) -> Path:
    path.write_text("\n".join([header, *(",".join(map(str, row)) for row in rows)]))  # type: ignore[call-overload]
    return path
