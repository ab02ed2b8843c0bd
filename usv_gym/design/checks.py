"""Inspection of vessels: derived particulars, and broken rules of thumb."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from usv_gym.design import regressions as reg
from usv_gym.design.seaway import sail_in_sea
from usv_gym.physics import GRAVITY, ship
from usv_gym.physics import frames as fr
from usv_gym.physics.hull import hull_forces
from usv_gym.physics.propulsion import propulsion_forces
from usv_gym.vessel.runaway import check_motion
from usv_gym.vessel.vessel import Vessel, VesselError, course_eigenvalues, jacobian, state_at
from usv_gym.world.sea import SeaState

__all__ = ["Finding", "Inspection", "inspect"]

DT_S = 0.05
"""Default integration step of simulations."""

RK4_LIMIT = 2.5
"""Largest step times eigenvalue; RK4 is stable up to about 2.7."""

CAPSIZED_RAD = math.radians(70.0)
"""Heel at which a hull counts as capsized in a turn."""

SEAS = ("2", "3", "4")
"""Sea states in which a vessel is tried, up to waves of half its length."""

NO_TURN_LENGTHS = 100.0
"""Turning radius from which a ship counts as not turning."""


@dataclass(frozen=True)
class Finding:
    """A broken rule, in one sentence; an ``error`` makes the vessel wrong, else it is unusual."""

    error: bool
    text: str


@dataclass(frozen=True)
class Inspection:
    """Derived particulars of a vessel by name with unit, and the rules that it breaks."""

    name: str
    title: str
    facts: dict[str, float]
    """NaN: there is none, as the period of an overdamped motion."""
    findings: list[Finding]
    """Errors first."""

    @property
    def errors(self) -> list[Finding]:
        """The findings that are errors."""
        return [finding for finding in self.findings if finding.error]


def inspect(vessel: Vessel) -> Inspection:
    """Return derived particulars of a vessel, and what is wrong or unusual."""
    facts, findings = _proportions(vessel), []
    try:
        facts |= _speeds(vessel) | _course(vessel) | _turn(vessel, facts)
        for dof in (3, 6):
            check_motion(vessel, dof, DT_S)
    except VesselError as error:
        findings.append(Finding(True, str(error)))
    rules = (_unusual, _wrong, _wrong_turn)
    findings += [finding for rule in rules for finding in rule(vessel, facts)]
    if not any(finding.error for finding in findings):
        facts |= _seaway(vessel, findings)
    findings.sort(key=lambda finding: not finding.error)
    return Inspection(vessel.name, vessel.title, facts, findings)


def _proportions(vessel: Vessel) -> dict[str, float]:
    """Return ratios of the particulars, and the natural periods at rest."""
    v, hull = vessel.values, reg.Form.of(vessel)
    L, B, d, mass = v["length_waterline"], v["beam"], v["draft"], v["mass"]
    water = reg.hydrostatics(hull, v["A_wp"] / (hull.hulls * hull.length * hull.beam))
    facts = {
        "mass kg": mass,
        "displacement of the hull kg": hull.mass,
        "length / beam": L / B,
        "beam / draft": B / d,
        "block coefficient": v["block_coefficient"],
        "water-plane coefficient": v["A_wp"] / (L * B),
        "KG m": v["KG"],
    }
    if hull.hulls == 2:
        facts["length / beam of each hull"] = L / hull.beam
    for key in ("GM_T", "GM_L"):
        facts[f"{key} m"] = v[key]
        if vessel.stated:
            facts[f"{key} of the file m"] = vessel.stated[key]
        if hull.hulls == 2 or not vessel.two_hulls:  # else the spacing of the hulls is not known
            facts[f"{key} by KB + BM - KG m"] = water["KB"] - v["KG"] + water[f"BM_{key[-1]}"]
    return facts | {
        "gyradius in roll / beam": math.sqrt(v["I_xx"] / mass) / B,
        "gyradius in pitch / length overall": math.sqrt(v["I_yy"] / mass) / v["length_overall"],
        "gyradius in yaw / length overall": math.sqrt(v["I_zz"] / mass) / v["length_overall"],
        "added mass in surge / mass": v["m_x"] / mass,
        "added mass in sway / mass": v["m_y"] / mass,
        "added mass in heave / mass": v["m_z"] / mass,
        "added inertia in roll / inertia": v["J_xx"] / v["I_xx"],
        "added inertia in pitch / inertia": v["J_yy"] / v["I_yy"],
        "added inertia in yaw / inertia": v["J_zz"] / v["I_zz"],
        "bollard pull N": _thrust(vessel, v["shaft_speed_max"]),
        "bollard pull astern N": -_thrust(vessel, -v["shaft_speed_max"]),
        **_periods(vessel),
    }


def _periods(vessel: Vessel) -> dict[str, float]:
    """Return the periods of the modes at rest with the most energy in heave, roll and pitch."""
    v = vessel.values
    rows = [fr.Z, fr.PHI, fr.THETA, fr.U, fr.V, fr.W, fr.P, fr.Q, fr.R]
    values, vectors = np.linalg.eig(jacobian(vessel, state_at(vessel, 0.0, 0.0), rows))
    weight = v["mass"] * GRAVITY
    stiffness = (v["water_density"] * GRAVITY * v["A_wp"], weight * v["GM_T"], weight * v["GM_L"])
    energy = np.abs(vectors[:3]) ** 2 * np.array(stiffness)[:, None]
    swings = values.imag > 1e-6 * np.abs(values)
    share = np.where(swings, energy / np.maximum(energy.sum(axis=0), 1e-300), 0.0)
    periods = {}
    for name, shares in zip(("heave", "roll", "pitch"), share, strict=True):
        at = int(np.argmax(shares))
        period = 2.0 * math.pi / float(abs(values[at])) if shares[at] > 0.3 else math.nan
        periods[f"period of {name} s"] = period
    return periods


def _thrust(vessel: Vessel, n: float, speed: float = 0.0) -> float:
    """Return the thrust of all units, N."""
    state = state_at(vessel, n, speed)
    return float(propulsion_forces(speed, 0.0, 0.0, state, vessel.packed.copy())[0])


def _speeds(vessel: Vessel) -> dict[str, float]:
    """Return speed, Froude number and thrust straight ahead in calm water."""
    facts = {}
    for name in ("manoeuvring", "service", "max"):
        n = vessel.values[f"shaft_speed_{name}"]
        facts[f"speed, {name} m/s"] = speed = vessel.straight_speed(n)
        wave = math.sqrt(GRAVITY * vessel.values["length_waterline"])
        facts[f"Froude number, {name}"] = speed / wave
        facts[f"thrust, {name} N"] = _thrust(vessel, n, speed)
    return facts


def _course(vessel: Vessel) -> dict[str, float]:
    """Return the growth rates of drift and turning on a straight course at service speed."""
    first, second = course_eigenvalues(vessel, vessel.values["shaft_speed_service"])
    return {"growth of drift 1/s": first.real, "growth of drift, second 1/s": second.real}


def _turn(vessel: Vessel, facts: dict[str, float]) -> dict[str, float]:
    """Return a turning circle to starboard in calm water at the manoeuvring shaft speed.

    With full helm; a pair of fixed thrusters has no helm: one of them stops.
    """
    v = vessel.values
    n, L = v["shaft_speed_manoeuvring"], v["length_waterline"]
    speed = vessel.straight_speed(n)
    periods = (facts[f"period of {name} s"] for name in ("heave", "roll", "pitch"))
    dt = min(
        0.02 * L / speed,
        v["shaft_lag"],
        v.get("steer_lag", math.inf),
        *(0.05 * period for period in periods if not math.isnan(period)),
    )
    state, command = state_at(vessel, n, speed), vessel.command(n, vessel.helm_max)
    free, calm = ship.Ship(vessel.packed, 6), ship.calm_sea()
    work = np.zeros((ship.WORK_ROWS, fr.STATE_SIZE))
    advance = diameter = math.nan
    heel = 0.0
    for k in range(int(120.0 * L / speed / dt)):
        ship.step(state, command, free, calm, k * dt, dt, work)
        heading, heel = abs(state[fr.PSI]), max(heel, abs(state[fr.PHI]))
        if not heel < CAPSIZED_RAD or heading > 4.0 * math.pi:
            break
        if heading >= 0.5 * math.pi and math.isnan(advance):
            advance = float(state[fr.X]) / L
        if heading >= math.pi and math.isnan(diameter):
            diameter = abs(float(state[fr.Y])) / L
    end, rate = math.hypot(state[fr.U], state[fr.V]), float(state[fr.R])
    return {
        "turn: advance in lengths": advance,
        "turn: tactical diameter in lengths": diameter,
        "turn: steady radius in lengths": end / abs(rate) / L if rate != 0.0 else math.inf,
        "turn: steady yaw rate deg/s": math.degrees(rate),
        "turn: steady speed / approach": end / speed,
        "turn: largest heel deg": math.degrees(heel),
        "turn: drift angle deg": math.degrees(math.atan2(-state[fr.V], state[fr.U])),
    }


def _seaway(vessel: Vessel, findings: list[Finding]) -> dict[str, float]:
    """Return the largest tilt in each sea, up to one in which the vessel capsizes."""
    facts = {}
    for name in SEAS:
        sea = SeaState.named(name)
        if sea.hs > 0.5 * vessel.values["length_waterline"]:
            break
        trial = sail_in_sea(vessel, sea)
        facts[f"sea {name}: largest tilt deg"] = math.degrees(trial.tilt)
        if trial.capsized:
            text = f"In sea state {name} it capsizes within a minute, {trial.where}."
            findings.append(Finding(False, text))
            break
    return facts


def _unusual(vessel: Vessel, facts: dict[str, float]) -> Iterator[Finding]:
    """Yield a finding for each number outside its typical range."""
    v, two = vessel.values, vessel.two_hulls
    L, weight = v["length_waterline"], v["mass"] * GRAVITY
    pair = vessel.kind == "thruster_pair"
    # a catamaran may be as wide as it is long
    wide = 0.4 * v["beam"] / v["length_overall"] if two else 0.0
    mass, origin = "does it belong to another mass?", "are both measured from the same origin?"
    steers = "check k_0 to k_2 (thrust, drag of the stopped one), y_P, N_r and D_r" if pair else ""
    ranges: dict[str, tuple[float, float, str]] = {
        "length / beam": (1.0 if two else 1.5, 12.0, ""),
        "length / beam of each hull": (3.0, 30.0, ""),
        "beam / draft": (1.2, 60.0 if two else 20.0, ""),
        "gyradius in roll / beam": (0.3, 0.5, mass),
        "gyradius in pitch / length overall": (0.2, 0.3, mass),
        "gyradius in yaw / length overall": (0.2, math.hypot(0.3, wide), mass),
        "added mass in surge / mass": (0.01, 0.3, ""),
        "added mass in sway / mass": (0.15, 4.0 if two else 2.0, ""),
        "added mass in heave / mass": (0.2, 8.0, ""),
        "added inertia in roll / inertia": (0.02, 8.0, ""),
        "added inertia in pitch / inertia": (0.2, 5.0, ""),
        "added inertia in yaw / inertia": (0.1, 4.0 if two else 2.5, ""),
        "Froude number, max": (0.05, 2.6, "check thrust and resistance"),
        "turn: steady radius in lengths": (0.2, 30.0 if two and not pair else 10.0, steers),
        "turn: drift angle deg": (-10.0, 45.0, ""),
        "turn: largest heel deg": (0.0, 25.0, ""),
        "turn: steady speed / approach": (0.1, 2.5, ""),
    }
    values = {
        "displacement of the hull over the mass": (
            facts["displacement of the hull kg"] / v["mass"],
            (0.97, 1.03, "block coefficient, length, beam and draft make the displacement"),
        ),
        "x_G over the length": (v["x_G"] / L, (-0.15, 0.15, "it is measured from midship")),
        "x_F - x_G over the length": ((v["x_F"] - v["x_G"]) / L, (-0.15, 0.15, origin)),
        "KG over draft": (v["KG"] / v["draft"], (0.4, 10.0 if two else 3.0, "")),
        "GM_T over beam": (v["GM_T"] / v["beam"], (0.02, 12.0 if two else 1.0, "")),
        "bollard pull over the weight": (facts["bollard pull N"] / weight, (5e-4, 2.0, "")),
        **{key: (v[key], (0.02, 0.7, "")) for key in ("zeta_heave", "zeta_roll", "zeta_pitch")},
        **{key: (facts[key], bounds) for key, bounds in ranges.items() if key in facts},
    }
    for key in ("GM_T", "GM_L"):
        guess = facts.get(f"{key} by KB + BM - KG m", math.nan)
        if not math.isnan(guess):
            share = v[key] / guess if guess > 0.0 else math.inf
            values[f"{key} over KB + BM - KG of the water plane"] = share, (0.5, 2.0, "")
    if "speed, max m/s" in facts:
        drag = -hull_forces(facts["speed, max m/s"], 0.0, 0.0, vessel.packed.copy())[0]
        values["resistance at full shaft speed over the weight"] = drag / weight, (5e-4, 0.6, "")
    for name, (value, (low, high, hint)) in values.items():
        if not low <= value <= high:
            end = f"; {hint}" if hint else ""
            text = f"{name} is {value:.3g}, typical are {low:.3g} to {high:.3g}{end}"
            yield Finding(False, text)
    for name in ("heave", "roll", "pitch"):
        if math.isnan(facts[f"period of {name} s"]):
            yield Finding(False, f"The ship at rest does not oscillate in {name}: it is overdamped")
    growth = facts.get("growth of drift 1/s", 0.0)
    if growth > 0.0:
        yield Finding(
            False,
            "On a straight course at service speed drift doubles every "
            f"{math.log(2.0) / growth:.3g} s; it should decay (Y_v, N_v, N_r, fins or drives)",
        )


def _wrong(vessel: Vessel, facts: dict[str, float]) -> Iterator[Finding]:
    """Yield a finding for each number that cannot be."""
    v = vessel.values
    shafts = [v[f"shaft_speed_{name}"] for name in ("manoeuvring", "service", "max")]
    plane, block = facts["water-plane coefficient"], v["block_coefficient"]
    gyradii = [facts[f"gyradius in {axis} / length overall"] for axis in ("pitch", "yaw")]
    rate = _fastest(vessel, facts)
    rules = [
        (
            v["length_waterline"] > v["length_overall"],
            f"length_waterline = {v['length_waterline']:g} m is above length_overall",
        ),
        (plane > 1.0, f"A_wp = {v['A_wp']:.4g} m2 is above length times beam"),
        (
            plane < 0.9 * block,
            f"The water-plane coefficient {plane:.3g} is below the block coefficient {block:.3g}: "
            "the hull would widen downwards",
        ),
        (
            min(gyradii) < 0.1
            or max(gyradii) > math.hypot(0.6, 0.4 * v["beam"] / v["length_overall"]),
            "The gyradius in pitch or yaw is below 0.1 or above 0.6 of the length: I_yy and I_zz "
            "belong to another mass",
        ),
        (
            sorted(shafts) != shafts,
            f"The shaft speeds of manoeuvring, service and max, {shafts} rev/s, must not fall",
        ),
        (
            rate * DT_S > RK4_LIMIT,
            f"The stiffest motion ({rate:.3g} 1/s) is too fast for a step of {DT_S:g} s; simulate "
            f"with dt_physics = {RK4_LIMIT / rate:.2g} s or less",
        ),
        (
            facts.get("Froude number, max", 0.0) > 5.0,
            "Full shaft speed makes a Froude number above 5; check thrust and resistance",
        ),
    ]
    yield from (Finding(True, text) for broken, text in rules if broken)


def _wrong_turn(vessel: Vessel, facts: dict[str, float]) -> Iterator[Finding]:
    """Yield a finding if the turning circle cannot be."""
    if "turn: steady yaw rate deg/s" not in facts:
        return
    helm = "one thruster stopped" if vessel.kind == "thruster_pair" else "full helm"
    rate, speed = facts["turn: steady yaw rate deg/s"], facts["turn: steady speed / approach"]
    if not (math.isfinite(rate) and speed <= 5.0):
        yield Finding(True, "The turning circle diverges: no steady turn is reached")
    elif facts["turn: largest heel deg"] >= math.degrees(CAPSIZED_RAD):
        yield Finding(
            True,
            f"A turn with {helm} capsizes the ship: GM_T is too small, or KG, z_H and z_P lie too "
            "far apart",
        )
    elif rate < 0.0:
        yield Finding(True, f"{helm.capitalize()} to starboard turns to port ({rate:.3g} deg/s)")
    elif not facts["turn: steady radius in lengths"] < NO_TURN_LENGTHS:
        yield Finding(True, f"With {helm} the ship hardly turns: {rate:.3g} deg/s at the end")


def _fastest(vessel: Vessel, facts: dict[str, float]) -> float:
    """Return the largest rate of the ship's motion at rest and at full speed, 1/s."""
    v = vessel.values
    rows = [*range(fr.Z, fr.THETA + 1), *range(fr.U, fr.R + 1), *range(fr.N_LEFT, fr.STATE_SIZE)]
    fastest = max(1.0 / v["shaft_lag"], 1.0 / v.get("steer_lag", 1.0))
    moving = [(v["shaft_speed_max"], facts["speed, max m/s"])] if "speed, max m/s" in facts else []
    for n, speed in [(0.0, 0.0), *moving]:
        values = np.linalg.eigvals(jacobian(vessel, state_at(vessel, n, speed), rows))
        fastest = max(fastest, float(np.max(np.abs(values))))
    return fastest
