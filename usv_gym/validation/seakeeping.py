"""Validation of loads and motions in waves."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from usv_gym.manoeuvring import rao
from usv_gym.physics import GRAVITY, spectra, waves
from usv_gym.physics import frames as fr
from usv_gym.validation.study import (
    DEGREE,
    HEADINGS,
    JENSEN_HULL,
    OMEGA,
    SEPARATE,
    SPEEDS,
    Array,
    BoatInSea,
    Section,
    Study,
    rows,
    under_way,
)
from usv_gym.vessel.vessel import Vessel
from usv_gym.world.realisation import Sea

JENSEN = (
    (1.0, 0.0, 0.9868, 0.1013),
    (1.777, 0.0, 0.8686, 0.3011),
    (1.777, 5.58, 1.2713, 0.4407),
    (2.5, 0.0, 0.5152, 0.4759),
    (2.5, 5.58, 0.0725, 0.0669),
)
"""Frequency (rad/s), speed (m/s), heave (m/m) and pitch (rad/m) in head sea."""

DAMPINGS = (
    ("heave", fr.Z, "zeta_heave"),
    ("pitch", fr.THETA, "zeta_pitch"),
    ("roll", fr.PHI, "zeta_roll"),
)
"""Motion, column, key of the damping."""

# heading, rms of heave (m), pitch and roll (deg) under way
EXPECTED = (
    ("head", 0.131, 2.18, None),
    ("bow-quarter", 0.151, 2.04, 3.5),
    ("stern-quarter", 0.068, 1.1, 0.9),
)

LONG = OMEGA <= 2.2
"""Waves longer than two ship lengths."""


def quadrature_error(boat: Vessel, count: int = 200) -> float:
    """Return the largest error of box loads against quadrature, over the largest load."""
    rng, worst, v = np.random.default_rng(0), 0.0, boat.values
    L, B, d, rho = (v[key] for key in ("length_waterline", "beam", "draft", "water_density"))
    box = {**v, "block_coefficient": 1.0, "mass": rho * L * B * d, "A_wp": L * B}
    box |= {"GM_L": L**2 / (12.0 * d), "GM_T": B**2 / (12.0 * d)}
    vessel = replace(boat, values=box)
    p = vessel.packed.copy()
    for _ in range(count):
        k, to, psi, phase = rng.uniform((0.02, -math.pi, -7.0, 0.0), (8.0, math.pi, 7.0, 6.2))
        wave = Sea.regular(vessel, math.sqrt(GRAVITY * k), 0.2, to, phase).waves
        factors = waves.factor_workspace(1)
        waves.box_factors(psi, wave, p, 6, factors)
        got = np.array(waves.first_order_loads(2.0, -5.0, psi, 3.3, wave, p, 6, factors))[:6]
        want = rao.box_loads(wave[:, 0], 2.0, -5.0, psi, 3.3, rao.Box(L, B, d, rho))
        side = wave[waves.PRESSURE, 0] * k * L * B
        bottom = wave[waves.PRESSURE, 0] * wave[waves.BOTTOM, 0] * L * B
        scale = [side, side, 0.5 * side * L, bottom, 0.5 * bottom * B, 0.5 * bottom * L]
        worst = max(worst, float(np.max(np.abs(got - want) / scale)))
    return worst


def decay(vessel: Vessel, column: int, size: float = 0.02) -> tuple[float, float]:
    """Return natural period (s) and damping ratio of a free decay."""
    dt, state = 0.01, under_way(0.0)
    state[column] = size
    motion = BoatInSea(vessel, dof=6).run(state, np.zeros(4), 12.0, dt)[:, column]
    peak = int(np.flatnonzero((motion[1:-1] > motion[:-2]) & (motion[1:-1] >= motion[2:]))[0]) + 1
    decrement = math.log(motion[0] / motion[peak])
    zeta = decrement / math.hypot(2.0 * math.pi, decrement)
    return dt * peak * math.sqrt(1.0 - zeta**2), zeta


def rms(response: Array, hs: float = 0.5) -> float:
    """Return the standard deviation of a motion with given amplitudes in a PM sea."""
    known = np.isfinite(response)
    amplitude = np.interp(OMEGA, OMEGA[known], response[known])
    return math.sqrt(float(np.trapezoid(amplitude**2 * spectra.pm_spectrum(OMEGA, hs), OMEGA)))


def loads_in_waves(study: Study) -> Section:
    """Return closed forms, quadrature, dampings, limits and linearity."""
    boat, formulas, limits = study.boat, [], []
    for omega, speed, *wants in JENSEN:
        # published for g = 9.81 m/s2: the same wave and Froude number here
        scale = math.sqrt(GRAVITY / 9.81)
        got = rao.jensen(omega * scale, math.pi, speed=speed * scale, **JENSEN_HULL)
        where = f"Jensen, head sea, w = {omega:g}, U = {speed:g} m/s"
        for name, value, want in zip(("heave, m/m", "pitch, rad/m"), got, wants, strict=True):
            formulas.append((f"{where}: {name}", float(value), want))
    found = rows(formulas, SEPARATE, 1e-3)
    item = "Froude-Krylov loads against quadrature: largest error over 200 waves"
    found += rows([(item, quadrature_error(boat), 0.0)], "numerical quadrature", 1e-10, "below")
    for name, column, key in DAMPINGS:
        item = f"usv75, free decay: {name}, damping over critical"
        entry = (item, decay(boat, column)[1], boat.values[key])
        found += rows([entry], "hydrodynamic table", 0.1, digits=3)
    slope = OMEGA[0] ** 2 / GRAVITY
    for speed in SPEEDS:
        head, beam = (study.responses[name, speed] for name in ("head", "beam"))
        at = f"usv75, wave of {2.0 * math.pi / slope:.0f} m, U = {speed:g} m/s"
        limits = [
            (f"{at}: heave over wave, head", float(head.heave[0]), 1.0),
            (f"{at}: pitch over slope, head", float(head.pitch[0] / slope), 1.0),
            (f"{at}: sway over wave, beam", float(beam.east[0]), 1.0),
            (f"{at}: roll over slope, beam", float(beam.roll[0] / slope), 1.0),
        ]
        found += rows(limits, "limit of long waves", 0.02 if speed == 0.0 else 0.05)
    for motion, heading in (("heave", "head"), ("pitch", "head"), ("roll", "beam")):
        small, double, high = (
            getattr(rao.respond(boat, 1.777, HEADINGS[heading] * DEGREE, amplitude=a), motion) * a
            for a in (1e-3, 2e-3, 0.25)
        )
        item = f"usv75, {motion} in 2 mm over 1 mm waves, w = 1.777"
        found += rows([(item, float(double / small), 2.0)], "linearity", 0.01)
        item = f"usv75, {motion} in .25 m over 1 mm waves, w = 1.777"
        found += rows([(item, float(high / small), 250.0)], "linearity")
    return Section(
        "Loads and free motions in waves",
        "Closed forms and quadrature check the formulas of the loads. Dampings, long-wave limits "
        "and linearity check the simulation in six degrees of freedom. In a very long wave "
        "the boat must move with the water and tilt with its slope, at rest and under way. "
        "Hull, propulsion and added mass move relative to the orbital motion. Roll and pitch "
        "couple with sway, which changes their damping. Waves of .25 m show how linear the boat "
        "remains in a sea with Hs .5 m.",
        tuple(found),
    )


def motions(study: Study) -> Section:
    """Return response amplitudes under way over Jensen's, and motions in a PM sea."""
    found, jensen, speed = [], "Jensen, Mansour and Olsen 2004", SPEEDS[1]
    for heading in ("head", "bow-quarter", "beam", "following"):
        got = study.responses[heading, speed]
        simulated = {"heave": got.heave, "pitch": got.pitch}
        closed = dict(zip(simulated, study.jensen(heading, speed), strict=True))
        for name in simulated if heading != "beam" else ("heave",):
            values, wants = simulated[name], closed[name]
            used = LONG & np.isfinite(values)
            ratio = values[used] / wants[used]
            where = f"usv75, {name}, {heading}, U = {speed:g} m/s"
            extremes = [
                (f"{where}, lambda > 2 L: smallest ratio", float(np.min(ratio)), 1.0),
                (f"{where}, lambda > 2 L: largest ratio", float(np.max(ratio)), 1.0),
            ]
            found += rows(extremes, jensen, digits=3)
            used = np.isfinite(values) & (OMEGA <= 4.0)
            correlation = float(np.corrcoef(values[used], wants[used])[0, 1])
            entry = (f"{where}: correlation, w <= 4", correlation, 1.0)
            found += rows([entry], jensen, 0.2, "absolute", 3)
    names = ("heave, m", "pitch, deg", "roll, deg")
    for heading, *references in EXPECTED:
        got = study.responses[heading, speed]
        sizes = rms(got.heave), rms(got.pitch) / DEGREE, rms(got.roll) / DEGREE
        where = f"usv75 in PM, Hs .5 m, {heading}, U = {speed:g} m/s: rms"
        entries = [
            (f"{where} {name}", value, want)
            for name, value, want in zip(names, sizes, references, strict=True)
            if want is not None
        ]
        found += rows(entries, "Jensen's closed forms", digits=3)
    return Section(
        "Motions under way beside Jensen's closed forms",
        "No table of hydrodynamics under way is at hand. Shown are ratios of the simulated boat's "
        "response amplitudes to a theory of box-shaped ships, in low regular waves longer than two "
        "ship lengths, then motions in a PM sea with Hs .5 m. The theory holds to a Froude number "
        "of .4 and the boat sails at .7, so sizes are reported only. Their shape over the "
        "frequency is tested. Added mass, damping and excitation are those at rest here, and waves "
        "are met at the frequency of encounter. In following seas the boat is compared at its "
        "encounter frequency, which is outside the range of the closed forms. No model tests of "
        "this boat are known.",
        tuple(found),
        {
            "raos.png": "Response amplitudes of the 7.5 m boat: simulated (lines) and Jensen's "
            "closed forms (dashed); roll is simulated only.",
        },
    )
