"""The boat's geometric model: triangle meshes drawn from its main particulars.

All meshes are in metres in the ship's own frame, that of its state: x forward, y to starboard,
z down, origin where ``eta`` has it, so at the still water line (z = 0). The hull displaces what
the particulars say, and its water plane has their area where a vessel states it. What moves,
drives, rudders and propellers, are parts of their own that hang on the point about which they
turn. A mesh file (``mesh`` in a vessel's table ``[vessel]``) replaces hull and superstructure.

Source: Qu et al. 2025, section 2.2.5 (the geometric model of the twin).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usv_gym.vessel.vessel import MESH_FORMATS, Vessel, VesselError

__all__ = [
    "COLOURS",
    "Boat",
    "Form",
    "Mesh",
    "Part",
    "boat_of",
    "hull_of",
]

Array = NDArray[np.float64]

Colour = tuple[int, int, int]

COLOURS: dict[str, Colour] = {
    "hull": (32, 74, 112),
    "deck": (196, 202, 206),
    "superstructure": (240, 241, 238),
    "windows": (28, 36, 44),
    "mast": (86, 94, 100),
    "sensors": (230, 159, 0),
    "drive": (62, 68, 74),
    "propeller": (181, 134, 52),
}
"""Colour of each kind of part, red, green and blue of 255; a drive is also a rudder."""

# a point in the ship's frame -> in a glTF file (y up, z forward, x to port), or any other file
_GLTF = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])

_UPRIGHT = np.diag([1.0, -1.0, -1.0])

_PROPULSION = ("drive", "rudder", "shaft", "bracket", "propeller")
"""How the names of the parts begin that a mesh file need not have."""

_STATIONS, _BELOW, _ABOVE = 33, 8, 4  # sections of a hull; rows of faces below and above water

_POWERS = (math.log(0.6), math.log(40.0))  # logarithms of a section's exponent: hollow V to box


@dataclass(frozen=True, eq=False)
class Mesh:
    """A surface of triangles.

    Parameters
    ----------
    vertices : ndarray, shape (V, 3)
        Points, m.
    faces : ndarray, shape (F, 3)
        Rows of ``vertices`` (int32), counter-clockwise seen from outside.
    """

    vertices: Array
    faces: NDArray[np.int32]

    @property
    def volume(self) -> float:
        """Volume inside, m3; of a closed surface."""
        a, b, c = np.moveaxis(self.vertices[self.faces], 1, 0)
        return float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6.0

    @property
    def bounds(self) -> Array:
        """Least and largest x, y and z, m, shape (2, 3)."""
        return np.array([self.vertices.min(axis=0), self.vertices.max(axis=0)])

    def moved(self, by: Sequence[float] | Array) -> Mesh:
        """Return the surface moved by a vector (3,), m."""
        return Mesh(self.vertices + np.asarray(by), self.faces)

    @classmethod
    def joined(cls, meshes: Iterable[Mesh]) -> Mesh:
        """Return several surfaces as one."""
        meshes = tuple(meshes)
        starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
        pairs = zip(meshes, starts, strict=False)
        return cls(
            np.concatenate([mesh.vertices for mesh in meshes]),
            np.concatenate([mesh.faces + start for mesh, start in pairs]).astype(np.int32),
        )


@dataclass(frozen=True, eq=False)
class Part:
    """A piece of a boat with one colour.

    Parameters
    ----------
    name : str
        Such as ``hull``, ``deck``, ``drive_left``, ``propeller_left``.
    mesh : Mesh
        Its surface, m, axes as the ship's, about ``position``.
    colour : tuple of int
        Red, green and blue of 255.
    position : tuple of float
        Where it hangs and turns, m, shape (3,): in the ship's frame, or in that of its parent.
    parent : str
        Name of the part that it moves with; "": the ship.
    moves : str
        ``steer``: turns about its z axis, by minus the drive or rudder angle (which is above 0
        to starboard); ``spin``: turns about its x axis with the shaft; "": stays.
    unit : int
        Whose angle or shaft speed: 0 left or only one, 1 right.
    """

    name: str
    mesh: Mesh
    colour: Colour
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    parent: str = ""
    moves: str = ""
    unit: int = 0


@dataclass(frozen=True, kw_only=True)
class Form:
    """The numbers that a boat is drawn from.

    Parameters
    ----------
    length, beam, draft : float
        On the water line, m.
    volume : float
        Displaced, m3.
    length_overall : float, optional
        m; a tenth above ``length`` by default.
    waterplane : float, optional
        Area of the water plane, m2; by its usual share of the box around it by default.
    height : float, optional
        Mean height of hull and superstructure above the water, m; that of like boats by default.
    kind : str
        ``steerable_drive``, ``propeller_rudder`` or ``thruster_pair``, as in a vessel file.
    units : int
        Propellers, 1 or 2.
    diameter : float, optional
        Of a propeller, m; 0.7 of the draft by default.
    arm, aside, depth : float, optional
        Where drives or rudders stand: m forward of the origin, m off the centre line, and m that
        the shaft lies below the water; usual places by default.
    propeller : float, optional
        m forward of the origin, where a rudder stands behind it.
    blade : tuple of float, optional
        Height and area of a rudder, m and m2; usual shares of the draft by default.
    """

    length: float
    beam: float
    draft: float
    volume: float
    length_overall: float | None = None
    waterplane: float | None = None
    height: float | None = None
    kind: str = "steerable_drive"
    units: int = 2
    diameter: float | None = None
    arm: float | None = None
    aside: float | None = None
    depth: float | None = None
    propeller: float | None = None
    blade: tuple[float, float] | None = None

    @classmethod
    def of(cls, vessel: Vessel) -> Form:
        """Return what a vessel file says of its form."""
        v = vessel.values
        length, kind = v["length_waterline"], vessel.kind
        rudder = kind == "propeller_rudder"
        return cls(
            length=length,
            beam=v["beam"],
            draft=v["draft"],
            volume=v["block_coefficient"] * length * v["beam"] * v["draft"],
            length_overall=v["length_overall"],
            waterplane=v["A_wp"],
            height=v["A_L"] / v["length_overall"],
            kind=kind,
            units=int(v["units"]),
            diameter=v["propeller_diameter"],
            arm=v["x_R_prime"] * length if rudder else v.get("x_P"),
            aside=v["y_P"],
            depth=v["z_P"],
            propeller=v["x_P_prime"] * length if rudder else None,
            blade=(v["rudder_height"], v["A_R"]) if rudder else None,
        )

    @property
    def block(self) -> float:
        """Block coefficient."""
        return self.volume / (self.length * self.beam * self.draft)

    @cached_property
    def screw(self) -> float:
        """Propeller diameter, m."""
        return 0.7 * self.draft if self.diameter is None else self.diameter

    @cached_property
    def off(self) -> float:
        """How far the propellers stand off the centre line, m."""
        if self.units == 1:
            return 0.0
        usual = 0.36 if self.kind == "thruster_pair" else 0.22
        return usual * self.beam if self.aside is None else self.aside

    @cached_property
    def overall(self) -> float:
        """Length overall, m; at least that of the water line."""
        return max(self.length_overall or 1.1 * self.length, self.length)

    @cached_property
    def middle(self) -> float:
        """Where the middle of the water line lies, m forward of the origin.

        The transom of a boat with steerable drives ends just before them; other ships have the
        middle of the water line at the origin.
        """
        if self.kind != "steerable_drive" or self.arm is None:
            return 0.0
        shift = self.arm + 1.08 * self.screw + 0.5 * self.length
        return min(max(shift, -0.2 * self.length), 0.2 * self.length)

    @cached_property
    def stern(self) -> float:
        """After end of the water line, m forward of the origin."""
        return self.middle - 0.5 * self.length

    @cached_property
    def above(self) -> float:
        """Mean height of hull and superstructure above the water, m."""
        if self.height is not None:
            return self.height
        L = self.overall
        return 0.16 * L if L < 10.0 else 1.6 * (L / 10.0) ** 0.6

    @cached_property
    def freeboard(self) -> float:
        """Height of the deck amidships above the water, m."""
        return min(max(0.65 * self.above, 0.02 * self.length), 0.15 * self.length)

    @cached_property
    def pontoon(self) -> float:
        """Beam of each of two hulls, m; 0 for a single hull.

        Thrusters wide apart under a box that is mostly empty are those of a catamaran.
        """
        if self.kind != "thruster_pair" or self.off <= 0.25 * self.beam or self.block > 0.4:
            return 0.0
        least = max(self.block * self.beam / 1.6, 0.05 * self.beam)
        return min(max(self.beam - 2.0 * self.off, least), 0.45 * self.beam)


@dataclass(frozen=True, eq=False)
class Boat:
    """The parts of a boat.

    Parameters
    ----------
    parts : tuple of Part
        Parents before their children.
    """

    parts: tuple[Part, ...]

    def __getitem__(self, name: str) -> Part:
        for part in self.parts:
            if part.name == name:
                return part
        raise KeyError(f"no part {name!r}; there are: {', '.join(p.name for p in self.parts)}")

    def place(self, part: Part) -> Array:
        """Return where a part hangs in the ship's frame with all drives straight, m, (3,)."""
        here = np.array(part.position)
        return here + self.place(self[part.parent]) if part.parent else here

    def whole(self) -> Mesh:
        """Return all parts as one surface in the ship's frame, drives straight."""
        return Mesh.joined(part.mesh.moved(self.place(part)) for part in self.parts)

    def encoded(self, suffix: str) -> bytes:
        """Return the content of a mesh file.

        Parameters
        ----------
        suffix : str
            ``.glb``: parts as named nodes with colours; axes of glTF: y up, z forward, x to
            port. ``.ply``, ``.obj``, ``.stl``, which name no parts: one surface of all but the
            propulsion, z up, x forward, y to port. Metres, origin amidships on the water line, as
            in the ship's state.

        Raises
        ------
        VesselError
            For any other suffix, and where trimesh is missing.
        """
        if suffix not in MESH_FORMATS:
            raise VesselError(f"no mesh format is called {suffix!r}; use {', '.join(MESH_FORMATS)}")
        trimesh = _trimesh()
        if suffix != ".glb":
            # as the mesh of a vessel, drives that stand still would stick to those that turn
            fixed = [part for part in self.parts if part.name.partition("_")[0] not in _PROPULSION]
            mesh = Mesh.joined(part.mesh.moved(self.place(part)) for part in fixed)
            solid = trimesh.Trimesh(mesh.vertices @ _UPRIGHT.T, mesh.faces, process=False)
            if suffix == ".ply":
                counts = [len(part.mesh.faces) for part in fixed]
                solid.visual.face_colors = np.repeat([p.colour for p in fixed], counts, axis=0)
            content = solid.export(file_type=suffix[1:])
            return content.encode() if isinstance(content, str) else bytes(content)
        scene = trimesh.Scene(base_frame="boat")
        for part in self.parts:
            solid = trimesh.Trimesh(part.mesh.vertices @ _GLTF.T, part.mesh.faces, process=False)
            solid.visual = trimesh.visual.TextureVisuals(
                material=trimesh.visual.material.PBRMaterial(
                    name=part.name,
                    baseColorFactor=[*part.colour, 255],
                    metallicFactor=0.1,
                    roughnessFactor=0.7,
                )
            )
            place = np.eye(4)
            place[:3, 3] = _GLTF @ np.array(part.position)
            scene.add_geometry(
                solid,
                node_name=part.name,
                geom_name=part.name,
                parent_node_name=part.parent or "boat",
                transform=place,
            )
        return bytes(scene.export(file_type="glb"))


