"""The joint filter's forecasts: intervals of a small boat at rest, and what counts as plausible."""

import numpy as np
import pytest

from twin import Particulars, Twin
from twin.predictors.forecast import drive_share, is_plausible

SMALL = Particulars(
    name="small catamaran",
    length=1.2,
    beam=0.93,
    draft=0.15,
    mass=15.0,
    speed=2.0,
    shaft_speed=20.0,
    steering="differential",
)


@pytest.fixture(scope="module", params=["ukf", "dsw-ukf-plus"])
def at_rest(request: pytest.FixtureRequest) -> Twin:
    """Return a twin that watched a boat lie still with all but no thrust for a minute."""
    twin, rng = Twin(SMALL, request.param), np.random.default_rng(0)
    command = np.array([-1.5, 2.1, 0.0, 0.0])
    for k in range(600):
        z = np.full(17, np.nan)
        z[:2] = rng.normal(0.0, 0.1, 2)
        z[2:4] = rng.normal(0.0, 0.05, 2)
        z[4:6] = rng.normal(0.0, 0.01, 2)
        z[6:8] = rng.normal(0.0, 0.1, 2)
        twin.step(0.1 * k, z, command)
    return twin


@pytest.mark.parametrize("thrust", [0.0, 1.0, 2.0])
def test_intervals_of_a_small_boat_at_rest_are_such_as_a_boat_can_fill(
    at_rest: Twin, thrust: float
) -> None:
    plan = np.tile([20.0 * thrust, 20.0 * thrust, 0.0, 0.0], (20, 1))
    forecast = at_rest.predict(plan, dt=0.5)
    low, high = forecast.interval([10.0])
    width = (high - low)[0]
    # 3.3 standard deviations of a velocity, each at most .6 of 1.5 nominal speeds
    fastest = max(thrust, 1.0) * SMALL.speed
    # twice as fast a boat turns twice as far
    assert width[2] < 4.0 * np.pi * max(thrust, 1.0)
    assert (width[3:5] < 3.0 * fastest).all()
    assert width[5] < 3.0 * fastest / SMALL.length
    assert (np.abs(forecast.mean[:, 3]) < 1.5 * fastest).all()


def test_a_plan_of_more_thrust_may_lead_to_more_speed() -> None:
    nominal, fastest = np.array([3.0, 1.6, 2.0]), np.zeros(3)
    states = np.zeros((4, 6))
    states[2, 3] = 4.0
    plan = np.zeros((4, 4))
    assert drive_share(plan, 20.0, 2.5) == 1.0
    assert not is_plausible(states, fastest, nominal, drive_share(plan, 20.0, 2.5))
    plan[1, 1] = -40.0
    assert drive_share(plan, 20.0, 2.5) == 2.0
    assert is_plausible(states, fastest, nominal, drive_share(plan, 20.0, 2.5))
    plan[1, 1] = 1e9
    assert not is_plausible(
        4.0 / 1.5 * nominal[0] * np.ones((4, 6)), fastest, nominal, drive_share(plan, 20.0, 2.5)
    )
    states[3, 5] = np.nan
    assert not is_plausible(states, fastest, nominal, 2.0)
