"""Hydrodynamic tables from a vessel's mesh, with the boundary-element code capytaine.

It is an optional package: ``pip install 'usv-twin[hydro]'``.
"""

from __future__ import annotations

import contextlib
import logging
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usv_gym.hydro.motions import drift_loads, response
from usv_gym.hydro.table import Array, Complex, HydroError, HydroTable
from usv_gym.physics import GRAVITY
from usv_gym.vessel.geometry import hull_of
from usv_gym.vessel.hydrostatics import Hydrostatics, wetted_surface
from usv_gym.vessel.mesh import Mesh
from usv_gym.vessel.vessel import Vessel

__all__ = ["FREQUENCIES", "HEADINGS", "capytaine", "make_table"]

FREQUENCIES = np.concatenate(
    [[0.3, 0.45, 0.6, 0.75, 0.9, 1.05], np.arange(1.2, 5.01, 0.17), [5.4, 5.92, 6.44]]
)
"""Frequencies of a table over sqrt(g / L); in shorter waves panels of pontoons are too coarse."""

HEADINGS = np.linspace(0.0, math.pi, 13)
"""Headings of a table, rad."""

PANELS_MAX = 4000
"""Most panels: the time grows with their square, and more."""

ANGLES = 120
"""Angles at which the waves sent out are counted."""

LID = 250
"""Panels of the lid inside the water line, about."""

# x ahead, y to port, z up -> x ahead, y to starboard, z down, and the wave from the other side
_TURN = np.array([1.0, 1.0, -1.0, -1.0, -1.0, 1.0])

_DOFS = ("Surge", "Sway", "Heave", "Roll", "Pitch", "Yaw")


