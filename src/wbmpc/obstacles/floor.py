"""What of an arm can run into the floor: boxes around its moving parts."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from weakref import WeakSet

import casadi as ca
import numpy as np

from wbmpc.arrays import Array
from wbmpc.errors import InputError
from wbmpc.model.kinematics import constant
from wbmpc.model.robot import RobotModel
from wbmpc.model.tree import Frame
from wbmpc.obstacles.geometry import RobotGeometry, has_shapes, path_of, rigid_link, robot_geometry
from wbmpc.obstacles.pairs import HOME_SHARE, draw_states

_LOG = logging.getLogger("wbmpc")
_WARNED: WeakSet[RobotModel] = WeakSet()
#: States that are drawn to see what comes near the floor, and edges of boxes below which they are rounded, as a share.
SAMPLES, ROUNDED = 400, 0.01


@dataclass(frozen=True)
class FloorBox:
    """A box of half sides ``half`` (3) [m] about ``center`` (3) [m] in the axes of a link's frame ``name``, which stays ``margin`` [m] above
    the floor."""

    name: str
    frame: Frame
    center: Array
    half: Array
    margin: float

    def height(self, position: ca.SX, rotation: ca.SX) -> ca.SX:
        """Of its lowest point [m], at most, where the frame's position (3) and rotation (3, 3) are these."""
        up = rotation[2, :].T
        reach = ca.sqrt(up**2 + ROUNDED**2)
        return position[2] + ca.dot(up, constant(self.center)) - ca.dot(constant(self.half), reach)


def floor_boxes(robot: RobotModel) -> tuple[FloorBox, ...]:
    """Of the arm's parts that come nearer to the floor than they may in random states. What is low at home keeps
    :data:`~wbmpc.obstacles.pairs.HOME_SHARE` of its height there, if that is less than ``collision.margin``; what is in the floor
    at home keeps nothing. None of a robot without shapes, nor where the robot file says that there is no floor; nor, with a warning, where
    shapes cannot be read: plans need none."""
    margin = robot.description.collision.margin
    try:
        if not robot.description.collision.floor or not has_shapes(robot):
            return ()
    except InputError as error:
        if robot not in _WARNED:
            _WARNED.add(robot)
            _LOG.warning("nothing keeps the arm of '%s' off the floor: %s", robot.description.name, error)
        return ()
    geometry = robot_geometry(robot)
    arm = {robot.tree.joint(n) for n in robot.description.arm.joints}
    found: dict[int, FloorBox] = {}
    for name in geometry.frames:
        link = rigid_link(robot, name)
        if link not in found and not arm.isdisjoint(path_of(robot, link)):
            found[link] = _box(geometry, name)
    boxes = list(found.values())
    if not boxes:
        return ()
    at = heights(robot, boxes, draw_states(robot, SAMPLES))
    kept = np.minimum(margin, HOME_SHARE * at[0])
    return tuple(
        FloorBox(b.name, b.frame, b.center, b.half, float(m))
        for b, m, low in zip(boxes, kept, at.min(axis=0), strict=True)
        if m > 0.0 and low < m
    )


def heights(robot: RobotModel, boxes: list[FloorBox], states: Array) -> Array:
    """Of the boxes above the floor (n, boxes) [m] at states (n, nx)."""
    x = ca.SX.sym("x", robot.state.size)
    chain = robot.base.chain(x)
    rows = [b.height(*chain.frame_place(b.frame)) - robot.base.ground for b in boxes]
    return np.array(ca.Function("heights", [x], [ca.vertcat(*rows)])(states.T)).T


def _box(geometry: RobotGeometry, name: str) -> FloorBox:
    """Around all shapes that are fixed to a frame, in its axes."""
    robot, axes = geometry.robot, np.concatenate([np.eye(3), -np.eye(3)])
    at, turns = (v[0] for v in geometry.kinematics(robot.home[None]))
    own = geometry.frames.index(name)
    ends = []
    for shape in geometry.fixed_to(name):
        solid, frame = geometry.shapes[shape].solid, geometry.frame_of[shape]
        turn = turns[own].T @ turns[frame] @ solid.rotation
        center = turns[own].T @ (at[frame] + turns[frame] @ solid.position - at[own])
        ends.append(center + solid.support(axes @ turn) @ turn.T)
    points = np.concatenate(ends)
    low, high = points.min(axis=0), points.max(axis=0)
    return FloorBox(name, robot.tree.frames[name], 0.5 * (low + high), 0.5 * (high - low), 0.0)
