"""All detectors on one log: what was measured, and what is wrong."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from twin.channels import COMMANDS, MEASUREMENTS
from twin.logs.columns import UNITS, Array
from twin.logs.diagnosis.attitude import (
    check_attitude,
    is_three_axis,
    unchecked_axes,
    upright,
)
from twin.logs.diagnosis.commands import check_commands
from twin.logs.diagnosis.findings import ERROR, NOTE, SEVERITIES, WARNING, Finding, Recording
from twin.logs.diagnosis.fixes import find_stands, within
from twin.logs.diagnosis.forces import check_forces
from twin.logs.diagnosis.heading import (
    GyroFit,
    check_dead,
    check_heading,
    dead_columns,
    gyro_lag,
    gyro_on_compass,
)
from twin.logs.diagnosis.imu import TILTED, ImuFit, check_imu, imu_on_fixes
from twin.logs.diagnosis.position import (
    StampFit,
    VelocityFit,
    agrees,
    check_position,
    exchanged,
    find_jumps,
    fix_stamps,
    velocity_on_fixes,
)
from twin.logs.diagnosis.signals import ENOUGH, Lag, white_noise
from twin.logs.diagnosis.signs import Effect, check_each_side, check_signs, turned_by, yaw_effects
from twin.logs.diagnosis.timing import check_timing, sensor_rates
from twin.logs.diagnosis.track import TrackFit, compass_on_track, thrust
from twin.particulars import Particulars
from usv_kernel.channels import GYRO

__all__ = [
    "Diagnosis",
    "Measured",
    "diagnose",
    "measure",
    "without_jumps",
]


_TILT_NOISE = {
    "tilt_radps": ("gyro_x_radps", "gyro_y_radps"),
    "lift_mps2": ("accel_z_mps2",),
    "ahrs_rad": ("ahrs_roll_rad", "ahrs_pitch_rad"),
    "height_m": ("gps_z_m",),
    "climb_mps": ("gps_vz_mps",),
}


_CAUSES = (
    "time-empty",
    "time-back",
    "time-unit",
    "position-degrees",
    "position-exchanged",
    "compass-degrees",
    "compass-reversed",
    "track-mirrored",
)
"""What other findings follow from, in this order."""

_NO_SIGN = {"commands-missing", "shaft-pwm"}
"""Faults of commands that leave nothing to tell their signs by."""

_TURNS_AXES = {
    "compass-degrees",
    "compass-reversed",
    "compass-sign",
    "track-mirrored",
}
"""Faults of the heading that turn the axes of sound accelerometers."""

_SAME = math.radians(30.0)
"""Angles of track and accelerometers that differ by less have one cause, rad."""

_MARKS = (999.0, 9999.0, 99999.0, 999999.0)
"""Programs write these numbers, of either sign, where there is no value."""

_FACTORS = sorted({factor for units in UNITS.values() for factor in units.values()})
"""By which a column may have been multiplied when it was read."""

_AGAIN, _DIGITS = 3, 1e-9
"""A mark stands so many times or more; it is the same within this share."""

_OF_RATES = {"gyro-scale", "gyro-degrees", "speed-unit", "shaft-unit", "shaft-speed"}
"""Findings that a wrong unit of time feigns."""

_TIMELESS = {
    "too-short",
    "sensor-empty",
    "sensor-dead",
    "infinite",
    "command-empty",
    "position-degrees",
    "compass-degrees",
    "angle-degrees",
    "shaft-pwm",
}
"""Findings that rest on no time."""


@dataclass(frozen=True)
class Measured:
    """What the sensors of a log are like, as far as it tells.

    Parameters
    ----------
    rates : dict of str to float
        New samples a second of each sensor, Hz; 0 for none.
    noise : dict of str to float
        White noise of each sensor, from sample to sample, in its unit.
    stamps, velocity, track, gyro, imu
        Comparisons of sensors with each other; None where there is nothing to compare.
    effects : dict of str to Effect
        What the commands do to the yaw rate.
    lags : dict of str to Lag
        Correlation of sensors at each lag.
    unchecked : tuple of str, optional
        Columns of a three-axis IMU whose axis and sign the log does not tell; None for no such IMU.
    """

    rates: dict[str, float]
    noise: dict[str, float]
    stamps: StampFit | None
    velocity: VelocityFit | None
    track: TrackFit | None
    gyro: GyroFit | None
    imu: ImuFit | None
    effects: dict[str, Effect]
    lags: dict[str, Lag]
    unchecked: tuple[str, ...] | None = None


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What :func:`diagnose` returns.

    Parameters
    ----------
    recording : Recording
        The log, without fixes that no boat can reach.
    measured : Measured
        What its sensors are like.
    findings : tuple of Finding
        Errors first, then warnings and notes.
    """

    recording: Recording
    measured: Measured
    findings: tuple[Finding, ...]

    def of(self, severity: str) -> list[Finding]:
        """Return the findings of one severity."""
        return [finding for finding in self.findings if finding.severity == severity]

    def to_json(self) -> dict[str, Any]:
        """Return everything as plain numbers and texts; NaN becomes None."""
        fits = ("stamps", "velocity", "track", "gyro", "imu")
        measured = self.measured
        return {
            "name": self.recording.name,
            "rows": len(self.recording.stamps),
            "rates_hz": measured.rates,
            "noise": _plain(measured.noise),
            **{
                name: None if fit is None else _plain(fit._asdict())
                for name in fits
                for fit in [getattr(measured, name)]
            },
            "unchecked": None if measured.unchecked is None else list(measured.unchecked),
            "effects": {name: _plain(e._asdict()) for name, e in measured.effects.items()},
            "findings": [
                {**dataclasses.asdict(finding), "evidence": _plain(dict(finding.evidence))}
                for finding in self.findings
            ],
        }


