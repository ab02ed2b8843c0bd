"""A log that is written row by row while the boat sails."""

from __future__ import annotations

import itertools
import time
from pathlib import Path
from typing import TextIO

import numpy as np
from numpy.typing import NDArray

from twin.channels import COMMANDS, MEASUREMENTS, TIME, TRUTH
from twin.logs.datum import DATUM, Datum
from twin.logs.log import sibling_path
from twin.particulars import Particulars
from usv_kernel.files import write_whole

__all__ = [
    "Recorder",
]

Array = NDArray[np.float64]


class Recorder:
    """Writes rows to a new log, as CSV, and the boat's particulars beside it.

    ``path`` is the log, ``rows`` counts its rows. OSError where the disk does not take them.

    Parameters
    ----------
    folder : Path
        Where the log goes; it is made if needed.
    particulars : Particulars
        Of the boat.
    with_truth : bool
        Whether rows have the true state.
    """

    def __init__(self, folder: Path, particulars: Particulars, *, with_truth: bool) -> None:
        self.rows, self._with_truth = 0, with_truth
        folder.mkdir(parents=True, exist_ok=True)
        self.path, self._file = _new_log(folder)
        names = (TIME, *COMMANDS, *MEASUREMENTS, *(TRUTH if with_truth else ()), *DATUM)
        self._file.write(",".join(names) + "\n")
        write_whole(sibling_path(self.path, ".toml"), particulars.to_toml().encode())

    def add(self, t: float, z: Array, cmd: Array, truth: Array, datum: Datum | None) -> None:
        """Take a row: time (s), measurements (19,), commands (4,) and true state (6,)."""
        place = (datum.latitude, datum.longitude, datum.epoch) if datum else (None, None, None)
        values = [t, *cmd.tolist(), *z.tolist(), *(truth.tolist() if self._with_truth else ())]
        cells = ("" if one is None or one != one else repr(one) for one in (*values, *place))
        self._file.write(",".join(cells) + "\n")
        self.rows += 1

    def close(self) -> Path | None:
        """Write all rows, and return the file; None without a row."""
        self._file.close()
        if not self.rows:
            for path in (self.path, sibling_path(self.path, ".toml")):
                path.unlink(missing_ok=True)
        return self.path if self.rows else None


def _new_log(folder: Path) -> tuple[Path, TextIO]:
    """Create a log of a name that is free; return it and its file, written line by line."""
    stamp = time.strftime("%Y%m%d-%H%M%S")
    for k in itertools.count(1):
        path = folder / f"view_{stamp}{f'_{k}' if k > 1 else ''}.csv"
        try:
            return path, path.open("x", buffering=1, newline="")
        except FileExistsError:
            continue
    raise AssertionError
