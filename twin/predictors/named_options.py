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
import math
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

BOOLS = {"true": True, "on": True, "yes": True, "false": False, "off": False, "no": False}
"""Words for a truth value."""

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
    options: dict[str, Any] = {}
    given: list[str] = []
    for k, piece in enumerate(text.split(",")):
        key, mark, value = (part.strip() for part in piece.partition("="))
        if not mark:
            if k > 0 or key not in presets:
                raise OptionTextError(_no_preset(name, key, presets, list(known)))
            options |= presets[key]
            continue
        if key in given:
            raise OptionTextError(f"predictor {name!r}: {key} is given twice; leave one out")
        given.append(key)
        if not takes_any:
            check_options(f"predictor {name!r}", [key], list(known))
        where = f"predictor {name!r}: {key} = {value!r}"
        options[key] = _value(where, value, known.get(key))
    return options


def _no_preset(
    name: str, found: str, presets: Mapping[str, Mapping[str, Any]], options: Sequence[str]
) -> str:
    """Return what to say of a piece that is neither ``key=value`` nor a preset in first place."""
    own = f"its presets, which stand first: {', '.join(presets)}" if presets else "it has no preset"
    return (
        f"predictor {name!r}: {found!r} is no option as key=value{did_you_mean(found, presets)}; "
        f"its options: {', '.join(options) or 'none'}; {own}"
    )


def _value(where: str, text: str, option: inspect.Parameter | None) -> Any:
    """Return the value of an option; its default or its annotation says of which type."""
    default = inspect.Parameter.empty if option is None else option.default
    hint = "" if option is None or option.annotation is option.empty else str(option.annotation)
    if text.lower() == "none" and (default is None or "None" in hint):
        return None
    words = set(re.findall(r"\w+", hint)) - {"None", "Optional", "Union", "typing", "class"}
    kinds = [kind for kind in READERS if kind.__name__ in words]
    if not kinds or len(kinds) < len(words):  # numbers, of which one stands for an array, say
        kinds = [kind for kind in READERS if type(default) is kind]
    if words and not kinds:
        raise OptionTextError(
            f"{where}: a value of the type {hint} has no text; hand it to make_predictor or Twin"
        )
    return _first_that_reads(where, text, kinds or list(READERS))


def _bool(where: str, text: str) -> bool:
    if text.lower() not in BOOLS:
        raise OptionTextError(f"{where} must be one of {', '.join(BOOLS)}")
    return BOOLS[text.lower()]


def _int(where: str, text: str) -> int:
    try:
        return int(text)
    except ValueError:
        raise OptionTextError(f"{where} must be a whole number") from None


def _float(where: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if math.isnan(value):
        raise OptionTextError(f"{where} must be a number")
    return value


def _str(where: str, text: str) -> str:
    if not text:
        raise OptionTextError(f"{where}: is empty; write a value behind the =")
    return text


READERS: dict[type, Callable[[str, str], Any]] = {
    bool: _bool,
    int: _int,
    float: _float,
    str: _str,
}
"""How the text of a value of each type is read."""


def _first_that_reads(where: str, text: str, kinds: Sequence[type]) -> Any:
    """Return a text as the first type that it can be; the last one says why it cannot."""
    for kind in kinds[:-1]:
        with contextlib.suppress(OptionTextError):
            return READERS[kind](where, text)
    return READERS[kinds[-1]](where, text)
