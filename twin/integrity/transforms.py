"""Simple faults of columns as hypotheses: what undoes each, and which explains a log best.

A hypothesis changes signals to what they were without its fault. Its evidence is the log-likelihood
by which sensors and commands agree better then (:mod:`twin.integrity.evidence`), less what it costs
to assume it. All compete; the best one is named and undone, and then the rest is judged anew. A
parameter is found where its likelihood is largest, with the interval in which it lies with 95 %.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from twin.channels import MEASUREMENTS
from twin.integrity.evidence import (
    BY_COMMANDS,
    FLOOR,
    Evidence,
    Signals,
    gain,
    log_likelihood,
    touched,
)
from twin.integrity.findings import ERROR, WARNING, Finding
from twin.integrity.instruments import Measured
from twin.logs.recording import Recording
from twin.particulars import GRAVITY

__all__ = [
    "Hypothesis",
    "Undone",
    "explain",
    "gps_delay",
    "gyro_bias",
    "hypotheses",
    "unseen_faults",
]

DEGREE = math.pi / 180.0

Undo = Callable[[Signals, float], Signals]
"""Returns signals without a fault, of a size."""

ENOUGH_GAIN = 12.0
"""Log-likelihood, beyond what a fault costs, from which on it is one."""

FIXED_COST, FITTED_COST = 3.0, 8.0
"""Of a fault without a number, and of one with a number that is fitted."""

ONE_SIDE = 25.0
"""Cost of a fault of one side: thrusts of both are seldom even."""

RIVAL = 3.0
"""A rival that explains a log so nearly as well is named beside the best."""

LIKELY = 0.6
"""What is left must shrink to this share in one comparison."""

PLAIN = 0.9
"""A fault without a number that explains so much of what a number does is preferred."""

MOST = 5
"""Faults of one log, at most."""


class Scan(NamedTuple):
    """Values of a parameter that are tried, and how far from nominal it is a fault."""

    nominal: float
    least: float
    values: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A fault of columns."""

    code: str
    sensor: str
    what: str  # with {size} where it has a number
    remedy: str
    changed: tuple[str, ...]  # the signals that it changes
    undo: Undo
    scan: Scan | None = None
    severity: str = ERROR
    shown: float = 1.0  # factor of the number, for people
    plus: float = 0.0  # what is added to it: the delay that is stated
    cost: float = 0.0  # of one that concerns several sensors at once
    each: float = 0.0  # of one that explains each window by itself, for each
    exact: bool = True  # whether the rows of a log are sound without it


def _set(s: Signals, **changed: object) -> Signals:
    return dataclasses.replace(s, **changed)  # type: ignore[arg-type]


def _by(name: str, factor: complex) -> Undo:
    """Return what multiplies a signal."""
    return lambda s, _: _set(s, **{name: getattr(s, name) * factor})


def _columns(name: str, matrix: list[list[float]]) -> Undo:
    """Return what makes columns of others."""
    return lambda s, _: _set(s, **{name: getattr(s, name) @ np.array(matrix).T})


def _diagonal(name: str, *factors: float) -> Undo:
    return lambda s, _: _set(s, **{name: getattr(s, name) * np.array(factors)})


def _from(angle: float, gyros: float = 1.0) -> Undo:
    """Return what makes a heading of one that counts from an angle, to port."""
    by = np.array([1.0, 1.0, gyros])
    return lambda s, _: _set(s, heading=angle - s.heading, gyros=s.gyros * by)


def _late(*names: str) -> Undo:
    return lambda s, seconds: s.late(seconds, *names)


def _turned(a: int, b: int, *names: str) -> Undo:
    """Return what turns columns a and b of sensors back."""

    def undo(s: Signals, angle: float) -> Signals:
        for name in names:
            s = _turn(s, angle, name, a, b)
        return s

    return undo


def _scaled_gyro(j: int) -> Undo:
    return lambda s, a: _set(s, gyros=s.gyros * np.where(np.arange(3) == j, a, 1.0))


