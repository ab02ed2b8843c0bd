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

from twin.channels import COMMANDS, MEASUREMENTS, MOTION_AT
from twin.integrity.evidence import (
    RAW_HEADING,
    Evidence,
    Signals,
    angle_rate,
    level_forces,
    log_likelihood,
    signals_of,
)
from twin.integrity.findings import ERROR, NOTE, SEVERITIES, WARNING, Finding
from twin.integrity.instruments import (
    SensorFigures,
    estimate_instruments,
    particulars_text,
    pooled,
    sensor_figures,
    typical_boat,
)
from twin.integrity.monitor import run_over
from twin.integrity.rows import (
    ANGLES,
    FIX,
    FORCES,
    GYROS,
    SAMPLES_MIN,
    SENSORS,
    check_cells,
    check_commands,
    check_silence,
    check_time,
    without_leaps,
    without_marks,
)
from twin.integrity.state import DOUBTFUL, EXCLUDED, FROZEN, IMPOSSIBLE, REASONS
from twin.integrity.state import SENSORS as CHECKED
from twin.integrity.transforms import Trial, explain, measured, unseen
from twin.logs.checks import in_degrees
from twin.logs.datum import FEW
from twin.logs.errors import LogError
from twin.logs.log import Log, assemble, read_table
from twin.logs.recording import Recording
from twin.logs.signals import runs_of
from twin.particulars import GRAVITY, Instruments, Particulars

__all__ = ["LogCheck", "SensorFigures", "check_log", "check_recording"]

Array = npt.NDArray[np.float64]

REPORTED_MIN_S = 1.0
WARNING_MIN_S = 8.0
"""Least time in doubt of a sensor that is reported, and least time at once that is a warning; a
shorter one, with few rows in all, is a note."""

OF_COMMANDS = {"commands", "left", "right", "shafts", "steering"}
"""Sensors of findings about commands."""


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
    recording: Recording = dataclasses.field(repr=False)
    notes: tuple[str, ...] = ()
    log: Log | None = None

    @property
    def agreement(self) -> tuple[str, ...]:
        """How sensors and commands agree with each other, a line each."""
        return tuple(
            f"{name}: agree by {share:.1%}" if share > 0.5 else f"{name}: cannot tell"
            for name, share in self.agreed.items()
        )

    def count(self, severity: str) -> int:
        """Return how many findings are of a severity."""
        return sum(finding.severity == severity for finding in self.findings)

    def particulars_text(self, others: Sequence[LogCheck] = ()) -> str:
        """Return a particulars file as the log shows them; the rest is left to fill in.

        Parameters
        ----------
        others : sequence of LogCheck
            Of more logs of the same boat: then the instruments are medians.
        """
        checks = (self, *others)
        shown = pooled([(each.instruments, each.reasons) for each in checks])
        return particulars_text([each.recording for each in checks], *shown)

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
    recording, found = without_marks(recording, particulars)
    found += check_time(recording) + check_cells(recording)
    base = Instruments() if particulars is None else particulars.instruments
    if len(recording.t) < SAMPLES_MIN:
        return LogCheck(_sorted(found), sensor_figures(recording), {}, base, {}, recording)
    kept, leaps = without_leaps(recording)
    found += check_silence(recording) + leaps
    kept = _without_gross(kept, found)
    figures = sensor_figures(kept)
    fix = kept.z[np.isfinite(kept.z[:, :2]).all(axis=1), :2]
    if why := in_degrees(fix):
        what = f"{kept.called(*FIX)}: {why}"
        remedy = "give latitude and longitude in [position] of a mapping file"
        found.append(Finding(ERROR, "unit", what, remedy, "fixes"))
        kept = kept.without(FIX)
    if any(finding.code == "time-unit" for finding in found):
        kept = dataclasses.replace(kept, t=1e-3 * kept.t)
    found += check_commands(kept, particulars)
    signals, undone = signals_of(kept, base), list[Trial]()
    numbers: dict[str, Trial | None] = {}
    evidence: Evidence = {}
    if signals is not None:
        faults, signals, undone = explain(signals)
        found += faults
        evidence = log_likelihood(signals)
        known = {finding.sensor for finding in found}
        found += [each for each in unseen(signals, evidence) if each.sensor not in known]
        if signals.has(*FORCES[:2]):
            late = measured(signals, evidence, "late", "gps")
            numbers["gps_latency"] = late and late._replace(size=late.size + signals.latency)
        numbers["gyro_bias_sd"] = measured(signals, evidence, "bias", "gyro")
    instruments, reasons = estimate_instruments(kept, figures, numbers, particulars)
    found += _doubted(kept, found, undone, instruments, particulars)
    agreed = {name: max(1.0 - one.rho, 0.0) for name, one in evidence.items() if one is not None}
    return LogCheck(_sorted(found), figures, agreed, instruments, reasons, kept)


