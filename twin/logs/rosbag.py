"""Columns of a log out of a bag of ROS 2 (sqlite3 or MCAP) or ROS 1, through ``rosbags``."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Collection
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from twin.channels import COMMANDS, TIME
from twin.logs.columns import Array, notes_of
from twin.logs.errors import LogError
from twin.logs.files import cannot_be_read, shorten
from twin.logs.kinds import mcap_kind
from twin.logs.mapping import Layout, mapping_path
from twin.logs.readers import MAX_ROWS, Table, date_of, name_of, said, thinned, too_long
from usv_kernel.errors import UsvTwinError

__all__ = [
    "commanded",
    "is_bag",
    "read_bag",
]

_OWN = {"/command", "/gps/position", "/imu/data"}
"""Topics of every bag of :mod:`twin.logs.bag_writer`."""

_LATE = 1.0
"""Messages of a topic may overtake each other, and clocks may differ, by this much, s."""


def is_bag(path: Path) -> bool:
    """Return whether a path is that of a bag: a folder, or a file of its kind."""
    kinds = (".mcap", ".db3", ".bag")
    if path.suffix in kinds:
        return True
    with suppress(OSError):
        names = [*path.iterdir()] if path.is_dir() else []
        return any(file.suffix in kinds or file.name == "metadata.yaml" for file in names)
    return False


@dataclass
class _Topic:
    """Samples of the fields of one topic."""

    fields: list[str]
    read: list[Callable[[Any], float]]
    stamps: array[int] = field(default_factory=lambda: array("q"))
    received: array[int] = field(default_factory=lambda: array("q"))
    values: array[float] = field(default_factory=lambda: array("d"))


def read_bag(path: Path, layout: Layout | None) -> Table:
    """Return the log's columns that a mapping makes of a bag; one row for each stamp of any topic.

    The bag is a folder with ``metadata.yaml``, or a file ``.mcap`` or ``.db3``; or of ROS 1, a file
    ``.bag`` or a folder of those that follow each other. Without a mapping
    it is refused with a list of the topics. NaN where a sensor gave nothing, commands held.
    """
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise LogError(
            f"{path}: reading a bag needs the package rosbags: pip install 'usv-twin[ros]'"
        ) from None
    if not path.exists():
        raise cannot_be_read(path, FileNotFoundError(2, "No such file or directory"))
    try:
        old = sorted(path.glob("*.bag")) if path.is_dir() else []
        with AnyReader(old or [path], default_typestore=get_typestore(Stores.LATEST)) as reader:
            types = {link.topic: link.msgtype for link in reader.connections}
            if layout is None and types.keys() >= _OWN:
                layout = _own_layout(types)
            topics = _asked(path, layout, types)
            links = [link for link in reader.connections if link.topic in topics]
            messages = reader.messages(links) if links else ()
            for count, (link, received, raw) in enumerate(messages):
                if count == MAX_ROWS:
                    raise too_long(str(path))
                _sample(topics[link.topic], reader.deserialize(raw, link.msgtype), received)
    except LogError:
        raise
    except _FieldError as error:
        raise LogError(f"{path}: topic {link.topic} ({link.msgtype}): {error}") from None
    except Exception as error:  # a damaged bag fails in as many ways as it has bytes
        if path.suffix == ".mcap" and (kind := mcap_kind(_start(path))):
            raise LogError(f"{path}: this is {kind}") from None
        reason = shorten(" ".join(str(error).split()) or type(error).__name__, 120)
        raise LogError(
            f"{path}: the bag is damaged, cut off or no ROS bag ({reason}). Copy it again, or "
            "rescue what is whole with: mcap recover IN.mcap -o OUT.mcap, or: ros2 bag reindex "
            "FOLDER, or of ROS 1: rosbag reindex FILE.bag"
        ) from None
    assert layout is not None
    return _united(path, layout, topics)


def _start(path: Path) -> bytes:
    """Return the first megabyte of a file."""
    with path.open("rb") as file:
        return file.read(1 << 20)


def _own_layout(types: Collection[str]) -> Layout:
    """Return the mapping of a bag that this package wrote, as far as its topics are there."""
    layout = Layout.load(mapping_path("usv_twin_bag"))
    kept = tuple(entry for entry in layout.entries if entry.topic in types)
    return replace(layout, source="usv_twin_bag.toml", entries=kept)


def _asked(path: Path, layout: Layout | None, types: dict[str, str]) -> dict[str, _Topic]:
    """Return the topics of a mapping with their fields, if the bag has them."""
    there = shorten(", ".join(f"{name} ({kind})" for name, kind in sorted(types.items())), 600)
    if layout is None:
        raise LogError(
            f"{path}: a bag needs a mapping of its topics: --mapping FILE, or "
            f"{name_of(path)}.mapping.toml next to it, after twin/logs/mappings/ros2_example.toml "
            f"(topics: {there or 'none'})"
        )
    topics: dict[str, _Topic] = {}
    for entry in layout.entries:
        if not entry.sources:
            continue
        if not entry.topic:
            raise LogError(
                f"{layout.source}: {entry.names[0]}: a bag needs topic = and field =, not from ="
            )
        if entry.topic not in types:
            raise LogError(
                f"{path}: has no topic {entry.topic}, which {layout.source} asks for "
                f"(topics: {there or 'none'})"
            )
        topic = topics.setdefault(entry.topic, _Topic([], []))
        for source in entry.sources:
            if source not in topic.fields:
                topic.fields.append(source)
                topic.read.append(_getter(source))
    return topics


class _FieldError(UsvTwinError):
    """A field that a message lacks, or that is no number."""


def _getter(source: str) -> Callable[[Any], float]:
    """Return what takes a field, ``pose.position.x`` or ``data.0``, out of a message."""
    optional = source.endswith("?")
    parts = source.removesuffix("?").split(".")

    def get(message: Any) -> float:
        value = message
        try:
            for part in parts:
                value = value[int(part)] if part.isdigit() else getattr(value, part)
        except (AttributeError, IndexError, TypeError):
            if optional:
                return float("nan")
            known = ", ".join(name for name in vars(message) if not name.startswith("_"))
            raise _FieldError(f"no field {source}; the message has {known}") from None
        try:
            return float(value)
        except (TypeError, ValueError):
            raise _FieldError(
                f"the field {source} is a {type(value).__name__}, no number"
            ) from None

    return get


def _sample(topic: _Topic, message: Any, received: int) -> None:
    """Append what a message says."""
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    topic.stamps.append(0 if stamp is None else stamp.sec * 10**9 + stamp.nanosec)
    topic.received.append(received)
    topic.values.extend([get(message) for get in topic.read])


def _times(
    path: Path, layout: Layout, topics: dict[str, _Topic], notes: list[str]
) -> dict[str, npt.NDArray[np.int64]]:
    """Return the stamps of each topic's messages, ns since 1970."""
    times, late = {}, {}
    for name, topic in topics.items():
        stamps = np.array(topic.stamps, dtype=np.int64)
        received = np.array(topic.received, dtype=np.int64)
        own = layout.stamp == "header" and bool(stamps.any())
        if own:
            # a clock that begins with the recording says 0 at its first row
            missing = int(((stamps == 0) & (received != 0)).sum())
            if missing:
                raise LogError(
                    f"{path}: topic {name}: {missing} of {len(stamps)} messages "
                    'have no header stamp; take the time of receipt: stamp = "receive" in '
                    f"{layout.source}"
                )
            late[name] = float(np.median(received - stamps)) * 1e-9
        times[name] = stamps if own else received
        back = -float(np.diff(times[name]).min(initial=0)) * 1e-9
        if back > _LATE:
            raise LogError(
                f"{path}: topic {name}: the time goes back by {back:.3g} s; a clock was set while "
                'recording. Try stamp = "receive" in '
                f"{layout.source}, or read the piece before with stop_s"
            )
        if back > 0.0:
            count = int((np.diff(times[name]) < 0).sum())
            notes.append(f"{name}: {count} message(s) came late, put in order of their stamps")
        notes.append(f"{name}: time of {'the header' if own else 'receipt'}")
    worst = max(late.values(), key=abs, default=0.0)
    if abs(worst) > _LATE and len(late) < len(topics):
        raise LogError(
            f"{path}: header stamps and times of receipt differ by {worst:.3g} s, and not every "
            f'topic has a header; take stamp = "receive" in {layout.source}'
        )
    return times


