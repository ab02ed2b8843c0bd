"""Simple faults of columns as hypotheses: what undoes each, and which explains a log best.

A hypothesis changes columns to what they were without its fault. Its evidence is the log-likelihood
by which sensors and commands agree better then (:mod:`twin.integrity.evidence`), less what it costs
to assume it. All compete; the best one is named and undone, and then the rest is judged anew. A
parameter is found where its likelihood is largest, with the interval in which it lies with 95 %.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from twin.channels import COMMANDS
from twin.integrity.evidence import (
    BY_COMMANDS,
    GYRO_ZERO_RADPS,
    RAW_HEADING,
    RHO_MIN,
    Evidence,
    Signals,
    gain,
    log_likelihood,
)
from twin.integrity.findings import ERROR, NOTE, WARNING, Finding
from twin.integrity.rows import ANGLES, FIX, FORCES, GYROS, VELOCITY
from twin.logs.columns import UNITS
from twin.particulars import GRAVITY

__all__ = ["Hypothesis", "Trial", "explain", "measured", "unseen"]

Undo = Callable[[Signals, float], Signals]
"""Returns signals without a fault, of a size."""

GAIN_MIN = 15.0
"""Gain of log-likelihood, beyond the cost of a fault, above which it is reported."""

PARAMETER_COST = 5.0
"""Cost in log-likelihood of each fitted number and of each further mistake of a fault. A rival
within this cost of the best fault is named beside it."""

RARE_FAULT_COST = 25.0
"""Cost of rare faults: of one shaft, as thrusts are seldom equal, and of a velocity of which only
the size is right."""

SCAN_POINTS = 13
"""Number of values of a parameter on the first grid."""

RHO_SHARE_MAX = 0.5
"""Share to which a fault must reduce the rho of one comparison."""

COMPASS = ("compass_rad",)
HEIGHT = ("gps_z_m",)
CLIMB = ("gps_vz_mps",)
SHAFTS = COMMANDS[:2]
STEERING = COMMANDS[2:]


class Scan(NamedTuple):
    """Values of a parameter that are tried, and how far from nominal it is a fault."""

    nominal: float
    least: float
    values: Sequence[float]


def _between(low: float, high: float, least: float) -> Scan:
    return Scan(0.0, least, np.linspace(low, high, SCAN_POINTS).tolist())


def _angles(least_degrees: float) -> Scan:
    most = 0.95 * math.pi  # beyond it lies the other sign
    return _between(-most, most, math.radians(least_degrees))


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A fault of columns."""

    code: str
    sensor: str
    what: str  # with {size} where it has a number
    remedy: str
    changed: tuple[str, ...]  # the columns that it changes
    undo: Undo
    scan: Scan | None = None
    error_from: float = math.inf  # size from which on a log cannot be used so
    cost: float = 0.0  # beyond that of any fault
    guess: bool = False  # whether what undoes it takes from other columns
    needs: tuple[str, ...] = ()  # other columns without which nothing tells it

    def severity(self, size: float) -> str:
        """No fault of the columns that a twin does without is an error."""
        error = self.scan is None or abs(size) >= self.error_from
        needed = {*ANGLES, *HEIGHT, *CLIMB}.isdisjoint(self.changed)
        return ERROR if error and needed else WARNING

    def words(self, text: str, size: float) -> str:
        """Return a text with the number in it; angles in degrees."""
        shown = math.degrees(size) if "degrees" in self.what else size
        return text.format(size=f"{shown:.3g}", value=f"{size:.3f}")


def _map(names: tuple[str, ...], matrix: npt.ArrayLike, plus: npt.ArrayLike = 0.0) -> Undo:
    """Return what makes columns of others."""
    by, more = np.array(matrix), np.reshape(plus, (-1, 1))
    return lambda s, _: s.having(names, by @ s.stacked(*names) + more)


def _scaled(*names: str) -> Undo:
    return lambda s, a: s.having(names, a * s.stacked(*names))


