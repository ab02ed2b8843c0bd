"""Runs that several tests share."""

from __future__ import annotations

import pytest

from twin.log import Log
from twin.particulars import Particulars
from twin.simulated import particulars_of, simulate
from usv_gym import SeaState, Vessel


@pytest.fixture(scope="session")
def boat() -> Particulars:
    return particulars_of(Vessel.load("usv75"))


@pytest.fixture(scope="session")
def zigzag() -> Log:
    """Return a zigzag of 60 s in the sea of the paper, with the truth."""
    return simulate(
        "zigzag",
        vessel=Vessel.load("usv75"),
        sea=SeaState(hs=0.5, wind=4.5),
        duration=60.0,
        seed=7,
    )
