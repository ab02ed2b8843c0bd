"""Files are written whole or not at all, and read within limits."""

import errno
import os
from pathlib import Path

import numpy as np
import pytest

from tests.twin.agents.drawn_policy import drawn_policy
from twin import Log, Particulars, Twin
from twin.files import keep
from twin.predictors.learned.pretrained import FleetLSTM, Weights
from usv_kernel.errors import MESSAGE_MAX, UsvTwinError
from usv_kernel.files import (
    TOML_MAX,
    WriteError,
    read_json,
    read_toml,
    replacing,
    write_whole,
)


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def write_half(path):
    with replacing(path) as partial:
        partial.write_bytes(b"half")
        raise KeyError


def test_a_file_is_replaced_whole(tmp_path):
    path = tmp_path / "folder" / "a.bin"
    write_whole(path, b"old")
    with pytest.raises(KeyError):
        write_half(path)
    assert path.read_bytes() == b"old" and names(path.parent) == ["a.bin"]
    write_whole(path, b"new")
    assert path.read_bytes() == b"new" and names(path.parent) == ["a.bin"]


def test_a_link_stays_a_link_and_a_device_a_device(tmp_path):
    (tmp_path / "link").symlink_to(tmp_path / "a.bin")
    write_whole(tmp_path / "a.bin", b"old")
    write_whole(tmp_path / "link", b"new")
    assert (tmp_path / "link").is_symlink() and (tmp_path / "a.bin").read_bytes() == b"new"
    write_whole(Path(os.devnull), b"gone")
    assert not Path(os.devnull).is_file()


def test_a_name_that_cannot_be_written_is_an_error(tmp_path):
    (tmp_path / "file").write_bytes(b"")
    for path in (tmp_path / "file" / "below", tmp_path, tmp_path / ("x" * 300)):
        with pytest.raises(WriteError, match=r"cannot be written \(.*\); free space, or choose"):
            write_whole(path, b"1")
    assert names(tmp_path) == ["file"]


def test_a_full_disk_is_an_error_and_nothing_is_left(tmp_path, monkeypatch):
    """Every way in which the package writes files, on a disk that is full before the last byte."""
    log = Log(0.05 * np.arange(9), np.zeros((9, 10)), np.zeros((9, 4)))
    policy, weights = drawn_policy(), Weights.read(FleetLSTM.file, "lstm")
    boat = Particulars(
        name="b", length=6.0, beam=2.0, draft=0.5, mass=2e3, speed=5.0, shaft_speed=20.0
    )

    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    writers = {
        **{"a.csv": log.write, "a.csv.gz": log.write, "a.parquet": log.write},
        **{"a.twin": Twin(boat, "persistence").save, "a.npz": policy.save, "w.npz": weights.write},
        "a.json": lambda path: keep(path, 1, ["x"]),
    }
    for name, write in writers.items():
        with pytest.raises(UsvTwinError, match=rf"{name}: cannot be written \(No space left"):
            write(tmp_path / name)
    assert names(tmp_path) == []


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (b"a = 1\nb =", "is not valid TOML: Invalid value"),
        (b"a = " + b"[" * 3000, "nested"),
        (b"a" + b".a" * 3000 + b" = 1", "nested more than 32 deep"),
        (b"a = " + b"9" * 5000, "is not valid TOML"),
        (b"[t]\na = [1, " + b"9" * 100 + b"]", "t.a has more digits"),
        (b"a = '\xff'", "is not valid TOML"),
        (b"#" * (TOML_MAX + 1), "is longer than 1.05 MB"),
    ],
)
def test_toml_is_read_within_limits(tmp_path, text, words):
    path = tmp_path / "a.toml"
    path.write_bytes(text)
    with pytest.raises(UsvTwinError) as caught:
        read_toml(path, UsvTwinError)
    message = str(caught.value)
    assert message.startswith(f"{path}: ") and words in message and len(message) < 300


def test_json_is_read_within_limits(tmp_path):
    path = tmp_path / "a.json"
    for text, words in (
        ("[" * 100_000, "nested"),
        ('{"a": ' * 40 + "1" + "}" * 40, "nested more than 32 deep"),
        ("9" * 5000, "is not valid JSON"),
        ('{"a": ' + "9" * 400 + "}", "a has more digits"),
        ('{"a": 1', "is not valid JSON"),
    ):
        path.write_text(text)
        with pytest.raises(UsvTwinError, match=words):
            read_json(path, UsvTwinError)
    path.write_text('{"a": [1, 2.5, null, "x"]}')
    assert read_json(path, UsvTwinError) == {"a": [1, 2.5, None, "x"]}


def test_a_message_that_quotes_a_file_is_short():
    message = str(UsvTwinError(f"a.toml: {'9' * 100_000}: correct it"))
    assert len(message) <= MESSAGE_MAX
    assert message.startswith("a.toml: 999") and message.endswith("999: correct it")