def _shifted(name: str, sign: float = 1.0) -> Undo:
    return lambda s, a: s.having((name,), s.stacked(name) + sign * a)


def _rotated(*pairs: tuple[str, str]) -> Undo:
    """Return what turns pairs of columns by an angle, from the first to the second."""

    def undo(s: Signals, angle: float) -> Signals:
        for pair in pairs:
            both = s.level(pair) * np.exp(1j * angle)
            s = s.having(pair, np.array([both.real, both.imag]))
        return s

    return undo


def _late(*names: str) -> Undo:
    """Return the transform that undoes a delay of columns by their size, s."""

    def undo(s: Signals, seconds: float) -> Signals:
        at = s.t + seconds
        moved = np.array([np.interp(at, s.t, s[name]) for name in names])
        moved[:, (at < s.t[0]) | (at > s.t[-1])] = np.nan
        more = seconds if names == (*FIX, *VELOCITY) else 0.0
        return dataclasses.replace(s.having(names, moved), latency=s.latency + more)

    return undo


def _in_radians(s: Signals, _: float) -> Signals:
    """Return signals with a heading that was unwrapped as radians taken for degrees."""
    plain = np.radians(s[RAW_HEADING])
    known = np.isfinite(plain)
    plain[known] = np.unwrap(plain[known])
    return s.having(COMPASS, plain[None])


def _of_way(s: Signals, _: float) -> Signals:
    """Return signals whose velocity has the direction of the track."""
    count = max(round(1.0 / s.step), 1)
    fix, way = s.level(FIX), np.full(len(s.t), np.nan + 0j)
    way[count:-count] = fix[2 * count :] - fix[: -2 * count]
    both = np.abs(s.level(VELOCITY)) * np.exp(1j * np.angle(way))
    return s.having(VELOCITY, np.array([both.real, both.imag]))


def _units(sensor: str, *names: str) -> Iterator[Hypothesis]:
    """Return columns in another unit: of a mapping file, or hundreds or thousands."""
    own, given = names[0].rpartition("_")[2], ", ".join(names)
    for unit, factor in (UNITS[own] | {f"1e-2 {own}": 1e-2, f"1e-3 {own}": 1e-3}).items():
        remedy = (
            f'unit = "{unit}"' if unit in UNITS[own] else f"multiply scale and offset by {factor}"
        )
        ways = {f"in {unit}": (factor, f"{remedy} in the mapping")}
        if names == VELOCITY and unit in UNITS[own]:
            ways[f"{own} taken for {unit}"] = (1.0 / factor, "take the unit out of the mapping")
        for what, (scale, how) in ways.items() if factor != 1.0 else ():
            undo = _map(names, scale * np.eye(len(names)))
            yield Hypothesis("unit", sensor, f"{given}: {what}", how, names, undo)


def _mirrored(sensor: str, *vectors: tuple[str, ...]) -> Iterator[Hypothesis]:
    """Return each wrong sign, and each exchange of two axes, of all vectors alike."""
    size, names = len(vectors[0]), tuple(itertools.chain(*vectors))
    remedy = "turn or exchange them in the mapping: " + (
        "x is north, y east"
        + "; south and west are below 0: multiply the scale of latitude or longitude by -1"
        * (FIX[0] in names)
        if names[0] in (*FIX, *VELOCITY)
        else "x ahead, y to starboard, z down"
    )
    pairs = [(0, 0), *itertools.combinations(range(size), 2)]
    for (a, b), signs in itertools.product(pairs, itertools.product((1.0, -1.0), repeat=size)):
        wrong, swapped = {j for j in range(size) if signs[j] < 0.0}, {a, b} if a < b else set()
        if not (wrong or swapped) or (swapped and not wrong <= swapped):
            continue
        order = list(range(size))
        order[a], order[b] = b, a
        matrix = np.kron(np.eye(len(vectors)), np.diag(signs)[:, order])
        said = " and ".join(
            f"{', '.join(vector[j] for vector in vectors for j in sorted(those))} {how}"
            for those, how in ((swapped, "swapped"), (wrong, "with the wrong sign"))
            if those
        )
        mistakes = len(vectors) + bool(swapped) + max(len(wrong), 1) - 2
        yield Hypothesis(
            "axes" if swapped else "sign", sensor, said, remedy, names, _map(names, matrix),
            cost=PARAMETER_COST * mistakes,
        )  # fmt: skip


