"""Simple faults of an IMU, and the one that explains the evidence best.

Every fault is a pair of matrices: signed permutations, factors of columns, turns about the third
axis. Factors and angles are fitted. Each fault holds all along, or for one stretch of the log.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from twin.logs.columns import Array
from twin.logs.diagnosis.axes.evidence import Evidence
from twin.particulars import GRAVITY

__all__ = ["ACCELEROMETERS", "GYROS", "SOUND", "Fault", "Verdict", "explain", "unchecked"]

SOUND = np.concatenate([np.eye(3).ravel(), np.eye(3).ravel()])
"""Both matrices of an IMU without a fault."""

GYROS, ACCELEROMETERS = 0, 1

_TURNS = np.radians(np.arange(-175.0, 181.0, 5.0))

_UNITS = (
    (math.pi / 180.0, 1e-3, math.pi / 180e3),
    (GRAVITY, GRAVITY / 1e3),
)
"""Factors of units: deg/s, mrad/s, millidegrees/s; g, milli-g."""

_SLIGHT, _WEAK, _LEAST_FACTOR = 1.3, 2.5, 0.05
"""Smaller factors are no faults, of gyros; of horizontal accelerometers, which heel and noise
blur; and a column with one of less than the third, or more than its inverse, shows no motion."""

_DAMPED = 0.6, 1.05
"""Noise, and motion that the equations leave out, make horizontal forces look so many times as
large."""

_LEAST_TURN = math.radians(15.0), math.radians(6.0)
"""Smaller turns about the third axis are no faults, of one sensor and of the whole IMU."""

_GAIN, _SHARE, _SHARE_TURNED, _SHARE_FITTED = 60.0, 0.1, 0.03, 0.5
"""A fault is one if it explains more than so many variances, and so large a share of those left:
exchanges, signs and units; small turns; factors that no unit has."""

_TOGETHER = 30.0
"""What it costs to blame one column more: one that hardly moves fits as well with any factor."""

_FAINT = 0.2
"""Columns with smaller factors may as well show nothing."""

_EVIDENT = 20.0
"""What explains so many times what is left is no accident."""

_GAP = 0.7
"""It must leave no larger share of what the best matrices explain."""

_PART, _PART_SHARE, _CLEAR = 100.0, 0.1, 0.5
"""A fault is of one stretch if that explains so much more, also as a share, than all along, and
so large a share of what it leaves there."""

_OTHER, _OTHER_SHARE = 15.0, 0.02
"""Two faults that explain alike, to so many variances or such a share, look alike."""

_BAD, _TYPICAL = 2.5, 0.25
"""Windows with so many times the errors of the sounder ones, this share, are tried alone."""


class Fault(NamedTuple):
    """What undoes a fault: the matrices, and how they came about."""

    kind: str  # factor, axes, turned, ahrs
    sensors: tuple[int, ...]  # GYROS, ACCELEROMETERS or both
    columns: tuple[int, ...]  # of each sensor, that the fault concerns
    # factors of the columns, 0 for those too small to tell; or the angle, rad
    values: tuple[float, ...]
    matrices: Array  # (18,)
    variant: int  # of the signs of the AHRS
    cost: float  # of assuming it


class Verdict(NamedTuple):
    """A fault that explains the evidence."""

    fault: Fault
    span: tuple[int, int] | None  # windows, first and after the last; None for all
    gain: float  # squared errors less than of a sound IMU, in units of the variance
    other: Fault | None  # another fault that explains nearly as much


def _permutations() -> Iterator[tuple[Array, float, tuple[int, ...]]]:
    """Return signed permutations, what they cost, and the columns that they move or turn."""
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            matrix = np.zeros((3, 3))
            matrix[range(3), order] = signs
            moved = sum(k != place for k, place in enumerate(order))
            turned = sum(sign < 0.0 for sign in signs)
            if not moved and not turned:
                continue
            proper = np.linalg.det(matrix) > 0.0
            cost = 2.0 * moved + 4.0 * turned - (4.0 if proper and turned else 0.0)
            wrong = tuple(j for j in range(3) if matrix[j, j] != 1.0)
            yield matrix, cost, wrong


def _with(sensors: tuple[int, ...], matrix: Array) -> Array:
    """Return both matrices with those of some sensors replaced."""
    m = SOUND.copy()
    for sensor in sensors:
        m[9 * sensor : 9 * sensor + 9] = matrix.ravel()
    return m


def _scaled(sensor: int, columns: tuple[int, ...], factors: tuple[float, ...]) -> Array:
    """Return both matrices with columns of a sensor multiplied."""
    diagonal = np.ones(3)
    diagonal[list(columns)] = factors
    return _with((sensor,), np.diag(diagonal))


def _turned(angle: float) -> Array:
    """Return the matrix that undoes a turn about the third axis."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _fixed(evidence: Evidence) -> Iterator[Fault]:
    """Return the faults without a number to fit."""
    for matrix, cost, wrong in _permutations():
        single = len(wrong) == 1
        for sensors in ((GYROS,), (ACCELEROMETERS,), (GYROS, ACCELEROMETERS)):
            if len(sensors) == 2 and np.linalg.det(matrix) < 0.0:
                continue
            yield Fault(
                "factor" if single else "axes",
                sensors,
                wrong,
                (-1.0,) if single else (),
                _with(sensors, matrix),
                0,
                cost,
            )
    if not evidence.ahrs:
        return
    for variant in range(1, evidence.rest.shape[0]):
        yield Fault("ahrs", (), (0, 1), (), SOUND.copy(), variant, 6.0)
    for variant, columns in ((1, (0,)), (2, (1,)), (3, (0, 1))):
        both = _scaled(GYROS, columns, (-1.0,) * len(columns))
        yield Fault("ahrs", (GYROS,), columns, (), both, variant, 8.0)