def boat_of(source: Vessel | Form) -> Boat:
    """Return the geometric model of a vessel, or of a boat of which only a few numbers are known.

    Parameters
    ----------
    source : Vessel or Form
        A vessel whose file names a mesh gets that in place of hull and superstructure.

    Returns
    -------
    Boat

    Raises
    ------
    VesselError
        For a mesh file that cannot be used.

    Source: Qu et al. 2025, section 2.2.5.
    """
    form = Form.of(source) if isinstance(source, Vessel) else source
    moving = _propulsion(form)
    if isinstance(source, Vessel) and source.mesh is not None:
        return _with_file(source.mesh, form, moving)
    lines = _Lines(form)
    return Boat((*_fixed(form, lines), *moving))


def hull_of(form: Form) -> Mesh:
    """Return the closed surface of hull and deck, without anything on it or below it.

    Parameters
    ----------
    form : Form
        The numbers; what no hull of that length, beam and draft can displace is drawn as
        nearly as can be.
    """
    return _Lines(form).mesh


# ------------------------------------------------------------------------------- the lines
class _Lines:
    """Lines of a hull, or of the starboard one of two, by sections from stern to bow.

    Below water, sections are superellipses, so V-shaped to box-shaped by one exponent; the water
    line has straight sides between a run aft and an entrance. One number of the water line is
    found so that it has its area, and the exponent so that the hull has its volume.
    """

    def __init__(self, form: Form) -> None:
        self.form = form
        twin = form.pontoon > 0.0
        self.beam = form.pontoon or form.beam
        self.offset = 0.5 * (form.beam - form.pontoon) if twin else 0.0
        self.block = form.volume / (form.length * self.beam * form.draft) / (2.0 if twin else 1.0)
        plane = self.block / (0.47 + 0.55 * self.block)
        if form.waterplane is not None:
            plane = form.waterplane / (form.length * self.beam) / (2.0 if twin else 1.0)
        angle = np.linspace(0.0, math.pi, _STATIONS)
        self.params = 0.5 * (1.0 - np.cos(angle)) * 0.75 + 0.25 * angle / math.pi

        fullness = _bisect(
            lambda f: float(np.trapezoid(self._side(f), self.params)) - plane, 0.0, 1.0
        )
        power = _bisect(lambda n: self._displaced(fullness, math.exp(n)), *_POWERS)
        if power in _POWERS:  # no such section: let the water line give way
            fullness = _bisect(lambda f: self._displaced(f, math.exp(power)), 0.0, 1.0)
        self.fullness, self.power = fullness, math.exp(power)
        one = _loft(self._rings(), caps=(True, False)).moved([0.0, self.offset, 0.0])
        self.mesh = Mesh.joined((_mirrored(one), one)) if twin else one

    def _side(self, fullness: float) -> Array:
        """Half breadths of the water line, as shares of the largest."""
        full = {"steerable_drive": 0.86, "thruster_pair": 0.8}.get(self.form.kind, 0.25)
        transom = full + (1.0 - full) * fullness**2
        start = 0.12 + 0.8 * fullness  # of the entrance
        end = min(start, 0.42 - 0.3 * fullness)  # of the run
        fore = np.clip((self.params - start) / (1.0 - start), 0.0, 1.0)
        aft = np.clip((end - self.params) / end, 0.0, 1.0)
        side = (1.0 - fore ** (1.65 + 1.5 * fullness)) * (1.0 - (1.0 - transom) * aft**2)
        return np.asarray(side / side.max())

    def _keel(self) -> Array:
        """Drafts of the sections, as shares of the largest."""
        foot = min(max(0.45 + 0.55 * self.block, 0.5), 0.95)
        keel = np.sqrt(1.0 - np.clip((self.params - foot) / (1.0 - foot), 0.0, 1.0) ** 2)
        if self.form.kind == "propeller_rudder":  # room for the propeller
            rise = np.clip(self.params / min(max(0.7 * (1.0 - self.block), 0.02), 0.14), 0.0, 1.0)
            keel *= 0.12 + 0.88 * rise**2 * (3.0 - 2.0 * rise)
        return np.asarray(keel / keel.max())

    def _below(self, fullness: float, power: float) -> tuple[Array, Array]:
        """Return y and z of the sections from keel to water line, m, each (stations, rows + 1)."""
        angle = np.linspace(0.0, 0.5 * math.pi, _BELOW + 1)
        across, down = np.sin(angle) ** (2.0 / power), np.cos(angle) ** (2.0 / power)
        down[-1] = 0.0
        y = 0.5 * self.beam * np.outer(self._side(fullness), across)
        return y, self.form.draft * np.outer(self._keel(), down)

    def _displaced(self, fullness: float, power: float) -> float:
        """Volume below water less that wanted, as a share of the box's."""
        y, z = self._below(fullness, power)

        def area(y: Array, z: Array) -> Array:
            steps = (y[:, 1:] + y[:, :-1]) * (z[:, :-1] - z[:, 1:])
            return np.asarray(steps.sum(axis=1))

        ends, half = area(y, z), area(0.5 * (y[1:] + y[:-1]), 0.5 * (z[1:] + z[:-1]))
        pieces = (ends[1:] + 4.0 * half + ends[:-1]) / 6.0 * np.diff(self.params)
        return float(pieces.sum()) / (self.beam * self.form.draft) - self.block

    def deck(self) -> tuple[Array, Array, Array]:
        """x, half breadth and z of the deck's edge, m, each (stations,)."""
        x, y, z = (self._rings()[:, _BELOW + _ABOVE, i] for i in range(3))
        return x, y, z

    def _rings(self) -> Array:
        """Sections as closed polygons from the keel up to starboard, (stations, points, 3)."""
        form, xi = self.form, self.params
        y, z = self._below(self.fullness, self.power)
        sheer = 1.0 + 0.45 * np.clip((xi - 0.35) / 0.65, 0.0, 1.0) ** 2
        if form.pontoon:
            sheer = 1.0 + 0.25 * np.clip((xi - 0.6) / 0.4, 0.0, 1.0) ** 2
        height = np.linspace(0.0, 1.0, _ABOVE + 1)[1:]
        side = self._side(self.fullness)
        y_top = 0.5 * self.beam * (np.outer(side, 1.0 - height) + np.outer(side**0.7, height))
        z_top = -form.freeboard * np.outer(sheer, height)
        y, z = np.hstack([y, y_top]), np.hstack([z, z_top])
        # the stem rakes forward; ships also hang over aft, boats carry their drives there
        over = form.overall - form.length
        back = 0.5 * over if form.kind == "propeller_rudder" else 0.0
        rise = np.concatenate([np.zeros(_BELOW + 1), height])
        rake = (over - back) * np.clip((xi - 0.45) / 0.55, 0.0, 1.0) ** 2
        rake -= back * np.clip((0.2 - xi) / 0.2, 0.0, 1.0)
        x = (form.stern + form.length * xi)[:, None] + np.outer(rake, rise**0.8)
        crown = z[:, -1:] - 0.05 * y[:, -1:]
        half = np.stack([x, y, z], axis=-1)
        top = np.stack([x[:, -1:], np.zeros_like(crown), crown], axis=-1)
        port = half[:, :0:-1] * (1.0, -1.0, 1.0)
        return np.concatenate([half, top, port], axis=1)


