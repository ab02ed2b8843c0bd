"""Runs that several tests share."""

from collections.abc import Callable
from importlib.util import find_spec

import pytest

from twin import PREDICTORS, Twin, make_predictor
from twin.logs.log import Log
from twin.particulars import Particulars
from twin.predictors.registry import EXTRAS, predictor_class
from twin.sim.bridge import particulars_of, simulate
from usv_gym import SeaState, Vessel


@pytest.fixture(scope="session")
def boat() -> Particulars:
    return particulars_of(Vessel.load("usv75"))


SEA = SeaState(hs=0.5, wind=4.5)


@pytest.fixture(scope="session")
def zigzag() -> Log:
    """Return a zigzag of 60 s in the sea of the paper, with the truth."""
    return simulate(
        "zigzag",
        vessel=Vessel.load("usv75"),
        sea=SEA,
        duration=60.0,
        seed=7,
    )


@pytest.fixture(params=list(PREDICTORS))
def name(request: pytest.FixtureRequest) -> str:
    """Each predictor of the registry in turn, also those that are added later."""
    needs = EXTRAS.get(request.param, (None,))[0]
    if needs is not None and find_spec(needs) is None:
        pytest.skip(f"{request.param} needs {needs}")
    return request.param


@pytest.fixture
def make_twin(boat: Particulars) -> Callable[[str], Twin]:
    """Return a function that makes the twin of the zigzag's boat with a predictor by name.

    Learners train at 20 s; an oracle gets the sea.
    """

    def make(name: str) -> Twin:
        kind = predictor_class(name)
        options = {"train_at": 20.0} if kind.trains else {}
        if kind.needs_simulator:
            return Twin(boat, make_predictor(name, boat, seed=3, sea=SEA))
        return Twin(boat, name, seed=3, **options)

    return make
