"""The ship: symmetries, limits, order of the integrator."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq

from tests.usv_gym.world.seas import realise
from usv_gym import SeaState, Vessel, vessel_names
from usv_gym.physics import GRAVITY, hull, propulsion, ship, waves
from usv_gym.physics import frames as fr
from usv_gym.physics import parameters as par
from usv_gym.physics import weather as wx
from usv_gym.world.realisation import Sea

KNOT = 1852.0 / 3600.0
BOAT = Vessel.load("usv75")
P = BOAT.packed.copy()
CALM = Sea(waves=np.zeros((waves.WAVE_ROWS, 0)), gusts=np.zeros((3, 0)), weather=wx.constant())
MOTION = [fr.X, fr.Y, fr.PSI, fr.U, fr.V, fr.R]
BODY = [fr.U, fr.V, fr.R]

angles = st.floats(-math.pi, math.pi)


def start(
    u: float, v: float = 0.0, r: float = 0.0, n: float = 0.0, delta: float = 0.0, psi: float = 0.0
) -> np.ndarray:
    state = np.zeros(fr.STATE_SIZE)
    state[[fr.PSI, fr.U, fr.V, fr.R]] = psi, u, v, r
    state[fr.N_LEFT :] = n, n, delta, delta
    return state


def derivative(
    state: np.ndarray,
    cmd: np.ndarray | None = None,
    sea: Sea = CALM,
    p: np.ndarray = P,
    dof: int = 3,
) -> np.ndarray:
    out = np.zeros(fr.STATE_SIZE)
    around = sea.arrays()
    waves.wave_factors(state[fr.PSI], sea.waves, around.loads, p, dof, around.factors)
    air = wx.air_velocity(0.0, sea.gusts, sea.weather)
    gain = wx.wave_gain(0.0, sea.weather)
    cmd = state[fr.N_LEFT :].copy() if cmd is None else cmd
    ship.derivative(state, cmd, ship.Ship(p, dof), around, ship.Air(*air, gain), 0.0, out)
    return out


def sail(
    state: np.ndarray,
    cmd: np.ndarray,
    seconds: float,
    sea: Sea = CALM,
    dt: float = 0.05,
    dof: int = 3,
    p: np.ndarray = P,
) -> np.ndarray:
    """Return the states of a run, the first included."""
    steps = round(seconds / dt)
    states = np.empty((steps + 1, fr.STATE_SIZE))
    states[0] = state
    work = np.zeros((ship.WORK_ROWS, fr.STATE_SIZE))
    cmds = np.tile(cmd, (steps, 1))
    ship.sail(states, cmds, ship.Ship(p, dof), sea.arrays(), dt, work)
    return states


def shaft_for(knots: float) -> float:
    return float(brentq(lambda n: BOAT.straight_speed(n) - knots * KNOT, 1.0, 60.0))


def helm(n: float, delta_deg: float) -> np.ndarray:
    return np.array([n, n, math.radians(delta_deg), math.radians(delta_deg)])


def a_sea(seed: int, boat: Vessel = BOAT, **kwargs: float) -> Sea:
    state = SeaState(**{"hs": 0.5, "wind": 4.5, "components": 20, **kwargs})  # type: ignore[arg-type]
    return realise(state, seed, boat)


# ------------------------------------------------- symmetries


def mirrored(state: np.ndarray) -> np.ndarray:
    """Return states with port and starboard exchanged."""
    out = state.copy()
    out[..., [fr.Y, fr.PHI, fr.PSI, fr.V, fr.P, fr.R]] *= -1.0
    out[..., [fr.N_LEFT, fr.N_RIGHT]] = state[..., [fr.N_RIGHT, fr.N_LEFT]]
    out[..., [fr.DELTA_LEFT, fr.DELTA_RIGHT]] = -state[..., [fr.DELTA_RIGHT, fr.DELTA_LEFT]]
    return out


def mirrored_sea(sea: Sea) -> Sea:
    rows, weather = sea.waves.copy(), sea.weather.copy()
    rows[waves.K_EAST] *= -1.0
    weather["wind_from"] *= -1.0
    weather["current_east"] = -weather["current_east"]
    weather["drift_sums"][1::2] *= -1.0  # sums over the sine of the direction
    weather["drift_table"] = np.roll(weather["drift_table"][::-1], 1, axis=0) * [1.0, -1.0, -1.0]
    return dataclasses.replace(sea, waves=rows, weather=weather)


def turned_sea(sea: Sea, by: float) -> Sea:
    rows, weather = sea.waves.copy(), sea.weather.copy()
    rows[waves.K_NORTH], rows[waves.K_EAST] = turn(rows[waves.K_NORTH], rows[waves.K_EAST], by)
    weather["wind_from"][0] += by
    current = turn(weather["current_north"], weather["current_east"], by)
    weather["current_north"], weather["current_east"] = current
    for pair in weather["drift_sums"].reshape(3, 2):
        pair[:] = turn(pair[0], pair[1], by)
    steps = round(by / math.tau * waves.LOAD_HEADINGS)
    weather["drift_table"] = np.roll(weather["drift_table"], steps, axis=0)
    return dataclasses.replace(sea, waves=rows, weather=weather)


def turn(north: np.ndarray, east: np.ndarray, by: float) -> tuple[np.ndarray, np.ndarray]:
    c, s = math.cos(by), math.sin(by)
    return c * north - s * east, s * north + c * east


runs = {
    "u": st.floats(2.0, 18.0),
    "v": st.floats(-1.5, 1.5),
    "r": st.floats(-0.4, 0.4),
    "n_left": st.floats(-5.0, 40.0),
    "n_right": st.floats(-5.0, 40.0),
    "delta_left": st.floats(-0.5, 0.5),
    "delta_right": st.floats(-0.5, 0.5),
    "wave_to": angles,
    "current_to": angles,
    "seed": st.integers(0, 2**32 - 1),
}
freedom = st.sampled_from([3, 6])
tilts = st.tuples(
    st.floats(-0.5, 0.5),  # z, m
    st.floats(-0.6, 0.6),  # phi
    st.floats(-0.3, 0.3),  # theta
    st.floats(-0.5, 0.5),  # w, m/s
    st.floats(-0.5, 0.5),  # p
    st.floats(-0.3, 0.3),  # q
)
HELD = [fr.Z, fr.PHI, fr.THETA, fr.W, fr.P, fr.Q]


def tilted(state: np.ndarray, tilt: tuple[float, ...], dof: int) -> np.ndarray:
    if dof == 6:
        state[HELD] = tilt
    return state


def a_run(
    u: float, v: float, r: float, wave_to: float, current_to: float, seed: int, **cmd: float
) -> tuple[np.ndarray, np.ndarray, Sea]:
    sea = a_sea(seed, wave_to=wave_to, wind_from=1.3, current=0.6, current_to=current_to)
    return start(u, v, r, n=20.0), np.array(list(cmd.values())), sea


@given(dof=freedom, tilt=tilts, **runs)
@settings(max_examples=40, deadline=None)
def test_port_mirrors_starboard(dof: int, tilt: tuple[float, ...], **kwargs: float) -> None:
    state, cmd, sea = a_run(**kwargs)  # type: ignore[arg-type]
    tilted(state, tilt, dof)
    one = sail(state, cmd, 8.0, sea, dof=dof)
    other_cmd = np.array([cmd[1], cmd[0], -cmd[3], -cmd[2]])
    other = sail(mirrored(state), other_cmd, 8.0, mirrored_sea(sea), dof=dof)
    # left and right are added in the other order: rounding, grown over 160 steps
    np.testing.assert_allclose(mirrored(other), one, rtol=1e-9, atol=1e-9)


@given(steps=st.integers(0, waves.LOAD_HEADINGS), dof=freedom, tilt=tilts, **runs)
@settings(max_examples=40, deadline=None)
def test_north_is_not_special(
    steps: int, dof: int, tilt: tuple[float, ...], **kwargs: float
) -> None:
    """Heading, wind, waves and current turned together turn the track, and nothing else.

    By steps of the table's headings; it is interpolated between them.
    """
    by = 2.0 * math.pi * steps / waves.LOAD_HEADINGS
    state, cmd, sea = a_run(**kwargs)  # type: ignore[arg-type]
    tilted(state, tilt, dof)
    one = sail(state, cmd, 8.0, sea, dof=dof)
    turned = state.copy()
    turned[fr.PSI] += by
    other = sail(turned, cmd, 8.0, turned_sea(sea, by), dof=dof)
    expected = one.copy()
    expected[:, fr.X], expected[:, fr.Y] = turn(one[:, fr.X], one[:, fr.Y], by)
    expected[:, fr.PSI] += by
    # rounding of the turned directions, grown over 160 steps
    np.testing.assert_allclose(other, expected, rtol=1e-8, atol=1e-8)


@given(
    dof=freedom,
    speed=st.floats(0.1, 3.0),
    to=angles,
    v=st.floats(-1, 1),
    delta=st.floats(-0.5, 0.5),
)
@settings(max_examples=20, deadline=None)
def test_a_uniform_current_only_shifts_the_track(
    dof: int, speed: float, to: float, v: float, delta: float
) -> None:
    state, cmd, dt = start(8.0, v=v, n=25.0), np.array([25.0, 25.0, delta, delta]), 0.0125
    north, east = speed * math.cos(to), speed * math.sin(to)
    weather = wx.constant(north=north, east=east)
    adrift = state.copy()
    adrift[fr.U] += north  # heading north
    adrift[fr.V] += east
    still = sail(state, cmd, 10.0, dt=dt, dof=dof)
    moving = sail(adrift, cmd, 10.0, dataclasses.replace(CALM, weather=weather), dt=dt, dof=dof)
    t = dt * np.arange(len(still))
    # the turning current is integrated, not exact: the integrator's dt^4 is 2.4e-8
    np.testing.assert_allclose(moving[:, fr.X] - north * t, still[:, fr.X], atol=1e-5)
    np.testing.assert_allclose(moving[:, fr.Y] - east * t, still[:, fr.Y], atol=1e-5)
    np.testing.assert_allclose(moving[:, fr.PSI], still[:, fr.PSI], atol=1e-5)


# ------------------------------------------------- loads that must vanish, energy


def energy(states: np.ndarray, v: dict[str, float]) -> np.ndarray:
    """Return kinetic and hydrostatic energy, J, for rows of states (n, 16)."""
    u, sway, w, p, q, r = states[:, fr.U : fr.R + 1].T
    m, x_G, z_G, z_H = v["mass"], v["x_G"], v["draft"] - v["KG"], v["z_H"]
    moving = m * ((u + z_G * q) ** 2 + (sway - z_G * p + x_G * r) ** 2 + (w - x_G * q) ** 2)
    moving += v["m_x"] * (u + z_H * q) ** 2 + v["m_y"] * (sway - z_H * p) ** 2
    moving += v["m_z"] * (w - v["x_F"] * q) ** 2
    moving += (v["I_xx"] + v["J_xx"]) * p**2 + (v["I_yy"] + v["J_yy"]) * q**2
    moving += (v["I_zz"] + v["J_zz"]) * r**2
    k_x = -np.sin(states[:, fr.THETA])
    k_y = np.cos(states[:, fr.THETA]) * np.sin(states[:, fr.PHI])
    sinkage = states[:, fr.Z] + v["x_F"] * k_x
    stored = v["water_density"] * GRAVITY * v["A_wp"] * sinkage**2
    stored += m * GRAVITY * (v["GM_T"] * k_y**2 + v["GM_L"] * k_x**2)
    return 0.5 * (moving + stored)


@pytest.mark.parametrize("dof", [3, 6])
def test_a_boat_at_rest_in_calm_water_stays(dof: int) -> None:
    track = sail(start(0.0, psi=0.7), np.zeros(4), 30.0, dof=dof)
    np.testing.assert_array_equal(track, np.tile(track[0], (len(track), 1)))


@pytest.mark.parametrize("name", vessel_names())
@given(u=st.floats(-20, 20), v=st.floats(-5, 5), r=st.floats(-1.2, 1.2), dof=freedom, tilt=tilts)
@settings(max_examples=25, deadline=None)
def test_without_thrust_the_energy_only_falls(
    name: str, u: float, v: float, r: float, dof: int, tilt: tuple[float, ...]
) -> None:
    boat = Vessel.load(name)
    # Froude: the same for a ship of any length; steps short for the quick motions of a small one
    scale = math.sqrt(boat.values["length_waterline"] / BOAT.values["length_waterline"])
    state = tilted(start(u * scale, v * scale, r / scale), tilt, dof)
    state[fr.Z] *= scale**2
    state[fr.W] *= scale
    state[[fr.P, fr.Q]] /= scale
    dt, p = 0.025 * scale, boat.packed.copy()
    course = energy(sail(state, np.zeros(4), 10.0 * scale, dt=dt, dof=dof, p=p), boat.values)
    # rounding of energies; with heave and roll of 2 s the integrator's own error is
    # (0.025 * 3.1)^6 / 144 a step, 1e-9, and more for stiffer boats
    assert np.all(np.diff(course) <= (1e-9 if dof == 3 else 1e-6) * course[0])
    assert course[-1] < course[0] or course[0] < 1e-9


def test_energy_is_kept_without_damping() -> None:
    """Weight, buoyancy and rigid body alone turn one form of energy into the other."""
    p = P.copy()
    names = par.SCALARS
    no_hull_forces = names[names.index("R_0") : names.index("kind")]
    no_damping = "zeta_heave", "zeta_roll", "zeta_pitch", "m_x", "m_y"
    for name in (*no_damping, *no_hull_forces, "resistance_speed", "resistance_force"):
        p[name] = 0.0
    for name in ("A_R", "k_1", "k_2", "z_H"):
        p[name] = 0.0
    state = tilted(start(3.0, 0.5, 0.3), (0.3, 0.5, 0.2, 0.2, -0.4, 0.3), 6)
    cmd = np.zeros(4)
    track = sail(state, cmd, 5.0, dt=0.005, dof=6, p=p)
    course = energy(track, {**BOAT.values, "m_x": 0.0, "m_y": 0.0, "z_H": 0.0})
    # RK4 at 200 Hz: (0.005 * 3.1)^4 relative
    np.testing.assert_allclose(course, course[0], rtol=1e-7)


# ------------------------------------------------- heave, roll, pitch


@given(u=st.floats(-5, 20), v=st.floats(-3, 3), r=st.floats(-0.6, 0.6), delta=st.floats(-0.5, 0.5))
@settings(max_examples=60, deadline=None)
def test_three_degrees_are_six_with_heave_roll_and_pitch_held(
    u: float, v: float, r: float, delta: float
) -> None:
    """Inertia without bounds holds what 3-DOF holds; the other three rows must agree."""
    box = BOAT.without_table()  # both have its loads
    heavy = box.packed.copy()
    heavy["m_z"] = heavy["J_xx"] = heavy["J_yy"] = 1e15
    state, sea = start(u, v, r, n=15.0, delta=delta, psi=0.4), a_sea(3, box, current=0.5)
    three = derivative(state, sea=sea, p=heavy)
    six = derivative(state, sea=sea, p=heavy, dof=6)
    # the held accelerations are 1e-9 of the free ones
    np.testing.assert_allclose(six[MOTION], three[MOTION], rtol=1e-7, atol=1e-8)
    assert np.max(np.abs(six[HELD])) < 1e-7


def test_rolls_outward_in_a_turn_and_sails_upright_before_and_after() -> None:
    n = shaft_for(8.0)
    track = sail(start(8.0 * KNOT, n=n), helm(n, 15.0), 60.0, dof=6)
    assert track[-1, fr.R] > 0.0  # to starboard, so that the boat leans to port
    assert math.radians(-15.0) < track[-1, fr.PHI] < math.radians(-0.2)
    straight = sail(start(8.0 * KNOT, n=n), helm(n, 0.0), 60.0, dof=6)[-1]
    assert abs(straight[fr.PHI]) < 1e-9
    assert abs(straight[fr.THETA]) < math.radians(2.0)
    assert abs(straight[fr.Z]) < 0.05


@pytest.mark.parametrize("name", vessel_names())
@pytest.mark.parametrize("dof", [3, 6])
def test_a_long_beam_wave_does_not_turn_a_ship(name: str, dof: int) -> None:
    """The water pushes the boat's mass where it is, also if that is not at the origin."""
    boat = Vessel.load(name)
    L = boat.values["length_waterline"]
    k = 2.0 * math.pi / (20.0 * L)
    omega, slope = math.sqrt(GRAVITY * k), math.radians(4.5)
    period = 2.0 * math.pi / omega
    # the water stands still when the boat begins
    sea = Sea.regular(boat, omega, slope / k, to=0.5 * math.pi, phase=0.5 * math.pi)
    p, dt = boat.packed.copy(), period / 400.0
    track = sail(start(0.0), np.zeros(4), 8.0 * period, sea, dt=dt, dof=dof, p=p)
    t = dt * np.arange(len(track))
    late = t > 4.0 * period
    basis = np.stack([np.cos(omega * t), np.sin(omega * t), np.ones_like(t), t], axis=1)[late]
    fit = np.linalg.lstsq(basis, track[late, fr.PSI], rcond=None)[0]
    # pushed at the origin, otter and tanker swing by 4 degrees
    assert math.hypot(fit[0], fit[1]) < math.radians(0.5)


