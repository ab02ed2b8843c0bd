"""Base class of the errors that a user can correct, and the message for a misspelled name."""

import difflib
import math
from collections.abc import Iterable, Sequence

import numpy as np

__all__ = [
    "ArgumentError",
    "BoatIndexError",
    "UsvTwinError",
    "check_number",
    "check_options",
    "check_whole",
    "did_you_mean",
    "is_finite",
]


MESSAGE_MAX = 1500
"""Longest message, characters: what a file holds may be quoted, and may be of any length."""


class UsvTwinError(ValueError):
    """Invalid input; the message names the value, its place and the remedy."""

    def __init__(self, *arguments: object) -> None:
        text = arguments[0] if arguments else ""
        if isinstance(text, str) and len(text) > MESSAGE_MAX:
            arguments = (f"{text[: MESSAGE_MAX - 500]} ... {text[-400:]}", *arguments[1:])
        super().__init__(*arguments)


class ArgumentError(UsvTwinError, TypeError):
    """An argument of the wrong kind, or a name that no argument has."""


class BoatIndexError(UsvTwinError, IndexError):
    """A number that no boat of a vector environment has."""


def did_you_mean(name: object, known: Iterable[str]) -> str:
    """Return the known name that is nearest, as ``" (did you mean 'sea'?)"``; empty if none is."""
    near = difflib.get_close_matches(str(name), list(known), n=1)
    return f" (did you mean {near[0]!r}?)" if near else ""


def check_options(owner: str, options: Iterable[str], known: Sequence[str]) -> None:
    """Refuse names of options that do not exist.

    Parameters
    ----------
    owner : str
        What has the options, as it begins the message.
    options : iterable of str
        Names that were given.
    known : sequence of str
        Names that exist.

    Raises
    ------
    ArgumentError
        Names what is unknown, the nearest match and all options.
    """
    unknown = [f"{name!r}{did_you_mean(name, known)}" for name in options if name not in known]
    if unknown:
        raise ArgumentError(
            f"{owner} has no option {', '.join(unknown)}; its options: "
            + (", ".join(known) or "none")
        )


def is_finite(value: object) -> bool:
    """Return whether something is a finite number, and no truth value."""
    if not isinstance(value, (int, float, np.number)) or isinstance(value, (bool, complex)):
        return False
    try:
        return math.isfinite(value)  # type: ignore[arg-type]
    except (OverflowError, TypeError):  # a whole number of 400 digits, a complex number
        return False


def check_number(
    name: str, value: object, low: float, high: float, error: type[UsvTwinError] = UsvTwinError
) -> None:
    """Refuse what is no number from ``low`` to ``high``; the error names value and range."""
    if not is_finite(value) or not low <= value <= high:  # type: ignore[operator]
        raise error(f"{name} = {value!r}: must be a number from {low:g} to {high:g}")


def check_whole(
    name: str, value: object, low: int, high: int, error: type[UsvTwinError] = UsvTwinError
) -> None:
    """Refuse what is no whole number from ``low`` to ``high``; the error names value and range."""
    whole = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
    if not whole or not low <= value <= high:  # type: ignore[operator]
        raise error(f"{name} = {value!r}: must be a whole number from {low} to {high}")
