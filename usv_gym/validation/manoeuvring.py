"""Validation of manoeuvres: turns and zigzags of a tanker beside measurements."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from usv_gym.manoeuvring import indices, rao, trials
from usv_gym.manoeuvring.track import Track, TrackError
from usv_gym.physics import GRAVITY, KNOT, hull
from usv_gym.validation.study import DEGREE, ORIGIN, RUNS, SPEC, Recording, Row, Run, Section, Study
from usv_gym.vessel.vessel import Vessel, course_eigenvalues

# ---------------------------------------------------------------- KVLCC2

# physics.md 1.6: AD/L and DT/L (starboard, port), V/U0 (starboard), r' (starboard, port),
# overshoots 1 and 2 of the 10/10 zigzag and of the 20/20 zigzag (starboard, port)
MODEL = {
    "L7, n = 10.4 rps": (
        *((3.25, 3.26), (3.23, 3.22), 0.34, (0.854, 0.877)),
        *((5.2, 14.4), (7.5, 9.2), (10.8, 15.9), (14.3, 11.6)),
    ),
    "L7, n = 11.85 rps": (
        *((3.08, 3.09), (3.12, 3.11), 0.385, (0.858, 0.882)),
        *((5.0, 13.7), (7.1, 8.9), (10.5, 15.7), (13.7, 11.7)),
    ),
    "full scale, n = 1.53 rps": (
        *((3.15, 3.19), (3.13, 3.14), 0.33, (0.883, 0.901)),
        *((5.2, 14.0), (7.5, 8.9), (10.7, 15.5), (14.3, 11.4)),
    ),
    "full scale, n = 1.778 rps": (
        *((2.98, 3.00), (3.00, 3.01), 0.38, (0.887, 0.906)),
        *((5.0, 13.2), (7.0, 8.6), (10.5, 15.4), (13.7, 11.5)),
    ),
}

# physics.md 1.5, measured: (lab, starboard overshoots, port overshoots) of each zigzag
MEASURED_ZIGZAGS = {
    "10/10": (("MARIN", (8.2, 21.9), (9.5, 15.0)), ("HSVA", (9.7, 20.5), (9.7, 17.8))),
    "20/20": (("MARIN", (13.7, 14.9), (15.1, 13.3)),),
}

SIDES = ("starboard", "port")

ORDER = ("first", "second")


def tanker_trials(study: Study) -> Section:
    """Return the published trials of KVLCC2."""
    rows = []
    for case, got in study.tanker.items():
        AD, DT, ratio, rates, *overshoots = MODEL[case.removesuffix(", 6-DOF")]
        source = f"{SPEC} 1.6, computed apart from this code"
        for i, (turn, side) in enumerate(zip(got.turning, SIDES, strict=True)):
            where = f"{case}: 35 deg turn to {side}"
            # x_P' alone, on which sources differ, changes these by 1 %
            rows += [
                Row(f"{where}, AD/L", turn.advance, AD[i], 0.01, source),
                Row(f"{where}, DT/L", turn.tactical_diameter, DT[i], 0.01, source),
                Row(f"{where}, r'", turn.rate, rates[i], 0.01, source),
            ]
        ratio_got = got.turning[0].speed_ratio
        rows.append(Row(f"{case}: 35 deg turn to starboard, V/U0", ratio_got, ratio, 0.02, source))
        for name, zigzags, wants in (
            ("10/10", got.zigzag_10, overshoots[:2]),
            ("20/20", got.zigzag_20, overshoots[2:]),
        ):
            for zigzag, side, want in zip(zigzags, SIDES, wants, strict=True):
                for k, which in enumerate(ORDER):
                    item = f"{case}: {name} to {side}, {which} overshoot, deg"
                    value = zigzag.overshoots[k] / DEGREE
                    rows.append(Row(item, value, want[k], 0.3, source, "absolute"))
    n = rao.shaft_speed_for(study.model, 1.179)
    self_propulsion = f"{SPEC} 1.4, section 11"
    rows.append(Row("L7: self-propulsion at 1.179 m/s, rps", n, 11.85, 0.005, self_propulsion))
    return Section(
        "KVLCC2: trials, against a computation apart from this code",
        "The parameter set of Yasukawa and Yoshimura 2015 for the 7 m model and the ship, sailed "
        "through 35 degree turns and zigzags. The references are results of a separate "
        "computation with the same parameters, made for the specification of this project; they "
        "are neither measurements nor the paper's own table, which was not at hand. They say "
        "that the MMG equations came out alike twice, not that they are the ship: see the next "
        "two sections. The +-0.3 degrees and the 0.5 % are the specification's; 1 % and 2 % were "
        "chosen here, after seeing the values. At n = 10.4 rps the specification prints V/U0 "
        "from .34 and r' from .854 to .858, without a tolerance: both fall just outside. The "
        "wake by exp(-4 beta_P^2) is not implemented.",
        tuple(rows),
    )


def tanker_measured(study: Study) -> Section:
    """Return the trials of KVLCC2 beside those measured."""
    got = study.tanker["L7, n = 10.4 rps"]
    experiment = f"MARIN free-running tests, SIMMAN 2008 ({SPEC} 1.5)"
    rows = []
    for turn, side, AD, DT, allowed in zip(
        got.turning, SIDES, (3.25, 3.12), (3.34, 3.07), (0.05, 0.06), strict=True
    ):
        where = f"35 deg turn to {side}"
        rows += [
            Row(f"{where}, AD/L", turn.advance, AD, allowed, experiment),
            Row(f"{where}, DT/L", turn.tactical_diameter, DT, allowed, experiment),
        ]
    for turn, side, ratio, rate, transfer in zip(
        got.turning, SIDES, (0.366, 0.355), (0.80, 0.84), (1.36, 1.20), strict=True
    ):
        where = f"35 deg turn to {side}"
        rows += [
            Row(f"{where}, TR/L", turn.transfer, transfer, None, experiment, "reported"),
            Row(f"{where}, V/U0", turn.speed_ratio, ratio, None, experiment, "reported"),
            Row(f"{where}, r'", turn.rate, rate, None, experiment, "reported"),
        ]
    for name, labs in MEASURED_ZIGZAGS.items():
        zigzags = got.zigzag_10 if name == "10/10" else got.zigzag_20
        for lab, *measured in labs:
            for zigzag, side, want in zip(zigzags, SIDES, measured, strict=True):
                for k, which in enumerate(ORDER):
                    item = f"{lab} {name} to {side}, {which} overshoot, deg"
                    value = zigzag.overshoots[k] / DEGREE
                    lab_source = f"{lab}, SIMMAN 2008 ({SPEC} 1.5)"
                    rows.append(Row(item, value, want[k], None, lab_source, "reported"))
    return Section(
        "KVLCC2: the same trials, against the towing tanks",
        "The 7 m model at n = 10.4 rps beside free-running tests of two tanks. Turning circles "
        "agree within the 5 and 6 % that the specification allows. Overshoots of the 10/10 "
        "zigzag come out a fifth to a half too small; the specification knows this of the "
        "parameter set. The tanks differ from each other by up to 3 degrees. Overshoots are "
        "therefore not judged.",
        tuple(rows),
        {
            "kvlcc2_turns.png": "Turning circles of KVLCC2 at 35 degrees of rudder: simulated "
            "(thick), recorded by MARIN (thin), and the measured advance and tactical diameter "
            "(dots).",
            "kvlcc2_zigzags.png": "Zigzags of KVLCC2: heading as recorded, replayed with the "
            "recorded rudder, and of the free-sailing model; dots are measured overshoots.",
        },
    )


def tanker_replay(study: Study) -> Section:
    """Return how far the model strays when fed the recorded rudder and propeller."""
    rows: list[Row] = []
    source = "recorded run, SIMMAN 2008 (data not passed on)"
    for name, run in RUNS.items():
        items = ["position RMS, m", "position RMS, L", "position RMS to 30 s, L"]
        items.append("heading RMS, deg")
        if run.switch:
            items += [f"{which} overshoot, deg" for which in ORDER]
        else:
            items += ["AD/L", "DT/L", "r'"]
        recording = study.recordings.get(name)
        if recording is None:
            values: Sequence[tuple[float | None, float | None]] = [(None, None)] * len(items)
        else:
            values = _replay_errors(recording, run)
        skipped = "" if recording else "the recorded runs of KVLCC2 are not here"
        rows += [
            Row(f"{run.title}: {item}", value, want, None, source, "reported", 3, skipped)
            for item, (value, want) in zip(items, values, strict=True)
        ]
    return Section(
        "KVLCC2: recorded runs replayed",
        "Each recorded run once more: the model starts in the recorded state and is fed the "
        "recorded rudder angle and shaft speed; errors are over the whole run. Nothing is fitted "
        "and nothing is judged. The replay is poor: MARIN's runs stay within half a length, but "
        "the long zigzags of HSVA end up several lengths away, and overshoots are badly off. The "
        "rudder moved when the recorded ship was at the angle of the switch; the model is not "
        "there yet, and nothing brings its heading back. Growth of small errors is not the cause: "
        "the model is nearly neutral on its course, and 1e-3 rad/s more at the start moves these "
        "tracks by an RMS of .16 lengths or less. The cause was not found; the towed model had "
        "another propeller (0.204 m, here 0.216 m) and a rudder with a horn. '-': the heading "
        "never reached the switch.",
        tuple(rows),
    )


def _replay_errors(recording: Recording, run: Run) -> list[tuple[float | None, float | None]]:
    measured, replayed = recording.measured, recording.replayed
    apart = np.hypot(replayed.x - measured.x, replayed.y - measured.y)
    turned = replayed.psi - measured.psi
    sizes = apart, apart / 7.0, apart[measured.t <= 30.0] / 7.0, turned / DEGREE
    errors: list[tuple[float | None, float | None]] = [
        (math.sqrt(float(np.mean(size**2))), 0.0) for size in sizes
    ]
    if run.switch:
        pairs = [_overshoots(track, run.switch) for track in (replayed, measured)]
        return errors + list(zip(*pairs, strict=True))
    turns = [indices.turning(track, length=7.0, **ORIGIN) for track in (replayed, measured)]
    names = ("advance", "tactical_diameter", "rate")
    return errors + [(getattr(turns[0], name), getattr(turns[1], name)) for name in names]


def _overshoots(track: Track, switch: float) -> list[float | None]:
    """Return the first two overshoots in degrees, None where the heading never got so far."""
    try:
        got = indices.zigzag(track, length=7.0, switch=switch * DEGREE, **ORIGIN).overshoots
    except TrackError:
        got = ()
    return [got[k] / DEGREE if k < len(got) else None for k in range(2)]


# ---------------------------------------------------------------- plants
TURNS = (
    (11.0, 4.8, 17.5, 2.1),
    (20.0, 6.6, 21.0, 2.4),
    (30.0, 11.8, 24.0, 3.7),
    (38.0, 15.6, 29.0, 4.1),
)
"""Approach (kn), and speed (m/s), rate (deg/s) and radius (Loa) of the steady 20 deg turn."""

SAVITSKY = ((12, 7.4), (15, 6.7), (20, 5.7), (25, 5.2), (30, 5.3), (38, 6.05))
"""Speed (kn) and resistance (kN) of the bare hull at an LCG of 2.19 m."""


def plants(study: Study) -> Section:
    """Return the small boats: the 7.5 m boat and Telemetron."""
    boat, source = study.boat, f"{SPEC} 3.1"
    Loa = boat.values["length_overall"]
    rows = [
        Row(f"usv75: speed at {n:g} rps, kn", boat.straight_speed(n) / KNOT, knots, 0.015, source)
        for n, knots in ((20.4, 11.0), (25.6, 20.0), (39.7, 38.0))
    ]
    for knots, wants in ((8.0, (-0.59, -1.69)), (38.0, (-2.65, -8.0))):
        n = rao.shaft_speed_for(boat, knots * KNOT)
        for k, value in enumerate(course_eigenvalues(boat, n)):
            item = f"usv75 at {knots:g} kn: {ORDER[k]} eigenvalue of the course, 1/s"
            rows.append(Row(item, value.real, wants[k], 0.015, source))
    circles = {}
    for knots, speed, rate, radius in TURNS:
        n = rao.shaft_speed_for(boat, knots * KNOT)
        circles[knots] = track = trials.turning_circle(boat, angle=20.0 * DEGREE, n=n)
        u, v, r = track.motion[:, -1]
        U, where = math.hypot(u, v), f"usv75, 20 deg turn from {knots:g} kn"
        rows += [
            Row(f"{where}: speed, m/s", U, speed, 0.03, source),
            Row(f"{where}: rate, deg/s", float(r) / DEGREE, rate, 0.03, source),
            Row(f"{where}: radius, Loa", U / float(r) / Loa, radius, 0.03, source),
        ]
    for knots, advance, diameter in ((20.0, 5.3, 6.2), (38.0, 7.1, 8.9)):
        got = indices.turning(circles[knots], length=Loa, **ORIGIN)
        where = f"usv75, 20 deg turn from {knots:g} kn"
        rows += [
            Row(f"{where}: AD, Loa", got.advance, advance, 0.03, source),
            Row(f"{where}: DT, Loa", got.tactical_diameter, diameter, 0.03, source),
        ]
    swing = trials.zigzag(
        boat, switch=20.0 * DEGREE, helm=20.0 * DEGREE, n=rao.shaft_speed_for(boat, 11.0 * KNOT)
    )
    over = indices.zigzag(swing, length=Loa, switch=20.0 * DEGREE, **ORIGIN).overshoots
    within = f"{source}: 12 to 20 deg, and a degree"
    rows += [
        Row(
            "usv75, 20/20 at 11 kn: least overshoot, deg",
            min(over) / DEGREE,
            16,
            5,
            within,
            "absolute",
        ),
        Row(
            "usv75, 20/20 at 11 kn: largest overshoot, deg",
            max(over) / DEGREE,
            16,
            5,
            within,
            "absolute",
        ),
    ]
    p = boat.packed.copy()
    for knots, force in SAVITSKY:
        rows.append(
            Row(
                f"usv75: resistance at {knots} kn, kN",
                hull.resistance(knots * KNOT, p) / 1e3,
                force,
                None,
                "Savitsky 1964, bare hull: where the curve comes from, no check of it",
                "reported",
            )
        )
    v = boat.values
    volume = v["mass"] / v["water_density"]
    for knots in (20.0, 38.0):
        track = circles[knots]
        U, r = math.hypot(*track.motion[:2, -1]), float(track.motion[2, -1])
        froude = knots * KNOT / math.sqrt(GRAVITY * volume ** (1.0 / 3.0))
        slender = v["length_waterline"] / volume ** (1.0 / 3.0)
        want = (1.7 + 0.0222 * froude * slender**2.85) * 30.0 / 20.0
        rows.append(
            Row(
                f"usv75, 20 deg turn from {knots:g} kn: steady diameter, Lwl",
                2.0 * U / r / v["length_waterline"],
                want,
                None,
                "regression for planing boats, from memory of the literature, unverified",
                "reported",
                3,
            )
        )
    telemetron = Vessel.load("telemetron")
    n = telemetron.values["shaft_speed_max"]
    rows.append(
        Row(
            "Telemetron: u at 13.1 kN, m/s",
            telemetron.straight_speed(n),
            *(9.667, 1e-3, f"{SPEC} section 11"),
        )
    )
    return Section(
        "Small boats",
        "The 7.5 m boat of the paper has no published trials: its references are results of the "
        "same equations coded apart from this project, so they say that the code does what was "
        "meant, and nothing about the boat. Most of its coefficients are guesses, marked so in "
        "its file. Above 12 kn all that is known of planing is the resistance curve.",
        tuple(rows),
        {
            "speed_power.png": "Resistance and effective power of the vessels; dots are "
            "Savitsky's bare-hull points for the 7.5 m boat."
        },
    )
