"""Boats whose hull is a mesh file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from usv_gym.vessel.form import Form
from usv_gym.vessel.mesh import Mesh
from usv_gym.vessel.parts import COLOURS, Boat, Colour, Part
from usv_gym.vessel.vessel import VesselError

__all__ = ["read_mesh"]

# axes of the ship -> axes of glTF (y up, z forward, x to port), or of any other file
_GLTF = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])

_UPRIGHT = np.diag([1.0, -1.0, -1.0])


def read_mesh(path: Path, form: Form, moving: Sequence[Part]) -> Boat:
    """Return a boat with the meshes of a file, whose size the main particulars check.

    The file's meshes of equal names replace those of the ``moving`` propulsion. VesselError: it
    cannot be read, has no hull, or has a wrong size or place.
    """
    place = f"[vessel] mesh: {path}:"
    try:
        import trimesh
    except ImportError:
        raise VesselError(
            f"{place} mesh files need trimesh, which is not installed: pip install 'usv-twin[view]'"
        ) from None
    try:
        with np.errstate(all="ignore"):  # non-finite numbers are reported below
            scene = trimesh.load_scene(
                path, process=False
            )  # processing would drop non-finite vertices
            found = []
            for node in scene.graph.nodes_geometry:
                transform, key = scene.graph[node]
                solid = scene.geometry[key]
                if isinstance(solid, trimesh.Trimesh):
                    found.append((str(node), solid.copy().apply_transform(transform)))
    except OSError as error:
        raise VesselError(f"{place} cannot be read ({error.strerror or error})") from None
    except Exception:  # parsers may raise anything
        raise VesselError(
            f"{place} is no {path.suffix} file that can be read: damaged, cut off, empty or of "
            "another format; export it again"
        ) from None
    solids = [item[1] for item in found]
    if not any(len(solid.faces) for solid in solids):
        raise VesselError(f"{place} holds no triangles; export the boat's surface as a mesh")
    if not all(np.isfinite(solid.vertices).all() for solid in solids):
        raise VesselError(f"{place} has vertices that are not finite; export it again")
    for solid in solids:
        solid.merge_vertices()
    turn = _GLTF if path.suffix.lower() == ".glb" else _UPRIGHT
    own = {part.name: part for part in moving}
    parts: dict[str, Part] = {}
    for name, solid in found:
        mesh = Mesh(np.asarray(solid.vertices) @ turn, np.asarray(solid.faces, dtype=np.int32))
        if name in own:
            mesh = mesh.moved(-Boat(tuple(moving)).position_of(own[name]))
            own[name] = replace(own[name], mesh=mesh, colour=_colour(solid))
        else:
            parts[name] = Part(name, mesh, _colour(solid))
    body = Mesh.joined(part.mesh for part in parts.values()) if parts else None
    if body is None:
        raise VesselError(f"{place} holds drives and propellers only; it must hold the hull")
    length = float(np.ptp(body.bounds[:, 0]))
    if not 0.5 <= length / form.overall <= 2.0:
        raise VesselError(
            f"{place} is {length:.4g} m long from bow to stern, but length_overall is "
            f"{form.overall:.4g} m; {_hint(body, form)}"
        )
    off = float(np.abs(body.bounds.mean(axis=0)).max())
    if off > form.overall:
        raise VesselError(
            f"{place} lies {off:.4g} m off the origin, which must be amidships on the water line; "
            "move it there"
        )
    return Boat((*parts.values(), *own.values()))


def _hint(body: Mesh, form: Form) -> str:
    """Return the likely cause of a wrong length."""
    spans = np.ptp(body.bounds, axis=0)
    for factor, unit in ((1e-3, "mm"), (1e-2, "cm"), (0.0254, "inches"), (0.3048, "feet")):
        if 0.8 <= factor * spans[0] / form.overall <= 1.25:
            return f"it seems to be in {unit}; export it in m"
    if 0.5 <= spans.max() / form.overall <= 2.0:
        return (
            "its axes seem to differ; .glb files have y up and z forward, others z up and x forward"
        )
    return "the mesh must be in m, with the bow forward"


def _colour(solid: Any) -> Colour:
    """Return the main colour of a mesh from a file."""
    material = getattr(solid.visual, "material", None)
    colour = getattr(material, "main_color", None)
    if colour is None:
        colour = getattr(solid.visual, "main_color", None)
    if colour is None or not solid.visual.defined:
        return COLOURS["superstructure"]
    r, g, b = (int(c) for c in colour[:3])
    return r, g, b