def _bisect(f: Callable[[float], float], a: float, b: float) -> float:
    """Return where a rising function passes zero, or the end that comes nearest."""
    if f(a) >= 0.0:
        return a
    if f(b) <= 0.0:
        return b
    low, high = a, b
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if f(middle) < 0.0 else (low, middle)
    return 0.5 * (low + high)


# ----------------------------------------------------------------------------- simple bodies
def _loft(rings: Array, caps: tuple[bool, bool] = (True, True)) -> Mesh:
    """Return the closed surface through closed polygons, (rings, points, 3).

    Points that fall together are one, so that an end may run into a point or an edge; others
    need a cap. Diagonals mirror from the first half of the points to the second.
    """
    m, k, _ = rings.shape
    index = np.arange(m * k).reshape(m, k)
    a, b = index[:-1], index[1:]
    a_next, b_next = np.roll(a, -1, axis=1), np.roll(b, -1, axis=1)
    first = np.arange(k) < k // 2
    one = np.where(first[:, None], *(np.stack(t, -1) for t in ((a, b, b_next), (a, b, a_next))))
    two = np.where(
        first[:, None], *(np.stack(t, -1) for t in ((a, b_next, a_next), (b, b_next, a_next)))
    )
    faces = [one.reshape(-1, 3), two.reshape(-1, 3)]
    points = [rings.reshape(-1, 3)]
    for i, (capped, ring) in enumerate(zip(caps, (index[0], index[-1]), strict=True)):
        if capped:
            centre = np.full(k, m * k + len(points) - 1)
            fan = np.stack([centre, ring, np.roll(ring, -1)], axis=-1)
            faces.append(fan if i == 0 else fan[:, ::-1])
            points.append(rings[-i].mean(axis=0)[None])
    return _merged(np.concatenate(points), np.concatenate(faces))


