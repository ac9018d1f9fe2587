"""What a user of a view may ask a robot for. What is outside of it is not done; the run goes on."""

from __future__ import annotations

import numpy as np

from wbmpc.arrays import Array
from wbmpc.checks import numbers
from wbmpc.errors import InputError

#: Goals are at most this far from the base in the plane [m], and between these heights [m] above the floor.
REACH, HEIGHTS = 5.0, (-0.5, 3.0)
#: The largest push [N] and how long it may last [s]; factors of weights; speeds of a run against the clock.
PUSH, PUSH_TIME, FACTORS, SPEEDS = 1000.0, 2.0, (1e-3, 1e3), (0.05, 1.0)
#: Edges of a cube that a user puts in the robot's way [m].
EDGES = (0.05, 2.0)
#: How far a quaternion's norm may be from 1.
_UNIT = 1e-3


def pose(goal: Array, base: Array) -> Array:
    """A pose (7) of the end effector, its height above the floor, with its quaternion at length 1; ``base``: where the robot is
    (x, y, …) [m]. Raises :class:`InputError` for one that is not finite, no pose or too far away."""
    return _pose("goal of the end effector", goal, base)


def box(values: Array, base: Array) -> tuple[Array, float]:
    """Pose (7) of a cube, its height above the floor, and its edge [m], 0 of one that is taken away; ``values`` (8). Raises
    :class:`InputError` as :func:`pose` does."""
    edge = float(numbers("box", "pose and edge", values, 8)[7])
    if edge == 0.0:
        return np.array(values[:7]), 0.0
    within("box: edge [m]", edge, *EDGES)
    return _pose("box", values[:7], base), edge


def _pose(who: str, pose: Array, base: Array) -> Array:
    value = numbers(who, "pose", pose, 7)
    norm = float(np.linalg.norm(value[3:]))
    if abs(norm - 1.0) > _UNIT:
        raise InputError(f"{who}: the quaternion must have the length 1, got {norm:.3g}")
    _near(who, value, base)
    within(f"{who}: height [m]", float(value[2]), *HEIGHTS)
    return np.concatenate([value[:3], value[3:] / norm])


def planar(goal: Array, base: Array) -> Array:
    """A pose (x, y, yaw) of the base near where it is; raises :class:`InputError` as :func:`pose` does."""
    value = numbers("goal of the base", "pose", goal, 3)
    _near("goal of the base", value, base)
    return value


def _near(who: str, value: Array, base: Array) -> None:
    distance = float(np.linalg.norm(value[:2] - base[:2]))
    if distance > REACH:
        raise InputError(f"{who}: must be at most {REACH:g} m from the robot, got {distance:.3g} m")


def push(force: Array, seconds: Array) -> tuple[Array, float]:
    """A force (3) [N] and its duration [s]; raises :class:`InputError` for what is not finite or too large."""
    value = numbers("push", "force", force, 3)
    within("push: force [N]", float(np.linalg.norm(value)), 0.0, PUSH)
    within("push: time [s]", float(seconds), 0.0, PUSH_TIME)
    return value, float(seconds)


def factors(values: Array) -> Array:
    """Factors (n) of weights; raises :class:`InputError` for what is not finite or outside of :data:`FACTORS`."""
    for value in numbers("weights", "factors", values, len(values)):
        within("weights: factor", float(value), *FACTORS)
    return values


def choice(who: str, index: Array, count: int) -> int:
    """One of ``count`` choices by its number; raises :class:`InputError` for another."""
    value = float(index)
    if value not in range(count):
        raise InputError(f"{who}: must be a whole number from 0 to {count - 1}, got {value:g}")
    return int(value)


def within(who: str, value: float, low: float, high: float) -> None:
    """Raise :class:`InputError` for a number outside of [low, high], or none."""
    if not low * (1.0 - 1e-9) - 1e-9 <= value <= high * (1.0 + 1e-9) + 1e-9:
        raise InputError(f"{who}: must be {low:g} to {high:g}, got {value:g}")
