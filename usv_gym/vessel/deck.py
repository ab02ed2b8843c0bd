"""Hull and deck of a boat."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from usv_gym.vessel.form import Form
from usv_gym.vessel.hull_lines import HullLines
from usv_gym.vessel.mesh import Mesh, loft, mirrored, prism
from usv_gym.vessel.parts import Part

__all__ = ["fixed_parts"]


def fixed_parts(form: Form, lines: HullLines) -> Iterator[Part]:
    """Yield hull and deck of a boat; a catamaran has a platform between its hulls."""
    yield Part.fixed("hull", lines.mesh)
    platform = [_platform(form, lines)] if form.pontoon else []
    yield Part.fixed("deck", Mesh.joined([*_deck(lines), *platform]))


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
