"""First vessel files from main particulars; all other numbers are marked estimates."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field

from usv_gym.design import regressions as reg
from usv_gym.physics import GRAVITY, KNOT
from usv_gym.vessel.schema import KIND_SCHEMA, SCHEMA, keys_of
from usv_gym.vessel.vessel import Vessel, course_eigenvalues
from usv_kernel.errors import UsvTwinError

__all__ = [
    "DesignError",
    "Draft",
    "MainParticulars",
    "design",
]

HULLS = {
    1: {"L/B": (1.5, 15.0), "B/d": (1.2, 20.0), "C_b": (0.2, 0.95)},
    2: {"L/B": (3.0, 30.0), "B/d": (0.5, 10.0), "C_b": (0.1, 0.95)},
}
"""Bounds of one hull, and of each of two. The latter are those of Insel and Molland 1992 (L/B 7 to
15, B/d 1.5 to 2.5, block coefficient 0.4). They are widened for small USVs with skegs or inflated
hulls."""

FROUDE = {"propeller_rudder": 0.2, "steerable_drive": 0.5, "thruster_pair": 0.3}
"""Default Froude number of the service speed."""

WATER_DENSITY = 1025.0
"""Sea water, kg/m3."""

EFFICIENCY = 0.5
"""Resistance times speed over shaft power."""

RESERVE = 1.15
"""Most over service shaft speed."""

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


STABILISERS = (
    *((part, 1.0) for part in (1.0, 0.8, 0.6, 0.4, 0.2, 0.0)),
    *((0.0, whole) for whole in (1.5, 2.0, 3.0, 5.0)),
    (-0.5, 5.0),
)
"""Factors of N_v and N_r that are tried in turn for a stable course."""

# fmt: off
KVLCC2 = {
    "C_1": 2.0, "x_P_prime": -0.48, "kappa": 0.5, "l_R_prime": -0.71, "x_H_prime": -0.464,
    "x_R_prime": -0.5,
}
"""Coefficients of a rudder, Yasukawa and Yoshimura 2015."""

KVLCC2_SIDES = {
    "C_2_plus": 1.35, "C_2_minus": 1.35, "gamma_R_plus": 0.52, "gamma_R_minus": 0.52,
}
"""The same, each the mean of two sides."""

BLENDERMANN = {
    "speed boat": {
        "kappa_wind": 1.1, "CD_t": 0.90, "CD_l_bow": 0.55, "CD_l_stern": 0.60, "delta_wind": 0.60,
    },
    "cargo vessel, loaded": {
        "kappa_wind": 1.7, "CD_t": 0.85, "CD_l_bow": 0.65, "CD_l_stern": 0.55, "delta_wind": 0.40,
    },
}
"""Coefficients of wind loads, Blendermann 1994."""
# fmt: on


class DesignError(UsvTwinError):
    """Impossible main particulars; the message names the value and the remedy."""


@dataclass(frozen=True, kw_only=True)
class MainParticulars:
    """What is known of a ship, or of a catamaran, before its vessel file is written."""

    name: str  # letters, digits, _ and -
    # at the water line, m; the beam over all hulls
    length: float
    beam: float
    draft: float
    mass: float  # kg
    kind: str = "steerable_drive"  # kind of propulsion
    units: int | None = None  # 1 or 2; default 1 for a propeller with rudder, else 2
    speed: float | None = None  # in service, m/s; default from a typical Froude number
    hulls: int = 1  # 2 of a catamaran
    # of a catamaran, m: beam of each hull at the water line, and distance of their centre lines;
    # default of the latter: beam less hull_beam
    hull_beam: float | None = None
    spacing: float | None = None


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
    guess: bool


@dataclass
class _Work:
    """A draft at work: what is known without gaps, and the numbers found so far."""

    known: MainParticulars
    form: reg.Form
    """Of the hull, or of each of two."""
    units: int
    service: float = 0.0
    """Service speed, m/s."""
    entries: dict[str, _Entry] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def put(self, key: str, value: float, source: str, guess: bool = True) -> None:
        """Write a number with its source."""
        self.entries[key] = _Entry(value, source, guess)

    def put_given(self, key: str, value: float, default: str = "") -> None:
        """Write a particular; ``default`` is the source of one that was not given."""
        guess = getattr(self.known, key) is None
        self.put(key, value, default if guess else "given", guess)

    def get(self, key: str) -> float:
        """Return a number that was written."""
        return self.entries[key].value

    def limited(self, value: float, low: float, high: float, what: str) -> float:
        """Return a value limited to its bounds, and note it if it was outside."""
        inside = min(max(value, low), high)
        if inside != value:
            self.notes.append(f"{what} is {value:.3g} by its regression, limited to {inside:.3g}")
        return inside


def design(known: MainParticulars) -> Draft:
    """Return a first vessel file for one hull or two; DesignError names value and remedy."""
    work = _complete(known)
    _set_speed(work)
    _particulars(work)
    _seakeeping(work)
    _hull(work)
    _propulsion(work)
    _wind(work)
    vessel = _make_stable(work)
    return Draft(_toml(work), vessel, tuple(dict.fromkeys(work.notes)))


def _complete(known: MainParticulars) -> _Work:
    """Check the particulars, and fill their gaps."""
    two, units = known.hulls == 2, known.units
    if known.hulls not in HULLS:
        raise DesignError(f"hulls = {known.hulls}: must be 1, or 2 of a catamaran")
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]*", known.name):
        raise DesignError(f"name = {known.name!r}: use letters, digits, _ and -")
    if known.kind not in KIND_SCHEMA:
        raise DesignError(f"kind = {known.kind!r}: must be one of {', '.join(KIND_SCHEMA)}")
    if units not in ((None, 2) if known.kind == "thruster_pair" else (None, 1, 2)):
        raise DesignError(f"units = {units}: must be 1 or 2, and 2 of a thruster_pair")
    for key in ("length", "beam", "draft", "mass", "speed", "hull_beam", "spacing"):
        value = getattr(known, key)
        if value is not None and not (math.isfinite(value) and value > 0.0):
            raise DesignError(f"{key} = {value:g}: must be a finite number above 0")
    hull_beam, spacing = known.beam, 0.0
    if two:
        hull_beam, spacing = _hulls_of(known)
    elif (known.hull_beam, known.spacing) != (None, None):
        raise DesignError(
            "hull_beam and spacing: are of a catamaran only; add hulls = 2 (--hulls 2)"
        )
    box = known.hulls * WATER_DENSITY * known.length * hull_beam * known.draft
    form = reg.Form(
        length=known.length,
        beam=hull_beam,
        draft=known.draft,
        block_coefficient=float(f"{known.mass / box:.5g}"),
        water_density=WATER_DENSITY,
        hulls=known.hulls,
        spacing=spacing,
    )
    for key, (low, high) in HULLS[known.hulls].items():
        ratio = form.ratios[key]
        if not low <= ratio <= high:
            made = (
                f"mass = {known.mass:g} kg: a box of length, beam and draft displaces {box:.4g} kg,"
                f" which makes a block coefficient of {ratio:.3g}"
                if key == "C_b"
                else f"{key} = {ratio:.3g}, of length, beam and draft"
            )
            what = "each hull of a catamaran has" if two else "one hull has"
            hint = "" if two else "; a catamaran has --hulls 2 --hull-beam M --spacing M"
            raise DesignError(f"{made}; {what} {low:g} to {high:g}{hint}")
    if units is None:
        units = 1 if known.kind == "propeller_rudder" else 2
    return _Work(known, form, units)


def _hulls_of(known: MainParticulars) -> tuple[float, float]:
    """Return beam and spacing of a catamaran's hulls, m."""
    if known.hull_beam is None:
        raise DesignError(
            "hull_beam is missing: give the beam of each hull of the catamaran at the water line "
            "(--hull-beam)"
        )
    spacing = known.beam - known.hull_beam if known.spacing is None else known.spacing
    if not known.hull_beam < spacing <= 1.001 * known.beam - known.hull_beam:
        raise DesignError(
            f"hull_beam = {known.hull_beam:g} m, spacing = {spacing:g} m: the hulls must not "
            f"touch, and must lie within the beam of {known.beam:g} m"
        )
    return known.hull_beam, spacing


