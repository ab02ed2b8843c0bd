"""Geometric models: closed surfaces of the given size and volume."""

import numpy as np
import pytest

from usv_gym import Vessel, vessel_names
from usv_gym.vessel.geometry import Mesh, boat_of

trimesh = pytest.importorskip("trimesh")


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
