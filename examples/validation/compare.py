"""Ship and sea beside towing tanks and a boundary-element code: docs/explanation/validation.md.

python examples/validation/compare.py                      # prints the tables, half a minute
python examples/validation/compare.py --pictures docs/explanation/validation
python examples/validation/compare.py --recorded FOLDER    # recorded runs, which nobody may pass on
"""

import argparse
import math
from pathlib import Path

import numpy as np
import rao
import trials
from matplotlib.figure import Figure
from trials import Track

from usv_gym import SeaState, Vessel
from usv_gym.hydro.motions import response
from usv_gym.hydro.table import between
from usv_gym.physics import GRAVITY, ship, spectra
from usv_gym.physics import frames as fr
from usv_gym.physics.waves import drift_at
from usv_gym.world.simulation import Simulation

LENGTH_M, SHAFT_RPS, SPEED_MPS = 7.0, 10.4, 1.179
"""The 7 m model of KVLCC2 in the tests."""

# Free-running tests for SIMMAN 2008, to starboard and to port.
TURNS = {
    "35 deg turn: advance, L": ("advance", (3.25, 3.12)),
    "transfer, L": ("transfer", (1.36, 1.20)),
    "tactical diameter, L": ("tactical_diameter", (3.34, 3.07)),
    "speed over that of the approach": ("speed_ratio", (0.366, 0.355)),
    "rate r L / U": ("rate", (0.80, 0.84)),
}
# first and second overshoot, degrees
ZIGZAGS = {
    ("10/10", "MARIN"): ((8.2, 21.9), (9.5, 15.0)),
    ("10/10", "HSVA"): ((9.7, 20.5), (9.7, 17.8)),
    ("20/20", "MARIN"): ((13.7, 14.9), (15.1, 13.3)),
}

BOATS = ("usv75", "telemetron", "otter", "wamv16")
MOTIONS = {"heave": 2, "roll": 3, "pitch": 4}
MOTIONS_AT = {90: ("heave", "roll"), 135: ("heave", "roll", "pitch"), 180: ("heave", "pitch")}
"""Motions by heading, degrees; 180 is a head sea."""

RECORDED = {
    "marin_tc_35": "MARIN 35 deg turn to port",
    "marin_zz_10": "MARIN 10/10, port first",
    "marin_zz_20": "MARIN 20/20, port first",
    "hsva_z_10_10_s": "HSVA 10/10, starboard first",
    "hsva_z_20_10_s": "HSVA 20/10, starboard first",
    "hsva_z_05_01": "HSVA 5/1",
    "hsva_z_10_05": "HSVA 10/5",
    "hsva_z_15_05": "HSVA 15/5",
    "hsva_z_30_05": "HSVA 30/5",
}


def table(heads, rows):
    """Print a Markdown table; numbers have three figures."""
    shown = [[f"{x:.3g}" if isinstance(x, float) else str(x) for x in row] for row in rows]
    for line in (heads, ["---"] * len(heads), *shown):
        print("| " + " | ".join(line) + " |")
    print()


def tanks():
    """Trials of KVLCC2 beside the towing tanks."""
    found = trials.standard_trials(Vessel.load("kvlcc2_l7"), SHAFT_RPS, speed=SPEED_MPS)
    rows = []
    for item, (index, measured) in TURNS.items():
        here = [getattr(turn, index) for turn in found.turning]
        rows.append((item, "MARIN", here[0], measured[0], here[1], measured[1]))
    for (name, tank), measured in ZIGZAGS.items():
        runs = found.zigzag_10 if name == "10/10" else found.zigzag_20
        for k, which in enumerate(("first", "second")):
            here = [math.degrees(run.overshoots[k]) for run in runs]
            item = f"{name}: {which} overshoot, deg"
            rows.append((item, tank, here[0], measured[0][k], here[1], measured[1][k]))
    table(("", "tank", "to starboard", "measured", "to port", "measured"), rows)


def amplitudes(boat, omega):
    """Yield heading, motion, simulated amplitudes and those of the boat's table."""
    theory = response(boat.hydro, boat.values)
    for degrees, motions in MOTIONS_AT.items():
        ours = rao.responses(boat, omega, math.radians(degrees))
        column = round(degrees / 180 * (len(boat.hydro.heading) - 1))
        theirs = np.abs(between(omega, boat.hydro.omega, theory[:, column]))
        for motion in motions:
            yield degrees, motion, getattr(ours, motion), theirs[:, MOTIONS[motion]]


