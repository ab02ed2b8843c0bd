"""Instruments of a boat as its log shows them, and a particulars file with them."""

from __future__ import annotations

import dataclasses
import math
import re
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from twin.channels import MEASUREMENTS, MOTION_AT
from twin.integrity.rows import FIX, SENSORS, SIZE_MAX, STAMP_JITTER_S, fix_scatter, speed_of
from twin.integrity.transforms import Trial
from twin.logs.jumps import TYPICAL
from twin.logs.recording import Recording
from twin.logs.signals import ENOUGH, white_noise
from twin.particulars import LATENCY_MAX_S, Instruments, Particulars

__all__ = [
    "SensorFigures",
    "estimate_instruments",
    "particulars_text",
    "pooled",
    "renewed",
    "sensor_figures",
    "typical_boat",
]

Array = npt.NDArray[np.float64]

SD_SHARE_MIN = 0.25
FIX_SD_MIN_M = 0.005
"""Least estimate of a standard deviation, as a share of the usual one, and of that of fixes, m:
filtered columns are smoother than their sensor is accurate."""

UPRIGHT_MPS2 = 0.07
"""Margin for what the white noise of an accelerometer leaves out: the tilt of the boat."""

NOISY = {"doppler_sd": "velocity", "compass_sd": "compass", "gyro_sd": "gyro"}
"""Sensors whose noise from sample to sample an instrument of the particulars is."""

HEAD, MARK = "# By usv-twin check from", " # log: "
"""The first line of a particulars file that was written from a log, and what marks estimates."""

UNITS = {
    "m": ("m", 1.0),
    "mps": ("m/s", 1.0),
    "mps2": ("m/s2", 1.0),
    "rad": ("deg", math.degrees(1.0)),
    "radps": ("deg/s", math.degrees(1.0)),
}
"""Unit in which the noise of columns is shown, and the factor to it."""


@dataclass(frozen=True)
class SensorFigures:
    """What a sensor of a log is like.

    Parameters
    ----------
    name : str
        Of the sensor.
    rate_hz : float
        New samples a second; 0 for none.
    noise : float
        White noise from sample to sample, in ``unit``; NaN where the log does not tell.
    unit : str
        Of the noise, for a table.
    """

    name: str
    rate_hz: float
    noise: float
    unit: str


def sensor_figures(recording: Recording) -> tuple[SensorFigures, ...]:
    """Return rate and noise of each sensor; those of roll, pitch and heave only if there."""
    figures = []
    for name, columns in SENSORS.items():
        t, values = recording.samples(*columns)
        rate = 1.0 / float(np.median(np.diff(t))) if len(t) > 1 else 0.0
        if rate == 0.0 and MEASUREMENTS.index(columns[0]) >= MOTION_AT:
            continue
        if name == "compass":
            values = np.unwrap(values, axis=0)
        unit, scale = UNITS[columns[0].rpartition("_")[2]]
        noise = math.nan
        if len(t) >= ENOUGH and name != "wind":
            parts = [max(white_noise(t, each), _rounding_sd(each)) for each in values.T]
            noise = math.sqrt(sum(min(each, SIZE_MAX) ** 2 for each in parts) / len(parts))
            if name == "velocity":  # speed and course may be coarse, of which its parts are made
                speed, course = np.hypot(*values.T), np.arctan2(*values.T[::-1])
                along, across = _rounding_sd(speed), np.median(speed) * _rounding_sd(course)
                noise = max(noise, min(math.hypot(along, across) / math.sqrt(2.0), SIZE_MAX))
            noise *= scale
        figures.append(SensorFigures(name, rate, noise, unit if rate else ""))
    return tuple(figures)


def _rounding_sd(values: Array) -> float:
    """Return the standard deviation of a rounding error: 1/sqrt(12) of the least step of values.

    Its square counts by the share of values that come again.
    """
    distinct = np.unique(values.round(6))
    again = 1.0 - len(distinct) / len(values)
    least = float(np.diff(distinct).min()) if len(distinct) > 1 else 0.0
    return least * math.sqrt(again / 12.0)


