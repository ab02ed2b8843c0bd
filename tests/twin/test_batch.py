"""Twins of several boats in one batch."""

import numpy as np
import pytest

from twin import Twin
from twin.batch import Twins
from twin.predictors.registry import make_predictor
from twin.sim.bridge import particulars_of, simulate
from usv_gym import SeaState, Vessel

BOAT = Vessel.load("usv75")


def rows_of(n, duration=8.0):
    """Return the rows of n boats at sea."""
    sea = SeaState.named("2")
    return [
        list(simulate("random", vessel=BOAT, sea=sea, duration=duration, seed=i)) for i in range(n)
    ]


@pytest.mark.parametrize("name", ["ukf", "dsw-ukf-plus", "persistence"])
def test_boats_of_a_batch_are_as_alone_and_one_begins_anew_by_itself(name):
    about, logs = particulars_of(BOAT), rows_of(2)
    batch, alone = Twins(about, make_predictor(name, about), 2), [Twin(about, name) for _ in logs]
    for k, rows in enumerate(zip(*logs, strict=True)):
        if k == 100:
            batch.reset(1)
            alone[1].reset()
        for i, (t, z, cmd) in enumerate(rows):
            batch.boats["t"][i], batch.boats["z"][i], batch.boats["cmd"][i] = t, z, cmd
            alone[i].step(t, z, cmd)
        batch.step()
    for i, one in enumerate(alone):
        np.testing.assert_array_equal(batch.state(i), one.predictor.state)
        copy = Twin(about, name)
        copy.take_over(batch, i)
        assert (copy.t, copy.begun, copy.health) == (one.t, one.begun, one.health)
        np.testing.assert_array_equal(copy.predict("hold").mean, one.predict("hold").mean)
