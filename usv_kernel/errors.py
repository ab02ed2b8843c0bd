"""Base class of the errors that a user can correct."""

__all__ = ["ArgumentError", "UsvTwinError"]


class UsvTwinError(ValueError):
    """Invalid input; the message names the value, its place and the remedy."""


class ArgumentError(UsvTwinError, TypeError):
    """An argument of the wrong kind, or a name that no argument has."""
