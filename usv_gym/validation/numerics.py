"""Validation of the numerics: symmetry, energy and observed order."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from usv_gym.physics import GRAVITY, waves
from usv_gym.physics import frames as fr
from usv_gym.physics import weather as wx
from usv_gym.validation.study import Array, BoatInSea, Section, Study, realise, rows, under_way
from usv_gym.vessel.vessel import Vessel
from usv_gym.world.sea import SeaState


def mirrored(state: Array) -> Array:
    """Return states with port and starboard exchanged."""
    out = state.copy()
    out[..., [fr.Y, fr.PHI, fr.PSI, fr.V, fr.P, fr.R]] *= -1.0
    out[..., [fr.N_LEFT, fr.N_RIGHT]] = state[..., [fr.N_RIGHT, fr.N_LEFT]]
    out[..., [fr.DELTA_LEFT, fr.DELTA_RIGHT]] = -state[..., [fr.DELTA_RIGHT, fr.DELTA_LEFT]]
    return out


def _random_state(rng: np.random.Generator, dof: int) -> Array:
    """Return a random state under way."""
    state = np.zeros(fr.STATE_SIZE)
    state[[fr.U, fr.V, fr.R]] = rng.uniform((2.0, -1.5, -0.4), (18.0, 1.5, 0.4))
    if dof == 6:
        tilt = rng.uniform(-1.0, 1.0, 6) * (0.5, 0.6, 0.3, 0.5, 0.5, 0.3)
        state[[fr.Z, fr.PHI, fr.THETA, fr.W, fr.P, fr.Q]] = tilt
    return state


def energy(states: Array, v: Mapping[str, float]) -> Array:
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


def observed_order(boat: Vessel, dof: int) -> float:
    """Return the smallest observed order of the time step over two halvings in calm water."""
    runner, cmd = BoatInSea(boat, dof=dof), np.array([33.0, 33.0, 0.1, 0.1])
    state = under_way(14.0, -0.8, 0.2, 33.0)
    state[fr.DELTA_LEFT :] = 0.1
    if dof == 6:
        state[[fr.Z, fr.PHI, fr.THETA, fr.W, fr.P, fr.Q]] = 0.1, 0.1, 0.02, 0.1, 0.1, -0.05
    columns = [fr.X, fr.Y, fr.PSI, fr.U, fr.V, fr.R]
    ends = [
        runner.run(state, cmd, 1.0, dt)[-1, columns] for dt in (0.05, 0.025, 0.0125, 1.0 / 1280)
    ]
    errors = np.array([np.linalg.norm(end - ends[-1]) for end in ends[:-1]])
    return float(np.min(np.log2(errors[:-1] / errors[1:])))


def numerics(study: Study) -> Section:
    """Return properties that hold exactly."""
    boat, exact, found = study.boat, "exact", []
    for dof in (3, 6):
        name, rng = f"{dof} degrees of freedom", np.random.default_rng(dof)
        order = observed_order(boat, dof)
        found += rows([(f"{name}: order of the time step", order, 4.0)], "RK4", 0.3, "absolute", 3)
        calm, gain, mirror = BoatInSea(boat, dof=dof), 0.0, 0.0
        for _ in range(20):
            state = _random_state(rng, dof)
            cmd = rng.uniform((-5, -5, -0.5, -0.5), (40, 40, 0.5, 0.5))
            course = energy(calm.run(state, np.zeros(4), 10.0), boat.values)
            gain = max(gain, float(np.max(np.diff(course))) / course[0])
            other = np.array([cmd[1], cmd[0], -cmd[3], -cmd[2]])
            run, image = calm.run(state, cmd, 8.0), calm.run(mirrored(state), other, 8.0)
            mirror = max(mirror, float(np.max(np.abs(mirrored(image) - run))))
        # with heave and roll of 2 s the error of a step at 20 Hz is 1e-7
        item = f"{name}: largest gain of energy without thrust"
        found += rows([(item, max(gain, 0.0), 0.0)], exact, 1e-9 if dof == 3 else 1e-6, "below")
        item = f"{name}: port against starboard, 20 runs of 8 s"
        found += rows([(item, mirror, 0.0)], exact, 1e-8, "below")
    level = realise(SeaState(hs=0.5, components=20), boat)
    level.waves[[waves.AMPLITUDE, waves.PRESSURE, waves.BOTTOM]] = 0.0
    level = replace(level, weather=wx.constant())
    calm, still = BoatInSea(boat, dof=6), BoatInSea(boat, level, 6)
    # three degrees of freedom have the loads of a box
    box = boat.without_table()
    sea = realise(SeaState(hs=0.5, wind=4.5, components=20), box)
    held = replace(box, values={**box.values, "m_z": 1e15, "J_xx": 1e15, "J_yy": 1e15})
    six, three = BoatInSea(held, sea, 6), BoatInSea(held, sea, 3)
    rng, load, difference = np.random.default_rng(0), 0.0, 0.0
    columns = [fr.X, fr.Y, fr.PSI, fr.U, fr.V, fr.R]
    for _ in range(20):
        state = _random_state(rng, 6)
        change = still.derivative(state) - calm.derivative(state)
        load = max(load, float(np.max(np.abs(change))))
        state = _random_state(rng, 3)
        change = (six.derivative(state) - three.derivative(state))[columns]
        difference = max(difference, float(np.max(np.abs(change))))
    item = "load of a sea without height, wind and current"
    found += rows([(item, load, 0.0)], exact, 1e-300, "below")
    item = "3-DOF against 6-DOF with heave, roll and pitch held"
    found += rows([(item, difference, 0.0)], exact, 1e-7, "below")
    return Section(
        "Numerics",
        "Properties that hold for any coefficients, on random states and runs of the 7.5 m boat. "
        "Bounds are rounding errors. The tests check each property on many more.",
        tuple(found),
    )