def _opposite(
    code: str, sensor: str, what: str, names: tuple[str, ...], angle: float = 0.0
) -> Hypothesis:
    """Return columns that all have the wrong sign; the first counts from an angle."""
    plus = [angle, *[0.0] * (len(names) - 1)]
    remedy = f'{MINUS}, or frame = "enu" for all that runs from east'
    undo, cost = _map(names, -np.eye(len(names)), plus), PARAMETER_COST * (len(names) - 1)
    return Hypothesis(code, sensor, what, remedy, names, undo, cost=cost)


QUARTER = 0.5 * math.pi
ASKEW = _angles(10.0)
SCALES = Scan(1.0, 0.09, np.geomspace(0.1, 10.0, SCAN_POINTS).tolist())
ZERO = _between(-0.3, 0.3, GYRO_ZERO_RADPS)
DELAY = _between(0.0, 3.0, 0.2)
STAMPS = "look for a filter in the sensor; stamp samples when they are taken"
STATED = "in [instruments] of the particulars"
FACTOR = "multiply scale and offset by {value} there in the mapping"
MINUS = FACTOR.format(value=-1)
PLUS = "add {value} to offset there in the mapping"

TABLE: tuple[Hypothesis, ...] = (
    Hypothesis("unit", "compass", "the heading is in degrees, not radians",
               'unit = "deg" for it in the mapping', COMPASS, _in_radians),
    *(_opposite("axes" if where else "sign", "compass", f"{what} counter-clockwise{where}", names,
                angle)
      for what, names in (("the heading runs", COMPASS),
                          ("heading and yaw rate run", (*COMPASS, GYROS[2])))
      for where, angle in (("", 0.0), (" from east", QUARTER), (" from west", -QUARTER))),
    Hypothesis("offset", "compass", "the compass sits back to front",
               PLUS.format(value=3.1416), COMPASS, _map(COMPASS, [[1.0]], math.pi)),
    Hypothesis("offset", "compass", "the heading is {size} degrees off the motion in any direction",
              f'{PLUS} (with frame = "enu" subtract it): variation, or a sensor askew',
              COMPASS, _shifted(*COMPASS), ASKEW, QUARTER),
    *(each for vectors, sensor in (
        ((FIX,), "fixes"), ((VELOCITY,), "velocity"), ((FIX, VELOCITY), "gps"), ((GYROS,), "gyro"),
        ((GYROS[2:],), "gyro"), ((FORCES,), "accelerometers"), ((FORCES[:2],), "accelerometers"),
        ((ANGLES,), "ahrs"),
    ) for each in _mirrored(sensor, *vectors)),
    *(each for names, sensor in (
        (FIX, "fixes"), (VELOCITY, "velocity"), (ANGLES, "ahrs"), (HEIGHT, "height"),
        (CLIMB, "climb"), *((part, "gyro") for part in (GYROS, GYROS[:2], *zip(GYROS))),
        *((part, "accelerometers") for part in (FORCES, FORCES[:2], *zip(FORCES))),
    ) for each in _units(sensor, *names)),
    *(Hypothesis("late", sensor, f"{sensor}: {{size}} s late", STAMPS, names,
                 _late(*names), DELAY) for sensor, names in (
        ("compass", COMPASS), ("fixes", FIX), ("velocity", VELOCITY), ("gyro", GYROS[2:]))),
    Hypothesis("late", "gps", "the GPS comes {size} s late", f"gps_latency = {{value}} {STATED}",
               (*FIX, *VELOCITY), _late(*FIX, *VELOCITY), DELAY,
               needs=FORCES[:2]),  # a boat that drifts in turns follows its heading late
    Hypothesis("unit", "velocity", "only the size of the velocity goes with the fixes: its course "
               "is no angle in radians", 'unit = "deg" for the course in the mapping', VELOCITY,
               _of_way, cost=RARE_FAULT_COST, guess=True),
    Hypothesis("scale", "velocity", "the fixes go {size} times as fast as the velocity over ground",
              "check the units of speed, position and time", VELOCITY, _scaled(*VELOCITY),
              SCALES, error_from=0.0),
    Hypothesis("offset", "velocity", "the velocity points {size} degrees off the track of the "
               "fixes", f"{PLUS}: courses count from true north, clockwise", VELOCITY,
              _rotated(VELOCITY), ASKEW, QUARTER),
    Hypothesis("unit", "accelerometers", f"{FORCES[2]} lacks gravity",
               f"{PLUS.format(value=-9.81)}: give the specific force as it is measured",
               FORCES[2:], _map(FORCES[2:], [[1.0]], -GRAVITY)),
    Hypothesis("axes", "accelerometers", f"{', '.join(FORCES[:2])}: turned by {{size}} degrees",
              "turn them back in the mapping", FORCES[:2], _rotated(FORCES[:2]), ASKEW,
              error_from=0.0),
    *(Hypothesis("axes", "imu", f"the IMU is turned by {{size}} degrees about its {axis} axis, or "
                "the boat lies so", f"imu_mounting = [{angles}] {STATED}", (*GYROS, *FORCES),
                _rotated((GYROS[a], GYROS[b]), (FORCES[a], FORCES[b])), _angles(4.0))
      for axis, a, b, angles in (("second", 2, 0, "0.0, {value}, 0.0"),
                                 ("first", 1, 2, "{value}, 0.0, 0.0"),
                                 ("third", 0, 1, "0.0, 0.0, {value}"))),
    Hypothesis("scale", "accelerometers", "the accelerometers are {size} times too small", FACTOR,
              FORCES, _scaled(*FORCES), SCALES),
    *(Hypothesis("scale", "gyro", f"{name} is {{size}} times too small", FACTOR, (name,),
                _scaled(name), SCALES) for name in GYROS),
    Hypothesis("bias", "gyro", "the zero of the yaw rate is off by {size} rad/s",
              "subtract {value} from offset there in the mapping", GYROS[2:],
              _shifted(GYROS[2], -1.0), ZERO),
    *(_opposite("sign", "ahrs", f"{' and '.join(pair)} with the wrong sign", pair)
      for pair in zip(ANGLES, GYROS[:2], strict=True)),
    _opposite("sign", "height", "gps_z_m is above 0 upwards", HEIGHT),
    _opposite("sign", "climb", "gps_vz_mps is above 0 upwards", CLIMB),
    _opposite("sign", "height", "gps_z_m and gps_vz_mps are above 0 upwards", (*HEIGHT, *CLIMB)),
    Hypothesis("sign", "commands", "the shaft speeds have the wrong sign", MINUS, SHAFTS,
               _map(SHAFTS, -np.eye(2))),
    Hypothesis("sides", "commands", "left and right are swapped", "exchange them in the mapping, "
               "or in [skid_steering] multiply scale and offset of steering by -1",
               SHAFTS, _map(SHAFTS, [[0.0, 1.0], [1.0, 0.0]])),
    Hypothesis("sign", "steering", "steering to starboard turns to port", MINUS,
               STEERING, _map(STEERING, -np.eye(2))),
    *(Hypothesis(code, side, what, "check this thruster, or its column in the mapping", SHAFTS,
                 _map(SHAFTS, np.diag(factors)), None, code == "sign", RARE_FAULT_COST)
      for code, side, what, factors in (
        ("sign", "left", "n_left_rps has the wrong sign", (-1.0, 1.0)),
        ("sign", "right", "n_right_rps has the wrong sign", (1.0, -1.0)),
        ("sides", "left", "the left unit hardly turns the boat", (0.0, 1.0)),
        ("sides", "right", "the right unit hardly turns the boat", (1.0, 0.0)))),
)  # fmt: skip
"""All hypotheses of faults."""