def estimate_instruments(
    recording: Recording,
    figures: tuple[SensorFigures, ...],
    measured: dict[str, Trial | None],
    particulars: Particulars | None = None,
) -> tuple[Instruments, dict[str, str]]:
    """Return instruments as a log shows them, and for each key that it shows, how.

    Parameters
    ----------
    recording : Recording
        The log.
    figures : tuple of SensorFigures
        Of its sensors.
    measured : dict of str to Trial or None
        Latency of the GPS and bias of the gyro, as far as the log shows them.
    particulars : Particulars, optional
        For what a log cannot show: slow errors of position and heading, places of the sensors.
    """
    noise = {
        each.name: each.noise / UNITS[SENSORS[each.name][0].rpartition("_")[2]][1]
        for each in figures
    }
    usual, scatter = Instruments(), "scatter from sample to sample"
    along = fix_scatter(*recording.samples(*FIX))[0]
    found = {
        "gps_sd": (max(noise["fix"], FIX_SD_MIN_M), "scatter from fix to fix"),
        "accel_sd": (
            math.hypot(noise["accelerometers"], UPRIGHT_MPS2),
            f"{scatter}, and {UPRIGHT_MPS2} for tilt",
        ),
    }
    if along > found["gps_sd"][0]:
        found["gps_sd"] = along, "scatter of the fixes along the track"
    for key, sensor in NOISY.items():
        value, least = noise[sensor], SD_SHARE_MIN * getattr(usual, key)
        found[key] = max(value, least), scatter if value > least else f"{scatter}, least value"
    bias, late = measured.get("gyro_bias_sd"), measured.get("gps_latency")
    if bias is not None:
        least = SD_SHARE_MIN * usual.gyro_bias_sd
        found["gyro_bias_sd"] = max(abs(bias.size), least), "mean difference from the compass"
    if late is not None and late.sd < STAMP_JITTER_S < late.size + STAMP_JITTER_S:
        found["gps_latency"] = min(late.size, LATENCY_MAX_S), "best agreement with accelerometers"
    found = {key: pair for key, pair in found.items() if 0.0 <= pair[0] < SIZE_MAX}
    base = Instruments() if particulars is None else particulars.instruments
    values: dict[str, Any] = {key: float(f"{pair[0]:.3g}") for key, pair in found.items()}
    return dataclasses.replace(base, **values), {key: pair[1] for key, pair in found.items()}


def pooled(
    shown: Sequence[tuple[Instruments, dict[str, str]]],
) -> tuple[Instruments, dict[str, str]]:
    """Return what logs of one boat show, each of :func:`estimate_instruments`: the medians.

    What no log shows is as usual.
    """
    values, reasons = dict[str, Any](), dict[str, str]()
    for key in dict.fromkeys(key for _, why in shown for key in why):
        found = [(getattr(one, key), why[key]) for one, why in shown if key in why]
        values[key] = float(f"{np.median([value for value, _ in found]):.3g}")
        several = f", median of {len(found)} logs" if len(found) > 1 else ""
        reasons[key] = f"{found[0][1]}{several}"
    return Instruments(**values), reasons


def typical_boat(recording: Recording, instruments: Instruments) -> Particulars:
    """Return particulars where those of the boat are unknown: its speeds are those of the log."""
    n = np.nan_to_num(np.abs(recording.cmd[:, :2])).mean(axis=1)
    motion, speed, shaft = speed_of(recording), 1.0, 0.0
    if motion is not None:
        speeds = np.hypot(*motion[1].T)
        typical = float(np.quantile(speeds, TYPICAL))
        speed = min(max(typical, 0.5), 20.0)
        shaft = float(np.median(np.interp(motion[0][speeds >= typical], recording.t, n)))
    fixed = not np.nan_to_num(recording.cmd[:, 2:]).any()
    return Particulars(
        name=recording.name, length=3.0, beam=1.2, draft=0.3, mass=300.0,
        speed=float(f"{speed:.3g}"), shaft_speed=float(f"{shaft:.3g}") or 20.0,
        instruments=instruments,
        steering="differential" if fixed else "drives",
    )  # fmt: skip


