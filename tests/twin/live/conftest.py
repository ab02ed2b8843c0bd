"""The recorded run of the tests of the live feed."""

import pytest

from tests.twin.live.wire import RUN
from twin.logs.log import Log
from twin.particulars import Particulars


@pytest.fixture(scope="session")
def circle() -> Log:
    """Return the first 90 s of the recorded run, over the midnight at which replays begin."""
    return Log.read(RUN).slice(0.0, 90.0)


@pytest.fixture(scope="session")
def usv() -> Particulars:
    return Particulars.load(RUN.with_name("boat1_usv_circle.toml"))