def _with_rate(signs: list[float]) -> Undo:
    """Return what turns the sign of an angle and of its rate."""
    both = np.array(signs)
    return lambda s, _: _set(s, gyros=s.gyros * both, angles=s.angles * both[:2])


def _range(first: float, last: float, count: int) -> tuple[float, ...]:
    return tuple(np.linspace(first, last, count).tolist())


FRAME = 'frame = "enu" in the mapping, for one that runs from east'

AXES = "x is north and y is east"


def _of_heading() -> Iterator[Hypothesis]:
    """Return faults of the compass."""
    at = ("heading",)
    yield Hypothesis(
        "unit", "compass", "the heading is in degrees, not radians",
        'unit = "deg" for compass_rad in the mapping', at, lambda s, _: _degrees(s),
    )  # fmt: skip
    yield Hypothesis(
        "sign", "compass", "the heading runs counter-clockwise", f"scale = -1.0, or {FRAME}", at,
        _by("heading", -1.0),
    )  # fmt: skip
    for angle, side in ((0.5 * math.pi, "east"), (-0.5 * math.pi, "west")):
        yield Hypothesis(
            "axes", "compass", f"the heading counts from {side}, counter-clockwise", FRAME, at,
            _from(angle),
        )  # fmt: skip
        yield Hypothesis(
            "axes", "compass", f"heading and yaw rate count from {side}, counter-clockwise", FRAME,
            ("heading", "gyros"),
            _from(angle, -1.0),
            cost=2.0,
        )  # fmt: skip
    yield Hypothesis(
        "sign", "compass", "heading and yaw rate run counter-clockwise",
        "scale = -1.0 for both in the mapping", ("heading", "gyros"),
        lambda s, _: _diagonal("gyros", 1.0, 1.0, -1.0)(_set(s, heading=-s.heading), 0.0), cost=2.0,
    )  # fmt: skip
    yield Hypothesis(
        "offset", "compass", "the compass sits back to front: the boat goes where its stern points",
        "offset = 3.1416 for compass_rad in the mapping", at,
        lambda s, _: _set(s, heading=s.heading + math.pi),
    )  # fmt: skip
    yield Hypothesis(
        "offset", "compass", "the heading is {size} degrees off the motion, in any direction",
        "offset = {value} for compass_rad in the mapping (magnetic variation, or a sensor askew)",
        at, lambda s, a: _set(s, heading=s.heading + a),
        Scan(0.0, math.radians(10.0), _range(-0.95 * math.pi, 0.95 * math.pi, 13)), WARNING,
        1.0 / DEGREE,
    )  # fmt: skip
    yield Hypothesis(
        "late", "compass", "the heading comes {size} s late",
        "look for a filter of the compass; stamp samples when they are taken", at,
        lambda s, a: s.late(a, "heading"), Scan(0.0, 0.2, _range(0.0, 2.5, 9)), WARNING,
    )  # fmt: skip


def _degrees(s: Signals) -> Signals:
    """Return signals with a heading that was unwrapped as radians taken for degrees."""
    plain = np.radians(s.raw_heading)
    known = np.isfinite(plain)
    heading = np.full_like(plain, math.nan)
    heading[known] = np.unwrap(plain[known])
    return _set(s, heading=heading)


