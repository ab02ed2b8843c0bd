"""Main particulars from which a boat is drawn, with defaults for what is unknown."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from usv_gym.vessel.vessel import Vessel

__all__ = ["Form"]


@dataclass(frozen=True, kw_only=True)
class Form:
    """Main particulars from which a boat is drawn."""

    # on the water line, m
    length: float
    beam: float
    draft: float
    volume: float  # displaced, m3
    hull_beam: float | None = None  # of each hull of a catamaran, m
    length_overall: float | None = None  # m; default 1.1 length
    # area of the water plane, m2; default from the block coefficient
    waterplane: float | None = None
    # centre of buoyancy, m forward of the origin; default where the lines put it
    buoyancy: float | None = None
    # mean height of hull and deck above the water, m; default from the length
    height: float | None = None
    # steerable_drive, propeller_rudder or thruster_pair, as in a vessel file
    kind: str = "steerable_drive"
    units: int = 2  # propellers, 1 or 2
    diameter: float | None = None  # of a propeller, m; default 0.7 draft
    # position of drives or rudders, m: forward of the origin, off the centre line, and depth of the
    # shaft; default from the particulars
    arm: float | None = None
    aside: float | None = None
    depth: float | None = None
    # position of a propeller ahead of a rudder, m forward of the origin
    propeller: float | None = None
    # height and area of a rudder, m and m2; default from the draft
    blade: tuple[float, float] | None = None

    @classmethod
    def of(cls, vessel: Vessel) -> Form:
        """Return the form of a vessel."""
        v = vessel.values
        length, kind = v["length_waterline"], vessel.kind
        rudder = kind == "propeller_rudder"
        return cls(
            length=length,
            beam=v["beam"],
            draft=v["draft"],
            volume=v["block_coefficient"] * length * v["beam"] * v["draft"],
            hull_beam=v.get("hull_beam"),
            length_overall=v["length_overall"],
            waterplane=v["A_wp"],
            buoyancy=v["x_G"],
            height=v["A_L"] / v["length_overall"],
            kind=kind,
            units=int(v["units"]),
            diameter=v["propeller_diameter"],
            arm=v["x_R_prime"] * length if rudder else v.get("x_P"),
            aside=v["y_P"],
            depth=v["z_P"],
            propeller=v["x_P_prime"] * length if rudder else None,
            blade=(v["rudder_height"], v["A_R"]) if rudder else None,
        )

    @property
    def block(self) -> float:
        """Block coefficient."""
        return self.volume / (self.length * self.beam * self.draft)

    @cached_property
    def propeller_diameter(self) -> float:
        """Propeller diameter, m."""
        return 0.7 * self.draft if self.diameter is None else self.diameter

    @cached_property
    def propeller_offset(self) -> float:
        """Distance of the propellers from the centre line, m."""
        if self.units == 1:
            return 0.0
        share = 0.36 if self.kind == "thruster_pair" else 0.22
        return share * self.beam if self.aside is None else self.aside

    @cached_property
    def overall(self) -> float:
        """Length overall, m; at least that of the water line."""
        return max(self.length_overall or 1.1 * self.length, self.length)

    @cached_property
    def middle(self) -> float:
        """Middle of the water line, m forward of the origin."""
        if self.kind != "steerable_drive" or self.arm is None:
            return 0.0
        # the transom ends just ahead of steerable drives
        shift = self.arm + 1.08 * self.propeller_diameter + 0.5 * self.length
        return min(max(shift, -0.2 * self.length), 0.2 * self.length)

    @cached_property
    def stern(self) -> float:
        """Aft end of the water line, m forward of the origin."""
        return self.middle - 0.5 * self.length

    @cached_property
    def above(self) -> float:
        """Mean height of hull and deck above the water, m."""
        if self.height is not None:
            return self.height
        L = self.overall
        return 0.16 * L if L < 10.0 else 1.6 * (L / 10.0) ** 0.6

    @cached_property
    def freeboard(self) -> float:
        """Height of the deck amidships above the water, m."""
        return min(max(0.65 * self.above, 0.02 * self.length), 0.15 * self.length)

    @cached_property
    def pontoon(self) -> float:
        """Beam of each hull of a catamaran, m; 0 for a single hull."""
        if self.hull_beam is not None:
            return self.hull_beam
        # a catamaran: thrusters wide apart and a small block coefficient
        if (
            self.kind != "thruster_pair"
            or self.propeller_offset <= 0.25 * self.beam
            or self.block > 0.4
        ):
            return 0.0
        least = max(self.block * self.beam / 1.6, 0.05 * self.beam)
        return min(max(self.beam - 2.0 * self.propeller_offset, least), 0.45 * self.beam)
