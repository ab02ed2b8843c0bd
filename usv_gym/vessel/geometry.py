"""Geometric model of a boat, drawn from its main particulars.

Source: Qu et al. 2025, section 2.2.5.
"""

from __future__ import annotations

import numpy as np

from usv_gym.vessel.drives import propulsion_parts
from usv_gym.vessel.form import Form
from usv_gym.vessel.hull_lines import HullLines
from usv_gym.vessel.mesh import Mesh, loft, mirrored, prism
from usv_gym.vessel.parts import COLOURS, Boat, Part
from usv_gym.vessel.vessel import Vessel

__all__ = ["COLOURS", "Boat", "Form", "Mesh", "Part", "boat_of", "hull_of"]


def boat_of(source: Vessel | Form) -> Boat:
    """Return the geometric model of a vessel, or of a boat with a few known particulars.

    The hull has the displacement of the particulars, and the water-plane area of a vessel; a
    catamaran has a platform between its hulls. Drives, rudders and propellers are separate parts
    that turn.
    """
    form = Form.of(source) if isinstance(source, Vessel) else source
    lines = HullLines(form)
    platform = [_platform(form, lines)] if form.pontoon else []
    deck = Part.fixed("deck", Mesh.joined([*_deck(lines), *platform]))
    return Boat((Part.fixed("hull", lines.mesh), deck, *propulsion_parts(form)))


def hull_of(vessel: Vessel) -> Mesh:
    """Return the surface of a vessel that floats."""
    return HullLines(Form.of(vessel)).mesh


def _deck(lines: HullLines) -> list[Mesh]:
    """Return the deck, a thin body in the top of each hull."""
    x, y, z = lines.deck()
    thick, inner = 0.006 * lines.beam, 0.93 * y
    rim, crown = z - 0.05 * (y - inner), z - 0.05 * y
    corners = [
        (x, inner, rim - thick),
        (x, 0.0 * y, crown + thick),
        (x, -inner, rim - thick),
        (x, 0.0 * y, crown - thick),
    ]
    ring = np.stack([np.stack(corner, axis=-1) for corner in corners], axis=1)
    inside = (lines.params > 0.012) & (lines.params < 0.985)
    planks = loft(ring[inside]).moved([0.0, lines.offset, 0.0])
    return [planks, mirrored(planks)] if lines.offset else [planks]


def _platform(form: Form, lines: HullLines) -> Mesh:
    """Return what joins the hulls of a catamaran."""
    x, _, z = lines.deck()
    base = float(np.interp(form.middle, x, z)) - 0.02 * form.overall
    aft, fore = form.middle - 0.25 * form.overall, form.middle + 0.25 * form.overall
    half = 0.5 * (form.beam - form.pontoon)
    return prism(base + 0.02 * form.overall, base, aft, fore, half, 8.0)