def particulars_text(
    recordings: Sequence[Recording],
    instruments: Instruments,
    reasons: dict[str, str],
) -> str:
    """Return the text of a particulars file, with what its logs show.

    The keys that no log shows stand as comments to fill in, and the file is refused until that is
    done; :func:`renewed` adds what is known of the boat.

    Parameters
    ----------
    recordings : sequence of Recording
        The logs.
    instruments, reasons
        Of :func:`pooled`.
    """
    boats = [typical_boat(each, instruments) for each in recordings]
    boat, names = max(boats, key=lambda one: one.speed), ", ".join(each.name for each in recordings)
    steering = "drives" if any(one.steering == "drives" for one in boats) else boat.steering
    seen = {
        "speed": f"upper quartile of {boat.name}",
        "shaft_speed": f"at {boat.speed:g} m/s and above",
    }
    reasons = reasons | seen | {"steering": "by the angles in the log"}
    boat = dataclasses.replace(boat, name=boats[0].name, steering=steering)
    lines = []
    for line in boat.to_toml().splitlines():
        key = line.partition(" = ")[0]
        if key in ("length", "beam", "draft", "mass"):
            lines.append(f"# {key} = ?  # fill in")
        else:
            lines.append(f"{line} {MARK}{reasons[key]}" if key in reasons else line)
    head = f"{HEAD} {names}. Lines with{MARK}are written anew by --write, others stay."
    return "\n".join([head, *lines]) + "\n"


def renewed(text: str, old: str) -> tuple[str, list[str]]:
    """Return a particulars file with what a user wrote by hand in the file of the boat.

    That is each line of the old file without :data:`MARK`, and each line that is a comment.
    Instruments that the log shows are kept only where they were changed in a file of ``usv-twin
    check``.

    Parameters
    ----------
    text, old : str
        The new file, of :func:`particulars_text`, and the old one.

    Returns
    -------
    str, list of str
        The file, and the names of the keys that were kept.
    """
    tables, kept = _lines_by_key(text), list[str]()
    given, usual = tomllib.loads(old).get("instruments", {}), Instruments()
    for table, lines in _lines_by_key(old).items():
        parent, _, name = table.rpartition(".")
        tables.get(parent, {}).pop(name, None)  # a prior is a table, or the name of a file
        for key, line in lines.items():
            tables.pop(f"{table}.{key}", None)
            new = tables.setdefault(table, {}).get(key, "")
            same = line.partition("#")[0].strip() == new.partition("#")[0].strip()
            by_hand = HEAD in old and given.get(key) != getattr(usual, key, None)
            of_log = table == "instruments" and MARK in new and not by_hand
            if not (of_log or MARK in line or line.startswith("#")):
                tables[table][key] = line
                kept += [] if same else [table.partition(".")[2] or key]
    parts = ["\n".join([f"[{table}]", *lines.values()]) for table, lines in tables.items()]
    new = text[: text.index("\n[") + 1] + "\n\n".join(parts)
    return _with_comments(new, old, text), [*dict.fromkeys(kept)]


def _with_comments(text: str, old: str, written: str) -> str:
    """Return a TOML file with the comments of an old one before the same tables and keys.

    Those that stand in ``written`` are the program's, as is its head.
    """
    known, waiting, before = written.splitlines(), list[str](), dict[str, list[str]]()
    for line, begun in _begun(old):
        if begun:
            before.setdefault(begun, []).extend(waiting)
            waiting = []
        elif line.startswith("#") and line not in known and not line.startswith(HEAD):
            waiting.append(line)
    lines = [each for line, begun in _begun(text) for each in (*before.pop(begun, ()), line)]
    return "\n".join([*lines, *(line for left in before.values() for line in left), *waiting, ""])


def _begun(text: str) -> Iterator[tuple[str, str]]:
    """Yield the lines of a TOML file with the table or key that each begins, or ""."""
    table = ""
    for line in text.splitlines():
        if head := re.match(r"\s*\[([\w.]+)\]\s*(#.*)?$", line):
            table = head[1]
            yield line, table
        else:
            entry = re.match(r"\s*(?:# )?(\w+)\s*=", line)
            yield line, f"{table}.{entry[1]}" if entry else ""


def _lines_by_key(text: str) -> dict[str, dict[str, str]]:
    """Return the lines of a TOML file by table and key; those that begin no entry go with it."""
    tables: dict[str, dict[str, str]] = {}
    table, key = "", ""
    for line, begun in _begun(text):
        if begun:
            own, _, key = begun.rpartition(".")
            if line.lstrip().startswith("["):
                table, key = begun, ""
            else:
                tables.setdefault(own, {})[key] = line
        elif key and line.strip() and not line.startswith("#"):
            tables[table][key] += f"\n{line}"
    return tables
