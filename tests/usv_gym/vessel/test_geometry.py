"""Geometric models: closed surfaces of the given size and volume, and mesh files."""

from __future__ import annotations

import dataclasses
import pickle
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import usv_gym
from usv_gym import Vessel, vessel_names
from usv_gym.vessel.geometry import Boat, Form, Mesh, boat_of, hull_of
from usv_gym.vessel.hull_lines import HullLines
from usv_gym.vessel.vessel import KIND_SCHEMA, MESH_FORMATS, VesselError

trimesh = pytest.importorskip("trimesh")

USV75 = Path(usv_gym.__file__).parent / "vessel" / "vessels" / "usv75.toml"


def submerged(mesh: Mesh) -> float:
    """Return the volume below z = 0 of a hull with a ring of points at z = 0."""
    triangles = mesh.vertices[mesh.faces]
    below = triangles[(triangles[..., 2] > -1e-9 * np.ptp(mesh.bounds)).all(axis=1)]
    normals = 0.5 * np.cross(below[:, 1] - below[:, 0], below[:, 2] - below[:, 0])
    return float((below[..., 2].mean(axis=1) * normals[:, 2]).sum())


def waterline(mesh: Mesh) -> np.ndarray:
    """Return length and beam on the water line, m."""
    on = np.abs(mesh.vertices[:, 2]) < 1e-9 * np.ptp(mesh.bounds)
    return np.asarray(np.ptp(mesh.vertices[on, :2], axis=0))


def check_solid(mesh: Mesh) -> None:
    solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    assert solid.is_watertight
    assert solid.is_winding_consistent
    assert solid.volume > 0.0
    assert mesh.volume == pytest.approx(solid.volume)


def check_symmetric(mesh: Mesh) -> None:
    grain = 1e-7 * np.ptp(mesh.bounds)
    mirrored = mesh.vertices * (1.0, -1.0, 1.0)
    both = [{tuple(row) for row in np.round(v / grain)} for v in (mesh.vertices, mirrored)]
    near = both[0] ^ both[1]  # a coordinate on the edge of rounding may fall to either side
    assert len(near) <= 0.02 * len(both[0])
    assert abs(mesh.vertices[:, 1].max() + mesh.vertices[:, 1].min()) <= grain


@pytest.fixture(params=vessel_names())
def vessel(request: pytest.FixtureRequest) -> Vessel:
    return Vessel.load(request.param)


def test_hull_is_closed_with_the_displacement_of_the_vessel(vessel: Vessel) -> None:
    hull, v = boat_of(vessel)["hull"].mesh, vessel.values
    check_solid(hull)
    check_symmetric(hull)
    volume = v["block_coefficient"] * v["length_waterline"] * v["beam"] * v["draft"]
    assert submerged(hull) == pytest.approx(volume, rel=0.01)
    np.testing.assert_allclose(waterline(hull), [v["length_waterline"], v["beam"]], rtol=1e-9)
    assert hull.bounds[1, 2] == pytest.approx(v["draft"])
    assert np.ptp(hull.bounds[:, 0]) == pytest.approx(v["length_overall"])
    assert np.ptp(hull.bounds[:, 1]) == pytest.approx(v["beam"])


def test_water_plane_has_the_area_of_the_vessel() -> None:
    vessel = Vessel.load("usv75")
    on = boat_of(vessel)["hull"].mesh.vertices
    on = on[np.abs(on[:, 2]) < 1e-9]
    side = on[on[:, 1] >= 0.0]
    side = side[np.argsort(side[:, 0])]
    assert 2.0 * np.trapezoid(side[:, 1], side[:, 0]) == pytest.approx(vessel.A_wp, rel=0.01)


def test_parts_are_closed_and_have_few_vertices(vessel: Vessel) -> None:
    boat = boat_of(vessel)
    for part in boat.parts:
        check_solid(part.mesh)
        assert np.isfinite(part.mesh.vertices).all()
    assert len({part.name for part in boat.parts}) == len(boat.parts)
    assert sum(len(part.mesh.vertices) for part in boat.parts) < 4000


def test_catamarans_have_two_hulls() -> None:
    for name, hulls in {"otter": 2, "wamv16": 2, "usv75": 1}.items():
        mesh = boat_of(Vessel.load(name))["hull"].mesh
        solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
        assert len(solid.split()) == hulls
        assert (np.abs(mesh.vertices[:, 1]).min() > 0.0) == (hulls == 2)