def capytaine() -> Any:
    """Return the optional module capytaine."""
    try:
        with _quiet():
            import capytaine
    except ImportError:
        raise HydroError(
            "hydrodynamic tables are made with capytaine, which is not installed: "
            "pip install 'usv-twin[hydro]'"
        ) from None
    return capytaine


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Keep capytaine from logging what a table does not need."""
    logger = logging.getLogger("capytaine")
    level, spread = logger.level, logger.propagate
    logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        logger.setLevel(level)
        logger.propagate = spread


@dataclass(frozen=True)
class _Panels:
    """Wetted panels: corners (n, 3, 3), x ahead, y to port, z up; of one side if ``half``."""

    corners: NDArray[np.float64]
    half: bool

    @classmethod
    def of(cls, vessel: Vessel, mesh: Mesh) -> _Panels:
        corners = wetted_surface(mesh) * np.array([1.0, -1.0, -1.0])
        grain = 1e-6 * vessel.values["beam"]
        port, starboard = (side * corners[:, :, 1] > -grain for side in (1.0, -1.0))
        half = bool(np.all(port.all(axis=1) | starboard.all(axis=1)))
        panels = cls(corners[port.all(axis=1)] if half else corners, half)
        if len(panels.corners) > PANELS_MAX:
            raise HydroError(
                f"{vessel.name}: its mesh has {len(panels.corners)} wetted panels, and at most "
                f"{PANELS_MAX} can be computed; make it coarser"
            )
        return panels

    def body(self, code: Any, name: str, plane: float) -> Any:
        """Return the floating body of the panels, with a lid against irregular frequencies.

        ``plane`` is the area of the water plane, m2.
        """
        grain = 1e-7 * float(np.ptp(self.corners))
        points, where = np.unique(
            np.round(self.corners.reshape(-1, 3) / grain), axis=0, return_inverse=True
        )
        faces = where.reshape(-1, 3)
        faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
        mesh = code.Mesh(points * grain, faces)
        if self.half:
            mesh = code.ReflectionSymmetricMesh(mesh, plane="xOz")
        dofs = code.rigid_body_dofs(rotation_center=(0.0, 0.0, 0.0))
        lid = mesh.generate_lid(faces_max_radius=math.sqrt(0.5 * plane / LID))
        return code.FloatingBody(mesh, dofs=dofs, lid_mesh=lid, name=name)


def make_table(
    vessel: Vessel, on_progress: Callable[[int], None] | None = None, source: str = ""
) -> HydroTable:
    """Return the table of a vessel's hull on even keel; some minutes for fine meshes.

    A hull that would trim is moved along until its centre of buoyancy lies over the centre of
    gravity. Else the waves would push the boat beside its mass, and turn it.

    ``on_progress`` is called with the number of frequencies that are done, ``source`` is kept in
    the table. Mean drift is that of the vessel's own mass, centre of gravity and viscous roll
    damping.
    HydroError: capytaine is missing, or the mesh has too many panels.
    """
    code, v = capytaine(), vessel.values
    mesh = hull_of(vessel)
    mesh = mesh.moved((v["x_G"] - Hydrostatics.of(mesh).x_B, 0.0, 0.0))
    hull = Hydrostatics.of(mesh)
    length, density = v["length_waterline"], v["water_density"]
    omega = FREQUENCIES * math.sqrt(GRAVITY / length)
    A, B = (np.zeros((len(omega), 6, 6)) for _ in "AB")
    F = np.zeros((len(omega), len(HEADINGS), 6), dtype=complex)
    sent = np.zeros((len(omega), len(HEADINGS), ANGLES), dtype=complex)
    radiated = np.zeros((len(omega), 6, ANGLES), dtype=complex)
    with _quiet():
        body, solver = _Panels.of(vessel, mesh).body(code, vessel.name, hull.A_wp), code.BEMSolver()
        for i, w in enumerate(omega):
            far = _far_field(body, float(w) ** 2 / GRAVITY)
            common = {"body": body, "omega": float(w), "rho": density, "g": GRAVITY}
            for j, dof in enumerate(_DOFS):
                problem = code.RadiationProblem(radiating_dof=dof, **common)
                got = solver.solve(problem, keep_details=True, _check_wavelength=False)
                A[i, :, j] = [got.added_masses[name] for name in _DOFS]
                B[i, :, j] = [got.radiation_dampings[name] for name in _DOFS]
                radiated[i, j] = far @ got.sources
            for j, heading in enumerate(HEADINGS):
                problem = code.DiffractionProblem(wave_direction=float(heading), **common)
                got = solver.solve(problem, keep_details=True, _check_wavelength=False)
                incident = code.bem.airy_waves.froude_krylov_force(problem)
                F[i, j] = [got.forces[name] + incident[name] for name in _DOFS]
                sent[i, j] = far @ got.sources
            if on_progress is not None:
                on_progress(i + 1)
    GM_T, GM_L = hull.GM(v["KG"] - v["draft"])
    turn = _TURN[:, None] * _TURN
    table = HydroTable(
        omega=omega,
        heading=HEADINGS,
        added_mass=turn * 0.5 * (A + np.swapaxes(A, 1, 2)),
        damping=turn * 0.5 * (B + np.swapaxes(B, 1, 2)),
        excitation=_TURN * F,
        length=length,
        density=density,
        hydrostatics=(hull.A_wp, hull.x_F, GM_T, GM_L),
        source=source,
    )
    return replace(table, drift=_drift(table, vessel, radiated, sent))


def _far_field(body: Any, k: float) -> Complex:
    """Return what makes Kochin functions of the sources on all panels, (angles, panels)."""
    theta = 2.0 * math.pi * np.arange(ANGLES) / ANGLES
    mesh = body.mesh_including_lid
    x, y, z = mesh.faces_centers.T
    along = np.outer(np.cos(theta), x) + np.outer(np.sin(theta), y)
    return np.asarray(np.exp(k * (z - 1j * along)) * mesh.faces_areas / (4.0 * math.pi))


def _drift(table: HydroTable, vessel: Vessel, radiated: Complex, diffracted: Complex) -> Array:
    """Return the mean drift (F, H, 3) from Kochin functions of six modes and all headings."""
    moving = vessel.with_table(table).values
    motion = response(table, moving)
    viscous = (
        2.0
        * moving["zeta_roll_viscous"]
        * math.sqrt(moving["mass"] * GRAVITY * moving["GM_T"] * (moving["I_xx"] + moving["J_xx"]))
    )
    absorbed = 0.5 * viscous * table.omega[:, None] ** 2 * np.abs(motion[..., 3]) ** 2
    waves = 1j * (diffracted + np.einsum("fhj,fjn->fhn", _TURN * motion, radiated))
    return drift_loads(table.omega, table.heading, waves, absorbed, table.density)