def _groups(sensor: int) -> Iterator[tuple[tuple[int, ...], ...]]:
    """Return groups of columns of a sensor that share a factor."""
    for count in (1, 2, 3):
        yield from ((columns,) for columns in itertools.combinations(range(3), count))
    if sensor == GYROS:  # those of accelerometers hardly tell more than one factor
        for count in (2, 3):
            for columns in itertools.combinations(range(3), count):
                yield tuple((j,) for j in columns)


def _of_factors(evidence: Evidence, inside: slice) -> Iterator[Fault]:
    """Return the faults of factors: those of units, and as they fit some windows best."""
    for sensor in (GYROS, ACCELEROMETERS):
        for groups in _groups(sensor):
            columns = tuple(j for group in groups for j in group)
            extra = _TOGETHER * (len(columns) - 1)
            for factor in _UNITS[sensor] if len(groups) == 1 else ():
                values = (factor,) * len(columns)
                matrices = _scaled(sensor, columns, values)
                yield Fault("factor", (sensor,), columns, values, matrices, 0, 5.0 + extra)
            values = _fit_factors(evidence, inside, sensor, groups)
            if _is_plausible(sensor, columns, values):
                cost = 10.0 * len(groups) + extra
                matrices = _scaled(sensor, columns, values)
                yield Fault("factor", (sensor,), columns, values, matrices, 0, cost)


def _is_plausible(sensor: int, columns: tuple[int, ...], values: tuple[float, ...]) -> bool:
    """Return whether factors are those of a fault, not of noise or of what is left out."""
    for j, value in zip(columns, values, strict=True):
        least = _WEAK if sensor == ACCELEROMETERS and j < 2 else _SLIGHT
        if not _LEAST_FACTOR < abs(value) < 1.0 / _LEAST_FACTOR:
            return False
        if value > 0.0 and 1.0 / least < value < least:
            return False
    return True


