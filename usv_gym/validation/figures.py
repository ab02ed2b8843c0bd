"""Pictures of the validation page; those of recorded data need the data."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from usv_gym.manoeuvring.track import Track
from usv_gym.physics import GRAVITY, KNOT, wind
from usv_gym.physics.hull import hull_forces
from usv_gym.validation.boundary_elements import BOATS, both
from usv_gym.validation.manoeuvring import SAVITSKY
from usv_gym.validation.sea import BLENDERMANN_LOADS, SEAS
from usv_gym.validation.study import DEGREE, HEADINGS, OMEGA, SPEEDS, Study, an_hour, realise
from usv_gym.vessel.vessel import Vessel, vessel_names
from usv_kernel.files import replacing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = [
    "PICTURES",
    "draw",
]

# Okabe and Ito's colours, for any kind of colour vision
BLUE, ORANGE, GREEN, RED = "#0072B2", "#E69F00", "#009E73", "#D55E00"

COLOURS = (BLUE, ORANGE, GREEN, RED, "#CC79A7", "#56B4E9")

GREY = "#606060"

DPI = 100

LENGTH = 7.0


def draw(study: Study, folder: Path) -> list[Path]:
    """Write every picture with available data to a folder, and return the paths."""
    written = []
    for name, picture in PICTURES.items():
        figure = picture(study)
        if figure is not None:
            # no date or version: equal pictures are equal bytes
            with replacing(folder / name) as partial:
                figure.savefig(partial, metadata={"Software": None}, pil_kwargs={"optimize": True})
            written.append(folder / name)
    return written


def _axes(rows: int, columns: int, width: float, height: float) -> tuple[Figure, Any]:
    """Return a figure without pyplot, and its axes."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), dpi=DPI, facecolor="white", layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False)
    for each in axes.flat:
        each.grid(visible=True, linewidth=0.5, alpha=0.4)
        each.spines[["top", "right"]].set_visible(False)
    return figure, axes


def _label(axes: Axes, x: str, y: str, title: str = "") -> None:
    """Label the axes."""
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.set_title(title, fontsize=10)


def turns(study: Study) -> Figure | None:
    """Turning circles of KVLCC2."""
    if not study.recordings:
        return None
    figure, ((axes,),) = _axes(1, 1, 7.0, 5.6)
    got = study.tanker["L7, n = 10.4 rps"]
    measured, replayed = study.recordings["marin_tc_35"]
    # a circle and a half
    for side, colour, AD, TR, DT in (
        ("starboard", BLUE, 3.25, 1.36, 3.34),
        ("port", ORANGE, 3.12, 1.20, 3.07),
    ):
        sign = 1.0 if side == "starboard" else -1.0
        track = got.tracks[f"turning circle to {side}"]
        part = np.abs(track.psi) < 3.0 * math.pi
        label = f"free-running model to {side}"
        axes.plot(track.y[part] / LENGTH, track.x[part] / LENGTH, color=colour, lw=2, label=label)
        marks = {"marker": "o", "ls": "", "color": colour, "mec": "black", "ms": 7}
        axes.plot([sign * TR], [AD], label=f"MARIN to {side}: AD, TR", **marks)
        axes.axvline(sign * DT, color=colour, lw=1, ls=":", label=f"MARIN to {side}: DT")
    tracks: tuple[tuple[Track, dict[str, Any], str], ...] = (
        (replayed, {"color": RED, "lw": 1.2, "ls": "--"}, "replay of the recorded rudder"),
        # smoothed, as the data have three figures
        (measured.smoothed(4.0), {"color": "black", "lw": 0.8}, "recorded by MARIN"),
    )
    for track, style, label in tracks:
        part = np.abs(track.psi - track.psi[0]) < 3.0 * math.pi
        axes.plot(track.y[part] / LENGTH, track.x[part] / LENGTH, label=label, **style)
    axes.set_aspect("equal")
    figure.legend(fontsize=8, loc="outside lower center", ncols=2)
    _label(axes, "to starboard, y/L", "ahead, x/L", "KVLCC2, 7 m model: 35 degrees of rudder")
    return figure


