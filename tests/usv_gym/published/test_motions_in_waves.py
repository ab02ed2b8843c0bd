"""Motions in waves beside a boundary-element code and Jensen's closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import spherical_jn

from examples.validation import rao
from tests.usv_gym.published.in_waves import check_drift, check_motions, check_natural_modes, decay
from usv_gym import Vessel
from usv_gym.physics import GRAVITY
from usv_gym.physics import frames as fr

BOAT = Vessel.load("usv75")


@pytest.mark.parametrize("name", ["usv75", "telemetron", "otter", "wamv16"])
def test_boats_at_rest_move_as_capytaine_says(name: str) -> None:
    """Tables of capytaine 3.0.0, which slow tests compute again."""
    boat = Vessel.load(name)
    assert boat.hydro is not None
    check_motions(boat, boat.hydro)
    check_natural_modes(boat, boat.hydro)
    check_drift(boat, boat.hydro)


@pytest.mark.parametrize(
    ("place", "key"), [(fr.Z, "zeta_heave"), (fr.THETA, "zeta_pitch"), (fr.PHI, "zeta_roll")]
)
def test_free_decays_have_the_damping_of_the_table(place: int, key: str) -> None:
    # roll and pitch couple with sway, which changes their damping
    assert decay(BOAT, place)[1] == pytest.approx(BOAT.values[key], rel=0.1)


def jensen(omega: np.ndarray, heading: float, speed: float) -> tuple[np.ndarray, np.ndarray]:
    """Return heave (m/m) and pitch (rad/m) of a box-shaped ship as large as the 7.5 m boat.

    ``heading`` of the waves less that of the boat, rad; pi: head sea. Froude numbers below .4.
    Source: Jensen, Mansour and Olsen 2004; the pressure falls with exp(-k T) on every heading.
    """
    length, beam, draft, block = 6.336, 2.714, 0.526, 0.3689
    k, B, T = omega**2 / GRAVITY, beam * block, draft
    a = 1.0 - omega * speed / GRAVITY * math.cos(heading)
    half = 0.5 * np.abs(k * math.cos(heading)) * length
    A = 2.0 * np.sin(0.5 * k * B * a**2) * np.exp(-k * T * a**2)
    f = np.sqrt((1.0 - k * T) ** 2 + (A**2 / (k * B * a**3)) ** 2)
    load = np.exp(-k * T) * f
    eta = 1.0 / np.hypot(1.0 - 2.0 * k * T * a**2, A**2 / (k * B * a**2))
    heave = eta * load * np.abs(np.sinc(half / math.pi))
    pitch = eta * load * (6.0 / length) * np.abs(spherical_jn(1, half))
    return heave, pitch


@pytest.mark.parametrize(
    ("omega", "speed", "heave", "pitch"),
    [
        (1.0, 0.0, 0.9868, 0.1013),
        (1.777, 0.0, 0.8686, 0.3011),
        (1.777, 5.58, 1.2713, 0.4407),
        (2.5, 0.0, 0.5152, 0.4759),
        (2.5, 5.58, 0.0725, 0.0669),
    ],
)
def test_jensens_closed_forms_in_head_sea(
    omega: float, speed: float, heave: float, pitch: float
) -> None:
    """A separate computation with g = 9.81 m/s2: the same wave and Froude number here."""
    scale = math.sqrt(GRAVITY / 9.81)
    found = jensen(np.array(omega * scale), math.pi, speed * scale)
    np.testing.assert_allclose(found, (heave, pitch), rtol=1e-3)


@pytest.mark.parametrize(
    ("degrees", "motions"),
    [
        (180.0, ("heave", "pitch")),
        (135.0, ("heave", "pitch")),
        (90.0, ("heave",)),
        (0.0, ("heave", "pitch")),
    ],
)
def test_amplitudes_under_way_have_the_shape_of_jensens(
    degrees: float, motions: tuple[str, ...]
) -> None:
    """At a Froude number of .7, beyond the theory: so the shape only, by its correlation."""
    speed, heading = 5.58, math.radians(degrees)
    omega = np.concatenate([[0.25, 0.4, 0.6], np.arange(0.8, 3.55, 0.1), np.arange(3.6, 4.1, 0.2)])
    ours = rao.responses(BOAT, omega, heading, speed=speed)
    theirs = dict(zip(("heave", "pitch"), jensen(omega, heading, speed), strict=True))
    for motion in motions:
        got = getattr(ours, motion)
        known = np.isfinite(got)
        assert np.corrcoef(got[known], theirs[motion][known])[0, 1] > 0.8, motion