def frequencies(boat, count, longest=0.64, shortest=2.8):
    """Wave frequencies, rad/s, of waves from 15 to .8 lengths."""
    scale = math.sqrt(GRAVITY / boat.values["length_waterline"])
    return np.linspace(longest, shortest, count) * scale


def percent(got, want):
    """Largest difference, %."""
    return float(100.0 * np.max(np.abs(np.divide(got, want) - 1.0)))


def boundary_elements():
    """Largest differences of simulated boats at rest from linear theory of their tables."""
    rows = []
    for name in BOATS:
        boat = Vessel.load(name)
        largest = dict.fromkeys(MOTIONS, 0.0)
        for _, motion, got, want in amplitudes(boat, frequencies(boat, 10)):
            largest[motion] = max(largest[motion], percent(got, want))
        omega, irregular = np.geomspace(0.9, 9.0, 48), []
        for _, _, got, want in amplitudes(boat, omega):
            for hs in (0.3, 0.88):
                density = spectra.pm_spectrum(omega, hs)
                squares = [np.trapezoid(a**2 * density, omega) for a in (got, want)]
                irregular.append(percent(*np.sqrt(squares)))
        rows.append((name, *largest.values(), max(irregular), largest_drift_error(boat)))
    heads = ("boat", "heave, %", "roll, %", "pitch, %", "rms in sea states 2 and 3, %", "drift, %")
    table(heads, rows)


def largest_drift_error(boat):
    """Difference of the drift of simulated seas from an integral over the spectrum, %."""
    omega, errors = np.linspace(boat.hydro.omega[0], boat.hydro.omega[-1], 2000), []
    for hs in (0.3, 0.88):
        simulation = Simulation(1, boat, SeaState(hs=hs, wave_to=0.0))
        simulation.reset([0], [np.random.default_rng(0)])
        drawn = np.asarray(simulation.weather[0]["drift_table"])
        for degrees in MOTIONS_AT:
            column = round(degrees / 180 * (len(boat.hydro.heading) - 1))
            of_table = between(omega, boat.hydro.omega, boat.hydro.drift[:, column])
            found = drift_at(-math.radians(degrees), drawn)
            for place in (0, 1):
                if (place, degrees) not in ((0, 90), (1, 180)):
                    load = 2.0 * spectra.pm_spectrum(omega, hs) * of_table[:, place]
                    errors.append(percent(found[place], np.trapezoid(load, omega)))
    return max(errors)


def replays(folder):
    """The model with the recorded rudder and shaft speed, from the recorded start."""
    rows = []
    for name, title in RECORDED.items():
        measured, replayed = replay(folder / f"{name}.csv.gz")
        off = np.hypot(replayed.x - measured.x, replayed.y - measured.y) / LENGTH_M
        turned = np.degrees(replayed.psi - measured.psi)
        overshoots = "-", "-"
        if title[-1].isdigit() or "first" in title:
            switch = float(title.split("/")[1].split(",")[0])
            overshoots = [first_overshoot(track, switch) for track in (replayed, measured)]
        sizes = [math.sqrt(np.mean(x**2)) for x in (off[measured.t <= 30.0], off, turned)]
        rows.append((title, *sizes, *overshoots))
    heads = "position rms to 30 s, L", "position rms, L", "heading rms, deg"
    table(("run", *heads, "first overshoot, deg", "recorded"), rows)


def replay(path):
    """Return the recorded and the simulated track."""
    log = np.genfromtxt(path, delimiter=",", names=True)
    names = {"t": "t_s", "x": "x_m", "y": "y_m", "psi": "psi_rad", "u": "u_mps", "v": "v_mps"}
    names |= {"r": "r_radps", "delta": "delta_rad"}
    measured = Track(**{ours: log[theirs] for ours, theirs in names.items()})
    shaft, helm = log["n_rps"], measured.delta
    columns = {"x": fr.X, "y": fr.Y, "psi": fr.PSI, "u": fr.U, "v": fr.V, "r": fr.R}
    states = np.zeros((len(measured.t), fr.STATE_SIZE))
    for name, column in columns.items():
        states[0, column] = getattr(measured, name)[0]
    model, sea = ship.Ship(Vessel.load("kvlcc2_l7").packed.copy(), 3), ship.calm_sea()
    work, command = np.zeros((ship.WORK_ROWS, fr.STATE_SIZE)), np.empty(4)
    for k, dt in enumerate(np.diff(measured.t)):
        # mean rudder angle and shaft speed of the step
        command[:2], command[2:] = shaft[k : k + 2].mean(), helm[k : k + 2].mean()
        states[k + 1] = states[k]
        states[k + 1, fr.N_LEFT :] = command
        ship.step(states[k + 1], command, model, sea, 0.0, float(dt), work)
    motion = {name: states[:, column] for name, column in columns.items()}
    return measured, Track(t=measured.t, delta=helm, **motion)


