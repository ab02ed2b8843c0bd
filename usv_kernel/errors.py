"""The base of all errors that a user can mend."""

__all__ = ["UsvTwinError"]


class UsvTwinError(ValueError):
    """Wrong input; the message names the value, where it stands, and the remedy."""