def zigzags(study: Study) -> Figure | None:
    """Zigzags of KVLCC2."""
    if not study.recordings:
        return None
    figure, axes = _axes(3, 1, 7.0, 8.0)
    got = study.tanker["L7, n = 10.4 rps"]
    cases = (
        ("marin_zz_10", "10/10 zigzag to port", "10/10, MARIN", -1.0, 10.0, (9.5, 15.0)),
        ("marin_zz_20", "20/20 zigzag to port", "20/20, MARIN", -1.0, 20.0, (15.1, 13.3)),
        ("hsva_z_10_10_s", "10/10 zigzag to starboard", "10/10, HSVA", 1.0, 10.0, (9.7, 20.5)),
    )
    for one, (name, trial, title, side, switch, overshoots) in zip(axes.flat, cases, strict=True):
        measured, replayed = study.recordings[name]
        free = got.tracks[trial]
        one.plot(measured.t, measured.helm / DEGREE, color=GREY, lw=0.7, label="recorded rudder")
        for track, style, label in (
            (free, {"color": BLUE, "lw": 2}, "free-running model"),
            (replayed, {"color": RED, "lw": 1.2, "ls": "--"}, "replay of the recorded rudder"),
            (measured, {"color": "black", "lw": 0.8}, "recorded"),
        ):
            one.plot(track.t, track.psi / DEGREE, label=label, **style)
        for k, over in enumerate(overshoots):
            peak = side * (-1.0) ** k * (switch + over)
            at = int(np.argmin(np.abs(measured.psi / DEGREE - peak)))
            one.plot(measured.t[at], peak, "o", color="black", ms=5)
        _label(one, "time, s", "heading, rudder, deg", title)
    axes[0, 0].legend(fontsize=8, ncols=2)
    return figure


def wind_coefficients(study: Study) -> Figure:
    """Wind coefficients with the reference points."""
    figure, ((axes,),) = _axes(1, 1, 7.0, 3.8)
    p = study.boat.packed.copy()
    gamma = np.linspace(0.0, 180.0, 361)
    values = np.array([wind.coefficients(g * DEGREE, p) for g in gamma]).T
    v = study.boat.values
    areas = np.array([v["A_F"], v["A_L"], v["A_L"] * v["length_overall"]])
    pressure = 0.5 * 1.224 * 100.0
    for k, (name, colour) in enumerate((("C_X", BLUE), ("C_Y", ORANGE), ("5 C_N", GREEN))):
        scale = 5.0 if k == 2 else 1.0
        axes.plot(gamma, scale * values[k], color=colour, lw=2, label=name)
        x, y = np.array([(g, load[k]) for g, load in BLENDERMANN_LOADS], dtype=float).T
        axes.plot(x, scale * y / pressure / areas[k], "o", color=colour, mec="black")
    axes.legend()
    axes.set_xticks(range(0, 181, 30))
    title = "Blendermann, speed boat (dots: reference)"
    _label(axes, "apparent wind off the bow, deg", "coefficient", title)
    return figure


def seas(study: Study) -> Figure | None:
    """Given spectra, and those of an hour of elevation."""
    if not study.hours:
        return None
    figure, axes = _axes(1, 2, 9.0, 3.8)
    one, other = axes[0]
    for (name, state), colour in zip(SEAS.items(), COLOURS, strict=False):
        f, density = an_hour(realise(state, study.boat))[1:]
        table = state.wave_spectrum()
        one.plot(table.omega / (2 * math.pi), table.density * 2 * math.pi, color=colour, label=name)
        one.plot(f, density, ".", color=colour, ms=4)
    one.set_xlim(0.0, 0.8)
    one.legend(fontsize=8)
    _label(one, "frequency, Hz", "density, m2/Hz", "named spectra")
    hour = list(study.hours)[6]
    got = study.hours[hour]
    other.plot(got.f, got.density, color="black", lw=1.5, label="buoy")
    other.plot(got.f, got.estimate, "o", color=BLUE, ms=4, label="an hour simulated")
    other.legend(fontsize=8)
    _label(other, "frequency, Hz", "density, m2/Hz", f"NDBC 46042, {hour}")
    return figure


