"""A ship with a table moves in waves as linear theory says of the table."""

import dataclasses
import math

import numpy as np
import pytest

from examples.validation import rao
from tests.usv_gym.world.seas import realise
from usv_gym import SeaState, Vessel
from usv_gym.physics import waves
from usv_gym.world.realisation import load_rows

NAMES = ("usv75", "otter")
OMEGA = {"usv75": (1.2, 2.2, 3.2), "otter": (2.0, 3.5, 5.0)}


@pytest.fixture(scope="module", params=NAMES)
def boat(request):
    return Vessel.load(request.param)


def test_the_file_s_numbers_are_kept_aside(boat):
    plain = boat.without_table()
    assert boat.stated == plain.values
    for key in ("m_z", "J_yy", "zeta_pitch", "GM_T"):
        assert boat.values[key] != plain.values[key]
    assert boat.values["mass"] == plain.values["mass"]
    again = boat.with_table(boat.hydro)
    assert again.values == boat.values


def test_a_varied_boat_takes_the_table_by_its_size(boat):
    other = boat.varied(np.random.default_rng(3), 0.15)
    ratio = other.values["length_waterline"] / boat.values["length_waterline"]
    assert ratio != 1.0
    omega = OMEGA[boat.name][0] / math.sqrt(ratio)
    got, known = (
        float(rao.respond(one, at, math.pi).heave)
        for one, at in ((other, omega), (boat, OMEGA[boat.name][0]))
    )
    assert got == pytest.approx(known, rel=0.2)


def test_loads_between_headings_are_interpolated_closely(boat):
    sea = realise(SeaState(hs=0.3, wind=3.0, components=20), 0, boat)
    loads = load_rows(boat, sea.waves)
    by = 0.37 * 2.0 * math.pi / waves.LOAD_HEADINGS
    turned = sea.waves.copy()
    north, east = sea.waves[waves.K_NORTH], sea.waves[waves.K_EAST]
    turned[waves.K_NORTH] = north * math.cos(by) + east * math.sin(by)
    turned[waves.K_EAST] = east * math.cos(by) - north * math.sin(by)
    factors = waves.factor_workspace(sea.waves.shape[1])
    exact = factors.copy()
    waves.wave_factors(by, sea.waves, loads, boat.packed.copy(), 6, factors)
    waves.wave_factors(0.0, turned, load_rows(boat, turned), boat.packed.copy(), 6, exact)
    # waves as long as half the boat and longer; steps of 15 degrees are coarse for shorter ones
    k = np.hypot(north, east)
    long = np.flatnonzero(k * boat.values["length_waterline"] < 4.0 * math.pi)
    assert len(long) >= 8
    for mode in range(6):
        both = [mode, mode + waves.SINE_LOADS]
        error, size = (factors - exact)[both][:, long], exact[both][:, long]
        assert np.linalg.norm(error) < 0.02 * np.linalg.norm(size)


def test_a_table_that_ends_too_early_is_refused():
    boat = Vessel.load("usv75")
    table = boat.hydro
    few = slice(0, 6)
    short = dataclasses.replace(
        table,
        omega=table.omega[few],
        added_mass=table.added_mass[few],
        damping=table.damping[few],
        excitation=table.excitation[few],
        drift=table.drift[few],
    )
    with pytest.raises(ValueError, match=r"natural frequency of .* wider range"):
        boat.with_table(short)