def _merged(points: Array, faces: NDArray[np.integer[Any]]) -> Mesh:
    """Join points that fall together, drop what has no area then, and turn the inside in."""
    grain = 1e-9 * float(np.ptp(points, axis=0).max())
    _, kept, where = np.unique(
        np.round(points / grain), axis=0, return_index=True, return_inverse=True
    )
    faces = where.reshape(-1)[faces]
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    mesh = Mesh(points[kept], faces.astype(np.int32))
    return mesh if mesh.volume >= 0.0 else Mesh(mesh.vertices, mesh.faces[:, ::-1])


def _mirrored(mesh: Mesh) -> Mesh:
    return Mesh(mesh.vertices * (1.0, -1.0, 1.0), mesh.faces[:, ::-1])


def _block(
    levels: Sequence[tuple[float, float, float, float]], power: float = 5.0, points: int = 16
) -> Mesh:
    """Return a body with rounded corners from levels of z, x of its ends and half breadth, m."""
    angle = 2.0 * math.pi * (np.arange(points) + 0.5) / points
    c, s = (np.copysign(np.abs(f(angle)) ** (2.0 / power), f(angle)) for f in (np.cos, np.sin))
    rings = [
        np.stack([0.5 * (x0 + x1) + 0.5 * (x1 - x0) * c, half * s, np.full(points, z)], axis=-1)
        for z, x0, x1, half in levels
    ]
    return _loft(np.array(rings))


