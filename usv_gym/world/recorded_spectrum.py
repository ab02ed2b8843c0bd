"""Wave spectra recorded by buoys."""

from __future__ import annotations

import csv
import gzip
import math
import os
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from usv_gym.physics import spectra
from usv_kernel.errors import UsvTwinError

__all__ = ["SeaError", "Spectrum"]

Array = NDArray[np.float64]


class SeaError(UsvTwinError):
    """An invalid sea state; the message names the value and the remedy."""


SPECTRUM_MAX = 1 << 22
"""Longest file of a spectrum, bytes, unpacked."""


@dataclass(frozen=True, eq=False)
class Spectrum:
    """A wave spectrum as a table, linear between its points and zero beyond them.

    ``omega`` (n,) rises, rad/s, above 0; ``density`` (n,) is in m2 s/rad, not below 0.
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

        Its two columns have the header ``frequency_hz,density_m2_per_hz`` or
        ``omega_radps,density_m2s_per_rad``.
        """
        path = Path(path)
        try:
            with gzip.open(path) if path.suffix == ".gz" else path.open("rb") as file:
                raw = file.read(SPECTRUM_MAX + 1)
            if len(raw) > SPECTRUM_MAX:
                raise SeaError(f"longer than {SPECTRUM_MAX / 1e6:.3g} MB")
            text = raw.decode("utf-8-sig")
            lines = [line for line in text.splitlines() if not line.startswith("#")]
            rows = [row for row in csv.reader(lines) if row]
        except (OSError, EOFError, ValueError, zlib.error, csv.Error) as error:
            raise SeaError(f"{path}: cannot be read as a spectrum ({error})") from None
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