def hypotheses(s: Signals) -> list[Hypothesis]:
    """Return the faults that signals may have, each once; of one shaft, where they are two."""
    one = {"left", "right", "sides"} if np.array_equal(*s.stacked(*SHAFTS)) else set[str]()
    table = [each for each in TABLE if one.isdisjoint((each.sensor, each.code))]
    return list({each.what: each for each in table if s.has(*each.changed, *each.needs)}.values())


class Trial(NamedTuple):
    """A hypothesis, its number, and what it explains."""

    hypothesis: Hypothesis
    size: float
    sd: float
    cost: float
    score: float
    signals: Signals
    evidence: Evidence

    def on_rows(self, s: Signals) -> Signals:
        """Return rows without the fault, or without columns where it is not known well enough."""
        each = self.hypothesis
        if each.guess or each.code in ("late", "bias") or each.sensor == "fixes":
            return s.having(each.changed, math.nan * s.stacked(*each.changed))
        return each.undo(s, self.size)


def _total(before: Evidence, after: Evidence, *tried: Hypothesis) -> float:
    """Return the gain of log-likelihood by a hypothesis; a fitted number gains none by commands."""
    known = BY_COMMANDS if any(each.scan for each in tried) else ()
    return sum(gain(before[name], after[name]) for name in before if name not in known)