def _source(estimate: reg.Estimate) -> str:
    """Return author and year, with a remark if the hull is out of range."""
    return estimate.source + ("; out of its range" if estimate.notes else "")


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


def _set_speed(work: _Work) -> None:
    """Set the service speed."""
    unit = math.sqrt(GRAVITY * work.form.length)
    speed = FROUDE[work.known.kind] * unit if work.known.speed is None else work.known.speed
    froude = speed / unit
    if not 0.02 <= froude <= 2.5:
        raise DesignError(
            f"speed = {speed / KNOT:.3g} kn: makes a Froude number of {froude:.3g}; the model "
            "holds from 0.02 to 2.5"
        )
    if froude > 0.6:
        work.notes.append(f"Froude number {froude:.2f}: planing is in the resistance curve only")
    work.service = speed


def _particulars(work: _Work) -> None:
    """Write the table [particulars]."""
    known, form, two = work.known, work.form, work.known.hulls == 2
    mass = known.mass
    I_xx, I_yy = mass * (0.38 * known.beam) ** 2, mass * (0.25 * known.length) ** 2
    # two hulls and a deck are flat and wide: perpendicular axis theorem
    I_zz = I_xx + I_yy if two else I_yy
    surge, added = reg.soding(form), reg.zhou(form)
    work.notes += [*surge.notes, *added.notes]
    small = form.length / form.beam < 4.5
    m_x = work.limited(surge["m_x"] / mass, 0.02, 0.25, "m_x over the mass") * mass
    most = 4.0 if two else 1.5
    m_y = work.limited(added["m_y"] / mass, 0.3, most, "m_y over the mass") * mass
    # in a turn one hull moves ahead and the other astern
    turning = added["J_zz"] + m_x * (0.5 * form.spacing) ** 2
    J_zz = work.limited(turning / I_zz, 0.2, most, "J_zz over I_zz") * I_zz
    work.put("length_overall", 1.05 * known.length, "1.05 of the length")
    work.put("length_waterline", known.length, "given", guess=False)
    for key in ("beam", "draft", "mass"):
        work.put_given(key, getattr(known, key))
    if two:
        work.put_given("hull_beam", form.beam)
        work.put_given("spacing", form.spacing, "beam less that of a hull")
    block, box = form.block_coefficient, " of the box over both hulls" if two else ""
    share = known.hulls * form.beam / known.beam if two else 1.0
    work.put("block_coefficient", block * share, f"from mass and dimensions{box}", guess=False)
    work.put("water_density", WATER_DENSITY, "sea water")
    work.put("x_G", 0.0, "origin at the centre of gravity", guess=False)
    if two:
        KG = known.draft + 0.1 * known.length
        work.put("KG", KG, "0.1 of the length above water, as the Otter")
    else:
        work.put("KG", (1.5 if small else 0.9) * known.draft, "1.5 of the draft; ships 0.9")
    work.put("I_xx", I_xx, "gyradius 0.38 of the beam")
    work.put("I_yy", I_yy, "gyradius 0.25 of the length")
    work.put("I_zz", I_zz, "I_xx + I_yy, flat and wide" if two else "gyradius 0.25 of the length")
    work.put("m_x", m_x, _source(surge))
    work.put("m_y", m_y, _source(added))
    work.put("J_zz", J_zz, _source(added))