def test_a_storm_leaves_no_nan_and_a_capsized_boat_is_a_state_like_any_other() -> None:
    sea = a_sea(5, hs=6.0, wind=16.3, components=60)
    track = sail(start(5.0, n=20.0), helm(20.0, 10.0), 300.0, sea, dof=6)
    assert np.all(np.isfinite(track))
    state = start(3.0, n=10.0)
    state[[fr.PHI, fr.THETA]] = 3.0, 1.5707
    assert np.all(np.isfinite(sail(state, helm(10.0, 0.0), 60.0, sea, dof=6)))


# ------------------------------------------------- branches


def jump(function: object, x: float, width: float) -> float:
    values = [np.asarray(function(y)) for y in (x - width, x, x + width)]  # type: ignore[operator]
    return float(max(np.max(np.abs(values[1] - values[0])), np.max(np.abs(values[2] - values[1]))))


@pytest.mark.parametrize("r", [0.0, 0.3])
@pytest.mark.parametrize("n", [0.0, 10.0, -10.0])
@pytest.mark.parametrize("column", [fr.U, fr.V, fr.R, fr.N_LEFT, fr.DELTA_LEFT])
def test_loads_are_continuous_through_zero(column: int, n: float, r: float) -> None:
    """U = 0, r = 0, n = 0, J = 0 and delta = 0 are no places to jump at."""
    base = start(0.0, 0.0, r, n=n)

    def rate(value: float) -> np.ndarray:
        state = base.copy()
        state[column] = value
        return derivative(state, np.zeros(4))[BODY]

    # slopes of the accelerations are below 1e3 per m/s, rad/s, rev/s or rad
    assert jump(rate, 0.0, 1e-8) < 1e-5


