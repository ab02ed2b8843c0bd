"""Geometric model of a boat, drawn from its main particulars or read from a mesh file.

Source: Qu et al. 2025, section 2.2.5.
"""

from __future__ import annotations

from usv_gym.vessel.drives import propulsion_parts
from usv_gym.vessel.form import Form
from usv_gym.vessel.hull_lines import HullLines
from usv_gym.vessel.mesh import Mesh
from usv_gym.vessel.mesh_files import read_mesh
from usv_gym.vessel.parts import COLOURS, Boat, Part
from usv_gym.vessel.superstructure import fixed_parts
from usv_gym.vessel.vessel import Vessel

__all__ = ["COLOURS", "Boat", "Form", "Mesh", "Part", "boat_of", "hull_of"]


def boat_of(source: Vessel | Form) -> Boat:
    """Return the geometric model of a vessel, or of a boat with a few known particulars.

    The hull has the displacement of the particulars, and the water-plane area of a vessel. A
    vessel's mesh file replaces hull and superstructure; VesselError if it cannot be used. Drives,
    rudders and propellers are separate parts that turn.
    """
    form = Form.of(source) if isinstance(source, Vessel) else source
    moving = propulsion_parts(form)
    if isinstance(source, Vessel) and source.mesh is not None:
        return read_mesh(source.mesh, form, moving)
    return Boat((*fixed_parts(form, HullLines(form)), *moving))


def hull_of(vessel: Vessel) -> Mesh:
    """Return the surface of a vessel that floats: its drawn hull, or its mesh file without drives.

    VesselError: the file cannot be used.
    """
    if vessel.mesh is None:
        return HullLines(Form.of(vessel)).mesh
    drives = {part.name for part in propulsion_parts(Form.of(vessel))}
    return Mesh.joined(part.mesh for part in boat_of(vessel).parts if part.name not in drives)
