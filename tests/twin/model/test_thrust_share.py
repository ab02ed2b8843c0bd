"""A thruster that gives less of its thrust, as other parameters of a sound boat."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twin.model.dynamics import model_of
from twin.model.structure import N_TERMS, accelerations, state_terms, thrust_terms
from twin.model.thrust_share import share_slopes
from twin.sim.bridge import particulars_of
from usv_gym.vessel.vessel import Vessel

BOATS = ("usv75", "otter", "wamv16")


def rates(structure, xi, motion, shafts, angle):
    terms, hull = np.zeros(N_TERMS), structure.terms.hull
    c, s = np.cos(angle), np.sin(angle)
    thrust_terms(*shafts, c, s, c, s, terms)
    state_terms(*motion, 1.0, 0.0, np.zeros(2), hull, terms)
    return np.array(accelerations(terms, structure.terms, xi, 0))


@pytest.fixture(scope="module", params=BOATS)
def boat(request):
    about = particulars_of(Vessel.load(request.param))
    structure = model_of(about, "mmg", biased=True, current=True)
    return about, structure, share_slopes(structure.terms)


@settings(max_examples=60)
@given(
    share=st.floats(0.0, 1.0),
    side=st.integers(0, 1),
    u=st.floats(0.3, 1.2),
    turn=st.floats(-0.3, 0.3),
    shaft=st.floats(0.4, 1.2),
    angle=st.floats(-0.35, 0.35),
)
def test_other_parameters_act_as_a_weak_thruster(boat, share, side, u, turn, shaft, angle):
    about, structure, slopes = boat
    motion = u * about.speed, 0.0, turn * about.speed / about.length
    n = shaft * about.speed
    shafts = [n, n]
    xi = structure.mean
    sound = rates(structure, xi, motion, shafts, angle)
    shafts[side] *= np.sqrt(share)
    weak = rates(structure, xi, motion, shafts, angle)
    other = xi + (share - 1.0) * slopes[side] @ xi
    shown = rates(structure, other, motion, [n, n], angle)
    # advance and rudders follow the share by its root: a part of the change is left
    size = np.array([1.0, 1.0, 1.0 / about.length]) * about.speed**2 / about.length
    assert np.all(np.abs(shown - weak) < 0.2 * np.abs(sound - weak) + 0.04 * size)


def test_sides_are_mirror_images(boat):
    _, structure, slopes = boat
    xi = structure.mean
    left, right = slopes[0] @ xi, slopes[1] @ xi
    for name, sign in (("X_nn", 1.0), ("X_dn", -1.0), ("N_dn", 1.0), ("N_mn", -1.0)):
        k = structure.parameters.index(name)
        assert left[k] == pytest.approx(sign * right[k], rel=0.02, abs=1e-9)


def test_what_has_nothing_to_do_with_thrust_stays(boat):
    _, structure, slopes = boat
    for name in ("X_u|u|", "Y_|u|v", "N_|u|r", "C_north", "E_east", "N_0", "Y_w"):
        k = structure.parameters.index(name)
        assert not slopes[:, k].any() and not slopes[:, :, k].any()
