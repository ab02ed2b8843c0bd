"""What is in a log, and what is wrong with it, before a twin runs over it.

First exact rules for rows and cells (:mod:`twin.integrity.rows`), then hypotheses of units, signs,
axes, sides and delays (:mod:`twin.integrity.transforms`). Then the checks that run on board go over
the rows, without the faults found before: what they leave out or doubt for a while is a finding.
"""

from __future__ import annotations

import dataclasses
import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from twin.channels import MEASUREMENTS
from twin.integrity.evidence import Evidence, Signals, log_likelihood, signals_of
from twin.integrity.findings import ERROR, NOTE, SEVERITIES, WARNING, Finding
from twin.integrity.instruments import (
    Measured,
    estimate_instruments,
    noise_of,
    particulars_text,
    typical_boat,
)
from twin.integrity.monitor import run_over
from twin.integrity.rows import SENSORS as SENSORS_OF
from twin.integrity.rows import (
    check_cells,
    check_commands,
    check_leaps,
    check_silence,
    check_time,
    sensor_rates,
    without_marks,
)
from twin.integrity.state import COMMANDS as OF_COMMANDS
from twin.integrity.state import DOUBTFUL, EXCLUDED, FROZEN, IMPOSSIBLE, REASONS, SENSORS
from twin.integrity.transforms import Undone, explain, gps_delay, gyro_bias, unseen_faults
from twin.logs.checks import in_degrees, is_gap
from twin.logs.errors import LogError
from twin.logs.jumps import find_jumps
from twin.logs.log import Log, assemble, read_table
from twin.logs.recording import Recording
from twin.logs.signals import ENOUGH, runs_of
from twin.particulars import Instruments, Particulars

__all__ = ["LogCheck", "SensorFigures", "check_log", "check_recording"]

Array = npt.NDArray[np.float64]

TIMES = "time-unit"

SHORT_S, DOUBT_S, DOUBT_SHARE = 1.0, 8.0, 0.1
"""A sensor that the checks leave out or doubt for less than the first is not worth a word; for
less than the second at once, and this share of the log in all, a note."""

DRIVES = "shafts", "steering"
"""Commands in another unit are not held against the motion."""

NOISE = {
    "fix": ("m", 1.0),
    "velocity": ("m/s", 1.0),
    "compass": ("deg", 180.0 / math.pi),
    "gyro": ("deg/s", 180.0 / math.pi),
    "accelerometers": ("m/s2", 1.0),
    "roll and pitch gyros": ("deg/s", 180.0 / math.pi),
    "vertical accelerometer": ("m/s2", 1.0),
    "AHRS": ("deg", 180.0 / math.pi),
    "height": ("m", 1.0),
    "vertical speed": ("m/s", 1.0),
}
"""Unit in which noise is shown, and the factor to it."""


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
    agreed : dict of str to float
        Share of the squares of two signals that agrees, of each comparison, without the faults
        found: 1 for equal signals, 0 for strangers.
    instruments : Instruments
        As the log shows them.
    reasons : dict of str to str
        How, for each of their keys that it shows.
    recording : Recording
        Columns of the log before any repair, without fixes that no boat can reach.
    notes : tuple of str
        What reading the file changed or left out.
    log : Log or None
        The log; None where it cannot be used.
    """

    findings: tuple[Finding, ...]
    sensors: tuple[SensorFigures, ...]
    agreed: dict[str, float]
    instruments: Instruments
    reasons: dict[str, str]
    recording: Recording
    notes: tuple[str, ...] = ()
    log: Log | None = None

    @property
    def agreement(self) -> tuple[str, ...]:
        """How sensors and commands agree with each other, a line each."""
        return tuple(
            f"{name}: agree by {share:.1%}" if share > 0.3 else f"{name}: cannot tell"
            for name, share in self.agreed.items()
        )

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
        return particulars_text(self.recording, self.instruments, self.reasons, particulars)

    def to_json(self) -> dict[str, Any]:
        """Return everything as plain numbers and texts; NaN becomes None."""
        return {
            "name": self.recording.name,
            "rows": len(self.recording.stamps),
            "sensors": [_plain(dataclasses.asdict(each)) for each in self.sensors],
            "agreed": _plain(self.agreed),
            "instruments": {key: getattr(self.instruments, key) for key in self.reasons},
            "findings": [_plain(dataclasses.asdict(each)) for each in self.findings],
        }


def _plain(numbers: dict[str, Any]) -> dict[str, Any]:
    return {
        key: None if isinstance(value, float) and not math.isfinite(value) else value
        for key, value in numbers.items()
    }


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
        Of the boat; they tell units of commands, and what the sensors are like.

    Raises
    ------
    LogError
        Where the file cannot be read at all.
    """
    table = read_table(path, mapping)
    notes = tuple(table.notes)
    recording = Recording.of(table.data, table.given, table.name, table.plane)
    check = check_recording(recording, particulars)
    log, extra = None, []
    if table.lacking:
        what = table.lacking.removeprefix(f"{table.source}: ")
        extra.append(Finding(ERROR, "missing", what, "", "columns"))
    else:
        try:
            log = assemble(dataclasses.replace(table, notes=list(notes)))
        except LogError as error:
            if not check.count(ERROR):  # else a finding names the cause
                extra.append(Finding(ERROR, "missing", str(error), "", "log"))
    return dataclasses.replace(check, findings=(*extra, *check.findings), notes=notes, log=log)


