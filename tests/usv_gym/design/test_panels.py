"""Tables that capytaine makes of our meshes."""

import math

import numpy as np
import pytest

from tests.usv_gym.published.in_waves import check_drift, check_motions, check_natural_modes
from usv_gym import Vessel
from usv_gym.design import panels
from usv_gym.hydro.motions import response, ship_matrices
from usv_gym.hydro.table import HydroError
from usv_gym.physics import GRAVITY
from usv_gym.vessel.geometry import hull_of


@pytest.mark.slow
@pytest.mark.parametrize("name", ["usv75", "telemetron", "otter", "wamv16"])
def test_stored_tables_are_what_the_function_makes(name):
    pytest.importorskip("capytaine")
    vessel, done = Vessel.load(name), []
    stored, again = vessel.hydro, panels.make_table(vessel, done.append)
    assert done == list(range(1, len(stored.omega) + 1))
    for key in ("added_mass", "damping", "excitation", "drift"):
        wanted = getattr(stored, key)
        size = np.abs(wanted).max(axis=(0, 1), keepdims=True)
        assert np.all(np.abs(getattr(again, key) - wanted) <= 2e-3 * size), key
    check_motions(vessel, again)
    check_natural_modes(vessel, again)
    check_drift(vessel, again)


@pytest.mark.slow
def test_motions_and_drift_are_those_of_capytaine_itself():
    cpt = pytest.importorskip("capytaine")
    xr = pytest.importorskip("xarray")
    from capytaine.io.xarray import kochin_data_array
    from capytaine.post_pro import rao
    from capytaine.post_pro.mean_drift_force import far_field_mean_drift_force

    vessel, headings = Vessel.load("usv75"), (0.5 * math.pi, math.pi)
    table, ship = vessel.hydro, ship_matrices(vessel.values)
    some, places = [8, 12, 14, 16, 18, 22], [6, 12]
    omega, names = table.omega[some], list(panels._DOFS)
    body = panels._Panels.of(vessel, hull_of(vessel)).body(cpt, "usv75", vessel.values["A_wp"])
    water = {"rho": table.density, "g": GRAVITY, "body": body}
    problems = []
    for w in omega:
        problems += [cpt.RadiationProblem(omega=w, radiating_dof=dof, **water) for dof in names]
        problems += [cpt.DiffractionProblem(omega=w, wave_direction=to, **water) for to in headings]
    solver = cpt.BEMSolver()
    results = [solver.solve(one, keep_details=True, _check_wavelength=False) for one in problems]
    data = cpt.assemble_dataset(results, hydrostatics=False)
    turn = panels._TURN[:, None] * panels._TURN
    axes = {"influenced_dof": names, "radiating_dof": names}
    for name, matrix in (("inertia_matrix", ship.body), ("hydrostatic_stiffness", ship.stiffness)):
        data[name] = xr.DataArray(turn * matrix, coords=axes, dims=list(axes))
    viscous = xr.DataArray(turn * ship.viscous, coords=axes, dims=list(axes))
    theirs = [
        rao(data, wave_direction=to, dissipation=viscous).sel(radiating_dof=names).values
        for to in headings
    ]
    theirs = np.reshape(theirs, (2, len(omega), 6)).swapaxes(0, 1)
    ours = (panels._TURN * response(table, vessel.values))[np.ix_(some, places)]
    for motion, heading in ((2, 0), (3, 0), (0, 1), (2, 1), (4, 1)):
        got, wanted = theirs[:, heading, motion], ours[:, heading, motion]
        # in theirs, surge by pitch and pitch by surge are not quite one
        assert np.abs(got - wanted).max() < 0.04 * np.abs(wanted).max(), (motion, heading)

    angles = np.linspace(-0.5, 2.0 * math.pi + 0.5, 240)
    waves = kochin_data_array(results, angles).squeeze(drop=True)
    waves = waves.assign_coords(radiating_dof=[str(dof) for dof in waves["radiating_dof"].values])
    for name in ("wavenumber", "water_depth", "rho", "g"):
        waves[name] = data[name]
    coords = {"omega": omega, "wave_direction": list(headings), "radiating_dof": names}
    drift = far_field_mean_drift_force(xr.DataArray(ours, coords=coords, dims=list(coords)), waves)
    for name, place, heading in (("sway", 1, 0), ("surge", 0, 1)):
        at = {"wave_direction_k": heading, "wave_direction_l": heading}
        got = np.real(drift[f"drift_force_{name}"].isel(at).values)
        wanted = table.drift[some, places[heading], place]
        # theirs takes what the wave loses from its wake, ours from the energy sent out
        np.testing.assert_allclose(got, wanted, atol=0.1 * np.abs(wanted).max())


def test_without_capytaine_the_remedy_is_named(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "capytaine", None)
    with pytest.raises(HydroError, match=r"pip install 'usv-twin\[hydro\]'"):
        panels.make_table(Vessel.load("usv75"))
