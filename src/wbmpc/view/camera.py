"""Where a camera stands at first: near enough for the robot's size, and where nothing hides it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from wbmpc import lie
from wbmpc.simulation.scene import Scene, Shape

Array = np.ndarray
#: From a robot of 1.4 m [m]: from its front left.
_PLACE = np.array([1.9, 2.3, 1.5])
#: What is farther away from the base [m] is not looked at.
_AROUND = 1.2


def camera_offset(poses: Array, scene: Scene) -> Array:
    """Where a browser's camera stands at first, from the robot (3) [m]: the farther away, the larger it is. ``poses`` (n, 7)."""
    robot = poses[scene.index, :3]
    near = poses[np.linalg.norm(poses[:, :2] - robot[:2], axis=1) < 2.0]
    place = _PLACE * float(np.clip(np.ptp(near[:, :3], axis=0).max() / 1.4, 0.4, 1.5))
    around: list[Array] = [place * [x, y, 1.0] for x, y in ((1, 1), (-1, 1), (1, -1), (-1, -1))]
    return around[clearest(scene, poses, [robot + offset for offset in around])]


def clearest(scene: Scene, poses: Array, eyes: Sequence[Array]) -> int:
    """Which of the places ``eyes`` (each 3) [m] sees most of the robot's bodies past boxes (walls, doors); the first of equals."""
    robot, names = poses[scene.index, :2], [b.name for b in scene.bodies]
    roots = {"world", *(b.name for b in scene.bodies if b.parent == "world" and b.name != scene.robot)}
    boxes = [shape for shape in scene.shapes if shape.kind == "box" and shape.body in roots]
    others = {shape.body for shape in boxes}
    seen = [
        p[:3] for name, p in zip(names, poses, strict=True)
        if name not in others and np.linalg.norm(p[:2] - robot) < _AROUND
    ]  # fmt: skip
    placed = {"world": np.array([0.0, 0, 0, 1, 0, 0, 0]), **dict(zip(names, poses, strict=True))}
    hidden = [sum(any(_between(b, placed[b.body], eye, point) for b in boxes) for point in seen) for eye in eyes]
    return int(np.argmin(hidden))


def _between(box: Shape, body: Array, eye: Array, point: Array) -> bool:
    """Whether the straight line from ``eye`` to ``point`` goes through a box of a body at pose ``body`` (7)."""
    pose = lie.pose_compose(body, np.array(box.pose))
    turn = lie.quaternion_to_rotation(pose[3:])
    start, way = (eye - pose[:3]) @ turn, (point - eye) @ turn
    with np.errstate(divide="ignore", invalid="ignore"):
        sides = (np.array([[-1.0], [1.0]]) * np.array(box.size)[:3] - start) / way
    enters, leaves = np.nanmax(sides.min(axis=0)), np.nanmin(sides.max(axis=0))
    return bool(0.0 <= enters <= min(leaves, 1.0))