def _turned(profile: Sequence[tuple[float, float]], axis: int, points: int = 12) -> Mesh:
    """Return a body of revolution about x (0), y (1) or z (2) from places and radii, m."""
    angle = 2.0 * math.pi * (np.arange(points) + 0.5) / points
    along, radius = np.array(profile).T
    rings = np.empty((len(along), points, 3))
    rings[..., axis] = along[:, None]
    rings[..., (axis + 1) % 3] = np.outer(radius, np.cos(angle))
    rings[..., (axis + 2) % 3] = np.outer(radius, np.sin(angle))
    return _loft(rings, caps=(profile[0][1] > 0.0, profile[-1][1] > 0.0))


def _ball(radius: float, centre: Sequence[float]) -> Mesh:
    angle = np.linspace(0.0, math.pi, 7)
    profile = [(-radius * math.cos(a), radius * math.sin(a)) for a in angle[1:-1]]
    return _turned([(-radius, 0.0), *profile, (radius, 0.0)], 2).moved(centre)


def _foil(chord: float, thick: float, low: float, high: float, lead: float) -> Mesh:
    """Return an upright blade from z = low to high, its nose ``lead`` ahead of the z axis, m."""
    s = np.array([0.0, 0.08, 0.3, 0.6, 1.0])
    half = 0.5 * thick * np.array([0.0, 0.62, 1.0, 0.72, 0.12])
    x = lead - chord * s
    outline = np.concatenate([np.stack([x, half], axis=-1), np.stack([x, -half], axis=-1)[:0:-1]])
    rings = [np.column_stack([outline, np.full(len(outline), z)]) for z in (low, high)]
    return _loft(np.array(rings))


def _propeller(diameter: float, blades: int = 3) -> Mesh:
    """Return a right-handed screw about x, its disc at x = 0, m."""
    hub = 0.14 * diameter
    pieces = [_turned([(-0.13 * diameter, 0.25 * hub), (0.0, 0.9 * hub), (0.1 * diameter, hub)], 0)]
    share = np.array([0.2, 0.45, 0.7, 0.9, 1.0])
    chord = diameter * np.array([0.2, 0.32, 0.36, 0.27, 0.08])
    pitch = np.arctan(1.0 / (math.pi * share))
    corners = np.array([[-0.5, 0.0], [0.0, 0.06], [0.5, 0.0], [0.0, -0.06]])
    rings = np.empty((len(share), 4, 3))
    for ring, r, c, p in zip(rings, 0.5 * diameter * share, chord, pitch, strict=True):
        along, off = c * corners[:, 0], c * corners[:, 1]
        ring[:, 0] = along * math.sin(p) + off * math.cos(p)
        side = along * math.cos(p) - off * math.sin(p)
        # the tip stays within the disc
        ring[:, 1] = side
        ring[:, 2] = np.sqrt(np.maximum(r * r - side * side, 0.0))
    blade = _loft(rings)
    for i in range(blades):
        a = 2.0 * math.pi * i / blades
        turn = np.array(
            [[1.0, 0.0, 0.0], [0.0, math.cos(a), -math.sin(a)], [0.0, math.sin(a), math.cos(a)]]
        )
        pieces.append(Mesh(blade.vertices @ turn.T, blade.faces))
    return Mesh.joined(pieces)


# --------------------------------------------------------------------------- what is on board
def _fixed(form: Form, lines: _Lines) -> Iterator[Part]:
    """Yield hull, deck and superstructure."""
    part = partial(_part, (0.0, 0.0, 0.0))
    yield part("hull", [lines.mesh])
    x, y, z = lines.deck()
    thick, inner = 0.006 * lines.beam, 0.93 * y
    rim, crown = z - 0.05 * (y - inner), z - 0.05 * y
    corners = (
        *((x, inner, rim - thick), (x, 0.0 * y, crown + thick)),
        *((x, -inner, rim - thick), (x, 0.0 * y, crown - thick)),
    )
    ring = np.stack([np.stack(corner, axis=-1) for corner in corners], axis=1)
    inside = (lines.params > 0.012) & (lines.params < 0.985)
    planks = _loft(ring[inside]).moved([0.0, lines.offset, 0.0])
    yield part("deck", [planks, _mirrored(planks)] if lines.offset else [planks])

    def floor(at: float) -> float:
        return float(np.interp(at, x, z - 0.05 * y))

    L, top = form.overall, form.above
    draw = _wheelhouse if form.kind != "propeller_rudder" else _ship_house
    if lines.offset:
        draw = _bridge
    for name, meshes in draw(form, floor, L, top).items():
        yield part(name, meshes)


def _part(position: tuple[float, float, float], name: str, meshes: Sequence[Mesh]) -> Part:
    kind = name.partition("_")[0].replace("rudder", "drive").replace("thruster", "drive")
    return Part(name=name, mesh=Mesh.joined(meshes), colour=COLOURS[kind], position=position)


