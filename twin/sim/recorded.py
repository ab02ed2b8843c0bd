"""Recorded runs with the particulars of their boats."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from twin.logs import datasets as archive
from twin.logs.log import Log, sibling_path
from twin.particulars import Particulars
from twin.sim.bridge import particulars_of
from usv_gym.vessel.vessel import Vessel

__all__ = [
    "lacks_particulars",
    "particulars_for_log",
    "read_run",
]


def log_name(path: str) -> str:
    """Return the name of a recorded run."""
    return sibling_path(path, "").name


def read_run(
    path: str, ship: str | None = None, mapping: str | None = None
) -> tuple[Log, Particulars]:
    """Return a recorded run and its boat's particulars.

    See :func:`particulars_for_log` and ``Log.read``.
    """
    return Log.read(path, mapping), particulars_for_log(path, ship)[0]


NO_PARTICULARS = "{}: no particulars beside it, taken to be the usv75; --ship FILE names a boat"
"""Said where :func:`particulars_for_log` found none."""


def lacks_particulars(path: str) -> bool:
    """Return whether a log has no particulars of its boat."""
    return not (sibling_path(path, ".toml").exists() or archive.known(path))


def particulars_for_log(path: str | Path, ship: str | None = None) -> tuple[Particulars, bool]:
    """Return the particulars for a log, and whether any were given for it.

    They are those of ``ship``, else those in ``<log>.toml`` next to the log, else those of an
    archive's boat, else the usv75's without its class. ``ship`` is a TOML file of particulars, of
    one boat or of several (``[[ship]]``, see :meth:`twin.particulars.Particulars.load`), or the
    name or file of a vessel of ``usv_gym``. ParticularsError, VesselError: file and remedy.
    """
    if ship is None:
        file = sibling_path(path, ".toml")
        if file.exists():
            return Particulars.load(file), True
        if archive.known(path):
            return archive.ship(path), True
        return dataclasses.replace(particulars_of(Vessel.load("usv75")), design=""), False
    text = _text(ship) if Path(ship).suffix == ".toml" else ""
    if "[[ship]]" in text or ("[particulars]" in text and "[hull]" not in text):
        return Particulars.load(ship, log=path), True
    return particulars_of(Vessel.load(ship)), True


def _text(path: str) -> str:
    try:
        return Path(path).read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
