"""Make the hydrodynamic table of a vessel's hull with the boundary-element code capytaine.

Run ``python examples/hydrodynamics/make_table.py usv75 [usv75.nc]``.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from usv_gym import Vessel
from usv_gym.hydro.motions import response
from usv_gym.hydro.netcdf import write_table
from usv_gym.hydro.table import HydroTable
from usv_gym.physics import GRAVITY
from usv_gym.vessel.geometry import hull_of

try:
    import capytaine as cpt
except ImportError as error:
    raise SystemExit(f"{error}: python -m pip install -e '.[hydro]'") from None

# over sqrt(g / L); in shorter waves panels of pontoons are too coarse
FREQUENCIES = np.concatenate(
    [[0.3, 0.45, 0.6, 0.75, 0.9, 1.05], np.arange(1.2, 5.01, 0.17), [5.4, 5.92, 6.44]]
)
HEADINGS_RAD = np.linspace(0.0, np.pi, 13)
ANGLES_RAD = 2.0 * np.pi * np.arange(120) / 120  # at which the waves sent out are counted
PANELS_MAX = 4000  # the time grows with their square, and more
LID_PANELS = 250  # about, inside the water line against irregular frequencies
MODES = ("Surge", "Sway", "Heave", "Roll", "Pitch", "Yaw")
# x ahead, y to port, z up -> x ahead, y to starboard, z down, and the wave from the other side
TURN = np.array([1.0, 1.0, -1.0, -1.0, -1.0, 1.0])


def wetted_panels(vessel: Vessel) -> np.ndarray:
    """Return the triangles below water, corners (n, 3, 3) in m: x ahead, y to port, z up.

    A hull that would trim is moved along until its centre of buoyancy lies below that of gravity:
    else the waves would push the boat beside its mass.
    """
    hull = hull_of(vessel)
    corners = (hull.vertices * (1.0, -1.0, -1.0))[hull.faces]
    below = corners[:, :, 2] < 0.0
    count = below.sum(axis=1)
    pieces = [corners[count == 3]]
    for wet in (1, 2):
        # turned so that the one corner on its own side comes first
        cut, side = corners[count == wet], below[count == wet]
        order = (np.argmax(side == (wet == 1), axis=1)[:, None] + np.arange(3)) % 3
        p, q, r = np.moveaxis(np.take_along_axis(cut, order[:, :, None], axis=1), 1, 0)
        pq, pr = (p + (p[:, 2:] / (p - to)[:, 2:]) * (to - p) for to in (q, r))
        pairs = [(p, pq, pr)] if wet == 1 else [(pq, q, r), (pq, r, pr)]
        pieces += [np.stack(three, axis=1) for three in pairs]
    corners = np.concatenate(pieces)
    return corners + np.array([vessel.values["x_G"] - hydrostatics(corners)["x_B"], 0.0, 0.0])


def hydrostatics(corners: np.ndarray) -> dict[str, float]:
    """Return volume (m3), centres of buoyancy and water plane (m), its area and inertias."""
    a, b, c = np.moveaxis(corners, 1, 0)
    down = -0.5 * np.cross(b - a, c - a)[:, 2]  # what lies below the water plane is the hull
    sums = a + b + c

    def mean(p: int, q: int) -> np.ndarray:
        """Return the mean of the product of two coordinates over each triangle."""
        at_corners = a[:, p] * a[:, q] + b[:, p] * b[:, q] + c[:, p] * c[:, q]
        return (at_corners + sums[:, p] * sums[:, q]) / 12.0

    volume, area = -np.sum(sums[:, 2] / 3.0 * down), np.sum(down)
    x_F = np.sum(sums[:, 0] / 3.0 * down) / area
    return {
        "volume": volume,
        "x_B": -np.sum(mean(0, 2) * down) / volume,
        "z_B": -0.5 * np.sum(mean(2, 2) * down) / volume,  # up
        "A_wp": area,
        "x_F": x_F,
        "I_T": np.sum(mean(1, 1) * down),
        "I_L": np.sum(mean(0, 0) * down) - area * x_F**2,
    }


def floating_body(vessel: Vessel, corners: np.ndarray, plane: float) -> cpt.FloatingBody:
    """Return the body of wetted panels, with a lid on its water plane (area in m2)."""
    grain = 1e-6 * vessel.values["beam"]
    port, starboard = ((side * corners[:, :, 1] > -grain).all(axis=1) for side in (1.0, -1.0))
    half = bool((port | starboard).all())
    corners = corners[port] if half else corners
    if len(corners) > PANELS_MAX:
        raise SystemExit(f"{vessel.name}: {len(corners)} wetted panels; make the mesh coarser")
    grain = 1e-7 * np.ptp(corners)
    points, where = np.unique(np.round(corners.reshape(-1, 3) / grain), axis=0, return_inverse=True)
    faces = where.reshape(-1, 3)
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    mesh = cpt.Mesh(points * grain, faces)
    if half:
        mesh = cpt.ReflectionSymmetricMesh(mesh, plane="xOz")
    dofs = cpt.rigid_body_dofs(rotation_center=(0.0, 0.0, 0.0))
    lid = mesh.generate_lid(faces_max_radius=np.sqrt(0.5 * plane / LID_PANELS))
    return cpt.FloatingBody(mesh, dofs=dofs, lid_mesh=lid, name=vessel.name)


def make_table(vessel: Vessel) -> HydroTable:
    """Return added mass, damping, excitation and mean drift; half a minute for a shipped boat."""
    corners, v = wetted_panels(vessel), vessel.values
    hull, solver = hydrostatics(corners), cpt.BEMSolver()
    body = floating_body(vessel, corners, hull["A_wp"])
    omega = FREQUENCIES * np.sqrt(GRAVITY / v["length_waterline"])
    F, H, N = len(omega), len(HEADINGS_RAD), len(ANGLES_RAD)
    added_mass, damping = np.zeros((2, F, 6, 6))
    excitation = np.zeros((F, H, 6), dtype=complex)
    radiated, diffracted = np.zeros((F, 6, N), dtype=complex), np.zeros((F, H, N), dtype=complex)
    x, y, z = body.mesh_including_lid.faces_centers.T
    areas = body.mesh_including_lid.faces_areas
    across = np.outer(np.cos(ANGLES_RAD), x) + np.outer(np.sin(ANGLES_RAD), y)
    for i, w in enumerate(omega):
        # Kochin functions of the sources on all panels
        far = np.exp(w**2 / GRAVITY * (z - 1j * across)) * areas / (4.0 * np.pi)
        water = {"body": body, "omega": w, "rho": v["water_density"], "g": GRAVITY}
        for j, mode in enumerate(MODES):
            problem = cpt.RadiationProblem(radiating_dof=mode, **water)
            got = solver.solve(problem, keep_details=True, _check_wavelength=False)
            added_mass[i, :, j] = [got.added_masses[name] for name in MODES]
            damping[i, :, j] = [got.radiation_dampings[name] for name in MODES]
            radiated[i, j] = far @ got.sources
        for j, heading in enumerate(HEADINGS_RAD):
            problem = cpt.DiffractionProblem(wave_direction=heading, **water)
            got = solver.solve(problem, keep_details=True, _check_wavelength=False)
            incident = cpt.bem.airy_waves.froude_krylov_force(problem)
            excitation[i, j] = [got.forces[name] + incident[name] for name in MODES]
            diffracted[i, j] = far @ got.sources
        print(f"{vessel.name}: {i + 1} of {F} frequencies", flush=True)
    turn, arm = TURN[:, None] * TURN, hull["z_B"] - (v["KG"] - v["draft"])
    table = HydroTable(
        omega=omega,
        heading=HEADINGS_RAD,
        added_mass=turn * 0.5 * (added_mass + np.swapaxes(added_mass, 1, 2)),
        damping=turn * 0.5 * (damping + np.swapaxes(damping, 1, 2)),
        excitation=TURN * excitation,
        length=v["length_waterline"],
        density=v["water_density"],
        hydrostatics=(
            hull["A_wp"],
            hull["x_F"],
            hull["I_T"] / hull["volume"] + arm,
            hull["I_L"] / hull["volume"] + arm,
        ),
        source=f"examples/hydrodynamics/make_table.py {vessel.name}, capytaine {cpt.__version__}",
    )
    moving = vessel.with_table(table).values
    motion = response(table, moving)
    roll = moving["mass"] * GRAVITY * moving["GM_T"] * (moving["I_xx"] + moving["J_xx"])
    viscous = 2.0 * moving["zeta_roll_viscous"] * np.sqrt(roll)
    absorbed = 0.5 * viscous * omega[:, None] ** 2 * np.abs(motion[..., 3]) ** 2
    waves = 1j * (diffracted + np.einsum("fhj,fjn->fhn", TURN * motion, radiated))
    return replace(table, drift=mean_drift(omega, waves, absorbed, table.density))


def mean_drift(omega, kochin, absorbed, density):
    """Return the mean drift (F, H, 3) per square of the amplitude from far-field waves.

    ``kochin`` (F, H, N) is the Kochin function of all waves that the moving hull sends out,
    ``absorbed`` (F, H) the power that viscous damping takes, W/m2; axes as in capytaine.

    Source: Maruo 1960, Newman 1967, in capytaine's scale. What the wave loses is taken from the
    energy sent out and absorbed, not from the wave sent straight on: the two are equal by
    conservation of energy.
    """
    k, theta, N = (omega**2 / GRAVITY)[:, None], ANGLES_RAD, len(ANGLES_RAD)
    step, scale = 2.0 * np.pi / N, 2.0 * np.pi * density * k**2
    sent = scale[..., None] * np.abs(kochin) ** 2 * step
    lost = sent.sum(axis=2) + absorbed * k / omega[:, None]
    surge = lost * np.cos(HEADINGS_RAD) - np.sum(sent * np.cos(theta), axis=2)
    sway = lost * np.sin(HEADINGS_RAD) - np.sum(sent * np.sin(theta), axis=2)
    order = np.fft.fftfreq(N, 1.0 / N)
    waves = np.fft.fft(kochin, axis=2)
    slope = np.fft.ifft(1j * order * waves, axis=2)
    ahead = np.exp(1j * order * HEADINGS_RAD[:, None])
    straight = np.einsum("fhn,hn->fh", 1j * order * waves, ahead) / N
    yaw = (2.0 * np.pi * density * omega[:, None] / k) * (1j * straight).real
    yaw = yaw - scale / k * np.sum((np.conj(kochin) * slope).imag, axis=2) * step
    return np.stack([surge, sway, yaw], axis=-1)


def main(vessel: str, out: str = "") -> None:
    """Write the table, and print what it replaces in the vessel file."""
    boat, path = Vessel.load(vessel), Path(out or f"{Path(vessel).stem}.nc")
    cpt.set_logging("ERROR")
    table = make_table(boat)
    write_table(path, table)
    with_table = boat.with_table(table)
    for key, value in with_table.values.items():
        if value != with_table.stated.get(key):
            print(f"{key}: {with_table.stated.get(key, float('nan')):.4g} -> {value:.4g}")
    print(f'{path}: write hydro = "{path.name}" in [vessel] of the vessel file beside it')


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("vessel", help="name of a vessel, or its TOML file")
    parser.add_argument("out", nargs="?", default="", help="the table, VESSEL.nc if left out")
    main(**vars(parser.parse_args()))