def hull_in_waves(study: Study) -> Figure:
    """Response amplitudes of four boats, and those of a boundary-element code."""
    figure, axes = _axes(len(BOATS), 3, 7.0, 7.2)
    for row, name in enumerate(BOATS):
        boat, table = Vessel.load(name), study.table(name)
        scale = math.sqrt(GRAVITY / boat.values["length_waterline"])
        fine, few = (np.linspace(0.64, 4.0, count) * scale for count in (60, 15))
        lines, dots = both(boat, table, fine), both(boat, table, few)
        for column, motion in enumerate(("heave", "roll", "pitch")):
            one = axes[row, column]
            for direction, colour in zip(("beam", "bow", "head"), COLOURS, strict=False):
                if (motion, direction) in lines:
                    one.plot(fine, lines[motion, direction][0], color=colour, label=direction)
                    one.plot(few, dots[motion, direction][1], "o", color=colour, ms=4)
            unit = "m/m" if motion == "heave" else "deg/m"
            last = row == len(BOATS) - 1
            _label(one, "wave frequency, rad/s" if last else "", f"{motion}, {unit}", name)
            one.set_ylim(bottom=0.0)
    axes[0, 0].legend(fontsize=8)
    return figure


def raos(study: Study) -> Figure:
    """Response amplitudes, and Jensen's."""
    figure, axes = _axes(3, 2, 7.2, 6.4)
    k = OMEGA**2 / GRAVITY
    low = OMEGA <= 4.6
    for column, speed in enumerate(SPEEDS):
        for heading, colour in zip(HEADINGS, COLOURS, strict=False):
            got, closed = study.responses[heading, speed], study.jensen(heading, speed)
            for row, (simulated, theory) in enumerate(
                ((got.heave, closed[0]), (got.pitch / k, closed[1] / k), (got.roll / k, None))
            ):
                if (row, heading) in ((1, "beam"), (2, "head")):
                    continue
                one, x = axes[row, column], OMEGA[low]
                one.plot(x, simulated[low], color=colour, lw=1.8, label=heading)
                if theory is not None:
                    one.plot(x, theory[low], color=colour, lw=1.2, ls="--")
        for row, label in enumerate(("heave / wave", "pitch / slope", "roll / slope")):
            title = f"U = {speed:g} m/s" if row == 0 else ""
            _label(axes[row, column], "wave frequency, rad/s" if row == 2 else "", label, title)
            axes[row, column].set_ylim(bottom=0.0)
    axes[0, 0].plot([], [], color=GREY, ls="--", label="Jensen 2004")
    axes[0, 0].legend(fontsize=8)
    axes[2, 0].legend(fontsize=8)
    return figure


def speed_power(study: Study) -> Figure:
    """Resistance and effective power of the vessels."""
    figure, axes = _axes(1, 2, 9.0, 4.2)
    for name, colour in zip(vessel_names(), COLOURS, strict=False):
        vessel = Vessel.load(name)
        p, v = vessel.packed.copy(), vessel.values
        u = np.linspace(0.0, vessel.straight_speed(v["shaft_speed_max"]), 200)[1:]
        force = np.array([-hull_forces(float(x), 0.0, 0.0, p)[0] for x in u])
        weight = v["mass"] * GRAVITY
        froude = u / math.sqrt(GRAVITY * v["length_waterline"])
        axes[0, 0].plot(froude, force / weight, color=colour, lw=1.8, label=name)
        axes[0, 1].plot(u / KNOT, force * u / 1e3, color=colour, lw=1.8, label=name)
        if name == study.boat.name:
            knots, kilonewton = np.array(SAVITSKY).T
            froude = knots * KNOT / math.sqrt(GRAVITY * v["length_waterline"])
            style = {"ls": "", "marker": "o", "color": colour, "mec": "black", "ms": 5}
            axes[0, 0].plot(froude, 1e3 * kilonewton / weight, **style)
            axes[0, 1].plot(knots, kilonewton * knots * KNOT, **style)
    for one in axes[0]:
        one.set_yscale("log")
    axes[0, 1].set_xscale("log")
    axes[0, 0].set_ylim(1e-4, 1.0)
    axes[0, 1].set_xlim(0.5, 60.0)
    axes[0, 1].set_ylim(1e-3, 1e5)
    axes[0, 0].legend(fontsize=8)
    _label(axes[0, 0], "Froude number", "resistance / weight")
    _label(axes[0, 1], "speed, kn", "effective power, kW")
    return figure


PICTURES: dict[str, Callable[[Study], Figure | None]] = {
    "kvlcc2_turns.png": turns,
    "kvlcc2_zigzags.png": zigzags,
    "wind.png": wind_coefficients,
    "spectra.png": seas,
    "hull_in_waves.png": hull_in_waves,
    "raos.png": raos,
    "speed_power.png": speed_power,
}
"""Functions that draw the pictures; they return None without the data."""
