"""What parameters and sensors say of a twin: two of the answers of :mod:`twin.benchmark.trust`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.channels import MEASUREMENTS
from twin.integrity.findings import ERROR, WARNING, Finding
from twin.integrity.monitor import SensorStatus
from twin.logs.log import Log
from twin.particulars import Particulars
from twin.predictors.base import Estimate, ParametersInUse

__all__ = [
    "AMBER",
    "COLOURS",
    "DOUBTFUL_AMBER",
    "EXCLUDED_AMBER",
    "EXCLUDED_RED",
    "FAR",
    "FAR_AMBER",
    "GREEN",
    "RED",
    "SEE_CHECK",
    "SPEED_LEAST",
    "SPEED_MOST",
    "Answer",
    "HealthCount",
    "other_boat",
    "parameter_answer",
    "sensor_answer",
    "speed_ratio",
    "turned_effects",
    "with_parameters_in_use",
]

Array = NDArray[np.float64]

GREEN, AMBER, RED = "green", "amber", "red"

COLOURS = (GREEN, AMBER, RED)

FAR, FAR_AMBER = 4.0, 4
"""Prior standard deviations beyond which a parameter is far, and how many such are amber."""

EXCLUDED_AMBER, DOUBTFUL_AMBER = 0.05, 0.2
"""Shares of a run from which on a sensor that its twin left out, or doubted, is amber ..."""

EXCLUDED_RED = 0.8
"""... and from which on one that a twin needs and left out is red."""

NEEDED = ("commands", "compass", "gps")
"""A twin learns nothing without these."""

SPEED_LEAST, SPEED_MOST = 0.4, 1.7
"""Speed straight ahead over what the particulars say at that shaft speed. On 33 recorded runs of
five boats with their own particulars it lies between .50 and 1.42, on 24 simulated ones of four
between .87 and 1.26."""

OTHER_BOAT = "wrong boat, steering or units?"
"""Said of parameters far from the prior of a population ..."""

OWN_CHANGED = (
    "has the boat changed (load, hull, propellers) since the runs of its own prior? Then make the "
    "prior again"
)
"""... and of those far from the boat's own prior."""

SURE_BEFORE, SURE_AFTER = 1.5, 2.0
"""Standard deviations by which a sign was known before and after, where it is said to be other."""

EFFECTS = {
    **dict.fromkeys(("X_nn", "T_uL", "T_uR"), "surge"),
    **dict.fromkeys(("Y_nn", "Y_F", "T_vL", "T_vR"), "sway"),
    **dict.fromkeys(("N_nn", "N_F", "N_dn", "T_rL", "T_rR"), "yaw"),
}
"""Parameters that say what commands do, and their equations."""

DAMPING = {
    **dict.fromkeys(("X_u", "X_u|u|", "X_uu"), "surge"),
    **dict.fromkeys(("Y_|u|v", "Y_v"), "sway"),
    **dict.fromkeys(("N_|u|r", "N_r"), "yaw"),
}
"""Parameters that damp the motion, and their equations."""

SHOWN = 2
"""Findings of the log check that are said in words; the others are counted."""

SEE_CHECK = "see usv-twin log check"
"""Ends the line on the sensors where the log check found something."""

TIMING = ("time", "gap", "jitter")
"""Codes of findings on stamps, which a twin mostly bridges."""

SILENT = ("lost", "frozen")
"""Codes of findings on sensors that were silent for a while."""

PASSING = ("contradiction", "jump")
"""Codes of findings that may concern a moment only. The others concern the whole log."""

STRAIGHT_LENGTHS, STRAIGHT_RATE = 3.0, 0.2
"""A boat goes straight ahead if its shaft speeds were steady over the time in which it goes so many
lengths, and its yaw rate times length over speed is less than this."""

STRAIGHT_MIN = 20.0
"""Less time straight ahead than this, s, says nothing of the speed."""

STEADY_SHAFT, FAST_SHAFT = 0.2, 0.3
"""Standard deviation of steady shaft speeds over their mean, and the least mean over the most."""

ANGLE_USED, SIDES_DIFFER = 0.01, 0.1
"""Steering angles (rad) that move less are not used; shafts that differ by more (of the largest
shaft speed, root mean square) steer."""


