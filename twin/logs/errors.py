"""The error of logs."""

from __future__ import annotations

from usv_kernel.errors import UsvTwinError

__all__ = ["LogError"]


class LogError(UsvTwinError):
    """A log that cannot be used; the message names the file, the place and the remedy."""
