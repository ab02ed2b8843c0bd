"""What is in a log, and what is wrong with it, before anything is run."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from twin.logs.diagnosis.diagnose import Diagnosis, Measured, diagnose
from twin.logs.diagnosis.findings import ERROR, NOTE, SEVERITIES, WARNING, Finding, Recording
from twin.logs.diagnosis.instruments import particulars_text
from twin.logs.errors import LogError
from twin.logs.log import Log, assemble, read_table
from twin.particulars import Particulars

__all__ = [
    "ERROR",
    "NOTE",
    "SEVERITIES",
    "WARNING",
    "Finding",
    "LogCheck",
    "SensorFigures",
    "check_log",
]

_NOISE = {
    "fix": ("gps_m", "m", 1.0),
    "velocity": ("velocity_mps", "m/s", 1.0),
    "compass": ("compass_rad", "deg", 180.0 / math.pi),
    "gyro": ("gyro_radps", "deg/s", 180.0 / math.pi),
    "accelerometers": ("accel_mps2", "m/s2", 1.0),
    "roll and pitch gyros": ("tilt_radps", "deg/s", 180.0 / math.pi),
    "vertical accelerometer": ("lift_mps2", "m/s2", 1.0),
    "AHRS": ("ahrs_rad", "deg", 180.0 / math.pi),
    "height": ("height_m", "m", 1.0),
    "vertical speed": ("climb_mps", "m/s", 1.0),
}
"""Key of each sensor's noise, the unit in which it is shown, and the factor to that."""


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


@dataclass(frozen=True, eq=False)
class LogCheck:
    """What :func:`check_log` returns.

    Parameters
    ----------
    findings : tuple of Finding
        Errors first, then warnings and notes.
    sensors : tuple of SensorFigures
        Rates and noise.
    agreement : tuple of str
        How sensors and commands agree with each other, a line each.
    notes : tuple of str
        What reading the file changed or left out.
    log : Log or None
        The log; None where it cannot be used.
    diagnosis : Diagnosis
        Recording, and all that was measured.
    """

    findings: tuple[Finding, ...]
    sensors: tuple[SensorFigures, ...]
    agreement: tuple[str, ...]
    notes: tuple[str, ...]
    log: Log | None
    diagnosis: Diagnosis

    @property
    def recording(self) -> Recording:
        """Columns of the log before any repair, without fixes that no boat can reach."""
        return self.diagnosis.recording

    def count(self, severity: str) -> int:
        """Return how many findings are of a severity."""
        return sum(finding.severity == severity for finding in self.findings)

    def particulars_text(self, particulars: Particulars | None = None) -> str:
        """Return a particulars file with the instruments as the log shows them.

        Parameters
        ----------
        particulars : Particulars, optional
            Of the boat; without them length, beam, draft and mass are left to fill in.
        """
        return particulars_text(self.diagnosis, particulars)

    def to_json(self) -> dict[str, Any]:
        """Return everything as plain numbers and texts; NaN becomes None."""
        measured = self.diagnosis.to_json()
        more = self.findings[: len(self.findings) - len(self.diagnosis.findings)]
        measured["findings"] = [dataclasses.asdict(f) for f in more] + measured["findings"]
        return measured


def check_log(
    path: str | Path,
    mapping: str | Path | None = None,
    particulars: Particulars | None = None,
) -> LogCheck:
    """Read a log, and tell what is wrong with it.

    Parameters
    ----------
    path, mapping : str or Path
        Log, and the file that says which of its columns is which, as of :meth:`Log.read`.
    particulars : Particulars, optional
        Of the boat; they tell units of commands.

    Raises
    ------
    LogError
        Where the file cannot be read at all.
    """
    table = read_table(path, mapping)
    notes = tuple(table.notes)
    recording = Recording.of(table.data, table.given, table.name, table.plane)
    diagnosis = diagnose(recording, particulars)
    log, extra = None, []
    if table.lacking:
        what = table.lacking.removeprefix(f"{table.source}: ")
        extra.append(Finding(ERROR, "columns-missing", what, ""))
    else:
        try:
            log = assemble(dataclasses.replace(table, notes=list(notes)))
        except LogError as error:
            if not diagnosis.of(ERROR):  # else a finding names the cause
                extra.append(Finding(ERROR, "refused", str(error), ""))
    return LogCheck(
        findings=(*extra, *diagnosis.findings),
        sensors=_sensors(diagnosis.measured),
        agreement=_agreement(diagnosis.measured) if len(recording.t) > 1 else (),
        notes=notes,
        log=log,
        diagnosis=diagnosis,
    )


def _sensors(measured: Measured) -> tuple[SensorFigures, ...]:
    """Return rate and noise of each sensor."""
    figures = []
    for name, rate in measured.rates.items():
        key, unit, scale = _NOISE.get(name, ("", "", 1.0))
        noise = measured.noise.get(key, math.nan) * scale
        figures.append(SensorFigures(name, rate, noise, unit if rate else ""))
    return tuple(figures)


def _agreement(measured: Measured) -> tuple[str, ...]:
    """Return lines on how sensors and commands agree with each other."""
    lines = []
    gyro, headed = measured.gyro, measured.rates["compass"] > 0.0
    if gyro is not None and abs(gyro.correlation) > 0.8:
        late = f", {gyro.lag:+.2f} s late" if gyro.lag else ""
        lines.append(
            f"gyro against compass: scale {gyro.scale:.3f}, bias {gyro.bias:+.4f} rad/s{late}"
        )
    elif measured.rates["gyro"] and headed:
        lines.append("gyro against compass: cannot tell, the boat turns too little")
    track = measured.track
    if track is not None and track.is_known:
        off, sd = math.degrees(track.legs), math.degrees(track.legs_sd)
        lines.append(f"track against compass: {off:+.1f} degrees (standard deviation {sd:.1f})")
    elif headed:
        lines.append(
            "track against compass: cannot tell; sail legs in opposite directions, or circles to "
            "both sides"
        )
    velocity = measured.velocity
    if velocity is not None:
        late = f", {velocity.lag:+.2f} s late" if velocity.lag else ""
        lines.append(f"fixes against speed over ground: ratio {velocity.ratio:.3f}{late}")
    imu = measured.imu
    if imu is not None and imu.correlation > 0.7 and imu.latency_sd < 0.2:
        lines.append(
            f"GPS latency: {imu.latency:.2f} s behind the accelerometers (standard deviation "
            f"{imu.latency_sd:.2f} s)"
        )
    else:
        lines.append("GPS latency: cannot tell without accelerometers that see the boat accelerate")
    for name, called in (("difference", "unequal thrust"), ("steering", "steering angle")):
        effect = measured.effects.get(name)
        if effect is not None and effect.clear:
            side = "starboard" if effect.gain > 0.0 else "port"
            lines.append(
                f"{called} above 0 turns to {side}, and explains {effect.share:.0%} of the turning"
            )
        elif effect is not None:
            lines.append(f"{called}: cannot tell its sign")
    if measured.unchecked:
        lines.append(f"axes of the IMU: cannot tell those of {', '.join(measured.unchecked)}")
    elif measured.unchecked is not None:
        lines.append("axes of the IMU: each moves enough to be checked")
    return tuple(lines)
