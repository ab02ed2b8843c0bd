"""First vessel files from main particulars; all other numbers are marked estimates."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from usv_gym.design import regressions as reg
from usv_gym.design.main_particulars import (
    DesignError,
    Given,
    MainParticulars,
    completed,
    form_of,
)
from usv_gym.physics import GRAVITY, KNOT
from usv_gym.vessel.schema import keys_of
from usv_gym.vessel.vessel import Vessel, course_eigenvalues

__all__ = [
    "DesignError",
    "Draft",
    "MainParticulars",
    "design",
]

FROUDE = {"propeller_rudder": 0.2, "steerable_drive": 0.5, "thruster_pair": 0.3}
"""Default Froude number of the service speed."""

EFFICIENCY = 0.5
"""Resistance times speed over shaft power."""

VISCOSITY = 1.19e-6
"""Kinematic viscosity of sea water at 15 degrees, m2/s."""

K_T = (0.45, -0.35, -0.05)
"""Thrust coefficients of a fixed propeller of pitch over diameter near 1."""

K_T_POD = (0.45, -0.12, -0.26)
"""The same of a fixed thruster that may stand still while the boat moves on.

Pull at rest, and the advance ratio 1.1 without thrust, are those of :data:`K_T`. ``k_2`` is the
drag of a stopped propeller: 1.2 of the dynamic pressure on blades that fill 0.55 of the disk
(Larsson and Eliasson, Principles of Yacht Design).
"""

POD = 0.8
"""Diameter of a catamaran's thruster over the beam of its hull, as the Otter's.

