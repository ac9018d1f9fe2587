"""The floor of `swerve-drive`: a door, bumps and cables."""

from __future__ import annotations

import mujoco
import numpy as np

from wbmpc.bases.swerve.model import swerve_base
from wbmpc.model.robot import RobotModel
from wbmpc.simulation.contacts import GROUND, OBSTACLE

#: The door [m]: where it is, its width. Half widths [m] of the body and of a leg with its wheel (for the clearance).
DOOR, DOOR_WIDTH, BODY, LEG_HALF = 3.0, 0.90, (0.451, 0.400), 0.045
#: Half lengths [m] of the posts that are drawn beside the gap.
POST, POST_COLOR = (0.03, 0.05, 1.0), (0.55, 0.40, 0.28, 1.0)
#: Bumps (x, y) [m] of 15 mm and cables (x) of 10 mm radius [m].
BUMPS = ((6.0, 0.6), (9.5, 0.5), (10.5, -0.5), (11.5, 0.2), (12.5, -0.6))
BUMP_HEIGHT, BUMP_RADIUS, CABLES, CABLE_RADIUS = 0.015, 0.30, (9.0, 12.0), 0.010


def terrain(spec: mujoco.MjSpec) -> None:
    """Bumps and cables on the floor, and the door's posts."""
    uneven_floor(spec)
    for side in (-1.0, 1.0):
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX, size=POST, pos=[DOOR, side * (0.5 * DOOR_WIDTH + POST[1]), POST[2]],
            rgba=POST_COLOR, **OBSTACLE,
        )  # fmt: skip


def uneven_floor(spec: mujoco.MjSpec) -> None:
    """Bumps and cables."""
    common = {"friction": [0.75, 0.005, 1e-4], "solref": [0.01, 1.0], **GROUND}
    for x, y in BUMPS:
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_ELLIPSOID,
            size=[BUMP_RADIUS, BUMP_RADIUS, BUMP_HEIGHT],
            pos=[x, y, 0.0],
            **common,
        )
    for x in CABLES:
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=[x, -2.0, 0.0, x, 2.0, 0.0], size=[CABLE_RADIUS, 0, 0], **common
        )


def clearance(robot: RobotModel, poses: np.ndarray, legs: np.ndarray) -> float:
    """Smallest distance [m] of body and wheels to the posts of the door on the way (poses (k, 3), leg angles (k, n))."""
    nearest = np.inf
    corners = np.array([[x, y] for x in (-BODY[0], BODY[0]) for y in (-BODY[1], BODY[1])])
    posts = np.array([[DOOR, 0.5 * DOOR_WIDTH], [DOOR, -0.5 * DOOR_WIDTH]])
    near = np.abs(poses[:, 0] - DOOR) < 1.2
    for (x, y, yaw), leg in zip(poses[near], legs[near], strict=True):
        turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
        feet = swerve_base(robot).geometry.steer_axes(leg)
        points = np.vstack([corners, feet + [0.0, LEG_HALF], feet - [0.0, LEG_HALF]]) @ turn.T + [x, y]
        # the outline between its corners is widest at them
        inside = np.abs(points[:, 0] - DOOR) < 0.05
        if inside.any():
            nearest = min(nearest, float(np.min(posts[0, 1] - np.abs(points[inside, 1]))))
    return float(nearest)
