"""What is wrong with the axes of an IMU, in words: one finding, its number and the remedy."""

from __future__ import annotations

import math

import numpy as np

from twin.logs.columns import Array
from twin.logs.diagnosis.axes.evidence import (
    FORCES,
    LATENCY,
    RATES,
    VARIANTS,
    Evidence,
    gather,
)
from twin.logs.diagnosis.axes.faults import (
    ACCELEROMETERS,
    GYROS,
    Fault,
    Verdict,
    explain,
    unchecked,
)
from twin.logs.diagnosis.findings import ERROR, WARNING, Finding, Recording
from twin.logs.diagnosis.signals import ENOUGH, white_noise
from twin.particulars import GRAVITY

__all__ = ["axes_unchecked", "check_axes"]

_ANGLES = "ahrs_roll_rad", "ahrs_pitch_rad"

_NAMES = RATES, FORCES

_NEAR = 0.12
"""A factor is that of a unit if it is no further off, as a share."""

_G_NOISE, _SIMILAR = (7.0, 14.0), 2.0
"""An axis in g has so many times less noise than the other two, which differ by no more than the
second."""

_UNIT_G = 'state unit = "g" for this column in a mapping file'

_AXES = "x is forward, y to starboard, z down, and rates are about them"

_MIRRORED = -3.0, -0.3
"""A factor between these is a wrong sign: where little moves it is not known better."""


def check_axes(
    recording: Recording, mounting: Array, late: float = LATENCY
) -> list[Finding] | None:
    """Return the fault that the axes of an IMU have, at most one; None where nothing tells.

    Parameters
    ----------
    recording, mounting, late
        As for :func:`~twin.logs.diagnosis.axes.evidence.gather`.
    """
    in_g = _check_noise(recording)
    if in_g:
        return in_g
    evidence = gather(recording, mounting, late)
    if evidence is None:
        return None
    verdict = explain(evidence)
    if verdict is None:
        return []
    fault, other, numbers = verdict.fault, verdict.other, {"gain": verdict.gain}
    if other is not None and fault.kind == "ahrs":
        fault, other = other, fault
    names = _columns(recording, fault)
    if verdict.span is not None:
        return [_for_a_while(evidence, verdict, names)]
    code, what, remedy = _words(recording, fault)
    if other is not None:
        what += f"; or {_columns(recording, other)}: {_words(recording, other)[1]}"
        what = f"{names}: {what}"
        remedy = f"the log cannot tell which: record waves from another side ({_AXES})"
        return [Finding(ERROR, code, what, remedy, numbers)]
    if fault.kind == "turned":
        numbers |= {"yaw_rad": fault.values[0], "sd_rad": _deviation(evidence, fault)}
    elif fault.kind == "factor":
        numbers |= {"factor": fault.values[0]}
    severity = WARNING if code == "imu-askew" and len(fault.sensors) == 2 else ERROR
    return [Finding(severity, code, f"{names}: {what}", remedy, numbers)]


def _check_noise(recording: Recording) -> list[Finding]:
    """Return whether one horizontal accelerometer has the noise of one in g."""
    t, force = recording.samples(*FORCES)
    if len(t) < 5 * ENOUGH:
        return []
    noise = [white_noise(t, column) for column in force.T]
    spread = force.std(axis=0)
    for k in range(2):
        others = noise[1 - k], noise[2]
        similar = 0.0 < max(others) < _SIMILAR * min(others)
        if not similar or not noise[k] > 0.0:
            continue
        ratio = math.sqrt(others[0] * others[1]) / noise[k]
        if _G_NOISE[0] < ratio < _G_NOISE[1] and 3.0 * spread[k] < max(spread[1 - k], spread[2]):
            what = (
                f"{recording.called(FORCES[k])}: noise and motion {ratio:.0f} times less than of "
                "the other axes: these are g"
            )
            return [Finding(ERROR, "accel-unit", what, _UNIT_G, {"ratio": ratio})]
    return []