def _of_gps(latency: float) -> Iterator[Hypothesis]:
    """Return faults of fixes and velocity over ground."""
    for names, sensor, columns in (
        (("fix",), "fixes", "gps_x_m, gps_y_m"),
        (("velocity",), "velocity", "gps_vx_mps, gps_vy_mps"),
        (("fix", "velocity"), "gps", "fixes and velocity"),
    ):
        both = 2.0 * (len(names) - 1)

        def all_of(
            change: Callable[[np.ndarray], np.ndarray], names: tuple[str, ...] = names
        ) -> Undo:
            return lambda s, _: _set(s, **{name: change(getattr(s, name)) for name in names})

        for code, what, change in (
            ("axes", "north and east are swapped", lambda v: 1j * np.conj(v)),
            ("axes", "north has the wrong sign", lambda v: -np.conj(v)),
            ("axes", "east has the wrong sign", np.conj),
            ("sign", "both have the wrong sign", lambda v: -v),
        ):
            yield Hypothesis(
                code, sensor, f"{columns}: {what}", f"exchange or turn them in the mapping: {AXES}",
                names, all_of(change), cost=both + 2.0 * (code == "sign"), exact=names != ("fix",),
            )  # fmt: skip
    for factor, unit, remedy in (
        (1852.0 / 3600.0, "knots", 'unit = "kn"'),
        (1.0 / 3.6, "km/h", 'unit = "kmph"'),
        (0.3048, "ft/s", 'unit = "ftps"'),
        (0.01, "cm/s", "scale = 0.01"),
        (0.001, "mm/s", "scale = 0.001"),
        (3600.0 / 1852.0, "m/s taken for knots", "take the unit out"),
        (3.6, "m/s taken for km/h", "take the unit out"),
    ):
        yield Hypothesis(
            "unit", "velocity", f"the velocity over ground is in {unit}",
            f"{remedy} for the velocity in the mapping", ("velocity",), _by("velocity", factor),
        )  # fmt: skip
    yield Hypothesis(
        "unit", "fixes", "the positions are in feet", 'unit = "ft" in the mapping', ("fix",),
        _by("fix", 0.3048),
    )  # fmt: skip
    yield Hypothesis(
        "unit", "velocity", "only the size of the velocity goes with the fixes: its course is no "
        "angle in radians", 'unit = "deg" for the course in the mapping', ("velocity",), _of_way,
        each=2.0, exact=False,
    )  # fmt: skip
    yield Hypothesis(
        "scale", "velocity", "the fixes go {size} times as fast as the velocity over ground",
        "check the units of speed, position and time", ("velocity",),
        lambda s, a: _set(s, velocity=s.velocity * a), Scan(1.0, 0.15, _SCALES), ERROR,
    )  # fmt: skip
    yield Hypothesis(
        "offset", "velocity", "the velocity points {size} degrees off the track of the fixes",
        "offset = {value} for the course in the mapping: it counts from true north, clockwise",
        ("velocity",), lambda s, a: _set(s, velocity=s.velocity * np.exp(1j * a)),
        Scan(0.0, math.radians(10.0), _range(-2.9, 2.9, 11)), WARNING, 1.0 / DEGREE,
    )  # fmt: skip
    for names, sensor, said in (
        (("fix", "velocity"), "gps", "the GPS comes {size} s late"),
        (("fix",), "fixes", "the fixes come {size} s late"),
        (("velocity",), "velocity", "the velocity over ground comes {size} s late"),
    ):
        yield Hypothesis(
            "late", sensor, said, "gps_latency = {value} in [instruments] of the particulars"
            if len(names) > 1
            else "look for a filter in the receiver, or leave the late columns out",
            names, _late(*names),
            Scan(0.0, 0.25, _range(0.0, 3.0, 11)), WARNING, cost=2.0 * (len(names) - 1),
            plus=latency if len(names) > 1 else 0.0,
        )  # fmt: skip


def _of_way(s: Signals, _: float) -> Signals:
    """Return signals whose velocity has the direction of the track."""
    count = max(round(1.0 / s.step), 1)
    way = np.full(len(s.t), np.nan + 0j)
    way[count:-count] = s.fix[2 * count :] - s.fix[: -2 * count]
    return _set(s, velocity=np.abs(s.velocity) * np.exp(1j * np.angle(way)))


_SCALES = tuple(np.geomspace(0.1, 10.0, 11).tolist())

