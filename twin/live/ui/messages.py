"""What a browser may send to a view: presses of buttons, values of controls, and its camera."""

from __future__ import annotations

import math
from typing import Any

import msgspec

from usv_kernel.errors import UsvTwinError

__all__ = [
    "RefusedError",
    "checked",
]

SLACK = 1e-6
"""Part of a range by which browsers round past its ends; of whole numbers they do not."""

LONGEST = 120
"""So many characters of a value are repeated in a message."""

Triple = tuple[float, float, float]


class RefusedError(UsvTwinError):
    """A message that no control of the page sends; the text says why."""


class _Message(msgspec.Struct, tag_field="type", forbid_unknown_fields=True):
    """A message by the name of its type in viser."""


class _Value(msgspec.Struct, forbid_unknown_fields=True):
    """Of the properties of a control, the only one that a browser may change."""

    value: bool | float | str


class _Update(_Message, tag="GuiUpdateMessage"):
    """A new value of a control."""

    uuid: str
    updates: _Value


class _Trigger(_Message, tag="CommandTriggerMessage"):
    """A key that was pressed."""

    uuid: str


class _Camera(_Message, tag="ViewerCameraMessage"):
    """Where the browser looks from."""

    wxyz: tuple[float, float, float, float]
    position: Triple
    fov: float
    near: float
    far: float
    image_height: int
    image_width: int
    look_at: Triple
    up_direction: Triple


_decode = msgspec.msgpack.Decoder(_Update | _Trigger | _Camera).decode


def checked(gui: Any, raw: bytes | str) -> bytes:
    """Return a message of a browser in viser's format, after it has been checked.

    Parameters
    ----------
    gui : viser.GuiApi
        The page's controls.
    raw : bytes or str
        What came.

    Raises
    ------
    RefusedError
        For anything but a value that a control offers, a key, or a finite pose of the camera.
    """
    try:
        message = _decode(raw) if isinstance(raw, bytes) else None
    except (msgspec.MsgspecError, RecursionError, ValueError):
        message = None
    if isinstance(message, _Update):
        message.updates.value = _value(gui, message.uuid, message.updates.value)
    elif isinstance(message, _Camera):
        poses = (*message.wxyz, *message.position, *message.look_at, *message.up_direction)
        if not all(map(math.isfinite, (*poses, message.fov, message.near, message.far))):
            raise RefusedError("a camera that is nowhere")
    elif message is None:
        raise RefusedError("a message that no control of this page sends")
    return msgspec.msgpack.encode(message)


def _value(gui: Any, uuid: str, value: bool | float | str) -> bool | float | str:
    """Return a new value of a control, which must be one that it offers."""
    import viser

    control = gui._gui_input_handle_from_uuid.get(uuid)
    if control is None or control.disabled:
        raise RefusedError("a value of a control that is not there")
    if isinstance(control, viser.GuiButtonHandle):
        fits = value is True
    elif isinstance(control, viser.GuiDropdownHandle):
        fits = value in control.options
    elif isinstance(control, (viser.GuiSliderHandle, viser.GuiNumberHandle)):
        fits = _is_within(control, value)
    else:
        fits = False
    if not fits:
        raise RefusedError(f"{control.label}: {str(value)[:LONGEST]!r} is not on offer")
    return value


def _is_within(control: Any, value: bool | float | str) -> bool:
    """Return whether a value is a number of a control's kind and in its range."""
    if isinstance(value, (bool, str)) or not math.isfinite(value):
        return False
    low = -math.inf if control.min is None else control.min
    high = math.inf if control.max is None else control.max
    if isinstance(control.value, int):
        return value == int(value) and bool(low <= value <= high)
    slack = SLACK * (high - low) if math.isfinite(high - low) else 0.0
    return bool(low - slack <= value <= high + slack)