def _seakeeping(work: _Work) -> None:
    """Write the table [seakeeping]; KG is lowered where stability requires it."""
    form, two = work.form, work.form.hulls == 2
    C_b, d, mass = form.block_coefficient, form.draft, form.mass
    boat = form.length / form.beam < 4.5
    plane = max((1.0 + 2.0 * C_b) / 3.0, 0.75 if two else 0.78 if boat else 0.65)
    area = form.hulls * plane * form.length * form.beam
    water = reg.hydrostatics(form, plane)
    work.notes += water.notes
    KG = work.get("KG")
    metacentre = water["KB"] + water["BM_T"]
    # a narrow ship model with less than a tenth capsizes in waves of its size
    least = (0.1 if boat or two or form.length < 5.0 else 0.05) * (form.beam + form.spacing)
    if metacentre - KG < least:
        KG = max(metacentre - least, 0.4 * d)
        work.notes.append(f"KG is lowered to {KG:.3g} m for a GM_T of {least:.3g} m")
        work.put("KG", KG, "as low as stability requires")
    GM_T = max(metacentre - KG, 0.03 * form.beam)  # two hulls have far more
    GM_L = water["KB"] + water["BM_L"] - KG
    I_xx, I_yy = work.get("I_xx"), work.get("I_yy")
    shape = "Schneekluth; Otter 0.75" if two else "Schneekluth; boats 0.78"
    work.put("A_wp", area, f"water-plane coefficient {plane:.2f} ({shape})")
    work.put("x_F", 0.0, "centre of the water plane at that of gravity")
    work.put("GM_T", GM_T, f"KB + BM - KG, {_source(water)}")
    work.put("GM_L", GM_L, f"KB + BM - KG, {_source(water)}")
    if two:  # Jensen's periods are those of ships
        strips = reg.heave_of_two_hulls(form, plane)
        for key in ("m_z", "J_xx", "J_yy"):
            work.put(key, strips[key], _source(strips))
    else:
        jensen = "period of Jensen 2004, 2 pi sqrt(2 d / g)"
        work.put("m_z", 2.0 * form.water_density * d * area - mass, jensen)
        work.put("J_xx", 0.2 * I_xx, "0.2 of I_xx, Fossen's Otter")
        work.put("J_yy", max(mass * GM_L * 2.0 * d - I_yy, 0.4 * I_yy), jensen)
    pitch = reg.pitch_damping(form)
    work.put("zeta_heave", 0.3, "Fossen's Otter")
    if two:
        work.put("zeta_roll", 0.2, "Fossen's Otter")
    else:
        work.put("zeta_roll", 0.18 if boat else 0.08, "hard chines 0.18, ships 0.08")
    work.put("zeta_pitch", pitch["zeta_pitch"], f"radiated waves, {_source(pitch)}")
    work.put("z_H", 0.5 * d, "half the draft")


