"""Results of other codes as tables: capytaine (NetCDF), NEMOH and WAMIT."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from usv_gym.hydro.netcdf import FILE_MAX, read_table
from usv_gym.hydro.table import Array, Complex, HydroError, HydroTable, between
from usv_gym.physics import GRAVITY

__all__ = ["Water", "read_results"]

TEXT_MAX = 1 << 24
"""Longest text file, bytes; longest NetCDF-4 file: four times that."""

_MODES = ("surge", "sway", "heave", "roll", "pitch", "yaw")

# x ahead, y to port, z up -> x ahead, y to starboard, z down; and the wave from the other side
_TURN = np.array([1.0, 1.0, -1.0, -1.0, -1.0, 1.0])


class Water(NamedTuple):
    """What results of other codes do not say of a hull."""

    length: float
    """Of the water line, m."""
    density: float
    """kg/m3."""
    mass: float
    """kg, for GM from restoring."""


class _Raw(NamedTuple):
    """Results in the axes of other codes: x ahead, y to port, z up; loads for exp(-i omega t)."""

    omega: Array
    heading: Array
    """Where the wave goes, rad from x to y."""
    added_mass: Array
    damping: Array
    excitation: Complex
    stiffness: Array | None = None
    drift: Array | None = None


def read_results(path: Path, water: Water, origin: float = 0.0) -> HydroTable:
    """Return the table in results of another code, without mean drift where they have none.

    Parameters
    ----------
    path : Path
        A NetCDF file of capytaine or of ``usv-twin vessel hydro``, the folder of a run of NEMOH
        (or its ``results``), or a file of WAMIT, ``.1`` or ``.3``, beside the other of that name
        (with ``.hst`` and ``.8`` if they are there). One body in deep water, its mesh symmetric, on
        the water line z = 0, with loads about the origin of the axes.
    water : Water
        Of the vessel.
    origin : float
        How far the file's origin lies forward of the vessel's, m.

    Raises
    ------
    HydroError
        Names the file and what is wrong with it.
    """
    if not path.exists():
        raise HydroError(f"{path}: there is no such file or folder")
    suffix = path.suffix.lower()
    if suffix in (".nc", ".nc4") and path.is_file():
        with path.open("rb") as file:
            classic = file.read(3) == b"CDF"
        if classic:
            return read_table(path).moved(origin)
        reader: Callable[[Path, Water], _Raw] = _read_capytaine
    elif path.is_dir():
        reader = _read_nemoh
    elif suffix in (".1", ".3"):
        reader = _read_wamit
    else:
        raise HydroError(
            f"{path}: give a .nc file of capytaine, a folder of NEMOH, or a .1 file of WAMIT"
        )
    try:
        return _table(reader(path, water), water, f"read from {path.name}").moved(origin)
    except HydroError as error:
        text = str(error)
        raise HydroError(text if text.startswith(str(path)) else f"{path}: {text}") from None


def _table(raw: _Raw, water: Water, source: str) -> HydroTable:
    """Return the table of results in the axes of other codes, at even headings."""
    order = np.argsort(raw.omega)
    heading = np.mod(raw.heading, 2.0 * math.pi)
    one_side = heading <= math.pi + 1e-6
    if one_side.sum() < 5 or np.ptp(heading[one_side]) < math.pi - 1e-3:
        raise HydroError(
            "headings must go from 0 to 180 degrees, 5 or more of them; run the code with these"
        )
    along = np.flatnonzero(one_side)[np.argsort(heading[one_side])]
    points = np.linspace(0.0, math.pi, len(along))

    def even(values: Array | Complex) -> Any:
        return np.moveaxis(
            between(points, heading[along], np.moveaxis(values[order][:, along], 1, 0)), 0, 1
        )

    static = None
    if raw.stiffness is not None:
        C = raw.stiffness
        weight, x_F = water.mass * GRAVITY, -C[2, 4] / C[2, 2] if C[2, 2] > 0.0 else math.nan
        static = (
            C[2, 2] / (water.density * GRAVITY),
            x_F,
            C[3, 3] / weight,
            (C[4, 4] - C[2, 2] * x_F**2) / weight,
        )
        if not (np.isfinite(static).all() and min(static[0], *static[2:]) > 0.0):
            raise HydroError("its restoring matrix does not hold the hull upright")
    turn = _TURN[:, None] * _TURN
    return HydroTable(
        omega=raw.omega[order],
        heading=points,
        added_mass=turn * raw.added_mass[order],
        damping=turn * raw.damping[order],
        excitation=_TURN * even(raw.excitation),
        drift=None if raw.drift is None else even(raw.drift),
        length=water.length,
        density=water.density,
        hydrostatics=static,
        source=source,
    )


def _read_capytaine(path: Path, water: Water) -> _Raw:
    """Read a data set of capytaine, which xarray opens."""
    if path.stat().st_size > 4 * FILE_MAX:
        raise HydroError(f"is longer than {4 * FILE_MAX >> 20} MiB")
    try:
        import netCDF4  # noqa: F401
        import xarray
    except ImportError:
        raise HydroError(
            "files of capytaine are read with xarray and netCDF4, which are not installed: "
            "pip install 'usv-twin[hydro]'"
        ) from None
    try:
        with xarray.open_dataset(path, engine="netcdf4") as opened:
            found = opened.load()
    except (OSError, ValueError, RuntimeError, LookupError, AttributeError, TypeError) as error:
        raise HydroError(f"cannot be read as NetCDF ({type(error).__name__})") from None
    names = ["added_mass", "radiation_damping", "Froude_Krylov_force", "diffraction_force"]
    if "excitation_force" in found:
        names[2:] = ["excitation_force"]
    missing = [name for name in (*names, "omega", "wave_direction") if name not in found.variables]
    if missing:
        raise HydroError(f"lacks {', '.join(missing)}; it is no result of capytaine")
    try:
        turned = {name: _by_mode(found[name]) for name in names}
        density = float(np.squeeze(found["rho"].values)) if "rho" in found else water.density
        stiffness = None
        if "hydrostatic_stiffness" in found:
            stiffness = _by_mode(found["hydrostatic_stiffness"])
        omega = np.atleast_1d(found["omega"].values).astype(float)
        heading = np.atleast_1d(found["wave_direction"].values).astype(float)
    except (KeyError, ValueError, TypeError, IndexError) as error:
        raise HydroError(f"has other dimensions than one rigid body needs ({error})") from None
    if abs(density / water.density - 1.0) > 0.05:
        raise HydroError(f"is of water of {density:g} kg/m3, the vessel's has {water.density:g}")
    loads = sum(turned[name] for name in names[2:])
    return _Raw(omega, heading, turned[names[0]], turned[names[1]], loads, stiffness)


def _by_mode(data: Any) -> Any:
    """Return values (frequency, heading, mode) or (frequency, mode, mode), modes in their order."""
    if "complex" in data.dims:
        data = data.sel(complex="re") + 1j * data.sel(complex="im")
    axes = [axis for axis in ("omega", "wave_direction") if axis in data.dims]
    for axis in ("influenced_dof", "radiating_dof"):
        if axis in data.dims:
            names = [str(name) for name in data[axis].values]
            plain = [name.split("__")[-1].lower() for name in names]
            data = data.isel({axis: [plain.index(mode) for mode in _MODES]})
            axes.append(axis)
    extra = [axis for axis in data.dims if axis not in axes]
    return data.isel(dict.fromkeys(extra, 0)).transpose(*axes).values


def _numbers(path: Path) -> list[list[float]]:
    """Return the numbers in the lines of a text file; words end a line."""
    try:
        with path.open("rb") as file:
            raw = file.read(TEXT_MAX + 1)
    except OSError as error:
        raise HydroError(f"{path}: cannot be read ({error.strerror or error})") from None
    if len(raw) > TEXT_MAX:
        raise HydroError(f"{path}: is longer than {TEXT_MAX >> 20} MiB")
    lines = raw.decode("latin-1").replace(",", " ").splitlines()
    return [
        [float(word) for word in itertools.takewhile(_is_number, _words(line))] for line in lines
    ]


def _words(line: str) -> list[str]:
    """Return the words of a line, Fortran's exponents as others'."""
    return line.replace("D", "E").replace("d", "e").split()


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _read_wamit(path: Path, water: Water) -> _Raw:
    """Read numeric output of WAMIT: .1 and .3, and .hst and .8 (drift by momentum) if there."""
    radiation = [row for row in _numbers(path.with_suffix(".1")) if len(row) >= 5]
    incident = [row for row in _numbers(path.with_suffix(".3")) if len(row) >= 7]
    periods = sorted({row[0] for row in radiation if row[0] > 0.0}, reverse=True)
    angles = sorted({row[1] for row in incident})
    if not periods or not angles:
        raise HydroError(f"{path}: holds no periods above 0, or no headings")
    omega = 2.0 * math.pi / np.array(periods)
    A, B = np.full((2, len(omega), 6, 6), 0.0)
    F = np.full((len(omega), len(angles), 6), np.nan, dtype=complex)
    at, side = {T: i for i, T in enumerate(periods)}, {b: j for j, b in enumerate(angles)}
    for period, p, q, a, b in (row[:5] for row in radiation):
        if period in at and _is_mode(p) and _is_mode(q):
            i = at[period]
            A[i, int(p) - 1, int(q) - 1] = water.density * a
            B[i, int(p) - 1, int(q) - 1] = water.density * omega[i] * b
    for row in incident:
        if row[0] in at and _is_mode(row[2]):
            # for exp(i omega t), and an elevation of phase 0 at the origin
            load = water.density * GRAVITY * (row[5] - 1j * row[6])
            F[at[row[0]], side[row[1]], int(row[2]) - 1] = load
    if np.isnan(F).any():
        raise HydroError(f"{path.with_suffix('.3')}: lacks some of the periods, headings or modes")
    stiffness, drift = None, None
    if path.with_suffix(".hst").is_file():
        stiffness = np.zeros((6, 6))
        for row in _numbers(path.with_suffix(".hst")):
            if len(row) >= 3 and _is_mode(row[0]) and _is_mode(row[1]):
                value = water.density * GRAVITY * row[2]
                stiffness[int(row[0]) - 1, int(row[1]) - 1] = value
    if path.with_suffix(".8").is_file():
        drift = np.full((len(omega), len(angles), 3), np.nan)
        for row in _numbers(path.with_suffix(".8")):
            known = len(row) >= 7 and row[0] in at and row[1] in side and row[1] == row[2]
            if known and abs(row[3]) in (1.0, 2.0, 6.0):
                mode = (1.0, 2.0, 6.0).index(abs(row[3]))
                drift[at[row[0]], side[row[1]], mode] = water.density * GRAVITY * row[6]
        if np.isnan(drift).any():
            raise HydroError(f"{path.with_suffix('.8')}: lacks some of the periods or headings")
    return _Raw(omega, np.radians(angles), A, B, F, stiffness, drift)


def _is_mode(number: float) -> bool:
    return number in (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)


def _read_nemoh(path: Path, water: Water) -> _Raw:
    """Read a run of NEMOH 2 or 3: RadiationCoefficients.tec, ExcitationForce.tec, Mesh/KH.dat."""
    folder = path / "results" if (path / "results").is_dir() else path
    radiation = _zones(folder / "RadiationCoefficients.tec")
    incident = _zones(folder / "ExcitationForce.tec")
    if len(radiation) != 6 or not incident:
        raise HydroError(
            f"{folder}: holds {len(radiation)} motions and {len(incident)} headings; must hold one "
            "body with 6 motions, and headings"
        )
    omega = radiation[0][:, 0]
    for zone in (*radiation, *incident):
        if zone.shape != (len(omega), 13) or np.abs(zone[:, 0] - omega).max() > 1e-4:
            raise HydroError(f"{folder}: its zones differ in their frequencies, or are cut off")
    coefficients = np.stack(radiation, axis=1)[..., 1:]
    loads = np.stack(incident, axis=1)[..., 1:]
    # amplitude and phase, for exp(-i omega t)
    F = loads[..., 0::2] * np.exp(1j * loads[..., 1::2])
    stiffness = None
    for name in (path / "Mesh" / "KH.dat", path / "mesh" / "KH.dat"):
        if name.is_file():
            rows = [row for row in _numbers(name) if len(row) == 6]
            if len(rows) != 6:
                raise HydroError(f"{name}: must hold a matrix of 6 rows and columns")
            stiffness = np.array(rows)
    heading = np.linspace(0.0, math.pi, len(incident))
    angles = _headings(path)
    if angles is not None:
        if len(angles) != len(incident):
            raise HydroError(f"{path}: its Nemoh.cal has another number of headings")
        heading = angles
    return _Raw(
        omega,
        heading,
        np.swapaxes(coefficients[..., 0::2], 1, 2),
        np.swapaxes(coefficients[..., 1::2], 1, 2),
        F,
        stiffness,
    )


def _zones(path: Path) -> list[Array]:
    """Return the blocks of numbers of a Tecplot file, rows of 13."""
    zones: list[list[list[float]]] = [[]]
    for row in _numbers(path):
        if len(row) == 13:
            zones[-1].append(row)
        elif zones[-1]:
            zones.append([])
    return [np.array(zone) for zone in zones if zone]


def _headings(path: Path) -> Array | None:
    """Return the headings (rad) that Nemoh.cal asks for, or None without the file."""
    file = path / "Nemoh.cal"
    if not file.is_file():
        return None
    for row, line in zip(_numbers(file), file.read_text("latin-1").splitlines(), strict=True):
        if "wave directions" in line.lower() and len(row) >= 3:
            return np.asarray(np.radians(np.linspace(row[1], row[2], int(row[0]))))
    raise HydroError(f"{file}: names no wave directions")