def _fit_factors(
    evidence: Evidence, inside: slice, sensor: int, groups: tuple[tuple[int, ...], ...]
) -> tuple[float, ...]:
    """Return the factors of columns that fit some windows best, horizontal forces damped."""
    square, cross = (part[0, inside].sum(axis=0) for part in (evidence.square, evidence.cross))
    columns = tuple(j for group in groups for j in group)
    base = _scaled(sensor, columns, (0.0,) * len(columns))
    ways = np.array(
        [
            _scaled(sensor, group, (1.0,) * len(group))
            - _scaled(sensor, group, (0.0,) * len(group))
            for group in groups
        ]
    )
    damp = np.ones(18)
    values: tuple[float, ...] = ()
    for _ in range(3):
        parts, known = damp * ways, damp * base
        normal, right = parts @ square @ parts.T, parts @ (cross - square @ known)
        fitted = np.linalg.lstsq(normal, right, rcond=1e-12)[0]
        values = tuple(
            float(value) for group, value in zip(groups, fitted, strict=True) for _ in group
        )
        damp[9:15] = _damping(square, cross, _scaled(sensor, columns, values))
    return values


def _of_turns(square: Array, cross: Array) -> Iterator[Fault]:
    """Return turns about the third axis, as they fit normal equations best."""
    for sensors in ((GYROS,), (ACCELEROMETERS,), (GYROS, ACCELEROMETERS)):

        def error(angle: float, sensors: tuple[int, ...] = sensors) -> float:
            m = _with(sensors, _turned(angle))
            return float(m @ square @ m - 2.0 * cross @ m)

        best = float(min(_TURNS, key=error))
        for width in (2.5, 1.0, 0.5, 0.2):
            step = math.radians(width)
            best = min((best + k * step for k in range(-2, 3)), key=error)
        matrices = _with(sensors, _turned(best))
        yield Fault("turned", sensors, (0, 1), (best,), matrices, 0, 6.0)


def _candidates(evidence: Evidence, inside: slice) -> Iterator[Fault]:
    """Return all faults, fitted to some windows."""
    square, cross = (part[0, inside].sum(axis=0) for part in (evidence.square, evidence.cross))
    yield from _fixed(evidence)
    yield from _of_factors(evidence, inside)
    yield from _of_turns(square, cross)


def _damping(square: Array, cross: Array, m: Array) -> float:
    """Return the factor of horizontal forces that fits best."""
    moving, rest = np.zeros(18), m.copy()
    moving[9:15], rest[9:15] = m[9:15], 0.0
    power = float(moving @ square @ moving)
    share = float(moving @ (cross - square @ rest)) / max(power, 1e-300)
    return min(max(share, _DAMPED[0]), _DAMPED[1])


def _damped(evidence: Evidence, m: Array, variant: int, inside: slice) -> Array:
    """Return matrices (18,) with the horizontal forces damped as it fits some windows best."""
    square, cross = (part[variant, inside].sum(axis=0) for part in evidence[1:3])
    damped = m.copy()
    damped[9:15] *= _damping(square, cross, m)
    return damped


def _best_span(gain: Array) -> tuple[int, int]:
    """Return where the sum of gains is largest: first, and after the last."""
    total = np.concatenate([[0.0], np.cumsum(gain)])
    lowest = np.minimum.accumulate(total)
    end = int(np.argmax(total - lowest))
    return int(np.argmin(total[: end + 1])), end


def explain(evidence: Evidence) -> Verdict | None:
    """Return the fault that explains the evidence best; None where a sound IMU does."""
    whole = slice(None)
    square, cross = (part[0].sum(axis=0) for part in evidence[1:3])
    sound = evidence.errors(_damped(evidence, SOUND, 0, whole))
    left = float(sound.sum())
    free = float(evidence.errors(np.linalg.lstsq(square, cross, rcond=1e-9)[0]).sum())
    scored = []
    for fault in _candidates(evidence, whole):
        m = _damped(evidence, fault.matrices, fault.variant, whole)
        errors = float(evidence.errors(m, fault.variant).sum())
        scored.append((left - errors - fault.cost, fault))
    part = _explain_part(evidence, sound)
    most = max(pair[0] for pair in scored)
    if part is not None and part.gain > (1.0 + _PART_SHARE) * max(most, 0.0) + _PART:
        return part
    scored = [pair for pair in scored if _is_fault(evidence, pair[1], pair[0], (left, free))]
    if not scored:
        return None
    gain, fault = max(scored, key=lambda pair: pair[0])
    if not _is_seen(evidence, fault):
        unknown = fault._replace(values=(0.0,) * len(fault.values))
        return Verdict(unknown, None, gain, None)
    near = gain - max(_OTHER, _OTHER_SHARE * gain)
    others = [pair for pair in scored if pair[0] > near and _differ(pair[1], fault)]
    return Verdict(fault, None, gain, max(others, key=lambda pair: pair[0])[1] if others else None)