def _hull(work: _Work) -> None:
    """Write the table [hull]."""
    form = work.form
    scale = 0.5 * form.water_density * form.length**2 * form.draft
    m_x, m_y = work.get("m_x") / scale, work.get("m_y") / scale
    if work.known.kind == "propeller_rudder" and form.hulls == 1:  # that polynomial is of one hull
        whole = reg.yoshimura(form, m_x, m_y)
        if not whole.notes:
            for key, value in whole.values.items():
                work.put(key, value, whole.source)
            return
        work.notes += whole.notes
    linear, drag = reg.kijima(form, m_x), reg.cross_flow(form)
    work.notes += linear.notes
    for key in ("Y_v", "Y_r", "N_v", "N_r"):
        work.put(key, linear[key], _source(linear))
    work.put("C_d_crossflow", drag["C_d_crossflow"], _source(drag))


def _advance_ratio(coefficients: tuple[float, float, float], load: float) -> float:
    """Return the advance ratio J at which K_T / J^2 is a load."""
    k_0, k_1, k_2 = coefficients
    a = k_2 - load
    return (-k_1 - math.sqrt(k_1 * k_1 - 4.0 * a * k_0)) / (2.0 * a)


def _pod_diameter(work: _Work, thrust: float, inflow: float, least: float) -> float:
    """Return the diameter of a catamaran's thrusters, m; ``thrust`` is that of each in service.

    It is smaller where the boat would pull more than :data:`PULL` of its weight at rest.
    """
    density = work.form.water_density
    diameter = max(POD * work.form.beam, least)
    while diameter > least:
        J = _advance_ratio(K_T_POD, thrust / (density * diameter**2 * inflow**2))
        pull = 2.0 * density * K_T_POD[0] * (diameter * inflow / J) ** 2
        if pull <= PULL * work.known.mass * GRAVITY:
            break
        diameter = max(0.95 * diameter, least)
    return diameter