def test_loads_are_continuous_in_every_direction_of_flow_at_rest() -> None:
    """The primed velocities v', r' have no limit at U = 0, but their forces must."""
    for angle in np.linspace(0, 2 * math.pi, 17):
        for share in (0.0, 0.5, 10.0):
            u, v = 1e-7 * math.cos(angle), 1e-7 * math.sin(angle)
            forces = np.array(hull.hull_forces(u, v, share * 1e-7, P))
            # the largest slope is that of the resistance curve, 120 N per m/s
            assert np.max(np.abs(forces)) < 1e-4
    assert hull.hull_forces(0.0, 0.0, 0.0, P) == (0.0, 0.0, 0.0)


def test_continuous_where_the_turn_is_limited() -> None:
    # r' is held at 4 for turns on the spot: L |r| / U = 4
    r = 0.4
    U = BOAT.values["length_waterline"] * r / hull.R_PRIME_MAX
    assert jump(lambda u: hull.hull_forces(u, 0.0, r, P), U, 1e-8) < 1e-2


def test_thrust_is_as_printed_and_odd_from_bollard_pull_on() -> None:
    D, rho, k_0 = (BOAT.values[k] for k in ("propeller_diameter", "water_density", "k_0"))
    # bollard pull (J = 0) is rho n^2 D^4 k_0
    assert propulsion.thrust(20.0, 0.0, P) == pytest.approx(rho * 400.0 * D**4 * k_0, rel=1e-12)
    assert propulsion.thrust(0.0, 0.0, P) == 0.0
    # as printed with the quotient: docs/explanation/ship_and_sea.md, Propulsion
    n, u = 20.0, 5.0
    J = u / (n * D)
    K_T = k_0 + BOAT.values["k_1"] * J + BOAT.values["k_2"] * J**2
    assert propulsion.thrust(n, u, P) == pytest.approx(rho * n**2 * D**4 * K_T, rel=1e-12)
    # astern it is the propeller turned round
    assert propulsion.thrust(-n, -u, P) == -propulsion.thrust(n, u, P)