def axes_unchecked(
    recording: Recording, mounting: Array, late: float = LATENCY
) -> tuple[str, ...] | None:
    """Return the columns of an IMU whose axis and sign a log does not tell; None for no IMU.

    Parameters
    ----------
    recording, mounting, late
        As for :func:`~twin.logs.diagnosis.axes.evidence.gather`.
    """
    if len(recording.samples(*RATES, *FORCES)[0]) == 0:
        return None
    evidence = gather(recording, mounting, late)
    if evidence is None:
        return tuple(recording.called(name) for name in (*RATES, *FORCES))
    return tuple(recording.called(_NAMES[sensor][j]) for sensor, j in unchecked(evidence))


def _columns(recording: Recording, fault: Fault) -> str:
    """Return what the file calls the columns that a fault concerns."""
    names = [_NAMES[sensor][j] for sensor in fault.sensors for j in fault.columns]
    if fault.kind == "ahrs":
        names = [_ANGLES[j] for j in fault.columns] + names
    return recording.called(*names)


def _for_a_while(evidence: Evidence, verdict: Verdict, names: str) -> Finding:
    """Return the finding of a fault that lasts for a stretch."""
    assert verdict.span is not None
    first, last = verdict.span
    begins = float(evidence.times[first])
    ends = float(evidence.times[last]) if last < len(evidence.times) else math.inf
    until = f"to {ends:.0f} s" if math.isfinite(ends) else "to the end"
    what = f"{names}: against the motion from about t = {begins:.0f} {until}, sound otherwise"
    numbers = {"from_s": begins, "to_s": ends, "gain": verdict.gain}
    return Finding(WARNING, "axis-faulty", what, "leave its cells empty there", numbers)


def _words(recording: Recording, fault: Fault) -> tuple[str, str, str]:
    """Return code, what is wrong, and the remedy."""
    if fault.kind == "ahrs":
        return _of_ahrs(recording, fault)
    if fault.kind == "turned":
        return _of_turn(fault)
    sensor = fault.sensors[0]
    if fault.kind == "axes":
        turn = _quarter_turn(fault)
        what = f"turned by {turn} degrees about the third axis" if turn else _exchanged(fault)
        remedy = f"{_AXES}: exchange the columns or turn their signs, or state imu_mounting"
        if len(fault.sensors) == 1:
            remedy = f"{_AXES}: {_recipe(recording, fault)}"
        return ("accel-swapped" if sensor == ACCELEROMETERS else "gyro-swapped"), what, remedy
    return _of_factors(recording, fault)


def _of_ahrs(recording: Recording, fault: Fault) -> tuple[str, str, str]:
    """Return the words for a fault of the AHRS."""
    variant = list(VARIANTS)[fault.variant]
    if variant == "in degrees":
        names = [name.replace("_rad", "_deg") for name in _ANGLES]
        return "ahrs-unit", "these are degrees", f"name the columns {', '.join(names)}"
    if "reversed" in variant:
        signs = "roll is above 0 with starboard down, pitch with the bow up; so are their rates"
        what = f"{variant} against the motion: a wrong sign"
        return "tilt-sign", what, signs
    remedy = "roll is about the axis ahead, pitch about that to starboard: exchange the columns"
    return "ahrs-axes", f"{variant} against the motion", remedy


def _of_turn(fault: Fault) -> tuple[str, str, str]:
    """Return the words for a turn about the third axis."""
    angle = fault.values[0]
    what = f"turned by {math.degrees(angle):.0f} degrees about the third axis"
    if len(fault.sensors) == 2:
        return (
            "imu-askew",
            what,
            f"if it is how the IMU is mounted, state imu_mounting = [0.0, 0.0, {angle:.3f}] in "
            "[instruments] of the particulars, or add it to the third angle there",
        )
    others = "accelerometers" if fault.sensors[0] == GYROS else "gyros"
    code = "imu-askew"
    remedy = f"the {others} are not: turn these columns by that angle before use"
    return code, what, remedy


def _quarter_turn(fault: Fault) -> int:
    """Return the angle of a turn about the third axis, degrees; 0 for any other exchange."""
    matrix = _matrix(fault)
    about_third = matrix[2, 2] == 1.0 and np.linalg.det(matrix[:2, :2]) > 0.0
    return round(math.degrees(math.atan2(matrix[1, 0], matrix[0, 0]))) if about_third else 0


