"""First vessel files from main particulars; all other numbers are marked estimates."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass

from usv_gym.design import regressions as reg
from usv_gym.physics import GRAVITY, KNOT
from usv_gym.vessel.schema import KIND_SCHEMA, keys_of
from usv_gym.vessel.vessel import Vessel, course_eigenvalues
from usv_kernel.errors import UsvTwinError

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

SHARES = (0.0, 0.15, 0.3, 0.45, 0.6, 0.75, 0.9, 1.0, 1.15, 1.3)
"""Points of the resistance curve, relative to the service speed."""

CURVE_SOURCE = "ITTC 1957 friction; from Froude number 0.2 the hump of the 7.5 m boat"

STABLE = 0.02
"""Required decay of drift per ship length on a straight course."""


class DesignError(UsvTwinError):
    """Impossible main particulars; the message names the value and the remedy."""


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


@dataclass(frozen=True, kw_only=True)
class MainParticulars:
    """What is known of a ship of one hull before its vessel file is written."""

    name: str  # letters, digits, _ and -
    # at the water line, m
    length: float
    beam: float
    draft: float
    mass: float  # kg
    kind: str = "steerable_drive"  # kind of propulsion
    units: int | None = None  # 1 or 2; default 1 for a propeller with rudder, else 2
    # service speed (m/s) and shaft power of all units (W); default one from the other, or both from
    # a typical Froude number
    speed: float | None = None
    power: float | None = None
    length_overall: float | None = None  # m; default 1.05 length
    water_density: float | None = None  # kg/m3; default 1025, sea water


@dataclass(frozen=True, kw_only=True)
class _Given(MainParticulars):
    """The same without gaps; ``assumed`` names the default values."""

    units: int
    length_overall: float
    water_density: float
    assumed: frozenset[str]


def design(known: MainParticulars) -> Draft:
    """Return a first vessel file for a ship of one hull; DesignError names value and remedy."""
    defaults = {
        "units": 1 if known.kind == "propeller_rudder" else 2,
        "length_overall": 1.05 * known.length,
        "water_density": 1025.0,
    }
    assumed = {key: value for key, value in defaults.items() if getattr(known, key) is None}
    given = _Given(**{**vars(known), **assumed}, assumed=frozenset(assumed))
    form = _check(given)
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


def _check(given: _Given) -> reg.Form:
    """Check the particulars, and return the form of the hull."""
    units = {"length": "m", "beam": "m", "draft": "m", "mass": "kg", "length_overall": "m"}
    units |= {"water_density": "kg/m3", "speed": "m/s", "power": "W"}
    for key, unit in units.items():
        value = getattr(given, key)
        if value is not None and not (math.isfinite(value) and value > 0.0):
            raise DesignError(f"{key} = {value:g} {unit}: must be a finite number above 0")
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]*", given.name):
        raise DesignError(f"name = {given.name!r}: use letters, digits, _ and -")
    if given.kind not in KIND_SCHEMA:
        raise DesignError(f"kind = {given.kind!r}: must be one of {', '.join(KIND_SCHEMA)}")
    if given.units not in (1, 2) or (given.kind == "thruster_pair" and given.units != 2):
        raise DesignError(f"units = {given.units}: must be 1 or 2, and 2 of a thruster_pair")
    box = given.water_density * given.length * given.beam * given.draft
    form = reg.Form(
        length=given.length,
        beam=given.beam,
        draft=given.draft,
        block_coefficient=float(f"{given.mass / box:.5g}"),
        water_density=given.water_density,
    )
    if not 0.2 <= form.block_coefficient <= 0.95:
        raise DesignError(
            f"mass = {given.mass:g} kg: a box of length, beam and draft displaces {box:.4g} kg, "
            f"which makes a block coefficient of {form.block_coefficient:.3g}; one hull has 0.2 to "
            "0.95"
        )
    ratios = form.ratios
    for text, low, high in (("L/B", 1.5, 15.0), ("B/d", 1.2, 20.0)):
        if not low <= ratios[text] <= high:
            raise DesignError(
                f"{text} = {ratios[text]:.3g}: length, beam and draft of one hull make {low:g} to "
                f"{high:g}"
            )
    if given.length_overall < given.length:
        raise DesignError(
            f"length_overall = {given.length_overall:g} m: must not be below the length of "
            f"{given.length:g} m"
        )
    return form


def _source(estimate: reg.Estimate) -> str:
    """Return author and year, with a remark if the hull is out of range."""
    return estimate.source + ("; out of its range" if estimate.notes else "")


def _limited(value: float, low: float, high: float, what: str, notes: list[str]) -> float:
    """Return a value limited to its bounds, and add a note if it was outside."""
    inside = min(max(value, low), high)
    if inside != value:
        notes.append(f"{what} is {value:.3g} by its regression, limited to {inside:.3g}")
    return inside


def _givened(given: _Given, key: str, otherwise: str) -> _Entry:
    """Return the entry of a value, marked as an estimate if it is a default."""
    guess = key in given.assumed
    return _Entry(getattr(given, key), otherwise if guess else "given", guess)


def _particulars(given: _Given, form: reg.Form, notes: list[str]) -> dict[str, _Entry]:
    mass, stated = given.mass, "given"
    I_xx, I_zz = mass * (0.38 * given.beam) ** 2, mass * (0.25 * given.length) ** 2
    surge, added = reg.soding(form), reg.zhou(form)
    notes += [*surge.notes, *added.notes]
    small = form.length / form.beam < 4.5
    m_x = _limited(surge["m_x"] / mass, 0.02, 0.25, "m_x over the mass", notes) * mass
    m_y = _limited(added["m_y"] / mass, 0.3, 1.5, "m_y over the mass", notes) * mass
    J_zz = _limited(added["J_zz"] / I_zz, 0.2, 1.5, "J_zz over I_zz", notes) * I_zz
    return {
        "length_overall": _givened(given, "length_overall", "1.05 of the length"),
        "length_waterline": _Entry(given.length, stated, False),
        "beam": _Entry(given.beam, stated, False),
        "draft": _Entry(given.draft, stated, False),
        "block_coefficient": _Entry(form.block_coefficient, "from mass and dimensions", False),
        "water_density": _givened(given, "water_density", "sea water"),
        "mass": _Entry(mass, stated, False),
        "x_G": _Entry(0.0, "origin at the centre of gravity", False),
        "KG": _Entry((1.5 if small else 0.9) * given.draft, "1.5 of the draft; ships 0.9"),
        "I_xx": _Entry(I_xx, "gyradius 0.38 of the beam"),
        "I_yy": _Entry(I_zz, "gyradius 0.25 of the length"),
        "I_zz": _Entry(I_zz, "gyradius 0.25 of the length"),
        "m_x": _Entry(m_x, _source(surge)),
        "m_y": _Entry(m_y, _source(added)),
        "J_zz": _Entry(J_zz, _source(added)),
    }


def _seakeeping(
    form: reg.Form, particulars: dict[str, _Entry], notes: list[str]
) -> dict[str, _Entry]:
    C_b, d = form.block_coefficient, form.draft
    boat = form.length / form.beam < 4.5
    plane = max((1.0 + 2.0 * C_b) / 3.0, 0.78 if boat else 0.65)
    area = plane * form.length * form.beam
    water = reg.hydrostatics(form, plane)
    notes += water.notes
    KG = particulars["KG"].value
    metacentre = water["KB"] + water["BM_T"]
    # a narrow ship model with less than a tenth capsizes in waves of its size
    least = (0.1 if boat or form.length < 5.0 else 0.05) * form.beam
    if metacentre - KG < least:
        KG = max(metacentre - least, 0.4 * d)
        notes.append(f"KG is lowered to {KG:.3g} m for a GM_T of {least:.3g} m")
        particulars["KG"] = _Entry(KG, "as low as stability requires")
    GM_T = max(metacentre - KG, 0.03 * form.beam)
    GM_L = water["KB"] + water["BM_L"] - KG
    mass = form.mass
    I_xx, I_yy = particulars["I_xx"].value, particulars["I_yy"].value
    jensen = "period of Jensen 2004, 2 pi sqrt(2 d / g)"
    return {
        "A_wp": _Entry(area, f"water-plane coefficient {plane:.2f} (Schneekluth; boats 0.78)"),
        "x_F": _Entry(0.0, "centre of the water plane at that of gravity"),
        "GM_T": _Entry(GM_T, f"KB + BM - KG, {_source(water)}"),
        "GM_L": _Entry(GM_L, f"KB + BM - KG, {_source(water)}"),
        "m_z": _Entry(2.0 * form.water_density * d * area - mass, jensen),
        "J_xx": _Entry(0.2 * I_xx, "0.2 of I_xx, Fossen's Otter"),
        "J_yy": _Entry(max(mass * GM_L * 2.0 * d - I_yy, 0.4 * I_yy), jensen),
        "zeta_heave": _Entry(0.3, "Fossen's Otter"),
        "zeta_roll": _Entry(0.18 if boat else 0.08, "hard chines 0.18, ships 0.08"),
        "zeta_pitch": _Entry(0.35, "Fossen's Otter 0.4, MSS 0.3"),
        "z_H": _Entry(0.5 * d, "half the draft"),
    }


def _resistance(form: reg.Form, speed: float) -> float:
    """Return the resistance in N: friction, and a hump from Froude number 0.2 to 0.7."""
    # ITTC 1957 line with 25 % for form and 0.0004 for roughness on the wetted surface of Denny and
    # Mumford, smaller above Froude number 0.9 by planing; hump of the 7.5 m boat (0.14 of the
    # weight), less for slender hulls
    if speed == 0.0:
        return 0.0
    L, volume = form.length, form.volume
    froude = speed / math.sqrt(GRAVITY * L)
    surface = (1.7 * L * form.draft + volume / form.draft) * min(1.0, 0.9 / froude)
    reynolds = max(speed * L / VISCOSITY, 1e4)
    friction = 1.25 * 0.075 / (math.log10(reynolds) - 2.0) ** 2 + 4e-4
    s = min(max((froude - 0.2) / 0.5, 0.0), 1.0)
    hump = 0.14 * min(max((4.24 * volume ** (1.0 / 3.0) / L) ** 2, 0.1), 1.5)
    weight = form.mass * GRAVITY
    return 0.5 * form.water_density * surface * speed**2 * friction + hump * weight * s**3 * (
        10.0 - 15.0 * s + 6.0 * s * s
    )


def _speed(given: _Given, form: reg.Form, notes: list[str]) -> tuple[float, float]:
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
    given: _Given, form: reg.Form, particulars: dict[str, _Entry], notes: list[str]
) -> dict[str, _Entry]:
    scale = 0.5 * form.water_density * form.length**2 * form.draft
    m_x, m_y = particulars["m_x"].value / scale, particulars["m_y"].value / scale
    estimate = reg.yoshimura(form, m_x, m_y)
    if not estimate.notes and given.kind == "propeller_rudder":
        return {key: _Entry(value, estimate.source) for key, value in estimate.values.items()}
    if given.kind == "propeller_rudder":
        notes += estimate.notes
    linear, drag = reg.kijima(form, m_x), reg.cross_flow(form)
    notes += linear.notes
    keys = ("Y_v", "Y_r", "N_v", "N_r")
    return {
        **{key: _Entry(linear[key], _source(linear)) for key in keys},
        "C_d_crossflow": _Entry(drag["C_d_crossflow"], _source(drag)),
    }


def _propulsion(
    given: _Given, form: reg.Form, service: float, power: float, notes: list[str]
) -> dict[str, _Entry]:
    C_b, d, L = form.block_coefficient, form.draft, form.length
    rudder = given.kind == "propeller_rudder"
    wake = min(max(0.5 * C_b - 0.05, 0.05), 0.4) if rudder else 0.02
    deduction = 0.6 * wake if rudder else 0.03
    inflow = (1.0 - wake) * service
    thrust = _resistance(form, service) / (1.0 - deduction) / given.units
    loaded = math.sqrt(8.0 * thrust / (2.5 * math.pi * form.water_density * inflow**2))
    diameter = max({1: 0.65, 2: 0.5}[given.units] * d, loaded)
    if diameter > d:
        notes.append(f"the propeller needs {diameter:.3g} m, more than the draft of {d:.3g} m")
    k_0, k_1, k_2 = K_T
    a = k_2 - thrust / (form.water_density * diameter**2 * inflow**2)
    J = (-k_1 - math.sqrt(k_1 * k_1 - 4.0 * a * k_0)) / (2.0 * a)
    n = inflow / (J * diameter)
    needed = _resistance(form, service) * service / EFFICIENCY
    reserve = min(max((power / needed) ** (1.0 / 3.0), 1.15), 1.5)
    top = reserve * n
    slow = 0.5 * top if given.kind == "thruster_pair" else 0.8 * n
    aside = {"thruster_pair": 0.35}.get(given.kind, 0.25) if given.units == 2 else 0.0
    fixed = "fixed propeller, pitch over diameter near 1"
    entries = {
        "units": _givened(given, "units", "typical for the kind"),
        "propeller_diameter": _Entry(diameter, "a share of the draft, or by its thrust"),
        "k_0": _Entry(k_0, fixed),
        "k_1": _Entry(k_1, fixed),
        "k_2": _Entry(k_2, fixed),
        "astern": _Entry(0.7, "in reverse: 0.6 to 0.8"),
        "wake_fraction": _Entry(wake, "Taylor, one screw" if rudder else "open drives"),
        "thrust_deduction": _Entry(deduction, "0.6 of the wake" if rudder else "open drives"),
        "y_P": _Entry(aside * form.beam, "thruster pairs 0.35 of the beam, else 0.25; one: 0"),
        "z_P": _Entry(0.7 * d if rudder else d, "behind the hull, or at the keel"),
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


def _wind(given: _Given) -> dict[str, _Entry]:
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


def _vessel(given: _Given, tables: Tables, curve: Curve) -> Vessel:
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
    given: _Given, tables: Tables, curve: Curve, service: float, notes: list[str]
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


def _title(given: _Given) -> str:
    return f"first draft of a {given.length_overall:.3g} m vessel"


def _head(given: _Given, service: float, power: float) -> list[str]:
    return [
        "First draft by usv-twin vessel new: the particulars were given, all else is estimated for",
        "one hull. Replace estimates by better values, and run usv-twin vessel check.",
        f"{service / KNOT:.3g} kn in service, about {power / 1e3:.3g} kW; origin at the centre of "
        "gravity.",
        "Each number: value, unit, source; guess = true marks estimates.",
    ]


def _round(value: float) -> float:
    return float(f"{value:.5g}")


def _toml(given: _Given, head: list[str], tables: Tables, curve: Curve) -> str:
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