def _propulsion(work: _Work) -> None:
    """Write the table [propulsion]."""
    form, kind, units, service = work.form, work.known.kind, work.units, work.service
    C_b, d, L = form.block_coefficient, form.draft, form.length
    rudder, pair, two = kind == "propeller_rudder", kind == "thruster_pair", form.hulls == 2
    pods = two and pair  # a fixed thruster below each hull of a catamaran
    wake = min(max(0.5 * C_b - 0.05, 0.05), 0.4) if rudder else 0.02
    deduction = 0.6 * wake if rudder else 0.03
    inflow = (1.0 - wake) * service
    thrust = _resistance(form, service) / (1.0 - deduction) / units
    loaded = math.sqrt(8.0 * thrust / (2.5 * math.pi * form.water_density * inflow**2))
    if pods:
        diameter = _pod_diameter(work, thrust, inflow, loaded)
    else:
        diameter = max({1: 0.65, 2: 0.5}[units] * d, loaded)
        if diameter > d:
            text = f"the propeller needs {diameter:.3g} m, more than the draft of {d:.3g} m"
            work.notes.append(text)
    curve = K_T_POD if pods else K_T
    J = _advance_ratio(curve, thrust / (form.water_density * diameter**2 * inflow**2))
    n = inflow / (J * diameter)
    top = RESERVE * n
    lag = min(max(0.25 * math.sqrt(L), 0.1), 5.0)
    work.put_given("units", units, "typical for the kind")
    size = "hull's beam" if pods else "draft"
    work.put("propeller_diameter", diameter, f"a share of the {size}, or by its thrust")
    stopped = ", with the drag of a stopped one" if pods else ""
    for key, value in zip(("k_0", "k_1", "k_2"), curve, strict=True):
        work.put(key, value, f"fixed propeller, pitch over diameter near 1{stopped}")
    work.put("astern", 0.7, "in reverse: 0.6 to 0.8")
    work.put("wake_fraction", wake, "Taylor, one screw" if rudder else "open drives")
    work.put("thrust_deduction", deduction, "0.6 of the wake" if rudder else "open drives")
    if two and units == 2:
        work.put("y_P", 0.5 * form.spacing, "behind each hull")
    else:
        aside = (0.35 if pair else 0.25) if units == 2 else 0.0
        source = "thruster pairs 0.35 of the beam, else 0.25; one: 0"
        work.put("y_P", aside * work.known.beam, source)
    if pods:
        work.put("z_P", max(d, 0.7 * diameter), "below the hulls, under water")
    else:
        work.put("z_P", 0.7 * d if rudder else d, "behind the hull, or at the keel")
    work.put("shaft_lag", lag, "engines of that size")
    work.put("shaft_rate", top / lag, "from the lag")
    work.put("shaft_speed_max", top, f"{RESERVE:.2f} of service")
    work.put("shaft_speed_service", n, f"{service / KNOT:.3g} kn")
    slow = 0.5 * top if pair else 0.8 * n
    work.put("shaft_speed_manoeuvring", slow, "0.8 of service; thruster pair: half of max")
    if pair:
        return
    work.put("steer_lag", min(max(0.04 * math.sqrt(L), 0.1), 1.0), "steering gear of that size")
    rate = math.radians(min(max(41.8 / math.sqrt(L), 2.32), 20.0))
    work.put("steer_rate", rate, "KVLCC2's 2.34 deg/s, to scale")
    work.put("steer_max", math.radians(35.0 if rudder else 30.0), "typical stop")
    if rudder:
        _rudder(work, diameter)
    else:
        work.put("A_R", 0.015 * L * d, "as the 7.5 m boat's leg, over length and draft")
        work.put("f_alpha", 2.2, "low aspect ratio")
        work.put("x_P", -0.45 * L, "at the transom")
        work.put("slipstream", 0.175, "as the 7.5 m boat")


def _rudder(work: _Work, diameter: float) -> None:
    """Write the entries of a rudder behind a propeller of a diameter, m."""
    form = work.form
    estimate = reg.kijima_rudder(form)
    work.notes += estimate.notes
    area = form.length * form.draft / 100.0 * (1.0 + 25.0 * (form.beam / form.length) ** 2)
    area /= work.units
    height = min(max(1.3 * diameter, 0.5 * form.draft), 0.8 * form.draft)
    aspect = height * height / area
    work.put("A_R", area, "DNV's least rudder area")
    work.put("f_alpha", 6.13 * aspect / (aspect + 2.25), "Fujii")
    work.put("rudder_height", height, "1.3 propellers, within the draft")
    for key, low, high in (("a_H", 0.05, 0.45), ("t_R", 0.15, 0.4), ("epsilon", 0.85, 1.25)):
        work.put(key, work.limited(estimate[key], low, high, key), _source(estimate))
    for key, value in KVLCC2.items():
        work.put(key, value, "as KVLCC2, Yasukawa and Yoshimura 2015")
    for key, value in KVLCC2_SIDES.items():
        work.put(key, value, "mean of KVLCC2's two sides")


