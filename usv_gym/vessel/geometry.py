"""Geometric model of a boat, drawn from its main particulars.

Source: Qu et al. 2025, section 2.2.5.
"""

from __future__ import annotations

from usv_gym.vessel.deck import fixed_parts
from usv_gym.vessel.drives import propulsion_parts
from usv_gym.vessel.form import Form
from usv_gym.vessel.hull_lines import HullLines
from usv_gym.vessel.mesh import Mesh
from usv_gym.vessel.parts import COLOURS, Boat, Part
from usv_gym.vessel.vessel import Vessel

__all__ = ["COLOURS", "Boat", "Form", "Mesh", "Part", "boat_of", "hull_of"]


def boat_of(source: Vessel | Form) -> Boat:
    """Return the geometric model of a vessel, or of a boat with a few known particulars.

    The hull has the displacement of the particulars, and the water-plane area of a vessel. Drives,
    rudders and propellers are separate parts that turn.
    """
    form = Form.of(source) if isinstance(source, Vessel) else source
    return Boat((*fixed_parts(form, HullLines(form)), *propulsion_parts(form)))


def hull_of(vessel: Vessel) -> Mesh:
    """Return the surface of a vessel that floats."""
    return HullLines(Form.of(vessel)).mesh