_GYROS = ("gyro_x_radps", "gyro_y_radps", "gyro_radps")
_ANGLES = ("ahrs_roll_rad", "ahrs_pitch_rad")
_FORCES = ("accel_x_mps2", "accel_y_mps2", "accel_z_mps2")


def _of_imu(full: bool) -> Iterator[Hypothesis]:
    """Return faults of gyros and accelerometers, of all three axes or of those a boat needs."""
    sensors = (
        ("gyros", "gyro", _GYROS, ((DEGREE, "degrees per second", 'unit = "degps"'),
                                   (1e-3, "mrad/s", "scale = 0.001"))),
        ("forces", "accelerometers", _FORCES, ((GRAVITY, "g", 'unit = "g"'),)),
    )  # fmt: skip
    for name, sensor, columns, units in sensors:
        own = (0, 1, 2) if full else (2,) if name == "gyros" else (0, 1)
        groups: list[tuple[int, ...]] = [(j,) for j in own]
        if len(own) > 1:
            groups += [(0, 1), own] if full else [own]
        for group in groups:
            given = ", ".join(columns[j] for j in group)
            more = 2.0 * (len(group) - 1)
            factors = [*((factor, "unit", f"{given} in {unit}", f"{remedy} in the mapping")
                         for factor, unit, remedy in units),
                       (-1.0, "sign", f"{given}: wrong sign", "scale = -1.0 there")]  # fmt: skip
            for factor, code, what, remedy in factors:
                by = [factor if j in group else 1.0 for j in range(3)]
                yield Hypothesis(
                    code, sensor, what, remedy, (name,), _diagonal(name, *by), cost=more
                )
        for a, b in ((0, 1), (0, 2), (1, 2)) if full else ((0, 1),) * (name == "forces"):
            for sign, said in ((1.0, "swapped"), (-1.0, "swapped, one with the wrong sign")):
                for other in (1.0, -1.0):
                    swap = np.eye(3)
                    swap[[a, b]] = swap[[b, a]]
                    swap[a] *= sign
                    swap[b] *= other * sign if sign < 0.0 else other
                    yield Hypothesis(
                        "axes", sensor, f"{columns[a]}, {columns[b]}: {said}",
                        "x is forward, y to starboard, z down: exchange the columns", (name,),
                        _columns(name, swap.tolist()), cost=1.0 + (sign * other < 0.0),
                    )  # fmt: skip
        if full or name == "forces":
            yield Hypothesis(
                "axes", sensor, f"{columns[0]}, {columns[1]}: turned by {{size}} degrees",
                "turn them back, or state imu_mounting in the particulars", (name,),
                _turned(0, 1, name),
                Scan(0.0, math.radians(20.0 if full else 45.0), _range(-3.0, 3.0, 13)), ERROR,
                1.0 / DEGREE,
            )  # fmt: skip
    if full:
        for a, b, name, about in ((1, 2, "roll", "first"), (2, 0, "pitch", "second")):
            yield Hypothesis(
                "axes", "imu", f"the IMU is turned by {{size}} degrees about its {about} axis, or "
                "the boat lies so", f"imu_mounting: {name} = {{value}} rad in [instruments] of the "
                "particulars", ("gyros", "forces"),
                _turned(a, b, "gyros", "forces"),
                Scan(0.0, math.radians(4.5), _range(-1.2, 1.2, 9)), WARNING, 1.0 / DEGREE,
            )  # fmt: skip
        yield Hypothesis(
            "unit", "accelerometers", "accel_z_mps2 lacks gravity",
            "give the specific force as the IMU measures it: offset = -9.81 in the mapping",
            ("forces",), lambda s, _: _set(s, forces=s.forces - np.array([0.0, 0.0, GRAVITY])),
        )  # fmt: skip
        yield Hypothesis(
            "scale", "accelerometers", "the accelerometers are {size} times too small",
            "scale = {value} for them in the mapping", ("forces",),
            lambda s, a: _set(s, forces=s.forces * a), Scan(1.0, 0.05, _SCALES), WARNING,
        )  # fmt: skip
        yield Hypothesis(
            "axes", "imu", "the IMU is turned by {size} degrees about its third axis",
            "imu_mounting = [0.0, 0.0, {value}] in [instruments] of the particulars",
            ("gyros", "forces"), lambda s, a: _turn(_turn(s, a, "gyros"), a, "forces"),
            Scan(0.0, math.radians(6.0), _range(-3.0, 3.0, 13)), WARNING, 1.0 / DEGREE,
        )  # fmt: skip
    for j, column in enumerate(_GYROS):
        if j < 2 and not full:
            continue
        yield Hypothesis(
            "scale", "gyro", f"{column} is {{size}} times too small",
            f"scale = {{value}} for {column} in the mapping", ("gyros",),
            _scaled_gyro(j),
            Scan(1.0, 0.1 if j == 2 else 0.3, _SCALES), WARNING,
        )  # fmt: skip
    yield Hypothesis(
        "bias", "gyro", "the zero of the yaw rate is off by {size} rad/s",
        "offset = {value} for gyro_radps in the mapping, with the other sign", ("gyros",),
        lambda s, a: _set(s, gyros=s.gyros - np.array([0.0, 0.0, a])),
        Scan(0.0, 0.01, _range(-0.3, 0.3, 13)), WARNING, exact=False,
    )  # fmt: skip
    yield Hypothesis(
        "late", "gyro", "the yaw rate comes {size} s late", "stamp samples when they are taken",
        ("gyros",), lambda s, a: s.late(a, "gyros"), Scan(0.0, 0.2, _range(0.0, 2.5, 9)), WARNING,
    )  # fmt: skip