def _wind(work: _Work) -> None:
    """Write the table [wind]."""
    L = work.get("length_overall")
    height = 0.16 * L if L < 10.0 else 1.6 * (L / 10.0) ** 0.6
    shape = "between the 7.5 m boat and KVLCC2"
    work.put("A_F", 1.2 * work.known.beam * height, shape)
    work.put("A_L", L * height, shape)
    work.put("s_L", 0.0, "lateral centre amidships")
    work.put("s_H", 0.55 * height, shape)
    kind = "speed boat" if L < 30.0 else "cargo vessel, loaded"
    for key, value in BLENDERMANN[kind].items():
        work.put(key, value, f"Blendermann 1994, {kind}")


def _curve(work: _Work) -> dict[str, list[float]]:
    """Return the points of the resistance curve, m/s and N."""
    speeds = [share * work.service for share in SHARES]
    forces = [_resistance(work.form, speed) for speed in speeds]
    return {"speed": list(map(_round, speeds)), "force": list(map(_round, forces))}


def _vessel(work: _Work) -> Vessel:
    """Return the vessel in the file."""
    curve, entries = _curve(work), work.entries.items()
    guesses = [key for key, entry in entries if entry.guess]
    return Vessel(
        name=work.known.name,
        title=_title(work),
        kind=work.known.kind,
        values={key: _round(entry.value) for key, entry in entries},
        resistance_speed=tuple(curve["speed"]),
        resistance_force=tuple(curve["force"]),
        guesses=frozenset(["resistance_speed", "resistance_force", *guesses]),
    )


def _make_stable(work: _Work) -> Vessel:
    """Reduce N_v, then raise N_r, until the ship is course-stable, and return the vessel."""
    N_v, N_r = work.entries["N_v"], work.entries["N_r"]
    limit = -STABLE * work.service / work.known.length
    for part, whole in STABILISERS:
        if (part, whole) != (1.0, 1.0):
            why = "of it: skegs or fins for a stable course"
            work.put("N_v", part * N_v.value, f"{N_v.source}; {part:g} {why}")
            if whole != 1.0:
                work.put("N_r", whole * N_r.value, f"{N_r.source}; {whole:g} {why}")
        vessel = _vessel(work)
        if all(
            course_eigenvalues(vessel, vessel.values[f"shaft_speed_{at}"])[0].real < limit
            for at in ("manoeuvring", "service", "max")
        ):
            break
    if part != 1.0:
        work.notes.append(
            f"hull and drives are course-unstable: N_v is reduced to {part:g} of its regression"
            + (f", N_r raised to {whole:g}" if whole != 1.0 else "")
        )
    return vessel


def _title(work: _Work) -> str:
    return f"first draft of a {work.get('length_overall'):.3g} m vessel"


def _round(value: float) -> float:
    return float(f"{value:.5g}")


def _toml(work: _Work) -> str:
    """Return the text of the vessel file."""
    one = work.form.hulls == 1
    power = _resistance(work.form, work.service) * work.service / EFFICIENCY
    hulls = "one hull" if one else "two hulls that do not disturb each other"
    lines = [
        "# First draft by usv-twin vessel new: the particulars were given, all else is estimated "
        f"for {hulls}.",
        "# Replace estimates by better values, and run usv-twin vessel check.",
        f"# {work.service / KNOT:.3g} kn in service, about {power / 1e3:.3g} kW.",
        "# The origin lies at the centre of gravity.",
        "# Each number: value, unit, source; guess = true marks estimates.",
        "",
        "[vessel]",
        f'name = "{work.known.name}"',
        f'title = "{_title(work)}"',
    ]
    for name in SCHEMA:
        lines += ["", f"[{name}]"]
        if name == "propulsion":
            lines.append(f'kind = "{work.known.kind}"')
        for key, (unit, _) in keys_of(name, work.known.kind).items():
            if key in work.entries:
                entry = work.entries[key]
                lines.append(_line(key, _round(entry.value), unit, entry.source, entry.guess))
        if name == "hull":
            lines += ["", "[hull.resistance]"]
            for key, unit in (("speed", "m/s"), ("force", "N")):
                lines.append(_line(key, _curve(work)[key], unit, CURVE_SOURCE, guess=True))
    return "\n".join(lines) + "\n"


def _line(key: str, value: float | list[float], unit: str, source: str, guess: bool) -> str:
    mark = ", guess = true" if guess else ""
    return f'{key} = {{ value = {value!r}, unit = "{unit}", source = "{source}"{mark} }}'
