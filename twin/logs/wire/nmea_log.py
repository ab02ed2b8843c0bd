"""Text logs of NMEA 0183 as columns of a log, by the feed that reads the sentences live."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from twin.channels import COMMANDS, MEASUREMENTS, TIME
from twin.logs.columns import Array
from twin.logs.errors import LogError
from twin.logs.files import opened
from twin.logs.kinds import is_nmea
from twin.logs.mapping import Layout
from twin.logs.readers import MAX_ROWS, Table, date_of, name_of, said, thinned, too_long
from twin.logs.wire.nmea import DAY, NmeaFeed
from twin.particulars import Particulars

__all__ = ["is_nmea_log", "read_nmea_log"]

_DATE = re.compile(
    rb"RMC,\d+(?:\.\d*)?,A(?:,[^,]*){6},(\d{4})(\d\d),|ZDA,\d[^,]*,(\d\d,\d\d),\d\d(\d\d),"
)
"""Day and month, and year, of an RMC that has a fix or of a ZDA."""

_ANY = Particulars(name="", length=2.0, beam=1.0, draft=0.2, mass=100.0, speed=1.0, shaft_speed=1.0)
"""A feed wants a boat, for the commands that do not come; those are left out here."""


def is_nmea_log(path: Path) -> bool:
    """Return whether most lines at the start of a file are sentences."""
    try:
        with opened(path) as file:
            return is_nmea(file.read(4096))
    except LogError:
        return False  # said by those who read it


def _times(path: Path, lines: Sequence[bytes]) -> tuple[int, Array]:
    """Return the first line with a time, and the times from there, s; between them, even steps.

    A receiver without a fix may not know the time: it counts where it has none else.
    """
    feed, stamps = NmeaFeed(None, _ANY), np.full((2, len(lines)), np.nan)
    unread = Counter[str]()
    for k, line in enumerate(lines):
        for item in feed.decode(line):
            if isinstance(item, str):
                unread[item] += 1
            elif item.stamp is not None:
                stamps[int(item.void), k] = item.stamp
    known = np.flatnonzero(np.isfinite(stamps[0]))
    if not len(known):
        known, stamps = np.flatnonzero(np.isfinite(stamps[1])), stamps[1:]
    if not len(known):
        came = "".join(f", {count} {name}" for name, count in unread.items())
        raise LogError(
            f"{path}: no sentence tells the time (GGA, RMC, GNS, GLL, ZDA): {len(lines)} lines"
            f"{came} (broken: without a checksum, or with a wrong one)"
        )
    times = np.maximum.accumulate(np.unwrap(stamps[0, known], period=DAY))
    return int(known[0]), np.interp(np.arange(known[0], len(lines)), known, times)


def read_nmea_log(path: Path, layout: Layout | None) -> Table:
    """Return the columns of a text log of sentences; a mapping gives constants and [rows] alone.

    LogError: it cannot be read, or no sentence tells the time.
    """
    layout = layout or Layout()
    for entry in layout.entries:
        if entry.sources:
            raise LogError(
                f"{layout.source}: {entry.names[0]}: the sentences of an NMEA log are known; give "
                "constants alone, such as n_rps = 0.0"
            )
    with opened(path) as file:
        text = file.read()
    # from the sentence or its TAG block on: loggers put the time of arrival before it
    found = (re.search(rb"[$!\\].*", line) for line in text.splitlines() if line.strip())
    lines = [b"?\r\n" if each is None else each[0].strip() + b"\r\n" for each in found]
    before, times = _times(path, lines)
    now = float(times[0])
    feed = NmeaFeed(None, _ANY, clock=lambda: now)
    rows = []
    for line, now in zip(lines[before:], times.tolist(), strict=True):
        feed.receive(line, now)
        rows += feed.take()
        if len(rows) > MAX_ROWS:
            raise too_long(str(path))
    now += DAY
    rows += feed.take()
    if not rows:
        raise LogError(f"{path}: no sentence holds a measurement: {'; '.join(feed.notes)}")
    t, z, cmd = (np.array(part) for part in zip(*rows, strict=True))
    data: dict[str, Array] = {TIME: t}
    data |= {name: cmd[:, k] for k, name in enumerate(COMMANDS) if name in feed.commanded}
    seen = np.isfinite(z).any(axis=0)
    data |= {name: z[:, k] for k, name in enumerate(MEASUREMENTS) if seen[k]}
    for entry in layout.entries:
        data = {**{k: np.full(len(t), v) for k, v in entry.columns([]).items()}, **data}
    notes = [note for note in feed.notes if "taken as" not in note]
    notes.append(", ".join(f"{name} {count}" for name, count in feed.counts.items() if count))
    notes += [f"{before} line(s) before the first that tells the time left out"] * (before > 0)
    epoch, day = None, _DATE.search(b"".join(lines))
    if day is not None:
        parts = b"".join(part for part in day.groups() if part).replace(b",", b"").decode()
        midnight = datetime.strptime(parts, "%d%m%y").replace(tzinfo=UTC).timestamp()
        epoch = midnight + feed.stamp_of(0.0)
        notes.append(f"t_s: counted from {date_of(epoch)}")
    data = thinned(data[TIME], data, layout)
    t = data[TIME]
    notes += said(layout, len(rows), len(t))
    given = {name: name for name in data}
    return Table(
        str(path), name_of(path), data, given, lambda row: f"t = {t[row]:.6g} s", notes,
        feed.plane, epoch,
    )  # fmt: skip