def _turn(s: Signals, angle: float, name: str, a: int = 0, b: int = 1) -> Signals:
    """Return signals with two columns turned back by an angle about the third."""
    turn = np.eye(3)
    turn[a, a] = turn[b, b] = math.cos(angle)
    turn[b, a] = math.sin(angle)
    turn[a, b] = -turn[b, a]
    return _columns(name, turn.tolist())(s, angle)


def _of_tilt() -> Iterator[Hypothesis]:
    """Return faults of roll, pitch and height."""
    both = ("angles", "gyros")
    for j, angle in enumerate(("roll", "pitch")):
        one = [-1.0 if k == j else 1.0 for k in range(3)]
        yield Hypothesis(
            "sign", "ahrs", f"ahrs_{angle}_rad: wrong sign", "scale = -1.0 in the mapping",
            ("angles",), _diagonal("angles", *one[:2]),
        )  # fmt: skip
        yield Hypothesis(
            "sign", "ahrs", f"{angle} and its rate have the wrong sign", "scale = -1.0 for both",
            both, _with_rate(one), cost=2.0,
        )  # fmt: skip
    yield Hypothesis(
        "axes", "ahrs", "roll and pitch of the AHRS are swapped", "exchange them", ("angles",),
        _columns("angles", [[0.0, 1.0], [1.0, 0.0]]),
    )  # fmt: skip
    yield Hypothesis(
        "unit", "ahrs", "roll and pitch are in degrees", 'unit = "deg" in the mapping', ("angles",),
        _by("angles", DEGREE),
    )  # fmt: skip
    up = 'it is above 0 downwards: scale = -1.0, or frame = "enu" in the mapping'
    for name, column in (("height", "gps_z_m"), ("climb", "gps_vz_mps")):
        yield Hypothesis("sign", name, f"{column} points up", up, (name,), _by(name, -1.0))
        for factor, unit in ((0.3048, "feet"), (0.01, "cm"), (0.001, "mm")):
            yield Hypothesis(
                "unit", name, f"{column} is in {unit}", f"scale = {factor} in the mapping", (name,),
                _by(name, factor),
            )  # fmt: skip
    yield Hypothesis(
        "sign", "height", "gps_z_m and gps_vz_mps point up", up, ("height", "climb"),
        lambda s, _: _set(s, height=-s.height, climb=-s.climb), cost=2.0,
    )  # fmt: skip


