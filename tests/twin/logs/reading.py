"""Logs that are refused, for tests."""

from __future__ import annotations

from pathlib import Path

import pytest

from twin.logs.errors import LogError
from twin.logs.log import Log


def refused(path: Path) -> str:
    with pytest.raises(LogError) as caught:
        Log.read(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    return message
