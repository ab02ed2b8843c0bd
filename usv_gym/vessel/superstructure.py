"""Hull, deck and superstructure of a boat."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from usv_gym.vessel.form import Form
from usv_gym.vessel.hull_lines import HullLines
from usv_gym.vessel.mesh import Mesh, block, loft, mirrored, prism
from usv_gym.vessel.parts import Part

__all__ = ["fixed_parts"]


def fixed_parts(form: Form, lines: HullLines) -> Iterator[Part]:
    """Yield hull, deck and superstructure of a boat."""
    yield Part.fixed("hull", lines.mesh)
    yield Part.fixed("deck", Mesh.joined(_deck(lines)))
    yield Part.fixed("superstructure", Mesh.joined(_superstructure(form, lines)))


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


def _superstructure(form: Form, lines: HullLines) -> list[Mesh]:
    """Return a house whose front and sides lean back; a catamaran has it on a platform."""
    x, _, z = lines.deck()
    L, stern, platform = form.overall, form.stern, []
    if form.pontoon:
        aft, fore, half, height = form.middle - 0.17 * L, form.middle + 0.1 * L, 0.2, 0.055 * L
        deck = float(np.interp(form.middle, x, z))
        base = deck - 0.02 * L
        ends = form.middle - 0.25 * L, form.middle + 0.25 * L
        platform = [prism(deck, base, *ends, 0.5 * (form.beam - form.pontoon), 8.0)]
    elif form.kind == "propeller_rudder":
        aft, fore, half = stern + 0.055 * form.length, stern + 0.135 * form.length, 0.36
        height = min(max(1.2 * form.above, 0.05 * L), 0.075 * L)
        base = float(np.interp(0.5 * (aft + fore), x, z))
    else:
        aft, fore, half = stern + 0.22 * form.length, stern + 0.62 * form.length, 0.29
        height = min(max(1.6 * form.above - form.freeboard, 0.06 * L), 0.13 * L)
        base = float(max(np.interp([aft, fore], x, z)))
    half, long = half * form.beam, fore - aft
    house = block(
        [
            (base + 0.3 * height, aft, fore, half),
            (base, aft, fore, half),
            (base - height, aft + 0.08 * long, fore - 0.25 * long, 0.84 * half),
        ]
    )
    return [*platform, house]