def _of_commands() -> Iterator[Hypothesis]:
    """Return faults of the commands."""
    at, said = ("shafts",), "scale = -1.0 in the mapping"
    yield Hypothesis(
        "sign", "commands", "the shaft speeds have the wrong sign", said, at, _by("shafts", -1.0)
    )
    yield Hypothesis(
        "sign",
        "left",
        "n_left_rps has the wrong sign",
        said,
        at,
        _diagonal("shafts", -1.0, 1.0),
        cost=ONE_SIDE,
    )
    yield Hypothesis(
        "sign",
        "right",
        "n_right_rps has the wrong sign",
        said,
        at,
        _diagonal("shafts", 1.0, -1.0),
        cost=ONE_SIDE,
    )
    yield Hypothesis(
        "sides", "commands", "left and right are swapped", "exchange the two in the mapping", at,
        _columns("shafts", [[0.0, 1.0], [1.0, 0.0]]),
    )  # fmt: skip
    for j, side in enumerate(("left", "right")):
        yield Hypothesis(
            "sides", side, f"the {side} unit hardly turns the boat",
            "check this thruster, or whether its command is recorded", at,
            _diagonal("shafts", *(float(k != j) for k in range(2))), severity=WARNING,
            cost=ONE_SIDE + 2.0,
        )  # fmt: skip
    yield Hypothesis(
        "sign", "steering", "the steering angle has the wrong sign: above 0 it turns to port", said,
        ("steering",), _by("steering", -1.0),
    )  # fmt: skip


def hypotheses(s: Signals) -> list[Hypothesis]:
    """Return the faults that signals may have."""
    full = s.has("gyros", "forces") and bool(np.nanstd(s.gyros[:, :2]) > 0.0)
    found = [*_of_heading(), *_of_gps(s.latency), *_of_imu(full), *_of_tilt(), *_of_commands()]
    return [each for each in found if s.has(*each.changed)]


class _Trial(NamedTuple):
    """A hypothesis, and what it explains."""

    hypothesis: Hypothesis
    size: float
    sd: float
    score: float
    signals: Signals
    evidence: Evidence


def _total(before: Evidence, after: Evidence, each: Hypothesis) -> float:
    """Return what a hypothesis explains; of a number, commands know little."""
    known = () if each.scan is None else BY_COMMANDS
    return sum(gain(before[name], after[name]) for name in before if name not in known)


def _at_most(base: Evidence, each: Hypothesis) -> float:
    """Return the score of a hypothesis that explains all that it touches."""
    return (
        -each.cost
        - FITTED_COST
        + sum(
            0.5 * one.samples * math.log(one.rho / FLOOR)
            for name, one in base.items()
            if one is not None and touched(name, each.changed)
        )
    )


def _explains(before: Evidence, after: Evidence) -> bool:
    """Return whether some comparison is made much better, and leaves little."""
    return any(
        one is not None and other is not None and other.rho < LIKELY * min(one.rho, 1.0)
        for one, other in ((before[name], after[name]) for name in before)
    )


