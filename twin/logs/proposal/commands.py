"""Which columns of an unknown log hold shaft speeds and steering angles, and in which unit."""

from __future__ import annotations

import re
from collections.abc import Collection

import numpy as np

from twin.logs.proposal.header_words import (
    NAMES,
    is_rpm,
    is_setpoint,
    is_shaft,
    is_side,
    is_steering,
    means,
    other_side,
    sides_of,
    unit_of,
    words_of,
)
from twin.logs.proposal.sheet import (
    Columns,
    Proposal,
    add_line,
    entry,
    is_pulses,
    known,
    marked,
    put,
)

__all__ = ["find_commands", "find_pulses"]

_LACKING = "n_left_rps, n_right_rps (or n_rps)"

_PULSES = "scale = 0.02, offset = -30.0"
"""Of pulse widths, us: 0 at 1500, 10 at 2000."""


def find_commands(columns: Columns, found: Proposal, given: Collection[str]) -> None:
    """Find shaft speeds and steering angles, of one unit or two; ``given`` ones are known."""
    alone = []
    for is_named, single, pair, convert in (
        (is_shaft, "n_rps", ("n_left_rps", "n_right_rps"), _shaft),
        (is_steering, "delta_rad", ("delta_left_rad", "delta_right_rad"), _steer),
    ):
        if any(name in given for name in (single, *pair)):
            continue
        there = [n for n in columns.left if n in columns.numbers and is_named(n)]
        there.sort(key=is_setpoint)  # what was done tells more than what was asked for
        if any(line.startswith("n_left_rps") for line in found.lines.get("columns", ())):
            there = [n for n in there if not is_setpoint(n) and "turn" not in words_of(n)]
        sides = _sides(columns, found, there, shafts=is_named is is_shaft)
        if sides is not None:
            for target, source in zip(pair, sides, strict=True):
                convert(target, source, columns, found)
        elif there:
            convert(single, there[0], columns, found)
            alone.append(there[0])
            if len(there) > 1:
                found.questions.append(
                    f"{', '.join(there)}: {single} is taken from {there[0]} alone; if two of them "
                    f"are left and right, write {pair[0]} and {pair[1]} instead"
                )
        elif single == "delta_rad":
            line = "delta_rad = 0.0  # no angle found: fixed thrusters"
            add_line(found, "columns", line)
        else:
            found.missing.append(_LACKING)
    pulses = [is_pulses(columns.numbers[name]) for name in alone]
    if len(alone) == 2 and pulses[0] == pulses[1] and means(alone[1], NAMES["steering"]):
        more = _PULSES if pulses[0] else ""
        lines = " and ".join(
            entry(key, name, "", marked(columns, name, more))
            for key, name in zip(("throttle", "steering"), alone, strict=True)
        )
        found.questions.append(
            f"{', '.join(alone)}: of one rudder or drive? A boat that steers by two thrusters has "
            f"[skid_steering] with {lines}, in place of n_rps and delta_rad"
        )


def _sides(
    columns: Columns, found: Proposal, there: list[str], *, shafts: bool
) -> tuple[str, str] | None:
    """Return the columns of the left and the right, and ask where the names leave it open."""
    outputs = _autopilot_outputs(columns, there) if shafts else None
    if outputs is not None:
        found.questions.append(
            f"{outputs[0]}, {outputs[1]}: taken as left and right, as ArduPilot's skid steering "
            "has its outputs 1 and 3; if output 1 steers, write n_rps and delta_rad instead"
        )
        return outputs
    named = sides_of(there)
    if named is not None and other_side(named[0], [named[1]]) is None:
        return named
    if not there and shafts:
        # plain "left" and "right"
        bare = sides_of([n for n in columns.left if n in columns.numbers and is_side(n)])
        if bare is not None:
            found.questions.append(f"{bare[0]}, {bare[1]}: taken as the shafts")
        return bare
    pairs = (other_side(name, there[k + 1 :]) for k, name in enumerate(there))
    like = named or next((pair for pair in pairs if pair is not None), None)
    if like is not None:
        found.questions.append(
            f"{like[0]}, {like[1]}: taken as left and right; exchange them if it is the other way"
        )
    return like


def _autopilot_outputs(columns: Columns, there: list[str]) -> tuple[str, str] | None:
    """Return outputs 1 and 3 of an autopilot, where both move and output 2 does not."""
    moving: dict[str, str] = {}
    for name in there:
        found = [re.fullmatch(r"servo(\d)", word) for word in words_of(name)]
        values = known(columns.numbers[name])
        for match in found:
            if match is not None and len(values) and np.ptp(values) > 0.0:
                moving.setdefault(match[1], name)
    return (moving["1"], moving["3"]) if {"1", "3"} <= set(moving) and "2" not in moving else None


def find_pulses(columns: Columns, found: Proposal) -> None:
    """Take two columns of pulse widths as the shafts, where no column is named so."""
    pulses = [
        name
        for name in columns.left
        if is_pulses(values := columns.numbers.get(name, np.empty(0)))
        and (np.ptp(known(values)) > 20.0 or means(name, NAMES["channel"]))
    ]
    if _LACKING not in found.missing or len(pulses) != 2:
        return
    found.missing.remove(_LACKING)
    sides = sides_of(pulses) or pulses
    for target, name in zip(("n_left_rps", "n_right_rps"), sides, strict=True):
        _shaft(target, name, columns, found)
    found.questions.append(f"{sides[0]}, {sides[1]}: left and right? Or throttle and steering?")


def _shaft(target: str, name: str, columns: Columns, found: Proposal) -> None:
    values, rpm = known(columns.numbers[name]), is_rpm(name)
    most = float(np.abs(values).max(initial=0.0))
    if is_pulses(values) and not rpm:
        put(columns, found, target, name, "", _PULSES, "pulse width, 1500 us: stop")
        if (values == 1500.0).mean() < 0.02:
            found.questions.append(
                f"{name}: pulse widths, and stopped at 1500 us? Where it is 1000, offset = -20.0; "
                'if these are rpm, write unit = "rpm" alone'
            )
    elif unit_of(name, ("radps",)):
        put(columns, found, target, name, "radps")
    elif rpm or most > 150.0:
        if not rpm:
            found.questions.append(f"{name}: rpm, by its size? Else state its unit, or a scale")
        put(columns, found, target, name, "rpm", why="" if rpm else "by its size")
    else:
        put(columns, found, target, name, why="rev/s, or any unit: as in the particulars")


def _steer(target: str, name: str, columns: Columns, found: Proposal) -> None:
    values = known(columns.numbers[name])
    most, full = float(np.abs(values).max(initial=0.0)), ""
    if is_pulses(values):
        full, more = "2000 us", "scale = 0.001, offset = -1.5"
        why = "pulse width, 1500 us: midships"
    elif unit_of(name, ("percent",)):
        full, more = ("100", "scale = 0.005") if most > 1.0 else ("1", "scale = 0.5")
        why = "a share of full helm; above 0 must turn to starboard"
    if full:
        found.questions.append(
            f"{name}: {full} is taken as 0.5 rad, 29 degrees, to starboard; state the boat's own "
            "angle by scale and offset"
        )
        put(columns, found, target, name, "", more, why)
        return
    unit = unit_of(name, ("deg", "rad"))
    if not unit:
        unit = "deg" if most > 1.6 else "rad"
        found.questions.append(
            f"{name}: deg, rad or a share of full helm? {unit} is taken: it is within {most:.2g}"
        )
    why = "above 0 must turn to starboard"
    put(columns, found, target, name, "deg" if unit == "deg" else "", why=why)
