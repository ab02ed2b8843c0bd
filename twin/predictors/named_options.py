"""Options that are part of a predictor's name: ``dsw-ukf:window=off,adapt=literal``.

Behind the name and a colon stand options as ``key=value``, separated by commas. A named preset of
the class may stand before them, as in ``dsw-ukf:printed,window=off``; what follows overrides it.
In a list of predictors a comma separates both predictors and options. There a piece that is a
``key=value`` belongs to the predictor before it: ``ukf,dsw-ukf:window=off,adapt=literal,lstm`` is
three predictors.
"""

from __future__ import annotations

import contextlib
import inspect
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any

from usv_kernel.errors import UsvTwinError, check_options, did_you_mean

__all__ = [
    "OptionTextError",
    "parse_options",
    "split_name",
    "split_names",
]

WORDS = {"true": True, "on": True, "yes": True, "false": False, "off": False, "no": False}
"""Words for a truth value."""

TYPES: dict[str, tuple[Callable[[str], Any], str]] = {
    "bool": (WORDS.__getitem__, f"one of {', '.join(WORDS)}"),
    "int": (int, "a whole number"),
    "float": (float, "a number"),
    "str": (str, "a text"),
}
"""How the text of a value of each type is read, and what it must be."""

_OPTION = re.compile(r"\s*[A-Za-z_]\w*\s*=")


class OptionTextError(UsvTwinError):
    """Options in a name that cannot be read; the message says what can."""


def split_name(name: str, known: Collection[str]) -> tuple[str, str | None]:
    """Return a name without its options, and their text; None where there are none.

    Parameters
    ----------
    name : str
        ``NAME``, ``NAME:OPTIONS``, ``module:Class`` or ``module:Class:OPTIONS``.
    known : collection of str
        Names without a module.
    """
    first, mark, rest = name.partition(":")
    # an option behind the first colon: the name is misspelled, and no module
    if not mark or first in known or _OPTION.match(rest):
        return first.strip(), rest if mark else None
    attribute, mark, options = rest.partition(":")
    return f"{first}:{attribute}", options if mark else None


def split_names(text: str) -> list[str]:
    """Return the predictors of a comma-separated list, each with its options.

    Parameters
    ----------
    text : str
        Such as ``"ukf,dsw-ukf:window=off,adapt=literal"``. A piece that is a ``key=value``
        belongs to the options before it.

    Raises
    ------
    OptionTextError
        An option without a predictor before it.
    """
    names: list[str] = []
    for piece in filter(None, map(str.strip, text.split(","))):
        if not _OPTION.match(piece):
            names.append(piece)
        elif names and ":" in names[-1]:
            names[-1] += f",{piece}"
        else:
            before = names[-1] if names else "PREDICTOR"
            raise OptionTextError(
                f"{piece}: an option follows its predictor and a colon; write {before}:{piece}"
            )
    return names


def parse_options(
    name: str,
    text: str,
    presets: Mapping[str, Mapping[str, Any]],
    arguments: Sequence[inspect.Parameter],
) -> dict[str, Any]:
    """Return options by name, each with the type that the class wants.

    Parameters
    ----------
    name : str
        Of the predictor, for messages.
    text : str
        ``preset,key=value,...`` or ``key=value,...``.
    presets : mapping
        Named options of the class.
    arguments : sequence of inspect.Parameter
        Options of its constructor.

    Raises
    ------
    OptionTextError
        No such preset, or a value of the wrong type; names what is legal.
    ArgumentError
        An option that the predictor does not have; lists those that it has.
    """
    known = {one.name: one for one in arguments if one.name != "seed"}
    takes_any = any(one.kind is one.VAR_KEYWORD for one in arguments)
    first, *rest = (piece.strip() for piece in text.split(","))
    options = dict(presets.get(first, {}))
    given: list[str] = []
    for piece in rest if first in presets else (first, *rest):
        key, mark, value = (part.strip() for part in piece.partition("="))
        if not mark:
            own = ", ".join(presets)
            raise OptionTextError(
                f"predictor {name!r}: {key!r} is no option as key=value"
                f"{did_you_mean(key, presets)}; its options: {', '.join(known) or 'none'}; "
                + (f"its presets, which stand first: {own}" if presets else "it has no preset")
            )
        if key in given:
            raise OptionTextError(f"predictor {name!r}: {key} is given twice; leave one out")
        given.append(key)
        if not takes_any:
            check_options(f"predictor {name!r}", [key], list(known))
        where = f"predictor {name!r}: {key} = {value!r}"
        options[key] = _value(where, value, known.get(key))
    return options


def _value(where: str, text: str, option: inspect.Parameter | None) -> Any:
    """Return the value of an option by its annotation, else by the type of its default.

    A value of an unknown type is the first of a number and a text that it can be.
    """
    hint = set() if option is None else set(re.findall(r"\w+", str(option.annotation)))
    if "None" in hint and text.lower() == "none":
        return None
    default = "" if option is None else type(option.default).__name__
    kinds = [kind for kind in TYPES if kind in hint] or [kind for kind in TYPES if kind == default]
    if option is not None and option.default is None and not kinds:
        raise OptionTextError(
            f"{where}: a value of the type {option.annotation} has no text; hand it to "
            "make_predictor or Twin"
        )
    kinds = kinds or ["int", "float", "str"]
    for kind in kinds:
        with contextlib.suppress(KeyError, ValueError):
            return TYPES[kind][0](text.lower() if kind == "bool" else text)
    raise OptionTextError(f"{where} must be {' or '.join(TYPES[kind][1] for kind in kinds)}")