# ------------------------------------------------- resistance


def with_points(count: int) -> Vessel:
    """Return the boat with a resistance curve of so many points."""
    speed = tuple(float(v) for v in range(count))
    force = tuple(50.0 * v**2 for v in speed)
    return dataclasses.replace(BOAT, resistance_speed=speed, resistance_force=force)


@pytest.mark.parametrize(
    "boat", [BOAT, with_points(3), with_points(par.RESISTANCE_POINTS)], ids=["own", "few", "all"]
)
def test_resistance_goes_through_its_points_and_grows_with_the_square_beyond(boat: Vessel) -> None:
    p = boat.packed.copy()
    for speed, force in zip(boat.resistance_speed, boat.resistance_force, strict=True):
        assert hull.resistance(speed, p) == pytest.approx(force, rel=1e-12, abs=1e-12)
        # odd, to the bit; and continuous: slopes are below 3 kN per m/s
        assert hull.resistance(-speed, p) == -hull.resistance(speed, p)
        assert jump(lambda u: hull.resistance(u, p), speed, 1e-8) < 1e-4
    top, force = boat.resistance_speed[-1], boat.resistance_force[-1]
    assert hull.resistance(1.5 * top, p) == pytest.approx(2.25 * force, rel=1e-12)


def test_resistance_does_not_overshoot() -> None:
    speed, force = np.array(BOAT.resistance_speed), np.array(BOAT.resistance_force)
    for i in range(len(speed) - 1):
        inside = np.linspace(speed[i], speed[i + 1], 200)
        values = np.array([hull.resistance(u, P) for u in inside])
        low, high = sorted(force[i : i + 2])
        assert np.all((values >= low - 1e-9) & (values <= high + 1e-9))
        steps = np.diff(values) * np.sign(force[i + 1] - force[i])
        assert np.all(steps >= -1e-9)  # monotone between two points


