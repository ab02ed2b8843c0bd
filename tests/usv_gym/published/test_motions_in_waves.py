"""Motions in waves beside a boundary-element code and Jensen's closed forms."""

import math

import numpy as np
import pytest
from scipy.special import spherical_jn

from examples.validation import rao
from tests.usv_gym.world.seas import realise
from usv_gym import SeaState, Vessel
from usv_gym.hydro.motions import natural_frequencies, response
from usv_gym.hydro.table import HydroTable, between
from usv_gym.physics import GRAVITY, ship, spectra
from usv_gym.physics import frames as fr
from usv_gym.physics.waves import drift_at

MODE = {"heave": 2, "roll": 3, "pitch": 4}
"""Place of each motion among the six of a table."""

MOTIONS_AT = {90: ("heave", "roll"), 135: ("heave", "roll", "pitch"), 180: ("heave", "pitch")}
"""Motions that a boat alike on both sides has, by heading (degrees; 180: head sea)."""

HEIGHTS_M = (0.3, 0.88)
"""Significant heights of sea states 2 and 3."""


def column(table: HydroTable, degrees: int) -> int:
    return round(degrees / 180 * (len(table.heading) - 1))


def check_motions(boat: Vessel, table: HydroTable) -> None:
    """Assert amplitudes within 10 % in regular waves, and rms within 5 % in irregular seas.

    Waves of 15 to .8 lengths. The boat in time has constant added mass and damping; what they lack
    is part of its loads.
    """
    scale = math.sqrt(GRAVITY / boat.values["length_waterline"])
    regular, irregular = np.linspace(0.64, 2.8, 10) * scale, np.geomspace(0.9, 9.0, 48)
    theory = response(table, boat.with_table(table).values)
    for degrees, motions in MOTIONS_AT.items():
        of_table = theory[:, column(table, degrees)]
        for omega in (regular, irregular):
            ours = rao.responses(boat, omega, math.radians(degrees))
            theirs = np.abs(between(omega, table.omega, of_table))
            for motion in motions:
                got, want = getattr(ours, motion), theirs[:, MODE[motion]]
                where = f"{boat.name}, {motion}, {degrees} degrees"
                if omega is regular:
                    np.testing.assert_allclose(got, want, rtol=0.1, err_msg=where)
                    continue
                for hs in HEIGHTS_M:
                    density = spectra.pm_spectrum(omega, hs)
                    variances = [np.trapezoid(a**2 * density, omega) for a in (got, want)]
                    np.testing.assert_allclose(
                        *np.sqrt(variances), rtol=0.05, err_msg=f"{where}, {hs} m"
                    )


def check_drift(boat: Vessel, table: HydroTable) -> None:
    """Assert the mean drift of simulated seas within 10 % of an integral over the spectrum."""
    omega = np.linspace(table.omega[0], table.omega[-1], 2000)
    for hs in HEIGHTS_M:
        sea = realise(SeaState(hs=hs, wave_to=0.0), 0, boat)
        drawn = np.asarray(sea.weather["drift_table"])
        density = 2.0 * spectra.pm_spectrum(omega, hs)
        for degrees in MOTIONS_AT:
            of_table = between(omega, table.omega, table.drift[:, column(table, degrees)])
            # waves that go north, on a boat turned to port
            found = drift_at(-math.radians(degrees), drawn)
            for place in (0, 1):
                if (place, degrees) not in ((0, 90), (1, 180)):
                    wanted = np.trapezoid(density * of_table[:, place], omega)
                    np.testing.assert_allclose(found[place], wanted, rtol=0.1)


def check_natural_modes(boat: Vessel, table: HydroTable) -> None:
    """Assert natural periods within 10 %, and added masses there within 2 %."""
    v, at = boat.values, natural_frequencies(table, boat.values)
    for motion, place in (("heave", fr.Z), ("roll", fr.PHI), ("pitch", fr.THETA)):
        # in a free decay heave and pitch couple
        period, _ = decay(boat, place)
        np.testing.assert_allclose(period, 2.0 * math.pi / getattr(at, motion), rtol=0.1)
    heave, pitch = table.at(at.heave)[0][0], table.at(at.pitch)[0][0]
    np.testing.assert_allclose(v["m_z"], heave[2, 2], rtol=0.02)
    about = pitch[4, 4] + 2.0 * v["x_F"] * pitch[2, 4] + v["x_F"] ** 2 * pitch[2, 2]
    np.testing.assert_allclose(v["J_yy"], about, rtol=0.02)


def decay(boat: Vessel, place: int) -> tuple[float, float]:
    """Return natural period (s) and damping ratio of a free decay of one column of the state."""
    dt, steps = 0.01, 1200
    states = np.zeros((steps + 1, fr.STATE_SIZE))
    states[0, place] = 0.02
    work = np.zeros((ship.WORK_ROWS, fr.STATE_SIZE))
    ship.sail(states, np.zeros((steps, 4)), ship.Ship(boat.packed, 6), ship.calm_sea(), dt, work)
    motion = states[:, place]
    peak = int(np.flatnonzero((motion[1:-1] > motion[:-2]) & (motion[1:-1] >= motion[2:]))[0]) + 1
    decrement = math.log(motion[0] / motion[peak])
    zeta = decrement / math.hypot(2.0 * math.pi, decrement)
    return dt * peak * math.sqrt(1.0 - zeta**2), zeta


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