def check_recording(recording: Recording, particulars: Particulars | None = None) -> LogCheck:
    """Tell what is wrong with the columns of a log.

    Parameters
    ----------
    recording : Recording
        Columns before any repair.
    particulars : Particulars, optional
        Of the boat.
    """
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of columns that are empty for a while
        return _check(recording, particulars)


def _check(recording: Recording, particulars: Particulars | None) -> LogCheck:
    recording, found = without_marks(recording)
    found += check_time(recording) + check_cells(recording)
    if len(recording.t) < 3 * ENOUGH:
        base = Instruments() if particulars is None else particulars.instruments
        noise = dict.fromkeys(NOISE, math.nan)
        return LogCheck(_sorted(found), _figures(recording, noise), {}, base, {}, recording)
    found += check_silence(recording) + check_leaps(recording)
    kept = _without_spans(_without_false_fixes(recording), found)
    noise = noise_of(kept)
    kept, more, signals, undone = _mended(kept, found, particulars)
    found += more
    measured: dict[str, Measured | None] = {}
    evidence: Evidence = {}
    if signals is not None:
        evidence = log_likelihood(signals)
        found += _unknown(signals, evidence, more)
        delay, taken = gps_delay(signals), sum(each.delay for each in undone)
        if delay is not None:
            measured["gps_latency"] = Measured(delay.value + taken, delay.sd)
        measured["gyro_bias_sd"] = gyro_bias(signals)
    instruments, reasons = estimate_instruments(kept, noise, measured, particulars)
    units = any(each.code == "unit" and each.sensor in DRIVES for each in more)
    found += _doubted(kept, undone, instruments, particulars, not units)
    agreed = {name: max(1.0 - one.rho, 0.0) for name, one in evidence.items() if one is not None}
    return LogCheck(_sorted(found), _figures(recording, noise), agreed, instruments, reasons, kept)


def _figures(recording: Recording, noise: dict[str, float]) -> tuple[SensorFigures, ...]:
    """Return rate and noise of each sensor."""
    figures = []
    for name, rate in sensor_rates(recording).items():
        unit, scale = NOISE.get(name, ("", 1.0))
        size = noise.get(name, math.nan) * scale
        figures.append(SensorFigures(name, rate, size, unit if rate else ""))
    return tuple(figures)


