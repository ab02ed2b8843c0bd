"""Base class of the errors that a user can correct."""

__all__ = ["UsvTwinError"]


class UsvTwinError(ValueError):
    """Invalid input; the message names the value, its place and the remedy."""
