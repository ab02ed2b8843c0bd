"""The anemometer: apparent wind of its height, its errors, and that it disturbs nothing else."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from tests.usv_gym.world.sample_rows import rows
from usv_gym import Fault, SeaState, SensorSuite
from usv_gym.physics import frames as fr
from usv_gym.world.anemometer import PROFILE
from usv_gym.world.sensors import WIND_AT
from usv_gym.world.simulation import Simulation

EXACT = dataclasses.replace(SensorSuite.perfect(), wind_rate=20.0, wind_height=10.0)
AIR = math.atan2(4.0, 5.0), math.hypot(4.0, 5.0)
"""Where the wind of ``sample_rows`` blows to, rad, and its speed, m/s."""


def state(**values: float) -> np.ndarray:
    made = np.zeros(fr.STATE_SIZE)
    for name, value in values.items():
        made[getattr(fr, name)] = value
    return made


def apparent(suite: SensorSuite, count: int = 1, **values: float) -> np.ndarray:
    return rows(suite, count, state=state(**values))[:, WIND_AT:]


@pytest.mark.parametrize("heading", [0.0, 1.0, -2.5])
def test_a_boat_at_rest_feels_the_true_wind(heading: float) -> None:
    ((speed, angle),) = apparent(EXACT, PSI=heading)
    assert speed == pytest.approx(AIR[1])
    assert math.remainder(angle + heading - AIR[0] - math.pi, 2 * math.pi) == pytest.approx(0.0)


def test_a_boat_that_moves_adds_its_own_wind() -> None:
    """Down the wind, faster than it: 4 m/s from ahead; with sway to starboard, from there."""
    ((speed, angle),) = apparent(EXACT, PSI=AIR[0], U=AIR[1] + 4.0)
    assert (speed, angle) == (pytest.approx(4.0), pytest.approx(0.0, abs=1e-9))
    ((speed, angle),) = apparent(EXACT, PSI=AIR[0], U=AIR[1], V=3.0)
    assert (speed, angle) == (pytest.approx(3.0), pytest.approx(0.5 * math.pi))


def test_a_masthead_that_rolls_or_pitches_moves_through_the_air() -> None:
    """Rolling to starboard it moves there; bow up it moves astern: 10 m times the rate."""
    for name, sign, axis in (("P", 1.0, 1), ("Q", -1.0, 0)):
        still, moving = (
            apparent(EXACT, PSI=AIR[0], U=AIR[1], **{name: rate})[0] for rate in (0.0, 0.2)
        )
        assert still[0] == pytest.approx(0.0, abs=1e-9)
        from_ahead_and_starboard = moving[0] * np.array([math.cos(moving[1]), math.sin(moving[1])])
        assert from_ahead_and_starboard[axis] == pytest.approx(sign * 2.0)


def test_the_wind_is_weaker_near_the_sea() -> None:
    low = apparent(dataclasses.replace(EXACT, wind_height=2.0))[0, 0]
    assert low == pytest.approx(AIR[1] * 0.2**PROFILE)


def test_rate_and_latency_are_those_asked_for() -> None:
    suite = dataclasses.replace(EXACT, wind_rate=4.0, wind_latency=0.5)
    has = np.isfinite(apparent(suite, 200)[:, 0])
    assert not has[:10].any()
    np.testing.assert_array_equal(np.flatnonzero(has), 10 + 5 * np.arange(38))


def test_noise_and_bias_have_their_sizes() -> None:
    suite = dataclasses.replace(
        EXACT, wind_white=0.2, wind_from_white=0.05, wind_bias=0.3, wind_from_bias=0.04
    )
    suite = dataclasses.replace(suite, wind_bias_time=1.0)
    z = apparent(suite, 40_000)
    off = z - apparent(EXACT, 1)
    off[:, 1] = np.remainder(off[:, 1] + math.pi, 2 * math.pi) - math.pi
    # 40 000 rows hold about 1000 independent biases: sd of an sd 2 %, three times that
    assert off.std(axis=0) == pytest.approx([math.hypot(0.2, 0.3), math.hypot(0.05, 0.04)], rel=0.1)


def sailed(suite: SensorSuite, faults: tuple[Fault, ...] = (), n: int = 1) -> np.ndarray:
    simulation = Simulation(n, "usv75", SeaState.named("2"), suite=suite, faults=faults)
    simulation.reset(range(n), [np.random.default_rng(7 + i) for i in range(n)])
    found = [simulation.z.copy()]
    for _ in range(300):
        simulation.step(simulation.cmd)
        found.append(simulation.z.copy())
    return np.array(found)


def test_without_an_anemometer_nothing_else_changes() -> None:
    best = SensorSuite.grade("best")
    assert best.has_anemometer
    on = sailed(best)
    off = sailed(dataclasses.replace(best, wind_rate=0.0))
    np.testing.assert_array_equal(on[..., :WIND_AT], off[..., :WIND_AT])
    assert np.isfinite(on[..., WIND_AT:]).any() and np.isnan(off[..., WIND_AT:]).all()