It hangs below the hull, so the draft does not limit it. Drafts of Otter, BlueBoat and WAM-V 16 then
pull 5 to 8 times their resistance at full speed at rest; the published pulls are 4 to 11 times it.
"""

PULL = 0.75
"""Most that they pull at rest over the weight, at service shaft speed. A BlueBoat's pull as much at
full speed."""

SHARES = (0.0, 0.15, 0.3, 0.45, 0.6, 0.75, 0.9, 1.0, 1.15, 1.3)
"""Points of the resistance curve, relative to the service speed."""

CURVE_SOURCE = "ITTC 1957 friction; from Froude number 0.2 the hump of the 7.5 m boat"

STABLE = 0.02
"""Required decay of drift per ship length on a straight course."""


@dataclass(frozen=True)
class Draft:
    """A first vessel file: its TOML, its vessel, and notes on values out of range or limited."""

    text: str
    vessel: Vessel
    notes: tuple[str, ...]


@dataclass(frozen=True)
class _Entry:
    """A number of the file in SI units, with its source."""

    value: float
    source: str
    guess: bool = True


Tables = dict[str, dict[str, _Entry]]

Curve = dict[str, list[float]]


def design(known: MainParticulars) -> Draft:
    """Return a first vessel file for one hull or two; DesignError names value and remedy."""
    given = completed(known)
    form = form_of(given)
    notes: list[str] = []
    service, power = _speed(given, form, notes)
    particulars = _particulars(given, form, notes)
    tables = {
        "particulars": particulars,
        "seakeeping": _seakeeping(form, particulars, notes),
        "hull": _hull(given, form, particulars, notes),
        "propulsion": _propulsion(given, form, service, power, notes),
        "wind": _wind(given),
    }
    curve = _curve(form, service)
    vessel = _make_stable(given, tables, curve, service, notes)
    head = _head(given, service, power)
    return Draft(_toml(given, head, tables, curve), vessel, tuple(dict.fromkeys(notes)))


def _source(estimate: reg.Estimate) -> str:
    """Return author and year, with a remark if the hull is out of range."""
    return estimate.source + ("; out of its range" if estimate.notes else "")


def _limited(value: float, low: float, high: float, what: str, notes: list[str]) -> float:
    """Return a value limited to its bounds, and add a note if it was outside."""
    inside = min(max(value, low), high)
    if inside != value:
        notes.append(f"{what} is {value:.3g} by its regression, limited to {inside:.3g}")
    return inside


def _givened(given: Given, key: str, otherwise: str) -> _Entry:
    """Return the entry of a value, marked as an estimate if it is a default."""
    guess = key in given.assumed
    return _Entry(getattr(given, key), otherwise if guess else "given", guess)


def _particulars(given: Given, form: reg.Form, notes: list[str]) -> dict[str, _Entry]:
    mass, stated, two = given.mass, "given", given.hulls == 2
    I_xx, I_yy = mass * (0.38 * given.beam) ** 2, mass * (0.25 * given.length) ** 2
    # two hulls and a deck are flat and wide: perpendicular axis theorem
    I_zz = I_xx + I_yy if two else I_yy
    surge, added = reg.soding(form), reg.zhou(form)
    notes += [*surge.notes, *added.notes]
    small = form.length / form.beam < 4.5
    m_x = _limited(surge["m_x"] / mass, 0.02, 0.25, "m_x over the mass", notes) * mass
    most = 4.0 if two else 1.5
    m_y = _limited(added["m_y"] / mass, 0.3, most, "m_y over the mass", notes) * mass
    # in a turn one hull moves ahead and the other astern
    turning = added["J_zz"] + m_x * (0.5 * form.spacing) ** 2
    J_zz = _limited(turning / I_zz, 0.2, most, "J_zz over I_zz", notes) * I_zz
    KG = _Entry((1.5 if small else 0.9) * given.draft, "1.5 of the draft; ships 0.9")
    if two:
        KG = _Entry(given.draft + 0.1 * given.length, "0.1 of the length above water, as the Otter")
    return {
        "length_overall": _givened(given, "length_overall", "1.05 of the length"),
        "length_waterline": _Entry(given.length, stated, False),
        "beam": _Entry(given.beam, stated, False),
        "draft": _Entry(given.draft, stated, False),
        **(_hulls_of(given) if two else {}),
        "block_coefficient": _Entry(
            form.block_coefficient * (given.hulls * given.hull_beam / given.beam if two else 1.0),
            "from mass and dimensions" + (" of the box over both hulls" if two else ""),
            False,
        ),
        "water_density": _givened(given, "water_density", "sea water"),
        "mass": _Entry(mass, stated, False),
        "x_G": _Entry(0.0, "origin at the centre of gravity", False),
        "KG": KG,
        "I_xx": _Entry(I_xx, "gyradius 0.38 of the beam"),
        "I_yy": _Entry(I_yy, "gyradius 0.25 of the length"),
        "I_zz": _Entry(
            I_zz, "I_xx + I_yy, flat and wide" if two else "gyradius 0.25 of the length"
        ),
        "m_x": _Entry(m_x, _source(surge)),
        "m_y": _Entry(m_y, _source(added)),
        "J_zz": _Entry(J_zz, _source(added)),
    }


def _hulls_of(given: Given) -> dict[str, _Entry]:
    """Return the entries that make a vessel a catamaran."""
    spacing = _givened(given, "spacing", "beam less that of a hull")
    return {"hull_beam": _Entry(given.hull_beam, "given", False), "spacing": spacing}


def _seakeeping(
    form: reg.Form, particulars: dict[str, _Entry], notes: list[str]
) -> dict[str, _Entry]:
    C_b, d, two = form.block_coefficient, form.draft, form.hulls == 2
    boat = form.length / form.beam < 4.5
    plane = max((1.0 + 2.0 * C_b) / 3.0, 0.75 if two else 0.78 if boat else 0.65)
    area = form.hulls * plane * form.length * form.beam
    water = reg.hydrostatics(form, plane)
    notes += water.notes
    KG = particulars["KG"].value
    metacentre = water["KB"] + water["BM_T"]
    # a narrow ship model with less than a tenth capsizes in waves of its size
    least = (0.1 if boat or two or form.length < 5.0 else 0.05) * (form.beam + form.spacing)
    if metacentre - KG < least:
        KG = max(metacentre - least, 0.4 * d)
        notes.append(f"KG is lowered to {KG:.3g} m for a GM_T of {least:.3g} m")
        particulars["KG"] = _Entry(KG, "as low as stability requires")
    GM_T = max(metacentre - KG, 0.03 * form.beam)  # two hulls have far more
    GM_L = water["KB"] + water["BM_L"] - KG
    mass = form.mass
    I_xx, I_yy = particulars["I_xx"].value, particulars["I_yy"].value
    jensen = "period of Jensen 2004, 2 pi sqrt(2 d / g)"
    added = {
        "m_z": _Entry(2.0 * form.water_density * d * area - mass, jensen),
        "J_xx": _Entry(0.2 * I_xx, "0.2 of I_xx, Fossen's Otter"),
        "J_yy": _Entry(max(mass * GM_L * 2.0 * d - I_yy, 0.4 * I_yy), jensen),
    }
    if two:  # Jensen's periods are those of ships
        strips = reg.heave_of_two_hulls(form, plane)
        added = {key: _Entry(strips[key], _source(strips)) for key in added}
    shape = "Schneekluth; Otter 0.75" if two else "Schneekluth; boats 0.78"
    pitch = reg.pitch_damping(form)
    roll = _Entry(0.18 if boat else 0.08, "hard chines 0.18, ships 0.08")
    return {
        "A_wp": _Entry(area, f"water-plane coefficient {plane:.2f} ({shape})"),
        "x_F": _Entry(0.0, "centre of the water plane at that of gravity"),
        "GM_T": _Entry(GM_T, f"KB + BM - KG, {_source(water)}"),
        "GM_L": _Entry(GM_L, f"KB + BM - KG, {_source(water)}"),
        **added,
        "zeta_heave": _Entry(0.3, "Fossen's Otter"),
        "zeta_roll": _Entry(0.2, "Fossen's Otter") if two else roll,
        "zeta_pitch": _Entry(pitch["zeta_pitch"], f"radiated waves, {_source(pitch)}"),
        "z_H": _Entry(0.5 * d, "half the draft"),
    }


def _resistance(form: reg.Form, speed: float) -> float:
    """Return the resistance in N: friction, and a hump from Froude number 0.2 to 0.7.

    Two hulls have twice that of one: Insel and Molland 1992 without their interference factors.
    """
    # ITTC 1957 line with 25 % for form and 0.0004 for roughness. Wetted surface of Denny and
    # Mumford, smaller above Froude number 0.9 by planing. Hump of the 7.5 m boat (0.14 of the
    # weight), less for slender hulls
    if speed == 0.0:
        return 0.0
    L, volume = form.length, form.volume / form.hulls
    froude = speed / math.sqrt(GRAVITY * L)
    wetted = form.hulls * (1.7 * L * form.draft + volume / form.draft)
    surface = wetted * min(1.0, 0.9 / froude)
    reynolds = max(speed * L / VISCOSITY, 1e4)
    friction = 1.25 * 0.075 / (math.log10(reynolds) - 2.0) ** 2 + 4e-4
    s = min(max((froude - 0.2) / 0.5, 0.0), 1.0)
    hump = 0.14 * min(max((4.24 * volume ** (1.0 / 3.0) / L) ** 2, 0.1), 1.5)
    weight = form.mass * GRAVITY
    return 0.5 * form.water_density * surface * speed**2 * friction + hump * weight * s**3 * (
        10.0 - 15.0 * s + 6.0 * s * s
    )


def _speed(given: Given, form: reg.Form, notes: list[str]) -> tuple[float, float]:
    """Return service speed (m/s) and shaft power (W)."""
    unit = math.sqrt(GRAVITY * form.length)
    speed = given.speed
    if speed is None and given.power is not None:
        low, high = 0.02 * unit, 2.5 * unit
        for _ in range(60):
            speed = 0.5 * (low + high)
            enough = _resistance(form, speed) * speed <= EFFICIENCY * given.power
            low, high = (speed, high) if enough else (low, speed)
    if speed is None:
        speed = FROUDE[given.kind] * unit
    froude = speed / unit
    if not 0.02 <= froude <= 2.5:
        raise DesignError(
            f"speed = {speed / KNOT:.3g} kn: makes a Froude number of {froude:.3g}; the model "
            "holds from 0.02 to 2.5"
        )
    if froude > 0.6:
        notes.append(f"Froude number {froude:.2f}: planing is in the resistance curve only")
    needed = _resistance(form, speed) * speed / EFFICIENCY
    if given.power is not None and not 0.7 < given.power / needed < 2.0:
        notes.append(
            f"{speed / KNOT:.3g} kn need about {needed / 1e3:.3g} kW, not {given.power / 1e3:.3g}"
        )
    return speed, needed if given.power is None else given.power


def _curve(form: reg.Form, service: float) -> Curve:
    """Return the points of the resistance curve, m/s and N."""
    speeds = [share * service for share in SHARES]
    return {"speed": speeds, "force": [_resistance(form, speed) for speed in speeds]}


def _hull(
    given: Given, form: reg.Form, particulars: dict[str, _Entry], notes: list[str]
) -> dict[str, _Entry]:
    scale = 0.5 * form.water_density * form.length**2 * form.draft
    m_x, m_y = particulars["m_x"].value / scale, particulars["m_y"].value / scale
    estimate = reg.yoshimura(form, m_x, m_y)
    whole = given.kind == "propeller_rudder" and given.hulls == 1  # that polynomial is of one hull
    if not estimate.notes and whole:
        return {key: _Entry(value, estimate.source) for key, value in estimate.values.items()}
    if whole:
        notes += estimate.notes
    linear, drag = reg.kijima(form, m_x), reg.cross_flow(form)
    notes += linear.notes
    keys = ("Y_v", "Y_r", "N_v", "N_r")
    return {
        **{key: _Entry(linear[key], _source(linear)) for key in keys},
        "C_d_crossflow": _Entry(drag["C_d_crossflow"], _source(drag)),
    }


def _has_pods(given: Given) -> bool:
    """Return whether it is a catamaran that steers with a fixed thruster below each hull."""
    return given.hulls == 2 and given.kind == "thruster_pair"


def _advance_ratio(coefficients: tuple[float, float, float], load: float) -> float:
    """Return the advance ratio J at which K_T / J^2 is a load."""
    k_0, k_1, k_2 = coefficients
    a = k_2 - load
    return (-k_1 - math.sqrt(k_1 * k_1 - 4.0 * a * k_0)) / (2.0 * a)


def _pod_diameter(
    given: Given, form: reg.Form, thrust: float, inflow: float, least: float
) -> float:
    """Return the diameter of a catamaran's thrusters, m; ``thrust`` is that of each in service.

    It is smaller where the boat would pull more than :data:`PULL` of its weight at rest.
    """
    diameter = max(POD * given.hull_beam, least)
    while diameter > least:
        load = thrust / (form.water_density * diameter**2 * inflow**2)
        J = _advance_ratio(K_T_POD, load)
        pull = 2.0 * form.water_density * K_T_POD[0] * (diameter * inflow / J) ** 2
        if pull <= PULL * given.mass * GRAVITY:
            break
        diameter = max(0.95 * diameter, least)
    return diameter


def _propulsion(
    given: Given, form: reg.Form, service: float, power: float, notes: list[str]
) -> dict[str, _Entry]:
    C_b, d, L = form.block_coefficient, form.draft, form.length
    rudder = given.kind == "propeller_rudder"
    wake = min(max(0.5 * C_b - 0.05, 0.05), 0.4) if rudder else 0.02
    deduction = 0.6 * wake if rudder else 0.03
    inflow = (1.0 - wake) * service
    thrust = _resistance(form, service) / (1.0 - deduction) / given.units
    loaded = math.sqrt(8.0 * thrust / (2.5 * math.pi * form.water_density * inflow**2))
    pods = _has_pods(given)
    if pods:
        diameter = _pod_diameter(given, form, thrust, inflow, loaded)
    else:
        diameter = max({1: 0.65, 2: 0.5}[given.units] * d, loaded)
    if diameter > d and not pods:
        notes.append(f"the propeller needs {diameter:.3g} m, more than the draft of {d:.3g} m")
    k_0, k_1, k_2 = K_T_POD if pods else K_T
    J = _advance_ratio((k_0, k_1, k_2), thrust / (form.water_density * diameter**2 * inflow**2))
    n = inflow / (J * diameter)
    needed = _resistance(form, service) * service / EFFICIENCY
    reserve = min(max((power / needed) ** (1.0 / 3.0), 1.15), 1.5)
    top = reserve * n
    slow = 0.5 * top if given.kind == "thruster_pair" else 0.8 * n
    aside = {"thruster_pair": 0.35}.get(given.kind, 0.25) if given.units == 2 else 0.0
    across = _Entry(aside * given.beam, "thruster pairs 0.35 of the beam, else 0.25; one: 0")
    if given.hulls == 2 and given.units == 2:
        across = _Entry(0.5 * given.spacing, "behind each hull")
    fixed = "fixed propeller, pitch over diameter near 1"
    deep, size = _Entry(0.7 * d if rudder else d, "behind the hull, or at the keel"), "draft"
    if pods:
        fixed += ", with the drag of a stopped one"
        deep, size = _Entry(max(d, 0.7 * diameter), "below the hulls, under water"), "hull's beam"
    entries = {
        "units": _givened(given, "units", "typical for the kind"),
        "propeller_diameter": _Entry(diameter, f"a share of the {size}, or by its thrust"),
        "k_0": _Entry(k_0, fixed),
        "k_1": _Entry(k_1, fixed),
        "k_2": _Entry(k_2, fixed),
        "astern": _Entry(0.7, "in reverse: 0.6 to 0.8"),
        "wake_fraction": _Entry(wake, "Taylor, one screw" if rudder else "open drives"),
        "thrust_deduction": _Entry(deduction, "0.6 of the wake" if rudder else "open drives"),
        "y_P": across,
        "z_P": deep,
        "shaft_lag": _Entry(min(max(0.25 * math.sqrt(L), 0.1), 5.0), "engines of that size"),
        "shaft_rate": _Entry(top / min(max(0.25 * math.sqrt(L), 0.1), 5.0), "from the lag"),
        "shaft_speed_max": _Entry(top, f"{reserve:.2f} of service"),
        "shaft_speed_service": _Entry(n, f"{service / KNOT:.3g} kn"),
        "shaft_speed_manoeuvring": _Entry(slow, "0.8 of service; thruster pair: half of max"),
    }
    if given.kind == "thruster_pair":
        return entries
    entries |= {
        "steer_lag": _Entry(min(max(0.04 * math.sqrt(L), 0.1), 1.0), "steering gear of that size"),
        "steer_rate": _Entry(
            math.radians(min(max(41.8 / math.sqrt(L), 2.32), 20.0)),
            "KVLCC2's 2.34 deg/s, to scale",
        ),
        "steer_max": _Entry(math.radians(35.0 if rudder else 30.0), "typical stop"),
    }
    if not rudder:
        return entries | {
            "A_R": _Entry(0.015 * L * d, "as the 7.5 m boat's leg, over length and draft"),
            "f_alpha": _Entry(2.2, "low aspect ratio"),
            "x_P": _Entry(-0.45 * L, "at the transom"),
            "slipstream": _Entry(0.175, "as the 7.5 m boat"),
        }
    estimate = reg.kijima_rudder(form)
    notes += estimate.notes
    area = L * d / 100.0 * (1.0 + 25.0 * (form.beam / L) ** 2) / given.units
    height = min(max(1.3 * diameter, 0.5 * d), 0.8 * d)
    aspect = height * height / area
    inside = {
        "a_H": _limited(estimate["a_H"], 0.05, 0.45, "a_H", notes),
        "t_R": _limited(estimate["t_R"], 0.15, 0.4, "t_R", notes),
        "epsilon": _limited(estimate["epsilon"], 0.85, 1.25, "epsilon", notes),
    }
    kvlcc2 = "as KVLCC2, Yasukawa and Yoshimura 2015"
    return entries | {
        "A_R": _Entry(area, "DNV's least rudder area"),
        "f_alpha": _Entry(6.13 * aspect / (aspect + 2.25), "Fujii"),
        "rudder_height": _Entry(height, "1.3 propellers, within the draft"),
        **{key: _Entry(value, _source(estimate)) for key, value in inside.items()},
        "C_1": _Entry(2.0, kvlcc2),
        "C_2_plus": _Entry(1.35, "mean of KVLCC2's two sides"),
        "C_2_minus": _Entry(1.35, "mean of KVLCC2's two sides"),
        "x_P_prime": _Entry(-0.48, kvlcc2),
        "kappa": _Entry(0.5, kvlcc2),
        "l_R_prime": _Entry(-0.71, kvlcc2),
        "gamma_R_plus": _Entry(0.52, "mean of KVLCC2's two sides"),
        "gamma_R_minus": _Entry(0.52, "mean of KVLCC2's two sides"),
        "x_H_prime": _Entry(-0.464, kvlcc2),
        "x_R_prime": _Entry(-0.5, kvlcc2),
    }


def _wind(given: Given) -> dict[str, _Entry]:
    L = given.length_overall
    height = 0.16 * L if L < 10.0 else 1.6 * (L / 10.0) ** 0.6
    boat = L < 30.0
    kappa, side, bow, stern, delta = (
        (1.1, 0.90, 0.55, 0.60, 0.60) if boat else (1.7, 0.85, 0.65, 0.55, 0.40)
    )
    table = f"Blendermann 1994, {'speed boat' if boat else 'cargo vessel, loaded'}"
    shape = "between the 7.5 m boat and KVLCC2"
    return {
        "A_F": _Entry(1.2 * given.beam * height, shape),
        "A_L": _Entry(L * height, shape),
        "s_L": _Entry(0.0, "lateral centre amidships"),
        "s_H": _Entry(0.55 * height, shape),
        "kappa_wind": _Entry(kappa, table),
        "CD_t": _Entry(side, table),
        "CD_l_bow": _Entry(bow, table),
        "CD_l_stern": _Entry(stern, table),
        "delta_wind": _Entry(delta, table),
    }


def _vessel(given: Given, tables: Tables, curve: Curve) -> Vessel:
    """Return the vessel in the file."""
    entries = {key: entry for table in tables.values() for key, entry in table.items()}
    return Vessel(
        name=given.name,
        title=_title(given),
        kind=given.kind,
        values={key: _round(entry.value) for key, entry in entries.items()},
        resistance_speed=tuple(map(_round, curve["speed"])),
        resistance_force=tuple(map(_round, curve["force"])),
        guesses=frozenset(
            ["resistance_speed", "resistance_force"]
            + [key for key, entry in entries.items() if entry.guess]
        ),
    )


def _make_stable(
    given: Given, tables: Tables, curve: Curve, service: float, notes: list[str]
) -> Vessel:
    """Reduce N_v, then raise N_r, until the ship is course-stable, and return the vessel."""
    hull = tables["hull"]
    N_v, N_r = hull["N_v"], hull["N_r"]
    limit = -STABLE * service / given.length
    for part, whole in _steps():
        if (part, whole) != (1.0, 1.0):
            why = f"{N_v.source}; {part:g} of it: skegs or fins for a stable course"
            hull["N_v"] = _Entry(part * N_v.value, why)
            if whole != 1.0:
                why = f"{N_r.source}; {whole:g} of it: skegs or fins for a stable course"
                hull["N_r"] = _Entry(whole * N_r.value, why)
        vessel = _vessel(given, tables, curve)
        if all(
            course_eigenvalues(vessel, vessel.values[f"shaft_speed_{at}"])[0].real < limit
            for at in ("manoeuvring", "service", "max")
        ):
            break
    if part != 1.0:
        notes.append(
            f"hull and drives are course-unstable: N_v is reduced to {part:g} of its regression"
            + (f", N_r raised to {whole:g}" if whole != 1.0 else "")
        )
    return vessel


def _steps() -> Iterator[tuple[float, float]]:
    """Yield factors of N_v and N_r."""
    yield from ((part, 1.0) for part in (1.0, 0.8, 0.6, 0.4, 0.2, 0.0))
    yield from ((0.0, whole) for whole in (1.5, 2.0, 3.0, 5.0))
    yield (-0.5, 5.0)


def _title(given: Given) -> str:
    return f"first draft of a {given.length_overall:.3g} m vessel"


def _head(given: Given, service: float, power: float) -> list[str]:
    hulls = "one hull" if given.hulls == 1 else "two hulls that do not disturb each other"
    return [
        "First draft by usv-twin vessel new: the particulars were given, all else is estimated for",
        f"{hulls}. Replace estimates by better values,",
        "and run usv-twin vessel check.",
        f"{service / KNOT:.3g} kn in service, about {power / 1e3:.3g} kW; origin at the centre of "
        "gravity.",
        "Each number: value, unit, source; guess = true marks estimates.",
    ]


def _round(value: float) -> float:
    return float(f"{value:.5g}")


def _toml(given: Given, head: list[str], tables: Tables, curve: Curve) -> str:
    lines = [f"# {line}" for line in head]
    lines += ["", "[vessel]", f'name = "{given.name}"', f'title = "{_title(given)}"']
    for name, entries in tables.items():
        lines += ["", f"[{name}]"]
        if name == "propulsion":
            lines.append(f'kind = "{given.kind}"')
        for key, about in keys_of(name, given.kind).items():
            if key in entries:
                entry = entries[key]
                lines.append(_line(key, _round(entry.value), about[0], entry.source, entry.guess))
        if name == "hull":
            lines += ["", "[hull.resistance]"]
            for key, unit in (("speed", "m/s"), ("force", "N")):
                lines.append(_line(key, list(map(_round, curve[key])), unit, CURVE_SOURCE, True))
    return "\n".join(lines) + "\n"


def _line(key: str, value: float | list[float], unit: str, source: str, guess: bool) -> str:
    mark = ", guess = true" if guess else ""
    return f'{key} = {{ value = {value!r}, unit = "{unit}", source = "{source}"{mark} }}'