def _lead(one: Trial, other: Trial) -> float:
    """Return the log-likelihood of a hypothesis over that of another one, less their costs.

    They are held against each other: what either leaves has another number of independent samples.
    """
    tried = one.hypothesis, other.hypothesis
    return _total(other.evidence, one.evidence, *tried) - one.cost + other.cost


def _at_most(base: Evidence, each: Hypothesis) -> float:
    """Return the largest possible score of a hypothesis: each rho that it changes is RHO_MIN."""
    known = [one for name, one in base.items() if one and name not in BY_COMMANDS]
    touched = [one for one in known if not one.uses.isdisjoint(each.changed)]
    most = sum(0.5 * one.samples * math.log(one.rho / RHO_MIN) for one in touched)
    return most - each.cost - PARAMETER_COST


def _explains(before: Evidence, after: Evidence) -> bool:
    """Return whether a hypothesis reduces the rho of some comparison enough."""
    return any(
        one is not None and other is not None and other.rho < RHO_SHARE_MAX * min(one.rho, 1.0)
        for one, other in ((before[name], after[name]) for name in before)
    )


def _try(s: Signals, base: Evidence, each: Hypothesis) -> Trial:
    """Return the trial of a hypothesis at the size of the highest score."""
    from scipy.optimize import minimize_scalar  # takes half a second

    def at(size: float) -> tuple[float, Signals, Evidence]:
        changed = each.undo(s, size)
        after = log_likelihood(changed, each.changed, base)
        return _total(base, after, each) - cost, changed, after

    size, sd, cost = math.nan, math.nan, each.cost
    if each.scan is not None:
        cost += PARAMETER_COST
        values = np.array(each.scan.values)
        scores = [at(float(value))[0] for value in values]
        k = int(np.argmax(scores))
        low, high = np.pad(values, 1, "reflect", reflect_type="odd")[[k, k + 2]]
        width, accuracy = 0.1 * (high - low), {"xatol": 0.01 * (high - low)}
        best = minimize_scalar(lambda x: -at(x)[0], bounds=(low, high), options=accuracy)
        size = float(best.x if -best.fun > scores[k] else values[k])
        bend = at(size - width)[0] + at(size + width)[0] - 2.0 * max(-best.fun, scores[k])
        sd = width / math.sqrt(-bend) if bend < 0.0 else math.inf
    return Trial(each, size, sd, cost, *at(size))