def _plain(numbers: dict[str, Any]) -> dict[str, float | None]:
    return {k: float(v) if math.isfinite(v) else None for k, v in numbers.items()}


def without_jumps(recording: Recording) -> Recording:
    """Return a recording in which fixes that no boat can reach from the others are NaN."""
    jumps = find_jumps(recording.t, recording.z[:, :2])
    if jumps is None:
        return recording
    z = recording.z.copy()
    z[jumps.lost, :2] = np.nan
    return dataclasses.replace(recording, z=z)


def without_stands(recording: Recording) -> Recording:
    """Return a recording in which fixes that stand still while the boat goes are NaN.

    Parameters
    ----------
    recording : Recording
        Without jumps.
    """
    stands = find_stands(recording, *recording.samples("gps_x_m", "gps_y_m"))
    if not stands:
        return recording
    z = recording.z.copy()
    z[within(recording.t, stands), :2] = np.nan
    return dataclasses.replace(recording, z=z)


def without_fixes(recording: Recording) -> Recording:
    """Return a recording without positions."""
    z = recording.z.copy()
    z[:, :2] = np.nan
    return dataclasses.replace(recording, z=z)


def without_velocity(recording: Recording) -> Recording:
    """Return a recording without velocities over ground."""
    z = recording.z.copy()
    z[:, 2:4] = np.nan
    return dataclasses.replace(recording, z=z)


def measure(recording: Recording) -> Measured:
    """Return what the sensors of a log are like.

    Parameters
    ----------
    recording : Recording
        Without jumps.
    """
    fix = recording.samples("gps_x_m", "gps_y_m")
    velocity = recording.samples("gps_vx_mps", "gps_vy_mps")
    t, compass = recording.samples("compass_rad")
    t_gyro, gyro = recording.samples("gyro_radps")
    accel = recording.samples("accel_x_mps2", "accel_y_mps2")
    psi = np.unwrap(compass[:, 0])
    noise = {
        "gps_m": _noise(*fix),
        "velocity_mps": _noise(*velocity),
        "compass_rad": _noise(t, psi[:, None]),
        "gyro_radps": _noise(t_gyro, gyro),
        "accel_mps2": _noise(*accel),
        **{key: _noise(*recording.samples(*names)) for key, names in _TILT_NOISE.items()},
    }
    way = velocity_on_fixes(fix, velocity)
    # a velocity that contradicts the fixes would blame the accelerometers
    moved = imu_on_fixes(recording if agrees(way) else without_velocity(recording))
    turned = gyro_lag(t, psi, t_gyro, gyro[:, 0])
    lags = {"gyro behind compass": turned, "GPS behind accelerometers": moved and moved[1]}
    return Measured(
        sensor_rates(recording),
        noise,
        fix_stamps(*fix),
        way,
        compass_on_track(fix, (t, psi), thrust(recording)),
        gyro_on_compass(t, psi, t_gyro, gyro[:, 0]),
        moved[0] if moved else None,
        yaw_effects(recording),
        {name: lag for name, lag in lags.items() if lag is not None},
    )


def _noise(t: Array, values: Array) -> float:
    """Return the white noise of a channel, or the mean of two."""
    if len(t) < ENOUGH:
        return math.nan
    each = [white_noise(t, column) for column in values.T]
    return math.sqrt(sum(sd * sd for sd in each) / len(each))


