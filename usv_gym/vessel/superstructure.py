"""Deck, superstructure, masts and sensors of a boat."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from usv_gym.vessel.form import Form
from usv_gym.vessel.hull_lines import HullLines
from usv_gym.vessel.mesh import Mesh, block, loft, mirrored, prism, revolve, sphere
from usv_gym.vessel.parts import Part

__all__ = ["fixed_parts"]

Deck = Callable[[float], float]

Pieces = dict[str, list[Mesh]]


def fixed_parts(form: Form, lines: HullLines) -> Iterator[Part]:
    """Yield hull, deck and superstructure of a boat."""
    x, y, z = lines.deck()

    def deck(at: float) -> float:
        return float(np.interp(at, x, z - 0.05 * y))

    outfit = _ship_house if form.kind == "propeller_rudder" else _wheelhouse
    if form.pontoon:
        outfit = _catamaran_frame
    pieces = {"hull": [lines.mesh], "deck": _deck(lines), **outfit(form, deck)}
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


def _post(
    x: float, y: float, low: tuple[float, float], high: tuple[float, float], points: int = 12
) -> Mesh:
    """Return a vertical post at x, y from one (z, radius) to another, m."""
    return revolve([low, high], 2, points).moved([x, y, 0.0])


def _bar(x: float, z: float, half: float, radius: float, points: int = 12) -> Mesh:
    """Return a bar across the boat at x, z, m."""
    return revolve([(-half, radius), (half, radius)], 1, points).moved([x, 0.0, z])


def _wheelhouse(form: Form, deck: Deck) -> Pieces:
    """Return the low wheelhouse and the mast with sensors of a fast boat."""
    L = form.overall
    a, b = form.stern + 0.22 * form.length, form.stern + 0.62 * form.length
    z = max(deck(a), deck(b))
    h = min(max(1.6 * form.above - form.freeboard, 0.06 * L), 0.13 * L)
    half = 0.29 * form.beam

    def level(s: float, out: float = 0.0) -> tuple[float, float, float, float]:
        nose = b - 0.10 * L * s**1.2 - (0.03 * L if s >= 1.0 else 0.0)
        width = half * (1.0 - 0.16 * s)
        return (z - h * s, a + 0.03 * L * s - out, nose + out, width + out)

    house = block([(z + 0.3 * h, a, b + 0.03 * L, half), level(0.0), level(0.9), level(1.0)])
    aft, end = b - 0.1 * L, form.stern + 0.84 * form.length
    low, fore = deck(0.5 * (b + end)), 0.5 * half
    trunk = block(
        [
            (low + 0.5 * h, aft, end, fore * 1.5),
            (low - 0.16 * h, aft, end - 0.03 * L, fore * 1.4),
            (low - 0.22 * h, aft, end - 0.06 * L, fore * 1.1),
        ],
        power=3.0,
    )
    glass = block([level(0.42, 0.004 * L), level(0.8, 0.004 * L)])
    roof, foot, tall, r = z - h, a + 0.10 * L, 0.16 * L, 0.009 * L
    yard = roof - 0.7 * tall
    radar = roof - 0.34 * tall
    mast = [
        _post(foot, 0.0, (roof + 0.02 * L, 1.6 * r), (roof - tall, 0.8 * r)),
        _bar(foot, yard, 0.6 * half, 0.7 * r),
        prism(roof - 0.28 * tall, radar, foot - 2 * r, foot + 5 * r, 2.4 * r, 5.0),
        _post(a + 0.05 * L, 0.7 * half, (roof + r, 0.35 * r), (roof - 1.5 * tall, 0.15 * r), 6),
    ]
    sensors = [
        sphere(1.9 * r, [foot, 0.6 * half, yard - 2.2 * r]),
        sphere(1.9 * r, [foot, -0.6 * half, yard - 2.2 * r]),
        _post(foot, 0.0, (roof - tall, 1.7 * r), (roof - tall - 4.0 * r, 1.7 * r)),
        _post(foot + 2 * r, 0.0, (radar, 2.6 * r), (radar - 2.0 * r, 2.6 * r)),
    ]
    return {"superstructure": [house, trunk], "windows": [glass], "mast": mast, "sensors": sensors}


def _ship_house(form: Form, deck: Deck) -> Pieces:
    """Return the deck house aft, funnel, masts and deck pipes of a cargo ship."""
    L = form.overall
    a, b = form.stern + 0.055 * form.length, form.stern + 0.135 * form.length
    z, half = deck(0.5 * (a + b)), 0.36 * form.beam
    h = min(max(1.2 * form.above, 0.05 * L), 0.075 * L)
    deep, bridge = z + 0.2 * form.freeboard, z - h
    wings, roof = bridge - 0.012 * L, bridge - 0.024 * L
    house = [
        prism(deep, bridge, a, b, half, 12.0),
        prism(bridge, wings, b - 0.03 * L, b + 0.004 * L, 0.5 * form.beam, 12.0),
        block(
            [
                (wings, b - 0.028 * L, b, 0.8 * half),
                (roof, b - 0.026 * L, b - 0.003 * L, 0.76 * half),
            ],
            power=12.0,
        ),
    ]
    edge = 5e-4 * L
    glass = [
        block(
            [
                (bridge - 0.0135 * L, b - 0.029 * L, b + 0.001 * L, 0.81 * half),
                (bridge - 0.0205 * L, b - 0.029 * L, b, 0.81 * half),
            ],
            power=12.0,
        )
    ]
    glass += [
        prism(z - (s + 0.06) * h, z - s * h, a - edge, b + edge, half + edge, 12.0)
        for s in (0.3, 0.5, 0.7)
    ]
    funnel = block(
        [
            (deep, a - 0.035 * L, a - 0.008 * L, 0.13 * form.beam),
            (z - 0.95 * h, a - 0.035 * L, a - 0.012 * L, 0.11 * form.beam),
        ],
        power=3.0,
    )
    r, foot, yard = 0.003 * L, b - 0.015 * L, roof - 0.026 * L
    fore = form.stern + 0.95 * form.length
    mid, pipe = 0.5 * (b + fore), (fore - 0.05 * L, 0.8 * r)
    above = deck(mid) - 2.5 * r
    mast = [
        funnel,
        _post(foot, 0.0, (roof, 1.6 * r), (roof - 0.04 * L, 0.7 * r)),
        _bar(foot, yard, 6 * r, 0.7 * r),
        _post(fore, 0.0, (deck(fore) + r, 1.5 * r), (deck(fore) - 0.04 * L, 0.7 * r)),
        *(revolve([(b, 0.8 * r), pipe], 0, 8).moved([0.0, y * r, above]) for y in (-2.2, 0.0, 2.2)),
        *(_bar(mid + at * r, above, half, 0.8 * r, 8) for at in (-4.5, 0.0, 4.5)),
    ]
    sensors = [sphere(1.8 * r, [foot, 6.0 * side * r, yard - 2.0 * r]) for side in (-1.0, 1.0)]
    return {"superstructure": house, "windows": glass, "mast": mast, "sensors": sensors}


def _catamaran_frame(form: Form, deck: Deck) -> Pieces:
    """Return the frame, platform and mast of a catamaran."""
    L, mid, r = form.overall, form.middle, 0.011 * form.overall
    across = 0.5 * (form.beam - form.pontoon)
    z = deck(mid) - 0.045 * L
    frame = []
    for x in (mid - 0.2 * L, mid + 0.2 * L):
        frame.append(_bar(x, z, across, r))
        frame += [_post(x, y, (deck(mid) + r, 1.3 * r), (z, r)) for y in (-across, across)]
    wide = max(0.75 * across, 0.3 * form.beam)
    foot, roof, tall = mid + 0.02 * L, z - 0.055 * L, 0.2 * L
    platform = [
        prism(z - 0.3 * r, z - 1.8 * r, mid - 0.25 * L, mid + 0.25 * L, wide, 8.0),
        block(
            [
                (z - 1.8 * r, mid - 0.17 * L, mid + 0.1 * L, 0.55 * wide),
                (roof, mid - 0.16 * L, mid + 0.07 * L, 0.48 * wide),
            ]
        ),
    ]
    yard = roof - 0.75 * tall
    frame += [
        _post(foot, 0.0, (roof + r, r), (roof - tall, 0.6 * r)),
        _bar(foot, yard, 0.3 * wide, 0.5 * r),
    ]
    sensors = [
        *(sphere(1.5 * r, [foot, y * wide, yard - 1.6 * r]) for y in (-0.3, 0.3)),
        _post(foot, 0.0, (roof - tall, 1.6 * r), (roof - tall - 3.0 * r, 1.6 * r)),
    ]
    edge = (roof + 0.004 * L, roof - 0.003 * L)
    glass = [prism(*edge, mid - 0.14 * L, mid + 0.03 * L, 0.38 * wide, 10.0)]
    return {"superstructure": platform, "windows": glass, "mast": frame, "sensors": sensors}