def _matrix(fault: Fault) -> Array:
    """Return the matrix of the first sensor of a fault."""
    return fault.matrices.reshape(2, 3, 3)[fault.sensors[0]]


def _exchanged(fault: Fault) -> str:
    """Return which exchange of axes a fault is."""
    matrix = _matrix(fault)
    moved = any(matrix[j, j] == 0.0 for j in fault.columns)
    signs = (matrix < 0.0).any()
    if not moved:
        return "against the motion: they have the wrong sign"
    return "each fits the motion in the place of another" + (", with other signs" if signs else "")


def _recipe(recording: Recording, fault: Fault) -> str:
    """Return how the columns of one sensor are exchanged."""
    names, matrix = _NAMES[fault.sensors[0]], _matrix(fault)
    parts = []
    for j in fault.columns:
        k = int(np.argmax(np.abs(matrix[j])))
        sign = "-" if matrix[j, k] < 0.0 else ""
        parts.append(f"{names[j]} = {sign}{recording.called(names[k])}")
    return ", ".join(parts)


def _of_factors(recording: Recording, fault: Fault) -> tuple[str, str, str]:
    """Return the words for wrong factors of columns."""
    sensor = fault.sensors[0]
    names = [_NAMES[sensor][j] for j in fault.columns]
    values = fault.values
    gyros, yaw_only = sensor == GYROS, names == ["gyro_radps"]
    if not any(values):
        what = "far too large for the motion: in another unit, or noise"
        return "tilt-unit" if gyros else "accel-scale", what, "state the unit in a mapping file"
    if all(_MIRRORED[0] < value < _MIRRORED[1] for value in values):
        remedy = f"{_AXES}: turn the sign (scale = -1.0 in a mapping file)"
        code = "gyro-sign" if yaw_only else "tilt-sign"
        return code, "against the motion: it has the wrong sign", remedy
    same = max(values) - min(values) < 1e-9 * abs(values[0])
    value = values[0]
    if same and abs(value * 180.0 / math.pi - 1.0) < _NEAR and gyros:
        wanted = " and ".join(name.replace("_radps", "_degps") for name in names)
        what = "57 times too large for the motion: these are degrees per second"
        column = "column" if len(names) == 1 else "columns"
        return "gyro-degrees" if yaw_only else "tilt-unit", what, f"name the {column} {wanted}"
    if same and abs(value / GRAVITY - 1.0) < 0.4 and not gyros:
        what = "9.8 times too small for the motion: these are g"
        return "accel-unit", what, _UNIT_G
    parts = [f"{name} {1.0 / value:.3g} times" for name, value in zip(names, values, strict=True)]
    parts = parts[:1] if same else parts
    what = (
        f"as large as the motion: {', '.join(parts)}"
        if not same
        else (
            f"{1.0 / abs(value):.3g} times as large as the motion"
            + (", with the wrong sign" if value < 0.0 else "")
        )
    )
    if same and abs(value / 1e-3 - 1.0) < _NEAR and gyros:
        what, value = "1000 times too large for the motion: these are mrad/s", 1e-3
        values = (value,) * len(names)
    scales = ", ".join(
        f"{name}: scale = {value:.4g}" for name, value in zip(names, values, strict=True)
    )
    code = "accel-scale" if not gyros else "gyro-scale" if yaw_only else "tilt-scale"
    if gyros and same and not 0.1 < abs(value) < 10.0:
        code = "tilt-unit"
    return code, what, f"check unit and range of the sensor; in a mapping file {scales} corrects it"


def _deviation(evidence: Evidence, fault: Fault) -> float:
    """Return the standard deviation of the angle of a turn, rad."""
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    change = np.zeros(18)
    for sensor in fault.sensors:
        inside = slice(9 * sensor, 9 * sensor + 9)
        change[inside] = (turn @ fault.matrices[inside].reshape(3, 3)).ravel()
    known = float(change @ evidence.square[fault.variant].sum(axis=0) @ change)
    return 1.0 / math.sqrt(max(known, 1e-12))