def diagnose(recording: Recording, particulars: Particulars | None = None) -> Diagnosis:
    """Run all detectors on a log.

    Parameters
    ----------
    recording : Recording
        Columns before any repair.
    particulars : Particulars, optional
        Of the boat; units of the shaft speed and the delay of the GPS are held against them.

    Returns
    -------
    Diagnosis
    """
    recording, marks = _without_marks(recording)
    whole, dead = recording, check_dead(recording)
    recording = _without_dead(recording)  # one would be named again by each comparison
    timing = check_timing(recording)
    found = _cells(whole, timing) + marks + dead + timing
    gps_sd = 0.0 if particulars is None else particulars.instruments.gps_sd
    kept, swapped = exchanged(without_jumps(recording))
    position = swapped + check_position(kept if swapped else recording, gps_sd)
    clean = without_stands(kept)  # they would blame the velocity, the compass and the commands
    if any(finding.code == "position-degrees" for finding in position):
        # ways in degrees would blame the commands
        clean = without_fixes(recording)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        tilt = check_attitude(clean, particulars)
        # roll and pitch that are sound are taken out of the other sensors
        level = clean if any(finding.severity == ERROR for finding in tilt) else upright(clean)
        measured = dataclasses.replace(measure(level), unchecked=unchecked_axes(clean, particulars))
        side, mended = check_each_side(clean)
        headed = dataclasses.replace(level, cmd=mended.cmd)
        heading = check_heading(headed, turned_by(mended))
        moved = check_imu(measured.imu, level, particulars)
        if any("gain" in finding.evidence for finding in tilt):
            moved = []  # faults of axes explain what they show
        elif level is clean and is_three_axis(clean):
            # the accelerometers of a boat that rolls also show its tilt
            moved = [finding for finding in moved if finding.code not in TILTED]
        heading_left, moved = _by_compass(heading, moved)
        if any(finding.code == "track-mirrored" for finding in heading):
            # fixes that turn against the compass turn against the velocity as well
            position = [finding for finding in position if finding.code != "velocity-mirrored"]
        found += position + _of_own_cause(heading_left, tilt) + tilt + moved
        commands = check_commands(clean, particulars)
        few = len(clean.t) < ENOUGH
        if not few and not any(finding.code in _NO_SIGN for finding in commands):
            signs = check_signs(mended, heading)
            unchecked = any(finding.code == "commands-unchecked" for finding in signs)
            commands += signs if unchecked else side + signs
        found += commands + _without_spin(check_forces(clean), heading)
    first: dict[str, Finding] = {}
    for finding in _by_cause(found):
        first.setdefault(finding.code, finding)
    order = sorted(first.values(), key=_rank)
    return Diagnosis(kept, measured, tuple(order))


def _rank(finding: Finding) -> tuple[int, int]:
    """Return the place of a finding: severe ones first, and a cause before what follows from it."""
    before = _CAUSES.index(finding.code) if finding.code in _CAUSES else len(_CAUSES)
    return SEVERITIES.index(finding.severity), before


def _by_cause(found: list[Finding]) -> list[Finding]:
    """Return findings without those that a wrong unit of time explains."""
    codes = {finding.code for finding in found}
    if "time-unit" not in codes or not codes & _OF_RATES:
        return found
    left = []
    for finding in found:
        if finding.code == "time-unit":
            remedy = f"{finding.remedy}; all rates and speeds rest on it, so check again then"
            left.append(dataclasses.replace(finding, severity=ERROR, remedy=remedy))
        elif finding.code in _TIMELESS or finding.code.startswith("time-"):
            left.append(finding)
    return left


def _of_own_cause(heading: list[Finding], tilt: list[Finding]) -> list[Finding]:
    """Return findings of the heading without those that faults of the IMU's axes explain."""
    named = {finding.code for finding in tilt if "gain" in finding.evidence}
    if not named & {"gyro-swapped", "tilt-unit", "tilt-scale"}:
        return heading
    return [finding for finding in heading if not finding.code.startswith("gyro-")]


def _without_spin(forces: list[Finding], heading: list[Finding]) -> list[Finding]:
    """Return findings of forces without turns that a compass in degrees feigns."""
    if not any(finding.code == "compass-degrees" for finding in heading):
        return forces
    return [finding for finding in forces if finding.code != "spin"]


def _by_compass(
    heading: list[Finding], moved: list[Finding]
) -> tuple[list[Finding], list[Finding]]:
    """Return findings of heading and accelerometers without axes that a wrong compass feigns.

    Accelerations are turned by the compass before they are held against the fixes. Where they show
    the same angle as the track, two sensors speak against the compass.
    """
    left, sure = [], False
    for finding in moved:
        turned = finding.evidence.get("turned", 0.0)
        follows = finding.code in TILTED and any(
            fault.severity != NOTE
            and (
                fault.code in _TURNS_AXES
                or (fault.code == "compass-offset" and _same(fault.evidence["steady"], turned))
            )
            for fault in heading
        )
        sure |= follows and finding.code == "accel-axes"
        left += [] if follows else [finding]
    if sure:
        heading = [
            dataclasses.replace(
                fault,
                severity=ERROR,
                what=fault.what + "; the accelerometers show the same angle",
            )
            if fault.code == "compass-offset"
            else fault
            for fault in heading
        ]
    return heading, left


