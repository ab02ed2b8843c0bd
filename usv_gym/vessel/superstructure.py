"""Hull, deck, superstructure, mast and sensors of a boat."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from usv_gym.vessel.form import Form
from usv_gym.vessel.hull_lines import HullLines
from usv_gym.vessel.mesh import Mesh, block, loft, mirrored, prism, revolve, sphere
from usv_gym.vessel.parts import Part

__all__ = ["fixed_parts"]


def fixed_parts(form: Form, lines: HullLines) -> Iterator[Part]:
    """Yield hull, deck and superstructure of a boat."""
    pieces = {"hull": [lines.mesh], "deck": _deck(lines), **_outfit(form, lines)}
    for name, meshes in pieces.items():
        yield Part.fixed(name, Mesh.joined(meshes))


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


def _outfit(form: Form, lines: HullLines) -> dict[str, list[Mesh]]:
    """Return house, windows, mast and sensors; a catamaran has a platform between its hulls."""
    x, _, z = lines.deck()
    L, stern = form.overall, form.stern
    thin, tall = 0.009 * L, 0.16 * L  # radius and height of the mast
    frame: list[Mesh] = []
    platform: list[Mesh] = []
    if form.pontoon:
        aft, fore, half, height = form.middle - 0.17 * L, form.middle + 0.1 * L, 0.2, 0.055 * L
        across = 0.5 * (form.beam - form.pontoon)
        deck = float(np.interp(form.middle, x, z))
        foot = deck - 0.045 * L
        for at in (form.middle - 0.2 * L, form.middle + 0.2 * L):
            frame.append(_bar(at, foot, across, thin))
            frame += [_post(at, side, deck + thin, foot, thin) for side in (-across, across)]
        wide = max(0.75 * across, 0.3 * form.beam)
        ends = (form.middle - 0.25 * L, form.middle + 0.25 * L)
        platform = [prism(foot - 0.3 * thin, foot - 1.8 * thin, *ends, wide, 8.0)]
        base = foot - 1.8 * thin
    elif form.kind == "propeller_rudder":
        aft, fore, half = stern + 0.055 * form.length, stern + 0.135 * form.length, 0.36
        height = min(max(1.2 * form.above, 0.05 * L), 0.075 * L)
        base = float(np.interp(0.5 * (aft + fore), x, z))
        thin, tall = 0.0036 * L, 0.05 * L
    else:
        aft, fore, half = stern + 0.22 * form.length, stern + 0.62 * form.length, 0.29
        height = min(max(1.6 * form.above - form.freeboard, 0.06 * L), 0.13 * L)
        base = float(max(np.interp([aft, fore], x, z)))
    half *= form.beam
    roof, long = base - height, fore - aft

    def level(share: float, out: float = 0.0) -> tuple[float, float, float, float]:
        """Return the house at a share of its height: its front and sides lean back."""
        nose = fore - 0.25 * long * share
        width = half * (1.0 - 0.16 * share)
        return base - share * height, aft + 0.08 * long * share - out, nose + out, width + out

    house = block([(base + 0.3 * height, aft, fore, half), level(0.0), level(0.9), level(1.0)])
    glass = block([level(0.42, 0.004 * L), level(0.8, 0.004 * L)])
    mast_x, top, yard = aft + 0.3 * long, roof - tall, roof - 0.7 * tall
    frame += [
        _post(mast_x, 0.0, roof + thin, top, thin),
        _bar(mast_x, yard, 0.6 * half, 0.7 * thin),
    ]
    sensors = [
        *(sphere(1.9 * thin, [mast_x, y, yard - 2.2 * thin]) for y in (-0.6 * half, 0.6 * half)),
        _post(mast_x, 0.0, top, top - 4.0 * thin, 1.7 * thin),
    ]
    return {
        "superstructure": [*platform, house],
        "windows": [glass],
        "mast": frame,
        "sensors": sensors,
    }


def _post(x: float, y: float, low: float, high: float, radius: float) -> Mesh:
    """Return a vertical post at x, y from one z to another, m."""
    return revolve([(low, radius), (high, radius)], 2).moved([x, y, 0.0])


def _bar(x: float, z: float, half: float, radius: float) -> Mesh:
    """Return a bar across the boat at x, z, m."""
    return revolve([(-half, radius), (half, radius)], 1).moved([x, 0.0, z])