def _united(path: Path, layout: Layout, topics: dict[str, _Topic]) -> Table:
    """Return the rows of all topics together."""
    notes: list[str] = []
    topics = {name: topic for name, topic in topics.items() if len(topic.stamps)}
    times = _times(path, layout, topics, notes)
    stamps = np.unique(np.concatenate([*times.values(), np.zeros(0, np.int64)]))
    rows = len(stamps)
    data: dict[str, Array] = {TIME: (stamps - stamps[:1]) * 1e-9}
    plane = None
    for name, topic in topics.items():
        at = np.searchsorted(stamps, times[name])
        double = len(at) - len(np.unique(at))
        if double:
            notes.append(f"{name}: {double} message(s) with the stamp of another, the last kept")
        values = np.array(topic.values).reshape(len(at), len(topic.fields))
        for entry in layout.entries:
            if entry.topic == name:
                given = [values[:, topic.fields.index(source)] for source in entry.sources]
                plane = entry.plane(given) if entry.plane is not None else plane
                made = entry.columns(given)
                for key, column in made.items():
                    data[key] = np.full(rows, np.nan)
                    data[key][at] = column
    for entry in layout.entries:
        if entry.topic and entry.topic not in topics:
            notes.append(f"{entry.topic}: no message")
            data.update({key: np.full(rows, np.nan) for key in entry.names})
        elif not entry.topic:
            data.update({k: np.full(rows, v) for k, v in entry.columns([]).items()})
    if rows:
        notes.append(f"t_s: counted from {date_of(float(stamps[0]) * 1e-9)}")
    data = commanded(data, notes)
    before = len(data[TIME])
    data = thinned(data[TIME], data, layout)
    notes += said(layout, before, len(data[TIME]))
    notes += notes_of(layout.entries)
    t = data[TIME]
    return Table(
        str(path),
        name_of(path),
        data,
        {name: name for name in data},
        lambda row: f"t = {t[row]:.6g} s",
        notes,
        plane,
        float(stamps[0]) * 1e-9 if rows else None,
    )


def commanded(data: dict[str, Array], notes: list[str]) -> dict[str, Array]:
    """Hold the commands from the row after their message on; drop the rows before the first."""
    given = [data[key] for key in COMMANDS if key in data]
    if not given or any(np.isnan(values).all() for values in given):
        return data  # reported where columns are checked
    first = max(int(np.argmin(np.isnan(values))) for values in given)
    rows = np.arange(len(data[TIME]))
    for key in COMMANDS:
        if key in data:
            last = np.maximum.accumulate(np.where(np.isnan(data[key]), 0, rows))[first:]
            # a row has the commands in force in the interval that ends at it
            data[key][first:] = data[key][np.concatenate((last[:1], last[:-1]))]
    if first:
        notes.append(f"{first} row(s) before the first command left out")
    return {key: values[first:] for key, values in data.items()}
