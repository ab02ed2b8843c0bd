"""Commands that steer in another way than they say, and instruments of a log with faults."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tests.twin.logs.log_faults import frozen
from twin.channels import MEASUREMENTS
from twin.logs.diagnosis.diagnose import diagnose
from twin.logs.diagnosis.findings import Recording
from twin.logs.diagnosis.instruments import estimate_instruments
from twin.particulars import Particulars
from twin.sim.bridge import simulate
from usv_gym import SeaState, Vessel

X, Y, PSI, R = (MEASUREMENTS.index(n) for n in ("gps_x_m", "gps_y_m", "compass_rad", "gyro_radps"))


def test_written_gyro_noise_covers_the_difference_from_the_compass() -> None:
    sea = SeaState(hs=0.1, wind=3.0)
    log = simulate("zigzag", vessel=Vessel.load("usv75"), sea=sea, duration=100.0, seed=1)
    z = frozen(50.0, 65.0, R)(log.t, log.z, log.cmd)[1]
    clean, wrong = (diagnose(Recording(log.t, each, log.cmd, log.t)) for each in (log.z, z))
    assert "gyro-compass" in {finding.code for finding in wrong.findings}
    assert estimate_instruments(clean)[0].gyro_sd < 0.003
    on_board, reasons = estimate_instruments(wrong)
    assert on_board.gyro_sd > 0.02
    assert "compass" in reasons["gyro_sd"]


@pytest.mark.parametrize("vessel", ["wamv16", "usv75"])
def test_a_boat_that_circles_against_its_commands_is_named(vessel: str) -> None:
    """A steady turn changes no command, but no wind turns a boat around again and again."""
    ship = Vessel.load(vessel)
    sea = SeaState(hs=0.1, wind=3.0)
    log = simulate("turn", vessel=ship, sea=sea, duration=150.0, seed=1).without_truth()
    swapped_sides, other_sign = log.cmd[:, [1, 0, 2, 3]], log.cmd * [1.0, 1.0, -1.0, -1.0]
    wrong = swapped_sides if vessel == "wamv16" else other_sign

    def codes(cmd: np.ndarray) -> set[str]:
        return {f.code for f in diagnose(Recording(log.t, log.z, cmd, log.t)).findings}

    fault = "sides-swapped" if vessel == "wamv16" else "steering-sign"
    assert fault in codes(wrong)
    assert not {"sides-swapped", "steering-sign"} & codes(log.cmd)


@pytest.mark.parametrize("vessel", ["otter", "wamv16"])
@pytest.mark.parametrize("seed", range(3))
def test_a_heading_held_in_waves_does_not_look_like_swapped_sides(vessel: str, seed: int) -> None:
    """The commands answer the waves: before, the remedy was to swap the columns."""
    ship, sea = Vessel.load(vessel), SeaState.named(str(1 + seed))
    log = simulate("heading45", vessel=ship, sea=sea, duration=120.0, seed=seed, dof=6)
    found = diagnose(Recording(log.t, log.z, log.cmd, log.t)).findings
    assert "sides-swapped" not in {finding.code for finding in found}


def test_steering_that_the_particulars_do_not_know_is_named() -> None:
    rng = np.random.default_rng(0)
    t = np.arange(0.0, 60.0, 0.1)
    z = np.full((len(t), len(MEASUREMENTS)), np.nan)
    z[:, X], z[:, Y] = t + 0.1 * rng.standard_normal((2, len(t)))
    z[:, PSI] = 0.01 * rng.standard_normal(len(t))
    boat = Particulars(
        name="a", length=2.0, beam=1.0, draft=0.1, mass=50.0, speed=1.0, shaft_speed=10.0
    )
    thrusters = dataclasses.replace(boat, steering="differential")
    swing = np.sin(0.2 * t)

    def codes(about: Particulars, difference: np.ndarray, angle: np.ndarray) -> set[str]:
        cmd = np.column_stack([10.0 + difference, 10.0 - difference, angle, angle])
        return {f.code for f in diagnose(Recording(t, z, cmd, t), about).findings}

    assert "steering-kind" in codes(thrusters, 0.0 * t, 0.3 * swing)
    assert "steering-kind" in codes(boat, 2.0 * swing, 0.0 * t)
    for about, difference, angle in (
        (thrusters, 2.0 * swing, 0.0 * t),
        (boat, 0.0 * t, 0.3 * swing),
        (boat, 2.0 * swing, 0.3 * swing),
        (boat, 0.0 * t, 0.0 * t),
    ):
        assert "steering-kind" not in codes(about, difference, angle)