def _sorted(found: Sequence[Finding]) -> tuple[Finding, ...]:
    """Return findings, each once, errors first."""
    return tuple(sorted(dict.fromkeys(found), key=lambda each: SEVERITIES.index(each.severity)))


def _without_gross(recording: Recording, found: list[Finding]) -> Recording:
    """Return a recording without dead and frozen columns."""
    for finding in found:
        names = SENSORS.get(finding.sensor, (finding.sensor,))
        if finding.code == "frozen":
            # of one that is frozen from the first row on, no sample was new
            begun = (recording.t > finding.start) | (finding.start == recording.t[0])
            inside = begun & (recording.t <= finding.end)
            recording = recording.without(names, inside)
        elif finding.code == "dead":
            recording = recording.without(names)
    return recording


def _doubted(
    recording: Recording,
    known: list[Finding],
    undone: list[Trial],
    instruments: Instruments,
    particulars: Particulars | None,
) -> list[Finding]:
    """Return what the checks that run on board leave out or doubt, and when.

    They watch no commands that have a fault in the whole log.
    """
    rows = _mended(recording, undone)
    boat = particulars or typical_boat(rows, instruments)
    with_commands = particulars is not None and OF_COMMANDS.isdisjoint(
        finding.sensor for finding in known if finding.severity != NOTE
    )
    t, found = rows.t, []
    statuses, reasons = run_over(boat, t, rows.z, rows.cmd)
    for j, sensor in enumerate(CHECKED if with_commands else CHECKED[:-1]):
        out = (statuses[:, j] == EXCLUDED) | (statuses[:, j] == DOUBTFUL)
        runs = [(i, k - 1) for i, k in runs_of(out) if t[k - 1] - t[i] > REPORTED_MIN_S]
        if not runs:
            continue
        i, k = max(runs, key=lambda run: t[run[1]] - t[run[0]])
        total = float(sum(t[b] - t[a] for a, b in runs))
        why = int(np.bincount(reasons[i : k + 1, j].astype(int)).argmax())
        what = f"{sensor} {REASONS[why]} from t = {t[i]:.1f} to {t[k]:.1f} s"
        if len(runs) > 1:
            what += f", {total:.0f} s in {len(runs)} stretches"
        code = {IMPOSSIBLE: "mark", FROZEN: "frozen"}.get(why, "contradiction")
        brief = t[k] - t[i] < WARNING_MIN_S and total < FEW * (t[-1] - t[0])
        # of commands, the whole log tells more than a stretch
        severity = NOTE if brief or sensor == "commands" else WARNING
        remedy = "the twin leaves it out there; mend it or empty these cells"
        span = {"start": float(t[i]), "end": float(t[k])}
        found.append(Finding(severity, code, what, remedy, sensor, total, **span))
    return found


def _mended(recording: Recording, undone: list[Trial]) -> Recording:
    """Return new samples without the faults that were found, as of a boat that stands upright."""
    columns = dict(zip(MEASUREMENTS, recording.z.T.copy(), strict=True))
    columns |= zip(COMMANDS, np.nan_to_num(recording.cmd).T, strict=True)
    for names in SENSORS.values():
        at, _ = recording.samples(*names)
        for name in names if MEASUREMENTS.index(names[0]) < MOTION_AT else ():
            columns[name][~np.isin(recording.t, at)] = math.nan
    rows = Signals(recording.t, columns | {RAW_HEADING: columns["compass_rad"]})
    for each in undone:
        rows = each.on_rows(rows)
    if rows.has(*ANGLES):
        roll, pitch = (
            np.interp(rows.t, rows.t[seen], rows[name][seen])
            for name in ANGLES
            for seen in [np.isfinite(rows[name])]
        )
        gyros = np.nan_to_num(rows.stacked(*GYROS))
        forces = rows.stacked(*FORCES)
        forces[2, np.isnan(forces[2])] = -GRAVITY
        known = np.isfinite(rows[GYROS[2]])
        turning = np.where(known, angle_rate(2, roll, pitch, gyros), math.nan)
        rows = rows.having(GYROS[2:], turning[None])
        rows = rows.having(FORCES[:2], np.array(level_forces(roll, pitch, forces)))
    z, cmd = rows.stacked(*MEASUREMENTS).T, rows.stacked(*COMMANDS).T
    return dataclasses.replace(recording, z=z, cmd=cmd)