@dataclass(frozen=True)
class Answer:
    """One of the lines."""

    about: str
    colour: str  # one of COLOURS
    text: str
    numbers: dict[str, Any] = field(default_factory=dict)
    # orders answers of one colour: the larger, the worse; by the first number, then the next
    badness: tuple[float, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Return it as plain data."""
        named = {"about": self.about, "colour": self.colour, "text": self.text}
        return {**named, "numbers": self.numbers}


class _Stretch(NamedTuple):
    """How long a sensor was doubtful or excluded, s, and the last reason."""

    seconds: float
    why: str


class HealthCount:
    """How long a twin left sensors out, or doubted them."""

    def __init__(self) -> None:
        self.seconds = 0.0  # of all rows, s
        self.found: dict[tuple[str, str], _Stretch] = {}  # by sensor and status

    def take(self, step: float, statuses: Mapping[str, SensorStatus]) -> None:
        """Count a row that came ``step`` seconds after the one before."""
        self.seconds += step
        for sensor, now in statuses.items():
            if now.status in ("doubtful", "excluded"):
                before = self.found.get((sensor, now.status), _NEVER).seconds
                self.found[sensor, now.status] = _Stretch(before + step, now.why)

    def share(self, sensor: str, status: str) -> float:
        """Return the share of the rows in which a sensor had a status."""
        return self.found.get((sensor, status), _NEVER).seconds / max(self.seconds, 1e-9)

    def colour(self, sensor: str, status: str) -> str:
        """Return the colour of that."""
        share = self.share(sensor, status)
        if status == "doubtful":
            return AMBER if share >= DOUBTFUL_AMBER else GREEN
        if share >= EXCLUDED_RED and sensor in NEEDED:
            return RED
        return AMBER if share >= EXCLUDED_AMBER else GREEN

    def lines(self) -> list[tuple[str, str]]:
        """Return colour and words for each sensor and status, the worst first."""
        said = []
        for (sensor, status), stretch in self.found.items():
            share = self.share(sensor, status)
            text = f"{sensor} {status} for {stretch.seconds:.0f} s, {share:.0%} of the run"
            reason = stretch.why.removeprefix(f"{sensor} ")
            said.append((self.colour(sensor, status), share, f"{text} ({reason})"))
        said.sort(key=lambda item: (COLOURS.index(item[0]), item[1]), reverse=True)
        return [(item[0], item[2]) for item in said]


_NEVER = _Stretch(0.0, "")


def sensor_answer(findings: Sequence[Finding], health: HealthCount | None = None) -> Answer:
    """Return which sensors and commands the log check doubts, and which the twin left out.

    Parameters
    ----------
    findings : sequence of Finding
        Of ``twin.integrity.log_check.check_log``.
    health : HealthCount, optional
        What the twin said of its sensors while it ran over the log.
    """
    health = HealthCount() if health is None else health
    doubted = [f for f in findings if f.severity in (ERROR, WARNING)]
    doubted.sort(key=_consequence)
    numbers = {
        "findings": {f"{f.code} {f.sensor}": f.severity for f in doubted},
        "health_s": {" ".join(key): stretch.seconds for key, stretch in health.found.items()},
    }
    lines = health.lines()
    colours = [RED if f.severity == ERROR else AMBER for f in doubted]
    colours += [line[0] for line in lines]
    parts = [text for colour, text in lines if colour == RED]
    parts += [f.what for f in doubted[:SHOWN]]
    parts += [text for colour, text in lines if colour == AMBER]
    longest = max((stretch.seconds for stretch in health.found.values()), default=0.0)
    badness = (float(len(parts) + max(len(doubted) - SHOWN, 0)), longest)
    unknown = [f.what for f in findings if f.code == "unchecked" and f.sensor == "compass"]
    if not parts:
        briefly = "; ".join(line[1] for line in lines[:2])
        text = "; ".join([briefly or "none in doubt", *unknown])
        return Answer("sensors", GREEN, text, numbers, badness)
    parts += unknown
    if len(doubted) > SHOWN:
        parts.append(f"and {len(doubted) - SHOWN} more: {SEE_CHECK}")
    elif doubted:
        parts.append(SEE_CHECK)
    return Answer("sensors", max(colours, key=COLOURS.index), "; ".join(parts), numbers, badness)


def _consequence(finding: Finding) -> tuple[bool, bool, bool, bool]:
    """Return what orders findings: errors first; the motion, silent sensors, then the timing."""
    code = finding.code
    return finding.severity != ERROR, code in TIMING, code in SILENT, code in PASSING


def parameter_answer(
    deviations: Sequence[tuple[str, float]],
    reversed_effects: Sequence[str],
    drag: float = 1.0,
    others: Sequence[str] = (),
    own_prior: bool = False,
) -> Answer:
    """Return what parameters far from the prior, or of the other sign, say.

    Parameters
    ----------
    deviations : sequence of tuple
        Names, and deviations in prior standard deviations, largest first.
    reversed_effects : sequence of str
        Effects of commands that ended with the other sign.
    drag : float
        Factor by which a rough prior was scaled.
    others : sequence of str
        What :func:`other_boat` says.
    own_prior : bool
        Whether the prior is of earlier runs of this boat.
    """
    far = [(name, size) for name, size in deviations if size > FAR]
    numbers: dict[str, Any] = {"far": dict(far), "sign": list(reversed_effects)}
    numbers |= {"count": len(deviations), "drag": drag, "other_boat": list(others)}
    parts = list(others)
    if not deviations:
        text = "; ".join(["the predictor has none", *parts])
        return Answer("parameters", AMBER if parts else GREEN, text, numbers)
    badness = (float(len(far) + len(reversed_effects) + len(others)), deviations[0][1])
    if not far and not reversed_effects and not others:
        name, size = deviations[0]
        text = f"all within {FAR:g} prior standard deviations; largest {name}, {size:.1f}"
        if not 0.5 < drag < 2.0:
            text += f" (of a boat with {drag:.2g} times the drag of the rough prior)"
        return Answer("parameters", GREEN, text, numbers, badness)
    if far:
        shown = ", ".join(f"{name} ({size:.1f})" for name, size in far[:4])
        more = ", ..." if len(far) > 4 else ""
        parts.append(
            f"{len(far)} of {len(deviations)} beyond {FAR:g} prior standard deviations: "
            f"{shown}{more}; {OWN_CHANGED if own_prior else OTHER_BOAT}"
        )
    if reversed_effects:
        names = ", ".join(reversed_effects[:4])
        parts.append(f"other sign: {names}; wrong sides or signs of commands?")
    colour = AMBER if len(far) <= FAR_AMBER else RED
    return Answer("parameters", colour, " ".join(parts), numbers, badness)


def with_parameters_in_use(
    answer: Answer, in_use: ParametersInUse | None, own_prior: bool
) -> Answer:
    """Return the answer on the parameters, with the candidate in use.

    Where that is the prior, ``answer`` is on the best refit. Forecasts with a population's prior
    do not confirm any parameters, so the answer is amber at least. Those with the boat's own prior
    confirm it.

    Parameters
    ----------
    answer : Answer
        Of :func:`parameter_answer`.
    in_use : ParametersInUse or None
        None of a predictor without a choice: the answer is returned as it is.
    own_prior : bool
        Whether the prior is of earlier runs of this boat.
    """
    if in_use is None:
        return answer
    text, colour = f"{answer.text}; in use: {in_use.name}", answer.colour
    if in_use.is_prior:
        found = "no refit yet" if in_use.refit is None else f"the best refit: {answer.text}"
        text = f"in use: {in_use.name}; {found}"
        colour = AMBER if colour == GREEN and not own_prior else colour
    numbers = answer.numbers | {"in_use": in_use.name, "prior_in_use": in_use.is_prior}
    return replace(answer, colour=colour, text=text, numbers=numbers)


def turned_effects(names: Sequence[str], prior: Estimate, last: Estimate) -> list[str]:
    """Return the effects of commands that ended with the other sign, where both are sure.

    An effect and the damping of its motion that are both reversed are the two sides of one
    equation: a steady run has shown their ratio only.

    Parameters
    ----------
    names : sequence of str
        Names of the parameters (p,).
    prior, last : Estimate
        Before the first row, and at the end.
    """
    before, after = prior.params, last.params
    known = (before * after < 0.0) & (np.abs(before) > SURE_BEFORE * prior.params_sd)
    sure = known & (np.abs(after) > SURE_AFTER * last.params_sd)
    damping = {
        DAMPING[name]
        for name, is_known in zip(names, known, strict=True)
        if is_known and name in DAMPING
    }
    found = [name for name, is_sure in zip(names, sure, strict=True) if is_sure]
    return [name for name in found if name in EFFECTS and EFFECTS[name] not in damping]


def other_boat(log: Log, particulars: Particulars) -> list[str]:
    """Return what in a run is not as the particulars say: its steering, and its speed ahead.

    The parameters do not show these. They may move far enough to make almost any boat of the
    particulars that goes and turns as the log does.
    """
    said = []
    cmd = log.cmd
    if particulars.steering == "drives" and len(cmd):
        most = float(np.abs(cmd[:, :2]).max())
        apart = float(np.sqrt(np.mean((cmd[:, 0] - cmd[:, 1]) ** 2)))
        if float(np.ptp(cmd[:, 2:], axis=0).max()) < ANGLE_USED and apart > SIDES_DIFFER * most:
            said.append(
                'steering = "drives", but no angle moves and the shafts differ: '
                'wrong boat, or "differential"?'
            )
    ratio = speed_ratio(log, particulars)
    if ratio is not None and not SPEED_LEAST <= ratio <= SPEED_MOST:
        said.append(
            f"straight ahead it goes {ratio:.2g} times as fast as speed and shaft_speed say: "
            "wrong boat, or unit of the commands?"
        )
    return said


def speed_ratio(log: Log, particulars: Particulars) -> float | None:
    """Return the speed straight ahead over what the particulars say at that shaft speed.

    At steady shaft speed, and straight ahead, thrust and drag grow with the square of both. So
    speed over shaft speed is a number of the boat. None: the run shows too little of that.
    """
    fix = np.isfinite(log.z[:, :2]).all(axis=1)
    heading = np.isfinite(log.z[:, _COMPASS])
    if fix.sum() < 2 or heading.sum() < 2:
        return None
    step = 1.0
    t = np.arange(log.t[0], log.t[-1], step)
    x, y = (np.interp(t, log.t[fix], log.z[fix, k]) for k in (0, 1))
    # of the run itself, as the stated speed may be that of another boat
    far = np.hypot(x[4:] - x[:-4], y[4:] - y[:-4]) / (4.0 * step)
    typical = float(np.quantile(far, 0.75)) if len(far) else 0.0
    window = STRAIGHT_LENGTHS * particulars.length / max(typical * step, 1e-6)
    window = round(min(max(window, 4), max(len(t) // 4, 4)))
    if len(t) <= window:
        return None
    psi = np.interp(t, log.t[heading], np.unwrap(log.z[heading, _COMPASS]))
    shaft = np.interp(t, log.t, log.cmd[:, :2].mean(axis=1))
    way = np.hypot(x[window:] - x[:-window], y[window:] - y[:-window])
    turned = np.abs(psi[window:] - psi[:-window])
    mean = _averages(shaft, window)[: len(way)]
    scatter = np.sqrt(np.maximum(_averages(shaft**2, window)[: len(way)] - mean**2, 0.0))
    ahead = (mean > FAST_SHAFT * float(np.abs(shaft).max())) & (scatter < STEADY_SHAFT * mean)
    ahead &= (mean > 0.0) & (turned * particulars.length < STRAIGHT_RATE * way)
    if ahead.sum() * step < STRAIGHT_MIN:
        return None
    stated = mean[ahead] * particulars.speed / particulars.shaft_speed * window * step
    return float(np.median(way[ahead] / stated))


_COMPASS = MEASUREMENTS.index("compass_rad")


def _averages(values: Array, window: int) -> Array:
    """Return the means of so many values that follow each other."""
    total = np.concatenate([[0.0], np.cumsum(values)])
    return np.asarray((total[window:] - total[:-window]) / window)