def _sorted(found: Sequence[Finding]) -> tuple[Finding, ...]:
    """Return findings, each once, errors first."""
    return tuple(sorted(dict.fromkeys(found), key=lambda each: SEVERITIES.index(each.severity)))


def _without_false_fixes(recording: Recording) -> Recording:
    """Return a recording without fixes at (0, 0) among others, or that no boat can reach."""
    z = recording.z.copy()
    fix = z[:, :2]
    nothing = (fix == 0.0).all(axis=1)
    if nothing.mean() < 0.5 and np.nanmedian(np.abs(fix)) > 1.0:
        z[nothing, :2] = np.nan
    jumps = find_jumps(recording.t, z[:, :2])
    if jumps is not None:
        z[jumps.lost, :2] = np.nan
    dead = [
        j
        for j, column in enumerate(z.T)
        for seen in [column[np.isfinite(column)]]
        if len(seen) >= ENOUGH and (seen == seen[0]).all()
    ]
    z[:, dead] = np.nan
    return dataclasses.replace(recording, z=z)


def _without_spans(recording: Recording, found: list[Finding]) -> Recording:
    """Return a recording without stretches in which a sensor stood still."""
    z = recording.z.copy()
    for finding in found:
        columns = SENSORS_OF.get(finding.sensor, (finding.sensor,))
        if finding.code == "frozen" and columns[0] in MEASUREMENTS:
            inside = (recording.t > finding.start) & (recording.t <= finding.end)
            for name in columns:
                z[inside, MEASUREMENTS.index(name)] = np.nan
    return dataclasses.replace(recording, z=z)


def _mended(
    recording: Recording, found: list[Finding], particulars: Particulars | None
) -> tuple[Recording, list[Finding], Signals | None, list[Undone]]:
    """Return a log without the faults that explain it best, these, and what is left of it."""
    more: list[Finding] = []
    fix = recording.z[np.isfinite(recording.z[:, :2]).all(axis=1), :2]
    if why := in_degrees(fix):
        remedy = "give latitude and longitude in [position] of a mapping file"
        more.append(Finding(ERROR, "unit", f"{recording.called('gps_x_m', 'gps_y_m')}: {why}",
                            remedy, "fixes"))  # fmt: skip
        z = recording.z.copy()
        z[:, :2] = np.nan
        recording = dataclasses.replace(recording, z=z)
    if any(finding.code == TIMES for finding in found):
        recording = dataclasses.replace(recording, t=1e-3 * recording.t)
    more += check_commands(recording, particulars)
    stated = None if particulars is None else particulars.instruments
    signals = signals_of(recording, stated)
    if signals is None:
        return recording, more, None, []
    by_transforms, signals, undone = explain(signals)
    return recording, more + by_transforms, signals, undone


def _unknown(signals: Signals, evidence: Evidence, found: list[Finding]) -> list[Finding]:
    """Return a note on faults that the log would not show."""
    said = []
    for sensor, faults in unseen_faults(signals, evidence).items():
        if any(finding.sensor == sensor for finding in found):
            continue
        what = f"{sensor}: this log does not tell whether {' or '.join(faults)}"
        remedy = "record turns to both sides, legs in several directions and changes of thrust"
        said.append(Finding(NOTE, "unchecked", what, remedy, sensor))
    return said


