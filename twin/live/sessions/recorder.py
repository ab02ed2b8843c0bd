"""A log that is written while the boat sails: a process that is killed loses a second of it."""

from __future__ import annotations

import itertools
import os
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twin.channels import COMMANDS, MEASUREMENTS, TIME, TRUTH
from twin.logs.datum import DATUM, Datum
from twin.logs.log import sibling_path
from twin.particulars import Particulars
from usv_kernel.files import write_whole

__all__ = [
    "FLUSHED",
    "Recorder",
]

Array = NDArray[np.float64]

FLUSHED = 0.5
"""Time between two writes to the disk, s."""


class Recorder:
    """Writes rows to a new log, as CSV, and the boat's particulars beside it.

    Rows that the disk does not take are kept, and written when it takes them again. ``path`` is
    the log, ``rows`` counts its rows.

    Parameters
    ----------
    folder : Path
        Where the log goes; it is made if needed.
    particulars : Particulars
        Of the boat.
    with_truth : bool
        Whether rows have the true state.

    Raises
    ------
    OSError
        Where the folder cannot be written to.
    """

    def __init__(self, folder: Path, particulars: Particulars, *, with_truth: bool) -> None:
        self.rows, self._with_truth, self._due = 0, with_truth, 0.0
        names = (TIME, *COMMANDS, *MEASUREMENTS, *(TRUTH if with_truth else ()), *DATUM)
        self._pending = bytearray((",".join(names) + "\n").encode())
        folder.mkdir(parents=True, exist_ok=True)
        self.path, self._file = _new_log(folder)
        try:
            self.flush()
            write_whole(sibling_path(self.path, ".toml"), particulars.to_toml().encode())
        except OSError:
            os.close(self._file)
            self.path.unlink(missing_ok=True)
            raise

    def add(self, t: float, z: Array, cmd: Array, truth: Array, datum: Datum | None) -> None:
        """Take a row: time (s), measurements (19,), commands (4,) and true state (6,)."""
        place = (datum.latitude, datum.longitude, datum.epoch) if datum else (None, None, None)
        values = [t, *cmd.tolist(), *z.tolist(), *(truth.tolist() if self._with_truth else ())]
        cells = ("" if one is None or one != one else repr(one) for one in (*values, *place))
        self._pending += (",".join(cells) + "\n").encode()
        self.rows += 1

    def flush(self, *, now: bool = True) -> None:
        """Write what is pending, at once or when it is due; OSError names the file."""
        clock = time.monotonic()
        if not (now or clock >= self._due):
            return
        self._due = clock + FLUSHED
        try:
            while self._pending:
                # a part of it, where the disk fills up
                del self._pending[: os.write(self._file, self._pending)]
        except OSError as error:
            error.filename = str(self.path)
            raise

    def close(self) -> Path | None:
        """Write all rows, to the medium itself, and return the file; None without a row."""
        self.flush()
        os.fsync(self._file)
        os.close(self._file)
        if not self.rows:
            for path in (self.path, sibling_path(self.path, ".toml")):
                path.unlink(missing_ok=True)
        return self.path if self.rows else None


def _new_log(folder: Path) -> tuple[Path, int]:
    """Create a log of a name that is free; return it and its descriptor."""
    stamp = time.strftime("%Y%m%d-%H%M%S")
    for k in itertools.count(1):
        path = folder / f"view_{stamp}{f'_{k}' if k > 1 else ''}.csv"
        try:
            return path, os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND, 0o644)
        except FileExistsError:
            continue
    raise AssertionError
