"""The shipped tables are what the script of examples/hydrodynamics makes."""

import runpy
from pathlib import Path

import numpy as np
import pytest

from usv_gym import Vessel

SCRIPT = Path(__file__).resolve().parents[3] / "examples/hydrodynamics/make_table.py"


@pytest.mark.slow
@pytest.mark.parametrize("name", ["usv75", "telemetron", "otter", "wamv16"])
def test_shipped_tables_are_what_the_script_makes(name):
    pytest.importorskip("capytaine")
    vessel = Vessel.load(name)
    again = runpy.run_path(str(SCRIPT))["make_table"](vessel)
    for key in ("added_mass", "damping", "excitation", "drift"):
        wanted = getattr(vessel.hydro, key)
        size = np.abs(wanted).max(axis=(0, 1), keepdims=True)
        assert np.all(np.abs(getattr(again, key) - wanted) <= 2e-3 * size), key
    np.testing.assert_allclose(again.hydrostatics, vessel.hydro.hydrostatics, rtol=1e-6, atol=1e-3)
