"""The recorded run of the tests of the live feed."""

import pytest

from tests.twin.live.wire import RUN
from twin.particulars import Particulars


@pytest.fixture(scope="session")
def usv() -> Particulars:
    return Particulars.load(RUN.with_name("boat1_usv_circle.toml"))