def first_overshoot(track, switch):
    """Return it in degrees; a dash where the heading never reached the switch."""
    try:
        found = trials.zigzag_indices(track, math.radians(switch), origin=0.0, heading=0.0)
    except ValueError:
        return "-"
    return math.degrees(found.overshoots[0]) if found.overshoots else "-"


def axes_of(rows, columns, width, height):
    figure = Figure(figsize=(width, height), dpi=100, facecolor="white", layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False)
    for one in axes.flat:
        one.grid(visible=True, linewidth=0.5, alpha=0.4)
        one.spines[["top", "right"]].set_visible(False)
    return figure, axes


def draw_turns(path):
    """Turning circles of KVLCC2 with the measured advance, transfer and diameter."""
    figure, ((one,),) = axes_of(1, 1, 7.0, 3.2)
    for side, sign, colour in (("starboard", 1.0, "#0072B2"), ("port", -1.0, "#E69F00")):
        k = 0 if sign > 0 else 1
        track = trials.turning_circle(
            Vessel.load("kvlcc2_l7"), sign * math.radians(35.0), n=SHAFT_RPS, speed=SPEED_MPS
        )
        part = np.abs(track.psi) < 3.0 * math.pi
        x, y = track.x[part] / LENGTH_M, track.y[part] / LENGTH_M
        one.plot(y, x, color=colour, lw=2, label=f"to {side}")
        advance, transfer, diameter = (
            TURNS[item][1][k]
            for item in ("35 deg turn: advance, L", "transfer, L", "tactical diameter, L")
        )
        marks = {"marker": "o", "ls": "", "color": colour, "mec": "black"}
        one.plot(sign * transfer, advance, label="MARIN: advance, transfer", **marks)
        one.axvline(sign * diameter, color=colour, ls=":", label="MARIN: tactical diameter")
    one.set_aspect("equal")
    one.set(xlabel="to starboard, y/L", ylabel="ahead, x/L")
    figure.legend(fontsize=8, loc="outside right")
    save(figure, path)


def draw_amplitudes(path):
    """Response amplitudes of four boats: simulated, and dots of the boundary-element code."""
    figure, axes = axes_of(len(BOATS), 3, 7.0, 7.2)
    colours = dict(zip(MOTIONS_AT, ("#0072B2", "#E69F00", "#009E73"), strict=True))
    for row, name in zip(axes, BOATS, strict=True):
        boat = Vessel.load(name)
        many, few = frequencies(boat, 60, shortest=4.0), frequencies(boat, 15, shortest=4.0)
        for omega, is_line in ((many, True), (few, False)):
            for degrees, motion, ours, theirs in amplitudes(boat, omega):
                unit = 1.0 if motion == "heave" else math.radians(1.0)
                one = row[list(MOTIONS).index(motion)]
                if is_line:
                    one.plot(omega, ours / unit, color=colours[degrees], label=f"{degrees} deg")
                else:
                    one.plot(omega, theirs / unit, "o", color=colours[degrees], ms=4)
        for one, motion in zip(row, MOTIONS, strict=True):
            one.set_ylabel(f"{motion}, {'m/m' if motion == 'heave' else 'deg/m'}")
            one.set_title(name, fontsize=10)
            one.set_ylim(bottom=0.0)  # after all curves, which set the top
    for one in axes[-1]:
        one.set_xlabel("wave frequency, rad/s")
    axes[0, 0].legend(fontsize=8)
    save(figure, path)


def save(figure, path):
    # no date or version: equal pictures are equal bytes
    figure.savefig(path, metadata={"Software": None}, pil_kwargs={"optimize": True})


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--recorded", type=Path, help="folder kvlcc2_simman2008 of recorded runs")
    parser.add_argument("--pictures", type=Path, help="folder to write the pictures to")
    options = parser.parse_args()
    tanks()
    boundary_elements()
    if options.recorded:
        replays(options.recorded)
    if options.pictures:
        options.pictures.mkdir(parents=True, exist_ok=True)
        draw_turns(options.pictures / "kvlcc2_turns.png")
        draw_amplitudes(options.pictures / "hull_in_waves.png")


if __name__ == "__main__":
    main()