def _same(first: float, second: float) -> bool:
    """Return whether two angles are about the same, rad."""
    return math.cos(first - second) > math.cos(_SAME)


def _without_marks(recording: Recording) -> tuple[Recording, list[Finding]]:
    """Return a recording without numbers that stand for "no value", and a finding about each."""
    z, found = recording.z.copy(), []
    speed = np.hypot(recording.z[:, 2], recording.z[:, 3])
    for names, values in [
        *(((name,), recording.z[:, j]) for j, name in enumerate(MEASUREMENTS)),
        # made of speed and course, a mark is in both
        (("gps_vx_mps", "gps_vy_mps"), speed),
    ]:
        seen, count = np.unique(values[np.isfinite(values)], return_counts=True)
        often = np.flatnonzero(count >= _AGAIN)
        # times a factor, the last digits may differ
        mark = next((m for i in often if (m := _mark_of(float(seen[i]), seen, count))), None)
        if mark is None:
            continue
        rows = np.abs(values - mark[0]) < _DIGITS * abs(mark[0])
        for name in names:
            z[rows, MEASUREMENTS.index(name)] = np.nan
        sign = "plus or minus " if len(names) > 1 else ""  # a speed along a course has lost it
        what = (
            f"{recording.called(*names)}: {rows.sum()} of {np.isfinite(values).sum()} values are "
            f'{sign}{mark[1]:g}, far from all others: a mark for "no value"'
        )
        remedy = "leave these cells empty; here they are left out, and the rest is checked"
        evidence = {"mark": mark[1], "rows": float(rows.sum())}
        found.append(Finding(ERROR, f"no-value-{names[0]}", what, remedy, evidence))
    return (dataclasses.replace(recording, z=z), found) if found else (recording, [])


def _mark_of(value: float, seen: Array, count: npt.NDArray[np.intp]) -> tuple[float, float] | None:
    """Return a value and the mark that it is in the unit of the file, if it is one."""
    same = np.abs(seen - value) < _DIGITS * abs(value)
    others = np.repeat(seen[~same], count[~same])
    if len(others) < ENOUGH:
        return None
    # a mark of its own in another column may have spoilt a few of the others
    low, high = np.quantile(others, [0.01, 0.99])
    if max(low - value, value - high) < high - low:
        return None
    for factor in _FACTORS:
        for mark in _MARKS:
            if abs(abs(value) - mark * factor) < _DIGITS * abs(value):
                return value, math.copysign(mark, value)
    return None


def _without_dead(recording: Recording) -> Recording:
    """Return a recording without fixes, velocity, heading and yaw rate that never change."""
    dead = [j for j in dead_columns(recording) if j <= GYRO]
    if not dead:
        return recording
    z = recording.z.copy()
    z[:, dead] = np.nan
    return dataclasses.replace(recording, z=z)


def _cells(recording: Recording, timing: list[Finding]) -> list[Finding]:
    """Return findings about too few rows, sensors without a sample and infinite cells.

    Rows that are few for what ``timing`` says already are no second finding.
    """
    if len(recording.t) < ENOUGH:
        if any(finding.severity == ERROR for finding in timing) and len(recording.stamps) >= ENOUGH:
            return []  # there are rows enough, but not in the order of their times
        what = f"{len(recording.t)} rows with a time of their own"
        return [Finding(ERROR, "too-short", what, "record for longer: some minutes, with turns")]
    found = []
    for name in ("gps_x_m", "compass_rad"):
        count = int(np.isfinite(recording.z[:, MEASUREMENTS.index(name)]).sum())
        if count < ENOUGH:
            what = f"{recording.called(name)}: {count} samples"
            remedy = "position and heading are needed"
            found.append(Finding(ERROR, "sensor-empty", what, remedy, {"samples": count}))
    if recording.infinite:
        what = f"{recording.infinite} cells are infinite"
        found.append(Finding(ERROR, "infinite", what, "leave cells without a value empty"))
    empty = int(np.isnan(recording.cmd[:, : len(COMMANDS)]).any(axis=1).sum())
    if empty:
        what = f"{empty} of {len(recording.t)} rows come before the first command"
        remedy = "fill in the commands in force, or remove these rows"
        found.append(Finding(WARNING, "command-empty", what, remedy, {"rows": empty}))
    return found