Deck = Callable[[float], float]


def _wheelhouse(form: Form, floor: Deck, L: float, top: float) -> dict[str, list[Mesh]]:
    """Return the low wheelhouse and the mast with sensors of a fast boat."""
    a, b = form.stern + 0.22 * form.length, form.stern + 0.62 * form.length
    z = max(floor(a), floor(b))
    h = min(max(1.6 * top - form.freeboard, 0.06 * L), 0.13 * L)
    half = 0.29 * form.beam

    def level(s: float, out: float = 0.0) -> tuple[float, float, float, float]:
        nose = b - 0.10 * L * s**1.2 - (0.03 * L if s >= 1.0 else 0.0)
        width = half * (1.0 - 0.16 * s)
        return (z - h * s, a + 0.03 * L * s - out, nose + out, width + out)

    house = _block([(z + 0.3 * h, a, b + 0.03 * L, half), level(0.0), level(0.9), level(1.0)])
    trunk_end = form.stern + 0.84 * form.length
    low, fore = floor(0.5 * (b + trunk_end)), 0.5 * half
    trunk = _block(
        [
            (low + 0.5 * h, b - 0.1 * L, trunk_end, fore * 1.5),
            (low - 0.16 * h, b - 0.1 * L, trunk_end - 0.03 * L, fore * 1.4),
            (low - 0.22 * h, b - 0.1 * L, trunk_end - 0.06 * L, fore * 1.1),
        ],
        power=3.0,
    )
    glass = _block([level(0.42, 0.004 * L), level(0.8, 0.004 * L)])
    roof, foot = z - h, a + 0.10 * L
    tall = 0.16 * L
    r = 0.009 * L
    mast = [
        _turned([(roof + 0.02 * L, 1.6 * r), (roof - tall, 0.8 * r)], 2).moved([foot, 0.0, 0.0]),
        _turned([(-0.6 * half, 0.7 * r), (0.6 * half, 0.7 * r)], 1).moved(
            [foot, 0.0, roof - 0.7 * tall]
        ),
        _block(
            [
                (roof - 0.28 * tall, foot - 2 * r, foot + 5 * r, 2.4 * r),
                (roof - 0.34 * tall, foot - 2 * r, foot + 5 * r, 2.4 * r),
            ]
        ),
        _turned([(roof + r, 0.35 * r), (roof - 1.5 * tall, 0.15 * r)], 2, 6).moved(
            [a + 0.05 * L, 0.7 * half, 0.0]
        ),
    ]
    sensors = [
        _ball(1.9 * r, [foot, 0.6 * half, roof - 0.7 * tall - 2.2 * r]),
        _ball(1.9 * r, [foot, -0.6 * half, roof - 0.7 * tall - 2.2 * r]),
        _turned([(roof - tall, 1.7 * r), (roof - tall - 4.0 * r, 1.7 * r)], 2).moved(
            [foot, 0.0, 0.0]
        ),
        _turned([(roof - 0.34 * tall, 2.6 * r), (roof - 0.34 * tall - 2.0 * r, 2.6 * r)], 2).moved(
            [foot + 2 * r, 0.0, 0.0]
        ),
    ]
    return {
        "superstructure": [house, trunk],
        "windows": [glass],
        "mast": mast,
        "sensors": sensors,
    }


def _ship_house(form: Form, floor: Deck, L: float, top: float) -> dict[str, list[Mesh]]:
    """Return the deck house aft, funnel, masts and the deck's pipes of a cargo ship."""
    a, b = form.stern + 0.055 * form.length, form.stern + 0.135 * form.length
    z, half = floor(0.5 * (a + b)), 0.36 * form.beam
    h = min(max(1.2 * top, 0.05 * L), 0.075 * L)
    deep = z + 0.2 * form.freeboard
    box = partial(_block, power=12.0)
    bridge = z - h
    house = [
        box([(deep, a, b, half), (bridge, a, b, half)]),
        box(
            [
                (bridge, b - 0.03 * L, b + 0.004 * L, 0.5 * form.beam),
                (bridge - 0.012 * L, b - 0.03 * L, b + 0.004 * L, 0.5 * form.beam),
            ]
        ),
        box(
            [
                (bridge - 0.012 * L, b - 0.028 * L, b, 0.8 * half),
                (bridge - 0.024 * L, b - 0.026 * L, b - 0.003 * L, 0.76 * half),
            ]
        ),
    ]
    glass = [
        box(
            [
                (bridge - 0.0135 * L, b - 0.029 * L, b + 0.001 * L, 0.81 * half),
                (bridge - 0.0205 * L, b - 0.029 * L, b, 0.81 * half),
            ]
        )
    ]
    glass += [
        box(
            [
                (z - (s + 0.06) * h, a - 5e-4 * L, b + 5e-4 * L, half + 5e-4 * L),
                (z - s * h, a - 5e-4 * L, b + 5e-4 * L, half + 5e-4 * L),
            ]
        )
        for s in (0.3, 0.5, 0.7)
    ]
    funnel = _block(
        [
            (deep, a - 0.035 * L, a - 0.008 * L, 0.13 * form.beam),
            (z - 0.95 * h, a - 0.035 * L, a - 0.012 * L, 0.11 * form.beam),
        ],
        power=3.0,
    )
    r = 0.003 * L
    fore = form.stern + 0.95 * form.length
    aloft = bridge - 0.024 * L
    mast = [
        funnel,
        _turned([(aloft, 1.6 * r), (aloft - 0.04 * L, 0.7 * r)], 2).moved([b - 0.015 * L, 0, 0]),
        _turned([(-6 * r, 0.7 * r), (6 * r, 0.7 * r)], 1).moved(
            [b - 0.015 * L, 0.0, aloft - 0.026 * L]
        ),
        _turned([(floor(fore) + r, 1.5 * r), (floor(fore) - 0.04 * L, 0.7 * r)], 2).moved(
            [fore, 0.0, 0.0]
        ),
    ]
    mid = 0.5 * (b + fore)
    # pipes, and the manifold across them
    pipe, above = 0.36 * form.beam, floor(mid) - 2.5 * r
    mast += [
        _turned([(b, 0.8 * r), (fore - 0.05 * L, 0.8 * r)], 0, 8).moved([0.0, y * r, above])
        for y in (-2.2, 0.0, 2.2)
    ]
    mast += [
        _turned([(-pipe, 0.8 * r), (pipe, 0.8 * r)], 1, 8).moved([mid + at * r, 0.0, above])
        for at in (-4.5, 0.0, 4.5)
    ]
    sensors = [
        _ball(1.8 * r, [b - 0.015 * L, 6.0 * side * r, aloft - 0.026 * L - 2.0 * r])
        for side in (-1.0, 1.0)
    ]
    return {"superstructure": house, "windows": glass, "mast": mast, "sensors": sensors}


