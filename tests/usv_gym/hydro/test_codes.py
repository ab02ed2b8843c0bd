"""Results of other codes become the same table, and damaged ones a sentence."""

import math

import numpy as np
import pytest

from usv_gym import Vessel
from usv_gym.hydro.codes import Water, read_results
from usv_gym.hydro.netcdf import encode_table
from usv_gym.hydro.table import HydroError
from usv_gym.physics import GRAVITY

BOAT = Vessel.load("usv75")
TABLE = BOAT.hydro
WATER = Water(TABLE.length, TABLE.density, BOAT.values["mass"])
TURN = np.array([1.0, 1.0, -1.0, -1.0, -1.0, 1.0])
BOTH = TURN[:, None] * TURN


def stiffness():
    A_wp, x_F, GM_T, GM_L = TABLE.hydrostatics
    C = np.zeros((6, 6))
    C[2, 2] = TABLE.density * GRAVITY * A_wp
    C[2, 4] = C[4, 2] = -C[2, 2] * x_F
    weight = WATER.mass * GRAVITY
    C[3, 3], C[4, 4] = weight * GM_T, weight * GM_L + C[2, 2] * x_F**2
    return C


def write_wamit(folder, lines=None):
    one, three, eight, hst = [], [], [], []
    for i, omega in enumerate(TABLE.omega):
        T = 2.0 * math.pi / omega
        A, B = BOTH * TABLE.added_mass[i], BOTH * TABLE.damping[i]
        for p in range(6):
            for q in range(6):
                a, b = A[p, q] / WATER.density, B[p, q] / WATER.density / omega
                one.append(f"{T:.9e} {p + 1} {q + 1} {a:.9e} {b:.9e}")
        for j, heading in enumerate(TABLE.heading):
            beta = f"{math.degrees(heading):.6f}"
            for p in range(6):
                load = np.conj(TURN[p] * TABLE.excitation[i, j, p]) / WATER.density / GRAVITY
                phase = math.degrees(np.angle(load))
                three.append(
                    f"{T:.9e} {beta} {p + 1} {abs(load):.9e} {phase:.6f} "
                    f"{load.real:.9e} {load.imag:.9e}"
                )
            for mode, value in zip((1, 2, 6), TABLE.drift[i, j], strict=True):
                value = value / WATER.density / GRAVITY
                eight.append(f"{T:.9e} {beta} {beta} {mode} {abs(value):.6e} 0 {value:.9e} 0")
    for p, q in np.argwhere(stiffness() != 0.0):
        hst.append(f"{p + 1} {q + 1} {stiffness()[p, q] / WATER.density / GRAVITY:.9e}")
    for suffix, rows in ((".1", one), (".3", three), (".8", eight), (".hst", hst)):
        (folder / f"boat{suffix}").write_text("\n".join(rows[:lines]) + "\n")
    return folder / "boat.1"


def write_nemoh(folder):
    results = folder / "results"
    results.mkdir()
    (folder / "Mesh").mkdir()
    np.savetxt(folder / "Mesh" / "KH.dat", stiffness())
    A, B = BOTH * TABLE.added_mass, BOTH * TABLE.damping
    text = 'VARIABLES="w (rad/s)"\n'
    for q in range(6):
        text += f'Zone t="Motion of body 1 in DoF {q + 1}",I={len(TABLE.omega)},F=POINT\n'
        pairs = np.stack([A[:, :, q], B[:, :, q]], axis=-1).reshape(len(TABLE.omega), 12)
        for omega, row in zip(TABLE.omega, pairs, strict=True):
            text += " ".join(f"{number:.9e}" for number in (omega, *row)) + "\n"
    (results / "RadiationCoefficients.tec").write_text(text)
    text = 'VARIABLES="w (rad/s)"\n'
    for j in range(len(TABLE.heading)):
        text += 'Zone t="Diffraction force",F=POINT\n'
        F = TURN * TABLE.excitation[:, j]
        pairs = np.stack([np.abs(F), np.angle(F)], axis=-1).reshape(len(TABLE.omega), 12)
        for omega, row in zip(TABLE.omega, pairs, strict=True):
            text += " ".join(f"{number:.9e}" for number in (omega, *row)) + "\n"
    (results / "ExcitationForce.tec").write_text(text)
    return folder


def assert_same(found, drift):
    for name in ("omega", "heading", "added_mass", "damping", "excitation"):
        wanted = getattr(TABLE, name)
        size = np.abs(wanted).max(axis=0)
        error = np.abs(getattr(found, name) - wanted)
        assert np.all(error <= 1e-5 * (size + np.abs(wanted).max())), name
    np.testing.assert_allclose(found.hydrostatics, TABLE.hydrostatics, rtol=1e-5, atol=1e-6)
    if drift:
        np.testing.assert_allclose(found.drift, TABLE.drift, rtol=1e-5, atol=1e-2)
    else:
        assert found.drift is None


def test_wamit_is_read(tmp_path):
    assert_same(read_results(write_wamit(tmp_path), WATER), drift=True)


def test_nemoh_is_read(tmp_path):
    assert_same(read_results(write_nemoh(tmp_path), WATER), drift=False)


def test_a_table_of_our_own_is_read_and_moved(tmp_path):
    path = tmp_path / "table.nc"
    path.write_bytes(encode_table(TABLE))
    assert_same(read_results(path, WATER), drift=True)
    moved = read_results(path, WATER, origin=0.5)
    wanted = TABLE.moved(0.5)
    np.testing.assert_allclose(moved.excitation, wanted.excitation, rtol=1e-6)


def test_damaged_results_give_a_sentence(tmp_path):
    path = write_wamit(tmp_path, lines=100)
    with pytest.raises(HydroError, match="lacks some of the periods"):
        read_results(path, WATER)
    path.write_text("nothing here")
    with pytest.raises(HydroError, match="no periods"):
        read_results(path, WATER)
    with pytest.raises(HydroError, match="no such file"):
        read_results(tmp_path / "none.1", WATER)
    (tmp_path / "a.txt").write_text("")
    with pytest.raises(HydroError, match=r"give a \.nc file"):
        read_results(tmp_path / "a.txt", WATER)
    (tmp_path / "empty").mkdir()
    with pytest.raises(HydroError, match="cannot be read"):
        read_results(tmp_path / "empty", WATER)


def test_capytaine_s_own_file_is_read(tmp_path):
    xarray = pytest.importorskip("xarray")
    pytest.importorskip("netCDF4")
    dofs = ["Surge", "Sway", "Heave", "Roll", "Pitch", "Yaw"]
    F = TURN * TABLE.excitation
    parts = np.stack([F.real, F.imag])
    data = xarray.Dataset(
        {
            "added_mass": (("omega", "radiating_dof", "influenced_dof"), BOTH * TABLE.added_mass),
            "radiation_damping": (
                ("omega", "radiating_dof", "influenced_dof"),
                BOTH * TABLE.damping,
            ),
            "excitation_force": (
                ("complex", "omega", "wave_direction", "influenced_dof"),
                parts,
            ),
            "hydrostatic_stiffness": (("influenced_dof", "radiating_dof"), stiffness()),
            "rho": TABLE.density,
        },
        coords={
            "omega": TABLE.omega,
            "wave_direction": TABLE.heading,
            "radiating_dof": dofs,
            "influenced_dof": dofs,
            "complex": ["re", "im"],
        },
    )
    path = tmp_path / "results.nc"
    data.to_netcdf(path, engine="netcdf4")
    assert_same(read_results(path, WATER), drift=False)
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    with pytest.raises(HydroError) as error:
        read_results(path, WATER)
    assert str(path) in str(error.value)
