"""An empty working directory, and one with a simulated run."""

from __future__ import annotations

import pytest

from tests.twin.cli.command import run


@pytest.fixture
def empty(tmp_path, monkeypatch):
    """An empty working directory."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="session")
def folder(tmp_path_factory):
    """A folder with a zigzag of 40 s that loses GPS, and its particulars."""
    path = tmp_path_factory.mktemp("cli")
    options = ("--duration", "40", "--seed", "3", "--faults", "gps5@20")
    run("simulate", "zigzag", *options, "--out", path / "run.csv")
    return path