def _try(s: Signals, base: Evidence, each: Hypothesis) -> _Trial:
    """Return what a hypothesis explains, its number at its best."""

    def at(size: float) -> tuple[float, Signals, Evidence]:
        changed = each.undo(s, size)
        after = log_likelihood(changed, each.changed, base)
        return _total(base, after, each), changed, after

    if each.scan is None:
        score, changed, after = at(math.nan)
        known = [one.samples for k, one in base.items() if one and touched(k, each.changed)]
        windows = min(known, default=0)
        score -= each.cost + each.each * windows + FIXED_COST
        return _Trial(each, math.nan, math.nan, score, changed, after)
    values = np.array(each.scan.values)
    scores = [at(float(value))[0] for value in values]
    best = int(np.argmax(scores))
    size, width, sd = float(values[best]), float(np.abs(np.diff(values)).max()), math.inf
    if each.scan.nominal == 1.0:
        width = 0.3 * size
    for _ in range(5):
        left, middle, right = (at(size + k * width)[0] for k in (-1.0, 0.0, 1.0))
        bend = left - 2.0 * middle + right
        if bend < 0.0:
            sd = min(sd, width / math.sqrt(-bend))
            size += min(max(0.5 * (left - right) / bend, -1.0), 1.0) * width
        elif max(left, right) > middle:
            size += width if right > left else -width
        width *= 0.4
    score, changed, after = at(size)
    return _Trial(each, size, sd, score - each.cost - FITTED_COST, changed, after)


def _counts(trial: _Trial) -> bool:
    """Return whether the interval of a parameter excludes its nominal value."""
    scan = trial.hypothesis.scan
    if scan is None:
        return True
    inside = scan.values[0] <= trial.size <= scan.values[-1]
    return inside and abs(trial.size - scan.nominal) > max(scan.least, 4.0 * trial.sd)


def explain(s: Signals) -> tuple[list[Finding], Signals, list[Undone]]:
    """Return the faults that explain signals best, the signals without them, what undoes them."""
    base = log_likelihood(s)
    table, found, undone = hypotheses(s), list[Finding](), list[Undone]()
    while len(found) < MOST:
        trials = [_try(s, base, each) for each in table if each.scan is None]
        most = max([ENOUGH_GAIN, *(t.score for t in trials if _explains(base, t.evidence))])
        # what could explain no more than a fault without a number is not tried
        trials += [
            _try(s, base, each)
            for each in table
            if each.scan is not None and _at_most(base, each) > most
        ]
        likely = [t for t in trials if _counts(t) and _explains(base, t.evidence)]
        if not likely:
            break
        best = max(likely, key=lambda trial: trial.score)
        if best.score < ENOUGH_GAIN:
            break
        plain = [t for t in likely if t.hypothesis.scan is None and t.score > PLAIN * best.score]
        if best.hypothesis.scan is not None and plain:
            best = max(plain, key=lambda trial: trial.score)
        near = [
            t.hypothesis
            for t in likely
            if t.score > best.score - RIVAL and t is not best and t.score > ENOUGH_GAIN
        ]
        found.append(_finding(best, near))
        undone.append(Undone(best.hypothesis, best.size))
        s, base = best.signals, best.evidence
        if best.hypothesis.each > 0.0:  # what is not known of them cannot be held against others
            s = _set(s, **{name: getattr(s, name) * math.nan for name in best.hypothesis.changed})
            base = log_likelihood(s)
        table = [each for each in hypotheses(s) if each.what != best.hypothesis.what]
    return found, s, undone


def _finding(trial: _Trial, rivals: list[Hypothesis]) -> Finding:
    """Return a fault in words."""
    each, size = trial.hypothesis, trial.size + trial.hypothesis.plus
    half = 1.96 * trial.sd
    numbers = {"size": f"{each.shown * size:.3g}", "value": f"{size:.3f}"}
    what, remedy = each.what.format(**numbers), each.remedy.format(**numbers)
    if each.scan is not None:
        what += f" (95 %: {each.shown * (size - half):.3g} to {each.shown * (size + half):.3g})"
    if rivals:
        remedy += f"; or else: {rivals[0].what.format(**numbers)}"
    return Finding(
        each.severity, each.code, what, remedy, each.sensor, size, size - half, size + half
    )


_ROWS = {"fix": (0, 1), "velocity": (2, 3), "heading": (4,), "gyros": (5,), "forces": (6, 7)}
"""Columns of the measurements that the checks on board use."""