def _bridge(form: Form, floor: Deck, L: float, top: float) -> dict[str, list[Mesh]]:
    """Return the frame, platform and mast of a catamaran."""
    across, mid = 0.5 * (form.beam - form.pontoon), form.middle
    z = floor(mid) - 0.045 * L
    r = 0.011 * L
    frame = []
    for at in (-0.2, 0.2):
        x = mid + at * L
        frame.append(_turned([(-across, r), (across, r)], 1).moved([x, 0.0, z]))
        frame += [
            _turned([(floor(mid) + r, 1.3 * r), (z, r)], 2).moved([x, side * across, 0.0])
            for side in (-1.0, 1.0)
        ]
    wide = max(0.75 * across, 0.3 * form.beam)
    platform = [
        _block(
            [
                (z - 0.3 * r, mid - 0.25 * L, mid + 0.25 * L, wide),
                (z - 1.8 * r, mid - 0.25 * L, mid + 0.25 * L, wide),
            ],
            power=8.0,
        ),
        _block(
            [
                (z - 1.8 * r, mid - 0.17 * L, mid + 0.1 * L, 0.55 * wide),
                (z - 0.055 * L, mid - 0.16 * L, mid + 0.07 * L, 0.48 * wide),
            ]
        ),
    ]
    foot, roof, tall = mid + 0.02 * L, z - 0.055 * L, 0.2 * L
    frame += [
        _turned([(roof + r, r), (roof - tall, 0.6 * r)], 2).moved([foot, 0.0, 0.0]),
        _turned([(-0.3 * wide, 0.5 * r), (0.3 * wide, 0.5 * r)], 1).moved(
            [foot, 0.0, roof - 0.75 * tall]
        ),
    ]
    sensors = [
        _ball(1.5 * r, [foot, side * 0.3 * wide, roof - 0.75 * tall - 1.6 * r])
        for side in (-1.0, 1.0)
    ]
    sensors.append(
        _turned([(roof - tall, 1.6 * r), (roof - tall - 3.0 * r, 1.6 * r)], 2).moved(
            [foot, 0.0, 0.0]
        )
    )
    glass = [
        _block(
            [
                (roof + 0.004 * L, mid - 0.14 * L, mid + 0.03 * L, 0.38 * wide),
                (roof - 0.003 * L, mid - 0.14 * L, mid + 0.03 * L, 0.38 * wide),
            ],
            power=10.0,
        )
    ]
    return {"superstructure": platform, "windows": glass, "mast": frame, "sensors": sensors}


# ----------------------------------------------------------------------------------- drives
def _propulsion(form: Form) -> list[Part]:
    """Return drives or rudders, and the propellers."""
    parts: list[Part] = []
    for unit in range(form.units):
        name = ("_left", "_right")[unit] if form.units == 2 else ""
        y = (2 * unit - 1) * form.off
        parts += (_rudder if form.kind == "propeller_rudder" else _drive)(form, name, unit, y)
    return parts


