"""Long runs: garbage for every predictor, random steps of boats, and a feed over a poor link."""

from __future__ import annotations

import itertools
import math
import warnings
from collections import Counter

import gymnasium as gym
import numpy as np
import pytest

from tests.twin.live.wire import disturbed, example
from twin import PREDICTORS, Twin, known_plan
from twin.channels import COMMANDS, MEASUREMENTS
from twin.digital_twin import TwinError
from twin.logs.wire.nmea import NmeaFeed
from twin.sim.bridge import particulars_of, simulate
from usv_gym import SeaState, Vessel
from usv_gym.envs.episodes import BOUND, CapsizeWarning
from usv_gym.vessel.vessel import vessel_names
from usv_gym.world.faults import parse_faults

BOAT = Vessel.load("usv75")

CLEAN_S, HORIZON_S = 60.0, 10.0
"""Clean sailing before the garbage, and horizon of the forecasts."""

EXTREMES = [
    math.nan,
    math.inf,
    -math.inf,
    0.0,
    -0.0,
    5e-324,
    1e300,
    -1e300,
    1e9,
    -1e9,
    360.0,
    2**53,
]

SOAKED = sorted(set(PREDICTORS) - {"oracle", "lstm"})
"""All but the one that knows the truth, and the one that needs torch and a training."""


def garbage_rows(rng, t):
    """Yield time, measurements and commands of rows without sense, for ever.

    Values are any bits of a double, extremes or plausible numbers; cells are missing; stamps stand
    still, go back, or jump by up to an hour.
    """
    width = len(MEASUREMENTS) + len(COMMANDS)
    while True:
        bits = rng.integers(2**64, size=width, dtype=np.uint64).view(np.float64)
        plausible = 10.0 ** rng.uniform(-3, 4, width) * rng.choice([-1, 1], width)
        kinds = [bits, rng.choice(EXTREMES, width), plausible, np.full(width, math.nan)]
        values = np.choose(rng.integers(4, size=width), kinds)
        z, cmd = values[: len(MEASUREMENTS)], values[len(MEASUREMENTS) :]
        if rng.random() < 0.7:  # or Twin.step refused nearly all
            cmd = np.where(np.isfinite(cmd), cmd, 0.0)
        step = 0.05 if rng.random() < 0.97 else rng.choice([1e-9, 0.0, -1.0, 3.0, 3600.0])
        yield t + step, z, cmd
        t = max(t, t + step)


def check(twin):
    """Assert that estimate and forecast are finite, and covariances positive semidefinite."""
    estimate, forecast = twin.estimate(), twin.predict("hold")
    for part in (estimate.state, forecast.mean, forecast.cov, forecast.low, forecast.high):
        assert np.isfinite(part).all()
    scale = np.abs(forecast.cov).max(axis=(1, 2), keepdims=True) + 1e-300
    assert np.linalg.eigvalsh(forecast.cov / scale).min() > -1e-9


def errors(twin, log, first, last, shift):
    """Feed rows of a log; return the errors of position of the forecasts made once a second, m."""
    found = []
    for k in range(first, last):
        twin.step(log.t[k] + shift, log.z[k], log.cmd[k])
        if k % 20 == 0:
            forecast = twin.predict(known_plan(log, k, HORIZON_S, 0.25), dt=0.25)
            later = k + round(HORIZON_S / log.dt)
            found.append(np.hypot(*(forecast.mean[-1, :2] - log.truth[later, :2])))
    return found


@pytest.mark.parametrize(
    ("name", "rows"),
    [
        ("persistence", 1000),
        ("ukf", 1000),
        *(pytest.param(name, 2000, marks=pytest.mark.slow) for name in SOAKED),
    ],
)
def test_garbage_harms_no_predictor(name, rows):
    """30 s after garbage, errors are near those of a twin that got none."""
    log = simulate("random", vessel=BOAT, sea=SeaState.named("2"), duration=110.0, seed=1)
    twin, clean = (Twin(particulars_of(BOAT), name, seed=1) for _ in range(2))
    middle, end = round(CLEAN_S / log.dt), round((CLEAN_S + 40.0) / log.dt)
    normal = errors(clean, log, 0, end, 0.0)
    errors(twin, log, 0, middle, 0.0)
    refused = 0
    garbage = itertools.islice(garbage_rows(np.random.default_rng(1), twin.t), rows)
    for k, row in enumerate(garbage):
        try:
            twin.step(*row)
        except TwinError:
            refused += 1
        if k % 100 == 0:
            check(twin)
    assert 0 < refused < 0.5 * rows
    found = errors(twin, log, middle, end, twin.t + log.dt - log.t[middle])
    check(twin)
    assert np.mean(found[-10:]) <= 1.5 * np.mean(normal[-10:]) + 0.2


@pytest.mark.slow
@pytest.mark.parametrize("dof", [3, 6])
@pytest.mark.parametrize("vessel", vessel_names())
def test_random_steps_with_all_faults_are_finite(vessel, dof):
    rng = np.random.default_rng(2)
    for sea in range(7):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", CapsizeWarning)  # here boats may
            options = {"vessel": vessel, "sea": str(sea), "dof": dof, "faults": "on", "twin": None}
            env = gym.make_vec("USVTwin-v0", num_envs=64, **options)
        env.reset(seed=sea)
        for k in range(500):
            if k % 40 == 0:
                action = rng.uniform(-1.2, 1.2, env.action_space.shape).astype(np.float32)
            observation, reward = env.step(action)[:2]
            assert (np.abs(observation) <= BOUND).all()  # NaN is not
            assert np.isfinite(reward).all()
        env.close()


@pytest.mark.slow
def test_a_feed_over_a_poor_link_is_twinned():
    """A quarter of an hour of NMEA with all faults of sensors; a fifth of it is spoilt."""
    log = simulate(
        "random",
        vessel=BOAT,
        sea=SeaState.named("2"),
        duration=900.0,
        seed=2,
        faults=parse_faults("on", 0.0),
    )
    sent = example.schedule(log, example.NmeaStream((63.43, 10.4), 1.7e9))
    twin, now, rows, off = Twin(particulars_of(BOAT), "ukf", seed=2), 0.0, 0, []
    with NmeaFeed(None, particulars_of(BOAT), clock=lambda: now) as feed:
        for datagram in disturbed(sent, np.random.default_rng(2), Counter()):
            now = max(now, datagram.due)
            feed.receive(datagram.data, now, ("127.0.0.1", 9))
            for t, z, cmd in feed.take():
                twin.step(t, z, cmd)
                rows += 1
                if rows % 20 == 0:
                    check(twin)
                    k = min(max(round(t / log.dt), 0), len(log) - 1)
                    off.append(np.hypot(*(twin.estimate().state[:2] - log.truth[k, :2])))
    assert rows > 0.9 * len(log)
    assert np.median(off) < 4.0