class Undone(NamedTuple):
    """A fault that was found, to be undone in the rows of a log."""

    hypothesis: Hypothesis
    size: float

    @property
    def delay(self) -> float:
        """Of the GPS that was taken out, s."""
        of_gps = self.hypothesis.code == "late" and self.hypothesis.sensor == "gps"
        return self.size if of_gps else 0.0

    def on_rows(self, recording: Recording) -> Recording:
        """Return a recording without it."""
        z, at = recording.z.copy(), {name: j for j, name in enumerate(MEASUREMENTS)}
        cmd = np.nan_to_num(recording.cmd)
        gyros, forces, angles = (
            [at[name] for name in names] for names in (_GYROS, _FORCES, _ANGLES)
        )
        rows = Signals(
            recording.t, z[:, 0] + 1j * z[:, 1], z[:, 2] + 1j * z[:, 3], z[:, 4], z[:, 4],
            z[:, gyros], z[:, forces], z[:, angles], z[:, at["gps_z_m"]], z[:, at["gps_vz_mps"]],
            cmd[:, :2], cmd[:, 2:], {}, whole=True,
        )  # fmt: skip
        if self.hypothesis.changed[0] not in ("shafts", "steering"):
            for columns in (gyros, forces):  # of one axis only
                z[:, columns] = np.where(np.isnan(z[:, columns]), 0.0, z[:, columns])
        missing = np.isnan(recording.z)
        rows = dataclasses.replace(rows, gyros=z[:, gyros], forces=z[:, forces])
        rows = self.hypothesis.undo(rows, self.size)
        z = recording.z.copy()
        z[:, 0], z[:, 1] = rows.fix.real, rows.fix.imag
        z[:, 2], z[:, 3], z[:, 4] = rows.velocity.real, rows.velocity.imag, rows.heading
        z[:, gyros], z[:, forces], z[:, angles] = rows.gyros, rows.forces, rows.angles
        if not self.hypothesis.exact:
            unknown = [j for name in self.hypothesis.changed for j in _ROWS.get(name, ())]
            missing[:, unknown] = True
        whole = missing.all(axis=0) if self.hypothesis.code == "late" else missing
        z[np.broadcast_to(whole, z.shape)] = np.nan
        return dataclasses.replace(recording, z=z, cmd=np.hstack([rows.shafts, rows.steering]))


def gps_delay(s: Signals) -> Measured | None:
    """Return the delay of the GPS behind compass and accelerometers."""
    for each in _of_gps(s.latency):
        if each.code == "late" and each.sensor == "gps" and s.has("forces", *each.changed):
            trial = _try(s, log_likelihood(s), each)
            return Measured(trial.size + s.latency, trial.sd)
    return None


def gyro_bias(s: Signals) -> Measured | None:
    """Return the zero of the gyro by the compass, rad/s."""
    if not s.has("gyros", "heading"):
        return None
    for each in _of_imu(False):
        if each.code == "bias":
            trial = _try(s, log_likelihood(s), each)
            return Measured(trial.size, trial.sd)
    return None


def unseen_faults(s: Signals, base: Evidence) -> dict[str, list[str]]:
    """Return faults, by sensor, that would not show in signals that are sound."""
    found: dict[str, list[str]] = {}
    for each in hypotheses(s):
        if each.code not in ("sign", "sides") or each.cost > 0.0 or each.severity != ERROR:
            continue
        moves = any(np.nanstd(np.abs(getattr(s, name))) > 0.0 for name in each.changed)
        after = log_likelihood(each.undo(s, math.nan), each.changed, base)
        if moves and -_total(base, after, each) < ENOUGH_GAIN:
            found.setdefault(each.sensor, []).append(each.what)
    for each in _of_heading():
        if each.code == "offset" and each.scan is not None and s.has("heading", "fix"):
            width = each.scan.least
            turned = [
                _total(base, log_likelihood(each.undo(s, a), each.changed, base), each)
                for a in (-width, width)
            ]
            if max(turned) > -ENOUGH_GAIN:
                found.setdefault("compass", []).append("it is off by a constant angle")
    return found
