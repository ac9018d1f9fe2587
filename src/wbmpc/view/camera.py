"""Where a camera stands at first: near enough for the robot's size, and where nothing hides it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from wbmpc import lie
from wbmpc.arrays import Array
from wbmpc.simulation.scene import Scene, Shape

#: From a robot of 1.4 m [m]: from its front left.
_PLACE = np.array([1.9, 2.3, 1.5])
#: What is farther away from the base [m] is not considered.
_AROUND = 1.2


def camera_offset(poses: Array, scene: Scene) -> Array:
    """Where a browser's camera stands at first, from the robot (3) [m]: the farther away, the larger it is. ``poses`` (n, 7)."""
    robot = poses[scene.index, :3]
    place = _PLACE * float(np.clip(np.ptp(near(poses, scene), axis=0).max() / 1.4, 0.4, 1.5))
    around: list[Array] = [place * [x, y, 1.0] for x, y in ((1, 1), (-1, 1), (1, -1), (-1, -1))]
    return around[clearest(scene, poses, [robot + offset for offset in around])]


def near(poses: Array, scene: Scene) -> Array:
    """Positions (m, 3) [m] of the bodies around the robot. Bodies that are not there yet lie far below the floor."""
    places = poses[:, :3]
    return places[np.linalg.norm(places - places[scene.index], axis=1) < 2.0]


def clearest(scene: Scene, poses: Array, eyes: Sequence[Array]) -> int:
    """Which of the places ``eyes`` (each 3) [m] sees most of the robot's bodies; the first of equals."""
    return int(np.argmin(hidden(scene, poses, eyes)))


def hidden(scene: Scene, poses: Array, eyes: Sequence[Array]) -> list[int]:
    """How many of the robot's bodies the places ``eyes`` (each 3) [m] do not see past walls, doors, pillars and people."""
    robot, names = poses[scene.index, :2], [b.name for b in scene.bodies]
    roots = {"world", *(b.name for b in scene.bodies if b.parent == "world" and b.name != scene.robot)}
    boxes = [(shape, half) for shape in scene.shapes if shape.body in roots and (half := _half_size(shape)) is not None]
    others = {shape.body for shape, _ in boxes}
    seen = [
        p[:3] for name, p in zip(names, poses, strict=True)
        if name not in others and np.linalg.norm(p[:2] - robot) < _AROUND
    ]  # fmt: skip
    placed = {"world": np.array([0.0, 0, 0, 1, 0, 0, 0]), **dict(zip(names, poses, strict=True))}
    return [sum(any(_between(b, h, placed[b.body], eye, point) for b, h in boxes) for point in seen) for eye in eyes]


def _half_size(shape: Shape) -> Array | None:
    """Of the box around a shape (3) [m]; None for kinds that hide little."""
    if shape.kind == "box":
        return np.array(shape.size)[:3]
    if shape.kind in ("cylinder", "capsule"):
        radius, half_length = shape.size[:2]
        return np.array([radius, radius, half_length])
    return None


def _between(box: Shape, half: Array, body: Array, eye: Array, point: Array) -> bool:
    """Whether the straight line from ``eye`` to ``point`` goes through the box of a body at pose ``body`` (7)."""
    pose = lie.pose_compose(body, np.array(box.pose))
    turn = lie.quaternion_to_rotation(pose[3:])
    start, way = (eye - pose[:3]) @ turn, (point - eye) @ turn
    with np.errstate(divide="ignore", invalid="ignore"):
        sides = (np.array([[-1.0], [1.0]]) * half - start) / way
    enters, leaves = np.nanmax(sides.min(axis=0)), np.nanmin(sides.max(axis=0))
    return bool(0.0 <= enters <= min(leaves, 1.0))
