"""Recorded runs of five vessels: their findings, and the faults that are put into them."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from twin.logs.datasets import known_ship
from twin.logs.diagnosis.diagnose import diagnose
from twin.logs.diagnosis.findings import NOTE, Finding, Recording
from twin.logs.log import read_table
from twin.particulars import Particulars

DATA = Path(__file__).resolve().parents[3].parent / "shared" / "data"

SOUND = {
    "blueboat_trondheim": {
        "blueboat_216": "gyro-compass",
        "blueboat_218": "sides-unknown",
        "blueboat_220": "",
        "blueboat_221": "sides-unknown",
        "blueboat_223": "",
        "blueboat_225": "",
        "blueboat_226": "",
        "blueboat_228": "",
        "blueboat_230": "fix-steps",
        "blueboat_232": "sides-unknown",
        "blueboat_233": "",
        "blueboat_234": "",
    },
    "boat1_usv": {
        "boat1_2_circle": "compass-beyond-turn fix-stamps",
    },
    "esso_osaka_frt": {
        "berthing_12-Nov-2020_11_07_23": "",
        "berthing_12-Nov-2020_11_14_47": "fix-steps",
        "berthing_12-Nov-2020_11_21_46": "sides-unknown",
        "berthing_12-Nov-2020_13_37_05": "",
        "random_03-Aug-2020_11_04_37": "fix-steps",
        "random_06-Aug-2020_16_24_25_1": "fix-steps",
        "random_06-Aug-2020_16_24_25_4": "fix-steps",
        "random_06-Aug-2020_16_24_25_6": "fix-steps rest",
        "random_31-Jul-2020_12_29_58": "fix-steps",
        "random_31-Jul-2020_12_48_39": "compass-steps fix-steps",
        "turn_14-Oct-2020_14_17_39": "fix-steps sides-unknown",
        "turn_14-Oct-2020_14_29_49": "compass-beyond-turn fix-steps sides-unknown",
        "turn_14-Oct-2020_14_56_07": "compass-beyond-turn fix-steps sides-unknown",
        "turn_14-Oct-2020_15_21_57": "compass-beyond-turn fix-steps sides-unknown",
        "turn_14-Sep-2020_13_39_32": "compass-beyond-turn fix-steps",
        "turn_14-Sep-2020_14_16_04": "compass-beyond-turn sides-unknown",
        "turn_14-Sep-2020_14_50_41": "compass-beyond-turn fix-steps sides-unknown",
        "turn_14-Sep-2020_15_58_08": "compass-beyond-turn sides-unknown",
        "turn_cut_14-Sep-2020_15_58_08": "sides-unknown",
        "zigzag_31-Jul-2020_13_22_52": "fix-steps",
        "zigzag_31-Jul-2020_13_29_19": "fix-steps",
        "zigzag_31-Jul-2020_13_50_28": "compass-steps fix-steps",
        "zigzag_31-Jul-2020_13_57_45": "compass-steps fix-steps",
        "zigzag_31-Jul-2020_14_03_39": "fix-steps",
    },
    "kvlcc2_simman2008": {
        "hsva_z_05_01": "",
        "hsva_z_10_05": "",
        "hsva_z_10_10_s": "",
        "hsva_z_15_05": "",
        "hsva_z_20_10_s": "",
        "hsva_z_30_05": "",
        "marin_tc_35": "compass-beyond-turn sides-unknown",
        "marin_zz_10": "",
        "marin_zz_20": "",
    },
    "otter_oslofjord": {
        "otter_12-22-10": "fix-lost fix-stamps gyro-compass stale-rows time-jitter time-skips",
        "otter_12-32-31": "fix-stamps time-jitter",
        "otter_12-35-58": "compass-steps fix-stamps stale-rows time-jitter",
        "otter_12-44-08": "fix-jumps fix-stamps fix-steps time-jitter time-skips",
        "otter_15-30-52": "compass-steps fix-stamps stale-rows time-jitter time-skips",
        "otter_16-07-36": "fix-lost fix-stamps fix-steps gyro-compass stale-rows time-jitter "
        "time-skips",
    },
}
"""Findings of each run as it was recorded."""

Columns = dict[str, np.ndarray]
Fault = Callable[[Columns], None]
N = ("n_left_rps", "n_right_rps")


@functools.cache
def recorded(folder: str, run: str) -> tuple[Columns, Particulars | None]:
    path = DATA / folder / f"{run}.csv.gz"
    if not path.exists():
        pytest.skip(f"{path} is absent: recorded runs are not part of the project")
    boats = {"otter_oslofjord": "otter.toml", "blueboat_trondheim": "blueboat.toml"}
    boat = Particulars.load(DATA / folder / boats[folder]) if folder in boats else None
    return read_table(path).data, boat or known_ship(path)


def found_in(folder: str, run: str, fault: Fault | None = None) -> tuple[Finding, ...]:
    columns, boat = recorded(folder, run)
    data = {name: np.array(values) for name, values in columns.items()}
    if fault is not None:
        fault(data)
    return diagnose(Recording.of(data, {}, run), boat).findings


EACH = [(folder, run) for folder, runs in SOUND.items() for run in runs]


@pytest.mark.parametrize(("folder", "run"), EACH)
def test_findings_of_recorded_runs_stay(folder: str, run: str) -> None:
    codes = sorted(finding.code for finding in found_in(folder, run))
    assert " ".join(codes) == SOUND[folder][run]


# --- faults: how many runs of each vessel must show them ------------------------------------------


def swap_fixes(data: Columns) -> None:
    for first, second in (("gps_x_m", "gps_y_m"), ("gps_vx_mps", "gps_vy_mps")):
        if first in data:
            data[first], data[second] = data[second], data[first]


def turn_compass(degrees: float) -> Fault:
    def fault(data: Columns) -> None:
        data["compass_rad"] += math.radians(degrees)

    return fault


def change(factor: float, *names: str) -> Fault:
    def fault(data: Columns) -> None:
        for name in names:
            data[name] *= factor

    return fault


def per_cent(data: Columns) -> None:
    most = max(np.nanmax(np.abs(data[name])) for name in N)
    for name in N:
        data[name] = 100.0 * data[name] / most


def pulses(data: Columns) -> None:
    most = max(np.nanmax(np.abs(data[name])) for name in N)
    for name in N:
        data[name] = 1500.0 + 400.0 * data[name] / most


def degrees_and_no_fix(data: Columns) -> None:
    data["gps_x_m"] = 63.44 + data["gps_x_m"] / 111_000.0
    data["gps_y_m"] = 10.4 + data["gps_y_m"] / 50_000.0
    data["gps_x_m"][15] = data["gps_y_m"][15] = 0.0


def stop_gyro(data: Columns) -> None:
    t = data["t_s"] - data["t_s"][0]
    rows = np.flatnonzero((t > 0.5 * t[-1]) & (t < 0.8 * t[-1]))
    data["gyro_radps"][rows] = data["gyro_radps"][rows[0] - 1]


BLUEBOAT, OTTER, ESSO, KVLCC2 = (
    "blueboat_trondheim",
    "otter_oslofjord",
    "esso_osaka_frt",
    "kvlcc2_simman2008",
)

FAULTS: dict[str, tuple[Fault, set[str], dict[str, int]]] = {
    "north and east swapped": (
        swap_fixes,
        {"track-mirrored", "compass-offset"},
        {BLUEBOAT: 12, OTTER: 6, ESSO: 24, KVLCC2: 9},
    ),
    "compass 45 degrees off": (
        turn_compass(45.0),
        {"compass-offset"},
        {BLUEBOAT: 12, OTTER: 6, ESSO: 23, KVLCC2: 8},
    ),
    "compass back to front": (
        turn_compass(180.0),
        {"compass-reversed"},
        {BLUEBOAT: 8, OTTER: 6, ESSO: 24, KVLCC2: 9},
    ),
    "compass with the wrong sign": (
        change(-1.0, "compass_rad"),
        {"track-mirrored", "compass-sign"},
        {BLUEBOAT: 12, OTTER: 6, ESSO: 23, KVLCC2: 9},
    ),
    "gyro with the wrong sign": (
        change(-1.0, "gyro_radps"),
        {"gyro-sign"},
        {BLUEBOAT: 11, OTTER: 6, ESSO: 20, KVLCC2: 9},
    ),
    "gyro 1.3 times": (
        change(1.3, "gyro_radps"),
        {"gyro-scale"},
        {BLUEBOAT: 8, OTTER: 6, ESSO: 19, KVLCC2: 6},
    ),
    "gyro stands still": (
        stop_gyro,
        {"gyro-frozen"},
        {BLUEBOAT: 12, OTTER: 6, ESSO: 20, KVLCC2: 9},
    ),
    "left thruster with the wrong sign": (
        change(-1.0, N[0]),
        {"left-sign"},
        {BLUEBOAT: 8, OTTER: 3},
    ),
    "right thruster with the wrong sign": (
        change(-1.0, N[1]),
        {"right-sign"},
        {BLUEBOAT: 9, OTTER: 3},
    ),
    "both thrusters with the wrong sign": (
        change(-1.0, *N),
        {"thrust-sign"},
        {BLUEBOAT: 9, OTTER: 6, ESSO: 23, KVLCC2: 9},
    ),
    "rpm": (change(60.0, *N), {"shaft-unit"}, {BLUEBOAT: 12, OTTER: 6, ESSO: 24, KVLCC2: 9}),
    "per cent": (per_cent, {"shaft-unit"}, {BLUEBOAT: 12, OTTER: 6, ESSO: 24, KVLCC2: 9}),
    "pulse widths": (
        pulses,
        {"shaft-unit", "shaft-pwm"},
        {BLUEBOAT: 12, OTTER: 6, ESSO: 24, KVLCC2: 9},
    ),
    "degrees, and one fix at zero": (
        degrees_and_no_fix,
        {"position-degrees"},
        {BLUEBOAT: 12, OTTER: 6, ESSO: 24, KVLCC2: 9},
    ),
    "milliseconds": (
        change(1000.0, "t_s"),
        {"time-unit"},
        {BLUEBOAT: 12, OTTER: 6, ESSO: 24, KVLCC2: 9},
    ),
}


@pytest.mark.parametrize(
    ("name", "folder"), [(name, folder) for name in FAULTS for folder in FAULTS[name][2]]
)
def test_faults_of_recorded_runs_are_named(name: str, folder: str) -> None:
    fault, codes, least = FAULTS[name]
    seen, several = [], []
    for run in SOUND[folder]:
        if name.startswith("gyro") and "gyro_radps" not in recorded(folder, run)[0]:
            continue
        sound = {finding.code for finding in found_in(folder, run)}
        new = {f.code for f in found_in(folder, run, fault) if f.severity != NOTE} - sound
        noted = {f.code for f in found_in(folder, run, fault)} - sound
        if codes & noted:
            seen.append(run)
            if len(new & COMMANDS) > 1:
                several.append(run)
    assert len(seen) >= least[folder], sorted(set(SOUND[folder]) - set(seen))
    assert not several


COMMANDS = {
    "thrust-sign",
    "compass-reversed",
    "left-sign",
    "right-sign",
    "sides-swapped",
    "steering-sign",
    "gyro-sign",
    "compass-sign",
}
"""One fault is one of these."""