def test_resistance_has_no_kink_inside() -> None:
    h = 1e-5
    for speed in BOAT.resistance_speed[1:-1]:
        left = (hull.resistance(speed, P) - hull.resistance(speed - h, P)) / h
        right = (hull.resistance(speed + h, P) - hull.resistance(speed, P)) / h
        # second derivatives are below 1e4 N per (m/s)^2
        assert left == pytest.approx(right, abs=0.2)


# ------------------------------------------------- actuators


def test_drives_turn_no_faster_than_they_can() -> None:
    rate = BOAT.values["steer_rate"]
    track = sail(start(5.0, n=20.0), np.array([20.0, 20.0, 0.5, -0.5]), 5.0)
    speeds = np.diff(track[:, fr.DELTA_LEFT :], axis=0) / 0.05
    assert np.max(np.abs(speeds)) <= rate * (1 + 1e-12)
    # 20 deg/s for the first half second, and there in the end
    assert track[10, fr.DELTA_LEFT] == pytest.approx(rate * 0.5, rel=1e-9)
    assert track[10, fr.DELTA_RIGHT] == pytest.approx(-rate * 0.5, rel=1e-9)
    np.testing.assert_allclose(track[-1, fr.DELTA_LEFT :], [0.5, -0.5], rtol=1e-6)


