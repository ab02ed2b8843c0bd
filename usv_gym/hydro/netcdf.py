"""Tables in files of the classic NetCDF format."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np

from usv_gym.hydro.table import HydroError, HydroTable
from usv_kernel.files import read_limited, replacing

__all__ = ["read_table", "write_table"]

FILE_MAX = 1 << 24
"""Longest file of a table, bytes."""

VARIABLES = {
    "omega": ("d", ("frequency",), "rad/s"),
    "heading": (
        "d",
        ("heading",),
        "rad; where the wave goes less where the boat heads: 0 following, pi head sea",
    ),
    "added_mass": ("f", ("frequency", "force", "motion"), "kg, kg m, kg m2"),
    "damping": ("f", ("frequency", "force", "motion"), "kg/s, kg m/s, kg m2/s"),
    "excitation_real": (
        "f",
        ("frequency", "heading", "force"),
        "N/m, N; load = Re(F a exp(-i omega t)), wave a cos(k.x - omega t)",
    ),
    "excitation_imaginary": ("f", ("frequency", "heading", "force"), "N/m, N"),
    "drift": (
        "f",
        ("frequency", "heading", "drift_force"),
        "surge N/m2, sway N/m2, yaw N/m; times the square of the amplitude",
    ),
}
"""Variables of a table: type, dimensions and units."""

NOTES = {
    "title": "hydrodynamics of a hull, see usv_gym.hydro.table",
    "forces": "surge sway heave roll pitch yaw; x forward, y to starboard, z down, about the "
    "origin on the water line",
    "hydrostatics_names": "A_wp m2, x_F m, GM_T m, GM_L m",
}
"""What a file says of itself."""


class _Once(io.BytesIO):
    """The content of a file, of which no more is read than its length.

    A damaged head may point to the same bytes a thousand times.
    """

    def __init__(self, content: bytes) -> None:
        super().__init__(content)
        self.left = len(content) + 1

    def read(self, size: int | None = -1) -> bytes:
        found = super().read(size)
        self.left -= len(found)
        if self.left < 0:
            raise HydroError("is damaged: its variables overlap")
        return found


def read_table(path: Path) -> HydroTable:
    """Read a table of at most :data:`FILE_MAX` bytes; HydroError names the file and what is wrong.

    The script of examples/hydrodynamics makes such files.
    """
    content = read_limited(path, HydroError, FILE_MAX)
    if content[:3] != b"CDF":
        raise HydroError(
            f"{path}: is no NetCDF file of the classic format, as examples/hydrodynamics makes them"
        )
    try:
        return _decoded(content)
    except HydroError as error:
        raise HydroError(f"{path}: {error}") from None
    except Exception as error:  # the parser may raise anything
        raise HydroError(
            f"{path}: is damaged, or no hydrodynamic table ({type(error).__name__}); make it again"
        ) from None


def _decoded(content: bytes) -> HydroTable:
    """Return the table of a file's content."""
    from scipy.io import netcdf_file  # imported by vessels with a table only

    file = netcdf_file(_Once(content))
    values: dict[str, Any] = {}
    for name, (_, axes, _) in VARIABLES.items():
        found = file.variables.get(name)
        if found is None and name == "drift":
            continue
        if found is None or found.dimensions != axes:
            raise HydroError(f"has no variable {name}({', '.join(axes)})")
        values[name] = np.asarray(found.data, dtype=float)
    hydrostatics = getattr(file, "hydrostatics", None)
    if hydrostatics is not None and np.shape(hydrostatics) != (4,):
        raise HydroError("attribute hydrostatics: must hold A_wp, x_F, GM_T and GM_L")
    return HydroTable(
        omega=values["omega"],
        heading=values["heading"],
        added_mass=values["added_mass"],
        damping=values["damping"],
        excitation=values["excitation_real"] + 1j * values["excitation_imaginary"],
        drift=values.get("drift"),
        length=float(file.length),
        density=float(file.density),
        hydrostatics=None if hydrostatics is None else tuple(map(float, hydrostatics)),  # type: ignore[arg-type]
        source=file.source.decode("utf-8"),
    )


def write_table(path: Path, table: HydroTable) -> None:
    """Write a table whole or not at all; numbers have single precision but for the axes."""
    from scipy.io import netcdf_file

    arrays = {name: getattr(table, name, None) for name in VARIABLES}
    arrays |= {
        "excitation_real": table.excitation.real,
        "excitation_imaginary": table.excitation.imag,
    }
    sizes = {"frequency": len(table.omega), "heading": len(table.heading)}
    with replacing(path) as partial, netcdf_file(partial, "w") as file:
        for name, size in (sizes | {"force": 6, "motion": 6, "drift_force": 3}).items():
            file.createDimension(name, size)
        for name, text in (NOTES | {"source": table.source}).items():
            setattr(file, name, text.encode("utf-8"))
        file.length, file.density = np.float64(table.length), np.float64(table.density)
        if table.hydrostatics is not None:
            file.hydrostatics = np.array(table.hydrostatics)
        for name, array in arrays.items():
            if array is not None:
                kind, axes, units = VARIABLES[name]
                file.createVariable(name, kind, axes)[:] = array
                file.variables[name].units = units
