"""Trials of examples/validation: closed forms, symmetry, scaling, recorded runs of KVLCC2."""

import math
import os
from pathlib import Path

import numpy as np
import pytest

from examples.validation import trials
from examples.validation.trials import Track
from usv_gym import Vessel

SHARED = Path(os.environ.get("USV_TWIN_SHARED", Path(__file__).parents[4] / "shared"))
KVLCC2 = SHARED / "data" / "kvlcc2_simman2008"
DEGREE = math.pi / 180.0
BOAT = Vessel.load("usv75")
LENGTH, SPEED, RADIUS, APPROACH = 7.0, 1.5, 12.0, 4.0


def track_of(t: np.ndarray, x: np.ndarray, y: np.ndarray, psi: np.ndarray, helm: float) -> Track:
    """Return a track with the velocities of its slopes, and a helm that moves at the approach."""
    north, east = np.gradient(x, t), np.gradient(y, t)
    c, s = np.cos(psi), np.sin(psi)
    u, v, r = c * north + s * east, c * east - s * north, np.gradient(psi, t)
    return Track(t=t, x=x, y=y, psi=psi, u=u, v=v, r=r, delta=np.where(t > APPROACH, helm, 0.0))


def triangles(t: np.ndarray, switch: float, overshoot: float, rate: float) -> Track:
    """Return triangular headings, to starboard first."""
    top = switch + overshoot
    phase = np.maximum(t - APPROACH, 0.0) * rate / top
    psi = top * (np.abs((phase - 1.0) % 4.0 - 2.0) - 1.0)
    steps = SPEED * np.gradient(t)
    x, y = np.cumsum(steps * np.cos(psi)), np.cumsum(steps * np.sin(psi))
    return track_of(t, x, y, psi, switch)


@pytest.mark.parametrize("drift", [0.0, 0.2])
def test_turning_of_a_circle_has_closed_form_indices(drift: float) -> None:
    t = 0.02 * np.arange(4000)
    angle = np.maximum(t - APPROACH, 0.0) * SPEED / RADIUS
    x = np.where(t > APPROACH, RADIUS * np.sin(angle), SPEED * (t - APPROACH))
    psi = angle + np.where(t > APPROACH, drift, 0.0)
    track = track_of(t, x, RADIUS * (1.0 - np.cos(angle)), psi, 0.5)
    got, R = trials.turning_indices(track, LENGTH), RADIUS / LENGTH
    # the course lags the heading by the drift angle; a sample's way is 0.03 m of 12 m
    advance, transfer = R * math.cos(drift), R * (1.0 - math.sin(drift))
    diameter = R * (1.0 + math.cos(drift))
    assert got == pytest.approx((1, advance, transfer, diameter, 1 / R, R, drift, 1.0), abs=5e-3)
    other = trials.turning_indices(track.mirrored(), LENGTH)
    assert other.side == -1 and other[1:] == pytest.approx(got[1:], rel=1e-9)


def test_incomplete_manoeuvres_are_refused() -> None:
    small = triangles(0.05 * np.arange(2000), 6 * DEGREE, 2 * DEGREE, DEGREE)
    with pytest.raises(ValueError, match="never reached 10 degrees"):
        trials.zigzag_indices(small, 10 * DEGREE)
    with pytest.raises(ValueError, match="never reached 180 degrees"):
        trials.turning_indices(small, LENGTH)
    with pytest.raises(ValueError, match="not done"):
        trials.zigzag(BOAT, 99.0, 0.02, 20.4, dt=0.05)


def recorded(name: str) -> Track:
    path = KVLCC2 / f"{name}.csv.gz"
    if not path.exists():
        pytest.skip(f"{path} is missing (set USV_TWIN_SHARED); it must not be redistributed")
    log = np.genfromtxt(path, delimiter=",", names=True)
    columns = {"t": "t_s", "x": "x_m", "y": "y_m", "psi": "psi_rad", "u": "u_mps", "v": "v_mps"}
    columns |= {"r": "r_radps", "delta": "delta_rad"}
    return Track(**{ours: log[theirs] for ours, theirs in columns.items()})


def test_recorded_turn_has_published_indices() -> None:
    # MARIN, 35 degrees to port, with a pull-out; values published with the data
    track = recorded("marin_tc_35")
    got = trials.turning_indices(track, 7.0, origin=0.0, heading=0.0)
    assert got.side == -1
    # two decimals and another window of the steady turn: 0.02
    assert got.advance == pytest.approx(3.11, abs=0.02)
    assert got.transfer == pytest.approx(1.22, abs=0.02)
    assert got.tactical_diameter == pytest.approx(3.08, abs=0.02)
    assert got.rate == pytest.approx(0.83, abs=0.02)
    assert got.radius == pytest.approx(1.19, abs=0.02)
    assert got.speed_ratio == pytest.approx(0.361, abs=0.02)
    # published from the first motion of the rudder
    assert trials.turning_indices(track, 7.0, heading=0.0).advance == pytest.approx(3.00, abs=0.03)


@pytest.mark.parametrize(
    ("name", "side", "switch", "overshoots"),
    [
        ("marin_zz_10", -1, 10.0, (9.5, 15.0)),
        ("marin_zz_20", -1, 20.0, (15.1, 13.3)),
        ("hsva_z_10_10_s", 1, 10.0, (9.7, 20.5)),
        ("hsva_z_20_10_s", 1, 10.0, (11.7, 15.6)),
    ],
)
def test_recorded_zigzags_have_published_overshoots(
    name: str, side: int, switch: float, overshoots: tuple[float, float]
) -> None:
    got = trials.zigzag_indices(recorded(name), switch * DEGREE, origin=0.0, heading=0.0)
    assert got.side == side
    # one decimal: 0.05
    np.testing.assert_allclose(np.degrees(got.overshoots[:2]), overshoots, atol=0.06)
