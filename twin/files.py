"""Files written whole or not at all, and results as JSON."""

from __future__ import annotations

import gzip
import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

__all__ = [
    "compressed_csv",
    "results_text",
    "write_whole",
]


def write_whole(path: Path, content: bytes) -> None:
    """Write a file whole or not at all, even if the machine stops; make its folder if needed."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{os.getpid()}_{path.name}")
    try:
        with partial.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


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
    """Return rows as a gzipped CSV; equal rows give equal bytes."""
    import polars as pl

    return gzip.compress(pl.DataFrame(rows).write_csv().encode(), mtime=0)
