"""Instruments of a boat as its log shows them, and a particulars file with them."""

from __future__ import annotations

import dataclasses
import json
import math
from typing import Any

import numpy as np

from twin.logs.diagnosis.diagnose import Diagnosis
from twin.logs.diagnosis.signs import speed_of
from twin.particulars import LATENCY_MAX, Instruments, Particulars

__all__ = [
    "estimate_instruments",
    "particulars_text",
]

_LEAST = {"gps_sd": 0.005, "doppler_sd": 0.02, "compass_sd": 0.002, "gyro_sd": 5e-4}
"""No standard deviation is set lower: filtered columns are smoother than the sensor is true."""

_UPRIGHT = 0.07
"""Margin for what the white noise of an accelerometer leaves out, m/s2."""


def estimate_instruments(
    diagnosis: Diagnosis, base: Instruments | None = None
) -> tuple[Instruments, dict[str, str]]:
    """Return instruments as a log shows them.

    Parameters
    ----------
    diagnosis : Diagnosis
        Of the log.
    base : Instruments, optional
        For what a log cannot show: slow errors of position and heading, places of the sensors.

    Returns
    -------
    Instruments, dict of str to str
        And for each key that the log shows, how.
    """
    measured, noise = diagnosis.measured, diagnosis.measured.noise
    found: dict[str, tuple[float, str]] = {}

    def set_noise(key: str, value: float, why: str) -> None:
        if math.isfinite(value):
            least = _LEAST.get(key, 0.0)
            found[key] = (max(value, least), why if value > least else f"{why}, least value")

    stamps = measured.stamps
    if stamps is not None and stamps.along > noise["gps_m"]:
        set_noise("gps_sd", stamps.along, "scatter of the fixes along the track")
    else:
        set_noise("gps_sd", noise["gps_m"], "scatter from fix to fix")
    set_noise("doppler_sd", noise["velocity_mps"], "scatter from sample to sample")
    set_noise("compass_sd", noise["compass_rad"], "scatter from sample to sample")
    set_noise("gyro_sd", noise["gyro_radps"], "scatter from sample to sample")
    if math.isfinite(noise["accel_mps2"]):
        scatter = math.hypot(noise["accel_mps2"], _UPRIGHT)
        found["accel_sd"] = scatter, f"scatter from sample to sample, and {_UPRIGHT} for tilt"
    for finding in diagnosis.findings:
        apart = finding.evidence.get("disagree", 0.0) if finding.code == "gyro-compass" else 0.0
        if apart > found.get("gyro_sd", (0.0, ""))[0]:
            set_noise("gyro_sd", apart, "difference from the compass over half a second")
    gyro = measured.gyro
    if gyro is not None and abs(gyro.correlation) > 0.8:
        found["gyro_bias_sd"] = max(abs(gyro.bias), 5e-4), "mean difference from the compass"
    imu = measured.imu
    if imu is not None and imu.correlation > 0.7 and 0.05 > imu.latency_sd < imu.latency:
        found["gps_latency"] = (
            min(imu.latency, LATENCY_MAX),
            "best correlation with the accelerometers",
        )
    values: dict[str, Any] = {key: float(f"{pair[0]:.3g}") for key, pair in found.items()}
    reasons = {key: pair[1] for key, pair in found.items()}
    return dataclasses.replace(base or Instruments(), **values), reasons


def particulars_text(diagnosis: Diagnosis, particulars: Particulars | None = None) -> str:
    """Return the text of a particulars file, with instruments estimated from a log.

    Parameters
    ----------
    diagnosis : Diagnosis
        Of the log.
    particulars : Particulars, optional
        Of the boat. Without them the keys that no log shows stand as comments to fill in, and
        the file is refused until that is done.
    """
    base = None if particulars is None else particulars.instruments
    instruments, reasons = estimate_instruments(diagnosis, base)
    if particulars is not None:
        text = dataclasses.replace(particulars, instruments=instruments).to_toml()
    else:
        text = _template(diagnosis, instruments)
    lines = []
    for line in text.splitlines():
        key = line.partition(" = ")[0]
        lines.append(f"{line}  # {reasons[key]}" if key in reasons else line)
    head = f"# Instruments estimated from {diagnosis.recording.name} by usv-twin check;"
    return "\n".join([head, "# those without a comment are not.", *lines]) + "\n"


def _template(diagnosis: Diagnosis, instruments: Instruments) -> str:
    """Return the text for a boat of which only its log is known."""
    recording = diagnosis.recording
    speed = shaft = math.nan
    motion = speed_of(recording)
    if motion is not None:
        all_speeds = np.hypot(*motion[1].T)
        speed = float(np.nanquantile(all_speeds, 0.75))
        near = motion[0][np.abs(all_speeds - speed) < 0.2 * speed]
        n = np.nan_to_num(np.abs(recording.cmd[:, :2])).mean(axis=1)
        shaft = float(np.median(np.interp(near, recording.t, n))) if len(near) else math.nan
    fixed = not np.nan_to_num(recording.cmd[:, 2:]).any()
    lines = [
        "[particulars]",
        f"name = {json.dumps(recording.name, ensure_ascii=False)}",
        "# length = ?    # fill in: m, on the waterline",
        "# beam = ?      # fill in: m",
        "# draft = ?     # fill in: m",
        "# mass = ?      # fill in: kg",
        f"speed = {speed:.3g}  # upper quartile of the log" if speed == speed else "# speed = ?",
        f"shaft_speed = {shaft:.3g}  # at that speed" if shaft == shaft else "# shaft_speed = ?",
        f'steering = "{"differential" if fixed else "drives"}"  # '
        + ("no angle changes in the log" if fixed else "the log has angles"),
        "",
        "[instruments]",
    ]
    for item in dataclasses.fields(instruments):
        value = getattr(instruments, item.name)
        lines.append(f"{item.name} = {list(value) if isinstance(value, tuple) else value!r}")
    return "\n".join(lines)
