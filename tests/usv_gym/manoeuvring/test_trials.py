"""Trials: reference results, symmetry, scaling, time step and errors."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from scipy.optimize import brentq

from usv_gym import Vessel
from usv_gym.manoeuvring import indices, trials
from usv_gym.manoeuvring.indices import Track
from usv_gym.manoeuvring.trials import TrialError
from usv_gym.vessel.schema import KIND_SCHEMA, SCHEMA

KNOT = 1852.0 / 3600.0
DEGREE = math.pi / 180.0
BOAT = Vessel.load("usv75")
LOA, LWL = BOAT.values["length_overall"], BOAT.values["length_waterline"]

SCHEMAS = [*SCHEMA.values(), *KIND_SCHEMA.values()]
UNIT_OF = {key: unit for keys in SCHEMAS for key, (unit, _) in keys.items()}


def shaft_for(knots: float) -> float:
    return float(brentq(lambda n: BOAT.straight_speed(n) - knots * KNOT, 1.0, 60.0))


def power(unit: str) -> float:
    """Return the power of length with which a unit scales by Froude's law."""
    total, sign = 0.0, 1.0
    for part in unit.replace("/", " / ").split():
        if part == "/":
            sign = -1.0
            continue
        name = part.rstrip("0123456789")
        times = float(part[len(name) :] or 1.0)
        total += sign * times * {"m": 1.0, "kg": 3.0, "s": 0.5}.get(name, 0.0)
    return total


def scaled(scale: float) -> Vessel:
    """Return a ship of another size that is similar by Froude's law."""
    return dataclasses.replace(
        BOAT,
        values={key: a * scale ** power(UNIT_OF[key]) for key, a in BOAT.values.items()},
        resistance_speed=tuple(v * scale**0.5 for v in BOAT.resistance_speed),
        resistance_force=tuple(f * scale**3 for f in BOAT.resistance_force),
    )


def assert_mirrored(port: Track, starboard: Track) -> None:
    for name, column in port._given().items():
        # left and right are added in the other order
        np.testing.assert_allclose(column, getattr(starboard.mirrored(), name), atol=1e-9)


def test_a_turning_circle_begins_with_the_order_and_is_alike_to_port() -> None:
    n = shaft_for(20.0)
    starboard = trials.turning_circle(BOAT, angle=20.0 * DEGREE, n=n)
    got = indices.turning(starboard, length=LOA)
    assert got.drift > 0.0
    assert starboard.helm_moves() == pytest.approx(0.0, abs=1e-12)
    assert got == indices.turning(starboard, length=LOA, origin=0.0, heading=0.0)
    assert_mirrored(trials.turning_circle(BOAT, angle=-20.0 * DEGREE, n=n), starboard)


def test_a_zigzag_reverses_at_its_switch() -> None:
    switch, n = 20.0 * DEGREE, shaft_for(11.0)
    track = trials.zigzag(BOAT, switch=switch, helm=switch, n=n)
    got = indices.zigzag(track, length=LWL, switch=switch)
    assert len(got.overshoots) == 4 and len(got.executes) == 5
    assert got.period == pytest.approx(np.sum(np.diff(got.executes)[1:3]), rel=1e-12)
    port = trials.zigzag(BOAT, switch=switch, helm=-switch, n=n)
    assert_mirrored(port, track)
    # the helm reverses within a step of the switch
    turned = np.flatnonzero(np.diff(np.sign(track.helm[1:]))) + 1
    at = track.psi[turned] * np.sign(track.helm[turned])
    step = np.abs(track.motion[2]).max() * track.t[1]
    assert len(turned) == 4
    assert np.all((at >= switch) & (at < switch + 1.01 * step))


def compared(one: trials.StandardTrials, other: trials.StandardTrials) -> list[tuple[float, float]]:
    pairs = [
        (getattr(a, key), getattr(b, key))
        for a, b in zip(one.turning, other.turning, strict=True)
        for key in ("advance", "transfer", "tactical_diameter", "rate", "drift", "speed_ratio")
    ]
    for kind in ("zigzag_10", "zigzag_20"):
        for a, b in zip(getattr(one, kind), getattr(other, kind), strict=True):
            pairs += zip(a.overshoots, b.overshoots, strict=True)
            pairs.append((a.initial_turning_distance, b.initial_turning_distance))
    return pairs


@pytest.fixture(scope="module")
def standard() -> trials.StandardTrials:
    return trials.standard_trials(BOAT, 25.6)


def test_standard_trials_equal_single_trials(standard: trials.StandardTrials) -> None:
    assert standard.speed == BOAT.straight_speed(25.6)
    # 35 degrees, but the drives stop at 30
    assert standard.angle == BOAT.values["steer_max"]
    assert [run.side for run in standard.turning] == [1, -1]
    assert [run.side for run in standard.zigzag_10] == [1, -1]
    alone = trials.zigzag(BOAT, switch=10 * DEGREE, helm=-10 * DEGREE, n=25.6, overshoots=2)
    np.testing.assert_array_equal(standard.tracks["10/10 zigzag to port"].psi, alone.psi)
    alone = trials.turning_circle(BOAT, angle=standard.angle, n=25.6)
    np.testing.assert_array_equal(standard.tracks["turning circle to starboard"].x, alone.x)


def test_indices_do_not_depend_on_the_scale(standard: trials.StandardTrials) -> None:
    # a ship of 320 m, similar by Froude's law
    scale = 320.0 / LWL
    big = trials.standard_trials(scaled(scale), 25.6 / math.sqrt(scale))
    assert big.speed == pytest.approx(standard.speed * math.sqrt(scale), rel=1e-9)
    for ours, theirs in compared(standard, big):
        # rounding of scaled numbers; one step more or less before the helm is reversed, 0.3 degrees
        assert theirs == pytest.approx(ours, rel=1e-6, abs=1e-6)


def test_indices_do_not_depend_on_the_time_step(standard: trials.StandardTrials) -> None:
    dt = 0.005 * LWL / standard.speed
    fine = trials.standard_trials(BOAT, 25.6, dt=0.25 * dt)
    for ours, theirs in compared(standard, fine):
        # the helm is reversed up to a step late: 0.005 L / U of a rate of r L / U = 1
        assert theirs == pytest.approx(ours, rel=2e-3, abs=0.005)


def test_a_given_approach_speed_is_used() -> None:
    track = trials.turning_circle(BOAT, angle=10.0 * DEGREE, n=20.4, speed=4.0)
    assert track.speed[0] == 4.0
    assert track.motion[2, 0] == 0.0 and track.x[0] == track.y[0] == track.psi[0] == 0.0


def test_impossible_trials_are_refused() -> None:
    for angle in (31.0 * DEGREE, 0.0, "a"):
        with pytest.raises(TrialError, match="helm angle"):
            trials.turning_circle(BOAT, angle=angle, n=20.4)  # type: ignore[arg-type]
    for wrong, words in (
        ({"n": 0.0}, "n = 0"),
        ({"dt": 0}, "dt = 0"),
        ({"switch": 0.0}, "switch = 0"),
        ({"switch": 99.0, "helm": 0.02, "dt": 0.05}, "not done"),
    ):
        with pytest.raises(TrialError, match=words):
            trials.zigzag(BOAT, **{"switch": 0.1, "helm": 0.1, "n": 20.4, **wrong})  # type: ignore[arg-type]