def _drive(form: Form, name: str, unit: int, y: float) -> list[Part]:
    """Return a leg with its propeller, and the head that is seen above water."""
    D, fixed = form.screw, form.kind == "thruster_pair"
    x = form.arm
    if x is None:
        x = form.stern - (0.3 if fixed else 0.8) * D
    depth = form.draft if form.depth is None else form.depth
    up = -depth - 0.7 * form.freeboard  # where the leg ends, from the shaft
    chord = 0.62 * D
    torpedo = ((-0.42, 0.09), (-0.2, 0.13), (0.25, 0.13), (0.5, 0.05), (0.55, 0.0))
    leg = [
        _turned([(along * D, radius * D) for along, radius in torpedo], 0),
        _foil(chord, 0.16 * D, up, 0.0, 0.45 * chord),
        _foil(0.8 * chord, 0.05 * D, 0.0, 0.55 * D, 0.2 * chord),
        _block([(z * D, -0.62 * D, 0.3 * D, 0.22 * D) for z in (-0.62, -0.58)], power=3.0),
    ]
    parts = []
    if x < form.stern:  # the motor's cowl, and a bracket to the transom
        size = min((0.9 if fixed else 1.5) * D, 0.25 * form.beam)
        tall = (0.45 if fixed else 0.95) * min(size, form.freeboard)
        cowl = ((0.0, 0.42, 0.26), (0.25, 0.52, 0.33), (0.8, 0.5, 0.31), (1.0, 0.36, 0.22))
        leg.append(
            _block(
                [(up - at * tall, -long * size, long * size, w * size) for at, long, w in cowl],
                power=3.5,
            )
        )
        ends = (x + 0.1 * D, form.stern + 0.1 * D, 0.2 * D)
        bracket = _block([(z * form.freeboard, *ends) for z in (-0.6, -0.15)], power=8.0)
        parts.append(Part(f"bracket{name}", bracket.moved([0.0, y, 0.0]), COLOURS["mast"]))
    drive = Part(
        name=f"drive{name}",
        mesh=Mesh.joined(leg),
        colour=COLOURS["drive"],
        position=(x, y, depth),
        moves="" if fixed else "steer",
        unit=unit,
    )
    return [*parts, drive, _screw(form, name, unit, (-0.5 * D, 0.0, 0.0), drive.name)]


def _rudder(form: Form, name: str, unit: int, y: float) -> list[Part]:
    """Return a rudder, and the propeller before it on its shaft."""
    D = form.screw
    height, area = form.blade or (0.8 * form.draft, 0.0)
    chord = area / height if area > 0.0 else 0.55 * height
    x = form.stern if form.arm is None else form.arm
    depth = 0.7 * form.draft if form.depth is None else form.depth
    ahead = x + 0.02 * form.length if form.propeller is None else form.propeller
    z = min(depth, form.draft - 0.5 * height)
    stock = 0.06 * chord
    blade = [
        _foil(chord, 0.18 * chord, -0.5 * height, 0.5 * height, 0.3 * chord),
        _turned([(-z, stock), (-0.45 * height, stock)], 2),
    ]
    tube = _turned([(0.1 * D, 0.1 * D), (0.35 * D, 0.16 * D), (0.11 * form.length, 0.2 * D)], 0)
    shaft = Part(f"shaft{name}", tube, COLOURS["hull"], (ahead, y, depth))
    rudder = Part(
        f"rudder{name}", Mesh.joined(blade), COLOURS["drive"], (x, y, z), moves="steer", unit=unit
    )
    return [shaft, rudder, _screw(form, name, unit, (ahead, y, depth), "")]


def _screw(
    form: Form, name: str, unit: int, position: tuple[float, float, float], parent: str
) -> Part:
    return Part(
        f"propeller{name}",
        _propeller(form.screw),
        COLOURS["propeller"],
        position,
        parent,
        "spin",
        unit,
    )


# ------------------------------------------------------------------------------- mesh files
def _trimesh() -> Any:
    try:
        import trimesh
    except ImportError:
        raise VesselError(
            "mesh files need trimesh, which is not installed: pip install 'usv-twin[view]'"
        ) from None
    return trimesh


def _with_file(path: Path, form: Form, moving: Sequence[Part]) -> Boat:
    """Return a boat from a mesh file; a part that moves is drawn where the file has none."""
    trimesh = _trimesh()
    place = f"[vessel] mesh: {path}:"
    try:
        with np.errstate(all="ignore"):  # of numbers that are none: told below
            scene = trimesh.load_scene(path, process=False)  # which would drop them
            found = []
            for node in scene.graph.nodes_geometry:
                transform, key = scene.graph[node]
                solid = scene.geometry[key]
                if isinstance(solid, trimesh.Trimesh):
                    found.append((str(node), solid.copy().apply_transform(transform)))
    except OSError as error:
        raise VesselError(f"{place} cannot be read ({error.strerror or error})") from None
    except Exception:  # a parser of foreign files may raise anything
        raise VesselError(
            f"{place} is no {path.suffix} file that can be read: it is damaged, cut off, empty or "
            "of another kind; export it again"
        ) from None
    if not any(len(solid.faces) for _, solid in found):
        raise VesselError(f"{place} holds no triangles; export the boat's surface as a mesh")
    if not all(np.isfinite(solid.vertices).all() for _, solid in found):
        raise VesselError(f"{place} has vertices that are no finite numbers; export it again")
    for _, solid in found:
        solid.merge_vertices()
    turn = _GLTF if path.suffix.lower() == ".glb" else _UPRIGHT
    own = {part.name: part for part in moving}
    parts: dict[str, Part] = {}
    for name, solid in found:
        mesh = Mesh(np.asarray(solid.vertices) @ turn, np.asarray(solid.faces, dtype=np.int32))
        if name in own:
            mesh = mesh.moved(-Boat(tuple(moving)).place(own[name]))
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
    """Say what is likely wrong with a mesh of a wrong length."""
    spans = np.ptp(body.bounds, axis=0)
    for factor, unit in ((1e-3, "mm"), (1e-2, "cm"), (0.0254, "inches"), (0.3048, "feet")):
        if 0.8 <= factor * spans[0] / form.overall <= 1.25:
            return f"it seems to be in {unit}; export it in m"
    if 0.5 <= spans.max() / form.overall <= 2.0:
        return (
            "it seems to point elsewhere; in .glb files y is up and z forward, in others z is up "
            "and x forward"
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
