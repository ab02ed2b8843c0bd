"""A vessel that capsizes in a sea says so before it is sailed."""

import dataclasses
import math
import warnings

import gymnasium as gym
import pytest

import usv_gym  # noqa: F401 - registers the environment
from usv_gym.design.checks import inspect
from usv_gym.design.seaway import sail_in_sea, warning_of
from usv_gym.envs.episodes import CapsizeWarning
from usv_gym.vessel.vessel import Vessel
from usv_gym.world.sea import SeaKeyframe, SeaState

TENDER = Vessel.load("kvlcc2_l7")
"""A tanker of 7 m, which no one would take into waves of 2.5 m."""


def test_a_stiff_boat_is_not_blamed_and_rolls_more_in_higher_waves() -> None:
    boat = Vessel.load("usv75")
    tilts = [sail_in_sea(boat, SeaState.named(sea)).tilt for sea in ("1", "2", "3")]
    assert tilts == sorted(tilts)
    assert tilts[0] < math.radians(6.0)
    assert warning_of(boat, SeaState.named("4"), 6) is None
    assert warning_of(TENDER, SeaState.named("calm"), 6) is None


def test_a_tender_ship_is_named_with_its_sea_and_headings() -> None:
    trial = sail_in_sea(TENDER, SeaState.named("4"))
    assert trial.capsized
    said = warning_of(TENDER, SeaState.named("4"), 6)
    assert said is not None
    assert said.startswith("kvlcc2_l7 capsizes in waves of 2.5 m within a minute")
    assert warning_of(TENDER, SeaState.named("4"), 3) is None
    found = inspect(TENDER)
    assert any("capsizes within a minute" in finding.text for finding in found.findings)
    assert not any("capsizes" in one.text for one in inspect(Vessel.load("usv75")).findings)


def test_the_worst_moment_of_a_sea_that_changes_counts() -> None:
    moments = (
        SeaKeyframe(40.0, 0.1, 4.5),
        SeaKeyframe(100.0, 2.5, 10.0),
        SeaKeyframe(160.0, 0.1, 4.5),
    )
    said = warning_of(TENDER, SeaState(schedule=moments), 6)
    assert said is not None
    assert "waves of 2.5 m" in said
    assert warning_of(TENDER, SeaState(schedule=(SeaKeyframe(0.0, 0.05, 1.0),)), 6) is None


def test_the_trial_repeats_itself_and_is_that_of_the_numbers() -> None:
    sea = SeaState.named("3")
    assert sail_in_sea(TENDER, sea) == sail_in_sea(Vessel.load("kvlcc2_l7"), sea)
    calmer = dataclasses.replace(sea, hs=0.1)
    assert sail_in_sea(TENDER, calmer).tilt < sail_in_sea(TENDER, sea).tilt


def test_an_environment_warns_when_it_is_made() -> None:
    with pytest.warns(CapsizeWarning, match="kvlcc2_l7 capsizes"):
        gym.make("USVTwin-v0", vessel="kvlcc2_l7", sea="4", dof=6, twin=None).close()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        gym.make("USVTwin-v0", vessel="kvlcc2_l7", sea="4", twin=None).close()
        gym.make("USVTwin-v0", sea="4", dof=6, twin=None).close()
