"""Seas and tables of spectra, for tests."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from usv_gym import SeaState, Vessel
from usv_gym.world.realisation import Sea


def realise(state: SeaState, seed: int = 0) -> Sea:
    return state.realise(Vessel.load("usv75"), *np.random.default_rng(seed).spawn(2))


def write(path: Path, header: str, rows: list[object]) -> Path:
    path.write_text("\n".join([header, *(",".join(map(str, row)) for row in rows)]))  # type: ignore[call-overload]
    return path
