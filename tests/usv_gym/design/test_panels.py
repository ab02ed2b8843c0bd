"""Tables that capytaine makes of our meshes."""

import numpy as np
import pytest

from usv_gym import Vessel
from usv_gym.design import panels
from usv_gym.hydro.table import HydroError


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


def test_without_capytaine_the_remedy_is_named(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "capytaine", None)
    with pytest.raises(HydroError, match=r"pip install 'usv-twin\[hydro\]'"):
        panels.make_table(Vessel.load("usv75"))
