"""Names, memory and settings of the checks of sensors and commands."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from twin.filters.navigation_state import sample_limits
from twin.integrity.bank import ACCELERATION_FIRST, BANK, BANK_SETTINGS, LEVEL_MAX, bank_settings
from twin.integrity.commands import DRIVES, DRIVES_SETTINGS, drives_settings, initial_drives
from twin.integrity.decision import DECISION
from twin.particulars import Particulars

__all__ = [
    "INTEGRITY",
    "INTEGRITY_SETTINGS",
    "REASONS",
    "SENSORS",
    "STATUSES",
    "initial_integrity",
    "integrity_settings",
]

Array = NDArray[np.float64]

SENSORS = ("gps", "compass", "gyro", "accelerometers", "commands")
"""What is checked."""

GPS, COMPASS, GYRO, ACCELEROMETERS, COMMANDS = range(len(SENSORS))

STATUSES = ("absent", "ok", "doubtful", "excluded")
"""Status of a sensor: no samples; used; used, but inconsistent with others; not used."""

ABSENT, OK, DOUBTFUL, EXCLUDED = range(len(STATUSES))

REASONS = (
    "",
    "gave numbers that no boat gives",
    "repeats itself while the boat moves",
    "contradicts the other sensors",
    "gives a velocity that contradicts the other sensors, and which is not used",
    "has gone silent",
    "hands out old samples, as after a stall",
    "have the wrong sign",
    "have the wrong sign in steering",
    "have the wrong sign in thrust",
    "have swapped sides",
    "do not reach the left thruster",
    "do not reach the right thruster",
    "do not explain how the boat moves",
)
"""Reasons of a status, in words that follow the sensor's name."""

NO_REASON, IMPOSSIBLE, FROZEN, CONTRADICTS, VELOCITY_OUT, SILENT, OLD, HYPOTHESIS_REASON = range(8)
"""Places of reasons; from the last on, those of the hypotheses of commands but the first."""

STATUS = np.dtype(
    [
        ("status", "f8"),  # one of STATUSES
        ("reason", "f8"),  # one of REASONS
        ("since", "f8"),  # clock at which it became so, s
        ("silent", "f8"),  # time since the last sample, s
    ]
)

WIND_CHECK = np.dtype(
    [
        ("status", "f8"),  # one of STATUSES
        ("reason", "f8"),  # one of REASONS
        ("since", "f8"),  # clock at which it became so, s
        ("silent", "f8"),  # time since the last sample, s
        ("age", "f8"),  # time since the last sample that was used, s
        ("last", "f8", 2),  # last apparent wind, m/s and rad
        ("repeated", "f8", 2),  # how long speed and direction have been the same, s
        ("changing", "f8"),  # how long they have changed while excluded, s
        ("known", "f8"),  # time that the mean wind is the mean of, s; 0: nothing is known
        ("velocity", "f8", 2),  # true wind, smoothed: velocity of the air north and east, m/s
        ("mean", "f8", 2),  # its mean, m/s
    ]
)
"""What is remembered of an anemometer, and of the wind."""

PARTS = 5
"""Fix, velocity, compass, gyro and accelerometers."""

INTEGRITY = np.dtype(
    [
        ("clock", "f8"),  # time since the start, s
        ("statuses", "f8"),  # all statuses in one number: it differs where one of them does
        ("sensors", STATUS, len(SENSORS)),
        ("commands_doubted", "f8"),  # 1 while the commands do not explain the motion
        ("motion_doubted", "f8"),  # 1 while GPS or compass are left out, or sensors at odds
        ("bank", BANK),
        ("decision", DECISION),
        ("drives", DRIVES),
        ("last", "f8", 8),  # last new sample of each channel; NaN before the first
        ("step", "f8", PARTS),  # smallest change of a part, in its unit; 0 before the first
        ("unchanged", "f8", PARTS),  # time since a part gave something new, s
        ("unused", "f8", PARTS),  # time since a sample of it was used, s
        ("renewal", "f8", PARTS),  # typical time between new samples, s
        ("frozen", "f8", PARTS),  # 1 where it repeats itself while the boat moves
        ("masked", "f8", PARTS),  # time for which it is left out after impossible numbers, s
        ("contradicted", "f8"),  # 1 while GPS or compass contradict the filter in force
        ("backlog", "f8"),  # time for which samples may be old, as all had been missing, s
        ("old", "f8"),  # 1 where they are
        ("heard", "f8"),  # how long there have been samples again, s
        ("garbage", "f8"),  # 1 in a row with impossible numbers of two sensors
        ("turned", "f8"),  # what the heading changed since the compass gave something new, rad
        ("switched", "f8"),  # 1 in a row after which another filter is in force, 2: it had GPS
        ("wind", WIND_CHECK),
        ("z", "f8", 8),  # scratch: samples of the row that may be used
    ]
)
"""What the checks remember of a boat."""

INTEGRITY_SETTINGS = np.dtype(
    [
        ("bank", BANK_SETTINGS),
        ("drives", DRIVES_SETTINGS),
        ("limits", "f8", 8),  # sizes that no sample reaches
        ("wind_gain", "f8"),  # wind 10 m above the sea over that at the anemometer
    ]
)
"""What the checks are given of a boat and its instruments."""

NEVER_S = 1e9
"""Age of a sample that has never come."""

REFERENCE_HEIGHT_M = 10.0
PROFILE = 0.11
"""The wind of the model is that of this height; exponent of the wind's profile over open sea.

Source: Hsu, Meindl and Gilhousen 1994."""


def integrity_settings(particulars: Particulars) -> Array:
    """Return the settings of the checks, in the order of :data:`INTEGRITY_SETTINGS`."""
    height = particulars.instruments.wind_height
    return np.array(
        [
            *bank_settings(particulars),
            *drives_settings(particulars),
            *sample_limits(particulars)[:8],
            (REFERENCE_HEIGHT_M / height) ** PROFILE,
        ]
    )


def initial_integrity(particulars: Particulars) -> Array:
    """Return the memory of checks that have seen nothing, in the layout of :data:`INTEGRITY`."""
    memory = np.zeros(INTEGRITY.itemsize // 8)
    record = memory.view(INTEGRITY)[0]
    bank = record["bank"]
    for name in ("last", "rate", "epoch_rate", "epoch_force", "velocity_age"):
        bank[name] = math.nan
    bank["level"], bank["acceleration"] = LEVEL_MAX, ACCELERATION_FIRST**2
    bank["imu_age"] = record["sensors"]["silent"] = NEVER_S
    record["last"] = math.nan
    record["decision"]["failing_since"] = -1.0
    record["drives"] = initial_drives(particulars).view(DRIVES)[0]
    return memory
