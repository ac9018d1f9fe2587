"""Between numbers of this library and messages (REP 103: SI, x ahead, z up). The bus has quaternions as x, y, z, w."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from wbmpc import lie
from wbmpc.arrays import Array
from wbmpc.checks import unit_quaternions
from wbmpc.errors import InputError, NotFinite, described, printable

#: Of a message about something from the bus.
LONGEST = 300
#: No position [m, rad], speed or force is farther from 0, nor the turns of a wheel: what follows would overflow.
LARGEST_NUMBER = 1e7
#: A quaternion's length that is off by less is rounding; what is off by more is asked for one by one.
_ROUNDING = 5e-3
#: The first and the last second that a stamp can say.
_FIRST, _LAST = -(2**31), 2**31 - 1


def error_message(error: Exception) -> str:
    """What a goal or a message was rejected for: our own message, or what went wrong by its kind."""
    return one_line(str(error) if isinstance(error, InputError) else described(error))


def one_line(message: str) -> str:
    """One line of at most :data:`LONGEST` characters of what may quote others on the bus: nobody writes lines of ours."""
    message = printable(message)
    middle = len(message) - LONGEST
    if middle > 0:  # the end says what is valid
        message = f"{message[: LONGEST // 2]} [{middle} characters] {message[-LONGEST // 2 :]}"
    return message


def stamp(seconds: float) -> dict[str, int]:
    """A time [s] as a stamp, or the nearest one that there is: a clock on the bus may say any time."""
    nanoseconds = round(min(max(seconds, _FIRST), _LAST) * 1e9)
    return {"sec": nanoseconds // 10**9, "nanosec": nanoseconds % 10**9}


def seconds(time: Any) -> float:
    """A stamp or a duration as seconds."""
    return float(time.sec) + 1e-9 * float(time.nanosec)


def header(time: float, frame: str) -> dict[str, Any]:
    return {"stamp": stamp(time), "frame_id": frame}


def vector(values: Array) -> dict[str, float]:
    """Three numbers as x, y, z."""
    return dict(zip(("x", "y", "z"), map(float, values), strict=True))


def quaternion(values: Array) -> dict[str, float]:
    """A quaternion of this library."""
    return dict(zip(lie.PARTS, map(float, values), strict=True))


def pose(position: Array, orientation: Array) -> dict[str, Any]:
    """A pose: position (3) [m], quaternion (4) of this library."""
    return {"position": vector(position), "orientation": quaternion(orientation)}


def upright(base: Array, height: float = 0.0) -> tuple[Array, Array]:
    """Position and quaternion of a planar pose (x, y, yaw)."""
    return np.array([base[0], base[1], height]), np.asarray(lie.quaternion_about((0, 0, 1), base[2]))


def read_vector(v: Any, what: str) -> Array:
    """x, y, z of a message, checked as by :func:`check_numbers`."""
    return check_numbers(np.array([v.x, v.y, v.z], float), what)


def read_pose(p: Any, what: str) -> tuple[Array, Array]:
    """Position (3) [m] and unit quaternion (4) of this library."""
    q = check_numbers(np.array([getattr(p.orientation, n) for n in lie.PARTS], float), what)
    return read_vector(p.position, what), unit_quaternions(what, q)


def read_poses(poses: Sequence[Any], what: str) -> tuple[Array, Array]:
    """Positions (n, 3) [m] and unit quaternions (n, 4) of n poses: :func:`read_pose` of each, but all at once, for a path may have
    thousands. An error is that of the first one that is wrong; ``what`` may name its number ({})."""
    vectors = [
        (p.position.x, p.position.y, p.position.z, *(getattr(p.orientation, n) for n in lie.PARTS)) for p in poses
    ]
    values = np.array(vectors, float).reshape(-1, 7)
    with np.errstate(all="ignore"):
        near = np.abs(np.linalg.norm(values[:, 3:], axis=1) - 1.0) <= _ROUNDING
    for k in np.flatnonzero(~(near & (np.abs(values) <= LARGEST_NUMBER).all(axis=1))):
        read_pose(poses[int(k)], what.format(k))
    return values[:, :3], unit_quaternions(what, values[:, 3:])


def planar(position: Array, orientation: Array) -> Array:
    """(x, y, yaw) of a pose."""
    yaw = lie.rotation_to_euler_zyx(lie.quaternion_to_rotation(orientation))[0]
    return np.array([position[0], position[1], yaw])


def planar_path(positions: Array, orientations: Array) -> Array:
    """(x, y, yaw) (n, 3) of poses: positions (n, 3), quaternions (n, 4)."""
    turned = lie.quaternion_to_rotation(np.transpose(orientations))
    return np.column_stack([positions[:, :2], np.arctan2(turned[1, 0], turned[0, 0])])


def nearest_angle(yaw: float, to: float) -> float:
    """The angle [rad] of the same direction that is nearest to another one."""
    return to + (yaw - to + np.pi) % (2.0 * np.pi) - np.pi


def path(time: float, frame: str, positions: Array, orientations: Array, times: Sequence[float]) -> dict[str, Any]:
    """A nav_msgs/Path of positions (n, 3), quaternions (n, 4) at times (n) [s]."""
    poses = [
        {"header": header(t, frame), "pose": pose(p, q)} for t, p, q in zip(times, positions, orientations, strict=True)
    ]
    return {"header": header(time, frame), "poses": poses}


def status(level: int, name: str, message: str, hardware: str, values: Mapping[str, Any]) -> dict[str, Any]:
    """One entry of /diagnostics: level 0 is well, 1 a warning, 2 an error."""
    pairs = [{"key": k, "value": str(v)} for k, v in values.items()]
    return {"level": level, "name": name, "message": message, "hardware_id": hardware, "values": pairs}


def check_numbers(values: Array, what: str) -> Array:
    """Raise :class:`NotFinite`, or :class:`InputError` for numbers beyond :data:`LARGEST_NUMBER`; returns them."""
    if not np.isfinite(values).all():
        raise NotFinite(f"{what}: a number is not finite")
    if np.abs(values).max(initial=0.0) > LARGEST_NUMBER:
        raise InputError(f"{what}: a number is too large; valid: -{LARGEST_NUMBER:g} to {LARGEST_NUMBER:g}")
    return values
