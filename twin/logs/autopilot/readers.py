"""The two kinds of logs of an autopilot, as one kind of recording."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from twin.logs.autopilot.dataflash import flash_parameters, read_flash
from twin.logs.autopilot.flight import table_of
from twin.logs.autopilot.telemetry import read_telemetry, telemetry_parameters
from twin.logs.mapping import Layout
from twin.logs.readers import Table

__all__ = [
    "is_autopilot_log",
    "parameters_of",
    "read_autopilot_log",
]

SUFFIXES = (".bin", ".tlog")
"""Endings of DataFlash and telemetry logs, in any case."""


def is_autopilot_log(path: Path) -> bool:
    """Return whether a path is that of a log of an autopilot, by its ending."""
    return path.suffix.lower() in SUFFIXES


def read_autopilot_log(path: Path, layout: Layout | None) -> Table:
    """Return the columns of an autopilot's log.

    Position and velocity are those of the GPS receiver, heading, roll and pitch those of the
    autopilot's attitude, and the commands come from its servo outputs.

    Raises
    ------
    LogError
        Names the file and the remedy.
    """
    read = read_telemetry if path.suffix.lower() == ".tlog" else read_flash
    return table_of(path, read(path), layout)


def parameters_of(path: Path) -> Mapping[str, float]:
    """Return the autopilot's parameters in its log, by name."""
    read = telemetry_parameters if path.suffix.lower() == ".tlog" else flash_parameters
    return read(path)