def _needed(fault: Fault) -> float:
    """Return the share of what is left that a fault must explain."""
    if fault.kind == "turned" and len(fault.sensors) == 2:
        return _SHARE_TURNED
    units = (*_UNITS[GYROS], *_UNITS[ACCELEROMETERS], -1.0)
    fitted = any(value not in units for value in fault.values)
    return _SHARE_FITTED if fault.kind == "factor" and fitted else _SHARE


def _is_fault(evidence: Evidence, fault: Fault, gain: float, errors: tuple[float, float]) -> bool:
    """Return whether a fault explains enough, with the errors of a sound IMU and the least."""
    left, free = errors
    after = left - gain
    if gain < _GAIN + _needed(fault) * after or after - free > _GAP * (left - free) + _GAIN:
        return False
    if fault.kind == "turned":
        return abs(fault.values[0]) >= _LEAST_TURN[len(fault.sensors) - 1]
    # no other fault makes so much noise
    return gain > _EVIDENT * after or _is_seen(evidence, fault)


def _is_seen(evidence: Evidence, fault: Fault) -> bool:
    """Return whether columns of another unit show motion, not only less than they did."""
    if fault.kind != "factor" or max(abs(value) for value in fault.values) > _FAINT:
        return True
    whole = slice(None)
    none = _scaled(fault.sensors[0], fault.columns, (0.0,) * len(fault.columns))
    without, with_it = (
        float(evidence.errors(_damped(evidence, m, 0, whole)).sum()) for m in (none, fault.matrices)
    )
    return without - with_it > 0.5 * _GAIN


def _differ(one: Fault, other: Fault) -> bool:
    """Return whether two faults concern other columns."""
    first, second = (
        {(sensor, j) for sensor in fault.sensors for j in fault.columns} or {(-1, fault.variant)}
        for fault in (one, other)
    )
    return not (first <= second or second <= first)


def _explain_part(evidence: Evidence, sound: Array) -> Verdict | None:
    """Return the fault that explains one stretch of a log, if any."""
    typical = float(np.quantile(sound, _TYPICAL))
    bad = np.flatnonzero(sound > _BAD * max(typical, 1.0))
    if not len(bad):
        return None
    best: Verdict | None = None
    for first, last in {(int(bad[0]), int(bad[-1]) + 1), _longest(bad)}:
        for fault in _candidates(evidence, slice(first, last)):
            if not fault.sensors or any(abs(value) < _LEAST_FACTOR for value in fault.values):
                continue  # a unit does not change on the way
            m = _damped(evidence, fault.matrices, fault.variant, slice(first, last))
            gains = sound - evidence.errors(m, fault.variant)
            start, end = _best_span(gains)
            gain = float(gains[start:end].sum()) - fault.cost
            after = float(sound[start:end].sum()) - gain
            enough = gain > _PART + _CLEAR * after and end - start < len(sound)
            if enough and (best is None or gain > best.gain):
                best = Verdict(fault, (start, end), gain, None)
    return best


def _longest(bad: npt.NDArray[np.int64]) -> tuple[int, int]:
    """Return the longest run of windows."""
    runs = np.split(bad, np.flatnonzero(np.diff(bad) > 1) + 1)
    run = max(runs, key=len)
    return int(run[0]), int(run[-1]) + 1


def unchecked(evidence: Evidence) -> list[tuple[int, int]]:
    """Return sensor and column of each axis whose sign the log does not tell."""
    found = []
    for sensor in (GYROS, ACCELEROMETERS):
        for j in range(3):
            m = _scaled(sensor, (j,), (-1.0,))
            sound = float(evidence.errors(_damped(evidence, SOUND, 0, slice(None))).sum())
            wrong = float(evidence.errors(_damped(evidence, m, 0, slice(None))).sum())
            if wrong - sound < _GAIN + _SHARE * sound:
                found.append((sensor, j))
    return found