def test_drives_return() -> None:
    """The paper's Eq (11) cannot come back to 0, nor go from 20 to -20 degrees."""
    angle = math.radians(20.0)
    for target in (0.0, -angle):
        end = sail(start(5.0, n=20.0, delta=angle), np.array([20.0, 20.0, target, target]), 5.0)
        np.testing.assert_allclose(end[-1, fr.DELTA_LEFT :], target, atol=1e-6)


def test_commands_are_held_inside_what_the_boat_can_do() -> None:
    end = sail(start(5.0), np.array([1e3, -1e3, 3.0, -3.0]), 20.0)[-1]
    n, delta = BOAT.values["shaft_speed_max"], BOAT.values["steer_max"]
    np.testing.assert_allclose(end[fr.N_LEFT :], [n, -n, delta, -delta], rtol=1e-9)


def test_shafts_follow_with_their_lag() -> None:
    track = sail(start(5.0), np.array([20.0, 10.0, 0.0, 0.0]), 3.0)
    t = 0.05 * np.arange(len(track))
    expected = 1.0 - np.exp(-t / BOAT.values["shaft_lag"])
    # RK4 on a first-order lag: (dt/tau)^5 / 120 a step
    np.testing.assert_allclose(track[:, fr.N_LEFT], 20.0 * expected, atol=1e-5)
    np.testing.assert_allclose(track[:, fr.N_RIGHT], 10.0 * expected, atol=1e-5)


