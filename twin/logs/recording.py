"""Columns of a log before any repair, and which of their samples are new."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from twin.channels import COMMANDS, MEASUREMENTS, TIME
from twin.logs.clock import run_on, spread, wild_stamps
from twin.logs.columns import Array
from twin.logs.datum import Plane
from twin.logs.readers import merged
from usv_kernel.channels import COMPASS

__all__ = [
    "Recording",
    "clashing_rows",
    "equal_times",
    "held",
    "motion_of",
    "repeated",
]


@dataclass(frozen=True, eq=False)
class Recording:
    """Columns of a log before any repair.

    Parameters
    ----------
    t : ndarray, shape (N,)
        Time, s, strictly increasing; where the clock was set back, as if it were not.
    z : ndarray, shape (N, 19)
        Measurements in the order of ``MEASUREMENTS``; NaN where there is none.
    cmd : ndarray, shape (N, 4)
        Commands in the order of ``COMMANDS``; NaN where there is none.
    stamps : ndarray, shape (M,)
        Time as the file has it, also where it is empty or goes back.
    given : mapping of str to str
        What the file calls each column of the log.
    name : str
        Of the log.
    infinite : int
        Cells that were infinite, and are NaN here.
    clashes : int
        Rows with the time of the row before and other values.
    plane : Plane, optional
        On which positions are measured, where the file has latitude and longitude.
    motion : ndarray, shape (M, 3), optional
        Positions and headings of all rows, also of those whose time does not advance.
    """

    t: Array
    z: Array
    cmd: Array
    stamps: Array
    given: Mapping[str, str] = field(default_factory=dict)
    name: str = "log"
    infinite: int = 0
    clashes: int = 0
    plane: Plane | None = None
    motion: Array | None = None

    @classmethod
    def of(
        cls,
        data: Mapping[str, Array],
        given: Mapping[str, str],
        name: str,
        plane: Plane | None = None,
    ) -> Recording:
        """Return the recording in the columns of a table, with the rows whose time advances.

        Parameters
        ----------
        data : mapping of str to ndarray, shape (M,)
            Columns of the log; those that are absent become NaN.
        given : mapping of str to str
            What the file calls them.
        name : str
            Of the log.
        plane : Plane, optional
            On which positions are measured.
        """
        stamps = np.asarray(data[TIME], dtype=np.float64)
        # a step of the clock makes no sensor jump
        motion = motion_of(data)
        times = run_on(np.where(wild_stamps(stamps), np.nan, stamps), motion)
        clashes = clashing_rows(data)
        if clashes and (apart := spread(times)) is not None:
            times = apart
        valid = np.isfinite(times)
        latest = np.maximum.accumulate(np.where(valid, times, -np.inf))
        kept = valid & (times > np.append(-np.inf, latest[:-1]))

        def stack(names: tuple[str, ...]) -> Array:
            table = np.full((int(kept.sum()), len(names)), np.nan)
            for j, name in enumerate(names):
                if name in data:
                    table[:, j] = np.asarray(data[name], dtype=np.float64)[kept]
            return table

        z, cmd = stack(MEASUREMENTS), stack(COMMANDS)
        infinite = int(np.isinf(z).sum() + np.isinf(cmd).sum())
        z[np.isinf(z)], cmd[np.isinf(cmd)] = np.nan, np.nan
        cmd = held(cmd)  # an empty command is the last one
        cmd[:, [column not in data for column in COMMANDS]] = 0.0
        more = infinite, clashes, plane, motion
        return cls(times[kept], z, cmd, stamps, dict(given), name, *more)

    def called(self, *names: str) -> str:
        """Return what the file calls columns, each once."""
        return ", ".join(dict.fromkeys(self.given.get(name, name) for name in names))

    def without(
        self, names: Iterable[str], rows: slice | npt.NDArray[Any] = slice(None)
    ) -> Recording:
        """Return a recording without some columns, in all rows or some; a command is the last."""
        table, columns = np.column_stack([self.z, self.cmd]), (*MEASUREMENTS, *COMMANDS)
        for name in {*names}.intersection(columns):
            table[rows, columns.index(name)] = np.nan
        z, cmd = np.hsplit(table, [len(MEASUREMENTS)])
        return dataclasses.replace(self, z=z, cmd=held(cmd))

    def samples(self, *names: str) -> tuple[Array, Array]:
        """Return times (M,) and new samples (M, k) of measurements that come together.

        A fix, a velocity or a compass value that only repeats the last one is no new sample. Nor is
        a yaw rate that repeats while the compass does: the logger wrote a row again.
        """
        columns = [MEASUREMENTS.index(name) for name in names]
        values = self.z[:, columns]
        new = np.isfinite(values).all(axis=1)
        fix = self.z[:, :2]
        if columns[0] < 2:
            new &= ~repeated(fix)
        elif columns[0] < 4:
            new &= ~(repeated(values) & (repeated(fix) | np.isnan(fix).any(axis=1)))
        elif columns[0] == 4:
            new &= ~repeated(values)
        elif columns[0] == 5:
            new &= ~(repeated(values) & repeated(self.z[:, 4:5]))
        return self.t[new], values[new]


def motion_of(data: Mapping[str, Array]) -> Array | None:
    """Return positions and headings (N, 3) in columns of a log, if they are there."""
    names = (*MEASUREMENTS[:2], MEASUREMENTS[COMPASS])
    if not all(name in data for name in names):
        return None
    return np.column_stack([np.asarray(data[name], np.float64) for name in names])


class EqualTimes(NamedTuple):
    """Rows of a log with one row for each time."""

    first: npt.NDArray[np.intp]  # number of the first row of each time
    data: dict[str, Array]  # columns with one row for each
    clashes: int  # rows that contradict another one of the same time


def equal_times(data: Mapping[str, Array]) -> EqualTimes | None:
    """Return the rows of a log merged by time; None if all differ, or times go back.

    Parameters
    ----------
    data : mapping of str to ndarray, shape (N,)
        Columns of a log, ``t_s`` among them; NaN contradicts nothing.
    """
    step = np.diff(np.asarray(data[TIME], dtype=np.float64), prepend=-np.inf)
    if not (step == 0.0).any() or not (step >= 0.0).all():
        return None
    group = np.cumsum(step > 0.0) - 1
    one = merged(group, data)
    other = np.zeros(len(step), dtype=np.bool_)
    for name, values in data.items():
        other |= ~((one[name][group] == values) | np.isnan(values))
    return EqualTimes(np.flatnonzero(step > 0.0), one, int(other.sum()))


def clashing_rows(data: Mapping[str, Array]) -> int:
    """Return how many rows contradict another one of the same time; see :func:`equal_times`."""
    found = equal_times(data)
    return 0 if found is None else found.clashes


def held(values: Array) -> Array:
    """Return values (N,) or (N, k) with NaN replaced by the last number before it, if any."""
    rows = np.arange(len(values)).reshape((-1,) + (1,) * (values.ndim - 1))
    last = np.maximum.accumulate(np.where(np.isnan(values), 0, rows), axis=0)
    return np.take_along_axis(values, last, axis=0)


def repeated(values: Array) -> npt.NDArray[np.bool_]:
    """Return the rows of (N, k) values that equal the last complete row before them."""
    complete = np.flatnonzero(~np.isnan(values).any(axis=1))
    samples = values[complete]
    same = np.zeros(len(values), dtype=np.bool_)
    # Against the last valid sample, not the last row: reading twice changes nothing more.
    same[complete[1:]] = (samples[1:] == samples[:-1]).all(axis=1)
    return same