def _counts(trial: Trial) -> bool:
    """Return whether a parameter is far from its nominal value: so is its interval, then."""
    scan = trial.hypothesis.scan
    if scan is None:
        return True
    inside = scan.values[0] <= trial.size <= scan.values[-1]
    return inside and abs(trial.size - scan.nominal) > scan.least


def explain(s: Signals) -> tuple[list[Finding], Signals, list[Trial]]:
    """Return the faults that explain signals best, signals without them, and what undoes them."""
    base = log_likelihood(s)
    table, found, undone = hypotheses(s), list[Finding](), list[Trial]()
    while True:
        trials = [_try(s, base, each) for each in table if each.scan is None]
        most = max([GAIN_MIN, *(t.score for t in trials if _explains(base, t.evidence))])
        # what could explain no more than a fault without a number is not tried
        trials += [
            _try(s, base, each)
            for each in table
            if each.scan is not None and _at_most(base, each) > most
        ]
        likely = [
            t for t in trials if t.score > GAIN_MIN and _counts(t) and _explains(base, t.evidence)
        ]
        if not likely:
            return found, s, undone
        # what a guess takes from other columns agrees with them in any case
        certain = [trial for trial in likely if not trial.hypothesis.guess] or likely
        best = certain[0]
        for trial in certain[1:]:
            best = trial if _lead(trial, best) > 0.0 else best
        near = [t for t in likely if t is not best and _lead(best, t) < PARAMETER_COST]
        found.append(_finding(best, near, s.latency))
        undone.append(best)
        # what is guessed cannot be held against others
        s = best.on_rows(s) if best.hypothesis.guess else best.signals
        base = log_likelihood(s)
        known = {each.hypothesis.what for each in undone}
        table = [each for each in hypotheses(s) if each.what not in known]


def _finding(trial: Trial, rivals: list[Trial], latency: float) -> Finding:
    """Return a fault in words; a delay of the GPS with the one that is stated."""
    each, size = trial.hypothesis, trial.size
    if (each.code, each.sensor) == ("late", "gps"):
        size += latency
    low, high = size - 1.96 * trial.sd, size + 1.96 * trial.sd
    what, remedy = each.words(each.what, size), each.words(each.remedy, size)
    if each.scan is not None:
        what += f" (95 %: {each.words('{size}', low)} to {each.words('{size}', high)})"
    if rivals:
        other = rivals[0].hypothesis
        remedy += f"; or else: {other.words(other.what, rivals[0].size)}"
    return Finding(each.severity(size), each.code, what, remedy, each.sensor, size, low, high)


def measured(s: Signals, base: Evidence, code: str, sensor: str) -> Trial | None:
    """Return the number of a fault, such as the delay of the GPS, whatever its size."""
    for each in hypotheses(s):
        if each.scan is not None and (each.code, each.sensor) == (code, sensor):
            return _try(s, base, each)
    return None


def unseen(s: Signals, base: Evidence) -> list[Finding]:
    """Return notes, by sensor, on faults that would not show in signals that are sound."""
    found: dict[str, list[str]] = {}
    for each in hypotheses(s):
        sizes = [math.nan]
        if each.scan is not None and (each.code, each.sensor) == ("offset", "compass"):
            sizes = [-each.scan.least, each.scan.least]
        elif each.code not in ("sign", "sides") or each.cost > 0.0 or each.scan is not None:
            continue
        after = [log_likelihood(each.undo(s, size), each.changed, base) for size in sizes]
        moves = np.nanstd(np.abs(s.stacked(*each.changed)), axis=1).any()
        if moves and max(_total(base, one, each) for one in after) > -GAIN_MIN:
            found.setdefault(each.sensor, []).append(each.words(each.what, max(sizes)))
    remedy = (
        "record turns to both sides, legs in several directions and changes of thrust; if it has "
        "them, look for wrong columns or units"
    )
    said = "this log does not tell whether"
    return [
        Finding(NOTE, "unchecked", f"{sensor}: {said} {' or '.join(faults)}", remedy, sensor)
        for sensor, faults in found.items()
    ]