def test_drives_and_rudders_have_the_positions_of_the_vessel(vessel: Vessel) -> None:
    boat, v = boat_of(vessel), vessel.values
    sides = ("_left", "_right") if v["units"] == 2.0 else ("",)
    for unit, side in enumerate(sides):
        propeller = boat[f"propeller{side}"]
        y = (2 * unit - 1) * v["y_P"] if side else 0.0
        assert propeller.moves == "spin"
        assert propeller.unit == unit
        np.testing.assert_allclose(boat.position_of(propeller)[1:], [y, v["z_P"]])
        radius = np.hypot(*propeller.mesh.vertices[:, 1:].T).max()
        assert radius == pytest.approx(0.5 * v["propeller_diameter"], rel=0.05)
        if vessel.kind == "propeller_rudder":
            rudder = boat[f"rudder{side}"]
            assert rudder.moves == "steer"
            assert rudder.position[0] == pytest.approx(v["x_R_prime"] * v["length_waterline"])
            assert propeller.position[0] == pytest.approx(v["x_P_prime"] * v["length_waterline"])
            assert rudder.mesh.bounds[1, 2] == pytest.approx(0.5 * v["rudder_height"])
        else:
            drive = boat[f"drive{side}"]
            assert propeller.parent == drive.name
            assert drive.moves == ("" if vessel.kind == "thruster_pair" else "steer")
            assert drive.position[0] == pytest.approx(v.get("x_P", drive.position[0]))
            assert drive.position[0] < boat["hull"].mesh.bounds[0, 0] + 0.1 * v["length_overall"]


@st.composite
def forms(draw: st.DrawFn) -> Form:
    """Draw a form of any shape and size."""
    length, kind = draw(st.floats(0.5, 400.0)), draw(st.sampled_from(tuple(KIND_SCHEMA)))
    beam = length / draw(st.floats(1.2, 10.0))
    draft = beam / draw(st.floats(1.5, 12.0))

    def some(low: float, high: float, scale: float) -> float | None:
        share = draw(st.none() | st.floats(low, high))
        return None if share is None else share * scale

    return Form(
        length=length,
        beam=beam,
        draft=draft,
        volume=draw(st.floats(0.35, 0.9)) * length * beam * draft,
        length_overall=some(0.9, 1.4, length),
        waterplane=some(0.3, 1.0, length * beam),
        kind=kind,
        units=2 if kind == "thruster_pair" else draw(st.sampled_from([1, 2])),
        arm=some(-0.8, -0.01, length),
        aside=some(0.0, 0.6, beam),
    )


@pytest.mark.slow
@settings(max_examples=50, deadline=None)
@given(forms())
def test_any_boat_can_be_drawn(form: Form) -> None:
    hull = HullLines(form).mesh
    check_solid(hull)
    assert submerged(hull) == pytest.approx(form.volume, rel=0.02)
    np.testing.assert_allclose(waterline(hull), [form.length, form.beam], rtol=1e-6)
    assert hull.bounds[1, 2] == pytest.approx(form.draft)
    for part in boat_of(form).parts:
        check_solid(part.mesh)


def with_mesh(folder: Path, mesh: str) -> Path:
    """Write usv75 with a mesh; return its file."""
    path = folder / "mine.toml"
    text = USV75.read_text(encoding="utf-8")
    path.write_text(text.replace("[vessel]", f'[vessel]\nmesh = "{mesh}"', 1), encoding="utf-8")
    return path


UPRIGHT = np.diag([1.0, -1.0, -1.0])
GLTF = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])


def write_mesh(path: Path, boat: Boat) -> None:
    """Write the parts of a boat as a mesh file: .glb has y up, others z up."""
    turn = GLTF if path.suffix == ".glb" else UPRIGHT
    scene = trimesh.Scene()
    for part in boat.parts:
        vertices = part.mesh.moved(boat.position_of(part)).vertices @ turn.T
        solid = trimesh.Trimesh(vertices, part.mesh.faces, process=False)
        material = trimesh.visual.material.PBRMaterial(baseColorFactor=[*part.colour, 255])
        solid.visual = trimesh.visual.TextureVisuals(material=material)
        scene.add_geometry(solid, node_name=part.name, geom_name=part.name)
    if path.suffix == ".glb":
        scene.export(path)
    else:
        scene.to_geometry().export(path)