def _doubted(
    recording: Recording,
    undone: list[Undone],
    instruments: Instruments,
    particulars: Particulars | None,
    with_commands: bool,
) -> list[Finding]:
    """Return what the checks that run on board leave out or doubt, and when."""
    rows = _rows(recording, undone)
    boat = particulars or typical_boat(rows, instruments)
    t, found = rows.t, []
    # after a gap they begin anew
    begins = np.flatnonzero(is_gap(t) & (np.diff(t) > SHORT_S)) + 1
    parts = np.split(np.arange(len(t)), begins) if len(begins) < len(t) / ENOUGH else []
    ran = [run_over(boat, t[part], rows.z[part], rows.cmd[part]) for part in parts]
    if not ran:
        return []
    statuses, reasons = (np.concatenate(each) for each in zip(*ran, strict=True))
    for j, sensor in enumerate(SENSORS):
        if j == OF_COMMANDS and (particulars is None or not with_commands):
            continue
        out = (statuses[:, j] == EXCLUDED) | (statuses[:, j] == DOUBTFUL)
        runs = [(i, k - 1) for i, k in runs_of(out) if t[k - 1] - t[i] > SHORT_S]
        if not runs:
            continue
        i, k = max(runs, key=lambda run: t[run[1]] - t[run[0]])
        total = float(sum(t[b] - t[a] for a, b in runs))
        why = int(np.bincount(reasons[i : k + 1, j].astype(int)).argmax())
        what = f"{sensor} {REASONS[why]} from t = {t[i]:.1f} to {t[k]:.1f} s"
        if len(runs) > 1:
            what += f", {total:.0f} s in {len(runs)} stretches"
        code = "contradiction"
        if why in (IMPOSSIBLE, FROZEN):
            code = "mark" if why == IMPOSSIBLE else "frozen"
        brief = t[k] - t[i] < DOUBT_S and total < DOUBT_SHARE * (t[-1] - t[0])
        # of commands, the whole log tells more than a stretch
        severity = NOTE if brief or j == OF_COMMANDS else WARNING
        remedy = "the twin leaves it out there; mend it or empty these cells"
        span = {"start": float(t[i]), "end": float(t[k])}
        found.append(Finding(severity, code, what, remedy, sensor, total, **span))
    return found


def _rows(recording: Recording, undone: list[Undone]) -> Recording:
    """Return rows with new samples only, and without the faults that were found."""
    z = np.full_like(recording.z, np.nan)
    rows = np.arange(len(recording.t))
    for names in (MEASUREMENTS[:2], MEASUREMENTS[2:4], MEASUREMENTS[4:5], MEASUREMENTS[5:6],
                  MEASUREMENTS[6:8]):  # fmt: skip
        columns = [MEASUREMENTS.index(name) for name in names]
        at, values = recording.samples(*names)
        inside = rows[np.isin(recording.t, at)]
        for j, column in zip(columns, values.T, strict=True):
            z[inside, j] = column
    rest = slice(8, len(MEASUREMENTS))
    z[:, rest] = recording.z[:, rest]
    rows_of = dataclasses.replace(recording, z=z)
    for each in undone:
        rows_of = each.on_rows(rows_of)
    return _upright(rows_of)


def _upright(recording: Recording) -> Recording:
    """Return a recording with yaw rate and accelerations as on a boat that does not roll or pitch.

    By the angles of an AHRS; without them, or without three axes, nothing changes.
    """
    at = {name: j for j, name in enumerate(MEASUREMENTS)}
    z = recording.z
    needed = ("ahrs_roll_rad", "ahrs_pitch_rad", "gyro_y_radps", "accel_z_mps2")
    if not all(np.isfinite(z[:, at[name]]).sum() > 5 * ENOUGH for name in needed):
        return recording
    angles = []
    for name in needed[:2]:
        times, values = recording.samples(name)
        angles.append(np.interp(recording.t, times, values[:, 0]))
    roll, pitch = angles
    q, r = z[:, at["gyro_y_radps"]], z[:, at["gyro_radps"]]
    x, y, low = (z[:, at[f"accel_{axis}_mps2"]] for axis in "xyz")
    down = y * np.sin(roll) + low * np.cos(roll)
    level = z.copy()
    level[:, at["gyro_radps"]] = (q * np.sin(roll) + r * np.cos(roll)) / np.cos(pitch)
    level[:, at["accel_x_mps2"]] = x * np.cos(pitch) + down * np.sin(pitch)
    level[:, at["accel_y_mps2"]] = y * np.cos(roll) - low * np.sin(roll)
    return dataclasses.replace(recording, z=level)
