"""What a browser may send to a view: messages of known kinds with numbers in their ranges. All else stops here."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeAlias

import msgspec
import viser

from wbmpc.errors import InputError

#: The largest message [bytes], and the largest coordinate [m]: what a robot may be asked for is narrower and checked by the run.
LARGEST, FARTHEST = 65_536, 1e3
#: How far a quaternion's norm may be from 1: browsers count in single precision.
_UNIT = 1e-3
#: A camera is at least this far from what it looks at, as a share of its largest coordinate, or of 1 m.
_APART = 1e-6
_Vector: TypeAlias = tuple[float, float, float]
_Quaternion: TypeAlias = tuple[float, float, float, float]


class _Frame(msgspec.Struct, tag_field="type", forbid_unknown_fields=True):
    pass


class _Gui(_Frame, tag="GuiUpdateMessage"):
    uuid: str
    updates: dict[str, bool | int | float | str]


class _Camera(_Frame, tag="ViewerCameraMessage"):
    wxyz: _Quaternion
    position: _Vector
    fov: float
    near: float
    far: float
    image_height: float
    image_width: float
    look_at: _Vector
    up_direction: _Vector


class _Moved(_Frame, tag="TransformControlsUpdateMessage"):
    name: str
    wxyz: _Quaternion
    position: _Vector
    owner: str = ""


class _Grasped(_Frame, tag="TransformControlsDragStartMessage"):
    name: str
    owner: str = ""


class _LetGo(_Frame, tag="TransformControlsDragEndMessage"):
    name: str
    owner: str = ""


_DECODER = msgspec.msgpack.Decoder(_Gui | _Camera | _Moved | _Grasped | _LetGo)
#: The input of an identifier; None if there is none.
Inputs = Callable[[str], Any]


def checked(raw: bytes | str, inputs: Inputs) -> bytes:
    """A message as the server may take it in: quaternions of length 1, nothing but an input's value changed.

    Raises :class:`InputError` that says what is wrong.
    """
    if isinstance(raw, str):
        raise InputError("a message of the page is text")
    try:
        frame = _DECODER.decode(raw)
    except (msgspec.DecodeError, RecursionError, ValueError) as error:
        raise InputError(f"a message of the page is malformed ({str(error)[:120]})") from None
    if isinstance(frame, _Gui):
        _check_input(frame, inputs(frame.uuid))
    elif isinstance(frame, _Camera):
        _check_camera(frame)
    elif isinstance(frame, _Moved):
        _finite("the position of the goal", *frame.position, maximum=FARTHEST)
        frame.wxyz = _unit("the orientation of the goal", frame.wxyz)
    return msgspec.msgpack.encode(frame)


def _check_camera(frame: _Camera) -> None:
    size = (frame.fov, frame.near, frame.far, frame.image_height, frame.image_width)
    _finite("the camera", *frame.position, *frame.look_at, *frame.up_direction, *size, maximum=1e9)
    frame.wxyz = _unit("the camera", frame.wxyz)
    scale = max(1.0, *(abs(v) for v in (*frame.position, *frame.look_at)))
    if not math.dist(frame.position, frame.look_at) >= _APART * scale:
        raise InputError("the camera: position and target are the same point")
    if not math.hypot(*frame.up_direction) >= _APART:
        raise InputError("the camera: its upward direction has the length 0")


def _finite(what: str, *values: float, maximum: float) -> None:
    bad = next((v for v in values if not abs(v) <= maximum), None)
    if bad is not None:
        raise InputError(f"{what}: numbers must be finite and at most {maximum:g}, got {bad:g}")


def _unit(what: str, wxyz: _Quaternion) -> _Quaternion:
    norm = math.sqrt(sum(min(abs(v), 1e9) ** 2 for v in wxyz))
    if not abs(norm - 1.0) <= _UNIT:
        raise InputError(f"{what}: a quaternion must have the length 1, got {norm:g}")
    w, x, y, z = (v / norm for v in wxyz)
    return w, x, y, z


def _check_input(frame: _Gui, handle: Any) -> None:
    if handle is None:
        raise InputError("a message of the page is for a control that there is not")
    if set(frame.updates) != {"value"}:
        raise InputError("a message of the page changes what is not the value of a control")
    value, label = frame.updates["value"], getattr(handle, "label", "control")
    if isinstance(handle, viser.GuiSliderHandle):
        low, high = float(handle.min), float(handle.max)
        if isinstance(value, bool | str) or not low - 1e-9 <= value <= high + 1e-9:
            raise InputError(f"{label}: must be {low:g} to {high:g}, got {str(value)[:40]}")
    elif isinstance(handle, viser.GuiButtonGroupHandle):
        if value not in handle.options:
            raise InputError(f"{label}: must be one of {', '.join(handle.options)}, got {str(value)[:40]}")
    elif isinstance(handle, viser.GuiCheckboxHandle | viser.GuiButtonHandle):
        if not isinstance(value, bool):
            raise InputError(f"{label}: must be true or false, got {str(value)[:40]}")
    else:
        raise InputError("a message of the page changes what is read-only")