@pytest.mark.parametrize("suffix", MESH_FORMATS)
def test_a_mesh_file_replaces_hull_and_superstructure(tmp_path: Path, suffix: str) -> None:
    boat = boat_of(Vessel.load("usv75"))
    hull = dataclasses.replace(boat["hull"], colour=(10, 200, 30))
    write_mesh(tmp_path / f"hull{suffix}", Boat((hull,)))
    vessel = Vessel.load(with_mesh(tmp_path, f"hull{suffix}"))
    again = boat_of(vessel)
    assert [part.name for part in again.parts[1:]] == [
        part.name for part in boat.parts if part.moves or part.name.startswith("bracket")
    ]
    assert hull_of(vessel).volume == pytest.approx(hull.mesh.volume, rel=1e-4)
    np.testing.assert_allclose(again.parts[0].mesh.bounds, hull.mesh.bounds, atol=1e-5)
    if suffix == ".glb":
        assert again.parts[0].colour == (10, 200, 30)


def test_drives_of_a_glb_file_take_the_place_of_drawn_ones(tmp_path: Path) -> None:
    boat = boat_of(Vessel.load("usv75"))
    write_mesh(tmp_path / "boat.glb", boat)
    again = boat_of(Vessel.load(with_mesh(tmp_path, "boat.glb")))
    assert {part.name for part in again.parts} == {part.name for part in boat.parts}
    for part in boat.parts:
        back = again[part.name]
        np.testing.assert_allclose(back.mesh.bounds, part.mesh.bounds, atol=1e-5)
        np.testing.assert_allclose(again.position_of(back), boat.position_of(part))
        assert (back.moves, back.parent, back.unit) == (part.moves, part.parent, part.unit)


def test_a_vessel_keeps_its_mesh(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_mesh(tmp_path / "boat.glb", boat_of(Vessel.load("usv75")))
    with_mesh(tmp_path, "boat.glb")
    monkeypatch.chdir(tmp_path.parent)
    vessel = Vessel.load(f"{tmp_path.name}/mine.toml")
    monkeypatch.chdir("/")
    for other in (
        pickle.loads(pickle.dumps(vessel)),
        vessel.varied(np.random.default_rng(0)),
        dataclasses.replace(vessel, name="other"),
    ):
        assert other.mesh == (tmp_path / "boat.glb").resolve()
        boat_of(other)


def refused(folder: Path, mesh: str, message: str) -> None:
    with pytest.raises(VesselError, match=message) as caught:
        boat_of(Vessel.load(with_mesh(folder, mesh)))
    assert mesh in str(caught.value)
    assert "\n" not in str(caught.value)


def test_bad_mesh_files_are_refused(tmp_path: Path) -> None:
    refused(tmp_path, "none.glb", "no file")
    (tmp_path / "boat.fbx").touch()
    refused(tmp_path, "boat.fbx", r"\.glb, \.stl")
    damaged = b"", b"glTF", b"solid x", b"glTF\x02\0\0\0\x14\0\0\0" + bytes(8), b"none \xff\0"
    for suffix in MESH_FORMATS:
        for content in damaged:
            (tmp_path / f"bad{suffix}").write_bytes(content)
            refused(tmp_path, f"bad{suffix}", "can be read|no triangles")
    for text, word in (
        ("# nothing\n", "can be read|no triangles"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\n", "can be read|no triangles"),
        ("v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "finite"),
    ):
        (tmp_path / "bad.obj").write_text(text)
        refused(tmp_path, "bad.obj", word)
    boat = boat_of(Vessel.load("usv75"))
    write_mesh(tmp_path / "drive.glb", Boat((boat["drive_left"],)))
    refused(tmp_path, "drive.glb", "hull")


@pytest.mark.parametrize(
    ("change", "moved", "message"),
    [
        (np.eye(3) * 1e3, 0.0, "in mm"),
        (np.eye(3) * 100.0, 0.0, "in cm"),
        (np.eye(3) / 0.3048, 0.0, "in feet"),
        (np.eye(3) * 5.0, 0.0, "must be in m"),
        (np.eye(3)[[2, 1, 0]], 0.0, "axes"),
        (np.eye(3), 500.0, "origin"),
    ],
)
def test_a_mesh_of_another_size_or_place_is_refused(
    tmp_path: Path, change: np.ndarray, moved: float, message: str
) -> None:
    hull = boat_of(Vessel.load("usv75"))["hull"]
    mesh = Mesh(hull.mesh.vertices @ change, hull.mesh.faces).moved([moved, 0.0, 0.0])
    write_mesh(tmp_path / "wrong.stl", Boat((dataclasses.replace(hull, mesh=mesh),)))
    refused(tmp_path, "wrong.stl", message)


def test_missing_trimesh_is_reported_with_the_remedy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "boat.stl").touch()
    monkeypatch.setitem(sys.modules, "trimesh", None)
    refused(tmp_path, "boat.stl", r"usv-twin\[view\]")
