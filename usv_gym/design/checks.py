"""Inspection of vessels: derived particulars, and broken rules of thumb."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from usv_gym.design import regressions as reg
from usv_gym.design.seaway import sail_in_sea
from usv_gym.physics import GRAVITY, KNOT, ship
from usv_gym.physics import frames as fr
from usv_gym.physics.hull import hull_forces
from usv_gym.physics.propulsion import propulsion_forces
from usv_gym.vessel.geometry import hull_of
from usv_gym.vessel.hydrostatics import Hydrostatics
from usv_gym.vessel.runaway import check_motion
from usv_gym.vessel.vessel import Vessel, VesselError, course_eigenvalues, jacobian, state_at
from usv_gym.world.sea import SeaState

__all__ = [
    "Finding",
    "Inspection",
    "form_of",
    "inspect",
]

DT = 0.05
"""Default integration step of simulations, s."""

RK4_LIMIT = 2.5
"""Largest step times eigenvalue; RK4 is stable up to about 2.7."""

CAPSIZED = math.radians(70.0)
"""Heel at which a hull counts as capsized, rad."""

SEAS = ("2", "3", "4")
"""Seas in which a vessel is tried."""

HIGHEST = 0.5
"""Highest waves in which it is tried, in lengths: no boat stands much more."""

LEVEL = 0.5
"""Trim up to which a mesh counts as level, degrees."""

WIDEST, SLOWEST = 10.0, 0.06
"""Of boats that steer by unequal thrust, with one thruster stopped: largest radius in lengths, and
least yaw rate in speeds of approach over lengths. A recorded BlueBoat has 8 and 0.08."""

WEAK = "it hardly steers: check k_0 to k_2 (thrust, drag of the stopped one), y_P, N_r and D_r."
"""Hint of those rules."""

NO_TURN = 100.0
"""Turning radius in lengths from which a ship counts as not turning."""


@dataclass(frozen=True)
class Finding:
    """A broken rule, in one sentence; an ``error`` makes the vessel wrong, else it is unusual."""

    error: bool
    text: str


@dataclass
class Inspection:
    """Derived particulars of a vessel."""

    # of the vessel
    name: str
    title: str
    particulars: dict[str, float] = field(default_factory=dict)  # name with unit to number
    # natural periods of heave, roll and pitch in s; nan for an overdamped motion
    periods: dict[str, float] = field(default_factory=dict)
    # shaft speed, speed, Froude number and thrust, up to the largest shaft speed
    speeds: list[dict[str, float]] = field(default_factory=list)
    # eigenvalues of drift and turning on a straight course at service speed, 1/s
    course: dict[str, float] = field(default_factory=dict)
    # turning circle at the manoeuvring shaft speed and full helm; a pair of fixed thrusters has no
    # helm: one of them stops, and the shaft speeds stand in its place
    turn: dict[str, float] = field(default_factory=dict)
    # by sea state: largest angle of the mast from upright, headings on which it capsizes
    seaway: dict[str, dict[str, float]] = field(default_factory=dict)
    findings: list[Finding] = field(default_factory=list)  # errors first

    @property
    def errors(self) -> list[Finding]:
        """The findings that are errors."""
        return [finding for finding in self.findings if finding.error]

    def to_json(self) -> dict[str, Any]:
        """Return everything as dictionaries; numbers that are not finite become None."""
        return _plain(dataclasses.asdict(self))


def _plain(item: Any) -> Any:
    """Return an item with None for numbers that are not finite."""
    if isinstance(item, dict):
        return {key: _plain(value) for key, value in item.items()}
    if isinstance(item, list):
        return [_plain(value) for value in item]
    return None if isinstance(item, float) and not math.isfinite(item) else item


def form_of(vessel: Vessel) -> reg.Form:
    """Return the main particulars for the regressions."""
    v = vessel.values
    hulls, beam = (2, v["hull_beam"]) if "hull_beam" in v else (1, v["beam"])
    return reg.Form(
        length=v["length_waterline"],
        beam=beam,
        draft=v["draft"],
        block_coefficient=v["block_coefficient"]
        * (v["beam"] / (2.0 * beam) if hulls == 2 else 1.0),
        water_density=v["water_density"],
        x_G=v["x_G"],
        hulls=hulls,
        spacing=v.get("spacing", 0.0),
    )


def _periods(vessel: Vessel) -> dict[str, float]:
    """Return the periods of the modes at rest with the most energy in heave, roll and pitch."""
    v = vessel.values
    places = [fr.Z, fr.PHI, fr.THETA]
    rows = [*places, fr.U, fr.V, fr.W, fr.P, fr.Q, fr.R]
    values, vectors = np.linalg.eig(jacobian(vessel, state_at(vessel, 0.0, 0.0), rows))
    weight = v["mass"] * GRAVITY
    stiffness = (v["water_density"] * GRAVITY * v["A_wp"], weight * v["GM_T"], weight * v["GM_L"])
    energy = np.abs(vectors[:3]) ** 2 * np.array(stiffness)[:, None]
    swings = values.imag > 1e-6 * np.abs(values)
    share = np.where(swings, energy / np.maximum(energy.sum(axis=0), 1e-300), 0.0)
    periods = {}
    for name, shares in zip(("heave", "roll", "pitch"), share, strict=True):
        at = int(np.argmax(shares))
        periods[name] = 2.0 * math.pi / float(abs(values[at])) if shares[at] > 0.3 else math.nan
    return periods


def _turn(vessel: Vessel, periods: list[float]) -> dict[str, float]:
    """Simulate a turning circle to starboard in calm water."""
    v = vessel.values
    n, L = v["shaft_speed_manoeuvring"], v["length_waterline"]
    speed = vessel.straight_speed(n)
    dt = min(
        0.02 * L / speed,
        v["shaft_lag"],
        v.get("steer_lag", math.inf),
        *(0.05 * period for period in periods),
    )
    state, cmd = state_at(vessel, n, speed), vessel.command(n, vessel.helm_max)
    free, calm = ship.Ship(vessel.packed, 6), ship.calm_sea()
    work = np.zeros((ship.WORK_ROWS, fr.STATE_SIZE))
    turn = {"advance_m": math.nan, "tactical_diameter_m": math.nan}
    heel = 0.0
    for k in range(int(120.0 * L / speed / dt)):
        ship.step(state, cmd, free, calm, k * dt, dt, work)
        heading, heel = abs(state[fr.PSI]), max(heel, abs(state[fr.PHI]))
        if not heel < CAPSIZED or heading > 4.0 * math.pi:
            break
        if heading >= 0.5 * math.pi and math.isnan(turn["advance_m"]):
            turn["advance_m"] = float(state[fr.X])
        if heading >= math.pi and math.isnan(turn["tactical_diameter_m"]):
            turn["tactical_diameter_m"] = abs(float(state[fr.Y]))
    end = math.hypot(state[fr.U], state[fr.V])
    rate = float(state[fr.R])
    helm = {"helm_deg": math.degrees(vessel.helm_max), "shaft_speed_rps": n}
    if vessel.kind == "thruster_pair":  # it has no helm
        helm = {"left_shaft_rps": float(cmd[0]), "right_shaft_rps": float(cmd[1])}
    return {
        **helm,
        **turn,
        "advance_lengths": turn["advance_m"] / L,
        "tactical_diameter_lengths": turn["tactical_diameter_m"] / L,
        "approach_speed_mps": speed,
        "steady_speed_mps": end,
        "steady_speed_share": end / speed,
        "steady_rate_degps": math.degrees(rate),
        "steady_radius_m": end / abs(rate) if rate != 0.0 else math.inf,
        "largest_heel_deg": math.degrees(heel),
        "drift_angle_deg": math.degrees(math.atan2(-state[fr.V], state[fr.U])),
    }


def _pull(vessel: Vessel, n: float, speed: float = 0.0) -> float:
    """Return the thrust of all units, N."""
    return float(
        propulsion_forces(speed, 0.0, 0.0, state_at(vessel, n, speed), vessel.packed.copy())[0]
    )


def _speeds(vessel: Vessel) -> list[dict[str, float]]:
    """Return speed, Froude number and thrust over the shaft speed."""
    v = vessel.values
    top = v["shaft_speed_max"]
    wanted = {share * top for share in (0.2, 0.4, 0.6, 0.8, 1.0)}
    wanted |= {v["shaft_speed_manoeuvring"], v["shaft_speed_service"]}
    rows = []
    for n in sorted(n for n in wanted if n > 0.0):
        speed = vessel.straight_speed(n)
        rows.append(
            {
                "shaft_speed_rps": n,
                "speed_mps": speed,
                "speed_kn": speed / KNOT,
                "froude": speed / math.sqrt(GRAVITY * v["length_waterline"]),
                "thrust_N": _pull(vessel, n, speed),
            }
        )
    return rows


def inspect(vessel: Vessel) -> Inspection:
    """Return derived particulars of a vessel, and what is wrong or unusual."""
    v, form = vessel.values, form_of(vessel)
    L, B, d, mass = form.length, v["beam"], form.draft, v["mass"]
    plane = v["A_wp"] / (L * B)
    water = reg.hydrostatics(form, v["A_wp"] / (form.hulls * L * form.beam))
    keel = water["KB"] - v["KG"]
    estimates = {f"GM_{axis} by KB + BM - KG m": keel + water[f"BM_{axis}"] for axis in "TL"}
    if vessel.two_hulls and form.hulls == 1:  # how far they are apart is not known
        estimates = {}
    mesh, stated = Hydrostatics.of(hull_of(vessel)), vessel.stated
    height = v["KG"] - d
    GM = mesh.GM(height)
    found = Inspection(vessel.name, vessel.title)
    found.particulars = {
        "mass kg": mass,
        "displacement of the hull kg": form.mass,
        "length / beam": L / B,
        "beam / draft": B / d,
        **({"length / beam of each hull": L / form.beam} if form.hulls == 2 else {}),
        "block coefficient": v["block_coefficient"],
        "water-plane coefficient": plane,
        "KG m": v["KG"],
        "GM_T m": v["GM_T"],
        "GM_L m": v["GM_L"],
        **({"GM_T of the file m": stated["GM_T"]} if stated else {}),
        **({"GM_L of the file m": stated["GM_L"]} if stated else {}),
        "GM_T of the mesh m": GM[0],
        "GM_L of the mesh m": GM[1],
        "centre of buoyancy of the mesh ahead of that of gravity m": mesh.x_B - v["x_G"],
        "trim of the mesh by the stern deg": math.degrees(mesh.trim(v["x_G"], height)),
        **estimates,
        "gyradius in roll / beam": math.sqrt(v["I_xx"] / mass) / B,
        "gyradius in pitch / length": math.sqrt(v["I_yy"] / mass) / L,
        "gyradius in yaw / length": math.sqrt(v["I_zz"] / mass) / L,
        "added mass in surge / mass": v["m_x"] / mass,
        "added mass in sway / mass": v["m_y"] / mass,
        "added inertia in yaw / inertia": v["J_zz"] / v["I_zz"],
        "bollard pull N": _pull(vessel, v["shaft_speed_max"]),
        "bollard pull astern N": -_pull(vessel, -v["shaft_speed_max"]),
    }
    found.periods = _periods(vessel)
    try:
        found.speeds = _speeds(vessel)
        first, second = course_eigenvalues(vessel, v["shaft_speed_service"])
        found.course = {
            "first_real": first.real,
            "first_imag": first.imag,
            "second_real": second.real,
            "second_imag": second.imag,
        }
        found.turn = _turn(vessel, [t for t in found.periods.values() if not math.isnan(t)])
    except VesselError as error:
        found.findings.append(Finding(True, str(error)))
    for rule in (
        _runaway_rules,
        _hull_rules,
        _level_rules,
        _mass_rules,
        _motion_rules,
        _speed_rules,
        _steering_rules,
        _seaway_rules,
    ):
        found.findings += rule(vessel, found)
    found.findings.sort(key=lambda finding: not finding.error)
    return found


Findings = Iterator[Finding]

Range = tuple[str, float, float, float] | tuple[str, float, float, float, str]
"""What it is, value, smallest and largest typical value, and a hint."""


def _outside(*ranges: Range, error: bool = False) -> Findings:
    """Yield a finding for each number outside its typical range."""
    for text, value, low, high, *hint in ranges:
        if not low <= value <= high:
            end = f"; {hint[0]}" if hint else "."
            yield Finding(error, f"{text} is {value:.3g}, typical are {low:g} to {high:g}{end}")


def _hull_rules(vessel: Vessel, found: Inspection) -> Findings:
    v, facts = vessel.values, found.particulars
    L, B, d = v["length_waterline"], v["beam"], v["draft"]
    if not 0.97 < facts["displacement of the hull kg"] / v["mass"] < 1.03:
        yield Finding(
            False,
            f"The mass is {v['mass']:.4g} kg, but block coefficient, length, beam and draft "
            f"displace {facts['displacement of the hull kg']:.4g} kg; both should agree to 3 %.",
        )
    two = vessel.two_hulls
    yield from _outside(
        ("Length over beam", L / B, 1.0 if two else 1.5, 12.0),
        ("Beam over draft", B / d, 1.2, 60.0 if two else 20.0),
    )
    if "hull_beam" in v:  # HULLS of new_vessel
        each = v["hull_beam"]
        yield from _outside(
            ("Length over the beam of each hull", L / each, 3.0, 30.0),
            ("The beam of each hull over draft", each / d, 0.5, 10.0),
        )
    if v["length_waterline"] > v["length_overall"]:
        yield Finding(
            True,
            f"The length at the water line ({L:g} m) is above the length overall "
            f"({v['length_overall']:g} m).",
        )
    plane = facts["water-plane coefficient"]
    if plane > 1.0:
        yield Finding(
            True, f"A_wp is {v['A_wp']:.4g} m2, above length times beam ({L * B:.4g} m2)."
        )
    if plane < 0.9 * v["block_coefficient"]:
        yield Finding(
            True,
            f"The water-plane coefficient is {plane:.3g}, below the block coefficient of "
            f"{v['block_coefficient']:.3g}: the hull would widen downwards.",
        )
    origin = "are both measured from the same origin?"
    yield from _outside(
        ("x_G over the length", v["x_G"] / L, -0.15, 0.15, "it is measured from midship."),
        ("x_F - x_G over the length", (v["x_F"] - v["x_G"]) / L, -0.15, 0.15, origin),
        ("KG over draft", v["KG"] / d, 0.4, 10.0 if two else 3.0),
        ("GM_T over beam", v["GM_T"] / B, 0.02, 12.0 if two else 1.0),
    )
    if "GM_T by KB + BM - KG m" in facts:
        for key in ("GM_T", "GM_L"):
            guess = facts[f"{key} by KB + BM - KG m"]
            text = f"{key} ({v[key]:.3g} m) over KB + BM - KG of the water plane ({guess:.3g} m)"
            yield from _outside((text, v[key] / guess if guess > 0.0 else math.inf, 0.5, 2.0))


def _level_rules(vessel: Vessel, found: Inspection) -> Findings:
    trim = found.particulars["trim of the mesh by the stern deg"]
    apart = found.particulars["centre of buoyancy of the mesh ahead of that of gravity m"]
    if abs(trim) > LEVEL:
        yield Finding(
            False,
            f"The mesh does not float level: it trims {abs(trim):.2g} degrees by the "
            f"{'stern' if trim > 0.0 else 'bow'}, as its centre of buoyancy lies "
            f"{abs(apart):.3g} m {'ahead' if apart > 0.0 else 'aft'} of x_G.",
        )


def _mass_rules(vessel: Vessel, found: Inspection) -> Findings:
    v, facts = vessel.values, found.particulars
    stale = "does it belong to another mass?"
    roll, two = facts["gyradius in roll / beam"], vessel.two_hulls
    yield from _outside(("The gyradius in roll over the beam", roll, 0.3, 0.5, stale))
    for axis, key in (("pitch", "I_yy"), ("yaw", "I_zz")):
        gyradius = math.sqrt(v[key] / v["mass"]) / v["length_overall"]
        text = f"The gyradius in {axis} over the length overall"
        # a catamaran may be as wide as it is long
        wide = 0.4 * v["beam"] / v["length_overall"] if two and axis == "yaw" else 0.0
        yield from _outside(
            (text, gyradius, 0.2, math.hypot(0.3, wide), stale),
            error=not 0.1 < gyradius < math.hypot(0.6, wide),
        )
    if v["I_zz"] < 0.8 * max(v["I_xx"], v["I_yy"]):
        yield Finding(
            False,
            f"I_zz is {v['I_zz']:.3g} kg m2, less than I_xx or I_yy; a ship turns slowest in yaw.",
        )
    for name, key, of, low, high in (
        ("surge", "m_x", "mass", 0.01, 0.3),
        ("sway", "m_y", "mass", 0.15, 4.0 if two else 2.0),
        ("heave", "m_z", "mass", 0.2, 8.0),
        ("roll", "J_xx", "I_xx", 0.02, 8.0),
        ("pitch", "J_yy", "I_yy", 0.2, 5.0),
        ("yaw", "J_zz", "I_zz", 0.1, 4.0 if two else 2.5),
    ):
        text = f"The added mass or inertia in {name} ({key}) over {of}"
        yield from _outside((text, v[key] / v[of], low, high))
    if v["m_y"] < v["m_x"]:
        yield Finding(
            False,
            f"m_y ({v['m_y']:.3g} kg) is below m_x ({v['m_x']:.3g} kg): a hull moves more water "
            "sideways than ahead.",
        )


def _motion_rules(vessel: Vessel, found: Inspection) -> Findings:
    v = vessel.values
    form, two = form_of(vessel), vessel.two_hulls
    estimate = reg.periods(form, v["GM_T"])
    for name, period in found.periods.items():
        if math.isnan(period):
            yield Finding(
                False, f"The ship at rest does not oscillate in {name}: it is overdamped."
            )
        elif not two or (name == "heave" and form.hulls == 1):
            text = (
                f"The period of {name} ({period:.3g} s) over that of {estimate.source} "
                f"({estimate[name]:.3g} s)"
            )
            yield from _outside((text, period / estimate[name], 0.6, 1.7))
    for key in ("zeta_heave", "zeta_roll", "zeta_pitch"):
        yield from _outside((key, v[key], 0.02, 0.7))
    rows = [*range(fr.Z, fr.THETA + 1), *range(fr.U, fr.R + 1), *range(fr.N_LEFT, fr.STATE_SIZE)]
    fastest = 0.0
    for row in [{"shaft_speed_rps": 0.0, "speed_mps": 0.0}, *found.speeds[-1:]]:
        state = state_at(vessel, row["shaft_speed_rps"], row["speed_mps"])
        values = np.linalg.eigvals(jacobian(vessel, state, rows))
        lags = [1.0 / v["shaft_lag"], 1.0 / v.get("steer_lag", 1.0)]
        fastest = max(fastest, float(np.max(np.abs(values))), *lags)
    if fastest * DT > RK4_LIMIT:
        yield Finding(
            True,
            f"The stiffest motion ({fastest:.3g} 1/s) is too fast for a step of {DT:g} s; simulate "
            f"with dt_physics = {RK4_LIMIT / fastest:.2g} s or less.",
        )


def _speed_rules(vessel: Vessel, found: Inspection) -> Findings:
    v = vessel.values
    shafts = [v[f"shaft_speed_{name}"] for name in ("manoeuvring", "service", "max")]
    if sorted(shafts) != shafts:
        yield Finding(
            True,
            "The shaft speeds of manoeuvring, service and max are "
            f"{', '.join(f'{n:g}' for n in shafts)} rev/s and must not fall.",
        )
    if v["astern"] == 0.0:
        yield Finding(False, "astern is 0: the ship cannot pull astern.")
    if v["propeller_diameter"] > 1.2 * v["draft"] and vessel.kind == "propeller_rudder":
        yield Finding(
            False,
            f"The propeller ({v['propeller_diameter']:.3g} m) is larger than the draft "
            f"({v['draft']:.3g} m).",
        )
    if not found.speeds:
        return
    top = found.speeds[-1]
    text = f"The Froude number at full shaft speed ({top['speed_kn']:.3g} kn)"
    froude = (text, top["froude"], 0.05, 2.6, "check thrust and resistance.")
    yield from _outside(froude, error=top["froude"] > 5.0)
    weight, pull = v["mass"] * GRAVITY, found.particulars["bollard pull N"]
    resistance = -hull_forces(top["speed_mps"], 0.0, 0.0, vessel.packed.copy())[0]
    yield from _outside(
        ("Resistance at full shaft speed over the weight", resistance / weight, 5e-4, 0.6),
        ("Bollard pull over the weight", pull / weight, 5e-4, 2.0),
    )


def _runaway_rules(vessel: Vessel, found: Inspection) -> Findings:
    try:
        for dof in (3, 6):
            check_motion(vessel, dof, DT)
    except VesselError as error:
        if found.speeds:  # else it is the error of the speeds
            yield Finding(True, str(error))


def _seaway_rules(vessel: Vessel, found: Inspection) -> Findings:
    if found.errors:
        return
    for name in SEAS:
        sea = SeaState.named(name)
        if sea.hs > HIGHEST * vessel.values["length_waterline"]:
            return
        try:
            trial = sail_in_sea(vessel, sea)
        except VesselError:
            return  # the error of the motion says it
        found.seaway[name] = {
            "largest_tilt_deg": math.degrees(trial.tilt),
            "capsized": float(len(trial.capsized)),
        }
        if trial.capsized:
            what = f"In sea state {name} it capsizes within a minute, {trial.where}."
            yield Finding(False, what)
            return


def _steering_rules(vessel: Vessel, found: Inspection) -> Findings:
    if not found.course or not found.turn:
        return
    growth, turn = found.course["first_real"], found.turn
    pair = vessel.kind == "thruster_pair"
    full = "one thruster stopped" if pair else "full helm"
    if growth > 0.0:
        yield Finding(
            False,
            "On a straight course at service speed drift doubles every "
            f"{math.log(2.0) / growth:.3g} s; it should decay (Y_v, N_v, N_r, fins or drives).",
        )
    rate, speed = turn["steady_rate_degps"], turn["steady_speed_share"]
    if not all(math.isfinite(value) for value in (rate, speed)) or speed > 5.0:
        yield Finding(True, "The turning circle diverges: no steady turn is reached.")
    elif turn["largest_heel_deg"] >= math.degrees(CAPSIZED):
        yield Finding(
            True,
            f"{full.capitalize()} at {turn['approach_speed_mps']:.3g} m/s capsizes the ship: GM_T "
            f"({vessel.values['GM_T']:.3g} m) is too small, or KG, z_H and z_P lie too far apart.",
        )
    elif rate < 0.0:
        what = "Thrust on the port side" if pair else "Helm to starboard"
        yield Finding(True, f"{what} turns the ship to port ({rate:.3g} deg/s).")
    elif not turn["steady_radius_m"] < NO_TURN * vessel.values["length_waterline"]:
        yield Finding(True, f"With {full} the ship hardly turns: {rate:.3g} deg/s at the end.")
    else:
        L = vessel.values["length_waterline"]
        radius, drift = turn["steady_radius_m"] / L, turn["drift_angle_deg"]
        widest = 30.0 if vessel.two_hulls and not pair else WIDEST
        hint = (WEAK,) if pair else ()
        if pair:
            yield from _thruster_rules(turn, L)
        yield from _outside(
            ("The steady turning radius in lengths", radius, 0.2, widest, *hint),
            ("The drift angle in the steady turn, degrees,", drift, -10.0, 45.0),
            (f"The heel with {full}, degrees,", turn["largest_heel_deg"], 0.0, 25.0),
            ("The speed in the steady turn over that of the approach", speed, 0.1, 2.5),
        )


def _thruster_rules(turn: dict[str, float], length: float) -> Findings:
    """Yield a finding for a boat that turns slowly with one of its fixed thrusters stopped."""
    pace = math.radians(turn["steady_rate_degps"]) * length / turn["approach_speed_mps"]
    what = (
        f"The yaw rate with one thruster stopped ({turn['steady_rate_degps']:.3g} deg/s) in speeds "
        "of approach over lengths"
    )
    yield from _outside((what, pace, SLOWEST, 5.0, WEAK))
