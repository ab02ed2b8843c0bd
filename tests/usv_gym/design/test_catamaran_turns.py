"""Drafts of catamarans with fixed thrusters turn as published and recorded boats do."""

import dataclasses
import math
import os
from pathlib import Path

import numpy as np
import pytest

from tests.usv_gym.design import test_new_vessel as new
from usv_gym import Vessel
from usv_gym.design.checks import inspect
from usv_gym.design.new_vessel import MainParticulars, design
from usv_gym.physics import KNOT, ship
from usv_gym.physics import frames as fr
from usv_gym.vessel.vessel import state_at

SHARED = Path(
    os.environ.get("USV_TWIN_SHARED") or Path(__file__).resolve().parents[3].parent / "shared"
)
BLUEBOAT_RUNS = SHARED / "data" / "blueboat_trondheim"

FACTOR = 1.5
"""By which a draft from main particulars may differ."""

# fmt: off
OTTER = dataclasses.replace(new.OTTER, speed=3.3 * KNOT)
BLUEBOAT = dataclasses.replace(new.BLUEBOAT, speed=4.0 * KNOT)
WAMV = MainParticulars(
    name="wamv", length=4.9, beam=2.3919, draft=0.0794748, mass=180.0, kind="thruster_pair",
    speed=1.7, hulls=2, hull_beam=0.3379, spacing=2.054,
)
# fmt: on


def one_sided_turn(vessel: Vessel) -> tuple[float, float]:
    """Return tactical diameter (lengths) and steady yaw rate (deg/s), one thruster at full speed.

    The turn begins straight ahead at full speed, when the other thruster stops; calm water.
    """
    n, L = vessel.values["shaft_speed_max"], vessel.values["length_waterline"]
    speed = vessel.straight_speed(n)
    state, free, calm = state_at(vessel, n, speed), ship.Ship(vessel.packed, 3), ship.calm_sea()
    command, work = np.array([n, 0.0, 0.0, 0.0]), np.zeros((ship.WORK_ROWS, fr.STATE_SIZE))
    dt = min(0.5 * vessel.values["shaft_lag"], 0.02 * L / speed)
    diameter = math.nan
    for k in range(int(120.0 / dt)):
        ship.step(state, command, free, calm, k * dt, dt, work)
        if math.isnan(diameter) and abs(state[fr.PSI]) >= math.pi:
            diameter = abs(float(state[fr.Y])) / L
    return diameter, math.degrees(state[fr.R])


def within(value: float, expected: float) -> bool:
    """Return whether a value is within the factor of what is expected."""
    return expected / FACTOR <= value <= expected * FACTOR


@pytest.mark.parametrize(
    ("known", "speed", "shipped"),
    [
        (OTTER, 3.3 * KNOT, "otter"),
        (OTTER, 2.64, "otter"),  # its full speed is then that of the shipped otter
        (WAMV, 1.7, "wamv16"),
        (WAMV, 2.0, "wamv16"),  # the same of the WAM-V
    ],
)
def test_draft_turns_as_the_shipped_catamaran(
    known: MainParticulars, speed: float, shipped: str
) -> None:
    drafted = one_sided_turn(design(dataclasses.replace(known, speed=speed)).vessel)
    published = one_sided_turn(Vessel.load(shipped))
    assert within(drafted[0], published[0]), (drafted, published)
    assert within(drafted[1], published[1]), (drafted, published)


def recorded_rates(run: str) -> list[float]:
    """Return yaw rates (deg/s) of a BlueBoat's turns with one side at full and the other stopped.

    Of each turn of 3 s or more, the mean after its first 2 s.
    """
    path = BLUEBOAT_RUNS / f"blueboat_{run}.csv.gz"
    if not path.exists():
        pytest.skip(f"{path} is missing (set USV_TWIN_SHARED); it must not be redistributed")
    log = np.genfromtxt(path, delimiter=",", names=True)
    left, right = log["n_left_rps"], log["n_right_rps"]
    yaw_rate = np.degrees(log["gyro_radps"])
    rates = []
    for full, still in ((left, right), (right, left)):
        turns = np.diff(np.concatenate(([0], (full > 38.0) & (np.abs(still) < 5.0), [0])))
        for a, b in zip(np.flatnonzero(turns > 0), np.flatnonzero(turns < 0), strict=True):
            if b - a >= 30:  # at 10 Hz
                rates.append(abs(float(np.nanmean(yaw_rate[a + 20 : b]))))
    return rates


@pytest.mark.parametrize("run", ["225", "234"])
@pytest.mark.parametrize("speed", [4.0 * KNOT, 2.75])  # in service; at full speed 3.2 m/s, as it
def test_draft_turns_as_the_recorded_blueboat(run: str, speed: float) -> None:
    rates = recorded_rates(run)
    assert len(rates) >= 2
    rate = one_sided_turn(design(dataclasses.replace(BLUEBOAT, speed=speed)).vessel)[1]
    assert all(within(rate, recorded) for recorded in rates), (rate, rates)


def test_thruster_that_stands_still_drags() -> None:
    boat = design(BLUEBOAT).vessel
    D, k_2 = boat.values["propeller_diameter"], boat.values["k_2"]
    disk = 0.25 * math.pi * D**2
    # 1.2 of the dynamic pressure on blades that fill 0.55 of the disk
    assert -k_2 * D**2 == pytest.approx(0.5 * 1.2 * 0.55 * disk, rel=0.01)
    k_0, k_1 = boat.values["k_0"], boat.values["k_1"]
    assert k_0 + 1.1 * k_1 + 1.1**2 * k_2 == pytest.approx(0.0, abs=0.01)


def test_check_warns_of_thrusters_that_hardly_turn_the_boat() -> None:
    # the propellers that drafts had before: small, and without drag when they stop
    boat = design(BLUEBOAT).vessel
    speed = boat.values["shaft_speed_service"]
    small = {"k_1": -0.35, "k_2": -0.05, "propeller_diameter": 0.5 * boat.values["draft"]}
    weak = dataclasses.replace(boat, values={**boat.values, **small})
    shafts = weak.shaft_speed_for(boat.straight_speed(speed)) / speed
    for key in ("service", "manoeuvring", "max"):
        small[f"shaft_speed_{key}"] = shafts * boat.values[f"shaft_speed_{key}"]
    found = inspect(dataclasses.replace(boat, values={**boat.values, **small}))
    assert any("turn: steady radius" in finding.text for finding in found.findings)
    assert not found.errors
