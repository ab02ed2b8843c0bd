"""Validation of motions in waves against a boundary-element code."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from usv_gym.hydro.motions import natural_frequencies, response
from usv_gym.hydro.table import HydroTable, between
from usv_gym.manoeuvring import rao
from usv_gym.physics import GRAVITY, spectra
from usv_gym.physics import frames as fr
from usv_gym.physics.waves import drift_at
from usv_gym.validation.seakeeping import decay
from usv_gym.validation.study import DEGREE, Array, Row, Section, Study, rows
from usv_gym.vessel.vessel import Vessel
from usv_gym.world.sea import SeaState

BOATS = ("usv75", "telemetron", "otter", "wamv16")

MOTIONS = {"heave": 2, "roll": 3, "pitch": 4}
"""Motions and their places among six."""

DIRECTIONS = {"beam": 90, "bow": 135, "head": 180}
"""Headings, degrees."""

FREQUENCIES = np.linspace(0.64, 2.8, 10)
"""Wave frequencies of the amplitudes over sqrt(g / L): waves of 15 to .8 lengths."""

SEAS = {"sea state 2": 0.3, "sea state 3": 0.88}
"""Significant heights, m."""

SPECTRUM = np.geomspace(0.9, 9.0, 48)
"""Frequencies of the amplitudes in irregular seas, rad/s."""

CODE = "capytaine 3.0.0"


def hull_in_waves(study: Study) -> Section:
    """Return amplitudes, motions in irregular seas, free motions and mean drift of four boats."""
    found: list[Row] = []
    for name in BOATS:
        found += boat_in_waves(Vessel.load(name), study.table(name))
    return Section(
        "Motions in waves against a boundary-element code",
        "Shown are simulated boats at rest, and beside them linear theory with added mass, damping "
        "and excitation of the code at each frequency. The boat in time has constant added mass "
        "and damping; what they lack is part of the loads. Viscous roll damping is 5 % of the "
        "critical one in both, a guess. The hulls are drawn from main particulars, so this "
        "validates the motions of these hulls and not the shape of real boats. References are from "
        "the tables in usv_gym/vessel/vessels, which the slow tests compute again. Natural periods "
        "are of a free decay, where heave and pitch couple. Drift of a simulated sea is beside an "
        "integral over its spectrum.",
        tuple(found),
        {"hull_in_waves.png": f"Amplitudes of four boats: simulated (lines) and {CODE} (dots)."},
    )


def boat_in_waves(boat: Vessel, table: HydroTable) -> list[Row]:
    """Return the rows of a boat with a table, beside those that a table gives for it."""
    parts = _amplitudes, _irregular, _free, _drift
    return [row for part in parts for row in part(boat, table)]


def _modes() -> Iterator[tuple[str, str]]:
    """Return each motion with each heading at which a boat alike on both sides has it."""
    for motion in MOTIONS:
        for direction in DIRECTIONS:
            if (motion, direction) not in (("roll", "head"), ("pitch", "beam")):
                yield motion, direction


def both(
    boat: Vessel, table: HydroTable, omega: Array
) -> dict[tuple[str, str], tuple[Array, Array]]:
    """Return the amplitudes of simulation and table at frequencies (rad/s), by motion and heading.

    Per wave amplitude: m/m and degrees/m.
    """
    motions = response(table, boat.with_table(table).values)
    out = {}
    for direction, degrees in DIRECTIONS.items():
        ours = rao.responses(boat, omega, degrees * DEGREE)
        column = round(degrees * DEGREE / math.pi * (len(table.heading) - 1))
        theirs = np.abs(between(omega, table.omega, motions[:, column]))
        for motion, place in MOTIONS.items():
            unit = 1.0 if motion == "heave" else DEGREE
            pair = np.asarray(getattr(ours, motion)) / unit, theirs[:, place] / unit
            out[motion, direction] = pair
    return {key: out[key] for key in _modes()}


def _amplitudes(boat: Vessel, table: HydroTable) -> list[Row]:
    """Return rows of response amplitudes in regular waves."""
    omega = FREQUENCIES * math.sqrt(GRAVITY / boat.values["length_waterline"])
    entries = [
        (f"{boat.name}, {motion}, {direction}, w = {w:.2f}: {_unit(motion)}/m", a, b)
        for (motion, direction), pair in both(boat, table, omega).items()
        for w, a, b in zip(omega, *pair, strict=True)
    ]
    return rows(entries, CODE, 0.1, digits=3)


def _irregular(boat: Vessel, table: HydroTable) -> list[Row]:
    """Return rows of the standard deviation of motions in PM seas."""
    pairs = both(boat, table, SPECTRUM)
    return rows(
        (
            (
                f"{boat.name}, {sea}, {direction}: rms {motion}, {_unit(motion)}",
                _rms(ours, hs),
                _rms(theirs, hs),
            )
            for sea, hs in SEAS.items()
            for (motion, direction), (ours, theirs) in pairs.items()
        ),
        CODE,
        0.05,
        digits=3,
    )


def _rms(amplitude: Array, hs: float) -> float:
    density = spectra.pm_spectrum(SPECTRUM, hs)
    return math.sqrt(float(np.trapezoid(amplitude**2 * density, SPECTRUM)))


def _unit(motion: str) -> str:
    return "m" if motion == "heave" else "deg"


def _free(boat: Vessel, table: HydroTable) -> list[Row]:
    """Return rows of natural periods, and of added masses there."""
    v = boat.values
    at = natural_frequencies(table, v)
    columns = {"heave": fr.Z, "roll": fr.PHI, "pitch": fr.THETA}
    periods = [
        (
            f"{boat.name}, free decay: {motion}, period, s",
            decay(boat, column)[0],
            2.0 * math.pi / getattr(at, motion),
        )
        for motion, column in columns.items()
    ]
    A_33, A_55 = table.at(at.heave)[0][0, 2, 2], table.at(at.pitch)[0][0]
    about = A_55[4, 4] + 2.0 * v["x_F"] * A_55[2, 4] + v["x_F"] ** 2 * A_55[2, 2]
    masses = [
        (f"{boat.name}: added mass of heave over mass", v["m_z"] / v["mass"], A_33 / v["mass"]),
        (
            f"{boat.name}: added inertia of pitch over inertia",
            v["J_yy"] / v["I_yy"],
            about / v["I_yy"],
        ),
    ]
    return rows(periods, CODE, 0.1, digits=3) + rows(masses, CODE, 0.02, digits=3)


def _drift(boat: Vessel, table: HydroTable) -> list[Row]:
    """Return rows of the mean drift in irregular seas."""
    if table.drift is None:
        return []
    omega, entries = np.linspace(table.omega[0], table.omega[-1], 2000), []
    for sea, hs in SEAS.items():
        state = SeaState(hs=hs, wave_to=0.0)
        drawn = state.realise(boat, *np.random.default_rng(0).spawn(2)).weather["drift_table"]
        density = 2.0 * spectra.pm_spectrum(omega, hs)
        for direction, degrees in DIRECTIONS.items():
            column = round(degrees * DEGREE / math.pi * (len(table.heading) - 1))
            of_code = between(omega, table.omega, table.drift[:, column])
            # waves that go north, on a boat turned to port
            ours = drift_at(-degrees * DEGREE, np.asarray(drawn))
            for i, name in enumerate(("X", "Y")):
                if (name, direction) not in (("X", "beam"), ("Y", "head")):
                    wanted = float(np.trapezoid(density * of_code[:, i], omega))
                    entries.append(
                        (f"{boat.name}, {sea}, {direction}: drift {name}, N", ours[i], wanted)
                    )
    return rows(entries, CODE, 0.1, digits=3)
