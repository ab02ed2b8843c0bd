"""Main particulars of a vessel that is to be designed, with their defaults and bounds."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from usv_gym.design import regressions as reg
from usv_gym.vessel.schema import KIND_SCHEMA
from usv_kernel.errors import UsvTwinError

__all__ = [
    "DesignError",
    "Given",
    "MainParticulars",
    "completed",
    "form_of",
]

HULLS = {
    1: {"L/B": (1.5, 15.0), "B/d": (1.2, 20.0), "C_b": (0.2, 0.95)},
    2: {"L/B": (3.0, 30.0), "B/d": (0.5, 10.0), "C_b": (0.1, 0.95)},
}
"""Bounds of one hull, and of each of two: those of Insel and Molland 1992 (L/B 7 to 15, B/d 1.5 to
2.5, block coefficient 0.4), widened for small USVs with skegs or inflated hulls."""


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
    # service speed (m/s) and shaft power of all units (W); default one from the other, or both from
    # a typical Froude number
    speed: float | None = None
    power: float | None = None
    length_overall: float | None = None  # m; default 1.05 length
    water_density: float | None = None  # kg/m3; default 1025, sea water
    hulls: int = 1  # 2 of a catamaran
    # of a catamaran, m: beam of each hull at the water line, and distance of their centre lines;
    # default of the latter: beam less hull_beam
    hull_beam: float | None = None
    spacing: float | None = None


@dataclass(frozen=True, kw_only=True)
class Given(MainParticulars):
    """The same without gaps; ``assumed`` names the default values."""

    units: int
    length_overall: float
    water_density: float
    hull_beam: float
    spacing: float
    assumed: frozenset[str]


def completed(known: MainParticulars) -> Given:
    """Return particulars without gaps."""
    defaults = {
        "units": 1 if known.kind == "propeller_rudder" else 2,
        "length_overall": 1.05 * known.length,
        "water_density": 1025.0,
        **_hull_defaults(known),
    }
    assumed = {key: value for key, value in defaults.items() if getattr(known, key) is None}
    return Given(**{**vars(known), **assumed}, assumed=frozenset(assumed))


def _hull_defaults(known: MainParticulars) -> dict[str, float]:
    """Return beam and spacing of the hulls where they are not given."""
    if known.hulls not in (1, 2):
        raise DesignError(f"hulls = {known.hulls}: must be 1, or 2 of a catamaran")
    if known.hulls == 1:
        for key in ("hull_beam", "spacing"):
            if getattr(known, key) is not None:
                raise DesignError(f"{key}: is of a catamaran only; add hulls = 2 (--hulls 2)")
        return {"hull_beam": known.beam, "spacing": 0.0}
    if known.hull_beam is None:
        raise DesignError(
            "hull_beam is missing: give the beam of each hull of the catamaran at the water line "
            "(--hull-beam)"
        )
    return {"spacing": known.beam - known.hull_beam}


def form_of(given: Given) -> reg.Form:
    """Check the particulars, and return the form of the hull, or of each hull."""
    units = {"length": "m", "beam": "m", "draft": "m", "mass": "kg", "length_overall": "m"}
    if given.hulls == 2:
        units |= {"hull_beam": "m", "spacing": "m"}
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
    if given.hulls == 2 and not (
        given.hull_beam < given.spacing and given.spacing + given.hull_beam <= 1.001 * given.beam
    ):
        raise DesignError(
            f"hull_beam = {given.hull_beam:g} m, spacing = {given.spacing:g} m: the hulls must not "
            f"touch, and must lie within the beam of {given.beam:g} m"
        )
    box = given.hulls * given.water_density * given.length * given.hull_beam * given.draft
    form = reg.Form(
        length=given.length,
        beam=given.hull_beam,
        draft=given.draft,
        block_coefficient=float(f"{given.mass / box:.5g}"),
        water_density=given.water_density,
        hulls=given.hulls,
        spacing=given.spacing,
    )
    hulls, ratios = HULLS[given.hulls], form.ratios
    two = "" if given.hulls == 2 else "; a catamaran has --hulls 2 --hull-beam M --spacing M"
    what = "one hull" if given.hulls == 1 else "each hull of a catamaran"
    low, high = hulls["C_b"]
    if not low <= form.block_coefficient <= high:
        raise DesignError(
            f"mass = {given.mass:g} kg: a box of length, beam and draft displaces {box:.4g} kg, "
            f"which makes a block coefficient of {form.block_coefficient:.3g}; {what} has {low:g} "
            f"to {high:g}{two}"
        )
    for text in ("L/B", "B/d"):
        low, high = hulls[text]
        if not low <= ratios[text] <= high:
            raise DesignError(
                f"{text} = {ratios[text]:.3g}: length, beam and draft of {what} make {low:g} to "
                f"{high:g}{two}"
            )
    if given.length_overall < given.length:
        raise DesignError(
            f"length_overall = {given.length_overall:g} m: must not be below the length of "
            f"{given.length:g} m"
        )
    return form
