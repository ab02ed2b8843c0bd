"""Hydrodynamic tables: files, scale, and what is refused."""

import dataclasses
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.io import netcdf_file

from usv_gym import Vessel
from usv_gym.hydro.netcdf import read_table, write_table
from usv_gym.hydro.table import HydroError, between

TABLE = Vessel.load("usv75").hydro


def test_a_file_keeps_a_table(tmp_path):
    for table in (TABLE, dataclasses.replace(TABLE, drift=None, hydrostatics=None)):
        write_table(tmp_path / "table.nc", table)
        assert read_table(tmp_path / "table.nc") == table


@given(ratio=st.floats(0.1, 20.0))
def test_scale_goes_there_and_back(ratio):
    again = TABLE.scaled(ratio).scaled(1.0 / ratio)
    for name in ("omega", "added_mass", "damping", "excitation", "drift"):
        wanted = getattr(TABLE, name)
        np.testing.assert_allclose(getattr(again, name), wanted, atol=1e-9 * np.abs(wanted).max())
    np.testing.assert_allclose(again.hydrostatics, TABLE.hydrostatics, rtol=1e-9)


def test_a_table_is_physical():
    # radiation takes energy from every motion, and added mass matrices are symmetric
    for matrix in TABLE.damping:
        assert np.linalg.eigvalsh(matrix)[0] > -1e-3 * np.abs(matrix).max()
    np.testing.assert_allclose(TABLE.added_mass, np.swapaxes(TABLE.added_mass, 1, 2), rtol=1e-6)
    # a long wave lifts with rho g A_wp, and pushes the water that the hull displaces aside
    lift = abs(TABLE.excitation[0, :, 2])
    wanted = TABLE.density * 9.80665 * TABLE.hydrostatics[0]
    np.testing.assert_allclose(lift, wanted, rtol=0.05)
    # Haskind: waves that a heave sends out and waves that heave it are one, energy by energy
    k = TABLE.omega**2 / 9.80665
    around = np.abs(TABLE.around(TABLE.excitation)[:, :, 2]) ** 2
    energy = TABLE.omega * k / (2.0 * TABLE.density * 9.80665**2) * around.mean(axis=1)
    np.testing.assert_allclose(energy[4:16], TABLE.damping[4:16, 2, 2], rtol=0.03)


def test_between_is_exact_for_cubics():
    points = np.array([0.1, 0.5, 0.6, 1.3, 2.0, 2.2])
    x = np.linspace(0.1, 2.2, 31)

    def cubic(s):
        return np.stack([1.0 - s + 2.0 * s**2 - 0.3 * s**3, s], axis=-1)

    np.testing.assert_allclose(between(x, points, cubic(points)), cubic(x), atol=1e-12)
    held = between(np.array([0.0, 9.0]), points, cubic(points))
    np.testing.assert_allclose(held, cubic(points[[0, -1]]), atol=1e-12)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"omega": TABLE.omega[::-1]}, "rise"),
        ({"heading": TABLE.heading**2}, "180 degrees"),
        ({"added_mass": TABLE.added_mass[1:]}, "shape"),
        ({"excitation": TABLE.excitation * np.nan}, "finite"),
        ({"damping": -abs(TABLE.damping)}, "sign"),
        ({"length": 0.0}, "above 0"),
    ],
)
def test_a_table_that_cannot_be_is_refused(change, text):
    with pytest.raises(HydroError, match=text):
        dataclasses.replace(TABLE, **change)


def test_a_file_that_is_missing_or_another_kind_is_named(tmp_path):
    (tmp_path / "bad.nc").write_bytes(b"\x89HDF\r\n\x1a\n")
    with pytest.raises(HydroError, match=r"bad\.nc: is"):
        read_table(tmp_path / "bad.nc")
    with pytest.raises(HydroError, match="cannot be read"):
        read_table(tmp_path / "none.nc")


def test_variables_that_share_their_bytes_take_no_more_memory(tmp_path):
    path, size = tmp_path / "shared.nc", 8 * 1000
    with netcdf_file(path, "w") as file:
        file.createDimension("n", 1000)
        for k in range(100):
            file.createVariable(f"v{k}", "d", ("n",))[:] = 0.0
    content = path.read_bytes()
    begin = len(content) - 100 * size
    for k in range(100):
        content = content.replace(struct.pack(">i", begin + k * size), struct.pack(">i", begin))
    path.write_bytes(content[: begin + size])
    with pytest.raises(HydroError, match="overlap"):
        read_table(path)


def test_a_vessel_of_another_water_is_refused():
    boat = Vessel.load("usv75")
    mercury = dataclasses.replace(TABLE, density=13_600.0)
    with pytest.raises(ValueError, match="13600 kg/m3"):
        boat.with_table(mercury)