def test_port_propeller_and_positive_angle_turn_to_starboard() -> None:
    """Signs of docs/explanation/ship_and_sea.md, Frames and notation."""
    assert sail(start(5.0, n=20.0), np.array([25.0, 15.0, 0, 0]), 3.0)[-1, fr.R] > 0.0
    assert sail(start(5.0, n=20.0), helm(20.0, 10.0), 3.0)[-1, fr.R] > 0.0


# ------------------------------------------------- integrator


@pytest.mark.parametrize("dof", [3, 6])
def test_the_step_is_of_fourth_order_in_calm_water(dof: int) -> None:
    # between two resistance points (25 and 30 kn), turning one way, below the rate limit:
    # nothing but smooth functions on the way
    state, cmd = start(14.0, v=-0.8, r=0.2, n=33.0, delta=0.1), helm(33.0, math.degrees(0.1))
    tilted(state, (0.1, 0.1, 0.02, 0.1, 0.1, -0.05), dof)

    def end(dt: float) -> np.ndarray:
        track = sail(state, cmd, 1.0, dt=dt, dof=dof)
        assert np.all((track[:, fr.U] > 25.0 * KNOT) & (track[:, fr.U] < 30.0 * KNOT))
        return track[-1, MOTION]

    exact = end(1.0 / 1280)
    errors = [np.linalg.norm(end(dt) - exact) for dt in (0.05, 0.025, 0.0125)]
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert np.all(orders > 3.7)
    # the 2 s motions of heave, roll and pitch cost more than turning does
    assert errors[0] < (1e-6 if dof == 3 else 1e-4)
