"""Parquet files, which polars reads and writes: the extra ``parquet``."""

from __future__ import annotations

import importlib
import io
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from twin.logs.columns import Array
from twin.logs.dates import Clock
from twin.logs.errors import LogError
from twin.logs.files import Block, CsvFile, as_numbers, cannot_be_read, shorten
from usv_kernel.errors import UsvTwinError
from usv_kernel.files import write_whole

if TYPE_CHECKING:
    import polars as pl

__all__ = ["ParquetFile", "column_file", "need_polars", "write_parquet"]

_BLOCK_ROWS = 1 << 19


def need_polars(purpose: str, error: type[UsvTwinError] = LogError) -> Any:
    """Return the module polars; ``error`` with the remedy where it is not installed."""
    try:
        return importlib.import_module("polars")
    except ImportError:
        raise error(
            f"{purpose} needs the package polars: pip install 'usv-twin[parquet]'"
        ) from None


def column_file(path: Path) -> CsvFile | ParquetFile:
    """Return a file of columns, of the kind that its name ends in."""
    return ParquetFile(path) if path.suffix == ".parquet" else CsvFile(path)


_READER = """
import sys, polars as pl
source, columns, *numbers = sys.argv[1:]
pl.scan_parquet(source, glob=False).select(pl.nth(*map(int, numbers))).sink_ipc(columns)
"""
"""Run by a process of its own: of a damaged page, polars 2.1 asks for more memory than there is and
ends its process."""


def write_parquet(path: str | Path, frame: pl.DataFrame) -> None:
    """Write a frame, NaN as null."""
    packed = io.BytesIO()  # polars would turn a full disk into an error of its own
    frame.fill_nan(None).write_parquet(packed)
    write_whole(path, packed.getvalue())


class ParquetFile:
    """A Parquet file; LogError where it is none."""

    unit, head, first = "row", "the header", 1  # as of a CsvFile

    def __init__(self, path: Path) -> None:
        pl = need_polars(f"{path}: reading Parquet")
        self.path, self.source = path, str(path)
        try:
            with path.open("rb") as file:
                start = file.read(4)
        except OSError as error:
            raise cannot_be_read(path, error) from None
        if start != b"PAR1":
            what = "is not a Parquet file" if start else "the file is empty"
            raise LogError(f"{path}: {what}; write it again, or give a CSV file the ending .csv")
        try:
            self.header = tuple(pl.read_parquet_schema(path))
        except pl.exceptions.DuplicateError as error:
            raise LogError(f"{path}: {error}; rename one of them") from None
        except (pl.exceptions.PolarsError, pl.exceptions.PanicException, OSError) as error:
            raise self._damaged(str(error)) from None

    def _damaged(self, reason: str) -> LogError:
        said = shorten(" ".join(reason.split()) or "its pages", 100)
        return LogError(
            f"{self.path}: the Parquet file is damaged or cut off ({said}); copy it again"
        )

    def _frames(self, sources: Sequence[str], rows: int) -> Iterator[pl.DataFrame]:
        """Yield the columns named, in pieces of so many rows; one empty piece if there are none."""
        import polars as pl

        numbers = [str(self.header.index(name)) for name in sources]
        with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
            columns = Path(folder) / "columns.arrow"
            command = [sys.executable, "-P", "-c", _READER, str(self.path), str(columns)]
            done = subprocess.run([*command, *numbers], capture_output=True, check=False)
            if done.returncode:
                lines = done.stderr.decode("utf-8", "replace").strip().splitlines() or [""]
                raise self._damaged(lines[-1 if done.returncode == 1 else 0])
            whole = pl.scan_ipc(columns)
            height = whole.select(pl.len()).collect().item()
            for first in range(0, max(height, 1), rows):
                yield whole.slice(first, rows).collect()

    def blocks(self, sources: Sequence[str], clock: Clock) -> Iterator[Block]:
        """Yield the columns named, in pieces; see :meth:`CsvFile.blocks`."""
        first = self.first
        for frame in self._frames(sources, _BLOCK_ROWS):
            lines = np.arange(first, first + frame.height, dtype=np.float64)
            columns = {name: self._column(frame[name], clock) for name in frame.columns}
            dates = {name for name, kind in frame.schema.items() if _is_date(kind)}
            dated = dates | (
                {clock.column} & {n for n, v in columns.items() if isinstance(v, list)}
            )
            yield lines, as_numbers(columns, clock, lines, self.source, self.unit), dated
            first += frame.height

    def _column(self, values: pl.Series, clock: Clock) -> Array | list[str]:
        """Return a column as numbers, or as text where it holds text or the parts of a date."""
        import polars as pl

        kind = values.dtype
        written = values.name == clock.column and clock.format and kind.is_numeric()
        if kind == pl.String or values.name == clock.date or written:
            return _texts(values)
        if _is_date(kind):
            values = values.cast(pl.Datetime("us")).dt.epoch("us").cast(pl.Float64) * 1e-6
        elif kind == pl.Duration:
            values = values.dt.total_microseconds().cast(pl.Float64) * 1e-6
        elif not (kind.is_numeric() or kind == pl.Null):
            raise LogError(
                f"{self.source}: column {values.name} holds {kind}, not numbers; convert it"
            )
        return values.cast(pl.Float64).to_numpy().astype(np.float64, copy=False)

    def texts(self, rows: int) -> dict[str, list[str]]:
        """Return the first rows as text by column, those of lists left out."""
        frame = next(self._frames(self.header, rows))
        plain = [name for name, kind in frame.schema.items() if not kind.is_nested()]
        return {name: _texts(frame[name]) for name in plain}


def _is_date(kind: pl.DataType) -> bool:
    import polars as pl

    return kind in (pl.Datetime, pl.Date)


def _texts(values: pl.Series) -> list[str]:
    """Return the cells of a column as text, empty where there is none."""
    import polars as pl

    return values.cast(pl.String).fill_null("").to_list()
