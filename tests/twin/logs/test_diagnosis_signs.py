"""Signs, sides, units and mirrored tracks: one fault has one finding, and its cause comes first."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable

import numpy as np
import pytest

from twin.channels import MEASUREMENTS
from twin.logs.diagnosis.diagnose import diagnose
from twin.logs.diagnosis.findings import ERROR, NOTE, Finding, Recording
from twin.logs.diagnosis.heading import gyro_on_compass
from twin.logs.diagnosis.track import compass_on_track
from twin.particulars import Particulars
from twin.sim.bridge import particulars_of, simulate
from usv_gym import SeaState, Vessel

X, Y, PSI, R = (MEASUREMENTS.index(n) for n in ("gps_x_m", "gps_y_m", "compass_rad", "gyro_radps"))

Fault = Callable[[np.ndarray, np.ndarray], None]
"""Changes measurements and commands in place."""


@functools.cache
def simulated(vessel: str, manoeuvre: str) -> tuple[Recording, Particulars]:
    """Return a sound log with fixes, compass and gyro only."""
    ship = Vessel.load(vessel)
    sea = SeaState(hs=0.1, wind=2.0)
    log = simulate(manoeuvre, vessel=ship, sea=sea, duration=150.0, seed=3)
    z = log.z.copy()
    z[:, [j for j in range(z.shape[1]) if j not in (X, Y, PSI, R)]] = np.nan
    return Recording(log.t, z, log.cmd, log.t), particulars_of(ship)


def found_with(fault: Fault, vessel: str = "otter", manoeuvre: str = "random") -> list[Finding]:
    sound, boat = simulated(vessel, manoeuvre)
    z, cmd = sound.z.copy(), sound.cmd.copy()
    fault(z, cmd)
    return list(diagnose(dataclasses.replace(sound, z=z, cmd=cmd), boat).findings)


def errors(findings: list[Finding]) -> list[str]:
    return [finding.code for finding in findings if finding.severity == ERROR]


def swap_fixes(z: np.ndarray, _: np.ndarray) -> None:
    z[:, [X, Y]] = z[:, [Y, X]]


def compass_from_east(z: np.ndarray, _: np.ndarray) -> None:
    z[:, PSI] = 0.5 * math.pi - z[:, PSI]


def compass_to_port(z: np.ndarray, _: np.ndarray) -> None:
    z[:, PSI] *= -1.0


def compass_reversed(z: np.ndarray, _: np.ndarray) -> None:
    z[:, PSI] += math.pi


def both_shafts(_: np.ndarray, cmd: np.ndarray) -> None:
    cmd[:, :2] *= -1.0


def left_shaft(_: np.ndarray, cmd: np.ndarray) -> None:
    cmd[:, 0] *= -1.0


def right_shaft(_: np.ndarray, cmd: np.ndarray) -> None:
    cmd[:, 1] *= -1.0


def swap_shafts(_: np.ndarray, cmd: np.ndarray) -> None:
    cmd[:, :2] = cmd[:, [1, 0]]


def gyro_to_port(z: np.ndarray, _: np.ndarray) -> None:
    z[:, R] *= -1.0


@pytest.mark.parametrize(
    ("fault", "code"),
    [
        (swap_fixes, "track-mirrored"),
        (compass_from_east, "track-mirrored"),
        (compass_to_port, "track-mirrored"),
        (compass_reversed, "compass-reversed"),
        (gyro_to_port, "gyro-sign"),
        (both_shafts, "thrust-sign"),
        (left_shaft, "left-sign"),
        (right_shaft, "right-sign"),
        (swap_shafts, "sides-swapped"),
    ],
)
@pytest.mark.parametrize("vessel", ["otter", "wamv16"])
def test_one_fault_has_one_error(fault: Fault, code: str, vessel: str) -> None:
    """Before, the compass was followed by wrong shafts and gyro, and one shaft was not found."""
    assert errors(found_with(fault, vessel)) == [code]


def test_thrust_of_a_zigzag_with_the_wrong_sign_leaves_the_rudder_alone() -> None:
    """The shaft speed is constant: only the track shows its sign."""
    assert errors(found_with(both_shafts, "kvlcc2_l7", "zigzag")) == ["thrust-sign"]


def test_commands_are_not_blamed_for_a_wrong_heading() -> None:
    codes = [finding.code for finding in found_with(compass_from_east)]
    assert codes == ["track-mirrored", "commands-unchecked"]


def test_mirrored_track_names_what_gyro_and_commands_speak_against() -> None:
    by_fixes = found_with(swap_fixes)[0].what
    by_compass = found_with(compass_from_east)[0].what
    assert "swapped" in by_fixes
    assert "counts from east" not in by_fixes
    assert "counts from east" in by_compass
    assert "swapped" not in by_compass


# --- tracks -----------------------------------------------------------------------------------


def track(turns: float, offset: float = 0.0, mirrored: bool = False) -> Recording:
    """Return a log of 245 m at 1 m/s that turns by some times .35 rad to and fro."""
    rng = np.random.default_rng(0)
    t = np.arange(0.0, 245.0, 0.2)
    psi = 0.4 + 0.35 * turns * np.sin(0.06 * t)
    way = np.cumsum(0.2 * np.exp(1j * psi))
    z = np.full((len(t), len(MEASUREMENTS)), np.nan)
    z[:, X], z[:, Y] = way.real, way.imag
    z[:, [X, Y]] += 0.1 * rng.standard_normal((len(t), 2))
    if mirrored:
        z[:, [X, Y]] = z[:, [Y, X]]
    z[:, PSI] = psi + offset + 0.01 * rng.standard_normal(len(t))
    return Recording(t, z, np.ones((len(t), 4)) * [5.0, 5.0, 0.0, 0.0], t)


@pytest.mark.parametrize("offset", [0.0, 0.5])
@pytest.mark.parametrize("turns", [1.0, 2.0])
def test_swapped_fixes_are_found_on_few_headings(turns: float, offset: float) -> None:
    """Before, the mean resultant lengths of both had to differ by .3; here they do by .1."""
    log = track(turns, offset, mirrored=True)
    fit = compass_on_track(log.samples("gps_x_m", "gps_y_m"), (log.t, log.z[:, PSI]))
    assert fit is not None
    assert fit.mirrored < fit.along + 0.3 or turns > 1.0
    found = {finding.code for finding in diagnose(log).findings}
    assert "track-mirrored" in found
    assert "track-mirrored" not in {f.code for f in diagnose(track(turns, offset)).findings}


def test_straight_track_far_from_the_compass_is_a_warning_that_names_both() -> None:
    found = {f.code: f for f in diagnose(track(0.02, math.radians(70.0))).findings}
    assert found["compass-offset"].severity != NOTE
    assert "the compass is off" in found["compass-offset"].remedy
    assert "swapped" in found["compass-offset"].remedy


def test_compass_45_degrees_off_is_said_on_few_headings() -> None:
    codes = {f.code for f in diagnose(track(1.0, math.radians(45.0))).findings}
    assert "compass-offset" in codes


@pytest.mark.parametrize("seed", range(3))
def test_a_straight_course_in_waves_and_current_is_no_mirrored_track(seed: int) -> None:
    sea = SeaState(hs=0.4, wind=5.0, current=0.6, current_to=2.0 * seed)
    log = simulate("straight", vessel=Vessel.load("kvlcc2_l7"), sea=sea, duration=150.0, seed=seed)
    found = diagnose(Recording(log.t, log.z, log.cmd, log.t)).findings
    assert "track-mirrored" not in {finding.code for finding in found}


# --- gyros ------------------------------------------------------------------------------------


@pytest.mark.parametrize(("rate", "code"), [(0.02, "gyro-bias"), (0.05, "gyro-sign")])
def test_sign_and_unit_of_a_gyro_show_in_a_steady_turn(rate: float, code: str) -> None:
    """Turns that do not vary have no standard deviation; a slow one could be a bias of .04."""
    rng = np.random.default_rng(1)
    t = np.arange(0.0, 300.0, 0.1)
    noise, error = 0.002 * rng.standard_normal((2, len(t)))
    psi = rate * t + error
    for factor in (-1.0, 57.3):
        fit = gyro_on_compass(t, psi, t, factor * rate + noise)
        assert fit is not None
        assert fit.turned > 3.0 * fit.blurred
        assert abs(fit.scale / factor - 1.0) < 0.05
    z = np.full((len(t), len(MEASUREMENTS)), np.nan)
    z[:, PSI], z[:, R] = np.remainder(psi, 2.0 * math.pi), -rate + noise
    codes = {f.code for f in diagnose(Recording(t, z, np.zeros((len(t), 4)), t)).findings}
    assert code in codes


def test_scale_of_a_gyro_shows_on_a_slow_ship() -> None:
    """It turns by .03 rad in 2 s; before, .05 were needed."""

    def fault(z: np.ndarray, _: np.ndarray) -> None:
        z[:, R] *= 1.3

    codes = [f.code for f in found_with(fault, "kvlcc2_l7", "zigzag")]
    assert codes == ["gyro-scale"]


def test_gyro_that_stands_still_is_named_though_its_values_repeat() -> None:
    def repeats(z: np.ndarray, _: np.ndarray) -> None:
        z[:, R] = np.round(z[:, R], 1)

    def stands(z: np.ndarray, cmd: np.ndarray) -> None:
        repeats(z, cmd)
        z[600:1400, R] = z[600, R]
        z[1400:1450, R] = z[600, R] + 0.02  # no jump afterwards

    assert "gyro-frozen" not in {f.code for f in found_with(repeats)}
    assert "gyro-frozen" in {f.code for f in found_with(stands)}


# --- units ------------------------------------------------------------------------------------


def degrees_with_no_fix(z: np.ndarray, _: np.ndarray) -> None:
    z[:, [X, Y]] = z[:, [X, Y]] / 111_000.0 + [59.43, 10.47]
    first = np.flatnonzero(np.isfinite(z[:, X]))[50]
    z[first, [X, Y]] = 0.0


def test_positions_in_degrees_are_named_alone_despite_a_fix_at_zero() -> None:
    """Before, the jump to (0, 0) hid the degrees, and shaft speeds were blamed."""
    found = found_with(degrees_with_no_fix)
    assert errors(found) == ["position-degrees"]
    assert "degrees" in found[0].what


@pytest.mark.parametrize("manoeuvre", ["random", "straight"])
@pytest.mark.parametrize("unit", ["rpm", "per cent", "shares", "pulses"])
def test_units_of_commands_are_named_by_the_particulars(unit: str, manoeuvre: str) -> None:
    def fault(_: np.ndarray, cmd: np.ndarray) -> None:
        share = cmd[:, :2] / np.abs(cmd[:, :2]).max()
        cmd[:, :2] = {
            "rpm": 60.0 * cmd[:, :2],
            "per cent": 100.0 * share,
            "shares": share,
            "pulses": 1500.0 + 400.0 * share,
        }[unit]

    assert errors(found_with(fault, "otter", manoeuvre))[0] in ("shaft-unit", "shaft-pwm")


def test_units_are_named_where_the_boat_does_not_move() -> None:
    sound, boat = simulated("otter", "random")
    z = sound.z.copy()
    z[:, [X, Y]] = 0.01 * np.random.default_rng(0).standard_normal((len(z), 2))
    cmd = 60.0 * sound.cmd
    codes = {f.code for f in diagnose(dataclasses.replace(sound, z=z, cmd=cmd), boat).findings}
    assert "shaft-unit" in codes


def test_wrong_unit_of_time_is_the_only_error() -> None:
    """Before, gyro and shaft speeds were blamed first."""
    sound, boat = simulated("otter", "random")
    t = 1000.0 * sound.t
    found = list(diagnose(dataclasses.replace(sound, t=t, stamps=t), boat).findings)
    assert errors(found) == ["time-unit"]
