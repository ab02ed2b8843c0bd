"""Contents of files: results as JSON and CSV, arrays in archives, and kept results."""

from __future__ import annotations

import csv
import gzip
import io
import json
import zipfile
import zlib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

from usv_kernel.errors import UsvTwinError
from usv_kernel.files import JSON_MAX, read_json, read_limited, write_whole

__all__ = [
    "compressed_csv",
    "csv_text",
    "keep",
    "kept",
    "read_archive",
    "results_text",
    "write_csv",
]

ARCHIVE_MAX = 2**28
EXPANSION_MAX = 20
"""An archive unpacks to no more bytes than this, or than so many times its file. Zeros of an
empty window shrink to nothing, a long history hardly at all."""


_CSV_ROWS = 1 << 14
"""Rows of a CSV file that are turned into text at a time."""


def results_text(results: dict[str, Any]) -> str:
    """Return results as JSON with a line for each row of each table."""
    lines = []
    for key, value in results.items():
        text = json.dumps(value, indent=1) if isinstance(value, dict) else json.dumps(value)
        if isinstance(value, list) and value and isinstance(value[0], dict):
            text = "[\n  " + ",\n  ".join(json.dumps(row) for row in value) + "\n ]"
        lines.append(f" {json.dumps(key)}: {text}")
    return "{\n" + ",\n".join(lines) + "\n}\n"


def compressed_csv(rows: Sequence[dict[str, Any]]) -> bytes:
    """Return rows of equal keys as a gzipped CSV; equal rows give equal bytes."""
    text = csv_text(rows[0] if rows else (), [list(row.values()) for row in rows])
    return gzip.compress(text.encode(), mtime=0)


def csv_text(header: Iterable[str], rows: Iterable[Iterable[Any]]) -> str:
    """Return rows as CSV: None as an empty cell, ``true`` and ``false``."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    for row in rows:
        writer.writerow([str(cell).lower() if isinstance(cell, bool) else cell for cell in row])
    return text.getvalue()


def write_csv(file: BinaryIO | gzip.GzipFile, columns: Mapping[str, npt.ArrayLike]) -> None:
    """Write columns of equal length (N,) as CSV, NaN and None as empty cells.

    Each number has the digits that give the same float64 back.
    """
    text = io.TextIOWrapper(file, "utf-8", newline="", write_through=True)  # type: ignore[arg-type]
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    values = [np.asarray(column) for column in columns.values()]
    for first in range(0, len(values[0]), _CSV_ROWS):
        parts = [column[first : first + _CSV_ROWS].astype(object) for column in values]
        for part in parts:
            part[part != part] = None  # NaN
        writer.writerows(zip(*parts, strict=True))
    text.detach()


def read_archive(
    path: str | Path, error: type[UsvTwinError], what: str, remedy: str
) -> dict[str, Any]:
    """Return the entries of a zip archive: arrays by name without ``.npy``, others as bytes.

    Nothing in it is run. ``error`` says that the file is no ``what`` and the ``remedy``, or that it
    is damaged.
    """
    path = Path(path)
    content = read_limited(path, error, JSON_MAX)
    if not content.startswith(b"PK"):
        raise error(f"{path}: is no {what}; {remedy}")
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            names = archive.namelist()
            size = sum(info.file_size for info in archive.infolist())
            most = max(ARCHIVE_MAX, EXPANSION_MAX * len(content))
            if size > most or len(set(names)) < len(names):
                raise error(
                    f"{path}: holds {size:.3g} bytes in {len(names)} parts, more or other than "
                    f"a {what} has; {remedy}"
                )
            return {name.removesuffix(".npy"): _entry(archive, name) for name in names}
    except error:
        raise
    except Exception:  # a damaged archive fails in as many ways as it has bytes
        raise error(f"{path}: is cut off or damaged; use an earlier copy of the file") from None


def _entry(archive: zipfile.ZipFile, name: str) -> Any:
    """Return one entry of an archive."""
    content = archive.read(name)
    if not name.endswith(".npy"):
        return content
    return np.lib.format.read_array(io.BytesIO(content), allow_pickle=False)


class _KeptError(UsvTwinError):
    """A kept result that cannot be read; never seen outside of this module."""


def keep(path: Path, key: Any, content: Any) -> None:
    """Keep a result, plain JSON data, for :func:`kept` with the same key."""
    checksum = zlib.crc32(json.dumps(content).encode())
    write_whole(path, json.dumps({"key": key, "checksum": checksum, "content": content}).encode())


def kept(path: Path, key: Any) -> Any:
    """Return what :func:`keep` wrote; None if it is missing, damaged, or has another key."""
    try:
        found = read_json(path, _KeptError)
    except _KeptError:
        return None
    if not isinstance(found, dict) or found.get("key") != json.loads(json.dumps(key)):
        return None
    content = found.get("content")
    checksum = zlib.crc32(json.dumps(content).encode())
    return content if found.get("checksum") == checksum else None
